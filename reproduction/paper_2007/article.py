"""The drawings and tables of the notebook on the paper of 2007: one function for each."""

import warnings
from itertools import permutations
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag, solve_discrete_lyapunov

from mpt_helpers import KalmanFilter, constant_velocity
from mpt_helpers.metrics import rms
from reproduction import plots
from reproduction.lasting import fit_lasting, lasting_error, memory

from . import recorded
from .positioning import line_sigma

LENGTHS = np.array([2, 3, 5, 10, 20, 35, 50, 75, 100])
STYLES = ("-", "--")  # of the kinds of range
# One colour for one filter, here and in Part II.
FILTERS = {"white": plots.COLOURS[1], "tuned": plots.COLOURS[2], "aware": plots.COLOUR_OF["kalman"]}
ELLIPSE = 2.4477  # sigmas that hold 95 % in the plane: sqrt(-2 ln 0.05)


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
    plots.use_style()
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
    plots.use_style()
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
    plots.use_style()
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
    plots.use_style()
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


def remedies(cases):
    """Return a row for each case: the error (m) of one fix, of the line of 100, smoothed, and of the mean of 100.

    All are over the same epochs, from the hundredth on.
    """
    n, rows = recorded.WINDOW, []
    for name, case in cases.items():
        last = case.errors[n - 1 :]
        whole = np.isfinite(recorded.newest_points(case.errors, n)).all(axis=1)
        sets = [last, recorded.newest_points(case.errors, n)]
        sets += [None if case.smooth is None else case.smooth[n - 1 :], recorded.means(case.errors, n)]
        rows.append([name, *(metres(None if each is None else each[whole]) for each in sets)])
    return rows


def gains(cases):
    """Return the share of the error that each remedy takes off, in percent over all cases: {what: (least, most)}."""
    rows = np.array([[float(text) for text in row[1:]] for row in remedies(cases) if "-" not in row[1:]])
    fix, line, smooth, mean = rows.T
    pairs = {
        "smoothing, of one fix": (smooth, fix),
        "smoothing, of the line": (smooth, line),
        "the mean, of the smoothed fix": (mean, smooth),
    }
    return {
        what: 100 * (1 - np.array([np.max(one / other), np.min(one / other)])) for what, (one, other) in pairs.items()
    }


def how_far(cases, left_in=None):
    """Return a row for each case: its 95 % error (m) horizontally and up, one fix and smoothed.

    The errors count from the position in the files' headers, so that the constant of the day is in them. left_in are
    some of the cases with the code biases left in, {name: Case}: each has a row before its own.
    """
    rows = []
    for name, case in cases.items():
        if left_in and name in left_in:
            rows.append([f"{case.station}, two, biases left in", *within_95(left_in[name])])
        rows.append([name, *within_95(case)])
    return rows


def within_95(case):
    """Return the 95 % errors (m) of a case as four texts: one fix, horizontally and up, and the same smoothed."""
    texts = []
    for errors in (case.errors, case.smooth):
        texts += ["-", "-"] if errors is None else [f"{each:.1f}" for each in of_95(errors + case.offset)]
    return texts


def of_95(errors):
    """Return within how many metres 95 % of errors (N, 3) lie, horizontally and up."""
    horizontal = np.linalg.norm(errors[:, :2], axis=1)
    return np.nanpercentile(horizontal, 95), np.nanpercentile(np.abs(errors[:, 2]), 95)


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


def spread(values, form="{:.2f}"):
    """Return the least and the largest of some numbers as a text.

    >>> spread([[1, 2.5], [3, 2]])
    '1.00 to 3.00'
    """
    return f"{form.format(np.min(values))} to {form.format(np.max(values))}"


def over_stated(cases, filtered, word, constant=False):
    """Return the error in space of a filter over the one that it states, at the end of a window: (cases,).

    With constant, the constant error of the day is added to it, in squares.
    """
    ratios = []
    for name, each in filtered.items():
        judged = getattr(each, word)
        made = in_space(judged, "error")
        if constant:
            made = np.hypot(made, np.linalg.norm(cases[name].offset))
        ratios.append(made / in_space(judged, "stated"))
    return np.array(ratios)


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

    def __str__(self):
        ratio = f"{spread(self.stated_over_made)}, median {np.median(self.stated_over_made):.2f}"
        others = median_of(self.others) if len(self.others) else "-"
        shares = f"own constants {median_of(self.own)}, another station's {others}"
        return f"all axes, stated over made: {ratio}\nwithin 2σ (%): {shares}"


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


