"""Files of every kind that a recording may come in, sound and damaged: the table read from each, or what is said.

Also what each kind of column gives as numbers. All beside committed text (to renew it: `tests/expected.py`)."""

from __future__ import annotations

import bz2
import functools
import gzip
import io
import lzma
import operator
import re
import zipfile
from collections.abc import Callable
from datetime import datetime, timedelta
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import zstandard
from railstate.scenarios.recorded.columns import cells_of, decimal_sign, find_column, need_unit, numbers
from railstate.scenarios.recorded.readers import files
from railstate.scenarios.recorded.readers.reading import read
from railstate.scenarios.recorded.readers.table import Table
from railstate.scenarios.recorded.recording import Meaning, read_recording
from railstate.scenarios.recorded.times import ordered, seconds

from ..recordings import tram

PLAIN = "t [s],x [m]\n0,1.5\n1,2.5\n2,-4\n"


def zipped(**members: str) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, text in members.items():
            archive.writestr(name.replace("__", "/"), text)
    return file.getvalue()


def parquet(table: pa.Table) -> bytes:
    file = io.BytesIO()
    pq.write_table(table, file)
    return file.getvalue()


def nmea(*sentences: str) -> bytes:
    return "\r\n".join(f"${text}*{functools.reduce(operator.xor, text.encode()):02X}" if text else ""
                       for text in sentences).encode()


GGA = "GPGGA,235958.50,4717.11,N,00833.91,E,{quality},08,1.01,499.6,M,48.0,M,,"
GIVEN: dict[str, bytes] = {
    "plain.csv": PLAIN.encode(), "plain.csv.gz": gzip.compress(PLAIN.encode()), "a.bz2": bz2.compress(PLAIN.encode()),
    "a.xz": lzma.compress(PLAIN.encode()), "a.zst": zstandard.compress(PLAIN.encode()),
    "cut.gz": gzip.compress(PLAIN.encode() * 9)[:40], "cut.xz": lzma.compress(PLAIN.encode() * 9)[:60],
    "one.zip": zipped(folder__="", folder__a=PLAIN), "two.zip": zipped(a=PLAIN, b=PLAIN), "none.zip": zipped(),
    "sheet.xlsx": zipped(**{"[Content_Types].xml": "", "b": ""}), "cut.zip": zipped(a=PLAIN)[:50],
    "mark.csv": b"\xef\xbb\xbf" + PLAIN.encode(), "wide.csv": PLAIN.encode("utf-16"),
    "wide-le.csv": PLAIN.encode("utf-16-le"), "wide-be.csv": PLAIN.encode("utf-16-be"),
    "wide-cut.csv": PLAIN.encode("utf-16")[:-1], **{
        f"{x} of latin.csv": f"t;{'路' * (99 - x)}{'x' * x}\n0;1\n".encode("utf-16-le") for x in (70, 90)},
    "mark-only.csv": b"\xef\xbb\xbf\xff\xfe\xfa",
    "latin.csv": "Zeit [s];Höhe\n0;1\n1;2\n".encode("latin-1"), "latin-control.csv": b"t;H\xf6he\n0;\x01\n",
    "control.csv": b"t;x\n0;\x01\n", "nul.csv": b"t;x\n0;\0\n1;2\n", "empty.csv": b"", "blank.csv": b" \n\t\r\n",
    "comment.csv": b"# made by hand\n\n# t [s], x [m]\n0, 1\n1, 2\n", "comments-only.csv": b"# t, x\n#\n\n",
    "comment-names.csv": b"# made\nt;x\n0;1\n", "decimal-commas.csv": b"t;x\n0,5;1,25\n1,5;2\n",
    "tabs.csv": b"t\tx y\n0\t1\n1\t2\n", "bars.csv": b"t|x\n0|1\n", "spaces.csv": b"t   x\n0   1\n1  2\n",
    "quotes.csv": b't,"x, in m",w\n0,"1,5","a ""b"""\n1,2,c\n', "open-quote.csv": b't,x\n0,"1\n1,2\n',
    "short.csv": b"t,x,y\n0,1,2\n1,2\n", "long.csv": b"t,x\n0,1\n\n1,2,3\n", "trailing.csv": b"t,x\n0,1,\n1,2,\n",
    "half.csv": b"t;x;y\n0;1;2\n1;2\n", "twice.csv": b"t,x,x\n0,1,2\n", "unnamed.csv": b"t,,x\n0,1,2\n",
    "numbers.csv": b"0,1\n1,2\n2,3\n", "one-column.csv": b"t\n0\n1\n", "names-only.csv": b"t,x\n",
    "mac.csv": b"t,x\r0,1\r", "dollar.csv": b"$-speed;t\n1;2\n",
    "page.xml": b"<?xml version='1.0'?><html/>", "empty.gpx": b"<gpx></gpx>", "broken.gpx": b"<gpx><trk>",
    "level5.mat": b"MATLAB 5.0 MAT-file", "level7.mat": b"\x89HDF\r\n\x1a\n", "bag.db3": b"SQLite format 3\0",
    "wrong.parquet": PLAIN.encode(), "cut.pq": b"PAR1abc", "wrong.mcap": PLAIN.encode(), "wrong.mf4": b"MDX",
    "twice.parquet": parquet(pa.table([pa.array([1]), pa.array([2])], names=["a", "a"])),
    "index.parquet": parquet(pa.table({"x": [1.5, None], "list": [[1], [2]], "__index_level_0__": [7, 8]})),
    "both.parquet": parquet(pa.table({"index": [1], "__index_level_0__": [7]})),
    "a.nmea": nmea(GGA.format(quality=4), "GPVTG,054.7,T,034.4,M,005.5,N,010.2,K,A", "",
                   "GPRMC,235959.00,A,4717.12,N,00833.92,W,004.5,077.52,091202,,,A",
                   "GPGST,235959.00,1.8,,,,1.7,1.3,2.2", "GPGSV,1,1,00", "GPGLL,4717.13,S,00833.93,E,000000.00,A,A",
                   "GPRMC,000001.00,V,,,,,,,091202,,,N", "GPGLL,4717.14,N,00833.93,E,000002.00,V,A",
                   GGA.replace("235958.50", "000003.25").format(quality=0),
                   GGA.replace("235958.50", "").format(quality=1),
                   GGA.replace("235958.50", "000004.00").format(quality=9)) + (
                       b"\r\n$GPGGA,1*00\r\nnoise\r\n$GPGLL,4717.99,N,00833.99,E,000009.00,A,A\r\n"),
    "untimed.nmea": nmea("GPVTG,054.7,T,034.4,M,005.5,N,010.2,K,A"), "ship.nmea": b"!AIVDM,1,1,,A,x,0*00\n"}


