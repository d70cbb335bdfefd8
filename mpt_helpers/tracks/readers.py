"""Recorded tracks from files: GPX is read without other packages, and a CSV by the names of its columns."""

from __future__ import annotations

import codecs
import csv
import gzip
import io
import math
import re
from array import array
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from os import PathLike
from pathlib import Path
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from .._checks import Array

# A time that is not there, in microseconds.
NO_TIME = -(2**63)
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
# No GPX file nests its elements deeper; a file that nests 200,000 would need as much memory as its author likes.
DEEPEST = 100
CHUNK = 1 << 20  # bytes that are read at a time
# Texts of a fix that are wanted, by the name of their element.
WANTED = frozenset(["time", "ele", "hdop"])
# A second that is a leap second is the one before it, and one more.
LEAP = re.compile(r"(:\d\d):60(?!\d)")
# Usual names of columns, in small letters, with _ for what is no letter or digit.
NAMES = {
    "time": [
        "time",
        "timestamp",
        "datetime",
        "date_time",
        "date",
        "t",
        "t_s",
        "t_ms",
        "time_s",
        "time_ms",
        "utc",
        "gps_time",
        "seconds",
        "secs",
    ],
    "date": ["date", "day", "date_utc", "utc_date"],
    "lat": ["lat", "latitude", "lat_deg", "latitude_deg", "position_lat", "y_lat", "late7", "latitudee7"],
    "lon": [
        "lon",
        "lng",
        "long",
        "longitude",
        "lon_deg",
        "longitude_deg",
        "position_long",
        "x_lon",
        "lone7",
        "longitudee7",
    ],
    "east": ["east", "easting", "x", "e", "east_m", "x_m", "utm_x", "utm_e"],
    "north": ["north", "northing", "y", "n", "north_m", "y_m", "utm_y", "utm_n"],
    "height": ["ele", "elevation", "alt", "altitude", "height", "z", "up", "ele_m", "alt_m", "altitude_m", "height_m"],
    "hdop": ["hdop"],
    "accuracy": ["accuracy", "horizontal_accuracy", "hacc", "h_acc", "accuracy_m", "sigma", "std"],
}
# A time of day. Without a date it counts from the first midnight; where it runs back by more than half a day, another
# day has begun.
OF_A_DAY = re.compile(r"\s*(\d{1,2}):(\d\d)(?::(\d\d(?:[.,]\d+)?))?\s*")
DAY = 86_400_000_000  # microseconds
# From these sizes on a number that stands for a time counts milli-, micro- or nanoseconds since 1970: in seconds it
# would be after the year 5138.
UNITS_OF_TIMES = ((1e17, 1e-3, "nanoseconds"), (1e14, 1.0, "microseconds"), (1e11, 1e3, "milliseconds"))


