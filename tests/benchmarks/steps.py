"""Steps of a drive as scores take them up: some at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from railstate.benchmarks.scoring.stretch import Stretch
from railstate.estimators.interface import Estimate
from railstate.scenarios.world import Step


def stretches(steps: Sequence[tuple[Estimate, Step]], counts: Sequence[int]) -> Iterator[Stretch]:
    """All steps, so many at a time; whoever gets them looks before the next are made."""
    estimate, step = steps[0]
    kept = Stretch(step.truth.shape[1], len(estimate.mean))
    kept.renew(estimate, step)
    first = 0
    for count in counts:
        kept.count = 0
        for k in range(first, min(first + count, len(steps))):
            assert kept.take(k, *steps[k])
        yield kept
        first += count
    assert first >= len(steps)
