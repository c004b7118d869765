"""A finished folder on standard output: tables, headlines, failures with their replay lines."""

from __future__ import annotations

from itertools import groupby

import pandas as pd

from ..judging.table import verdicts_of
from ..store.folder import Store
from .console import print_table
from .sayings import headlines
from .tables import cell_tables, requirement_tables, window_tables
from .wording import notes_of


def print_results(store: Store) -> None:
    """The tables on standard output, failures with their replay lines, and the closing count."""
    rows, manifest, table = store.rows(), store.manifest(), verdicts_of(store)
    windows: dict[str, list[tuple[str, pd.DataFrame]]] = {}
    for title, parts in (*requirement_tables(table), *window_tables(table, manifest)):
        windows.setdefault(title.partition(": ")[0], []).append((title, parts))
    tables = cell_tables(table, manifest, store.timing())
    for scenario, variants in groupby(tables, lambda item: item[0].split("/")[0]):
        told: set[str] = set()
        for place, (key, frame, caption) in enumerate(variants):
            notes = [caption, *notes_of(manifest["scenarios"][scenario]["variants"][key.split("/")[1]])]
            print_table(key, frame, [note for note in notes if note not in told])
            told.update(notes)
            for title, parts in windows.pop(key, []):
                if place == 0 or title.endswith(": requirements"):
                    print_table(title, parts, ["Sizes: 95th percentiles over the runs."]
                                if title.endswith(": requirements") else [])
        for line in headlines(table, scenario):
            print(f"{scenario}: {line}")
        print()
    bad = rows[rows["status"] != "ok"]
    groups = bad.groupby(["scenario", "variant", "estimator", "status", "reason"], sort=False)
    for (scenario, variant, estimator, status, reason), part in groups:
        first = int(part["run"].iloc[0])
        print(f"{status}: {scenario}/{variant}/{estimator}, {len(part)} of {manifest['configuration']['runs']} runs: "
              f"{str(reason).splitlines()[0] if reason else 'no reason given'}\n"
              f"  replay: railstate replay {scenario}/{variant}/{estimator}/{first} --out {store.folder}")
    counts = rows["status"].value_counts()
    print(f"{len(rows)} rows: " + ", ".join(f"{n} {status}" for status, n in counts.items()) + f"; in {store.folder}")
