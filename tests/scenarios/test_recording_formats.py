"""Formats other than text tables, each written here by the format's own package and read back."""

from __future__ import annotations

import json
import re
import sys

import numpy as np
import pandas as pd
import pytest
from railstate.scenarios.recorded.inspecting import suggested
from railstate.scenarios.recorded.readers import read
from railstate.scenarios.recorded.recording import table_at

from tests.recordings import fixes, ride, tram
from tests.scenarios.test_recording_reading import MAP, refused, same
from tests.scenarios.test_recording_reading import read as recording


@pytest.fixture
def plain(tmp_path):
    tram().to_csv(tmp_path / "plain.csv", index=False)
    return recording(tmp_path / "plain.csv")


def test_parquet_is_read_as_csv_is(tmp_path, plain):
    table = tram()
    table["odo_m"] = table.odo_m.astype(int)
    table["list"] = [[1.0]] * len(table)
    table.to_parquet(tmp_path / "trip.parquet")
    found = recording(tmp_path / "trip.parquet")
    assert same(found, plain) and "read as: Parquet" in found.said[0]
    assert "list" not in read(str(tmp_path / "trip.parquet")).names


def gpx(table: pd.DataFrame) -> str:
    points = "".join(f'<trkpt lat="{row.latitude:.8f}" lon="{row.longitude:.8f}"><ele>12.5</ele><time>{row.time}</time>'
                     "</trkpt>" for row in table.itertuples())
    return ('<?xml version="1.0"?><gpx version="1.1" creator="x" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>'
            f"{points}</trkseg></trk></gpx>")


def test_gpx(tmp_path):
    table = fixes()
    (tmp_path / "trip.gpx").write_text(gpx(table))
    found = read(str(tmp_path / "trip.gpx"))
    assert found.names == ["time", "latitude", "longitude", "elevation [m]"] and found.rows == len(table)
    assert suggested(found).map == {"time": "time", "latitude": "latitude", "longitude": "longitude"}
    table.to_csv(tmp_path / "trip.csv", index=False)
    columns = {"time": "time", "latitude": "latitude", "longitude": "longitude"}
    a, b = recording(tmp_path / "trip.gpx", columns), recording(tmp_path / "trip.csv", columns)
    assert np.array_equal(a.measured["position"], b.measured["position"]) and np.array_equal(a.time, b.time)
    (tmp_path / "bad.gpx").write_text("<?xml version='1.0'?><gpx><trk>")
    assert "not a GPX file" in refused(tmp_path / "bad.gpx")
    (tmp_path / "none.gpx").write_text("<?xml version='1.0'?><gpx xmlns='http://www.topografix.com/GPX/1/1'></gpx>")
    assert "without track points" in refused(tmp_path / "none.gpx")


def sentence(body: str) -> str:
    check = 0
    for letter in body:
        check ^= ord(letter)
    return f"${body}*{check:02X}"


def nmea(table: pd.DataFrame) -> list[str]:
    """GGA and RMC of each fix, through midnight."""
    lines = []
    for k, row in enumerate(table.itertuples()):
        of_day = (86400 - 60 + 0.5 * k) % 86400
        stamp = f"{int(of_day // 3600):02d}{int(of_day // 60 % 60):02d}{of_day % 60:05.2f}"
        lat, lon = (f"{int(value):0{width}d}{60 * (value % 1):010.7f}" for value, width in (
            (row.latitude, 2), (row.longitude, 3)))
        quality = {"NARROW_INT3": 4, "SINGLE": 1, "PROPAGATED": 0}[row.fix]
        lines.append(sentence(f"GNGGA,{stamp},{lat},N,{lon},E,{quality},12,0.8,45.4,M,46.9,M,,"))
        lines.append(sentence(f"GNRMC,{stamp},A,{lat},N,{lon},E,{10 + k % 3:.1f},84.4,010325,,,A"))
        lines.append(sentence("GNGSV,1,1,01,40,083,046,41"))
    return lines


def test_nmea(tmp_path):
    table = fixes()
    lines = nmea(table)
    (tmp_path / "trip.nmea").write_text("\r\n".join([*lines, "$GNGGA,broken*00"]))
    found = read(str(tmp_path / "trip.nmea"))
    assert found.rows == len(table) and "1 lines with a wrong checksum left out" in found.said
    columns = found.columns.to_pandas()
    assert np.allclose(np.diff(columns["time [s]"]), 0.5)
    assert np.allclose(columns["latitude"], table.latitude, atol=2e-9)
    assert set(columns["fix"]) == {"RTK fixed", "GNSS", "none"}
    guess = suggested(found)
    assert guess.map == {"time": "time [s]", "latitude": "latitude", "longitude": "longitude", "speed": "speed [kn]",
                         "position_sd": "fix"}
    assert guess.quality == {"RTK fixed": 0.05, "GNSS": 3.0, "none": "missing"}
    (tmp_path / "none.nmea").write_text("\n".join(lines[2:3] * 4))
    assert "no NMEA sentence with a time" in refused(tmp_path / "none.nmea")


