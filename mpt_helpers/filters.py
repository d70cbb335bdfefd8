"""The Kalman filter and the Lainiotis filter, one step as the papers print it, and what all recursive filters share.

Each filter is x(k+1/k+1) = A_k x(k/k) + B_k z(k+1), and no A_k, B_k depends on the values measured, only on which
measurements are there: the filters differ in how `gains` makes the coefficients. A missing measurement has a zero row
in H and a one in R; then every equation holds as printed, also when all measurements of an epoch are missing.
"""

from dataclasses import dataclass
from functools import cached_property

import filterpy.kalman
import numpy as np

from . import checks, columns
from .model import Immutable, LinearModel
from .recursion import TILE_OF_COVARIANCES, Coefficients, run, tiles
from .riccati import lainiotis_matrices, lainiotis_transition

# The steps without gaps that a filter keeps once it has made them. The papers' filters are at rest after some 45.
KEPT = 256
# P is at rest when no entry moves by more than the rounding of its standard deviations.
AT_REST = 4e-16


class Filter(Immutable):
    """What all filters share: a `model`, and measurements that are checked and brought into columns.

    A subclass defines `_estimates(z)`: x (N, n, M) for measurements z (N, m, M) with NaN where they are missing.
    """

    def filter(self, z):
        """Return the estimates x(1/1) ... x(N/N): (N, n) for z of shape (N, m), (N, n, M) for z of shape (N, m, M).

        z[0] is z(1), NaN where a measurement is missing. Raises ValueError or TypeError for another shape, another kind
        of data, or infinite values.
        """
        z, tracks = self._columns(z)
        with np.errstate(invalid="ignore"):  # NaN times zero
            x = self._estimates(z)
        if not np.isfinite(x[-1]).all():
            checks.no_infinity(z)
        return x if tracks else x[..., 0]

    def _columns(self, z):
        """Return checked measurements as (N, m, M), and whether they came as many tracks."""
        z = checks.measurements(z, self.model.m)
        return (z, True) if z.ndim == 3 else (z[..., None], False)


