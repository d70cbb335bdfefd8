"""Recorded tracks from GPX files, from CSV files of named columns, and from pandas frames.

Nothing is guessed: a table has `time` (ISO 8601, Unix seconds, or seconds from 0) and `lat`, `lon` (°) or `x`, `y` (m),
and may have `ele`, `hdop`, `accuracy`. Other names are given as `columns`. All else is refused, with the line that
mends it.
"""

from __future__ import annotations

import codecs
import csv
import gzip
import io
import itertools
import math
import re
import zlib
from array import array
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
from .doubts import refuse_other_kinds, refuse_several, refuse_signs, way_of

NO_TIME = -(2**63)  # a time that is not there, in microseconds; it is also the integer of numpy's NaT
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
CUT = [expat.errors.codes[words] for words in ("no element found", "unclosed token", "partial character")]
LEAP = re.compile(r"(:\d\d):60(?!\d)")  # a leap second is the one before it, and one more
ZONE = re.compile(r"([Zz]|:.*[+-]\d\d(:?\d\d)?)\s*$")
COLUMNS = ("time", "lat", "lon", "x", "y", "ele", "hdop", "accuracy")
MISSING = frozenset(["", "nan", "nat", "none", "null", "na", "n/a", "<na>", "-"])
MANY = 0.1  # of the cells: so many that are no numbers are another way of writing them
# Unix seconds are between these, the years 1973 and 2255. Smaller numbers are seconds only if they count from the first
# fix: the first one is below a hundred then, which no clock's digits are after the first minute of a day. Digits from
# midnight on are never 60 to 99 in a minute, which steps below FORTY seconds do not pass over.
UNIX, LATEST, FROM_ZERO, FORTY = 1e8, 9e9, 100.0, 40.0
FEW = 10  # lines, of which the last one cannot be told to be cut


@dataclass(frozen=True)
class Recording:
    """The fixes of a file in its own order, N of them, faults and all."""

    time: NDArray[np.int64]  # microseconds since 1970 in UTC, NO_TIME where there is none
    lat: Array | None  # degrees as they stand, or None where the file has metres
    lon: Array | None
    metres: Array | None  # x and y (N, 2), or None where the file has degrees
    height: Array  # m, NaN where there is none
    hdop: Array
    accuracy: Array  # the standard deviation of each fix that the file states, m
    segment: NDArray[np.int64]  # the number of the fix' segment, from 1
    unread: dict[int, str]  # what stands in place of a time and cannot be read as one, by row
    said: tuple[str, ...] = ()  # what is to be said of the file
    data: bytes = b""  # of a whole GPX file
    dated: bool = True  # whether times stand there as dates, and not as numbers
    index: Any = None  # the labels of a frame's rows


def microseconds(text: str) -> int:
    """Return an ISO 8601 time in microseconds since 1970, in UTC if it has no zone. Raises ValueError for another text.

    >>> microseconds("1970-01-01T00:00:01.5Z"), microseconds(" 1970-01-01 00:00:60,5+00:00")
    (1500000, 60500000)
    """
    text, leap = LEAP.subn(r"\1:59", text.strip().replace("/", "-"))
    moment = datetime.fromisoformat(text)
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=UTC)
    return (moment - EPOCH) // timedelta(microseconds=1) + leap * 1_000_000


def moment_of(time: int) -> datetime:
    """Return microseconds since 1970 as a datetime."""
    return EPOCH + timedelta(microseconds=int(time))


def read(path: Path, columns: Mapping[str, str] | None = None) -> Recording:
    """Return the Recording of a GPX or CSV file, packed by gzip or not. Raises ValueError for another file."""
    data, said = _contents(path)
    if not data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        return _of_csv(path, data.decode("utf-8-sig", errors="replace"), columns, said)
    if columns:
        raise ValueError(f"{path}: is a GPX file, which has no columns to name, got {dict(columns)!r:.80}")
    return _of_gpx(path, data, said)


def read_gpx(path: Path) -> Recording:
    """Return the Recording of a GPX file. Raises ValueError for another file."""
    return _of_gpx(path, *_contents(path))


def _contents(path):
    """Return the bytes of a file, unpacked and in an encoding where ASCII is ASCII, and what is said of their end."""
    if path.exists() and not path.is_file():
        raise ValueError(f"{path}: needs a file, got a folder, a pipe or a device")
    data, said = path.read_bytes(), []
    if data.startswith(b"\x1f\x8b"):
        file, parts = gzip.GzipFile(fileobj=io.BytesIO(data)), []
        try:
            while part := file.read1():
                parts.append(part)
        except EOFError:
            said.append("ATTENTION: the packed file is cut: what follows is lost")
        except (OSError, zlib.error) as error:
            raise ValueError(f"{path}: needs a file that can be unpacked, got a damaged one ({error})") from None
        data = b"".join(parts)
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        text = data.decode("utf-16", errors="replace")
        data = re.sub(r"\A(<\?xml[^>]*encoding\s*=\s*[\"'])[\w-]+", r"\1UTF-8", text).encode()
    if data.endswith(b"\0"):
        data = data.rstrip(b"\0")
        said.append("ATTENTION: the file ends in empty bytes: what stood there is lost")
    refuse_other_kinds(path, data)
    return data, said


