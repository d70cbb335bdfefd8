"""The states of all epochs given all measurements: the filter's recursion, run backwards (Rauch, Tung, Striebel 1965).

    x(k/N) = C_k x(k+1/N) + (I - C_k F) x(k/k),   C_k = P(k/k) Fᵀ P(k+1/k)⁻¹
    P(k/N) = C_k [P(k+1/N) + Q] C_kᵀ + (I - C_k F) P(k/k) (I - C_k F)ᵀ

A step back is x <- C x + d, P <- C P Cᵀ + D, with d = (I - C F) x(k/k) and D = C Q Cᵀ + (I - C F) P(k/k) (I - C F)ᵀ.
C, d and D depend on the filter's results alone, and are computed first, many epochs in one call. Then the steps back
are a filter on columns (`columns`): one `advance` for each epoch, the last one first, and a long track in pieces.
"""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.linalg import eig

from .. import _checks as checks
from .algebra import product, solved, transposed
from .columns import as_columns
from .pieces import through
from .shared import epochs_at_a_time

# A mode is damped if its eigenvalue is smaller than DAMPED, and undriven if the variance that Q adds to it in a step is
# smaller than UNDRIVEN times the one after the first measurement.
DAMPED = 1 - 1e-6
UNDRIVEN = 1e-12


class StepBack(NamedTuple):
    """One step back of all columns: d as z (n, c, M), C and D (n, n, M)."""

    z: np.ndarray
    C: np.ndarray
    D: np.ndarray

    def advance(self, x, P):
        """Return x and P one epoch earlier, and no innovations: a step back takes no measurement."""
        return product(self.C, x) + self.z, product(product(self.C, P), transposed(self.C)) + self.D, x[:0]


@dataclass(frozen=True)
class RowsBack:
    """The steps back, to be iterated, the last epoch first: d as z (N, n, c, M), C and D (N, n, n, M)."""

    z: np.ndarray
    C: np.ndarray
    D: np.ndarray

    def __iter__(self):
        """Yield one StepBack after the other."""
        return map(StepBack, self.z, self.C, self.D)


def smoothed(prediction, epochs, x, P):
    """Return x(k/N) (N, n, M) and P(k/N) (N, n, n, M or 1) from x(k/k) and P(k/k) of the same shapes.

    prediction is the filter's, epochs are its Epochs. P has one covariance for all tracks (1) or one for each.
    """
    modes = _undriven(prediction.F, prediction.Q, P[0])
    if modes:
        text = f"smooth: F has damped modes without process noise, {', '.join(modes)}, and is ill-conditioned backwards"
        checks.warn(f"{text}: covariances may be wrong. Process noise of a millionth of the variances mends it")
    (N, n, M), width = x.shape, P.shape[3]
    x, P = x.copy(), P.copy()
    if N == 1:
        return x, P
    C, d, D = np.empty((N - 1, n, n, width)), np.empty((N - 1, n, M)), np.empty((N - 1, n, n, width))
    for part in epochs_at_a_time(N - 1, n * n * width):
        steps = epochs.steps(slice(part.start + 1, part.stop + 1))
        C[part], d[part], D[part] = _coefficients(prediction, steps, x[part], P[part])
    in_columns = partial(as_columns, together=epochs.alike)
    back = RowsBack(in_columns(d[::-1]), C[::-1], D[::-1])
    # From x(N/N) and P(N/N). The results are written to x and P, through views that begin with the epoch N - 1.
    through(StepBack.advance, back, in_columns(x[-1]), P[-1], in_columns(x[-2::-1]), P[-2::-1])
    return x, P


def _undriven(F, Q, P):
    """Return the damped modes of F that Q does not drive, as texts.

    A mode is y = lᴴ x, with a left eigenvector l of F. Q adds lᴴ Q l to its variance in a step, which is compared with
    the variance lᴴ P l of the first epoch, P (n, n, M or 1).
    """
    modes, left = eig(F, left=True, right=False)
    added = np.einsum("im,ij,jm->m", left.conj(), Q, left).real
    known = np.einsum("im,ijt,jm->mt", left.conj(), P, left).real.max(axis=1)
    return [f"{abs(mode):.3g}" for mode in modes[(np.abs(modes) < DAMPED) & (added < UNDRIVEN * known)]]


def _coefficients(prediction, steps, x, P):
    """Return C (N, n, n, M or 1), d = (I - C F) x (N, n, M) and D = C Q Cᵀ + (I - C F) P (I - C F)ᵀ of N epochs.

    x (N, n, M) and P (N, n, n, M or 1) are the filter's at these epochs. steps are the Steps that follow them, None
    where all are the model's.
    """
    x, P = np.moveaxis(x, 1, 0), np.moveaxis(P, 0, 2)  # now states, epochs, tracks
    FP = prediction.state(P, steps)
    C = transposed(solved(prediction.covariance(P, steps), FP))
    d = x - product(C, prediction.state(x, steps))
    kept = P - product(C, FP)  # (I - C F) P
    Q = prediction.Q[..., None, None] if steps is None else steps.Q
    # D = kept - (kept Fᵀ - C Q) Cᵀ: the bracket is zero but for the rounding of `kept`, which it takes back.
    left = transposed(prediction.state(transposed(kept), steps)) - product(C, Q)
    D = kept - product(left, transposed(C))
    return np.moveaxis(C, 2, 0), np.moveaxis(d, 1, 0), np.moveaxis((D + transposed(D)) / 2, 2, 0)
