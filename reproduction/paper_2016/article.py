"""The drawings and the tables of the notebook on 2016: a figure is two lines there, wherever it is shown."""

from dataclasses import replace

import numpy as np

from mpt_helpers.kalman import KalmanFilter
from mpt_helpers.metrics import error_moments
from mpt_helpers.model import constant_acceleration, constant_velocity
from mpt_helpers.steady import SteadyStateFilter
from reproduction import plots

from .. import burden
from . import readings, table1

STEPS = 10_000  # of the averages of Table 1, read as percent
TIME_STEPS = (0.5, 1.0, 2.0)  # seconds
SECONDS = 5  # ahead, at most
STANDS = 10  # seconds after it began to brake, the car stands
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
    """Return header and rows of the table of steps after which a gain may be frozen.

    In units of the time step and of σ of a measurement, the models have no parameter but q Δt³ / R (constant velocity)
    or q Δt⁵ / R (constant acceleration). So one column serves every q, Δt and R.
    """
    header = ["q Δt³ / R, or q Δt⁵ / R", *(f"{table1.NAMES[key]}: from step" for key in table1.MODELS)]
    rows = []
    for ratio in (0.1, 0.01, 0.001, 0.0001):
        steps = [steps_to_freeze(make(1.0, table1.Q, table1.Q / ratio)) for make in table1.MODELS.values()]
        rows.append([f"{ratio:g}", *steps])
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
        way = way + rest[0] * (dt**2 / 2)
    if rest and steps > 1:
        longer = rest[0] * dt**2  # the way of each step is longer by this than that of the step before
    positions = []
    for N in range(1, steps + 1):
        s = s + way
        positions.append(s)
        if rest and steps > N:
            way = way + longer
    return positions


def frozen_step(x, K, z, dt):
    """Return the next estimate [s v] or [s v a]: predict, then correct, written out without products with 0 and 1.

    >>> frozen_step([0.0, 2.0], [0.5, 0.25], z=4.0, dt=1.0)
    [3.0, 2.5]
    """
    s, v, *rest = x
    if rest:
        (a,) = rest
        predicted = [s + v * dt + a * (dt**2 / 2), v + a * dt, a]
    else:
        predicted = [s + v * dt, v]
    surprise = z - predicted[0]
    return [each + gain * surprise for each, gain in zip(predicted, K, strict=True)]


def varying_step(x, P, z, dt, Q, R):
    """Return the next estimate [s v] and [P11 P12 P22] of a Kalman filter, written out; Q is [Q11 Q12 Q22].

    >>> x, P = varying_step([0.0, 2.0], [1.0, 0.0, 1.0], z=4.0, dt=1.0, Q=[0.0, 0.0, 0.0], R=2.0)
    >>> x, P
    ([3.0, 2.5], [1.0, 0.5, 0.75])
    """
    a, b, c = P
    grown = b + c * dt
    a, b, c = a + (b + grown) * dt + Q[0], grown + Q[1], c + Q[2]
    S = a + R
    K = [a / S, b / S]
    return frozen_step(x, K, z, dt), [K[0] * R, K[1] * R, c - K[1] * b]


def predictor_step(x, B, z, dt, N):
    """Return the next prediction N steps ahead by Eq. 19, [s v] or [s v a], from the one before; B is B_N.

    It predicts by F, takes the prediction back by N steps to compare it with the measurement, and corrects.

    >>> predictor_step([4.0, 2.0], [1.0, 0.25], z=4.0, dt=1.0, N=2)  # as `frozen_step`, and then two steps on
    [8.0, 2.5]
    """
    back = N * dt
    s, v, *rest = x
    if rest:
        (a,) = rest
        s, v = s + v * dt + a * (dt**2 / 2), v + a * dt
        surprise = z - (s + v * -back + a * (back**2 / 2))
    else:
        s = s + v * dt
        surprise = z - (s + v * -back)
    return [each + gain * surprise for each, gain in zip([s, v, *rest], B, strict=True)]


