"""Innovations, NIS, NEES, likelihood and moments of errors against oracles."""

import numpy as np
import pytest
from conftest import MODELS_2016, dense_model
from scipy.linalg import block_diag

import mpt_helpers as mpt
from mpt_helpers.metrics import chi_square_band, innovations, log_likelihood, nees, nis, relative_gap, rms


def test_relative_gap_and_rms():
    assert relative_gap([[1.0, 2.0]], [[1.0, -4.0]]) == pytest.approx(6 / 4)
    assert (
        relative_gap(np.array([-1], np.int8), np.array([-128], np.int8)) == 127 / 128
    )  # its absolute value is no int8
    assert [relative_gap([0.0], [0.0]), relative_gap([1.0], [0.0])] == [0.0, np.inf]
    assert rms([3.0, 4.0]) == pytest.approx(np.sqrt(12.5))
    np.testing.assert_allclose(rms([[3.0, 4.0], [0.0, 2.0]], axis=0), [np.sqrt(4.5), np.sqrt(10)])


def test_nees_is_the_quadratic_form_of_each_step_and_track():
    rng = np.random.default_rng(0)
    roots = rng.standard_normal((7, 3, 3))
    P = roots @ roots.transpose(0, 2, 1)
    errors = rng.standard_normal((7, 3, 5))
    expected = [[errors[k, :, i] @ np.linalg.inv(P[k]) @ errors[k, :, i] for i in range(5)] for k in range(7)]
    np.testing.assert_allclose(nees(errors, P), expected, rtol=1e-9)
    np.testing.assert_allclose(nees(errors[..., 0], P), np.array(expected)[:, 0], rtol=1e-9)
    np.testing.assert_allclose(nees(errors, P[0])[0], expected[0], rtol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_innovations_are_what_the_textbook_subtracts(seed):
    model = dense_model(seed)
    _, z = mpt.simulate(model, 6, np.random.default_rng(seed), tracks=3)
    F, H, Q, R, P = model.F, model.H, model.Q, model.R, model.P0
    x = np.repeat(model.x0[:, None], 3, axis=1)
    made = innovations(mpt.KalmanFilter(model), z)
    for k in range(6):
        x, P = F @ x, F @ P @ F.T + Q
        S = H @ P @ H.T + R
        np.testing.assert_allclose(made.values[k], z[k] - H @ x, rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(made.S[k], np.repeat(S[..., None], 3, axis=2), rtol=1e-9)
        K = P @ H.T @ np.linalg.inv(S)
        x, P = x + K @ (z[k] - H @ x), (np.eye(model.n) - K @ H) @ P
    np.testing.assert_allclose(innovations(mpt.KalmanFilter(model), z[..., 0]).values, made.values[..., 0], rtol=1e-9)


@pytest.mark.parametrize("steady", [False, True])
@pytest.mark.parametrize("model", MODELS_2016.values(), ids=MODELS_2016)
def test_a_filter_of_the_true_model_is_consistent(model, steady):
    """NEES and NIS are chi-square with n and m degrees of freedom at every step, from the first on."""
    P = mpt.SteadyStateFilter.from_kalman(model).P
    model = mpt.LinearModel(**{name: getattr(model, name) for name in "FHQR"}, x0=np.ones(model.n), P0=P)
    each = mpt.SteadyStateFilter.from_kalman(model) if steady else mpt.KalmanFilter(model)
    x, z = mpt.simulate(model, 40, np.random.default_rng(2), tracks=5000)
    for values, dof in ((nees(x - each.filter(z), each.covariances(40)), model.n), (nis(each, z), model.m)):
        # All but one in a million bands of one step; over forty steps one in 25,000.
        low, high = chi_square_band(dof, 5000, level=1 - 1e-6)
        mean = values.mean(axis=1)
        assert ((low < mean) & (mean < high)).all()
        assert values.var() == pytest.approx(2 * dof, rel=0.05)


def test_the_chi_square_band_holds_what_it_says():
    mean = np.random.default_rng(0).chisquare(3, (20_000, 50)).mean(axis=1)
    low, high = chi_square_band(3, 50, level=0.9)
    # 20,000 trials know a share of 5 % to 0.15 %.
    assert np.mean(mean < low) == pytest.approx(0.05, abs=0.0075)
    assert np.mean(mean > high) == pytest.approx(0.05, abs=0.0075)


def test_each_matrix_must_be_symmetric_by_its_own_size():
    with pytest.raises(ValueError, match=r"P: .* not symmetric"):
        nees(np.ones((2, 2)), np.array([1e7 * np.eye(2), [[1, 0.9], [-0.9, 1]]]))


def test_innovations_of_steady_filters_joined_or_side_by_side_are_those_of_the_steady_filter():
    model = mpt.gsm_axis(dt=1.0, q=0.01, r=0.1)
    steady = mpt.SteadyStateFilter.from_kalman(model)
    z = mpt.simulate(model, 20, np.random.default_rng(1))[1]
    for each in (mpt.JoinFilter(steady, steady), mpt.Separate(steady)):
        np.testing.assert_allclose(nis(each, z), nis(steady, z), rtol=1e-12)  # some ten products
        np.testing.assert_allclose(innovations(each, z).S[0], innovations(each, z).S[-1], rtol=1e-12)
    both = mpt.Separate(steady, mpt.KalmanFilter(model))
    np.testing.assert_array_equal(both.P0, block_diag(steady.P, model.P0))


@pytest.mark.parametrize("make", [innovations, nis, log_likelihood])
@pytest.mark.parametrize("seen", [1, 400])
def test_states_beyond_doubles_are_no_missing_measurements(make, seen):
    """Without process noise the state grows to infinity; with no measurement but the last, its covariance does."""
    model = mpt.LinearModel(F=[[10.0]], H=[[1.0]], Q=[[0.0 if seen > 1 else 1.0]], R=[[1.0]], x0=[1.0])
    z = np.zeros((400, 1))
    z[:-seen] = np.nan
    with (
        np.errstate(all="ignore"),
        pytest.raises(ValueError, match=r": needs .*(doubles|double precision).* got an overflow"),
    ):
        make(mpt.KalmanFilter(model), z)
