"""Oracles that share no code with the package: the textbook's filter, dense Gaussian conditioning, exact errors."""

import numpy as np


def textbook_steps(F, H, Q, R, x0, P0, z):
    """Yield x, P, the innovation and its covariance S of each epoch, as in any textbook.

    Of a row of z that is partly NaN, the rows of H and R that are there are used; the innovation and S are of those.
    """
    x, P = x0, P0
    for z_k in z:
        seen = ~np.isnan(z_k)
        H_k, R_k = H[seen], R[np.ix_(seen, seen)]
        x, P = F @ x, F @ P @ F.T + Q
        S, innovation = H_k @ P @ H_k.T + R_k, z_k[seen] - H_k @ x
        K = P @ H_k.T @ np.linalg.inv(S)
        x, P = x + K @ innovation, (np.eye(len(x)) - K @ H_k) @ P
        yield x, P, innovation, S


def textbook_kalman(F, H, Q, R, x0, P0, z):
    """The Kalman filter as in any textbook: the estimates (N, n) and covariances (N, n, n)."""
    steps = list(textbook_steps(F, H, Q, R, x0, P0, z))
    return np.array([step[0] for step in steps]), np.array([step[1] for step in steps])


def _joint(F, H, Q, R, x0, P0, N):
    """The means of all states and of all measurements, and the joint covariances xx, xz, zz."""
    power, n = np.linalg.matrix_power, len(F)
    from_start = np.vstack([power(F, k + 1) for k in range(N)])
    from_noise = np.block([[power(F, k - j) if j <= k else np.zeros((n, n)) for j in range(N)] for k in range(N)])
    mean = from_start @ x0
    C = from_start @ P0 @ from_start.T + from_noise @ np.kron(np.eye(N), Q) @ from_noise.T
    H_all = np.kron(np.eye(N), H)
    return mean, H_all @ mean, C, C @ H_all.T, H_all @ C @ H_all.T + np.kron(np.eye(N), R)


def gaussian_conditioning(F, H, Q, R, x0, P0, z):
    """x(k/k) and P(k/k) by conditioning the joint Gaussian of all states on the measurements that are there."""
    (N, m), n = z.shape, len(F)
    x, expected, C, C_xz, C_zz = _joint(F, H, Q, R, x0, P0, N)
    estimates, covariances = [], []
    for k in range(N):
        here = slice(n * k, n * (k + 1))
        seen = np.flatnonzero(~np.isnan(z.ravel()[: m * (k + 1)]))
        gain = np.linalg.solve(C_zz[np.ix_(seen, seen)], C_xz[here, seen].T).T
        estimates.append(x[here] + gain @ (z.ravel()[seen] - expected[seen]))
        covariances.append(C[here, here] - gain @ C_xz[here, seen].T)
    return np.array(estimates), np.array(covariances)


def gaussian_log_density(F, H, Q, R, x0, P0, z):
    """The logarithm of the joint density of all measurements that are there."""
    _, expected, _, _, C_zz = _joint(F, H, Q, R, x0, P0, len(z))
    seen = np.flatnonzero(~np.isnan(z.ravel()))
    if not len(seen):
        return 0.0
    d, C = (z.ravel() - expected)[seen], C_zz[np.ix_(seen, seen)]
    return -0.5 * (d @ np.linalg.solve(C, d) + np.linalg.slogdet(2 * np.pi * C)[1])


def error_covariances(F, H, Q, R, x0, P0, lost, linear_filter, ahead=0):
    """The exact covariances (N, n, n) of x(k+ahead) - what a linear filter gives at k, whatever the filter is.

    Each noise of the start, of the motion and of the measurements becomes a track on which it alone is one. lost (N, m)
    says which measurements are missing.
    """
    (N, m), n = lost.shape, len(F)
    T = N + ahead
    count = n + T * n + N * m
    unit = np.eye(count)
    start, motion, noise = unit[:n], unit[n : n + T * n].reshape(T, n, count), unit[n + T * n :].reshape(N, m, count)
    x, states = x0[:, None] + start, []
    for k in range(T):
        x = F @ x + motion[k]
        states.append(x)
    x = np.array(states)
    z = np.where(lost[..., None], np.nan, H @ x[:N] + noise)
    errors = x[ahead:] - linear_filter(z)
    # A track without any noise: what is left there, the filter makes of x0 alone.
    mean = [np.linalg.matrix_power(F, k + 1) @ x0 for k in range(T)]
    without = np.where(lost, np.nan, np.array(mean[:N]) @ H.T)[..., None]
    errors = errors - (np.array(mean)[ahead:, :, None] - linear_filter(without))
    blocks = [P0] + [Q] * T + [R] * N
    C, at = np.zeros((count, count)), 0
    for block in blocks:
        C[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return np.einsum("kia,ab,kjb->kij", errors, C, errors, optimize=True)


def matrices(model):
    """The arguments of the oracles, of a model."""
    return model.F, model.H, model.Q, model.R, model.x0, model.P0
