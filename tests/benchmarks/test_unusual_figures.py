"""Figures of unusual cells: long runs, values over decades, ends that few runs reach, what one estimator alone kept.

Every figure is asked of every cell, whatever its setting; what is drawn stands in committed text."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from railstate.benchmarks.planning.plan import make_plan
from railstate.benchmarks.scoring.columns import PHASES
from railstate.benchmarks.telling.figures import catalogue, data, moving_block, requirements, sections, trust
from railstate.benchmarks.telling.figures.axes import Style
from railstate.benchmarks.telling.figures.catalogue import FIGURES, Figure, of_scenario
from railstate.benchmarks.telling.figures.data import CROWD, CellResults, Curve, Kept, Results, assign_styles
from railstate.benchmarks.telling.report import plots
from railstate.scenarios.errors import InputError

from ..expected import figure
from .test_worded import line

Expected = Callable[[str, str], None]
OF_ROWS = ("errors-per-run", "accuracy-latency", "certified", "headway")
T = np.linspace(1.0, 91.0, 300)
RISE = np.exp(0.05 * T)
"""Over a factor of 90: a scale that may be logarithmic is."""


def kept(labels: list[str], names: tuple[str, ...]) -> dict[tuple[str, str], Kept]:
    """Tracks that rise over decades, each label's error greater than that before, all of one sign."""
    return {(label, name): Kept(T, RISE + place, (1.1 + number / 4) * RISE + place, 0.1 * RISE + number)
            for number, label in enumerate(labels) for place, name in enumerate(names)}


def curves(labels: list[str], names: tuple[str, ...], floor: bool) -> dict[tuple[str, str], Curve]:
    """Of 40 runs, of which fewer go on: 5, then 4 and then 1. Each label's errors are 7 times those before."""
    active = np.where(T < 60, 40.0, np.where(T < 80, 5.0, np.where(T < 85, 4.0, 1.0)))
    found = {}
    for number, label in enumerate(labels):
        mean = 7.0 ** number * (2 + np.sin(T))
        for name in names:
            found[label, name] = Curve(T, active, active * mean, active * mean**2 * (2 + np.cos(T)) / 2, 0.3 * active,
                                       active * mean / 4 if floor else np.full(len(T), np.nan))
    return found


def unusual(cell: CellResults) -> list[CellResults]:
    """Wide ranges with a floor; three labels, of which the first kept nothing; nothing received; as many as `CROWD`."""
    labels, names = cell.ran, tuple(cell.about["quantities"])
    extras = {("", name): Kept(T, value, value, value) for name, value in (
        ("received", (T > 80) * 1.0), ("gradient", RISE / 1e3), ("disturbance", -RISE), ("speed-limit", 0 * T + 40.0),
        ("outage", (T % 30 > 20) * 1.0), ("since-reference", np.where(T < 20, np.nan, T % 30)),
        ("reference-error", 0.01 * T))}
    asked = [{"form": "allowance", "constant": 5.0, "share": 0.05},
             {"form": "confidence", "name": "near", "k": 2.0, "accept": 0.9, "quantity": names[0]}]
    plain = [{key: value for key, value in asked[1].items() if key != "accept"}]
    parts = tuple(line(label, 10.0 ** (number % 3) * (place + 1.5), kind="value", quantity=f"{name}-{word}")
                  for name, words in ((names[0], ("1", "2")), (names[-1], PHASES)) for place, word in enumerate(words)
                  for number, label in enumerate(labels) if place != 1 or number)
    wide = replace(cell, lines=(*cell.lines, *parts), table={"requirements": asked, "estimators": {}}, kept={
        **kept(labels, (*names, "diversity")), **extras}, curves=curves(labels, (*names, "nees", "nis"), True))
    few = labels[:3]
    rows = cell.rows[cell.rows["estimator"].isin(few)]
    factor = rows["estimator"].map({label: 10.0**place for place, label in enumerate(few)})
    rows = rows.assign(**{name: rows[name] * factor for name in rows.columns if name.startswith(("rmse", "mae"))}, **{
        "half-width:near:m": factor * (1 + rows["run"]), "inside:near:1": 1 - 0.001 * factor,
        "begin:outage:s": rows["run"] % 4 * 10.0 + 5, "rmse:position-outage-end:m": (1 + rows["run"]) * factor})
    lines = tuple({**one, "value": 1 / one["value"]} if one["kind"] == "error" else one for one in cell.lines)
    some = replace(cell, lines=lines, rows=rows, kept=kept(few[1:], names), curves=curves(few, (*names, "nis"), False),
                   width=400.0, table={"requirements": plain, "estimators": {}}, only=names[-1:])
    none = replace(cell, kept={("", "received"): Kept(T, 0 * T, T, T)}, curves={}, table={"estimators": {}})
    return [wide, some, none, replace(wide, rows=cell.rows[cell.rows["estimator"].isin(labels[:CROWD])])]


