"""Prediction bands that keep their stated coverage, since they adapt to their own past errors.

`ahead` predicts each fix some seconds in advance. `following` puts a band around each prediction, and uses only errors
that were known when the prediction was made. `LiveBand` gives the same band fix by fix.

The *horizon* is the time from a prediction to the fix that checks it: `seconds`, or h steps. On each axis, the
half-width of the band is f c sigma:

    sigma   the standard deviation that the filter states: the root of H P(k+h/k) Hᵀ + R
    c       sqrt(0.2 + 0.8 a), the same for all axes; a is the recent average of NIS / m, which is 1 if the model is
            right. The 0.2 keeps the band from vanishing while a mobile is at rest.
    f       a factor that follows the misses of its axis: for a band of 95 %, log f rises by 0.95 gamma after a miss
            and falls by 0.05 gamma after a hit. A fix that repeats the one at which it was predicted counts as neither.

Both have a memory of one horizon, in fixes, but of at least five: a new NIS has the weight 1 / memory, and gamma is
0.5 / memory. For a, the memory counts the fixes of the last horizon; for f, those from the prediction to its check.

The rule for f is quantile tracking, the proportional part of conformal PID control (Angelopoulos, Candes and Tibshirani
2023). With a constant gamma, the share of misses among T predictions differs from 5 % by at most the range of log f
over gamma T, whatever the mobile does and whatever sigma is. So a correct share proves little. A good band is also as
narrow as it can be: compare its `interval_score`, and its `coverage` under conditions that are known in advance.
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
from ._engine.columns import whitened
from ._engine.run import require_digits_of
from ._immutable import types_as_written
from .model import LinearModel, require_transition

__all__ = [
    "Coverage",
    "Expected",
    "ForecastErrors",
    "LiveBand",
    "ahead",
    "coverage",
    "following",
    "interval_score",
]

SHORTEST_MEMORY = 5  # fixes
# The share of the stated variance that is scaled by the recent innovations.
SCALED_SHARE = 0.8
# NIS / m is clipped at this value, so that one jump does not widen the band for the length of the memory.
MAX_NIS = 50.0
# A prediction is checked by the first fix after one horizon, if it comes within this many horizons.
LATEST_CHECK = 1.5
# Rounding of times that should be one horizon apart, in horizons.
TIME_ROUNDING = 1e-6
# With fewer independent predictions than this, `coverage` warns: the share of 30 has a standard deviation of 4 %.
ENOUGH = 30
# If the first fixes all come too late for a check, up to this many, the horizon is shorter than the steps.
MAX_UNCHECKED = 30
SUITABLE_HORIZON = "a horizon after which there are fixes, within 1 to 1.5 times its length"


@types_as_written
class ForecastErrors(NamedTuple):
    """Errors of K predictions, each of a fix some seconds later. Tracks follow one another along K.

    Attributes
    ----------
    made, due : ndarray (K,)
        Times of the prediction and of the fix that checks it, in s.
    errors, sigma : ndarray (K, m)
        Measured minus predicted, NaN where nothing was measured, and the standard deviation that the filter states.
    recent : ndarray (K,)
        The factor c when the prediction was made: the recent size of the innovations relative to the stated size.
    row, due_row, fixes : ndarray of int (K,)
        Rows of z of the prediction and of its fix, and the number of fixes from one to the other.
    track : ndarray of int (K,)
        The track.
    rests : ndarray of bool (K,)
        Whether the checking fix repeats the fix at which it was predicted.
    left_out : int
        Number of fixes without a later one within 1 to 1.5 horizons: those before a gap, and at the end.
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


@types_as_written
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


@types_as_written
class Expected(NamedTuple):
    """The expected measurement and its band.

    Attributes
    ----------
    position, half_width : ndarray (m,)
        The expected measurement, and the half-widths of the band around it.

    """

    position: Array
    half_width: Array


