"""How recordings are read: encodings, delimiters, decimals, names with units, times; what is refused, and the words."""

from __future__ import annotations

import bz2
import gzip
import lzma
import os
import subprocess
import sys
import zipfile

import numpy as np
import pandas as pd
import pytest
from pydantic import ValidationError
from railstate.scenarios.recorded.config import Plant
from railstate.scenarios.recorded.recording import Recording

from tests.recordings import ride, tram

MAP = {"time": "t_s", "position": "s_gnss_m", "speed": "v_kmh", "odometer": "odo_m", "acceleration": "acc_mps2",
       "reference_position": "s_ref_m", "reference_speed": "v_ref_mps"}


def read(path, columns=MAP, **options) -> Recording:
    return Plant.model_validate({"kind": "recorded", "recording": str(path), "map": columns, **options}).recorded()[0]


def refused(path, columns=MAP, **options) -> str:
    with pytest.raises(ValidationError) as caught:
        read(path, columns, **options)
    message = caught.value.errors()[0]["msg"]
    assert "\n" not in message
    return message


def same(found: Recording, expected: Recording) -> bool:
    if set(found.measured) != set(expected.measured) or not np.allclose(found.time, expected.time, atol=1e-6):
        return False
    pairs = [(found.measured[name], expected.measured[name]) for name in found.measured]
    return all(np.allclose(*pair, rtol=1e-12) for pair in (
        *pairs, (found.position, expected.position), (found.speed, expected.speed)))


@pytest.fixture
def plain(tmp_path) -> Recording:
    tram().to_csv(tmp_path / "plain.csv", index=False)
    return read(tmp_path / "plain.csv")


@pytest.mark.parametrize(("options", "said"), [
    ({}, "commas, UTF-8"), ({"sep": ";"}, "semicolons"), ({"sep": "\t"}, "tabs"), ({"sep": "|"}, "bars"),
    ({"sep": " "}, "spaces"), ({"sep": ";", "decimal": ","}, "semicolons, UTF-8, decimal commas"),
    ({"decimal": ",", "quoting": 1}, "commas, UTF-8, decimal commas"), ({"lineterminator": "\r\n"}, "commas"),
    ({"lineterminator": "\r"}, "commas"), ({"encoding": "utf-8-sig"}, "UTF-8 with byte-order mark"),
    ({"encoding": "utf-16"}, "UTF-16"), ({"encoding": "utf-16-le"}, "UTF-16"), ({"encoding": "utf-32"}, "UTF-32"),
    ({"quoting": 1}, "commas"), ({"index": True}, "commas")])
def test_kin_of_csv_are_read_and_said(tmp_path, plain, options, said):
    tram().to_csv(tmp_path / "trip.txt", **{"index": False, **options})
    found = read(tmp_path / "trip.txt")
    assert same(found, plain)
    assert said in found.said[0]


def test_latin_1_comments_and_blank_lines(tmp_path, plain):
    text = tram().assign(général="là").to_csv(index=False)
    (tmp_path / "trip.csv").write_bytes(("# logger 7\n#\n" + text.replace("\n", "\n\n", 3)).encode("latin-1"))
    found = read(tmp_path / "trip.csv")
    assert same(found, plain) and "Latin-1" in found.said[0]
    np.savetxt(tmp_path / "numpy.txt", tram().to_numpy(), header=" ".join(tram().columns))
    assert same(read(tmp_path / "numpy.txt"), plain)


@pytest.mark.parametrize("kind", ["gzip", "bzip2", "xz", "zip", "zstd"])
def test_what_is_packed_is_unpacked_and_said(tmp_path, plain, kind):
    data, path = tram().to_csv(index=False).encode(), tmp_path / "trip.csv"
    if kind == "zip":
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("inside.csv", data)
    elif kind == "zstd":
        import zstandard
        path.write_bytes(zstandard.ZstdCompressor().compress(data))
    else:
        path.write_bytes({"gzip": gzip, "bzip2": bz2, "xz": lzma}[kind].compress(data))
    found = read(path)
    assert same(found, plain) and kind in found.said[0]
    if kind == "gzip":
        path.write_bytes(path.read_bytes()[:-20])
        assert "compressed file is damaged" in refused(path)


