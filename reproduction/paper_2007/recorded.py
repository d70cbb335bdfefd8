"""What real receivers say of the paper of 2007: a table of ranges becomes fixes, and their errors noise and what lasts.

A station stands still, so that whatever moves is error. Errors are counted from the mean of the recording: what is
constant, or slower than the recording, is in none of the numbers, but for `Case.offset`.

The receiver may be any that stood still: another step, epochs that are missing, one frequency only. Faulty ranges are
left out first (`tested`), and each case says how many.
"""

import gzip
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.signal import correlate
from scipy.stats import chi2

from mpt_helpers._checks import refuse
from mpt_helpers.kalman import KalmanFilter
from mpt_helpers.metrics import rms
from mpt_helpers.model import constant_velocity, gps_ins
from reproduction.lasting import lasting_error

from . import positioning
from .experiments import exact_moments

TABLES = {"ESBC": "esbc_2020_177.csv.gz", "Belem": "bele_2024_010.csv.gz", "NYA1": "nya1_2024_124.csv.gz"}
KINDS = ("one frequency", "two frequencies")
AXES = ("east", "north", "up")
LAMBDA = 1.6469444  # (f1/f2)² of GPS: the delay in the ionosphere goes with 1/f²
AMPLIFIED = LAMBDA / (LAMBDA - 1)  # what two frequencies make of an error of the first: 2.55
SLIP = 0.15  # m, of L1 - L2 from epoch to epoch: a lost cycle makes 0.19 m or more, the ionosphere hardly ever 0.15
JUMP = 10.0  # m, of phase minus code: its noise moved up to 5 m; whole cycles that L1 - L2 does not show make 14.7 m
SMOOTHED = 300.0  # s, the time of a carrier-smoothed range with both phases
SMOOTHED_L1 = 100.0  # s, with one phase: the ionosphere delays the code and advances the phase, and they part
# The residuals of an epoch are tested with twice the usual sigma of the day: in bad hours they are up to 14 times the
# usual square, and no epoch of the three days shipped fails. Faults beyond some ten sigma are found.
BAD_HOURS, FALSE_ALARM = 2.0, 1e-5
POOR = 10.0  # PDOP from which on a fix says little: ten metres for each metre of a range
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
    bias: np.ndarray  # (N, 32), what was taken from the ranges for the satellites' code biases

    @property
    def step(self):
        """Return the time between epochs in seconds."""
        return float(self.seconds[1] - self.seconds[0])


def recorded_day(path):
    """Read a table that `notebooks/data/make_table.py` made; an epoch that is missing becomes a row of NaN.

    Raises ValueError for a table of other columns, and for epochs that have no common step.
    """
    with gzip.open(path, "rt") as lines:
        station = np.array(next(lines).split(",")[1:], dtype=float)
        columns = next(lines).strip().split(",")
    if columns[-4:] != ["second", "phase1", "phase2", "bias"]:
        refuse("path", "a table of make_table.py with its 13 columns", f"the columns {','.join(columns)}")
    rows = np.loadtxt(path, delimiter=",", skiprows=2)
    epochs, k = np.unique(rows[:, 0], return_inverse=True)
    step = float(np.median(np.diff(epochs)))
    row = np.round((epochs - epochs[0]) / step).astype(int)
    if (np.diff(row) == 0).any():
        refuse("path", f"epochs of one step, here {step:g} s", f"epochs {np.diff(epochs).min():g} s apart")
    seconds = epochs[0] + step * np.arange(row[-1] + 1)
    full = np.full((len(seconds), 32, 10), np.nan)
    full[row[k], rows[:, 1].astype(int) - 1] = rows[:, [2, 3, 4, 5, 7, 8, 9, 10, 11, 12]]
    return Day(station, seconds, full[..., :3], *np.moveaxis(full[..., 3:], 2, 0))


def without_biases(day):
    """Return a `Day` whose ranges keep the satellites' code biases."""
    return day._replace(ranges=day.ranges + day.bias, dual=day.dual + (AMPLIFIED - 1) * day.bias, bias=0 * day.bias)


def recorded_days(tables=None):
    """Read tables {name: file} from the notebooks' data, by default those shipped; return {name: Day}."""
    return {name: _kept_day((_data() / file).resolve()) for name, file in (tables or TABLES).items()}


@lru_cache(maxsize=8)
def _kept_day(path):
    """Return `recorded_day`, read once in a process; nobody may write to it."""
    day = recorded_day(path)
    for values in day:
        values.setflags(write=False)
    return day


