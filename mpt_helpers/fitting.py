"""The parameters of a model that make measurements most probable, with their errors.

`search` finds the parameters, the maximum of log L. The errors are here, and the warnings of all that looks wrong. A
*point* is the vector of the natural logarithms of the parameters. In it, a distance is the logarithm of a factor.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri, stdtrit
from tqdm import tqdm

from . import _checks as checks
from . import bands, metrics
from ._base import Filter
from ._checks import Array, Seconds
from ._immutable import same
from .kalman import KalmanFilter
from .model import LinearModel
from .search import FARTHEST, FLAT, NOTHING, along_a_line, differences, lowest

# A search that has ended within this factor of FARTHEST would have gone on.
NEAR_THE_END = math.log(10)


class Fit(NamedTuple):
    """The result of `fit`.

    values: the parameters, by name
    log_errors: the standard errors of their natural logarithms, by name: 0.1 stands for ten percent
    filter: the filter with these values
    log_likelihood: log L
    errors_from: what the errors were made from, as "15 blocks of 300 fixes", "40 tracks" or "curvature"
    """

    values: dict[str, float]
    log_errors: dict[str, float]
    filter: Filter
    log_likelihood: float
    errors_from: str


def fit(make: Callable[..., LinearModel | Filter], z: ArrayLike, **start: float) -> Fit:
    """Return the positive parameters that make measurements z most probable, jointly for all tracks.

    make(**values) returns a model, for a Kalman filter, or a filter; z is (N, m) or (N, m, M), NaN where missing; start
    has a first guess of each parameter by its name. The search runs on logarithms and shows its progress on a terminal.
    Where all parameters scale Q and R alike, as q and r do, it goes along their ratio first; elsewhere, it is Nelder
    and Mead's. Newton's steps follow, and a look further along each parameter.

    Rows at steps of different lengths need a filter with times `t`. Nothing tells that they were forgotten: the mobile
    seems to move wildly, and q comes out a hundred times too large, and more.

    `log_errors` hold for the data as they are, and not only if the model is right (White 1982). No recorded track moves
    by one q: the curvature of log L alone, which takes the model for true, states errors five to twenty times too
    small there. So the score of each block of a track, by how much it pulls at the parameters, is computed, and the
    errors follow from how much the blocks differ. A track is cut into a block for every 300 s, 6 to 20 of them. Of
    several tracks each is cut into the same number of blocks, the smallest that makes as many in all; 20 tracks or more
    are a block each. With few blocks Student's factor makes the errors larger, so that 1.96 of them hold 95 %. With
    fewer than 12 fixes they are those of the curvature.

    Warns (UserWarning) where log L does not fall as a parameter goes to zero, where a direction is flat, where a value
    is so far from its guess that units may differ, of what `metrics.suspicious` finds, and where the first measurements
    are far from the start of the model, so that the fit explains the distance as motion. Raises
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
        near = _start_of_the_search(surprise, origin)
        best = lowest(surprise, origin, near)
        to_zero = [_runs_to_zero(surprise, best, i) for i in range(len(best))]
        blocks = _blocks(estimator, z)
        log_errors = _log_errors(surprise, best, np.flatnonzero(np.logical_not(to_zero)), blocks)
    log_errors = dict(zip(guess, log_errors.tolist(), strict=True))
    ended = np.abs(best - (origin if near is None else near)) > FARTHEST - NEAR_THE_END
    _warn_of_what_is_not_known(log_errors, dict(zip(guess, to_zero, strict=True)), dict(zip(guess, ended, strict=True)))
    found = surprise.filter_at(best)
    _warn_of_a_start_that_is_far(found, z)
    _warn_of_data(metrics.suspicious(found, z), surprise.values_at(best), log_errors, guess)
    return Fit(surprise.values_at(best), log_errors, found, -surprise(best), blocks.name)


class Blocks(NamedTuple):
    """The parts of tracks whose scores are taken as independent: the block of each row (N, M), how many, and a name."""

    of_rows: np.ndarray
    count: int
    name: str


# After so many rows for each state a start is forgotten, but for filters that smooth much.
ROWS_OF_A_START = 5
# Measurements that never change would make all variances zero.
LEAST_SCALE = 1e-9


