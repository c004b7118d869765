"""The coupled cars: matrices and motion against independent computations, the channel's and headway's known answers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter
from railstate.benchmarks.running.drive import drive, prepare
from railstate.estimators.registry import estimators
from railstate.scenarios.channels import Channel
from railstate.scenarios.coupled_cars.config import Command, of_cars
from railstate.scenarios.coupled_cars.plant import largest_force, matrices, simulate
from railstate.scenarios.coupled_cars.setting import CoupledCars
from railstate.scenarios.errors import InputError
from railstate.scenarios.files import load
from railstate.scenarios.randomness import Streams
from scipy.integrate import solve_ivp


def setting(variant: str = "uniform", **overrides: Any) -> CoupledCars:
    changes = {key.replace("__", "."): value for key, value in overrides.items()}
    found = load("cbtc-csma", changes).setting(variant)
    assert isinstance(found, CoupledCars)
    return found


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RAILSTATE_CACHE", str(tmp_path_factory.getbasetemp() / "designs"))


@pytest.mark.parametrize("masses", [[80e3, 80e3], [80e3, 40e3, 60e3], [80e3, 40e3, 40e3, 40e3, 40e3, 80e3]])
def test_one_step_is_newtons_equations(masses: list[float]) -> None:
    n, k, free, period = len(masses), 80e3, 21.0, 0.1
    m = np.array(masses)
    random = np.random.default_rng(3)
    start = np.concatenate([free * np.arange(n)[::-1] + random.normal(0, 0.3, n), random.normal(10, 1, n)])
    u, f = random.normal(0, 2e4, n), random.normal(0, 1e4, n)

    def motion(t: float, state: np.ndarray) -> np.ndarray:
        x, v = state[:n], state[n:]
        coupler = np.array([k * (x[i] - x[i + 1] - free) for i in range(n - 1)])
        force = u - f
        force[:-1] -= coupler
        force[1:] += coupler
        return np.concatenate([v, force / m])

    found = matrices(m, k, free, list(range(n)), period)
    exact = solve_ivp(motion, (0, period), start, rtol=1e-12, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(found.A @ start + found.B @ u + found.E @ f + found.h, exact, rtol=0, atol=1e-9)


def test_motion_is_the_textbook_loop() -> None:
    n, steps, runs = 3, 60, 4
    masses = np.array([80e3, 40e3, 80e3])
    plant = matrices(masses, 80e3, 21.0, [0, 2], 0.1)
    force = np.full((steps, 2), 2.8e4)
    force[30:] = -9e4  # until the cars roll back: the resistive force must turn round too
    phase = np.linspace(0, 0.9, runs)
    truth = np.zeros((steps, 2 * n, runs))
    truth[0, :n] = 21.0 * np.arange(n)[::-1, None]
    c0, c1, c2, ramp, length = 0.01, 8e-4, 1.6e-5, 900.0, 50.0
    simulate(plant.A, plant.B, plant.E, plant.h, force, masses, c0, c1, c2, ramp, length, phase, truth)
    assert truth[:, n:].min() < 0 < truth[:, n:].max()
    for s in range(runs):
        x = truth[0, :, s]
        for k in range(1, steps):
            v = x[n:]
            resistive = np.sign(v) * (c0 + c1 * np.abs(v)) * masses
            resistive[0] += np.sign(v[0]) * c2 * masses.sum() * v[0] ** 2
            turn = x[:n] / length + phase[s]
            resistive += ramp * (4 * np.abs(turn - np.floor(turn + 0.5)) - 1)
            x = plant.A @ x + plant.B @ force[k] - -plant.E @ resistive + plant.h
            np.testing.assert_allclose(truth[k, :, s], x, rtol=0, atol=1e-9)


def test_a_run_does_not_depend_on_its_neighbours() -> None:
    found = setting(time__steps=300, disturbance__ramp=2000.0)
    together = found.world(Streams(5, "cbtc-csma", "uniform", range(9)))
    for runs in ([4], [8, 2, 4]):
        some = found.world(Streams(5, "cbtc-csma", "uniform", runs))
        for part in ("truth", "u", "y", "received", "initial_mean"):
            np.testing.assert_array_equal(getattr(some, part), getattr(together, part)[..., runs])
    assert np.ptp(together.truth[-1, 0]) > 0  # the ramp lies elsewhere in each run


def test_input_is_that_of_the_interval_that_ends_at_the_step() -> None:
    world = setting().world(Streams(0, "cbtc-csma", "uniform", [0]))
    assert world.steps == 9921
    assert world.lengths[0] == 0.0 and (world.lengths[1:] == 0.1).all()  # s
    end, middle = world.u[:, 0, 0], world.u[:, 1, 0]
    for k, force in ((1, 2.8e4), (3000, 2.8e4), (3001, 2.48e4), (6250, 2.48e4), (6251, -0.28e4), (9920, -0.28e4)):
        assert (end[k], middle[k]) == (force, force / 2)
    np.testing.assert_array_equal(world.truth[0, :, 0], [105, 84, 63, 42, 21, 0] + [0] * 6)
    np.testing.assert_array_equal(world.initial_mean, world.truth[0])


def test_the_believed_start() -> None:
    """Off the truth by uniform errors of either kind, of a stream of its own; nowhere where it is not known at all."""
    streams = Streams(3, "cbtc-csma", "uniform", [4, 9])
    off = setting(plant__start_error=[2.0, 0.5], time__steps=3).world(streams)
    drawn = Streams(3, "cbtc-csma", "uniform", [4, 9])("start").uniform(-1.0, 1.0, 12)
    np.testing.assert_array_equal(off.initial_mean - off.truth[0],
                                  off.truth[0] + np.repeat([[2.0], [0.5]], 6, axis=0) * drawn - off.truth[0])
    nowhere = setting(plant__start="zero", plant__start_error=[0.0, 0.5], time__steps=3).world(streams)
    np.testing.assert_array_equal(nowhere.initial_mean, np.repeat([[0.0], [0.5]], 6, axis=0) * drawn)


def test_push_pull_drives_the_end_cars_only() -> None:
    both, ends = setting().design_model({}, np.zeros((12, 1))), setting("push-pull").design_model({}, np.zeros((12, 1)))
    assert both.linear is not None and ends.linear is not None
    np.testing.assert_array_equal(ends.linear.B(0), both.linear.B(0)[:, [0, 5]])


@pytest.mark.parametrize("variant", ["uniform", "table3", "push-pull"])
def test_known_bounds_cover_the_true_force(variant: str) -> None:
    found = setting(variant)
    law, n = found.config.disturbance, found.cars
    speeds = found.world(Streams(0, "cbtc-csma", variant, [0])).truth[:, n:, 0]
    forces = (law.law[0] + law.law[1] * np.abs(speeds)) * found.config.plant.mass
    forces[:, 0] += law.law[2] * found.config.plant.mass.sum() * speeds[:, 0] ** 2
    bounds = found.design_model({}, np.zeros((12, 1))).bounds
    assert bounds is not None
    assert (forces <= bounds.w_bar).all()


def test_delta_is_remark_2_or_scaled_to_what_is_asked() -> None:
    masses = np.array([80e3, 40e3, 80e3])
    delta = largest_force(masses, 0.01, 8e-4, 1.6e-5, 500.0, 50.0)
    np.testing.assert_allclose(delta, [0.05 * 80e3 + 500 + 1.6e-5 * 200e3 * 2500, 0.05 * 40e3 + 500, 0.05 * 80e3 + 500])
    own = setting().design_model({}, np.zeros((12, 1))).bounds
    scaled = setting(knowledge__delta=7e5).design_model({}, np.zeros((12, 1))).bounds
    assert own is not None and scaled is not None
    assert np.linalg.norm(scaled.w_bar) == pytest.approx(7e5)
    np.testing.assert_allclose(scaled.w_bar / own.w_bar, scaled.w_bar[0] / own.w_bar[0])


def test_what_is_known_of_the_channel() -> None:
    """pbar, p^, Delta's of section IV: 0.3125, 0.1796875, 0.1875, 0.0703125; epsilon 0.5."""
    for variant in ("uniform", "table3", "one-train", "three-trains"):
        told = setting(variant).design_model({}, np.zeros((12, 1))).reception
        assert told is not None
        assert (told.p_low, told.p_high, told.variance) == (0.125, 0.5, 0.1796875 + 0.0703125)
    alone = setting(channel__trains=2).design_model({}, np.zeros((12, 1))).reception
    assert alone is not None and (alone.p_low, alone.p_high) == (0.25, 0.25)


