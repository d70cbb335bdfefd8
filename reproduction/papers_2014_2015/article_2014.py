"""The drawings of the notebook on 2014, its simulated walks, and the judges of its exercises."""

from dataclasses import replace

import numpy as np

from mpt_helpers.kalman import KalmanFilter
from mpt_helpers.metrics import innovations
from mpt_helpers.model import gsm_axis, simulate
from mpt_helpers.steady import SteadyStateFilter
from reproduction import plots
from reproduction.plots import COLOUR_OF

from .. import burden
from ..figures import visible_gap
from . import table4

AXIS = gsm_axis(dt=1.0, q=0.01, r=0.1)  # Example 1: H = [1 dt]
RIGHT = replace(AXIS, H=[[1, 0]])  # the same for a sensor of present positions
UNKNOWN = 100 * np.eye(2)  # P(0/0) of a start that nobody knows: sigma of 10 m and 10 m/s
WALK = 1.5  # m/s, walking pace
GREY = "0.87"


def from_unknown(model):
    """Return the model with a start that nobody knows."""
    return replace(model, P0=UNKNOWN)


def walk(steps=60):
    """Return a walk on one axis: true states (steps, 2) and measurements (steps,) of the position, one per second.

    The velocity is 1.5 m/s at the start and wanders as in Example 1; the measurements have its noise, sigma 0.32 m.

    >>> states, measured = walk(60)
    >>> states.shape, measured.shape
    ((60, 2), (60,))
    """
    rng = np.random.default_rng(14)  # this one stays at 1.2 to 1.9 m/s
    states, z = simulate(replace(RIGHT, x0=[0, WALK]), steps, rng)
    return states, z[:, 0]


