"""Least squares of the paper of 2007: a place from pseudoranges (Eqs. 1-7), a line from places (Eqs. 8-10).

Places are in metres, in coordinates that turn with the Earth; a state X is [x y z D'], the place and the receiver's
clock shift as a length. The Earth is a sphere.
"""

from itertools import accumulate, islice, repeat
from typing import NamedTuple

import numpy as np

from . import checks
from .recursion import measurements

EARTH_RADIUS = 6_371e3  # m
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
MASK = 10.0  # degrees of elevation
# A geometry whose smallest singular value is this part of its largest has a DOP near 1e6: errors of a metre become
# 1,000 km there, farther than any start here, and the fix is none.
DEGENERATE = 1e-6
# A correction below this ends the iteration (m): the next one, which is quadratic in it, would be rounding.
CONVERGED = 1e-4
STEPS = 50  # an iteration that has not converged by then wanders: from 300 km it takes 3 to 5


class DegenerateGeometryError(ValueError):
    """The satellites and the place do not determine a position."""


def place(latitude, longitude):
    """Return the place (3,) in metres on the surface of the Earth at a latitude and longitude in degrees.

    Raises ValueError or TypeError for no finite numbers and a latitude beyond 90.

    >>> place(0.0, 90.0).round()
    array([      0., 6371000.,       0.])
    """
    phi = np.radians(checks.number("latitude", latitude, "a number in [-90, 90]", lambda phi: abs(phi) <= 90))
    lam = np.radians(checks.number("longitude", longitude))
    return EARTH_RADIUS * np.array([np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam), np.sin(phi)])


def local_axes(x):
    """Return the unit vectors east, north and up at a place that is not a pole: the rows of a 3×3 matrix.

    Raises ValueError or TypeError for anything else.

    >>> local_axes(place(0.0, 0.0)).round() + 0.0
    array([[0., 1., 0.],
           [0., 0., 1.],
           [1., 0., 0.]])
    """
    x = checks.array("x", x, (3,))
    if np.hypot(x[0], x[1]) <= 1e-9 * np.abs(x[2]):  # east would be of rounding
        checks.refuse("x", "a place that is not on the axis of the Earth", x)
    up = x / np.linalg.norm(x)
    east = np.array([-up[1], up[0], 0.0]) / np.hypot(up[0], up[1])
    return np.array([east, np.cross(up, east), up])


def constellation(t):
    """Return where the 24 satellites of the nominal GPS constellation are, (24, 3) in metres.

    t is in seconds after 0000Z on 1 July 1993. The orbits are circles of 26,560 km in six planes of 55 degrees.

    >>> np.linalg.norm(constellation(0.0), axis=1).round()[:2]
    array([26560000., 26560000.])
    """
    t = checks.number("t", t)
    node = np.repeat(np.radians(np.array(NODES) - GREENWICH), 4) - 2 * np.pi * t / SIDEREAL_DAY
    u = np.radians(np.ravel(ARGUMENTS)) + 4 * np.pi * t / SIDEREAL_DAY
    along, across = np.cos(u), np.sin(u) * np.cos(INCLINATION)
    x = along * np.cos(node) - across * np.sin(node)
    y = along * np.sin(node) + across * np.cos(node)
    return ORBIT_RADIUS * np.column_stack([x, y, np.sin(u) * np.sin(INCLINATION)])


def elevation(satellites, x):
    """Return the elevation (m,) in degrees of satellites (m, 3) above the horizon of a place (3,).

    Raises ValueError or TypeError for other arrays, the centre of the Earth and a place that is a satellite's.

    >>> elevation([[2e7, 0.0, 0.0]], place(0.0, 0.0))
    array([90.])
    """
    satellites, x = checks.finite("satellites", satellites, ("m", 3)), checks.array("x", x, (3,))
    if not x.any() or (satellites == x).all(axis=1).any():
        checks.refuse("x", "a place that is neither the centre of the Earth nor a satellite's", x)
    away = satellites - x
    sine = away @ x / np.linalg.norm(away, axis=1) / np.linalg.norm(x)
    return np.degrees(np.arcsin(np.clip(sine, -1, 1)))


