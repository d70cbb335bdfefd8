"""The run of a filter over tracks: from `Epochs` to states x, covariances P and innovations.

A track goes one of two ways:

1. *Tracks without gaps, at steps and with variances of the model.* They share A_k, B_k and P, which are made once, and
   all of them go through several steps in one product (`shared`).
2. *All others* are columns (`columns`): one row is taken after the other (`in_sequence`), or, where a few long tracks
   would leave the processor idle, pieces of them run side by side (`pieces`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from .. import _checks as checks
from .algebra import product_for_covariances
from .columns import Rows, as_columns
from .pieces import through
from .shared import FEW_TRACKS, TILE, TILE_OF_COVARIANCES, epochs_at_a_time, run_shared, tiles


def estimates(estimator, epochs, x, covariances):
    """Write x(k/k) of all epochs to x (N, n, M), and return P(k/k) (N, n, n, M), or None if it is not wanted.

    P is (N, n, n, 1) where all tracks share it.
    """
    N, _, M = x.shape
    equal_steps = epochs.dt is None and epochs.r is None
    if not equal_steps or _columns_will_do_all(epochs, covariances):
        return _by_columns(estimator, epochs, x, covariances)
    shared = estimator.shared_steps(N, M)
    if shared is None:
        return _by_columns(estimator, epochs, x, covariances)
    run_shared(shared.products, estimator.model.x0[:, None], epochs.z, x)
    if covariances:  # no track has a gap here: those with gaps were sent to columns above
        return _finite(np.array([step.P for step in shared.steps])[..., None])
    # Without covariances some may. A gap is NaN, which spreads to all that follows: tracks whose last state is NaN had
    # one, and run again as columns.
    gaps = np.isnan(x[-1]).any(axis=0)
    if not gaps.any():
        return None
    if gaps.all():
        return _by_columns(estimator, epochs, x, covariances)
    of_gaps = np.empty((*x.shape[:2], gaps.sum()))
    _by_columns(estimator, epochs.of(gaps), of_gaps, covariances=False)
    x[..., gaps] = of_gaps
    return None


def _columns_will_do_all(epochs, covariances):
    """Tell whether no track can be taken by the shared steps: then they are not made.

    With covariances it is so as soon as one track has a gap: P is one array for all, and then each needs its own.

    Without covariances it is so if all tracks have a gap. Few tracks are searched for that. A search of many costs more
    than it saves: `estimates` runs them by the shared steps first, and sees which have gaps in their last states.
    """
    if covariances:
        return bool(epochs.missing.any())
    if epochs.z.shape[2] > FEW_TRACKS or epochs.complete:
        return False
    return bool(epochs.missing.any(axis=(0, 1)).all())


def _by_columns(estimator, epochs, x, covariances):
    """Do what `estimates` does by the second way, so many columns at a time."""
    (N, n, M), together = x.shape, epochs.alike
    P = np.empty((N, n, n, 1 if together else M)) if covariances else None
    for part in tiles(M, TILE if together else TILE_OF_COVARIANCES):
        advance, rows, x0, P0 = start_on_columns(estimator, epochs.of(part).rows(together))
        # Views of x and P, which `through` writes to.
        P_part = P if P is None or together else P[..., part]
        written = as_columns(x[..., part], together), P_part
        P_last, least_variance = through(partial(in_sequence, advance), rows, x0, P0, *written)
        if least_variance < 0:
            # The variance of a state that is known exactly comes out as the rounding of zero, on either side of it.
            keeping_zeros = partial(_keeping_what_is_known, estimator.prediction, advance)
            P_last, least_variance = through(partial(in_sequence, keeping_zeros), rows, x0, P0, *written)
        if least_variance < 0:
            need = "measurements that are not far more precise than P0 or than what is known after a gap"
            checks.refuse("z", need, "a variance below zero, by rounding")
        _finite(P_last)
    return P


def _finite(P):
    if not np.isfinite(P).all():
        checks.refuse("z", "gaps over which the covariances stay within the range of doubles", "an overflow")
    return P


class OnColumns(NamedTuple):
    """A filter before its first row: its `advance`, the rows, and x(0/0) (d, c, M) and P(0/0) (d, d, M).

    The first n of the d states are those of the model. The others, if there are any, are noises of the measurements.
    """

    advance: Callable
    rows: Rows
    x: np.ndarray
    P: np.ndarray


def start_on_columns(estimator, rows):
    """Return OnColumns of Rows."""
    advance, x0, P0 = estimator.on_columns(rows)
    _, _, c, M = rows.z.shape
    x = np.broadcast_to(x0[:, None, None], (len(x0), c, M))
    return OnColumns(advance, rows, x, np.repeat(P0[..., None], M, axis=2))


def on_own_columns(estimator, z):
    """Return OnColumns of the measurements z (N, m, M), with a column for each track, as a gate needs it.

    Tracks that share a column share a covariance, so that a row could only be refused in all of them. `as_tracks` of
    the filter makes such a z of one track too.
    """
    return start_on_columns(estimator, estimator.epochs_of(z).rows(together=False))


def _keeping_what_is_known(prediction, advance, row, x, P):
    """Advance, and let a state that is predicted exactly, by a variance of zero, be known exactly afterwards."""
    x, P_next, innovations = advance(row, x, P)
    n = len(prediction.F)
    known = np.zeros(P_next.shape[1:], bool)  # (d, M)
    known[:n] = np.einsum("jjm->jm", prediction.covariance(P[:n, :n], row.steps)) == 0
    row_or_column_is_known = known[:, None] | known  # (d, 1, M) and (d, M) make (d, d, M)
    return x, np.where(row_or_column_is_known, 0.0, P_next), innovations


def in_sequence(advance, rows, x, P, takes=None):
    """Yield x(k/k), P(k/k) and the innovations of one row after the other, from x(0/0) (d, c, M) and P(0/0) (d, d, M).

    The innovations (m, c, M) are at unit covariance. takes(row, innovations) is a gate, called once for each Row, in
    order: it says in which columns the Row is taken, (M,) or one truth value for all. A Row that is not taken in a
    column counts as missing there: x and P are those without it, and the innovations are still those that were seen.
    Without a gate all are taken.

    Here is one, which refuses what lies further off than 25 variances; only the second track has such a row:

    >>> import mpt_helpers as mpt
    >>> kf = mpt.KalmanFilter(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1, x0=[0, 1]))
    >>> z = np.array([[1.0, 1.0], [2.0, 2.0], [3.0, 9.0], [4.0, 4.0]])[:, None]  # (N, m, M): one axis of two tracks
    >>> def near(row, innovations):
    ...     return (innovations**2).sum(axis=(0, 1)) < 25
    >>> for x, P, innovations in in_sequence(*on_own_columns(kf, z), takes=near):
    ...     print(x[0, 0].round(1), innovations[0, 0].round(1))
    [1. 1.] [0. 0.]
    [2. 2.] [0. 0.]
    [3. 3.] [ 0.  14.5]
    [4. 4.] [0. 0.]

    Raises ValueError for a gate where tracks share a column, and for one that says something of another shape;
    TypeError where there are no innovations.
    """
    if takes is not None and rows.z.shape[2] > 1:
        checks.refuse("takes", "a column for each track (on_own_columns)", f"{rows.z.shape[2]} tracks in one")
    for row in rows:
        x_next, P_next, innovations = advance(row, x, P)
        if takes is not None:
            if not len(innovations):
                got = "one whose P is not that of the best estimate (optimal = False)"
                checks.refuse("takes", "a filter with innovations", got, TypeError)
            taken = np.asarray(takes(row, innovations))
            if taken.dtype == object or taken.shape not in ((), P.shape[2:]):
                need = f"a gate that returns one truth value, or one for each of the {P.shape[2]} columns"
                checks.refuse("takes", need, f"{taken.dtype} of shape {taken.shape}")
            refused = np.logical_not(taken)
            if refused.any():
                x_next, P_next, _ = advance(row.without(refused), x, P)
        x, P = x_next, P_next
        yield x, P, innovations


def innovations(estimator, epochs):
    """Return the innovations z(k) - H x(k/k-1) (N, m, M), NaN where z has NaN, and their covariances S (N, m, m, M).

    S is (N, m, m, 1) where all tracks share it. These innovations are in the units of z. An `advance` returns them at
    unit covariance.
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