@pytest.mark.parametrize(("change", "message"), [
    (lambda t: t.replace("\n", ",\n").replace(",\n", "\n", 1), "line 2 has 8 fields, but there are 7 names (decimal"),
    (lambda t: t.replace("10.0,", "10,0,", 1), "fields, but there are 7 names (decimal commas"),
    (lambda t: t[:-10], "(cut off?)"),
    (lambda t: t.replace("odo_m", "v_kmh", 1), 'two columns are called "v_kmh": names must differ'),
    (lambda t: t[t.index("\n") + 1:], "the first row holds numbers (0.0, "),
    (lambda t: t.replace("10.0,", '"10.0,', 1), "a quote is opened and not closed in that line"),
    (lambda t: t.replace("\n3.0,", '\n"3.0,', 1).replace("\n6.0,", '\n6.0",', 1), "line 5: a quote is opened"),
    (lambda t: t.replace("10.0,", "\0,", 1), "not a text table: it holds NUL bytes"),
    (lambda t: t.replace("10.0,", "\x02,", 1), "not a text table: it holds control characters"),
    (lambda t: "", "not a CSV table: the file is empty"), (lambda t: "hello\nworld\n", "no delimiter found"),
    (lambda t: "<kml></kml>", "is XML, but no GPX")])
def test_texts_that_are_no_table_are_refused(tmp_path, change, message):
    (tmp_path / "trip.csv").write_text(change(tram().to_csv(index=False)))
    assert message in refused(tmp_path / "trip.csv")


@pytest.mark.parametrize(("change", "message"), [
    (lambda t: t.assign(v_kmh=t.v_kmh.map(lambda v: f"{v:.2f}".replace(".", ","))), "one file, one decimal sign"),
    (lambda t: t.assign(odo_m=t.odo_m.map(lambda v: f"{v:,.1f}")), "with comma and point"),
    (lambda t: pd.DataFrame({"t_s": range(9), "s_gnss_m": 1, "odo_m": [f"{v:,}" for v in range(3000, 3009)]}),
     "decimal comma or thousands cannot be told"),
    (lambda t: t.assign(odo_m=t.odo_m.map(lambda v: f"{v} m")), "not numeric: row 1 has '3760.0 m'"),
    (lambda t: t.assign(odo_m=t.odo_m.where(t.index != 7, np.inf)), "not numeric: row 8 has 'inf'")])
def test_numbers_that_are_none_are_refused(tmp_path, change, message):
    change(tram()).to_csv(tmp_path / "trip.csv", index=False, sep=";")
    columns = {"time": "t_s", "position": "s_gnss_m", "odometer": "odo_m"}
    table = pd.read_csv(tmp_path / "trip.csv", sep=";")
    assert message in refused(tmp_path / "trip.csv", {**columns, **({"speed": "v_kmh"} if "v_kmh" in table else {})})


@pytest.mark.parametrize(("name", "text", "factor"), [
    ("speed [km/h]", "speed [km/h]", 3.6), ("v (m/s)", "v (m/s)", 1), ("v in km/h", "v in km/h", 3.6),
    ("speed [km/h]", "speed", 3.6), ("v", "v [km/h]", 3.6), ("v", "v (mph)", 3600 / 1609.344),
    ("v_kn", "v_kn", 3600 / 1852)])
def test_units_in_names(tmp_path, plain, name, text, factor):
    table = tram()
    table = table.assign(**{name: table.v_kmh / 3.6 * factor}).drop(columns=["v_kmh"])
    table.to_csv(tmp_path / "trip.csv", index=False)
    found = read(tmp_path / "trip.csv", {**MAP, "speed": text})
    assert found.measured["speed"] == pytest.approx(plain.measured["speed"], rel=1e-12)


