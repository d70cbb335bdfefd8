"""Recorded tracks from GPX files, from CSV files of named columns, and from pandas frames.

Nothing is guessed: a table has `time` (ISO 8601, or Unix seconds) and `lat`, `lon` (°) or `x`, `y` (m), and may have
`ele`, `hdop`, `accuracy`. Other names are given as `columns`. All else is refused, with the line that mends it.
"""

from __future__ import annotations

import codecs
import csv
import math
import re
import zlib
from array import array
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from .._checks import Array
from .doubts import is_clock_as_number, refuse_other_kinds, refuse_other_xml, refuse_several, refuse_signs

NO_TIME = -(2**63)  # a time that is not there, in microseconds
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
DEEPEST = 100  # no GPX file nests its elements deeper; one of 200,000 would need as much memory as its author likes
WANTED = frozenset(["time", "ele", "hdop"])  # the texts of a GPX fix that are read
LEAP = re.compile(r"(:\d\d):60(?!\d)")  # a leap second is the one before it, and one more
COLUMNS = ("time", "lat", "lon", "x", "y", "ele", "hdop", "accuracy")
MISSING = frozenset(["", "nan", "nat", "none", "null", "na", "n/a", "<na>", "-"])
MANY = 0.1  # of the cells: so many that are no numbers are another way of writing them
LATEST = 1e10  # Unix seconds of the year 2286: a larger number counts something else, and such a date is a fault
FEW = 10  # lines, of which the last one cannot be told to be cut
CUT = [expat.errors.codes[text] for text in (expat.errors.XML_ERROR_NO_ELEMENTS, expat.errors.XML_ERROR_UNCLOSED_TOKEN)]


@dataclass(frozen=True)
class Recording:
    """The fixes of a file in its own order, N of them, faults and all.

    time (N,): microseconds since 1970 in UTC, NO_TIME where there is none
    lat, lon (N,): degrees as they stand, or None where the file has metres
    metres (N, 2): x and y, or None where the file has degrees
    height, hdop (N,): m and a number, NaN where the file has none
    segment (N,): the number of the fix' segment, from 1; `segments` counts the empty ones too
    unread: what stands in place of a time and cannot be read as one, by row
    said: what is to be said of the file
    places: where each fix begins and ends in `data`, the bytes of a whole GPX file, (N, 2); or None
    accuracy: the standard deviation of each fix that the file states, m, or None
    dated: whether times stand there as dates, and not as numbers
    index: the labels of a frame's rows, or None
    """

    time: NDArray[np.int64]
    lat: Array | None
    lon: Array | None
    metres: Array | None
    height: Array
    hdop: Array
    segment: NDArray[np.int64]
    segments: int
    unread: dict[int, str]
    said: tuple[str, ...] = ()
    places: NDArray[np.int64] | None = None
    data: bytes = b""
    accuracy: Array | None = None
    dated: bool = True
    index: Any = None


def microseconds(text: str) -> int:
    """Return a time as GPX and most programs write it in microseconds since 1970. Raises ValueError for another text.

    Blanks around it, a comma for the point and a leap second are taken for what they are; without a zone it is UTC.

    >>> microseconds("1970-01-01T00:00:01.5Z"), microseconds(" 1970-01-01 00:00:60,5+00:00")
    (1500000, 60500000)
    """
    try:
        moment = datetime.fromisoformat(text)
        leap = 0
    except ValueError:
        text, leap = LEAP.subn(r"\1:59", text.strip().replace(",", ".").replace("/", "-"))
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
        refuse_other_kinds(path, data)
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
    data, said, packed = path.read_bytes(), [], []
    while data[:2] == b"\x1f\x8b":
        unpacker = zlib.decompressobj(wbits=31)
        try:
            packed.append(unpacker.decompress(data))
        except zlib.error as error:
            raise ValueError(f"{path}: needs a file that can be unpacked, got a damaged one ({error})") from None
        if not unpacker.eof:
            said.append("ATTENTION: the packed file is cut: what follows is lost")
        data = unpacker.unused_data
    data = b"".join(packed) if packed else data
    if data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        text = data.decode("utf-16", errors="replace")
        data = re.sub(r"\A(<\?xml[^>]*encoding\s*=\s*[\"'])[\w-]+", r"\1UTF-8", text).encode()
    if data.endswith(b"\0"):
        data = data.rstrip(b"\0")
        said.append("ATTENTION: the file ends in empty bytes: what stood there is lost")
    return data, said


