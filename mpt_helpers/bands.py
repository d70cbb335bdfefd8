"""Bands around predictions that hold as often as they say, because they follow their own checked errors.

`ahead` predicts each fix some seconds before. `following` makes a band around these predictions that learns from the
ones that have come due, and from nothing later. `LiveBand` gives that band fix by fix.

The *horizon* is the time from a prediction to its fix, `seconds`, or h steps. The half-width of the band is f c sigma
on each axis:

    sigma   what the filter states: the root of H P(k+h/k) Hᵀ + R
    c       one for all axes: sqrt(0.2 + 0.8 a), where a is the recent average of NIS / m. It is one where the model is
            right. A fifth stays, so that the band does not vanish while a mobile rests.
    f       follows the misses of its axis: for a band of 95 %, log f rises by 0.95 gamma after a miss and falls by
            0.05 gamma after a hit. A fix that repeats the one it was predicted at counts as neither.

Both remember the fixes of one horizon, and at least five: a new NIS has the weight 1 / memory, and gamma is 0.5 /
memory. For a the memory is the number of fixes in the last horizon, for f that from the prediction to its check.

The rule for f is quantile tracking, the proportional part of conformal PID control (Angelopoulos, Candes and Tibshirani
2023). With a constant gamma, the share of misses among T predictions differs from 5 % by at most the range of log f
over gamma T, whatever the mobile does and whatever sigma is. So a right share proves little: a good band is narrow
where it can be, which its `interval_score` shows, and its `coverage` in states that are known beforehand.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri

from . import _checks as checks
from ._base import Filter
from ._checks import Array, Seconds
from .model import LinearModel

__all__ = [
    "Coverage",
    "Expected",
    "ForecastErrors",
    "LiveBand",
    "ahead",
    "coverage",
    "following",
    "interval_score",
    "placebo",
]

# What is learnt of the errors is forgotten over the fixes of one horizon, and over no fewer than these.
SHORTEST_MEMORY = 5
# The part of a prediction's variance that the recent innovations scale.
LOCAL = 0.8
# A larger NIS / m counts as this: one jump does not widen the band for a whole memory.
CAP = 50.0
# A prediction is checked by the first fix that is one horizon later, and by none later than these horizons.
LATEST = 1.5
# Times that should be one horizon apart may differ by their rounding, in horizons.
TIME_ROUNDING = 1e-6
# The share of 30 independent predictions has a standard deviation of 4 %: with fewer, `coverage` warns.
FEW = 30
# If so many fixes in a row, from the first on, are too late for a check, the horizon is shorter than the steps.
UNCHECKED = 30
FITTING = "a horizon with fixes 1 to 1.5 times as much later than others"


class ForecastErrors(NamedTuple):
    """Errors of K predictions, each of a fix some seconds later. Tracks follow one another along K.

    Attributes
    ----------
    made, due : ndarray (K,)
        Times of the prediction and of the fix that checks it, in s.
    errors : ndarray (K, m)
        Measured minus predicted, NaN where nothing was measured.
    sigma : ndarray (K, m)
        Standard deviation of the error that the filter states.
    recent : ndarray (K,)
        c, the size of the recent innovations over the stated one, when the prediction was made.
    row, due_row : ndarray of int (K,)
        Rows of z of both.
    fixes : ndarray of int (K,)
        How many fixes later the checking one is.
    track : ndarray of int (K,)
        The track.
    rests : ndarray of bool (K,)
        Whether the checking fix repeats the one it was predicted at.
    left_out : int
        How many fixes had no other one 1 to 1.5 horizons later: before a gap, and at the end.
    seconds : float
        The horizon.

    """

    made: Array
    due: Array
    errors: Array
    sigma: Array
    recent: Array
    row: NDArray[np.intp]
    due_row: NDArray[np.intp]
    fixes: NDArray[np.intp]
    track: NDArray[np.intp]
    rests: NDArray[np.bool_]
    left_out: int
    seconds: float

    def __repr__(self) -> str:
        K, m = self.errors.shape
        return f"ForecastErrors({K} predictions of {m} axes, {self.seconds:g} s ahead; {self.left_out} fixes left out)"


class Coverage(NamedTuple):
    """The share of errors inside a band.

    Attributes
    ----------
    share, error : ndarray (m,)
        The share on each axis and its standard error.
    independent : int
        The number of independent predictions, on the axis with the fewest.

    """

    share: Array
    error: Array
    independent: int


class Expected(NamedTuple):
    """The expected measurement and its band.

    Attributes
    ----------
    position : ndarray (m,)
        The expected measurement.
    half_width : ndarray (m,)
        The half-widths of the band around it.

    """

    position: Array
    half_width: Array


def ahead(estimator: Filter, z: ArrayLike, seconds: Seconds) -> ForecastErrors:
    """Return the forecast errors of a filter: each fix minus its prediction, made `seconds` before.

    Each fix is checked by the first one that is 1 to 1.5 times `seconds` later. On a grid, times count from row 0.

    Parameters
    ----------
    estimator : Filter
        A filter with covariances, of a model with a transition.
    z : array_like (N, m) or (N, m, M)
        Measurements, NaN where one is missing.
    seconds : float or timedelta
        The horizon in s.

    Returns
    -------
    ForecastErrors
        The errors and the standard deviations that the filter states of them.

    Raises
    ------
    ValueError
        For a model without a transition, a joint or separate filter whose parts have times of their own, and a horizon
        that fits no two fixes.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> kf = mpt.KalmanFilter(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1, x0=[0, 1]))
    >>> a = mpt.metrics.ahead(kf, [[1.1], [1.9], [np.nan], [4.0], [5.2]], seconds=2.0)
    >>> a.made, a.due, a.errors.ravel().round(2), a.sigma.ravel().round(2), a.left_out
    (array([0., 1.]), array([3., 3.]), array([-0.02,  0.04]), array([0.56, 0.53]), 2)

    """
    model = _model_of_any_step(estimator)
    seconds = checks.duration("seconds", seconds)
    z = checks.measurements(z, model.m)
    x, P = estimator.estimates(z)
    if z.ndim == 2:
        z, x, P = z[..., None], x[..., None], P[..., None]
    N, m, M = z.shape
    t = np.broadcast_to(estimator.times_of(N).reshape(N, -1), (N, M))
    R = np.broadcast_to(estimator.epochs_of(z).noise(model.R), (N, m, m, M))
    parts = []
    for c in range(M):
        t_c, R_c = t[:, c], R[..., c]
        x_c = np.vstack([model.x0, x[..., c]])
        P_c = np.concatenate([estimator.P0[None], P[..., c]])
        parts.append(_ahead_on_one_track(model, t_c, z[..., c], x_c, P_c, R_c, seconds, c))
    if not any(len(part[0]) for part in parts):
        steps = np.diff(t[np.isfinite(z[..., 0]).any(axis=1), 0])
        got = f"{seconds:g} with steps of {np.median(steps):g} s" if len(steps) else "fewer than two fixes"
        checks.refuse("seconds", FITTING, got)
    arrays = [np.concatenate(column) for column in zip(*[part[:-1] for part in parts], strict=True)]
    return ForecastErrors._make([*arrays, sum(part[-1] for part in parts), seconds])


def following(a: ForecastErrors, before: ForecastErrors | None = None, level: float = 0.95) -> Array:
    """Return the half-widths of a band that follows its own checked errors, f c sigma of this module.

    The band of a prediction has learnt from the predictions of its track that were due when it was made.

    Parameters
    ----------
    a : ForecastErrors
        The errors of `ahead`.
    before : ForecastErrors, optional
        Those of an earlier segment with the same horizon: f goes on from their end. Without them it starts at the
        quantile of the normal distribution.
    level : float
        The share of an axis' errors that its band is to hold, between 0 and 1.

    Returns
    -------
    ndarray (K, m)
        The half-widths, in the units of the errors.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> kf = mpt.KalmanFilter(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1))
    >>> a = mpt.metrics.ahead(kf, [[0.0], [0.1], [5.0], [5.1], [5.2]], seconds=1.0)
    >>> band = mpt.metrics.following(a)
    >>> (band / a.sigma / a.recent[:, None]).ravel().round(3)  # f after a hit, a miss and a hit
    array([1.96 , 1.95 , 2.145, 2.134])

    """
    checks.instance("a", a, ForecastErrors)
    level = checks.level(level)
    start = _start(a.seconds, a.errors.shape[1], before, level)
    band = np.empty_like(a.sigma)
    for rows in _each_track(a):
        _follow(a, rows, start, level, band)
    return band


def coverage(a: ForecastErrors, band: ArrayLike, where: ArrayLike | None = None) -> Coverage:
    """Return the share of the errors inside a band, on each axis, with its standard error.

    Predictions that overlap in time share most of their errors, so the standard error counts only those that do not,
    with two hits and two misses added (Agresti and Coull 1998).

    Parameters
    ----------
    a : ForecastErrors
        The errors of `ahead`.
    band : array_like (K, m)
        Half-widths of the band; those that are NaN are left out.
    where : array_like of bool (K,), optional
        Which predictions to look at; all where not given.

    Returns
    -------
    Coverage
        The share, its standard error and the number of independent predictions.

    Warns
    -----
    UserWarning
        Of fewer than 30 independent predictions, and of errors that are left out since their band is NaN.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> kf = mpt.KalmanFilter(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1))
    >>> a = mpt.metrics.ahead(kf, np.where(np.arange(64) == 60, 9.0, 0.0)[:, None], seconds=1.0)
    >>> mpt.metrics.coverage(a, mpt.metrics.following(a))  # one fix is 9 m off, and the filter with it for a while
    Coverage(share=array([0.96825397]), error=array([0.02894597]), independent=63)

    """
    band, judged = _judged("coverage", a, band, where)
    inside = np.where(judged, np.abs(a.errors) <= band, np.nan)
    of_axes = np.array([_independent(a, of_axis) for of_axis in judged.T])
    fewest = int(of_axes.min())
    if fewest < FEW:
        text = f"coverage: {fewest} independent predictions of {a.seconds:g} s are too few to judge a band by"
        checks.warn(f"{text}, which takes {FEW}")
    share = np.nanmean(inside, axis=0)
    near = (share * of_axes + 2) / (of_axes + 4)
    return Coverage(share, np.sqrt(near * (1 - near) / (of_axes + 4)), fewest)


def interval_score(a: ForecastErrors, band: ArrayLike, level: float = 0.95, where: ArrayLike | None = None) -> Array:
    """Return the mean interval score of a band on each axis: its width, and by how much errors exceed it.

        2 b + 2 / (1 - level) · max(|error| - b, 0),   b the half-width

    It is least for the true quantiles (Gneiting and Raftery 2007, Eq. 43).

    Parameters
    ----------
    a : ForecastErrors
        The errors of `ahead`.
    band : array_like (K, m)
        Half-widths of the band, NaN where nothing is stated.
    level : float
        The share of errors that the band is to hold, between 0 and 1.
    where : array_like of bool (K,), optional
        Which predictions to look at; all where not given.

    Returns
    -------
    ndarray (m,)
        The score of each axis, in the units of the errors.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> kf = mpt.KalmanFilter(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1))
    >>> a = mpt.metrics.ahead(kf, [[0.0], [0.5], [2.0]], seconds=1.0)
    >>> a.errors.ravel().round(2)
    array([0.5 , 1.82])
    >>> mpt.metrics.interval_score(a, np.ones((2, 1))).round(2)  # the second is missed by 0.82
    array([18.38])

    """
    band, judged = _judged("interval_score", a, band, where)
    missed_by = np.maximum(np.abs(a.errors) - band, 0)
    return np.nanmean(np.where(judged, 2 * band + 2 / (1 - checks.level(level)) * missed_by, np.nan), axis=0)


def placebo(a: ForecastErrors, rng: np.random.Generator) -> ForecastErrors:
    """Return the errors with a sigma that tells nothing: the median of each axis times lognormal (0, 1) numbers.

    A band that follows its errors holds as many of them with this sigma; a true sigma must have a better score.

    Parameters
    ----------
    a : ForecastErrors
        The errors of `ahead`.
    rng : numpy.random.Generator
        Source of random numbers.

    Returns
    -------
    ForecastErrors
        The errors with another sigma, and with c = 1.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> kf = mpt.KalmanFilter(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1))
    >>> a = mpt.metrics.ahead(kf, [[0.0], [0.5], [2.0]], seconds=1.0)
    >>> mpt.bands.placebo(a, np.random.default_rng(1)).sigma.ravel().round(2)
    array([0.54, 0.87])

    """
    # The median, since a band on a short track has not yet learnt the size.
    sigma = np.median(a.sigma, axis=0) * np.exp(rng.standard_normal(a.sigma.shape))
    return a._replace(sigma=sigma, recent=np.ones(len(a.recent)))


class LiveBand:
    """The band of `following`, fix by fix, beside the `step` of a filter.

    It is for a measurement exactly `seconds` after a fix, with the variances of that fix. On uneven steps the band of
    `following` is wider, as its prediction is for the fix that checks it.

    Parameters
    ----------
    estimator : Filter
        A filter as for `ahead`.
    seconds : float or timedelta
        The horizon in s.
    before : ForecastErrors, optional
        Those of an earlier segment with the same horizon, as for `following`.
    level : float
        The share of an axis' errors that its band is to hold, between 0 and 1.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> kf = mpt.KalmanFilter(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1, x0=[0, 1]))
    >>> live = mpt.bands.LiveBand(kf, seconds=2.0)
    >>> x, P = kf.model.x0, kf.P0
    >>> for t, z in enumerate([[1.1], [1.9], [3.2]]):
    ...     x, P = kf.step(x, P, z)
    ...     position, half_width = live.step(t, z, x, P)
    ...     print(f"at {t + 2} s: {position.item():.2f} ± {half_width.item():.2f}")
    at 2 s: 3.01 ± 0.79
    at 3 s: 3.96 ± 0.89
    at 4 s: 5.14 ± 0.92

    """

    def __init__(self, estimator: Filter, seconds: Seconds, before: ForecastErrors | None = None, level: float = 0.95):
        self.model: LinearModel = _model_of_any_step(estimator)
        self.seconds: float = checks.duration("seconds", seconds)
        self.level: float = checks.level(level)
        self.log_f: list[float] = _start(self.seconds, self.model.m, before, self.level)
        self.average: float = 1.0  # a: the recent average of NIS / m
        # The estimate of the last call: time, x, P.
        self.last: tuple[float | None, Array, Array] = None, self.model.x0, estimator.P0
        self.times: deque[float] = deque()  # of the fixes within the last horizon
        self.fixes: int = 0
        # How many fixes came too late for a check; None once one did not.
        self.unchecked: int | None = 0 if before is None else None
        # Predictions that wait for their fix: time, x, P, f c, the number of their fix, its z.
        self.pending: deque[tuple[Any, ...]] = deque()

    @property
    def factor(self) -> Array:
        """The factor f of each axis, (m,): 1.96 where the filter's own band of 95 % was right."""
        return np.exp(self.log_f)

    def step(self, t: float, z: ArrayLike, x: ArrayLike, P: ArrayLike, r: ArrayLike | None = None) -> Expected:
        """Return the expected measurement `seconds` after t and its band.

        Parameters
        ----------
        t : float
            Time of this epoch in s.
        z : array_like (m,)
            The measurement at t, NaN where it is missing or was refused.
        x, P : array_like (n,), (n, n)
            The filter's estimate after it, and its covariance.
        r : array_like (m,), optional
            Variances of the measurement, where it has some of its own.

        Returns
        -------
        Expected
            The expected measurement and the half-widths of the band.

        Raises
        ------
        ValueError
            For a time before the last one, and after 30 fixes of which none could check a prediction: the steps are
            longer than the horizon.

        """
        t = checks.number("t", t, "a time in seconds", lambda _: True)
        z = checks.measurements(np.reshape(z, (1, -1)), self.model.m)[0].copy()  # the caller may fill it anew
        checks.no_infinity(z)
        x, P = (each.copy() for each in checks.state(x, P, self.model.n))
        seen = ~np.isnan(z)
        R = self.model.R
        if r is not None:
            R = np.diag(np.where(seen, checks.variances_of_one("r", r, seen), np.diag(R)))
        if self.last[0] is None:
            self.last = t - self.model.dt, *self.last[1:]
        if t < self.last[0]:
            checks.refuse("t", f"a time that is not before the last one, {self.last[0]:g}", f"{t:g}")
        if seen.any():
            self._check(t, z, R)
            self._learn(t, z, R)
        self.last = t, x, P
        scale = self.factor * _local(self.average)
        if seen.any():
            self.fixes += 1
            self.times.append(t)
            self.pending.append((t, x, P, scale, self.fixes, z))
        expected, sigma = self._predicted(x, P, self.seconds, R)
        return Expected(expected, scale * sigma)

    def _check(self, t, z, R):
        """Let f learn from the predictions that have come due at the fix z."""
        too_late = 0.0  # by how many seconds this fix came after predictions that it cannot check
        while self.pending and t - self.pending[0][0] >= self.seconds * (1 - TIME_ROUNDING):
            made, x, P, scale, number, z_made = self.pending.popleft()
            if t - made > self.seconds * (LATEST + TIME_ROUNDING):
                too_late = t - made
                continue
            self.unchecked = None
            if not _repeats(z, z_made):
                expected, sigma = self._predicted(x, P, t - made, R)
                fixes = self.fixes + 1 - number
                self.log_f = _after(self.log_f, np.abs(z - expected), scale * sigma, fixes, self.level)
        if too_late and self.unchecked is not None:
            self.unchecked += 1
            if self.unchecked == UNCHECKED:
                got = f"{self.seconds:g}, and none of {UNCHECKED} fixes came so soon; the last was {too_late:g} s later"
                checks.refuse("seconds", FITTING, got)

    def _learn(self, t, z, R):
        """Let the average of the recent innovations learn from the fix z."""
        while self.times and self.times[0] < t - self.seconds * (1 + TIME_ROUNDING):
            self.times.popleft()
        last, x, P = self.last
        expected, S = _expected(self.model, x[None], P[None], np.array([t - last]), R[None])
        squared = _nis_per_number(z[None] - expected, S)[0]
        self.average = _average_with(self.average, squared, len(self.times))

    def _predicted(self, x, P, seconds, R):
        expected, S = _expected(self.model, x[None], P[None], np.array([seconds]), R[None])
        return expected[0], np.sqrt(np.diag(S[0]))


