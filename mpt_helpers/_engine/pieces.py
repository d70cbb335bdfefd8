"""One long track as many short ones: Lainiotis' partition.

The Lainiotis filter takes a step as if x(k) were known exactly, and adds afterwards what is not known of it. That holds
for many rows as well as for one. So a long track is cut into pieces that run side by side, as columns:

1. every piece from a start that is known exactly: its estimate, its sensitivity to the start, and what its measurements
   tell about the start;
2. the starts, one after the other: each takes one Lainiotis step over a whole piece;
3. every piece again, from its own start. It must end where the next one starts.

Instead of N rows one after the other there are two runs of K rows, side by side, and N / K starts.

run_rows(rows, x, P) yields x(k/k), P(k/k) and the innovations at unit covariance of one row after the other, from
x(0/0) and P(0/0): it is `run.in_sequence` with the `advance` of a filter (`columns`), or one step of the smoother.
"""

import math
from functools import partial

import numpy as np

from ..equations import gain_on_the_start
from .shared import FEW_TRACKS

# Fewer rows than this are not worth cutting, nor are tracks by the hundred, which fill the processor without. Measured
# on one processor, with the rows "one track" of benchmarks/bench.py.
LEAST_ROWS = 30
# The starts of pieces lose digits where a piece holds several long gaps. So each piece must start where the one before
# it ends, to this part of a sigma (tracks with pauses of an hour reach 1e-7), or to the rounding of the largest state:
# a simulated constant acceleration is 1e11 sigmas from its origin after 100,000 rows.
AGREED = 1e-6
STATE_ROUNDING = 16 * np.finfo(float).eps
# Where pieces do not fit together, all of them run again from where the ones before ended, so many times in all. Then
# the track is not cut.
MOST_PASSES = 3
# The floor of the eigenvalues of a correlation matrix, whose squares are some 1e-14: below it differences are rounding,
# and no disagreement.
NARROWEST = 1e-7


def through(run_rows, rows, x0, P0, x, P):
    """Write the states x(1) ... x(N) of rows to x (N, n, c, M), and P(1) ... P(N) to P (N, n, n, M) unless it is None.

    rows can be cut by `mapped`, and given more tracks by `with_tracks_of_zeros`, as `epochs.Rows`. They are cut into
    pieces where that is sooner done, and costs no digits. Returns the last P, of each piece where there are several, in
    which an overflow shows, and the least variance of all.
    """
    N, _, c, M = x.shape
    K = rows_per_piece(N, c * M)
    if K < N:
        found = _in_pieces(run_rows, rows, K, x0, P0, x, P)
        if found is not None:
            return found
    _, P_last, least_variance = _written(run_rows, rows, x0, P0, x, P)
    return P_last, least_variance


def _in_pieces(run_rows, rows, K, x0, P0, x, P):
    """Do what `through` does, in pieces of K rows. Returns None where the pieces do not fit together."""
    N, n, _, M = x.shape
    pieces = rows.mapped(partial(cut, K=K))
    try:
        x_start, P_start = starts(run_rows, pieces, count_of_pieces(N, K), x0, P0)
    except np.linalg.LinAlgError:  # too much of a start is lost over the gaps of a piece
        return None
    x_pieces = np.empty((K, n, *x_start.shape[1:]))
    P_pieces = None if P is None else np.empty((K, n, n, P_start.shape[2]))
    for _ in range(MOST_PASSES):
        x_last, P_last, least_variance = _written(run_rows, pieces, x_start, P_start, x_pieces, P_pieces)
        x_next, P_next = next_starts(x0, x_last), next_starts(P0, P_last)
        if least_variance >= 0 and agree(x_start, P_start, x_next, P_next):
            x[...] = uncut(x_pieces, N, M)
            if P is not None:
                P[...] = uncut(P_pieces, N, M)
            return P_last, least_variance
        x_start, P_start = x_next, P_next
    return None


def _written(run_rows, rows, x0, P0, x, P):
    """Write the states to x and the covariances to P unless it is None.

    Returns the last of both, of all d states, and the least variance of all.
    """
    n = x.shape[1]
    least_variance = np.inf
    for k, (x_k, P_k, _) in enumerate(run_rows(rows, x0, P0)):
        x[k] = x_k[:n]
        least_variance = min(least_variance, np.einsum("jj...->j...", P_k[:n, :n]).min())
        if P is not None:
            P[k] = P_k[:n, :n]
    return x_k, P_k, least_variance


