"""Predictions some steps ahead: of any filter, and of the steady-state filter as 2016 (Assimakis et al.) prints it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from . import _checks as checks
from ._base import Filter
from ._checks import Array
from .equations import predicted_covariance
from .model import LinearModel
from .steady import SteadyStateFilter


@dataclass(frozen=True, eq=False, repr=False)
class Predictor(Filter):
    """The prediction of a filter's state N steps ahead: row k - 1 of `filter(z)` is x(k+N/k).

        x(k+N/k) = Fᴺ x(k/k),   P(k+N/k) = Fᴺ P(k/k) Fᴺᵀ + Q + F Q Fᵀ + ... + Fᴺ⁻¹ Q (Fᴺ⁻¹)ᵀ

    A prediction has no P0, no innovations, no `step` and no smoother.

    Parameters
    ----------
    estimator : Filter
        The filter whose state is predicted.
    steps : int
        The number of steps N, each of the model's dt, also where the filter has times of its own.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> kf = mpt.KalmanFilter(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1, x0=[0, 2], P0=np.eye(2)))
    >>> mpt.Predictor(kf, steps=3).filter([[2.0], [4.0]])
    array([[ 8.,  2.],
           [10.,  2.]])

    """

    estimator: Filter
    steps: int
    optimal: ClassVar[bool] = False  # P is the covariance of a prediction

    def __post_init__(self) -> None:
        checks.instance("estimator", self.estimator, Filter)
        object.__setattr__(self, "steps", checks.count("steps", self.steps, least=0))  # an int, as filters are compared

    @property
    def model(self) -> LinearModel:
        """The model of the filter."""
        return self.estimator.model

    @property
    def subfilters(self) -> Sequence[Filter]:
        """The filter whose states are predicted."""
        return (self.estimator,)

    @property
    def steps_ahead(self) -> int:
        """The number of steps from the last measurement to the state that is predicted."""
        return self.estimator.steps_ahead + self.steps

    @property
    def F_N(self) -> Array:
        """The transition over N steps, Fᴺ (n×n)."""
        return np.linalg.matrix_power(self.model.F, self.steps)

    def run(self, z: Array, x: Array, covariances: bool) -> Array | None:
        """Write the predictions to x and return the covariances of their errors if wanted, as in Filter."""
        P = self.estimator.run(z, x, covariances)
        F_N = self.F_N
        for x_k in x:
            x_k[:] = F_N @ x_k
        if P is None:
            return None
        P = predicted_covariance(self.model, np.moveaxis(P, 3, 1), self.steps)  # stacks (N, M or 1, n, n)
        return np.moveaxis(P, 1, 3)


@dataclass(frozen=True, eq=False, repr=False)
class SteadyStatePredictor(Predictor):
    """The steady-state prediction N steps ahead (2016 Eqs. 15-20): row k - 1 of `filter(z)` is x(k+N/k).

        x(k+N/k) = A_N x(k+N-1/k-1) + B_N z(k),   A_N = Fᴺ A F⁻ᴺ,   B_N = Fᴺ B,   x(N/0) = Fᴺ x0

    It is computed as Fᴺ x(k/k), through gaps too: where nothing is missing, that is the recursion above.

    Parameters
    ----------
    estimator : SteadyStateFilter
        The filter with A and B.
    steps : int
        The number of steps N.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> steady = mpt.SteadyStateFilter.from_kalman(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1))
    >>> mpt.SteadyStatePredictor(steady, steps=3).filter([[1.0], [2.0]]).round(4)
    array([[1.186 , 0.2125],
           [2.8678, 0.4757]])

    """

    estimator: SteadyStateFilter

    def __post_init__(self) -> None:
        checks.instance("estimator", self.estimator, SteadyStateFilter)
        super().__post_init__()

    @property
    def A(self) -> Array:
        """A_N = Fᴺ A F⁻ᴺ (n×n), which `filter` does not use; raises LinAlgError where F has no inverse."""
        return np.linalg.solve(self.F_N.T, (self.F_N @ self.estimator.A).T).T

    @property
    def B(self) -> Array:
        """B_N = Fᴺ B (n×m)."""
        return self.F_N @ self.estimator.B

    @property
    def P(self) -> Array:
        """The covariance of the prediction's error in steady state (n×n)."""
        return predicted_covariance(self.model, self.estimator.P, self.steps)
