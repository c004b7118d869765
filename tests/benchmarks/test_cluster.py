"""A real Dask cluster of two workers: the same rows as here, whoever dies, hangs, is missing or is lost meanwhile."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pandas as pd
import pytest
from railstate.benchmarks.running import cluster as on_dask
from railstate.benchmarks.store.folder import Store
from railstate.estimators import registry

from ..conftest import PLUGIN, Command
from .test_run import rows, same

PLUG_INS = PLUGIN + '''

class Single(Half):
    def estimate(self):
        return Estimate(self.x.astype(np.float32))
'''


class Machine:
    """A scheduler and some workers, each a process."""

    def __init__(self, folder: Path, stack: ExitStack, workers: int) -> None:
        self.file = folder / "scheduler.json"
        common = ["--scheduler-file", str(self.file), "--no-dashboard"]

        def start(module: str, *words: str) -> subprocess.Popen[bytes]:
            process = subprocess.Popen([sys.executable, "-m", f"distributed.cli.{module}", *common, *words],
                                       cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            stack.callback(process.wait)
            stack.callback(process.kill)
            return process

        self.scheduler = start("dask_scheduler", "--port", "0", "--host", "127.0.0.1")
        self.workers = [start("dask_worker", "--nthreads", "1", "--no-nanny") for _ in range(workers)]
        until = time.monotonic() + 60
        while not self.file.exists():
            assert time.monotonic() < until
            time.sleep(0.05)
        import json

        self.address = json.loads(self.file.read_text())["address"]


@contextmanager
def machine(folder: Path, workers: int = 2) -> Iterator[Machine]:
    with ExitStack() as stack:
        yield Machine(folder, stack, workers)


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machine]:
    with machine(tmp_path_factory.mktemp("dask")) as found:
        yield found


def on(found: Machine) -> tuple[str, ...]:
    return "--backend", "dask", "--scheduler", found.address


@pytest.mark.long
def test_rows_are_those_of_here_beside_plug_ins_that_die_hang_and_round(railstate: Command, two: Machine) -> None:
    Path("half.py").write_text(PLUG_INS)
    words = ("run", "cart.toml/calm", "--estimators", "ekf,kalman,half,dies,hangs,single", "--plugin", "half.py",
             "--runs", 6, "--batch", 1, "--timeout", 6, "--keep", 1)
    assert railstate(*words, "--jobs", 1, "--out", "here").code == 0
    done = railstate(*words, *on(two), "--out", "there")
    assert done.code == 0 and not done.err, done.err
    here, there = rows("here"), rows("there")
    same(here, there)
    assert here.groupby("estimator")["status"].agg(lambda found: (found != "ok").sum()).to_dict() == {
        "ekf": 0, "kalman": 0, "half": 0, "dies": 1, "hangs": 1, "single": 6}
    for kind in ("curves", "trajectories"):
        first, second = (getattr(Store(name), kind)() for name in ("here", "there"))
        order = [name for name in first.columns if first[name].dtype.kind != "f"]
        first, second = (frame.astype(dict.fromkeys(order, str)).sort_values(order).reset_index(drop=True)
                         for frame in (first, second))
        pd.testing.assert_frame_equal(first, second, check_exact=kind == "trajectories")


def test_a_plug_in_that_workers_do_not_have_is_computed_here(
        railstate: Command, two: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = tmp_path / "site"
    (place / "known_here-1.0.dist-info").mkdir(parents=True)
    (place / "known_here.py").write_text(PLUGIN)
    (place / "known_here-1.0.dist-info" / "METADATA").write_text("Name: known-here\nVersion: 1\n")
    (place / "known_here-1.0.dist-info" / "entry_points.txt").write_text(
        "[railstate.estimators]\nknown-here = known_here:Half\n")
    monkeypatch.syspath_prepend(str(place))
    registry.installed.cache_clear()
    words = ("run", "cart.toml/calm", "--estimators", "ekf,known-here", "--runs", 4, "--batch", 2)
    assert railstate(*words, "--jobs", 1, "--out", "here").code == 0
    done = railstate(*words, *on(two), "--out", "there")
    registry.installed.cache_clear()
    assert done.code == 0, done.err
    assert done.err == (f"warning: --scheduler {two.address}: a worker has no plug-in known-here: 4 rows are computed "
                        "here\n")
    same(rows("here"), rows("there"))


def test_workers_with_other_code_are_refused(railstate: Command, two: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(on_dask, "version", lambda name: "0.1")
    refused = railstate("run", "cart.toml/calm", "--estimators", "ekf", "--runs", 2, *on(two))
    assert refused.code == 2 and refused.err.count("\n") == 1
    assert "its worker tcp://127.0.0.1:" in refused.err and ", not 0.1: the same must be there" in refused.err


@pytest.mark.parametrize("words", [
    ("sweep", "cart.toml/calm", "--over", "channel.p=0.5,0.9", "--estimators", "ekf"),
    ("compare", "ekf", "kalman", "--scenario", "cart.toml/calm"),
    ("tune", "ningbo-metro/white", "--estimator", "ekf-naive", "--over", "knowledge.sigma_w=0.01..1:log",
     "--objective", "rmse:speed", "--budget", "3"),
    ("reproduce", "zheng2015"),
], ids=lambda words: words[0])
def test_every_command_that_runs_takes_a_cluster(railstate: Command, words: tuple[str, ...],
                                                 monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(on_dask, "ANSWER", 0.5)
    refused = railstate(*words, "--backend", "dask", "--scheduler", "tcp://127.0.0.1:1", "--runs", 2, "--batch", 1,
                        "--timeout", 5, "--memory", 1)
    assert refused.code == 2 and "no Dask scheduler answers there" in refused.err, refused.err


def _once_begun(folder: str, act: signal.Signals, process: subprocess.Popen[bytes]) -> threading.Thread:
    """A thread that sends a signal to a process when the folder has its first rows."""
    def wait() -> None:
        until = time.monotonic() + 60
        while time.monotonic() < until and not list(Path(folder, "rows").glob("*.parquet")):
            time.sleep(0.02)
        os.kill(process.pid, act)

    thread = threading.Thread(target=wait)
    thread.start()
    return thread


@pytest.mark.long
def test_a_worker_that_is_killed_changes_no_row_and_a_lost_scheduler_is_one_line(
        railstate: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = ("run", "cart.toml/calm", "--estimators", "ekf,slow", "--plugin", "half.py", "--runs", 6, "--batch", 1)
    assert railstate(*words, "--jobs", 2, "--out", "here").code == 0
    with machine(tmp_path) as found:
        killer = _once_begun("killed", signal.SIGKILL, found.workers[0])
        done = railstate(*words, *on(found), "--out", "killed")
        killer.join()
        assert done.code == 0 and not done.err, done.err
        same(rows("here"), rows("killed"))
        killer = _once_begun("lost", signal.SIGKILL, found.scheduler)
        begun = time.monotonic()
        done = railstate(*words, *on(found), "--out", "lost")
        killer.join()
        assert done.code == 2 and time.monotonic() < begun + 30
        assert done.err == (f"error: --scheduler {found.address}: is lost, or all its workers are; what is done is "
                            "kept, the same command continues\n")
    kept = rows("lost")
    assert 0 < len(kept) < len(rows("here"))
    assert railstate(*words, "--out", "lost").code == 0
    same(rows("here"), rows("lost"))
