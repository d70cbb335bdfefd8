"""A recorded track, from numbers to a smoothed line with a band: faults refused, q and r fitted, segments smoothed.

A *segment* is what a filter runs through from its own first fix. The steps are repeated until no other fix is refused,
four times at most, since a fault spoils q and r, and without q and r no fault can be told:

1. `gate`, in sequence, from a first guess of q and r that a tenth of faults does not move;
2. a second look from both sides: a fix that is far off what all others say of it, those after it included;
3. maximum-likelihood q and r of the remaining fixes.

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

from .. import _checks as checks
from .. import bands, fitting
from .._checks import Array, Seconds
from ..kalman import KalmanFilter
from ..model import constant_velocity, stack
from ..search import AROUND, along_a_line
from . import gate, geodesy, plot, report, writers
from .files import write_together
from .readers import Recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEVEL = 0.95
OWN = 1.96  # standard deviations, of a normal distribution's 95 %
FEWEST = 10  # fixes
LEAST_TOLD = 3  # fixes after the first two of their recordings
# Without fixes for so long, or for so many usual steps, the motion before says nothing of the motion after.
PAUSE, PAUSE_IN_STEPS = 60.0, 10
# So few fixes, and no larger part of all, whose times are so far (s) from all others are faults of time: a receiver
# that does not know the date yet says 1980, or is off by 1024 weeks.
STRAY, STRAY_SHARE, FAR_IN_TIME = 10, 0.05, 100 * 86400.0
# Rows are written faster than fixes where so large a part of the positions is repeated while the mobile moves at half
# its usual speed or more, and steps are longer than so many steps of the numbers' grid. (Recorded tracks: 0 to 2 %.)
REPEATED, STEPS_OF_GRID = 0.1, 3.0
# From both sides: a fix is refused above this, if both neighbours are less far off; looked at so often at most. At 30,
# up to 0.2 % of the fixes of clean tracks are refused, at 200 nothing is gained.
FROM_BOTH_SIDES, LOOKS = 60.0, 3
# Where fixes are so many seconds apart or more, the limit is lower while the motion is smooth: in proportion to the
# median of so many fixes around, over that of two axes of a right model, but no lower than CALM. Twice as many outliers
# of 20 to 40 m are caught. On denser tracks all are caught anyway, and fixes that are a few metres off would go too.
SPARSE, NEIGHBOURS, MEDIAN, CALM = 4.0, 21, 1.39, 30.0
# The variance r - P_s of that look is known to the rounding of P_s: below this part of r it is taken for this part.
SMALLEST_DIFFERENCE = 1e-8
TURNS = 4  # of the gate, the look from both sides and the fit
# q and r are those of at most so many fixes: more, in parts spread over the track, tell them to 1 % already.
MOST_FITTED, FITTED_AT_A_TIME = 20_000, 1_000
# Segments stand on one line of time, this long apart at least: so long that nothing of one is known in the next. In T
# seconds without a fix the variance of a velocity grows by q T: it has to grow by the square of so many usual speeds.
# But that of the position, q T³ / 3, stays below so many times r, which doubles hold.
HOUR_BETWEEN, FORGOTTEN, HELD = 3600.0, 8, 1e20
# r / q, in units of the usual step cubed (s³), is searched between these: first all over, later near the last one.
RATIOS = math.log(1e-8), math.log(1e6)
ALL_OVER = math.log(100) * np.arange(-3.5, 4)
RATIO_FOUND = 0.02
# A step is one of a grid if it is a multiple of it, but for this part of it. Of two numbers that lie on no grid the
# difference is at most this part of a usual step, if it is to be their rounding.
ON_GRID, HUNDREDTH = 0.05, 0.01
# A first guess takes the squares that a tenth of all exceed: 2.71 of a normal distribution's variance.
TENTH, OF_TENTH = 0.9, 2.7055
# The band is judged at a horizon that a third of the fixes have another fix at.
CHECKED = 1 / 3


class Band(NamedTuple):
    """The worth of predictions on the part of a track that the fit behind them has not seen.

    Attributes
    ----------
    seconds : float
        How far ahead.
    half_width : float
        The median half-width in m of the band that follows its own checked errors.
    asked, held, own : float
        The share of fixes that is asked for, that this band held, and that the fit's own band held.
    checked, independent : int
        How many predictions were checked, and how many of them do not overlap in time.
    ahead : ForecastErrors
        The forecast errors of the whole track.
    widths : ndarray (K, m)
        The half-widths of the band around them.
    unseen : ndarray of bool (K,)
        Which of them lie in the part that was not seen.

    """

    seconds: float
    half_width: float
    asked: float
    held: float
    own: float
    checked: int
    independent: int
    ahead: bands.ForecastErrors
    widths: Array
    unseen: NDArray[np.bool_]

    def __repr__(self) -> str:
        return (
            f"Band({self.seconds:g} s ahead: ± {self.half_width:.3g}, held {self.held:.1%} of {self.asked:.0%} asked, "
            f"{self.checked} checked, {self.independent} independent)"
        )


@dataclass(frozen=True)
class Line:
    """The K rows of a track that lie in segments, on one line of time, which a filter takes for one track of m axes.

    rows (K,): which rows of the track they are
    t (K,): their times, an hour or more from one segment to the next
    z (K, m): the positions, NaN where refused, each segment beginning where the one before it ended
    moved (K, m): how far they were moved for that
    first (K,): the first two fixes of each segment: they only tell where it begins, and its velocity
    number (K,): the segment that each row lies in, 0, 1, ...
    relative (K, m): the variances of the fixes, relative to each other, or None where all are alike
    """

    rows: NDArray[np.intp]
    t: Array
    z: Array
    moved: Array
    first: NDArray[np.bool_]
    number: NDArray[np.intp]
    relative: Array | None

    def part(self, rows: NDArray[np.intp]) -> Line:
        """Return some of the rows."""
        own = {field.name: getattr(self, field.name) for field in fields(self)}
        return Line(**{name: None if each is None else each[rows] for name, each in own.items()})


class Track(NamedTuple):
    """Times (N,), positions and relative variances (N, m), and which rows (N,) are no fixes of their own."""

    t: Array
    z: Array
    relative: Array | None
    repeats: NDArray[np.bool_]


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


@dataclass(frozen=True)
class Source:
    """The file that a track is from.

    rows (N,): which fixes of the recording those of the track are; left_out: how many others there are, by reason
    charts: the charts of the track (`geodesy`); plane (N,): in which one a fix lies; empty and zero for metres
    said: what was taken for what, in words
    """

    path: Path | str
    recording: Recording
    rows: NDArray[np.intp]
    left_out: dict[str, int]
    charts: list[geodesy.Plane | geodesy.Belt]
    plane: NDArray[np.intp]
    said: list[str]


@dataclass(frozen=True, repr=False)
class Cleaned:
    """A recorded track without its faults; printed, it is its report.

    Attributes
    ----------
    t : ndarray (N,)
        Times in s.
    z : ndarray (N, m)
        Positions in m as recorded, NaN where there is none.
    pieces : ndarray of int (N,)
        The segment of each fix, 0, 1, ..., and -1 where it is refused or there is none.
    x, P : ndarray (N, 2 m), (N, 2 m, 2 m)
        Smoothed position and velocity of each axis, [east, v_east, north, v_north], and their covariance; NaN where a
        row lies in no segment.
    q, r : float
        Process noise (m²/s³) and variance of a fix (m²) of all axes, of the fixes that are kept.
    log_errors : dict
        Standard errors of their logarithms, infinite for an r that is the rounding of the numbers.
    rounding : bool
        Whether r is that rounding: the recorder has smoothed the positions, and their noise does not show.
    band : Band or None
        None for a track too short to judge one on.
    filter : KalmanFilter
        The filter of all segments on one line of time, `line`.
    line : Line
        The rows that lie in segments, on one line of time.
    recordings : list
        The rows where a recording begins: the first one, after a pause, and in another segment of the file.
    repeats : ndarray of bool (N,)
        The rows that are no fixes of their own: repeated positions, and all but the newest of one time.
    said : list
        What was found about the times, in words.
    source : Source or None
        The file that the track is from.

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
    line: Line
    recordings: list[int]
    repeats: NDArray[np.bool_]
    said: list[str]
    source: Source | None = None

    def __repr__(self) -> str:
        return self.report()

    @property
    def mask(self) -> NDArray[np.bool_]:
        """The mask of the fixes that are kept, (N,)."""
        return self.pieces >= 0

    @property
    def refused(self) -> NDArray[np.intp]:
        """The rows of the fixes that are refused."""
        return np.flatnonzero(~self.mask & np.isfinite(self.z).any(axis=1) & ~self.repeats)

    @property
    def stretches(self) -> int:
        """The number of segments."""
        return int(self.pieces.max()) + 1

    @property
    def unusual(self) -> list[str]:
        """The unusual things about a recorded track, in words: it may be in other units, or have too few digits."""
        return report.unusual(self)

    def report(self) -> str:
        """Say in words what was done to the track and what was found about it.

        Returns
        -------
        str
            The report, of several lines.

        """
        return report.text(self)

    def summary(self) -> dict[str, Any]:
        """Return the numbers of the report.

        Returns
        -------
        dict
            The numbers by name, ready for JSON.

        """
        return report.summary(self)

    def plot(self) -> Figure:
        """Draw the track: a map with the refused fixes, and the speed with its band.

        Returns
        -------
        matplotlib.figure.Figure
            The figure.

        """
        return plot.figure(self)

    def gpx(self, path: str | PathLike[str], overwrite: bool = False) -> None:
        """Write the smoothed track as a GPX file.

        Times, heights, segments and all else that the file of the track holds are kept. A fix that was refused within a
        segment lies on the smoothed line; one between segments is left out, and after a jump a new one begins, so that
        a map draws no line over the jump.

        Parameters
        ----------
        path : path
            The file to write, never the source.
        overwrite : bool
            Whether a file that exists is replaced.

        Raises
        ------
        ValueError
            For a track in metres.
        FileExistsError
            For a file that exists, unless `overwrite` is True.

        """
        write_together({Path(path): writers.gpx_bytes(self)}, overwrite, self.source.path)

    def to_frame(self) -> Any:
        """Return the track as a pandas frame with a row for each fix that was used.

        Returns
        -------
        pandas.DataFrame
            `time`, the smoothed `lat`, `lon` (of a track in degrees), `x`, `y` (m) and velocities `v_x`, `v_y` (m/s),
            `sigma` and `sigma_v`, the standard deviations of each axis of these, `kept`, and the number of the segment;
            NaN and -1 outside of segments. The rows have the labels of the frame that the track is from.

        """
        return writers.frame_of(self)

    @property
    def starts(self) -> NDArray[np.intp]:
        """The rows where a segment begins after a jump, not after a pause."""
        firsts = np.array([np.flatnonzero(self.pieces == k)[0] for k in range(self.stretches)], dtype=np.intp)
        recording = np.searchsorted(self.recordings, firsts, side="right")
        return firsts[1:][recording[1:] == recording[:-1]]  # of the recording that the segment before is of


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
    show: Callable[[str], None] | None = None,
) -> Cleaned:
    """Return a recorded track without its faults, smoothed and with a band.

    q and r are one for all axes: give heights apart, or not at all. Rows that repeat a position while the mobile moves
    on, where rows are written faster than fixes, are no fixes; of several fixes at one time the last one counts.

    Parameters
    ----------
    t : array_like, (N,)
        Times in s, or dates, that do not decrease; those of another `segment` may be before the last ones.
    z : array_like, (N, m)
        Positions in metres on any axes, NaN where one is missing.
    r : array_like, (N,) or (N, m), optional
        Variances relative to each other, as the squares of a receiver's hdop: their size is fitted.
    seconds : float or timedelta
        The horizon of the band.
    limit : float
        That of `gated`.
    pause : float or timedelta, optional
        After so long without a fix a recording begins anew: a minute, or ten usual steps where these are longer.
    segment : array_like, (N,), optional
        Where it changes a recording begins anew.
    rounding : float, optional
        The variance that the digits of z have, m²; without it their grid is searched.
    show : callable, optional
        Called with what is done next, in words.

    Returns
    -------
    Cleaned
        The cleaned track.

    Raises
    ------
    ValueError
        For times that decrease, fewer than ten fixes at different times, a track that does not move, or only by what
        looks like faults, and for other shapes.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> axis = mpt.constant_velocity(dt=1.0, q=0.04, r=4.0)
    >>> _, z = mpt.simulate(mpt.stack(axis, axis), N=600, rng=1)
    >>> z[100] += 500.0
    >>> c = mpt.tracks.clean(np.arange(600.0), z)
    >>> c.refused.tolist(), c.starts.tolist(), round(c.q, 3), round(c.r, 2)
    ([100], [], 0.035, 4.03)

    """
    say = show or (lambda _: None)
    seconds = checks.duration("seconds", seconds)
    limit = checks.number("limit", limit, "a squared distance in variances, above 1, as 100", lambda value: value > 1)
    pause = None if pause is None else checks.duration("pause", pause)
    t, z, relative, another = checked_track(t, z, r, segment)
    rounding = least_distance(z) ** 2 / 12 if rounding is None else checks.not_negative("rounding", rounding)
    repeats, said = no_fixes_of_their_own(t, z, another, rounding)
    fixes = np.flatnonzero(np.isfinite(z).any(axis=1) & ~repeats)
    begin = begins(t[fixes], another[fixes], pause)
    stray = strays(t[fixes], begin)
    if stray.any():
        said.append(f"refused: {stray.sum()} fixes whose time is months or years from all others")
        begin, fixes = begin[~stray], fixes[~stray]
        begin[0] = True
    if len(fixes) < FEWEST:
        checks.refuse("t", f"at least {FEWEST} fixes at different times", len(fixes))
    recordings = fixes[begin].tolist()
    if np.maximum(np.diff([*np.flatnonzero(begin), len(fixes)]) - 2, 0).sum() < LEAST_TOLD:
        got = f"{len(recordings)} recordings of {len(fixes)} fixes, of which the first two each tell nothing of q and r"
        checks.refuse("t" if pause is None else "pause", "recordings of three fixes and more", got)
    track = Track(t, z, relative, repeats)
    clock = clock_of(t[fixes], begin)  # for the gate, which starts anew after a pause: its length does not count
    own = z[fixes], None if relative is None else relative[fixes]
    scale = scale_of(clock, own[0], rounding, begin)
    noise, pieces = first_guess(clock, own[0], scale, begin), None
    for _ in range(TURNS):
        say("looking for faults")
        before, pieces = pieces, np.full(len(t), -1)
        kf = filter_of(noise, scale, clock, None if relative is None else own[1].max(axis=1)[:, None], 1)
        pieces[fixes] = gate.segments_of(kf, own[0][:, None], np.flatnonzero(begin), limit, 3)
        line = on_one_line(track, pieces, noise, scale)
        pieces = seen_from_both_sides(line, noise, scale, pieces)
        if before is not None and np.array_equal(pieces, before):
            break
        line = on_one_line(track, pieces, noise, scale)
        if stands_still(line, scale):
            still = f"{(pieces >= 0).sum()} of {len(fixes)} fixes standing still"
            checks.refuse("z", "a track that moves", f"{still}, all else being faults or jumps: are digits missing?")
        say("fitting")
        noise = fitted(line, noise, scale, near=before is not None)
    line = on_one_line(track, pieces, noise, scale)
    say("smoothing")
    kf = filter_of(noise, scale, line.t, line.relative, z.shape[1])
    s = kf.smooth(line.z)
    n = 2 * z.shape[1]
    x, P = np.full((len(t), n), np.nan), np.full((len(t), n, n), np.nan)
    x[line.rows], P[line.rows] = s.x, s.P
    x[line.rows, ::2] -= line.moved
    say("judging the band")
    errors = log_errors(line, noise, scale)
    band = band_of(line, noise, scale, seconds)
    return Cleaned(
        t, z, pieces, x, P, noise.q, noise.r, errors, noise.rounding, band, kf, line, recordings, repeats, said
    )


