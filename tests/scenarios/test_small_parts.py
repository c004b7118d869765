"""Small parts that all settings share, whole: measurements and courses, where a design model starts, what is said of
tables that do not fit, what a setting is that says nothing of itself."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Annotated, Any, Literal

import numpy as np
import pytest
from pydantic import Field, ValidationError
from railstate.scenarios import measurement
from railstate.scenarios.errors import describe
from railstate.scenarios.measurement import Course, Interval
from railstate.scenarios.schema import Empty, Strict
from railstate.scenarios.setting import Quantity, Setting

from .. import models


def test_what_nobody_tells() -> None:
    asked = measurement.untold(3, 2)
    assert asked.received.dtype == bool and asked.received.shape == asked.y.shape == (2, 1) and asked.received.all()
    assert (asked.y == 0).all() and asked[2:] == (3, 0, 0.0, None)
    y, variance = np.ones((4, 2, 3)), np.full((4, 2, 3), 2.0)
    course = Course(1, 0.5, np.arange(4.0), y, y, y > 0)
    assert np.isnan(course.told).all() and course.told.shape == y.shape
    assert course._replace(variance=variance).told is variance


def test_intervals_of_all_runs_and_of_one() -> None:
    whole, parts = Interval(3, 1.0, 0.5), Interval(3, 1.0, np.array([0.5, 0.0, 0.25]), np.array([1.0, 0.0, 0.5]))
    assert (whole.depart, whole.whole, parts.whole) == (2, True, False)
    assert whole._replace(share=0.5).whole is False and parts._replace(share=np.ones(3)).whole is True
    assert parts.moving(3).tolist() == [True, False, True] and whole.moving(2).tolist() == [True, True]
    assert whole._replace(length=0.0).moving(2).tolist() == [False, False]
    assert [parts.of_run(run) for run in range(3)] == [
        (3, 1.0, 0.5, 1.0), (3, 1.0, 0.0, 0.0), (3, 1.0, 0.25, 0.5)]
    assert parts._replace(start=np.array(2.0)).of_run(1) == (3, 2.0, 0.0, 0.0)
    assert all(type(part) is float for part in parts.of_run(1)[1:])


def test_how_the_noise_is_told() -> None:
    """What the sensors tell in place of the model's own, each element of it; a mode may inflate either."""
    own = np.array([[1.0, 0.5], [0.5, 2.0]])[:, :, None]
    told = np.array([[4.0, np.nan], [np.nan, np.nan]])[:, :, None] * np.ones(3)
    asked = measurement.untold(7, 2)
    for inflate in (1.0, 3.0):
        covariance = measurement.told(lambda step: own * step, inflate)
        assert np.array_equal(covariance(asked), 7 * inflate * own)
        said = covariance(asked._replace(covariance=told))
        assert said[..., 1].tolist() == [[4 * inflate, 3.5 * inflate], [3.5 * inflate, 14 * inflate]]
        assert said.shape == (2, 2, 3)


def test_where_a_model_starts_however_that_lies_in_memory() -> None:
    mean, covariance = np.arange(24).reshape(4, 6)[:3, ::2], np.diag([1, 2, 3])[:, :, None]
    for change in (np.asarray, np.asfortranarray, np.float32):
        model = replace(models.linear(3), initial_mean=change(mean), initial_covariance=change(covariance))
        for found, wanted in ((model.initial_mean, mean), (model.initial_covariance, covariance)):
            assert found.dtype == float and found.flags.c_contiguous and not found.flags.writeable
            assert np.array_equal(found, wanted)
    own = np.zeros((3, 3))
    assert np.shares_memory(replace(model, initial_mean=own).initial_mean, own) and own.flags.writeable


class Round(Strict):
    kind: Literal["round"]
    radius: float
    name: str = ""


class Square(Strict):
    kind: Literal["square"]
    side: float = Field(alias="from")
    name: str = ""


Shape = Annotated[Round | Square, Field(discriminator="kind")]


class Shapes(Strict):
    one: Shape
    many: list[Shape] = []
    named: dict[str, Round] = {}
    size: float | list[float] = 1.0
    pair: list[list[float]] = []
    both: tuple[float, float] = (0.0, 1.0)


GOOD = {"kind": "round", "radius": 1}
TABLE, NUMBER = "Input should be a valid dictionary", "Input should be a valid number"
UNKNOWN, PARSED = "unknown key (got 2); allowed: ", f"{NUMBER}, unable to parse string as a number"