def test_random_access_lets_one_car_report_each_step() -> None:
    for cars in (2, 6, 7):
        found = setting("random-access", plant__cars=cars, time__steps=500)
        received = found.world(Streams(0, "cbtc-csma", "random-access", range(3))).received
        np.testing.assert_array_equal(received[:, :cars], received[:, cars:])
        assert (received[:, :cars].sum(axis=1) == 1).all()
        assert received.any(axis=0).all()


def test_any_number_of_cars() -> None:
    for cars in (2, 9):
        for variant in load("cbtc-csma").variants:
            found = setting(variant, plant__cars=cars, time__steps=20)
            world = found.world(Streams(0, "cbtc-csma", variant, [0]))
            assert world.truth.shape == (20, 2 * cars, 1)
            assert found.config.plant.mass.tolist() == [80e3, *[40e3] * (cars - 2), 80e3]
            assert found.batch_bytes() >= sum(getattr(world, p).nbytes for p in ("truth", "u", "y", "received"))


def test_headway_decodes_table_iv() -> None:
    """Published times and the errors they stand for: 1.7 .. 2.05 m of the estimator, 127 .. 159 m held measurements."""
    found = setting()
    published = (((33.309, 31.362, 30.049, 29.113), (1.6, 2.15)), ((40.309, 37.004, 35.003, 34.124), (126, 160)))
    for times, errors in published:
        for name, speed, time in zip((65, 81, 97, 113), (64.857, 81.071, 97.285, 113.499), times, strict=True):
            error = (time - 23.5) * speed / 3.6 - 175
            assert errors[0] < error < errors[1]
            out = found.outcomes(None, {("max", "position-front"): np.array([error])})
            assert out["headway", f"headway-{name}", "s"][0] == pytest.approx(time, abs=1e-9)
            assert out["trains-per-hour", f"headway-{name}", "1/h"][0] == pytest.approx(3600 / time)


