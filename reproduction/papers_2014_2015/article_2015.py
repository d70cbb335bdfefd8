"""The drawings of the notebook on 2015, and the answers to its exercises."""

import numpy as np
from matplotlib.colors import ListedColormap

from mpt_helpers import plots
from mpt_helpers.filters import KalmanFilter
from mpt_helpers.model import LinearModel, gsm_axis, simulate, stack

PAPER = gsm_axis(dt=1.0, q=0.01, r=0.1)  # the paper's example: H = [1 1], the position one step ahead
AXIS = LinearModel(F=PAPER.F, H=[[1, 0]], Q=PAPER.Q, R=PAPER.R)  # the same axis, measured where it is
KALMAN, STEADY = plots.COLOUR_OF["kalman"], plots.COLOUR_OF["steady"]


def covariance(steps=60):
    """Return P (6, 6) of the six-state filter for three axes, after so many steps from a known start.

    >>> int(np.count_nonzero(covariance()))
    12
    """
    return KalmanFilter(stack(AXIS, AXIS, AXIS)).covariances(steps)[-1]


def draw_covariance():
    """Return a figure of the entries of P, (6, 6): which are zero, and the numbers of the others."""
    P = covariance()
    names = [rf"${kind}_{axis}$" for axis in "xyz" for kind in "sv"]
    fig, ax = plots.panels([["P"]], height=4.3)
    ax["P"].imshow(P != 0, cmap=ListedColormap(["white", KALMAN]), alpha=0.25)
    for i, j in np.ndindex(P.shape):
        text = f"{P[i, j]:.3f}" if P[i, j] else "0"
        ax["P"].text(j, i, text, ha="center", va="center", color="black" if P[i, j] else "0.6")
    ax["P"].set_xticks(range(6), names)
    ax["P"].set_yticks(range(6), names)
    ax["P"].tick_params(length=0, top=False, labeltop=True, bottom=False, labelbottom=False)
    ax["P"].set_xticks(np.arange(7) - 0.5, minor=True)
    ax["P"].set_yticks(np.arange(7) - 0.5, minor=True)
    ax["P"].tick_params(which="minor", length=0)
    ax["P"].grid(False)
    ax["P"].grid(which="minor", color="0.8")
    ax["P"].spines[:].set_visible(False)
    zeros = np.count_nonzero(P == 0)
    ax["P"].set_title(f"{zeros} of {P.size} entries are zero,\nand the three blocks are equal")
    return fig


def silent_phones(phones=30, steps=60, last=30):
    """Return errors of the position (steps, 3, phones), and sigma (steps, 3), where z falls silent after step `last`.

    >>> errors, sigma = silent_phones()
    >>> sigma[-1].round(1)
    array([ 0.2,  0.2, 10.5])
    """
    model = stack(AXIS, AXIS, AXIS)
    states, measured = simulate(model, steps, np.random.default_rng(2015), tracks=phones)
    measured[last:, 2] = np.nan
    estimates = KalmanFilter(model).estimates(measured)
    variances = np.diagonal(estimates.P[..., 0], axis1=1, axis2=2)  # the same for all phones
    return (estimates.x - states)[:, ::2], np.sqrt(variances[:, ::2])


def in_one_line(x, columns):
    """Return the x and y of a line that draws each column over x, with a break between them."""
    gap = np.full((1, columns.shape[1]), np.nan)
    y = np.vstack([columns, gap])
    return np.tile([*x, np.nan], columns.shape[1]), y.T.ravel()


def draw_lost_axis(last=30):
    """Return a figure of the errors on x, which is measured, and on z, which falls silent: phones, and twice sigma."""
    errors, sigma = silent_phones(last=last)
    k = np.arange(1, len(errors) + 1)
    fig, ax = plots.panels([["x"], ["z"]], height=2.1)
    titles = {"x": "error of x, measured all the time (m)", "z": "error of z, silent from second 31 on (m)"}
    for name, i in (("x", 0), ("z", 2)):
        lines = in_one_line(k, errors[:, i])
        ax[name].plot(*lines, color=KALMAN, lw=0.6, alpha=0.6, label=f"{errors.shape[2]} phones")
        band = in_one_line(k, np.column_stack([2 * sigma[:, i], -2 * sigma[:, i]]))
        ax[name].plot(*band, color="black", lw=1.4, label="twice σ, as stated")
        ax[name].set_ylim(-32, 32)
        plots.finish(ax[name], "", titles[name])
        ax[name].get_legend().remove()
    ax["x"].annotate(f"2σ = {2 * sigma[-1, 0]:.2f} m", (k[-1], 3), ha="right", va="bottom")
    ax["z"].annotate(f"2σ = {2 * sigma[-1, 2]:.0f} m", (k[-1] - 4, 24), ha="right", va="bottom")
    ax["z"].axvline(last, color="0.5", ls=":", label="last measurement")
    ax["z"].annotate("last measurement", (last - 1, -28), ha="right", va="bottom", color="0.3")
    ax["z"].set_xlabel("second")
    fig.suptitle("Thirty seconds of silence cost 10 m", x=0.02, ha="left", weight="bold")
    return fig


