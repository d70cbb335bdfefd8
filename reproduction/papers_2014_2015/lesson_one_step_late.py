"""What the lesson `one_step_late` draws: a simulated walk and its picture."""

from dataclasses import replace

import numpy as np

import mpt_helpers as mpt
from reproduction import plots

PRINTED = mpt.gsm_axis(dt=1.0, q=0.01, r=0.1)  # Example 1 of the paper: H = [1 dt]
NOISE = np.sqrt(PRINTED.R[0, 0])  # sigma of a measured position (m)
UNKNOWN = 100 * np.eye(2)  # P(0/0) of a start that nobody knows: sigma of 10 m and 10 m/s
WRONG, RIGHT, BAND = plots.COLOUR_OF["wrong"], plots.COLOUR_OF["kalman"], "0.87"


def walk(rows, push=0.1, tracks=None, seed=1):
    """Simulate walks on one axis: true and measured positions, once a second.

    The speed begins at 1.5 m/s, and a push changes it evenly over each second: in that second the walker goes at the
    mean of the old and the new speed.

    Parameters
    ----------
    rows : int
        Number of seconds.
    push : float
        Standard deviation of a push (m/s).
    tracks : int, optional
        Number of walks; without it, one walk and arrays of one dimension.
    seed : int
        Seed of the random numbers.

    Returns
    -------
    true, measured : ndarray, (rows,) or (rows, tracks)
        Positions in metres; the error of a measured one has a variance of 0.1 m².

    Examples
    --------
    >>> true, measured = walk(60)
    >>> true.shape, float(round(true[-1] / 60, 1))
    ((60,), 1.5)

    """
    rng = np.random.default_rng(seed)
    shape = () if tracks is None else (tracks,)
    speed = 1.5 + np.cumsum(rng.normal(0, push, (rows, *shape)), axis=0)
    before = np.concatenate([np.full((1, *shape), 1.5), speed[:-1]])
    true = np.cumsum((before + speed) / 2, axis=0)
    return true, true + rng.normal(0, NOISE, true.shape)


def draw_late():
    """Return a figure of a walk: the errors of the printed and of the right filter, and the innovations of the first.

    Both filters start from a position and a speed that nobody knows; the first two seconds are left out.
    """
    true, measured = walk(60)
    late, right = (mpt.KalmanFilter(replace(PRINTED, H=H, P0=UNKNOWN)) for H in ([[1, 1]], [[1, 0]]))
    sigma = np.sqrt(late.covariances(60)[:, 0, 0])
    new = mpt.metrics.innovations(late, measured[:, None])
    surprises = new.values[:, 0] / np.sqrt(new.S[:, 0, 0])
    shown = slice(2, None)
    second = np.arange(1, 61)[shown]
    fig, ax = plots.panels([["error"], ["surprises"]], height=2.3)
    ax["error"].fill_between(second, -2 * sigma[shown], 2 * sigma[shown], color=BAND, lw=0)
    ax["error"].axhline(0, color="0.4", lw=1)
    errors = {kf: (kf.filter(measured[:, None])[:, 0] - true)[shown] for kf in (late, right)}
    (late_line,) = ax["error"].plot(second, errors[late], color=WRONG)
    (right_line,) = ax["error"].plot(second, errors[right], "--", lw=1.2, color=RIGHT)
    plots.label_line(late_line, "paper's filter, H = [1 1]", at=59, xytext=(0, -27), ha="right")
    plots.label_line(right_line, "right filter, H = [1 0]", at=3, xytext=(0, 22))
    ax["error"].annotate("grey: ± 2σ of the paper's filter", (60, 0.6), ha="right", va="bottom", color="0.3")
    ax["error"].set_ylim(-2.9, 1.3)
    ax["surprises"].axhspan(-2, 2, color=BAND, lw=0)
    ax["surprises"].plot(second, surprises[shown], ".-", lw=0.8, color=WRONG)
    ax["surprises"].set_ylim(-3.5, 3.5)
    plots.finish(ax["error"], "", "reported minus true position (m)")
    plots.finish(ax["surprises"], "second", "surprises of the paper's filter, over their σ; grey: ± 2")
    fig.suptitle(
        "Fed with positions of now, the paper's filter\nis nine σ off. In a minute its test sees nothing.",
        weight="bold",
    )
    return fig