def sky(x, t, mask=MASK):
    """Return the satellites of the nominal constellation above the mask (degrees) at a place and time, (m, 3).

    Raises ValueError or TypeError for what is no place, time or number.

    >>> len(sky(place(56.95, 24.1), t=0.0))
    8
    """
    satellites, mask = constellation(t), checks.number("mask", mask)
    return satellites[elevation(satellites, x) > mask]


def pseudoranges(satellites, X):
    """Return the pseudoranges P(X) without errors, (m,) in metres (2007 Eq. 5): distances plus clock shift.

    Raises ValueError or TypeError for anything but satellites (m, 3) and a state (4,).

    >>> pseudoranges([[3.0, 4.0, 0.0]], [0.0, 0.0, 0.0, 10.0])
    array([15.])
    """
    return _ranges(checks.finite("satellites", satellites, ("m", 3)), checks.array("X", X, (4,)))


def _ranges(satellites, X):
    return np.linalg.norm(satellites - X[:3], axis=1) + X[3]


def linearised(satellites, X):
    """Return H (m, 4), the derivatives of the pseudoranges by [x y z D'] at X (2007 Eq. 6).

    Raises ValueError or TypeError for anything but satellites (m, 3) and a state (4,) that is not at one of them.

    >>> linearised([[3.0, 4.0, 0.0]], [0.0, 0.0, 0.0, 10.0])
    array([[-0.6, -0.8, -0. ,  1. ]])
    """
    satellites, X = checks.finite("satellites", satellites, ("m", 3)), checks.array("X", X, (4,))
    _require_apart("X", satellites, X)
    return _derivatives(satellites, X)


def _derivatives(satellites, X):
    away = satellites - X[:3]
    return np.column_stack([-away / np.linalg.norm(away, axis=1)[:, None], np.ones(len(away))])


def corrected(satellites, ranges, X):
    """Return one step of the iteration (2007 Eq. 7): X + (HᵀH)⁻¹Hᵀ (ranges - P(X)), solved by numpy's least squares.

    Raises DegenerateGeometryError, a ValueError, when the satellites do not determine a position near X, and ValueError
    or TypeError as `position_steps` does.
    """
    return _corrected(*_checked(satellites, ranges, X, "X"))


def _corrected(satellites, ranges, X):
    H = _derivatives(satellites, X)
    step, _, _, singular = np.linalg.lstsq(H, ranges - _ranges(satellites, X), rcond=None)
    _require_determined(singular)
    return X + step


def position_steps(satellites, ranges, start, steps):
    """Return the iterates of the rough position (2007 Eq. 7), (steps + 1, 4); the first one is the start.

    satellites is (m, 3), ranges their pseudoranges (m,), start the known [x y z D'], all in metres.

    Raises ValueError for fewer than four satellites, data that are not finite or do not fit together, and a degenerate
    geometry.

    >>> X = np.array([*place(56.95, 24.1), 5e3])
    >>> satellites = sky(X[:3], t=0.0)
    >>> path = position_steps(satellites, pseudoranges(satellites, X), X + [3e5, 0, 0, -5e3], steps=4)
    >>> [f"{gap:.0e}" if gap > 1e-6 else "below 1e-06" for gap in np.linalg.norm(path - X, axis=1)[:4]]
    ['3e+05', '2e+03', '5e-02', 'below 1e-06']
    """
    steps = checks.count("steps", steps, least=0)
    return np.array(list(islice(iterates(satellites, ranges, start), steps + 1)))


