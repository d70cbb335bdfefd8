"""The drawings of the notebook on 2014, and what its exercises start from."""

import numpy as np

from mpt_helpers import plots
from mpt_helpers.filters import KalmanFilter
from mpt_helpers.metrics import innovations
from mpt_helpers.model import LinearModel, gsm_axis, simulate
from mpt_helpers.steady import SteadyStateFilter

from .. import burden
from ..figures import visible_gap
from . import table4

AXIS = gsm_axis(dt=1.0, q=0.01, r=0.1)  # Example 1
WALK = 1.5  # m/s, walking pace


def walk(steps=60):
    """Return a walk on one axis: true states (steps, 2) and measurements (steps,) of the position, one per second.

    The velocity is 1.5 m/s at the start and wanders as in Example 1; the measurements have its noise, sigma 0.32 m.

    >>> states, measured = walk(60)
    >>> states.shape, measured.shape
    ((60, 2), (60,))
    """
    model = LinearModel(F=AXIS.F, H=[[1, 0]], Q=AXIS.Q, R=AXIS.R, x0=[0, WALK])
    states, z = simulate(model, steps, np.random.default_rng(14))  # this one stays at 1.2 to 1.9 m/s
    return states, z[:, 0]


def settled():
    """Return A, (2, 2), of the steady-state filter of Example 1, and the sigma of its position in metres.

    >>> A, sigma = settled()
    >>> round(sigma, 3)
    0.169
    """
    steady = SteadyStateFilter.from_kalman(AXIS)
    return steady.A, float(np.sqrt(steady.P[0, 0]))


def kalman_step(x, P, z):
    """Return x and P after one step of the Kalman filter of Example 1 (2014 Eq. 4), from x (2,), P (2, 2) and z.

    >>> x, P = kalman_step(np.zeros(2), np.zeros((2, 2)), 1.0)
    >>> x.round(3)
    array([0.061, 0.122])
    """
    return KalmanFilter(AXIS).step(x, P, np.atleast_1d(z))


def draw_late():
    """Return a figure of what H = [1 dt] does to a filter that is fed with positions, and of its innovations."""
    states, measured = walk()
    start_unknown = LinearModel(F=AXIS.F, H=AXIS.H, Q=AXIS.Q, R=AXIS.R, P0=100 * np.eye(2))
    kf = KalmanFilter(start_unknown)
    z = measured[:, None]
    estimate, P = kf.filter(z)[:, 0], kf.covariances(len(z))[:, 0, 0]
    new = innovations(kf, z)
    k = np.arange(1, len(z) + 1)
    band = 2 * np.sqrt(P)
    settled = slice(2, None)  # the first two steps only find the start
    fig, ax = plots.panels([["truth"], ["innovations"]], height=2.1)
    ax["truth"].fill_between(k[settled], -band[settled], band[settled], color="0.85", lw=0)
    ax["truth"].axhline(0, color="0.4", lw=1)
    ax["truth"].plot(k[settled], (states[:, 0] - estimate)[settled], "C1.-", lw=0.8)
    ax["truth"].annotate("here the filter says it is", (k[-1], -0.4), ha="right", va="top", color="0.3")
    ax["truth"].annotate("here the phone is", (k[-1], 2.1), ha="right", va="bottom", color="C1")
    ax["truth"].set_ylim(-1.1, 2.9)
    ax["innovations"].axhspan(-2, 2, color="0.85", lw=0)
    ax["innovations"].plot(k[settled], (new.values[:, 0] / np.sqrt(new.S[:, 0, 0]))[settled], "C0.-", lw=0.8)
    ax["innovations"].set_ylim(-3.5, 3.5)
    plots.finish(ax["truth"], "", "true position minus estimate (m); grey: ± 2σ stated")
    plots.finish(ax["innovations"], "step k", "innovations, each over its σ; grey: ± 2")
    return fig


def draw_lookahead(x, z, r):
    """Return a figure of z(k) - s(k) with the velocity over it, and of z(k) - s(k+1), on the first axis.

    x (N, n) are true states, position and velocity first, z (N, m) measurements with noise of variance r.
    """
    k = np.arange(1, len(x))
    fig, ax = plots.panels([["now"], ["next"]], height=1.9)
    for name, position, label in (("now", x[:-1, 0], "z(k) - s(k)"), ("next", x[1:, 0], "z(k) - s(k+1)")):
        ax[name].axhspan(-2 * np.sqrt(r), 2 * np.sqrt(r), color="0.9", lw=0)
        ax[name].plot(k, z[:-1, 0] - position, "C0.-", lw=0.8, label="measurement minus position")
        ax[name].set_ylim(-1.2, 2.2)
        plots.finish(ax[name], "", f"{label} (m), x axis; grey: ± 2σ of the noise")
    ax["now"].plot(k, x[:-1, 1], "C1-", lw=2, label="Δt times velocity")
    ax["next"].set_xlabel("step k")
    plots.legend_below(ax["now"], 2)
    return fig


