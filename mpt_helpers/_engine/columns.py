"""One epoch of many tracks: predict, then correct by each measurement that is there.

Tracks that differ in their gaps, steps or variances differ in their covariances, so each track is a column of arrays.
Tracks that share all three share one covariance, and lie together in one column. The axes:

    N      epochs, always first                    n, m   states, measurements
    M      tracks                                  W      columns: 1 where all tracks share P, else M
    c      tracks that lie in one column, M / W    K, C   rows of a piece, number of pieces (`pieces`)

    as given     z (N, m, M)       t (N, M or 1)             r (N, m, M or 1)
    results      x (N, n, M)       P (N, n, n, W)
    on columns   x (n, c, W)       P (n, n, W)               of one epoch
    rows         z (N, m, c, W)    seen, r (N, m, W)         F, Q (N, n, n, W)

A filter on columns is one function of a row (z, seen, F, Q, r), which holds those arrays of one epoch:

    x, P, innovations = advance(row, x, P)

- The new x is linear in x and z, the new P depends on neither, and the arguments are left unchanged. `pieces` relies on
  all three.
- innovations (m, c, W) are white and of unit variance, and zero where nothing was measured. A filter that is not
  `optimal` returns none, (0, c, W).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from .algebra import LinearMap, Motion


@dataclass(frozen=True)
class Epochs:
    """Measurements z (N, m, M) of M tracks, NaN where missing, with the steps dt before them and their variances r.

    motion is the model's. dt (N, M or 1) are in s, None where all are the model's dt; over(dt) returns F and Q of such
    steps, (..., n, n). r (N, m, M or 1) are None where they are the model's.
    """

    z: np.ndarray
    motion: Motion
    dt: np.ndarray | None = None
    r: np.ndarray | None = None
    over: Any = None

    @cached_property
    def missing(self) -> np.ndarray:
        """The mask of the measurements that are missing, (N, m, M)."""
        return np.isnan(self.z)

    @property
    def complete(self) -> bool:
        """Whether nothing is missing. A NaN makes the sum NaN (as do infinities of both signs): faster than a mask."""
        return not math.isnan(self.z.sum())

    @cached_property
    def width(self) -> int:
        """The number of columns W: 1 where all tracks have the same gaps, steps and variances, and so share P."""
        own = [array for array in (self.dt, self.r) if array is not None and array.shape[-1] > 1]
        shared = not own and (self.missing == self.missing[..., :1]).all()
        return 1 if shared else self.z.shape[2]

    def of(self, tracks: slice | np.ndarray) -> Epochs:
        """Return the Epochs of some tracks, a slice or a mask of them."""
        dt, r = (a if a is None or a.shape[-1] == 1 else a[..., tracks] for a in (self.dt, self.r))
        return Epochs(self.z[..., tracks], self.motion, dt, r, self.over)

    def motions(self, part: slice) -> Motion:
        """Return the Motion before the epochs of a slice: the model's, or one of F and Q (n, n, K, M or 1)."""
        if self.dt is None:
            return self.motion
        F, Q = self.over(self.dt[part])
        return Motion(np.moveaxis(F, (-2, -1), (0, 1)), np.moveaxis(Q, (-2, -1), (0, 1)))

    def noise(self, R: np.ndarray) -> np.ndarray:
        """Return the covariances of the measurements (N, m, m, M or 1), or (m, m, 1) where all are the model's R."""
        if self.r is None:
            return R[..., None]
        return self.r[:, :, None] * np.eye(len(R))[..., None]

    def rows(self) -> tuple[np.ndarray | None, ...]:
        """Return z (zero where missing), seen, F, Q and r; the last three are None where they are the model's."""
        W, (N, m, _) = self.width, self.z.shape
        seen = ~self.missing[..., :W]
        z = np.where(self.missing, 0.0, self.z).reshape(N, m, -1, W)
        F = Q = None
        if self.dt is not None:
            every = self.motions(slice(None))
            F, Q = (np.moveaxis(np.broadcast_to(A, (*A.shape[:3], W)), 2, 0) for A in (every.matrix, every.Q))
        r = None if self.r is None else np.broadcast_to(self.r, seen.shape)
        return z, seen, F, Q, r


