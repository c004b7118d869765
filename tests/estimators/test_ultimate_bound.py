"""Ultimate bounds: the LMIs against the paper's printed form, the inequality they certify, and published numbers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
from railstate.estimators.ultimate_bound import decay as lmi_decay
from railstate.estimators.ultimate_bound import lmi
from railstate.estimators.ultimate_bound.estimators import FastestDecay, FixedGain, UltimateBound
from railstate.estimators.ultimate_bound.gains import read_gain
from railstate.estimators.ultimate_bound.lmi import Certificate, ErrorSystem
from railstate.estimators.ultimate_bound.system import error_system
from railstate.scenarios.errors import Infeasible, InputError, Unsupported
from railstate.scenarios.files import load
from railstate.scenarios.model import DesignModel, Reception
from railstate.scenarios.randomness import RunRandom

from ..models import heard, whole

PUBLISHED = "zou2018_gain.csv"


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("RAILSTATE_CACHE", str(tmp_path / "designs"))
    return tmp_path / "designs"


def model(variant: str = "uniform", cars: int = 2, runs: int = 1, **told: Any) -> DesignModel:
    overrides = {"plant.cars": cars, "time.steps": 5, **{f"knowledge.{key}": value for key, value in told.items()}}
    return load("cbtc-csma", overrides).setting(variant).design_model({}, np.zeros((2 * cars, runs)))


def system(variant: str = "uniform", cars: int = 2, **told: Any) -> ErrorSystem:
    return error_system(model(variant, cars, **told))


def printed(system: ErrorSystem, theta: float) -> float:
    """Corollary 1 as the paper prints it, (23) to (26), in coordinates M x and with forces scaled."""
    (node,) = system.nodes
    T, size = system.M, float(np.linalg.norm(system.delta))
    inverse = np.linalg.inv(T)
    A, C, E = T @ system.A @ inverse, system.C @ inverse, T @ system.E * size
    rows = np.diag(1 / np.linalg.norm(C, axis=1))
    C, root, unit = rows @ C, rows @ system.noise_root, inverse.T @ inverse
    nx, nf = E.shape
    P, Q = cp.Variable((nx, nx), symmetric=True), cp.Variable((nx, nx), symmetric=True)
    Y, one, two = cp.Variable((nx, nx)), cp.Variable(nonneg=True), cp.Variable(nonneg=True)
    Z = np.zeros
    X14 = A.T @ P - node.mean * (Y @ C).T
    Xi = cp.bmat([
        [node.spread**2 * one * unit - theta * P, Z((nx, nx)), Z((nx, nf)), X14, (Y @ C).T],
        [Z((nx, nx)), -one * unit, Z((nx, nf)), -(Y @ C).T, Z((nx, nx))],
        [Z((nf, nx)), Z((nf, nx)), -two * np.eye(nf), E.T @ P, Z((nf, nx))],
        [X14.T, -Y @ C, P @ E, -P, Z((nx, nx))],
        [Y @ C, Z((nx, nx)), Z((nx, nf)), Z((nx, nx)), -P / node.variance]])
    problem = cp.Problem(cp.Minimize(node.largest * cp.trace(Q) + two), [
        (Xi + Xi.T) / 2 << 0, cp.bmat([[-Q, (Y @ root).T], [Y @ root, -P]]) << 0, P >> np.eye(nx)])
    problem.solve(solver="CLARABEL")
    assert problem.status == "optimal"
    return float(problem.objective.value) / (1 - theta)


def check_inequality(system: ErrorSystem, found: Certificate, samples: int = 400) -> None:
    """E V(k+1) <= theta V(k) + (1 - theta) bound and |z|^2 <= V, straight from the error's dynamics (11)."""
    random = np.random.default_rng(7)
    nx, ny = system.C.shape[1], system.C.shape[0]
    P, K, noise = found.P, found.K, system.noise_root @ system.noise_root.T
    assert np.linalg.eigvalsh(P - system.M.T @ system.M)[0] > -1e-7 * np.linalg.eigvalsh(P)[-1]
    level = np.linalg.cholesky(np.linalg.inv(P))  # V(level v) = |v|^2
    for _ in range(samples):
        e = level @ random.normal(size=nx) * np.sqrt(found.bound) * 10 ** random.uniform(-2, 2)
        f = random.choice([-1.0, 1.0], len(system.delta)) * system.delta
        drift = system.A @ e + system.E @ f
        ways: list[list[tuple[float, np.ndarray]]] = []
        if len(system.nodes) > 1:
            ways.append([(node.mean, np.isin(np.arange(ny), node.elements) * 1.0) for node in system.nodes])
        else:
            (node,) = system.nodes
            ways += [[(q, np.ones(ny)), (1 - q, np.zeros(ny))]
                     for q in (node.mean - node.spread, node.mean, node.mean + node.spread)]
        for way in ways:
            after = 0.0
            for probability, arrived in way:
                gain = K * arrived
                moved = drift - gain @ system.C @ e
                after += probability * (moved @ P @ moved + np.trace(noise @ gain.T @ P @ gain))
            assert after <= (found.theta * e @ P @ e + (1 - found.theta) * found.bound) * (1 + 1e-6)



