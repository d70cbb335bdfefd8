"""Files and tables that are something else than they seem: recognised, and refused with the way to mend them."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .._checks import Array

GPSBABEL = "gpsbabel -t -i {} -f FILE -o gpx -F track.gpx"
# How other files begin, what they are, and how a GPX or CSV file is made of them.
KINDS = (
    (rb"PK\x03\x04", "a zip archive", "unpack it; a workbook: pandas.read_excel('FILE').to_csv('track.csv')"),
    (rb"BZh|\xfd7zXZ|\x28\xb5\x2f\xfd|7z\xbc\xaf|Rar!", "a packed file", "unpack it"),
    (rb"(?s)[\x0c\x0e].{7}\.FIT", "a FIT file", f"{GPSBABEL.format('garmin_fit')}, or the package fitdecode"),
    (rb"\s*[$!](G|P|AI|BD)[A-Z]{2,}", "a log of NMEA sentences", GPSBABEL.format("nmea")),
    (rb"A[A-Z]{3}.*[\r\n]+H", "an IGC file", GPSBABEL.format("igc")),
    (rb".{60}(C?RINEX) VERS", "a RINEX file", "it holds ranges: make fixes of them first"),
    (rb"\s*[{[]", "a JSON file", "pandas.read_json('FILE').to_csv('track.csv')"),
    (rb"PAR1", "a Parquet file", "pandas.read_parquet('FILE').to_csv('track.csv')"),
    (rb"(?s).*\0", "a binary file, or UTF-16 without its mark", "export it as GPX or CSV"),
)
XML_KINDS = {
    "TrainingCenterDatabase": f"a TCX file: {GPSBABEL.format('gtrnctr')}",
    "kml": f"a KML file: {GPSBABEL.format('kml')}",
    "html": "a web page: was the download refused?",
}
# Fixes of several mobiles lie so much farther from the line between any two neighbours than from that of their own.
FARTHER, AT_LEAST = 2.5, 10


def refuse_other_kinds(path: Path, data: bytes) -> None:
    """Refuse a file that is neither XML nor a table, by how it begins."""
    for begins, kind, way in KINDS:
        if re.match(begins, data):
            raise ValueError(f"{path}: needs a GPX or CSV file, got {kind}: {way.replace('FILE', path.name)}")


def refuse_other_xml(path: Path, root: str | None) -> None:
    """Refuse an XML file by the name of its outermost element."""
    if root not in ("gpx", None):
        kind = XML_KINDS.get(root, f"another kind of XML, <{root}>")
        raise ValueError(f"{path}: needs a GPX file, got {kind.replace('FILE', path.name)}")


def is_clock_as_number(numbers: Array) -> bool:
    """Tell whether numbers are clock times as hhmmss: digits are below 60, and the steps are more even if read so.

    With parts of a second behind, or without seconds, they are found too; days and months may stand before them.
    """
    for unit in (0.01, 1, 100, 1000):  # of hhmm, hhmmss, hhmmsscc and hhmmssmmm
        whole = np.floor(numbers / unit)
        days, hours, minutes, seconds = whole // 10**6, whole // 10**4 % 100, whole // 100 % 100, numbers / unit % 100
        if (whole < 0).any() or (seconds >= 60).any() or (minutes >= 60).any() or (hours >= 24).any():
            continue
        clock, plain = np.diff(86400 * days + 3600 * hours + 60 * minutes + seconds), np.diff(numbers / unit)
        usual = [np.median(each) for each in (clock, plain) if len(each)]
        if min(usual, default=0) > 0 and np.ptp(clock) / usual[0] < 0.9 * np.ptp(plain) / usual[1]:
            return True
    return False


def refuse_signs(name: str, others: dict[str, list[str]], numbers: dict[str, Array]) -> None:
    """Refuse latitudes and longitudes, {column: degrees}, whose sign stands in a column of its own, as N or S."""
    for what, plus, minus in zip(numbers, "NE", "SW", strict=True):
        for column, cells in others.items():
            letters = np.array([cell.strip().upper()[:1] for cell in cells])
            of_this = {cell.strip().upper() for cell in cells} <= {plus, minus, "NORTH", "SOUTH", "EAST", "WEST", ""}
            if of_this and np.any(numbers[what][letters == minus] > 0):
                way = f"frame[{what!r}] *= frame[{column!r}].str.upper().str[0].map({{{plus!r}: 1, {minus!r}: -1}})"
                raise ValueError(f"{name}: needs signed degrees, got the sign of {what} in column {column!r}: {way}")


def refuse_several(name: str, others: dict[str, list[str]], time: NDArray[np.int64], place: Array) -> None:
    """Refuse a table of several mobiles, told by the values of another column: ships by their MMSI.

    One mobile is nearest to the fixes before and after it, whatever the column says. Of several, the fixes of one value
    lie on a line between their own neighbours in time, and not on that between any two.
    """
    rows = np.flatnonzero((time != np.iinfo(np.int64).min) & np.isfinite(place).all(axis=1))
    rows = rows[np.argsort(time[rows], kind="stable")]
    t, z = time[rows] / 1e6, place[rows]
    if len(rows) < AT_LEAST:
        return
    apart = _off_the_line(t, z)
    for column, cells in others.items():
        codes: dict[str, int] = {}
        value = np.array([codes.setdefault(cells[row], len(codes)) for row in rows])
        if not 1 < len(codes) <= len(rows) / 3:
            continue
        by_value = np.argsort(value, kind="stable")
        own = np.full(len(rows), math.nan)
        inner = np.flatnonzero(value[by_value][2:] == value[by_value][:-2]) + 1
        own[by_value[inner]] = _off_the_line(t[by_value], z[by_value])[inner]
        mixed = np.isfinite(own) & np.isfinite(apart)
        mixed[1:-1] &= (value[1:-1] != value[:-2]) | (value[1:-1] != value[2:])
        if mixed.sum() >= AT_LEAST and np.median(apart[mixed]) > FARTHER * np.median(own[mixed]):
            one = f"frame[frame[{column!r}] == {cells[rows[0]]!r}]"
            got = f"{len(codes)}, by their column {column!r}"
            raise ValueError(f"{name}: needs one mobile, got {got}: take one: {one}, in quotes only if it is a text")


def _off_the_line(t, z):
    """Return how far each fix is from the line between the ones before and after it, (N,), NaN at both ends."""
    off, long = np.full(len(t), math.nan), t[2:] - t[:-2]
    part = np.divide(t[1:-1] - t[:-2], long, out=np.full(len(long), 0.5), where=long > 0)
    off[1:-1] = np.linalg.norm(z[1:-1] - z[:-2] - part[:, None] * (z[2:] - z[:-2]), axis=1)
    return off
