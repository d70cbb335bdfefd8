"""Minimisation of -log L, for `fitting`.

A point (d,) is the vector of the natural logarithms of d parameters, so that a distance is the logarithm of a factor.
Searches along lines, over many decades, find a point near the minimum; scipy's Newton method refines it.
"""

import math

import numpy as np
from scipy.optimize import minimize, minimize_scalar

# Tolerance of the search along a line; Newton's method refines the point.
LINE_TOLERANCE = 0.1
# Smaller differences of log L are not significant: it falls by this much at one standard error.
SIGNIFICANT = 0.5

# A search along a line first tries factors of 1e-24 to 1e24, then factors around the best of them, and at last searches
# between the neighbours of that one. An r that the fixes hardly determine may be only a factor of 100 above the values
# that have no effect.
COARSE = math.log(1e4) * np.arange(-6, 7)
AROUND = math.log(10) * np.arange(-2, 3)


def line_search(objective, origin, direction, reach=COARSE, close=LINE_TOLERANCE, nothing=SIGNIFICANT):
    """Return the lowest point origin + s direction (d,) that a search finds, coarse at first.

    objective(point) returns a shift and the function's value after adding the shift to all components of the point.
    `reach` are the values of s that are tried first; the s found is accurate to `close`. Values that differ by less
    than `nothing` count as equal, and of these the one nearest to the start is taken.
    """
    known = {}

    def value(s):
        if (key := round(float(s), 9)) not in known:
            known[key] = objective(origin + s * direction)
        return known[key][1]

    s = 0.0
    for places in (reach, AROUND):
        places = s + places
        values = np.array([value(each) for each in places])
        alike = values <= values.min() + nothing  # several where r has no effect, for example
        s = float(places[np.argmin(np.where(alike, np.abs(places - s), np.inf))])
    bounds = [each if math.isfinite(value(each)) else s for each in (s + AROUND[1], s + AROUND[-2])]
    found = float(minimize_scalar(value, bounds=bounds, method="bounded", options={"xatol": close}).x)
    s = found if value(found) < value(s) else s
    return origin + s * direction + known[round(s, 9)][0]


# Rounds of `coordinate_descent`: each but the last finds a lower point. One or two are usual.
MAX_ROUNDS = 10


def coordinate_descent(function, point):
    """Return the lowest point (d,) that is found along each parameter in turn, and then by Newton's method.

    It starts again while there is a lower point far along a parameter. If q is far too small, for example, a larger r
    explains the motion first, and only then is a larger q better.
    """
    units = np.eye(len(point))
    for _ in range(MAX_ROUNDS):
        for unit in units:
            point = line_search(lambda each: (0.0, function(each)), point, unit)
        point = newton(function, point)
        if min(function(point + s * unit) for unit in units for s in COARSE) > function(point) - SIGNIFICANT:
            break
    return point


# Derivatives of log L are differences between points 0.5 % of a parameter apart. The first ones are biased by h² / 6
# times the third derivative: by 4e-6 of the second one, if both are of one size. Rounding moves the second ones by some
# 1e-16 |log L| / h², 4e-6 for a million measurements.
SPACING = 0.005
# The search ends where the gradient is below this fraction of the largest curvature; a smaller one would be the bias.
FLAT_GRADIENT = 1e-5
# A direction is flat if its curvature is below this fraction of the largest, the rounding error of second differences.
# It is added to all curvatures, since rounding would decide a step along a flat direction.
FLAT_CURVATURE = 1e-6


def newton(function, point):
    """Return the lowest point (d,) that Newton's method finds, in a trust region of a factor of e at first."""
    known = {}  # gradient and curvature of the points so far: scipy asks for one, and later for the other

    def derivatives(at):
        key = at.tobytes()
        if key not in known:
            # Next to a point without a likelihood they are not finite: zeros end the search there.
            _, gradient, H = (np.where(np.isfinite(each), each, 0.0) for each in finite_differences(function, at))
            known[key] = gradient, H + FLAT_CURVATURE * np.abs(H).max() * np.eye(len(H))
        return known[key]

    def gradient(at):
        return derivatives(at)[0]

    def curvature(at):
        return derivatives(at)[1]

    least = FLAT_GRADIENT * np.abs(curvature(point)).max()
    found = minimize(function, point, method="trust-exact", jac=gradient, hess=curvature, options={"gtol": least})
    return found.x


def finite_differences(function, point):
    """Return function(point) (...), its gradient (d, ...) and second derivatives (d, d, ...), by central differences.

    The shape (...) is that of the function's value: () for -log L, (B,) for the shares of B blocks in it.
    """
    d, h = len(point), SPACING
    unit = h * np.eye(d)
    here = function(point)
    up = np.array([function(point + each) for each in unit])
    down = np.array([function(point - each) for each in unit])
    H = np.empty((d, d, *np.shape(here)))
    with np.errstate(invalid="ignore"):  # next to points without a likelihood
        for i in range(d):
            H[i, i] = (up[i] - 2 * here + down[i]) / h**2
            for j in range(i):
                both = function(point + unit[i] + unit[j]) + function(point - unit[i] - unit[j])
                H[i, j] = H[j, i] = (both + 2 * here - up[i] - up[j] - down[i] - down[j]) / (2 * h**2)
        return here, (up - down) / (2 * h), H