def _ahead_on_one_track(model, t, z, x, P, R, seconds, track):
    """Return the fields of ForecastErrors, but for seconds. x and P begin with those before the first row."""
    fixes = np.flatnonzero(np.isfinite(z).any(axis=1))
    t_fix = t[fixes]
    due = np.searchsorted(t_fix, t_fix + seconds * (1 - TIME_ROUNDING))
    checked = due < len(fixes)
    checked[checked] = t_fix[due[checked]] - t_fix[checked] <= seconds * (LATEST + TIME_ROUNDING)
    row, due_row = fixes[checked], fixes[due[checked]]
    later = due[checked] - np.flatnonzero(checked)
    expected, S = _expected(model, x[row + 1], P[row + 1], t[due_row] - t[row], R[due_row])
    sigma = np.sqrt(np.diagonal(S, axis1=1, axis2=2))
    before = np.diff(t, prepend=t[0] - model.dt)[fixes]
    innovation_of, S_of = _expected(model, x[fixes], P[fixes], before, R[fixes])
    recent = _recent(t_fix, _nis_per_number(z[fixes] - innovation_of, S_of), seconds)[checked]
    tracks, rests = np.full(len(row), track), _repeats(z[due_row], z[row])
    left_out = len(fixes) - len(row)
    return t[row], t[due_row], z[due_row] - expected, sigma, recent, row, due_row, later, tracks, rests, left_out


