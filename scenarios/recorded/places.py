"""Latitude and longitude as the distance along a line and the offset across: a track's (GeoJSON), or the own path.

Distances along are geodesic; the line of a network is the way through it that stays nearest to the fixes."""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pyproj
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from ..arrays import Array
from .readers.files import content, regular

GEOD = pyproj.Geod(ellps="WGS84")
APART, CLEAR = 25.0, 3.0
"""A vertex of the own path is at least this many m, and this many standard deviations, from the one before."""
FAR = 1e4
"""m; a line farther than this from all fixes is another one."""
JOINT, AWAY = 2.0, 10.0
"""m: ends of a network's pieces that are nearer are one point; a piece this far from the fixes costs twice its
length."""


def along(latitude: Array, longitude: Array, sd: Array | None, track: str | None,
          path: str) -> tuple[Array, Array, str]:
    """Distance along (N,) and offset across (N,) in m (NaN where there is no fix), and in words along what. Raises
    ValueError."""
    there = np.isfinite(latitude) & np.isfinite(longitude)
    wrong = np.flatnonzero(there & ((np.abs(latitude) > 90) | (np.abs(longitude) > 180)))
    if len(wrong):
        raise ValueError(f"{path}: latitude {latitude[wrong[0]]:g}, longitude {longitude[wrong[0]]:g} in row "
                         f"{wrong[0] + 1}: degrees are needed, -90 .. 90 and -180 .. 180 (a missing value: missing = "
                         f"[{latitude[wrong[0]]:g}])")
    if there.sum() < 3:
        raise ValueError(f"{path}: needs at least three fixes of latitude and longitude, but has {there.sum()}")
    plane = pyproj.Proj(proj="tmerc", lat_0=float(np.median(latitude[there])),
                        lon_0=float(np.median(longitude[there])), ellps="WGS84")
    x, y = (np.asarray(values) for values in plane(longitude[there], latitude[there]))
    spread = np.full(there.sum(), 3.0) if sd is None else np.where(np.isnan(sd), 3.0, sd)[there]
    s, across = np.full(len(there), np.nan), np.full(len(there), np.nan)
    if track is None:
        s[there], across[there] = _own(x, y, spread)
        return s, across, "the recording's own path"
    line = _line(track, plane, x, y)
    points = shapely.points(x, y)
    flat = shapely.line_locate_point(line, points)
    corners = np.asarray(line.coords)
    lengths = _lengths(corners, plane)
    at = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    s[there] = np.interp(flat, at, lengths)
    if s[there][-1] < s[there][0]:
        s[there] = lengths[-1] - s[there]
    across[there] = shapely.distance(line, points)
    return s, across, f"the track of {track}"


def _lengths(corners: Array, plane: pyproj.Proj) -> Array:
    """Geodesic distance (n,) of a line's corners from its start."""
    lon, lat = plane(corners[:, 0], corners[:, 1], inverse=True)
    return np.concatenate([[0.0], np.cumsum(GEOD.line_lengths(lon, lat))])


def _own(x: Array, y: Array, sd: Array) -> tuple[Array, Array]:
    """Along and across the path made of the fixes that are clearly apart, each fix between its two neighbours in
    time."""
    corners = [0]
    for i in range(1, len(x)):
        k = corners[-1]
        if np.hypot(x[i] - x[k], y[i] - y[k]) > max(APART, CLEAR * np.hypot(sd[i], sd[k])):
            corners.append(i)
    if corners[-1] != len(x) - 1:
        corners.append(len(x) - 1)
    turn = np.array(corners)
    dx, dy = np.diff(x[turn]), np.diff(y[turn])
    length = np.hypot(dx, dy)
    begins = np.concatenate([[0.0], np.cumsum(length)])
    part = np.clip(np.searchsorted(turn, np.arange(len(x)), side="right") - 1, 0, len(length) - 1)
    scale = np.where(length > 0, length, 1.0)[part]
    ax, ay = x - x[turn][part], y - y[turn][part]
    forward = np.clip((ax * dx[part] + ay * dy[part]) / scale, 0, length[part])
    return begins[part] + forward, np.abs(ax * dy[part] - ay * dx[part]) / scale