def draw_fig1(kf, sskf, sigma, shown=15):
    """Return the paper's Figure 1 and what it cannot show: the gap between both groups of filters.

    kf and sskf are the estimates (N, 6) of both groups, sigma (2,) of the settled filter: position and velocity.
    """
    fig, ax = plots.panels([["position", "velocity"], ["position gap", "velocity gap"]], height=2.3)
    k = np.arange(1, len(kf) + 1)
    for i, (name, unit) in enumerate({"position": "m", "velocity": "m/s"}.items()):
        both = ax[name], ax[f"{name} gap"]
        for axis in range(3):
            solid = both[0].plot(k, kf[:, 2 * axis + i], "-", color=KALMAN)
            dashed = both[0].plot(k, sskf[:, 2 * axis + i], "--", color=STEADY)
            gap = (kf - sskf)[:shown, 2 * axis + i] / sigma[i]
            both[1].plot(k[:shown], gap, ".-", color=STEADY, lw=0.8)
        both[1].axhspan(-0.1, 0.1, color="0.85", lw=0)
        both[1].set_ylim(-1.1, 1.1)
        plots.finish(both[0], "", f"{name} ({unit})")
        plots.finish(both[1], "step k", f"gap of {name} (σ)")
    ax["position gap"].annotate("grey: ± σ/10", (shown, -0.95), ha="right", va="bottom", color="0.3")
    fig.suptitle("Both groups agree after the first steps", x=0.02, ha="left", weight="bold")
    names = ["KF/LF/JKLF", "SSKF/SSLF/JSSKLF"]
    fig.legend([*solid, *dashed], names, loc="outside lower center", ncols=2)
    return fig


def sigma_after(seconds):
    """Return sigma of the position of a settled axis after so many seconds without a measurement, in metres."""
    missing = np.zeros((60 + seconds, 1))  # sixty steps settle the filter; P does not depend on what is measured
    missing[60:] = np.nan
    return float(np.sqrt(KalmanFilter(AXIS).covariances(missing)[-1, 0, 0]))


def answer_silence(seconds, limit=1.0):
    """Say whether this is the first whole second of silence at which sigma passes the limit, and if not, what sigma is.

    >>> print(answer_silence(30))
    not quite: after 30 s of silence σ is 10.5 m. It passed 1 m earlier.
    """
    if seconds is None:
        return "not yet: give a whole number of seconds"
    sigma, before = sigma_after(seconds), sigma_after(seconds - 1)
    if sigma <= limit:
        return f"not quite: after {seconds} s of silence σ is {sigma:.2f} m. It passes {limit:g} m later."
    if before > limit:
        return f"not quite: after {seconds} s of silence σ is {sigma:.3g} m. It passed {limit:g} m earlier."
    return f"right: after {seconds} s of silence σ is {sigma:.2f} m, a second before it was {before:.2f} m"


def answer_step(step):
    """Say how far a step(x, P, z) of a reader's own is from the filter's, from an x (2,), a P (2, 2) and a number z.

    >>> print(answer_step(lambda x, P, z: (x, P)))
    not quite: x should be [1.690 0.596], yours is [1.000 0.500]. P comes after x.
    """
    x, P, z = np.array([1.0, 0.5]), np.eye(2), 1.7
    mine = step(x, P, z)
    if mine is None:
        return "not yet: return x and P one step later"
    right = KalmanFilter(AXIS).step(x, P, np.array([z]))
    for name, ours, theirs, after in zip(
        ("x", "P"), right, mine, (". P comes after x.", ". Your x is right."), strict=True
    ):
        if np.shape(theirs) != ours.shape:
            return f"not quite: {name} should have the shape {ours.shape}, yours has {np.shape(theirs)}"
        if not np.allclose(theirs, ours, atol=1e-9):
            return f"not quite: {name} should be {written(ours)}, yours is {written(theirs)}{after}"
    return "right: x and P are those of the filter"


def written(values):
    """Return an array of numbers as a line of text with three digits."""
    return np.array2string(np.asarray(values, float), precision=3, floatmode="fixed").replace("\n", "")
