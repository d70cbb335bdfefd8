"""What the lesson `what_averaging_leaves` draws and tabulates: recorded errors, and what averages and filters leave."""

import warnings
from itertools import permutations
from typing import NamedTuple

import numpy as np

from mpt_helpers.metrics import rms
from reproduction import plots
from reproduction.lasting import memory

from . import recorded
from .checks import spread
from .positioning import line_sigma

LENGTHS = np.array([2, 3, 5, 10, 20, 35, 50, 75, 100])
STYLES = ("-", "--")  # of the kinds of range
FILTERS = {"white": plots.COLOURS[1], "tuned": plots.COLOURS[2], "aware": plots.COLOUR_OF["kalman"]}
# The tropics, up to 15 degrees, in RTCA/DO-229 (MOPS, appendix A.4.2.4; UNB3 has the same): pressure of vapour (hPa),
# temperature (K), its lapse (K/m), and the exponent by which vapour falls with height. There they have no season.
VAPOUR, WARM, LAPSE, EXPONENT = 26.31, 299.65, 6.30e-3, 2.77
GAS, GRAVITY, REFRACTION = 287.054, 9.784, 382_000.0  # J/(kg K), m/s² in the column's mean, K²/hPa


def cases(tables=None):
    """Return the recorded cases, by "station, kind", of tables {name: file}, by default of all stations shipped."""
    return recorded.cases(recorded.recorded_days(tables))


def without_biases(cases, tables=None):
    """Return some `cases` anew, {name: Case}, by ranges that keep the satellites' code biases."""
    days = recorded.recorded_days(tables)
    return {
        name: recorded.case(case.station, recorded.without_biases(days[case.station]), case.kind)
        for name, case in cases.items()
    }


def smoothed(cases, hatch, tables=None, times=None):
    """Return the errors (N, 3) about their mean of fixes from carrier-smoothed ranges, {name: errors}, None without.

    hatch(code, phase, anew, n, slip) is the filter that smooths one satellite. Where there is no phase, the code stays.
    The phases say where they begin anew; with times, this is left to slip: so many times the median step of code minus
    phase.
    """
    days, found = recorded.recorded_days(tables), {}
    for name, case in cases.items():
        day, code, slip = days[case.station], case.ranges, np.inf
        if not recorded.phases_of(day):
            found[name] = None
            continue
        phase, anew, n = recorded.to_smooth(day, case.kind, code)
        if times is not None:
            slip = times * np.nanmedian(np.abs(np.diff(code - phase, axis=0)))
            anew = np.zeros(anew.shape, dtype=bool)
        columns = [hatch(*each, n, slip) for each in zip(code.T, phase.T, anew.T, strict=True)]
        smooth = np.transpose(columns)
        ranges = np.where(np.isfinite(smooth), smooth, code)
        found[name] = recorded.about_mean(recorded.fixes(day, ranges).local)
    return found


def filtered(cases):
    """Return the `recorded.Filtered` of each case; what a fit warns of is for the reader's own recordings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return {name: recorded.filtered(case) for name, case in cases.items()}


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
        if case.lasting is not None:
            line = {"color": plots.COLOURS[0], "label": "without its noise"}
            ax[name].plot(case.seconds[k] / 3600, case.lasting[k, 2], **line)
        ax[name].set_ylim(-9, 9)
        plots.finish(ax[name], "hour" if name == names[-1] else "", f"error of the height (m), {name}")
    plots.legend_below(ax[names[-1]], 2)
    return fig


def draw_biases(case, raw):
    """Draw the lasting error of the height over a day, with the satellites' code biases left in (raw) and corrected."""
    fig, ax = plots.panels([["up"]], height=2.8)
    titled(fig, "A part of the lasting error was ours to correct")
    for each, colour, label in ((raw, plots.COLOURS[1], "biases left in"), (case, plots.COLOURS[0], "corrected")):
        errors = each.errors if each.lasting is None else each.lasting
        ax["up"].plot(each.seconds / 3600, errors[:, 2], color=colour, lw=1.2, label=label)
    ax["up"].set(xlim=(0, 24), xticks=range(0, 25, 6))
    plots.finish(ax["up"], "hour of the day", f"lasting error of the height (m), {case.station}, {case.kind}")
    plots.legend_below(ax["up"], 2)
    return fig


