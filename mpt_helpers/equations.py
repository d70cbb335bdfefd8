"""The papers' equations on matrices: predicted covariance, gain, Joseph's form, and the constants of Lainiotis.

Each function is one equation. `model` is a LinearModel, or anything with its F, H, Q and R. Where a docstring says so,
P may be a stack of covariances, (..., n, n).
"""

from typing import NamedTuple

import numpy as np


def predicted_covariance(model, P, steps=1):
    """Return the covariance P, (n, n) or (..., n, n), after steps in which nothing is measured: P <- F P Fᵀ + Q.

    >>> from mpt_helpers.model import constant_velocity
    >>> predicted_covariance(constant_velocity(dt=1.0, q=3.0, r=1.0), np.zeros((2, 2)))
    array([[1. , 1.5],
           [1.5, 3. ]])
    """
    F, Q = several_steps(model.F, model.Q, steps)
    return F @ P @ F.T + Q


def several_steps(F, Q, steps):
    """Return F and Q of `steps` steps in a row, by doubling.

    >>> several_steps(np.eye(1), np.eye(1), steps=5)
    (array([[1.]]), array([[5.]]))
    """
    F_N, Q_N = np.eye(len(F)), np.zeros_like(Q)
    while steps:
        if steps % 2:
            F_N, Q_N = F @ F_N, F @ Q_N @ F.T + Q
        F, Q = F @ F, F @ Q @ F.T + Q
        steps //= 2
    return F_N, Q_N


def unit_measurements(H, R):
    """Return H_1 (p×n) and U (p×m) such that U z = H_1 x + unit noise carries the information of z = H x + v.

    The noise v has covariance R (m×m), and p = min(m, n): redundant measurements are combined first. Otherwise the
    variance of a precise sensor would be added to a much larger H P Hᵀ, and lost to rounding.

    >>> H_1, U = unit_measurements(H=np.array([[1.0], [1.0]]), R=np.diag([4.0, 1.0]))
    >>> (H_1 ** 2).round(12), (U / H_1).round(12)
    (array([[1.25]]), array([[0.2, 0.8]]))
    """
    sigma = np.sqrt(np.diag(R))
    variance, V = np.linalg.eigh(R / sigma[:, None] / sigma)  # a Cholesky factor loses digits of close correlations
    whiten = V.T / sigma / np.sqrt(variance)[:, None]
    E, H_1 = np.linalg.qr(whiten @ H)
    return H_1, E.T @ whiten


def gain(P, H, R):
    """Return the Kalman gain K = P Hᵀ [H P Hᵀ + R]⁻¹ (n×m) for the predicted covariance P (2014 Eq. 4).

    Computed from `unit_measurements`, it stays accurate when sensors of very different precision measure one state.

    >>> gain(P=np.eye(1), H=np.array([[1.0]]), R=np.array([[3.0]])).round(12)
    array([[0.25]])
    """
    H_1, U = unit_measurements(H, R)
    return P @ _weights(P, H_1) @ U


def _weights(P, H_1):
    """Return H_1ᵀ [H_1 P H_1ᵀ + I]⁻¹ (n×p)."""
    return np.linalg.solve(H_1 @ P @ H_1.T + np.eye(len(H_1)), H_1).T


def corrected_covariance(P, K, H, R):
    """Return (I - K H) P (I - K H)ᵀ + K R Kᵀ (n×n), Joseph's form, for the predicted covariance P.

    It holds for any gain K, and stays accurate where R is far smaller than P. All arguments may be stacks.

    >>> corrected_covariance(P=np.eye(1), K=np.array([[0.5]]), H=np.eye(1), R=np.eye(1))
    array([[0.5]])
    """
    keep = np.eye(P.shape[-1]) - K @ H
    P = keep @ P @ _transposed(keep) + K @ R @ _transposed(K)
    return (P + _transposed(P)) / 2


class LainiotisMatrices(NamedTuple):
    """The constant matrices of the Lainiotis filter (2014 Eq. 7, 2015 Eq. 3).

    C (n×p) and U (p×m) are factors of two of them: O_n = C Cᵀ and K_m = C U. U z = Cᵀ x + unit noise carries all that z
    says of the state x before the step.
    """

    Fn: np.ndarray
    Kn: np.ndarray
    Km: np.ndarray
    Pn: np.ndarray
    On: np.ndarray
    C: np.ndarray
    U: np.ndarray


