"""Bands around predictions that hold as often as they say, because they follow their own checked errors.

The covariance of a filter is a claim about measurements that it has not seen. `ahead` puts the claim to the test: it
sets every later fix against its prediction, made some seconds before. `following` makes a band of it that has learnt,
at every moment, from the predictions that had come due by then. Nothing in it looks ahead, so that `LiveBand` gives the
same band fix by fix, wherever a fix comes exactly one horizon later.

The *horizon* is the time from a prediction to the fix that it is for, `seconds`, or h steps. The half-width of the band
around a prediction is f · c · sigma on each axis:

    sigma   what the filter states: the root of H P(k+h/k) Hᵀ + R
    c       of all axes: sqrt(0.2 + 0.8 a), with the recent average a of NIS / m: one where the model is right. A fifth
            stays, so that a mobile at rest does not make the band vanish before it starts.
    f       a factor that follows the misses of its own axis: up by 0.95 gamma after a miss, down by 0.05 gamma after a
            hit, on the logarithm, for a band of 95 %. A fix that repeats the one it was predicted at is none of either:
            the mobile rests, which says nothing of how it will move on

Both c and f remember as many fixes as fall into one horizon, and at least five: what is learnt is that old when it is
used. With that memory, 1 / memory is the weight of the latest NIS in a, and gamma is 0.5 / memory. (For a it counts the
fixes of the last horizon, for f those from the prediction to the fix that checks it.)

The rule for f is quantile tracking, the proportional part of conformal PID control (Angelopoulos, Candes and Tibshirani
2023). Over T predictions that count, its share of misses differs from 5 % by at most the range of log f over gamma T,
whatever the mobile does, if gamma is the same for all, as on even steps. That holds for any sigma, even for random
numbers (`placebo`), so that a right share proves little. What tells a good band from a bad one is its `interval_score`,
and its `coverage` in states that are known beforehand.
"""

from __future__ import annotations

import math
from collections import deque
from datetime import date, datetime
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
# A fix further off than this many variances counts as that: one jump does not widen the band for a whole memory.
CAP = 50.0
# A prediction is checked by the first fix that is one horizon later, and by none later than these horizons.
LATEST = 1.5
# Times that should be one horizon apart may differ by their rounding, in horizons.
TIME_ROUNDING = 1e-6
# A share of fewer independent predictions than this is too uncertain to judge a band by: that of 30 has a standard
# deviation of 4 % where it should be 95 %.
FEW = 30
# The horizon of a live band is too short if so many fixes, the first ones that could check a prediction, come later
# than 1.5 horizons after it. On a track of uneven steps where two of five do not, 30 fail by chance once in four
# million.
UNCHECKED = 30


class ForecastErrors(NamedTuple):
    """The forecast errors of later fixes, each predicted some seconds before. All tracks follow one another along K.

    Attributes
    ----------
    made, due : ndarray (K,)
        Times of a prediction and of the fix that checks it, in s.
    errors : ndarray (K, m)
        Measured minus predicted, NaN where nothing was measured.
    sigma : ndarray (K, m)
        Standard deviation of the error that the filter states.
    recent : ndarray (K,)
        c, the size of the recent innovations over the stated one, when the prediction was made.
    row, due_row : ndarray of int (K,)
        Rows of z of both fixes.
    fixes : ndarray of int (K,)
        How many fixes later the checking one is.
    track : ndarray of int (K,)
        The track that they belong to, 0 where there is one.
    rests : ndarray of bool (K,)
        Whether the checking fix repeats the one it was predicted at; `following` learns nothing from it.
    left_out : int
        How many fixes had no later one between 1 and 1.5 horizons: before a gap, and at the end.
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
    """Return the forecast errors: each fix against its prediction, made `seconds` before.

    After every fix the first one that is `seconds` later is predicted, if it is at most 1.5 times as much later. On a
    grid the times count from the first row.

    Parameters
    ----------
    estimator : Filter
        A filter with covariances, on a grid or with times of its own, of a model with a transition.
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
    TypeError
        For a predictor, and for a filter without covariances.
    ValueError
        For a model without a transition, for a joint or separate filter whose parts have times, and for a horizon that
        is not positive or that no fix is later by.

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
        checks.refuse("seconds", "a horizon with fixes 1 to 1.5 times as much later than others", got)
    arrays = [np.concatenate(column) for column in zip(*[part[:-1] for part in parts], strict=True)]
    return ForecastErrors._make([*arrays, sum(part[-1] for part in parts), seconds])


