"""The base classes of all filters: what users call, and what the rest of the package calls.

Users call `filter`, `estimates`, `covariances`, `smooth` and `step`. Metrics, bands, and filters made of filters call

- `as_tracks(z)`: checks z and reshapes it to (N, m, M);
- `run(z, x, covariances)`: writes the estimates to x, and returns the covariances if they are wanted;
- `innovations_of(z)`: the innovations and their covariances;
- `epochs_of(z)`: z with the time steps and variances of its epochs; `times_of(N)`: the times of the epochs in s;
- `subfilters`: the filters that a filter combines; `elementary_filters`: the leaves of that tree.

Their covariances are (N, n, n, M), or (N, n, n, 1) where all tracks share them.

A `RecursiveFilter` defines `next_step`: A_k, B_k and P of one step. The engine runs it over tracks, as described in
`_engine/__init__.py`. The general `advance` calls `next_step` for each track; KalmanFilter has a faster one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from inspect import signature
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from . import _checks as checks
from ._checks import Array, Seconds
from ._engine.columns import Epochs, LinearMap, Motion, whitened
from ._engine.diffuse import DIFFUSE_S, LARGEST_S, observability_rows
from ._engine.run import (
    MOST_ROUNDING_OF_S,
    in_tiles,
    is_rounded_away,
    observability_of,
    run_estimates,
    run_innovations,
)
from ._engine.shared import Step, make_shared_steps, steps_without_gaps
from ._engine.smoother import smoothed
from ._immutable import Immutable, types_as_written
from .equations import corrected_covariance, predicted_covariance
from .model import LinearModel

# The largest fraction of a variance that may be rounding error after a single step.
MOST_ROUNDING = 0.1


@types_as_written
class Estimates(NamedTuple):
    """The states of all epochs and their covariances. Its repr shows their shapes.

    Attributes
    ----------
    x : ndarray (N, n) or (N, n, M)
        The states.
    P : ndarray (N, n, n) or (N, n, n, M)
        Their covariances.

    """

    x: Array
    P: Array

    def __repr__(self) -> str:
        return f"Estimates(x {self.x.shape}, P {self.P.shape})"


def one_or_many(values: Array, covariances: Array, many: bool) -> tuple[Array, Array]:
    """Return values (N, d, M) and covariances (N, d, d, M or 1) without the axis of tracks, if there is one track.

    Otherwise the covariances are repeated for each track that shares them.
    """
    if not many:
        return values[..., 0], covariances[..., 0]
    M = values.shape[2]
    return values, covariances if covariances.shape[3] == M else np.repeat(covariances, M, axis=3)


class Filter(Immutable):
    """A filter for measurements z of its `model`. A subclass defines `run`, and what else it supports.

    t and r are the times and variances that it was given, or None.
    """

    model: LinearModel
    t: Array | None = None
    r: Array | None = None

    @property
    def subfilters(self) -> Sequence[Filter]:
        """The filters that this one combines; empty except for joint and separate filters and predictors."""
        return ()

    @property
    def optimal(self) -> bool:
        """Whether the gain, in every subfilter, is the Kalman gain for P, so that P is the covariance of the error."""
        return bool(self.subfilters) and all(each.optimal for each in self.subfilters)

    @property
    def steps_ahead(self) -> int:
        """The number of steps from the last measurement used to the state that is estimated."""
        return self.subfilters[0].steps_ahead if self.subfilters else 0

    @property
    def P0(self) -> Array:
        """The covariance P(0/0) (n, n) that the filter starts from; predictors and FIR filters raise TypeError."""
        raise self._not_recursive()

    def filter(self, z: ArrayLike) -> Array:
        """Return the estimates x(1/1) ... x(N/N) of all epochs.

        Parameters
        ----------
        z : array_like (N, m) or (N, m, M)
            Measurements of one track, or of M tracks; NaN where one is missing. Row 0 is z(1). One sensor may give a
            series (N,).

        Returns
        -------
        ndarray (N, n) or (N, n, M)
            Row k is x(k+1/k+1), given the measurements up to row k of z.

        Raises
        ------
        ValueError
            For another shape, for infinite measurements, and where covariances overflow or lose all their digits.
        TypeError
            For anything but real numbers.

        """
        z, many = self.as_tracks(z)
        x = np.empty((len(z), self.model.n, z.shape[2]))
        with np.errstate(invalid="ignore"):  # NaN times zero
            self.run(z, x, covariances=False)
        if not np.isfinite(x[-1]).all():  # an infinite measurement shows to the end, so z is searched only now
            checks.no_infinity(z)
        return x if many else x[..., 0]

    def estimates(self, z: ArrayLike) -> Estimates:
        """Return the estimates of all epochs and their covariances, in one pass.

        Parameters
        ----------
        z : array_like (N, m) or (N, m, M)
            Measurements as for `filter`.

        Returns
        -------
        Estimates
            x(k/k) as `x`, (N, n) or (N, n, M), and P(k/k) as `P`, (N, n, n) or (N, n, n, M).

        Raises
        ------
        ValueError, TypeError
            As `filter`; TypeError also for a filter without covariances.

        """

        def of_tracks(z):
            x = np.empty((len(z), self.model.n, z.shape[2]))
            return x, self.run(z, x, covariances=True)

        return self._as_given(z, of_tracks)

    def covariances(self, z: ArrayLike) -> Array:
        """Return the covariances P(1/1) ... P(N/N): they depend on which measurements are missing, not on their values.

        Parameters
        ----------
        z : array_like (N, m) or (N, m, M), or int
            Measurements as for `filter`, or a number of epochs N in which nothing is missing.

        Returns
        -------
        ndarray (N, n, n) or (N, n, n, M)
            Row k is P(k+1/k+1).

        Raises
        ------
        ValueError, TypeError
            As `estimates`.

        """
        if np.ndim(z) == 0:
            z = np.zeros((checks.count("N", z), self.model.m))
        return self.estimates(z).P

    def smooth(self, z: ArrayLike) -> Estimates:
        """Return the states of all epochs given all measurements, and their covariances.

        This is the Rauch-Tung-Striebel smoother (1965), with P(k/N) in Joseph's form:

            x(k/N) = C_k x(k+1/N) + (I - C_k F) x(k/k),   C_k = P(k/k) Fᵀ P(k+1/k)⁻¹

        Parameters
        ----------
        z : array_like (N, m) or (N, m, M)
            Measurements as for `filter`.

        Returns
        -------
        Estimates
            x(k/N) as `x`, (N, n) or (N, n, M), and P(k/N) as `P`, (N, n, n) or (N, n, n, M).

        Raises
        ------
        ValueError
            As `estimates`, and where a diffuse start or a long pause leaves no digits of the smoothed states.
        TypeError
            For a filter whose gain is not the Kalman gain for its P (constant gain, or a step of the user's own), a
            predictor, and a FIR filter.

        Warns
        -----
        UserWarning
            Where damped modes without process noise make P(k/N) inaccurate.

        """
        raise self._not_recursive("smooth")

    def step(
        self, x: ArrayLike, P: ArrayLike, z_k: ArrayLike, dt: Seconds | None = None, r: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Return x(k+1/k+1) and P(k+1/k+1) from x(k/k), P(k/k) and one measurement z(k+1).

        Parameters
        ----------
        x, P : array_like (n,), (n, n)
            Estimate and covariance; at the start `model.x0` and `P0`.
        z_k : array_like (m,)
            The measurement, NaN where a component is missing.
        dt : float or timedelta, optional
            Time since x(k/k) in s, for a KalmanFilter of a model with a transition; one with times needs it.
        r : array_like (m,), optional
            Variances of the measurement in place of the model's R, for a KalmanFilter; one with variances needs them.

        Returns
        -------
        x : ndarray (n,)
            The estimate x(k+1/k+1).
        P : ndarray (n, n)
            Its covariance P(k+1/k+1).

        Raises
        ------
        ValueError
            For other shapes, for numbers that are not finite, for a P that is not a covariance, and for a P or dt so
            large that the step exceeds double precision.
        TypeError
            For anything but real numbers, for a filter without steps (a predictor, a FIR filter), and for dt or r where
            the filter is not a KalmanFilter.

        Examples
        --------
        >>> import mpt_helpers as mpt
        >>> kf = mpt.KalmanFilter(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1, P0=np.eye(2)))
        >>> x, P = kf.step(kf.model.x0, kf.P0, [1.0])
        >>> x, P = kf.step(x, P, [2.5], dt=1.5)
        >>> x.round(2)
        array([2.45, 0.94])

        """
        raise self._not_recursive("step")

    @property
    def elementary_filters(self) -> list[Filter]:
        """The filters at the bottom of the tree of `subfilters`; the filter itself where it has none."""
        return [each for part in self.subfilters for each in part.elementary_filters] or [self]

    def times_of(self, N: int) -> Array:
        """Return the times of N epochs in s: t, (N,) or (N, M), or the steps of the model's dt from 0, (N,).

        t is that of the filter, or of the first of its subfilters that has one. A model without a dt has steps of 1 s.
        """
        given = [each.t for each in self.elementary_filters if each.t is not None]
        if given:
            return given[0]
        return (1.0 if self.model.dt is None else self.model.dt) * np.arange(N)

    def epochs_of(self, z: Array) -> Epochs:
        """Return z (N, m, M) with its time steps and variances; raises ValueError where their number differs."""
        return Epochs(z, self.motion)

    @cached_property
    def motion(self) -> Motion:
        """The model's prediction on columns, x <- F x and P <- F P Fᵀ + Q."""
        return Motion(self.model.F, self.model.Q)

    @cached_property
    def measurement(self) -> LinearMap:
        """The expected measurement H x and its covariance H P Hᵀ on columns."""
        return LinearMap(self.model.H)

    def run(self, z: Array, x: Array, covariances: bool) -> Array | None:
        """Write the estimates of z (N, m, M) to x (N, n, M), and return their covariances if wanted, else None.

        Raises TypeError where they are wanted of a filter that has none.
        """
        raise NotImplementedError

    def innovations_of(self, z: Array) -> tuple[Array, Array]:
        """Return the innovations of z (N, m, M), NaN where z is NaN, and S, (N, m, m, M) or (N, m, m, 1).

        Raises TypeError for a filter that has none.
        """
        raise self._not_recursive()

    def as_tracks(self, z: ArrayLike) -> tuple[Array, bool]:
        """Return z as (N, m, M), and whether it had an axis of tracks; raises for other shapes and types."""
        z = checks.measurements(z, self.model.m)
        return (z, True) if z.ndim == 3 else (z[..., None], False)

    def _as_given(self, z, function):
        """Return the Estimates function(z (N, m, M)), with an axis of tracks only if z has one."""
        z, many = self.as_tracks(z)
        checks.no_infinity(z)
        return Estimates(*one_or_many(*function(z), many))

    def __repr__(self) -> str:
        """One line: the kind, and the sizes of the model."""
        given = "".join(f", {name}" for name in ("t", "r") if getattr(self, name) is not None)
        n, m = self.model.n, self.model.m
        return f"<{type(self).__name__}: {n} state{'s' * (n > 1)}, {m} measurement{'s' * (m > 1)}{given}>"

    if not TYPE_CHECKING:  # a type checker would take every name for one that is there

        def __getattr__(self, name: str) -> Any:
            """Name `step` where filterpy's `predict` or `update` is asked for. This runs only where no such name is."""
            hint = "; step(x, P, z_k) predicts and updates" if name in ("predict", "update") else ""
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}{hint}", name=name, obj=self)

    def _not_recursive(self, name: str = "estimator") -> TypeError:
        return TypeError(f"{name}: needs a filter with P0, covariances and step, got a {type(self).__name__}")


