"""Outliers and jumps of a recorded track: one pass of a Kalman filter, fix by fix, labels every fix.

A receiver fails in two ways that no filter models. Single fixes, or a few in a row, are far off; or the whole track
jumps, for example when the signal returns, and continues from there. The gate tells one from the other:

1. A fix whose NIS exceeds a limit is refused, and the filter treats it as missing.
2. Consecutive refused fixes that agree *with each other* start a new segment at the first of them.
3. The cheapest chain of segments is kept. Dropping a segment costs one per fix; a jump between two segments that are
   kept costs ten. If the track's usual speed leads from one segment to the next, there is no jump: the mobile has
   turned, and the two become one segment.

The limit is far above anything that noise explains. A chi-square limit of 99.9 % would refuse a fifth of the good fixes
of real tracks, whose motion is alternately smooth and highly dynamic.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg.lapack import dposv

from .. import _checks as checks
from .. import metrics
from .._checks import Array
from ..equations import corrected_covariance, gain, predicted_covariance, unit_measurements
from ..kalman import KalmanFilter
from ..lainiotis import LainiotisFilter

# A speed is too high above FASTER times the usual speed, the 95 % quantile of the steps. Clean tracks stay below.
FASTER, OF_STEPS = 2.0, 0.95
# A fix within the limit of its segment still goes to a new start if its -2 log density there is lower by more than
# this. With 0, good fixes are lost to new starts; with 20, the gate misses shifts on sparse tracks.
CLEARLY_LOWER = 5.0
# Cost of a jump, in fixes: a segment with fewer fixes between two jumps is an outlier.
JUMP = 10
# Each step within a segment that is too fast costs as much as a jump, up to this number: a long ride, such as one by
# train during a walk, is never dropped for its speed.
MOST_TOO_FAST = 2
# A receiver without signal repeats its position, or writes a wrong one, and jumps when the signal returns. It is stuck
# if at least STUCK fixes lie within HARDLY times the length of that jump, and of the straight line from the fix before
# them to the fix after them.
STUCK, HARDLY = 3, 0.1
# A mobile that rests is not stuck. So the speed of arrival must be at least ARRIVED times the speed along that line,
# and the speed along the line at least WENT_ON times the speed of arrival.
ARRIVED, WENT_ON = 0.5, 0.25
# A step this many times faster than usual leads to a wrong position; receivers do not jump as far.
IMPOSSIBLE = 1000.0
# A step this many times longer than the median is a gap. A receiver may be wrong after one, for example behind a
# tunnel.
GAP = 10
# Number of parts before each one from which the chain may continue. More parts in a row are never dropped.
LOOK_BACK = 30
# Two fixes at the same time count as this many seconds apart.
LEAST_STEP = 1e-9
# Where S is MUCH_LARGER than R, the difference P - K H P has lost digits, and Joseph's form takes its place. If H P Hᵀ
# of the start is TOO_LARGE, this loses them too, and the engine takes the first rows.
MUCH_LARGER, TOO_LARGE = 1e6, 1e12


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
        The NIS, of all measurements of a fix together, above which the fix is refused. It is a squared distance, not a
        probability, and must be above 1.
    patience : int
        The number of consecutive refused fixes, agreeing with each other, that start a new segment.

    Returns
    -------
    ndarray of int, (N,)
        0, 1, ... in order of time, and -1 where a fix is refused or there is none. Each segment is a track of its own:
        the first starts from the model's x0 and P0, as `kf` does; each other one from x0 and P0 moved to its first fix.

    Raises
    ------
    TypeError
        For any other filter, such as one with a constant gain.
    ValueError
        For many tracks, a limit of 1 or below, or a patience below 1.

    Warns
    -----
    UserWarning
        If all of the first fixes are refused, because x0 and P0 do not say where the track begins.

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
    return segments_of(kf, z, [], checked_limit(limit), checks.count("patience", patience))


def checked_limit(limit):
    """Return the NIS above which a fix is refused."""
    return checks.number("limit", limit, "a squared distance in variances, above 1, as 100", lambda value: value > 1)


def segments_of(kf, z, begins, limit, patience):
    """Return the segment of each fix of z (N, m) as `gated` does.

    A recording begins at each row of `begins`: the filter restarts there, no segment continues across it, and the step
    to it is no jump. The filter starts row 0 from x0 and P0 unless a recording begins there.
    """
    try:
        found = _segments_in_sequence(_RowFilter(kf, z), begins, limit, patience)
    except np.linalg.LinAlgError:
        checks.refuse("kf", "covariances that doubles can hold over these epochs", "one that is not positive")
    if len(begins) == 0 and np.isfinite(z).any() and not found[0]:
        nis = metrics.nis(kf, z)
        off = math.sqrt(nis[np.isfinite(nis)][0])
        where = "say where the track begins: x0 at the first fix, and a P0 that holds its position and velocity"
        checks.warn(f"gated: the first fixes are {off:.0f} standard deviations from x0: {where}")
    found = [rows for rows in found if rows]
    number = np.full(len(z), -1)
    if found:
        recording = np.searchsorted(begins, np.arange(len(z)), side="right")
        moves = _Moves(found, z / np.sqrt(np.diag(kf.model.R)), kf.times_of(len(z)).ravel(), recording)
        found = _without_stuck_fixes(_without_excursions(found, moves), moves)
        for k, rows in enumerate(_cheapest_chain(found, moves)):
            number[rows] = k
    return number


class _RowFilter:
    """The Kalman filter of a track z (N, m), one row at a time.

    A state is a matrix [[P, x], [xᵀ, -c]] (n + 1, n + 1), with the sum c of all NIS so far. One product predicts it,
    and sets z against it; the Schur complement of S corrects it:

                   [ H F  0 ]         [ H F  0 ]ᵀ   [ H Q Hᵀ + R  H Q  -z ]   [ S      H P   H x - z ]
        state  ->  [  F   0 ]  state  [  F   0 ]  + [   Q Hᵀ       Q    0 ] = [ P Hᵀ    P       x    ]
                   [  0   1 ]         [  0   1 ]    [   -zᵀ        0    0 ]   [ ...     xᵀ     -c    ]

    A missing measurement has a row of zeros in H and z, and of the identity in R. Lists have an item for each row.
    """

    def __init__(self, kf, z):
        self.kf, self.seen = kf, np.isfinite(z)
        self.fixes = self.seen.any(axis=1)
        self.z = np.where(self.seen, z, 0.0)
        model, epochs = kf.model, kf.epochs_of(z[..., None])
        (N, m), n = z.shape, model.n
        R = epochs.noise(model.R)[..., 0]
        self.R = np.where(self.seen[:, :, None] & self.seen[:, None], R, np.eye(m))
        self.H = self.seen[:, :, None] * model.H
        F, Q = (model.F, model.Q) if epochs.dt is None else model.over(epochs.dt[:, 0])
        HQ = self.H @ Q
        step, noise = np.zeros((N, m + n + 1, n + 1)), np.zeros((N, m + n + 1, m + n + 1))
        step[:, :m, :n], step[:, m:-1, :n], step[:, -1, -1] = self.H @ F, F, 1.0
        noise[:, :m, :m], noise[:, :m, m:-1], noise[:, :m, -1] = HQ @ self.H.swapaxes(1, 2) + self.R, HQ, -self.z
        noise[:, m:-1, :m], noise[:, m:-1, m:-1] = HQ.swapaxes(1, 2), Q
        noise[:, -1, :m] = -self.z
        self.steps, self.noises = list(step), list(noise)
        self.large = (MUCH_LARGER * self.R.trace(axis1=1, axis2=2)).tolist()
        self.x, self.P = model.F @ model.x0, predicted_covariance(model, model.P0)  # of a start, before its fix
        self.starts = {}
        least = np.diagonal(self.R, 0, 1, 2)[self.seen].min(initial=math.inf)
        self.diffuse = (model.H @ self.P @ model.H.T).max() > TOO_LARGE * least

    def after(self, state, k):
        """Return the state after row k without and with its measurement, the NIS, and S."""
        # On such small matrices `dot` and LAPACK's own routine are much faster than `@` and np.linalg.
        m, step = self.z.shape[1], self.steps[k]
        both = step.dot(state).dot(step.T) + self.noises[k]
        S, predicted = both[:m, :m], both[m:, m:]
        _, solved, fails = dposv(S, both[:m, m:])
        corrected = predicted - both[m:, :m].dot(solved)
        nis = float(predicted[-1, -1] - corrected[-1, -1])
        if fails or not nis < math.inf:
            raise np.linalg.LinAlgError
        if sum(S.diagonal().tolist()) > self.large[k]:
            corrected[:-1, :-1] = corrected_covariance(predicted[:-1, :-1], solved[:, :-1].T, self.H[k], self.R[k])
        return predicted, corrected, nis, S

    def start(self, k):
        """Return the state after row k as a first fix: x0 and P0 are moved there."""
        H, R, z = self.H[k], self.R[k], self.z[k]
        conditions = self.seen[k].tobytes(), R.tobytes()
        if conditions not in self.starts:
            H_1, W = unit_measurements(H, R)
            K = gain(self.P, H, R)
            self.starts[conditions] = np.linalg.pinv(H_1) @ W, K, corrected_covariance(self.P, K, H, R)
        to_fix, K, P = self.starts[conditions]
        x = self.x + to_fix @ (z - H @ self.x)
        return _state(x + K @ (z - H @ x), P)

    def before_a_fault(self, stop, limit):
        """Return the fixes before the first fault, up to row `stop`, and the state after them; also the next row.

        With a P0 so diffuse that P would lose its digits row by row, the engine takes these rows; otherwise none.
        """
        model, z = self.kf.model, np.where(self.seen, self.z, np.nan)
        count, state = 0, _state(model.x0, model.P0)
        if self.diffuse:
            z[stop:] = np.nan
            faults = np.flatnonzero(metrics.nis(self.kf, z) > limit)
            count = int(faults[0]) if len(faults) else stop
            z[count:] = np.nan
            state = _state(*(each[count - 1] for each in self.kf.estimates(z))) if count else state
        return _Start(np.flatnonzero(self.fixes[:count]).tolist(), state), count


def _state(x, P):
    """Return the state of a `_RowFilter`, (n + 1, n + 1)."""
    state = np.zeros((len(x) + 1, len(x) + 1))
    state[:-1, :-1], state[:-1, -1], state[-1, :-1] = P, x, x
    return state


class _Start(NamedTuple):
    """A new start: the rows of refused fixes that agree with each other, and the state after them."""

    rows: list[int]
    state: Array  # of a `_RowFilter`, (n + 1, n + 1)


def _segments_in_sequence(row_filter, begins, limit, patience):
    """Return the rows of each segment by rules 1 and 2, ordered by first row."""
    found, seen = [], row_filter.seen
    for begin, stop in pairwise(sorted({0, *begins, len(seen)})):
        if begin not in begins:
            start, begin = row_filter.before_a_fault(stop, limit)
            found += _segments_of_recording(row_filter, start, begin, stop, limit, patience)
            continue
        # Only a fix with all axes says where each of them begins.
        whole = begin + np.flatnonzero(seen[begin:stop].all(axis=1))
        if len(whole):
            first = int(whole[0])
            start = _Start([first], row_filter.start(first))
            found += _segments_of_recording(row_filter, start, first + 1, stop, limit, patience)
    return found


def _segments_of_recording(row_filter, start, begin, stop, limit, patience):
    """Return the rows of each segment from row `begin` to `stop`; the first segment begins with the rows of a start."""
    (rows, state), found, starts = start, [], []
    for k in range(begin, stop):
        without_fix, with_fix, nis, S = row_filter.after(state, k)
        if not row_filter.fixes[k]:
            state = without_fix
            starts = [_Start(each.rows, row_filter.after(each.state, k)[0]) for each in starts]
            continue
        agreed, expected = [], nis <= limit
        for each in starts:
            _, own, own_nis, own_S = row_filter.after(each.state, k)
            if own_nis <= limit:
                agreed.append(_Start([*each.rows, k], own))
                expected = expected and _deviance(nis, S) <= _deviance(own_nis, own_S) + CLEARLY_LOWER
        if expected:
            state, starts = with_fix, []
            rows.append(k)
            continue
        state, starts = without_fix, [*agreed, _Start([k], row_filter.start(k))]
        if len(starts[0].rows) == patience:
            found.append(rows)
            (rows, state), starts = starts[0], []
    return [*found, rows]


def _deviance(nis, S):
    """Return -2 log of the probability density of an innovation, without its constant."""
    return nis + float(np.linalg.slogdet(S)[1])


class _Moves:
    """Distances and speeds between fixes z (N, m), in units of their noise.

    The steps within the segments found tell the usual speed. No move between two recordings is too fast.
    """

    def __init__(self, found, z, times, recording):
        self.z, self.times, self.recording = z, times, recording
        a = np.concatenate([rows[:-1] for rows in found]).astype(int)
        b = np.concatenate([rows[1:] for rows in found]).astype(int)
        speeds = self.speed(a, b)[times[b] > times[a]]
        self.usual = float(np.quantile(speeds, OF_STEPS)) if len(speeds) else math.inf
        self.gap = GAP * float(np.median(times[b] - times[a])) if len(a) else math.inf

    def distance(self, a, b):
        """Return the distance between fixes a and b along the axes that both have."""
        return np.sqrt(np.nansum((self.z[b] - self.z[a]) ** 2, axis=-1))

    def speed(self, a, b):
        """Return the speed from fixes a to later fixes b."""
        return self.distance(a, b) / np.maximum(self.times[b] - self.times[a], LEAST_STEP)

    def too_fast(self, a, b, at_most=FASTER):
        """Tell which moves from fixes a to b exceed `at_most` times the usual speed."""
        return (self.recording[a] == self.recording[b]) & (self.speed(a, b) > at_most * self.usual)


def _without_excursions(found, moves):
    """Return the segments without those at one wrong position, such as 0° N 0° E, from which the track returns."""
    if moves.usual == 0:  # a track on a coarse grid, which stands still in most steps
        return found
    rows, left = np.concatenate(found), []
    for own, following in zip(found, [*found[1:], None], strict=True):
        steps = [(left[-1][-1], own[0])] if left else []
        steps += [(own[-1], following[0])] if following else []
        steps = [(a, b) for a, b in steps if moves.recording[a] == moves.recording[b]]
        if not steps or not _is_excursion(own, steps, rows, moves):
            left.append(own)
    return left


def _is_excursion(own, steps, rows, moves):
    """Tell whether a segment stays at a wrong position, judging by the steps to it and away from it.

    Both steps are too fast, while the step that bypasses the segment is not. At either end of a recording there is only
    one step, which must be impossibly fast. Of the two positions, the one with more fixes is right.
    """
    both = len(steps) == 2
    if not all(moves.too_fast(a, b, FASTER if both else IMPOSSIBLE) for a, b in steps):
        return False
    if both and moves.too_fast(steps[0][0], steps[1][1]):
        return False
    near = HARDLY * min(moves.distance(a, b) for a, b in steps)
    stays = moves.distance(own, own[0]).max() <= near
    elsewhere = steps[0][0] if steps[0][1] == own[0] else steps[0][1]
    here, there = ((moves.distance(rows, row) <= near).sum() for row in (own[0], elsewhere))
    return stays and here < there


def _without_stuck_fixes(found, moves):
    """Return the rows of the segments without those where a receiver without signal was stuck at one position.

    Fixes are stuck if the step after them is too fast, the straight line from the fix before them is not, and the
    mobile arrived at about the speed of that line. After a rest instead, the fast step is a jump. For example, in the
    middle of a track that moves at 1 m/s:

        time (s)          0   1   2   3   4   5   6   7   8
        true position     0   1   2   3   4   5   6   7   8
        recorded          0   1   2   3   3   3   3   7   8
                             before  tail ...    k   k + 1

    The step of 4 m from k is too fast. The fixes from `tail` to k lie within a tenth of it. The line from the fix
    before them to k + 1 is 5 m in 5 s, the usual speed, and the mobile arrived at 1 m/s. So the four fixes at 3 m are
    refused.
    """
    rows = np.concatenate(found)
    stuck = np.zeros(len(rows), dtype=bool)
    for k in np.flatnonzero(moves.too_fast(rows[:-1], rows[1:])):
        near = HARDLY * moves.distance(rows[k], rows[k + 1])
        tail = k
        while tail > 0 and not stuck[tail - 1] and moves.distance(rows[tail - 1], rows[k]) <= near:
            tail -= 1
        if tail == 0:
            continue
        arrived = moves.speed(rows[max(tail - 1 - STUCK, 0)], rows[tail - 1])
        # Fixes that still move, faster than half the speed of arrival, are good.
        while tail < k and moves.speed(rows[tail], rows[tail + 1]) > arrived / 2:
            tail += 1
        before, after = rows[tail - 1], rows[k + 1]
        if k + 1 - tail < STUCK or moves.too_fast(before, after):
            continue
        # If they spread further, the fixes before and after them are the ones at a wrong position.
        stands = moves.distance(rows[tail:k], rows[k]).max() <= HARDLY * moves.distance(before, after)
        speed = moves.speed(before, after)
        stuck[tail : k + 1] = stands and ARRIVED * speed <= arrived <= speed / WENT_ON
    refused = set(rows[stuck].tolist())
    left = ([row for row in each if row not in refused] for each in found)
    return [each for each in left if each]


def _cheapest_chain(found, moves):
    """Return the rows of the segments that are kept by rule 3; those without a jump between them are joined.

    A segment is dropped by parts: the fixes between two that are refused, and those at its ends, one or a few beyond a
    gap, which may be faults that agreed with the others by chance. The cheapest chain that ends with part j, which
    follows part i or is the first, costs, compared to dropping all fixes,

        cost[j] = to_keep[j] - fixes of part j + min(0, min over i of (cost[i] + JUMP if there is one))
    """
    parts, segment = [], []
    for number, rows in enumerate(found):
        own = _droppable_parts(rows, moves)
        parts += own
        segment += [number] * len(own)
    rows, part = np.concatenate(parts), np.repeat(np.arange(len(parts)), [len(each) for each in parts])
    too_fast = moves.too_fast(rows[:-1], rows[1:]) & (part[:-1] == part[1:])
    to_keep = JUMP * np.minimum(np.bincount(part[1:][too_fast], minlength=len(parts)), MOST_TOO_FAST)

    def jump(i, j):
        """Tell whether the move from the end of part i to the start of part j, of another segment, is too fast.

        If parts are dropped between the two, it must not exceed the usual speed: otherwise parts would be dropped just
        to lower it.
        """
        at_most = 1.0 if j > i + 1 else FASTER
        return segment[i] != segment[j] and bool(moves.too_fast(parts[i][-1], parts[j][0], at_most))

    cost, before = [], []  # before[j]: the part that is kept before j, or None
    for j in range(len(parts)):
        ways = [(0, 0, None)] if j < LOOK_BACK else []  # cost, how far back i is, and i
        ways += [(cost[i] + JUMP * jump(i, j), j - i, i) for i in range(max(j - LOOK_BACK, 0), j)]
        least, _, i = min(ways)  # of equal costs the nearest
        cost.append(int(to_keep[j]) - len(parts[j]) + least)
        before.append(i)
    j = min(range(len(parts))[-LOOK_BACK:], key=lambda j: (cost[j], -j))
    kept = []
    while j is not None:
        kept.insert(0, j)
        j = before[j]
    joined = [list(parts[kept[0]])]
    for i, j in pairwise(kept):
        if jump(i, j) or moves.recording[parts[i][-1]] != moves.recording[parts[j][0]]:
            joined.append([])
        joined[-1] += parts[j]
    return joined


def _droppable_parts(rows, moves):
    """Return the parts of a segment: the rows between two refused fixes, its ends, and a few fixes beyond a gap."""
    before = np.arange(1, len(rows))  # the number of fixes before each step
    near_an_end = np.minimum(before, len(rows) - before) < JUMP
    apart = (np.diff(rows) > 1) | (near_an_end & (np.diff(moves.times[rows]) > moves.gap))
    cuts = {0, 1, *before[apart].tolist(), len(rows) - 1, len(rows)}
    return [rows[begin:end] for begin, end in pairwise(sorted(cuts))]
