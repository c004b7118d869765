"""A train of coupled cars over a shared radio channel (Zou 2018)."""

from .setting import CoupledCars

__all__ = ["CoupledCars"]
