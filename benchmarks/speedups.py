"""The papers' filters step by step, in like-for-like numpy: what their operation counts become on a clock.

A step is written once for each filter. Arrays are (rows, columns, tracks): with one track a step costs its calls, with
many tracks, each with a covariance of its own, it costs its operations.
"""

from functools import partial

import numpy as np

import mpt_helpers as mpt
from mpt_helpers.equations import lainiotis_matrices


def product(*matrices):
    """Return the matrix product for each track."""
    result = matrices[0]
    for each in matrices[1:]:
        result = np.einsum("ijt,jkt->ikt", result, each)
    return result


def inverse(matrix):
    """Return the matrix inverse for each track: numpy's for one, an elimination over all tracks at once for many."""
    p, _, tracks = matrix.shape
    if tracks == 1:
        return np.linalg.inv(matrix[..., 0])[..., None]
    rows = np.concatenate([matrix, np.repeat(np.eye(p)[..., None], tracks, axis=2)], axis=1)
    for i in range(p):  # no pivot is small: S and I + P O_n have eigenvalues away from zero
        pivot = rows[i] / rows[i, i]
        rows = rows - rows[:, i, None] * pivot
        rows[i] = pivot
    return rows[:, p:]


def transposed(matrix):
    """Return the transpose for each track."""
    return matrix.swapaxes(0, 1)


def kalman_step(F, H, Q, R, identity, x, P, z):
    """One step of 2014 Eq. 4: gain, estimate, covariance."""
    x, P = product(F, x), product(F, P, transposed(F)) + Q
    K = product(P, transposed(H), inverse(product(H, P, transposed(H)) + R))
    return x + product(K, z - product(H, x)), product(identity - product(K, H), P)


def lainiotis_step(Fn, Kn, Km, Pn, On, identity, x, P, z):
    """One step of 2014 Eqs. 5-6."""
    A = product(Fn, inverse(identity + product(P, On)))
    return product(A, x) + product(Kn + product(A, P, Km), z), product(A, P, transposed(Fn)) + Pn


def steady_step(A, B, x, P, z):
    """One step with constant coefficients."""
    return product(A, x) + product(B, z), P


def shared_step(A, B, x, z):
    """One step of many tracks that share their coefficients, however they were made: x (n, M), z (m, M)."""
    return A @ x + B @ z


def steps(model, tracks):
    """Return the step of each filter over so many tracks, a function without arguments."""

    def same(matrix):
        return np.repeat(matrix[:, :, None], tracks, axis=2)

    rng = np.random.default_rng(0)
    x, z = rng.standard_normal((model.n, 1, tracks)), rng.standard_normal((model.m, 1, tracks))
    steady = mpt.SteadyStateFilter.from_kalman(model)
    P, identity = same(steady.P), same(np.eye(model.n))
    kalman = [same(each) for each in (model.F, model.H, model.Q, model.R)]
    lainiotis = [same(each) for each in lainiotis_matrices(model)[:5]]
    return {
        "KF": partial(kalman_step, *kalman, identity, x, P, z),
        "LF": partial(lainiotis_step, *lainiotis, identity, x, P, z),
        "SS": partial(steady_step, same(steady.A), same(steady.B), x, P, z),
    }


def shared_steps(model, tracks):
    """Return the step of each filter over so many tracks that share their coefficients: it is the same for all."""
    rng, steady = np.random.default_rng(0), mpt.SteadyStateFilter.from_kalman(model)
    step = partial(shared_step, steady.A, steady.B, rng.standard_normal((model.n, tracks)))
    step = partial(step, rng.standard_normal((model.m, tracks)))
    return dict.fromkeys(("KF", "LF", "SS"), step)


def agree(tolerance):
    """Raise AssertionError unless the steps of all filters agree, one track or many, model A or B."""
    axis = mpt.gsm_axis(dt=1.0, q=0.01, r=0.1)
    for model in (axis, mpt.stack(axis, axis), mpt.stack(axis, axis, axis)):
        for tracks in (1, 3):
            results = [step() for step in steps(model, tracks).values()]
            for x, P in results[1:]:
                np.testing.assert_allclose(x, results[0][0], rtol=0, atol=tolerance)
                np.testing.assert_allclose(P, results[0][1], rtol=0, atol=tolerance)
