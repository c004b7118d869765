"""`railstate table`: one table over settings, each value and sign the verdict table's; LaTeX that compiles silently."""

from __future__ import annotations

import csv
import io
import re
import shutil
import subprocess
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from railstate.benchmarks.commands.table import table
from railstate.benchmarks.judging.table import verdicts_of
from railstate.benchmarks.store.folder import Store
from railstate.benchmarks.telling import over_settings
from railstate.scenarios.errors import InputError

from ..synthetic_results import write_results


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_results(tmp_path_factory.mktemp("table") / "run", keep=False)


def printed(capsys: pytest.CaptureFixture[str], folder: Path, **words: str) -> str:
    table(str(folder), **words)
    return capsys.readouterr().out


def test_values_signs_and_bold_are_the_verdicts(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = printed(capsys, folder, scenarios="ningbo-metro", estimators="ekf,ukf,ekf-naive", quantities="position")
    errors = verdicts_of(Store(folder)).query("kind == 'error' and quantity == 'position'").set_index(
        ["variant", "estimator"])
    rows = {row.split(" & ")[0]: row.removesuffix(r" \\").split(" & ")[1:] for row in text.splitlines()
            if row.startswith(("switching", "white", "constant"))}
    assert set(rows) == {"switching", "white", "constant"}
    ratios: dict[str, list[float]] = {}
    for variant, cells in rows.items():
        for label, cell in zip(("ekf", "ukf", "ekf-naive"), cells, strict=True):
            line = errors.loc[variant, label]
            assert float(re.search(r"\d+\.\d+", cell)[0]) == pytest.approx(line["value"], abs=6e-4)  # type: ignore[index]
            assert (r"\textbf" in cell) == (line["verdict"] in ("best", "tie"))
            assert (r"$^{=}$" in cell) == (line["verdict"] == "tie") and r"$^{?}$" not in cell
            ratios.setdefault(label, []).append(line["ratio"])
    means = next(row for row in text.splitlines() if "ratio to best" in row).removesuffix(r" \\").split(" & ")[1:]
    assert [float(mean) for mean in means] == pytest.approx(
        [np.exp(np.log(ratios[label]).mean()) for label in ("ekf", "ukf", "ekf-naive")], abs=0.006)
    assert r"\label{tab:ningbo-metro}" in text and "24 paired runs" in text and "all 6 entries" in text
    assert "undecided" not in text and "Italic" not in text  # signs that do not appear are not explained


def test_csv_md_and_html(folder: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    frame = pd.read_csv(io.StringIO(printed(capsys, folder, scenarios="cbtc-csma", format_="csv")))
    assert len(frame) == 2 * 3 * 4 and set(frame["verdict"]) == {"best", "worse", "lost"}
    line = verdicts_of(Store(folder)).query("variant == 'uniform' and kind == 'error' and quantity == 'position' and "
                                            "estimator == 'ultimate-bound'").iloc[0]
    mine = frame.query("variant == 'uniform' and quantity == 'position' and entry == 'ultimate-bound'").iloc[0]
    assert mine["ratio"] == pytest.approx(line["ratio"], rel=1e-8)
    text = printed(capsys, folder, scenarios="cbtc-csma/table3", quantities="position", format_="md")
    assert "*0/24*" in text and "Italic: runs that finished" in text and "ratio to best" not in text
    table(str(folder), scenarios="cbtc-csma", format_="html", out=str(tmp_path / "t.html"))
    html = (tmp_path / "t.html").read_text()
    assert html.count("<tbody>") == html.count("</tbody>") == 3 and "<i>0/24</i>" in html


@pytest.mark.parametrize(("words", "message"), [
    ({"scenarios": "nowhere"}, r"--scenarios nowhere: not in this folder; allowed: ningbo-metro, "),
    ({"estimators": "nobody"}, "--estimators nobody"), ({"quantities": "smell"}, "--quantities smell"),
    ({"format_": "doc"}, "--format doc: unknown; allowed: tex, md, csv, html")])
def test_what_is_not_there_is_said(folder: Path, words: dict[str, str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        table(str(folder), **words)


def test_all_settings_in_one_table(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = printed(capsys, folder, format_="csv")
    assert {(row["scenario"], row["variant"]) for row in csv.DictReader(io.StringIO(text))} == {
        ("ningbo-metro", v) for v in ("switching", "white", "constant")} | {
        ("cbtc-csma", "uniform"), ("cbtc-csma", "table3"), ("braking-rate", "paper")}


@pytest.mark.skipif(not shutil.which("pdflatex"), reason="no pdflatex on this machine (Debian: apt install "
                                                         "texlive-latex-recommended)")
def test_latex_compiles_without_a_warning(folder: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    parts = [printed(capsys, folder, scenarios=name) for name in ("ningbo-metro", "cbtc-csma", "braking-rate", "")]
    parts[-1] = parts[-1].replace("tab:", "tab:all-")
    (tmp_path / "t.tex").write_text("\n".join([
        r"\documentclass{article}", r"\usepackage{booktabs}", r"\begin{document}", "\n\\clearpage\n".join(parts),
        r"\end{document}"]))
    for _ in range(2):  # labels are known the second time
        done = subprocess.run(["pdflatex", "-interaction=nonstopmode", "t.tex"], cwd=tmp_path, capture_output=True)
    log = (tmp_path / "t.log").read_text(errors="replace")
    assert done.returncode == 0, log[-2000:]
    assert not re.findall(r".*(?:[Ww]arning|Overfull|Underfull).*", log)


def test_one_table_of_twelve_settings_is_no_scenario_s(monkeypatch: pytest.MonkeyPatch, folder: Path, tmp_path: Path,
                                                       capsys: pytest.CaptureFixture[str]) -> None:
    """Up to eleven, scenarios' names are in the label, each once; a file is as what is printed, and named."""
    monkeypatch.setattr("railstate.benchmarks.commands.table.verdicts_of", lambda store: pd.DataFrame())
    monkeypatch.setattr("railstate.benchmarks.telling.rankings.cells_of", lambda table, manifest: [])
    for count, name in ((1, "s0"), (11, "s0-s1-s2"), (12, "settings"), (13, "settings")):
        cells = [SimpleNamespace(scenario=f"s{k % 3}") for k in range(count)]
        monkeypatch.setattr(over_settings, "grid", lambda *given, cells=cells: SimpleNamespace(cells=cells))
        monkeypatch.setitem(over_settings.WRITERS, "md", lambda made, name: f"{len(made.cells)} {name} å\n")
        assert printed(capsys, folder, format_="md") == f"{count} {name} å\n"
        assert printed(capsys, folder, format_="md", out=str(tmp_path / "t.md")) == f"{tmp_path / 't.md'}\n"
        assert (tmp_path / "t.md").read_text(encoding="utf-8") == f"{count} {name} å\n"
    with pytest.raises(InputError) as caught:
        table(str(folder), format_="md", out=str(tmp_path / "no" / "t.md"))
    assert str(caught.value) == f"--out {tmp_path / 'no' / 't.md'}: cannot be written: No such file or directory"
