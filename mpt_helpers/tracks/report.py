"""A cleaned track for people: in words, as numbers by name, as a picture, and as a file for maps.

The words need no knowledge of filters; what a specialist looks for stands in brackets.
"""

from __future__ import annotations

import math
import re
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from . import geodesy
from .readers import moment_of, places_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Cleaned = Any  # that of `cleaning`, whose methods call this module
MOVING = 0.5  # m/s, slower than a walk
REST, REST_STEP = 60.0, 2.0  # s: a rest lasts a minute, which is looked at in steps
KM_H = 3.6
COLUMNS = 100  # of a terminal
TOGETHER = "\u00a0"  # a blank at which no line is broken
A_FEW, VAGUE = 0.3, math.log(10)  # errors of a logarithm: below the first one they are a percentage
LISTED = 5  # times of faults
LONG = 3 * 3600.0  # s, from where on the picture counts hours
MOSTLY_PAUSES = 20.0  # a picture that is so many times as long as its rides shows nothing of them
# The picture: panels one below the other, 5.2 inches wide, so that text of 11 pt is legible on a phone 358 pixels wide.
WIDTH, MAP_HEIGHT, SPEED_HEIGHT = 5.2, 5.0, 3.2
LONGEST_LINE = 5_000  # points that are drawn of a curve
# A usual recording is neither so fast nor so slow: a fighter's speed, a snail's. Between fixes of RARELY or more a
# tenth of a second may lie, in milliseconds. A larger share of fixes than MANY is hardly one of faults.
VERY_FAST, VERY_SLOW = 400.0, 0.02  # m/s
RARELY = 100.0  # s
MANY = 0.1
NUMBERS = 5  # steps of an axis at most: six numbers of five digits fit
# The tag that a fix begins with. A value in quotes may hold a >.
START_TAG = re.compile(rb"<(?:[^>\"']|\"[^\"]*\"|'[^']*')*>")


def text(c: Cleaned) -> str:
    """Return the report of a Cleaned."""
    lines = [_heading(c), *_faults(c), _motion_line(c), _precision(c), _prediction(c), _way(c)]
    lines += [f"note: {each}" for each in _notes(c)]
    filled = [fill(line, COLUMNS, subsequent_indent="  ", break_on_hyphens=False) for line in lines]
    return "\n".join(filled).replace(TOGETHER, " ")


def summary(c: Cleaned) -> dict[str, Any]:
    """Return the numbers of the report; infinite and missing ones are None."""
    band = None
    if c.band is not None:
        b = c.band
        band = {"seconds": b.seconds, "half_width": b.half_width, "asked": b.asked, "held": b.held, "own": b.own}
        band |= {"checked": b.checked, "independent": b.independent}
    left_out = {} if c.source is None else c.source.left_out
    fixes = len(c.t) + sum(left_out.values())
    kilometres, moving, speed, fastest, error = _numbers_of_the_way(c)
    return {
        "fixes": fixes,
        "refused": _of_file(c, c.refused),
        "starts": _of_file(c, c.starts),
        "left_out": left_out,
        "stretches": c.stretches,
        "q": c.q,
        "r": c.r,
        "r_is_rounding": c.rounding,
        "log_errors": {name: error if math.isfinite(error) else None for name, error in c.log_errors.items()},
        "ahead": band,
        "kilometres": kilometres,
        "moving_seconds": moving,
        "median_speed_km_h": speed,
        "fastest_km_h": fastest,
        "speed_error_km_h": error,
        "notes": _notes(c),
    }


def _notes(c):
    """Return what was taken for what, and what is unusual, in words."""
    return [*([] if c.source is None else c.source.said), *c.said, *c.unusual]


