"""Requirements: shares, allowances and claims against numbers by hand and numpy, batches, and what bad ones get."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from pydantic import TypeAdapter, ValidationError
from railstate.benchmarks.judging.selection import Aligned
from railstate.benchmarks.judging.table import Cell, framed
from railstate.benchmarks.scoring.requirements import RequirementScores
from railstate.benchmarks.telling import rankings
from railstate.benchmarks.telling.sentences import requirements_of
from railstate.estimators.interface import Estimate
from railstate.scenarios.arrays import Array
from railstate.scenarios.requirements import Requirement, check
from railstate.scenarios.setting import Quantity
from railstate.scenarios.world import Step

from ..conftest import SCENARIO, Command
from .steps import stretches

QUANTITIES = (Quantity("position", "m", ((0, 1.0),)), Quantity("speed", "m/s", ((1, 1.0),)))


def asked(**table: Any) -> Requirement:
    return TypeAdapter(Requirement).validate_python({"name": "it", **table})


def scored(requirement: Requirement, truth: Array, error: Array, variance: Array | None = None, scored: Any = None,
           reference: Array | None = None, ellipsoid: bool = False) -> dict[str, Array]:
    """The columns of truth, error (K, 2, S), by metric; reference (K, 2, S); variance (K, S) of position."""
    scores = RequirementScores([requirement], QUANTITIES, truth.shape[2], len(truth))
    active = np.ones(truth.shape[2], dtype=bool)
    steps = []
    for k in range(len(truth)):
        claim = None if variance is None else variance[k][None, None]
        estimate = Estimate(truth[k] + error[k], **{"ellipsoid" if ellipsoid else "covariance": claim})
        steps.append((estimate, Step(np.zeros((0, truth.shape[2])), (), truth[k], active,
                                     None if scored is None else scored[k],
                                     reference=None if reference is None else reference[k])))
    for stretch in stretches(steps, [1, *[50] * (len(truth) // 50 + 1)]):
        scores.add(stretch, 0)
    return {metric if name == "it" else f"{metric}:{name}": value
            for (metric, name, _), value in scores.finish().items()}


def driven(scale: float, every: float, length: float = 3000.0) -> tuple[Array, Array, Array]:
    """Truth, error and reference of an odometer with a scale error and perfect balises every so many metres."""
    s = np.arange(1.0, length + 1)
    reference = np.floor(s / every) * every
    truth = np.stack([s, np.ones_like(s)], axis=1)[:, :, None]
    error = np.stack([scale * (s - reference), np.zeros_like(s)], axis=1)[:, :, None]
    return truth, error, np.stack([reference, reference], axis=1)[:, :, None]


def test_one_per_cent_of_scale_uses_ten_of_fifty_five_metres() -> None:
    truth, error, reference = driven(0.01, 1000.0)
    found = scored(asked(form="allowance", constant=5.0, share=0.05, s="true"), truth, error, reference=reference)
    assert found["use"][0] == pytest.approx(9.99 / (5 + 0.05 * 999)) and found["kept"][0] == 1
    assert found["over"][0] == pytest.approx(9.99) and found["under"][0] == 0 and found["inside"][0] == 1


@pytest.mark.parametrize(("scale", "s", "fails"), [
    (0.06, "measured", 714), (-0.06, "measured", 385), (0.06, "true", 500), (-0.06, "true", 500)])
def test_six_per_cent_fail_from_there_on(scale: float, s: str, fails: int) -> None:
    """The distance by which the allowance grows is the measured one (the standard's) or the true one."""
    truth, error, reference = driven(scale, 5000.0)
    found = scored(asked(form="allowance", constant=5.0, share=0.05, s=s), truth, error, reference=reference)
    inside = int(np.round(found["inside"][0] * len(truth)))
    assert abs(inside - fails) <= 1 and found["kept"][0] == 0


def test_the_map_s_error_is_none_of_the_odometer_s() -> None:
    truth, error, reference = driven(0.0, 1000.0)
    reference[:, 0] += 0.7
    error[:, 0] += 0.7
    found = scored(asked(form="allowance", constant=5.0, share=0.05), truth, error, reference=reference)
    assert found["use"][0] == pytest.approx(0, abs=1e-9)
    reference[:300] = np.nan  # before the first reference nothing counts
    error[:300, 0] = 1e6
    found = scored(asked(form="allowance", constant=5.0, share=0.05), truth, error, reference=reference)
    assert found["use"][0] == pytest.approx(0, abs=1e-9) and found["inside"][0] == 1


def random_case(runs: int = 3, steps: int = 400) -> tuple[Array, Array, Array, Array]:
    rng = np.random.default_rng(5)
    truth = np.stack([np.cumsum(rng.uniform(0, 2, (steps, runs)), axis=0), rng.uniform(0, 30, (steps, runs))], axis=1)
    error = rng.normal(size=(steps, 2, runs)) * np.array([2.0, 0.4])[None, :, None]
    return truth, error, rng.uniform(0.5, 6, (steps, runs)), rng.uniform(size=(steps, 2, runs)) < 0.8


def test_speed_limits_go_straight_from_point_to_point() -> None:
    truth, error, _, mask = random_case()
    points = [[30 / 3.6, 2 / 3.6], [500 / 3.6, 12 / 3.6]]
    found = scored(asked(form="speed", points=points), truth, error, scored=mask)
    V = 3.6 * truth[:, 1]
    limit = (2 + np.maximum(0, V - 30) * 10 / 470) / 3.6
    for run in range(3):
        e, top = error[mask[:, 1, run], 1, run], limit[mask[:, 1, run], run]
        assert found["inside"][run] == pytest.approx((np.abs(e) <= top).mean())
        assert found["use"][run] == pytest.approx((np.abs(e) / top).max())
        assert found["over"][run] == pytest.approx(e.max()) and found["under"][run] == pytest.approx(-e.min())


@pytest.mark.parametrize("ellipsoid", [False, True])
def test_claims_and_percentiles(ellipsoid: bool) -> None:
    """A set claims its whole half-width, a covariance k standard deviations."""
    truth, error, variance, mask = random_case()
    found = scored(asked(form="confidence", k=2.0), truth, error, variance, mask, ellipsoid=ellipsoid)
    k = 1.0 if ellipsoid else 2.0
    for run in range(3):
        take = mask[:, 0, run]
        e, sd = np.abs(error[take, 0, run]), np.sqrt(variance[take, run])
        assert found["inside"][run] == pytest.approx((e <= k * sd).mean())
        assert found["half-width"][run] == pytest.approx(k * np.median(sd))
        assert found["k99"][run] == pytest.approx(np.percentile(e / sd, 99))
        assert found["kept"][run] == 0
        for percent in (50, 95, 99):
            assert found[f"p{percent}:position"][run] == pytest.approx(np.percentile(e, percent))
    found = scored(asked(form="percentile", quantity="position", percent=90, limit=3.3), truth, error, scored=mask)
    values = [np.percentile(np.abs(error[mask[:, 0, run], 0, run]), 90) for run in range(3)]
    np.testing.assert_allclose(found["p90"], values)
    np.testing.assert_array_equal(found["kept"], [float(v <= 3.3) for v in values])


def test_a_stop_is_the_last_step_of_each_run_whatever_else_counts() -> None:
    """One ends with its first step."""
    truth, error, _, _ = random_case(4)
    scores = RequirementScores([asked(form="stop", within=0.5)], QUANTITIES, 4, 10)
    steps = [(Estimate(truth[k] + error[k]), Step(np.zeros((0, 4)), (), truth[k], np.array([
        k < 4, True, k < 7, k < 1]), np.zeros((2, 4), dtype=bool))) for k in range(10)]
    for stretch in stretches(steps, [4, 4, 4]):
        scores.add(stretch, 0)
    found = scores.finish()
    final = np.abs([error[3, 0, 0], error[9, 0, 1], error[6, 0, 2], error[0, 0, 3]])
    np.testing.assert_allclose(found["error", "it", "m"], final)
    np.testing.assert_array_equal(found["kept", "it", "1"], (final <= 0.5).astype(float))
    assert np.isnan(found["p95", "position", "m"]).all()


def test_the_change_of_the_error_over_a_distance() -> None:
    truth, error, reference = driven(0.02, 1e9)
    found = scored(asked(form="allowance", constant=5.0, share=0.05), truth, error, reference=reference)
    for distance in (10, 100, 1000):
        assert found[f"change-{distance}m:position"][0] == pytest.approx(0.02 * distance)


@pytest.mark.parametrize(("table", "error", "kept"), [
    ({"form": "stop", "within": 0.5}, [9.0, -0.5], 1), ({"form": "stop", "within": 0.5}, [0.0, 0.5000001], 0),
    ({"form": "percentile", "percent": 50, "quantity": "position", "limit": 0.5}, [0.5, -0.5], 1),
    ({"form": "percentile", "percent": 50, "quantity": "position", "limit": 0.5}, [0.5, 0.6], 0),
    ({"form": "confidence", "k": 2.0}, [4.0, -4.0], 1), ({"form": "confidence", "k": 2.0}, [4.0, 4.1], 0),
    ({"form": "speed", "quantity": "position", "points": [[0.0, 0.5]]}, [0.5, -0.5], 1),
    ({"form": "speed", "quantity": "position", "points": [[0.0, 0.5]]}, [0.5, -0.6], 0),
    ({"form": "allowance", "constant": 0.5, "share": 0.25, "s": "true"}, [-1.0, 1.0], 1),
    ({"form": "allowance", "constant": 0.5, "share": 0.25, "s": "true"}, [1.0, 1.1], 0)])
def test_what_ties_with_a_limit_is_kept(table: dict[str, Any], error: list[float], kept: int) -> None:
    """A claimed standard deviation of 2; 2 m since the reference."""
    truth, reference = np.full((2, 2, 1), 8.0), np.full((2, 2, 1), 6.0)
    found = scored(asked(**table), truth, np.array(error)[:, None, None] * [[1.0], [0.0]], np.full((2, 1), 4.0),
                   reference=reference)
    assert found["kept"].tolist() == [kept]


@pytest.mark.parametrize(("form", "own"), [
    ("allowance", "inside use over under"), ("speed", "inside use over under"), ("stop", "error"),
    ("confidence", "inside half-width k99"), ("percentile", "p97.5")])
def test_which_columns_a_requirement_has(form: str, own: str) -> None:
    """Changes over a distance where something is about references, and of what is a length."""
    truth, error, reference = driven(0.02, 500.0)
    table = {**SOUND[form], **({"percent": 97.5} if form == "percentile" else {})}
    found = scored(asked(form=form, **table), truth[:20], error[:20], np.ones((20, 1)), reference=reference[:20])
    about = asked(form=form, **table).quantity
    assert list(found) == [*(f"p{percent}:{about}" for percent in (50, 95, 99)), *(
        f"change-{length}m:{about}" for length in (10, 100, 1000) if form == "allowance"), "kept", *own.split()]


def test_no_batch_changes_a_bit() -> None:
    truth, error, variance, mask = random_case()
    for form in ({"form": "confidence", "k": 2.0}, {"form": "speed", "points": [[5.0, 0.4]]},
                 {"form": "percentile", "quantity": "speed", "percent": 97, "limit": 1.0}):
        together = scored(asked(**form), truth, error, variance, mask)
        for run in range(3):
            one = slice(run, run + 1)
            alone = scored(asked(**form), truth[..., one], error[..., one], variance[:, one], mask[..., one])
            for name, value in together.items():
                np.testing.assert_array_equal(alone[name][0], value[run])


def test_requirements_that_do_not_fit_are_told() -> None:
    found = check([asked(form="speed", quantity="height", points=[[1, 1]]),
                   asked(form="allowance", constant=1, share=0)], ["position", "speed"], False)
    assert [line.split(":")[0] for line in found] == ["requirements.0.quantity", "requirements.1.form", "requirements"]
    assert "allowed: position, speed" in found[0] and "references" in found[1] and "stands twice" in found[2]


SOUND: dict[str, dict[str, object]] = {
    "allowance": {"constant": 0.0, "share": 0.0}, "speed": {"points": [[0.0, 0.5], [1.0, 0.1]]},
    "stop": {"within": 0.1},
    "confidence": {"k": 0.1}, "percentile": {"quantity": "speed", "percent": 100.0, "limit": 0.1}}


@pytest.mark.parametrize(("form", "changes", "field"), [
    *((form, {}, "") for form in SOUND), ("allowance", {"constant": -0.1}, "constant"),
    ("allowance", {"share": -0.1}, "share"), ("speed", {"points": [[0.0, 0.5], [0.0, 0.6]]}, "speed"),
    ("speed", {"points": [[1.0, 0.5], [0.5, 0.5]]}, "speed"), ("speed", {"points": [[1.0, 0.0]]}, "speed"),
    ("speed", {"points": [[1.0, 1e-9]]}, ""), ("speed", {"points": []}, "points"), ("speed", {"points": [[1.0]]}, "0"),
    ("stop", {"within": 0.0}, "within"), ("confidence", {"k": 0.0}, "k"), ("percentile", {"percent": 0.0}, "percent"),
    ("percentile", {"percent": 100.1}, "percent"), ("percentile", {"limit": 0.0}, "limit"),
    ("stop", {"accept": 1.0}, "accept"), ("stop", {"accept": 0.0}, "accept"), ("stop", {"per": "time"}, "per"),
    ("percentile", {"per": "time"}, "per"), ("allowance", {"per": "time"}, ""), ("stop", {"name": "-x"}, "name")])
def test_what_a_requirement_may_say(form: str, changes: dict[str, object], field: str) -> None:
    try:
        asked(form=form, **{**SOUND[form], **changes})
        assert not field
    except ValidationError as error:
        (found,) = error.errors()
        assert field in map(str, found["loc"]), found


@pytest.mark.parametrize(("table", "expected"), [
    ('name = "x"\nform = "speed"\npoints = [[2, 1], [1, 1]]', "increasing speeds"),
    ('name = "x"\nform = "hope"', "requirements.x"),
    ('name = "x"\nform = "stop"\nwithin = -1', "requirements.x.within"),
    ('name = "x"\nform = "stop"\nwithin = 1\nquantity = "height"', "no scored quantity"),
    ('name = "x"\nform = "allowance"\nconstant = 1\nshare = 0', "needs references"),
])
def test_bad_requirements_are_one_message(railstate: Command, table: str, expected: str) -> None:
    Path("bad.toml").write_text(SCENARIO.replace("[channel]", f"[[requirements]]\n{table}\n[channel]"))
    done = railstate("run", "bad.toml", "--plugin", "half.py", "--runs", 2, "--out", "out")
    assert done.code == 2 and expected in done.err and "Traceback" not in done.err, done.err


def test_rows_of_any_scenario_carry_its_requirements(railstate: Command) -> None:
    table = '[[requirements]]\nname = "near"\nform = "percentile"\nquantity = "position"\npercent = 95\nlimit = 3.0\n'
    Path("cart.toml").write_text(SCENARIO.replace("[channel]", f"{table}[channel]"))
    done = railstate("run", "cart.toml", "--plugin", "half.py", "--estimators", "half", "--runs", 4, "--out",
                     "out")
    assert done.code == 0, done.err
    from railstate.benchmarks.store.folder import Store
    rows = Store(Path("out")).rows()
    assert {"kept:near:1", "p95:near:m", "p99:position:m"} <= set(rows.columns)
    np.testing.assert_array_equal(rows["kept:near:1"], (rows["p95:near:m"] <= 3.0).astype(float))


def test_requirements_are_judged_with_their_sizes_beside() -> None:
    """Met, not met, undecided; a lost run has not kept it; who claims nothing has no line."""
    rng = np.random.default_rng(3)
    kept = {"good": np.ones(100), "bad": (rng.uniform(size=100) < 0.5).astype(float),
            "open": np.r_[np.zeros(4), np.ones(96)], "mute": np.full(100, np.nan)}
    rows = pd.concat([pd.DataFrame({
        "scenario": "s", "variant": "v", "estimator": label, "run": range(100), "status": "ok", "reason": "",
        "kept:near:1": values, "use:near:1": np.linspace(0, 1, 100), "over:near:m": 3.0, "under:near:m": 1.0,
    }) for label, values in kept.items()], ignore_index=True)
    lost = (rows["estimator"] == "good") & (rows["run"] < 30)
    near = asked(form="allowance", constant=5.0, share=0.05, accept=0.95).model_copy(update={"name": "near"})
    about = {"quantities": [], "shown": {}, "variants": {"v": {"requirements": [near.model_dump()]}}}

    def verdicts(table: pd.DataFrame) -> dict[str, dict[str, Any]]:
        cell = Cell("s/v", Aligned(table), about, {}, {})
        return {line["estimator"]: line for line in cell._requirements()}

    found = verdicts(rows)
    assert {label: line["verdict"] for label, line in found.items()} == {
        "good": "met", "bad": "not met", "open": "undecided"}
    assert found["open"]["deciding"] > 100 and np.isnan(found["good"]["deciding"])
    assert found["good"]["note"] == "P95 over runs: use 0.95, over 3 m, under 1 m"
    rows.loc[lost, ["kept:near:1", "use:near:1"]] = np.nan
    rows.loc[lost, "status"] = "diverged"
    again = verdicts(rows)
    assert again["good"]["verdict"] == "not met" and again["good"]["value"] == pytest.approx(0.7)
    told = rankings.Cell("s", "v", tuple(rankings.records(framed(list(found.values())))), about, {}, {}, {},
                         frozenset(), {})
    assert requirements_of(told) == ["Requirement near, in 95 % of the runs: met by good; not met by bad; undecided "
                                     "for open."]