def _of_gpx(path, data, said):
    """Return the Recording of a GPX file; names may have a prefix. Of a file that is cut, the whole fixes."""
    reader = _Reader()
    try:
        reader.parser.Parse(data, True)
    except (expat.ExpatError, LookupError, ValueError) as error:
        refuse_other_xml(path, reader.root)
        if getattr(error, "code", None) not in CUT or not reader.end:
            raise ValueError(f"{path}: needs a GPX file, got one that cannot be read ({error})") from None
        said = [*said, f"ATTENTION: the file is cut after {len(reader.end)} fixes: what follows is lost"]
        return reader.recording(None, said)
    refuse_other_xml(path, reader.root)
    return reader.recording(data, said)


class _Reader:
    """The target of the parser of a GPX file: it keeps numbers, and the text of the element that it is in."""

    def __init__(self):
        self.time, self.segment, self.begin, self.end = (array("q") for _ in range(4))
        self.lat, self.lon, self.height, self.hdop = (array("d") for _ in range(4))
        self.depth = self.segments = 0
        self.of_fix = None  # how deep the fix is nested that the parser is in
        self.root, self.unread, self.text = None, {}, []
        self.names = {}  # each name without its prefix
        self.parser = expat.ParserCreate()
        self.parser.buffer_text = True
        self.parser.StartElementHandler, self.parser.EndElementHandler = self.start, self.finish

    def start(self, name, attributes):
        self.depth += 1
        if self.depth > DEEPEST:
            raise ValueError(f"elements nested more than {DEEPEST} deep")
        if name not in self.names:
            self.names[name] = name.rpartition(":")[2]
        name = self.names[name]
        if self.depth == 1:
            self.root = name
        elif self.of_fix is not None:
            if name in WANTED and self.depth == self.of_fix + 1:
                self.text = []
                self.parser.CharacterDataHandler = self.text.append
        elif name == "trkpt":
            self.of_fix = self.depth
            self.begin.append(self.parser.CurrentByteIndex)
            self.lat.append(_number(attributes.get("lat")))
            self.lon.append(_number(attributes.get("lon")))
            self.time.append(NO_TIME)
            self.height.append(math.nan)
            self.hdop.append(math.nan)
            self.segment.append(self.segments)
        elif name == "trkseg":
            self.segments += 1

    def finish(self, name):
        depth = self.depth
        self.depth -= 1
        if self.of_fix is None:
            return
        if depth == self.of_fix:
            self.of_fix = None
            self.end.append(self.parser.CurrentByteIndex)
        elif depth == self.of_fix + 1 and self.parser.CharacterDataHandler is not None:
            self.parser.CharacterDataHandler = None
            text, name = "".join(self.text), self.names[name]
            if name == "time":
                self.time[-1] = _time_or_none(text, len(self.time) - 1, self.unread)
            else:
                (self.height if name == "ele" else self.hdop)[-1] = _number(text)

    def recording(self, data, said):
        """Return the whole fixes as a Recording; without data if the file is cut, since it cannot be written back."""
        N = len(self.end)
        lat, lon, height, hdop = (np.array(each[:N]) for each in (self.lat, self.lon, self.height, self.hdop))
        time, segment = (np.array(each[:N], dtype=np.int64) for each in (self.time, self.segment))
        places = None if data is None else np.column_stack([self.begin, self.end]).astype(np.int64)
        unread = {row: text for row, text in self.unread.items() if row < N}
        said, data = tuple(said), data or b""
        return Recording(time, lat, lon, None, height, hdop, segment, self.segments, unread, said, places, data)


def _number(text):
    """Return a number that a text stands for, NaN where it is none or infinite."""
    try:
        value = float(text)
    except (TypeError, ValueError):
        return math.nan
    return value if math.isfinite(value) else math.nan


def _time_or_none(text, row, unread):
    """Return a time in microseconds, or NO_TIME; a text that is none is kept in `unread`."""
    try:
        time = microseconds(text)
        if abs(time) < LATEST * 1e6:
            return time
    except (ValueError, OverflowError):
        pass
    if text.strip().lower() not in MISSING:
        unread[row] = text
    return NO_TIME


