"""`railstate design` and `certify`, driven as a user would, on a short train."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import typer
from click.testing import Result
from railstate.benchmarks.commands.design import certify, design
from railstate.scenarios.errors import InputError
from typer.testing import CliRunner

app = typer.Typer()
app.command()(design)
app.command()(certify)
SHORT = ("--set", "plant.cars=2", "--set", "time.steps=5")


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Result]:
    monkeypatch.setenv("RAILSTATE_CACHE", str(tmp_path / "designs"))
    return lambda *words: CliRunner().invoke(app, [str(word) for word in words])


def test_designs_gains_and_certificates_agree(command: Callable[..., Result], tmp_path: Path) -> None:
    words = ("design", "cbtc-csma", *SHORT, "--delta", "4e4", "-e", "ultimate-bound,ultimate-bound-published")
    first, again = command(*words, "--out", tmp_path), command(*words)
    assert first.exit_code == again.exit_code == 0
    line = " ".join(row for row in first.output.splitlines() if row.split()[:1] == ["ultimate-bound"])
    assert {"CLARABEL", "optimal", "solver", "0.98"} <= set(line.split())
    assert "ultimate-bound-published not certified unsupported: the gain is 12 x 12" in " ".join(first.output.split())
    assert any("cache" in row.split() for row in again.output.splitlines() if row.split()[:1] == ["ultimate-bound"])
    assert np.loadtxt(tmp_path / "ultimate-bound.csv", delimiter=",").shape == (4, 4)
    put = command("certify", "cbtc-csma", *SHORT, "--delta", "4e4", "--gain", tmp_path / "ultimate-bound.csv")
    assert put.exit_code == 0
    scalar, free = (float(next(row for row in put.output.splitlines() if row.split()[:1] == [kind]).split()[n])
                    for kind, n in (("scalar", 3), ("free", 2)))
    assert scalar == pytest.approx(float(line.split()[1]), rel=1e-4)
    assert free < scalar


def test_what_has_no_certificate_says_so(command: Callable[..., Result], tmp_path: Path) -> None:
    found = command("design", "cbtc-csma", *SHORT, "--theta", "0.9", "-e", "ultimate-bound")
    assert found.exit_code == 0
    text = " ".join(found.output.split())
    assert "not certified infeasible: no certificate at theta = 0.9: the decay constraint (23)" in text
    found = command("design", "cbtc-csma/start-at-zero", *SHORT[:2], "--set", "time.steps=200", "-e",
                    "ultimate-bound,ultimate-bound-force-walk")
    text = " ".join(found.output.split())
    assert "ultimate-bound-force-walk not certified infeasible: no certificate at theta = 0.98" in text
    assert "start's error at 1 %" in text and "ultimate-bound-force-walk: for `railstate design`: with the" in text
    np.savetxt(tmp_path / "zero.csv", np.zeros((4, 4)), delimiter=",")
    put = command("certify", "cbtc-csma", *SHORT, "--gain", tmp_path / "zero.csv")
    assert put.exit_code == 1
    assert "(14) of Theorem 1 fails for this gain" in " ".join(put.output.split())
    np.savetxt(tmp_path / "zero.csv", np.zeros((4, 3)), delimiter=",")  # a plant without bounds
    put = command("certify", "braking-rate", "--gain", tmp_path / "zero.csv")
    said = " ".join(word for word in put.output.split() if word != "0.98")  # stands in its line, however wide
    assert put.exit_code == 1 and "an ultimate bound needs linear, bounds," in said


def test_trade_off_is_a_table_and_a_figure(command: Callable[..., Result], tmp_path: Path) -> None:
    found = command("design", "cbtc-csma", *SHORT, "--trade-off", "0.9,0.98,0.99", "--plot", tmp_path / "t.svg")
    assert found.exit_code == 0
    rows = {row.split()[0]: row.split()[1:] for row in found.output.splitlines() if row.strip().startswith("0.")}
    assert rows["0.9"][:2] == ["not", "certified"]
    assert all(float(rows[theta][0]) > 0 and rows[theta][1] == "optimal" for theta in ("0.98", "0.99"))
    assert (tmp_path / "t.svg").read_text().startswith("<?xml")


@pytest.mark.parametrize(("words", "message"), [
    (("design", "cbtc-csma", "--theta", "1.2"), "knowledge.theta"),
    (("design", "cbtc-csma", "--delta", "-1"), "knowledge.delta"),
    (("design", "cbtc-csma", "-e", "nobody"), "allowed: direct"),
    (("design", "cbtc-csma", *SHORT, "-e", "direct"), "anything to design"),
    (("design", "cbtc-csma", "--trade-off", "0.9,x"), "between 0 and 1"),
    (("design", "cbtc-csma", "--plot", "x.svg"), "--trade-off"),
    (("design", "rap-example-1", "--trade-off", "0.9"), "rap-example-1/corrected"),
    (("design", "cbtc-csma/nowhere"), "no variant"),
    (("certify", "cbtc-csma", *SHORT, "--gain", "zou2018_gain.csv"), "12 x 12, cbtc-csma/uniform needs 4 x 4"),
    (("certify", "cbtc-csma", *SHORT, "--gain", "nowhere.csv"), "no such file"),
])
def test_bad_input_is_one_message(command: Callable[..., Result], words: tuple[str, ...], message: str) -> None:
    found = command(*words)
    assert isinstance(found.exception, InputError)
    assert message in str(found.exception)
