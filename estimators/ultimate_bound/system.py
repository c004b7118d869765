"""The estimation error's dynamics of a design model: what the LMIs are about."""

from __future__ import annotations

from typing import cast

import numpy as np

from ...scenarios.arrays import Array
from ...scenarios.errors import Unsupported
from ...scenarios.model import DesignModel
from . import lmi
from .lmi import ErrorSystem, Node

NEEDS = ("linear", "bounds", "reception", "performance")
THETA = 0.98
"""The paper's decay, where neither the estimator's parameters nor the scenario's knowledge name one."""


def error_system(model: DesignModel) -> ErrorSystem:
    """The estimation error's dynamics (eq. (11)) from a design model. Raises Unsupported.

    Forces are `bounds.G` w with |w_i| <= `bounds.w_bar[i]`. Reception: one packet with all elements, its probability
    known to an interval (the paper's case); or nodes of which exactly one transmits each step with known probabilities
    (random access), where the same Lyapunov argument holds with exact second moments: E over the chosen node i of
    (A - K Pi_i C)' P (A - K Pi_i C). The latter is our extension, not the paper's. `details["mirror"]`, where given:
    see `ErrorSystem`."""
    linear, bounds, reception, performance = model.linear, model.bounds, model.reception, model.performance
    if linear is None or bounds is None or reception is None or performance is None:
        raise Unsupported(f"an ultimate bound needs {', '.join(NEEDS)} of the design model")
    if not linear.constant or bounds.M is not None:
        raise Unsupported("an ultimate bound needs a linear plant that does not change with time")
    C = linear.C(0)
    if reception.nodes:
        nodes = tuple(Node(elements, p, 0.0, p * (1 - p), p)
                      for elements, p in zip(reception.nodes, reception.p, strict=True))
    else:
        nodes = (lmi.packet(reception.p_low, reception.p_high, C.shape[0], reception.variance),)
    noise_root = cast(Array, np.linalg.cholesky(linear.R(0)))
    mirror = cast(tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]] | None, model.details.get("mirror"))
    if model.appended:
        mirror = None  # an order of the plain model's states
    return ErrorSystem(linear.A(0), C, bounds.G, performance, noise_root, bounds.w_bar, nodes, mirror)
