"""One long track as many short ones: Lainiotis' partition.

The Lainiotis filter takes a step as if x(k) were known exactly, and adds afterwards what is not known of it. That holds
for many steps as well as for one. So a long track is cut into pieces that run side by side, as columns:

1. every piece from a start that is known exactly: what it makes of its measurements, how it answers to its start, and
   what its measurements tell about its start;
2. the starts, one after the other: each takes one Lainiotis step over a whole piece;
3. every piece again, from its own start. It must end where the next one started.

Instead of N steps one after the other there are two runs of K rows, side by side, and N / K starts.
"""

import math
from functools import partial

import numpy as np

from .equations import corrected_covariance, gain_on_the_start

# Fewer rows than this are not worth cutting, nor are tracks by the hundred, which fill the processor without. Measured.
LEAST_ROWS = 30
MOST_TRACKS = 64
# The starts of pieces lose digits where a piece holds several long gaps. So each piece must start where the one before
# it ends, to this part of a sigma (tracks with pauses of an hour reach 1e-7) or to the rounding of the states. If one
# does not, all pieces run again from these ends, MOST_PASSES times in all. Then the track is not cut.
AGREED = 1e-6
ROUNDING = 16 * np.finfo(float).eps
# Variances along the axes of correlations that are smaller than this count as this: P rounds to some 1e-14, which is no
# disagreement.
NARROWEST = 1e-7
MOST_PASSES = 3


def rows_per_piece(N, tracks):
    """Return K, how many rows a piece has: N where cutting does not pay.

    >>> rows_per_piece(12_000, tracks=1), rows_per_piece(12_000, tracks=1000)
    (55, 12000)
    """
    if N < LEAST_ROWS or tracks > MOST_TRACKS:
        return N
    return max(8, math.ceil(math.sqrt(N * tracks) / 2))


def through(advance, rows, x0, P0, x, P):
    """Write the states x(1) ... x(N) of rows to x (N, n, c, M), and P(1) ... P(N) to P (N, n, n, M) unless it is None.

    advance(row, x, P) returns columns x (n, c, M) and P (n, n, M) one row further, and the innovations at unit
    covariance. x0 and P0 are the start; where noises have joined the state, only its first n components are written.
    rows can be iterated, cut by `mapped`, and given more tracks by `with_tracks_of_zeros`, as `columns.Rows`. They are
    not cut where that would cost digits. Returns the last P, of each piece if the rows are cut, and the least variance
    of all.
    """
    K = rows_per_piece(len(x), x.shape[2] * x.shape[3])
    found = None if len(x) == K else _in_pieces(advance, rows, K, x0, P0, x, P)
    if found is not None:
        return found
    _, last, least = _each_row(advance, rows, x0, P0, x, P)
    return last, least


def _each_row(advance, rows, x_k, P_k, x, P):
    """Write the states to x and the covariances to P unless it is None.

    Returns the last of both, whole, and the least variance of all.
    """
    n = x.shape[1]
    least = np.inf
    for k, row in enumerate(rows):
        x_k, P_k, _ = advance(row, x_k, P_k)
        x[k] = x_k[:n]
        least = min(least, np.einsum("jj...->j...", P_k[:n, :n]).min())
        if P is not None:
            P[k] = P_k[:n, :n]
    return x_k, P_k, least


