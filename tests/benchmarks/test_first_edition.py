"""Plug-ins of the first edition of the interface end in one message that says what to write instead."""

from __future__ import annotations

from pathlib import Path

import pytest

from ..conftest import PLUGIN, Command

OLD = '''
from railstate.estimators.interface import Estimate, Estimator


class Old(Estimator):
    summary = "of the first edition"

    def start(self, model, runs, random):
        super().start(model, runs, random)
        self.x = model.initial_mean.copy()

    def predict(self, u, portion):
        self.x = self.model.transition(self.x, u, 0, portion)

    def update(self, y, received):
        pass

    def estimate(self):
        return Estimate(self.x)
'''
OLD_RUN = '''
from railstate.estimators.adapters import PerRun


class Old(PerRun):
    summary = "of the first edition"

    def make(self, model):
        return model

    def predict_run(self, filter, model, u, portion):
        pass
'''


@pytest.mark.parametrize(("text", "told"), [
    (OLD, ["predict(self, u, portion) and update(self, y, received)", "write predict(self, u, interval)",
           "interval.length in seconds", "update(self, measurement)"]),
    (OLD_RUN, ["predict_run(self, filter, model, u, portion)", "write predict_run(self, filter, model, u, interval)"]),
], ids=["estimator", "adapter"])
@pytest.mark.parametrize("command", ["check", "run"])
def test_an_estimator_of_the_first_edition(railstate: Command, text: str, told: list[str], command: str) -> None:
    Path("old.py").write_text(text)
    words = (("check", "old.py", "--scenario", "cart.toml/calm") if command == "check" else
             ("run", "cart.toml/calm", "--plugin", "old.py", "--estimators", "old", "--runs", 2, "--jobs", 1))
    done = railstate(*words)
    assert done.code == 2 and "Traceback" not in done.err and done.err.count("error:") == 1
    for part in told:
        assert part in done.err
    assert "portion" not in PLUGIN  # the one that is used elsewhere is of today's
