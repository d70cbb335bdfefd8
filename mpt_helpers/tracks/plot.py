"""The picture of a cleaned track: the map, and below it the speed with its band."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .report import KM_H, distance_and_speeds
from .writers import degrees_of, segment_of_rows, velocities_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .result import Cleaned

LONG = 3 * 3600.0  # s: longer tracks are drawn over hours
MOSTLY_PAUSES = 20.0  # a recording so many times longer than its rides is drawn without its pauses
# Panels one below the other, 5.2 inches wide, so that text of 11 pt is legible on a phone 358 pixels wide.
WIDTH, MAP_HEIGHT, SPEED_HEIGHT = 5.2, 5.0, 3.2
NUMBERS = 5  # steps along an axis at most: six numbers of five digits fit


def figure(c: Cleaned) -> Figure:
    """Return the picture of a Cleaned: the map, and below it the speed with its band."""
    import matplotlib
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    from .style import COLOURS, STYLE

    with matplotlib.rc_context(STYLE):
        fig = Figure(figsize=(WIDTH, MAP_HEIGHT + SPEED_HEIGHT), layout="constrained")
        axes = fig.subplots(2, 1, height_ratios=[MAP_HEIGHT, SPEED_HEIGHT])
        blue, orange, green, pink = COLOURS[:4]
        _draw_map(axes[0], c, line=blue, refused=orange, start=green)
        _draw_speed(axes[1], c, line=blue, refused=orange, band=pink)
        handles, labels = (a + b for a, b in zip(*(ax.get_legend_handles_labels() for ax in axes), strict=True))
        fig.legend(handles, labels, loc="outside lower center", ncols=2)
        for ax in axes:
            ax.xaxis.set_major_locator(MaxNLocator(NUMBERS))
    return fig


def _on_one_map(c, z):
    """Return positions (N, 2) in km on one chart; a single axis points east."""
    z = np.column_stack([z, np.zeros(len(z))])[:, :2]
    if c.source is not None and c.source.charts:
        z = c.source.charts[0].metres(*degrees_of(c, z))
    return z / 1000


def _draw_map(ax, c, line, refused, start):
    position = _on_one_map(c, c.x[:, :4:2])
    number = segment_of_rows(c)
    for k in range(c.stretches):
        rows = np.flatnonzero(number == k)
        ax.plot(*position[rows].T, color=line, linewidth=1.4, label="smoothed" if k == 0 else None)
    inside = np.isfinite(position[:, 0])
    for row in c.starts:
        before = np.flatnonzero(inside[:row])[-1]
        label = "jumps" if row == c.starts[0] else None
        ax.plot(*position[[before, row]].T, ":", color="0.4", linewidth=1.4, label=label)
    low, high = position[inside].min(axis=0), position[inside].max(axis=0)
    margin = 0.08 * max((high - low).max(), 0.01)
    if len(c.refused):
        recorded = _on_one_map(c, c.z)[c.refused]
        near = ((recorded >= low - margin) & (recorded <= high + margin)).all(axis=1)
        label = f"refused: {len(c.refused)}" + ("" if near.all() else f", {np.sum(~near)} off the map")
        ax.plot(*recorded[near].T, "x", color=refused, markersize=6, linestyle="none", label=label)
    first, last = np.flatnonzero(inside)[[0, -1]]
    ax.plot(*position[first], "o", color=start, markersize=7, linestyle="none", label="start")
    ax.plot(*position[last], "s", color="0.2", markersize=6, linestyle="none", label="end")
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_xlabel("east (km)")
    name = "track" if c.source is None else Path(c.source.path).name.encode(errors="replace").decode()
    name = name if len(name) <= 26 else f"{name[:23]}..."
    title = f"{name}: {distance_and_speeds(c)['kilometres']:.1f} km"
    ax.set_title(title, loc="left", parse_math=False)  # a name may have $ in it
    ax.set_ylabel("north (km)")


def _draw_speed(ax, c, line, refused, band):
    speed = np.linalg.norm(velocities_of(c)[:, :2], axis=1)
    sigma = np.sqrt(c.P[:, 1, 1])
    time, recorded = _time_of_the_picture(c)
    unit, seconds = ("h", 3600) if np.nanmax(time) > LONG else ("min", 60)
    time = time / seconds
    number = segment_of_rows(c)
    for k in range(c.stretches):
        rows = np.flatnonzero(number == k)
        low, high = (np.maximum(speed[rows] + sign * 1.96 * sigma[rows], 0) * KM_H for sign in (-1, 1))
        label = "stated 95 % band" if k == 0 else None
        ax.fill_between(time[rows], low, high, color=band, alpha=0.6, linewidth=0, label=label)
        ax.plot(time[rows], speed[rows] * KM_H, color=line, linewidth=0.9)
    known = speed[np.isfinite(speed)]
    top = 1.25 * max(float(np.quantile(known, 0.999)), 0.1) * KM_H
    ax.set_ylim(0, top)
    if len(c.refused):
        bottom = np.full(len(c.refused), 0.02 * top)
        ax.plot(time[c.refused], bottom, "|", color=refused, markersize=9)
    ax.set_xlabel(f"{recorded} ({unit})")
    ax.set_title("speed (km/h)", loc="left")


def _time_of_the_picture(c):
    """Return the seconds (N,) since the start, and their name; without pauses if these leave no room for the rides."""
    t = c.t[c.line.rows]
    ridden = np.where(np.diff(c.line.number) == 0, np.diff(c.line.t), 0.0)
    time = np.full(len(c.t), np.nan)
    if np.ptp(t) <= MOSTLY_PAUSES * ridden.sum():
        inside = (c.t >= t.min()) & (c.t <= t.max())
        time[inside] = c.t[inside] - t.min()
        return time, "time"
    time[c.line.rows] = np.append(0.0, np.cumsum(ridden))
    return time, "time without pauses"
