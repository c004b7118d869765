"""One table over settings for a paper: a block a quantity, settings by rows, entries by columns under their families.

Bold is the least error and what ties with it; notes speak only of what is shown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from itertools import groupby

import numpy as np

from ...scenarios.errors import InputError
from .cleaning import csv_text, latex, markdown, visible
from .marks import Line, drawn
from .rankings import Cell, Ranking
from .wording import counted, metric_name, number

TEXT_WIDTH, LETTER, GAP, MOST_LINES = 322.0, 4.9, 12.0, 37
"""Points of a column of text, of a \\small letter, between two columns; lines that a page holds."""

TEX = r"\textbf{{{}}}", r"\textit{{{}}}", r"\rlap{$^{=}$}", r"\rlap{$^{?}$}"
"""How `_marked` marks in LaTeX: signs overhang, so that figures stay aligned."""


@dataclass(frozen=True)
class Block:
    """A quantity: its rankings by setting; decimals of its values, the same for all."""

    metric: str
    quantity: str
    unit: str
    rankings: dict[str, Ranking]

    @property
    def name(self) -> str:
        return ", ".join(filter(None, [f"{metric_name(self.metric)} of {self.quantity}", self.unit]))

    @property
    def places(self) -> int:
        """Three figures of the middle one of the least errors."""
        least = [ranking.best["value"] * ranking.best["factor"] for ranking in self.rankings.values()
                 if ranking.best and ranking.best["runs"] and ranking.best["value"] > 0]
        return int(np.clip(2 - np.floor(np.log10(np.median(least))), 0, 9)) if least else 3

    def value(self, line: Line) -> str:
        """A value at the block's decimals, three figures where those would show none."""
        shown = line["value"] * line["factor"]
        text = f"{shown:.{self.places}f}"
        return text if shown == 0 or float(text) else f"{shown:.1e}"


@dataclass(frozen=True)
class Grid:
    """The table: entries with their families, blocks, runs; settings named without their scenario where it is one."""

    entries: list[tuple[str, str]]
    blocks: list[Block]
    cells: list[Cell]
    title: str

    @property
    def labels(self) -> list[str]:
        return [label for label, _ in self.entries]

    def name(self, key: str) -> str:
        scenario, _, variant = key.partition("/")
        return variant if len({cell.scenario for cell in self.cells}) == 1 else f"{scenario}/{variant}"


def grid(cells: Sequence[Cell], scenarios: Sequence[str] = (), estimators: Sequence[str] = (),
         quantities: Sequence[str] = ()) -> Grid:
    """The table over some settings (scenario or scenario/variant), entries and quantities; none: all. Raises InputError
    naming what there is."""
    for flag, wanted, known in (
            ("--scenarios", scenarios, [*(c.scenario for c in cells), *(c.key for c in cells)]),
            ("--estimators", estimators, [label for cell in cells for label in cell.labels]),
            ("--quantities", quantities, [r.quantity for cell in cells for r in cell.rankings])):
        for name in wanted:
            if name not in known:
                raise InputError(f"{flag} {name}: not in this folder; allowed: {', '.join(dict.fromkeys(known))}")
    chosen = [cell for cell in cells if not scenarios or {cell.scenario, cell.key} & set(scenarios)]
    blocks: dict[tuple[str, str, str], dict[str, Ranking]] = {}
    for cell in chosen:
        for ranking in cell.rankings:
            if not quantities or ranking.quantity in quantities:
                blocks.setdefault((ranking.metric, ranking.quantity, ranking.unit), {})[cell.key] = ranking
    families = {label: cell.families.get(label, "Other") for cell in chosen for label in cell.entries}
    labels = list(estimators) or [label for label in families if any(label in cell.labels for cell in chosen)]
    order = list(dict.fromkeys(families[label] for label in labels if label in families))
    entries = sorted(((label, families[label]) for label in labels if label in families),
                     key=lambda entry: order.index(entry[1]))
    return Grid(entries, [Block(*key, found) for key, found in blocks.items()], chosen,
                " and ".join(dict.fromkeys(str(cell.about["title"]) for cell in chosen)) if len(
                    {cell.scenario for cell in chosen}) == 1 else counted(len(chosen), "setting"))


def means(block: Block, labels: Sequence[str]) -> list[str]:
    """Geometric mean of the ratio to the best over the block's settings; nothing where one is missing or lost."""
    out = []
    for label in labels:
        lines = [ranking.line(label) for ranking in block.rankings.values()]
        fine = [line["ratio"] for line in lines if line and drawn(line) in ("best", "tie", "undecided", "worse")
                and 0 < line["ratio"] < np.inf]
        out.append(f"{np.exp(np.mean(np.log(fine))):.2f}" if len(fine) == len(lines) and fine else "–")
    return out


def shown_words(table: Grid) -> set[str]:
    """Verdicts that appear."""
    return {drawn(line) for block in table.blocks for ranking in block.rankings.values() for label in table.labels
            if (line := ranking.line(label))}