@dataclass(frozen=True)
class Recording:
    """The fixes of a file in its own order, N of them, faults and all.

    time (N,): microseconds since 1970 in UTC, or since any moment where `dated` is False; NO_TIME where there is none
    lat, lon (N,): degrees as they stand, or None where the file has metres
    metres (N, 2): east and north, or None where the file has degrees
    height, hdop (N,): m and a number, NaN where the file has none
    segment (N,): the number of the fix' segment, from 1; `segments` counts the empty ones too
    unread: what stands in place of a time and cannot be read as one, by row
    places: where each fix begins and ends in a GPX file, in bytes, (N, 2)
    said: what was taken for what, in words
    accuracy (N,): the standard deviation of each fix that the file states, m, or None
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
    places: NDArray[np.int64] | None = None
    dated: bool = True
    said: tuple[str, ...] = ()
    accuracy: Array | None = None


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


def read(path: str | PathLike[str], columns: dict[str, str] | None = None) -> Recording:
    """Return the Recording of a GPX or CSV file, which may be compressed (.gz). Raises ValueError for another file."""
    path = Path(path)
    return read_gpx(path) if _is_xml(path) else read_csv(path, columns or {})


def in_degrees(path: str | PathLike[str], columns: dict[str, str] | None = None) -> bool:
    """Tell whether a file has degrees, and not metres, by its first lines. Raises ValueError as `read_csv`."""
    path = Path(path)
    if _is_xml(path):
        return True
    with _opened_as_text(path) as text:
        _, _, found = _head(path, text, columns or {})
    return "lat" in found


def _is_xml(path):
    with _opened(path) as file:
        start = file.read(64)
    return start.lstrip(b"\xef\xbb\xbf \t\r\n").startswith((b"<", b"\xff\xfe", b"\xfe\xff"))


def _opened(path):
    return gzip.open(path) if path.suffix == ".gz" else path.open("rb")


def _opened_as_text(path):
    return io.TextIOWrapper(_opened(path), encoding="utf-8-sig", errors="replace", newline="")


def read_gpx(path: str | PathLike[str]) -> Recording:
    """Return the Recording of a GPX file, read in pieces, so that memory holds the numbers only.

    Names may have a prefix. Raises ValueError for what is no GPX file, and for elements nested deeper than any of GPX.
    """
    path, reader = Path(path), _Reader()
    try:
        with _opened(path) as file:
            while chunk := file.read(CHUNK):
                reader.parser.Parse(chunk, False)
        reader.parser.Parse(b"", True)
    except (expat.ExpatError, LookupError, ValueError, EOFError) as error:
        raise ValueError(f"{path}: needs a GPX file, got one that cannot be read ({error})") from None
    if not reader.is_gpx:
        raise ValueError(f"{path}: needs a GPX file, got one that cannot be read (another kind of XML)")
    return reader.recording()


class _Reader:
    """The target of the parser of a GPX file: it keeps numbers, and the text of the element that it is in."""

    def __init__(self):
        self.time, self.segment, self.begin, self.end = (array("q") for _ in range(4))
        self.lat, self.lon, self.height, self.hdop = (array("d") for _ in range(4))
        self.depth = self.segments = 0
        self.of_fix = None  # how deep the fix is nested that the parser is in
        self.is_gpx, self.unread, self.text = False, {}, []
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
        if self.of_fix is not None:
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
        elif name == "gpx" and self.depth == 1:
            self.is_gpx = True

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
                self._keep_time(text)
            else:
                (self.height if name == "ele" else self.hdop)[-1] = _number(text)

    def _keep_time(self, text):
        try:
            self.time[-1] = microseconds(text)
        except (ValueError, OverflowError):
            if text.strip():
                self.unread[len(self.time) - 1] = text

    def recording(self):
        floats = (np.frombuffer(each) if each else np.empty(0) for each in (self.lat, self.lon, self.height, self.hdop))
        lat, lon, height, hdop = floats
        time, segment, begin, end = (
            np.array(each, dtype=np.int64) for each in (self.time, self.segment, self.begin, self.end)
        )
        places = np.column_stack([begin, end])
        return Recording(time, lat, lon, None, height, hdop, segment, self.segments, self.unread, places)


def _number(text):
    """Return a number that a text stands for, NaN where it is none or infinite."""
    try:
        value = float(text)
    except (TypeError, ValueError):
        return math.nan
    return value if math.isfinite(value) else math.nan


def read_csv(path: str | PathLike[str], columns: dict[str, str]) -> Recording:
    """Return the Recording of a table with a line of names: times, and degrees or metres.

    columns names some of time, date, lat, lon, east, north, height, hdop, accuracy; the others are found by their
    usual names. A date of its own is taken where the time has none; columns whose names end with E7 have ten millionths
    of a degree. Raises ValueError for a file without such columns, naming those that it has.
    """
    path = Path(path)
    with _opened_as_text(path) as text:
        header, delimiter, found = _head(path, text, columns)
        cells = list(zip(*csv.reader(_lines_of(text, len(header), delimiter), delimiter=delimiter), strict=False))
    if not cells:
        raise ValueError(f"{path}: needs a recorded track, got no fixes")
    comma = delimiter != ","
    numbers = {}
    for name, column in found.items():
        if name not in ("time", "date"):
            numbers[name] = _numbers(cells[column], comma)
            _refuse_commas(path, header[column], cells[column], numbers[name])
            if header[column].lower().endswith("e7"):
                numbers[name] /= 1e7
    texts = cells[found["time"]]
    of_a_day = any(texts) and all(OF_A_DAY.fullmatch(text) for text in texts if text.strip())
    if of_a_day and "date" in found:
        texts = [f"{day.strip()} {clock.strip()}" for day, clock in zip(cells[found["date"]], texts, strict=True)]
    else:
        found.pop("date", None)
    if of_a_day and "date" not in found:
        time, unread, dated, said = _times_of_a_day(texts)
    else:
        time, unread, dated, said = _times(texts, header[found["time"]], comma)
    N = len(time)
    nothing = np.full(N, math.nan)
    lat, lon, metres = numbers.get("lat"), numbers.get("lon"), None
    if lat is None:
        metres = np.column_stack([numbers["east"], numbers["north"]])
    height, hdop = numbers.get("height", nothing), numbers.get("hdop", nothing)
    took = ", ".join(f"{name} from {header[column]!r}" for name, column in found.items())
    one = np.ones(N, dtype=np.int64)
    said = (f"columns: {took}", *said)
    return Recording(time, lat, lon, metres, height, hdop, one, 1, unread, None, dated, said, numbers.get("accuracy"))


def _head(path, text, columns):
    """Return the names of columns, what stands between them, and {what: number of the column}, from the first line.

    Lines before it that begin with a # are passed over.
    """
    first = text.readline()
    while first.startswith("#"):
        first = text.readline()
    delimiter = max(",;\t", key=first.count)
    header = [name.strip() for name in next(csv.reader([first], delimiter=delimiter), [])]
    return header, delimiter, _columns(path, header, columns)


def _lines_of(text, width, delimiter):
    """Yield the lines that are not empty, filled up to as many cells as the first one names."""
    for line in text:
        if line.strip():
            yield line.rstrip("\r\n") + delimiter * max(width - 1 - line.count(delimiter), 0)


def _columns(path, header, named):
    """Return {what: number of the column}."""
    plain = [re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") for name in header]
    found = {}
    for what, name in named.items():
        if name not in header:
            raise ValueError(f"{path}: needs a column {name!r} of {what}, got {', '.join(map(repr, header))}")
        found[what] = header.index(name)
    for what, names in NAMES.items():
        for name in names:
            if what not in found and name in plain and plain.index(name) not in found.values():
                found[what] = plain.index(name)
    pairs = [pair for pair in (("lat", "lon"), ("east", "north")) if all(name in found for name in pair)]
    if "time" not in found or not pairs:
        need = "columns of time and of latitude and longitude, or of metres east and north"
        got = ", ".join(map(repr, header)) or "an empty file"
        raise ValueError(f"{path}: needs {need} (name them: --time, --lat, --lon, --east, --north), got {got:.300}")
    named_pairs = [pair for pair in pairs if named.keys() & set(pair)]
    pair = (named_pairs or pairs)[0]
    others = {"lat", "lon", "east", "north"} - set(pair)
    return {what: column for what, column in found.items() if what not in others}


def _numbers(texts, comma):
    """Return the numbers of some cells (N,), NaN where there is none; with a decimal comma where it can be one."""
    return np.array([_number(text.replace(",", ".") if comma else text) for text in texts])


def _times(texts, name, comma):
    """Return times in microseconds, those that cannot be read by row, whether they have a date, and what was said."""
    numbers = _numbers(texts, comma)
    time, unread = np.full(len(texts), NO_TIME, dtype=np.int64), {}
    known = np.isfinite(numbers)
    filled = sum(bool(text.strip()) for text in texts)
    if known.sum() > 0.5 * filled:
        unit, said = _unit(numbers[known], name)
        whole = np.round(numbers[known] * unit)
        fits = np.abs(whole) < 2.0**62
        time[np.flatnonzero(known)[fits]] = whole[fits].astype(np.int64)
        unread = {k: text for k, text in enumerate(texts) if time[k] == NO_TIME and text.strip()}
        dated = float(np.median(time[known])) > 3e8 * 1e6  # from mid 1979 on
        return time, unread, dated, said
    for k, text in enumerate(texts):
        try:
            time[k] = microseconds(text)
        except (ValueError, OverflowError):
            if text.strip():
                unread[k] = text
    return time, unread, True, ()


def _refuse_commas(path, name, texts, numbers):
    """Refuse a column without any number, but with decimal commas where commas stand between the columns too."""
    with_comma = next((text for text in texts if re.fullmatch(r"\s*[+-]?\d+,\d+\s*", text)), None)
    if with_comma is not None and not np.isfinite(numbers).any():
        need = "decimal points, or semicolons between the columns"
        raise ValueError(f"{path}: needs {need}, got decimal commas in column {name!r}, as {with_comma!r:.40}")


def _times_of_a_day(texts):
    """Return what `_times` does of hours, minutes and seconds without a date."""
    time = np.full(len(texts), NO_TIME, dtype=np.int64)
    for k, text in enumerate(texts):
        if text.strip():
            hours, minutes, seconds = OF_A_DAY.fullmatch(text).groups()
            seconds = float((seconds or "0").replace(",", "."))
            time[k] = (int(hours) * 60 + int(minutes)) * 60_000_000 + round(seconds * 1e6)
    known = time != NO_TIME
    time[known] += DAY * np.cumsum(np.diff(time[known], prepend=0) < -DAY // 2)
    return time, {}, False, ("times of day without a date: they count from the first midnight",)


def _unit(numbers, name):
    """Return the microseconds that one unit of a time column stands for, and a sentence that says so."""
    usual = float(np.median(np.abs(numbers)))
    for least, microseconds_each, unit in UNITS_OF_TIMES:
        if usual > least:
            return microseconds_each, (f"times taken for {unit} since 1970",)
    if re.search(r"(^|[^a-z])(ms|msec|millis|milliseconds)$", name.lower()):
        return 1e3, ("times taken for milliseconds",)
    return 1e6, ()


def places_of(path: Path, recording: Recording) -> tuple[bytes, NDArray[np.int64]]:
    """Return the bytes of a GPX file, in an encoding where ASCII is ASCII, and where each fix stands in them."""
    with _opened(path) as file:
        data = file.read()
    if not data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data, recording.places
    text = re.sub(r"(encoding\s*=\s*[\"'])[\w-]+", r"\1UTF-8", data.decode("utf-16"), count=1)
    reader = _Reader()
    reader.parser.Parse(text.encode(), True)
    return text.encode(), reader.recording().places
