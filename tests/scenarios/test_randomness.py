"""Random streams: a run's numbers depend on its names, its number and its own draws, and are what they claim to be."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
from railstate.scenarios import randomness
from railstate.scenarios.randomness import RunRandom, Streams
from scipy import stats


def draws(random: RunRandom, which=None):
    """Some of each kind, the runs last."""
    return np.concatenate([random.normal(3, 2).reshape(6, -1), random.uniform(-2.0, 5.0, 4), random.integers(3, 9, 2),
                           random.normal(5, which=which), random.uniform(0.0, 1.0)[None], random.normal()[None]])


def test_a_run_draws_the_same_in_any_batch():
    whole = draws(Streams(1, "s", "v", range(70))("truth"))
    for runs in ([3], [69, 2, 3], range(10, 50)):
        assert np.array_equal(draws(Streams(1, "s", "v", runs)("truth")), whole[:, list(runs)])


def test_runs_that_do_not_draw_stay_where_they_are():
    which = np.arange(40) % 3 == 0
    some, all_ = RunRandom(1, ("s", "v"), range(40)), RunRandom(1, ("s", "v"), range(40))
    first = some.normal(4, which=which)
    assert np.array_equal(first[:, which], all_.normal(4)[:, which]) and not first[:, ~which].any()
    assert np.array_equal(some.drawn, which)
    # what the others draw now, they would have drawn before
    assert np.array_equal(some.normal(4)[:, ~which], RunRandom(1, ("s", "v"), range(40)).normal(4)[:, ~which])


def test_streams_runs_draws_seeds_and_generators_share_no_number():
    parts = [RunRandom(seed, names, range(20)) for seed in (0, 1) for names in (("s", "v", "a"), ("s", "v", "b"),
                                                                             ("s", "va"), ("sv", "a"))]
    seen = [random.uniform(0.0, 1.0, 50) for random in parts for _ in range(2)]
    seen += [np.array([generator.random(50) for generator in random.generators]).T for random in parts]
    values = np.concatenate([part.ravel() for part in seen])
    assert len(np.unique(values)) == len(values)


def test_the_numbers_are_those_of_numpy_s_philox_in_their_place():
    random = RunRandom(1, ("s", "v"), [5])
    random.normal(3)
    second = np.random.Generator(np.random.Philox(key=random._key, counter=[0, 1, 5, 0]))
    assert np.array_equal(random.uniform(0.0, 1.0, 9)[:, 0], second.random(9))


@pytest.mark.parametrize("count", [1, 4, 7, 64])
def test_many_runs_draw_the_same_uniform_numbers_in_compiled_code(count, monkeypatch):
    found = []
    for many in (19, 20):
        monkeypatch.setattr(randomness, "MANY", many)
        random = RunRandom(7, ("s", "v"), [*range(3, 21), 2**40])
        which = np.arange(19) % 4 != 1
        found.append([random.uniform(-2.0, 5.0, count), random.uniform(0.0, 1.0, count, which=which),
                      random.uniform(0.5, 0.7, count, 2), random.normal(), random.drawn])
    for compiled, numpy_s in zip(*found, strict=True):
        assert np.array_equal(compiled, numpy_s)


@pytest.mark.parametrize("across", ["runs", "draws", "one-draw"])
def test_distributions(across):
    """Along each of the three ways in which a number's place may differ from the next one's."""
    n = 20_000
    random = RunRandom(3, ("s", "v"), range(n if across == "runs" else 1))
    times = n if across == "draws" else 1
    shape = (n,) if across == "one-draw" else ()
    normal, uniform, whole = (np.concatenate([draw().ravel() for _ in range(times)]) for draw in (
        lambda: random.normal(*shape), lambda: random.uniform(-1., 3., *shape), lambda: random.integers(2, 5, *shape)))
    assert stats.kstest(normal, "norm").pvalue > 1e-3
    assert stats.kstest(uniform, stats.uniform(-1, 4).cdf).pvalue > 1e-3
    assert stats.chisquare(np.bincount(whole, minlength=6)[2:]).pvalue > 1e-3
    for values in (normal, uniform):
        assert abs(np.corrcoef(values[:-1], values[1:])[0, 1]) < 4 / n**0.5


def test_copies_go_on_where_the_original_stands():
    random = RunRandom(1, ("s", "v"), range(4))
    random.normal(2)
    random.generators[1].random(3)
    copies = copy.deepcopy(random), pickle.loads(pickle.dumps(random))
    expected = draws(random), random.generators[1].random(3)
    for other in copies:
        assert np.array_equal(draws(other), expected[0]) and np.array_equal(other.generators[1].random(3), expected[1])
