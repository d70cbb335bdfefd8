"""A recorded track, from numbers to a smoothed line with a band: faults refused, q and r fitted, stretches smoothed.

The steps are those of the guide. They are repeated until no other fix is refused, four times at most, since a fault
spoils q and r, and without q and r no fault can be told:

1. `gate`, in sequence, from a first guess of q and r that a tenth of faults does not move;
2. a second look from both sides: a fix that is far off what all others say of it, those after it included;
3. q and r that make the fixes most probable which are left.

Then the band is judged, on the half of the track that a fit of the first half has not seen.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize_scalar

from .. import _checks as checks
from .. import bands, metrics
from .._checks import Array, Seconds
from ..fitting import covariance_of_scores
from ..kalman import KalmanFilter
from ..model import constant_velocity, stack
from . import gate, report, writers
from .files import write_together
from .readers import Recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEVEL = 0.95
OWN = 1.96  # standard deviations, of a normal distribution's 95 %
FEWEST = 10  # fixes
# Without fixes for so long, or for so many usual steps, the motion before says nothing of the motion after.
PAUSE, PAUSE_IN_STEPS = 60.0, 10
# From both sides: a fix is refused above this, if both neighbours are less far off; looked at so often at most. At 30,
# up to 0.2 % of the fixes of clean tracks are refused, at 200 nothing is gained.
FROM_BOTH_SIDES, LOOKS = 60.0, 3
# Where fixes are so many seconds apart or more, the limit is lower while the motion is calm: in proportion to the
# median of so many fixes around, over that of two axes of a right model, but no lower than CALM. Twice as many outliers
# of 20 to 40 m are caught. On denser tracks all are caught anyway, and fixes that are a few metres off would go too.
SPARSE, NEIGHBOURS, MEDIAN, CALM = 4.0, 21, 1.39, 30.0
# The variance r - P_s of that look is known to the rounding of P_s: below this part of r it is taken for this part.
SMALLEST_DIFFERENCE = 1e-8
TURNS = 4  # of the gate, the look from both sides and the fit
# q and r are those of at most so many fixes: more, in stretches spread over the track, tell them to 1 % already.
MOST_FITTED, FITTED_AT_A_TIME = 20_000, 1_000
# Stretches stand on one line of time, this long apart at least: so long that nothing of one is known in the next. In T
# seconds without a fix the variance of a velocity grows by q T: it has to grow by the square of so many usual speeds.
HOUR_BETWEEN, FORGOTTEN = 3600.0, 8
# Errors of q and r come from blocks of so many seconds, or of a tenth of the track if there are fewer.
SECONDS_PER_BLOCK, BLOCKS_AT_LEAST = 300.0, 10
# log(r / q) is searched between these, r / q in units of the usual step cubed (s³), and found to this.
RATIOS, RATIO_FOUND = (math.log(1e-8), math.log(1e6)), 0.02
# A step is one of a grid if it is a multiple of it, but for this part of it. Of two numbers that lie on no grid the
# difference is at most this part of a usual step, if it is to be their rounding.
ON_GRID, HUNDREDTH = 0.05, 0.01
# A first guess takes the squares that a tenth of all exceed: 2.71 of a normal distribution's variance.
TENTH, OF_TENTH = 0.9, 2.7055
# The band is judged at a horizon that a third of the fixes have another fix at.
CHECKED = 1 / 3


class Band(NamedTuple):
    """The worth of predictions on the part of a track that the fit behind them has not seen.

    seconds: how far ahead; half_width: the median half-width of the band that follows its own checked errors, m
    asked, held, own: the share of fixes that is asked for, that this band held, and that the fit's own band held
    checked: how many predictions were checked; independent: how many of them do not overlap in time
    ahead, widths: all predictions of the track (bands.Ahead), and the half-widths of the band around them (K, m)
    unseen (K,): which of them lie in the part that was not seen
    """

    seconds: float
    half_width: float
    asked: float
    held: float
    own: float
    checked: int
    independent: int
    ahead: bands.Ahead
    widths: Array
    unseen: NDArray[np.bool_]


@dataclass(frozen=True)
class Stretches:
    """The K rows of a track that lie in stretches, on one line, which a filter takes for one track of m axes.

    rows (K,): which rows of the track they are
    t (K,): their times, an hour or more from one stretch to the next
    z (K, m): the positions, NaN where refused, each stretch beginning where the one before it ended
    moved (K, m): how far they were moved for that
    first (K,): the first two fixes of each stretch: they only tell where it begins, and its velocity
    number (K,): the stretch that each row lies in, 0, 1, ...
    relative (K, m): the variances of the fixes, relative to each other, or None where all are alike
    """

    rows: NDArray[np.intp]
    t: Array
    z: Array
    moved: Array
    first: NDArray[np.bool_]
    number: NDArray[np.intp]
    relative: Array | None

    def part(self, rows):
        """Return some of the rows."""
        own = {field.name: getattr(self, field.name) for field in fields(self)}
        return Stretches(**{name: None if each is None else each[rows] for name, each in own.items()})


class Noise(NamedTuple):
    """q (m²/s³) and r (m²) of all axes, and whether r is the least that is possible: the rounding of the numbers."""

    q: float
    r: float
    rounding: bool


class Scale(NamedTuple):
    """The size of a track's numbers: its usual step (s), the speed that a tenth of the steps exceed (m/s), and the
    least variance that a fix can have (m²), that of the rounding of the numbers.
    """

    step: float
    speed: float
    rounding: float


def checked_track(t, z, r):
    """Return times (N,), positions (N, m) and relative variances (N, m) or None, all checked."""
    t = checks.times("t", t)
    need = "positions (N, m) in metres, NaN where one is missing"
    z = checks.real_numbers("z", z, need).astype(float)
    if z.ndim != 2 or 0 in z.shape or t.shape != (len(z),):
        checks.refuse("t, z", f"times (N,) and {need}", f"shapes {t.shape} and {z.shape}")
    checks.no_infinity(z)
    fixes = np.isfinite(z).any(axis=1)
    if fixes.sum() < FEWEST:
        checks.refuse("z", f"at least {FEWEST} fixes", int(fixes.sum()))
    if t[0] == t[-1]:
        checks.refuse("t", "times that increase", f"{t[0]:g} in all {len(t)} rows")
    if (np.nanmax(z, axis=0) == np.nanmin(z, axis=0)).all():
        checks.refuse("z", "a track that moves", f"one position {fixes.sum()} times")
    if r is not None:
        r = checks.real_numbers("r", r, "variances").astype(float)
        r = np.repeat(r[:, None], z.shape[1], axis=1) if r.ndim == 1 else r
        if r.shape != z.shape:
            checks.refuse("r", f"a variance of each fix, shape {t.shape} or {z.shape}", f"shape {r.shape}")
        there = r[np.isfinite(z)]
        checks.used_variances("r", there, of="fix")
        r = r / np.median(there)
    return t, z, r


def begins(t: Array, fixes: NDArray[np.bool_], segment: ArrayLike | None, pause: float | None) -> list[int]:
    """Return the rows where another recording begins: row 0, another segment, and the first fix after a pause (s)."""
    rows = np.flatnonzero(fixes)
    steps = np.diff(t[rows])
    if pause is None:
        pause = max(PAUSE, PAUSE_IN_STEPS * float(np.median(steps)))
    after = steps > pause
    if segment is not None:
        after |= np.diff(np.asarray(segment)[rows]) != 0
    return [int(rows[0]), *rows[1:][after].tolist()]


def grid_of(values: Array, grids: tuple[float, ...]) -> float:
    """Return the grid that numbers of few digits lie on: the coarsest of some that three quarters of their steps fit.

    The steps count, and not the values: a track that was moved has left the grid as a whole, and a fault for two steps.
    Numbers that lie on no grid have the least difference between two of them, as far as it can be one.
    """
    known = values[np.isfinite(values)]
    steps = np.abs(np.diff(known))
    steps = steps[steps > 0]
    if not len(steps):
        return 0.0
    for grid in sorted(grids, reverse=True):
        long = steps[steps > ON_GRID * grid] / grid  # shorter ones are none, but for the last digit
        fits = np.abs(long - np.round(long)) < ON_GRID
        if len(long) > 0.1 * len(steps) and np.mean(fits) > 0.75:
            return grid
    return float(min(np.diff(np.unique(known)).min(), HUNDREDTH * np.median(steps)))


def least_distance(z: Array) -> float:
    """Return the least distance between a fix and the next one, as far as it can be that of the numbers' grid.

    That is where it is less than a hundredth of a usual one.
    """
    moved = np.linalg.norm(np.diff(z[np.isfinite(z).all(axis=1)], axis=0), axis=1)
    moved = moved[moved > 0]
    return float(min(moved.min(), HUNDREDTH * np.median(moved)))


def scale_of(t: Array, z: Array, rounding: float) -> Scale:
    """Return the Scale of a track, faults and all."""
    rows = np.flatnonzero(np.isfinite(z).all(axis=1))
    seconds, moved = np.diff(t[rows]), np.sqrt((np.diff(z[rows], axis=0) ** 2).sum(axis=1))
    later = seconds > 0
    speeds = moved[later] / seconds[later]
    speed = float(np.quantile(speeds, TENTH))
    if speed == 0:  # it rests for nine tenths of the time
        speed = float(speeds[speeds > 0].mean())
    return Scale(float(np.median(seconds[later])), speed, max(rounding, (1e-9 * speed) ** 2))


def first_guess(t: Array, z: Array, scale: Scale) -> Noise:
    """Return q and r that give the changes of velocity between fixes the size that a tenth of them exceeds.

    Over two steps of h seconds the velocity changes by a variance of 2 q h / 3 + 6 r / h². Steps of one fix and of four
    tell both; a tenth of faults changes neither by much.
    """
    rows = np.flatnonzero(np.isfinite(z).all(axis=1))
    equations, sizes = [], []
    for lag in (1, 4):
        t_lag, z_lag = t[rows[::lag]], z[rows[::lag]]
        h = np.diff(t_lag)[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            changes = np.diff(np.diff(z_lag, axis=0) / h, axis=0) ** 2
        changes = changes[np.isfinite(changes)]
        if len(changes):
            step = float(np.median(h))
            equations.append([2 * step / 3, 6 / step**2])
            sizes.append(float(np.quantile(changes, TENTH)) / OF_TENTH)
    q, r = np.linalg.lstsq(np.array(equations), np.array(sizes), rcond=None)[0]
    least_q = 1e-6 * scale.speed**2 / scale.step
    return Noise(max(float(q), least_q), max(float(r), scale.rounding), False)


def filter_of(noise: Noise, scale: Scale, t: Array, relative: Array | None, axes: int) -> KalmanFilter:
    """Return the filter of a track of some axes, which starts from its first fix, known to some steps."""
    sigma = 10 * (math.sqrt(noise.r) + scale.speed * scale.step)
    P0 = np.diag([sigma**2, (2 * scale.speed) ** 2])
    axis = constant_velocity(dt=scale.step, q=noise.q, r=noise.r, P0=P0)
    return KalmanFilter(stack(*[axis] * axes), t=t, r=None if relative is None else noise.r * relative)


def on_one_line(t: Array, z: Array, relative: Array | None, pieces: NDArray[np.intp], noise: Noise, scale: Scale):
    """Return the Stretches of a track: the rows from the first to the last fix of each piece.

    They are so long apart that the velocity at the start of one is not known from the one before it.
    """
    apart = max(HOUR_BETWEEN, (FORGOTTEN * scale.speed) ** 2 / noise.q)
    rows, times, moved, first = [], [], [], []
    end, last = 0.0, np.zeros(z.shape[1])  # of the stretch before, on the line
    for k in range(pieces.max() + 1):
        own = np.flatnonzero(pieces == k)
        span = np.arange(own[0], own[-1] + 1)
        times.append(t[span] - t[own[0]] + end)
        moved.append(np.broadcast_to(last - z[own[0]], (len(span), z.shape[1])))
        first.append(np.isin(span, own[:2]))
        rows.append(span)
        end = times[-1][-1] + apart
        last = z[own[-1]] + moved[-1][0]
    number = np.repeat(np.arange(len(rows)), [len(span) for span in rows])
    rows, moved = np.concatenate(rows), np.concatenate(moved)
    z_line = np.where((pieces[rows] >= 0)[:, None], z[rows] + moved, np.nan)
    relative = None if relative is None else relative[rows]
    return Stretches(rows, np.concatenate(times), z_line, moved, np.concatenate(first), number, relative)


def fitted(line: Stretches, guess: Noise, scale: Scale) -> Noise:
    """Return the q and r that make the fixes of a line most probable, given the first two of each stretch.

    With q and r doubled, gains stay as they are and S doubles: so only rho = r / q is searched, and q is the mean NIS
    for q = 1 (`_best_q`). Where r comes out below the rounding of the numbers it is set to that.

    `fitting.fit` finds the same q and r for any model and any parameters (a test holds each to the other). It takes
    1.6 s for a track that this takes 0.1 s for, up to five times, and knows nothing of stretches and of rounding.
    """
    line = _sample(line)

    def surprise(log_rho):
        return _best_q(line, math.exp(log_rho), guess.q, scale)[1]

    unit = math.log(scale.step**3)
    at = math.log(guess.r / guess.q)
    low, high = max(at - math.log(100), RATIOS[0] + unit), min(at + math.log(100), RATIOS[1] + unit)
    if guess.rounding or not low < at < high:
        low, high = RATIOS[0] + unit, RATIOS[1] + unit
    found = minimize_scalar(surprise, bounds=(low, high), method="bounded", options={"xatol": RATIO_FOUND})
    if low > RATIOS[0] + unit and min(found.x - low, high - found.x) < 0.1:  # at an edge of the part that was searched
        wide = RATIOS[0] + unit, RATIOS[1] + unit
        found = minimize_scalar(surprise, bounds=wide, method="bounded", options={"xatol": RATIO_FOUND})
    rho = math.exp(found.x)
    q = _best_q(line, rho, guess.q, scale)[0]
    if q * rho > scale.rounding:
        return Noise(q, q * rho, False)
    for _ in range(3):  # r is known, and q is the mean NIS for r / q, which q itself changes
        q = _best_q(line, scale.rounding / q, guess.q, scale)[0]
    return Noise(q, scale.rounding, True)


def stands_still(line: Stretches, scale: Scale) -> bool:
    """Tell whether all fixes of a line are one, but for their rounding: no q and r can be fitted to such a line."""
    there = line.z[np.isfinite(line.z).any(axis=1)]
    width = np.nanmax(there, axis=0) - np.nanmin(there, axis=0)
    return bool((width < math.sqrt(scale.rounding)).all())


def _nis_and_log_S(line, rho, about_q, scale):
    """Return NIS and log S of each number of a line for q = 1 and r = rho, (K, m); NaN for the first of stretches.

    All variances count in units of q, those of the start too: for these q is taken for `about_q`.
    """
    kf = _from_an_unknown_start(line, 1.0, rho, scale, unit=about_q)
    values, S = metrics.innovations(kf, line.z[:, None])  # (K, 1, m) and (K, 1, 1, m): each axis is a track
    values = np.where(line.first[:, None], np.nan, values[:, 0])
    return values**2 / S[:, 0, 0], np.where(np.isnan(values), np.nan, np.log(S[:, 0, 0]))


def _best_q(line, rho, about_q, scale):
    """Return the best q for rho = r / q, and -log L there, but for a constant.

    -log L is ½ Σ (nis / q + log q + log S), which is least where q is the mean of nis.
    """
    nis, log_S = _nis_and_log_S(line, rho, about_q, scale)
    q, count = float(np.nanmean(nis)), int(np.isfinite(nis).sum())
    return q, 0.5 * (count * math.log(q) + float(np.nansum(log_S)))


def _sample(line):
    """Return a line, or parts spread over it where it has many fixes, each of which begins as a stretch does."""
    if len(line.rows) <= MOST_FITTED:
        return line
    starts = np.linspace(0, len(line.rows) - FITTED_AT_A_TIME, MOST_FITTED // FITTED_AT_A_TIME).astype(int)
    rows = np.unique(starts[:, None] + np.arange(FITTED_AT_A_TIME))
    first = line.first.copy()
    fixes = np.flatnonzero(np.isfinite(line.z).any(axis=1))
    for start in starts:
        first[fixes[np.searchsorted(fixes, start) :][:2]] = True
    part = line.part(rows)
    return replace(part, first=first[rows])


def log_errors(line: Stretches, noise: Noise, scale: Scale) -> dict[str, float]:
    """Return standard errors of log q and log r that hold where the motion is calm and wild by turns.

    With nis and S of a filter of q = 1 and r = rho, where rho = r / q, the derivatives of -log L are

        -log L                 = ½ Σ (nis / q + log q + log S)
        ∂ / ∂log q             = ½ Σ (1 - nis / q)
        ∂² / ∂(log q)²         = ½ Σ nis / q
        ∂² / ∂log q ∂log rho   = - ½ Σ ∂(nis / q) / ∂log rho

    and those by log rho alone are differences. The second derivatives, H, say how well a right model would know both.
    Here the scatter of the first ones does: s are their sums over blocks of some minutes, which hardly depend on each
    other, and the covariance of the errors is H⁻¹ J H⁻¹, where J is Σ s sᵀ with Student's factor for few blocks (a
    sandwich of scores, as in `fit`). log r is log q + log rho. The error of an r that is the rounding is infinite.
    """
    rho, h = noise.r / noise.q, 0.05

    def at(step):
        """Return nis / q and -log L, but for log q, of each number, (K, m), a step of log rho away."""
        nis, log_S = _nis_and_log_S(line, rho * math.exp(step), noise.q, scale)
        return nis / noise.q, 0.5 * (nis / noise.q + log_S)

    nis, surprise = at(0.0)
    gradient = [0.5 * (1 - nis)]
    H = np.array([[0.5 * np.nansum(nis)]])
    if not noise.rounding:
        (nis_up, up), (nis_down, down) = at(h), at(-h)
        gradient.append((up - down) / (2 * h))
        cross = -0.5 * np.nansum(nis_up - nis_down) / (2 * h)
        bend = np.nansum(up + down - 2 * surprise) / h**2
        H = np.array([[H[0, 0], cross], [cross, bend]])
    known = np.isfinite(nis).any(axis=1)
    block = _blocks_of(line, scale)[known]
    _, block = np.unique(block, return_inverse=True)  # those that have fixes are 0, 1, ...
    scores = np.array([np.bincount(block, np.nansum(each[known], axis=1)) for each in gradient])
    J = covariance_of_scores(scores) if scores.shape[1] > 1 else H
    inverse = np.linalg.inv(H)
    covariance = inverse @ J @ inverse
    error_of_q = math.sqrt(covariance[0, 0])
    if noise.rounding:
        return {"q": error_of_q, "r": math.inf}
    return {"q": error_of_q, "r": math.sqrt(max(float(covariance.sum()), 0.0))}


def _blocks_of(line, scale):
    """Return the number of the block that each row lies in, (K,): five minutes, or a tenth of all stretches."""
    seconds = np.diff(line.t)[np.diff(line.number) == 0].sum()  # without those between two stretches
    return np.floor(line.t / max(scale.step, min(SECONDS_PER_BLOCK, seconds / BLOCKS_AT_LEAST)))


def seen_from_both_sides(line: Stretches, noise: Noise, scale: Scale, pieces: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the pieces without the fixes that are far off what all others say of them.

    The squared distance of a fix from the smoothed line without it, in units of its variance, is (z - x)² / (r - P),
    where x and P are those of the line with it. A fault spoils its neighbours too: so only the worst of neighbours
    goes, and what is left is looked at again.
    """
    pieces = pieces.copy()
    for _ in range(LOOKS):
        x, P = _smoothed(line, noise, scale)
        r = noise.r if line.relative is None else noise.r * line.relative
        without = np.maximum(r - P, SMALLEST_DIFFERENCE * r)
        seen = np.isfinite(line.z)
        off = np.where(seen, (line.z - x) ** 2 / without, 0).sum(axis=1)
        fixes = np.flatnonzero(seen.any(axis=1))
        limits = _limits_of_calm(off[fixes]) if scale.step >= SPARSE else FROM_BOTH_SIDES
        off = np.concatenate([[0], off[fixes], [0]])  # so that the first and the last have neighbours too
        worst = (off[1:-1] > limits) & (off[1:-1] >= off[:-2]) & (off[1:-1] >= off[2:])
        if not worst.any():
            break
        pieces[line.rows[fixes[worst]]] = -1
        z = line.z.copy()
        z[fixes[worst]] = np.nan
        line = replace(line, z=z)
    return pieces


