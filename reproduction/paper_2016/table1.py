"""Table 1 of 2016: what "percent absolute average error" may mean, and how probable each meaning makes the print.

A mobile moves on two axes, and a steady-state filter follows it on each. The error of the prediction that is made at
step k, N steps ahead, is e = s(k+N) - s(k+N/k): real minus predicted position; N = 0 is the estimate. The averages here
are means of |e| / |s(k+N)| over k = 1 ... L, for N = 0 ... 5. A reading of the table says on which axis, over how many
steps L, in which unit, and with how much process noise in the track.
"""

from dataclasses import dataclass, replace
from math import factorial

import numpy as np
from scipy.special import erf

from mpt_helpers.metrics import error_moments
from mpt_helpers.model import constant_acceleration, constant_velocity, simulate
from mpt_helpers.steady import SteadyStateFilter

LARGEST_N = 5  # steps ahead in the table
# After TRANSIENT steps the mean of |e| is taken as constant; after 2·TRANSIENT the mean of e as zero.
TRANSIENT = 110
AXES = ("x", "y", "both", "plane")
LAST_DIGIT = 1e-4  # of a printed number
DT, Q, R = 1.0, 0.01, 0.1  # the examples of Sections 5.1 and 5.2: time step, strength of the process noise, variance
MODELS = {"cv": constant_velocity, "ca": constant_acceleration}
NAMES = {"cv": "constant velocity", "ca": "constant acceleration"}
STARTS = {"cv": ((0, 20), (0, 30)), "ca": ((0, 0, 2), (0, 0, 3))}  # x(0) on the axes x and y
PRINTED = {
    "cv": (0.0111, 0.0142, 0.0156, 0.0165, 0.0172, 0.0177),
    "ca": (0.0077, 0.0146, 0.0173, 0.0189, 0.0200, 0.0209),
}


@dataclass(frozen=True)
class Column:
    """One column of the table: the filter, the start x(0) on each axis, the printed numbers of N = 0 ... 5 (6,).

    Raises ValueError unless both starts are multiples of one: `averages` takes positions to grow alike on both axes.
    """

    steady: SteadyStateFilter
    starts: tuple
    printed: np.ndarray

    def __post_init__(self):
        if np.linalg.matrix_rank(self.starts) != 1:
            raise ValueError(f"starts: needs x(0) on both axes in proportion, got {self.starts}")

    def truth(self, axis, noise=0.0):
        """Return the model of the track on axis 0 or 1. Its process noise is `noise` times that of the filter's Q."""
        model = self.steady.model
        return replace(model, x0=self.starts[axis], P0=np.zeros_like(model.Q), Q=noise * model.Q)

    def positions(self, axis, steps):
        """Return s(k+N) for N = 0 ... 5 and k = 1 ... steps, (6, steps), of the track without process noise."""
        t = self.steady.model.F[0, 1] * np.arange(1, steps + LARGEST_N + 1)  # F[0, 1] is the time step
        s = sum(component * t**i / factorial(i) for i, component in enumerate(self.starts[axis]))
        return np.array([s[N : N + steps] for N in range(LARGEST_N + 1)])


def columns(dt=DT, q=Q, r=R, size=1.0):
    """Return both columns of the table, {"cv": Column, "ca": Column}, as the paper has them by default.

    dt, q and r are those of `constant_velocity`; size multiplies the velocity and the acceleration of the mobile.

    >>> columns()["ca"].steady.B.round(3).ravel()
    array([0.744, 0.488, 0.16 ])
    """
    result = {}
    for key, make in MODELS.items():
        starts = tuple(tuple(size * component for component in start) for start in STARTS[key])
        result[key] = Column(SteadyStateFilter.from_kalman(make(dt, q, r)), starts, np.array(PRINTED[key]))
    return result


