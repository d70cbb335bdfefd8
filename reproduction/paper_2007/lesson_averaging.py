"""What the lesson `what_averaging_leaves` draws and tabulates: recorded errors, and what averages and filters leave."""

import warnings
from itertools import permutations

import numpy as np

from mpt_helpers.metrics import rms
from reproduction import lasting, plots

from . import recorded
from .checks import spread

LENGTHS = np.array([1, 2, 3, 5, 10, 20, 35, 50, 75, 100])
MINUTES = (10, 50, 240)  # of filters that are judged
STYLES = ("-", "--")  # of the kinds of range
# Two that state too little, and one that does not
FILTERS = {
    "white": (plots.COLOUR_OF["wrong"], "-"),
    "tuned": (plots.COLOUR_OF["wrong"], ":"),
    "aware": (plots.COLOUR_OF["kalman"], "-"),
}
SLIP_STEPS = 12  # a slip of one phase: so many times the median step of code minus phase
# The tropics, up to 15 degrees, in RTCA/DO-229 (MOPS, appendix A.4.2.4; UNB3 has the same): pressure of vapour (hPa),
# temperature (K), its lapse (K/m), and the exponent by which vapour falls with height. There they have no season.
VAPOUR, WARM, LAPSE, EXPONENT = 26.31, 299.65, 6.30e-3, 2.77
GAS, GRAVITY, REFRACTION = 287.054, 9.784, 382_000.0  # J/(kg K), m/s² in the column's mean, K²/hPa


def cases(tables=None):
    """Return the recorded cases, by "station, kind", of tables {name: file}, by default of all stations shipped."""
    return recorded.cases(recorded.recorded_days(tables))


