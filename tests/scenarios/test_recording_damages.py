"""One damage at a time to a sound recording: what `railstate inspect` says of it, word by word.

The answers are in `tests/expected/damages.txt`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from ..conftest import Command
from ..recordings import metro, tram

Expected = Callable[[str, str], None]


def cell(row: int, column: str, value: object) -> Callable[[pd.DataFrame], pd.DataFrame]:
    def change(table: pd.DataFrame) -> pd.DataFrame:
        table = table.astype({column: object})
        table.loc[row, column] = value
        return table
    return change


def column(name: str, change: Callable[[pd.Series], object], to: str = "") -> Callable[[pd.DataFrame], pd.DataFrame]:
    gone = [name] if to else []
    return lambda table: table.assign(**{to or name: change(table[name])}).drop(columns=gone)


def after(row: int, name: str, by: float) -> Callable[[pd.DataFrame], pd.DataFrame]:
    return lambda table: table.assign(**{name: table[name] + by * (table.index > row)})


DAMAGES: dict[str, Callable[[pd.DataFrame], pd.DataFrame]] = {
    "sound": lambda table: table,
    "a clock in milliseconds": column("t_s", lambda x: 1000 * x),
    "a clock in hours": column("t_s", lambda x: x / 3600),
    "an hour missing": after(90, "t_s", 3600.0), "a gap": after(90, "t_s", 12.0), "a small gap": after(90, "t_s", 4.0),
    "uneven steps": column("t_s", lambda x: x + 0.3 * np.sin(np.arange(len(x)))),
    "time back": cell(50, "t_s", 48.5), "time twice": cell(50, "t_s", 49.0), "time missing": cell(50, "t_s", np.nan),
    "no number": cell(50, "v_kmh", "fast"), "a huge place": cell(50, "s_gnss_m", 9e9),
    "missing value": cell(50, "v_kmh", -9999), "a place off": cell(50, "s_gnss_m", 900.0),
    "a place a little off": cell(50, "s_gnss_m", 200.0), "a jump": after(90, "s_gnss_m", 150.0),
    "a small jump": after(90, "s_gnss_m", 30.0), "kilometres": column("s_gnss_m", lambda x: x / 1000),
    "speed too fast": cell(100, "v_kmh", 700.0), "speed jumps": cell(100, "v_kmh", 110.0),
    "speed in metres": column("v_kmh", lambda x: x / 3.6), "speed negative": column("v_kmh", lambda x: -x),
    "speed frozen": column("v_kmh", lambda x: np.where((x.index > 40) & (x.index < 100), x[41], x)),
    "place frozen": column("s_gnss_m", lambda x: np.where((x.index > 40) & (x.index < 90), x[41], x)),
    "odometer back": after(90, "odo_m", -10.0), "odometer jumps": after(90, "odo_m", 300.0),
    "odometer reset": column("odo_m", lambda x: np.where(x.index > 90, x - x[91], x)),
    "odometer in feet": column("odo_m", lambda x: x / 0.3048), "odometer dead": column("odo_m", lambda x: 0 * x + 5),
    "acceleration turned": column("acc_mps2", lambda x: -x),
    "acceleration in g": column("acc_mps2", lambda x: x / 9.81),
    "reference turned": column("s_ref_m", lambda x: -x), "speed and place swapped": lambda table: table.rename(
        columns={"v_kmh": "s_gnss_m", "s_gnss_m": "v_kmh"}),
    "no unit": column("v_kmh", lambda x: x, "v"), "odd unit": column("v_kmh", lambda x: x, "v_furlong"),
    "names twice": lambda table: table.rename(columns={"s_ref_m": "t_s"}),
    "two rows": lambda table: table.head(2), "no rows": lambda table: table.head(0),
    "no place": lambda table: table[["t_s", "acc_mps2"]],
    "columns of text": lambda table: table.assign(driver="Ann", v_kmh=table.v_kmh.map("{:.1f} km/h".format))}
TEXTS: dict[str, Callable[[str], str]] = {
    "commas": lambda text: text.replace(",", ";").replace(".", ","), "tabs": lambda text: text.replace(",", "\t"),
    "no names": lambda text: text.partition("\n")[2], "cut": lambda text: text[:2000], "nothing": lambda text: "",
    "a quote": lambda text: text.replace("10.0", '"10.0', 1), "nul": lambda text: text[:500] + "\0" + text[500:],
    "control": lambda text: text[:500] + "\x07" + text[500:], "one column": lambda text: text.replace(",", "x"),
    "more fields": lambda text: text.replace("\n20.0,", "\n20.0,7,", 1), "gpx": lambda text: "<gpx></gpx>",
    "xml": lambda text: "<html></html>", "nmea": lambda text: "$GPGGA,1*00\n"}


def test_what_is_said_of_damaged_recordings(railstate: Command, expected: Expected) -> None:
    whole, said = tram(), list[str]()
    sound = whole.to_csv(index=False)
    made = {name: change(whole.copy()).to_csv(index=False) for name, change in DAMAGES.items()}
    made |= {name: change(sound) for name, change in TEXTS.items()}
    wheels = metro()
    made["wheels"] = wheels.to_csv(index=False)
    made["a wheel in feet"] = wheels.assign(wheel_b_m=wheels.wheel_b_m / 0.3048).to_csv(index=False)
    made["a wheel turned"] = wheels.assign(wheel_b_m=-wheels.wheel_b_m).to_csv(index=False)
    for name, text in made.items():
        Path("trip.csv").write_text(text)
        done = railstate("inspect", "trip.csv")
        mapped = done.out.partition("[plant.map]\n")[2].splitlines() if name in TEXTS or "unit" in name else []
        tail = [line for line in done.out.partition("read as:")[2].splitlines()[1:] if line]
        said += [f"{name}: {done.code}", *mapped[:9], *tail[:-1], *done.err.splitlines()]
    expected("damages", "\n".join(said))
