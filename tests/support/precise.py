"""The Kalman filter, its steady state and the smoother in 60 digits, to measure doubles against.

It shares no code with the package. Numbers are those of `decimal`, ten times as fast as mpmath's.
"""

import decimal
from decimal import Decimal

import numpy as np

decimal.getcontext().prec = 60


def exact(array):
    """The doubles of an array as numbers of 60 digits."""
    doubles = np.asarray(array, dtype=float)
    numbers = np.empty(doubles.shape, dtype=object)
    numbers.flat = [Decimal(each) for each in doubles.ravel().tolist()]
    return numbers


def inverse(M):
    """The inverse by elimination, the largest pivot of each column first."""
    n = len(M)
    both = np.concatenate([M, exact(np.eye(n))], axis=1)
    for j in range(n):
        pivot = j + int(np.argmax(np.abs(both[j:, j])))
        both[[j, pivot]] = both[[pivot, j]]
        both[j] = both[j] / both[j, j]
        for i in range(n):
            if i != j:
                both[i] = both[i] - both[i, j] * both[j]
    return both[:, n:]


def _size(M):
    return max(map(abs, M.ravel()))


def update(P_p, F, H, R):
    """The coefficients A, B, the covariance P after a measurement, and S of the measurement, from the predicted P_p."""
    S = H @ P_p @ H.T + R
    B = P_p @ H.T @ inverse(S)
    P = P_p - B @ H @ P_p
    return F - B @ H @ F, B, (P + P.T) / 2, S


def kalman(F, H, Q, R, x0, P0, z):
    """The estimates x (N, n), and the coefficients A, B, the covariances P, P_p and S of each step.

    NaN in z is a missing measurement: the rows of H and R that are there are used, and B is zero for others.
    """
    F, H, Q, R, x, P = map(exact, (F, H, Q, R, x0, P0))
    z = np.asarray(z, float)
    no_gain, numbers, steps = exact(np.zeros(H.T.shape)), exact(np.nan_to_num(z)), []
    for is_seen, z_k in zip(~np.isnan(z), numbers, strict=True):
        seen = np.flatnonzero(is_seen)
        P_p = P = F @ P @ F.T + Q
        A, B, x = F, no_gain.copy(), F @ x
        if len(seen):
            _, B[:, seen], P, _ = update(P_p, F, H[seen], R[np.ix_(seen, seen)])
            A = F - B @ H @ F
            x = x + B @ (z_k - H @ x)
        steps.append((x, A, B, P, P_p, H @ P_p @ H.T + R))
    return [np.array(each) for each in zip(*steps, strict=True)]


def smoothed(F, H, Q, R, x0, P0, z):
    """The states x (N, n) and covariances P (N, n, n) of all epochs given all of z."""
    x, _, _, P, P_p, _ = kalman(F, H, Q, R, x0, P0, z)
    F = exact(F)
    for k in reversed(range(len(x) - 1)):
        C = P[k] @ F.T @ inverse(P_p[k + 1])
        x[k] += C @ (x[k + 1] - F @ x[k])
        P[k] += C @ (P[k + 1] - P_p[k + 1]) @ C.T
    return x, P


def steady(F, H, Q, R):
    """The limit of A, B, P, P_p and S: the REKF by doubling, and what it leaves in the equation is checked."""
    F, H, Q, R = map(exact, (F, H, Q, R))
    A, G, P_p, identity = F.T, H.T @ inverse(R) @ H, Q, exact(np.eye(len(F)))
    for _ in range(200):
        W = inverse(identity + G @ P_p)
        step = A.T @ P_p @ W @ A
        A, G, P_p = A @ W @ A, G + A @ W @ G @ A.T, P_p + (step + step.T) / 2
        if _size(step) <= Decimal(10) ** -50 * _size(P_p):
            break
    A, B, P, S = update(P_p, F, H, R)
    assert _size(Q + F @ P @ F.T - P_p) < Decimal(10) ** -30 * _size(P_p)
    return A, B, P, P_p, S


def recursion(A, B, x0, z):
    """The estimates of given coefficients A (N, n, n), B (N, n, m), each a double."""
    x, estimates = exact(x0), []
    for A_k, B_k, z_k in zip(exact(A), exact(B), exact(z), strict=True):
        x = A_k @ x + B_k @ z_k
        estimates.append(x)
    return np.array(estimates)


def two_doubles(reference):
    """Numbers of 60 digits as a sum of two doubles, (2, ...), which hold 32 of them."""
    first = reference.astype(float)
    return np.array([first, (reference - exact(first)).astype(float)])


def digits(ours, reference, unit):
    """The number of decimal digits of an array that hold, relative to a unit for each entry: 17 where all bits do.

    The reference has 60 digits, or is that of `two_doubles`, which is sooner compared if that is done often.
    """
    first, second = reference if reference.dtype == float else two_doubles(reference)
    # The difference of two doubles that are near is exact. Of others a digit is enough.
    gap = np.abs((ours - first) - second) / unit
    return float(min(17.0, -np.log10(max(gap.max(), 1e-300))))
