"""The verdict table: everything that is said of a results folder, computed once from its rows.

Files, terminal, report, `compare` and figures render it; nothing else judges."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from ...scenarios.arrays import Array, Mask
from ..scoring.columns import metric_columns, shown_unit
from ..store.folder import Store
from . import claims
from . import statistics as st
from .family import Draws, compare_all, eligible
from .floors import floor_lines, floored
from .judged import Judged, Line, notes
from .selection import ERRORS, FLOORS, NEGLIGIBLE, Aligned, Column, apart, cells, grounds, judged_columns, yardsticks

VERDICT_COLUMNS = (
    "scenario", "variant", "kind", "metric", "quantity", "unit", "shown_unit", "factor", "estimator", "value", "low",
    "high", "standard_error", "runs", "lost", "against", "ratio", "ratio_low", "ratio_high", "won", "verdict",
    "eligible", "family", "deciding", "median", "inside", "floor", "efficiency", "floor_kind", "note")
"""Columns of verdicts.parquet and verdicts.csv; the README says what each holds."""
TEXTS = ("scenario", "variant", "kind", "metric", "quantity", "unit", "shown_unit", "estimator", "against", "verdict",
         "floor_kind", "note")
STATUSES = ("diverged", "failed", "crashed", "timeout", "infeasible")


def verdicts(rows: pd.DataFrame, manifest: Mapping[str, Any]) -> pd.DataFrame:
    """The verdict table of a folder's rows, columns `VERDICT_COLUMNS`, in the order of the rows."""
    lines: list[Line] = []
    for scenario, variant, part in cells(rows):
        about = manifest["scenarios"][scenario]
        cell = Cell(f"{scenario}/{variant}", Aligned(part), about, apart(manifest, scenario, variant),
                    grounds(manifest, scenario, variant))
        lines += cell.lines(judged_columns(part, about), yardsticks(manifest, scenario))
    return framed(lines)


def verdicts_of(store: Store) -> pd.DataFrame:
    """The verdict table of a folder: as it was written with its rows, or made now where it is not up to date."""
    table, numbers = store.verdicts(), [name for name in VERDICT_COLUMNS if name not in TEXTS]
    sound = (table is not None and tuple(table) == VERDICT_COLUMNS
             and bool((table[numbers].dtypes == framed([])[numbers].dtypes).all()))
    return table if sound and table is not None else verdicts(store.rows(), store.manifest())


def framed(lines: Sequence[Line]) -> pd.DataFrame:
    """Lines as a table of `VERDICT_COLUMNS`; numbers that a line lacks are NaN, texts empty."""
    table = pd.DataFrame(list(lines), columns=list(VERDICT_COLUMNS))
    table[list(TEXTS)] = table[list(TEXTS)].astype(object).fillna("").astype(str)
    table["eligible"] = table["eligible"].ne(False)  # missing: nothing speaks against it
    for name in ("runs", "lost", "family"):
        table[name] = table[name].fillna(0).astype(int)
    numbers = [name for name in VERDICT_COLUMNS if name not in (*TEXTS, "eligible", "runs", "lost", "family")]
    table[numbers] = table[numbers].astype(float)
    return table