def _of_gpx(path, data, said):
    """Return the Recording of a GPX file; names may have a prefix. Of a file that is cut, the whole fixes."""
    numbers, unread, segments = array("d"), {}, 0
    parser, builder = expat.ParserCreate(), TreeBuilder()

    def end(name):
        nonlocal segments
        element, name = builder.end(name), name.rpartition(":")[2]
        if name == "trkseg":
            segments += 1
        elif name == "trkpt":
            texts = {each.tag.rpartition(":")[2]: each.text or "" for each in element}
            time = _time_of(texts.get("time", ""))
            if math.isnan(time) and not _is_missing(texts.get("time", "")):
                unread[len(numbers) // 6] = texts["time"]
            values = element.get("lat"), element.get("lon"), texts.get("ele"), texts.get("hdop")
            numbers.extend([segments + 1, *map(_number, values), time])
            element.clear()

    parser.buffer_text = True
    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = builder.start, end, builder.data
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, LookupError, ValueError) as error:
        if getattr(error, "code", None) not in CUT or not numbers:
            raise ValueError(f"{path}: needs a GPX file, got one that cannot be read ({error})") from None
        said, data = [*said, f"ATTENTION: the file is cut after {len(numbers) // 6} fixes: what follows is lost"], b""
    segment, lat, lon, height, hdop, time = np.array(numbers).reshape(-1, 6).T
    nothing = np.full(len(time), math.nan)
    return Recording(_whole(time), lat, lon, None, height, hdop, nothing, _whole(segment), unread, tuple(said), data)


def _number(text):
    """Return a number that a text stands for, NaN where it is none or infinite."""
    try:
        value = float(text)
    except (TypeError, ValueError):
        return math.nan
    return value if math.isfinite(value) else math.nan


def _time_of(text):
    """Return the microseconds of a time, NaN where the text is none."""
    try:
        time = microseconds(text)
    except (ValueError, OverflowError):
        return math.nan
    return time if abs(time) < LATEST * 1e6 else math.nan


def _whole(numbers):
    """Return numbers as integers, NO_TIME where they are NaN."""
    return np.where(np.isnan(numbers), NO_TIME, numbers).astype(np.int64)


def _is_missing(text):
    return text.strip().lower() in MISSING


def _of_csv(path, text, columns, said):
    """Return the Recording of a CSV with a line of names. Lines before it that begin with a # are passed over.

    Each line is a row for itself, so that a quote that is never closed costs no other one.
    """
    lines = filter(str.strip, re.split(r"[\r\n]+", text))
    lines = list(itertools.dropwhile(lambda line: line.startswith("#"), lines))
    names, *rows = [next(csv.reader([line])) if '"' in line else line.split(",") for line in lines or ["nothing"]]
    if text[-1:] not in "\r\n" and len(rows) > FEW and len(lines[-1]) < min(map(len, lines[1:-1])):
        del rows[-1], lines[-1]
        said = [*said, "ATTENTION: the last line is cut, and left out"]
    for line, row in zip(lines, [names, *rows], strict=False):
        if line.count('"') % 2 and (row is names or len(row) < len(names)):
            way = "pandas.read_csv(FILE).replace('\\n', ' ', regex=True).to_csv('new.csv')"
            raise ValueError(f"{path}: needs each row in one line, got a quote left open in {line!r:.60}: {way}")
        if len(names) > 1 and any(row[len(names) :]):
            got = f"{len(row)} in {line!r:.60}: are commas decimal, too, or in a text without quotes?"
            way = "pandas.read_csv(FILE, on_bad_lines='skip').to_csv('new.csv') leaves such lines out"
            raise ValueError(f"{path}: needs {len(names)} cells in a line, got {got} {way}")
    cells = [[row[k] if k < len(row) else "" for row in rows] for k in range(len(names))]
    return _of_table(str(path), [name.strip() for name in names], cells, columns, said)


def read_frame(frame: Any, columns: Mapping[str, str] | None = None) -> Recording:
    """Return the Recording of a pandas frame, whose index may hold the times. Raises ValueError for another table."""
    names, index = [str(name) for name in frame.columns], getattr(frame, "index", None)
    values = [frame.iloc[:, k] if hasattr(frame, "iloc") else frame[name] for k, name in enumerate(names)]
    time = columns.get("time", "time") if isinstance(columns, Mapping) else "time"
    if time not in names and (getattr(index, "name", None) == time or _kind(index) in ("M", "m")):
        names, values, columns = [*names, "the index"], [*values, index], {**(columns or {}), "time": "the index"}
    return _of_table("frame", names, values, columns, [], index)


def _kind(values):
    return getattr(getattr(values, "dtype", None), "kind", "")


