"""Recorded tracks: read, without their faults, smoothed, with a prediction band that was tested on the track itself.

`track` does all of it with a file or a pandas frame, and `clean` with times and positions in metres. `gpx` only reads
segments from a GPX file; `local` and `degrees` convert between degrees and metres.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .. import _checks as checks
from .._checks import Array, Seconds
from .._immutable import types_as_written
from . import geodesy, report
from .cleaning import clean
from .fixes import FEWEST, grid_of
from .readers import MANY, Recording, read, read_frame, to_datetime
from .result import Cleaned, Source

__all__ = ["Cleaned", "Track", "clean", "degrees", "gpx", "local", "track"]


# The largest latitude, longitude (°) and height (m), and the lowest height. A number beyond them counts as missing:
# some files write -32768 where there is no height.
MOST, LOWEST = np.array([90.0, 360.0, 1e5]), -12_000.0
METRES_OF_A_DEGREE = 111_000.0  # of latitude, and of longitude at most
UNSORTED = 0.25  # share of times that run back: if it is larger, the rows are not in order of time
MOST_KNOWN = 0.5  # share of the fixes that must have an accuracy
# The grids that files round to: decimals of degrees, minutes or seconds, or integers of which 2^31 make half a circle.
DECIMALS = tuple(10.0**-k for k in range(10))
GRIDS = (*DECIMALS, *(each / 60 for each in DECIMALS), *(each / 3600 for each in DECIMALS), 180 / 2**31)


@types_as_written
class Track(NamedTuple):
    """A segment of a recorded track.

    Attributes
    ----------
    t : ndarray (N,)
        Times in s since `start`.
    z : ndarray (N, 2) or (N, 3)
        Metres east and north of the origin, and above it; a height is NaN where the file has none.
    origin : tuple of float
        Latitude and longitude (°) and height (m) that z counts from: the segment's first ones, or those given.
    start : datetime
        The time of the first fix of the file that was kept.

    """

    t: Array
    z: Array
    origin: tuple[float, float, float]
    start: datetime


def gpx(
    path: str | PathLike[str],
    up: bool = False,
    skip: bool = False,
    pause: Seconds | None = None,
    origin: tuple[float, ...] | None = None,
) -> list[Track]:
    """Return the track segments of a GPX file; segments without a fix are left out.

    Filter each segment by itself: between two of them the receiver was switched off, or the file's author joined
    tracks. Every fix needs a time, later than that of the one before in its segment: two equal times are almost always
    one fix written twice, or rounded times, and would count as two independent measurements.

    Parameters
    ----------
    path : path
        The GPX file.
    up : bool
        Whether z has the heights as a third column.
    skip : bool
        Whether to leave out, with a warning, fixes without a position or a time, and as few others as possible so that
        times increase.
    pause : float or timedelta, optional
        A segment is also split where its next fix comes more than this later, in s.
    origin : tuple of float, optional
        Latitude and longitude (°) and, if wanted, height (m) of one plane for all segments. By default each segment
        lies in the plane through its own first fix, since segments may be far apart.

    Returns
    -------
    list of Track
        The segments.

    Raises
    ------
    ValueError
        If the file is not GPX or holds no tracks (routes and waypoints have no times). If a fix is out of order, or
        lacks its time or position: the first one is named. Also for a pause that is not positive, and a bad origin.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> for segment in mpt.tracks.gpx("ride.gpx", pause=300.0):  # doctest: +SKIP
    ...     print(segment.start, len(segment.t), "fixes")

    """
    pause = math.inf if pause is None else checks.duration("pause", pause)
    origin = None if origin is None else _origin(origin)
    recording = read(Path(path))
    time, segment = recording.time, recording.segment
    rows, left_out = usable_rows(path, recording)
    why = report.counted(left_out)
    if recording.lat is None or not len(rows):
        checks.refuse(path, "a recorded track in degrees", f"{len(time)} fixes{why and ', '}{why}")
    if left_out and not skip:
        first = np.setdiff1d(np.arange(len(time)), rows)[0]
        where = f"fix {(segment[: first + 1] == segment[first]).sum()} of segment {segment[first]}"
        got = f"{why}, first in {where}; gpx(path, skip=True) leaves them out"
        checks.refuse(path, "a position and a later time in each fix", got)
    if left_out:
        checks.warn(f"{path}: fixes left out: {why}")
    begins = np.flatnonzero((np.diff(segment[rows]) != 0) | (np.diff(time[rows]) > pause * 1e6)) + 1
    return [_track(recording, part, time[rows[0]], origin, up) for part in np.split(rows, begins)]


def local(lat: ArrayLike, lon: ArrayLike, origin: tuple[float, ...] | None = None) -> Array:
    """Return positions in metres east and north of an origin.

    The positions lie in the plane tangent to the Earth at the origin: 100 km away lengths are 0.01 % too short.

    Parameters
    ----------
    lat, lon : array_like (N,)
        Latitudes and longitudes in degrees, NaN where there is none.
    origin : tuple of float, optional
        Latitude, longitude and, if wanted, height (m); the first position where not given.

    Returns
    -------
    ndarray (N, 2)
        Metres east and north, NaN where the position is.

    Raises
    ------
    ValueError
        For other shapes, numbers that are no degrees, and a bad origin.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> mpt.tracks.local([57.0, 57.0009], [9.9, 9.9]).round(1) + 0.0
    array([[  0. ,   0. ],
           [  0. , 100.2]])

    """
    lat, lon = checks.real_numbers("lat", lat, "latitudes"), checks.real_numbers("lon", lon, "longitudes")
    if lat.ndim != 1 or lat.shape != lon.shape or not lat.size:
        checks.refuse("lat, lon", "as many latitudes as longitudes, in one dimension", f"{lat.shape} and {lon.shape}")
    (there,) = np.nonzero(~np.isnan(lat) & ~np.isnan(lon))
    if not there.size or not _on_earth(lat[there], lon[there]).all():
        checks.refuse("lat, lon", "degrees of at most 90 and 360", _no_degrees(lat, lon))
    origin = _origin((lat[there[0]], lon[there[0]]) if origin is None else origin)
    return geodesy.to_plane(lat, lon, origin)


def degrees(z: ArrayLike, origin: tuple[float, ...]) -> tuple[Array, Array]:
    """Return latitudes and longitudes of positions in metres: the inverse of `local`.

    The positions have the height of the origin: 150 km away the plane is 1.8 km above the surface, and this is
    corrected for.

    Parameters
    ----------
    z : array_like (N, 2)
        Metres east and north, NaN where there is no position.
    origin : tuple of float
        Latitude, longitude and, if wanted, height (m), as given to `local`.

    Returns
    -------
    lat : ndarray (N,)
        Latitudes in degrees.
    lon : ndarray (N,)
        Longitudes in degrees, between -180 and 180.

    Raises
    ------
    ValueError
        For another shape, and for a bad origin.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> lat, lon = mpt.tracks.degrees([[0.0, 100.2]], origin=(57.0, 9.9))
    >>> lat.round(4), lon.round(4)
    (array([57.0009]), array([9.9]))

    """
    z = checks.real_numbers("z", z, "positions (N, 2) in metres").astype(float)
    if z.ndim != 2 or z.shape[1] != 2:
        checks.refuse("z", "positions (N, 2) in metres", f"shape {z.shape}")
    return geodesy.from_plane(z, _origin(origin))


def longest_in_order(time: Array) -> Array:
    """Return the rows of the longest increasing subsequence of times (Fredman 1975), NaN where there is none.

    One clock error then costs one fix, not all that follow it.
    """
    known = np.flatnonzero(np.isfinite(time))
    if (np.diff(time[known]) > 0).all():
        return known
    # Of all increasing subsequences of k + 1 rows, the one that ends earliest can be continued by most: ends[k] is its
    # last time, rows[k] its last row, the newest of several at one time; `before` has the row before each one.
    ends: list[Any] = []
    rows: list[Any] = []
    before: dict[Any, Any] = {}
    for row in known.tolist():
        k = bisect.bisect_left(ends, time[row])
        before[row] = rows[k - 1] if k else None
        ends[k : k + 1] = [time[row]]
        rows[k : k + 1] = [row]
    kept, row = [], rows[-1]
    while row is not None:
        kept.append(row)
        row = before[row]
    return np.array(kept[::-1])


def _on_earth(lat, lon):
    """Tell which latitudes and longitudes are degrees; NaN is not."""
    return (np.abs(lat) <= MOST[0]) & (np.abs(lon) <= MOST[1])


def _no_degrees(lat, lon):
    """Return the first two numbers that are no degrees, with what they may be."""
    wrong = np.flatnonzero(np.isfinite(lat) & np.isfinite(lon) & ~_on_earth(lat, lon))
    if not len(wrong):
        return "none"
    ways = "are the two exchanged, are they metres, 1e7 to a degree, or ddmm.mmmm (lat // 100 + lat % 100 / 60)?"
    return f"{lat[wrong[0]]:.10g} and {lon[wrong[0]]:.10g}: {ways}"


def _origin(origin):
    """Return an origin as latitude, longitude and height, 0 m where it has none."""
    values = np.ravel(checks.real_numbers("origin", origin, "a latitude and a longitude")).astype(float)
    if len(values) not in (2, 3) or not np.isfinite(values).all() or (np.abs(values) > MOST[: len(values)]).any():
        checks.refuse("origin", "a latitude, a longitude (°) and, if wanted, a height (m)", f"{origin!r:.60}")
    return (*values[:2].tolist(), float(values[2]) if len(values) == 3 else 0.0)


def _track(recording, rows, start, origin, up):
    """Return fixes as a Track; without an origin it is the first latitude, longitude and height of them."""
    lat, lon, heights = recording.lat[rows], recording.lon[rows], recording.height[rows]
    heights = np.where((heights >= LOWEST) & (heights <= MOST[2]), heights, np.nan)
    if origin is None:
        known = heights[np.isfinite(heights)]
        origin = (float(lat[0]), float(lon[0]), float(known[0]) if len(known) else 0.0)
    z = local(lat, lon, origin)
    if up:
        z = np.column_stack([z, heights - origin[2]])
    return Track((recording.time[rows] - start) / 1e6, z, origin, to_datetime(start))


def track(
    source: str | PathLike[str] | Any,
    *,
    columns: Mapping[str, str] | None = None,
    seconds: Seconds = 10.0,
    limit: float = 100.0,
    pause: Seconds | None = None,
) -> Cleaned:
    """Return the track of a GPX or CSV file, or of a pandas frame, without its faults, smoothed and with a band.

    Each segment is smoothed by itself. Fixes without a position or a time, and those whose time does not increase, are
    left out and counted in `report()`. Fixes are weighted by their accuracy or hdop, where the file states one.
    `to_frame()` of the result gives a frame back.

    Parameters
    ----------
    source : path or frame
        A GPX file; or a CSV file or a frame with the columns `time` (ISO 8601, Unix seconds, or seconds from 0) and
        `lat`, `lon` (°) or `x`, `y` (m). They may have `ele` (m), `hdop` and `accuracy` (m) too. Without a column of
        times, the levels of a frame's index count as columns, and an index of dates is the time.
    columns : dict, optional
        Other names of these columns, as {"time": "when"}.
    seconds : float or timedelta
        The horizon of the band in s, as in `clean`.
    limit : float
        The NIS above which a fix is refused, as in `gated`.
    pause : float or timedelta, optional
        After so long without a fix, in s, a new recording begins, as in `clean`.

    Returns
    -------
    Cleaned
        The cleaned track.

    Raises
    ------
    ValueError
        For a file or frame that holds no recorded track; the message says what it holds instead. Also as `clean`.

    Examples
    --------
    >>> import pandas, mpt_helpers as mpt
    >>> t = pandas.date_range("2024-05-03T10:00", periods=300, freq="s", name="time")
    >>> x = np.cumsum(np.sin(np.arange(300) / 40)) + np.random.default_rng(1).normal(0, 0.5, 300)
    >>> c = mpt.track(pandas.DataFrame({"x": x, "y": x}, index=t))
    >>> c.to_frame().columns.tolist()
    ['time', 'x', 'y', 'v_x', 'v_y', 'sigma', 'sigma_v', 'kept', 'segment']

    """
    is_frame = hasattr(source, "itertuples")  # which neither a path nor a pandas series has
    path = "frame" if is_frame else Path(source)
    recording = read_frame(source, columns) if is_frame else read(path, columns)
    known = recording.time[np.isfinite(recording.time)]
    back = np.sum(np.diff(known) < 0)
    if back > UNSORTED * len(known):
        got = f"{back} of {len(known)} earlier than the one before: frame.sort_values('time') sorts them"
        checks.refuse(path, "times in order", got)
    rows, left_out = usable_rows(path, recording)
    if len(rows) < FEWEST:
        got = ", ".join(filter(None, [f"{len(rows)} of {len(recording.time)}", report.counted(left_out)]))
        checks.refuse(path, f"at least {FEWEST} fixes with a time and a position", got)
    t, segment = recording.time[rows] / 1e6, recording.segment[rows]
    t -= t.min()
    said = [*recording.said, *_notes_on_order(t, segment)]
    if back and len(known) > (1 + MANY) * len(rows):
        said.append("ATTENTION: times run back: was the clock put back, as in autumn, or are these two recordings?")
    if recording.metres is None:
        charts, plane, z = geodesy.charts_of(recording.lat[rows], recording.lon[rows], segment)
        east = np.unwrap(recording.lon[rows], period=360)  # without a step of 360°
        grids = [grid_of(each, GRIDS) * METRES_OF_A_DEGREE for each in (recording.lat[rows], east)]
    else:
        charts, plane, z = [], np.zeros(len(rows), dtype=np.intp), recording.metres[rows]
        grids = [grid_of(column, DECIMALS) for column in z.T]
    relative, weighted = _relative_variances(recording, rows)
    said += weighted
    how = {"seconds": seconds, "limit": limit, "pause": pause}
    c = clean(t, z, relative, segment=segment, rounding=max(grids) ** 2 / 12, **how)
    return replace(c, source=Source(path, recording, rows, left_out, charts, plane, said))


def usable_rows(path: Path | str, recording: Recording) -> tuple[Array, dict[str, int]]:
    """Return the rows of a recording that can be used, and how many others there are by reason."""
    time = recording.time
    if recording.metres is None:
        lat, lon = recording.lat, recording.lon
        somewhere = _on_earth(lat, lon)
        if somewhere.sum() < (1 - MANY) * (np.isfinite(lat) & np.isfinite(lon)).sum():
            checks.refuse(path, "degrees of at most 90 and 360", _no_degrees(lat, lon))
    else:
        somewhere = np.isfinite(recording.metres).all(axis=1)
    timed = np.isfinite(time)
    kept = [np.empty(0, dtype=int)]
    for number in np.unique(recording.segment):
        rows = np.flatnonzero((recording.segment == number) & somewhere & timed)
        kept.append(rows[longest_in_order(time[rows])])
    rows = np.concatenate(kept)
    reasons = {  # each row counts for one
        "no position on the Earth": int((~somewhere).sum()),
        "no time that can be read": int((somewhere & ~timed).sum()),
        "a time that is not after the one before": int((somewhere & timed).sum()) - len(rows),
    }
    return rows, {reason: count for reason, count in reasons.items() if count > 0}


def _notes_on_order(t, segment):
    """Return notes on segments that are not in order of time, or overlap, as those of two receivers do."""
    first = np.flatnonzero(np.append(True, np.diff(segment) != 0))
    starts, ends = np.minimum.reduceat(t, first), np.maximum.reduceat(t, first)
    order = np.argsort(starts, kind="stable")
    if (starts[order][1:] < ends[order][:-1]).any():
        return ["segments overlap in time, as of two receivers: each is a recording of its own"]
    return [] if (np.diff(order) > 0).all() else ["segments are not in order of time"]


def _relative_variances(recording, rows):
    """Return the relative variances (N,) of fixes, or None, and a note on the column that they are from.

    A fix without an entry counts as the median one, if most fixes have one.
    """
    for name in ("accuracy", "hdop"):
        sigma = getattr(recording, name)[rows]
        known = sigma > 0
        if not known.any() or np.ptp(sigma[known]) == 0:
            continue
        if known.mean() > MOST_KNOWN:
            return np.where(known, sigma, np.median(sigma[known])) ** 2, [f"fixes are weighted by their {name}"]
        return None, [f"the {name} is not used: only {known.mean():.0%} of the fixes have one"]
    return None, []
