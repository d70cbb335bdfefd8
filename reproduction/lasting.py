"""Errors that last: a model that has them, and their size and duration from fixes at rest."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag
from scipy.special import chdtri

from mpt_helpers import _checks as checks
from mpt_helpers._base import Filter
from mpt_helpers._checks import Array, Seconds
from mpt_helpers.fitting import fit
from mpt_helpers.metrics import log_likelihood
from mpt_helpers.model import LinearModel

MOST_ROWS = 1500  # of a log that is fitted: a day, one a minute; more tell little of what lasts and take longer
PARAMETERS = ("r", "sigma", "tau")
UNKNOWN = 0.5  # a standard error of log tau: from there on its span of 95 % covers a factor of e², seven
LEAST_FIXES = 100  # a log of fewer says nothing of three unknowns
# An error that lasts is seen where it makes the log e³ = 20 times as probable: of logs of independent errors some 2 in
# 100 become so by chance.
SEEN = 3.0
# Means over so many tau, of which there are so many or more, scatter as the fit says but once in a thousand times.
SLOW, FEWEST_MEANS, UNLIKELY = 10, 5, 1e-3
STILL = LinearModel(F=[[1.0]], H=[[1.0]], Q=[[0.0]], R=[[1.0]])  # a position at rest, for the shapes of its fixes


def lasting_error(
    model: LinearModel, sigma: ArrayLike, tau: ArrayLike | Seconds, dt: Seconds | None = None
) -> LinearModel:
    """Return `model` with one more state for each measurement: an error that fades slowly (Gauss-Markov, first order).

        e(k+1) = a e(k) + w(k),   a = exp(-dt / tau),   w ~ N(0, sigma² (1 - a²)),   e(0) ~ N(0, sigma²)
        z(k)   = H x(k) + e(k) + v(k)

    The new states follow those of the model, one for each row of H, and R stays the noise of one measurement. sigma is
    the standard deviation of the lasting error, in the units of the measurement, tau the time in seconds after which
    its correlation has fallen to 1/e; both are a number, or one for each measurement, and tau may be a timedelta. dt is
    the time step in seconds, of a model that does not say it itself. All steps share it: a filter that is given times
    refuses such a model.

    A filter of this model cannot take the lasting error off a position that it knows from the same measurements. What
    changes is what it states: the error of the position does not fall below what lasts.

    Raises ValueError for sigma < 0, tau <= 0, another number of them, and a dt that is not positive, that is missing,
    or that is not the model's own; TypeError for anything but a model.

    >>> from mpt_helpers.model import constant_velocity
    >>> axis = constant_velocity(dt=30.0, q=0.0, r=0.04)
    >>> model = lasting_error(axis, sigma=1.0, tau=3600.0)
    >>> model.H
    array([[1., 0., 1.]])
    >>> model.F[2, 2].round(4), model.Q[2, 2].round(4), model.P0[2, 2]
    (np.float64(0.9917), np.float64(0.0165), np.float64(1.0))
    """
    checks.instance("model", model, LinearModel)
    variance = _of_each("sigma", sigma, model.m, checks.not_negative) ** 2
    a = np.exp(-_step_of(model, dt) / _of_each("tau", checks.as_seconds(tau), model.m, checks.positive))
    return LinearModel(
        F=block_diag(model.F, np.diag(a)),
        H=np.hstack([model.H, np.eye(model.m)]),
        Q=block_diag(model.Q, np.diag(variance * (1 - a**2))),
        R=model.R,
        x0=np.append(model.x0, np.zeros(model.m)),
        P0=block_diag(model.P0, np.diag(variance)),
    )


def _step_of(model, dt):
    """Return the time step of a model in seconds: its own, or dt where it has none, or raise."""
    if dt is None and model.dt is None:
        checks.refuse("dt", "the time step in seconds, which this model does not say", "none")
    step = checks.duration("dt", model.dt if dt is None else dt)
    if model.dt not in (None, step):
        checks.refuse("dt", f"the model's own time step, {model.dt:g} s", f"{step:g} s")
    return step


def _of_each(name, value, m, accept):
    """Return a number for each of m measurements, (m,), from one number or from m of them, or raise."""
    values = checks.real_numbers(name, value, f"a number, or {m} numbers")
    if values.shape not in ((), (m,)):
        checks.refuse(name, f"a number, or {m} numbers", f"shape {values.shape}")
    return np.array([accept(name, each) for each in np.broadcast_to(values, (m,)).tolist()])


class LastingFit(NamedTuple):
    """The errors that logs of fixes at rest tell: the result of `fit_lasting`, one number for each of m axes.

    r (m²) is the variance of what is new at each fix, sigma (m) the size of what lasts, tau (s) the time in which its
    correlation falls to 1/e. known has {"r", "sigma", "tau"}: (m, 2) each, from where to where 95 % of such estimates
    lie. floor (m) is the size of what lasts in the worst half of the worst log. halves (2, m, 3) are r, sigma and
    tau of both halves of the log, or of the logs, each fitted apart.

    On an axis on which no error that lasts is seen, r is the variance of the fixes, sigma is 0, tau one step, and the
    floor 0: none is known. known["sigma"] then goes from 0 to the largest sigma that would not have been seen.
    """

    r: np.ndarray
    sigma: np.ndarray
    tau: np.ndarray
    known: dict[str, np.ndarray]
    floor: np.ndarray
    halves: np.ndarray


def fit_lasting(*logs: tuple[ArrayLike, ArrayLike]) -> LastingFit:
    """Return r, sigma and tau of `lasting_error`, and a floor, from fixes of a receiver that did not move.

    A log is a pair (t, z): times (N,) in seconds, at one step, and positions (N,) or (N, m) in metres, about any
    point; missing fixes are left out, or NaN. Days may be given one by one, `fit_lasting(day1, day2)`: they share r,
    sigma and tau, and each has its own unknown mean. No true position is needed: the three are those that make the
    fixes most probable (`fit`), one axis after the other. Of a log of more than 1,500 steps, gaps counted, every second
    or third step is taken, or fewer: give parts that are far apart as logs of their own.

    What lasts is larger in some hours than in others, and fades differently. So `known` is the wider of two spans: the
    one of `fit`, by how much blocks of a log differ, and the one between the halves of the log (of several logs,
    between the first and the last of them), each fitted apart. Where a standard error of log tau is above 0.5, the logs
    do not determine it: a UserWarning gives the span, and asks for more days. Where an error that lasts makes the logs
    less than 20 times as probable as independent errors do, it is not seen, and more days of the same would hardly
    help: a UserWarning says how large it may be unseen, if it lasts for ten steps to a tenth of the log. Where means
    over ten tau scatter more than the fit says, a slower error is there beside the quick one: a UserWarning says so.

    The floor is the root of the mean square about the log's mean less r, in the worst half of a log: a filter should
    state no less. Where nothing is seen, it is 0. A constant error is in no number here: it looks like another
    position. To a floor add that of your receiver, in squares.

    Raises ValueError for a log of fewer than 100 fixes on an axis, or of which so few are left where every second step
    or fewer is taken, for times that do not increase or have no common step, and for logs that differ in step or axes.

    >>> from mpt_helpers.model import LinearModel, simulate
    >>> still = LinearModel(F=[[1]], H=[[1]], Q=[[0]], R=[[0.25]])
    >>> _, z = simulate(lasting_error(still, sigma=1.0, tau=600.0, dt=30.0), 2880, np.random.default_rng(1))
    >>> found = fit_lasting((30.0 * np.arange(2880), z))
    >>> [float(each[0].round(1)) for each in (found.r, found.sigma, found.tau / 60, found.floor)]
    [0.3, 0.9, 10.2, 0.9]
    >>> (found.known["tau"][0] / 60).round().tolist()
    [7.0, 16.0]
    """
    if not logs:
        checks.refuse("logs", "at least one pair (t, z)", "none")
    grids = [_on_a_grid(log) for log in logs]
    steps, axes = [step for step, _ in grids], {z.shape[1] for _, z in grids}
    if max(steps) > 1.01 * min(steps) or len(axes) > 1:
        got = f"steps of {min(steps):g} to {max(steps):g} s and {', '.join(map(str, sorted(axes)))} axes"
        checks.refuse("logs", "one step and one number of axes", got)
    every = math.ceil(max(len(z) for _, z in grids) / MOST_ROWS)
    step = every * steps[0]
    least = min(_fixes_on_an_axis(z[::every]) for _, z in grids)
    if least < LEAST_FIXES:
        need = f"at least {LEAST_FIXES} fixes on each axis where 1 of {every} steps is taken"
        checks.refuse("log", need, f"{least}; give parts that are far apart as logs of their own")
    centred = [z - np.nanmean(z, axis=0) for _, z in grids]
    thinned = np.full((max(len(z[::every]) for z in centred), len(centred), axes.pop()), np.nan)
    for j, z in enumerate(centred):
        thinned[: len(z[::every]), j] = z[::every]
    values, spans, floors, halves = [], [], [], []
    for axis in range(thinned.shape[2]):
        rows = thinned[:, None, :, axis]
        best, errors = _fit_axis(rows, step)
        if not _is_seen(rows, step, best):
            best, span, apart = _unseen(rows, step, axis)
            floor = 0.0
        else:
            apart = _fit_halves(rows, step)
            errors = np.maximum(errors, np.abs(np.log(apart[0] / apart[1])) / 2)  # half the distance of two halves
            with np.errstate(over="ignore"):
                span = best * np.exp(np.multiply.outer([-1.96, 1.96], errors))
            floor = max(_of_lasting(half[:, axis], best[0]) for z in centred for half in np.array_split(z, 2))
            _warn_of_slower_errors([z[:, axis] for z in centred], steps[0], best, axis)
            if errors[2] > UNKNOWN:
                said = _span_in_words(span[:, 2], step, step * len(rows))
                checks.warn(f"fit_lasting: axis {axis}: tau is {said}, which the logs do not determine: give more days")
        for kept, new in zip((values, spans, floors, halves), (best, span, floor, apart), strict=True):
            kept.append(new)
    r, sigma, tau = np.transpose(values)
    known = dict(zip(PARAMETERS, np.transpose(spans, (2, 0, 1)), strict=True))
    return LastingFit(r, sigma, tau, known, np.array(floors), np.swapaxes(halves, 0, 1))


def _warn_of_slower_errors(logs, step, best, axis):
    """Warn where means of ten tau scatter more than r, sigma and tau say: a slower error is there beside a quick one.

    The mean of n fixes over T seconds has a variance of r / n + 2 sigma² (tau / T - (tau / T)² (1 - exp(-T / tau))).
    """
    r, sigma, tau = best
    n = max(math.ceil(SLOW * tau / step), 2)
    means = [
        np.nanmean(part) for z in logs for part in np.split(z, range(n, len(z), n)) if np.isfinite(part).sum() > n / 2
    ]
    part = tau / (n * step)
    expected = r / n + 2 * sigma**2 * (part - part**2 * -math.expm1(-1 / part))
    free = len(means) - len(logs)
    found = float(np.sum(np.square(means))) / max(free, 1)
    if free >= FEWEST_MEANS and found > expected * chdtri(free, UNLIKELY) / free:
        scatter = f"scatter by {math.sqrt(found):.2g} m, not by {math.sqrt(expected):.2g} m as fitted"
        slower = "a slower error is there too; give the means as a log of their own"
        checks.warn(f"fit_lasting: axis {axis}: means over {_in_words(n * step)} {scatter}: {slower}")


def _span_in_words(span, step, length):
    """Return from where to where tau lies, in words where it is shorter than a step or longer than the log (s)."""
    low, high = span
    first = f"less than a step of {_in_words(step)}" if low < step else _in_words(low)
    return f"{first} to " + (f"more than the {_in_words(length)} of the log" if high > length else _in_words(high))


def _in_words(seconds):
    """Return a time as a text.

    >>> _in_words(90.0), _in_words(1800.0)
    ('90 s', '30 min')
    """
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"


def _halves(z):
    """Return two halves of logs (N, 1, M): of one log its rows, of several the first and the last of them."""
    return np.array_split(z, 2, axis=2 if z.shape[2] > 1 else 0)


def _fit_halves(z, step):
    """Return r, sigma and tau of both halves of logs (N, 1, M) of one axis, each fitted apart, (2, 3)."""
    return np.array([_fit_axis(half, step)[0] for half in _halves(z)])


def _is_seen(z, step, best):
    """Tell whether logs (N, 1, M) of one axis show an error that lasts, with r, sigma and tau as fitted."""
    independent = _log_likelihood(z, step, float(np.nanvar(z)), 0.0, step)
    return _log_likelihood(z, step, *best) > independent + SEEN


def _unseen(z, step, axis):
    """Return r, sigma and tau (3,), their spans (2, 3) and those of two halves (2, 3) of independent errors, and warn.

    The largest sigma that may be there unseen is the largest that the logs find no less probable than two standard
    errors would, e^-2, beside independent errors, for a tau of ten steps to a tenth of the log.
    """
    variance = float(np.nanvar(z))
    taus = step * np.geomspace(10, len(z) / 10, 3)
    independent = _log_likelihood(z, step, variance, 0.0, step)
    largest = 0.0
    for sigma in math.sqrt(variance) * np.geomspace(0.02, 3, 30):
        shares = variance, max(variance - sigma**2, variance / 10)  # the log's mean takes a part of what lasts along
        if max(_log_likelihood(z, step, r, sigma, tau) for r in shares for tau in taus) > independent - 2:
            largest = float(sigma)
    checks.warn(
        f"fit_lasting: axis {axis}: no error that lasts is seen: the errors look independent, sigma is below about "
        f"{largest:.2g} m for a tau of {_in_words(taus[0])} to {_in_words(taus[-1])}"
    )
    error = 1.96 * math.sqrt(2 / np.isfinite(z).sum())
    span = [[variance * math.exp(-error), 0.0, 0.0], [variance * math.exp(error), largest, math.inf]]
    halves = [[float(np.nanvar(half)), 0.0, step] for half in _halves(z)]
    return np.array([variance, 0.0, step]), np.array(span), np.array(halves)


def _log_likelihood(z, step, r, sigma, tau):
    """Return the logarithm of the probability density of logs (N, 1, M) at rest, all together."""
    return float(np.sum(log_likelihood(_at_rest(float(np.nanvar(z)), step, r, sigma, tau), z)))


def _at_rest(variance, step, r, sigma, tau):
    """Return the filter of a receiver at rest with an error that lasts, whose fixes have such a variance (m²)."""
    return _AtRest(unknown=10 * variance, noise=r, lasting=sigma**2, fade=math.exp(-step / tau))


def _fit_axis(z, step):
    """Return r, sigma and tau of a receiver at rest, (3,), and standard errors of their logarithms, (3,)."""
    variance = float(np.nanvar(z))

    def make(r, sigma, tau):
        return _at_rest(variance, step, r, sigma, tau)

    new = float(np.nanmean(np.square(np.diff(z, axis=0)))) / 2
    start = {"r": max(new, 0.01 * variance), "sigma": math.sqrt(variance), "tau": 60 * step}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # what is not known is told by fit_lasting
        found = fit(make, z, **start)
    return tuple(np.array([each[name] for name in PARAMETERS]) for each in (found.values, found.log_errors))


@dataclass(frozen=True, eq=False)
class _AtRest(Filter):
    """The Kalman filter of `lasting_error` for a position at rest, without matrices: a fit runs it 400 times.

    Its covariance never settles, so that a general filter computes each step with small matrices, ten times as slowly.
    unknown, noise and lasting are variances: of the position at the start, of a fix and of what lasts; fade is the part
    of what lasts that a step leaves.
    """

    unknown: float
    noise: float
    lasting: float
    fade: float
    model: LinearModel = STILL

    def innovations_of(self, z: Array) -> tuple[Array, Array]:
        """Return the innovations of logs z (N, 1, M), NaN where z has NaN, and their variances (N, 1, 1, M)."""
        values, S = np.transpose([self._innovations_of_one(log.tolist()) for log in z[:, 0].T], (1, 2, 0))
        return values[:, None], S[:, None, None]

    def _innovations_of_one(self, z):
        """Return the innovations of one log, a list of N numbers, and their variances."""
        fade, r, added = self.fade, self.noise, self.lasting * (1 - self.fade**2)
        p, both, e = self.unknown, 0.0, self.lasting  # variance of the position, covariance, variance of what lasts
        position = lasting = 0.0
        values, variances = [], []
        for z_k in z:
            lasting, both, e = fade * lasting, fade * both, fade * fade * e + added
            new, S = z_k - position - lasting, p + 2 * both + e + r
            values.append(new)
            variances.append(S)
            if new == new:  # not NaN
                with_p, with_e = p + both, both + e  # covariances of the innovation with both states
                K_p, K_e = with_p / S, with_e / S
                position += K_p * new
                lasting += K_e * new
                p -= K_p * with_p
                both -= K_p * with_e
                e -= K_e * with_e
        return values, variances


def _of_lasting(errors, r):
    """Return the size of what lasts in errors (N,) of which r (m²) is new at each fix, 0 where that explains them."""
    return math.sqrt(max(float(np.nanmean(np.square(errors))) - r, 0.0))


def _on_a_grid(log):
    """Return the step of a log (t, z) in seconds and its positions (N, m), a row for each step, or raise."""
    try:
        t, z = log
    except (TypeError, ValueError):
        checks.refuse("log", "a pair (t, z)", type(log).__name__, TypeError)
    t, z = checks.real_numbers("t", t, "times in seconds"), checks.real_numbers("z", z, "positions in metres")
    z = z[:, None] if z.ndim == 1 else z
    if t.ndim != 1 or z.ndim != 2 or z.shape[1] == 0 or len(t) != len(z):
        checks.refuse("log", "times (N,) and positions (N,) or (N, m)", f"shapes {t.shape} and {z.shape}")
    checks.no_infinity(z)
    if not np.isfinite(t).all():
        checks.refuse("t", "a time of each fix", "nan or infinity")
    if np.abs(t).max() > checks.LATEST_TIME:
        checks.refuse("t", "times in seconds", f"{np.abs(t).max():.15g}, as of Unix milli-, micro- or nanoseconds")
    if _fixes_on_an_axis(z) < LEAST_FIXES:
        checks.refuse("log", f"at least {LEAST_FIXES} fixes on each axis", _fixes_on_an_axis(z))
    if (np.nanmax(z, axis=0) == np.nanmin(z, axis=0)).any():
        checks.refuse("z", "positions that differ, by their errors", "one position in all fixes of an axis")
    gaps = np.diff(t)
    if not (gaps > 0).all():
        checks.refuse("t", "times that increase", f"{t[gaps.argmin()]:g} and then {t[gaps.argmin() + 1]:g}")
    step = float(np.median(gaps))
    row = np.round((t - t[0]) / step).astype(int)
    if (np.diff(row) == 0).any():
        k = int(np.flatnonzero(np.diff(row) == 0)[0])
        checks.refuse("t", f"times at one step, here {step:g} s", f"{t[k]:g} and {t[k + 1]:g}")
    rows = np.full((row[-1] + 1, z.shape[1]), np.nan)
    rows[row] = z
    return step, rows


def _fixes_on_an_axis(z):
    """Return the number of fixes on the axis of z (N, m) that has the fewest."""
    return int(np.isfinite(z).sum(axis=0).min())