def unusual(c: Cleaned) -> list[str]:
    """Return what is unusual for a recorded track, as questions: it may be in other units, or have too few digits.

    Times in milliseconds that are taken for seconds make a quarter of an hour of each second, and a snail of a car: a
    track that hardly moves is asked about, and one with rare fixes that would be no faster than a usual one.
    """
    found = []
    fixes = np.isfinite(c.z).all(axis=1) & c.mask
    seconds, moved = np.diff(c.t[fixes]), np.linalg.norm(np.diff(c.z[fixes], axis=0), axis=1)
    later = seconds > 0
    if later.any():
        in_degrees = c.source is not None and bool(c.source.charts)
        found += _of_speeds(moved[later] / seconds[later], float(np.median(seconds[later])), in_degrees)
    share = _share_refused(c)
    if share > MANY:
        many = f"{share:.0%} of the fixes are refused. So many are hardly faults"
        found.append(f"ATTENTION: {many}: are digits missing, or is the noise large?")
    return found


def _of_speeds(speeds, step, in_degrees):
    """Ask about units where the speed (m/s) that 99 of 100 steps have at most is unusual for a usual step (s)."""
    speed = float(np.quantile(speeds, 0.99))
    rarely = f", with a fix every {step:g} s" if step >= RARELY else ""
    if speed > VERY_FAST:
        units = "degrees" if in_degrees else "metres, not millimetres"
        seen = f"one step in a hundred is faster than {speed:.0f} m/s"
        return [f"ATTENTION: {seen}: are the times in seconds, and the positions in {units}?"]
    if speed == 0:
        return ["ATTENTION: 99 of 100 fixes stand where the one before them stood: are digits missing?"]
    if speed < VERY_SLOW or (rarely and speed < VERY_FAST / 1000):
        units = "" if in_degrees else ", and the positions in metres, not degrees or kilometres"
        seen = f"99 of 100 steps are slower than {speed:.1g} m/s{rarely}"
        return [f"ATTENTION: {seen}: are the times in seconds, not milliseconds{units}?"]
    return []


def _share_refused(c):
    return len(c.refused) / max(np.isfinite(c.z).any(axis=1).sum(), 1)


def _of_file(c, rows):
    return (rows if c.source is None else c.source.rows[rows]).tolist()


def _clock(seconds):
    minutes, seconds = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{seconds:02d}"


def _count(number, one, many=None):
    return f"{number:,} {one if number == 1 else many or one + 's'}"


def _heading(c):
    name = "" if c.source is None else f"{c.source.path.name}: "
    steps = np.diff(c.t[np.isfinite(c.z).any(axis=1)])
    steps = steps[steps >= 0]
    usual = float(np.median(steps))
    every = f"every {usual:g} s" if np.mean(steps == usual) > 0.99 else f"mostly every {usual:g} s"
    parts = [f"{name}{_count(len(c.t), 'fix', 'fixes')} in {_clock(np.ptp(c.t[c.line.rows]))}, {every}"]
    if len(c.recordings) > 1:
        parts.append(f"in {len(c.recordings)} parts (pauses, or segments of the file)")
    return "; ".join(parts)


def _faults(c):
    lines = []
    if c.source is not None and c.source.left_out:
        why = ", ".join(f"{count:,} with {reason}" for reason, count in c.source.left_out.items())
        lines.append(f"not used: {why}")
    if len(c.refused):
        fixes = _count(len(c.refused), "fix", "fixes")
        lines.append(f"refused as faults: {fixes} ({_share_refused(c):.2%}), {_moments(c, _first_of_runs(c.refused))}")
    else:
        lines.append("refused as faults: none")
    if len(c.starts):
        lines.append(f"jumps that stay: {len(c.starts)}, {_moments(c, c.starts)}; the smoothed line begins anew there")
    return lines


def _moments(c, rows):
    """Say when the first few of some rows were recorded."""
    seconds = c.t[rows] - c.t[c.line.rows].min()
    seconds = seconds[(seconds >= 0) & (seconds <= np.ptp(c.t[c.line.rows]))]  # without faults of time
    when = ", ".join(map(_clock, seconds[:LISTED]))
    return (
        f"{when}{', ...' if len(seconds) > LISTED else ''} after the start" if len(seconds) else "at impossible times"
    )


