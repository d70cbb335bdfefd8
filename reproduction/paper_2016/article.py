"""The drawings and the tables of the notebook on 2016: a figure is two lines there, wherever it is shown."""

from dataclasses import replace

import numpy as np

from mpt_helpers import plots
from mpt_helpers.filters import KalmanFilter
from mpt_helpers.metrics import error_moments
from mpt_helpers.model import constant_acceleration, constant_velocity
from mpt_helpers.steady import SteadyStateFilter

from .. import burden
from . import readings, table1

STEPS = 10_000  # of the averages of Table 1, read as percent
TIME_STEPS = (0.5, 1.0, 2.0)  # seconds
SECONDS = 5  # ahead, at most
LONGEST_START = 500  # steps; every gain here has settled by then
UNKNOWN = 1e4  # the variance of a start of which nothing is known


def unknown_start(model):
    """Return the Kalman filter with P(0/0) = 10⁴ I, whose gain varies.

    >>> kf = unknown_start(table1.columns()["cv"].steady.model)
    >>> float(abs(kf.coefficients(8).B[-1] / table1.columns()["cv"].steady.B - 1).max().round(3))
    0.005
    """
    return KalmanFilter(replace(model, P0=UNKNOWN * np.eye(model.n)))


class FrozenLater:
    """The Kalman filter of `unknown_start`, with its gain frozen after some steps.

    >>> frozen = FrozenLater(table1.columns()["cv"].steady.model, after=8)
    >>> frozen.coefficients(60).B[[0, 7, 59], 0, 0].round(3)
    array([1.   , 0.551, 0.551])
    """

    def __init__(self, model, after):
        self.model = model
        self.varying = unknown_start(model).coefficients(after)

    def coefficients(self, N):
        """Return the coefficients A, B and P of N steps, as filters do; P is that of the last step that varied."""
        steps = np.minimum(np.arange(N), len(self.varying.B) - 1)
        return type(self.varying)(*(each[steps] for each in self.varying))


def settled_covariance(column, noise=0.0):
    """Return the covariance of the filter's error after the start, (n, n), with `noise` times Q in the track.

    >>> settled_covariance(table1.columns()["cv"]).round(3)
    array([[0.046, 0.013],
           [0.013, 0.006]])
    """
    return error_moments(column.steady, column.truth(0, noise), 2 * table1.TRANSIENT).covariance[-1]


def settled_sigma(column, seconds, noise=0.0):
    """Return σ of the position these seconds ahead (array), after the start.

    The mobile moves exactly as stated, or with a process noise that is `noise` times Q.

    >>> settled_sigma(table1.columns()["cv"], [0, 5]).round(3)
    array([0.214, 0.571])
    """
    model = column.steady.model
    P = settled_covariance(column, noise)
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


def steps_to_freeze(model, within=0.02):
    """Return the first step from which the gain of an unknown start stays near the settled gain, within 2 % of it.

    >>> steps_to_freeze(constant_velocity(dt=1.0, q=0.01, r=0.1))
    8
    """
    gains = unknown_start(model).coefficients(LONGEST_START).B
    settled = SteadyStateFilter.from_kalman(model).B
    off = np.abs(gains / settled - 1).max(axis=(1, 2))
    last_that_is_off = np.flatnonzero(off >= within)[-1]
    return int(last_that_is_off) + 2  # counted from 1, and the step after it


def freeze_table():
    """Return header and rows of the table of steps after which a gain may be frozen, for worse and worse sensors."""
    header = ["σ of one measurement (m)", *(table1.NAMES[key] for key in table1.MODELS)]
    rows = []
    for r in (0.1, 1.0, 10.0, 100.0):
        steps = [steps_to_freeze(make(table1.DT, table1.Q, r)) for make in table1.MODELS.values()]
        rows.append([f"{np.sqrt(r):.2g}", *steps])
    return header, rows


def positions_ahead(x, dt, steps):
    """Return the positions 1 ... steps time steps after a state [s v] or [s v a], by adding the way of one step.

    >>> positions_ahead([10.0, 2.0], dt=1.0, steps=3)
    [12.0, 14.0, 16.0]
    >>> positions_ahead([0.0, 0.0, 2.0], dt=1.0, steps=3)
    [1.0, 4.0, 9.0]
    """
    s, v, *rest = x
    way = v * dt
    if rest:
        longer = rest[0] * dt**2  # the way of each step is longer by this than that of the step before
        way = way + longer * 0.5
    positions = []
    for N in range(1, steps + 1):
        s = s + way
        positions.append(s)
        if rest and steps > N:
            way = way + longer
    return positions


