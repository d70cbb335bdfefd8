"""One epoch of many tracks: predict, then correct by each measurement that is there.

Tracks that differ in their gaps, steps or variances differ in their covariances too. So each track is a column of
arrays: x is (n, M) and P is (n, n, M). Tracks that share all of these share a column as well: x is (n, c, M), for c
tracks in each of M columns.

Two ideas keep the Kalman filter free of branches and of loops over tracks:

- A missing measurement gets a gain of zero, and leaves x and P alone.
- Measurements are taken one after the other, each in coordinates where it is one component of the state: for H = [1 dt]
  the state [s v] becomes [s + v dt, v]. There the update needs no matrix inverse, and the row of P that belongs to the
  measured component is written without a difference of large numbers.

A filter on columns is a function, one epoch of it:

    x, P, innovations = advance(row, x, P)

- x comes out linear in x and in the measurements, and P does not depend on them (so `pieces` may start anywhere).
- x and P are left as they were, and a second call returns the same (so a gate may refuse the row, and call again).
- innovations (m, c, M) are white and of unit variance, zero where nothing was measured: the sum of their squares is
  the NIS of the row. A filter whose P is not that of the best estimate returns none, (0, c, M).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from .algebra import LinearMap, product, transposed, whitened
from .shared import epochs_at_a_time


class Steps(NamedTuple):
    """F and Q (n, n, ...) of the steps of columns, and where F has an entry that is not zero: [(i, j), ...]."""

    F: np.ndarray
    Q: np.ndarray
    entries: list


class Row(NamedTuple):
    """One epoch of all columns: z (m, c, M), seen (m, M), the Steps before it and the variances r (m, M).

    The steps are None where they are the model's, and so are the variances.
    """

    z: np.ndarray
    seen: np.ndarray
    steps: Steps | None
    r: np.ndarray | None

    def without(self, refused):
        """Return the Row with nothing measured in the columns that `refused` (M,) says."""
        return self._replace(z=np.where(refused, 0, self.z), seen=self.seen & ~np.asarray(refused))


@dataclass(frozen=True)
class Rows:
    """The epochs of c tracks in each of M columns.

    z (N, m, c, M) is zero where a measurement is missing, and seen (N, m, M) tells which are there. dt (N, M) and r
    (N, m, M) are those of `Epochs`, and `over` too.
    """

    z: np.ndarray
    seen: np.ndarray
    dt: np.ndarray | None = None
    r: np.ndarray | None = None
    over: Callable | None = None

    def __iter__(self):
        """Yield one Row after the other."""
        for part in epochs_at_a_time(len(self.z), self.seen[0].size) if self.dt is not None else [slice(len(self.z))]:
            steps = steps_of(self.over, self.dt, part)
            for k in range(part.start or 0, part.stop):
                of_row = steps and Steps(steps.F[:, :, k - part.start], steps.Q[:, :, k - part.start], steps.entries)
                yield Row(self.z[k], self.seen[k], of_row, None if self.r is None else self.r[k])

    def mapped(self, function):
        """Return the Rows of function(array) for each array."""
        arrays = (None if each is None else function(each) for each in (self.z, self.seen, self.dt, self.r))
        return Rows(*arrays, self.over)

    def with_tracks_of_zeros(self, count):
        """Return the Rows with `count` more tracks in each column, all of whose measurements are zero."""
        N, m, _, M = self.z.shape
        return replace(self, z=np.concatenate([self.z, np.zeros((N, m, count, M))], axis=2))


@dataclass(frozen=True)
class Epochs:
    """Measurements z (N, m, M) of M tracks, NaN where missing, with the steps dt before them and their variances r.

    dt (N, M or 1) are in s, None where all are the model's dt. over(dt) returns F and Q of such steps, (..., n, n). r
    (N, m, M or 1) are None where they are the model's.
    """

    z: np.ndarray
    dt: np.ndarray | None = None
    r: np.ndarray | None = None
    over: Callable | None = None

    @cached_property
    def missing(self):
        """The mask of the measurements that are missing, (N, m, M)."""
        return np.isnan(self.z)

    @property
    def complete(self):
        """Say whether nothing is missing: a NaN makes the sum NaN, sooner seen than a mask (so do two infinities)."""
        return not math.isnan(self.z.sum())

    @cached_property
    def alike(self):
        """Say whether all tracks have the same gaps, steps and variances: then they share their covariances."""
        widths = [array.shape[-1] for array in (self.dt, self.r) if array is not None]
        return all(width == 1 for width in widths) and bool((self.missing == self.missing[..., :1]).all())

    def of(self, tracks):
        """Return the Epochs of some tracks, a slice or a mask of them."""
        dt, r = (a if a is None or a.shape[-1] == 1 else a[..., tracks] for a in (self.dt, self.r))
        return Epochs(self.z[..., tracks], dt, r, self.over)

    def steps(self, part):
        """Return the Steps (n, n, K, M or 1) before the epochs of a slice, None where all are the model's."""
        return steps_of(self.over, self.dt, part)

    def noise(self, R):
        """Return the covariances of the measurements (N, m, m, M or 1), or (m, m, 1) where all are the model's R."""
        if self.r is None:
            return R[..., None]
        # The variance of a measurement that is missing may be anything: the model's stands for it.
        known = np.where(np.isfinite(self.r) & (self.r > 0), self.r, np.diag(R)[:, None])
        return known[:, :, None] * np.eye(len(R))[..., None]

    def rows(self, together):
        """Return the Rows: all tracks in one column if they are to lie together, else each in a column of its own."""
        seen = ~self.missing[..., :1] if together else ~self.missing
        z = as_columns(np.where(self.missing, 0, self.z), together)
        dt = None if self.dt is None else np.broadcast_to(self.dt, (len(z), seen.shape[-1]))
        r = None if self.r is None else np.where(seen, self.r, 1)  # what is not used must not spread
        return Rows(z, seen, dt, r, self.over)