def iso(zone):
    """The times of the tram in a night in which summer time ends (an hour stands twice on a wall's clock)."""
    stamps = pd.Timestamp("2025-10-26T02:58:30+02:00") + pd.to_timedelta(tram().t_s, unit="s")
    return [stamp.tz_convert(zone).isoformat() for stamp in stamps]


@pytest.mark.parametrize(("values", "text", "kind"), [
    (lambda t: (1000 * t).astype(int), "t_ms", "units of 0.001 s"), (lambda t: t + 1_740_816_217, "x [s]", "unix time"),
    (lambda t: (1000 * t).astype(int) + 1_740_816_217_000, "x [ms]", "unix time"),
    (lambda t: (1e9 * t).astype("int64") + 1_740_816_217_000_000_000, "x [ns]", "unix time"),
    (lambda t: iso("UTC"), "time", "ISO 8601 with zone"),
    (lambda t: iso("Europe/Brussels"), "time", "ISO 8601 with zone"),
    (lambda t: pd.Timestamp("2025-03-01 08:00") + pd.to_timedelta(t, unit="s"), "time", "ISO 8601 without zone"),
    (lambda t: (pd.Timestamp("2025-03-01 23:59") + pd.to_timedelta(t, unit="s")).dt.strftime("%H:%M:%S.%f"), "time",
     "times of day")])
@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_times(tmp_path, plain, values, text, kind, suffix):
    name = text.partition(" [")[0]
    table = tram()
    table = table.assign(**{name: values(table.t_s)}).drop(columns=["t_s"])
    if suffix == "csv":
        table.to_csv(tmp_path / "trip.csv", index=False)
    else:
        table.to_parquet(tmp_path / "trip.parquet")
        kind = kind.replace("ISO 8601 without zone", "dates and times without zone")
    found = read(tmp_path / f"trip.{suffix}", {**MAP, "time": text})
    assert found.time == pytest.approx(plain.time, abs=1e-6) and kind in found.said[0]


@pytest.mark.parametrize("zone", [None, "UTC", "Europe/Brussels"])
def test_pandas_index_in_parquet(tmp_path, plain, zone):
    table = tram()
    stamps = pd.Timestamp("2025-03-01", tz=zone) + pd.to_timedelta(table.t_s, unit="s")
    table.drop(columns="t_s").set_index(pd.DatetimeIndex(stamps).rename(None)).to_parquet(tmp_path / "trip.parquet")
    assert same(read(tmp_path / "trip.parquet", {**MAP, "time": "index"}), plain)


@pytest.mark.parametrize(("change", "message"), [
    (lambda s: s.where(s.index != 5, "yesterday"), "row 6 has 'yesterday'; allowed: numbers with a unit, or ISO 8601"),
    (lambda s: s.where(s.index != 5, "2025-10-26T00:58:35"), "row 6 has no zone, others have one"),
    (lambda s: s.where(s.index != 5, "2025-13-26T00:58:35Z"), "time \"time\": "),
    (lambda s: s.where(s.index != 5), "the time is missing in row 6"),
    (lambda s: pd.Series(iso("Europe/Brussels")).str[:-6], "an hour back (a clock change? times with a zone"),
    (lambda s: s.iloc[::-1].reset_index(drop=True), "time must increase"),
    (lambda s: s.where(s.index != 5, s[4]), 'stands twice (row 6; 1 rows repeat a time): duplicates = "first"')])
def test_times_that_are_none_are_refused(tmp_path, change, message):
    tram().assign(time=change(pd.Series(iso("UTC")))).to_csv(tmp_path / "trip.csv", index=False)
    assert message in refused(tmp_path / "trip.csv", {**MAP, "time": "time"})


@pytest.mark.parametrize(("columns", "message"), [
    ({**MAP, "altitude": "z_m"}, "map.altitude: no such role; allowed: time, position"),
    ({**MAP, "speed": "v"}, 'has no column "v"; it has t_s'),
    ({**MAP, "speed": "v_kmh [furlong]"}, 'the unit of "v_kmh [furlong]" is unknown; allowed: m/s, mps, km/h'),
    ({"position": "s_gnss_m"}, "map: needs time and position"), ({"time": "t_s"}, "map: needs time and position"),
    ({**MAP, "latitude": "s_ref_m"}, "latitude and longitude go together"),
    ({**MAP, "odometer": "odd"}, 'the unit of "odd" is unknown; end the column\'s name in a unit (_m, _km'),
    ({"time": "t_s", "position": "s_ref_m", "speed_sd": "v_ref_mps"}, "how good speed is, which is not mapped")])
