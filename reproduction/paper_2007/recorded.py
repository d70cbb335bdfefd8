"""What real receivers say of the paper of 2007: a table of ranges becomes fixes, and their errors noise and what lasts.

A station stands still, so that whatever moves is error. Errors are counted from the mean of the recording: what is
constant, or slower than the recording, is in none of the numbers.
"""

import gzip
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mpt_helpers.checks import refuse
from mpt_helpers.filters import KalmanFilter
from mpt_helpers.fitting import fit
from mpt_helpers.lasting import lasting_error
from mpt_helpers.metrics import nis, rms
from mpt_helpers.model import constant_velocity, gps_ins

from . import positioning
from .experiments import exact_moments

TABLES = {"ESBC": "esbc_2020_177.csv.gz", "NYA1": "nya1_2024_124.csv.gz"}
KINDS = ("one frequency", "two frequencies")
AXES = ("east", "north", "up")
LAMBDA = 1.6469444  # (f1/f2)² of GPS: the delay in the ionosphere goes with 1/f²
SLIP = 0.15  # m, of L1 - L2 from epoch to epoch: a lost cycle makes 0.19 m or more, the ionosphere hardly ever 0.15
JUMP = 10.0  # m, of phase minus code: its noise moved up to 5 m; whole cycles that L1 - L2 does not show make 14.7 m
SMOOTHED = 10  # epochs of a carrier-smoothed range: 5 minutes, in which the ionosphere changes little
WINDOW = 100  # fixes of a line or a filter: the paper's n
UNKNOWN = np.diag([10.0**2, 1.0**2])  # m², (m/s)²: what a filter knows of position and velocity at the start
SETTLED = 20  # epochs after which a filter's statement is judged
SPEED, BIAS, INS_SIGMA = 0.2, 1.0, 0.01  # m/s, of the paper: the velocity, and the INS's constant and random error


class Day(NamedTuple):
    """A table of recorded ranges: N epochs of 32 satellites, NaN where a satellite was not in view."""

    station: np.ndarray  # (3,), as the header of the raw file has it
    seconds: np.ndarray  # (N,)
    satellites: np.ndarray  # (N, 32, 3)
    ranges: np.ndarray  # (N, 32), corrected
    troposphere: np.ndarray  # (N, 32), what was taken from them for it
    dual: np.ndarray  # (N, 32), what to add for two frequencies
    second: np.ndarray  # (N, 32), C2W minus C1C
    phase1: np.ndarray  # (N, 32), L1C minus C1C
    phase2: np.ndarray  # (N, 32), L2W minus C1C


def recorded_day(path):
    """Read a table that `notebooks/data/make_table.py` made.

    Raises ValueError for a table of other columns.
    """
    with gzip.open(path, "rt") as lines:
        station = np.array(next(lines).split(",")[1:], dtype=float)
        columns = next(lines).strip().split(",")
    if columns[-3:] != ["second", "phase1", "phase2"]:
        refuse("path", "a table of make_table.py with its 12 columns", f"the columns {','.join(columns)}")
    rows = np.loadtxt(path, delimiter=",", skiprows=2)
    seconds, k = np.unique(rows[:, 0], return_inverse=True)
    full = np.full((len(seconds), 32, 9), np.nan)
    full[k, rows[:, 1].astype(int) - 1] = rows[:, [2, 3, 4, 5, 7, 8, 9, 10, 11]]
    return Day(station, seconds, full[..., :3], *np.moveaxis(full[..., 3:], 2, 0))


def recorded_days(tables=None):
    """Read tables {name: file} from the notebooks' data, by default those of both stations; return {name: Day}."""
    folder = Path("notebooks/data") if Path("notebooks").is_dir() else Path("data")
    return {name: recorded_day(folder / file) for name, file in (tables or TABLES).items()}


def ranges_of(day, kind):
    """Return the ranges (N, 32) of one of the `KINDS`: its ionosphere is of a model, or of two frequencies."""
    return day.ranges if kind == KINDS[0] else day.ranges + day.dual


class Fixes(NamedTuple):
    """A least-squares fix for each epoch.

    local (N, 3) is east, north and up of the header's position, P (N, 3, 3) its covariance where each range has the
    variance 1: the squares of the DOP. chi_square (N,) is the sum of squared residuals, redundant (N,) the number of
    satellites beyond four.
    """

    local: np.ndarray
    P: np.ndarray
    chi_square: np.ndarray
    redundant: np.ndarray


