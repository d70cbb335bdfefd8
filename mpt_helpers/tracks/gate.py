"""The faults among the fixes of a recorded track: one pass of a Kalman filter in sequence, which makes a mask.

A receiver errs in two ways that no filter expects. Single fixes, or a few in a row, lie far off; and the whole track
jumps, as when the signal comes back, and goes on from elsewhere. The gate tells one from the other:

1. A fix is refused if its NIS, its squared distance from what the filter predicts in units of what it expects, is above
   a limit. The filter goes on as if the fix were missing.
2. Refused fixes that follow one another and agree *with each other* begin a new piece, from the first of them.
3. Of these pieces the cheapest chain is kept. To drop a piece costs as many as it has fixes, a jump between two that
   are kept costs ten. Where the way between two pieces is no faster than the track usually is, there is no jump: the
   mobile has turned, and both are one piece.

The limit is far above what noise explains: a chi-square limit of 99.9 % would refuse a fifth of the good fixes of real
tracks, whose motion is calm and wild by turns. What is refused becomes NaN, and the fast filters take it for missing.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _checks as checks
from ..kalman import KalmanFilter
from ..lainiotis import LainiotisFilter

# Two pieces are joined, without a jump, where the way between them is at most so many times as fast as the fastest
# twentieth of all steps: between consecutive fixes of a clean track none was.
FASTER, OF_STEPS = 2.0, 0.95
# A fix that the filter expects belongs to a new start nevertheless, if that expects it so much better, in units of -2
# log of a probability density. At 0 good fixes are lost to new starts, at 20 the gate misses shifts on sparse tracks.
RARE = 5.0
# What a jump costs, in fixes: a piece of fewer fixes between two jumps is an outlier.
JUMP = 10
# A piece is charged for so many of its steps that are too fast, a jump each. A piece of more fixes than that costs, as
# a train ride within a walk, is never dropped for its speed.
MOST_TOO_FAST = 2
# A receiver without signal repeats its position, and jumps when the signal is back. So many fixes that stray by less
# than this part of the way from the piece before them to the one after them are taken for that.
STUCK, HARDLY = 3, 0.1
# The mobile has come to that place with at least this part of the speed at which it would have gone on.
ARRIVED = 0.5
# And it has gone on with at least this part of the speed with which it came: one that rests for long would crawl.
WENT_ON = 0.25
# A piece is tried after the ones that ended at most so many pieces before it. More in a row are never dropped.
LOOK_BACK = 30


def gated(kf: KalmanFilter, z: ArrayLike, limit: float = 100.0, patience: int = 3) -> NDArray[np.intp]:
    """Return the piece of each fix of a track, (N,): 0, 1, ... in order of time, and -1 where the fix is refused.

    kf is a Kalman or Lainiotis filter of any model, with its times and variances; z is (N, m), NaN where a measurement
    is missing. A row without measurements is no fix and gets -1 too. A row that is partly NaN is judged by the rest. A
    fix is refused where its NIS, of all its measurements together, is above `limit`; so many refused fixes in a row as
    `patience` says, which agree with each other, begin a new piece. Each piece is a track of its own, to be filtered
    from its own first fix: the first one starts from the model's x0 and P0, as `kf` does, the others from x0 and P0
    moved to their first fix.

    The rule was made on recorded tracks: see `gate`. It takes some 3 us a row for stacks of `constant_velocity` whose
    rows are not partly NaN, and some 30 us for others. Raises TypeError for another filter, as one of constant gain,
    and ValueError for many tracks and for a limit or a patience that is not positive.

    >>> from mpt_helpers.model import constant_velocity
    >>> kf = KalmanFilter(constant_velocity(dt=1.0, q=0.01, r=0.1, P0=[[1, 0], [0, 1]]))
    >>> z = np.arange(30.0)[:, None]
    >>> z[10] += 50  # one outlier
    >>> z[18:] += 200  # and a jump
    >>> gated(kf, z)
    array([ 0,  0,  0,  0,  0,  0,  0,  0,  0,  0, -1,  0,  0,  0,  0,  0,  0,
            0,  1,  1,  1,  1,  1,  1,  1,  1,  1,  1,  1,  1])
    """
    if not isinstance(kf, KalmanFilter | LainiotisFilter):
        checks.refuse("kf", "a KalmanFilter, whose gain follows its covariance", f"a {type(kf).__name__}", TypeError)
    z = checks.measurements(z, kf.model.m)
    if z.ndim == 3:
        checks.refuse("z", "one track, (N, m): each track has a gate of its own", f"shape {z.shape}")
    checks.no_infinity(z)
    limit, patience = checks.positive("limit", limit), checks.count("patience", patience)
    return pieces(kf, z, [], limit, patience)


def pieces(kf, z, begins, limit, patience):
    """Return the piece of each fix as `gated` does. No piece goes on into the rows that begin another recording.

    The filter starts anew at each row of `begins`, as at a new piece, and from x0 and P0 at row 0 unless that is one of
    them. The way from one recording to the next is no jump.
    """
    seen = ~np.isnan(z)
    steps = _steps_of(kf, z, seen)
    try:
        found = _in_sequence(steps, seen.any(axis=1), set(begins), limit, patience)
    except (np.linalg.LinAlgError, OverflowError, ZeroDivisionError):
        checks.refuse(
            "kf", "covariances that doubles can hold over these epochs", "an overflow, or none that is positive"
        )
    unit = z / np.sqrt(np.diag(kf.model.R))
    recording = np.zeros(len(z), dtype=int)
    recording[list(begins)] = 1
    recording = np.cumsum(recording)
    number = np.full(len(z), -1)
    if not found:
        return number
    way = _Way(found, unit, kf.times_of(len(z)), recording)
    for k, rows in enumerate(_cheapest_chain(_without_stuck_ones(found, way), way, recording)):
        number[rows] = k
    return number


class _Candidate(NamedTuple):
    """A new start that refused fixes make which agree: the state after them, their rows, and how surprising the last
    of them was to it, which the first one cannot be.
    """

    state: Any
    rows: list[int]
    surprise: float | None = None


def _in_sequence(steps, fixes, begins, limit, patience):
    """Return the rows of each piece, in order of their first rows, by rules 1 and 2."""
    found, rows = [], []
    state, candidates = steps.origin(), []
    for k in range(len(fixes)):
        if k in begins:
            found.append(rows)
            rows, state, candidates = [], None, []
        if state is None:  # before the first fix of a recording
            if fixes[k]:
                state, rows = steps.start(k), [k]
            continue
        nis, predicted = steps.look(state, k)
        if not fixes[k]:
            state = predicted
            candidates = [each._replace(state=steps.look(each.state, k)[1]) for each in candidates]
            continue
        agreed = []
        for each in candidates:
            other_nis, other = steps.look(each.state, k)
            if other_nis <= limit:
                agreed.append(_Candidate(steps.take(other, k), [*each.rows, k], steps.surprise(other_nis, other)))
        surprise = steps.surprise(nis, predicted) if agreed else -math.inf
        if nis <= limit and all(surprise <= each.surprise + RARE for each in agreed):
            state, candidates = steps.take(predicted, k), []
            rows.append(k)
            continue
        state = predicted
        candidates = [*agreed, _Candidate(steps.start(k), [k])]
        oldest = candidates[0]
        if len(oldest.rows) == patience:
            found.append(rows)
            state, rows, candidates = oldest.state, oldest.rows, []
    found.append(rows)
    return [rows for rows in found if rows]


def _without_stuck_ones(found, way):
    """Return the rows of the pieces without those where a receiver without signal has stood still.

    That is before a step that is too fast, if it would be none from where the fixes began to stay in one place, and if
    the mobile came there at such a speed: one that rested there has not gone on, and the step is a jump. An example, in
    the middle of a track that moves 1 m a second:

        time (s)          0   1   2   3   4   5   6   7   8
        true position     0   1   2   3   4   5   6   7   8
        recorded          0   1   2   3   3   3   3   7   8
                             before  tail ...    k   k + 1

    The step of 4 m from k is too fast. The fixes from `tail` to k lie within a tenth of it. From the fix before them
    the way to k + 1 is 5 m in 5 s, which is usual, and the mobile came at 1 m/s: the four fixes of 3 m are refused.
    """
    rows = np.concatenate(found)
    stuck = np.zeros(len(rows), dtype=bool)
    for k in np.flatnonzero(way.too_fast(rows[:-1], rows[1:])):
        near = HARDLY * way.distance(rows[k], rows[k + 1])
        tail = k
        while tail > 0 and not stuck[tail - 1] and way.distance(rows[tail - 1], rows[k]) <= near:
            tail -= 1
        if tail == 0 or k + 1 - tail < STUCK or way.too_fast(rows[tail - 1 : tail], rows[k + 1 : k + 2])[0]:
            continue
        before = tail - 1
        arrived = way.speed(rows[max(before - STUCK, 0)], rows[before])
        gone_on = way.speed(rows[before], rows[k + 1])
        if ARRIVED * gone_on <= arrived <= gone_on / WENT_ON:
            stuck[tail : k + 1] = True
    refused = set(rows[stuck].tolist())
    left = ([row for row in each if row not in refused] for each in found)
    return [each for each in left if each]


class _Way:
    """The distance between fixes, z (N, m) in units of their noise, and whether one is too far from another.

    Those of different recordings never are.
    """

    def __init__(self, found, z, times, recording):
        self._z, self._times, self._recording = z, times, recording
        a = np.concatenate([rows[:-1] for rows in found]).astype(int)
        b = np.concatenate([rows[1:] for rows in found]).astype(int)
        seconds = times[b] - times[a]
        speeds = self._lengths(a, b)[seconds > 0] / seconds[seconds > 0]
        self._fast = float(np.quantile(speeds, OF_STEPS)) if len(speeds) else math.inf

    def too_fast(self, a, b, at_most=FASTER):
        """Tell which ways, from rows of a to those of b, are over `at_most` times as fast as a track usually is."""
        a, b = np.array(a, dtype=int), np.array(b, dtype=int)
        seconds = np.maximum(self._times[b] - self._times[a], 1e-9)
        return (self._recording[a] == self._recording[b]) & (self._lengths(a, b) > at_most * self._fast * seconds)

    def distance(self, a, b):
        """Return the distance between two fixes, along the axes that both of them have measured."""
        return float(self._lengths(a, b))

    def speed(self, a, b):
        """Return the speed of the way between two fixes."""
        return self.distance(a, b) / max(float(self._times[b] - self._times[a]), 1e-9)

    def _lengths(self, a, b):
        return np.sqrt(np.nansum((self._z[b] - self._z[a]) ** 2, axis=-1))


def _cheapest_chain(found, way, recording):
    """Return the rows of the pieces that are kept, those without a jump between them as one, by rule 3.

    A piece is dropped by parts: what stands between refused fixes, and its first and its last fix, which may be faults
    that agreed with the others by chance. The cheapest way to keep part j, after part i or as the first one, costs

        cost[j] = to_keep[j] + min over i of (cost[i] + fixes of the parts between i and j + JUMP if there is one)
        cost[j] = to_keep[j] + fixes of all parts before j
    """
    parts, of_piece = [], []
    for k, rows in enumerate(found):
        own = _parts(rows)
        parts += own
        of_piece += [k] * len(own)
    firsts, lasts = [rows[0] for rows in parts], [rows[-1] for rows in parts]
    dropped = np.concatenate([[0], np.cumsum([len(rows) for rows in parts])]).tolist()  # [j]: fixes of all before j
    jumps = {}

    def jump(i, j):
        """Tell whether the way from the end of a part to the start of one of another piece is too fast.

        Where parts are dropped between them it must be a usual speed, lest they are dropped to make time for the way.
        """
        if (i, j) not in jumps:
            at_most = 1.0 if j > i + 1 else FASTER
            jumps[i, j] = of_piece[i] != of_piece[j] and way.too_fast(lasts[i : i + 1], firsts[j : j + 1], at_most)[0]
        return jumps[i, j]

    too_fast = [int(way.too_fast(rows[:-1], rows[1:]).sum()) for rows in parts]
    to_keep = [JUMP * min(steps, MOST_TOO_FAST) for steps in too_fast]
    cost, before = [], []  # before[j]: the part that is kept before j, or None
    for j in range(len(parts)):
        ways = [(dropped[j], 0, None)] if j < LOOK_BACK else []  # cost, how far back i is, and i
        for i in range(max(j - LOOK_BACK, 0), j):
            ways.append((cost[i] + dropped[j] - dropped[i + 1] + JUMP * jump(i, j), j - i, i))
        least, _, i = min(ways, key=lambda each: each[:2])  # of equal costs the nearest
        cost.append(least + to_keep[j])
        before.append(i)
    ends = range(max(0, len(parts) - LOOK_BACK), len(parts))
    j = min(ends, key=lambda j: (cost[j] + dropped[-1] - dropped[j + 1], -j))
    kept = []
    while j is not None:
        kept.append(j)
        j = before[j]
    kept.reverse()
    joined = [list(parts[kept[0]])]
    for i, j in pairwise(kept):
        if jump(i, j) or recording[lasts[i]] != recording[firsts[j]]:
            joined.append(list(parts[j]))
        else:
            joined[-1] += parts[j]
    return joined


def _parts(rows):
    """Return the rows of a piece between those that are refused, its first and its last one apart."""
    cuts = np.flatnonzero(np.diff(rows) > 1) + 1
    cuts = np.unique(np.concatenate([[0, 1], cuts, [len(rows) - 1, len(rows)]]))
    return [rows[begin:end] for begin, end in pairwise(cuts.tolist()) if end > begin]


# What follows is all that knows how a filter takes a step. Both classes do the same:
#   origin()            the state before the first row, x0 and P0
#   start(k)            the state after a first fix, of row k
#   look(state, k)      the NIS of row k, and the state there before it is measured
#   surprise(nis, predicted)   -2 log of the probability density of row k, but for a constant
#   take(predicted, k)  the state after it is measured


def _steps_of(kf, z, seen):
    epochs = kf.epochs_of(z[..., None])
    lengths = np.ones(len(z)) if epochs.lengths is None else epochs.lengths[:, 0]
    variances = None if epochs.variances is None else epochs.variances[..., 0]
    if _is_a_stack_of_equal_axes(kf.model, variances, seen):
        return _EqualAxes(kf.model, lengths, variances, z)
    return _AnyModel(kf.model, lengths, variances, z, seen)


class _AnyModel:
    """A Kalman filter in matrices; a state is x (n,), P (n, n)."""

    def __init__(self, model, lengths, variances, z, seen):
        self._model, self._variances, self._z, self._seen = model, variances, z, seen
        self._lengths = lengths
        self._steps = {}  # F and Q by length

    def origin(self):
        return self._model.x0, self._model.P0

    def start(self, k):
        F, Q = self._step(1.0)
        H, _ = self._measured(k)
        x, P = F @ self._model.x0, F @ self._model.P0 @ F.T + Q
        x = x + np.linalg.pinv(H) @ (self._z[k][self._seen[k]] - H @ x)
        return self.take(self._before(x, P, k), k)

    def look(self, state, k):
        F, Q = self._step(self._lengths[k])
        x, P, *_ = state
        predicted = self._before(F @ x, F @ P @ F.T + Q, k)
        unit = predicted[2]
        return float(unit @ unit), predicted

    def surprise(self, nis, predicted):
        return nis + predicted[4]

    def take(self, predicted, k):
        x, P, unit, W, _ = predicted
        return x + W.T @ unit, P - W.T @ W

    def _step(self, length):
        if length not in self._steps:
            if len(self._steps) > 1000:
                self._steps.clear()
            model = self._model
            self._steps[length] = (model.F, model.Q) if length == 1 else model.over(length)
        return self._steps[length]

    def _measured(self, k):
        seen = self._seen[k]
        R = self._model.R if self._variances is None else np.diag(np.where(seen, self._variances[k], 1))
        return self._model.H[seen], R[np.ix_(seen, seen)]

    def _before(self, x, P, k):
        """Return x, P, the innovation at unit covariance, W with K = Wᵀ L⁻¹, log det S.

        P changes by - Wᵀ W.
        """
        H, R = self._measured(k)
        L = np.linalg.cholesky(H @ P @ H.T + R)
        both = np.linalg.solve(L, np.column_stack([self._z[k][self._seen[k]] - H @ x, H @ P]))
        return x, P, both[:, 0], both[:, 1:], 2 * float(np.log(np.diag(L)).sum())


def _is_a_stack_of_equal_axes(model, variances, seen):
    """Tell whether all axes of a track share one 2x2 covariance: equal axes of position and velocity, seen together."""
    n, m = model.n, model.m
    if n != 2 * m or model.powers is None or not np.array_equal(model.powers, [1.5, 0.5] * m):
        return False
    axis = slice(0, 2)
    eye = np.eye(m)
    alike = all(np.array_equal(M, np.kron(eye, M[axis, axis])) for M in (model.F, model.Q, model.P0))
    if not alike or not np.array_equal(model.H, np.kron(eye, [[1.0, 0.0]])):
        return False
    if not np.array_equal(model.R, model.R[0, 0] * eye) or not (seen.all(axis=1) == seen.any(axis=1)).all():
        return False
    return variances is None or bool((variances == variances[:, :1])[seen].all())


class _EqualAxes:
    """The same for equal axes of position and velocity: plain numbers, some ten times as fast.

    A state is P11, P12, P22 of one axis (a, b, c), and the positions and the velocities of all. With H = [1 0] the gain
    of a position is a / S, that of a velocity b / S, and P - K H P is a r / S, b r / S, c - b² / S.
    """

    def __init__(self, model, lengths, variances, z):
        self._z, self._lengths = z.tolist(), lengths.tolist()
        N = len(self._z)
        self._r = [float(model.R[0, 0])] * N if variances is None else variances[:, 0].tolist()
        self._dt = float(model.F[0, 1])
        self._q = float(model.Q[0, 0]), float(model.Q[0, 1]), float(model.Q[1, 1])
        self._P0 = float(model.P0[0, 0]), float(model.P0[0, 1]), float(model.P0[1, 1])
        self._x0 = model.x0[::2].tolist(), model.x0[1::2].tolist()

    def origin(self):
        return *self._P0, *self._x0

    def start(self, k):
        _, (a, b, c, _, velocities, _, S) = self._look(self.origin(), k, 1.0)
        position = self._z[k]
        return self.take((a, b, c, position, velocities, [0.0] * len(position), S), k)

    def look(self, state, k):
        return self._look(state, k, self._lengths[k])

    def surprise(self, nis, predicted):
        return nis + len(predicted[5]) * math.log(predicted[6])

    def take(self, predicted, k):
        a, b, c, positions, velocities, off, S = predicted
        K_s, K_v, left = a / S, b / S, self._r[k] / S
        positions = [s + K_s * e for s, e in zip(positions, off, strict=True)]
        velocities = [v + K_v * e for v, e in zip(velocities, off, strict=True)]
        return a * left, b * left, c - b * K_v, positions, velocities

    def _look(self, state, k, length):
        a, b, c, positions, velocities, *_ = state
        q11, q12, q22 = self._q
        dt = self._dt * length
        a += dt * (2 * b + dt * c) + q11 * length**3
        b += dt * c + q12 * length**2
        c += q22 * length
        positions = [s + dt * v for s, v in zip(positions, velocities, strict=True)]
        off = [z - s for z, s in zip(self._z[k], positions, strict=True)]
        S = a + self._r[k]
        return sum([e * e for e in off]) / S, (a, b, c, positions, velocities, off, S)
