"""Steady-state covariances: two Riccati equations and two solvers that share nothing but the model.

Each solver checks its result against its own equation, at unit variances, and refuses a model that has no steady state.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_are

from . import checks
from .model import LinearModel, predicted_covariance, square_root

# Relative distance at which a mode still counts as undetectable or unstabilizable: the rounding of an eigenvalue of F,
# with room for n up to some hundreds.
MODE_ROUNDING = 1e-12
# A multiple eigenvalue is computed as a ring around it, of relative size 1e-8 for a double one, 6e-6 for a triple.
RING = 1e-4
# A double eigenvalue on the unit circle is computed to the square root of the machine precision.
ON_CIRCLE = 1 - np.sqrt(np.finfo(float).eps)
# How far P may move, in standard deviations, when its equation is applied once more or solved anew: six digits hold.
RESIDUAL = 1e-6
# The same before the refinement of scipy's solution: what moves more was no solution.
UNREFINED = 1e-3
# Doubling 64 times covers more steps than a double can count.
DOUBLINGS = 64


class LainiotisMatrices(NamedTuple):
    """The constant matrices of the Lainiotis filter (2014 Eq. 7, 2015 Eq. 3)."""

    Fn: np.ndarray
    Kn: np.ndarray
    Km: np.ndarray
    Pn: np.ndarray
    On: np.ndarray


def lainiotis_matrices(model, H=None, R=None):
    """Return F_n (n×n), K_n, K_m (n×m), P_n, O_n (n×n) of the Lainiotis filter (2014 Eq. 7, 2015 Eq. 3).

        A = [H Q Hᵀ + R]⁻¹,   K_n = Q Hᵀ A,   K_m = Fᵀ Hᵀ A,   F_n = F - K_n H F,   P_n = Q - K_n H Q,   O_n = K_m H F

    H and R are those of the model unless others are given. P_n is computed as the square of a root, in Joseph's form,
    which keeps its digits where R is far smaller than Q.

    >>> from mpt_helpers.model import gsm_axis
    >>> lainiotis_matrices(gsm_axis(dt=1.0, q=0.01, r=0.1)).Fn.round(4)
    array([[ 0.9388,  0.8776],
           [-0.1224,  0.7551]])
    """
    F, Q = model.F, model.Q
    H = model.H if H is None else H
    R = model.R if R is None else R
    HtA = innovation_weights(Q, H, R)
    Kn = Q @ HtA
    Km = F.T @ HtA
    update = np.eye(model.n) - Kn @ H
    root = np.hstack([update @ square_root(Q), Kn @ np.linalg.cholesky(R)])
    return LainiotisMatrices(Fn=update @ F, Kn=Kn, Km=Km, Pn=root @ root.T, On=Km @ H @ F)


def innovation_weights(P, H, R):
    """Return Hᵀ [H P Hᵀ + R]⁻¹ (n×m): P times it is the Kalman gain.

    Where two sensors of very unequal precision see the same state, the sum in brackets rounds the better one away. So
    the measurements are first joined into at most n with unit noise: with R = L Lᵀ and L⁻¹ H = E H₁, where E has
    orthonormal columns, the result is H₁ᵀ [H₁ P H₁ᵀ + I]⁻¹ Eᵀ L⁻¹.

    >>> innovation_weights(P=np.eye(1), H=np.array([[1.0]]), R=np.array([[3.0]])).round(12)
    array([[0.25]])
    """
    L = np.linalg.cholesky(R)
    E, H_1 = np.linalg.qr(np.linalg.solve(L, H))
    S = H_1 @ P @ H_1.T + np.eye(len(H_1))
    return H_1.T @ np.linalg.solve(S, np.linalg.solve(L.T, E).T)


def rekf(model):
    """Return P_p (n×n), the steady-state prediction error covariance (2014 Eq. 11, 2015 Eq. 9).

        P_p = Q + F P_p Fᵀ - F P_p Hᵀ [H P_p Hᵀ + R]⁻¹ H P_p Fᵀ

    Solved by scipy, then refined by two steps of Newton's method. Raises ValueError when there is no steady state,
    naming the condition that fails and the mode of F.

    >>> from mpt_helpers.model import gsm_axis
    >>> rekf(gsm_axis(dt=1.0, q=0.01, r=0.1)).round(4)
    array([[0.0597, 0.0257],
           [0.0257, 0.0227]])
    """
    _require_steady_state(model)
    # scipy is silently wrong where R is very small or very large, and fails where the variances of the states differ
    # much: it gets states and measurements of unit variance. Near the unit circle it loses more digits than need be.
    unit = _units(model)
    F = model.F * unit / unit[:, None]
    Q = model.Q / unit[:, None] / unit
    H = np.linalg.solve(np.linalg.cholesky(model.R), model.H * unit)
    try:
        P = solve_discrete_are(F.T, H.T, Q, np.eye(model.m))
        for largest in (UNREFINED, RESIDUAL):
            step = _newton_step(P, F, H, Q)
            P = P + (step + step.T) / 2
            sigma = np.sqrt(np.maximum(np.diag(P), 1))  # at least the noise of n steps, which is 1 in these units
            if not (np.abs(step) <= largest * np.outer(sigma, sigma)).all():
                _refuse_unsolved(model)
    except np.linalg.LinAlgError:
        _refuse_unsolved(model)
    return (P + P.T) / 2 * unit[:, None] * unit


def _newton_step(P, F, H, Q):
    """Return what Newton's method adds to P, a solution of the REKF with R = I: Σ Aⁱ D Aᵀⁱ where P misses it by D."""
    identity = np.eye(len(H))
    K = P @ innovation_weights(P, H, identity)
    update = np.eye(len(P)) - K @ H
    A = F @ update
    step = F @ (update @ P @ update.T + K @ K.T) @ F.T + Q - P
    with np.errstate(over="ignore", invalid="ignore"):  # where A is not stable, the sum has no end
        for _ in range(DOUBLINGS):
            A, step = A @ A, step + A @ step @ A.T
    return step


