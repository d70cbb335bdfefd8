"""One long track as many short ones: Lainiotis' partitioning.

The Lainiotis filter takes a step as if x(k) were known exactly, and then accounts for its uncertainty. The same holds
for many epochs at once. So a long track is cut into pieces that run side by side, as columns:

1. Run each piece from a start that is assumed to be exact. This gives its estimate, its sensitivity to the start, and
   the information about the start in its measurements.
2. Find the starts. Each piece is now one long Lainiotis step, that is, one row of a much shorter track. Run that track,
   in pieces again if it is long.
3. Run each piece again, from its own start. It must end where the next one starts.

This works for any `advance` (`columns`): of a filter, of pieces, or of the smoother's backward pass. Its rows are a
tuple of arrays (N, ..., W), or None, z first.
"""

import math
from itertools import repeat

import numpy as np

from ..equations import start_gain

# Up to this many tracks, a numpy call costs more in overhead than in arithmetic.
FEW_TRACKS = 64
# Shorter tracks are not cut. Measured on one processor, with the rows "one track" of benchmarks/bench.py.
LEAST_ROWS = 30
# The starts lose digits where a piece has several long gaps. So each piece must start where the preceding one ends, to
# this fraction of a sigma (tracks with pauses of an hour reach 1e-7), or to the rounding of the largest state: a
# simulated constant acceleration is 1e11 sigmas from its origin after 100,000 rows.
MATCH_TOLERANCE = 1e-6
STATE_ROUNDING = 16 * np.finfo(float).eps
# The most runs of step 3. Where the pieces do not match, each runs again from the end of the preceding one; if they do
# not match after the last run, the track is filtered uncut.
MOST_PASSES = 3
# Eigenvalues of a correlation matrix are taken to be at least this: below its square, 1e-14, differences are rounding.
LEAST_EIGENVALUE = 1e-7


def run_rows(advance, rows, x0, P0, x, P):
    """Filter all rows from x0 (n, c, W) and P0 (n, n, W), in pieces where that is faster and loses no digits.

    The states x(1) ... x(N) are written to x (N, n, c, W), and P(1) ... P(N) to P (N, n, n, W) unless it is None.
    Returns the largest variances (W, n), NaN where the covariances exceeded double precision.
    """
    N, _, c, W = x.shape
    K, largest = rows_per_piece(N, c * W), None
    with np.errstate(invalid="ignore"):  # the root of an S that rounding made negative: NaN, which is refused
        if K < N:
            largest = _in_pieces(advance, rows, K, x0, P0, x, P)
        if largest is None:
            _, largest = _in_sequence(advance, rows, x0, P0, x, P)
    return largest


def _in_sequence(advance, rows, x_k, P_k, x, P):
    """Filter the rows in sequence. Returns the last P, and the largest variances as `run_rows`.

    An overflow persists to the last row; a negative variance may not.
    """
    largest = P_k.diagonal()
    least = np.zeros_like(largest)
    for k, row in enumerate(_one_by_one(rows)):
        x_k, P_k, _ = advance(row, x_k, P_k)
        x[k] = x_k
        variances = P_k.diagonal()
        least, largest = np.minimum(least, variances), np.maximum(largest, variances)
        if P is not None:
            P[k] = P_k
    valid = (least == 0).all(axis=1) & np.isfinite(P_k).all(axis=(0, 1))
    return P_k, np.where(valid[:, None], largest, np.nan)


def _in_pieces(advance, rows, K, x0, P0, x, P):
    """Filter the rows in pieces of K. Returns as `run_rows`; None also where the pieces do not match."""
    N, n, _, W = x.shape
    pieces = map_arrays(rows, lambda array: cut(array, K))
    try:
        x_start, P_start = (each[..., :-W] for each in boundary_states(advance, pieces, x0, P0))
    except np.linalg.LinAlgError:  # the gaps within a piece left no digit of its start
        return None
    x_pieces = np.empty((K, *x_start.shape))
    P_pieces = None if P is None else np.empty((K, *P_start.shape))
    for _ in range(MOST_PASSES):
        P_last, largest = _in_sequence(advance, pieces, x_start, P_start, x_pieces, P_pieces)
        # Each piece starts where the preceding one ends, the first at x0 and P0.
        x_next = np.concatenate([x0, x_pieces[-1, ..., :-W]], axis=-1)
        P_next = np.concatenate([P0, P_last[..., :-W]], axis=-1)
        if np.isfinite(largest).all() and boundaries_match(x_start, P_start, x_next, P_next):
            x[...] = uncut(x_pieces, N, W)
            if P is not None:
                P[...] = uncut(P_pieces, N, W)
            return largest.reshape(-1, W, n).max(axis=0)
        x_start, P_start = x_next, P_next
    return None


def map_arrays(rows, function):
    """Return the rows with a function applied to each of their arrays."""
    return tuple(None if array is None else function(array) for array in rows)


def _one_by_one(rows):
    """Yield one row after the other."""
    return zip(*(repeat(None) if array is None else array for array in rows), strict=False)


def rows_per_piece(N, tracks):
    """Return K, the number of rows per piece, or N where cutting does not pay.

    >>> rows_per_piece(12_000, tracks=1), rows_per_piece(12_000, tracks=1000)
    (37, 12000)
    """
    if N < LEAST_ROWS or tracks > FEW_TRACKS:
        return N
    return max(8, math.ceil(math.sqrt(N * tracks) / 3))


