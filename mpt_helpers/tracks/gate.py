"""Faults among the fixes of a recorded track: one pass of a Kalman filter in sequence, which makes a mask.

A receiver errs in two ways that no filter expects. Single fixes, or a few in a row, lie far off; and the whole track
jumps, as when the signal comes back, and goes on from elsewhere. The gate tells one from the other:

1. A fix is refused if its NIS is above a limit. The filter goes on as if the fix were missing.
2. Refused fixes that follow one another and agree *with each other* begin a new segment, from the first of them.
3. Of these segments the cheapest chain is kept. To drop a segment costs as many as it has fixes, a jump between two
   that are kept costs ten. Where the way between two segments is no faster than the track usually is, there is no
   jump: the mobile has turned, and both are one segment.

The limit is far above what noise explains: a chi-square limit of 99.9 % would refuse a fifth of the good fixes of real
tracks, whose motion is alternately smooth and highly dynamic. Refused fixes become NaN, which filters treat as missing.
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

# Two segments are joined, without a jump, where the way between them is at most so many times as fast as the fastest
# twentieth of all steps: between consecutive fixes of a clean track none was.
FASTER, OF_STEPS = 2.0, 0.95
# A fix that the filter expects belongs to a new start nevertheless, if that expects it so much better, in units of -2
# log of a probability density. At 0 good fixes are lost to new starts, at 20 the gate misses shifts on sparse tracks.
RARE = 5.0
# What a jump costs, in fixes: a segment of fewer fixes between two jumps is an outlier.
JUMP = 10
# A segment is charged a jump for each of its steps that are too fast, but for no more than these: one of more fixes
# than that costs, as a train ride within a walk, is never dropped for its speed.
MOST_TOO_FAST = 2
# A receiver without signal repeats its position, or writes another one, and jumps when the signal is back: so many
# fixes that stray by less than this part of the jump, and of the way from the fix before them to the one after them.
STUCK, HARDLY = 3, 0.1
# The mobile has come to that position with at least this part of the speed at which it would have gone on.
ARRIVED = 0.5
# And it has gone on with at least this part of the speed with which it came: one that rests for long would crawl.
WENT_ON = 0.25
# A way that is so many times as fast as a track usually is leads to a wrong position, and is no jump of a receiver.
IMPOSSIBLE = 1000.0
# A segment is tried after the ones that ended at most so many before it. More in a row are never dropped.
LOOK_BACK = 30


def gated(kf: KalmanFilter, z: ArrayLike, limit: float = 100.0, patience: int = 3) -> NDArray[np.intp]:
    """Return the segment of each fix of a track, with -1 where the fix is refused.

    Parameters
    ----------
    kf : KalmanFilter or LainiotisFilter
        A filter of any model, with its times and variances.
    z : array_like, (N, m)
        Measurements, NaN where one is missing. A row that is partly NaN is judged by the rest; a row without
        measurements is no fix.
    limit : float
        A fix is refused where its NIS, of all its measurements together, is above it. A squared distance, not a
        probability: above 1.
    patience : int
        So many refused fixes in a row that agree with each other begin a new segment.

    Returns
    -------
    ndarray of int, (N,)
        0, 1, ... in order of time, and -1 where a fix is refused or there is none. Each segment is a track of its own:
        the first starts from the model's x0 and P0, as `kf` does, the others from x0 and P0 moved to their first fix.

    Raises
    ------
    TypeError
        For another filter, as one of constant gain.
    ValueError
        For many tracks, a limit of 1 or below, and a patience below 1.

    Warns
    -----
    UserWarning
        Where the first fixes are all refused: x0 and P0 do not say where the track begins.

    Examples
    --------
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
    need = "a squared distance in variances, above 1, as 100"
    limit = checks.number("limit", limit, need, lambda value: value > 1)
    patience = checks.count("patience", patience)
    _warn_of_a_far_start(_Sequence(kf, z[..., None]), limit, patience)
    return segments_of(kf, z[..., None], [], limit, patience)