def _repeats(z, before):
    """Tell which measurements z (..., m) repeat the ones before them, to the last bit."""
    return ((z == before) | (np.isnan(z) & np.isnan(before))).all(axis=-1)


def _expected(model, x, P, seconds, R):
    """Return the mean (K, m) and covariance (K, m, m) of measurements some seconds (K,) after x (K, n), P (K, n, n)."""
    F, Q = model.over(seconds)
    P = F @ P @ F.swapaxes(1, 2) + Q
    x = (F @ x[..., None])[..., 0]
    return x @ model.H.T, model.H @ P @ model.H.T + R


def _nis_per_number(innovations, S):
    """Return NIS / m of innovations (K, m), at most CAP, where m counts those that are there."""
    seen = np.isfinite(innovations)
    both = seen[:, :, None] & seen[:, None]
    y = np.where(seen, innovations, 0)
    nis = np.einsum("ki,ki->k", y, np.linalg.solve(np.where(both, S, np.eye(S.shape[1])), y[..., None])[..., 0])
    return np.minimum(nis / seen.sum(axis=1), CAP)


def _recent(t, squared, seconds):
    """Return c after each fix, from NIS / m of all fixes."""
    within = np.arange(len(t)) - np.searchsorted(t, t - seconds * (1 + TIME_ROUNDING))
    a, averages = 1.0, []
    for value, count in zip(squared.tolist(), within.tolist(), strict=True):
        a = _average_with(a, value, count)
        averages.append(a)
    return _local(np.array(averages))


