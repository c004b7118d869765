"""NMEA 0183 sentences of a satellite receiver (GGA, RMC, GLL, GST, VTG), one row a stamp, by pynmea2.

Sentences with a wrong checksum are left out and counted; a stamp's sentences stand together in one row."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pynmea2

from .table import Table, table_of

KINDS = {"0": "none", "1": "GNSS", "2": "differential", "4": "RTK fixed", "5": "RTK float", "6": "dead reckoning"}
HALF = 43200.0


def read_nmea(path: Path, data: bytes) -> Table:
    """Columns time [s] (of the first day), latitude, longitude, speed [kn], fix (in words), hdop, satellites, height
    [m], latitude_sd [m], longitude_sd [m]. Raises ValueError."""
    rows: list[dict[str, Any]] = []
    wrong = 0
    day, last = 0.0, None
    for line in data.decode("ascii", errors="replace").splitlines():
        text = line.strip()
        if not text:
            continue
        try:
            said = pynmea2.parse(text, check=True)
            found = _sentence(said)
        except (pynmea2.ParseError, ValueError, AttributeError, TypeError):
            wrong += 1
            continue
        stamp = getattr(said, "timestamp", None) if found is not None else None
        if found is None or (stamp is None and not rows):
            continue
        if stamp is not None:
            of_day = 3600.0 * stamp.hour + 60.0 * stamp.minute + stamp.second + 1e-6 * stamp.microsecond
            if last is not None and of_day < last - HALF:
                day += 2 * HALF
            last = of_day
            if not rows or rows[-1]["time [s]"] != day + of_day:
                rows.append({"time [s]": day + of_day})
        rows[-1].update({name: value for name, value in found.items() if value is not None})
    if not rows:
        raise ValueError(f"{path}: no NMEA sentence with a time (GGA, RMC, GLL, GST); {wrong} lines are none or have a "
                         "wrong checksum")
    names = list(dict.fromkeys(name for row in rows for name in row))
    columns = {name: [str(row.get(name, "")) for row in rows] if name == "fix" else
               np.array([row.get(name, np.nan) for row in rows], dtype=float) for name in names}
    return table_of(str(path), columns, f"NMEA{f', {wrong} lines with a wrong checksum left out' if wrong else ''}")


def _sentence(said: Any) -> dict[str, Any] | None:
    """What a sentence says, by column; None for a kind that is not read."""
    kind = getattr(said, "sentence_type", "")
    place = {}
    if kind in ("GGA", "RMC", "GLL") and said.lat and said.lon:
        place = {"latitude": said.latitude, "longitude": said.longitude}
    if kind == "GGA":
        none = str(said.gps_qual) == "0"
        return {**({} if none else place), "fix": KINDS.get(str(said.gps_qual), str(said.gps_qual)),
                "hdop": _number(said.horizontal_dil), "satellites": _number(said.num_sats),
                "height [m]": _number(said.altitude)}
    if kind == "RMC":
        return {**place, "speed [kn]": _number(said.spd_over_grnd)} if said.status == "A" else {}
    if kind == "GLL":
        return place if said.status == "A" else {}
    if kind == "VTG":
        return {"speed [kn]": _number(said.spd_over_grnd_kts)}
    if kind == "GST":
        return {"latitude_sd [m]": _number(said.std_dev_latitude), "longitude_sd [m]": _number(said.std_dev_longitude)}
    return None


def _number(value: Any) -> float | None:
    return None if value in (None, "") else float(value)
