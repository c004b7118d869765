"""The design model: what an estimator is *told*. Truth lives in `world.py`; mismatch between the two is the point.

All callables work on arrays whose *last* axis is the runs; extra axes (sigma points) may stand in between."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from .arrays import Array, read_only
from .compiled import Compiled, LinearSteps, WholeSteps, accumulate, affine
from .densities import Densities
from .errors import InputError, Unsupported
from .measurement import Course, Interval, Measurement, told


@dataclass(frozen=True)
class Linear:
    """x(k+1) = A x + B u + h + process noise, y = C x + measurement noise. Matrices may depend on the step k.

    A (nx, nx), B (nx, nu), h (nx,), C (ny, nx), Q (nx, nx), R (ny, ny); `constant` promises that k does not matter.
    `A(k)` leads from step k to step k + 1; `C(k)`, `R(k)` belong to the measurement of step k; step 0 is the start.
    steps: how many steps the matrices are known for; None: any number."""

    A: Callable[[int], Array]
    B: Callable[[int], Array]
    h: Callable[[int], Array]
    C: Callable[[int], Array]
    Q: Callable[[int], Array]
    R: Callable[[int], Array]
    constant: bool = True
    steps: int | None = None


@dataclass(frozen=True)
class Bounds:
    """Unknown-but-bounded knowledge: x+ = f(x, u) + G w, |w_i| <= w_bar_i; y = h(x) + v, |v_i| <= v_bar_i.

    G (nx, nw), w_bar (nw,), v_bar (ny,). Linearisation error f(x) - f(x^) = (A + M Delta N) e with |Delta| <= 1,
    M (nx, 1), N (1, nx) without its factor kappa; `kappa(x, u, Pi)` gives that factor, shape (S,), from the estimate
    (nx, S), input (nu, S) and the error bound's shape matrix Pi (nx, nx, S). None: the plant is linear.
    v_bar_i infinite: sensor i has no bound. `part(interval)`: G of a part of a step, (nx, nw, S or 1); None: G, M and N
    hold for whole steps only."""

    G: Array
    w_bar: Array
    v_bar: Array
    M: Array | None = None
    N: Array | None = None
    kappa: Callable[[Array, Array, Array], Array] | None = None
    part: Callable[[Interval], Array] | None = None


@dataclass(frozen=True)
class Grid:
    """A discrete parameter theta on a grid, a linear model for each value, as stacked matrices.

    grid (m,); A (m, nx, nx), B (m, nx, nu) exact zero-order hold; C (ny, nx); Q (nx, nx); R (ny, ny).
    prior (m,) over the grid; name and unit of the parameter."""

    name: str
    grid: Array
    A: Array
    B: Array
    C: Array
    Q: Array
    R: Array
    prior: Array


@dataclass(frozen=True)
class Mode:
    """A hypothesis: a whole design model of the same states and measurements, and what it is called.

    value: where modes stand for a number that is estimated; NaN otherwise."""

    name: str
    model: DesignModel
    value: float = math.nan


@dataclass(frozen=True)
class Modes:
    """Hypotheses of which one holds at a time, with prior (m,) and transition (m, m) over one sampling period, from
    row to column; an interval of p periods takes its power p. transition None: the estimator chooses.

    grid: the same as stacked matrices where the modes are values of a parameter on a grid, linear each; else None."""

    modes: tuple[Mode, ...]
    prior: Array
    transition: Array | None = None
    grid: Grid | None = None


@dataclass(frozen=True)
class Inclusion:
    """What surely holds of the first n states: intervals [low, high] from bounds of all errors, none of them random.

    low, high (n, 1 or S): at the start. predict(low, high, u, interval), observe(low, high, measurement): (n, S)
    each, the intervals after them."""

    low: Array
    high: Array
    predict: Callable[[Array, Array, Array, Interval], tuple[Array, Array]]
    observe: Callable[[Array, Array, Measurement], tuple[Array, Array]]


@dataclass(frozen=True)
class Reception:
    """What is known of the channel: bounds of the reception probability, or each node's probability and sensors.

    p_low <= Prob(received) <= p_high; `variance` bounds Prob (1 - Prob) where that is known better than from the
    interval (p-persistent CSMA). `nodes[i]` lists the measurement indices of node i, `p[i]` its probability of
    being the one that transmits (random access). `breaks`: why no guarantee holds over this channel, such as one that
    counts on independent draws; `spoils`: why no covariance does either; empty where they may."""

    p_low: float = 1.0
    p_high: float = 1.0
    nodes: tuple[tuple[int, ...], ...] = ()
    p: tuple[float, ...] = ()
    variance: float | None = None
    breaks: str = ""
    spoils: str = ""


@dataclass(frozen=True)
class DesignModel:
    """What an estimator is told of the plant. Optional parts are None where the scenario does not give them.

    transition(x, u, interval): (nx, .., S) -> (nx, .., S), the state at the end of the interval; u (nu, S) is the whole
    step's input, of which `interval.share` falls into it.
    measurement(x, step): (nx, .., S) -> (ny, .., S).
    transition_jacobian(x, u, interval): (nx, S) -> (nx, nx, S) or (nx, nx, 1) where all runs share it.
    measurement_jacobian(x, step): (nx, S) -> (ny, nx, S or 1).
    input_jacobian(x, u, interval): (nx, nu, S or 1), df/du, for scales on inputs; may be None.
    process_covariance(x, u, interval): (nx, nx, S or 1), PSD. Parts of a step need not add up to the whole.
    measurement_covariance(measurement): (ny, ny, S or 1), PD: what the sensors tell, else the model's own (`told`).
    initial_mean (nx, S); initial_covariance (nx, nx, 1). performance: M (nz, nx) of z = M x.
    S is the number of runs of the arrays passed in, which need not be the batch's: adapters ask run by run.
    whole: the same for whole sampling periods in machine code (`over`), where the setting gives that.
    densities: noise that is not Gaussian, for particle filters; its moments are those of the covariances.
    appended: how many states stand behind the setting's own (`augmented`); those are not scored and steer nothing.
    linear_measurement: promises measurement(x, step) = H(step) x + constant, with one measurement_jacobian for every x,
    by which sigma-point filters then update exactly. Transition and its Jacobian may be `Compiled`.
    tells: measurements whose sensors tell their own covariance, so that an estimator that cannot use it refuses.
    `details` carries plant-specific knowledge for estimators written for that plant (keys told by the setting)."""

    states: tuple[str, ...]
    measurements: tuple[str, ...]
    period: float
    transition: Callable[[Array, Array, Interval], Array]
    measurement: Callable[[Array, int], Array]
    transition_jacobian: Callable[[Array, Array, Interval], Array] | None
    measurement_jacobian: Callable[[Array, int], Array] | None
    process_covariance: Callable[[Array, Array, Interval], Array] | None
    measurement_covariance: Callable[[Measurement], Array] | None
    initial_mean: Array
    initial_covariance: Array
    linear: Linear | None = None
    bounds: Bounds | None = None
    modes: Modes | None = None
    reception: Reception | None = None
    performance: Array | None = None
    details: dict[str, object] = field(default_factory=dict)
    inclusion: Inclusion | None = None
    tells: tuple[str, ...] = ()
    input_jacobian: Callable[[Array, Array, Interval], Array] | None = None
    appended: int = 0
    linear_measurement: bool = False
    densities: Densities | None = None
    whole: WholeSteps | LinearSteps | None = None

    def __post_init__(self) -> None:
        """Raises InputError for functions of the first edition, which took a step and a portion of it."""
        for name in ("transition", "transition_jacobian", "process_covariance"):
            if _wants(getattr(self, name)) == 4:
                raise InputError(
                    f"DesignModel.{name}(x, u, k, portion) is of railstate's first edition: write {name}(x, u, "
                    "interval), with interval.length in seconds, interval.share of the step's input and "
                    "interval.depart for k; measurement_covariance(measurement) likewise, with measurement.step for k")
        for name in ("initial_mean", "initial_covariance"):
            object.__setattr__(self, name, read_only(np.ascontiguousarray(getattr(self, name), dtype=float)))

    def over(self, course: Course) -> WholeSteps | LinearSteps | None:
        """`whole`, where it stands for the functions that this model has, and for the periods of a course."""
        whole = self.whole
        return whole if whole is not None and whole.of == self.functions and course.period == self.period else None

    @property
    def functions(self) -> tuple[object, ...]:
        """What `whole` stands for."""
        return (self.transition, self.transition_jacobian, self.measurement, self.measurement_jacobian,
                self.process_covariance, self.measurement_covariance)

    @property
    def nx(self) -> int:
        return len(self.states)

    @property
    def own(self) -> int:
        """How many leading states are the setting's own."""
        return len(self.states) - self.appended

    @property
    def ny(self) -> int:
        return len(self.measurements)


