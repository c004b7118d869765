"""What is wrong with a recording: each column alone. Impossible is what no train does, odd what a user should know.

`railstate inspect` prints all of it; before a run what is impossible ends it, and what is odd stands in the notes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from ..arrays import Array, Index
from .against import against
from .counters import TOP_SPEED
from .findings import Finding, leave_out, spans
from .times import DAY, HOUR

SENTINELS = (-9999.0, -999.0, -99999.0, 9999.0, 99999.0, -32768.0, 32767.0, 65535.0, 999999.0, -999999.0)
HUGE = 1e9
HARDEST, SLACK, SPREADS, TOLD = 3.0, 5.0, 12.0, 4.0
"""A place jumps where it is farther than this acceleration (m/s^2), this slack (m) and so many usual deviations (told
ones: the last number) from where its own pace leads."""
FROZEN, SAMPLES = 30.0, 20
"""A reading is frozen where it is the same to the last digit for so many s, and so many samples."""
WIDER = 20
"""How often what is to be left out grows, where a place jumps again over what was left out before."""
OFFSIDE = 50.0
"""m across the line, above which a fix is said to be off it."""
PLACES, PACES = ("position", "reference_position", "balise"), ("speed", "reference_speed")
COUNTERS = ("odometer", "wheel-a", "wheel-b")


def examine(time: Array, columns: Mapping[str, Array], told: Mapping[str, Array]) -> Iterator[Finding]:
    """The findings of a recording: time (N,) s, columns by role (N,) in SI, NaN where none; told: what sensors say of
    their standard deviations."""
    yield from _clock(time)
    for role, values in columns.items():
        there = np.flatnonzero(np.isfinite(values))
        if len(there) < 3:
            continue
        sound = there
        for finding, bad in _no_values(role, values, there, time):
            sound = sound[~np.isin(sound, bad)]
            yield finding
        if role == "across":
            yield from _offside(time, values, there, told.get("position", np.zeros(len(time))))
        if len(sound) < 3:
            continue
        at, clean = time[sound], values[sound]
        if role in PLACES:
            yield from _jumps(role, at, clean, told[role][sound] if role in told else np.zeros(len(at)))
        if role in PACES:
            yield from _paces(role, at, clean)
        if role in COUNTERS:
            yield from _counter(role, at, clean)
        if role in (*PLACES, *PACES, "acceleration"):
            yield from _frozen(role, at, clean)
    yield from against(time, columns)


def _clock(time: Array) -> Iterator[Finding]:
    steps = np.diff(time)
    usual = float(np.median(steps))
    if usual >= 100 and time[-1] > DAY:
        name, unit = ("nanoseconds", "ns") if usual > 1e6 else ("milliseconds", "ms")
        yield Finding("impossible", "time", f"the usual step is {usual:g} s and the whole {time[-1] / DAY:.3g} days: "
                      f"{name} in a column taken as seconds? (map it with its unit, time = \"NAME [{unit}]\")")
        return
    if usual < 1e-4:
        yield Finding("odd", "time", f"the usual step is {usual:g} s, the whole trip {time[-1] - time[0]:.3g} s: "
                      "seconds in a column taken as ms or us?")
    hours = np.flatnonzero((np.abs(steps - HOUR) < 60) & (steps > 20 * usual))
    for k in hours[:2]:
        yield Finding("odd", "time", f"an hour is missing at t = {time[k]:.6g} s: a clock that is an hour off?")
    wide = np.flatnonzero(steps > max(10 * usual, 5.0))
    wide = np.setdiff1d(wide, hours)
    if len(wide):
        k = wide[np.argmax(steps[wide])]
        more = f" ({len(wide)} such gaps)" if len(wide) > 1 else ""
        yield Finding("odd", "time", f"a gap of {steps[k]:.3g} s at t = {time[k]:.6g} s; the usual step is {usual:.3g} "
                      f"s{more}")
    low, high = np.quantile(steps, [0.05, 0.95])
    if high > 3 * max(low, 1e-12):
        yield Finding("odd", "time", f"steps are uneven: {low:.3g} .. {high:.3g} s, usually {usual:.3g} s")


def _no_values(role: str, values: Array, there: Index, time: Array) -> Iterator[tuple[Finding, Index]]:
    """Numbers that stand for no value, or cannot be one."""
    present = values[there]
    huge = there[np.abs(present) >= HUGE]
    if len(huge):
        yield Finding("impossible", role, f"{role} is {values[huge[0]]:g} at t = {time[huge[0]]:.6g} s ({len(huge)} "
                      f"such rows): missing = [{values[huge[0]]:g}] takes it as no value"), huge
    marks = {value: there[present == value] for value in SENTINELS if present.min() <= value <= present.max()}
    marks = {value: rows for value, rows in marks.items() if len(rows)}
    others = present[~np.isin(present, list(marks)) & (np.abs(present) < HUGE)]
    low, high = (others.min(), others.max()) if len(others) else (0.0, 0.0)
    reach = max(high - low, 1.0)
    for value, rows in marks.items():
        if not low - 0.1 * reach <= value <= high + 0.1 * reach:
            yield Finding("impossible", role, f"{role} is {value:g} at t = {time[rows[0]]:.6g} s ({len(rows)} such "
                          f"rows) and {low:.4g} .. {high:.4g} elsewhere: missing = [{value:g}] takes it as no "
                          "value"), rows


def _jumps(role: str, time: Array, place: Array, told: Array) -> Iterator[Finding]:
    pace = np.diff(place) / np.diff(time)
    what = {"position": "the position", "balise": "the place by balises"}.get(role, "the reference")
    jump, ahead = _jumping(time, place, told)
    if not len(jump):
        if np.abs(pace).max() < 0.3 and abs(place[-1] - place[0]) > 5 and time[-1] > 60:
            yield Finding("odd", role, f"{what} never moves faster than {np.abs(pace).max():.3g} m/s: is its unit "
                          "right?")
        return
    k = jump[np.argmax(np.abs(pace[jump]))]
    places = f" ({len(jump)} such places)" if len(jump) > 1 else ""
    verb = "moves" if np.abs(pace[k]) > TOP_SPEED else "jumps"
    text = (f"{what} moves at {abs(pace[k]):.0f} m/s at t = {time[k + 1]:.6g} s" if verb == "moves" else
            f"{what} jumps by {abs(ahead[max(k - 1, 0)]):.3g} m at t = {time[k + 1]:.6g} s")
    rows, cure = np.zeros(0, dtype=np.int64), ""
    for _ in range(WIDER):  # until what is left has none
        left = np.ones(len(time), dtype=bool)
        for begin, end in spans(time, rows):
            left &= (time < begin) | (time > end)
        at = np.flatnonzero(left)
        more = _jumping(time[at], place[at], told[at])[0] if len(at) > 3 else np.zeros(0, dtype=np.int64)
        if not len(more):
            cure = leave_out(time, rows)
            break
        rows = np.union1d(rows, np.union1d(at[more], at[np.minimum(more + 1, len(at) - 1)]))
    cure = cure or f"for good; one side alone is --to {np.floor(time[k]):.0f} or --from {np.ceil(time[k + 1]):.0f}"
    yield Finding("impossible", role, f"{text}{places}: {cure}",
                  reading=not role.startswith("reference"))


def _jumping(time: Array, place: Array, told: Array) -> tuple[Index, Array]:
    """The steps that no train makes, and how far each place is from where the pace before leads (N - 2,), m."""
    lengths, moved = np.diff(time), np.diff(place)
    pace = moved / lengths
    sure = np.nan_to_num(told)
    sure = TOLD * (sure[1:] + sure[:-1])  # what the readings themselves leave open
    fast = np.flatnonzero(np.abs(moved) > TOP_SPEED * lengths + sure)
    ahead = moved[1:] - pace[:-1] * lengths[1:]
    usual = float(np.median(np.abs(ahead)))
    limit = SLACK + HARDEST * lengths[1:] * (lengths[1:] + lengths[:-1]) / 2 + SPREADS * usual
    limit += sure[1:] + sure[:-1] * lengths[1:] / lengths[:-1]
    # a jump leads from the usual pace to another: the step itself, not the one after it
    return np.union1d(np.flatnonzero(np.abs(ahead) > limit) + 1, fast), ahead


def _paces(role: str, time: Array, speed: Array) -> Iterator[Finding]:
    fast = np.flatnonzero(np.abs(speed) > TOP_SPEED)
    if len(fast):
        k = fast[np.argmax(np.abs(speed[fast]))]
        yield Finding("impossible", role, f"{role} is {speed[k]:.4g} m/s at t = {time[k]:.6g} s ({len(fast)} such "
                      f"rows): is its unit right? else {leave_out(time, fast)}")
        return
    change, lengths = np.abs(np.diff(speed)), np.diff(time)
    hard = np.flatnonzero(change > 3.0 + HARDEST * lengths + SPREADS * float(np.median(change)))
    if len(hard):
        k = hard[np.argmax(change[hard])]
        yield Finding("odd", role, f"{role} jumps by {change[k]:.3g} m/s at t = {time[k + 1]:.6g} s ({len(hard)} such "
                      "places)")


def _counter(role: str, time: Array, counted: Array) -> Iterator[Finding]:
    steps = np.diff(counted)
    back = np.flatnonzero(steps < 0)
    if len(back):
        yield Finding("odd", role, f"the {role} goes back by {-steps[back].min():.4g} m at t = "
                      f"{time[back[np.argmin(steps[back])] + 1]:.6g} s ({len(back)} such places)")
    fast = np.flatnonzero(steps > TOP_SPEED * np.diff(time) + 10 * max(float(np.median(np.abs(steps))), 1.0))
    if len(fast):
        k = fast[np.argmax(steps[fast])]
        yield Finding("impossible", role, f"the {role} jumps by {steps[k]:.4g} m at t = {time[k + 1]:.6g} s "
                      f"({len(fast)} such places): {leave_out(time, fast + 1)}")


def _frozen(role: str, time: Array, values: Array) -> Iterator[Finding]:
    """The same value to the last digit for long: of a speed or acceleration other than zero, or of a place that moved
    just before or moves just after."""
    change = np.flatnonzero(np.diff(values) != 0)
    begins, ends = np.concatenate([[0], change + 1]), np.concatenate([change, [len(values) - 1]])
    long = (time[ends] - time[begins] >= FROZEN) & (ends - begins >= SAMPLES)
    for a, b in zip(begins[long], ends[long], strict=True):
        if role in PLACES:
            before = abs(values[a] - values[a - 1]) / (time[a] - time[a - 1]) if a else 0.0
            after = abs(values[b + 1] - values[b]) / (time[b + 1] - time[b]) if b + 1 < len(values) else 0.0
            moving = max(before, after) > 3.0
        else:
            moving = values[a] != 0
        if moving:
            yield Finding("odd", role, f"{role} is frozen at {values[a]:.6g} from t = {time[a]:.6g} to {time[b]:.6g} s")
            return


def _offside(time: Array, across: Array, there: Index, told: Array) -> Iterator[Finding]:
    off = there[across[there] > OFFSIDE + TOLD * np.nan_to_num(told)[there]]
    if len(off):
        k = off[np.argmax(across[off])]
        yield Finding("odd", "position", f"{len(off)} fixes are off the line, by up to {across[k]:.3g} m at t = "
                      f"{time[k]:.6g} s: {leave_out(time, off)}")