def following(a: ForecastErrors, before: ForecastErrors | None = None, level: float = 0.95) -> Array:
    """Return the half-widths of a band that follows its own checked errors: f · c · sigma of this module.

    The band of a prediction has learnt from those of its own track that were due when it was made, and from no other.

    Parameters
    ----------
    a : ForecastErrors
        The errors of `ahead`.
    before : ForecastErrors, optional
        Those of an earlier segment with the same horizon: the factor f starts from where it ends there, and from the
        normal distribution where not given.
    level : float
        The share of an axis' errors that its band is to hold, between 0 and 1.

    Returns
    -------
    ndarray (K, m)
        The half-widths, in the units of the errors.

    Raises
    ------
    TypeError
        For anything but ForecastErrors.
    ValueError
        For a level outside (0, 1), and for another horizon or number of axes before.

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
    log_f = _start(a.seconds, a.errors.shape[1], before, level)
    band = np.empty_like(a.sigma)
    for rows in _each_track(a):
        _follow(a, rows, log_f, level, band)
    return band


def coverage(a: ForecastErrors, band: ArrayLike, where: ArrayLike | None = None) -> Coverage:
    """Return the share of the errors inside a band, on each axis, with its standard error.

    Predictions that overlap in time share most of their errors. Independent are the first one, and from then on each
    that is made when the one counted before it is due, or later. The standard error is that of a share of so many, with
    two hits and two misses added (Agresti and Coull 1998), so that it is not zero where all of them hit.

    Parameters
    ----------
    a : ForecastErrors
        The errors of `ahead`.
    band : array_like (K, m)
        Half-widths of the band. Where one is NaN nothing was stated, which counts as neither a hit nor a miss.
    where : array_like of bool (K,), optional
        Which predictions to look at; all where not given.

    Returns
    -------
    Coverage
        The share, its standard error and the number of independent predictions.

    Raises
    ------
    ValueError
        For a band or a `where` of another shape, a negative half-width, and where an axis has no prediction left.

    Warns
    -----
    UserWarning
        Of fewer than 30 independent predictions, and of errors left out since their band is NaN: a band that states
        nothing in hard cases looks better than it is.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> kf = mpt.KalmanFilter(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1))
    >>> a = mpt.metrics.ahead(kf, np.where(np.arange(64) == 60, 9.0, 0.0)[:, None], seconds=1.0)
    >>> mpt.metrics.coverage(a, mpt.metrics.following(a))  # one fix is 9 m off, and the filter with it for a while
    Coverage(share=array([0.96825397]), error=array([0.02894597]), independent=63)

    """
    band, judged = _checked_band("coverage", a, band, where)
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

    It is smallest for the true quantiles (Gneiting and Raftery 2007, Eq. 43): a band that is too wide pays by its
    width, one that is too narrow by 40 times what it misses (level 0.95).

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

    Raises
    ------
    ValueError
        As `coverage`.

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
    band, judged = _checked_band("interval_score", a, band, where)
    missed_by = np.maximum(np.abs(a.errors) - band, 0)
    return np.nanmean(np.where(judged, 2 * band + 2 / (1 - checks.level(level)) * missed_by, np.nan), axis=0)


def placebo(a: ForecastErrors, rng: np.random.Generator) -> ForecastErrors:
    """Return the errors with a sigma that tells nothing: the median of each axis times lognormal (0, 1) numbers.

    A band that follows its errors holds as many of them with these. Its interval score and its coverage in states that
    are known beforehand are what a true sigma must beat.

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
    checks.instance("a", a, ForecastErrors)
    checks.instance("rng", rng, np.random.Generator)
    # Of the size of the true ones: on a short track a band has not yet learnt its size.
    sigma = np.median(a.sigma, axis=0) * np.exp(rng.standard_normal(a.sigma.shape))
    return a._replace(sigma=sigma, recent=np.ones(len(a.recent)))


