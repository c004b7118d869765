"""Every installed estimator with each of its parameters off its default, on the rules' small model: what it estimates,
whole, beside committed text (to renew it: `tests/expected.py`)."""

from __future__ import annotations

import typing
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from railstate.benchmarks.conformance import tapes
from railstate.benchmarks.conformance.trial import feed
from railstate.estimators.registry import estimators
from railstate.scenarios.errors import Infeasible, InputError, Unsupported

from ..expected import digest

SLOW = ("robust-bounded", "robust-ellipsoid", "robust-mean-square", "ultimate-bound", "fastest-decay")
"""What solves convex problems: with its defaults alone, where it is quick."""
GIVEN: dict[str, dict[str, Any]] = {"fixed-gain": {"gain": [[0.5, 0.1], [0.2, 0.4]]}}


def others(annotation: Any, default: Any) -> Iterator[Any]:
    """Values of a parameter other than the usual one."""
    origin = typing.get_origin(annotation)
    if origin is typing.Literal:
        yield from (value for value in typing.get_args(annotation) if value != default)
    elif isinstance(default, bool):
        yield not default
    elif isinstance(default, int):
        yield from (default + 1, max(default // 2, 1))
    elif isinstance(default, float):
        yield from (default * 0.5, default * 1.5 if default else 0.5)
    elif default is None and (annotation is float or float in typing.get_args(annotation)):
        yield from (0.4, 2.5)
    elif default is None and int in typing.get_args(annotation):
        yield 3


def cases(cls: type[Any], name: str) -> Iterator[Mapping[str, Any]]:
    given = GIVEN.get(name, {})
    yield given
    if name in SLOW:
        return
    for key, field in cls.Parameters.model_fields.items():
        if not field.is_required() and key not in given:
            for value in others(field.annotation, field.get_default(call_default_factory=True)):
                yield {**given, key: value}


def estimates(cls: type[Any], case: tapes.Case) -> Iterator[str]:
    """Over all instants and runs, and of the last alone."""
    record = feed(cls, case, case.tape)
    for part in ("mean", "covariance", "ellipsoid", "bound", "parameter"):
        found = [getattr(one, part) for one in record.estimates if getattr(one, part, None) is not None]
        if found:
            yield f"    {part} {digest(np.stack([np.broadcast_to(one, found[-1].shape) for one in found]))}"
            yield f"      at last {digest(found[-1])}"
    if record.status.any():
        yield f"    {record.status.tolist()} {record.reasons}"


@pytest.mark.parametrize("name", sorted(estimators()))
def test_estimates(name: str, expected: Callable[[str, str], None]) -> None:
    cls, out = estimators()[name], list[str]()
    for parameters in cases(cls, name):
        for make in (tapes.small_case, tapes.telling_case)[:1 + ("covariance" in cls.honours)]:
            case = make(parameters)
            out.append(f"  {case.name} {dict(parameters)}")
            try:
                out += estimates(cls, case)
            except (InputError, Unsupported, Infeasible, ValidationError) as error:
                out.append(f"    {str(error).splitlines()[0]}")
    expected(f"estimates:{name}", "\n".join(out))
