"""The drawings of the lesson on three axes, and the numbers behind its table."""

from dataclasses import replace

import numpy as np
from matplotlib.colors import ListedColormap

from mpt_helpers import metrics
from mpt_helpers.kalman import KalmanFilter
from mpt_helpers.model import LinearModel, gsm_axis, simulate, stack
from mpt_helpers.steady import SteadyStateFilter
from reproduction import plots

PAPER = gsm_axis(dt=1.0, q=0.01, r=0.1)  # the paper's example: H = [1 1], the position one step ahead
AXIS = replace(PAPER, H=[[1, 0]])  # the same axis, measured where it is
KALMAN = plots.COLOUR_OF["kalman"]


def covariance(steps=60):
    """Return P (6, 6) of the six-state filter for three axes, after so many steps from a known start.

    >>> int(np.count_nonzero(covariance()))
    12
    """
    return KalmanFilter(stack(AXIS, AXIS, AXIS)).covariances(steps)[-1]


def draw_covariance():
    """Return a figure of the entries of P, (6, 6): which are zero, and the numbers of the others."""
    P = covariance()
    names = [rf"${kind}_\mathrm{{{axis}}}$" for axis in ("east", "north", "height") for kind in "sv"]
    fig, ax = plots.panels([["P"]], height=3.6)
    ax["P"].imshow(P != 0, cmap=ListedColormap(["white", KALMAN]), alpha=0.25, aspect="auto")  # wide cells
    for i, j in np.ndindex(P.shape):
        text = f"{P[i, j]:.4f}" if P[i, j] else "0"
        ax["P"].text(j, i, text, ha="center", va="center", color="black" if P[i, j] else "0.6")
    ax["P"].set_xticks(range(6), names)
    ax["P"].set_yticks(range(6), names)
    ax["P"].tick_params(length=0, top=False, labeltop=True, bottom=False, labelbottom=False)
    ax["P"].grid(False)
    edges = np.arange(len(P) + 1) - 0.5
    ax["P"].hlines(edges, edges[0], edges[-1], color="0.8", lw=0.8, clip_on=False)
    ax["P"].vlines(edges, edges[0], edges[-1], color="0.8", lw=0.8, clip_on=False)
    ax["P"].set_xlim(edges[0], edges[-1])
    ax["P"].set_ylim(edges[-1], edges[0])
    ax["P"].spines[:].set_visible(False)
    zeros = np.count_nonzero(P == 0)
    ax["P"].set_title(f"{zeros} of {P.size} entries are zero,\nand the three blocks are equal", weight="bold")
    return fig