def segments_of(kf, z, begins, limit, patience):
    """Return the segment of each fix as `gated` does, of z (N, m, A): A axes of one track that share P.

    The filter starts anew at each row of `begins`, where a recording begins, and from x0 and P0 at row 0 unless that is
    one of them. No segment goes on into another recording, and the way between two recordings is no jump.
    """
    found = _in_sequence(_Sequence(kf, z), set(begins), limit, patience)
    recording = np.zeros(len(z), dtype=int)
    recording[list(begins)] = 1
    number = np.full(len(z), -1)
    if found:
        way = _Way(found, z / np.sqrt(np.diag(kf.model.R))[:, None], kf.times_of(len(z)), np.cumsum(recording))
        for k, rows in enumerate(_cheapest_chain(_without_stuck_ones(_without_excursions(found, way), way), way)):
            number[rows] = k
    return number


def _warn_of_a_far_start(sequence, limit, patience):
    """Warn where x0 and P0 expect none of the first fixes: good ones are refused then until some of them agree."""
    state, off = sequence.first(), []
    for k, fix in enumerate(sequence.fixes):
        look = sequence.look(state, k)
        state = look.refused
        off += [look.nis] if fix else []
        if len(off) == patience:
            break
    if min(off, default=0.0) > limit:
        where = "say where the track begins: x0 at the first fix, and a P0 that holds its position and velocity"
        checks.warn(f"gated: the first fixes are {math.sqrt(min(off)):.0f} standard deviations from x0: {where}")


class _Sequence:
    """A Kalman filter that is led through z (N, m, A) row by row; A axes of one track share P. A state is x (n, A), P.

    A step depends on no measured value. On even steps P comes to rest, and then its steps are `made` already.
    """

    def __init__(self, kf, z):
        epochs = kf.epochs_of(z)
        self.model, self.z, self.made = kf.model, z, {}
        self.missing = np.isnan(z)
        self.seen = ~self.missing.all(axis=2)
        self.fixes = self.seen.any(axis=1).tolist()
        # Whether no axis lacks what others have.
        self.whole = (~self.missing | ~self.seen[:, :, None]).all(axis=(1, 2)).tolist()
        self.dt, self.motions = [None] * len(z), {None: (kf.model.F, kf.model.Q)}  # F and Q by the length of a step
        if epochs.dt is not None:
            self.dt = epochs.dt[:, 0].tolist()
            lengths = np.unique(epochs.dt)
            self.motions |= dict(zip(lengths.tolist(), zip(*kf.model.over(lengths), strict=True), strict=True))
        # What is missing has zeros in H and a one in R.
        R = np.broadcast_to(epochs.noise(kf.model.R)[..., 0], (len(z), kf.model.m, kf.model.m))
        both = self.seen[:, :, None] & self.seen[:, None]
        self.H = np.where(self.seen[:, :, None], kf.model.H, 0.0)
        self.R = np.where(both, R, np.eye(kf.model.m) * ~self.seen[:, None])

    def first(self):
        """Return the state before the first row."""
        return np.repeat(self.model.x0[:, None], self.z.shape[2], axis=1), self.model.P0

    def start(self, k):
        """Return the state after a first fix, of row k: x0 and P0 moved there."""
        x, P = self.first()
        step = self._step(P, k, None)
        x = step.F @ x
        e = self._innovation(x, k)
        moved = np.linalg.pinv(self.H[k]) @ e
        return x + moved + step.gain @ (e - self.H[k] @ moved), step.corrected

    def look(self, state, k):
        """Return what the fix of row k, if it has one, makes of a state."""
        x, P = state
        step = self._step(P, k, self.dt[k])
        x = step.F @ x
        if not self.fixes[k]:
            return _Look((x, step.predicted))
        e = self._innovation(x, k)
        nis = float(np.vdot(e, step.precision @ e))
        return _Look((x, step.predicted), (x + step.gain @ e, step.corrected), nis, nis + step.log_det)

    def _innovation(self, x, k):
        e = self.z[k] - self.H[k] @ x
        e[self.missing[k]] = 0.0
        return e

    def _step(self, P, k, dt):
        key = P.tobytes(), dt, self.seen[k].tobytes(), self.R[k].tobytes()
        if key not in self.made:
            self.made[key] = self._made(P, k, dt)
        return self.made[key]

    def _made(self, P, k, dt):
        """Return the _Step from P (n, n) over dt to row k."""
        F, Q = self.motions[dt]
        P = F @ P @ F.T + Q
        if not self.fixes[k]:
            return _Step(F, P)
        HP = self.H[k] @ P
        S = HP @ self.H[k].T + self.R[k]
        precision, log_det = _inverse_and_log_det(S)
        gain = HP.T @ precision
        return _Step(F, P, gain, P - gain @ HP, precision, log_det * self.z.shape[2])


