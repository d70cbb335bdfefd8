"""Make a table of corrected GPS ranges from a day of RINEX: observations and broadcast ephemerides of one station.

    python -m pip install ".[gps]"
    python make_table.py OBSERVATIONS.crx.gz NAVIGATION.rnx.gz table.csv.gz [--biases BIASES]

One row for each epoch and GPS satellite above 10 degrees:

    epoch         seconds of the receiver's clock since the first epoch's midnight (GPS time)
    satellite     its number
    x, y, z       where it was at transmission (m), turned with the Earth until reception
    range         C1C, corrected for satellite clock, group delay, code bias, ionosphere and troposphere (m)
    elevation     degrees above the ellipsoid's horizon
    troposphere   what was taken from `range` for it (m): add it for the range without that correction
    dual          what to add to `range` for the ionosphere-free combination of C1C and C2W (m); nan without C2W
    second        C2W minus C1C, as measured (m)
    phase1        the carrier phase L1C minus C1C, as measured (m)
    phase2        the carrier phase L2W minus C1C, as measured (m)
    bias          what was taken from `range` for the code bias (m): 0 where it is not known

**The code bias.** The broadcast clock is defined for the P(Y) codes, C1W and C2W; C1C differs from C1W by a constant of
each satellite, up to a metre. Where the observations have C1W too, it is the mean of C1C - C1W of the day. Where they
have not, name a file of biases: Bias-SINEX (DSB of C1C and C1W, or OSB of both), as the analysis centres of the IGS
publish for each day, or a CSV with the columns satellite and C1C_minus_C1W_ns. Only differences between satellites
count, so that the mean over all is taken off. Where some satellites have C1W and others have not, the file fills in the
others, shifted so that it has the same mean over the satellites that both know.

Ranges that no message is near enough to are left out, with a warning. Needed are RINEX 3 files of one day: GPS C1C and
the station's position in the observations, GPSA and GPSB (the ionosphere) in the header of the ephemerides.

So `range` is the distance to (x, y, z) plus the receiver's clock, and errors. A phase is a range that lacks a constant,
another one after each loss of lock. What was not measured is nan. The formulas are those of IS-GPS-200
(orbit 20.3.3.4.3, clock and group delay 20.3.3.3.3, ionosphere 20.3.3.5.2.5) and of Saastamoinen (1972).
"""

import argparse
import csv
import gzip
import io
import re
import sys
import warnings
from pathlib import Path

import numpy as np

C = 299_792_458.0  # m/s
MU = 3.986005e14  # m³/s², of the Earth
EARTH_RATE = 7.2921151467e-5  # rad/s
RELATIVITY = -4.442807633e-10  # s/√m
L1, L2 = 1575.42e6, 1227.60e6  # Hz
MASK = 10.0  # degrees
MOST_AGE = 7_200.0  # s, from a message's time of ephemeris: half of the four hours that its numbers are fitted to
WEEK = 604_800.0  # s
COLUMNS = "epoch,satellite,x,y,z,range,elevation,troposphere,dual,second,phase1,phase2,bias"
FORMAT = "%.10g,%d,%.2f,%.2f,%.2f,%.2f,%.1f,%.2f,%.2f,%.3f,%.3f,%.3f,%.3f"
OBSERVED = ["C1C", "C1W", "C2W", "L1C", "L2W"]
CSV_COLUMN = "C1C_minus_C1W_ns"
MOST_BIAS = 20.0  # ns from the median of all: satellites of GPS have some 3
MOST_CHANGE = 2.0  # ns from one day to the next
OLD = 31  # days between biases and observations, from which on it is said: numbers go to new satellites
# The lines of an observation file: an epoch, what a satellite's begins with, and a number (F14.3) with its two flags.
EPOCH = re.compile(r"> \d{4}( [ \d]\d){4} [ \d]\d\.\d{7}  [01][ \d]{2}\d")
SATELLITE = re.compile(r"[A-Z][ \d]\d")
WHOLE = re.compile(r"([ -]*\d+\.\d{3}| {14})")
# A message of GPS: its lines, its numbers up to the issue of data of its clock, and one of them (D19.12).
MESSAGE_LINES, MESSAGE_NUMBERS, NUMBER = 8, 27, re.compile(r" *|[ -]*\d*\.\d+[DEde][+-]\d\d *")
EVENTS, NEW_SITE = ("2", "3", "4", "5", "6"), "3"
CHANGES = ("SYS / # / OBS TYPES", "APPROX POSITION XYZ", "SYS / SCALE FACTOR", "END OF HEADER")
NO_BIASES = (
    "the observations have no C1W, and no --biases are given: the satellites' code biases stay in the ranges. At three "
    "stations that made the error that lasts, of two frequencies, 1.4 to 1.6 times as large"
)