def _in_pieces(advance, rows, K, x0, P0, x, P):
    """Do what `through` does, in pieces of K rows. Returns None where the pieces do not fit together."""
    N, n, _, M = x.shape
    pieces = rows.mapped(partial(cut, K=K))
    try:
        x_start, P_start = starts(advance, pieces, -(-N // K), x0, P0)
    except np.linalg.LinAlgError:  # too much of a start is lost over the gaps of a piece
        return None
    x_pieces = np.empty((K, n, *x_start.shape[1:]))
    P_pieces = None if P is None else np.empty((K, n, n, P_start.shape[2]))
    for _ in range(MOST_PASSES):
        x_last, P_last, least = _each_row(advance, pieces, x_start, P_start, x_pieces, P_pieces)
        # Each piece starts where the one before it ends, and the first one at x0.
        x_next = np.concatenate([x0, x_last[..., :-M]], axis=2)
        P_next = np.concatenate([P0, P_last[..., : -P0.shape[2]]], axis=2)
        if least >= 0 and _agree(x_start, P_start, x_next, P_next):
            x[...] = joined(x_pieces, N, M)
            if P is not None:
                P[...] = joined(P_pieces, N, M)
            return P_last, least
        x_start, P_start = x_next, P_next
    return None


def _agree(x, P, x_next, P_next):
    """Say whether pieces start at x (n, c, M) and P (n, n, M) where the ones before them end, at x_next and P_next.

    They are compared along the axes of P_next, each in its own sigma: after a gap a sum of states can be known far
    better than any state, and is what counts at the next measurement.
    """
    if not (np.isfinite(x_next).all() and np.isfinite(P_next).all()):
        return False
    sigma = np.sqrt(np.maximum(np.einsum("jj...->j...", P_next), 0))
    unit = np.where(sigma > 0, sigma, 1)
    apart = x - x_next
    apart = np.where(np.abs(apart) > ROUNDING * np.abs(x_next), apart, 0) / unit[:, None]
    units = unit * unit[:, None]
    variances, axes = np.linalg.eigh(np.moveaxis(P_next / units, 2, 0))
    axes = axes / np.sqrt(np.maximum(variances, NARROWEST))[:, None]
    of_x = axes.swapaxes(1, 2) @ np.moveaxis(apart, 2, 0)
    of_P = axes.swapaxes(1, 2) @ np.moveaxis((P - P_next) / units, 2, 0) @ axes
    return bool((np.abs(of_x) <= AGREED).all() and (np.abs(of_P) <= AGREED).all())


def cut(array, K):
    """Return an array (N, ..., M) as (K, ..., C M): C pieces side by side. The last one is filled up with its last row.

    >>> cut(np.arange(5)[:, None], K=2)
    array([[0, 2, 4],
           [1, 3, 4]])
    """
    N, M = len(array), array.shape[-1]
    C = -(-N // K)
    filled = np.concatenate([array, np.repeat(array[-1:], C * K - N, axis=0)])
    pieces = np.moveaxis(filled.reshape(C, K, *array.shape[1:]), 0, -2)
    return np.ascontiguousarray(pieces).reshape(*pieces.shape[:-2], C * M)


def joined(array, N, M):
    """Return the array (N, ..., M) that `cut` takes to this one (K, ..., C M).

    >>> joined(np.array([[0, 2, 4], [1, 3, 4]]), N=5, M=1)[:, 0]
    array([0, 1, 2, 3, 4])
    """
    pieces = np.moveaxis(array.reshape(*array.shape[:-1], -1, M), -2, 0)  # (C, K, ..., M)
    return pieces.reshape(-1, *pieces.shape[2:])[:N]


def starts(advance, pieces, count, x0, P0):
    """Return where each piece starts: x (n, c, C M) and P (n, n, C M), from x0 (n, c, M) and P0 (n, n, M).

    pieces are rows that were cut into `count` pieces, C. advance is that of `through`.

    Started from x instead of zero, a piece ends at x_piece + T x, and has the innovations e - L x. The e are white and
    of unit variance, so that y = L x + noise measures x: it is updated with y, and moves on by T. A filter of constant
    gain returns no innovations (m = 0), and nothing corrects its starts.
    """
    n, c, M = x0.shape
    width = count * M
    # Beside the c tracks of a column run n more without measurements, one from each unit start: they make T and L.
    x = np.zeros((n, c + n, width))
    x[:, c:] = np.eye(n)[..., None]
    P = np.zeros((n, n, width))
    innovations = []
    for row in pieces.with_tracks_of_zeros(n):
        x, P, new = advance(row, x, P)
        innovations.append(new)
    x, P = _matrices(x, M), _matrices(P, M)
    x_piece, T = x[..., :c], x[..., c:]
    L, y = _compressed(_matrices(np.concatenate(innovations), M), c)
    x_k, P_k = _matrices(x0, M)[0], _matrices(P0, M)[0]
    states, covariances = [x_k], [P_k]
    for i in range(count - 1):
        G = gain_on_the_start(P_k, L[i].swapaxes(1, 2))
        x_k = x_k + G @ (y[i] - L[i] @ x_k)
        P_k = corrected_covariance(P_k, G, L[i], np.eye(L.shape[2]))
        x_k = x_piece[i] + T[i] @ x_k
        P_k = P[i] + T[i] @ P_k @ T[i].swapaxes(1, 2)
        states.append(x_k)
        covariances.append(P_k)
    return _columns(states), _columns(covariances)


def _compressed(innovations, c):
    """Return L (..., p, n) and y (..., p, c), with p <= n: y = L x + noise is all that a piece tells of its start x.

    innovations (..., K m, c + n) are e, of the tracks from a start of zero, and beside them -L, of the unit starts.
    An orthogonal factor joins their K m rows into p, which keeps the digits that sums of squares lose.
    """
    Q, R = np.linalg.qr(-innovations[..., c:])
    return R, Q.swapaxes(-1, -2) @ innovations[..., :c]


def _matrices(array, M):
    """Return columns (a, b, C M) as matrices (C, M, a, b)."""
    a, b, width = array.shape
    return np.ascontiguousarray(np.moveaxis(array.reshape(a, b, width // M, M), (2, 3), (0, 1)))


def _columns(matrices):
    """Return a list of C matrices (M, a, b) as columns (a, b, C M)."""
    stacked = np.moveaxis(np.array(matrices), (0, 1), (2, 3))
    return np.ascontiguousarray(stacked).reshape(*stacked.shape[:2], -1)
