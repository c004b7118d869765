"""A results folder: parts written whole, the manifest, and readers that check what they read.

Layout (public): {rows,curves,trajectories}/*.parquet, summary.csv, timing.csv, tables/, manifest.json."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import ValidationError

from ...scenarios.errors import InputError, describe
from ..scoring.columns import IDENTITY, TIMING
from .lock import LOCK, locked
from .manifest import SCHEMA, Manifest
from .parts import codes, labels_in, part_paths, read_curves, read_part, read_rows, read_trajectories, without
from .provenance import environment

if TYPE_CHECKING:
    import pandas as pd

KINDS = ("rows", "curves", "trajectories", "tables")
"""The folders in it."""
Gone = Mapping[tuple[str, str], Collection[int] | None]
"""(scenario/variant, estimator) -> runs whose rows are to go (None: all)."""


class Store:
    """A results folder being written or read."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self._manifest: dict[str, Any] | None = None

    # -- writing ---------------------------------------------------------------------------------------------------
    @property
    def exists(self) -> bool:
        """Whether it is a results folder. Raises InputError for a folder of something else."""
        if (self.folder / "manifest.json").exists():
            return True
        if self.folder.exists() and (not self.folder.is_dir() or any(
                path.name != LOCK and not path.name.startswith(".manifest.json.") for path in self.folder.iterdir())):
            raise InputError(f"{self.folder}: is not empty and not a results folder (no manifest.json); choose another "
                             "--out")
        return False

    @property
    def writable(self) -> bool:
        """Whether anything can be written to it, or it can be made."""
        place = self.folder
        while not place.exists() and place != place.parent:
            place = place.parent
        lock = self.folder / LOCK
        return os.access(place, os.W_OK | os.X_OK) and (not lock.exists() or os.access(lock, os.W_OK))

    @contextmanager
    def writing(self, command: str) -> Iterator[None]:
        """Make the folder and hold its lock. Raises InputError where another process does, or it is something else's.
        """
        self.exists  # noqa: B018  (refused before anything is put into it)
        self.folder.mkdir(parents=True, exist_ok=True)
        for kind in KINDS:
            within(self.folder, kind)
        with locked(self.folder, command):
            self._manifest = None
            for kind in (*KINDS, ""):
                for leftover in (self.folder / kind).glob(".*.[0-9]*"):  # of a process that was killed
                    leftover.unlink(missing_ok=True)
            yield

    def open(self, configuration: Mapping[str, Any], description: Mapping[str, Any], command: str,
             afresh: bool = False) -> None:
        """Write the manifest (first of all: without it the folder is nobody's), or what it now holds besides; afresh:
        instead. Raises InputError for names of which no file can be made."""
        before = self.manifest() if self.exists and not afresh else None
        commands: list[str] = before["command"].split(" && ") if before else []
        commands += [command] if command not in commands else []
        self._write_manifest({
            "schema_version": SCHEMA, "railstate": version("railstate"), "environment": environment(),
            "started": datetime.now(UTC).isoformat(timespec="seconds"), **(before or {}),
            "command": " && ".join(commands), "configuration": configuration, **description, "finished": None})
        for name in KINDS:
            (self.folder / name).mkdir(parents=True, exist_ok=True)

    def finish(self, *, rows: int, **facts: Any) -> None:
        """Record in the manifest how many rows there are, and the end of the run if those are all."""
        manifest = self.manifest()
        wanted = sum(cell["runs"] * len(cell["estimators"]) for cell in manifest["configuration"]["cells"].values())
        now = datetime.now(UTC).isoformat(timespec="seconds") if rows == wanted else None
        self._write_manifest({**manifest, "rows": rows, **facts, "finished": now})

    def told(self, key: str, name: str) -> Any:
        """What the manifest tells of a cell under a name; None: nothing."""
        scenario, variant = key.split("/")
        return self.manifest()["scenarios"][scenario]["variants"][variant].get(name)

    def tell(self, facts: Mapping[str, Mapping[str, Any]]) -> None:
        """Record more of cells (scenario/variant) in the manifest."""
        scenarios = json.loads(json.dumps(self.manifest()["scenarios"]))
        for key, about in facts.items():
            scenario, variant = key.split("/")
            scenarios[scenario]["variants"][variant].update(about)
        self._write_manifest({**self.manifest(), "scenarios": scenarios})

    def _write_manifest(self, content: Mapping[str, Any]) -> None:
        text = json.dumps(content, indent=1, default=list)
        self._manifest = _validated(text, self.folder / "manifest.json")
        self.write_text("manifest.json", text)

    def write_part(self, stem: str, **tables: pa.Table | None) -> None:
        """Write the tables of one task; `rows` last, each whole or not at all."""
        for kind in ("curves", "trajectories", "rows"):
            table = tables.get(kind)
            if table is not None:
                self._write_table(inside(self.folder / kind, f"{stem}.parquet"), table)

    def _write_table(self, path: Path, table: pa.Table) -> None:
        words = [field.name for field in table.schema if not pa.types.is_floating(field.type)]
        with _whole(path) as temporary:  # numbers that hardly repeat: dictionaries of them double the time
            pq.write_table(table, temporary, use_dictionary=words, write_statistics=False)  # pyright: ignore

    def write_text(self, name: str, text: str) -> None:
        """Write a text file whole or not at all. Raises InputError for a name that leads out of the folder."""
        write_whole(inside(self.folder, name), text)

    def write_timing(self, lines: pd.DataFrame) -> None:
        """Write lines of timing.csv, instead of those that it has of the same cells and estimators."""
        import pandas as pd

        before = self.timing()
        if before is not None:
            lines = pd.concat([before, lines]).drop_duplicates(list(TIMING[:3]), keep="last")
        self.write_text("timing.csv", lines.astype({"samples": "Int64"}).to_csv(index=False))

    def drop(self, gone: Gone) -> None:
        """Take rows out, with what belongs to them; a part without rows goes whole."""
        if not gone:
            return
        for path in part_paths(self.folder, "rows"):
            table = read_part(path, "rows")
            left = without(table, gone)
            if not left.num_rows:
                for kind in ("rows", "curves", "trajectories"):  # rows first: the others do not count without them
                    (self.folder / kind / path.name).unlink(missing_ok=True)
            elif left.num_rows < table.num_rows:
                self._write_table(path, left)
        for path in (self.folder / "tables").glob("*"):  # made again from what stays
            path.unlink()
        timing = self.timing()
        if timing is not None:
            lines = zip(*(timing[name] for name in TIMING[:3]), strict=True)
            stay = [gone.get((f"{scenario}/{variant}", label), ()) is not None for scenario, variant, label in lines]
            self.write_text("timing.csv", timing[stay].to_csv(index=False))

    def write_verdicts(self, table: pd.DataFrame) -> None:
        """Write verdicts.parquet."""
        self._write_table(self.folder / "verdicts.parquet", pa.Table.from_pandas(table, preserve_index=False))

    # -- reading ---------------------------------------------------------------------------------------------------
    def manifest(self) -> dict[str, Any]:
        """manifest.json, read once. Raises InputError where there is none, it is damaged or of another version."""
        if self._manifest is None:
            path = self.folder / "manifest.json"
            try:
                if path.exists() and not path.is_file():
                    raise InputError(f"{path}: is no file")
                self._manifest = _validated(path.read_bytes(), path)
            except (FileNotFoundError, NotADirectoryError):
                raise InputError(f"{self.folder}: not a results folder (no manifest.json); `railstate run --out DIR` "
                                 "makes one") from None
            except OSError as error:
                raise InputError(f"{path}: cannot be read: {error.strerror}") from None
        return self._manifest

    def done(self) -> dict[tuple[str, str], set[int]]:
        """(scenario/variant, estimator) -> the runs that have rows."""
        found: dict[tuple[str, str], set[int]] = {}
        table = self._rows(IDENTITY)
        for cell, estimator, run in [] if table is None else labels_in(table):
            found.setdefault((cell, estimator), set()).add(run)
        return found

    def lost(self, statuses: Collection[str]) -> dict[tuple[str, str], set[int]]:
        """(scenario/variant, estimator) -> the runs whose rows have one of these statuses."""
        found: dict[tuple[str, str], set[int]] = {}
        table = self._rows((*IDENTITY, "status"))
        if table is not None:
            words = table["status"].to_pylist()
            for (cell, estimator, run), status in zip(labels_in(table), words, strict=True):
                if status in statuses:
                    found.setdefault((cell, estimator), set()).add(run)
        return found

    def rows(self) -> pd.DataFrame:
        """All rows, sorted by scenario, variant, estimator (in the manifest's order) and run. Raises InputError."""
        table = self._rows()
        if table is None:
            raise InputError(f"{self.folder}: holds no finished rows yet; continue it with: "
                             f"{self.manifest()['command']}")
        places: dict[str, int] = {}
        for cell, value in self.manifest()["configuration"]["cells"].items():
            for label in value["estimators"]:
                places[f"{cell}/{label}"] = len(places)
        code, names = codes(table, IDENTITY[:3])
        place = np.array([places["/".join(name)] for name in names], dtype=int)[code]
        table = table.take(pa.array(np.lexsort((table["run"].to_numpy(), place))))
        return table.to_pandas(split_blocks=True, self_destruct=True)

    def verdicts(self) -> pd.DataFrame | None:
        """verdicts.parquet, or None where there is none that is newer than all rows and readable."""
        path = self.folder / "verdicts.parquet"
        try:
            written = path.stat().st_mtime_ns if path.is_file() else 0
            parts = [*(self.folder / "rows").glob("*.parquet")]
            if not parts or max(part.stat().st_mtime_ns for part in parts) > written:
                return None
            return pq.ParquetFile(path).read().to_pandas()
        except (OSError, pa.ArrowInvalid):
            return None

    def curves(self) -> pd.DataFrame:
        """Sums over all runs per scenario, variant, estimator, quantity and step (empty if there are none)."""
        return read_curves(self.folder)

    def trajectories(self) -> pd.DataFrame | None:
        """The kept trajectories (`--keep N`), or None."""
        table = read_trajectories(self.folder)
        return None if table is None else table.to_pandas(strings_to_categorical=True)

    def timing(self) -> pd.DataFrame | None:
        """timing.csv, or None. Raises InputError if it is damaged."""
        import pandas as pd

        path = self.folder / "timing.csv"
        if not path.is_file():
            return None
        try:
            table = pd.read_csv(path, dtype=dict.fromkeys(TIMING[:3], str), keep_default_na=False,
                                na_values={name: ["", "nan", "NaN"] for name in TIMING[3:]})
            if "samples" not in table:
                table["samples"] = float("nan")  # of a folder from before they were counted
            if table.duplicated(list(TIMING[:3])).any():
                raise ValueError("a line stands in it twice")
            return table.astype(dict.fromkeys(TIMING[3:], float))
        except (ValueError, KeyError, OSError) as error:
            raise InputError(f"{path}: damaged: {str(error).splitlines()[0]}; remove it and run again") from None

    def _rows(self, columns: tuple[str, ...] | None = None) -> pa.Table | None:
        return read_rows(self.folder, self.manifest()["configuration"]["cells"], columns)