def _inverse_and_log_det(S):
    """Return S⁻¹ and log det S; of a single measurement, ten times as fast, by a division."""
    if len(S) == 1 and S[0, 0] > 0:
        return 1 / S, math.log(S[0, 0])
    sign, log_det = np.linalg.slogdet(S)
    if not sign > 0:
        checks.refuse("kf", "covariances that doubles can hold over these epochs", "one that is not positive")
    return np.linalg.inv(S), float(log_det)


class _Step(NamedTuple):
    """F, the predicted P, and, where there is a fix: the gain, the corrected P, S⁻¹ and log det S of all axes."""

    F: Any
    predicted: Any
    gain: Any = None
    corrected: Any = None
    precision: Any = None
    log_det: float = 0.0


class _Look(NamedTuple):
    """The states if a fix is refused and if it is taken, its NIS, and its deviance: -2 log density, but for 2 pi."""

    refused: Any
    taken: Any = None
    nis: float = 0.0
    deviance: float = 0.0


class _Candidate(NamedTuple):
    """A new start: refused fixes that agree, the state after them, and the deviance of the last of them."""

    state: Any
    rows: list[int]
    deviance: float = -math.inf


def _in_sequence(sequence, begins, limit, patience):
    """Return the rows of each segment, in order of their first rows, by rules 1 and 2."""
    found, rows = [], []
    state, candidates = sequence.first(), []
    for k, fix in enumerate(sequence.fixes):
        if k in begins:
            found.append(rows)
            rows, state, candidates = [], None, []
        if state is None:  # before the first fix of a recording that says where all axes begin
            if fix and sequence.whole[k]:
                state, rows = sequence.start(k), [k]
            continue
        look = sequence.look(state, k)
        looks = [sequence.look(each.state, k) for each in candidates]
        if not fix:
            state = look.refused
            candidates = [each._replace(state=own.refused) for each, own in zip(candidates, looks, strict=True)]
            continue
        agreed = [
            _Candidate(own.taken, [*each.rows, k], own.deviance)
            for each, own in zip(candidates, looks, strict=True)
            if own.nis <= limit
        ]
        if look.nis <= limit and all(look.deviance <= each.deviance + RARE for each in agreed):
            state, candidates = look.taken, []
            rows.append(k)
            continue
        state, candidates = look.refused, [*agreed, _Candidate(sequence.start(k), [k])]
        oldest = candidates[0]
        if len(oldest.rows) == patience:
            found.append(rows)
            state, rows, candidates = oldest.state, oldest.rows, []
    found.append(rows)
    return [rows for rows in found if rows]


def _without_excursions(found, way):
    """Return the segments without those that stand in one wrong position, as 0° N 0° E, from where the track returns.

    The mobile goes there and back too fast, from and to where it could have gone without. At an end of a recording,
    which has no way back, it must go there impossibly fast. Of the two positions that with more fixes is right.
    """
    if way.fast == 0:  # a track that mostly stands still, but for the steps of a coarse grid
        return found
    rows, left = np.concatenate(found), []
    for own, following in zip(found, [*found[1:], None], strict=True):
        here = own[0], own[-1]
        ways = [(left[-1][-1], here[0])] if left else []
        ways += [(here[1], following[0])] if following else []
        ways = [(a, b) for a, b in ways if way.recording[a] == way.recording[b]]
        both = len(ways) == 2
        at_most = FASTER if both else IMPOSSIBLE
        if not ways or not all(way.too_fast([a], [b], at_most)[0] for a, b in ways):
            left.append(own)
            continue
        near = HARDLY * min(way.distance(a, b) for a, b in ways)
        other = ways[0][0] if ways[0][1] == here[0] else ways[0][1]
        leads_on = both and way.too_fast([ways[0][0]], [ways[1][1]])[0]
        moves = way.distance(np.array(own), here[0]).max() > near
        at_other = (way.distance(rows, other) <= near).sum()
        if leads_on or moves or (way.distance(rows, here[0]) <= near).sum() >= at_other:
            left.append(own)
    return left


