"""Figures 1 to 4 of 2016 as the paper describes them, with their errors below, and Table 1 as a picture."""

import numpy as np

from .. import plots
from . import table1

STEPS = 30  # of a run; the paper does not print how many
CAUGHT_UP = 13  # steps; those after them are drawn on a scale of their own
NUMBERS = {("cv", 0): 1, ("cv", 1): 2, ("ca", 0): 3, ("ca", 1): 4}  # of the figures, by motion and steps ahead


def draw_figure(key, N, seed):
    """Return Figure 1 (key "cv", N = 0), 2 ("cv", 1), 3 ("ca", 0) or 4 ("ca", 1), and its errors on both axes.

    Above is the track in the plane: the real position and the estimate (N = 0) or the one-step prediction (N = 1).
    Below are real minus estimated position, in two panels for two scales; bands are their mean ± 2σ, exact.
    """
    column = table1.columns()[key]
    k = np.arange(1, STEPS + 1)
    shown = {0: ("estimation", "estimate", "steady"), 1: ("prediction", "one-step prediction", "predictor")}
    what, name, filter_ = shown[N]
    colour = plots.COLOUR_OF[filter_]
    fig, ax = plots.panels([["plane", "plane"], ["start", "later"]], height=3.0)

    real, found = [], []
    for axis, (label, style) in enumerate((("x", "-"), ("y", "--"))):
        e, s = table1.errors(column, axis, 0.0, np.random.default_rng([seed, axis]), 1)
        e, s = e[N, :STEPS, 0], s[N, :STEPS, 0]
        real.append(s)
        found.append(s - e)
        mean, variance = table1.mean_and_variance(column, axis, STEPS)
        low, high = (mean[N] + factor * np.sqrt(variance[N]) for factor in (-2, 2))
        for panel, some in (("start", slice(0, CAUGHT_UP)), ("later", slice(CAUGHT_UP, None))):
            band = "_mean ± 2σ" if axis else "mean ± 2σ"  # in the legend once
            ax[panel].fill_between(k[some], low[some], high[some], color=colour, alpha=0.12, lw=0, label=band)
            ax[panel].plot(k[some], e[some], style, color=colour, label=label)

    plots.finish(ax["start"], "step k", "added: error (m) at first")
    plots.finish(ax["later"], "step k", "added: error (m), later")
    plots.legend_below(ax["start"], 3)

    ax["plane"].plot(*real, "o-", color=plots.COLOUR_OF["truth"], ms=6, mfc="white", label="real position")
    ax["plane"].plot(*found, "x--", color=colour, ms=5, label=name)
    ax["plane"].set_ylabel("y (m)")
    plots.finish(ax["plane"], "x (m)", "")
    plots.head(fig, f"Figure {NUMBERS[key, N]}, redrawn: {what}, {table1.NAMES[key]}")
    return fig


def draw_table1():
    """Return a figure of Table 1: printed, computed, and of the same filter if it had settled before the first step."""
    fig, ax = plots.panels([["cv", "ca"]], height=3.2)
    steps = 10_000
    for key, column in table1.columns().items():
        panel = ax[key]
        measured = table1.average_of_measurements(column, steps)
        steady, grey = plots.COLOUR_OF["steady"], plots.COLOUR_OF["measured"]
        panel.semilogy(column.printed, "o", color="black", ms=5, label="printed in the paper")
        panel.semilogy(100 * table1.of_both_axes(column, steps), "-", color=steady, label="computed: starts at rest")
        settled = 100 * table1.settled_averages(column, steps)
        panel.semilogy(settled, "--", color=steady, label="had it settled before")
        panel.semilogy(0, 100 * measured, "s", color=grey, label="bare measurements")
        panel.set_ylim(5e-4, 3e-2)
        panel.set_yticks([1e-3, 1e-2], ["0.001", "0.01"])
        plots.finish(panel, "steps ahead N", table1.NAMES[key])
    ax["cv"].set_ylabel("average error (%)")
    plots.legend_below(ax["cv"], 2)
    plots.head(fig, "Table 1 as a picture (ours)")
    return fig