def _data():
    """Return the folder of the recordings, from the project's root, its notebooks or its lessons."""
    folders = [Path(each) for each in ("notebooks/data", "data", "../data")]
    return next((each for each in folders if each.is_dir()), folders[0])


def ranges_of(day, kind):
    """Return the ranges (N, 32) of one of the `KINDS`: its ionosphere is of a model, or of two frequencies."""
    return day.ranges if kind == KINDS[0] else day.ranges + day.dual


class Fixes(NamedTuple):
    """A least-squares fix for each epoch.

    local (N, 3) is east, north and up of the header's position, P (N, 3, 3) its covariance where each range has the
    variance 1: the squares of the DOP. chi_square (N,) is the sum of squared residuals, redundant (N,) the number of
    satellites beyond four. An epoch of fewer than four is NaN.
    """

    local: np.ndarray
    P: np.ndarray
    chi_square: np.ndarray
    redundant: np.ndarray


def fixes(day, ranges, variance=1.0):
    """Return the `Fixes` of ranges (N, 32) of a day, each as `positioning.position` makes it, all epochs at once.

    variance is a number or (N, 32). The start is the station. No range is tested: `tested` does it.
    """
    seen = np.isfinite(ranges)
    enough = seen.sum(axis=1) >= 4
    weight = np.where(seen, 1 / np.sqrt(variance), 0.0)
    satellites = np.where(seen[..., None], day.satellites, 0.0)
    X = np.tile(np.append(day.station, 0.0), (len(ranges), 1))
    for _ in range(5):  # the start is metres off: two steps are enough, since each squares the error over 2e7 m
        away = satellites - X[:, None, :3]
        distance = np.linalg.norm(away, axis=2)
        H = np.concatenate([-away / distance[..., None], np.ones((*distance.shape, 1))], axis=2) * weight[..., None]
        residuals = weight * np.where(seen, ranges - distance - X[:, 3:], 0.0)
        N = np.where(enough[:, None, None], np.swapaxes(H, 1, 2) @ H, np.eye(4))
        X = X + np.linalg.solve(N, np.swapaxes(H, 1, 2) @ residuals[..., None])[..., 0]
    axes = positioning.local_axes(day.station)
    P = axes @ np.linalg.inv(N)[:, :3, :3] @ axes.T
    local = np.where(enough[:, None], (X[:, :3] - day.station) @ axes.T, np.nan)
    P = np.where(enough[:, None, None], P, np.nan)
    chi_square = np.where(enough, np.square(residuals).sum(axis=1), np.nan)
    return Fixes(local, P, chi_square, np.maximum(seen.sum(axis=1) - 4, 0))


def ranging_sigma(found):
    """Return the standard deviation (m) of a range that the residuals of `Fixes` show at the median epoch.

    The median does not mind some faulty ranges. Raises ValueError where no epoch has five satellites.
    """
    more = found.redundant > 0
    if not more.any():
        refuse("found", "an epoch of five satellites", "none")
    return float(np.sqrt(np.median(found.chi_square[more] / chi2.median(found.redundant[more]))))


class Tested(NamedTuple):
    """Ranges (N, 32) of which faulty ones, and all of an epoch that is left out, are NaN; and a line that counts both.

    sigma (m) is the `ranging_sigma` of the day.
    """

    ranges: np.ndarray
    sigma: float
    said: str


def tested(day, ranges):
    """Return the `Tested` ranges (N, 32) of a day.

    An epoch's residuals are tested against the day's own size; where they fail, `positioning.position` looks for the
    faulty ranges. An epoch is left out if they are not found, if it has fewer than five ranges, so that nothing tests
    them, or if its geometry is poor.
    """
    found = fixes(day, ranges)
    sigma = ranging_sigma(found)
    variance = (BAD_HOURS * sigma) ** 2
    pdop = np.sqrt(np.trace(found.P, axis1=1, axis2=2))
    keep = (found.redundant > 0) & (pdop < POOR)
    fails = keep & (chi2.sf(found.chi_square / variance, np.maximum(found.redundant, 1)) < FALSE_ALARM)
    kept = np.where(keep[:, None], ranges, np.nan)
    left_out = 0
    for k in np.flatnonzero(fails):
        s = np.flatnonzero(np.isfinite(ranges[k]))
        used = _agreeing(day, k, s, ranges[k, s], variance)
        kept[k, s[~used]] = np.nan
        left_out += int((~used).sum()) if used.any() else 0
    epochs, had = np.isfinite(kept).any(axis=1).sum(), np.isfinite(ranges).any(axis=1).sum()
    count = np.isfinite(ranges).sum()
    said = f"left out: {left_out} faulty of {count:,} ranges, {had - epochs} of {had:,} epochs"
    return Tested(kept, sigma, said)


