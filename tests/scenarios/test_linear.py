"""Linear plants from scenario files: expressions, checks, the simulated truth and what the estimators are told.

The truth is compared with moments known in closed form, each with its Monte Carlo error."""

from __future__ import annotations

import math
import re
from copy import deepcopy
from typing import Any

import numpy as np
import pytest
from railstate.scenarios.errors import InputError
from railstate.scenarios.files import load, parse
from railstate.scenarios.linear.config import LinearConfig
from railstate.scenarios.linear.expressions import expression
from railstate.scenarios.linear.matrices import at_step
from railstate.scenarios.linear.setting import LinearSystem
from railstate.scenarios.randomness import Streams

from ..models import whole

TABLE: dict[str, Any] = {
    "name": "trial", "title": "Trial", "time": {"period": 1.0, "steps": 6},
    "plant": {
        "kind": "linear", "x0": [1.0, -2.0],
        "A": [[0.9, "0.3*cos(k)"], [0.0, 0.8]], "B": [[1.0, 0.5], [0.2, "1 + 0.1*k"]],
        "C": [[1.0, 0.0], [0.5, "sin(k)"], [0.0, 1.0]],
        "Q": [[0.5, 0.2], [0.2, "0.4 + 0.05*k"]], "R": [[0.3, 0.1, 0.0], [0.1, 0.2, 0.0], [0.0, 0.0, 0.4]],
        "P0": [[2.0, 0.6], [0.6, 1.0]]},
    "channel": {"kind": "random-access", "p": [0.25, 0.75], "nodes": [[0, 2], [1]]},
    "estimators": {"random-access": {"plugin": "random-access"}},
}


def changed(changes: dict[str, Any]) -> dict[str, Any]:
    """TABLE with dotted keys replaced."""
    table = deepcopy(TABLE)
    for key, value in changes.items():
        *heads, last = key.split(".")
        inner = table
        for head in heads:
            inner = inner.setdefault(head, {})
        inner[last] = value
    return table


def setting(**changes: Any) -> LinearSystem:
    return LinearSystem(LinearConfig.model_validate(changed({k.replace("__", "."): v for k, v in changes.items()})))


@pytest.mark.parametrize(("text", "value"), [
    ("0.95 + 0.05*sin(k)", lambda k: 0.95 + 0.05 * math.sin(k)),
    ("0.2*sin(0.05*pi*k)", lambda k: 0.2 * math.sin(0.05 * math.pi * k)),
    ("-k**2 / (1 + abs(-k)) % 3", lambda k: math.fmod(-(k**2) / (1 + k), 3)),
    ("2**-k * sqrt(4) + exp(0) - log(e)", lambda k: 2.0**-k * 2),
    (" +1e-3 ", lambda k: 1e-3),
    ("k" + 199 * " ", float),
])
def test_expressions_are_arithmetic_in_k(text, value):
    for k in range(8):
        assert expression(text)(k) == pytest.approx(value(k), rel=1e-14, abs=1e-15)


@pytest.mark.parametrize("text", [
    "__import__('os').getcwd()", "k.real", "(lambda: 1)()", "[1][0]", "x + 1", "sin(k, 2)", "sin(x=k)", "eval('1')",
    "", "1 +", "True", "1j", "'a'", "k if k else 1", "k < 2", "open", "k := 3", "1" * 201, "(" * 150 + "k",
    "k @ k", "k // 2", "f'{k}'", "*k", "sin.__self__", "1e", "k(1)", "1" + "0" * 198 + "_",
])
def test_anything_but_arithmetic_is_refused(text):
    with pytest.raises(ValueError, match=r"allowed|too long|too large"):
        expression(text)


@pytest.mark.parametrize("text", ["1/k", "9**9**9**9", "log(0)", "sqrt(-1)", "exp(1e9)", "(-8)**0.5", "1e999"])
def test_values_that_are_not_finite_name_the_step(text):
    with pytest.raises(ValueError, match="no finite value at k = 0"):
        expression(text)(0)


def test_a_matrix_a_step_equals_its_expression():
    text = at_step([[1.0, "cos(k)"], ["0.1*k", -2]])
    rows = at_step([[[1.0, math.cos(k)], [0.1 * k, -2]] for k in range(5)])
    for k in range(5):
        np.testing.assert_array_equal(text(k), rows(k))