def _first_of_runs(rows):
    return rows[np.diff(rows, prepend=-2) > 1]


def _motion_line(c):
    change = math.sqrt(c.q)
    return (
        f"motion: from one second to the next the speed changes by about {_digits(change)} m/s, east and north each "
        f"({_symbol('q', c.q, 'm²/s³')}, {_known(c.log_errors['q'])})"
    )


def _precision(c):
    if c.rounding:
        return (
            "fixes: the recorder had smoothed them already, so how far they are from the true way does not show; they "
            f"count as exact to {_digits(math.sqrt(c.r))} m, the last digit of the numbers ({_symbol('r', c.r, 'm²')})"
        )
    known = _known(c.log_errors["r"])
    return (
        f"fixes: each scatters around the line by about {_digits(math.sqrt(c.r))} m, east and north each "
        f"({_symbol('r', c.r, 'm²')}, {known})"
    )


def _symbol(name, value, unit):
    return TOGETHER.join([name, "=", _digits(value), unit])


def _known(log_error):
    if log_error < A_FEW:
        return f"known to {log_error:.0%}"
    return f"known to a factor of {math.exp(log_error):.1f}" if log_error < VAGUE else "hardly known"


def _prediction(c):
    b = c.band
    if b is None:
        return "prediction: the track is too short, or its fixes too far apart, to test one"
    few = "" if b.independent >= 30 else f" (only {b.independent} of them apart in time: too few to rely on)"
    parts = [
        f"prediction: {b.seconds:g} s ahead the position can be told to ± {_digits(b.half_width)} m, east and north",
        f"each. Tested on the second half of the track, from which nothing was learnt beforehand: {b.held:.0%} of",
        f"{b.checked:,} fixes lay within, {b.asked:.0%} was the aim{few}. The band that the filter states by itself,",
        f"without a test, would have held {b.own:.0%}.",
    ]
    return " ".join(parts)


def _numbers_of_the_way(c):
    """Return km, seconds in motion or None, the median speed in motion, the fastest but 0.1 %, and their error (km/h).

    Of a track with charts the way is that on the Earth; of a rest it is the straight line from its start to its end. In
    motion is a row that is faster than MOVING and does not lie
    in a minute at rest (`_at_rest`); it is not known where the error of the speed is as large as MOVING.
    """
    rows = c.line.rows
    position, velocity = c.x[rows][:, :4:2], c.x[rows][:, 1:4:2]
    speed, on_earth = np.linalg.norm(velocity, axis=1), position.T
    if c.source is not None and c.source.charts:
        for k, chart in enumerate(c.source.charts):
            own = c.source.plane[rows] == k
            speed[own] = chart.speed(position[own], velocity[own])
        lat, lon = degrees_of(c)
        on_earth = geodesy.earth_centred(lat[rows], lon[rows], 0.0)
    rest = _at_rest(c.line, position, speed)
    same = np.diff(c.line.number) == 0
    kept = np.ones(len(rows), dtype=bool)
    kept[1:-1] = ~(rest[1:-1] & rest[:-2] & rest[2:] & same[:-1] & same[1:])
    steps = np.linalg.norm(np.diff(on_earth[:, kept], axis=1), axis=0)
    seconds = np.diff(c.t[rows])
    moving = (speed > MOVING) & ~rest
    error = math.sqrt(float(np.median(c.P[rows, 1, 1])))
    median = float(np.median(speed[moving])) if moving.any() else 0.0
    return (
        float(steps[np.diff(c.line.number[kept]) == 0].sum()) / 1000,
        float(seconds[moving[1:] & same].sum()) if error < MOVING else None,
        median * KM_H,
        float(np.quantile(speed, 0.999)) * KM_H,
        error * KM_H,
    )


