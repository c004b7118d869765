"""Channels at the edges of their draws, of their nodes, and of the readings that there are: to the letter."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from railstate.scenarios.channels import Sent, gilbert_elliott
from railstate.scenarios.channels.gilbert_elliott import bursts

from .test_channels import carried, channel, sent, streams


class Drawn:
    """Draws one after the other, the same in both runs."""

    runs = (0, 1)

    def __init__(self, *values):
        self.values = list(values)

    def uniform(self, low, high, *shape):
        assert (low, high) == (0.0, 1.0)
        return np.repeat(np.array([self.values.pop(0) for _ in range(math.prod(shape))]).reshape(shape)[..., None], 2,
                         axis=-1)

    def integers(self, low, high, *shape):
        return np.full((*shape, 2), low)


LESS = 2**-53


def test_what_is_drawn_at_the_edges():
    """Each with just the probability it says: a draw lies in [0, 1), and one that is p is no arrival."""
    def first(draws, steps=0, **table):
        found = channel(**table).draw(Drawn(*draws), steps or len(draws), 2)
        assert found.shape == (steps or len(draws), 2, 2) and found.dtype == bool
        return found[:, 0, 0].tolist()

    assert first([1 - LESS], kind="bernoulli", p=1.0) == [True]
    assert first([0.5, 0.5 - LESS], kind="bernoulli", p=0.5) == [False, True]
    assert first([0.25, 0.25 - LESS], kind="csma", p=0.5, trains=2) == [False, True]
    assert first([0.140625, 0.140625 - LESS], kind="csma", p=0.25, trains=3) == [False, True]
    fresh = channel(kind="csma", trains=[2, 4], traffic="uniform").contending(Drawn(), 3)
    assert fresh.tolist() == [[2, 2]] * 3
    four = channel(kind="markov-random-access", stay=0.5)
    assert [four.chosen(Drawn(draw), 1, 4).tolist() for draw in (0.1, 0.3, 0.6, 0.9)] == [[[i, i]] for i in range(4)]
    moving = channel(kind="csma", trains=[2, 4], traffic="birth-death", rate=0.25)
    draws = [0.25, 0.25 - LESS, 0.75, 0.75 + LESS, 0.9, 0.0, 0.0, 0.0, 0.5]
    assert moving.contending(Drawn(*draws), 9)[:, 1].tolist() == [2, 3, 3, 2, 2, 3, 4, 4, 4]
    assert bursts(Drawn(0.25, 0.25, 0.25 - LESS, 0.75, 0.75 - LESS), 5, 0.25, 0.75)[:, 0].tolist() == [
        False, False, True, True, False]
    burst = {"kind": "gilbert-elliott", "p_good_bad": 0.5, "p_bad_good": 0.5, "p_good": 0.75, "p_bad": 0.25}
    for state, p in ((0.9, 0.75), (0.1, 0.25)):  # the states are drawn from a stream of their own beside it
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(gilbert_elliott, "beside", lambda random, name, state=state: Drawn(state))
            assert [first([draw], **burst) for draw in (p, p - LESS)] == [[False], [True]]
    nodes = [[0], [1]]
    assert first([0.25, 0.25 - LESS], kind="random-access", p=[0.25, 0.75], nodes=nodes) == [False, True]
    chain = [[0.25, 0.75], [0.5, 0.5]]
    assert first([0.1, 0.25, 0.5 - LESS, 0.25 - LESS, 0.3, 0.5], kind="markov-random-access", transition=chain,
                 nodes=nodes) == [True, False, True, True, False, False]
    assert channel(kind="markov-random-access", stay=0.25).chain(1).tolist() == [[1.0]]
    assert channel(kind="markov-random-access", stay=0.25).chain(4)[0].tolist() == [0.25] * 4
    late = channel(kind="delay", steps=2, loss={"kind": "bernoulli", "p": 0.5})
    assert late.draw(Drawn(0.5, 0.4), 2, 1)[:, 0, 0].tolist() == [False, True]
    with pytest.raises(NotImplementedError):
        channel(kind="try-once-discard").draw(Drawn(), 1, 1)


def test_who_carries_what_to_the_letter():
    """A node without a reading does not contend, nor does one of which only some readings are there send the rest."""
    y = np.array([[1.0, 5.0, 2.0], [1.0, 5.0, 9.0], [3.0, 5.0, 9.0], [3.0, 7.5, 9.0]])[..., None]
    there = np.array([[0, 1, 1], [1, 0, 0], [0, 0, 0], [1, 1, 1]], dtype=bool)[..., None]
    kind = channel(kind="try-once-discard", nodes=[[0], [1, 2]])
    found = kind.carry(streams(1), Sent(y, there, np.array([1.0, 2.0, 10.0])))
    assert found.received[..., 0].astype(int).tolist() == [[0, 1, 1], [1, 0, 0], [0, 0, 0], [1, 0, 0]]
    for table, ny, said in (
            ({"kind": "round-robin", "nodes": [[0], [2]]}, 2, "elements 0, 2, but there are 2: each element 0 .. 1"),
            ({"kind": "markov-random-access", "transition": [[1.0]]}, 2, "x.transition has 1 rows for 2 nodes"),
            ({"kind": "delay", "loss": {"kind": "round-robin", "nodes": [[1]]}}, 1, "x.loss.nodes list")):
        with pytest.raises(ValueError, match=re.escape(said)):
            channel(**table).check(ny, "x")
    for kind in ({"kind": "round-robin"}, {"kind": "random-access", "p": [0.5, 0.5]}, {"kind": "markov-random-access",
                                                                                       "stay": 0.5}):
        with pytest.raises(ValueError, match=r"^channel\.nodes list the measurement elements 0, 2, but there are 2: "):
            channel(**kind, nodes=[[0], [2]]).draw(streams(1)("channel"), 1, 2)
    with pytest.raises(ValueError, match=r"^channel\.nodes list the measurement elements 0, 2, but there are 2: "):
        carried(channel(kind="try-once-discard", nodes=[[0], [2]]), sent(1, 2, 1))