@dataclass(frozen=True)
class Surprise:
    """-log L of measurements z as a function of a point, the natural logarithms of the parameters of `make`.

    Its values are kept: a search comes back to its points.
    """

    make: Callable[..., LinearModel | Filter]
    names: list[str]
    z: Array
    bar: tqdm
    computed: dict[bytes, float] = field(default_factory=dict)

    def __call__(self, point: Array) -> float:
        """Return -log L, infinite where the model cannot be computed."""
        key = point.tobytes()
        if key not in self.computed:
            self.computed[key] = self._at(point)
        return self.computed[key]

    def _at(self, point):
        try:
            self.bar.update()
            return -float(np.sum(metrics.log_likelihood(self.filter_at(point), self.z)))
        except (ValueError, FloatingPointError):
            return math.inf

    def by_block(self, point: Array, blocks: Blocks) -> Array:
        """Return the share of each block in -log L (B,), infinite where the model cannot be computed."""
        try:
            self.bar.update()
            squares, log_det, count = metrics.squares_of(self.filter_at(point), self.z)
        except (ValueError, FloatingPointError):
            return np.full(blocks.count, math.inf)
        terms = 0.5 * (squares + log_det + count * math.log(2 * math.pi))
        return np.bincount(blocks.of_rows.ravel(), terms.ravel(), blocks.count)

    def values_at(self, point: Array) -> dict[str, float]:
        """Return the parameters by name."""
        return dict(zip(self.names, np.exp(point).tolist(), strict=True))

    def filter_at(self, point: Array) -> Filter:
        """Return the filter with these parameters."""
        return _filter(self.make, self.values_at(point))

    def with_best_scale(self, point: Array) -> tuple[float, float]:
        """Return the log c that makes z most probable with c Q, c R and c P0, and -log L then: the profile likelihood.

        Gains and estimates stay as they are, all S become c S, and all NIS become NIS / c. So, for
        `count` numbers that were measured,

            -log L(c) = [Σ NIS / c + Σ log det S + count (log c + log 2π)] / 2

        Its derivative is zero at c = Σ NIS / count. There Σ NIS / c is `count`, and what is left is

            -log L = [Σ log det S + count (log c + 1 + log 2π)] / 2

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

    One parameter is its own line. Of two, as q and r, c times both give often c Q and c R. Then `with_best_scale` gives
    the best c for each ratio of the two, and the line is that of the ratios. With c P0 in place of P0 this is only
    nearly the likelihood. So c is computed anew whenever the search has come nearer, and the point found is but the
    start of a search of the likelihood itself.
    """
    if len(origin) == 1:
        return along_a_line(lambda point: (0.0, surprise(point)), origin, np.ones(1))
    if len(origin) > 2 or not _covariances_scale(surprise, origin):
        return None
    point = along_a_line(surprise.with_best_scale, origin, np.array([0.5, -0.5]))
    return point if math.isfinite(surprise(point)) and _covariances_scale(surprise, point) else None


def _covariances_scale(surprise, point):
    """Tell whether twice all parameters give a Kalman filter with twice Q and R, and else change nothing but P0."""
    one, two = (surprise.filter_at(each) for each in (point, point + math.log(2)))
    if not (isinstance(one, KalmanFilter) and isinstance(two, KalmanFilter)):
        return False
    alike = [(getattr(one.model, name), getattr(two.model, name)) for name in ("F", "H", "x0")]
    alike.append((2 * one.model.Q, two.model.Q))
    alike.append((2 * one.model.R, two.model.R) if one.r is None else (2 * one.r, two.r))
    twice = all(np.shape(a) == np.shape(b) and np.allclose(a, b, rtol=1e-9, atol=0, equal_nan=True) for a, b in alike)
    return twice and same(one.t, two.t) and (one.r is None) == (two.r is None)


# Errors come from so many blocks, of so many seconds where a track is long enough. Measured on recorded tracks: over
# 10 s scores are far from independent, over 300 s nearly, on tracks of hours over 600 to 1200 s.
FEWEST_BLOCKS, MOST_BLOCKS, SECONDS_OF_A_BLOCK = 6, 20, 300.0


