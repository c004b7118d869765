"""What is said of recordings beside their numbers: the notes of a setting, and what does not fit one, in whole words.

The answers are in `tests/expected/recording-words.txt`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from railstate.scenarios.errors import InputError, Unsupported
from railstate.scenarios.files import load
from railstate.scenarios.recorded.findings import APART, leave_out, spans
from railstate.scenarios.setting import Setting

from ..recordings import METRO, fixes, metro, tram, write_examples

TRAM = {"time": "t_s", "position": "s_gnss_m", "speed": "v_kmh", "odometer": "odo_m", "acceleration": "acc_mps2"}
WHOLE = {**TRAM, "reference_position": "s_ref_m", "reference_speed": "v_ref_mps"}
PLACES = {"time": "time", "latitude": "latitude", "longitude": "longitude", "position_sd": "fix"}
LEVEL = {"stops": [0.0, 1500.0], "speed_limits": [[0.0, 20.0]], "gradients": [[0.0, 0.0]]}
BARE = {"time": "t_s", "position": "s_gnss_m"}
QUALITY = {"NARROW_INT3": 0.05, "SINGLE": 30.0, "PROPAGATED": "missing"}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Recordings, named in files as they are here."""
    monkeypatch.chdir(tmp_path)
    write_examples(tmp_path)
    tram(2).to_csv("two.csv", index=False)
    tram(1, 0.2).to_csv("fine.csv", index=False)
    fixes().to_csv("fixes.csv", index=False)
    tram().assign(s_ref_m=lambda table: table["s_ref_m"].where(table.index % 20 == 0)).to_csv("few.csv", index=False)
    vague = fixes()
    vague.loc[vague.index > 1, "fix"] = "SINGLE"
    vague.to_csv("vague.csv", index=False)
    metro().assign(balise=lambda table: table["balise"].ffill(limit=1)).to_csv("held.csv", index=False)
    metro().assign(balise=lambda table: table["balise"].shift(1)).to_csv("shared.csv", index=False)
    (tmp_path / "three.csv").write_text("name,position_m,side\na,1,2\n")
    return tmp_path


def setting(name: str, recording: str | list[str], columns: dict[str, str], variant: str = "as-recorded",
            **overrides: Any) -> Setting[Any]:
    changes = {key.replace("__", "."): value for key, value in overrides.items()}
    return load(name, {"plant.recording": recording, "plant.map": columns, **changes}, variant).setting(variant)


def own(**overrides: Any) -> Setting[Any]:
    return setting("recorded", "tram.csv", TRAM, **overrides)


def wheels(recording: str = "metro.csv", columns: dict[str, str] = METRO, variant: str = "wheels",
           **overrides: Any) -> Setting[Any]:
    return setting("recorded-odometry", recording, columns, variant, **{"plant__balises": "balises.csv", **overrides})


NOTES: dict[str, Callable[[], Setting[Any]]] = {
    "a tram, its own reference": own,
    "swept": lambda: own(variant="sweep", sensors__outage__duration=20.0),
    "a reference of its own": lambda: setting("recorded", "tram.csv", WHOLE),
    "two trips": lambda: setting("recorded", ["tram.csv", "two.csv"], WHOLE, sensors__simulated=["wheel-a", "balise"]),
    "many rows": lambda: setting("recorded", "fine.csv", TRAM),
    "steps that are told": lambda: own(sensors__odometer_step=2.5),
    "fixes": lambda: setting("recorded", "fixes.csv", PLACES, plant__quality=QUALITY),
    "wheels": wheels, "balises held": lambda: wheels("held.csv"),
    "balises in other rows": lambda: wheels("shared.csv"),
    "no position": lambda: setting("recorded", "tram.csv", {role: name for role, name in WHOLE.items()
                                                            if role != "position"}, sensors__use=["speed"]),
    "no recording": lambda: load("recorded").setting("outage")}
