"""What the lesson `what_averaging_leaves` draws and tabulates, and the page `docs/smoothing.md` for those who go on."""

import warnings
from itertools import permutations

import numpy as np

from mpt_helpers.metrics import rms
from reproduction import lasting, plots

from . import recorded
from .checks import spread

UP = 2  # the column of the heights
TENTH = "{:.1f}"  # how ratios are shown
SLIP_STEPS = 12  # a slip of one phase: so many times the median step of code minus phase
# The tropics, up to 15 degrees, in RTCA/DO-229 (MOPS, appendix A.4.2.4; UNB3 has the same): pressure of vapour (hPa),
# temperature (K), its lapse (K/m), and the exponent by which vapour falls with height. There they have no season.
VAPOUR, WARM, LAPSE, EXPONENT = 26.31, 299.65, 6.30e-3, 2.77
GAS, GRAVITY, REFRACTION = 287.054, 9.784, 382_000.0  # J/(kg K), m/s² in the column's mean, K²/hPa


def cases(tables=None):
    """Return the recorded cases, by "station, kind", of tables {name: file}, by default of all stations shipped."""
    return recorded.cases(recorded.recorded_days(tables))


def memories(cases):
    """Return a row for each case: what the mean of a window and the newest point of a line through it leave."""
    rows = []
    for name, case in cases.items():
        newest = np.transpose([recorded.line_errors(axis, recorded.WINDOW)[1] for axis in case.errors.T])
        fixes = case.errors[recorded.WINDOW - 1 :]
        left = [recorded.ratio_of(each, fixes) for each in (recorded.means(case.errors, recorded.WINDOW), newest)]
        rows.append([name, *(f"{each:.2f}" for each in left)])
    return rows


# The wall


def draw_wall(case, stretches=9):
    """Draw the errors of the height over some stretches of a hundred fixes: single fixes, their wave, their means."""
    fig, ax = plots.panels([["wall"]], height=3.6)
    fig.suptitle("The mean of fifty minutes follows the lasting error", x=0.02, ha="left", fontsize=12)
    panel, n = ax["wall"], recorded.WINDOW
    hours = case.seconds[: n * stretches] / 3600
    errors, wave = (each[: n * stretches, UP] for each in (case.errors, case.lasting))
    root_n = np.nanstd(case.errors[:, UP]) / np.sqrt(n)
    panel.axhspan(-root_n, root_n, color="0.78", lw=0, label=f"± {root_n:.2f} m, by √n")
    panel.plot(hours, errors, ".", ms=2, color="0.6", label="one fix")
    panel.plot(hours, wave, color="0.25", lw=1, label="without its noise")
    means = {"color": plots.COLOUR_OF["line"], "lw": 4, "solid_capstyle": "butt", "label": "mean of 100 fixes"}
    for part, mean in zip(np.split(hours, stretches), np.split(errors, stretches), strict=True):
        panel.plot(part[[0, -1]], [mean.mean()] * 2, **means)
        means.pop("label", None)
    plots.finish(panel, "hour", f"error of the height (m), {case.station}, {case.kind}")
    plots.legend_below(panel, 2)
    return fig


def draw_kept(ends):
    """Draw what filters state at the end of each stretch, estimate ± 2σ, beside the truth.

    ends has for each filter, by its name, the estimates and sigmas (stretches,) of a height whose truth is 0.
    """
    fig, ax = plots.panels([list(ends)], height=3.2)
    fig.suptitle("White is sure of what it does not know", x=0.02, ha="left", fontsize=12)
    reach = max(np.max(np.abs(x) + 2 * sigma) for x, sigma in ends.values())
    for name, (x, sigma) in ends.items():
        panel, k = ax[name], np.arange(1, len(x) + 1)
        holds = np.abs(x) <= 2 * sigma
        for some, colour, label in (
            (holds, plots.COLOUR_OF["line"], "0 inside"),
            (~holds, plots.COLOUR_OF["wrong"], "0 outside"),
        ):
            panel.errorbar(k[some], x[some], 2 * sigma[some], fmt="o", ms=3, lw=1, color=colour, label=label)
        panel.axhline(0, color="0.25", lw=1)
        panel.set_ylim(-1.1 * reach, 1.1 * reach)
        plots.finish(panel, "stretch of fifty minutes", f"{name}: height ± 2σ (m)")
    plots.legend_below(ax[next(iter(ends))], 2)
    return fig


