"""Bands that follow their own errors: what they rest on, what they guarantee, that they know nothing of the future."""

from dataclasses import replace
from datetime import datetime
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import plain_band
from scipy.linalg import block_diag

import mpt_helpers as mpt
from mpt_helpers.bands import ForecastErrors, LiveBand, ahead, coverage, following, interval_score

AXIS = mpt.constant_velocity(dt=1.0, q=0.05, r=0.5, P0=np.diag([100.0, 100.0]))
PLANE = mpt.stack(AXIS, AXIS)


def recorded(N=400, seed=0, model=PLANE):
    """A track with steps of any length, a pause, lost fixes, fixes with one number, and two fixes at one time."""
    rng = np.random.default_rng(seed)
    steps = rng.choice([0.5, 1.0, 2.0], N)
    steps[[0, N // 2, N // 3]] = 1.0, 300.0, 0.0
    t = np.cumsum(steps)
    z = np.cumsum(np.cumsum(rng.standard_t(3, (N, model.m)), axis=0), axis=0) * 0.3
    z[rng.random(N) < 0.1] = np.nan
    z[rng.random(N) < 0.05, 0] = np.nan
    return t, z


def an_ahead(errors, sigma=1.0, lag=1, seconds=None):
    """Forecast errors on a grid of one second, from errors (K, m), where every prediction waits for `lag` fixes."""
    errors = np.asarray(errors, float)
    row = np.arange(len(errors))
    ones = np.ones(len(errors))
    sigma = np.broadcast_to(sigma, errors.shape).copy()
    return ForecastErrors(
        row * 1.0,
        row * 1.0 + lag,
        errors,
        sigma,
        ones,
        row,
        row + lag,
        0 * row + lag,
        0 * row,
        row < 0,
        lag,
        seconds or float(lag),
    )


@pytest.mark.parametrize("seconds", [1.0, 4.0, 20.0])
def test_a_prediction_is_what_the_filter_states_of_a_later_row_without_the_fixes_between(seconds):
    t, z = recorded(120)
    kf = mpt.KalmanFilter(PLANE, t=t)
    a = ahead(kf, z, seconds)
    assert len(a.made) > 50
    for k in range(0, len(a.made), 7):
        blind = z.copy()
        blind[a.row[k] + 1 :] = np.nan
        e = kf.estimates(blind)
        at = a.due_row[k]
        np.testing.assert_allclose(a.errors[k], z[at] - PLANE.H @ e.x[at], atol=1e-9)
        np.testing.assert_allclose(a.sigma[k] ** 2, np.diag(PLANE.H @ e.P[at] @ PLANE.H.T + PLANE.R), rtol=1e-9)


def test_the_later_fix_is_the_first_one_after_the_horizon_and_at_most_half_a_horizon_later():
    t = np.array([0.0, 1.0, 2.0, 3.5, 5.1, 100.0, 101.5])
    a = ahead(mpt.KalmanFilter(AXIS, t=t), np.zeros((7, 1)), 2.0)
    assert [*zip(a.made.tolist(), a.due.tolist(), strict=True)] == [(0.0, 2.0), (1.0, 3.5)]
    assert a.row.tolist() == [0, 1]
    assert a.due_row.tolist() == [2, 3]
    assert a.left_out == 5


@pytest.mark.parametrize(
    "same",
    [
        mpt.LainiotisFilter(PLANE),
        mpt.JoinFilter(mpt.KalmanFilter(PLANE), mpt.LainiotisFilter(PLANE)),
        mpt.Separate(mpt.KalmanFilter(AXIS), mpt.LainiotisFilter(AXIS)),
    ],
    ids=lambda each: type(each).__name__,
)
def test_filters_that_agree_have_the_same_bands(same):
    _, z = recorded()
    whole = np.where(np.isnan(z).any(axis=1, keepdims=True), np.nan, z)
    expected = following(ahead(mpt.KalmanFilter(PLANE), whole, 4.0))
    np.testing.assert_allclose(following(ahead(same, whole, 4.0)), expected, rtol=1e-6)


def with_a_start_of_its_own(rng, model):
    """A filter of constant gain whose P(0/0) is not the model's."""
    B, root = rng.uniform(0.1, 0.5, (model.n, model.m)) * (model.H.T != 0), rng.standard_normal((model.n, model.n))
    A = (np.eye(model.n) - B @ model.H) @ model.F
    return mpt.SteadyStateFilter(model, A=A, B=B, P=root @ root.T + 0.1 * np.eye(model.n))


@pytest.mark.parametrize("kind", ["constant gain", "joint", "joint with a Kalman filter", "separate"])
@settings(max_examples=2)
@given(seed=st.integers(0, 2**32 - 1), seconds=st.sampled_from([1.0, 2.5, 4.0]), level=st.sampled_from([0.95, 0.7]))
def test_bands_of_other_filters_start_from_the_P0_of_the_filter(kind, seed, seconds, level):
    """`ahead`, `following` and the live band against the plain loop: the first innovation is judged by that P0."""
    rng = np.random.default_rng(seed)
    axis = mpt.constant_velocity(0.5, 0.3, 1.0, x0=rng.standard_normal(2), P0=9 * np.eye(2))
    other = replace(axis.with_noise_times(2.0), R=[[2.0]])
    plane = mpt.stack(axis, other)
    one, two = with_a_start_of_its_own(rng, plane), with_a_start_of_its_own(rng, plane)
    halves = [with_a_start_of_its_own(rng, each) for each in (axis, other)]
    estimator, P0 = {
        "constant gain": (one, one.P),
        "joint": (mpt.JoinFilter(one, two), (one.P + two.P) / 2),
        "joint with a Kalman filter": (mpt.JoinFilter(mpt.KalmanFilter(plane), two), (plane.P0 + two.P) / 2),
        "separate": (mpt.Separate(*halves), block_diag(*(each.P for each in halves))),
    }[kind]
    N, M = 30, 2
    z = 3 * rng.standard_normal((N, 2, M))
    z[np.repeat(rng.random((N, 1, M)) < 0.15, 2, axis=1)] = np.nan
    t, (x, P) = 0.5 * np.arange(N), estimator.estimates(z)
    a = ahead(estimator, z, seconds)
    band = following(a, level=level)
    normal = np.log([{0.95: 1.959963984540054, 0.7: 1.0364333894937898}[level]] * 2)
    for i in range(M):
        checked, at_rows, log_f = plain_band(
            plane.over,
            *(plane.H, plane.R, [plane.R] * N, (-0.5, plane.x0, P0), t),
            *(z[..., i], x[..., i], P[..., i], seconds, level, normal),
        )
        of_it = a.track == i
        np.testing.assert_allclose(a.errors[of_it], [each.errors for each in checked], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(a.sigma[of_it], [each.sigma for each in checked], rtol=1e-9)
        np.testing.assert_allclose(a.recent[of_it], [each.c for each in checked], rtol=1e-9)
        np.testing.assert_allclose(band[of_it], [each.half_width for each in checked], rtol=1e-9)
        live = LiveBand(estimator, seconds, level=level)
        for k, at_row in enumerate(at_rows):
            expected = live.step(t[k], z[k, :, i], x[k, :, i], P[k, :, :, i])
            np.testing.assert_allclose(expected.position, at_row.position, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(expected.half_width, at_row.half_width, rtol=1e-9)
        np.testing.assert_allclose(live.factor, np.exp(log_f), rtol=1e-9)


def test_times_that_are_a_horizon_apart_but_for_their_rounding_belong_together():
    t = np.arange(300) * 0.1  # 0.3 - 0.1 < 0.2
    a = ahead(mpt.KalmanFilter(AXIS, t=t), np.zeros((300, 1)), 0.2)
    np.testing.assert_array_equal(a.due_row - a.row, 2)


def test_a_grid_gives_what_its_times_give():
    _, z = recorded()
    grid, times = (ahead(kf, z, 5.0) for kf in (mpt.KalmanFilter(PLANE), mpt.KalmanFilter(PLANE, t=np.arange(len(z)))))
    for name in ForecastErrors._fields:
        np.testing.assert_allclose(getattr(grid, name), getattr(times, name), rtol=1e-9, atol=1e-9, err_msg=name)


def test_a_fix_of_a_stated_accuracy_is_expected_with_it():
    t, z = recorded()
    r = np.random.default_rng(1).uniform(0.1, 9.0, z.shape)
    kf = mpt.KalmanFilter(PLANE, t=t, r=r)
    a = ahead(kf, z, 4.0)
    other = r.copy()
    k = len(a.row) // 3
    other[a.due_row[k]] += 100.0
    b = ahead(mpt.KalmanFilter(PLANE, t=t, r=other), z, 4.0)
    np.testing.assert_allclose(b.sigma[k] ** 2 - a.sigma[k] ** 2, 100.0, rtol=1e-9)
    np.testing.assert_array_equal(b.sigma[:k][a.due_row[:k] < a.due_row[k]], a.sigma[:k][a.due_row[:k] < a.due_row[k]])


def test_many_tracks_have_the_bands_that_each_has_alone():
    tracks = [recorded(seed=seed) for seed in range(3)]
    t, z = np.stack([t for t, _ in tracks], axis=-1), np.stack([z for _, z in tracks], axis=-1)
    a = ahead(mpt.KalmanFilter(PLANE, t=t), z, 4.0)
    band = following(a)
    for c, (t_c, z_c) in enumerate(tracks):
        alone = ahead(mpt.KalmanFilter(PLANE, t=t_c), z_c, 4.0)
        of_it = a.track == c
        np.testing.assert_array_equal(a.due_row[of_it], alone.due_row)
        np.testing.assert_allclose(a.errors[of_it], alone.errors, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(band[of_it], following(alone), rtol=1e-9)
    assert a.left_out == sum(ahead(mpt.KalmanFilter(PLANE, t=t), z, 4.0).left_out for t, z in tracks)


def test_the_live_band_is_that_of_the_whole_track():
    seconds, level = 4.0, 0.8
    t, z = recorded()
    kf = mpt.KalmanFilter(PLANE, t=t)
    earlier = ahead(kf, z + 5.0, seconds)
    e, a = kf.estimates(z), ahead(kf, z, seconds)
    band = following(a, before=earlier, level=level)
    live = LiveBand(kf, seconds, before=earlier, level=level)
    stepped = [live.step(*fix) for fix in zip(t, z, e.x, e.P, strict=True)]
    exact = np.abs(a.due - a.made - seconds) < 1e-9
    assert exact.sum() > 100
    for k in np.flatnonzero(exact):
        now = stepped[a.row[k]]
        there = np.isfinite(a.errors[k])
        np.testing.assert_allclose(now.half_width, band[k], rtol=1e-9)
        np.testing.assert_allclose((z[a.due_row[k]] - now.position)[there], a.errors[k][there], atol=1e-9)
    # The other predictions are checked later than the live band looks: by the sigma of that time their bands agree too.
    assert (~exact).sum() > 10
    for k in np.flatnonzero(~exact):
        row = a.row[k]
        axis = mpt.constant_velocity(dt=seconds, q=0.05, r=0.5)
        plane = mpt.stack(axis, axis)
        sigma = np.sqrt(np.diag(plane.H @ (plane.F @ e.P[row] @ plane.F.T + plane.Q) @ plane.H.T + plane.R))
        np.testing.assert_allclose(stepped[row].half_width, band[k] * sigma / a.sigma[k], rtol=1e-9)
        assert (stepped[row].half_width < band[k]).all()


def test_the_live_band_refuses_steps_that_are_longer_than_its_horizon():
    kf = mpt.KalmanFilter(AXIS)

    def steps(times, before=None):
        live = LiveBand(kf, 10.0, before=before)
        return [live.step(t, [0.0], AXIS.x0, AXIS.P0) for t in times]

    with pytest.raises(
        ValueError, match=r"seconds: needs a horizon after which there are fixes, .* got 10, and none of 30 fixes"
    ):
        steps(98.0 * np.arange(31))
    assert len(steps(98.0 * np.arange(30))) == 30
    late = 98.0 * np.arange(1, 40)
    assert len(steps([0.0, 12.0, *late])) == 41  # one could be checked: what follows are gaps
    assert len(steps(late, before=ahead(kf, np.zeros((30, 1)), 10.0))) == 39


def test_the_live_band_takes_the_accuracy_of_each_fix():
    t, z = recorded()
    z = np.where(np.isnan(z).any(axis=1, keepdims=True), np.nan, z)
    r = np.full(z.shape, 2.0)
    kf = mpt.KalmanFilter(PLANE, t=t, r=r)
    e, a = kf.estimates(z), ahead(kf, z, 4.0)
    live = LiveBand(kf, 4.0)
    stepped = [live.step(*fix) for fix in zip(t, z, e.x, e.P, r, strict=True)]
    exact = np.flatnonzero(np.abs(a.due - a.made - 4.0) < 1e-9)
    np.testing.assert_allclose([stepped[a.row[k]].half_width for k in exact], following(a)[exact], rtol=1e-9)


@pytest.mark.parametrize("k", [50, 200, 333])
def test_a_band_knows_nothing_of_what_comes_later(k):
    t, z = recorded()
    kf = mpt.KalmanFilter(PLANE, t=t)
    other = z.copy()
    other[k + 1 :] *= -7.0
    bands = [following(ahead(kf, measured, 4.0)) for measured in (z, other)]
    made_by_then = ahead(kf, z, 4.0).row <= k
    np.testing.assert_array_equal(*(band[made_by_then] for band in bands))
    assert (bands[0][~made_by_then] != bands[1][~made_by_then]).any()


def test_whatever_the_errors_are_the_share_of_misses_is_what_the_factor_moved_by():
    """Each prediction that comes due moves log f by gamma (missed - 0.05): the sum is the guarantee."""
    rng = np.random.default_rng(0)
    errors = np.exp(rng.standard_normal((5000, 1)) * np.linspace(0, 3, 5000)[:, None])  # wilder and wilder
    a = an_ahead(errors, seconds=1.0)
    band = following(a)
    missed = (np.abs(a.errors) > band)[:-1].sum()
    assert np.log(band[-1] / band[0]).item() == pytest.approx(0.1 * (missed - 0.05 * 4999), rel=1e-9)
    gain, factors = 0.1, np.log(band)
    share = (np.abs(a.errors) > band).mean()
    assert abs(share - 0.05) <= np.ptp(factors) / (gain * 5000) + 1 / 5000


@pytest.mark.parametrize(("lag", "gain"), [(1, 0.1), (5, 0.1), (10, 0.05), (100, 0.005)])
def test_the_factor_moves_by_half_over_the_fixes_that_a_prediction_waits_for(lag, gain):
    errors = np.zeros((lag + 2, 1))
    errors[0] = 1e9  # the first prediction is missed, and known to be when the one `lag` later is made
    band = following(an_ahead(errors, lag=lag))
    np.testing.assert_allclose(np.log(band[lag] / band[lag - 1]), gain * 0.95)
    np.testing.assert_allclose(np.log(band[lag + 1] / band[lag]), -gain * 0.05)


def test_a_parked_mobile_moves_off_within_its_band():
    """The receiver repeats its position: half an hour of such hits must not make the band vanish."""
    rng, rest = np.random.default_rng(1), 1800

    def drive():
        heading = np.cumsum(0.05 * rng.standard_normal(1200))
        speed = np.minimum(np.arange(1200.0), 10) + np.sin(np.arange(1200) / 17)
        return np.cumsum(speed[:, None] * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)

    there = drive() + 0.5 * rng.standard_normal((1200, 2))
    on = there[-1] + drive() + 0.5 * rng.standard_normal((1200, 2))
    z = np.vstack([there, np.repeat(there[-1:], rest, axis=0), on])
    axis = mpt.constant_velocity(dt=1.0, q=0.5, r=0.25, P0=np.diag([100.0, 900.0]))
    kf = mpt.KalmanFilter(mpt.stack(axis, axis))
    a = ahead(kf, z, 10.0)
    band, off = following(a), 1200 + rest
    for seconds, share in ((60, 0.75), (300, 0.9)):  # both were 0.0 while the rest counted
        since = (a.row >= off) & (a.row < off + seconds)
        assert (np.abs(a.errors) <= band)[since].mean() > share


def test_one_early_pause_does_not_stop_the_live_band():
    kf = mpt.KalmanFilter(AXIS)
    live, x, P, last = LiveBand(kf, 60.0), AXIS.x0, kf.P0, -1.0
    for t in np.concatenate([np.arange(40.0), 140 + np.arange(200.0)]):
        x, P = kf.step(x, P, [0.0], dt=t - last)
        live.step(t, [0.0], x, P)
        last = t
    assert live.unchecked < 0  # it has learnt since


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"z": [np.inf]}, "z: needs .* of numbers, got infinity"),
        ({"z": [1.0], "r": [np.nan]}, "r: needs a positive variance of every measurement that is there, got nan"),
        ({"z": [1.0], "r": [-1.0]}, "r: needs a positive variance of every measurement that is there, got -1"),
        ({"z": [1.0], "r": [1.0, 1.0]}, "r: needs a vector of 1 positive variances, got"),
    ],
)
def test_the_live_band_refuses_what_would_spoil_it(given, said):
    kf = mpt.KalmanFilter(AXIS)
    live = LiveBand(kf, 1.0)
    with pytest.raises(ValueError, match=said):
        live.step(0.0, x=AXIS.x0, P=kf.P0, **given)
    assert np.isfinite(live.step(0.0, [np.nan], AXIS.x0, kf.P0, r=[np.nan]).half_width)  # of what is missing


def test_a_caller_may_fill_one_array_with_every_measurement():
    kf, z = mpt.KalmanFilter(AXIS), np.random.default_rng(1).normal(scale=9, size=(60, 1))
    ends = []
    for buffer in (np.empty(1), None):
        live, x, P = LiveBand(kf, 3.0), AXIS.x0, kf.P0
        for k, z_k in enumerate(z):
            given = z_k if buffer is None else buffer
            given[:] = z_k
            x, P = kf.step(x, P, given)
            live.step(float(k), given, x, P)
        ends.append(live.factor)
    assert ends[0] == ends[1] != LiveBand(kf, 3.0).factor


def test_each_axis_is_covered_by_its_own_predictions():
    """Heights are known once in thirty seconds: ten predictions of them are too few, and the error is theirs."""
    _, z = mpt.simulate(PLANE, 300, np.random.default_rng(2))
    z[np.arange(300) % 30 != 5, 1] = np.nan
    a = ahead(mpt.KalmanFilter(PLANE), z, 1.0)
    with pytest.warns(UserWarning, match="coverage: 10 independent predictions"):
        found = coverage(a, following(a))
    assert found.independent == 10
    assert found.error[1] > 4 * found.error[0]
    with pytest.raises(ValueError, match="band, where: needs a half-width of at least one checked prediction"):
        coverage(a, following(a), where=a.row < 3)


def test_of_a_model_that_is_right_the_band_is_the_filters_own():
    """The factor stays near 1.96. Following costs some 5 % of the score of the true quantiles, the best there is."""
    _, z = mpt.simulate(PLANE, 20_000, np.random.default_rng(0))
    kf = mpt.KalmanFilter(PLANE)
    for seconds in (1.0, 10.0):
        a = ahead(kf, z, seconds)
        band, true = following(a), 1.96 * a.sigma
        np.testing.assert_allclose(coverage(a, band).share, 0.95, atol=0.005)
        assert (interval_score(a, band) / interval_score(a, true)).max() < 1.08
        assert 0.9 < np.median(band / true) < 1.1


def test_the_recent_size_is_the_average_of_the_innovations_over_the_fixes_of_a_horizon():
    t, z = recorded()
    kf = mpt.KalmanFilter(PLANE, t=t)
    a = ahead(kf, z, 20.0)
    nis, numbers = mpt.metrics.nis(kf, z), np.isfinite(z).sum(axis=1)
    fixes, average, expected = np.flatnonzero(numbers), 1.0, {}
    for row in fixes:
        memory = max(5, ((t[fixes] >= t[row] - 20.0) & (fixes < row)).sum())
        average += (min(nis[row] / numbers[row], 50) - average) / memory
        expected[row] = np.sqrt(0.2 + 0.8 * average)
    np.testing.assert_allclose(a.recent, [expected[row] for row in a.row], rtol=1e-9)


def test_the_recent_size_pays_where_the_mobile_is_calm_and_wild_by_turns():
    calm, rng, wild = mpt.constant_velocity(dt=1.0, q=0.01, r=0.1), np.random.default_rng(0), np.arange(4000) // 200 % 2
    velocity = np.cumsum(np.where(wild, np.sqrt(10.0), np.sqrt(0.01)) * rng.standard_normal(4000))
    z = (np.cumsum(velocity) + np.sqrt(0.1) * rng.standard_normal(4000))[:, None]
    a = ahead(mpt.KalmanFilter(calm), z, 5.0)
    settled = a.row % 200 > 50
    of_wild = wild[a.row] == 1
    assert np.median(a.recent[settled & ~of_wild]) == pytest.approx(1, abs=0.1)
    assert np.median(a.recent[settled & of_wild]) > 3
    plain = a._replace(recent=np.ones(len(a.recent)))
    assert (interval_score(a, following(a)) < 0.9 * interval_score(plain, following(plain))).all()


def test_random_numbers_for_sigma_hold_the_share_too_and_score_and_states_tell_them_apart():
    rng = np.random.default_rng(0)
    loud = np.repeat(rng.random(400) < 0.5, 20)  # a state that is known
    sigma = np.where(loud, 5.0, 1.0)[:, None]
    a = an_ahead(sigma * rng.standard_normal((8000, 1)), sigma)
    band, blind = following(a), following(a._replace(sigma=np.exp(rng.standard_normal(sigma.shape))))
    for each in (band, blind):
        assert coverage(a, each).share == pytest.approx(0.95, abs=0.01)
    assert interval_score(a, band) < 0.6 * interval_score(a, blind)
    assert min(coverage(a, band, where=where).share for where in (loud, ~loud)) > 0.93
    assert min(coverage(a, blind, where=where).share for where in (loud, ~loud)) < 0.93


def test_the_mean_nis_is_blind_to_a_jump_that_ruins_the_filter():
    """With a jump in the track a q can be found whose mean NIS is right; the median and the band know better."""
    _, z = mpt.simulate(PLANE, 2000, np.random.default_rng(0))
    z[1000:1020] = z[1000]
    z[1020:] += 300.0

    def filter_with(q):
        axis = mpt.constant_velocity(dt=1.0, q=q, r=0.5, P0=AXIS.P0)
        return mpt.KalmanFilter(mpt.stack(axis, axis))

    low, high = 0.05, 1e4
    for _ in range(40):
        q = np.sqrt(low * high)
        nis = mpt.metrics.nis(filter_with(q), z)
        low, high = (q, high) if nis.mean() > 2 else (low, q)
    assert nis.mean() == pytest.approx(2, rel=1e-3)
    assert q > 100 * 0.05
    assert np.median(nis) < 0.5 * 1.39
    a = ahead(filter_with(q), z, 10.0)
    assert np.median(1.96 * a.sigma) > 10 * np.median(following(a)[1500:])


def test_a_band_goes_on_where_an_earlier_stretch_has_ended():
    rng = np.random.default_rng(0)
    errors = 3.0 * rng.standard_normal((3000, 2))
    whole, first = an_ahead(errors), an_ahead(errors[:1500])
    np.testing.assert_allclose(following(an_ahead(errors[1500:]), before=first)[0], following(whole)[1500], rtol=1e-9)


def test_predictions_that_overlap_are_not_independent():
    a = an_ahead(np.zeros((600, 1)), lag=10)
    assert coverage(a, a.sigma).independent == 60
    assert coverage(a, a.sigma, where=np.arange(600) % 100 < 50).independent == 30
    np.testing.assert_allclose(coverage(a, a.sigma).error, np.sqrt(62 * 2 / 64**3))  # (60 + 2) of (60 + 4) are hits
    row = np.tile(np.arange(300), 2)
    two = a._replace(made=row * 1.0, due=row + 10.0, track=np.repeat([0, 1], 300))
    assert coverage(two, two.sigma).independent == 60
    sparse = a._replace(made=a.made * 1000, due=a.made * 1000 + 10)  # the span alone would count 59,900
    assert coverage(sparse, sparse.sigma).independent == 600
    with pytest.warns(UserWarning, match="29 independent predictions of 10 s are too few"):
        coverage(a, a.sigma, where=np.arange(600) < 290)


def test_coverage_and_score_leave_out_what_was_not_measured():
    errors = np.zeros((100, 2))
    errors[:10, 0], errors[10:60, 0] = 2.0, np.nan
    a = an_ahead(errors)
    np.testing.assert_allclose(coverage(a, a.sigma).share, [0.8, 1.0])
    np.testing.assert_allclose(interval_score(a, a.sigma), [2 + 40 * 0.2, 2])


def test_coverage_and_score_leave_out_what_has_no_band_and_say_how_much():
    """Also where an error is missing as well, which is no statement left out."""
    errors = np.zeros((100, 2))
    errors[:10], errors[10:20, 0] = 2.0, np.nan
    a = an_ahead(errors)
    band = a.sigma.copy()
    band[:5, 0] = band[15:30, 0] = band[95:, 1] = np.nan
    stated = np.arange(100) % 4 > 0
    for where in (None, stated):
        these = np.ones(100, bool) if where is None else where
        there = np.isfinite(errors) & these[:, None]
        missed = [np.mean(errors[there[:, i] & np.isfinite(band[:, i]), i] > 1) for i in (0, 1)]
        count = (there & np.isnan(band)).sum()
        with pytest.warns(UserWarning, match=f"coverage: left out {count} of {there.sum()} errors") as told:
            found = coverage(a, band, where)
        assert told[0].filename == __file__
        np.testing.assert_allclose(found.share, 1 - np.array(missed))
        assert found.independent == (there & np.isfinite(band)).sum(axis=0).min()
        with pytest.warns(UserWarning, match=f"interval_score: left out {count} of"):
            score = interval_score(a, band, where=where)
        np.testing.assert_allclose(score, 2 + 40 * np.array(missed))
    band[:, 1] = np.nan
    for judge in (coverage, interval_score):
        with pytest.raises(ValueError, match="band, where: needs a half-width of at least one checked prediction"):
            judge(a, band)
        with pytest.raises(ValueError, match=r"band: needs half-widths of .* not negative, got -1"):
            judge(a, -a.sigma)


@pytest.mark.parametrize("r", [np.nan, -1.0])
def test_a_measurement_that_is_missing_needs_no_variance(r):
    """Its sigma is that of the model's noise, as in `innovations`: it was NaN once."""
    t, z = recorded(100)
    z[51] = 1.0, np.nan
    given = np.full(z.shape, 4.0)
    given[51, 1] = r
    a = ahead(mpt.KalmanFilter(PLANE, t=t, r=given), z, seconds=1.0)
    given[51, 1] = PLANE.R[1, 1]
    np.testing.assert_array_equal(a.sigma, ahead(mpt.KalmanFilter(PLANE, t=t, r=given), z, seconds=1.0).sigma)
    assert 51 in a.due_row


def test_an_axis_that_is_never_measured_has_no_score():
    t, z = recorded(50)
    z[:, 1] = np.nan
    a = ahead(mpt.KalmanFilter(PLANE, t=t), z, seconds=1.0)
    band = following(a)
    for judged in (coverage, interval_score):
        with pytest.raises(ValueError, match="band, where: needs a half-width of at least one checked prediction"):
            judged(a, band)


def test_the_score_is_least_for_the_true_quantiles():
    errors = np.random.default_rng(0).standard_normal((200_000, 1))
    a = an_ahead(errors)
    scores = {width: interval_score(a, np.full(errors.shape, width)).item() for width in (1.5, 1.8, 1.96, 2.1, 2.5)}
    assert min(scores, key=scores.get) == 1.96


def test_a_model_of_one_step_length_and_a_horizon_without_fixes_are_refused():
    with pytest.raises(ValueError, match="estimator: needs a model with a transition"):
        ahead(mpt.KalmanFilter(mpt.gsm_axis(dt=1.0, q=0.01, r=0.1)), np.zeros((9, 1)), 1.0)
    with pytest.raises(ValueError, match=r"seconds: needs a horizon after which there are fixes, .* got 1$"):
        ahead(mpt.KalmanFilter(AXIS, t=np.arange(9) * 3.0), np.zeros((9, 1)), 1.0)
    for made in (mpt.JoinFilter, mpt.Separate):
        whole = made(*2 * [mpt.KalmanFilter(AXIS, t=np.arange(9))])
        with pytest.raises(ValueError, match="estimator: needs a filter whose times and variances are its own"):
            ahead(mpt.Separate(whole, whole), np.zeros((9, whole.model.m * 2)), 1.0)
    for predictor in (mpt.Predictor(mpt.KalmanFilter(AXIS), 2), mpt.FIRFilter(AXIS, np.ones((3, 2, 1)))):
        with pytest.raises(TypeError, match="needs a filter with P0"):
            ahead(predictor, np.zeros((9, 1)), 1.0)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda a: following(a.errors), "a: needs a ForecastErrors"),
        (lambda a: following(a, level=1.0), r"level: needs a number in \(0, 1\)"),
        (lambda a: following(a, before=an_ahead(a.errors, lag=2)), "before: needs predictions of 1 s and 2 axes"),
        (lambda a: following(a, before=an_ahead(a.errors[:, :1])), "before: needs predictions of 1 s and 2 axes"),
        (lambda a: LiveBand(mpt.KalmanFilter(PLANE), 2.0, before=a), "before: needs predictions of 2 s and 2 axes"),
        (lambda a: coverage(a, a.sigma[:1]), r"band: needs half-widths of shape \(40, 2\)"),
        (lambda a: coverage(a, a.sigma, where=[True]), "where: needs an array of 40 truth values"),
        (lambda a: coverage(a, a.sigma, where=np.arange(40)), "where: needs an array of 40 truth values"),
        (lambda a: coverage(a, a.sigma, where=np.zeros(40, bool)), "band, where: needs a half-width of at least one"),
        (lambda a: interval_score(a, a.sigma, level=0), "level: needs"),
        (lambda a: ahead(mpt.KalmanFilter(PLANE), a.errors, 0.0), "seconds: needs a positive number"),
    ],
)
def test_bad_input_is_refused_by_name(call, said):
    with pytest.raises((ValueError, TypeError), match=said):
        call(an_ahead(np.zeros((40, 2))))


