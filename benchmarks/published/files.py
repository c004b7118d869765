"""The papers' files: what is printed, how our number for it is found, and the readings under which that is tried.

Data only: no number of ours is in them, and what a file says wrongly is named with its place."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from string import Formatter
from typing import Any, Literal

from pydantic import Field, ValidationError, field_validator, model_validator

from ...scenarios.errors import InputError, describe
from ...scenarios.schema import Strict

Agreement = Literal["reproduced", "corrected", "fitted", "follows from its own table"]
Disagreement = Literal["not reproduced", "contradicts its text"]
Word = Agreement | Disagreement | Literal["undecided", "unreachable"]
WORDS: dict[Word, str] = {
    "reproduced": "comes out, and nothing was chosen for it",
    "corrected": "comes out with a named misprint mended, which more printed numbers tell than it has freedom",
    "fitted": "comes out with a choice, for it, of what the paper does not print",
    "follows from its own table": "is arithmetic of the paper on numbers of its own",
    "not reproduced": "does not come out",
    "contradicts its text": "does not follow from the paper's own formulas, data or claims",
    "undecided": "more runs would tell",
    "unreachable": "nothing can be computed for it: what is missing is said",
}
"""The verdicts in the order of the tables, and what each says of a printed number."""
FOLDER = Path(__file__).parent


class Reading(Strict):
    """A way to read the paper: `where` stands for the {names} in its cells' texts; `agrees` is the best that an
    agreement can mean under it (a reading that was chosen for its numbers is `fitted`). counts: false for a method that
    is not the paper's own: its numbers are shown, and the paper is not judged by them."""

    title: str
    counts: bool = True
    agrees: Agreement | None = None
    where: dict[str, str | int | float] = {}


class Trial(Strict):
    """Cells of one run of the paper's, which carry its name in `trial`: tested together, since one run gave them all.
    decimals: what all of them are rounded to, in the cells' unit."""

    expected: Word
    rounding: float
    note: str = ""


class Published(Strict):
    """One printed number, and what of ours stands beside it.

    Either scenario, variant, estimator, metric, quantity (a summary of rows, times `factor`), or `compute` with its
    arguments (a function of `computed/`), or neither: unreachable, and `missing` says what is missing. {names} in
    these texts are a reading's.
    It agrees within relative * |published| + absolute of our number. trials: it is printed of one run (1), which has to
    lie among our single runs; of a mean of so many, whose chance is allowed for; 0: of neither. at_most, at_least: a
    claim that the number is not beyond this. agrees, differs: what an agreement or a disagreement means; why: the
    tolerance's reason. trial: cells of one run, tested together. expected: the verdict under the reading that
    stands for the paper."""

    group: str
    cell: str
    published: float | str
    unit: str
    scenario: str = ""
    variant: str = ""
    estimator: str = ""
    metric: str = ""
    quantity: str = ""
    factor: float = 1.0
    compute: str = ""
    arguments: list[str | int | float] = []
    relative: float = Field(0.0, ge=0)
    absolute: float = Field(0.0, ge=0)
    why: str
    trials: int = Field(0, ge=0)
    trial: str = ""
    at_most: float | None = None
    at_least: float | None = None
    agrees: Agreement = "reproduced"
    differs: Disagreement = "not reproduced"
    missing: str = ""
    expected: Word

    @model_validator(mode="after")
    def _reachable_or_not(self) -> Published:
        if bool(self.scenario or self.compute) == (self.expected == "unreachable") or (
                bool(self.missing) != (self.expected == "unreachable")):
            raise ValueError("a cell names what computes it (scenario .., or compute), or is unreachable and says what "
                             "is missing")
        if isinstance(self.published, str) and not self.claim and (self.scenario or self.compute):
            raise ValueError("published: a number, or the claim in words with at_most or at_least")
        return self

    @property
    def claim(self) -> bool:
        """Whether it is no number but that ours is not beyond one."""
        return self.at_most is not None or self.at_least is not None

    @property
    def names(self) -> set[str]:
        """The {names} in its texts."""
        texts = [self.scenario, self.variant, self.estimator, self.metric, self.quantity,
                 *(one for one in self.arguments if isinstance(one, str))]
        return {name for text in texts for _, name, _, _ in Formatter().parse(text) if name}

    def under(self, where: Mapping[str, Any]) -> Published:
        """The cell with its {names} filled in."""
        def fill(value: Any) -> Any:
            if not isinstance(value, str) or "{" not in value:
                return value
            return where[value[1:-1]] if value[1:-1] in where else value.format_map(where)

        texts = ("scenario", "variant", "estimator", "metric", "quantity")
        return self.model_copy(update={**{name: fill(getattr(self, name)) for name in texts},
                                       "arguments": [fill(one) for one in self.arguments]})