def draw_recorded(cases):
    """Draw how far a line through n fixes reduces their error: noise and lasting error of all cases, and each case.

    On the left there is a band from the least to the largest of all cases. On the right a curve of a case ends at its
    station's name; its style is that of its kind of range.
    """
    fig, ax = plots.panels([["parts", "whole"]], height=3.8)
    titled(fig, "A line fit takes out the noise. The lasting error stays")
    ends = {}
    for case in cases.values():
        kind = recorded.KINDS.index(case.kind)
        ratios = [recorded.newest_ratio(case.errors, n) for n in LENGTHS]
        label = {} if kind in ends.values() else {"label": case.kind}
        ax["whole"].plot(LENGTHS, ratios, STYLES[kind], color="0.35", lw=1.3, **label)
        ends[ratios[-1], case.station] = kind
    colours = {"noise": plots.COLOUR_OF["measured"], "lasting": plots.COLOURS[0]}
    for part, colour in colours.items():
        there = [getattr(case, part) for case in cases.values() if getattr(case, part) is not None]
        if there:
            ratios = np.array([[recorded.newest_ratio(errors, n) for n in LENGTHS] for errors in there])
            ax["parts"].fill_between(LENGTHS, ratios.min(axis=0), ratios.max(axis=0), color=colour, alpha=0.6, lw=1)
    for panel in ax.values():
        panel.plot(LENGTHS, [line_sigma(n, n) for n in LENGTHS], "k:")
        panel.text(25, 0.09, "if independent")
        panel.set_ylim(0, 1.25)
    at = 0.0
    for ratio, station in sorted(ends):
        at = max(ratio, at + 0.08)  # at the end of its curve; where two end close together, above the other
        ax["whole"].text(103, at, station, va="center")
    ax["whole"].set(xlim=(-3, 145), xticks=(0, 50, 100))
    ax["parts"].text(30, 1.14, "lasting error", color=colours["lasting"])
    ax["parts"].text(55, 0.42, "noise")
    plots.finish(ax["whole"], "fixes n fitted", "error (one fix = 1)")
    plots.finish(ax["parts"], "fixes n fitted", "its two parts, all cases")
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
        for i, (word, colour) in enumerate(FILTERS.items()):
            made, stated = (in_space(getattr(each, word), what) for what in ("error", "stated"))
            y = -j - 0.27 * i
            panel.plot([stated, made], [y, y], "-", color=colour, lw=2, label=word if j == 0 else None)
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


def metres(errors):
    """Return the size of errors (N, 3) as a text, "-" where there are none."""
    return "-" if errors is None else f"{recorded.size(errors):.2f}"


def remedies(cases, smooth):
    """Return a row for each case: the error (m) of one fix, of the line of 100, smoothed, and of the mean of 100.

    All are over the same epochs, from the hundredth on. smooth has the errors of `smoothed`.
    """
    n, rows = recorded.WINDOW, []
    for name, case in cases.items():
        last = case.errors[n - 1 :]
        whole = np.isfinite(recorded.newest_points(case.errors, n)).all(axis=1)
        sets = [last, recorded.newest_points(case.errors, n)]
        sets += [None if smooth[name] is None else smooth[name][n - 1 :], recorded.means(case.errors, n)]
        rows.append([name, *(metres(None if each is None else each[whole]) for each in sets)])
    return rows


def slips(cases, hatch, times=(6, 12)):
    """Return a row for each case: the error (m) smoothed, by the two phases, and by so many times the median step."""
    found = [smoothed(cases, hatch, times=each) for each in (None, *times)]
    return [[name, *(metres(each[name][recorded.WINDOW - 1 :]) for each in found)] for name in cases]


def how_far(cases, smooth):
    """Return a row for each case: its 95 % error (m) horizontally and up, one fix and smoothed.

    The errors count from the position in the files' headers, so that the constant of the day is in them.
    """
    rows = []
    for name, case in cases.items():
        both = (case.errors, smooth[name])
        texts = [["-", "-"] if each is None else of_95(each + case.offset) for each in both]
        rows.append([name, *texts[0], *texts[1]])
    return rows


def of_95(errors):
    """Return within how many metres 95 % of errors (N, 3) lie, horizontally and up, as texts."""
    horizontal = np.linalg.norm(errors[:, :2], axis=1)
    return [f"{np.nanpercentile(each, 95):.1f}" for each in (horizontal, np.abs(errors[:, 2]))]


def by_elevation(cases, tables=None):
    """Return by how much (%) the error of fixes changes where a range's variance grows as that of `Day.troposphere`."""
    days, found = recorded.recorded_days(tables), {}
    for name, case in cases.items():
        day = days[case.station]
        variance = (day.troposphere / np.nanmin(day.troposphere)) ** 2  # 1 / sin² of the elevation
        weighted = recorded.about_mean(recorded.fixes(day, case.ranges, variance).local)
        found[name] = 100 * (recorded.size(weighted) / recorded.size(case.errors) - 1)
    return found


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


def over_a_fix(cases, filtered):
    """Return the error in space of each filter at the end of a window over that of its last fix, {kind: {word: list}}.

    The lists have a number for each station.
    """
    found = {kind: {word: [] for word in FILTERS} for kind in recorded.KINDS}
    for name, each in filtered.items():
        case = cases[name]
        last = np.linalg.norm([rms(recorded.windows(axis)[-1, 0]) for axis in case.errors.T])
        for word in FILTERS:
            found[case.kind][word].append(in_space(getattr(each, word), "error") / last)
    return found


def memories(cases):
    """Return a row for each case: what the mean and the newest point of a line leave, over one span."""
    rows = []
    for name, case in cases.items():
        found = memory((case.seconds, case.errors), recorded.WINDOW * case.step)
        rows.append([name, *(f"{each:.2f}" for each in (found.mean, found.newest))])
    return rows


