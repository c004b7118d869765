"""Messages of a log as columns: their numbers by `topic.field`, each at the stamps at which it was written.

What ROS 2 logs and JSON logs share; fields that are lists, texts or times of their own are left out."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from .table import Table, joined

LEFT_OUT = ("header", "stamp", "covariance")
DEEPEST = 6


class Series:
    """Collects numbers of messages by topic and field."""

    def __init__(self) -> None:
        self.stamps: dict[str, list[int]] = {}
        self.values: dict[str, list[float]] = {}

    def add(self, topic: str, stamp: int, message: Any) -> None:
        """Take up a message's numbers; stamp in ns."""
        for field, value in _numbers(message):
            name = f"{topic}.{field}" if field else topic
            self.stamps.setdefault(name, []).append(stamp)
            self.values.setdefault(name, []).append(value)

    def table(self, path: str, said: str) -> Table:
        """All series in one table. Raises ValueError where there are none."""
        if not self.values:
            raise ValueError(f"{path}: holds no message with numbers that can be read")
        series = {name: (np.array(self.stamps[name]), np.array(self.values[name])) for name in self.values}
        return joined(path, series, "log_time [ns]", said)


def _numbers(message: Any, field: str = "", depth: int = 0) -> Iterator[tuple[str, float]]:
    if isinstance(message, bool) or depth > DEEPEST:
        return
    if isinstance(message, (int, float, np.number)):
        yield field, float(message)
        return
    if isinstance(message, dict):
        inside = message.items()
    elif getattr(message, "__slots__", ()):
        inside = ((name, getattr(message, name, None)) for name in message.__slots__)
    elif hasattr(message, "__dict__"):
        inside = vars(message).items()
    else:
        return
    for name, value in inside:
        if not str(name).startswith("_") and name not in LEFT_OUT:
            yield from _numbers(value, f"{field}.{name}" if field else str(name), depth + 1)
