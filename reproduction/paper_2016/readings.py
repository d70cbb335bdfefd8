"""How probable the twelve numbers of Table 1 of 2016 are under each reading of it.

A reading says in which unit the table is and how much process noise the tracks have, as a multiple of the filter's. The
axis and the length of the averages stay open: probabilities are means over the four axes and over lengths, with equal
weight for equal factors. The columns count as independent.
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
CHOSEN_STEPS = 10_000  # of the reading by which Table 1 is judged


class Reading(NamedTuple):
    """A reading of the table: its unit, and the process noise of the tracks as a multiple of the filter's."""

    unit: str
    noise: float


PERCENT = Reading("percent", 0.0)  # of exact motion
FRACTION = Reading("fraction", 1.0)  # of motion with the process noise of Q
FOUR = (PERCENT, FRACTION, Reading("fraction", 0.0), Reading("percent", 1.0))


def simulated(columns, noise, runs, seed):
    """Return |e| / |s| of runs of both filters: {key: {axis: (6, 110, runs)}}."""
    ratios = {}
    for i, (key, column) in enumerate(columns.items()):
        ratios[key] = relative_errors(column, noise, np.random.default_rng([seed, i]), runs)
    return ratios


def all_samples(columns, reading, seed, runs=RUNS, lengths=None):
    """Return the averages of simulated runs in the unit of a reading: {(axis, key): (lengths, 6, runs)}."""
    if lengths is None:
        lengths = LENGTHS[reading.unit]
    ratios = simulated(columns, reading.noise, runs, seed)
    samples = {}
    for key, column in columns.items():
        for axis in AXES:
            samples[axis, key] = UNITS[reading.unit] * averages(column, ratios[key][axis], lengths)
    return samples


def log_probabilities(samples, columns):
    """Return the log of the probability of printing each column, at each length: {(axis, key): (lengths,)}."""
    return {name: log_likelihood(each, columns[name[1]].printed[:, None])[:, 0] for name, each in samples.items()}


def weights(lengths):
    """Return weights of lengths that are equal for equal factors."""
    return np.gradient(np.log(lengths))


def probability(log_p, lengths, axes=AXES, keys=("cv", "ca")):
    """Return the probability of the printed columns under one rule for all keys, but for a constant common to all.

    log_p is that of `log_probabilities`. The mean is over the axes and the lengths.
    """
    both = [sum(log_p[axis, key] for key in keys) for axis in axes]
    return float(np.mean([weights(lengths) @ np.exp(each) for each in both]))


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


def bands(columns, seed):
    """Return the central 99 % of 10,000 runs, {key: (2, 6)}, of the reading by which Table 1 is judged.

    That is percent of exact motion, the mean of both axes, CHOSEN_STEPS.
    """
    means = {key: [] for key in columns}
    for each in range(seed, seed + 5):  # in five parts: all at once would take a gigabyte
        for key, ratio in simulated(columns, PERCENT.noise, RUNS, each).items():
            means[key].append(UNITS[PERCENT.unit] * averages(columns[key], ratio["both"], [CHOSEN_STEPS])[0])
    return {key: np.quantile(np.hstack(each), [0.005, 0.995], axis=1) for key, each in means.items()}


def compared(columns, seed):
    """Return the log-probabilities of the print under the four readings, and header and rows of a table of them.

    The log-probabilities are {Reading: {(axis, key): (lengths,)}}. The first example is the reading that we chose; the
    others are those that put most numbers into their bands.
    """
    log_p, rows = {}, []
    for reading in FOUR:
        lengths = LENGTHS[reading.unit]
        samples = all_samples(columns, reading, seed)
        log_p[reading] = log_probabilities(samples, columns)
        passed = {axis: passes(samples, columns, axis) for axis in AXES}
        if reading == PERCENT:
            axis, at = "both", np.flatnonzero(lengths == CHOSEN_STEPS)[0]
        else:
            axis = max(passed, key=lambda name: passed[name].max())
            at = passed[axis].argmax()
        most, length = passed[axis][at], lengths[at]
        behind = probability(log_p[PERCENT], LENGTHS[PERCENT.unit]) / probability(log_p[reading], lengths)
        against = "1" if reading == PERCENT else f"1 : {rough(behind)}"
        motion = "with the noise of Q" if reading.noise else "as stated"
        on = {"both": "both axes", "plane": "the plane"}.get(axis, f"axis {axis}")
        rows.append([reading.unit, motion, f"{most} of 12", f"{on}, {length} steps", against])
    header = ["unit", "motion", "in the 99 % band of runs", "for example", "odds to the first"]
    return log_p, header, rows


def rough(ratio):
    """Return a ratio as text with one digit, since another seed changes it by some 15 %; a large one as a power of ten.

    >>> rough(27.9), rough(0.83), rough(1.24), rough(6.6), rough(158), rough(75272)
    ('30', '0.8', '1', '7', '200', '10^5')
    """
    if ratio >= 1000:
        return f"10^{np.log10(ratio):.0f}"
    return f"{float(f'{ratio:.1g}'):g}"
