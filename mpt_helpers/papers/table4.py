"""Table 4 of 2014: from which numbers it was made, and a map of which of its cells are right."""

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch, Rectangle

RIGHT, WRONG, LOST, NONE = range(4)
COLOURS = {RIGHT: "#d2e4ee", WRONG: "#d55e00", LOST: "white", NONE: "0.88"}


def agrees(value, printed):
    """Return whether a number, or which of an array of them, rounds to the printed digits; a tie may go either way."""
    half_a_digit = 0.5 * 10.0 ** -len(printed.partition(".")[2])
    return np.abs(value - float(printed)) <= half_a_digit * (1 + 1e-9)


def numbers_behind(ratios, known, limit=10_000):
    """Return from which whole numbers a table of ratios was made.

    ratios maps (i, j) to the printed text of number i over number j, "?" where it is lost. known maps some of the
    indices to their numbers. For each other index the result lists the whole numbers up to limit that agree, at the
    printed digits, with every ratio to a known number.

    >>> numbers_behind({("b", "a"): "0.500", ("a", "b"): "2.00"}, known={"a": 10})
    {'b': [5]}
    """
    numbers = np.arange(1, limit + 1)
    fits = {i: np.ones(limit, bool) for pair in ratios for i in pair if i not in known}
    for (i, j), printed in ratios.items():
        if printed != "?" and i in fits and j in known:
            fits[i] &= agrees(numbers / known[j], printed)
        if printed != "?" and j in fits and i in known:
            fits[j] &= agrees(known[i] / numbers, printed)
    return {i: numbers[fit].tolist() for i, fit in fits.items()}


def compare(ratios, numbers):
    """Return the state of each cell of a table of ratios, and the cells that turn a comparison round.

    ratios maps (row, column) to the printed text, "?" where it is lost, of the row's number over the column's. A wrong
    ratio turns a comparison round if it is above 1 and the right one below, or the other way round.

    >>> compare({(0, 1): "0.50", (1, 0): "0.90"}, numbers=[1, 2])
    (array([[3, 0],
           [1, 3]]), [(1, 0)])
    """
    states = np.full((len(numbers), len(numbers)), NONE)
    turned = []
    for (row, column), printed in ratios.items():
        ratio = numbers[row] / numbers[column]
        if printed == "?":
            states[row, column] = LOST
        elif agrees(ratio, printed):
            states[row, column] = RIGHT
        else:
            states[row, column] = WRONG
            if (float(printed) - 1) * (ratio - 1) < 0:
                turned.append((row, column))
    return states, turned


def draw(ax, states, names, notes, framed=()):
    """Draw a table as a map: a square for each cell, coloured by its state, and a legend below.

    states is a square array of RIGHT, WRONG, LOST and NONE, names are those of its rows and columns. notes maps some of
    the names to what is written at the right of their row; these names have the colour of a wrong cell. framed lists
    the (row, column) of cells that get a black frame.
    """
    size = len(names)
    edges = np.arange(size + 1) - 0.5
    colours = ListedColormap(list(COLOURS.values()))
    ax.pcolormesh(edges, edges, states, cmap=colours, vmin=RIGHT, vmax=NONE, edgecolors="white", linewidth=1.5)
    for row, column in np.argwhere(np.asarray(states) == LOST):
        ax.text(column, row, "?", ha="center", va="center", color="0.4")
    for row, column in framed:
        ax.add_patch(Rectangle((column - 0.46, row - 0.46), 0.92, 0.92, fill=False, linewidth=2.5))
    ax.set(xlim=(-0.5, size - 0.5), ylim=(size - 0.5, -0.5), aspect="equal")
    ax.xaxis.tick_top()
    ax.set_xticks(range(size), names, rotation=90)
    ax.set_yticks(range(size), names)
    for label in [*ax.get_xticklabels(), *ax.get_yticklabels()]:
        label.set_color(COLOURS[WRONG] if label.get_text() in notes else "black")
    for name, note in notes.items():
        ax.text(size - 0.3, names.index(name), note, va="center", color=COLOURS[WRONG])
    ax.tick_params(length=0)
    ax.grid(False)
    ax.spines[:].set_visible(False)
    meanings = {"right": RIGHT, "wrong": WRONG, "lost by our copy": LOST}
    handles = [Patch(facecolor=COLOURS[state], edgecolor="0.7", label=text) for text, state in meanings.items()]
    ax.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0), ncols=3)