def _wants(function: Callable[..., object] | None) -> int:
    """How many arguments a function must be given; 0 where that cannot be told."""
    try:
        asked = inspect.signature(function).parameters.values() if function else ()
    except (TypeError, ValueError):
        return 0
    return sum(one.default is one.empty and one.kind in (one.POSITIONAL_ONLY, one.POSITIONAL_OR_KEYWORD)
               for one in asked)


def whole_steps(interval: Interval, who: str) -> None:
    """Raise Unsupported where a prediction goes a part of a step only."""
    if not interval.whole:
        raise Unsupported(f"{who} knows whole sampling periods only, not parts of one")


def linear_model(
    linear: Linear,
    *,
    states: tuple[str, ...],
    measurements: tuple[str, ...],
    period: float,
    initial_mean: Array,
    initial_covariance: Array,
    **parts: object,
) -> DesignModel:
    """A design model from its matrices: the callables of `DesignModel` filled in.

    The matrices are those of whole steps: asked for a part of one, the transition raises Unsupported."""

    def packed(k: int) -> Array:
        A, B = linear.A(k), linear.B(k)
        return np.concatenate([B.shape, *map(np.ravel, (A, B, linear.h(k)))])

    always = packed(0) if linear.constant else None

    def given(interval: Interval, runs: int) -> tuple[Array, Array]:
        whole_steps(interval, "this linear design model")
        return packed(interval.depart) if always is None else always, np.empty(runs)

    transition = Compiled(affine, linear.B(0).shape[1], given)
    model = DesignModel(
        states=states, measurements=measurements, period=period, transition=transition,
        transition_jacobian=lambda x, u, interval: linear.A(interval.depart)[:, :, None],
        measurement=lambda x, step: product(linear.C(step), x),
        measurement_jacobian=lambda x, step: linear.C(step)[:, :, None],
        process_covariance=lambda x, u, interval: linear.Q(interval.depart)[:, :, None],
        measurement_covariance=told(lambda step: linear.R(step)[:, :, None]),
        initial_mean=initial_mean, initial_covariance=initial_covariance, linear=linear, linear_measurement=True,
        **parts)  # pyright: ignore[reportArgumentType]
    if always is None or np.count_nonzero(linear.R(0)) > np.count_nonzero(linear.R(0).diagonal()):
        return model
    F, Q, H, R = (np.array(matrix(0)[:, :, None], dtype=float, order="C") for matrix in (
        linear.A, linear.Q, linear.C, linear.R))
    return replace(model, whole=LinearSteps(transition, always, F, Q, H, R, model.functions))


