"""Two decompositions of many small matrices at once.

The last axes count the matrices: S (n, n, M) are M matrices (n, n). One numpy call works on all of them, which is much
faster than one call per matrix.
"""

import numpy as np


def solved(S, X):
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


def whitened(values, C):
    """Return values (d, ...) at unit covariance, and log det C (...), from their covariances C (d, d, ...).

    A NaN is a missing value: it becomes zero and does not contribute to the determinant. Each component in turn is
    decorrelated from the preceding ones. Where C is not positive definite the results are not finite.

    >>> whitened(np.array([3.0, np.nan]), np.array([[4.0, 1.0], [1.0, 1.0]]))
    (array([1.5, 0. ]), array(1.38629436))
    """
    values, C = values.copy(), np.broadcast_to(C, (*C.shape[:2], *values.shape[1:])).copy()
    log_det = np.zeros(values.shape[1:])
    for j in range(len(values)):
        seen = ~np.isnan(values[j])
        pivot = np.where(seen, np.where(C[j, j] > 0, C[j, j], np.nan), 1.0)
        value = np.where(seen, values[j], 0.0)
        share = C[j + 1 :, j] * (seen / pivot)
        values[j + 1 :] -= share * value
        C[j + 1 :, j + 1 :] -= share[:, None] * C[j, j + 1 :]
        values[j] = value / np.sqrt(pivot)
        log_det += np.log(pivot)
    return values, log_det
