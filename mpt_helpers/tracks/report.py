"""The report of a cleaned track, in words and as named numbers.

The words need no knowledge of filters; the specialist's numbers are in brackets.
"""

from __future__ import annotations

import math
from datetime import timedelta
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..fitting import UNKNOWN
from .fixes import FAR_IN_TIME
from .geodesy import earth_centred
from .noise_fit import SMOOTHED
from .readers import UNIX, to_datetime
from .unsupported import take_turns
from .writers import degrees_of, velocities_of

if TYPE_CHECKING:
    from .result import Cleaned

MOVING = 0.5  # m/s, slower than a walk
DOUBTFUL = 0.05  # share of rows: if the speed of more cannot be told from MOVING, the time in motion is unknown
REST, REST_STEP = 60.0, 2.0  # s: a rest lasts at least a minute, and is searched on a grid
KM_H = 3.6
COLUMNS = 100  # of a terminal
NO_BREAK = "\u00a0"  # a blank at which no line is broken
SMALL_ERROR = 0.3  # error of a logarithm: below it given in per cent, below UNKNOWN as a factor, else not at all
MOST_LISTED = 5  # at most so many times of faults
BAND_FIELDS = ("seconds", "half_width", "asked", "held", "own", "checked", "independent")
# Recorded speeds lie between those of a snail and of a fighter jet. If fixes are RARELY seconds apart and slow, their
# times are probably in milliseconds.
VERY_FAST, VERY_SLOW, SLOW_AND_RARE, RARELY = 400.0, 0.02, 0.4, 100.0  # m/s, m/s, m/s, s
# Noise scatters alike along the way and across it: of FEW fixes the ratio is 1 with a standard error of a tenth. A
# receiver's north errors may be half again as large as its east errors.
FEW, UNEVEN = 100, 1.6
MANY = 0.1  # share of the fixes: if more are refused, they are hardly all faults
# If more than a few fixes are FAR times farther from the line than the median one, faults were taken for noise. On
# recorded tracks at most 1.3 % were as far.
FAR, A_FEW = 6.0, 0.03


def text(c: Cleaned) -> str:
    """Return the report of a Cleaned; questions come before the numbers that they cast doubt on."""
    lines = [_heading(c), *(f"note: {each}" for each in _notes(c))]
    lines += [*_faults(c), _motion(c), _precision(c), _prediction(c), _distance(c)]
    filled = [fill(line, COLUMNS, subsequent_indent="  ", break_on_hyphens=False) for line in lines]
    return "\n".join(filled).replace(NO_BREAK, " ")


def summary(c: Cleaned) -> dict[str, Any]:
    """Return the numbers of the report; infinite and missing ones are None."""
    left_out = {} if c.source is None else c.source.left_out
    row_of_file = np.arange(len(c.t)) if c.source is None else c.source.rows
    return {
        "fixes": len(c.t) + sum(left_out.values()),
        "refused": row_of_file[c.refused].tolist(),
        "starts": row_of_file[c.starts].tolist(),
        "left_out": left_out,
        "stretches": c.stretches,
        "q": c.q,
        "r": c.r,
        "r_is_rounding": c.rounding,
        "log_errors": {name: error if math.isfinite(error) else None for name, error in c.log_errors.items()},
        "ahead": None if c.band is None else {name: getattr(c.band, name) for name in BAND_FIELDS},
        **distance_and_speeds(c),
        "notes": _notes(c),
    }


def _notes(c):
    """Return the notes of the reader and of `clean`, and questions about what is unusual."""
    return [*([] if c.source is None else c.source.said), *c.said, *c.unusual]


