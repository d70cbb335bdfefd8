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
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import TreeBuilder
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from .._checks import Array
from .doubts import conversion_of, refuse_other_kinds, refuse_several, refuse_signs

NO_TIME = -(2**63)  # a missing time, in microseconds; it is also the integer of numpy's NaT
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
CUT = [expat.errors.codes[words] for words in ("no element found", "unclosed token", "partial character")]
ZONE = re.compile(r"([Zz]|:.*[+-]\d\d(:?\d\d)?)\s*$")
COLUMNS = ("time", "lat", "lon", "x", "y", "ele", "hdop", "accuracy")
MISSING = frozenset(["", "nan", "nat", "none", "null", "na", "n/a", "<na>", "-"])
MANY = 0.1  # share of cells: if more of a column cannot be read, all of it is in another format
# Unix seconds lie between UNIX and LATEST, the years 1973 and 2255. Smaller numbers count as seconds if the first is
# below FROM_ZERO, unless they look like a clock's hhmmss after midnight: steps below CLOCK_STEP, and last two digits
# that are never 60 to 99.
UNIX, LATEST, FROM_ZERO, CLOCK_STEP = 1e8, 9e9, 100.0, 40.0


@dataclass(frozen=True)
class Recording:
    """The N fixes of a file, in file order, faults included."""

    time: NDArray[np.int64]  # microseconds since 1970 in UTC, NO_TIME where there is none
    lat: Array | None  # degrees as written, or None where the file has metres
    lon: Array | None
    metres: Array | None  # x and y (N, 2), or None where the file has degrees
    height: Array  # m, NaN where there is none
    hdop: Array
    accuracy: Array  # the standard deviation that the file states for each fix, m
    segment: NDArray[np.int64]  # the number of the segment that each fix lies in, from 1
    said: tuple[str, ...] = ()  # notes about the file, for the report
    data: bytes = b""  # a whole GPX file; empty for others
    dated: bool = True  # whether times are dates, not numbers
    index: Any = None  # the labels of a frame's rows


def moment_of(time: int) -> datetime:
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
        raise ValueError(f"{path}: needs a file, got a folder, a pipe or a device")
    data, said = path.read_bytes(), []
    if data.startswith(b"\x1f\x8b"):
        file, parts = gzip.GzipFile(fileobj=io.BytesIO(data)), []
        try:
            while part := file.read1():
                parts.append(part)
        except EOFError:
            said.append("ATTENTION: the compressed file is cut off: the rest is lost")
        except (OSError, zlib.error) as error:
            raise ValueError(f"{path}: needs a file that can be decompressed, got a damaged one ({error})") from None
        data = b"".join(parts)
    if data.endswith(b"\0"):
        data = data.rstrip(b"\0")
        said.append("ATTENTION: the file ends in empty bytes: what stood there is lost")
    refuse_other_kinds(path, data)
    return data, said


def _read_gpx(path, data, said):
    """Return the Recording of a GPX file, whose names may have a prefix; if it is cut off, of its complete fixes."""
    fixes, segments = [], 0
    parser, builder = expat.ParserCreate(), TreeBuilder()

    def end(name):
        nonlocal segments
        element, name = builder.end(name), name.rpartition(":")[2]
        if name == "trkseg":
            segments += 1
        elif name == "trkpt":
            texts = {each.tag.rpartition(":")[2]: each.text or "" for each in reversed(element)}  # the first one counts
            inside = (texts.get(what, "") for what in ("time", "ele", "hdop"))
            fixes.append((segments + 1, element.get("lat", ""), element.get("lon", ""), *inside))
            element.clear()

    parser.buffer_text = True
    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = builder.start, end, builder.data
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, LookupError, ValueError) as error:
        if getattr(error, "code", None) not in CUT or not fixes:
            raise ValueError(f"{path}: needs a GPX file, got one that cannot be read ({error})") from None
        said, data = [*said, f"ATTENTION: the file is cut off after {len(fixes)} fixes: the rest is lost"], b""
    if not fixes:
        raise ValueError(f"{path}: needs a recorded track, got no trkpt: routes and waypoints have no times")
    segment, lat, lon, time, height, hdop = map(list, zip(*fixes, strict=True))
    lat, lon = _numbers(path, "lat", lat), _numbers(path, "lon", lon)
    time = _whole_microseconds(path, "time", time, np.array([_microseconds(text) for text in time]), "ISO 8601")
    height, hdop = (np.array([_number(text) for text in texts]) for texts in (height, hdop))
    accuracy = np.full(len(time), math.nan)
    return Recording(time, lat, lon, None, height, hdop, accuracy, np.array(segment), tuple(said), data)


