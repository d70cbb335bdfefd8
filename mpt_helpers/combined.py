"""Filters made of filters: the mean of two, and one for each axis."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from . import checks
from .checks import Array, Seconds
from .filters import KalmanFilter, LainiotisFilter
from .model import LinearModel, same, stack
from .recursive import Estimates, Filter, RecursiveFilter, one_measurement, one_state
from .steady import SteadyStateFilter

# Both Riccati equations give one gain to so many digits at least.
SAME_GAIN = 1e-6


@dataclass(frozen=True, eq=False)
class JoinFilter(Filter):
    """The mean of two filters of one model (2014 Eqs. 8, 16; 2015 Eqs. 4-5, 13).

        x(k/k) = [x_1(k/k) + x_2(k/k)] / 2,   P(k/k) = [P_1(k/k) + P_2(k/k)] / 2

    The papers join the Kalman and the Lainiotis filter, JKLF, and both steady-state filters, JSSKLF. P is the papers'
    formula: it is the covariance of the mean's error only where both give the same estimate. Raises TypeError for
    anything but two filters, and ValueError where their models, times or variances differ or one predicts further ahead
    than the other.

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

    def step(self, x: ArrayLike, P: ArrayLike, z_k: ArrayLike) -> tuple[Array, Array]:
        """Return the mean of both filters' steps from x (n,), P (n, n) and one measurement z_k (m,).

        Raises TypeError where the filters differ in their gains: then each would need a state of its own.
        """
        gains = [getattr(each, "B", 0.0) for each in (self.first, self.second)]  # of filters whose gain is constant
        if self.first.optimal != self.second.optimal or not np.allclose(*gains, rtol=SAME_GAIN, atol=0):
            kinds = " and ".join(type(each).__name__ for each in (self.first, self.second))
            raise TypeError(f"step: needs two filters of the same gain, as each keeps a state of its own, got {kinds}")
        x_1, P_1 = self.first.step(x, P, z_k)
        x_2, P_2 = self.second.step(x, P, z_k)
        return (x_1 + x_2) / 2, (P_1 + P_2) / 2

    @property
    def optimal(self) -> bool:
        """Say whether both filters' gains follow their covariances."""
        return self.first.optimal and self.second.optimal

    def epochs(self, z: Array) -> Iterator[tuple[Array, Array]]:
        """Yield the means of what both filters' `epochs` yield."""
        for (x_1, P_1), (x_2, P_2) in zip(self.first.epochs(z), self.second.epochs(z), strict=True):
            yield (x_1 + x_2) / 2, (P_1 + P_2) / 2

    def smooth(self, z: ArrayLike) -> Estimates:
        """Return the means of what both filters' `smooth` return."""
        first, second = self.first.smooth(z), self.second.smooth(z)
        return Estimates((first.x + second.x) / 2, (first.P + second.P) / 2)

    def _estimates(self, z):
        return _means(self.first._estimates(z), self.second._estimates(z))

    def _innovations(self, z):
        # Both are linear in the state and in its covariance.
        return _means(self.first._innovations(z), self.second._innovations(z))

    def _fill(self, x, z):
        second = np.empty_like(x)
        self.first._fill(x, z)
        self.second._fill(second, z)
        for x_k, second_k in zip(x, second, strict=True):  # an epoch at a time, which stays in the cache
            x_k += second_k
            x_k /= 2


def _means(first, second):
    """Return the means of two pairs of arrays."""
    return tuple((a + b) / 2 for a, b in zip(first, second, strict=True))


