"""The style of figures: colours, panels, labels and legends."""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from mpt_helpers.tracks.style import COLOURS, STYLE

# One colour for one filter, in every figure, and one for what is wrong. Kalman and Lainiotis are one estimate.
COLOUR_OF = {
    "kalman": COLOURS[0],
    "lainiotis": COLOURS[0],
    "steady": COLOURS[1],
    "fir": COLOURS[2],
    "predictor": COLOURS[3],
    "line": COLOURS[4],
    "acceleration": COLOURS[5],  # a Kalman filter that knows the acceleration, beside one that does not
    "wrong": "#B8251D",
    "measured": "0.55",
    "truth": "black",
}


def use_style() -> None:
    """Give all figures made from now on the style of this project."""
    matplotlib.rcParams.update(STYLE)


def panels(layout: list[list[str]], height: float = 2.3, width: float = 5.2) -> tuple[Figure, dict[str, Axes]]:
    """Return a figure in the style of this project, and its axes by name.

    layout is a list of rows of names; a name that stands twice spans both places. height is that of a row and width
    that of the figure, in inches.

    >>> fig, ax = panels([["s_x", "s_y"], ["gap", "gap"]])
    >>> sorted(ax)
    ['gap', 's_x', 's_y']
    """
    use_style()
    fig = Figure(figsize=(width, height * len(layout)), layout="constrained")
    return fig, fig.subplot_mosaic(layout)


def head(fig: Figure, text: str) -> None:
    """Say above a figure which one it is, such as "Figure 1: position estimation"."""
    fig.suptitle(text, x=0.02, ha="left", weight="bold", fontsize="medium")


def finish(ax: Axes, xlabel: str, title: str) -> None:
    """Label the x axis, say above the axes what they show, and name the curves in a legend if they have labels."""
    ax.set_xlabel(xlabel)
    ax.set_title(title, loc="left")
    if ax.get_legend_handles_labels()[0]:
        ax.legend()
    if isinstance(ax.xaxis.get_major_locator(), MaxNLocator) and np.ptp(ax.get_xlim()) > 2:
        ax.xaxis.get_major_locator().set_params(integer=True)


def label_line(line: Line2D, text: str, at: float, **placing: Any) -> None:
    """Write a text in a line's own colour at its point whose x is nearest to `at`, in place of a legend.

    placing goes to `Axes.annotate`: xytext (in points, from the line), ha, va.

    >>> fig, ax = panels([["a"]])
    >>> (line,) = ax["a"].plot([0, 1, 2], [0, 1, 4])
    >>> label_line(line, "Kalman", at=1.2, xytext=(4, -4))
    >>> ax["a"].texts[0].xy
    (1.0, 1.0)
    """
    x, y = np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)
    nearest = np.nanargmin(np.abs(x - at))
    placing = {"xytext": (0, 4), "textcoords": "offset points", "color": line.get_color()} | placing
    line.axes.annotate(text, (float(x[nearest]), float(y[nearest])), **placing)


def legend_below(ax: Axes, columns: int) -> None:
    """Replace the legends of all panels by one of these axes' curves, below the figure and in this many columns."""
    for panel in ax.figure.axes:
        if panel.get_legend():
            panel.get_legend().remove()
    ax.figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=columns)