def caption(table: Grid) -> list[str]:
    """What the table says, of which family and runs, and what its signs mean: only those that appear."""
    runs = sorted({cell.runs for cell in table.cells})
    families = sorted({int(line["family"]) for block in table.blocks for ranking in block.rankings.values()
                       for line in ranking.ranked if line["family"]})
    words = shown_words(table)
    metrics = " and ".join(dict.fromkeys(metric_name(block.metric) for block in table.blocks))
    many = f"{families[0]}" if len(families) == 1 else f"{families[0]} to {families[-1]}" if families else "0"
    parts = [f"{metrics} over {' or '.join(map(str, runs))} paired runs. {table.title}."]
    ties = " and entries that tie with it (=, 95 % interval of the ratio within ±1 %)" if "tie" in words else ""
    parts.append(f"Bold: least error of all {many} entries of a setting{ties}.")
    if "undecided" in words:
        parts.append("?: undecided at so many runs.")
    if "worse" in words:
        parts.append("All others are worse (95 %, simultaneous over all pairs).")
    if "lost" in words:
        parts.append("Italic: runs that finished of those run; lost more than equals would.")
    if "oracle" in words:
        parts.append("In brackets: told what the others estimate, not ranked.")
    if any(label in cell.smoothers for cell in table.cells for label in table.labels):
        parts.append("Smoothers are ranked among themselves.")
    halves = [(line["high"] - line["low"]) / 2 / line["value"] for block in table.blocks
              for ranking in block.rankings.values() for label in table.labels
              if (line := ranking.line(label)) and line["runs"] and line["value"] > 0 and np.isfinite(line["high"])]
    if halves:
        parts.append(f"Half of the 95 % interval of a value is at most {number(100 * max(halves), 2)} % of it.")
    if any(len(block.rankings) > 1 for block in table.blocks):
        parts.append("Ratio to best: geometric mean over the settings.")
    return parts


def _texts(table: Grid, block: Block) -> Iterator[tuple[str, list[tuple[str, str]]]]:
    """(setting, per entry (text, verdict)) of a block."""
    for key, ranking in block.rankings.items():
        out = []
        for label in table.labels:
            line = ranking.line(label)
            word = drawn(line) if line else ""
            out.append((f"{line['runs']}/{line['runs'] + line['lost']}" if line and word == "lost"
                        else block.value(line) if line and word else "–", word))
        yield table.name(key), out


def to_tex(table: Grid, name: str) -> str:
    """LaTeX with booktabs: as many tables as the width and height of a page ask for. name: of the label."""
    heads = _short_names(table)
    first = max([len("ratio to best"), *(len(table.name(cell.key)) for cell in table.cells)])
    alone = [sum(of == family for _, of in table.entries) == 1 for _, family in table.entries]
    widths = [max(len(head), len(table.entries[i][1]) if alone[i] else 4, *(
        len(texts[i][0]) for block in table.blocks for _, texts in _texts(table, block)))
        for i, head in enumerate(heads)]
    parts: list[list[int]] = [[]]
    used = first * LETTER
    for i, width in enumerate(widths):
        need = width * LETTER + GAP
        if parts[-1] and used + need > TEXT_WIDTH:
            parts.append([])
            used = first * LETTER
        parts[-1].append(i)
        used += need
    parts = [part.tolist() for part in np.array_split(np.arange(len(heads)), len(parts))]
    pages: list[list[Block]] = [[]]
    for block in table.blocks:
        lines = sum(len(b.rankings) + 2 for b in [*pages[-1], block])
        if pages[-1] and lines > MOST_LINES:
            pages.append([])
        pages[-1].append(block)
    tables = [(columns, blocks) for blocks in pages for columns in parts]
    out = []
    for place, (columns, blocks) in enumerate(tables):
        part = Grid([table.entries[i] for i in columns], blocks, table.cells, table.title)
        out.append(_one_tex(part, [heads[i] for i in columns], name + (f"-{place + 1}" if place else ""),
                            f" Part {place + 1} of {len(tables)}." if len(tables) > 1 else ""))
    return "\n".join(["% needs \\usepackage{booktabs}", *out])


def _short_names(table: Grid) -> list[str]:
    """Labels without the name of their plug-in where that is still clear under the family's heading."""
    plugins = {label: entry["plugin"] for cell in table.cells for label, entry in cell.entries.items()}
    short = {label: label.removeprefix(f"{plugins[label]}-") for label in table.labels}
    for family in {family for _, family in table.entries}:
        mine = [label for label, of in table.entries if of == family]
        common = {label.partition("-")[0] for label in mine}
        if len(mine) > 1 and len(common) == 1 and all("-" in label for label in mine):
            short.update({label: label.partition("-")[2] for label in mine})
    seen: dict[tuple[str, str], int] = {}
    for label, family in table.entries:
        seen[family, short[label]] = seen.get((family, short[label]), 0) + 1
    return [short[label] if seen[family, short[label]] == 1 else label for label, family in table.entries]


