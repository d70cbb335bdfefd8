"""What the notebook on the paper of 2007 simulates: skies drawn at random, tracks of GPS and INS.

All trackers of this paper except the adaptive window are linear in the measurements. So the mean and the covariance of
their errors are computed without a seed, from the effect of each measurement's error alone.
"""

from dataclasses import replace

import numpy as np

from mpt_helpers.kalman import KalmanFilter

from . import positioning

# The paper does not say which measurement belongs to the third row of H_k, [1 -dt 0]. Each reading computes it from the
# time step, the last estimate, and the measurements (GPS, INS, second receiver) of the step before and of this step.
READINGS = {
    "no third row": None,
    "second receiver": lambda dt, x, before, now: before[2],
    "GPS again": lambda dt, x, before, now: before[0],
    "own estimate": lambda dt, x, before, now: x[0],
    "GPS - Δt (INS - b)": lambda dt, x, before, now: now[0] - dt * (now[1] - x[2]),
}


def random_sky(rng):
    """Return the satellites (m, 3) above the mask, and the state [x y z D'], at a random position and time.

    The position is uniform over the sphere of directions, the time over a sidereal day, D' is zero.

    >>> satellites, X = random_sky(np.random.default_rng(0))
    >>> satellites.shape, X.shape
    ((9, 3), (4,))
    """
    latitude = np.degrees(np.arcsin(rng.uniform(-1, 1)))
    x = positioning.place(latitude, rng.uniform(-180, 180))
    return positioning.sky(x, rng.uniform(0, positioning.SIDEREAL_DAY)), np.append(x, 0.0)


def rough_errors(start, sigma, steps, rng, M, anew=True):
    """Return the errors (steps + 1, M) of the rough position over the iteration (2007 Figs. 1, 2), in M random runs.

    Each run has a `random_sky`, and range errors of standard deviation sigma: others at each step, or the same for all
    steps. start takes the true [x y z D'] to the known one. The errors are distances to the true position, at the start
    and after each step.

    >>> def off(X):
    ...     return X + np.array([3e5, 0, 0, 5e3])
    >>> rough_errors(off, 1.0, 3, np.random.default_rng(0), 2)[0]
    array([300000., 300000.])
    """
    errors = []
    for _ in range(M):
        satellites, X = random_sky(rng)
        exact = positioning.pseudoranges(satellites, X)
        noise = sigma * rng.standard_normal((steps if anew else 1, len(satellites)))
        path = positioning.position_steps(satellites, exact + (noise if anew else noise[0]), start(X), steps)
        errors.append(np.linalg.norm((path - X)[:, :3], axis=1))
    return np.transpose(errors)


def change(before, after, seconds, N, dt=1.0, phase=0.0):
    """Return a track (N, 2), position and velocity, whose velocity changes from `before` to `after` within `seconds`.

    The change begins `phase` steps before sample N/2. It is a ramp, or a jump for 0 seconds; the position is the
    integral of the velocity.

    >>> change(0.0, 2.0, 2.0, 6)[2:]
    array([[0. , 0. ],
           [0. , 0. ],
           [0.5, 1. ],
           [2. , 2. ]])
    """
    k = np.arange(N)
    t = dt * (k - N // 2 + phase)
    since = np.maximum(t, 0)
    ramp = np.minimum(since, seconds)
    share = ramp / seconds if seconds else (t >= 0).astype(float)  # of the change, so far
    way = (share * ramp) / 2 + since - ramp  # the integral of the share
    return np.column_stack([before * dt * k + (after - before) * way, before + (after - before) * share])


def exact_moments(tracker, z, truth, sigmas):
    """Return the mean (N, n, M) and the covariance (N, n, n) of a linear tracker's errors, without drawing any.

    tracker takes measurements (N, m, M) of M tracks to estimates (N, n, M). z (N, m, M) are the measurements without
    errors, truth (N, n, M) is what the tracker estimates, sigmas (m,) are the standard deviations of the measurements'
    independent errors, the same for all tracks.

    >>> z = np.array([[[1.0]], [[1.0]]])
    >>> mean, covariance = exact_moments(lambda z: z.cumsum(axis=0), z, truth=z, sigmas=[3.0])
    >>> mean.ravel(), covariance.ravel()
    (array([0., 1.]), array([ 9., 18.]))
    """
    N, m, _ = z.shape
    one_error_each = np.diag(np.tile(sigmas, N)).reshape(N, m, N * m)
    without = np.zeros((N, m, 1))
    estimates = tracker(np.concatenate([one_error_each, without, z], axis=2))  # side by side: the gains are made once
    of_errors, of_none, of_z = np.split(estimates, [N * m, N * m + 1], axis=2)
    effects = of_errors - of_none  # (N, n, N m)
    return of_z - truth, effects @ effects.swapaxes(1, 2)


def exact_rms(tracker, z, truth, sigmas):
    """Return the root mean square (N, n, M) of a linear tracker's errors, with the arguments of `exact_moments`."""
    mean, covariance = exact_moments(tracker, z, truth, sigmas)
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    return np.sqrt(mean**2 + variance[..., None])


def filter_of(model, reading):
    """Return the filter of Eq. 11 for a model of three rows and a reading of the third, one of `READINGS`."""
    if reading == "no third row":
        model = replace(model, H=model.H[:2], R=model.R[:2, :2])
    return KalmanFilter(model)


def kalman(model, z, reading):
    """Run `filter_of` a model and a reading over GPS and INS; return the estimates (N, 3, M).

    z is (N + 1, 2, M), or (N + 1, 3, M) with a second receiver. x0 and P0 hold at row 0. The filter starts at row 1;
    only a reading that looks one step back uses row 0. The filter takes the third measurement as independent.
    """
    A, B, _ = filter_of(model, reading).coefficients(len(z) - 1)
    third_of = READINGS[reading]
    dt = model.F[0, 1]
    x = np.repeat(model.x0[:, None], z.shape[2], axis=1)
    estimates = []
    for A_k, B_k, before, now in zip(A, B, z[:-1], z[1:], strict=True):
        measured = now[:2]
        if third_of is not None:
            measured = np.vstack([measured, third_of(dt, x, before, now)])
        x = A_k @ x + B_k @ measured
        estimates.append(x)
    return np.array(estimates)
