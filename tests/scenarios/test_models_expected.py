"""What estimators are told, whole: every design model of every variant, its matrices and what its functions return at
a few points, beside committed text (to renew it: `tests/expected.py`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from railstate.benchmarks.api.listing import scenario_lines
from railstate.estimators.registry import estimators
from railstate.scenarios.errors import InputError, Unsupported
from railstate.scenarios.files import load
from railstate.scenarios.measurement import Interval, Measurement, untold
from railstate.scenarios.model import DesignModel, Inclusion, Linear
from railstate.scenarios.randomness import Streams
from railstate.scenarios.setting import Setting
from railstate.scenarios.world import Step

from ..benchmarks.test_expected import SHORT
from ..expected import digest

RUNS = (0, 1, 2)


def content(name: str, thing: Any) -> Iterator[str]:
    """Numbers and arrays of a part of a model, by name; functions are asked elsewhere."""
    if isinstance(thing, np.ndarray | int | float) and not isinstance(thing, bool):
        yield f"{name} {digest(thing)}"
    elif isinstance(thing, str | bool):
        yield f"{name} {thing}"
    elif is_dataclass(thing):
        for field in fields(thing):
            if field.name == "whole":  # addresses of machine code
                continue
            yield from content(f"{name}.{field.name}", getattr(thing, field.name))
    elif hasattr(thing, "_fields"):
        for key, part in thing._asdict().items():
            yield from content(f"{name}.{key}", part)
    elif isinstance(thing, dict):
        for key, part in thing.items():
            yield from content(f"{name}.{key}", part)
    elif isinstance(thing, tuple | list) and thing:
        if all(isinstance(part, int | float | str) for part in thing):
            yield f"{name} {thing}"
        else:
            yield from content(f"{name}[0]", thing[0])
            yield from content(f"{name}[-1]", thing[-1])


def answers(model: DesignModel, step: Step) -> Iterator[str]:
    """What the model's functions return around the truth of a step, over all of it and a part of it."""
    x = model.initial_mean + np.linspace(0.0, 0.1, model.initial_mean.size).reshape(model.initial_mean.shape)
    known = min(len(step.truth), model.own)
    x[:known] = step.truth[:known]
    P = 0.1 * np.eye(len(x))[:, :, None] + np.zeros(len(RUNS))
    number = max(step.number, 1)
    event = step.events[0]
    heard = Measurement(event.y, event.received, number, covariance=event.covariance)
    for share in (1.0, 0.4):
        over = Interval(number, step.start, step.length * share, share)
        asked: dict[str, Callable[..., Any] | None] = {
            "f": model.transition, "F": model.transition_jacobian, "Q": model.process_covariance,
            "G": model.input_jacobian}
        for name, function in asked.items():
            if function is not None:
                try:
                    yield f"{name} {share} {digest(function(x, step.u, over))}"
                except Unsupported as reason:
                    yield f"{name} {share} {reason}"
        if model.bounds is not None and model.bounds.part is not None:
            yield f"bounds.part {share} {digest(model.bounds.part(over))}"
        if model.densities is not None:
            z = np.random.default_rng(1).uniform(size=(model.densities.drawn, 4, len(RUNS)))
            yield f"noise {share} {digest(model.densities.process(z, over))}"
    yield f"h {digest(model.measurement(x, number))}"
    if model.measurement_jacobian is not None:
        yield f"H {digest(model.measurement_jacobian(x, number))}"
    if model.measurement_covariance is not None:
        yield f"R {digest(model.measurement_covariance(untold(number, model.ny)))}"
        yield f"R heard {digest(model.measurement_covariance(heard))}"
    if model.densities is not None:
        v = np.random.default_rng(2).normal(size=(model.ny, 4, len(RUNS)))
        yield f"log {digest(np.maximum(model.densities.log_measurement(v, heard), -1e3))}"
    if model.bounds is not None and model.bounds.kappa is not None:
        yield f"kappa {digest(model.bounds.kappa(x, step.u, P))}"
    if isinstance(model.linear, Linear):
        for name in "ABhCQR":
            yield f"{name} {[digest(getattr(model.linear, name)(k)) for k in (0, 1)]}"
    if isinstance(model.inclusion, Inclusion):
        between = model.inclusion.predict(model.inclusion.low + np.zeros(len(RUNS)), model.inclusion.high + np.zeros(
            len(RUNS)), step.u, Interval(number, step.start, step.length))
        y = model.measurement(x, number)
        full = Measurement(y, np.ones(y.shape, dtype=bool), number)
        for one in (heard, full):
            yield f"inclusion {[digest(end) for end in (*between, *model.inclusion.observe(*between, one))]}"


def refused(model: DesignModel) -> Iterator[str]:
    """Whom a model does not suit, and why."""
    for label, cls in estimators().items():
        try:
            cls.require(model)
        except Unsupported as reason:
            yield f"{label}: {reason}"


def told(model: DesignModel, step: Step) -> list[str]:
    lines = [*content("", model), *answers(model, step)]
    if model.modes is not None:
        lines += [line for mode in (model.modes.modes[0], model.modes.modes[-1]) for line in answers(mode.model, step)]
    return lines


def bound(setting: Setting[Any], step: Step) -> list[str]:
    """The model that bounds every estimator, where there is one."""
    found = setting.matched(len(RUNS))
    if found is None:
        return []
    more = [f"outward {digest(found.outward(step.truth))}"] if found.outward else []
    return [f"matched {found.kind}", *content("beyond", found.beyond), *more, *told(found.model, step)]


def test_what_every_estimator_is_told(expected: Callable[[str, str], None]) -> None:
    """Of each how many lines, and those that none before it in its scenario has."""
    out = list[str]()
    for line in scenario_lines():
        name, seen = line["scenario"], set[str]()
        overrides = next((more for key, more in SHORT.items() if key.partition("/")[0] == name), {})
        scenario = load(name, {} if "plant.line.stops" in overrides else overrides)
        for variant in scenario.variants:
            setting = scenario.setting(variant)
            world = setting.world(Streams(4, name, variant, RUNS))
            step = world.step(0, world.initial_mean)
            asked = {repr((entry.knowledge, entry.augment)): (label, entry)
                     for label, entry in setting.config.estimators.items()}
            out += [f"{name}/{variant}", *(f"  quantity {found.name} {found.unit}" for found in setting.quantities())]
            for label, entry in asked.values():
                who = list[str]()
                try:
                    model = setting.told(entry.knowledge, entry.augment, world.initial_mean)
                    lines, who = told(model, step), list(refused(model))
                except (InputError, Unsupported) as error:
                    lines = [str(error)]
                more = [line for line in dict.fromkeys([*lines, *who]) if line not in seen]
                out += [f"  {label}: {len(lines)}", *(f"    {line}" for line in more)]
                seen.update(more)
            for what, lines in (("sensing", content("", setting.sensing())), ("bound", bound(setting, step))):
                more = [line for line in dict.fromkeys(lines) if line not in seen]
                out += [f"  {what}", *(f"    {line}" for line in more)] if more else []
                seen.update(more)
    expected("models", "\n".join(out))
