"""Speed side by side with named peers doing the same work, on one thread: `railstate timing`.

Ours are whole filter steps as the runner drives them; peers are bare loops of their own, as their users write them; the
limit of a filter is a compiled loop written by hand for its one model."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from importlib import import_module
from multiprocessing import get_context

from ...scenarios.errors import InputError
from . import cluster
from .measure import Line, Row

COMPARISONS = {
    "metro": "2 states, filterpy's own loop with a plain Python model, and loops written by hand",
    "cars": "4 and 12 states with missing packets, filterpy, simdkalman, and loops written by hand",
    "robust": "batched fast form against the convex form (DPP-parametrised, Clarabel)",
    "particles": "braking rate, against a numpy loop over particles",
    "cluster": "a local Dask cluster of one and of two workers against this process, by runs a task",
}
"""The comparisons, a module each, and what they are."""


def race(name: str, repeats: int, processes: int = 1) -> list[Row]:
    """The lines of one comparison: minimums of so many repetitions in each of so many processes, one after the other,
    whose memory happens to lie better or worse; with 1 in this one. Raises InputError where a peer is not installed."""
    try:
        if processes == 1:
            return [line.row for line in _lines(name, repeats)]
        found = []
        for _ in range(processes):
            with ProcessPoolExecutor(1, get_context("spawn")) as fresh:
                found.append(fresh.submit(_lines, name, repeats).result())
        return [lines[0].least(lines).row for lines in zip(*found, strict=True)]
    except ModuleNotFoundError as error:
        raise InputError(f"--only {name}: its peer {error.name} is not installed; pip install 'railstate[test]' has "
                         "all peers") from None


def _lines(name: str, repeats: int) -> Sequence[Line | cluster.Line]:
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        return import_module(f".{name}", __name__).race(repeats)
