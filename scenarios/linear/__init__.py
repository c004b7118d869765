"""Any linear system whose matrices stand in the file."""

from .setting import LinearSystem

__all__ = ["LinearSystem"]
