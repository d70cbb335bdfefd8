"""Missed epochs and partly missing rows: estimates, covariances, innovations and likelihood against the oracles.

Random models (correlated and uncorrelated noises, dense H, more measurements than states) and random gaps.
"""

from dataclasses import replace

import numpy as np
import pytest
from conftest import AXIS, dense_model
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import error_covariances, gaussian_conditioning, gaussian_log_density, matrices, textbook_kalman
from oracles import textbook_steps as textbook
from test_properties import FILTERS, SOLVED, assert_same, condition, models, seeds

import mpt_helpers as mpt
from mpt_helpers import metrics
from mpt_helpers._engine.shared import steps_without_gaps

EPS = np.finfo(float).eps
# How likely an epoch is missed, and a measurement of the others.
GAPS = st.sampled_from([(0.0, 0.0), (0.3, 0.0), (0.0, 0.3), (0.2, 0.2), (1.0, 0.0)])
both_filters = pytest.mark.parametrize("make", FILTERS)
few = settings(max_examples=5)  # of what `test_paths` looks at too, under more conditions


def with_gaps(model, seed, gaps, N=15, tracks=4):
    """Measurements of tracks that each miss some of their own; the last track ends early."""
    rng = np.random.default_rng(seed)
    z = mpt.simulate(model, N, rng, tracks)[1]
    epoch, row = gaps
    z[np.broadcast_to(rng.random((N, 1, tracks)) < epoch, z.shape) | (rng.random(z.shape) < row)] = np.nan
    if any(gaps):
        z[N // 2 :, :, -1] = np.nan
    return z


@st.composite
def cases(draw):
    """A model and measurements of four tracks with gaps of their own."""
    model = draw(models(most=5))
    if draw(st.booleans(), "uncorrelated"):
        model = replace(model, R=np.diag(np.diag(model.R)))
    return model, with_gaps(model, draw(seeds), draw(GAPS, "gaps"))


def each_track(z):
    return np.moveaxis(z, 2, 0)


def columns(tracks):
    """Results of tracks, one after the other, as columns."""
    return np.stack(tracks, axis=-1)


@both_filters
@few
@given(cases())
def test_filter_and_covariances_are_the_textbooks(make, case):
    """Of many tracks, and of each track alone."""
    model, z = case
    x, P = map(columns, zip(*(textbook_kalman(*matrices(model), track) for track in each_track(z)), strict=True))
    each, rounding = make(model), condition(model)
    assert_same(each.filter(z), x, rounding)
    assert_same(each.covariances(z), P, rounding)
    for i, track in enumerate(each_track(z)[:2]):
        assert_same(each.filter(track), x[..., i], rounding)
        assert_same(each.covariances(track), P[..., i], rounding)


@both_filters
@pytest.mark.parametrize(("seed", "n", "m"), [(0, 3, 2), (1, 2, 4), (2, 1, 3)])
def test_partly_missing_rows_are_conditioned_on_what_is_there(make, seed, n, m):
    model = dense_model(seed, n, m)
    z = with_gaps(model, seed, (0.2, 0.3), N=8)
    for i, track in enumerate(each_track(z)):
        x, P = gaussian_conditioning(*matrices(model), track)
        unseen = textbook_kalman(*matrices(model), np.full_like(track, np.nan))[1]
        variance = np.diagonal(P, axis1=1, axis2=2)
        sigma = np.sqrt(variance)
        # The oracle subtracts what the measurements tell from the covariance without any, and loses the digits by which
        # that is larger than the result; each number is the sum of some hundred products.
        allowed = 100 * EPS * (np.diagonal(unseen, axis1=1, axis2=2) / variance).max()
        assert (np.abs(make(model).filter(z)[..., i] - x) / sigma).max() < allowed
        assert (np.abs(make(model).covariances(z)[..., i] - P) / sigma[:, None] / sigma[..., None]).max() < allowed


@given(cases())
def test_innovations_nis_and_likelihood_are_the_textbooks(case):
    model, z = case
    kf = mpt.KalmanFilter(model)
    new, nis, likelihood = metrics.innovations(kf, z), metrics.nis(kf, z), metrics.log_likelihood(kf, z)
    assert new.values.shape == z.shape
    assert new.S.shape == (len(z), model.m, model.m, z.shape[2])
    assert likelihood.shape == z.shape[2:]
    np.testing.assert_array_equal(np.isnan(new.values), np.isnan(z))
    allowed, largest = EPS * condition(model), max(1.0, np.nanmax(np.abs(z), initial=0.0))
    for i, track in enumerate(each_track(z)):
        total = 0.0
        for k, (_, _, innovation, S) in enumerate(textbook(*matrices(model), track)):
            seen = ~np.isnan(track[k])
            assert np.abs(new.values[k, seen, i] - innovation).max(initial=0.0) <= allowed * largest
            assert np.abs(new.S[k][np.ix_(seen, seen)][..., i] - S).max(initial=0.0) <= allowed * np.abs(new.S).max()
            square = innovation @ np.linalg.solve(S, innovation)
            total -= 0.5 * (square + np.linalg.slogdet(2 * np.pi * S)[1])
            if seen.any():
                np.testing.assert_allclose(nis[k, i], square, rtol=1e-7, atol=1e-7)
            else:
                assert np.isnan(nis[k, i])
        np.testing.assert_allclose(likelihood[i], total, rtol=1e-7, atol=1e-7)


@both_filters
@pytest.mark.parametrize(("seed", "gaps"), [(0, (0.0, 0.0)), (1, (0.3, 0.3)), (2, (0.3, 0.3))])
def test_the_likelihood_is_the_joint_density_of_what_was_measured(make, seed, gaps):
    model = dense_model(seed)
    z = with_gaps(model, seed, gaps, N=8)
    together = metrics.log_likelihood(make(model), z)
    for i, track in enumerate(each_track(z)):
        alone = metrics.log_likelihood(make(model), track)
        assert np.ndim(alone) == 0
        np.testing.assert_allclose([alone, together[i]], gaussian_log_density(*matrices(model), track), rtol=1e-8)


def made(model):
    """Filters with a `step`, and whether they take rows that are partly missing."""
    kf, lf, steady = mpt.KalmanFilter(model), mpt.LainiotisFilter(model), mpt.SteadyStateFilter.from_kalman(model)
    return {
        "KF": (kf, True),
        "LF": (lf, True),
        "SSKF": (steady, False),
        "join": (mpt.JoinFilter(kf, lf), True),
        "separate": (mpt.Separate(lf, mpt.JoinFilter(kf, lf)), True),
    }


@pytest.mark.parametrize("name", ["KF", "LF", "SSKF", "join", "separate"])
@settings(max_examples=3)
@given(models(most=4), seeds, GAPS)
def test_one_step_after_the_other_is_the_filter(name, model, seed, gaps):
    """From `model.x0` and P0; one track, and among many: `filter`, `covariances` and `innovations` tell the same."""
    each, partly = made(model)[name]
    z = with_gaps(each.model, seed, gaps if partly else (gaps[0], 0.0))
    x, P, new = each.filter(z), each.covariances(z), metrics.innovations(each, z)
    F, H, Q, R = each.model.F, each.model.H, each.model.Q, each.model.R
    rounding = condition(model)

    def near(ours, theirs, largest):
        return np.abs(ours - theirs).max() <= EPS * rounding * max(np.abs(largest).max(), EPS)

    for i, track in enumerate(each_track(z)[1:3]):
        state, covariance, seen = each.model.x0, each.P0, ~np.isnan(track)
        alone = metrics.innovations(each, track)
        assert_same(each.filter(track), x[..., i + 1], rounding)
        assert_same(each.covariances(track), P[..., i + 1], rounding)
        for k, z_k in enumerate(track):
            S = H @ (F @ covariance @ F.T + Q) @ H.T + R
            expected = (z_k - H @ F @ state)[seen[k]]
            if seen[k].any():
                assert near(new.values[k, seen[k], i + 1], expected, x)
                assert near(alone.values[k, seen[k]], expected, x)
            assert near(new.S[k, ..., i + 1], S, S)
            assert near(alone.S[k], S, S)
            state, covariance = each.step(state, covariance, z_k)
            assert near(state, x[k, :, i + 1], x)
            assert near(covariance, P[k, ..., i + 1], P)


@pytest.mark.parametrize("name", ["KF", "LF", "SSKF", "SSLF"])
@few
@given(models(most=3), seeds, GAPS, st.integers(0, 3))
def test_covariances_are_those_of_the_error_that_is_made(name, model, seed, gaps, steps):
    """Of any linear filter, by tracks of one unit noise each; a filter with a constant gain takes whole rows only."""
    each = mpt.six_filters(model)[name]
    constant = name.startswith("SS")
    z = with_gaps(model, seed, (gaps[0], 0.0) if constant else gaps, N=10)
    model, rounding = replace(model, P0=each.P0), 10 * condition(model)
    for i in (0, 3):
        exact = error_covariances(*matrices(model), np.isnan(z[..., i]), each.filter)
        assert_same(each.covariances(z[..., i]), exact, rounding)
        assert_same(each.covariances(z)[..., i], exact, rounding)
    if constant:
        ahead = mpt.SteadyStatePredictor(each, steps)
        exact = error_covariances(*matrices(model), np.isnan(z[..., 0]), ahead.filter, steps)
        rounding *= max(1.0, np.linalg.norm(np.linalg.matrix_power(model.F, steps), 2) ** 2)
        assert_same(ahead.covariances(z[..., 0]), exact, rounding)
        assert_same(ahead.covariances(z)[..., 0], exact, rounding)


@pytest.mark.parametrize("make", SOLVED)
def test_the_stated_covariance_of_a_steady_state_grows_in_a_gap_and_returns(make):
    steady, z = make(AXIS), np.zeros((100, 1))
    z[20:25] = np.nan
    P = steady.covariances(z)
    np.testing.assert_allclose(P[:20], [steady.P] * 20, rtol=1e-12)
    np.testing.assert_allclose(P[22], AXIS.F @ P[21] @ AXIS.F.T + AXIS.Q, rtol=1e-12)
    assert (np.diff(P[19:25, 0, 0]) > 0).all()
    np.testing.assert_allclose(P[-1], steady.P, rtol=1e-12)


@both_filters
@few
@given(models(most=3), models(most=3), seeds, GAPS)
def test_filters_side_by_side_each_see_their_own_rows(make, first, second, seed, gaps):
    both, separate = mpt.stack(first, second), mpt.Separate(make(first), make(second))
    z = with_gaps(both, seed, gaps)
    assert_same(separate.filter(z), make(both).filter(z), condition(both))
    assert_same(separate.covariances(z), make(both).covariances(z), condition(both))
    np.testing.assert_allclose(metrics.log_likelihood(separate, z), metrics.log_likelihood(make(both), z), rtol=1e-7)


@pytest.mark.parametrize("make", SOLVED)
def test_steady_filters_side_by_side_lose_one_axis_at_a_time(make):
    one, both = make(AXIS), mpt.Separate(make(AXIS), make(AXIS))
    z = with_gaps(both.model, 1, (0.1, 0.3), N=40, tracks=3)
    x, P = both.filter(z), both.covariances(z)
    for axis in range(2):
        states, rows = slice(2 * axis, 2 * axis + 2), slice(axis, axis + 1)
        np.testing.assert_allclose(x[:, states], one.filter(z[:, rows]), rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(P[:, states, states], one.covariances(z[:, rows]), rtol=1e-12)


@few
@given(cases())
def test_the_joint_filter_is_the_mean_of_both(case):
    model, z = case
    kf, lf = mpt.KalmanFilter(model), mpt.LainiotisFilter(model)
    join = mpt.JoinFilter(kf, lf)
    np.testing.assert_array_equal(join.filter(z), (kf.filter(z) + lf.filter(z)) / 2)
    np.testing.assert_array_equal(join.covariances(z), (kf.covariances(z) + lf.covariances(z)) / 2)


def test_the_joint_filter_starts_from_the_mean_of_both_starts():
    """One filter knows its start, the other one begins settled; in either order."""
    kf, steady = mpt.KalmanFilter(AXIS), mpt.SteadyStateFilter.from_kalman(AXIS)
    for join in (mpt.JoinFilter(kf, steady), mpt.JoinFilter(steady, kf)):
        np.testing.assert_array_equal(join.P0, steady.P / 2)
        P_p = AXIS.F @ join.P0 @ AXIS.F.T + AXIS.Q
        S = metrics.innovations(join, np.ones((1, 1))).S[0]
        np.testing.assert_allclose(S, AXIS.H @ P_p @ AXIS.H.T + AXIS.R, rtol=1e-14)  # some ten products


def test_a_track_without_any_measurement_has_no_nis_and_likelihood_one():
    z = np.full((4, 1), np.nan)
    assert np.isnan(metrics.nis(mpt.KalmanFilter(AXIS), z)).all()
    assert metrics.log_likelihood(mpt.KalmanFilter(AXIS), z) == 0


def test_the_makers_take_a_start():
    for make, n in ((mpt.gsm_axis, 2), (mpt.constant_velocity, 2), (mpt.constant_acceleration, 3)):
        model = make(1.0, 0.01, 0.1, x0=np.ones(n), P0=2 * np.eye(n))
        assert model == replace(make(1.0, 0.01, 0.1), x0=np.ones(n), P0=2 * np.eye(n))


def test_correlated_noises_with_partly_missing_rows_take_one_pass_for_all_tracks(monkeypatch):
    """Not one filterpy object for each track and epoch."""
    model = mpt.LinearModel(F=np.eye(2), H=np.eye(2), Q=np.eye(2), R=[[1, 0.5], [0.5, 1]])
    z = mpt.simulate(model, 30, np.random.default_rng(0), tracks=40)[1]
    z[np.random.default_rng(1).random(z.shape) < 0.2] = np.nan
    made, next_step = [], mpt.KalmanFilter.next_step
    monkeypatch.setattr(mpt.KalmanFilter, "next_step", lambda *all: made.append(all) or next_step(*all))
    x = mpt.KalmanFilter(model).filter(z)
    assert len(made) <= len(z)  # those of the first pass, as if nothing were missing
    for i in range(0, 40, 13):
        np.testing.assert_allclose(x[..., i], textbook_kalman(*matrices(model), z[..., i])[0], rtol=1e-9, atol=1e-12)


def test_filters_of_many_states_converge():
    """Twelve states flicker by more than the rounding of one number."""
    rng = np.random.default_rng(4)
    F, G, H = rng.standard_normal((12, 12)), rng.standard_normal((12, 12)), rng.standard_normal((6, 12))
    F /= np.abs(np.linalg.eigvals(F)).max()
    kf = mpt.KalmanFilter(mpt.LinearModel(F=F, H=H, Q=G @ G.T, R=np.eye(6)))
    taken = list(steps_without_gaps(kf.next_step, kf.P0, 6, 500))
    assert len({id(step) for step in taken}) < 100


@pytest.mark.parametrize("value", [np.inf, -np.inf])
def test_a_step_refuses_an_infinite_measurement(value):
    with pytest.raises(ValueError, match=r"z_k: needs .* of numbers, got infinity"):
        mpt.KalmanFilter(AXIS).step(AXIS.x0, AXIS.P0, [value])


def test_a_row_of_zeros_in_H_tells_nothing_to_tracks_with_gaps_of_their_own():
    model = mpt.constant_velocity(1.0, 0.05, 0.5, P0=np.eye(2))
    blind = replace(model, H=[[1, 0], [0, 0]], R=np.eye(2) / 2)
    z = with_gaps(model, 5, (0.3, 0.0))
    kf = mpt.KalmanFilter(blind)
    both = np.concatenate([z, np.where(np.isnan(z), np.nan, 7.0)], axis=1)
    np.testing.assert_allclose(kf.filter(both), mpt.KalmanFilter(model).filter(z), rtol=1e-12)


def test_a_constant_gain_refuses_partly_missing_rows_of_tracks_with_gaps_of_their_own():
    steady = mpt.SteadyStateFilter.from_kalman(mpt.stack(AXIS, AXIS))
    z = with_gaps(steady.model, 5, (0.0, 0.3))
    for function in (steady.filter, steady.covariances):
        with pytest.raises(ValueError, match="z: needs rows all of numbers or all of NaN"):
            function(z)


def test_separate_filters_of_which_one_has_gaps_of_each_tracks_own():
    """In either order: one of them yields a covariance for all tracks, the other one for each."""
    kf = mpt.KalmanFilter(AXIS)
    whole, gappy = mpt.simulate(AXIS, 15, np.random.default_rng(1), 4)[1], with_gaps(AXIS, 5, (0.3, 0.0))
    for order in ([whole, gappy], [gappy, whole]):
        P = mpt.Separate(kf, kf).covariances(np.concatenate(order, axis=1))
        for i, z in enumerate(order):
            axis = slice(2 * i, 2 * i + 2)
            np.testing.assert_array_equal(P[:, axis, axis], kf.covariances(z))
