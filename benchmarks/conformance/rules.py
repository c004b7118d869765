"""The rules an estimator must keep, each with what is expected of it and how to mend a plug-in that breaks it.

A rule is a function of a `Trial` that returns what happened where it is broken."""

from __future__ import annotations

import pickle
import random
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ...estimators.interface import Status, misshapen
from ...scenarios.arrays import Array
from ...scenarios.errors import Unsupported
from ...scenarios.measurement import untold
from ...scenarios.model import DesignModel
from .trial import CLAIMS, DoesNotApply, Record, Rule, Trial, difference, feed
from .walking import walks

ALIKE = 1e-9
"""How far a claimed matrix may be from symmetric and semi-definite, relative to its largest element."""
CERTAIN, SINGULAR = 1e-6, 1e-13
"""Error that an element without variance may have, relative; eigenvalue of correlations that counts as none."""
MATRICES = ("covariance", "ellipsoid")
ABSURD = 1e9


def _shapes(trial: Trial) -> str | None:
    model = trial.case.model(trial.case.tape.initial_mean)
    nx, runs = model.nx, len(trial.case.tape.runs)
    record = trial.record
    if record.status.shape != (runs,):
        return f"status has shape {record.status.shape} for {runs} runs"
    parameters = trial.case.tape.truth.shape[1] - nx
    for estimate, when in zip(record.estimates, record.when, strict=True):
        wrong = misshapen(estimate, nx, runs, parameters)
        if wrong:
            return f"{when} {wrong}"
    return None


def _description(trial: Trial) -> str | None:
    cls = trial.cls
    if not cls.summary.strip():
        return "summary is empty"
    if isinstance(cls.claims, str) or not set(cls.claims) <= set(CLAIMS[1:]):
        return f"claims = {cls.claims!r} holds unknown names; allowed: {', '.join(CLAIMS[1:])}"
    silent = {name for estimate in trial.record.estimates for name in CLAIMS[1:-1]
              if getattr(estimate, name) is not None} - set(cls.claims)
    return f"estimate() gives {', '.join(sorted(silent))}, which claims does not list" if silent else None


def _causality(trial: Trial) -> str | None:
    tape = trial.case.tape
    half = len(tape.shares) // 2
    end = slice(half, None)
    later = tape.copy()
    for values in (later.u, later.y, later.truth):
        values[end] = -1.0 - values[end][::-1]
    later.received[end] = later.received[end][::-1]
    found = difference(trial.feed(later).first(half), trial.record.first(half), statuses=False)
    return f"with other measurements from event {half} on, {found}" if found else None


def _independence(trial: Trial) -> str | None:
    tape = trial.case.tape
    for which in ([3], [4, 0]):
        found = difference(trial.feed(tape.only(which)), trial.record, which)
        if found:
            return f"with only the runs {which} of {len(tape.runs)} in the batch, {found}"
    spoilt = tape.copy()
    spoilt.y[..., 1] = ABSURD
    others = [0, 2, 3, 4]
    found = difference(trial.feed(spoilt).of(others), trial.record, others)
    return f"when run 1 measures nonsense, {found}" if found else None


def _determinism(trial: Trial) -> str | None:
    found = difference(trial.feed(), trial.record)
    if found:
        return f"a second instance on the same tape and random stream: {found}"
    instance = trial.cls(trial.case.parameters)
    trial.feed(trial.case.tape.only([1, 2]), instance=instance)
    found = difference(trial.feed(instance=instance), trial.record)
    return f"an instance that is started a second time: {found}" if found else None


def _no_global_random(trial: Trial) -> str | None:
    kept = random.getstate(), np.random.get_state()  # noqa: NPY002
    try:
        records = []
        for seed in (1, 2):
            random.seed(seed)
            np.random.seed(seed)  # noqa: NPY002
            before = random.getstate(), _numpy_state()
            records.append(trial.feed())
            if before != (random.getstate(), _numpy_state()):
                return "the state of the global generator of random or numpy.random changed"
        return difference(records[1], records[0])
    finally:
        random.setstate(kept[0])
        np.random.set_state(kept[1])  # noqa: NPY002