def cost_of_a_step():
    """Return header and rows of the table of operations per step at constant velocity, counted in two ways.

    The paper counts all that matrices take, and a prediction is then the first row of F^N times the estimate. Written
    out, products with 0 and 1 are left out, and positions one second after the other are reached by adding v Δt.

    >>> header, rows = cost_of_a_step()
    >>> [row[1:] for row in rows]
    [[69, 22], [10, 7], [15, 6], [50, 45]]
    """
    n = table1.columns()["cv"].steady.model.n
    varying, frozen, _, predictor, five = (row[1] for row in cost_table()[1])
    rows = [
        ["estimate, while the gain varies", burden.total(burden.kalman(n, 1)), varying],
        ["estimate, once it is frozen", burden.total(burden.steady_state(n, 1)), frozen],
        ["five positions ahead, from the estimate", SECONDS * burden.product(1, n, 1), five - frozen],
        [
            "the same five, by the predictors of the paper",
            SECONDS * burden.total(burden.prediction(n, 1)),
            SECONDS * predictor,
        ],
    ]
    return ["operations a step", "all products", "none with 0 or 1"], rows


def cost_table():
    """Return header and rows of the table of operations per step, written out without products with 0 and 1."""
    rows = [
        ["estimate, its gain varies (`varying_step`)", 22, "-"],
        ["estimate, its gain frozen (`frozen_step`)", 7, 13],
        ["estimate, and one position ahead", 7 + 2, 13 + 4],
        ["predictor of the paper (`predictor_step`)", 9, 17],
        ["estimate, and the next five positions (`positions_ahead`)", 7 + 6, 13 + 13],
    ]
    return ["additions and multiplications", *table1.NAMES.values()], rows


def without_noise(column, steps=STEPS):
    """Return the averages of Table 1 if neither the mobile nor the sensor has noise, (6,): the wrong start alone.

    >>> (100 * without_noise(table1.columns()["cv"])).round(4)
    array([0.0106, 0.0135, 0.0147, 0.0155, 0.016 , 0.0164])
    """
    each = []
    for axis in (0, 1):
        mean, _ = table1.mean_and_variance(column, axis, steps)
        each.append((np.abs(mean) / column.positions(axis, steps)).mean(axis=1))
    return np.mean(each, axis=0)


def percent_of_position(column):
    """Return the expected |error| / position of the estimate in percent, (STEPS,), as the mean of both axes."""
    each = []
    for axis in (0, 1):
        error = table1.expected_absolute(*table1.mean_and_variance(column, axis, STEPS))
        each.append(100 * error[0] / column.positions(axis, STEPS)[0])
    return np.mean(each, axis=0)


def draw_start(steps=25):
    """Return a figure of the typical (rms) error of the estimate at constant velocity, x axis, of two starts."""
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
    zero = rms["steady"][:10].argmin()
    crossing = f"at step {k[zero]} its mean error\npasses through zero"
    ax.annotate(crossing, (k[zero], rms["steady"][zero]), (2, 52), textcoords="offset points", color=frozen.get_color(),
                arrowprops={"arrowstyle": "-", "color": "0.6", "relpos": (0, 0)})  # fmt: skip
    plots.label_line(varying, f"the gain varies first: settles at {rms['kalman'][-1]:.2f} m", at=5, xytext=(0, -26))
    ax.annotate("one measurement: 0.32 m", (steps, np.sqrt(table1.R)), (0, 5), textcoords="offset points", ha="right",
                color=measured.get_color())  # fmt: skip
    ax.set_ylabel("typical error at 20 m/s (m)")
    largest = rms["steady"].max()
    plots.label_line(frozen, f"frozen at once, as in the paper: up to {largest:.0f} m off", at=3, xytext=(10, 4))
    plots.finish(ax, "measurements so far", f"Let the gain vary first, or start {largest:.0f} m off")
    ax.get_legend().remove()
    return fig


