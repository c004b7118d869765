"""Printing: no line wider than the terminal (120 columns where there is none), no letter that the output cannot encode.

Wide tables are set in several, one under another, the first column again in each. Progress is a bar on a terminal, a
line a minute in a log."""

from __future__ import annotations

import json
import math
import os
import shutil
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from .cleaning import plain, raw, visible
from .wording import numeric

if TYPE_CHECKING:
    import pandas as pd

WIDE, NARROWEST = 120, 40
GAP = 2
LEAST_TEXT, NAME = 16, 40
"""Columns that a text keeps at least when it is wrapped; first columns up to this are names, and stay whole."""
Advance = Callable[[int, str], None]
"""advance(count, what): so many more are done, the last of them of this."""
Piece = tuple[str, str]
"""(text, style)."""


def columns() -> int:
    """Columns of the output: the terminal's; else what COLUMNS says, at most 120."""
    found = shutil.get_terminal_size((WIDE, 24)).columns
    return max(NARROWEST, found if sys.stdout.isatty() else min(found, WIDE))


def say(*pieces: Piece | str) -> None:
    """A line on standard output; colours on a terminal that has them, unless NO_COLOR asks for none."""
    parts = [(visible(text), style) for text, style in
             ((piece, "") if isinstance(piece, str) else piece for piece in pieces)]
    if not sys.stdout.isatty() or os.environ.get("NO_COLOR"):
        print("".join(text for text, _ in parts).rstrip())
        return
    from rich.console import Console
    from rich.text import Text

    out = Console(file=raw(sys.stdout), width=10_000, highlight=False, markup=False, emoji=False, soft_wrap=True,
                  legacy_windows=False)
    out.print(Text.assemble(*parts), end="\n")


def wrapped(text: str, indent: str = "  ") -> None:
    """A sentence, wrapped at the output's width; lines after the first are indented."""
    for line in textwrap.wrap(plain(text), columns(), subsequent_indent=indent, break_on_hyphens=False) or [""]:
        say(line)


def command(*parts: str) -> None:
    """A line to copy, continued by a backslash where it is longer than the output is wide."""
    whole = plain("  " + " ".join(parts))
    say(whole if len(whole) <= columns() else plain("  " + " \\\n    ".join(parts)))


def print_json(content: Any) -> None:
    """Plain data as JSON, numbers that are none as null."""
    def clean(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: clean(item) for key, item in value.items()}
        if isinstance(value, list | tuple):
            return [clean(item) for item in value]
        return None if isinstance(value, float) and not math.isfinite(value) else value

    print(json.dumps(clean(content), indent=1, default=lambda value: value.item() if hasattr(value, "item")
                     else str(value)))


@dataclass
class Column:
    """A column: head lines, cells of pieces. right: set to the right; text: may be wrapped. Widths are counted here."""

    head: list[str]
    cells: list[list[Piece]]
    right: bool = False
    text: bool = False

    def __post_init__(self) -> None:
        self.head = [plain(visible(line)) for line in self.head]
        self.cells = [[(plain(visible(text)).replace("\n", " "), style) for text, style in cell] for cell in self.cells]
        self.width = max([*map(len, self.head), *(sum(len(text) for text, _ in cell) for cell in self.cells), 0])

    @property
    def least(self) -> int:
        return min(self.width, max(LEAST_TEXT, *map(len, self.head))) if self.text else self.width


def print_columns(first: Column, rest: Sequence[Column], heading: str = "") -> None:
    """Columns side by side as far as they fit, then the next beneath, the first one again in each."""
    if heading:
        for line in textwrap.wrap(plain(heading), columns()):
            say((line, "bold"))
    width = columns()
    waiting = list(rest)
    while waiting or rest == []:
        group = [first]
        while waiting and (len(group) == 1 or sum(c.least + GAP for c in group) + waiting[0].least <= width):
            group.append(waiting.pop(0))
        _print_group(group, width)
        if not waiting:
            break
        print()


def _print_group(group: list[Column], width: int) -> None:
    widths = [column.least for column in group]
    room = width - sum(widths) - GAP * (len(group) - 1)
    while room > 0 and any(size < column.width for size, column in zip(widths, group, strict=True)):
        place = max(range(len(group)), key=lambda i: group[i].width / widths[i])  # the most wrapped one gets it
        widths[place] += 1
        room -= 1
    if room < 0:  # one column alone is too wide
        widest = max(range(len(group)), key=lambda i: widths[i])
        widths[widest] = max(8, widths[widest] + room)
    depth = max(len(column.head) for column in group)
    for i in range(depth):
        heads = [([""] * (depth - len(column.head)) + column.head)[i] for column in group]
        say((_set([head[:size] for head, size in zip(heads, widths, strict=True)], group, widths).rstrip(), "bold"))
    say(plain("─") * min(width, sum(widths) + GAP * (len(group) - 1)))
    for row in range(len(group[0].cells)):
        parts = [_lines(column.cells[row], size) for column, size in zip(group, widths, strict=True)]
        for i in range(max(map(len, parts))):
            pieces: list[Piece] = []
            for column, size, part in zip(group, widths, parts, strict=True):
                cell = part[i] if i < len(part) else []
                pad = " " * (size - sum(len(text) for text, _ in cell))
                pieces += [*([(pad, "")] if column.right else []), *cell, *([] if column.right else [(pad, "")]),
                           (" " * GAP, "")]
            say(*pieces[:-1])


