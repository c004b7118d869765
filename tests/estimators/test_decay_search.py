"""The search for the fastest decay on bounds of the test's own, without a solver: what is tried, where it ends."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from railstate.estimators.registry import estimators
from railstate.estimators.ultimate_bound import decay, lmi
from railstate.estimators.ultimate_bound.decay import Decay, fastest_decay, printed_decay, trade_off
from railstate.estimators.ultimate_bound.lmi import Certificate
from railstate.scenarios.errors import Infeasible, Unsupported

SYSTEM: Any = "the system"
K, P = np.ones((2, 1)), np.eye(2)


@pytest.fixture
def tried(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[float], float]], list[Any]]:
    """What is asked of a bound over the decay; infinite: none."""
    def of(bound: Callable[[float], float]) -> list[Any]:
        found = list[Any]()

        def asked(system: Any, theta: float, **how: Any) -> Certificate:
            assert system is SYSTEM
            found.append((theta, how))
            if bound(theta) == np.inf:
                raise Infeasible(f"none at {theta}")
            return Certificate(theta, bound(theta), K, P, "S", "optimal", -1.0, 0.0)

        monkeypatch.setattr(decay, "ultimate_bound", asked)
        return found

    return of


@pytest.mark.parametrize(("edge", "begins"), [
    (0.97, [0.98, 0.97, 0.95, 0.96]), (0.925, [0.98, 0.97, 0.95, 0.9, 0.925, 0.9125]), (0.981, [0.98, 0.985, 0.9825]),
    (0.9999, [0.98, 0.985, 0.99, 0.995, 0.999, 0.9999]), (0.98, [0.98, 0.97, 0.975]),
    (0.1, [0.98, 0.97, 0.95, 0.9, 0.8, 0.6, 0.3, 0.15, 0.075])])
def test_the_edge_is_found_to_the_tolerance(edge: float, begins: list[float], tried: Any) -> None:
    """A bound that is just kept is kept."""
    asked = tried(lambda theta: 1.0 if theta >= edge else np.inf if theta < edge / 2 else 2.0)
    found = fastest_decay(SYSTEM, 1.0, multipliers="free", tolerance=1e-3, solver="S")
    assert edge <= found.theta <= edge + 1e-3 and found.bound == 1.0 and found.seconds > 0
    thetas = [theta for theta, _ in asked]
    assert thetas[:len(begins)] == pytest.approx(begins) and len(thetas) < 22
    assert all(how == {"multipliers": "free", "solver": "S"} for _, how in asked)
    widths = np.abs(np.diff(thetas))
    assert widths[-1] > 0.25e-3  # not beyond what was asked for


def test_a_valley_between_the_decays_tried(tried: Any) -> None:
    asked = tried(lambda theta: 1.0 + 1e4 * (theta - 0.9925) ** 2 if theta > 0.981 else np.inf)
    found = fastest_decay(SYSTEM, 1.01)
    assert 0.9915 <= found.theta <= 0.9915 + 5e-4 and found.bound <= 1.01
    assert [theta for theta, _ in asked[:6]] == [0.98, 0.985, 0.99, 0.995, 0.999, 0.9999]
    assert asked[0][1] == {"multipliers": "scalar", "solver": "CLARABEL"}
    with pytest.raises(Infeasible, match=r"under varpi = 0\.99 .*: the least bound found is 1 at theta = 0\.9925; try"):
        fastest_decay(SYSTEM, 0.99, tolerance=1e-5)
    tried(lambda theta: np.inf)
    with pytest.raises(Infeasible, match=r"no decay up to 0\.9999 has a certificate; try a larger varpi"):
        fastest_decay(SYSTEM, 0.99)


def test_trade_off_and_the_printed_form(tried: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = tried(lambda theta: 1 / theta if theta > 0.5 else np.inf)
    (a, one), (b, none) = trade_off(SYSTEM, [0.8, 0.4], multipliers="free", solver="S")
    assert (a, b) == (0.8, 0.4) and isinstance(one, Certificate) and one.bound == 1.25 and str(none) == "none at 0.4"
    assert asked == [(0.8, {"multipliers": "free", "solver": "S"}), (0.4, {"multipliers": "free", "solver": "S"})]
    told = list[Any]()

    def corollary2(system: Any, varpi: float | None, *, solver: str) -> Decay:
        told.append((system, varpi, solver))
        if varpi == 9.0:
            raise Infeasible("no solution")
        return Decay(1.25, K, P, "S", "optimal", 1e-9, 3.0)

    monkeypatch.setattr(decay, "corollary2", corollary2)
    assert printed_decay(SYSTEM, 7.0, solver="S") == Certificate(0.8, 7.0, K, P, "S", "optimal", 3.0, 1e-9)
    with pytest.raises(Infeasible, match=r"^no solution; \(32\) alone admits gamma_bar = 1\.25 at most, and a decay"):
        printed_decay(SYSTEM, 9.0)
    assert told == [(SYSTEM, 7.0, "S"), (SYSTEM, 9.0, "CLARABEL"), (SYSTEM, None, "CLARABEL")]


def test_what_estimators_ask_for(monkeypatch: pytest.MonkeyPatch) -> None:
    told = list[Any]()
    for module, name in ((decay, "fastest_decay"), (decay, "printed_decay"), (lmi, "ultimate_bound")):
        monkeypatch.setattr(module, name, lambda *given, name=name, **how: told.append((name, *given, how)))

    class Model:
        details: dict[str, float] = {"varpi": 5.0, "theta": 0.9}

    known: Any = Model()
    for plugin, parameters in (("fastest-decay", {}), ("fastest-decay", {
            "varpi": 2.0, "tolerance": 0.01, "multipliers": "free"}), ("fastest-decay", {"form": "printed"}),
            ("ultimate-bound", {}), ("ultimate-bound", {"theta": 0.7, "multipliers": "free"})):
        made: Any = estimators()[plugin](parameters)
        made._solve(SYSTEM, made._target(known))
    assert told == [
        ("fastest_decay", SYSTEM, 5.0, {"multipliers": "scalar", "tolerance": 5e-4}),
        ("fastest_decay", SYSTEM, 2.0, {"multipliers": "free", "tolerance": 0.01}), ("printed_decay", SYSTEM, 5.0, {}),
        ("ultimate_bound", SYSTEM, 0.9, {"multipliers": "scalar"}),
        ("ultimate_bound", SYSTEM, 0.7, {"multipliers": "free"})]
    known.details = {}
    made = estimators()["ultimate-bound"]({})
    assert made._target(known) == 0.98
    with pytest.raises(Unsupported, match="fastest-decay needs varpi"):
        estimators()["fastest-decay"]({})._target(known)  # type: ignore[attr-defined]
