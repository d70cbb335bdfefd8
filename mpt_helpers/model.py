"""Linear models of how a mobile moves and what is measured of it, and tracks drawn from these models.

The papers, cited by year: Kluga & Kluga 2007, Assimakis & Adam 2014 and 2015, Assimakis et al. 2016.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from . import _checks as checks
from ._checks import Array, Seconds
from ._engine.shared import Step, products_for, run_shared
from ._immutable import Immutable
from .equations import square_root
from .motion import Motion, OneLength, Powers, checked, joined, powers_of, refuse_other_lengths

# The longest time step (s): its fifth power, in the Q of constant acceleration, is a double.
LONGEST_DT = 1e60


@dataclass(frozen=True, eq=False, init=False)
class LinearModel(Immutable):
    """A linear time-invariant model (2014 Eq. 1, 2015 Section 2).

        x(k+1) = F x(k) + w(k),     w ~ N(0, Q)
        z(k)   = H x(k) + v(k),     v ~ N(0, R)

    F is n×n, H is m×n, Q is n×n (the papers' G Q Gᵀ), R is m×m and positive definite. x0 (n,) and P0 (n×n) are the mean
    and the covariance of x(0), zero where not given, as in the papers. All arrays are copied and made read-only.

    `motion` says what F and Q are over a step of any length, for tracks with times of their own (`motion.Motion`):
    give it in place of F and Q, or give F and Q with dt (s) and powers (n,), by which a step of s dt has
    F_ij s^(e_i - e_j) and Q_ij s^(e_i + e_j), with the powers e. `constant_velocity` and `constant_acceleration` do.
    Two steps of dt / 2 must be one of dt. A model of F and Q alone knows steps of one length: then dt is None.

    `replace` keeps the motion where the new F and Q are a step of its kind (Q may become zero, and of powers any that
    they fit). Else the model knows one length, and its dt is None. So for a motion of your own with twice the noise,
    give the model a new motion: what a new Q would be over other lengths cannot be known from that of one.

    Two models are equal, and have the same hash, when all their numbers are equal. So are two filters: a model or a
    filter can be the key of a dictionary.

    Raises ValueError for a wrong shape or value and TypeError for anything but real numbers, naming the argument.

    >>> LinearModel(F=[[1.0]], H=[[1.0]], Q=[[0.01]], R=[[0.1]]).P0
    array([[0.]])
    """

    F: Array
    H: Array
    Q: Array
    R: Array
    x0: Array
    P0: Array
    dt: float | None
    powers: Array | None
    motion: Motion

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
        powers: ArrayLike | None = None,
        motion: Motion | None = None,
    ):
        if motion is not None and F is None and Q is None:
            F, Q = checked(motion)
            for name, value in (("dt", dt), ("powers", powers)):
                if value is not None:
                    checks.refuse(name, "to be left out beside a motion, which has its own", f"{value}", TypeError)
            dt, powers = motion.dt, powers_of(motion)
        elif F is None or Q is None:
            lacking, other = ("F", "Q") if F is None else ("Q", "F")
            checks.refuse(lacking, f"a matrix, as {other} does, or a motion in place of both", None, TypeError)
        n, m = checks.rows("F", F), checks.rows("H", H)
        given = {
            "F": checks.array("F", F, (n, n)),
            "H": checks.array("H", H, (m, n)),
            "Q": checks.covariance("Q", Q, n),
            "R": checks.covariance("R", R, m, definite=True),
            "x0": checks.array("x0", np.zeros(n) if x0 is None else x0, (n,)),
            "P0": checks.covariance("P0", np.zeros((n, n)) if P0 is None else P0, n),
        }
        dt = None if dt is None else checks.duration("dt", dt)
        powers = None if powers is None else checks.array("powers", powers, (n,))
        found = _motion_of(given["F"], given["Q"], dt, powers, motion)
        given |= {"dt": found.dt, "powers": powers_of(found), "motion": found}
        for name, value in given.items():
            object.__setattr__(self, name, value)

    def over(self, length: ArrayLike) -> tuple[Array, Array]:
        """Return F and Q of a step of this length, in units of dt, a number that is not negative; (K, n, n) of K steps.

        Raises ValueError for a model that knows one length only: then its dt is None.

        >>> constant_velocity(dt=2.0, q=0.01, r=0.1).over(1.5)[0]
        array([[1., 3.],
               [0., 1.]])
        """
        if self.dt is None:
            refuse_other_lengths()
        return self.motion.over(length)

    @property
    def n(self) -> int:
        """Dimension of the state."""
        return len(self.F)

    @property
    def m(self) -> int:
        """Dimension of the measurement."""
        return len(self.H)


def _motion_of(F, Q, dt, powers, motion):
    """Return the Motion of a model with these F and Q, from what was given of it.

    A user gives what stands in the first five lines, where a misfit is an error. `replace` and copies give back what
    the model has, its motion too, with other F, Q, dt or powers among it. There F and Q that do not fit make a model of
    one length.

        dt    powers   motion                      the motion returned
        -     -        -                           OneLength
        -     given    -                           error: without dt, powers say nothing
        given -        -                           error: what is a step of another length?
        given given    -                           Powers; error where they do not fit
        given any      any other kind              its `with_matrices` of F and Q, or OneLength

        -     any      any (`replace` of dt)       OneLength
        given -        OneLength or Powers         error: what is a step of another length?
        given given    OneLength or Powers         Powers of what was given; OneLength where they do not fit
    """
    if dt is None:
        if powers is not None and motion is None:
            checks.refuse("powers", "a dt, the length of the step (s) for which F and Q are", "none")
        return OneLength(F, Q)
    # OneLength and Powers hold nothing but F, Q, dt and powers, which were given too, and may be newer there.
    if motion is None or isinstance(motion, OneLength | Powers):
        if powers is None:
            checks.refuse(
                "dt", "powers, or a motion in place of F and Q, that say what a step of another length is", dt
            )
        by_powers = Powers(F, Q, powers, dt)
        if by_powers.fits():
            return by_powers
        if motion is None:
            checks.refuse("powers", "two steps of dt / 2 to be one of dt", "an F or a Q for which they are not")
        return OneLength(F, Q)
    checks.instance("motion", motion, Motion)
    if dt != motion.dt:
        checks.refuse("dt", f"the dt of the motion, {motion.dt:g} s", f"{dt:g} s")
    return motion.with_matrices(F, Q) or OneLength(F, Q)


def gsm_axis(dt: Seconds, q: float, r: float, x0: ArrayLike | None = None, P0: ArrayLike | None = None) -> LinearModel:
    """Return the model of one axis of a GSM phone: position and velocity (2014 Eq. 3, 2015 Section 2, model B).

        F = [1 dt; 0 1],   G = [dt/2; 1],   Q = G q Gᵀ,   H = [1 dt],   R = r

    dt is the time step (s), q the variance of the velocity's change in a step (m²/s²), r the variance of a measurement
    (m²), x0 (2,) and P0 (2×2) are the start. H measures s + v dt: the position that F predicts for the next step.

    Raises ValueError for dt <= 0, q < 0 or r <= 0.

    >>> gsm_axis(dt=1.0, q=0.01, r=0.1).Q
    array([[0.0025, 0.005 ],
           [0.005 , 0.01  ]])
    """
    dt, q, r = _checked(dt, q, r)
    G = np.array([[dt / 2], [1.0]])
    return LinearModel(F=[[1, dt], [0, 1]], H=[[1, dt]], Q=q * G @ G.T, R=[[r]], x0=x0, P0=P0)


def constant_velocity(
    dt: Seconds, q: float, r: float, x0: ArrayLike | None = None, P0: ArrayLike | None = None
) -> LinearModel:
    """Return the model of one axis with nearly constant velocity: position and velocity (2016 Eq. 5).

        F = [1 dt; 0 1],   H = [1 0],   Q = [dt³/3 dt²/2; dt²/2 dt] q,   R = r

    dt is the time step (s), q the spectral density of the white noise that drives the velocity (m²/s³), r the variance
    of the measured position (m²), x0 (2,) and P0 (2×2) are the start.

    Raises ValueError for dt <= 0, q < 0 or r <= 0.

    >>> constant_velocity(dt=1.0, q=0.06, r=0.1).Q
    array([[0.02, 0.03],
           [0.03, 0.06]])
    """
    dt, q, r = _checked(dt, q, r)
    F = [[1, dt], [0, 1]]
    Q = [[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]
    return LinearModel(F=F, H=[[1, 0]], Q=q * np.array(Q), R=[[r]], x0=x0, P0=P0, dt=dt, powers=[1.5, 0.5])


def constant_acceleration(
    dt: Seconds, q: float, r: float, x0: ArrayLike | None = None, P0: ArrayLike | None = None
) -> LinearModel:
    """Return the model of one axis with nearly constant acceleration: position, velocity and acceleration.

    2016 Eq. 6 with the Q of Section 5.2, which is the right one: Eq. 6 prints dt³/3 for dt³/6 in its first row.

        F = [1 dt dt²/2; 0 1 dt; 0 0 1],   H = [1 0 0],   R = r
        Q = [dt⁵/20 dt⁴/8 dt³/6; dt⁴/8 dt³/3 dt²/2; dt³/6 dt²/2 dt] q

    dt is the time step (s), q the spectral density of the white noise that drives the acceleration (m²/s⁵), r the
    variance of the measured position (m²), x0 (3,) and P0 (3×3) are the start.

    Raises ValueError for dt <= 0, q < 0 or r <= 0.

    >>> constant_acceleration(dt=1.0, q=0.12, r=0.1).Q
    array([[0.006, 0.015, 0.02 ],
           [0.015, 0.04 , 0.06 ],
           [0.02 , 0.06 , 0.12 ]])
    """
    dt, q, r = _checked(dt, q, r)
    F = [[1, dt, dt**2 / 2], [0, 1, dt], [0, 0, 1]]
    Q = [[dt**5 / 20, dt**4 / 8, dt**3 / 6], [dt**4 / 8, dt**3 / 3, dt**2 / 2], [dt**3 / 6, dt**2 / 2, dt]]
    powers = [2.5, 1.5, 0.5]
    return LinearModel(F=F, H=[[1, 0, 0]], Q=q * np.array(Q), R=[[r]], x0=x0, P0=P0, dt=dt, powers=powers)


def gps_ins(
    dt: Seconds, q: float, r: ArrayLike, x0: ArrayLike | None = None, P0: ArrayLike | None = None
) -> LinearModel:
    """Return the model of GPS and INS on one axis: position, velocity and the bias of the INS (2007 Eq. 11).

        F = [1 dt 0; 0 1 0; 0 0 1],   H = [1 0 0; 0 1 1; 1 -dt 0],   Q = diag(0, q, 0),   R = diag(r)

    The rows of H are the position from GPS, the velocity with its bias from the INS, and a third row that the paper
    does not explain: s - v dt, the position one step before. dt is the time step (s), q the variance of the velocity's
    change in a step (m²/s²; the paper prints no Q), r the variances of the first two rows (m², m²/s²) or of all three
    (m², m²/s², m²). x0 (3,) and P0 (3×3) are the start.

    Raises ValueError for dt <= 0 or above 1e60 s, q < 0, a variance that is not positive, and for fewer or more.

    >>> gps_ins(dt=1.0, q=0.0, r=(1.0, 1e-4)).H
    array([[1., 0., 0.],
           [0., 1., 1.]])
    """
    variances = checks.real_numbers("r", r, "two or three variances").tolist()
    if not isinstance(variances, list) or len(variances) not in (2, 3):
        checks.refuse("r", "two or three variances", f"{r!r:.60}")
    R = np.diag([checks.positive("r", variance) for variance in variances])
    dt, q, _ = _checked(dt, q, variances[0])
    F = [[1, dt, 0], [0, 1, 0], [0, 0, 1]]
    H = [[1, 0, 0], [0, 1, 1], [1, -dt, 0]]
    return LinearModel(F=F, H=H[: len(R)], Q=np.diag([0, q, 0]), R=R, x0=x0, P0=P0)


def _checked(dt, q, r):
    dt = checks.duration("dt", dt)
    if dt > LONGEST_DT:
        checks.refuse("dt", f"at most {LONGEST_DT:g} s, whose powers are doubles", f"{dt:g} s")
    return dt, checks.not_negative("q", q), checks.positive("r", r)


def stack(*models: LinearModel) -> LinearModel:
    """Return one model of several axes: model A of the papers (2014 Eq. 2, 2015 Section 2).

    Every matrix is block diagonal, and the states follow one another: [s_x v_x s_y v_y ...].

    Raises ValueError when no model is given and where two of them say another dt, TypeError for anything but a
    LinearModel.

    >>> axis = gsm_axis(dt=1.0, q=0.01, r=0.1)
    >>> stack(axis, axis).H
    array([[1., 1., 0., 0.],
           [0., 0., 1., 1.]])
    """
    if not models:
        checks.refuse("models", "at least one model", "none")
    for i, model in enumerate(models):
        checks.instance(f"models[{i}]", model, LinearModel)
    known = {i: model.dt for i, model in enumerate(models) if model.dt is not None}
    for i, dt in known.items():
        first, dt_0 = next(iter(known.items()))
        if dt != dt_0:
            checks.refuse(
                f"models[{i}].dt", f"a model that says the same dt as models[{first}], {dt_0:g} s", f"{dt:g} s"
            )
    motion = joined([model.motion for model in models])
    F, Q = motion.one_step
    H, R, P0 = (block_diag(*[getattr(model, name) for model in models]) for name in ("H", "R", "P0"))
    x0 = np.concatenate([model.x0 for model in models])
    return LinearModel(
        F=F,
        H=H,
        Q=Q,
        R=R,
        x0=x0,
        P0=P0,
        dt=motion.dt,
        powers=powers_of(motion),
        motion=motion,
    )


def exact_motion(model: LinearModel, x0: ArrayLike) -> LinearModel:
    """Return the model of a track that starts at x0 exactly and has no process noise; measurements keep their noise.

    >>> exact_motion(constant_velocity(dt=1.0, q=0.01, r=0.1), x0=[0, 20]).Q
    array([[0., 0.],
           [0., 0.]])
    """
    checks.instance("model", model, LinearModel)
    zero = np.zeros_like(model.Q)
    return replace(model, Q=zero, x0=x0, P0=zero)


def mean_track(model: LinearModel, N: int) -> Array:
    """Return the track that a model takes without noise: x(1) ... x(N) = F x0 ... Fᴺ x0, (N, n).

    >>> mean_track(exact_motion(constant_velocity(dt=1.0, q=0.01, r=0.1), x0=[0, 20]), N=3)
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


def simulate(model: LinearModel, N: int, rng: np.random.Generator, tracks: int | None = None) -> tuple[Array, Array]:
    """Draw true tracks and their measurements from a model (2014 Eq. 1).

    N is the number of steps, rng a numpy Generator, tracks the number of tracks M, or None for one track.

    Returns x and z of shapes (N, n) and (N, m), or (N, n, M) and (N, m, M). Row k is x(k+1), z(k+1): x(0) itself, drawn
    from N(x0, P0), is not returned. Raises TypeError for anything but a model and a Generator, ValueError for N < 1.

    >>> x, z = simulate(gsm_axis(dt=1.0, q=0.01, r=0.1), N=5, rng=np.random.default_rng(1), tracks=3)
    >>> x.shape, z.shape
    ((5, 2, 3), (5, 1, 3))
    """
    checks.instance("model", model, LinearModel)
    checks.instance("rng", rng, np.random.Generator)
    N = checks.count("N", N)
    M = 1 if tracks is None else checks.count("tracks", tracks)
    x0 = model.x0[:, None] + square_root(model.P0) @ rng.standard_normal((model.n, M))
    x = rng.standard_normal((N, model.n, M))
    step = Step(A=model.F, B=square_root(model.Q), P=None)
    run_shared(products_for([step] * N, M), x0, x, x)  # driven by noise, which the states replace
    z = square_root(model.R) @ rng.standard_normal((N, model.m, M))
    z += model.H @ x
    return (x[..., 0], z[..., 0]) if tracks is None else (x, z)
