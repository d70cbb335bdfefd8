"""The q and r of a recorded track, fitted to its segments in sequence, which a filter treats as one track."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import _checks as checks
from .. import fitting, metrics
from .._checks import Array
from .._immutable import types_as_written
from ..kalman import KalmanFilter
from ..model import constant_velocity, stack
from ..search import AROUND, SIGNIFICANT, line_search

# Segments are put an hour or more apart, so that the filter learns nothing about one from another. In T seconds without
# a fix the variance of the velocity grows by q T, which must reach the square of FORGOTTEN usual speeds. That of the
# position grows by q T³ / 3, which must stay below HELD times r for double precision.
HOUR_BETWEEN, FORGOTTEN, HELD = 3600.0, 8, 1e20
# The initial speed is known to at most so many sigmas of a fix per step: `smooth` has no digits beside a vaguer one.
VAGUEST_SPEED = 1e7
# Limits of log(r / q), with r / q in units of the median step cubed (s³); the points of the global search; and the
# tolerance of log(r / q).
RATIOS = math.log(1e-8), math.log(1e6)
ALL_OVER = math.log(100) * np.arange(-3.5, 4)
RATIO_FOUND = 0.02
# Fixes are sparse if r < SPARSE q step³: the motion between two of them is as uncertain as a fix. Then smoothing gains
# little, and r follows from small details of a model that real motion does not keep to.
SPARSE = 0.5
# If the model explains the fixes, their innovations are uncorrelated; where r is too large, they are correlated
# negatively. The sum of squares of the negative ones at LAGS 1 to 4 may be MOST_NEGATIVE of sparse and of other fixes.
# On eleven recorded tracks, thinned and with noise of 3 m, it was mostly below 0.02 while r was right, and 0.02 to 0.12
# where the line was worse than the fixes. By chance it is 2 / n of n numbers, rarely 8 / n: so a few sparse fixes never
# tell r, and a few dense ones nothing against it.
LAGS, MOST_NEGATIVE, BY_CHANCE, CLIPPED = 4, (0.02, 0.06), (2.0, 8.0), 3.0
# Differences of order k of white noise have binom(2k, k) times its variance, and motion only adds to it: the least of
# these orders is an upper limit of r.
ORDERS = range(1, 9)
# The upper limit of the standard deviation (m) below which a recorder has smoothed its fixes, and that of a receiver in
# the open, which is assumed if the fixes tell nothing of theirs.
SMOOTHED, USUAL = 0.5, 3.0
# A robust measure of size: the value that a tenth of the numbers exceed. Of squared normal numbers it is 2.7055 times
# their variance.
TENTH, OF_TENTH = 0.9, 2.7055


@types_as_written
class Noise(NamedTuple):
    """q (m²/s³) and r (m²), the same for all axes.

    rounding: whether r is the variance of the rounding of the numbers, its lower bound
    assumed: whether r is only assumed, since the motion hides it
    """

    q: float
    r: float
    rounding: bool
    assumed: bool = False


@types_as_written
class Scale(NamedTuple):
    """Typical sizes of a track.

    step: the median time between fixes (s); speed: the speed that a tenth of the steps exceed (m/s)
    rounding: the variance of the rounding of the numbers (m²), a lower bound for that of a fix
    """

    step: float
    speed: float
    rounding: float


def scale_of(t: Array, z: Array, rounding: float, begin: NDArray[np.bool_] | None = None) -> Scale:
    """Return the Scale of a track, faults included; `begin` (N,) marks the rows where a recording begins."""
    rows, recording = _whole_fixes(z, begin)
    seconds, moved = np.diff(t[rows]), np.linalg.norm(np.diff(z[rows], axis=0), axis=1)
    inside = (seconds > 0) & (np.diff(recording) == 0)
    speeds = moved[inside] / seconds[inside]
    if not (speeds > 0).any():
        checks.refuse("z", "a track that moves", "one that stands still within each recording")
    speed = float(np.quantile(speeds, TENTH)) or float(speeds[speeds > 0].mean())  # nine tenths may be a rest
    return Scale(float(np.median(seconds[inside])), speed, max(rounding, (1e-9 * speed) ** 2))


def first_guess(t: Array, z: Array, scale: Scale, begin: NDArray[np.bool_] | None = None) -> Noise:
    """Return a guess of q and r from the changes of velocity from step to step; it tolerates a tenth of faults.

    From one step of h seconds to the next, the velocity of the fixes changes by a variance of 2 q h / 3 + 6 r / h².
    Steps of one fix and of four give two equations.
    """
    rows, recording = _whole_fixes(z, begin)
    equations, sizes = [], []
    for lag in (1, 4):
        of = recording[::lag]
        h = np.diff(t[rows[::lag]])
        with np.errstate(divide="ignore", invalid="ignore"):
            changes = np.diff(np.diff(z[rows[::lag]], axis=0) / h[:, None], axis=0) ** 2
        changes = changes[of[2:] == of[:-2]]
        changes = changes[np.isfinite(changes)]
        if len(changes):
            step = float(np.median(h))
            equations.append([2 * step / 3, 6 / step**2])
            sizes.append(float(np.quantile(changes, TENTH)) / OF_TENTH)
    q, r = np.linalg.lstsq(np.array(equations), np.array(sizes), rcond=None)[0] if sizes else (0.0, 0.0)
    return Noise(max(float(q), 1e-6 * scale.speed**2 / scale.step), max(float(r), scale.rounding), False)


def _whole_fixes(z, begin):
    """Return the rows with all axes, and the number of the recording of each."""
    rows = np.flatnonzero(np.isfinite(z).all(axis=1))
    return rows, np.zeros(len(rows)) if begin is None else np.cumsum(begin)[rows]


@types_as_written
class Line(NamedTuple):
    """The K rows of all segments of a track in sequence, which a filter treats as one track.

    rows (K,): their rows in the track
    t (K,): their times, with an hour or more between segments
    z (K, m): the positions, NaN where refused, shifted so that each segment begins where the one before it ended
    moved (K, m): the shifts
    first (K,): whether each is one of the first two fixes of a segment, which only determine its initial state
    number (K,): the segment, 0, 1, ...
    relative (K, m): the relative variances of the fixes, or None if all are equal
    """

    rows: NDArray[np.intp]
    t: Array
    z: Array
    moved: Array
    first: NDArray[np.bool_]
    number: NDArray[np.intp]
    relative: Array | None

    def part(self, rows: NDArray[np.intp] | slice) -> Line:
        """Return the Line of some of its rows."""
        return Line(*(None if each is None else each[rows] for each in self))

    def stands_still(self, scale: Scale) -> bool:
        """Tell whether all fixes are equal up to rounding, so that no q and r can be fitted to them."""
        there = self.z[np.isfinite(self.z).any(axis=1)]
        width = np.nanmax(there, axis=0) - np.nanmin(there, axis=0)
        return bool((width < math.sqrt(scale.rounding)).all())


def concatenate_segments(
    t: Array,
    z: Array,
    relative: Array | None,
    same_as: NDArray[np.intp],
    segment: NDArray[np.intp],
    noise: Noise,
    scale: Scale,
) -> Line:
    """Return the Line of a track: the rows from the first to the last fix of each segment (N,).

    A row that repeats a fix, the row `same_as` (N,), belongs to the segment of that fix.
    """
    held = float(np.cbrt(3 * HELD * noise.r / noise.q))
    apart = max(HOUR_BETWEEN, min((FORGOTTEN * scale.speed) ** 2 / noise.q, held))
    rows, times, moved, first = [], [], [], []
    end, last = 0.0, np.zeros(z.shape[1])  # of the segment before, on the line
    for k in range(segment.max() + 1):
        own = np.flatnonzero(segment == k)
        inside = np.flatnonzero(segment[same_as] == k)
        span = np.arange(inside[0], inside[-1] + 1)
        begins_at, ends_at = _ends(z[own])
        rows.append(span)
        times.append(t[span] - t[own[0]] + end)
        moved.append(np.tile(last - begins_at, (len(span), 1)))
        first.append(np.isin(span, own[:2]))
        end = times[-1][-1] + apart
        last = ends_at + last - begins_at
    number = np.repeat(np.arange(len(rows)), [len(span) for span in rows])
    rows, moved = np.concatenate(rows), np.concatenate(moved)
    z_line = np.where((segment[rows] >= 0)[:, None], z[rows] + moved, np.nan)
    relative = None if relative is None else relative[rows]
    return Line(rows, np.concatenate(times), z_line, moved, np.concatenate(first), number, relative)


def _ends(z):
    """Return the first and the last known position (m,) on each axis of fixes (K, m), 0 where none is known."""
    known = [column[np.isfinite(column)] for column in z.T]
    return np.array([each[[0, -1]] if len(each) else [0.0, 0.0] for each in known]).T


def filter_of(noise: Noise, scale: Scale, t: Array, relative: Array | None, axes: int) -> KalmanFilter:
    """Return the filter of a track, with an initial sigma of ten steps in position and two usual speeds in velocity."""
    sigma = 10 * (math.sqrt(noise.r) + scale.speed * scale.step)
    axis = _axis_model(noise.q, noise.r, scale, relative, sigma, 2 * scale.speed)
    return KalmanFilter(stack(*[axis] * axes), t=t, r=None if relative is None else noise.r * relative)


def vague_axis_filter(line: Line, q: float, r: float, scale: Scale) -> KalmanFilter:
    """Return the filter of one axis, with an initial sigma of a hundred usual steps and ten usual speeds.

    It filters each axis of z (K, 1, m) as a track.
    """
    axis = _axis_model(q, r, scale, line.relative, 100 * scale.speed * scale.step, 10 * scale.speed)
    return KalmanFilter(axis, t=line.t, r=None if line.relative is None else r * line.relative[:, None])


def _axis_model(q, r, scale, relative, sigma, sigma_of_speed):
    """Return the model of one axis, with the initial sigmas of its position and speed."""
    of_fix = math.sqrt(r if relative is None else r * float(relative.min()))
    sigma_of_speed = min(sigma_of_speed, VAGUEST_SPEED * of_fix / scale.step)
    return constant_velocity(dt=scale.step, q=q, r=r, P0=np.diag([sigma**2, sigma_of_speed**2]))


def likelihood_of(line: Line, scale: Scale) -> fitting.NegativeLogLikelihood:
    """Return -log L as a function of log q and log r, for the fixes of a line given the first two of each segment."""
    make = lambda q, r: vague_axis_filter(line, q, r, scale)  # noqa: E731
    return fitting.NegativeLogLikelihood(make, ["q", "r"], line.z[:, None], ~line.first)


def fit_noise(line: Line, guess: Noise, scale: Scale, near: bool = True) -> Noise:
    """Return maximum-likelihood q and r of the fixes of a line, by a local or a global search along r / q.

    The global search is for a guess that may lie near a local maximum: recordings with many short gaps have several. An
    r below the rounding of the numbers is set to the rounding.
    """
    likelihood = likelihood_of(line, scale)
    low, high = (each + math.log(scale.step**3) for each in RATIOS)

    def objective(point):
        within = low <= point[1] - point[0] <= high
        return likelihood.with_best_scale(point) if within else (0.0, math.inf)

    at, ratio = np.log([guess.q, guess.r]), np.array([-0.5, 0.5])
    found = line_search(objective, at, ratio, AROUND, RATIO_FOUND, nothing=0.0) if near else at
    if not near or abs(np.diff(found - at)[0]) > AROUND[-2]:  # the guess was not close
        middle = at[0] + np.array([0.0, (low + high) / 2])
        found = line_search(objective, middle, ratio, ALL_OVER, RATIO_FOUND, nothing=0.0)
    q, r = np.exp(found)
    if r > scale.rounding:
        return Noise(float(q), float(r), False)
    return Noise(_fit_q(likelihood, float(q), scale.rounding, math.exp(high)), scale.rounding, True)


def _fit_q(likelihood, q, r, most):
    """Return the maximum-likelihood q given r, where r / q is at most `most`: fixes at rest do not determine q."""
    for _ in range(3):  # each best scale changes q, and so r / q
        q *= math.exp(likelihood.with_best_scale(np.log([q, r]))[0])
        q = max(q, r / most)
    return q


def assume_r_if_unidentifiable(line: Line, noise: Noise, scale: Scale) -> Noise:
    """Return the Noise with an r that is assumed if the motion hides the noise of the fixes, else the same Noise.

    With a fix in half a minute, or on a circling mobile, the fit takes turns between two fixes for noise, and r becomes
    far too large; or it takes noise for motion, and r becomes far too small. The assumed r leaves the line near the
    fixes.
    """
    likelihood = likelihood_of(line, scale)
    r = max(min(upper_limit_of_r(line, scale), USUAL**2), scale.rounding)
    if (r < SMOOTHED**2 or r <= noise.r) if noise.rounding else _is_identifiable(line, noise, scale, likelihood):
        return noise
    q = _fit_q(likelihood, noise.q, r, math.exp(RATIOS[1]) * scale.step**3)
    return Noise(q, r, rounding=False, assumed=True)


def _is_identifiable(line, noise, scale, likelihood):
    """Tell whether q and r explain the fixes: innovations are uncorrelated, and those of sparse fixes tell r."""
    sparse = noise.r < SPARSE * noise.q * scale.step**3
    at = np.log([noise.q, noise.r])
    if sparse:
        much_less = likelihood.with_best_scale(at - math.log(1000) * np.array([0.0, 1.0]))[1]
        if much_less - likelihood.with_best_scale(at)[1] < SIGNIFICANT:
            return False
    unit, _, _ = metrics.unit_innovations(likelihood.filter_at(at), likelihood.z)
    unit = np.clip(unit[~line.first, 0], -CLIPPED, CLIPPED)
    unit = np.nan_to_num(unit[np.isfinite(unit).any(axis=1)])
    correlations = [np.sum(unit[k:] * unit[:-k]) / np.sum(unit**2) for k in range(1, LAGS + 1)]
    negative = np.sum(np.minimum(correlations, 0.0) ** 2)
    if sparse:
        return bool(negative + BY_CHANCE[0] / unit.size < MOST_NEGATIVE[0])
    return bool(noise.r < USUAL**2 or negative < MOST_NEGATIVE[1] + BY_CHANCE[1] / unit.size)


def upper_limit_of_r(line: Line, scale: Scale) -> float:
    """Return an upper limit of r, whatever the motion is, from fixes without gaps between them."""
    fixes = np.isfinite(line.z).any(axis=1)
    t, differences = line.t[fixes], line.z[fixes]
    found = []
    for k in ORDERS:
        differences = np.diff(differences, axis=0)
        own = differences[t[k:] - t[:-k] < (k + 1) * scale.step]
        if np.isfinite(own).any() and len(own) >= len(t) / 2:
            found.append(np.nanmean(own**2) / math.comb(2 * k, k))
    relative = 1.0 if line.relative is None else float(line.relative[fixes].mean())
    return float(min(found, default=math.inf)) / relative


def log_errors(line: Line, noise: Noise, scale: Scale) -> dict[str, float]:
    """Return the standard errors of log q and log r, as `fit` does, infinite for an r that is not an estimate."""
    known = np.arange(1 if noise.rounding or noise.assumed else 2)
    blocks = fitting.blocks_of(vague_axis_filter(line, *noise[:2], scale), line.z[:, :1])
    blocks = blocks._replace(of_rows=np.repeat(blocks.of_rows, line.z.shape[1], axis=1))  # one for all axes of a fix
    errors = fitting.log_errors(likelihood_of(line, scale), np.log([noise.q, noise.r]), known, blocks)
    return dict(zip("qr", errors.tolist(), strict=True))