@pytest.mark.parametrize(("changes", "message"), [
    ({"plant.A": [[1, 0], [0]]}, "plant.A: has rows of different lengths"),
    *(({"plant.A": rows}, "plant.A: must be a list of rows such as .*, or a list of such matrices") for rows in (
        [], [[]], [[1], []], [1, 2], [[[1]], [[]]], [[[1]], []])),
    ({"plant.A": [[1, 0, 0]] * 3}, "trial.toml: plant.A is 3 x 3, must be 2 x 2"),
    ({"plant.A": [["cos(q)", 0], [0, 1]]}, r"plant.A: entry \[0\]\[0\]: .*q is not allowed; allowed: numbers, k"),
    ({"plant.A": [[True, 0], [0, 1]]}, r"entry \[0\]\[0\]: True is neither"),
    ({"plant.A": [["1/(k-3)", 0], [0, 1]]}, "plant.A: .* has no finite value at k = 3"),
    ({"plant.A": [[[1, 0], [0, 1]]] * 6}, "plant.A lists 6 matrices; 7 are needed, for k = 0 .. 6"),
    ({"plant.A": [[[1, 0], [0, 1]], [[1]]] * 4}, "plant.A: lists matrices of different shapes"),
    ({"plant.Q": [[0.5, 0.1], [0.2, 0.4]]}, "plant.Q is a covariance and must be symmetric"),
    ({"plant.Q": [[0.5, 0.0], [0.0, "2 - k"]]}, "plant.Q at k = 3 must be positive semi-definite"),
    ({"plant.R": [[1, 0, 0], [0, 0, 0], [0, 0, 1]]}, "plant.R must be positive definite"),
    ({"plant.P0": [["1 + k", 0], [0, 1]]}, "plant.P0 is the covariance at k = 0"),
    ({"plant.x0": [0.0]}, "plant.A is 2 x 2, must be 1 x 1"),
    ({"plant.states": ["a"]}, "plant.states has 1 entries for 2 states"),
    ({"plant.states": ["a", "a"]}, "plant.states repeats a name"),
    ({"plant.D": [[1]]}, "plant.D: unknown key"),
    ({"channel.p": [0.5, 0.6]}, "p must sum to 1, but sums to 1.1"),
    ({"channel.p": [0.0, 1.0]}, r"channel.p.0: .*greater than 0"),
    ({"channel.p": [-0.5, 1.5]}, r"channel.p.0: .*greater than 0"),
    ({"channel.p": [1.0]}, "p has 1 probabilities for 2 nodes"),
    ({"channel.nodes": [[0, 2], [3]]}, "channel.nodes list the measurement elements 0, 2, 3, but there are 3"),
    ({"channel.nodes": [[0], [1]]}, "each element 0 .. 2 must belong to a node"),
    ({"channel.nodes": [[0, 2], [2]]}, "nodes share a measurement element"),
    ({"channel.nodes": [[0, 1, 2], []]}, "channel.nodes.1: .*at least 1"),
    ({"channel": {"kind": "ideal"}, "knowledge.p": [1.0]}, "knowledge.p are access probabilities"),
    ({"knowledge.p": [0.5, 0.4]}, "p must sum to 1"),
    ({"knowledge.C": [[1, 0]]}, "plant.R is 3 x 3, must be 1 x 1"),
    ({"estimators.random-access.knowledge.A": [[1]]}, "estimators.random-access.knowledge: plant.A is 1 x 1"),
])
def test_bad_scenarios_are_refused_with_the_field_and_what_is_allowed(changes, message):
    with pytest.raises(InputError, match=message):
        parse(changed(changes), "trial.toml")