def _at_rest(line, position, speed):
    """Tell which rows of a line lie in a minute at rest.

    The error of a receiver that stands wanders, at the speed of a slow walk. But it leads nowhere: such a minute stays
    within the way that MOVING makes in it, and half of its speeds are below twice MOVING.
    """
    rest = np.zeros(len(position), dtype=bool)
    half = REST / REST_STEP / 2
    for k in range(line.number[-1] + 1):
        own = np.flatnonzero(line.number == k)
        t = line.t[own]
        grid = np.arange(t[0], t[-1], REST_STEP)
        size = int(2 * half) + 1
        if len(grid) < size or len(grid) > 100 * len(own):
            continue
        windows = [sliding_window_view(np.interp(grid, t, each), size) for each in (*position[own].T, speed[own])]
        extent = np.linalg.norm([np.ptp(each, axis=1) for each in windows[:-1]], axis=0)
        calm = (extent < MOVING * REST) & (np.median(windows[-1], axis=1) < 2 * MOVING)
        among = np.convolve(calm, np.ones(size))[: len(grid)] > 0.5  # the steps of the grid that a calm minute holds
        rest[own] = among[np.minimum(np.searchsorted(grid, t), len(grid) - 1)]
    return rest


def _way(c):
    kilometres, moving, speed, fastest, error = _numbers_of_the_way(c)
    motion = "" if moving is None else f", in motion for {_clock(moving)}"
    return (
        f"way: {kilometres:.2f} km{motion}. Speed in motion: {speed:.1f} km/h at the median, {fastest:.1f} at most, "
        f"but for one fix in a thousand; standard error {_digits(error)} km/h"
    )


def _stretch_of_rows(c):
    """Return the segment of every row that lies in one, refused ones too, and -1 of others."""
    number = np.full(len(c.t), -1)
    number[c.line.rows] = c.line.number
    return number


def _digits(value):
    """Return a number with two digits that count, without an exponent where it is readable without."""
    if value == 0 or not 1e-4 <= abs(value) < 1e6:
        return f"{value:.1e}"
    return f"{value:.{max(0, 1 - math.floor(math.log10(abs(value))))}f}"


def degrees_of(c: Cleaned) -> tuple[np.ndarray, np.ndarray]:
    """Return latitudes and longitudes (N,) of the smoothed track, NaN outside of stretches."""
    lat, lon = np.full(len(c.t), np.nan), np.full(len(c.t), np.nan)
    inside = np.isfinite(c.x[:, 0])
    for k, chart in enumerate(c.source.charts):
        own = inside & (c.source.plane == k)
        lat[own], lon[own] = chart.degrees(c.x[own, :4:2])
    recorded = c.source.recording.lon[c.source.rows]
    return lat, lon + 360 * np.round((recorded - lon) / 360)  # as the file counts them


def gpx_bytes(c: Cleaned) -> bytes:
    """Return the smoothed track as the bytes of a GPX file."""
    if c.source is None or c.source.recording.metres is not None:
        raise ValueError("gpx: needs a track in degrees, from a file; this one has metres only")
    lat, lon = degrees_of(c)
    new_segments = set(c.starts.tolist())
    if c.source.recording.places is None:
        return _plain_gpx(c, lat, lon, new_segments)
    data, places = places_of(c.source.path, c.source.recording)
    row_of = {int(fix): row for row, fix in enumerate(c.source.rows)}
    pieces, at = [], 0
    for fix, (begin, end) in enumerate(places.tolist()):
        pieces.append(data[at:begin])
        opening = START_TAG.match(data, begin)[0]
        # Of an element without content, <trkpt .../>, the end is that of its tag.
        at = begin + len(opening) if opening.endswith(b"/>") else data.index(b">", end) + 1
        row = row_of.get(fix)
        if row is None or math.isnan(lat[row]):
            continue
        if row in new_segments:
            prefix = re.match(rb"<([\w.-]+:)?trkpt", opening)[1] or b""
            pieces.append(b"</%strkseg><%strkseg>" % (prefix, prefix))
        pieces.append(_with_number(_with_number(opening, b"lat", lat[row]), b"lon", lon[row]))
        pieces.append(data[begin + len(opening) : at])
    pieces.append(data[at:])
    return _signed(b"".join(pieces))


