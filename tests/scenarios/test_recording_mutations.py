"""Recordings spoilt in 526 ways: each is refused in one line, or read as what it is, or what is wrong with it is said.

The script is seeded: mutation k is always the same file. A sample runs by default, all with --long."""

from __future__ import annotations

import bz2
import gzip
import io
import json
import zipfile
from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest
from pydantic import ValidationError
from railstate.scenarios.recorded.config import Plant
from railstate.scenarios.recorded.recording import Meaning, Recording, read_recording

from tests.recordings import tram
from tests.scenarios.test_recording_reading import MAP

COUNT, SAMPLED = 526, 9
Rng = np.random.Generator
READINGS = ["s_gnss_m", "v_kmh", "odo_m", "acc_mps2", "s_ref_m", "v_ref_mps"]


def csv(table: pd.DataFrame, **options) -> bytes:
    return table.to_csv(index=False, **options).encode()


def cell(value: str | Callable[[str], str], columns=READINGS) -> Callable[[Rng], bytes]:
    """The tram with one cell replaced."""
    def mutate(rng: Rng) -> bytes:
        table = tram().astype(str)
        row, column = rng.integers(5, len(table) - 5), rng.choice(columns)
        table.loc[row, column] = value(table.loc[row, column]) if callable(value) else value
        return csv(table)
    return mutate


def line(change: Callable[[str, Rng], str]) -> Callable[[Rng], bytes]:
    """The tram's text with one row changed."""
    def mutate(rng: Rng) -> bytes:
        rows = csv(tram()).decode().split("\n")
        k = int(rng.integers(2, len(rows) - 2))
        rows[k] = change(rows[k], rng)
        return "\n".join(rows).encode()
    return mutate


def frame(change: Callable[[pd.DataFrame, Rng], pd.DataFrame], **options) -> Callable[[Rng], bytes]:
    return lambda rng: csv(change(tram(), rng), **options)


def comma(rng: Rng) -> bytes:
    """A file of semicolons and points with one decimal comma."""
    spoilt = cell(lambda v: f"{float(v):.2f}".replace(".", ":"))(rng)
    return spoilt.replace(b",", b";").replace(b":", b",")


def scaled(columns: list[str], factor: float) -> Callable[[Rng], bytes]:
    return frame(lambda t, rng: t.assign(**{name: factor * t[name] for name in [rng.choice(columns)]}))


def held(table: pd.DataFrame, rng: Rng) -> pd.DataFrame:
    """A reading that stands still to the last digit for 40 s while the train moves at full speed."""
    name, begin = rng.choice(["s_gnss_m", "v_kmh", "v_ref_mps", "s_ref_m"]), int(rng.integers(28, 34))
    table.loc[begin:begin + 34, name] = table.loc[begin, name]
    return table


def leap(table: pd.DataFrame, rng: Rng) -> pd.DataFrame:
    """A place, its reference or the odometer a kilometre off for some seconds, or from there on."""
    name, begin = rng.choice(["s_gnss_m", "s_ref_m", "odo_m"]), int(rng.integers(20, 150))
    end = begin + int(rng.integers(1, 10)) if name != "odo_m" and rng.random() < 0.5 else len(table)
    table.loc[begin:end, name] += rng.uniform(900, 4000) * (1 if name == "odo_m" else rng.choice([-1, 1]))
    return table


def turned(table: pd.DataFrame, rng: Rng) -> pd.DataFrame:
    k = int(rng.integers(60, 150))
    table.loc[k:, "odo_m"] -= rng.choice([30.0, 60.0])
    return table


def repeated(table: pd.DataFrame, rng: Rng) -> pd.DataFrame:
    k = int(rng.integers(1, len(table) - 1))
    return pd.concat([table[:k], table[k - 1:k], table[k:]])


def exchanged(one: str, other: str) -> Callable[[Rng], bytes]:
    return frame(lambda t, rng: t.rename(columns={one: other, other: one}))


def fallen(time: pd.Series, rng: Rng, by: float) -> pd.Series:
    return time.where(time < rng.integers(50, 150), time + by)


def unix(time: pd.Series, rng: Rng) -> pd.Series:
    return (1000 * time).astype("int64") + 1_740_816_217_000 + rng.integers(1e6)


def clock(change: Callable[[pd.Series, Rng], object]) -> Callable[[Rng], bytes]:
    return frame(lambda t, rng: t.assign(t_s=change(t.t_s, rng)))


def stamps(zone: str, strip: bool, table: pd.DataFrame) -> list[str]:
    found = pd.Timestamp("2025-10-26T02:58:30+02:00") + pd.to_timedelta(table.t_s, unit="s")
    text = [stamp.tz_convert(zone).isoformat(timespec="milliseconds") for stamp in found]
    return [one[:-6] for one in text] if strip else text


