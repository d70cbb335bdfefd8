"""Many tracks that each miss measurements of their own: one step of all tracks at a time, with their covariances.

Tracks are columns, and so are their covariances: P is (n, n, M). Three ideas keep the Kalman filter free of branches
and of loops over tracks:

- A missing measurement is one of infinite variance: its gain vanishes, and nothing else has to be done about it.
- A linear map x -> T x takes P to T P Tᵀ, which is linear in P: one matrix product serves all tracks.
- Measurements are taken one after the other, each in a basis in which it measures one component of the state alone.
  There the update needs no matrix inverse, and the row of P that belongs to the measured component can be written
  without a difference of large numbers.
"""

from itertools import pairwise

import numpy as np

# Stands for an infinite variance. Far above any S, and its products with finite numbers do not overflow.
MISSING = 1e200


def can_run(model, z):
    """Tell whether `kalman_epochs` can filter z (N, m, M): no row is partly NaN, or the noises are uncorrelated."""
    lost = np.isnan(z)
    whole = bool((lost.all(axis=1) == lost.any(axis=1)).all())
    return whole or _is_diagonal(model.R)


def kalman_epochs(model, z):
    """Yield x(k/k) (n, M) and P(k/k) (n, n, M) for k = 1 ... N of tracks z (N, m, M).

    NaN in z is a missing measurement. The yielded arrays may be written over when the next ones are asked for.
    """
    n, m, M = model.n, model.m, z.shape[2]
    H, variances = model.H, np.diag(model.R)
    if not _is_diagonal(model.R):  # measurements L⁻¹ z have uncorrelated noises, where R = L diag(variances) Lᵀ
        root = np.linalg.cholesky(model.R)
        L, variances = root / np.diag(root), np.diag(root) ** 2
        H, z = np.linalg.solve(L, H), np.linalg.solve(L, z)
    bases, measured = zip(*map(_basis, H), strict=True)
    predict = linear_map(bases[0] @ model.F)
    Q = (bases[0] @ model.Q @ bases[0].T).reshape(n * n, 1)
    between = [linear_map(new @ np.linalg.inv(old)) for old, new in pairwise(bases)]
    back = linear_map(np.linalg.inv(bases[-1]))

    x = np.repeat(model.x0[:, None], M, axis=1)
    P = np.repeat(model.P0[..., None], M, axis=2)
    for z_k in z:
        x, P = predict(x, P)
        P.reshape(n * n, M)[:] += Q
        for j in range(m):
            if j > 0:
                x, P = between[j - 1](x, P)
            _update(x, P, z_k[j], variances[j], measured[j])
        x, P = back(x, P)
        yield x, P


def constant_gain_epochs(model, B, P0, z):
    """Yield x(k/k) (n, M) and P(k/k) (n, n, M) for k = 1 ... N of tracks z (N, m, M), filtered with the gain B (n, m).

    A row of z that is NaN is a missed epoch, which is predicted only. P is the covariance of the true error.
    """
    M = z.shape[2]
    update = np.eye(model.n) - B @ model.H
    predict, correct = linear_map(model.F), linear_map(update)
    noise = (B @ model.R @ B.T)[..., None]
    x = np.repeat(model.x0[:, None], M, axis=1)
    P = np.repeat(P0[..., None], M, axis=2)
    for z_k in z:
        x, P = predict(x, P)
        P = P + model.Q[..., None]
        x_corrected, P_corrected = correct(x, P)
        seen = ~np.isnan(z_k[0])
        x = np.where(seen, x_corrected + B @ np.where(seen, z_k, 0), x)
        P = np.where(seen, P_corrected + noise, P)
        yield x, P


def _update(x, P, z, variance, i):
    """Correct x and P in place with the measurement z (M,) of component i of the state, NaN where it is missing.

    The textbook's update with H = eᵢᵀ. Row i of it, cᵢ - cᵢ c / S with S = cᵢ + v, is c v / S without the difference.
    """
    lost = np.isnan(z)
    v = np.where(lost, MISSING, variance)
    innovation = np.where(lost, 0, z - x[i])
    c = P[i].copy()
    S = c[i] + v
    gain = c / S
    x += gain * innovation
    P -= gain[:, None] * c
    P[i] = P[:, i] = c * (v / S)


def _is_diagonal(R):
    return np.array_equal(R, np.diag(np.diag(R)))


def _basis(h):
    """Return the basis T (n, n) in which a measurement h x is a component of the state, and that component's number.

    T is the identity with h in place of one row: the row of h's largest entry, so that T has an inverse. Where h picks
    one component, T is the identity.
    """
    i = int(np.argmax(np.abs(h)))
    T = np.eye(len(h))
    T[i] = h
    return T, i


def linear_map(T):
    """Return a function that takes x (n, M) and its covariance P (n, n, M) to T x and T P Tᵀ."""
    n = len(T)
    if np.array_equal(T, np.eye(n)):
        return lambda x, P: (x, P)
    W = np.kron(T, T).reshape(n, n, n * n)
    W = ((W + W.swapaxes(0, 1)) / 2).reshape(n * n, n * n)  # gives a P that is symmetric to the last bit
    return lambda x, P: (T @ x, (W @ P.reshape(n * n, -1)).reshape(P.shape))
