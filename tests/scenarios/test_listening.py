"""Estimators that listen to one closed-loop trial of moving-block instead of steering one each."""

from __future__ import annotations

from railstate.benchmarks.planning.plan import make_plan
from railstate.benchmarks.running.execute import execute


def test_estimators_listen_to_one_trial_that_none_of_them_steers() -> None:
    """Gap and lap are one for all, and one with that of any other company; each estimator's error is its own; the
    trial is much like the closed loop of the EKF (mean gap within 5 %)."""
    def found(variant, labels):
        plan = make_plan([f"moving-block/{variant}"], only=labels)
        return execute(plan.task(plan.cells[0], tuple(labels), tuple(range(12)))).rows.to_pandas()

    rows = found("law-p-listening", ["ekf", "ukf", "dead-reckoning", "ekf-scale"])
    assert set(rows["status"]) == {"ok"}
    for column in ("mean:gap:m", "min:gap:m", "mean:lap:s"):
        assert (rows.groupby("run")[column].nunique() == 1).all()
    errors = rows.groupby("estimator")["rmse:x:m"].mean()
    assert errors.nunique() == 4 and errors["ekf"] < 0.5 * errors["dead-reckoning"]
    steered = found("law-p", ["ekf"])
    assert abs(rows["mean:gap:m"].mean() / steered["mean:gap:m"].mean() - 1) < 0.05
