"""Linear algebra on columns: many small matrices at once.

The last axis counts the columns, and each column holds a matrix of its own: A (a, b, M) are M matrices (a, b). One call
of numpy works on all columns, which is much faster than one call for each matrix.
"""

import numpy as np


def product(A, B):
    """Return the products A B (a, ...) of matrices A (a, b, M) and vectors B (b, M), or matrices B (b, c, M)."""
    return np.einsum("ij...,j...->i...", A, B)


def transposed(A):
    """Return the transposed matrices of A (a, b, ...)."""
    return A.swapaxes(0, 1)


def solved(S, X):
    """Return S⁻¹ X (n, c, ...) for covariances S (n, n, ...), which may be singular, and X (n, c, ...).

    A direction of zero variance is known exactly and gets zeros: its pivot is nothing but rounding.
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

    A value that is NaN is unknown: it becomes zero, and adds nothing to the determinant. One component after the other
    is decorrelated from the preceding ones. Where C is not positive definite the results are not finite.

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


class LinearMap:
    """x -> T x and P -> T P Tᵀ, with one matrix T (m, n) for all columns or, where m = n, one for each (n, n, ...)."""

    def __init__(self, T):
        self.matrix = T
        if T.ndim == 2:
            # T P Tᵀ is linear in P, so that one product makes it for all columns: vec(T P Tᵀ) = (T ⊗ T) vec(P). Rows
            # for (a, b) and (b, a) are made equal, so that T P Tᵀ is symmetric to the last bit.
            m, n = T.shape
            kron = np.kron(T, T).reshape(m, m, n * n)
            self._of_vec = ((kron + kron.swapaxes(0, 1)) / 2).reshape(m * m, n * n)

    def __call__(self, x, P):
        """Return T x and T P Tᵀ."""
        return self.of_state(x), self.of_covariance(P)

    def of_state(self, x):
        """Return T x of states x (n, ...), or T P of matrices."""
        if self.matrix.ndim > 2:
            return product(self.matrix, x)
        return (self.matrix @ x.reshape(len(x), -1)).reshape(-1, *x.shape[1:])

    def of_covariance(self, P):
        """Return T P Tᵀ of symmetric P (n, n, ...)."""
        if self.matrix.ndim > 2:
            P = product(self.matrix, transposed(product(self.matrix, P)))
            return (P + transposed(P)) / 2
        m = len(self.matrix)
        return (self._of_vec @ P.reshape(len(P) ** 2, -1)).reshape(m, m, *P.shape[2:])


class Motion(LinearMap):
    """The prediction x -> F x, P -> F P Fᵀ + Q, with F and Q (n, n) of all columns or (n, n, ...) of each."""

    def __init__(self, F, Q):
        super().__init__(F)
        self.Q = Q

    def of_covariance(self, P):
        """Return F P Fᵀ + Q."""
        predicted = super().of_covariance(P)
        predicted += self.noise_of(P)
        return predicted

    def noise_of(self, P):
        """Return Q, with as many axes as P."""
        return self.Q.reshape(*self.Q.shape, *[1] * (P.ndim - self.Q.ndim))
