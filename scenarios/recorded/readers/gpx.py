"""GPX tracks: time, latitude, longitude, height and what else a point says, by gpxpy.

All tracks and segments of a file follow each other; whoever wants one alone cuts it out by its times."""

from __future__ import annotations

from pathlib import Path

import gpxpy
import gpxpy.gpx
import numpy as np

from .table import Table, cause, table_of


def read_gpx(path: Path, data: bytes) -> Table:
    """Columns time (ISO 8601), latitude, longitude, elevation [m], hdop and speed [m/s] where there are any. Raises
    ValueError."""
    try:
        found = gpxpy.parse(data)
    except (gpxpy.gpx.GPXException, ValueError, AttributeError) as error:
        raise ValueError(f"{path}: not a GPX file: {cause(error)}") from None
    segments = [segment.points for track in found.tracks for segment in track.segments if segment.points]
    points = [point for segment in segments for point in segment]
    if not points:
        raise ValueError(f"{path}: a GPX file without track points")
    columns = {"time": ["" if point.time is None else point.time.isoformat() for point in points],
               "latitude": np.array([point.latitude for point in points]),
               "longitude": np.array([point.longitude for point in points])}
    for name, values in (("elevation [m]", [point.elevation for point in points]),
                         ("hdop", [point.horizontal_dilution for point in points]),
                         ("speed [m/s]", [point.speed for point in points])):
        if any(value is not None for value in values):
            columns[name] = np.array([np.nan if value is None else value for value in values])
    count = f", {len(segments)} segments" if len(segments) > 1 else ""
    return table_of(str(path), columns, f"GPX{count}")