def test_twenty_nodes_and_one_node_are_fine():
    for count in (1, 20):
        table = changed({
            "plant.C": [[1.0, 0.1 * i] for i in range(20)], "plant.R": np.eye(20).tolist(),
            "channel.p": [1 / count] * count,
            "channel.nodes": [[int(i) for i in part] for part in np.array_split(np.arange(20), count)]})
        world = LinearSystem(LinearConfig.model_validate(table)).world(Streams(1, "trial", "default", range(50)))
        assert set(np.unique(world.extra["node"])) == set(range(count))
        np.testing.assert_array_equal(world.received.sum(axis=1), 20 // count)


@pytest.mark.parametrize("index", ["departure", "arrival"])
def test_the_truth_has_the_moments_of_the_plant(index):
    """Mean and covariance of the state at every step against their recursion; 4.5 standard errors for 30 numbers."""
    runs = 4000
    plant = setting(plant__index=index)
    world = plant.world(Streams(3, "trial", index, range(runs)))
    A, B, Q = (at_step(TABLE["plant"][name]) for name in "ABQ")
    mean, P = np.array(TABLE["plant"]["x0"]), np.array(TABLE["plant"]["P0"])
    for step in range(1, 7):
        k = step if index == "arrival" else step - 1
        mean, P = A(k) @ mean, A(k) @ P @ A(k).T + B(k) @ Q(k) @ B(k).T
        x = world.truth[step - 1]
        assert np.all(np.abs(x.mean(axis=1) - mean) < 4.5 * np.sqrt(np.diag(P) / runs))
        deviation = x - mean[:, None]
        sample = deviation @ deviation.T / runs
        error = np.sqrt((np.outer(np.diag(P), np.diag(P)) + P**2) / runs)
        assert np.all(np.abs(sample - P) < 4.5 * error)


def test_measurement_noise_and_node_frequencies():
    runs = 4000
    world = setting().world(Streams(4, "trial", "default", range(runs)))
    C, R = at_step(TABLE["plant"]["C"]), np.array(TABLE["plant"]["R"])
    noise = np.concatenate([world.y[k] - C(k + 1) @ world.truth[k] for k in range(6)], axis=1)
    count = noise.shape[1]
    error = np.sqrt((np.outer(np.diag(R), np.diag(R)) + R**2) / count)
    assert np.all(np.abs(noise @ noise.T / count - R) < 4.5 * error)
    node = world.extra["node"]
    assert abs(np.mean(node == 1) - 0.75) < 4.5 * math.sqrt(0.25 * 0.75 / count)
    np.testing.assert_array_equal(world.received[:, 1], node == 1)
    for element in (0, 2):
        np.testing.assert_array_equal(world.received[:, element], node == 0)


def test_a_run_does_not_depend_on_its_batch():
    plant = setting()
    whole = plant.world(Streams(5, "trial", "default", range(40)))
    for runs in ([17], [3, 17, 39], list(range(7))):
        part = plant.world(Streams(5, "trial", "default", runs))
        for name in ("truth", "y", "received", "initial_mean"):
            np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[..., runs])


