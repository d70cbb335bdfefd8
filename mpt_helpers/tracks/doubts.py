"""Files and tables that are something else than they seem: recognised, and refused with the way to mend them."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .._checks import Array

GPSBABEL = "gpsbabel -t -i {} -f FILE -o gpx -F track.gpx"
XML = rb"(?i)(\xef\xbb\xbf)?\s*(<[?!][^>]*>\s*)*<"  # what stands before the name of the outermost element
# How other files begin, what they are, and how a GPX or CSV file is made of them.
KINDS = (
    (rb"PK\x03\x04", "a zip archive", "unpack it; a workbook: pandas.read_excel('FILE').to_csv('track.csv')"),
    (rb"BZh|\xfd7zXZ|\x28\xb5\x2f\xfd|7z\xbc\xaf|Rar!", "a packed file", "unpack it"),
    (rb"(?s)[\x0c\x0e].{7}\.FIT", "a FIT file", f"{GPSBABEL.format('garmin_fit')}, or the package fitdecode"),
    (rb"\s*[$!](G|P|AI|BD)[A-Z]{2,}", "a log of NMEA sentences", GPSBABEL.format("nmea")),
    (rb"A[A-Z]{3}.*[\r\n]+H", "an IGC file", GPSBABEL.format("igc")),
    (rb".{60}(C?RINEX) VERS", "a RINEX file", "it holds ranges: make fixes of them first"),
    (rb"\s*[{[]", "a JSON file", "pandas.read_json('FILE').to_csv('track.csv')"),
    (XML + rb"TrainingCenterDatabase", "a TCX file", GPSBABEL.format("gtrnctr")),
    (XML + rb"kml", "a KML file", GPSBABEL.format("kml")),
    (XML + rb"html", "a web page", "was the download refused?"),
    (XML + rb"(?![?!]|([\w.-]+:)?gpx)", "another kind of XML", "export it as GPX"),
    (rb"(?s).*\0", "a binary file, or UTF-16 without its mark", "export it as GPX or CSV"),
)
# How a COLUMN becomes numbers or times whose cells look so.
WAYS = (
    (r"\d{13,}(\.\d*)?", "pandas.to_datetime(COLUMN, unit='ms'), 'us' or 'ns'; of digits format='%Y%m%d%H%M%S'"),
    (r"\d+(\.\d*)?", "a clock's digits? pandas.to_datetime(frame['date'] + COLUMN, format='%Y-%m-%d%H%M%S'), as texts"),
    (r"[+-]?\d+([.,'\s]\d{3})*[.,]?\d*", "pandas.read_csv(FILE, decimal=',', thousands='.'), or the two exchanged"),
    (r"[\d.]+ *[NSEWnsew]", "COLUMN.str[:-1].astype(float) * COLUMN.str[-1].map({'N': 1, 'S': -1, 'E': 1, 'W': -1})"),
    (r".*\d *[°º'd].*", "degrees + minutes / 60 + seconds / 3600, negative south and west"),
    (r"\d{1,2}:\d\d.*", "a date is needed too: pandas.to_datetime(frame['date'] + ' ' + COLUMN)"),
    (r"(?s).*", "numbers are decimal; of dates, is the day first? pandas.to_datetime(COLUMN, dayfirst=True)"),
)
# Fixes of several mobiles lie so much farther from the line between any two neighbours than from that of their own.
FARTHER, AT_LEAST = 2.5, 10


def refuse_other_kinds(path: Path, data: bytes) -> None:
    """Refuse a file of another kind, by how it begins."""
    for begins, kind, way in KINDS:
        if re.match(begins, data):
            raise ValueError(f"{path}: needs a GPX or CSV file, got {kind}: {way.replace('FILE', path.name)}")


def way_of(column: str, text: str) -> str:
    """Return a cell of a column and the way to mend the column."""
    way = next(way for looks, way in WAYS if re.fullmatch(looks, text.strip()))
    return f"{text!r:.40}: {way.replace('COLUMN', f'frame[{column!r}]')}"


def refuse_signs(name: str, others: dict[str, list[str]], column: str, degrees: Array, words: tuple[str, str]) -> None:
    """Refuse latitudes or longitudes of a column whose sign stands in another column, as NORTH, N or SOUTH, S.

    Another column with both letters is one of directions, as of a bus, where the track stays away from 0° and 180°.
    """
    plus, minus = (word[0] for word in words)
    near_zero = (np.abs(np.abs(degrees) - 90) > 89).any()
    for other, cells in others.items():
        cells = [cell.strip().upper() for cell in cells]
        south = np.array([cell.startswith(minus) for cell in cells], dtype=bool)
        signs = set(cells) <= {*words, plus, minus, ""} and (near_zero or not any(cell[:1] == plus for cell in cells))
        if signs and (degrees[south] > 0).any():
            way = f"frame[{column!r}] *= frame[{other!r}].str.upper().str[0].map({{{plus!r}: 1, {minus!r}: -1}})"
            raise ValueError(f"{name}: needs signed degrees, got the sign of {column} in column {other!r}: {way}")


def refuse_several(name: str, others: dict[str, list[str]], time: NDArray[np.int64], place: Array) -> None:
    """Refuse a table of several mobiles, told by the values of another column: ships by their MMSI.

    One mobile is nearest to the fixes before and after it, whatever the column says. Of several, the fixes of one value
    lie on a line between their own neighbours in time, and not on that between any two.
    """
    rows = np.flatnonzero((time != np.iinfo(np.int64).min) & np.isfinite(place).all(axis=1))
    rows = rows[np.argsort(time[rows], kind="stable")]
    apart = _off_the_line(time[rows], place[rows], np.zeros(len(rows)))
    for column, cells in others.items():
        values, value = np.unique([cells[row] for row in rows], return_inverse=True)
        if not 1 < len(values) <= len(rows) / 3:
            continue
        own, by_value = np.empty(len(rows)), np.argsort(value, kind="stable")
        own[by_value] = _off_the_line(time[rows][by_value], place[rows][by_value], value[by_value])
        mixed = np.isfinite(own) & np.isfinite(apart)
        mixed[1:-1] &= (value[1:-1] != value[:-2]) | (value[1:-1] != value[2:])
        if mixed.sum() >= AT_LEAST and np.median(apart[mixed]) > FARTHER * np.median(own[mixed]):
            one = f"frame[frame[{column!r}] == {cells[rows[0]]!r}], in quotes only if it is a text"
            raise ValueError(
                f"{name}: needs one mobile, got {len(values)}, by their column {column!r}: take one: {one}"
            )


def _off_the_line(time, place, value):
    """Return how far each fix is from the line between its neighbours (N,), NaN where these have other values."""
    off, t = np.full(len(time), math.nan), time / 1e6
    part = (t[1:-1] - t[:-2]) / np.maximum(t[2:] - t[:-2], 1e-6)
    off[1:-1] = np.linalg.norm(place[1:-1] - place[:-2] - part[:, None] * (place[2:] - place[:-2]), axis=1)
    off[1:-1][value[2:] != value[:-2]] = math.nan
    return off
