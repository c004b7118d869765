"""Figures: every one is drawn from a results folder, shows its data, stays inside its canvas, writes all formats.

Scales, ticks, styles and the numbers behind the figures are checked against what they must be."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from railstate.benchmarks.commands.report import plot
from railstate.benchmarks.judging.ranks import over_settings
from railstate.benchmarks.telling.figures.axes import Scale, spanning, tick_text
from railstate.benchmarks.telling.figures.canvas import DARK, FONT, LIGHT, Canvas
from railstate.benchmarks.telling.figures.catalogue import FIGURES, drawn
from railstate.benchmarks.telling.figures.data import Curve, Results, assign_styles, load_results
from railstate.benchmarks.telling.figures.errors import binned_rms
from railstate.benchmarks.telling.figures.recorded import recorded_trip
from railstate.scenarios.errors import InputError

from ..synthetic_results import BRAKING, CBTC, METRO, PERIOD, write_results

SERIES = {LIGHT[f"c{i}"] for i in range(8)}


def test_every_figure_the_data_allow_is_drawn_for_every_variant(results: Results) -> None:
    found = {(figure.name, scenario, variant) for figure, scenario, variant, _ in drawn(results)}
    cells = [(cell.scenario, cell.variant) for cells in results.scenarios.values() for cell in cells]
    for name in ("error-over-time", "errors-per-run", "accuracy-latency", "example"):
        assert {(name, *cell) for cell in cells} <= found
    assert {("nees", "ningbo-metro", variant) for variant in ("switching", "white", "constant")} <= found
    assert ("nees", "cbtc-csma", "uniform") not in found
    assert {("certified", "cbtc-csma", "uniform"), ("receptions", "cbtc-csma", "table3"),
            ("headway", "cbtc-csma", "uniform"), ("parameter", "braking-rate", "paper"),
            ("speed-profile", "ningbo-metro", "white"), ("critical-difference", "ningbo-metro", "")} <= found


def test_no_figure_is_empty_and_nothing_leaves_its_canvas(results: Results) -> None:
    for figure, scenario, variant, canvas in drawn(results):
        where = f"{figure.name} {scenario}/{variant}"
        root = ET.fromstring(canvas.svg())
        width, height = (float(v) for v in root.attrib["viewBox"].split()[2:])
        paths = [(node, parent) for parent in root.iter() for node in parent.findall("{http://www.w3.org/2000/svg}path")]
        assert any({one.get(name) for one in pair for name in ("stroke", "fill")} & SERIES for pair in paths), where
        for node, _ in paths:
            for part in node.attrib["d"].split("M")[1:]:
                numbers = [int(n) for n in re.findall(r"-?\d+", part)]
                points = np.cumsum(np.array(numbers[:2 * (len(numbers) // 2)]).reshape(-1, 2), axis=0)
                assert points[:, 0].min() >= -1, where
                assert points[:, 0].max() <= width + 1, where
                assert points[:, 1].min() >= -1, where
                assert points[:, 1].max() <= height + 1, where
        texts = list(root.iter("{http://www.w3.org/2000/svg}text"))
        assert all(0 <= float(node.attrib["y"]) <= height for node in texts), where
        assert not [node.text for node in texts if re.search(r"\d\.\d{5}|\bnan\b|\binf\b", node.text or "")], where


def test_the_error_curve_is_the_root_mean_square_over_runs_with_its_interval() -> None:
    rng = np.random.default_rng(3)
    squared = rng.chisquare(2, (5, 4000)) / 2
    curve = Curve(np.arange(5.0), np.full(5, 4000.0), squared.sum(1), (squared**2).sum(1), np.zeros(5))
    time, root, low, high = binned_rms(curve)
    assert time.tolist() == [0, 1, 2, 3, 4]
    assert root == pytest.approx(np.sqrt(squared.mean(1)))
    half = 1.96 * squared.std(axis=1, ddof=1) / np.sqrt(4000) / 2 / root
    assert high - root == pytest.approx(half, rel=1e-6)
    assert root - low == pytest.approx(half, rel=1e-6)


def test_long_curves_are_averaged_in_bins_and_thin_ends_left_out() -> None:
    active = np.append(np.full(1000, 100.0), np.full(50, 3.0))
    curve = Curve(np.arange(1050.0), active, 4.0 * active, 16.0 * active, np.zeros(1050))
    time, root, low, high = binned_rms(curve)
    assert len(time) <= 130
    assert time.max() < 1000
    assert root == pytest.approx(np.full(len(root), 2.0))
    assert np.allclose(low, high)


def test_ranks_put_the_best_first_those_that_failed_last_and_leave_out_oracles(results: Results) -> None:
    table = results.verdicts
    found = over_settings(table[table["scenario"] == "cbtc-csma"], "position")
    assert found is not None
    labels, ranks = found
    assert labels == ["direct", "kalman", "ultimate-bound", "fastest-decay"]
    assert ranks.n == 2  # variants, not runs
    assert labels[int(np.argmin(ranks.mean))] == "kalman"
    assert ranks.mean[3] == 3.5  # third where it finished, last where it lost every run
    assert over_settings(table[table["scenario"] == "braking-rate"], "f") is None  # one variant
    told = table.assign(verdict=table["verdict"].where(table["estimator"] != "ekf", "oracle"))
    metro = over_settings(told[told["scenario"] == "ningbo-metro"], "speed")
    assert metro is not None and "ekf" not in metro[0]


def test_estimators_seen_together_differ_in_dash_or_marker_and_few_of_them_in_colour(results: Results) -> None:
    """What differs in dash or marker survives grey."""
    styles = results.styles
    assert set(styles) == {*METRO, *CBTC, *BRAKING}
    for group in (METRO, CBTC, BRAKING):
        assert len({(styles[label].dash, styles[label].marker) for label in group}) == len(group)
    for group in (METRO, CBTC):
        assert len({styles[label].colour for label in group}) == len(group)
    assert max([styles[label].colour for label in BRAKING].count(c) for c in LIGHT) == 2


def test_a_label_looks_the_same_wherever_it_appears() -> None:
    styles = assign_styles([["a", "b"], ["c", "d", "b"], ["a", "d"]])
    assert len({styles[label].colour for label in "bcd"}) == 3
    assert styles["a"].colour not in (styles["b"].colour, styles["d"].colour)
    many = assign_styles([[f"e{i}" for i in range(25)]])
    assert len({(s.dash, s.marker) for s in many.values()}) == 25


def test_entries_quantities_and_width_can_be_chosen(results: Results, tmp_path: Path) -> None:
    plot(str(results.folder), figure="error-over-time", entries="ekf,robust-ellipsoid", quantities="speed", width=7.0,
         format_="svg", out=str(tmp_path))
    assert len(list(tmp_path.glob("*.svg"))) == 3  # the variants of the scenario that has these
    text = (tmp_path / "error-over-time~ningbo-metro~switching.svg").read_text()
    assert 'width="504pt"' in text and "RMS error of speed" in text and "position" not in text
    assert "robust-ellipsoid" in text and "ukf" not in text
    for words in ({"entries": "nobody"}, {"quantities": "smell"}, {"run": 5}):
        with pytest.raises(InputError, match=r"not in this folder; allowed: |1 runs are kept"):
            plot(str(results.folder), **words)


def test_series_colours_have_contrast_and_stay_apart_for_every_kind_of_sight() -> None:
    machado = {
        "normal": np.eye(3),
        "protan": [[.152286, 1.052583, -.204868], [.114503, .786281, .099216], [-.003882, -.048116, 1.051998]],
        "deutan": [[.367322, .860646, -.227968], [.280085, .672501, .047413], [-.011820, .042940, .968881]],
        "tritan": [[1.255528, -.076749, -.178779], [-.078411, .930809, .147602], [.004733, .691367, .303900]]}
    xyz = np.array([[.4124564, .3575761, .1804375], [.2126729, .7151522, .0721750], [.0193339, .1191920, .9503041]])

    def linear(colour: str) -> np.ndarray:
        c = np.array([int(colour[i:i + 2], 16) for i in (1, 3, 5)]) / 255
        return np.where(c <= .04045, c / 12.92, ((c + .055) / 1.055) ** 2.4)

    def lab(rgb: np.ndarray) -> np.ndarray:
        t = xyz @ np.clip(rgb, 0, 1) / np.array([.95047, 1, 1.08883])
        x, y, z = np.where(t > .008856, np.cbrt(t), 7.787 * t + 16 / 116)
        return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])

    for palette, least in ((LIGHT, 2.7), (DARK, 3.3)):
        series = [linear(palette[f"c{i}"]) for i in range(8)]
        paper = (xyz @ linear(palette["paper"]))[1] + .05
        for rgb in series:
            own = (xyz @ rgb)[1] + .05
            assert max(own, paper) / min(own, paper) >= least
        for sight in machado.values():
            seen = [lab(np.asarray(sight) @ rgb) for rgb in series]
            assert min(np.linalg.norm(a - b) for i, a in enumerate(seen) for b in seen[:i]) > 28


@pytest.mark.parametrize(("low", "high", "most", "expected"), [
    (0, 1, 6, [0, 0.2, 0.4, 0.6, 0.8, 1.0]), (-3, 112, 2, [0, 100]), (0.0947, 0.1342, 4, [0.1, 0.11, 0.12, 0.13]),
    (-1e-9, 3e-9, 5, [-1e-9, 0, 1e-9, 2e-9, 3e-9])])
def test_linear_ticks_are_round_and_few(low: float, high: float, most: int, expected: list[float]) -> None:
    assert Scale(low, high).ticks(most) == pytest.approx(expected)


def test_logarithmic_scales_where_values_span_decades() -> None:
    assert spanning([1.0, 100.0]).log
    assert not spanning([1.0, 10.0]).log
    assert not spanning([-1.0, 100.0]).log
    assert Scale(0.01, 1000, True).ticks(6) == pytest.approx([0.01, 0.1, 1, 10, 100, 1000])
    assert Scale(2, 9, True).ticks(4) == [2, 3, 5, 7]
    assert spanning([]) == Scale(0.0, 1.0)
    assert Scale(1, 100, True).share([0.0, 10.0, 1e9]).tolist() == [0.0, pytest.approx(0.5), 1.0]


@pytest.mark.parametrize(("value", "text"), [(0, "0"), (0.30000000000000004, "0.3"), (-25, "−25"), (1e-5, "10⁻⁵"),
                                             (2.5e6, "2.5·10⁶"), (12000, "12000")])
def test_tick_texts_are_short(value: float, text: str) -> None:
    assert tick_text(value) == text


def test_texts_of_a_figure_cannot_break_the_page() -> None:
    canvas = Canvas(20, 'a "<b>" & c')
    canvas.text(0, 10, "<script>&")
    canvas.path([(0, 0), (1, 1)], title="</title><script>")
    for inline in (True, False):
        assert "<script>" not in canvas.svg(inline=inline)
        ET.fromstring(canvas.svg(inline=inline))


def test_all_that_is_drawn_is_in_other_formats(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every property of each kind of item as matplotlib is told it, in the order in which they lie on each other."""
    from matplotlib.colors import to_hex
    from matplotlib.figure import Figure

    told: list[Any] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **how: told.append((figure, how)))
    canvas = Canvas(144, "of all", width=72.0)
    canvas.path([(0, 1), (2, 3), (4, 5)], width=2.0, dash=(3.0, 1.0))
    canvas.dots([(5, 6), (7, 8)], "c1", 1.5)
    canvas.path([(0, 0), (1, 0), (1, 1)], fill="c2", opacity=0.25, stroke="ink", width=0.5)
    canvas.text(3, 4, "a $ b", size=10.0, anchor="middle", colour="c1", bold=True)
    canvas.text(1, 2, "end", anchor="end")
    assert canvas.svg(inline=True).startswith('<svg viewBox="0 0 720 1440" role="img" aria-label="of all"><path ')
    canvas.save(tmp_path / "a.png")
    (figure, how), = told
    (axes,) = figure.axes
    assert how == {"dpi": 300, "facecolor": "white"} and tuple(figure.get_size_inches()) == (1.0, 2.0)
    assert axes.get_xlim() == (0, 72) and axes.get_ylim() == (144, 0) and not axes.axison
    line, dots, outline = axes.lines
    assert [(one.get_zorder(), dots.get_markersize() if one is dots else one.get_linewidth(), to_hex(one.get_color()))
            for one in axes.lines] == [(0, 2.0, LIGHT["ink"]), (1, 1.5, LIGHT["c1"]), (2, 0.5, LIGHT["ink"])]
    assert [one.get_xydata().tolist() for one in axes.lines] == [
        [[0, 1], [2, 3], [4, 5]], [[5, 6], [7, 8]], [[0, 0], [1, 0], [1, 1], [0, 0]]]
    assert line._unscaled_dash_pattern == (0, (1.5, 0.5)) and outline.get_linestyle() == "-"
    assert (dots.get_marker(), dots.get_linestyle(), dots.get_markeredgewidth()) == (".", "None", 0)
    assert {(one.get_solid_capstyle(), one.get_solid_joinstyle()) for one in (line, outline)} == {("butt", "round")}
    (area,) = axes.patches
    assert (to_hex(area.get_facecolor()), area.get_alpha(), area.get_zorder()) == (LIGHT["c2"], 0.25, 2)
    assert area.get_edgecolor()[3] == 0 and area.get_xy()[:3].tolist() == [[0, 0], [1, 0], [1, 1]]
    assert [(one.get_text(), one.get_position(), one.get_fontsize(), to_hex(one.get_color()), one.get_ha(),
             one.get_va(), one.get_rotation(), one.get_weight(), one.get_zorder())
            for one in axes.texts] == [
        (r"a \$ b", (3, 4), 9.5, LIGHT["c1"], "center", "baseline", 0, "bold", 3),
        ("end", (1, 2), FONT * 0.95, LIGHT["ink"], "right", "baseline", 0, "normal", 4)]