def orbit(message, t):
    """Return a satellite's position (N, 3) at its own transmission times t (N,), and the correction of its clock.

    message maps the names of georinex to arrays (N,) or numbers, t is in seconds of the week of the message. The
    correction, in seconds, contains the relativistic term; the axes are those of the Earth at transmission.
    """
    m = message
    a = m["sqrtA"] ** 2
    since = (t - m["Toe"] + WEEK / 2) % WEEK - WEEK / 2
    mean = m["M0"] + (np.sqrt(MU / a**3) + m["DeltaN"]) * since
    E = mean
    for _ in range(10):  # Kepler's equation; with e below 0.03 each step gains a digit and a half
        E = mean + m["Eccentricity"] * np.sin(E)
    true = np.arctan2(np.sqrt(1 - m["Eccentricity"] ** 2) * np.sin(E), np.cos(E) - m["Eccentricity"])
    u = true + m["omega"]
    cos2, sin2 = np.cos(2 * u), np.sin(2 * u)
    r = a * (1 - m["Eccentricity"] * np.cos(E)) + m["Crs"] * sin2 + m["Crc"] * cos2
    i = m["Io"] + m["IDOT"] * since + m["Cis"] * sin2 + m["Cic"] * cos2
    u = u + m["Cus"] * sin2 + m["Cuc"] * cos2
    node = m["Omega0"] + (m["OmegaDot"] - EARTH_RATE) * since - EARTH_RATE * m["Toe"]
    along, across = r * np.cos(u), r * np.sin(u)
    x = along * np.cos(node) - across * np.cos(i) * np.sin(node)
    y = along * np.sin(node) + across * np.cos(i) * np.cos(node)
    clock = m["SVclockBias"] + m["SVclockDrift"] * since + m["SVclockDriftRate"] * since**2
    return np.column_stack([x, y, across * np.sin(i)]), clock + RELATIVITY * m["Eccentricity"] * m["sqrtA"] * np.sin(E)


def turned(positions, seconds):
    """Return positions (N, 3) in the axes of an Earth that has turned for so many seconds (N,) since."""
    angle = EARTH_RATE * seconds
    x = positions[:, 0] * np.cos(angle) + positions[:, 1] * np.sin(angle)
    y = positions[:, 1] * np.cos(angle) - positions[:, 0] * np.sin(angle)
    return np.column_stack([x, y, positions[:, 2]])


def klobuchar(coefficients, latitude, longitude, azimuth, elevation, t):
    """Return the delay of L1 in the ionosphere (m). Angles are in degrees, t in seconds of the day (GPS time)."""
    e, lat, lon = elevation / 180, latitude / 180, longitude / 180  # semicircles, as the formula has it
    angle = 0.0137 / (e + 0.11) - 0.022
    lat = np.clip(lat + angle * np.cos(np.radians(azimuth)), -0.416, 0.416)
    lon = lon + angle * np.sin(np.radians(azimuth)) / np.cos(np.pi * lat)
    lat = lat + 0.064 * np.cos(np.pi * (lon - 1.617))
    alpha, beta = (np.polynomial.polynomial.polyval(lat, each) for each in np.reshape(coefficients, (2, 4)))
    phase = 2 * np.pi * ((43_200 * lon + t) % 86_400 - 50_400) / np.maximum(beta, 72_000)
    day = np.where(np.abs(phase) < 1.57, np.maximum(alpha, 0) * (1 - phase**2 / 2 + phase**4 / 24), 0)
    return C * (1 + 16 * (0.53 - e) ** 3) * (5e-9 + day)


