"""Least squares of the paper of 2007: a position from pseudoranges (Eqs. 1-7), a line from positions (Eqs. 8-10).

Positions are in metres, in coordinates that turn with the Earth (ECEF, WGS 84). A state X is [x y z D']: the position,
and the receiver's clock shift as a length.
"""

from contextlib import suppress
from itertools import combinations
from math import comb
from typing import NamedTuple

import numpy as np
from scipy.linalg import toeplitz
from scipy.special import gammaincc

from mpt_helpers import _checks as checks
from mpt_helpers.equations import square_root

EARTH_RADIUS = 6_378_137.0  # m, at the equator
FLATNESS = 6.69437999014e-3  # e² of the WGS 84 ellipsoid
ORBIT_RADIUS = 26_560e3  # m
INCLINATION = np.radians(55.0)
SIDEREAL_DAY = 86_164.0905  # s; a satellite takes half of it for a revolution
# The nominal constellation of the GPS SPS Performance Standard (2001), Table 3-1: the right ascension of the node of
# the planes A to F, and the argument of latitude of their four satellites, in degrees at 0000Z on 1 July 1993.
NODES = (272.847, 332.847, 32.847, 92.847, 152.847, 212.847)
ARGUMENTS = (
    (268.126, 161.786, 11.676, 41.806),
    (80.956, 173.336, 309.976, 204.376),
    (111.876, 11.796, 339.666, 241.556),
    (135.226, 265.446, 35.136, 167.356),
    (197.046, 302.596, 66.066, 333.686),
    (238.886, 345.226, 105.206, 135.346),
)
GREENWICH = 279.06  # degrees, the hour angle of Greenwich at that time: 18 h 36 min 14.4 s
# m, bounds of pseudoranges and of distances from the Earth's centre: 1.9e7 to 4.3e7, and 1e7 for a clock 30 ms off.
NEAREST, FARTHEST = 9e6, 1e8
DEGENERATE = 1e-6  # smallest over largest singular value: with a DOP of 1e6, errors of a metre become 1,000 km
CONVERGED = 1e-4  # m: a correction below this ends the iteration; the next one would be rounding
STEPS = 50  # from 300 km the iteration takes 3 to 5
MOST_SETS = 3000  # of satellites that are tried without: five of 14 make 2,002, and take a second


def place(latitude, longitude, height=0.0):
    """Return the position (3,) in metres at a latitude and longitude in degrees and a height above the ellipsoid.

    >>> place(0.0, 90.0).round()
    array([      0., 6378137.,       0.])
    """
    phi, lam = np.radians(latitude), np.radians(longitude)
    across = EARTH_RADIUS / np.sqrt(1 - FLATNESS * np.sin(phi) ** 2)
    out = (across + height) * np.cos(phi)
    return np.array([out * np.cos(lam), out * np.sin(lam), (across * (1 - FLATNESS) + height) * np.sin(phi)])


def local_axes(x):
    """Return the unit vectors east, north and up at a position (3,) near the ground: the rows of a 3×3 matrix.

    Up is the normal of the ellipsoid; at a height of 10 km it is off by 1e-5 rad. Raises ValueError on the Earth's
    axis, where there is no east.
    """
    x = np.asarray(x, dtype=float)
    if np.hypot(x[0], x[1]) <= 1e-9 * np.abs(x[2]):
        raise ValueError(f"x: needs a position that is not on the Earth's axis, got {x}")
    up = x / [1, 1, 1 - FLATNESS]
    up = up / np.linalg.norm(up)
    east = np.array([-up[1], up[0], 0.0]) / np.hypot(up[0], up[1])
    return np.array([east, np.cross(up, east), up])


def constellation(t):
    """Return the positions of the 24 satellites of the nominal GPS constellation, (24, 3) in metres.

    t is in seconds after 0000Z on 1 July 1993. The orbits are circles of 26,560 km in six planes of 55 degrees.
    """
    node = np.repeat(np.radians(np.array(NODES) - GREENWICH), 4) - 2 * np.pi * t / SIDEREAL_DAY
    u = np.radians(np.ravel(ARGUMENTS)) + 4 * np.pi * t / SIDEREAL_DAY
    along, across = np.cos(u), np.sin(u) * np.cos(INCLINATION)
    x = along * np.cos(node) - across * np.sin(node)
    y = along * np.sin(node) + across * np.cos(node)
    return ORBIT_RADIUS * np.column_stack([x, y, np.sin(u) * np.sin(INCLINATION)])


