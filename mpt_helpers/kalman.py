"""The Kalman filter: `next_step` is one step as the papers print it, by filterpy; `advance` steps many tracks at once.

A_k, B_k and P depend on which measurements are missing, not on their values. For a missing measurement, H has a row of
zeros, and R has a one on the diagonal and zeros elsewhere in its row and column. Then every equation holds as printed,
even when all measurements of an epoch are missing.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from typing import Any, ClassVar

import filterpy.kalman
import numpy as np
from numpy.typing import ArrayLike

from . import _checks as checks
from ._base import RecursiveFilter, require_digits
from ._checks import Array
from ._engine.columns import Epochs, KalmanColumns
from .equations import masked, unit_measurements
from .model import LinearModel, half_step_gap, require_transition

# The filter warns of an inaccurate transition where a step and two half steps differ by more than this fraction.
MOST_HALF_STEP_GAP = 1e-3


@dataclass(frozen=True, eq=False, init=False, repr=False)
class KalmanFilter(RecursiveFilter):
    """The Kalman filter (2014 Eq. 4, 2015 Eq. 1).

        A_k = (I - K_k H) F,   B_k = K_k

    filterpy computes the gains and covariances of single steps, and those shared by tracks without gaps. Tracks with
    gaps, times or variances are filtered side by side as columns of arrays, by the same equations (`_engine.columns`).

    `filter` returns the estimates, `covariances` their P, `estimates` both, `smooth` those given all of z; `step` takes
    one measurement at a time.

    A subclass that overrides `next_step` must override `advance`, too, to take t or r (see RecursiveFilter).

    Parameters
    ----------
    model : LinearModel
        The model of motion and measurements.
    t : array_like (N,) or (N, M), optional
        Times of the epochs, for all tracks or for each: seconds, or dates (datetime64, datetimes, a pandas index). They
        must not decrease. x0 is the state one time step dt of the model before t[0]. The model needs a transition.
    r : array_like (N, m) or (N, m, M), optional
        Variances of the measurements in place of the model's R, such as the accuracy that a receiver states of each
        fix. They are ignored where z is NaN.

    Raises
    ------
    ValueError
        For times that decrease or that the model does not take, and for variances that are not positive.

    Examples
    --------
    Position and velocity from measured positions, one second apart, then at times of their own:

    >>> import mpt_helpers as mpt
    >>> model = mpt.constant_velocity(dt=1.0, q=0.01, r=0.1, P0=np.diag([100.0, 1.0]))
    >>> kf = mpt.KalmanFilter(model)
    >>> kf.filter([[1.0], [2.0], [3.1]]).round(2)
    array([[1.  , 0.01],
           [1.92, 0.84],
           [3.04, 1.  ]])
    >>> mpt.KalmanFilter(model, t=[1.0, 4.5]).filter([[1.0], [4.5]]).round(2)
    array([[1.  , 0.01],
           [4.47, 0.99]])

    The gain of each epoch is K = P(k/k) Hᵀ R⁻¹ for a diagonal R, with a column of zeros for a missing measurement:

    >>> z = np.array([[1.0], [np.nan], [3.1]])
    >>> seen = ~np.isnan(z)
    >>> K = kf.covariances(z) @ model.H.T / np.diag(model.R) * seen[:, None]
    >>> K[..., 0].round(3)
    array([[0.999, 0.01 ],
           [0.   , 0.   ],
           [0.976, 0.478]])

    """

    t: Array | None
    r: Array | None

    optimal: ClassVar[bool] = True

    def __init__(self, model: LinearModel, t: ArrayLike | Sequence[datetime] | None = None, r: ArrayLike | None = None):
        super().__init__(model)
        if t is not None:
            require_transition("t", model)
        object.__setattr__(self, "t", None if t is None else checks.times("t", t))
        object.__setattr__(self, "r", None if r is None else checks.variances("r", r, model.m))

    def next_step(
        self, P: Array, seen: np.ndarray, dt: float | None = None, r: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """Return A_k, B_k and P(k+1/k+1) from P(k/k) by filterpy, as in RecursiveFilter.

        dt is the length of the step in s, r (m,) are the variances; the model's where not given. Raises ValueError for
        a P that is not a covariance, and for a step whose variances exceed double precision.
        """
        kf = copy.copy(self._filterpy)  # predict and update change it, and other threads may take a step, too
        kf.P = P
        U = self._units[1]
        if dt is not None:
            kf.F, kf.Q = require_transition("dt", self.model)(dt)
        if r is not None or not seen.all():
            R = self.model.R if r is None else np.diag(np.where(seen, r, 1))
            H_1, U = unit_measurements(*masked(self.model.H, R, seen))
            kf.H, kf.R = H_1, np.eye(len(H_1))
        kf.predict()
        kf.update(np.zeros(len(U)))  # neither gain nor covariance depends on x or z
        if min(kf.S.diagonal().tolist()) <= 0:  # of any covariance it is one or more, but for rounding
            checks.refuse("P", "a covariance", "one that gives a measurement a variance that is not positive")
        keep = self._identity - kf.K @ kf.H
        require_digits(keep, kf.F, P, kf.P, kf.H @ kf.F, kf.S.diagonal(), dt)
        return keep @ kf.F, kf.K @ U, kf.P

    def epochs_of(self, z: Array) -> Epochs:
        """Return z (N, m, M) with its time steps and variances; raises ValueError where their number differs."""
        N, m, M = z.shape
        for name, given, shape in (("t", self.t, (N,)), ("r", self.r, (N, m))):
            if given is not None and given.shape not in (shape, (*shape, M)):
                checks.refuse(name, f"the epochs and tracks of z, {shape} or {(*shape, M)}", f"shape {given.shape}")
        r = self.r
        if r is not None:
            r = r.reshape(N, m, -1)
            checks.used_variances("r", np.broadcast_to(r, z.shape)[~np.isnan(z)])
            # A missing measurement may have any variance: the model's replaces one that is not a positive number.
            r = np.where(np.isfinite(r) & (r > 0), r, np.diag(self.model.R)[:, None])
        return Epochs(z, self.motion, self._steps, r, self.model.over)

    @cached_property
    def _steps(self):
        """The steps (N, 1 or M) before each epoch in s, or None. Warns of an inaccurate transition."""
        if self.t is None:
            return None
        t = self.t.reshape(len(self.t), -1)
        steps = np.concatenate([np.full_like(t[:1], self.model.dt), np.diff(t, axis=0)])
        lengths = steps[steps > 0]
        for dt in {lengths.min(), lengths.max()} if lengths.size else ():
            missed = half_step_gap(self.model.transition, dt)
            if missed == np.inf and not np.isfinite(self.model.over(dt)).all():
                checks.refuse("t", "steps over which the transition gives finite F and Q", f"one of {dt:.6g} s")
            if MOST_HALF_STEP_GAP < missed < np.inf:
                of = f"over {dt:.3g} s the transition's F and Q are not those of two half steps"
                checks.warn(f"t: {of}, by {missed:.1%}: its formula loses its digits there")
        return steps

    def advance(self, row: tuple[Any, ...], x: Array, P: Array) -> tuple[Array, Array, Array]:
        """Return x(k+1/k+1), P(k+1/k+1) and the innovations of one row of many tracks, as in RecursiveFilter."""
        of_whole_rows, of_others = self._columns
        seen = row[1]
        if of_others is not of_whole_rows and (seen != seen[:1]).any():
            return of_others.advance(row, x, P)
        return of_whole_rows.advance(row, x, P)

    @cached_property
    def _columns(self):
        """Two KalmanColumns: for complete or missed rows, and for partly missing ones."""
        H, R, P0 = self.model.H, self.model.R, self.model.P0
        uncorrelated = np.diag(np.diag(R))
        if self.r is not None or np.array_equal(R, uncorrelated):
            both = KalmanColumns(self.motion, H, uncorrelated, P0)
            return both, both
        return KalmanColumns(self.motion, H, R, P0), KalmanColumns(self.motion, H, R, P0, noises_are_states=True)

    @cached_property
    def _identity(self):
        return np.eye(self.model.n)

    @cached_property
    def _units(self):
        return unit_measurements(self.model.H, self.model.R)

    @cached_property
    def _filterpy(self):
        # filterpy 2.0 would add a scalar R to all entries of S, so R is a matrix. x has one dimension, like z. The
        # noise has unit variance, since in S = H P Hᵀ + R a precise sensor would be rounded away beside a large P.
        # filterpy's function `update` returns the gain only together with a density, which takes most of the time.
        H_1, _ = self._units
        kf = filterpy.kalman.KalmanFilter(dim_x=self.model.n, dim_z=len(H_1))
        kf.x = np.zeros(self.model.n)
        kf.F, kf.Q, kf.H, kf.R = self.model.F, self.model.Q, H_1, np.eye(len(H_1))
        return kf
