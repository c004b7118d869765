"""The scorer against a naive loop over runs and steps, with runs that end, diverge or lose their covariance."""

from __future__ import annotations

import numpy as np
import pytest
from railstate.benchmarks.scoring.forms import BINS, add_spread, histogram_medians, quadratic_forms
from railstate.benchmarks.scoring.kernels import lane_sum
from railstate.benchmarks.scoring.scorer import Scorer
from railstate.benchmarks.scoring.windows import PhaseErrors, WindowErrors
from railstate.estimators.interface import Estimate, Status
from railstate.scenarios.machine_code import njit
from railstate.scenarios.setting import Quantity
from railstate.scenarios.world import Step
from scipy.stats import chi2

from .steps import stretches


@njit(cache=True)
def total(values):  # pyright: ignore
    return lane_sum(values)


@njit(cache=True)
def spread(forms, live, middle, limit, inside, histogram):  # pyright: ignore
    for form in forms:
        add_spread(form, live, middle, limit, inside, histogram)


STEPS, SKIP = 12, 3
QUANTITIES = (Quantity("position", "m", ((0, 1.0), (1, 1.0))), Quantity("speed", "m/s", ((2, 3.6),)),
              Quantity("weighted", "1", ((0, 0.5), (2, 2.0)), mean=False))


