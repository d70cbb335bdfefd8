"""Recorded tracks: from a GPX file, or from latitudes and longitudes, to times in seconds and positions in metres.

It needs two packages more, the extra `tracks`: pip install "mpt_helpers[tracks]".
"""

from __future__ import annotations

import bisect
import codecs
import itertools
import math
import re
import warnings
from datetime import UTC, datetime
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from . import checks
from .checks import Array


class Track(NamedTuple):
    """A segment of a recorded track.

    t (N,): times in s since `start`
    z (N, 2) or (N, 3): metres east and north of the origin, and above it; a height is NaN where the file has none
    origin: latitude and longitude (°) and height (m) that z counts from: the segment's first ones, or those given
    start: the time of the first fix of the file that was kept
    """

    t: Array
    z: Array
    origin: tuple[float, float, float]
    start: datetime


def gpx(
    path: str | PathLike[str],
    up: bool = False,
    skip: bool = False,
    pause: float | None = None,
    origin: tuple[float, ...] | None = None,
) -> list[Track]:
    """Return the track segments of a GPX file as a list of Tracks; segments without a fix are left out.

    Segments stay apart, since between two of them the receiver was switched off or the file's author put tracks
    together: filter each for itself. With `pause`, a segment is also cut wherever its next fix comes more than so many
    seconds later. Each segment lies in the plane through its own first fix, where z is 0, since segments may be far
    apart; `origin`, a latitude, a longitude and, if wanted, a height (m), puts all of them into one plane. With up=True
    a third column has the heights.

    Every fix needs a time, later than that of the one before in its segment: an equal time is almost always one fix
    written twice or the rounding of times, and would count as two independent measurements. skip=True leaves out as few
    fixes as will do, and warns how many.

    Raises ValueError for a file that is no GPX, holds no tracks (routes and waypoints have no times), or has fixes that
    are out of order, have no time or no degrees, of which the first is named, for a pause that is not positive and an
    origin that is none; ImportError without gpxpy and pymap3d.
    """
    if pause is not None:
        pause = checks.positive("pause", pause)
    if origin is not None:
        origin = _origin(origin)
    import gpxpy

    data = Path(path).read_bytes()
    try:
        text = data.decode(_encoding(data))
        prefixed = re.search(r"<(\w+):gpx\b", text)
        if prefixed:  # gpxpy knows names without a prefix only
            text = re.sub(f"(</?){prefixed[1]}:", r"\1", text)
        document = gpxpy.parse(text)
    except (gpxpy.gpx.GPXException, UnicodeDecodeError, LookupError) as error:
        raise ValueError(f"{path}: needs a GPX file, got one that cannot be read ({error})") from error
    segments = [segment.points for track in document.tracks for segment in track.segments]
    if not any(point.time for points in segments for point in points):
        raise ValueError(f"{path}: needs a recorded track, got {len(segments)} track segments and no times")
    kept, left_out = [], 0
    for number, points in enumerate(segments, start=1):
        _check_degrees(path, number, points)
        rows, wrong = _in_order(points)
        if wrong and not skip:
            row, why = wrong[0]
            got = f"{why} in fix {row + 1} of segment {number} ({len(wrong)} such of its {len(points)} fixes)"
            raise ValueError(f"{path}: needs times that increase, got {got}; gpx(path, skip=True) leaves them out")
        left_out += len(wrong)
        if rows:
            kept.append([points[row] for row in rows])
    if left_out:
        warnings.warn(f"{path}: {left_out} fixes left out whose times are missing or do not increase", stacklevel=2)
    start = _time(kept[0][0])
    if pause is not None:
        kept = [part for points in kept for part in _apart(points, pause)]
    return [_track(points, start, origin, up) for points in kept]


def local(lat: ArrayLike, lon: ArrayLike, origin: tuple[float, ...] | None = None) -> Array:
    """Return positions in metres east and north of an origin, (N, 2), from latitudes and longitudes (N,) in degrees.

    origin is a latitude, a longitude and, if they are given, a height (m); without one it is the first position. The
    positions lie in the plane that touches the Earth at the origin: 100 km away lengths are 0.01 % too short. NaN
    stays NaN. Raises ValueError for other shapes, degrees that are none and an origin that is none, ImportError without
    pymap3d.

    >>> local([57.0, 57.0009], [9.9, 9.9]).round(1) + 0.0
    array([[  0. ,   0. ],
           [  0. , 100.2]])
    """
    lat, lon = checks.real_numbers("lat", lat, "latitudes"), checks.real_numbers("lon", lon, "longitudes")
    if lat.ndim != 1 or lat.shape != lon.shape or not lat.size:
        checks.refuse("lat, lon", "as many latitudes as longitudes, in one dimension", f"{lat.shape} and {lon.shape}")
    (there,) = np.nonzero(~np.isnan(lat) & ~np.isnan(lon))
    if not there.size or np.abs(lat[there]).max() > 90 or np.abs(lon[there]).max() > 360:
        checks.refuse("lat, lon", "degrees of at most 90 and 360", "others: none, metres, or the two exchanged")
    lat_0, lon_0, height = _origin((lat[there[0]], lon[there[0]]) if origin is None else origin)
    import pymap3d

    east, north, _ = pymap3d.geodetic2enu(lat, lon, height, lat_0, lon_0, height)
    return np.column_stack([east, north]) + 0.0  # without -0.0


