"""The drawings and the tables of the notebook on 2016: a figure is two lines there, wherever it is shown."""

from dataclasses import replace

import numpy as np

from mpt_helpers import plots
from mpt_helpers.filters import KalmanFilter
from mpt_helpers.metrics import error_moments
from mpt_helpers.model import constant_acceleration, constant_velocity

from . import readings, table1

STEPS = 10_000  # of the averages of Table 1, read as percent
TIME_STEPS = (0.5, 1.0, 2.0)  # seconds
SECONDS = 5  # ahead, at most
SHOWN = {"percent": (9500, 10_600), "fraction": (92, 110)}  # lengths
UNKNOWN = 1e4  # the variance of a start of which nothing is known


def unknown_start(model):
    """Return the Kalman filter with P(0/0) = 10⁴ I, whose gain varies.

    >>> kf = unknown_start(table1.columns()["cv"].steady.model)
    >>> float(abs(kf.coefficients(8).B[-1] / table1.columns()["cv"].steady.B - 1).max().round(3))
    0.005
    """
    return KalmanFilter(replace(model, P0=UNKNOWN * np.eye(model.n)))


def settled_sigma(column, seconds, noise=0.0):
    """Return σ of the position these seconds ahead (array), after the start.

    The mobile moves exactly as stated, or with a process noise that is `noise` times Q.

    >>> settled_sigma(table1.columns()["cv"], [0, 5]).round(3)
    array([0.214, 0.571])
    """
    model = column.steady.model
    P = error_moments(column.steady, column.truth(0, noise), 2 * table1.TRANSIENT).covariance[-1]
    make = {2: constant_velocity, 3: constant_acceleration}[model.n]
    sigma = []
    for ahead in seconds:
        variance = P[0, 0]
        if ahead > 0:
            later = make(ahead, table1.Q, table1.R)
            variance = (later.F @ P @ later.F.T + noise * later.Q)[0, 0]
        sigma.append(np.sqrt(variance))
    return np.array(sigma)


def sigma_table():
    """Return header and rows of the table to print instead: σ in metres, beside the printed numbers."""
    seconds = np.arange(table1.LARGEST_N + 1)
    header = ["error of the position", "now", *(f"{ahead} s ahead" for ahead in seconds[1:])]
    rows = []
    for key, column in table1.columns().items():
        rows += [
            [f"{table1.NAMES[key]}: printed in Table 1 (%)", *(f"{value:.4f}" for value in column.printed)],
            ["σ, exact motion (m)", *(f"{value:.3f}" for value in settled_sigma(column, seconds))],
            ["σ, with process noise (m)", *(f"{value:.3f}" for value in settled_sigma(column, seconds, noise=1.0))],
        ]
    return header, rows


def draw_table1():
    """Return a figure of Table 1: printed, computed, and of the same filter if it had settled before the first step."""
    fig, ax = plots.panels([["cv", "ca"]], height=3.2)
    for key, column in table1.columns().items():
        panel = ax[key]
        positions = [column.positions(axis, STEPS)[0] for axis in (0, 1)]
        measured = table1.expected_absolute(0.0, table1.R) * np.mean([1 / each for each in positions])
        panel.semilogy(column.printed, "o", color="black", ms=5, label="printed in the paper")
        panel.semilogy(100 * table1.of_both_axes(column, STEPS), "-", label="computed: starts at rest")
        panel.semilogy(100 * table1.settled_averages(column, STEPS), "--", label="if settled from the start")
        panel.semilogy(0, 100 * measured, "s", label="one raw measurement")
        panel.set_ylim(5e-4, 3e-2)
        panel.set_yticks([1e-3, 1e-2], ["0.001", "0.01"])
        plots.finish(panel, "steps ahead N", table1.NAMES[key])
    fig.suptitle("Table 1: average |error| / position (%)", x=0.02, ha="left", fontsize=11)
    plots.legend_below(ax["cv"], 2)
    return fig


