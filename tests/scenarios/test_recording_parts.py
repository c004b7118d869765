"""Small parts of reading recordings on inputs made by hand: logs, tracks, ways through networks, wheels, balises."""

from __future__ import annotations

import errno
import json
import os
import re
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyproj
import pytest
from railstate.scenarios.recorded import places, wheels
from railstate.scenarios.recorded.readers import delimited, files, gpx, mcap, mf4, parquet, reading, rosbag
from railstate.scenarios.recorded.readers.gpx import read_gpx
from railstate.scenarios.recorded.readers.messages import Series
from railstate.scenarios.recorded.readers.table import Table, joined

GPX = "http://www.topografix.com/GPX/1/1"


def refused(message: str) -> Any:
    return pytest.raises(ValueError, match=f"^{re.escape(message)}$")


def test_points_of_a_gpx_track() -> None:
    def track(*segments: str) -> bytes:
        return (f'<gpx version="1.1" creator="x" xmlns="{GPX}"><trk>'
                f"{''.join(f'<trkseg>{one}</trkseg>' for one in segments)}</trk></gpx>").encode()

    time, more = "<time>2026-01-02T03:04:05Z</time>", "<ele>7</ele><hdop>2</hdop>"
    two = track(f'<trkpt lat="1" lon="2">{time}</trkpt>', "", f'<trkpt lat="3" lon="4.5">{more}</trkpt>')
    found = read_gpx(Path("a"), two)
    assert found.said == "GPX, 2 segments" and found.columns.to_pydict() == {
        "time": ["2026-01-02T03:04:05+00:00", ""], "latitude": [1.0, 3.0], "longitude": [2.0, 4.5],
        "elevation [m]": [None, 7.0], "hdop": [None, 2.0]}
    one = read_gpx(Path("a"), track(f'<trkpt lat="1" lon="2"/><trkpt lat="3" lon="4">{time}</trkpt>'))
    assert one.said == "GPX" and one.names == ["time", "latitude", "longitude"]
    with refused("a: a GPX file without track points"):
        read_gpx(Path("a"), track())


def test_numbers_of_messages_by_topic_and_field() -> None:
    class Slots:
        __slots__ = ("_hidden", "a", "gone", "header")

        def __init__(self) -> None:
            self.a, self.header, self._hidden = np.float32(1.5), 9, 9

    class Plain:
        def __init__(self) -> None:
            self.b, self.inner = 2, Slots()

    series = Series()
    with refused("log: holds no message with numbers that can be read"):
        series.table("log", "kind")
    series.add("/x", 20, Slots())
    series.add("/x", 10, Plain())
    series.add("/y", 20, 7)
    series.add("/y", 20, 8)
    table = series.table("log", "kind")
    assert (table.path, table.said) == ("log", "kind") and table.columns.to_pydict() == {
        "log_time [ns]": [10, 20], "/x.a": [None, 1.5], "/x.b": [2.0, None], "/x.inner.a": [1.5, None],
        "/y": [None, 8.0]}
    assert joined("p", {}, "t", "s").columns.to_pydict() == {"t": []}


