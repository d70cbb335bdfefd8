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
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _checks as checks
from .. import metrics
from ..equations import corrected_covariance, gain, neutralised
from ..kalman import KalmanFilter
from ..lainiotis import LainiotisFilter

# Where no fault was found, or not for so many fixes, the filter runs over many rows at once, in place of one after the
# other: over all of the recording, or over so many times the fixes since the last fault.
CALM, GROWTH = 200, 5
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
# The mobile came to that position at this part of the speed at which it would have gone on, or more, and went on at
# this part of the speed at which it came, or more: one that rests for long would crawl.
ARRIVED, WENT_ON = 0.5, 0.25
# A way that is so many times as fast as a track usually is leads to a wrong position, and is no jump of a receiver.
IMPOSSIBLE = 1000.0
# A segment is tried after the ones that ended at most so many before it. More in a row are never dropped.
LOOK_BACK = 30
# Two fixes at one time count as so many seconds apart.
NO_TIME = 1e-9


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
    _warn_of_a_far_start(_Rows(kf, z), limit, patience)
    return segments_of(kf, z, [], limit, patience)


def segments_of(kf, z, begins, limit, patience):
    """Return the segment of each fix of z (N, m) as `gated` does.

    The filter starts anew at each row of `begins`, where a recording begins, and from x0 and P0 at row 0 unless that is
    one of them. No segment goes on into another recording, and the way between two recordings is no jump.
    """
    found = _in_sequence(_Rows(kf, z), begins, limit, patience)
    number = np.full(len(z), -1)
    if found:
        recording = np.searchsorted(begins, np.arange(len(z)), side="right")
        way = _Way(found, z / np.sqrt(np.diag(kf.model.R)), kf.times_of(len(z)), recording)
        for k, rows in enumerate(_cheapest_chain(_without_stuck_ones(_without_excursions(found, way), way), way)):
            number[rows] = k
    return number


def _warn_of_a_far_start(track, limit, patience):
    """Warn where x0 and P0 expect none of the first fixes: good ones are refused then until some of them agree."""
    state, off = track.first(), []
    for k in range(len(track.z)):
        if track.fixes[k]:
            off.append(track.with_fix(state, k)[1])
        if len(off) == patience:
            break
        state = track.without_fix(state, k)
    if min(off, default=0.0) > limit:
        where = "say where the track begins: x0 at the first fix, and a P0 that holds its position and velocity"
        checks.warn(f"gated: the first fixes are {math.sqrt(min(off)):.0f} standard deviations from x0: {where}")


class _Rows:
    """The rows of a track z (N, m), and what a Kalman filter makes of them. A state is x (n,) and P (n, n).

    Where it is one before row k, it may be led on with the fix or without.
    """

    def __init__(self, kf, z):
        kf.epochs_of(z[..., None])  # refuses times and variances that are not those of z
        self.model, self.z, self.seen = kf.model, z, np.isfinite(z)
        self.fixes = self.seen.any(axis=1)
        self.t = None if kf.t is None else kf.t.ravel()
        self.r = None if kf.r is None else kf.r.reshape(z.shape)
        if kf.t is not None:
            self.dt = np.diff(self.t, prepend=self.t[0] - self.model.dt)
            self.F, self.Q = self.model.over(self.dt)

    def first(self):
        """Return the state before the first row."""
        return self.model.x0, self.model.P0

    def start(self, k):
        """Return the state after a first fix, of row k: x0 and P0 moved there."""
        model, seen = self.model, self.seen[k]
        x, P = model.F @ model.x0, model.F @ model.P0 @ model.F.T + model.Q
        H = seen[:, None] * model.H
        moved = np.linalg.pinv(H) @ np.where(seen, self.z[k] - H @ x, 0.0)
        return self._corrected(x + moved, P, k)[0]

    def without_fix(self, state, k):
        """Return the state after row k if nothing is measured there."""
        x, P = state
        F, Q = (self.model.F, self.model.Q) if self.t is None else (self.F[k], self.Q[k])
        return F @ x, F @ P @ F.T + Q

    def with_fix(self, state, k):
        """Return the state after row k, the NIS of its fix, and -2 log of its density, but for 2 pi."""
        return self._corrected(*self.without_fix(state, k), k)

    def _corrected(self, x, P, k):
        seen = self.seen[k]
        R = self.model.R if self.r is None else np.diag(np.where(seen, self.r[k], 1.0))
        H, R = neutralised(self.model.H, R, seen)
        innovation = np.where(seen, self.z[k] - H @ x, 0.0)
        S = H @ P @ H.T + R
        sign, log_det = np.linalg.slogdet(S)
        if not (sign > 0 and math.isfinite(log_det)):
            checks.refuse("kf", "covariances that doubles can hold over these epochs", "one that is not positive")
        K = gain(P, H, R)
        nis = float(innovation @ np.linalg.solve(S, innovation))
        return (x + K @ innovation, corrected_covariance(P, K, H, R)), nis, nis + float(log_det)

    def part(self, state, k, stop):
        """Return the filter that goes on from a state before row k, and the rows k to `stop`, which it is for."""
        model = replace(self.model, x0=state[0], P0=state[1])
        if self.t is not None:
            model = replace(model, F=None, Q=None, dt=max(self.dt[k], NO_TIME))  # that of the first step
        t, r = (None if each is None else each[k:stop] for each in (self.t, self.r))
        return KalmanFilter(model, t, r), self.z[k:stop]


