"""The search for the lowest point of -log L, for `fitting`.

A point (d,) is the vector of the natural logarithms of d parameters, so that a distance is the logarithm of a factor.
The search looks along lines, over many decades, and goes on from the best point by Newton's method.
"""

import math

import numpy as np
from scipy.optimize import minimize_scalar

# Tolerance of the search along a line; Newton's method continues from there.
NEAR_ENOUGH = 0.1
# A difference of log L below this is not significant: log L falls by as much at one standard error.
NOTHING = 0.5
# A direction whose curvature is below this fraction of the largest one is flat: it is the rounding error of the second
# differences.
FLAT = 1e-6

# A search along a line begins with factors of 1e-24 to 1e24, continues with factors around the best of them, and then
# between its neighbours: an r that the fixes hardly determine can be a factor of 100 away from where it has no effect.
LINE = math.log(1e4) * np.arange(-6, 7)
AROUND = math.log(10) * np.arange(-2, 3)


def along_a_line(rated, origin, direction, reach=LINE, close=NEAR_ENOUGH, nothing=NOTHING):
    """Return the lowest point origin + s direction (d,) that is found: the best of a few far apart, and then near it.

    rated(point) returns a shift and a value: the value is that of the point with the shift added to all its components.
    reach are the values of s that are tried first; the last s is found to `close`. Values that differ by less than
    `nothing` count as equal, and of these the nearest is gone on from.
    """
    known = {}

    def value(s):
        if (key := round(float(s), 9)) not in known:
            known[key] = rated(origin + s * direction)
        return known[key][1]

    s = 0.0
    for places in (reach, AROUND):
        places = s + places
        values = np.array([value(each) for each in places])
        alike = values <= values.min() + nothing  # several where r has no effect, for example: the nearest is best
        s = float(places[np.argmin(np.where(alike, np.abs(places - s), np.inf))])
    bounds = [each if math.isfinite(value(each)) else s for each in (s + AROUND[1], s + AROUND[-2])]
    found = float(minimize_scalar(value, bounds=bounds, method="bounded", options={"xatol": close}).x)
    s = found if value(found) < value(s) else s
    return origin + s * direction + known[round(s, 9)][0]


# Each round of `lowest` but the last finds a lower point; one or two are usual.
MOST_ROUNDS = 10


def lowest(function, point):
    """Return the lowest point (d,) that is found: along each parameter in turn, then by Newton's method.

    It starts again while there is a lower point far along a parameter: if q is far too small, r explains the motion,
    and only after that is a larger q better.
    """
    units = np.eye(len(point))
    for _ in range(MOST_ROUNDS):
        for unit in units:
            point = along_a_line(lambda each: (0.0, function(each)), point, unit)
        point = by_newton(function, point)
        if min(function(point + s * unit) for unit in units for s in LINE) > function(point) - NOTHING:
            break
    return point


# Newton's steps are at most a factor of e long. They end below NEAR, a hundredth of the standard error of a parameter
# that a thousand measurements determine to a few percent.
LONGEST_STEP, MOST_STEPS, MOST_HALVINGS, NEAR = 1.0, 30, 8, 1e-4


def by_newton(function, point):
    """Return the lowest point (d,) that Newton's method finds."""
    for _ in range(MOST_STEPS):
        value, gradient, H = differences(function, point)
        step = step_downhill(gradient, H)
        for _ in range(MOST_HALVINGS):
            if np.abs(step).max() < NEAR:
                return point
            if function(point + step) < value:
                break
            step = step / 2
        else:
            return point
        point = point + step
    return point


def step_downhill(gradient, H):
    """Return the step (d,) to where the gradient (d,) vanishes, by the second derivatives H (d, d).

    It leads downhill where the curvature is negative, leaves flat directions alone, and is limited in length.
    """
    if not (np.isfinite(H).all() and np.isfinite(gradient).all()):  # next to a point that has no likelihood
        return np.zeros(len(H))
    curvatures, directions = np.linalg.eigh(H)
    sizes = np.abs(curvatures)
    bent = sizes > FLAT * sizes.max()
    along = directions.T @ gradient
    step = -directions[:, bent] @ (along[bent] / sizes[bent])
    return step * min(1.0, LONGEST_STEP / max(np.abs(step).max(), NEAR))


# Differences of log L are taken between points 2 % of a parameter apart. The rounding of the second ones,
# 1e-16 |log L| / step², is below 1e-6 of them up to a million measurements. The bias of the first ones, step² / 6 of
# the third, moves the maximum by less than 1e-4.
DIFFERENCE = 0.02


def differences(function, point):
    """Return function(point) (...), its gradient (d, ...) and second derivatives (d, d, ...), by central differences.

    The axes (...) are those of the function: none of -log L, one of the shares of blocks in it.
    """
    d, h = len(point), DIFFERENCE
    unit = h * np.eye(d)
    here = function(point)
    up = np.array([function(point + each) for each in unit])
    down = np.array([function(point - each) for each in unit])
    H = np.empty((d, d, *np.shape(here)))
    with np.errstate(invalid="ignore"):  # beside points that have no likelihood
        for i in range(d):
            H[i, i] = (up[i] - 2 * here + down[i]) / h**2
            for j in range(i):
                both = function(point + unit[i] + unit[j]) + function(point - unit[i] - unit[j])
                H[i, j] = H[j, i] = (both + 2 * here - up[i] - up[j] - down[i] - down[j]) / (2 * h**2)
        return here, (up - down) / (2 * h), H