def corrected(x, P, z, seen, variance, i):
    """Return x (n, c, W), P (n, n, W) and the innovations at unit variance, after measurements z (c, W) of component i.

    seen (W,) tells where there is one, and its variance v is a number or (W,). It is the textbook's update with eᵢᵀ for
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
    """The Kalman filter on columns, for measurements H x (m, n) with noises of covariance R (m, m).

    Each measurement is taken in coordinates where it is one component of the state: for H = [1 dt] the state [s v]
    becomes [s + v dt, v]. Where a row brings variances r, they replace R. P0 (n, n) is the covariance of the start.

    Correlated noises v, R = L diag(variances) Lᵀ, are made uncorrelated: L⁻¹ z = L⁻¹ H x + L⁻¹ v. For rows that are
    partly missing, the noises become states behind those of x instead: z = [H I] [x; v], without any other noise.
    """

    def __init__(self, motion, H, R, P0, noises_are_states=False):
        self._motion, self._noise, self._L_inverse = motion, None, None
        F, Q, variances, m = motion.matrix, motion.Q, np.diag(R), len(R)
        if noises_are_states:
            self._noise = R[..., None]
            none = np.zeros((m, m))
            F, Q, P0 = block_diag(F, none), block_diag(Q, R), block_diag(P0, none)
            H, variances = np.hstack([H, np.eye(m)]), np.zeros(m)
        elif not np.array_equal(R, np.diag(variances)):
            root = np.linalg.cholesky(R)
            self._L_inverse = np.linalg.inv(root / np.diag(root))
            H, variances = self._L_inverse @ H, np.diag(root) ** 2
        self._variances = variances[:, None]
        self._changes, self._back = _coordinates(F, Q, H, variances, P0)

    def advance(self, row, x, P):
        """Return x(k+1/k+1), P(k+1/k+1) and the innovations from x(k/k) and P(k/k)."""
        z, seen, F, Q, r = row
        n, motion = len(x), self._motion if F is None else Motion(F, Q)
        x, P = motion(x, P)
        known = P.diagonal().T == 0  # (n, W)
        if self._noise is not None:
            x, P = self._with_noise(x, P)
        if self._L_inverse is not None:
            z = np.tensordot(self._L_inverse, z, axes=1)
        variances = self._variances if r is None else r
        innovations = np.zeros((len(z), *x.shape[1:]))
        for change, j, i in self._changes:
            x, P = change(x, P) if change else (x, P)
            x, P, innovations[j] = corrected(x, P, z[j], seen[j], variances[j], i)
        x, P = self._back(x, P) if self._back else (x, P)
        x, P = x[:n], P[:n, :n]
        if known.any():  # a state known exactly stays so: its variance would be the rounding of zero, of either sign
            P = np.where(known[:, None] | known, 0.0, P)
        return x, P, innovations

    def _with_noise(self, x, P):
        """Return [x; 0] and the covariance of [x; v]: the noises v are new in each epoch."""
        (n, c, W), m = x.shape, len(self._noise)
        both = np.zeros((n + m, n + m, W))
        both[:n, :n], both[n:, n:] = P, self._noise
        return np.concatenate([x, np.zeros((m, c, W))]), both


def _coordinates(F, Q, H, variances, P0):
    """Return the changes of coordinates that make one measurement after the other a component of the state.

    Each is (LinearMap or None, index of the row of H, component). Also returns the LinearMap from the last coordinates
    back to the state. None changes nothing.

    In exact arithmetic any choice gives the same estimates. In doubles, a measurement replaces the component that
    contributes most to it: one that contributes little would be recovered as a small difference of large numbers. Rough
    sizes suffice: those after n steps of the model, when the process noise has reached every state that it can reach.
    """
    n, P = len(F), P0
    for _ in range(n):
        P = F @ P @ F.T + Q
    sigma = np.sqrt(np.maximum(np.diag(P), np.finfo(float).tiny))  # the size of each coordinate
    changes, T = [], np.eye(n)
    for j, h in enumerate(H):
        if h.any():  # a row of zeros measures nothing
            weights = h @ np.linalg.inv(T)  # h x in the present coordinates
            i = int(np.argmax(np.abs(weights) * sigma))
            change = np.eye(n)
            change[i] = weights
            # The new coordinate is h x. Before the measurement its sigma is at most the sum of what each coordinate
            # gives; after it, at most that of the measurement's noise.
            sigma[i] = min(np.sqrt(variances[j]), np.abs(weights) @ sigma)
            T = change @ T
            changes.append((_unless_identity(change), j, i))
    return changes, _unless_identity(np.linalg.inv(T))


def _unless_identity(T):
    return None if np.array_equal(T, np.eye(len(T))) else LinearMap(T)
