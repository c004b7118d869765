"""The verdict table as people read it: by cells, their quantities ranked, each line in the order of the page.

Nothing is judged here, and no number is made: lines of the verdict table are found and put in order."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import pandas as pd

from .marks import Line, drawn
from .wording import metric_name

APART = ("lost", "oracle", "")
OUTCOMES = ("value", "share")
CLAIMED = ("nees", "coverage", "half-width", "bound", "mean-square")
"""Metrics of claims, which tables show as claims."""


def records(table: pd.DataFrame, *kinds: str) -> list[dict[str, Any]]:
    """Lines of a verdict table, of some kinds, as mappings."""
    return table[table["kind"].isin(kinds)].to_dict("records") if kinds else table.to_dict("records")  # pyright: ignore


@dataclass(frozen=True)
class Ranking:
    """One error of a cell: its lines as they are shown: by the ratio to the best, who lost runs after every one that
    finished, oracles last. Smoothers, which are ranked among themselves, after the filters."""

    lines: tuple[Line, ...]
    first: str

    @classmethod
    def of(cls, lines: Sequence[Line], smoothers: Collection[str] = ()) -> Ranking:
        best = next((line["estimator"] for line in sorted(lines, key=lambda line: line["estimator"] in smoothers)
                     if line["verdict"] == "best"), "")
        places = {id(line): place for place, line in enumerate(lines)}

        def order(line: Line) -> tuple[Any, ...]:
            word = drawn(line)
            apart = APART.index(word) + 1 if word in APART else 0
            ratio = line["ratio"] if line["ratio"] == line["ratio"] else float("inf")
            value = line["value"] if line["value"] == line["value"] else float("inf")
            return apart, line["against"] not in (best, ""), ratio if not apart else value, word != "best", value, \
                places[id(line)]

        return cls(tuple(sorted(lines, key=order)), best)

    @property
    def metric(self) -> str:
        return str(self.lines[0]["metric"])

    @property
    def quantity(self) -> str:
        return str(self.lines[0]["quantity"])

    @property
    def unit(self) -> str:
        return str(self.lines[0]["shown_unit"])

    @property
    def name(self) -> str:
        """`RMSE position`."""
        return f"{metric_name(self.metric)} {self.quantity}"

    @cached_property
    def best(self) -> Line | None:
        return self.line(self.first)

    @cached_property
    def smoothed(self) -> Line | None:
        """The best of the smoothers, where there are any beside filters."""
        return next((line for line in self.lines if line["verdict"] == "best" and line is not self.best), None)

    @cached_property
    def ranked(self) -> list[Line]:
        """Lines of the family of the best, and who lost runs."""
        return [line for line in self.lines if drawn(line) not in ("oracle", "") and self.best is not None
                and line["against"] in (self.best["estimator"], "")]

    def drawn(self, word: str) -> list[Line]:
        """Ranked lines of one verdict, in order."""
        return [line for line in self.ranked if drawn(line) == word]

    def line(self, label: str) -> Line | None:
        return next((line for line in self.lines if line["estimator"] == label), None)


@dataclass(frozen=True)
class Cell:
    """One scenario variant of a verdict table. about: what the manifest tells of the scenario; entries: its estimators'
    entries; families: by label; timing: by label. The file's order is that of the rows."""

    scenario: str
    variant: str
    lines: tuple[Line, ...]
    about: Mapping[str, Any]
    entries: Mapping[str, Mapping[str, Any]]
    origin: Mapping[str, str]
    families: Mapping[str, str]
    smoothers: frozenset[str]
    timing: Mapping[str, Mapping[str, float]]

    @property
    def key(self) -> str:
        return f"{self.scenario}/{self.variant}"

    @property
    def title(self) -> str:
        return str(self.about["variants"][self.variant]["title"])

    @cached_property
    def _by_kind(self) -> dict[str, list[Line]]:
        found: dict[str, list[Line]] = {}
        for line in self.lines:
            found.setdefault(str(line["kind"]), []).append(line)
        return found

    def of(self, kind: str, metric: str = "", quantity: str = "") -> list[Line]:
        """Lines of a kind, a metric, a quantity (empty: any)."""
        return [line for line in self._by_kind.get(kind, ()) if metric in ("", line["metric"])
                and quantity in ("", line["quantity"])]

    @cached_property
    def rankings(self) -> list[Ranking]:
        """A ranking for each judged error that has a value at all."""
        groups: dict[tuple[str, str], list[Line]] = {}
        for line in self.of("error"):
            groups.setdefault((line["metric"], line["quantity"]), []).append(line)
        return [Ranking.of(lines, self.smoothers) for lines in groups.values()]

    @cached_property
    def labels(self) -> list[str]:
        """Entries in the order of the first ranking; of the rows where nothing is ranked."""
        lines = self.rankings[0].lines if self.rankings else self.of("reliability", "lost")
        return list(dict.fromkeys(str(line["estimator"]) for line in lines))

    @cached_property
    def runs(self) -> int:
        return max((int(line["runs"]) for line in self.of("reliability", "lost")), default=0)

    def lost(self, label: str) -> int:
        return next((int(line["lost"]) for line in self.of("reliability", "lost") if line["estimator"] == label), 0)

    def claim(self, label: str) -> Line | None:
        """What an entry claims, the first there is: a covariance, its innovations', a set, a bound."""
        for kind, metric in (("consistency", "nees"), ("consistency", "nis"), ("claim", "coverage"),
                             ("claim", "bound")):
            for line in self.of(kind, metric):
                if line["estimator"] == label and line["runs"]:
                    return line
        return None

    @cached_property
    def requirements(self) -> dict[str, list[Line]]:
        """Requirement -> its lines."""
        found: dict[str, list[Line]] = {}
        for line in self.of("requirement"):
            found.setdefault(str(line["quantity"]), []).append(line)
        return found

    @cached_property
    def outcomes(self) -> list[list[Line]]:
        """Of the scenario's table, what is neither a judged error nor a claim: the lines of each."""
        judged = {(ranking.metric, ranking.quantity) for ranking in self.rankings}
        found = []
        for pair in map(tuple, self.about["table"]):
            lines = [line for kind in OUTCOMES for line in self.of(kind, *pair) if line["runs"]]
            if lines and pair not in judged and pair[0] not in CLAIMED:
                found.append(lines)
        return found

    def tuned(self, label: str) -> bool:
        """Whether an entry's numbers were searched on training runs of this variant, as the scenario file says."""
        record = self.entries.get(label, {}).get("tuned")
        said = self.origin.get(f"estimators.{label}", "").startswith("tuned")
        return record["variant"] == self.variant if record else said

    def told(self, label: str) -> str:
        """What an entry is told or set differently: `sigma_w = 0.3`, `tuned: ..`."""
        entry = self.entries.get(label, {})
        plugin = "" if entry.get("plugin", label) == label else entry["plugin"]
        changes = [f"{key} = {_short(value)}" for part in ("parameters", "knowledge")
                   for key, value in entry.get(part, {}).items()]
        changes += [f"+ {name}" for name in entry.get("augment", {})]
        words = ", ".join(filter(None, [plugin, *changes]))
        return f"tuned: {words}" if self.tuned(label) else words


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.3g}"
    text = str(value)
    return text if len(text) <= 24 else f"{text[:22]}.."