class _File(Strict):
    """The file itself: groups, each with `cells` that take over what the group says of all of them, and a `note` on
    them all. stands: the reading that stands for the paper; why: the reason."""

    title: str
    authors: str
    year: int
    reference: str
    stands: str = ""
    why: str = ""
    readings: dict[str, Reading] = {}
    trials: dict[str, Trial] = {}
    groups: list[dict[str, Any]]

    @field_validator("groups")
    @classmethod
    def _have_cells(cls, groups: list[dict[str, Any]]) -> list[dict[str, Any]]:
        for group in groups:
            cells = group.get("cells")
            if not isinstance(cells, list) or not all(isinstance(cell, dict) for cell in cells):
                raise ValueError(f"group \"{group.get('group')}\" needs cells = [{{ cell = .. }}, ..]")
        return groups

    @model_validator(mode="after")
    def _one_stands(self) -> _File:
        if self.readings and (self.stands not in self.readings or not self.why):
            raise ValueError(f"stands: one of the readings ({', '.join(self.readings)}), and `why` it stands")
        return self


class Paper(_File):
    """A file of `published/`. notes: by group."""

    name: str
    notes: dict[str, str]
    cells: tuple[Published, ...]

    def readings_of(self, cell: Published) -> list[str]:
        """The readings under which a cell is tried: the one that stands first, then those that change one of its
        {names}. One without a name where none does."""
        if not cell.names:
            return [""]
        return [self.stands, *(name for name, reading in self.readings.items()
                               if name != self.stands and cell.names & set(reading.where))]

    def under(self, cell: Published, reading: str) -> Published:
        """The cell as a reading has it; what the reading does not say is as in the one that stands."""
        if not reading:
            return cell
        chosen = self.readings[reading]
        filled = cell.under({**self.readings[self.stands].where, **chosen.where})
        return filled.model_copy(update={"agrees": chosen.agrees}) if (
            chosen.agrees and filled.agrees == "reproduced") else filled


def papers(names: Sequence[str] = ()) -> list[Paper]:
    """The papers asked for (none: all). Raises InputError for an unknown name or a malformed file."""
    known = sorted(path.stem for path in FOLDER.glob("*.toml"))
    for name in names:
        if name not in known:
            raise InputError(f"{name}: no such paper; there are {', '.join(known)}")
    return [read(FOLDER / f"{name}.toml") for name in (names or known)]


def read(path: Path) -> Paper:
    """A published file: groups share what their cells have in common; a matrix of values becomes a cell an entry."""
    try:
        book = _File.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path.name}: not valid TOML: {error}") from None
    except ValidationError as error:
        raise InputError("\n".join(f"{path.name}: {line}" for line in describe(error, _File))) from None
    cells: list[Published] = []
    notes: dict[str, str] = {}
    mistakes: list[str] = []
    for group in book.groups:
        common = {key: value for key, value in group.items() if key not in ("cells", "note")}
        notes[str(group.get("group"))] = str(group.get("note", ""))
        for given in group["cells"]:
            for each in _entries({**common, **given}):
                place = f"{each.get('group')}: {each.get('cell')}"
                try:
                    cells.append(cell := Published.model_validate(each))
                except ValidationError as error:
                    mistakes += describe(error, Published, place)
                    continue
                known = book.readings[book.stands].where if book.stands else {}
                mistakes += [f"{place}: {{{name}}}: the reading that stands does not say it; it says "
                             f"{', '.join(known) or 'nothing'}" for name in sorted(cell.names - set(known))]
                if cell.trial and cell.trial not in book.trials:
                    mistakes.append(f"{place}: trial {cell.trial}: not among [trials]: {', '.join(book.trials)}")
    if mistakes:
        raise InputError("\n".join(f"{path.name}: {line}" for line in mistakes))
    return Paper.model_construct(**dict(book), name=path.stem, notes=notes, cells=tuple(cells))


def _entries(cell: dict[str, Any]) -> Iterable[dict[str, Any]]:
    if not isinstance(cell.get("published"), list):
        yield cell
        return
    for i, row in enumerate(cell["published"]):
        for j, value in enumerate(row):
            yield {**cell, "cell": f"{cell['cell']}[{i + 1},{j + 1}]", "published": value,
                   "arguments": [*cell.get("arguments", []), i, j]}
