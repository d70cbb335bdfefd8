"""Oracles that share no code with the package: the textbook's filter, dense Gaussian conditioning, exact errors."""

from types import SimpleNamespace

import numpy as np
from scipy.linalg import expm


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


def gaussian_covariance(F, H, Q, R, x0, P0, N):
    """The joint covariance of all measurements."""
    return _joint(F, H, Q, R, x0, P0, N)[-1]


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


def van_loan(A, noise, T):
    """F and Q over T of dx = A x dt + white noise of these densities, by van Loan's exponential."""
    n = len(A)
    both = expm(np.block([[-A, np.diag(noise)], [np.zeros((n, n)), A.T]]) * T)
    F = both[..., n:, n:].swapaxes(-1, -2)
    Q = F @ both[..., :n, n:]
    return F, (Q + Q.swapaxes(-1, -2)) / 2


def plain_loop(steps, H, Rs, x0, P0, z, alpha=1.0):
    """All that a filter tells of one track, one epoch after the other; each has its own (F, Q), and its own R.

    x, P; the innovations and S of whole rows, the NIS of what is there, and the log density of all of it. A filter of
    fading memory predicts P alpha² times as large.
    """
    x, P, rows, log_density = np.array(x0), np.array(P0), [], 0.0
    for (F, Q), R, z_k in zip(steps, Rs, z, strict=True):
        x, P = F @ x, alpha**2 * F @ P @ F.T + Q
        seen = ~np.isnan(z_k)
        new, S = z_k - H @ x, H @ P @ H.T + R
        H_k, S_k = H[seen], S[np.ix_(seen, seen)]
        nis = new[seen] @ np.linalg.solve(S_k, new[seen]) if seen.any() else np.nan
        if seen.any():
            K = P @ H_k.T @ np.linalg.inv(S_k)
            keep = np.eye(len(x)) - K @ H_k
            x, P = x + K @ new[seen], keep @ P @ keep.T + K @ R[np.ix_(seen, seen)] @ K.T
            log_density -= (np.linalg.slogdet(2 * np.pi * S_k)[1] + nis) / 2
        rows.append((x, P, new, S, nis))
    names = ("x", "P", "innovations", "S", "nis")
    columns = {name: np.array(column) for name, column in zip(names, zip(*rows, strict=True), strict=True)}
    return SimpleNamespace(**columns, log_density=log_density)


def plain_smoother(steps, x, P):
    """x(k/N) and P(k/N) from x(k/k) and P(k/k) of one track, as Rauch, Tung and Striebel print it."""
    states, covariances = [x[-1]], [P[-1]]
    for k in range(len(x) - 2, -1, -1):
        F, Q = steps[k + 1]
        predicted = F @ P[k] @ F.T + Q
        C = P[k] @ F.T @ np.linalg.inv(predicted)
        states.append(x[k] + C @ (states[-1] - F @ x[k]))
        covariances.append(P[k] + C @ (covariances[-1] - predicted) @ C.T)
    return np.array(states[::-1]), np.array(covariances[::-1])


def plain_band(over, H, R, Rs, start, t, z, x, P, seconds, level, log_f):
    """The bands of one track that follow their own checked errors, one fix after the other, as the module's text says.

    over(T) returns F and Q over T seconds; R is that of the model and Rs those of the rows; start is (t, x, P) before
    the first row; x and P are the estimates of the rows; log f (m,) is that of the start. Times are compared to a
    millionth of a horizon.

    Returns the predictions that a fix checks, and those that any row makes of what is measured `seconds` later, as
    lists of namespaces, and log f at the end.
    """
    log_f, average, waiting, checked, at_rows, fix_times = np.array(log_f), 1.0, [], [], [], []
    little, last = 1e-6 * seconds, start
    for k in range(len(z)):
        seen = ~np.isnan(z[k])
        if seen.any():
            for each in [each for each in waiting if t[k] - each.t >= seconds - little]:
                waiting.remove(each)
                if t[k] - each.t > 1.5 * seconds + little:
                    continue
                F, Q = over(t[k] - each.t)
                each.errors = z[k] - H @ F @ each.x
                each.sigma = np.sqrt(np.diag(H @ (F @ each.P @ F.T + Q) @ H.T + Rs[k]))
                each.half_width = each.f * each.c * each.sigma
                each.due_row, each.fixes = k, len(fix_times) - each.fix
                # The factor learns from half-widths of that time, but of a mobile that rests nothing.
                each.rests = all(a == b or (np.isnan(a) and np.isnan(b)) for a, b in zip(z[k], each.z, strict=True))
                for i in np.flatnonzero(seen):
                    if not each.rests:
                        missed = abs(each.errors[i]) > each.half_width[i]
                        log_f[i] += 0.5 / max(5, each.fixes) * (missed - (1 - level))
                checked.append(each)
            within = sum(other >= t[k] - seconds - little for other in fix_times)
            F, Q = over(t[k] - last[0])
            new, S = z[k] - H @ F @ last[1], H @ (F @ last[2] @ F.T + Q) @ H.T + Rs[k]
            nis = new[seen] @ np.linalg.inv(S[np.ix_(seen, seen)]) @ new[seen] / seen.sum()
            average += (min(nis, 50.0) - average) / max(5, within)
        made = {"t": t[k], "x": x[k], "P": P[k], "f": np.exp(log_f), "c": np.sqrt(0.2 + 0.8 * average)}
        F, Q = over(seconds)
        sigma = np.sqrt(np.diag(H @ (F @ P[k] @ F.T + Q) @ H.T + np.where(np.outer(seen, seen), Rs[k], R)))
        at_rows.append(SimpleNamespace(position=H @ F @ x[k], half_width=made["f"] * made["c"] * sigma))
        if seen.any():
            waiting.append(SimpleNamespace(**made, row=k, fix=len(fix_times), z=z[k]))
            fix_times.append(t[k])
        last = t[k], x[k], P[k]
    checked.sort(key=lambda each: each.row)
    return checked, at_rows, log_f