def silent_phones(phones=30, steps=60, last=30):
    """Return errors of the position (steps, 3, phones), and sigma (steps, 3); the height is silent after step `last`.

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
    """Return a figure of the errors east, which is measured, and of the height, which falls silent: phones, 2 sigma.

    Both stand beside each other in one scale, and below is the height again in a scale that holds all of it.
    """
    errors, sigma = silent_phones(last=last)
    k = np.arange(1, len(errors) + 1)
    fig, ax = plots.panels([["east", "height"], ["far", "far"]], height=2.2)
    for name, axis, limit in (("east", 0, 1), ("height", 2, 1), ("far", 2, 36)):
        band = in_one_line(k, np.column_stack([2 * sigma[:, axis], -2 * sigma[:, axis]]))
        ax[name].plot(*band, color="black", lw=1.0)
        lines = in_one_line(k, errors[:, axis])
        ax[name].plot(*lines, color=KALMAN, lw=0.6, alpha=0.6)  # over the band, which would hide them from afar
        ax[name].axvline(last, color="0.5", ls=":", visible=axis == 2)
        ax[name].set_ylim(-limit, limit)
        ax[name].set_xlim(0, k[-1] + 2)
        ax[name].set_xticks([0, last, k[-1]])
    plots.finish(ax["east"], "second", "east: measured\nall the time")
    plots.finish(ax["height"], "second", f"height: silent\nafter second {last}")
    plots.finish(ax["far"], "second", "the height again, from afar")
    ax["east"].set_ylabel("error (m)")
    ax["far"].set_ylabel("error (m)")
    ax["far"].annotate(f"2σ = {2 * sigma[-1, 2]:.0f} m", (k[-1], 34), ha="right", va="top")
    ax["far"].annotate(f"blue: {errors.shape[2]} phones\nblack: ± 2σ", (2, -34), ha="left", va="bottom", color="0.3")
    title = f"{len(k) - last} silent seconds turn σ = {sigma[last - 1, 2]:.2f} m into {sigma[-1, 2]:.1f} m"
    fig.suptitle(title, x=0.02, ha="left", weight="bold")
    return fig


def sigma_of_both(P0, steps):
    """Return sigma of the position (steps,) with the gain that varies, and with the settled gain from the first step.

    >>> best, constant = sigma_of_both(np.zeros((2, 2)), 60)
    >>> print(f"{best[0]:.3f} {constant[0]:.3f} {best[-1]:.3f} {constant[-1]:.3f}")
    0.049 0.174 0.234 0.234
    """
    model = replace(AXIS, P0=P0)
    best = KalmanFilter(model).covariances(steps)
    constant = metrics.error_moments(SteadyStateFilter.from_kalman(AXIS), model, steps).covariance
    return np.sqrt(best[:, 0, 0]), np.sqrt(constant[:, 0, 0])


def losses_apart(sizes, errors=0.0, changes=0.0):
    """Return the loss of axes kept apart to one filter, in percent (axes, 2): sigma of position and velocity.

    The measurement errors of all axes are sizes (axes,) times those of AXIS. They have the correlation `errors`, and
    the random changes of the velocity the correlation `changes`. Neither changes what an axis kept apart does.

    >>> losses_apart([1, 1], errors=0.5).round(1)
    array([[1. , 1.6],
           [1. , 1.6]])
    """
    sizes, identity = np.asarray(sizes, float), np.eye(len(sizes))
    scales = AXIS.R[0, 0] * np.outer(sizes, sizes)
    F, H, Q = (np.kron(identity, each) for each in (AXIS.F, AXIS.H, AXIS.Q))
    linked = LinearModel(
        F=F, H=H, Q=np.kron(correlated(len(sizes), changes), AXIS.Q), R=scales * correlated(len(sizes), errors)
    )
    together = SteadyStateFilter.from_kalman(linked).P
    apart = SteadyStateFilter.from_kalman(LinearModel(F=F, H=H, Q=Q, R=scales * identity)).P
    return 100 * (np.sqrt(np.diag(apart) / np.diag(together)) - 1).reshape(-1, 2)


def correlated(axes, c):
    """Return the correlation matrix (axes, axes) of axes that have the correlation c with each other."""
    return c + (1 - c) * np.eye(axes)


def diagonal_apart(c):
    """Return sigma of the position along the diagonal of three axes, where measurement errors have the correlation c.

    The axes are kept apart. First what their filters imply, as they state nothing between the axes, then what is true.

    >>> implied, true = diagonal_apart(0.0)
    >>> print(f"{implied:.3f} {true:.3f}")
    0.234 0.234
    """
    F, H, Q, R = (np.kron(np.eye(3), each) for each in (AXIS.F, AXIS.H, AXIS.Q, AXIS.R))
    apart = SteadyStateFilter.from_kalman(LinearModel(F=F, H=H, Q=Q, R=R))
    linked = LinearModel(F=F, H=H, Q=Q, R=AXIS.R[0, 0] * correlated(3, c))
    true = metrics.error_moments(apart, linked, 500).covariance[-1]
    along = np.kron(np.ones(3), [1, 0]) / np.sqrt(3)
    return float(np.sqrt(along @ apart.P @ along)), float(np.sqrt(along @ true @ along))


def silent_in_company(changes, true_changes=None, seconds=30):
    """Return sigma of the height after so many seconds of its silence, with one filter for all axes: stated, and true.

    The filter assumes correlations (3, 3) of the random changes.
    What it states is true unless the true correlations of the changes are others.

    >>> stated, true = silent_in_company(correlated(3, 0.0))
    >>> print(f"{stated:.1f} {true:.1f}")
    10.5 10.5
    """
    F, H, identity = (np.kron(np.eye(3), each) for each in (AXIS.F, AXIS.H, np.eye(2)))
    R = AXIS.R[0, 0] * np.eye(3)
    Q, true_Q = (np.kron(each, AXIS.Q) for each in (changes, changes if true_changes is None else true_changes))
    P, true = np.zeros((6, 6)), np.zeros((6, 6))
    for k in range(60 + seconds):  # sixty steps settle the filter
        seen = [0, 1, 2] if k < 60 else [0, 1]
        P, true = F @ P @ F.T + Q, F @ true @ F.T + true_Q
        H_seen, R_seen = H[seen], R[np.ix_(seen, seen)]
        K = P @ H_seen.T @ np.linalg.inv(H_seen @ P @ H_seen.T + R_seen)
        left = identity - K @ H_seen
        P, true = left @ P, left @ true @ left.T + K @ R_seen @ K.T
    return float(np.sqrt(P[4, 4])), float(np.sqrt(true[4, 4]))


def after_silence(missed, steps):
    """Return sigma of the position (steps,) after so many missed fixes: with the gain from P, and the settled gain.

    >>> best, constant = after_silence(30, steps=5)
    >>> print(best.round(2), constant.round(2))
    [0.32 0.26 0.26 0.25 0.25] [4.98 1.45 0.56 1.29 1.36]
    """
    return sigma_of_both(covariance_after(missed), steps)


def sigma_if_errors_last(c, steps=1000):
    """Return sigma of the position that the settled filter makes if measurement errors follow each other by c.

    Each error is c times the one before and a new part, with the variance of AXIS in all. Their state joins that of
    the filter's error: e(k+1) = A e(k) + (I - K H) w - K v.

    >>> round(sigma_if_errors_last(0.0), 3)
    0.234
    """
    steady = SteadyStateFilter.from_kalman(AXIS)
    r, K, kept = AXIS.R[0, 0], steady.B, np.eye(2) - steady.B @ AXIS.H
    fresh = r * (1 - c**2)
    moves = np.block([[steady.A, -c * K], [np.zeros((1, 2)), np.array([[c]])]])
    noise = np.zeros((3, 3))
    noise[:2, :2] = kept @ AXIS.Q @ kept.T
    enters = np.vstack([-K, [[1.0]]])
    noise += fresh * enters @ enters.T
    P = np.zeros((3, 3))
    for _ in range(steps):
        P = moves @ P @ moves.T + noise
    return float(np.sqrt(P[0, 0]))


def covariance_after(seconds):
    """Return P of a settled axis after so many seconds without a measurement, (2, 2)."""
    P = SteadyStateFilter.from_kalman(AXIS).P
    for _ in range(seconds):
        P = AXIS.F @ P @ AXIS.F.T + AXIS.Q
    return P


def sigma_after(seconds):
    """Return sigma of the position of a settled axis after so many seconds without a measurement, in metres."""
    return float(np.sqrt(covariance_after(seconds)[0, 0]))
