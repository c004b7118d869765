"""Types of arrays, one name each; shapes and units stand in the docstring of whoever takes or returns one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]
