"""Tracks without gaps share their coefficients: these are computed once, and several steps are taken at a time.

    x(k+1) = A_k x(k) + B_k z(k+1)

For the Kalman filter A_k = (I - K_k H) F and B_k = K_k. A_k and B_k never depend on the measured values, so tracks
without gaps share them. `recursion` is the plain loop. `run_shared` computes the same, up to rounding, in less time: L
successive steps are one matrix product, which is the same for all tracks,

    [x(k+1); ...; x(k+L)] = T [x(k); z(k+1); ...; z(k+L)].

`make_shared_steps` computes the steps of a filter until it has converged.
"""

from typing import NamedTuple

import numpy as np

# Tracks per tile where all tracks share one T: a block of steps of one tile stays in the processor's cache.
TILE = 16_384
# Tracks per tile where each track has its own covariance, which takes more memory.
TILE_OF_COVARIANCES = 4_096
# Numbers per array where about ten arrays are in use at once, so that all fit into the cache. Measured on one processor
# with benchmarks/bench.py, like the sizes below.
IN_CACHE = 16_384
# (size, L): take L steps in one product where the states of a tile hold at least `size` numbers. Short products need
# many calls, long ones do not fit into the cache.
STEPS_PER_PRODUCT = ((30_000, 2), (1_500, 4), (300, 8), (50, 16), (0, 32))
# The most different steps that a filter computes and keeps for tracks without gaps. A filter that has not converged by
# then, as without process noise, is faster on columns. The papers' models converge within about 50 steps.
MOST_STEPS = 128
# A filter of n states has converged when no P_ij changes by more than this times n σ_i σ_j, the rounding of doubles.
CONVERGED = 2e-16


class Step(NamedTuple):
    """One step of a filter: its coefficients A (n, n) and B (n, m), and the covariance P (n, n) after it.

    `coefficients` returns N of them as one Step, whose arrays have a first axis of length N.
    """

    A: np.ndarray
    B: np.ndarray
    P: np.ndarray


def recursion(A, B, x0, z):
    """Return x(1) ... x(N), one step after the other.

    A (N, n, n) and B (N, n, m) are the coefficients of each step, x0 is (n,) or (n, M), z is (N, m) or (N, m, M)
    without NaN. The result is (N, n) or (N, n, M).

    >>> recursion(A=[np.eye(1), np.eye(1)], B=[np.eye(1), np.eye(1)], x0=np.zeros(1), z=[[1.0], [2.0]])
    array([[1.],
           [3.]])
    """
    x, states = x0, []
    for A_k, B_k, z_k in zip(A, B, z, strict=True):
        x = A_k @ x + B_k @ z_k
        states.append(x)
    return np.array(states)


def product_of_steps(A, B):
    """Return T (L n, n + L m), which takes [x(k); z(k+1); ...; z(k+L)] to [x(k+1); ...; x(k+L)].

    It is the recursion run on unit inputs: column j of T is the response to input j alone.

    >>> product_of_steps(A=np.full((2, 1, 1), 0.5), B=np.full((2, 1, 1), 0.5))
    array([[0.5 , 0.5 , 0.  ],
           [0.25, 0.25, 0.5 ]])
    """
    L, n, m = np.shape(B)
    inputs = np.eye(n + L * m)
    return recursion(A, B, inputs[:n], inputs[n:].reshape(L, m, -1)).reshape(L * n, -1)


def make_shared_steps(next_step, P0, m, N, tracks):
    """Return the Steps of N epochs without gaps and their products for `run_shared`, or None for too many steps.

    next_step(P, seen) is a filter's method, P0 its P(0/0), and m the number of its measurements.
    """
    steps = list(steps_without_gaps(next_step, P0, m, min(N, MOST_STEPS)))
    if N > MOST_STEPS:
        if steps[-1] is not steps[-2]:  # a filter that has converged repeats one object
            return None
        steps += steps[-1:] * (N - MOST_STEPS)
    return steps, products_for(steps, tracks)


def steps_without_gaps(next_step, P0, m, N):
    """Yield the Steps of N epochs without gaps. Once a filter has converged, all are one and the same object."""
    P, converged, seen = P0, False, np.ones(m, bool)
    for _ in range(N):
        if not converged:
            step = Step(*map(np.array, next_step(P, seen)))  # copies: those of a user's own stay writeable
            for array in step:
                array.flags.writeable = False
            converged = _has_not_moved(P, step.P)
            P = step.P
        yield step


def _has_not_moved(before, after):
    sigma = np.sqrt(np.abs(np.diag(after)))
    return bool((np.abs(after - before) <= len(sigma) * CONVERGED * np.outer(sigma, sigma)).all())


def products_for(steps, tracks):
    """Return T of each block of L Steps, for `run_shared` on this number of tracks.

    Identical blocks, as after convergence, share one T.
    """
    L = steps_per_product(len(steps[0].A) * min(tracks, TILE))
    made, products = {}, []
    for k in range(0, len(steps), L):
        block = steps[k : k + L]
        objects = tuple(map(id, block))
        if objects not in made:
            made[objects] = product_of_steps([step.A for step in block], [step.B for step in block])
        products.append(made[objects])
    return products


def run_shared(products, x0, z, x):
    """Write x(1) ... x(N) of many tracks to x (N, n, M), as `recursion` would, with several steps in one product.

    products come from `products_for`, x0 is (n, M) or (n, 1), and z is (N, m, M) and may be x itself. A NaN in z
    spreads to its whole block of steps and to all later ones.
    """
    (_, n, M), m = x.shape, z.shape[1]
    x0 = np.broadcast_to(x0, (n, M))
    L = len(products[0]) // n
    for tracks in tiles(M, TILE):
        width = tracks.stop - tracks.start
        inputs, outputs = np.empty((n + L * m, width)), np.empty((L * n, width))
        state, measured = inputs[:n], inputs[n:].reshape(L, m, width)  # views
        state[:] = x0[:, tracks]
        k = 0
        for T in products:
            after = outputs[: len(T)]
            end = k + len(T) // n
            measured[: end - k] = z[k:end, :, tracks]
            np.matmul(T, inputs[: T.shape[1]], out=after)
            x[k:end, :, tracks] = after.reshape(end - k, n, width)
            state[:] = after[-n:]
            k = end


def steps_per_product(size):
    """Return the number of steps L to take in one product when the states of all tracks hold `size` numbers.

    >>> [steps_per_product(size) for size in (2, 200, 400, 20_000, 200_000)]
    [32, 16, 8, 4, 2]
    """
    return next(L for least, L in STEPS_PER_PRODUCT if size >= least)


def epochs_at_a_time(N, numbers):
    """Return slices that cover N epochs of `numbers` numbers each, such that one slice fits into the cache.

    >>> epochs_at_a_time(5, numbers=8_000)
    [slice(0, 1, None), slice(1, 3, None), slice(3, 5, None)]
    """
    return tiles(N, max(1, IN_CACHE // numbers))


def tiles(M, width):
    """Return slices of nearly equal width that cover M tracks, none wider than `width`.

    >>> tiles(20_000, TILE)
    [slice(0, 10000, None), slice(10000, 20000, None)]
    """
    parts = -(-M // width)
    return [slice(i * M // parts, (i + 1) * M // parts) for i in range(parts)]
