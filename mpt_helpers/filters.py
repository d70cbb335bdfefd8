"""One step of the Kalman filter and of the Lainiotis filter, as the papers print it, and on columns.

A_k, B_k and P depend on which measurements are missing, not on their values. A missing measurement has a row of zeros
in H, and in R a one on the diagonal and zeros elsewhere in its row and column: then every equation holds as printed,
also when all measurements of an epoch are missing.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cached_property

import filterpy.kalman
import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from . import checks
from .checks import Array, Seconds
from .columns import KalmanColumns, Motion, whitened
from .equations import lainiotis_matrices, lainiotis_step, unit_measurements
from .model import LinearModel
from .recursive import RecursiveFilter, Step, neutralised, one_measurement, one_state

# Patterns of missing measurements whose constants a Lainiotis filter keeps.
MOST_PATTERNS = 64


@dataclass(frozen=True, eq=False, init=False)
class KalmanFilter(RecursiveFilter):
    """The Kalman filter (2014 Eq. 4, 2015 Eq. 1). Tracks without gaps share filterpy's gains and covariances.

        A_k = (I - K_k H) F,   B_k = K_k

    t are the times of the epochs, (N,) for all tracks or (N, M) for each: numbers in s, or dates, as datetime64,
    datetimes and a pandas index are. They do not decrease; x0 lies one step dt
    of the model before t[0]. The model must say what a step of another length is, as `constant_velocity` and
    `constant_acceleration` do. r are the variances of the measurements, (N, m) or (N, m, M), in place of the model's R:
    the accuracy that a receiver states of each fix. They are looked at only where there is a measurement.

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
            need = "a model that says what a step of another length is (constant_velocity, constant_acceleration)"
            checks.refuse("t", need, "one whose F and Q are for one length only")
        object.__setattr__(self, "t", None if t is None else checks.times("t", t))
        object.__setattr__(self, "r", None if r is None else checks.variances("r", r, model.m))

    def coefficients(self, N: int) -> Step:
        """Return A (N, n, n), B (N, n, m) and the covariance P (N, n, n) of steps 1 to N with nothing missing.

        Raises ValueError for a filter with times or variances: each of its epochs has a `next_step` of its own.
        """
        if not self._epochs_are_alike:
            name, got = ("r", "variances") if self.t is None else ("t", "times")
            checks.refuse(name, "to be left out, as coefficients are those of equal steps and of the model's R", got)
        return super().coefficients(N)

    def next_step(
        self, P: Array, seen: np.ndarray, length: float | None = None, r: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """Return A_k, B_k and P(k+1/k+1) from P(k/k) (n, n), with the measurements seen (m,), by filterpy.

        length is that of the step in units of the model's dt, r (m,) the variances; the model's where None.
        """
        kf = copy.copy(self._filterpy)  # predict and update change the object, so each step takes a copy
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
        return (np.eye(self.model.n) - kf.K @ kf.H) @ kf.F, kf.K @ W, kf.P

    def step(
        self, x: ArrayLike, P: ArrayLike, z_k: ArrayLike, dt: Seconds | None = None, r: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Return x(k+1/k+1) and P(k+1/k+1) from x(k/k) (n,), P(k/k) (n, n) and one measurement z(k+1) (m,).

        NaN stands for a missing measurement. The start is `model.x0` and `P0`. dt is the time since x(k/k), in s
        or a timedelta: a filter with times needs it, others may get it where the model takes steps of other lengths.
        r (m,) are the variances of the measurements, which a filter with variances needs. Raises ValueError or
        TypeError for other shapes, a negative dt, and for states and covariances that are not finite.
        """
        n, m = self.model.n, self.model.m
        x, P = one_state(x, P, n)
        z_k, seen = one_measurement(z_k, m)
        if dt is None and self.t is not None:
            checks.refuse("dt", "the time since x, as the filter has times", "none")
        if r is None and self.r is not None:
            checks.refuse("r", "the variances of z_k, as the filter has them for each epoch", "none")
        length = None if dt is None else self._length_of(checks.not_negative("dt", checks.as_seconds(dt)))
        if r is not None:
            r = checks.variances_of_one("r", r, seen)
        A, B, P = self.next_step(P, seen, length, r)
        return A @ x + B @ np.where(seen, z_k, 0), P

    @property
    def _epochs_are_alike(self):
        return self.t is None and self.r is None

    @property
    def _motion(self):
        return Motion(self.model.F, self.model.Q, self._powers)

    @property
    def _powers(self):
        return None if self.t is None else self.model.powers

    @cached_property
    def _conditions(self):
        lengths = variances = None
        if self.t is not None:
            t = self.t if self.t.ndim == 2 else self.t[:, None]
            lengths = np.concatenate([np.ones((1, t.shape[1])), np.diff(t, axis=0) / self.model.dt])
        if self.r is not None:
            variances = self.r if self.r.ndim == 3 else self.r[..., None]
        return lengths, variances

    def _of_tracks(self, part):
        t = self.t[:, part] if self.t is not None and self.t.ndim == 2 else self.t
        r = self.r[..., part] if self.r is not None and self.r.ndim == 3 else self.r
        return self if t is self.t and r is self.r else replace(self, t=t, r=r)

    def _require_conditions_of(self, z: Array) -> None:
        N, m, M = z.shape
        for name, given, shape in (("t", self.t, (N,)), ("r", self.r, (N, m))):
            if given is not None and given.shape not in (shape, (*shape, M)):
                checks.refuse(name, f"the epochs and tracks of z, {shape} or {(*shape, M)}", f"shape {given.shape}")
        if self.r is not None:
            _, variances = self._conditions
            there = np.broadcast_to(variances, z.shape)[~np.isnan(z)]
            if not (np.isfinite(there) & (there > 0)).all():
                checks.refuse("r", "a positive variance of every measurement that is there", "another")

    def _in_columns(self, rows):
        model, powers = self.model, self._powers
        F, H, Q, R, x0, P0 = model.F, model.H, model.Q, model.R, model.x0, model.P0
        variances = np.diag(R)
        if rows.variances is None and not np.array_equal(R, np.diag(variances)):
            if (rows.seen.all(axis=1) == rows.seen.any(axis=1)).all():
                # With R = L diag(variances) Lᵀ, the measurements L⁻¹ z have uncorrelated noises.
                root = np.linalg.cholesky(R)
                L, variances = root / np.diag(root), np.diag(root) ** 2
                H = np.linalg.solve(L, H)
                rows = replace(rows, z=np.moveaxis(np.tensordot(np.linalg.inv(L), rows.z, axes=(1, 1)), 0, 1))
            else:
                # Rows that are partly missing: the noises join the state, and what is measured has none left.
                F, Q = block_diag(F, np.zeros_like(R)), block_diag(Q, R)
                P0 = block_diag(P0, np.zeros_like(R))
                H, x0, variances = np.hstack([H, np.eye(model.m)]), np.append(x0, np.zeros(model.m)), np.zeros(model.m)
                powers = None if powers is None else np.append(powers, np.zeros(model.m))
        _, _, c, M = rows.z.shape
        x = np.broadcast_to(x0[:, None, None], (len(x0), c, M))
        return KalmanColumns(F, H, Q, variances, P0, powers), rows, x, np.repeat(P0[..., None], M, axis=2)

    def _length_of(self, dt):
        if self.model.dt is None:
            need = "a model that says what a step of another length is (constant_velocity, constant_acceleration)"
            checks.refuse("dt", need, "one whose F and Q are for one length only")
        return dt / self.model.dt

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


class LainiotisFilter(RecursiveFilter):
    """The Lainiotis filter (2014 Eqs. 5-7, 2015 Eqs. 2-3).

        A_k = F_n [I + P(k/k) O_n]⁻¹,   B_k = K_n + A_k P(k/k) K_m,   P(k+1/k+1) = P_n + A_k P(k/k) F_nᵀ

    Each step is made as if x(k/k) were exact: F_n, K_n and P_n; what is not known of it is added, with what the
    measurement tells about it: O_n and K_m. That holds for many steps as well as for one, and that is what this filter
    is good for: `partition` runs a long track in pieces by it, for every filter here. As a filter of its own it
    computes what the Kalman filter computes. Tracks with different gaps take it many times as long.

    >>> from mpt_helpers.model import gsm_axis
    >>> LainiotisFilter(gsm_axis(dt=1.0, q=0.01, r=0.1)).filter([[1.0], [2.0]]).round(4)
    array([[0.0612, 0.1224],
           [0.5557, 0.4681]])
    """

    def next_step(self, P: Array, seen: np.ndarray) -> tuple[Array, Array, Array]:
        """Return A_k, B_k and P(k+1/k+1) from P(k/k), (n, n) or (M, n, n), with the measurements seen (m,)."""
        return lainiotis_step(P, self._constants_of(seen))

    def _constants_of(self, seen):
        kept, pattern = self._constants, seen.tobytes()
        if pattern not in kept:
            if len(kept) == MOST_PATTERNS:
                kept.clear()
            kept[pattern] = lainiotis_matrices(self.model, *neutralised(self.model.H, self.model.R, seen))
        return kept[pattern]

    @cached_property
    def _constants(self):
        return {}

    def _in_columns(self, rows):
        _, _, c, M = rows.z.shape
        x = np.broadcast_to(self.model.x0[:, None, None], (self.model.n, c, M))
        return LainiotisColumns(self), rows, x, np.repeat(self.P0[..., None], M, axis=2)


class LainiotisColumns:
    """The Lainiotis filter on columns: in each epoch, those that see the same measurements take their step together."""

    def __init__(self, lainiotis):
        self._filter = lainiotis
        self._motion = Motion(lainiotis.model.F, lainiotis.model.Q)

    def advance(self, row, x, P):
        """Return x(k+1/k+1) (n, c, M), P(k+1/k+1) (n, n, M) and the innovations at unit covariance (m, c, M)."""
        innovations = self._innovations(row, x, P)
        x, P, z = (np.moveaxis(each, 2, 0).copy() for each in (x, P, row.z))  # stacks of matrices
        for seen in np.unique(row.seen, axis=1).T:
            columns = np.flatnonzero((seen == row.seen.T).all(axis=1))
            A, B, P[columns] = self._filter.next_step(P[columns], seen)
            x[columns] = A @ x[columns] + B @ z[columns]
        return np.moveaxis(x, 0, 2), np.moveaxis(P, 0, 2), innovations

    def _innovations(self, row, x, P):
        H, R = self._filter.model.H, self._filter.model.R
        expected = np.tensordot(H, self._motion.state(x), axes=1)
        P = np.moveaxis(self._motion.covariance(P), 2, 0)
        S = np.moveaxis(H @ P @ H.T + R, 0, 2)[:, :, None]
        return whitened(np.where(row.seen[:, None], row.z - expected, np.nan), S)[0]
