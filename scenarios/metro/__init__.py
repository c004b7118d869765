"""A metro train from stop to stop (Liu 2025)."""

from .setting import Metro

__all__ = ["Metro"]
