"""Many tracks that each miss measurements of their own: one step of all tracks at a time, with their covariances.

Tracks are columns, and so are their covariances: P is (n, n, M). Three ideas keep the Kalman filter free of branches
and of loops over tracks:

- A missing measurement gets a gain of zero and an innovation of zero, and leaves P alone.
- A linear map x -> T x takes P to T P Tᵀ, which is linear in P: one matrix product serves all tracks.
- Measurements are taken one after the other, each in coordinates where it is one component of the state: for H = [1 dt]
  the state [s v] may become [s + v dt, v]. There the update needs no matrix inverse, and the row of P that belongs to
  the measured component can be written without a difference of large numbers.
"""

import numpy as np

from .model import predicted_covariance


def can_run(model, z):
    """Tell whether `kalman_epochs` can filter z (N, m, M): no row is partly NaN, or the noises are uncorrelated."""
    lost = np.isnan(z)
    whole = bool((lost.all(axis=1) == lost.any(axis=1)).all())
    return whole or _is_diagonal(model.R)


def kalman_epochs(model, z):
    """Yield x(k/k) (n, M) and P(k/k) (n, n, M) for k = 1 ... N of tracks z (N, m, M) that `can_run` allows."""
    H, variances = model.H, np.diag(model.R)
    if not _is_diagonal(model.R):  # with R = L diag(variances) Lᵀ, the measurements L⁻¹ z have uncorrelated noises
        root = np.linalg.cholesky(model.R)
        L, variances = root / np.diag(root), np.diag(root) ** 2
        H, z = np.linalg.solve(L, H), np.linalg.solve(L, z)
    changes, T = _coordinates(model, H, variances)
    predict, back = linear_map(model.F), linear_map(np.linalg.inv(T))

    x = np.repeat(model.x0[:, None], z.shape[2], axis=1)
    P = np.repeat(model.P0[..., None], z.shape[2], axis=2)
    for z_k in z:
        x, P = predict(x, P)
        P = P + model.Q[..., None]
        for change, j, i in changes:
            x, P = change(x, P)
            x, P = _corrected(x, P, z_k[j], variances[j], i)
        x, P = back(x, P)
        yield x, P


def _corrected(x, P, z, variance, i):
    """Return x (n, M) and P (n, n, M) after a measurement z (M,) of component i of the state, NaN where it is missing.

    It is the textbook's update with eᵢᵀ for H. With row i of P as c, the variance as v and S = cᵢ + v, the new row and
    column i are c - cᵢ c / S = c v / S, which is written without a difference of large numbers. P is overwritten, so it
    must be the caller's own.
    """
    lost = np.isnan(z)
    c = P[i].copy()
    S = c[i] + variance
    gain = np.where(lost, 0, c / S)
    P -= gain[:, None] * c
    P[i] = P[:, i] = c * np.where(lost, 1, variance / S)
    return x + gain * np.where(lost, 0, z - x[i]), P


def constant_gain_epochs(model, B, P0, z):
    """Yield x(k/k) (n, M) and P(k/k) (n, n, M) for k = 1 ... N of tracks z (N, m, M), filtered with the gain B (n, m).

    Each row of z is complete, or all NaN: a missed epoch, which is predicted only. P is the covariance of the true
    error if that of x0 is P0.
    """
    predict, correct = linear_map(model.F), linear_map(np.eye(model.n) - B @ model.H)
    noise = (B @ model.R @ B.T)[..., None]
    x = np.repeat(model.x0[:, None], z.shape[2], axis=1)
    P = np.repeat(P0[..., None], z.shape[2], axis=2)
    for z_k in z:
        seen = ~np.isnan(z_k[0])
        x, P = predict(x, P)
        P = P + model.Q[..., None]
        x_seen, P_seen = correct(x, P)
        x = np.where(seen, x_seen + B @ np.where(seen, z_k, 0), x)
        P = np.where(seen, P_seen + noise, P)
        yield x, P


def _is_diagonal(R):
    return np.array_equal(R, np.diag(np.diag(R)))


def _coordinates(model, H, variances):
    """Return the changes of coordinates that make one measurement after the other a component of the state.

    Each is (function of x and P, index of the row of H, component). Also returns T (n, n), which takes the state to the
    last coordinates.
    """
    # sigma: the predicted standard deviation of each coordinate. A measurement replaces the coordinate that contributes
    # most to it: one that contributes little would come back as a small difference of large numbers.
    variance = np.diag(predicted_covariance(model, model.P0, model.n))
    sigma = np.sqrt(np.maximum(variance, np.finfo(float).tiny))
    changes, T = [], np.eye(model.n)
    for j, h in enumerate(H):
        if h.any():  # a row of zeros tells nothing
            change = np.eye(model.n)
            weights = h @ np.linalg.inv(T)  # h x in the present coordinates
            i = int(np.argmax(np.abs(weights) * sigma))
            change[i] = weights
            sigma[i] = min(np.sqrt(variances[j]), np.abs(weights) @ sigma)  # once it is measured
            T = change @ T
            changes.append((linear_map(change), j, i))
    return changes, T


def linear_map(T):
    """Return a function that takes x (n, M) and its covariance P (n, n, M) to T x and T P Tᵀ."""
    n = len(T)
    if np.array_equal(T, np.eye(n)):
        return lambda x, P: (x, P)
    W = np.kron(T, T).reshape(n, n, n * n)
    # Equal rows for (a, b) and (b, a), so that T P Tᵀ is symmetric.
    W = ((W + W.swapaxes(0, 1)) / 2).reshape(n * n, n * n)
    return lambda x, P: (T @ x, (W @ P.reshape(n * n, -1)).reshape(P.shape))
