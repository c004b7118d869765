"""The conformance test of estimators: recorded tapes are fed, cut, changed and fed again, and compared bit for bit.

`checking.py` runs the rules of `rules.py` (one in `walking.py`) on the cases of `tapes.py`, with what `trial.py` says
of them."""

from .checking import Finding, Report, conform
from .tapes import small_model

check = conform
"""The name by which the tests that `railstate new` wrote for version 0.1 call it."""

__all__ = ["Finding", "Report", "check", "conform", "small_model"]