def saastamoinen(height, elevation):
    """Return the delay in the troposphere (m) at a height (m) in the standard atmosphere, half saturated."""
    kelvin, pressure = 288.15 - 6.5e-3 * height, 1013.25 * (1 - 2.2557e-5 * height) ** 5.2568
    vapour = 0.5 * 6.108 * np.exp((17.15 * kelvin - 4684) / (kelvin - 38.45))
    slant = np.cos(np.radians(90 - elevation))
    return 0.0022768 * (pressure + (1255 / kelvin + 0.05) * vapour) / slant


def station_of(header):
    """Return the station's position (3,) from the header of the observations, as georinex gives it.

    Some files have 0 0 0 there, and files that were put together have several positions.

    >>> station_of({"APPROX POSITION XYZ": "        0.0000        0.0000        0.0000"})
    Traceback (most recent call last):
    ...
    ValueError: APPROX POSITION XYZ: needs a position on the Earth, got [0.0, 0.0, 0.0]
    """
    words = header.get("APPROX POSITION XYZ", "nan nan nan").split()
    positions = np.unique(np.array(words, dtype=float).reshape(-1, 3), axis=0)
    if len(positions) > 1:
        raise ValueError(f"APPROX POSITION XYZ: needs one position, got {positions.tolist()}: delete all but one")
    (position,) = positions
    if not 6.3e6 < np.linalg.norm(position) < 6.4e6:
        raise ValueError(f"APPROX POSITION XYZ: needs a position on the Earth, got {position.tolist()}")
    return position


def since_sunday(time, toe, sunday):
    """Return times of ephemeris (M,) in seconds since a Sunday's midnight, from those in seconds of their own weeks.

    time (M,) has the messages' dates, which tell the week: files begin on the evening before, and end on the next day.

    >>> since_sunday(np.array(["2020-06-27T22", "2020-06-28T00"], "datetime64[s]"), [597_600, 0], "2020-06-28")
    array([-7200.,     0.])
    """
    own_week = (time - np.datetime64(sunday)) / np.timedelta64(1, "s") - toe
    return toe + WEEK * np.round(own_week / WEEK)


def message_at(navigation, satellite, t, sunday):
    """Return the message of a satellite whose time of ephemeris is nearest, for each t (N,), as name -> (N,).

    t is in seconds since the midnight of that Sunday. "age" is how far that time is from t, in seconds.
    """
    own = navigation.sel(sv=satellite).dropna("time", how="all", subset=["Toe"])
    toe = since_sunday(own["time"].values, own["Toe"].values, sunday)
    nearest = np.abs(t[:, None] - toe).argmin(axis=1)
    numbers = {name: own[name].values[nearest] for name in own.data_vars if own[name].dims == ("time",)}
    return numbers | {"age": np.abs(t - toe[nearest])}


def observed(own, name, seen):
    """Return what a satellite's observations have of one kind at the epochs `seen`, NaN where there is nothing."""
    if name not in own:
        return np.full(seen.sum(), np.nan)
    values = own[name].values[seen]
    return np.where(values == 0, np.nan, values)  # a missing observation is zero or NaN


def about_their_mean(biases):
    """Return the values of a mapping less their mean: what all satellites share goes into the receiver's clock.

    >>> about_their_mean({"G01": 1.0, "G02": 3.0})
    {'G01': -1.0, 'G02': 1.0}
    """
    mean = sum(biases.values()) / max(len(biases), 1)
    return {satellite: value - mean for satellite, value in biases.items()}


