"""Curves are of the runs that rows and tables are of: those that finished."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from railstate.benchmarks.store.folder import Store

from ..conftest import Command

HALF_DIVERGE = '''

class HalfDiverge(Half):
    def estimate(self):
        self.calls = getattr(self, "calls", 0) + 1
        away = (self.numbers % 2 == 0) & (self.calls > 20)
        return Estimate(np.where(away, 1e6, self.x + 1e-9 * self.noise))
'''


def sums(folder: str, label: str) -> pd.DataFrame:
    """One estimator's curves."""
    return Store(folder).curves().query(f"estimator == '{label}'").sort_values(["quantity", "step"]).reset_index()


def test_curves_are_of_the_runs_that_finished(railstate: Command) -> None:
    """Half of the runs leave the limit on their way: they are in no curve, and the rows are those of runs alone."""
    plugin = railstate.folder / "half.py"
    plugin.write_text(plugin.read_text() + HALF_DIVERGE)
    scenario = (railstate.folder / "cart.toml").read_text()
    Path("cart.toml").write_text(scenario.replace("[channel]", "[score.divergence]\nposition = 1000.0\n[channel]"))
    run = ("run", "cart.toml/calm", "--plugin", "half.py", "--jobs", 1, "--runs", 8)
    for words in (("half-diverge", "--out", "whole"), ("half-diverge", "--batch", 1, "--out", "single")):
        done = railstate(*run, "--estimators", *words)
        assert done.code == 0, done.err
    rows, single = (Store(name).rows().drop(columns="seconds").sort_values("run").reset_index(drop=True)
                    for name in ("whole", "single"))
    pd.testing.assert_frame_equal(rows, single, check_exact=True)
    assert (rows["status"] == np.where(rows["run"] % 2 == 0, "diverged", "ok")).all()
    curve = sums("whole", "half-diverge").query("quantity == 'position'")
    assert (curve["active"] == 4).all() and len(curve) > 20
    good = rows[rows["status"] == "ok"]
    np.testing.assert_allclose(curve["squared"].sum(), len(curve) * (good["rmse:position:m"] ** 2).sum(), rtol=1e-10)
    np.testing.assert_allclose(curve["squared"], sums("single", "half-diverge").query(
        "quantity == 'position'")["squared"], rtol=1e-12)
