"""Linear models of how a mobile moves and what is measured of it, and tracks drawn from these models.

The papers, cited by year: Kluga & Kluga 2007, Assimakis & Adam 2014 and 2015, Assimakis et al. 2016.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from . import checks
from .checks import Array, Seconds
from .equations import square_root
from .recursion import Step, lifted, run


class Immutable:
    """A dataclass of numbers, arrays and others of its kind that nobody can write to.

    Two are equal, and have the same hash, when they are of one class and all that they hold is equal; NaN equals NaN.
    Copies and pickles go through the constructor: numpy does not keep the read-only flag.
    """

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return all(map(same, self._held(), other._held()))

    def __hash__(self) -> int:
        # Of an array its numbers; + 0.0 makes 0 of -0, which is equal to it.
        held = [(each + 0.0).tobytes() if isinstance(each, np.ndarray) else each for each in self._held()]
        return hash((type(self), *held))

    def _held(self):
        return [getattr(self, field.name) for field in fields(self)]

    def __reduce__(self):
        return partial(type(self), **{field.name: getattr(self, field.name) for field in fields(self)}), ()


def same(a, b):
    """Tell whether two fields are equal: arrays where all their numbers are."""
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return np.array_equal(a, b, equal_nan=True)
    return bool(type(a) is type(b) and a == b)


@dataclass(frozen=True, eq=False, init=False)
class LinearModel(Immutable):
    """A linear time-invariant model (2014 Eq. 1, 2015 Section 2).

        x(k+1) = F x(k) + w(k),     w ~ N(0, Q)
        z(k)   = H x(k) + v(k),     v ~ N(0, R)

    F is n×n, H is m×n, Q is n×n (the papers' G Q Gᵀ), R is m×m and positive definite. x0 (n,) and P0 (n×n) are the mean
    and the covariance of x(0), zero where not given, as in the papers. All arrays are copied and made read-only.

    dt (s) and powers (n,) say what F and Q become over a step of another length, for tracks with times of their own:
    a step of s dt has F_ij s^(e_i - e_j) and Q_ij s^(e_i + e_j), with the powers e. `constant_velocity` and
    `constant_acceleration` give them. They are dropped where they do not fit F and Q, as when `replace` gives other
    ones: two steps of dt / 2 must be one of dt.

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

    def __init__(
        self,
        *,
        F: ArrayLike,
        H: ArrayLike,
        Q: ArrayLike,
        R: ArrayLike,
        x0: ArrayLike | None = None,
        P0: ArrayLike | None = None,
        dt: Seconds | None = None,
        powers: ArrayLike | None = None,
    ):
        n, m = checks.rows("F", F), checks.rows("H", H)
        checked = {
            "F": checks.array("F", F, (n, n)),
            "H": checks.array("H", H, (m, n)),
            "Q": checks.covariance("Q", Q, n),
            "R": checks.covariance("R", R, m, definite=True),
            "x0": checks.array("x0", np.zeros(n) if x0 is None else x0, (n,)),
            "P0": checks.covariance("P0", np.zeros((n, n)) if P0 is None else P0, n),
            "dt": None if dt is None else checks.positive("dt", checks.as_seconds(dt)),
            "powers": None if powers is None else checks.array("powers", powers, (n,)),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        if self.dt is None or self.powers is None or not self._two_half_steps_are_one():
            object.__setattr__(self, "dt", None)
            object.__setattr__(self, "powers", None)

    def _two_half_steps_are_one(self):
        """Tell whether F and Q fit the powers, and whether a step of length zero changes nothing."""
        e, F, Q = self.powers, self.F, self.Q
        differences, sums = e[:, None] - e, e[:, None] + e
        if (differences[F != 0] % 1).any() or (sums[Q != 0] % 1).any():
            return False
        if (differences[F != 0] < 0).any() or (sums[Q != 0] <= 0).any():
            return False
        if (np.diag(F) != 1).any() or F[(differences == 0) & ~np.eye(len(F), dtype=bool)].any():
            return False
        half, noise = F * 0.5**differences, Q * 0.5**sums
        rounding = 1e-12  # of a few products
        size = np.abs(half) @ np.abs(Q) @ np.abs(half.T) + np.abs(Q)
        same_F = np.abs(half @ half - F) <= rounding * np.abs(half) @ np.abs(half)
        same_Q = np.abs(half @ noise @ half.T + noise - Q) <= rounding * size
        return bool(same_F.all() and same_Q.all())

    def over(self, length: ArrayLike) -> tuple[Array, Array]:
        """Return F and Q of a step of this length, in units of dt, a number that is not negative; (K, n, n) of K steps.

        Raises ValueError for a model that knows one length only: then its dt is None.

        >>> constant_velocity(dt=2.0, q=0.01, r=0.1).over(1.5)[0]
        array([[1., 3.],
               [0., 1.]])
        """
        if self.powers is None:
            checks.refuse("model", "powers that say what a step of another length is", "none")
        # Where a power is below zero there is no F_ij or no Q_ij: no step of length zero is divided by.
        differences, sums = self.powers[:, None] - self.powers, self.powers[:, None] + self.powers
        s = np.asarray(length, dtype=float)[..., None, None]
        return self.F * s ** np.maximum(differences, 0), self.Q * s ** np.maximum(sums, 0)

    @property
    def n(self) -> int:
        """Dimension of the state."""
        return len(self.F)

    @property
    def m(self) -> int:
        """Dimension of the measurement."""
        return len(self.H)


def gsm_axis(dt: Seconds, q: float, r: float, x0: ArrayLike | None = None, P0: ArrayLike | None = None) -> LinearModel:
    """Return the model of one axis of a GSM phone: position and velocity (2014 Eq. 3, 2015 Section 2, model B).

        F = [1 dt; 0 1],   G = [dt/2; 1],   Q = G q Gᵀ,   H = [1 dt],   R = r

    dt is the time step (s), q the variance of the velocity's change in a step (m²/s²), r the variance of a measurement
    (m²), x0 (2,) and P0 (2×2) are the start. H measures s + v dt: the position one step ahead.

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

    Raises ValueError for dt <= 0, q < 0, a variance that is not positive, and for fewer or more variances.

    >>> gps_ins(dt=1.0, q=0.0, r=(1.0, 1e-4)).H
    array([[1., 0., 0.],
           [0., 1., 1.]])
    """
    variances = checks.real_numbers("r", r, "two or three variances").tolist()
    if not isinstance(variances, list) or len(variances) not in (2, 3):
        checks.refuse("r", "two or three variances", f"{r!r:.60}")
    R = np.diag([checks.positive("r", variance) for variance in variances])
    dt, q = checks.positive("dt", checks.as_seconds(dt)), checks.not_negative("q", q)
    F = [[1, dt, 0], [0, 1, 0], [0, 0, 1]]
    H = [[1, 0, 0], [0, 1, 1], [1, -dt, 0]]
    return LinearModel(F=F, H=H[: len(R)], Q=np.diag([0, q, 0]), R=R, x0=x0, P0=P0)


def _checked(dt, q, r):
    return checks.positive("dt", checks.as_seconds(dt)), checks.not_negative("q", q), checks.positive("r", r)


def stack(*models: LinearModel) -> LinearModel:
    """Return one model of several axes: model A of the papers (2014 Eq. 2, 2015 Section 2).

    Every matrix is block diagonal, and the states follow one another: [s_x v_x s_y v_y ...].

    Raises ValueError when no model is given, TypeError for anything but a LinearModel.

    >>> axis = gsm_axis(dt=1.0, q=0.01, r=0.1)
    >>> stack(axis, axis).H
    array([[1., 1., 0., 0.],
           [0., 0., 1., 1.]])
    """
    if not models:
        checks.refuse("models", "at least one model", "none")
    for i, model in enumerate(models):
        checks.instance(f"models[{i}]", model, LinearModel)
    blocks = {name: block_diag(*[getattr(model, name) for model in models]) for name in ("F", "H", "Q", "R", "P0")}
    x0 = np.concatenate([model.x0 for model in models])
    if models[0].dt is None or any(model.dt != models[0].dt for model in models):
        return LinearModel(**blocks, x0=x0)
    powers = np.concatenate([model.powers for model in models])
    return LinearModel(**blocks, x0=x0, dt=models[0].dt, powers=powers)


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
    motion = Step(A=model.F, B=square_root(model.Q), P=None)
    run(lifted([motion] * N, M), x0, x, x)  # the filters' recursion, driven by noise, which the states replace
    z = square_root(model.R) @ rng.standard_normal((N, model.m, M))
    z += model.H @ x
    return (x[..., 0], z[..., 0]) if tracks is None else (x, z)
