"""Plug-ins that do harm, each in a process of its own: the suite's own rows stay, theirs are lost or their affair.

All of them run beside `ekf`; each kind is a line of a table: where, what, and what its rows' reason says."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.metadata import EntryPoint, distribution
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from railstate.benchmarks import cli
from railstate.benchmarks.store.folder import Store
from railstate.scenarios import registry
from railstate.scenarios.linear import LinearSystem

from ..conftest import Command

HEAD = '''
import builtins, json, os, random, signal, sys, threading, time, warnings
import numpy as np
from railstate.estimators.interface import Estimate, Estimator
from railstate.scenarios.errors import InputError


class Quiet(Estimator):
    summary = "holds the start"

    def start(self, model, runs, random):
        super().start(model, runs, random)
        self.x = np.array(model.initial_mean, dtype=float)

    def predict(self, u, interval):
        self.do_predict(u)

    def do_predict(self, u):
        pass

    def update(self, measurement):
        self.do_update(measurement.y, measurement.received)

    def do_update(self, y, received):
        pass

    def estimate(self):
        return Estimate(self.x)
'''

KINDS: dict[str, tuple[str, str, str]] = {
    "writes-y": ("update", "y += 1000", ""),
    "writes-received": ("update", "received[:] = False", ""),
    "writes-u": ("predict", "u *= 0", ""),
    "writes-start": ("update", "self.model.initial_mean[:] = 7", ""),
    "writes-spread": ("update", "self.model.initial_covariance[:] = 7", ""),
    "writes-matrices": ("update", "self.model.linear.A(0)[:] = 7", ""),
    "single-precision": ("estimate", "return Estimate(self.x.astype(np.float32))", "type float32"),
    "half-precision": ("estimate", "return Estimate(self.x.astype(np.float16))", "type float16"),
    "whole-numbers": ("estimate", "return Estimate(self.x.astype(int))", "type int64"),
    "complex-numbers": ("estimate", "return Estimate(self.x + 0j)", "type complex128"),
    "objects": ("estimate", "return Estimate(self.x.astype(object))", "type object"),
    "words": ("estimate", "return Estimate(self.x.astype(str))", "mean has shape"),
    "listing": ("estimate", "return Estimate(self.x.tolist())", "mean is list"),
    "nothing": ("estimate", "return None", "AttributeError"),
    "too-short": ("estimate", "return Estimate(self.x[:1])", "mean has shape"),
    "odd-covariance": ("estimate", "return Estimate(self.x, covariance=np.eye(7)[:, :, None])", "covariance has shape"),
    "no-number": ("estimate", "return Estimate(self.x * np.nan)", "not finite"),
    "endless": ("estimate", "return Estimate(self.x * np.inf)", "not finite"),
    "odd-status": ("update", "self.status[:] = 99", "is not a valid Status"),
    "no-status": ("update", "self.status = None", "Error"),
    "odd-reasons": ("update", "self.status[:] = 2; self.reasons = {n: object() for n in range(9)}", "object"),
    "surrogates": ("update", "raise ValueError('\\ud800 x')", "x"),
    "long-words": ("update", "raise ValueError('x' * 10**6)", "ValueError: xxx"),
    "raises-input-error": ("update", "raise InputError('mine')", "InputError: mine"),
    "interrupt": ("update", "raise KeyboardInterrupt", "KeyboardInterrupt"),
    "leaves": ("update", "sys.exit(0)", "SystemExit: 0"),
    "raises-base-exception": ("update", "raise BaseException('b')", "BaseException: b"),
    "raises-generator-exit": ("update", "raise GeneratorExit", "GeneratorExit"),
    "raises-memory-error": ("update", "raise MemoryError", "MemoryError"),
    "recursion": ("update", "self.do_update(y, received)", "RecursionError"),
    "exits": ("update", "os._exit(0)", "exit code 0"),
    "aborts": ("update", "os.abort()", "Aborted"),
    "kills-itself": ("update", "os.kill(os.getpid(), 9)", "Killed"),
    "kills-its-parent": ("update", "os.kill(os.getppid(), 9); time.sleep(9)", "died"),
    "closes-stdout": ("update", "os.close(1)", ""),
    "closes-everything": ("update", "os.closerange(0, 200)", "died"),
    "changes-folder": ("update", "os.chdir('/')", ""),
    "no-environment": ("update", "os.environ.clear()", ""),
    "signal-handlers": ("update", "[signal.signal(n, signal.SIG_IGN) for n in (2, 15)]", ""),
    "numpy-raises": ("update", "np.seterr(all='raise')", ""),
    "global-generator": ("update", "np.random.seed(1); random.seed(1)", ""),
    "warns": ("update", "warnings.warn('overflow of mine')", ""),
    "prints": ("update", "print('x' * 1000)", ""),
    "no-print": ("update", "builtins.print = None", ""),
    "no-json": ("update", "json.dumps = None", ""),
    "lies-in-json": ("update", "json.dumps = lambda *a, **k: '[]'", ""),
    "patches-scorer": ("update", "from railstate.benchmarks.scoring import scorer; scorer.Scorer.add = None", ""),
    "patches-ekf": ("update", "from railstate.estimators import kalman; kalman.ExtendedKalman.update = None", ""),
    "patches-registry": ("update", "from railstate.estimators import registry; registry.estimators().clear()", ""),
    "reads-frames": ("update", "f = sys._getframe()\n"
                     "        while f:\n            f.f_locals.get('world'); f = f.f_back", ""),
    "threads": ("update", "threading.Thread(target=time.sleep, args=(99,), daemon=True).start()", ""),
    "forks-once": ("update", "self.made = getattr(self, 'made', 0) or os.fork() or time.sleep(99)", ""),
    "forks-and-returns": ("update", "self.made = getattr(self, 'made', 0) or os.fork() or 1", ""),
    "forks-many": ("update", "[os.fork() or time.sleep(99) for _ in range(70)]; time.sleep(99)",
                   "more than 64 processes"),
    "allocates": ("update", "bytearray(1 << 36)", "MemoryError"),
}
ENDLESS: dict[str, tuple[str, str, str]] = {
    "loops": ("update", "while True: pass", "did not finish within 2 s"),
    "sleeps": ("predict", "time.sleep(999)", "did not finish within 2 s"),
    "deaf-loops": ("update", "[signal.signal(n, signal.SIG_IGN) for n in (1, 2, 15)]\n"
                   "        while True: time.sleep(1)", "did not finish within 2 s"),
}


def hostile(kinds: dict[str, tuple[str, str, str]]) -> str:
    """A file with a class for each kind."""
    text = HEAD
    for name, (where, what, _) in kinds.items():
        cls = "".join(part.capitalize() for part in name.split("-"))
        head = {"update": "do_update(self, y, received)", "predict": "do_predict(self, u)",
                "estimate": "estimate(self)"}[where]
        text += f"\n\nclass {cls}(Quiet):\n    def {head}:\n        {what}\n"
    return text


@pytest.mark.parametrize(("kinds", "timeout"), [(KINDS, 60), (ENDLESS, 2)], ids=["harm", "endless"])
def test_only_their_own_rows_suffer(railstate: Command, kinds: dict[str, tuple[str, str, str]], timeout: int) -> None:
    Path("hostile.py").write_text(hostile(kinds))
    common = ("run", "cart.toml/calm", "--runs", 1, "--jobs", 2, "--keep", 0)
    assert railstate(*common, "--estimators", "ekf", "--out", "alone").code == 0
    done = railstate(*common, "--estimators", ",".join(["ekf", *kinds]), "--plugin", "hostile.py", "--out", "beside",
                     "--timeout", timeout, "--memory", 4)
    assert done.code == 0, done.err
    rows = Store("beside").rows()
    alone, beside = (frame[frame["estimator"] == "ekf"].drop(columns="seconds").reset_index(drop=True)
                     for frame in (Store("alone").rows(), rows))
    pd.testing.assert_frame_equal(beside[alone.columns.tolist()], alone, check_exact=True, check_dtype=False)
    assert set(alone["status"]) == {"ok"}
    wrong = {}
    for name, (_, _, expected) in kinds.items():
        mine = rows[rows["estimator"] == name]
        told = expected == "" or ((mine["status"] != "ok").all()
                                  and mine["reason"].str.contains(expected, regex=False).all())
        if len(mine) != 1 or not told:
            wrong[name] = mine[["status", "reason"]].to_numpy().tolist()
    assert not wrong
    assert [line for line in done.err.splitlines() if "overflow of mine" in line] == [
        f"warning: overflow of mine ({Path('hostile.py').resolve()}:{number})"
        for number, line in enumerate(Path("hostile.py").read_text().splitlines(), 1) if "overflow of mine" in line]


def test_there_are_fifty() -> None:
    assert len(KINDS) + len(ENDLESS) >= 50


@pytest.mark.parametrize(("text", "message"), [
    ("import sys; sys.exit(0)", "does not import: SystemExit: 0"),
    ("import os; os._exit(0)", "cannot be imported: the process running it died (exit code 0)"),
    ("raise KeyboardInterrupt", "does not import: KeyboardInterrupt"),
    ("x = 1", "holds no subclass"),
])
def test_an_import_that_ends_everything_is_one_message(railstate: Command, text: str, message: str) -> None:
    Path("odd.py").write_text(text + "\n")
    done = railstate("run", "cart.toml/calm", "--plugin", "odd.py", "--runs", 2)
    assert done.code == 2 and message in done.err and len(done.err.splitlines()) == 1


def test_two_of_one_name_are_refused(railstate: Command) -> None:
    Path("twice.py").write_text(Path("half.py").read_text())
    done = railstate("run", "cart.toml/calm", "--plugin", "half.py", "--plugin", "twice.py", "--runs", 2)
    assert done.code == 2 and "an estimator named half is in" in done.err


def interrupted() -> None:
    raise KeyboardInterrupt


@pytest.mark.parametrize(("act", "said"), [
    (lambda: sys.exit(0), "is left out: SystemExit: 0"),
    (lambda: os._exit(0), "is left out: SystemExit: 0"),
    (interrupted, "is left out: KeyboardInterrupt: "),
    (lambda: None, "no subclass of railstate.scenarios.setting.Setting"),
    (lambda: LinearSystem, "there is a setting of kind linear already"),
])
def test_a_setting_that_ends_everything_on_import_or_takes_a_name_is_left_out(
        monkeypatch: pytest.MonkeyPatch, act: Callable[[], Any], said: str) -> None:
    class Strange(EntryPoint):
        def load(self) -> Any:
            return act()

    class Linear(EntryPoint):
        dist = distribution("railstate")

        def load(self) -> Any:
            return LinearSystem

    points = [Strange("a-strange", "strange", "railstate.scenarios"), Linear("linear", "", "railstate.scenarios")]
    monkeypatch.setattr(registry, "entry_points", lambda group: points)
    with pytest.warns(UserWarning, match=said) as caught:
        assert registry.settings.__wrapped__() == {"linear": LinearSystem}
    assert len(caught) == 1 and "a-strange" in str(caught[0].message)


def test_an_interrupt_while_a_setting_is_imported_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    class Strange(EntryPoint):
        def load(self) -> Any:
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(registry, "entry_points", lambda group: [Strange("strange", "strange", group)])
    before = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr(signal, "default_int_handler", before)
    with pytest.raises(KeyboardInterrupt):
        registry.settings.__wrapped__()
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.skipif(sys.platform != "linux", reason="who descends from whom is read from /proc")
def test_sigterm_leaves_nobody_and_says_how_to_go_on(railstate: Command) -> None:
    text = Path("half.py").read_text().replace("            time.sleep(1000)", "            os.fork()\n"
                                               "            open(str(os.getpid()), 'w')\n            time.sleep(1000)")
    Path("stay.py").write_text(text)
    before = set(os.listdir())
    command = subprocess.Popen(
        [sys.executable, "-c", "from railstate.benchmarks.cli import main; main()", "run", "cart.toml/calm", "--plugin",
         "stay.py", "--estimators", "ekf,hangs", "--runs", "2", "--out", "cut", "--keep", "0"],
        stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    try:
        until = time.monotonic() + 120
        while len(there := [int(name) for name in set(os.listdir()) - before if name.isdecimal()]) < 2:
            assert command.poll() is None and time.monotonic() < until
            time.sleep(0.1)
        family = [pid for pid in map(int, filter(str.isdecimal, os.listdir("/proc"))) if command.pid in _above(pid)]
        assert set(there) <= set(family)
        command.terminate()
        said = command.communicate(timeout=60)[1]
        assert command.returncode == 130 and "the same command continues" in said and "Traceback" not in said
        until = time.monotonic() + 2
        while (left := [pid for pid in family if _above(pid)]) and time.monotonic() < until:
            time.sleep(0.05)
        assert left == []
    finally:
        command.kill()


def _above(pid: int) -> list[int]:
    """The living process and all it descends from; nothing where it has ended."""
    found: list[int] = []
    while pid > 1:
        try:
            state, parent = Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[:2]
        except OSError:
            return found
        if state == b"Z":
            return found
        found.append(pid)
        pid = int(parent)
    return found


def test_a_fault_of_our_own_is_a_plain_traceback(railstate: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody's data stand in it: no box with the values of all variables."""
    def fails(name: str) -> str:
        secret = "do not show " * 3
        raise ArithmeticError(f"of our own {len(secret)}")

    monkeypatch.setattr(cli, "version", fails)
    monkeypatch.setattr(sys, "excepthook", sys.__excepthook__)
    with pytest.raises(ArithmeticError) as caught:
        railstate("--version")
    sys.excepthook(caught.type, caught.value, caught.tb)
    said = railstate.capfd.readouterr().err
    assert said.startswith("Traceback (most recent call last):\n") and said.endswith("ArithmeticError: of our own 36\n")
    assert "do not show do not show" not in said