def _of_table(name, names, values, columns, said, index=None):
    """Return the Recording of a table of named columns of numbers, times or texts."""
    found = _found(name, names, {} if columns is None else columns)
    texts = {column: list(map(str, each)) for column, each in zip(names, values, strict=True)}
    numbers = {what: _numbers(name, column, texts[column]) for what, column in found.items() if what != "time"}
    time, unread, dated = _times(name, found["time"], values[names.index(found["time"])], texts[found["time"]])
    others = {column: texts[column] for column in names if column not in found.values()}
    lat, lon, metres = numbers.get("lat"), numbers.get("lon"), None
    if lat is None:
        metres = place = np.column_stack([numbers["x"], numbers["y"]])
    else:
        refuse_signs(name, others, found["lat"], lat, ("NORTH", "SOUTH"))
        refuse_signs(name, others, found["lon"], lon, ("EAST", "WEST"))
        place = np.column_stack([lon * np.cos(np.radians(lat)), lat])
    refuse_several(name, others, time, place)
    more = [numbers.get(what, np.full(len(time), math.nan)) for what in ("ele", "hdop", "accuracy")]
    one = np.ones(len(time), dtype=np.int64)
    return Recording(time, lat, lon, metres, *more, one, unread, tuple(said), dated=dated, index=index)


def _found(name, names, columns):
    """Return {what: its column} of a table: the names of COLUMNS, or those given instead."""
    if not isinstance(columns, Mapping) or not set(columns) <= set(COLUMNS):
        need = f"names of some of {', '.join(COLUMNS)}, as {{'time': 'when'}}"
        raise ValueError(f"columns: needs {need}, got {columns!r:.80}")
    found = {what: what for what in COLUMNS if what in names} | dict(columns)
    in_degrees = {"lat", "lon"} <= set(found) and not {"x", "y"} & set(columns)
    place, unused = (("lat", "lon"), ("x", "y")) if in_degrees else (("x", "y"), ("lat", "lon"))
    got = f"{', '.join(map(ascii, names)):.300}"
    if not {"time", *place} <= set(found):
        need = "columns time and lat, lon (degrees) or x, y (metres), with commas between"
        way = "name others: --time when --lat y ..., or columns={'time': 'when', 'lat': 'y', ...}"
        if re.search(r"[;\t|]", "".join(names)):
            way = "of ; or tabs make commas: pandas.read_csv(FILE, sep=';', decimal=',').to_csv('new.csv')"
        raise ValueError(f"{name}: needs {need}, got {got}: {way}")
    found = {what: column for what, column in found.items() if what not in unused}
    for what, column in found.items():
        if names.count(column) != 1 or list(found.values()).count(column) != 1:
            raise ValueError(f"{name}: needs one column {column!r} of {what} alone, got {got}")
    return found


def _numbers(name, column, texts):
    """Return the numbers of a column (N,), NaN where there is none, or refuse one that is written in another way."""
    numbers = np.array([_number(text) for text in texts])
    others = [texts[k] for k in np.flatnonzero(np.isnan(numbers)) if not _is_missing(texts[k])]
    if len(others) > MANY * len(texts) or any("," in text for text in others):
        raise ValueError(f"{name}: needs decimal numbers in column {column!r}, got {way_of(column, others[0])}")
    return numbers


def _times(name, column, values, texts):
    """Return times in microseconds, those that cannot be read by row, and whether they stand there as dates."""
    if (kind := _kind(values)) in ("M", "m"):
        return np.asarray(values, dtype=f"{kind}8[us]").astype(np.int64), {}, kind == "M"
    times = np.array([_number(text) for text in texts])
    known = times[np.isfinite(times)]
    dated = len(known) <= 0.5 * sum(not _is_missing(text) for text in texts)
    if dated:
        times = np.array([_time_of(text) for text in texts])
        zoned = [text for text, time in zip(texts, times, strict=True) if math.isfinite(time) and ZONE.search(text)]
        if 0 < len(zoned) < np.isfinite(times).sum():
            way = f"pandas.to_datetime(frame[{column!r}], utc=True, format='ISO8601') where the others are UTC"
            raise ValueError(f"{name}: needs a zone in all times or none, got one in {zoned[0]!r:.40} only: {way}")
    elif not _are_seconds(known):
        times[:] = math.nan
    times = times if dated else np.round(np.where(np.abs(times) < LATEST, times, math.nan) * 1e6)
    unread = {row: texts[row] for row in np.flatnonzero(np.isnan(times)).tolist() if not _is_missing(texts[row])}
    if len(unread) > MANY * len(texts):
        got = way_of(column, next(iter(unread.values())))
        raise ValueError(f"{name}: needs ISO 8601, Unix seconds, or seconds from 0 in column {column!r}, got {got}")
    return _whole(times), unread, bool(dated)


def _are_seconds(times):
    """Tell whether numbers are Unix seconds or seconds from 0, and no digits of a clock from midnight on."""
    usual, step = np.median(times), np.median(np.diff(times)) if len(times) > 1 else 0.0
    clock = step < FORTY and times.max() >= FROM_ZERO and (times % 100 < 60).all()
    return UNIX <= usual < LATEST or (0 <= times[0] < FROM_ZERO and usual < LATEST and not clock)