def _blocks(estimator, z):
    """Return the Blocks of measurements z: in each track the same number of blocks, of equal numbers of fixes.

    Of M tracks each is cut into `parts`, the least number of them that makes `wanted` blocks in all or more.
    """
    N, _, M = z.reshape(len(z), z.shape[1], -1).shape
    seen = np.isfinite(z).any(axis=1).reshape(N, M)
    fixes = seen.sum()
    if fixes < 2 * FEWEST_BLOCKS:
        return Blocks(np.zeros((N, M), int), 1, "curvature")
    wanted = np.clip(fixes * _usual_step(estimator, seen) / SECONDS_OF_A_BLOCK, FEWEST_BLOCKS, MOST_BLOCKS)
    parts = math.ceil(wanted / M)
    before = np.cumsum(seen, axis=0) - seen  # the fixes of a track before each row, (N, M)
    part = before * parts // np.maximum(seen.sum(axis=0), 1)
    block = np.minimum(part, parts - 1) + parts * np.arange(M)  # numbered along the first track, then the second, ...
    _, of_rows = np.unique(np.where(seen, block, block[seen][0]), return_inverse=True)  # only those with a fix
    of_rows = of_rows.reshape(N, M)
    count = int(of_rows.max()) + 1
    return Blocks(of_rows, count, f"{count} tracks" if parts == 1 else f"{count} blocks of {fixes / count:.0f} fixes")


def _usual_step(estimator, seen):
    """Return the median step between fixes in seconds."""
    t = np.broadcast_to(estimator.times_of(len(seen)).reshape(len(seen), -1), seen.shape)
    steps = np.concatenate([np.diff(t_of_one[seen_of_one]) for t_of_one, seen_of_one in zip(t.T, seen.T, strict=True)])
    return float(np.median(steps)) if len(steps) else 0.0


# A parameter is known although a flat direction moves it, if it is by less than this part of the direction's length: so
# much comes from the end of the search.
APART = 1e-2


def _variances(H, J):
    """Return the diagonal of H⁻¹ J H⁻¹ (d,) for matrices (d, d), infinite for what a flat direction of H moves.

    H are the second derivatives of -log L, J is the covariance of its gradient: H itself if the model is right.
    """
    if not (np.isfinite(H).all() and np.isfinite(J).all()):
        return np.full(len(H), math.inf)
    curvatures, directions = np.linalg.eigh(H)
    flat = curvatures <= FLAT * max(curvatures[-1], 0)
    kept = directions[:, ~flat]
    inverse = kept / curvatures[~flat] @ kept.T
    moved = np.square(directions[:, flat]).sum(axis=1)
    return np.where(moved > APART**2, math.inf, np.diag(inverse @ J @ inverse))


def covariance_of_scores(scores: Array) -> Array:
    """Return J (d, d) from the scores of blocks (d, B), which sum to zero, with Student's factor for few blocks."""
    count = scores.shape[1]
    student = stdtrit(count - 1, 0.975) / ndtri(0.975)
    return student**2 * count / (count - 1) * scores @ scores.T


def _runs_to_zero(surprise, best, i):
    """Tell whether log L falls by nothing as parameter i goes on towards zero."""
    lower = best.copy()
    lower[i] -= math.log(1000)
    return surprise(lower) < surprise(best) + NOTHING


def _log_errors(surprise, best, known, blocks):
    """Return the standard errors of the logarithms of all parameters (d,), infinite but for those that are `known`.

    known are the indices of the parameters that are moved; the others stay at their best values. The errors are the
    roots of the diagonal of H⁻¹ J H⁻¹, the sandwich: H are the second derivatives of -log L, J the covariance of its
    gradient, as it shows in the scores of the blocks. Where the model is right, J is H, and the errors are the
    curvature's.
    """

    def of_known(point):
        moved = best.copy()
        moved[known] = point
        return surprise.by_block(moved, blocks)

    errors = np.full(len(best), math.inf)
    if len(known) == 0:
        return errors
    _, scores, H = differences(of_known, best[known])  # scores (d, B), H (d, d, B) of B blocks
    H = H.sum(axis=-1)
    J = H if blocks.count == 1 else covariance_of_scores(scores)
    errors[known] = np.sqrt(_variances(H, J))
    return errors


# A parameter so many times its guess, or less than that part of it, may be of other units: kilometres for metres make
# 1e-6 of q and r, milliseconds for seconds 1e-9 of q, degrees 1e-10 of both.
OTHER_UNITS = 1e5
# A parameter known to no better than this factor is not known.
VAGUE = math.log(10)