def filled(own, others):
    """Return biases {satellite: m}, filled with others where there are none, and which satellites were filled.

    Both have a constant of their own, that of their receivers: the others are put on the mean that the own have over
    the satellites which both know. The result is about its mean.

    >>> filled({"G01": 1.0, "G02": 3.0}, {"G02": 13.0, "G03": 12.0})
    ({'G01': -1.0, 'G02': 1.0, 'G03': 0.0}, ['G03'])
    """
    shared = [satellite for satellite in own if satellite in others]
    added = [satellite for satellite in others if satellite not in own]
    if not (shared and added):
        return own, []
    offset = sum(own[each] - others[each] for each in shared) / len(shared)
    return about_their_mean(own | {each: others[each] + offset for each in added}), added


def own_biases(observations):
    """Return {satellite: C1C - C1W in metres}, means over the observations that have both; {} where none has."""
    if "C1W" not in observations:
        return {}
    found = {}
    for satellite in observations.sv.values:
        own = observations.sel(sv=satellite)
        both = (own["C1C"].values > 0) & (own["C1W"].values > 0)
        if both.any():
            found[str(satellite)] = float(np.mean((own["C1C"].values - own["C1W"].values)[both]))
    return about_their_mean(found)


def read_biases(path, day):
    """Return {satellite: C1C - C1W in metres} of a file, and how many days (or None) it lies from a day.

    The file is Bias-SINEX or a CSV, gzipped or not, day a numpy.datetime64. Raises ValueError for a file without them.
    """
    raw = Path(path).read_bytes()
    text = (gzip.decompress(raw) if raw[:2] == b"\x1f\x8b" else raw).decode("ascii", errors="replace")
    if text.startswith("%=BIA"):
        nanoseconds, days = _bias_sinex(text.splitlines(), day)
    else:
        rows = list(csv.DictReader(text.splitlines()))
        if not rows or not {"satellite", CSV_COLUMN} <= set(rows[0]):
            raise ValueError(f"{path}: needs Bias-SINEX, or a CSV with the columns satellite and {CSV_COLUMN}")
        nanoseconds, days = {}, None
        for number, row in enumerate(rows, start=2):
            satellite, value = _bias_of_line(path, number, row)
            if satellite in nanoseconds:
                raise ValueError(f"{path}, line {number}: needs one bias of each satellite, got {satellite} again")
            nanoseconds[satellite] = value
    if not nanoseconds:
        raise ValueError(f"{path}: needs biases of C1C and C1W of GPS satellites, got none")
    usual = np.nanmedian(list(nanoseconds.values()))
    for satellite, value in nanoseconds.items():
        if not abs(value - usual) <= MOST_BIAS:  # nan too
            need = f"biases in ns, within {MOST_BIAS:g} of their median {usual:.3g}"
            raise ValueError(f"{path}: needs {need}, got {value:g} of {satellite}")
    return about_their_mean({satellite: C * 1e-9 * value for satellite, value in nanoseconds.items()}), days


def _bias_of_line(path, number, row):
    """Return the satellite and the bias in ns of one line of a CSV, or raise ValueError that names file and line."""
    try:
        return row["satellite"], float(row[CSV_COLUMN])
    except (TypeError, ValueError):  # TypeError: a line that ends before the column
        got = row[CSV_COLUMN]
        raise ValueError(f"{path}, line {number}: needs a number in {CSV_COLUMN}, got {got or 'nothing'}") from None


