"""Diffuse starts: a P0 so large that updates row by row would lose its digits, and pauses that make P as large.

Row by row, each update takes the difference of two large numbers: beside a P0 of 1e12 R, doubles keep three digits. So
the first rows are taken as one piece (`pieces`), run from a start that is assumed to be exact. The start itself is
solved by a root of P0, which has twice as many digits. A long pause is a start, too.
"""

import numpy as np

from .. import _checks as checks
from ..equations import square_root, unit_measurements
from .columns import product
from .pieces import compress_measurement, map_arrays, run_from_zero, run_rows

# S is the variance of a predicted measurement due to P, in units of its noise. Above DIFFUSE_S, an update row by row
# leaves about three digits in P. The root of S, by which a diffuse start is solved, has twice as many digits: near
# LARGEST_S, P is wrong by some percent, at 1e24 by a thousandth. Below CLEAR_S, updates row by row keep nine digits.
DIFFUSE_S = 1e12
CLEAR_S = 1e6
LARGEST_S = 1e30
# A start is over where the process noise since then makes an S larger than this fraction of the last one: P, rounded
# by 2e-16 of its S, keeps nine digits beside that noise. If the start went on, x would lose its digits:
# in a pause of a day it moves by 1e12 sigmas.
NOISE_OF_S = 1e-7
# A track with diffuse pauses is filtered in parts, since all rows of a part after a pause are filtered again: in each
# part as many rows as since the last pause, at least and at most so many.
SHORTEST_PART, LONGEST_PART = 64, 1_000


def observability_rows(F, Q, H, R):
    """Return the magnitudes of the rows H F, H F² ... H Fⁿ of the observability matrix, (rows, n), normalized.

    They are in units of the noise of the measurements and of Q. An observable state shows within n steps.
    """
    G, seen = unit_measurements(H, H @ Q @ H.T + R)[0], []
    for _ in F:
        G = G @ F
        seen.append(np.abs(G))
    return np.concatenate(seen)


def largest_S(observability, variances):
    """Return the largest S to which states of these variances (..., n) may add up, (...)."""
    return ((np.sqrt(np.abs(variances)) @ observability.T) ** 2).max(axis=-1)


def run_rows_with_diffuse_starts(advance, rows, x0, P0, x, P, observability):
    """Filter all rows as `run_rows`, also from a diffuse P0, and after pauses that make P as diffuse.

    `advance` is that of an optimal filter, and observability its `observability_rows`. Returns whether the covariances
    stayed within double precision.
    """
    first_x, first_P = x0[None], P0[None]  # x and P before each of the rows 0 to k
    if _is_diffuse(observability, P0.diagonal()).any():
        next_x, next_P, done = _diffuse_initialization(advance, rows, x0, P0, observability, "P0")
        if (done == len(next_x)).all():  # else some columns had a pause too soon: below, all are filtered again
            first_x, first_P = np.concatenate([first_x, next_x]), np.concatenate([first_P, next_P])
    k = len(first_x) - 1
    x[:k] = first_x[1:]
    if P is not None:
        P[:k] = first_P[1:]
    rest = map_arrays(rows, lambda array: array[k:])
    largest = run_rows(advance, rest, first_x[k], first_P[k], x[k:], None if P is None else P[k:])
    # Perhaps only where nothing is measured: P of each row tells.
    columns = np.flatnonzero(_is_diffuse(observability, largest))
    if not len(columns):
        return True
    own = map_arrays(rows, lambda array: array[..., columns])
    own_x, own_P = (np.empty((len(x) + 1, *first.shape[1:-1], len(columns))) for first in (first_x, first_P))
    own_x[: k + 1], own_P[: k + 1] = first_x[..., columns], first_P[..., columns]
    valid = _run_rows_with_pauses(advance, own, k, own_x, own_P, observability)
    x[..., columns] = own_x[1:]
    if P is not None:
        P[..., columns] = own_P[1:]
    return valid


def _is_diffuse(observability, variances):
    """Tell which states of these variances (..., n) make a measurement more than DIFFUSE_S times as uncertain as R."""
    return ~(largest_S(observability, variances) < DIFFUSE_S)  # true of NaN


def _run_rows_with_pauses(advance, rows, k, x, P, observability):
    """Filter the rows from k on, and start anew at each row that leaves P diffuse: a pause is a start.

    x (N + 1, n, c, W) and P (N + 1, n, n, W) are those before each row, known up to row k. Columns that go on from the
    same row do so together. Returns whether the covariances stayed within double precision.
    """
    z, seen, F, *_ = rows
    N, diffuse = len(z), _is_diffuse(observability, P[k].diagonal())
    next_row, paused = np.full((2, len(diffuse)), k)  # of each column; paused is the row of its last pause
    last_measured = (seen.any(axis=1) * np.arange(N)[:, None]).max(axis=0)
    while (k := next_row.min()) < N:
        columns = np.flatnonzero(next_row == k)
        restart = diffuse[columns].any()
        if restart:
            columns, end = columns[diffuse[columns]], N
        else:
            end = k + min(max(k - paused[columns].max(), SHORTEST_PART), LONGEST_PART)
            end -= end % SHORTEST_PART  # so that columns meet again
        here = map_arrays(rows, lambda array, part=slice(k, end), columns=columns: array[part][..., columns])
        x_k, P_k = x[k][..., columns], P[k][..., columns]
        if restart:
            if not np.isfinite(P_k).all():  # an overflow, not a pause
                return False
            name = "P0" if k == 0 else "z" if F is None else "t"
            x_here, P_here, done = _diffuse_initialization(advance, here, x_k, P_k, observability, name)
            P_end = P_here[done - 1, ..., np.arange(len(done))]  # still diffuse if a pause came too soon
            diffuse[columns] = _is_diffuse(observability, P_end.diagonal(axis1=1, axis2=2))
            diffuse[columns] &= k + done <= last_measured[columns]
            paused[columns] = k
        else:
            x_here, P_here = (np.empty((len(here[0]), *each.shape)) for each in (x_k, P_k))
            largest = run_rows(advance, here, x_k, P_k, x_here, P_here)
            left_diffuse = here[1].any(axis=1) & _is_diffuse(observability, P_here.diagonal(axis1=1, axis2=2))
            diffuse[columns] = left_diffuse.any(axis=0)
            if not np.isfinite(largest[~diffuse[columns]]).all():
                return False
            done = np.where(diffuse[columns], left_diffuse.argmax(axis=0), len(x_here))
        after = slice(k + 1, k + 1 + len(x_here))
        x[after][..., columns], P[after][..., columns] = x_here, P_here
        next_row[columns] += done
    return True


