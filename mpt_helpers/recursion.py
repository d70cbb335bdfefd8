"""Run s(k+1) = A_k s(k) + B_k z(k+1) over one track or many: the on-line half of every filter.

No A_k, B_k depends on the measurements, so several steps in a row are one matrix product:

    [x(k+1) ... x(k+L)] = W [s(k) z(k+1) ... z(k+L)]

and W is the same for all tracks, and for all blocks of steps with the same coefficients.
"""

from itertools import islice
from typing import NamedTuple

import numpy as np

from . import checks

TILE = 16_384  # tracks at a time: a block of them stays in the cache, so that a track costs the same however many
CHUNK = 500_000  # so many measurements, or eight rows, are looked at together for missed epochs: the masks stay small


class System(NamedTuple):
    """The coefficients of N steps: step k has A[of[k]] and B[of[k]], of A (U, p, p) and B (U, p, m)."""

    A: np.ndarray
    B: np.ndarray
    of: np.ndarray


def measurements(z, m):
    """Check measurements and mark the missed epochs.

    z is (N, m) for one track or (N, m, M) for M tracks. A row that is all NaN is a missed epoch.

    Returns z as floats in C order with its missed rows set to zero (z itself where it is that: not to be written to),
    and the boolean `missed`, (N,) or (N, M). Raises ValueError for another shape, an empty or infinite z or a row that
    is only partly NaN, TypeError for data that are not real numbers.

    >>> measurements([[1.0], [np.nan]], m=1)
    (array([[1.],
           [0.]]), array([False,  True]))
    """
    z = shaped(z, m)
    with np.errstate(all="ignore"):
        complete = np.isfinite(z.sum())  # no mask as large as z
    if complete:
        return z.astype(float, order="C", copy=False), np.broadcast_to(False, (z.shape[0], *z.shape[2:]))
    _require_finite(z)
    missed = _missed(z)
    return np.where(np.expand_dims(missed, 1), 0.0, z).astype(float, order="C", copy=False), missed


def shaped(z, m):
    """Return z as an array if it has the shape and the kind of measurements, or raise; its numbers are not looked at.

    >>> shaped([1.0], m=1)
    Traceback (most recent call last):
    ...
    ValueError: z: needs an (N, 1) or (N, 1, M) array, got shape (1,)
    """
    need = _need(m)
    z = checks.numbers("z", z, need)
    if z.dtype.itemsize > np.dtype(float).itemsize:
        with np.errstate(over="ignore"):  # of what is longer than a double: it is infinite here
            z = z.astype(float)
    if z.ndim not in (2, 3) or z.shape[1] != m or 0 in z.shape:
        checks.refuse("z", need, f"shape {z.shape}" if z.ndim else "a scalar")
    return z


def _need(m):
    return f"an (N, {m}) or (N, {m}, M) array"


def _missed(z, first=0):
    """Return which rows are all NaN; raise for one that is partly NaN, `first` being the number of the first row."""
    lost = np.isnan(z)
    missed = lost[:, 0] if z.shape[1] == 1 else lost.all(axis=1)
    if z.shape[1] > 1 and len(partly := np.argwhere(lost.any(axis=1) & ~missed)):
        row, *track = partly[0]
        place = f"row {first + row}" + "".join(f" of track {t}" for t in track if z.shape[2:] != (1,))
        checks.refuse("z", "rows that are all numbers or all NaN (a missed epoch)", f"{place} partly NaN")
    return missed


def _require_finite(z):
    if np.isinf(z).any():
        checks.refuse("z", f"{_need(z.shape[1])} of finite numbers", "an infinite value")