REFUSED: dict[str, Callable[[], Any]] = {
    "no recording": lambda: load("recorded").setting("outage").trips,  # pyright: ignore
    "a split that leaves none": lambda: setting("recorded", ["tram.csv", "two.csv"], TRAM, plant__split=2),
    "a split that leaves one": lambda: setting("recorded", ["tram.csv", "two.csv"], TRAM, plant__split=1),
    "a span of nothing": lambda: own(plant__span=[5.0, 5.0]),
    "windows without any": lambda: own(sensors__outage={"place": "windows"}),
    "an empty window": lambda: own(sensors__outage={"place": "windows", "windows": [[5.0, 5.0]]}),
    "an outage of what is not heard": lambda: own(sensors__use=["speed"], sensors__outage={
        "place": "windows", "windows": [[5.0, 6.0]]}),
    "an outage where nothing is": lambda: own(sensors__use=["balise"], sensors__simulated=["balise"], sensors__outage={
        "place": "windows", "windows": [[5.0, 6.0]]}),
    "sensors that are not there": lambda: own(sensors__use=["balise", "radar"]),
    "wheels of another model": lambda: own(sensors__use=["wheel-a"]),
    "an odometer of another model": lambda: wheels(sensors__use=["odometer"]),
    "simulated beside its own": lambda: own(sensors__simulated=["accelerometer"], sensors__use=["speed"]),
    "wheels beside its own": lambda: wheels(sensors__simulated=["wheel-a"]),
    "few steps": lambda: own(time__steps=100), "one step too few": lambda: own(time__steps=182),
    "just enough steps": lambda: own(time__steps=183),
    "a long outage": lambda: own(variant="outage", sensors__outage__duration=500.0),
    "a long outage of a part": lambda: own(variant="outage", plant__span=[30.0, 90.0], sensors__outage__duration=90.0),
    "a line alone": lambda: own(plant__line=LEVEL).design_model({}, np.zeros((2, 1))),
    "three of a reference": lambda: setting("recorded", "few.csv", WHOLE, plant__span=[0.0, 40.0]),
    "two of a reference": lambda: setting("recorded", "few.csv", WHOLE, plant__span=[0.0, 30.0]),
    "vague fixes": lambda: setting("recorded", "vague.csv", PLACES, plant__quality=QUALITY),
    "balises of three columns": lambda: wheels(plant__balises="three.csv"),
    "no odometer and no speed": lambda: setting("recorded", "tram.csv", BARE).design_model(
        {"motion": "odometer"}, np.zeros((2, 1))),
    "no accelerometer": lambda: setting("recorded", "tram.csv", BARE).design_model(
        {"motion": "accelerometer"}, np.zeros((2, 1))),
    "no train": lambda: own().design_model({"motion": "train"}, np.zeros((2, 1))),
    "wheels without an accelerometer": lambda: wheels(columns={
        role: name for role, name in METRO.items() if role != "acceleration"}).design_model({}, np.zeros((2, 1))),
    "minmax of one wheel": lambda: wheels(columns={
        role: name for role, name in METRO.items() if role != "wheel-b"}).design_model(
            {"motion": "minmax"}, np.zeros((2, 1)))}


def test_what_is_said_of_recordings(folder: Path, expected: Callable[[str, str], None]) -> None:
    said = list[str]()
    for name, made in NOTES.items():
        found = made()
        said += [f"{name}: {found.table()}", *(f"  {note}" for note in found.notes)]
    for name, call in REFUSED.items():
        try:
            call()
            said.append(f"{name}: taken")
        except (InputError, Unsupported) as error:
            said.append(f"{name}: {error}")
    expected("recording-words", "\n".join(said).replace(f"{folder}/", ""))


def test_options_that_leave_rows_out() -> None:
    """Rows nearer than `APART` are one place; four are named at most, in whole seconds around them."""
    time = np.array([0.0, 0.4, 0.4 + APART, 31.0 + APART, 100.0, 200.7, 300.0, 400.0, 500.2])
    rows = np.arange(len(time))
    places = [(0.0, 31.0), (61.0, 61.0), (100.0, 100.0), (200.0, 201.0), (300.0, 300.0), (400.0, 400.0), (500.0, 501.0)]
    assert spans(time, rows) == places and spans(time, rows[:0]) == [] and spans(time, rows[[2]]) == [(30.0, 31.0)]
    options = [f"--without {a:g}..{b:g}" for a, b in places]
    for count, last in ((0, 0), (1, 3), (4, 6), (5, 7), (7, 9)):
        more = f" and {count - 4} more such places" if count > 4 else ""
        assert leave_out(time, rows[:last]) == " ".join(options[:min(count, 4)]) + more
