"""The design model of a train's own odometry, for settings that simulate it and for recorded trips alike."""

from .model import Initial, Odometer, OdometerKnowledge, Slip
from .modes import slip_modes
from .motion import INPUTS

__all__ = ["INPUTS", "Initial", "Odometer", "OdometerKnowledge", "Slip", "slip_modes"]
