"""Steady-state covariances: two Riccati equations, two solvers that share nothing but the model."""

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_are

from . import checks
from .model import LinearModel, predicted_covariance, square_root

# How far (relative to the matrix) a mode may be from undetectable or unstabilizable and still count as that: the
# rounding of an eigenvalue of F, with room for n up to some hundreds.
MODE_ROUNDING = 1e-12
# The size of the ring, relative to the eigenvalue: 1e-8 for a double one, 6e-6 for a triple one.
RING = 1e-4
# A double eigenvalue on the unit circle is computed to the square root of the machine precision.
ON_CIRCLE = 1 - np.sqrt(np.finfo(float).eps)
# What the first and the second step of Newton's method may change, at unit variances: more in the first, and what it
# began from was no solution; more in the second, and six digits are not sure.
NEWTON = 1e-3, 1e-6
# Doubling 64 times covers more steps than a double can count.
DOUBLINGS = 64


class LainiotisMatrices(NamedTuple):
    """The constant matrices of the Lainiotis filter (2014 Eq. 7, 2015 Eq. 3)."""

    Fn: np.ndarray
    Kn: np.ndarray
    Km: np.ndarray
    Pn: np.ndarray
    On: np.ndarray


def lainiotis_matrices(model):
    """Return F_n (n×n), K_n, K_m (n×m), P_n, O_n (n×n) of the Lainiotis filter (2014 Eq. 7, 2015 Eq. 3).

    P_n is Q - K_n H Q in the form of Joseph, which keeps its digits where R is much smaller than Q. Raises TypeError
    for anything but a model.

    >>> from mpt_helpers.model import gsm_axis
    >>> lainiotis_matrices(gsm_axis(dt=1.0, q=0.01, r=0.1)).Fn.round(4)
    array([[ 0.9388,  0.8776],
           [-0.1224,  0.7551]])
    """
    checks.instance("model", model, LinearModel)
    F, H, Q, R = model.F, model.H, model.Q, model.R
    A = np.linalg.inv(H @ Q @ H.T + R)
    Kn = Q @ H.T @ A
    Km = F.T @ H.T @ A
    update = np.eye(model.n) - Kn @ H
    Pn = update @ Q @ update.T + Kn @ R @ Kn.T
    return LainiotisMatrices(Fn=F - Kn @ H @ F, Kn=Kn, Km=Km, Pn=Pn, On=Km @ H @ F)


def lainiotis_gain(P, Fn, On):
    """Return F_n [I + P O_n]⁻¹ (n×n), the transition of the Lainiotis filter (2014 Eqs. 5, 13).

    Raises ValueError or TypeError for anything but square matrices of one size.

    >>> lainiotis_gain(np.eye(1), Fn=np.eye(1), On=np.eye(1))
    array([[0.5]])
    """
    n = len(checks.matrix("P", P, "a square matrix"))
    return _gain(*(checks.array(name, each, (n, n)) for name, each in {"P": P, "Fn": Fn, "On": On}.items()))


def _gain(P, Fn, On):
    return np.linalg.solve((np.eye(len(P)) + P @ On).T, Fn.T).T


