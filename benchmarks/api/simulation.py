"""One run of a scenario as tables: its truth, and what an estimator is told and hears."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...scenarios.arrays import Array
from ...scenarios.errors import InputError
from ...scenarios.randomness import Streams
from ...scenarios.setting import Setting
from ..planning.naming import find_one

if TYPE_CHECKING:
    import pandas as pd


class Simulated(NamedTuple):
    """truth: a line per step. measurements: a line per measured instant, NaN for what did not arrive in time. The index
    is seconds from the start."""

    truth: pd.DataFrame
    measurements: pd.DataFrame


def simulate(scenario: str | Path, run: int = 0, *, seed: int = 1,
             overrides: Mapping[str, Any] | None = None) -> Simulated:
    """A run's truth and measurements, those that `railstate run` has under the same seed and number.

    scenario: a built-in name, NAME/VARIANT or a TOML file. truth: the state in SI units (of a recording: position and
    speed), then the parameters behind it, NaN where unknown. measurements: inputs told over the interval that ends
    there (`input 1`, ..), the readings; where some come late, by how many steps (`NAME late`), and where sensors fail,
    whether a reading is faulty (`NAME faulty`). In a closed loop the trains are steered by their true states. Raises
    InputError."""
    if run < 0:
        raise InputError(f"run = {run}: must be 0 or more")
    found, variant = find_one(str(scenario), overrides)
    return simulated(found.setting(variant), Streams(seed, found.name, variant, (run,)))


def simulated(setting: Setting[Any], streams: Streams) -> Simulated:
    """The same of a setting; the streams of one run."""
    world = setting.world(streams)
    model = setting.design_model({}, world.initial_mean)
    times: list[float] = []
    truths: list[Array] = []
    stamps: list[float] = []
    lines: list[dict[str, Any]] = []
    mean = world.initial_mean
    for k in range(world.steps):
        step = world.step(k, mean)
        if not step.active[0]:
            break
        mean, gone = step.truth[:model.own].copy(), 0.0
        start, length = _of_run(step.start), _of_run(step.length)
        times.append(start + length)
        truths.append(step.truth[:, 0].copy())
        for event in step.events:
            gone += _of_run(event.share)
            stamps.append(start + gone * length if length else start)
            line: dict[str, Any] = {f"input {i + 1}": value for i, value in enumerate(step.u[:, 0].tolist())}
            for i, name in enumerate(model.measurements):
                line[name] = float(event.y[i, 0]) if event.received[i, 0] else np.nan
                if event.late is not None and event.late[i, 0]:
                    line[name], line[f"{name} late"] = float(event.y[i, 0]), int(event.late[i, 0])
                if event.faulty is not None:
                    line[f"{name} faulty"] = bool(event.faulty[i, 0])
            lines.append(line)
    import pandas as pd

    values = np.array(truths)
    names = [*model.states[:model.own], *(f"parameter {i + 1}" for i in range(values.shape[1] - model.own))]
    names = names[:values.shape[1]]  # a recording knows the first of the states alone
    return Simulated(pd.DataFrame(values, pd.Index(times, name="time"), names),
                     pd.DataFrame(lines, pd.Index(stamps, name="time")))


def _of_run(value: float | Array) -> float:
    return float(np.asarray(value).reshape(-1)[0])