def _agreeing(day, k, s, ranges, variance):
    """Return a mask (len(s),) of the satellites s of epoch k that agree about a position: none where nobody knows."""
    start = np.append(day.station, 0.0)
    try:
        fix = positioning.position(day.satellites[k, s], ranges, start, variance=variance, false_alarm=FALSE_ALARM)
    except ValueError:  # no iteration converges, or a range is absurd
        return np.zeros(len(s), dtype=bool)
    return fix.used & fix.trusted


def kinds_of(day):
    """Return the `KINDS` of ranges that a day has: the second where half of its ranges have a second frequency."""
    both = np.isfinite(day.dual).sum() > np.isfinite(day.ranges).sum() / 2
    return KINDS if both else KINDS[:1]


def phases_of(day):
    """Return how many phases a day has, 0, 1 or 2: one that is there for half of the ranges."""
    half = np.isfinite(day.ranges).sum() / 2
    return sum(bool(np.isfinite(phase).sum() > half) for phase in (day.phase1, day.phase1 + day.phase2))


def carrier(day, kind):
    """Return a carrier range minus the code range of one kind, (N, 32): their noise with a minus sign, and a constant.

    The constant is another one in each of the `arcs`. The code of one frequency sees the ionosphere delayed, its phase
    advanced: twice that is put right with the second phase, and stays where there is none. With two frequencies neither
    sees it.
    """
    if kind == KINDS[0]:
        if phases_of(day) < 2:
            return day.phase1
        return day.phase1 + 2 * (day.phase1 - day.phase2) / (LAMBDA - 1)
    return (LAMBDA * day.phase1 - day.phase2 + day.second) / (LAMBDA - 1)


def arcs(day):
    """Return the number of the arc (N, 32) that each phase belongs to, -1 where there is none.

    An arc ends where a satellite is lost, or where L1 - L2 or phase minus code jump: there a cycle was lost. With one
    phase, phase minus code is all there is: it jumps where it moves six times as far as usual.
    """
    if phases_of(day) == 2:
        there = np.isfinite(day.second + day.phase1 + day.phase2)
        tests = [(day.phase1 - day.phase2, SLIP), (day.phase1, JUMP)]
    else:
        there = np.isfinite(day.ranges + day.phase1)
        steps = np.abs(np.diff(day.phase1, axis=0))
        usual = np.median(steps[np.isfinite(steps)]) / 0.6745 if np.isfinite(steps).any() else np.inf
        tests = [(day.phase1, 6 * usual)]
    new = np.ones(there.shape, dtype=bool)
    with np.errstate(invalid="ignore"):
        goes_on = there[:-1].copy()
        for values, limit in tests:
            goes_on &= np.abs(np.diff(values, axis=0)) < limit
    new[1:] = ~goes_on
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


def to_smooth(day, kind, code):
    """Return what carrier smoothing takes of code ranges (N, 32) of a day: phase, anew, both (N, 32), and a number.

    The phase is a range with an unknown constant, NaN where there is none; anew tells where that constant is another
    one than an epoch before. The number is that of the epochs to average.
    """
    arc = np.where(np.isfinite(code), arcs(day), -1)
    phase = np.where(arc >= 0, code + carrier(day, kind), np.nan)
    anew = np.ones(arc.shape, dtype=bool)
    anew[1:] = arc[1:] != arc[:-1]
    return phase, anew, max(round((SMOOTHED if phases_of(day) == 2 else SMOOTHED_L1) / day.step), 1)


class Case(NamedTuple):
    """One kind of range of one station: errors (N, 3) east, north and up, in metres about the mean of the day.

    errors are those of the fixes, NaN at an epoch without one. Of these, noise is what code and carrier phase do not
    share, averaged to zero over each arc, and lasting is the rest; both are None without the phases of two frequencies.
    ranges (N, 32) are those that the fixes were made of. offset (3,) is the mean of the day from the header's position,
    step the seconds between epochs. said tells what was left out.
    """

    station: str
    kind: str
    step: float
    errors: np.ndarray
    noise: np.ndarray | None
    lasting: np.ndarray | None
    ranges: np.ndarray
    offset: np.ndarray
    said: str

    @property
    def seconds(self):
        """Return the time of each row in seconds, from the first on."""
        return self.step * np.arange(len(self.errors))