def _with_number(tag, name, value):
    return re.sub(rb"(\s%s\s*=\s*)(\"[^\"]*\"|'[^']*')" % name, rb'\g<1>"%.8f"' % value, tag, count=1)


def _signed(data):
    """Return a GPX file with a line that says what made it, after the declaration."""
    said = b"<!-- smoothed by mpt_helpers: refused fixes lie on the smoothed line, or are left out -->\n"
    declaration = re.match(rb"\s*(\xef\xbb\xbf)?<\?xml.*?\?>\s*", data, re.DOTALL)
    at = declaration.end() if declaration else 0
    return data[:at] + said + data[at:]


def _plain_gpx(c, lat, lon, new_segments):
    recording = c.source.recording
    lines = ['<?xml version="1.0" encoding="UTF-8"?>']
    lines.append('<gpx version="1.1" creator="mpt_helpers" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>')
    for row in np.flatnonzero(np.isfinite(lat)).tolist():
        if row in new_segments:
            lines.append("</trkseg><trkseg>")
        fix = c.source.rows[row]
        height = recording.height[fix]
        ele = f"<ele>{height:.2f}</ele>" if math.isfinite(height) else ""
        time = moment_of(recording.time[fix]).isoformat().replace("+00:00", "Z")
        lines.append(f'<trkpt lat="{lat[row]:.8f}" lon="{lon[row]:.8f}">{ele}<time>{time}</time></trkpt>')
    lines.append("</trkseg></trk></gpx>\n")
    return _signed("\n".join(lines).encode())


def csv_bytes(c: Cleaned) -> bytes:
    """Return the smoothed track of a file in metres as a table, with a line of names."""
    recording = c.source.recording
    lines = ["# smoothed by mpt_helpers", "t_s,east_m,north_m,v_east,v_north,refused"]
    number = _stretch_of_rows(c)
    for row in np.flatnonzero(number >= 0).tolist():
        seconds = recording.time[c.source.rows[row]] / 1e6
        x = c.x[row]
        refused = int(c.pieces[row] < 0)
        lines.append(f"{seconds:.6f},{x[0]:.4f},{x[2]:.4f},{x[1]:.4f},{x[3]:.4f},{refused}")
    return "\n".join([*lines, ""]).encode()


def figure(c: Cleaned) -> Figure:
    """Return the picture of a Cleaned: the map, and below it the speed with its band."""
    import matplotlib
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    from .style import COLOURS, STYLE

    with matplotlib.rc_context(STYLE):
        fig = Figure(figsize=(WIDTH, MAP_HEIGHT + SPEED_HEIGHT), layout="constrained")
        axes = fig.subplots(2, 1, height_ratios=[MAP_HEIGHT, SPEED_HEIGHT])
        blue, orange, green, pink = COLOURS[:4]
        _draw_map(axes[0], c, line=blue, refused=orange, start=green)
        _draw_speed(axes[1], c, line=blue, refused=orange, band=pink)
        handles, labels = (a + b for a, b in zip(*(ax.get_legend_handles_labels() for ax in axes), strict=True))
        fig.legend(handles, labels, loc="outside lower center", ncols=2)
        for ax in axes:
            ax.xaxis.set_major_locator(MaxNLocator(NUMBERS))
    return fig


def _on_one_map(c, z):
    """Return positions (N, 2) in km in one plane."""
    if c.source is None or len(c.source.charts) <= 1:
        return z / 1000
    far = np.empty_like(z)
    for k, chart in enumerate(c.source.charts):
        own = c.source.plane == k
        far[own] = c.source.charts[0].metres(*chart.degrees(np.nan_to_num(z[own]))) / 1000
    return np.where(np.isnan(z), np.nan, far)


