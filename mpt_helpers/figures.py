"""Figures: one saved file each, and a description in words and numbers that a test can compare.

Every function raises ValueError or TypeError for arguments that are not what it says, naming the argument.

A PNG cannot be compared across machines, so `save_figure` shows beside it, as plain text, what the figure plots. The
style is in notebooks/matplotlibrc.
"""

import re
import zlib
from base64 import b64encode
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from os import PathLike
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Text

from . import checks
from .files import write_together

# Gaps below this are rounding, and other digits on every processor: they are drawn at it.
FLOOR = 1e-12
# Below this a drawn value has one digit, in the picture and in the description: rounding reaches some 1e-14 on the
# tracks plotted here.
QUANTUM = 1e-9


def panels(layout, height=2.3):
    """Return a figure of the width of a page and its axes by name.

    layout is a list of rows of names; a name that stands twice spans both places. height is that of a row, in inches.

    >>> fig, ax = panels([["s_x", "s_y"], ["gap", "gap"]])
    >>> sorted(ax)
    ['gap', 's_x', 's_y']
    """
    need, height = "rows of as many names each, a name filling a rectangle", checks.positive("height", height)
    layout = [checks.several("layout", row, need) for row in checks.several("layout", layout, need)]
    for name in (name for row in layout for name in row):
        checks.instance("layout", name, str)
    fig = Figure(figsize=(7.2, height * len(layout)), layout="constrained")
    try:
        return fig, fig.subplot_mosaic([list(row) for row in layout])
    except ValueError:
        checks.refuse("layout", need, checks.brief(layout))


def tracking(x, z, estimates, P, gaps):
    """Return a figure of one track: position, its error and velocity of every axis, and the gaps between estimates.

    x (N, 2d) are the true states [s_x v_x s_y v_y ...] of d axes, z (N, d) the measurements. estimates maps two labels
    to estimates (N, 2d): the first is drawn solid, the second dashed. P (N, 2d, 2d) is the covariance of the first: the
    band is ± 2 standard deviations. gaps is what `draw_gaps` draws.

    >>> x, z, P = np.zeros((3, 2)), np.zeros((3, 1)), np.zeros((3, 2, 2))
    >>> fig = tracking(x, z, {"KF": x, "SSKF": x}, P, gaps={"KF - SSKF": np.zeros(3)})
    >>> [ax.get_title(loc="left") for ax in fig.axes][:3]
    ['position (m), x axis', 'position error (m), x axis', 'velocity (m/s), x axis']
    """
    z = checks.finite("z", z, ("N", 1), ("N", 2), ("N", 3))
    N, d = z.shape
    x, P = checks.finite("x", x, (N, 2 * d)), checks.finite("P", P, (N, 2 * d, 2 * d))
    _not_negative("P", np.einsum("kii->ki", P))
    estimates, gaps = _curves("estimates", estimates, (2,), (N, 2 * d)), _gaps(gaps)
    letters = "xyz"[:d]
    rows = ["position (m)", "position error (m)", "velocity (m/s)"]
    fig, ax = panels([[f"{row}, {letter} axis" for letter in letters] for row in rows] + [["gap"] * len(letters)], 1.8)
    for i, letter in enumerate(letters):
        true_s, true_v = x[:, 2 * i], x[:, 2 * i + 1]
        var_s, var_v = P[:, 2 * i, 2 * i], P[:, 2 * i + 1, 2 * i + 1]
        s = {label: each[:, 2 * i] for label, each in estimates.items()}
        v = {label: each[:, 2 * i + 1] for label, each in estimates.items()}
        error = {label: each - true_s for label, each in s.items()}
        drawn = [(true_s, s, var_s, z[:, i]), (0 * true_s, error, var_s), (true_v, v, var_v)]
        for row, components in zip(rows, drawn, strict=True):
            title = f"{row}, {letter} axis"
            _draw_component(ax[title], *components)
            ax[title].set_title(title, loc="left")
        ax[title].set_xlabel("step k")
    draw_gaps(ax["gap"], gaps)
    legend = ax[f"position (m), {letters[0]} axis"].get_legend_handles_labels()
    fig.legend(*legend, loc="outside upper center", ncols=5)
    return fig


