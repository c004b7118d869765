"""What several commands share: options, `key=value` overrides, the command as it was given, files that are written."""

from __future__ import annotations

import shlex
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from ...scenarios.errors import InputError

Estimators = Annotated[str, typer.Option("--estimators", "-e", metavar="A,B",
                                         help="Labels of the scenario, or names of installed estimators.")]
Runs = Annotated[int, typer.Option("--runs", "-n", help="Monte Carlo runs.")]
Seed = Annotated[int, typer.Option(help="Root seed; the same seed gives bit-identical rows.")]
Jobs = Annotated[int, typer.Option("--jobs", "-j", help="Processes (0: all cores). Does not change a row.")]
Sets = Annotated[list[str], typer.Option("--set", metavar="KEY=VALUE",
                                         help="Override a key of the scenario file, such as channel.p=0.3.")]
Plugins = Annotated[list[str], typer.Option("--plugin", metavar="FILE.py",
                                            help="Use estimator classes of a loose file.")]
Line = Annotated[str, typer.Option("--line", metavar="FILE", help="The line: a TTOBench track file.")]
Train = Annotated[str, typer.Option("--train", metavar="FILE", help="The train: a TTOBench train file.")]
Recording = Annotated[list[str], typer.Option("--recording", metavar="FILE",
                                              help="Recorded trip for the recorded setting; several: several trips.")]
Map = Annotated[str, typer.Option("--map", metavar="ROLE=COLUMN,..",
                                  help="Columns of the recording: time=t_s,position=s_m,..")]
Quality = Annotated[str, typer.Option("--quality", metavar="CLASS=SD,..",
                                      help="What classes of a _sd column mean: m, m/s, or missing.")]
Missing = Annotated[str, typer.Option("--missing", metavar="VALUE,..", help="Values that stand for none, as -9999.")]
Track = Annotated[str, typer.Option("--track", metavar="FILE", help="GeoJSON line that latitude and longitude run "
                                                                    "along; none: the recording's own path.")]
Balises = Annotated[str, typer.Option("--balises", metavar="FILE", help="Table of balises, a name and a "
                                                                       "position, for a recording that names them.")]
From = Annotated[float | None, typer.Option("--from", help="Leave out what is before, s after the first row.")]
To = Annotated[float | None, typer.Option("--to", help="Leave out what is after, s after the first row.")]
Without = Annotated[list[str], typer.Option("--without", metavar="FROM..TO",
                                            help="Leave out these seconds of the recording.")]

Batch = Annotated[int, typer.Option(help="Runs computed together (0: chosen). Does not change a row.")]
Backend = Annotated[str, typer.Option(help="local, or dask: a cluster.")]
Scheduler = Annotated[str, typer.Option(metavar="ADDRESS", help="Of the cluster's scheduler, as tcp://host:8786.")]
Timeout = Annotated[float, typer.Option(help="Seconds after which a task counts as hung.")]
Memory = Annotated[float, typer.Option("--memory", metavar="GB", min=0.0,
                                       help="Memory a plug-in's process may take (0: a share of the machine's).")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing: no tables, no progress.")]


def command() -> str:
    """The command as it was given, for a folder or a file to tell."""
    return shlex.join(["railstate", *sys.argv[1:]])


@contextmanager
def written(flag: str, path: str) -> Iterator[None]:
    """InputError of what cannot be written meanwhile."""
    try:
        yield
    except (OSError, ValueError) as error:
        raise InputError(f"{flag} {path}: cannot be written: {getattr(error, 'strerror', None) or error}") from None


def names_in(text: str) -> list[str]:
    """`A,B` as a list."""
    return [word.strip() for word in text.split(",") if word.strip()]


def labels(text: str) -> list[str]:
    """`--estimators A,B`. Raises InputError for an option without a name in it."""
    found = names_in(text)
    if text and not found:
        raise InputError(f"--estimators {text}: expected labels or names, such as ekf,ukf")
    return found


def value(text: str) -> Any:
    """A TOML value, or the text itself where it is none."""
    try:
        return tomllib.loads(f"v = {text}")["v"]
    except (tomllib.TOMLDecodeError, RecursionError):
        return text


def overrides(pairs: list[str], flag: str = "--set", example: str = "channel.p=0.3") -> dict[str, Any]:
    """`key=value` words as a mapping. Raises InputError for a word without `=`."""
    out: dict[str, Any] = {}
    for pair in pairs:
        key, equals, text = pair.partition("=")
        if not equals or not key.strip():
            raise InputError(f"{flag} {pair}: expected KEY=VALUE, such as {example}")
        out[key.strip()] = value(text.strip())
    return out


def meaning(columns: str, quality: str, missing: str, track: str, balises: str, begin: float | None,
            end: float | None, without: list[str]) -> dict[str, Any]:
    """The flags that say what a recording means as overrides of the scenario. Raises InputError."""
    changes: dict[str, Any] = {}
    if columns:
        changes["plant.map"] = _pairs("--map", columns, "ROLE=COLUMN", "time=t_s,position=s_gnss_m")
    if quality:
        pairs = _pairs("--quality", quality, "CLASS=SD", "NARROW_INT3=0.05,PROPAGATED=missing")
        changes["plant.quality"] = {name: value(text) for name, text in pairs.items()}
    if missing:
        changes["plant.missing"] = [value(text) for text in names_in(missing)]
    for key, path in (("track", track), ("balises", balises)):
        if path:
            changes[f"plant.{key}"] = existing(f"--{key}", path)
    if begin is not None or end is not None:
        changes["plant.span"] = [begin or 0.0, 1e12 if end is None else end]
    if without:
        changes["plant.without"] = [_span(text) for text in without]
    return changes


def files(line: str, train: str, recording: list[str]) -> dict[str, Any]:
    """`--line`, `--train` and `--recording FILE`, the last given once or several times, as overrides of the scenario.
    Raises InputError."""
    found = {f"plant.{name}": existing(f"--{name}", path) for name, path in (("line", line), ("train", train)) if path}
    paths = [existing("--recording", path) for path in recording]
    return {**found, **({"plant.recording": paths[0] if len(paths) == 1 else paths} if paths else {})}


def existing(flag: str, path: str) -> str:
    """The full path of a user's file. Raises InputError where there is none."""
    if not Path(path).exists():
        raise InputError(f"{flag} {path}: no such file")
    return str(Path(path).resolve())


def _pairs(flag: str, text: str, form: str, example: str) -> dict[str, str]:
    pairs = {name: column for name, _, column in (pair.partition("=") for pair in names_in(text))}
    if not pairs or not all(pairs.values()):
        raise InputError(f"{flag} {text}: expected {form} pairs, such as {example}")
    return pairs


def _span(text: str) -> list[float]:
    try:
        begin, end = (float(part) for part in text.split(".."))
    except ValueError:
        raise InputError(f"--without {text}: expected FROM..TO in seconds, such as 205..240") from None
    return [begin, end]