def printed_and_computed():
    """Return header and rows of Table 1 beside what is expected of its filters: percent, both axes, 10,000 steps."""
    header = ["average error (%)", "estimate", *(f"{N} ahead" for N in range(1, table1.LARGEST_N + 1))]
    rows = []
    for key, column in table1.columns().items():
        rows.append([f"{table1.NAMES[key]}, printed", *(f"{each:.4f}" for each in column.printed)])
        computed = 100 * table1.of_both_axes(column, STEPS)
        rows.append([f"{table1.NAMES[key]}, computed", *(f"{each:.4f}" for each in computed)])
    return header, rows


def draw_sum(single=10):
    """Return a figure of what each step adds to the first number of Table 1: ten single steps, and all others."""
    fig, axes = plots.panels([["sum"]], height=3.2)
    ax = axes["sum"]
    added = percent_of_position(table1.columns()["cv"])
    heights = [*added[:single], added[single:].sum()]
    places = [*range(1, single + 1), single + 2]
    colour = plots.COLOUR_OF["steady"]
    ax.bar(places, heights, color=[colour] * single + ["0.45"])
    for x, height in zip(places, heights, strict=True):
        ax.annotate(f"{height:.1f}", (x, height), (0, 2), textcoords="offset points", ha="center")
    ax.annotate(f"the other {STEPS - single:,} steps\ntogether", (places[-1], heights[-1]), (10, 18),
                textcoords="offset points", ha="right", color="0.35")  # fmt: skip
    ax.set_xticks(places, [*map(str, places[:-1]), "later"])
    ax.set_ylim(0, 52)
    ax.set_ylabel("error / position (%)")
    plots.finish(ax, "step", f"The first ten of {STEPS:,} steps make nearly all of the average")
    return fig


def draw_ahead():
    """Return a figure of σ of the predicted position at constant velocity, by seconds ahead: exact and pushed."""
    fig, axes = plots.panels([["sigma"]], height=2.8)
    ax = axes["sigma"]
    colour = plots.COLOUR_OF["steady"]
    column = table1.columns()["cv"]
    seconds = np.arange(0, SECONDS + 0.25, 0.5)
    for name, noise, style in (("pushed as Q says", 1, "-"), ("exact motion", 0, "--")):
        (line,) = ax.plot(seconds, settled_sigma(column, seconds, noise), style, color=colour, label=name)
        plots.label_line(line, f"{name}:\n{line.get_ydata()[-1]:.2f} m", at=SECONDS, xytext=(6, -9))
    ax.set_ylim(0, 1.25)
    ax.set_xlim(-0.2, SECONDS + 2.3)  # room for the labels
    ax.set_xticks(range(SECONDS + 1))
    ax.set_ylabel("typical error (m)")
    plots.finish(ax, "seconds ahead", "Five seconds ahead, the pushes double the error")
    ax.get_legend().remove()
    return fig


def braking(key, q):
    """Return what a filter says of a car that brakes after a minute at 20 m/s, by 2 m/s², measured without error.

    The filter's gain varied first and is frozen. Rows are the seconds since the brake was touched, 0 ... 10. Columns
    are the position now, estimated, and that of `SECONDS` later, predicted: metres from where the car brakes.

    >>> braking("cv", 0.01)[5].round(1)  # the car is at 75 m, and will stand at 100 m
    array([ 78.9, 151.5])
    """
    model = table1.MODELS[key](table1.DT, q, table1.R)
    t = np.arange(-60, STANDS + 1)
    steps = FrozenLater(model, steps_to_freeze(model)).coefficients(len(t))
    x, said = np.zeros(model.n), []
    ahead = np.linalg.matrix_power(model.F, SECONDS)[0]
    for A, B, z in zip(steps.A, steps.B, road_of(t) - road_of(-60), strict=True):
        x = A @ x + B[:, 0] * z
        said.append([x[0], ahead @ x])
    return np.array(said)[t >= 0] + road_of(-60)


