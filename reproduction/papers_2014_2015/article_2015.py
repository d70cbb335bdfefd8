"""The drawings of the notebook on 2015."""

import numpy as np

from mpt_helpers import plots
from mpt_helpers.filters import KalmanFilter
from mpt_helpers.model import gsm_axis, stack

AXIS = gsm_axis(dt=1.0, q=0.01, r=0.1)  # the paper's example


def draw_lost_axis(steps=60, last=30):
    """Return a figure of the sigma of the position on each axis; z is measured up to step `last` and then lost."""
    missing = np.zeros((steps, 3))  # a covariance does not depend on what is measured, only on what is missing
    missing[last:, 2] = np.nan
    P = KalmanFilter(stack(AXIS, AXIS, AXIS)).covariances(missing)
    sigma = np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    k = np.arange(1, steps + 1)
    fig, ax = plots.panels([["sigma"]], height=2.8)
    ax["sigma"].semilogy(k, sigma[:, 4], "C1-", label=f"z, lost after step {last}")
    ax["sigma"].semilogy(k, sigma[:, 0], "C0-", label="x and y")
    for i, (dx, dy) in {4: (-4, 2), 0: (-4, 6)}.items():
        text = f"{sigma[-1, i]:.3g} m"
        ax["sigma"].annotate(text, (k[-1], sigma[-1, i]), (dx, dy), textcoords="offset points", ha="right", va="bottom")
    ax["sigma"].set_ylim(0.03, 30)
    plots.finish(ax["sigma"], "step k", "σ of the position (m)")
    return fig


def draw_fig1(x, kf, sskf):
    """Return the paper's Figure 1: true states (N, 6), the estimates of both groups, and their first gaps."""
    layout = [[f"position {i}", f"velocity {i}"] for i in "xyz"] + [["gap", "gap"]]
    fig, ax = plots.panels(layout, height=1.6)
    k = np.arange(1, len(x) + 1)
    for i, name in enumerate(name for row in layout[:3] for name in row):
        lines = ax[name].plot(k, x[:, i], "0.7", k, kf[:, i], "C0-", k, sskf[:, i], "C1--")
        lines[0].set_linewidth(4)
        plots.finish(ax[name], "", f"{name} ({'m/s' if 'velocity' in name else 'm'})")
    for i, name in enumerate("xyz"):
        ax["gap"].plot(k[:15], (kf - sskf)[:15, 2 * i], ".-", label=name)
    plots.finish(ax["gap"], "step k", "KF - SSKF, position (m)")
    ax["gap"].legend(loc="upper right", ncols=3)
    fig.legend(lines, ["true", "KF/LF/JKLF", "SSKF/SSLF/JSSKLF"], loc="outside lower center", ncols=3)
    return fig