def ahead(estimator: Filter, z: ArrayLike, seconds: Seconds) -> ForecastErrors:
    """Return the forecast errors of a filter: each fix minus its prediction, made `seconds` earlier.

    Each prediction is checked by the first fix that is 1 to 1.5 times `seconds` later. Without times of its own, a
    filter has row 0 at 0 s.

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
        The errors, their times and their stated standard deviations.

    Raises
    ------
    ValueError
        For a model without a transition, for parts with times of their own, and for a horizon after which there are no
        fixes.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> kf = mpt.KalmanFilter(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1, x0=[0, 1]))
    >>> a = mpt.metrics.ahead(kf, [[1.1], [1.9], [np.nan], [4.0], [5.2]], seconds=2.0)
    >>> a.made, a.due, a.errors.ravel().round(2), a.sigma.ravel().round(2), a.left_out
    (array([0., 1.]), array([3., 3.]), array([-0.02,  0.04]), array([0.56, 0.53]), 2)

    """
    model = _model_with_transition(estimator)
    seconds = checks.duration("seconds", seconds)
    z, _ = estimator.as_tracks(z)
    x, P = estimator.estimates(z)
    N, m, M = z.shape
    t = np.broadcast_to(estimator.times_of(N).reshape(N, -1), (N, M))
    R = np.broadcast_to(estimator.epochs_of(z).noise(model.R), (N, m, m, M))
    tracks = []
    for c in range(M):
        of_track = (each[..., c] for each in (t, z, x, P, R))
        forecasts = _forecasts_of_track(model, estimator.P0, seconds, *of_track)
        tracks.append(forecasts | {"track": np.full(len(forecasts["made"]), c)})
    fields = {name: np.concatenate([each[name] for each in tracks]) for name in tracks[0]}
    K = len(fields["made"])
    if K == 0:
        checks.refuse("seconds", SUITABLE_HORIZON, f"{seconds:g}")
    left_out = int(np.isfinite(z).any(axis=1).sum()) - K
    return ForecastErrors(**fields, left_out=left_out, seconds=seconds)


def _forecasts_of_track(model, P0, seconds, t, z, x, P, R):
    """Return the arrays of ForecastErrors of one track by name."""
    fixes = np.flatnonzero(np.isfinite(z).any(axis=1))
    t_fix = t[fixes]
    checking = np.searchsorted(t_fix, t_fix + seconds * (1 - TIME_ROUNDING))
    later = np.append(t_fix, np.inf)[checking] - t_fix
    made = np.flatnonzero(later <= seconds * (LATEST_CHECK + TIME_ROUNDING))
    due = checking[made]
    row, due_row = fixes[made], fixes[due]
    expected, S = _predicted_measurement(model, x[row], P[row], later[made], R[due_row])
    return {
        "made": t[row],
        "due": t[due_row],
        "errors": z[due_row] - expected,
        "sigma": np.sqrt(np.diagonal(S, axis1=1, axis2=2)),
        "recent": _recent_sizes(model, P0, seconds, t, z, x, P, R, fixes)[made],
        "row": row,
        "due_row": due_row,
        "fixes": due - made,
        "rests": _repeats(z[due_row], z[row]),
    }


def _recent_sizes(model, P0, seconds, t, z, x, P, R, fixes):
    """Return c after each of the fixes (rows of z), from the innovations of a prediction from one row to the next."""
    x_before, P_before = np.vstack([model.x0, x])[fixes], np.concatenate([P0[None], P])[fixes]
    steps = np.diff(t, prepend=t[0] - model.dt)[fixes]
    expected, S = _predicted_measurement(model, x_before, P_before, steps, R[fixes])
    nis = _nis_per_number(z[fixes] - expected, S)
    in_horizon = np.arange(len(fixes)) - np.searchsorted(t[fixes], t[fixes] - seconds * (1 + TIME_ROUNDING))
    average, sizes = 1.0, np.empty(len(fixes))
    for k in range(len(fixes)):
        average = _updated_average(average, nis[k], in_horizon[k])
        sizes[k] = _recent_size(average)
    return sizes


