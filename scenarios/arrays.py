"""Types of arrays, one name each; shapes and units stand in the docstring of whoever takes or returns one."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]
AnyArray = TypeVar("AnyArray", bound=NDArray[Any])


def read_only(values: AnyArray) -> AnyArray:
    """The same numbers for somebody else to read: a view that refuses to be written to.

    Numba compiles for such arrays apart: what is handed to estimators is read-only always, not sometimes."""
    if values.flags.writeable:
        values = values.view()
        values.flags.writeable = False
    return values