def _draw_component(ax, true, estimates, variance, measured=None):
    k = np.arange(1, len(true) + 1)
    (first, solid), (second, dashed) = estimates.items()
    sigma = np.sqrt(variance)
    ax.fill_between(k, solid - 2 * sigma, solid + 2 * sigma, color="C0", alpha=0.25, lw=0, label="estimate ± 2σ")
    if measured is not None:
        ax.plot(k, measured, ".", color="0.45", ms=3.5, label="measured")
    ax.plot(k, true, color="black", lw=0.9, label="true")
    ax.plot(k, solid, color="C0", lw=1.8, label=first)
    ax.plot(k, dashed, "--", color="C1", lw=1.5, label=second)


def following(k, true, estimated, mean, sigma, label, last=None):
    """Return a figure of one track and its axes by name: position and position error of every axis.

    k (N,) are the steps, true and estimated (N, d) the positions on d axes, mean and sigma (N, d) the mean error and
    its standard deviation: the band is mean ± 2σ. The error is drawn twice, the second time enlarged. last names a
    panel below that is left empty.

    >>> one = np.ones((3, 1))
    >>> fig, ax = following(range(3), one, one, 0 * one, one, "estimate", last="steps")
    >>> list(ax)
    ['position (m), x axis', 'error (m), x axis', 'error (m), x axis, enlarged', 'steps']
    """
    true = checks.finite("true", true, ("N", 1), ("N", 2), ("N", 3))
    k = checks.finite("k", k, true.shape[:1])
    named = {"estimated": estimated, "mean": mean, "sigma": sigma}
    estimated, mean, sigma = (checks.finite(name, value, true.shape) for name, value in named.items())
    _not_negative("sigma", sigma)
    checks.instance("label", label, str)
    checks.instance("last", "" if last is None else last, str)
    letters = "xyz"[: true.shape[1]]
    rows = ["position (m), {} axis", "error (m), {} axis", "error (m), {} axis, enlarged"]
    layout = [[row.format(letter) for letter in letters] for row in rows]
    fig, ax = panels(layout + ([[last] * len(letters)] if last else []), 1.8)
    for i, names in enumerate(zip(*layout, strict=True)):
        position, error, enlarged = (ax[name] for name in names)
        position.plot(k, true[:, i], color="black", lw=0.9, label="real position")
        position.plot(k, estimated[:, i], "--", color="C1", lw=1.5, label=label)
        for each in (error, enlarged):
            low, high = mean[:, i] - 2 * sigma[:, i], mean[:, i] + 2 * sigma[:, i]
            each.fill_between(k, low, high, color="C0", alpha=0.25, lw=0, label="mean error ± 2σ")
            each.plot(k, true[:, i] - estimated[:, i], color="C2", lw=1.2, label="its error")
        enlarged.set_ylim(-4 * sigma[-1, i], 4 * sigma[-1, i])
        for name in names:
            ax[name].set_title(name, loc="left")
        enlarged.set_xlabel("step k")
    handles = position.get_legend_handles_labels()[0] + error.get_legend_handles_labels()[0]
    fig.legend(handles=handles, loc="outside upper center", ncols=4)
    return fig, ax


def steps_ahead(ax, errors, real, stated):
    """Draw how the error of a prediction grows with the number of steps N = 0, 1, ...

    errors (N, K) are K errors of one track for each N, real and stated (N,) the standard deviations; bands are ± 2σ.

    >>> fig, ax = panels([["steps"]])
    >>> steps_ahead(ax["steps"], np.zeros((3, 5)), real=np.ones(3), stated=np.ones(3))
    """
    checks.instance("ax", ax, Axes)
    errors = checks.finite("errors", errors, ("N", "K"))
    real, stated = (checks.finite(name, each, errors.shape[:1]) for name, each in (("real", real), ("stated", stated)))
    _not_negative("real", real)
    _not_negative("stated", stated)
    N = np.arange(len(errors))
    ax.fill_between(N, -2 * stated, 2 * stated, color="0.85", lw=0, label="± 2σ stated")
    ax.fill_between(N, -2 * real, 2 * real, color="C0", alpha=0.3, lw=0, label="± 2σ real")
    ax.plot(np.repeat(N, errors.shape[1]), errors.ravel(), ".", color="C2", ms=3, label="errors of this track")
    finish(ax, "steps ahead N", "prediction error (m), x axis, after the start")
    ax.legend(loc="upper left", ncols=3)


