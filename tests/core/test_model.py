"""Models: what they take, what they refuse, and what they simulate."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import AXIS, MODELS_2016
from filterpy.common import Q_continuous_white_noise
from scipy.integrate import quad_vec
from scipy.linalg import expm

import mpt_helpers as mpt
from mpt_helpers.model import square_root


@pytest.mark.parametrize("number", [np.float32, np.float16, np.longdouble, np.int8])
def test_numbers_of_any_real_type_are_taken_without_a_warning(number):
    assert mpt.constant_velocity(number(1), number(2), number(3)) == mpt.constant_velocity(1, 2, 3)


def test_gsm_axis_is_equation_3():
    axis = mpt.gsm_axis(dt=0.5, q=4.0, r=9.0)
    np.testing.assert_array_equal(axis.F, [[1, 0.5], [0, 1]])
    np.testing.assert_array_equal(axis.H, [[1, 0.5]])
    np.testing.assert_allclose(axis.Q, 4 * np.outer([0.25, 1], [0.25, 1]))
    np.testing.assert_array_equal(axis.R, [[9]])
    assert not axis.x0.any()
    assert not axis.P0.any()


def test_stack_is_equation_2():
    model = mpt.stack(AXIS, AXIS)
    np.testing.assert_array_equal(model.F, [[1, 1, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1], [0, 0, 0, 1]])
    np.testing.assert_array_equal(model.H, [[1, 1, 0, 0], [0, 0, 1, 1]])
    G = np.array([[0.5, 0], [1, 0], [0, 0.5], [0, 1]])
    np.testing.assert_allclose(model.Q, 0.01 * G @ G.T)
    np.testing.assert_allclose(model.R, 0.1 * np.eye(2))
    starts = [replace(AXIS, x0=x0, P0=P0 * np.eye(2)) for x0, P0 in (([1.0, 2.0], 1.0), ([3.0, 4.0], 2.0))]
    np.testing.assert_array_equal(mpt.stack(*starts).x0, [1, 2, 3, 4])
    np.testing.assert_array_equal(mpt.stack(*starts).P0, np.diag([1, 1, 2, 2]))


def test_models_are_equal_by_their_numbers():
    assert mpt.gsm_axis(1, 0.01, 0.1) == AXIS
    assert mpt.gsm_axis(1, 0.01, 0.2) != AXIS
    assert mpt.stack(AXIS) == AXIS
    assert AXIS != "a model"


def test_a_model_keeps_its_own_copy():
    F = np.eye(2)
    model = mpt.LinearModel(F=F, H=[[1, 0]], Q=np.eye(2), R=[[1]])
    F[0, 0] = 5
    assert model.F[0, 0] == 1


@pytest.mark.parametrize(
    "C", [np.zeros((2, 2)), np.diag([4.0, 0.0]), [[0.0025, 0.005], [0.005, 0.01]], np.diag([1e12, 1.0, 1e-12])]
)
def test_square_root_squares_to_the_matrix(C):
    root = square_root(C)
    np.testing.assert_allclose(root @ root.T, C, rtol=1e-14, atol=1e-17)


def test_square_root_of_a_singular_matrix_is_singular():
    # The square root of an eigenvalue that is the rounding of a zero would be 1e-8.
    assert np.linalg.svd(square_root(AXIS.Q), compute_uv=False)[1] < 1e-15


def test_simulated_tracks_have_the_covariances_of_the_model():
    P0 = np.array([[4.0, 1.0], [1.0, 2.0]])
    model = mpt.LinearModel(F=[[1, 1], [0, 1]], H=[[1, 1]], Q=[[0.5, 0.2], [0.2, 0.3]], R=[[0.7]], x0=[5, -3], P0=P0)
    M = 200_000
    x, z = mpt.simulate(model, 2, np.random.default_rng(0), tracks=M)
    first = model.F @ P0 @ model.F.T + model.Q
    second = model.F @ first @ model.F.T + model.Q
    # The relative standard error of a variance over M tracks is sqrt(2 / M) = 0.3 %; four of it.
    for mean, C, drawn in ((model.F @ model.x0, first, x[0]), (model.F @ model.F @ model.x0, second, x[1])):
        np.testing.assert_allclose(drawn.mean(axis=1), mean, atol=4 * np.sqrt(C.max() / M))
        np.testing.assert_allclose(np.cov(drawn), C, atol=4 * np.sqrt(2 / M) * C.max())
    np.testing.assert_allclose(np.cov(z[1] - model.H @ x[1]), model.R[0, 0], rtol=4 * np.sqrt(2 / M))


def test_simulation_from_zero_covariance_starts_at_x0():
    model = mpt.LinearModel(F=np.eye(2), H=[[1, 0]], Q=np.zeros((2, 2)), R=[[1]], x0=[1, 2])
    x, _ = mpt.simulate(model, 3, np.random.default_rng(0))
    np.testing.assert_array_equal(x, [[1, 2]] * 3)


def test_simulation_is_reproducible():
    draws = [mpt.simulate(AXIS, 5, np.random.default_rng(4), tracks=3) for _ in range(2)]
    for first, second in zip(*draws, strict=True):
        np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("dt", [1e-3, 0.3, 1.0, 20.0])
@pytest.mark.parametrize(("make", "n"), [(mpt.constant_velocity, 2), (mpt.constant_acceleration, 3)])
def test_equations_5_and_6_of_2016_are_the_integrals(make, n, dt):
    """F is the matrix exponential and Q the integral of the driving noise, entry by entry; filterpy has the same Q."""
    model, drift, G = make(dt, 0.7, 0.3), np.eye(n, k=1), np.eye(n)[:, -1:]
    np.testing.assert_allclose(model.F, expm(drift * dt), rtol=1e-14)
    integral, _ = quad_vec(lambda t: (expm(drift * t) @ G) @ (expm(drift * t) @ G).T, 0, dt, epsabs=0, epsrel=1e-12)
    np.testing.assert_allclose(model.Q, 0.7 * integral, rtol=1e-10)
    np.testing.assert_allclose(model.Q, Q_continuous_white_noise(n, dt, 0.7), rtol=1e-14)
    np.testing.assert_array_equal(model.H, np.eye(n)[:1])
    assert model.R == [[0.3]]
    assert not model.x0.any()
    assert not model.P0.any()


@pytest.mark.parametrize("model", MODELS_2016.values(), ids=MODELS_2016)
def test_the_mean_track_is_what_simulate_draws_without_noise(model):
    truth = mpt.exact_motion(model, np.arange(1.0, model.n + 1))
    x, z = mpt.simulate(truth, 20, np.random.default_rng(0))
    np.testing.assert_array_equal(x, mpt.mean_track(truth, 20))
    np.testing.assert_allclose(
        mpt.mean_track(truth, 20)[19], np.linalg.matrix_power(model.F, 20) @ truth.x0, rtol=1e-14
    )
    assert np.ptp(z[:, 0] - x[:, 0]) > 0.1  # the measurements keep their noise
    assert (truth.F == model.F).all()
    assert (truth.R == model.R).all()
