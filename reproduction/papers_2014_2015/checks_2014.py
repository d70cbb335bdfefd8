"""What the filters of 2014 are held against: formulas that share no line with them, and how close is "very close"."""

from dataclasses import replace

import numpy as np
from scipy.linalg import solve_discrete_lyapunov
from scipy.stats import chi2

import mpt_helpers as mpt


def gap(one, *others):
    """Return the largest difference of arrays from the first, or of tuples of arrays member by member.

    >>> gap((np.zeros(2), np.eye(2)), (np.zeros(2), np.zeros((2, 2))))
    1.0
    """
    if isinstance(one, (tuple, list)):
        return max(gap(*members) for members in zip(one, *others, strict=True))
    return max(float(np.abs(np.asarray(one) - other).max()) for other in others)


def conditioned(model, z):
    """Return x(k) and its covariance given z(1) ... z(k), for each k, from one Gaussian vector of all noises.

    x(0) = 0 is known. No recursion: this is what each filter should compute.
    """
    N, n, m = len(z), len(model.F), len(model.H)
    powers = [np.linalg.matrix_power(model.F, i) for i in range(N)]
    zero = np.zeros((n, n))
    moved = np.block([[powers[k - j] if j <= k else zero for j in range(N)] for k in range(N)])  # x from w
    X = moved @ np.kron(np.eye(N), model.Q) @ moved.T  # covariance of all states
    seen = np.kron(np.eye(N), model.H)
    means, covariances = [], []
    for k in range(N):
        known, now = seen[: m * (k + 1)] @ X, slice(n * k, n * k + n)
        noise = np.kron(np.eye(k + 1), model.R)
        weights = np.linalg.solve(known @ seen[: m * (k + 1)].T + noise, known[:, now]).T
        means.append(weights @ np.ravel(z[: k + 1]))
        covariances.append(X[now, now] - weights @ known[:, now])
    return np.array(means), np.array(covariances)


def coefficients(step, model, P):
    """Return A and B of one step x(k+1/k+1) = A x(k/k) + B z(k+1) of a filter, `step(x, P, z, model)`."""
    n, m = len(model.F), len(model.H)
    return step(np.eye(n), P, np.zeros((m, n)), model)[0], step(np.zeros((n, m)), P, np.eye(m), model)[0]


def parts_of_eq7(step, model, Kn, Km, Pn, Fn, On):
    """Return the gap of the matrices of Eq. 7 to what they mean.

    F_n, K_n and P_n are those of a Kalman step from P = 0; K_m and O_n condition x(0) on z(1).
    """
    P = np.zeros_like(Pn)
    of_step = (*coefficients(step, model, P), step(np.zeros(len(P)), P, np.zeros(len(model.H)), model)[1])
    S, HF, prior = model.H @ model.Q @ model.H.T + model.R, model.H @ model.F, np.array([[2, 0.5], [0.5, 1]])
    gain = prior @ HF.T @ np.linalg.inv(HF @ prior @ HF.T + S)
    mended = np.linalg.inv(np.eye(len(prior)) + prior @ On)
    start = mended @ prior, mended @ prior @ Km
    return gap((Fn, Kn, Pn, *start), (*of_step, prior - gain @ HF @ prior, gain))


def forgets_its_start(axis):
    """Return, of five models, whether P from 0 and from 100 I meet, and whether they should: {name: (meet, should)}."""
    F, H, Q = axis.F, axis.H, axis.Q
    kinds = {
        "the paper's axis": (F, H, Q, True),
        "stable, nothing measured": (0.9 * F, 0 * H, Q, True),
        "stable, no plant noise": (0.9 * F, H, 0 * Q, True),
        "unstable, measured and driven": (1.1 * F, H, Q, True),
        "velocity measured, not position": (F, [[0, 1]], Q, False),
    }
    found = {}
    for name, (F_k, H_k, Q_k, should) in kinds.items():
        starts = [mpt.LinearModel(F=F_k, H=H_k, Q=Q_k, R=axis.R, P0=p0 * np.eye(2)) for p0 in (0, 100)]
        first, second = (mpt.KalmanFilter(start).covariances(400)[-1] for start in starts)
        found[name] = bool(np.abs(first - second).max() < 1e-12), should
    return found