class Chain(NamedTuple):
    """Filters with an error state on carrier-smoothed fixes, judged: {(case, case of its constants): three axes}."""

    judged: dict

    def within(self):
        """Return how often (%) the truth was within 2σ on all axes: by own constants, and by those of others."""
        own, other = [], []
        for (name, source), axes in self.judged.items():
            (own if name == source else other).extend(100 * axis.within for axis in axes)
        return own, other

    def gains(self, filtered):
        """Return how much (%) smaller the error in space is than that of the aware filter of fixes as they are."""
        made = {name: in_space(each.aware, "error") for name, each in filtered.items()}
        return [100 * (1 - in_space(self.judged[name, name], "error") / each) for name, each in made.items()]


def smoothed_and_aware(cases):
    """Return the `Chain` of smoothing and error state: both its constants and its fixes are those after smoothing."""
    smoothed = {name: case for name, case in cases.items() if case.smooth is not None}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        fits = {name: fit_lasting((case.seconds, case.smooth)) for name, case in smoothed.items()}
    filters = {name: recorded.aware_filters(case.step, fits[name]) for name, case in smoothed.items()}
    judged = {}
    for name, case in smoothed.items():
        for source in smoothed:
            if smoothed[source].kind == case.kind:
                pairs = zip(filters[source], case.smooth.T, strict=True)
                judged[name, source] = [recorded.judged(filter, recorded.windows(axis)) for filter, axis in pairs]
    return Chain(judged)


def median_of(values):
    """Return the median and the range of some numbers as a text.

    >>> median_of([1, 50, 80])
    '50 (1 to 80)'
    """
    return f"{np.median(values):.0f} ({spread(values, '{:.0f}')})"


def of_axes(filtered):
    """Return a row for each of three filters, each with ranges over all axes of all cases.

    They are the error over the stated σ at the end of a window, and NEES and NIS from the 21st fix of a window on.
    """
    rows = []
    for word in FILTERS:
        judged = [axis for each in filtered.values() for axis in getattr(each, word)]
        rows.append([
            word,
            spread([axis.error[-1] / axis.stated[-1] for axis in judged], "{:.1f}"),
            spread([axis.nees for axis in judged], "{:.2g}"),
            spread([axis.nis for axis in judged]),
        ])  # fmt: skip
    return rows


def constants(cases, filtered):
    """Return a row for each case: the size of what lasts by the carrier phase, and r, sigma, tau, floor of the fit.

    Each has three numbers, for east, north and up.
    """
    return [
        [
            name,
            "-" if cases[name].lasting is None else three(np.nanstd(cases[name].lasting, axis=0)),
            three(each.fit.sigma),
            three(np.sqrt(each.fit.r)),
            three(each.fit.tau / 60, "{:.0f}"),
            three(each.fit.floor),
        ]
        for name, each in filtered.items()
    ]


def exchanged(cases, filtered):
    """Judge three filters by constants that were fitted to the other stations, for ranges of the same kind.

    Returns {"NEES", "white", "tuned", "aware", "aware, with its floor"}: for all axes of all pairs the NEES of the
    aware filter, and of each filter the percent within 2σ. The floor is that of the other station's log, and a filter
    states the larger. With one station there is nothing to exchange: {}.
    """
    found = {name: [] for name in ("NEES", *FILTERS, "aware, with its floor")}
    for name, other in permutations(cases, 2):
        case = cases[name]
        if case.kind != cases[other].kind:
            continue
        for j, errors in enumerate(case.errors.T):
            tracks = recorded.windows(errors)
            judged = {word: recorded.judged(filtered[other].filters[word][j], tracks) for word in FILTERS}
            for word, each in judged.items():
                found[word].append(100 * each.within)
            found["NEES"].append(judged["aware"].nees)
            aware, floor = filtered[other].filters["aware"][j], filtered[other].fit.floor[j]
            found["aware, with its floor"].append(100 * within_floor(aware, tracks, floor))
    return found if found["NEES"] else {}