def checked_track(t, z, r, segment):
    """Return times (N,), positions (N, m), relative variances (N, m) or None, and where another segment begins."""
    need = "positions (N, m) in metres, NaN where one is missing"
    z = checks.real_numbers("z", z, need).astype(float)
    if z.ndim != 2 or 0 in z.shape or np.shape(t) != (len(z),):
        checks.refuse("t, z", f"times (N,) and {need}", f"shapes {np.shape(t)} and {z.shape}")
    checks.no_infinity(z)
    another = np.zeros(len(z), dtype=bool)
    if segment is not None:
        segment = np.asarray(segment)
        if segment.shape != (len(z),):
            checks.refuse("segment", f"a number or a name for each of {len(z)} rows", f"shape {segment.shape}")
        another[1:] = segment[1:] != segment[:-1]
    order = np.argsort(np.asarray(t), kind="stable") if another.any() else np.arange(len(z))
    given, t = t, np.empty(len(z))
    t[order] = checks.times("t", given if not another.any() else np.asarray(given)[order])
    back = (np.diff(t) < 0) & ~another[1:]
    if back.any():
        checks.refuse("t", "times that do not decrease within a segment", f"less in row {np.argmax(back) + 1}")
    whole = np.isfinite(z).all(axis=1).sum()
    if whole < FEWEST:
        checks.refuse("z", f"at least {FEWEST} fixes with all axes", int(whole))
    if (np.nanmax(z, axis=0) == np.nanmin(z, axis=0)).all():
        checks.refuse("z", "a track that moves", f"one position {whole} times")
    if r is not None:
        r = checks.real_numbers("r", r, "variances").astype(float)
        r = np.repeat(r[:, None], z.shape[1], axis=1) if r.ndim == 1 else r
        if r.shape != z.shape:
            checks.refuse("r", f"a variance of each fix, shape {t.shape} or {z.shape}", f"shape {r.shape}")
        there = r[np.isfinite(z)]
        checks.used_variances("r", there, of="fix")
        r = np.where(np.isfinite(z), r / np.median(there), 1.0)
    return t, z, r, another


