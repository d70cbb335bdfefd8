"""One long track as many short ones: Lainiotis' partition.

The Lainiotis filter takes a step as if x(k) were known exactly, and then accounts for its uncertainty. The same works
for many rows at once. So a long track is cut into pieces that run side by side, as columns:

1. Run every piece from a start that is taken as exact. This gives its estimate, its sensitivity to the start, and the
   information of its measurements about the start.
2. Find the starts. Each piece is now one long Lainiotis step, a row of a shorter track: run that track, in pieces
   again where it is long.
3. Run every piece again, from its own start. It must end where the next one starts.

It works for any `advance` (`columns`), whose rows are a tuple of arrays (N, ..., W), or None, z first: of a filter, of
pieces, or of the smoother's backward pass.
"""

import math
from itertools import repeat

import numpy as np

from ..equations import start_gain
from .shared import FEW_TRACKS

# Shorter tracks are not cut, nor are more than FEW_TRACKS. Measured on one processor, with the rows "one track" of
# benchmarks/bench.py.
LEAST_ROWS = 30
# The starts of pieces lose digits where a piece holds several long gaps. So each piece must start where the preceding
# one ends, to this fraction of a sigma (tracks with pauses of an hour reach 1e-7), or to the rounding of the largest
# state: a simulated constant acceleration is 1e11 sigmas from its origin after 100,000 rows.
AGREED = 1e-6
STATE_ROUNDING = 16 * np.finfo(float).eps
# The largest number of runs. Where pieces do not fit together, each runs again from where the preceding one ended; if
# they do not fit after the last run, the track is filtered uncut.
MOST_PASSES = 3
# Smaller eigenvalues of a correlation matrix count as this one: below its square, 1e-14, differences are rounding.
NARROWEST = 1e-7


def run_rows(advance, rows, x0, P0, x, P, vague=False):
    """Write the states x(1) ... x(N) of rows to x (N, n, c, W), and P(1) ... P(N) to P (N, n, n, W) unless it is None.

    They start from x0 (n, c, W) and P0 (n, n, W), which may be vague (`digits`). Rows are cut into pieces where that is
    faster and costs no digits. Returns whether doubles held the covariances.
    """
    if vague:
        try:
            k, x0, P0 = _from_a_vague_start(advance, rows, x0, P0, x, P)
        except np.linalg.LinAlgError:  # rounding has taken every digit of a P of the start
            return False
        rows, x, P = _of_each(rows, lambda array: array[k:]), x[k:], P if P is None else P[k:]
    N, _, c, W = x.shape
    K = rows_per_piece(N, c * W)
    with np.errstate(invalid="ignore"):  # the root of an S that rounding took below zero: NaN, which is refused
        if K < N and _in_pieces(advance, rows, K, x0, P0, x, P):
            return True
        _, held = _in_sequence(advance, rows, x0, P0, x, P)
    return held


def _in_sequence(advance, rows, x_k, P_k, x, P):
    """Do what `run_rows` does, one row after the other. Returns the last P, and whether doubles held all of them.

    An overflow persists to the last row; a variance below zero may come and go.
    """
    least_variance = 0.0
    for k, row in enumerate(_one_by_one(rows)):
        x_k, P_k, _ = advance(row, x_k, P_k)
        x[k] = x_k
        least_variance = min(least_variance, P_k.diagonal().min())
        if P is not None:
            P[k] = P_k
    return P_k, least_variance == 0 and bool(np.isfinite(P_k).all())


def _in_pieces(advance, rows, K, x0, P0, x, P):
    """Do what `run_rows` does, in pieces of K rows. Returns False where the pieces do not fit together."""
    N, W = len(x), x.shape[-1]
    pieces = _of_each(rows, lambda array: cut(array, K))
    try:
        x_start, P_start = (each[..., :-W] for each in starts(advance, pieces, x0, P0))
    except np.linalg.LinAlgError:  # the gaps of a piece left no digits of its start
        return False
    x_pieces = np.empty((K, *x_start.shape))
    P_pieces = None if P is None else np.empty((K, *P_start.shape))
    for _ in range(MOST_PASSES):
        P_last, held = _in_sequence(advance, pieces, x_start, P_start, x_pieces, P_pieces)
        # Each piece starts where the one before it ends, the first one at x0 and P0.
        x_next = np.concatenate([x0, x_pieces[-1, ..., :-W]], axis=-1)
        P_next = np.concatenate([P0, P_last[..., :-W]], axis=-1)
        if held and agree(x_start, P_start, x_next, P_next):
            x[...] = uncut(x_pieces, N, W)
            if P is not None:
                P[...] = uncut(P_pieces, N, W)
            return True
        x_start, P_start = x_next, P_next
    return False