def draw_start(steps=25):
    """Return a figure of the rms error of the estimate on the x axis, of three starts."""
    fig, ax = plots.panels([["cv", "ca"]], height=3.2)
    k = np.arange(1, steps + 1)
    for key, column in table1.columns().items():
        panel = ax[key]
        starts = {
            "constant gain, at rest at the origin": (column.steady, "-"),
            "varying gain, start unknown": (unknown_start(column.steady.model), "--"),
        }
        for label, (estimator, style) in starts.items():
            mean, variance = table1.mean_and_variance(column, 0, steps, estimator)
            panel.semilogy(k, np.sqrt(mean[0] ** 2 + variance[0]), style, label=label)
        panel.axhline(np.sqrt(table1.R), color="C2", ls=":", label="one raw measurement")
        panel.set_ylim(0.1, 20)
        panel.set_yticks([0.1, 1, 10], ["0.1", "1", "10"])
        plots.finish(panel, "step k", table1.NAMES[key])
    fig.suptitle("rms error of the estimated position (m)", x=0.02, ha="left", fontsize=11)
    plots.legend_below(ax["cv"], 1)
    return fig


def draw_time_step():
    """Return a figure of σ of the predicted position for three time steps, counted in steps and in seconds."""
    fig, ax = plots.panels([["cv steps", "cv"], ["ca steps", "ca"]], height=2.4)
    for dt, colour, style in zip(TIME_STEPS, ("C0", "C1", "C2"), (":", "-", "--"), strict=True):
        for key, column in table1.columns(dt=dt).items():
            sigma = settled_sigma(column, dt * np.arange(table1.LARGEST_N + 1))
            ax[f"{key} steps"].semilogy(sigma, f"{style}o", color=colour, ms=3, label=f"Δt = {dt:g} s")
            seconds = np.linspace(0, SECONDS, 21)
            ax[key].semilogy(seconds, settled_sigma(column, seconds), style, color=colour)
            at_steps = seconds[seconds % dt == 0]
            ax[key].semilogy(at_steps, settled_sigma(column, at_steps), "o", color=colour, ms=3)
    for name, panel in ax.items():
        panel.set_ylim(0.14, 9)
        panel.set_yticks([0.2, 0.5, 1, 2, 5], ["0.2", "0.5", "1", "2", "5"])
        panel.minorticks_off()
        plots.finish(panel, "steps ahead" if "steps" in name else "seconds ahead", table1.NAMES[name[:2]])
    fig.suptitle("σ of the predicted position (m), exact motion", x=0.02, ha="left", fontsize=11)
    plots.legend_below(ax["cv steps"], 3)
    return fig


def readings_of(seed):
    """Return the log-probabilities of the print, {Reading: {(axis, key): (lengths,)}}, of the two best readings."""
    columns = table1.columns()
    log_p = {}
    for reading in (readings.PERCENT, readings.FRACTION):
        samples = readings.all_samples(columns, reading, seed)
        log_p[reading] = readings.log_probabilities(samples, columns)
    return log_p


def odds(log_p, axes=table1.AXES, keys=("cv", "ca")):
    """Return how many times as probable the print is as percent than as fractions, of `readings_of`."""
    p = [readings.probability(each, readings.LENGTHS[reading.unit], axes, keys) for reading, each in log_p.items()]
    return p[0] / p[1]


