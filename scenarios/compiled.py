"""Model functions as machine code of one signature, handed to compiled filters by address.

So filters compile once for all models, and run model and moments on a block of runs while it is in the cache."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Callable
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import carray, types  # pyright: ignore[reportPrivateImportUsage]
from numba.extending import intrinsic

from .arrays import Array, read_only
from .machine_code import cfunc, njit
from .measurement import Interval

FLOAT = np.dtype(float)
_NUMBERS = types.CPointer(types.float64)
SIGNATURE = types.int64(_NUMBERS, _NUMBERS, _NUMBERS, _NUMBERS, types.int64, types.int64, types.int64, _NUMBERS)
"""0 from (x, u, seconds, data, points, width, stride, out).

x (nx, points, stride), u (nu, stride) and seconds (stride,), the length of each run's interval, of which the first
`width` runs count; data: the model's constants. out: f(x, u), (nx, points, stride), or df/dx, (nx, nx, stride), where
points is 1. Nothing of a run may depend on another."""


class Compiled:
    """A function of a design model (`DesignModel.transition`, `transition_jacobian`) that is machine code: callable
    like any other, and to be called from compiled code through `call`.

    function: of `SIGNATURE`, to be compiled; inputs: how many it reads; given(interval, runs): its data and the lengths
    (S,) of the interval, or Unsupported raised where the model does not know such; square: whether it is a Jacobian."""

    def __init__(self, function: Callable[..., int], inputs: int, given: Callable[[Interval, int], tuple[Array, Array]],
                 square: bool = False) -> None:
        self.function, self.inputs, self.given, self.square = function, inputs, given, square

    @cached_property
    def address(self) -> int:
        """Where the machine code is; compiled when first asked for."""
        return address(self.function)

    def arguments(self, u: Array, interval: Interval) -> tuple[int, Array, Array, Array]:
        """Address, u (nu, S), seconds (S,) and data, for `call`. Raises ValueError for inputs of another shape."""
        inputs, runs = u.shape
        if inputs != self.inputs:
            raise ValueError(f"this model has {self.inputs} inputs, not {inputs}")
        data, seconds = self.given(interval, runs)
        if u.dtype is not FLOAT or not u.flags.c_contiguous:
            u = np.ascontiguousarray(u, dtype=float)
        return self.address, read_only(u), seconds, data

    def __call__(self, x: Array, u: Array, interval: Interval) -> Array:
        points = np.ascontiguousarray(x, dtype=float).reshape(x.shape[0], -1, x.shape[-1])
        out = np.empty((len(x), len(x), x.shape[-1]) if self.square else points.shape)
        _run(*self.arguments(u, interval), points, out)
        return out if self.square else out.reshape(x.shape)


@cache
def address(function: Callable[..., int]) -> int:
    """Where the machine code of a function of `SIGNATURE` is."""
    code: Any = cfunc(SIGNATURE, cache=True, error_model="numpy")(function)
    return int(code.address)


class WholeSteps(NamedTuple):
    """A design model over whole sampling periods, in machine code: functions of `SIGNATURE` by address, those of the
    measurement of x alone: out (ny, points, stride), (ny, nx, stride). All take `data`; Q (nx, nx, 1).

    noise (3, ny): R of each element, uncorrelated: its variance where sensors tell none, a factor on either, and what
    it is whatever they tell (NaN: nothing). of: the design model's functions that all this stands for."""

    transition: int
    jacobian: int
    measurement: int
    measurement_jacobian: int
    data: Array
    Q: Array
    noise: Array
    of: tuple[object, ...]


class LinearSteps(NamedTuple):
    """A linear design model over whole sampling periods that are all alike: x+ in machine code with its `data`, F, Q
    (nx, nx, 1), H (ny, nx, 1), and R (ny, ny, 1), which is diagonal, where sensors tell none. of: as above."""

    transition: Compiled
    data: Array
    F: Array
    Q: Array
    H: Array
    R: Array
    of: tuple[object, ...]


def _call(typingctx: Any, address: Any, x: Any, u: Any, seconds: Any, data: Any, points: Any, width: Any, stride: Any,
          out: Any) -> Any:
    """call(address, x, u, seconds, data, points, width, stride, out) with contiguous arrays, see `SIGNATURE`."""
    arrays = (1, 2, 3, 4, 8)

    def codegen(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        word, number = ir.IntType(64), ir.DoubleType()
        given = []
        for i, value in enumerate(values):
            if i in arrays:
                given.append(context.make_array(signature.args[i])(context, builder, value).data)
            elif i:
                given.append(value)
        kind = ir.FunctionType(word, [ir.PointerType(number) if i in arrays else word for i in range(1, 9)])
        return builder.call(builder.inttoptr(values[0], ir.PointerType(kind)), given)

    number = types.int64
    return types.int64(number, x, u, seconds, data, number, number, number, out), codegen


call: Any = intrinsic(_call)
"""In compiled code: run the machine code at an address."""


@njit(cache=True)
def _run(address, u, seconds, data, x, out):  # pyright: ignore
    """The function at an address for all runs at once: x (nx, P, S)."""
    call(address, x, u, seconds, data, x.shape[1], x.shape[2], x.shape[2], out)


@njit(cache=True)
def accumulate(matrix, x, out):  # pyright: ignore
    """out (m, S) += matrix (m, n) times x (n, S)."""
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            factor = matrix[i, j]
            if factor != 0.0:
                for s in range(x.shape[1]):
                    out[i, s] += factor * x[j, s]


def affine(x, u, seconds, data, points, width, stride, out):  # pyright: ignore
    """A x + B u + h of data = nx, nu, A, B, h: sums over the small index, so that runs do not mix."""
    n, m = int(data[0]), int(data[1])
    constants = carray(data, (2 + n * n + n * m + n,))
    here, there, driven = carray(x, (n, points, stride)), carray(out, (n, points, stride)), carray(u, (m, stride))
    A, B = constants[2:2 + n * n].reshape((n, n)), constants[2 + n * n:2 + n * n + n * m].reshape((n, m))
    h, drive = constants[2 + n * n + n * m:], np.empty((n, width))
    columns, counts = np.empty((n, n), np.int64), np.zeros(n, np.int64)
    for i in range(n):
        row = drive[i]
        for s in range(width):
            row[s] = 0.0
        for j in range(m):
            factor = B[i, j]
            if factor != 0.0:
                given = driven[j]
                for s in range(width):
                    row[s] += factor * given[s]
        for j in range(n):
            columns[i, counts[i]] = j
            counts[i] += A[i, j] != 0.0
    for p in range(points):  # of a point at a time all states are in the first cache
        for i in range(n):
            moved, count, k = there[i, p], counts[i], 0
            for s in range(width):
                moved[s] = 0.0
            while k + 4 <= count:  # four terms at a time: fewer loads and stores, the same order of additions
                a, b, c, d = columns[i, k], columns[i, k + 1], columns[i, k + 2], columns[i, k + 3]
                f0, f1, f2, f3 = A[i, a], A[i, b], A[i, c], A[i, d]
                x0, x1, x2, x3 = here[a, p], here[b, p], here[c, p], here[d, p]
                for s in range(width):
                    moved[s] = (((moved[s] + f0 * x0[s]) + f1 * x1[s]) + f2 * x2[s]) + f3 * x3[s]
                k += 4
            while k < count:
                f0, x0 = A[i, columns[i, k]], here[columns[i, k], p]
                for s in range(width):
                    moved[s] += f0 * x0[s]
                k += 1
            row = drive[i]
            for s in range(width):
                moved[s] = (moved[s] + h[i]) + row[s]
    return 0
