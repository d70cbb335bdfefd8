"""Table 1 of 2016: expected and simulated averages, and the probability of the print."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import MODELS_2016
from scipy.stats import multivariate_normal

import mpt_helpers as mpt
from reproduction.paper_2016 import table1

COLUMNS = table1.columns()
PRINTED = {key: column.printed for key, column in COLUMNS.items()}
both_models = pytest.mark.parametrize("column", COLUMNS.values(), ids=COLUMNS)


def test_the_columns_are_the_papers_examples():
    for key, model in MODELS_2016.items():
        for name in "FHQR":
            np.testing.assert_array_equal(getattr(COLUMNS[key].steady.model, name), getattr(model, name))
    faster = table1.columns(dt=0.5, size=2.0)["ca"]
    assert faster.starts == ((0, 0, 4), (0, 0, 6))
    assert faster.steady.model.F[0, 1] == 0.5


def better_start(column):
    """The Kalman filter that knows the position at the start, but not velocity and acceleration."""
    model = column.steady.model
    return mpt.KalmanFilter(replace(model, P0=np.diag([0.0, 1e4, 1e4][: model.n])))


def relative_errors(column, noise, seed, runs):
    return table1.relative_errors(column, noise, np.random.default_rng(seed), runs)


@both_models
@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_errors_are_those_of_plain_loops(column, noise):
    """One run, by hand: the filter's recursion, then F^N, against the same draws."""
    errors, positions = table1.errors(column, 1, noise, np.random.default_rng(3), 1)
    steady, F = column.steady, column.steady.model.F
    states, z = mpt.simulate(column.truth(1, noise), table1.TRANSIENT + 5, np.random.default_rng(3), tracks=1)
    x = np.zeros(len(F))
    for k in range(table1.TRANSIENT):
        x = steady.A @ x + steady.B @ z[k, :, 0]
        for N in range(6):
            s = states[k + N, 0, 0]
            assert positions[N, k, 0] == s
            assert errors[N, k, 0] == pytest.approx(s - (np.linalg.matrix_power(F, N) @ x)[0], rel=1e-9, abs=1e-9)


@both_models
def test_measurement_noise_may_be_given_for_each_axis(column):
    """Without any on x, the errors are their own mean; with it on y, they are as if it had been drawn."""
    drawn = mpt.simulate(column.truth(1), table1.TRANSIENT + 5, np.random.default_rng(3), tracks=2)
    v = drawn[1] - drawn[0][:, :1]
    ratio = table1.relative_errors(column, 0.0, np.random.default_rng(4), 2, (0 * v, v))
    mean, _ = table1.mean_and_variance(column, 0, table1.TRANSIENT)
    expected = np.abs(mean / column.positions(0, table1.TRANSIENT))
    np.testing.assert_allclose(ratio["x"][:, :, 1], expected, rtol=1e-9, atol=1e-12)
    e, s = table1.errors(column, 1, 0.0, np.random.default_rng(3), 2)
    np.testing.assert_allclose(ratio["y"], np.abs(e / s), rtol=1e-9, atol=1e-12)


@both_models
def test_the_axes_are_x_y_their_mean_and_the_plane(column):
    rng = np.random.default_rng(5)
    (e_x, s_x), (e_y, s_y) = (table1.errors(column, axis, 0.5, rng, 3) for axis in (0, 1))
    ratio = relative_errors(column, 0.5, 5, 3)
    np.testing.assert_allclose(ratio["x"], np.abs(e_x / s_x))
    np.testing.assert_allclose(ratio["both"], (np.abs(e_x / s_x) + np.abs(e_y / s_y)) / 2)
    np.testing.assert_allclose(ratio["plane"], np.hypot(e_x, e_y) / np.hypot(s_x, s_y))


def test_the_expected_absolute_value_is_that_of_drawn_numbers():
    rng = np.random.default_rng(0)
    mean, variance = np.array([0.0, 0.5, -2.0, 10.0]), np.array([1.0, 4.0, 1.0, 1e-4])
    drawn = np.abs(mean + np.sqrt(variance) * rng.standard_normal((200_000, 4)))
    expected = table1.expected_absolute(mean, variance)
    np.testing.assert_allclose(expected, drawn.mean(axis=0), atol=5 * 2 / np.sqrt(200_000))


@both_models
def test_expected_averages_are_the_mean_of_many_runs(column):
    ratio = relative_errors(column, 0, 1, 2000)
    lengths = [1, 9, 110, 10_000]
    for axis in (0, 1):
        expected = table1.expected_averages(column, axis, max(lengths))
        for L, runs in zip(lengths, table1.averages(column, ratio["xy"[axis]], lengths), strict=True):
            off = np.abs(runs.mean(axis=1) - expected[:, L - 1])
            # Five standard errors, and one part in a thousand for the steps that are not simulated.
            assert (off < 5 * runs.std(axis=1) / np.sqrt(2000) + 1e-3 * expected[:, L - 1]).all()


@pytest.mark.parametrize("starts", [((0, 20), (5, 30)), ((0, 20), (30, 0)), ((0, 0), (0, 0))])
def test_starts_that_are_not_in_proportion_are_refused(starts):
    """Beyond step 110, averages take the positions on both axes to grow alike."""
    with pytest.raises(ValueError, match=r"starts: needs x\(0\) on both axes in proportion, got "):
        replace(COLUMNS["cv"], starts=starts)


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_averages_over_long_runs_are_those_of_long_simulations(noise, monkeypatch):
    column = COLUMNS["cv"]
    short = table1.averages(column, relative_errors(column, noise, 1, 500)["x"], [800])[0]
    monkeypatch.setattr(table1, "TRANSIENT", 800)
    long = table1.averages(column, relative_errors(column, noise, 2, 500)["x"], [800])[0]
    # Five standard errors of the differences of the means and of the standard deviations.
    off = np.abs(short.mean(axis=1) - long.mean(axis=1))
    assert (off < 5 * np.sqrt((short.var(axis=1) + long.var(axis=1)) / 500)).all()
    ratio = long.std(axis=1) / short.std(axis=1)
    assert (np.abs(ratio - 1) < 5 * np.hypot(error_of_sigma(short), error_of_sigma(long))).all()


