"""The Kalman filter and the Lainiotis filter, and what all recursive filters share.

Each filter computes x(k+1/k+1) = A_k x(k/k) + B_k z(k+1). The filters differ in `next_step`, which computes A_k, B_k
and P(k+1/k+1) from P(k/k) with the papers' equations. For speed, KalmanFilter repeats these equations for a single
measurement (`step`) and for a stack of tracks (`_next_steps`). Where tracks have different gaps, `columns` takes one
measurement after the other instead, unless R is correlated and a row is partly missing.

A_k, B_k and P depend on which measurements are missing, not on their values. In the Kalman and the Lainiotis filter, a
missing measurement has a row of zeros in H, and in R a one on the diagonal and zeros elsewhere in its row and column:
then every equation holds as printed, also when all measurements of an epoch are missing.
"""

import copy
from dataclasses import dataclass
from functools import cached_property

import filterpy.kalman
import numpy as np

from . import checks, columns
from .model import Immutable, LinearModel, predicted_covariance
from .recursion import TILE_OF_COVARIANCES, Step, lifted, run, tiles
from .riccati import corrected_covariance, innovation_weights, lainiotis_matrices, lainiotis_transition

# A filter keeps the products of its steps for its next call if it has no more steps than this, or converges within
# them. On the models of 2014 to 2016 it converges within some 50.
MOST_KEPT = 256
# A filter of n states has converged when no P_ij moves by more than this times n σ_i σ_j, the rounding of doubles.
CONVERGED = 2e-16


class Filter(Immutable):
    """A filter of measurements z of its `model`.

    A subclass defines `_fill(x, z)`, and `P0` and `epochs(z)` where its estimates have covariances.
    """

    steps_ahead = 0  # how far an estimate lies past its last measurement: 0, or N in a predictor

    @property
    def P0(self):
        """P(0/0); raises TypeError for a filter that has none, a predictor or a FIR filter."""
        raise self._not_recursive()

    def epochs(self, z):
        """Yield x(k/k) (n, M) and P(k/k), (n, n, 1) or (n, n, M), for k = 1 ... N of tracks z (N, m, M).

        P is (n, n, 1) where all tracks have the same gaps. Raises TypeError for a filter that has no covariances.
        """
        raise self._not_recursive()

    def step(self, x, P, z_k):
        """Return x(k+1/k+1) and P(k+1/k+1); raises TypeError for a filter that has no step."""
        raise self._not_recursive()

    def filter(self, z):
        """Return the estimates x(1/1) ... x(N/N): (N, n) for z of shape (N, m), (N, n, M) for z of shape (N, m, M).

        z[0] is z(1), NaN where a measurement is missing. Raises ValueError or TypeError for another shape, another kind
        of data, or infinite values.
        """
        z, many = self._as_tracks(z)
        x = np.empty((len(z), self.model.n, z.shape[2]))
        with np.errstate(invalid="ignore"):  # NaN times zero
            self._fill(x, z)
        if not np.isfinite(x[-1]).all():  # an infinite measurement shows to the end, so z is searched only now
            checks.no_infinity(z)
        return x if many else x[..., 0]

    def covariances(self, z):
        """Return P(1/1) ... P(N/N) for the gaps that z has: (N, n, n) for z (N, m), (N, n, n, M) for z (N, m, M).

        With an integer N for z, nothing is missing. Raises as `filter`, and TypeError for a filter that has none.
        """
        if np.ndim(z) == 0:
            z = np.zeros((checks.count("N", z), self.model.m))
        z, many = self._as_tracks(z)
        checks.no_infinity(z)
        (N, _, M), n = z.shape, self.model.n
        P = np.empty((N, n, n, M))
        for tracks in tiles(M, TILE_OF_COVARIANCES):
            for k, (_, P_k) in enumerate(self.epochs(z[..., tracks])):
                P[k, ..., tracks] = P_k
        return P if many else P[..., 0]

    def _fill(self, x, z):
        """Write the estimates of z (N, m, M) to x (N, n, M)."""
        raise NotImplementedError

    def _as_tracks(self, z):
        """Return checked measurements as (N, m, M), and whether they came with an axis of tracks."""
        z = checks.measurements(z, self.model.m)
        return (z, True) if z.ndim == 3 else (z[..., None], False)

    def _not_recursive(self):
        return TypeError(f"needs a filter with P0, epochs and step, got a {type(self).__name__}")