def _missing(trial: Trial) -> str | None:
    tape = trial.case.tape
    for value in (np.nan, 1e30):
        found = difference(trial.feed(replace(tape, y=np.where(tape.received, tape.y, value))), trial.record)
        if found:
            return f"with {value} in the elements that were not received, {found}"
    return None


def _inputs(trial: Trial) -> str | None:
    tape = trial.case.tape.copy()
    model = trial.case.model(tape.initial_mean)
    watched, original = dict(_arrays(model)), tape.copy()
    before = {name: value.copy() for name, value in watched.items()}
    feed(trial.cls, trial.case, tape, model=model)
    changed = [name for name, value in watched.items() if not np.array_equal(value, before[name], equal_nan=True)]
    changed += [name for name in ("u", "y", "received", "truth")
                if not np.array_equal(getattr(tape, name), getattr(original, name))]
    return f"it changed {', '.join(changed)}" if changed else None


def _claims(trial: Trial) -> str | None:
    for estimate, when in zip(trial.record.estimates, trial.record.when, strict=True):
        for name in MATRICES:
            value = getattr(estimate, name)
            if value is None:
                continue
            for run in range(value.shape[2]):
                wrong = _not_a_covariance(value[:, :, run])
                if wrong and trial.record.status[run] == Status.ok:
                    return f"{when} {name} of run {run} {wrong}"
        if estimate.bound is not None and (~(estimate.bound >= 0) & (trial.record.status == Status.ok)).any():
            return f"{when} bound is {estimate.bound.tolist()}: a mean square is not negative"
    found = _certain_but_wrong(trial)
    if found:
        return found
    last, model = trial.record.estimates[-1], trial.case.model(trial.case.tape.initial_mean)
    missing = [name for name in trial.cls.claims if getattr(last, name) is None
               and (name != "bound" or model.performance is not None)]  # without a performance there is none to bound
    return f"claims lists {', '.join(missing)}, but the last estimate has none" if missing else None


def _certain_but_wrong(trial: Trial) -> str | None:
    """A covariance that leaves no room for the error that there is, at the end of a step."""
    tape, record = trial.case.tape, trial.record
    for event in [first - 1 for first in tape.firsts[1:]] + [len(tape.begins) - 1]:
        estimate = record.estimates[2 * event + 2]
        if estimate.covariance is None:
            continue
        n = len(estimate.covariance)
        covariance = np.broadcast_to(estimate.covariance, (n, n, len(tape.runs)))
        truth = tape.truth[event, :n]
        errors = estimate.mean[:n] - truth
        for run in np.flatnonzero(record.status == Status.ok):
            found = _excluded(covariance[:, :, run], errors[:, run], CERTAIN * (1 + np.abs(truth[:, run])))
            if found:
                return f"{record.when[2 * event + 2]} covariance of run {run} {found}"
    return None


def _excluded(covariance: Array, error: Array, slack: Array) -> str | None:
    """An error (n,) beyond its slack (n,) in a direction in which a covariance (n, n) has no variance."""
    sd = np.sqrt(np.diag(covariance))
    i = int(np.argmax((sd == 0) & (np.abs(error) > slack)))
    if sd[i] == 0 and abs(error[i]) > slack[i]:
        return f"has no variance of element {i}, whose error is {error[i]:.3g}"
    free = sd > 0
    scale = np.outer(sd[free], sd[free])
    values, directions = np.linalg.eigh(covariance[np.ix_(free, free)] / scale)
    far = np.abs(directions.T @ (error[free] / sd[free]))
    allowed = np.abs(directions.T) @ (slack[free] / sd[free])
    if ((values < SINGULAR) & (far > np.maximum(1.0, allowed))).any():
        return f"is singular, and leaves no room for the error {error.tolist()}"
    return None