def three(values, form="{:.2f}"):
    """Return one number for each axis as a text.

    >>> three([1, 2.5, 3])
    '1.00 2.50 3.00'
    """
    return " ".join(form.format(value) for value in values)


def changed(filtered, word, other):
    """Return by how much (%) the error in space of a filter at the end of a window differs from another's: (cases,)."""
    made = [[in_space(getattr(each, name), "error") for each in filtered.values()] for name in (word, other)]
    return 100 * (np.divide(*made) - 1)


class AtRest(NamedTuple):
    """The stated error of a mean at rest over the one it makes (axes,), and how often (%) the truth was within 2σ.

    own has one share for each axis, by its own station's constants; others has those by the constants of others.
    """

    stated_over_made: np.ndarray
    own: np.ndarray
    others: np.ndarray


def stated_at_rest(r, sigma, tau, span, n):
    """Return the sigma (m) to state for a mean of n fixes over a span (s): 7 % more than the best average leaves."""
    return 1.07 * np.sqrt(sigma**2 / (1 + span / (2 * tau)) + r / n)


def at_rest(cases, filtered):
    """Judge what the mean of a window states, on all axes of all cases (`AtRest`).

    Other constants are those of each other station, for ranges of the same kind.
    """
    n, ratios, own, others = recorded.WINDOW, [], [], []
    for name, case in cases.items():
        means = [recorded.windows(axis)[:, 0].mean(axis=0) for axis in case.errors.T]
        means = [mean[np.isfinite(mean)] for mean in means]  # of windows without a gap
        for source, each in filtered.items():
            if cases[source].kind != case.kind:
                continue
            fit = each.fit
            states = stated_at_rest(fit.r, fit.sigma, fit.tau, n * case.step, n)
            within = [100 * np.mean(np.abs(mean) < 2 * stated) for mean, stated in zip(means, states, strict=True)]
            if source == name:
                ratios.extend(stated / rms(mean) for mean, stated in zip(means, states, strict=True))
                own.extend(within)
            else:
                others.extend(within)
    return AtRest(*map(np.array, (ratios, own, others)))


def median_of(values):
    """Return the median and the range of some numbers as a text.

    >>> median_of([1, 50, 80])
    '50 (1 to 80)'
    """
    return f"{np.median(values):.0f} ({spread(values, '{:.0f}')})"


def constants(cases, filtered):
    """Return a row for each case: the size of what lasts by the carrier phase, and sigma, √r and tau of the fit.

    Each has three numbers, for east, north and up.
    """
    return [
        [
            name,
            "-" if cases[name].lasting is None else three(np.nanstd(cases[name].lasting, axis=0)),
            three(each.fit.sigma),
            three(np.sqrt(each.fit.r)),
            three(each.fit.tau / 60, "{:.0f}"),
        ]
        for name, each in filtered.items()
    ]


def same_day(cases, filtered):
    """Return how often (%) the truth was within 2σ of *aware* on each axis, by constants of the same day."""
    return [100 * axis.within for name in cases for axis in filtered[name].aware]


def other_half(cases, filtered):
    """Return how often (%) the truth was within 2σ of *aware* on each axis, by constants of the day's other half."""
    found = []
    for name, case in cases.items():
        halves = np.array_split(case.errors, 2)
        for errors, constants in zip(halves, reversed(filtered[name].fit.halves), strict=True):
            for axis, each in zip(errors.T, constants, strict=True):
                filter = recorded.with_lasting(case.step, *each)
                found.append(100 * recorded.judged(filter, recorded.windows(axis)).within)
    return found


def exchanged(cases, filtered):
    """Return how often (%) the truth was within 2σ of *aware*, by constants of each other station, for the same ranges.

    With one station there is nothing to exchange: [].
    """
    found = []
    for name, other in permutations(cases, 2):
        if cases[name].kind == cases[other].kind:
            pairs = zip(filtered[other].filters["aware"], cases[name].errors.T, strict=True)
            found.extend(100 * recorded.judged(filter, recorded.windows(axis)).within for filter, axis in pairs)
    return found


def carried(cases, filtered):
    """Return rows of how often (%) the truth was within 2σ, of *aware* and of the mean of a window, by kind of range.

    The columns are by constants of the same day, of its other half (not for the mean), and of each other station. Each
    is the median of all axes, and from where to where it goes.
    """
    rows = []
    for kind in recorded.KINDS:
        of_kind = {name: case for name, case in cases.items() if case.kind == kind}
        columns = [judge(of_kind, filtered) for judge in (same_day, other_half, exchanged)]
        rows.append([f"filter, {kind}", *(median_of(each) if each else "-" for each in columns)])
        mean = at_rest(of_kind, {name: filtered[name] for name in of_kind})
        others = median_of(mean.others) if len(mean.others) else "-"
        rows.append([f"mean, {kind}", median_of(mean.own), "-", others])
    return rows
