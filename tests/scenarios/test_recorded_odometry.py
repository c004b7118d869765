"""Recorded trips with wheels that slip and balises: what estimators hear, and those of `odometry` on them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks.running.drive import drive, prepare
from railstate.estimators.registry import estimators
from railstate.scenarios.errors import InputError, Unsupported
from railstate.scenarios.files import load
from railstate.scenarios.randomness import Streams
from railstate.scenarios.recorded.config import Plant
from railstate.scenarios.recorded.wheels import step_of

from ..conftest import Command
from ..recordings import BALISES, METRO, metro, write_examples


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_examples(tmp_path)
    return tmp_path


def setting(folder: Path, variant: str = "wheels", columns: dict[str, str] = METRO, **overrides: Any) -> Any:
    changes = {"plant.recording": str(folder / "metro.csv"), "plant.balises": str(folder / "balises.csv"),
               "plant.map": columns, **overrides}
    return load("recorded-odometry", changes).setting(variant)


def world(chosen: Any, runs: int = 2, variant: str = "wheels") -> Any:
    return chosen.world(Streams(1, "recorded-odometry", variant, range(runs)))


def run(chosen: Any, label: str, runs: int = 1, variant: str = "wheels") -> Any:
    made, entry = world(chosen, runs, variant), chosen.config.estimators[label]
    estimator, model = prepare(chosen, estimators()[entry.plugin], entry.parameters, entry.knowledge, made.initial_mean)
    estimator.design(model)
    streams = Streams(1, "recorded-odometry", variant, range(runs))
    return drive(chosen, made, estimator, model, streams("estimator", label))


def test_what_is_heard(folder: Path) -> None:
    table = metro()
    lost = [60, 61, 62]
    table.loc[lost, ["wheel_a_m"]] = np.nan  # then no wheel is heard: they are read together
    table.to_csv(folder / "metro.csv", index=False)
    made = world(setting(folder))
    there = table[["wheel_a_m", "wheel_b_m"]].notna().all(axis=1).to_numpy()
    rows = np.flatnonzero(there)
    for i, name in enumerate(("wheel_a_m", "wheel_b_m")):
        np.testing.assert_array_equal(made.received[:, i, 0], there[1:])
        np.testing.assert_allclose(made.y[rows[1:] - 1, i, 1], np.diff(table[name][rows]), rtol=0, atol=1e-9)
        assert made.u[:, 7 + i, 0].sum() == pytest.approx(table[name].iloc[-1])
        variance = 0.02**2 + 0.027**2 / 6 + (0.003 * np.diff(table[name][rows])) ** 2
        np.testing.assert_allclose(made.covariance[rows[1:] - 1, i, i, 0], variance, rtol=1e-6)
    # what is rolled is measured from the last count on
    np.testing.assert_array_equal(made.u[1:, 6, 0], there[1:-1])
    # balises are events at times of their own
    passed = table.balise.notna().to_numpy()
    np.testing.assert_array_equal(made.received[:, 2, 0], passed[1:])
    np.testing.assert_array_equal(made.y[passed[1:], 2, 0], BALISES)
    np.testing.assert_array_equal(np.cumsum(made.lengths)[passed[1:]], table.t_s[passed])
    assert (made.covariance[passed[1:], 2, 2] == 1.0).all()
    reference = made.reference[:, :, 0]
    since = np.maximum.accumulate(np.where(passed[1:], np.arange(len(passed) - 1), -1))
    np.testing.assert_array_equal(reference[since >= 0, 0], np.array(made.y[:, 2, 0])[since[since >= 0]])
    assert np.abs(reference[since >= 0, 0] - reference[since >= 0, 1]).max() < 0.3
    # a row of a balise has its part of what is rolled around it
    k = int(np.flatnonzero(passed)[1])
    step = table.wheel_b_m[k + 1] - table.wheel_b_m[k - 1]
    share = (table.t_s[k] - table.t_s[k - 1]) / (table.t_s[k + 1] - table.t_s[k - 1])
    assert made.u[k - 1, 8, 0] == pytest.approx(share * step) and made.u[k, 8, 0] == pytest.approx((1 - share) * step)


def test_a_balise_told_with_other_readings_was_passed_before(folder: Path) -> None:
    """In a row of other readings its place is worth as much less as the way since the row before."""
    table = metro()
    table = table.assign(balise=table.balise.shift(1))[table.balise.isna()].reset_index(drop=True)
    table.to_csv(folder / "metro.csv", index=False)
    chosen = setting(folder)
    made = world(chosen)
    passed = table.balise.notna().to_numpy()
    way = np.diff(table.wheel_a_m)
    np.testing.assert_allclose(made.covariance[passed[1:], 2, 2, 0], 1 + way[passed[1:]] ** 2 / 3)
    assert any("told in a row of other readings" in note for note in chosen.notes)


def test_a_column_that_holds_the_last_balise(folder: Path) -> None:
    table = metro()
    place = table.balise.map({f"B{number + 1}": place for number, place in enumerate(BALISES)}).ffill()
    table.assign(balise_m=place).to_csv(folder / "metro.csv", index=False)
    columns = {**METRO, "balise": "balise_m"}
    chosen = setting(folder, columns=columns, **{"plant.balises": {}})
    assert world(chosen).received[:, 2, 0].sum() == len(BALISES)
    assert any("repeat the balise of the row before" in note for note in chosen.notes)


def test_slip_is_found_from_the_command_line(folder: Path, railstate: Command) -> None:
    """The estimators that win in `odometry` on a trip whose wheels slip and slide by tens of metres."""
    columns = ",".join(f"{role}={name}" for role, name in METRO.items())
    done = railstate("run", "recorded-odometry/wheels", "--recording", folder / "metro.csv", "--map", columns,
                     "--balises", folder / "balises.csv", "--runs", 1, "--jobs", 1, "--out", folder / "out")
    assert done.code == 0 and "6 ok" in done.out, done.out + done.err
    rows = pd.concat(pd.read_parquet(path) for path in (folder / "out" / "rows").iterdir())
    rows = rows.set_index("estimator")
    error, kept = rows["rmse:position:m"], rows["kept:odometry:1"]
    assert error["imm-slip"] < 0.5 and kept["imm-slip"] == 1.0
    assert (error.drop("imm-slip") > 5).all() and (kept.drop("imm-slip") == 0.0).all()
    assert "5 balises are passed, each with a time of its own" in done.out


def test_dead_reckoning_goes_on_from_the_last_balise(folder: Path) -> None:
    driven, table = run(setting(folder), "dr-wheel-b"), metro()
    last = int(np.flatnonzero(table.balise.notna())[-1])
    share = (table.t_s[last + 1] - table.t_s[last]) / (table.t_s[last + 1] - table.t_s[last - 1])
    counts = table.wheel_b_m
    end = BALISES[-1] + share * (counts[last + 1] - counts[last - 1]) + counts.iloc[-1] - counts[last + 1]
    expected = abs(end - np.interp(table.t_s.iloc[-1], table.t_s[table.s_ref_m.notna()], table.s_ref_m.dropna()))
    assert driven.scored.metrics["final", "position"][0] == pytest.approx(expected, abs=1e-6)


def test_one_wheel_alone_and_balises_as_the_only_places(folder: Path) -> None:
    columns = {role: METRO[role] for role in ("time", "wheel-a", "acceleration", "balise")}
    chosen = setting(folder, columns=columns)
    trip = chosen.trips[0]
    assert trip.own == "balise" and "with the first balise" in " ".join(trip.said)
    assert not chosen.quantities()[0].referenced and len(chosen.design_model({}, np.zeros((5, 1))).modes.modes) == 2
    withheld = setting(folder, "wheels", columns, **{"sensors.outage": {
        "place": "windows", "windows": [[100.0, 150.0]], "sensors": ["balise"]}})
    assert withheld.quantities()[0].referenced  # where a balise is withheld its place is the reference
    assert run(withheld, "imm-slip").outcomes["rmse", "position-outage", "m"][0] < 10
    for label, words in (("dr-wheel-b", "wheel-b in plant.map"), ("dr-minmax", "needs wheel-b")):
        with pytest.raises(Unsupported, match=words):
            run(chosen, label)
    with pytest.raises(Unsupported, match="needs an acceleration"):
        run(setting(folder, columns={key: value for key, value in METRO.items() if key != "acceleration"}), "ekf-scale")


def test_several_trips_lost_readings_and_a_sensor_s_fault(folder: Path) -> None:
    """Trips of other lengths and rates in one batch are what each is alone; wheels stuck or lost are borne."""
    metro(2, 0.4).head(300).to_csv(folder / "other.csv", index=False)
    paths = [str(folder / "metro.csv"), str(folder / "other.csv")]
    for label in ("imm-slip", "dr-minmax"):
        both = run(setting(folder, **{"plant.recording": paths}), label, 4).scored.metrics["rmse", "position"]
        for number, path in enumerate(paths):
            alone = run(setting(folder, **{"plant.recording": path}), label).scored.metrics["rmse", "position"]
            np.testing.assert_allclose(both[number::2], alone[0], rtol=1e-12)
    lossy = setting(folder, **{"channel.kind": "bernoulli", "channel.p": 0.8})
    made = world(lossy, 3)
    assert 0.7 < made.received[:, 0].mean() / np.isfinite(lossy.trips[0].measured["wheel-a"]).mean() < 0.9
    assert run(lossy, "imm-slip", 3).scored.metrics["rmse", "position"].max() < 5
    stuck = setting(folder, faults=[{"kind": "stuck", "sensors": ["wheel-a"], "every": 60.0, "lasts": 10.0}])
    assert not run(stuck, "imm-slip", 2).scored.status.any()


def test_a_minus_turns_a_column(folder: Path) -> None:
    """A trip against the line's direction: its places fall while its wheels count."""
    table = metro().assign(s_ref_m=lambda t: 5000 - t.s_ref_m)
    table.to_csv(folder / "metro.csv", index=False)
    columns = {role: METRO[role] for role in METRO if role != "balise"}
    with pytest.raises(InputError, match="a minus turns one"):
        setting(folder, columns=columns)
    turned = setting(folder, columns={**columns, "reference_position": "-s_ref_m"}).trips[0]
    assert turned.position[-1] - turned.position[0] == pytest.approx(1521.7, abs=0.5)
    with pytest.raises(InputError, match="a minus turns places"):
        setting(folder, columns={**columns, "time": "-t_s"})


