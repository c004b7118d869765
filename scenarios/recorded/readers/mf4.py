"""MF4 measurements (ASAM MDF): every numeric channel with its unit, by asammdf.

Groups have clocks of their own; a row is a stamp of any of them, in s after the measurement's start."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from asammdf import MDF
from asammdf.blocks.utils import MdfException

from .table import Table, cause, joined


def read_mf4(path: Path) -> Table:
    """Columns time [s] and the channels by name, with their units. Raises ValueError."""
    series, units = {}, dict[str, str]()
    try:
        with MDF(str(path)) as measured:
            for signal in measured.iter_channels(skip_master=True):
                values = np.asarray(signal.samples)
                if values.ndim == 1 and values.dtype.kind in "iuf" and len(values):
                    name = signal.name if signal.name not in series else f"{signal.name} #{len(series)}"
                    series[name] = np.round(signal.timestamps, 9), values.astype(float)
                    if signal.unit:
                        units[name] = signal.unit
    except (MdfException, OSError, ValueError, KeyError, IndexError) as error:
        raise ValueError(f"{path}: not an MF4 measurement that can be read: {cause(error)}") from None
    if not series:
        raise ValueError(f"{path}: holds no numeric channel")
    return joined(str(path), series, "time [s]", "MF4", units)