def iterates(satellites, ranges, start):
    """Return an iterator over the iterates of the rough position (2007 Eq. 7), without end; the first is the start.

    Raises ValueError or TypeError as `position_steps` does; DegenerateGeometryError comes with the step that meets it.

    >>> X = np.array([*place(56.95, 24.1), 5e3])
    >>> satellites = sky(X[:3], t=0.0)
    >>> len(next(iterates(satellites, pseudoranges(satellites, X), X)))
    4
    """
    satellites, ranges, start = _checked(satellites, ranges, start)
    return accumulate(repeat(ranges), lambda X, ranges: _corrected(satellites, ranges, X), initial=start)


def position(satellites, ranges, start):
    """Return the position [x y z D'] to which the iteration of `position_steps` converges, (4,) in metres.

    Raises ValueError as it does, and when the iteration does not converge from this start.

    >>> X = np.array([*place(56.95, 24.1), 5e3])
    >>> satellites = sky(X[:3], t=0.0)
    >>> fix = position(satellites, pseudoranges(satellites, X), start=X + [3e5, 0, 0, -5e3])
    >>> bool(np.abs(fix - X).max() < 1e-6)
    True
    """
    satellites, ranges, X = _checked(satellites, ranges, start)
    for _ in range(STEPS):
        before, X = X, _corrected(satellites, ranges, X)
        if np.abs(X - before).max() < CONVERGED:
            return X
    checks.refuse("start", "a place from which the iteration converges", f"a last correction of {X - before} m")


def dilution(satellites, X):
    """Return the dilution of precision east, north, up and of the clock, (4,): standard errors for unit errors.

    They are the square roots of the diagonal of (HᵀH)⁻¹ in local axes. Their norm is the GDOP, that of the first three
    the PDOP. Raises ValueError for fewer than four satellites and a degenerate geometry.

    >>> X = np.array([*place(56.95, 24.1), 0.0])
    >>> np.linalg.norm(dilution(sky(X[:3], t=0.0), X)).round(2)
    np.float64(2.49)
    """
    satellites, X = _satellites(satellites), checks.array("X", X, (4,))
    _require_apart("X", satellites, X)
    H = _derivatives(satellites, X)
    H[:, :3] = H[:, :3] @ local_axes(X[:3]).T
    _require_determined(np.linalg.svd(H, compute_uv=False))
    return np.sqrt(np.diag(np.linalg.inv(H.T @ H)))


def position_kalman(satellites, ranges, start, P0, Q, R, *, linearisations=1):
    """Return the positions of an extended Kalman filter over epochs of pseudoranges, (N, 4) (2007 Eqs. 6, 11).

    satellites is (m, 3), ranges (N, m); start and P0 are the mean (4,) and covariance (4, 4) before the first epoch, Q
    (4, 4) is added between epochs, R is the variance of a pseudorange (m²). H is linearised at the prediction; more
    linearisations of an epoch are at its estimates so far (the iterated filter). Raises ValueError as `position_steps`
    does, but for no geometry (P0 gives a place to each), and for a P0 that is not definite.

    >>> X = np.array([*place(56.95, 24.1), 0.0])
    >>> satellites = sky(X[:3], t=0.0)
    >>> ranges = np.tile(pseudoranges(satellites, X), (3, 1))
    >>> position_kalman(satellites, ranges, X, P0=np.eye(4), Q=np.zeros((4, 4)), R=1.0).shape
    (3, 4)
    """
    ranges = checks.matrix("ranges", ranges, "an (N, m) array")
    satellites, _, X = _checked(satellites, ranges[0], start)
    P, Q = checks.covariance("P0", P0, 4, definite=True), checks.covariance("Q", Q, 4)
    sigma, linearisations = np.sqrt(checks.positive("R", R)), checks.count("linearisations", linearisations)
    path = []
    for k, measured in enumerate(ranges):
        P = P + Q if k else P
        # Eq. 11 as least squares of prediction and measurements: its own form loses the digits, as P0 is 1e11 times R.
        prior = np.linalg.cholesky(np.linalg.inv(P)).T
        predicted = X
        for _ in range(linearisations):
            A = np.vstack([prior, _derivatives(satellites, X) / sigma])
            new = np.append(prior @ (predicted - X), (measured - _ranges(satellites, X)) / sigma)
            X = X + np.linalg.lstsq(A, new)[0]
        P = np.linalg.inv(A.T @ A)
        path.append(X)
    return np.array(path)


