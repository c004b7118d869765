"""One table over settings, of verdict lines made by hand: decimals, means, short names, captions, how it is split."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np
import pytest
from railstate.benchmarks.telling import over_settings
from railstate.benchmarks.telling.over_settings import Block, Grid, caption, grid, means, to_csv, to_md, to_tex
from railstate.benchmarks.telling.rankings import Cell, Ranking

from .test_worded import ABOUT, line, lost, ratio

WORDS = {1.0: "best", 1.005: "tie", 1.02: "undecided", 2.0: "worse", 4.5: "worse"}


def errors(quantity: str, *given: tuple[str, float], size: float = 0.01) -> list[dict[str, Any]]:
    """Lines of one error, each with its ratio to the least, `size` m."""
    return [line(label, size * value, 0.001 * size, quantity=quantity, **ratio(value, value, value, WORDS[value]))
            for label, value in given]


def cell(variant: str, *lines: dict[str, Any], scenario: str = "s", runs: int = 40, **facts: Any) -> Cell:
    labels = dict.fromkeys(one["estimator"] for one in lines)
    about = {**ABOUT, "title": f"About {scenario}", "variants": {variant: {"title": variant, "notes": []}}}
    entries = {label: {"plugin": label.partition("-")[0]} for label in labels}
    return Cell(scenario, variant, (*lines, *({**lost(label), "runs": runs} for label in labels)), about, entries, {},
                facts.pop("families", {}), facts.pop("smoothers", frozenset()), {})


@pytest.mark.parametrize(("least", "places", "value", "text"), [
    ([0.01], 2, 0.01234, "1.23"), ([0.001], 3, 0.00123, "0.123"), ([10.0], 0, 12.34, "1234"), ([0.1], 1, 1.0, "100.0"),
    ([0.0099], 3, 0.01, "1.000"), ([1e-14], 9, 1e-13, "1.0e-11"), ([1e-14], 9, 0.0, "0.000000000"),
    ([0.01, 0.1, 10.0], 1, 1e-4, "1.0e-02"), ([0.0], 3, 0.02, "2.000"), ([], 3, 4e-6, "4.0e-04")])
def test_decimals_of_a_block(least: list[float], places: int, value: float, text: str) -> None:
    """Three figures of the middle one of the least errors; of a value that would show none, two."""
    rankings = {str(place): Ranking.of([line("a", one, **ratio(1.0, 1.0, 1.0, "best")), line(
        "b", 9.0, **ratio(9.0, 9.0, 9.0, "worse"))]) for place, one in enumerate(least)}
    none = Ranking.of([line("a", runs=0, lost=40, verdict="lost", eligible=False)])
    block = Block("rmse", "position", "cm", {**rankings, "none": none})
    assert (block.places, block.value(line("a", value))) == (places, text)
    assert block.name == "RMSE of position, cm" and replace(block, unit="").name == "RMSE of position"


def test_means_of_ratios() -> None:
    """Geometric, over all settings; none where one is missing, lost, an oracle's or endless."""
    first = Ranking.of(errors("x", ("a", 1.0), ("b", 2.0), ("c", 1.02), ("d", 2.0), ("e", 1.005)))
    second = Ranking.of([*errors("x", ("a", 1.0), ("b", 4.5), ("d", 2.0)), line("c", 0.01, verdict="oracle", ratio=0.5),
                         line("e", 0.5, runs=20, lost=20, verdict="worse", ratio=3.0, eligible=False)])
    block = Block("rmse", "x", "cm", {"s/v": first, "s/w": second})
    assert means(block, ["a", "b", "c", "d", "e", "z"]) == ["1.00", "3.00", "–", "2.00", "–", "–"]
    endless = Ranking.of([*errors("x", ("a", 1.0)), line("b", 0.1, verdict="worse", ratio=np.inf)])
    assert means(Block("rmse", "x", "", {"s/v": endless}), ["a", "b"]) == ["1.00", "–"]


def table(*cells: Cell, **chosen: Any) -> Grid:
    return grid(cells, **chosen)


def test_captions_say_what_appears_alone() -> None:
    plain = table(cell("v", *errors("x", ("a", 1.0))))
    ends = " Half of the 95 % interval of a value is at most 0.100 % of it."
    assert " ".join(caption(plain)) == ("RMSE over 40 paired runs. About s. Bold: least error of all 4 entries of a "
                                        f"setting.{ends}")
    assert over_settings.shown_words(plain) == {"best"} and plain.labels == ["a"] and plain.name("s/v") == "v"
    lines = [*errors("x", ("a", 1.0), ("b", 1.005), ("c", 1.02), ("d", 2.0)), line(
        "o", 0.001, verdict="oracle", quantity="x"), line("l", 0.03, 0.009, quantity="x", runs=30,
                                                          lost=10, verdict="lost", eligible=False)]
    full = table(cell("v", *lines, smoothers=frozenset("c")), cell("w", *(
        {**one, "family": 7} for one in errors("x", ("a", 1.0), ("d", 4.5))), scenario="z", runs=99))
    assert " ".join(caption(full)) == (
        "RMSE over 40 or 99 paired runs. 2 settings. Bold: least error of all 4 to 7 entries of a setting and entries "
        "that tie with it (=, 95 % interval of the ratio within ±1 %). ?: undecided at so many runs. All others are "
        "worse (95 %, simultaneous over all pairs). Italic: runs that finished of those run; lost more than equals "
        "would. In brackets: told what the others estimate, not ranked. Smoothers are ranked among themselves. Half of "
        "the 95 % interval of a value is at most 30 % of it. Ratio to best: geometric mean over the settings.")
    assert [full.name(cell.key) for cell in full.cells] == ["s/v", "z/w"]
    assert to_md(full, "").splitlines()[2:7] == [
        "| RMSE of x, cm | a | b | c | d | o | l |", "| --- | ---: | ---: | ---: | ---: | ---: | ---: |",
        "| s/v | **1.00** | **1.00** = | 1.02 ? | 2.00 | (0.10) | *30/40* |",
        "| z/w | **1.00** | – | – | 4.50 | – | – |",
        "| *ratio to best* | 1.00 | – | – | 3.00 | – | – |"]
    assert to_csv(full, "").splitlines()[:3] == [
        "scenario,variant,metric,quantity,unit,entry,runs,lost,verdict,value,low,high,ratio,ratio_low,ratio_high",
        "s,v,rmse,x,cm,a,40,0,best,1,0.999,1.001,1,1,1", "s,v,rmse,x,cm,b,40,0,tie,1.005,1.004,1.006,1.005,1.005,1.005"]
    assert to_csv(full, "").splitlines()[5] == "s,v,rmse,x,cm,o,40,0,oracle,0.1,0.1,0.1,,,"