def no_fixes_of_their_own(t, z, another, rounding):
    """Return which rows (N,) are no fixes of their own, and what to say of them.

    Of several fixes at one time the last counts: a receiver that catches up writes all it has with the time of the
    newest. And where rows are written faster than fixes, each position is repeated until the next fix. A mobile at rest
    repeats its position too: so repeats count only if they are usual while it moves, and in a longer rest than such a
    repeat one row for each of its length is kept.
    """
    N, said = len(t), []
    rows = np.flatnonzero(np.isfinite(z).any(axis=1))
    again = np.zeros(N, dtype=bool)
    again[rows[:-1]] = (
        (np.diff(t[rows]) == 0) & ~another[rows[1:]] & (np.isfinite(z[rows[1:]]) | np.isnan(z[rows[:-1]])).all(axis=1)
    )
    if again.any():
        said.append(f"{again.sum()} fixes have the time of the next one: only the last of each time counts")
    rows = rows[~again[rows]]
    new = np.append(True, (np.diff(z[rows], axis=0) != 0).any(axis=1) | another[rows[1:]])
    first = rows[new]
    if len(first) < FEWEST:
        return again, said
    seconds, moved = np.diff(t[first]), np.linalg.norm(np.diff(z[first], axis=0), axis=1)
    later = seconds > 0
    speed = moved[later] / seconds[later]
    moving = speed > np.nanmedian(speed) / 2
    held = (np.diff(np.flatnonzero(new)) > 1)[later]
    grid = max(math.sqrt(12 * rounding), _coarse_grid(z[first]))
    if held[moving].mean() < REPEATED or np.nanmedian(moved) < STEPS_OF_GRID * grid:
        return again, said
    longest = float(np.quantile(seconds[later][moving & held], LEVEL))
    since = np.floor((t[rows] - t[first][np.cumsum(new) - 1]) / longest)
    repeats = ~new & (since == np.append(0, since[:-1]))
    again[rows[repeats]] = True
    said.append(f"{repeats.sum()} rows repeat a position while the mobile moves on: they are no fixes")
    return again, said