class _Candidate(NamedTuple):
    """A new start: refused fixes that agree, the state after them, and the deviance of the last of them."""

    state: Any
    rows: list[int]
    deviance: float = -math.inf


def _in_sequence(track, begins, limit, patience):
    """Return the rows of each segment, in order of their first rows, by rules 1 and 2."""
    found = []
    for begin, stop in pairwise(sorted({0, *begins, len(track.z)})):
        if begin not in begins:
            found += _of_recording(track, track.first(), [], begin, stop, limit, patience)
            continue
        whole = begin + np.flatnonzero(track.seen[begin:stop].all(axis=1))  # only these tell where all axes begin
        if len(whole):
            first = int(whole[0])
            found += _of_recording(track, track.start(first), [first], first + 1, stop, limit, patience)
    return [rows for rows in found if rows]


def _of_recording(track, state, rows, k, stop, limit, patience):
    """Return the rows of each segment from row k to `stop`; the first one has some rows already, and their state."""
    found, candidates = [], []
    calm = stop - k  # fixes since the last fault; before the first one as many as there are rows
    if not rows:  # x0 and P0 may be so vague that one row after the other would lose the digits of P
        calm = max(calm, CALM)
    while k < stop:
        if not candidates and calm >= CALM:
            kf, z = track.part(state, k, min(k + GROWTH * calm, stop))
            over = np.flatnonzero(metrics.nis(kf, z) > limit)
            count = int(over[0]) if len(over) else len(z)
            if 0 < count < stop - k:
                kf, z = track.part(state, k, k + count)
                x, P = kf.estimates(z)
                state = x[-1], P[-1]
            rows += (k + np.flatnonzero(track.fixes[k : k + count])).tolist()
            k += count
            calm = 0 if len(over) else calm + count
            continue
        if not track.fixes[k]:
            state = track.without_fix(state, k)
            candidates = [each._replace(state=track.without_fix(each.state, k)) for each in candidates]
            k += 1
            continue
        taken, nis, deviance = track.with_fix(state, k)
        agreed = []
        for each in candidates:
            own, own_nis, own_deviance = track.with_fix(each.state, k)
            if own_nis <= limit:
                agreed.append(_Candidate(own, [*each.rows, k], own_deviance))
        if nis <= limit and all(deviance <= each.deviance + RARE for each in agreed):
            state, candidates = taken, []
            rows.append(k)
            calm += 1
        else:
            state, candidates = track.without_fix(state, k), [*agreed, _Candidate(track.start(k), [k])]
            calm = 0
            oldest = candidates[0]
            if len(oldest.rows) == patience:
                found.append(rows)
                state, rows, candidates = oldest.state, oldest.rows, []
        k += 1
    return [*found, rows]


class _Way:
    """The way between fixes, z (N, m) in units of their noise: its length, and whether it is too fast.

    That is measured by the steps within the segments found. The way to a fix of another recording never is.
    """

    def __init__(self, found, z, times, recording):
        self.z, self.times, self.recording = z, times, recording
        a = np.concatenate([rows[:-1] for rows in found]).astype(int)
        b = np.concatenate([rows[1:] for rows in found]).astype(int)
        later = times[b] > times[a]
        speeds = self.speed(a, b)[later]
        self.fast = float(np.quantile(speeds, OF_STEPS)) if len(speeds) else math.inf

    def distance(self, a, b):
        """Return the distance between fixes a and b, along the axes that both have measured."""
        return np.sqrt(np.nansum((self.z[b] - self.z[a]) ** 2, axis=-1))

    def speed(self, a, b):
        """Return the speed of the way from fixes a to b."""
        return self.distance(a, b) / np.maximum(self.times[b] - self.times[a], NO_TIME)

    def too_fast(self, a, b, at_most=FASTER):
        """Tell which ways, from fixes a to b, are more than `at_most` times as fast as the track usually is."""
        return (self.recording[a] == self.recording[b]) & (self.speed(a, b) > at_most * self.fast)