class LiveBand:
    """The band of `following`, fix by fix, beside the `step` of a filter.

    f and c are those of `following` at each fix, but sigma may differ. Here it belongs to a measurement exactly
    `seconds` after the fix, of the variances r that the step is given (the model's, where it is given none or nothing
    was measured). There it belongs to the fix that checks the prediction. That comes up to 1.5 times as late where
    steps are uneven, so that sigma is larger, and it has its own variances.

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
        self._factor = _Factor(_start(self.seconds, self.model.m, before, self.level), self.level)
        self.average: float = 1.0  # a: the recent average of NIS / m
        self.last: tuple[float, Array, Array] | None = None  # the estimate of the last call: time, x, P
        self.kind: str | None = None  # of its time: a number, a date or a date with a zone
        self.first: tuple[Array, Array] = (self.model.x0, estimator.P0)
        self.times: deque[float] = deque()  # of the fixes within the last horizon
        self.fixes: int = 0
        # How many fixes came too late; None once one did not.
        self.unchecked: int | None = 0 if before is None else None
        # Predictions that wait for their fix: time, x, P, f c, the number of their fix, its z.
        self.pending: deque[tuple[Any, ...]] = deque()

    @property
    def factor(self) -> Array:
        """The factor f of each axis, (m,): 1.96 where the filter's own band of 95 % was right."""
        return np.exp(self._factor.log_f)

    def step(
        self, t: float | datetime | np.datetime64, z: ArrayLike, x: ArrayLike, P: ArrayLike, r: ArrayLike | None = None
    ) -> Expected:
        """Return the expected measurement `seconds` after t and its band.

        Parameters
        ----------
        t : float or datetime
            Time of this epoch, in s or as a date.
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
            For another shape, an infinite measurement, a variance that is not positive, a time before the last one, and
            where none of the first 30 fixes that came late enough for a prediction was 1 to 1.5 horizons later: then
            the steps are longer than the horizon, and the band would never learn.

        """
        n, m = self.model.n, self.model.m
        t = self._moment(t)
        z = checks.measurements(np.reshape(z, (1, -1)), m)[0].copy()  # it is kept, and the caller may fill it anew
        x, P = (each.copy() for each in checks.state(x, P, n))
        checks.no_infinity(z)
        R = self.model.R
        if r is not None:
            seen = ~np.isnan(z)
            R = np.diag(np.where(seen, checks.variances_of_one("r", r, seen), np.diag(R)))
        if self.last is None:
            self.last = t - self.model.dt, *self.first
        if t < self.last[0]:
            checks.refuse("t", f"a time that is not before the last one, {self.last[0]:g}", f"{t:g}")
        if not np.isnan(z).all():
            self._check(t, z, R)
            self._learn(t, z, R)
        self.last = t, x, P
        scale = self.factor * _local(self.average)
        if not np.isnan(z).all():
            self.fixes += 1
            self.times.append(t)
            self.pending.append((t, x, P, scale, self.fixes, z))
        expected, sigma = self._predicted(x, P, self.seconds, R)
        return Expected(expected, scale * sigma)

    def _moment(self, t):
        """Return a time in seconds; all of them are numbers, or dates of one kind."""
        kind = "numbers of seconds"
        if isinstance(t, date | np.datetime64):
            kind = "dates with a zone" if getattr(t, "tzinfo", None) is not None else "dates without a zone"
        if isinstance(t, date) and not isinstance(t, datetime):
            checks.refuse("t", "a time in seconds or a datetime", "a date without a time of day", TypeError)
        if self.kind not in (None, kind):
            checks.refuse("t", f"{self.kind}, as those before", kind)
        self.kind = kind
        return checks.moment("t", t)

    def _check(self, t, z, R):
        """Let the factor learn from the predictions that have come due at the fix z."""
        too_late = 0.0  # by how many seconds this fix came after predictions that it cannot check
        while self.pending and t - self.pending[0][0] >= self.seconds * (1 - TIME_ROUNDING):
            made, x, P, scale, number, z_made = self.pending.popleft()
            if t - made > self.seconds * (LATEST + TIME_ROUNDING):
                too_late = t - made
                continue
            self.unchecked = None
            if _repeats(z, z_made):
                continue
            expected, sigma = self._predicted(x, P, t - made, R)
            self._factor.learn(np.abs(z - expected).tolist(), (scale * sigma).tolist(), self.fixes + 1 - number)
        if too_late and self.unchecked is not None:
            self._refuse_steps_that_are_too_long(too_late)

    def _refuse_steps_that_are_too_long(self, later):
        self.unchecked += 1
        if self.unchecked == UNCHECKED:
            got = f"{self.seconds:g}, and none of {UNCHECKED} fixes came so soon; the last one was {later:g} s later"
            checks.refuse("seconds", "a horizon with fixes 1 to 1.5 times as much later than others", got)

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