def _coarse_grid(z):
    """Return the step that nearly all changes of one of the axes of positions (N, m) are multiples of, or zero."""
    grid = 0.0
    for steps in np.abs(np.diff(z, axis=0)).T:
        steps = steps[steps > 1e-3 * np.nanmax(steps, initial=0.0)]
        if not len(steps):
            continue
        least = np.quantile(steps, 1 - LEVEL)
        if np.mean(np.abs(steps / least - np.round(steps / least)) < ON_GRID) > LEVEL:
            grid = max(grid, float(least))
    return grid


def begins(t: Array, another: NDArray[np.bool_], pause: float | None) -> NDArray[np.bool_]:
    """Return which fixes, at times t, begin another recording: the first, in another segment, and after a pause (s)."""
    steps = np.diff(t)
    inside = steps[steps > 0]
    if pause is None:
        pause = max(PAUSE, PAUSE_IN_STEPS * float(np.median(inside))) if len(inside) else PAUSE
    return np.append(True, (steps > pause) | (steps < 0) | another[1:])


def strays(t: Array, begin: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which fixes have a time that cannot be: few of them, and months from all others."""
    number = np.cumsum(begin) - 1
    count = np.bincount(number)
    few = count < min(STRAY, STRAY_SHARE * len(t))
    if few.all() or not few.any():
        return np.zeros(len(t), dtype=bool)
    sound = np.sort(t[~few[number]])
    after = np.searchsorted(sound, t)
    low, high = sound[np.maximum(after - 1, 0)], sound[np.minimum(after, len(sound) - 1)]
    apart = np.minimum(np.abs(t - low), np.abs(t - high))
    return few[number] & (apart > FAR_IN_TIME)


def clock_of(t: Array, begin: NDArray[np.bool_]) -> Array:
    """Return times that run on, an hour later, where another recording begins."""
    return np.cumsum(np.append(0.0, np.where(begin[1:], HOUR_BETWEEN, np.diff(t))))


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


def scale_of(t: Array, z: Array, rounding: float, begin: NDArray[np.bool_] | None = None) -> Scale:
    """Return the Scale of a track, faults and all; steps to another recording do not count."""
    rows = np.flatnonzero(np.isfinite(z).all(axis=1))
    seconds, moved = np.diff(t[rows]), np.sqrt((np.diff(z[rows], axis=0) ** 2).sum(axis=1))
    later = seconds > 0
    if begin is not None:
        later &= np.diff(np.cumsum(begin)[rows]) == 0
    speeds = moved[later] / seconds[later]
    if not (speeds > 0).any():
        checks.refuse("z", "a track that moves", "one that stands still within each recording")
    speed = float(np.quantile(speeds, TENTH))
    if speed == 0:  # it rests for nine tenths of the time
        speed = float(speeds[speeds > 0].mean())
    return Scale(float(np.median(seconds[later])), speed, max(rounding, (1e-9 * speed) ** 2))


def first_guess(t: Array, z: Array, scale: Scale, begin: NDArray[np.bool_] | None = None) -> Noise:
    """Return q and r that give the changes of velocity between fixes the size that a tenth of them exceeds.

    Over two steps of h seconds the velocity changes by a variance of 2 q h / 3 + 6 r / h². Steps of one fix and of four
    tell both; a tenth of faults changes neither by much.
    """
    rows = np.flatnonzero(np.isfinite(z).all(axis=1))
    number = np.zeros(len(rows)) if begin is None else np.cumsum(begin)[rows]
    equations, sizes = [], []
    for lag in (1, 4):
        t_lag, z_lag, of = t[rows[::lag]], z[rows[::lag]], number[::lag]
        h = np.diff(t_lag)[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            changes = np.diff(np.diff(z_lag, axis=0) / h, axis=0) ** 2
        changes = changes[of[2:] == of[:-2]]
        changes = changes[np.isfinite(changes)]
        if len(changes):
            step = float(np.median(h))
            equations.append([2 * step / 3, 6 / step**2])
            sizes.append(float(np.quantile(changes, TENTH)) / OF_TENTH)
    q, r = np.linalg.lstsq(np.array(equations), np.array(sizes), rcond=None)[0] if sizes else (0.0, 0.0)
    least_q = 1e-6 * scale.speed**2 / scale.step
    return Noise(max(float(q), least_q), max(float(r), scale.rounding), False)


def filter_of(noise: Noise, scale: Scale, t: Array, relative: Array | None, axes: int) -> KalmanFilter:
    """Return the filter of a track of some axes, which starts from its first fix, known to some steps."""
    sigma = 10 * (math.sqrt(noise.r) + scale.speed * scale.step)
    P0 = np.diag([sigma**2, (2 * scale.speed) ** 2])
    axis = constant_velocity(dt=scale.step, q=noise.q, r=noise.r, P0=P0)
    return KalmanFilter(stack(*[axis] * axes), t=t, r=None if relative is None else noise.r * relative)


def on_one_line(track: Track, pieces: NDArray[np.intp], noise: Noise, scale: Scale) -> Line:
    """Return the Line of a track: the rows from the first to the last fix of each segment.

    They are so long apart that the velocity at the start of one is not known from the one before it. Rows that are no
    fixes of their own belong to the segment of the fix that they repeat.
    """
    t, z, relative, repeats = track
    held = float(np.cbrt(3 * HELD * noise.r / noise.q))
    apart = max(HOUR_BETWEEN, min((FORGOTTEN * scale.speed) ** 2 / noise.q, held))
    rows, times, moved, first = [], [], [], []
    end, last = 0.0, np.zeros(z.shape[1])  # of the segment before, on the line
    for k in range(pieces.max() + 1):
        own = np.flatnonzero(pieces == k)
        begin, end_row = own[0], own[-1]
        while begin > 0 and repeats[begin - 1] and t[begin - 1] == t[own[0]]:
            begin -= 1
        while end_row + 1 < len(t) and repeats[end_row + 1] and (z[end_row + 1] == z[end_row]).all():
            end_row += 1
        span = np.arange(begin, end_row + 1)
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
    return Line(rows, np.concatenate(times), z_line, moved, np.concatenate(first), number, relative)


def likelihood_of(line: Line, scale: Scale) -> fitting.NegativeLogLikelihood:
    """Return -log L of the log of q and r, of the fixes of a line given the first two of each segment."""
    make = lambda q, r: _from_an_unknown_start(line, q, r, scale)  # noqa: E731
    return fitting.NegativeLogLikelihood(make, ["q", "r"], line.z[:, None], ~line.first)  # each axis is a track


def fitted(line: Line, guess: Noise, scale: Scale, near: bool = True) -> Noise:
    """Return maximum-likelihood q and r of the fixes of a line, searched along r / q, first near a guess or all over.

    Where r comes out below the rounding of the numbers it is set to that.
    """
    likelihood = likelihood_of(_sample(line), scale)
    low, high = (each + math.log(scale.step**3) for each in RATIOS)

    def rated(point):
        within = low <= point[1] - point[0] <= high
        return likelihood.with_best_scale(point) if within else (0.0, math.inf)

    at, ratio = np.log([guess.q, guess.r]), np.array([-0.5, 0.5])
    found = along_a_line(rated, at, ratio, AROUND, RATIO_FOUND, nothing=0.0) if near else at
    if not near or abs(np.diff(found - at)[0]) > AROUND[-2]:  # it was looked for in the wrong place
        middle = at[0] + np.array([0.0, (low + high) / 2])
        found = along_a_line(rated, middle, ratio, ALL_OVER, RATIO_FOUND, nothing=0.0)
    q, r = np.exp(found)
    if r > scale.rounding:
        return Noise(float(q), float(r), False)
    for _ in range(3):  # r is known, and the best scale for r / q changes q, and so r / q
        q *= math.exp(likelihood.with_best_scale(np.log([q, scale.rounding]))[0])
        q = max(q, scale.rounding / math.exp(high))  # of fixes that rest nothing tells q
    return Noise(float(q), scale.rounding, True)


def log_errors(line: Line, noise: Noise, scale: Scale) -> dict[str, float]:
    """Return standard errors of log q and log r, as `fit` does; that of an r that is the rounding is infinite."""
    known = np.arange(1 if noise.rounding else 2)
    blocks = fitting.blocks_of(_from_an_unknown_start(line, *noise[:2], scale), line.z[:, :1])
    blocks = blocks._replace(of_rows=np.repeat(blocks.of_rows, line.z.shape[1], axis=1))  # one for all axes of a fix
    errors = fitting.log_errors(likelihood_of(line, scale), np.log([noise.q, noise.r]), known, blocks)
    return dict(zip("qr", errors.tolist(), strict=True))


def _sample(line):
    """Return a line, or parts spread over it where it has many fixes, each of which begins as a segment does."""
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


def stands_still(line: Line, scale: Scale) -> bool:
    """Tell whether all fixes of a line are one, but for their rounding: no q and r can be fitted to such a line."""
    there = line.z[np.isfinite(line.z).any(axis=1)]
    width = np.nanmax(there, axis=0) - np.nanmin(there, axis=0)
    return bool((width < math.sqrt(scale.rounding)).all())


def seen_from_both_sides(line: Line, noise: Noise, scale: Scale, pieces: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the segments without the fixes that are far off what all others say of them.

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
    kept = pieces >= 0
    pieces[kept] = np.unique(pieces[kept], return_inverse=True)[1]  # a segment may have gone as a whole
    return pieces


def _limits_of_calm(off):
    """Return the limit of each fix, (N,), from how far off (N,) the fixes around it are."""
    around = np.lib.stride_tricks.sliding_window_view(np.pad(off, NEIGHBOURS // 2, mode="reflect"), NEIGHBOURS)
    return np.clip(FROM_BOTH_SIDES * np.median(around, axis=1) / MEDIAN, CALM, FROM_BOTH_SIDES)


def _smoothed(line, noise, scale):
    """Return the smoothed positions of a line and their variances, (K, m)."""
    s = _from_an_unknown_start(line, noise.q, noise.r, scale).smooth(line.z[:, None])  # each axis is a track
    return s.x[:, 0], s.P[:, 0, 0]


def _from_an_unknown_start(line, q, r, scale):
    """Return the filter of one axis of a line, from the variances of a hundred usual steps and of ten usual speeds."""
    P0 = np.diag([(100 * scale.speed * scale.step) ** 2, (10 * scale.speed) ** 2])
    axis = constant_velocity(dt=scale.step, q=q, r=r, P0=P0)
    return KalmanFilter(axis, t=line.t, r=None if line.relative is None else r * line.relative[:, None])


def band_of(line: Line, noise: Noise, scale: Scale, seconds: float) -> Band | None:
    """Return the Band of the second half of a line, or None where it has too few predictions.

    q and r are fitted anew, on the first half; where it stands still there is none.
    """
    half = len(line.rows) // 2
    before = line.part(slice(half))
    if stands_still(before, scale) or np.isfinite(before.z[~before.first]).sum() < FEWEST:
        return None
    first = fitted(before, noise, scale)
    kf = filter_of(first, scale, line.t, line.relative, line.z.shape[1])
    t = line.t[np.isfinite(line.z).any(axis=1)]
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
    shares = float(held.share.mean()), float(own.share.mean())
    width = float(np.median(widths[unseen]))
    return Band(seconds, width, LEVEL, *shares, int(unseen.sum()), held.independent, a, widths, unseen)
