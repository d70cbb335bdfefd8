"""The run of a filter over tracks: from `Epochs` to states x, covariances P and innovations, in one of two ways.

1. *Tracks without gaps, with the time step and R of the model,* share A_k, B_k and P. These are computed once, and
   several steps are taken in one matrix product (`shared`).
2. *All other tracks* are columns of arrays (`columns`), filtered epoch by epoch. A few long tracks are cut into pieces,
   which run side by side as columns (`pieces`).
"""

import numpy as np

from .. import _checks as checks
from .columns import product
from .diffuse import DIFFUSE_S, largest_S, observability_rows, run_rows_with_diffuse_starts
from .pieces import FEW_TRACKS, run_rows
from .shared import TILE, TILE_OF_COVARIANCES, epochs_at_a_time, run_shared, tiles

EPS = np.finfo(float).eps
# The largest fraction of an S that may be rounding error: NIS and likelihood are wrong by as much.
MOST_ROUNDING_OF_S = 0.01
# Most numbers in the covariances of the tracks that are computed together: 32 MB.
MOST_NUMBERS = 4_000_000


def run_estimates(estimator, epochs, x, covariances, observability):
    """Write x(k/k) of all epochs to x (N, n, M), and return P(k/k) (N, n, n, M), or None if it is not wanted.

    P is (N, n, n, 1) where all tracks share it. `observability_of` the filter is needed only if it is optimal.
    """
    N, _, M = x.shape
    if estimator.optimal and largest_S(observability, estimator.P0.diagonal()) > DIFFUSE_S:
        return _on_columns(estimator, epochs, x, covariances, observability)
    # Searching many tracks for gaps takes time. Where no covariance is wanted, all are filtered as if they had none: a
    # NaN in z propagates to the last state, and the tracks whose last state is NaN are filtered again, as columns.
    unsearched = M > FEW_TRACKS and not covariances
    alike = epochs.dt is None and epochs.r is None and (unsearched or not epochs.missing.any())
    shared = estimator.shared_steps(N, M) if alike else None
    if shared is None:
        return _on_columns(estimator, epochs, x, covariances, observability)
    steps, products = shared
    run_shared(products, estimator.model.x0[:, None], epochs.z, x)
    if covariances:
        P = np.array([step.P for step in steps])[..., None]
        require_valid(np.isfinite(P).all())
        return P
    gaps = np.isnan(x[-1]).any(axis=0)
    if gaps.any():
        of_gaps = np.empty((*x.shape[:2], gaps.sum()))
        _on_columns(estimator, epochs.select(gaps), of_gaps, False, observability)
        x[..., gaps] = of_gaps
    return None


def observability_of(estimator, epochs):
    """Return the `observability_rows` of an optimal filter, else None.

    With time steps they are those of the median and of the largest; of variances r, the smallest of each sensor counts.
    """
    if not estimator.optimal:
        return None
    if epochs.dt is None and epochs.r is None:
        return estimator.observability
    model, R = estimator.model, estimator.model.R
    if epochs.r is not None:
        smallest = np.where(epochs.missing, np.inf, epochs.r).min(axis=(0, 2))
        R = np.diag(np.where(np.isfinite(smallest), smallest, np.diag(R)))
    F, Q = [model.F], [model.Q]
    if epochs.dt is not None:
        F, Q = epochs.over(np.array([np.median(epochs.dt), epochs.dt.max()]))
    return np.concatenate([observability_rows(*each, model.H, R) for each in zip(F, Q, strict=True)])