def fixes(day, ranges, variance=1.0):
    """Return the `Fixes` of ranges (N, 32) of a day, each as `positioning.position` makes it, all epochs at once.

    variance is a number or (N, 32). The start is the station. No range is tested. Raises ValueError for an epoch of
    fewer than four.
    """
    seen = np.isfinite(ranges)
    count = seen.sum(axis=1)
    if count.min() < 4:
        refuse("ranges", "four satellites at each epoch", f"{count.min()} in row {count.argmin()}")
    weight = np.where(seen, 1 / np.sqrt(variance), 0.0)
    satellites = np.where(seen[..., None], day.satellites, 0.0)
    X = np.tile(np.append(day.station, 0.0), (len(ranges), 1))
    for _ in range(5):  # the start is metres off: two steps are enough, since each squares the error over 2e7 m
        away = satellites - X[:, None, :3]
        distance = np.linalg.norm(away, axis=2)
        H = np.concatenate([-away / distance[..., None], np.ones((*distance.shape, 1))], axis=2) * weight[..., None]
        residuals = weight * np.where(seen, ranges - distance - X[:, 3:], 0.0)
        N = np.swapaxes(H, 1, 2) @ H
        X = X + np.linalg.solve(N, np.swapaxes(H, 1, 2) @ residuals[..., None])[..., 0]
    axes = positioning.local_axes(day.station)
    P = axes @ np.linalg.inv(N)[:, :3, :3] @ axes.T
    return Fixes((X[:, :3] - day.station) @ axes.T, P, np.square(residuals).sum(axis=1), seen.sum(axis=1) - 4)


def ranging_sigma(found):
    """Return the standard deviation (m) of the ranges that the residuals of `Fixes` show."""
    return float(np.sqrt(found.chi_square.sum() / found.redundant.sum()))


def carrier(day, kind):
    """Return a carrier range minus the code range of one kind, (N, 32): their noise with a minus sign, and a constant.

    The constant is another one in each of the `arcs`. The code of one frequency sees the ionosphere delayed, its phase
    advanced: twice that is put right with the second phase. With two frequencies neither sees it.
    """
    if kind == KINDS[0]:
        return day.phase1 + 2 * (day.phase1 - day.phase2) / (LAMBDA - 1)
    return (LAMBDA * day.phase1 - day.phase2 + day.second) / (LAMBDA - 1)


def arcs(day):
    """Return the number of the arc (N, 32) that each phase belongs to, -1 where there is none.

    An arc ends where a satellite is lost, or where L1 - L2 or phase minus code jump: there a cycle was lost.
    """
    there = np.isfinite(day.second + day.phase1 + day.phase2)
    new = np.ones(there.shape, dtype=bool)
    steps = (np.abs(np.diff(each, axis=0)) for each in (day.phase1 - day.phase2, day.phase1))
    slip, jump = steps
    with np.errstate(invalid="ignore"):
        new[1:] = ~(there[:-1] & (slip < SLIP) & (jump < JUMP))
    return np.where(there, np.cumsum(new, axis=0), -1)


def arc_means(values, arc):
    """Return the mean of values (N, 32) over each arc, in the shape of values; NaN where there is no arc.

    >>> arc_means(np.array([[1.0], [3.0], [5.0]]), np.array([[1], [1], [2]])).ravel()
    array([2., 2., 5.])
    """
    label = np.where(arc >= 0, arc + (len(arc) + 1) * np.arange(arc.shape[1]), -1)
    _, index = np.unique(label, return_inverse=True)
    index = index.reshape(label.shape)
    there = label >= 0
    sums = np.bincount(index[there], values[there], minlength=index.max() + 1)
    counts = np.bincount(index[there], minlength=index.max() + 1)
    return np.where(there, (sums / np.maximum(counts, 1))[index], np.nan)


def smoothed(code, phase, arc, most=SMOOTHED):
    """Return carrier-smoothed ranges (N, m): the code's noise averaged over at most so many epochs of an arc (Hatch).

    code and phase are ranges (N, m), the phase with an unknown constant in each arc (N, m). Each epoch uses the past
    only. Where there is no arc (-1), the code stays.

    >>> phase = np.array([[0.0], [10.0], [20.0]])
    >>> smoothed(np.array([[101.0], [109.0], [120.0]]), phase, np.array([[1], [1], [1]])).ravel()
    array([101., 110., 120.])
    """
    offset, count, ranges = np.zeros(code.shape[1]), np.zeros(code.shape[1]), code.copy()
    for k, here in enumerate(arc):
        goes_on = (here >= 0) & (here == arc[k - 1]) if k else np.zeros(len(here), dtype=bool)
        count = np.where(goes_on, np.minimum(count + 1, most), 1)
        gap = code[k] - phase[k] - offset
        offset = np.where(goes_on, offset + gap / count, code[k] - phase[k])
        ranges[k] = np.where(here >= 0, phase[k] + offset, code[k])
    return ranges