def heads(text: str) -> list[list[str]]:
    """The entries of each table of a LaTeX text."""
    return [found.split(" & ") for found in re.findall(r"(?m)^setting & (.*) \\\\$", text)]


def test_short_names_under_their_family_s_heading() -> None:
    """Without the plug-in's name, or what all of the family begin with; whole where two would be the same."""
    labels = ["ekf", "ekf-naive", "ukf-naive", "robust-wide", "robust-near", "robust-far", "kf-a", "kf-b", "one-x"]
    families = {**dict.fromkeys(labels[:3], "K"), **dict.fromkeys(labels[3:6], "R"), "kf-a": "S", "kf-b": "S",
                "one-x": "O"}
    made = cell("v", *errors("x", *((label, 1.0 if label == "ekf" else 2.0) for label in labels)), families=families)
    made = replace(made, entries={label: {"plugin": {"kf-a": "other", "kf-b": "kf", "one-x": "two"}.get(
        label, label.partition("-")[0])} for label in labels})
    assert [*chain(*heads(to_tex(table(made), "t")))] == ["ekf", "ekf-naive", "ukf-naive", "wide", "near", "far", "a",
                                                          "b", "one-x"]
    text = to_tex(table(made, estimators=("ekf-naive", "ekf", "kf-a", "one-x")), "t")
    assert heads(text) == [["naive", "ekf", "kf-a", "one-x"]]
    assert r"\multicolumn{2}{c}{K} & \multicolumn{1}{c}{S} & \multicolumn{1}{c}{O} \\ " in text
    assert r"\cmidrule(lr){2-3}\cmidrule(lr){4-4}\cmidrule(l){5-5}" in text
    assert r"\label{tab:t}" in text and "Part" not in text and r"\begin{tabular}{@{}l*{4}{r}@{\quad}}" in text


@pytest.mark.parametrize(("sizes", "pages"), [
    ((16, 17), [2]), ((16, 18), [1, 1]), ((35,), [1]), ((36,), [1]), ((10, 10, 11), [3]), ((10, 10, 12), [2, 1]),
    ((40, 1, 34), [1, 1, 1]), ((40, 1, 32), [1, 2])])
def test_how_many_quantities_stand_on_a_page(sizes: tuple[int, ...], pages: list[int]) -> None:
    """37 lines, two of them a quantity's own; a quantity is never divided."""
    cells = [cell(f"v{place}", *(one for number, size in enumerate(sizes) if place < size
                                 for one in errors(f"q{number}", ("a", 1.0), ("b", 2.0)))) for place in range(
                                     max(sizes))]
    text = to_tex(table(*cells), "t")
    parts = text.split(r"\begin{table}")[1:]
    assert [part.count(r"\emph{") for part in parts] == pages
    labels = re.findall(r"\\label\{tab:(.*?)\}", text)
    assert labels == ["t", *(f"t-{place + 2}" for place in range(len(pages) - 1))]
    said = [f"Part {place + 1} of {len(pages)}." if len(pages) > 1 else "over the settings." if max(sizes) > 1 else ""
            for place in range(len(pages))]
    assert all(words in part for words, part in zip(said, parts, strict=True))
    assert [part.count(r"\midrule") for part in parts] == pages


@pytest.mark.parametrize("width", [4, 9, 15])
def test_how_many_entries_stand_beside_each_other(width: int) -> None:
    """As many as 322 points hold, of 4.9 a letter and 12 between two; then in equal parts. Families alone count."""
    for count in (1, 2, 5, 6, 7, 8, 12, 13, 14, 15, 16, 39):
        labels = [f"{chr(97 + n // 26)}{chr(97 + n % 26)}".ljust(width, "x") for n in range(count)]
        made = cell("v", *errors("x", *((label, 2.0 if place else 1.0) for place, label in enumerate(labels))),
                    families=dict.fromkeys(labels, "F"))
        room, used, parts = 322.0 - 4.9 * len("ratio to best"), 0.0, 1
        for place in range(count):
            need = 4.9 * max(width, len("Family alone") if count == 1 else 4) + 12
            used, parts = (need, parts + 1) if place and used + need > room else (used + need, parts)
        found = heads(to_tex(table(made), "t"))
        assert [len(one) for one in found] == [len(one) for one in np.array_split(np.arange(count), parts)]
        assert [*chain(*found)] == labels
