"""MCAP logs with ROS 2 or JSON messages: every number of every topic as a column `topic.field`, by mcap.

A row is a stamp of the log; topics of different rates have values at their own stamps only."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mcap.decoder import DecoderFactory
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory as Ros2

from .messages import Series
from .table import Table, cause


class Json(DecoderFactory):
    """Decodes messages that are JSON objects."""

    def decoder_for(self, message_encoding: str, schema: Any) -> Callable[[bytes], Any] | None:
        return json.loads if message_encoding == "json" else None


def read_mcap(path: Path) -> Table:
    """Columns log_time [ns] and topic.field. Raises ValueError."""
    series, kinds = Series(), set[str]()
    try:
        with path.open("rb") as file:
            reader = make_reader(file, decoder_factories=[Ros2(), Json()])
            for schema, channel, message, decoded in reader.iter_decoded_messages():
                kinds.add(schema.name if schema else channel.message_encoding)
                series.add(channel.topic, message.log_time, decoded)
    except (McapError, OSError, ValueError, EOFError, KeyError) as error:
        raise ValueError(f"{path}: not an MCAP log that can be read: {type(error).__name__}: {cause(error)}") from None
    return series.table(str(path), f"MCAP: {', '.join(sorted(kinds)[:4])}")
