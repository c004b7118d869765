"""What odometry estimators are told: the odometer's model, and the bounds for set-membership."""

from __future__ import annotations

from typing import Literal

from ..railway.odometer import OdometerKnowledge
from .inclusion import Limits


class Knowledge(OdometerKnowledge):
    """limits: bounds, for set-membership; the rest see `OdometerKnowledge`."""

    motion: Literal["accelerometer", "wheel-a", "wheel-b", "minmax"]  # pyright: ignore[reportIncompatibleVariableOverride]
    limits: Limits