def cut(array, K):
    """Return an array (N, ..., W) as C pieces side by side (K, ..., C W). The last piece is padded with its last row.

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
    """Return the array (N, ..., W) that `cut` turned into this one (K, ..., C W).

    >>> uncut(np.array([[0, 2, 4], [1, 3, 4]]), N=5, W=1)[:, 0]
    array([0, 1, 2, 3, 4])
    """
    C = array.shape[-1] // W
    pieces = np.moveaxis(array.reshape(*array.shape[:-1], C, W), -2, 0)  # (C, K, ..., W)
    return pieces.reshape(C * len(array), *pieces.shape[2:])[:N]


def boundary_states(advance, pieces, x0, P0):
    """Return the starts of all pieces and the end of the last: x (n, c, (C + 1) W) and P (n, n, (C + 1) W).

    The first piece starts from x0 (n, c, W) and P0 (n, n, W).

    A piece started from zero ends at x_piece, with innovations e. Started from x it ends at x_piece + T x, with
    innovations e - L x, since a filter is linear. These are white with unit variance, so e = L x + noise is a
    measurement of x. A filter of constant gain returns no innovations, and its starts are not corrected.

    For example, a constant, F = 1 and Q = 0, is measured twice with H = 1 and R = 1. If it is known to be 0, the
    estimate stays 0: x_piece = 0 and e = [z1, z2]. If it is known to be 1 and both measurements are 0, the estimate
    stays 1: T = 1, with innovations [-1, -1] = -L. So e = L x + noise reads z1 = x + v1, z2 = x + v2.
    """
    n, c, W = x0.shape
    innovations = []
    for after in run_from_zero(advance, pieces, n):
        innovations.append(after[2])
    x, P, _ = after
    C = P.shape[-1] // W
    x, P, e = (uncut(each[None], C, W) for each in (x, P, np.concatenate(innovations)))  # a row for each piece
    L, y = compress_measurement(-e[:, :, c:], e[:, :, :c])
    rows = np.concatenate([x[:, :, :c], y], axis=1), x[:, :, c:], P, L
    x, P = np.empty((C + 1, n, c, W)), np.empty((C + 1, n, n, W))
    x[0], P[0] = x0, P0
    run_rows(advance_piece, rows, x0, P0, x[1:], P[1:])
    return cut(x, K=1)[0], cut(P, K=1)[0]


def run_from_zero(advance, rows, n):
    """Run rows of c tracks from an exactly known zero; yield x (n, c + n, W), P and the innovations of each row.

    n more tracks run alongside. Their measurements are zero and they start from the unit vectors: they end at the T of
    `boundary_states`, and have its -L as innovations.
    """
    _, m, c, W = rows[0].shape
    x, P, z = np.zeros((n, c + n, W)), np.zeros((n, n, W)), np.zeros((m, c + n, W))
    x[:, c:] = np.eye(n)[..., None]
    for z_k, *conditions in _one_by_one(rows):
        z[:, :c] = z_k
        x, P, e = advance((z, *conditions), x, P)
        yield x, P, e


def advance_piece(row, x, P):
    """Return x, P and the innovations after one piece: the `advance` of a track whose rows are pieces.

    It is one Lainiotis step, with F_n = T, P_n = P_piece and O_n = Lᵀ L. A row is z = [x_piece; y], T, P_piece and L of
    `boundary_states`. The start is corrected by the measurement y = L x + noise of unit variance, and propagated by T;
    P is that of `lainiotis_step` in fewer products.
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


def compress_measurement(L, y):
    """Reduce the measurement y = L x + noise of unit variance to p <= n rows that carry the same information.

    L (..., n, W) and y (..., c, W) have one row per innovation. With L = Q R, Qᵀ y = R x + Qᵀ noise: the noise stays
    white, and the components of y that Qᵀ drops are independent noise. Lᵀ L and Lᵀ y carry the same information, but
    lose digits by squaring. The order of the rows affects only rounding: the last rows come first, as they are the
    largest where x grows.
    """
    L, y = (np.moveaxis(each, -1, 0)[..., ::-1, :] for each in (L, y))  # stacks of matrices
    Q, R = np.linalg.qr(L)
    return tuple(np.moveaxis(each[..., ::-1, :], 0, -1) for each in (R, Q.swapaxes(-1, -2) @ y))


def boundaries_match(x, P, x_next, P_next):
    """Tell whether pieces start, at x (n, c, W) and P (n, n, W), where the preceding ones end, at x_next and P_next.

    They are compared along the principal axes of P_next, in units of sigma: after a gap, a sum of states can be known
    far better than any single state, and it is what the next measurement depends on. With U diag(d) Uᵀ = P_next, all
    components of these must be small:

        d^-½ Uᵀ (x - x_next),   d^-½ Uᵀ (P - P_next) U d^-½

    Each state is first divided by its own sigma, so that their units do not matter.
    """
    if not (np.isfinite(x_next).all() and np.isfinite(P_next).all()):
        return False
    sigma = np.sqrt(np.maximum(P_next.diagonal().T, 0))
    unit = np.where(sigma > 0, sigma, 1)
    units = unit * unit[:, None]
    variances, axes = np.linalg.eigh(np.moveaxis(P_next / units, 2, 0))
    axes = axes / np.sqrt(np.maximum(variances, LEAST_EIGENVALUE))[:, None]
    of_x = np.abs(axes.swapaxes(1, 2) @ np.moveaxis((x - x_next) / unit[:, None], 2, 0))
    of_P = np.abs(axes.swapaxes(1, 2) @ np.moveaxis((P - P_next) / units, 2, 0) @ axes)
    largest = np.moveaxis(np.abs(x_next / unit[:, None]).max(axis=0, keepdims=True), 2, 0)  # (W, 1, c), in sigmas
    rounding = STATE_ROUNDING * np.abs(axes).sum(axis=1)[..., None] * largest
    return bool((of_x <= MATCH_TOLERANCE + rounding).all() and (of_P <= MATCH_TOLERANCE).all())