class Cell:
    """One variant of one scenario, judged. key: `scenario/variant`, by which (and the runs) resampling is seeded.
    apart, grounds: as those of `selection` tell."""

    def __init__(self, key: str, aligned: Aligned, about: Mapping[str, Any], apart: Mapping[str, str],
                 grounds: Mapping[str, str]) -> None:
        self.key, self.aligned, self.about, self.apart, self.grounds = key, aligned, about, apart, grounds
        self.scenario, self.variant = key.split("/")[:2]
        self.draws = Draws(key, aligned.runs, about["variants"].get(self.variant, {}).get("level", st.ALPHA))
        self.labels, self.n = aligned.labels, aligned.runs
        self.lost = aligned.lost

    def lines(self, judged: Sequence[Column], references: Sequence[str]) -> Iterator[Line]:
        """All that is said of the cell."""
        for column in judged:
            yield from self._errors(column, references)
        yield from self._values([c for c in metric_columns(self.aligned.part)
                                 if c not in judged and c[1] not in FLOORS])
        for column, label, facts in floor_lines(self.aligned):
            yield self._line("value", column, label, **facts)
        yield from self._claims()
        yield from self._requirements()
        yield from self._reliability()

    def duels(self, judged: Sequence[Column], a: str, b: str) -> Iterator[tuple[Line, Line]]:
        """(a's line, b's line) of each error, and of the runs lost where they differ: b against a, a family of two."""
        i, j = self.labels.index(b), self.labels.index(a)
        for column in judged:
            values, power, found = averaged(self.aligned.values(column[0]), column[1])
            if np.isfinite(values[[i, j]]).any(axis=1).all():
                yield (self._line("error", column, a, **_shown(found, j), verdict="reference"),
                       self._line("error", column, b, **_shown(found, i), against=a,
                                  **self._judged(values, [i, j], power).facts(i, j)))
        if (self.lost[i] != self.lost[j]).any():
            fine = eligible(self.lost[[i, j]], self.key)
            word = "tie" if fine.all() else "better" if fine[0] else "worse"
            first, second = (self._reliability_line(place, bool(ok)) for place, ok in ((j, fine[1]), (i, fine[0])))
            yield {**first, "verdict": "reference"}, {**second, "verdict": word, "against": a}

    def _line(self, kind: str, column: Column, label: str, **facts: Any) -> Line:
        _, metric, quantity, unit = column
        name, factor = shown_unit(self.about, metric, quantity, unit)
        return {"scenario": self.scenario, "variant": self.variant, "kind": kind, "metric": metric,
                "quantity": quantity, "unit": unit, "shown_unit": name, "factor": factor, "estimator": label,
                "lost": int(self.lost[self.labels.index(label)].sum()), **facts}

    # -- errors ----------------------------------------------------------------------------------------------------
    def _errors(self, column: Column, references: Sequence[str]) -> Iterator[Line]:
        """An error's value and verdict of each estimator; then each against the scenario's yardsticks."""
        values, power, found = averaged(self.aligned.values(column[0]), column[1])
        some = np.asarray(np.isfinite(values).any(axis=1))
        groups = [[i for i, label in enumerate(self.labels) if some[i] and self.apart.get(label, "") == kind]
                  for kind in ("", "smoother")]
        told: dict[int, Judged] = {}
        for group in filter(None, groups):
            told.update(dict.fromkeys(group, self._judged(values, group, power)))
        kind = self.about["variants"][self.variant].get("floor", "")
        for i, label in enumerate(self.labels):
            shown = _shown(found, i)
            if i in told:
                line = self._line("error", column, label, **shown, **told[i].against_best(i, self.labels))
            elif some[i]:
                line = self._line("error", column, label, **shown, verdict="oracle", note=notes(values[i], self.n))
            else:
                line = self._line("error", column, label, **shown, eligible=False,
                                  verdict="lost" if self.lost[i].all() else "none")
            yield floored(line, self.aligned, i, kind)
        for reference in references:
            j = self.labels.index(reference) if reference in self.labels else -1
            for i in told[j].members if j in told else ():
                if i != j:
                    yield self._line("yardstick", column, self.labels[i], **_shown(found, i), against=reference,
                                     **told[j].facts(i, j))

    def _judged(self, values: Array, group: list[int], power: float) -> Judged:
        family = compare_all(values[group], self.draws, power)
        return Judged(group, family, values, eligible(np.isnan(values[group]), self.key))

    # -- the rest --------------------------------------------------------------------------------------------------
    def _values(self, columns: Sequence[Column]) -> Iterator[Line]:
        """Means with their intervals of everything else that is measured, shares where a run is 0 or 1; no verdict."""
        for column in columns:
            name, metric, _, unit = column
            values = self.aligned.values(name)
            if unit == "1" and np.isin(values[~np.isnan(values)], (0.0, 1.0)).all():
                yield from (self._share("share", column, label, row)
                            for label, row in zip(self.labels, values, strict=True) if not np.isnan(row).all())
                continue
            found = averaged(values, metric, exact=True)[2] if metric in (*ERRORS, "half-width") else st.hall(values)
            for i, label in enumerate(self.labels):
                if found.n[i]:
                    yield self._line("value", column, label, **_shown(found, i))

    def _claims(self) -> Iterator[Line]:
        """`_claimed`; where the channel takes a claim's ground away, `not certified` beside what was measured."""
        reasons = self.about["variants"][self.variant].get("uncertified", {})
        for line in self._claimed():
            ground = "guarantee" if line["kind"] == "claim" else self.grounds.get(line["estimator"], "covariance")
            why = reasons.get(ground, "")
            if why and (line["kind"] == "claim" or line["metric"] == "nees"):
                note = "; ".join(filter(None, [why, f"measured: {line['verdict']}", line.get("note", "")]))
                line = {**line, "verdict": "not certified", "note": note}
            yield line

    def _claimed(self) -> Iterator[Line]:
        """Covariances, sets and bounds that estimators claim."""
        none = np.full((len(self.labels), self.n), np.nan)
        nees, states, inside, median, held, bound, measured = (
            self.aligned.values(name) if name in self.aligned else none for name in (
                "nees:state:1", "nees_states", "inside:state:1", "nees-median:state:1", "coverage:ellipsoid:1",
                "bound:performance:1", "mean-square:performance:1"))
        for i, label in enumerate(self.labels):
            known = ~np.isnan(nees[i])
            if known.any():
                found = claims.consistency(nees[i][known] / states[i][known], inside[i])
                middle = median[i][~np.isnan(median[i])]
                yield self._line("consistency", ("", "nees", "state", "1"), label, **_limits(found),
                                 verdict=found.verdict, note=found.note, inside=st.share(inside[i]).value,
                                 median=float(np.median(middle)) if middle.size else np.nan)
            yield from self._innovations(i, label)
            kept = st.finite(held[i])
            if kept.size:
                left = int((kept < 1).sum())
                yield {**self._share("claim", ("", "coverage", "ellipsoid", "1"), label, kept),
                       "verdict": "broken" if left else "kept",
                       "note": f"left in {left} of {kept.size} runs" if left else ""}
            limit = claims.bounded(measured[i], bound[i])
            if limit:
                yield self._line("claim", ("", "bound", "performance", "1"), label, **_limits(limit),
                                 verdict=limit.verdict, against="certified", ratio=limit.value / limit.certified,
                                 ratio_low=limit.low / limit.certified, ratio_high=limit.high / limit.certified)

    def _requirements(self) -> Iterator[Line]:
        """What the scenario asks for: met, not met, or undecided and by about how many runs it would be decided. A lost
        run has not kept it; who claims nothing that is asked about has no line."""
        for asked in self.about["variants"][self.variant].get("requirements", ()):
            metric, name = "kept" if asked["per"] == "runs" else "inside", asked["name"]
            column = f"{metric}:{name}:1"
            if column not in self.aligned:
                continue
            for label, row, lost in zip(self.labels, self.aligned.values(column), self.lost, strict=True):
                if np.isnan(row[~lost]).all() and not lost.all():
                    continue
                found = claims.requirement(np.where(lost, 0.0, row), asked["accept"])
                yield self._line("requirement", (column, metric, name, "1"), label, value=found.found.value,
                                 low=found.found.low, high=found.found.high, runs=found.found.n,
                                 verdict=found.verdict, deciding=found.deciding, against=f"{asked['accept']:g}",
                                 note=self._sizes(asked, label))

    def _sizes(self, asked: Mapping[str, Any], label: str) -> str:
        """The metres (or m/s) beside a verdict, which alone may mislead: 95th percentiles over the runs."""
        shown = {"allowance": ("use", "over", "under"), "speed": ("use",), "stop": ("error",),
                 "confidence": ("half-width", "k99"), "percentile": (f"p{asked.get('percent', 0):g}",)}[asked["form"]]
        words, i = [], self.labels.index(label)
        for metric in shown:
            found = [c for c in metric_columns(self.aligned.part) if c[1:3] == (metric, asked["name"])]
            values = st.finite(self.aligned.values(found[0][0])[i]) if found else np.zeros(0)
            if values.size:
                unit = "" if found[0][3] == "1" else f" {found[0][3]}"
                words.append(f"{metric} {np.percentile(values, 95):.3g}{unit}")
        return f"P95 over runs: {', '.join(words)}" if words else ""

    def _innovations(self, i: int, label: str) -> Iterator[Line]:
        """What needs no truth: NIS by the rule of the ANEES, whiteness, the mean log-likelihood, which is a score."""
        for metric in ("nis", "whiteness", "log-likelihood"):
            column = ("", metric, "innovation", "1")
            name = f"{metric}:innovation:1"
            values = self.aligned.values(name)[i] if name in self.aligned else np.zeros(0)
            if not st.finite(values).size:
                continue
            if metric == "nis":
                found = claims.consistency(values)
                yield self._line("consistency", column, label, **_limits(found), verdict=found.verdict, note=found.note)
            else:
                mean = st.hall(values)
                word = claims.white(mean) if metric == "whiteness" else ""
                yield self._line("consistency", column, label, value=float(mean.value), low=float(mean.low),
                                 high=float(mean.high), runs=int(mean.n), verdict=word)

    def _reliability(self) -> Iterator[Line]:
        """The share of runs that did not end well, and who lost more than equals would."""
        group = [i for i, label in enumerate(self.labels) if not self.apart.get(label)]
        fine = dict(zip(group, eligible(self.lost[group], self.key).tolist(), strict=True)) if group else {}
        for i, label in enumerate(self.labels):
            yield self._reliability_line(i, fine.get(i, True))
            for status, runs in zip(STATUSES, self.aligned.ended(STATUSES)[:, i], strict=True):
                if runs.any():
                    yield self._share("reliability", ("", status, "runs", "1"), label, runs)

    def _reliability_line(self, i: int, fine: bool) -> Line:
        label, runs = self.labels[i], self.lost[i]
        endings = [f"{int(n)} {status}" for status, n in zip(STATUSES, self.aligned.ended(STATUSES)[:, i].sum(axis=1),
                                                              strict=True) if n]
        return {**self._share("reliability", ("", "lost", "runs", "1"), label, runs), "eligible": fine,
                "verdict": "" if fine else "lost", "note": ", ".join(endings)}

    def _share(self, kind: str, column: Column, label: str, per_run: Array | Mask) -> Line:
        found = st.share(per_run)
        return self._line(kind, column, label, value=found.value, low=found.low, high=found.high, runs=found.n,
                          standard_error=st.mean_se(per_run)[1])