def test_the_live_band_refuses_a_time_that_runs_back():
    kf = mpt.KalmanFilter(AXIS)
    live = LiveBand(kf, 1.0)
    live.step(5.0, [0.0], AXIS.x0, AXIS.P0)
    with pytest.raises(ValueError, match="t: needs a time that is not before the last one, 5, got 4"):
        live.step(4.0, [0.0], AXIS.x0, AXIS.P0)


@pytest.mark.parametrize(
    ("t", "P", "said"),
    [
        (datetime(2024, 5, 3), np.eye(2), "t: needs a time in seconds"),
        (0.0, -np.eye(2), "P: needs a symmetric"),
        (0.0, np.array([[1.0, 50.0], [0.0, 1.0]]), "P: needs a symmetric"),
    ],
)
def test_the_live_band_refuses_dates_and_what_is_no_covariance(t, P, said):
    live = LiveBand(mpt.KalmanFilter(AXIS), 1.0)
    with pytest.raises((ValueError, TypeError), match=said):
        live.step(t, [0.0], [0.0, 1.0], P)


def test_a_mask_of_a_masked_array_is_refused():
    a = an_ahead(np.zeros((40, 1)))
    with pytest.raises(ValueError, match="where: needs an array of 40 truth values, got MaskedArray"):
        coverage(a, a.sigma, where=np.ma.array(np.ones(40, bool), mask=np.arange(40) < 30))


