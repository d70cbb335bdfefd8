"""The parameters of a model that make measurements most probable."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize, minimize_scalar
from tqdm import tqdm

from . import checks, metrics
from .checks import Array
from .filters import KalmanFilter
from .model import LinearModel, same
from .recursive import Filter

# How near, in natural logarithms of the parameters, the search must come: a hundredth of the error of a parameter that
# a thousand measurements tell to some percent.
NEAR = 1e-4
# So near comes the search that needs no derivatives. Newton's, which goes on from there, needs no more.
NEAR_ENOUGH = 0.1
# A search along one line looks at these places first, natural logarithms of factors of 1e-12 to 1e12, then at those
# around the best one, and then between their neighbours: an r that the fixes tell by a little can be a factor of 100
# away from where it makes no difference.
LINE = math.log(1e3) * np.arange(-4, 5)
AROUND = math.log(10) * np.arange(-2, 3)
# After so many rows for each state a start is forgotten, but for filters that smooth much.
ROWS_OF_A_START = 5
# Measurements that never change would make all variances zero.
LEAST_SCALE = 1e-9
# Newton's steps are at most so long, a factor of e, and so many at most. Each is shortened so many times.
LONGEST, MOST_STEPS, MOST_HALVINGS = 1.0, 30, 8
# A search that has ended looks further along each parameter, by these factors, as long as log L does not change: with
# a process noise far too small, the noise of the measurements explains the motion, and q changes nothing. It goes on
# from what is better, so many times at most.
FURTHER = tuple(math.log(factor) for factor in (3, 1e3, 1e6, 1e9, 1e12, 1e15, 1e18, 1e21, 1e24))
MOST_SEARCHES = 10
# Differences of log L are taken between points 2 % of a parameter apart. The rounding of the second ones,
# 1e-16 |log L| / step², is below 1e-6 of them up to a million measurements. The bias of the first ones, step² / 6 of
# the third, moves the maximum by less than NEAR.
DIFFERENCE = 0.02
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
    with tqdm(desc="fit", unit=" filters", disable=None, leave=False) as bar:
        surprise = Surprise(make, list(guess), z, bar)
        origin = np.log(list(guess.values()))
        if not math.isfinite(surprise(origin)):
            metrics.log_likelihood(estimator, z)  # raises, and says why
            checks.refuse("start", "parameters under which z has a likelihood", guess)
        best = _lowest(surprise, origin, _start_of_the_search(surprise, origin))
        to_zero = [_runs_to_zero(surprise, best, i) for i in range(len(best))]
        log_errors = _log_errors(surprise, best, np.flatnonzero(np.logical_not(to_zero)))
    log_errors = dict(zip(guess, log_errors.tolist(), strict=True))
    _warn_of_what_is_not_known(log_errors, dict(zip(guess, to_zero, strict=True)))
    found = surprise.filter_at(best)
    _warn_of_a_start_that_is_far(found, z)
    return Fit(surprise.values_at(best), log_errors, found, -surprise(best))


@dataclass(frozen=True)
class Surprise:
    """-log L of measurements z as a function of a point, the natural logarithms of the parameters of `make`."""

    make: Callable[..., LinearModel | Filter]
    names: list[str]
    z: Array
    bar: tqdm

    def __call__(self, point: Array) -> float:
        """Return -log L, infinite where the model cannot be computed."""
        try:
            self.bar.update()
            return -float(np.sum(metrics.log_likelihood(self.filter_at(point), self.z)))
        except (ValueError, FloatingPointError):
            return math.inf

    def values_at(self, point: Array) -> dict[str, float]:
        """Return the parameters by name."""
        return dict(zip(self.names, np.exp(point).tolist(), strict=True))

    def filter_at(self, point: Array) -> Filter:
        """Return the filter with these parameters."""
        return _filter(self.make, self.values_at(point))

    def with_best_scale(self, point: Array) -> tuple[float, float]:
        """Return the log c that makes z most probable with c Q, c R and c P0, and -log L then.

        The first rows are left out: there P0 shows, which is not c P0.
        """
        first = min(ROWS_OF_A_START * self.filter_at(point).model.n, len(self.z) // 4)
        try:
            self.bar.update()
            squares, log_det, count = (each[first:].sum() for each in metrics.squares_of(self.filter_at(point), self.z))
        except (ValueError, FloatingPointError):
            return 0.0, math.inf
        if count == 0:
            return 0.0, math.inf
        log_c = math.log(max(squares / count, LEAST_SCALE))
        return log_c, 0.5 * float(log_det + count * (log_c + 1 + math.log(2 * math.pi)))


def _filter(make, values):
    made = make(**values)
    if isinstance(made, LinearModel):
        return KalmanFilter(made)
    checks.instance("make", made, Filter)
    return made


def _start_of_the_search(surprise, origin):
    """Return a point near the lowest one, by a search along one line, or None where there is no such line.

    With one parameter that is its own line. With two, as q and r, c times both give often c Q and c R. Then gains and
    estimates stay as they are, S becomes c S, and NIS becomes NIS / c, so that the best c is the mean of NIS / m. What
    is left is the ratio of the two. Only c P0 stands for P0 then. So the first rows are left out, c is taken anew
    whenever the search has come nearer, and the point is but the start of a search of the likelihood itself.
    """
    if len(origin) == 1:
        return _along_a_line(lambda point: (0.0, surprise(point)), origin, np.ones(1))
    if len(origin) > 2 or not _covariances_scale(surprise, origin):
        return None
    point = _along_a_line(surprise.with_best_scale, origin, np.array([0.5, -0.5]))
    return point if math.isfinite(surprise(point)) and _covariances_scale(surprise, point) else None


def _covariances_scale(surprise, point):
    """Tell whether twice all parameters give a Kalman filter with twice Q and R, and else change nothing but P0."""
    one, two = (surprise.filter_at(each) for each in (point, point + math.log(2)))
    if not (isinstance(one, KalmanFilter) and isinstance(two, KalmanFilter)):
        return False
    alike = [(getattr(one.model, name), getattr(two.model, name)) for name in ("F", "H", "x0")]
    alike += [(2 * getattr(one.model, name), getattr(two.model, name)) for name in ("Q", "R")]
    if not all(a.shape == b.shape and np.allclose(a, b, rtol=1e-9, atol=0) for a, b in alike):
        return False
    if one.r is not None and not (two.r is not None and np.allclose(2 * one.r, two.r, rtol=1e-9, equal_nan=True)):
        return False
    return same(one.t, two.t)


def _along_a_line(rated, origin, direction):
    """Return the lowest point origin + s direction that is found: the best of a few far apart, and then near it.

    rated(point) returns by how much all of it is to be moved, and the value there.
    """
    point = origin
    for places in (LINE, AROUND):
        points = [point + s * direction for s in places]
        moves, values = zip(*map(rated, points), strict=True)
        alike = np.array(values) <= min(values) + NOTHING  # where r makes no difference, say: then the nearest
        best = int(np.argmin(np.where(alike, np.abs(places), np.inf)))
        point = points[best] + moves[best]
    nearby = AROUND[1], AROUND[-2]
    options = {"xatol": NEAR_ENOUGH}
    found = minimize_scalar(lambda s: rated(point + s * direction)[1], bounds=nearby, method="bounded", options=options)
    moved = point + found.x * direction
    move, value = rated(moved)
    return moved + move if value < rated(point)[1] else point


def _lowest(function, origin, start):
    """Return the lowest point that is found from a start near it, or from the origin where that is None."""
    if start is not None:
        origin = start

    def within(point):
        return function(point) if np.abs(point - origin).max() <= FARTHEST else math.inf

    point = _by_simplex(within, origin) if start is None else start
    for _ in range(MOST_SEARCHES):
        point = _by_newton(within, point)
        further = _lower_further_on(within, point)
        if further is None:
            break
        point = _by_simplex(within, further)
    return point


def _by_simplex(function, point):
    """Return the lowest point that Nelder and Mead's search finds, from each guess to e times it."""
    d = len(point)
    simplex = point + np.vstack([np.zeros(d), np.eye(d)])
    options = {"initial_simplex": simplex, "xatol": NEAR_ENOUGH, "fatol": NEAR_ENOUGH, "maxfev": 400 * d}
    return minimize(function, point, method="Nelder-Mead", options=options).x


