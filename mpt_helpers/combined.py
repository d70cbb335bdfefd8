"""Filters made of filters: the mean of two, and one for each axis.

2014 and 2015 are papers of Assimakis & Adam; `mpt_helpers` has their titles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from . import _checks as checks
from ._base import Estimates, Filter
from ._checks import Array, Seconds
from ._immutable import same
from .kalman import KalmanFilter
from .lainiotis import LainiotisFilter
from .model import LinearModel, stack
from .steady import SteadyStateFilter

# Two constant gains are one gain if they differ by no more than this part of the largest gain of the same state. Both
# Riccati equations give one gain to six digits at least.
SAME_GAIN = 1e-6


@dataclass(frozen=True, eq=False, repr=False)
class JoinFilter(Filter):
    """The mean of two filters of one model (2014 Eqs. 8, 16; 2015 Eqs. 4-5, 13).

        x(k/k) = [x_1(k/k) + x_2(k/k)] / 2,   P(k/k) = [P_1(k/k) + P_2(k/k)] / 2

    The papers join the Kalman and the Lainiotis filter, JKLF, and both steady-state filters, JSSKLF. P is the papers'
    formula: it is the covariance of the mean's error only where both give the same estimate. Raises TypeError for
    anything but two filters, and ValueError where their models, times or variances differ (but for variances within a
    Separate, which are not compared) or one predicts further ahead than the other.

    >>> from mpt_helpers.model import gsm_axis
    >>> axis = gsm_axis(dt=1.0, q=0.01, r=0.1)
    >>> JoinFilter(KalmanFilter(axis), LainiotisFilter(axis)).filter([[1.0], [2.0]]).round(4)
    array([[0.0612, 0.1224],
           [0.5557, 0.4681]])
    """

    first: Filter
    second: Filter

    def __post_init__(self):
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
    def steps_ahead(self) -> int:
        """The number of steps that both filters predict ahead."""
        return self.first.steps_ahead

    @property
    def P0(self) -> Array:
        """The mean of both P(0/0)."""
        return (self.first.P0 + self.second.P0) / 2

    @property
    def parts(self) -> Sequence[Filter]:
        """Both filters."""
        return self.first, self.second

    def step(
        self, x: ArrayLike, P: ArrayLike, z_k: ArrayLike, dt: Seconds | None = None, r: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Return the mean of both filters' steps from x (n,), P (n, n) and one measurement z_k (m,).

        dt and r are as in KalmanFilter, for filters that both take them. Raises TypeError where the gains are not
        known to be the same, as for two constant ones that differ: then each would need a state of its own.
        """
        if self.first.optimal != self.second.optimal or not _equal(*map(_constant_gain, self.parts)):
            kinds = " and ".join(type(each).__name__ for each in self.parts)
            raise TypeError(f"step: needs two filters of the same gain, as each keeps a state of its own, got {kinds}")
        x_1, P_1 = self.first.step(x, P, z_k, dt, r)
        x_2, P_2 = self.second.step(x, P, z_k, dt, r)
        return (x_1 + x_2) / 2, (P_1 + P_2) / 2

    @property
    def optimal(self) -> bool:
        """Say whether both filters are optimal: a filter of constant gain is not."""
        return self.first.optimal and self.second.optimal

    def smooth(self, z: ArrayLike) -> Estimates:
        """Return the means of what both filters' `smooth` return."""
        first, second = self.first.smooth(z), self.second.smooth(z)
        return Estimates((first.x + second.x) / 2, (first.P + second.P) / 2)

    def run(self, z: Array, x: Array, covariances: bool) -> Array | None:
        """Write the mean estimates to x and return the mean covariances if wanted, as in Filter."""
        x_2 = np.empty_like(x)
        P_1 = self.first.run(z, x, covariances)
        P_2 = self.second.run(z, x_2, covariances)
        for x_k, x_2_k in zip(x, x_2, strict=True):  # an epoch at a time, which stays in the cache
            x_k += x_2_k
            x_k /= 2
        return (P_1 + P_2) / 2 if covariances else None

    def innovations_of(self, z: Array) -> tuple[Array, Array]:
        """Return the means of both: they are linear in the state and in its covariance."""
        values_1, S_1 = self.first.innovations_of(z)
        values_2, S_2 = self.second.innovations_of(z)
        return (values_1 + values_2) / 2, (S_1 + S_2) / 2


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Separate(Filter):
    """One filter for each axis: the papers' model B (2014 Section 5, Eqs. 17-18).

    The states of the filters follow one another, as in `stack`, and each filter takes its own rows of z. Raises
    TypeError for anything but filters, and ValueError for none, where one predicts further ahead than another, and
    where the dt of their models differ: the rows of z are of one time.

    >>> from mpt_helpers.model import gsm_axis
    >>> kf = KalmanFilter(gsm_axis(dt=1.0, q=0.01, r=0.1))
    >>> Separate(kf, kf).filter([[1.0, 1.0], [2.0, 0.0]]).round(4)
    array([[0.0612, 0.1224, 0.0612, 0.1224],
           [0.5557, 0.4681, 0.1164, 0.06  ]])
    """

    filters: tuple[Filter, ...]

    def __init__(self, *filters: Filter):
        if not filters:
            checks.refuse("filters", "at least one filter", "none")
        for i, each in enumerate(filters):
            checks.instance(f"filters[{i}]", each, Filter)
            _require_equally_far_ahead(f"filters[{i}]", filters[0], each)
        known = [each.model.dt for each in filters if each.model.dt is not None]
        for dt in known:
            if dt != known[0]:
                need = "models of one dt, as the measurements of a row of z are of one time"
                checks.refuse("filters", need, f"{known[0]:g} and {dt:g} s")
        object.__setattr__(self, "filters", filters)

    def __reduce__(self):
        return type(self), self.filters

    @cached_property
    def model(self) -> LinearModel:
        """The models of the filters, stacked."""
        return stack(*(each.model for each in self.filters))

    @property
    def steps_ahead(self) -> int:
        """The number of steps that all filters predict ahead."""
        return self.filters[0].steps_ahead

    @property
    def P0(self) -> Array:
        """The block diagonal P(0/0)."""
        return block_diag(*(each.P0 for each in self.filters))

    @property
    def optimal(self) -> bool:
        """Say whether all filters are optimal: a filter of constant gain is not."""
        return all(each.optimal for each in self.filters)

    @property
    def parts(self) -> Sequence[Filter]:
        """The filters."""
        return self.filters

    def step(
        self, x: ArrayLike, P: ArrayLike, z_k: ArrayLike, dt: Seconds | None = None, r: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Return x (n,) and P (n, n), block diagonal, after one step of each filter with its part of z_k (m,).

        dt is the time since x, for filters that all take it. r (m,) are the variances of z_k, each filter's own; all
        NaN for a filter that has none.
        """
        z_k, _ = checks.one_measurement(z_k, self.model.m)
        x, P = checks.state(x, P, self.model.n)
        if r is not None:
            r = checks.real_numbers("r", r, f"a vector of {self.model.m} variances").astype(float)
            if r.shape != z_k.shape:
                checks.refuse("r", f"a vector of {self.model.m} variances", f"shape {r.shape}")
        after = []
        for each, i, rows in self._slices():
            r_i = None if r is None else _variances_for(each, r[rows])
            after.append(each.step(x[i], P[i, i], z_k[rows], dt, r_i))
        return np.concatenate([x_i for x_i, _ in after]), block_diag(*(P_i for _, P_i in after))

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
    d = sum(C.shape[1] for C in parts)
    whole, start = np.zeros((len(parts[0]), d, d, max(C.shape[3] for C in parts))), 0
    for C in parts:
        here = slice(start, start + C.shape[1])
        whole[:, here, here] = C
        start = here.stop
    return whole


def _variances_for(estimator, r):
    """Return the variances r (m,) of one measurement for the `step` of a filter: all NaN mean none, if it has none."""
    return None if np.isnan(r).all() and estimator.r is None else r


def _equal(K_1, K_2):
    """Tell whether two gains (n, m) are one but for what two solvers may differ by, state by state: each has its unit.

    Where a gain is zero, of two axes in one model for example, one solver may give zero and the other its rounding.
    """
    size = np.abs(K_1).max(axis=1, keepdims=True)
    rounding = np.finfo(float).eps * size.max()
    return (np.abs(K_1 - K_2) <= SAME_GAIN * size + rounding).all()


def _constant_gain(estimator):
    """Return the gain (n, m) of a steady-state filter and of what is made of them.

    A filter whose gain follows its P (`optimal`) has zeros here: two of them have the same gain wherever they have the
    same P. Of any other filter it is not known, and NaN equals nothing.
    """
    if isinstance(estimator, SteadyStateFilter):
        return estimator.B
    if isinstance(estimator, JoinFilter):
        return _constant_gain(estimator.first)  # its `step` asks whether the second has the same
    if isinstance(estimator, Separate):
        return block_diag(*map(_constant_gain, estimator.filters))
    n = len(estimator.P0)  # a filter that has no step raises here, by name
    return np.full((n, estimator.model.m), 0.0 if estimator.optimal else np.nan)


def _require_equally_far_ahead(name, first, other):
    if first.steps_ahead != other.steps_ahead:
        need, got = (f"one {each.steps_ahead} steps ahead" for each in (first, other))
        checks.refuse(name, f"{need}, as the first", got)


def _require_equal_conditions(first, second):
    leaves = [*_leaves(first), *_leaves(second)]
    if not all(same(leaves[0].t, other.t) for other in leaves[1:]):
        checks.refuse("second", "a filter of the same times as the first", "one of others")
    # The filters in a Separate see some columns of z each: one of them has no variances that others could be.
    of_first, of_second = ([leaf.r for leaf in _leaves(each)] for each in (first, second))
    if len(of_first) == len(of_second) and not all(map(same, of_first, of_second)):
        checks.refuse("second", "a filter of the same variances as the first", "one of others")


def _leaves(estimator):
    """Return the filters that a filter is made of in the end, itself where it is made of none."""
    return [leaf for part in estimator.parts for leaf in _leaves(part)] or [estimator]


def six_filters(model: LinearModel) -> dict[str, Filter]:
    """Return the six filters of the papers by their names (2014 Table 1, 2015 Table 1), in the papers' order.

    Raises ValueError when the model has no steady state.

    >>> from mpt_helpers.model import gsm_axis
    >>> list(six_filters(gsm_axis(dt=1.0, q=0.01, r=0.1)))
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
