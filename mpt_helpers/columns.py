"""The Kalman filter on columns: many tracks at a time, each with conditions of its own.

The conditions of an epoch are which measurements are there, how long the step before it was, and how precise they are.
Tracks whose conditions differ differ in their covariances too, so each track is a column: P is (n, n, M). Where all
tracks share their conditions they share one column of P. x is (n, c, M), where c is the number of tracks in a column.

Three ideas keep the filter free of branches and of loops over tracks:

- A missing measurement gets a gain of zero, and leaves P alone.
- A linear map x -> T x takes P to T P Tᵀ, which is linear in P: one matrix product serves all columns.
- Measurements are taken one after the other, each in coordinates where it is one component of the state: for H = [1 dt]
  the state [s v] may become [s + v dt, v]. There the update needs no matrix inverse, and the row of P that belongs to
  the measured component can be written without a difference of large numbers.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


class Row(NamedTuple):
    """One epoch of all tracks, in the shapes of `Rows` without the first axis."""

    z: np.ndarray
    seen: np.ndarray
    lengths: np.ndarray | None
    variances: np.ndarray | None


@dataclass(frozen=True)
class Rows:
    """The measurements and the conditions of N epochs of c tracks in each of M columns.

    z (N, m, c, M) is zero where a measurement is missing, and seen (N, m, M) tells which are there. lengths (N, M) are
    those of the steps before each epoch, in units of the model's dt, or None where all are one. variances
    (N, m, M) are those of the measurements, or None where they are the model's.
    """

    z: np.ndarray
    seen: np.ndarray
    lengths: np.ndarray | None = None
    variances: np.ndarray | None = None

    def __iter__(self):
        """Yield one Row after the other."""
        for k in range(len(self.z)):
            yield Row(self.z[k], self.seen[k], *(None if a is None else a[k] for a in (self.lengths, self.variances)))

    def mapped(self, function):
        """Return the Rows of function(array) for each array."""
        arrays = (self.z, self.seen, self.lengths, self.variances)
        return Rows(*(None if array is None else function(array) for array in arrays))

    def with_tracks_of_zeros(self, count):
        """Return the Rows with `count` more tracks in each column, all of whose measurements are zero."""
        N, m, _, M = self.z.shape
        z = np.concatenate([self.z, np.zeros((N, m, count, M))], axis=2)
        return Rows(z, self.seen, self.lengths, self.variances)


class Motion:
    """x <- F x and P <- F P Fᵀ + Q on columns, over steps of one length or of a length of each column's own.

    powers (n,) says how F and Q follow the length s of a step, in units of the one for which they are given:
    F_ij s^(e_i - e_j) and Q_ij s^(e_i + e_j). None: there are no steps but of that length.
    """

    def __init__(self, F, Q, powers=None):
        self.F, self.Q = F, Q
        n = len(F)
        self._product = product_for_covariances(F)
        if powers is not None:
            pairs = [(i, j) for i in range(n) for j in range(n)]
            # State i moves by states j of lower powers. The highest moves first, by the others as they were.
            pairs.sort(key=lambda pair: -powers[pair[0]])
            self._terms = [(i, j, F[i, j], round(powers[i] - powers[j])) for i, j in pairs if i != j and F[i, j]]
            self._noises = [(i, j, Q[i, j], round(powers[i] + powers[j])) for i, j in pairs if i <= j and Q[i, j]]
            self._highest = max((power for *_, power in self._terms + self._noises), default=0)
            self._diagonal = None if (np.diag(F) == 1).all() else np.diag(F)

    def both(self, x, P, lengths=None):
        """Return F x (n, c, M) and F P Fᵀ + Q (n, n, M). The lengths of the steps (M,) are all one where None."""
        if lengths is None:
            return self.state(x), self.covariance(P)
        s = self._powers_of(lengths)
        return self._moved(x, s), self._moved_covariance(P, s)

    def state(self, x, lengths=None):
        """Return F x for x (n, ...)."""
        if lengths is None:
            return (self.F @ x.reshape(len(x), -1)).reshape(x.shape)
        return self._moved(x, self._powers_of(lengths))

    def covariance(self, P, lengths=None):
        """Return F P Fᵀ + Q for P (n, n, ...)."""
        if lengths is None:
            n = len(P)
            noise = self.Q.reshape(n, n, *[1] * (P.ndim - 2))
            return (self._product @ P.reshape(n * n, -1)).reshape(P.shape) + noise
        return self._moved_covariance(P, self._powers_of(lengths))

    def _powers_of(self, lengths):
        """Return [1, s, s², ...] for the lengths of the steps. A step of length zero leaves the state where it is."""
        powers = [1.0, lengths]
        for _ in range(self._highest - 1):
            powers.append(powers[-1] * lengths)
        return powers

    def _moved(self, x, s):
        moved = x.copy() if self._diagonal is None else x * self._diagonal.reshape(-1, *[1] * (x.ndim - 1))
        for i, j, f, power in self._terms:
            moved[i] += f * s[power] * moved[j]
        return moved

    def _moved_covariance(self, P, s):
        P = self._moved(P, s)
        if self._diagonal is not None:
            P *= self._diagonal.reshape(-1, *[1] * (P.ndim - 2))
        for i, j, f, power in self._terms:
            P[:, i] += f * s[power] * P[:, j]
        for i, j, q, power in self._noises:
            P[i, j] += q * s[power]
        for i in range(len(P)):
            P[i, :i] = P[:i, i]  # the same sums in another order: P stays symmetric to the last bit
        return P


def product_for_covariances(T):
    """Return W (m², n²) with vec(T P Tᵀ) = W vec(P) for T (m, n) and a symmetric P."""
    m, n = T.shape
    W = np.kron(T, T).reshape(m, m, n * n)
    # Equal rows for (a, b) and (b, a), so that T P Tᵀ is symmetric to the last bit.
    return ((W + W.swapaxes(0, 1)) / 2).reshape(m * m, n * n)


def corrected(x, P, z, seen, variance, i):
    """Return x (n, c, M) and P (n, n, M) after measurements z (c, M) of component i of the state, and more.

    seen (M,) tells where there is one, and its variance is a number or (M,). It is the textbook's update with eᵢᵀ for
    H. With row i of P as p, the variance as v and S = pᵢ + v, the new row and column i are p - pᵢ p / S = p v / S: that
    takes no difference of large numbers. P is overwritten, so it must be the caller's own.

    The third result is the innovation (z - xᵢ) / √S (c, M) at unit variance, zero where nothing was measured.
    """
    p_i = P[i].copy()
    S = p_i[i] + variance
    weight = seen / S
    gain = p_i * weight
    P -= gain[:, None] * p_i
    P[i] = P[:, i] = p_i * np.where(seen, variance / S, 1.0)
    innovation = z - x[i]
    with np.errstate(invalid="ignore"):  # where rounding took S below zero: a NaN, and the track is not cut
        root = np.sqrt(seen * weight)
    return x + gain[:, None] * innovation, P, innovation * root


class KalmanColumns:
    """The Kalman filter on columns, for measurements of uncorrelated noises.

    F, Q, powers are those of `Motion`, H is (m, n), and variances (m,) are those of the noises where rows have none of
    their own. P0 (n, n), the covariance of the start, decides in which coordinates the measurements are taken.
    """

    def __init__(self, F, H, Q, variances, P0, powers=None):
        self.motion = Motion(F, Q, powers)
        self._variances = variances[:, None]
        self._changes, T = _coordinates(F, H, Q, variances, P0)
        self._back = LinearMap(np.linalg.inv(T))

    def advance(self, row, x, P):
        """Return x(k+1/k+1), P(k+1/k+1) and the innovations at unit covariance (m, c, M) from x(k/k) and P(k/k)."""
        x, P = self.motion.both(x, P, row.lengths)
        variances = self._variances if row.variances is None else row.variances
        innovations = np.zeros((len(row.z), *x.shape[1:]))
        for change, j, i in self._changes:
            x, P = change(x, P)
            x, P, innovations[j] = corrected(x, P, row.z[j], row.seen[j], variances[j], i)
        x, P = self._back(x, P)
        return x, P, innovations


class LinearMap:
    """A linear map of columns: x -> T x, P -> T P Tᵀ."""

    def __init__(self, T):
        self._T = None if np.array_equal(T, np.eye(len(T))) else T
        self._product = product_for_covariances(T)

    def __call__(self, x, P):
        """Return T x (n, c, M) and T P Tᵀ (n, n, M)."""
        if self._T is None:
            return x, P
        return (self._T @ x.reshape(len(x), -1)).reshape(x.shape), (self._product @ P.reshape(len(P) ** 2, -1)).reshape(
            P.shape
        )


def _coordinates(F, H, Q, variances, P0):
    """Return the changes of coordinates that make one measurement after the other a component of the state.

    Each is (LinearMap, index of the row of H, component). Also returns T (n, n), which takes the state to the last
    coordinates.
    """
    # sigma: the predicted standard deviation of each coordinate. A measurement replaces the coordinate that contributes
    # most to it: one that contributes little would come back as a small difference of large numbers.
    n, P = len(F), P0
    for _ in range(n):
        P = F @ P @ F.T + Q
    sigma = np.sqrt(np.maximum(np.diag(P), np.finfo(float).tiny))
    changes, T = [], np.eye(n)
    for j, h in enumerate(H):
        if h.any():  # a row of zeros tells nothing
            change = np.eye(n)
            weights = h @ np.linalg.inv(T)  # h x in the present coordinates
            i = int(np.argmax(np.abs(weights) * sigma))
            change[i] = weights
            sigma[i] = min(np.sqrt(variances[j]), np.abs(weights) @ sigma)  # once it is measured
            T = change @ T
            changes.append((LinearMap(change), j, i))
    return changes, T


class ConstantGainColumns:
    """A filter of constant gain B (n, m) on columns. Each row is complete or missed: then it is predicted only.

    P is the covariance of the true error if that of x0 is P0.
    """

    def __init__(self, F, H, Q, R, B):
        self.motion = Motion(F, Q)
        self._B = B
        self._keep = LinearMap(np.eye(len(F)) - B @ H)
        self._noise = (B @ R @ B.T)[..., None]

    def advance(self, row, x, P):
        """Return x(k+1/k+1) and P(k+1/k+1), and no innovations: the gain being constant, none corrects the start."""
        x, P = self.motion.both(x, P)
        seen = row.seen[0]
        x_seen, P_seen = self._keep(x, P)
        measured = (self._B @ row.z.reshape(len(row.z), -1)).reshape(x.shape)
        return (
            np.where(seen, x_seen + measured, x),
            np.where(seen, P_seen + self._noise, P),
            np.zeros((0, *x.shape[1:])),
        )


def whitened(values, C):
    """Return values (d, ...) at unit covariance, and log det C (...), from their covariances C (d, d, ...).

    Of a value that is NaN nothing is known: it becomes zero, and adds nothing to the determinant. One component is
    taken after the other, each freed of what those before it say of it. Where C is not positive definite, a pivot is
    not positive, and the results are not finite.
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


