"""The drawings and tables of the notebook on the paper of 2007: one function for each."""

from itertools import permutations

import numpy as np

from mpt_helpers import plots
from mpt_helpers.lasting import lasting_error
from mpt_helpers.metrics import rms

from . import recorded
from .positioning import line_sigma

LENGTHS = np.array([2, 3, 5, 10, 20, 35, 50, 75, 100])
STYLES = ("-", "--")  # of the kinds of range
COLOURS = ("C0", "C1", "C2", "C3")  # of the stations


def cases(tables=None):
    """Return the recorded cases, by "station, kind", of tables {name: file}, by default of both stations."""
    return recorded.cases(recorded.recorded_days(tables))


def looks(cases):
    """Return the colour and the style of each case, by its name: a colour for a station, a style for a kind."""
    stations = list(dict.fromkeys(case.station for case in cases.values()))
    return {
        name: {"color": COLOURS[stations.index(case.station)], "linestyle": STYLES[recorded.KINDS.index(case.kind)]}
        for name, case in cases.items()
    }


def draw_recorded(cases):
    """Draw how far a line through n fixes reduces their error: as a whole, and of noise and lasting error apart."""
    plots.use_style()
    fig, ax = plots.panels([["whole", "parts"]], height=3.2)
    independent = [line_sigma(n, n) for n in LENGTHS]
    for name, look in looks(cases).items():
        case = cases[name]
        parts = {"errors": case.errors, "noise": case.noise, "lasting": case.lasting}
        ratios = {part: [recorded.newest_ratio(each, n) for n in LENGTHS] for part, each in parts.items()}
        ax["whole"].plot(LENGTHS, ratios["errors"], label=name, **look)
        ax["parts"].plot(LENGTHS, ratios["noise"], **look)
        ax["parts"].plot(LENGTHS, ratios["lasting"], **look)
    ax["whole"].plot(LENGTHS, independent, "k:", label="if errors were independent")
    ax["parts"].plot(LENGTHS, independent, "k:")
    ax["parts"].text(55, 1.13, "what lasts")
    ax["parts"].text(55, 0.42, "noise")
    for panel in ax.values():
        panel.set_ylim(0, 1.25)
    plots.finish(ax["whole"], "fixes n in the line", "error (one fix = 1)")
    plots.finish(ax["parts"], "fixes n in the line", "taken apart")
    plots.legend_below(ax["whole"], 2)
    return fig


def draw_stated(cases, filtered):
    """Draw what three filters are wrong by, and what they state, over a window: a panel for each case."""
    names = list(cases)
    fig, ax = plots.panels([names[i : i + 2] for i in range(0, len(names), 2)], height=2.5)
    minutes = 0.5 * np.arange(1, recorded.WINDOW + 1)
    for name, each in filtered.items():
        for judged, colour, label in (
            (each.white, "C1", "white"),
            (each.tuned, "C2", "tuned"),
            (each.aware, "C0", "aware"),
        ):
            error, stated = (
                np.sqrt(np.sum(np.square(axes), axis=0)) for axes in zip(*[j[:2] for j in judged], strict=True)
            )
            ax[name].plot(minutes, error, color=colour, label=f"{label}: error")
            ax[name].plot(minutes, stated, "--", color=colour, label=f"{label}: stated")
        ax[name].set_ylim(0, None)
        plots.finish(ax[name], "minutes", f"{name} (m)")
    plots.legend_below(ax[names[0]], 3)
    return fig


def remedies(cases):
    """Return a row for each case: the error (m) of one fix, of mean and line of 100, smoothed, and both.

    Behind those of mean and line stand, in brackets, their ratios to that of one fix.
    """
    n, rows = recorded.WINDOW, []
    for name, case in cases.items():
        line, both = (recorded.size(recorded.newest_points(errors, n)) for errors in (case.errors, case.smooth))
        fix, smooth = recorded.size(case.errors[n - 1 :]), recorded.size(case.smooth[n - 1 :])
        ratio = recorded.mean_ratio(case.errors, n)
        rows.append([
            name,
            f"{fix:.2f}",
            f"{ratio * fix:.2f} ({ratio:.2f})",
            f"{line:.2f} ({line / fix:.2f})",
            f"{smooth:.2f}",
            f"{both:.2f}",
        ])  # fmt: skip
    return rows


