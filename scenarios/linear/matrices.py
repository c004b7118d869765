"""Matrices of scenario files: numbers, expressions of the step k, or one matrix a step.

Checked when the file is read, so that a simulation never meets a bad entry half-way."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import AfterValidator, WithJsonSchema

from ..arrays import Array
from .expressions import expression

AtStep = Callable[[int], Array]
Value = TypeVar("Value")


def _checked(matrix: list[Any]) -> list[Any]:
    """The same lists, every entry checked. Raises ValueError saying where and what."""
    for one in matrix if _per_step(matrix) else [matrix]:
        if not one or not all(isinstance(row, list) and row for row in one):
            raise ValueError("must be a list of rows such as [[1, 0.1], [0, 1]], or a list of such matrices")
        if len({len(row) for row in one}) > 1:
            raise ValueError(f"has rows of different lengths {[len(row) for row in one]}")
        for i, row in enumerate(one):
            for j, entry in enumerate(row):
                try:
                    _entry(entry)
                except ValueError as error:
                    raise ValueError(f"entry [{i}][{j}]: {error}") from None
    if _per_step(matrix) and len({(len(one), len(one[0])) for one in matrix}) > 1:
        raise ValueError("lists matrices of different shapes")
    return matrix


def _per_step(matrix: list[Any]) -> bool:
    first = matrix[0] if matrix else None
    return isinstance(first, list) and bool(first) and isinstance(first[0], list)


def _entry(entry: Any) -> float | Callable[[int], float]:
    if isinstance(entry, str):
        return expression(entry)
    if isinstance(entry, bool) or not isinstance(entry, int | float) or not math.isfinite(entry):
        raise ValueError(f"{entry!r} is neither a finite number nor an expression of k in quotes")
    return float(entry)


Matrix = Annotated[list[Any], AfterValidator(_checked), WithJsonSchema({
    "type": "array", "items": {"type": "array"},
    "description": "Rows of numbers or expressions of the step k (\"0.95 + 0.05*sin(k)\"); or one matrix a step.",
})]
"""A field type: rows of numbers or expressions, or a list of such matrices of which the first is for k = 0."""


def shape(matrix: list[Any]) -> tuple[int, int]:
    """Rows and columns."""
    one = matrix[0] if _per_step(matrix) else matrix
    return len(one), len(one[0])


def listed(matrix: list[Any]) -> int | None:
    """How many steps a matrix-a-step lists; None for a matrix that holds at every step."""
    return len(matrix) if _per_step(matrix) else None


def varies(matrix: list[Any]) -> bool:
    """Whether the matrix may depend on the step."""
    return _per_step(matrix) or any(isinstance(entry, str) for row in matrix for entry in row)


def times(matrix: list[Any], factor: float) -> list[Any]:
    """The matrix with every entry so many times as large."""
    if isinstance(matrix, list):
        return [times(part, factor) for part in matrix]
    return f"{factor!r}*({matrix})" if isinstance(matrix, str) else factor * matrix


def at_step(matrix: list[Any]) -> AtStep:
    """The matrix as a function of k, each step evaluated once; the arrays (rows, columns) are not to be written to.

    The function raises ValueError where an expression has no finite value."""

    def entries(rows: list[Any]) -> list[list[Any]]:
        return [[_entry(entry) for entry in row] for row in rows]

    once = None if _per_step(matrix) else entries(matrix)

    def value(k: int) -> Array:
        rows = once or entries(matrix[k])
        return np.array([[entry(k) if callable(entry) else entry for entry in row] for row in rows])

    return remembered(value, varies(matrix))


def remembered(value: Callable[[int], Value], varying: bool) -> Callable[[int], Value]:
    """`value` computed once a step, or once for all steps where it does not vary."""
    if varying:
        return cache(value)
    once = cache(lambda: value(0))
    return lambda k: once()