@dataclass(frozen=True, eq=False, repr=False)
class RecursiveFilter(Filter):
    """A filter with coefficients and a covariance. A subclass defines `next_step`; all else follows from it.

    A subclass may add faster versions, `next_steps` and `advance`. They are inherited only together with `next_step`:
    a subclass that overrides `next_step` alone falls back to the general ones, which call it.

    Parameters
    ----------
    model : LinearModel
        The model of motion and measurements.

    Examples
    --------
    >>> import mpt_helpers as mpt
    >>> class Doubting(mpt.RecursiveFilter):
    ...     def next_step(self, P, seen):
    ...         A, B, P = mpt.KalmanFilter(self.model).next_step(P, seen)
    ...         return A, B, 1.2 * P  # less sure than the Kalman filter, so that old measurements count less
    >>> Doubting(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1, P0=np.eye(2))).filter([[1.0], [2.0], [4.0]]).round(2)
    array([[0.95, 0.48],
           [1.94, 0.89],
           [3.79, 1.44]])

    """

    model: LinearModel

    # True in a class whose gain is the Kalman gain for its P. Only its tracks can be smoothed.
    optimal: ClassVar[bool] = False

    def __init_subclass__(cls) -> None:
        """Restore the general methods where a subclass overrides `next_step` but not its faster versions."""
        super().__init_subclass__()
        for name in ("next_steps", "advance", "optimal"):
            if cls.__mro__.index(_owner(cls, "next_step")) < cls.__mro__.index(_owner(cls, name)):
                setattr(cls, name, vars(RecursiveFilter)[name])

    def __post_init__(self) -> None:
        checks.instance("model", self.model, LinearModel)

    @property
    def P0(self) -> Array:
        """P(0/0), the initial covariance: the model's."""
        return self.model.P0

    def next_step(self, P: Array, seen: np.ndarray) -> tuple[Array, Array, Array]:
        """Return A_k, B_k and P(k+1/k+1) from P(k/k).

        Parameters
        ----------
        P : ndarray (n, n)
            The covariance P(k/k).
        seen : ndarray (m,) of bool
            Which measurements are available.

        Returns
        -------
        A : ndarray (n, n)
            The coefficient of x(k/k) in x(k+1/k+1) = A x(k/k) + B z(k+1).
        B : ndarray (n, m)
            The coefficient of z(k+1).
        P : ndarray (n, n)
            The covariance P(k+1/k+1).

        """
        raise NotImplementedError

    def next_steps(self, P: Array, seen: np.ndarray) -> tuple[Array, Array, Array]:
        """Return A_k (M, n, n), B_k (M, n, m) and P(k+1/k+1) (M, n, n) of each P(k/k) of a stack (M, n, n).

        This calls `next_step` for each. A subclass may compute all of them at once.
        """
        A, B, P = zip(*(self.next_step(each, seen) for each in P), strict=True)
        return np.array(A), np.array(B), np.array(P)

    def advance(self, row: tuple[Any, ...], x: Array, P: Array) -> tuple[Array, Array, Array]:
        """Return x(k+1/k+1), P(k+1/k+1) and the innovations of one row of many tracks.

        A subclass may override it by a faster version. To take times or variances, one with a `next_step` of its own
        has to.

        Parameters
        ----------
        row : tuple
            z (m, c, W), zero where missing; seen (m, W), False where missing; F and Q (n, n, W) and r (m, W), or None
            where they are the model's. Each of W columns has c tracks with one P (see `_engine.columns`).
        x, P : ndarray (n, c, W), (n, n, W)
            The states and covariances before the row, which are not modified.

        Returns
        -------
        x, P : ndarray (n, c, W), (n, n, W)
            The states and covariances after it. x is linear in x and z, and P depends on neither.
        innovations : ndarray (m, c, W)
            White, of unit variance, and zero where missing; (0, c, W) of a filter that is not `optimal`.

        """
        z, seen, F, _, r = row
        if F is not None or r is not None:
            name = "r" if F is None else "t"
            need = f"an `advance` of {type(self).__name__}, as its `next_step` is not given the {name} of a row"
            checks.refuse(name, need, "that of RecursiveFilter, which tells how to write one")
        innovations = x[:0]
        if self.optimal:
            expected, S = self.measurement(*self.motion(x, P))
            S += self.model.R[..., None]
            innovations, _ = whitened(np.where(seen[:, None], z - expected, np.nan), S[:, :, None])
        x, P, z = (np.moveaxis(each, 2, 0).copy() for each in (x, P, z))  # stacks of matrices
        for which in np.unique(seen, axis=1).T:
            columns = np.flatnonzero((which == seen.T).all(axis=1))
            A, B, P[columns] = self.next_steps(P[columns], which)
            x[columns] = A @ x[columns] + B @ z[columns]
        return np.moveaxis(x, 0, 2), np.moveaxis(P, 0, 2), innovations

    @cached_property
    def observability(self) -> Array:
        """The `observability_rows` of the model, cached: they take a third of a short track's time."""
        return observability_rows(self.model.F, self.model.Q, self.model.H, self.model.R)

    def coefficients(self, N: int) -> Step:
        """Return the coefficients of steps 1 to N with nothing missing.

        Parameters
        ----------
        N : int
            Number of steps.

        Returns
        -------
        A : ndarray (N, n, n)
            A_k of each step.
        B : ndarray (N, n, m)
            B_k of each step.
        P : ndarray (N, n, n)
            P(k/k) after each step.

        Raises
        ------
        ValueError
            For a filter with times or variances: each of its epochs has a `next_step` of its own.

        """
        if self.t is not None or self.r is not None:
            name, got = ("r", "variances") if self.t is None else ("t", "times")
            checks.refuse(name, "to be left out, as coefficients are those of equal steps and of the model's R", got)
        each = steps_without_gaps(self.next_step, self.P0, self.model.m, checks.count("N", N))
        return Step(*map(np.array, zip(*each, strict=True)))

    def step(
        self, x: ArrayLike, P: ArrayLike, z_k: ArrayLike, dt: Seconds | None = None, r: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        if dt is None and self.t is not None:
            checks.refuse("dt", "the time since x, as the filter has times", "none")
        if r is None and self.r is not None:
            checks.refuse("r", "the variances of z_k, as the filter has them for each epoch", "none")
        x, P = checks.state(x, P, self.model.n)
        z_k, seen = checks.one_measurement(z_k, self.model.m)
        conditions = {}
        if dt is not None:
            conditions["dt"] = checks.not_negative("dt", checks.as_seconds(dt))
        if r is not None:
            conditions["r"] = checks.variances_of_one("r", r, seen)
        for name in conditions:
            if name not in self._arguments_of_next_step:
                need = "a filter whose `next_step` takes it, such as KalmanFilter"
                checks.refuse(name, need, f"a {type(self).__name__}", TypeError)
        with np.errstate(over="ignore", invalid="ignore"):  # a dt that is too long overflows, and is refused
            A, B, P = self.next_step(P, seen, **conditions)
        return A @ x + B @ np.where(seen, z_k, 0), P

    @cached_property
    def _arguments_of_next_step(self):
        return signature(self.next_step).parameters.keys()

    def smooth(self, z: ArrayLike) -> Estimates:
        if not self.optimal:
            raise TypeError(f"smooth: needs a filter of optimal gain, got a {type(self).__name__}")
        return self._as_given(z, lambda z: in_tiles(smoothed, self, self.epochs_of(z), self.model.n))

    def run(self, z: Array, x: Array, covariances: bool) -> Array | None:
        """Write the estimates to x and return the covariances if wanted, as in Filter."""
        epochs = self.epochs_of(z)
        return run_estimates(self, epochs, x, covariances, observability_of(self, epochs))

    def innovations_of(self, z: Array) -> tuple[Array, Array]:
        """Return the innovations and their covariances, as in Filter; refused where P is not predicted by the model."""
        if not self.optimal:
            self._require_prediction_by_model()
        return in_tiles(run_innovations, self, self.epochs_of(z), self.model.m)

    def _require_prediction_by_model(self):
        """Raise a ValueError where P does not follow from the gain and F P Fᵀ + Q: S would be another filter's."""
        model, seen = self.model, np.ones(self.model.m, bool)
        _, _, P = self.next_step(self.P0, seen)
        A, K, after = self.next_step(P, seen)
        expected = corrected_covariance(predicted_covariance(model, P), K, model.H, model.R)
        sigma, size = np.sqrt(np.abs(expected.diagonal())), np.abs(A) @ np.sqrt(np.abs(P.diagonal()))
        rounding = model.n * np.finfo(float).eps * size * size[:, None]
        if (np.abs(after - expected) > checks.SOLVED * sigma * sigma[:, None] + rounding).any():
            need = "a filter whose P follows from its gain and the model's prediction F P Fᵀ + Q, of which S is made"
            checks.refuse("estimator", need, f"a {type(self).__name__} that predicts P otherwise")

    @cached_property
    def shared_steps(self) -> Callable[[int, int], Any]:
        """`make_shared_steps` of this filter, as a function of N and M that caches its last result."""
        return lru_cache(maxsize=1)(partial(make_shared_steps, self.next_step, self.P0, self.model.m))


def _owner(cls, name):
    """Return the class from which cls takes an attribute."""
    return next(each for each in cls.__mro__ if name in vars(each))


def may_be_diffuse(P, H):
    """Tell, by a bound that takes little time, whether H P Hᵀ may have a variance above DIFFUSE_S."""
    return not np.vdot(H, H) * sum(P.diagonal().tolist()) < DIFFUSE_S


def require_digits(T_1, T_2, P, after, H, S, dt=None):
    """Raise a ValueError if a step leaves no digit in a variance `after` it, or less than two in an S (p,).

    The step is x <- T_1 T_2 x + B z, and T_1 T_2 P (T_1 T_2)ᵀ is one term of the covariance `after` it (n, n). S are
    the variances of measurements with unit noise, and H P Hᵀ (p, p) is one term of theirs. Doubles round P_ij by
    ε σ_i σ_j, and so these terms by up to ε (|T_1| |T_2| σ)² and ε (|H| σ)². The error names dt where it is given.
    """
    if not may_be_diffuse(P, H) and math.isfinite(np.vdot(after, after)):
        return
    sigma = np.sqrt(np.abs(P.diagonal()))
    largest_S = (np.abs(H) @ sigma) ** 2
    finite = np.isfinite(after).all()
    if largest_S.max() < DIFFUSE_S and finite:
        return
    largest_P = (np.abs(T_1) @ np.abs(T_2) @ sigma) ** 2
    P_is_right = not is_rounded_away(largest_P, after.diagonal(), MOST_ROUNDING)
    S_is_right = not is_rounded_away(largest_S, S, MOST_ROUNDING_OF_S)
    if S.max() < LARGEST_S and finite and P_is_right and S_is_right:
        return
    if dt is not None:
        checks.refuse("dt", "a time over which the prediction keeps digits beside the measurement noise", f"{dt:.6g} s")
    need = "a covariance that keeps digits beside the measurement noise (filter and estimates take a larger P0)"
    checks.refuse("P", need, f"{largest_S.max():.2g} times the noise variance")