def case(station, day, kind):
    """Return the `Case` of one kind of range of a day."""
    measured = tested(day, ranges_of(day, kind))
    code = measured.ranges
    local = fixes(day, code).local
    offset = np.nanmean(local, axis=0)
    noise = lasting = None
    if phases_of(day) == 2:
        phase, arc = carrier(day, kind), np.where(np.isfinite(code), arcs(day), -1)
        levelled = np.where(arc >= 0, code + phase - arc_means(phase, arc), code)
        lasting = about_mean(fixes(day, levelled).local)
        noise = local - offset - lasting
    return Case(station, kind, day.step, local - offset, noise, lasting, code, offset, measured.said)


def about_mean(values):
    """Return values (N, 3) less their mean over the rows that are there."""
    return values - np.nanmean(values, axis=0)


def cases(days):
    """Return the `Case` of each kind of range of each day {name: Day}, by "name, kind"."""
    return {f"{name}, {kind}": case(name, day, kind) for name, day in days.items() for kind in kinds_of(day)}


def size(errors):
    """Return the root mean square of three-dimensional errors (N, 3), in metres, over the rows that are there.

    >>> float(size(np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 5.0], [np.nan, 1.0, 1.0]])))
    5.0
    """
    return np.sqrt(np.nanmean(np.sum(np.square(errors), axis=1)))


def autocorrelation(x):
    """Return the autocorrelation (N,) of a series (N,) about its mean; a missing value counts as the mean.

    The sum of each lag is divided by that of lag 0, not by its own number of terms, which keeps the matrix R of the
    entries ρ_|j-k| positive semidefinite.

    >>> autocorrelation(np.array([1.0, -1.0, 1.0, -1.0]))
    array([ 1.  , -0.75,  0.5 , -0.25])
    """
    x = np.nan_to_num(x - np.nanmean(x))
    sums = correlate(x, x, "full")[len(x) - 1 :]
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
    lines = line_errors(errors, n)
    whole = np.isfinite(lines).all(axis=0)
    fixes = errors[(n - 1) // 2 : len(errors) - n // 2], errors[n - 1 :]
    return rms(lines[:, whole], axis=1) / [rms(each[whole]) for each in fixes]


def means(errors, n):
    """Return the means (N - n + 1, 3) of n successive errors (N, 3)."""
    return np.lib.stride_tricks.sliding_window_view(errors, n, axis=0).mean(axis=-1)


def ratio_of(errors, others):
    """Return the size of errors (N, 3) over that of others, at the rows that both have."""
    both = np.isfinite(errors).all(axis=1) & np.isfinite(others).all(axis=1)
    return size(errors[both]) / size(others[both])


def windows(errors, n=WINDOW):
    """Return successive stretches of n errors (N,) as tracks, (n, 1, N // n).

    >>> windows(np.arange(5.0), 2).shape
    (2, 1, 2)
    """
    tracks = len(errors) // n
    return errors[: tracks * n].reshape(tracks, n).T[:, None]


def white(step, r):
    """Return the filter that takes errors for independent: constant velocity, no process noise, variance r (m²)."""
    return KalmanFilter(constant_velocity(dt=step, q=0.0, r=r, P0=UNKNOWN))


def with_lasting(step, r, sigma, tau):
    """Return the filter whose model has an error state besides: of sigma metres, that fades within tau seconds."""
    axis = constant_velocity(dt=step, q=0.0, r=r, P0=UNKNOWN)
    return KalmanFilter(lasting_error(axis, sigma=sigma, tau=tau))


def ins_model(step, r, q=0.0):
    """Return the paper's model of GPS and INS for fixes `step` seconds apart: r (m²) is their variance."""
    return gps_ins(step, q, (r, INS_SIGMA**2), P0=np.diag([*np.diag(UNKNOWN), 1.0]))


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
    seed enters. Windows with a missing fix are left out.
    """
    gps = windows(errors)[:, 0]
    gps = gps[:, np.isfinite(gps).all(axis=0)]
    n, M = gps.shape
    step = model.F[0, 1]
    truth = np.tile(np.column_stack([SPEED * step * np.arange(n), np.full(n, SPEED), np.full(n, BIAS)])[..., None], M)
    z = np.stack([truth[:, 0] + gps, truth[:, 1] + truth[:, 2]], axis=1)
    kf = KalmanFilter(model)
    mean, covariance = exact_moments(lambda z: kf.filter(z)[:, :3], z, truth, [0.0, INS_SIGMA])
    square = np.square(mean) + np.diagonal(covariance, axis1=1, axis2=2)[..., None]
    variance = kf.covariances(n)[:, 0, 0]
    nees = (square[SETTLED:, 0] / variance[SETTLED:, None]).mean()
    position, velocity, bias = np.sqrt(square[n // 2 :].mean(axis=(0, 2)))
    return WithIns(position, velocity, bias, rms(gps[n // 2 :]), np.sqrt(variance[-1]), nees)