def _average_with(average, squared, fixes):
    """Return the recent average of NIS / m after one more of them, with so many fixes in the horizon before it."""
    return average + (squared - average) / _memory(fixes)


def _local(average):
    """Return c from the recent average of NIS / m."""
    return np.sqrt(1 - LOCAL + LOCAL * average)


def _memory(fixes):
    """Return the number of fixes over which errors are remembered, from the number of fixes in one horizon."""
    return max(SHORTEST_MEMORY, fixes)


def _after(log_f, errors, half_widths, fixes, level):
    """Return log f of each axis after errors (m,), NaN where none counts, checked so many fixes after the prediction.

    The fixes that come while one prediction waits are no more than the memory, so they move log f by 0.5 at most.
    """
    gain = 0.5 / _memory(fixes)
    return [
        f + gain * ((error > half_width) - (1 - level)) if error == error else f
        for f, error, half_width in zip(log_f, errors, half_widths, strict=True)
    ]


def _follow(a, rows, log_f, level, band):
    """Write the half-widths of one track, a slice of rows, to band (K, m); return log f (m,) after the last fix."""
    widths = (a.sigma[rows] * a.recent[rows, None]).tolist()
    errors = np.where(a.rests[rows, None], np.nan, np.abs(a.errors[rows])).tolist()
    made_row, due_row, fixes = a.row[rows].tolist(), a.due_row[rows].tolist(), a.fixes[rows].tolist()
    half, checked = [], 0  # the half-widths so far; how many predictions f has learnt from
    for k, row in enumerate([*made_row, math.inf]):  # those due after the last one was made are learnt from at the end
        while checked < k and due_row[checked] <= row:
            log_f = _after(log_f, errors[checked], half[checked], fixes[checked], level)
            checked += 1
        if k < len(widths):
            half.append([math.exp(f) * width for f, width in zip(log_f, widths[k], strict=True)])
    band[rows] = half
    return log_f


