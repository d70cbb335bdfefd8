"""A recorded track, from numbers to a smoothed line with a band: faults refused, q and r fitted, segments smoothed.

A *segment* is an uninterrupted part of a track: the filter starts each from its own first fix. Faults spoil q and r,
but without q and r faults cannot be told from noise. So three steps are repeated until the refused fixes stay the same,
at most four times:

1. `gate`, fix by fix, at first with a guess of q and r that tolerates a tenth of faults;
2. the smoother, which refuses fixes that are far from the smoothed line of all others;
3. maximum-likelihood q and r of the remaining fixes.

Then the band is tested on the second half of the track, with q and r fitted to the first half.
"""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _checks as checks
from .. import bands
from .._checks import Seconds
from . import gate
from .fixes import FEWEST, checked_track, find_fixes, grid_of
from .noise_fit import (
    HOUR_BETWEEN,
    Line,
    Noise,
    Scale,
    assume_r_if_unidentifiable,
    concatenate_segments,
    filter_of,
    first_guess,
    fit_noise,
    log_errors,
    scale_of,
    vague_axis_filter,
)
from .result import Band, Cleaned

LEVEL = 0.95
NORMAL = 1.96  # standard deviations that hold 95 % of a normal distribution
# The smoother refuses a fix whose squared distance exceeds this limit and those of both neighbours. A limit of 30
# refuses up to 0.2 % of the fixes of clean tracks; a limit of 200 refuses no fewer than 60.
SMOOTHER_LIMIT, SMOOTHER_PASSES = 60.0, 3
# With a fix every 4 s or less often, the limit is lower where the motion is smooth, down to LEAST_LIMIT. It is
# proportional to the median squared distance of the 21 fixes around; with two axes and the right model this is 1.39. It
# catches twice as many outliers of 20 to 40 m. Denser tracks do not need it, and would lose fixes a few metres off.
SPARSE, NEIGHBOURS, MEDIAN, LEAST_LIMIT = 4.0, 21, 1.39, 30.0
# A smaller fraction of r is the rounding error of r - P.
SMALLEST_DIFFERENCE = 1e-8
TURNS = 4  # of the gate, the smoother and the fit
# The horizon of the band is one at which at least this fraction of the fixes is followed by another fix.
CHECKED = 1 / 3


def clean(
    t: ArrayLike,
    z: ArrayLike,
    r: ArrayLike | None = None,
    *,
    seconds: Seconds = 10.0,
    limit: float = 100.0,
    pause: Seconds | None = None,
    segment: ArrayLike | None = None,
    rounding: float | None = None,
) -> Cleaned:
    """Return a recorded track without its faults, smoothed, and with a tested prediction band.

    All axes share q and r, so clean heights separately. If rows are written faster than fixes are made, a row that
    repeats a position while the mobile moves is not a fix. Of several fixes at one time, the last one counts.

    Parameters
    ----------
    t : array_like, (N,)
        Times in s, or dates, which must not decrease within a `segment`.
    z : array_like, (N, m)
        Positions in metres on any axes, NaN where one is missing.
    r : array_like, (N,) or (N, m), optional
        Relative variances, such as the squares of a receiver's hdop. Their common factor is fitted.
    seconds : float or timedelta
        The horizon of the band.
    limit : float
        The NIS above which a fix is refused, as in `gated`.
    pause : float or timedelta, optional
        The time without a fix after which a new recording begins. By default a minute, or ten median steps if these
        are longer.
    segment : array_like, (N,), optional
        A number or name for each row. A new recording begins where it changes.
    rounding : float, optional
        The variance of the rounding of z in m², found from the digits by default.

    Returns
    -------
    Cleaned
        The cleaned track.

    Raises
    ------
    ValueError
        For times that decrease, fewer than ten fixes at different times, a track that stands still apart from faults,
        and other shapes.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> axis = mpt.constant_velocity(dt=1.0, q=0.04, r=4.0)
    >>> _, z = mpt.simulate(mpt.stack(axis, axis), N=600, rng=1)
    >>> z[100] += 500.0
    >>> c = mpt.tracks.clean(np.arange(600.0), z)
    >>> c.refused.tolist(), c.starts.tolist(), round(c.q, 3), round(c.r, 2)
    ([100], [], 0.035, 4.03)

    """
    seconds = checks.duration("seconds", seconds)
    limit = gate.checked_limit(limit)
    pause = None if pause is None else checks.duration("pause", pause)
    t, z, relative, begins_segment = checked_track(t, z, r, segment)
    rounding = max(map(grid_of, z.T)) ** 2 / 12 if rounding is None else checks.not_negative("rounding", rounding)
    fixes = find_fixes(t, z, begins_segment, rounding, pause)
    # The gate restarts with each recording, so an hour stands for any pause, and for any step back in time.
    clock = np.cumsum(np.append(0.0, np.where(fixes.begin[1:], HOUR_BETWEEN, np.diff(t[fixes.rows]))))
    own = z[fixes.rows]
    weights = None if relative is None else relative[fixes.rows]
    scale = scale_of(clock, own, rounding, fixes.begin)
    noise, segments = first_guess(clock, own, scale, fixes.begin), None

    def line_of(segments):
        return concatenate_segments(t, z, relative, fixes.same_as, segments, noise, scale)

    for _ in range(TURNS):
        before, segments = segments, np.full(len(t), -1)
        kf = filter_of(noise, scale, clock, weights, z.shape[1])
        segments[fixes.rows] = gate.segments_of(kf, own, np.flatnonzero(fixes.begin), limit, 3)
        segments = without_smoother_outliers(line_of(segments), noise, scale, segments)
        if before is not None and np.array_equal(segments, before):
            break
        line = line_of(segments)
        if line.stands_still(scale):
            still = f"{(segments >= 0).sum()} of {len(own)} fixes standing still"
            checks.refuse("z", "a track that moves", f"{still}, all else being faults or jumps: are digits missing?")
        noise = fit_noise(line, noise, scale, near=before is not None)
    line = line_of(segments)
    noise = assume_r_if_unidentifiable(line, noise, scale)
    kf = filter_of(noise, scale, line.t, line.relative, z.shape[1])
    s = kf.smooth(line.z)
    n = 2 * z.shape[1]
    x, P = np.full((len(t), n), np.nan), np.full((len(t), n, n), np.nan)
    x[line.rows], P[line.rows] = s.x, s.P
    x[line.rows, ::2] -= line.moved
    return Cleaned(
        t=t,
        z=z,
        segments=segments,
        x=x,
        P=P,
        q=noise.q,
        r=noise.r,
        log_errors=log_errors(line, noise, scale),
        rounding=noise.rounding,
        band=band_of(line, noise, scale, seconds),
        filter=kf,
        line=line,
        recordings=fixes.rows[fixes.begin].tolist(),
        repeats=fixes.same_as != np.arange(len(t)),
        said=fixes.said,
    )