def random_case(runs: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Truth, mean (K, 3, S), covariance (K, 3, 3, S), active (K, S)."""
    rng = np.random.default_rng(5)
    truth, mean = rng.normal(size=(2, STEPS, 3, runs))
    root = rng.normal(size=(STEPS, 3, 3, runs))
    covariance = np.einsum("kijs,kljs->kils", root, root) + 0.1 * np.eye(3)[:, :, None]
    active = np.arange(STEPS)[:, None] < rng.integers(6, STEPS + 1, runs)
    return truth, mean, covariance, active


def scored(runs: slice, mean: np.ndarray, covariance: np.ndarray):
    """What the scorer makes of some of 33 runs."""
    truth, _, _, active = random_case(33)
    scorer = Scorer(QUANTITIES, len(range(33)[runs]), STEPS, SKIP, {"speed": 50.0}, None)
    steps = [(Estimate(mean[k][:, runs], covariance=covariance[k][:, :, runs]),
              Step(np.zeros((0, 1)), (), truth[k][:, runs], active[k][runs])) for k in range(STEPS)]
    for stretch in stretches(steps, [1, 5, 2, 4]):
        scorer.add(stretch)
    return scorer.finish(np.zeros(len(range(33)[runs]), dtype=np.int8), {})


def test_errors_by_phase_equal_a_naive_loop() -> None:
    """The first position and speed by the phase that the true speed tells; none while it is unknown or at the start."""
    rng = np.random.default_rng(8)
    length = np.array([0.0, 0.5, 0.5, 0.25] + [0.5] * 28)
    speed = np.repeat(np.maximum(np.cumsum(0.2 * rng.choice([-1, 0, 0, 1], (16, 5)), axis=0), 0.0), 2, axis=0)
    speed[9, 2] = np.nan
    truth = np.stack([np.cumsum(length[:, None] * np.nan_to_num(speed), axis=0), speed], axis=1)
    mean, active = truth + rng.normal(size=truth.shape), rng.uniform(size=speed.shape) < 0.9
    mean[9, 1, 2] = 7.0
    quantities = (Quantity("norm", "m", ((0, 2.0),), mean=False), Quantity("position", "m", ((0, 1.0),)),
                  Quantity("weighted", "1", ((0, 1.0), (1, 1.0)), mean=False), Quantity("rear", "m", ((0, 2.0),)),
                  Quantity("fast", "m/s", ((0, 1.0),), mean=False), Quantity("speed", "m/s", ((1, 1.0),)),
                  Quantity("speed-front", "m/s", ((1, 1.0),)))
    scores = PhaseErrors(quantities, 5)
    steps = [(Estimate(mean[k]), Step(np.zeros((0, 5)), (), truth[k], active[k], length=length[k]))
             for k in range(len(length))]
    for stretch in stretches(steps, [1, 1, 10, 20]):
        scores.add(stretch, SKIP)
    told = (("position", "m"), ("speed", "m/s"))
    expected: dict[tuple[str, str, str], list[list[float]]] = {
        ("rmse", f"{name}-{phase}", unit): [[] for _ in range(5)] for name, unit in told
        for phase in ("standing", "accelerating", "coasting", "braking")}
    for s in range(5):
        for k in range(SKIP, len(length)):
            a = (speed[k, s] - speed[k - 1, s]) / length[k]
            phase = ("standing" if speed[k, s] <= 0.05 else "accelerating" if a > 0.1 else "braking" if a < -0.1
                     else "coasting")
            for i, (name, unit) in enumerate(told):
                if active[k, s] and np.isfinite(a if phase != "standing" else 0.0) and np.isfinite(truth[k, i, s]):
                    expected["rmse", f"{name}-{phase}", unit][s].append((mean[k, i, s] - truth[k, i, s]) ** 2)
    found = scores.finish()
    assert set(found) == set(expected) and all(any(map(len, runs)) for runs in expected.values())
    for key, squares in expected.items():
        np.testing.assert_allclose(found[key], [np.sqrt(np.mean(one)) if one else np.nan for one in squares],
                                   err_msg=str(key))
    assert PhaseErrors(quantities[:5], 5).finish() == {}


def test_errors_by_window_are_roots_of_means() -> None:
    """Over the components of a mean, summed of a norm; of a run that never was in a window there is none."""
    rng = np.random.default_rng(9)
    truth, mean = rng.normal(size=(2, STEPS, 3, 4))
    window = rng.integers(-1, 2, (STEPS, 4)).astype(np.int16)
    window[:, 3] = 0
    scores = WindowErrors(("here", "there"), QUANTITIES, 4)
    steps = [(Estimate(mean[k]), Step(np.zeros((0, 4)), (), truth[k], np.ones(4, dtype=bool), window=window[k]))
             for k in range(STEPS)]
    for stretch in stretches(steps, [1, 5, 6]):
        scores.add(stretch, SKIP)
    with np.errstate(all="raise"):
        found = scores.finish()
    e, late = mean - truth, np.arange(STEPS)[:, None] >= SKIP
    squares = {("position", "m"): (e[:, 0] ** 2 + e[:, 1] ** 2) / 2, ("speed", "m/s"): (3.6 * e[:, 2]) ** 2,
               ("weighted", "1"): (0.5 * e[:, 0]) ** 2 + (2.0 * e[:, 2]) ** 2}
    for (name, unit), square in squares.items():
        for number, word in enumerate(("here", "there")):
            mine = [square[(window[:, s] == number) & late[:, 0], s] for s in range(4)]
            np.testing.assert_allclose(found.pop(("rmse", f"{name}-{word}", unit)), [
                np.sqrt(one.mean()) if one.size else np.nan for one in mine], rtol=1e-12)
    assert found == {} and not (window[SKIP:, 3] == 1).any()


def test_metrics_equal_a_naive_loop() -> None:
    truth, mean, covariance, active = random_case(33)
    found = scored(slice(None), mean, covariance)
    assert (found.status == Status.ok).all() and found.nees_states == 3
    for s in range(33):
        use = [k for k in range(SKIP, STEPS) if active[k, s]]
        error = np.array([mean[k, :, s] - truth[k, :, s] for k in use])
        nees = [e @ np.linalg.solve(covariance[k, :, :, s], e) for k, e in zip(use, error, strict=True)]
        expected = {
            ("rmse", "position"): np.sqrt(np.mean(error[:, :2] ** 2)), ("mae", "position"): np.mean(abs(error[:, :2])),
            ("max", "position"): abs(error[:, :2]).max(), ("rmse", "speed"): np.sqrt(np.mean((3.6 * error[:, 2]) ** 2)),
            ("final", "speed"): abs(3.6 * error[-1, 2]),
            ("final", "position"): np.sqrt(np.mean(error[-1, :2] ** 2)), ("nees", "state"): np.mean(nees),
            ("inside", "state"): np.mean(np.array(nees) <= chi2(3).ppf(0.95)),
            ("sum-squared", "weighted"): np.sum((0.5 * error[:, 0]) ** 2 + (2 * error[:, 2]) ** 2)}
        for key, value in expected.items():
            assert found.metrics[key][s] == pytest.approx(value, rel=1e-10), key
    for k in range(STEPS):
        counted = active[k] & (k >= SKIP)
        assert found.curves["active"][k] == counted.sum()
        speed = 3.6 * (mean[k, 2] - truth[k, 2])[counted]
        assert found.curves["squared"][k, 1] == pytest.approx(np.sum(speed**2))
        assert found.curves["fourth"][k, 1] == pytest.approx(np.sum(speed**4))


def test_a_batch_gives_each_run_the_same_bits() -> None:
    _, mean, covariance, _ = random_case(33)
    whole = scored(slice(None), mean, covariance)
    for runs in (slice(0, 1), slice(5, 12), slice(16, 33)):
        part = scored(runs, mean, covariance)
        for key, values in part.metrics.items():
            np.testing.assert_array_equal(values, whole.metrics[key][runs])


def test_bad_runs_have_a_status_and_leave_the_others_alone() -> None:
    _, mean, covariance, active = random_case(33)
    good = scored(slice(None), mean, covariance)
    mean, covariance = mean.copy(), covariance.copy()
    assert active[5].all()
    mean[5, 0, 4] = np.nan
    mean[4, 2, 7] = 1e3
    covariance[5, :, :, 9] = -np.eye(3)
    bad = scored(slice(None), mean, covariance)
    assert {s: Status(v).name for s, v in enumerate(bad.status) if v} == {4: "diverged", 7: "diverged", 9: "failed"}
    keep = bad.status == Status.ok
    for key, values in good.metrics.items():
        np.testing.assert_array_equal(values[keep], bad.metrics[key][keep])
        assert np.isnan(bad.metrics[key][~keep]).all()


def quadratic(vector: np.ndarray, truth: np.ndarray, matrix: np.ndarray, states: int = 4) -> np.ndarray:
    """The quadratic forms (S,) of one step, whose matrix is fine."""
    form, diagonal = np.full((1, vector.shape[1]), -1.0), np.empty((1, len(matrix), vector.shape[1]))
    failed = np.ones(form.shape, dtype=bool)
    quadratic_forms(vector[None], truth[None], matrix[None], states, diagonal, form, failed)
    assert not failed.any()
    np.testing.assert_array_equal(diagonal[0] - matrix[range(len(matrix)), range(len(matrix))], 0.0)
    return form[0]


@pytest.mark.parametrize("runs", [1, 5, 700])
@pytest.mark.parametrize("shared", [True, False])
def test_quadratic_forms(runs: int, shared: bool) -> None:
    rng = np.random.default_rng(1)
    root = rng.normal(size=(4, 4, 1 if shared else runs))
    matrix = np.einsum("ijs,kjs->iks", root, root) + 0.1 * np.eye(4)[:, :, None]
    vector, truth = rng.normal(size=(2, 5, runs))
    for states in (4, 3):
        error = (vector - truth)[:states]
        part = matrix[:states, :states]
        expected = [error[:, s] @ np.linalg.solve(part[:, :, 0 if shared else s], error[:, s]) for s in range(runs)]
        np.testing.assert_allclose(quadratic(vector, truth, matrix, states), expected, rtol=1e-9)
    unknown = np.where(np.arange(5)[:, None] == 1, np.nan, truth)
    np.testing.assert_array_equal(quadratic(vector, unknown, matrix),
                                  quadratic(vector, np.where(np.isnan(unknown), vector, unknown), matrix))
    singular = np.zeros((4, 4, 1))
    assert np.isnan(quadratic(vector, vector, singular)).all()  # no claim, no error: nothing to be judged
    assert np.isposinf(quadratic(vector, truth, singular)).all()


def test_a_claim_without_uncertainty_where_there_is_an_error_is_infinitely_too_sure() -> None:
    rng = np.random.default_rng(3)
    root = np.eye(3)[:, :, None] + 0.2 * rng.normal(size=(3, 3, 50))
    root = np.concatenate([root, root[:1]])  # the last state is the first: rank 3
    matrix = np.einsum("ijs,kjs->iks", root, root)
    allowed = rng.normal(size=(4, 50))
    allowed[3] = allowed[0]
    zero = np.zeros((4, 50))
    assert np.isnan(quadratic(allowed, zero, matrix)).all()
    assert np.isposinf(quadratic(allowed + 1e-3 * rng.normal(size=(4, 50)), zero, matrix)).all()


def test_infinite_nees_reaches_the_metrics() -> None:
    scorer = Scorer((Quantity("position", "m", ((0, 1.0),)),), 2, 3, 0, {}, None)
    nothing = np.zeros((1, 2))
    claims = [np.array([[[1.0, 1.0]]]) * (k != 1 or np.array([1.0, 0.0])) for k in range(3)]
    for stretch in stretches([(Estimate(nothing + 2.0, covariance=claim),
                               Step(nothing, (), nothing, np.ones(2, dtype=bool))) for claim in claims], [3]):
        scorer.add(stretch)
    found = scorer.finish(np.zeros(2, dtype=np.int8), {})
    assert found.metrics["nees", "state"].tolist() == [4.0, np.inf] and not found.status.any()


@pytest.mark.parametrize("length", [0, 1, 7, 8, 1001])
def test_lane_sum(length: int) -> None:
    values = np.random.default_rng(2).normal(size=length)
    assert total(values) == pytest.approx(values.sum(), abs=1e-12)


def test_median_and_share_inside() -> None:
    """Of chi-square forms: the share exactly, the median to less than a bin of its histogram, zeros, infinities."""
    forms, middle, limit = np.random.default_rng(3).chisquare(2, (4001, 6)), chi2(2).ppf(0.5), chi2(2).ppf(0.95)
    inside, histogram = np.zeros(6), np.zeros((6, BINS), dtype=np.int32)
    spread(forms, np.ones(6), middle, limit, inside, histogram)
    np.testing.assert_array_equal(inside, (forms <= limit).sum(axis=0))
    np.testing.assert_allclose(histogram_medians(histogram), np.median(forms, axis=0) / middle, rtol=0.03)
    inside, histogram = np.zeros(6), np.zeros((6, BINS), dtype=np.int32)
    spread(np.array([[0.0, 1e-300, 1e300, np.inf, np.nan, 1.0]]), np.array([1.0] * 5 + [0.0]), 1.0, 2.0, inside,
           histogram)
    np.testing.assert_array_equal(histogram_medians(histogram), [0.0, 0.0, np.inf, np.inf, np.nan, np.nan])
    np.testing.assert_array_equal(inside, [1, 1, 0, 0, 0, 0])
    spread(np.ones((9, 6)), np.ones(6), 1.0, 2.0, inside, histogram)
    assert (abs(histogram_medians(histogram) - 1) < 1 / 16).all()  # one degenerate step rules nothing