def elevation(satellites, x):
    """Return the elevation (m,) in degrees of satellites (m, 3) above the horizon of a position (3,)."""
    away = satellites - x
    sine = away @ local_axes(x)[2] / np.linalg.norm(away, axis=1)
    return np.degrees(np.arcsin(np.clip(sine, -1, 1)))


def sky(x, t, mask=10.0):
    """Return the satellites of the nominal constellation above the mask (degrees) at a position and time, (m, 3)."""
    satellites = constellation(t)
    return satellites[elevation(satellites, x) > mask]


def pseudoranges(satellites, X):
    """Return the pseudoranges P(X) without errors, (m,) in metres (2007 Eq. 5): distances plus clock shift."""
    return np.linalg.norm(satellites - X[:3], axis=1) + X[3]


def linearised(satellites, X):
    """Return H (m, 4), the derivatives of the pseudoranges by [x y z D'] at X (2007 Eq. 6).

    >>> linearised(np.array([[3.0, 4.0, 0.0]]), np.array([0.0, 0.0, 0.0, 10.0]))
    array([[-0.6, -0.8, -0. ,  1. ]])
    """
    away = satellites - X[:3]
    return np.column_stack([-away / np.linalg.norm(away, axis=1)[:, None], np.ones(len(away))])


def position_steps(satellites, ranges, start, steps):
    """Return the iterates of the rough position (2007 Eq. 7), (steps + 1, 4); the first one is the start.

    satellites is (m, 3), ranges their pseudoranges, the same (m,) for all steps or others (steps, m) for each, start
    the known [x y z D'], all in metres. Raises ValueError for fewer than four satellites, ranges that cannot be, and a
    degenerate geometry.

    >>> X = np.array([*place(56.95, 24.1), 5e3])
    >>> satellites = sky(X[:3], t=0.0)
    >>> path = position_steps(satellites, pseudoranges(satellites, X), X + [3e5, 0, 0, -5e3], steps=2)
    >>> print(*(f"{gap:.0e}" for gap in np.linalg.norm(path - X, axis=1)))
    3e+05 2e+03 5e-02
    """
    satellites, ranges, sigma = _checked_epoch(satellites, ranges, np.ones(len(satellites)), dimensions=(1, 2))
    path = [checks.array("start", start, (4,))]
    for each in np.broadcast_to(ranges, (steps, len(satellites))):
        path.append(path[-1] + _correction(satellites, each, sigma, path[-1]))
    return np.array(path)


def _correction(satellites, ranges, sigma, X):
    """Return the step of Eq. 7, (HᵀH)⁻¹Hᵀ (ranges - P(X)), with each range in units of its sigma."""
    H = linearised(satellites, X) / sigma[:, None]
    step, _, _, singular = np.linalg.lstsq(H, (ranges - pseudoranges(satellites, X)) / sigma, rcond=None)
    if singular[-1] <= DEGENERATE * singular[0]:
        raise ValueError("satellites: needs a geometry that determines a position, got a degenerate one")
    return step


class Fix(NamedTuple):
    """A position X [x y z D'], its covariance, and whether the ranges agree with each other.

    P (4, 4) holds for the variances that were stated. used (m,) says which satellites made the fix. residuals (m,) are
    measured minus computed ranges, of excluded satellites too. chi_square is the sum of the squared residuals of the
    satellites used, over their variances. probability is the probability that chance alone gives a sum at least this
    large, NaN with four satellites. trusted is True where a test was asked for, the satellites used have passed it, and
    enough of them are to spare: two beyond four, and more than were left out.
    """

    X: np.ndarray
    P: np.ndarray
    residuals: np.ndarray
    used: np.ndarray
    chi_square: float
    probability: float
    trusted: bool = False