class _Factor:
    """log f of each axis, which learns from predictions when they come due.

    The fixes that come while one prediction waits are no more than the memory. So they move log f by 0.5 at most: if
    all of them are misses, the band becomes 1.6 times as wide.
    """

    def __init__(self, log_f, level):
        self.log_f, self.level = list(log_f), level

    def learn(self, errors, half_widths, fixes):
        """Learn from the sizes of errors, NaN where none counts, checked so many fixes after they were predicted."""
        gain = 0.5 / _memory(fixes)
        for axis, (error, half_width) in enumerate(zip(errors, half_widths, strict=True)):
            if error == error:
                self.log_f[axis] += gain * ((error > half_width) - (1 - self.level))


def _follow(a, rows, log_f, level, band):
    """Write the half-widths of one track, a slice of rows, to band (K, m); return log f (m,) after the last fix."""
    factor = _Factor(log_f, level)
    widths = (a.sigma[rows] * a.recent[rows, None]).tolist()
    errors = np.where(a.rests[rows, None], np.nan, np.abs(a.errors[rows])).tolist()
    made_row, due_row, fixes = a.row[rows].tolist(), a.due_row[rows].tolist(), a.fixes[rows].tolist()
    half, checked = [], 0  # the half-widths so far; how many predictions the factor has learnt from
    for k, row in enumerate([*made_row, math.inf]):  # those due after the last one was made are learnt from at the end
        while checked < k and due_row[checked] <= row:
            factor.learn(errors[checked], half[checked], fixes[checked])
            checked += 1
        if k < len(widths):
            half.append([math.exp(f) * width for f, width in zip(factor.log_f, widths[k], strict=True)])
    band[rows] = half
    return np.array(factor.log_f)


def _start(seconds, m, before, level):
    """Return log f (m,) at the start of predictions `seconds` ahead: where those before end, if there are any."""
    if before is None:
        return np.full(m, math.log(ndtri((1 + level) / 2)))
    checks.instance("before", before, ForecastErrors)
    if before.seconds != seconds or before.errors.shape[1] != m:
        got = f"{before.seconds:g} s and {before.errors.shape[1]} axes"
        checks.refuse("before", f"predictions of {seconds:g} s and {m} axes, as those that follow", got)
    band, start = np.empty_like(before.sigma), _start(seconds, m, None, level)
    ends = [_follow(before, rows, start, level, band) for rows in _each_track(before)]
    return np.mean(ends or [start], axis=0)


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
    if not isinstance(estimator, Filter):
        checks.refuse("estimator", "a filter", f"{estimator!r:.60}", TypeError)
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


def _checked_band(name, a, band, where):
    """Return the band, and a mask (K, m) of the errors that judge it: measured, where `where` says, with a half-width.

    `name` is that of the function that judges, for the warning of errors without a half-width.
    """
    checks.instance("a", a, ForecastErrors)
    band = checks.real_numbers("band", band, "half-widths")
    if band.shape != a.errors.shape:
        checks.refuse("band", f"half-widths of shape {a.errors.shape}", f"shape {band.shape}")
    if (band < 0).any():
        checks.refuse("band", "half-widths that are not negative, NaN where nothing is stated", f"{np.nanmin(band):g}")
    if isinstance(where, np.ma.MaskedArray):
        checks.refuse("where", "truth values", "a masked array (its filled(False) has none that is masked)", TypeError)
    where = np.ones(len(band), bool) if where is None else np.asarray(where)
    if where.shape != (len(band),) or where.dtype != bool:
        checks.refuse("where", f"{len(band)} truth values", f"shape {where.shape} of {where.dtype}")
    measured = ~np.isnan(a.errors) & where[:, None]
    if not measured.any(axis=0).all():
        checks.refuse("where", "at least one prediction that is checked on each axis", "none on some")
    judged = measured & ~np.isnan(band)
    if not judged.any(axis=0).all():
        checks.refuse("band", "a half-width of at least one checked prediction on each axis", "none but NaN on some")
    unstated = int((measured & ~judged).sum())
    if unstated:
        checks.warn(
            f"{name}: left out {unstated} of {measured.sum()} errors, whose band is NaN: nothing was stated of them"
        )
    return band, judged