def test_corollary_1_is_the_printed_one() -> None:
    """Half-size linear form and mirror sectors lose nothing against (23) to (26); a second solver agrees."""
    two = system(delta=7e5)
    bound = printed(two, 0.98)
    assert lmi.ultimate_bound(two, 0.98).bound == pytest.approx(bound, rel=1e-5)
    assert lmi.ultimate_bound(replace(two, mirror=None), 0.98).bound == pytest.approx(bound, rel=1e-5)
    assert lmi.ultimate_bound(two, 0.98, solver="SCS").bound == pytest.approx(bound, rel=1e-4)


@pytest.mark.parametrize(("variant", "cars", "multipliers"), [
    ("uniform", 2, "scalar"), ("uniform", 3, "free"), ("random-access", 2, "scalar"), ("random-access", 3, "free"),
])
def test_certificates_hold(variant: str, cars: int, multipliers: lmi.Multipliers) -> None:
    given = system(variant, cars)
    found = lmi.ultimate_bound(given, 0.98, multipliers=multipliers)
    check_inequality(given, found)
    certified = lmi.certify(given, found.K, 0.98, multipliers=multipliers)
    check_inequality(given, certified)
    assert certified.bound == pytest.approx(found.bound, rel=1e-4)
    with pytest.raises(AssertionError):
        check_inequality(given, replace(found, bound=found.bound / 20))


def test_free_multipliers_and_known_reception_are_never_worse() -> None:
    wide, narrow = system(), system(trains=[3, 3])
    assert narrow.nodes[0].spread == 0
    scalar = lmi.ultimate_bound(wide, 0.98).bound
    assert lmi.ultimate_bound(wide, 0.98, multipliers="free").bound < scalar
    assert lmi.ultimate_bound(narrow, 0.98).bound < scalar
    assert lmi.ultimate_bound(system(delta=0.0), 0.98).bound < scalar
    check_inequality(narrow, lmi.ultimate_bound(narrow, 0.98))


def test_published_gain_and_our_optimum() -> None:
    """sqrt(sum delta^2) = 7e5 N, theta = 0.98: 158.914 and 158.934; Frobenius distances 2.5 % and 4.5 %."""
    six = system(cars=6, delta=7e5)
    found, published = lmi.ultimate_bound(replace(six, mirror=None), 0.98), read_gain(PUBLISHED)
    assert found.bound == pytest.approx(158.914, rel=1e-4)
    assert lmi.certify(six, published, 0.98).bound == pytest.approx(158.934, rel=1e-4)
    assert lmi.certify(six, found.K, 0.98).bound == pytest.approx(found.bound, rel=1e-5)
    for columns, distance in ((slice(0, 6), 0.025), (slice(6, 12), 0.045)):
        away = np.linalg.norm((found.K - published)[:, columns]) / np.linalg.norm(published[:, columns])
        assert away == pytest.approx(distance, abs=0.002)


def test_trade_off_of_the_page() -> None:
    found = dict(lmi_decay.trade_off(system(cars=6, delta=4e4), [0.999, 0.99, 0.98, 0.97, 0.96]))
    for theta, bound in ((0.999, 3.409), (0.99, 0.5049), (0.98, 0.6124), (0.97, 8.529)):
        certificate = found[theta]
        assert isinstance(certificate, Certificate)
        assert certificate.bound == pytest.approx(bound, rel=1e-3)
    assert isinstance(found[0.96], Infeasible)
    for word in ("theta = 0.96", "(23)", "try theta closer to 1"):
        assert word in str(found[0.96])


def test_corollary_2_needs_other_coordinates() -> None:
    """At 4e4 N with T = P^(1/2) of Corollary 1 at 0.98: gamma_bar = 1.0317 at varpi = 10; as printed, infeasible. Its
    gain has a certificate at its own decay, with a bound under varpi, by the multipliers of those coordinates."""
    six = system(cars=6, delta=4e4)
    values, vectors = np.linalg.eigh(lmi.ultimate_bound(six, 0.98).P)
    found = lmi_decay.corollary2(six, 10.0, vectors * np.sqrt(values) @ vectors.T)
    assert found.gamma_bar == pytest.approx(1.0317, abs=1e-4)
    assert lmi.certify(six, found.K, 1 / found.gamma_bar, multipliers="free").bound < 10
    with pytest.raises(Infeasible, match="Corollary 2 has no solution"):
        lmi_decay.corollary2(six, 100.0, np.eye(12))


