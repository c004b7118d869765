"""`railstate design` and `certify`: gains and their certified bounds, offline, before any run.

A design is a scenario's estimators' own `design` step; a certificate is Theorem 1 put to any gain."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import pandas as pd
import typer

from ...estimators.interface import Estimator
from ...estimators.random_access.losses import growth, plant
from ...estimators.random_access.losses import losses as mean_covariance
from ...estimators.registry import estimator_class
from ...estimators.ultimate_bound.decay import trade_off
from ...estimators.ultimate_bound.estimators import FixedGain
from ...estimators.ultimate_bound.gains import read_gain
from ...estimators.ultimate_bound.moments import mean_square, measured_fall
from ...estimators.ultimate_bound.system import error_system
from ...scenarios.channels.gilbert_elliott import GilbertElliott
from ...scenarios.errors import Infeasible, InputError, Unsupported
from ...scenarios.model import DesignModel
from ...scenarios.randomness import Streams
from ...scenarios.schema import EstimatorEntry
from ...scenarios.setting import Setting
from ...scenarios.world import Trajectory
from ..isolation.process import IMPORT, Ended
from ..planning.catalogue import Catalogue
from ..planning.naming import find_one
from ..running.drive import prepare
from ..telling.console import print_table
from .options import Estimators, Sets, labels, names_in, overrides, written

Theta = Annotated[float | None, typer.Option(help="Decay asked of the certificate, between 0 and 1 (the scenario's).")]
Delta = Annotated[float | None, typer.Option(help="sqrt(sum delta_i^2) in newtons (the scenario's resistive law).")]
NONE = "not certified"
"""Where a bound would stand, of a gain or a design that has no certificate; why stands in its status."""
FALLING, RUNS = 400, 200
"""Steps and runs from which is measured how fast the start's error falls."""
Scenario = Annotated[str, typer.Argument(metavar="SCENARIO", help="Built-in name, NAME/VARIANT, or a TOML file.")]


def design(
    scenario: Scenario,
    estimators: Estimators = "",
    theta: Theta = None,
    delta: Delta = None,
    trade: Annotated[str, typer.Option("--trade-off", metavar="T,T,..",
                                       help="Certified bound against these decays instead, such as 0.97,0.98.")] = "",
    losses: Annotated[str, typer.Option(metavar="P,P,..", help=(
        "The Kalman filter's mean covariance and its bounds where these shares of packets arrive, such as 0.4,0.6."
    ))] = "",
    plot: Annotated[str, typer.Option(help="Draw trade-off or losses into this file (.svg, .pdf, .png).")] = "",
    out: Annotated[str, typer.Option(help="Write each gain to FOLDER/LABEL.csv, as `certify --gain` reads it.")] = "",
    set_: Sets = [],  # noqa: B006
) -> None:
    """Design a scenario's estimators and print gains and certified bounds."""
    setting, name, variant = _setting(scenario, theta, delta, set_)
    if plot and not (trade or losses):
        raise InputError("--plot: draws a trade-off or losses, so it needs --trade-off or --losses")
    if losses:
        _losses(setting, name, variant, _shares(losses, "--losses"), plot)
        return
    if trade:
        _trade_off(setting, name, variant, _shares(trade, "--trade-off"), plot)
        return
    rows: list[dict[str, Any]] = []
    gains: dict[str, np.ndarray] = {}
    others: dict[str, dict[str, Any]] = {}
    catalogue = Catalogue()
    for label in _labels(setting, estimators, catalogue):
        entry = setting.config.estimators.get(label) or EstimatorEntry(plugin=label)
        entry = entry.model_copy(update={"parameters": catalogue.parameters(
            entry.plugin, entry.parameters, f"{name}: estimators.{label}.parameters")})
        found = (_designed(setting, name, variant, estimator_class(entry.plugin, name), entry)
                 if catalogue.own(entry.plugin) else _designed_apart(setting, name, variant, catalogue, entry))
        if found.row:
            rows.append({"estimator": label, **found.row})
        if found.gain is not None:
            gains[label] = found.gain
        if found.other:
            others[label] = found.other
    if not rows and not others:
        raise InputError(f"{name}/{variant}: none of these estimators has anything to design")
    if rows:
        entries = setting.config.estimators
        print_table(f"Designs of {name}/{variant}", pd.DataFrame(rows),
                    [f"{row['estimator']}: {note}." for row in rows
                     if row["estimator"] in entries and (note := entries[row["estimator"]].note)])
    for label, other in others.items():
        print_table(f"Design of {label} on {name}/{variant}", pd.DataFrame(
            [{"what": what, "value": value} for what, value in _lines(other)]))
    for label, gain in gains.items():
        print_table(f"Gain of {label}", pd.DataFrame([
            {"": f"row {i + 1}", **{f"{j + 1}": f"{value:.5g}" for j, value in enumerate(row)}}
            for i, row in enumerate(gain)]))
        if out:
            with written("--out", out):
                Path(out).mkdir(parents=True, exist_ok=True)
                np.savetxt(Path(out) / f"{label}.csv", gain, delimiter=",", fmt="%.17g")


