"""A cleaned track as a GPX file, a table or a pandas frame."""

from __future__ import annotations

import io
import itertools
import math
import re
from typing import TYPE_CHECKING, Any

import numpy as np

from .geodesy import axes_at, earth_centred
from .readers import to_datetime

if TYPE_CHECKING:
    from .result import Cleaned

# A fix of a GPX file: its start tag, and the rest. Comments and CDATA come first, since they hold no fix; a value may
# contain a >.
FIX = re.compile(
    rb"""<!--.*?--> | <!\[CDATA\[.*?\]\]>
    | (?P<tag> <(?P<prefix>(?:[\w.-]+:)?)trkpt(?=[\s/>])(?:[^>"']|"[^"]*"|'[^']*')*> )
      (?P<rest> (?<=/>) | .*?</(?P=prefix)trkpt\s*> )""",
    re.DOTALL | re.VERBOSE,
)


def segment_of_rows(c: Cleaned) -> np.ndarray:
    """Return the segment that each row lies in, refused rows included, and -1 outside of segments."""
    number = np.full(len(c.t), -1)
    number[c.line.rows] = c.line.number
    return number


def degrees_of(c: Cleaned, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return latitudes and longitudes (N,) of positions (N, 2), one for each row of the track, on the row's chart."""
    lat, lon = np.empty(len(z)), np.empty(len(z))
    for k, chart in enumerate(c.source.charts):
        own = c.source.plane == k
        lat[own], lon[own] = chart.degrees(z[own])
    recorded = c.source.recording.lon[c.source.rows]
    return lat, lon + 360 * np.round((recorded - lon) / 360)  # as the file counts them


def velocities_of(c: Cleaned) -> np.ndarray:
    """Return the smoothed velocities (N, m) in m/s, east and north on the Earth where the track is in degrees.

    Far from the middle of a chart its own north is not north, and its metres across are too long.
    """
    position, velocity = c.x[:, ::2], c.x[:, 1::2]
    if c.source is None or not c.source.charts:
        return velocity
    lat, lon = degrees_of(c, position)
    here, in_a_second = earth_centred(lat, lon, 0.0), earth_centred(*degrees_of(c, position + velocity), 0.0)
    return np.einsum("ijn,jn->ni", axes_at(lat, lon)[:2], in_a_second - here)


def gpx_bytes(c: Cleaned) -> bytes:
    """Return the smoothed track as the bytes of a GPX file."""
    if c.source is None or c.source.recording.metres is not None:
        raise ValueError("gpx: needs a track in degrees, from a file; this one has metres only")
    lat, lon = degrees_of(c, c.x[:, :4:2])
    data = c.source.recording.data
    count = sum(found["tag"] is not None for found in FIX.finditer(data))
    if count != len(c.source.recording.time):  # a table, or a GPX file that is cut off: only its fixes are kept
        return _new_gpx(c, lat, lon)
    starts = set(c.starts.tolist())
    fixes, row_of = itertools.count(), {int(fix): row for row, fix in enumerate(c.source.rows)}

    def smoothed(found):
        if found["tag"] is None:
            return found[0]
        row = row_of.get(next(fixes))
        if row is None or math.isnan(lat[row]):
            return b""
        between = b"</%strkseg><%strkseg>" % (found["prefix"], found["prefix"]) if row in starts else b""
        return between + _with_value(_with_value(found["tag"], b"lat", lat[row]), b"lon", lon[row]) + found["rest"]

    return _with_comment(FIX.sub(smoothed, data))


def _with_value(tag, name, value):
    return re.sub(rb"(\s%s\s*=\s*)(\"[^\"]*\"|'[^']*')" % name, rb'\g<1>"%.8f"' % value, tag, count=1)


def _with_comment(data):
    """Return a GPX file with a comment after its declaration that names this package."""
    said = b"<!-- smoothed by mpt_helpers: refused fixes lie on the smoothed line, or are left out -->\n"
    declaration = re.match(rb"\s*(\xef\xbb\xbf)?<\?xml.*?\?>\s*", data, re.DOTALL)
    at = declaration.end() if declaration else 0
    return data[:at] + said + data[at:]


def _new_gpx(c, lat, lon):
    """Return the rows inside of segments as a new GPX file, with one trkseg for each segment."""
    recording, number = c.source.recording, segment_of_rows(c)
    lines = ['<?xml version="1.0" encoding="UTF-8"?>']
    lines.append('<gpx version="1.1" creator="mpt_helpers" xmlns="http://www.topografix.com/GPX/1/1"><trk>')
    for k in range(c.stretches):
        lines.append("<trkseg>")
        for row in np.flatnonzero(number == k).tolist():
            fix = c.source.rows[row]
            height = recording.height[fix]
            ele = f"<ele>{height:.2f}</ele>" if math.isfinite(height) else ""
            time = to_datetime(recording.time[fix]).isoformat().replace("+00:00", "Z")
            lines.append(f'<trkpt lat="{lat[row]:.8f}" lon="{lon[row]:.8f}">{ele}<time>{time}</time></trkpt>')
        lines.append("</trkseg>")
    lines.append("</trk></gpx>\n")
    return _with_comment("\n".join(lines).encode())


def csv_bytes(c: Cleaned) -> bytes:
    """Return the smoothed track of a file in metres as a table, with a line of names."""
    rows = np.flatnonzero(segment_of_rows(c) >= 0)
    seconds = c.source.recording.time[c.source.rows[rows]] / 1e6
    table = np.column_stack([seconds, c.x[rows][:, [0, 2, 1, 3]], c.segments[rows] < 0])
    file, head = io.StringIO(), "# smoothed by mpt_helpers\ntime,x,y,v_x,v_y,refused"
    np.savetxt(file, table, ["%.6f", *["%.4f"] * 4, "%d"], delimiter=",", header=head, comments="")
    return file.getvalue().encode()


def frame_of(c: Cleaned) -> Any:
    """Return a Cleaned as a pandas frame, as `Cleaned.to_frame` says."""
    import pandas

    recording = None if c.source is None else c.source.recording
    time, index = c.t, None
    if recording is not None:
        time = recording.time[c.source.rows] / 1e6
        if recording.dated:
            time = pandas.to_datetime(recording.time[c.source.rows].astype(np.int64), unit="us", utc=True)
        index = c.source.rows if recording.index is None else recording.index[c.source.rows]
    columns: dict[str, Any] = {"time": time}
    if recording is not None and recording.metres is None:
        columns["lat"], columns["lon"] = degrees_of(c, c.x[:, :4:2])
    axes = "xyz"[: c.z.shape[1]] if c.z.shape[1] <= 3 else [f"x{k}" for k in range(c.z.shape[1])]
    columns |= {axis: c.x[:, 2 * k] for k, axis in enumerate(axes)}
    columns |= {f"v_{axis}": each for axis, each in zip(axes, velocities_of(c).T, strict=True)}
    variances = c.P.diagonal(axis1=1, axis2=2)
    columns |= {"sigma": np.sqrt(variances[:, ::2].max(axis=1)), "sigma_v": np.sqrt(variances[:, 1::2].max(axis=1))}
    columns |= {"kept": c.mask, "segment": segment_of_rows(c)}
    return pandas.DataFrame(columns, index=index)