def filtered(cases):
    """Return the `recorded.Filtered` of each case; what a fit warns of is for the reader's own recordings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return {name: recorded.filtered(case) for name, case in cases.items()}


def memories(cases):
    """Return a row for each case: what the mean and the newest point of a line leave, over one span."""
    rows = []
    for name, case in cases.items():
        found = lasting.memory((case.seconds, case.errors), recorded.WINDOW * case.step)
        rows.append([name, *(f"{each:.2f}" for each in (found.mean, found.newest))])
    return rows


# Figures


def titled(fig, finding):
    """Give a figure its finding as a title."""
    fig.suptitle(finding, x=0.02, ha="left", fontsize=12)


def draw_waves(cases, names, hours=3.5):
    """Draw the errors of the height over some hours, as single fixes and without their noise: a panel for each name."""
    fig, ax = plots.panels([[name] for name in names], height=2.0)
    titled(fig, "An error of GPS is a slow wave with noise on it")
    for name in names:
        case = cases[name]
        k = case.seconds <= 3600 * hours
        ax[name].plot(case.seconds[k] / 3600, case.errors[k, 2], ".", ms=2, color="0.6", label="one fix")
        line = {"color": plots.COLOUR_OF["kalman"], "label": "without its noise"}
        ax[name].plot(case.seconds[k] / 3600, case.lasting[k, 2], **line)
        ax[name].set_ylim(-9, 9)
        plots.finish(ax[name], "hour" if name == names[-1] else "", f"error of the height (m), {name}")
    plots.legend_below(ax[names[-1]], 2)
    return fig


def left_by_mean(errors, n):
    """Return the size of the means of n successive errors (N, 3) over that of the last of them."""
    return recorded.ratio_of(recorded.means(errors, n), errors[n - 1 :])


def draw_means(cases):
    """Draw what the mean of n fixes leaves of their error: noise and lasting error of all cases, and each case.

    On the left there is a band from the least to the largest of all cases. On the right a curve of a case ends at its
    station's name; its style is that of its kind of range.
    """
    fig, ax = plots.panels([["parts", "whole"]], height=3.8)
    titled(fig, "Averaging takes the noise. Most of the lasting error stays")
    colours = {"noise": plots.COLOUR_OF["measured"], "lasting": plots.COLOUR_OF["kalman"]}
    for part, colour in colours.items():
        ratios = np.array([[left_by_mean(getattr(case, part), n) for n in LENGTHS] for case in cases.values()])
        ax["parts"].fill_between(LENGTHS, ratios.min(axis=0), ratios.max(axis=0), color=colour, alpha=0.6, lw=1)
    ends = []
    for case in cases.values():
        ratios = [left_by_mean(case.errors, n) for n in LENGTHS]
        style = STYLES[recorded.KINDS.index(case.kind)]
        label = None if any(each[2] == case.kind for each in ends) else case.kind
        ax["whole"].plot(LENGTHS, ratios, style, color="0.35", lw=1.3, label=label)
        ends.append((ratios[-1], case.station, case.kind))
    at = 0.0
    for ratio, station, _ in sorted(ends):
        at = max(ratio, at + 0.08)  # at the end of its curve; where two end close together, above the other
        ax["whole"].text(103, at, station, va="center")
    for panel in ax.values():
        panel.plot(LENGTHS, 1 / np.sqrt(LENGTHS), "k:")
        panel.text(2, 0.02, "if independent")
        panel.set_ylim(0, 1.15)
    ax["whole"].set(xlim=(-3, 145), xticks=(0, 50, 100))
    ax["parts"].text(30, 1.03, "lasting error", color=colours["lasting"])
    ax["parts"].text(45, 0.27, "noise")
    plots.finish(ax["whole"], "fixes n averaged", "error (one fix = 1)")
    plots.finish(ax["parts"], "fixes n averaged", "its two parts, all recordings")
    plots.legend_below(ax["whole"], 1)
    return fig


def in_space(judged, what):
    """Return the last error or stated sigma of three axes, together in space, in metres."""
    return float(np.sqrt(sum(getattr(axis, what)[-1] ** 2 for axis in judged)))


def draw_stated(filtered):
    """Draw what three filters make and what they state at the end of a window: a pair of dots for each case."""
    fig, ax = plots.panels([["metres"]], height=0.72 * len(filtered) + 1.2)
    titled(fig, "All three filters are about equally wrong. One says so")
    panel, ticks, right = ax["metres"], [], 0
    for j, (name, each) in enumerate(filtered.items()):
        for i, (word, (colour, style)) in enumerate(FILTERS.items()):
            made, stated = (in_space(getattr(each, word), what) for what in ("error", "stated"))
            y = -j - 0.27 * i
            panel.plot([stated, made], [y, y], style, color=colour, lw=2, label=word if j == 0 else None)
            panel.plot(stated, y, "o", color=colour, mfc="white", ms=11)
            panel.plot(made, y, "o", color=colour, ms=5)
            text = f"{made / stated:.1f} x"
            panel.annotate(text, (max(made, stated), y), (10, -4), textcoords="offset points", color=colour)
            right = max(right, made, stated)
        ticks.append(
            (-j - 0.27, name.replace(", ", "\n").replace("frequencies", "freq.").replace("frequency", "freq."))
        )
    panel.set_yticks(*zip(*ticks, strict=True))
    panel.set_xlim(0, 1.18 * right)
    minutes = recorded.WINDOW * next(iter(filtered.values())).step / 60
    plots.finish(panel, "○ stated, ● made; beside: made over stated", f"error in space (m) after {minutes:.0f} minutes")
    plots.legend_below(panel, len(FILTERS))
    return fig


# Filters


def at_the_end(filter, tracks):
    """Return the error that a filter makes at the end of tracks (n, 1, M) of errors, and the one that it states."""
    found = filter.estimates(tracks)
    return rms(found.x[-1, 0]), np.sqrt(np.mean(found.P[-1, 0, 0]))


def over_time(cases, filtered):
    """Return a row for each filter: the error that it makes over the one that it states after `MINUTES`, in space.

    Each is the least and the largest of all cases, over stretches of that length.
    """
    rows = []
    for word in FILTERS:
        texts = []
        for minutes in MINUTES:
            ratios = []
            for name, case in cases.items():
                n = round(60 * minutes / case.step)
                axes = zip(filtered[name].filters[word], case.errors.T, strict=True)
                ends = [at_the_end(filter, recorded.windows(axis, n)) for filter, axis in axes]
                made, stated = np.linalg.norm(ends, axis=0)
                ratios.append(made / stated)
            texts.append(spread(ratios, "{:.1f}"))
        rows.append([word, *texts])
    return rows


def changed(filtered, word, other):
    """Return by how much (%) the error in space of a filter at the end of a window differs from another's: (cases,)."""
    made = [[in_space(getattr(each, name), "error") for each in filtered.values()] for name in (word, other)]
    return 100 * (np.divide(*made) - 1)


# The mean at rest


def stated_at_rest(r, sigma, tau, span, n):
    """Return the sigma (m) to state for a mean of n fixes over a span (s): 7 % more than the best average leaves."""
    return 1.07 * np.sqrt(sigma**2 / (1 + span / (2 * tau)) + r / n)


def constants_of(fit):
    """Return r, sigma and tau of each axis of a fit, (3, 3)."""
    return np.transpose([fit.r, fit.sigma, fit.tau])


def same_day(cases, filtered):
    """Return the errors (N, 3) of each case, and the constants (3, 3) fitted to the same day."""
    return [(case.errors, constants_of(filtered[name].fit)) for name, case in cases.items()]


def other_half(cases, filtered):
    """Return the errors (N, 3) of each half of each day, and the constants (3, 3) fitted to its other half."""
    found = []
    for name, case in cases.items():
        found += zip(np.array_split(case.errors, 2), reversed(filtered[name].fit.halves), strict=True)
    return found


def another_station(cases, filtered):
    """Return the errors (N, 3) of each case, and the constants (3, 3) of another station; all pairs of one kind."""
    pairs = [(name, other) for name, other in permutations(cases, 2) if cases[name].kind == cases[other].kind]
    return [(cases[name].errors, constants_of(filtered[other].fit)) for name, other in pairs]