def _of_csv(path, text, columns, said):
    """Return the Recording of a CSV with a line of names. Lines before it that begin with a # are passed over.

    Each line is a row for itself, so that a quote that is never closed costs no other one.
    """
    lines = [line for line in re.split(r"\r\n|\n|\r", text) if line.strip()]
    while lines and lines[0].startswith("#"):
        del lines[0]
    names = [name.strip() for name in _cells(lines[0])] if lines else []
    rows = [_cells(line) for line in lines[1:]]
    long = [k for k, row in enumerate(rows) if any(cell.strip() for cell in row[len(names) :])]
    if len(long) > MANY * len(rows):
        need = f"{len(names)} cells in a line, as its first one has"
        how = "are commas decimal, too? Write points"
        raise ValueError(f"{path}: needs {need}, got {len(rows[long[0]])} in {lines[long[0] + 1]!r:.60}: {how}")
    for k in long:
        rows[k] = []
    ends = [len(row[-1]) for row in rows if len(row) == len(names)]
    if text[-1:] not in "\r\n" and len(ends) > FEW and len(rows[-1]) == len(names) and ends[-1] < min(ends[:-1]):
        rows[-1] = []
        said = [*said, "ATTENTION: the last line is cut, and left out"]
    cells = [[row[k] if k < len(row) else "" for row in rows] for k in range(len(names))]
    return _of_table(str(path), names, cells.__getitem__, columns, said, separators=lines[0] if lines else "")


def _cells(line):
    return next(csv.reader([line])) if '"' in line else line.split(",")


def read_frame(frame: Any, columns: Mapping[str, str] | None = None) -> Recording:
    """Return the Recording of a pandas frame, whose index may hold the times. Raises ValueError for another table."""
    names, index = [str(name) for name in frame.columns], getattr(frame, "index", None)
    values = [frame.iloc[:, k] if hasattr(frame, "iloc") else frame[name] for k, name in enumerate(names)]
    time = (columns or {}).get("time", "time")
    in_index = getattr(index, "name", None) == time or getattr(getattr(index, "dtype", None), "kind", "") in ("M", "m")
    if time not in names and in_index:
        names, values, columns = [*names, "the index"], [*values, index], {**(columns or {}), "time": "the index"}
    return _of_table("frame", names, values.__getitem__, columns, [], index)


def _of_table(name, names, values, columns, said, index=None, separators=""):
    """Return the Recording of a table; values(k) are those of column k, numbers, times or texts."""
    found = _found(name, names, columns, separators)
    numbers = {what: _numbers(name, names[k], values(k)) for what, k in found.items() if what != "time"}
    time, unread, dated = _times(name, names[found["time"]], values(found["time"]))
    N = len(time)
    others = {names[k]: list(map(str, values(k))) for k in set(range(len(names))) - set(found.values())}
    lat, lon, metres = numbers.get("lat"), numbers.get("lon"), None
    if lat is None:
        metres = place = np.column_stack([numbers["x"], numbers["y"]])
    else:
        refuse_signs(name, others, {names[found[what]]: numbers[what] for what in ("lat", "lon")})
        place = np.column_stack([lon * np.cos(np.radians(lat)), lat])
    refuse_several(name, others, time, place)
    nothing, one = np.full(N, math.nan), np.ones(N, dtype=np.int64)
    height, hdop, accuracy = numbers.get("ele", nothing), numbers.get("hdop", nothing), numbers.get("accuracy")
    fixes = Recording(time, lat, lon, metres, height, hdop, one, 1, unread, tuple(said))
    return replace(fixes, accuracy=accuracy, dated=dated, index=index)


