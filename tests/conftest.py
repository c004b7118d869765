"""Shared fixtures: the command line driven in a temporary folder, a throw-away scenario with loose estimators.

Also the studies of minutes, which run when asked for (`pytest --long all`)."""

from __future__ import annotations

import hashlib
import io
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from railstate.benchmarks import cli

from .expected import compare

SCENARIO = """
name = "cart"
title = "a cart on a line, for tests"
[time]
period = 1.0
steps = 40
[plant]
kind = "linear"
A = [[1, 1], [0, 1]]
B = [[0.5], [1]]
C = [[1, 0]]
Q = [[0.01]]
R = [[1]]
x0 = [0, 1]
P0 = [[1, 0], [0, 0.01]]
states = ["position", "speed"]
units = ["m", "m/s"]
[channel]
kind = "bernoulli"
p = 0.8
[estimators.half]
plugin = "half"
[variants.calm]
title = "calm"
[variants.rough.plant]
Q = [[1.0]]
"""

PLUGIN = '''
"""A fixed-gain filter and misbehaving relatives; `RUN` is what a run's own stream draws first."""
import os, time
import numpy as np
from railstate.estimators.interface import Estimate, Estimator


class Half(Estimator):
    summary = "gain one half"

    def start(self, model, runs, random):
        super().start(model, runs, random)
        self.x = model.initial_mean.copy()
        self.numbers = np.array(random.runs)
        self.noise = random.normal(1)[0]

    def predict(self, u, interval):
        self.x = np.stack([self.x[0] + interval.length * self.x[1], self.x[1]])

    def update(self, measurement):
        innovation = np.where(measurement.received[0], measurement.y[0] - self.x[0], 0.0)
        self.x = self.x + np.stack([0.5 * innovation, 0.1 * innovation])

    def estimate(self):
        return Estimate(self.x + 1e-9 * self.noise)


class Raises(Half):
    def update(self, measurement):
        super().update(measurement)
        if (self.numbers == 3).any():
            raise ArithmeticError("run 3 is not for me")


class Wanders(Half):
    def estimate(self):
        return Estimate(np.where(self.numbers == 2, np.nan, self.x))


class Blank(Half):
    def estimate(self):
        return Estimate(self.x * np.nan)


class Dies(Half):
    def update(self, measurement):
        super().update(measurement)
        if (self.numbers == 5).any():
            os._exit(3)


class DiesAtOnce(Half):
    def update(self, measurement):
        if (self.numbers == 0).any():
            os._exit(3)


class Leaves(Half):
    def update(self, measurement):
        if (self.numbers == 2).any():
            raise SystemExit(5)


class Short(Half):
    def estimate(self):
        return Estimate(self.x[:1])


class OneForAll(Half):
    def estimate(self):
        return Estimate(self.x, covariance=np.ones((2, 2, 1 + len(self.numbers) // 2)))


class Listing(Half):
    def estimate(self):
        return Estimate(self.x.tolist())


class Hangs(Half):
    def update(self, measurement):
        super().update(measurement)
        if (self.numbers == 1).any():
            time.sleep(1000)


class Slow(Half):
    def update(self, measurement):
        super().update(measurement)
        time.sleep(0.01)
'''


FIRST = ("test_documents.py", "test_packaging.py")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--long", default="none", metavar="none|all|SHARE:SEED",
                     help="the studies marked long: none of them, all, or a drawn share (0.1:7)")
    parser.addoption("--rewrite", action="store_true", help="write anew what tests/expected holds")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out the studies marked long that --long does not ask for; a share is drawn by each one's own name. Files of
    tests that each take long go first: at the end the other process would wait for them."""
    wanted, _, seed = str(config.getoption("--long")).partition(":")
    share = {"none": 0.0, "all": 1.0}.get(wanted)
    share = float(wanted) if share is None else share

    def left_out(item: pytest.Item) -> bool:
        drawn = hashlib.sha256(f"{seed} {item.nodeid}".encode()).digest()
        return item.get_closest_marker("long") is not None and int.from_bytes(drawn[:4]) >= share * 2**32

    config.hook.pytest_deselected(items=[item for item in items if left_out(item)])
    items[:] = sorted((item for item in items if not left_out(item)), key=lambda item: item.path.name not in FIRST)


@pytest.fixture(scope="session", autouse=True)
def text_is_utf_8() -> Iterator[None]:
    """No module of ours reads or writes text in the machine's own encoding."""
    usual = io.text_encoding

    def told(encoding: str | None, stacklevel: int = 2) -> str:
        caller = sys._getframe(2).f_globals.get("__name__", "")
        assert encoding or not caller.startswith("railstate."), f"{caller}: text without its encoding"
        return usual(encoding, stacklevel)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(io, "text_encoding", told)
        yield


@pytest.fixture
def expected(request: pytest.FixtureRequest) -> Callable[[str, str], None]:
    """Compares a text with the committed one of that name."""
    return lambda name, text: compare(name, text, request.config.getoption("--rewrite"))


@dataclass
class Outcome:
    """What a command did."""

    code: int
    out: str
    err: str


class Command:
    """Runs `railstate ARGS` in this process, in a temporary folder."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
        self.folder, self.monkeypatch, self.capfd = folder, monkeypatch, capfd

    def __call__(self, *words: str | Path | int) -> Outcome:
        self.monkeypatch.setattr(sys, "argv", ["railstate", *map(str, words)])
        self.capfd.readouterr()
        code = 0
        try:
            cli.main()
        except SystemExit as error:
            code = error.code if isinstance(error.code, int) else int(error.code is not None)
        captured = self.capfd.readouterr()
        return Outcome(code, captured.out, captured.err)


@pytest.fixture
def railstate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Command:
    """The command line, in a temporary folder that holds cart.toml and half.py."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("COLUMNS", raising=False)  # tables as without a terminal
    (tmp_path / "cart.toml").write_text(SCENARIO)
    (tmp_path / "half.py").write_text(PLUGIN)
    return Command(tmp_path, monkeypatch, capfd)