def relf(model):
    """Return P_e (n×n), the steady-state estimation error covariance (2014 Eq. 14, 2015 Eq. 12), by doubling.

        P_e = P_n + F_n [I + P_e O_n]⁻¹ P_e F_nᵀ

    Round i composes 2^i steps of the Lainiotis recursion from P = 0 into one of the same form, so that it converges
    quadratically (D. G. Lainiotis, N. D. Assimakis and S. K. Katsikas, J. Math. Anal. Appl. 186, 1994). The REKF is not
    used. Raises ValueError when there is no steady state, naming the condition that fails and the mode of F.

    >>> from mpt_helpers.model import gsm_axis
    >>> relf(gsm_axis(dt=1.0, q=0.01, r=0.1)).round(4)
    array([[0.0285, 0.008 ],
           [0.008 , 0.0127]])
    """
    _require_steady_state(model)
    Fn, _, _, Pn, On = lainiotis_matrices(model)
    for _ in range(DOUBLINGS):
        A = lainiotis_transition(Pn, Fn, On)
        P = Pn + A @ Pn @ Fn.T
        P = (P + P.T) / 2
        if np.array_equal(P, Pn):  # no entry moves any more: an entry of a small variance may settle last
            break
        On = On + Fn.T @ On @ np.linalg.solve(np.eye(model.n) + Pn @ On, Fn)
        Pn, Fn = P, A @ Fn
    _require_solution_of_relf(model, P)
    return P


def lainiotis_transition(P, Fn, On):
    """Return A = F_n [I + P O_n]⁻¹ (n×n) of the Lainiotis filter (2014 Eqs. 5 and 13); P may be a stack (M, n, n).

    >>> lainiotis_transition(P=np.eye(1), Fn=np.eye(1), On=np.eye(1))
    array([[0.5]])
    """
    bracket = np.eye(len(Fn)) + P @ On
    return np.linalg.solve(bracket.swapaxes(-1, -2), Fn.T).swapaxes(-1, -2)


def _require_solution_of_relf(model, P):
    Fn, _, _, Pn, On = lainiotis_matrices(model)
    A = lainiotis_transition(P, Fn, On)
    closed_loop = np.abs(np.linalg.eigvals(A)).max()
    sigma = np.sqrt(np.diag(P))
    rounding = 100 * np.finfo(float).eps * (np.abs(Pn) + np.abs(A) @ np.abs(P) @ np.abs(Fn.T))  # of some 100 terms
    residual = np.abs(Pn + A @ P @ Fn.T - P)
    if not (closed_loop < 1 and (residual <= RESIDUAL * np.outer(sigma, sigma) + rounding).all()):
        _refuse_unsolved(model)


def _units(model):
    """Return how far the noise of n steps moves each state, to a power of two: in these units entries compare."""
    variance = np.diag(predicted_covariance(model, model.Q, model.n - 1))
    moved = variance > 0
    exponent = np.log2(variance, out=np.zeros(model.n), where=moved) / 2
    usual = exponent[moved].mean() if moved.any() else 0.0
    return np.exp2(np.round(np.where(moved, exponent, usual)))


def _modes(model):
    """Yield (margin, condition, mode) for each mode of F on or outside the unit circle, by the PBH rank test."""
    unit = _units(model)
    F = model.F * unit / unit[:, None]
    H = _at_the_size_of(F, model.H * unit)
    G = _at_the_size_of(F, square_root(model.Q) / unit[:, None])
    modes = np.linalg.eigvals(F)
    # The mean of a ring of computed eigenvalues is as good as a simple one.
    means = [modes[np.abs(modes - mode) <= RING * abs(mode)].mean() for mode in modes]
    for mode in [*means, *modes]:
        if abs(mode) >= ON_CIRCLE:
            shifted = mode * np.eye(model.n) - F
            yield _margin(np.vstack([shifted, H])), "[F, H] is not detectable", mode
            yield _margin(np.hstack([shifted, G])), "[F, G] with G Gᵀ = Q is not stabilizable", mode


def _margin(pencil):
    """Return how far a matrix is from losing rank, relative to its size."""
    singular = np.linalg.svd(pencil, compute_uv=False)
    return singular[-1] / singular[0] if singular[0] else 0.0


def _at_the_size_of(F, matrix):
    """Return the matrix scaled to the largest entry of F: whether a mode is seen or driven depends on no unit."""
    size = np.abs(matrix).max()
    return matrix * (np.abs(F).max() / size) if size else matrix


def _require_steady_state(model):
    checks.instance("model", model, LinearModel)
    for margin, condition, mode in _modes(model):
        if margin < MODE_ROUNDING:
            raise ValueError(f"model: needs a steady state, but {condition} at the mode {_text(mode)} of F")


def _refuse_unsolved(model):
    margin, condition, mode = min(_modes(model), default=(1, "no condition fails", 0), key=lambda found: found[0])
    nearest = f"nearest to failing, by {margin:.0e}: {condition} at the mode {_text(mode)} of F"
    raise ValueError(f"model: needs a steady state that double precision can resolve; {nearest}")


def _text(mode):
    return f"{mode.real:.6g}" if np.isreal(mode) else f"{mode:.6g}"
