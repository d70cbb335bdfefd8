"""Figures 1 and 2 of 2014 as its captions describe them, each with the difference of its two lines below."""

import numpy as np

from reproduction import plots
from reproduction.plots import COLOUR_OF

CENTIMETRES = 100  # in a metre
GREY = "0.87"
STATE = {"position x": "m", "velocity x": "m/s", "position y": "m", "velocity y": "m/s"}  # in its order


def draw_fig1(time_invariant, steady, sigma):
    """Return Figure 1: estimates (N, 4) of both groups of filters, and their difference beside sigma.

    sigma is what the settled filter states as the error of the position, in metres.
    """
    lines = {"solid line: KF/LF/JKLF": (time_invariant, "kalman"), "dashed line: SSKF/SSLF/JSSKLF": (steady, "steady")}
    places = {"x": (1, (7, -3)), "y": (4, (8, 0))}
    return _draw("Figure 1", lines, sigma, places)


def draw_fig2(steady, fir, sigma):
    """Return Figure 2: estimates (N, 4) of the steady-state filters and of FIR, and their difference beside sigma."""
    lines = {"solid line: SSKF/SSLF": (steady, "steady"), "dashed line: FIR SSKF/SSLF": (fir, "fir")}
    places = {"x": (48, (0, -15)), "y": (48, (0, 7))}
    return _draw("Figure 2", lines, sigma, places)


def _draw(name, lines, sigma, places):
    """Draw a figure: two estimates, {label: (array, name of its colour)}, and below the second minus the first.

    places says for each axis, "x" and "y", at which step its label stands, and how many points from the line.
    """
    layout = [["position x", "position y"], ["velocity x", "velocity y"], ["gap", "gap"]]
    fig, ax = plots.panels(layout, height=1.9)
    k = np.arange(1, 1 + len(next(iter(lines.values()))[0]))
    for i, (part, unit) in enumerate(STATE.items()):
        for (label, (estimates, colour)), style in zip(lines.items(), ("-", "--"), strict=True):
            ax[part].plot(k, estimates[:, i], style, color=COLOUR_OF[colour], label=label)
        plots.finish(ax[part], "step k" if "velocity" in part else "", f"{part} ({unit})")
    (first, _), (second, colour) = lines.values()
    ax["gap"].axhspan(-sigma / 10 * CENTIMETRES, sigma / 10 * CENTIMETRES, color=GREY, lw=0)
    for axis, column, style in (("x", 0, "-"), ("y", 2, ":")):
        gap = CENTIMETRES * (second - first)[:, column]
        (line,) = ax["gap"].plot(k, gap, style, color=COLOUR_OF[colour])
        at, xytext = places[axis]
        plots.label_line(line, axis, at=at, xytext=xytext)
    ax["gap"].margins(y=0.15)
    plots.finish(ax["gap"], "step k", "Ours: dashed minus solid, position (cm). Grey: ± σ/10")
    plots.legend_below(ax["velocity x"], columns=1)
    fig.suptitle(f"{name}: position and velocity estimation", weight="bold")
    return fig
