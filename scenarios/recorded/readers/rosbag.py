"""The folder of a rosbag2: every number of every topic as a column `topic.field`, by rosbags.

A row is a stamp of the log; topics of different rates have values at their own stamps only."""

from __future__ import annotations

from pathlib import Path

from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.typesys import Stores, get_typestore

from .messages import Series
from .table import Table, cause


def read_rosbag(path: Path) -> Table:
    """Columns log_time [ns] and topic.field. Raises ValueError."""
    series, kinds = Series(), set[str]()
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            for connection, stamp, raw in reader.messages():
                if connection.msgtype in reader.typestore.fielddefs:
                    kinds.add(connection.msgtype)
                    series.add(connection.topic, stamp, reader.deserialize(raw, connection.msgtype))
    except (AnyReaderError, OSError, ValueError, KeyError, TypeError, AssertionError) as error:
        raise ValueError(f"{path}: not a rosbag2 that can be read: {cause(error)}") from None
    return series.table(str(path), f"rosbag2: {', '.join(sorted(kinds)[:4])}")