# The six recordings


def fits(cases):
    """Return the `LastingFit` of the height of each case; what a fit warns of is for the reader's own recordings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return {name: lasting.fit_lasting((case.seconds, case.errors[:, UP])) for name, case in cases.items()}


def constants_of(fit):
    """Return r, sigma and tau of a fit of one axis."""
    return float(fit.r[0]), float(fit.sigma[0]), float(fit.tau[0])


def stated_at_rest(r, sigma, tau, span, n):
    """Return the standard deviation (m) to state for a mean of n fixes over a span (s)."""
    return np.sqrt(sigma**2 / (1 + span / (2 * tau)) + r / n)


def noise_of(z):
    """Return the variance r of the noise of fixes, from the steps between neighbours."""
    return float(np.nanmean(np.diff(z) ** 2) / 2)


def stretches_of(z, n=recorded.WINDOW):
    """Return successive stretches (M, n) of n heights each, without those in which a fix is missing."""
    parts = recorded.windows(z, n)[:, 0].T
    return parts[np.isfinite(parts).all(axis=1)]


def mean_over_stated(z, constants, step, n=recorded.WINDOW):
    """Return the rms error of means of n heights over what `stated_at_rest` says, by constants r, sigma and tau."""
    return rms(stretches_of(z, n).mean(axis=1)) / stated_at_rest(*constants, n * step, n)


def made_over_stated(kalman, z, step, **constants):
    """Return the error that a filter makes of the position at the end of stretches, over the one that it states."""
    ends = [list(kalman(stretch, step, **constants))[-1] for stretch in stretches_of(z)]
    return rms([x[0] for x, _ in ends]) / np.sqrt(np.mean([P[0, 0] for _, P in ends]))


def ratios(kalman, z, step, one, constants):
    """Return made over stated of the mean by the root of n and by the formula, and of the filters white and aware.

    one is the variance of a fix, for the first and the third; the others take the constants r, sigma and tau.
    """
    return [
        rms(stretches_of(z).mean(axis=1)) / np.sqrt(one / recorded.WINDOW),
        mean_over_stated(z, constants, step),
        made_over_stated(kalman, z, step, r=one),
        made_over_stated(kalman, z, step, **dict(zip(("r", "sigma", "tau"), constants, strict=True))),
    ]


def judged(cases, kalman, sigma, tau):
    """Return a row for each height: √r by its neighbouring fixes, and its `ratios` by this sigma and tau."""
    rows = []
    for name, case in cases.items():
        z = case.errors[:, UP]
        r = noise_of(z)
        found = ratios(kalman, z, case.step, np.nanvar(z), (r, sigma, tau))
        rows.append([name, f"{np.sqrt(r):.2f}", *map(TENTH.format, found)])
    return rows


def pair_of_others(name, fits):
    """Return the geometric means of sigma and tau as fitted at the other stations, or None where there are none."""
    station = name.partition(",")[0]
    others = [constants_of(fit)[1:] for other, fit in fits.items() if other.partition(",")[0] != station]
    return np.exp(np.log(others).mean(axis=0)).tolist() if others else None


def carried(cases, fits, kalman):
    """Return a row for each origin of the constants: the spread of `ratios` over all heights.

    The constants are fitted to the other half of the day, to the same kind of range at each other station, or are the
    `pair_of_others` with the noise of the height itself.
    """
    halves, stations, pairs = [], [], []
    for name, case in cases.items():
        z = case.errors[:, UP]
        parts = np.array_split(z, 2)
        for part, other, fitted in zip(parts, parts[::-1], fits[name].halves[::-1, 0], strict=True):
            halves.append(ratios(kalman, part, case.step, np.nanvar(other), fitted))
        if pair := pair_of_others(name, fits):
            pairs.append(ratios(kalman, z, case.step, np.nanvar(z), (noise_of(z), *pair)))
    for name, other in permutations(cases, 2):
        if cases[name].kind == cases[other].kind:
            z, step, fitted = cases[name].errors[:, UP], cases[name].step, constants_of(fits[other])
            stations.append(ratios(kalman, z, step, np.nanvar(cases[other].errors[:, UP]), fitted))
    # A reader's own station may be the only one.
    origins = {"another half day": halves, "another station": stations, "a pair of the others": pairs}
    return [
        [name, *(spread(each, TENTH) for each in zip(*found, strict=True))] for name, found in origins.items() if found
    ]


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