@pytest.mark.parametrize(("trains", "greatest"), [([1, 3], 0.8866), ([1, 1], 1.6910)])
def test_corollary_2_as_printed_has_no_decay_for_one_to_three_trains(trains: list[int], greatest: float) -> None:
    """(32) alone, whatever varpi and delta are; the estimator's option says so."""
    told = load("cbtc-csma", {"knowledge.trains": trains, "time.steps": 2}).setting("uniform")
    model = told.design_model({}, np.zeros((12, 1)))
    found = lmi_decay.corollary2(error_system(model), None)
    assert found.gamma_bar == pytest.approx(greatest, abs=1e-4)
    if greatest < 1:
        with pytest.raises(Infeasible, match=r"Corollary 2 has no solution.*gamma_bar = 0.8866 at most"):
            lmi_decay.printed_decay(error_system(model), 1e4)


def test_corollary_2_as_printed_where_it_has_a_solution() -> None:
    """A plant that forgets by itself, in units in which its Lyapunov function is near the identity."""
    told = lmi.ErrorSystem(0.5 * np.eye(2), np.eye(2), 0.01 * np.eye(2), 0.01 * np.eye(2), 0.01 * np.eye(2),
                           np.ones(2), (lmi.packet(0.8, 0.8, 2),))
    found = lmi_decay.printed_decay(told, 10.0)
    assert found.theta < 1 and found.bound == 10.0
    assert lmi.certify(told, found.K, found.theta + 1e-4, multipliers="free").bound <= found.bound


def test_fastest_decay_is_the_edge() -> None:
    two, varpi, width = system(), 1.0, 2e-3
    found = lmi_decay.fastest_decay(two, varpi, tolerance=width)
    assert found.bound <= varpi
    assert lmi.certify(two, found.K, found.theta).bound == pytest.approx(found.bound, rel=1e-4)
    try:
        assert lmi.ultimate_bound(two, found.theta - 1.01 * width).bound > varpi
    except Infeasible as reason:
        assert "(23)" in str(reason)
    with pytest.raises(Infeasible, match=r"varpi = 1e-06.*least bound found is"):
        lmi_decay.fastest_decay(two, 1e-6)


def test_an_inaccurate_solution_is_no_design(monkeypatch: pytest.MonkeyPatch) -> None:
    solve = lmi.solve_problem

    def inaccurate(problem: Any, solver: str) -> str:
        status = solve(problem, solver)
        return "optimal_inaccurate" if status == "optimal" else status

    monkeypatch.setattr(lmi, "solve_problem", inaccurate)
    with pytest.raises(Infeasible, match=r"no trustworthy certificate at theta = 0.98.*optimal_inaccurate.*\(23\)"):
        lmi.ultimate_bound(system(), 0.98)


@pytest.mark.parametrize("what", ["all", "W", "Kcal"])
@pytest.mark.parametrize("variant", ["uniform", "random-access"])
def test_a_solver_s_word_is_not_enough(monkeypatch: pytest.MonkeyPatch, variant: str, what: str) -> None:
    """An "optimal" answer whose P is under M'M though the LMI holds, whose W is too small or whose Kcal is another: a
    wrong certificate is none, and one that comes nevertheless holds."""
    solve = lmi.solve_problem

    def careless(problem: Any, solver: str) -> str:
        status = solve(problem, solver)
        for variable in problem.variables():
            if what in ("all", variable.name()):
                variable.value = 0.9 * variable.value
        return status

    monkeypatch.setattr(lmi, "solve_problem", careless)
    found = system(variant)
    try:
        certificate = lmi.ultimate_bound(found, 0.98)
    except Infeasible as reason:
        assert "matrix inequalities are violated" in str(reason)
    else:
        assert what != "all"
        check_inequality(found, certificate)


@pytest.mark.parametrize("variant", ["uniform", "random-access"])
def test_estimator_is_equation_10(variant: str) -> None:
    """The filtered form, predicted, is x^(k+1) = A x^ + B u + h + K Pi (y - C x^); lost elements are never read."""
    runs, steps = 3, 12
    told = model(variant, runs=runs)
    estimator = UltimateBound()
    estimator.design(told)
    random = np.random.default_rng(1)
    y, u = random.normal(0, 5, (steps, 4, runs)), random.normal(0, 1e4, (steps, 2, runs))
    received = random.uniform(size=(steps, 4, runs)) < 0.5
    y[~received] = np.nan
    estimator.start(told, runs, RunRandom(0, ("s", "v"), range(runs)))
    linear = told.linear
    assert linear is not None
    A, B, C, h = linear.A(0), linear.B(0), linear.C(0), linear.h(0)[:, None]
    x = np.zeros((4, runs))
    for k in range(steps):
        if k:
            estimator.predict(u[k], whole(k))
            innovation = np.where(received[k - 1], y[k - 1] - C @ x, 0.0)
            x = A @ x + B @ u[k] + h + estimator.K @ innovation
        np.testing.assert_allclose(estimator.estimate().mean, x, rtol=1e-9, atol=1e-9)
        estimator.update(heard(y[k], received[k], k))
    bound = estimator.estimate().bound
    assert bound is not None and bound.shape == (1,)