@pytest.mark.parametrize(("table", "said"), [
    ({}, ["one: missing"]),
    ({"one": {"kind": "round", "radius": "x", "side": 2}},
     [f"one.radius: {PARSED} (got 'x')", f"one.side: {UNKNOWN}kind, radius, name"]),
    ({"one": GOOD, "both": [1.0]}, ["both.1: missing"]),
    ({"one": GOOD, "both": []}, ["both.0: missing", "both.1: missing"]),
    ({"one": GOOD, "both": ["x", {"name": "y"}]}, [f"both.0: {PARSED} (got 'x')", f"both.y: {NUMBER}"]),
    ({"one": {"kind": "oval"}},
     ["one: Input tag 'oval' found using 'kind' does not match any of the expected tags: 'round', 'square'"]),
    ({"one": 3}, [f"one: {TABLE} or object to extract fields from (got 3)"]),
    ({"one": {"kind": "square", "no": 2}, "many": [GOOD, {"kind": "square", "name": "mine", "from": "x"},
                                                   {"kind": "round"}, 3]},
     ["one.from: missing", f"one.no: {UNKNOWN}kind, from, name", f"many.mine.from: {PARSED} (got 'x')",
      "many.round.radius: missing", f"many.3: {TABLE} or object to extract fields from (got 3)"]),
    ({"one": GOOD, "named": {"round": GOOD | {"radius": "x"}, "b": 3}, "size": "x", "pair": [[1.0, "x"], 3], "szie": 2},
     [f"named.round.radius: {PARSED} (got 'x')", f"named.b: {TABLE} or instance of Round (got 3)",
      f"size: {PARSED} (got 'x')", "size: Input should be a valid list (got 'x')", f"pair.0.1: {PARSED} (got 'x')",
      "pair.1: Input should be a valid list (got 3)", f"szie: {UNKNOWN}one, many, named, size, pair, both"]),
    ({"one": GOOD, "size": [1.0, "w" * 60], "named": {"c": GOOD | {"form": 2}}},
     [f"named.c.form: {UNKNOWN}kind, radius, name", f"size: {NUMBER} (got [1.0, 'wwwwwwwwwwww...wwwwwwwwwwwww'])",
      f"size.1: {PARSED} (got 'wwwwwwwwwwww...wwwwwwwwwwwww')"])])
def test_what_is_said_of_tables_that_do_not_fit(table: dict[str, Any], said: list[str]) -> None:
    with pytest.raises(ValidationError) as caught:
        Shapes.model_validate(table)
    assert describe(caught.value, Shapes, table=table) == said
    assert describe(caught.value, Shapes, "a.toml", table) == [f"a.toml.{line}" for line in said]


def test_places_as_pydantic_has_them_where_the_table_is_not_known() -> None:
    table = {"one": {"kind": "square", "no": 2}, "size": [1.0, "x"]}
    with pytest.raises(ValidationError) as caught:
        Shapes.model_validate(table)
    assert describe(caught.value, Shapes) == [
        "one.square.from: missing", f"one.square.no: {UNKNOWN}kind, from, name",
        f"size.float: {NUMBER} (got [1.0, 'x'])", f"size.list[float].1: {PARSED} (got 'x')"]


class Known(Strict):
    shape: Shape = Round(kind="round", radius=1.0)
    pair: dict[str, float] = {}
    size: float = 2.0


class Bare(Setting[Any]):
    """What has to be defined, and no more."""

    kind = "bare"

    def quantities(self) -> tuple[Quantity, ...]:
        return (Quantity("a", "m", ((0, 1.0),)), Quantity("b", "s", ((1, 1.0),)))

    def world(self, streams: Any) -> Any:
        raise AssertionError

    def design_model(self, knowledge: Any, initial_mean: Any) -> Any:
        return models.linear(initial_mean.shape[1])


def test_a_setting_that_says_nothing_of_itself() -> None:
    config: Any = SimpleNamespace(channel=Empty(), notes=["n"], time=SimpleNamespace(steps=7, period=0.5))
    bare = Bare(config)
    assert (bare.notes, bare.sampling_period, bare.matched(3), bare.uncertified, bare.sensing(), bare.extras({}),
            bare.split(True), bare.outcomes(SimpleNamespace(), {}), bare.batch_bytes(), bare.chosen({}, {})) == (  # pyright: ignore
        ["n"], 0.5, None, {}, None, {}, {}, {}, 7 * 320, [])
    assert bare.table() == (("rmse", "a"), ("rmse", "b"), ("nees", "state"), ("coverage", "ellipsoid"))
    assert bare.told({}, {}, np.zeros((3, 2))).appended == 0


@pytest.mark.parametrize(("own", "over", "told"), [
    ({}, {}, {}), ({"size": 3.0}, {}, {"size": 3.0}), ({"size": 3.0}, {"size": 4.0}, {"size": 4.0}),
    ({"pair": {"a": 1.0}}, {"pair": {"b": 2.0}}, {"pair": {"a": 1.0, "b": 2.0}}),
    ({}, {"pair": {"b": 2.0}}, {"pair": {"b": 2.0}}),
    ({"shape": {"kind": "round", "radius": 3.0, "name": "c"}}, {"shape": {"radius": 4.0}},
     {"shape": {"kind": "round", "radius": 4.0, "name": "c"}}),
    ({"shape": {"kind": "round", "radius": 3.0, "name": "c"}}, {"shape": {"kind": "round", "radius": 4.0}},
     {"shape": {"kind": "round", "radius": 4.0}})])
def test_what_is_told_otherwise(own: dict[str, Any], over: dict[str, Any], told: dict[str, Any]) -> None:
    """A table within changes what it names, one of a kind replaces it; what nobody says stays unsaid."""
    config: Any = SimpleNamespace(knowledge=Known.model_validate(own))
    assert Bare(config).resolve_knowledge(over).model_dump(exclude_unset=True) == told
    with pytest.raises(ValidationError):
        Bare(config).resolve_knowledge({"shape": {"no": 1}})
