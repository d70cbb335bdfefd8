"""Table 1 of 2016: what "percent absolute average error" may mean, and how probable each meaning makes the print.

A mobile moves on two axes, and a steady-state filter follows it on each. The error of the prediction that is made at
step k, N steps ahead, is e = s(k+N) - s(k+N/k): real minus predicted position; N = 0 is the estimate. The averages here
are means of |e| / |s(k+N)| over k = 1 ... L, for N = 0 ... 5. A reading of the table says on which axis, over how many
steps L, in which unit, and with how much process noise in the track.
"""

from dataclasses import dataclass, replace
from itertools import repeat
from math import factorial

import numpy as np

from ..metrics import expected_absolute
from ..model import simulate

AHEAD = 5  # the largest N
# Steps after which the filter has forgotten its start: from there on the mean of |e| is constant, and not simulated.
TRANSIENT = 110
AXES = ("x", "y", "both", "plane")


@dataclass(frozen=True)
class Column:
    """One column of the table: the filter, the start x(0) on each axis, the printed numbers of N = 0 ... 5 (6,)."""

    steady: object
    starts: tuple
    printed: np.ndarray

    def truth(self, axis, noise=0.0):
        """Return the model of the track on axis 0 or 1. Its process noise is `noise` times that of the filter's Q."""
        model = self.steady.model
        return replace(model, x0=self.starts[axis], P0=np.zeros_like(model.Q), Q=noise * model.Q)

    def positions(self, axis, steps):
        """Return s(k+N) for N = 0 ... 5 and k = 1 ... steps, (6, steps), of the track without process noise."""
        t = self.steady.model.F[0, 1] * np.arange(1, steps + AHEAD + 1)  # F[0, 1] is the time step
        s = sum(component * t**i / factorial(i) for i, component in enumerate(self.starts[axis]))
        return np.array([s[N : N + steps] for N in range(AHEAD + 1)])


def ahead(model):
    """Return the first rows of F^N for N = 0 ... 5, (6, n): they take a state to the position N steps later."""
    return np.array([np.linalg.matrix_power(model.F, N)[0] for N in range(AHEAD + 1)])


def error_moments(column, axis, L, gains=None):
    """Return the mean and the variance of e for N = 0 ... 5 and k = 1 ... L, each (6, L), without process noise.

    gains is a list of (A, B) for the first 220 steps; without it they are those of the steady state. The error obeys
    e(k+1) = A e(k) - B v(k+1). After 220 steps its mean is zero and its variance constant.
    """
    model = column.steady.model
    rows = ahead(model)
    e = np.asarray(column.starts[axis], float)
    P = np.zeros_like(model.Q)
    mean = np.zeros((AHEAD + 1, L))
    variance = np.empty((AHEAD + 1, L))
    constant = repeat((column.steady.A, column.steady.B))
    for k, (A, B) in zip(range(min(L, 2 * TRANSIENT)), gains or constant, strict=False):
        e = A @ e
        P = A @ P @ A.T + B @ model.R @ B.T
        mean[:, k] = rows @ e
        variance[:, k] = np.einsum("Ni,ij,Nj->N", rows, P, rows)
    variance[:, k + 1 :] = variance[:, k : k + 1]
    return mean, variance


def expected_averages(column, axis, L, gains=None):
    """Return the expected averages over the first 1 ... L steps, (6, L), exactly: the track has no process noise.

    >>> from mpt_helpers import SteadyStateFilter, constant_velocity
    >>> steady = SteadyStateFilter.from_kalman(constant_velocity(dt=1.0, q=0.01, r=0.1))
    >>> column = Column(steady, starts=((0, 20), (0, 30)), printed=())
    >>> (100 * expected_averages(column, axis=0, L=10_000)[:2, -1]).round(4)
    array([0.0112, 0.0142])
    """
    ratio = expected_absolute(*error_moments(column, axis, L, gains)) / column.positions(axis, L)
    return ratio.cumsum(axis=1) / np.arange(1, L + 1)


def errors(column, axis, noise, rng, runs, v=None):
    """Return e and s(k+N) of simulated runs on one axis, each (6, 110, runs).

    v is the measurement noise, (115, 1, runs), drawn like the rest if it is not given.
    """
    x, z = simulate(column.truth(axis, noise), TRANSIENT + AHEAD, rng, tracks=runs)
    if v is not None:
        z = x[:, :1] + v
    predicted = np.einsum("Ni,kim->Nkm", ahead(column.steady.model), column.steady.filter(z[:TRANSIENT]))
    position = np.array([x[N : N + TRANSIENT, 0] for N in range(AHEAD + 1)])
    return position - predicted, position