def _by_newton(function, point):
    """Return the lowest point that Newton's steps lead to. A direction that is flat is not gone along."""
    for _ in range(MOST_STEPS):
        value, gradient, H = _differences(function, point)
        step = _newton_step(gradient, H)
        for _ in range(MOST_HALVINGS):
            if np.abs(step).max() < NEAR:
                return point
            if function(point + step) < value:
                break
            step = step / 2
        else:
            return point
        point = point + step
    return point


def _newton_step(gradient, H):
    """Return the step to where the gradient vanishes, downwards where H curves the other way, and not too long."""
    if not (np.isfinite(H).all() and np.isfinite(gradient).all()):
        return np.zeros(len(H))
    curvatures, directions = np.linalg.eigh(H)
    sizes = np.abs(curvatures)
    bent = sizes > FLAT * sizes.max()
    along = directions.T @ gradient
    step = -directions[:, bent] @ (along[bent] / sizes[bent])
    return step * min(1.0, LONGEST / max(np.abs(step).max(), NEAR))


def _lower_further_on(function, point):
    """Return a point along one parameter that is lower than this one, or None."""
    value = function(point)
    for unit in np.eye(len(point)):
        for sign in (1, -1):
            for far in FURTHER:
                moved = point + sign * far * unit
                change = function(moved) - value
                if change < -NOTHING:
                    return moved
                if change > NOTHING:
                    break
    return None


def _differences(function, point):
    """Return a function, its gradient and its second derivatives at a point, by central differences."""
    d, h = len(point), DIFFERENCE
    unit = h * np.eye(d)
    here = function(point)
    up = np.array([function(point + each) for each in unit])
    down = np.array([function(point - each) for each in unit])
    with np.errstate(invalid="ignore"):  # beside points that have no likelihood
        H = np.diag((up - 2 * here + down) / h**2)
        for i in range(d):
            for j in range(i):
                both = function(point + unit[i] + unit[j]) + function(point - unit[i] - unit[j])
                H[i, j] = H[j, i] = (both + 2 * here - up[i] - up[j] - down[i] - down[j]) / (2 * h**2)
        return here, (up - down) / (2 * h), H


def _variances(H):
    """Return the diagonal of the inverse of a matrix (d, d), infinite for what a flat direction moves."""
    if not np.isfinite(H).all():
        return np.full(len(H), math.inf)
    curvatures, directions = np.linalg.eigh(H)
    flat = curvatures <= FLAT * max(curvatures[-1], 0)
    squares = directions**2
    variances = (squares[:, ~flat] / curvatures[~flat]).sum(axis=1)
    return np.where(squares[:, flat].sum(axis=1) > APART**2, math.inf, variances)


def _runs_to_zero(surprise, best, i):
    """Tell whether log L falls by nothing as parameter i goes on towards zero."""
    lower = best.copy()
    lower[i] -= math.log(1000)
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
    errors[known] = np.sqrt(_variances(_differences(of_known, best[known])[2]))
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