def closeness(axis, p0=0.0, steps=60):
    """Return how far constant coefficients are from the Kalman filter, exactly: rms gaps, and both rms errors.

    The Kalman estimate is optimal, so the gap's covariance is the difference of the covariances of both errors. gap
    (N,) is the larger one of position and velocity, in σ of the settled filter; metres, kalman and constant (N,) are
    of the position. share (N, 2) are the variances that the Kalman filter states, over those of the settled filter.
    """
    start = replace(axis, P0=p0 * np.eye(2))
    steady = mpt.SteadyStateFilter.from_kalman(axis)
    own, of_kalman = (
        mpt.metrics.error_moments(steady, start, steps).covariance,
        mpt.KalmanFilter(start).covariances(steps),
    )
    apart = np.sqrt(np.maximum(np.diagonal(own - of_kalman, axis1=1, axis2=2), 0))
    sigma = np.sqrt(np.diag(steady.P))
    return {
        "gap": (apart / sigma).max(axis=1),
        "metres": apart[:, 0],
        "kalman": np.sqrt(of_kalman[:, 0, 0]),
        "constant": np.sqrt(own[:, 0, 0]),
        "share": np.diagonal(of_kalman, axis1=1, axis2=2) / np.diag(steady.P),
    }


def stated(near):
    """Return in words how soon the variances of `closeness` are the settled ones: P is an output, too."""
    share = near["share"]
    settled = below(np.abs(share - 1).max(axis=1))
    first = f"Kalman's P of the position is {100 * share[0, 0]:.0f} % of P_e at step 1"
    return f"{first}, within 10 % from step {settled} on"


def below(values, limit=0.1):
    """Return from which step on values stay below a limit."""
    return 2 + int(np.flatnonzero(values >= limit).max())


def dropped_by_fir(axis, M, steps=300):
    """Return the rms of what FIR of order M drops, A^M x(k-M/k-M), at steps 0 ... N, in σ of position and velocity."""
    steady = mpt.SteadyStateFilter.from_kalman(axis)
    A, B, F, H = steady.A, steady.B, axis.F, axis.H
    T = np.block([[F, np.zeros((2, 2))], [B @ H @ F, A]])  # of the true state and the estimate
    W, V = np.vstack([np.eye(2), B @ H]), np.vstack([np.zeros((2, 1)), B])
    noise, C, of_estimate = W @ axis.Q @ W.T + V @ axis.R @ V.T, np.zeros((4, 4)), [np.zeros((2, 2))]
    for _ in range(steps):
        C = T @ C @ T.T + noise
        of_estimate.append(C[2:, 2:])
    A_M = np.linalg.matrix_power(A, M)
    of_old = A_M @ np.array(of_estimate[: steps + 1 - M]) @ A_M.T
    found = np.zeros((steps + 1, 2))
    found[M:] = np.sqrt(np.diagonal(of_old, axis1=1, axis2=2)) / np.sqrt(np.diag(steady.P))
    return found


def late_by(axis, H_data):
    """Return how a settled filter errs on data of another H: steps late, σ of the rest of its error, its stated σ."""
    steady = mpt.SteadyStateFilter.from_kalman(axis)
    A, B, F = steady.A, steady.B, axis.F
    D = F - A - B @ H_data @ F  # of the state, zero if H_data is the filter's own
    late = np.linalg.solve(np.eye(2) - A, D[:, 1])
    W = np.eye(2) - B @ H_data - np.outer(late, [0, 1])
    rest = solve_discrete_lyapunov(A, W @ axis.Q @ W.T + B @ axis.R @ B.T)
    return late[0] / F[0, 1], np.sqrt(rest[0, 0]), np.sqrt(steady.P[0, 0])


def nis_of_late(axis, G, q):
    """Return the mean NIS of a filter with H = [1 Δt] that is fed with present positions, exactly."""
    steady = mpt.SteadyStateFilter.from_kalman(axis)
    A, B, F, H, H_d = steady.A, steady.B, axis.F, axis.H, np.array([[1, 0]])
    T = np.block([[A, (np.eye(2) - B @ H) @ G], [np.zeros((1, 2)), 0]])  # of the error about x(k-1), and the last push
    N = np.block([[-B @ H_d @ G, -B], [1, 0]])  # the next push, and the noise
    C, D = np.hstack([H @ F, H @ G]), np.hstack([H_d @ G, [[1]]])
    noise = np.diag([q, axis.R[0, 0]])
    spread = solve_discrete_lyapunov(T, N @ noise @ N.T)
    stated = H @ (F @ steady.P @ F.T + axis.Q) @ H.T + axis.R
    return ((C @ spread @ C.T + D @ noise @ D.T) / stated).item()


def noticed(nis, N):
    """Return the chance that the two-sided 5 % test of N squared innovations sees that their mean is not 1 but nis."""
    low, high = chi2.ppf([0.025, 0.975], N)
    return chi2.cdf(low / nis, N) + chi2.sf(high / nis, N)
