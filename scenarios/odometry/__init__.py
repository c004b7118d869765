"""A train's own odometry: wheels that slip, balises, satellites."""

from .setting import Odometry

__all__ = ["Odometry"]
