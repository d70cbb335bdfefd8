"""One epoch of many tracks: predict, then correct by each measurement that is there.

Tracks that differ in their gaps, steps or variances differ in their covariances. So each track is a column of arrays: x
is (n, M) and P is (n, n, M). Tracks that share all of these share a column: x is (n, c, M), c vectors in each of M
columns. A filter on columns is one function,

    x, P, innovations = advance(epoch, x, P)

- x comes out linear in x and in z, P depends on neither, and both arguments are left as they were: so `pieces` of a
  track may start anywhere.
- innovations (m, c, M) are white and of unit variance, zero where nothing was measured. A filter whose P is not that of
  the best estimate returns none, (0, c, M).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import repeat
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag

from .algebra import LinearMap, product, transposed, whitened
from .shared import epochs_at_a_time


class Steps(NamedTuple):
    """F and Q (n, n, ...) of steps whose lengths are their own."""

    F: np.ndarray
    Q: np.ndarray

    @classmethod
    def over(cls, transition: Callable[..., Any], dt: np.ndarray) -> Steps:
        """Return the Steps (n, n, ...) of lengths dt (...)."""
        return cls(*(np.moveaxis(each, (-2, -1), (0, 1)) for each in transition(dt)))


class Epoch(NamedTuple):
    """One epoch of all columns: z (m, c, M), zero where missing, seen (m, M), the Steps before it, variances r (m, M).

    Steps and variances are None where they are the model's.
    """

    z: np.ndarray
    seen: np.ndarray
    steps: Steps | None
    r: np.ndarray | None


@dataclass(frozen=True)
class Rows:
    """The epochs of columns, to be iterated: z (N, m, c, M), seen (N, m, M); dt (N, M), r (N, m, M) as in `Epochs`."""

    z: np.ndarray
    seen: np.ndarray
    dt: np.ndarray | None = None
    r: np.ndarray | None = None
    over: Callable[..., Any] | None = None

    def __iter__(self) -> Iterator[Epoch]:
        """Yield one Epoch after the other."""
        steps = repeat(None) if self.dt is None else self._steps()
        r = repeat(None) if self.r is None else self.r
        return map(Epoch, self.z, self.seen, steps, r)

    def _steps(self):
        """Yield the Steps before each epoch; F and Q of many epochs are made at once."""
        for part in epochs_at_a_time(len(self.dt), self.seen[0].size):
            F, Q = Steps.over(self.over, self.dt[part])
            for k in range(part.stop - part.start):
                yield Steps(F[:, :, k], Q[:, :, k])


@dataclass(frozen=True)
class Epochs:
    """Measurements z (N, m, M) of M tracks, NaN where missing, with the steps dt before them and their variances r.

    dt (N, M or 1) are in s, None where all are the model's dt. over(dt) returns F and Q of such steps, (..., n, n). r
    (N, m, M or 1) are None where they are the model's.
    """

    z: np.ndarray
    dt: np.ndarray | None = None
    r: np.ndarray | None = None
    over: Callable[..., Any] | None = None

    @cached_property
    def missing(self) -> np.ndarray:
        """The mask of the measurements that are missing, (N, m, M)."""
        return np.isnan(self.z)

    @property
    def complete(self) -> bool:
        """Say whether nothing is missing: a NaN, or two infinities, makes the sum NaN, which is faster than a mask."""
        return not math.isnan(self.z.sum())

    @cached_property
    def alike(self) -> bool:
        """Say whether all tracks have the same gaps, steps and variances: then they share their covariances."""
        widths = [array.shape[-1] for array in (self.dt, self.r) if array is not None]
        return all(width == 1 for width in widths) and bool((self.missing == self.missing[..., :1]).all())

    def of(self, tracks: slice | np.ndarray) -> Epochs:
        """Return the Epochs of some tracks, a slice or a mask of them."""
        dt, r = (a if a is None or a.shape[-1] == 1 else a[..., tracks] for a in (self.dt, self.r))
        return Epochs(self.z[..., tracks], dt, r, self.over)

    def steps(self, part: slice) -> Steps | None:
        """Return the Steps (n, n, K, M or 1) before the epochs of a slice, None where all are the model's."""
        return None if self.dt is None else Steps.over(self.over, self.dt[part])

    def noise(self, R: np.ndarray) -> np.ndarray:
        """Return the covariances of the measurements (N, m, m, M or 1), or (m, m, 1) where all are the model's R."""
        if self.r is None:
            return R[..., None]
        # The variance of a measurement that is missing may be anything: the model's stands for it.
        known = np.where(np.isfinite(self.r) & (self.r > 0), self.r, np.diag(R)[:, None])
        return known[:, :, None] * np.eye(len(R))[..., None]

    def rows(self, together: bool) -> Rows:
        """Return the Rows: all tracks in one column if they are to lie together, else each in a column of its own."""
        seen = ~self.missing[..., :1] if together else ~self.missing
        z = as_columns(np.where(self.missing, 0, self.z), together)
        dt = None if self.dt is None else np.broadcast_to(self.dt, (len(z), seen.shape[-1]))
        r = None if self.r is None else np.where(seen, self.r, 1)  # a NaN that is not used must not spread
        return Rows(z, seen, dt, r, self.over)


