"""A cluster's parts in this process: a client that computes what it is given, dies or is lost as a test says.

The real one is in `test_cluster.py`; here its words, its bookkeeping and every way in which it ends are known."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import joblib
import pandas as pd
import pyarrow as pa
import pytest
from distributed import KilledWorker
from joblib.externals import loky  # pyright: ignore[reportMissingImports]
from railstate.benchmarks.isolation.process import Ended
from railstate.benchmarks.planning.plan import Plan, make_plan
from railstate.benchmarks.running import cluster, result
from railstate.benchmarks.running.isolated import Loss, Losses
from railstate.benchmarks.running.machinery import Machinery
from railstate.benchmarks.running.runner import run
from railstate.estimators.interface import Status
from railstate.scenarios.errors import InputError

from ..conftest import PLUGIN, SCENARIO

ADDRESS = "tcp://host:8786"
THREADS = {"tcp://one:1": 1, "tcp://one:2": 1, "tls://two:7": 1}


class Client:
    """Computes tasks when it is asked for their results. broken: what happens to which submission instead."""

    def __init__(self, broken: dict[int, Any] | None = None) -> None:
        self.broken, self.given, self.asked, self.status, self.released = broken or {}, [], [], "running", 0

    def nthreads(self) -> dict[str, int]:
        return THREADS

    def wait_for_workers(self, count: int, timeout: float) -> None:
        assert (count, timeout) == (1, cluster.PATIENCE)

    def run(self, function: Callable[..., Any], *arguments: Any) -> dict[str, Any]:
        return dict.fromkeys(THREADS, function(*arguments))

    def submit(self, function: Callable[..., Any], *arguments: Any, pure: bool) -> Any:
        number, fault = len(self.given), self.broken.get(len(self.given))
        self.given.append(arguments)
        assert not pure

        def result() -> Any:
            self.asked.append(len(self.given))
            if isinstance(fault, BaseException):
                raise fault
            return fault if isinstance(fault, cluster.Done) else function(*arguments)

        def release() -> None:
            self.released += 1

        status = fault if isinstance(fault, str) else "finished"
        future = SimpleNamespace(key=str(number), status=status, result=result, release=release)
        future.add_done_callback = lambda put: put(future) if fault != "never" else None
        return future


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    folder = tmp_path_factory.mktemp("cart")
    (folder / "cart.toml").write_text(SCENARIO)
    (folder / "half.py").write_text(PLUGIN)
    return make_plan([f"{folder}/cart.toml/calm"], only=["kalman", "ekf", "half"], plugins=[f"{folder}/half.py"],
                     runs=6)


@pytest.fixture(scope="module")
def here(plan: Plan) -> pd.DataFrame:
    return table(plan, Machinery(1))


def on(client: Client, plan: Plan, monkeypatch: pytest.MonkeyPatch, batch: int = 1) -> pd.DataFrame:
    @contextmanager
    def connected(address: str) -> Iterator[Client]:
        assert address == ADDRESS
        yield client

    monkeypatch.setattr(cluster, "_client", connected)
    return table(plan, Machinery(4, batch, ADDRESS))


def table(plan: Plan, machinery: Machinery) -> pd.DataFrame:
    tables = [result.rows for result in run(plan, {}, machinery)]
    found = pa.concat_tables(tables, promote_options="default").to_pandas()
    found = found.drop(columns=["seconds", "exception"]).astype({"estimator": str})
    return found.sort_values(["estimator", "run"]).reset_index(drop=True)


def test_rows_of_workers_are_those_of_here(plan: Plan, here: pd.DataFrame, monkeypatch: pytest.MonkeyPatch) -> None:
    client = Client()
    pd.testing.assert_frame_equal(on(client, plan, monkeypatch), here, check_exact=True)
    assert len(client.given) == client.released == 12  # kalman and ekf share a task of each run, half has its own
    assert client.asked[0] == 3 * cluster.AHEAD and client.asked == sorted(client.asked)
    for task, words, alike, digest, losses in client.given:
        assert words == Machinery(2, 1, "")  # as many jobs as the greatest machine has threads, and no scheduler
        assert digest == (plan.catalogue["half"].hash if task.labels == ("half",) else "") and losses == {}
        assert alike.keys() > {"numpy", "numba", "scipy", "railstate.benchmarks.running.execute"}
        assert {"railstate.scenarios.linear", "railstate.estimators.kalman"} <= {
            name.rpartition(".")[0] if name.endswith("setting") else name for name in alike}


def test_what_a_worker_cannot_or_dies_of_is_computed_here(plan: Plan, here: pd.DataFrame,
                                                          monkeypatch: pytest.MonkeyPatch) -> None:
    ended = Ended(Status.crashed, "the process running it died")
    client = Client({0: KilledWorker("x", "y", []), 3: cluster.Done(None, "a worker is odd", {}), 5: cluster.Done(
        None, "a worker is odd", {("cart/calm", "half"): Loss(1, 2, ended)})})
    with pytest.warns(UserWarning) as caught:
        pd.testing.assert_frame_equal(on(client, plan, monkeypatch), here, check_exact=True)
    rows_of = [sum(len(client.given[n][0].runs) * len(client.given[n][0].labels) for n in numbers)
               for numbers in ((0,), (3, 5))]
    assert [str(found.message) for found in caught] == [
        f"--scheduler {ADDRESS}: several workers died of a task: {rows_of[0]} rows are computed here",
        f"--scheduler {ADDRESS}: a worker is odd: {rows_of[1]} rows are computed here"]
    told = [losses for task, *_, losses in client.given if task.labels == ("half",)]
    assert told[-1] == {("cart/calm", "half"): Loss(1, 2, ended)} and told[0] == {}


@pytest.mark.parametrize("fault", [OSError("gone"), TimeoutError(), CancelledError(), "cancelled", "lost", "never"])
def test_a_cluster_that_is_lost(plan: Plan, monkeypatch: pytest.MonkeyPatch, fault: Any) -> None:
    monkeypatch.setattr(cluster, "PATIENCE", 0.1)
    client = Client(dict.fromkeys(range(12), fault))
    if fault == "never":
        client.status = "closed"
    with pytest.raises(InputError) as caught:
        on(client, plan, monkeypatch)
    assert str(caught.value) == (f"--scheduler {ADDRESS}: is lost, or all its workers are; what is done is kept, the "
                                 "same command continues")


def test_what_a_task_raises_is_raised_and_workers_must_be_alike(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ArithmeticError, match="mine"):
        on(Client({0: ArithmeticError("mine")}), plan, monkeypatch)
    client = Client()
    client.run = lambda *_: {"tcp://one:1": "", "tcp://one:2": "scipy 1, not 2"}
    with pytest.raises(InputError, match=f"{ADDRESS}: its worker tcp://one:2 has scipy 1, not 2: the same must be th"):
        on(client, plan, monkeypatch)

    def fails(*_: Any) -> Any:
        raise ModuleNotFoundError("No module named 'railstate'")

    client.run = fails
    with pytest.raises(InputError, match=f"{ADDRESS}: a worker cannot run railstate: No module named 'railstate'"):
        on(client, plan, monkeypatch)

    def waits(*_: Any, **__: Any) -> None:
        raise TimeoutError

    client.wait_for_workers = waits
    with pytest.raises(InputError, match=f"{ADDRESS}: has no workers"):
        on(client, plan, monkeypatch)


def test_what_a_worker_says_of_its_code(monkeypatch: pytest.MonkeyPatch) -> None:
    here, name = cluster.version("numpy"), "railstate.estimators.kalman"
    alike = {"numpy": here, name: cluster.source_hash(name)}
    assert cluster.differences(alike) == ""
    assert cluster.differences({**alike, "numpy": "0.1"}) == f"numpy {here}, not 0.1"
    assert cluster.differences({**alike, name: "x"}) == f"other code of {name}"
    monkeypatch.setattr(cluster, "NUMERICAL", ("no-such-package",))
    assert cluster.differences({"no-such-package": "1"}) == "no-such-package none, not 1"


def test_a_task_of_a_stranger_on_a_worker(plan: Plan) -> None:
    """Computed apart with what it has cost before, what it costs sent back; not at all with another plug-in."""
    (task,) = [task for task in cluster.make_tasks(plan, {}, 1, 6) if task.labels == ("half",)]
    digest, machinery = plan.catalogue["half"].hash, Machinery(1)
    found = cluster.compute(task, machinery, {}, digest, {})
    assert found.result is not None and found.result.rows.num_rows == 6 and found[1:] == ("", {})
    assert found.result.curves is not None and set(found.result.rows["status"].to_pylist()) == {"ok"}
    assert cluster.compute(task, machinery, {"numpy": "0"}, digest, {}).unlike.startswith("numpy ")
    assert cluster.compute(task, machinery, {}, "odd", {}) == (None, "a worker has another plug-in half", {})
    assert [cluster._known(*of, "x") for of in (("nobody", ""), ("half", "none.py"), ("kalman", ""))] == [
        "a worker has no plug-in nobody", "a worker has no plug-in half", "a worker has another plug-in kalman"]
    before = {("cart/calm", "half"): Loss(3, 3, Ended(Status.timeout, "hung"))}
    lost = cluster.compute(task, machinery, {}, digest, before)
    assert lost.result is not None and lost.losses == {} and set(lost.result.rows["status"].to_pylist()) == {"timeout"}
    assert set(lost.result.rows["reason"].to_pylist()) == {"not run after 3 lost processes: hung"}


def test_what_a_worker_loses_is_told_where_the_command_runs(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    """And not on the worker, which knows what was lost before."""
    (task,) = [task for task in cluster.make_tasks(plan, {}, 1, 6) if task.labels == ("half",)]
    key, ended, seen = ("cart/calm", "half"), Ended(Status.crashed, "died"), []

    def loses(tasks: list[Any], machinery: Machinery, losses: Losses) -> Iterator[Any]:
        seen.append((tasks, machinery, dict(losses.found)))
        losses.put(key, Loss(1, 4, ended))
        yield result.lost(tasks[0], *ended)

    monkeypatch.setattr(cluster, "isolated", loses)
    before = {key: Loss(2, 2, Ended(Status.timeout, "hung")), ("cart/calm", "other"): Loss(1, 1, ended)}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = cluster.compute(task, Machinery(1), {}, plan.catalogue["half"].hash, before)
    assert found.unlike == "" and found.losses == {key: Loss(1, 4, ended)} and seen == [([task], Machinery(1), before)]
    assert found.result is not None and (found.result.curves, found.result.kept) == (None, None)
    assert found.result.rows.equals(result.lost(task, *ended).rows)
    own = next(task for task in cluster.make_tasks(plan, {}, 1, 6) if task.labels != ("half",))
    assert cluster.compute(own, Machinery(1), {"numpy": "0"}, "", {}).result is None


def test_losses_end_an_estimator_in_a_cell() -> None:
    ended, key = Ended(Status.crashed, "died"), ("s/v", "a")
    task = SimpleNamespace(cell=SimpleNamespace(key="s/v"), labels=("a",), runs=(0,))
    for runs, calls, over in ((2, 11, False), (3, 3, True), (2, 12, True)):
        losses = Losses({key: Loss(runs, calls, ended)}, quiet=True)
        found = losses.over(task)  # pyright: ignore[reportArgumentType]
        assert found == (Ended(Status.crashed, f"not run after {calls} lost processes: died") if over else None)
        task.labels = ("a", "b")
        assert losses.over(task) is None  # pyright: ignore[reportArgumentType]
        task.labels = ("a",)
    losses = Losses()
    for number in (0, 1):
        losses.add(task, ended)  # pyright: ignore[reportArgumentType]
        task.runs = (0, 1)[:1 + number]
    losses.put(key, Loss(0, 1, Ended(Status.timeout, "hung")))
    assert losses.found == {key: Loss(2, 3, Ended(Status.timeout, "hung"))}
    with pytest.warns(UserWarning, match=r"^s/v/a: lost 4 processes \(died\): the rest of its runs are lost too$"
                      ) as told:
        losses.put(key, Loss(1, 1, ended))
        losses.put(key, Loss(1, 1, ended))
    assert len(told) == 1


@pytest.mark.parametrize("error", [TimeoutError(), loky.process_executor.TerminatedWorkerError("died")])
def test_workers_of_which_one_died_or_hung_are_ended_and_their_tasks_done_apart(
        plan: Plan, here: pd.DataFrame, monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    ended = []

    class Parallel:
        def __init__(self, **words: Any) -> None:
            assert words == {"n_jobs": 3, "backend": "loky", "timeout": 900.0, "batch_size": 1,
                             "return_as": "generator_unordered", "pre_dispatch": "2*n_jobs"}

        def __call__(self, calls: Any) -> Iterator[Any]:
            function, arguments, _ = next(calls)
            yield function(*arguments)
            raise error

    monkeypatch.setattr(joblib, "Parallel", Parallel)
    monkeypatch.setattr(loky, "get_reusable_executor",
                        lambda: SimpleNamespace(shutdown=lambda **words: ended.append(words)))
    pd.testing.assert_frame_equal(table(plan, Machinery(3, 3)), here, check_exact=True)
    assert ended == [{"wait": False, "kill_workers": True}]