@dataclass(frozen=True, eq=False)
class RecursiveFilter(Filter):
    """A filter with coefficients and a covariance of its own.

    A subclass defines `gains(P, seen)`: A_k, B_k and P(k+1/k+1) from P(k/k), where seen (m,) says which measurements
    are there. P may be a stack (M, n, n).
    """

    model: LinearModel

    def __post_init__(self):
        checks.instance("model", self.model, LinearModel)

    @property
    def P0(self):
        """P(0/0), the covariance that the filter starts from: the model's."""
        return self.model.P0

    def coefficients(self, N):
        """Return A (N, n, n), B (N, n, m) and the covariance P (N, n, n) of steps 1 to N with nothing missing."""
        steps = self._steps(np.ones((checks.count("N", N), self.model.m), bool))
        return Coefficients(*map(np.array, zip(*steps, strict=True)))

    def covariances(self, z):
        """Return P(1/1) ... P(N/N) with the gaps that the measurements z have.

        The result is (N, n, n) for z of shape (N, m), and (N, n, n, M) for z of shape (N, m, M). For an integer N
        instead of z it is (N, n, n), with nothing missing. Raises as `filter` does.
        """
        if np.ndim(z) == 0:
            return self.coefficients(z).P
        z, tracks = self._columns(z)
        checks.no_infinity(z)
        N, _, M = z.shape
        seen = ~np.isnan(z)
        if _alike(seen):
            P = np.array([step.P for step in self._steps(seen[..., 0])])[..., None]
            return np.broadcast_to(P, (*P.shape[:3], M)) if tracks else P[..., 0]
        P = np.empty((N, self.model.n, self.model.n, M))
        for tile in tiles(M, TILE_OF_COVARIANCES):
            for k, (_, P_k) in enumerate(self.epochs(z[..., tile])):
                P[k, ..., tile] = P_k
        return P

    def step(self, x, P, z_k):
        """Return x(k+1/k+1) and P(k+1/k+1) from x(k/k) (n,), P(k/k) (n, n) and one measurement z(k+1) (m,).

        NaN stands for a missing measurement. Start from `model.x0` and `P0`.
        """
        z_k = _one_measurement(z_k, self.model.m)
        seen = ~np.isnan(z_k)
        A, B, P = self.gains(P, seen)
        x = A @ x + B @ np.where(seen, z_k, 0)
        return x, P

    def epochs(self, z):
        """Yield x(k/k) (n, M) and P(k/k), (n, n, 1) or (n, n, M), for k = 1 ... N of tracks z (N, m, M).

        P has one column where all tracks miss the same measurements. The arrays may be written over by the next epoch.
        """
        seen = ~np.isnan(z)
        if not _alike(seen):
            yield from self._epochs_of_own_gaps(z, seen)
            return
        x = self.model.x0[:, None]
        for step, z_k in zip(self._steps(seen[..., 0]), np.where(seen, z, 0), strict=True):
            x = step.A @ x + step.B @ z_k
            yield x, step.P[..., None]

    def _estimates(self, z):
        seen = _usual(z)
        x0 = np.broadcast_to(self.model.x0[:, None], (self.model.n, z.shape[2]))
        x = run(self._steps(seen), seen, x0, z)
        others = np.flatnonzero(_unlike(x, z, seen))
        for tile in tiles(len(others), TILE_OF_COVARIANCES) if len(others) else []:
            tracks = others[tile]
            for k, (x_k, _) in enumerate(self.epochs(z[..., tracks])):
                x[k][:, tracks] = x_k
        return x

    def _epochs_of_own_gaps(self, z, seen):
        """Yield what `epochs` does: in each epoch, the tracks that see the same measurements together."""
        x = np.repeat(self.model.x0[None], z.shape[2], axis=0)
        P = np.repeat(self.P0[None], z.shape[2], axis=0)
        for z_k, seen_k in zip(np.where(seen, z, 0), seen, strict=True):
            for pattern in np.unique(seen_k, axis=1).T:
                tracks = np.flatnonzero((pattern == seen_k.T).all(axis=1))
                A, B, P[tracks] = self.gains(P[tracks], pattern)
                x[tracks] = (A @ x[tracks, :, None] + B @ z_k.T[tracks, :, None])[..., 0]
            yield x.T, P.transpose(1, 2, 0)

    @cached_property
    def _kept_steps(self):
        with np.errstate(all="ignore"):  # a covariance may overflow in steps that nobody asks for
            return self._more_steps([], np.ones((KEPT, self.model.m), bool))

    def _steps(self, seen):
        """Return a list of the Coefficients of each epoch of seen (N, m). Where they repeat, the object repeats."""
        gaps = np.flatnonzero(~seen.all(axis=1))
        before_gaps = gaps[0] if len(gaps) else len(seen)
        return self._more_steps(self._kept_steps[:before_gaps], seen)

    def _more_steps(self, steps, seen):
        """Return these first steps, followed by the steps of the remaining epochs of seen (N, m)."""
        repeats = np.append(False, (seen[1:] == seen[:-1]).all(axis=1)).tolist()
        steps = list(steps)
        at_rest = len(steps) > 1 and steps[-1] is steps[-2]
        for k in range(len(steps), len(seen)):
            if at_rest and repeats[k]:
                steps.append(steps[-1])
                continue
            P = steps[-1].P if steps else self.P0
            steps.append(Coefficients(*self.gains(P, seen[k])))
            at_rest = _has_not_moved(P, steps[-1].P)
        return steps


def _alike(seen):
    """Tell whether all tracks of seen (N, m, M) miss the same measurements."""
    return bool((seen == seen[..., :1]).all())


