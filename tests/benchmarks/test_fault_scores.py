"""What rows say of runs with faults: locked, recovered, alarms; and that rows without any stay as they are."""

from __future__ import annotations

import numpy as np
import pandas as pd
from railstate.benchmarks.scoring.faults import FaultScores, fault_table
from railstate.estimators.interface import Estimate
from railstate.scenarios.faults import Jump, Outliers
from railstate.scenarios.measurement import Measurement
from railstate.scenarios.setting import Quantity
from railstate.scenarios.world import Event, Step

PLACE = (Quantity("position", "m", ((0, 1.0),)),)


def scored(faults, errors, rejected=None, faulty=None):
    """Scores of runs with these position errors (K, S), a step a second; rejected, faulty (K, S) of one sensor."""
    runs = errors.shape[1]
    scores = FaultScores(faults, PLACE, runs)
    for k, error in enumerate(errors):
        wrong = None if faulty is None else faulty[k][None]
        event = Event(1.0, np.zeros((1, runs)), np.ones((1, runs), dtype=bool), faulty=wrong)
        step = Step(np.zeros((0, runs)), (event,), np.zeros((1, runs)), np.ones(runs, dtype=bool), None, None, k + 1,
                    float(k), 1.0)
        if rejected is not None:
            scores.judged(step, Measurement(event.y, event.received, k + 1, 0, k + 1.0), rejected[k][None])
        scores.add(Estimate(error[None]), step)
    return scores.finish()


def test_locked_and_recovered():
    jump = Jump(kind="jump", **{"from": 5.0})
    errors = np.full((30, 4), 0.5)
    errors[4:12, 1] = 20.0   # away until 12 s, back from 13 s on
    errors[4:, 2] = -20.0    # away for good
    errors[21:, 3] = 5.0     # away for the last 9 s only
    found = scored([jump], errors)
    np.testing.assert_array_equal(found["locked", "position", "1"], [0, 0, 1, 0])
    np.testing.assert_array_equal(found["recovery", "position", "s"], [0, 8, np.nan, np.nan])


def test_alarms_hits_and_false_alarms():
    faulty, rejected = np.zeros((20, 2), dtype=bool), np.zeros((20, 2), dtype=bool)
    faulty[10:14] = True
    rejected[[2, 11, 12, 17], 0] = True
    found = scored([Outliers(kind="outliers", **{"from": 10.0})], np.zeros((20, 2)), rejected, faulty)
    np.testing.assert_array_equal(found["first-alarm", "readings", "s"], [2, np.nan])
    np.testing.assert_allclose(found["hits", "readings", "1"], [0.5, 0])
    np.testing.assert_allclose(found["false-alarms", "readings", "1"], [2 / 16, 0])
    assert ("recovery", "position", "s") not in found  # they never end
    faulty[11:], faulty[10, 1] = False, False  # one wrong reading, none
    found = scored([Outliers(kind="outliers", **{"from": 10.0})], np.zeros((20, 2)), ~faulty, faulty)
    np.testing.assert_array_equal(found["hits", "readings", "1"], [0, np.nan])
    np.testing.assert_array_equal(found["false-alarms", "readings", "1"], [1, 1])
    found = scored([Outliers(kind="outliers", **{"from": 10.0})], np.zeros((20, 2)), faulty, ~faulty)
    np.testing.assert_array_equal(found["hits", "readings", "1"], [0, 0])
    np.testing.assert_array_equal(found["false-alarms", "readings", "1"], [1, np.nan])  # one right reading, none


def test_no_faults_no_columns():
    assert scored([], np.zeros((5, 2))) == {}


def test_the_command_line_breaks_filters_down(railstate):
    few = ["-n", "3", "--jobs", "1", "--out"]
    over = ["--over", "faults.outliers.share=0,0.3", "-e", "ekf,gate"]
    assert railstate("sweep", "ningbo-metro/gaussian", *over, *few, "down").code == 0
    assert railstate("run", "ningbo-metro/gaussian", "-e", "ekf", *few, "plain").code == 0

    def rows(folder, estimator):
        found = pd.concat(map(pd.read_parquet, (railstate.folder / folder / "rows").glob("*.parquet")))
        return found[found["estimator"] == estimator].sort_values("run").reset_index(drop=True)

    none, many = "down/faults.outliers.share=0", "down/faults.outliers.share=0.3"
    error = "rmse:position:m"
    assert (rows(many, "ekf")[error] > 3 * rows(many, "gate")[error]).all()
    assert (rows(many, "gate")["hits:readings:1"] > 0.9).all() and (rows(many, "ekf")["locked:position:1"] == 0).all()
    plain, same = rows("plain", "ekf"), rows(none, "ekf")
    names = [name for name in plain.columns if name != "seconds"]
    pd.testing.assert_frame_equal(plain[names], same[names], check_exact=True)