def test_figures_of_unusual_cells(results: Results, expected: Expected) -> None:
    """Each once of a kind of cell, and once more where there are many estimators; not those of the rows alone."""
    out = dict[tuple[str, int, bool], str]()
    for cells in results.scenarios.values():
        for number, cell in enumerate(unusual(cells[0])):
            for one in FIGURES:
                key = one.name, number, len(cells[0].ran) > CROWD
                if number == 3 and not key[2]:
                    continue
                if one.draw and key not in out and one.name not in ("track", "gap", *OF_ROWS[:0 if number == 1 else 9]):
                    canvas = one.draw(cell)
                    out |= {key: f"{one.name} {cell.key} {number}\n{figure(canvas.svg())}"} if canvas else {}
    expected("figures-unusual", "\n".join(out.values()))


def test_figures_of_two_trains(results: Results, expected: Expected) -> None:
    """Under moving and fixed block; the encoder alone beside a filter; a run that ends early; no filter at all."""
    tables = [found.table for found in make_plan(["moving-block/law-p", "moving-block/law-p-fixed-block"]).cells]
    cell = results.scenarios["ningbo-metro"][0]
    ended = np.where(T < 70, 1.0, np.nan)
    laps = {f"{kind}{axis}-{train}": ended * (1 + 0.02 * (kind != "")) * way(T / 9 - (train == "b"))
            for kind in ("", "estimate-") for axis, way in (("x", np.cos), ("y", np.sin)) for train in "ab"}
    tracks = {**laps, "s-a": ended * (2 + RISE / 9), "s-b": ended * (1 + RISE / 9), "gap": ended * (0.5 + RISE / 99),
              "kept-distance": 0.4 + T / 99}
    out = []
    for labels, table in ((("dead-reckoning", "robust", "ekf"), tables[0]), (("robust", "dead-reckoning"), tables[1]),
                          (("ckf", "robust"), tables[1]), (("robust",), tables[1])):
        rows = cell.rows[cell.rows["run"] < len(labels)].assign(estimator=lambda found, labels=labels: [
            labels[run] for run in found["run"]])
        one = replace(cell, rows=rows, table=table, styles=assign_styles([labels]),
                      kept={(label, name): Kept(T, (1 + place) * values, values, values)
                            for place, label in enumerate(labels) for name, values in tracks.items()
                            if label != "robust" or "estimate" not in name})
        out.append(one)
    drawn = [found for one in FIGURES if "moving-block" in one.kinds for found in (
        map(one.draw, out) if one.draw else [one.draw_all(cells) for cells in (out, out[2:])] if one.draw_all else [])]
    expected("figures-trains", "\n".join(figure(canvas.svg()) if canvas else "none" for canvas in drawn))
    track = next(one.draw for one in FIGURES if one.name == "track")
    for draw, drawn_of in ((track, out[0]), (FIGURES[0].draw, cell)):  # a legend is as high as its lines at any width
        for width in range(150, 400, 12):
            canvas = draw and draw(replace(drawn_of, width=float(width)))
            assert canvas
            lowest = max(map(float, re.findall(r'<text [^>]*y="([\d.]+)"', canvas.svg()))) / 10
            assert canvas.height - lowest == pytest.approx(6.0, abs=0.06)


