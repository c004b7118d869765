"""Speed side by side with named peers doing the same work, in one process, on one thread: `railstate timing`.

Ours are whole filter steps as the runner drives them; peers are bare loops of their own, as their users write them."""

from __future__ import annotations

from importlib import import_module

from ...scenarios.errors import InputError
from .measure import Row

COMPARISONS = {
    "metro": "2 states, filterpy's own loop with a plain Python model",
    "cars": "12 states with missing packets, filterpy and simdkalman",
    "robust": "batched fast form against the convex form (DPP-parametrised, Clarabel)",
    "particles": "braking rate, against a numpy loop over particles",
}
"""The comparisons, a module each, and what they are."""


def race(name: str, repeats: int) -> list[Row]:
    """The lines of one comparison, medians of so many repetitions. Raises InputError where a peer is not installed."""
    from threadpoolctl import threadpool_limits

    try:
        with threadpool_limits(1):
            return import_module(f".{name}", __name__).race(repeats)
    except ModuleNotFoundError as error:
        raise InputError(f"--only {name}: its peer {error.name} is not installed; pip install 'railstate[test]' has "
                         "all peers") from None
