"""Moving block's own figures: the track with its tags and both trains, their way over time, and the gap."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ....scenarios.arrays import Array
from ....scenarios.moving_block.track import StadiumTrack
from .axes import Panel, Scale, Style, draw_marker, legend, legend_height, spanning
from .canvas import Canvas
from .data import CellResults
from .errors import LEFT, RIGHT
from .example import thinned

LEADER, FOLLOWER, TAG, TRUE = Style("c0"), Style("c1", (), "square"), Style("muted", (), "diamond"), Style("ink")
INSTANTS = 16


def _shown(cell: CellResults) -> str | None:
    """The estimator whose run is drawn: the first Kalman-type one that kept a run, else the first that did."""
    kept = [label for label in cell.labels if (label, "s-a") in cell.kept]
    return next((label for label in kept if label in ("ukf", "ekf", "ckf")), kept[0] if kept else None)


def track(cell: CellResults) -> Canvas | None:
    """The track from above with its tags; at some instants where both trains' noses were, and where the encoder alone
    and a filter, each in its own loop, believed them to be."""
    names = dict.fromkeys(("dead-reckoning", _shown(cell) or ""))
    labels = [name for name in names if (name, "estimate-x-b") in cell.kept]
    if not labels:
        return None
    entries = [("tag", TAG), ("true", TRUE), *((name, cell.styles[name]) for name in labels)]
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
            steps = np.flatnonzero(np.isfinite(true[0]))
            steps = steps[thinned(len(steps), INSTANTS)]
            was, thought = (panel.points(y[steps] * 100, x[steps] * 100) for y, x in (true, believed))
            for here, there in zip(was, thought, strict=True):
                canvas.path([here, there], stroke=cell.styles[name].colour, width=0.8)
                draw_marker(canvas, here[0], here[1], TRUE, 1.2, "true")
                draw_marker(canvas, there[0], there[1], cell.styles[name], 1.6, name)
    start = at(np.zeros(1))[0]
    canvas.text(start[0] + 4, start[1] + 10, "start", size=7, colour="muted")
    legend(canvas, room, entries, markers=True)
    return canvas


def trains_over_time(cells: Sequence[CellResults]) -> Canvas | None:
    """Ways of both trains under moving block and under fixed block, first kept run of one filter."""
    chosen: dict[str, CellResults] = {}
    for cell in cells:
        kind = str(cell.table.get("plant", {}).get("signalling", {}).get("kind", ""))
        if kind and _shown(cell) and kind not in chosen:
            chosen[kind] = cell
    if not chosen:
        return None
    each = 84.0
    entries = [("leader", LEADER), ("follower", FOLLOWER)]
    room = legend_height([name for name, _ in entries], cells[0].width)
    canvas = Canvas(len(chosen) * (each + 18) + 26 + room, f"Trains over time, {cells[0].scenario}", cells[0].width)
    tracks = {kind: [cell.kept[str(_shown(cell)), name] for name in ("s-a", "s-b")] for kind, cell in chosen.items()}
    alive = [np.isfinite(pair[0].truth) for pair in tracks.values()]
    x = spanning(*(pair[0].time[ok] for pair, ok in zip(tracks.values(), alive, strict=True)), log=False, margin=0.0)
    for row, (kind, pair) in enumerate(tracks.items()):
        last = row == len(tracks) - 1
        panel = Panel(canvas, LEFT, 14 + row * (each + 18), cells[0].width - LEFT - RIGHT, each, x,
                      spanning(*(way.truth * 100 for way in pair), log=False), x_ticks=last,
                      title=f"{kind} block ({chosen[kind].variant}, {_shown(chosen[kind])}): way [cm]",
                      x_label="time [s]" if last else "")
        for way, style, name in zip(pair, (LEADER, FOLLOWER), ("leader", "follower"), strict=True):
            use = thinned(len(way.time))
            panel.line(way.time[use], way.truth[use] * 100, style, title=name)
    legend(canvas, room, entries)
    return canvas


def gap_over_time(cell: CellResults) -> Canvas | None:
    """The true gap in each estimator's own loop, first kept run, and the distance that must not be undercut."""
    labels = [label for label in cell.labels if (label, "gap") in cell.kept]
    if not labels:
        return None
    gaps = {label: (cell.kept[label, "gap"].time, cell.kept[label, "gap"].truth * 100) for label in labels}
    least = float(cell.setting.config.plant.control.safe_gap) * 100
    room = legend_height(labels, cell.width - 8)
    canvas = Canvas(14 + 130 + 26 + room, f"Gap, {cell.key}", cell.width)
    x = spanning(*(time[np.isfinite(gap)] for time, gap in gaps.values()), log=False, margin=0.0)
    panel = Panel(canvas, LEFT, 14, cell.width - LEFT - RIGHT, 130, x,
                  spanning(*(gap for _, gap in gaps.values()), [0.0], log=False),
                  title="gap [cm]; dashed: the least admitted", x_label="time [s]")
    for label, (time, gap) in gaps.items():
        use = thinned(int(np.isfinite(gap).sum()), 400)
        panel.line(time[use], gap[use], cell.styles[label], width=0.9, title=label)
    panel.level(least, colour="ink", dash=(3, 2))
    legend(canvas, room, [(label, cell.styles[label]) for label in labels])
    return canvas
