"""Recordings of the suite's own making, of the kinds that people have: a tram's hops, fixes on a curved track, a metro.

The files in `scenarios/recorded/examples` are written by `write_examples`; a test compares them."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pyproj

STOPS, TOP, PULL = (0.0, 700.0, 1500.0), 14.0, 0.9
SCALE, STEP = 0.969, 5.0
ORIGIN = 50.85, 4.40
METRO = {"time": "t_s", "wheel-a": "wheel_a_m", "wheel-b": "wheel_b_m", "acceleration": "acc_mps2", "balise": "balise",
         "reference_position": "s_ref_m", "reference_speed": "v_ref_mps"}
BALISES = 20.0, 350.0, 690.0, 1080.0, 1400.0


def ride(period: float = 1.0, dwell: float = 20.0) -> pd.DataFrame:
    """t_s, s_m, v_mps, a_mps2 of a train that goes from stop to stop and stands in between."""
    hop: list[np.ndarray] = []
    for begin, end in pairwise(STOPS):
        ramp = TOP / PULL
        cruise = (end - begin - TOP * ramp) / TOP
        t = np.arange(0.0, dwell + 2 * ramp + cruise, 0.05)
        a = np.select([t < dwell, t < dwell + ramp, t < dwell + ramp + cruise], [0.0, PULL, 0.0], -PULL)
        a += 0.05 * np.sin(t / 7) * (a == 0) * (t > dwell)
        v = np.maximum(np.concatenate([[0.0], np.cumsum(a[:-1]) * 0.05]), 0.0)
        hop.append(np.stack([a, v]))
    a, v = np.concatenate([*hop, np.zeros((2, 100))], axis=1)
    s = np.concatenate([[0.0], np.cumsum(0.05 * (v[1:] + v[:-1]) / 2)])
    every = round(period / 0.05)
    return pd.DataFrame({"t_s": np.round(np.arange(len(s)) * 0.05, 2)[::every], "s_m": s[::every], "v_mps": v[::every],
                         "a_mps2": a[::every]}).reset_index(drop=True)


def tram(seed: int = 1, period: float = 1.0) -> pd.DataFrame:
    """The ride as a tram's logger writes it: positions by satellite, speed, an odometer 3.1 % short in steps of 5 m,
    an accelerometer, and a smoothed reference."""
    rng, true = np.random.default_rng(seed), ride(period)
    n = len(true)
    return pd.DataFrame({
        "t_s": true.t_s, "s_gnss_m": (true.s_m + rng.normal(0, 1.5, n)).round(2),
        "v_kmh": (3.6 * np.maximum(true.v_mps + rng.normal(0, 0.05, n) * (true.v_mps > 0), 0)).round(2),
        "odo_m": STEP * np.floor(SCALE * true.s_m / STEP) + 3760,
        "acc_mps2": (true.a_mps2 + rng.normal(0, .05, n)).round(2),
        "s_ref_m": true.s_m.round(2), "v_ref_mps": true.v_mps.round(3)})


def metro(seed: int = 1, period: float = 0.5) -> pd.DataFrame:
    """The ride as a train's own odometry logs it: two wheels' counters in steps of 2.7 cm, .6 % long and .4 % short,
    that slip in the second start and slide before the last stop; an accelerometer with a bias; balises by name, each
    in a row of its own; a reference."""
    rng, fine = np.random.default_rng(seed), ride(0.05)
    s, v, t = fine.s_m.to_numpy(), fine.v_mps.to_numpy(), fine.t_s.to_numpy()
    starting, stopping = (s > STOPS[1] + 5) & (s < STOPS[1] + 70), (s > STOPS[2] - 75) & (s < STOPS[2] - 8)
    counts = {}
    for name, scale, slips in (("wheel_a_m", 1.006, starting | stopping), ("wheel_b_m", 0.996, stopping)):
        turned = np.where(slips, v * np.where(starting, 1.5, 0.5), v) * scale
        counts[name] = 0.027 * np.floor(np.concatenate([[0.0], np.cumsum(0.05 * turned[1:])]) / 0.027)
    every = round(period / 0.05)
    out = pd.DataFrame({"t_s": t, **counts, "acc_mps2": fine.a_mps2 + 0.04})[::every].reset_index(drop=True)
    n = len(out)
    out = out.assign(
        wheel_a_m=out.wheel_a_m.round(3), wheel_b_m=out.wheel_b_m.round(3),
        acc_mps2=(out.acc_mps2 + rng.normal(0, 0.03, n)).round(3),
        s_ref_m=(s[::every] + rng.normal(0, 0.05, n)).round(2), v_ref_mps=v[::every].round(3))
    passed = np.interp(BALISES, s + 1e-9 * t, t).round(2)
    events = pd.DataFrame({"t_s": passed, "balise": [f"B{number + 1}" for number in range(len(BALISES))]})
    return pd.concat([out, events[~events.t_s.isin(out.t_s)]]).sort_values("t_s").reset_index(drop=True)


def track() -> np.ndarray:
    """Longitude and latitude (n, 2) of a line of 1.9 km with two curves."""
    along = np.linspace(-200.0, 1700.0, 96)
    heading = np.radians(60 + 25 * np.sin(along / 260) + along / 40)
    step = np.diff(along, prepend=along[0])
    x, y = np.cumsum(step * np.sin(heading)), np.cumsum(step * np.cos(heading))
    plane = pyproj.Proj(proj="tmerc", lat_0=ORIGIN[0], lon_0=ORIGIN[1], ellps="WGS84")
    return np.column_stack(plane(x, y, inverse=True)).round(7)


def fixes(seed: int = 1, period: float = 0.5) -> pd.DataFrame:
    """The ride as a satellite receiver writes it: time with zone, latitude, longitude and a class of each fix, which is
    RTK for the most part, plain in places and none under a bridge."""
    rng, true = np.random.default_rng(seed), ride(period)
    line = track()
    geod = pyproj.Geod(ellps="WGS84")
    lengths = np.concatenate([[0.0], np.cumsum(geod.line_lengths(line[:, 0], line[:, 1]))])
    n = len(true)
    kind = np.full(n, "NARROW_INT3", dtype=object)
    kind[(true.s_m > 480) & (true.s_m < 560)] = "SINGLE"
    kind[(true.s_m > 1040) & (true.s_m < 1160)] = "PROPAGATED"
    sd = pd.Series(kind).map({"NARROW_INT3": 0.03, "SINGLE": 2.0, "PROPAGATED": 15.0}).to_numpy()
    place = 150 + true.s_m.to_numpy()
    plane = pyproj.Proj(proj="tmerc", lat_0=ORIGIN[0], lon_0=ORIGIN[1], ellps="WGS84")
    x, y = plane(np.interp(place, lengths, line[:, 0]), np.interp(place, lengths, line[:, 1]))
    lon, lat = plane(x + rng.normal(0, sd), y + rng.normal(0, sd), inverse=True)
    stamps = pd.Timestamp("2025-10-26T02:58:00+02:00") + pd.to_timedelta(true.t_s, unit="s")
    local = [stamp.tz_convert("Europe/Brussels").isoformat(timespec="milliseconds") for stamp in stamps]
    return pd.DataFrame({"time": local, "latitude": lat.round(8), "longitude": lon.round(8), "fix": kind})


def geojson(lines: list[np.ndarray]) -> str:
    """A GeoJSON file of these lines (n, 2)."""
    features = [{"type": "Feature", "properties": {"id": number}, "geometry": {
        "type": "LineString", "coordinates": line.tolist()}} for number, line in enumerate(lines)]
    return json.dumps({"type": "FeatureCollection", "features": features})


def write_examples(folder: Path) -> None:
    """tram.csv (commas); fixes.csv (semicolons, decimal commas) with its line track.geojson; metro.csv with the places
    of its balises."""
    metro().to_csv(folder / "metro.csv", index=False, lineterminator="\n")
    names = [f"B{number + 1}" for number in range(len(BALISES))]
    pd.DataFrame({"balise": names, "position_m": BALISES}).to_csv(folder / "balises.csv", index=False,
                                                                  lineterminator="\n")
    tram().to_csv(folder / "tram.csv", index=False, lineterminator="\n")
    fixes().to_csv(folder / "fixes.csv", index=False, sep=";", decimal=",", lineterminator="\n")
    (folder / "track.geojson").write_text(geojson([track()]), encoding="utf-8")
