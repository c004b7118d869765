"""The command-line words that several commands share: options, `key=value` overrides, plans made from them."""

from __future__ import annotations

import tomllib
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

Memory = Annotated[float, typer.Option("--memory", metavar="GB", min=0.0,
                                       help="Memory a plug-in's process may take (0: a share of the machine's).")]


def gigabytes(memory: float) -> int:
    """`--memory` in bytes."""
    return int(memory * 1e9)


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
    except tomllib.TOMLDecodeError:
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
