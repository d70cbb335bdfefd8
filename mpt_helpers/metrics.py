"""How far estimates lie from each other and from the truth, and how far they should."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaincinv

from . import checks
from .algebra import whitened
from .bands import ahead as ahead  # what a filter's covariance is worth, under the names that it has had here
from .bands import coverage as coverage
from .bands import following as following
from .bands import interval_score as interval_score
from .checks import Array
from .equations import corrected_covariance, predicted_covariance
from .model import LinearModel
from .recursive import Filter
from .steady import SteadyStateFilter
from .steps import epochs_at_a_time


def relative_gap(a: ArrayLike, b: ArrayLike) -> float:
    """Return the largest difference between two arrays of one shape, relative to the largest entry of b.

    >>> relative_gap([1.0, 2.0], [1.0, 4.0])
    0.5
    """
    a, b = np.asarray(a, float), np.asarray(b, float)
    if a.shape != b.shape:
        checks.refuse("a", f"the shape of b, {b.shape}", a.shape)
    return float(np.abs(a - b).max() / np.abs(b).max())


def rms(values: ArrayLike, axis: int | tuple[int, ...] | None = None) -> Any:
    """Return the root mean square along an axis, or of all values.

    >>> float(rms([3.0, -3.0]))
    3.0
    """
    return np.sqrt(np.mean(np.square(np.asarray(values, float)), axis=axis))


class Innovations(NamedTuple):
    """The innovations z(k) - H x(k/k-1), (N, m) or (N, m, M), and their covariance S, (N, m, m) or (N, m, m, M)."""

    values: Array
    S: Array


def innovations(estimator: Filter, z: ArrayLike) -> Innovations:
    """Return z(k) - H x(k/k-1) and S(k) = H P(k/k-1) Hᵀ + R for k = 1 ... N of a filter over measurements z.

    `estimator` is a recursive filter, z is (N, m) or (N, m, M). `values` has the shape of z, with NaN where z has NaN.
    S is the covariance of a measurement, missing or not: (N, m, m), or (N, m, m, M) for many tracks.

    Raises ValueError or TypeError for measurements of another kind, and TypeError for a filter that has no innovations:
    a predictor or a FIR filter.

    >>> from mpt_helpers.model import constant_velocity
    >>> steady = SteadyStateFilter.from_kalman(constant_velocity(dt=1.0, q=0.01, r=0.1))
    >>> innovations(steady, [[1.0], [2.0]]).values.round(4)
    array([[1.   ],
           [1.239]])
    """
    z, many, values, S = _of(estimator, z)
    if not many:
        return Innovations(values[..., 0], S[..., 0])
    return Innovations(values, S if S.shape[3] == z.shape[2] else np.repeat(S, z.shape[2], axis=3))


def _of(estimator, z):
    """Return z (N, m, M), whether it came with an axis of tracks, its innovations, and S (N, m, m, M or 1)."""
    checks.instance("estimator", estimator, Filter)
    z, many = estimator.as_tracks(z)
    checks.no_infinity(z)
    values, S = estimator.innovations_of(z)
    if not np.isfinite(np.where(np.isnan(z), 0, values)).all() or not np.isfinite(S).all():
        checks.refuse("estimator", "states and covariances that doubles can hold over these epochs", "an overflow")
    return z, many, values, S


def _squares(values, C):
    """Return the sums of squares of values (N, d, M) at unit covariance, (N, M), and log det C (N, M).

    C is (N, d, d, M or 1). A value that is NaN adds nothing to either.
    """
    N, d, M = values.shape
    squares, log_det = np.empty((N, M)), np.empty((N, M))
    for part in epochs_at_a_time(N, d * d * M):
        unit, log_det[part] = whitened(np.moveaxis(values[part], 1, 0), np.moveaxis(C[part], 0, 2))
        squares[part] = np.square(unit).sum(axis=0)
    return squares, log_det


def nis(estimator: Filter, z: ArrayLike) -> Array:
    """Return the normalised innovation squared of each epoch, (N,) or (N, M), NaN where nothing was measured.

    For a consistent filter its mean is the number of measurements in the epoch. Raises as `innovations`.

    >>> from mpt_helpers.model import constant_velocity
    >>> nis(SteadyStateFilter.from_kalman(constant_velocity(dt=1.0, q=0.01, r=0.1)), [[1.0], [2.0]]).round(2)
    array([4.51, 6.93])
    """
    z, many, values, S = _of(estimator, z)
    squares, _ = _squares(values, S)
    result = np.where(np.isnan(z).all(axis=1), np.nan, squares)
    return result if many else result[:, 0]


def log_likelihood(estimator: Filter, z: ArrayLike) -> Any:
    """Return the logarithm of the probability density of measurements z, a number or, for many tracks, (M,).

    It is the sum of the log densities of the innovations. For a filter with a constant gain it is a quasi-likelihood:
    its S assumes that P(0/0) is the steady P, and its innovations are correlated until the start or a gap is
    forgotten. Raises as `innovations`.

    >>> from mpt_helpers.filters import KalmanFilter
    >>> from mpt_helpers.model import constant_velocity
    >>> round(float(log_likelihood(KalmanFilter(constant_velocity(dt=1.0, q=0.01, r=0.1)), [[1.0], [np.nan]])), 4)
    -4.6228
    """
    z, many, values, S = _of(estimator, z)
    squares, log_det = _squares(values, S)
    count = np.isfinite(values).sum(axis=1)
    result = -0.5 * (squares + log_det + count * np.log(2 * np.pi)).sum(axis=0)
    return result if many else result[0]


def nees(errors: ArrayLike, P: ArrayLike) -> Array:
    """Return the normalised estimation error squared eᵀ P⁻¹ e of each step, (N,) or (N, M).

    errors is (N, n) or (N, n, M). P is the covariance that the filter reports: (n, n), (N, n, n) or (N, n, n, M). The
    mean over steps or tracks is n when the errors have mean zero and covariance P.

    Raises ValueError for other shapes, for NaN, and for a P that is not symmetric and positive definite.

    >>> nees([[1.0, 2.0]], [[1.0, 0.0], [0.0, 4.0]])
    array([2.])
    """
    need = "an (N, n) or (N, n, M) array"
    errors = checks.real_numbers("errors", errors, need).astype(float)
    P = checks.real_numbers("P", P, "covariances").astype(float)
    if errors.ndim not in (2, 3):
        checks.refuse("errors", need, f"shape {errors.shape}")
    N, n = errors.shape[:2]
    many = errors.ndim == 3
    if P.shape not in ((n, n), (N, n, n), (N, n, *errors.shape[1:])):
        need = f"an (n, n), (N, n, n) or (N, n, n, M) array for errors of {errors.shape}"
        checks.refuse("P", need, f"shape {P.shape}")
    if not (np.isfinite(P).all() and np.isfinite(errors).all()):
        checks.refuse("errors, P", "finite numbers", "NaN or infinity")
    P = np.broadcast_to(P, (N, n, n)) if P.ndim == 2 else P
    P = P[..., None] if P.ndim == 3 else P  # one for all tracks
    sigma = np.sqrt(np.abs(np.einsum("kii...->ki...", P)))
    if (np.abs(P - P.swapaxes(1, 2)) > checks.SOLVED * sigma[:, :, None] * sigma[:, None]).any():
        checks.refuse("P", "positive definite matrices", "one that is not symmetric")
    squares, _ = _squares(errors if many else errors[..., None], P)
    if not np.isfinite(squares).all():
        checks.refuse("P", "positive definite matrices", "one that is not")
    return squares if many else squares[:, 0]


def chi_square_band(dof: int, runs: int, level: float = 0.95) -> tuple[float, float]:
    """Return the central band of the mean of `runs` independent chi-square variables of `dof` degrees of freedom.

    The mean NEES (dof n) or NIS (dof m) over so many runs of a consistent filter lies in it with probability `level`.

    >>> low, high = chi_square_band(dof=2, runs=100)
    >>> round(low, 2), round(high, 2)
    (1.63, 2.41)
    """
    total = checks.count("dof", dof) * checks.count("runs", runs)
    level = checks.number("level", level, "a number in (0, 1)", lambda level: 0 < level < 1)
    low, high = 2 * gammaincinv(total / 2, [(1 - level) / 2, (1 + level) / 2]) / runs
    return float(low), float(high)


class ErrorMoments(NamedTuple):
    """The mean (N, n) and the covariance (N, n, n) of an error at the steps 1 to N."""

    mean: Array
    covariance: Array


def error_moments(steady: SteadyStateFilter, truth: LinearModel, N: int, steps: int = 0) -> ErrorMoments:
    """Return the mean and the covariance of the error that a steady-state filter really makes.

    The filter runs on measurements of another model, `truth`, which differs in x0, P0, Q and R. Its error is

        e(k+1) = A e(k) + (I - B H) w(k) - B v(k+1),   e(0) = x(0) - x(0/0),   e(k+s/k) = Fˢ e(k) + noise

    Returns mean (N, n) and covariance (N, n, n) of x(k+s) - x(k+s/k) for k = 1 ... N and s = steps. Raises ValueError
    when truth has another F or H.

    >>> from mpt_helpers.model import constant_velocity, exact_motion
    >>> steady = SteadyStateFilter.from_kalman(constant_velocity(dt=1.0, q=0.01, r=0.1))
    >>> error_moments(steady, exact_motion(steady.model, x0=[0.0, 20.0]), N=2).mean.round(3)
    array([[ 9.029, 15.75 ],
           [11.187, 10.485]])
    """
    checks.instance("steady", steady, SteadyStateFilter)
    checks.instance("truth", truth, LinearModel)
    if not all(np.array_equal(getattr(truth, name), getattr(steady.model, name)) for name in "FH"):
        checks.refuse("truth", "the F and H of the filter's model", "others")
    steps = checks.count("steps", steps, least=0)
    mean, P = [], []
    e, C = truth.x0 - steady.model.x0, truth.P0
    for _ in range(checks.count("N", N)):
        e = steady.A @ e
        C = corrected_covariance(predicted_covariance(truth, C), steady.B, truth.H, truth.R)
        mean.append(e)
        P.append(C)
    F_steps = np.linalg.matrix_power(truth.F, steps)
    return ErrorMoments(np.array(mean) @ F_steps.T, predicted_covariance(truth, np.array(P), steps))