def rekf(model):
    """Return P_p (n×n), the steady-state prediction error covariance (2014 Eq. 11, 2015 Eq. 9).

    Solved by scipy, then refined by two steps of Newton's method.

        P_p = Q + F P_p Fᵀ - F P_p Hᵀ [H P_p Hᵀ + R]⁻¹ H P_p Fᵀ

    Raises ValueError when there is no steady state, naming the condition that fails and the mode of F.

    >>> from mpt_helpers.model import gsm_axis
    >>> rekf(gsm_axis(dt=1.0, q=0.01, r=0.1)).round(4)
    array([[0.0597, 0.0257],
           [0.0257, 0.0227]])
    """
    _require_steady_state(model)
    # scipy is silently wrong where R is very small or large, and fails where the variances of the states differ much:
    # it gets states and measurements of unit variance. Near the unit circle it loses more digits than the equation.
    unit = _units(model)
    F, Q = model.F * unit / unit[:, None], model.Q / unit[:, None] / unit
    H = np.linalg.solve(np.linalg.cholesky(model.R), model.H * unit)
    try:
        P = solve_discrete_are(F.T, H.T, Q, np.eye(model.m))
        for most in NEWTON:
            step = _newton_step(P, F, H, Q)
            P = P + (step + step.T) / 2
            sigma = np.sqrt(np.maximum(np.diag(P), 1))
            if not (np.abs(step) <= most * np.outer(sigma, sigma)).all():
                _refuse_unsolved(model)
    except np.linalg.LinAlgError:
        _refuse_unsolved(model)
    return (P + P.T) / 2 * unit[:, None] * unit


def _newton_step(P, F, H, Q):
    """Return what Newton's method adds to a solution P of the REKF with R = I: Σ Aⁱ D Aᵀⁱ where P misses it by D."""
    K = np.linalg.solve(H @ P @ H.T + np.eye(len(H)), H @ P).T
    update = np.eye(len(P)) - K @ H
    A, step = F @ update, F @ (update @ P @ update.T + K @ K.T) @ F.T + Q - P
    with np.errstate(over="ignore", invalid="ignore"):  # of an A that is not stable: its sum has no end
        for _ in range(DOUBLINGS):
            A, step = A @ A, step + A @ step @ A.T
    return step


def _units(model):
    """Return how far the noise of n steps moves each state, to a power of two: in these units entries compare."""
    variance = np.diag(predicted_covariance(model, model.Q, model.n - 1))
    moved = variance > 0
    exponent = np.log2(variance, out=np.zeros(model.n), where=moved) / 2
    usual = exponent[moved].mean() if moved.any() else 0.0
    return np.exp2(np.round(np.where(moved, exponent, usual)))


def relf(model):
    """Return P_e (n×n), the steady-state estimation error covariance (2014 Eq. 14, 2015 Eq. 12), by doubling.

        P_e = P_n + F_n [I + P_e O_n]⁻¹ P_e F_nᵀ

    Step i composes 2^i steps of the Lainiotis recursion from P = 0 into one of the same form, so that it converges
    quadratically (D. G. Lainiotis, N. D. Assimakis and S. K. Katsikas, J. Math. Anal. Appl. 186, 1994). The REKF is not
    used. Raises ValueError when there is no steady state, naming the condition that fails and the mode of F.

    >>> from mpt_helpers.model import gsm_axis
    >>> relf(gsm_axis(dt=1.0, q=0.01, r=0.1)).round(4)
    array([[0.0285, 0.008 ],
           [0.008 , 0.0127]])
    """
    _require_steady_state(model)
    Fn, _, _, Pn, On = lainiotis_matrices(model)
    identity = np.eye(model.n)
    for _ in range(DOUBLINGS):
        W = _gain(Pn, Fn, On)
        following = Pn + W @ Pn @ Fn.T
        following = (following + following.T) / 2
        if np.array_equal(following, Pn):  # no entry moves: one of a small variance may settle last
            return Pn
        On = On + Fn.T @ On @ np.linalg.solve(identity + Pn @ On, Fn)
        Pn, Fn = following, W @ Fn
    _refuse_unsolved(model)


def _modes(model):
    """Yield (margin, condition, mode) for each mode of F on or outside the unit circle, by the PBH rank test."""
    unit = _units(model)
    F = model.F * unit / unit[:, None]
    H, G = _scaled(model.H * unit, F), _scaled(square_root(model.Q) / unit[:, None], F)
    modes = np.linalg.eigvals(F)
    # A multiple eigenvalue is computed as a ring around it, whose mean is as good as a simple one.
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


def _scaled(matrix, F):
    """Return the matrix at the size of F: whether a mode is seen or excited does not depend on the unit of H or Q."""
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
