"""How probable the twelve numbers of Table 1 of 2016 are under each reading of it.

A reading says in which unit the table is and how much process noise the tracks have, as a multiple of the filter's. The
axis and the length of the averages stay open: probabilities are means over the four axes and over lengths, with equal
weight for equal factors. The columns count as independent, but for `same_measurement_noise`.
"""

from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from . import table1
from .table1 import AXES, averages, log_likelihood, relative_errors

UNITS = {"percent": 100, "fraction": 1}
LENGTHS = {"percent": np.arange(9000, 11001, 25), "fraction": np.arange(85, 111)}  # tried
WIDE = {"percent": np.arange(5000, 16001, 250), "fraction": np.arange(50, 161, 2)}  # for other averages and starts
RUNS = 2000


class Reading(NamedTuple):
    """A reading of the table: its unit, and the process noise of the tracks as a multiple of the filter's."""

    unit: str
    noise: float


PERCENT = Reading("percent", 0.0)  # of exact motion
FRACTION = Reading("fraction", 1.0)  # of motion with the process noise of Q


def simulated(columns, noise, runs, seed):
    """Return |e| / |s| of runs of both filters: {key: {axis: (6, 110, runs)}}."""
    ratios = {}
    for i, (key, column) in enumerate(columns.items()):
        ratios[key] = relative_errors(column, noise, np.random.default_rng([seed, i]), runs)
    return ratios


def all_samples(columns, reading, seed, runs=RUNS, lengths=None, average=averages):
    """Return the averages of simulated runs in the unit of a reading: {(axis, key): (lengths, 6, runs)}.

    `average` makes them from |e| / |s|: `averages`, or another function with its arguments.
    """
    if lengths is None:
        lengths = LENGTHS[reading.unit]
    ratios = simulated(columns, reading.noise, runs, seed)
    samples = {}
    for key, column in columns.items():
        for axis in AXES:
            samples[axis, key] = UNITS[reading.unit] * average(column, ratios[key][axis], lengths)
    return samples


def averages_within(column, ratio, lengths):
    """Return `averages` that stop where their target leaves the run: N steps earlier than the estimate's."""
    lengths = np.asarray(lengths)
    each = [averages(column, ratio, lengths - N)[:, N] for N in range(table1.LARGEST_N + 1)]
    return np.stack(each, axis=1)


def log_probabilities(samples, columns):
    """Return the log of the probability of printing each column, at each length: {(axis, key): (lengths,)}."""
    return {name: log_likelihood(each, columns[name[1]].printed[:, None])[:, 0] for name, each in samples.items()}


def weights(lengths):
    """Return weights of lengths that are equal for equal factors."""
    return np.gradient(np.log(lengths))


def probability(log_p, lengths, axes=AXES, keys=("cv", "ca"), only=None):
    """Return the probability of the printed columns under one rule for all keys, but for a constant common to all.

    log_p is that of `log_probabilities`. The mean is over the axes, and over the lengths or at one length only.
    """
    weight = weights(lengths) if only is None else lengths == only
    both = [sum(log_p[axis, key] for key in keys) for axis in axes]
    return float(np.mean([weight @ np.exp(each) for each in both]))


def same_measurement_noise(columns, reading, seed, runs=RUNS):
    """Return `probability` if both columns had the same measurement noise, as with one seed for all runs."""
    shape = (2, table1.TRANSIENT + table1.LARGEST_N, 1, runs)
    v = np.sqrt(table1.R) * np.random.default_rng([seed, 2]).standard_normal(shape)
    lengths = LENGTHS[reading.unit]
    ratios = {}
    for i, (key, column) in enumerate(columns.items()):
        ratios[key] = relative_errors(column, reading.noise, np.random.default_rng([seed, 3 + i]), runs, v)
    table = np.concatenate([column.printed for column in columns.values()])[:, None]
    p = []
    for axis in AXES:
        own = [UNITS[reading.unit] * averages(column, ratios[key][axis], lengths) for key, column in columns.items()]
        p.append(weights(lengths) @ np.exp(log_likelihood(np.concatenate(own, axis=1), table)[:, 0]))
    return float(np.mean(p))


