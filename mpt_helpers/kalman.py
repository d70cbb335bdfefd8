"""The Kalman filter: one step as the papers print it, by filterpy.

A_k, B_k and P depend on which measurements are missing, not on their values. A missing measurement has a row of zeros
in H, and in R a one on the diagonal and zeros elsewhere in its row and column: then every equation holds as printed,
also when all measurements of an epoch are missing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property

import filterpy.kalman
import numpy as np
from numpy.typing import ArrayLike

from . import _checks as checks
from ._base import RecursiveFilter
from ._checks import Array, Seconds
from ._engine.columns import kalman_on_columns
from ._engine.epochs import Epochs, Rows
from ._engine.shared import Step
from .equations import neutralised, unit_measurements
from .model import LinearModel
from .motion import MISSED_ELSEWHERE, missed_by_halves

# How many times as large as the variance of a measurement that of its prediction may be. filterpy's P after the
# measurement is wrong by some 1e-31 of the variance of the prediction. At this limit that is 1e-31 * 1e29 = 1 % of the
# variance of the measurement, which P is then about.
LARGEST = 1e29


@dataclass(frozen=True, eq=False, init=False)
class KalmanFilter(RecursiveFilter):
    """The Kalman filter (2014 Eq. 4, 2015 Eq. 1). Tracks without gaps share filterpy's gains and covariances.

        A_k = (I - K_k H) F,   B_k = K_k

    t are the times of the epochs, (N,) for all tracks or (N, M) for each: numbers in s, or dates, as datetime64,
    datetimes and a pandas index are. They do not decrease; x0 lies one step dt of the model before t[0]. The model must
    say what a step of another length is, as `constant_velocity`, `constant_acceleration` and motions of your own do. r
    are the variances of the measurements, (N, m) or (N, m, M), in place of the model's R: the accuracy that a receiver
    states of each fix. They are looked at only where there is a measurement.

    Raises TypeError for anything but a model, and ValueError for times that a model does not take or that decrease, and
    for variances that are not positive.

    >>> from mpt_helpers.model import constant_velocity, gsm_axis
    >>> KalmanFilter(gsm_axis(dt=1.0, q=0.01, r=0.1)).filter([[1.0], [2.0]]).round(4)
    array([[0.0612, 0.1224],
           [0.5557, 0.4681]])
    >>> model = constant_velocity(dt=1.0, q=0.01, r=0.1, x0=[0, 1])
    >>> KalmanFilter(model, t=[1.0, 4.5]).filter([[1.0], [4.5]])
    array([[1. , 1. ],
           [4.5, 1. ]])
    """

    t: Array | None
    r: Array | None

    def __init__(self, model: LinearModel, t: ArrayLike | Sequence[datetime] | None = None, r: ArrayLike | None = None):
        super().__init__(model)
        if t is not None and model.dt is None:
            _refuse_lengths_of("t")
        object.__setattr__(self, "t", None if t is None else checks.times("t", t))
        object.__setattr__(self, "r", None if r is None else checks.variances("r", r, model.m))
        if r is not None and model.m > 1 and self.r.shape[2:] == (model.m,) and _are_covariances(self.r):
            need = f"variances, (N, {model.m}) or (N, {model.m}, M)"
            got = f"what looks like covariances; variances of {model.m} tracks that look so are taken track by track"
            checks.refuse("r", need, got)

    def coefficients(self, N: int) -> Step:
        """Return A (N, n, n), B (N, n, m) and the covariance P (N, n, n) of steps 1 to N with nothing missing.

        Raises ValueError for a filter with times or variances: each of its epochs has a `next_step` of its own.
        """
        if self.t is not None or self.r is not None:
            name, got = ("r", "variances") if self.t is None else ("t", "times")
            checks.refuse(name, "to be left out, as coefficients are those of equal steps and of the model's R", got)
        return super().coefficients(N)

    def next_step(
        self, P: Array, seen: np.ndarray, length: float | None = None, r: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """Return A_k, B_k and P(k+1/k+1) from P(k/k) (n, n), with the measurements seen (m,), by filterpy.

        length is that of the step in units of the model's dt, r (m,) the variances; the model's where None.
        """
        # A copy, as predict and update set attributes, and other threads may take a step by the same object. It is made
        # by hand, without the constructor, which is slow; copy.copy is slower too.
        kf = object.__new__(filterpy.kalman.KalmanFilter)
        vars(kf).update(vars(self._filterpy))
        kf.P = P
        W = self._units[1]
        if length is not None:
            kf.F, kf.Q = self.model.over(length)
        if r is not None or not seen.all():
            R = self.model.R if r is None else np.diag(np.where(seen, r, 1))
            H_1, W = unit_measurements(*neutralised(self.model.H, R, seen))
            kf.H, kf.R = H_1, np.eye(len(H_1))
        kf.predict()
        kf.update(np.zeros(len(W)))  # neither gain nor covariance depends on x or z
        if min(kf.S.diagonal().tolist()) <= 0:  # of any covariance it is one or more, but for rounding
            checks.refuse("P", "a covariance", "one that gives a measurement a variance that is not positive")
        if length is not None and not kf.S.max() < LARGEST:
            need = "a time after which doubles hold the variances of the measurements beside that of the prediction"
            checks.refuse("dt", need, f"{length * self.model.dt:.6g} s")
        return (self._identity - kf.K @ kf.H) @ kf.F, kf.K @ W, kf.P

    def step(
        self, x: ArrayLike, P: ArrayLike, z_k: ArrayLike, dt: Seconds | None = None, r: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Return x(k+1/k+1) and P(k+1/k+1) from x(k/k) (n,), P(k/k) (n, n) and one measurement z(k+1) (m,).

        NaN stands for a missing measurement. The start is `model.x0` and `P0`. dt is the time since x(k/k), in s
        or a timedelta: a filter with times needs it, others may get it where the model takes steps of other lengths.
        r (m,) are the variances of the measurements, which a filter with variances needs. Raises ValueError or
        TypeError for other shapes, for a dt that is negative or so large that doubles do not hold the step, for states
        and covariances that are not finite, and for a P that is no covariance as far as a glance tells: its eigenvalues
        are not computed, but it is looked at by pairs of states, and by what it says of the measurements.
        """
        n, m = self.model.n, self.model.m
        x, P = checks.state(x, P, n)
        z_k, seen = checks.one_measurement(z_k, m)
        if dt is None and self.t is not None:
            checks.refuse("dt", "the time since x, as the filter has times", "none")
        if r is None and self.r is not None:
            checks.refuse("r", "the variances of z_k, as the filter has them for each epoch", "none")
        dt = None if dt is None else checks.not_negative("dt", checks.as_seconds(dt))
        length = None if dt is None else self._length_of(dt)
        if r is not None:
            r = checks.variances_of_one("r", r, seen)
        with np.errstate(over="ignore", invalid="ignore"):  # the largest times are refused by what they make
            A, B, P = self.next_step(P, seen, length, r)
        if length is not None and not math.isfinite(P.sum()):
            checks.refuse("dt", "a time over which the covariance stays within the range of doubles", f"{dt:.6g} s")
        return A @ x + B @ np.where(seen, z_k, 0), P

    def epochs_of(self, z: Array) -> Epochs:
        """Return z (N, m, M) with its steps and variances; raises ValueError where those are of other epochs."""
        N, m, M = z.shape
        for name, given, shape in (("t", self.t, (N,)), ("r", self.r, (N, m))):
            if given is not None and given.shape not in (shape, (*shape, M)):
                checks.refuse(name, f"the epochs and tracks of z, {shape} or {(*shape, M)}", f"shape {given.shape}")
        epochs = Epochs(z, self._lengths, self._variances)
        if epochs.variances is not None:
            checks.used_variances("r", np.broadcast_to(epochs.variances, z.shape)[~epochs.missing])
        return epochs

    @cached_property
    def _lengths(self):
        """The lengths of the steps (N, 1 or M) before each epoch in units of dt, the first 1, or None.

        Raises ValueError where a step is so long that `step` refuses it.
        """
        if self.t is None:
            return None
        t = self.t.reshape(len(self.t), -1)
        lengths = lengths_of(t, self.model.dt)
        self._require_steps_that_doubles_hold(lengths.max())
        if self.model.powers is None:  # powers of a length lose no digits
            self._warn_of_lost_digits(lengths)
        return lengths

    def _warn_of_lost_digits(self, lengths):
        """Warn where F and Q of the shortest or the longest step are not those of two half steps, to three digits."""
        steps = lengths[lengths > 0]
        for length in {steps.min(), steps.max()} if steps.size else ():
            missed = max(missed_by_halves(self.model.motion, length))
            if missed > MISSED_ELSEWHERE:
                of = f"over {length * self.model.dt:.3g} s the motion's F and Q are not those of two half steps"
                checks.warn(f"t: {of}, by {missed:.1%}: its formula loses its digits there")

    def _require_steps_that_doubles_hold(self, longest):
        """Raise a ValueError where the process noise of the longest step alone is too large beside R for doubles.

        What was not known before the step comes on top of it. So no step is refused here that `step` would take.
        """
        R = self.model.R
        if self.r is not None:
            known = np.where(self.r > 0, self.r, np.inf)  # NaN stands for those that are missing
            least = known.min(axis=(0, *range(2, self.r.ndim)))
            R = np.diag(np.where(np.isfinite(least), least, 1))
        with np.errstate(over="ignore", invalid="ignore"):  # an infinite or undefined S is refused too
            H_1, _ = unit_measurements(self.model.H, R)
            S = H_1 @ self.model.over(longest)[1] @ H_1.T
            held = S.max() < LARGEST
        if not held:
            need = "steps after which doubles hold the variances of the measurements beside that of the prediction"
            checks.refuse("t", need, f"one of {longest * self.model.dt:.6g} s")

    @property
    def _variances(self):
        """The variances (N, m, 1 or M), or None."""
        return None if self.r is None else self.r.reshape(*self.r.shape[:2], -1)

    def in_columns(self, rows: Rows) -> tuple[Callable, Rows, Array, Array]:
        """Return the filter on columns, as in RecursiveFilter."""
        return kalman_on_columns(self.model, rows)

    def _length_of(self, dt):
        if self.model.dt is None:
            _refuse_lengths_of("dt")
        return dt / self.model.dt

    @cached_property
    def _identity(self):
        return np.eye(self.model.n)

    @cached_property
    def _units(self):
        return unit_measurements(self.model.H, self.model.R)

    @cached_property
    def _filterpy(self):
        # filterpy 2.0: a scalar R would be added to all of S, so R is a matrix; x has one dimension, as z has. It gets
        # measurements of unit noise, since its S = H P Hᵀ + R rounds a precise sensor away beside a large P.
        H_1, _ = self._units
        kf = filterpy.kalman.KalmanFilter(dim_x=self.model.n, dim_z=len(H_1))
        kf.x = np.zeros(self.model.n)
        kf.F, kf.Q, kf.H, kf.R = self.model.F, self.model.Q, H_1, np.eye(len(H_1))
        return kf