def effects(values, results, labels, xlabel):
    """Return a figure of how results depend on something: a column for each model, a row for each result.

    results maps (result, model) to an array of a row for each of the values and a column for each of the labels. All
    axes are logarithmic.

    >>> fig = effects([1, 2], {("σ (m)", "CV"): np.ones((2, 1)), ("σ (m)", "CA"): np.ones((2, 1))}, ["N = 0"], "Δt (s)")
    >>> [ax.get_title(loc="left") for ax in fig.axes]
    ['σ (m), CV', 'σ (m), CA']
    """
    values = checks.finite("values", values, ("N",))
    if values.min() <= 0:
        checks.refuse("values", "positive numbers, for a logarithmic axis", f"{values.min():.6g}")
    labels, xlabel = checks.several("labels", labels, "one to three labels"), checks.instance("xlabel", xlabel, str)
    if len(labels) > 3:
        checks.refuse("labels", "one to three labels", len(labels))
    names = checks.several("results", checks.instance("results", results, Mapping), "at least one result")
    if not all(isinstance(name, tuple) and len(name) == 2 for name in names):
        checks.refuse("results", "pairs (result, model) as keys", checks.brief(names))
    results = {name: checks.finite("results", each, (len(values), len(labels))) for name, each in results.items()}
    rows, columns = (list(dict.fromkeys(each)) for each in zip(*names, strict=True))
    if len(rows) * len(columns) != len(results):
        checks.refuse("results", "every result for every model", checks.brief(names))
    fig, ax = panels([[f"{row}, {column}" for column in columns] for row in rows])
    for (row, column), result in results.items():
        for curve, label, style in zip(np.transpose(result), labels, ("o-", "s--", "^:"), strict=False):
            ax[f"{row}, {column}"].loglog(values, curve, style, ms=4, label=label)
        finish(ax[f"{row}, {column}"], xlabel, f"{row}, {column}")
        ax[f"{row}, {column}"].get_legend().remove()
    fig.legend(*fig.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=len(labels))
    return fig