def _limits_of_calm(off):
    """Return the limit of each fix, (N,), from how far off (N,) the fixes around it are."""
    around = np.lib.stride_tricks.sliding_window_view(np.pad(off, NEIGHBOURS // 2, mode="reflect"), NEIGHBOURS)
    return np.clip(FROM_BOTH_SIDES * np.median(around, axis=1) / MEDIAN, CALM, FROM_BOTH_SIDES)


def _smoothed(line, noise, scale):
    """Return the smoothed positions of a line and their variances, (K, m)."""
    s = _from_an_unknown_start(line, noise.q, noise.r, scale).smooth(line.z[:, None])  # each axis is a track
    return s.x[:, 0], s.P[:, 0, 0]


def _from_an_unknown_start(line, q, r, scale, unit=1.0):
    """Return the filter of one axis of a line, which knows nothing of its start. `unit` is that of q and r, in m²/s³.

    The variances of the start are those of a hundred usual steps and of ten usual speeds, in that unit.
    """
    P0 = np.diag([(100 * scale.speed * scale.step) ** 2, (10 * scale.speed) ** 2]) / unit
    axis = constant_velocity(dt=scale.step, q=q, r=r, P0=P0)
    return KalmanFilter(axis, t=line.t, r=None if line.relative is None else r * line.relative[:, None])


def band_of(line: Stretches, noise: Noise, scale: Scale, seconds: float) -> Band | None:
    """Return the Band of the second half of a line, or None where it has too few predictions.

    q and r are fitted anew, on the first half; where it stands still there is none.
    """
    half = len(line.rows) // 2
    before = line.part(slice(half))
    if stands_still(before, scale):
        return None
    first = fitted(before, noise, scale)
    kf = filter_of(first, scale, line.t, line.relative, line.z.shape[1])
    fixes = np.isfinite(line.z).any(axis=1)
    t = line.t[fixes]
    due = np.append(t, np.inf)[np.searchsorted(t, t + seconds * (1 - bands.TIME_ROUNDING))] - t
    if np.mean(due <= bands.LATEST * seconds) < CHECKED:
        seconds = float(np.quantile(np.diff(t), 0.5, method="higher"))
    try:
        a = bands.ahead(kf, line.z, seconds)
    except ValueError:  # no fix has another at that distance
        return None
    unseen = a.row >= half
    if not np.isfinite(a.errors[unseen]).any(axis=0).all():
        return None
    widths = bands.following(a, level=LEVEL)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of few predictions: `independent` says how many
        held = bands.coverage(a, widths, where=unseen)
        own = bands.coverage(a, OWN * a.sigma, where=unseen)
    half_width = float(np.median(widths[unseen]))
    return Band(
        seconds,
        half_width,
        LEVEL,
        float(held.share.mean()),
        float(own.share.mean()),
        int(unseen.sum()),
        held.independent,
        a,
        widths,
        unseen,
    )


@dataclass(frozen=True)
class Source:
    """The file that a track is from.

    rows (N,): which fixes of the recording those of the track are; left_out: how many others there are, by reason
    origins: of each plane of the track the latitude, longitude (°) and height (m); plane (N,): in which one a fix lies;
    empty and zero for a file in metres
    said: what was taken for what, in words
    """

    path: Path | str
    recording: Recording
    rows: NDArray[np.intp]
    left_out: dict[str, int]
    origins: list[tuple[float, float, float]]
    plane: NDArray[np.intp]
    said: list[str]


@dataclass(frozen=True)
class Cleaned:
    """A recorded track without its faults.

    t (N,): times in s; z (N, m): positions in m as recorded, NaN where there is none
    pieces (N,): the stretch of each fix, 0, 1, ..., and -1 where it is refused or there is none
    x (N, 2 m), P (N, 2 m, 2 m): smoothed position and velocity of each axis, [east, v_east, north, v_north], and their
        covariance; NaN where a row lies in no stretch
    q, r: of all axes, m²/s³ and m², as the fixes have them that are kept; log_errors: standard errors of their
        logarithms, infinite for an r that is the rounding of the numbers
    band: a Band, or None for a track too short to judge one on
    rounding: whether r is that rounding: the recorder has smoothed the positions, and their noise does not show
    filter: the KalmanFilter of all stretches on one line of time, `line`
    recordings: the rows where a recording begins: the first one, after a pause, and in another segment
    source: the file that the track is from, or None
    """

    t: Array
    z: Array
    pieces: NDArray[np.intp]
    x: Array
    P: Array
    q: float
    r: float
    log_errors: dict[str, float]
    rounding: bool
    band: Band | None
    filter: KalmanFilter
    line: Stretches
    recordings: list[int]
    source: Source | None = None

    @property
    def mask(self) -> NDArray[np.bool_]:
        """The mask of the fixes that are kept, (N,)."""
        return self.pieces >= 0

    @property
    def refused(self) -> NDArray[np.intp]:
        """The rows of the fixes that are refused."""
        return np.flatnonzero(~self.mask & np.isfinite(self.z).any(axis=1))

    @property
    def stretches(self) -> int:
        """The number of stretches."""
        return int(self.pieces.max()) + 1

    @property
    def unusual(self) -> list[str]:
        """The unusual things about a recorded track, in words: it may be in other units, or have too few digits."""
        return report.unusual(self)

    def report(self) -> str:
        """Return a report, in words, of what was done to the track and what was found about it."""
        return report.text(self)

    def summary(self) -> dict[str, Any]:
        """Return the numbers of the report by name, ready for JSON."""
        return report.summary(self)

    def plot(self) -> Figure:
        """Return a figure: a map with the refused fixes, and the speed with its band."""
        return report.figure(self)

    def gpx(self, path: str | PathLike[str], overwrite: bool = False) -> None:
        """Write the smoothed track as a GPX file.

        Times, heights, segments and all else that the file of the track holds are kept. A fix that was refused within a
        stretch lies on the smoothed line; one between stretches is left out, and after a jump a new segment begins, so
        that a map draws no line over the jump. Raises ValueError for a track in metres, and FileExistsError for a file
        that exists, unless `overwrite` is True; the source is never written over.
        """
        write_together({Path(path): writers.gpx_bytes(self)}, overwrite, self.source.path)

    def to_frame(self) -> Any:
        """Return the track as a pandas frame with a row for each fix that was used.

        It has `time`, the smoothed `lat`, `lon` (of a track in degrees), `x`, `y` (m) and velocities `v_x`, `v_y`
        (m/s), `sigma` and `sigma_v`, the standard deviations of each axis of these, `kept`, and the number of the
        stretch; NaN and -1 outside of stretches. The rows have the labels of the frame that the track is from.
        """
        return writers.frame_of(self)

    @property
    def starts(self) -> NDArray[np.intp]:
        """The rows where a stretch begins after a jump, not after a pause."""
        firsts = np.array([np.flatnonzero(self.pieces == k)[0] for k in range(self.stretches)], dtype=np.intp)
        recording = np.searchsorted(self.recordings, firsts, side="right")
        return firsts[1:][recording[1:] == recording[:-1]]  # of the recording that the stretch before is of


def clean(
    t: ArrayLike,
    z: ArrayLike,
    r: ArrayLike | None = None,
    *,
    seconds: Seconds = 10.0,
    limit: float = 100.0,
    pause: Seconds | None = None,
    segment: ArrayLike | None = None,
    rounding: float | None = None,
    show: Callable[[str], None] = lambda _: None,
) -> Cleaned:
    """Return a recorded track without its faults, smoothed and with a band, as a Cleaned.

    t (N,) are times in s that do not decrease, z (N, m) positions in metres on any axes, NaN where one is missing. r
    (N,) or (N, m) are variances relative to each other, as the squares of a receiver's hdop: their size is fitted. q
    and r are one for all axes: give heights apart, or not at all.

    seconds is the horizon of the band, limit that of `gated`; after a `pause` (s; a minute, or ten usual steps where
    these are longer) and where `segment` (N,) changes a stretch begins anew. rounding is the variance that the digits
    of z have; without it their grid is searched. seconds and pause are numbers or timedeltas. show is called with what
    is done next, in words.

    Raises ValueError for times that decrease or are all equal, fewer than ten fixes, a track that does not move, or
    only by what looks like faults, and for other shapes.

    >>> from mpt_helpers.model import simulate
    >>> axis = constant_velocity(dt=1.0, q=0.04, r=4.0)
    >>> _, z = simulate(stack(axis, axis), N=600, rng=np.random.default_rng(1))
    >>> z[100] += 500.0
    >>> c = clean(np.arange(600.0), z)
    >>> c.refused.tolist(), c.starts.tolist(), round(c.q, 3), round(c.r, 2)
    ([100], [], 0.035, 4.03)
    """
    t, z, relative = checked_track(t, z, r)
    seconds, limit = checks.duration("seconds", seconds), checks.positive("limit", limit)
    if pause is not None:
        pause = checks.duration("pause", pause)
    if rounding is None:
        rounding = least_distance(z) ** 2 / 12
    recordings = begins(t, np.isfinite(z).any(axis=1), segment, pause)
    scale = scale_of(t, z, rounding)
    noise, pieces = first_guess(t, z, scale), None
    for _ in range(TURNS):
        show("looking for faults")
        before = pieces
        pieces = gate.pieces(filter_of(noise, scale, t, relative, z.shape[1]), z, recordings, limit, 3)
        line = on_one_line(t, z, relative, pieces, noise, scale)
        pieces = seen_from_both_sides(line, noise, scale, pieces)
        if before is not None and np.array_equal(pieces, before):
            break
        line = on_one_line(t, z, relative, pieces, noise, scale)
        if stands_still(line, scale):
            still = f"{(pieces >= 0).sum()} of {np.isfinite(z).any(axis=1).sum()} fixes standing still"
            checks.refuse("z", "a track that moves", f"{still}, all else being faults or jumps: are digits missing?")
        show("fitting")
        noise = fitted(line, noise, scale)
    line = on_one_line(t, z, relative, pieces, noise, scale)
    show("smoothing")
    kf = filter_of(noise, scale, line.t, line.relative, z.shape[1])
    s = kf.smooth(line.z)
    n = 2 * z.shape[1]
    x, P = np.full((len(t), n), np.nan), np.full((len(t), n, n), np.nan)
    x[line.rows], P[line.rows] = s.x, s.P
    x[line.rows, ::2] -= line.moved
    show("judging the band")
    errors = log_errors(line, noise, scale)
    band = band_of(line, noise, scale, seconds)
    return Cleaned(t, z, pieces, x, P, noise.q, noise.r, errors, noise.rounding, band, kf, line, recordings)
