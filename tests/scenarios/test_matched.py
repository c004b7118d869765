"""The models that bound every estimator, and the extra states that settings offer: each number from the file's own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from railstate.scenarios.augmented import Extra
from railstate.scenarios.files import load
from railstate.scenarios.linear.config import LinearConfig
from railstate.scenarios.linear.setting import LinearSystem
from railstate.scenarios.measurement import untold
from railstate.scenarios.registry import scenario_files
from railstate.scenarios.setting import Setting

from ..expected import digest
from ..models import part, whole

INTO = np.array([0.02, 0.2])
"""What 1 m/s^2 does to the metro's position and speed in a step of 0.2 s."""


def metro(variant: str, **overrides: Any) -> Setting[Any]:
    return load("ningbo-metro", {key.replace("__", "."): value for key, value in overrides.items()}, variant
                ).setting(variant)


@pytest.mark.parametrize(("variant", "noise", "kind", "w", "v"), [
    ("gaussian", "gaussian", "floor", 0.05, 3.0), ("gaussian", "uniform", "linear optimum", 0.05, 3**0.5),
    ("white", "gaussian", "linear optimum", 0.15 / 3**0.5, 3.0),
    ("white", "uniform", "linear optimum", 0.15 / 3**0.5, 3**0.5),
    ("constant", "uniform", "linear optimum", 0.15, 3**0.5)])
def test_what_bounds_the_metro(variant: str, noise: str, kind: str, w: float, v: float) -> None:
    found = metro(variant, sensors__noise=noise).matched(2)
    assert found is not None and (found.kind, found.outward, found.beyond) == (kind, None, None)
    model, extra = found.model, variant == "constant"
    assert model.process_covariance is not None and model.measurement_covariance is not None
    size = 3 if extra else 2
    Q, P = np.zeros((size, size)), np.diag([4 / 3, 0.09 / 3, w * w][:size])
    Q[:2, :2] = 0.0 if extra else w * w * np.outer(INTO, INTO)
    found_Q = model.process_covariance(model.initial_mean, np.zeros((1, 2)), whole(0, 0.2))[:, :, 0]
    np.testing.assert_allclose(found_Q, Q, rtol=0, atol=1e-15)
    np.testing.assert_allclose(model.initial_covariance[:, :, 0], P, rtol=1e-12)
    np.testing.assert_allclose(model.measurement_covariance(untold(1, 2))[:, :, 0],
                               np.diag([1.0, 0.04]) / v**2, rtol=1e-12)
    assert model.initial_mean.shape == (size, 2) and (model.initial_mean == model.initial_mean[:, :1]).all()
    assert model.initial_mean[:2, 0].tolist() == list(metro(variant).start)  # pyright: ignore


@pytest.mark.parametrize(("variant", "changes"), [
    ("switching", {}), ("sinusoid", {}), ("physical", {}), ("white", {"sensors__noise": "biased"}),
    ("white", {"sensors__use": ["position"]}), ("white", {"sensors__use": ["position", "speed", "balise"]}),
    ("white", {"plant__loads": [200000.0]})])
def test_metros_that_have_no_bound(variant: str, changes: dict[str, Any]) -> None:
    assert metro(variant, **changes).matched(2) is None


def plain(extra: Extra) -> tuple[Any, ...]:
    return (extra.name, extra.unit, extra.kind, extra.start_sd, extra.mean, extra.time_constant, extra.input,
            extra.instead, extra.bound)


def test_extra_states_of_the_metro() -> None:
    found = metro("switching").extras({"sigma_w": 0.3, "sigma_v": [0.5, 0.25]})
    assert list(found) == ["disturbance", "position-bias", "speed-bias"]
    (force,), (place,), (pace,) = found.values()
    assert plain(force) == ("disturbance", "m/s^2", "gauss-markov", None, 0.0, 8.0, None, 1.0, None) and force.sd == 0.3
    assert force.gain is not None and np.allclose(force.gain(whole(0, 0.2))[:, 0], INTO)
    assert np.allclose(force.gain(part(0, np.array([0.5, 0.0]), 0.2)), [[0.005, 0.0], [0.1, 0.0]])
    for bias, unit, sd, column in ((place, "m", 0.5, [1.0, 0.0]), (pace, "m/s", 0.25, [0.0, 1.0])):
        assert plain(bias) == (bias.name, unit, "gauss-markov", None, 0.0, 20.0, None, 0.0, None) and bias.sd == sd
        assert bias.column is not None and bias.column.tolist() == column
    only = metro("switching", sensors__use=["speed", "balise"]).extras({})
    assert list(only) == ["disturbance", "speed-bias"] and only["speed-bias"][0].column is not None
    assert only["speed-bias"][0].column.tolist() == [1.0, 0.0]