def lengths_of(t: Array, dt: float) -> Array:
    """Return the lengths of the steps before epochs at times t (N, ...), in units of dt: x0 lies one before the first.

    >>> lengths_of(np.array([5.0, 6.0, 9.0]), dt=2.0)
    array([1. , 0.5, 1.5])
    """
    return np.concatenate([np.ones_like(t[:1]), np.diff(t, axis=0) / dt])


def _refuse_lengths_of(name):
    need = "a model that says what a step of another length is (constant_velocity, or a motion of your own)"
    checks.refuse(name, need, "one whose F and Q are for one length only")


def _are_covariances(r):
    """Say whether arrays (N, m, m) look like covariances in all epochs, where they could be variances of m tracks.

    A user with the covariances of a receiver would hand them in, and the shape alone does not tell: taken for variances
    of m tracks they would make wrong estimates without a word. Most of the epochs decide: a covariance that was rotated
    is symmetric but for its rounding, and one of a bad fix may be singular.
    """
    known = r[np.isfinite(r).all(axis=(1, 2)) & (np.diagonal(r, axis1=1, axis2=2) > 0).all(axis=1)]
    if 2 * len(known) <= np.isfinite(r).all(axis=(1, 2)).sum():
        return False
    sigma = np.sqrt(np.diagonal(known, axis1=1, axis2=2))
    scaled = known / sigma[:, :, None] / sigma[:, None]
    symmetric = (np.abs(scaled - scaled.swapaxes(1, 2)) <= checks.ROUNDING).all(axis=(1, 2))
    # Equal variances of all tracks make a matrix of rank one, which is no covariance of noises.
    definite = (np.linalg.eigvalsh(scaled) > checks.ROUNDING).all(axis=1)
    return bool(2 * (symmetric & definite).sum() > len(known))
