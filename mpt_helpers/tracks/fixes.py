"""Which rows of a recorded track are fixes, where recordings begin, and the grid that the numbers lie on."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import _checks as checks
from .._checks import Array
from .._immutable import types_as_written

FEWEST = 10  # fixes
LEAST_TOLD = 3  # fixes after the first two of their recordings
# A recording ends if no fix follows within PAUSE seconds, or PAUSE_IN_STEPS median steps if these are longer: motion
# before such a pause says nothing about motion after it.
PAUSE, PAUSE_IN_STEPS = 60.0, 10
# A group of fixes has wrong times if it has fewer than ten fixes and 5 % of all, and lies more than 100 days from the
# others: a receiver that does not know the date yet reports 1980, or is off by 1024 weeks.
STRAY, STRAY_SHARE, FAR_IN_TIME = 10, 0.05, 100 * 86400.0
# A position is a repeat if no axis changes by more than LAST_DIGIT of the grid of the numbers, in all rows of the
# repeat together. Rows are written faster than fixes are made if two conditions hold. At least a tenth of positions are
# repeated while the mobile moves at half its median speed or faster (in recorded tracks it is 0 to 2 %), and the median
# step is at least three times the grid of the numbers.
LAST_DIGIT, REPEATED, STEPS_OF_GRID, NEARLY_ALL = 1.5, 0.1, 3.0, 0.95
# A step lies on a grid if it is a multiple of it to within ON_GRID of the grid. Numbers on no grid are rounded to at
# most HUNDREDTH of a median step.
ON_GRID, HUNDREDTH = 0.05, 0.01


@types_as_written
class Fixes(NamedTuple):
    """The fixes of a track.

    rows (K,): their rows in the track
    begin (K,): whether a recording begins with each
    same_as (N,): for each row of the track, the row of the fix that it repeats, or its own number
    said: notes on what was found
    """

    rows: NDArray[np.intp]
    begin: NDArray[np.bool_]
    same_as: NDArray[np.intp]
    said: list[str]


def checked_track(t, z, r, segment):
    """Return times (N,), positions (N, m), relative variances (N, m) or None, and where a segment begins (N,)."""
    need = "positions (N, m) in metres, NaN where one is missing"
    z = checks.real_numbers("z", z, need).astype(float)
    if z.ndim != 2 or 0 in z.shape or np.shape(t) != (len(z),):
        checks.refuse("t, z", f"times (N,) and {need}", f"shapes {np.shape(t)} and {z.shape}")
    checks.no_infinity(z)
    segment = np.zeros(len(z)) if segment is None else np.asarray(segment)
    if segment.shape != (len(z),):
        checks.refuse("segment", f"a number or a name for each of {len(z)} rows", f"shape {segment.shape}")
    begins_segment = np.append(False, segment[1:] != segment[:-1])
    order = np.argsort(t, kind="stable")  # segments may be out of order, the rows of a segment may not
    times = np.empty(len(z))
    times[order] = checks.times("t", np.asanyarray(t)[order])
    back = (np.diff(times) < 0) & ~begins_segment[1:]
    if back.any():
        checks.refuse("t", "times that do not decrease within a segment", f"less in row {np.argmax(back) + 1}")
    whole = np.isfinite(z).all(axis=1).sum()
    if whole < FEWEST:
        checks.refuse("z", f"at least {FEWEST} fixes with all axes", int(whole))
    if (np.nanmax(z, axis=0) == np.nanmin(z, axis=0)).all():
        checks.refuse("z", "a track that moves", f"one position {whole} times")
    return times, z, None if r is None else _relative(r, z), begins_segment


def _relative(r, z):
    """Return variances (N,) or (N, m) as (N, m), relative to their median."""
    r = checks.real_numbers("r", r, "variances").astype(float)
    if r.shape not in (z.shape[:1], z.shape):
        checks.refuse("r", f"a variance of each fix, shape {z.shape[:1]} or {z.shape}", f"shape {r.shape}")
    r = np.broadcast_to(r if r.ndim == 2 else r[:, None], z.shape)
    there = np.isfinite(z)
    checks.used_variances("r", r[there], of="fix")
    return np.where(there, r / np.median(r[there]), 1.0)


def find_fixes(t: Array, z: Array, begins_segment: NDArray[np.bool_], rounding: float, pause: float | None) -> Fixes:
    """Return the Fixes of a track; `begins_segment` (N,) marks where a segment begins, `rounding` is a variance."""
    seen = np.isfinite(z).any(axis=1)
    early = _superseded(t, z, begins_segment, np.flatnonzero(seen))
    rows = np.flatnonzero(seen & ~early)
    again = _repeated(t, z, rows, _recording_begins(t[rows], begins_segment[rows], pause), rounding)
    fix = seen & ~early & ~again
    row = np.arange(len(t))
    before = np.maximum.accumulate(np.where(fix, row, 0))
    after = np.minimum.accumulate(np.where(fix, row, len(t) - 1)[::-1])[::-1]
    same_as = np.where(early, after, np.where(again, before, row))
    said = []
    if early.any():
        said.append(f"{early.sum()} fixes have the time of the next one: only the last of each time counts")
    if again.any():
        said.append(f"{again.sum()} rows repeat a position while the mobile moves on: they are no fixes")
    rows = np.flatnonzero(fix)
    begin = _recording_begins(t[rows], begins_segment[rows], pause)
    stray = _stray_times(t[rows], begin)
    if stray.any():
        said.append(f"refused: {stray.sum()} fixes whose time is months or years from all others")
        rows, begin = rows[~stray], begin[~stray]
        begin[0] = True
    if len(rows) < FEWEST:
        checks.refuse("t", f"at least {FEWEST} fixes at different times", len(rows))
    longest = np.diff(np.sort(t[rows])).max()
    if longest > FAR_IN_TIME:
        said.append(f"ATTENTION: for {longest / 86400:,.0f} days there is no fix: are the dates right?")
    counts = np.bincount(np.cumsum(begin) - 1)
    if np.maximum(counts - 2, 0).sum() < LEAST_TOLD:
        got = f"{len(counts)} recordings of {len(rows)} fixes, of which the first two each tell nothing of q and r"
        checks.refuse("t" if pause is None else "pause", "recordings of three fixes and more", got)
    return Fixes(rows, begin, same_as, said)


def _superseded(t, z, begins_segment, rows):
    """Return the mask (N,) of those `rows` that have the time of the next one, which has all their axes.

    A receiver that catches up gives several fixes the time of the newest, so the last of them counts.
    """
    early = np.zeros(len(t), dtype=bool)
    has_all = (np.isfinite(z[rows[1:]]) | np.isnan(z[rows[:-1]])).all(axis=1)
    early[rows[:-1]] = (np.diff(t[rows]) == 0) & ~begins_segment[rows[1:]] & has_all
    return early


def _repeated(t, z, rows, begin, rounding):
    """Return the mask (N,) of those `rows` that repeat a position because rows are written faster than fixes are made.

    `begin` marks the rows that begin a recording, which may be far from the row before them. A mobile at rest repeats
    its position too. So there are none unless repeats are frequent while the mobile moves, and a rest keeps one row per
    period of those repeats.
    """
    again = np.zeros(len(t), dtype=bool)
    digit = LAST_DIGIT * math.sqrt(12 * rounding)
    new = np.append(True, ~(np.abs(np.diff(z[rows], axis=0)) <= digit).all(axis=1) | begin[1:])
    group = np.cumsum(new) - 1
    creeps = ~(np.abs(z[rows] - z[rows][new][group]) <= digit).all(axis=1)
    new |= np.isin(group, group[creeps])
    first = rows[new]
    if len(first) < FEWEST:
        return again
    seconds, moved = np.diff(t[first]), np.linalg.norm(np.diff(z[first], axis=0), axis=1)
    later = seconds > 0
    speed = moved[later] / seconds[later]
    moving = speed > np.nanmedian(speed) / 2
    held = (np.diff(np.flatnonzero(new)) > 1)[later]
    grid = max(math.sqrt(12 * rounding), _coarse_grid(z[first]))
    if held[moving].mean() < REPEATED or np.nanmedian(moved) < STEPS_OF_GRID * grid:
        return again
    longest = float(np.quantile(seconds[later][moving & held], NEARLY_ALL))
    since = np.floor((t[rows] - t[first][np.cumsum(new) - 1]) / longest)
    again[rows] = ~new & (since == np.append(0, since[:-1]))
    return again


def _recording_begins(t, begins_segment, pause):
    """Return the mask of the fixes, at times t, that begin a recording: at the start, after a pause, with a segment."""
    steps = np.diff(t)
    if pause is None:
        inside = steps[steps > 0]
        pause = max(PAUSE, PAUSE_IN_STEPS * float(np.median(inside))) if len(inside) else PAUSE
    return np.append(True, (steps > pause) | (steps < 0) | begins_segment[1:])


def _stray_times(t, begin):
    """Return the mask of the fixes with a wrong time: a few that are months from all others."""
    number = np.cumsum(begin) - 1
    few = (np.bincount(number) < min(STRAY, STRAY_SHARE * len(t)))[number]
    if few.all() or not few.any():
        return np.zeros(len(t), dtype=bool)
    sound = np.sort(t[~few])
    after = np.searchsorted(sound, t)
    low, high = sound[np.maximum(after - 1, 0)], sound[np.minimum(after, len(sound) - 1)]
    return few & (np.minimum(np.abs(t - low), np.abs(t - high)) > FAR_IN_TIME)


def grid_of(values: Array, grids: tuple[float, ...] = ()) -> float:
    """Return the grid that numbers lie on: the coarsest of `grids` that holds three quarters of their steps.

    Steps are tested, not values: a shifted track is off the grid as a whole, and a fault spoils only two steps. If no
    grid fits, the result is the shortest step, but at most HUNDREDTH of a median step.
    """
    steps = _steps(values)
    for grid in sorted(grids, reverse=True):
        long = steps[steps > ON_GRID * grid]  # shorter ones are rounding errors of zero
        if len(long) > 0.1 * len(steps) and _on_grid(long, grid) > 0.75:
            return grid
    return float(min(steps.min(), HUNDREDTH * np.median(steps))) if len(steps) else 0.0


def _coarse_grid(z):
    """Return the coarsest grid that holds nearly all steps of one axis of positions (N, m), or zero."""
    found = 0.0
    for steps in map(_steps, z.T):
        steps = steps[steps > 1e-3 * steps.max(initial=0.0)]
        short = float(np.quantile(steps, 1 - NEARLY_ALL)) if len(steps) else 0.0
        if short > found and _on_grid(steps, short) > NEARLY_ALL:
            found = short
    return found


def _steps(values):
    """Return the sizes of the steps between successive numbers, without NaN and zeros."""
    steps = np.abs(np.diff(values[np.isfinite(values)]))
    return steps[steps > 0]


def _on_grid(steps, grid):
    """Return the share of steps that lie on a grid."""
    return np.mean(np.abs(steps / grid - np.round(steps / grid)) < ON_GRID)
