"""Moving block's own figures: the track with its tags and both trains, their way over time, and the gap."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ....scenarios.arrays import Array
from ....scenarios.moving_block.track import StadiumTrack
from .axes import LEFT, RIGHT, Panel, Scale, Sheet, Style, draw_marker, legend, legend_height, spanning
from .canvas import Canvas
from .data import CellResults
from .example import thinned

LEADER, FOLLOWER, TAG = Style("c0"), Style("c1", (), "square"), Style("muted", (), "diamond")
TRAINS = {"a": Style("ink"), "b": Style("ink", (), "square")}
"""How the two trains are told apart, whoever estimates them."""
INSTANTS, GAPS = 24, 12


def _shown(cell: CellResults) -> str | None:
    """The estimator whose run is drawn: the first Kalman-type one that kept a run, else the first that did."""
    kept = [label for label in cell.ran if (label, "s-a") in cell.kept]
    return next((label for label in kept if label in ("ukf", "ekf", "ckf")), kept[0] if kept else None)


def track(cell: CellResults) -> Canvas | None:
    """The track from above with its tags; at some instants where both trains' noses were (dark; A round, B square), and
    where the encoder alone and a filter, each in its own loop, believed them to be (in their colours)."""
    names = dict.fromkeys(("dead-reckoning", _shown(cell) or ""))
    labels = [name for name in names if (name, "estimate-x-b") in cell.kept]
    if not labels:
        return None
    entries = [("tag", TAG), ("A, true", TRAINS["a"]), ("B, true", TRAINS["b"]),
               *((f"{name}, {train.upper()}", Style(cell.styles[name].colour, (), TRAINS[train].marker))
                 for name in labels for train in "ab")]
    room = legend_height([name for name, _ in entries], cell.width - 8)
    config = cell.setting.config
    way = StadiumTrack(config.plant.track.straight, config.plant.track.radius)
    long_side, short_side = (way.half + way.radius) * 100 + 10, way.radius * 100 + 10
    width = cell.width - LEFT - RIGHT
    height = width * short_side / long_side
    canvas = Canvas(14 + height + 26 + room, f"Track, {cell.key}", cell.width)
    panel = Panel(canvas, LEFT, 14, width, height, Scale(-long_side, long_side), Scale(-short_side, short_side),
                  title="x [cm]", x_label="y [cm]")

    def at(s: Array) -> Array:
        x, y, _ = way.points(s)
        return panel.points(y * 100, x * 100)

    canvas.path(at(np.linspace(0, way.length, 200)), stroke="muted", width=0.6)
    for x, y in at(way.tags(config.sensors.tags.count)):
        draw_marker(canvas, x, y, TAG, 2.2, "tag")
    for name in labels:
        for train in "ab":
            true, believed = ([cell.kept[name, f"{kind}{axis}-{train}"].truth for axis in "yx"]
                              for kind in ("", "estimate-"))
            steps = np.flatnonzero(np.isfinite(true[0]) & np.isfinite(believed[0]))
            steps = steps[thinned(len(steps), INSTANTS)]
            was, thought = (panel.points(y[steps] * 100, x[steps] * 100) for y, x in (true, believed))
            for here, there in zip(was, thought, strict=True):
                colour, marker = cell.styles[name].colour, TRAINS[train].marker
                canvas.path([here, there], stroke=colour, width=0.8)
                draw_marker(canvas, here[0], here[1], TRAINS[train], 1.2, f"{train.upper()}, true")
                draw_marker(canvas, there[0], there[1], Style(colour, (), marker), 1.6, f"{name}, {train.upper()}")
    start = at(np.zeros(1))[0]
    canvas.text(start[0] + 4, start[1] + 10, "start", size=7, colour="muted")
    legend(canvas, room, entries, markers=True)
    return canvas


def trains_over_time(cells: Sequence[CellResults]) -> Canvas | None:
    """Ways of both trains under moving block and under fixed block, a kept run of one filter; the gap from the leader's
    tail to the follower's nose is marked at some instants, its mean said in the title."""
    chosen: dict[str, CellResults] = {}
    for cell in cells:
        kind = str(cell.table.get("plant", {}).get("signalling", {}).get("kind", ""))
        if kind and _shown(cell) and kind not in chosen:
            chosen[kind] = cell
    if not chosen:
        return None
    sheet = Sheet(f"Trains over time, {cells[0].scenario}", cells[0].width, [84.0] * len(chosen),
                  [("leader", LEADER), ("follower", FOLLOWER), ("gap", TAG)], foot=30)
    tracks = {kind: [cell.kept[str(_shown(cell)), name] for name in ("s-a", "s-b")] for kind, cell in chosen.items()}
    alive = [np.isfinite(pair[0].truth) for pair in tracks.values()]
    x = spanning(*(pair[0].time[ok] for pair, ok in zip(tracks.values(), alive, strict=True)), log=False, margin=0.0)
    for kind, pair in tracks.items():
        shown = str(_shown(chosen[kind]))
        gap = float(np.nanmean(chosen[kind].kept[shown, "gap"].truth)) * 100
        panel = sheet.panel(x, spanning(*(way.truth * 100 for way in pair), log=False),
                            f"{kind} block, {shown}: way [cm]; mean gap {gap:.0f} cm")
        for way, style, name in zip(pair, (LEADER, FOLLOWER), ("leader", "follower"), strict=True):
            use = thinned(len(way.time))
            panel.line(way.time[use], way.truth[use] * 100, style, title=name)
        steps = np.flatnonzero(np.isfinite(pair[0].truth))
        length = float(chosen[kind].setting.config.plant.trains.length)
        for k in steps[thinned(len(steps), GAPS)]:
            ends = panel.points([pair[0].time[k]] * 2, [pair[1].truth[k] * 100, (pair[0].truth[k] - length) * 100])
            sheet.canvas.path(ends, stroke=TAG.colour, width=0.7, title="gap")
    return sheet.done()


def gap_over_time(cell: CellResults) -> Canvas | None:
    """The true gap in each estimator's own loop, a kept run; d_min(k) of one of them, under which the synchronization
    acts (under moving block); and the distance that must not be undercut."""
    labels = [label for label in cell.ran if (label, "gap") in cell.kept]
    if not labels:
        return None
    gaps = {label: (cell.kept[label, "gap"].time, cell.kept[label, "gap"].truth * 100) for label in labels}
    least = float(cell.setting.config.plant.control.safe_gap) * 100
    moving = cell.setting.config.plant.signalling.kind == "moving"
    acting = cell.kept.get((str(_shown(cell)), "kept-distance")) if moving else None
    entries = cell.styled(labels)
    if acting is not None:
        entries.append((f"d_min(k), {_shown(cell)}", Style("ink", (1.3, 1.3))))
    sheet = Sheet(f"Gap, {cell.key}", cell.width, [130], entries)
    x = spanning(*(time[np.isfinite(gap)] for time, gap in gaps.values()), log=False, margin=0.0)
    panel = sheet.panel(x, spanning(*(gap for _, gap in gaps.values()), [0.0], log=False),
                        "gap [cm]; dashed: the least admitted")
    for label, (time, gap) in gaps.items():
        use = thinned(int(np.isfinite(gap).sum()), 400)
        panel.line(time[use], gap[use], cell.styles[label], width=0.9, title=label)
    if acting is not None:
        use = thinned(int(np.isfinite(acting.truth).sum()), 400)
        panel.line(acting.time[use], acting.truth[use] * 100, entries[-1][1], width=0.8, title=entries[-1][0])
    panel.level(least, colour="ink", dash=(3, 2))
    return sheet.done()