def zipped(data: bytes) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("a.csv", data)
    return out.getvalue()


def shuffled(rng: Rng) -> bytes:
    table = tram()
    return csv(table.sample(frac=1, random_state=int(rng.integers(1 << 30))))


SAME = {  # the same trip, written otherwise: must come out the same, or be refused
    "semicolons": frame(lambda t, r: t, sep=";"), "tabs": frame(lambda t, r: t, sep="\t"),
    "bars": frame(lambda t, r: t, sep="|"), "spaces": frame(lambda t, r: t, sep=" "),
    "decimal commas": frame(lambda t, r: t, sep=";", decimal=","),
    "tabs and commas": frame(lambda t, r: t, sep="\t", decimal=","),
    "quoted": frame(lambda t, r: t, quoting=1), "quoted commas": frame(lambda t, r: t, decimal=",", quoting=1),
    "windows": frame(lambda t, r: t, lineterminator="\r\n"), "old mac": frame(lambda t, r: t, lineterminator="\r"),
    "utf-8-sig": lambda r: b"\xef\xbb\xbf" + csv(tram()), "utf-16": lambda r: csv(tram()).decode().encode("utf-16"),
    "utf-16-le": lambda r: csv(tram()).decode().encode("utf-16-le"),
    "utf-32": lambda r: csv(tram()).decode().encode("utf-32"),
    "latin-1": lambda r: csv(tram().assign(é="ü")).decode().encode("latin-1"),
    "gzip": lambda r: gzip.compress(csv(tram())),
    "bzip2": lambda r: bz2.compress(csv(tram())), "zip": lambda r: zipped(csv(tram())),
    "columns in another order": frame(lambda t, r: t[r.permutation(t.columns)]),
    "spaces around": lambda r: csv(tram()).replace(b",", b" , "),
    "more columns": frame(lambda t, r: t.assign(x="a;b", y="1,5")),
    "exponents": frame(lambda t, r: t.map(lambda v: f"{v:.12e}")),
    "plus signs": cell(lambda v: v if v[0] == "-" else f"+{v}"),
    "comment": lambda r: b"# logger\n" + csv(tram()), "empty line": line(lambda row, r: row + "\n"),
    "space in a cell": cell(lambda v: f" {v} ")}
MISSING = {name: cell(text) for name, text in (  # no value: the rest must be the same
    ("empty", ""), ("nan", "nan"), ("NaN", "NaN"), ("NA", "NA"), ("null", "NULL"), ("none", "None"))}
REFUSED = {
    "word": cell("far"),
    "unit in a cell": cell(lambda v: f"{v} m"),
    "hexadecimal": cell("0x1F"),
    "infinite": cell("inf"),
    "two points": cell("1.2.3"), "thousands": cell('"1,234.5"'), "underscore": cell("1_000"), "minus alone": cell("-"),
    "date in a cell": cell("2025-03-01"), "arabic digits": cell("\u0661\u0662"), "unicode minus": cell("\u22123.5"),
    "a field more": line(lambda row, r: row + ",1"), "a field less": line(lambda row, r: row.rpartition(",")[0]),
    "decimal commas without quotes": lambda r: csv(tram()).replace(b".", b","),
    "one decimal comma": line(lambda row, r: row.replace(".", ",", 1)),
    "quote opened": line(lambda row, r: '"' + row), "quote closed": line(lambda row, r: row + '"'),
    "row of other delimiters": line(lambda row, r: row.replace(",", ";")), "row cut": line(lambda row, r: row[:9]),
    "delimiter at the end": lambda r: csv(tram()).replace(b"\n", b",\n").replace(b",\n", b"\n", 1),
    "mixed decimals": frame(lambda t, r: t.assign(v_kmh=t.v_kmh.map(lambda v: f"{v:.2f}".replace(".", ","))), sep=";"),
    "one comma among points": lambda r: comma(r),
    "time missing": cell("", ["t_s"]), "time a word": cell("now", ["t_s"]), "reversed": frame(lambda t, r: t[::-1]),
    "shuffled": shuffled,
    "row twice": frame(repeated),
    "name twice": lambda r: csv(tram()).replace(b"odo_m", b"v_kmh", 1),
    "no names": lambda r: csv(tram()).partition(b"\n")[2], "names alone": lambda r: csv(tram().head(0)),
    "two rows": lambda r: csv(tram().head(2)), "empty": lambda r: b"", "blank": lambda r: b"\n \n\t\n",
    "nul": line(lambda row, r: row[:5] + "\0" + row[5:]), "bytes": lambda r: r.bytes(3000),
    "bytes after the names": lambda r: csv(tram().head(5)) + r.bytes(500),
    "utf-16 cut": lambda r: csv(tram()).decode().encode("utf-16")[:1001],
    "gzip cut": lambda r: gzip.compress(csv(tram()))[:-40],
    "json": lambda r: json.dumps(tram().to_dict()).encode(),
    "clock falls an hour": clock(lambda t, r: fallen(t, r, -3600)),
    "clock starts anew": clock(lambda t, r: t % 100),
    "local time in an autumn night": frame(lambda t, r: t.assign(t_s=stamps("Europe/Brussels", True, t))),
    "column renamed": lambda r: csv(tram()).replace(str(r.choice(READINGS)).encode(), b"x_m", 1),
    "odometer frozen": frame(lambda t, r: t.assign(odo_m=3760.0))}
