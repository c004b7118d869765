"""A finished folder on standard output: verdict tables, findings, lost runs with their replay lines, the count."""

from __future__ import annotations

from ..judging.table import verdicts_of
from ..store.folder import Store
from .console import command, print_json, print_table, say, wrapped
from .rankings import cells_of, records
from .tables import phase_tables, window_tables
from .terminal import print_cell, print_key
from .wording import notes_of


def print_results(store: Store) -> None:
    """The cells on standard output, lost runs with their replay lines, and the closing count."""
    rows, manifest, table = store.rows(), store.manifest(), verdicts_of(store)
    told: set[str] = set()
    parts = [*window_tables(table, manifest), *phase_tables(table[table["scenario"].isin(
        table["scenario"][table["kind"] == "requirement"])], manifest)]
    for cell in cells_of(table, manifest, store.timing()):
        print_cell(cell, f", seed {manifest['configuration']['seed']}")
        for note in notes_of(cell.about["variants"][cell.variant]):
            if note not in told:
                wrapped(f"Note: {note}")
                told.add(note)
        for title, frame in parts:
            if title.startswith(f"{cell.key}: ") and cell.variant == next(iter(cell.about["variants"])):
                print_table(title, frame)
        print()
    print_key()
    print()
    bad = rows[rows["status"] != "ok"]
    for (scenario, variant, estimator, status, reason), part in bad.groupby(
            ["scenario", "variant", "estimator", "status", "reason"], sort=False):
        wrapped(f"{status}: {scenario}/{variant}/{estimator}, {len(part)} of {manifest['configuration']['runs']} runs: "
                f"{str(reason).splitlines()[0] if reason else 'no reason given'}")
        command(f"railstate replay {scenario}/{variant}/{estimator}/{int(part['run'].iloc[0])}",
                f"--out {store.folder}")
    counts = rows["status"].value_counts()
    say(f"{len(rows)} rows: " + ", ".join(f"{n} {status}" for status, n in counts.items()) + f"; in {store.folder}")
    command("page: railstate report", str(store.folder))


def print_results_json(store: Store) -> None:
    """The same as data: folder, counts, the verdict table's lines."""
    rows = store.rows()
    print_json({"folder": str(store.folder), "rows": len(rows),
                "statuses": {str(k): int(v) for k, v in rows["status"].value_counts().items()},
                "verdicts": records(verdicts_of(store))})