@pytest.mark.parametrize("index", ["departure", "arrival"])
def test_the_design_model_says_how_the_truth_moves(index):
    """Predictions from the true state leave the process noise, whose covariance is the model's Q, and no mean."""
    runs = 2000
    plant = setting(plant__index=index)
    world = plant.world(Streams(6, "trial", index, range(runs)))
    model = plant.design_model({}, world.initial_mean)
    for k in range(1, 6):
        left = world.truth[k] - model.transition(world.truth[k - 1], world.u[k], whole(k))
        Q = model.process_covariance(world.truth[k - 1], world.u[k], whole(k))[:, :, 0]
        error = np.sqrt((np.outer(np.diag(Q), np.diag(Q)) + Q**2) / runs)
        assert np.all(np.abs(left @ left.T / runs - Q) < 4.5 * error)
        np.testing.assert_allclose(model.measurement(world.truth[k], k + 1),
                                   at_step(TABLE["plant"]["C"])(k + 1) @ world.truth[k], rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(model.initial_covariance[:, :, 0], TABLE["plant"]["P0"])
    assert not model.linear.constant


def test_estimators_may_be_told_another_plant():
    plant, start = setting(), np.zeros((2, 1))
    told = plant.design_model({"p": [0.5, 0.5], "R": np.eye(3).tolist()}, start)
    assert told.reception.p == (0.5, 0.5)
    np.testing.assert_array_equal(told.linear.R(3), np.eye(3))
    own = plant.design_model({}, start)
    assert own.reception.p == (0.25, 0.75)
    np.testing.assert_array_equal(own.linear.A(2), told.linear.A(2))


@pytest.mark.parametrize("name", ["rap-example-1", "rap-example-2"])
def test_the_built_in_scenarios(name):
    scenario = load(name)
    usual = [variant for variant in scenario.variants if variant not in scenario.requested]
    assert usual == ["corrected", "printed"]
    for variant in usual:
        plant = scenario.setting(variant)
        assert [label for label, entry in plant.config.estimators.items() if entry.default] == [
            "random-access", "random-access-conditional"]
        assert [q.name for q in plant.quantities()] == [f"x{i + 1}" for i in range(len(plant.config.plant.x0))]


def test_units_and_names_are_the_files():
    plant = setting(plant__states=["position", "speed"], plant__units=["m", "m/s"])
    assert [(q.name, q.unit) for q in plant.quantities()] == [("position", "m"), ("speed", "m/s")]
    assert plant.design_model({}, np.zeros((2, 1))).states == ("position", "speed")


@pytest.mark.parametrize(("index", "shift"), [("departure", 0), ("arrival", 1)])
def test_the_truth_is_a_loop_over_the_streams_by_their_names(index, shift):
    found, again = (Streams(9, "trial", "default", range(3)) for _ in range(2))
    varying = [[0.3, 0.1, 0.0], [0.1, 0.2, 0.0], [0.0, 0.0, "0.4 + 0.1*k"]]
    world, motion = setting(plant__index=index, plant__R=varying).world(found), again("truth")
    plant = TABLE["plant"] | {"R": varying}
    A, B, C, Q, R, P0 = (at_step(plant[name]) for name in ("A", "B", "C", "Q", "R", "P0"))
    root = {name: (lambda k, M=M: (lambda d, v: v @ np.diag(np.sqrt(d)) @ v.T)(*np.linalg.eigh(M(k))))
            for name, M in (("Q", Q), ("R", R), ("P0", P0))}
    x = np.array(TABLE["plant"]["x0"])[:, None] + root["P0"](0) @ motion.normal(2)
    w, v = motion.normal(6, 2), again("measurement").normal(6, 3)
    for k in range(6):
        x = A(k + shift) @ x + B(k + shift) @ root["Q"](k + shift) @ w[k]
        np.testing.assert_allclose(world.truth[k], x, rtol=1e-12)
        np.testing.assert_allclose(world.y[k], C(k + 1) @ x + root["R"](k + 1) @ v[k], rtol=1e-12)


def test_extra_states_have_the_plants_own_numbers():
    """A disturbance for each column of B, a bias for each sensor, both as large as the noise of the first step."""
    extras, B = setting().extras({}), at_step(TABLE["plant"]["B"])
    assert [(one.name, one.kind, one.sd, one.instead, one.time_constant) for one in extras["disturbance"]] == [
        ("w1", "gauss-markov", math.sqrt(0.5), 1.0, 10.0), ("w2", "gauss-markov", math.sqrt(0.4), 1.0, 10.0)]
    for j, one in enumerate(extras["disturbance"]):
        assert one.gain is not None
        for k in range(3):
            np.testing.assert_array_equal(one.gain(whole(k)), B(k)[:, [j]])
    assert [(one.name, one.kind, one.sd, None if one.column is None else one.column.tolist())
            for one in extras["bias"]] == [("bias 1", "constant", math.sqrt(0.3), [1.0, 0.0, 0.0]),
                                           ("bias 2", "constant", math.sqrt(0.2), [0.0, 1.0, 0.0]),
                                           ("bias 3", "constant", math.sqrt(0.4), [0.0, 0.0, 1.0])]


@pytest.mark.parametrize(("name", "wrong", "message"), [
    ("Q", [[-0.5, 0.0], [0.0, 1.0]], "must be positive semi-definite; its least eigenvalue is -0.5"),
    ("Q", [[1.0, 0.1], [0.0, 1.0]], "is a covariance and must be symmetric"),
    ("R", np.diag([1.0, 0.0, 1.0]).tolist(), "must be positive definite; its least eigenvalue is 0")])
def test_every_step_of_a_covariance_is_looked_at(name: str, wrong: list[list[float]], message: str) -> None:
    """k = 0 .. 6 of six steps, and no further; fewer are refused."""
    good = np.eye(len(wrong)).tolist()
    for k in range(7):
        with pytest.raises(ValueError, match=rf"plant\.{name} at k = {k} {re.escape(message)}"):
            setting(**{f"plant__{name}": [*[good] * k, wrong, *[good] * (7 - k)]})
    setting(**{f"plant__{name}": [*[good] * 7, wrong]})
    with pytest.raises(ValueError, match=rf"plant\.{name} lists 6 matrices; 7 are needed, for k = 0 \.\. 6"):
        setting(**{f"plant__{name}": [good] * 6})
