"""What the lesson `a_track_in_pieces` shows: measured times, the stack of matrices, and the relay of pieces."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.patches import Rectangle

import mpt_helpers as mpt
from reproduction import plots

from .lesson_one_step_late import PRINTED, UNKNOWN, walk

POSITIONS = replace(PRINTED, H=[[1, 0]])  # of a sensor that shows the position
BLUE = plots.COLOUR_OF["lainiotis"]
SHADES = ("0.93", "#C6DBEF")  # of the pieces, in turns
RESULTS = Path(__file__).parents[2] / "benchmarks" / "results.json"


def times_as_fast():
    """Return how many times as fast as the plain loop in numpy each way was, by `make bench`, to one digit.

    >>> times_as_fast()["in pieces"]
    '10'
    """
    rows = json.loads(RESULTS.read_text(encoding="utf-8"))["rows"]
    taught = {row["against"].split(": ")[1]: row for row in rows if row["work"].endswith("as taught: in pieces")}
    loop = taught.pop("plain loop of numpy")
    ms = {name: row["against_ms"] for name, row in taught.items()} | {"in pieces": loop["ms"]}
    to_one_digit = {name: float(f"{loop['against_ms'] / each:.0e}") for name, each in ms.items()}
    return {name: f"{ratio:,.0f}" for name, ratio in to_one_digit.items()}


def _cells(ax, left, top, rows, columns, colour, numbers=None):
    """Draw a matrix of unit cells, and a number in each."""
    for i in range(rows):
        for j in range(columns):
            ax.add_patch(Rectangle((left + j, top - i - 1), 1, 1, facecolor=colour, edgecolor="0.4", lw=0.7))
            if numbers is not None:
                ax.annotate(str(numbers[i][j]), (left + j + 0.5, top - i - 0.5), ha="center", va="center")


def draw_stack(pieces=4, L=5):
    """Return a figure of a recording cut into pieces that lie side by side, and of what one call of numpy works on."""
    fig, ax = plots.panels([["stack"]], height=4.6)
    ax = ax["stack"]
    for piece in range(pieces):
        numbers = np.arange(piece * L, (piece + 1) * L) + 1
        colour = SHADES[piece % 2]
        _cells(ax, piece * L, 13, 1, L, colour)
        for end in (numbers[0], numbers[-1]):
            ax.annotate(str(end), (end - 0.5, 12.5), ha="center", va="center")
        _cells(ax, 1.5 * piece, 9.6, L, 1, colour, numbers[:, None])
        _cells(ax, 8 + 3 * piece, 7.6, 1, 1, colour, [[numbers[2]]])
        _cells(ax, 8 + 3 * piece, 4.2, 2, 1, colour)
        _cells(ax, 8 + 3 * piece, 1.0, 2, 2, colour)
    width = 1.5 * pieces - 0.5
    ax.add_patch(Rectangle((-0.2, 6.5), width + 0.4, 1.2, fill=False, edgecolor=BLUE, lw=2.2))
    ax.annotate("", (7.8, 7.1), (width + 0.3, 7.1), arrowprops={"arrowstyle": "->", "color": BLUE, "lw": 2})
    ax.annotate(f"the recording: {pieces * L} rows", (0, 13.3), va="bottom")
    ax.annotate("cut, and laid\nside by side", (0, 9.9), va="bottom")
    for text, top in (
        (f"z ({pieces}, 1, 1): row 3 of all", 7.8),
        (f"x ({pieces}, 2, 1)", 4.4),
        (f"P ({pieces}, 2, 2)", 1.2),
    ):
        ax.annotate(text, (8, top), va="bottom", color=BLUE)
    ax.set(xlim=(-0.5, pieces * L + 0.5), ylim=(-1.3, 14.6))
    ax.axis("off")
    fig.suptitle("One call of numpy takes a row of all pieces", weight="bold")
    return fig


def draw_relay(pieces=4, L=30):
    """Return a figure of a track cut into pieces: pretended starts, then the real ones that a runner brings."""
    true, measured = walk(pieces * L)
    pretended = mpt.KalmanFilter(POSITIONS).filter(measured.reshape(pieces, L).T[:, None])[:, 0]  # from 0 exactly
    whole = mpt.KalmanFilter(replace(POSITIONS, P0=UNKNOWN)).filter(measured[:, None])[:, 0]
    second = np.arange(1, pieces * L + 1)
    starts = L * np.arange(pieces)
    ends = np.append(starts, pieces * L)
    at_ends = np.concatenate([[0.0], whole[L - 1 :: L]])
    fig, ax = plots.panels([["pretend"], ["relay"]], height=2.1)
    for axes in ax.values():
        for start in starts[1:]:
            axes.axvline(start, color="0.6", lw=0.8, ls=":")
        axes.plot(second, true, color="0.8", lw=4)
        axes.set(xlim=(-6, pieces * L + 6), ylim=(-12, 1.15 * true.max()))
    for start, estimates in zip(starts, pretended.T, strict=True):
        ax["pretend"].plot(start + np.arange(L + 1), np.append(0, estimates), color=BLUE)
    ax["pretend"].plot(starts, 0 * starts, "o", color=BLUE, ms=5)
    ax["relay"].plot(starts, at_ends[:-1], "o", color=BLUE, ms=5)
    arrow = {"arrowstyle": "->", "color": BLUE, "lw": 1.6, "shrinkA": 4, "shrinkB": 4}
    for i in range(pieces):
        ax["relay"].annotate("", (ends[i + 1], at_ends[i + 1]), (ends[i], at_ends[i]), arrowprops=arrow)
    texts = {"pretend": "each pretends to start at 0", "relay": "the runner: one step for each piece"}
    for name, text in texts.items():
        ax[name].annotate(text, (1, 0.85 * true.max()), color=BLUE)
    ax["relay"].annotate("grey: the true track", (pieces * L, 5), color="0.45", ha="right")
    plots.finish(ax["pretend"], "", "first: all pieces at once (m)")
    plots.finish(ax["relay"], "second", "then: one piece after the other (m)")
    fig.suptitle("All pieces run at once from a pretended start.\nThen a runner visits them.", weight="bold")
    return fig