@pytest.mark.parametrize(("variant", "label", "low", "high"), [
    ("one-train", "direct", 1500, 1700),
    ("table3", "direct", 1600, 1800),
    ("table3", "ultimate-bound-published", 235, 265),
    ("three-trains", "ultimate-bound-published", 255, 275),
    ("one-train", "ultimate-bound-published", 112, 120),
])
def test_sums_of_the_page(variant: str, label: str, low: float, high: float) -> None:
    """Sum of |z~|^2 over the run: the mean of 16 runs is inside the page's range to three standard errors."""
    found, runs = setting(variant), 16
    streams = Streams(1, "cbtc-csma", variant, range(runs))
    world = found.world(streams)
    entry = found.config.estimators[label]
    estimator, model = prepare(found, estimators()[entry.plugin], entry.parameters, entry.knowledge, world.initial_mean)
    estimator.design(model)
    metrics = drive(found, world, estimator, model, streams("estimator", label)).scored.metrics
    sums = metrics["sum-squared", "weighted"]
    error = 3 * sums.std(ddof=1) / np.sqrt(runs)
    assert low - error < sums.mean() < high + error
    assert error < (high - low)
    if ("bound", "performance") in metrics:
        assert (metrics["mean-square", "performance"] < metrics["bound", "performance"]).all()
    if (variant, label) == ("one-train", "ultimate-bound-published"):
        assert 1.5 < metrics["max", "position-front"].mean() < 2.5


@pytest.mark.parametrize(("key", "value", "message"), [
    ("plant.cars", 1, "plant.cars"),
    ("plant.masses", [1.0, 2.0], "one each"),
    ("plant.commands", [{"start": 5, "end": 1.0, "middle": 1.0}], "start at step 0"),
    ("knowledge.theta", 1.0, "knowledge.theta"),
    ("knowledge.trains", [3, 1], "least <= most"),
    ("disturbance.c3", 1.0, "disturbance.c3: unknown key"),
])
def test_bad_input_names_the_field(key: str, value: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        load("cbtc-csma", {key: value})


def test_forces_of_the_cars_that_are_driven() -> None:
    plant = setting().config.plant.model_copy(update={"cars": 4, "commands": [
        Command(start=0, end=1.0, middle=2.0), Command(start=2, end=3.0, middle=4.0)]})
    assert plant.driven == [0, 1, 2, 3] and plant.forces(5).tolist() == [
        [0, 0, 0, 0], [1, 2, 2, 1], [1, 2, 2, 1], [3, 4, 4, 3], [3, 4, 4, 3]]
    ends = plant.model_copy(update={"drive": "push-pull"})
    assert ends.driven == [0, 3] and ends.forces(4).tolist() == [[0, 0], [1, 1], [1, 1], [3, 3]]


@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize(("own", "nodes"), [((), [[0, 2], [1, 3]]), ([[0], [1, 2, 3]], [[0], [1, 2, 3]])])
def test_each_car_is_a_node_where_none_are_given(late: bool, own: Any, nodes: list[list[int]]) -> None:
    inner = {"kind": "round-robin", **({"nodes": own} if own else {})}
    channel: Any = TypeAdapter(Channel).validate_python({"kind": "delay", "steps": 1, "loss": inner} if late else inner)
    found: Any = of_cars(channel, 2)
    assert [list(node) for node in (found.loss if late else found).nodes] == nodes
    other: Any = TypeAdapter(Channel).validate_python({"kind": "bernoulli", "p": 0.5})
    assert of_cars(other, 2) is other