@pytest.mark.parametrize(("format_", "magic"), [("svg", b"<svg"), ("pdf", b"%PDF"), ("png", b"\x89PNG")])
def test_plot_writes_each_format_at_column_width(results: Results, tmp_path: Path, format_: str, magic: bytes,
                                                 capsys: pytest.CaptureFixture[str]) -> None:
    plot(str(results.folder), figure="critical-difference", format_=format_, out=str(tmp_path / "out"))
    written = sorted((tmp_path / "out").iterdir())
    assert [path.name for path in written] == [f"critical-difference~{scenario}.{format_}" for scenario in
                                               ("cbtc-csma", "ningbo-metro")]  # the other has one variant: no blocks
    assert "2 figures" in capsys.readouterr().out
    data = written[0].read_bytes()
    assert data.startswith(magic)
    if format_ == "png":
        assert int.from_bytes(data[16:20], "big") == 3.5 * 300
    if format_ == "svg":
        assert b'width="252pt"' in data
    if format_ == "pdf":
        assert re.search(rb"/MediaBox \[ ?0 0 252 ", data)


@pytest.mark.parametrize(("words", "message"), [({"figure": "nothing"}, "error-over-time"),
                                                ({"format_": "gif"}, "svg, pdf, png"),
                                                ({"figure": "trace"}, "no data")])
def test_plot_says_what_is_allowed(results: Results, words: dict[str, str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        plot(str(results.folder), **{"figure": "", "format_": "svg", "out": str(results.folder / "x"), **words})


def test_figures_without_kept_runs_are_left_out(tmp_path: Path) -> None:
    bare = load_results(write_results(tmp_path / "bare", keep=False))
    names = {figure.name for figure, *_ in drawn(bare)}
    assert names.isdisjoint({"example", "speed-profile", "receptions", "parameter"})
    assert {"error-over-time", "headway", "nees"} <= names
    assert {figure.name for figure in FIGURES} >= names
    assert bare.scenarios["ningbo-metro"][0].period == PERIOD


def test_a_trip_shows_every_entry_in_speed_and_in_position(results: Results) -> None:
    cell = results.scenarios["ningbo-metro"][0]
    canvas = recorded_trip(cell)
    assert canvas is not None
    lines = Counter(re.findall("<path[^>]*><title>(.*?)</title>", canvas.svg()))
    assert lines == {"reference": 1, **dict.fromkeys(METRO, 2)}