def certify(
    scenario: Scenario,
    gain: Annotated[str, typer.Option(metavar="FILE.csv", help="The gain K, one row a line, predictor form.")],
    theta: Theta = None,
    delta: Delta = None,
    set_: Sets = [],  # noqa: B006
) -> None:
    """Put any gain through Theorem 1: the least bound that can be certified for it. Exit code 1: there is none."""
    setting, name, variant = _setting(scenario, theta, delta, set_)
    rows, K = [], read_gain(gain)
    try:
        needed = _prepare(setting, name, variant, FixedGain, _fixed(K))[1]
    except Unsupported as reason:
        raise InputError(f"{name}/{variant}: {reason}") from None
    if K.shape != (needed.nx, needed.ny):
        raise InputError(f"{gain}: the gain is {K.shape[0]} x {K.shape[1]}, {name}/{variant} needs {needed.nx} x "
                         f"{needed.ny} (states x measurements)")
    for multipliers in ("scalar", "free"):
        found = _designed(setting, name, variant, FixedGain, _fixed(K, multipliers=multipliers))
        rows.append({"multipliers": {"scalar": "scalar (Theorem 1)", "free": "free (tighter)"}[multipliers],
                     **found.row})
    print_table(f"Certificates of {gain} on {name}/{variant}", pd.DataFrame(rows))
    if all(row["bound"] == NONE for row in rows):
        raise typer.Exit(1)


def _fixed(gain: np.ndarray, **parameters: Any) -> EstimatorEntry:
    return EstimatorEntry(plugin="fixed-gain", parameters={"gain": gain.tolist(), **parameters})


class _Designed(NamedTuple):
    """A row of the table with its gain; or whatever else a design tells, as nested names and values."""

    row: dict[str, str]
    gain: np.ndarray | None = None
    other: dict[str, Any] = {}


def _lines(found: dict[str, Any], path: str = "") -> list[tuple[str, str]]:
    """Nested names and values as lines; matrices row by row."""
    out: list[tuple[str, str]] = []
    for key, value in found.items():
        name = f"{path}: {key}" if path else key
        if isinstance(value, dict):
            out += _lines(value, name)
        else:
            matrix = np.atleast_2d(np.asarray(value)) if isinstance(value, list | np.ndarray) else None
            if matrix is None or matrix.dtype.kind not in "if":
                out.append((name, f"{value:.6g}" if isinstance(value, float) else str(value)))
            else:
                out += [(f"{name}, row {i + 1}" if len(matrix) > 1 else name, "  ".join(f"{x:.4g}" for x in row))
                        for i, row in enumerate(matrix)]
    return out