def _encoding(data):
    """Return the encoding of an XML file: UTF-16 by its mark, what it declares, or UTF-8."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    declared = re.search(rb"""encoding\s*=\s*["']([\w-]+)""", data[:200])
    return declared[1].decode() if declared else "utf-8"


def _origin(origin):
    """Return an origin as latitude, longitude and height, 0 m where it has none."""
    values = np.ravel(checks.real_numbers("origin", origin, "a latitude and a longitude")).astype(float)
    if len(values) not in (2, 3) or not np.isfinite(values).all() or abs(values[0]) > 90 or abs(values[1]) > 360:
        checks.refuse("origin", "a latitude, a longitude (°) and, if wanted, a height (m)", f"{origin!r:.60}")
    return (*values[:2].tolist(), float(values[2]) if len(values) == 3 else 0.0)


def _check_degrees(path, number, points):
    """Refuse a segment with a fix that lies nowhere on the Earth."""
    for row, point in enumerate(points):
        if not (abs(point.latitude) <= 90 and abs(point.longitude) <= 360):  # nor is NaN
            got = f"{point.latitude:g} and {point.longitude:g} in fix {row + 1} of segment {number}"
            raise ValueError(f"{path}: needs latitudes and longitudes of at most 90 and 360 degrees, got {got}")


def _in_order(points):
    """Return the rows of the most fixes whose times increase, and the other rows, each with what is wrong.

    So one clock error does not cost all that follows it. It is the longest increasing subsequence, found from the end:
    of all that are as long, the one that starts latest can be continued by most (Fredman 1975).
    """
    starts, after = [], {}  # for each length (-time, row) of the latest start; the row that follows each
    for row in reversed(range(len(points))):
        if points[row].time is None:
            continue
        turned = -_time(points[row]).timestamp()
        length = bisect.bisect_left(starts, turned, key=lambda start: start[0])
        after[row] = starts[length - 1][1] if length else None
        starts[length : length + 1] = [(turned, row)]  # of two at one time the first stays
    rows, row = [], starts[-1][1] if starts else None
    while row is not None:
        rows.append(row)
        row = after[row]
    return rows, [(row, _what_is_wrong(points, rows, row)) for row in sorted(set(range(len(points))) - set(rows))]


def _what_is_wrong(points, rows, row):
    """Return why a fix was left out of those that are in order."""
    if points[row].time is None:
        return "no time"
    time = _time(points[row])
    kept = bisect.bisect(rows, row)  # so many come before it
    last = _time(points[rows[kept - 1]]) if kept else None
    if last is None or last < time:
        return f"{time:%Y-%m-%d %H:%M:%S} before an earlier time"
    return f"{time:%Y-%m-%d %H:%M:%S} {'again' if last == time else 'after a later time'}"


def _time(point):
    """Return the time of a fix; where the file names no zone it is UTC, as GPX prescribes."""
    return point.time.replace(tzinfo=UTC) if point.time.tzinfo is None else point.time


def _apart(points, pause):
    """Return the fixes of a segment in parts, cut where the next fix comes more than a pause (s) later."""
    times = [_time(point) for point in points]
    steps = [(later - time).total_seconds() for time, later in itertools.pairwise(times)]
    cuts = [0, *(row + 1 for row, step in enumerate(steps) if step > pause), len(points)]
    return [points[begin:end] for begin, end in itertools.pairwise(cuts)]


def _track(points, start, origin, up):
    """Return fixes as a Track; without an origin it is the first latitude, longitude and height of them."""
    heights = np.array([_height(point) for point in points])
    if origin is None:
        known = heights[np.isfinite(heights)]
        origin = (points[0].latitude, points[0].longitude, float(known[0]) if len(known) else 0.0)
    t = np.array([(_time(point) - start).total_seconds() for point in points])
    z = local([point.latitude for point in points], [point.longitude for point in points], origin)
    if up:
        z = np.column_stack([z, heights - origin[2]])
    return Track(t, z, origin, start)


def _height(point):
    """Return the height of a fix in metres, NaN where the file has none or no number."""
    known = point.elevation is not None and math.isfinite(point.elevation)
    return point.elevation if known else math.nan
