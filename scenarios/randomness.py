"""Random streams keyed by names, one generator per run, so that run 17 is run 17 in any batch, order or process.

Every random number of the suite comes from here: there is no global generator."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .arrays import Array, Mask


def generator(seed: int, *names: str | int) -> np.random.Generator:
    """The generator of one stream: `seed` and `names` (scenario, variant, run, stream, ..) hashed, order-free."""
    digest = hashlib.sha256("\0".join(str(name) for name in names).encode()).digest()
    words = np.frombuffer(digest, dtype=np.uint32)
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, *words.tolist()])))


class RunRandom:
    """One named stream of each run of a batch. All draws carry the runs as their last axis.

    Draws of run s depend on (seed, names, run number s) and on what was drawn before, never on the other runs.
    The generators are made at the first draw, so an estimator that draws nothing costs nothing."""

    def __init__(self, seed: int, names: tuple[str, ...], runs: Sequence[int]) -> None:
        self.seed = seed
        self.names = names
        self.runs = tuple(int(run) for run in runs)
        self._generators: list[np.random.Generator] | None = None

    @property
    def generators(self) -> list[np.random.Generator]:
        """One generator per run, in the order of `runs`."""
        if self._generators is None:
            scenario, variant, *rest = self.names
            self._generators = [generator(self.seed, scenario, variant, run, *rest) for run in self.runs]
        return self._generators

    def normal(self, *shape: int, which: Mask | None = None) -> Array:
        """Standard normal draws, shape (*shape, S). which (S,): runs that draw; the others get 0, drawing nothing."""
        out = np.zeros((*shape, len(self.runs)))
        for run, gen in enumerate(self.generators):
            if which is None or which[run]:
                out[..., run] = gen.standard_normal(shape)
        return out

    def uniform(self, low: float, high: float, *shape: int, which: Mask | None = None) -> Array:
        """Uniform draws in [low, high), shape (*shape, S). which (S,): as in `normal`."""
        out = np.zeros((*shape, len(self.runs)))
        for run, gen in enumerate(self.generators):
            if which is None or which[run]:
                out[..., run] = gen.uniform(low, high, shape)
        return out

    def integers(self, low: int, high: int, *shape: int) -> NDArray[np.int64]:
        """Integer draws in low..high, both included, shape (*shape, S)."""
        out = np.empty((*shape, len(self.runs)), dtype=np.int64)
        for run, gen in enumerate(self.generators):
            out[..., run] = gen.integers(low, high, shape, endpoint=True)
        return out


class Streams:
    """The streams of a batch of runs of one scenario variant: `streams("truth")`, `("measurement")`, `("channel")`, ..

    Estimator streams are `streams("estimator", label)`: adding or removing an estimator moves no other stream."""

    def __init__(self, seed: int, scenario: str, variant: str, runs: Sequence[int]) -> None:
        self.seed, self.scenario, self.variant = seed, scenario, variant
        self.runs = tuple(int(run) for run in runs)

    def __call__(self, *names: str) -> RunRandom:
        return RunRandom(self.seed, (self.scenario, self.variant, *names), self.runs)