def _designed(setting: Setting[Any], name: str, variant: str, cls: type[Estimator],
              entry: EstimatorEntry) -> _Designed:
    """One row of the table; empty for an estimator that designs nothing. A gain that does not fit is an InputError."""
    try:
        estimator, model = _prepare(setting, name, variant, cls, entry)
        info = estimator.design(model)
    except Unsupported as reason:
        return _Designed({"bound": NONE, "status": f"unsupported: {reason}"})
    except Infeasible as reason:
        return _Designed({"bound": NONE, "status": f"infeasible: {reason}"})
    if "gain" not in info:
        return _Designed({}, other=info)
    bound, seconds, exact = info["bound"], info.get("design_s"), _exact(model, info["gain"])
    return _Designed({
        "bound": NONE if bound is None else f"{bound:.6g}",
        "status": info["status"],
        "decay theta": f"{info['theta']:.6g}",
        **exact,
        **(_measured(setting, name, variant, entry, info["gain"]) if exact else {}),
        "solver": info.get("solver", ""),
        "seconds": "" if seconds is None else f"{seconds:.2f}",
        "from": "" if seconds is None else "cache" if info["cached"] else "solver",
    }, info["gain"])


def _exact(model: DesignModel, K: np.ndarray) -> dict[str, str]:
    """What a constant gain's second moments really do, at the least and the greatest reception told."""
    try:
        system = error_system(model)
    except Unsupported:
        return {}
    (first, *others) = system.nodes
    chances = [None] if others or not first.spread else [first.mean - first.spread, first.mean + first.spread]
    try:
        found = [mean_square(system, K, chance) for chance in chances]
    except Unsupported:
        return {}

    def shown(values: list[float | None]) -> str:
        return " .. ".join("none" if value is None else f"{value:.3g}" for value in values)

    return {"reception": shown([first.mean if chance is None else chance for chance in chances]) if not others else "",
            "exact decay": shown([item.decay for item in found]),
            "long run, noise alone": shown([item.noise for item in found]),
            "long run, forces at their bounds": shown([item.forced for item in found])}


def _measured(setting: Setting[Any], name: str, variant: str, entry: EstimatorEntry, K: np.ndarray) -> dict[str, str]:
    """How fast a gain forgets the start's error in this scenario's own runs, where the start has one."""
    time = setting.config.time
    short = type(setting)(setting.config.model_copy(
        update={"time": time.model_copy(update={"steps": min(time.steps, FALLING)})}))
    world = short.world(Streams(0, name, variant, tuple(range(RUNS))))
    if not isinstance(world, Trajectory) or (world.truth[0] == world.initial_mean).all():
        return {}
    steps = measured_fall(short.told(entry.knowledge, entry.augment, world.initial_mean), K, world)
    return {"start's error at 1 %": "not reached" if steps is None else
            f"after {steps} steps ({0.01 ** (1 / steps):.3f} a step)"}


def _designed_apart(setting: Setting[Any], name: str, variant: str, catalogue: Catalogue,
                    entry: EstimatorEntry) -> _Designed:
    """The same of a plug-in, in a process of its own."""
    with catalogue.process(entry.plugin, IMPORT) as process:
        found = process.call(_plain, setting, name, variant, entry)
    if isinstance(found, Ended):
        return _Designed({"bound": NONE, "status": found.reason})
    row, gain, other = found
    return _Designed(row, None if gain is None else np.array(gain), other)


def _plain(setting: Setting[Any], name: str, variant: str, entry: EstimatorEntry) -> list[Any]:
    """A plug-in's design as plain data."""
    found = _designed(setting, name, variant, estimator_class(entry.plugin, name), entry)
    return json.loads(json.dumps(found, default=lambda value: np.asarray(value).tolist()))


def _prepare(setting: Setting[Any], name: str, variant: str, cls: type[Estimator],
             entry: EstimatorEntry) -> tuple[Estimator, DesignModel]:
    world = setting.world(Streams(0, name, variant, (0,)))
    return prepare(setting, cls, entry.parameters, entry.knowledge, world.initial_mean,
                   augment=entry.augment)


def _setting(scenario: str, theta: float | None, delta: float | None, set_: list[str]) -> tuple[Setting[Any], str, str]:
    told = {"knowledge.theta": theta, "knowledge.delta": delta}
    found, variant = find_one(scenario, {**overrides(set_), **{k: v for k, v in told.items() if v is not None}})
    return found.setting(variant), found.name, variant