def write_whole(path: Path, text: str) -> None:
    """Write a text file whole or not at all. Raises OSError naming it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with _whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


@contextmanager
def _whole(path: Path) -> Iterator[Path]:
    """A file beside it that takes its place once it is written."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        raise OSError(error.errno or 0, error.strerror or str(error), str(path)) from None
    finally:
        temporary.unlink(missing_ok=True)


def inside(folder: Path, name: str) -> Path:
    """The path of a file in a folder. Raises InputError for a name that leads out of it or is none, see `within`."""
    parts = name.split("/")
    if not all(re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._~=,@+-]*", part) for part in parts):
        raise InputError(f"{name[:200]!r}: is no name of a file in {folder}")
    for part in parts[:-1]:
        folder = within(folder, part)
    return folder / parts[-1]


def within(folder: Path, name: str) -> Path:
    """The path of a folder in a folder, there or not. Raises InputError for a link, which may lead out, or a file."""
    path = folder / name
    if path.is_symlink() or (path.exists() and not path.is_dir()):
        raise InputError(f"{path}: is no folder but a {'link' if path.is_symlink() else 'file'}; remove it")
    return path


def _validated(text: str | bytes, path: Path) -> dict[str, Any]:
    """A manifest's content. Raises InputError."""
    try:
        raw = json.loads(text)
        found = raw.get("schema_version", 1) if isinstance(raw, dict) and "configuration" in raw else SCHEMA
        if found != SCHEMA:
            raise InputError(f"{path}: was written by railstate {str(raw.get('railstate', '?'))[:40]} (folders of "
                             f"version {str(found)[:20]}; this one reads {SCHEMA}): read it with that one, or run "
                             "again with another --out")
        return Manifest.model_validate(raw).model_dump()
    except ValidationError as error:
        lines = describe(error, Manifest)
        more = f" (and {len(lines) - 1} more)" if len(lines) > 1 else ""
        raise InputError(f"{path}: damaged: {lines[0]}{more}") from None
    except (ValueError, RecursionError, TypeError) as error:
        raise InputError(f"{path}: damaged: {str(error).splitlines()[0][:200]}") from None