def cost_table():
    """Return header and rows of the table of operations per step, counted as in the paper's Table 2."""
    five = table1.LARGEST_N
    adding = {2: 1 + five, 3: 4 + five + (five - 1)}  # what `positions_ahead` multiplies and adds
    one = {2: 1 + 1, 3: 4 + 1}
    rows = {}
    for n in (2, 3):
        filtering = burden.total(burden.steady_state(n, 1))
        predictor = burden.total(burden.prediction(n, 1))
        row = burden.product(1, n, 1)
        counts = {
            "estimate, Kalman filter": burden.total(burden.kalman(n, 1)),
            "estimate, constant gain": filtering,
            "one prediction, without an estimate: the paper's predictor": predictor,
            "estimate and one prediction: adding the way": filtering + one[n],
            "estimate and one prediction: a row times the estimate": filtering + row,
            "estimate and one prediction: filter and predictor": filtering + predictor,
            "estimate and five: adding the way again and again": filtering + adding[n],
            "estimate and five: five rows times the estimate": filtering + five * row,
            "estimate and five: filter and five predictors": filtering + five * predictor,
        }
        for what, count in counts.items():
            rows.setdefault(what, []).append(count)
    return ["operations per step", *table1.NAMES.values()], [[what, *each] for what, each in rows.items()]


def percent_of_position(column):
    """Return the expected |error| / position of the estimate in percent, (STEPS,), as the mean of both axes."""
    each = []
    for axis in (0, 1):
        error = table1.expected_absolute(*table1.mean_and_variance(column, axis, STEPS))
        each.append(100 * error[0] / column.positions(axis, STEPS)[0])
    return np.mean(each, axis=0)


def effects_table():
    """Return header and rows of the table of the two effects that enlarge Table 1."""
    header = ["in the first ten steps", "error that never changes", "the paper's filter", "numbers, had it settled"]
    rows = []
    for key, column in table1.columns().items():
        flat, own = [], []
        for axis in (0, 1):
            positions = column.positions(axis, STEPS)
            error = table1.expected_absolute(*table1.mean_and_variance(column, axis, STEPS))
            flat.append(table1.share_of_the_start(1 / positions))
            own.append(table1.share_of_the_start(error / positions))
        factor = table1.of_both_axes(column, STEPS) / table1.settled_averages(column, STEPS)
        flat, own = 100 * np.array(flat), 100 * np.array(own)
        shares = [f"{flat.min():.0f} to {flat.max():.0f} %", f"{own.min():.0f} to {own.max():.0f} %"]
        rows.append([table1.NAMES[key], *shares, f"{factor.min():.1f} to {factor.max():.1f} times smaller"])
    return header, rows


def draw_start(steps=25):
    """Return a figure of the rms error of the estimate at constant velocity, x axis, of two starts."""
    fig, axes = plots.panels([["cv"]], height=3.4)
    ax = axes["cv"]
    column = table1.columns()["cv"]
    k = np.arange(1, steps + 1)
    rms = {}
    for name, estimator in {"steady": column.steady, "kalman": FrozenLater(column.steady.model, after=8)}.items():
        mean, variance = table1.mean_and_variance(column, 0, steps, estimator)
        rms[name] = np.sqrt(mean[0] ** 2 + variance[0])
    measured = ax.axhline(np.sqrt(table1.R), color=plots.COLOUR_OF["measured"], ls=":", label="one measurement")
    (frozen,) = ax.semilogy(k, rms["steady"], color=plots.COLOUR_OF["steady"], label="frozen at once, as in the paper")
    (varying,) = ax.semilogy(k, rms["kalman"], color=plots.COLOUR_OF["kalman"], ls="--", label="the gain varies first")
    ax.set_ylim(0.1, 20)
    ax.set_yticks([0.1, 0.3, 1, 3, 10], ["0.1", "0.3", "1", "3", "10"])
    ax.minorticks_off()
    plots.label_line(frozen, f"frozen at once: {rms['steady'].max():.0f} m off", at=4, xytext=(8, 2))
    plots.label_line(varying, f"the gain varies first: settles at {rms['kalman'][-1]:.2f} m", at=5, xytext=(0, -26))
    ax.annotate("one measurement: 0.32 m", (steps, np.sqrt(table1.R)), (0, 5), textcoords="offset points", ha="right",
                color=measured.get_color())  # fmt: skip
    ax.set_ylabel("rms error (m)")
    plots.finish(ax, "measurements so far", "Let the gain vary first, or start 11 m off")
    ax.get_legend().remove()
    return fig