def as_columns(array, together):
    """Return a view of an array (..., M) of all tracks: (..., M, 1) in one column, else (..., 1, M)."""
    return array[..., None] if together else array[..., None, :]


def steps_of(over, dt, part):
    """Return the Steps (n, n, K, M) of dt[part] (K, M), or None."""
    if dt is None:
        return None
    F, Q = (np.moveaxis(each, (-2, -1), (0, 1)) for each in over(dt[part]))
    return Steps(F, Q, np.argwhere(F.any(axis=(2, 3))).tolist())


class Prediction:
    """x <- F x and P <- F P Fᵀ + Q on columns: x is (n, ...), P is (n, n, ...).

    F and Q (n, n) are those of the model's dt; the columns may have Steps of their own.
    """

    def __init__(self, F, Q):
        self.F, self.Q = F, Q
        self._map = LinearMap(F)

    def __call__(self, x, P, steps=None):
        """Return F x and F P Fᵀ + Q."""
        return self.state(x, steps), self.covariance(P, steps)

    def state(self, x, steps=None):
        """Return F x."""
        return self._map.of_state(x) if steps is None else _times(steps, x)

    def covariance(self, P, steps=None):
        """Return F P Fᵀ + Q, symmetric to the last bit where P is."""
        if steps is None:
            return self._map.of_covariance(P) + self.Q.reshape(*self.Q.shape, *[1] * (P.ndim - 2))
        P = _times(steps, transposed(_times(steps, P)))
        return (P + transposed(P)) / 2 + steps.Q


def _times(steps, x):
    """Return F x (n, ...) of x (n, ...): most entries of F are zero in all columns."""
    moved = np.zeros(x.shape)
    for i, j in steps.entries:
        moved[i] += steps.F[i, j] * x[j]
    return moved


