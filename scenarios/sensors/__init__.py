"""Sensors of trains: what each reads of the truth (drawn per run), and what it tells of how good a reading is."""

from .accelerometer import Accelerometer
from .balise import Balises, Passages
from .gnss import Gnss
from .radar import Radar
from .wheel import Wheel

__all__ = ["Accelerometer", "Balises", "Gnss", "Passages", "Radar", "Wheel"]