def _diffuse_initialization(advance, rows, x0, P0, observability, name):
    """Filter the first rows from a diffuse P0. Returns x and P after each, and the number of rows of each column (W,).

    Row by row, the first updates would lose as many digits as P0 / R has, and without process noise never regain them.
    So the rows 0 to k are treated as one piece, extended by one row at a time, and row k is its end. A column continues
    until S is clear of diffuse (CLEAR_S), or until it is not diffuse and each sensor has measured 2 n times, or until
    nothing more is measured. It ends before a row with so much process noise, as after a pause, that P is diffuse
    even from an exact start, or that the start hardly matters any more.

    name is the argument that makes P0 diffuse, for errors. After a pause, name "t", row 0 is predicted first: its
    covariance F P Fᵀ + Q is A Aᵀ with A = [F P^½, Q^½], a root that keeps the digits of both terms.
    """
    z, seen, F, Q, r = rows
    A = square_root(np.moveaxis(P0, 2, 0))
    if name == "t":
        x0 = product(F[0], x0)
        A = np.concatenate([np.moveaxis(F[0], 2, 0) @ A, square_root(np.moveaxis(Q[0], 2, 0))], axis=2)
        F, Q = F.copy(), Q.copy()
        F[0], Q[0] = np.eye(len(x0))[..., None], 0.0  # row 0 follows on the prediction after no time
    n, c, W = x0.shape
    counts = np.cumsum(seen, axis=0)
    nothing_follows = (counts == counts[-1]).all(axis=1)
    measured_often = ((counts >= 2 * n) | (counts == counts[-1])).all(axis=1)
    L, y, x, P, S = np.zeros((0, n, W)), np.zeros((0, c, W)), [], [], np.inf
    paused, settled, done = np.zeros(W, bool), np.zeros(W, bool), np.zeros(W, int)
    for k, (x_piece, P_piece, innovations) in enumerate(run_from_zero(advance, (z, seen, F, Q, r), n)):
        S_piece = largest_S(observability, P_piece.diagonal())
        if k > 0:
            paused |= ~(S_piece < DIFFUSE_S) | (~settled & (S_piece > NOISE_OF_S * S))
        if (paused | settled).all():
            break
        if seen[k].any():
            e, minus_L = innovations[:, :c], innovations[:, c:]
            L, y = compress_measurement(np.concatenate([L, -minus_L]), np.concatenate([y, e]))
        x_k, P_k = _end_of_piece(x_piece[:, :c], y, x_piece[:, c:], P_piece, L, x0, A, name)
        x.append(x_k)
        P.append(P_k)
        done += ~paused
        S = largest_S(observability, P_k.diagonal())
        settled |= nothing_follows[k] | (S < CLEAR_S) | (measured_often[k] & (S < DIFFUSE_S))
    return np.array(x), np.array(P), done


def _end_of_piece(x_piece, y, T, P_piece, L, x0, A, name):
    """Return x and P at the end of a piece, from x0 with the covariance A Aᵀ, whose digits outnumber a double's.

    In units of A, the start has unit covariance, and y measures it by L A = V diag(s) Uᵀ: each of its components along
    U by itself, with noise of variance 1 / s². That leaves a variance of 1 / (1 + s²). The largest s² is P0 / R, so s
    has only half of its digits.
    """
    x_piece, y, T, P_piece, L, x0 = (np.moveaxis(each, 2, 0) for each in (x_piece, y, T, P_piece, L, x0))
    S = np.square(L @ A).sum(axis=(1, 2)).max()
    if not S < LARGEST_S:
        what = "a start that makes" if name == "P0" else "pauses that make"
        need = f"{what} the first measurements less than {LARGEST_S:g} times as uncertain as their noise does"
        checks.refuse(name, need, f"{S:.2g} times")
    V, s, U_t = np.linalg.svd(L @ A)
    p = s.shape[1]
    variances = np.ones(U_t.shape[:2])
    variances[:, :p] = 1 / (1 + s**2)
    TAU = T @ A @ U_t.swapaxes(-1, -2)
    innovations = V.swapaxes(-1, -2) @ (y - L @ x0)
    x = x_piece + T @ x0 + TAU[..., :p] @ (innovations * (s / (1 + s**2))[..., None])
    P = P_piece + (TAU * variances[:, None]) @ TAU.swapaxes(-1, -2)
    P = (P + P.swapaxes(-1, -2)) / 2
    return np.moveaxis(x, 0, 2), np.moveaxis(P, 0, 2)
