"""`railstate inspect` and `railstate new recording` on recordings of the suite's own making."""

from __future__ import annotations

import re
import shlex
import tomllib
from importlib.resources import files

import pytest
from railstate.benchmarks import cli
from railstate.scenarios.files import load
from railstate.scenarios.recorded.config import Plant

from tests.recordings import METRO, fixes, geojson, ride, track, tram, write_examples


def call(capsys, monkeypatch, *words: object) -> tuple[int, str, str]:
    """Exit code, output and complaints of a command."""
    monkeypatch.setattr("sys.argv", ["railstate", *map(str, words)])
    try:
        cli.main()
        code = 0
    except SystemExit as ended:
        code = int(ended.code or 0)
    found = capsys.readouterr()
    assert "Traceback" not in found.err
    return code, found.out, found.err


@pytest.fixture
def inspect(capsys, monkeypatch):
    return lambda *words: call(capsys, monkeypatch, "inspect", *words)


def mapping(said: str) -> dict:
    """The table that `inspect` writes, as a scenario file has it."""
    return tomllib.loads(re.search(r"\[plant\].*?(?=\n\n(?!\[))", said, re.DOTALL)[0])["plant"]


def test_examples_are_shipped_and_are_what_their_script_makes(tmp_path, capsys, monkeypatch):
    write_examples(tmp_path)
    shipped = files("railstate.scenarios.recorded") / "examples"
    assert sorted(item.name for item in shipped.iterdir()) == ["balises.csv", "fixes.csv", "metro.csv", "track.geojson",
                                                                "tram.csv"]
    for item in shipped.iterdir():
        assert item.read_text() == (tmp_path / item.name).read_text(), item.name
    (tmp_path / "mine").mkdir()
    code, said, _ = call(capsys, monkeypatch, "new", "recording", "--in", tmp_path / "mine")
    assert code == 0 and "railstate inspect" in said
    assert (tmp_path / "mine" / "tram.csv").read_bytes() == (tmp_path / "tram.csv").read_bytes()
    code, _, complaint = call(capsys, monkeypatch, "new", "recording", "--in", tmp_path / "mine")
    assert code == 2 and "exists already" in complaint


def test_a_sound_recording_is_mapped_and_ready_to_run(tmp_path, inspect):
    tram().to_csv(tmp_path / "trip.csv", index=False, sep=";", decimal=",")
    code, said, _ = inspect(tmp_path / "trip.csv")
    assert code == 0 and "Nothing that cannot be" in said
    assert "CSV: semicolons, UTF-8, decimal commas" in said
    found = mapping(said)
    assert found["map"] == {
        "time": "t_s", "position": "s_gnss_m", "speed": "v_kmh", "odometer": "odo_m", "acceleration": "acc_mps2",
        "reference_position": "s_ref_m", "reference_speed": "v_ref_mps"}
    command = shlex.split(said.strip().splitlines()[-1])
    assert command[:4] == ["railstate", "run", "recorded", "--recording"]
    assert dict(pair.split("=") for pair in command[-1].split(",")) == found["map"]
    assert Plant.model_validate({"kind": "recorded", "recording": command[4], **found}).recorded()


def test_units_that_no_name_tells_are_found_by_what_fits(tmp_path, inspect):
    true = ride()
    for unit, factor in (("m/s", 1.0), ("km/h", 3.6)):
        table = true.assign(spd=factor * true.v_mps, tst=1_740_816_217 + true.t_s)[["tst", "s_m", "spd"]]
        table.to_csv(tmp_path / "trip.csv", index=False)
        code, said, _ = inspect(tmp_path / "trip.csv")
        assert code == 0 and mapping(said)["map"] == {"time": "tst [s]", "position": "s_m", "speed": f"spd [{unit}]"}
        assert "its way is 1 times that of the position" in said or "its way is 0.99" in said


def test_fixes_and_their_classes(tmp_path, inspect):
    fixes().to_csv(tmp_path / "fixes.csv", index=False)
    (tmp_path / "track.geojson").write_text(geojson([track()]))
    code, said, _ = inspect(tmp_path / "fixes.csv", "--track", tmp_path / "track.geojson")
    found = mapping(said)
    assert code == 0 and found["quality"] == {"NARROW_INT3": 0.05, "SINGLE": 3.0, "PROPAGATED": "missing"}
    assert "along the track of" in said and "--track" in said.strip().splitlines()[-1]


def test_what_cannot_be_is_said_with_its_place(tmp_path, inspect):
    table = tram()
    table.loc[90:95, "s_ref_m"] += 400
    table.loc[20, "acc_mps2"] = -9999
    table.assign(v_kmh=table.v_kmh / 3.6).to_csv(tmp_path / "trip.csv", index=False)
    code, said, _ = inspect(tmp_path / "trip.csv")
    assert code == 1 and "What cannot be:" in said
    assert "the reference moves at 4" in said and "--without 89..97" in said
    assert "missing = [-9999]" in said
    assert "the factor between km/h and m/s (3.6)" in said
    tram().sample(frac=1, random_state=1).to_csv(tmp_path / "trip.csv", index=False)
    code, said, _ = inspect(tmp_path / "trip.csv")
    assert code == 1 and "time must increase" in said and "reference: position: s_ref_m" in said


def test_a_train_s_own_odometry_and_a_scenario_file_of_it(tmp_path, inspect):
    """Wheels and balises by name are mapped; the file has the built-in scenario without what does not fit the trip."""
    write_examples(tmp_path)
    code, said, _ = inspect(tmp_path / "metro.csv", "--balises", tmp_path / "balises.csv", "--out",
                            tmp_path / "my.toml")
    assert code == 0 and mapping(said)["map"] == METRO
    assert "railstate run recorded-odometry" in said and "sweep: left out" in said
    own, built_in = load(str(tmp_path / "my.toml")), load("recorded-odometry")
    assert own.variants["wheels"]["name"] == "my" and set(own.variants) == {"wheels", "as-recorded"}
    assert {key: own.variants["wheels"][key] for key in ("estimators", "requirements")} == {
        key: built_in.variants["wheels"][key] for key in ("estimators", "requirements")}
    assert own.setting("wheels").sensors == ("wheel-a", "wheel-b", "balise")
    code, _, complaint = inspect(tmp_path / "metro.csv", "--out", tmp_path / "none" / "my.toml")
    assert code == 2 and "cannot be written" in complaint


def test_files_that_cannot_be_read_end_with_2(tmp_path, inspect):
    (tmp_path / "trip.csv").write_text("hello")
    for words, message in (((tmp_path / "trip.csv",), "no delimiter found"), (("/dev/zero",), "no regular file"),
                           ((tmp_path / "none.csv",), "cannot be read")):
        code, _, complaint = inspect(*words)
        assert code == 2 and message in complaint and complaint.count("\n") == 1
    tram().to_csv(tmp_path / "trip.csv", index=False)
    for words, message in ((("--map", "time"), "expected ROLE=COLUMN pairs"), (("--without", "5"), "expected FROM..TO"),
                           (("--map", "altitude=t_s"), "no such role"), (("--set", "plant.color=1"), "unknown key")):
        code, _, complaint = inspect(tmp_path / "trip.csv", *words)
        assert code == 2 and message in complaint
