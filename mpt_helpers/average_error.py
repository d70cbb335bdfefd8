"""The average errors of 2016 Table 1: computed, expected, and searched under every reading that the paper leaves open.

A mobile moves on one axis exactly as its model does without noise, from x(0) = `truth.x0`; its position is measured
with noise. The steady-state filter starts from the x0 of its own model. The error of the N-step prediction made at k is
|s(k+N) - s(k+N/k)|; with N = 0 it is that of the estimate.
"""

from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np

from . import checks
from .filters import SteadyStateFilter
from .metrics import error_moments, expected_absolute
from .model import mean_track
from .study import study

UNITS = {"fraction": 1, "percent": 100}
AVERAGES = ("mean of ratios", "ratio of sums")
AXES = ("x", "y", "both", "plane")
FIRST_ESTIMATES, FIRST_PREDICTIONS = (1, 2), (0, 1, 2)


def mean_relative_errors(steady, truth, L, steps, rng, M):
    """Return the mean over k = 1 ... L of |s(k+N) - s(k+N/k)| / |s(k+N)| for N = 0 ... steps, (steps + 1, M).

    One column for each of M runs: an experiment for `study`, once all but the last two arguments are given.
    """
    s, x = _run(steady, truth, L, steps, rng, M)
    return np.array(
        [np.einsum("k,km->m", 1 / s[N + 1 : N + 1 + L], e[1:]) / L for N, e in _errors(steady, s, x, steps)]
    )


def expected_relative_errors(steady, truth, L, steps):
    """Return the expectation of `mean_relative_errors`, (steps + 1,), in closed form.

    The error at each k is Gaussian, with the moments of `metrics.error_moments`.
    """
    s = _positions(truth, L + steps)
    mean, P = error_moments(steady, truth, L)
    rows = [truth.H[0] @ np.linalg.matrix_power(truth.F, N) for N in range(steps + 1)]
    moments = [(mean @ h, np.einsum("i,kij,j->k", h, P, h)) for h in rows]
    return np.array([(expected_absolute(*each) / s[N + 1 : N + 1 + L]).mean() for N, each in enumerate(moments)])


@dataclass(frozen=True)
class Protocol:
    """One reading of "percent absolute average error".

    unit is "fraction" or "percent"; average is "mean of ratios" (the mean of error / position) or "ratio of sums" (the
    mean error over the mean position); axes is "x", "y", "both" (averaged) or "plane" (distances in the plane);
    first_estimate and first_prediction are the first k that counts, 0 being the prediction s(N/0) that no measurement
    has touched; length is the last k.
    """

    unit: str
    average: str
    axes: str
    first_estimate: int
    first_prediction: int
    length: int


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
    """A column of the table: a filter, the true motions on the x and the y axis, the printed numbers of N = 0, 1 ..."""

    steady: SteadyStateFilter
    truths: tuple
    printed: tuple

    @property
    def steps(self):
        """The largest N."""
        return len(self.printed) - 1


def search(cases, lengths, runs, seed, digits=4, workers=1):
    """Return the Fit of every protocol of the family to the printed numbers of all cases, the nearest first.

    lengths are the values of L to try, digits the decimals printed. Both the runs and the print are rounded to them.
    """
    lengths = [checks.count("lengths", length, least=max(FIRST_PREDICTIONS)) for length in lengths]
    ends = sorted({*FIRST_ESTIMATES, *FIRST_PREDICTIONS, *lengths})
    sums = [study(partial(error_sums, case, ends), runs, seed + i, workers=workers) for i, case in enumerate(cases)]
    positions = [_case_positions(case, ends[-1]) for case in cases]
    fits = []
    for average, axes, *firsts, length in product(AVERAGES, AXES, FIRST_ESTIMATES, FIRST_PREDICTIONS, lengths):
        samples = [averages(*each, ends, average, axes, *firsts, length) for each in zip(positions, sums, strict=True)]
        for unit, scale in UNITS.items():
            scores = [_score(scale * s, case.printed, digits) for s, case in zip(samples, cases, strict=True)]
            distance, distances, inside = map(sum, zip(*scores, strict=True))
            p = float(np.mean(distances >= distance))
            fits.append(Fit(Protocol(unit, average, axes, *firsts, length), float(distance), p, int(inside)))
    return sorted(fits, key=lambda fit: fit.distance)