def told(call: Callable[[], Any]) -> str:
    try:
        return str(call())
    except ValueError as error:
        return f"refused: {error}"


def shown(table: Table) -> str:
    return f"{table.said} {table.rows} {dict(table.units)} {table.columns.schema.types} {table.columns.to_pydict()}"


def test_files_of_every_kind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                             expected: Callable[[str, str], None]) -> None:
    monkeypatch.chdir(tmp_path)
    Path("folder").mkdir()
    out = []
    for name, data in GIVEN.items():
        Path(name).write_bytes(data)
    for name in [*GIVEN, "folder", "absent.csv", "nul\0.csv", "/dev/null"]:
        out.append(f"{name!r}: {told(lambda name=name: shown(read(name)))}")
    monkeypatch.setattr(files, "LARGEST", len(PLAIN))
    out.append(told(lambda: shown(read("plain.csv"))))
    monkeypatch.setattr(files, "LARGEST", len(PLAIN) - 1)
    out += [told(lambda name=name: shown(read(name))) for name in ("plain.csv", "plain.csv.gz")]
    expected("recording-files", "\n".join(out))


COLUMNS: dict[str, pa.Array] = {
    "integers": pa.array([1, None, -9999]), "floats": pa.array([1.5, None, float("nan"), -9999.0]),
    "infinite": pa.array([1.0, float("-inf")]), "truths": pa.array([True]), "decimals": pa.array([Decimal("1.25")]),
    "stamps": pa.array([datetime(2026, 1, 2)]), "spans": pa.array([timedelta(seconds=1)]), "bytes": pa.array([b"1"]),
    "words": pa.array(["1", " 2.5 ", "+3", "-4e2", ".5", "6.", "", None]), "none": pa.array(["nan", "NULL", "-", "1"]),
    "own none": pa.array(["Lost", "1", "-9999"]), "commas": pa.array(["1,5", "+2,25", "3"]), "hex": pa.array(["0x1f"]),
    "signs": pa.array(["1", "+-2"]), "huge": pa.array(["1", "1e999"]), "text": pa.array(["1", "fast", "2"]),
    "dictionary": pa.array(["1", "2", "1"]).dictionary_encode(), "infinity": pa.array(["1", "inf"])}