def following(a: ForecastErrors, before: ForecastErrors | None = None, level: float = 0.95) -> Array:
    """Return the half-widths f c sigma of a band that adapts to its own past errors (see the module `bands`).

    The band of a prediction uses only those predictions of its track that were checked by the time it was made.

    Parameters
    ----------
    a : ForecastErrors
        The errors of `ahead`.
    before : ForecastErrors, optional
        Errors of an earlier segment with the same horizon, after which f continues. Without them f starts at the
        quantile of the normal distribution.
    level : float
        The share of the errors of each axis that the band is to hold, between 0 and 1.

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
    return _half_widths(a, _log_f_at_start(a.seconds, a.errors.shape[1], before, level), level)[0]


def _log_f_at_start(seconds, m, before, level):
    """Return log f of each axis at the start: its value after the errors `before`, if there are any."""
    normal = np.full(m, math.log(ndtri((1 + level) / 2)))
    if before is None:
        return normal
    checks.instance("before", before, ForecastErrors)
    if before.seconds != seconds or before.errors.shape[1] != m:
        got = f"{before.seconds:g} s and {before.errors.shape[1]} axes"
        checks.refuse("before", f"predictions of {seconds:g} s and {m} axes, as those that follow", got)
    return _half_widths(before, normal, level)[1]


def _half_widths(a, start, level):
    """Return the band (K, m) of tracks that start with log f = start (m,), and the mean of log f at their ends."""
    band, ends = np.empty_like(a.sigma), []
    for predictions in np.split(np.arange(len(a.track)), np.flatnonzero(np.diff(a.track)) + 1):
        log_f, checked = start, predictions[0]
        for k in predictions:
            while a.due_row[checked] <= a.row[k]:  # a prediction is due after it was made: it ends before k
                log_f = _log_f_after(log_f, a.errors[checked], band[checked], a.fixes[checked], a.rests[checked], level)
                checked += 1
            band[k] = np.exp(log_f) * a.recent[k] * a.sigma[k]
        for k in range(checked, predictions[-1] + 1):
            log_f = _log_f_after(log_f, a.errors[k], band[k], a.fixes[k], a.rests[k], level)
        ends.append(log_f)
    return band, np.mean(ends, axis=0)


def _log_f_after(log_f, error, half_width, fixes, rests, level):
    """Return log f (m,) after a check, `fixes` fixes after the prediction: higher after a miss, lower after a hit.

    While a prediction waits for its fix, no more checks come than the memory is long, so log f moves by 0.5 at most.
    """
    if rests:
        return log_f
    gamma = 0.5 / max(SHORTEST_MEMORY, fixes)
    missed = np.abs(error) > half_width
    return np.where(np.isnan(error), log_f, log_f + gamma * (missed - (1 - level)))


def _updated_average(average, nis, fixes):
    """Return the recent average of NIS / m with one more value; `fixes` counts the fixes of the horizon before it."""
    return average + (nis - average) / max(SHORTEST_MEMORY, fixes)


def _recent_size(average):
    """Return c from the recent average of NIS / m."""
    return math.sqrt(1 - SCALED_SHARE + SCALED_SHARE * average)


def _repeats(z, before):
    """Tell which measurements z (..., m) repeat the ones before them, to the last bit."""
    return ((z == before) | (np.isnan(z) & np.isnan(before))).all(axis=-1)


def _predicted_measurement(model, x, P, seconds, R):
    """Return mean (..., m) and covariance (..., m, m) of measurements some seconds (...) after x (..., n) and P.

    Raises a ValueError where rounding leaves no digits of the covariance.
    """
    F, Q = model.over(seconds)
    sigma = np.sqrt(np.diagonal(P, axis1=-2, axis2=-1))[..., None]
    size = (np.abs(model.H) @ np.abs(F) @ sigma)[..., 0] ** 2
    P = F @ P @ F.swapaxes(-1, -2) + Q
    x = (F @ x[..., None])[..., 0]
    S = model.H @ P @ model.H.T + R
    require_digits_of(np.diagonal(S, axis1=-2, axis2=-1), size)
    return x @ model.H.T, S


def _nis_per_number(innovations, S):
    """Return NIS / m of innovations (..., m), at most MAX_NIS, where m counts those that are there."""
    unit, _ = whitened(innovations.T, np.moveaxis(S, (-2, -1), (0, 1)))
    return np.minimum(np.square(unit).sum(axis=0) / np.isfinite(innovations).sum(axis=-1), MAX_NIS)


def _model_with_transition(estimator):
    """Return the model of a filter whose predictions some seconds ahead are known."""
    checks.instance("estimator", estimator, Filter)
    require_transition("estimator", estimator.model)
    if estimator.subfilters and any(each.t is not None or each.r is not None for each in estimator.elementary_filters):
        need = "a filter whose times and variances are its own, as a KalmanFilter of the stacked model"
        checks.refuse("estimator", need, f"a {type(estimator).__name__} of filters that have them")
    return estimator.model


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
        Which predictions to count; all where not given.

    Returns
    -------
    Coverage
        The share, its standard error and the number of independent predictions.

    Warns
    -----
    UserWarning
        If there are fewer than 30 independent predictions, and if errors are left out since their band is NaN.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> kf = mpt.KalmanFilter(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1))
    >>> a = mpt.metrics.ahead(kf, np.where(np.arange(64) == 60, 9.0, 0.0)[:, None], seconds=1.0)
    >>> mpt.metrics.coverage(a, mpt.metrics.following(a))  # one fix is 9 m off, and the filter with it for a while
    Coverage(share=array([0.96825397]), error=array([0.02894597]), independent=63)

    """
    band, judged = _checked_band("coverage", a, band, where)
    share = np.nanmean(np.where(judged, np.abs(a.errors) <= band, np.nan), axis=0)
    independent = np.array([_count_independent(a, of_axis) for of_axis in judged.T])
    fewest = int(independent.min())
    if fewest < ENOUGH:
        text = f"coverage: {fewest} independent predictions of {a.seconds:g} s are too few to judge a band by"
        checks.warn(f"{text}, which takes {ENOUGH}")
    near = (share * independent + 2) / (independent + 4)
    return Coverage(share, np.sqrt(near * (1 - near) / (independent + 4)), fewest)