def rows_per_piece(N, tracks):
    """Return K, the number of rows of a piece: N where cutting does not pay.

    >>> rows_per_piece(12_000, tracks=1), rows_per_piece(12_000, tracks=1000)
    (55, 12000)
    """
    if N < LEAST_ROWS or tracks > FEW_TRACKS:
        return N
    return max(8, math.ceil(math.sqrt(N * tracks) / 2))


def count_of_pieces(N, K):
    """Return C, the number of pieces of K rows that hold N rows; the last one may have room for more.

    >>> count_of_pieces(5, K=2)
    3
    """
    return -(-N // K)


def cut(array, K):
    """Return an array (N, ..., M) as (K, ..., C M): C pieces side by side. The last one is filled up with its last row.

    >>> cut(np.arange(5)[:, None], K=2)
    array([[0, 2, 4],
           [1, 3, 4]])
    """
    N, M = len(array), array.shape[-1]
    C = count_of_pieces(N, K)
    filled = np.concatenate([array, np.repeat(array[-1:], C * K - N, axis=0)])
    pieces = np.moveaxis(filled.reshape(C, K, *array.shape[1:]), 0, -2)
    return np.ascontiguousarray(pieces).reshape(*pieces.shape[:-2], C * M)


def uncut(array, N, M):
    """Return the array (N, ..., M) that `cut` takes to this one (K, ..., C M).

    >>> uncut(np.array([[0, 2, 4], [1, 3, 4]]), N=5, M=1)[:, 0]
    array([0, 1, 2, 3, 4])
    """
    pieces = np.moveaxis(array.reshape(*array.shape[:-1], -1, M), -2, 0)  # (C, K, ..., M)
    return pieces.reshape(-1, *pieces.shape[2:])[:N]


def next_starts(start, last):
    """Return the starts of pieces side by side, (..., C M), if each starts where the one before ends; last (..., C M).

    The first one starts at start (..., M).
    """
    M = start.shape[-1]
    return np.concatenate([start, last[..., :-M]], axis=-1)


def starts(run_rows, pieces, count, x0, P0):
    """Return the start of each piece: x (n, c, C M) and P (n, n, C M), from x0 (n, c, M) and P0 (n, n, M).

    pieces are rows that were cut into `count` pieces, C.

    Started from x instead of zero, a piece ends at x_piece + T x: a filter is linear in x. Then it has the innovations
    e - L x, and these are white and of unit variance, so that e = L x + noise measures x. Each start takes one
    Lainiotis step: it is corrected by what the piece measures of it, and moves on by T. A filter of constant gain
    returns no innovations, and nothing corrects its starts.

    For example, a state that stays where it is, F = 1 and Q = 0, is measured twice, H = 1 and R = 1. Known to be at
    zero, it stays there: x_piece = 0, with innovations e = [z1, z2]. Known to be at 1, where both measurements are
    zero, it stays there too: T = 1, with innovations [-1, -1] = -L. So y = L x + noise reads z1 = x + v1, z2 = x + v2.
    """
    n, c, M = x0.shape
    # All pieces run from a start of zero that is known exactly. Beside the c tracks of a column run n more, which have
    # no measurements and start at one of the unit vectors each: they end at T, and have the innovations -L.
    exact = np.zeros((n, c + n, count * M)), np.zeros((n, n, count * M))
    exact[0][:, c:] = np.eye(n)[..., None]
    innovations = []
    for x_P_and_innovations in run_rows(pieces.with_tracks_of_zeros(n), *exact):
        innovations.append(x_P_and_innovations[2])
    x_last, P_last, _ = x_P_and_innovations
    x, P_piece, e = (_as_matrices(each, M) for each in (x_last, P_last, np.concatenate(innovations)))
    x_piece, T = x[..., :c], x[..., c:]
    L, y = _compressed(-e[..., c:], e[..., :c])
    x_k, P_k = _as_matrices(x0, M)[0], _as_matrices(P0, M)[0]
    found = [(x_k, P_k)]
    pieces = [T, x_piece, P_piece, L, y]
    if M == 1:  # products of single matrices are much faster than those of stacks
        x_k, P_k, pieces = x_k[0], P_k[0], [each[:, 0] for each in pieces]
    for piece in zip(*(each[:-1] for each in pieces), strict=True):
        x_k, P_k = _next_start(x_k, P_k, *piece)
        found.append((x_k, P_k))
    return tuple(_as_columns([each.reshape(M, n, -1) for each in every]) for every in zip(*found, strict=True))


def _next_start(x, P, T, x_piece, P_piece, L, y):
    """Return the start of the next piece by one Lainiotis step over this one, from its start x (n, c), P (n, n).

    They may be stacks.

    First it is corrected by what the piece measures of it, y = L x + noise of unit variance, in Joseph's form.
    """
    G = gain_on_the_start(P, L.swapaxes(-1, -2))
    keep, TG = T @ (np.eye(P.shape[-1]) - G @ L), T @ G
    P = keep @ P @ keep.swapaxes(-1, -2) + TG @ TG.swapaxes(-1, -2) + P_piece
    return x_piece + keep @ x + TG @ y, (P + P.swapaxes(-1, -2)) / 2


def _compressed(L, y):
    """Return L (..., p, n) and y (..., p, c) of p <= n rows that tell as much of x: y = L x + noise of unit variance.

    Those given have a row for each innovation of a piece. With L = Q R, Qᵀ y = R x + Qᵀ noise. Q has orthonormal
    columns, so that the noise stays white. What Qᵀ drops of y is orthogonal to L x: it is noise alone, and independent
    of the noise that is kept. Lᵀ L and Lᵀ y would tell the same, but sums of squares lose digits that R keeps.
    """
    Q, R = np.linalg.qr(L)
    return R, Q.swapaxes(-1, -2) @ y


def agree(x, P, x_next, P_next):
    """Say whether pieces start at x (n, c, M) and P (n, n, M) where the ones before them end, at x_next and P_next.

    They are compared along the axes of P_next, each in its own sigma: after a gap a sum of states can be known far
    better than any state, and is what counts at the next measurement. With U diag(d) Uᵀ = P_next, the components of
    these must be small:

        d^-½ Uᵀ (x - x_next),   d^-½ Uᵀ (P - P_next) U d^-½

    of which the first has the squared norm (x - x_next)ᵀ P_next⁻¹ (x - x_next). Here each state is taken in its own
    sigma first, so that states of any units may stand side by side. x is rounded in proportion to its largest state.
    """
    if not (np.isfinite(x_next).all() and np.isfinite(P_next).all()):
        return False
    sigma = np.sqrt(np.maximum(np.einsum("jj...->j...", P_next), 0))
    unit = np.where(sigma > 0, sigma, 1)
    units = unit * unit[:, None]
    variances, axes = np.linalg.eigh(np.moveaxis(P_next / units, 2, 0))
    axes = axes / np.sqrt(np.maximum(variances, NARROWEST))[:, None]
    of_x = np.abs(axes.swapaxes(1, 2) @ np.moveaxis((x - x_next) / unit[:, None], 2, 0))
    of_P = np.abs(axes.swapaxes(1, 2) @ np.moveaxis((P - P_next) / units, 2, 0) @ axes)
    largest = np.moveaxis(np.abs(x_next / unit[:, None]).max(axis=0, keepdims=True), 2, 0)  # (M, 1, c), in sigmas
    rounding = STATE_ROUNDING * np.abs(axes).sum(axis=1)[..., None] * largest
    return bool((of_x <= AGREED + rounding).all() and (of_P <= AGREED).all())


def _as_matrices(array, M):
    """Return columns (a, b, C M) as matrices (C, M, a, b)."""
    a, b, width = array.shape
    return np.ascontiguousarray(np.moveaxis(array.reshape(a, b, width // M, M), (2, 3), (0, 1)))


def _as_columns(matrices):
    """Return a list of C matrices (M, a, b) as columns (a, b, C M)."""
    stacked = np.moveaxis(np.array(matrices), (0, 1), (2, 3))
    return np.ascontiguousarray(stacked).reshape(*stacked.shape[:2], -1)