def _bias_sinex(lines, day):
    """Return C1C - C1W in ns of each GPS satellite by the lines nearest to a day, and how many days that is."""
    single, found = {}, {}  # OSB of one code each, and their differences, as {satellite: (days, ns)}
    for line in lines:
        kind, satellite, station = line[1:4], line[11:14].strip(), line[15:24].strip()
        codes, unit = (line[25:29].strip(), line[30:34].strip()), line[65:69].strip()
        if (
            kind not in ("DSB", "OSB")
            or not satellite.startswith("G")
            or len(satellite) != 3
            or station
            or unit != "ns"
        ):
            continue
        value, away = float(line[70:91]), _days_outside(day, line[35:49], line[50:64])
        if kind == "OSB" and codes[0] in ("C1C", "C1W"):
            _keep_nearest(single, (satellite, codes[0]), away, value)
        elif codes in (("C1C", "C1W"), ("C1W", "C1C")):
            _keep_nearest(found, satellite, away, value if codes[0] == "C1C" else -value)
    for satellite, code in single:
        if code == "C1C" and (satellite, "C1W") in single and satellite not in found:
            (away, one), (_, other) = single[satellite, "C1C"], single[satellite, "C1W"]
            found[satellite] = away, one - other
    days = max((away for away, _ in found.values()), default=0.0)
    return {satellite: value for satellite, (_, value) in found.items()}, days


def _keep_nearest(found, key, away, value):
    """Keep of several lines for one key the one nearest in time; raises ValueError for two that disagree there."""
    if key in found and away == found[key][0] and abs(value - found[key][1]) > MOST_CHANGE:
        raise ValueError(f"needs one bias of {key} at a time, got {found[key][1]:g} and {value:g} ns")
    if key not in found or away < found[key][0]:
        found[key] = away, value


def _days_outside(day, start, end):
    """Return how many days a day lies outside of a span of Bias-SINEX, 0 within it.

    >>> _days_outside(np.datetime64("2024-05-03"), "2024:010:00000", "2024:011:00000")
    113.0
    """
    first, last = (
        np.datetime64(f"{each[:4]}-01-01") + np.timedelta64(int(each[5:8]) - 1, "D") for each in (start, end)
    )
    return float(max((first - day) / np.timedelta64(1, "D"), (day - last) / np.timedelta64(1, "D"), 0))


def biases_of(observations, path):
    """Return {satellite: C1C - C1W in metres} of the observations, filled from a file or None, and where they are from.

    {} and a warning stand for neither. Satellites that were filled are named.
    """
    own = own_biases(observations)
    if path is None:
        if not own:
            warnings.warn(NO_BIASES, stacklevel=2)
        return own, "of the observations" if own else "none"
    others, days = read_biases(path, observations["time"].values[0].astype("datetime64[D]"))
    seen = {str(satellite) for satellite in observations.sv.values}
    others = {satellite: value for satellite, value in others.items() if satellite in seen}
    found, added = filled(own, others) if own else (others, list(others))
    if own and not added:
        shared = "knows no others" if set(others) <= set(own) else "knows none of these, and is not used"
        return found, f"of the observations, for {len(own)} satellites; {path} {shared}"
    if days is None:
        warnings.warn(
            f"{path} does not say of which day its biases are: numbers of satellites go to new ones", stacklevel=2
        )
    elif days > OLD:
        warnings.warn(
            f"{path} is {days:.0f} days from the observations: numbers of satellites go to new ones", stacklevel=2
        )
    if not own:
        return found, f"of {path}"
    return found, f"of the observations, and of {path}, put on their mean, for {', '.join(added)}"


