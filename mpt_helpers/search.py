"""The search for the parameters of `fitting`: the lowest point of -log L.

A point (d,) is the vector of the natural logarithms of d parameters. In it, a distance is the logarithm of a factor.
The search has three parts, one after the other:

1. Where one line leads near the lowest point, `along_a_line`. Elsewhere Nelder and Mead's simplex, which needs no
   derivatives.
2. Newton's steps, with derivatives by central differences. A few of them reach the lowest point nearby.
3. A look further along each parameter, since log L may be flat over decades. From a lower point there, the simplex and
   Newton's steps go on.
"""

import math

import numpy as np
from scipy.optimize import minimize, minimize_scalar

# How near to the lowest point the search must come: a hundredth of the error of a parameter that a thousand
# measurements tell to some percent.
NEAR = 1e-4
# How near parts 1 and 3 come. Newton's steps, which go on from there, need no more.
NEAR_ENOUGH = 0.1
# A search changes no parameter by more than this factor.
FARTHEST = math.log(1e12)
# A log L that falls by less than this says nothing against a parameter: so much it falls at one standard error.
NOTHING = 0.5
# A direction in which log L curves by less than this part of its largest curvature is flat, by the second differences'
# rounding.
FLAT = 1e-6

# A search along a line looks at these places first, factors of 1e-24 to 1e24, then at those around the best one, and
# then between the neighbours of that: an r that the fixes tell by a little can be a factor of 100 away from where it
# makes no difference.
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
        alike = values <= values.min() + nothing  # several where r makes no difference, say: the nearest is best
        s = float(places[np.argmin(np.where(alike, np.abs(places - s), np.inf))])
    bounds = [each if math.isfinite(value(each)) else s for each in (s + AROUND[1], s + AROUND[-2])]
    found = float(minimize_scalar(value, bounds=bounds, method="bounded", options={"xatol": close}).x)
    s = found if value(found) < value(s) else s
    return origin + s * direction + known[round(s, 9)][0]


# A search goes on from a lower point further on so many times at most.
MOST_SEARCHES = 10


def lowest(function, origin, start):
    """Return the lowest point (d,) of function(point) that is found, by parts 1 to 3 of this module.

    start is a point that `along_a_line` found near it. Where it is None, the search begins at the origin.
    """
    if start is not None:
        origin = start

    def within(point):
        return function(point) if np.abs(point - origin).max() <= FARTHEST else math.inf

    point = _by_simplex(within, origin) if start is None else start
    for _ in range(MOST_SEARCHES):
        point = _by_newton(within, point)
        further = _lower_further_on(within, point)
        if further is None:
            break
        point = _by_simplex(within, further)
    return point


def _by_simplex(function, point):
    """Return the lowest point that Nelder and Mead's search finds, from each guess to e times it."""
    d = len(point)
    simplex = point + np.vstack([np.zeros(d), np.eye(d)])
    options = {"initial_simplex": simplex, "xatol": NEAR_ENOUGH, "fatol": NEAR_ENOUGH, "maxfev": 400 * d}
    return minimize(function, point, method="Nelder-Mead", options=options).x


# Newton's steps are at most so long, a factor of e, and so many at most. Each is shortened so many times.
LONGEST_STEP, MOST_ITERATIONS, MOST_HALVINGS = 1.0, 30, 8


def _by_newton(function, point):
    """Return the lowest point that Newton's steps lead to."""
    for _ in range(MOST_ITERATIONS):
        value, gradient, H = differences(function, point)
        step = _step_downhill(gradient, H)
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


def _step_downhill(gradient, H):
    """Return the step (d,) to where the gradient (d,) vanishes, by the second derivatives H (d, d).

    It goes downwards where H curves the other way, not along a flat direction, and not too far.
    """
    if not (np.isfinite(H).all() and np.isfinite(gradient).all()):
        return np.zeros(len(H))
    curvatures, directions = np.linalg.eigh(H)
    sizes = np.abs(curvatures)
    bent = sizes > FLAT * sizes.max()
    along = directions.T @ gradient
    step = -directions[:, bent] @ (along[bent] / sizes[bent])
    return step * min(1.0, LONGEST_STEP / max(np.abs(step).max(), NEAR))


# A search that has ended looks further along each parameter, by these factors, as long as log L does not change: with
# a process noise far too small, the noise of the measurements explains the motion, and q changes nothing.
FURTHER = tuple(math.log(factor) for factor in (3, 1e3, 1e6, 1e9, 1e12, 1e15, 1e18, 1e21, 1e24))


def _lower_further_on(function, point):
    """Return a point along one parameter that is lower than this one, or None."""
    value = function(point)
    for unit in np.eye(len(point)):
        for sign in (1, -1):
            for far in FURTHER:
                moved = point + sign * far * unit
                change = function(moved) - value
                if change < -NOTHING:
                    return moved
                if change > NOTHING:
                    break
    return None


# Differences of log L are taken between points 2 % of a parameter apart. The rounding of the second ones,
# 1e-16 |log L| / step², is below 1e-6 of them up to a million measurements. The bias of the first ones, step² / 6 of
# the third, moves the maximum by less than NEAR.
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