def interval_score(a: ForecastErrors, band: ArrayLike, level: float = 0.95, where: ArrayLike | None = None) -> Array:
    """Return the mean interval score of a band on each axis: its width, plus a penalty for errors outside it.

        2 b + 2 / (1 - level) · max(|error| - b, 0),   with b the half-width

    Smaller is better; the true quantiles have the smallest (Gneiting and Raftery 2007, Eq. 43).

    Parameters
    ----------
    a, band, level, where : ForecastErrors, array_like, float, array_like
        As for `coverage`; level is the share of errors that the band is to hold, between 0 and 1.

    Returns
    -------
    ndarray (m,)
        The score of each axis, in the units of the errors.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> kf = mpt.KalmanFilter(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1))
    >>> a = mpt.metrics.ahead(kf, [[0.0], [0.5], [2.0]], seconds=1.0)
    >>> mpt.metrics.interval_score(a, np.ones((2, 1))).round(2)  # an error of 0.5 m, and one of 1.82 m that misses
    array([18.38])

    """
    band, judged = _checked_band("interval_score", a, band, where)
    missed_by = np.maximum(np.abs(a.errors) - band, 0)
    return np.nanmean(np.where(judged, 2 * band + 2 / (1 - checks.level(level)) * missed_by, np.nan), axis=0)


def _checked_band(name, a, band, where):
    """Return the band, and a mask (K, m) of the errors that count: measured, selected by `where`, with a half-width.

    `name` is the function that is called, for its warning.
    """
    checks.instance("a", a, ForecastErrors)
    need = f"half-widths of shape {a.errors.shape} that are not negative"
    band = checks.real_numbers("band", band, need, a.errors.shape)
    if (band < 0).any():
        checks.refuse("band", need, f"{np.nanmin(band):g}")
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


def _count_independent(a, where):
    """Return the number of predictions that do not overlap: each is made when the last counted one is due, or later."""
    count, end, track = 0, -np.inf, -1
    for made, due, of_track in zip(a.made[where], a.due[where], a.track[where], strict=True):
        if made >= end or of_track != track:
            count, end, track = count + 1, due, of_track
    return count


