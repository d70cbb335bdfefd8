"""The predictor of 2016, and the error that it really makes."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import MODELS_2016, dense_model
from oracles import gaussian_conditioning, matrices

import mpt_helpers as mpt
from mpt_helpers.metrics import error_moments

STEPS = range(11)
both_models = pytest.mark.parametrize("model", MODELS_2016.values(), ids=MODELS_2016)


def steady_of(model):
    return mpt.SteadyStateFilter.from_kalman(model)


def gap(a, b):
    return np.abs(a - b).max() / np.abs(b).max()


@pytest.mark.parametrize("steps", STEPS)
@both_models
def test_predictor_equals_propagated_estimate(model, steps):
    model = replace(model, x0=np.arange(1.0, model.n + 1))
    _, z = mpt.simulate(model, 60, np.random.default_rng(3), tracks=4)
    z[[0, 7, 8, 30], :, 1] = np.nan
    steady = steady_of(model)
    expected = np.linalg.matrix_power(model.F, steps) @ steady.filter(z)
    # F^-10 F^10 with entries up to 50 costs some three of sixteen digits.
    assert gap(mpt.SteadyStatePredictor(steady, steps).filter(z), expected) < 1e-12


@pytest.mark.parametrize("seed", range(5))
def test_predictor_of_a_dense_model_equals_propagated_estimate(seed):
    model = dense_model(seed)
    model = replace(model, F=model.F / np.abs(np.linalg.eigvals(model.F)).max())
    _, z = mpt.simulate(model, 30, np.random.default_rng(seed))
    steady, predictor = steady_of(model), mpt.SteadyStatePredictor(steady_of(model), 3)
    # F is not scaled: its condition number, cubed, is what the inverse of F^3 may cost.
    allowed = 1e-14 * np.linalg.cond(model.F) ** 3
    assert gap(predictor.filter(z), steady.filter(z) @ np.linalg.matrix_power(model.F, 3).T) < max(allowed, 1e-12)


@pytest.mark.parametrize("steps", [1, 2, 7])
@both_models
def test_prediction_is_the_conditional_mean_and_covariance(model, steps):
    """After the start of the Kalman filter has passed: conditioning on all measurements, none of the last ones seen."""
    steady = steady_of(model)
    model = replace(model, P0=steady.P, x0=np.ones(model.n))  # from its P_e on, the Kalman filter is in steady state
    _, z = mpt.simulate(model, 12 + steps, np.random.default_rng(steps))
    unseen = z.copy()
    unseen[12:] = np.nan
    x, P = gaussian_conditioning(*matrices(model), unseen)
    predictor = mpt.SteadyStatePredictor(steady_of(model), steps)
    np.testing.assert_allclose(predictor.filter(z)[11], x[-1], rtol=1e-9)
    np.testing.assert_allclose(predictor.P, P[-1], rtol=1e-9)
    # P stays at the steady state up to the rounding of three steps, in units of its largest entry.
    np.testing.assert_allclose(predictor.covariances(3), [predictor.P] * 3, rtol=1e-12)


@both_models
def test_no_steps_is_the_filter_itself(model):
    steady = steady_of(model)
    predictor = mpt.SteadyStatePredictor(steady, 0)
    for name in "ABP":
        np.testing.assert_allclose(getattr(predictor, name), getattr(steady, name), rtol=1e-14)


def test_separate_predictors_are_that_of_the_stacked_model():
    model = mpt.stack(*MODELS_2016.values())
    _, z = mpt.simulate(model, 40, np.random.default_rng(5))
    apart = mpt.Separate(*(mpt.SteadyStatePredictor(steady_of(each), 4) for each in MODELS_2016.values()))
    assert gap(apart.filter(z), mpt.SteadyStatePredictor(steady_of(model), 4).filter(z)) < 1e-10


@pytest.mark.parametrize("F", [[[1, 2], [0.5, 1]], [[0, 1], [0, 0]], np.diag([1.0, 0.0])])
def test_a_singular_transition_has_a_prediction_but_no_recursion_of_its_own(F):
    steady = steady_of(mpt.LinearModel(F=F, H=[[1, 0]], Q=np.eye(2), R=[[1]]))
    predictor = mpt.SteadyStatePredictor(steady, 1)
    z = np.arange(4.0)[:, None]
    np.testing.assert_allclose(predictor.filter(z), steady.filter(z) @ np.transpose(F), rtol=1e-12)
    with pytest.raises(ValueError, match="Singular"):
        predictor.A  # noqa: B018


@pytest.mark.parametrize("steps", [1, 3, 6])
@both_models
def test_the_prediction_is_its_own_recursion(model, steps):
    """2016 Eqs. 15-20 as printed: x(k+N/k) = A_N x(k+N-1/k-1) + B_N z(k), from F^N x0."""
    model = replace(model, x0=np.arange(1.0, model.n + 1))
    _, z = mpt.simulate(model, 60, np.random.default_rng(3))
    predictor = mpt.SteadyStatePredictor(steady_of(model), steps)
    x, predictions = np.linalg.matrix_power(model.F, steps) @ model.x0, []
    for z_k in z:
        x = predictor.A @ x + predictor.B @ z_k
        predictions.append(x)
    # F^-6 F^6 with entries up to 36 costs some three of sixteen digits.
    assert gap(predictor.filter(z), np.array(predictions)) < 1e-12


@pytest.mark.parametrize("steps", [0, 1, 5])
@both_models
def test_error_moments_are_those_of_simulated_tracks(model, steps):
    """A truth that differs in x0, P0, Q and R from the filter's model."""
    model = replace(model, x0=-np.ones(model.n))
    truth = replace(model, x0=np.arange(model.n) + 1.0, P0=0.2 * np.eye(model.n), Q=3 * model.Q, R=2 * model.R)
    M, N = 20_000, 6
    x, z = mpt.simulate(truth, N + steps, np.random.default_rng(1), tracks=M)
    steady = steady_of(model)
    e = x[steps:] - np.linalg.matrix_power(model.F, steps) @ steady.filter(z[:N])
    mean, P = error_moments(steady, truth, N, steps)
    sigma = np.sqrt(np.einsum("kii->ki", P))
    # Five standard errors: one in two million is that far off, and there are some hundred numbers.
    assert np.abs((e.mean(axis=2) - mean) / sigma).max() < 5 / np.sqrt(M)
    covariance = np.einsum("kim,kjm->kij", e - mean[..., None], e - mean[..., None]) / M
    assert np.abs((covariance - P) / sigma[:, :, None] / sigma[:, None]).max() < 5 * np.sqrt(2 / M)


