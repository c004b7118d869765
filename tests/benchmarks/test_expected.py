"""What the tool says, draws, writes and computes, whole, beside committed text (to renew it: `tests/expected.py`).

Tables, figures and page of hand-made rows; help and lists; rows and figures of short runs of every setting."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
import railstate as api
from railstate.benchmarks import cli
from railstate.benchmarks.commands.table import table
from railstate.benchmarks.planning.plan import Plan
from railstate.benchmarks.running.latency import TIMING
from railstate.benchmarks.store.folder import Store
from railstate.benchmarks.studies import complete
from railstate.benchmarks.telling.figures.catalogue import FIGURES, drawn
from railstate.benchmarks.telling.figures.data import Results, load_results
from railstate.benchmarks.telling.report.page import render
from railstate.benchmarks.telling.results import print_results, print_results_json

from ..conftest import SCENARIO, Command
from ..expected import figure, page

Expected = Callable[[str, str], None]

EXAMPLES = files("railstate.scenarios.recorded") / "examples"
TRAM = {"time": "t_s", "position": "s_gnss_m", "speed": "v_kmh", "odometer": "odo_m", "acceleration": "acc_mps2",
        "reference_position": "s_ref_m", "reference_speed": "v_ref_mps"}
METRO = {"time": "t_s", "acceleration": "acc_mps2", "reference_position": "s_ref_m", "reference_speed": "v_ref_mps",
         "wheel-a": "wheel_a_m", "wheel-b": "wheel_b_m"}
LINE = {"stops": [0.0, 400.0], "gradients": [[0.0, 0.0], [200.0, 0.008]], "speed_limits": [[0.0, 15.0]]}
FEW = {"time.steps": 60}
SHORT: Mapping[str, dict[str, Any]] = {
    "braking-rate/stop": FEW, "cbtc-csma/push-pull": FEW, "moving-block/law-p": FEW,
    "moving-block/law-p-fixed-block": FEW, "ningbo-metro/switching-bias": {"plant.line.stops": [0.0, 400.0, 800.0]},
    "rap-example-1/corrected": FEW,
    "rap-example-2/printed": FEW,
    "odometry/wet-radar": {**{f"plant.line.{key}": value for key, value in LINE.items()}, "plant.tunnels": [[150, 250]],
                           "plant.balises.positions": [10, 120, 300], "plant.balises.platforms": [],
                           "plant.adhesion.low": [[200, 260]]},
    "recorded/sweep": {"plant.recording": str(EXAMPLES / "tram.csv"), "plant.map": TRAM},
    "recorded-odometry/wheels": {"plant.recording": str(EXAMPLES / "metro.csv"), "plant.map": METRO,
                                 "plant.balises": str(EXAMPLES / "balises.csv")}}


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> list[Store]:
    """Two runs of a variant of each setting, with all its entries; times of design and step left out."""
    top, stores = tmp_path_factory.mktemp("short"), []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(complete, "timing_table", _timing)
        for number, (name, overrides) in enumerate(SHORT.items()):
            runs = 3 if "sweep" in name else 2
            api.run(name, runs=runs, seed=3, jobs=1, folder=top / str(number), overrides=overrides, quiet=True)
            stores.append(Store(top / str(number)))
    return stores


def _timing(plan: Plan, *_: Any) -> pd.DataFrame:
    return pd.DataFrame([{"scenario": cell.scenario, "variant": cell.variant, "estimator": label, "design_s": 0.001,
                          "latency_us_median": 5.0 + place, "latency_us_p99": 9.0 + 2 * place, "samples": 100,
                          "throughput_ns": 400.0, "sampling_period_s": 0.1} for cell in plan.cells
                         for place, label in enumerate(cell.entries)], columns=list(TIMING))


def _figures(folders: list[Results], left_out: Collection[str] = ()) -> dict[str, list[str]]:
    """By name each figure of the first variant of each scenario."""
    found: dict[tuple[str, str], str] = {}
    for results in folders:
        for one, scenario, variant, canvas in drawn(results):
            if one.name not in left_out and (one.name, scenario) not in found:
                found[one.name, scenario] = f"{one.name} {scenario}/{variant}\n{figure(canvas.svg())}"
    return {name: [text for (one, _), text in found.items() if one == name] for name, _ in found}


def test_figures(results: Results, expected: Expected) -> None:
    expected("figures", "\n".join(itertools.chain(*_figures([results]).values())))


def test_figures_of_short_runs(results: Results, short: list[Store], expected: Expected) -> None:
    """Those that hand-made rows lack: each one there is, is drawn. Of the others as much as tells that one differs."""
    known, folders = {one.name for one, *_ in drawn(results)}, [load_results(store.folder) for store in short]
    more = _figures(folders, known)
    assert known | set(more) == {one.name for one in FIGURES}
    some = load_results(results.folder, entries=("sma", "gsma", "ekf-naive", "direct", "kalman"), width=400.0)
    rest = [text for found in _figures([some, *folders], set(more)).values() for text in found]
    expected("figures-of-runs", "\n".join([*itertools.chain(*more.values()), *(
        f"{text.partition(chr(10))[0]} {text.count(chr(10))} {sha256(text.encode()).hexdigest()[:12]}"
        for text in rest if "moving-block" not in text)]))  # a closed loop is no such exact thing


MACHINE = {"environment": {"processor": "one", "cores": 2, "platform": "any", "python": "3", "git_dirty": True,
                           "git_commit": "0123456789ab", "packages": {"numpy": "2", "scipy": "1"}},
           "started": "2026-01-02T03:04:05+00:00", "finished": "2026-01-02T03:14:05+00:00", "railstate": "0"}


def test_the_page(results: Results, expected: Expected) -> None:
    manifest = {**results.manifest, **MACHINE}
    text = page(render(replace(results, folder=Path("DIR"), manifest=manifest)))
    assert str(results.folder) not in text
    expected("page", text)


def test_tables(results: Results, expected: Expected, capsys: pytest.CaptureFixture[str],
                monkeypatch: pytest.MonkeyPatch) -> None:
    """On a terminal of 80 and 120 columns, as JSON, and for papers."""
    monkeypatch.chdir(results.folder.parent)  # lines are wrapped by how long its name is
    folder = results.folder.name
    for width in (80, 120):
        monkeypatch.setenv("COLUMNS", str(width))
        print_results(Store(folder))
    for format_ in ("tex", "md", "csv", "html"):
        table(folder, format_=format_, scenarios="ningbo-metro,braking-rate")
    expected("tables", capsys.readouterr().out)
    print_results_json(Store(folder))
    said = json.loads(capsys.readouterr().out)
    lines = [" ".join(f"{value:.8e}" if isinstance(value, float) else str(value) for value in line.values())
             for line in said.pop("verdicts") if line["variant"] in ("uniform", "switching")]
    expected("verdicts", "\n".join([json.dumps(said), *lines]))


def test_tables_and_pages_of_short_runs(short: list[Store], expected: Expected, capsys: pytest.CaptureFixture[str],
                                        monkeypatch: pytest.MonkeyPatch) -> None:
    """What hand-made rows lack: windows, outages, requirements, faults, notes of each setting."""
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.chdir(short[0].folder.parent)
    for store in short:
        print_results(Store(store.folder.name))
    expected("tables-of-runs", capsys.readouterr().out)
    out = []
    for name in ("odometry", "recorded", "ningbo-metro"):
        found = load_results(next(store.folder for store in short if name in store.rows()["scenario"].tolist()))
        made = page(render(replace(found, folder=Path("DIR"), manifest={**found.manifest, **MACHINE})))
        out.append(made.partition("<main>")[2].partition('id="provenance"')[0])
    expected("pages-of-runs", "\n".join(out).replace(str(EXAMPLES), "EXAMPLES"))


def test_help_and_lists(railstate: Command, expected: Expected) -> None:
    out = [railstate("--help").out, *(railstate(name, "--help").out for name in cli.COMMANDS),
           *(railstate("new", name, "--help").out for name in ("estimator", "scenario", "recording"))]
    expected("help", "\n".join(out))
    shown = (("list",), ("show", "cart.toml", "--plugin", "half.py"), ("show", "half", "--plugin", "half.py"),
             ("show", "rap-example-1"), ("show", "imm"))
    expected("lists", "\n".join(railstate(*words).out for words in shown))


def test_rows_of_short_runs(short: list[Store], expected: Expected) -> None:
    """Every number of every row, times of computing apart."""
    out = []
    for store in short:
        rows = store.rows()
        for (scenario, variant, estimator), part in rows.groupby(["scenario", "variant", "estimator"], sort=False,
                                                                 observed=True):
            out.append(f"{scenario}/{variant} {estimator} {' '.join(part['status'])} {part['steps'].tolist()}")
            for name, column in part.items():
                if ":" in str(name) and column.notna().any():
                    out.append(f"  {name} {' '.join(f'{value:.8e}' for value in column)}")
    expected("rows", "\n".join(out))


CART = SCENARIO.replace('[estimators.half]\nplugin = "half"', "\n".join(
    f'[estimators.{label}]\nplugin = "{plugin}"' for label, plugin in (
        ("kalman", "kalman"), ("ukf", "ukf"), ("held", "dead-reckoning"), ("certified", "robust-mean-square"))))


def test_commands(railstate: Command, expected: Expected, monkeypatch: pytest.MonkeyPatch) -> None:
    """A session with a small scenario: whatever each command says."""
    monkeypatch.setattr(complete, "timing_table", _timing)
    Path("cart.toml").write_text(CART)
    for item in EXAMPLES.iterdir():
        Path(item.name).write_bytes(item.read_bytes())
    text = Path("tram.csv").read_text().splitlines()
    Path("torn.csv").write_text("\n".join([*text[:20], text[12], *text[20:40], *text[60:]]))
    Path("new").mkdir()
    few = ("--runs", 21, "--jobs", 1)
    out = []
    for words in (
            ("run", "cart.toml", *few, "--out", "A"),
            ("run", "cart.toml/calm", *few, "--out", "B", "--set", "estimators.held.plugin=direct-kalman"),
            ("run", "cart.toml/calm", *few, "--out", "B", "-e", "kalman,held", "--set", "estimators.held.plugin=ekf"),
            ("run", "cart.toml/calm", *few, "--out", "C", "--until", "rmse:position=50%"),
            ("compare", "A", "B"), ("compare", "B", "C"), ("verify", "A"), ("replay", "cart/calm/ukf/3", "--out", "A"),
            ("show", "kalman", "--out", "A"), ("show", "cart.toml", "--keys"), ("design", "cart.toml/calm"),
            ("inspect", "tram.csv"), ("inspect", "metro.csv"), ("inspect", "fixes.csv"), ("inspect", "torn.csv"),
            ("check", "kalman"), ("sweep", "cart.toml/calm", "--over", "channel.p=0.5,0.9", *few, "--out", "S"),
            ("report", "S"), ("plot", "A", "--figure", "nees", "--out", "plots"),
            ("table", "A", "--format", "md", "--quantities", "position"), ("new", "estimator", "mine", "--in", "new"),
            ("new", "scenario", "yours", "--in", "new")):
        done = railstate(*words)
        out += [f"$ railstate {' '.join(map(str, words))} # {done.code}", done.out, done.err]
    out += ["S/report.html", page(Path("S/report.html").read_text()).partition('id="provenance"')[0]]
    out += [f"{path}\n{figure(path.read_text())}" for path in sorted(Path("S").glob("*.svg"))]
    out += [f"{path}\n{path.read_text()}" for path in sorted(Path("new").rglob("*")) if path.is_file()]
    expected("commands", "\n".join(out).replace(str(Path.cwd()), "."))
