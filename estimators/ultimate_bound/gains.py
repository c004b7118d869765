"""Gains in files."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from ...scenarios.arrays import Array
from ...scenarios.errors import InputError
from ...scenarios.registry import scenario_files


def read_gain(file: str, folder: Path = Path()) -> Array:
    """The matrix in a CSV file: one beside the built-in scenarios by its bare name, else by path from `folder` on.
    Raises InputError."""
    known = [beside for toml in scenario_files().values() if (beside := toml.parent / file).is_file()]
    path = known[0] if Path(file).name == file and known else folder / file
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of an empty file, which has its own message
            gain = np.loadtxt(path, delimiter=",", ndmin=2)
    except FileNotFoundError:
        raise InputError(f"{file}: there is no such file, neither here nor beside the built-in scenarios") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: not a CSV file of numbers, one row of the gain a line: {error}") from None
    if not gain.size:
        raise InputError(f"{file}: is empty; a gain has one row of numbers a line")
    if not np.isfinite(gain).all():
        raise InputError(f"{file}: a gain must have only finite numbers")
    return gain