def unusual(c: Cleaned) -> list[str]:
    """Return questions about anything unusual in a recorded track, such as other units or too few digits."""
    found = []
    fixes = np.isfinite(c.z).all(axis=1) & c.mask
    seconds, moved = np.diff(c.t[fixes]), np.linalg.norm(np.diff(c.z[fixes], axis=0), axis=1)
    later = seconds > 0
    if later.any():
        step, speed = np.median(seconds[later]), np.quantile(moved[later] / seconds[later], 0.99)
        seen = ""
        if speed > VERY_FAST:
            seen = f"one step in a hundred is faster than {speed:.0f} m/s"
        elif speed < VERY_SLOW or (step >= RARELY and speed < SLOW_AND_RARE):
            seen = f"99 of 100 steps are slower than {speed:.1g} m/s, with a fix every {step:g} s"
        if seen:
            units = "are the times in seconds, not milliseconds, and the positions in metres, or a file's in degrees?"
            found.append(f"ATTENTION: {seen}: {units}")
    if c.source is not None and c.source.charts:
        recording, rows = c.source.recording, c.source.rows[fixes]
        if max(np.abs(recording.lat[rows]).max() * 2, np.abs(recording.lon[rows]).max()) < math.pi:
            found.append("ATTENTION: all fixes lie in the Atlantic near 0° N 0° E: are they in radians?")
    if take_turns(c.t[fixes], c.z[fixes]):
        found.append("ATTENTION: every other fix lies on a path of its own: are these two receivers, or two mobiles?")
    along, across, count = _along_and_across(c)
    if count >= FEW and along > UNEVEN * across:
        why = "the speed varies between them (short stops count as motion), or their times are wrong"
        found.append(
            f"ATTENTION: in motion the fixes scatter by {_digits(along)} m along the way, but by {_digits(across)} m "
            f"across it: {why}. The smoothed line may be farther from the true way than the fixes"
        )
    if math.isinf(c.log_errors["r"]) and not c.rounding:
        found.append(
            "ATTENTION: the errors of the fixes cannot be told from the motion: the fixes are too far apart, the "
            "mobile turns or stops between them, or neighbouring fixes share their errors. r is assumed, the line "
            "stays near the fixes, and errors lengthen the way"
        )
    off = np.linalg.norm(_off_the_line(c)[fixes[c.line.rows]], axis=1)
    far = float(np.mean(off > FAR * np.median(off)))
    if far > A_FEW and math.isfinite(c.log_errors["r"]):
        found.append(
            f"ATTENTION: {far:.0%} of the fixes are more than {FAR:g} times as far from the smoothed line as the "
            "median one: they are much less precise, or faults too many to be refused, and spoil the line"
        )
    share = _share_refused(c)
    if share > MANY:
        asked = "So many are hardly faults: are digits missing, or is the noise large?"
        found.append(f"ATTENTION: {share:.0%} of the fixes are refused. {asked}")
    return found


def _off_the_line(c):
    """Return how far the fixes of the line's rows are from it (K, m), in m of a fix of median precision."""
    off = (c.z - c.x[:, ::2])[c.line.rows]
    return off if c.line.relative is None else off / np.sqrt(c.line.relative)


def _along_and_across(c):
    """Return how far fixes in motion are from the smoothed line, along it and across it (rms, m), and their number."""
    rows = c.line.rows
    velocity, off = c.x[rows, 1:4:2], _off_the_line(c)[:, :2]
    speed = np.linalg.norm(velocity, axis=1)
    moving = np.isfinite(off).all(axis=1) & c.mask[rows] & (speed > MOVING)
    if c.z.shape[1] == 1 or not moving.any():
        return 0.0, 0.0, 0
    along = np.sum(off * velocity, axis=1)[moving] / speed[moving]
    squares = np.sum(off**2, axis=1)[moving]
    return math.sqrt(np.mean(along**2)), math.sqrt(np.mean(np.maximum(squares - along**2, 0))), len(along)


def _share_refused(c):
    return len(c.refused) / np.isfinite(c.z).any(axis=1).sum()


def _clock(seconds):
    return str(timedelta(seconds=round(seconds)))


def counted(left_out: dict[str, int]) -> str:
    """Return how many fixes were left out for which reason, in words."""
    return ", ".join(f"{count:,} with {reason}" for reason, count in left_out.items())


def _fixes(number):
    return f"{number:,} fix{'' if number == 1 else 'es'}"