@dataclass(frozen=True, eq=False, init=False)
class Separate(Filter):
    """One filter for each axis: the papers' model B (2014 Section 5, Eqs. 17-18).

    The states of the filters follow one another, as in `stack`, and each filter takes its own rows of z. Raises
    TypeError for anything but filters, and ValueError for none and where one predicts further ahead than another.

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
        """Say whether all filters' gains follow their covariances."""
        return all(each.optimal for each in self.filters)

    def step(self, x: ArrayLike, P: ArrayLike, z_k: ArrayLike, dt: Seconds | None = None) -> tuple[Array, Array]:
        """Return x (n,) and P (n, n), block diagonal, after one step of each filter with its part of z_k (m,).

        dt is the time since x, for filters that all take it.
        """
        z_k, _ = one_measurement(z_k, self.model.m)
        x, P = one_state(x, P, self.model.n)
        given = {} if dt is None else {"dt": dt}
        after = [each.step(x[i], P[i, i], z_k[rows], **given) for each, i, rows in self._parts()]
        return np.concatenate([x_i for x_i, _ in after]), block_diag(*(P_i for _, P_i in after))

    def epochs(self, z: Array) -> Iterator[tuple[Array, Array]]:
        """Yield x (n, M) and P (n, n, 1 or M), block diagonal, of what the filters' `epochs` yield."""
        n = self.model.n
        parts = self._parts()
        for epoch in zip(*(each.epochs(z[:, rows]) for each, _, rows in parts), strict=True):
            P = np.zeros((n, n, max(P_i.shape[2] for _, P_i in epoch)))
            for (_, P_i), (_, i, _) in zip(epoch, parts, strict=True):
                P[i, i] = P_i
            yield np.concatenate([x for x, _ in epoch]), P

    def smooth(self, z: ArrayLike) -> Estimates:
        """Return what the filters' `smooth` return, as one state and a block diagonal covariance."""
        return self._as_given(z, self._smoothed)

    def _fill(self, x, z):
        for each, i, rows in self._parts():
            each._fill(x[:, i], z[:, rows])

    def _estimates(self, z):
        return self._side_by_side([each._estimates(z[:, rows]) for each, _, rows in self._parts()])

    def _innovations(self, z):
        return self._side_by_side([each._innovations(z[:, rows]) for each, _, rows in self._parts()])

    def _smoothed(self, z):
        return self._side_by_side([each.smooth(z[:, rows]) for each, _, rows in self._parts()])

    @staticmethod
    def _side_by_side(parts):
        """Return pairs of values (N, d, M) and covariances (N, d, d, M or 1) as one pair, block diagonal."""
        values = np.concatenate([value for value, _ in parts], axis=1)
        N, d, _ = values.shape
        C = np.zeros((N, d, d, max(C_i.shape[3] for _, C_i in parts)))
        end = 0
        for _, C_i in parts:
            here = slice(end, end + C_i.shape[1])
            C[:, here, here] = C_i
            end = here.stop
        return values, C

    def _parts(self):
        """Return each filter with the slices of its states and of its measurements."""
        parts, n, m = [], 0, 0
        for each in self.filters:
            parts.append((each, slice(n, n + each.model.n), slice(m, m + each.model.m)))
            n, m = n + each.model.n, m + each.model.m
        return parts


def _require_equally_far_ahead(name, first, other):
    if first.steps_ahead != other.steps_ahead:
        need, got = (f"one {each.steps_ahead} steps ahead" for each in (first, other))
        checks.refuse(name, f"{need}, as the first", got)


def _require_equal_conditions(first, second):
    for name, what in (("t", "times"), ("r", "variances")):
        one, *others = (getattr(each, name, None) for each in (*_leaves(first), *_leaves(second)))
        if name == "r" and not (isinstance(first, RecursiveFilter) and isinstance(second, RecursiveFilter)):
            others = []  # of filters of some rows of z each
        if not all(same(one, other) for other in others):
            checks.refuse("second", f"a filter of the same {what} as the first", "one of others")


def _leaves(estimator):
    """Return the filters that a filter is made of in the end."""
    parts = getattr(estimator, "filters", ())
    parts += tuple(vars(estimator)[name] for name in ("first", "second", "estimator") if name in vars(estimator))
    return [leaf for part in parts for leaf in _leaves(part)] or [estimator]


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