def three(values, form="{:.2f}"):
    """Return one number for each axis as a text.

    >>> three([1, 2.5, 3])
    '1.00 2.50 3.00'
    """
    return " ".join(form.format(value) for value in values)


def spread(values, form="{:.2f}"):
    """Return the least and the largest of some numbers as a text.

    >>> spread([[1, 2.5], [3, 2]])
    '1.00 to 3.00'
    """
    return f"{form.format(np.min(values))} to {form.format(np.max(values))}"


def statements(cases, filtered):
    """Return a row for each case: true and fitted size of what lasts, its duration, and how right each filter is."""
    rows = []
    for name, each in filtered.items():
        values = [found.values for found in each.fits]
        rows.append([
            name,
            three(cases[name].lasting.std(axis=0)),
            three(value["sigma"] for value in values),
            three((value["tau"] / 60 for value in values), "{:.0f}"),
            three((judged.nees for judged in each.white), "{:.0f}"),
            three((judged.nees for judged in each.tuned), "{:.0f}"),
            three((judged.nees for judged in each.aware), "{:.1f}"),
            three((100 * judged.within for judged in each.aware), "{:.0f}"),
        ])  # fmt: skip
    return rows


def exchanged(cases, filtered):
    """Judge the error state by constants that were fitted to the other stations, for ranges of the same kind.

    Returns {"NEES", "percent within 2σ", "NEES of the white filter": (axes of all pairs,)}. The white filter
    takes the variance of the other station's fixes. With one station there is nothing to exchange: {}.
    """
    found = {"NEES": [], "percent within 2σ": [], "NEES of the white filter": []}
    for name, other in permutations(cases, 2):
        if cases[name].kind == cases[other].kind:
            known = zip(filtered[other].fits, cases[other].errors.T, cases[name].errors.T, strict=True)
            for fit, elsewhere, errors in known:
                tracks = recorded.windows(errors)
                aware = recorded.judged(fit.filter, tracks)
                found["NEES"].append(aware.nees)
                found["percent within 2σ"].append(100 * aware.within)
                found["NEES of the white filter"].append(recorded.judged(recorded.white(elsewhere.var()), tracks).nees)
    return found if found["NEES"] else {}


