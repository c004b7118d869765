"""The page's overview of verdict lines by hand, whole: each family's entry in each view, tallies, who is left out.

Sign, class, ratio and place in the order of every cell are written down here."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from railstate.benchmarks.telling.rankings import Cell
from railstate.benchmarks.telling.report.matrix import View, anchor, matrix

from .test_worded import ABOUT, cell, line, lost, ratio

FAMILIES = {"a": "K", "b": "K", "c": "R", "d": "S", "e": "S", "t": "R"}


def duel(estimator: str, against: str, **facts: Any) -> dict[str, Any]:
    return line(estimator, 0.01, kind="yardstick", against=against, **facts)


def floored(floor: float, efficiency: float) -> dict[str, Any]:
    return {"floor": floor, "efficiency": efficiency}


LINES = (
    line("a", 0.010, **ratio(1.0, 1.0, 1.0, "best"), **floored(0.008, 0.8)),
    line("b", 0.0101, **ratio(1.01, 0.98, 1.05, "undecided"), **floored(0.008, 0.79)),
    line("c", 0.0102, **ratio(1.02, 1.01, 1.09, "worse"), **floored(0.0, 0.0)),
    line("t", 0.021, **ratio(2.1, 1.8, 2.2, "worse"), **floored(0.008, 1e-12)),
    line("d", 0.015, **ratio(1.5, 1.4, 1.6, "worse"), floor_kind="linear optimum", **floored(0.012, 0.8)),
    line("e", runs=30, lost=10, verdict="lost", eligible=False))
SECOND = (
    line("c", 2.0, quantity="speed", against="c", **ratio(1.0, 1.0, 1.0, "best")),
    line("a", 2.2, quantity="speed", against="c", **ratio(1.1, 1.0, 1.2, "worse")),
    line("e", 0.0, quantity="speed", runs=0, lost=40, verdict="lost", eligible=False, against=""))
DUELS = (duel("b", "a", **ratio(1.01, 0.9, 1.1, "tie")), duel("c", "a", **ratio(0.9, 0.8, 0.95, "better")),
         duel("t", "a", **ratio(2.1, 1.9, 2.2, "worse")), duel("d", "b", **ratio(1.5, 1.4, 1.6, "worse")))


def whole(*lines: dict[str, Any], **facts: Any) -> Cell:
    return replace(cell(*lines, *(lost(label, 10 * (label == "e")) for label in "abctde")), families=FAMILIES, **facts)


def test_every_view_of_a_setting() -> None:
    made = matrix([whole(*LINES, *DUELS)])
    assert (made.families, made.views, made.against) == (["K", "R", "S"], ["first of the setting"], [
        "the best", "the yardstick", "the floor"])
    [row] = made.rows
    assert (row.scenario, row.variant, row.id, row.least) == ("s", "v", "s-v", [("1.00 cm", "a")])
    assert row.cells == {
        "K": [View("best", "★ 1", "a", 1.0, "best"), View("outline", "◇ 1", "a", 1.0, "reference"),
              View("best", "★ 1.25", "a", 1.25, "best")],
        "R": [View("w1", "▲ 1.02", "c", 1.02, "worse"), View("tie", "▼ 0.90", "c", 0.9, "better"), None],
        "S": [View("w2", "▲ 1.50 ✕", "d", 1.5, "worse"), None, View("w2", "▲ 1.25 ✕", "d", 1.25, "worse")]}
    assert made.tallies == {
        "K": [("★= 1", [("best", 100.0)]), ("◇ 1", [("outline", 100.0)]), ("★= 1", [("best", 100.0)])],
        "R": [("▲ 1", [("w2", 100.0)]), ("▼ 1", [("tie", 100.0)]), ("", [])],
        "S": [("▲ 1", [("w2", 100.0)]), ("", []), ("▲ 1", [("w2", 100.0)])]}


def test_tuned_entries_stand_for_their_family_and_who_is_lost_has_no_ratio() -> None:
    """A floor of next to nothing is none; without a yardstick that view is empty."""
    tuned = whole(*LINES[:4], LINES[5], origin={"estimators.t": "tuned: by hand", "estimators.a": "the paper"})
    [row] = matrix([tuned]).rows
    assert row.cells == {
        "K": [View("best", "★ 1", "a", 1.0, "best"), None, View("best", "★ 1.25", "a", 1.25, "best")],
        "R": [View("w3", "▲ 2.10", "t", 2.1, "worse"), None, None],
        "S": [View("lost", "✕ 10 of 40 lost", "e", None, "lost")] * 3}
    above = replace(tuned, lines=tuple({**one, **floored(0.008, 1.1e-12)} if one["estimator"] == "t" else one
                                       for one in tuned.lines))
    assert [view and view.sort for view in matrix([above]).rows[0].cells["R"]] == [2.1, None, 1 / 1.1e-12]


def test_settings_of_one_and_of_two_quantities() -> None:
    """Families by how many settings they are in, of equals in the order of entries; without any floor two views."""
    bare = [{**one, "floor": np.nan, "efficiency": np.nan, "floor_kind": ""} for one in LINES]
    other = replace(whole(*[one for one in bare if one["estimator"] != "d"]), scenario="z", variant="A.b", about={
        **ABOUT, "variants": {"A.b": {"title": "", "notes": []}}})
    gone = whole(line("a", runs=0, lost=40, verdict="lost", eligible=False))
    made = matrix([whole(*bare, *SECOND), other, gone, whole()])
    assert made.views == ["first of the setting", "second"] and made.against == ["the best", "the yardstick"]
    assert made.families == ["K", "R", "S"] and [row.id for row in made.rows] == ["s-v", "z-a-b", "s-v"]
    assert [row.least for row in made.rows] == [[("1.00 cm", "a"), ("200 cm", "c")], [("1.00 cm", "a")] * 2,
                                                [("", "")] * 2]
    first, second, third = (row.cells for row in made.rows)
    assert [[view and view.text for view in first[name]] for name in "KRS"] == [
        ["★ 1", "▲ 1.10", None, None], ["▲ 1.02", "★ 1", None, None],
        ["▲ 1.50 ✕", "✕ 40 of 40 lost", None, "✕ 40 of 40 lost"]]
    assert [[view and view.text for view in second[name]] for name in "KRS"] == [
        ["★ 1", None, None, None], ["▲ 1.02", None, None, None], ["✕ 10 of 40 lost", None, "✕ 10 of 40 lost", None]]
    assert [third[name] for name in "KRS"] == [[None] * 4] * 3
    assert made.tallies["K"] == [("★= 2", [("best", 100.0)]), ("▲ 1", [("w2", 100.0)]), ("", []), ("", [])]
    assert matrix([whole(*bare), other]).views == ["first of the setting"]
    assert anchor("a.B", "c/1") == "a-b-c-1" and matrix([]) == ([], [], {}, ["first of the setting"], [
        "the best", "the yardstick"])