def cells_of(table: pd.DataFrame, manifest: Mapping[str, Any], timing: pd.DataFrame | None = None) -> Iterator[Cell]:
    """The cells of a verdict table, scenario by scenario, each in the order of the scenario's file."""
    times: dict[tuple[str, str], dict[str, dict[str, float]]] = {}
    for line in [] if timing is None else timing.to_dict("records"):
        scenario, variant, label = (str(line.pop(name)) for name in ("scenario", "variant", "estimator"))
        times.setdefault((scenario, variant), {})[label] = {str(name): float(value) for name, value in line.items()}
    groups = {(str(a), str(b)): part for (a, b), part in table.groupby(["scenario", "variant"], sort=False)}
    for scenario in dict.fromkeys(scenario for scenario, _ in groups):
        about = manifest["scenarios"][scenario]
        for variant in [name for name in about["variants"] if (scenario, name) in groups]:
            saved = manifest["replay"]["cells"][f"{scenario}/{variant}"]
            plugins = {label: entry["plugin"] for label, entry in saved["entries"].items()}
            yield Cell(scenario, variant, tuple(records(groups[scenario, variant])), about, saved["entries"],
                       saved["table"].get("origin", {}),
                       {label: manifest["estimators"][plugin].get("family") or "Other" for label, plugin
                        in plugins.items() if plugin in manifest["estimators"]},
                       frozenset(label for label, plugin in plugins.items()
                                 if manifest["estimators"].get(plugin, {}).get("smoother")),
                       times.get((scenario, variant), {}))
