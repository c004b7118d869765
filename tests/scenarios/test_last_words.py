"""What is refused seldom: guards of scenario files, matrices, channels, models and bounds, each with its whole words.

What is refused often stands in `tests/expected/refusals.txt`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import shapely
from railstate.estimators.ultimate_bound import lmi
from railstate.estimators.ultimate_bound.estimators import ConstantGain, FastestDecay
from railstate.estimators.ultimate_bound.gains import read_gain
from railstate.estimators.ultimate_bound.moments import mean_square
from railstate.scenarios.augmented import Extra, augmented
from railstate.scenarios.errors import InputError, Unsupported
from railstate.scenarios.files import load, parse
from railstate.scenarios.inheritance import Read, inherited, set_dotted, with_entry
from railstate.scenarios.linear.expressions import expression
from railstate.scenarios.model import DesignModel, Linear, grid_of, linear_model
from railstate.scenarios.recorded.places import _way
from railstate.scenarios.schema import Augment
from railstate.scenarios.setting import Setting

from ..conftest import SCENARIO


def metro(variant: str = "gaussian", **overrides: Any) -> Setting[Any]:
    return load("ningbo-metro", {key.replace("__", "."): value for key, value in overrides.items()}, variant
                ).setting(variant)


def linear(A: Any, C: Any = ((1.0, 0.0),), constant: bool = True) -> DesignModel:
    A, C = np.array(A), np.array(C)
    form = Linear(lambda k: A, lambda k: np.zeros((len(A), 0)), lambda k: np.zeros(len(A)), lambda k: C,
                  lambda k: np.eye(len(A)), lambda k: np.eye(len(C)), constant=constant)
    names = tuple(f"x{i}" for i in range(len(A)))
    return linear_model(form, states=names, measurements=("y",), period=1.0, initial_mean=np.zeros((len(A), 1)),
                        initial_covariance=np.eye(len(A))[:, :, None])


STORY: dict[str, tuple[Callable[[], Any], type[Exception], str]] = {
    "an override that is no table": (
        lambda: set_dotted({"time": {"period": 1.0}}, "time.period.x", 2), InputError,
        "--set time.period.x: time.period is not a table"),
    "one at the top": (lambda: set_dotted({"name": "a"}, "name.x", 2), InputError, "--set name.x: name is not a table"),
    "a fault without a key": (lambda: set_dotted({}, "faults.jump", 2), InputError,
                              "--set faults.jump: names no key of a fault, such as faults.outliers.share"),
    "two faults of a name": (
        lambda: with_entry([{"kind": "jump"}, {"kind": "stuck"}, {"kind": "drift", "name": "jump"}], "jump", dict),
        InputError, "faults.jump: two entries are called so: give each a name of its own"),
    "a fault of no kind": (
        lambda: with_entry([{"kind": "jump", "name": "a"}, {"kind": "jump"}], "b", dict), InputError,
        "faults.b: no such entry and no such kind; allowed: a, jump, "),
    "variants that are no tables": (
        lambda: parse({"name": "a", "variants": {"calm": 3}}, "a.toml"), InputError,
        "a.toml: variants must be tables such as [variants.NAME]"),
    "no variants": (lambda: parse({"name": "a", "variants": {}}, "a.toml"), InputError,
                    "a.toml: variants must be tables such as [variants.NAME]"),
    "a model without modes": (lambda: grid_of(linear(np.eye(2)), "he"), Unsupported,
                              "he needs modes that are values of a parameter on a grid, a linear model for each"),
    "headways that round to one": (
        lambda: load("cbtc-csma", {"headway.speeds": [18.05, 18.06]}), InputError,
        "headway: speeds must differ by 1 km/h or more"),
    "a gain that is empty": (lambda: read_gain("empty.csv"), InputError,
                             "empty.csv: is empty; a gain has one row of numbers a line"),
    "a plant that changes": (lambda: ConstantGain.require(linear(np.eye(2), constant=False)), Unsupported,
                             "ConstantGain needs a plant that does not change with time"),
    "a plant without an inverse": (
        lambda: FastestDecay.require(linear([[1.0, 1.0], [1.0, 1.0]])), Unsupported,
        "FastestDecay needs "),
    "moments of many states": (
        lambda: mean_square(SimpleNamespace(A=np.eye(33)), np.eye(33)),  # pyright: ignore[reportArgumentType]
        Unsupported, "exact second moments are computed for up to 32 states, here are 33"),
    "densities of other sensors": (
        lambda: metro(sensors__use=["position", "speed", "radar"], knowledge__densities="uniform").design_model(
            {}, np.zeros((2, 1))), Unsupported,
        'densities = "uniform" needs the sensors of position and speed, and no other'),
    "densities of one sensor": (
        lambda: metro(sensors__use=["speed"], knowledge__densities="uniform").design_model({}, np.zeros((2, 1))),
        Unsupported, 'densities = "uniform" needs the sensors of position and speed, and no other'),
    "a track with a hole": (
        lambda: _way([shapely.LineString([[0, 0], [10, 0]]), shapely.LineString([[500, 0], [510, 0]])],
                     shapely.LineString([[0, 0], [510, 0]]), shapely.points([0, 510], [0, 0])), ValueError,
        "the track's pieces do not connect where the recording begins with where it ends")}


BASE = "a.toml: base: must be a scenario's name, NAME/VARIANT or the path of a TOML file"
WHOLE: dict[str, tuple[Callable[[], Any], str]] = {
    "two ways of entering": (
        lambda: Extra("bias", "m", "walk", 1.0, column=np.ones(1), input=0),
        "bias: an extra state takes exactly one of gain, column, input"),
    "no way": (lambda: Extra("bias", "m", "walk", 1.0),
               "bias: an extra state takes exactly one of gain, column, input"),
    "no time constant": (lambda: Extra("bias", "m", "gauss-markov", 1.0, column=np.ones(1)),
                         'bias: kind = "gauss-markov" needs a time_constant in s'),
    "a scale on no input": (
        lambda: augmented(linear(np.eye(2)), [Extra("scale", "1", "walk", 1.0, input=0)]),
        "a scale on an input needs the design model's input_jacobian: this setting gives none"),
    "a walk without a start": (lambda: metro().chosen({}, {"disturbance": Augment(kind="walk")}),
                               'augment.disturbance: kind = "walk" needs a start_sd in m/s^2'),
    "an extra state that there is not": (
        lambda: metro().chosen({}, {"wind": Augment(kind="walk")}),
        "augment.wind: there is no such extra state here; allowed: disturbance, position-bias, speed-bias"),
    "a long expression": (lambda: expression("1" * 201), "an expression of 201 characters is too long; at most 200"),
    "an expression at its end": (lambda: expression("1/(k-3)")(3), '"1/(k-3)" has no finite value at k = 3'),
    "a base that is no text": (lambda: inherited(Read("a.toml", Path(), {"base": 3})),
                               f"{BASE} (got 3)"),
    "a base that is empty": (lambda: inherited(Read("a.toml", Path(), {"base": ""})),
                             f"{BASE} (got '')"),
    "a function of the first edition": (
        lambda: replace(linear(np.eye(2)), transition=lambda x, u, k, portion: x),
        "DesignModel.transition(x, u, k, portion) is of railstate's first edition: write transition(x, u, interval), "
        "with interval.length in seconds, interval.share of the step's input and interval.depart for k; "
        "measurement_covariance(measurement) likewise, with measurement.step for k"),
    "infinite gains": (lambda: read_gain("infinite.csv"), "infinite.csv: a gain must have only finite numbers"),
    "no gains": (lambda: read_gain("none.csv"),
                 "none.csv: there is no such file, neither here nor beside the built-in scenarios"),
}


@pytest.mark.parametrize("what", WHOLE)
def test_what_is_said_in_whole(what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("infinite.csv").write_text("1.0,inf\n")
    call, words = WHOLE[what]
    with pytest.raises((InputError, ValueError)) as caught:
        call()
    assert str(caught.value) == words


@pytest.mark.parametrize("what", STORY)
def test_what_is_said(what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("empty.csv").write_text("")
    call, kind, words = STORY[what]
    with pytest.raises(kind) as caught:
        call()
    assert words in str(caught.value), str(caught.value)


def test_several_nodes_need_exact_probabilities() -> None:
    spread = [lmi.Node((i,), 0.5, 0.1, 0.25, 1.0) for i in range(2)]
    system = lmi.ErrorSystem(np.eye(2), np.eye(2), np.eye(2), np.eye(2), np.ones(2), np.eye(2), tuple(spread), None)
    with pytest.raises(ValueError, match=r"several nodes need exact probabilities \(spread 0\)"):
        lmi.ultimate_bound(system, 0.9)


def test_a_track_goes_through_its_pieces() -> None:
    """Of two ways the shorter one, whichever way round a piece is drawn; where both ends are on one piece, that."""
    def line(*corners: tuple[float, float]) -> shapely.LineString:
        return shapely.LineString(corners)

    pieces = [line((0, 0), (100, 0)), line((200, 0), (100, 0)), line((100, 0), (150, 80), (200, 0)),
              line((200, 0), (300, 0))]
    trail = line((0, 1), (150, 1), (300, 1))
    for ends, corners in (([5, 295], [0, 100, 200, 300]), ([295, 5], [300, 200, 100, 0])):
        found = _way(pieces, trail, shapely.points(ends, [1, 1]))
        assert list(dict.fromkeys(found.coords)) == [(x, 0) for x in corners] and found.length == 300
    assert _way(pieces, trail, shapely.points([5, 60], [1, 1])) is pieces[0]


def test_what_is_said_anew_over_a_base_is_neither_fitted_nor_of_its_origin(tmp_path: Path) -> None:
    base = SCENARIO.replace("[time]", 'fitted = ["plant.Q", "plant.R", "channel.p"]\n[time]') + (
        '[origin]\n"plant.Q" = "guessed"\n"plant.R" = "measured"\n')
    (tmp_path / "base.toml").write_text(base)
    (tmp_path / "top.toml").write_text('name = "top"\nbase = "base.toml"\n[plant]\nQ = [[0.5]]\n[channel]\np = 0.5\n')
    found = load(str(tmp_path / "top.toml")).variants["calm"]
    assert found["fitted"] == ["plant.R"]
    assert found["origin"] == {"plant.R": "measured", "plant.Q": f"set in {tmp_path}/top.toml"}
    below = load(str(tmp_path / "base.toml")).variants["calm"]
    assert below["fitted"] == ["plant.Q", "plant.R", "channel.p"] and below["origin"]["plant.Q"] == "guessed"