def draw_sum():
    """Return a figure of the running sum whose last value, divided by 10,000, is a number of Table 1."""
    fig, axes = plots.panels([["sum"]], height=3.2)
    ax = axes["sum"]
    k = np.arange(1, STEPS + 1)
    some = np.unique(np.geomspace(1, STEPS, 60).astype(int)) - 1  # enough points for a smooth line
    ax.axvspan(1, 10, color="0.93", lw=0)
    for (key, column), style in zip(table1.columns().items(), ("-", "--"), strict=True):
        total = percent_of_position(column).cumsum()
        (line,) = ax.semilogx(
            k[some], total[some], style, color=plots.COLOUR_OF["steady"], label=f"estimate, {table1.NAMES[key]}"
        )
        text = f"{table1.NAMES[key]}:\n{total[9]:.0f} % after ten steps, {total[-1]:.0f} % after all"
        plots.label_line(line, text, at=STEPS, xytext=(0, 5), ha="right")
    ax.set_ylim(0, 150)
    ax.set_xlim(1, STEPS)
    ax.set_xticks([1, 10, 100, 1000, 10_000], ["1", "10", "100", "1,000", "10,000"])
    ax.set_ylabel("sum of |error| / position (%)")
    plots.finish(ax, "steps", "Ten of 10,000 steps make nearly all of Table 1")
    ax.get_legend().remove()
    return fig


def draw_time_step():
    """Return a figure of σ of the predicted position for three time steps, counted in steps and in seconds."""
    fig, ax = plots.panels([["steps", "seconds"]], height=3.0)
    for dt, style in zip(TIME_STEPS, (":", "-", "--"), strict=True):
        column = table1.columns(dt=dt)["cv"]
        look = {"ls": style, "color": plots.COLOUR_OF["steady"], "label": f"Δt = {dt:g} s"}
        steps = np.arange(table1.LARGEST_N + 1)
        (line,) = ax["steps"].plot(steps, settled_sigma(column, dt * steps), **look)
        plots.label_line(line, f"{dt:g} s", at=SECONDS, xytext=(4, -4))
        seconds = np.linspace(0, SECONDS, 21)
        ax["seconds"].plot(seconds, settled_sigma(column, seconds), **look)
    ends = [settled_sigma(table1.columns(dt=dt)["cv"], [SECONDS])[0] for dt in (TIME_STEPS[0], TIME_STEPS[-1])]
    colour = plots.COLOUR_OF["steady"]
    for dt, end, below in zip((TIME_STEPS[0], TIME_STEPS[-1]), ends, (-10, 0), strict=True):
        text = f"{dt:g} s: {end:.2f} m"
        ax["seconds"].annotate(text, (SECONDS, end), (4, below), textcoords="offset points", color=colour)
    for name, panel in ax.items():
        panel.set_ylim(0, 1.15)
        panel.set_xlim(0, SECONDS + (1.6 if name == "steps" else 3.6))  # room for the labels
        panel.set_xticks(range(SECONDS + 1))
        plots.finish(panel, f"{name} ahead", "σ of the position (m)")
        panel.get_legend().remove()
    fig.suptitle("Counted in seconds, the time step hardly matters", x=0.02, ha="left", fontsize=11)
    return fig


def time_step_table():
    """Return header and rows of the table of what is known at constant velocity, exact motion, for each time step."""
    header = ["time step (s)", "σ of the position now (m)", "σ of the velocity (m/s)", "σ of the position in 5 s (m)"]
    rows = []
    for dt in TIME_STEPS:
        column = table1.columns(dt=dt)["cv"]
        now, ahead = settled_sigma(column, [0, SECONDS])
        velocity = np.sqrt(settled_covariance(column)[1, 1])
        rows.append([f"{dt:g}", f"{now:.3f}", f"{velocity:.3f}", f"{ahead:.3f}"])
    return header, rows


