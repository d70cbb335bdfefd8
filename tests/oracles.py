"""Two oracles that share no code with the package, and the models that the tests run on."""

import numpy as np


def textbook_kalman(F, H, Q, R, x0, P0, z):
    """The Kalman filter as in any textbook; a NaN row of z is predicted only. Returns the estimates and covariances."""
    x, P, estimates, covariances = x0, P0, [], []
    for z_k in z:
        x, P = F @ x, F @ P @ F.T + Q
        if not np.isnan(z_k).any():
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
            x, P = x + K @ (z_k - H @ x), (np.eye(len(x)) - K @ H) @ P
        estimates.append(x)
        covariances.append(P)
    return np.array(estimates), np.array(covariances)


def gaussian_conditioning(F, H, Q, R, x0, P0, z):
    """x(k/k) and P(k/k) by conditioning the joint Gaussian of all states and measurements; NaN rows are left out."""
    N, n, m = len(z), len(F), len(H)
    power = np.linalg.matrix_power
    from_start = np.vstack([power(F, k + 1) for k in range(N)])
    from_noise = np.block([[power(F, k - j) if j <= k else np.zeros((n, n)) for j in range(N)] for k in range(N)])
    mean = from_start @ x0
    C = from_start @ P0 @ from_start.T + from_noise @ np.kron(np.eye(N), Q) @ from_noise.T
    H_all = np.kron(np.eye(N), H)
    C_zz = H_all @ C @ H_all.T + np.kron(np.eye(N), R)
    estimates, covariances = [], []
    for k in range(N):
        here = slice(n * k, n * (k + 1))
        seen = np.repeat(~np.isnan(z[: k + 1]).any(axis=1), m).nonzero()[0]
        gain = np.linalg.solve(C_zz[np.ix_(seen, seen)], (H_all @ C[:, here])[seen]).T
        estimates.append(mean[here] + gain @ (z.ravel()[seen] - (H_all @ mean)[seen]))
        covariances.append(C[here, here] - gain @ (H_all @ C[:, here])[seen])
    return np.array(estimates), np.array(covariances)


def matrices(model):
    """The arguments of both oracles, of a model."""
    return model.F, model.H, model.Q, model.R, model.x0, model.P0
