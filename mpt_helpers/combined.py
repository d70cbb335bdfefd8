"""Filters made of filters: the mean of two, and one for each axis. 2014 and 2015 are papers of Assimakis & Adam."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from . import _checks as checks
from ._base import Estimates, Filter
from ._checks import Array, Seconds
from ._engine.columns import block_diagonal
from ._immutable import same
from .kalman import KalmanFilter
from .lainiotis import LainiotisFilter
from .model import LinearModel, stack
from .steady import SteadyStateFilter


@dataclass(frozen=True, eq=False, repr=False)
class JoinFilter(Filter):
    """The mean of two filters of one model (2014 Eqs. 8, 16; 2015 Eqs. 4-5, 13).

        x(k/k) = [x_1(k/k) + x_2(k/k)] / 2,   P(k/k) = [P_1(k/k) + P_2(k/k)] / 2

    The papers join the Kalman and Lainiotis filters, JKLF, and the two steady-state filters, JSSKLF. P is the papers'
    formula. It is the error covariance of the mean only where both filters give the same estimate.

    Parameters
    ----------
    first, second : Filter
        Two filters of one model, with the same times and variances, that predict equally far ahead.

    Raises
    ------
    ValueError
        Where their models, times, variances or steps ahead differ.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> model = mpt.constant_velocity(dt=1.0, q=0.01, r=0.1, P0=np.diag([100.0, 1.0]))
    >>> join = mpt.JoinFilter(mpt.KalmanFilter(model), mpt.LainiotisFilter(model))
    >>> join.filter([[1.0], [2.0], [3.1]]).round(2)
    array([[1.  , 0.01],
           [1.92, 0.84],
           [3.04, 1.  ]])

    """

    first: Filter
    second: Filter

    def __post_init__(self) -> None:
        checks.instance("first", self.first, Filter)
        checks.instance("second", self.second, Filter)
        if self.first.model != self.second.model:
            checks.refuse("second", "a filter of the same model as the first", "one of another model")
        _require_equally_far_ahead("second", self.first, self.second)
        _require_equal_conditions(self.first, self.second)

    @property
    def model(self) -> LinearModel:
        """The model of both filters."""
        return self.first.model

    @property
    def P0(self) -> Array:
        """The mean of both P(0/0)."""
        return (self.first.P0 + self.second.P0) / 2

    @property
    def subfilters(self) -> Sequence[Filter]:
        """Both filters."""
        return self.first, self.second

    def step(
        self, x: ArrayLike, P: ArrayLike, z_k: ArrayLike, dt: Seconds | None = None, r: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Return the mean of both filters' steps from one state, as `KalmanFilter.step`.

        Raises TypeError where the two results differ, as with different gains: each filter would need its own state.
        """
        x_1, P_1 = self.first.step(x, P, z_k, dt, r)
        x_2, P_2 = self.second.step(x, P, z_k, dt, r)
        sigma = np.sqrt(np.abs(P_1.diagonal()))
        same_x = np.abs(x_1 - x_2) <= checks.SOLVED * (np.abs(x_1) + sigma)
        same_P = np.abs(P_1 - P_2) <= checks.SOLVED * sigma * sigma[:, None]
        if not (self.optimal or (same_x.all() and same_P.all())):
            kinds = " and ".join(type(each).__name__ for each in self.subfilters)
            raise TypeError(f"step: needs two filters of the same gain, as each keeps a state of its own, got {kinds}")
        return (x_1 + x_2) / 2, (P_1 + P_2) / 2

    def smooth(self, z: ArrayLike) -> Estimates:
        """Return the means of both filters' smoothed states and covariances."""
        first, second = self.first.smooth(z), self.second.smooth(z)
        return Estimates((first.x + second.x) / 2, (first.P + second.P) / 2)

    def run(self, z: Array, x: Array, covariances: bool) -> Array | None:
        """Write the mean estimates to x and return the mean covariances if wanted, as in Filter."""
        x_2 = np.empty_like(x)
        P_1 = self.first.run(z, x, covariances)
        P_2 = self.second.run(z, x_2, covariances)
        x += x_2
        x /= 2
        return (P_1 + P_2) / 2 if covariances else None

    def innovations_of(self, z: Array) -> tuple[Array, Array]:
        """Return the means of both, as innovations are linear in the state and S is linear in its covariance."""
        values_1, S_1 = self.first.innovations_of(z)
        values_2, S_2 = self.second.innovations_of(z)
        return (values_1 + values_2) / 2, (S_1 + S_2) / 2


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Separate(Filter):
    """One filter for each axis: the papers' model B (2014 Section 5, Eqs. 17-18).

    The state vectors of the filters are stacked, as by `stack`, and each filter takes its own components of z.

    Parameters
    ----------
    *filters : Filter
        The filters, whose models have the same dt, and which predict equally far ahead.

    Raises
    ------
    ValueError
        For no filter, and where the dt of their models or their steps ahead differ.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> axis = mpt.constant_velocity(dt=1.0, q=0.01, r=0.1, P0=np.diag([100.0, 1.0]))
    >>> kf = mpt.KalmanFilter(axis)
    >>> mpt.Separate(kf, kf).filter([[1.0, 1.0], [2.0, 0.0]]).round(2)
    array([[ 1.  ,  0.01,  1.  ,  0.01],
           [ 1.92,  0.84,  0.08, -0.83]])

    """

    filters: tuple[Filter, ...]

    def __init__(self, *filters: Filter):
        if not filters:
            checks.refuse("filters", "at least one filter", "none")
        for i, each in enumerate(filters):
            checks.instance(f"filters[{i}]", each, Filter)
            _require_equally_far_ahead(f"filters[{i}]", filters[0], each)
        object.__setattr__(self, "filters", filters)
        object.__setattr__(self, "model", stack(*(each.model for each in filters)))  # refuses models of different dt

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), self.filters

    @property
    def P0(self) -> Array:
        """The block diagonal P(0/0)."""
        return block_diag(*(each.P0 for each in self.filters))

    @property
    def subfilters(self) -> Sequence[Filter]:
        """The filters."""
        return self.filters

    def step(
        self, x: ArrayLike, P: ArrayLike, z_k: ArrayLike, dt: Seconds | None = None, r: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Return one step of each filter with its components of z_k and of r, as `KalmanFilter.step`.

        Raises ValueError for a P that is not block diagonal. A NaN in r means "none" for a filter without variances.
        """
        z_k, _ = checks.one_measurement(z_k, self.model.m)
        x, P = checks.state(x, P, self.model.n)
        if r is not None:
            r = checks.real_numbers("r", r, f"a vector of {self.model.m} variances", z_k.shape).astype(float)
        x_after, P_after, between = np.empty_like(x), np.zeros_like(P), P.copy()
        for each, i, rows in self._slices():
            between[i, i] = 0
            has_none = r is None or (each.r is None and np.isnan(r[rows]).all())
            x_after[i], P_after[i, i] = each.step(x[i], P[i, i], z_k[rows], dt, None if has_none else r[rows])
        sigma = np.sqrt(np.abs(P.diagonal()))
        if (np.abs(between) > checks.ROUNDING * sigma * sigma[:, None]).any():
            checks.refuse("P", "a block diagonal covariance", "one between the states of different filters")
        return x_after, P_after

    def smooth(self, z: ArrayLike) -> Estimates:
        """Return the results of the filters' `smooth` as one state and a block diagonal covariance."""
        return self._as_given(z, lambda z: self._side_by_side([f.smooth(z[:, rows]) for f, _, rows in self._slices()]))

    def run(self, z: Array, x: Array, covariances: bool) -> Array | None:
        """Write the filters' estimates to x and return the block diagonal covariances if wanted, as in Filter."""
        P = [each.run(z[:, rows], x[:, i], covariances) for each, i, rows in self._slices()]
        return _block_diagonal(P) if covariances else None

    def innovations_of(self, z: Array) -> tuple[Array, Array]:
        """Return the innovations of all filters, and their covariances, block diagonal."""
        return self._side_by_side([each.innovations_of(z[:, rows]) for each, _, rows in self._slices()])

    @staticmethod
    def _side_by_side(parts):
        """Return pairs of values (N, d, M) and covariances (N, d, d, M or 1) as one pair."""
        values, C = zip(*parts, strict=True)
        return np.concatenate(values, axis=1), _block_diagonal(C)

    def _slices(self):
        """Return each filter with the slices of its states and of its measurements."""
        parts, n, m = [], 0, 0
        for each in self.filters:
            parts.append((each, slice(n, n + each.model.n), slice(m, m + each.model.m)))
            n, m = n + each.model.n, m + each.model.m
        return parts


def _block_diagonal(parts):
    """Return covariances (N, d_i, d_i, M or 1) as one (N, d, d, M or 1), block diagonal."""
    return np.moveaxis(block_diagonal(np.moveaxis(C, 0, 2) for C in parts), 2, 0)


def _require_equally_far_ahead(name, first, other):
    if first.steps_ahead != other.steps_ahead:
        need, got = (f"one {each.steps_ahead} steps ahead" for each in (first, other))
        checks.refuse(name, f"{need}, as the first", got)


def _require_equal_conditions(first, second):
    of_first, of_second = first.elementary_filters, second.elementary_filters
    t = of_first[0].t
    if not all(same(t, each.t) for each in (*of_first, *of_second)):
        checks.refuse("second", "a filter of the same times as the first", "one of others")
    # The filters in a Separate see some columns of z each: their variances are comparable only one by one.
    if len(of_first) == len(of_second) and not all(same(a.r, b.r) for a, b in zip(of_first, of_second, strict=True)):
        checks.refuse("second", "a filter of the same variances as the first", "one of others")


def six_filters(model: LinearModel) -> dict[str, Filter]:
    """Return the six filters of the papers (2014 Table 1, 2015 Table 1), in the papers' order.

    Parameters
    ----------
    model : LinearModel
        The model, which must have a steady state.

    Returns
    -------
    dict
        The filters by their names in the papers.

    Raises
    ------
    ValueError
        For a model without a steady state.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> list(mpt.six_filters(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1)))
    ['KF', 'LF', 'JKLF', 'SSKF', 'SSLF', 'JSSKLF']

    """
    kf, lf = KalmanFilter(model), LainiotisFilter(model)
    sskf, sslf = SteadyStateFilter.from_kalman(model), SteadyStateFilter.from_lainiotis(model)
    return {
        "KF": kf,
        "LF": lf,
        "JKLF": JoinFilter(kf, lf),
        "SSKF": sskf,
        "SSLF": sslf,
        "JSSKLF": JoinFilter(sskf, sslf),
    }
