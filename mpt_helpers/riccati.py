"""Steady-state covariances, from the Riccati equations of the Kalman filter (REKF) and of the Lainiotis filter (RELF).

`rekf` refines scipy's solution; `relf` uses the doubling algorithm. The two are independent, so their agreement is a
real check. Each checks its solution against its own equation. Models without a steady state are detected by the rank
test of Popov, Belevitch and Hautus (PBH).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_discrete_are

from . import _checks as checks
from ._checks import Array
from .equations import (
    corrected_covariance,
    gain,
    lainiotis_matrices,
    lainiotis_transition,
    predicted_covariance,
    square_root,
    unit_measurements,
)
from .model import LinearModel

__all__ = ["rekf", "relf"]

# A mode counts as undetectable or unstabilizable within this relative distance of a loss of rank: the rounding error
# of an eigenvalue of F.
MODE_ROUNDING = 1e-12
# Rounding splits a double eigenvalue by 1e-8 of it, a triple one by 6e-6. Computed eigenvalues closer than this may be
# one multiple eigenvalue. Then their mean, which is as accurate as a simple eigenvalue, is tested too.
SAME_EIGENVALUE = 1e-4
# Rounding moves a double eigenvalue on the unit circle by up to the square root of the machine precision.
ON_CIRCLE = 1 - np.sqrt(np.finfo(float).eps)
# Largest residual of a solution P in its equation, relative to the standard deviations: P has six correct digits.
RESIDUAL = 1e-6
# Largest rounding error of a variance, relative to it: beyond, not even one digit is correct.
MAX_ROUNDING_SHARE = 0.1
# Number of times that the number of steps is doubled: any filter converges in 2^64 steps.
DOUBLINGS = 64


def rekf(model: LinearModel) -> Array:
    """Return the steady-state prediction error covariance P_p (2014 Eq. 11, 2015 Eq. 9).

        P_p = Q + F P_p Fᵀ - F P_p Hᵀ [H P_p Hᵀ + R]⁻¹ H P_p Fᵀ

    Parameters
    ----------
    model : LinearModel
        The model with F, H, Q and R.

    Returns
    -------
    ndarray (n, n)
        P_p, the covariance of x(k+1/k).

    Raises
    ------
    ValueError
        For a model without a steady state; the message names the condition that fails and the mode of F.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> mpt.riccati.rekf(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1)).round(4)
    array([[0.1215, 0.0471],
           [0.0471, 0.0308]])

    """
    return _steady_state(model, _solve_rekf)


def relf(model: LinearModel) -> Array:
    """Return the steady-state estimation error covariance P_e (2014 Eq. 14, 2015 Eq. 12), by doubling.

        P_e = P_n + F_n [I + P_e O_n]⁻¹ P_e F_nᵀ

    Round i composes 2^i Lainiotis steps (Lainiotis, Assimakis and Katsikas, J. Math. Anal. Appl. 186, 1994).

    Parameters
    ----------
    model : LinearModel
        The model with F, H, Q and R.

    Returns
    -------
    ndarray (n, n)
        P_e, the covariance of x(k/k).

    Raises
    ------
    ValueError
        As `rekf`.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> mpt.riccati.relf(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1)).round(4)
    array([[0.0549, 0.0212],
           [0.0212, 0.0208]])

    """
    return _steady_state(model, _solve_relf)


def _steady_state(model, solve):
    """Return the solution that solve(model) finds, or raise a ValueError that says why there is none."""
    checks.instance("model", model, LinearModel)
    nearest = "F is stable, so there is one in exact numbers"
    with np.errstate(all="ignore"):  # where double precision does not resolve the steady state
        try:
            margins = list(_margins(model))
        except np.linalg.LinAlgError:
            checks.refuse("model", "matrices whose products do not overflow", "an overflow")
        if margins:
            margin, condition = min(margins, key=lambda each: each[0])
            if margin < MODE_ROUNDING:
                raise ValueError(f"model: needs a steady state, but {condition}")
            nearest = f"nearest to failing, by {margin:.0e}: {condition}"
        try:
            P, solved = solve(model)
        except ValueError:  # scipy's, and numpy's LinAlgError
            solved = False
    if not solved:
        raise ValueError(f"model: needs a steady state that double precision can resolve; {nearest}")
    return P


def _solve_rekf(model):
    # scipy needs states and measurements of unit variance: its result is silently wrong for very small or large R. It
    # loses digits where the filter converges slowly, so its solution is refined.
    unit = _units(model)
    F = model.F * unit / unit[:, None]
    Q = model.Q / unit[:, None] / unit
    H, _ = unit_measurements(model.H * unit, model.R)
    P = solve_discrete_are(F.T, H.T, Q, np.eye(len(H)))
    P = P + _newton_step(P, F, H, Q)
    change = _newton_step(P, F, H, Q)
    P = P + change
    sigma = np.sqrt(np.maximum(np.diag(P), 1))  # no less than 1, the noise of n steps in these units
    solved = (np.abs(change) <= RESIDUAL * np.outer(sigma, sigma)).all()
    # A state without process noise is known exactly in the end; the rounding of its standard deviation is eps in these
    # units.
    known = np.diag(P) <= np.finfo(float).eps ** 2
    P = np.where(known[:, None] | known, 0.0, (P + P.T) / 2)
    return P * unit[:, None] * unit, solved


def require_resolved(model: LinearModel, P: Array) -> None:
    """Raise a ValueError if rounding leaves no digit of P (n×n), a steady-state estimation error covariance.

    A step of the Kalman filter must leave P nearly unchanged, and the rounding error of that step must be small
    compared with P. In (I - K H) P_p (I - K H)ᵀ there are two rounding errors, with sigma² the variances of P_p and eps
    the machine precision:

        P_p      by at most eps sigma_i sigma_j, which adds         eps (|I - K H| sigma)²
        I - K H  by at most D = eps (I + |K| |H|), which adds       (D sigma)²

    The term that is linear in D is D P for the optimal gain, which is small compared with P.
    """
    P_p = predicted_covariance(model, P)
    K = gain(P_p, model.H, model.R)
    sigma, variance = np.sqrt(np.maximum(np.diag(P_p), 0)), np.diag(P)
    eps = model.n * np.finfo(float).eps
    identity = np.eye(model.n)
    D = eps * (identity + np.abs(K) @ np.abs(model.H))
    rounding = eps * (np.abs(identity - K @ model.H) @ sigma) ** 2 + (D @ sigma) ** 2
    change = np.abs(corrected_covariance(P_p, K, model.H, model.R) - P)
    allowed = MAX_ROUNDING_SHARE * np.sqrt(np.outer(variance, variance)) + eps * np.outer(sigma, sigma)
    if (change > allowed).any() or (rounding > MAX_ROUNDING_SHARE * variance).any():
        raise ValueError("model: needs a steady state that double precision can resolve; a variance has no digit right")


def _newton_step(P, F, H, Q):
    """Return the Newton correction of P, an approximate solution of the REKF with R = I: the sum of Aⁱ D Aᵀⁱ over i.

    D is the residual of P. After j rounds `total` has 2^j terms, and `A` is the power 2^j.
    """
    identity = np.eye(len(H))
    K = gain(P, H, identity)
    A = F - F @ K @ H
    total = F @ corrected_covariance(P, K, H, identity) @ F.T + Q - P
    for _ in range(DOUBLINGS):
        A, total = A @ A, total + A @ total @ A.T
    return (total + total.T) / 2


def _solve_relf(model):
    Fn, _, _, Pn, On, _, _ = lainiotis_matrices(model)
    F_i, P, O_i = Fn, Pn, On  # of 2^i steps
    for _ in range(DOUBLINGS):
        A = lainiotis_transition(P, F_i, O_i)
        longer = P + A @ P @ F_i.T
        longer = (longer + longer.T) / 2
        if np.array_equal(longer, P):  # all entries have settled, those of small variances last
            break
        O_i = O_i + F_i.T @ O_i @ np.linalg.solve(np.eye(model.n) + P @ O_i, F_i)
        P, F_i = longer, A @ F_i
    A = lainiotis_transition(P, Fn, On)
    sigma = np.sqrt(np.diag(P))
    terms = np.abs(Pn) + np.abs(A) @ np.abs(P) @ np.abs(Fn.T)
    rounding = 100 * np.finfo(float).eps * terms  # roughly that of all rounds; the only tolerance of a zero variance
    missed = np.abs(Pn + A @ P @ Fn.T - P)
    solved = (missed <= RESIDUAL * np.outer(sigma, sigma) + rounding).all()
    forgets_the_start = np.abs(np.linalg.eigvals(A)).max() < 1
    return P, solved and forgets_the_start


def _units(model):
    """Return the standard deviation of each state after n steps of noise, as a power of two: scaling by it is exact."""
    variance = np.diag(predicted_covariance(model, model.Q, model.n - 1))
    moved = variance > 0
    exponent = np.log2(variance, out=np.zeros(model.n), where=moved) / 2
    usual = exponent[moved].mean() if moved.any() else 0.0
    return np.exp2(np.round(np.where(moved, exponent, usual)))


def _margins(model):
    """Yield the margin and the words of both conditions of the PBH rank test, for each mode that is not stable."""
    unit = _units(model)
    F = model.F * unit / unit[:, None]
    H = np.array([_scaled_to(F, row) for row in model.H * unit])  # the unit of a measurement changes nothing
    G = _scaled_to(F, square_root(model.Q) / unit[:, None])
    modes = np.linalg.eigvals(F)
    means = [modes[np.abs(modes - mode) <= SAME_EIGENVALUE * abs(mode)].mean() for mode in modes]
    for mode in [*means, *modes]:  # close eigenvalues may be one or several: both cases are tested
        if abs(mode) >= ON_CIRCLE:
            at = f"at the mode {mode.real if np.isreal(mode) else mode:.6g} of F"
            shifted = mode * np.eye(model.n) - F
            yield _distance_from_rank_loss(np.vstack([shifted, H])), f"[F, H] is not detectable {at}"
            yield _distance_from_rank_loss(np.hstack([shifted, G])), f"[F, G] with G Gᵀ = Q is not stabilizable {at}"


def _distance_from_rank_loss(pencil):
    """Return the distance of a matrix from losing rank, relative to its size."""
    singular = np.linalg.svd(pencil, compute_uv=False)
    return singular[-1] / singular[0] if singular[0] else 0.0


def _scaled_to(F, matrix):
    """Return the matrix scaled to the largest entry of F, so that the rank test does not depend on units."""
    size = np.abs(matrix).max()
    return matrix * (np.abs(F).max() / size) if size else matrix