def position(satellites, ranges, start=(0.0, 0.0, 0.0, 0.0), *, variance=1.0, false_alarm=None):
    """Return the `Fix` to which the iteration of `position_steps` converges, by default from the Earth's centre.

    satellites is (m, 3), ranges (m,), start [x y z D'], in metres. variance is that of a range (m²), a number or (m,).
    There is one clock shift D': the satellites must be of one system (GPS, or Galileo), or their ranges corrected for
    the offsets between the clocks of the systems. Otherwise the position is wrong by some of that offset, and the test
    below may pass all the same.

    With a false_alarm, such as 1e-3, the residuals are tested (chi-square). While their probability is lower, one more
    satellite is left out: of all sets of so many, the one without which the residuals are smallest (receiver autonomous
    integrity monitoring, RAIM). Of m satellites at most (m - 4) // 2 are left out: one of six, two of eight. Were there
    more faulty ones, as many satellites could agree on a wrong position as on the right one.

    `trusted` is False, and P says nothing about the error, where the test fails to the end: then the fix of all
    satellites is returned. It is False too where another set passes the test and gives another position, so that nobody
    knows which one is right. And it is False where so few satellites are to spare that a wrong set passes by luck: with
    five satellites one in a hundred does, if their ranges are wrong by kilometres at a variance of (4.5 m)². So two
    satellites beyond four have to agree, and more of them than were left out. The test sees faults of some satellites,
    not errors that all ranges share with their neighbours, such as the ionosphere.

    Raises ValueError for fewer than four satellites, for ranges that are zero, missing or absurd, for a false_alarm
    that is no probability, and where the iteration does not converge or the satellites do not determine a position.

    >>> X = np.array([*place(56.95, 24.1), 5e3])
    >>> satellites = sky(X[:3], t=0.0)
    >>> ranges = pseudoranges(satellites, X)
    >>> ranges[2] -= 100
    >>> fix = position(satellites, ranges, false_alarm=1e-3)
    >>> np.flatnonzero(~fix.used), bool(np.abs(fix.X - X).max() < 1e-6), fix.trusted
    (array([2]), True, True)
    """
    satellites, ranges, sigma = _checked_epoch(satellites, ranges, variance)
    if false_alarm is not None:
        checks.number("false_alarm", false_alarm, "a probability between 0 and 1", lambda value: 0 < value < 1)
    everyone = np.full(len(ranges), True)
    fix = _fix(satellites, ranges, sigma, checks.array("start", start, (4,)), everyone)
    if false_alarm is None:
        return fix
    if fix.probability >= false_alarm:
        return fix._replace(trusted=_enough_to_spare(fix))
    for count in range(1, (len(ranges) - 4) // 2 + 1):
        passing = []
        for used in _without(len(ranges), count):
            with suppress(ValueError):  # these do not determine a position
                passing.append(_fix(satellites, ranges, sigma, fix.X, used))
        passing = [each for each in passing if each.probability >= false_alarm]
        if passing:
            best = min(passing, key=lambda each: each.chi_square)
            alone = all(_agree(best, each, false_alarm) for each in passing)
            return best._replace(trusted=alone and _enough_to_spare(best))
    return fix


def _enough_to_spare(fix):
    """Tell whether two satellites beyond four made a fix, and more than were left out."""
    to_spare = fix.used.sum() - 4
    return bool(to_spare >= 2 and to_spare > (~fix.used).sum())


def _without(m, count):
    """Return masks (m,) of all sets without so many of m satellites; none where there are more than `MOST_SETS`."""
    if comb(m, count) > MOST_SETS:
        return []
    masks = np.ones((comb(m, count), m), dtype=bool)
    for mask, left_out in zip(masks, combinations(range(m), count), strict=True):
        mask[list(left_out)] = False
    return list(masks)


def _agree(one, other, false_alarm):
    """Tell whether two fixes differ by no more than chance, of the probability false_alarm, makes of their P."""
    gap = one.X - other.X
    return bool(gammaincc(2, gap @ np.linalg.solve(one.P + other.P, gap) / 2) >= false_alarm)


def _fix(satellites, ranges, sigma, X, used):
    """Return the `Fix` of the satellites that are used (m,), by the iteration that starts at X."""
    for _ in range(STEPS):
        step = _correction(satellites[used], ranges[used], sigma[used], X)
        X = X + step
        if np.abs(step).max() < CONVERGED:
            break
    else:
        raise ValueError(f"start: needs a position from which the iteration converges, got a last correction of {step}")
    H = linearised(satellites[used], X) / sigma[used, None]
    residuals = ranges - pseudoranges(satellites, X)
    chi_square = float(np.sum((residuals[used] / sigma[used]) ** 2))
    redundant = used.sum() - 4
    probability = float(gammaincc(redundant / 2, chi_square / 2)) if redundant else np.nan
    return Fix(X, np.linalg.inv(H.T @ H), residuals, used, chi_square, probability)


def _checked_epoch(satellites, ranges, variance, dimensions=(1,)):
    """Return the arrays of satellites (m, 3), ranges (..., m) and standard deviations (m,) of one epoch, or raise."""
    satellites, ranges = _filled(satellites), _filled(ranges)
    if satellites.ndim != 2 or satellites.shape[1] != 3 or len(satellites) < 4:
        raise ValueError(f"satellites: needs an (m, 3) array of at least 4, got shape {satellites.shape}")
    if ranges.ndim not in dimensions or ranges.shape[-1] != len(satellites):
        raise ValueError(f"ranges: needs one for each of {len(satellites)} satellites, got shape {ranges.shape}")
    _require_plausible("satellites", "positions", np.linalg.norm(satellites, axis=1))
    _require_plausible("ranges", "pseudoranges", ranges)
    return satellites, ranges, _checked_sigma(variance, np.full(len(satellites), True))


def _filled(values):
    """Return an array of doubles, with NaN for what a masked array hides."""
    return np.ma.filled(np.ma.asarray(values, dtype=float), np.nan)


def _checked_sigma(variance, measured):
    """Return the standard deviations of ranges, in the shape of `measured` (where there are any), or raise."""
    of_each = np.broadcast_to(np.asarray(variance, dtype=float), measured.shape)
    used = of_each[measured]
    if not (np.isfinite(used) & (used > 0)).all():
        raise ValueError(f"variance: needs a positive number, or one for each range, got {variance}")
    return np.sqrt(of_each)


def _require_plausible(name, what, distances):
    bad = np.argwhere(~((distances >= NEAREST) & (distances <= FARTHEST)))
    if len(bad):
        got = f"{distances[tuple(bad[0])]:g} at index {bad[0].tolist()} (leave out what was not measured)"
        raise ValueError(f"{name}: needs {what} of {NEAREST:.0e} to {FARTHEST:.0e} m, got {got}")


class Followed(NamedTuple):
    """The result of a filter over N epochs of m satellites: estimates X (N, 4) and their covariances P (N, 4, 4).

    innovations (N, m) are measured ranges minus those expected before the epoch, and S (N, m, m) is what the filter
    states of their covariance. Both are NaN where a satellite was not measured.
    """

    X: np.ndarray
    P: np.ndarray
    innovations: np.ndarray
    S: np.ndarray


def position_kalman(satellites, ranges, start, P0, Q, variance, *, linearisations=1):
    """Return the `Followed` of an extended Kalman filter over epochs of pseudoranges (2007 Eqs. 6, 11).

    ranges is (N, m), with NaN, or a mask, where a satellite was not measured; satellites is (N, m, 3), or (m, 3) where
    they stand still; variance is that of a range (m²): a number, (m,) or (N, m). start (4,) and P0 (4, 4) belong to the
    step before the first epoch, and Q (4, 4) is added at each epoch, so that the last X and P of one track start the
    next. Its last entry is the receiver's clock (m²): 1e12 for one that runs free, or the position follows it. P0 and Q
    may be singular: what they leave without variance stays as it is. As in `position`, there is one clock, for
    satellites of one system.

    H is linearised at the prediction. With more linearisations the next ones are at the estimate so far (the iterated
    filter). No range is tested: set those that `position` leaves out to NaN, or those whose innovation is too large for
    its S. Raises ValueError for ranges that are zero or absurd, a measured satellite without a position, a variance
    that is not positive, a start of another shape, a P0 or Q that is no 4×4 covariance and fewer than one
    linearisation.

    >>> X = np.array([*place(56.95, 24.1), 5e3])
    >>> satellites = sky(X[:3], t=0.0)
    >>> ranges = pseudoranges(satellites, X) + [[0], [0], [7]]
    >>> track = position_kalman(satellites, ranges, X, P0=np.diag([0, 0, 0, 1]), Q=np.zeros((4, 4)), variance=1.0)
    >>> track.innovations[2, :2].round(3), track.S[2, :2, :2].round(3)
    (array([7., 7.]), array([[1.059, 0.059],
           [0.059, 1.059]]))
    """
    ranges = _filled(ranges)
    measured = ~np.isnan(ranges)
    _require_plausible("ranges", "pseudoranges", np.where(measured, ranges, NEAREST))
    sigma = _checked_sigma(_filled(variance), measured)
    checks.count("linearisations", linearisations)
    satellites = np.broadcast_to(_filled(satellites), (*ranges.shape, 3))
    distances = np.linalg.norm(satellites, axis=2)
    _require_plausible("satellites", "positions", np.where(measured, distances, NEAREST))
    X = checks.array("start", start, (4,))
    P, Q = checks.covariance("P0", P0, 4), checks.covariance("Q", Q, 4)
    N, m = ranges.shape
    track = Followed(np.empty((N, 4)), np.empty((N, 4, 4)), np.full((N, m), np.nan), np.full((N, m, m), np.nan))
    for k, seen in enumerate(measured):
        P = P + Q
        if seen.any():
            now = satellites[k, seen], ranges[k, seen], sigma[k, seen]
            track.innovations[k, seen], track.S[k][np.ix_(seen, seen)] = _innovation(*now, X, P)
            X, P = _update(*now, X, P, linearisations)
        track.X[k], track.P[k] = X, P
    return track


def _innovation(satellites, ranges, sigma, predicted, P):
    """Return measured minus expected ranges (m,) at a prediction, and their covariance (m, m)."""
    H = linearised(satellites, predicted)
    return ranges - pseudoranges(satellites, predicted), H @ P @ H.T + np.diag(sigma**2)


def _update(satellites, ranges, sigma, predicted, P, linearisations):
    """Return X and P after one epoch, by least squares over prediction and measurements.

    That is Eq. 11 in another form, which keeps its digits where P is 1e11 times R. The unknowns are u in X = predicted
    + G u, with P = G Gᵀ and a variance of one each: so a P that is singular needs no inverse.
    """
    G = square_root(P)
    X = predicted
    for _ in range(linearisations):
        H = linearised(satellites, X)
        expected = pseudoranges(satellites, X) + H @ (predicted - X)
        orthogonal, triangular = np.linalg.qr(np.vstack([np.eye(4), H @ G / sigma[:, None]]))
        new = np.append(np.zeros(4), (ranges - expected) / sigma)
        X = predicted + G @ np.linalg.solve(triangular, orthogonal.T @ new)
    half = np.linalg.solve(triangular.T, G.T)
    return X, half.T @ half


class Line(NamedTuple):
    """A line through points i = 1 ... n: its position at i = 0, one step before the first, and its velocity (m/s)."""

    start: np.ndarray
    velocity: np.ndarray


def line_fit(x, dt):
    """Return the least-squares line through n >= 2 positions, dt seconds apart (2007 Eqs. 8-10).

    x is (n,) or (n, ...), in metres. Eq. 9 gives a displacement for each step; it is divided by dt. The sums are those
    of doubles, whatever numbers x has; a line through a missing position is NaN. Raises ValueError for fewer than two
    positions.

    >>> line_fit(np.array([1.0, 3.0, 5.0]), dt=0.5)
    Line(start=np.float64(-1.0), velocity=np.float64(4.0))
    """
    x = _filled(x)
    n = len(x)
    if n < 2:
        raise ValueError(f"x: needs at least 2 positions, got {n}")
    i = np.arange(1.0, n + 1)  # the sums of integers would overflow above n = 100,000
    sum_i, sum_ii = i.sum(), i @ i
    sum_x, sum_ix = x.sum(axis=0), np.tensordot(i, x, 1)
    d = n * sum_ii - sum_i**2
    step = (n * sum_ix - sum_i * sum_x) / d
    return Line(start=(sum_ii * sum_x - sum_i * sum_ix) / d, velocity=step / dt)


def line_sigma(n, i, autocorrelation=None):
    """Return the standard error of the fitted position at point i of n, in units of that of one position.

    i is a number or an array: 0 is Eq. 8, n the newest point, n + 1 the expected position. For independent errors the
    result is sqrt(1/n + 12 (i - (n + 1)/2)² / (n (n² - 1))), which is 1/sqrt(n) only in the middle of the window. With
    an autocorrelation (1, ρ1, ρ2, ...) of the errors, for at least n lags, it is sqrt(cᵀ R c): c are the weights of the
    fit, and R has the entries ρ_|j-k|.

    >>> line_sigma(100, np.array([0, 50.5, 100])).round(3)
    array([0.202, 0.1  , 0.199])
    >>> line_sigma(100, 100, autocorrelation=0.99 ** np.arange(100)).round(3)
    np.float64(1.064)
    """
    if n < 2:
        raise ValueError(f"n: needs at least 2 points, got {n}")
    if autocorrelation is not None and len(autocorrelation) < n:
        raise ValueError(f"autocorrelation: needs at least n = {n} lags, got {len(autocorrelation)}")
    off = np.asarray(i, dtype=float)[..., None] - (n + 1) / 2
    c = 1 / n + 12 * off * (np.arange(1, n + 1) - (n + 1) / 2) / (n * (n**2 - 1))
    R = np.eye(n) if autocorrelation is None else toeplitz(np.asarray(autocorrelation, dtype=float)[:n])
    return np.sqrt(np.sum((c @ R) * c, axis=-1))


class Tracked(NamedTuple):
    """Positions and velocities (N, 2 m) or (N, 2 m, M), [x v y v ...], and the lengths (N,) or (N, M) of the window."""

    x: np.ndarray
    n: np.ndarray


def adaptive_line(z, dt, threshold, smallest, largest):
    """Return the newest point and the velocity of a line fit whose window adapts itself (2007, after Eq. 10).

    Where a position is more than `threshold` (the paper's Δx, metres) from the expected one, x_n + V dt, the window
    falls to `smallest` epochs (the paper's 2...5). Otherwise, and at a missed epoch, it grows by one, up to `largest`.
    x_n is the fitted position. With a threshold of infinity the window only grows.

    z is (N, m) or (N, m, M): m coordinates, which share a window, of M tracks. A row with NaN, or masked, is a missed
    epoch, at which the line goes on. There is no line (NaN) before `smallest` epochs, and from fewer than two measured
    ones.

    >>> z = np.array([[0.0], [1.0], [2.0], [3.0], [14.0], [15.0]])
    >>> adaptive_line(z, dt=1.0, threshold=3.0, smallest=2, largest=100).n
    array([2, 2, 3, 4, 2, 2])
    """
    if not 2 <= smallest <= largest:
        raise ValueError(f"smallest: needs 2 or more, and at most largest, got {smallest} and {largest}")
    if np.ndim(z) == 2:
        one = adaptive_line(_filled(z)[..., None], dt, threshold, smallest, largest)
        return Tracked(one.x[..., 0], one.n[:, 0])
    z = _filled(z)
    N, m, M = z.shape
    measured = ~np.isnan(z).any(axis=1)
    z = np.where(measured[:, None], z, 0.0)
    newest = np.full((N, m, M), np.nan)
    velocity = np.full((N, m, M), np.nan)
    windows = np.full((N, M), smallest)
    for k in range(smallest - 1, N):
        if k >= smallest:
            expected = newest[k - 1] + velocity[k - 1] * dt
            off = measured[k] & (np.linalg.norm(z[k] - expected, axis=0) > threshold)
            windows[k] = np.where(off, smallest, np.minimum(windows[k - 1] + 1, largest))
        block = slice(max(k + 1 - largest, 0), k + 1)
        age = np.arange(k - block.start, -1, -1)[:, None]
        inside = (age < windows[k]) & measured[block]
        newest[k], velocity[k] = _newest_point(z[block], -age * dt, inside)
    return Tracked(np.stack([newest, velocity], axis=2).reshape(N, 2 * m, M), windows)


def _newest_point(z, t, inside):
    """Return position and velocity (m, M) at t = 0 of the lines through the points (L, m, M) that are inside (L, M).

    The sums are about the means of the window, so that no digits cancel however long a track is.
    """
    weight = inside / np.maximum(inside.sum(axis=0), 1)
    mean_t = (weight * t).sum(axis=0)
    mean_z = np.einsum("lm,lcm->cm", weight, z)
    lever = weight * (t - mean_t)
    spread = (lever * t).sum(axis=0)
    velocity = np.einsum("lm,lcm->cm", lever, z - mean_z) / np.where(spread > 0, spread, np.nan)
    return mean_z - velocity * mean_t, velocity