def rows_of(satellite, observations, navigation, station, coefficients, bias=0.0):
    """Return the table's rows (N, 13) of one satellite, whose C1C is `bias` metres longer than C1W."""
    from pymap3d import ecef2aer, ecef2geodetic

    own = observations.sel(sv=satellite)
    seen = own["C1C"].values > 0
    time, measured = own["time"].values[seen].astype("datetime64[ns]"), own["C1C"].values[seen]
    second = observed(own, "C2W", seen)
    phase1 = observed(own, "L1C", seen) * C / L1
    phase2 = observed(own, "L2W", seen) * C / L2
    midnight = observations["time"].values[0].astype("datetime64[D]")
    epoch = (time - midnight) / np.timedelta64(1, "s")
    sunday = np.datetime64("1980-01-06") + (midnight - np.datetime64("1980-01-06")) // np.timedelta64(7, "D") * 7
    t = epoch + (midnight - sunday) / np.timedelta64(1, "s")
    message = message_at(navigation, satellite, t, sunday)
    _, clock = orbit(message, t - measured / C)
    at_transmission, clock = orbit(message, t - measured / C - clock)
    travel = np.linalg.norm(at_transmission - station, axis=1) / C
    position = turned(at_transmission, travel)
    latitude, longitude, height = ecef2geodetic(*station)
    azimuth, elevation, _ = ecef2aer(*position.T, latitude, longitude, height)
    ionosphere = klobuchar(coefficients, latitude, longitude, azimuth, elevation, epoch)
    troposphere = saastamoinen(height, elevation)
    corrected = measured - bias + C * (clock - message["TGD"]) - ionosphere - troposphere
    free = (L1**2 * (measured - bias) - L2**2 * second) / (L1**2 - L2**2)
    dual = free + C * clock - troposphere - corrected
    number = np.full(len(epoch), int(satellite[1:]))
    as_measured = np.column_stack([second, phase1, phase2]) - measured[:, None]
    biases = np.full(len(epoch), bias)
    rows = np.column_stack([epoch, number, position, corrected, elevation, troposphere, dual, as_measured, biases])
    current = message["age"] <= MOST_AGE
    if not current.all():
        how_many = f"{satellite}: {np.sum(~current)} of {len(current)} ranges left out"
        warnings.warn(f"{how_many}: no message of the navigation file is within two hours of them", stacklevel=2)
    return rows[(elevation > MASK) & (message["health"] == 0) & current]


def ends_early(header, last):
    """Return how many seconds before the time that its header names the observations end, 0 within one interval.

    header is that of georinex, last the time of the last epoch that was read. A header may name no last time.

    >>> header = {"TIME OF LAST OBS": "  2020     6    25    23    59   30.0000000     GPS", "INTERVAL": "  30.000  "}
    >>> ends_early(header, np.datetime64("2020-06-25T21:59:30"))
    7200.0
    """
    words = header.get("TIME OF LAST OBS", "").split()
    if len(words) < 6:
        return 0.0
    year, month, day, hour, minute = (int(word) for word in words[:5])
    minutes = np.datetime64(f"{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}")
    missing = (minutes - last) / np.timedelta64(1, "s") + float(words[5])
    interval = float((header.get("INTERVAL") or "60").split()[0])
    return float(missing) if missing > interval else 0.0


def whole_epochs(text):
    """Return the observations of a RINEX 3 file as georinex can read them, and in words what was left out.

    georinex stops without a word at a line between two epochs that begins none: a comment, or an event with lines of
    its own. A file that was cut ends within an epoch, or within a number: that one would be read as a smaller one.
    """
    lines = text.splitlines()
    end = next(k for k, line in enumerate(lines) if "END OF HEADER" in line) + 1
    said = []
    if not text.endswith("\n") and lines[-1] != _whole_numbers(lines[-1]):
        lines[-1] = _whole_numbers(lines[-1])
        said.append("the last line is cut within a number, which is left out")
    body = [line for line in lines[end:] if line[60:].strip() != "COMMENT"]
    starts = [k for k, line in enumerate(body) if line.startswith(">")]
    kept, last, broken, incomplete = lines[:end], "", [], []
    for start, following in zip(starts, [*starts[1:], len(body)], strict=True):
        epoch, inside = body[start], [line for line in body[start + 1 : following] if line.strip()]
        flag, count = epoch[29:32].strip(), epoch[32:35].strip()
        if flag in EVENTS:
            changes = next((line[60:].strip() for line in inside if line[60:].strip() in CHANGES), None)
            if flag == NEW_SITE or changes:
                said.append(f"not read from {epoch[2:21]} on, where {changes or 'a new site'} is announced")
                break
            continue
        satellites = [line for line in inside if SATELLITE.match(line)]
        if not EPOCH.match(epoch) or epoch[:29] <= last or not satellites:
            broken.append(epoch[2:21])
            continue
        if len(satellites) != int(count) or len(satellites) != len(inside):
            incomplete.append(epoch[2:21])
        kept += [f"{epoch[:32]}{len(satellites):3d}{epoch[35:]}", *satellites]
        last = epoch[:29]
    if broken:
        said.append(f"{len(broken)} epochs left out that are cut, empty, or not later ({broken[0]})")
    if incomplete:
        said.append(f"{len(incomplete)} epochs have fewer or more lines than they announce ({incomplete[0]})")
    return "\n".join([*kept, ""]), said


