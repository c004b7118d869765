"""Linear plants for the tests of the random access filters: random time-varying ones, and the paper's two examples."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from railstate.estimators.random_access.bounds import CovarianceBounds
from railstate.scenarios.files import load
from railstate.scenarios.linear.config import LinearConfig
from railstate.scenarios.linear.setting import LinearSystem


def plant(nx: int, nodes: list[list[int]], steps: int = 12, seed: int = 0, **channel: Any) -> LinearSystem:
    """A random time-varying plant with correlated noises whose measurement elements belong to `nodes`."""
    rng = np.random.default_rng(seed)
    ny = sum(len(node) for node in nodes)

    def covariance(n: int) -> list[Any]:
        half = rng.normal(size=(n, n))
        return (half @ half.T / n + 0.3 * np.eye(n)).tolist()

    def varying(rows: int, columns: int, scale: float) -> list[Any]:
        mean, swing = rng.normal(size=(2, rows, columns)) * scale
        return [[f"{a:.6f} + {0.3 * b:.6f}*sin({1 + i + j}*k)" for j, (a, b) in enumerate(zip(*row, strict=True))]
                for i, row in enumerate(zip(mean, swing, strict=True))]

    p = rng.uniform(0.5, 1.5, len(nodes))
    return LinearSystem(LinearConfig.model_validate({
        "name": "trial", "title": "Trial", "time": {"period": 1.0, "steps": steps},
        "plant": {"kind": "linear", "x0": rng.normal(size=nx).tolist(), "A": varying(nx, nx, 1 / math.sqrt(nx)),
                  "B": varying(nx, nx, 1.0), "C": varying(ny, nx, 1.0), "Q": covariance(nx), "R": covariance(ny),
                  "P0": covariance(nx)},
        "channel": channel or {"kind": "random-access", "p": (p / p.sum()).tolist(), "nodes": nodes},
        "estimators": {"random-access": {"plugin": "random-access"}},
    }))


PLANTS = {
    "two nodes": (2, [[0], [1]]), "one node": (3, [[0, 1]]), "nodes of several sensors": (3, [[0, 3], [1, 2], [4]]),
    "one sensor": (1, [[0]]), "twenty nodes": (2, [[i] for i in range(20)]),
}

def example(name: str, variant: str = "corrected") -> Any:
    setting = load(name).setting(variant)
    return setting.design_model({}, np.array(setting.config.plant.x0)[:, None])


def bounds_of(model: Any, horizon: int = 300) -> CovarianceBounds:
    return CovarianceBounds(model.linear, model.reception, model.initial_covariance[:, :, 0], horizon)
