"""The drawing of the lesson on freezing a filter: its start."""

from dataclasses import replace

import numpy as np

from mpt_helpers.kalman import KalmanFilter
from mpt_helpers.model import constant_velocity
from mpt_helpers.steady import SteadyStateFilter
from reproduction import plots

SPEED, Q, R = 20.0, 0.01, 0.1  # of the car (m/s); the paper's noises at constant velocity, one measurement a second
UNKNOWN = 1e4 * np.eye(2)  # the covariance of a start of which nothing is known


def typical_errors(steps=25, after=8):
    """Return the rms position error of a car that nothing pushes, (steps,) of two filters, exact and without a seed.

    The first is frozen at once and guesses that the car rests at zero, as the paper's. The second works
    through the lesson's list: its gain varies from a start of which nothing is known and has its limit at step `after`
    and from there on. It is given as the limit of ever wider starts, so that the guess no longer matters.

    >>> at_once, later = typical_errors()
    >>> print(at_once[:3].round(1), later[[0, 24]].round(2))
    [ 9.  11.2  9.8] [0.32 0.21]
    """
    model = constant_velocity(1.0, Q, R)
    settled = SteadyStateFilter.from_kalman(model).B
    varying = KalmanFilter(replace(model, P0=UNKNOWN)).coefficients(after - 1).B
    at_rest = np.array([0.0, -SPEED]), np.zeros((2, 2))
    return [
        rms_errors(model, gains, *at_rest)
        for gains in ([settled] * steps, [*varying, *[settled] * (steps - after + 1)])
    ]


def rms_errors(model, gains, off, P):
    """Return the rms position error after each of the gains, of a car that nothing pushes.

    off (2,) is the mean error of the start, estimate minus truth, and P (2, 2) its covariance.
    """
    F, H, R, rms = model.F, model.H, model.R, []
    for K in gains:
        left = np.eye(2) - K @ H
        off, P = left @ F @ off, left @ F @ P @ F.T @ left.T + K @ R @ K.T
        rms.append(np.sqrt(off[0] ** 2 + P[0, 0]))
    return np.array(rms)


def errors_from_two_measurements(r=R, steps=25):
    """Return the rms position error (steps,) of the filter that is frozen at once, begun on the line through two fixes.

    r is the variance of a measurement; the first step has the error of one measurement.

    >>> print(errors_from_two_measurements()[:4].round(2), errors_from_two_measurements(100.0).max().round())
    [0.32 0.32 0.36 0.34] 60.0
    """
    model = constant_velocity(1.0, Q, r)
    settled = SteadyStateFilter.from_kalman(model).B
    P = r * np.array([[1.0, 1.0], [1.0, 2.0]])  # of z(2), z(2) - z(1)
    one = np.sqrt(r)
    return np.array([one, one, *rms_errors(model, [settled] * (steps - 2), np.zeros(2), P)])


def draw_start(steps=25):
    """Return a figure of `typical_errors` and `errors_from_two_measurements`, on a logarithmic axis."""
    at_once, later = typical_errors(steps)
    k = np.arange(1, steps + 1)
    fig, axes = plots.panels([["error"]], height=3.4)
    ax = axes["error"]
    measured = ax.axhline(np.sqrt(R), color=plots.COLOUR_OF["measured"], ls=":", label="one measurement")
    (frozen,) = ax.semilogy(k, at_once, color=plots.COLOUR_OF["steady"], label="frozen at once, as in the paper")
    (varying,) = ax.semilogy(k, later, color=plots.COLOUR_OF["kalman"], ls="--", label="the gain varies first")
    two = errors_from_two_measurements(steps=steps)
    ax.semilogy(k, two, color=frozen.get_color(), ls="-.", lw=1.2, label="begun on two measurements")
    ax.set_ylim(0.1, 20)
    ax.set_yticks([0.1, 0.3, 1, 3, 10], ["0.1", "0.3", "1", "3", "10"])
    ax.minorticks_off()
    zero = at_once[:10].argmin()
    crossing = f"at step {k[zero]} its mean error\npasses through zero"
    ax.annotate(crossing, (k[zero], at_once[zero]), (2, 52), textcoords="offset points", color=frozen.get_color(),
                arrowprops={"arrowstyle": "-", "color": "0.6", "relpos": (0, 0)})  # fmt: skip
    plots.label_line(varying, f"the gain varies first: settles at {later[-1]:.2f} m", at=5, xytext=(0, -26))
    ax.annotate("one measurement: 0.32 m", (steps, np.sqrt(R)), (0, 5), textcoords="offset points", ha="right",
                color=measured.get_color())  # fmt: skip
    ax.annotate("begun on two", (3, two[2]), (-28, 8), textcoords="offset points", color=frozen.get_color())
    ax.set_ylabel("typical error at 20 m/s (m)")
    plots.label_line(frozen, f"frozen at once: up to {at_once.max():.0f} m off", at=3, xytext=(10, 4))
    plots.finish(ax, "measurements so far", f"Let the gain vary first, or be up to {at_once.max():.0f} m off")
    ax.get_legend().remove()
    return fig