def _thinned(rows):
    return rows[:: max(1, len(rows) // LONGEST_LINE)]


def _draw_map(ax, c, line, refused, start):
    position = _on_one_map(c, c.x[:, :4:2])
    if position.shape[1] < 2:
        position = np.column_stack([position, np.zeros(len(position))])
    number = _stretch_of_rows(c)
    for k in range(c.stretches):
        rows = _thinned(np.flatnonzero(number == k))
        ax.plot(*position[rows].T, color=line, linewidth=1.4, label="smoothed" if k == 0 else None)
    inside = np.isfinite(position[:, 0])
    for k, row in enumerate(c.starts):
        before = np.flatnonzero(inside[:row])[-1]
        label = "jumps" if k == 0 else None
        ax.plot(*position[[before, row]].T, ":", color="0.4", linewidth=1.4, label=label)
    low, high = position[inside].min(axis=0), position[inside].max(axis=0)
    margin = 0.08 * max((high - low).max(), 0.01)
    if len(c.refused):
        recorded = _on_one_map(c, c.z)[c.refused]
        near = ((recorded >= low - margin) & (recorded <= high + margin)).all(axis=1)
        off = f", {np.sum(~near)} off the map" if not near.all() else ""
        label = f"refused: {len(c.refused)}{off}"
        ax.plot(*recorded[near].T, "x", color=refused, markersize=6, linestyle="none", label=label)
    first, last = np.flatnonzero(inside)[[0, -1]]
    ax.plot(*position[first], "o", color=start, markersize=7, linestyle="none", label="start")
    ax.plot(*position[last], "s", color="0.2", markersize=6, linestyle="none", label="end")
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_xlabel("east (km)")
    ax.set_title(_title(c), loc="left")
    ax.set_ylabel("north (km)")


def _title(c):
    name = "track" if c.source is None else c.source.path.name
    name = name if len(name) <= 26 else f"{name[:23]}..."
    return f"{name}: {_numbers_of_the_way(c)[0]:.1f} km"


def _time_of_the_picture(c):
    """Return the seconds (N,) since the start, and their name; pauses that leave no room for the rides are left out."""
    t = c.t[c.line.rows]
    ridden = np.where(np.diff(c.line.number) == 0, np.diff(c.line.t), 0.0)
    time = np.full(len(c.t), np.nan)
    if np.ptp(t) <= MOSTLY_PAUSES * ridden.sum():
        inside = (c.t >= t.min()) & (c.t <= t.max())
        time[inside] = c.t[inside] - t.min()
        return time, "time"
    time[c.line.rows] = np.append(0.0, np.cumsum(ridden))
    return time, "time without pauses"


def _draw_speed(ax, c, line, refused, band):
    speed = np.hypot(c.x[:, 1], c.x[:, 3]) if c.x.shape[1] >= 4 else np.abs(c.x[:, 1])
    sigma = np.sqrt(c.P[:, 1, 1])
    time, recorded = _time_of_the_picture(c)
    unit, seconds = ("h", 3600) if np.nanmax(time) > LONG else ("min", 60)
    time = time / seconds
    number = _stretch_of_rows(c)
    for k in range(c.stretches):
        rows = _thinned(np.flatnonzero(number == k))
        low, high = (np.maximum(speed[rows] + sign * 1.96 * sigma[rows], 0) * KM_H for sign in (-1, 1))
        ax.fill_between(
            time[rows], low, high, color=band, alpha=0.6, linewidth=0, label="95 % band" if k == 0 else None
        )
        ax.plot(time[rows], speed[rows] * KM_H, color=line, linewidth=0.9)
    known = speed[np.isfinite(speed)]
    top = 1.25 * max(float(np.quantile(known, 0.999)), 0.1) * KM_H
    ax.set_ylim(0, top)
    if len(c.refused):
        bottom = np.full(len(c.refused), 0.02 * top)
        ax.plot(time[c.refused], bottom, "|", color=refused, markersize=9)
    ax.set_xlabel(f"{recorded} ({unit})")
    ax.set_title("speed (km/h)", loc="left")