def _whole_numbers(line):
    """Return the last line of a file that does not end with a line, without a number that is cut."""
    if not SATELLITE.match(line):
        return line
    numbers = [line[k : k + 16] for k in range(3, len(line), 16)]
    return line[:3] + "".join(each if WHOLE.match(each) else " " * 16 for each in numbers)


def whole_messages(text):
    """Return the GPS messages of a RINEX 3 navigation file as georinex can read them, and in words what was left out.

    georinex takes a comment for a line of numbers, and what is missing from a message that was cut for zeros.
    """
    lines = text.splitlines()
    end = next(k for k, line in enumerate(lines) if "END OF HEADER" in line) + 1
    body = [line for line in lines[end:] if line[60:].strip() != "COMMENT" and line.strip()]
    starts = [k for k, line in enumerate(body) if SATELLITE.match(line)]
    kept, broken = lines[:end], []
    for start, following in zip(starts, [*starts[1:], len(body)], strict=True):
        message = body[start:following]
        if not message[0].startswith("G"):
            continue
        columns = [message[0][23:], *(line[4:] for line in message[1:])]
        numbers = [line[k : k + 19] for line in columns for k in range(0, len(line.rstrip()), 19)]
        if len(message) == MESSAGE_LINES and len(numbers) >= MESSAGE_NUMBERS and all(map(NUMBER.fullmatch, numbers)):
            kept += message
        else:
            broken.append(message[0][:23])
    said = [f"{len(broken)} messages left out that are cut or broken ({broken[0]})"] if broken else []
    return "\n".join([*kept, ""]), said


def text_of(path):
    """Return the text of a RINEX file, unpacked as georinex does it."""
    from georinex.rio import opener

    with opener(path) as file:
        return file.read()


def load(path, what, need, whole, **options):
    """Return what georinex reads of a file, and its header, or end with a message that says what it lacks.

    `need` tells from the header what is missing, or nothing; `whole` is `whole_epochs` or `whole_messages`.
    """
    import georinex

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)  # georinex: one for each message
            header = georinex.rinexheader(path)
            missing = need(header)
            if not missing:
                text, left_out = whole(text_of(path))
                found = georinex.load(io.StringIO(text), use="G", **options)
    except Exception as error:  # a file that is cut or of another kind fails anywhere in it
        raise SystemExit(f"{path}: needs a RINEX 3 file of {what}, got one that cannot be read ({error!r})") from None
    if missing:
        raise SystemExit(f"{path}: needs {missing}")
    for each in left_out:
        warnings.warn(f"{path}: {each}", stacklevel=2)
    return found, header


