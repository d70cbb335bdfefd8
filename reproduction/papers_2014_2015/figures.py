"""The figures of 2014 and 2015 as their captions describe them, and below them the difference of their two lines."""

import numpy as np

from reproduction import plots
from reproduction.plots import COLOUR_OF

UNITS = {"position": "m", "velocity": "m/s"}  # of an axis, in the order of the state
MARKERS = {"x": "o", "y": "s", "z": "^"}  # of the axes, in the panels below


def draw_fig1(time_invariant, steady, sigma):
    """Return Figure 1 of both papers: estimates (N, 2 axes) of both groups of filters, and their first differences.

    sigma (2,) is what the settled filter states of its position and velocity.
    """
    solid = "solid line: KF/LF/JKLF", time_invariant, COLOUR_OF["kalman"]
    dashed = "dashed line: SSKF/SSLF/JSSKLF", steady, COLOUR_OF["steady"]
    return _draw(1, solid, dashed, sigma, shown=15)


def draw_fig2(steady, fir, sigma):
    """Return Figure 2 of 2014: estimates (N, 4) of the steady-state filters and of FIR, and their difference."""
    solid = "solid line: SSKF/SSLF", steady, COLOUR_OF["steady"]
    dashed = "dashed line: FIR SSKF/SSLF", fir, COLOUR_OF["fir"]
    return _draw(2, solid, dashed, sigma, shown=len(fir))


def _draw(number, solid, dashed, sigma, shown):
    """Draw two estimates, (label, array, colour) each, and below the second minus the first for `shown` steps."""
    (_, first, _), (_, second, colour) = solid, dashed
    steps, states = first.shape
    k = np.arange(1, steps + 1)
    axes = list(MARKERS)[: states // 2]
    fig, ax = plots.panels([[f"{part} {axis}" for part in UNITS] for axis in axes] + [list(UNITS)], height=1.8)
    for i, (part, unit) in enumerate(UNITS.items()):
        for j, axis in enumerate(axes):
            state, panel = 2 * j + i, ax[f"{part} {axis}"]
            for (label, estimates, of_line), style in ((solid, "-"), (dashed, "--")):
                panel.plot(k, estimates[:, state], style, color=of_line, label=label)
            panel.set_xlim(0, steps + 1)
            plots.finish(panel, "step k" if axis == axes[-1] else "", f"{part} {axis} ({unit})")
            gap = 100 * (second - first)[:shown, state]  # in centimetres
            sparse = {"marker": MARKERS[axis], "ms": 4, "markevery": max(shown // 12, 1)}
            ax[part].plot(k[:shown], gap, color=colour, lw=0.8, **sparse, label=axis)
        ax[part].axhspan(-10 * sigma[i], 10 * sigma[i], color="0.85", lw=0)  # a tenth of sigma, in centimetres
        plots.finish(ax[part], "step k", f"added: dashed − solid,\nc{unit}; grey: ± σ/10")
    plots.legend_below(ax["position x"], columns=1)
    for part in UNITS:
        low, high = ax[part].get_ylim()
        ax[part].set_ylim(low, high + 0.4 * (high - low))  # room for the legend
        ax[part].legend(loc="upper right", ncols=len(axes), handlelength=1.2, columnspacing=0.8, borderaxespad=0)
    plots.head(fig, f"Figure {number}, redrawn: estimates on a track of our own")
    return fig
