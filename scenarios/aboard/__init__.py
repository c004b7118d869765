"""Sensors aboard a train, for any setting that knows a true trip: what they read, and a design model that hears them.

The truth is the setting's own; wheels slip on it by the adhesion that its motion needs, balises are read inside
steps."""

from .config import FITTED, Filled, Fitted, Instruments, Places, Route
from .sensing import Aboard, sense
from .told import hearing

__all__ = ["FITTED", "Aboard", "Filled", "Fitted", "Instruments", "Places", "Route", "hearing", "sense"]
