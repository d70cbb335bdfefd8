"""Oracles that share no code with the package: the textbook's filter, dense Gaussian conditioning, exact errors."""

from types import SimpleNamespace

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


def gaussian_conditioning_of_steps(Fs, Qs, H, Rs, x0, P0, z):
    """All that measurements tell, by conditioning the joint Gaussian; each step has its own F, Q and R.

    Returns x(k/k), P(k/k), x(k/N), P(k/N), the innovations (NaN where missing), S of whole rows, the log density of
    what is there, and the NIS of each row (NaN where nothing is).
    """
    (N, m), n = z.shape, len(x0)
    x, P, mean, C = x0, P0, [], np.zeros((N * n, N * n))
    for k in range(N):
        x, P = Fs[k] @ x, Fs[k] @ P @ Fs[k].T + Qs[k]
        mean.append(x)
        C[n * k : n * (k + 1), n * k : n * (k + 1)] = P
        for j in range(k):
            C[n * k : n * (k + 1), n * j : n * (j + 1)] = Fs[k] @ C[n * (k - 1) : n * k, n * j : n * (j + 1)]
            C[n * j : n * (j + 1), n * k : n * (k + 1)] = C[n * k : n * (k + 1), n * j : n * (j + 1)].T
    H_all = np.kron(np.eye(N), H)
    R_all = np.zeros((N * m, N * m))
    for k in range(N):
        R_all[m * k : m * (k + 1), m * k : m * (k + 1)] = Rs[k]
    C_xz, C_zz, mean = C @ H_all.T, H_all @ C @ H_all.T + R_all, np.concatenate(mean)
    expected, values = H_all @ mean, z.ravel()

    def given(seen, a, b, C_a, C_ab):
        gain = np.linalg.solve(C_zz[np.ix_(seen, seen)], C_ab[:, seen].T).T
        return a + gain @ (values[seen] - expected[seen]), C_a - gain @ C_ab[:, seen].T

    result = {name: [] for name in ("x", "P", "x_smooth", "P_smooth", "innovations", "S", "nis")}
    there = ~np.isnan(values)
    for k in range(N):
        state, row = slice(n * k, n * (k + 1)), slice(m * k, m * (k + 1))
        until, before = (np.flatnonzero(there & (np.arange(N * m) < m * end)) for end in (k + 1, k))
        for names, seen in ((("x", "P"), until), (("x_smooth", "P_smooth"), np.flatnonzero(there))):
            pair = given(seen, mean[state], None, C[state, state], C_xz[state])
            for name, value in zip(names, pair, strict=True):
                result[name].append(value)
        z_k, S = given(before, expected[row], None, C_zz[row, row], C_zz[row])
        new = values[row] - z_k
        result["innovations"].append(new)
        result["S"].append(S)
        seen = there[row]
        square = new[seen] @ np.linalg.solve(S[np.ix_(seen, seen)], new[seen]) if seen.any() else np.nan
        result["nis"].append(square)
    d, seen = (values - expected)[there], np.flatnonzero(there)
    C_seen = C_zz[np.ix_(seen, seen)]
    log_density = -0.5 * (d @ np.linalg.solve(C_seen, d) + np.linalg.slogdet(2 * np.pi * C_seen)[1])
    return SimpleNamespace(**{name: np.array(value) for name, value in result.items()}, log_density=log_density)
