"""The drawing of the lesson on a car that brakes: how far the package's filters miss, five seconds ahead."""

import numpy as np

from mpt_helpers.kalman import KalmanFilter
from mpt_helpers.model import constant_acceleration, constant_velocity
from reproduction import plots

SPEED, R, SECONDS = 20.0, 0.1, 5.0  # of the car (m/s); variance of a position (m²), one a second; how far ahead
FILTERS = {
    "velocity, q = 0.01": constant_velocity(1.0, 0.01, R, P0=1e4 * np.eye(2)),
    "velocity, q = 1": constant_velocity(1.0, 1.0, R, P0=1e4 * np.eye(2)),
    "acceleration, q = 0.01": constant_acceleration(1.0, 0.01, R, P0=1e4 * np.eye(3)),
}
BRAKES = {"to a standstill": np.inf, "let go after 3 s": 3.0}  # how long a brake of 2 m/s² lasts (s)


def road(t, brake, lasting=np.inf):
    """Return the metres beyond the point where the brake is touched at second 0; it is let go after `lasting` seconds.

    >>> print(road(np.array([-1.0, 1.0, 5.0, 20.0]), brake=4.0))
    [-20.  18.  50.  50.]
    """
    end = min(lasting, SPEED / brake)
    before, braking, after = np.minimum(t, 0), np.clip(t, 0, end), np.maximum(t - end, 0)
    return SPEED * before + SPEED * braking - brake * braking**2 / 2 + (SPEED - brake * end) * after


def misses(model, brake, lasting=np.inf, stops=True):
    """Return how far each prediction lies beyond the true position (m), (11,): those made at seconds 0 to 10.

    The measurements have no error. With `stops` no predicted speed falls below zero.

    >>> print(misses(FILTERS["velocity, q = 1"], 2.0)[[0, 5, 10]].round())
    [25. 30.  5.]
    """
    t = np.arange(-60, 11)
    x = KalmanFilter(model).filter(road(t, brake, lasting)[:, None] - road(-60, brake))[t >= 0]
    s, v, a = [*x.T, np.zeros(len(x))][:3]
    moving = np.full(len(x), SECONDS)
    if stops:
        slows = a < 0
        moving[slows] = np.minimum(SECONDS, v[slows] / -a[slows])
        moving[v <= 0] = 0
    return s + v * moving + a * moving**2 / 2 - (road(t[t >= 0] + SECONDS, brake, lasting) - road(-60, brake))


def draw_braking():
    """Return a figure of `misses` for a brake of 2 m/s² that ends in a standstill, and for one that is let go."""
    velocity, acceleration = plots.COLOUR_OF["kalman"], plots.COLOUR_OF["acceleration"]
    styles = [(velocity, ":"), (velocity, "-"), (acceleration, "-")]
    fig, axes = plots.panels([list(BRAKES)], height=3.9)
    axes["let go after 3 s"].sharey(axes["to a standstill"])
    for (name, lasting), ax in zip(BRAKES.items(), axes.values(), strict=True):
        for (filter_name, model), (colour, style) in zip(FILTERS.items(), styles, strict=True):
            ax.plot(misses(model, 2.0, lasting), style, color=colour, marker=".", label=filter_name)
        if name == "to a standstill":
            backwards = misses(model, 2.0, lasting, stops=False)
            ax.plot(backwards, "--", color=acceleration, marker=".", label="the same, if it may drive backwards")
        ax.axhline(0, color="0.4", lw=1.0)
        if np.isfinite(lasting):
            ax.axvline(lasting, color="0.6", ls=":", lw=1.0)
            ax.annotate("let go", (lasting, 0.96), (4, 0), xycoords=("data", "axes fraction"),
                        textcoords="offset points", va="top", color="0.4")  # fmt: skip
        plots.finish(ax, "seconds since the touch", f"2 m/s², {name}")
        ax.get_legend().remove()
    first = axes["to a standstill"]
    first.set_ylabel(f"predicted {SECONDS:g} s ahead,\nbeyond the true position (m)")
    fig.legend(*first.get_legend_handles_labels(), loc="outside lower center", ncols=1)
    fig.suptitle("Which filter misses less depends on the driver", x=0.02, ha="left", weight="bold")
    return fig


def draw_border(errors):
    """Draw the typical error of both filters over how long the driver brakes, a panel for each strength of the brake.

    errors has for each strength (m/s²) the seconds (lengths,) of brakes that are let go, and of both filters, velocity
    and acceleration, the errors of these (lengths,) and of a stop.
    """
    colours = {"velocity": plots.COLOUR_OF["kalman"], "acceleration": plots.COLOUR_OF["acceleration"]}
    fig, axes = plots.panels([[f"{brake:g} m/s²" for brake in list(errors)[i : i + 2]] for i in (0, 2)], height=2.4)
    fig.suptitle("The velocity filter wins if the driver lets go early", x=0.02, ha="left", fontsize=12)
    for ax, (lengths, *both) in zip(axes.values(), errors.values(), strict=True):
        stop = lengths[-1] + 1.5
        for (name, colour), (let_go, of_stop) in zip(colours.items(), both, strict=True):
            ax.plot(lengths, let_go, ".-", color=colour, label=name)
            ax.plot([stop], [of_stop], "s", color=colour)
        ticks = [each for each in lengths if each % 2 == 1]
        ax.set_xticks([*ticks, stop], [*(f"{each:g}" for each in ticks), "stop"])
        ax.set_ylim(bottom=0)
    for name, ax in axes.items():
        plots.finish(ax, "seconds of braking", f"error (m), brake of {name}")
    plots.legend_below(next(reversed(axes.values())), 2)
    return fig