def test_columns_of_every_kind_as_numbers(expected: Callable[[str, str], None]) -> None:
    out = []
    for name, column in COLUMNS.items():
        table = Table("file", pa.table({name: column}), "")
        for missing, decimal in (((), "."), (("LOST ", -9999), ".")) + (((), ","),) * (name == "commas"):
            rules = cells_of(missing, decimal)
            out.append(f"{name} {decimal}{missing}: {told(lambda: numbers(table, name, rules).tolist())}")  # noqa: B023
    expected("recording-columns", "\n".join(out))


def column_table(*names: str, units: dict[str, str] | None = None, **columns: list[Any]) -> Table:
    return Table("file", pa.table({**{name: pa.array(["1"]) for name in names}, **columns}), "", units or {})


def test_which_column_a_role_means(expected: Callable[[str, str], None]) -> None:
    table = column_table("t_s", "v_kmh", "x [km]", "y (m)", "way in mi", "s", "kmh", "a", "p_sd_cm", "lat", "two [m]",
                         "two [km]", "given", "odd", units={"given": "mph", "odd": "furlong"})
    out = []
    for role, text in (("time", "t_s"), ("time", "-t_s"), ("time", "s"), ("speed", "v_kmh"), ("speed", "-v_kmh"),
                       ("speed", "v_kmh [m/s]"), ("speed", "v_kmh [ms]"), ("speed", "kmh"), ("position", "x [km]"),
                       ("position", "x"), ("position", "x (m)"), ("position", "y (m)"), ("position", "-y"),
                       ("position", "way in mi"), ("position", "two"), ("position", "two [m]"),
                       ("position", "none [m]"), ("position", "none"), ("acceleration", "a"), ("acceleration", "a [g]"),
                       ("speed", "given"), ("speed", "odd"), ("speed", "odd (m/s)"), ("position_sd", "p_sd_cm"),
                       ("position_sd", "-p_sd_cm"),
                       ("latitude", "lat"), ("latitude", "-lat")):
        found = told(lambda: find_column(table, role, text))  # noqa: B023
        unit = "" if found.startswith("refused") else told(
            lambda: need_unit(role, find_column(table, role, text), text))  # noqa: B023
        out.append(f"{role} = {text}: {found} {unit}")
    for columns in (["1,5", "2"], ["1.5", "2"], ["1", "2"], ["1,500", "2,000,000"], ["1,500", "2,5"], ["1.500,5"],
                    ["fast, then 1,5"], ["-,5"], ["0,125"]):
        for beside in ([], ["1.5"], ["1,25"]):
            both = column_table(x=columns, y=(beside * len(columns)) or [1.5] * len(columns))
            out.append(f"{columns} {beside}: {told(lambda: decimal_sign(both, both.names))}")  # noqa: B023
    expected("recording-roles", "\n".join(out))


TIMES: dict[str, Any] = {
    "ints": [5, None, 7], "milliseconds": [1_760_000_000_123, 1_760_000_000_456], "floats": [0.5, None, 2.0],
    "unix": [1.76e9, 1.76e9 + 0.5], "border": [6e8, 6e8 + 1], "beyond": [4e9, 4e9 + 1], "none": [None, None],
    "stamps": pa.array([datetime(2026, 1, 2), None, datetime(2026, 1, 2, 0, 0, 1, 250000)]),
    "zoned": pa.array([datetime(2026, 1, 2)], pa.timestamp("ms", "UTC")), "words": ["1.5", "2.25"],
    "iso": ["2026-03-29T01:59:59", "", "2026-03-29 02:00:00,5"], "dates": ["2026-01-02", "2026-01-03"],
    "utc": ["2026-03-29T01:59:59Z", "2026-03-29T02:00:01 UTC"],
    "offset": ["2026-03-29T01:59+01:00", "2026-03-29T03:01+02"],
    "some zone": ["2026-03-29T01:59:59Z", "2026-03-29T02:00:01"], "thirteen": ["2026-13-01T00:00"],
    "of day": ["23:59:59.5", "NaN", "00:00:01", "0:00:02,25"], "back in a day": ["10:00:00", "09:59:59"],
    "noon": ["12:00:01", "00:00:01", "12:00:00"], "words of time": ["10:00:00", "later"], "lost": ["Lost", "10:00:00"]}