def other_half(cases, filtered):
    """Judge filters on each half of a day by constants of the other half: the percent within 2σ of all axes.

    Returns {"white", "tuned", "aware", "aware, with its floor"}. With the floor a filter states at least what lasts in
    the half that gave the constants.
    """
    found = {name: [] for name in (*FILTERS, "aware, with its floor")}
    for name, case in cases.items():
        halves = np.array_split(case.errors, 2)
        for j, constants in enumerate(filtered[name].fit.halves):
            for (r, sigma, tau), own, errors in zip(constants, halves[j].T, halves[1 - j].T, strict=True):
                filter, tracks = recorded.with_lasting(case.step, r, sigma, tau), recorded.windows(errors)
                independent = recorded.white(case.step, np.nanvar(own))
                found["white"].append(100 * recorded.judged(independent, tracks).within)
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", UserWarning)  # that half a day at a constant velocity has no q
                    tuned = recorded.fit_tracker(case.step, own).filter
                found["tuned"].append(100 * recorded.judged(tuned, tracks).within)
                found["aware"].append(100 * recorded.judged(filter, tracks).within)
                floor = np.sqrt(max(np.nanmean(np.square(own)) - r, 0))
                found["aware, with its floor"].append(100 * within_floor(filter, tracks, floor))
    return found


def carried(cases, filtered):
    """Return a row for each filter: how often the truth was within 2σ (%), by constants of three origins.

    They are fitted to the same day, to the other half of the day, and to each other station, for ranges of the same
    kind. Each share is the median over all axes of all cases, and from where to where it goes.
    """
    columns = same_day(cases, filtered), other_half(cases, filtered), exchanged(cases, filtered)
    names = [*FILTERS, "aware, with its floor"]
    return [[name, *(median_of(each[name]) if name in each else "-" for each in columns)] for name in names]


def same_day(cases, filtered):
    """Judge filters by constants of the same day: the percent within 2σ of all axes, as `other_half` has it."""
    found = {
        word: [100 * axis.within for each in filtered.values() for axis in getattr(each, word)] for word in FILTERS
    }
    found["aware, with its floor"] = [
        100 * within_floor(filter, recorded.windows(errors), floor)
        for name, each in filtered.items()
        for filter, errors, floor in zip(each.filters["aware"], cases[name].errors.T, each.fit.floor, strict=True)
    ]
    return found


def within_floor(filter, tracks, floor):
    """Return the share of errors within 2σ where σ is the filter's or the floor, whichever is larger."""
    estimates = filter.estimates(tracks)
    variance = np.maximum(estimates.P[:, 0, 0].reshape(len(tracks), -1), floor**2)
    return float(np.mean(np.square(estimates.x[recorded.SETTLED :, 0]) < 4 * variance[recorded.SETTLED :]))


