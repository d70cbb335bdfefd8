"""The smoother: the states of all epochs given all measurements, by a backward pass (Rauch, Tung & Striebel 1965).

    x(k/N) = C_k x(k+1/N) + (I - C_k F) x(k/k),   C_k = P(k/k) Fᵀ P(k+1/k)⁻¹
    P(k/N) = C_k [P(k+1/N) + Q] C_kᵀ + (I - C_k F) P(k/k) (I - C_k F)ᵀ

A step back is x <- C x + d, P <- C P Cᵀ + D, with d = (I - C F) x(k/k) and D = C Q Cᵀ + (I - C F) P(k/k) (I - C F)ᵀ.
C, d and D depend only on the filter's results, and are computed first, many epochs per call. The backward pass then
runs like a filter on columns (`columns`): one `advance` per epoch, from the last to the first, a long track in pieces.
"""

import numpy as np
from scipy.linalg import eig

from .. import _checks as checks
from .columns import product, transposed
from .diffuse import largest_S
from .pieces import run_rows
from .run import observability_of, require_valid, run_estimates
from .shared import epochs_at_a_time

# A mode is damped if its eigenvalue is below DAMPED, and undriven if the variance that Q adds to it per step is below
# UNDRIVEN times its variance after the first measurement.
DAMPED = 1 - 1e-6
UNDRIVEN = 1e-12
# The largest S (see `diffuse`) of a sensor that has just measured: the smoothed states near a diffuse start, or after a
# long pause, are the small rest of a large P, and rounding leaves one or two digits in it.
MOST_TO_SMOOTH = 1e15


def smoothed(estimator, epochs):
    """Return x(k/N) (N, n, M) and P(k/N) (N, n, n, M), or (N, n, n, 1) where all tracks share it."""
    N, _, M = epochs.z.shape
    x = np.empty((N, estimator.model.n, M))
    observability = observability_of(estimator, epochs)
    P = run_estimates(estimator, epochs, x, True, observability)
    if N == 1:
        return x, P
    _warn_of_undriven_modes(epochs.motion, P[0])
    _require_digits(observability, epochs.missing[:-1], P[:-1], epochs.dt is not None)
    d, C, D = np.empty_like(x[:-1]), np.empty_like(P[:-1]), np.empty_like(P[:-1])
    for part in epochs_at_a_time(N - 1, P[0].size):
        motion = epochs.motions(slice(part.start + 1, part.stop + 1))
        d[part], C[part], D[part] = _backward_coefficients(motion, x[part], P[part])

    def in_columns(states):
        return states.reshape(*states.shape[:-1], -1, P.shape[3])

    # The pass starts from x(N/N) and P(N/N), and writes to reversed views of x and P, epoch N - 1 first.
    rows = in_columns(d[::-1]), C[::-1], D[::-1]
    largest = run_rows(_backward_step, rows, in_columns(x[-1]), P[-1], in_columns(x[-2::-1]), P[-2::-1])
    require_valid(np.isfinite(largest).all())
    return x, P


def _backward_step(row, x, P):
    """Return x and P one epoch earlier, and no innovations, as a backward step uses no measurement."""
    d, C, D = row
    return product(C, x) + d, product(product(C, P), transposed(C)) + D, x[:0]


def _backward_coefficients(motion, x, P):
    """Return d = (I - C F) x (N, n, M), C and D = C Q Cᵀ + (I - C F) P (I - C F)ᵀ (N, n, n, M or 1) of N epochs.

    x (N, n, M) and P (N, n, n, M or 1) are the filter's at these epochs; motion leads from each to the next.
    """
    x, P = np.moveaxis(x, 1, 0), np.moveaxis(P, 0, 2)  # now states, epochs, tracks
    FP = motion.map_state(P)
    C = transposed(_solve_semidefinite(motion.map_covariance(P), FP))
    d = x - product(C, motion.map_state(x))
    kept = P - product(C, FP)  # (I - C F) P
    # D = kept - (kept Fᵀ - C Q) Cᵀ: the bracket is zero except for the rounding error of `kept`, which it removes.
    left = transposed(motion.map_state(transposed(kept))) - product(C, motion.noise_like(P))
    D = kept - product(left, transposed(C))
    return np.moveaxis(d, 1, 0), np.moveaxis(C, 2, 0), np.moveaxis((D + transposed(D)) / 2, 2, 0)


def _solve_semidefinite(S, X):
    """Return S⁻¹ X (n, c, ...) for covariances S (n, n, ...), which may be singular, and X (n, c, ...).

    A direction of zero variance is known exactly and gets zeros: its pivot is pure rounding.
    """
    n = len(S)
    S, X = S.copy(), X.copy()
    least = n * np.finfo(float).eps * np.einsum("jj...->j...", S)
    weights = np.zeros_like(least)
    for j in range(n):
        there = S[j, j] > least[j]
        weights[j] = there / np.where(there, S[j, j], 1.0)
        share = (S[j + 1 :, j] * weights[j])[:, None]
        S[j + 1 :, j + 1 :] -= share * S[j, j + 1 :]
        X[j + 1 :] -= share * X[j]
    for j in reversed(range(n)):
        X[j] = weights[j] * (X[j] - np.einsum("i...,ic...->c...", S[j, j + 1 :], X[j + 1 :]))
    return X


def _warn_of_undriven_modes(motion, P):
    """Warn of damped modes of F that Q does not drive.

    A mode is y = lᴴ x with a left eigenvector l of F. Q adds lᴴ Q l to its variance per step; this is compared with the
    variance lᴴ P l after the first epoch, P (n, n, M or 1).
    """
    modes, left = eig(motion.matrix, left=True, right=False)
    added = np.einsum("im,ij,jm->m", left.conj(), motion.Q, left).real
    known = np.einsum("im,ijt,jm->mt", left.conj(), P, left).real.max(axis=1)
    undriven = [f"{abs(mode):.3g}" for mode in modes[(np.abs(modes) < DAMPED) & (added < UNDRIVEN * known)]]
    if undriven:
        text = f"smooth: F has damped modes without process noise, {', '.join(undriven)}, so the backward pass is"
        text += " ill-conditioned and covariances may be wrong. Process noise of a millionth of the variances helps"
        checks.warn(text)


def _require_digits(observability, missing, P, timed):
    """Raise a ValueError where a sensor has just measured, and within n steps will see an S above MOST_TO_SMOOTH.

    A sensor that has not measured does no harm: nothing that it sees is known well beside what is diffuse.
    """
    m, n, variances = missing.shape[1], P.shape[1], P.diagonal(axis1=1, axis2=2)
    if largest_S(observability, variances.max(axis=0)).max() <= MOST_TO_SMOOTH:
        return
    p = min(m, n)  # more sensors than states are joined
    seen = ~missing[..., : P.shape[3]]
    for j in range(p):
        measured = seen[:, j] if p == m else seen.any(axis=1)
        S = np.where(measured, largest_S(observability[j::p], variances), 0)
        if S.max() > MOST_TO_SMOOTH:
            k, column = np.argwhere(S > MOST_TO_SMOOTH)[0]
            name, what, advice = "P0", "a start that leaves", "a smaller P0 says as little"
            if seen[:k, :, column].any():
                name, what = ("t", "pauses that leave") if timed else ("z", "gaps that leave")
                advice = "or smooth what is before and after by itself"
            need = f"for smooth {what} what is measured less than {MOST_TO_SMOOTH:g} times as uncertain as R does"
            checks.refuse(name, f"{need} ({advice})", f"{S.max():.2g} times")
