"""Which format a recording has, by what it begins with, and the reader for it.

Readers whose package is an extra are imported when such a file comes; the message then says what to install."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from .files import content, regular
from .table import Table

EXTRA = "pip install 'railstate[recordings]'"
SUFFIXES = {".parquet": "Parquet", ".pq": "Parquet", ".mcap": "MCAP", ".mf4": "MF4", ".db3": "rosbag2"}
"""Formats of which a name that says so is believed: a CSV file of that name is a mistake."""


def read(path: str) -> Table:
    """The columns of a recording. Raises ValueError: what is wrong with the file, in one message that names it."""
    found = regular(path)
    if found.is_dir():
        if not (found / "metadata.yaml").is_file():
            raise ValueError(f"{path}: is a folder; a recording is a file, or the folder of a rosbag2 (with its "
                             "metadata.yaml)")
        return _behind("rosbag", "rosbags")(found)
    head = _head(found)
    kind = _kind(head)
    claimed = SUFFIXES.get(found.suffix.lower())
    if claimed and kind != claimed:
        raise ValueError(f"{path}: not a {claimed} {'file' if claimed != 'Parquet' else 'table'}: it does not begin "
                         "like one")
    if kind == "Parquet":
        return _reader("parquet")(found)
    if kind == "MCAP":
        return _behind("mcap", "mcap, mcap-ros2-support")(found)
    if kind == "MF4":
        return _behind("mf4", "asammdf", "pip install 'railstate[mf4]'")(found)
    if kind == "rosbag2":
        raise ValueError(f"{path}: is one file of a rosbag2: name its folder, in which metadata.yaml lies")
    if head[:4] in (b"\x89HDF", b"MATL"):
        raise ValueError(f"{path}: is a file of MATLAB or HDF5: write the columns as CSV or Parquet")
    data, packed = content(found)
    start = data[:4096].lstrip(b"\xef\xbb\xbf \t\r\n")
    if start[:1] == b"<":
        if b"<gpx" not in start:
            raise ValueError(f"{path}: is XML, but no GPX")
        table = _behind("gpx", "gpxpy")(found, data)
    elif start[:1] in (b"$", b"!") and start[1:6].isalnum():
        table = _behind("nmea", "pynmea2")(found, data)
    else:
        from .delimited import read_delimited
        table = read_delimited(path, data)
    return Table(table.path, table.columns, table.said + (f", {packed}" if packed else ""), table.units)


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(64)
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror or error}") from None


def _kind(head: bytes) -> str:
    for magic, kind in ((b"PAR1", "Parquet"), (b"\x89MCAP", "MCAP"), (b"MDF ", "MF4"), (b"UnFinMF", "MF4"),
                        (b"SQLite format 3", "rosbag2")):
        if head.startswith(magic):
            return kind
    return ""


def _reader(module: str) -> Callable[..., Table]:
    return getattr(import_module(f"{__package__}.{module}"), f"read_{module}")


def _behind(module: str, packages: str, install: str = EXTRA) -> Callable[..., Table]:
    """A reader whose packages may be missing. Raises ValueError that says what to install."""
    try:
        return _reader(module)
    except ImportError as error:
        raise ValueError(f"such a recording needs {packages} ({error}): {install}") from None