def _on_columns(estimator, epochs, x, covariances, observability):
    """Do `run_estimates` for tracks as columns, tile by tile."""
    (N, n, M), W = x.shape, epochs.width
    P = np.empty((N, n, n, W)) if covariances else None
    most = TILE if W == 1 else TILE_OF_COVARIANCES
    if W > 1 and epochs.dt is not None:  # each row of each track has an F and a Q
        most = min(most, max(FEW_TRACKS, MOST_NUMBERS // (N * n * n)))
    for part in tiles(M, most):
        tile = epochs.select(part)
        rows = tile.rows()
        _, _, c, width = rows[0].shape
        x0 = np.broadcast_to(estimator.model.x0[:, None, None], (n, c, width))
        P0 = np.repeat(estimator.P0[..., None], width, axis=2)
        x_part = x[..., part].reshape(N, n, c, width)  # a view, as P_part is where the columns are those of P
        P_part = P[..., part] if covariances and W > 1 else P
        only_of_this_tile = covariances and width < P_part.shape[3]  # its tracks share a P, and those of others do not
        if only_of_this_tile:
            P_part = np.empty((N, n, n, width))
        if estimator.optimal:
            valid = run_rows_with_diffuse_starts(estimator.advance, rows, x0, P0, x_part, P_part, observability)
        else:
            valid = np.isfinite(run_rows(estimator.advance, rows, x0, P0, x_part, P_part)).all()
        require_valid(valid)
        if only_of_this_tile:
            P[..., part] = P_part
    return P


def require_valid(valid):
    """Raise a ValueError where the covariances exceeded double precision."""
    if not valid:
        need = "covariances within double precision (shorter gaps, a smaller P0, more similar variances)"
        checks.refuse("z", need, "an overflow or a negative variance")


def run_innovations(estimator, epochs):
    """Return the innovations z(k) - H x(k/k-1) (N, m, M), NaN where z is NaN, and their covariances S (N, m, m, M).

    S is (N, m, m, 1) where all tracks share it. These innovations are in the units of z; those of `advance` are
    normalized to unit variance.
    """
    model, (N, m, M), n = estimator.model, epochs.z.shape, estimator.model.n
    x = np.empty((N, n, M))
    P = run_estimates(estimator, epochs, x, True, observability_of(estimator, epochs))
    values, S, size = np.empty((N, m, M)), np.empty((N, m, m, P.shape[3])), np.empty((N, m, P.shape[3]))
    for part in epochs_at_a_time(N, n * max(n * P.shape[3], M)):
        # Axes: states, epochs, tracks.
        before = np.moveaxis(_previous(x, model.x0, part), 1, 0), np.moveaxis(_previous(P, estimator.P0, part), 0, 2)
        motion = epochs.motions(part)
        expected, S_part = estimator.measurement(*motion(*before))
        values[part] = epochs.z[part] - np.moveaxis(expected, 0, 1)
        S[part] = np.moveaxis(S_part, 2, 0)
        sigma = np.sqrt(np.einsum("ii...->i...", before[1]))
        size[part] = np.moveaxis(product(np.abs(model.H), product(np.abs(motion.matrix), sigma)) ** 2, 1, 0)
    S += epochs.noise(model.R)
    require_digits_of(np.einsum("kii...->ki...", S), size)
    return values, S


def is_rounded_away(size, variances, most):
    """Tell whether the rounding of terms of this size, ε size, exceeds the fraction `most` of some of the variances."""
    return (EPS * size > most * variances).any()


def require_digits_of(variances, size):
    """Raise a ValueError where rounding is a large part of the variances of predicted measurements.

    size is (|H| |F| σ)², of the same shape: doubles round P_ij by ε σ_i σ_j, and so H F P Fᵀ Hᵀ by up to ε times this.
    """
    if is_rounded_away(size, variances, MOST_ROUNDING_OF_S):
        need = "a start that leaves digits of the predicted measurements beside states that were never measured"
        checks.refuse("P0", f"{need} (filter and estimates take a larger one)", "one that leaves none")


def _previous(array, start, part):
    """Return the rows of an array (N, ..., M) one before those of a slice; `start` (...) precedes row 0."""
    if part.start > 0:
        return array[part.start - 1 : part.stop - 1]
    first = np.broadcast_to(start[None, ..., None], (1, *array.shape[1:]))
    return np.concatenate([first, array[: part.stop - 1]])


def in_tiles(function, estimator, epochs, d):
    """Return function(estimator, epochs), values (N, d, M) and covariances (N, d, d, M or 1), a few tracks at a time.

    This bounds the memory of the intermediate covariances.
    """
    N, _, M = epochs.z.shape
    parts = tiles(M, max(1, MOST_NUMBERS // (N * estimator.model.n**2)))
    if len(parts) == 1:
        return function(estimator, epochs)
    values, covariances = np.empty((N, d, M)), np.empty((N, d, d, M))
    for part in parts:
        values[..., part], covariances[..., part] = function(estimator, epochs.select(part))
    return values, covariances
