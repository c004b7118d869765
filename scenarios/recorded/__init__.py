"""A recorded trip of the user's."""

from .setting import Recorded

__all__ = ["Recorded"]
