"""Stopping: rows of a fixed run, reasons told and kept, intervals that cover after it, nobody accused among equals."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from railstate.benchmarks.judging import statistics as st
from railstate.benchmarks.judging.family import Draws, compare_all
from railstate.benchmarks.judging.stopping import rule
from railstate.benchmarks.judging.table import verdicts_of
from railstate.benchmarks.store.folder import Store

from ..conftest import Command
from .test_judging_rates import lognormal
from .test_run import rows, same

ONE = ("run", "rap-example-2/printed", "-e", "random-access-conditional", "--jobs", 1)
TWO = ("run", "rap-example-1/corrected", "--jobs", 1)


def told(folder: str) -> dict[str, object]:
    manifest = json.loads(Path(folder, "manifest.json").read_text())
    return next(iter(next(iter(manifest["scenarios"].values()))["variants"].values()))


def test_until_a_precision(railstate: Command) -> None:
    words = (*ONE, "--runs", 300, "--until", "rmse:x1=1.9%", "--out", "narrow")
    done = railstate(*words)
    assert done.code == 0 and "Stopped after 100 runs: every half interval is within 1.9 % of rmse:x1" in done.out
    assert told("narrow")["until"] in " ".join(done.out.split()) and told("narrow")["level"] == 0.05
    railstate(*ONE, "--runs", 100, "--out", "fixed")
    same(rows("narrow"), rows("fixed"))
    line = verdicts_of(Store("narrow")).query("kind == 'error' and quantity == 'x1'").iloc[0]
    assert (line["high"] - line["low"]) / 2 <= 0.019 * line["value"]
    half = verdicts_of(Store("narrow")).query("kind == 'error'")["runs"].iloc[0]
    assert half == 100 and "Stopped after 100 runs" in Path("narrow/tables/rap-example-2~printed.md").read_text()
    before = Path("narrow/manifest.json").read_text()
    assert railstate(*words).code == 0 and Path("narrow/manifest.json").read_text() == before
    grown = railstate(*ONE, "--runs", 120, "--out", "narrow")  # goes on from there: it did not stop at 100
    assert grown.code == 0 and len(rows("narrow")) == 120 and not told("narrow").get("until")


def test_until_decided_shares_the_level(railstate: Command) -> None:
    done = railstate(*TWO, "--runs", 200, "--until", "decided", "--out", "out")
    assert done.code == 0, done.err
    facts = told("out")
    stopped = int(str(facts["until"]).split()[2])
    assert facts["level"] == 0.025 and "intervals of ratios cover 97.5 %" in str(facts["until"])
    assert stopped in (100, 200) and len(rows("out")) == 2 * stopped
    open_ = verdicts_of(Store("out")).query("kind == 'error' and verdict == 'undecided'")
    assert open_.empty == ("decided (" in str(facts["until"]))
    assert (open_["deciding"] > 0).all()
    railstate(*TWO, "--runs", stopped, "--out", "fixed")
    same(rows("out"), rows("fixed"))
    wide, plain = (verdicts_of(Store(folder)).query("kind == 'error' and verdict != 'best'") for folder in (
        "out", "fixed"))
    gaps = [(frame["ratio_high"] / frame["ratio_low"]).to_numpy() for frame in (wide, plain)]
    assert (gaps[0] > gaps[1]).all()


def test_the_most_allowed_and_cells_for_themselves(railstate: Command) -> None:
    done = railstate("run", "rap-example-2", "-e", "random-access-conditional", "--jobs", 1, "--runs", 60, "--until",
                     "rmse:x1=2.2%", "--out", "out")
    assert done.code == 0
    found = rows("out").groupby("variant").size().to_dict()
    variants = json.loads(Path("out/manifest.json").read_text())["scenarios"]["rap-example-2"]["variants"]
    for variant, runs in found.items():
        assert runs in (50, 60) and f"after {runs} runs" in variants[variant]["until"]
    assert found["printed"] == 50 and "most allowed: random-access-conditional has rmse x1" in variants["corrected"][
        "until"]


@pytest.mark.parametrize(("text", "said"), [
    ("soon", "expected decided"), ("rmse:x1", "expected decided"), ("rmse:x1=0%", "expected decided"),
    ("rmse:x1=-1", "expected decided"), ("rmse:x9=1%", "rmse:x9: is not measured in rap-example-2/printed; allowed:")])
def test_bad_words(railstate: Command, text: str, said: str) -> None:
    done = railstate(*ONE, "--runs", 4, "--until", text, "--out", "out")
    assert done.code == 2 and said in done.err and "Traceback" not in done.err


def test_looks() -> None:
    assert rule("decided", 1600).looks == [100, 200, 400, 800, 1600] and rule("decided", 1600).level == 0.01
    assert rule("rmse:x=1%", 300).looks == [50, 100, 200, 300] and rule("rmse:x=1%", 300).level == 0.05
    assert rule("rmse:x=0.2, mae:y=3%", 20).looks == [20]


def covered(draw: str, asked: float, most: int = 800, studies: int = 6000) -> float:
    """Share of studies whose interval of the RMSE holds the truth when it is narrow enough, or at the most."""
    rng = np.random.default_rng(list(draw.encode()))
    m = rng.chisquare(2, (studies, most)) / 2 if draw == "chi2" else np.exp(
        0.5 * rng.standard_normal((studies, most)) - 0.125)
    waiting, hits = np.ones(studies, dtype=bool), 0
    for look in rule(f"rmse:x={asked}%", most).looks:
        found = st.rooted(st.hall(m[waiting, :look], positive=True))
        done = ((found.high - found.low) / 2 <= asked / 100 * found.value) | (look == most)
        hits += int(((found.low <= 1) & (found.high >= 1))[done].sum())
        waiting[np.flatnonzero(waiting)[done]] = False
    assert not waiting.any()
    return hits / studies


@pytest.mark.parametrize("draw", ["chi2", "ln.5"])
@pytest.mark.parametrize("asked", [4.5, 9.0])
def test_intervals_cover_after_stopping_on_their_width(draw: str, asked: float) -> None:
    """95 +- 1.3 %, over so many studies that chance makes up .6 % of it."""
    assert abs(covered(draw, asked) - 0.95) <= 0.013


def accused(k: int, sigma: float, most: int, studies: int) -> float:
    """Share of studies of equals in which somebody is worse than the best where it stops, or at the most."""
    asked, rng, hits = rule("decided", most), np.random.default_rng([k, most]), 0
    draws = {look: Draws(f"equals {k}", look, asked.level) for look in asked.looks}
    for _ in range(studies):
        m = lognormal(sigma)(rng, k, most)
        for look in asked.looks:
            found = compare_all(m[:, :look], draws[look], 0.5)
            best = int(np.argmin(found.value))
            words = {found.verdict(i, best) for i in range(k) if i != best} - {"better"}
            if "undecided" not in words or look == most:
                hits += "worse" in words
                break
    return hits / studies


@pytest.mark.long
@pytest.mark.parametrize(("k", "sigma", "most", "studies"), [
    (2, 0.5, 400, 2000), (12, 0.5, 400, 500), (12, 1.0, 200, 500)])
def test_equals_until_decided(k: int, sigma: float, most: int, studies: int) -> None:
    """At most 5 % of the studies."""
    assert accused(k, sigma, most, studies) <= 0.05


@pytest.mark.long
@pytest.mark.parametrize("labels", ["ekf-tuned,robust-mean-square", ""])
def test_switching_reaches_one_per_cent_of_position(railstate: Command, labels: str) -> None:
    """By 1,600 runs, with two estimators and with all of the table."""
    done = railstate("run", "ningbo-metro/switching", *(["-e", labels] if labels else []), "--runs", 3200, "--until",
                     "rmse:position=1%", "--out", "out", "--quiet")
    assert done.code == 0 and "every half interval is within" in str(told("out")["until"])
    assert int(str(told("out")["until"]).split()[2]) <= 1600
