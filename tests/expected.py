"""What the tool prints, draws and computes, whole, as committed text in `tests/expected/`.

A change that is meant to change it: `pytest --rewrite tests/benchmarks/test_expected.py`, then read the difference."""

from __future__ import annotations

import difflib
import math
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

FOLDER = Path(__file__).parent / "expected"
NUMBER = re.compile(r"-?\d+\.\d{5,}(?:e[+-]\d+)?|-?\d\.\d+e[+-]\d+")
"""A number of so many digits that machines may differ in the last of them: compared to 1e-5 of its size, since a loop
that is closed makes much of a rounding."""
PLACE = re.compile(rf"{NUMBER.pattern}|\d{{4,}}")
"""In figures also whole numbers of four digits and more, which may differ by 2: places in tenths of a point, sums."""


def alike(old: str, new: str, number: re.Pattern[str] = NUMBER) -> bool:
    """Whether two lines say the same: words and short numbers to the letter, long numbers nearly."""
    return number.sub("#", old) == number.sub("#", new) and all(
        math.isclose(float(a), float(b), rel_tol=1e-5, abs_tol=2 if a.isdigit() else 1e-12)
        for a, b in zip(number.findall(old), number.findall(new), strict=True))


def compare(name: str, text: str, rewrite: object) -> None:
    """Assert that the text is what `expected/name.txt` holds, or write it there; NAME:PART is a part of that file, for
    tests of many cases (written by `pytest -n 0 --rewrite`)."""
    name, _, part = name.partition(":")
    path = FOLDER / f"{name}.txt"
    new = [line.rstrip() for line in text.splitlines()]
    whole = path.read_text(encoding="utf-8") if path.exists() else ""
    parts = dict(found.partition("\n")[::2] for found in whole.split("\n=== ")[1:]) if part else {"": whole}
    old = parts.get(part, "").splitlines()
    number = PLACE if name.startswith("figures") else NUMBER
    if len(old) == len(new) and all(alike(*pair, number) for pair in zip(old, new, strict=True)):
        return
    if rewrite:
        parts[part] = "\n".join(new) + "\n"
        path.write_text("".join(f"\n=== {key}\n{parts[key]}" for key in sorted(parts)) if part else parts[""], "utf-8")
        return
    shown = list(difflib.unified_diff(old, new, f"expected/{name}.txt {part}", "now", lineterm="", n=0))
    raise AssertionError("\n".join([*shown[:40], "meant to change: pytest --rewrite, see tests/expected.py"]))


def digest(value: Any) -> str:
    """Shape, sum, sum of squares and a sum that tells the order, of what there is."""
    if isinstance(value, tuple) and any(item is None or np.shape(item) != np.shape(value[0]) for item in value):
        return " ".join("-" if item is None else digest(item) for item in value)
    array = np.nan_to_num(np.asarray(value, dtype=float), nan=-7.0, posinf=1e9, neginf=-1e9)
    ordered = array.reshape(-1) @ np.sqrt(np.arange(1.0, array.size + 1))
    return f"{array.shape} {array.sum():.8e} {(array**2).sum():.8e} {ordered:.8e}"


def figure(svg: str) -> str:
    """An SVG element: a line each text (place, style, words), and of all paths of one style how many, how many points,
    their box and their sum, or what they are where they are few letters."""
    root = ElementTree.fromstring(svg)
    lines, paths = list[str](), dict[str, list[Any]]()
    for node in root.iter():
        facts = dict(node.attrib)
        data = facts.pop("d", "")
        said = " ".join([node.tag.rpartition("}")[2], *(facts.values()), (node.text or "").strip(),
                         *(child.text or "" for child in node if node is not root and child.tag.endswith("title"))])
        if re.fullmatch(r"(M[\d -]+l[\d -]+z?)+", data):
            for steps, closed in re.findall(r"(M[\d -]+l[\d -]+)(z?)", data):
                ways = np.array(re.findall(r"-?\d+", steps), int).reshape(-1, 2)
                paths.setdefault(said + " closed" * bool(closed), []).append(np.cumsum(ways, axis=0))
        elif not node.tag.endswith("title") or node.text == root[0].text:
            total = sum(map(int, re.findall(r"-?\d+", data)))
            lines.append(f"{said} {data if len(data) < 60 else f'{len(data)} {total} {data[:24]} .. {data[-24:]}'}")
    for said, each in paths.items():
        points = np.concatenate(each)
        lines.append(f"{said} {len(each)} of {len(points)}: {points.min(0)} {points.max(0)} {points.sum(0)}")
    return "\n".join(lines)


def page(html: str) -> str:
    """A page, a line each element; without styles, scripts and canvases, other drawings as `figure` has them."""
    html = re.sub(r"<(style|script).*?</\1>", "", html, flags=re.DOTALL)
    html = re.sub(r'<svg viewBox="[^"]*" role="img" aria-label.*?</svg>', r"<svg>", html, flags=re.DOTALL)
    html = re.sub(r"<svg .*?</svg>", lambda found: f"\n{figure(found[0])}\n", html, flags=re.DOTALL)
    parts = re.split(r"\n|(?=<(?:tr|p|h\d|table|div|section|li|figure|details|dl|dt)\b)", html)
    return "\n".join(line for part in parts if (line := part.strip()) and not re.fullmatch(r"(</\w+>\s*)+", line))