PLANT: dict[str, Any] = {"kind": "linear", "x0": [1.0, 2.0], "A": [[1, "k"], [0, 1]], "B": [["1 + k", 2], [0, 3]],
                         "C": [[1, 0], [1, 1], [0, 2]], "Q": [[4, 1], [1, 9]], "P0": [[1, 0], [0, 4]],
                         "R": [["16 + 9*k", 0, 0], [0, 4, 0], [0, 0, 0.25]]}


def linear(knowledge: dict[str, Any] | None = None, **plant: Any) -> LinearSystem:
    return LinearSystem(LinearConfig.model_validate({
        "name": "a", "title": "A", "time": {"period": 0.5, "steps": 3}, "plant": {**PLANT, **plant},
        "channel": {"kind": "bernoulli", "p": 0.5}, "estimators": {"kalman": {"plugin": "kalman"}},
        **({"knowledge": knowledge} if knowledge else {})}))


@pytest.mark.parametrize(("index", "shift"), [("departure", 0), ("arrival", 1)])
def test_what_bounds_a_linear_plant(index: str, shift: int) -> None:
    setting = linear(index=index)
    found = setting.matched(2)
    form, B = found.model.linear, np.array([[4.0 + shift, 2.0], [0.0, 3.0]])
    assert (found.kind, found.outward, found.beyond) == ("floor", None, None) and form is not None
    assert form.A(3).tolist() == [[1.0, 3.0 + shift], [0.0, 1.0]] and not form.constant and form.steps is None
    np.testing.assert_allclose(form.Q(3), B @ np.array(PLANT["Q"], dtype=float) @ B.T)
    assert form.C(3).tolist() == PLANT["C"] and form.R(3)[0, 0] == 43.0 and form.h(3).tolist() == [0.0, 0.0]
    assert form.B(3).shape == (2, 0) and found.model.initial_mean.tolist() == [[1.0, 1.0], [2.0, 2.0]]
    assert found.model.initial_covariance[:, :, 0].tolist() == PLANT["P0"] and found.model.period == 0.5
    assert found.model.reception is not None and found.model.reception.p_low == 0.5


def test_sensors_and_extra_states_of_a_linear_plant() -> None:
    setting = linear(index="arrival")
    assert setting.sensing().names == ("y1", "y2", "y3")
    np.testing.assert_allclose(setting.sensing().sd, [[5.0, 2.0, 0.5], [34**0.5, 2.0, 0.5], [43**0.5, 2.0, 0.5]])
    assert linear(R=[[16, 0, 0], [0, 4, 0], [0, 0, 0.25]]).sensing().sd.tolist() == [4.0, 2.0, 0.5]
    found = setting.extras({})
    assert [[extra.name for extra in each] for each in found.values()] == [["w1", "w2"], ["bias 1", "bias 2", "bias 3"]]
    for j, (extra, sd, gain) in enumerate(zip(found["disturbance"], (2.0, 3.0), ([[4.0], [0.0]], [[2.0], [3.0]]),
                                              strict=True)):
        assert plain(extra) == (f"w{j + 1}", "1", "gauss-markov", None, 0.0, 5.0, None, 1.0, None) and extra.sd == sd
        assert extra.gain is not None and extra.gain(whole(2, 0.5)).tolist() == gain
    for i, (extra, sd) in enumerate(zip(found["bias"], (4.0, 2.0, 0.5), strict=True)):
        assert plain(extra) == (f"bias {i + 1}", "1", "constant", None, 0.0, None, None, 0.0, None) and extra.sd == sd
        assert extra.column is not None and extra.column.tolist() == np.eye(3)[i].tolist()


def test_extra_states_of_every_setting(expected: Callable[[str, str], None]) -> None:
    """Whatever is offered, with how it enters over a whole step."""
    said = list[str]()
    for name, path in scenario_files().items():
        scenario = load(name)
        setting = scenario.setting(scenario.default)
        if setting.needs_file:
            continue
        for offered, extras in setting.extras({}).items():
            for extra in extras:
                ways = [digest(extra.gain(whole(3, setting.config.time.period)))] if extra.gain else []
                ways += [] if extra.column is None else [digest(extra.column)]
                said.append(f"{path.stem} {offered}: {plain(extra)} {extra.sd:.6g} {' '.join(ways)}".rstrip())
    expected("extra-states", "\n".join(said))