def _satellites(satellites):
    need = "an (m, 3) array of at least 4 satellites"
    satellites = checks.matrix("satellites", satellites, need)
    if satellites.shape[1] != 3 or len(satellites) < 4:
        checks.refuse("satellites", need, f"shape {satellites.shape}")
    return satellites


def _require_apart(name, satellites, X):
    if (satellites == X[:3]).all(axis=1).any():
        checks.refuse(name, "a place that is not a satellite's", X[:3])


def _checked(satellites, ranges, start, name="start"):
    satellites, start = _satellites(satellites), checks.array(name, start, (4,))
    _require_apart(name, satellites, start)
    return satellites, checks.array("ranges", ranges, (len(satellites),)), start


def _require_determined(singular):
    if singular[-1] <= DEGENERATE * singular[0]:
        need, ratio = "a geometry that determines a position", f"{singular[-1] / singular[0]:.0e}"
        checks.refuse("satellites", need, f"singular values in the ratio {ratio}", DegenerateGeometryError)


class Line(NamedTuple):
    """A line through points i = 1 ... n: its place at i = 0, one step before the first, and its velocity (per s)."""

    start: np.ndarray
    velocity: np.ndarray


def line_fit(x, dt):
    """Return the least-squares line through n places, dt seconds apart (2007 Eqs. 8-10).

    x is (n,) for one track or (n, M) for M tracks, in metres, n >= 2. Eq. 9 gives a displacement for each step; it is
    divided by dt. Raises ValueError for fewer than two places, NaN, or a dt that is not positive.

    >>> line_fit([1.0, 3.0, 5.0], dt=0.5)
    Line(start=np.float64(-1.0), velocity=np.float64(4.0))
    """
    need = "an (n,) or (n, M) array of at least 2 places"
    x, dt = checks.real("x", x, need), checks.positive("dt", dt)
    if x.ndim not in (1, 2) or len(x) < 2 or 0 in x.shape or np.isnan(x).any():
        checks.refuse("x", need, f"shape {x.shape}" if not np.isnan(x).any() else "NaN")
    i = np.arange(1, len(x) + 1)
    return _line(len(x), x.sum(axis=0), i @ x, dt)


def _line(n, sum_x, sum_ix, dt):
    """Return the line from n and the sums of x_i and of i x_i over i = 1 ... n (2007 Eqs. 8-10)."""
    sum_i, sum_ii = n * (n + 1) / 2, n * (n + 1) * (2 * n + 1) / 6
    d = n * sum_ii - sum_i**2
    return Line((sum_ii * sum_x - sum_i * sum_ix) / d, (n * sum_ix - sum_i * sum_x) / d / dt)


def line_sigma(n, i):
    """Return the standard error of the fitted place at point i of n, in units of that of one place.

    It is sqrt(1/n + 12 (i - (n + 1)/2)² / (n (n² - 1))): 1/sqrt(n) in the middle of the window, i = (n + 1)/2, and
    nowhere else. i = 0 is Eq. 8, i = n the newest point, i = n + 1 the expected place. i is a number or an array.

    Raises ValueError or TypeError for an n below 2 and an i that is not finite.

    >>> line_sigma(100, np.array([0, 50.5, 100])).round(3)
    array([0.202, 0.1  , 0.199])
    """
    n, i = checks.count("n", n, least=2), checks.finite("i", i)[()]
    return np.sqrt(1 / n + 12 * np.square(i - (n + 1) / 2) / (n * (n**2 - 1)))


class Tracked(NamedTuple):
    """Place and velocity (N, 2) or (N, 2, M) at each step, and the length (N,) or (N, M) of the window behind them."""

    x: np.ndarray
    n: np.ndarray