def draw_fig1(x, kf, sskf, sigma):
    """Return the paper's Figure 1: true states and estimates of both groups of filters, and their first errors.

    x, kf and sskf are (N, 4); sigma (N,) is what the Kalman filter states of its error of the position.
    """
    layout = [[f"{what} {axis}" for axis in "xy"] for what in ("position", "velocity", "error of position")]
    fig, ax = plots.panels(layout, height=1.9)
    k, first = np.arange(1, len(x) + 1), slice(12)
    for i, name in enumerate(["position x", "velocity x", "position y", "velocity y"]):
        lines = ax[name].plot(k, x[:, i], "0.7", k, kf[:, i], "C0-", k, sskf[:, i], "C1--")
        lines[0].set_linewidth(4)
    for i, name in ((0, "error of position x"), (2, "error of position y")):
        ax[name].fill_between(k[first], -2 * sigma[first], 2 * sigma[first], color="0.9", lw=0)
        ax[name].plot(k[first], (x - kf)[first, i], "C0-", k[first], (x - sskf)[first, i], "C1--")
    for name in ax:
        plots.finish(ax[name], "step k" if "error" in name else "", f"{name} ({'m/s' if 'velocity' in name else 'm'})")
    fig.legend(lines, ["true", "KF/LF/JKLF", "SSKF/SSLF/JSSKLF"], loc="outside lower center", ncols=3)
    return fig


def draw_gain(gains, limit, rho):
    """Return a figure of gains {label: (N,)} over the steps, and of their distance to the limit beside rho^(2k)."""
    fig, ax = plots.panels([["gain", "left"]], height=2.6)
    for (label, gain), style in zip(gains.items(), ("C0-", "C1--"), strict=True):
        k = np.arange(1, len(gain) + 1)
        ax["gain"].plot(k[:15], gain[:15], style, label=label)
        ax["left"].semilogy(k, visible_gap(np.abs(gain - limit)), style)
    ax["left"].semilogy(k, rho ** (2 * k), "k:", label=f"ρ²ᵏ, ρ = {rho:.3f}")
    plots.finish(ax["gain"], "step k", "gain of the position")
    plots.finish(ax["left"], "step k", "distance to the limit")
    return fig


def draw_fig2(sskf, fir):
    """Return the paper's Figure 2: estimates (N, 4) of the steady-state and the FIR filter, and their gap."""
    layout = [["position x", "velocity x"], ["position y", "velocity y"], ["gap", "gap"]]
    fig, ax = plots.panels(layout, height=1.9)
    k = np.arange(1, len(sskf) + 1)
    for i, name in enumerate(["position x", "velocity x", "position y", "velocity y"]):
        lines = ax[name].plot(k, sskf[:, i], "C0-", k, fir[:, i], "C1--")
        plots.finish(ax[name], "", f"{name} ({'m/s' if 'velocity' in name else 'm'})")
    for i, label in ((0, "x axis"), (2, "y axis")):
        ax["gap"].plot(k, 1000 * (sskf - fir)[:, i], f"C{i}.-", label=label)
    plots.finish(ax["gap"], "step k", "gap of the position, SSKF - FIR (mm)")
    fig.legend(lines, ["SSKF/SSLF", "FIR"], loc="outside lower center", ncols=2)
    return fig


def draw_fir_cost(M=17, printed=(108, 84)):
    """Return a figure of the operations for one result of the FIR filter of order M and of the steady-state filter.

    printed are those of the FIR filter in the paper's Table 7, of models A and B.
    """
    fig, ax = plots.panels([["A", "B"]], height=3.7)
    steps = np.arange(1, M + 1)
    for (name, n, m, filters), said in zip((("A", 4, 2, 1), ("B", 2, 1, 2)), printed, strict=True):
        one_step = filters * burden.total(burden.steady_state(n, m))
        in_one_product = [filters * burden.total(burden.lifted(n, m, k)) for k in steps]
        fir = filters * burden.total(burden.fir(n, m, M))
        ax[name].plot(steps, one_step * steps, "k.-", label="constant gain, step by step")
        ax[name].plot(steps, in_one_product, label="constant gain, in one product")
        ax[name].axhline(fir, color="C1", label="FIR, counted")
        ax[name].axhline(said, color="0.5", ls="--", label="FIR, printed")
        ax[name].set(xlim=(0, M + 0.5), ylim=(0, 1.25 * fir), xticks=(1, 3, 5, 7, 15), xlabel="steps between results")
        ax[name].set_title(f"model {name}: {fir}, not {said}")
    fig.suptitle("Operations for one result")
    fig.legend(*ax["A"].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return fig


def draw_axes(most=4):
    """Return a figure of the operations of one step with 1 ... `most` axes, in one filter (A) or one per axis (B)."""
    axes = list(range(1, most + 1))
    counts = {d: burden.twelve(d) for d in axes}
    fig, ax = plots.panels([["cost"]], height=3.2)
    for i, name in enumerate(("KF", "LF", "SSKF")):
        for kind, style in (("A", "o-"), ("B", "o--")):
            label = f"{name} {kind}"
            ax["cost"].semilogy(axes, [counts[d][label] for d in axes], style, color=f"C{i}", ms=4, label=label)
    plots.finish(ax["cost"], "axes", "operations of one step")
    ax["cost"].set_xticks(axes)
    ax["cost"].get_legend().remove()
    fig.legend(loc="outside right upper")
    return fig


def draw_table4(states, names, notes, framed):
    """Return a map of Table 4; the arguments are those of `table4.draw`."""
    fig, ax = plots.panels([["map"]], height=4.4)
    table4.draw(ax["map"], states, names, notes, framed)
    ax["map"].text(len(names) - 0.3, min(map(names.index, notes)) - 1, "made with", va="center", color="C1")
    wrong = int((states == table4.WRONG).sum())
    ax["map"].set_title(f"Table 4: all {wrong} wrong cells involve a join filter", x=-0.25, weight="bold")
    return fig
