"""The parameters of a model that make measurements most probable."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize
from tqdm import tqdm

from . import checks, metrics
from .filters import KalmanFilter
from .model import LinearModel
from .recursive import Filter

# How near, in natural logarithms of the parameters and in log L, the search must come: a hundredth of the error of a
# parameter that a thousand measurements tell to some percent.
NEAR = 1e-4
# A search that has ended looks further along each parameter, by these factors, as long as log L does not change: with
# a process noise far too small, the noise of the measurements explains the motion, and q changes nothing. It goes on
# from what is better, so many times at most.
FURTHER = tuple(math.log(factor) for factor in (3, 1e3, 1e6, 1e9, 1e12, 1e15, 1e18, 1e21, 1e24))
MOST_SEARCHES = 10
# Second differences of log L are taken between points 10 % of a parameter apart, two of these steps. Their rounding,
# 1e-16 |log L| / step², is below 1e-6 of them up to a million measurements, and their bias some step².
DIFFERENCE = 0.05
# A parameter that came this far from its start has no end in sight.
FARTHEST = math.log(1e12)
# A log L that falls by less than this says nothing against a parameter: so much it falls at one standard error.
NOTHING = 0.5
# A parameter known to no better than this factor is not known.
VAGUE = math.log(10)
# A direction in which log L curves by less than this part of its largest curvature is flat, by the second differences'
# rounding; and a parameter is known that it moves by less than this part of its length, by the end of the search.
FLAT, APART = 1e-6, 1e-2
# Squared distances from the start to the first measurement, in standard deviations: a fit is refused from the first on,
# and warned of from the second on, since it explains the distance by a wrong q.
ANOTHER_PLACE, FAR = 1e6, 100.0
# A start may have been explained by so large a noise that it seems near. Then it is still beyond three standard
# deviations, where one start in 370 is, and its square stands out from the usual ones, which are a thousandth of it.
SUSPECT, STANDS_OUT = 9.0, 1000.0


class Fit(NamedTuple):
    """The result of `fit`: values and standard errors of their natural logarithms, both by name, the filter, log L."""

    values: dict[str, float]
    log_errors: dict[str, float]
    filter: Filter
    log_likelihood: float


def fit(make: Callable[..., LinearModel | Filter], z: ArrayLike, **start: float) -> Fit:
    """Return the positive parameters that make measurements z most probable, jointly for all tracks.

    make(**values) returns a model, for a Kalman filter, or a filter; z is (N, m) or (N, m, M), NaN where missing; start
    has a first guess of each parameter by its name. The search (Nelder and Mead) runs on logarithms, looks further
    along each parameter where it ends, and shows its progress on a terminal. `log_errors` are the standard errors of
    the natural logarithms of the values, from second differences of log L: 0.1 stands for ten percent.

    Warns (UserWarning) where log L does not fall as a parameter goes to zero, where a direction is flat, and where the
    first measurements are far from the start of the model, so that the fit explains the distance as motion. Raises
    ValueError for guesses that are not positive, for no more measurements than parameters, for a Kalman filter whose
    start is far from the first measurement of a track, and where no guess has a likelihood; TypeError where make
    returns something else.

    >>> from mpt_helpers.model import constant_velocity, simulate
    >>> make = lambda q, r: constant_velocity(dt=1.0, q=q, r=r, P0=np.eye(2))
    >>> _, z = simulate(make(q=0.04, r=0.5), N=500, rng=np.random.default_rng(1))
    >>> found = fit(make, z, q=1.0, r=1.0)
    >>> {name: f"{value:.3f}" for name, value in found.values.items()}
    {'q': '0.035', 'r': '0.566'}
    """
    if not callable(make):
        checks.refuse("make", "a function that returns a model or a filter", type(make).__name__, TypeError)
    if not start:
        checks.refuse("start", "a first guess of at least one parameter", "none")
    guess = {name: checks.positive(name, value) for name, value in start.items()}
    count = int(np.isfinite(checks.real_numbers("z", z, "numbers")).sum())
    if count <= len(guess):
        checks.refuse("z", f"more measurements than parameters, of which there are {len(guess)}", count)
    estimator = _filter(make, guess)
    z = checks.measurements(z, estimator.model.m)
    _require_a_start_near(estimator, z)
    origin = np.log(list(guess.values()))

    def values_at(point):
        return dict(zip(guess, np.exp(point).tolist(), strict=True))

    def surprise(point):
        """Return -log L, infinite where the model cannot be computed."""
        if np.abs(point - origin).max() > FARTHEST:
            return math.inf
        try:
            return -float(np.sum(metrics.log_likelihood(_filter(make, values_at(point)), z)))
        except (ValueError, FloatingPointError):
            return math.inf

    if not math.isfinite(surprise(origin)):
        metrics.log_likelihood(_filter(make, guess), z)  # raises, and says why
        checks.refuse("start", "parameters under which z has a likelihood", guess)
    best = _lowest(surprise, origin)
    to_zero = [_runs_to_zero(surprise, origin, best, i) for i in range(len(best))]
    log_errors = _log_errors(surprise, best, np.flatnonzero(np.logical_not(to_zero)))
    log_errors = dict(zip(guess, log_errors.tolist(), strict=True))
    _warn_of_what_is_not_known(log_errors, dict(zip(guess, to_zero, strict=True)))
    found = _filter(make, values_at(best))
    _warn_of_a_start_that_is_far(found, z)
    return Fit(values_at(best), log_errors, found, -surprise(best))


def _filter(make, values):
    made = make(**values)
    if isinstance(made, LinearModel):
        return KalmanFilter(made)
    checks.instance("make", made, Filter)
    return made


def _lowest(function, origin):
    """Return the lowest point that is found from the origin."""
    with tqdm(desc="fit", unit=" filters", disable=None, leave=False) as bar:

        def counted(point):
            bar.update()
            return function(point)

        d, point = len(origin), origin
        for _ in range(MOST_SEARCHES):
            simplex = point + np.vstack([np.zeros(d), np.eye(d)])  # from each guess to e times it
            options = {"initial_simplex": simplex, "xatol": NEAR, "fatol": NEAR, "maxfev": 400 * d}
            found = minimize(counted, point, method="Nelder-Mead", options=options)
            point = _lower_further_on(counted, found)
            if point is None:
                break
        return found.x


def _lower_further_on(function, found):
    """Return a point along one parameter that is lower than what was found, or None."""
    for unit in np.eye(len(found.x)):
        for sign in (1, -1):
            for far in FURTHER:
                point = found.x + sign * far * unit
                change = function(point) - found.fun
                if change < -NOTHING:
                    return point
                if change > NOTHING:
                    break
    return None


def _second_differences(function, point):
    """Return the matrix of second derivatives of a function at a point, by central differences."""
    d, h = len(point), DIFFERENCE
    unit = h * np.eye(d)
    H = np.empty((d, d))
    for i in range(d):
        for j in range(i + 1):
            signs = [(1, 1), (1, -1), (-1, 1), (-1, -1)]
            H[i, j] = sum(a * b * function(point + a * unit[i] + b * unit[j]) for a, b in signs) / (4 * h**2)
            H[j, i] = H[i, j]
    return H


def _variances(H):
    """Return the diagonal of the inverse of a matrix (d, d), infinite for what a flat direction moves."""
    if not np.isfinite(H).all():
        return np.full(len(H), math.inf)
    curvatures, directions = np.linalg.eigh(H)
    flat = curvatures <= FLAT * max(curvatures[-1], 0)
    squares = directions**2
    variances = (squares[:, ~flat] / curvatures[~flat]).sum(axis=1)
    return np.where(squares[:, flat].sum(axis=1) > APART**2, math.inf, variances)


def _runs_to_zero(surprise, origin, best, i):
    """Tell whether log L falls by nothing as parameter i goes on towards zero."""
    lower = best.copy()
    lower[i] = max(best[i] - math.log(1000), origin[i] - FARTHEST)
    return surprise(lower) < surprise(best) + NOTHING


def _log_errors(surprise, best, known):
    """Return the standard errors of the logarithms of some parameters, the others as they are; theirs are infinite."""

    def of_known(point):
        moved = best.copy()
        moved[known] = point
        return surprise(moved)

    errors = np.full(len(best), math.inf)
    if len(known) == 0:
        return errors
    errors[known] = np.sqrt(_variances(_second_differences(of_known, best[known])))
    return errors


def _warn_of_what_is_not_known(log_errors, to_zero):
    for name, error in log_errors.items():
        if to_zero[name]:
            _warn(f"{name}: the likelihood does not fall as it goes to zero, so only an upper limit is known")
        elif error > VAGUE:
            _warn(f"{name}: the likelihood is flat, so z does not tell it, or not apart from the other parameters")


def _require_a_start_near(estimator, z):
    distance = _squared_distance_of_the_start(estimator, z)
    if distance > ANOTHER_PLACE:
        need = "a model whose x0 and P0 say where the tracks begin (x0 at the first measurement, or z - z[0])"
        checks.refuse("make", need, f"first measurements {math.sqrt(distance):.0f} standard deviations away")


def _warn_of_a_start_that_is_far(estimator, z):
    distance = _squared_distance_of_the_start(estimator, z)
    values, S = metrics.innovations(estimator, z)
    usual = float(np.nanmedian(values**2 / np.einsum("kjj...->kj...", S)))
    if distance > FAR or distance > max(SUSPECT, STANDS_OUT * usual):
        away = f"{math.sqrt(distance):.0f} standard deviations from what x0 and P0 expect"
        _warn(f"the first measurements are {away}: the fit explains the distance as motion or noise")


def _squared_distance_of_the_start(estimator: Filter, z: ArrayLike) -> float:
    """Return the largest squared distance of a first measurement from what x0 expects, over its variance by P0 and R.

    The motion's own noise does not count: it is what a fit would explain the distance by. Filters of other kinds than
    the Kalman filter are not looked at.
    """
    if not isinstance(estimator, KalmanFilter):
        return 0.0
    z = np.asarray(z, dtype=float).reshape(len(z), estimator.model.m, -1)
    seen = ~np.isnan(z)
    first = seen.any(axis=1).argmax(axis=0)  # of each track
    epochs, tracks = np.arange(len(z))[:, None, None], np.arange(len(first))
    quiet = replace(estimator.model, Q=np.zeros_like(estimator.model.Q))
    values, S = metrics.innovations(replace(estimator, model=quiet), np.where(epochs == first, z, np.nan))
    squares = values[first, :, tracks] ** 2 / np.einsum("Mjj->Mj", S[first, :, :, tracks])
    return float(np.max(squares, initial=0.0, where=seen[first, :, tracks]))


def _warn(text):
    warnings.warn(f"fit: {text}", UserWarning, stacklevel=4)
