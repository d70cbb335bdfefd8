"""What the time step, the measurement noise and the motion do to the errors of 2016, for Sections 5.1 and 5.2."""

from functools import cache
from itertools import product

import numpy as np

from . import table1

SECONDS = 10_000  # of a run, as Table 1 is read
STEPS = 10_000  # for what is compared over as many steps
VARIED = {"dt": (0.5, 1.0, 2.0), "r": (0.05, 0.1, 0.2), "size": (0.5, 1.0, 2.0)}  # Δt, R and times the stated motion
WIDE = (0.001, 0.01, *VARIED["r"], 1.0, 10.0)  # variances of a measurement, m²
PARTS = ("estimation", "prediction")  # N = 0 and N = 1
# What judges each part: the measures of `measures`, after the start where they are σ.
NAMES = (
    {"sigma": "σ after the start", "average": "the average of Table 1"},
    {"sigma": "σ one second ahead", "step": "σ one step ahead", "average": "the average of Table 1"},
)
UNITS = {"sigma": ("m", 2), "step": ("m", 2), "average": ("%", 4)}  # and decimals


@cache
def measures(key, dt=table1.DT, r=table1.R, size=1.0):
    """Return errors of the estimate and of the prediction one step ahead, {measure: (2,)}.

    "sigma" is σ of the position after the start in metres, of the prediction one second ahead, and "step" is the same
    of the prediction one step ahead; "average" is that of Table 1 in percent, the mean of both axes over as much time.

    >>> measures("cv")["sigma"].round(3), measures("cv")["average"].round(4)
    (array([0.214, 0.278]), array([0.0111, 0.0141]))
    """
    column = table1.columns(dt, table1.Q, r, size)[key]
    average = 100 * table1.of_both_axes(column, round(SECONDS / dt))[:2]
    now, one_second, one_step = table1.settled_sigma(column, [0, 1, dt])
    return {"sigma": np.array([now, one_second]), "step": np.array([now, one_step]), "average": average}


def varied(key, what, N, measure, values=None):
    """Return a measure for the values of `VARIED`, or others, of one quantity, with all else as in the paper.

    >>> varied("cv", "dt", 0, "sigma").round(2)
    array([0.17, 0.21, 0.25])
    """
    return np.array([measures(key, **{what: value})[measure][N] for value in values or VARIED[what]])


def factor(values):
    """Return the largest value over the least."""
    return values.max() / values.min()


def table(key):
    """Return header and rows of the table of errors for three values of each quantity."""
    named = {"dt": "Δt = {:g}, {:g}, {:g} s", "r": "R = {:g}, {:g}, {:g} m²", "size": "motion × {:g}, {:g}, {:g}"}
    header = ["", *(name.format(*VARIED[what]) for what, name in named.items())]
    rows = []
    for N, part in enumerate(("estimate", "prediction")):
        for measure, name in NAMES[N].items():
            unit, decimals = UNITS[measure]
            cells = [", ".join(f"{each:.{decimals}f}" for each in varied(key, what, N, measure)) for what in VARIED]
            rows.append([f"{part}: {name} ({unit})", *cells])
    return header, rows


def claims(key, part):
    """Return what we find of three claims on a part, "estimation" or "prediction", as `Paper.claims` takes it."""
    N = PARTS.index(part)
    names = NAMES[N]
    by = {(what, measure): varied(key, what, N, measure) for what, measure in product(VARIED, names)}
    found = {}

    step, noise = ({measure: factor(by[what, measure]) for measure in names} for what in ("dt", "r"))
    holds = {"that it has no effect": bool(np.isclose(step["sigma"], 1))}
    less = {name: bool(step[measure] < noise[measure]) for measure, name in names.items()}
    if all(less.values()):
        holds["that it changes the errors less than the noise does"] = True
    else:
        holds |= {f"that it changes {name} less than the noise does": each for name, each in less.items()}
    told = [f"{name} by a factor of {step[each]:.2f} ({noise[each]:.2f})" for each, name in names.items()]
    evidence = f"A, B and σ contain it; from 0.5 to 2 s (in brackets: for four times R) it changes {', '.join(told)}"
    beyond = f"Over as many steps, not as much time, the average changes {over_as_many_steps(key, N):.1f}-fold."
    found[f"{key}.{part}.dt"] = holds, evidence, beyond

    growing = [np.diff(varied(key, "r", N, measure, WIDE)) > 0 for measure in names]
    evidence = f"all errors grow from R = {WIDE[0]} to {WIDE[-1]:g} m²"
    found[f"{key}.{part}.r"] = bool(np.all(growing)), evidence

    same = factor(by["size", "sigma"])
    evidence = (
        "A, B and σ do not contain it; the error of the start is in proportion to it, and the average of Table 1,"
    )
    evidence += f" which divides by the position, changes by a factor of {factor(by['size', 'average']):.2f} from half"
    evidence += " to double"
    beyond = f"The error of the start is {metres_of_the_start(key, N)}."
    found[f"{key}.{part}.motion"] = bool(np.isclose(same, 1, rtol=1e-9)), evidence, beyond
    return found