def as_columns(array, together):
    """Return a view of an array (..., M) of all tracks: (..., M, 1) in one column, else (..., 1, M)."""
    return array[..., None] if together else array[..., None, :]


class Prediction:
    """x <- F x and P <- F P Fᵀ + Q on columns, with the F and Q (n, n) of the model or with Steps of their own."""

    def __init__(self, F, Q):
        self.F, self.Q = F, Q
        self._map = LinearMap(F)

    def __call__(self, x, P, steps=None):
        """Return F x and F P Fᵀ + Q."""
        return self.state(x, steps), self.covariance(P, steps)

    def state(self, x, steps=None):
        """Return F x."""
        return self._map.of_state(x) if steps is None else product(steps.F, x)

    def covariance(self, P, steps=None):
        """Return F P Fᵀ + Q, symmetric to the last bit where P is."""
        if steps is None:
            return self._map.of_covariance(P) + self.Q.reshape(*self.Q.shape, *[1] * (P.ndim - 2))
        P = product(steps.F, transposed(product(steps.F, P)))
        return (P + transposed(P)) / 2 + steps.Q


def corrected(x, P, z, seen, variance, i):
    """Return x (n, c, M), P (n, n, M) and the innovations at unit variance, after measurements z (c, M) of component i.

    seen (M,) tells where there is one, and its variance v is a number or (M,). It is the textbook's update with eᵢᵀ for
    H: with row i of P as p and S = pᵢ + v, the gain K is p / S, and the new row i is p - pᵢ p / S = p v / S. That last
    form takes no difference of large numbers. x and P are overwritten, so they must be the caller's own.
    """
    p = P[i].copy()
    S = p[i] + variance
    weight = np.sqrt(seen / S)  # zero where nothing was measured: then the gain is zero too
    K = p * weight**2
    P -= K[:, None] * p
    P[i] = P[:, i] = p * np.where(seen, variance / S, 1.0)
    innovation = z - x[i]
    x += K[:, None] * innovation
    return x, P, innovation * weight


class KalmanColumns:
    """The Kalman filter on columns of Rows, for measurements H x (m, n) with noises of covariance R (m, m).

    Each measurement is taken in coordinates where it is one component of the state: for H = [1 dt] the state [s v]
    becomes [s + v dt, v]. Where the Rows have variances of their own, those stand for R. P0 (n, n) is the covariance of
    the start.

    Correlated noises v, with R = L diag(variances) Lᵀ, are made uncorrelated: L⁻¹ z = L⁻¹ H x + L⁻¹ v. Where rows are
    partly missing, the noises become states behind those of x instead: z = [H I] [x; v], without any other noise.
    """

    def __init__(self, prediction, H, R, P0, rows):
        self._predicted, self._R = prediction, R
        F, Q, variances, m = prediction.F, prediction.Q, np.diag(R), len(R)
        correlated = rows.r is None and not np.array_equal(R, np.diag(variances))
        self._noises_are_states = correlated and bool((rows.seen.any(axis=1) != rows.seen.all(axis=1)).any())
        self._L_inverse = None
        if self._noises_are_states:
            none = np.zeros((m, m))
            F, Q, P0 = block_diag(F, none), block_diag(Q, R), block_diag(P0, none)
            H, variances = np.hstack([H, np.eye(m)]), np.zeros(m)
        elif correlated:
            root = np.linalg.cholesky(R)
            self._L_inverse = np.linalg.inv(root / np.diag(root))
            H, variances = self._L_inverse @ H, np.diag(root) ** 2
        self._variances = variances[:, None]
        self._changes, T = _coordinates(F, Q, H, variances, P0)
        self._back = LinearMap(np.linalg.inv(T))

    def advance(self, epoch, x, P):
        """Return x(k+1/k+1), P(k+1/k+1) and the innovations from x(k/k) and P(k/k)."""
        n = len(x)
        x, P = self._predicted(x, P, epoch.steps)
        known = P.diagonal().T == 0  # (n, M)
        if self._noises_are_states:
            x, P = self._with_noises(x, P)
        z = epoch.z if self._L_inverse is None else np.tensordot(self._L_inverse, epoch.z, axes=1)
        variances = self._variances if epoch.r is None else epoch.r
        innovations = np.zeros((len(z), *x.shape[1:]))
        for change, j, i in self._changes:
            x, P = change(x, P)
            x, P, innovations[j] = corrected(x, P, z[j], epoch.seen[j], variances[j], i)
        x, P = self._back(x, P)
        x, P = x[:n], P[:n, :n]
        if known.any():  # a state known exactly stays so: its variance would be the rounding of zero, of either sign
            P = np.where(known[:, None] | known, 0.0, P)
        return x, P, innovations

    def _with_noises(self, x, P):
        """Return [x; 0] and the covariance of [x; v]: the noises v are new in each epoch."""
        (n, c, M), m = x.shape, len(self._R)
        both = np.zeros((n + m, n + m, M))
        both[:n, :n], both[n:, n:] = P, self._R[..., None]
        return np.concatenate([x, np.zeros((m, c, M))]), both