def expected_absolute(mean, variance):
    """Return the expected absolute value of Gaussian variables with a variance above zero (folded normal).

    >>> expected_absolute(np.array([0.0, -3.0]), 1.0).round(4)
    array([0.7979, 3.0008])
    """
    sigma = np.sqrt(variance)
    ratio = mean / sigma
    return sigma * np.sqrt(2 / np.pi) * np.exp(-(ratio**2) / 2) + mean * erf(ratio / np.sqrt(2))


def position_rows(model):
    """Return the first rows of F^N for N = 0 ... 5, (6, n): they take a state to the position N steps later."""
    return np.array([np.linalg.matrix_power(model.F, N)[0] for N in range(LARGEST_N + 1)])


def mean_and_variance(column, axis, L, estimator=None):
    """Return the mean and the variance of e for N = 0 ... 5 and k = 1 ... L, each (6, L), without process noise.

    The estimator is the column's steady-state filter, or another filter of the same F, H and R. The error obeys
    e(k+1) = A e(k) - B v(k+1). After 2·TRANSIENT steps its mean is taken as zero and its variance as constant.
    """
    if estimator is None:
        estimator = column.steady
    steps = min(L, 2 * TRANSIENT)
    A, B, _ = estimator.coefficients(steps)
    rows = position_rows(estimator.model)
    e = np.asarray(column.starts[axis], dtype=float)
    P = np.zeros((len(e), len(e)))
    mean = np.zeros((LARGEST_N + 1, L))
    variance = np.empty((LARGEST_N + 1, L))
    for k in range(steps):
        e = A[k] @ e
        P = A[k] @ P @ A[k].T + B[k] @ estimator.model.R @ B[k].T
        mean[:, k] = rows @ e
        variance[:, k] = np.diag(rows @ P @ rows.T)
    variance[:, steps:] = variance[:, [steps - 1]]
    return mean, variance


def expected_averages(column, axis, L, estimator=None):
    """Return the expected averages over the first 1 ... L steps, (6, L), exactly: the track has no process noise.

    The estimator is that of `mean_and_variance`.

    >>> from mpt_helpers import SteadyStateFilter, constant_velocity
    >>> steady = SteadyStateFilter.from_kalman(constant_velocity(dt=1.0, q=0.01, r=0.1))
    >>> column = Column(steady, starts=((0, 20), (0, 30)), printed=())
    >>> (100 * expected_averages(column, axis=0, L=10_000)[:2, -1]).round(4)
    array([0.0112, 0.0142])
    """
    ratio = expected_absolute(*mean_and_variance(column, axis, L, estimator)) / column.positions(axis, L)
    return ratio.cumsum(axis=1) / np.arange(1, L + 1)


def of_both_axes(column, L, estimator=None):
    """Return the expected averages over L steps, (6,), as the mean of both axes.

    >>> (100 * of_both_axes(columns()["cv"], L=10_000)).round(4)
    array([0.0111, 0.0141, 0.0155, 0.0164, 0.0171, 0.0176])
    """
    return np.mean([expected_averages(column, axis, L, estimator)[:, -1] for axis in (0, 1)], axis=0)


def average_of_measurements(column, L):
    """Return the expected average of both axes over L steps of the bare measurements, without a filter."""
    inverse = np.mean([1 / column.positions(axis, L)[0] for axis in (0, 1)])
    return float(inverse * expected_absolute(0.0, R))


def settled_averages(column, L):
    """Return the averages of both axes over L steps, (6,), of the same filter if it had settled before the first.

    >>> (100 * settled_averages(columns()["cv"], L=10_000)).round(4)
    array([0.0007, 0.0008, 0.001 , 0.0011, 0.0013, 0.0014])
    """
    _, variance = mean_and_variance(column, 0, 2 * TRANSIENT)
    error = expected_absolute(0.0, variance[:, -1:])
    return np.mean([(error / column.positions(axis, L)).mean(axis=1) for axis in (0, 1)], axis=0)


