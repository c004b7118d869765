"""`railstate sweep`: rows, tables and plots over values of a scenario's fields."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import pandas as pd
from railstate.benchmarks.telling.figures.canvas import LIGHT

from ..conftest import Command


def test_sweep_says_where_a_bound_is_exceeded_and_what_a_design_takes(railstate: Command) -> None:
    """The certificate is for 1 to 3 trains: with 20 the measured mean square is beyond it, and said to be."""
    done = railstate("sweep", "cbtc-csma", "--over", "channel.trains=1,20", "--set", "channel.traffic=constant",
                     "--set", "knowledge.trains=[1,3]", "--set", "plant.cars=2", "--set", "time.steps=1500",
                     "--estimators", "ultimate-bound", "--runs", 20, "--jobs", 1, "--metric",
                     "mean-square:performance,design:seconds", "--out", "swept")
    assert done.code == 0, done.err
    said = [line for line in done.out.splitlines() if line.startswith("at channel.trains = ")]
    assert len(said) == 1 and "20: ultimate-bound: measured mean square" in said[0] and "certified bound" in said[0]
    table = pd.read_csv(railstate.folder / "swept" / "sweep.csv")
    bound, measured = (table[(table["channel.trains"] == 20) & (table["metric"] == metric)]["value"].iloc[0]
                       for metric in ("bound", "mean-square"))
    assert f"is {measured / bound:.1f} times its certified bound" in said[0] and measured > bound
    assert (table[table["metric"] == "design"]["value"] > 0).sum() == 2 and "design seconds" in done.out


def test_sweep_writes_rows_table_and_plots(railstate: Command) -> None:
    done = railstate("sweep", "cart.toml", "--plugin", "half.py", "--over", "channel.p=0.3,0.9", "--runs", 10,
                     "--estimators", "half,kalman", "--out", "swept")
    assert done.code == 0, done.err
    table = pd.read_csv(railstate.folder / "swept" / "sweep.csv")
    part = table.query("kind == 'error' and quantity == 'position' and estimator == 'kalman'").set_index("channel.p")
    assert part.loc[0.3, "value"] > part.loc[0.9, "value"]
    drawn = (railstate.folder / "swept" / "rmse-position.svg").read_text()
    assert LIGHT["c0"] in drawn and LIGHT["c1"] in drawn  # the report's colours, one for each estimator
    assert "rmse position" in done.out


def test_a_sweep_over_several_keys_says_who_meets_which_requirement_where(railstate: Command) -> None:
    asked = "".join(f'''
[[requirements]]
name = "{name}"
form = "percentile"
quantity = "position"
percent = 95
limit = {within}
accept = 0.5
''' for name, within in (("wide", 1e6), ("none", 1e-9)))
    text = Path("cart.toml").read_text()
    Path("cart.toml").write_text(text.replace("[estimators.half]", asked + "[estimators.half]", 1))
    done = railstate("sweep", "cart.toml", "--plugin", "half.py", "--over", "channel.p=0.3,0.9", "--over",
                     "time.period=1.0,2.0", "--runs", 12, "--estimators", "ekf,kalman", "--jobs", 1, "--out", "swept")
    assert done.code == 0, done.err
    whole = pd.read_csv(railstate.folder / "swept" / "sweep.csv")
    each = pd.read_csv(railstate.folder / "swept" / "channel.p=0.3,time.period=1.0" / "verdicts.csv")
    assert list(whole) == ["channel.p", "time.period", *each]
    pd.testing.assert_frame_equal(whole.iloc[:len(each), 2:], each, check_dtype=False)
    table = pd.read_csv(railstate.folder / "swept" / "requirements.csv")
    keys = ["requirement", "channel.p", "time.period", "estimator"]
    met = {point: {"wide": "met", "none": "not met"}[str(point[0])] for point in itertools.product(
        ("wide", "none"), (0.3, 0.9), (1.0, 2.0), ("ekf", "kalman"))}
    assert table.set_index(keys)["verdict"].to_dict() == met
    lines = (railstate.folder / "swept" / "requirements.md").read_text().splitlines()
    grid = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")]
    assert grid[0] == ["requirement", "channel.p", "time.period", "ekf", "kalman"]
    assert len(grid) == 2 + 8 and all(
        row[3].startswith("✓ 100 %" if row[0] == "wide, 50 %" else "✗ 0 %") and "; P95 over runs: p95" in row[3]
        for row in grid[2:])
    assert "which estimator keeps what" in done.out
    assert railstate("report", "swept").code == 0
    [first] = re.findall('<table class="sortable" data-name="who keeps what">(.*?)</table>',
                         (railstate.folder / "swept" / "report.html").read_text(), re.S)
    page = [[re.sub("<[^>]+>", "", cell).replace("\u202f", " ").strip() for cell in re.findall(
        "<t[hd].*?</t[hd]>", line, re.S)] for line in re.findall("<tr>(.*?)</tr>", first, re.S)]
    assert page[0] == grid[0] and [row[:3] for row in page[1:]] == [row[:3] for row in grid[2:]]
    for row, line in zip(page[1:], grid[2:], strict=True):  # the same shares and sizes of errors in both
        assert [cell.replace(" ", "") for cell in row[3:]] == [
            cell.replace("; P95 over runs: ", "").replace("]", "]%").replace(" ", "") for cell in line[3:]]


def test_a_damaged_sweep_is_one_message(railstate: Command) -> None:
    Path("swept").mkdir()
    for text in ("{", "[]", '{"name": "a"}'):
        Path("swept/sweep.json").write_text(text)
        done = railstate("report", "swept")
        assert done.code == 2 and "sweep.json" in done.err and "Traceback" not in done.err
