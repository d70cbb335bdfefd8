"""What every filter offers, and how the recursive ones run: estimates, covariances, one step, and smoothing.

Whole tracks go one of two ways:

- Tracks without gaps, at steps of one length, share A_k, B_k and P. Where few of these differ, they are made once, by
  the filter's `next_step`, and `recursion.run` takes all tracks through several steps at a time.
- All others have conditions of their own, and are columns (`columns`); a long track is cut into pieces (`partition`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from . import checks
from .checks import Array
from .columns import Motion, Rows, product_for_covariances
from .model import Immutable, LinearModel
from .partition import MOST_TRACKS, through
from .recursion import TILE, TILE_OF_COVARIANCES, Step, epochs_at_a_time, lifted, run, tiles
from .smoothing import smoothed

# A filter makes and keeps at most so many different steps for tracks without gaps; where it has not converged by then,
# as one without process noise, columns are sooner done. On the models of 2014 to 2016 it converges within some 50.
MOST_STEPS = 256
# The same for at most MOST_TRACKS tracks: as columns these are cut into pieces, and sooner done. Measured.
MOST_STEPS_OF_FEW = 64
# A filter of n states has converged when no P_ij moves by more than this times n σ_i σ_j, the rounding of doubles.
CONVERGED = 2e-16
# Numbers in the covariances of a tile of tracks whose innovations are computed together: 32 MB.
MOST_NUMBERS = 4_000_000


class Estimates(NamedTuple):
    """States x, (N, n) or (N, n, M), and their covariances P, (N, n, n) or (N, n, n, M)."""

    x: Array
    P: Array


class SharedSteps(NamedTuple):
    """The Steps of tracks without gaps, and the products of several of them that `recursion.run` takes."""

    steps: list
    products: list


class Filter(Immutable):
    """A filter of measurements z of its `model`.

    A subclass defines `_fill(x, z)`, and, where its estimates have covariances, `P0`, `_estimates(z)` and
    `_innovations(z)`. There z is (N, m, M), and a P is (N, n, n, 1) where all tracks share it.
    """

    model: LinearModel
    optimal = False  # whether its gain is that of the covariance P, so that P says all that is known
    steps_ahead = 0  # how far an estimate lies past its last measurement: 0, or N in a predictor

    @property
    def P0(self) -> Array:
        """P(0/0); raises TypeError for a filter that has none, a predictor or a FIR filter."""
        raise self._not_recursive()

    def filter(self, z: ArrayLike) -> Array:
        """Return the estimates x(1/1) ... x(N/N): (N, n) for z of shape (N, m), (N, n, M) for z of shape (N, m, M).

        z[0] is z(1), NaN where a measurement is missing. Raises ValueError or TypeError for another shape, another kind
        of data, infinite values, and for gaps over which covariances overflow or rounding takes a variance below zero.
        """
        z, many = self._as_tracks(z)
        x = np.empty((len(z), self.model.n, z.shape[2]))
        with np.errstate(invalid="ignore"):  # NaN times zero
            self._fill(x, z)
        if not np.isfinite(x[-1]).all():  # an infinite measurement shows to the end, so z is searched only now
            checks.no_infinity(z)
        return x if many else x[..., 0]

    def estimates(self, z: ArrayLike) -> Estimates:
        """Return x(1/1) ... x(N/N) and their covariances P(1/1) ... P(N/N) in one pass: `.x` and `.P`.

        x is (N, n) and P (N, n, n) for z of shape (N, m); (N, n, M) and (N, n, n, M) for z of shape (N, m, M). Raises
        as `filter`, and TypeError for a filter that has no covariances.
        """
        return self._as_given(z, self._estimates)

    def covariances(self, z: ArrayLike) -> Array:
        """Return P(1/1) ... P(N/N) for the gaps that z has: (N, n, n) for z (N, m), (N, n, n, M) for z (N, m, M).

        With an integer N for z, nothing is missing. Raises as `estimates`.
        """
        if np.ndim(z) == 0:
            z = np.zeros((checks.count("N", z), self.model.m))
        return self.estimates(z).P

    def epochs(self, z: Array) -> Iterator[tuple[Array, Array]]:
        """Yield x(k/k) (n, M) and P(k/k), (n, n, 1) or (n, n, M), for k = 1 ... N of tracks z (N, m, M).

        P is (n, n, 1) where all tracks share it. Raises TypeError for a filter that has no covariances.
        """
        raise self._not_recursive()

    def smooth(self, z: ArrayLike) -> Estimates:
        """Return the states and covariances of all epochs given all of z; raises TypeError where there are none."""
        raise self._not_recursive()

    def step(self, x: ArrayLike, P: ArrayLike, z_k: ArrayLike) -> tuple[Array, Array]:
        """Return x(k+1/k+1) and P(k+1/k+1); raises TypeError for a filter that has no step."""
        raise self._not_recursive()

    def _fill(self, x, z):
        """Write the estimates of z (N, m, M) to x (N, n, M)."""
        raise NotImplementedError

    def _estimates(self, z):
        """Return the estimates of z (N, m, M), (N, n, M), and their covariances, (N, n, n, M) or (N, n, n, 1)."""
        raise self._not_recursive()

    def _innovations(self, z):
        """Return the innovations of z (N, m, M), NaN where z has NaN, and S, (N, m, m, M) or (N, m, m, 1)."""
        raise self._not_recursive()

    def _as_given(self, z, function):
        """Return the Estimates that function(z (N, m, M)) returns, for one track or many, as z was given."""
        z, many = self._as_tracks(z)
        checks.no_infinity(z)
        x, P = function(z)
        if not many:
            return Estimates(x[..., 0], P[..., 0])
        return Estimates(x, P if P.shape[3] == z.shape[2] else np.repeat(P, z.shape[2], axis=3))

    def _as_tracks(self, z):
        """Return checked measurements as (N, m, M), and whether they came with an axis of tracks."""
        z = checks.measurements(z, self.model.m)
        return (z, True) if z.ndim == 3 else (z[..., None], False)

    def _not_recursive(self):
        return TypeError(f"needs a filter with P0, epochs and step, got a {type(self).__name__}")


@dataclass(frozen=True, eq=False)
class RecursiveFilter(Filter):
    """A filter with coefficients and a covariance.

    A subclass defines `next_step(P, seen)`: the Step from P(k/k) to epoch k+1, where seen (m,) says which measurements
    are there; and `_in_columns(rows)`, the same for columns.
    """

    model: LinearModel

    optimal = True

    def __post_init__(self):
        checks.instance("model", self.model, LinearModel)

    @property
    def P0(self) -> Array:
        """P(0/0), the covariance that the filter starts from: the model's."""
        return self.model.P0

    def coefficients(self, N: int) -> Step:
        """Return A (N, n, n), B (N, n, m) and the covariance P (N, n, n) of steps 1 to N with nothing missing."""
        return Step(*map(np.array, zip(*self._steps(checks.count("N", N)), strict=True)))

    def step(self, x: ArrayLike, P: ArrayLike, z_k: ArrayLike) -> tuple[Array, Array]:
        """Return x(k+1/k+1) and P(k+1/k+1) from x(k/k) (n,), P(k/k) (n, n) and one measurement z(k+1) (m,).

        NaN stands for a missing measurement. The start is `model.x0` and `P0`. Raises ValueError or TypeError for other
        shapes, and for states and covariances that are not finite.
        """
        x, P = one_state(x, P, self.model.n)
        z_k, seen = one_measurement(z_k, self.model.m)
        A, B, P = self.next_step(P, seen)
        return A @ x + B @ np.where(seen, z_k, 0), P

    def epochs(self, z: Array) -> Iterator[tuple[Array, Array]]:
        """Yield x(k/k) and P(k/k) as in Filter, for tracks of any length in little memory."""
        checks.no_infinity(z)
        self._require_conditions_of(z)
        shared = _alike(z, *self._conditions)
        columns, rows, x, P = self._in_columns(_rows(z, *self._conditions, shared))
        n = self.model.n
        for row in rows:
            x, P, _ = columns.advance(row, x, P)
            yield (x[:n, :, 0] if shared else x[:n, 0]), P[:n, :n]

    def smooth(self, z: ArrayLike) -> Estimates:
        """Return x(k/N) and P(k/N) of k = 1 ... N, the states given all measurements: `.x` and `.P`.

        The shapes are those of `estimates`. It is the papers' recursion run backwards (Rauch, Tung and Striebel 1965):

            x(k/N) = C_k x(k+1/N) + (I - C_k F) x(k/k),   C_k = P(k/k) Fᵀ P(k+1/k)⁻¹

        with P(k/N) in Joseph's form. Raises as `estimates`, and TypeError for a filter of constant gain: its P is not
        that of the best estimate. Warns of damped modes without process noise, whose P(k/N) loses its digits.
        """
        if not self.optimal:
            raise TypeError(f"smooth: needs a filter whose gain follows its covariance, got a {type(self).__name__}")
        return self._as_given(z, self._smoothed)

    @property
    def _epochs_are_alike(self):
        """Say whether all epochs of tracks without gaps have the same conditions."""
        return True

    @property
    def _motion(self):
        return Motion(self.model.F, self.model.Q)

    @property
    def _conditions(self):
        """The lengths of the steps (N, M or 1) and the variances (N, m, M or 1), or None where all are alike."""
        return None, None

    def _of_tracks(self, part):
        """Return the filter of some of the tracks that the times and variances are of."""
        return self

    def _in_columns(self, rows):
        """Return what advances the filter on columns, its rows, x(0/0) (n, c, M) and P(0/0) (n, n, M).

        There may be more states than the model's, after these.
        """
        raise NotImplementedError

    def _require_conditions_of(self, z):
        """Raise a ValueError where the times or variances of the filter are not those of z (N, m, M)."""

    def _fill(self, x, z):
        self._require_conditions_of(z)
        steps = self._shared_steps(len(z), z.shape[2])
        if steps is None:
            self._fill_from_columns(x, None, z)
            return
        # Filter every track as if it had no gaps. One whose last estimate is NaN had some: filter it again, as columns.
        run(steps.products, self.model.x0[:, None], z, x)
        gaps = np.isnan(x[-1]).any(axis=0)
        if gaps.all():
            self._fill_from_columns(x, None, z)
        elif gaps.any():
            tracks = np.flatnonzero(gaps)
            part = np.empty((*x.shape[:2], len(tracks)))
            self._fill_from_columns(part, None, z[..., tracks])
            x[..., tracks] = part

    def _estimates(self, z):
        self._require_conditions_of(z)
        (N, _, M), n = z.shape, self.model.n
        x = np.empty((N, n, M))
        steps = None if np.isnan(z).any() else self._shared_steps(N, M)
        if steps is not None:
            run(steps.products, self.model.x0[:, None], z, x)
            P = np.array([step.P for step in steps.steps])[..., None]
            if not np.isfinite(P[-1]).all():
                _refuse_overflow()
        else:
            P = np.empty((N, n, n, 1 if _alike(z, *self._conditions) else M))
            self._fill_from_columns(x, P, z)
        return x, P

    def _innovations(self, z):
        return self._in_tiles(type(self)._innovations_of_tile, z, self.model.m)

    def _smoothed(self, z):
        return self._in_tiles(type(self)._smoothed_tile, z, self.model.n)

    def _in_tiles(self, function, z, d):
        """Return function(filter, z): values (N, d, M) and covariances (N, d, d, M or 1), so many tracks at a time."""
        self._require_conditions_of(z)
        N, _, M = z.shape
        parts = tiles(M, max(1, MOST_NUMBERS // (N * self.model.n**2)))
        if len(parts) == 1:
            return function(self, z)
        values, covariances = np.empty((N, d, M)), np.empty((N, d, d, M))
        for part in parts:
            values[..., part], covariances[..., part] = function(self._of_tracks(part), z[..., part])
        return values, covariances

    def _innovations_of_tile(self, z):
        (N, m, M), n, H = z.shape, self.model.n, self.model.H
        x, P = self._estimates(z)
        lengths, variances = self._conditions
        motion, W = self._motion, product_for_covariances(H)
        values, S = np.empty((N, m, M)), np.empty((N, m, m, P.shape[3]))
        for part in epochs_at_a_time(N, n * max(n * P.shape[3], M)):
            # Axes: states, epochs, tracks. The states are those before the measurements.
            x_part = np.moveaxis(_before(x, self.model.x0, part), 1, 0)
            P_part = np.moveaxis(_before(P, self.P0, part), 0, 2)
            lengths_part = None if lengths is None else lengths[part]
            expected = H @ motion.state(x_part, lengths_part).reshape(n, -1)
            P_part = motion.covariance(P_part, lengths_part)
            S_part = (W @ P_part.reshape(n * n, -1)).reshape(m, m, *P_part.shape[2:])
            values[part] = z[part] - np.moveaxis(expected.reshape(m, *x_part.shape[1:]), 0, 1)
            S[part] = np.moveaxis(S_part, 2, 0)
        if variances is None:
            return values, S + self.model.R[..., None]
        return values, S + known_variances(variances, self.model.R)[:, :, None] * np.eye(m)[..., None]

    def _smoothed_tile(self, z):
        lengths, _ = self._conditions
        return smoothed(self._motion, lengths, *self._estimates(z))

    def _fill_from_columns(self, x, P, z):
        """Write the estimates of z to x, and the covariances to P (N, n, n, M or 1) unless it is None."""
        lengths, variances = self._conditions
        shared = _alike(z, lengths, variances)
        for part in tiles(z.shape[2], TILE if shared else TILE_OF_COVARIANCES):
            rows = _rows(z[..., part], _of(lengths, part), _of(variances, part), shared)
            columns, rows, x_0, P_0 = self._in_columns(rows)
            x_part = np.expand_dims(x[..., part], 3 if shared else 2)
            P_part = P if P is None or shared else P[..., part]
            last, least = through(columns.advance, rows, x_0, P_0, x_part, P_part)
            if least < 0:
                need = "gaps and a start beside which doubles hold the variances of the measurements"
                checks.refuse("z", need, "a variance below zero")
            if not np.isfinite(last).all():
                _refuse_overflow()

    def _shared_steps(self, N, tracks):
        """Return the SharedSteps of tracks without gaps, or None where epochs or too many of their Steps differ.

        They are kept for the next call, often one for the same numbers.
        """
        if not self._epochs_are_alike:
            return None
        kept_for, kept = vars(self).get("_kept_steps", (None, None))
        if kept_for != (N, tracks):
            most = MOST_STEPS if tracks > MOST_TRACKS else MOST_STEPS_OF_FEW
            first = list(self._steps(min(N, most)))
            steps = first + first[-1:] * (N - len(first))
            converged = most >= N or first[-1] is first[-2]
            kept = SharedSteps(steps, lifted(steps, tracks)) if converged else None
            vars(self)["_kept_steps"] = (N, tracks), kept
        return kept

    def _steps(self, N):
        """Yield the Steps of N epochs without gaps. A filter that has converged repeats one object."""
        P, converged, seen = self.P0, False, np.ones(self.model.m, bool)
        for _ in range(N):
            if not converged:
                step = Step(*self.next_step(P, seen))
                for array in step:
                    array.flags.writeable = False
                converged = _has_not_moved(P, step.P)
                P = step.P
            yield step


def known_variances(variances, R):
    """Return variances (N, m, M), those of R (m, m) where there are none: a measurement that is missing needs none."""
    known = np.isfinite(variances) & (variances > 0)
    return np.where(known, variances, np.diag(R)[:, None])


def _alike(z, lengths, variances):
    """Tell whether all tracks of z (N, m, M) have the same gaps, steps and variances: one covariance for all."""
    missing = np.isnan(z)
    widths = [array.shape[-1] for array in (lengths, variances) if array is not None]
    return all(width == 1 for width in widths) and bool((missing == missing[..., :1]).all())


def _rows(z, lengths, variances, shared):
    """Return the Rows of z (N, m, M): one column of M tracks where they share their conditions, else M columns."""
    seen = ~np.isnan(z)
    z = np.where(seen, z, 0)
    if variances is not None:  # those of missing measurements may be invalid
        variances = np.where(seen[..., :1] if shared else seen, variances, 1)
    if shared:
        return Rows(z[..., None], seen[..., :1], lengths, variances)
    N, _, M = z.shape
    return Rows(z[:, :, None], seen, None if lengths is None else np.broadcast_to(lengths, (N, M)), variances)


def _of(array, part):
    """Return some of the tracks of conditions (..., M), or conditions (..., 1) and None as they are."""
    return array if array is None or array.shape[-1] == 1 else array[..., part]


def _before(array, start, part):
    """Return the rows of an array (N, ..., M) before those of a slice; the one before the first is start (...)."""
    if part.start > 0:
        return array[part.start - 1 : part.stop - 1]
    first = np.broadcast_to(start[None, ..., None], (1, *array.shape[1:]))
    return np.concatenate([first, array[: part.stop - 1]])


def _refuse_overflow():
    checks.refuse("z", "gaps over which the covariances stay within the range of doubles", "an overflow")


def _has_not_moved(before, after):
    sigma = np.sqrt(np.abs(np.diag(after)))
    return bool((np.abs(after - before) <= len(sigma) * CONVERGED * np.outer(sigma, sigma)).all())


def one_measurement(z_k, m):
    """Return z_k as a vector of floats of length m, and which of them are there, or raise."""
    need = f"a vector of length {m}"
    z_k = checks.real_numbers("z_k", z_k, need).astype(float)
    if z_k.shape != (m,):
        checks.refuse("z_k", need, f"shape {z_k.shape}")
    seen = np.isfinite(z_k)
    if not seen.all():
        checks.no_infinity(z_k, "z_k")
    return z_k, seen


def one_state(x, P, n):
    """Return x (n,) and P (n, n) as arrays of finite floats, or raise."""
    if np.shape(x) == (n,) and np.shape(P) == (n, n):
        x_array, P_array = np.asarray(x), np.asarray(P)
        if x_array.dtype == P_array.dtype == float and math.isfinite(x_array.sum() + P_array.sum()):
            return x_array, P_array
    return checks.array("x", x, (n,)), checks.array("P", P, (n, n))


def neutralised(H, R, seen):
    """Return H and R with zeros in H, and rows of the identity in R, for the measurements that seen (m,) lacks."""
    H = H * seen[:, None]
    R = np.where(np.outer(seen, seen), R, np.diag(~seen))
    return H, R
