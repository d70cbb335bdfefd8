"""Linear models of motion and measurement, and tracks simulated from them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from inspect import Signature, signature
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from . import _checks as checks
from ._checks import Array, Seconds
from ._engine.columns import block_diagonal
from ._engine.shared import Step, products_for, run_shared
from ._immutable import Immutable
from .equations import square_root

# dt in s -> F and Q of a step of that length.
Transition = Callable[[float], tuple[Array, Array]]
# Largest relative difference between two half steps of a transition and one whole step. A Q that is computed as a
# difference of large numbers must keep six digits.
HALF_STEP_TOLERANCE = 1e-6
# Entries of F smaller than this fraction of the largest one are judged as if they had this size, since rounding turns a
# zero into 1e-16. (Not so for Q: over short steps, an entry may rightly be 1e-18 of the largest.)
F_FLOOR = 1e-9
TINY = np.finfo(float).tiny


@dataclass(frozen=True, eq=False, init=False)
class LinearModel(Immutable):
    """A linear model of motion and measurement (2014 Eq. 1, 2015 Section 2).

        x(k+1) = F x(k) + w(k),     w ~ N(0, Q)
        z(k)   = H x(k) + v(k),     v ~ N(0, R)

    A model is immutable; `dataclasses.replace` makes another one. With another dt or transition it has the F and Q that
    the transition makes. With another F or Q it has no transition. A model without a transition takes another dt only
    together with F and Q.

    Parameters
    ----------
    F, H : array_like (n, n), (m, n)
        Transition matrix of one step, and measurement matrix. F is left out where a `transition` is given.
    Q, R : array_like (n, n), (m, m)
        Covariances of the process noise of one step (the papers' G Q Gᵀ) and of the measurement noise. Q is left out
        where a `transition` is given.
    x0, P0 : array_like (n,), (n, n), optional
        Mean and covariance of x(0), zero where not given, as in the papers.
    dt : float or timedelta, optional
        Length of a step in s. Without it, a step counts as 1 s where seconds are needed.
    transition : callable, optional
        transition(dt) returns F and Q of a step of dt seconds, as arrays, for tracks with times of their own. Two steps
        of dt / 2 must equal one of dt. For a model that can be pickled, use a function of a module, or a frozen
        dataclass with `__call__`.

    Raises
    ------
    ValueError, TypeError
        For matrices that do not fit together, an R that is not positive definite, a Q or P0 that is not a covariance, a
        transition that is not one or stands beside F or Q, and in `replace`, another dt that does not fit F and Q.

    Examples
    --------
    A position and its constant velocity, which changes a little in each step:

    >>> import mpt_helpers as mpt
    >>> model = mpt.LinearModel(F=[[1, 1], [0, 1]], Q=[[0, 0], [0, 0.01]], H=[[1, 0]], R=[[0.5]], P0=np.eye(2))
    >>> mpt.KalmanFilter(model).filter([[1.0], [2.0]]).round(2)
    array([[0.8 , 0.4 ],
           [1.79, 0.74]])

    A distance that returns to zero within about tau seconds (an Ornstein-Uhlenbeck process of standard deviation
    sigma), for steps of any length. `expm1` keeps the digits of short steps:

    >>> def returning(dt, tau=20.0, sigma=3.0):
    ...     F = [[np.exp(-dt / tau)]]
    ...     Q = [[-(sigma**2) * np.expm1(-2 * dt / tau)]]
    ...     return np.array(F), np.array(Q)
    >>> model = mpt.LinearModel(transition=returning, dt=1.0, H=[[1]], R=[[0.5]], P0=[[9.0]])
    >>> mpt.KalmanFilter(model, t=[0.0, 1.0, 60.0]).filter([[2.0], [np.nan], [0.1]]).round(2)
    array([[1.89],
           [1.8 ],
           [0.1 ]])

    """

    F: Array
    H: Array
    Q: Array
    R: Array
    x0: Array
    P0: Array
    dt: float | None
    transition: Transition | None
    # F, Q, the dt that they are for, and the transition. `replace` hands them on: an F that is still the same object
    # has not been given anew.
    _origin: tuple[Array, Array, float | None, Transition | None] = field(repr=False, compare=False)

    def __init__(
        self,
        *,
        F: ArrayLike | None = None,
        H: ArrayLike,
        Q: ArrayLike | None = None,
        R: ArrayLike,
        x0: ArrayLike | None = None,
        P0: ArrayLike | None = None,
        dt: Seconds | None = None,
        transition: Transition | None = None,
        _origin: tuple[Array | None, Array | None, float | None, Transition | None] = (None, None, None, None),
    ):
        if dt is not None:
            dt = checks.duration("dt", dt)
        F, Q, transition = _one_step(F, Q, dt, transition, _origin)
        n, m = checks.rows("F", F), checks.rows("H", H)
        given = {
            "F": checks.array("F", F, (n, n)),
            "H": checks.array("H", H, (m, n)),
            "Q": checks.covariance("Q", Q, n),
            "R": checks.covariance("R", R, m, definite=True),
            "x0": checks.array("x0", np.zeros(n) if x0 is None else x0, (n,)),
            "P0": checks.covariance("P0", np.zeros((n, n)) if P0 is None else P0, n),
        }
        made = given["F"], given["Q"], _origin[2] if dt is None else dt, transition
        for name, value in (given | {"dt": dt, "transition": transition, "_origin": made}).items():
            object.__setattr__(self, name, value)

    def over(self, dt: ArrayLike) -> tuple[Array, Array]:
        """Return F and Q of a step of dt seconds, or of many.

        Parameters
        ----------
        dt : array_like (...)
            Lengths of the steps, not negative: in s, or timedeltas.

        Returns
        -------
        tuple of ndarray (..., n, n)
            F and Q of each step.

        Raises
        ------
        ValueError
            For a model without a transition, and for lengths that are negative or not finite.

        Examples
        --------
        >>> import mpt_helpers as mpt
        >>> mpt.constant_velocity(dt=2.0, q=0.01, r=0.1).over(3.0)[0]
        array([[1., 3.],
               [0., 1.]])

        """
        return _F_and_Q(require_transition("dt", self), checks.lengths("dt", dt))

    def with_noise_times(self, factor: float) -> LinearModel:
        """Return the model with its process noise scaled: Q times a factor, over steps of any length.

        Parameters
        ----------
        factor : float
            The factor, not negative.

        Returns
        -------
        LinearModel
            The scaled model.

        Examples
        --------
        >>> import mpt_helpers as mpt
        >>> mpt.constant_velocity(dt=1.0, q=0.06, r=0.1).with_noise_times(2.0).Q
        array([[0.04, 0.06],
               [0.06, 0.12]])

        """
        factor = checks.not_negative("factor", factor)
        if self.transition is None:
            return replace(self, Q=factor * self.Q)
        return replace(self, transition=Scaled(self.transition, factor))

    @property
    def n(self) -> int:
        """Dimension of the state."""
        return len(self.F)

    @property
    def m(self) -> int:
        """Dimension of the measurement."""
        return len(self.H)


# `_origin` is for `dataclasses.replace` alone: help and editors do not show it.
_shown = [each for each in signature(LinearModel).parameters.values() if each.name != "_origin"]
LinearModel.__signature__ = Signature(_shown)  # type: ignore[attr-defined]


def require_transition(name: str, model: LinearModel) -> Transition:
    """Return the transition of a model, or raise a ValueError that names the argument for which it is needed."""
    if model.transition is None:
        need = "a model with a transition, such as constant_velocity"
        checks.refuse(name, need, "one whose F and Q are for one length only")
    return model.transition


def _one_step(F, Q, dt, transition, before):
    """Return F and Q of a step of dt, and the transition, or None where F or Q is given in its place.

    `before` are F, Q, dt and the transition of the model that `replace` changes: they do not count as given.
    """
    F_before, Q_before, dt_before, transition_before = before
    F_is_given = F is not None and F is not F_before
    Q_is_given = Q is not None and Q is not Q_before
    if transition is None:
        if None not in (dt, dt_before) and dt != dt_before and not (F_is_given and Q_is_given):
            need = f"a transition, or F and Q of such a step: those of the model are for {dt_before:g} s"
            checks.refuse("dt", need, f"{dt:g} s")
        return F, Q, None
    if dt is None:
        checks.refuse("dt", "a length of step, since the model has a transition", None, TypeError)
    F_made, Q_made = _checked_step(transition, dt)
    if not (F_is_given or Q_is_given):
        return F_made, Q_made, transition
    if transition is not transition_before:
        checks.refuse("transition", "to be given without F and Q, which it makes", "F or Q as well")
    return F if F_is_given else F_made, Q if Q_is_given else Q_made, None


def _checked_step(transition, dt):
    """Check a transition and return its F and Q of one step of dt."""
    need = "a function of dt that returns F and Q as arrays"
    if not callable(transition):
        checks.refuse("transition", need, f"{transition!r:.60}", TypeError)
    both = transition(dt)
    if not (isinstance(both, tuple) and [type(each) for each in both] == [np.ndarray, np.ndarray]):
        checks.refuse("transition", need, f"{both!r:.60}", TypeError)
    n = checks.rows("transition", both[0])
    F, Q = (checks.array("transition", each, (n, n)) for each in both)
    F_0, Q_0 = transition(0.0)
    if not np.array_equal(F_0, np.eye(n)) or np.any(Q_0):
        checks.refuse("transition", "F = I and Q = 0 over a step of zero", "another F or Q")
    missed = half_step_gap(transition, dt)
    if missed > HALF_STEP_TOLERANCE:
        checks.refuse("transition", "two steps of dt / 2 to be one of dt", f"{missed:.2g} of their size between them")
    return F, Q


def _F_and_Q(transition, dt):
    """Return F and Q of one or many steps; a transition that takes a single dt is called once for each length."""
    if getattr(transition, "takes_arrays", False) or np.ndim(dt) == 0:
        return transition(dt)
    lengths, which = np.unique(dt, return_inverse=True)
    each = [transition(length) for length in lengths.tolist() or [0.0]]  # without a length, the shapes of any step
    F, Q = zip(*each, strict=True)
    which = which.reshape(np.shape(dt))  # numpy 2.0 returned another shape than 1.26 and 2.1
    return np.array(F)[which], np.array(Q)[which]


def half_step_gap(transition: Transition, dt: float) -> float:
    """Return the largest relative difference of F and Q between two steps of dt / 2 and one of dt."""
    with np.errstate(over="ignore", invalid="ignore"):
        (half, noise), (F, Q) = transition(dt / 2), transition(dt)
        missed_F, missed_Q = half @ half - F, half @ noise @ half.T + noise - Q
        half, noise = np.abs(half), np.abs(noise)
        F_size, Q_size = half @ half, half @ noise @ half.T + noise  # the sizes of the terms that are added
        F_size = np.maximum(F_size, F_FLOOR * F_size.max())
        gaps = np.abs([missed_F, missed_Q]) / np.maximum([F_size, Q_size], TINY)
    return float(np.nan_to_num(gaps, nan=np.inf, posinf=np.inf).max())


def _steps_first(rows):
    """Return matrices (..., n, n) from n rows of n entries, all of them numbers or all of them arrays (...)."""
    matrices = np.asarray(rows, float)
    return matrices.transpose(*range(2, matrices.ndim), 0, 1)


@dataclass(frozen=True)
class ConstantVelocity:
    """The transition of nearly constant velocity: white acceleration of spectral density q (m²/s³)."""

    q: float
    takes_arrays: ClassVar[bool] = True

    def __call__(self, dt: ArrayLike) -> tuple[Array, Array]:
        """Return F and Q of steps of dt seconds."""
        dt2 = dt * dt
        zero, one = 0 * dt, 0 * dt + 1
        F = _steps_first([[one, dt], [zero, one]])
        return F, self.q * _steps_first([[dt2 * dt / 3, dt2 / 2], [dt2 / 2, dt]])


@dataclass(frozen=True)
class ConstantAcceleration:
    """The transition of nearly constant acceleration: white jerk of spectral density q (m²/s⁵)."""

    q: float
    takes_arrays: ClassVar[bool] = True

    def __call__(self, dt: ArrayLike) -> tuple[Array, Array]:
        """Return F and Q of steps of dt seconds."""
        dt2 = dt * dt
        dt3, dt4 = dt2 * dt, dt2 * dt2
        zero, one = 0 * dt, 0 * dt + 1
        F = _steps_first([[one, dt, dt2 / 2], [zero, one, dt], [zero, zero, one]])
        Q = [[dt4 * dt / 20, dt4 / 8, dt3 / 6], [dt4 / 8, dt3 / 3, dt2 / 2], [dt3 / 6, dt2 / 2, dt]]
        return F, self.q * _steps_first(Q)


@dataclass(frozen=True)
class SideBySide:
    """The transitions of several axes side by side, as one of block-diagonal F and Q."""

    transitions: tuple[Transition, ...]
    takes_arrays: ClassVar[bool] = True

    def __call__(self, dt: ArrayLike) -> tuple[Array, Array]:
        """Return F and Q of steps of dt seconds."""
        F, Q = zip(*(_F_and_Q(transition, dt) for transition in self.transitions), strict=True)
        return _block_diagonal(F), _block_diagonal(Q)


@dataclass(frozen=True)
class Scaled:
    """A transition with the same F, and `factor` times the Q."""

    transition: Transition
    factor: float
    takes_arrays: ClassVar[bool] = True

    def __call__(self, dt: ArrayLike) -> tuple[Array, Array]:
        """Return F and Q of steps of dt seconds."""
        F, Q = _F_and_Q(self.transition, dt)
        return F, self.factor * np.asarray(Q)


def _block_diagonal(stacks):
    """Return stacks of matrices (..., n_i, n_i) as one stack of block diagonal matrices (..., n, n)."""
    return _steps_first(block_diagonal(np.moveaxis(each, (-2, -1), (0, 1)) for each in stacks))


def gsm_axis(dt: Seconds, q: float, r: float, x0: ArrayLike | None = None, P0: ArrayLike | None = None) -> LinearModel:
    """Return the papers' model of one axis, which measures the *next* position (2014 Eq. 3, model B of 2015 Section 2).

    If the measurements are of the present position, use `constant_velocity`: with this model the estimates would be one
    step late.

        F = [1 dt; 0 1],   G = [dt/2; 1],   Q = G q Gᵀ,   H = [1 dt],   R = r

    Parameters
    ----------
    dt : float or timedelta
        Time step in s.
    q : float
        Variance of the change of velocity in one step in m²/s², not negative.
    r : float
        Variance of a measurement in m², positive.
    x0, P0 : array_like (n,), (n, n), optional
        Mean and covariance of x(0), zero where not given.

    Returns
    -------
    LinearModel
        The model, whose states are position and velocity.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> mpt.gsm_axis(dt=1.0, q=0.01, r=0.1).Q
    array([[0.0025, 0.005 ],
           [0.005 , 0.01  ]])

    """
    dt, q, r = _positive(dt, q, r)
    G = np.array([[dt / 2], [1.0]])
    return LinearModel(F=[[1, dt], [0, 1]], H=[[1, dt]], Q=q * G @ G.T, R=[[r]], x0=x0, P0=P0, dt=dt)


def constant_velocity(
    dt: Seconds, q: float, r: float, x0: ArrayLike | None = None, P0: ArrayLike | None = None
) -> LinearModel:
    """Return the model of one axis with nearly constant velocity and measured position (2016 Eq. 5).

        F = [1 dt; 0 1],   H = [1 0],   Q = [dt³/3 dt²/2; dt²/2 dt] q,   R = r

    Parameters
    ----------
    dt : float or timedelta
        Time step in s.
    q : float
        Spectral density of the white acceleration, in m²/s³: the growth per second of the velocity's variance.
    r : float
        Variance of a measurement in m², positive.
    x0, P0 : array_like (n,), (n, n), optional
        Mean and covariance of x(0), zero where not given.

    Returns
    -------
    LinearModel
        The model, whose states are position and velocity.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> mpt.constant_velocity(dt=1.0, q=0.06, r=0.1).Q
    array([[0.02, 0.03],
           [0.03, 0.06]])

    """
    dt, q, r = _positive(dt, q, r)
    return LinearModel(transition=ConstantVelocity(q), dt=dt, H=[[1, 0]], R=[[r]], x0=x0, P0=P0)


def constant_acceleration(
    dt: Seconds, q: float, r: float, x0: ArrayLike | None = None, P0: ArrayLike | None = None
) -> LinearModel:
    """Return the model of one axis with nearly constant acceleration and measured position (2016 Eq. 6).

    Q is that of Section 5.2: Eq. 6 itself misprints dt³/6 in its first row as dt³/3.

        F = [1 dt dt²/2; 0 1 dt; 0 0 1],   H = [1 0 0],   R = r
        Q = [dt⁵/20 dt⁴/8 dt³/6; dt⁴/8 dt³/3 dt²/2; dt³/6 dt²/2 dt] q

    Parameters
    ----------
    dt, q, r, x0, P0 : float, array_like
        As for `constant_velocity`, but q is the spectral density of the white jerk, in m²/s⁵.

    Returns
    -------
    LinearModel
        The model, whose states are position, velocity and acceleration.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> mpt.constant_acceleration(dt=1.0, q=0.12, r=0.1).Q
    array([[0.006, 0.015, 0.02 ],
           [0.015, 0.04 , 0.06 ],
           [0.02 , 0.06 , 0.12 ]])

    """
    dt, q, r = _positive(dt, q, r)
    return LinearModel(transition=ConstantAcceleration(q), dt=dt, H=[[1, 0, 0]], R=[[r]], x0=x0, P0=P0)


def gps_ins(
    dt: Seconds, q: float, r: ArrayLike, x0: ArrayLike | None = None, P0: ArrayLike | None = None
) -> LinearModel:
    """Return the model of GPS and INS on one axis, with the bias of the INS (2007 Eq. 11).

        F = [1 dt 0; 0 1 0; 0 0 1],   H = [1 0 0; 0 1 1; 1 -dt 0],   Q = diag(0, q, 0),   R = diag(r)

    The rows of H are the position from GPS, the velocity with its bias from the INS, and a third row that the paper
    does not explain: s - v dt, the position one step before.

    Parameters
    ----------
    dt : float or timedelta
        Time step in s.
    q : float
        Variance of the change of velocity in one step in m²/s², not negative. The paper prints no Q.
    r : array_like (2,) or (3,)
        Variances of the first two rows of H (m², m²/s²), or of all three (m², m²/s², m²).
    x0, P0 : array_like (3,), (3, 3), optional
        Mean and covariance of x(0), zero where not given.

    Returns
    -------
    LinearModel
        The model, whose states are position, velocity and bias.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> mpt.gps_ins(dt=1.0, q=0.0, r=(1.0, 1e-4)).H
    array([[1., 0., 0.],
           [0., 1., 1.]])

    """
    r = checks.real_numbers("r", r, "two or three variances", (2,), (3,)).astype(float)
    for variance in r.tolist():
        dt, q, _ = _positive(dt, q, variance)
    F = [[1, dt, 0], [0, 1, 0], [0, 0, 1]]
    H = [[1, 0, 0], [0, 1, 1], [1, -dt, 0]]
    return LinearModel(F=F, H=H[: len(r)], Q=np.diag([0, q, 0]), R=np.diag(r), x0=x0, P0=P0, dt=dt)


def _positive(dt, q, r):
    return checks.duration("dt", dt), checks.not_negative("q", q), checks.positive("r", r)


def stack(*models: LinearModel) -> LinearModel:
    """Return one model of several axes: model A of the papers (2014 Eq. 2, 2015 Section 2).

    Every matrix is block diagonal, and the states follow one another: [s_x v_x s_y v_y ...].

    Parameters
    ----------
    *models : LinearModel
        The models of the axes, with the same dt where they have one.

    Returns
    -------
    LinearModel
        The model of all axes.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> axis = mpt.constant_velocity(dt=1.0, q=0.01, r=0.1)
    >>> mpt.stack(axis, axis).H
    array([[1., 0., 0., 0.],
           [0., 0., 1., 0.]])

    """
    if not models:
        checks.refuse("models", "at least one model", "none")
    for i, model in enumerate(models):
        checks.instance(f"models[{i}]", model, LinearModel)
    steps = {model.dt for model in models if model.dt is not None}
    if len(steps) > 1:
        checks.refuse("models", "models of the same dt", " and ".join(f"{model.dt} s" for model in models))

    def diagonal(name):
        return block_diag(*[getattr(model, name) for model in models])

    given = {name: diagonal(name) for name in ("H", "R", "P0")} | {"x0": np.concatenate([model.x0 for model in models])}
    given["dt"] = next(iter(steps), None)
    if any(model.transition is None for model in models):
        return LinearModel(F=diagonal("F"), Q=diagonal("Q"), **given)
    axes = [each for model in models for each in _axes_of(model.transition)]
    return LinearModel(transition=SideBySide(tuple(axes)), **given)


def _axes_of(transition):
    """Return the transitions of the single axes of a transition."""
    return transition.transitions if isinstance(transition, SideBySide) else (transition,)


def exact_motion(model: LinearModel, x0: ArrayLike) -> LinearModel:
    """Return the model of a track that starts exactly at x0 and has no process noise, with noisy measurements.

    Parameters
    ----------
    model : LinearModel
        The model of motion and measurements.
    x0 : array_like (n,)
        The start x(0).

    Returns
    -------
    LinearModel
        The model with this x0, and with P0 = 0 and Q = 0.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> mpt.exact_motion(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1), x0=[0, 20]).Q
    array([[0., 0.],
           [0., 0.]])

    """
    checks.instance("model", model, LinearModel)
    return replace(model.with_noise_times(0.0), x0=x0, P0=np.zeros_like(model.P0))


def mean_track(model: LinearModel, N: int) -> Array:
    """Return the noise-free track of a model: x(1) ... x(N) = F x0 ... Fᴺ x0.

    Parameters
    ----------
    model : LinearModel
        The model with F and x0.
    N : int
        Number of steps.

    Returns
    -------
    ndarray (N, n)
        The states; row k is x(k+1).

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> mpt.mean_track(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1, x0=[0, 20]), N=3)
    array([[20., 20.],
           [40., 20.],
           [60., 20.]])

    """
    checks.instance("model", model, LinearModel)
    x, states = model.x0, []
    for _ in range(checks.count("N", N)):
        x = model.F @ x
        states.append(x)
    return np.array(states)


def simulate(model: LinearModel, N: int, rng: Any, tracks: int | None = None) -> tuple[Array, Array]:
    """Simulate true tracks and their measurements (2014 Eq. 1).

    Parameters
    ----------
    model : LinearModel
        The model of motion and measurements.
    N : int
        Number of steps.
    rng : Generator, int or anything that `numpy.random.default_rng` takes
        Source of random numbers, or its seed.
    tracks : int, optional
        Number of tracks M; one, without an axis of tracks, where not given.

    Returns
    -------
    x : ndarray (N, n) or (N, n, M)
        True states. Row k is x(k+1); x(0), drawn from N(x0, P0), is not returned.
    z : ndarray (N, m) or (N, m, M)
        Measurements. Row k is z(k+1).

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> model = mpt.constant_velocity(dt=1.0, q=0.01, r=0.1)
    >>> x, z = mpt.simulate(model, N=5, rng=1, tracks=3)
    >>> x.shape, z.shape
    ((5, 2, 3), (5, 1, 3))

    """
    checks.instance("model", model, LinearModel)
    rng = np.random.default_rng(rng)
    N = checks.count("N", N)
    M = 1 if tracks is None else checks.count("tracks", tracks)
    x0 = model.x0[:, None] + square_root(model.P0) @ rng.standard_normal((model.n, M))
    x = rng.standard_normal((N, model.n, M))
    step = Step(A=model.F, B=square_root(model.Q), P=None)
    run_shared(products_for([step] * N, M), x0, x, x)  # x holds the noise of each step, then the states
    z = square_root(model.R) @ rng.standard_normal((N, model.m, M))
    z += model.H @ x
    return (x[..., 0], z[..., 0]) if tracks is None else (x, z)