def _valid_data(trial: Trial) -> str | None:
    status, reasons = trial.record.status, trial.record.reasons
    lost = np.flatnonzero((status != Status.ok) & (status != Status.infeasible))
    if not len(lost):
        return None
    run = int(lost[0])
    return f"{len(lost)} of {len(status)} runs are lost; {run} is {Status(status[run]).name}: {reasons.get(run, '')}"


def _statuses(trial: Trial) -> str | None:
    record = trial.record
    known = [status.value for status in Status]
    if not set(np.unique(record.status)) <= set(known):
        return f"status holds {sorted(set(record.status.tolist()))}; allowed: {known}"
    found = _unflagged(record)
    if found:
        return found
    silent = [run for run in np.flatnonzero(record.status).tolist() if not record.reasons.get(run)]
    if silent:
        return f"statuses are {record.status.tolist()}, but reasons says nothing of run {silent[0]}"
    tape = trial.case.tape
    half = len(tape.shares) // 2
    received = tape.received.copy()
    received[2:2 + half, :, 0] = False
    found = _unflagged(trial.feed(replace(tape, received=received)))
    return f"when run 0 hears nothing for {half} events, {found}" if found else None


def _pickling(trial: Trial) -> str | None:
    fresh = trial.cls(trial.case.parameters)
    if pickle.loads(pickle.dumps(fresh.parameters)) != fresh.parameters:
        return "the unpickled parameters are not equal to the pickled ones"
    found = difference(trial.feed(instance=pickle.loads(pickle.dumps(fresh))), trial.record)
    return f"an instance that was pickled: {found}" if found else None


