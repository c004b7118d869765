"""A results folder: parts written whole, the manifest, and readers that check what they read.

Layout (public): {rows,curves,trajectories}/*.parquet, summary.csv, timing.csv, tables/, manifest.json.
A part of `rows` is written last: curves and trajectories without their rows do not count."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ...scenarios.errors import InputError
from ..scoring.columns import IDENTITY, TIMING
from .manifest import MANIFEST, differing, environment

if TYPE_CHECKING:
    import pandas as pd



class Store:
    """A results folder being written or read."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)

    # -- writing ---------------------------------------------------------------------------------------------------
    def open(self, configuration: Mapping[str, Any], description: Mapping[str, Any], command: str) -> None:
        """Create the folder, or continue one of the same configuration. Raises InputError naming what differs."""
        manifest = self.folder / "manifest.json"
        if manifest.exists():
            differences = differing(self.manifest()["configuration"], json.loads(json.dumps(configuration)))
            if differences:
                shown = "\n".join(f"  {line}" for line in differences[:8])
                raise InputError(f"{self.folder}: holds results of another configuration; choose another --out or "
                                 f"remove it. What differs (there -> now):\n{shown}")
        elif self.folder.exists() and (not self.folder.is_dir() or any(self.folder.iterdir())):
            raise InputError(f"{self.folder}: is not empty and not a results folder (no manifest.json); choose another "
                             "--out")
        if not manifest.exists():  # first of all: without it the folder is nobody's
            self.write_text("manifest.json", json.dumps({
                "railstate": version("railstate"), "command": command, "configuration": configuration,
                **description, "environment": environment(), "started": datetime.now(UTC).isoformat(timespec="seconds"),
                "finished": None}, indent=1))
        for name in ("rows", "curves", "trajectories", "tables"):
            (self.folder / name).mkdir(parents=True, exist_ok=True)

    def finish(self, **facts: Any) -> None:
        """Record the end of the run in the manifest."""
        self.write_text("manifest.json", json.dumps({
            **self.manifest(), "finished": datetime.now(UTC).isoformat(timespec="seconds"), **facts}, indent=1))

    def write_part(self, stem: str, **tables: pa.Table | None) -> None:
        """Write the tables of one task; `rows` last, each whole or not at all."""
        for kind in ("curves", "trajectories", "rows"):
            table = tables.get(kind)
            if table is not None:
                path = self.folder / kind / f"{stem}.parquet"
                temporary = path.with_name(f".{path.name}.{os.getpid()}")
                pq.write_table(table, temporary)
                os.replace(temporary, path)

    def write_text(self, name: str, text: str) -> None:
        """Write a text file whole or not at all."""
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = path.with_name(f".{path.name}.{os.getpid()}")
        temporary.write_text(text, encoding="utf-8")
        os.replace(temporary, path)

    # -- reading ---------------------------------------------------------------------------------------------------
    def manifest(self) -> dict[str, Any]:
        """manifest.json. Raises InputError where there is none or it is damaged."""
        path = self.folder / "manifest.json"
        if not path.is_file():
            raise InputError(f"{self.folder}: not a results folder (no manifest.json); `railstate run --out DIR` makes "
                             "one")
        try:
            manifest = json.loads(path.read_text(encoding="utf-8"))
            cells = manifest["configuration"]["cells"]
            for key, kind in MANIFEST.items():
                if not isinstance(manifest[key], kind):
                    raise TypeError(f"{key} is no {kind.__name__}")
            for name, key in ((key.split("/")[0], key) for key in cells):
                if not {"variants", "table"} <= {*manifest["scenarios"][name], *manifest["replay"]["cells"][key]}:
                    raise KeyError(key)
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(f"{path}: damaged: {error!r}") from None
        return manifest

    def done(self) -> dict[tuple[str, str], set[int]]:
        """(scenario/variant, estimator) -> the runs that have rows."""
        found: dict[tuple[str, str], set[int]] = {}
        table = self._read("rows", list(IDENTITY))
        if table is not None:
            for scenario, variant, estimator, run in zip(*(table[name].to_pylist() for name in IDENTITY), strict=True):
                found.setdefault((f"{scenario}/{variant}", estimator), set()).add(run)
        return found

    def rows(self) -> pd.DataFrame:
        """All rows, sorted by scenario, variant, estimator (in the manifest's order) and run. Raises InputError."""
        manifest = self.manifest()
        table = self._read("rows")
        if table is None:
            raise InputError(f"{self.folder}: holds no finished rows yet; continue it with: {manifest['command']}")
        frame = table.to_pandas()
        places = [f"{cell}/{label}" for cell, value in manifest["configuration"]["cells"].items()
                  for label in value["estimators"]]
        place = (frame["scenario"] + "/" + frame["variant"] + "/" + frame["estimator"]).map(
            {key: n for n, key in enumerate(places)})
        return frame.iloc[np.lexsort((frame["run"], place))].reset_index(drop=True)

    def curves(self) -> pd.DataFrame:
        """Sums over all runs per scenario, variant, estimator, quantity and step (empty if there are none)."""
        import pandas as pd

        table = self._read("curves")
        if table is None:
            return pd.DataFrame(columns=["scenario", "variant", "estimator", "quantity", "step", "time", "active",
                                         "squared", "fourth", "error"])
        keys = ["scenario", "variant", "estimator", "quantity", "step", "time"]
        sums = ["active", "squared", "fourth", "error"]
        whole = table.group_by(keys, use_threads=False).aggregate([(name, "sum") for name in sums])
        return whole.rename_columns({f"{name}_sum": name for name in sums}).to_pandas(strings_to_categorical=True)

    def trajectories(self) -> pd.DataFrame | None:
        """The kept trajectories (`--keep N`), or None."""
        table = self._read("trajectories")
        return None if table is None else table.to_pandas(strings_to_categorical=True)

    def timing(self) -> pd.DataFrame | None:
        """timing.csv, or None. Raises InputError if it is damaged."""
        import pandas as pd

        path = self.folder / "timing.csv"
        if not path.is_file():
            return None
        try:
            table = pd.read_csv(path)
            return table.astype(dict.fromkeys(TIMING[3:], float)).astype(dict.fromkeys(TIMING[:3], str))
        except (ValueError, KeyError, OSError) as error:
            raise InputError(f"{path}: damaged: {error}") from None

    def _read(self, kind: str, columns: list[str] | None = None) -> pa.Table | None:
        rows = {path.name for path in (self.folder / "rows").glob("*.parquet")}
        tables = []
        for path in sorted((self.folder / kind).glob("*.parquet")):
            if path.name not in rows:
                continue
            try:
                table = pq.ParquetFile(path).read(columns)
                missing = [name for name in IDENTITY[:3 if kind == "curves" else 4] if name not in table.column_names]
                if missing:
                    raise OSError(f"no column {missing[0]}")
                tables.append(table)
            except (pa.ArrowInvalid, pa.ArrowKeyError, OSError) as error:
                raise InputError(f"{path}: damaged ({str(error).splitlines()[0]}); remove it and run again: only its "
                                 "rows are computed anew") from None
        return pa.concat_tables(tables, promote_options="default") if tables else None