def product(A, B):
    """Return the products A B (a, c, ...) of the matrices in the columns of A (a, b, ...) and B (b, c, ...)."""
    return np.einsum("ij...,jk...->ik...", A, B)


def transposed(A):
    """Return the transposed matrices of A (a, b, ...)."""
    return A.swapaxes(0, 1)


def solved(S, X):
    """Return S⁻¹ X (n, c, ...) for covariances S (n, n, ...), which may be singular, and X (n, c, ...).

    A direction without variance, known exactly, gets zeros: no multiple of it says anything. Its pivot is the rounding
    of zero.
    """
    n = len(S)
    S, X = S.copy(), X.copy()
    least = n * np.finfo(float).eps * np.einsum("jj...->j...", S)
    weights = np.zeros_like(least)
    for j in range(n):
        there = S[j, j] > least[j]
        weights[j] = there / np.where(there, S[j, j], 1.0)
        share = (S[j + 1 :, j] * weights[j])[:, None]
        S[j + 1 :, j + 1 :] -= share * S[j, j + 1 :]
        X[j + 1 :] -= share * X[j]
    for j in reversed(range(n)):
        X[j] = weights[j] * (X[j] - np.einsum("i...,ic...->c...", S[j, j + 1 :], X[j + 1 :]))
    return X