def test_runs_do_not_depend_on_their_neighbours() -> None:
    def drive(runs: list[int]) -> np.ndarray:
        told = model(runs=len(runs))
        estimator = UltimateBound()
        estimator.design(told)
        estimator.start(told, len(runs), RunRandom(0, ("s", "v"), runs))
        random = RunRandom(0, ("s", "v", "data"), runs)
        for _ in range(20):
            estimator.update(heard(random.normal(4), random.uniform(0, 1, 4) < 0.5))
            estimator.predict(1e4 * random.normal(2), whole(0))
        return estimator.estimate().mean.copy()

    together = drive(list(range(33)))
    for runs in ([7], [32, 0, 7]):
        np.testing.assert_array_equal(drive(runs), together[:, runs])


def test_a_design_is_solved_once(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told = model()
    fresh = UltimateBound().design(told)
    again = UltimateBound().design(told)
    assert (fresh["cached"], again["cached"]) == (False, True)
    assert again["design_s"] == fresh["design_s"] and again["bound"] == fresh["bound"]
    np.testing.assert_array_equal(again["gain"], fresh["gain"])
    (entry,) = cache.iterdir()
    whole = entry.read_bytes()
    for damaged in (whole[:len(whole) // 2], whole.replace(b"1", b"2", 5), b"", b"\xff\xfe"):
        entry.write_bytes(damaged)
        assert not UltimateBound().design(told)["cached"]
        assert UltimateBound().design(told)["cached"]
    assert not UltimateBound({"theta": 0.985}).design(told)["cached"]
    assert not UltimateBound().design(model(delta=1e4))["cached"]

    def refuse(*_: Any, **__: Any) -> Certificate:
        raise Infeasible("once")

    monkeypatch.setattr(lmi, "ultimate_bound", refuse)
    for _ in range(2):
        with pytest.raises(Infeasible, match="once"):
            UltimateBound({"theta": 0.9}).design(told)
        monkeypatch.setattr(lmi, "ultimate_bound", None)  # the second time nothing is solved


def test_a_fixed_gain_without_certificate_claims_nothing(tmp_path: Path) -> None:
    told = model()
    np.savetxt(tmp_path / "zero.csv", np.zeros((4, 4)), delimiter=",")
    estimator = FixedGain({"gain": str(tmp_path / "zero.csv")})
    info = estimator.design(told)
    assert info["bound"] is None and "(14) of Theorem 1" in info["status"]
    estimator.start(told, 1, RunRandom(0, ("s", "v"), [0]))
    assert estimator.estimate().bound is None
    with pytest.raises(Unsupported, match=r"12 x 12.*4 x 4"):
        FixedGain({"gain": PUBLISHED}).design(told)


@pytest.mark.parametrize(("text", "message"), [
    ("1,2\n3\n", "not a CSV"), ("a,b\n", "not a CSV"), ("1,nan\n", "finite")])
def test_a_bad_gain_file_is_an_input_error(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "gain.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        read_gain(str(tmp_path / "gain.csv"))
    with pytest.raises(InputError, match="no such file"):
        read_gain(str(tmp_path / "none.csv"))


@pytest.mark.filterwarnings("error")
def test_gains_of_one_row_and_of_none(tmp_path: Path) -> None:
    for text in ("1,2.5\n", "1\n-2\n", "3\n"):
        (tmp_path / "gain.csv").write_text(text)
        assert read_gain("gain.csv", tmp_path).tolist() == [
            [float(word) for word in line.split(",")] for line in text.splitlines()]
    (tmp_path / "gain.csv").write_text("")
    with pytest.raises(InputError, match="is empty"):
        read_gain("gain.csv", tmp_path)


def test_what_a_design_needs() -> None:
    told = model()
    with pytest.raises(Unsupported, match="reception"):
        error_system(replace(told, reception=None))
    assert told.linear is not None
    with pytest.raises(Unsupported, match="change with time"):
        error_system(replace(told, linear=replace(told.linear, constant=False)))
    with pytest.raises(ValueError, match="shorter"):
        error_system(replace(told, reception=Reception(0.5, 0.5, ((0,), (1,)), (1.0,))))
    with pytest.raises(Unsupported, match="varpi"):
        FastestDecay().design(replace(told, details={}))