def settled_sigma(column, seconds):
    """Return σ of the position these seconds ahead (array), after the start; the mobile moves exactly as stated.

    >>> settled_sigma(columns()["cv"], [0, 5]).round(3)
    array([0.214, 0.571])
    """
    model = column.steady.model
    P = error_moments(column.steady, column.truth(0), 2 * TRANSIENT).covariance[-1]
    make = {2: constant_velocity, 3: constant_acceleration}[model.n]
    rows = [make(ahead, Q, R).F[0] if ahead else np.eye(model.n)[0] for ahead in seconds]
    return np.sqrt([row @ P @ row for row in rows])


def errors(column, axis, noise, rng, runs, v=None):
    """Return e and s(k+N) of simulated runs on one axis, each (6, 110, runs).

    v is the measurement noise, (115, 1, runs), drawn like the rest if it is not given.
    """
    x, z = simulate(column.truth(axis, noise), TRANSIENT + LARGEST_N, rng, tracks=runs)
    if v is not None:
        z = x[:, :1] + v
    predicted = np.einsum("Ni,kim->Nkm", position_rows(column.steady.model), column.steady.filter(z[:TRANSIENT]))
    position = np.array([x[N : N + TRANSIENT, 0] for N in range(LARGEST_N + 1)])
    return position - predicted, position


def relative_errors(column, noise, rng, runs, v=(None, None)):
    """Return |e| / |s| of simulated runs: {axis: (6, 110, runs)}.

    The axes are x, y, the mean of both, and distances in the plane. noise is the process noise of the tracks as a
    multiple of the filter's, v the measurement noise on the axes x and y if it is given, each (115, 1, runs).
    """
    e_x, s_x = errors(column, 0, noise, rng, runs, v[0])
    e_y, s_y = errors(column, 1, noise, rng, runs, v[1])
    x = np.abs(e_x / s_x)
    y = np.abs(e_y / s_y)
    plane = np.sqrt((e_x**2 + e_y**2) / (s_x**2 + s_y**2))
    return dict(zip(AXES, (x, y, (x + y) / 2, plane), strict=True))


def averages(column, ratio, lengths):
    """Return the averages of runs over their first L steps, (lengths, 6, runs), from ratio, |e| / |s|, (6, 110, runs).

    Beyond step 110, |e| / |s| is replaced by its expectation: the mean of |e| is that of the last thirty steps
    simulated, and s grows as on the track without process noise (the starts of both axes are in proportion).
    """
    s = column.positions(0, max(TRANSIENT, *lengths))
    last = slice(TRANSIENT - 30, TRANSIENT)
    mean_error = (ratio[:, last].mean(axis=2) * s[:, last]).mean(axis=1, keepdims=True)
    expected = mean_error / s[:, TRANSIENT:]  # |e| / |s| of step 111 and those after it
    sums = ratio.cumsum(axis=1)
    result = []
    for L in lengths:
        simulated = sums[:, min(L, TRANSIENT) - 1]
        beyond = expected[:, : max(L - TRANSIENT, 0)].sum(axis=1, keepdims=True)
        result.append((simulated + beyond) / L)
    return np.array(result)


def log_likelihood(samples, tables):
    """Return the log of the probability of printing each table, (lengths, tables).

    samples are the averages of runs, (lengths, numbers, runs), six numbers for a column or twelve for both; tables are
    (numbers, tables), printed with four decimals. The averages of a run are taken as Gaussian with the mean and
    covariance of the samples. Rounding adds the variance of a uniform error. The density, times the width of the last
    digit for each number, is a probability.
    """
    _, numbers, runs = samples.shape
    mean = samples.mean(axis=2, keepdims=True)
    centred = samples - mean
    rounding = LAST_DIGIT**2 / 12 * np.eye(numbers)
    C = centred @ centred.swapaxes(1, 2) / (runs - 1) + rounding
    off = tables - mean
    distance = (off * np.linalg.solve(C, off)).sum(axis=1)
    log_det = np.linalg.slogdet(2 * np.pi * C).logabsdet
    return numbers * np.log(LAST_DIGIT) - (distance + log_det[:, None]) / 2