def _number(text):
    """Return the finite number in a text, or NaN."""
    try:
        value = float(text)
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan


def _microseconds(text):
    """Return the time in an ISO 8601 text, in microseconds, or NaN; without a zone it is UTC."""
    try:
        moment = datetime.fromisoformat(text.strip().replace("/", "-"))
        since = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)) - EPOCH
    except (ValueError, OverflowError):
        return math.nan
    return since // timedelta(microseconds=1) if abs(since) < timedelta(seconds=LATEST) else math.nan


def _is_empty(text):
    return text.strip().lower() in MISSING


def _checked(name, column, texts, values, need):
    """Return the values of a column, or refuse it as another format: many cells, or one with a comma, are unread."""
    unread = [texts[row] for row in np.flatnonzero(np.isnan(values)) if not _is_empty(texts[row])]
    if len(unread) > MANY * len(texts) or any("," in text for text in unread):
        raise ValueError(f"{name}: needs {need} in column {column!r}, got {conversion_of(column, unread[0])}")
    return values


def _numbers(name, column, texts):
    """Return the numbers of a column (N,), NaN where there is none."""
    return _checked(name, column, texts, np.array([_number(text) for text in texts]), "decimal numbers")


def _whole_microseconds(name, column, texts, times, need="ISO 8601, Unix seconds, or seconds from 0"):
    """Return times of a column (N,), NaN where there is none, in whole microseconds."""
    times = _checked(name, column, texts, times, need)
    return np.where(np.isnan(times), NO_TIME, times).astype(np.int64)


def _read_csv(path, text, columns, said):
    """Return the Recording of a CSV with a line of names; lines before it that begin with # are skipped."""
    lines = filter(str.strip, re.split(r"[\r\n]+", text))
    lines = list(itertools.dropwhile(lambda line: line.startswith("#"), lines)) or ["nothing"]
    try:
        names, *rows = [next(csv.reader([line])) if '"' in line else line.split(",") for line in lines]
    except csv.Error as error:
        raise ValueError(f"{path}: needs a CSV file, got one that cannot be read ({error})") from None
    if text[-1:] not in "\r\n" and len(rows) > 1 and (said or _is_cut(rows)):
        del rows[-1]
        said = [*said, "ATTENTION: the last line is cut off, and left out"]
    in_turn = zip(lines, [names, *rows], strict=False)
    wrong = [line for line, row in in_turn if line.count('"') % 2 or (len(names) > 1 and any(row[len(names) :]))]
    if wrong:
        skip = "pandas.read_csv(FILE, quoting=3, on_bad_lines='skip').to_csv('new.csv') leaves such lines out"
        way = f"are commas decimal, too? Then put ; between cells. Otherwise {skip}"
        need = f"{len(names)} cells in each line, as in {lines[0]!r:.60}, and quotes that close"
        raise ValueError(f"{path}: needs {need}, got {wrong[0]!r:.60}: {way}")
    cells = [[row[k] if k < len(row) else "" for row in rows] for k in range(len(names))]
    return _from_table(str(path), [name.strip() for name in names], cells, columns, said)


