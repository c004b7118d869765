"""The conformance test of estimators: recorded tapes are fed, cut, changed and fed again, and compared bit for bit.

`checking.py` runs the rules of `rules.py` on the cases of `tapes.py`, with what `trial.py` says of them."""

from .checking import Finding, Report, check
from .tapes import small_model

__all__ = ["Finding", "Report", "check", "small_model"]
