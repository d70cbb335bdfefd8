"""One epoch of many tracks: predict, then correct by each measurement that is there.

Tracks with different gaps, time steps or variances have different covariances, so each track is a column of arrays.
Tracks that share all three share one covariance and one column. The axes:

    N      epochs, always first                    n, m   states, measurements
    M      tracks                                  W      columns: 1 where all tracks share P, else M
    c      tracks in one column, M / W             K, C   rows of a piece, number of pieces (`pieces`)

    as given     z (N, m, M)       dt (N, M or 1)            r (N, m, M or 1)
    results      x (N, n, M)       P (N, n, n, W)
    on columns   x (n, c, W)       P (n, n, W)               of one epoch
    rows         z (N, m, c, W)    seen, r (N, m, W)         F, Q (N, n, n, W)

A filter on columns is one function, which takes the row (z, seen, F, Q, r) of one epoch:

    x, P, innovations = advance(row, x, P)

- The new x is linear in x and z, and the new P depends on neither. The arguments are not modified. `pieces` relies on
  all three.
- The innovations (m, c, W) are white with unit variance, and zero where a measurement is missing. A filter that is not
  `optimal` returns none, (0, c, W).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import block_diag


@dataclass(frozen=True)
class Epochs:
    """Measurements z (N, m, M) of M tracks, NaN where missing, with their time steps dt and variances r.

    motion is the model's. dt (N, M or 1) is the time before each epoch in s, or None for the model's; over(dt) returns
    the F and Q (..., n, n) of such steps. r is (N, m, M or 1), or None for the model's R.
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

    @cached_property
    def width(self) -> int:
        """The number of columns W: 1 where all tracks have the same gaps, time steps and variances, and so share P."""
        own = [array for array in (self.dt, self.r) if array is not None and array.shape[-1] > 1]
        shared = not own and (self.missing == self.missing[..., :1]).all()
        return 1 if shared else self.z.shape[2]

    def select(self, tracks: slice | np.ndarray) -> Epochs:
        """Return the Epochs of some tracks, a slice or a mask of them."""
        dt, r = (a if a is None or a.shape[-1] == 1 else a[..., tracks] for a in (self.dt, self.r))
        return Epochs(self.z[..., tracks], self.motion, dt, r, self.over)

    def motions(self, part: slice) -> Motion:
        """Return the model's Motion, or the Motions up to each epoch of a slice, with F and Q (n, n, K, M or 1)."""
        if self.dt is None:
            return self.motion
        F, Q = self.over(self.dt[part])
        return Motions(np.moveaxis(F, (-2, -1), (0, 1)), np.moveaxis(Q, (-2, -1), (0, 1)))

    def noise(self, R: np.ndarray) -> np.ndarray:
        """Return the noise covariances (N, m, m, M or 1), or the model's R as (m, m, 1)."""
        if self.r is None:
            return R[..., None]
        return self.r[:, :, None] * np.eye(len(R))[..., None]

    def rows(self) -> tuple[np.ndarray | None, ...]:
        """Return z (zero where missing), seen, F, Q and r; F, Q and r are None where they are the model's."""
        W, (N, m, _) = self.width, self.z.shape
        seen = ~self.missing[..., :W]
        z = np.where(self.missing, 0.0, self.z).reshape(N, m, -1, W)
        F = Q = None
        if self.dt is not None:
            every = self.motions(slice(None))
            F, Q = (np.moveaxis(np.broadcast_to(A, (*A.shape[:3], W)), 2, 0) for A in (every.matrix, every.Q))
        r = None if self.r is None else np.broadcast_to(self.r, seen.shape)
        return z, seen, F, Q, r