def road_of(t):
    """Return where the braking car is, metres from where it brakes, t seconds after that, up to the standstill.

    >>> road_of(np.array([-1, 0, 5, 10]))
    array([-20.,   0.,  75., 100.])
    """
    return 20.0 * t - np.maximum(t, 0) ** 2


def draw_braking():
    """Return a figure of the road of a braking car, and of what filters said of it five seconds before."""
    fig, axes = plots.panels([["road"]], height=3.8)
    ax = axes["road"]
    t = np.arange(STANDS + 1)
    shown = {
        ("cv", 0.01): ("velocity, q = 0.01", plots.COLOUR_OF["kalman"], "-", 2),
        ("ca", 0.0001): ("acceleration, q = 0.0001", plots.COLOURS[5], "--", -24),
        ("ca", 0.01): ("acceleration, q = 0.01", plots.COLOURS[2], "-", -3),
    }
    for (key, q), (name, colour, style, aside) in shown.items():
        said = braking(key, q)[: STANDS + 1 - SECONDS, 1]
        before = road_of(t[:SECONDS] - SECONDS) + 20.0 * SECONDS  # said before the brake: a steady car goes on
        (line,) = ax.plot(t, [*before, *said], style, color=colour, label=name)
        plots.label_line(line, f"{name}:\n{said[-1]:.0f} m", at=STANDS, xytext=(6, aside))
    (road,) = ax.plot(t, road_of(t), color=plots.COLOUR_OF["truth"], lw=2.4, label="the road")
    plots.label_line(road, f"the car: {road_of(STANDS):.0f} m", at=STANDS, xytext=(6, -14))
    reached = road_of(np.array([SECONDS]))[0]
    ax.plot([SECONDS] * 2, [reached, 20 * SECONDS], color="0.5", lw=1)
    ax.annotate(f"{20 * SECONDS - reached:.0f} m: nobody\ncan foresee it", (SECONDS, reached), (6, -28),
                textcoords="offset points", color="0.35")  # fmt: skip
    ax.set_xlim(0, STANDS + 7.5)  # room for the labels
    ax.set_xticks(range(0, STANDS + 1, 2))
    ax.set_ylim(0, 175)
    ax.set_ylabel("metres since the brake")
    plots.finish(ax, "seconds since the brake", "Five seconds ahead, one filter sees the standstill")
    ax.get_legend().remove()
    return fig


def draw_time_step():
    """Return a figure of σ of the predicted position, by seconds ahead, for three time steps."""
    fig, axes = plots.panels([["sigma"]], height=3.0)
    ax = axes["sigma"]
    colour = plots.COLOUR_OF["steady"]
    for dt, style, aside in zip(TIME_STEPS, (":", "-", "--"), (-9, -4, 1), strict=True):
        column = table1.columns(dt=dt)["cv"]
        seconds = np.arange(0, SECONDS + 0.25, 0.5)
        (line,) = ax.plot(seconds, settled_sigma(column, seconds), style, color=colour, label=f"Δt = {dt:g} s")
        ax.plot(dt, settled_sigma(column, [dt])[0], "o", color=colour, mfc="white", ms=7)
        plots.label_line(line, f"steps of {dt:g} s: {line.get_ydata()[-1]:.2f} m", at=SECONDS, xytext=(6, aside))
    ax.set_ylim(0, 0.75)
    ax.set_xlim(-0.2, SECONDS + 2.6)  # room for the labels
    ax.set_xticks(range(SECONDS + 1))
    ax.set_ylabel("σ of the position (m)")
    ax.annotate("circles: one step ahead", (2, settled_sigma(table1.columns(dt=2.0)["cv"], [2])[0]), (12, -34),
                textcoords="offset points", color=colour,
                arrowprops={"arrowstyle": "-", "color": "0.6"})  # fmt: skip
    plots.finish(ax, "seconds ahead", "Counted in seconds, the time step hardly matters")
    ax.get_legend().remove()
    return fig


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
