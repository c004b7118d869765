"""What odometry estimators are told: the odometer's model, and the bounds for set-membership."""

from __future__ import annotations

from typing import Annotated, Literal

from ..railway.odometer import OdometerKnowledge
from ..strict import key
from .inclusion import Limits


class Knowledge(OdometerKnowledge):
    """What the estimators of `odometry` are told."""

    motion: Annotated[Literal["accelerometer", "wheel-a", "wheel-b", "minmax"], key(  # pyright: ignore[reportIncompatibleVariableOverride]
        "what the prediction goes by: the accelerometer, or dead reckoning by a wheel's count: wheel-a, wheel-b, "
        "or minmax: braking the faster, in traction the slower, else their mean")]
    limits: Annotated[Limits, key("bounds, for set-membership")]
