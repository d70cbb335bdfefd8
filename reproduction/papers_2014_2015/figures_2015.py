"""The figure of the paper of 2015, as its caption describes it, and below it what the paper does not have."""

import numpy as np

from reproduction import plots

KALMAN, STEADY = plots.COLOUR_OF["kalman"], plots.COLOUR_OF["steady"]
AXES = {"x": 0, "y": 2, "z": 4}  # where the position of an axis stands in the state; its velocity follows
UNITS = {"position": "m", "velocity": "m/s"}


def draw_fig1(kf, sskf, sigma, shown=15):
    """Return Figure 1: position and velocity estimates of three axes, and below them the difference of both groups.

    kf and sskf (N, 6) are the estimates of the time-invariant and of the steady-state filters, sigma (2,) what the
    settled filter states of its position and velocity. The difference is drawn for as many steps as are `shown`.
    """
    plots.use_style()
    layout = [[f"{name} {axis}" for name in UNITS] for axis in AXES] + [list(UNITS)]
    fig, ax = plots.panels(layout, height=1.75)
    k = np.arange(1, len(kf) + 1)
    for i, (name, unit) in enumerate(UNITS.items()):
        for axis, place in AXES.items():
            panel = ax[f"{name} {axis}"]
            panel.plot(k, kf[:, place + i], "-", color=KALMAN, lw=2.2, label="solid line: KF/LF/JKLF")
            panel.plot(k, sskf[:, place + i], "--", color=STEADY, lw=1.4, label="dashed line: SSKF/SSLF/JSSKLF")
            panel.set_xlim(0, k[-1] + 1)
            plots.finish(panel, "step k" if axis == "z" else "", f"{name} {axis} ({unit})")
            ax[name].plot(k[:shown], 100 * (sskf - kf)[:shown, place + i], ".-", color=STEADY, lw=0.8)
        ax[name].axhspan(-10 * sigma[i], 10 * sigma[i], color="0.85", lw=0)  # a tenth of sigma, in centimetres
        plots.finish(ax[name], "step k", f"ours: dashed minus solid,\nc{unit}; grey: ± σ/10")
    plots.legend_below(panel, columns=1)
    fig.suptitle("Figure 1: position and velocity estimates", x=0.02, ha="left", weight="bold")
    return fig