def test_kinds_of_messages_of_a_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Four kinds at most are named; those that nobody knows are left out."""
    from mcap.writer import Writer

    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        for k, kind in enumerate("edcba"):
            schema = writer.register_schema(kind, "jsonschema", b"{}")
            channel = writer.register_channel(f"/{kind}", "json", schema if kind != "a" else 0)
            writer.add_message(channel, k, json.dumps({"v": k}).encode(), k)
        writer.finish()
    found = mcap.read_mcap(tmp_path / "a.mcap")
    assert found.said == "MCAP: b, c, d, e" and found.columns["/a.v"].to_pylist() == [None] * 4 + [4.0]
    assert mcap.Json().decoder_for("json", None) is json.loads and mcap.Json().decoder_for("cdr", None) is None

    class Reader:
        def __init__(self, paths: list[Path], default_typestore: Any) -> None:
            self.typestore = self
            self.fielddefs = set("abcde")
            assert paths == [tmp_path] and "std_msgs/msg/Float64" in default_typestore.fielddefs

        def __enter__(self) -> Reader:
            return self

        def __exit__(self, *_: object) -> None:
            pass

        def messages(self) -> Any:
            for k, kind in enumerate("xedcba"):
                yield type("Connection", (), {"msgtype": kind, "topic": f"/{kind}"}), k, b""

        def deserialize(self, raw: bytes, kind: str) -> dict[str, float]:
            return {"v": float(ord(kind))}

    monkeypatch.setattr(rosbag, "AnyReader", Reader)
    found = rosbag.read_rosbag(tmp_path)
    assert found.said == "rosbag2: a, b, c, d" and found.names == [
        "log_time [ns]", "/e.v", "/d.v", "/c.v", "/b.v", "/a.v"] and found.rows == 5


@pytest.mark.parametrize(("package", "call", "said"), [
    (delimited.pacsv, "read_csv", "not a CSV table: "), (gpx.gpxpy, "parse", "not a GPX file: "),
    (mcap, "make_reader", "not an MCAP log that can be read: ArrowInvalid: "),
    (mf4, "MDF", "not an MF4 measurement that can be read: "), (parquet.pq, "ParquetFile", "not a Parquet table: "),
    (rosbag, "AnyReader", "not a rosbag2 that can be read: ")])
@pytest.mark.parametrize("words", ["", "no end", "no end\nat all"])
def test_what_a_package_says_of_a_file_is_passed_on(
        package: Any, call: str, said: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first line of it, also where it says nothing."""
    def failing(*_: object, **__: object) -> Any:
        raise pa.ArrowInvalid(words)

    monkeypatch.setattr(package, call, failing)
    path, data = tmp_path / "a", b"x,y\n1,2\n"
    path.write_bytes(data)
    read: Any = {delimited.pacsv: lambda path: delimited.read_delimited(str(path), data), gpx.gpxpy: lambda path:
                 read_gpx(path, data), mcap: mcap.read_mcap, mf4: mf4.read_mf4, parquet.pq: parquet.read_parquet,
                 rosbag: rosbag.read_rosbag}[package]
    with refused(f"{path}: {said}{words[:6]}"):
        read(path)


def test_what_is_lacking_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> Any:
        raise ImportError("no such module")

    path = tmp_path / "a.mf4"
    path.write_bytes(b"MDF     4.10")
    monkeypatch.setattr(reading, "import_module", missing)
    with refused("such a recording needs asammdf (no such module): pip install 'railstate[mf4]'"):
        reading.read(str(path))
    path.rename(tmp_path / "a.mcap").write_bytes(b"\x89MCAP0\r\n")
    with refused("such a recording needs mcap, mcap-ros2-support (no such module): "
                 "pip install 'railstate[recordings]'"):
        reading.read(str(tmp_path / "a.mcap"))
    monkeypatch.setitem(sys.modules, "zstandard", None)
    path.write_bytes(b"\x28\xb5\x2f\xfd")
    with refused(f"{path}: is compressed by zstd: pip install zstandard, or unpack it"):
        files.content(path)


