"""Braking with an unknown friction coefficient (Zheng 2015)."""

from .setting import Braking

__all__ = ["Braking"]