def with_ins(cases, filtered):
    """Return what a simulated INS does for each axis of each case: {"error", "alone", "nees", "aware": (axes,)}.

    error and alone are the rms error of the position over that of a fix, with INS and without (both without an error
    state); nees is that with INS, aware the NEES with INS and error state.
    """
    found = {"error": [], "alone": [], "nees": [], "aware": []}
    for name, each in filtered.items():
        for errors, fit, white in zip(cases[name].errors.T, each.fits, each.white, strict=True):
            model = recorded.ins_model(errors.var())
            known = lasting_error(
                recorded.ins_model(fit.values["r"]), (fit.values["sigma"], 0.0), fit.values["tau"], dt=30.0
            )
            without, aware = recorded.with_ins(model, errors), recorded.with_ins(known, errors)
            found["error"].append(without.position / without.fix)
            found["alone"].append(rms(white.error[recorded.WINDOW // 2 :]) / without.fix)
            found["nees"].append(without.nees)
            found["aware"].append(aware.nees)
    return found


def draw_iterations(curves):
    """Draw the error of the position over the iteration: {panel: {start: errors (steps + 1, M)}} (Figure 1)."""
    fig, ax = plots.panels([list(curves)], height=3)
    for name, starts in curves.items():
        for (label, curve), style in zip(starts.items(), ("o-", "s--"), strict=False):
            ax[name].semilogy(np.median(curve, axis=1), style, ms=4, label=label)
            ax[name].fill_between(range(len(curve)), curve.min(axis=1), curve.max(axis=1), alpha=0.2, lw=0)
        ax[name].set_ylim(0.02, 1e10)
        plots.finish(ax[name], "step", f"error (m), {name}")
    return fig


def draw_fixes(local, seconds):
    """Draw fixes {station: (N, 3)} about the headers' positions: in the plane, and up over the day (Figure 2)."""
    fig, ax = plots.panels([["plane", "up"]], height=3)
    for name, fixes in local.items():
        ax["plane"].plot(*fixes[::6, :2].T, ".", ms=2, label=name)
        ax["up"].plot(seconds[name][::6] / 3600, fixes[::6, 2], lw=0.7)
    ax["plane"].set_aspect("equal")
    plots.finish(ax["plane"], "east (m)", "north (m)")
    plots.finish(ax["up"], "hour of the day", "up (m)")
    plots.legend_below(ax["plane"], 2)
    return fig


def draw_tracks(t, wrong, sigma):
    """Draw the errors of line and Kalman filter, {name: (N, 2)} in x and V, with 2 sigma (N, 2) of the line."""
    fig, ax = plots.panels([["x", "V"]], height=3)
    for j, (name, unit) in enumerate((("x", "m"), ("V", "m/s"))):
        ax[name].fill_between(t, -2 * sigma[:, j], 2 * sigma[:, j], color="0.85", lw=0)
        for (label, errors), style in zip(wrong.items(), ("-", "--"), strict=True):
            ax[name].plot(t, errors[:, j], style, label=label)
        plots.finish(ax[name], "time (s)", f"error of {name} ({unit})")
    plots.legend_below(ax["x"], 2)
    return fig


def draw_rough_kalman(medians):
    """Draw the median error of rough positions by Kalman filters, {name: (epochs,)}."""
    fig, ax = plots.panels([["error"]], height=3.3)
    for (name, errors), style in zip(medians.items(), ("-", "--", "-.", "k-"), strict=True):
        ax["error"].loglog(np.arange(1, len(errors) + 1), errors, style, label=name)
    ax["error"].set_ylim(0.3, 1e4)
    plots.finish(ax["error"], "epoch, 30 s each", "median error of the position (m)")
    return fig


def draw_changing(durations, filters, window):
    """Draw errors after a change over its duration: {panel: {family: (durations,)}}, and of the window by panel."""
    fig, ax = plots.panels([list(filters)], height=3.2)
    for panel, families in filters.items():
        for (family, errors), colour in zip(families.items(), ("C1", "C0"), strict=True):
            ax[panel].plot(durations, errors, "o-", color=colour, ms=4, label=f"Q: {family}")
        ax[panel].plot(durations, window[panel], "k--", label="adaptive window")
        ax[panel].set_ylim(0, 1.2 * max(window[panel].max(), *(errors.max() for errors in families.values())))
        plots.finish(ax[panel], "change takes (s)", f"error (m), {panel}")
    plots.legend_below(ax[panel], 2)
    return fig


def draw_third_row(R33, maps):
    """Draw the error over the line's, and the NEES, of readings {name: (len(R33), 2 or more)} of the third row of H."""
    fig, ax = plots.panels([["ratio", "nees"]], height=3.4)
    ax["ratio"].axhspan(0.95, 1.05, color="0.85", lw=0)
    for (reading, values), style in zip(maps.items(), ("k-", "-", "--", "-.", ":"), strict=True):
        width = 4 if reading == "no third row" else 1.6  # seen under the others
        ax["ratio"].loglog(R33, values[:, 0], style)
        ax["nees"].loglog(R33, values[:, 1], style, lw=width, label=reading)
    ax["ratio"].set_ylim(0.1, 300)
    plots.finish(ax["ratio"], "R_33 (m²)", "error of x over the line's")
    plots.finish(ax["nees"], "R_33 (m²)", "NEES (should be 3)")
    plots.legend_below(ax["nees"], 3)
    return fig
