import numpy as np
import pytest
from conftest import AXIS

import mpt_helpers as mpt
from mpt_helpers.model import square_root


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