@pytest.mark.parametrize("steps", [0, 4])
@both_models
def test_the_errors_covariance_tends_to_the_stated_one_when_the_model_is_true(model, steps):
    predictor = mpt.SteadyStatePredictor(steady_of(model), steps)
    mean, P = error_moments(steady_of(model), replace(model, x0=np.ones(model.n)), 200, steps)
    np.testing.assert_allclose(P[-1], predictor.P, rtol=1e-9)
    assert np.abs(mean[-1]).max() < 1e-9


def test_a_truth_of_another_motion_is_refused():
    cv, ca = MODELS_2016.values()
    for truth in (ca, replace(cv, F=[[1, 2], [0, 1]]), replace(cv, H=[[1, 1]])):
        with pytest.raises(ValueError, match="truth: needs the F and H of the filter's model"):
            error_moments(steady_of(cv), truth, 3)


@pytest.mark.parametrize(("name", "steps"), [("cv", 1000), ("ca", 100)])
def test_predictions_far_ahead_keep_their_digits(name, steps):
    model = MODELS_2016[name]
    _, z = mpt.simulate(model, 60, np.random.default_rng(3))
    expected = steady_of(model).filter(z) @ np.linalg.matrix_power(model.F, steps).T
    assert gap(mpt.SteadyStatePredictor(steady_of(model), steps).filter(z), expected) < 1e-12
