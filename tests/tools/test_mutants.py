"""Break the package in a dozen ways that matter, one at a time: a short comparison with plain loops must see each.

A mutant is told by what it breaks: a function put in the place of ours, whatever its lines read like.
"""

from contextlib import suppress

import numpy as np
import pytest
from oracles import plain_loop, plain_smoother

import mpt_helpers as mpt
from mpt_helpers import equations, kalman, lainiotis, metrics, steady
from mpt_helpers._engine import columns, pieces, run, shared, smoother

CV = mpt.constant_velocity(0.7, 0.04, 0.5, x0=[1.0, 2.0], P0=np.eye(2) + 0.1)
T = np.cumsum(np.random.default_rng(1).choice([0.1, 0.7, 3.0], 60))
Z = mpt.simulate(CV, 60, np.random.default_rng(2), tracks=3)[1]
GAPPY = np.where(np.random.default_rng(3).random(Z.shape) < 0.2, np.nan, Z)


def near(a, b):
    return np.allclose(a, b, rtol=1e-8, atol=1e-9)


def all_is_well():
    """Say whether filters, smoother, likelihood and steady state are the plain loops."""
    R = [CV.R] * len(Z)
    for t, steps in ((None, [(CV.F, CV.Q)] * len(Z)), (T, [CV.over(dt) for dt in np.diff(T, prepend=T[0] - 0.7)])):
        kf = mpt.KalmanFilter(CV, t=t)
        for z in (Z, GAPPY, GAPPY[..., :1]):
            e, s, log_density = kf.estimates(z), kf.smooth(z), metrics.log_likelihood(kf, z)
            for i in range(z.shape[2]):
                loop = plain_loop(steps, CV.H, R, CV.x0, CV.P0, z[..., i])
                x, P = plain_smoother(steps, loop.x, loop.P)
                pairs = [(e.x[..., i], loop.x), (e.P[..., i], loop.P), (s.x[..., i], x), (s.P[..., i], P)]
                pairs.append((log_density[i], loop.log_density))
                if not all(near(*pair) for pair in pairs):
                    return False
    kf, lf = mpt.KalmanFilter(CV), mpt.LainiotisFilter(CV)
    both = [mpt.SteadyStateFilter.from_kalman(CV), mpt.SteadyStateFilter.from_lainiotis(CV)]
    settled = kf.covariances(300)[-1]
    missed = both[0].covariances(GAPPY[..., 0])
    P = settled
    for z_k, P_k in zip(GAPPY[..., 0], missed, strict=True):
        P = CV.F @ P @ CV.F.T + CV.Q
        if np.isfinite(z_k).all():
            P = (np.eye(2) - both[0].B @ CV.H) @ P @ (np.eye(2) - both[0].B @ CV.H).T + both[0].B @ CV.R @ both[0].B.T
        if not near(P, P_k):
            return False
    return near(lf.filter(Z), kf.filter(Z)) and all(near(each.P, settled) for each in both)


def with_gain_where_missing(x, P, z, seen, variance, i, scalar_update=columns.scalar_update):
    return scalar_update(x, P, z, np.ones_like(seen), variance, i)


def turned(self, x, map_state=columns.LinearMap.map_state):
    return map_state(columns.LinearMap(self.matrix.swapaxes(0, 1)), x)


def without_the_noise_of_z(P, K, H, R):
    keep = np.eye(P.shape[-1]) - K @ H
    return keep @ P @ keep.swapaxes(-1, -2)


def half_a_step(A, B):
    return shared.recursion(np.asarray(A) / 2, B, *unit_inputs(B)).reshape(-1, unit_inputs(B)[0].shape[1])


def unit_inputs(B):
    L, n, m = np.shape(B)
    inputs = np.eye(n + L * m)
    return inputs[:n], inputs[n:].reshape(L, m, -1)


def starts_at_zero(advance, rows, x0, P0, boundary_states=pieces.boundary_states):
    x, P = boundary_states(advance, rows, x0, P0)
    return np.zeros_like(x), P


def backward_coefficients_without_noise(motion, x, P, backward_coefficients=smoother._backward_coefficients):
    return backward_coefficients(type(motion)(motion.matrix, 0 * motion.Q), x, P)


def step_from_zero(P, constants, lainiotis_step=equations.lainiotis_step):
    return lainiotis_step(0 * P, constants)


def twice_the_noise(H, R, unit_measurements=equations.unit_measurements):
    return unit_measurements(H, 2 * R)


MUTANTS = {
    "a missing measurement has a gain": (columns, "scalar_update", with_gain_where_missing),
    "columns without process noise": (columns.Motion, "noise_like", lambda self, P: 0.0),
    "F transposed on columns": (columns.Motion, "map_state", turned),
    "several steps in one product, with A halved": (shared, "product_of_steps", half_a_step),
    "a filter has converged at once": (shared, "_has_not_moved", lambda before, after: True),
    "tracks of other gaps share a column": (columns.Epochs, "width", 1),
    "a piece starts as the one before it": (pieces, "advance_piece", lambda row, x, P: (x, P, x[:0])),
    "all pieces start at zero": (pieces, "boundary_states", starts_at_zero),
    "the way back without process noise": (smoother, "_backward_coefficients", backward_coefficients_without_noise),
    "innovations against the state after": (run, "_previous", lambda array, start, part: array[part]),
    "Joseph's form without K R K'": (steady, "corrected_covariance", without_the_noise_of_z),
    "a Lainiotis step that forgets P": (lainiotis, "lainiotis_step", step_from_zero),
    "gains of measurements of twice the noise": (kalman, "unit_measurements", twice_the_noise),
}


def test_all_is_well():
    assert all_is_well()


@pytest.mark.parametrize(("place", "name", "wrong"), MUTANTS.values(), ids=MUTANTS)
def test_what_is_broken_is_seen(monkeypatch, place, name, wrong):
    monkeypatch.setattr(place, name, wrong)
    if place is pieces:  # that pieces do not fit together would be seen, and the track would not be cut
        monkeypatch.setattr(pieces, "boundaries_match", lambda *ends: True)
    with suppress(ValueError):  # which is a way to see it, too
        assert not all_is_well()
