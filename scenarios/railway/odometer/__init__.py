"""The design model of a train's own odometry, for settings that simulate it and for recorded trips alike."""

from .model import INPUTS, Odometer, OdometerKnowledge
from .modes import slip_modes

__all__ = ["INPUTS", "Odometer", "OdometerKnowledge", "slip_modes"]
