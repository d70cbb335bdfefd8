"""The Lainiotis filter: one step as the papers print it."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ._base import RecursiveFilter
from ._checks import Array
from .equations import lainiotis_matrices, lainiotis_step, neutralised

# Patterns of missing measurements whose constants a Lainiotis filter keeps.
MOST_PATTERNS = 64


class LainiotisFilter(RecursiveFilter):
    """The Lainiotis filter (2014 Eqs. 5-7, 2015 Eqs. 2-3).

        A_k = F_n [I + P(k/k) O_n]⁻¹,   B_k = K_n + A_k P(k/k) K_m,   P(k+1/k+1) = P_n + A_k P(k/k) F_nᵀ

    Each step is made as if x(k/k) were exact: F_n, K_n and P_n; what is not known of it is added, with what the
    measurement tells about it: O_n and K_m. That holds for many steps as well as for one, and that is what this filter
    is good for: `partition` runs a long track in pieces by it, for every filter here. As a filter of its own it
    computes what the Kalman filter computes. Tracks with different gaps take it many times as long.

    >>> from mpt_helpers.model import gsm_axis
    >>> LainiotisFilter(gsm_axis(dt=1.0, q=0.01, r=0.1)).filter([[1.0], [2.0]]).round(4)
    array([[0.0612, 0.1224],
           [0.5557, 0.4681]])
    """

    def next_step(self, P: Array, seen: np.ndarray) -> tuple[Array, Array, Array]:
        """Return A_k, B_k and P(k+1/k+1) from P(k/k), (n, n) or (M, n, n), with the measurements seen (m,)."""
        return lainiotis_step(P, self._constants_of(seen))

    def next_steps(self, P: Array, seen: np.ndarray) -> tuple[Array, Array, Array]:
        """Return A_k, B_k and P(k+1/k+1) of stacks (M, n, n), as in RecursiveFilter, all at once."""
        return self.next_step(P, seen)

    def _constants_of(self, seen):
        kept, pattern = self._constants, seen.tobytes()
        constants = kept.get(pattern)
        if constants is None:
            constants = lainiotis_matrices(self.model, *neutralised(self.model.H, self.model.R, seen))
            if len(kept) >= MOST_PATTERNS:
                kept.clear()
            kept[pattern] = constants
        return constants  # not what is kept: another thread may have cleared it

    @cached_property
    def _constants(self):
        return {}
