"""The run of a filter over tracks: from `Epochs` to states x, covariances P and innovations.

1. *Tracks without gaps, with the steps and variances of the model,* share A_k, B_k and P. These are made once, and
   several steps are taken in one product (`shared`).
2. *All others* are columns (`columns`), one epoch after the other. A few long tracks are cut into pieces, which are
   columns side by side (`pieces`).
"""

import numpy as np

from .. import _checks as checks
from .algebra import product_for_covariances
from .columns import as_columns
from .pieces import through
from .shared import FEW_TRACKS, TILE, TILE_OF_COVARIANCES, epochs_at_a_time, run_shared, tiles


def estimates(estimator, epochs, x, covariances):
    """Write x(k/k) of all epochs to x (N, n, M), and return P(k/k) (N, n, n, M), or None if it is not wanted.

    P is (N, n, n, 1) where all tracks share it.
    """
    N, _, M = x.shape
    shared = None
    # Many tracks are not searched for gaps where no covariance is wanted: they go the first way, where the NaN of a gap
    # spreads to the last state. The tracks whose last state is NaN run again as columns.
    unsearched = M > FEW_TRACKS and not covariances
    equal = epochs.dt is None and epochs.r is None and not estimator.vague
    if equal and (unsearched or epochs.complete):
        shared = estimator.shared_steps(N, M)
    if shared is None:
        return _by_columns(estimator, epochs, x, covariances)
    steps, products = shared
    run_shared(products, estimator.model.x0[:, None], epochs.z, x)
    if covariances:
        return _held(np.array([step.P for step in steps])[..., None])
    gaps = np.isnan(x[-1]).any(axis=0)
    if gaps.any():
        of_gaps = np.empty((*x.shape[:2], gaps.sum()))
        _by_columns(estimator, epochs.of(gaps), of_gaps, covariances=False)
        x[..., gaps] = of_gaps
    return None


def _by_columns(estimator, epochs, x, covariances):
    """Do what `estimates` does by the second way, one tile of tracks after the other."""
    (N, n, M), together = x.shape, epochs.alike
    P = np.empty((N, n, n, 1 if together else M)) if covariances else None
    for part in tiles(M, TILE if together else TILE_OF_COVARIANCES):
        rows = epochs.of(part).rows(together)
        # Views of x and P, which `through` writes to.
        P_part = P if P is None or together else P[..., part]
        written = as_columns(x[..., part], together), P_part
        _held(*through(estimator.on_columns(rows), rows, *_start(estimator, rows), *written, estimator.vague))
    return P


def _start(estimator, rows):
    """Return x(0/0) (n, c, M) and P(0/0) (n, n, M) of the columns of Rows."""
    _, _, c, M = rows.z.shape
    x0 = estimator.model.x0
    return np.broadcast_to(x0[:, None, None], (len(x0), c, M)), np.repeat(estimator.P0[..., None], M, axis=2)


def _held(P, least_variance=0.0):
    """Return the covariances P, or raise where doubles do not hold them."""
    if not np.isfinite(P).all() or least_variance < 0:
        need = "gaps over which the covariances stay within the range of doubles, and no far more precise measurements"
        checks.refuse("z", need, "an overflow, or a variance below zero by rounding")
    return P


def innovations(estimator, epochs):
    """Return the innovations z(k) - H x(k/k-1) (N, m, M), NaN where z has NaN, and their covariances S (N, m, m, M).

    S is (N, m, m, 1) where all tracks share it. They are in the units of z, unlike those of an `advance`.
    """
    model, (N, m, M), n = estimator.model, epochs.z.shape, estimator.model.n
    x = np.empty((N, n, M))
    P = estimates(estimator, epochs, x, covariances=True)
    W = product_for_covariances(model.H)
    values, S = np.empty((N, m, M)), np.empty((N, m, m, P.shape[3]))
    for part in epochs_at_a_time(N, n * max(n * P.shape[3], M)):
        # Axes: states, epochs, tracks. The states are those before the measurements.
        before = np.moveaxis(_before(x, model.x0, part), 1, 0), np.moveaxis(_before(P, estimator.P0, part), 0, 2)
        x_part, P_part = estimator.prediction(*before, epochs.steps(part))
        expected = (model.H @ x_part.reshape(n, -1)).reshape(m, *x_part.shape[1:])
        values[part] = epochs.z[part] - np.moveaxis(expected, 0, 1)
        S[part] = np.moveaxis((W @ P_part.reshape(n * n, -1)).reshape(m, m, *P_part.shape[2:]), 2, 0)
    return values, S + epochs.noise(model.R)


def _before(array, start, part):
    """Return the rows of an array (N, ..., M) before those of a slice; the one before the first is start (...)."""
    if part.start > 0:
        return array[part.start - 1 : part.stop - 1]
    first = np.broadcast_to(start[None, ..., None], (1, *array.shape[1:]))
    return np.concatenate([first, array[: part.stop - 1]])