def error_of_sigma(runs):
    """The relative standard error of the standard deviation of runs (..., M): √((κ - 1) / 4M), κ the kurtosis."""
    kurtosis = ((runs - runs.mean(axis=-1, keepdims=True)) ** 4).mean(axis=-1) / runs.var(axis=-1) ** 2
    return np.sqrt((kurtosis - 1) / 4 / runs.shape[-1])


@both_models
def test_averages_of_several_lengths_are_those_of_each(column):
    ratio = relative_errors(column, 1.0, 1, 4)["both"]
    lengths = [2, 50, 110, 111, 5000]
    together = table1.averages(column, ratio, lengths)
    for L, each in zip(lengths, together, strict=True):
        np.testing.assert_allclose(table1.averages(column, ratio, [L])[0], each, rtol=1e-12)
    np.testing.assert_allclose(together[1], ratio[:, :50].mean(axis=1), rtol=1e-12)


def test_the_first_step_beyond_the_simulation_has_the_mean_error_at_its_own_position():
    ratio = relative_errors(COLUMNS["cv"], 0, 1, 50)["x"]
    at_110, at_111 = table1.averages(COLUMNS["cv"], ratio, [110, 111])
    N = np.arange(6)[:, None]
    error = ratio * 20 * (np.arange(1, 111) + N)[:, :, None]
    step = error[:, 80:].mean(axis=(1, 2))[:, None] / (20 * (111 + N))
    np.testing.assert_allclose(111 * at_111 - 110 * at_110, np.broadcast_to(step, at_110.shape), rtol=1e-9)


@both_models
def test_the_noise_of_a_track_is_a_multiple_of_the_filters(column):
    truth = column.truth(1, noise=2.5)
    np.testing.assert_array_equal(truth.Q, 2.5 * column.steady.model.Q)
    np.testing.assert_array_equal(truth.x0, column.starts[1])
    assert not truth.P0.any()


@both_models
def test_a_better_start_lowers_every_number(column):
    better = table1.expected_averages(column, 0, 10_000, better_start(column))[:, -1]
    assert (better < 0.7 * table1.expected_averages(column, 0, 10_000)[:, -1]).all()


@both_models
def test_the_steady_state_filter_is_the_default(column):
    """And a Kalman filter that starts at its covariance has its gain."""
    kf = mpt.KalmanFilter(replace(column.steady.model, P0=column.steady.P))
    given = table1.expected_averages(column, 0, 300, kf)
    np.testing.assert_allclose(given, table1.expected_averages(column, 0, 300), rtol=1e-9)


@pytest.mark.parametrize("numbers", [6, 12])
def test_the_likelihood_is_a_gaussian_density_times_the_last_digits(numbers):
    rng = np.random.default_rng(0)
    root = 1e-3 * rng.standard_normal((numbers, numbers))
    samples = (root @ rng.standard_normal((numbers, 2000)) + 0.02)[None]
    C = np.cov(samples[0]) + 1e-8 / 12 * np.eye(numbers)
    tables = samples[0][:, :3].round(4)
    expected = multivariate_normal(samples[0].mean(axis=1), C).logpdf(tables.T) + numbers * np.log(1e-4)
    np.testing.assert_allclose(table1.log_likelihood(samples, tables)[0], expected, rtol=1e-9)


def test_the_likelihood_is_the_share_of_runs_that_print_the_table():
    """Where runs print the six numbers often enough to be counted: constant velocity, y axis, 9,800 steps, percent."""
    column = COLUMNS["cv"]
    samples = 100 * table1.averages(column, relative_errors(column, 0, 1, 8_000)["y"], [9800])
    share = (np.abs(samples[0] - PRINTED["cv"][:, None]) < 0.5e-4).all(axis=0).mean()
    p = np.exp(table1.log_likelihood(samples, PRINTED["cv"][:, None]))[0, 0]
    # The rounding of six numbers that vary together is not Gaussian: a factor of 2 in 1/20, far below the odds found.
    assert 0.03 < share < 0.12
    assert 0.5 < p / share < 2


def test_the_odds_point_to_the_reading_that_made_a_table():
    """Tables of 10,000 steps in percent without noise, and of 97 steps as fractions with noise, means of both axes."""
    lengths = {0: [9800, 9900, 10_000, 10_100, 10_200], 1: [95, 96, 97, 98, 99]}
    samples, tables = {}, {}
    for noise, scale in ((0, 100), (1, 1)):
        for i, (key, column) in enumerate(COLUMNS.items()):
            ratio = relative_errors(column, noise, i, 1000)["both"]
            samples[noise, key] = scale * table1.averages(column, ratio, lengths[noise])
            other = relative_errors(column, noise, 10 + i, 200)["both"]
            tables[noise, key] = (scale * table1.averages(column, other, [lengths[noise][2]])[0]).round(4)
    for made in (0, 1):
        best = [
            sum(table1.log_likelihood(samples[noise, key], tables[made, key]) for key in COLUMNS).max(axis=0)
            for noise in (0, 1)
        ]
        right = best[made] > best[1 - made]
        assert right.mean() > 0.9
