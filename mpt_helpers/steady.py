"""Filters with constant coefficients: the steady-state filter and its FIR form.

2014 and 2015 are papers of Assimakis & Adam, 2016 is one of Assimakis and others.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from . import _checks as checks
from . import riccati
from ._base import Filter, RecursiveFilter
from ._checks import Array
from ._engine.columns import LinearMap
from ._engine.shared import TILE, tiles
from .equations import corrected_covariance, gain, lainiotis_matrices, lainiotis_step, predicted_covariance
from .model import LinearModel

# The most taps of a FIR filter, which bounds the search for its order. Long before, the steady-state filter is faster.
MOST_TAPS = 1_000_000


@dataclass(frozen=True, eq=False, init=False, repr=False)
class SteadyStateFilter(RecursiveFilter):
    """A filter with constant coefficients (2014 Eqs. 9-15, 2015 Eqs. 6-12, 2016 Eqs. 8-12).

        x(k+1/k+1) = A x(k/k) + B z(k+1),   A = (I - B H) F

    `from_kalman` and `from_lainiotis` solve different Riccati equations, so that their agreement (2014 Eq. 15) is a
    genuine check. The covariance starts at P, grows during a gap, and converges back to P. It is that of the actual
    error provided that the error of x0 has covariance P. A row of z that is partly NaN is refused, since the constant
    gain is for a complete row.

    Parameters
    ----------
    model : LinearModel
        The model of motion and measurements.
    A, B : array_like (n, n), (n, m)
        The coefficients.
    P : array_like (n, n)
        P(0/0), the steady-state covariance. It is not checked against A and B; from another P the covariances converge
        to the steady one.

    Raises
    ------
    ValueError
        For arrays of another shape, and for an A that is not (I - B H) F.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> steady = mpt.SteadyStateFilter.from_kalman(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1))
    >>> steady.B.round(4)
    array([[0.5485],
           [0.2125]])
    >>> steady.filter([[1.0], [2.0], [3.1]]).round(2)
    array([[0.55, 0.21],
           [1.44, 0.48],
           [2.57, 0.73]])

    """

    A: Array
    B: Array
    P: Array

    optimal: ClassVar[bool] = False  # after a gap P has grown, and the gain has not

    def __init__(self, model: LinearModel, A: ArrayLike, B: ArrayLike, P: ArrayLike):
        super().__init__(model)
        n, m, F, H = model.n, model.m, model.F, model.H
        object.__setattr__(self, "A", checks.array("A", A, (n, n)))
        object.__setattr__(self, "B", checks.array("B", B, (n, m)))
        object.__setattr__(self, "P", checks.covariance("P", P, n, tolerance=checks.SOLVED))
        gap = np.abs(self.A - (F - self.B @ H @ F))
        size = np.abs(F) + np.abs(self.B) @ np.abs(H) @ np.abs(F)
        rounding = n * np.finfo(float).eps * size.max()  # where an entry of A is zero, and computed as nearly zero
        if (gap > checks.SOLVED * size + rounding).any():
            checks.refuse("A", "(I - B H) F, as in every filter of the papers", f"a gap of {gap.max():.6g}")

    @classmethod
    def from_kalman(cls, model: LinearModel) -> Self:
        """Make the filter of a model by the Riccati equation of the Kalman filter.

            A = (I - K H) F,   B = K (2014 Eqs. 10-11)

        Parameters
        ----------
        model : LinearModel
            The model.

        Returns
        -------
        SteadyStateFilter
            The filter.

        Raises
        ------
        ValueError
            For a model without a steady state, naming the condition that fails and the mode.

        """
        P = riccati.rekf(model)
        K = gain(P, model.H, model.R)
        A = (np.eye(model.n) - K @ model.H) @ model.F
        P = corrected_covariance(P, K, model.H, model.R)
        riccati.require_resolved(model, P)
        return cls(model, A=A, B=K, P=P)

    @classmethod
    def from_lainiotis(cls, model: LinearModel) -> Self:
        """Make the filter of a model by the Riccati equation of the Lainiotis filter (2014 Eqs. 13-14).

            A = F_n [I + P O_n]⁻¹,   B = K_n + A P K_m

        Parameters
        ----------
        model : LinearModel
            The model.

        Returns
        -------
        SteadyStateFilter
            The filter.

        Raises
        ------
        ValueError
            For a model without a steady state, naming the condition that fails and the mode.

        """
        P = riccati.relf(model)
        riccati.require_resolved(model, P)
        A, B, _ = lainiotis_step(P, lainiotis_matrices(model))
        return cls(model, A=A, B=B, P=P)

    @property
    def P0(self) -> Array:
        """P(0/0), the covariance of the steady state."""
        return self.P

    def next_step(self, P: Array, seen: np.ndarray) -> tuple[Array, Array, Array]:
        """Return A, B and P(k+1/k+1), as in RecursiveFilter. In a missed epoch A is F, B is zero, P is F P Fᵀ + Q."""
        P_predicted = predicted_covariance(self.model, P)
        if not seen.any():
            return self.model.F, np.zeros_like(self.B), P_predicted
        _require_whole_rows(seen)
        return self.A, self.B, corrected_covariance(P_predicted, self.B, self.model.H, self.model.R)

    def advance(self, row: tuple[Any, ...], x: Array, P: Array) -> tuple[Array, Array, Array]:
        """Return x(k+1/k+1) and P(k+1/k+1) of one row of many tracks, and no innovations, as in RecursiveFilter."""
        z, seen, *_ = row
        _require_whole_rows(seen)
        x, P = self.motion(x, P)
        keep, noise = self._correction
        x_seen, P_seen = keep(x, P)
        x_seen += np.tensordot(self.B, z, axes=1)
        return np.where(seen[0], x_seen, x), np.where(seen[0], P_seen + noise, P), x[:0]

    @cached_property
    def _correction(self):
        """I - B H as a LinearMap, and B R Bᵀ (n, n, 1)."""
        keep = LinearMap(np.eye(self.model.n) - self.B @ self.model.H)
        return keep, (self.B @ self.model.R @ self.B.T)[..., None]


def _require_whole_rows(seen):
    """Raise a ValueError where a row of seen, (m, ...), is partly true: a constant gain is for a complete row."""
    if (seen != seen[:1]).any():
        need = "rows all of numbers or all of NaN, as the gain is constant (KalmanFilter takes partly missing rows)"
        checks.refuse("z", need, "a row that is partly NaN")


def fir_order(A: ArrayLike, tol: float, norm: float | str = 2) -> int:
    """Return the FIR order: the first power M with ‖Aᴹ‖ < tol (2014 Section 7).

    Parameters
    ----------
    A : array_like (n, n)
        The coefficient of a steady-state filter.
    tol : float
        The paper's ε, in (0, 1].
    norm : {2, 1, inf, 'fro', 'nuc'}
        The norm as in `numpy.linalg.norm`; 2 is the spectral norm.

    Returns
    -------
    int
        The order M.

    Raises
    ------
    ValueError
        For a tol outside (0, 1], and for an A whose powers do not fall below it within a million steps.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> mpt.fir_order([[0.5]], tol=0.1)
    4

    """
    n = checks.rows("A", A)
    A = checks.array("A", A, (n, n))
    tol = checks.number("tol", tol, "a number in (0, 1]", lambda tol: 0 < tol <= 1)
    radius = np.abs(np.linalg.eigvals(A)).max()  # ρ: the powers of A fall by it in each step, in the end
    if radius >= 1:
        checks.refuse("A", "a spectral radius below 1", f"{radius:.6g}")
    # ‖Aᴹ‖ ≥ ρᴹ ≥ tol for every M ≤ log tol / log ρ, so the search starts there. One part in 1e9 is for rounding.
    least = np.log(tol) / np.log(radius) * (1 - 1e-9) if radius > 0 else 1
    order = max(1, int(least))
    power = np.linalg.matrix_power(A, min(order, MOST_TAPS))
    while order <= MOST_TAPS and np.linalg.norm(power, norm) >= tol:
        power = power @ A
        order += 1
    if order > MOST_TAPS:
        checks.refuse("A", f"powers that fall below {tol:g} within {MOST_TAPS:,} steps", f"a radius of {radius:.9f}")
    return order


@dataclass(frozen=True, eq=False, init=False, repr=False)
class FIRFilter(Filter):
    """The FIR form of a steady-state filter (2014 Section 7, Eqs. 20-22): a weighted sum of the last measurements.

        x(k/k) = Σ taps[j] z(k-j),   taps[j] = Aʲ B,   j = 0 ... order - 1

    Measurements before z(1) are taken as zero, so that the first `order` estimates are those of a start at zero. x0 is
    used only if the first epochs are missed. The estimate of a missed epoch is the prediction F x(k-1/k-1), and its
    measurement is replaced by the predicted one, H F x(k-1/k-1), with which the steady-state filter would return its
    prediction, too. The filter has no covariances.

    Parameters
    ----------
    model : LinearModel
        The model of motion and measurements.
    taps : array_like (order, n, m)
        The weights of the last measurements, the newest first.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> steady = mpt.SteadyStateFilter.from_kalman(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1))
    >>> fir = mpt.FIRFilter.from_steady_state(steady, tol=1e-3)
    >>> fir.order
    20
    >>> fir.filter([[1.0], [2.0], [3.1]]).round(2)
    array([[0.55, 0.21],
           [1.44, 0.48],
           [2.57, 0.73]])

    """

    model: LinearModel
    taps: Array

    def __init__(self, model: LinearModel, taps: ArrayLike):
        checks.instance("model", model, LinearModel)
        order = max(1, np.size(taps) // (model.n * model.m))
        object.__setattr__(self, "model", model)
        object.__setattr__(self, "taps", checks.array("taps", taps, (order, model.n, model.m)))

    @classmethod
    def from_steady_state(cls, steady: SteadyStateFilter, tol: float = 1e-3) -> Self:
        """Cut the impulse response Aʲ B of a steady-state filter where the spectral norm of Aʲ falls below tol.

        Parameters
        ----------
        steady : SteadyStateFilter
            The filter with A and B.
        tol : float
            The paper's ε, as in `fir_order`.

        Returns
        -------
        FIRFilter
            The FIR filter.

        Raises
        ------
        ValueError
            As `fir_order`.

        """
        checks.instance("steady", steady, SteadyStateFilter)
        taps = [steady.B]
        for _ in range(fir_order(steady.A, tol) - 1):
            taps.append(steady.A @ taps[-1])
        return cls(steady.model, np.array(taps))

    @property
    def order(self) -> int:
        """The paper's M: the number of measurements in an estimate."""
        return len(self.taps)

    def run(self, z: Array, x: Array, covariances: bool) -> None:
        """Write the estimates to x, as in Filter; there are no covariances."""
        if covariances:
            raise self._not_recursive()
        checks.no_infinity(z)
        seen = ~np.isnan(z)
        _require_whole_rows(seen.swapaxes(0, 1))
        self._convolve(x, np.where(seen, z, 0))
        missed = ~seen[:, 0]
        F, H, x0 = self.model.F, self.model.H, self.model.x0[:, None]
        for k in np.flatnonzero(missed.any(axis=1)):
            predicted = F @ (x[k - 1] if k > 0 else x0)
            predicted_z = np.where(missed[k], H @ predicted, 0)
            # The predicted measurement counts from epoch k on; x[k] itself is the predicted state.
            x[k : k + self.order] += self.taps[: len(x) - k] @ predicted_z
            x[k] = np.where(missed[k], predicted, x[k])

    def _convolve(self, x, z):
        """Write Σ taps[j] z(k-j) of z (N, m, M) to x (N, n, M)."""
        N, m, M = z.shape
        oldest_first = self.taps[::-1].swapaxes(0, 1).reshape(self.model.n, -1)  # [taps[order-1] ... taps[1] taps[0]]
        rows = np.ascontiguousarray(z).reshape(N * m, M)
        for tracks in tiles(M, TILE):
            for k in range(N):
                end = (k + 1) * m
                used = min(k + 1, self.order) * m
                x[k, :, tracks] = oldest_first[:, -used:] @ rows[end - used : end, tracks]