def scalar_update(x, P, z, seen, variance, i):
    """Correct x (n, c, W) and P (n, n, W) in place by z (c, W), a measurement of component i of the state.

    seen (W,) marks the columns that have this measurement; its variance v is a number or (W,). This is the textbook
    update with H = eᵢᵀ: with row i of P as p and S = pᵢ + v, the gain K is p / S, and the new row i is
    p - pᵢ p / S = p v / S. The last form avoids a difference of large numbers. Returns x, P and the innovations,
    normalized to unit variance.
    """
    p = P[i].copy()
    S = p[i] + variance
    weight = np.sqrt(seen / S)  # zero, and with it the gain, where the measurement is missing
    K = p * weight**2
    P -= K[:, None] * p
    P[i] = P[:, i] = p * np.where(seen, variance / S, 1.0)
    innovation = z - x[i]
    x += K[:, None] * innovation
    return x, P, innovation * weight


class KalmanColumns:
    """The Kalman filter on columns, for measurements z = H x + v with H (m, n) and noise v of covariance R (m, m).

    Each measurement is processed in coordinates in which it is one component of the state: for H = [1 dt], the state
    [s v] becomes [s + v dt, v]. The variances r of a row, if given, replace R. P0 (n, n) is the initial covariance.

    Correlated noise is decorrelated by R = L diag(variances) Lᵀ: the filter takes L⁻¹ z = L⁻¹ H x + L⁻¹ v. In a partly
    missing row this would mix the missing measurements with the others. There (noises_are_states) the state is
    augmented by v instead, and z = [H I] [x; v] has no further noise.
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
        n, motion = len(x), self._motion if F is None else Motions(F, Q)
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
            x, P, innovations[j] = scalar_update(x, P, z[j], seen[j], variances[j], i)
        x, P = self._back(x, P) if self._back else (x, P)
        x, P = x[:n], P[:n, :n]
        if known.any():  # a state known exactly stays known: rounding could make its variance slightly negative
            P = np.where(known[:, None] | known, 0.0, P)
        return x, P, innovations

    def _with_noise(self, x, P):
        """Return [x; 0] and the covariance of [x; v]: the noise v is white, hence new in each epoch."""
        (n, c, W), m = x.shape, len(self._noise)
        both = np.zeros((n + m, n + m, W))
        both[:n, :n], both[n:, n:] = P, self._noise
        return np.concatenate([x, np.zeros((m, c, W))]), both


def _coordinates(F, Q, H, variances, P0):
    """Return the changes of coordinates that turn each measurement in sequence into a component of the state.

    Each is (LinearMap or None, row of H, component); None stands for the identity. Also returns the LinearMap from the
    last coordinates back to the state.

    In exact arithmetic every choice of components gives the same estimates. In double precision, each measurement
    replaces the component that contributes most to it: a minor one would be recovered as a small difference of large
    numbers. Rough standard deviations suffice for this: those after n steps of the model, when the process noise has
    reached every state it can reach.
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
            # The new coordinate is h x. Its sigma is at most the sum of the contributions before the measurement, and
            # at most the noise's sigma after it.
            sigma[i] = min(np.sqrt(variances[j]), np.abs(weights) @ sigma)
            T = change @ T
            changes.append((_unless_identity(change), j, i))
    return changes, _unless_identity(np.linalg.inv(T))


def _unless_identity(T):
    return None if np.array_equal(T, np.eye(len(T))) else LinearMap(T)