class Case(NamedTuple):
    """One kind of range of one station: errors (N, 3) east, north and up, in metres about the mean of the day.

    errors are those of the fixes. Of these, noise is what code and carrier phase do not share, averaged to zero over
    each arc, and lasting is the rest. smooth are the errors of fixes from carrier-smoothed ranges.
    """

    station: str
    kind: str
    errors: np.ndarray
    noise: np.ndarray
    lasting: np.ndarray
    smooth: np.ndarray


def case(station, day, kind):
    """Return the `Case` of one kind of range of a day."""
    code, phase, arc = ranges_of(day, kind), carrier(day, kind), arcs(day)
    levelled = np.where(arc >= 0, code + phase - arc_means(phase, arc), code)
    smooth = smoothed(code, np.where(arc >= 0, code + phase, 0.0), arc)
    local = [fixes(day, each).local for each in (code, levelled, smooth)]
    whole, lasting, smooth = (each - each.mean(axis=0) for each in local)
    return Case(station, kind, whole, whole - lasting, lasting, smooth)


def cases(days):
    """Return the `Case` of each kind of range of each day {name: Day}, by "name, kind"."""
    return {f"{name}, {kind}": case(name, day, kind) for name, day in days.items() for kind in KINDS}


def size(errors):
    """Return the root mean square of three-dimensional errors (N, 3), in metres.

    >>> float(size(np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 5.0]])))
    5.0
    """
    return np.sqrt(np.mean(np.sum(np.square(errors), axis=1)))


def autocorrelation(x):
    """Return the autocorrelation (N,) of a series (N,) about its mean.

    The sum of each lag is divided by that of lag 0, not by its own number of terms, which keeps the matrix R of the
    entries ρ_|j-k| positive semidefinite.

    >>> autocorrelation(np.array([1.0, -1.0, 1.0, -1.0]))
    array([ 1.  , -0.75,  0.5 , -0.25])
    """
    x = x - x.mean()
    sums = np.correlate(x, x, "full")[len(x) - 1 :]
    return sums / sums[0]


def line_errors(errors, n):
    """Fit a line through each n successive errors of a receiver, (N,); return the errors of the lines, (2, N - n + 1).

    The first row holds the errors in the middle of the lines, the second those at their newest points.

    >>> line_errors(np.array([1.0, 2.0, 3.0, 4.0]), 3)
    array([[2., 3.],
           [3., 4.]])
    """
    line = positioning.line_fit(np.lib.stride_tricks.sliding_window_view(errors, n).T, 1.0)
    return np.array([line.start + line.velocity * (n + 1) / 2, line.start + line.velocity * n])


