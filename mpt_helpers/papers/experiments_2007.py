"""What the notebook on the paper of 2007 runs: skies drawn at random, a recorded day, tracks of GPS and INS.

All trackers of this paper but the adaptive window are linear in the measurements. So the mean and the covariance of
their errors are computed, without a seed, from what they make of one measurement at a time.
"""

import gzip
from contextlib import suppress
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from . import positioning

# How the third row of H_k, [1 -dt 0], can be read: which measurement it takes. The paper does not say.
READINGS = ("no third row", "second receiver", "GPS again", "own estimate", "GPS - Δt INS")


def random_sky(rng):
    """Return the satellites (m, 3) above the mask, and the state [x y z D'], at a random position and time.

    The position is uniform over the sphere of directions, the time over a sidereal day, D' is zero. At least four
    satellites are in view.

    >>> satellites, X = random_sky(np.random.default_rng(0))
    >>> len(satellites) >= 4, X.shape
    (True, (4,))
    """
    while True:
        x = positioning.place(np.degrees(np.arcsin(rng.uniform(-1, 1))), rng.uniform(-180, 180))
        satellites = positioning.sky(x, rng.uniform(0, positioning.SIDEREAL_DAY))
        if len(satellites) >= 4:
            return satellites, np.append(x, 0.0)


def rough_errors(offset, sigma, steps, rng, M):
    """Return the PDOP and the errors of the rough position over the iteration (2007 Fig. 1), (steps + 2, M).

    Each run has a `random_sky`, independent range errors of standard deviation sigma, and a start that is off by
    `offset`, [x y z D']. After the PDOP come the distances to the true position at the start and after each step; they
    stay NaN where a step meets a degenerate geometry.

    >>> rough_errors(np.array([3e5, 0, 0, 5e3]), 1.0, 3, np.random.default_rng(0), 2)[1]
    array([300000., 300000.])
    """
    result = np.full((steps + 2, M), np.nan)
    for run in range(M):
        satellites, X = random_sky(rng)
        ranges = positioning.pseudoranges(satellites, X) + sigma * rng.standard_normal(len(satellites))
        result[0, run] = np.linalg.norm(positioning.dilution(satellites, X)[:3])
        with suppress(positioning.DegenerateGeometryError):
            path = positioning.position_steps(satellites, ranges, X + offset, steps)
            result[1:, run] = np.linalg.norm((path - X)[:, :3], axis=1)
    return result


class Day(NamedTuple):
    """A table of recorded ranges: N epochs of 32 satellites, NaN where a satellite was not in view."""

    station: np.ndarray  # (3,), as the header of the raw file has it
    seconds: np.ndarray  # (N,)
    satellites: np.ndarray  # (N, 32, 3)
    ranges: np.ndarray  # (N, 32), corrected
    troposphere: np.ndarray  # (N, 32), what was taken from them for it
    dual: np.ndarray  # (N, 32), what to add for two frequencies


def recorded_day(path):
    """Read a table that `notebooks/data/make_table.py` made."""
    rows = np.loadtxt(path, delimiter=",", skiprows=2)
    seconds, k = np.unique(rows[:, 0], return_inverse=True)
    full = np.full((len(seconds), 32, 6), np.nan)
    full[k, rows[:, 1].astype(int) - 1] = rows[:, [2, 3, 4, 5, 7, 8]]
    with gzip.open(path, "rt") as lines:
        station = np.array(next(lines).split(",")[1:], dtype=float)
    return Day(station, seconds, full[..., :3], full[..., 3], full[..., 4], full[..., 5])


def autocorrelation(x):
    """Return the autocorrelation (N,) of a series about its mean, by the sums over N (so that no cᵀ R c is negative).

    >>> autocorrelation(np.array([1.0, -1.0, 1.0, -1.0]))
    array([ 1.  , -0.75,  0.5 , -0.25])
    """
    x = x - x.mean()
    transform = np.abs(np.fft.rfft(x, 2 * len(x))) ** 2
    sums = np.fft.irfft(transform)[: len(x)]
    return sums / sums[0]