def run(blocks, z, start, n):
    """Run the recursion over measurements of which some may be missed.

    blocks maps the missed epochs, a boolean array (N,), and how many steps to take at once to their `lift`; z is that
    of `shaped`, with its rows of NaN; start is s(0), of length p, and the estimate is the first n entries of s. Tracks
    that miss the same epochs share their coefficients.

    Returns the estimates, (N, n) or (N, n, M): row k is x(k+1/k+1). Raises ValueError as `measurements` does.

    >>> halves = System(np.full((1, 1, 1), 0.5), np.full((1, 1, 1), 0.5), np.zeros(2, int))
    >>> run(lambda missed, L: lift(halves, L, n=1), np.array([[1.0], [1.0]]), np.zeros(1), n=1)
    array([[0.5 ],
           [0.75]])
    """
    one = z.ndim == 2
    z = z[..., None] if one else z
    start = start[:, None]
    # Most tracks miss what the first one does. Those that do not show it: NaN, infinity and 0·NaN stay not finite to
    # the last row, so that the input needs no pass of its own.
    pattern = np.isnan(z[:, 0, 0])
    with np.errstate(invalid="ignore"):
        x = advance(blocks(pattern, steps_at_once(n, z.shape[2])), z, pattern, start, n)
    alike = np.isfinite(x[-1]).all(axis=0)
    for k in np.flatnonzero(pattern):
        alike &= np.isnan(z[k]).all(axis=0)
    others = np.flatnonzero(~alike)
    if len(others):
        for missed, which in _patterns(z, others):
            same = np.argmax(np.append(missed != pattern, True)) if len(start) == n else 0  # steps that are right
            for tracks in np.array_split(others[which], -(-which.sum() // TILE)):
                with np.errstate(invalid="ignore"):  # of estimates that overflow
                    _fill(x, tracks, blocks(missed, steps_at_once(n, len(tracks))), z, missed, start, same)
        if not np.isfinite(x[-1]).all():
            _require_finite(z)
    return x[..., 0] if one else x


def _patterns(z, tracks):
    """Give each pattern of missed epochs (N,) of these tracks and the boolean of those that have it."""
    N, _, M = z.shape
    rows = 8 * -(-CHUNK // (8 * M))
    packed = np.concatenate([_eight_to_a_byte(_missed(z[k : k + rows], k)) for k in range(0, N, rows)])[:, tracks]
    strings = np.ascontiguousarray(packed.T).view(f"V{len(packed)}")  # of bytes, one for each track: it sorts fast
    _, first, pattern_of = np.unique(strings, return_index=True, return_inverse=True)
    for i, track in enumerate(first):
        yield np.unpackbits(packed[:, track], count=N).astype(bool), pattern_of.ravel() == i


def _eight_to_a_byte(missed):
    """Return what np.packbits does along the first axis, where it is slow."""
    padded = np.pad(missed, ((0, -len(missed) % 8), (0, 0))).view(np.uint8)
    return np.einsum("i,kij->kj", 1 << np.arange(7, -1, -1, dtype=np.uint8), padded.reshape(-1, 8, missed.shape[1]))


def steps_at_once(n, M):
    """Return how many steps of M tracks to take in one product: little work is bound by calls, much by the cache.

    >>> [steps_at_once(n=2, M=M) for M in (1, 100, 200, 10_000, 100_000)]
    [32, 16, 8, 4, 2]
    """
    work = n * min(M, TILE)
    return next(L for least, L in ((30_000, 2), (1_500, 4), (300, 8), (50, 16), (0, 32)) if work >= least)


class Blocks(NamedTuple):
    """A System of N steps, L at a time: block i takes [s(k) z(k+1) ... z(k+L)] by W[of[i]] (U, L n, p + L m) to the
    estimates x(k+1) ... x(k+L), and by rest[of[i]] (U, p - n, p + L m) to what else s(k+L) holds.
    """

    W: np.ndarray
    rest: np.ndarray
    of: list


def lift(system, L, n):
    """Return the Blocks of L steps of a system whose estimate is the first n entries of its state.

    >>> halves = System(np.full((1, 1, 1), 0.5), np.full((1, 1, 1), 0.5), np.zeros(4, int))
    >>> lift(halves, L=2, n=1).W
    array([[[0.5 , 0.5 , 0.  ],
            [0.25, 0.25, 0.5 ]]])
    """
    (A, B, of), N = system, len(system.of)
    p, m = B.shape[1:]
    steps = of[np.minimum(np.arange(-(-N // L) * L), N - 1)].reshape(-1, L)
    new = np.append(True, (steps[1:] != steps[:-1]).any(axis=1))
    W = np.empty((new.sum(), L, n, p + L * m))
    s = np.zeros((new.sum(), p, p + L * m))
    s[:, :, :p] = np.eye(p)
    for i, step in enumerate(steps[new].T):
        s = A[step] @ s
        s[:, :, p + i * m : p + (i + 1) * m] = B[step]
        W[:, i] = s[:, :n]
    return Blocks(W.reshape(len(W), L * n, -1), s[:, n:], (new.cumsum() - 1).tolist())


def advance(blocks, z, missed, start, n):
    """Return the estimates (N, n, M) of tracks z (N, m, M) that miss the same epochs, from s(0) = start (p, 1 or M).

    >>> sums = lift(System(np.ones((1, 1, 1)), np.ones((1, 1, 1)), np.zeros(3, int)), L=2, n=1)
    >>> advance(sums, np.array([[[1.0]], [[np.nan]], [[2.0]]]), np.array([False, True, False]), np.zeros((1, 1)), n=1)
    array([[[1.]],
    <BLANKLINE>
           [[1.]],
    <BLANKLINE>
           [[3.]]])
    """
    N, _, M = z.shape
    x = np.empty((N, n, M))
    for tile in tiles(M):
        _fill(x, tile, blocks, z, missed, start)
    return x


def _fill(x, tracks, blocks, z, missed, start, same=0):
    """Write the estimates of some tracks, a slice or their numbers, to x, where so many steps are the same already."""
    (N, m, M), n, p = z.shape, x.shape[1], len(start)
    L = (blocks.W.shape[2] - p) // m
    gaps = np.logical_or.reduceat(missed, np.arange(0, N, L)).tolist()
    begin = same // L
    start = np.broadcast_to(x[begin * L - 1] if begin else start, (p, M))[:, tracks]
    inputs = np.concatenate([start, np.zeros((L * m, start.shape[1]))])
    state, ahead = inputs[:n], inputs[p:].reshape(L, m, -1)
    flat, together = x.reshape(N * n, M), isinstance(tracks, slice)
    steps = zip(range(0, N, L), blocks.of, gaps, strict=True)
    for k, i, gap in islice(steps, begin, None):
        rows, out = z[k : k + L], slice(k * n, (k + L) * n)
        rows = rows[..., tracks] if together else rows.take(tracks, axis=2)  # faster than by index
        ahead[: len(rows)] = rows
        if gap:
            ahead[: len(rows)][missed[k : k + L]] = 0
        W = blocks.W[i, : len(rows) * n]
        following = np.matmul(W, inputs, out=flat[out, tracks] if together else None)
        if not together:
            flat[out, tracks] = following
        if p > n:
            inputs[n:p] = blocks.rest[i] @ inputs
        state[:] = following[-n:]


def tiles(M):
    """Return slices of equal width that cover M tracks, each narrow enough for the cache.

    >>> tiles(20_000)
    [slice(0, 10000, None), slice(10000, 20000, None)]
    """
    ends = np.linspace(0, M, -(-M // TILE) + 1).astype(int).tolist()
    return [slice(*ends[i : i + 2]) for i in range(len(ends) - 1)]
