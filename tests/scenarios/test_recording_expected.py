"""What recordings are read as and what a ride on them is, whole, beside committed text (to renew it:
`tests/expected.py`): every array of a recording under every option, truth and readings under every key of [sensors]."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from math import nan
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import railstate
from railstate.scenarios.errors import InputError
from railstate.scenarios.files import load
from railstate.scenarios.randomness import Streams
from railstate.scenarios.recorded.recording import Meaning, Recording, read_recording

from ..benchmarks.test_python_expected import columns_of
from ..expected import digest
from ..recordings import METRO, fixes, geojson, metro, track, tram
from .test_models_expected import told
from .test_recording_damages import DAMAGES
from .test_recording_reading import MAP
from .test_recording_values import OWN, PLACES

Expected = Callable[[str, str], None]
Change = Callable[[pd.DataFrame], pd.DataFrame]
SD = {"NARROW_INT3": 0.05, "SINGLE": 3.0, "PROPAGATED": nan}


def swapped(table: pd.DataFrame) -> pd.DataFrame:
    return table.iloc[[*range(20), 21, 20, *range(22, len(table))]]


def twice(table: pd.DataFrame) -> pd.DataFrame:
    return pd.concat([table, table.iloc[[50, 60, 60]].assign(s_gnss_m=600.0, v_kmh=np.nan)]).sort_values("t_s")


def coarse(table: pd.DataFrame) -> pd.DataFrame:
    every = np.arange(len(table)) % 4 == 0
    return table.assign(s_ref_m=table.s_ref_m.where(every), v_ref_mps=table.v_ref_mps.where(every),
                        gnss_sd=np.where(every, 2.0, np.nan))


ONLY = {"time": "t_s", "position": "s_gnss_m"}
TRAM: dict[str, tuple[Change, dict[str, str], dict[str, Any]]] = {
    "order: sort": (swapped, MAP, {"order": "sort"}), "order: refuse": (swapped, MAP, {}),
    **{f"duplicates: {how}": (twice, MAP, {"duplicates": how}) for how in ("first", "last", "mean", "refuse")},
    "span": (lambda table: table, MAP, {"span": (30.0, 90.5)}),
    "without": (lambda table: table, MAP, {"without": ((20.0, 29.0), (100.0, 110.0))}),
    "all left out": (lambda table: table, MAP, {"span": (500.0, 600.0)}),
    "wrap": (lambda table: table.assign(odo_m=table.odo_m % 1000), MAP, {"wrap": 1000.0}),
    "wraps unsaid": (lambda table: table.assign(odo_m=table.odo_m % 1000), MAP, {}),
    "missing": (lambda table: table.assign(v_kmh=table.v_kmh.where(table.index % 7 > 0, -1.0)), MAP,
                {"missing": (-1.0,)}),
    "missing text": (lambda table: table.assign(s_gnss_m=table.s_gnss_m.astype(object).where(
        table.index % 9 > 0, "lost")), MAP, {"missing": ("lost",)}),
    "own": (lambda table: table, OWN, {}), "position": (lambda table: table, ONLY, {}),
    "speed": (lambda table: table, {"time": "t_s", "speed": "v_kmh"}, {}),
    "position, its reference": (lambda table: table, {**ONLY, "reference_position": "s_ref_m"}, {}),
    "odometer": (lambda table: table, {"time": "t_s", "odometer": "odo_m", "speed": "v_kmh"}, {}),
    "turned": (lambda table: table.assign(acc_mps2=-table.acc_mps2), {**MAP, "acceleration": "-acc_mps2"}, {}),
    "told worse than nothing": (lambda table: coarse(table).assign(gnss_sd=2.0 - table.index / 60),
                                {**MAP, "position_sd": "gnss_sd [m]"}, {}),
    "told": (coarse, {**MAP, "position_sd": "gnss_sd [m]"}, {}), "coarse reference": (coarse, MAP, {}),
    "control": (lambda table: table.assign(u=np.sin(table.t_s / 9)), {**MAP, "control": "u"}, {}),
    "balise": (lambda table: table.assign(b=table.s_ref_m.where(table.index % 40 == 7)),
               {**MAP, "balise": "b [m]"}, {})}
PLACED = {"B1": 20.0, "B2": 350.0, "B3": 690.0, "B4": 1080.0, "B5": 1400.0}
NAMED: dict[str, Any] = {"balises": tuple(PLACED.items())}
CLASSES = tuple(SD.items())
WHEELS: dict[str, tuple[dict[str, str], dict[str, Any]]] = {
    "wheels": (METRO, NAMED), "a file": (METRO, {"balises": "balises.csv"}),
    "some": (METRO, {"balises": tuple(list(PLACED.items())[:3])}),
    "one wheel": ({key: name for key, name in METRO.items() if key != "wheel-b"}, NAMED),
    "no balise": ({key: name for key, name in METRO.items() if key != "balise"}, {}),
    "no reference": ({key: name for key, name in METRO.items() if "ref" not in key}, NAMED)}
FIXES: dict[str, dict[str, Any]] = {
    "own path": {"quality": CLASSES}, "a track": {"quality": CLASSES, "track": "track.geojson"},
    "pieces": {"quality": CLASSES, "track": "pieces.geojson"}, "unknown class": {"quality": (("SINGLE", 3.0),)},
    "short": {"quality": CLASSES, "track": "short.geojson"}}


def whole(recording: Recording) -> Iterator[str]:
    for name in ("time", "position", "speed"):
        yield f"  {name} {digest(getattr(recording, name))}"
    for name in ("known", "measured", "told"):
        for key, values in getattr(recording, name).items():
            yield f"  {name}.{key} {digest(values)} {int(np.isfinite(values.astype(float)).sum())}"
    control = "" if recording.control is None else digest(recording.control)
    yield f"  {recording.apart} {recording.own} {recording.odometer_step:.8e} {control} {recording.reference}"
    yield from (f"  {line}" for line in recording.said)
    yield from (f"  {item.grade} {item.reading}: {item.text}" for item in recording.findings)


def test_recordings(expected: Expected, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    line, out = track(), list[str]()
    Path("track.geojson").write_text(geojson([line]))
    Path("pieces.geojson").write_text(geojson([line[60:][::-1], line[:40], line[39:61]]))
    Path("short.geojson").write_text(geojson([line[40:60]]))
    pd.DataFrame({"balise": list(PLACED), "position_m": PLACED.values()}).to_csv("balises.csv", index=False)
    fixes().to_csv("fixes.csv", index=False)
    metro().to_csv("metro.csv", index=False)
    cases = [(name, "trip.csv", change, columns, options) for name, (change, columns, options) in TRAM.items()]
    cases += [(f"damage: {name}", "trip.csv", change, MAP, {"order": "sort", "duplicates": "first"})
              for name, change in DAMAGES.items()]
    cases += [(f"metro: {name}", "metro.csv", None, *given) for name, given in WHEELS.items()]
    cases += [(f"fixes: {name}", "fixes.csv", None, PLACES, options) for name, options in FIXES.items()]
    for name, file, change, columns, options in cases:
        if change is not None:
            change(tram()).to_csv(file, index=False)
        try:
            found = read_recording(file, Meaning(tuple(sorted(columns.items())), **options))
            out += [name, *whole(found)]
        except ValueError as error:
            out += [name, f"  {error}"]
    expected("recordings", "\n".join(out).replace(str(tmp_path), "."))


RIDES = """
{} {'trips': 'draw'} {'sensors.noise': {'position': 2.0, 'speed': 0.5, 'odometer': 1.0}} {'score.skip': 5.0}
{'sensors.period': {'position': 5.0, 'speed': 2.0}} {'sensors.odometer_step': 2.0}
{'sensors.use': ['odometer', 'speed']}
{'sensors.outage': {'place': 'windows', 'windows': [[10, 20], [60, 80]], 'sensors': ['position', 'speed']}}
{'sensors.outage': {'place': 'random', 'duration': 12.0}} {'sensors.outage': {'place': 'sweep', 'duration': 12.0}}
{'sensors.simulated': ['gnss', 'radar', 'balise'], 'plant.every': 200.0}
{'sensors.simulated': ['accelerometer', 'wheel-a']}
{'knowledge.motion': 'jerk'} {'knowledge.motion': 'odometer'} {'knowledge.motion': 'accelerometer'}
{'knowledge.shortfall': 'modelled'} {'channel.kind': 'bernoulli', 'channel.p': 0.7}
{'faults': [{'kind': 'jump', 'sensors': ['speed'], 'size': 3.0, 'truth': True}]} {'sensors.use': ['balise']}
{'sensors.outage': {'place': 'random', 'duration': 500.0}} {'sensors.noise': {'balise': 1.0}} {'time.steps': 20}
""".replace("} {", "}\n{").strip().splitlines()


WHEEL_RIDES = """
{} {'channel.kind': 'bernoulli', 'channel.p': 0.7} {'sensors.simulated': ['gnss', 'radar']}
{'faults': [{'kind': 'outliers', 'sensors': ['wheel-a', 'balise'], 'share': 0.3, 'size': 2.0}]}
{'channel.kind': 'delay', 'channel.steps': [0, 3]} {'sensors.use': ['wheel-b']} {'knowledge.motion': 'minmax'}
{'sensors.outage': {'place': 'random', 'duration': 20.0, 'sensors': ['wheel-a', 'wheel-b']}}
{'faults': [{'kind': 'dropout', 'sensors': ['wheel-a'], 'from': 20.0, 'to': 40.0}]}
""".replace("} {", "}\n{").strip().splitlines()


def test_rides(expected: Expected, tmp_path: Path, monkeypatch: Any) -> None:
    """Two trips in turn: what is true, heard, told to be true, and scored."""
    monkeypatch.chdir(tmp_path)
    out = list[str]()
    for seed in (1, 2):
        tram(seed).iloc[:80 + 20 * seed].to_csv(f"trip-{seed}.csv", index=False)
    columns = {key: name for key, name in MAP.items() if key != "acceleration"}
    for text in RIDES:
        given = {f"plant.{key}" if key == "trips" else key: value for key, value in ast.literal_eval(text).items()}
        acceleration = {"acceleration": "acc_mps2"} if "accelerometer'}" in text else {}
        changes = {"plant.recording": ["trip-1.csv", "trip-2.csv"], "plant.map": {**columns, **acceleration}, **given}
        out += [text, *ridden("recorded", "as-recorded", changes)]
    metro().to_csv("metro.csv", index=False)
    for text in WHEEL_RIDES:
        changes = {"plant.recording": "metro.csv", "plant.map": METRO, "plant.balises": PLACED,
                   **ast.literal_eval(text)}
        seen = {*out}
        out += [f"wheels {text}", *(line for line in ridden("recorded-odometry", "wheels", changes)
                                    if line not in seen)]
    expected("rides", "\n".join(out).replace(str(tmp_path), "."))


def ridden(name: str, variant: str, changes: dict[str, Any]) -> list[str]:
    try:
        found = railstate.simulate(f"{name}/{variant}", 1, seed=2, overrides=changes)
        setting = load(name, changes, variant).setting(variant)
        world = setting.world(Streams(2, name, variant, (0, 1, 2)))
        return [*columns_of(found.truth), *columns_of(found.measurements), *(f"  {line}" for line in told(
            setting.told({}, {}, world.initial_mean), world.step(0, world.initial_mean))),
                *(f"  {part} {digest(getattr(world, part))}" for part in ("u", "y", "received"))]
    except InputError as error:
        return [f"  {error}"]