def test_which_settings_have_a_figure_of_their_own(results: Results, monkeypatch: pytest.MonkeyPatch) -> None:
    """The others have none of it, whatever their runs kept; a figure of a whole scenario stands for no variant."""
    canvas, cells = object(), results.scenarios["ningbo-metro"]
    kinds = {"speed-profile": "metro", "sections": "metro", "recorded-trip": "recorded", "outages": "recorded",
             "parameter": "braking", "receptions": "coupled-cars", "headway": "coupled-cars", "trace": "linear",
             "track": "moving-block", "trains": "moving-block", "gap": "moving-block"}
    for one in FIGURES:
        draws = {name: lambda _: canvas for name in ("draw", "draw_all") if getattr(one, name)}
        assert len(draws) == 1
        for kind in ("metro", "recorded", "braking", "coupled-cars", "linear", "moving-block", "odometry"):
            of_kind = [replace(cell, about={**cell.about, "kind": kind}) for cell in cells[:2]]
            found = list(of_scenario(replace(one, **draws), of_kind))  # type: ignore[arg-type]
            names = ["switching", "white"] if one.draw else [""]
            assert found == ([(name, canvas) for name in names] if kinds.get(one.name, kind) == kind else []), one.name
            assert not list(of_scenario(replace(one, **{name: lambda _: None for name in draws}), of_kind))
    some = tuple(Figure(name, "", "", lambda _: canvas) for name in ("a", "b"))  # type: ignore[arg-type,return-value]
    monkeypatch.setattr(catalogue, "FIGURES", some)
    assert [figure.name for figure, *_ in catalogue.drawn(results)] == ["a"] * 6 + ["b"] * 6
    assert {figure.name for figure, *_ in catalogue.drawn(results, "b")} == {"b"}


def test_what_there_is_nothing_to_draw_of(results: Results) -> None:
    """No time at which a sum counts, no claim known, no kept run; a drawing of the page is empty likewise."""
    cell = results.scenarios["ningbo-metro"][0]
    label, ranking = cell.ran[0], cell.rankings[0]
    none = replace(cell, curves={}, kept={})
    sums = {name: Curve(T, values, values, values, values) for name, values in (
        ("lost", 0 * T), ("unknown", np.where(T > 0, np.nan, T)), ("exact", np.ones(300)))}
    for name in ("lost", "unknown"):
        dead = replace(sums[name], active=np.ones(300) if name == "unknown" else 0 * T)
        one = replace(none, curves={(label, "nis"): dead, (label, ranking.quantity): dead})
        assert trust.nis_over_time(one) is None and plots.curves(one, ranking) == ("", 0)
    exact = replace(sums["exact"], squared=0 * T)
    assert plots.curves(replace(none, curves={(label, ranking.quantity): exact}), ranking) == ("", 0)
    assert plots.curves(none, ranking) == ("", 0)
    assert moving_block.trains_over_time([none]) is None and moving_block.gap_over_time(none) is None
    asked = {"name": "near", "form": "confidence"}
    rows = cell.rows.assign(**{"half-width:near:m": 1.0, "inside:near:1": np.nan})
    assert requirements.width_against_misses(replace(none, rows=rows, table={"requirements": [asked]})) is None
    assert requirements.width_against_misses(replace(none, rows=rows.assign(**{"inside:near:1": 0.9}), table={
        "requirements": [asked]})) is not None
    rows = results.rows[results.rows["scenario"] != "braking-rate"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(data.Store, "rows", lambda store: rows)
        patch.setattr(data, "verdicts_of", lambda store: results.verdicts)
        with pytest.raises(InputError) as caught:
            data.load_results(results.folder)
    assert str(caught.value) == (f"{results.folder}: verdicts.parquet tells of braking-rate/paper, and no rows are "
                                 "there; remove it")


def test_sections_lie_evenly_however_many_there_are() -> None:
    lines = [{"metric": "rmse", "quantity": f"speed-{place}", "unit": "m/s", "shown_unit": "m/s", "factor": 1.0,
              "estimator": "a", "value": 2.0} for place in range(1, 31)]
    style = Style("ink")
    cell: Any = SimpleNamespace(of=lambda *_: lines, about={"quantities": ["speed"]}, ran=["a"], width=430.0, key="s/v",
                                styled=lambda labels: [(label, style) for label in labels], styles={"a": style})
    drawn = sections.errors_by_section(cell)
    assert drawn and re.findall(r">([^<]+)</text>", drawn.svg())[6:-2] == [str(place) for place in range(2, 31, 2)]
    [line] = re.findall(r'stroke-width="10" d="M435 186l([^"]*)"', drawn.svg())
    assert len(steps := line.split(" ")) == 58 and {*steps[::2]} == {"128", "129"} and {*steps[1::2]} == {"0"}