def _coordinates(F, Q, H, variances, P0):
    """Return the changes of coordinates that make one measurement after the other a component of the state.

    Each is (LinearMap, index of the row of H, component). Also returns T (n, n), which takes the state to the last
    coordinates.

    In exact arithmetic any choice gives the same estimates, but the digits that are left depend on the component that a
    measurement replaces. It is the one that contributes most, since one that contributes little would come back as a
    small difference of large numbers. Rough sizes suffice: those after n steps of the model, within which the noise has
    reached every state that it reaches.
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
            # The new coordinate is h x. Before the measurement its sigma is at most the sum of what each coordinate
            # gives; after it, at most that of the measurement's noise.
            sigma[i] = min(np.sqrt(variances[j]), np.abs(weights) @ sigma)
            T = change @ T
            changes.append((LinearMap(change), j, i))
    return changes, T


class ConstantGainColumns:
    """A filter of constant gain B (n, m) on columns. Each row is complete or missed: then it is predicted only.

    P is the covariance of the true error if that of x0 is P0.
    """

    def __init__(self, prediction, B, H, R):
        self._predicted, self._B = prediction, B
        self._keep = LinearMap(np.eye(len(B)) - B @ H)
        self._noise = (B @ R @ B.T)[..., None]

    def advance(self, epoch, x, P):
        """Return x(k+1/k+1) and P(k+1/k+1), and no innovations."""
        x, P = self._predicted(x, P)
        seen = epoch.seen[0]
        x_seen, P_seen = self._keep(x, P)
        x_seen = x_seen + np.tensordot(self._B, epoch.z, axes=1)
        return np.where(seen, x_seen, x), np.where(seen, P_seen + self._noise, P), x[:0]


def advance_by_steps(estimator, epoch, x, P):
    """Return x(k+1/k+1) (n, c, M), P(k+1/k+1) (n, n, M) and the innovations, by the `next_steps` of any filter.

    Columns that see the same measurements go together.
    """
    innovations = _innovations_of_model(estimator, epoch, x, P) if estimator.optimal else x[:0]
    x, P, z = (np.moveaxis(each, 2, 0).copy() for each in (x, P, epoch.z))  # stacks of matrices
    for seen in np.unique(epoch.seen, axis=1).T:
        columns = np.flatnonzero((seen == epoch.seen.T).all(axis=1))
        A, B, P[columns] = estimator.next_steps(P[columns], seen)
        x[columns] = A @ x[columns] + B @ z[columns]
    return np.moveaxis(x, 0, 2), np.moveaxis(P, 0, 2), innovations


def _innovations_of_model(estimator, epoch, x, P):
    """Return the innovations (m, c, M) at unit variance that the model expects of a filter whose P is true."""
    H, R = estimator.model.H, estimator.model.R
    x, P = estimator.prediction(x, P)
    S = product(product(H, P), H.T[..., None]) + R[..., None]
    expected = np.tensordot(H, x, axes=1)
    return whitened(np.where(epoch.seen[:, None], epoch.z - expected, np.nan), S[:, :, None])[0]