def _without_excursions(found, way):
    """Return the segments but those that stand in a wrong position, as 0° N 0° E, from where the track returns."""
    if way.fast == 0:  # a track that mostly stands still, but for the steps of a coarse grid
        return found
    rows, left = np.concatenate(found), []
    for own, following in zip(found, [*found[1:], None], strict=True):
        before = left[-1][-1] if left and way.recording[left[-1][-1]] == way.recording[own[0]] else None
        after = following[0] if following and way.recording[following[0]] == way.recording[own[0]] else None
        if not _is_excursion(own, before, after, rows, way):
            left.append(own)
    return left


def _is_excursion(own, before, after, rows, way):
    """Tell whether a segment stands in a wrong position; before and after are the fixes beside it, or None.

    The mobile goes there and back too fast, from and to where it could have gone without. At an end of a recording,
    which has no way back, it must go there impossibly fast. Of the two positions that with more fixes is right.
    """
    ways = [(before, own[0])] if before is not None else []
    ways += [(own[-1], after)] if after is not None else []
    both = len(ways) == 2
    if not ways or not all(way.too_fast(a, b, FASTER if both else IMPOSSIBLE) for a, b in ways):
        return False
    if both and way.too_fast(before, after):
        return False
    near = HARDLY * min(way.distance(a, b) for a, b in ways)
    here, there = own[0], after if before is None else before
    stays = way.distance(own, here).max() <= near
    return stays and (way.distance(rows, here) <= near).sum() < (way.distance(rows, there) <= near).sum()


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
        if tail == 0:
            continue
        arrived = way.speed(rows[max(tail - 1 - STUCK, 0)], rows[tail - 1])
        # Fixes that still move, at half the speed at which the mobile came or faster, are good.
        while tail < k and way.speed(rows[tail], rows[tail + 1]) > arrived / 2:
            tail += 1
        if k + 1 - tail < STUCK:
            continue
        before, after = rows[tail - 1], rows[k + 1]
        # Where they have moved, the fixes before and after them are in one wrong position.
        moved = way.distance(rows[tail:k], rows[k]).max() > HARDLY * way.distance(before, after)
        if moved or way.too_fast(before, after):
            continue
        speed = way.speed(before, after)
        if ARRIVED * speed <= arrived <= speed / WENT_ON:
            stuck[tail : k + 1] = True
    refused = set(rows[stuck].tolist())
    left = ([row for row in each if row not in refused] for each in found)
    return [each for each in left if each]


def _cheapest_chain(found, way):
    """Return the rows of the segments that are kept, those without a jump between them as one, by rule 3.

    A segment is dropped by parts: what stands between refused fixes, and its first and its last fix, which may be
    faults that agreed with the others by chance. The cheapest way to keep part j, after part i or as the first one, is

        cost[j] = to_keep[j] + min over i of (cost[i] + fixes of the parts between i and j + JUMP if there is one)
        cost[j] = to_keep[j] + fixes of all parts before j
    """
    parts, segment = [], []
    for number, rows in enumerate(found):
        own = _parts(rows)
        parts += own
        segment += [number] * len(own)
    dropped = np.cumsum([0, *map(len, parts)]).tolist()  # [j]: the fixes of all parts before j

    def jump(i, j):
        """Tell whether the way from the end of a part to the start of one of another segment is too fast.

        Where parts are dropped between them it must be a usual speed, so that parts are not dropped just to lower it.
        """
        at_most = 1.0 if j > i + 1 else FASTER
        return segment[i] != segment[j] and bool(way.too_fast(parts[i][-1], parts[j][0], at_most))

    cost, before = [], []  # before[j]: the part that is kept before j, or None
    for j, rows in enumerate(parts):
        ways = [(dropped[j], 0, None)] if j < LOOK_BACK else []  # cost, how far back i is, and i
        for i in range(max(j - LOOK_BACK, 0), j):
            ways.append((cost[i] + dropped[j] - dropped[i + 1] + JUMP * jump(i, j), j - i, i))
        least, _, i = min(ways, key=lambda each: each[:2])  # of equal costs the nearest
        to_keep = JUMP * min(int(way.too_fast(rows[:-1], rows[1:]).sum()), MOST_TOO_FAST)
        cost.append(least + to_keep)
        before.append(i)
    last = range(len(parts))[-LOOK_BACK:]
    j = min(last, key=lambda j: (cost[j] + dropped[-1] - dropped[j + 1], -j))
    kept = []
    while j is not None:
        kept.insert(0, j)
        j = before[j]
    joined = [list(parts[kept[0]])]
    for i, j in pairwise(kept):
        if jump(i, j) or way.recording[parts[i][-1]] != way.recording[parts[j][0]]:
            joined.append([])
        joined[-1] += parts[j]
    return joined


def _parts(rows):
    """Return the rows of a segment between those that are refused, its first and its last one apart."""
    cuts = {0, 1, *(np.flatnonzero(np.diff(rows) > 1) + 1).tolist(), len(rows) - 1, len(rows)}
    return [rows[begin:end] for begin, end in pairwise(sorted(cuts))]