def corrected(x, P, z, seen, variance, i):
    """Return x (n, c, M), P (n, n, M) and the innovations at unit variance, after measurements z (c, M) of component i.

    seen (M,) tells where there is one, and its variance v is a number or (M,). It is the textbook's update with eᵢᵀ for
    H. With row i of P as p and S = pᵢ + v, the gain K is p / S, and the new row i is p - pᵢ p / S = p v / S: that last
    form takes no difference of large numbers. P is overwritten, so it must be the caller's own.

    The third result is the innovation (z - xᵢ) / √S (c, M) at unit variance, zero where nothing was measured.
    """
    p = P[i].copy()
    S = p[i] + variance
    one_over_S = seen / S  # zero where nothing was measured: then the gain is zero too
    K = p * one_over_S
    P -= K[:, None] * p
    P[i] = P[:, i] = p * np.where(seen, variance / S, 1.0)
    innovation = z - x[i]
    with np.errstate(invalid="ignore"):  # where rounding took S below zero: a NaN, and the track is not cut
        one_over_root = np.sqrt(one_over_S)
    return x + K[:, None] * innovation, P, innovation * one_over_root


class KalmanColumns:
    """The Kalman filter on columns, for measurements H x (m, n) with noises of uncorrelated variances (m,).

    The variances are used where rows have none of their own. P0 (n, n), the covariance of the start, decides in which
    coordinates the measurements are taken.
    """

    def __init__(self, prediction, H, variances, P0):
        self._predicted = prediction
        self._variances = variances[:, None]
        self._changes, T = _coordinates(prediction.F, prediction.Q, H, variances, P0)
        self._back = LinearMap(np.linalg.inv(T))

    def advance(self, row, x, P):
        """Return x(k+1/k+1), P(k+1/k+1) and the innovations from x(k/k) and P(k/k)."""
        x, P = self._predicted(x, P, row.steps)
        variances = self._variances if row.r is None else row.r
        innovations = np.zeros((len(row.z), *x.shape[1:]))
        for change, j, i in self._changes:
            x, P = change(x, P)
            x, P, innovations[j] = corrected(x, P, row.z[j], row.seen[j], variances[j], i)
        x, P = self._back(x, P)
        return x, P, innovations


def _coordinates(F, Q, H, variances, P0):
    """Return the changes of coordinates that make one measurement after the other a component of the state.

    Each is (LinearMap, index of the row of H, component). Also returns T (n, n), which takes the state to the last
    coordinates.

    In exact numbers any choice gives the same estimates. Which component a measurement replaces decides the digits that
    are left: it is the one that contributes most to it, since one that contributes little would come back as a small
    difference of large numbers. So it does no harm that the sizes are rough here: after n steps of one dt, within
    which the noise has reached every state that it reaches, and with the variances of the model, also where epochs have
    variances of their own.
    """
    n, P = len(F), P0
    for _ in range(n):
        P = F @ P @ F.T + Q
    sigma = np.sqrt(np.maximum(np.diag(P), np.finfo(float).tiny))  # the size of each coordinate
    changes, T = [], np.eye(n)
    for j, h in enumerate(H):
        if h.any():  # a row of zeros tells nothing
            weights = h @ np.linalg.inv(T)  # h x in the present coordinates
            i = int(np.argmax(np.abs(weights) * sigma))
            change = np.eye(n)
            change[i] = weights
            # The other coordinates stay what they were. The new one is h x. Before the measurement its sigma is at
            # most the sum of what each coordinate gives; after it, at most that of the measurement's noise.
            sigma[i] = min(np.sqrt(variances[j]), np.abs(weights) @ sigma)
            T = change @ T
            changes.append((LinearMap(change), j, i))
    return changes, T


def kalman_on_columns(prediction, H, R, x0, P0, rows):
    """Return the `advance` of the Kalman filter on Rows, x0 (d,) and P0 (d, d), where d > n if noises are states.

    `KalmanColumns` takes measurements of uncorrelated noises. There are two ways to make them so, the second of which
    takes rows that are partly missing, and costs m states more.
    """
    variances = np.diag(R)
    if rows.r is not None or np.array_equal(R, np.diag(variances)):
        return KalmanColumns(prediction, H, variances, P0).advance, x0, P0
    if (rows.seen.all(axis=1) == rows.seen.any(axis=1)).all():
        return _decorrelated(prediction, H, R, P0), x0, P0
    m = len(R)
    noise = np.zeros((m, m))
    return _with_noises_as_states(prediction, H, R, P0), np.append(x0, np.zeros(m)), block_diag(P0, noise)