def fitted_place(measured, fitted):
    """Return the place that `adaptive_line` expects the next one from: the newest point of the line."""
    return fitted


def measured_place(measured, fitted):
    """Return the place that `adaptive_line` expects the next one from: the newest measured place."""
    return measured


def adaptive_line(z, dt, threshold, smallest, largest, fall=None, last=fitted_place):
    """Return the newest point and the velocity of a line fit whose window adapts itself (2007, after Eq. 10).

    A place that is more than `threshold` (the paper's Δx, metres) from the expected one, x_n + V dt, takes `fall`
    points from the window, but leaves `smallest` (the paper's 2...5); where fall is None it takes all the others. A
    place that is nearer adds one, up to `largest`. A threshold of infinity grows the window only; smallest = largest
    keeps it as it is. `last` says what the paper's x_n is: `fitted_place` or `measured_place`.

    z is (N, 1) or (N, 1, M), the measured places. The first smallest - 1 rows of the result have no line: NaN.

    Raises ValueError for missed epochs, smallest < 2, largest < smallest, fewer than `smallest` places, and TypeError
    for a `last` that is no function.

    >>> z = np.array([[0.0], [1.0], [2.0], [3.0], [14.0], [15.0]])
    >>> adaptive_line(z, dt=1.0, threshold=3.0, smallest=2, largest=100).n
    array([2, 2, 3, 4, 2, 2])
    """
    z, missed = measurements(z, 1)
    if missed.any():
        checks.refuse("z", "places without a missed epoch", f"{missed.sum()} of them")
    dt, *window = line_window(dt, threshold, smallest, largest, fall, last)
    if len(z) < smallest:
        checks.refuse("z", f"at least {smallest} places, as smallest says", len(z))
    one = z.ndim == 2
    tracked = _adapt(z[:, 0] if not one else z, dt, *window)
    return Tracked(tracked.x[..., 0], tracked.n[..., 0]) if one else tracked


def line_window(dt, threshold, smallest, largest, fall=None, last=fitted_place):
    """Return what follows z in `adaptive_line`, checked, as a tuple: an absent `fall` is `largest`.

    >>> line_window(0.5, np.inf, 2, 100)[:5]
    (0.5, inf, 2, 100, 100)
    """
    dt = checks.positive("dt", dt)
    endless = isinstance(threshold, float) and threshold == np.inf
    threshold = threshold if endless else checks.positive("threshold", threshold)
    smallest = checks.count("smallest", smallest, least=2)
    largest = checks.count("largest", largest, least=smallest)
    fall = largest if fall is None else checks.count("fall", fall)
    return dt, threshold, smallest, largest, fall, checks.function("last", last, "a function such as fitted_place")


def _adapt(z, dt, threshold, smallest, largest, fall, last):
    N, M = z.shape
    x, windows = np.full((N, 2, M), np.nan), np.full((N, M), smallest)
    # Sums over the places up to k, of z and of k z; they start from the first place, so that they stay short numbers.
    first, k, tracks = z[0], np.arange(1, N + 1)[:, None], np.arange(M)
    zero = np.zeros((1, M))
    sums = np.concatenate([zero, (z - first).cumsum(axis=0)])
    moments = np.concatenate([zero, (k * (z - first)).cumsum(axis=0)])
    n = windows[0]
    for end in range(smallest, N + 1):
        if end > smallest:
            off = np.abs(z[end - 1] - last(z[end - 2], x[end - 2, 0]) - x[end - 2, 1] * dt) > threshold
            n = np.where(off, np.maximum(n - fall, smallest), np.minimum(n + 1, largest))
        begin = end - n
        sum_x = sums[end] - sums[begin, tracks]
        line = _line(n, sum_x, moments[end] - moments[begin, tracks] - begin * sum_x, dt)
        x[end - 1] = first + line.start + n * dt * line.velocity, line.velocity
        windows[end - 1] = n
    return Tracked(x, windows)