def test_steps_of_counters() -> None:
    counts = 0.027 * np.floor(np.cumsum(np.random.default_rng(1).uniform(0, 3, 200)) / 0.027)
    assert step_of(counts.round(3)) == pytest.approx(0.027)
    assert step_of(np.cumsum(np.random.default_rng(1).uniform(1, 3, 200))) < 1e-3


@pytest.mark.parametrize(("table", "message"), [
    ("balise,position_m\nB1,20\n", "has B2, B3, B4, B5 in \"balise\" without a place"),
    ("balise,position_m\nB1,20\nB1,30\n", "\"B1\" stands twice"), ("balise,position\nB1,20\n", "unit"),
    ("balise,position_m,z\nB1,20,1\n", "needs two columns"), ("balise,position_m\nB1,\nB2,3\n", "has no place")])
def test_bad_tables_of_balises_are_one_message(folder: Path, table: str, message: str) -> None:
    (folder / "balises.csv").write_text(table)
    with pytest.raises(InputError, match=message):
        setting(folder)


def test_an_entry_may_change_one_number_of_a_table(folder: Path) -> None:
    """As `tune --over knowledge.slip.enter=..` does."""
    told = setting(folder).resolve_knowledge({"slip": {"enter": 0.5}})
    assert told.slip.enter == 0.5 and told.slip.leave == 0.3


def test_wheels_belong_to_the_odometer_s_model(folder: Path) -> None:
    Plant.model_validate({"kind": "recorded"})
    for name, use, words in (("recorded", "wheel-a", "run recorded-odometry"),
                             ("recorded-odometry", "odometer", "map the odometer as wheel-a")):
        with pytest.raises(InputError, match=words):
            load(name, {"sensors.use": ["position", use]})
    with pytest.raises(InputError, match="knowledge: Input tag 'sonar'"):
        load("recorded-odometry", {"knowledge.motion": "sonar"})
