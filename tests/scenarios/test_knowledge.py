"""What an estimator's entry may be told otherwise than the truth reaches its design model, and nothing else.

What cannot be is told with its place."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator
from railstate.scenarios.errors import describe
from railstate.scenarios.files import load
from railstate.scenarios.measurement import untold
from railstate.scenarios.randomness import Streams
from railstate.scenarios.registry import scenario_files

from ..models import whole


def told(name, knowledge):
    """The design model of a scenario's default variant."""
    scenario = load(name)
    setting = scenario.setting(scenario.default)
    steps = setting.config.model_copy(update={"time": setting.config.time.model_copy(update={"steps": 20})})
    world = type(setting)(steps).world(Streams(1, name, scenario.default, (0,)))
    return setting.design_model(knowledge, world.initial_mean)


def noises(model):
    """Q of the first step and R."""
    assert model.linear is not None
    return model.linear.Q(0), model.linear.R(0)


@pytest.mark.parametrize(("name", "knowledge", "which", "changed"), [
    ("braking-rate", {"speed_variance_rate": 0.2}, 0, {(1, 1): 0.2}),
    ("braking-rate", {"displacement_variance": 7.0, "target_acceleration_variance": 3.0}, 1,
     {(0, 0): 7.0, (2, 2): 3.0}),
    ("cbtc-csma", {"position_noise": 0.5, "speed_noise": 2.0}, 1,
     {(i, i): 0.25 if i < 6 else 4.0 for i in range(12)}),
    ("rap-example-1", {"R": 2.0}, 1, {(0, 0): 0.18, (1, 1): 0.18}),
    ("rap-example-1", {"R": [[0.5, 0], [0, 0.6]]}, 1, {(0, 0): 0.5, (1, 1): 0.6})])
def test_told_noise_changes_what_it_names_alone(name, knowledge, which, changed):
    before, after = noises(told(name, {})), noises(told(name, knowledge))
    wanted = before[which].copy()
    for place, value in changed.items():
        wanted[place] = value
    assert after[which] == pytest.approx(wanted) and np.array_equal(before[1 - which], after[1 - which])


def test_a_number_times_a_covariance_that_varies():
    """Q as a number on a plant whose B moves with the step."""
    one, three = told("rap-example-1", {}).linear, told("rap-example-1", {"Q": 3.0}).linear
    assert all(three.Q(k) == pytest.approx(3 * one.Q(k)) for k in range(5))
    with pytest.raises(ValidationError):
        told("rap-example-1", {"Q": -1.0})


def test_bounds_of_an_entry_leave_its_standard_deviations():
    """w_bar and v_bar are what the robust estimators are told; a filter's Q and R stay those of the scenario."""
    def said(knowledge):
        model = told("ningbo-metro", knowledge)
        Q = model.process_covariance(model.initial_mean, np.zeros((1, 1)), whole(0, model.period))
        return model.bounds, Q, model.measurement_covariance(untold(1, 2))

    (plain, Q, R), (bounds, same, too) = said({}), said({"w_bar": 0.6, "v_bar": [2.0, 0.1]})
    assert bounds.w_bar == [0.6] and list(bounds.v_bar) == [2.0, 0.1] and plain.w_bar == [0.15]
    assert np.array_equal(Q, same) and np.array_equal(R, too)
    gaussian = said({"moments": "gaussian"})[1]
    assert gaussian == pytest.approx(Q / 3)


class Small(BaseModel):
    """A model that has everything that can go wrong."""

    model_config = ConfigDict(extra="forbid")
    period: float = Field(gt=0)
    word: str = "good"
    pairs: list[int] = []

    @field_validator("word")
    @classmethod
    def _good(cls, word: str) -> str:
        if word.startswith("bad"):
            raise ValueError(f"{word} is no word" if word == "bad" else "expected a good word")
        return word


@pytest.mark.parametrize(("table", "said"), [
    ({"period": -1.0, "word": "bad"}, [
        "t.period: Input should be greater than 0 (got -1.0)", "t.word: bad is no word"]),
    ({"period": 1.0, "word": "badly"}, ["t.word: expected a good word (got 'badly')"]),
    ({"periods": 2}, ["t.period: missing", "t.periods: unknown key (got 2); allowed: period, word, pairs"]),
    ({"period": {"a": 1}, "pairs": [1, "x"]}, [
        "t.period: Input should be a valid number",
        "t.pairs.1: Input should be a valid integer, unable to parse string as an integer (got 'x')"])])
def test_what_is_wrong_is_told_with_its_place_and_once(table: dict[str, Any], said: list[str]) -> None:
    with pytest.raises(ValidationError) as caught:
        Small.model_validate(table)
    assert describe(caught.value, Small, "t") == said
    assert describe(caught.value, Small) == [line.removeprefix("t.") for line in said]


@pytest.mark.parametrize("name", [name for name in scenario_files() if not name.startswith("recorded")])
def test_a_measurement_that_is_promised_to_be_linear_is(name):
    """Of every entry's design model: y(x) - y(0) = H x for any x, with one H, at any step."""
    scenario, rng, promised = load(name), np.random.default_rng(7), set()
    setting = scenario.setting(scenario.default)
    steps = setting.config.model_copy(update={"time": setting.config.time.model_copy(update={"steps": 20})})
    start = type(setting)(steps).world(Streams(1, name, scenario.default, (0, 1, 2))).initial_mean
    for label, entry in setting.config.estimators.items():
        model = setting.told(entry.knowledge, entry.augment, start)
        promised.add(model.linear_measurement)
        if not model.linear_measurement:
            continue
        x = model.initial_mean + rng.normal(size=model.initial_mean.shape) * 10.0
        for step in (0, 1, 7):
            H = model.measurement_jacobian(x, step)
            assert np.array_equal(H, model.measurement_jacobian(0 * x, step)), label
            away = model.measurement(x, step) - model.measurement(0 * x, step)
            expected = np.einsum("jns,ns->js", np.broadcast_to(H, (*H.shape[:2], x.shape[1])), x)
            np.testing.assert_allclose(away, expected, rtol=1e-9, atol=1e-9, err_msg=label)
    assert promised