def lainiotis_matrices(model, H=None, R=None):
    """Return F_n (n×n), K_n, K_m (n×m), P_n, O_n (n×n) of the Lainiotis filter (2014 Eq. 7, 2015 Eq. 3).

        K_n = Q Hᵀ S⁻¹,   K_m = Fᵀ Hᵀ S⁻¹,   F_n = F - K_n H F,   P_n = Q - K_n H Q,   O_n = K_m H F

    with S = H Q Hᵀ + R; the papers write A for S⁻¹. H and R are those of the model unless others are given.

    >>> from mpt_helpers.model import gsm_axis
    >>> lainiotis_matrices(gsm_axis(dt=1.0, q=0.01, r=0.1)).Fn.round(4)
    array([[ 0.9388,  0.8776],
           [-0.1224,  0.7551]])
    """
    F, Q = model.F, model.Q
    H_1, U = unit_measurements(model.H if H is None else H, model.R if R is None else R)
    K = Q @ _weights(Q, H_1)  # K_n is K U
    keep = np.eye(len(F)) - K @ H_1
    G = np.hstack([keep @ square_root(Q), K])  # P_n = G Gᵀ keeps more digits than the difference Q - K_n H Q
    root_of_S = np.linalg.cholesky(H_1 @ Q @ H_1.T + np.eye(len(H_1)))
    C = np.linalg.solve(root_of_S, H_1 @ F).T
    U_of_C = np.linalg.solve(root_of_S, U)
    return LainiotisMatrices(Fn=keep @ F, Kn=K @ U, Km=C @ U_of_C, Pn=G @ G.T, On=C @ C.T, C=C, U=U_of_C)


def start_gain(P, C):
    """Return G (n×p) with [I + P O]⁻¹ = I - G Cᵀ for O = C Cᵀ; P (n×n) and C (n×p) may be stacks.

    O is the information that the measurements of one epoch, or of several, contain about the state at their start. G is
    the Kalman gain for equivalent measurements Cᵀ x of that state with unit noise. It gives [I + P O]⁻¹ P in Joseph's
    form, which stays accurate where P is large; the explicit inverse loses digits after long gaps and with a diffuse P.

    >>> start_gain(P=np.eye(1), C=np.array([[2.0]]))
    array([[0.4]])
    """
    PC = P @ C
    return _transposed(np.linalg.solve(_transposed(C) @ PC + np.eye(C.shape[-1]), _transposed(PC)))


def lainiotis_step(P, constants):
    """Return A, B and P(k+1/k+1) of the Lainiotis filter from P(k/k) (2014 Eqs. 5-6, 2015 Eq. 2); P may be a stack.

        A = F_n [I + P O_n]⁻¹,   B = K_n + A P K_m,   P <- P_n + F_n [I + P O_n]⁻¹ P F_nᵀ

    >>> from mpt_helpers.model import gsm_axis
    >>> A, B, P = lainiotis_step(np.zeros((2, 2)), lainiotis_matrices(gsm_axis(dt=1.0, q=0.01, r=0.1)))
    >>> B.round(4)
    array([[0.0612],
           [0.1224]])
    """
    Fn, Kn, _, Pn, _, C, U = constants
    G = start_gain(P, C)
    A = Fn @ (np.eye(len(Fn)) - G @ C.T)
    B = Kn + Fn @ G @ U  # A P K_m = F_n [I + P C Cᵀ]⁻¹ P C U = F_n G U
    P = Pn + Fn @ corrected_covariance(P, G, C.T, np.eye(C.shape[1])) @ Fn.T
    return A, B, (P + _transposed(P)) / 2


def lainiotis_transition(P, Fn, On):
    """Return A = F_n [I + P O_n]⁻¹ (n×n) of the Lainiotis filter (2014 Eqs. 5 and 13).

    >>> lainiotis_transition(P=np.eye(1), Fn=np.eye(1), On=np.eye(1))
    array([[0.5]])
    """
    return np.linalg.solve((np.eye(len(Fn)) + P @ On).T, Fn.T).T


def masked(H, R, seen):
    """Return H and R with missing measurements, not in seen (m,), masked: rows of zeros in H, of the identity in R."""
    H = H * seen[:, None]
    R = np.where(np.outer(seen, seen), R, np.diag(~seen))
    return H, R


def square_root(C):
    """Return a matrix G with G Gᵀ = C for a positive semidefinite matrix C (n×n), or a stack of them.

    It is diag(σ) times the symmetric root of the correlation matrix: unique, so that tracks drawn with it do not depend
    on the signs that an eigenvalue routine picks, and accurate for variances of very different size.

    >>> square_root(np.diag([4.0, 0.0]))
    array([[2., 0.],
           [0., 0.]])
    """
    sigma = np.sqrt(np.maximum(np.einsum("...ii->...i", C), 0))[..., None]
    unit = np.where(sigma > 0, sigma, 1)
    w, V = np.linalg.eigh(C / unit / _transposed(unit))
    least = w.shape[-1] * np.finfo(float).eps * w[..., -1:]
    w = np.where(w > least, w, 0)[..., None, :]  # a smaller eigenvalue is the rounding of a zero
    return sigma * (V * np.sqrt(w)) @ _transposed(V)


def _transposed(stack):
    return stack.swapaxes(-1, -2)