# Walkers by what they do: the velocity at second k = 0, 1, ... in multiples of the pace.
WALKERS = {
    "goes straight on": lambda k: np.ones(len(k)),
    "turns back every 20 s": lambda k: 1.0 - 2 * (k // 20 % 2),
    "stops every 30 s, for 30 s": lambda k: 1.0 - k // 30 % 2,
    "never moves": lambda k: np.zeros(len(k)),
}


def walks(kind, steps, tracks, rng):
    """Return true positions (steps,) of one of the WALKERS, one per second, and measurements (steps, tracks) of them.

    >>> positions, z = walks("turns back every 20 s", 40, 3, np.random.default_rng(1))
    >>> positions[[0, 19, 39]], z.shape
    (array([ 1.5, 30. ,  0. ]), (40, 3))
    """
    positions = np.cumsum(WALK * WALKERS[kind](np.arange(steps)))
    return positions, positions[:, None] + rng.normal(0, np.sqrt(AXIS.R[0, 0]), (steps, tracks))


def lateness(model, positions, z, start=10):
    """Return errors and lateness of a filter from an unknown start on measured positions, without the first rows.

    positions (N,) are true, z (N, M) measured on M tracks; `start` rows are left out. The result has, by name: "gap",
    the mean of measurement minus reported position (m); "error", the rms error of the position (m); "late", the seconds
    late (M,) that a fit of that gap to the reported velocity finds; "velocity", the rms of that velocity (M,); "nis",
    the mean NIS.

    >>> positions, z = walks("goes straight on", 200, 50, np.random.default_rng(1))
    >>> found = lateness(AXIS, positions, z)
    >>> round(float(found["late"].mean()), 2), round(float(found["gap"]), 1)
    (1.0, 1.5)
    """
    kf = KalmanFilter(from_unknown(model))
    x = kf.filter(z[:, None])[start:]
    new = innovations(kf, z[:, None])
    gap = z[start:] - x[:, 0]
    return {
        "gap": gap.mean(),
        "error": np.sqrt(np.mean((positions[start:, None] - x[:, 0]) ** 2)),
        "late": (gap * x[:, 1]).sum(axis=0) / (x[:, 1] ** 2).sum(axis=0),
        "velocity": np.sqrt((x[:, 1] ** 2).mean(axis=0)),
        "nis": np.mean(new.values[start:, 0] ** 2 / new.S[start:, 0, 0].reshape(len(x), -1)),
    }


# The exercises: what they start from, and what they answer.


def another_sensor(steps=600):
    """Return the true states (steps, 2) of a walk, and what a sensor reported that is half a second behind.

    >>> states, reports = another_sensor()
    >>> np.linalg.lstsq(states, reports, rcond=None)[0].round(1)
    array([ 1. , -0.5])
    """
    rng = np.random.default_rng(15)
    states, _ = simulate(replace(AXIS, x0=[0, WALK]), steps, rng)
    return states, states @ [1.0, -0.5] + rng.normal(0, np.sqrt(AXIS.R[0, 0]), steps)


NOT_YET = "not yet answered"


def judge_h(mine):
    """Say whether an H explains what `another_sensor` reported, and how far off it is.

    >>> print(judge_h([1, 0]))
    not yet: with your H [1. 0.] the reports are off by 1.62 m (rms); the noise alone is 0.31 m
    """
    if mine is None:
        return NOT_YET
    states, reports = another_sensor()
    mine = np.asarray(mine, float).ravel()
    if mine.shape != (2,):
        return f"not yet: H needs two numbers, one for the position and one for the velocity; yours has {mine.size}"
    best = np.linalg.lstsq(states, reports, rcond=None)[0]
    off, noise = (np.sqrt(np.mean((reports - states @ h) ** 2)) for h in (mine, best))
    if off < 1.05 * noise:  # a tenth of a second in H's velocity makes more than that
        return f"right: H = {mine.round(1)}; the sensor reports where the phone was half a second ago"
    left = f"the reports are off by {off:.2f} m (rms); the noise alone is {noise:.2f} m"
    return f"not yet: with your H {mine.round(2)} {left}"


def judge_step(mine):
    """Say whether a function of x, P and z does what a Kalman step with H = [1 0] does, and how far off it is.

    >>> print(judge_step(lambda x, P, z: (x, P)))
    not yet: x is off by up to 2.5, P by up to 1.9; a Kalman step gives x = [3.5 2.2]
    """
    x, P, z = np.array([[1.0], [2.0]]), np.array([[2.0, 0.5], [0.5, 1.0]]), 3.5
    answer = mine(x, P, z)
    if answer is None:
        return NOT_YET
    right_x, right_P = KalmanFilter(RIGHT).step(x[:, 0], P, np.array([z]))
    mine_x, mine_P = np.asarray(answer[0], float).ravel(), np.asarray(answer[1], float)
    if mine_x.shape != (2,) or mine_P.shape != (2, 2):
        return f"not yet: needs x of two numbers and P of 2 x 2, got {mine_x.shape} and {mine_P.shape}"
    off = [np.abs(mine_x - right_x).max(), np.abs(mine_P - right_P).max()]
    if max(off) < 1e-9:  # rounding is 1e-15 here
        return "right: a Kalman step gives the same"
    return (
        f"not yet: x is off by up to {off[0]:.2g}, P by up to {off[1]:.2g}; a Kalman step gives x = {right_x.round(1)}"
    )


def judge_order(M, distance=10_000.0):
    """Say whether M terms are right for a FIR filter with H = [1 0] and a phone within `distance` metres.

    >>> print(judge_order(20))
    not yet: 20 terms drop up to 2.9 m of 10,000 m, and a tenth of σ is 0.023 m
    """
    steady = SteadyStateFilter.from_kalman(RIGHT)
    wanted = 0.1 * float(np.sqrt(steady.P[0, 0]))

    # Of the position, what is left after k steps: below 1e-30 from 200 on.
    shares = np.abs([np.linalg.matrix_power(steady.A, k)[0, 0] for k in range(200)])

    def dropped(terms):  # at most with so many terms or more: the share swings through 0, at 26 terms by accident
        return distance * float(shares[terms:].max(initial=0.0))

    said = f"{M} terms drop up to {dropped(M):.2g} m of {distance:,.0f} m, and a tenth of σ is {wanted:.3f} m"
    if dropped(M) > wanted:
        return f"not yet: {said}"
    spare = 0
    while dropped(M - spare - 1) <= wanted:
        spare += 1
    return f"right: {said}" if spare == 0 else f"enough, and {spare} more than needed: {said}"


# The drawings.


def draw_late():
    """Return a figure of what H = [1 dt] does to a filter that is fed with positions, and of its innovations."""
    states, measured = walk()
    kf = KalmanFilter(from_unknown(AXIS))
    z = measured[:, None]
    estimate, P = kf.filter(z)[:, 0], kf.covariances(len(z))[:, 0, 0]
    new = innovations(kf, z)
    k = np.arange(1, len(z) + 1)
    band = np.sqrt(P)
    found = slice(2, None)  # the first two steps only find the start
    fig, ax = plots.panels([["error"], ["innovations"]], height=2.3)
    right = KalmanFilter(from_unknown(RIGHT)).filter(z)[:, 0]
    ax["error"].fill_between(k[found], -2 * band[found], 2 * band[found], color=GREY, lw=0)
    ax["error"].axhline(0, color="0.4", lw=1)
    (line,) = ax["error"].plot(k[found], (states[:, 0] - estimate)[found], color=COLOUR_OF["kalman"])
    ax["error"].annotate(
        "grey: ± 2 of the σ that the paper's filter states", (k[-1], -0.6), ha="right", va="top", color="0.3"
    )
    (good,) = ax["error"].plot(k[found], (states[:, 0] - right)[found], "--", lw=1, color="0.35")
    plots.label_line(line, "of the paper's filter", at=k[-1], xytext=(0, 16), ha="right")
    plots.label_line(good, "of the right filter", at=10, xytext=(0, 17))
    ax["error"].set_ylim(-1.3, 2.9)
    ax["innovations"].axhspan(-2, 2, color=GREY, lw=0)
    ax["innovations"].plot(
        k[found], (new.values[:, 0] / np.sqrt(new.S[:, 0, 0]))[found], ".-", lw=0.8, color=COLOUR_OF["kalman"]
    )
    ax["innovations"].set_ylim(-3.5, 3.5)
    plots.finish(ax["error"], "", "true minus reported position (m)")
    plots.finish(ax["innovations"], "second", "surprises, each over its σ; grey: ± 2")
    fig.suptitle(
        "The error is nine times what the filter states.\nOver 60 seconds its own test sees nothing.", weight="bold"
    )
    return fig


def draw_pieces(pieces=4, L=30):
    """Return a figure of a track cut into pieces: pretended starts, then the real ones that a runner brings."""
    states, measured = walk(pieces * L)
    pretended = KalmanFilter(RIGHT).filter(measured.reshape(pieces, L).T[:, None])[:, 0]  # from 0 exactly
    whole = KalmanFilter(from_unknown(RIGHT)).filter(measured[:, None])[:, 0]
    k = np.arange(1, pieces * L + 1).reshape(pieces, L)
    junctions = L * np.arange(pieces)
    at_junctions = np.concatenate([[0.0], whole[L - 1 :: L][: pieces - 1]])
    fig, ax = plots.panels([["1"], ["2"]], height=2.1)
    for axes in ax.values():
        for at in junctions[1:]:
            axes.axvline(at, color="0.6", lw=0.8, ls=":")
        axes.plot(k.ravel(), states[:, 0], color="0.8", lw=4)
        axes.set(xlim=(-6, pieces * L + 6), ylim=(-12, 1.1 * states[:, 0].max()))
    blue = COLOUR_OF["lainiotis"]
    for of_piece, estimates in zip(k, pretended.T, strict=True):
        ax["1"].plot(np.append(of_piece[0] - 1, of_piece), np.append(0, estimates), color=blue)
    ax["1"].plot(junctions, 0 * junctions, "o", color=blue, ms=5)
    ax["2"].plot(junctions, at_junctions, "o", color=blue, ms=5)
    at_ends = np.append(at_junctions, whole[-1])
    ends = np.append(junctions, pieces * L)
    for i in range(pieces):
        arrow = {"arrowstyle": "->", "color": blue, "lw": 1.6, "shrinkA": 4, "shrinkB": 4}
        ax["2"].annotate("", (ends[i + 1], at_ends[i + 1]), (ends[i], at_ends[i]), arrowprops=arrow)
    said = {"1": "each pretends to start at 0", "2": "the runner: one step for each piece"}
    for name, text in said.items():
        ax[name].annotate(text, (1, 0.85 * states[:, 0].max()), color=blue)
    plots.finish(ax["1"], "", "1  all pieces at once (m)")
    plots.finish(ax["2"], "second", "2  one piece after the other (m)")
    fig.suptitle("All pieces run at once from a pretended start.\nThen a runner visits them.", weight="bold")
    return fig


def draw_fir_cost(M=17, printed=108):
    """Return a figure of the operations for one result in model A: FIR of order M, printed and counted, and its peers.

    Beside it: the filter of constant gain step by step, and over several steps in one product.
    """
    fig, ax = plots.panels([["A"]], height=3.9)
    axes = ax["A"]
    steps = np.arange(1, 20)
    one_step = burden.total(burden.steady_state(4, 2))
    in_one_product = [burden.total(burden.lifted(4, 2, k)) for k in steps]
    fir = burden.total(burden.fir(4, 2, M))
    few = steps[steps * one_step < 1.25 * fir]
    (ordinary,) = axes.plot(few, one_step * few, ".-", color=COLOUR_OF["steady"])
    (collected,) = axes.plot(steps, in_one_product, ".--", color=COLOUR_OF["steady"])
    (flat,) = axes.plot(steps[[0, -1]], [fir, fir], color=COLOUR_OF["fir"])
    (said,) = axes.plot(steps[[0, -1]], [printed, printed], color=COLOUR_OF["fir"], ls="--", alpha=0.5)
    plots.label_line(ordinary, "each step", at=5, xytext=(-8, 0), ha="right")
    plots.label_line(collected, "several steps collected", at=9, xytext=(6, -14))
    plots.label_line(flat, f"FIR: {fir}", at=1, xytext=(0, 5))
    plots.label_line(said, f"FIR as printed: {printed}", at=19, xytext=(0, -14), ha="right")
    early = int(np.ceil(printed / one_step))  # as printed
    meets = [int(np.ceil(fir / one_step)), int(steps[np.array(in_one_product) >= fir][0])]
    axes.plot(meets, [fir, fir], "o", color="black", ms=6)
    axes.plot(early, printed, "o", color="0.6", ms=6)  # as printed, FIR would pay from here
    axes.set(xlim=(0, 19.5), ylim=(0, 1.35 * fir), xticks=[1, early, *meets])
    plots.finish(axes, "steps between results", "operations for one result, model A")
    pays = f"FIR pays from every {meets[0]}th step on, not every {early}rd;"
    fig.suptitle(f"{pays}\nif steps are collected, from every {meets[1]}th", weight="bold")
    return fig


def draw_lookahead(x, z, r):
    """Return a figure of z(k) - s(k) with the velocity over it, and of z(k) - s(k+1), on the first axis.

    x (N, n) are true states, position and velocity first, z (N, m) measurements with noise of variance r.
    """
    k = np.arange(1, len(x))
    fig, ax = plots.panels([["now"], ["next"]], height=1.9)
    for name, position, label in (("now", x[:-1, 0], "z(k) - s(k)"), ("next", x[1:, 0], "z(k) - s(k+1)")):
        ax[name].axhspan(-2 * np.sqrt(r), 2 * np.sqrt(r), color="0.9", lw=0)
        ax[name].plot(k, z[:-1, 0] - position, ".-", color=COLOUR_OF["measured"], lw=0.8)
        ax[name].set_ylim(-1.2, 2.2)
        plots.finish(ax[name], "", f"{label} (m), x axis; grey: ± 2σ of the noise")
    (line,) = ax["now"].plot(k, x[:-1, 1], color=COLOUR_OF["truth"], lw=2)
    plots.label_line(line, "Δt times velocity", at=58, xytext=(0, 24), ha="right")
    ax["next"].set_xlabel("step k")
    fig.suptitle("The measurement is the next position", weight="bold")
    return fig


def _draw_estimates(ax, lines):
    """Draw estimates (N, 4) over the steps, {name of the colour: (array, style)}, small: as the paper's figures do."""
    for i, name in enumerate(["position x", "velocity x", "position y", "velocity y"]):
        for colour, (estimates, style) in lines.items():
            width = 4 if colour == "truth" else 1.6
            shade = "0.8" if colour == "truth" else COLOUR_OF[colour]
            ax[name].plot(np.arange(1, len(estimates) + 1), estimates[:, i], style, color=shade, lw=width)
        plots.finish(ax[name], "", f"{name} ({'m/s' if 'velocity' in name else 'm'})")


def _draw_gap(ax, gap, tenth, colour, places):
    """Draw gaps (N, 2) of the position on both axes, in cm, with the stripe that a tenth of sigma makes.

    places says for each label, "x" and "y", at which step it stands, and how many points from the line.
    """
    k = np.arange(1, len(gap) + 1)
    ax.axhspan(-100 * tenth, 100 * tenth, color=GREY, lw=0)
    for i, (label, style) in enumerate((("x", "-"), ("y", "--"))):
        (line,) = ax.plot(k, 100 * gap[:, i], style, color=COLOUR_OF[colour])
        at, xytext = places[label]
        plots.label_line(line, label, at=at, xytext=xytext)
    ax.margins(y=0.15)


def draw_fig1(x, kf, sskf, sigma):
    """Return the paper's Figure 1: true states and estimates of both groups of filters, and below their difference.

    x, kf and sskf are (N, 4); sigma is the error of the position that the settled filter states.
    """
    layout = [["position x", "position y"], ["velocity x", "velocity y"], ["gap", "gap"]]
    fig, ax = plots.panels(layout, height=1.7)
    _draw_estimates(ax, {"truth": (x, "-"), "kalman": (kf, "-"), "steady": (sskf, "--")})
    _draw_gap(ax["gap"], (sskf - kf)[:, [0, 2]], 0.1 * sigma, "steady", {"x": (1, (7, -3)), "y": (4, (8, 0))})
    plots.finish(ax["gap"], "step k", "constant gain minus Kalman, position (cm); grey: ± σ/10")
    fig.suptitle("After six steps the two groups are one", weight="bold")
    return fig


def draw_gain(gains, limit, rho):
    """Return a figure of gains {label: (N,)} over the steps, and of their distance to the limit beside rho^(2k)."""
    fig, ax = plots.panels([["gain"], ["left"]], height=2.2)
    for (label, gain), style, at in zip(gains.items(), ("-", "--"), (3, 2), strict=True):
        k = np.arange(1, len(gain) + 1)
        (line,) = ax["gain"].plot(k[:15], gain[:15], style, color=COLOUR_OF["kalman"])
        plots.label_line(line, f"from {label}", at=at, xytext=(10, 2 if at == 2 else -18))
        ax["left"].semilogy(k, visible_gap(np.abs(gain - limit)), style, color=COLOUR_OF["kalman"])
    (line,) = ax["left"].semilogy(k, rho ** (2 * k), "k:")
    plots.label_line(line, f"ρ²ᵏ, ρ = {rho:.3f}", at=20, xytext=(8, 10))
    ax["gain"].axhline(limit, color=COLOUR_OF["steady"], lw=1)
    plots.finish(ax["gain"], "", "gain of the position; orange: constant")
    plots.finish(ax["left"], "step k", "distance to the constant gain")
    fig.suptitle("The gain settles within ten steps", weight="bold")
    return fig


def draw_fig2(sskf, fir, sigma):
    """Return the paper's Figure 2: estimates (N, 4) of the steady-state and the FIR filter, and below their gap.

    sigma is the error of the position that the steady-state filter states.
    """
    layout = [["position x", "position y"], ["velocity x", "velocity y"], ["gap", "gap"]]
    fig, ax = plots.panels(layout, height=1.7)
    _draw_estimates(ax, {"steady": (sskf, "-"), "fir": (fir, "--")})
    _draw_gap(ax["gap"], (sskf - fir)[:, [0, 2]], 0.1 * sigma, "fir", {"x": (48, (0, 7)), "y": (48, (0, -15))})
    plots.finish(ax["gap"], "step k", "constant gain minus FIR, position (cm); grey: ± σ/10")
    fig.suptitle("FIR falls behind with the distance from the origin", weight="bold")
    return fig


def draw_axes(most=4):
    """Return a figure of how many times the operations of model B those of model A are, with 1 ... `most` axes."""
    axes = list(range(1, most + 1))
    counts = {d: burden.twelve(d) for d in axes}
    fig, ax = plots.panels([["ratio"]], height=3.0)
    shown = {"KF": ("kalman", "-", (6, -9)), "LF": ("lainiotis", "--", (6, 0)), "SSKF": ("steady", "-", (6, -4))}
    for name, (colour, style, place) in shown.items():
        ratio = [counts[d][f"{name} A"] / counts[d][f"{name} B"] for d in axes]
        (line,) = ax["ratio"].plot(axes, ratio, style, marker="o", ms=4, color=COLOUR_OF[colour])
        plots.label_line(line, name, at=most, xytext=place)
    plots.finish(ax["ratio"], "axes", "operations of one filter over those of one per axis")
    ax["ratio"].set(xticks=axes, xlim=(0.8, most + 0.6))
    fig.suptitle("One filter per axis saves more with each axis", weight="bold")
    return fig


def draw_table4(states, names, notes, framed):
    """Return a map of Table 4; the arguments are those of `table4.draw`."""
    fig, ax = plots.panels([["map"]], height=4.4)
    table4.draw(ax["map"], states, names, notes, framed)
    ax["map"].text(len(names) - 0.3, min(map(names.index, notes)) - 1, "it fits", va="center", color=table4.COLOURS[1])
    wrong = int((states == table4.WRONG).sum())
    ax["map"].set_title(f"Table 4: all {wrong} wrong cells involve a join filter", x=-0.25, weight="bold")
    return fig