def _parts(trial: Trial) -> str | None:
    if not trial.case.exact_parts or trial.cls.oracle:
        raise DoesNotApply
    tape = trial.case.tape.copy()
    share = np.array([0.0, 0.4, 1.0])
    events, runs = len(tape.shares), len(tape.runs)
    shares = tuple(share[(np.arange(runs) * 2 + e + e // 3) % 3] for e in range(events))
    idle = np.stack(shares)[:, None, :] == 0.0
    tape = replace(tape, shares=shares, received=tape.received & ~idle)
    try:
        record = trial.feed(tape)
    except Unsupported:
        raise DoesNotApply from None
    for e, part in enumerate(shares):
        before, after = (Record(record.estimates[i:i + 1], record.when[i:i + 1], record.status, {})
                         for i in (2 * e, 2 * e + 2))
        rest = [run for run in range(runs) if part[run] == 0.0]
        found = difference(after.of(rest), before, rest, statuses=False)
        if found:
            return f"a run that goes no part of a step and hears nothing moved: {found}"
    for run in (1, 2):
        found = difference(trial.feed(tape.only([run]), skip=True), record, [run])
        if found:
            return f"alone in its batch, where predictions of no length are not made, {found}"
    return None


def _unflagged(record: Record) -> str | None:
    """A number that is none in a run whose status is ok."""
    for estimate, when in zip(record.estimates, record.when, strict=True):
        for name in CLAIMS:
            value = getattr(estimate, name)
            if value is None:
                continue
            bad = ~np.isfinite(value) if name != "bound" else np.isnan(value)
            bad = np.broadcast_to(bad.reshape(-1, bad.shape[-1]).any(axis=0), record.status.shape)
            run = int(np.argmax(bad & (record.status == Status.ok)))
            if bad[run] and record.status[run] == Status.ok:
                return f"{when} {name} of run {run} is not finite although its status is ok at the end"
    return None


def _not_a_covariance(matrix: Array) -> str | None:
    """What keeps a matrix (n, n) from being symmetric and positive semi-definite, up to rounding."""
    if not np.isfinite(matrix).all():
        return "is not finite"
    slack = ALIKE * np.abs(matrix).max()
    if np.abs(matrix - matrix.T).max() > slack:
        return f"is not symmetric: {matrix.tolist()}"
    least = np.linalg.eigvalsh((matrix + matrix.T) / 2)[0]
    return f"has the negative eigenvalue {least:.3g}" if least < -slack else None


def _numpy_state() -> bytes:
    return pickle.dumps(np.random.get_state())  # noqa: NPY002


def _arrays(model: DesignModel) -> Iterator[tuple[str, Array]]:
    """The arrays a design model holds or hands out, by name."""
    for name, value in (*vars(model).items(), *(("measurement_covariance", r(untold(0, model.ny)))
                                                for r in [model.measurement_covariance] if r)):
        if isinstance(value, np.ndarray):
            yield name, value
    for part in (model.bounds, model.modes and model.modes.grid):
        for name, value in vars(part).items() if part else ():
            if isinstance(value, np.ndarray):
                yield f"{type(part).__name__.lower()}.{name}", value
    if model.linear:
        for name in "ABhCQR":
            yield f"linear.{name}", getattr(model.linear, name)(0)


RULES = (
    Rule("shapes",
         "arrays with the runs as their last axis: mean (nx, S), covariance and ellipsoid (n, n, S or 1), bound "
         "(S or 1,), parameter (np, S), status (S,)",
         "give every array its runs axis; call super().start(model, runs, random) first in start", _shapes),
    Rule("description",
         "a one-line summary; needs and claims name parts of DesignModel and Estimate; claims has all that is claimed",
         "set the class attributes summary, needs = (..) and claims = (..)", _description),
    Rule("causality",
         "what comes later changes nothing before",
         "use only what predict and update have been given so far; keep nothing on the class between batches",
         _causality),
    Rule("independence",
         "a run's numbers are the same to the last bit in any batch and whatever other runs measure",
         "combine nothing over the last axis and let no BLAS (@, dot, einsum, linalg) touch it: loops over the small "
         "indices, or the functions of railstate.estimators.kernels", _independence),
    Rule("determinism",
         "the same tape and random stream give the same bits, and start begins anew",
         "draw only from the `random` handed to start; set in start all that changes, nothing on the class",
         _determinism),
    Rule("global random state",
         "no use of the global generators of random and numpy.random",
         "draw from the `random` handed to start: random.normal(n), random.uniform(low, high, n), random.generators[s]",
         _no_global_random),
    Rule("missing measurements",
         "elements of y that were not received are never used",
         "take y through the mask: np.where(received, y - predicted, 0.0), before any arithmetic that passes a NaN on",
         _missing),
    Rule("inputs",
         "u, y, received, the truth and the design model's arrays are left as they are",
         "copy before changing: x = model.initial_mean.copy(), no in-place operators on what was handed in", _inputs),
    Rule("claims",
         "covariances and ellipsoids symmetric and positive semi-definite, with room for the errors made, bounds not "
         "negative, all of `claims` made",
         "symmetrise (P + P') / 2, use the Joseph form, claim no certainty that is none, or drop the claim", _claims),
    Rule("statuses",
         "finite numbers wherever status is ok; a reason wherever it is not",
         "flag(self, failed, Status.failed, 'why') for the runs (S,) that went wrong", _statuses),
    Rule("valid data",
         "no run is lost on the data of the model or of a scenario, unless its design is infeasible",
         "see the reason: a filter that works on such data flags none", _valid_data),
    Rule("pickling",
         "class, parameters and instance survive pickling, since runs go to other processes",
         "define the class at the top level of a module; keep lambdas, files and locks out of __init__", _pickling),
    Rule("parts of a step",
         "a run whose interval has no length stays as it is, its random stream too; a method for whole steps raises "
         "Unsupported",
         "take transition(x, u, interval), draw with which=interval.moving(self.runs), or call whole_steps(interval)",
         _parts),
    Rule("walks",
         "walk says of many periods what predict and update say of them one by one, to the bit",
         "call in walk the same functions in the same order; return None for a course it does not know", walks),
)