def grid_modes(grid: Grid, model: DesignModel) -> Modes:
    """A grid's values as modes: design models with its matrices and everything else of `model`."""
    zero = np.zeros(model.nx)

    def mode(A: Array, B: Array, value: float) -> Mode:
        linear = Linear(lambda k: A, lambda k: B, lambda k: zero, lambda k: grid.C, lambda k: grid.Q, lambda k: grid.R)
        return Mode(f"{grid.name} {value:g}", linear_model(
            linear, states=model.states, measurements=model.measurements, period=model.period,
            initial_mean=model.initial_mean, initial_covariance=model.initial_covariance), value)

    return Modes(tuple(map(mode, grid.A, grid.B, grid.grid.tolist())), grid.prior, None, grid)


def bounds_of(model: DesignModel) -> Bounds:
    """The model's bounds, which an estimator's `needs` has made sure of."""
    assert model.bounds is not None
    return model.bounds


def grid_of(model: DesignModel, who: str) -> Grid:
    """The grid of a design model's modes. Raises Unsupported where there is none."""
    if model.modes is None or model.modes.grid is None:
        raise Unsupported(f"{who} needs modes that are values of a parameter on a grid, a linear model for each")
    return model.modes.grid


def product(matrix: Array, x: Array) -> Array:
    """matrix (m, n) times x (n, .., S) as sums over the small index: bit-identical for any number of runs (no BLAS)."""
    out = np.zeros((matrix.shape[0], *x.shape[1:]))
    points, sums = x, out
    if x.ndim != 2:
        columns = math.prod(x.shape[1:])
        points, sums = x.reshape(len(x), columns), out.reshape(len(out), columns)
    accumulate(read_only(np.ascontiguousarray(matrix, dtype=float)),
               read_only(np.ascontiguousarray(points, dtype=float)), sums)
    return out
