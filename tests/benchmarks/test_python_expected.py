"""What the functions of `import railstate` take and return, whole, beside committed text (to renew it:
`tests/expected.py`): what is given, results as tables, a run's truth and readings."""

from __future__ import annotations

import json
import re
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import railstate
from pydantic import Field
from railstate.benchmarks.api.given import taken
from railstate.benchmarks.api.runs import _call
from railstate.benchmarks.telling.figures.data import Results
from railstate.estimators.interface import Parameters
from railstate.estimators.kalman import Kalman
from railstate.estimators.sigma_point import UnscentedKalman

from .test_expected import SHORT

Expected = Callable[[str, str], None]


class Drag(railstate.Estimator):
    """x+ = x- + g (y - x-)"""

    summary = "a gain on the position"

    class Parameters(Parameters):
        gain: float = Field(default=0.5, description="gain")

    start = predict = update = estimate = lambda self, *_: None  # pyright: ignore


class HTTPDrag2(Drag):
    """Begins with more than its parameters."""

    def __init__(self, word: Any) -> None:
        super().__init__({"gain": 0.25})
        self.word = word


class Old(Drag):
    """Written for the first edition."""

    def predict(self, u: Any, portion: Any) -> None: ...  # pyright: ignore

    def update(self, y: Any, received: Any) -> None: ...  # pyright: ignore


def hold_last(model: Any) -> Any:
    return lambda y, u: model.x0


GIVEN: dict[str, Any] = {
    "None": None, "'ekf'": "ekf", "['ekf', 'mine']": ["ekf", "mine"], "('ekf',)": ("ekf",), "Kalman": Kalman,
    "[Kalman(), Drag, hold_last]": [Kalman(), Drag, hold_last],
    "UnscentedKalman({'alpha': 0.5})": UnscentedKalman({"alpha": 0.5}),
    "{'a': Kalman, 'kalman': 'kalman', 'b': 'kalman'}": {"a": Kalman, "kalman": "kalman", "b": "kalman"},
    "{'a': Drag(), 'b': Drag({'gain': 0.5}), 'c': HTTPDrag2('go')}": {
        "a": Drag(), "b": Drag({"gain": 0.5}), "c": HTTPDrag2("go")},
    "HTTPDrag2": HTTPDrag2, "hold_last": hold_last, "{'l': lambda}": {"l": lambda model: None},
    "{'t': table}": {"t": {"plugin": "ekf", "knowledge": {"sigma_w": 1.0}}},
    "lambda": lambda model: None, "3": 3, "{'x': 3}": {"x": 3}, "[]": [], "{}": {}, "[table]": [{"plugin": "ekf"}],
    "['ekf', 'ekf']": ["ekf", "ekf"], "[Drag, Drag()]": [Drag, Drag()], "{'a b': 'ekf'}": {"a b": "ekf"},
    "{'-a': 'ekf'}": {"-a": "ekf"}, "{'': Drag}": {"": Drag}, "{3: 'ekf'}": {3: "ekf"}, "{'ekf': Drag}": {"ekf": Drag},
    "abstract": type("Part", (railstate.Estimator,), {}), "Old": Old, "lock": HTTPDrag2(threading.Lock()), "int": int}


def test_what_is_given(expected: Expected) -> None:
    """Each thing twice: the second time its pickle is there."""
    out = list[str]()
    for name, thing in GIVEN.items():
        try:
            only, entries, files = taken(thing)
            assert taken(thing)[:2] == (only, entries)
            for file in map(Path, files):
                assert file.is_file() and re.fullmatch(r"[0-9a-f]{16}", file.parent.name)
                assert file.parents[1].name.startswith("railstate-") and str(file).startswith(tempfile.gettempdir())
            said = f"{list(only)} {json.dumps(entries)} {[Path(file).name for file in files]}"
        except railstate.InputError as error:
            said = re.sub(r" at 0x\w+", "", str(error))
        out.append(f"{name}: {said}")
    some = taken(["ekf", "ukf"])
    out += [_call(*words) for words in (
        (["a"], taken(None), 100, 1, None, None), (["a"], some, 10, 2, Path("x"), {"channel.p": 0.5}),
        ([], some, 100, 1, "y", {}), (["a", Path("b.toml")], taken(None), 101, 1, "", None))]
    expected("given", "\n".join(out))


def _table(frame: pd.DataFrame) -> str:
    return frame.to_csv(float_format="%.8e", lineterminator="\n")


def test_results_as_tables(results: Results, expected: Expected) -> None:
    found = railstate.load(results.folder)
    timing = found.timing()
    assert timing is not None
    page = found._repr_html_().replace(str(results.folder), "DIR").replace("<tr", "\n<tr")
    out = [_table(frame) for frame in (found.summary(), found.compare("ekf", "ukf"), found.compare("direct", "kalman"),
                                       found.compare("kalman", "fastest-decay"), found.compare(found).head(12), timing)]
    expected("results-as-tables", "\n".join([*out, page, _table(railstate.scenarios()),
                                             _table(railstate.estimators())]))


def columns_of(frame: pd.DataFrame) -> list[str]:
    """A line each column: how many numbers, their mean, root mean square, first and last."""
    columns = {"time": frame.index.to_numpy(float), **{str(name): frame[name].to_numpy(float) for name in frame}}
    out = list[str]()
    for name, values in columns.items():
        known = values[~np.isnan(values)]
        facts = (known.mean(), np.sqrt((known**2).mean()), known[0], known[-1]) if len(known) else ()
        out.append(f"  {name}: {len(known)} of {len(frame)} {' '.join(f'{fact:.8e}' for fact in facts)}")
    return out


def test_a_run_s_truth_and_readings(expected: Expected) -> None:
    """Of every variant of every built-in scenario."""
    out = list[str]()
    for place, line in enumerate(railstate.scenarios().to_dict("records")):
        overrides = next((more for name, more in SHORT.items()
                          if "plant.line.stops" not in more and name.partition("/")[0] == line["scenario"]), {})
        for variant in (*line["variants"], *line["variants on request"]):
            name = f"{line['scenario']}/{variant}"
            try:
                found = railstate.simulate(name, place % 3, seed=3, overrides=overrides)
                out += [name, *columns_of(found.truth), *columns_of(found.measurements)]
            except railstate.InputError as error:  # of sensors that the recording lacks
                out += [name, str(error)]
    expected("simulated", "\n".join(out))
    with pytest.raises(railstate.InputError, match=r"^run = -1: must be 0 or more$"):
        railstate.simulate("rap-example-1", -1)