def _warn_of_data(suspicions, values, log_errors, guess):
    """Warn of what is wrong with z, and where a parameter lies so far from its guess that the units may differ."""
    for kind in ("far off", "same time"):
        if kind in suspicions:
            _warn(suspicions[kind])
    if "far off" in suspicions:  # then the values are those of one fix
        return
    for name, error in log_errors.items():
        times = values[name] / guess[name]
        if error < VAGUE and not 1 / OTHER_UNITS < times < OTHER_UNITS:
            units = "are z and t in the units of the guess (metres and seconds, not degrees, kilometres, milliseconds)?"
            _warn(f"{name}: {values[name]:.3g} is {times:.0e} times its guess: {units}")


def _warn_of_what_is_not_known(log_errors, to_zero, ended):
    for name, error in log_errors.items():
        if ended[name] and not to_zero[name]:
            _warn(
                f"{name}: the search ended {math.exp(FARTHEST):.0e} times its start away: give a guess that is nearer"
            )
        elif to_zero[name]:
            _warn(f"{name}: the likelihood does not fall as it goes to zero, so only an upper limit is known")
        elif error > VAGUE:
            _warn(f"{name}: the likelihood is flat, so z does not tell it, or not apart from the other parameters")


# Squared distances from the start to the first measurement, over the variance: a fit is refused from the first on, and
# warned of from the second on, since it explains the distance by a wrong q.
ANOTHER_PLACE, FAR = 1e6, 100.0
# A start may have been explained by so large a noise that it seems near. Then it is still beyond three standard
# deviations, where one start in 370 is, and its square stands out from the usual ones, which are a thousandth of it.
SUSPECT, STANDS_OUT = 9.0, 1000.0


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
    checks.warn(f"fit: {text}")


# Q is rescaled until the band changes by less than this, in logarithms of its variance, and so many times at most.
CLOSE, MOST_RESCALINGS = 1e-2, 50


def rescaled(estimator: KalmanFilter, z: ArrayLike, seconds: Seconds, level: float = 0.95) -> KalmanFilter:
    """Return the filter with Q times a factor under which the band that it states holds a share `level` of z.

    The likelihood judges by the next fix, and recorded tracks turn and stop more than it expects: ten seconds ahead,
    the fitted filter's own 95 % band is too narrow. Here the errors of `bands.ahead` decide, all axes together: the
    quantile of |error| / sigma becomes that of the normal distribution. R, and with it what is known of the noise,
    stays. Fit, rescale, and judge on what neither has seen; `bands.following` adapts further, and costs a call more.

    estimator is a Kalman filter that `bands.ahead` takes, z is (N, m) or (N, m, M), seconds is the horizon. Raises
    as `bands.ahead`, TypeError for another filter, and ValueError where no Q gives such a band: where the noise of
    the measurements alone, or a start that is not known, is more than the errors.

    >>> from mpt_helpers.model import constant_velocity, simulate
    >>> true = constant_velocity(dt=1.0, q=0.04, r=0.5, P0=np.eye(2))
    >>> _, z = simulate(true, N=1000, rng=np.random.default_rng(1))
    >>> kf = KalmanFilter(replace(true, Q=true.Q / 20))
    >>> bool(0.5 < rescaled(kf, z, seconds=10).model.Q[1, 1] / true.Q[1, 1] < 2)
    True
    """
    checks.instance("estimator", estimator, KalmanFilter)
    level = checks.level(level)
    normal = float(ndtri((1 + level) / 2))
    log_c = 0.0
    for _ in range(MOST_RESCALINGS):
        scaled = replace(estimator, model=replace(estimator.model, Q=math.exp(log_c) * estimator.model.Q))
        a = bands.ahead(scaled, z, seconds)
        reached = max(float(np.nanquantile(np.abs(a.errors / a.sigma), level)), LEAST_SCALE)
        change = 2 * math.log(reached / normal)
        if abs(change) < CLOSE:
            return scaled
        log_c += change
        if abs(log_c) > FARTHEST:
            break
    checks.refuse("estimator", "a filter whose process noise decides how wide its band is", "one where it does not")
