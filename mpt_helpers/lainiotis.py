"""The Lainiotis filter: one step as the papers print it."""

from __future__ import annotations

from functools import cached_property
from typing import ClassVar

import numpy as np

from ._base import RecursiveFilter, may_be_diffuse, require_digits
from ._checks import Array
from .equations import lainiotis_matrices, lainiotis_step, masked, start_gain


class LainiotisFilter(RecursiveFilter):
    """The Lainiotis filter (2014 Eqs. 5-7, 2015 Eqs. 2-3).

        A_k = F_n [I + P(k/k) O_n]⁻¹,   B_k = K_n + A_k P(k/k) K_m,   P(k+1/k+1) = P_n + A_k P(k/k) F_nᵀ

    F_n, K_n and P_n describe a step from an exactly known x(k/k); O_n and K_m add the information about x(k/k) in the
    measurement. Such steps compose: several steps together have matrices of the same form, which the engine uses to run
    a long track in pieces. The results are those of the Kalman filter, but tracks with different gaps take many times
    as long.

    Parameters
    ----------
    model : LinearModel
        The model of motion and measurements.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> model = mpt.constant_velocity(dt=1.0, q=0.01, r=0.1, P0=np.diag([100.0, 1.0]))
    >>> mpt.LainiotisFilter(model).filter([[1.0], [2.0], [3.1]]).round(2)
    array([[1.  , 0.01],
           [1.92, 0.84],
           [3.04, 1.  ]])

    """

    optimal: ClassVar[bool] = True

    def next_step(self, P: Array, seen: np.ndarray) -> tuple[Array, Array, Array]:
        """Return A_k, B_k and P(k+1/k+1) from P(k/k), as in RecursiveFilter.

        Raises ValueError for a P so large that double precision leaves no digit of the next one.
        """
        constants = self._constants(seen)
        A, B, P_next = lainiotis_step(P, constants)
        C = constants.C
        if may_be_diffuse(P, C.T):
            keep = np.eye(len(P)) - start_gain(P, C) @ C.T
            require_digits(constants.Fn, keep, P, P_next, C.T, (C.T @ P @ C).diagonal() + 1)
        return A, B, P_next

    def next_steps(self, P: Array, seen: np.ndarray) -> tuple[Array, Array, Array]:
        """Return A_k, B_k and P(k+1/k+1) of stacks (M, n, n), as in RecursiveFilter, all at once."""
        return lainiotis_step(P, self._constants(seen))

    def _constants(self, seen):
        """Return the LainiotisMatrices of rows with these measurements, computed once."""
        there = tuple(seen.tolist())
        if there not in self._matrices_of:
            self._matrices_of[there] = lainiotis_matrices(self.model, *masked(self.model.H, self.model.R, seen))
        return self._matrices_of[there]

    @cached_property
    def _matrices_of(self):
        return {}