def _set(texts: Sequence[str], group: Sequence[Column], widths: Sequence[int]) -> str:
    return (" " * GAP).join(text.rjust(size) if column.right else text.ljust(size)
                            for text, column, size in zip(texts, group, widths, strict=True))


def _lines(cell: list[Piece], width: int) -> list[list[Piece]]:
    if sum(len(text) for text, _ in cell) <= width:
        return [cell]
    style = cell[0][1] if cell else ""
    return [[(line, style)] for line in textwrap.wrap("".join(text for text, _ in cell), width, break_on_hyphens=False)]


def print_table(title: str, table: pd.DataFrame | Sequence[Mapping[str, Any]], notes: Sequence[str] = (),
                keys: int = 1) -> None:
    """A table of texts, a frame or a mapping per row: words to the left and wrapped, numbers to the right. keys: how
    many first columns say together what a line is about."""
    if isinstance(table, Sequence):
        columns = {name: [row[name] for row in table] for name in (table[0] if table else ())}
    else:
        columns = {name: table[name].astype(object).where(table[name].notna(), "") for name in table.columns}
    made = []
    for name, cells in columns.items():
        values = [str(value) for value in cells]
        right = numeric(values)
        name_like = not made and max(map(len, values), default=0) <= NAME
        made.append(Column(str(name).split(" ") if right else [str(name)], [[(value, "")] for value in values], right,
                           not right and not name_like))
    if made:
        print_columns(_side_by_side(made[:keys]), made[keys:], title)
    for note in notes:
        wrapped(note)
    print()


def _side_by_side(columns: list[Column]) -> Column:
    """Several columns as one, none of them wrapped."""
    if len(columns) == 1:
        return columns[0]
    widths = [column.width for column in columns]
    return Column([_set([" ".join(column.head) for column in columns], columns, widths)], [
        [(_set(["".join(text for text, _ in cell) for cell in cells], columns, widths), "")]
        for cells in zip(*(column.cells for column in columns), strict=True)])


COMPILING = "compiling what this run needs for this version and this processor, once: up to two minutes"
_hushed = False


def hush(on: bool) -> None:
    """Whether progress is kept to itself from here on."""
    global _hushed
    _hushed = on


def _nothing(count: int, what: str) -> None:
    """Progress that nobody sees."""


@contextmanager
def progress(total: int, unit: str) -> Iterator[Advance]:
    """Yield `advance(count, what)`: on standard error a bar with rate and time left, or a line a minute in a log."""
    if total == 0 or _hushed:
        yield _nothing
        return
    if not sys.stderr.isatty():
        with _logged(total, unit) as logged:
            yield logged
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    parts = (TextColumn("{task.description:32.32}"), BarColumn(), TextColumn("{task.completed:.0f}/{task.total:.0f} "
             + unit), TextColumn("{task.fields[rate]}"), TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
    from ...scenarios.machine_code import told

    with told(COMPILING), Progress(*parts, console=Console(file=raw(sys.stderr)), transient=True) as bar:
        job = bar.add_task("starting", total=total, rate="")

        def advance(count: int, what: str) -> None:
            elapsed = bar.tasks[0].elapsed or 0.0
            done = bar.tasks[0].completed + count
            bar.update(job, advance=count, description=what, rate=f"{done / elapsed:.0f}/s" if elapsed else "")

        yield advance


MINUTE = 60.0
"""Seconds between two lines of a log."""


@contextmanager
def _logged(total: int, unit: str) -> Iterator[Advance]:
    begin, done, last, end = time.monotonic(), 0, "starting", threading.Event()

    def advance(count: int, what: str) -> None:
        nonlocal done, last
        done, last = done + count, what

    def tell() -> None:
        while not end.wait(MINUTE):
            elapsed = time.monotonic() - begin
            left = f", about {elapsed * (total - done) / done / 60:.0f} min left" if done else ""
            print(f"{elapsed / 60:.0f} min: {done}/{total} {unit}, {last}{left}", file=sys.stderr, flush=True)

    teller = threading.Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield advance
    finally:
        end.set()
        teller.join()