def _found(name, names, columns, separators):
    """Return {what: number of its column} of a table, by the names that are known and by those given."""
    columns = {} if columns is None else columns
    if not isinstance(columns, Mapping) or not set(columns) <= set(COLUMNS):
        need = f"names of some of {', '.join(COLUMNS)}, as {{'time': 'when'}}"
        raise ValueError(f"columns: needs {need}, got {columns!r:.80}")
    wanted = {what: columns.get(what, what) for what in COLUMNS}
    for what, column in columns.items():
        if column not in names:
            raise ValueError(f"{name}: needs a column {column!r} of {what}, got {', '.join(map(ascii, names)):.300}")
    found = {what: column for what, column in wanted.items() if column in names}
    metres = {"x", "y"} <= set(found) and ({"x", "y"} & set(columns) or not {"lat", "lon"} <= set(found))
    for what in ("lat", "lon") if metres else ("x", "y"):
        found.pop(what, None)
    if "time" not in found or not (metres or {"lat", "lon"} <= set(found)):
        need = "columns time and lat, lon (degrees) or x, y (metres)"
        way = "name others: --time when --lat y ..., or columns={'time': 'when', 'lat': 'y', ...}"
        other = max(";\t", key=separators.count)
        if other in separators:
            way = f"cells need commas between them: pandas.read_csv(FILE, sep={other!r}, decimal=',').to_csv('new.csv')"
        raise ValueError(f"{name}: needs {need}, got {', '.join(map(ascii, names)) or 'nothing':.300}: {way}")
    for column in found.values():
        if names.count(column) > 1:
            raise ValueError(f"{name}: needs one column {column!r}, got {names.count(column)}: rename the others")
    return {what: names.index(column) for what, column in found.items()}


def _numbers(name, column, values):
    """Return the numbers of a column (N,), NaN where there is none, or refuse one that is written in another way."""
    try:
        numbers = np.array(values if hasattr(values, "dtype") else [float(value) for value in values], dtype=float)
        return np.where(np.isfinite(numbers), numbers, math.nan)
    except (TypeError, ValueError):
        texts = list(map(str, values))
    numbers = np.array([_number(text) for text in texts])
    others = [text for text, number in zip(texts, numbers, strict=True) if math.isnan(number)]
    others = [text for text in others if text.strip().lower() not in MISSING]
    if len(others) > MANY * len(texts):
        way = "degrees + minutes / 60 + seconds / 3600, negative south and west"
        if re.fullmatch(r"\s*[+-]?\d+,\d+\s*", others[0]):
            way = "pandas.read_csv(FILE, decimal=',')"
        elif re.fullmatch(r"\s*[\d.]+\s*[NSEW]\s*", others[0], re.IGNORECASE):
            sign = "map({'N': 1, 'S': -1, 'E': 1, 'W': -1})"
            way = f"frame[{column!r}] = frame[{column!r}].str[:-1].astype(float) * frame[{column!r}].str[-1].{sign}"
        raise ValueError(f"{name}: needs decimal numbers in column {column!r}, got {others[0]!r:.40}: {way}")
    return numbers


def _times(name, column, values):
    """Return times in microseconds, those that cannot be read by row, and whether they stand there as dates."""
    if getattr(getattr(values, "dtype", None), "kind", "") in ("M", "m"):
        kind = values.dtype.kind
        return np.asarray(values, dtype=f"{kind}8[us]").astype(np.int64), {}, kind == "M"
    texts, unread = list(map(str, values)), {}
    numbers = np.array([_number(text) for text in texts])
    known = np.isfinite(numbers)
    if known.sum() <= 0.5 * sum(text.strip().lower() not in MISSING for text in texts):
        times = [_time_or_none(text, row, unread) for row, text in enumerate(texts)]
        return np.array(times, dtype=np.int64), unread, True
    convert = f"frame[{column!r}] = pandas.to_datetime(frame[{column!r}]"
    usual = np.median(np.abs(numbers[known]))
    if usual > LATEST:
        ways = [(1e12, "format='%y%m%d%H%M%S'"), (1.9e13, "unit='ms'"), (2.1e13, "format='%Y%m%d%H%M%S'")]
        ways += [(1e14, "unit='ms'"), (1e17, "unit='us'"), (math.inf, "unit='ns'")]
        way = next(f"{convert}, {each})" for most, each in ways if usual < most)
        raise ValueError(f"{name}: needs ISO 8601 or Unix seconds in {column!r}, got {texts[0]!r:.40}: {way}")
    if is_clock_as_number(numbers[known]):
        way = f"{convert}, format='%H%M%S'), read as texts, with the date before them"
        raise ValueError(f"{name}: needs seconds in {column!r}, got a clock's digits as {texts[0]!r:.40}: {way}")
    time = np.full(len(texts), NO_TIME, dtype=np.int64)
    known &= np.abs(numbers) < LATEST
    time[known] = np.round(numbers[known] * 1e6).astype(np.int64)
    unread = {k: text for k, text in enumerate(texts) if not known[k] and text.strip().lower() not in MISSING}
    return time, unread, False