def _usual(z):
    """Return which measurements (N, m) are there in at least one of some ten tracks: what most tracks have."""
    sample = z[..., :: max(1, z.shape[2] // 10)]
    return ~np.isnan(sample).all(axis=2)


def _unlike(x, z, seen):
    """Return which tracks (M,) miss other measurements than seen (N, m) says.

    A missing measurement that was taken for one that is there shows in the last estimate: NaN stays to the end.
    """
    return ~np.isfinite(x[-1]).all(axis=0) | ~np.isnan(z[~seen]).all(axis=0)


def _has_not_moved(before, after):
    sigma = np.sqrt(np.abs(np.diag(after)))
    return bool((np.abs(after - before) <= AT_REST * np.outer(sigma, sigma)).all())


def _one_measurement(z_k, m):
    z_k = np.asarray(z_k, float)
    if z_k.shape != (m,):
        checks.refuse("z_k", f"a vector of length {m}", f"shape {z_k.shape}")
    return z_k


def rows_seen(model, seen):
    """Return H and R with a zero row of H and a one in R for each measurement that is missing."""
    H = model.H * seen[:, None]
    R = np.where(np.outer(seen, seen), model.R, np.diag(~seen))
    return H, R


@dataclass(frozen=True, eq=False)
class KalmanFilter(RecursiveFilter):
    """The Kalman filter (2014 Eq. 4, 2015 Eq. 1): gains and covariances are those of filterpy's KalmanFilter.

        A_k = (I - K_k H) F,   B_k = K_k

    Tracks that each have gaps of their own are filtered together, by equations of `columns` instead of filterpy's.

    >>> from mpt_helpers.model import gsm_axis
    >>> KalmanFilter(gsm_axis(dt=1.0, q=0.01, r=0.1)).filter([[1.0], [2.0]]).round(4)
    array([[0.0612, 0.1224],
           [0.5557, 0.4681]])
    """

    def gains(self, P, seen):
        """Return A_k, B_k and P(k+1/k+1) from P(k/k), with the measurements that are seen (m,)."""
        if P.ndim == 3:
            return tuple(map(np.array, zip(*(self.gains(each, seen) for each in P), strict=True)))
        # A fresh object each time, since its state survives a run, and full matrices: both are traps of filterpy 2.0.
        kf = filterpy.kalman.KalmanFilter(dim_x=self.model.n, dim_z=self.model.m)
        kf.F, kf.Q, kf.P = self.model.F, self.model.Q, P
        kf.H, kf.R = rows_seen(self.model, seen)
        kf.x = np.zeros(self.model.n)  # of one dimension; neither gain nor covariance depends on it
        kf.predict()
        kf.update(np.zeros(self.model.m))
        return (np.eye(self.model.n) - kf.K @ kf.H) @ kf.F, kf.K, kf.P

    def step(self, x, P, z_k):
        """Return x(k+1/k+1) and P(k+1/k+1) from x(k/k) (n,), P(k/k) (n, n) and one measurement z(k+1) (m,).

        NaN stands for a missing measurement. The equations are the textbook's, with P in Joseph's form as in filterpy.
        """
        z_k = _one_measurement(z_k, self.model.m)
        F, H, Q, R = self.model.F, self.model.H, self.model.Q, self.model.R
        seen = z_k == z_k  # false for NaN
        if not seen.all():
            z_k = np.where(seen, z_k, 0)
            H, R = rows_seen(self.model, seen)
        # `dot` takes half the time of `@` on matrices as small as these.
        x = F.dot(x)
        P = F.dot(P).dot(F.T) + Q
        PHt = P.dot(H.T)
        K = PHt.dot(np.linalg.inv(H.dot(PHt) + R))
        update = np.eye(len(x)) - K.dot(H)
        return x + K.dot(z_k - H.dot(x)), update.dot(P).dot(update.T) + K.dot(R).dot(K.T)

    def _epochs_of_own_gaps(self, z, seen):
        if columns.can_run(self.model, z):
            return columns.kalman_epochs(self.model, z)
        return super()._epochs_of_own_gaps(z, seen)


@dataclass(frozen=True, eq=False)
class LainiotisFilter(RecursiveFilter):
    """The Lainiotis filter (2014 Eqs. 5-7, 2015 Eqs. 2-3).

        A_k = F_n [I + P(k/k) O_n]⁻¹,   B_k = K_n + A_k P(k/k) K_m,   P(k+1/k+1) = P_n + A_k P(k/k) F_nᵀ

    Tracks that each have gaps of their own take several times as long as with the Kalman filter.

    >>> from mpt_helpers.model import gsm_axis
    >>> LainiotisFilter(gsm_axis(dt=1.0, q=0.01, r=0.1)).filter([[1.0], [2.0]]).round(4)
    array([[0.0612, 0.1224],
           [0.5557, 0.4681]])
    """

    def gains(self, P, seen):
        """Return A_k, B_k and P(k+1/k+1) from P(k/k), (n, n) or (M, n, n), with the measurements seen (m,)."""
        Fn, Kn, Km, Pn, On = (
            self._matrices if seen.all() else lainiotis_matrices(self.model, *rows_seen(self.model, seen))
        )
        A = lainiotis_transition(P, Fn, On)
        B = Kn + A @ P @ Km
        following = Pn + A @ P @ Fn.T
        return A, B, (following + following.swapaxes(-1, -2)) / 2

    @cached_property
    def _matrices(self):
        return lainiotis_matrices(self.model)