def error_sums(case, ends, rng, M):
    """Return the sums over k = 0 ... end of relative and absolute errors, (2, 3, steps + 1, ends, M).

    The axes are: mean of ratios, ratio of sums; x, y, plane; N; end; run.
    """
    L, starts = ends[-1], [0, *(end + 1 for end in ends[:-1])]
    runs = [_run(case.steady, truth, L, case.steps, rng, M) for truth in case.truths]
    pairs = zip(*(_errors(case.steady, s, x, case.steps) for s, x in runs), strict=True)
    sums = np.empty((2, 3, case.steps + 1, len(ends), M))
    for (N, e_x), (_, e_y) in pairs:
        s_x, s_y = (s[N : N + L + 1, None] for s, _ in runs)
        for i, (e, s) in enumerate(((e_x, s_x), (e_y, s_y), (np.hypot(e_x, e_y), np.hypot(s_x, s_y)))):
            ratio = np.divide(e, s, out=np.zeros_like(e), where=s > 0)  # s(0) = 0, where no estimate is counted
            sums[:, i, N] = [np.add.reduceat(each, starts, axis=0).cumsum(axis=0) for each in (ratio, e)]
    return sums


def averages(positions, sums, ends, average, axes, first_estimate, first_prediction, length):
    """Return the fractions that a protocol gives for each N and run, (steps + 1, M), from the `error_sums` of a case."""
    kind = AVERAGES.index(average)
    chosen = slice(0, 2) if axes == "both" else slice(*{"x": (0, 1), "y": (1, 2), "plane": (2, 3)}[axes])
    result = []
    for N in range(sums.shape[2]):
        first = first_prediction if N else first_estimate
        total = sums[kind, chosen, N, ends.index(length)].sum(axis=0)
        if first:
            total -= sums[kind, chosen, N, ends.index(first - 1)].sum(axis=0)
        weights = positions[chosen, N + first : N + length + 1]
        result.append(total / (weights.sum() if kind else weights.size))
    return np.array(result)


def _case_positions(case, L):
    """Return s(0) ... s(L + steps) on the x axis, the y axis and in the plane, (3, L + steps + 1)."""
    x, y = (_positions(truth, L + case.steps) for truth in case.truths)
    return np.array([x, y, np.hypot(x, y)])


def _score(samples, printed, digits):
    """Return the squared distance of the print from the samples, those of the samples, and how many are in the band."""
    unit, mean = 10.0**-digits, samples.mean(axis=1)
    inverse = np.linalg.inv(np.cov(samples) + unit**2 / 12 * np.eye(len(samples)))  # that of rounding to the unit
    off, rounded = np.array(printed) - mean, np.round(samples, digits) - mean[:, None]
    low, high = np.quantile(samples, [0.005, 0.995], axis=1)
    inside = (low - unit / 2 <= printed) & (printed <= high + unit / 2)
    return off @ inverse @ off, np.einsum("im,ij,jm->m", rounded, inverse, rounded), inside.sum()


def _positions(truth, N):
    """Return s(0) ... s(N)."""
    return np.concatenate([truth.x0[None], mean_track(truth, N)]) @ truth.H[0]


def _run(steady, truth, L, steps, rng, M):
    """Return s(0) ... s(L + steps) and the estimates x(0/0) ... x(L/L) of M runs."""
    s = _positions(truth, L + steps)
    z = s[1 : L + 1, None, None] + np.sqrt(truth.R[0]) * rng.standard_normal((L, 1, M))
    start = np.broadcast_to(steady.model.x0[:, None], (1, steady.model.n, M))
    return s, np.concatenate([start, steady.filter(z)])


def _errors(steady, s, x, steps):
    """Give N and |s(k+N) - s(k+N/k)| for k = 0 ... L, (L + 1, M), for each N."""
    for N in range(steps + 1):
        row = steady.model.H[0] @ np.linalg.matrix_power(steady.model.F, N)
        e = np.einsum("i,kim->km", row, x)
        e -= s[N : N + len(x), None]
        yield N, np.abs(e, out=e)