class LinearMap:
    """x -> T x and P -> T P Tᵀ, with one matrix T (m, n) for all columns."""

    def __init__(self, T: np.ndarray):
        self.matrix = T
        # One product gives T P Tᵀ for all columns: vec(T P Tᵀ) = (T ⊗ T) vec(P). The rows for (a, b) and (b, a) are
        # made equal, so that the result is symmetric to the last bit.
        m, n = T.shape
        kron = np.kron(T, T).reshape(m, m, n * n)
        self._of_vec = ((kron + kron.swapaxes(0, 1)) / 2).reshape(m * m, n * n)

    def __call__(self, x: np.ndarray, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return T x and T P Tᵀ."""
        return self.map_state(x), self.map_covariance(P)

    def map_state(self, x: np.ndarray) -> np.ndarray:
        """Return T x for states x (n, ...), or T P for matrices P (n, n, ...)."""
        return (self.matrix @ x.reshape(len(x), -1)).reshape(-1, *x.shape[1:])

    def map_covariance(self, P: np.ndarray) -> np.ndarray:
        """Return T P Tᵀ for symmetric P (n, n, ...)."""
        m = len(self.matrix)
        return (self._of_vec @ P.reshape(len(P) ** 2, -1)).reshape(m, m, *P.shape[2:])


class Motion(LinearMap):
    """The prediction x -> F x, P -> F P Fᵀ + Q, with one F and Q (n, n) for all columns."""

    def __init__(self, F: np.ndarray, Q: np.ndarray):
        super().__init__(F)
        self.Q = Q

    def map_covariance(self, P: np.ndarray) -> np.ndarray:
        """Return F P Fᵀ + Q."""
        predicted = super().map_covariance(P)
        predicted += self.noise_like(P)
        return predicted

    def noise_like(self, P: np.ndarray) -> np.ndarray:
        """Return Q, with as many axes as P."""
        return self.Q.reshape(*self.Q.shape, *[1] * (P.ndim - self.Q.ndim))


class Motions(Motion):
    """The prediction with an F and a Q of each column, (n, n, ...)."""

    def __init__(self, F: np.ndarray, Q: np.ndarray):
        self.matrix, self.Q = F, Q

    def map_state(self, x: np.ndarray) -> np.ndarray:
        """Return F x for states x (n, ...), or F P for matrices P (n, n, ...)."""
        return product(self.matrix, x)

    def map_covariance(self, P: np.ndarray) -> np.ndarray:
        """Return F P Fᵀ + Q for symmetric P (n, n, ...)."""
        P = product(self.matrix, transposed(product(self.matrix, P)))
        return (P + transposed(P)) / 2 + self.Q


def product(A, B):
    """Return the products A B (a, ...) of matrices A (a, b, M) and vectors B (b, M), or matrices B (b, c, M)."""
    return np.einsum("ij...,j...->i...", A, B)


def block_diagonal(parts):
    """Return matrices (n_i, n_i, ...), whose further axes broadcast, as one block diagonal matrix (n, n, ...)."""
    parts = list(parts)
    n = sum(len(part) for part in parts)
    whole, start = np.zeros((n, n, *np.broadcast_shapes(*(part.shape[2:] for part in parts)))), 0
    for part in parts:
        here = slice(start, start + len(part))
        whole[here, here] = part
        start = here.stop
    return whole


def transposed(A):
    """Return the transposed matrices of A (a, b, ...)."""
    return A.swapaxes(0, 1)


def whitened(values, C):
    """Return values (d, ...) at unit covariance, and log det C (...), from their covariances C (d, d, ...).

    A NaN is a missing value: it becomes zero and does not contribute to the determinant. Each component in turn is
    decorrelated from the preceding ones. Where C is not positive definite the results are not finite.

    >>> whitened(np.array([3.0, np.nan]), np.array([[4.0, 1.0], [1.0, 1.0]]))
    (array([1.5, 0. ]), array(1.38629436))
    """
    values, C = values.copy(), np.broadcast_to(C, (*C.shape[:2], *values.shape[1:])).copy()
    log_det = np.zeros(values.shape[1:])
    for j in range(len(values)):
        seen = ~np.isnan(values[j])
        pivot = np.where(seen, np.where(C[j, j] > 0, C[j, j], np.nan), 1.0)
        value = np.where(seen, values[j], 0.0)
        share = C[j + 1 :, j] * (seen / pivot)
        values[j + 1 :] -= share * value
        C[j + 1 :, j + 1 :] -= share[:, None] * C[j, j + 1 :]
        values[j] = value / np.sqrt(pivot)
        log_det += np.log(pivot)
    return values, log_det