def _line(track: str, plane: pyproj.Proj, x: Array, y: Array) -> shapely.LineString:
    """The line (in the plane) that the fixes run along. Raises ValueError."""
    pieces = [shapely.LineString(np.column_stack(plane(*np.asarray(line)[:, :2].T))) for line in _lines(track)]
    trail = shapely.LineString(np.column_stack([x, y]))
    merged = shapely.line_merge(shapely.MultiLineString(pieces))
    near = [line for line in shapely.get_parts(merged) if shapely.distance(line, trail) < FAR]
    if not near:
        lon, lat = plane(x, y, inverse=True)
        turned = shapely.LineString(np.column_stack(plane(lat, lon)))
        if shapely.distance(merged, turned) < FAR:
            raise ValueError(f"{track}: far from the fixes as they are mapped, near once latitude and longitude are "
                             "exchanged: latitude and longitude have changed places")
        raise ValueError(f"{track}: no line of it is within 10 km of the fixes (longitude before latitude in GeoJSON)")
    return near[0] if len(near) == 1 else _way(near, trail, shapely.points(x[[0, -1]], y[[0, -1]]))


def _way(pieces: Sequence[shapely.LineString], trail: shapely.LineString, ends: Any) -> shapely.LineString:
    """The way through a network from the piece nearest to the first fix to the one nearest to the last: the shortest,
    where length counts the more, the farther a piece is from the trail of fixes."""
    tips = np.array([np.asarray(line.coords)[[0, -1]] for line in pieces]).reshape(-1, 2)
    node = np.arange(len(tips))
    for i in range(len(tips)):
        close = np.flatnonzero(np.hypot(*(tips[:i] - tips[i]).T) < JOINT)
        if len(close):
            node[i] = node[close[0]]
    dear = np.array([line.length * (1 + shapely.distance(trail, shapely.line_interpolate_point(
        line, np.linspace(0, line.length, 20))).mean() / AWAY) for line in pieces])
    first, last = (int(np.argmin(shapely.distance(np.array(pieces), end))) for end in ends)
    if first == last:
        return pieces[first]
    a, b = node[::2], node[1::2]
    size = len(tips)
    order = np.argsort(-dear, kind="stable")  # of two pieces between the same ends, the cheaper is written last
    cost, which = np.zeros((size, size)), np.full((size, size), -1)
    for i in order:
        cost[a[i], b[i]] = cost[b[i], a[i]] = max(dear[i], 1e-9)
        which[a[i], b[i]] = which[b[i], a[i]] = i
    distance, before = dijkstra(coo_array(cost).tocsr(), directed=False, return_predecessors=True,
                                indices=[a[first], b[first]])
    best = min((distance[i, end], i, end) for i in (0, 1) for end in (a[last], b[last]))
    if not np.isfinite(best[0]):
        raise ValueError("the track's pieces do not connect where the recording begins with where it ends")
    stops, start = [int(best[2])], (a[first], b[first])[best[1]]
    while stops[-1] != start:
        stops.append(int(before[best[1], stops[-1]]))
    stops.reverse()
    way = [(first, start), *((int(which[p, q]), q) for p, q in pairwise(stops))]
    if way[-1][0] != last:
        way.append((last, b[last] if a[last] == stops[-1] else a[last]))
    corners = []
    for piece, leads_to in way:
        line = np.asarray(pieces[piece].coords)
        corners.append(line if b[piece] == leads_to else line[::-1])
    return shapely.LineString(np.concatenate(corners))


def _lines(track: str) -> list[Any]:
    """The coordinates of the lines in a GeoJSON file. Raises ValueError."""
    data, _ = content(regular(track))
    try:
        table = json.loads(data)
    except (ValueError, RecursionError):
        raise ValueError(f"{track}: not GeoJSON") from None
    found: list[Any] = []
    waiting = [table]
    while waiting:
        item = waiting.pop()
        if not isinstance(item, dict):
            continue
        waiting += [inner for key in ("features", "geometries") for inner in item.get(key) or []]
        waiting.append(item.get("geometry"))
        if item.get("type") == "LineString":
            found.append(item.get("coordinates"))
        elif item.get("type") == "MultiLineString":
            found += item.get("coordinates") or []
    try:
        lines = [np.array([point[:2] for point in line], dtype=float) for line in reversed(found)]
    except (TypeError, ValueError, IndexError):
        raise ValueError(f"{track}: a line's coordinates are not [longitude, latitude] pairs") from None
    good = [line for line in lines if line.ndim == 2 and len(line) > 1 and np.isfinite(line).all()]
    if not good:
        raise ValueError(f"{track}: holds no LineString")
    if any(np.abs(line[:, 1]).max() > 90 for line in good):
        raise ValueError(f"{track}: coordinates are no degrees: GeoJSON has longitude, latitude (WGS 84)")
    return good