def _one_tex(table: Grid, heads: Sequence[str], name: str, part: str) -> str:
    n = len(heads)
    rules, groups, at = [], [], 2
    for family, members in groupby(table.entries, key=lambda entry: entry[1]):
        size = len(list(members))
        groups.append(rf"\multicolumn{{{size}}}{{c}}{{{latex(family)}}}")
        rules.append(rf"\cmidrule({'l' if at + size == n + 2 else 'lr'}){{{at}-{at + size - 1}}}")
        at += size
    said = latex(" ".join(caption(table)) + part).replace("(=,", "($^{=}$,").replace("?: und", "$^{?}$: und")
    lines = [r"\begin{table}", r"\centering\small\setlength{\belowcaptionskip}{6pt}", rf"\caption{{{said}}}",
             rf"\label{{tab:{name}}}", rf"\begin{{tabular}}{{@{{}}l*{{{n}}}{{r}}@{{\quad}}}}", r"\toprule",
             " & " + " & ".join(groups) + r" \\ " + "".join(rules),
             "setting & " + " & ".join(latex(head) for head in heads) + r" \\", r"\midrule"]
    for place, block in enumerate(table.blocks):
        lines.append(rf"\addlinespace[2pt]\multicolumn{{{n + 1}}}{{@{{}}l}}{{\emph{{{latex(block.name)}}}}}\\")
        for setting, texts in _texts(table, block):
            marked = (_marked(latex(text), word, *TEX) for text, word in texts)
            lines.append(" & ".join([latex(setting), *marked]) + r" \\")
        if len(block.rankings) > 1:
            lines.append(r"\textit{ratio to best} & " + " & ".join(map(latex, means(block, table.labels))) + r" \\")
        if place < len(table.blocks) - 1:
            lines.append(r"\midrule")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", r"\end{table}", ""])


def _marked(text: str, word: str, bold: str = "**{}**", italic: str = "*{}*", tie: str = " =",
            undecided: str = " ?") -> str:
    """Best and ties bold, lost runs italic; with the verdict's sign."""
    sign = {"tie": tie, "undecided": undecided}.get(word, "")
    return {"best": bold, "tie": bold, "lost": italic, "oracle": "({})"}.get(word, "{}").format(text) + sign


def to_md(table: Grid, name: str) -> str:
    """Markdown, a table a quantity."""
    out = [markdown(" ".join(caption(table))), ""]
    for block in table.blocks:
        out += [f"| {markdown(block.name)} | " + " | ".join(map(markdown, table.labels)) + " |",
                "| --- |" + " ---: |" * len(table.labels)]
        for setting, texts in _texts(table, block):
            out.append(f"| {markdown(setting)} | " + " | ".join(_marked(*text) for text in texts) + " |")
        if len(block.rankings) > 1:
            out.append("| *ratio to best* | " + " | ".join(means(block, table.labels)) + " |")
        out.append("")
    return "\n".join(out)


def to_html(table: Grid, name: str) -> str:
    """An HTML table."""
    heads = "".join(f"<th>{escape(label)}</th>" for label in table.labels)
    out = [f'<table id="{name}">', f"<caption>{escape(' '.join(caption(table)))}</caption>"]
    for block in table.blocks:
        out.append(f"<tbody><tr><th>{escape(block.name)}</th>{heads}</tr>")
        for setting, texts in _texts(table, block):
            values = (_marked(escape(text), word, "<b>{}</b>", "<i>{}</i>") for text, word in texts)
            out.append(f"<tr><th>{escape(setting)}</th>" + "".join(f"<td>{value}</td>" for value in values) + "</tr>")
        if len(block.rankings) > 1:
            out.append("<tr><th><i>ratio to best</i></th>" + "".join(f"<td>{mean}</td>" for mean in means(
                block, table.labels)) + "</tr>")
        out.append("</tbody>")
    return visible("\n".join([*out, "</table>", ""]))


CSV = ("value", "low", "high", "ratio", "ratio_low", "ratio_high")


def to_csv(table: Grid, name: str) -> str:
    """A line a value, all of its digits, in the shown unit."""
    out = [",".join(("scenario", "variant", "metric", "quantity", "unit", "entry", "runs", "lost", "verdict", *CSV))]
    for block in table.blocks:
        for key, ranking in block.rankings.items():
            for label in table.labels:
                line = ranking.line(label)
                if line is not None:
                    values = [line[n] * (1 if n.startswith("ratio") else line["factor"]) for n in CSV]
                    names = map(csv_text, (block.metric, block.quantity, block.unit, label))
                    out.append(",".join([*key.split("/"), *names, str(line["runs"]), str(line["lost"]), drawn(line),
                                         *("" if v != v else f"{v:.9g}" for v in values)]))
    return "\n".join([*out, ""])


WRITERS = {"tex": to_tex, "md": to_md, "csv": to_csv, "html": to_html}