def relative_errors(column, noise, rng, runs, v=(None, None)):
    """Return |e| / |s| of simulated runs: {axis: (6, 110, runs)}.

    The axes are x, y, the mean of both, and distances in the plane. noise is the process noise of the tracks as a
    multiple of the filter's, v the measurement noise on the axes x and y if it is given, each (115, 1, runs).
    """
    (e_x, s_x), (e_y, s_y) = (errors(column, axis, noise, rng, runs, v[axis]) for axis in (0, 1))
    x = np.abs(e_x / s_x)
    y = np.abs(e_y / s_y)
    plane = np.sqrt((e_x**2 + e_y**2) / (s_x**2 + s_y**2))
    return dict(zip(AXES, (x, y, (x + y) / 2, plane), strict=True))


def averages(column, ratio, lengths):
    """Return the averages of runs over their first L steps, (lengths, 6, runs), from ratio, |e| / |s|, (6, 110, runs).

    Beyond step 110, |e| / |s| is replaced by its expectation: the mean of |e| is that of the last thirty steps
    simulated, and s grows as on the track without process noise.
    """
    lengths = np.asarray(lengths)
    s = column.positions(0, max(TRANSIENT, *lengths))
    last = slice(TRANSIENT - 30, TRANSIENT)
    at_rest = (ratio[:, last].mean(axis=2) * s[:, last]).mean(axis=1, keepdims=True)
    later = np.concatenate([np.zeros((AHEAD + 1, 1)), (at_rest / s[:, TRANSIENT:]).cumsum(axis=1)], axis=1)
    sums = ratio.cumsum(axis=1)
    total = sums[:, np.minimum(lengths, TRANSIENT) - 1] + later[:, np.maximum(lengths - TRANSIENT, 0), None]
    return total.swapaxes(0, 1) / lengths[:, None, None]


def implied_lengths(samples, lengths, tables):
    """Return the length at which the mean of the runs is each number of some tables, (6, tables).

    samples is (lengths, 6, runs) for increasing lengths, tables (6, tables) in the same unit.
    """
    mean = samples.mean(axis=2)
    return np.array([np.interp(-tables[N], -mean[:, N], lengths) for N in range(AHEAD + 1)])


def printed_lengths(column, ratio, scale, lengths):
    """Return the lengths that the six printed numbers imply, (6,). scale is 100 for percent, 1 for fractions.

    ratio is |e| / |s| of simulated runs, (6, 110, runs); lengths are those tried, increasing.
    """
    samples = scale * averages(column, ratio, lengths)
    return implied_lengths(samples, lengths, column.printed[:, None])[:, 0]


def log_likelihood(samples, tables, digits=4):
    """Return the log of the probability of printing each table, (lengths, tables).

    samples are the averages of runs, (lengths, numbers, runs), six numbers for a column or twelve for both; tables are
    (numbers, tables), printed with so many decimals. The averages of a run are taken as Gaussian with the mean and
    covariance of the samples. Rounding adds the variance of a uniform error. The density, times the width of the last
    digit for each number, is a probability.
    """
    unit = 10.0**-digits
    numbers = samples.shape[1]
    mean = samples.mean(axis=2, keepdims=True)
    centred = samples - mean
    C = centred @ centred.swapaxes(1, 2) / (samples.shape[2] - 1) + unit**2 / 12 * np.eye(numbers)
    off = tables - mean
    distance = (off * np.linalg.solve(C, off)).sum(axis=1)
    return numbers * np.log(unit) - (distance + np.linalg.slogdet(2 * np.pi * C)[1][:, None]) / 2


def draw_lengths(ax, column, ratio, scale, lengths, L):
    """Draw the lengths that the printed numbers imply (dots), over N, and those of thirty simulated runs of L steps."""
    samples = scale * averages(column, ratio, lengths)
    tables = scale * averages(column, ratio, [L])[0, :, :30]
    implied = implied_lengths(samples, lengths, tables)
    ax.plot(implied[:, 1:], color="0.8", lw=0.7)
    ax.plot(implied[:, 0], color="0.8", lw=0.7, label="simulated runs")
    ax.axhline(L, color="0.3", lw=0.8, label="one length")
    ax.plot(printed_lengths(column, ratio, scale, lengths), "o", color="C1", ms=5, label="printed")


def draw_errors(ax, column, e, N, some):
    """Draw e of one run on both axes, (steps, 2), for some of the steps, with bands: the mean of e ± 2σ."""
    k = np.arange(1, len(e) + 1)[some]
    for axis, (name, style) in enumerate((("x axis", "-"), ("y axis", "--"))):
        mean, variance = (moment[N, some] for moment in error_moments(column, axis, len(e)))
        sigma = np.sqrt(variance)
        ax.fill_between(k, mean - 2 * sigma, mean + 2 * sigma, color=f"C{axis}", alpha=0.2, lw=0)
        ax.plot(k, e[some, axis], style, color=f"C{axis}", label=name)