def draw_length(seed=2016):
    """Return a figure of the length that each column implies under both readings, and of the odds after a prior."""
    log_p = readings_of(seed)
    fig, ax = plots.panels([["percent", "fraction"], ["odds", "odds"]], height=2.5)
    for reading, each in log_p.items():
        panel = ax[reading.unit]
        lengths = readings.LENGTHS[reading.unit]
        for key, style in (("cv", "-"), ("ca", "--")):
            panel.plot(lengths, readings.length_from(each, lengths, [key])[0], style, label=table1.NAMES[key])
        panel.set_xlim(SHOWN[reading.unit])
        panel.set_yticks([])
        plots.finish(panel, "length L (steps)", f"{reading.unit}: likelihood of L")
        panel.get_legend().remove()
    prior = np.geomspace(1, 1000, 31)
    ratio = odds(log_p)
    of_axes = [odds(log_p, [axis]) for axis in table1.AXES]
    panel = ax["odds"]
    panel.fill_between(prior, min(of_axes) / prior, max(of_axes) / prior, color="C2", alpha=0.2, lw=0)
    panel.loglog(prior, ratio / prior, color="C2")
    panel.plot(ratio, 1, "o", color="black", ms=6)
    panel.annotate(f"even at about {readings.rough(ratio)}", (ratio, 1), (8, 6), textcoords="offset points")
    panel.axhline(1, color="0.3", lw=0.8)
    panel.set_xticks([1, 10, 100, 1000], ["1", "10", "100", "1,000"])
    panel.set_yticks([0.01, 1, 100], ["0.01", "1", "100"])
    panel.minorticks_off()
    plots.finish(
        panel, "how many times as plausible you find 100 steps as 10,000", "odds of percent: same axis, same steps"
    )
    fig.legend(*ax["percent"].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return fig


def draw_figure(key, N, seed, plane=False, steps=60, start=14):
    """Return Figure 1, 2, 3 or 4 of the paper as errors (m) of one run: of the start, and of the later steps.

    Bands are the mean ± 2σ, exact. `plane` adds the first eight steps in the plane.
    """
    column = table1.columns()[key]
    layout = [("start", "later"), ("plane", "plane")] if plane else [("start", "later")]
    fig, ax = plots.panels(layout, height=2.4)
    k = np.arange(1, steps + 1)
    tracks = []
    for axis, (name, style) in enumerate((("x axis", "-"), ("y axis", "--"))):
        e, s = table1.errors(column, axis, 0.0, np.random.default_rng([seed, axis]), 1)
        tracks.append((s[0, :8, 0], (s - e)[0, :8, 0]))
        mean, variance = table1.mean_and_variance(column, axis, steps)
        low, high = (mean[N] + factor * np.sqrt(variance[N]) for factor in (-2, 2))
        for panel, some in (("start", slice(0, start)), ("later", slice(start, None))):
            ax[panel].fill_between(k[some], low[some], high[some], color=f"C{axis}", alpha=0.2, lw=0)
            ax[panel].plot(k[some], e[N, :steps, 0][some], style, color=f"C{axis}", label=name)
    plots.finish(ax["start"], "step k", "error (m), the start")
    plots.finish(ax["later"], "step k", "error (m), later")
    ax["later"].get_legend().remove()
    if plane:
        (x, estimated_x), (y, estimated_y) = tracks
        ax["plane"].plot(x, y, "o-", color="black", label="real")
        ax["plane"].plot(estimated_x, estimated_y, "x--", color="C2", ms=7, label="estimated")
        plots.finish(ax["plane"], "x (m)", "y (m), first eight steps in the plane")
    return fig


def draw_bootstrap(noises, probabilities, ratios, of_the_print):
    """Return a figure of the probability of the print over the process noise, and of the odds that tables show.

    probabilities is {unit: one for each of the noises}, relative to any; ratios is {unit: log10 of the odds of tables
    drawn from it}, and of_the_print is log10 of the odds of the print.
    """
    fig, ax = plots.panels([["noise"], ["ratio"]], height=2.4)
    styles = {"percent": "-", "fraction": "--"}
    for unit, p in probabilities.items():
        ax["noise"].loglog(noises, p, styles[unit], label=unit)
    ax["noise"].set_ylim(1e-3, 1e2)
    plots.finish(ax["noise"], "process noise of the track, as a multiple of Q", "probability of the print, relative")
    edges = np.linspace(-12, 4, 49)
    for unit, values in ratios.items():
        counts = np.histogram(values, edges)[0]
        ax["ratio"].stairs(counts, edges, ls=styles[unit], lw=1.6, label=f"1,000 tables of {unit}")
    ax["ratio"].axvline(of_the_print, color="black", lw=1.2, label="the print")
    plots.finish(ax["ratio"], "log10 of the odds of percent to fraction", "what tables of each reading would show")
    return fig
