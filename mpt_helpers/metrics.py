"""Errors of estimates, and tests of a filter's consistency: innovations, NIS, NEES, likelihood."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaincinv

from . import _checks as checks
from ._base import Filter, one_or_many
from ._checks import Array
from ._engine.columns import whitened
from ._engine.shared import epochs_at_a_time
from ._immutable import types_as_written
from .bands import ahead, coverage, following, interval_score
from .equations import corrected_covariance, predicted_covariance
from .model import LinearModel
from .steady import SteadyStateFilter

__all__ = [
    "ErrorMoments",
    "Innovations",
    "ahead",
    "chi_square_band",
    "coverage",
    "error_moments",
    "following",
    "innovations",
    "interval_score",
    "log_likelihood",
    "nees",
    "nis",
    "relative_gap",
    "rms",
    "suspicious",
]

# Bounds of `suspicious`, from ten recorded tracks. The median NIS was 0.04 to 120 times that of a consistent filter. It
# was below 1e-4 times with degrees, kilometres or milliseconds in place of metres and seconds.
FAR_TOO_SMALL, FAR_TOO_LARGE = 2e-4, 1e4
# The largest NIS was below 1.3e3 times the median; with one fix 10,000 km away it was above 7e4 times.
OUTLIER = 1e4
# The correlation of successive innovations was below 0.3 in nine of ten fits, and up to 1 with q and r exchanged.
# Innovations are clipped at 4.4 times their median size, which is 3 sigma.
CORRELATED, CLIP = 0.5, 4.4
MEDIAN_OF_A_SQUARE = float(2 * gammaincinv(0.5, 0.5))  # the square of a normal variable of variance 1


def relative_gap(a: ArrayLike, b: ArrayLike) -> float:
    """Return the largest difference between two arrays, relative to the largest entry of b.

    Parameters
    ----------
    a, b : array_like
        Two arrays of one shape.

    Returns
    -------
    float
        max|a - b| / max|b|; 0 where a and b are equal, infinite where only b is zero.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> mpt.metrics.relative_gap([1.0, 2.0], [1.0, 4.0])
    0.5

    """
    b = checks.real_numbers("b", b, "an array of numbers").astype(float)
    a = checks.real_numbers("a", a, f"numbers in the shape of b, {b.shape}", b.shape).astype(float)
    gap = np.abs(a - b).max()
    if gap == 0:
        return 0.0
    with np.errstate(divide="ignore"):
        return float(gap / np.abs(b).max())


def rms(values: ArrayLike, axis: int | tuple[int, ...] | None = None) -> Any:
    """Return the root mean square along an axis, or of all values.

    Parameters
    ----------
    values : array_like
        Real numbers.
    axis : int or tuple of int, optional
        Axes to average over; all where not given.

    Returns
    -------
    ndarray or float
        The root mean square.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> float(mpt.metrics.rms([3.0, -3.0]))
    3.0

    """
    values = checks.real_numbers("values", values, "an array of numbers")
    return np.sqrt(np.mean(np.square(values, dtype=float), axis=axis))


@types_as_written
class Innovations(NamedTuple):
    """The innovations of a filter and their covariance.

    Attributes
    ----------
    values : ndarray (N, m) or (N, m, M)
        z(k) - H x(k/k-1), NaN where z has NaN.
    S : ndarray (N, m, m) or (N, m, m, M)
        H P(k/k-1) Hᵀ + R, whether or not the measurement is missing.

    """

    values: Array
    S: Array

    def __repr__(self) -> str:
        return f"Innovations(values {self.values.shape}, S {self.S.shape})"


def innovations(estimator: Filter, z: ArrayLike) -> Innovations:
    """Return the innovations z(k) - H x(k/k-1) and their covariance S(k) = H P(k/k-1) Hᵀ + R.

    Parameters
    ----------
    estimator : Filter
        Any filter except predictors and FIR filters, which have no innovations.
    z : array_like (N, m) or (N, m, M)
        Measurements, NaN where one is missing.

    Returns
    -------
    Innovations
        The innovations as `values`, in the shape of z, and their covariance as `S`.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> steady = mpt.SteadyStateFilter.from_kalman(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1))
    >>> mpt.metrics.innovations(steady, [[1.0], [2.0]]).values.round(4)
    array([[1.   ],
           [1.239]])

    """
    _, many, values, S = _checked_innovations(estimator, z)
    return Innovations(*one_or_many(values, S, many))


def _checked_innovations(estimator, z):
    """Return z (N, m, M), whether it was given with an axis of tracks, its innovations, and S (N, m, m, M or 1)."""
    checks.instance("estimator", estimator, Filter)
    z, many = estimator.as_tracks(z)
    checks.no_infinity(z)
    values, S = estimator.innovations_of(z)
    if not np.isfinite(np.where(np.isnan(z), 0, values)).all() or not np.isfinite(S).all():
        checks.refuse("estimator", "states and covariances that doubles can hold over these epochs", "an overflow")
    return z, many, values, S


def unit_innovations(estimator: Filter, z: ArrayLike) -> tuple[Array, Array, Array]:
    """Return innovations at unit covariance, (N, m, M), 0 where z is missing, and (N, M) log det S and their count."""
    _, _, values, S = _checked_innovations(estimator, z)
    return *_at_unit_covariance(values, S), np.isfinite(values).sum(axis=1)


def _at_unit_covariance(values, C):
    """Return values (N, d, M) at unit covariance, 0 where NaN, and log det C (N, M) of their C (N, d, d, M or 1)."""
    N, d, M = values.shape
    unit, log_det = np.empty((d, N, M)), np.empty((N, M))
    for part in epochs_at_a_time(N, d * d * M):
        unit[:, part], log_det[part] = whitened(np.moveaxis(values[part], 1, 0), np.moveaxis(C[part], 0, 2))
    return np.moveaxis(unit, 0, 1), log_det


def nis(estimator: Filter, z: ArrayLike) -> Array:
    """Return the normalised innovation squared (NIS), νᵀ S⁻¹ ν, of each epoch.

    For a consistent filter it is chi-square distributed, with one degree of freedom for each measurement of the epoch.

    Parameters
    ----------
    estimator, z : Filter, array_like (N, m) or (N, m, M)
        As for `innovations`.

    Returns
    -------
    ndarray (N,) or (N, M)
        The NIS, NaN where nothing was measured.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> steady = mpt.SteadyStateFilter.from_kalman(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1))
    >>> mpt.metrics.nis(steady, [[1.0], [2.0]]).round(2)
    array([4.51, 6.93])

    """
    unit, _, count = unit_innovations(estimator, z)
    result = np.where(count == 0, np.nan, np.square(unit).sum(axis=1))
    return result if np.ndim(z) == 3 else result[:, 0]


def log_likelihood(estimator: Filter, z: ArrayLike) -> Any:
    """Return the log-likelihood of the measurements, from the innovations.

        log p(z) = -1/2 Σ [νᵀ S⁻¹ ν + log det S + m log 2π]

    For a filter of constant gain it is a quasi-likelihood: its innovations are correlated after the start and after
    gaps.

    Parameters
    ----------
    estimator, z : Filter, array_like (N, m) or (N, m, M)
        As for `innovations`.

    Returns
    -------
    float or ndarray (M,)
        log p, for each track if there are many.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> kf = mpt.KalmanFilter(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1))
    >>> round(float(mpt.metrics.log_likelihood(kf, [[1.0], [np.nan]])), 4)
    -4.6228

    """
    unit, log_det, count = unit_innovations(estimator, z)
    result = -0.5 * (np.square(unit).sum(axis=1) + log_det + count * np.log(2 * np.pi)).sum(axis=0)
    return result if np.ndim(z) == 3 else result[0]


def suspicious(estimator: Filter, z: ArrayLike) -> dict[str, str]:
    """Return warnings, by kind, if the measurements or the filter look wrong.

    - "units": the median NIS, of single numbers, is below 2e-4 or above 1e4 times that of a consistent filter;
    - "far off": the NIS of one number is more than 1e4 times the median;
    - "correlated": successive innovations are correlated, as when q and r are exchanged;
    - "same time": two rows measure the same axis at the same time.

    Numbers that repeat the previous one do not count for the medians.

    Parameters
    ----------
    estimator, z : Filter, array_like (N, m) or (N, m, M)
        As for `innovations`.

    Returns
    -------
    dict
        A sentence for each kind of warning; empty if there is none.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> model = mpt.constant_velocity(dt=1.0, q=0.04, r=0.5, P0=np.eye(2))
    >>> _, z = mpt.simulate(model, N=200, rng=1)
    >>> mpt.metrics.suspicious(mpt.KalmanFilter(model), z)
    {}
    >>> z[70] = 1e4
    >>> mpt.metrics.suspicious(mpt.KalmanFilter(model), z)
    {'far off': 'row 70 of z is far off: its NIS is 2e+08 times the median one'}

    """
    z, _, values, S = _checked_innovations(estimator, z)
    unit = values / np.sqrt(np.einsum("kjj...->kj...", S))
    repeats = np.zeros(z.shape, bool)
    repeats[1:] = z[1:] == z[:-1]
    squares = np.square(np.where(repeats, np.nan, unit))
    median = float(np.nanmedian(squares)) if np.isfinite(squares).any() else 0.0
    found = {}
    if median > 0:
        found["units"] = _about_units(median / MEDIAN_OF_A_SQUARE)
        found["far off"] = _about_an_outlier(squares / median)
        found["correlated"] = _about_correlation(unit / math.sqrt(median))
    found["same time"] = _about_equal_times(estimator.times_of(len(z)), np.isfinite(z))
    return {kind: text for kind, text in found.items() if text}


def _about_units(ratio):
    """Return a warning if the median NIS is this many times that of a consistent filter, or an empty text."""
    if FAR_TOO_SMALL < ratio < FAR_TOO_LARGE:
        return ""
    units = "in the units of q and r (metres and seconds, not degrees, kilometres or milliseconds)?"
    return f"the median NIS is {ratio:.0e} times what it should be: are z and t {units}"


def _about_an_outlier(squares):
    """Return a warning if one of the NIS (N, m, M), in units of their median, is far larger, or an empty text."""
    largest = np.nanmax(squares)
    if largest <= OUTLIER:
        return ""
    k, _, track = np.unravel_index(np.nanargmax(squares), squares.shape)
    row = f"row {k} of z" if squares.shape[2] == 1 else f"row {k} of track {track} of z"
    return f"{row} is far off: its NIS is {largest:.0e} times the median one"


def _about_correlation(innovations):
    """Return a warning if successive innovations (N, m, M), of median square 1, are correlated, or an empty text."""
    clipped = np.clip(np.nan_to_num(innovations), -CLIP, CLIP)
    correlation = float((clipped[1:] * clipped[:-1]).sum() / np.square(clipped).sum())
    if abs(correlation) <= CORRELATED:
        return ""
    size = "small" if correlation > 0 else "large"
    why = f"q is too {size} for r (are the two exchanged?), or the model of motion is wrong"
    return f"successive innovations have a correlation of {correlation:.2f}: {why}"


def _about_equal_times(t, seen):
    """Return a warning if rows of seen (N, m, M) measure one axis twice at one time t (N, ...), or an empty text."""
    stopped = np.diff(t.reshape(len(t), -1), axis=0) == 0  # (N-1, 1 or M)
    again = (stopped & (seen[1:] & seen[:-1]).any(axis=1)).any(axis=1)
    if not again.any():
        return ""
    rows = f"{again.sum()} row(s) have the time of the one before, the first is row {again.argmax() + 1}"
    return f"{rows}: is it one fix, twice?"


def nees(errors: ArrayLike, P: ArrayLike) -> Array:
    """Return the normalised estimation error squared (NEES), eᵀ P⁻¹ e, of each step.

    Its mean is n if the errors have mean zero and covariance P.

    Parameters
    ----------
    errors : array_like (N, n) or (N, n, M)
        Errors of the states of one track or of M tracks.
    P : array_like (n, n), (N, n, n) or (N, n, n, M)
        The covariance that the filter reports.

    Returns
    -------
    ndarray (N,) or (N, M)
        The NEES.

    Raises
    ------
    ValueError
        For errors that are not finite, and a P that is not symmetric and positive definite.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> mpt.metrics.nees([[1.0, 2.0]], [[1.0, 0.0], [0.0, 4.0]])
    array([2.])

    """
    need = "an (N, n) or (N, n, M) array of finite numbers"
    errors = checks.real_numbers("errors", errors, need, ("N", "n"), ("N", "n", "M")).astype(float)
    if not np.isfinite(errors).all():  # a NaN would count as no error
        checks.refuse("errors", need, "NaN or infinity")
    many = errors.ndim == 3
    errors = errors if many else errors[..., None]
    N, n, M = errors.shape
    need = f"a covariance of each error, whose shape is {errors.shape}"
    P = checks.real_numbers("P", P, need, (n, n), (N, n, n), (N, n, n, M)).astype(float)
    P = P.reshape(-1, n, n, M if P.ndim == 4 else 1)  # a size of 1 stands for all epochs, or all tracks
    sigma = np.sqrt(np.abs(np.einsum("kii...->ki...", P)))
    if (np.abs(P - P.swapaxes(1, 2)) > checks.SOLVED * sigma[:, :, None] * sigma[:, None]).any():
        checks.refuse("P", "positive definite matrices", "one that is not symmetric")
    squares = np.square(_at_unit_covariance(errors, np.broadcast_to(P, (N, *P.shape[1:])))[0]).sum(axis=1)
    if not np.isfinite(squares).all():
        checks.refuse("P", "positive definite matrices", "one that is not")
    return squares if many else squares[:, 0]


def chi_square_band(dof: int, runs: int, level: float = 0.95) -> tuple[float, float]:
    """Return the central interval of the mean of independent chi-square variables.

    For a consistent filter, the mean NEES (dof n) or NIS (dof m) over the runs lies in it with probability `level`.

    Parameters
    ----------
    dof, runs : int
        Degrees of freedom of each variable, and their number.
    level : float
        Probability, between 0 and 1.

    Returns
    -------
    tuple of float
        The ends of the interval.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> low, high = mpt.metrics.chi_square_band(dof=2, runs=100)
    >>> round(low, 2), round(high, 2)
    (1.63, 2.41)

    """
    total = checks.count("dof", dof) * checks.count("runs", runs)
    level = checks.level(level)
    low, high = 2 * gammaincinv(total / 2, [(1 - level) / 2, (1 + level) / 2]) / runs
    return float(low), float(high)


@types_as_written
class ErrorMoments(NamedTuple):
    """The mean and the covariance of an error at the steps 1 to N.

    Attributes
    ----------
    mean, covariance : ndarray (N, n), (N, n, n)
        Mean and covariance at each step.

    """

    mean: Array
    covariance: Array


def error_moments(steady: SteadyStateFilter, truth: LinearModel, N: int, steps: int = 0) -> ErrorMoments:
    """Return the mean and the covariance of the actual error of a steady-state filter.

    The measurements come from another model, `truth`, with another x0, P0, Q or R. The error is

        e(k+1) = A e(k) + (I - B H) w(k) - B v(k+1),   e(0) = x(0) - x(0/0),   e(k+s/k) = Fˢ e(k) + noise

    Parameters
    ----------
    steady, truth : SteadyStateFilter, LinearModel
        The filter, and the model of the measurements, with the F and H of the filter's model.
    N, steps : int
        Number of steps, and the number s of steps that the estimate is predicted ahead.

    Returns
    -------
    ErrorMoments
        `mean` (N, n) and `covariance` (N, n, n) of x(k+s) - x(k+s/k) for k = 1 ... N.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> steady = mpt.SteadyStateFilter.from_kalman(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1))
    >>> truth = mpt.exact_motion(steady.model, x0=[0.0, 20.0])
    >>> mpt.metrics.error_moments(steady, truth, N=2).mean.round(3)
    array([[ 9.029, 15.75 ],
           [11.187, 10.485]])

    """
    checks.instance("steady", steady, SteadyStateFilter)
    checks.instance("truth", truth, LinearModel)
    if not all(np.array_equal(getattr(truth, name), getattr(steady.model, name)) for name in "FH"):
        checks.refuse("truth", "the F and H of the filter's model", "another F or H")
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