def made_at_rest(errors, constants, step, n=recorded.WINDOW):
    """Return the rms error of means of n fixes over what `stated_at_rest` says, for each axis of errors (N, 3)."""
    found = []
    for axis, each in zip(errors.T, constants, strict=True):
        means = recorded.windows(axis, n)[:, 0].mean(axis=0)
        whole = np.isfinite(means)  # windows without a gap
        found.append(rms(means[whole]) / stated_at_rest(*each, n * step, n))
    return found


def carried(cases, filtered):
    """Return rows of what the mean of a window makes over what is stated, by kind of range, as the median of all axes.

    The constants are of the same day, of its other half, and of each other station. In brackets are the least and the
    largest.
    """
    sources = {"the same day": same_day, "its other half": other_half, "another station": another_station}
    rows = []
    for source, pairs_of in sources.items():
        texts = []
        for kind in recorded.KINDS:
            of_kind = {name: case for name, case in cases.items() if case.kind == kind}
            step = next(iter(of_kind.values())).step
            made = [made_at_rest(*pair, step) for pair in pairs_of(of_kind, filtered)]
            texts.append(f"{np.median(made):.2f} ({spread(made)})")
        rows.append([source, *texts])
    return rows


def heights(cases, filtered):
    """Return a row for each case: what lasts in the height by the carrier phase, and sigma, √r and tau of the fit.

    A tau that the day does not determine, by the limit of `fit_lasting`, has a question mark.
    """
    rows = []
    for name, case in cases.items():
        fit = filtered[name].fit
        low, high = fit.known["tau"][2]
        unknown = "?" if np.log(high / low) > 2 * 1.96 * lasting.UNKNOWN else ""
        metres = [np.nanstd(case.lasting[:, 2]), fit.sigma[2], np.sqrt(fit.r[2])]
        rows.append([name, *(f"{each:.2f}" for each in metres), f"{fit.tau[2] / 60:.0f}{unknown}"])
    return rows


# What smoothing and corrections do


def smoothed(cases, hatch, tables=None, times=SLIP_STEPS):
    """Return the errors (N, 3) about their mean of fixes from carrier-smoothed ranges, {name: errors}.

    hatch(code, phase, anew, n, slip) is the filter that smooths one satellite. With two frequencies both phases are
    used, and say where they begin anew. With one frequency there is one phase, and a slip is a step of code minus phase
    of so many times the median one. Where there is no phase, the code stays.
    """
    days = recorded.recorded_days(tables)
    found = {}
    for name, case in cases.items():
        day, code, slip = days[case.station], case.ranges, np.inf
        if case.kind == recorded.KINDS[0]:
            day = day._replace(phase2=np.full(day.phase2.shape, np.nan))
        phase, anew, n = recorded.to_smooth(day, case.kind, code)
        if case.kind == recorded.KINDS[0]:
            slip = times * np.nanmedian(np.abs(np.diff(code - phase, axis=0)))
            anew = np.zeros(anew.shape, dtype=bool)
        columns = [hatch(*each, n, slip) for each in zip(code.T, phase.T, anew.T, strict=True)]
        smooth = np.transpose(columns)
        ranges = np.where(np.isfinite(smooth), smooth, code)
        found[name] = recorded.about_mean(recorded.fixes(day, ranges).local)
    return found


def remedies(cases, smooth):
    """Return a row for each case: the error (m) of one fix, smoothed, and of the mean of a window.

    All are over the same epochs, from the end of the first window on. smooth has the errors of `smoothed`.
    """
    n, rows = recorded.WINDOW, []
    for name, case in cases.items():
        means = recorded.means(case.errors, n)
        whole = np.isfinite(means).all(axis=1)
        sets = [case.errors[n - 1 :], smooth[name][n - 1 :], means]
        rows.append([name, *(f"{recorded.size(each[whole]):.2f}" for each in sets)])
    return rows


def wet_delay(height=0.0):
    """Return the delay (m) of the vapour of the tropics in the zenith, at a height in metres (RTCA/DO-229).

    >>> round(wet_delay(), 3)
    0.274
    """
    at_sea = 1e-6 * REFRACTION * GAS / (GRAVITY * (EXPONENT + 1) - LAPSE * GAS) * VAPOUR / WARM
    return at_sea * (1 - LAPSE * height / WARM) ** ((EXPONENT + 1) * 9.80665 / (GAS * LAPSE) - 1)


def in_the_tropics(case, zenith=0.085):
    """Return the mean of the day (3,) from the header's position with the vapour of the tropics, in metres.

    zenith (m) is the wet delay that the tables have, of standard air with a humidity of one half.
    """
    (day,) = recorded.recorded_days({case.station: recorded.TABLES[case.station]}).values()
    whole = np.nanmin(day.troposphere)  # that of the highest satellite, which was at the zenith within the percent
    ranges = case.ranges - (wet_delay() - zenith) / whole * day.troposphere
    return np.nanmean(recorded.fixes(day, ranges).local, axis=0)