def test_times_of_every_kind_and_their_order(expected: Callable[[str, str], None]) -> None:
    out = []
    for name, values in TIMES.items():
        table = column_table(t=values)
        for text in ("t", "t [s]", "t [ms]"):
            column = find_column(table, "time", text)
            found = told(lambda: seconds(table, column, text, cells_of(["lost"], ".")))  # noqa: B023
            out.append(f"{name} {text}: {' '.join(found.split())}")
    nan = float("nan")
    for time in ([0, 1, 2], [0, 2, 1, 3], [0, 1, 1, 2, 2], [0, 1, 0.5, 0.5], [0, nan, nan], [0, nan],
                 [7200, 7201, 3602, 3603], [7200, 7201, 3540, 3541], [7200, 7201, 3662, 3663], [0, 900, 1800, -1900]):
        for order in ("refuse", "sort"):
            for duplicates in ("refuse", "first", "mean"):
                found = told(lambda: ordered("file", np.array(time, dtype=float), order, duplicates))  # noqa: B023
                out.append(f"{time} {order} {duplicates}: {' '.join(found.split())}")
    expected("recording-times", "\n".join(out))


CANNOT: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("time=t_s latitude=s_gnss_m", "", {}), ("time=t_s position=s_gnss_m latitude=odo_m longitude=odo_m", "", {}),
    ("time=t_s speed=v_kmh", "", {}), ("position=s_gnss_m", "", {}),
    ("time=t_s position=s_gnss_m speed_sd=v_kmh", "", {}),
    ("time=t_s position=s_gnss_m position_sd=g_m", "g_m", {}), ("time=t_s position=s_gnss_m control=v_kmh [-]", "", {}),
    ("time=t_s position=s_gnss_m speed=v_kmh [furlong]", "", {}),
    ("time=t_s position=s_gnss_m odometer=odo_m", "dead", {}), ("time=t_s position=s_gnss_m odometer=odo_m", "few", {}),
    ("time=t_s position=s_gnss_m", "gone", {}), ("time=t_s position=s_gnss_m", "", {"span": (40.0, 30.0)}),
    ("time=t_s position=s_gnss_m", "", {"without": ((0.0, 9e9),)}),
    ("time=t_s position=s_gnss_m odometer=odo_m", "", {"wrap": 5.0}),
    ("time=t_s latitude=s_gnss_m longitude=odo_m", "", {}), ("time=t_s latitude=g_m longitude=g_m", "gone", {}),
    ("time=t_s latitude=g_m longitude=g_m", "near", {"track": "absent.geojson"}),
    *(("time=t_s latitude=g_m longitude=g_m", "near", {"track": track}) for track in (
        "", "[]", "{}", '{"type": "Point", "coordinates": [1, 2]}', '{"type": "LineString", "coordinates": [[1, 2]]}',
        '{"type": "LineString", "coordinates": [["a", 2], [3, 4]]}',
        '{"type": "LineString", "coordinates": [[1, 200], [3, 4]]}',
        '{"type": "MultiLineString", "coordinates": [[[1, 2], [3, 4]], [[50, 60], [51, 60]]]}')),
    ("time=t_s reference_position=s_ref_m wheel-a=odo_m", "dead", {}),
    ("time=t_s reference_position=s_ref_m wheel-a=odo_m wheel-b=g_m", "few", {}),
    ("time=t_s wheel-a=odo_m balise=g_m", "words", {}),
    ("time=t_s wheel-a=odo_m balise=g_m", "words", {"balises": "B.csv"}),
    ("time=t_s wheel-a=odo_m balise=g_m", "words", {"balises": (("a", 1.0),)}),
    ("time=t_s position=s_gnss_m position_sd=g_m", "words", {"quality": (("a", 1.0), ("c", 2.0))}))


def test_recordings_that_cannot_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                   expected: Callable[[str, str], None]) -> None:
    monkeypatch.chdir(tmp_path)
    nan, out = float("nan"), []
    for columns, change, options in CANNOT:
        table = tram().assign(g_m=0.0)
        if change == "g_m":
            table.loc[7, "g_m"] = -2.0
        elif change == "dead":
            table["odo_m"] = 4.0
        elif change == "few":
            table["odo_m"] = table["odo_m"].where(table.index < 2)
        elif change == "gone":
            table[["s_gnss_m", "g_m"]] = nan
        elif change == "near":
            table["g_m"] = 47 + 1e-5 * table.index
        elif change == "words":
            table["g_m"] = np.where(table.index % 9 == 1, "a", np.where(table.index % 9 == 2, "b", ""))
        table.to_csv("trip.csv", index=False)
        given = dict(options)
        if "track" in given and given["track"] != "absent.geojson":
            Path("track.geojson").write_text(given["track"])
            given["track"] = "track.geojson"
        roles = tuple(sorted(tuple(part.split("=")) for part in re.split(r" (?=[\w-]+=)", columns)))
        found = told(lambda: read_recording("trip.csv", Meaning(roles, **given)).said)  # noqa: B023
        out.append(f"{columns} {change} {options}: {found}")
    expected("recordings-that-cannot-be", "\n".join(out))