@dataclass(frozen=True, eq=False)
class RecursiveFilter(Filter):
    """A filter with coefficients and a covariance.

    A subclass defines `next_step(P, seen)`: the Step from P(k/k) to epoch k+1, where seen (m,) says which measurements
    are there; and either `_next_steps(P, seen)`, the same for a stack P (M, n, n), or an `_epochs_of_different_gaps` of
    its own.
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
        return Step(*map(np.array, zip(*steps, strict=True)))

    def step(self, x, P, z_k):
        """Return x(k+1/k+1) and P(k+1/k+1) from x(k/k) (n,), P(k/k) (n, n) and one measurement z(k+1) (m,).

        NaN stands for a missing measurement. The start is `model.x0` and `P0`. Only z_k is checked.
        """
        z_k, seen = one_measurement(z_k, self.model.m)
        A, B, P = self.next_step(P, seen)
        x = A @ x + B @ np.where(seen, z_k, 0)
        return x, P

    def epochs(self, z):
        """Yield x(k/k) and P(k/k) as in Filter. The arrays are not to be written to."""
        seen = ~np.isnan(z)
        if not _all_alike(seen):
            yield from self._epochs_of_different_gaps(z, seen)
            return
        x = self.model.x0[:, None]
        for step, z_k in zip(self._steps(seen[..., 0]), np.where(seen, z, 0), strict=True):
            x = step.A @ x + step.B @ z_k
            yield x, step.P[..., None]

    def _fill(self, x, z):
        """Filter all tracks as if nothing were missing; then those that end in NaN again, with their gaps."""
        run(self._products(len(z), z.shape[2]), self.model.x0[:, None], z, x)
        gaps = np.isnan(x[-1]).any(axis=0)
        if gaps.all():
            self._fill_with_gaps(x, z)
        elif gaps.any():
            tracks = np.flatnonzero(gaps)
            part = x[..., tracks]
            self._fill_with_gaps(part, z[..., tracks])
            x[..., tracks] = part

    def _fill_with_gaps(self, x, z):
        """Write the estimates of z to x: several steps in one product if all tracks have the same gaps."""
        checks.no_infinity(z)
        seen = ~np.isnan(z)
        if _all_alike(seen):
            products = lifted(list(self._steps(seen[..., 0])), z.shape[2])
            run(products, self.model.x0[:, None], np.where(seen, z, 0), x)
            return
        for tracks in tiles(z.shape[2], TILE_OF_COVARIANCES):
            for k, (x_k, _) in enumerate(self.epochs(z[..., tracks])):
                x[k, :, tracks] = x_k

    def _products(self, N, tracks):
        """Return `lifted` of N steps without gaps. They are kept for the next call, often one for the same numbers."""
        kept_for, products = vars(self).get("_kept_products", (None, None))
        if kept_for != (N, tracks):
            steps = list(self._steps(np.ones((N, self.model.m), bool)))
            products = lifted(steps, tracks)
            if N <= MOST_KEPT or steps[-1] is steps[MOST_KEPT - 1]:  # a filter that has converged repeats one Step
                vars(self)["_kept_products"] = (N, tracks), products
        return products

    def _steps(self, seen):
        """Yield the Steps of the epochs of seen (N, m). A filter that has converged repeats one object."""
        as_before = [False, *(seen[1:] == seen[:-1]).all(axis=1)]
        P, converged = self.P0, False
        for seen_k, same in zip(seen, as_before, strict=True):
            if not (converged and same):
                step = Step(*self.next_step(P, seen_k))
                for array in step:
                    array.flags.writeable = False
                converged = _has_not_moved(P, step.P)
                P = step.P
            yield step

    def _epochs_of_different_gaps(self, z, seen):
        """Yield what `epochs` yields; in each epoch, tracks that see the same measurements take their step together."""
        x = np.repeat(self.model.x0[None], z.shape[2], axis=0)  # tracks come first here: a stack of vectors
        P = np.repeat(self.P0[None], z.shape[2], axis=0)
        for z_k, seen_k in zip(np.where(seen, z, 0), seen, strict=True):
            x, P = x.copy(), P.copy()
            for pattern in np.unique(seen_k, axis=1).T:
                tracks = np.flatnonzero((pattern == seen_k.T).all(axis=1))
                A, B, after = self._next_steps(P[tracks], pattern)
                P[tracks] = after
                x[tracks] = (A @ x[tracks, :, None] + B @ z_k.T[tracks, :, None])[..., 0]
            yield x.T, P.transpose(1, 2, 0)


def _all_alike(seen):
    """Tell whether all tracks of seen (N, m, M) have the same gaps."""
    return bool((seen == seen[..., :1]).all())


def _has_not_moved(before, after):
    sigma = np.sqrt(np.abs(np.diag(after)))
    return bool((np.abs(after - before) <= len(sigma) * CONVERGED * np.outer(sigma, sigma)).all())


def one_measurement(z_k, m):
    """Return z_k as a vector of floats of length m, and which of them are there, or raise."""
    need = f"a vector of length {m}"
    z_k = checks.real_numbers("z_k", z_k, need).astype(float)
    if z_k.shape != (m,):
        checks.refuse("z_k", need, f"shape {z_k.shape}")
    seen = np.isfinite(z_k)
    if not seen.all():
        checks.no_infinity(z_k)
    return z_k, seen


def neutralised(model, seen):
    """Return H and R with zeros in H, and rows of the identity in R, for the measurements that seen (m,) lacks."""
    H = model.H * seen[:, None]
    R = np.where(np.outer(seen, seen), model.R, np.diag(~seen))
    return H, R


class KalmanFilter(RecursiveFilter):
    """The Kalman filter (2014 Eq. 4, 2015 Eq. 1), with filterpy's gains and covariances except where gaps differ.

        A_k = (I - K_k H) F,   B_k = K_k

    Where H P Hᵀ + R rounds away a precise sensor, filterpy's gain loses it: see docs/accuracy.md.

    >>> from mpt_helpers.model import gsm_axis
    >>> KalmanFilter(gsm_axis(dt=1.0, q=0.01, r=0.1)).filter([[1.0], [2.0]]).round(4)
    array([[0.0612, 0.1224],
           [0.5557, 0.4681]])
    """

    def next_step(self, P, seen):
        """Return A_k, B_k and P(k+1/k+1) from P(k/k) (n, n), with the measurements seen (m,)."""
        kf = copy.copy(self._filterpy)  # predict and update change the object, so each step takes a copy
        kf.P = P
        if not seen.all():
            kf.H, kf.R = neutralised(self.model, seen)
        kf.predict()
        kf.update(np.zeros(self.model.m))  # neither gain nor covariance depends on x or z
        return (np.eye(self.model.n) - kf.K @ kf.H) @ kf.F, kf.K, kf.P

    @cached_property
    def _filterpy(self):
        # filterpy 2.0: a scalar R would be added to all of S, so R is a matrix; x has one dimension, as z has.
        kf = filterpy.kalman.KalmanFilter(dim_x=self.model.n, dim_z=self.model.m)
        kf.x = np.zeros(self.model.n)
        kf.F, kf.Q, kf.H, kf.R = self.model.F, self.model.Q, self.model.H, self.model.R
        return kf

    def step(self, x, P, z_k):
        """Return x(k+1/k+1) and P(k+1/k+1), as in RecursiveFilter: the textbook's equations, Joseph's form for P."""
        z_k, seen = one_measurement(z_k, self.model.m)
        F, H, Q, R = self.model.F, self.model.H, self.model.Q, self.model.R
        # `dot` takes half the time of `@` on matrices as small as these.
        x = F.dot(x)
        P = F.dot(P).dot(F.T) + Q
        if not seen.all():
            if not seen.any():
                return x, P
            z_k = np.where(seen, z_k, 0)
            H, R = neutralised(self.model, seen)
        PHt = P.dot(H.T)
        K = PHt.dot(np.linalg.inv(H.dot(PHt) + R))
        update = np.eye(len(x)) - K.dot(H)
        return x + K.dot(z_k - H.dot(x)), update.dot(P).dot(update.T) + K.dot(R).dot(K.T)

    def _epochs_of_different_gaps(self, z, seen):
        if columns.can_run(self.model, z):
            return columns.kalman_epochs(self.model, z)
        return super()._epochs_of_different_gaps(z, seen)

    def _next_steps(self, P, seen):
        """Return what `next_step` returns, for a stack P (M, n, n), which filterpy does not take."""
        H, R = neutralised(self.model, seen)
        P = predicted_covariance(self.model, P)
        K = P @ innovation_weights(P, H, R)
        A = (np.eye(self.model.n) - K @ H) @ self.model.F
        return A, K, corrected_covariance(P, K, H, R)


class LainiotisFilter(RecursiveFilter):
    """The Lainiotis filter (2014 Eqs. 5-7, 2015 Eqs. 2-3).

        A_k = F_n [I + P(k/k) O_n]⁻¹,   B_k = K_n + A_k P(k/k) K_m,   P(k+1/k+1) = P_n + A_k P(k/k) F_nᵀ

    Tracks with different gaps take many times as long as with the Kalman filter. Where P0 is 10⁷ R or more, the
    estimates lose digits that the Kalman filter keeps: see docs/accuracy.md.

    >>> from mpt_helpers.model import gsm_axis
    >>> LainiotisFilter(gsm_axis(dt=1.0, q=0.01, r=0.1)).filter([[1.0], [2.0]]).round(4)
    array([[0.0612, 0.1224],
           [0.5557, 0.4681]])
    """

    def next_step(self, P, seen):
        """Return A_k, B_k and P(k+1/k+1) from P(k/k), (n, n) or (M, n, n), with the measurements seen (m,)."""
        Fn, Kn, Km, Pn, On = self._matrices
        if not seen.all():
            Fn, Kn, Km, Pn, On = lainiotis_matrices(self.model, *neutralised(self.model, seen))
        A = lainiotis_transition(P, Fn, On)
        B = Kn + A @ P @ Km
        P = Pn + A @ P @ Fn.T
        return A, B, (P + P.swapaxes(-1, -2)) / 2

    _next_steps = next_step  # it takes stacks of matrices as it takes one

    @cached_property
    def _matrices(self):
        return lainiotis_matrices(self.model)