def _heading(c):
    name = "" if c.source is None else f"{Path(c.source.path).name}: "
    steps = np.diff(c.t[np.isfinite(c.z).any(axis=1)])
    steps = steps[steps >= 0]
    usual = float(np.median(steps))
    alike = np.isclose(steps, usual, rtol=1e-4)  # Unix times of doubles are known to a microsecond
    every = f"{'' if np.mean(alike) > 0.99 else 'mostly '}every {usual:.4g} s"
    parts = [f"{name}{_fixes(len(c.t))} in {_clock(np.ptp(c.t[_near_in_time(c)]))}, {every}"]
    if c.source is not None:  # a reader notices GPS seconds by their date, ten years off
        start = c.source.recording.time[c.source.rows[_near_in_time(c)]].min()
        parts += [f"from {to_datetime(start):%Y-%m-%d %H:%M:%S} UTC"] if start >= UNIX * 1e6 else []
    if len(c.recordings) > 1:
        parts.append(f"in {len(c.recordings)} parts (pauses, or segments of the file)")
    return "; ".join(parts)


def _faults(c):
    lines = []
    if c.source is not None and c.source.left_out:
        lines.append(f"not used: {counted(c.source.left_out)}")
    if len(c.refused):
        first_of_runs = c.refused[np.diff(c.refused, prepend=-2) > 1]
        share = f"{_fixes(len(c.refused))} ({_share_refused(c):.2%})"
        lines.append(f"refused as faults: {share}, {_when(c, first_of_runs)}")
    else:
        lines.append("refused as faults: none")
    if len(c.starts):
        lines.append(f"jumps that stay: {len(c.starts)}, {_when(c, c.starts)}; the smoothed line begins anew there")
    return lines


def _when(c, rows):
    """Return when the first few of some rows were recorded, in words."""
    near = _near_in_time(c)
    seconds = c.t[rows[near[rows]]] - c.t[near].min()
    if not len(seconds):
        return "at impossible times"
    listed = ", ".join(map(_clock, seconds[:MOST_LISTED]))
    return f"{listed}{', ...' if len(seconds) > MOST_LISTED else ''} after the start"


def _near_in_time(c):
    """Return the mask of the fixes whose time is not months from the line's."""
    t = c.t[c.line.rows]
    return (c.t > t.min() - FAR_IN_TIME) & (c.t < t.max() + FAR_IN_TIME)


def _motion(c):
    return (
        f"motion: within a second the velocity changes by about {_digits(math.sqrt(c.q))} m/s, east and north each "
        f"(process noise {_symbol('q', c.q, 'm²/s³')}, {_known(c.log_errors['q'])})"
    )


def _precision(c):
    sigma, r = _digits(math.sqrt(c.r)), _symbol("r", c.r, "m²")
    if c.rounding and math.sqrt(c.r) >= SMOOTHED:
        return (
            "fixes: their errors do not show beside the rounding of the numbers, and the filter takes that of the "
            f"rounding, {sigma} m (variance {r})"
        )
    if c.rounding:
        return (
            "fixes: the recorder had smoothed them already, so their errors do not show; the filter takes them as "
            f"exact to {sigma} m, the rounding of the numbers (variance {r})"
        )
    if math.isinf(c.log_errors["r"]):
        return (
            "fixes: their errors cannot be told from the motion between them. The filter assumes "
            f"{sigma} m, east and north each (variance {r})"
        )
    known = _known(c.log_errors["r"])
    return (
        f"fixes: they scatter around the smoothed line by about {sigma} m, east and north each (variance {r}, "
        f"{known}). Errors that neighbouring fixes share are not in it; the line keeps them"
    )


def _symbol(name, value, unit):
    return NO_BREAK.join([name, "=", _digits(value), unit])


def _known(log_error):
    if log_error < SMALL_ERROR:
        return f"known to {log_error:.0%}"
    return f"known to a factor of {math.exp(log_error):.1f}" if log_error < UNKNOWN else "hardly known"


def _prediction(c):
    b = c.band
    if b is None:
        return "prediction: the track is too short, or its fixes too far apart, to test one"
    few = "" if b.independent >= 30 else f" (only {b.independent} of them apart in time: too few to rely on)"
    return (
        f"prediction: a fix {b.seconds:g} s ahead is predicted to ± {_digits(b.half_width)} m, east and north each, at "
        f"the median of a band that follows the errors made so far. Tested on the second half of the track, with q "
        f"and r of the first: {b.held:.0%} of {b.checked:,} fixes that were not refused lay within the band, and "
        f"{b.asked:.0%} was the aim{few}. The filter's own band, which no errors have corrected, would have held "
        f"{b.own:.0%}."
    )