def test_maps_that_cannot_be(tmp_path, columns, message):
    tram().assign(odd=1.0).to_csv(tmp_path / "trip.csv", index=False)
    assert message in refused(tmp_path / "trip.csv", columns)


def test_what_is_no_regular_file_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    assert "is no regular file but a pipe or a device" in refused(tmp_path / "pipe.csv")
    assert "is no regular file" in refused("/dev/zero")
    assert "is a folder" in refused(tmp_path)
    assert "cannot be read: No such file" in refused(tmp_path / "none.csv")
    assert "cannot be read" in refused("nul\0.csv")
    (tmp_path / "trip.parquet").write_text("not parquet")
    assert "not a Parquet table" in refused(tmp_path / "trip.parquet")
    (tmp_path / "cut.parquet").write_bytes(b"PAR1 and no more")
    assert "not a Parquet table" in refused(tmp_path / "cut.parquet")
    (tmp_path / "book.xlsx").write_bytes(b"")
    with zipfile.ZipFile(tmp_path / "book.xlsx", "w") as archive:
        archive.writestr("[Content_Types].xml", "<x/>")
    assert "is a spreadsheet: save its sheet as CSV" in refused(tmp_path / "book.xlsx")


def test_parts_are_taken_and_left_out_and_said(tmp_path, plain):
    found = read(tmp_path / "plain.csv", span=[20.0, 100.0], without=[[40.0, 60.0]])
    t = plain.time
    assert np.array_equal(found.time, t[(t >= 20) & (t <= 100) & ((t < 40) | (t > 60))])
    assert "123 of 184 rows left out" not in found.said and any("rows left out" in text for text in found.said)
    assert "from < to" in refused(tmp_path / "plain.csv", without=[[5.0, 5.0]])
    assert "leave no row" in refused(tmp_path / "plain.csv", span=[1000.0, 2000.0])


def test_the_ride_is_one_that_a_train_can_make():
    true = ride(0.05)
    assert true.a_mps2.abs().max() <= 0.96 and true.v_mps.min() >= 0
    assert np.abs(np.diff(true.s_m)).max() < 0.05 * 15


@pytest.mark.long
def test_a_million_rows_in_two_seconds_of_processor_time_and_500_megabytes(tmp_path):
    """A day at 10 Hz and more, in a process of its own: read, checked and ready, all of its rows."""
    n = 1_000_000
    t = 0.1 * np.arange(n)
    v = 10 + 8 * np.sin(t / 40)
    s = np.cumsum(0.1 * v)
    noise = np.random.default_rng(1).normal(0, 1, n)
    pd.DataFrame({"t_s": t, "s_gnss_m": s + noise, "v_kmh": 3.6 * v, "odo_m": 0.97 * s, "s_ref_m": s, "v_ref_mps": v}
                 ).round(3).to_csv(tmp_path / "day.csv", index=False)
    columns = {role: name for role, name in MAP.items() if role != "acceleration"}
    child = ("import resource, sys, time\n"
             "from railstate.scenarios.recorded.recording import Meaning, read_recording\n"
             "begin = time.process_time()\n"
             f"found = read_recording({str(tmp_path / 'day.csv')!r}, Meaning({tuple(sorted(columns.items()))!r}))\n"
             "print(len(found.time), len(found.findings), time.process_time() - begin, "
             "resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3)")
    done = subprocess.run([sys.executable, "-c", child], capture_output=True, text=True, check=True)
    rows, findings, seconds, megabytes = map(float, done.stdout.split())
    print(f"1e6 rows: {seconds:.2f} s, {megabytes:.0f} MB")
    assert (rows, findings) == (n, 0) and seconds < 2 and megabytes < 500