def draw_table1():
    """Return a figure of Table 1: printed, computed, and of the same filter if it had settled before the first step."""
    fig, ax = plots.panels([["cv", "ca"]], height=3.2)
    for key, column in table1.columns().items():
        panel = ax[key]
        positions = [column.positions(axis, STEPS)[0] for axis in (0, 1)]
        measured = table1.expected_absolute(0.0, table1.R) * np.mean([1 / each for each in positions])
        steady, grey = plots.COLOUR_OF["steady"], plots.COLOUR_OF["measured"]
        panel.semilogy(column.printed, "o", color="black", ms=5, label="printed in the paper")
        own = 100 * table1.of_both_axes(column, STEPS)
        panel.semilogy(own, "-", color=steady, label="computed: starts at rest")
        settled = 100 * table1.settled_averages(column, STEPS)
        panel.semilogy(settled, "--", color=steady, label="if settled from the start")
        panel.semilogy(0, 100 * measured, "s", color=grey, label="one raw measurement")
        panel.set_ylim(5e-4, 3e-2)
        panel.set_yticks([1e-3, 1e-2], ["0.001", "0.01"])
        plots.finish(panel, "steps ahead N", table1.NAMES[key])
    ax["cv"].set_ylabel("average error (%)")
    fig.suptitle("Had the filter settled, Table 1 would be 2 to 17 times smaller", x=0.02, ha="left", fontsize=11)
    plots.legend_below(ax["cv"], 2)
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


def draw_figure(key, N, seed, plane=False, steps=60, start=14):
    """Return Figure 1, 2, 3 or 4 of the paper as errors (m) of one run: of the start, and of the later steps.

    Bands are the mean ± 2σ, exact. `plane` adds the first eight steps in the plane.
    """
    column = table1.columns()[key]
    layout = [("start", "later"), ("plane", "plane")] if plane else [("start", "later")]
    fig, ax = plots.panels(layout, height=2.5)
    colour = plots.COLOUR_OF["predictor" if N else "steady"]
    k = np.arange(1, steps + 1)
    tracks, largest = [], []
    for axis, (name, style) in enumerate((("x axis", "-"), ("y axis", "--"))):
        e, s = table1.errors(column, axis, 0.0, np.random.default_rng([seed, axis]), 1)
        tracks.append((s[0, :8, 0], (s - e)[0, :8, 0]))
        mean, variance = table1.mean_and_variance(column, axis, steps)
        largest.append(np.sqrt(mean[N] ** 2 + variance[N]).max())
        low, high = (mean[N] + factor * np.sqrt(variance[N]) for factor in (-2, 2))
        for panel, some in (("start", slice(0, start)), ("later", slice(start, None))):
            ax[panel].fill_between(k[some], low[some], high[some], color=colour, alpha=0.12, lw=0)
            ax[panel].plot(k[some], e[N, :steps, 0][some], style, color=colour, label=name)
    plots.finish(ax["start"], "step k", "error (m), the start")
    plots.finish(ax["later"], "step k", "error (m), later")
    ax["later"].get_legend().remove()
    what = "The prediction" if N else "The estimate"
    sigma = settled_sigma(column, [N])[0]
    title = f"{what}: {max(largest):.2g} m off at the start, σ = {sigma:.2f} m later"
    fig.suptitle(title, x=0.02, ha="left", fontsize=11)
    if plane:
        (x, estimated_x), (y, estimated_y) = tracks
        ax["plane"].plot(x, y, "o-", color=plots.COLOUR_OF["truth"], label="real")
        ax["plane"].plot(estimated_x, estimated_y, "x--", color=colour, ms=7, label="estimated")
        plots.finish(ax["plane"], "x (m)", "y (m), first eight steps in the plane")
    return fig


def draw_odds(ratios, of_the_print):
    """Return a figure of the odds that tables drawn from either reading show, and of those that the print shows.

    ratios is {unit: log10 of the odds of percent to fraction, of each table drawn from it}; of_the_print is that of the
    print.
    """
    fig, axes = plots.panels([["odds"]], height=2.8)
    ax = axes["odds"]
    edges = np.linspace(-12, 4, 49)
    look = {"percent": ("0.4", "-", (4.9, 0.7)), "fraction": ("0.6", "--", (-8.5, 0.3))}  # colour, line, label's place
    for unit, values in ratios.items():
        colour, style, (x, height) = look[unit]
        counts = np.histogram(values, edges)[0]
        ax.stairs(counts, edges, ls=style, lw=1.6, color=colour, label=f"1,000 tables in {unit}")
        most = max(np.histogram(each, edges)[0].max() for each in ratios.values())
        ax.text(x, height * most, f"tables\nin {unit}", color=colour, ha="center")
    ax.axvline(of_the_print, color="black", lw=1.6, label="the paper's table")
    ax.annotate("the paper's table ", (of_the_print, 0.92 * most), ha="right")
    ax.set_xlim(-12.5, 7)
    ax.set_ylabel("tables")
    plots.finish(ax, "log10 of the odds of percent to fraction", "The paper's table lies among those in percent")
    ax.get_legend().remove()
    return fig
