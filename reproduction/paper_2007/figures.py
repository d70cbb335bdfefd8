"""The six figures of the paper of 2007, as its text and captions describe them; what is ours stands in panels below."""

import numpy as np

from reproduction import plots

MEASURED = {"color": plots.COLOUR_OF["measured"], "lw": 1.0}


def draw_fig1(one, skies):
    """Draw Figure 1: the error of the rough position over the iteration, by each start; below it that of many skies.

    one has for each start, by its name, the errors (steps + 1,), skies those under many skies (steps + 1, M).
    """
    fig, ax = _panels([list(one), ["many"] * len(one)], "Figure 1, redrawn: a rough position by least squares", 2.4)
    colour = plots.COLOUR_OF["line"]
    for (name, error), style in zip(one.items(), ("-", "--", ":"), strict=True):
        ax[name].plot(error / 1e3, f"o{style}", ms=4, color=colour)
        plots.finish(ax[name], "step", f"error (km),\n{name}")
        errors = skies[name]
        ax["many"].fill_between(
            range(len(errors)), errors.min(axis=1), errors.max(axis=1), color=colour, alpha=0.2, lw=0
        )
        ax["many"].plot(np.median(errors, axis=1), style, color=colour, label=name)
    ax["many"].set_yscale("log")
    plots.finish(
        ax["many"], "step of the iteration", f"added: error (m), median and range of {errors.shape[1]:,} skies"
    )
    return fig


def draw_fig2(one, skies, same):
    """Draw Figure 2: the error from a precise start, (steps + 1,), and below it what remains under many skies.

    skies (steps + 1, M) has new ranges at each step, same (steps + 1, M) one set of ranges for all steps.
    """
    fig, ax = _panels([["one"], ["many"]], "Figure 2, redrawn: from precise coordinates", 2.4)
    ax["one"].plot(one, "-", color=plots.COLOUR_OF["line"])
    ax["one"].set_ylim(0)
    plots.finish(ax["one"], "step of the iteration", "error of the position (m)")
    for label, errors, style in (("new ranges at each step", skies, "-"), ("one set of ranges", same, "--")):
        rms = np.sqrt(np.mean(errors**2, axis=1))
        ax["many"].plot(rms, style, color=plots.COLOUR_OF["line"], label=label)
    ax["many"].set_ylim(0)
    plots.finish(ax["many"], "step of the iteration", f"added: rms error (m), {skies.shape[1]:,} skies")
    return fig


def draw_line(number, t, x, measured, estimates, sigma):
    """Draw Figure 3 or 4: measured and estimated x, below it the estimated velocity, and below these the error of x.

    x (N, 2) is the true position and velocity, measured (N,) the positions, estimates (N, 2) the newest point of the
    line through all points so far and its velocity, sigma (N,) the standard deviation of that point.
    """
    speed = x[0, 1]
    fig, ax = _panels([["x"], ["V"], ["error"]], f"Figure {number}, redrawn: line fit (MMS), V = {speed:g} m/s", 2.0)
    _tracks(ax, t, x, measured, estimates, plots.COLOUR_OF["line"])
    _error(ax["error"], t, estimates[:, 0] - x[:, 0], sigma, plots.COLOUR_OF["line"])
    return fig


def draw_kalman(number, t, x, measured, estimates, sigma):
    """Draw Figure 5 or 6: measured and estimated x, below it the estimated velocity; then INS error, and error of x.

    x (N, 3) is the true position, velocity and constant error of the INS, measured (N,) the positions by GPS, estimates
    (N, 3) those of the filter, sigma (N,) what it states for the position.
    """
    layout = [["x", "x"], ["V", "V"], ["b", "error"]]
    fig, ax = _panels(layout, f"Figure {number}, redrawn: Kalman filter with INS, V = {x[0, 1]:g} m/s", 2.0)
    colour = plots.COLOUR_OF["kalman"]
    _tracks(ax, t, x, measured, estimates, colour)
    ax["b"].plot(t, x[:, 2], ":", color=plots.COLOUR_OF["truth"])
    ax["b"].plot(t, estimates[:, 2], "--", color=colour)
    ax["b"].set_xlim(0, t[-1])
    plots.finish(ax["b"], "time (s)", "added: INS error (m/s)")
    _error(ax["error"], t, estimates[:, 0] - x[:, 0], sigma, colour)
    return fig


def _tracks(ax, t, x, measured, estimates, colour):
    ax["x"].plot(t, measured, "-", **MEASURED, label="measured $x_m$")
    ax["x"].plot(t, estimates[:, 0], "--", color=colour, label="estimated $x_e$")
    ax["x"].plot([], [], ":", color=plots.COLOUR_OF["truth"], label="true")
    ax["V"].plot(t, x[:, 1], ":", color=plots.COLOUR_OF["truth"])
    ax["V"].plot(t, estimates[:, 1], "--", color=colour)
    settled = estimates[len(t) // 5 :, 1]
    ax["V"].set_ylim(settled.min() - np.ptp(settled), settled.max() + np.ptp(settled))  # the start would hide the rest
    for name, title in {"x": "coordinate x (m)", "V": "velocity (m/s)"}.items():
        ax[name].set_xlim(0, t[-1])
        plots.finish(ax[name], "", title)
    plots.legend_below(ax["x"], 3)


def _error(panel, t, error, sigma, colour):
    panel.fill_between(t, -2 * sigma, 2 * sigma, color="0.85", lw=0)
    panel.plot(t, error, "-", color=colour)
    panel.set_xlim(0, t[-1])
    plots.finish(panel, "time (s)", "added: error of x (m), ± 2σ")


def _panels(layout, title, height):
    fig, ax = plots.panels(layout, height=height)
    plots.head(fig, title)
    return fig, ax
