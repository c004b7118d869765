"""A run that has ended while others of its batch go on: nothing that becomes of it later may stand in its row."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd
from railstate.benchmarks.planning.plan import make_plan
from railstate.benchmarks.running.execute import execute


def rows(runs: Sequence[int]) -> pd.DataFrame:
    plan = make_plan(["ningbo-metro/constant"], only=["h-infinity-tuned"])
    found = execute(plan.task(plan.cells[0], ("h-infinity-tuned",), tuple(runs))).rows.to_pandas()
    return found.drop(columns="seconds").set_index("run")


def test_a_filter_that_fails_after_its_train_has_stopped_did_not_fail() -> None:
    """Without readings P grows until no filter keeps theta; alone, the run is over before."""
    together, alone = rows(range(6)), rows([0])
    assert together["steps"].nunique() > 1 and set(together["status"]) == {"ok"}
    pd.testing.assert_frame_equal(together.loc[[0]], alone, check_exact=True, check_index_type=False)