def _decorrelated(prediction, H, R, P0):
    """Return the `advance` for rows that are whole or missed.

    With R = L diag(variances) Lᵀ, the measurements L⁻¹ z = L⁻¹ H x + L⁻¹ v have uncorrelated noises.
    """
    root = np.linalg.cholesky(R)
    L_inverse = np.linalg.inv(root / np.diag(root))
    kalman = KalmanColumns(prediction, L_inverse @ H, np.diag(root) ** 2, P0)
    return lambda row, x, P: kalman.advance(row._replace(z=np.tensordot(L_inverse, row.z, axes=1)), x, P)


def _with_noises_as_states(prediction, H, R, P0):
    """Return the `advance` for any rows.

    The noises v become states behind those of x: z = [H I] [x; v], and what is measured has no other noise. S is the
    variance of H x + v, which is positive: v is new in each row, and R is definite.
    """
    m, n = H.shape
    noise = np.zeros((m, m))
    both = Prediction(block_diag(prediction.F, noise), block_diag(prediction.Q, R))
    kalman = KalmanColumns(both, np.hstack([H, np.eye(m)]), np.zeros(m), block_diag(P0, noise))

    def advance(row, x, P):
        if row.steps is not None:
            F, Q = np.zeros((2, n + m, n + m, P.shape[2]))
            F[:n, :n], Q[:n, :n], Q[n:, n:] = row.steps.F, row.steps.Q, R[..., None]
            row = row._replace(steps=Steps(F, Q, row.steps.entries))
        return kalman.advance(row, x, P)

    return advance


class ConstantGainColumns:
    """A filter of constant gain B (n, m) on columns. Each row is complete or missed: then it is predicted only.

    P is the covariance of the true error if that of x0 is P0.
    """

    def __init__(self, prediction, B, H, R):
        self._predicted = prediction
        self._B = B
        self._keep = LinearMap(np.eye(len(B)) - B @ H)
        self._noise = (B @ R @ B.T)[..., None]

    def advance(self, row, x, P):
        """Return x(k+1/k+1) and P(k+1/k+1), and no innovations: the gain being constant, none corrects the start."""
        x, P = self._predicted(x, P)
        seen = row.seen[0]
        x_seen, P_seen = self._keep(x, P)
        measured = (self._B @ row.z.reshape(len(row.z), -1)).reshape(x.shape)
        return (
            np.where(seen, x_seen + measured, x),
            np.where(seen, P_seen + self._noise, P),
            np.zeros((0, *x.shape[1:])),
        )


class SteppedColumns:
    """Any filter on columns, by its next_steps(P, seen): columns that see the same measurements go together.

    The innovations are those of the model's step, for a filter whose gain follows its covariance (`optimal`).
    """

    def __init__(self, next_steps, optimal, prediction, H, R):
        self._next_steps, self._optimal, self._predicted, self._H, self._R = next_steps, optimal, prediction, H, R

    def advance(self, row, x, P):
        """Return x(k+1/k+1) (n, c, M), P(k+1/k+1) (n, n, M) and the innovations."""
        innovations = self._innovations(row, x, P) if self._optimal else np.zeros((0, *x.shape[1:]))
        x, P, z = (np.moveaxis(each, 2, 0).copy() for each in (x, P, row.z))  # stacks of matrices
        for seen in np.unique(row.seen, axis=1).T:
            columns = np.flatnonzero((seen == row.seen.T).all(axis=1))
            A, B, P[columns] = self._next_steps(P[columns], seen)
            x[columns] = A @ x[columns] + B @ z[columns]
        return np.moveaxis(x, 0, 2), np.moveaxis(P, 0, 2), innovations

    def _innovations(self, row, x, P):
        x, P = self._predicted(x, P)
        S = product(product(self._H, P), self._H.T) + self._R[..., None]
        expected = np.tensordot(self._H, x, axes=1)
        return whitened(np.where(row.seen[:, None], row.z - expected, np.nan), S[:, :, None])[0]