def distance_and_speeds(c: Cleaned) -> dict[str, float | None]:
    """Return the length (km), the seconds in motion or None, the median speed in motion, the top speed and their error.

    The top speed is the 99.9 % quantile; speeds are in km/h. Lengths and speeds are those on the Earth where the track
    is in degrees, and a rest counts as the straight line from its start to its end. A row is in motion if it is faster
    than MOVING and not in a minute at rest. If too many speeds cannot be told from MOVING, the time in motion is None.
    """
    rows = c.line.rows
    position = c.x[:, :4:2]
    here = position.T[:, rows]
    if c.source is not None and c.source.charts:
        here = earth_centred(*degrees_of(c, position), 0.0)[:, rows]
    speed = np.linalg.norm(velocities_of(c)[rows, :2], axis=1)
    rest = _at_rest(c.line, position[rows], speed)
    same = np.diff(c.line.number) == 0
    kept = np.ones(len(rows), dtype=bool)
    kept[1:-1] = ~(rest[1:-1] & rest[:-2] & rest[2:] & same[:-1] & same[1:])
    steps = np.linalg.norm(np.diff(here[:, kept], axis=1), axis=0)
    seconds = np.diff(c.t[rows])
    moving = (speed > MOVING) & ~rest
    error = math.sqrt(float(np.median(c.P[rows, 1, 1])))
    doubtful = (speed > 0) & (speed < MOVING + 2 * error) & ~rest
    known = error < MOVING or np.mean(doubtful) < DOUBTFUL
    return {
        "kilometres": float(steps[np.diff(c.line.number[kept]) == 0].sum()) / 1000,
        "moving_seconds": float(seconds[moving[1:] & same].sum()) if known else None,
        "median_speed_km_h": float(np.median(speed[moving])) * KM_H if moving.any() else 0.0,
        "fastest_km_h": float(np.quantile(speed, 0.999)) * KM_H,
        "speed_error_km_h": error * KM_H,
    }


def _at_rest(line, position, speed):
    """Tell which rows of a line lie in a minute at rest.

    The fixes of a receiver at rest drift at the speed of a slow walk, but stay in one place: within a minute they
    spread no farther than MOVING would carry them, and half of their speeds are below twice MOVING. A rest may be
    shorter: of each minute it lasts from the first to the last of these speeds.
    """
    rest = np.zeros(len(position), dtype=bool)
    size = int(REST / REST_STEP) + 1
    for k in range(line.number[-1] + 1):
        own = np.flatnonzero(line.number == k)
        t = line.t[own]
        grid = np.arange(t[0], t[-1], REST_STEP)
        if len(grid) < size or len(grid) > 100 * len(own):
            continue
        windows = [sliding_window_view(np.interp(grid, t, each), size) for each in (*position[own].T, speed[own])]
        extent = np.linalg.norm([np.ptp(each, axis=1) for each in windows[:-1]], axis=0)
        still = np.flatnonzero((extent < MOVING * REST) & (np.median(windows[-1], axis=1) < 2 * MOVING))
        slow = windows[-1][still] < 2 * MOVING
        begins = still + np.argmax(slow, axis=1)
        ends = still + size - np.argmax(slow[:, ::-1], axis=1)
        count = np.bincount(begins, minlength=len(grid) + 1) - np.bincount(ends, minlength=len(grid) + 1)
        among = np.cumsum(count) > 0  # grid points inside such a rest
        rest[own] = among[np.minimum(np.searchsorted(grid, t), len(grid) - 1)]
    return rest


def _distance(c):
    way = distance_and_speeds(c)
    moving = way["moving_seconds"]
    motion = "" if moving is None else f", in motion for {_clock(moving)}"
    return (
        f"way: {way['kilometres']:.2f} km{motion}. Speed in motion: {way['median_speed_km_h']:.1f} km/h at the median; "
        f"one fix in a thousand is faster than {way['fastest_km_h']:.1f} km/h. The filter states a standard error of "
        f"{_digits(way['speed_error_km_h'])} km/h"
    )


def _digits(value):
    """Return a number with two significant digits, without an exponent where that stays readable."""
    if value == 0 or not 1e-4 <= abs(value) < 1e6:
        return f"{value:.1e}"
    return f"{value:.{max(0, 1 - math.floor(math.log10(abs(value))))}f}"