def test_what_tables_show_of_faults() -> None:
    place, speed = Quantity("position", "m", ((0, 1.0),)), Quantity("speed", "m/s", ((1, 1.0),))
    gap = Quantity("gap", "m", ((0, 1.0), (1, -1.0)))
    readings = (("first-alarm", "readings"), ("hits", "readings"), ("false-alarms", "readings"))
    assert fault_table([object()], (speed, gap, place)) == (("locked", "position"), ("recovery", "position"), *readings)
    assert fault_table([object()], (speed, gap)) == readings  # nothing that could be lost
    assert fault_table([], (place, speed)) == ()


def test_scores_are_those_of_loops_over_runs_and_steps() -> None:
    """Tenths of a second; errors at the limit, beyond it and unknown; two events a step of two sensors, of which one
    comes a step late; runs that end, and one that never began. Of several faults the first begin and the last end."""
    rng, steps, runs, onset, end = np.random.default_rng(7), 300, 40, 8, 120
    faults = [Outliers(kind="outliers", **{"from": 2.0, "to": 12.0}), Jump(kind="jump", **{"from": 0.8}),
              Outliers(kind="outliers", **{"from": 25.0}), object()]
    quantities = (Quantity("speed", "m/s", ((1, 1.0),)), Quantity("gap", "m", ((0, 1.0), (1, -1.0))),
                  Quantity("rear", "m", ((1, -2.0),)), Quantity("front", "m", ((0, 1.0),)))
    lasts = rng.integers(0, steps, runs)  # how long each is lost at its end
    lasts[:6] = 99, 100, 101, 100, steps, 0
    ends = rng.integers(steps // 2, steps + 1, runs)
    ends[7] = 0
    error = rng.choice([0.0, 1.5, -1.5, 1.6, np.nan], (steps, runs), p=[0.9, 0.03, 0.03, 0.02, 0.02])
    for run in range(runs):
        error[max(ends[run] - lasts[run], 0):ends[run], run] = -9.0 if run % 2 else np.nan
        error[max(ends[run] - lasts[run] - 1, 0):max(ends[run] - lasts[run], 0), run] = 0.0
    shape = (steps, 2, 2, runs)
    rejected, received, faulty = rng.random(shape) < 0.02, rng.random(shape) < 0.7, rng.random(shape) < 0.3
    rejected[:, :, :, 8], rejected[onset - 1, 0, 0, 9], received[onset - 1, 0, 0, 9] = False, True, True
    faulty[:, :, :, 10], faulty[:, :, :, 11] = False, True
    faulty[:, 1, :, :] &= (np.arange(steps) % 2 == 0)[:, None, None]  # the second event has none in odd steps
    scores, blind = FaultScores(faults, quantities, runs), FaultScores(faults, quantities[:2], runs)
    for k in range(steps):
        events = tuple(Event(0.5, np.zeros((2, runs)), received[k, e], faulty=None if e and k % 2 else faulty[k, e])
                       for e in range(2))
        step = Step(np.zeros((0, runs)), events, np.full((2, runs), 5.0), k < ends, None, None, k + 1, k / 10, 0.1)
        for e in range(2):
            for late in (0, 1):  # what belongs to another step is not judged
                measured = Measurement(events[e].y, received[k, e], k + 1 - late, e, k / 10 + 0.1)
                scores.judged(step, measured, np.ones((2, runs), dtype=bool) if late else rejected[k, e])
        scores.judged(step, Measurement(events[0].y, received[k, 0], k + 1, 0, k / 10 + 0.1), None)
        for one in (scores, blind):
            one.add(Estimate(np.stack([np.full(runs, 5.0), 5.0 + error[k]])), step)
    wanted = {name: np.full(runs, np.nan) for name in ("locked", "recovery", "first-alarm", "hits", "false-alarms")}
    for run in range(runs):
        away = [not abs(2 * error[k, run]) <= 3.0 for k in range(ends[run])]
        back = [k + 1 for k in range(1, ends[run]) if away[k - 1] and not away[k]]
        fine = [k + 1 for k in range(ends[run]) if not away[k]]
        lost = bool(away and away[-1])
        wanted["locked"][run] = lost and (not fine or ends[run] - fine[-1] >= 100)
        wanted["recovery"][run] = np.nan if lost else max(max(back, default=0) - end, 0) / 10
        said = [k + 1 for k in range(onset - 1, steps) if (rejected & received)[k, :, :, run].any()]
        wanted["first-alarm"][run] = (said[0] - onset) / 10 if said else np.nan
        for name, among in (("hits", faulty), ("false-alarms", ~faulty)):
            of = (among & received)[..., run]
            wanted[name][run] = rejected[..., run][of].mean() if of.any() else np.nan
    found = scores.finish()
    assert list(found) == [("locked", "rear", "1"), ("recovery", "rear", "s"), ("first-alarm", "readings", "s"),
                           ("hits", "readings", "1"), ("false-alarms", "readings", "1")]
    for (name, _, _), values in found.items():
        np.testing.assert_allclose(values, wanted[name], rtol=1e-12, atol=1e-12, err_msg=name)
    assert wanted["locked"][:6].tolist() == [0, 1, 1, 1, 1, 0] and (wanted["recovery"] > 0).any()
    assert blind.finish() == {}
