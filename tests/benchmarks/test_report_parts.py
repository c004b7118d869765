"""Parts of the page on inputs made by hand: published cells, scales of its drawings, a sweep's files."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from railstate.benchmarks.judging.table import TEXTS, VERDICT_COLUMNS
from railstate.benchmarks.telling.report import plots, published, sweep
from railstate.scenarios.errors import InputError


def reading(name: str, ours: float | None, error: float | None, stands: bool,
            verdict: str = "reproduced") -> dict[str, Any]:
    return {"reading": name, "ours": ours, "standard_error": error, "stands": stands, "verdict": verdict}


def cell(name: str, verdict: str, *entries: dict[str, Any]) -> dict[str, Any]:
    return {"cell": name, "published": 1.5, "unit": "m", "verdict": verdict, "entries": list(entries)}


def test_published_cells_of_a_paper() -> None:
    groups = [
        {"group": "I", "note": "first", "cells": [
            cell("a", "reproduced", reading("x", 1.25, 0.1, True), reading("y", 2.5, None, False, "not reproduced")),
            cell("b", "unreachable", reading("", None, None, True), reading("z", None, 0.1, False))]},
        {"group": "II", "note": "", "cells": [cell("c", "fitted", reading("x", 123456.0, None, True))]},
        {"group": "III", "note": "second", "cells": [cell("d", "fitted", reading("z", 7.0, 1.0, False, ""))]},
        {"group": "IV", "note": "first", "cells": []}]
    document = {"papers": [{"name": "n", "title": "T", "authors": "A", "year": 2020, "reference": "R", "stands": "x",
                            "readings": {"x": "as printed", "z": "mended"}, "groups": groups}]}
    (paper,) = published.papers(document)
    assert paper[:3] == ("n", "A (2020): T. R.", [("reproduced", 1), ("fitted", 2), ("unreachable", 1)])
    assert published.sentence([paper, paper]) == "Of 8 published numbers: 2 reproduced, 4 fitted, 2 unreachable."
    assert published.sentence([]) == ""
    table, heads = paper.table, ("published", "here", "unit", "verdict", "note", "y", "z")
    assert table.heads == [(head, "here|low|high" if head == "here" else head, head not in heads[2:5])
                           for head in heads]
    assert table.notes == ["x: as printed.", "z: mended.", "1: first", "2: second"]
    assert table.caption == ("Here: under the reading that stands for the paper, ± half of the 95 % interval; further "
                             "readings to the right.")
    fitted, none = ('<span class="c outline">~ fitted</span>', "fitted"), ("", "")
    lines = {
        "I: a": (("1.25 ± 0.20", "1.25|1.054|1.446"), ('<span class="c tie">✓ reproduced</span>', "reproduced"), 1,
                 ('<span class="c w2">✗ 2.500</span>', "2.5"), none),
        "I: b": (none, ('<span class="c none">– unreachable</span>', "unreachable"), 1, none, none),
        "II: c": (("1.235·10⁵", "123456||"), fitted, 0, none, none), "III: d": (none, fitted, 2, none, ("7.000", "7"))}
    for (name, entries), (wanted, (here, verdict, note, *others)) in zip(table.lines, lines.items(), strict=True):
        words = (("1.5", "1.5"), here, ("m", ""), verdict, (f"<sup>{note}</sup>" * bool(note), ""), *others)
        assert (name, entries) == (wanted, [(*pair, place not in (2, 3, 4)) for place, pair in enumerate(words)])
    alone = {**document["papers"][0], "groups": groups[3:]}
    assert published.papers({"papers": [alone]})[0].table.caption.endswith("± half of the 95 % interval.")
    with pytest.raises(InputError, match=r"reproduce writes them into published\.json: KeyError: 'groups'$"):
        published.papers({"papers": [{}]})


def test_scales_of_the_page_s_drawings() -> None:
    """Logarithmic from a factor on; what is none, or not above the floor, counts for nothing."""
    for values, floor, wanted in (
            ([], 0.0, (0.0, 1.0, False)), ([math.nan, math.inf, -1.0, 0.0], 0.0, (0.0, 1.0, False)),
            ([1.0, 3.9], 0.0, (1 - 0.06 * 2.9, 3.9 + 0.06 * 2.9, False)),
            ([1.0, 4.0, math.inf], 0.0, (4**-0.04, 4 * 4**0.04, True)), ([2.0, 2.0], 0.0, (1.8, 2.2, False)),
            ([0.1, 2.0], 0.1, (1.8, 2.2, False)), ([0.0, 10.0, 11.0], 0.0, (9.94, 11.06, False))):
        found = plots._scale(values, 4.0, floor)
        assert (found.low, found.high) == pytest.approx(wanted[:2]) and found.log == wanted[2]


def test_a_sweep_s_files(tmp_path: Path) -> None:
    assert not sweep.is_sweep(tmp_path)
    made = sweep.Sweep("s/v", ["p"], [("rmse", "x")], ["a", "b"], 9, 1, {"0.5": {}, "0.9": {"b": "lost"}},
                       "railstate sweep")
    file, table = tmp_path / "sweep.json", tmp_path / "sweep.csv"
    file.write_text(made.written())
    assert made.written() == json.dumps(json.loads(made.written()), indent=1) + "\n" and sweep.is_sweep(tmp_path)
    usual = {**dict.fromkeys(VERDICT_COLUMNS, 1.0), **dict.fromkeys(TEXTS, "t"), "eligible": True, "against": ""}
    rows = pd.DataFrame([{**usual, "p": p, "estimator": label} for p in ("0.5", "0.9") for label in "ab"])
    rows.to_csv(table, index=False)
    found, read = sweep.load(tmp_path)
    assert found == made and read["p"].tolist() == ["0.5", "0.5", "0.9", "0.9"] and (read["against"] == "").all()
    assert made.why(("0.9",), "b") == made.why(("ahead", "0.9"), "b") == "lost" and made.why(("0.5",), "b") == ""
    assert made.points() == [("0.5",), ("0.9",)]

    def refused(said: str, whole: bool = True) -> None:
        with pytest.raises(InputError) as caught:
            sweep.load(tmp_path)
        assert str(caught.value)[:None if whole else len(said)] == said

    rows.drop(columns=["value", "p"]).to_csv(table, index=False)
    refused(f"{table}: not as railstate sweep writes it: has no column value, p")
    rows.assign(kind="requirement", against="many").to_csv(table, index=False)
    refused(f"{table}: not as railstate sweep writes it: Unable to parse string", whole=False)
    table.unlink()
    refused(f"{table}: not as railstate sweep writes it: [Errno 2]", whole=False)
    table.mkdir()
    refused(f"{table}: not as railstate sweep writes it: is no file")
    for change, said in (({"lost": {"0.5 | 1": {}, "0.9": {}}}, "has points of other keys than p"), (
            {"keys": []}, "has points of other keys than"), ({"lost": {}}, "has points of other keys than p"),
            ({"keys": ["p" * 300, "q"]}, f"has points of other keys than {'p' * 270}"), ({"runs": "many"}, (
                "runs: Input should be a valid integer, unable to parse string as an integer (got 'many')"))):
        file.write_text(json.dumps({**json.loads(made.written()), **change}))
        refused(f"{file}: not as railstate sweep writes it: {said}")