def test_forecast_errors_are_shown_by_their_shapes():
    a = an_ahead(np.zeros((40, 2)))
    assert repr(a) == f"ForecastErrors(40 predictions of 2 axes, 1 s ahead; {a.left_out} fixes left out)"


def test_a_band_beside_a_state_that_nothing_measures_is_right_or_refused():
    """Only the sum of two states is measured, so each stays as vague as P0; the variance of the sum is exact here."""
    q, seconds, z = 0.01, 3.0, np.random.default_rng(0).normal(0, 1, (40, 1))

    def checked(p):
        model = mpt.LinearModel(H=[[1, 1]], R=[[1]], P0=p * np.eye(2), dt=1.0, transition=partial(_two_walks, q))
        return ahead(mpt.KalmanFilter(model), z, seconds)

    sum_of_both = mpt.LinearModel(F=[[1]], H=[[1]], Q=[[2 * q]], R=[[1]], P0=[[2e8]])
    P = mpt.KalmanFilter(sum_of_both).covariances(z)[:, 0, 0]
    a = checked(1e8)
    np.testing.assert_allclose(a.sigma[:, 0] ** 2, P[a.row] + 2 * q * (a.due - a.made) + 1, rtol=1e-6)
    for p in (1e15, 1e18):
        with pytest.raises(ValueError, match="P0: needs a start that leaves digits of the predicted measurements"):
            checked(p)


def _two_walks(q, dt):
    dt = np.asarray(dt, float)[..., None, None]
    return np.eye(2) + 0 * dt, q * dt * np.eye(2)
