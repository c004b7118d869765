"""Faults of sensors, common to all settings: what makes a reading wrong, or keeps it away, and when.

Drawn per run, each entry from a stream of its own: what has no fault drawn stays as it is, bit for bit."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field

from .base import Base, Readings
from .failing import Burst, Drift, Dropout, Stuck
from .noise import Outliers, StudentT
from .place import Jump, Stamps

Fault = Annotated[Outliers | StudentT | Stuck | Drift | Jump | Dropout | Burst | Stamps, Field(discriminator="kind")]
KINDS = ("outliers", "student-t", "stuck", "drift", "jump", "dropout", "burst", "stamps")


def _told_apart(faults: tuple[Base, ...]) -> tuple[Base, ...]:
    labels = [fault.label for fault in faults]
    twice = sorted({label for label in labels if labels.count(label) > 1})
    if twice:
        raise ValueError(f"two entries are called {', '.join(twice)}: give each a name of its own (name = ..)")
    return faults


Faults = Annotated[tuple[Fault, ...], AfterValidator(_told_apart)]
"""The [[faults]] of a scenario file."""

__all__ = ["KINDS", "Base", "Burst", "Drift", "Dropout", "Fault", "Faults", "Jump", "Outliers", "Readings", "Stamps",
           "Stuck", "StudentT"]