def _without_stuck_ones(found, way):
    """Return the rows of the segments without those where a receiver without signal has stood still.

    That is before a step that is too fast, if it would be none from where the fixes began to stay in one position, and
    if the mobile came there at such a speed: one that rested there has not gone on, and the step is a jump. An example,
    in the middle of a track that moves 1 m a second:

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
        before = tail - 1
        if tail == 0 or k + 1 - tail < STUCK or way.too_fast(rows[before : before + 1], rows[k + 1 : k + 2])[0]:
            continue
        gone_on = way.distance(rows[before], rows[k + 1])
        if max(way.distance(row, rows[k]) for row in rows[tail:k]) > HARDLY * gone_on:
            continue  # they have moved: it is the fixes before and after them that are in one wrong position
        arrived = way.speed(rows[max(before - STUCK, 0)], rows[before])
        speed = way.speed(rows[before], rows[k + 1])
        if ARRIVED * speed <= arrived <= speed / WENT_ON:
            stuck[tail : k + 1] = True
    refused = set(rows[stuck].tolist())
    left = ([row for row in each if row not in refused] for each in found)
    return [each for each in left if each]


class _Way:
    """The distance between fixes, z (N, m, A) in units of their noise, and whether one is too far from another.

    Fixes of different recordings never are.
    """

    def __init__(self, found, z, times, recording):
        self.z, self.times, self.recording = z.reshape(len(z), -1), times, recording
        a = np.concatenate([rows[:-1] for rows in found]).astype(int)
        b = np.concatenate([rows[1:] for rows in found]).astype(int)
        seconds = times[b] - times[a]
        speeds = self.distance(a, b)[seconds > 0] / seconds[seconds > 0]
        self.fast = float(np.quantile(speeds, OF_STEPS)) if len(speeds) else math.inf

    def too_fast(self, a, b, at_most=FASTER):
        """Tell which ways, from rows of a to those of b, are over `at_most` times as fast as a track usually is."""
        a, b = np.array(a, dtype=int), np.array(b, dtype=int)
        most = at_most * self.fast * np.maximum(self.times[b] - self.times[a], 1e-9)
        return (self.recording[a] == self.recording[b]) & (self.distance(a, b) > most)

    def distance(self, a, b):
        """Return the distance between two fixes, along the axes that both of them have measured."""
        return np.sqrt(np.nansum((self.z[b] - self.z[a]) ** 2, axis=-1))

    def speed(self, a, b):
        """Return the speed of the way between two fixes."""
        return self.distance(a, b) / max(self.times[b] - self.times[a], 1e-9)


def _cheapest_chain(found, way):
    """Return the rows of the segments that are kept, those without a jump between them as one, by rule 3.

    A segment is dropped by parts: what stands between refused fixes, and its first and its last fix, which may be
    faults that agreed with the others by chance. The cheapest way to keep part j, after part i or as the first one, is

        cost[j] = to_keep[j] + min over i of (cost[i] + fixes of the parts between i and j + JUMP if there is one)
        cost[j] = to_keep[j] + fixes of all parts before j
    """
    parts, of_segment = [], []
    for k, rows in enumerate(found):
        own = _parts(rows)
        parts += own
        of_segment += [k] * len(own)
    firsts, lasts = [rows[0] for rows in parts], [rows[-1] for rows in parts]
    dropped = np.concatenate([[0], np.cumsum([len(rows) for rows in parts])]).tolist()  # [j]: fixes of all before j
    too_fast = [int(way.too_fast(rows[:-1], rows[1:]).sum()) for rows in parts]
    to_keep = [JUMP * min(steps, MOST_TOO_FAST) for steps in too_fast]

    def jump(i, j):
        """Tell whether the way from the end of a part to the start of one of another segment is too fast.

        Where parts are dropped between them it must be a usual speed, so that parts are not dropped just to lower it.
        """
        at_most = 1.0 if j > i + 1 else FASTER
        return of_segment[i] != of_segment[j] and way.too_fast(lasts[i : i + 1], firsts[j : j + 1], at_most)[0]

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
        kept.insert(0, j)
        j = before[j]
    joined = [list(parts[kept[0]])]
    for i, j in pairwise(kept):
        if jump(i, j) or way.recording[lasts[i]] != way.recording[firsts[j]]:
            joined.append([])
        joined[-1] += parts[j]
    return joined


def _parts(rows):
    """Return the rows of a segment between those that are refused, its first and its last one apart."""
    cuts = np.flatnonzero(np.diff(rows) > 1) + 1
    cuts = np.unique(np.concatenate([[0, 1], cuts, [len(rows) - 1, len(rows)]]))
    return [rows[begin:end] for begin, end in pairwise(cuts.tolist()) if end > begin]
