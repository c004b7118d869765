"""Random streams keyed by names, one per run, so that run 17 is run 17 in any batch, order or process.

Every random number of the suite comes from here: there is no global generator."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .arrays import Array, Mask

MANY = 1000  # from so many runs on compiled code draws uniform numbers, to the same bits
BLOCK = 16  # runs drawn before they are laid out along the last axis: what is scattered stays in the cache


class RunRandom:
    """One named stream of each run of a batch. All draws carry the runs as their last axis.

    Draws of run s depend on (seed, names, run number s) and on how many draws of it there were before, never on the
    other runs. The numbers are those of Philox (Salmon et al., SC 2011), a generator without history: seed and names
    give its key, run and number of the draw the place where counting starts. One generator so serves all runs.

    drawn (S,): draws of each run so far, which is all the state there is."""

    def __init__(self, seed: int, names: tuple[str, ...], runs: Sequence[int]) -> None:
        self.seed = seed
        self.names = names
        self.runs = tuple(int(run) for run in runs)
        self.drawn = np.zeros(len(self.runs), dtype=np.int64)
        self._generators: list[np.random.Generator] | None = None
        text = "\0".join([str(seed), *names])
        self._key: list[int] = np.frombuffer(hashlib.sha256(text.encode()).digest()[:16], dtype=np.uint64).tolist()
        self._source: np.random.Generator | None = None

    @property
    def generators(self) -> list[np.random.Generator]:
        """A NumPy generator per run, in the order of `runs`, for code that brings its own way of drawing. They share no
        number with `normal`, `uniform` and `integers`."""
        if self._generators is None:
            self._generators = [np.random.Generator(np.random.Philox(key=self._key, counter=[0, 0, run, 1]))
                                for run in self.runs]
        return self._generators

    def counted(self, which: Mask | None = None) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
        """The key and the places (S,) that compiled code draws at by itself (`normals`): the number of each run and of
        this draw of it. which (S,): runs that draw. These share no number with those of the other ways."""
        place = self.drawn.copy()
        self.drawn += 1 if which is None else which
        key = np.array([self._key[0] & 0xFFFFFFFF, self._key[0] >> 32], dtype=np.uint64)
        return key, np.array(self.runs, dtype=np.int64), place  # pyright: ignore[reportReturnType]

    def normal(self, *shape: int, which: Mask | None = None) -> Array:
        """Standard normal draws, shape (*shape, S). which (S,): runs that draw; the others get 0, drawing nothing."""
        return self._fill(shape, which, np.random.Generator.standard_normal)

    def uniform(self, low: float, high: float, *shape: int, which: Mask | None = None) -> Array:
        """Uniform draws in [low, high), shape (*shape, S). which (S,): as in `normal`."""
        if len(self.runs) >= MANY:
            from .philox import uniform  # here: few runs are not worth its compilation

            out = (np.empty if which is None else np.zeros)((math.prod(shape), len(self.runs)))
            uniform(np.array(self._key, dtype=np.uint64), np.where(True if which is None else which, self.drawn, -1),
                    np.array(self.runs), low, high - low, out)
            self.drawn += 1 if which is None else which
            return out.reshape(*shape, len(self.runs))

        def fill(source: np.random.Generator, out: Array) -> None:
            source.random(out=out)
            out *= high - low
            out += low

        return self._fill(shape, which, fill)

    def integers(self, low: int, high: int, *shape: int) -> NDArray[np.int64]:
        """Integer draws in low..high, both included, shape (*shape, S)."""
        def fill(source: np.random.Generator, out: NDArray[np.int64]) -> None:
            out[:] = source.integers(low, high, len(out), endpoint=True)

        return self._fill(shape, None, fill, np.int64)

    def _fill(self, shape: tuple[int, ...], which: Mask | None, fill: Callable[..., Any],
              dtype: type = np.float64) -> NDArray[Any]:
        """Draws of each run (of `which`), shape (*shape, S): `fill(source, out=row)` fills a run's row."""
        if self._source is None:
            self._source = np.random.Generator(np.random.Philox(key=self._key))
        source, runs = self._source, len(self.runs)
        philox, counter = source.bit_generator, [0, 0, 0, 0]
        state = {"bit_generator": "Philox", "state": {"counter": counter, "key": self._key}, "buffer": [0] * 4,
                 "buffer_pos": 4, "has_uint32": 0, "uinteger": 0}
        drawn = self.drawn.tolist()
        out = np.zeros((math.prod(shape), runs), dtype)
        rows = np.zeros((min(BLOCK, runs), len(out)), dtype)
        for first in range(0, runs, BLOCK):
            block = rows[:runs - first]
            for place, row in enumerate(block, first):
                if which is None or which[place]:
                    counter[1], counter[2] = drawn[place], self.runs[place]
                    philox.state = state
                    fill(source, out=row)
                else:
                    row[:] = 0
            out[:, first:first + BLOCK] = block.T
        self.drawn += 1 if which is None else which
        return out.reshape(*shape, runs)


class Streams:
    """The streams of a batch of runs of one scenario variant: `streams("truth")`, `("measurement")`, `("channel")`, ..

    Estimator streams are `streams("estimator", label)`: adding or removing an estimator moves no other stream."""

    def __init__(self, seed: int, scenario: str, variant: str, runs: Sequence[int]) -> None:
        self.seed, self.scenario, self.variant = seed, scenario, variant
        self.runs = tuple(int(run) for run in runs)

    def __call__(self, *names: str) -> RunRandom:
        return RunRandom(self.seed, (self.scenario, self.variant, *names), self.runs)