@cache
def over_as_many_steps(key, N):
    """Return the factor by which the average of Table 1 over as many steps changes with the time step."""
    columns = [table1.columns(dt=dt)[key] for dt in VARIED["dt"]]
    return factor(np.array([table1.of_both_axes(column, STEPS)[N] for column in columns]))


@cache
def metres_of_the_start(key, N):
    """Return in words the largest mean error of the start on the x axis, for the motions of `VARIED`."""
    largest = []
    for size in VARIED["size"]:
        column = table1.columns(size=size)[key]
        mean, _ = table1.mean_and_variance(column, 0, table1.TRANSIENT)
        largest.append(np.abs(mean[N]).max())
    return "{:.2g}, {:.2g} and {:.2g} m on x for half, once and twice the motion".format(*largest)


def satisfying(key):
    """Return what we find of the claim that the filter produces satisfying estimates, as `Paper.claims` takes it."""
    column = table1.columns()[key]
    sensor = np.sqrt(table1.R)
    sigma, average = measures(key)["sigma"][0], measures(key)["average"][0]
    raw = 100 * table1.average_of_measurements(column, STEPS)
    x, y = (np.sqrt(mean[0] ** 2 + variance[0]).max() for mean, variance in of_the_start(column))
    later = f"after step {caught_up(key)} the estimates are better than the measurements"
    holds = {
        f"{later} (σ = {sigma:.2f} m against {sensor:.2f} m)": bool(sigma < sensor),
        f"before that (they are off by up to {x:.2g} m on x and {y:.2g} m on y, rms)": bool(max(x, y) < sensor),
    }
    evidence = f"after the start {sensor / sigma:.1f} times better than a measurement, before that up to"
    evidence += f" {max(x, y) / sensor:.0f} times worse; in the average of Table 1 {average / raw:.1f} times worse"
    return holds, evidence


def caught_up(key):
    """Return the last step at which the mean absolute error of the estimate is not below that of a measurement.

    It is 0 if there is none.

    >>> caught_up("cv"), caught_up("ca")
    (13, 6)
    """
    raw = table1.expected_absolute(0.0, table1.R)
    worse = [
        table1.expected_absolute(mean[0], variance[0]) >= raw for mean, variance in of_the_start(table1.columns()[key])
    ]
    steps = np.flatnonzero(np.any(worse, axis=0)) + 1
    return int(steps.max(initial=0))


def of_the_start(column):
    """Return mean and variance of the errors of the first steps, for the axes x and y."""
    return [table1.mean_and_variance(column, axis, table1.TRANSIENT) for axis in (0, 1)]


def steps_ahead(key):
    """Return what we find of the claim on predictions some steps ahead, as `Paper.claims` takes it."""
    column = table1.columns()[key]
    average = table1.of_both_axes(column, STEPS)
    ratio = average[2:] / average[1]
    _, variance = table1.mean_and_variance(column, 0, 2 * table1.TRANSIENT)
    later = np.sqrt(variance[2:, -1] / variance[1, -1])
    four = "{:.2f}, {:.2f}, {:.2f} and {:.2f} times that one step ahead"
    evidence = f"the averages of Table 1 two to five steps ahead are {four.format(*ratio)} (we ask for less than 2); "
    evidence += f"in metres, after the start, up to {later.max():.1f} times"
    return bool(ratio.max() < 2), evidence, f"In metres, after the start, the errors are {four.format(*later)}."
