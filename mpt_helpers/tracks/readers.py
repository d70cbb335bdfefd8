"""Recorded tracks from GPX files, from CSV files of named columns, and from pandas frames.

No format is guessed. A table has `time` (ISO 8601, Unix seconds, or seconds from 0) and `lat`, `lon` (°) or `x`, `y`
(m); it may also have `ele`, `hdop` and `accuracy`. Other names are given as `columns`. Anything else is refused, with
the line of pandas, or the program, that converts it.
"""

from __future__ import annotations

import csv
import gzip
import io
import itertools
import math
import re
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import TreeBuilder
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from .._checks import Array, refuse
from .unsupported import conversion_of, refuse_other_kinds, refuse_several, refuse_signs

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
# What expat says of a file that is cut off.
CUT = ("no element found", "unclosed token", "partial character", "unclosed CDATA section")
COLUMNS = ("time", "lat", "lon", "x", "y", "ele", "hdop", "accuracy")
GPX_COLUMNS = ("time", "lat", "lon", "ele", "hdop")
MISSING = frozenset(["", "nan", "nat", "none", "null", "na", "n/a", "<na>", "-"])
MANY = 0.1  # share of cells: if more of a column cannot be read, all of it is in another format
# Unix seconds lie between UNIX and LATEST, the years 1973 and 2255. Smaller numbers count as seconds if the first is
# below FROM_ZERO, unless they look like a clock's hhmmss after midnight: steps below CLOCK_STEP, and last two digits
# that are never 60 to 99.
UNIX, LATEST, FROM_ZERO, CLOCK_STEP = 1e8, 9e9, 100.0, 40.0


@dataclass(frozen=True)
class Recording:
    """The N fixes of a file, in file order, faults included."""

    time: Array  # whole microseconds since 1970 in UTC, NaN where there is none
    lat: Array | None  # degrees as written, or None where the file has metres
    lon: Array | None
    metres: Array | None  # x and y (N, 2), or None where the file has degrees
    height: Array  # m, NaN where there is none
    hdop: Array
    accuracy: Array  # the standard deviation that the file states for each fix, m
    segment: NDArray[np.int64]  # the number of the segment that each fix lies in, from 1
    said: tuple[str, ...] = ()  # notes about the file, for the report
    data: bytes = field(default=b"", repr=False)  # a whole GPX file; empty for others
    dated: bool = True  # whether times are dates, not numbers
    index: Any = None  # the labels of a frame's rows


def to_datetime(time: float) -> datetime:
    """Return microseconds since 1970 as a datetime."""
    return EPOCH + timedelta(microseconds=int(time))


def read(path: Path, columns: Mapping[str, str] | None = None) -> Recording:
    """Return the Recording of a GPX or CSV file, plain or gzipped. Raises ValueError for another file."""
    data, said = _contents(path)
    if not data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        return _read_csv(path, data.decode("utf-8-sig", errors="replace"), columns, said)
    if columns:
        raise ValueError(f"{path}: is a GPX file, which has no columns to name, got {dict(columns)!r:.80}")
    return _read_gpx(path, data, said)


def _contents(path):
    """Return the uncompressed bytes of a file, and notes if its end is missing."""
    if path.exists() and not path.is_file():
        refuse(path, "a file", "a folder, a pipe or a device")
    data, said = path.read_bytes(), []
    if data.startswith(b"\x1f\x8b"):
        file, parts = gzip.GzipFile(fileobj=io.BytesIO(data)), []
        try:
            while part := file.read1():
                parts.append(part)
        except EOFError:
            said.append("ATTENTION: the compressed file is cut off: the rest is lost")
        except (OSError, zlib.error) as error:
            refuse(path, "a file that can be decompressed", f"a damaged one ({error})")
        data = b"".join(parts)
    if data.endswith(b"\0"):
        data = data.rstrip(b"\0")
        said.append("ATTENTION: the file ends in empty bytes: what stood there is lost")
    refuse_other_kinds(path, data)
    return data, said