def line_errors(errors, n):
    """Return the errors in the middle and at the newest point of all lines through n of a receiver's errors, (2, ...).

    >>> line_errors(np.array([1.0, 2.0, 3.0, 4.0]), 3)
    array([[2., 3.],
           [3., 4.]])
    """
    line = positioning.line_fit(np.lib.stride_tricks.sliding_window_view(errors, n).T, 1.0)
    return np.array([line.start + line.velocity * (n + 1) / 2, line.start + line.velocity * n])


def change(before, after, seconds, N, dt=1.0, phase=0.0):
    """Return a track (N, 2) of position and velocity whose velocity changes in so many seconds, in its middle.

    The velocity is a ramp that begins `phase` steps before sample N/2, a jump for 0 seconds; the position is its
    integral.

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
    share = ramp / seconds if seconds else (t >= 0).astype(float)
    way = (share * ramp) / 2 + since - ramp  # of a change by 1 m/s
    return np.column_stack([before * dt * k + (after - before) * way, before + (after - before) * share])


def noise_weights(tracker, N, m):
    """Return what a linear tracker makes of each measurement by itself, (N, n, N, m).

    tracker takes measurements (N, m, M) of M tracks to estimates (N, n, M).

    >>> noise_weights(lambda z: z.cumsum(axis=0), 2, 1)[:, 0, :, 0]
    array([[1., 0.],
           [1., 1.]])
    """
    one_each = np.eye(N * m).reshape(N, m, N * m)
    weights = tracker(one_each) - tracker(np.zeros((N, m, 1)))
    return weights.reshape(*weights.shape[:2], N, m)


def error_moments(tracker, z, truth, sigmas):
    """Return the mean (N, n, M) and the covariance (N, n, n) of a linear tracker's errors, without drawing any.

    z (N, m, M) are the measurements of M tracks without errors, truth (N, n, M) is what the tracker estimates, sigmas
    (m,) are the standard deviations of the measurements' independent errors, the same for all tracks.
    """
    weights = noise_weights(tracker, *z.shape[:2]) * np.asarray(sigmas)
    weights = weights.reshape(*weights.shape[:2], -1)
    return tracker(z) - truth, weights @ weights.swapaxes(1, 2)


def rms(mean, covariance):
    """Return the root mean square (N, n, M) of errors with this mean (N, n, M) and covariance (N, n, n).

    >>> rms(np.array([[[3.0]]]), np.array([[[16.0]]]))
    array([[[5.]]])
    """
    return np.sqrt(mean**2 + np.einsum("kii->ki", covariance)[..., None])


def kalman(model, z, reading=READINGS[0]):
    """Run Eq. 11 over GPS and INS with a reading of the third row; return the estimates (N, 3, M).

    z is (N + 1, 2, M), or (N + 1, 3, M) with a second receiver: row 0, at which x0 and P0 hold, is used by the readings
    that look one step back only. The filter takes the third measurement as independent, with its variance R_33.
    """
    F, dt, x, estimates = model.F, model.F[0, 1], np.repeat(model.x0[:, None], z.shape[2], axis=1), []
    rows = 2 if reading == "no third row" else 3
    H = model.H[:rows]
    gains = [gain for gain, _ in _steps(model, len(z) - 1, rows)]
    for (before, now), K in zip(pairwise(z), gains, strict=True):
        third = {
            "no third row": now[0],  # left out below
            "second receiver": before[-1],
            "GPS again": before[0],
            "own estimate": x[0],
            "GPS - Δt INS": now[0] - dt * now[1],
        }[reading]
        measured = np.vstack([now[:2], third])[:rows]
        x = F @ x + K @ (measured - H @ F @ x)
        estimates.append(x)
    return np.array(estimates)


def kalman_covariances(model, N, reading=READINGS[0]):
    """Return the covariances (N, 3, 3) that the filter of `kalman` states: they do not depend on what it measures."""
    return np.array([P for _, P in _steps(model, N, 2 if reading == "no third row" else 3)])


def _steps(model, N, rows):
    """Yield the gain and the covariance of N steps of Eq. 11 with so many rows of H."""
    F, H, P = model.F, model.H[:rows], model.P0
    for _ in range(N):
        P = F @ P @ F.T + model.Q
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + model.R[:rows, :rows])
        P = (np.eye(len(F)) - K @ H) @ P
        yield K, P
