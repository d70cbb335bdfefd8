"""The figures of the lesson `a_track_in_pieces`: the relay of pieces, and the stack of matrices."""

from dataclasses import replace

import numpy as np
from matplotlib.patches import Rectangle

import mpt_helpers as mpt
from reproduction import plots

from .lesson_one_step_late import PRINTED, UNKNOWN, walk

# Of a sensor that shows the position to 3 m: a piece of the figure does not forget its start before it ends.
COARSE = replace(PRINTED, H=[[1, 0]], R=[[9.0]])
BLUE = plots.COLOUR_OF["lainiotis"]
SHADES = ("0.93", "#C6DBEF")  # of the pieces, in turns


def _cells(ax, left, top, rows, columns, colour, numbers=None):
    """Draw a matrix of unit cells, and a number in each."""
    for i in range(rows):
        for j in range(columns):
            ax.add_patch(Rectangle((left + j, top - i - 1), 1, 1, facecolor=colour, edgecolor="0.4", lw=0.7))
            if numbers is not None:
                ax.annotate(str(numbers[i][j]), (left + j + 0.5, top - i - 0.5), ha="center", va="center")


def draw_stack(pieces=4, L=5):
    """Return a figure of a recording cut into pieces that lie side by side, and of what one call of numpy works on."""
    fig, ax = plots.panels([["stack"]], height=3.8)
    ax = ax["stack"]
    for piece in range(pieces):
        numbers = np.arange(piece * L, (piece + 1) * L) + 1
        colour = SHADES[piece % 2]
        _cells(ax, piece * L, 9.6, 1, L, colour)
        for end in (numbers[0], numbers[-1]):
            ax.annotate(str(end), (end - 0.5, 9.1), ha="center", va="center")
        _cells(ax, 1.5 * piece, 7.2, L, 1, colour, numbers[:, None])
        _cells(ax, 11 + 2.4 * piece, 7.2, 1, 1, colour, [[numbers[2]]])
        _cells(ax, 11 + 2.4 * piece, 5.6, 2, 1, colour)
        _cells(ax, 11 + 2.4 * piece, 3.0, 2, 2, colour)
    width = 1.5 * pieces - 0.5
    ax.add_patch(Rectangle((-0.2, 4.1), width + 0.4, 1.2, fill=False, edgecolor=BLUE, lw=2.2))
    ax.annotate("", (7.7, 4.7), (width + 0.3, 4.7), arrowprops={"arrowstyle": "->", "color": BLUE, "lw": 2})
    ax.annotate(f"the recording: {pieces * L} rows", (0, 9.8), va="bottom")
    ax.annotate("cut, and laid side by side", (0, 7.4), va="bottom")
    for name, shape, middle in (("z", "1, 1", 6.7), ("x", "2, 1", 4.6), ("P", "2, 2", 2.0)):
        ax.annotate(f"{name}\n({pieces}, {shape})", (8, middle), va="center", color=BLUE)
    ax.set(xlim=(-0.5, pieces * L + 0.6), ylim=(0.8, 10.7))
    ax.axis("off")
    fig.suptitle("One call of numpy takes a row of all pieces", weight="bold")
    return fig


def draw_relay(pieces=4, L=10):
    """Return a figure of a track in pieces: from pretended starts, with a runner, and from his starts."""
    true, _ = walk(pieces * L)
    measured = true + np.sqrt(COARSE.R[0, 0]) * np.random.default_rng(4).standard_normal(len(true))
    pretended = mpt.KalmanFilter(COARSE).filter(measured.reshape(pieces, L).T[:, None])[:, 0]  # from 0 exactly
    whole = mpt.KalmanFilter(replace(COARSE, P0=UNKNOWN)).filter(measured[:, None])[:, 0]
    starts = L * np.arange(pieces)
    brought = np.append(0, whole[L - 1 : -1 : L])
    fig, ax = plots.panels([["pretend"], ["relay"], ["again"]], height=1.75)
    for axes in ax.values():
        for start in starts[1:]:
            axes.axvline(start, color="0.6", lw=0.8, ls=":")
        axes.plot(np.arange(1, pieces * L + 1), true, color="0.8", lw=4)
        axes.set(xlim=(-3, pieces * L + 3), ylim=(-12, 1.25 * true.max()))
    passes = {"pretend": (0 * brought, pretended.T), "again": (brought, whole.reshape(pieces, L))}
    for name, (first, estimates) in passes.items():
        for start, at_start, estimate in zip(starts, first, estimates, strict=True):
            ax[name].plot(start + np.arange(L + 1), np.append(at_start, estimate), color=BLUE)
        ax[name].plot(starts, first, "o", color=BLUE, ms=5)
    ends, mended = pretended[-1], np.append(brought[1:], whole[-1])
    for name in ("pretend", "relay"):
        ax[name].plot(starts + L, ends, "o", mec=BLUE, mfc="white", ms=5, zorder=3)
    ax["relay"].plot(np.append(starts, pieces * L), np.append(brought, whole[-1]), "o", color=BLUE, ms=5)
    arrow = {"arrowstyle": "->", "color": BLUE, "lw": 1.6, "shrinkA": 3, "shrinkB": 3}
    for at, end, to in zip(starts + L, ends, mended, strict=True):
        ax["relay"].annotate("", (at, to), (at, end), arrowprops=arrow)
    texts = {
        "pretend": "each pretends to start at 0",
        "relay": "the runner mends each end",
        "again": "each starts where he says",
    }
    for name, text in texts.items():
        ax[name].annotate(text, (0, 0.95 * true.max()), color=BLUE)
    ax["again"].annotate("grey: the true track", (pieces * L, 0), color="0.45", ha="right")
    plots.finish(ax["pretend"], "", "first: all pieces at once (m)")
    plots.finish(ax["relay"], "", "then: one piece after the other (m)")
    plots.finish(ax["again"], "second", "last: all pieces at once (m)")
    fig.suptitle("Pretended starts, a runner,\nand every piece is on the track", weight="bold")
    return fig