def with_ins(cases, filtered):
    """Return the effect of a simulated INS on each axis of each case: {"error", "alone", "nees", "aware": (axes,)}.

    error and alone are the rms error of the position over that of a fix, with INS and without (both without an error
    state); nees is that with INS, aware the NEES with INS and error state.
    """
    found = {"error": [], "alone": [], "nees": [], "aware": []}
    for name, each in filtered.items():
        case, fit = cases[name], each.fit
        for errors, r, sigma, tau, white in zip(case.errors.T, fit.r, fit.sigma, fit.tau, each.white, strict=True):
            model = recorded.ins_model(case.step, np.nanvar(errors))
            known = lasting_error(recorded.ins_model(case.step, r), (sigma, 0.0), tau, dt=case.step)
            without, aware = recorded.with_ins(model, errors), recorded.with_ins(known, errors)
            found["error"].append(without.position / without.fix)
            found["alone"].append(rms(white.error[recorded.WINDOW // 2 :]) / without.fix)
            found["nees"].append(without.nees)
            found["aware"].append(aware.nees)
    return found


class Walker(NamedTuple):
    """Sigmas (m) of a walker's position: that of one fix, and that of *aware*, as it states it and as it makes it."""

    fix: float
    stated: float
    made: float


def walker(remembered, smoothed=0.0, believed=None, dt=1.0, r=4.7, sigma=1.1, tau=2700.0, q=0.1, speed=1.4, N=500):
    """Return the `Walker` after N fixes whose noise is remembered for some seconds, as that of reflections is.

    The noise has the variance r. smoothed is the time (s) over which the carrier phase has averaged it, 0 for none.
    believed are the r, sigma and tau of the filter, by default the true ones. The truth (position, velocity, lasting
    error, noise, smoothed noise) and the filter's x are moved together, through the filter's own gains: no seed enters.
    """
    believed = believed or (r, sigma, tau)
    axis = constant_velocity(dt=dt, q=q, r=believed[0], P0=np.diag([10.0**2, speed**2]))
    filter = KalmanFilter(lasting_error(axis, *believed[1:]))
    F, H = filter.model.F, filter.model.H
    counts = 1 / max(smoothed / dt, 1)  # each fix of the smoothed noise
    keeps, fades = np.exp(-dt / remembered), np.exp(-dt / tau)
    noise = np.array([[keeps, 0], [counts * keeps, 1 - counts]])
    new = np.array([1, counts])
    new = r * (1 - keeps**2) * np.outer(new, new)
    moves = block_diag(axis.F, fades, noise)
    enters = block_diag(axis.Q, sigma**2 * (1 - fades**2), new)
    sees = np.array([[1.0, 0, 1, 0, 1]])
    settled = solve_discrete_lyapunov(noise, new)
    together = block_diag(axis.P0, sigma**2, settled, np.zeros((3, 3)))
    for K in filter.coefficients(N).B:  # a Kalman filter's B is its gain
        step = np.block([[moves, np.zeros((5, 3))], [K @ sees @ moves, F - K @ H @ F]])
        added = np.vstack([np.eye(5), K @ sees])
        together = step @ together @ step.T + added @ enters @ added.T
    wrong = np.array([-1, 0, 0, 0, 0, 1, 0, 0])  # the filter's position less the true one
    sigmas = (sigma**2 + settled[1, 1], filter.covariances(N)[-1, 0, 0], wrong @ together @ wrong)
    return Walker(*(float(np.sqrt(each)) for each in sigmas))


def draw_iterations(curves):
    """Draw the error of the position over the iteration: {panel: {start: errors (steps + 1, M)}} (Figure 1)."""
    plots.use_style()
    fig, ax = plots.panels([list(curves)], height=3)
    titled(fig, "From 300 km away two steps are enough")
    for name, starts in curves.items():
        for (label, curve), style in zip(starts.items(), ("o-", "s--"), strict=False):
            (line,) = ax[name].semilogy(np.median(curve, axis=1), style, ms=4)
            ax[name].fill_between(range(len(curve)), curve.min(axis=1), curve.max(axis=1), alpha=0.2, lw=0)
            plots.label_line(line, label, at=1, xytext=(6, 6))
        ax[name].set_ylim(0.02, 1e10)
        plots.finish(ax[name], "step", f"error (m), {name}")
    return fig


def draw_fixes(local):
    """Draw fixes {station: (N, 3)} in the plane about their means, with the ellipse of 95 % (Figure 2)."""
    plots.use_style()
    fig, ax = plots.panels([list(local)], height=2.6)
    titled(fig, "More steps would not help: fixes scatter by metres")
    angle = np.linspace(0, 2 * np.pi, 121)
    for name, fixes in local.items():
        about = fixes[:, :2] - np.nanmean(fixes[:, :2], axis=0)
        about = about[np.isfinite(about).all(axis=1)]
        root = np.linalg.cholesky(np.cov(about.T))
        ax[name].plot(*about[::12].T, "-", lw=0.4, color="0.75")
        ax[name].plot(*about[::6].T, ".", ms=1.5, color=plots.COLOUR_OF["measured"])
        ax[name].plot(*(ELLIPSE * root @ [np.cos(angle), np.sin(angle)]), color="black", lw=1.2)
        ax[name].set(xlim=(-4, 4), ylim=(-4, 4), aspect="equal", xticks=(-3, 0, 3), yticks=(-3, 0, 3))
        plots.finish(ax[name], "east (m)", name)
    return fig


def draw_tracks(t, wrong, sigma):
    """Draw the errors of the line, {name: (N, 2)} in x and V, and how far the Kalman filter is from it.

    wrong has two names, the line first. sigma (N, 2) is that of the line: grey is ± 2 of it, on both sides.
    """
    (line, first), (kalman, second) = wrong.items()
    plots.use_style()
    fig, ax = plots.panels([["x", "x gap"], ["V", "V gap"]], height=2.2)
    titled(fig, "Line and filter agree about position, less about velocity")
    for j, (name, unit) in enumerate((("x", "m"), ("V", "m/s"))):
        ax[name].fill_between(t, -2 * sigma[:, j], 2 * sigma[:, j], color="0.85", lw=0)
        ax[name].plot(t, first[:, j], color=plots.COLOUR_OF["line"])
        gap = ax[f"{name} gap"]
        gap.fill_between(t, -2 * sigma[:, j], 2 * sigma[:, j], color="0.85", lw=0)
        gap.plot(t, second[:, j] - first[:, j], color=plots.COLOUR_OF["kalman"])
        gap.set_ylim(ax[name].get_ylim())
        plots.finish(ax[name], "time (s)", f"{line}: error of {name} ({unit})")
        plots.finish(gap, "time (s)", f"{kalman} less line")
    return fig


def draw_rough_kalman(medians):
    """Draw the median error of rough positions by Kalman filters, {name: (epochs,)}."""
    plots.use_style()
    fig, ax = plots.panels([["error"]], height=3.3)
    titled(fig, "A filter that linearises once pays for a bad start")
    at = (20, 4, 1.5, 4)
    for (name, errors), style, epoch in zip(medians.items(), ("-", "--", "-.", "k-"), at, strict=True):
        (line,) = ax["error"].loglog(np.arange(1, len(errors) + 1), errors, style)
        plots.label_line(line, name, at=epoch, xytext=(6, -14 if style == "k-" else 5))
    ax["error"].set_ylim(0.3, 1e4)
    plots.finish(ax["error"], "epoch, 30 s each", "median error of the position (m)")
    return fig


def draw_changing(durations, filters, window):
    """Draw errors after a change over its duration: {panel: {family: (durations,)}}, and of the window by panel."""
    plots.use_style()
    fig, ax = plots.panels([list(filters)], height=3.2)
    titled(fig, "With an acceleration's Q the filter beats the line")
    for panel, families in filters.items():
        for (family, errors), style in zip(families.items(), ("--", "-"), strict=True):
            colour = plots.COLOUR_OF["kalman"]
            ax[panel].plot(durations, errors, "o" + style, color=colour, ms=4, label=f"Kalman with INS, Q: {family}")
        ax[panel].plot(durations, window[panel], "-", color=plots.COLOUR_OF["line"], label="adaptive line, GPS alone")
        ax[panel].set_ylim(0, 1.2 * max(window[panel].max(), *(errors.max() for errors in families.values())))
        plots.finish(ax[panel], "change takes (s)", f"error (m), {panel}")
    plots.legend_below(ax[panel], 1)
    return fig


def draw_third_row(readings, maps):
    """Draw what each reading of the third row makes of the error: over that without the row, a dot at R_33 = 1 m².

    readings is {name: (ratio, NEES)} at 1 m², maps {name: ratios over all R_33}, which are drawn as a thin line.
    """
    plots.use_style()
    fig, ax = plots.panels([["ratio"]], height=2.6)
    titled(fig, "Only a second receiver makes the third row pay")
    panel = ax["ratio"]
    panel.axvline(1, color="0.6", lw=0.8)
    for j, (name, (ratio, _)) in enumerate(readings.items()):
        panel.plot([maps[name].min(), maps[name].max()], [-j, -j], "-", color="0.75", lw=1)
        panel.plot(ratio, -j, "o", color=plots.COLOUR_OF["kalman"], ms=7)
        panel.annotate(f"{ratio:.2f}", (ratio, -j), (0, 6), textcoords="offset points", ha="center")
    panel.set_xscale("log")
    panel.set_xticks([0.1, 1, 10, 100], ["0.1", "1", "10", "100"])
    panel.set(xlim=(0.1, 200), ylim=(0.7 - len(readings), 0.8))
    panel.set_yticks([-j for j in range(len(readings))], list(readings))
    plots.finish(panel, "times the error without the row", "error of x; grey: other R_33")
    return fig
