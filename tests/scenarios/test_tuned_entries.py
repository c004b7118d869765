"""Yardsticks in the built-in scenarios: who is tuned, on what, and that no family stands in a table untuned."""

from __future__ import annotations

import numpy as np
import pytest
from railstate.benchmarks.planning.plan import make_plan
from railstate.benchmarks.running.execute import execute
from railstate.estimators.registry import estimator_class
from railstate.scenarios.files import load
from railstate.scenarios.inheritance import lineage
from railstate.scenarios.registry import scenario_files

SCENARIOS = sorted(scenario_files())
MODELS = {"model", "motion", "shortfall"}
"""What an entry may be told that chooses a model of the setting's, and no number of it."""


@pytest.mark.parametrize("name", SCENARIOS)
def test_no_default_table_in_which_a_family_has_no_tuned_or_matched_entry(name: str) -> None:
    """Tuned: its numbers were searched. Matched: it is told the numbers that the scenario tells, none of its own. In
    every variant, those on request too."""
    scenario = load(name)
    for variant in scenario.variants:
        fair: dict[str, bool] = {}
        for label, entry in scenario.setting(variant).config.estimators.items():
            if entry.default:
                family = estimator_class(entry.plugin, label).family
                told = {key for name, value in entry.knowledge.items()
                        for key in (value if isinstance(value, dict) else [name])}
                own = told - MODELS or entry.augment
                fair[family] = fair.get(family, False) or entry.tuned is not None or not own
        assert all(fair.values()), f"{name}/{variant}: {[family for family, one in fair.items() if not one]}"


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_tuned_entry_tells_where_it_comes_from(name: str) -> None:
    """Its variant and the entry before exist, it was no worse on the training runs (by the geometric mean that counts),
    [origin] has the command, and its label says what it is."""
    scenario = load(name)
    for variant in scenario.variants:
        config = scenario.setting(variant).config
        for label, entry in config.estimators.items():
            origin = config.origin.get(f"estimators.{label}", "")
            assert origin.startswith("tuned") == label.endswith("-tuned") == (entry.tuned is not None), (variant, label)
            if entry.tuned is None:
                continue
            before = config.estimators[entry.tuned.untuned]
            assert before.plugin == entry.plugin and entry.tuned.variant in scenario.variants
            assert f"railstate tune {name}/" in origin and f"--estimator {entry.tuned.untuned} " in origin
            ratio = 1.0
            for tuned, untuned in entry.tuned.train.values():
                ratio *= tuned / untuned
            assert ratio < 1.0001, (variant, label)


@pytest.mark.parametrize("name", SCENARIOS)
def test_tuned_entries_are_those_of_the_variant_or_of_what_it_is_laid_over(name: str) -> None:
    """Of a variant that runs by default: its own, or those of one with the same truth and knowledge. Of one on
    request: also those of the variants that it is laid over, the file's first where it names none."""
    scenario = load(name)
    for variant in scenario.variants:
        alike = {other for other in scenario.variants if scenario.content_hash(other) == scenario.content_hash(variant)}
        above = lineage(variant, scenario.layers)[:-1] or (scenario.default,)
        allowed = alike.union(above if variant in scenario.requested else ())
        for label, entry in scenario.setting(variant).config.estimators.items():
            assert entry.tuned is None or entry.tuned.variant in allowed, (variant, label, entry.tuned)


def test_the_metro_is_tuned_anew_wherever_its_noise_is_another() -> None:
    scenario = load("ningbo-metro")
    for variant in scenario.variants:
        records = [entry.tuned for entry in scenario.setting(variant).config.estimators.values() if entry.tuned]
        noise = variant if variant not in scenario.requested else "switching" if variant == "whole-line" else "gaussian"
        assert len(records) == 5 and {record.variant for record in records} == {noise}, variant


@pytest.mark.long
def test_with_one_prior_for_all_imm_is_ahead_of_the_appended_state() -> None:
    """MAE of f, imm-sticky less augmented-kalman on the same 100 runs: with priors of their own a tie (paper) or far
    behind (stop), with the same prior ahead in both, each by more than three standard errors."""
    for variant, least, most in (("paper", -0.002, 0.003), ("prior-normal", -0.0045, -0.0015),
                                 ("prior-uniform", -0.006, -0.0015), ("stop", 0.025, 0.045),
                                 ("stop-prior-normal", -0.02, -0.005), ("stop-prior-uniform", -0.03, -0.01)):
        plan = make_plan([f"braking-rate/{variant}"], only=["imm-sticky", "augmented-kalman"])
        rows = execute(plan.task(plan.cells[0], tuple(plan.cells[0].entries), tuple(range(100)))).rows.to_pandas()
        each = rows.pivot_table(index="run", columns="estimator", values="mae:f:1")
        less = each["imm-sticky"] - each["augmented-kalman"]
        assert least < less.mean() < most, (variant, less.mean())
        assert variant == "paper" or abs(less.mean()) > 3 * less.std() / len(less)**0.5, variant


@pytest.mark.long
def test_the_encoder_s_scale_as_a_state_takes_a_quarter_off_the_error_at_least() -> None:
    """moving-block/law-r, RMSE over 100 runs."""
    plan = make_plan(["moving-block/law-r"], only=["ekf", "ekf-scale"])
    rows = execute(plan.task(plan.cells[0], tuple(plan.cells[0].entries), tuple(range(100)))).rows.to_pandas()
    found = {label: np.square(part["rmse:x:m"]).mean()**0.5 for label, part in rows.groupby("estimator")}
    assert found["ekf-scale"] < 0.75 * found["ekf"]
