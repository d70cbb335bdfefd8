"""Files and tables in other formats, and of several mobiles: recognised, and refused with the way to convert them."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from .._checks import Array, refuse

GPSBABEL = "gpsbabel -t -i {} -f FILE -o gpx -F track.gpx"
XML = rb"(?i)(<[?!][^>]*>\s*)*<"  # what stands before the name of the outermost element
PACKED = rb"PK\x03\x04|BZh|\xfd7z|7z\xbc|Rar!|\x28\xb5\x2f\xfd|\x1f\x9d|\x04\x22\x4d\x18"
# How other files begin, what they are, and how to make a GPX or CSV file of them.
KINDS = (
    (PACKED, "an archive", "unpack it; or pandas.read_excel('FILE').to_csv('new.csv')"),
    (rb"\xff\xfe|\xfe\xff", "UTF-16", "save it as UTF-8; or pandas.read_csv('FILE', encoding='utf-16')"),
    (rb"(?s)[\x0c\x0e].{7}\.FIT", "a FIT file", f"{GPSBABEL.format('garmin_fit')}, or the package fitdecode"),
    (rb"[$!](G|P|AI|BD)[A-Z]{2,}", "a log of NMEA sentences", GPSBABEL.format("nmea")),
    (rb"A[A-Z]{3}.*[\r\n]+H", "an IGC file", GPSBABEL.format("igc")),
    (rb"[{[]", "a JSON file", "pandas.read_json('FILE').to_csv('new.csv'); of GeoJSON geopandas.read_file('FILE')"),
    (XML + rb"TrainingCenterDatabase", "a TCX file", GPSBABEL.format("gtrnctr")),
    (XML + rb"kml", "a KML file", GPSBABEL.format("kml")),
    (XML + rb"(?![?!]|([\w.-]+:)?gpx)", "another kind of XML, or a web page", "export it as GPX"),
    (rb"(?s).*\0|.{,99}[\1-\x08\x0e-\x1f]", "a binary file, or a damaged one", "export it as GPX or CSV"),
)
SIGNS = "{'N': 1, 'S': -1, 'E': 1, 'W': -1}"
# How cells may look, and how to make numbers or times of their COLUMN.
CONVERSIONS = (
    (r"\d{13,}(\.\d*)?", "pandas.to_datetime(COLUMN, unit='ms'), 'us' or 'ns'; of digits format='%Y%m%d%H%M%S'"),
    (r"\d{5}\.\d+", "days of a spreadsheet? pandas.to_datetime(COLUMN, unit='D', origin='1899-12-30')"),
    (
        r"-?[\d.]+",
        "a clock's digits? pandas.to_datetime(frame['date'] + ' ' + COLUMN, format='ISO8601'), as texts; "
        "seconds from another start? COLUMN - COLUMN.iloc[0]",
    ),
    (r"[+-]?\d+([.,'\s]\d{3})*[.,]?\d*", "pandas.read_csv(FILE, decimal=',', thousands='.'), or the two exchanged"),
    (r"[\d. NSEW]+", f"COLUMN.str.strip('NSEW ').astype(float) * COLUMN.str.extract('([NSEW])')[0].map({SIGNS})"),
    (r".*\d *[°º'd].*", "degrees + minutes / 60 + seconds / 3600, negative south and west"),
    (r"\d{1,2}:\d\d.*", "a date is needed too: pandas.to_datetime(frame['date'] + ' ' + COLUMN)"),
    (r"\d{4}\D.*", "pandas.to_datetime(COLUMN)"),
    (r"(?s).*", "numbers are decimal, without a unit; of dates pandas.to_datetime(COLUMN, dayfirst=True), or False"),
)
# Several mobiles: a column changes its value at least so often, has so many fixes of each value, and these lie so much
# farther from the line between their neighbours in time than from that between their neighbours of the same value.
FEWEST_CHANGES, FIXES_OF_EACH, FARTHER = 10, 5, 2.5


def refuse_other_kinds(path: Path, data: bytes) -> None:
    """Refuse a file of another kind by its first bytes, after a byte order mark and blanks."""
    data = data.removeprefix(b"\xef\xbb\xbf").lstrip(b" \t\r\n")
    for begins, kind, way in KINDS:
        if re.match(begins, data):
            refuse(path, "a GPX or CSV file", f"{kind}: {way.replace('FILE', path.name)}")


def conversion_of(column: str, text: str) -> str:
    """Return a cell of a column, and the way to convert the column."""
    way = next(way for looks, way in CONVERSIONS if re.fullmatch(looks, text.strip()))
    return f"{text!r:.40}: {way.replace('COLUMN', f'frame[{column!r}]')}"


def refuse_signs(name: str, others: dict[str, list[str]], column: str, degrees: Array, plus: str, minus: str) -> None:
    """Refuse degrees whose sign stands in another column, as a word (NORTH, SOUTH) or its first letter."""
    for other, cells in others.items():
        words = [cell.strip().upper() for cell in cells]
        negative = np.array([word.startswith(minus[0]) for word in words], dtype=bool)
        if set(words) <= {plus, minus, plus[0], minus[0], ""} and (degrees[negative] > 0).any():
            way = f"frame[{column!r}] *= frame[{other!r}].str.strip().str.upper().str[0].map({SIGNS})"
            refuse(name, "signed degrees", f"the sign of {column} in column {other!r}: {way}; or drop that column")


def refuse_several(name: str, others: dict[str, list[str]], time: Array, position: Array) -> None:
    """Refuse a table of several mobiles, as ships with an MMSI, and name the column that tells them apart.

    A fix of one mobile lies between the fixes before and after it, whatever the other columns say. With several mobiles
    it lies only between fixes with its own value of the column that tells them apart.
    """
    rows = np.flatnonzero(np.isfinite(time) & np.isfinite(position).all(axis=1))
    rows = rows[np.argsort(time[rows], kind="stable")]
    for column, cells in others.items():
        values, value = np.unique([cells[row] for row in rows], return_inverse=True)
        if len(values) * FIXES_OF_EACH > len(rows):
            continue
        apart, own = _off_the_lines(time[rows] / 1e6, position[rows], value)
        if apart > FARTHER * own:
            one = f"frame[frame[{column!r}].astype(str) == {str(values[np.argmax(np.bincount(value))])!r}]"
            refuse(name, "one mobile", f"{len(values)}, by their column {column!r}: take one: {one}")


def take_turns(time: Array, position: Array) -> bool:
    """Tell whether two mobiles take turns: every other fix by itself makes a much straighter path than all fixes.

    Rounded times of one mobile have the same effect, but move no fix farther than the mobile goes in two steps.
    """
    apart, own = _off_the_lines(time, position, np.arange(len(time)) % 2)
    return bool(apart > FARTHER * own and apart > np.median(np.linalg.norm(position[2:] - position[:-2], axis=1)))


def _off_the_lines(time, position, value):
    """Return how far fixes beside one of another value are from the line between their neighbours, at the median.

    The neighbours are first those in time, then those of the same value. Both are 0 if the value hardly ever changes.
    """
    changes = np.diff(value) != 0
    if changes.sum() < FEWEST_CHANGES:
        return 0.0, 0.0
    beside_another = np.append(changes, False) | np.append(False, changes)
    off = []
    for order in (np.arange(len(time)), np.argsort(value, kind="stable")):
        before, here, after = order[:-2], order[1:-1], order[2:]
        part = (time[here] - time[before]) / np.maximum(time[after] - time[before], 1e-6)
        on_the_line = position[before] + part[:, None] * (position[after] - position[before])
        distance = np.linalg.norm(position[here] - on_the_line, axis=1)
        off.append(np.median(distance[beside_another[here]]))
    return off