def _of_each(rows, function):
    """Return rows with function applied to each of their arrays."""
    return tuple(None if array is None else function(array) for array in rows)


def _one_by_one(rows):
    """Yield one row after the other."""
    return zip(*(repeat(None) if array is None else array for array in rows), strict=False)


def rows_per_piece(N, tracks):
    """Return K, the number of rows of a piece: N where cutting does not pay.

    >>> rows_per_piece(12_000, tracks=1), rows_per_piece(12_000, tracks=1000)
    (37, 12000)
    """
    if N < LEAST_ROWS or tracks > FEW_TRACKS:
        return N
    return max(8, math.ceil(math.sqrt(N * tracks) / 3))


def cut(array, K):
    """Return an array (N, ..., W) as (K, ..., C W): C pieces side by side. The last one is filled up with its last row.

    >>> cut(np.arange(5)[:, None], K=2)
    array([[0, 2, 4],
           [1, 3, 4]])
    """
    N, W = len(array), array.shape[-1]
    C = -(-N // K)
    filled = np.concatenate([array, np.repeat(array[-1:], C * K - N, axis=0)])
    pieces = np.moveaxis(filled.reshape(C, K, *array.shape[1:]), 0, -2)
    return np.ascontiguousarray(pieces).reshape(*pieces.shape[:-2], C * W)


def uncut(array, N, W):
    """Return the array (N, ..., W) that `cut` takes to this one (K, ..., C W).

    >>> uncut(np.array([[0, 2, 4], [1, 3, 4]]), N=5, W=1)[:, 0]
    array([0, 1, 2, 3, 4])
    """
    C = array.shape[-1] // W
    pieces = np.moveaxis(array.reshape(*array.shape[:-1], C, W), -2, 0)  # (C, K, ..., W)
    return pieces.reshape(C * len(array), *pieces.shape[2:])[:N]


def starts(advance, pieces, x0, P0):
    """Return the starts of all pieces and the end of the last: x (n, c, (C + 1) W) and P (n, n, (C + 1) W).

    The first piece starts from x0 (n, c, W) and P0 (n, n, W).

    Started from x instead of zero, a piece ends at x_piece + T x: a filter is linear in x. Then it has the innovations
    e - L x, and these are white and of unit variance, so that e = L x + noise measures x. A filter of constant gain
    returns no innovations, and nothing corrects its starts.

    For example, a state that stays where it is, F = 1 and Q = 0, is measured twice, H = 1 and R = 1. Known to be at
    zero, it stays there: x_piece = 0, with innovations e = [z1, z2]. Known to be at 1, where both measurements are
    zero, it stays there too: T = 1, with innovations [-1, -1] = -L. So y = L x + noise reads z1 = x + v1, z2 = x + v2.
    """
    n, c, W = x0.shape
    innovations = []
    for after in _from_exact_zero(advance, pieces, n):
        innovations.append(after[2])
    x, P, _ = after
    C = P.shape[-1] // W
    x, P, e = (uncut(each[None], C, W) for each in (x, P, np.concatenate(innovations)))  # a row for each piece
    L, y = _compressed(-e[:, :, c:], e[:, :, :c])
    rows = np.concatenate([x[:, :, :c], y], axis=1), x[:, :, c:], P, L
    x, P = np.empty((C + 1, n, c, W)), np.empty((C + 1, n, n, W))
    x[0], P[0] = x0, P0
    run_rows(over_a_piece, rows, x0, P0, x[1:], P[1:])
    return cut(x, K=1)[0], cut(P, K=1)[0]


def _from_exact_zero(advance, rows, n):
    """Run rows of c tracks from a zero that is known exactly, and yield x (n, c + n, W), P and the innovations of each.

    Beside the c tracks run n more, which have no measurements and start at one of the unit vectors each: they end at T,
    and have the innovations -L of `starts`.
    """
    _, m, c, W = rows[0].shape
    x, P, z = np.zeros((n, c + n, W)), np.zeros((n, n, W)), np.zeros((m, c + n, W))
    x[:, c:] = np.eye(n)[..., None]
    for z_k, *conditions in _one_by_one(rows):
        z[:, :c] = z_k
        x, P, e = advance((z, *conditions), x, P)
        yield x, P, e


def over_a_piece(row, x, P):
    """Return x, P and the innovations after one piece: the `advance` of a track whose rows are pieces.

    It is one Lainiotis step. A row holds z = [x_piece; y], T, P_piece and L of `starts`. The start is corrected by
    y = L x + noise of unit variance, with P in Joseph's form, and moves on by T.
    """
    n = len(x)
    z, T, P_piece, L, x, P = (each.transpose(2, 0, 1) for each in (*row, x, P))  # stacks of matrices
    L_t = L.swapaxes(-1, -2)
    innovations = z[:, n:] - L @ x
    root_of_S = np.linalg.cholesky(L @ P @ L_t + np.eye(L.shape[1]))
    TG = T @ start_gain(P, L_t)
    keep = T - TG @ L
    x = z[:, :n] + T @ x + TG @ innovations
    P = keep @ P @ keep.swapaxes(-1, -2) + TG @ TG.swapaxes(-1, -2) + P_piece
    P = (P + P.swapaxes(-1, -2)) / 2
    innovations = np.linalg.solve(root_of_S, innovations)
    return tuple(each.transpose(1, 2, 0) for each in (x, P, innovations))


def _from_a_vague_start(advance, rows, x0, P0, x, P):
    """Write the first rows as `run_rows` does, and return how many, x and P after the last.

    Taken row by row, the first updates from a vague start would lose the digits of P0 / R, and without process noise
    never regain them. So the rows 0 to k are one piece, which grows by a row at a time, and row k is its end. This goes
    on until each sensor of each track has measured 2 n times, or will not again.
    """
    n, c, W = x0.shape
    seen = rows[1]
    counts = np.cumsum(seen, axis=0)
    settled = ((counts >= 2 * n) | (counts == counts[-1])).all(axis=(1, 2))
    K = min(1 + np.sum(~settled), len(x))
    L, y = np.zeros((0, n, W)), np.zeros((0, c, W))
    first_rows = _of_each(rows, lambda array: array[:K])
    for k, (x_piece, P_piece, e) in enumerate(_from_exact_zero(advance, first_rows, n)):
        if seen[k].any():
            L, y = _compressed(np.concatenate([L, -e[:, c:]]), np.concatenate([y, e[:, :c]]))
        piece = np.concatenate([x_piece[:, :c], y]), x_piece[:, c:], P_piece, L
        x_k, P_k, _ = over_a_piece(piece, x0, P0)
        x[k] = x_k
        if P is not None:
            P[k] = P_k
    return K, x_k, P_k


def _compressed(L, y):
    """Return y = L x + noise of unit variance as p <= n rows of the same information.

    The given L (..., n, W) and y (..., c, W) have a row for each innovation of a piece. With L = Q R,
    Qᵀ y = R x + Qᵀ noise: the noise stays white, and the part of y that Qᵀ drops is noise alone, independent of the
    rest. Lᵀ L and Lᵀ y hold the same information, but sums of squares lose digits that R keeps. The order of the rows
    changes only the rounding: the last rows come first, as they are the largest where x grows.
    """
    L, y = (np.moveaxis(each, -1, 0)[..., ::-1, :] for each in (L, y))  # stacks of matrices
    Q, R = np.linalg.qr(L)
    return tuple(np.moveaxis(each[..., ::-1, :], 0, -1) for each in (R, Q.swapaxes(-1, -2) @ y))


def agree(x, P, x_next, P_next):
    """Say whether pieces start where the preceding ones end: x (n, c, W), P (n, n, W) at x_next, P_next.

    They are compared along the axes of P_next, each in its own sigma: after a gap a sum of states can be known far
    better than any single state, and it decides at the next measurement. With U diag(d) Uᵀ = P_next, the components of
    these must be small:

        d^-½ Uᵀ (x - x_next),   d^-½ Uᵀ (P - P_next) U d^-½

    Each state is taken in its own sigma first, so that states of any units may stand side by side.
    """
    if not (np.isfinite(x_next).all() and np.isfinite(P_next).all()):
        return False
    sigma = np.sqrt(np.maximum(P_next.diagonal().T, 0))
    unit = np.where(sigma > 0, sigma, 1)
    units = unit * unit[:, None]
    variances, axes = np.linalg.eigh(np.moveaxis(P_next / units, 2, 0))
    axes = axes / np.sqrt(np.maximum(variances, NARROWEST))[:, None]
    of_x = np.abs(axes.swapaxes(1, 2) @ np.moveaxis((x - x_next) / unit[:, None], 2, 0))
    of_P = np.abs(axes.swapaxes(1, 2) @ np.moveaxis((P - P_next) / units, 2, 0) @ axes)
    largest = np.moveaxis(np.abs(x_next / unit[:, None]).max(axis=0, keepdims=True), 2, 0)  # (W, 1, c), in sigmas
    rounding = STATE_ROUNDING * np.abs(axes).sum(axis=1)[..., None] * largest
    return bool((of_x <= AGREED + rounding).all() and (of_P <= AGREED).all())