def _read_gpx(path, data, said):
    """Return the Recording of a GPX file, whose names may have a prefix; if it is cut off, of its complete fixes."""
    fixes, segment, ended = [], [], 0
    parser, builder = expat.ParserCreate(), TreeBuilder()

    def end(name):
        nonlocal ended
        element, name = builder.end(name), name.rpartition(":")[2]
        if name == "trkseg":
            ended += 1
        elif name == "trkpt":
            texts = {each.tag.rpartition(":")[2]: each.text or "" for each in reversed(element)}  # the first one counts
            texts |= element.attrib
            fixes.append([texts.get(what, "") for what in GPX_COLUMNS])
            segment.append(ended + 1)
            element.clear()

    parser.buffer_text = True
    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = builder.start, end, builder.data
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, LookupError, ValueError) as error:
        if not str(error).startswith(CUT) or not fixes:
            refuse(path, "a GPX file", f"one that cannot be read ({error})")
        said, data = [*said, f"ATTENTION: the file is cut off after {len(fixes)} fixes: the rest is lost"], b""
    if not fixes:
        refuse(path, "a recorded track", "no trkpt: routes and waypoints have no times")
    return _recording(path, GPX_COLUMNS, zip(*fixes, strict=True), None, said, segment=np.array(segment), data=data)


def _read_csv(path, text, columns, said):
    """Return the Recording of a CSV with a line of names; lines before it that begin with # are skipped."""
    lines = filter(str.strip, re.split(r"[\r\n]+", text))
    lines = list(itertools.dropwhile(lambda line: line.startswith("#"), lines)) or ["nothing"]
    if text[-1:] not in "\r\n" and len(lines) > 2 and (said or _is_cut(lines[1:])):
        del lines[-1]
        said = [*said, "ATTENTION: the last line is cut off, and left out"]
    rows, reader = [], csv.reader(lines, strict=True)
    try:
        for row in reader:
            too_many = rows and len(rows[0]) > 1 and any(row[len(rows[0]) :])
            if too_many or reader.line_num > len(rows) + 1:  # a quote was closed in a later line
                raise csv.Error
            rows.append(row)
    except csv.Error:
        need = f"as many cells in each line as in {lines[0]!r:.60}, and quotes that close"
        way = "pandas.read_csv(FILE, quoting=3, on_bad_lines='skip').to_csv('new.csv') leaves such lines out"
        refuse(path, need, f"{lines[len(rows)]!r:.60}: are commas decimal, too? Put ; between cells. Otherwise {way}")
    in_turn = list(itertools.zip_longest(*rows, fillvalue=""))[: len(rows[0])]
    names, cells = [name.strip() for name in rows[0]], [column[1:] for column in in_turn]
    return _recording(path, names, cells, columns, said)