def line_ratios(errors, n):
    """Return the rms of both rows of `line_errors`, (2,), each over the rms of the fixes at the same epochs.

    The rms of the whole series would not do, since a receiver is worse in some hours. Where the middle lies between two
    epochs, the fix is that of the first.

    >>> line_ratios(np.array([1.0, -1.0, 1.0, 2.0]), 3).round(3)
    array([0.527, 0.98 ])
    """
    fixes = errors[(n - 1) // 2 : len(errors) - n // 2], errors[n - 1 :]
    return rms(line_errors(errors, n), axis=1) / [rms(each) for each in fixes]


def newest_points(errors, n):
    """Return the errors (N - n + 1, 3) of lines through n fixes at their newest points, from errors (N, 3)."""
    return np.transpose([line_errors(axis, n)[1] for axis in errors.T])


def newest_ratio(errors, n):
    """Return the three-dimensional error of the newest points of lines over that of the fixes at the same epochs."""
    return size(newest_points(errors, n)) / size(errors[n - 1 :])


def mean_ratio(errors, n):
    """Return the three-dimensional error of the means of n successive fixes over that of their last ones.

    >>> float(mean_ratio(np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]), 2))
    0.0
    """
    return size(np.lib.stride_tricks.sliding_window_view(errors, n, axis=0).mean(axis=-1)) / size(errors[n - 1 :])


def windows(errors, n=WINDOW):
    """Return successive stretches of n errors (N,) as tracks, (n, 1, N // n).

    >>> windows(np.arange(5.0), 2).shape
    (2, 1, 2)
    """
    tracks = len(errors) // n
    return errors[: tracks * n].reshape(tracks, n).T[:, None]


def white(r):
    """Return the filter that takes errors for independent: constant velocity, no process noise, variance r (m²)."""
    return KalmanFilter(constant_velocity(dt=30.0, q=0.0, r=r, P0=UNKNOWN))


def tracker(q, r):
    """Return the filter that takes errors for independent, but wanders: constant velocity, process noise q (m²/s³)."""
    return KalmanFilter(constant_velocity(dt=30.0, q=q, r=r, P0=UNKNOWN))


def with_lasting(r, sigma, tau):
    """Return the filter whose model has an error state besides: of sigma metres, that fades within tau seconds."""
    axis = constant_velocity(dt=30.0, q=0.0, r=r, P0=UNKNOWN)
    return KalmanFilter(lasting_error(axis, sigma=sigma, tau=tau))


def fit_lasting(errors):
    """Return the `Fit` of `with_lasting` to errors (N,), from the measurements alone: the true position is not used."""
    return fit(with_lasting, errors[:, None], r=0.1 * errors.var(), sigma=errors.std(), tau=1800.0)


def fit_tracker(errors):
    """Return the `Fit` of `tracker` to errors (N,): what makes its innovations most probable."""
    return fit(tracker, errors[:, None], q=1e-6, r=errors.var())


class Judged(NamedTuple):
    """A filter judged over windows of errors: its error and stated sigma (n,), NEES, share within 2σ, NIS.

    The NEES is that of the position alone: a filter that is right has 1. That of all states would hide it.
    """

    error: np.ndarray
    stated: np.ndarray
    nees: float
    within: float
    nis: float


def judged(filter, tracks):
    """Judge a filter over tracks (n, 1, M) of errors: its truth is zero."""
    found = filter.estimates(tracks)
    position, variance = found.x[:, 0], found.P[:, 0, 0]
    square = np.square(position)[SETTLED:] / variance[SETTLED:]
    share = float(np.mean(square < 4))
    return Judged(
        rms(position, axis=1), np.sqrt(variance[:, 0]), square.mean(), share, nis(filter, tracks)[SETTLED:].mean()
    )


class Filtered(NamedTuple):
    """Three axes of a case: the fits of `fit_lasting`, and three filters `judged` over windows.

    The white filter takes the variance of the fixes for that of independent errors, the tuned one has the constants of
    `fit_tracker`, the aware one those of the fits.
    """

    fits: tuple
    white: tuple
    tuned: tuple
    aware: tuple


def filtered(case):
    """Return the `Filtered` of a `Case`."""
    fits = tuple(fit_lasting(errors) for errors in case.errors.T)
    tracks = [windows(errors) for errors in case.errors.T]
    without = tuple(judged(white(errors.var()), each) for errors, each in zip(case.errors.T, tracks, strict=True))
    tuned = tuple(judged(fit_tracker(errors).filter, each) for errors, each in zip(case.errors.T, tracks, strict=True))
    aware = tuple(judged(found.filter, each) for found, each in zip(fits, tracks, strict=True))
    return Filtered(fits, without, tuned, aware)


def half_days(case):
    """Return the spread (2, 3) of what lasts in both halves of the day, in metres, about the mean of each half."""
    half = len(case.lasting) // 2
    return np.array([case.lasting[:half].std(axis=0), case.lasting[half:].std(axis=0)])


def ins_model(r, q=0.0):
    """Return the paper's model of GPS and INS for fixes 30 s apart: r (m²) is their variance, q as in `gps_ins`."""
    return gps_ins(30.0, q, (r, INS_SIGMA**2), P0=np.diag([*np.diag(UNKNOWN), 1.0]))


class WithIns(NamedTuple):
    """The errors of a filter of GPS and INS over windows of recorded errors, rms over their second halves.

    position (m), velocity and bias (m/s) are its errors, fix (m) that of the fixes. stated (m) is its last sigma of the
    position, nees that of the position alone.
    """

    position: float
    velocity: float
    bias: float
    fix: float
    stated: float
    nees: float


def with_ins(model, errors):
    """Judge a filter of GPS and INS over windows of recorded errors (N,). The INS is simulated: no receiver had one.

    The numbers are the expected ones: the effect of the INS's random errors is added as their covariance, so that no
    seed enters.
    """
    gps = windows(errors)[:, 0]
    n, M = gps.shape
    truth = np.tile(np.column_stack([SPEED * 30.0 * np.arange(n), np.full(n, SPEED), np.full(n, BIAS)])[..., None], M)
    z = np.stack([truth[:, 0] + gps, truth[:, 1] + truth[:, 2]], axis=1)
    kf = KalmanFilter(model)
    mean, covariance = exact_moments(lambda z: kf.filter(z)[:, :3], z, truth, [0.0, INS_SIGMA])
    square = np.square(mean) + np.diagonal(covariance, axis1=1, axis2=2)[..., None]
    variance = kf.covariances(n)[:, 0, 0]
    nees = (square[SETTLED:, 0] / variance[SETTLED:, None]).mean()
    position, velocity, bias = np.sqrt(square[n // 2 :].mean(axis=(0, 2)))
    return WithIns(position, velocity, bias, rms(gps[n // 2 :]), np.sqrt(variance[-1]), nees)
