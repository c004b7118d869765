"""Snapshots of every built-in estimator: what follows from one is to the bit what followed the first time; and what
estimators refuse, in whole words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from railstate.benchmarks.conformance.tapes import Case, scenario_case, small_case, small_model
from railstate.benchmarks.conformance.trial import Record, _Recorder, begun, difference
from railstate.benchmarks.running.loop import Loop
from railstate.estimators import registry
from railstate.estimators.interface import Estimator
from railstate.estimators.random_access.estimators import RandomAccessParameters
from railstate.estimators.registry import estimators
from railstate.scenarios.errors import Infeasible, InputError, Unsupported
from railstate.scenarios.model import Grid, grid_modes

from ..models import random

BEFORE = 7
"""Steps before the snapshot."""


def case_of(name: str) -> Case:
    """The small model, or a scenario that gives what an estimator needs."""
    cls, case = estimators()[name], small_case({})
    try:
        cls.require(case.model(case.tape.initial_mean))
        cls({}).design(case.model(case.tape.initial_mean))
    except (Unsupported, ValidationError):
        found = scenario_case(cls, name, {}, "odometry/wet" if name == "relocation" else "")
        assert found is not None
        return found
    return case


def rest(case: Case, estimator: Estimator) -> tuple[Record, dict[str, Any]]:
    """What an estimator says from step BEFORE on, and what it has counted then."""
    recorder = _Recorder(estimator.estimate())
    loop = Loop(case.tape, estimator, recorder)
    for k in range(BEFORE, case.tape.steps):
        loop.step(k)
    record = Record(recorder.estimates, recorder.when, estimator.status.copy(), dict(estimator.reasons),
                    recorder.innovations)
    counted = {**estimator.counters(), **estimator.extremes()}
    return record, {name: np.array(value) for name, value in counted.items()}


@pytest.mark.parametrize("name", sorted(name for name, cls in estimators().items() if cls.lag == 0))
def test_from_a_snapshot_all_goes_as_it_went(name: str) -> None:
    case = case_of(name)
    with np.errstate(all="ignore"):
        estimator = begun(estimators()[name], case, case.tape)
        loop = Loop(case.tape, estimator, _Recorder(estimator.estimate()))
        for k in range(BEFORE):
            loop.step(k)
        kept, found = estimator.snapshot(), list[tuple[Record, dict[str, Any]]]()
        for _ in range(3):
            found.append(rest(case, estimator))
            estimator.restore(kept)
    (first, counted), *others = found
    if name != "relocation":  # where balises lie, the train still stands
        assert any(not np.array_equal(first.estimates[0].mean, later.mean) for later in first.estimates[1:])
    for record, again in others:
        assert difference(record, first) is None and difference(first, record) is None
        assert record.reasons == first.reasons and list(again) == list(counted)
        for what, value in counted.items():
            np.testing.assert_array_equal(again[what], value, err_msg=what)


def refusal(name: str, parameters: dict[str, Any] | None = None, **changes: Any) -> str:
    """What an estimator says of the small model with some parts changed."""
    model = replace(small_model(np.zeros((2, 3))), **changes)
    cls = estimators()[name]
    with pytest.raises(Unsupported) as caught:
        cls.require(model)
        estimator = cls(parameters or {})
        estimator.design(model)
        estimator.start(model, 3, SimpleNamespace(uniform=lambda *_: np.zeros((1, 3))))  # pyright: ignore
    return str(caught.value)


def test_models_that_do_not_do(expected: Callable[[str, str], None]) -> None:
    """Whole refusals of a design model that lacks what an estimator stands on."""
    linear, bounds = small_model(np.zeros((2, 3))).linear, small_model(np.zeros((2, 3))).bounds
    assert linear is not None and bounds is not None
    leaning = np.array([[4.0, 0.5], [0.5, 1.0]])[:, :, None]
    said = {
        "coupled noise": refusal("gate", measurement_covariance=lambda measurement: leaning),
        "leaning start": refusal("rbpf", initial_covariance=leaning),
        "varying": refusal("ultimate-bound", linear=replace(linear, constant=False)),
        "no inverse": refusal("ultimate-bound", linear=replace(linear, A=lambda k: np.diag([1.0, 0.0]))),
        "more sensors than states": refusal("direct", linear=replace(linear, C=lambda k: np.ones((3, 2)))),
        "singular C": refusal("direct", linear=replace(linear, C=lambda k: np.ones((2, 2)))),
        "varying C": refusal("direct", linear=replace(linear, constant=False)),
        "no modes": refusal("rbpf", modes=None),
        "two needs": refusal("random-access", linear=None, reception=None),
        "telling": refusal("ultimate-bound", tells=("position", "speed")),
        "no bounds": refusal("robust-bounded", bounds=None),
        "weights": refusal("h-infinity", {"weights": [1.0, 2.0, 3.0]}),
        "sensors without bounds": refusal("robust-bounded", bounds=replace(bounds, v_bar=np.full(2, np.inf))),
        "forces without bounds": refusal("robust-bounded", bounds=replace(bounds, w_bar=np.array([np.inf]))),
        "a zonotope's sensors": refusal("zonotope", bounds=replace(bounds, v_bar=np.full(2, np.inf))),
        "a zonotope's forces": refusal("zonotope", bounds=replace(bounds, w_bar=np.array([np.inf]))),
        "curvature": refusal("robust-bounded", {"kappa": 1.0}),
        "a gain": refusal("fixed-gain", {"gain": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]}),
        "an ultimate bound": refusal("ultimate-bound", bounds=replace(bounds, M=np.ones((2, 1)))),
        "three in a group": refusal("gsma", modes=grid_modes(Grid(
            "f", np.array([0.2, 0.5]), *(np.zeros((2, 2, n)) for n in (2, 1)), np.eye(2), np.eye(2), np.eye(2),
            np.full(2, 0.5)), small_model(np.zeros((2, 3)))), initial_covariance=np.zeros((2, 2, 1))),
    }
    for parameters in ({"kappa": -2.0}, {"kappa": -2.5, "alpha": 0.5}):
        with pytest.raises(Infeasible) as caught:
            estimators()["ukf"](parameters).start(small_model(np.zeros((2, 3))), 3, random(3))
        said[f"ukf {parameters}"] = str(caught.value)
    expected("refused-models", "\n".join(f"{what}: {text}" for what, text in said.items()))


def test_windows_of_a_claim() -> None:
    for given, said in (({"sigma": 1.0}, "sigma and m go together: give both or neither"),
                        ({"m": 3}, "sigma and m go together: give both or neither"),
                        ({"sigma": 1.0, "m": 10, "horizon": 10}, "m must be less than horizon = 10")):
        with pytest.raises(ValidationError) as caught:
            RandomAccessParameters(**given)
        assert caught.value.errors()[0]["msg"] == f"Value error, {said}"
    assert RandomAccessParameters(sigma=1.0, m=9, horizon=10).m == 9


class Point(SimpleNamespace):
    """An entry point of another package."""

    def load(self) -> Any:
        """What it stands for, or what it raises."""
        if isinstance(self.what, Exception):
            raise self.what
        return self.what

    def __lt__(self, other: Point) -> bool:
        return (self.name, self.package) < (other.name, other.package)


class Mine(Estimator):
    """A plug-in that does nothing."""

    def start(self, model: Any, runs: int, random: Any) -> None: ...
    def predict(self, u: Any, interval: Any) -> None: ...
    def update(self, measurement: Any) -> None: ...
    def estimate(self) -> Any: ...


class Before(Mine):
    """One of the first edition."""

    def predict(self, u: Any, portion: Any) -> None: ...  # pyright: ignore[reportIncompatibleMethodOverride]


def test_installed_plug_ins(monkeypatch: pytest.MonkeyPatch, recwarn: pytest.WarningsRecorder,
                            expected: Callable[[str, str], None]) -> None:
    """Which count, which are left out with what words, and what is said of those that do not do."""
    points = [Point(name=name, package=package, what=what, value=f"{package}:{name}") for name, package, what in (
        ("ekf", "theirs", Mine), ("=cmd()", "theirs", Mine), ("twice", "a", Mine), ("twice", "b", Mine),
        ("twice", "c", Mine), ("good", "a", Mine), ("broken", "a", ImportError("no such thing")), ("odd", "a", int),
        ("thing", "a", 3), ("old", "a", Before), ("ckf", registry.SUITE, Mine))]
    known = registry.estimators()
    monkeypatch.setattr(registry, "entry_points", lambda group: points if group == registry.GROUP else [])
    monkeypatch.setattr(registry, "distribution", lambda point: point.package)
    monkeypatch.setattr(registry, "estimators", lambda: known)
    registry.installed.cache_clear()
    try:
        said = [f"installed: {' '.join(registry.installed())}", *(str(one.message) for one in recwarn.list)]
        assert registry.estimator_class("good", "x.toml") is Mine
        assert registry.estimator_class("ekf", "x.toml") is known["ekf"]
        for name in ("broken", "odd", "thing", "old", "twice", "none"):
            with pytest.raises(InputError) as caught:
                registry.estimator_class(name, "x.toml: estimators.a")
            said.append(f"{name}: {caught.value}")
    finally:
        registry.installed.cache_clear()
    expected("plug-ins", "\n".join(said))