def lacking_in_observations(header):
    """Tell what observations lack by their header, or return None.

    >>> lacking_in_observations({"rinextype": "obs", "version": 3.05, "fields": {"E": ["C1C"], "R": ["C1C"]}})
    'GPS observations, got those of E, R only'
    """
    if header["rinextype"] != "obs":
        return "observations, got another kind of file: are the two swapped?"
    if header["version"] < 3:  # also that of the Hatanaka compression, which is 1 for RINEX 2
        return "RINEX 3, got RINEX 2, whose names of ranges say less (C1, P2): convert it first"
    fields = header["fields"]
    if "G" not in fields:
        return f"GPS observations, got those of {', '.join(sorted(fields))} only"
    if "C1C" not in fields["G"]:
        return f"GPS ranges C1C, got the observations {' '.join(fields['G'])}"
    return None


def lacking_in_navigation(header):
    """Tell what a navigation file lacks by its header, or return None."""
    if header["rinextype"] != "nav":
        return "broadcast ephemerides, got another kind of file: are the two swapped?"
    if header["version"] < 3:
        return "RINEX 3, got RINEX 2: convert it first"
    return None


def show_in_one_line(message, *_):
    """Print a warning as one line: where in this script it arose tells a user nothing."""
    print(f"warning: {message}", file=sys.stderr)


def main():
    """Read the files that the command line names and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("observations", type=Path)
    parser.add_argument("navigation", type=Path)
    parser.add_argument("table", type=Path)
    parser.add_argument("--biases", type=Path, help="C1C - C1W of each satellite, where the observations have no C1W")
    names = parser.parse_args()
    if not names.table.absolute().parent.is_dir():
        raise SystemExit(f"{names.table}: needs a folder that exists, got {names.table.parent}")

    observations, header = load(
        names.observations, "observations", lacking_in_observations, whole_epochs, meas=OBSERVED
    )
    navigation, _ = load(names.navigation, "broadcast ephemerides", lacking_in_navigation, whole_messages)
    if "C1C" not in observations or not (observations["C1C"].values > 0).any():
        raise SystemExit(f"{names.observations}: needs GPS ranges C1C, got none in its epochs")
    if "Toe" not in navigation or not len(navigation.sv.values):
        raise SystemExit(f"{names.navigation}: needs ephemerides of GPS satellites, got none")
    if "ionospheric_corr_GPS" not in navigation.attrs:
        raise SystemExit(f"{names.navigation}: needs GPSA and GPSB, the ionosphere, in its header")
    try:
        station = station_of(header)
    except ValueError as error:
        raise SystemExit(f"{names.observations}: {error}") from None
    early = ends_early(header, observations["time"].values[-1])
    if early:
        warnings.warn(
            f"{names.observations}: what could be read ends {early:.0f} s before its header says", stacklevel=2
        )
    try:
        biases, source = biases_of(observations, names.biases)
    except (OSError, ValueError) as error:
        raise SystemExit(f"--biases: {error}") from None
    coefficients = navigation.attrs["ionospheric_corr_GPS"]
    known = [sv for sv in observations.sv.values if sv in navigation.sv.values]
    without = [str(sv) for sv in known if sv not in biases]
    if biases and without:
        warnings.warn(f"no code bias of {', '.join(without)}: taken for the mean of all", stacklevel=2)
    rows = [rows_of(sv, observations, navigation, station, coefficients, biases.get(sv, 0.0)) for sv in known]
    table = np.vstack([np.empty((0, len(FORMAT.split(",")))), *rows])
    if not len(table):
        raise SystemExit(f"{names.navigation}: needs messages of the day of {names.observations}, got none")
    table = table[np.lexsort([table[:, 1], table[:, 0]])]
    lines = [",".join(FORMAT.split(",")) % tuple(row) for row in table]
    first = ",".join(["# station", *map(str, station.tolist())])
    text = "\n".join([first, COLUMNS, *lines, ""])
    names.table.write_bytes(gzip.compress(text.encode(), mtime=0))
    print(f"{names.table}: {len(table)} rows, {len(np.unique(table[:, 0]))} epochs, {len(known)} satellites")
    print(f"code biases: {source}")


if __name__ == "__main__":
    warnings.showwarning = show_in_one_line
    main()
