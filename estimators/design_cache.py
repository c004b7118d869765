"""Designs kept on disk by the content of their inputs: an LMI is solved once on a machine, not once a run.

Entries are written whole and carry a checksum; one that is damaged, unreadable or old is designed again."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..scenarios.errors import Infeasible


@dataclass(frozen=True)
class Cached:
    """A design as JSON values, and whether it came from the disk."""

    value: dict[str, Any]
    cached: bool


def folder() -> Path:
    """Where designs are kept: RAILSTATE_CACHE, else the user's cache folder (XDG_CACHE_HOME, else ~/.cache)."""
    if own := os.environ.get("RAILSTATE_CACHE"):
        return Path(own)
    # expanduser leaves "~" where there is no home: writing there fails, or stays in the present folder
    return Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")) / "railstate"


def remember(inputs: Any, design: Callable[[], dict[str, Any]]) -> Cached:
    """The value of `design()`, from disk where these inputs have been designed for before.

    inputs: anything JSON can write (arrays as lists: Python writes floats so that they come back bit for bit), which
    must include whatever changes the result. The value must be JSON values too. `Infeasible` is a result like any
    other: it is kept, and raised again. A folder that cannot be written costs the memory, not the design."""
    key = hashlib.sha256(json.dumps(inputs, sort_keys=True).encode()).hexdigest()
    path = folder() / f"{key}.json"
    known = _read(path)
    if known is None:
        entry: dict[str, Any] = {}
        try:
            entry["value"] = design()
        except Infeasible as reason:
            entry["infeasible"] = str(reason)
        _write(path, entry)
    else:
        entry = known
    if "infeasible" in entry:
        raise Infeasible(entry["infeasible"])
    return Cached(entry["value"], known is not None)


def _read(path: Path) -> dict[str, Any] | None:
    try:
        digest, text = path.read_bytes().split(b"\n")
    except (OSError, ValueError):
        return None
    return json.loads(text) if digest == hashlib.sha256(text).hexdigest().encode() else None


def _write(path: Path, entry: dict[str, Any]) -> None:
    text = json.dumps(entry).encode()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=".design-")
    except OSError:
        return
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(hashlib.sha256(text).hexdigest().encode() + b"\n" + text)
        os.replace(temporary, path)
    except OSError:
        Path(temporary).unlink(missing_ok=True)