def _labels(setting: Setting[Any], only: str, catalogue: Catalogue) -> list[str]:
    known = setting.config.estimators
    for label in labels(only):
        if label not in known and label not in catalogue.names():
            raise InputError(f"{setting.config.name}: there is no estimator \"{label}\"; allowed: {', '.join(known)}, "
                             f"or the name of an installed estimator: {', '.join(catalogue.names())}")
    return labels(only) or list(known)


def _shares(text: str, flag: str) -> list[float]:
    try:
        found = [float(word) for word in names_in(text)]
    except ValueError:
        found = []
    if not found or not all(0 < value < 1 for value in found):
        raise InputError(f"{flag} {text}: expected numbers between 0 and 1, such as 0.97,0.98,0.99")
    return found


def _losses(setting: Setting[Any], name: str, variant: str, shares: list[float], plot: str) -> None:
    """Mean covariance and its bounds over the share of packets that arrive; of bursts, whether it is bounded."""
    model = setting.design_model({}, setting.world(Streams(0, name, variant, (0,))).initial_mean)
    try:
        grows, found = growth(plant(model)[0]), [mean_covariance(model, p) for p in sorted(shares)]
    except Unsupported as reason:
        raise InputError(f"{name}/{variant}: --losses: {reason}") from None

    def shown(value: float | None) -> str:
        return "not known" if value is None else f"{value:.4g}" if np.isfinite(value) else "infinite"

    print_table(f"Trace of the Kalman filter's predicted covariance under losses, {name}/{variant}", pd.DataFrame([
        {"arrives": f"{item.p:g}", "lower bound S": shown(item.lower), "mean": shown(item.mean),
         "± 95 %": f"{1.96 * item.error:.2g}" if item.error else "", "upper bound V": shown(item.upper)}
        for item in found]))
    threshold = 1 - 1 / max(grows, 1.0)
    print(f"Infinite where the share is at most 1 - 1/rho^2 = {threshold:.4g}, rho the largest |eigenvalue| of A.")
    channel = setting.config.channel
    if isinstance(channel, GilbertElliott) and (channel.p_good, channel.p_bad) == (1.0, 0.0):
        left = (1 - channel.p_bad_good) * grows
        if left >= 1 or found[0].mean is not None:
            print(f"Bursts of this channel: (1 - p_bad_good) rho^2 = {left:.4g}, so the mean is "
                  f"{'bounded' if left < 1 else 'infinite'}, whatever the mean loss.")
    if plot:
        from ..telling.figures.losses import covariance_under_losses

        with written("--plot", plot):
            covariance_under_losses(found, threshold, f"Covariance under losses, {name}/{variant}").save(Path(plot))


def _trade_off(setting: Setting[Any], name: str, variant: str, thetas: list[float], plot: str) -> None:
    """Certified bound of Corollary 1 against the decay, as a table and, where asked for, a figure."""
    world = setting.world(Streams(0, name, variant, (0,)))
    try:
        found = trade_off(error_system(setting.design_model({}, world.initial_mean)), thetas)
    except Unsupported as reason:
        raise InputError(f"{name}/{variant}: {reason}") from None
    rows = [{"decay theta": f"{theta:g}", "bound": NONE, "status": str(item)} if isinstance(item, Infeasible) else
            {"decay theta": f"{theta:g}", "bound": f"{item.bound:.5g}", "status": item.status}
            for theta, item in found]
    print_table(f"Certified bound on E |z~|^2 against decay, {name}/{variant}", pd.DataFrame(rows))
    if not plot:
        return
    points = sorted((theta, item.bound) for theta, item in found if not isinstance(item, Infeasible))
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.5, 3.6), layout="constrained")
    axes = figure.subplots()
    axes.semilogy([theta for theta, _ in points], [bound for _, bound in points], "o-")
    for theta, item in found:
        if isinstance(item, Infeasible):
            axes.axvline(theta, color="0.7", linestyle=":", label="no certificate")
    if len(points) < len(found):
        handles, labels = axes.get_legend_handles_labels()
        axes.legend(handles[:1], labels[:1])
    axes.set_xlabel("decay theta per step")
    axes.set_ylabel("certified bound on E |z~|^2")
    axes.grid(True, alpha=0.3)
    with written("--plot", plot):
        figure.savefig(plot)
