"""Three axes on a clock: one filter of six states, three filters of two, and the axes as columns of one (2015).

Each step is written once, in the plainest numpy. For one phone a step costs its calls. For many phones side by side,
each with a covariance of its own, it costs its operations.
"""

from functools import partial

import numpy as np
import speedups

import mpt_helpers as mpt
from reproduction import burden

PHONES = 10_000  # side by side: a call costs nothing beside its operations
BASE = "one filter of six states"  # what all others are held against
AXIS = mpt.gsm_axis(dt=1.0, q=0.01, r=0.1)
THREE = mpt.stack(AXIS, AXIS, AXIS)


def operations():
    """Return the operations of one step for three axes, {name: count}, counted as the papers do.

    >>> operations()["axes as columns, one P and K"]
    101
    """
    columns = burden.total(burden.kalman_columns(2, 1, axes=3))
    three = 3 * burden.total(burden.kalman(2, 1))
    constant = 3 * burden.total(burden.steady_state(2, 1))
    return {
        BASE: burden.total(burden.kalman(6, 3)),
        "three filters of two states": three,
        "axes as columns, one P and K": columns,
        "axes as columns, one P and K, by `inv`": columns,
        "axes stacked, a P for each": three,
        "constant gain: one filter of six states": burden.total(burden.steady_state(6, 3)),
        "constant gain: three filters of two states": constant,
        "constant gain: axes as columns": constant,
    }


def kalman(F, H, Q, R, x, P, z):
    """Return x and P after a step of 2015 Eq. 1."""
    x, P = F @ x, F @ P @ F.T + Q
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    return x + K @ (z - H @ x), P - K @ H @ P


def divided(F, H, Q, r, X, P, z):
    """Return X and P after the same step for one measured number per axis: S is a number, so its inverse a division.

    The axes are the columns of X (2, 3) and z (1, 3).
    """
    X, P = F @ X, F @ P @ F.T + Q
    K = P @ H.T / (H @ P @ H.T + r)
    return X + K * (z - H @ X), P - K @ H @ P


def stacked(F, H, Q, r, X, P, z):
    """Return X and P after the same step with a P for each axis: X (3, 2, 1), P (3, 2, 2), z (3,) with NaN."""
    seen = np.isfinite(z)
    X, P = F @ X, F @ P @ F.T + Q
    K = P @ H.T / (H @ P @ H.T + r) * seen[:, None, None]
    return X + K * (np.where(seen, z, 0.0)[:, None, None] - H @ X), P - K @ H @ P


def constant(A, B, x, z):
    """Return x after a step with constant coefficients."""
    return A @ x + B @ z


def three_times(step, states, measured):
    """Return what three filters make of their own axis, one after the other."""
    return [step(*state, z) for state, z in zip(states, measured, strict=True)]


def one_phone():
    """Return the step of each way to run one phone's filter, {name: function without arguments}."""
    X = np.arange(6.0).reshape(2, 3)  # axes as columns
    z = np.array([[0.5, 1.5, 2.5]])
    P = mpt.SteadyStateFilter.from_kalman(AXIS).P
    small = AXIS.F, AXIS.H, AXIS.Q, AXIS.R
    r = AXIS.R.item()
    divide = partial(divided, *small[:3], r)
    steady, big = (mpt.SteadyStateFilter.from_kalman(each) for each in (AXIS, THREE))
    columns, axes = [X[:, [i]] for i in range(3)], [z[:, [i]] for i in range(3)]
    in_one = X.T.reshape(6, 1), z.reshape(3, 1)
    return {
        BASE: partial(kalman, THREE.F, THREE.H, THREE.Q, THREE.R, in_one[0], np.kron(np.eye(3), P), in_one[1]),
        "three filters of two states": partial(three_times, divide, [(x, P) for x in columns], axes),
        "axes as columns, one P and K": partial(divide, X, P, z),
        "axes as columns, one P and K, by `inv`": partial(kalman, *small, X, P, z),
        "axes stacked, a P for each": partial(stacked, *small[:3], r, X.T[:, :, None], np.stack([P] * 3), z[0]),
        "constant gain: one filter of six states": partial(constant, big.A, big.B, *in_one),
        "constant gain: three filters of two states": partial(
            three_times, partial(constant, steady.A, steady.B), [(x,) for x in columns], axes
        ),
        "constant gain: axes as columns": partial(constant, steady.A, steady.B, X, z),
    }


def many_phones(phones=PHONES):
    """Return the step over many phones, each with its own covariance: {name: function without arguments}."""
    big, small = speedups.steps(THREE, phones)["KF"], speedups.steps(AXIS, phones)["KF"]
    *coefficients, x, P, z = small.args
    side_by_side = partial(speedups.kalman_step, *coefficients, np.repeat(x, 3, axis=1), P, np.repeat(z, 3, axis=1))
    return {
        BASE: big,
        "three filters of two states": lambda: [small() for _ in range(3)],
        "axes as columns, one P and K": side_by_side,
    }


def estimates(result):
    """Return position and velocity by axis, (2, 3), from what any step of `one_phone` returns."""
    if isinstance(result, list):  # three filters, one after the other
        return np.hstack([estimates_of_one(each) for each in result])
    X = estimates_of_one(result)
    return X.reshape(3, 2).T if X.shape in ((6, 1), (3, 2, 1)) else X


def estimates_of_one(result):
    """Return x of a step that returns x and P, or x alone."""
    return result[0] if isinstance(result, tuple) else result


def agree(tolerance):
    """Raise AssertionError unless all ways make the same estimates: P is the settled one, so constant gain too."""
    results = {name: estimates(step()) for name, step in one_phone().items()}
    for name, each in results.items():
        np.testing.assert_allclose(each, results[BASE], rtol=0, atol=tolerance, err_msg=name)


def on_the_clock(measure):
    """Return a row for each way, with its operations, its time for one phone and for many, and their ratios to BASE.

    measure takes {name: function} and returns {name: [seconds in each round]}. A ratio is the median over the rounds.
    """
    rows = []
    one, many = measure(one_phone(), title="axes, one phone"), measure(many_phones(), title="axes, many phones")
    for name, count in operations().items():
        row = {"name": name, "operations": count}
        for kind, samples in (("one", one), ("many", many)):
            if name in samples:
                row[f"{kind}_us"] = 1e6 * float(np.median(samples[name]))
                row[kind] = float(np.median(np.divide(samples[name], samples[BASE])))
        rows.append(row)
    return rows
