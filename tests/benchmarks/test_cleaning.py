"""What strangers wrote does no harm: on a terminal, in Markdown, LaTeX, CSV and HTML, each cleaned in one place."""

from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path

import pandas as pd
import pytest
from railstate.benchmarks.telling import cleaning
from railstate.benchmarks.telling.markup import to_latex, to_markdown

from ..conftest import SCENARIO, Command

EVIL = "a\x1b[31mred\x1b]8;;http://x\x07 \x9b2J \u202etxt <script>alert(1)</script> [me](javascript:x) | # 1\n# head"
STEERING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


@pytest.mark.parametrize(("text", "tex"), [
    ("Schützer", r"Sch\"{u}tzer"), ("Řehoř Ångström", r"\v{R}eho\v{r} \r{A}ngstr\"{o}m"),
    ("Müßig & Søn", r"M\"{u}\ss{}ig \& S\o{}n"),
    ("σ ± 3 µm", r"$\sigma$ $\pm$ 3 $\mu$m"), ("10⁻³", "10$^{-3}$"), ("中", "[U+4E2D]"),
    ("a\x07b\x1b", r"a\textbackslash{}x07b\textbackslash{}x1b"),
    (r"\input{x}$^", r"\textbackslash{}input\{x\}\$\^{}"), ("✓", "?"),
])
def test_latex_keeps_letters_and_no_command(text: str, tex: str) -> None:
    assert cleaning.latex(text) == tex


def test_markdown_keeps_its_cells_and_heads() -> None:
    text = to_markdown(EVIL, pd.DataFrame({EVIL: [EVIL, "a < b [84, 99] %"]}), [EVIL])
    lines = text.splitlines()
    assert len(lines) == 8 and lines[5] == "| a < b [84, 99] % |"
    assert all(len(re.findall(r"(?<!\\)\|", line)) == 2 for line in lines[2:6])
    assert "<script" not in text and "](" not in text and not STEERING.search(text)
    assert not STEERING.search(to_latex(EVIL, pd.DataFrame({"x": [EVIL]}), [EVIL]))


def test_csv_holds_no_formula_and_the_same_numbers() -> None:
    frame = pd.DataFrame({"label": ["=cmd()", "+1", "-x", "@a", "ekf"],
                          "value": [-1.5, 0.1 + 0.2, 1e-300, float("nan"), 2],
                          "mixed": [-3, "-3", True, None, "-"]})
    text = cleaning.csv(frame)
    read = list(csv.DictReader(io.StringIO(text)))
    assert text.splitlines()[:2] == ["label,value,mixed", "'=cmd(),-1.5,-3"]
    assert [row["label"] for row in read] == ["'=cmd()", "+1", "'-x", "'@a", "ekf"]
    plain = list(csv.DictReader(io.StringIO(frame.to_csv(index=False))))
    assert [row["value"] for row in read] == [row["value"] for row in plain]
    assert [row["mixed"] for row in read] == ["-3", "-3", "True", "", "-"]  # a dash alone computes nothing


def test_nothing_steers_any_output(railstate: Command) -> None:
    quoted = json.dumps(EVIL.replace("\n", "\\n"), ensure_ascii=True).replace("\\\\n", "\\n")
    text = SCENARIO.replace('title = "a cart on a line, for tests"',
                            f"title = {quoted}\nnotes = [{quoted}]\nsource = {quoted}")
    text = text.replace('title = "calm"', f"title = {quoted}")
    Path("cart.toml").write_text(text)
    Path("half.py").write_text(Path("half.py").read_text().replace(
        'raise ArithmeticError("run 3 is not for me")',
        f"import warnings; warnings.warn({EVIL!r}); raise ValueError({EVIL!r})"))
    words = ("run", "cart.toml/calm", "--estimators", "ekf,kalman,raises", "--plugin", "half.py", "--runs", 4, "--out",
             "out")
    outcomes = [railstate(*words), railstate("show", "cart.toml"), railstate("report", "out"),
                railstate("replay", "cart/calm/raises/3", "--out", "out", "--plugin", "half.py"),
                railstate("table", "out", "--format", "md"), railstate("run", f"{EVIL}.toml"),
                railstate(*words, "--json")]
    for done in outcomes:
        assert not STEERING.search(done.out + done.err), done
        assert "Traceback" not in done.err
    assert [done.code for done in outcomes] == [0, 0, 0, 0, 0, 2, 0]
    assert "\\x1b[31mred" in outcomes[1].out and "\\x1b[31mred" in outcomes[0].err and "\\x1b[31mred" in outcomes[3].out
    made = [path for path in Path("out").rglob("*") if path.suffix in (".md", ".tex", ".csv", ".html", ".json")]
    assert len(made) > 6
    for path in made:
        written = path.read_text(encoding="utf-8")
        assert not STEERING.search(written), path
        if path.suffix in (".md", ".html"):
            assert "<script>alert" not in written and (path.suffix == ".html" or "](" not in written), path


@pytest.mark.parametrize(("key", "value"), [("states", '["=cmd()", "speed"]'), ("states", '["a:b", "speed"]'),
                                            ("states", '["a\\u001b[1m", "speed"]'), ("units", '["m", "m:s"]'),
                                            ("units", '["<b>", "m/s"]'), ("units", '["=1", "m/s"]')])
def test_names_of_columns_are_names(railstate: Command, key: str, value: str) -> None:
    line = f"{key} = {value}".replace("\\", r"\\")
    Path("cart.toml").write_text(re.sub(rf"^{key} = .*$", line, SCENARIO, flags=re.M))
    refused = railstate("run", "cart.toml", "--estimators", "ekf", "--runs", 1)
    assert refused.code == 2 and f"plant.{key}" in refused.err and not STEERING.search(refused.err)


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp1252"])
def test_letters_that_an_output_has_not(encoding: str) -> None:
    stream = io.TextIOWrapper(io.BytesIO(), encoding)
    assert cleaning.Cleaned(stream).write("0.1 ± 0.2 ★ 中\x1b\n") == 15
    stream.flush()
    found = stream.buffer.getvalue().decode(encoding)  # type: ignore[attr-defined]
    assert found == {"ascii": "0.1 +- 0.2 * ?\\x1b\n"}.get(encoding, "0.1 ± 0.2 * ?\\x1b\n")
