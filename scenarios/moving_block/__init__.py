"""Two miniature trains in moving block (Faruqi 2019)."""

from .setting import MovingBlock

__all__ = ["MovingBlock"]