class LiveBand:
    """The band of `following`, fix by fix, for a filter that runs by `step`.

    It is for a measurement exactly `seconds` after a fix, with the variances of that fix. On uneven steps the band of
    `following` is wider, since the fix that checks a prediction may come later.

    Parameters
    ----------
    estimator, seconds : Filter, float or timedelta
        As for `ahead`.
    before, level : ForecastErrors, float
        As for `following`.

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
        self.model: LinearModel = _model_with_transition(estimator)
        self.seconds: float = checks.duration("seconds", seconds)
        self.level: float = checks.level(level)
        self._log_f: Array = _log_f_at_start(self.seconds, self.model.m, before, self.level)
        self.average: float = 1.0  # of the recent NIS / m
        # The estimate of the last call: time, x, P.
        self.last: tuple[float | None, Array, Array] = None, self.model.x0, estimator.P0
        self.times: deque[float] = deque()  # of the fixes within the last horizon
        # The predictions since the oldest one that waits for its fix: time, z, x, P, f c.
        self.pending: deque[tuple[Any, ...]] = deque()
        # The number of fixes that came too late for a check, until the first that did not; -inf after it.
        self.unchecked: float = 0 if before is None else -math.inf

    @property
    def factor(self) -> Array:
        """The factor f of each axis, (m,): near 1.96 while the filter's own band of 95 % holds 95 % of the errors."""
        return np.exp(self._log_f)

    def step(self, t: float, z: ArrayLike, x: ArrayLike, P: ArrayLike, r: ArrayLike | None = None) -> Expected:
        """Return the expected measurement `seconds` after t and its band.

        Parameters
        ----------
        t : float
            Time of this epoch in s.
        z : array_like (m,)
            The measurement at t, NaN where it is missing or was refused.
        x, P : array_like (n,), (n, n)
            The filter's estimate after this measurement, and its covariance.
        r : array_like (m,), optional
            Variances of the measurement; the model's R where not given.

        Returns
        -------
        Expected
            The expected measurement and the half-widths of the band.

        Raises
        ------
        ValueError
            For a time before the last one, and if the first 30 fixes all come too late to check a prediction.

        """
        t = checks.number("t", t, "a time in seconds", lambda _: True)
        z, seen = checks.one_measurement(z, self.model.m, "z")
        x, P = (each.copy() for each in checks.state(x, P, self.model.n))  # the caller may overwrite its arrays
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
        scale = self.factor * _recent_size(self.average)
        if seen.any():
            self.times.append(t)
            self.pending.append((t, z, x, P, scale))
        self.last = t, x, P
        expected, S = _predicted_measurement(self.model, x, P, self.seconds, R)
        return Expected(expected, scale * np.sqrt(np.diag(S)))

    def _check(self, t, z, R):
        """Update f with the predictions that are due at the fix z."""
        too_late = False
        while self.pending and t - self.pending[0][0] >= self.seconds * (1 - TIME_ROUNDING):
            made, z_made, x, P, scale = self.pending.popleft()
            if t - made > self.seconds * (LATEST_CHECK + TIME_ROUNDING):
                too_late = True
                continue
            self.unchecked = -math.inf
            expected, S = _predicted_measurement(self.model, x, P, t - made, R)
            half_width, fixes = scale * np.sqrt(np.diag(S)), len(self.pending) + 1
            self._log_f = _log_f_after(self._log_f, z - expected, half_width, fixes, _repeats(z, z_made), self.level)
        self.unchecked += too_late
        if self.unchecked == MAX_UNCHECKED:
            checks.refuse(
                "seconds", SUITABLE_HORIZON, f"{self.seconds:g}, and none of {MAX_UNCHECKED} fixes came so soon"
            )

    def _learn(self, t, z, R):
        """Update the average of the recent innovations with the fix z."""
        while self.times and self.times[0] < t - self.seconds * (1 + TIME_ROUNDING):
            self.times.popleft()
        last, x, P = self.last
        expected, S = _predicted_measurement(self.model, x, P, t - last, R)
        self.average = _updated_average(self.average, _nis_per_number(z - expected, S), len(self.times))
