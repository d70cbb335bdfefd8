"""The model with an error state."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import AXIS

import mpt_helpers as mpt
from mpt_helpers import lasting_error

CV = mpt.constant_velocity(dt=30.0, q=0.0, r=0.04, P0=np.diag([100.0, 1.0]))
GPS_INS = mpt.gps_ins(30.0, 0.0, (1.0, 1e-4), P0=np.diag([100.0, 1.0, 1.0]))


def covariance_of_measurements(model, N):
    """The covariance of N successive measurements (N m, N m), from the definitions of F, H, Q and R."""
    n, m = model.n, model.m
    C = np.zeros((N * n, N * n))  # of the states
    P, powers = model.P0, np.eye(n)
    for k in range(N):
        P = model.F @ P @ model.F.T + model.Q
        powers = np.eye(n)
        for later in range(k, N):
            block = powers @ P
            C[later * n : (later + 1) * n, k * n : (k + 1) * n] = block
            C[k * n : (k + 1) * n, later * n : (later + 1) * n] = block.T
            powers = model.F @ powers
    H = np.kron(np.eye(N), model.H)
    return H @ C @ H.T + np.kron(np.eye(N), model.R), m


@pytest.mark.parametrize(("model", "sigma", "tau"), [(CV, 1.2, 3600.0), (GPS_INS, (0.8, 0.02), (600.0, 7200.0))])
def test_the_measurements_gain_an_error_that_fades_exponentially(model, sigma, tau):
    """Against the covariance of such errors, written down at once."""
    made, m = covariance_of_measurements(lasting_error(model, sigma, tau, dt=30.0), 6)
    plain, _ = covariance_of_measurements(model, 6)
    lag = 30.0 * np.abs(np.subtract.outer(np.arange(6), np.arange(6)))
    for j, (s, t) in enumerate(zip(np.broadcast_to(sigma, m), np.broadcast_to(tau, m), strict=True)):
        plain[j::m, j::m] += s**2 * np.exp(-lag / t)
    np.testing.assert_allclose(made, plain, rtol=1e-9)


def test_the_step_is_the_models_own():
    assert lasting_error(CV, 1.0, 600.0) == lasting_error(CV, 1.0, 600.0, dt=30.0)
    with pytest.raises(ValueError, match="dt: needs the model's own time step, 30 s, got 1 s"):
        lasting_error(CV, 1.0, 600.0, dt=1.0)
    with pytest.raises(ValueError, match="dt: needs the time step in seconds, which this model does not say, got none"):
        lasting_error(AXIS, 1.0, 600.0)


def test_the_start_and_the_states_stay_in_front():
    begun = replace(GPS_INS, x0=[1.0, 2.0, 3.0])
    model = lasting_error(begun, (0.5, 0.0), 600.0, dt=30.0)
    np.testing.assert_array_equal(model.x0, [1, 2, 3, 0, 0])
    np.testing.assert_array_equal(model.P0, np.diag([100, 1, 1, 0.25, 0]))
    np.testing.assert_array_equal(model.F[:3, :3], GPS_INS.F)
    np.testing.assert_array_equal(model.R, GPS_INS.R)


def test_without_a_lasting_error_the_filter_is_the_same():
    _, z = mpt.simulate(CV, 50, np.random.default_rng(1))
    x = mpt.KalmanFilter(lasting_error(CV, 0.0, 600.0)).filter(z)
    np.testing.assert_allclose(x[:, :2], mpt.KalmanFilter(CV).filter(z), rtol=1e-9)
    np.testing.assert_array_equal(x[:, 2], 0)


def test_a_filter_that_knows_of_it_states_what_it_makes():
    model = lasting_error(CV, 1.0, 3600.0)
    x, z = mpt.simulate(model, 100, np.random.default_rng(2), tracks=2000)
    low, high = mpt.metrics.chi_square_band(1, 2000, level=0.9999)

    def squares(estimates):
        return (estimates.x[-1, 0] - x[-1, 0]) ** 2 / estimates.P[-1, 0, 0]

    assert low < squares(mpt.KalmanFilter(model).estimates(z)).mean() < high
    assert squares(mpt.KalmanFilter(CV).estimates(z)).mean() > 100  # and one that does not is wrong by ten sigma


def test_a_fit_finds_it_without_the_truth():
    true = lasting_error(CV, 1.0, 1800.0)
    _, z = mpt.simulate(true, 3000, np.random.default_rng(3))
    z[1500] = np.nan

    def make(r, sigma, tau):
        axis = mpt.constant_velocity(dt=30.0, q=0.0, r=r, P0=CV.P0)
        return lasting_error(axis, sigma, tau)

    found = mpt.fit(make, z, r=0.5, sigma=3.0, tau=300.0)
    for name, value in {"r": 0.04, "sigma": 1.0, "tau": 1800.0}.items():
        assert abs(np.log(found.values[name] / value)) < 4 * found.log_errors[name], name


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sigma": -1.0}, "sigma: needs a number that is not negative, got -1.0"),
        ({"sigma": [1.0, 2.0]}, r"sigma: needs a number, or 1 numbers, got shape \(2,\)"),
        ({"tau": 0.0}, "tau: needs a positive number, got 0.0"),
        ({"tau": np.inf}, "tau: needs a positive number, got inf"),
        ({"dt": -1.0}, "dt: needs a positive number, got -1.0"),
    ],
)
def test_bad_numbers_are_refused_by_name(change, message):
    with pytest.raises(ValueError, match=message):
        lasting_error(**{"model": CV, "sigma": 1.0, "tau": 600.0} | change)


def test_only_a_model_gets_an_error_state():
    with pytest.raises(TypeError, match="model: needs a LinearModel"):
        lasting_error("model", 1.0, 600.0)


def test_a_filter_with_times_refuses_it():
    with pytest.raises((TypeError, ValueError), match="t: needs a model that says what a step of another length is"):
        mpt.KalmanFilter(lasting_error(CV, 1.0, 600.0), t=[0.0, 30.0, 50.0])
