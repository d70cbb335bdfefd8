"""Filters on columns: many tracks at a time, each with conditions of its own.

Tracks whose conditions differ differ in their covariances too, so each track is a column: x is (n, c, M) and P
(n, n, M), where c is the number of tracks in a column. `epochs` says when that is more than one.

Three ideas keep the Kalman filter free of branches and of loops over tracks:

- A missing measurement gets a gain of zero, and leaves P alone.
- A linear map x -> T x takes P to T P Tᵀ, which is linear in P: one matrix product serves all columns.
- Measurements are taken one after the other, each in coordinates where it is one component of the state: for H = [1 dt]
  the state [s v] may become [s + v dt, v]. There the update needs no matrix inverse, and the row of P that belongs to
  the measured component can be written without a difference of large numbers.

`KalmanColumns` and `ConstantGainColumns` are made so. `SteppedColumns` makes a matrix for each column instead: that is
slower, and does for any filter.

Each class has `advance`, one epoch of its filter, which keeps the promises that `engine` names.
"""

from dataclasses import replace

import numpy as np

from .algebra import LinearMap, whitened


def corrected(x, P, z, seen, variance, i):
    """Return x (n, c, M), P (n, n, M) and the innovations at unit variance, after measurements z (c, M) of component i.

    seen (M,) tells where there is one, and its variance v is a number or (M,). It is the textbook's update with eᵢᵀ for
    H. With row i of P as p and S = pᵢ + v, the gain is p / S, and the new row i is p - pᵢ p / S = p v / S: that last
    form takes no difference of large numbers. P is overwritten, so it must be the caller's own.

    The third result is the innovation (z - xᵢ) / √S (c, M) at unit variance, zero where nothing was measured.
    """
    p = P[i].copy()
    S = p[i] + variance
    one_over_S = seen / S  # zero where nothing was measured: then the gain is zero too
    gain = p * one_over_S
    P -= gain[:, None] * p
    P[i] = P[:, i] = p * np.where(seen, variance / S, 1.0)
    innovation = z - x[i]
    with np.errstate(invalid="ignore"):  # where rounding took S below zero: a NaN, and the track is not cut
        one_over_root = np.sqrt(one_over_S)
    return x + gain[:, None] * innovation, P, innovation * one_over_root


class KalmanColumns:
    """The Kalman filter on columns, for measurements of uncorrelated noises.

    motion is that of the states, H is (m, n), and variances (m,) are those of the noises where rows have none of
    their own. P0 (n, n), the covariance of the start, decides in which coordinates the measurements are taken.
    """

    def __init__(self, motion, H, variances, P0):
        self._motion = motion
        self._variances = variances[:, None]
        self._changes, T = _coordinates(*motion.one_step, H, variances, P0)
        self._back = LinearMap(np.linalg.inv(T))

    def advance(self, row, x, P):
        """Return x(k+1/k+1), P(k+1/k+1) and the innovations at unit covariance (m, c, M) from x(k/k) and P(k/k)."""
        x, P = self._motion.predicted(x, P, row.lengths)
        variances = self._variances if row.variances is None else row.variances
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


def kalman_on_columns(model, rows):
    """Return the `advance` of the Kalman filter of a model, its rows, and where each track starts: x0 (d,), P0 (d, d).

    `KalmanColumns` takes measurements of uncorrelated noises. Where those of the model are correlated, there are two
    ways to make them so, the second of which takes rows that are partly missing, and costs m states more: d = n + m.
    """
    variances = np.diag(model.R)
    if rows.variances is not None or np.array_equal(model.R, np.diag(variances)):
        return KalmanColumns(model.motion, model.H, variances, model.P0).advance, rows, model.x0, model.P0
    whole_or_missed = (rows.seen.all(axis=1) == rows.seen.any(axis=1)).all()
    return (_decorrelated if whole_or_missed else _with_noises_as_states)(model, rows)


