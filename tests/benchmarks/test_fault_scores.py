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