def without_smoother_outliers(line: Line, noise: Noise, scale: Scale, segment: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the segments without the fixes that are far from the smoothed line of all others.

    The squared distance of a fix from the line smoothed without it, in units of its variance, is (z - x)² / (r - P),
    with x and P of the line smoothed with it. A fault makes its neighbours look bad too, so of neighbouring fixes only
    the worst is refused in each pass.
    """
    segment = segment.copy()
    for _ in range(SMOOTHER_PASSES):
        x, P = _smoothed(line, noise, scale)
        r = noise.r if line.relative is None else noise.r * line.relative
        distances = (line.z - x) ** 2 / np.maximum(r - P, SMALLEST_DIFFERENCE * r)
        fixes = np.flatnonzero(np.isfinite(line.z).any(axis=1))
        off = np.nansum(distances[fixes], axis=1)
        limits = _limits(off) if scale.step >= SPARSE else SMOOTHER_LIMIT
        before, after = np.append(0, off[:-1]), np.append(off[1:], 0)
        faults = fixes[(off > limits) & (off >= before) & (off >= after)]
        if not len(faults):
            break
        segment[line.rows[faults]] = -1
        z = line.z.copy()
        z[faults] = np.nan
        line = line._replace(z=z)
    kept = segment >= 0
    segment[kept] = np.unique(segment[kept], return_inverse=True)[1]  # whole segments may be gone
    return segment


def _limits(off):
    """Return the limit for each fix (N,), from the squared distances (N,) of the fixes around it."""
    around = np.lib.stride_tricks.sliding_window_view(np.pad(off, NEIGHBOURS // 2, mode="reflect"), NEIGHBOURS)
    return np.clip(SMOOTHER_LIMIT * np.median(around, axis=1) / MEDIAN, LEAST_LIMIT, SMOOTHER_LIMIT)


def _smoothed(line, noise, scale):
    """Return the smoothed positions of a line and their variances, (K, m)."""
    s = vague_axis_filter(line, noise.q, noise.r, scale).smooth(line.z[:, None])
    return s.x[:, 0], s.P[:, 0, 0]


def band_of(line: Line, noise: Noise, scale: Scale, seconds: float) -> Band | None:
    """Return the Band of the second half of a line, with q and r of the first half.

    It is None if a half has too few fixes, or the first half stands still.
    """
    half = len(line.rows) // 2
    before = line.part(slice(half))
    if before.stands_still(scale) or np.isfinite(before.z[~before.first]).sum() < FEWEST:
        return None
    first = fit_noise(before, noise, scale)
    kf = filter_of(first, scale, line.t, line.relative, line.z.shape[1])
    t = line.t[np.isfinite(line.z).any(axis=1)]
    due = np.append(t, np.inf)[np.searchsorted(t, t + seconds * (1 - bands.TIME_ROUNDING))] - t
    if np.mean(due <= bands.LATEST_CHECK * seconds) < CHECKED:
        seconds = float(np.quantile(np.diff(t), 0.5, method="higher"))
    try:
        a = bands.ahead(kf, line.z, seconds)
    except ValueError:  # no fix is followed by another at that horizon
        return None
    unseen = a.row >= half
    if not np.isfinite(a.errors[unseen]).any(axis=0).all():
        return None
    widths = bands.following(a, level=LEVEL)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # few predictions: `independent` says how many
        held = bands.coverage(a, widths, where=unseen)
        own = bands.coverage(a, NORMAL * a.sigma, where=unseen)
    shares = float(held.share.mean()), float(own.share.mean())
    width = float(np.median(widths[unseen]))
    return Band(seconds, width, LEVEL, *shares, int(unseen.sum()), held.independent, a, widths, unseen)