def test_channels_of_a_measurement(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Numbers alone, those of one name by their number, stamps to the nanosecond; none at all is said."""
    class Channel:
        def __init__(self, name: str, samples: Any, unit: str = "") -> None:
            self.name, self.samples, self.unit = name, np.array(samples), unit
            self.timestamps = np.arange(len(self.samples)) + 1.4e-10

    channels = [Channel("a", [[1.0, 2.0]]), Channel("b", ["x"]), Channel("c", np.zeros(0))]

    class Measured:
        def __init__(self, path: str) -> None:
            assert path == str(tmp_path)

        def __enter__(self) -> Measured:
            return self

        def __exit__(self, *_: object) -> None:
            pass

        def iter_channels(self, skip_master: bool) -> list[Channel]:
            assert skip_master
            return channels

    monkeypatch.setattr(mf4, "MDF", Measured)
    with refused(f"{tmp_path}: holds no numeric channel"):
        mf4.read_mf4(tmp_path)
    channels += [Channel("v", [1, 2], "m/s"), Channel("s", [0.5]), Channel("v", np.array([7], np.uint8), "km/h")]
    found = mf4.read_mf4(tmp_path)
    assert found.columns.to_pydict() == {"time [s]": [0.0, 1.0], "v": [1.0, 2.0], "s": [0.5, None], "v #2": [7.0, None]}
    assert (found.said, found.units) == ("MF4", {"v": "m/s", "v #2": "km/h"})


def test_files_that_cannot_be_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "seven.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for name in "abcdefg":
            archive.writestr(name, name)
    with refused(f"{path}: the zip holds 7 files (a, b, c, d, e, ..): one is needed"):
        files.content(path)

    def denied(*_: object) -> Any:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(Path, "open", denied)
    with refused(f"{path}: cannot be read: Permission denied"):
        files.content(path)


PLANE = pyproj.Proj(proj="tmerc", lat_0=50.0, lon_0=4.0, ellps="WGS84")


def geojson(path: Path, *lines: list[tuple[float, float]]) -> str:
    """Lines in m about 50 N, 4 E as a network."""
    degrees = [[list(PLANE(*point, inverse=True)) for point in line] for line in lines]
    path.write_text(json.dumps({"type": "MultiLineString", "coordinates": degrees}))
    return str(path)


def fixes(*points: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Latitudes and longitudes of places in m, NaN where there is none."""
    lon, lat = PLANE(*np.array(points, dtype=float).T, inverse=True)
    return np.where(np.isfinite(lat), lat, np.nan), np.where(np.isfinite(lon), lon, np.nan)


A, B, C, D = (0.0, 0.0), (1000.0, 0.0), (1000.0, 600.0), (2000.0, 0.0)
E = (2600.0, 0.0)
PIECES = {"straight": [B, D], "first": [A, B], "up": [C, B], "over": [C, D], "last": [E, D]}
TRIPS = {
    "along": ([(100.0, 3.0), (900.0, -4.0), (1500.0, 2.0), (2500.0, 0.0)], [100, 900, 1500, 2500], [3, 4, 2, 0]),
    "back": ([(2500.0, 0.0), (1500.0, 0.0), (300.0, 5.0)], [100, 1100, 2300], [0, 0, 5]),
    "over": ([(100.0, 0.0), (990.0, 300.0), (1500.0, 300.0), (2500.0, 0.0)], None, [0, 10, 0, 0]),
    "on one piece": ([(100.0, 0.0), (500.0, 1.0), (800.0, 0.0)], [100, 500, 800], [0, 1, 0])}


@pytest.mark.parametrize("trip", TRIPS)
@pytest.mark.parametrize("turned", [False, True])
def test_the_way_through_a_network(trip: str, turned: bool, tmp_path: Path) -> None:
    """Whatever way round its pieces are drawn, and in whatever order they stand; a piece far away is none of it."""
    points, where, across = TRIPS[trip]
    lines = [line[::-1] if turned else line for line in PIECES.values()]
    track = geojson(tmp_path / "a.json", *(lines[::-1] if turned else lines), [(9e4, 0.0), (9e4, 9.0)])
    s, off, said = places.along(*fixes(*points), None, track, "trip")
    assert said == f"the track of {track}"
    np.testing.assert_allclose(off, across, atol=0.02)
    if where is None:  # 600 m up, then down by the slope
        slope = np.hypot(1000, 600)
        where = [100, 1300, 1600 + slope / 2, 1600 + slope + 500]
    np.testing.assert_allclose(s - s[0], np.array(where) - where[0], atol=0.1)
    assert turned or trip == "back" or s[0] == pytest.approx(where[0], abs=0.1)


def test_tracks_that_are_none_of_the_trip(tmp_path: Path) -> None:
    lat, lon = fixes((0.0, 0.0), (1.0, np.nan), (500.0, 0.0), (900.0, 0.0))
    gap = geojson(tmp_path / "gap.json", [A, (400.0, 0.0)], [(403.0, 0.0), B])
    with refused("the track's pieces do not connect where the recording begins with where it ends"):
        places.along(lat, lon, None, gap, "trip")
    joint = geojson(tmp_path / "joint.json", [A, (400.0, 0.0)], [(401.9, 0.0), B])
    assert places.along(lat, lon, None, joint, "trip")[0][[0, 2, 3]] == pytest.approx([0, 500, 900], abs=0.1)
    far = geojson(tmp_path / "far.json", [(0.0, 10_100.0), (1000.0, 10_100.0)])
    with refused(f"{far}: no line of it is within 10 km of the fixes (longitude before latitude in GeoJSON)"):
        places.along(lat, lon, None, far, "trip")
    near = geojson(tmp_path / "near.json", [(0.0, 9900.0), (1000.0, 9900.0)])
    assert places.along(lat, lon, None, near, "trip")[1][0] == pytest.approx(9900, abs=1)
    text = Path(joint).read_text()
    (tmp_path / "turned.json").write_text(json.dumps({"geometries": [{"type": "LineString", "coordinates": [
        point[::-1] for point in line]} for line in json.loads(text)["coordinates"]]}))
    with refused(f"{tmp_path}/turned.json: far from the fixes as they are mapped, near once latitude and longitude are "
                 "exchanged: latitude and longitude have changed places"):
        places.along(lat, lon, None, str(tmp_path / "turned.json"), "trip")
    for degrees, good in ((90, True), (90.5, False)):
        (tmp_path / "pole.json").write_text(json.dumps({"type": "LineString", "coordinates": [
            [0, degrees, 7], [1, 50, 7]]}))
        if good:
            assert places._lines(str(tmp_path / "pole.json"))[0].tolist() == [[0, 90], [1, 50]]
        else:
            with refused(f"{tmp_path}/pole.json: coordinates are no degrees: GeoJSON has longitude, latitude (WGS 84)"):
                places._lines(str(tmp_path / "pole.json"))
    lat[2], lon[2] = -91.0, 4.0
    with refused("trip: latitude -91, longitude 4 in row 3: degrees are needed, -90 .. 90 and -180 .. 180 (a "
                 "missing value: missing = [-91])"):
        places.along(lat, lon, None, None, "trip")
    lat[2] = np.nan
    with refused("trip: needs at least three fixes of latitude and longitude, but has 2"):
        places.along(lat, lon, None, None, "trip")


def test_the_own_path_of_fixes() -> None:
    """Its corners are 25 m and three deviations of both ends apart; the last fix is one."""
    lat, lon = fixes((0.0, 0.0), (24.0, 3.0), (30.0, 0.0), (30.0, 20.0), (30.0, 40.0), (33.0, 44.0))
    s, across, said = places.along(lat, lon, None, None, "trip")
    assert said == "the recording's own path"
    np.testing.assert_allclose(s, [0, 24, 30, 50, 70, 75], atol=0.01)
    np.testing.assert_allclose(across, [0, 3, 0, 0, 0, 0], atol=0.01)
    sure = places.along(lat, lon, np.array([9.0, 3.0, 9.0, np.nan, 1.0, 1.0]), None, "trip")[0]
    one, two = np.hypot(30, 20), np.hypot(3, 24)
    np.testing.assert_allclose(sure, [0, 780 / one, 900 / one, one, one + 480 / two, one + two], atol=0.01)
    still = places.along(*fixes(*[(0.0, 0.0)] * 3), None, None, "trip")
    assert still[0].tolist() == [0, 0, 0] == still[1].tolist()


def test_wheels_and_balises_of_a_few_rows() -> None:
    nan = np.nan
    found, said = {"wheel-a": np.array([0.0, 1.0, nan, 3.0]), "wheel-b": np.array([5.0, 6.0, 7.0, 8.0])}, list[str]()
    wheels.together("file", found, said)
    np.testing.assert_array_equal(found["wheel-b"], [5, 6, nan, 8])
    assert said == ["1 rows have a count of one wheel only: taken with the next of both"]
    wheels.together("file", {}, said)
    wheels.together("file", {"wheel-b": np.array([5.0, 6.0, nan, 6.0])}, said)
    assert len(said) == 1
    with refused("file: wheel-a and wheel-b have 2 rows in which all have a count; at least three are needed"):
        wheels.together("file", {"wheel-a": found["wheel-a"], "wheel-b": np.array([1.0, nan, 2.0, 3.0])}, said)
    with refused("file: wheel-b never counts: it needs two different readings"):
        wheels.together("file", {"wheel-b": np.ones(3)}, said)
    passed = wheels.passages(np.array([1.0, 1.0, 1.0, nan, 1.0, 2.0, 2.0, 3.0]), said)
    np.testing.assert_array_equal(passed, [1, nan, nan, nan, 1, 2, nan, 3])
    assert said[1:] == ["3 rows repeat the balise of the row before: taken as one passage"]
    distance, ends, begins = wheels.counted(np.arange(5.0), np.array([nan, 2.0, nan, 5.0, 9.0]))
    assert distance.tolist() == [0, 0, 3, 4] and ends.tolist() == [0, 0, 1, 1] and begins.tolist() == [1, 1, 0, 1]
    assert wheels.step_of(np.array([0.0, 0.6, nan, 1.5, 1.5])) == pytest.approx(0.3)


def test_places_of_balises() -> None:
    places_of = {"7": 10.0, "B 2": 20.0}
    for cells in (pa.array([7.0, None]), pa.array([7, None]), pa.array([" 7", "none"])):
        np.testing.assert_array_equal(wheels.placed(Table("f", pa.table({"b": cells}), ""), "b", places_of),
                                      [10.0, np.nan])
    unknown = Table("f", pa.table({"b": pa.array([*"abcdefg", "B 2"])}), "")
    with refused("plant.balises: f has a, b, c, d, e, f in \"b\" without a place (m); 2 balises have one"):
        wheels.placed(unknown, "b", places_of)

    def table(**columns: list[Any]) -> Table:
        return Table("f", pa.table({name.replace("__", " [km]"): pa.array(values) for name, values in columns.items()}),
                     "")

    assert wheels.balises_in(table(name=[" a", "b"], position__=[1.0, 2.5])) == {"a": 1000.0, "b": 2500.0}
    assert wheels.balises_in(table(km__=[1.0], name=[7])) == {"7": 1000.0}
    for given, said in ((table(name=["a"], km__=[1.0], s_m=[2.0]), "it has name, km [km], s_m"),
                        (table(name=["a"], place=[1.0]), "it has name, place")):
        with refused(f"plant.balises: f needs two columns, a name and a position with its unit (position_m, position "
                     f"[km]); {said}"):
            wheels.balises_in(given)
    for given, said in ((table(name=["a", "b", "a"], s_m=[1.0, 2.0, 3.0]), '"a" stands twice'),
                        (table(name=["a"], s_m=[float("nan")]), "a balise has no place")):
        with refused(f"plant.balises: f: {said}"):
            wheels.balises_in(given)


def test_wheels_are_heard_where_all_have_a_count() -> None:
    nan, said = np.nan, list[str]()
    found = {"wheel-a": np.array([0.0, 1.0, nan, 3.0, 4.0, nan]), "wheel-b": np.array([0.0, nan, 2.0, 3.0, 5.0, 6.0]),
             "speed": np.arange(6.0)}
    wheels.together("trip.csv", found, said)
    np.testing.assert_array_equal(found["wheel-a"], [0.0, nan, nan, 3.0, 4.0, nan])
    np.testing.assert_array_equal(found["wheel-b"], [0.0, nan, nan, 3.0, 5.0, nan])
    np.testing.assert_array_equal(found["speed"], np.arange(6.0))
    assert said == ["3 rows have a count of one wheel only: taken with the next of both"]
