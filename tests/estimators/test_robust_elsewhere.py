"""The bounded-error family on settings that it was not made for: what it does there, or why it cannot."""

from __future__ import annotations

import pytest
from railstate.benchmarks.store.folder import Store

from ..conftest import Command


@pytest.mark.parametrize(("scenario", "label", "quantity", "worse"), [
    ("cbtc-csma/uniform", "robust-mean-square", "position", "direct"),
    ("cbtc-csma/uniform", "robust-ellipsoid", "position", "direct"),
    ("braking-rate/paper", "robust-mean-square", "f", "rbpf-static"),
    ("braking-rate/paper", "robust-ellipsoid", "f", "rbpf-static"),
])
def test_they_run_on_the_other_settings(railstate: Command, scenario: str, label: str, quantity: str,
                                        worse: str) -> None:
    """Missing packets, and f as a bounded unknown: they work, and know more than who does not model it."""
    steps = ("--set", "time.steps=600") if scenario.startswith("cbtc") else ()
    done = railstate("run", scenario, "--estimators", f"{label},{worse}", "--runs", 8, "--jobs", 1, "--out", "out",
                     *steps)
    assert done.code == 0, done.err
    frame = Store("out").rows()
    assert set(frame["status"]) == {"ok"}
    column = next(name for name in frame.columns if name.startswith(f"rmse:{quantity}:"))
    error = frame.groupby("estimator")[column].mean()
    assert error[label] < error[worse]


def test_where_they_cannot_run_it_says_why(railstate: Command) -> None:
    """F1 has no memory: a step without a packet is no contraction. A stop's command changes what f does."""
    done = railstate("run", "cbtc-csma/uniform", "--estimators", "robust-bounded", "--runs", 2, "--jobs", 1, "--set",
                     "time.steps=200")
    assert done.code == 0 and "infeasible: cbtc-csma/uniform/robust-bounded, 2 of 2 runs" in done.out
    assert "make the step no contraction by themselves" in done.out
    done = railstate("run", "braking-rate/stop", "--estimators", "robust-mean-square", "--runs", 2, "--jobs", 1)
    words = " ".join(done.out.split())  # wrapped where it may
    assert done.code == 0 and "needs bounds of the design model, which this scenario does not give" in words