def coordinate(t, truth, measured, estimates, sigma):
    """Return a figure of one coordinate: its place, the error of the place, its velocity, and the error of an INS.

    t (N,) are times in seconds; truth is (N, 2) or, with the constant error of an INS, (N, 3); measured (N,) are the
    places. estimates maps two labels to estimates (n, 2) or (n, 3) of the last n times: the first is drawn solid, the
    second dashed. sigma are the standard deviations of the first, in its shape: the band is ± 2 sigma.

    >>> t, x = np.arange(3.0), np.ones((3, 2))
    >>> fig = coordinate(t, truth=x, measured=t, estimates={"line fit": x[1:]}, sigma=x[1:])
    >>> [ax.get_title(loc="left") for ax in fig.axes]
    ['position (m)', 'position error (m)', 'velocity (m/s)']
    """
    truth = checks.finite("truth", truth, ("N", 2), ("N", 3))
    t, measured = (checks.finite(name, each, truth.shape[:1]) for name, each in (("t", t), ("measured", measured)))
    estimates = _curves("estimates", estimates, (1, 2), ("n", 2), ("n", 3))
    for x in estimates.values():
        if len(x) > len(t) or x.shape[1] > truth.shape[1]:
            checks.refuse("estimates", f"at most the shape of truth, {truth.shape}", f"shape {x.shape}")
    sigma = checks.finite("sigma", sigma, next(iter(estimates.values())).shape)
    _not_negative("sigma", sigma)
    names = ["position (m)", "velocity (m/s)", "constant error of the INS (m/s)"][: truth.shape[1]]
    fig, ax = panels([["position (m)", "position error (m)"], names[-2:] if len(names) == 3 else names[1:] * 2])
    ax["position (m)"].plot(t, measured, ".", color="0.45", ms=3.5, label="measured")
    for i, name in enumerate(names):
        components = {label: x[:, i] for label, x in estimates.items() if x.shape[1] > i}
        _draw_estimates(ax[name], t, truth[:, i], components, sigma[:, i])
    errors = {label: x[:, 0] - truth[len(t) - len(x) :, 0] for label, x in estimates.items()}
    _draw_estimates(ax["position error (m)"], t, 0 * t, errors, sigma[:, 0])
    for name, each in ax.items():
        each.set_title(name, loc="left")
        each.set_xlabel("time (s)")
    fig.legend(*ax["position (m)"].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return fig


def _draw_estimates(ax, t, true, estimates, sigma):
    # A fitted straight line moves a pixel with its last bits, which are others in another place of the memory.
    estimates = {label: np.round(x, 9) for label, x in estimates.items()}
    first = next(iter(estimates.values()))
    low, high = np.round([first - 2 * sigma, first + 2 * sigma], 9)
    ax.fill_between(t[-len(first) :], low, high, color="C0", alpha=0.25, lw=0, label="estimate ± 2σ")
    ax.plot(t, true, color="black", lw=0.9, label="true")
    for i, (label, x) in enumerate(estimates.items()):
        ax.plot(t[-len(x) :], x, ["-", "--"][i], color=f"C{i}", label=label)


def draw_gaps(ax, gaps):
    """Draw gaps between curves over the steps k = 1 ... N on a log scale, those at rounding level clipped and labelled.

    gaps maps a label to the gaps of each step: a vector, or (N, n) of which the largest of each step is drawn.

    >>> fig, ax = panels([["gap"]])
    >>> draw_gaps(ax["gap"], {"KF - LF": [1e-16, 0.0], "KF - SSKF": [0.1, 0.05]})
    >>> ax["gap"].lines[0].get_ydata()
    array([1.e-12, 1.e-12])
    """
    checks.instance("ax", ax, Axes)
    gaps = _gaps(gaps)
    styles = ["-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1))]
    for i, (label, gap) in enumerate(gaps.items()):
        largest = np.reshape(gap, (len(gap), -1)).max(axis=1)
        k = np.arange(1, len(gap) + 1)
        ax.semilogy(k, visible_gap(largest), ls=styles[i % len(styles)], label=label)
    ax.axhspan(FLOOR / 100, FLOOR, color="0.9", lw=0)
    ax.set_ylim(FLOOR / 100, None)
    ax.text(0.99, FLOOR / 50, "below 1e-12: rounding", transform=ax.get_yaxis_transform(), ha="right", fontsize=9)
    finish(ax, "step k", "largest gap in the state (m, m/s)")


def _curves(name, curves, counts, *shapes):
    """Return arrays of one of these shapes by their labels, so many of them."""
    checks.instance(name, curves, Mapping)
    if len(curves) not in counts:
        checks.refuse(name, f"{' or '.join(map(str, counts))} of them by their labels", len(curves))
    return {checks.instance(name, label, str): checks.finite(name, each, *shapes) for label, each in curves.items()}


def _gaps(gaps):
    checks.several("gaps", checks.instance("gaps", gaps, Mapping), "at least one gap by its label")
    gaps = _curves("gaps", gaps, (len(gaps),), ("N",), ("N", "n"))
    for gap in gaps.values():
        _not_negative("gaps", gap)
    return gaps


def _not_negative(name, values):
    if values.min() < 0:
        checks.refuse(name, "numbers that are not negative", f"{values.min():.6g}")


def finish(ax, xlabel, title):
    """Label the x axis, say above the axes what they show, and name the curves.

    >>> fig, ax = panels([["a"]])
    >>> _ = ax["a"].plot([1, 2], [3, 4], label="K")
    >>> finish(ax["a"], "step k", "gain")
    """
    checks.instance("ax", ax, Axes)
    ax.set_xlabel(checks.instance("xlabel", xlabel, str))
    ax.set_title(checks.instance("title", title, str), loc="left")
    ax.legend()
    if ax.get_xscale() == "linear":
        ax.xaxis.get_major_locator().set_params(integer=True)


def visible_gap(gap):
    """Return gaps as they are drawn: clipped at 1e-12, with one digit below 1e-9 and three above.

    A gap is the difference of numbers of order 10, so that its digits beyond some 1e-14 are rounding: drawn, they would
    move a pixel on another processor.

    >>> visible_gap([0.12345, 1.2345e-10, 1e-17])
    array([1.23e-01, 1.00e-10, 1.00e-12])
    """
    gap = checks.finite("gap", gap)
    _not_negative("gap", gap)
    gap = np.maximum(gap, FLOOR)
    unit = 10.0 ** (np.floor(np.log10(gap)) - np.where(gap < QUANTUM, 0, 2))
    return np.round(gap / unit) * unit


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


def save_figure(fig, name, folder="../figures"):
    """Save a figure as {folder}/{name}.png and .svg, the same bytes on every run, and return it for display.

    Raises TypeError for anything but a matplotlib Figure, ValueError for a name that is not a plain file name or a
    folder that does not exist.
    """
    checks.instance("fig", fig, Figure)
    if not re.fullmatch(r"\w+", checks.instance("name", name, str), re.ASCII):
        checks.refuse("name", "letters, digits and underscores", repr(name))
    if not Path(checks.instance("folder", folder, (str, PathLike))).is_dir():
        checks.refuse("folder", "a folder that exists", repr(str(folder)))
    _settle(fig)
    png, svg = BytesIO(), BytesIO()
    fig.savefig(png, format="png", metadata={"Software": None})
    with rc_context({"svg.hashsalt": name}):
        fig.savefig(svg, format="svg", metadata={"Date": None, "Creator": None})
    rounded = round_svg(svg.getvalue().decode()).encode()
    write_together({Path(folder) / f"{name}.png": png.getvalue(), Path(folder) / f"{name}.svg": rounded})
    return SavedFigure(png.getvalue(), f"{name}.png\n{describe(fig)}", alt_text(fig))


def _settle(fig):
    """Round what is drawn, and where: the last bits differ between processors, and with them a pixel at an edge."""
    for ax in fig.axes:
        scales = ax.get_xscale(), ax.get_yscale()
        for line in ax.lines:
            line.set_data(*map(_nine_digits, line.get_data(), scales))
        for path in (path for each in ax.collections for path in each.get_paths()):
            path.vertices[:] = np.column_stack(list(map(_nine_digits, path.vertices.T, scales)))
    if layout := fig.get_layout_engine():
        layout.execute(fig)
    fig.set_layout_engine("none")  # the layout stands: making it takes longer than writing the file
    for ax in fig.axes:
        ax.set_position(np.round(ax.get_position().bounds, 6))
        ax.set(xlim=_nine_digits(ax.get_xlim(), ax.get_xscale()), ylim=_nine_digits(ax.get_ylim(), ax.get_yscale()))


def _nine_digits(values, scale):
    """Round to nine digits: of each value on a log scale, of the largest otherwise."""
    values = np.asarray(values, float)
    size = np.abs(values) if scale == "log" else np.nanmax(np.abs(values), initial=0, keepdims=True)
    unit = 10.0 ** (np.floor(np.log10(np.where(size > 0, size, 1))) - 8)
    return np.round(values / unit) * unit


def round_svg(text):
    """Round the coordinates in an SVG to a hundredth of a point: their last digits differ between processors.

    >>> round_svg('<path d="M 1.23456 7 L 2.5 -0.000001" stroke-width="0.123456" transform="scale(0.015625)"/>')
    '<path d="M 1.23 7 L 2.5 0" stroke-width="0.123456" transform="scale(0.015625)"/>'
    """
    checks.instance("text", text, str)
    return re.sub(r' (?:d|x|y)="[^"]*"|translate\([^)]*\)', lambda place: _round_all(place[0]), text)


def _round_all(text):
    return re.sub(r"-?\d+\.\d{3,}", lambda number: f"{round(float(number[0]), 2) + 0.0:g}", text)


def alt_text(fig):
    """Say in words what a figure plots, for readers who do not see it: its panels and their curves.

    >>> fig, ax = panels([["s", "v"]])
    >>> for name in ax:
    ...     _ = ax[name].semilogy([1, 2], label="KF")
    ...     finish(ax[name], "step k", f"σ of {name}")
    >>> alt_text(fig)
    '2 panels. σ of s (log scale); σ of v (log scale), over step k. Curves: KF.'
    """
    alike = {}
    for ax in checks.instance("fig", fig, Figure).axes:
        drawn = [*ax.lines, *ax.collections, *ax.patches, *ax.images]
        labels = dict.fromkeys(str(each.get_label()) for each in drawn)
        curves = "; ".join(label for label in labels if label and not label.startswith("_"))
        log = " (log scale)" if ax.get_yscale() == "log" else ""
        alike.setdefault((ax.get_xlabel(), curves), []).append(_title(ax) + log)
    count = f"{len(fig.axes)} panels. " if len(fig.axes) > 1 else ""
    return count + " ".join(
        "; ".join(titles) + (f", over {xlabel}" if xlabel else "") + (f". Curves: {curves}." if curves else ".")
        for (xlabel, curves), titles in alike.items()
    )


def describe(fig):
    """Return what a figure plots, in words and numbers.

    For each axes it says its texts and scales, and for everything drawn in it the number of points, the extremes, the
    mean, and a checksum over all points at four digits (one digit below 1e-9, and zero below 1e-12).

    >>> fig, ax = panels([["a"]])
    >>> line = ax["a"].plot([1, 2, 3], [0.0, 0.5, 1.0], label="a")
    >>> print(describe(fig))
    axes 1: x '' linear 0.9..3.1; y '' linear -0.05..1.05
      line 'a': 3 points, x 1..3 mean 2, y 0..1 mean 0.5, checksum 43970567
    """
    checks.instance("fig", fig, Figure)
    lines = [f"text {text.get_text()!r}" for text in fig.texts]
    for i, ax in enumerate(fig.axes, 1):
        sides = [
            f"{side} {axis.get_label_text()!r} {axis.get_scale()} {_digits(axis.get_view_interval(), '..')}"
            for side, axis in (("x", ax.xaxis), ("y", ax.yaxis))
        ]
        title = _title(ax)
        lines.append(f"axes {i}: " + (f"{title!r} " if title else "") + "; ".join(sides))
        drawn = [*ax.lines, *ax.collections, *ax.patches, *ax.images, *ax.texts]
        lines += [f"  {_describe_artist(artist)}" for artist in drawn]
        lines += [f"  {_describe_legend(ax.get_legend())}"] if ax.get_legend() else []
    return "\n".join(lines + [_describe_legend(legend) for legend in fig.legends])


def _title(ax):
    return ax.get_title(loc="left") or ax.get_title()


def _describe_legend(legend):
    return f"legend {[text.get_text() for text in legend.get_texts()]}"


def _describe_artist(artist):
    if isinstance(artist, Text):
        return f"text {artist.get_text()!r}"
    kind, points = _points(artist)
    ranges = [
        f"{side} {_digits((values.min(), values.max()), '..')} mean {_digits([values.mean()])}"
        for side, values in zip("xy", points.T, strict=True)
    ]
    checksum = zlib.crc32(_digits(points.ravel()).encode())
    return f"{kind} {artist.get_label()!r}: {len(points)} points, {', '.join(ranges)}, checksum {checksum:08x}"


def _points(artist):
    if isinstance(artist, Line2D):
        return "line", np.asarray(artist.get_xydata(), float)
    if isinstance(artist, AxesImage):
        rows, columns = np.indices(artist.get_array().shape)
        return "image", np.column_stack([(rows + columns).ravel(), artist.get_array().ravel()]).astype(float)
    if isinstance(artist, Patch):
        return "patch", artist.get_patch_transform().transform(artist.get_path().vertices)
    paths = [path.vertices for path in artist.get_paths()]
    if len(artist.get_offsets()) > 1:
        paths = [artist.get_offsets()]
    return "area", np.concatenate(paths)


def _digits(values, separator=","):
    return separator.join(map(_digit_text, values))


def _digit_text(value):
    if abs(value) < 0.9 * FLOOR:
        return "0"
    return f"{value:.4g}" if abs(value) >= QUANTUM else f"{value:.0e}"