def _shown(found: st.Intervals, i: int) -> Line:
    return {"value": found.value[i], "low": found.low[i], "high": found.high[i], "standard_error": found.error[i],
            "runs": int(found.n[i])}


def _limits(found: claims.Claim | claims.Bounded) -> Line:
    return {"value": found.value, "low": found.low, "high": found.high, "runs": found.runs}


def averaged(values: Array, metric: str, *, exact: bool = False) -> tuple[Array, float, st.Intervals]:
    """What of `values` (k, n) is averaged over the runs, to which power the mean is shown, and the shown value with its
    interval: mean squares and 1/2 for RMSE, else the values themselves and 1."""
    values = values if exact else np.where(np.abs(values) < NEGLIGIBLE, 0.0, values)
    if metric == "rmse":
        return values**2, 0.5, st.rooted(st.hall(values**2, positive=True))
    return values, 1.0, st.hall(values, positive=True)


SUMMARY_COLUMNS = ("scenario", "variant", "estimator", "metric", "quantity", "unit", "mean", "standard_error", "runs")


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """summary.csv: of a verdict table, every metric's value and standard error over the finished runs, and the shares
    of runs that did not end well."""
    lines = table[table["kind"].isin(["error", "value", "share", "reliability"]) & (table["metric"] != "lost")
                  & (table["runs"] > 0)]
    return lines.rename(columns={"value": "mean"})[list(SUMMARY_COLUMNS)]