NONSENSE = {  # the page's kinds: each must be said, in a refusal or a finding
    "m/s called km/h": scaled(["v_kmh"], 1 / 3.6), "km/h called m/s": scaled(["v_ref_mps", "v_kmh"], 3.6),
    "km called m": scaled(["s_gnss_m", "s_ref_m", "odo_m"], 1e-3), "mm called m": scaled(["s_gnss_m", "odo_m"], 1e3),
    "feet called m": scaled(["s_gnss_m", "odo_m", "s_ref_m"], 1 / 0.3048),
    "m called feet": scaled(["odo_m", "s_ref_m"], 0.3048),
    "sign turned": scaled(["v_kmh", "v_ref_mps"], -1.0), "ms called s": clock(lambda t, r: (1000 * t).astype(int)),
    "s called ms": clock(lambda t, r: t / 1000),
    "unix ms called s": clock(unix),
    "an hour lost": clock(lambda t, r: fallen(t, r, 3600)),
    "places and speeds exchanged": exchanged("s_gnss_m", "v_kmh"),
    "odometer and speed exchanged": exchanged("odo_m", "v_kmh"),
    "references exchanged": exchanged("s_ref_m", "v_ref_mps"), "frozen": frame(held), "-9999": cell("-9999"),
    "1e308": cell("1e308"),
    "-999": cell("-999.0"),
    "65535": cell("65535", ["s_gnss_m", "v_kmh", "acc_mps2", "s_ref_m"]),
    "jump": frame(leap), "odometer backwards": frame(turned)}
KINDS: list[tuple[str, str, Callable[[Rng], bytes]]] = [
    (expected, name, mutate) for expected, part in (("same", SAME), ("missing", MISSING), ("refused", REFUSED),
                                                    ("said", NONSENSE)) for name, mutate in part.items()]



def outcome(path: str) -> tuple[Recording | None, str]:
    """The recording, or what is said in one line. A traceback is whatever else is raised."""
    try:
        return Plant.model_validate({"kind": "recorded", "recording": path, "map": MAP}).recorded()[0], ""
    except ValidationError as error:
        assert len(error.errors()) == 1
        return None, error.errors()[0]["msg"]


def differences(found: Recording, expected: Recording) -> tuple[int, int]:
    """How many values are other ones, and how many are missing."""
    if len(found.time) != len(expected.time):
        return len(expected.time), 0
    other = int((np.abs(found.time - expected.time) > 1e-6).sum())
    lost = 0
    for name in expected.measured:
        there = np.isfinite(found.measured[name])
        other += int((np.abs(found.measured[name] - expected.measured[name])[there] > 1e-9).sum())
        lost += int((~there).sum())
    for name in ("position", "speed"):
        known = found.known[name]
        other += int((np.abs(getattr(found, name) - getattr(expected, name))[known] > 1e-9).sum())
        lost += int((~known).sum())
    return other, lost


@pytest.mark.parametrize("number", [
    pytest.param(k, marks=[] if k % SAMPLED == 0 else [pytest.mark.long]) for k in range(COUNT)])
def test_a_spoilt_recording(tmp_path, number):
    expected, name, mutate = KINDS[number % len(KINDS)]
    plain = tmp_path / "plain.csv"
    plain.write_bytes(csv(tram()))
    path = tmp_path / "trip.csv"
    path.write_bytes(mutate(np.random.default_rng([20250301, number])))
    found, message = outcome(str(path))
    if found is None:
        assert expected in ("refused", "said"), f"{name}: {message}"
        assert "\n" not in message and str(path) in message and len(message) < 600
        return
    other, lost = differences(found, read_recording(str(plain), Meaning(tuple(MAP.items()))))
    if expected == "same":
        assert (other, lost) == (0, 0), name
    elif expected == "missing":
        assert (other, lost) == (0, 1), name
    else:
        assert expected == "said" and found.findings, f"{name}: read without a word, {other} values differ"
