"""Figures that are saved: one file each, and a description in words and numbers that a test can compare.

nbval skips pictures. `save_figure` therefore shows, beside the PNG, what the figure plots as plain text: nbval compares
that exactly, and it changes when the data change by one percent. The files are the same bytes on every processor.
"""

from __future__ import annotations

import copy
import re
import sys
import zlib
from base64 import b64encode
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure

from mpt_helpers.tracks.files import write_together

from .project import project

# Values below this are rounding and differ between processors: they are described as zero.
FLOOR = 1e-12
# Drawn values below this are described with one significant digit: the rounding of the tracks plotted here reaches
# some 1e-14.
QUANTUM = 1e-9


@dataclass(frozen=True)
class SavedFigure:
    """A figure that was saved: notebooks show the picture and its alt text, tests compare the description."""

    png: bytes
    description: str
    alt: str = ""

    def __repr__(self):
        return self.description

    def _repr_mimebundle_(self, include=None, exclude=None):
        data = {"image/png": b64encode(self.png).decode(), "text/plain": self.description}
        return data, {"image/png": {"alt": self.alt}}


def save_figure(fig: Figure, name: str, folder: str | Path | None = None) -> SavedFigure:
    """Save a figure as {folder}/{name}.png and .svg, the same bytes on every run, and return it for display.

    The folder is the project's figures/, found from the working directory: the project's root or its notebooks/. A
    figure of pyplot is closed, so that a notebook does not show it twice. Raises ValueError for a name that is not a
    plain file name, and FileNotFoundError anywhere else without a folder.
    """
    if not re.fullmatch(r"\w+", name, re.ASCII):
        raise ValueError(f"name: needs letters, digits and underscores, got {name!r}")
    folder = project() / "figures" if folder is None else Path(folder)
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close(fig)  # and it does not take hold of the copy either
    settled = _settled(fig)
    png, svg = BytesIO(), BytesIO()
    settled.savefig(png, format="png", metadata={"Software": None})
    with matplotlib.rc_context({"svg.hashsalt": name}):
        settled.savefig(svg, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    rounded_svg = round_svg(svg.getvalue().decode()).encode()
    write_together({folder / f"{name}.png": png.getvalue(), folder / f"{name}.svg": rounded_svg})
    return SavedFigure(png.getvalue(), f"{name}.png\n{describe(settled)}", alt_text(settled))


def _settled(fig):
    """Return a copy whose drawn values and places are rounded: last bits differ between processors and move pixels."""
    units = [axis.get_units() for ax in fig.axes for axis in (ax.xaxis, ax.yaxis)]
    # The units of an axis of words stay the same object: they hold an itertools.count, which Python 3.14 cannot copy.
    fig = copy.deepcopy(fig, {id(each): each for each in units})
    for ax in fig.axes:
        scales = ax.get_xscale(), ax.get_yscale()
        for line in ax.lines:
            line.set_data(*map(_nine_digits, line.get_xydata().T, scales))
        for drawn in ax.collections:
            for path in drawn.get_paths():
                path.vertices = np.column_stack([*map(_nine_digits, path.vertices.T, scales)])
    if fig.get_layout_engine():
        fig.get_layout_engine().execute(fig)
    with matplotlib.rc_context({"figure.autolayout": False, "figure.constrained_layout.use": False}):
        fig.set_layout_engine(None)  # the layout stands; with "none" matplotlib would draw twice for each file
    for ax in fig.axes:
        ax.set_position(np.round(ax.get_position().bounds, 6))
        ax.set(xlim=_nine_digits(ax.get_xlim(), ax.get_xscale()), ylim=_nine_digits(ax.get_ylim(), ax.get_yscale()))
    return fig


def _nine_digits(values, scale):
    """Round to nine significant digits: of each value on a log scale, of the largest otherwise."""
    finite = np.where(np.isfinite(values), np.abs(values), 0)
    size = finite if scale == "log" else finite.max(initial=0)
    unit = 10.0 ** (np.floor(np.log10(np.where(size > 0, size, 1))) - 8)
    return np.round(values / unit) * unit


def round_svg(text: str) -> str:
    """Round the coordinates in an SVG to a hundredth of a point: their last digits differ between processors.

    >>> round_svg('<path d="M 1.23456 7 L 2.5 -0.000001" stroke-width="0.123456" transform="scale(0.015625)"/>')
    '<path d="M 1.23 7 L 2.5 0" stroke-width="0.123456" transform="scale(0.015625)"/>'
    """

    def rounded(number):
        return f"{round(float(number[0]), 2) + 0.0:g}"  # + 0.0 makes 0 of -0

    def with_rounded(place):
        return re.sub(r"-?\d+\.\d{3,}", rounded, place[0])

    return re.sub(r' (?:d|x|y)="[^"]*"|translate\([^)]*\)', with_rounded, text)


def alt_text(fig: Figure) -> str:
    """Say in words what a figure plots, for readers who do not see it: its title, its panels and their curves.

    >>> from reproduction.plots import finish, panels
    >>> fig, ax = panels([["s", "v"]])
    >>> for name in ax:
    ...     _ = ax[name].semilogy([1, 2], label="KF")
    ...     finish(ax[name], "step k", f"σ of {name}")
    >>> alt_text(fig)
    '2 panels. σ of s (log scale); σ of v (log scale), over step k. Curves: KF.'
    """
    alike = {}  # titles of the panels that share their x label and curves
    for ax in fig.axes:
        drawn = [*ax.lines, *ax.collections, *ax.patches]
        labels = dict.fromkeys(str(each.get_label()) for each in drawn)
        curves = "; ".join(label for label in labels if label and not label.startswith("_"))
        title = _title(ax) or ax.get_ylabel() or "untitled panel"
        if ax.get_yscale() == "log":
            title += " (log scale)"
        alike.setdefault((ax.get_xlabel(), curves), []).append(title)
    above = fig.get_suptitle()
    sentences = [above if above.endswith((".", "!", "?")) else f"{above}."] if above else []
    sentences += [f"{len(fig.axes)} panels."] if len(fig.axes) > 1 else []
    for (xlabel, curves), titles in alike.items():
        place = f", over {xlabel}" if xlabel else ""
        sentences.append(f"{'; '.join(titles)}{place}.")
        if curves:
            sentences.append(f"Curves: {curves}.")
    in_one_line = re.sub(r"\s+", " ", " ".join(sentences))
    return re.sub(r"[$\\{}]", "", in_one_line)


def describe(fig: Figure) -> str:
    """Return what a figure plots in words and numbers: texts and scales of all axes; points, extremes and mean of all
    that is drawn, with a checksum over the points at four significant digits (one below 1e-9, and zero below 1e-12).

    >>> from reproduction.plots import panels
    >>> fig, ax = panels([["a"]])
    >>> line = ax["a"].plot([1, 2, 3], [0.0, 0.5, 1.0], label="a")
    >>> print(describe(fig))
    axes 1: x '' linear 0.9..3.1; y '' linear -0.05..1.05
      line 'a': 3 points, x 1..3 mean 2, y 0..1 mean 0.5, checksum 43970567
    """
    lines = [f"text {text.get_text()!r}" for text in fig.texts]
    for i, ax in enumerate(fig.axes, 1):
        title = f"{_title(ax)!r} " if _title(ax) else ""
        lines.append(f"axes {i}: {title}{_describe_axis('x', ax.xaxis)}; {_describe_axis('y', ax.yaxis)}")
        lines += [f"  {_describe_drawn(*drawn)}" for drawn in _drawn(ax)]
        lines += [f"  text {text.get_text()!r}" for text in ax.texts]
        if ax.get_legend():
            lines.append(f"  {_describe_legend(ax.get_legend())}")
    lines += [_describe_legend(legend) for legend in fig.legends]
    return "\n".join(lines)


def _title(ax):
    return ax.get_title(loc="left") or ax.get_title()


def _describe_axis(side, axis):
    text = f"{side} {axis.get_label_text()!r} {axis.get_scale()}"
    if axis.axes.get_aspect() != "auto" and axis.axes.get_adjustable() == "datalim":
        return f"{text} to scale"  # its limits fill the panel, whose size depends on the version of matplotlib
    low, high = axis.get_view_interval()
    return f"{text} {_digits(low)}..{_digits(high)}"


def _describe_legend(legend):
    return f"legend {[text.get_text() for text in legend.get_texts()]}"


def _drawn(ax):
    """Yield all that axes show: its kind, its label, its points (n, 2), and the values shown by colours."""
    for line in ax.lines:
        yield "line", line.get_label(), line.get_xydata(), []
    for drawn in ax.collections:
        if isinstance(drawn, PathCollection):
            kind, points = "points", drawn.get_offsets()
        else:
            outlines = [path.vertices for path in drawn.get_paths()]
            kind, points = "area", np.concatenate([np.empty((0, 2)), *outlines])
        values = [] if drawn.get_array() is None else drawn.get_array()
        yield kind, drawn.get_label(), points, values
    for patch in ax.patches:
        yield "patch", patch.get_label(), patch.get_patch_transform().transform(patch.get_path().vertices), []
    for image in ax.images:
        yield "image", image.get_label(), np.empty((0, 2)), image.get_array()


def _describe_drawn(kind, label, points, values):
    points = np.ma.filled(np.ma.asarray(points, float), np.nan)
    values = np.ma.filled(np.ma.asarray(values, float), np.nan).ravel()
    text = f"{kind} {label!r}: {len(points)} points"
    columns = dict(zip("xy", points.T, strict=True)) | {"value": values}
    for name, column in columns.items():
        finite = column[np.isfinite(column)]
        if finite.size:
            text += f", {name} {_digits(finite.min())}..{_digits(finite.max())} mean {_digits(_mean(finite))}"
    digits = ",".join(_digits(value) for value in (*points.ravel(), *values))
    return f"{text}, checksum {zlib.crc32(digits.encode()):08x}"


def _mean(values):
    """Return the mean; 0 where values of nine digits cancel, since what is left then differs between processors."""
    mean = values.mean()
    return mean if abs(mean) > 1e-9 * np.abs(values).max() else 0.0


def _digits(value):
    if abs(value) < 0.9 * FLOOR:
        return "0"
    return f"{value:.4g}" if abs(value) >= QUANTUM else f"{value:.0e}"
