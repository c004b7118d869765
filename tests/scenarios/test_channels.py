"""Channels of every setting: each kind against what theory says of it, bit for bit where it must be another kind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError
from railstate.scenarios.channels import Channel, Sent
from railstate.scenarios.files import load
from railstate.scenarios.model import Reception
from railstate.scenarios.randomness import Streams
from railstate.scenarios.schema import Empty


def channel(**table):
    return TypeAdapter(Channel).validate_python(table)


def streams(runs):
    return Streams(3, "network", "trial", range(runs))


def sent(steps, ny, runs, sd=1.0):
    y = streams(runs)("measurement").normal(steps, ny)
    return Sent(y, np.ones(y.shape, dtype=bool), np.full(ny, sd))


def carried(kind, readings):
    return kind.carry(streams(readings.y.shape[2]), readings)


def test_gilbert_elliott_mean_loss_spreads_as_the_chain_says():
    """s.d. of the mean loss over n steps: sqrt(l (1 - l)/n (1 + c)/(1 - c)), c = 1 - p(gb) - p(bg)."""
    steps, runs, p_gb, p_bg = 4000, 600, 0.0857142857, 0.2
    lost = ~carried(channel(kind="gilbert-elliott", p_good_bad=p_gb, p_bad_good=p_bg), sent(steps, 1, runs)).received
    mean, share, c = lost[:, 0].mean(axis=0), p_gb / (p_gb + p_bg), 1 - p_gb - p_bg
    sd = np.sqrt(share * (1 - share) / steps * (1 + c) / (1 - c))
    assert sd / np.sqrt(share * (1 - share) / steps) == pytest.approx(2.45, abs=0.005)
    assert abs(mean.mean() - share) < 4 * sd / np.sqrt(runs)
    assert mean.std(ddof=1) == pytest.approx(sd, rel=4 / np.sqrt(2 * runs))


def test_gilbert_elliott_of_equal_states_is_bernoulli_bit_for_bit():
    readings = sent(300, 2, 5)
    equal = channel(kind="gilbert-elliott", p_good_bad=0.3, p_bad_good=0.1, p_good=0.7, p_bad=0.7)
    np.testing.assert_array_equal(carried(equal, readings).received,
                                  carried(channel(kind="bernoulli", p=0.7), readings).received)
    assert equal.reception().p_low == pytest.approx(0.7) and equal.reception().p_high == pytest.approx(0.7)


@pytest.mark.parametrize("kind", [{"kind": "round-robin"}, {"kind": "try-once-discard"},
                                  {"kind": "random-access", "p": [1.0]}, {"kind": "markov-random-access", "stay": 0.5},
                                  {"kind": "delay", "steps": 0}, {"kind": "ideal", "silent": "hold"}])
def test_one_node_without_delay_is_the_ideal_channel(kind):
    readings = sent(40, 2, 3)
    nodes = {} if kind["kind"] in ("delay", "ideal") else {"nodes": [[0, 1]]}
    found = carried(channel(**kind, **nodes), readings)
    assert found.received.all()
    assert found.late is None or not found.late.any()
    np.testing.assert_array_equal(found.y, readings.y)


def test_round_robin_goes_round():
    found = carried(channel(kind="round-robin", nodes=[[0, 2], [1]]), sent(4, 3, 2)).received
    np.testing.assert_array_equal(found[:, :, 0], [[1, 0, 1], [0, 1, 0], [1, 0, 1], [0, 1, 0]])
    np.testing.assert_array_equal(found[..., 0], found[..., 1])


@pytest.mark.parametrize("share", [1.0, 0.6, 0.2])
def test_try_once_discard_against_a_scalar_loop(share):
    """The node of the greatest sum of (y - last sent)^2 / R of what is there; nodes never heard come first, in their
    order; nobody where nothing is there."""
    readings, nodes = sent(60, 4, 3), [[0, 2], [1], [3]]
    there = np.random.default_rng(1).random(readings.y.shape) < share
    there[0] = False
    sd = np.array([1.0, 0.3, 2.0, 0.7])
    found = channel(kind="try-once-discard", nodes=nodes).carry(streams(3), Sent(readings.y, there, sd))
    for run in range(3):
        last, heard = np.zeros(4), set()
        for k in range(60):
            y, is_there = readings.y[k, :, run], there[k, :, run]
            urgency = [-1.0 if not is_there[node].any() else np.inf if j not in heard else
                       sum((y[i] - last[i]) ** 2 / sd[i] ** 2 for i in node if is_there[i])
                       for j, node in enumerate(nodes)]
            chosen = int(np.argmax(urgency))
            sends = [] if max(urgency) < 0 else [i for i in sorted(nodes[chosen]) if is_there[i]]
            heard |= {chosen} if sends else set()
            last[sends] = y[sends]
            assert np.flatnonzero(found.received[k, :, run]).tolist() == sends


def test_try_once_discard_of_readings_that_stand_still() -> None:
    """Each node once, then the first, as no other is more urgent; nobody where nothing is there to be sent."""
    readings, there = np.ones((6, 3, 2)), np.ones((6, 3, 2), dtype=bool)
    there[4:, :, 1] = False
    found = channel(kind="try-once-discard", nodes=[[1], [0, 2]]).carry(streams(2), Sent(readings, there, np.ones(3)))
    first, second, none = [0, 1, 0], [1, 0, 1], [0, 0, 0]
    np.testing.assert_array_equal(found.received[:, :, 0], [first, second, first, first, first, first])
    np.testing.assert_array_equal(found.received[:, :, 1], [first, second, first, first, none, none])


def test_markov_random_access_stays_and_turns_as_it_says():
    chain = [[0.9, 0.1, 0.0], [0.2, 0.5, 0.3], [0.25, 0.25, 0.5]]
    steps, runs = 3000, 40
    found = carried(channel(kind="markov-random-access", transition=chain), sent(steps, 3, runs)).received
    assert (found.sum(axis=1) == 1).all()
    node = found.argmax(axis=1)
    for i in range(3):
        here = node[:-1] == i
        for j in range(3):
            share, count = (node[1:][here] == j).mean(), here.sum()
            assert abs(share - chain[i][j]) <= 4 * np.sqrt(chain[i][j] * (1 - chain[i][j]) / count)
    by_power = np.linalg.matrix_power(np.array(chain), 200)[0]
    assert channel(kind="markov-random-access", transition=chain, nodes=[[0], [1], [2]]).reception().p == pytest.approx(
        by_power)


@pytest.mark.parametrize(("given", "said"), [
    ({"transition": [[1.0, 0.0], [0.0, 1.0]]}, "no one stationary distribution"),
    ({"transition": [[0.5, 0.4], [0.5, 0.5]]}, "row 0 has 2 entries that sum to 0.9"),
    ({"transition": [[0.5, 0.5]]}, "must be square"), ({}, "needs either transition"),
    ({"transition": [[0.5, 0.5], [0.5, 0.5]], "stay": 0.5}, "needs either transition")])
def test_chains_of_access_that_are_none_are_refused(given, said):
    with pytest.raises(ValidationError, match=said):
        channel(kind="markov-random-access", **given)


@pytest.mark.parametrize("reorder", [True, False])
def test_delays_are_composed_with_a_loss(reorder):
    readings = sent(400, 2, 4)
    loss = {"kind": "gilbert-elliott", "p_good_bad": 0.1, "p_bad_good": 0.3}
    found = carried(channel(kind="delay", steps=[0, 5], reorder=reorder, loss=loss), readings)
    without = carried(channel(**loss), readings).received
    assert found.late is not None
    np.testing.assert_array_equal(found.received | (found.late > 0), without)
    assert set(np.unique(found.late[without])) == set(range(6))
    arrival = np.where(without[:, 0], np.arange(400)[:, None] + found.late[:, 0], -1)
    overtaken = any((np.diff(times[times >= 0]) < 0).any() for times in arrival.T)
    assert overtaken is reorder


def test_what_the_receiver_holds_is_the_newest_it_has():
    readings = sent(200, 2, 3)
    loss = {"kind": "bernoulli", "p": 0.5}
    plain = carried(channel(kind="delay", steps=[0, 3], loss=loss), readings)
    found = carried(channel(kind="delay", steps=[0, 3], loss=loss, silent="hold"), readings)
    assert found.late is None and plain.late is not None
    for run in range(3):
        newest = -1
        for k in range(200):
            for stamp in range(max(0, k - 3), k + 1):
                in_time = plain.received[stamp, 0, run] and stamp == k
                if in_time or (stamp < k and plain.late[stamp, 0, run] == k - stamp):
                    newest = max(newest, stamp)
            assert found.received[k, 0, run] == (newest >= 0)
            assert found.y[k, 0, run] == (readings.y[newest, 0, run] if newest >= 0 else 0.0)


@pytest.mark.parametrize("kind", ["round-robin", "try-once-discard", "random-access", "markov-random-access",
                                  "gilbert-elliott", "delay"])
def test_a_run_is_the_same_in_any_company(kind):
    more = {"random-access": {"p": [0.5, 0.5], "nodes": [[0], [1]]}, "markov-random-access": {"stay": 0.6},
            "gilbert-elliott": {"p_good_bad": 0.2, "p_bad_good": 0.5}, "delay": {"steps": [1, 3], "reorder": False}}
    chosen, together = channel(kind=kind, **more.get(kind, {})), sent(50, 2, 6)
    alone = Sent(together.y[..., 4:5], together.there[..., 4:5], together.sd)
    whole, part = chosen.carry(streams(6), together), chosen.carry(Streams(3, "network", "trial", [4]), alone)
    np.testing.assert_array_equal(whole.received[..., 4:5], part.received)
    if whole.late is not None and part.late is not None:
        np.testing.assert_array_equal(whole.late[..., 4:5], part.late)


@pytest.mark.parametrize(("kind", "setting"), [
    *((kind, name) for kind in ("round-robin", "try-once-discard", "gilbert-elliott", "delay")
      for name in ("ningbo-metro", "cbtc-csma", "braking-rate", "rap-example-1")),
    ("gilbert-elliott", "moving-block"), ("delay", "moving-block"), ("round-robin", "moving-block")])
def test_every_setting_takes_every_channel(kind, setting):
    more = {"gilbert-elliott": {"channel.p_good_bad": 0.2, "channel.p_bad_good": 0.5}}.get(kind, {})
    steps = {"time.steps": 30} if setting in ("cbtc-csma", "rap-example-1", "braking-rate") else {}
    found = load(setting, {"channel.kind": kind, **more, **steps})
    variant = next(name for name in found.variants if name not in found.unfit)
    world = found.setting(variant).world(Streams(1, setting, variant, range(2)))
    step = world.step(0, world.initial_mean)
    assert all(event.received.shape == event.y.shape for event in step.events)


def test_what_breaks_a_claim_says_so():
    for table in ({"kind": "try-once-discard"}, {"kind": "delay", "steps": 1}, {"kind": "bernoulli", "p": 0.5,
                                                                               "silent": "hold"}):
        assert channel(**table).reception().breaks
    for table in ({"kind": "ideal"}, {"kind": "delay", "steps": 0}, {"kind": "bernoulli", "p": 0.5},
                  {"kind": "gilbert-elliott", "p_good_bad": 0.1, "p_bad_good": 0.4}):
        assert not channel(**table).reception().breaks


def test_what_is_known_of_the_usual_channels():
    """The whole of it: an ideal channel delivers for certain, and nobody is late."""
    assert channel(kind="ideal").reception() == Reception(1.0, 1.0, (), (), None, "", "")
    assert channel(kind="bernoulli", p=0.7).reception() == Reception(0.7, 0.7)
    metro = load("ningbo-metro").setting("switching")
    assert metro.uncertified == {}
    metro.config = metro.config.model_copy(update={"channel": Empty()})  # a setting of somebody's without a channel
    assert metro.uncertified == {}
    assert set(load("ningbo-metro", {"channel": {"kind": "delay", "steps": 2}}).setting("switching").uncertified) == {
        "guarantee", "as-new"}


TURN, AFTER = "a node's turn is no independent draw", "who transmits depends on who did before"
CONTENT, LATE = "try-once-discard picks readings by their content, noise included", "packets come late"
OLD = "the receiver hands on old values as if they were fresh"


@pytest.mark.parametrize(("table", "known"), [
    ({"kind": "csma", "p": 0.25, "trains": [2, 4], "traffic": "uniform"}, (0.10546875, 0.1875, (), (), 0.15234375)),
    ({"kind": "csma", "p": 0.25, "trains": 3}, (0.140625, 0.140625, (), (), 0.120849609375)),
    ({"kind": "gilbert-elliott", "p_good_bad": 0.25, "p_bad_good": 0.5, "p_good": 0.75, "p_bad": 0.25}, (0.5, 0.625)),
    ({"kind": "random-access", "p": [0.25, 0.75], "nodes": [[0, 2], [1]]}, (0.25, 0.75, ((0, 2), (1,)), (0.25, 0.75))),
    ({"kind": "round-robin"}, (0.0, 1.0, (), (), None, TURN)), ({"kind": "round-robin", "nodes": [[0, 1]]}, ()),
    ({"kind": "round-robin", "nodes": [[1], [0, 2]]}, (0.0, 1.0, ((1,), (0, 2)), (0.5, 0.5), None, TURN)),
    ({"kind": "try-once-discard", "nodes": [[1], [0]]}, (0.0, 1.0, ((1,), (0,)), (0.5, 0.5), None, CONTENT, CONTENT)),
    ({"kind": "markov-random-access", "stay": 0.5}, (0.0, 1.0, (), (), None, AFTER)),
    ({"kind": "markov-random-access", "transition": [[0.75, 0.25], [0.5, 0.5]], "nodes": [[0], [1]]},
     (0.25, 0.75, ((0,), (1,)), (2 / 3, 1 / 3), None, AFTER)),
    ({"kind": "delay", "steps": [0, 1], "loss": {"kind": "random-access", "p": [0.25, 0.75], "nodes": [[0], [1]]}},
     (0.0, 0.75, ((0,), (1,)), (0.25, 0.75), None, LATE)),
    ({"kind": "delay", "steps": 0, "loss": {"kind": "csma", "p": 0.25, "trains": 3}},
     (0.140625, 0.140625, (), (), 0.120849609375)),
    ({"kind": "csma", "p": 0.25, "trains": 3, "silent": "hold"},
     (0.140625, 0.140625, (), (), 0.120849609375, OLD, OLD))])
def test_what_is_known_of_every_channel(table, known):
    found, wanted = channel(**table).reception(), Reception(*known)
    assert found.p == pytest.approx(wanted.p)
    assert replace(found, p=wanted.p) == wanted


@pytest.mark.parametrize(("table", "longest"), [
    ({"kind": "ideal"}, 0), ({"kind": "delay"}, 1), ({"kind": "delay", "steps": [2, 5]}, 5),
    ({"kind": "delay", "steps": 4, "silent": "hold"}, 0)])
def test_how_late_a_packet_can_be(table, longest):
    assert channel(**table).longest == longest


@pytest.mark.parametrize(("table", "said"), [
    ({"kind": "csma", "trains": [3, 3]}, 'traffic = "constant" needs a single number of trains, such as trains = 2'),
    ({"kind": "csma", "trains": [3, 3], "traffic": "uniform"}, ""),
    ({"kind": "csma", "trains": [4, 3], "traffic": "uniform"}, "trains = [least, most] needs least <= most"),
    ({"kind": "delay", "steps": [2, 2]}, ""), ({"kind": "delay", "steps": [3, 2]},
                                               "steps = [least, most] needs least <= most"),
    ({"kind": "round-robin", "nodes": [[0, 1], [1]]},
     "nodes share a measurement element: each element belongs to one node"),
    ({"kind": "random-access", "p": [0.5, 0.5], "nodes": [[0]]},
     "p has 2 probabilities for 1 nodes: one each is needed"),
    ({"kind": "random-access", "p": [0.5, 0.25], "nodes": [[0], [1]]}, "p must sum to 1, but sums to 0.75"),
    ({"kind": "random-access", "p": [0.5, 0.5 + 9e-10], "nodes": [[0], [1]]}, ""),
    ({"kind": "random-access", "p": [0.5, 0.5 + 1.1e-9], "nodes": [[0], [1]]},
     "p must sum to 1, but sums to 1.0000000011"),
    ({"kind": "markov-random-access", "transition": [[0.5, 0.5 + 9e-10], [0.5, 0.5]]}, ""),
    ({"kind": "markov-random-access", "transition": [[0.5, 0.5], [0.5 + 1.1e-9, 0.5]]},
     "transition must be square with rows that sum to 1; row 1 has 2 entries that sum to 1.0000000011"),
    ({"kind": "markov-random-access", "transition": [[0.0, 1.0], [1.0, 0.0]]}, ""),
    ({"kind": "markov-random-access"},
     "needs either transition (a row of probabilities a node) or stay (a probability)"),
    ({"kind": "markov-random-access", "transition": [[1.0], [0.5, 0.25]]},
     "transition must be square with rows that sum to 1; row 0 has 1 entries that sum to 1"),
    ({"kind": "markov-random-access", "transition": [[1.0, 0.0], [0.0, 1.0]]},
     "transition has nodes that never follow from others: no one stationary distribution")])
def test_tables_of_channels_that_are_none(table, said):
    if not said:
        channel(**table)
        return
    with pytest.raises(ValidationError) as caught:
        channel(**table)
    assert [error["msg"] for error in caught.value.errors()] == [f"Value error, {said}"]