def _start(seconds, m, before, level):
    """Return log f of each axis at the start: where the errors before end, if there are any."""
    normal = [math.log(ndtri((1 + level) / 2))] * m
    if before is None:
        return normal
    checks.instance("before", before, ForecastErrors)
    if before.seconds != seconds or before.errors.shape[1] != m:
        got = f"{before.seconds:g} s and {before.errors.shape[1]} axes"
        checks.refuse("before", f"predictions of {seconds:g} s and {m} axes, as those that follow", got)
    band = np.empty_like(before.sigma)
    ends = [_follow(before, rows, normal, level, band) for rows in _each_track(before)]
    return np.mean(ends or [normal], axis=0).tolist()


def _each_track(a):
    """Return the slice of each track along K."""
    first = np.flatnonzero(np.diff(a.track, prepend=-1))
    return [slice(*pair) for pair in zip(first, [*first[1:], len(a.track)], strict=True)]


def _independent(a, where):
    """Return the number of predictions that do not overlap: each begins when the one counted before it has ended."""
    count, end, track = 0, -np.inf, -1
    for made, due, of_track in zip(a.made[where].tolist(), a.due[where].tolist(), a.track[where].tolist(), strict=True):
        if made >= end or of_track != track:
            count, end, track = count + 1, due, of_track
    return count