def _decorrelated(model, rows):
    """Return what `kalman_on_columns` does, for rows that are whole or missed.

    With R = L diag(variances) Lᵀ, the measurements L⁻¹ z = L⁻¹ H x + L⁻¹ v have uncorrelated noises.
    """
    root = np.linalg.cholesky(model.R)
    L, variances = root / np.diag(root), np.diag(root) ** 2
    H = np.linalg.solve(L, model.H)
    rows = replace(rows, z=np.moveaxis(np.tensordot(np.linalg.inv(L), rows.z, axes=(1, 1)), 0, 1))
    return KalmanColumns(model.motion, H, variances, model.P0).advance, rows, model.x0, model.P0


def _with_noises_as_states(model, rows):
    """Return what `kalman_on_columns` does, for any rows.

    The noises v become states, z = [H I] [x; v], and what is measured has no other noise: variances of zero.

    `corrected` divides by S = pᵢ + 0, which is the variance of H x + v. It is positive: v is new in each row, and R is
    definite, so that no component of v is known from the others.
    """
    n, m = model.n, model.m
    P0 = np.zeros((n + m, n + m))
    P0[:n, :n] = model.P0
    H = np.hstack([model.H, np.eye(m)])
    kalman = KalmanColumns(model.motion.with_noises(model.R), H, np.zeros(m), P0)
    return kalman.advance, rows, np.append(model.x0, np.zeros(m)), P0


class ConstantGainColumns:
    """A filter of constant gain B (n, m) on columns. Each row is complete or missed: then it is predicted only.

    P is the covariance of the true error if that of x0 is P0.
    """

    def __init__(self, model, B):
        self._motion = model.motion
        self._B = B
        self._keep = LinearMap(np.eye(model.n) - B @ model.H)
        self._noise = (B @ model.R @ B.T)[..., None]

    def advance(self, row, x, P):
        """Return x(k+1/k+1) and P(k+1/k+1), and no innovations: the gain being constant, none corrects the start."""
        x, P = self._motion.predicted(x, P)
        seen = row.seen[0]
        x_seen, P_seen = self._keep(x, P)
        measured = (self._B @ row.z.reshape(len(row.z), -1)).reshape(x.shape)
        return (
            np.where(seen, x_seen + measured, x),
            np.where(seen, P_seen + self._noise, P),
            np.zeros((0, *x.shape[1:])),
        )


class SteppedColumns:
    """Any filter on columns, by its `next_steps`: columns that see the same measurements take their step together.

    The innovations are those of the model's step, for a filter whose gain follows its covariance (`optimal`). Others
    return none, so that `partition` cannot correct the starts of its pieces by measurements. Whether they are right
    shows where a piece ends: at the start of the next one, or the track is not cut.

    Lengths and variances of rows are not looked at: only a KalmanFilter takes any, and it has `KalmanColumns`.
    """

    def __init__(self, estimator):
        self._estimator = estimator
        self._motion = estimator.model.motion

    def advance(self, row, x, P):
        """Return x(k+1/k+1) (n, c, M), P(k+1/k+1) (n, n, M) and the innovations at unit covariance (m or 0, c, M)."""
        optimal = self._estimator.optimal
        innovations = self._innovations(row, x, P) if optimal else np.zeros((0, *x.shape[1:]))
        x, P, z = (np.moveaxis(each, 2, 0).copy() for each in (x, P, row.z))  # stacks of matrices
        for seen in np.unique(row.seen, axis=1).T:
            columns = np.flatnonzero((seen == row.seen.T).all(axis=1))
            A, B, P[columns] = self._estimator.next_steps(P[columns], seen)
            x[columns] = A @ x[columns] + B @ z[columns]
        return np.moveaxis(x, 0, 2), np.moveaxis(P, 0, 2), innovations

    def _innovations(self, row, x, P):
        H, R = self._estimator.model.H, self._estimator.model.R
        expected = np.tensordot(H, self._motion.state(x), axes=1)
        P = np.moveaxis(self._motion.covariance(P), 2, 0)
        S = np.moveaxis(H @ P @ H.T + R, 0, 2)[:, :, None]
        return whitened(np.where(row.seen[:, None], row.z - expected, np.nan), S)[0]
