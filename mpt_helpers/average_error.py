"""The average errors of 2016 Table 1: computed, expected, and searched under every reading that the paper leaves open.

A mobile moves on one axis from x(0) = `truth.x0`, and its position is measured with noise. The steady-state filter
starts from the x0 of its own model. The error of the N-step prediction made at k is |s(k+N) - s(k+N/k)|; with N = 0 it
is that of the estimate.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np

from . import checks
from .filters import SteadyStateFilter
from .metrics import error_moments, expected_absolute, require_same
from .model import mean_track, simulate
from .study import study

UNITS = {"fraction": 1, "percent": 100}
AVERAGES = ("mean of ratios", "ratio of sums")
AXES = {"x": slice(0, 1), "y": slice(1, 2), "both": slice(0, 2), "plane": slice(2, 3)}  # of what error_sums returns
FIRST_ESTIMATES, FIRST_PREDICTIONS = (1, 2), (0, 1, 2)


def mean_relative_errors(steady, truth, L, steps, rng, M):
    """Return the mean over k = 1 ... L of |s(k+N) - s(k+N/k)| / |s(k+N)| for N = 0 ... steps, (steps + 1, M).

    One column for each of M runs: an experiment for `study`, once all but the last two arguments are given.

    Raises ValueError or TypeError for a truth that has another F or H than the filter's model, more than one
    measurement or a position of zero, and for counts that are none.
    """
    result = np.empty((checks.count("steps", steps, least=0) + 1, checks.count("M", M)))
    for N, (e, s) in enumerate(_errors(steady, truth, L, steps, rng, M)):
        result[N] = np.einsum("km,km->m", e[1:], np.broadcast_to(1 / s[1:], e[1:].shape)) / L
    return result


def expected_relative_errors(steady, truth, L, steps):
    """Return the expected |s(k+N) - s(k+N/k)| / |s(k+N)| for N = 0 ... steps and k = 1 ... L, (steps + 1, L).

    truth is an `exact_motion`. The error at each k is Gaussian, with the moments of `metrics.error_moments`, so that
    this is a closed form; its mean over k is the expectation of `mean_relative_errors`. Raises as that does, and for
    a motion with noise or a random start.

    >>> from mpt_helpers.model import constant_velocity, exact_motion
    >>> steady = SteadyStateFilter.from_kalman(constant_velocity(dt=1.0, q=0.01, r=0.1))
    >>> truth = exact_motion(steady.model, x0=[0, 20])
    >>> (100 * expected_relative_errors(steady, truth, L=10_000, steps=1).mean(axis=1)).round(4)  # percent
    array([0.0112, 0.0142])
    """
    require_same(steady, truth)
    if truth.Q.any() or truth.P0.any():
        checks.refuse("truth", "an exact_motion", "a model with process noise or a random start")
    s = _track(steady, truth, L, steps)
    mean, P = error_moments(steady, truth, L)
    result = np.empty((steps + 1, L))
    for N in range(steps + 1):
        row = truth.H[0] @ np.linalg.matrix_power(truth.F, N)
        expected = expected_absolute(mean @ row, np.einsum("i,kij,j->k", row, P, row))
        result[N] = expected / np.abs(s[N + 1 : N + 1 + L])
    return result


@dataclass(frozen=True)
class Protocol:
    """One reading of "percent absolute average error".

    track names the kind of true track; unit is "fraction" or "percent"; average is "mean of ratios" (the mean of error
    / position) or "ratio of sums" (the mean error over the mean position); axes is "x", "y", "both" (averaged) or
    "plane" (distances in the plane); first_estimate and first_prediction are the first k that counts, 0 being the
    prediction s(N/0) that no measurement has touched; length is the last k. Raises ValueError or TypeError for others.
    """

    track: str
    unit: str
    average: str
    axes: str
    first_estimate: int
    first_prediction: int
    length: int

    def __post_init__(self):
        checks.instance("track", self.track, str)
        for name, choices in {"unit": UNITS, "average": AVERAGES, "axes": AXES}.items():
            checks.one_of(name, getattr(self, name), choices)
        for name in ("first_estimate", "first_prediction", "length"):
            checks.count(name, getattr(self, name), least=0)


class Fit(NamedTuple):
    """How well a protocol explains the printed numbers.

    distance is the squared Mahalanobis distance of all of them from the runs, p the share of runs that are as far or
    farther, inside how many of them lie in the central 99 % of the runs.
    """

    protocol: Protocol
    distance: float
    p: float
    inside: int


@dataclass(frozen=True, eq=False)
class Case:
    """A column of the table: a filter, the true motions on the x and the y axis, the printed numbers of N = 0, 1 ...

    Raises TypeError or ValueError for anything else.
    """

    steady: SteadyStateFilter
    truths: tuple
    printed: tuple

    def __post_init__(self):
        if len(truths := checks.several("truths", self.truths, "the motions on two axes")) != 2:
            checks.refuse("truths", "the motions on two axes", len(truths))
        for truth in truths:
            require_same(self.steady, truth, "truths")
        object.__setattr__(self, "truths", truths)
        checks.array("printed", self.printed, (len(checks.several("printed", self.printed, "printed numbers")),))

    @property
    def steps(self):
        """The largest N."""
        return len(self.printed) - 1


def search(tracks, lengths, runs, seed, digits=4, workers=1):
    """Return the Fit of every protocol of the family to the printed numbers, the nearest first.

    tracks maps a name for the kind of true track to the cases, the columns of the table; lengths are the values of L to
    try, digits the decimals printed, to which the runs are rounded too; workers are those of `study`. Raises
    ValueError or TypeError for anything else.
    """
    checks.several("tracks", checks.instance("tracks", tracks, Mapping), "at least one kind of track")
    tracks = {track: checks.several("tracks", cases, "Cases") for track, cases in tracks.items()}
    for case in (case for cases in tracks.values() for case in cases):
        checks.instance("tracks", case, Case)
    lengths = checks.several("lengths", lengths, "at least one length")
    lengths = [checks.count("lengths", length, least=max(FIRST_PREDICTIONS)) for length in lengths]
    checks.count("runs", runs, least=2)
    checks.count("seed", seed, least=0)
    checks.count("digits", digits, least=0)
    ends = sorted({*FIRST_ESTIMATES, *FIRST_PREDICTIONS, *lengths})
    fits = []
    for track, cases in tracks.items():
        sums = [study(partial(error_sums, case, ends), runs, seed + i, workers=workers) for i, case in enumerate(cases)]
        for average, axes, *firsts in product(AVERAGES, AXES, FIRST_ESTIMATES, FIRST_PREDICTIONS):
            samples = [_averages(each, ends, lengths, average, axes, *firsts) for each in sums]
            for unit, scale in UNITS.items():
                scores = [_score(scale * s, case.printed, digits) for s, case in zip(samples, cases, strict=True)]
                distance, distances, inside = (sum(each) for each in zip(*scores, strict=True))
                p = np.mean(distances >= distance[:, None], axis=1)
                for length, *fit in zip(lengths, distance.tolist(), p.tolist(), inside.tolist(), strict=True):
                    fits.append(Fit(Protocol(track, unit, average, axes, *firsts, length), *fit))
    return sorted(fits, key=lambda fit: fit.distance)


def error_sums(case, ends, rng, M):
    """Return the sums over k = 0 ... end of error / position, errors and positions, (3, 3, steps + 1, ends, M).

    The axes are: ratio, error, position; x, y, plane; N; end; run. Raises ValueError or TypeError for anything but a
    Case, ends that rise, a Generator and a positive count.
    """
    checks.instance("case", case, Case)
    ends, M = _ends(ends), checks.count("M", M)
    if ends[-1] < 1:
        checks.refuse("ends", "a last end of at least 1", ends[-1])
    starts, sums = [0, *(end + 1 for end in ends[:-1])], np.empty((3, 3, case.steps + 1, len(ends), M))
    pairs = zip(*(_errors(case.steady, truth, ends[-1], case.steps, rng, M) for truth in case.truths), strict=True)
    for N, ((e_x, s_x), (e_y, s_y)) in enumerate(pairs):
        for i, (e, s) in enumerate(((e_x, s_x), (e_y, s_y), (_length(e_x, e_y), _length(s_x, s_y)))):
            inverse = np.divide(1, s, out=np.zeros_like(s), where=s > 0)  # s(0) = 0, where no estimate is counted
            for kind, each in enumerate((e * inverse, e, s)):
                sums[kind, i, N] = np.add.reduceat(each, starts, axis=0).cumsum(axis=0)
    return sums


def _length(x, y):
    return np.sqrt(x * x + y * y)  # a fifth of the time of hypot, whose care for very large numbers is not needed


def averages(sums, ends, lengths, average, axes, first_estimate, first_prediction):
    """Return the fractions that protocols give for each length, N and run, (lengths, steps + 1, M).

    sums and ends are those of `error_sums`. Raises ValueError or TypeError for others, for lengths that are not
    among the ends, and for a first k that comes after them or whose sum before it is not there.
    """
    ends = _ends(ends)
    sums = checks.finite("sums", sums, (3, 3, "N", len(ends), "M"))
    lengths = checks.several("lengths", lengths, "at least one length")
    checks.one_of("average", average, AVERAGES)
    for name, first in {"first_estimate": first_estimate, "first_prediction": first_prediction}.items():
        if checks.count(name, first, least=0) and first - 1 not in ends:
            checks.refuse(name, f"0 or one more than one of the ends {ends}", first)
    for length in lengths:
        least = max(1, first_estimate, first_prediction)
        if checks.count("lengths", length, least=least) not in ends:
            checks.refuse("lengths", f"some of the ends {ends}", length)
    checks.one_of("axes", axes, AXES)
    return _averages(sums, ends, lengths, average, axes, first_estimate, first_prediction)


def _averages(sums, ends, lengths, average, axes, first_estimate, first_prediction):
    chosen = AXES[axes]
    last, result = [ends.index(length) for length in lengths], []
    for N in range(sums.shape[2]):
        first = first_prediction if N else first_estimate
        before = sums[:, chosen, N, ends.index(first - 1), None] if first else 0
        ratios, errors, positions = (sums[:, chosen, N, last] - before).sum(axis=1)
        points = (chosen.stop - chosen.start) * (np.array(lengths) - first + 1)
        result.append(errors / positions if average == "ratio of sums" else ratios / points[:, None])
    return np.stack(result, axis=1)


def score(samples, printed, digits):
    """Return how far printed numbers are from runs.

    samples is (..., numbers, runs). Returns the squared Mahalanobis distance of the print from the runs (...), those of
    the runs themselves, rounded to as many digits as the print, (..., runs), and how many of the printed numbers lie in
    the central 99 % of the runs (...). Raises ValueError or TypeError for other arrays and digits, and fewer than
    two runs.
    """
    samples = checks.real("samples", samples, "a (..., numbers, runs) array")
    if samples.ndim < 2 or samples.shape[-1] < 2 or not samples.size or np.isnan(samples).any():
        checks.refuse("samples", "a (..., numbers, runs) array of at least 2 runs", f"NaN or shape {samples.shape}")
    printed, digits = checks.array("printed", printed, samples.shape[-2:-1]), checks.count("digits", digits, least=0)
    return _score(samples, printed, digits)


def _score(samples, printed, digits):
    unit, mean = 10.0**-digits, samples.mean(axis=-1, keepdims=True)
    centred = samples - mean
    covariance = centred @ centred.swapaxes(-1, -2) / (samples.shape[-1] - 1)
    inverse = np.linalg.inv(covariance + unit**2 / 12 * np.eye(samples.shape[-2]))  # with the variance of rounding
    off, rounded = np.array(printed)[:, None] - mean, np.round(samples, digits) - mean
    low, high = np.quantile(samples, [0.005, 0.995], axis=-1)
    inside = (low - unit / 2 <= printed) & (printed <= high + unit / 2)
    distance, distances = ((each * (inverse @ each)).sum(axis=-2) for each in (off, rounded))
    return distance[..., 0], distances, inside.sum(axis=-1)


def _ends(ends):
    ends = [checks.count("ends", end, least=0) for end in checks.several("ends", ends, "at least one end")]
    if ends != sorted({*ends}):
        checks.refuse("ends", "numbers that rise", ends)
    return ends


def _track(steady, truth, L, steps):
    """Return s(0) ... s(L + steps) of a track without process noise."""
    require_same(steady, truth)
    if truth.m != 1:
        checks.refuse("truth", "one measurement", f"{truth.m}")
    N = checks.count("L", L) + checks.count("steps", steps, least=0)
    s = np.concatenate([truth.x0[None], mean_track(truth, N)]) @ truth.H[0]
    if not s[1:].all():
        checks.refuse("truth", "a track whose position is not zero", f"zero at k = {1 + np.flatnonzero(s[1:] == 0)[0]}")
    return s


def _errors(steady, truth, L, steps, rng, M):
    """Give |s(k+N) - s(k+N/k)|, (L + 1, M), and |s(k+N)|, (L + 1, M or 1), for k = 0 ... L and each N."""
    s = _track(steady, truth, L, steps)[:, None]
    checks.instance("rng", rng, np.random.Generator)
    if truth.Q.any():
        drawn, _ = simulate(truth, L + steps, rng, tracks=M)
        s = np.concatenate([np.broadcast_to(s[:1], (1, M)), np.einsum("i,kim->km", truth.H[0], drawn)])
    z = np.sqrt(truth.R[0]) * rng.standard_normal((L, 1, M))
    z += s[1 : L + 1, None]
    x = steady.filter(z)
    for N in range(steps + 1):
        row = steady.model.H[0] @ np.linalg.matrix_power(steady.model.F, N)
        e = np.empty((L + 1, M))
        e[0] = row @ steady.model.x0
        np.einsum("i,kim->km", row, x, out=e[1:])
        e -= s[N : N + L + 1]
        yield np.abs(e, out=e), np.abs(s[N : N + L + 1])
