"""The states of all epochs given all measurements: the filter's recursion, run backwards (Rauch, Tung, Striebel 1965).

    x(k/N) = C_k x(k+1/N) + (I - C_k F) x(k/k),   C_k = P(k/k) Fᵀ P(k+1/k)⁻¹
    P(k/N) = C_k [P(k+1/N) + Q] C_kᵀ + (I - C_k F) P(k/k) (I - C_k F)ᵀ

Only x(k+1/N) and P(k+1/N) are taken one after the other; all else is computed for all epochs at once. So the way back
of a long track is cut into pieces, as the way there is.
"""

from dataclasses import dataclass

import numpy as np

from .columns import product, solved, transposed
from .partition import through


@dataclass(frozen=True)
class Backwards:
    """The coefficients of N steps back: x <- C x + d, P <- C P Cᵀ + D, for columns.

    C and D are (N, n, n, M), d is (N, n, c, M).
    """

    C: np.ndarray
    d: np.ndarray
    D: np.ndarray

    def __len__(self):
        """N."""
        return len(self.C)

    def __iter__(self):
        """Yield C, d and D of one step after the other."""
        return zip(self.C, self.d, self.D, strict=True)

    def mapped(self, function):
        """Return the steps of function(array) for each array."""
        return Backwards(function(self.C), function(self.d), function(self.D))

    def with_tracks_of_zeros(self, count):
        """Return the steps with `count` more tracks in each column, of no d."""
        N, n, _, M = self.d.shape
        return Backwards(self.C, np.concatenate([self.d, np.zeros((N, n, count, M))], axis=2), self.D)


def smoothed(motion, steps, x, P):
    """Return x(k/N) (N, n, M) and P(k/N) (N, n, n, M or 1) from x(k/k) and P(k/k) of the same shapes.

    motion is the Motion of the states, steps (N, M or 1) are the lengths of the steps before each epoch, or None. One
    covariance may be that of all tracks.
    """
    x, P = x.copy(), P.copy()
    if len(x) == 1:
        return x, P
    # The epochs 1 to N - 1 from the last to the first, each with the step after it; axes: states, epochs, tracks.
    x_k, P_k = np.moveaxis(x[-2::-1], 1, 0), np.moveaxis(P[-2::-1], 0, 2)
    steps = None if steps is None else np.broadcast_to(steps[:0:-1], (len(x) - 1, P.shape[3]))
    C, D = _gains(motion, steps, P_k)
    d = x_k - _states(C, motion.state(x_k, steps))
    C, D = np.moveaxis(C, 2, 0), np.moveaxis(D, 2, 0)
    # One covariance for all tracks is one column of many tracks; otherwise each track is a column.
    axis = 3 if P.shape[3] == 1 else 2
    d = np.expand_dims(np.moveaxis(d, 1, 0), axis)
    x_N, P_N = np.expand_dims(x[-1], axis - 1), P[-1]
    through(_advance, Backwards(C, d, D), x_N, P_N, np.expand_dims(x[-2::-1], axis), P[-2::-1])
    return x, P


def _gains(motion, steps, P):
    """Return C and D = C Q Cᵀ + (I - C F) P (I - C F)ᵀ (n, n, ...) of each epoch, from P(k/k) (n, n, ...)."""
    FP = motion.state(P, steps)
    C = transposed(solved(motion.covariance(P, steps), FP))
    Q = motion.covariance(np.zeros_like(P), steps)
    kept = P - product(C, FP)  # (I - C F) P
    D = kept - product(transposed(motion.state(transposed(kept), steps)), transposed(C))
    D = D + product(product(C, Q), transposed(C))
    return C, (D + transposed(D)) / 2


def _states(C, x):
    """Return C x (n, ...) of matrices C (n, n, ...) and vectors x (n, ...)."""
    return product(C, x[:, None])[:, 0]


def _advance(step, x, P):
    """Return x and P one epoch earlier, and no innovations: where the way back starts is known."""
    C, d, D = step
    return product(C, x) + d, product(product(C, P), transposed(C)) + D, np.zeros((0, *x.shape[1:]))