def _model_of_any_step(estimator):
    if estimator.model.dt is None:
        need = "a model that knows steps of any length, such as constant_velocity or a motion of your own"
        checks.refuse("estimator", need, "one whose F and Q are for one length only")
    if any(map(_has_conditions, estimator.parts)):
        need = "a filter whose times and variances are its own, as a KalmanFilter of the stacked model"
        checks.refuse("estimator", need, f"a {type(estimator).__name__} of filters that have them")
    return estimator.model


def _has_conditions(estimator):
    """Tell whether a filter, or one of its parts, was given times or variances."""
    return estimator.t is not None or estimator.r is not None or any(map(_has_conditions, estimator.parts))


def _judged(name, a, band, where):
    """Return the band, and a mask (K, m) of the errors that judge it: measured, where `where` says, with a half-width.

    `name` is that of the function that judges, for its warning.
    """
    band = checks.real_numbers("band", band, "half-widths")
    if band.shape != a.errors.shape or (band < 0).any():
        got = f"shape {band.shape}, the least is {np.nanmin(band):g}"
        checks.refuse("band", f"half-widths of shape {a.errors.shape} that are not negative", got)
    where = np.ones(len(band), bool) if where is None else np.asanyarray(where)
    if type(where) is not np.ndarray or where.shape != (len(band),) or where.dtype != bool:
        checks.refuse("where", f"an array of {len(band)} truth values", f"{type(where).__name__} {where.shape}")
    measured = ~np.isnan(a.errors) & where[:, None]
    judged = measured & ~np.isnan(band)
    if not judged.any(axis=0).all():
        checks.refuse("band, where", "a half-width of at least one checked prediction on each axis", "none on some")
    if unstated := int((measured & ~judged).sum()):
        checks.warn(f"{name}: left out {unstated} of {measured.sum()} errors, whose band is NaN")
    return band, judged