def of_means(samples, columns, lengths, runs):
    """Return `probability` if each printed number is the mean of some runs."""
    narrower = {}
    for name, each in samples.items():
        mean = each.mean(axis=2, keepdims=True)
        narrower[name] = mean + (each - mean) / np.sqrt(runs)
    return probability(log_probabilities(narrower, columns), lengths)


def length_from(log_p, lengths, keys, axis="both"):
    """Return the density of the length given some columns (lengths,), its mean and its standard deviation."""
    log_density = sum(log_p[axis, key] for key in keys)
    density = np.exp(log_density - log_density.max())
    share = density * weights(lengths)
    mean = np.average(lengths, weights=share)
    spread = np.sqrt(np.average((lengths - mean) ** 2, weights=share))
    return density, float(mean), float(spread)


def best(log_p, lengths):
    """Return the axis and the length under which the printed table is most probable."""
    total = np.array([log_p[axis, "cv"] + log_p[axis, "ca"] for axis in AXES])
    axis, i = np.unravel_index(total.argmax(), total.shape)
    return AXES[axis], int(lengths[i])


def drawn_tables(columns, reading, axis, L, seed, tables=1000):
    """Return tables as a reading prints them: {key: (6, tables)}, with four decimals."""
    ratios = simulated(columns, reading.noise, tables, seed)
    result = {}
    for key, column in columns.items():
        result[key] = (UNITS[reading.unit] * averages(column, ratios[key][axis], [L])[0]).round(4)
    return result


def fit(samples, lengths, tables):
    """Return the log-probability of tables {key: (6, tables)}: averaged over axes and lengths, and at the best."""
    each = []
    for axis in AXES:
        each.append(sum(log_likelihood(samples[axis, key], table) for key, table in tables.items()))
    each = np.array(each)
    weighted = each + np.log(weights(lengths))[:, None]
    return np.logaddexp.reduce(weighted.reshape(-1, weighted.shape[2])), each.max(axis=(0, 1))


def passes(samples, columns, axis):
    """Return how many of the twelve numbers lie in the central 99 % of runs, at each length."""
    inside = []
    for key, column in columns.items():
        low, high = np.quantile(samples[axis, key], [0.005, 0.995], axis=2)
        inside.append((low <= column.printed) & (column.printed <= high))
    return np.hstack(inside).sum(axis=1)


def started(columns, at):
    """Return the columns for a mobile that starts at a matrix times x(0): at is {key: matrix}."""
    moved = {}
    for key, column in columns.items():
        moved[key] = replace(column, starts=[at[key] @ np.array(x0) for x0 in column.starts])
    return moved


def log10_at_best(columns, ratio, seed, runs=500):
    """Return log10 of the probability of the print on the x axis, at the best unit, length and track.

    ratio(e, s) is what is averaged over the steps, of the errors and the positions of runs, (6, 110, runs).
    """
    found = []
    for (unit, lengths), noise in product(WIDE.items(), (0.0, 1.0)):
        total = 0.0
        for i, column in enumerate(columns.values()):
            e, s = table1.errors(column, 0, noise, np.random.default_rng([seed, i]), runs)
            samples = np.abs(UNITS[unit] * averages(column, ratio(e, s), lengths))
            total = total + log_likelihood(samples, column.printed[:, None])
        found.append(total.max())
    return float(max(found) / np.log(10))


def rough(ratio):
    """Return a ratio as text with one digit, since another seed changes it by some 15 %; a large one as a power of ten.

    >>> rough(27.9), rough(0.83), rough(1.24), rough(6.6), rough(158), rough(75272)
    ('30', '0.8', '1', '7', '200', '10^5')
    """
    if ratio >= 1000:
        return f"10^{np.log10(ratio):.0f}"
    return f"{float(f'{ratio:.1g}'):g}"