def test_mcap_with_json_and_with_ros_2(tmp_path):
    from mcap.writer import Writer
    from mcap_ros2.writer import Writer as Ros2
    true = ride()
    with (tmp_path / "json.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("Odometry", "jsonschema", b"{}")
        speed, gnss = (writer.register_channel(topic, "json", schema) for topic in ("/speed", "/gnss"))
        for k, row in enumerate(true.itertuples()):
            stamp = int(1e9 * row.t_s)
            writer.add_message(speed, stamp, json.dumps({"v": row.v_mps, "valid": True}).encode(), stamp)
            if k % 5 == 0:
                writer.add_message(gnss, stamp, json.dumps({"position": {"s": row.s_m}}).encode(), stamp)
        writer.finish()
    with (tmp_path / "ros.mcap").open("wb") as file:
        writer = Ros2(file)
        schema = writer.register_msgdef("test_msgs/Speed", "float64 v\nbool valid\n")
        place = writer.register_msgdef("test_msgs/Place", "test_msgs/Point position\n" + "=" * 80
                                       + "\nMSG: test_msgs/Point\nfloat64 s\n")
        for k, row in enumerate(true.itertuples()):
            stamp = int(1e9 * row.t_s)
            writer.write_message("/speed", schema, {"v": row.v_mps, "valid": True}, stamp, stamp)
            if k % 5 == 0:
                writer.write_message("/gnss", place, {"position": {"s": row.s_m}}, stamp, stamp)
        writer.finish()
    columns = {"time": "log_time [ns]", "position": "/gnss.position.s [m]", "speed": "/speed.v [m/s]"}
    for name in ("json.mcap", "ros.mcap"):
        found = recording(tmp_path / name, columns)
        assert np.allclose(found.time, true.t_s, atol=1e-9) and np.array_equal(found.measured["speed"], true.v_mps)
        assert np.array_equal(found.measured["position"][::5], true.s_m[::5])
        assert np.isnan(found.measured["position"]).sum() == len(true) - len(true[::5])
    (tmp_path / "cut.mcap").write_bytes((tmp_path / "json.mcap").read_bytes()[:200])
    assert re.search(r"cut\.mcap: not an MCAP log that can be read: \w+: \w+", refused(tmp_path / "cut.mcap"))


def test_rosbag2(tmp_path):
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore
    store, true = get_typestore(Stores.ROS2_HUMBLE), ride()
    number = store.types["std_msgs/msg/Float64"]
    with Writer(tmp_path / "bag", version=9) as writer:
        place, speed = (writer.add_connection(topic, number.__msgtype__, typestore=store) for topic in ("/s", "/v"))
        for row in true.itertuples():
            for connection, value in ((place, row.s_m), (speed, row.v_mps)):
                writer.write(connection, int(1e9 * row.t_s), store.serialize_cdr(number(value), number.__msgtype__))
    columns = {"time": "log_time [ns]", "position": "/s.data [m]", "speed": "/v.data [m/s]"}
    found = recording(tmp_path / "bag", columns)
    assert np.array_equal(found.measured["position"], true.s_m) and np.array_equal(found.measured["speed"], true.v_mps)
    database = next((tmp_path / "bag").glob("*.db3"))
    assert "name its folder" in refused(database, columns)
    database.write_bytes(b"no database")
    assert "not a rosbag2 that can be read" in refused(tmp_path / "bag", columns)


def test_mf4(tmp_path):
    from asammdf import MDF, Signal
    true = ride(0.1)
    with MDF() as measured:
        measured.append([Signal(3.6 * true.v_mps.to_numpy(), true.t_s.to_numpy(), name="VehSpd", unit="km/h")])
        measured.append([Signal(true.s_m.to_numpy()[::10], true.t_s.to_numpy()[::10], name="Dist", unit="m")])
        measured.save(tmp_path / "trip.mf4")
    found = recording(tmp_path / "trip.mf4", {"time": "time [s]", "position": "Dist", "speed": "VehSpd"})
    assert np.allclose(found.measured["speed"], true.v_mps) and len(found.time) == len(true)
    assert np.allclose(found.measured["position"][::10], true.s_m[::10])
    (tmp_path / "cut.mf4").write_bytes((tmp_path / "trip.mf4").read_bytes()[:300])
    assert "cut.mf4: " in refused(tmp_path / "cut.mf4", {"time": "time [s]", "position": "Dist"})


def test_what_an_extra_lacks_is_said(tmp_path, monkeypatch):
    (tmp_path / "trip.gpx").write_text(gpx(fixes().head(5)))
    monkeypatch.setitem(sys.modules, "gpxpy", None)
    monkeypatch.delitem(sys.modules, "railstate.scenarios.recorded.readers.gpx", raising=False)
    assert "needs gpxpy" in refused(tmp_path / "trip.gpx") and "railstate[recordings]" in refused(tmp_path / "trip.gpx")


def test_a_file_that_changes_is_read_again(tmp_path):
    tram(1).to_csv(tmp_path / "trip.csv", index=False)
    first = recording(tmp_path / "trip.csv", MAP)
    tram(2).to_csv(tmp_path / "trip.csv", index=False)
    assert not np.array_equal(first.measured["speed"], recording(tmp_path / "trip.csv", MAP).measured["speed"])
    assert table_at(str(tmp_path / "trip.csv")) is table_at(str(tmp_path / "trip.csv"))