def _is_cut(rows):
    """Tell whether the last row is shorter than 99 % of the others, in cells or in decimals of its last cell."""
    ends = [(len(row), "." in row[-1], len(row[-1].rpartition(".")[2])) for row in rows]
    return ends[-1] < sorted(ends[:-1])[len(ends) // 100]


def read_frame(frame: Any, columns: Mapping[str, str] | None = None) -> Recording:
    """Return the Recording of a pandas frame, whose index may be the time. Raises ValueError for another table."""
    names, values = [str(name) for name in frame.columns], [frame.iloc[:, k] for k in range(len(frame.columns))]
    time = columns.get("time", "time") if isinstance(columns, Mapping) else "time"
    if time not in names and (frame.index.name == time or _kind(frame.index) in ("M", "m")):
        names, values, columns = [*names, "the index"], [*values, frame.index], {**(columns or {}), "time": "the index"}
    return _from_table("frame", names, values, columns, [], frame.index)


def _kind(values):
    return getattr(getattr(values, "dtype", None), "kind", "")


def _from_table(name, names, values, columns, said, index=None):
    """Return the Recording of a table of named columns of numbers, times or texts."""
    found = _named_columns(name, names, {} if columns is None else columns)
    texts = {column: list(map(str, each)) for column, each in zip(names, values, strict=True)}
    numbers = {what: _numbers(name, column, texts[column]) for what, column in found.items() if what != "time"}
    time, dated = _times(name, found["time"], values[names.index(found["time"])], texts[found["time"]])
    others = {column: texts[column] for column in names if column not in found.values()}
    lat, lon, metres = numbers.get("lat"), numbers.get("lon"), None
    if lat is None:
        metres = position = np.column_stack([numbers["x"], numbers["y"]])
    else:
        refuse_signs(name, others, found["lat"], lat, "NORTH", "SOUTH")
        refuse_signs(name, others, found["lon"], lon, "EAST", "WEST")
        position = np.column_stack([lon * np.cos(np.radians(lat)), lat])
    refuse_several(name, others, time, position)
    more = [numbers.get(what, np.full(len(time), math.nan)) for what in ("ele", "hdop", "accuracy")]
    one = np.ones(len(time), dtype=np.int64)
    return Recording(time, lat, lon, metres, *more, one, tuple(said), dated=dated, index=index)


def _named_columns(name, names, columns):
    """Return {what: its column} of a table: the names of COLUMNS, or those given instead."""
    if not isinstance(columns, Mapping) or not set(columns) <= set(COLUMNS):
        need = f"names of some of {', '.join(COLUMNS)}, as {{'time': 'when'}}"
        raise ValueError(f"columns: needs {need}, got {columns!r:.80}")
    found = {what: what for what in COLUMNS if what in names} | dict(columns)
    in_metres = "x" in columns or ("x" in found and "lat" not in found)
    place = ("x", "y") if in_metres else ("lat", "lon")
    got = f"{', '.join(map(ascii, names)):.300}"
    lacking = [what for what in ("time", *place) if what not in found]
    if lacking:
        need = "columns time and lat, lon (degrees) or x, y (metres), with commas between"
        options = " ".join(f"--{what} NAME" for what in lacking)
        way = f"name the others: {options}, or in Python columns={dict.fromkeys(lacking, 'NAME')}"
        if len(names) == 1 and (separator := re.search(r"[;\t| ]", names[0])):
            way = f"pandas.read_csv(FILE, sep={separator[0]!r}, decimal=',').to_csv('new.csv') makes commas"
        raise ValueError(f"{name}: needs {need}, got {got}: {way}")
    found = {what: found[what] for what in ("time", *place, "ele", "hdop", "accuracy") if what in found}
    for what, column in found.items():
        if names.count(column) != 1 or list(found.values()).count(column) != 1:
            raise ValueError(f"{name}: needs one column {column!r} of {what} alone, got {got}")
    return found


def _times(name, column, values, texts):
    """Return times in microseconds, and whether they are dates."""
    if (kind := _kind(values)) in ("M", "m"):
        return np.asarray(values, dtype=f"{kind}8[us]").astype(np.int64), kind == "M"
    times = np.array([_number(text) for text in texts])
    known = times[np.isfinite(times)]
    if len(known) > 0.5 * sum(not _is_empty(text) for text in texts):
        seconds = np.where(_are_seconds(known) & (np.abs(times) < LATEST), times, math.nan)
        return _whole_microseconds(name, column, texts, np.round(seconds * 1e6)), False
    times = np.array([_microseconds(text) for text in texts])
    zoned = [text for text, time in zip(texts, times, strict=True) if math.isfinite(time) and ZONE.search(text)]
    if 0 < len(zoned) < np.isfinite(times).sum():
        way = f"pandas.to_datetime(frame[{column!r}], utc=True, format='ISO8601') where the others are UTC"
        raise ValueError(f"{name}: needs a zone in all times or none, got one in {zoned[0]!r:.40} only: {way}")
    return _whole_microseconds(name, column, texts, times), True


def _are_seconds(times):
    """Tell whether numbers are Unix seconds or seconds from 0, and not the digits of a clock after midnight."""
    usual, step = np.median(times), np.median(np.diff(times)) if len(times) > 1 else 0.0
    clock = step < CLOCK_STEP and times.max() >= FROM_ZERO and (times % 100 < 60).all()
    return UNIX <= usual < LATEST or (0 <= times[0] < FROM_ZERO and usual < LATEST and not clock)