def _is_cut(lines):
    """Tell whether the last line is shorter than 99 % of the others, in cells or in decimals of its last cell."""
    cells = [line.split(",") for line in lines]
    ends = [(len(row), "." in row[-1], len(row[-1].rpartition(".")[2])) for row in cells]
    return ends[-1] < sorted(ends[:-1])[len(ends) // 100]


def read_frame(frame: Any, columns: Mapping[str, str] | None = None) -> Recording:
    """Return the Recording of a pandas frame, whose index may be the time, or have it. Raises ValueError for others."""
    time = columns.get("time", "time") if isinstance(columns, Mapping) else "time"
    table = frame
    if time not in frame.columns:
        table = (frame.rename_axis(time) if frame.index.dtype.kind in "mM" else frame).reset_index()
    cells = [_texts(table.iloc[:, k]) for k in range(len(table.columns))]
    return _recording("frame", list(map(str, table.columns)), cells, columns, [], index=frame.index)


def _texts(column):
    """Return the cells of a pandas column as texts."""
    if column.dtype.kind == "M":  # in UTC, and much faster than one by one
        return column.to_numpy("M8[us]").astype(str).tolist()
    return list(map(str, column.dt.total_seconds() if column.dtype.kind == "m" else column))


def _recording(name, names, cells, columns, said, segment=None, **more):
    """Return the Recording of named columns of texts; segment (N,) numbers the segments of a GPX file."""
    found = _named_columns(name, names, {} if columns is None else columns)
    texts = dict(zip(names, cells, strict=True))
    numbers = {}
    for what, column in found.items():
        if what != "time":
            numbers[what] = _checked(name, column, texts[column], _numbers(texts[column]), "decimal numbers")
    time, dated = _times(name, found["time"], texts[found["time"]], one_zone=segment is None)
    others = {column: texts[column] for column in names if column not in found.values()}
    lat, lon, metres = numbers.get("lat"), numbers.get("lon"), None
    if lat is None:
        metres = position = np.column_stack([numbers["x"], numbers["y"]])
    else:
        position = np.column_stack([lon * np.cos(np.radians(lat)), lat])
        refuse_signs(name, others, found["lat"], lat, "NORTH", "SOUTH")
        refuse_signs(name, others, found["lon"], lon, "EAST", "WEST")
    refuse_several(name, others, time, position)
    height, hdop, accuracy = (numbers.get(what, np.full(len(time), math.nan)) for what in ("ele", "hdop", "accuracy"))
    if segment is None:
        segment = np.ones(len(time), dtype=np.int64)
    return Recording(time, lat, lon, metres, height, hdop, accuracy, segment, tuple(said), dated=dated, **more)


def _named_columns(name, names, columns):
    """Return {what: its column} of a table: the names of COLUMNS, or those given instead."""
    if not isinstance(columns, Mapping) or not set(columns) <= set(COLUMNS):
        refuse("columns", f"names of some of {', '.join(COLUMNS)}, as {{'time': 'when'}}", f"{columns!r:.80}")
    found = {what: what for what in COLUMNS if what in names} | dict(columns)
    in_metres = "x" in columns or ("x" in found and "lat" not in found)
    place = ("x", "y") if in_metres else ("lat", "lon")
    got = f"{', '.join(map(ascii, names)):.300}"
    lacking = [what for what in ("time", *place) if what not in found]
    if lacking:
        options = " ".join(f"--{what} NAME" for what in lacking)
        way = f"name the others: {options}, or in Python columns={dict.fromkeys(lacking, 'NAME')}"
        if len(names) == 1 and (separator := re.search(r"[;\t| ]", names[0])):
            way = f"pandas.read_csv(FILE, sep={separator[0]!r}, decimal=',').to_csv('new.csv') makes commas"
        refuse(name, "columns time and lat, lon (degrees) or x, y (metres), with commas between", f"{got}: {way}")
    found = {what: found[what] for what in ("time", *place, "ele", "hdop", "accuracy") if what in found}
    for what, column in found.items():
        if names.count(column) != 1 or list(found.values()).count(column) != 1:
            refuse(name, f"one column {column!r} of {what} alone", got)
    return found


def _times(name, column, texts, one_zone):
    """Return times in microseconds, and whether they are dates; those without a zone are UTC.

    With `one_zone`, times with a zone among times without one are refused, since the latter may be local.
    """
    times, zoned = np.full(len(texts), math.nan), set()
    for row, text in enumerate(texts):
        try:
            moment = datetime.fromisoformat(text.strip().replace("/", "-"))
        except ValueError:
            continue
        zoned.add(moment.tzinfo is not None)
        moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
        times[row] = (moment - EPOCH) // timedelta(microseconds=1)
    if one_zone and len(zoned) > 1:
        way = f"pandas.to_datetime(frame[{column!r}], utc=True, format='ISO8601') where the others are UTC"
        refuse(name, "a zone in all times or none", f"some of each in column {column!r}: {way}")
    seconds = _numbers(texts)
    times[np.abs(times) >= 1e6 * LATEST] = math.nan
    seconds[np.abs(seconds) >= LATEST] = math.nan
    known = seconds[np.isfinite(seconds)]
    dated = not len(known) or np.isfinite(times).sum() > len(known)
    if not dated:
        times = np.round(1e6 * seconds) if _are_seconds(known) else np.full(len(texts), math.nan)
    return _checked(name, column, texts, times, "ISO 8601, Unix seconds, or seconds from 0"), dated


def _are_seconds(times):
    """Tell whether numbers are Unix seconds or seconds from 0, and not the digits of a clock after midnight."""
    step = np.median(np.diff(times)) if len(times) > 1 else 0.0
    clock = step < CLOCK_STEP and times.max() >= FROM_ZERO and (times % 100 < 60).all()
    return np.median(times) >= UNIX or (0 <= times[0] < FROM_ZERO and not clock)


def _numbers(texts):
    """Return the finite number in each text, NaN where there is none."""
    values = np.full(len(texts), math.nan)
    for row, text in enumerate(texts):
        try:
            values[row] = float(text)
        except ValueError:
            continue
    values[np.isinf(values)] = math.nan
    return values


def _checked(name, column, texts, values, need):
    """Return the values of a column, or refuse it as another format: many cells, or one with a comma, are unread."""
    unread = [texts[row] for row in np.flatnonzero(np.isnan(values)) if texts[row].strip().lower() not in MISSING]
    if len(unread) > MANY * len(texts) or any("," in text for text in unread):
        refuse(name, f"{need} in column {column!r}", conversion_of(column, unread[0]))
    return values
