"""Any track: gaps, times and precisions of its own, in one piece or in many; the smoother, predictions and fits."""

import warnings
from dataclasses import replace
from functools import partial

import numpy as np
import precise
import pytest
from conftest import AXIS, dense_model
from oracles import gaussian_conditioning_of_steps, gaussian_covariance, gaussian_log_density, matrices
from scipy.optimize import minimize

import mpt_helpers as mpt
from mpt_helpers import metrics
from mpt_helpers._base import Estimates
from mpt_helpers._engine import pieces as partition
from mpt_helpers._engine import run as engine
from mpt_helpers._engine import shared as steps
from mpt_helpers._engine.columns import KalmanColumns
from mpt_helpers._engine.shared import recursion
from mpt_helpers.equations import square_root

MAKERS = {"cv": mpt.constant_velocity, "ca": mpt.constant_acceleration}


def start(make, **given):
    """A model of one axis with a start that is not zero."""
    model = make(dt=0.7, q=0.04, r=0.5)
    return replace(model, x0=np.arange(1.0, model.n + 1), P0=np.eye(model.n) + 0.1, **given)


def plane(make=mpt.constant_velocity):
    return mpt.stack(start(make), replace(start(make), R=[[2.0]]))


def gappy(model, rng, N, tracks=None, epochs=0.2, rows=0.2):
    z = mpt.simulate(model, N, rng, tracks)[1]
    shape = (N, 1, *z.shape[2:])
    return np.where((rng.random(shape) < epochs) | (rng.random(z.shape) < rows), np.nan, z)


def of_steps(model, t):
    """F and Q of each step, by the papers' matrices for its length, and not by the package's scaling."""
    lengths = np.concatenate([[model.dt], np.diff(t)])
    make = {2: mpt.constant_velocity, 3: mpt.constant_acceleration}[model.n // model.m]
    made = [mpt.stack(*[make(dt=dt, q=0.04, r=1.0)] * model.m) if dt else None for dt in lengths]
    n = model.n
    return [each.F if each else np.eye(n) for each in made], [each.Q if each else np.zeros((n, n)) for each in made]


@pytest.mark.parametrize("P0", [0.0, 1.0], ids=["P0 = 0", "P0"])
@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
@pytest.mark.parametrize("own", [None, 3], ids=["one track", "tracks of their own times"])
def test_times_gaps_and_variances_are_dense_conditioning(make, P0, own):
    """Estimates, smoothed states, innovations and likelihood; two fixes at one time, and partly missing rows."""
    rng = np.random.default_rng(0)
    model = replace(plane(make), P0=P0 * plane(make).P0)
    N, shape = 16, () if own is None else (own,)
    lengths = rng.choice([0.0, 0.0, 1e-9, 0.1, 0.7, 3.0], (N, *shape))  # so that some three rows have one time
    t, z = np.cumsum(lengths, axis=0), gappy(model, rng, N, own)
    r = rng.uniform(0.1, 3.0, z.shape)
    kf = mpt.KalmanFilter(model, t=t, r=np.where(np.isnan(z), np.nan, r))
    both, smooth, new, log_l = kf.estimates(z), kf.smooth(z), metrics.innovations(kf, z), metrics.log_likelihood(kf, z)
    nis = metrics.nis(kf, z)
    for i in range(own or 1):
        one = (lambda array: array) if own is None else (lambda array, i=i: array[..., i])
        exact = gaussian_conditioning_of_steps(
            *of_steps(model, one(t)), model.H, [np.diag(row) for row in one(r)], model.x0, model.P0, one(z)
        )
        # Products of some hundred numbers of order 10; the dense solution itself rounds more.
        near = partial(np.testing.assert_allclose, rtol=1e-8, atol=1e-9)
        near(one(both.x), exact.x)
        near(one(both.P), exact.P)
        near(one(smooth.x), exact.x_smooth)
        near(one(smooth.P), exact.P_smooth)
        near(one(new.values), exact.innovations)
        seen = ~np.isnan(one(z))
        pairs = seen[:, :, None] & seen[:, None]
        near(one(new.S)[pairs], exact.S[pairs])
        near(np.atleast_1d(log_l)[i], exact.log_density)
        near(one(nis), exact.nis)


@pytest.mark.parametrize("tracks", [None, 4])
@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_a_row_of_nothing_at_any_time_changes_nothing(make, tracks):
    """Refinement: between two rows, at the time of a row, and after the end."""
    rng = np.random.default_rng(1)
    model, N = plane(make), 60
    shape = () if tracks is None else (tracks,)
    t, z = np.cumsum(rng.uniform(0.1, 2.0, (N, *shape)), axis=0), gappy(model, rng, N, tracks)
    put_in = np.sort(rng.integers(1, N + 1, 25))
    share = rng.choice([0.0, 0.3, 1.0], (25, *shape))
    after = np.concatenate([t, t[-1:] + 1.0])
    between = after[put_in - 1] + share * (after[put_in] - after[put_in - 1])
    order = np.argsort(np.concatenate([np.arange(N), put_in - 0.5]), kind="stable")
    finer_t = np.sort(np.concatenate([t, between])[order], axis=0)
    finer_z = np.concatenate([z, np.full((25, *z.shape[1:]), np.nan)])[order]
    rows = np.flatnonzero(order < N)
    # Rows at one time may have changed places with their neighbours of equal times by the sort: z stays with its time.
    assert np.array_equal(finer_t[rows], t)
    coarse, fine = mpt.KalmanFilter(model, t=t), mpt.KalmanFilter(model, t=finer_t)
    # A few hundred products of numbers up to 100, relative to the largest.
    near = partial(np.testing.assert_allclose, rtol=1e-10, atol=1e-12 * np.abs(coarse.filter(z)).max())
    for function in ("estimates", "smooth"):
        a, b = getattr(coarse, function)(z), getattr(fine, function)(finer_z)
        near(b.x[rows], a.x)
        near(b.P[rows], a.P)
    near(metrics.log_likelihood(fine, finer_z), metrics.log_likelihood(coarse, z))


def filters_of(model):
    kf, lf, steady = mpt.KalmanFilter(model), mpt.LainiotisFilter(model), mpt.SteadyStateFilter.from_kalman(model)
    return {
        "KF": kf,
        "LF": lf,
        "SSKF": steady,
        "join": mpt.JoinFilter(kf, lf),
        "separate": mpt.Separate(lf, kf),
        "predictor": mpt.Predictor(kf, 3),
        "steady predictor": mpt.SteadyStatePredictor(steady, 3),
    }


# Of one track and of several; the last piece is shorter, or as long as the others. test_paths draws all other kinds.
CUT = [("none", None, 7), ("own", 3, 2)]


@pytest.mark.parametrize(("gaps", "tracks", "pieces"), CUT)
@pytest.mark.parametrize("name", filters_of(dense_model(0)))
def test_a_track_in_pieces_is_the_track(monkeypatch, name, gaps, tracks, pieces):
    """Of any length of the pieces, the last of them shorter; estimates, innovations, likelihood and the smoother."""
    model = dense_model(3)
    model = replace(model, F=model.F / np.abs(np.linalg.eigvals(model.F)).max())
    each = filters_of(model)[name]
    rng = np.random.default_rng(2)
    z = mpt.simulate(each.model, 60, rng, tracks)[1]
    lost = rng.random((60, 1, *z.shape[2:])) < 0.2
    lost = {"none": False, "shared": lost[:, :, :1] if tracks else lost, "own": lost}[gaps]
    z[np.broadcast_to(lost, z.shape)] = np.nan

    def results():
        both = each.estimates(z)
        found = [each.filter(z), both.x, both.P]
        if "predictor" not in name:
            found += [*metrics.innovations(each, z), metrics.nis(each, z), metrics.log_likelihood(each, z)]
        if name in ("KF", "LF", "join", "separate"):
            found += each.smooth(z)
        return found

    def fitting_at_once(*arguments):
        largest = in_pieces(*arguments)
        assert largest is not None
        return largest

    in_pieces = partition._in_pieces
    monkeypatch.setattr(partition, "rows_per_piece", lambda N, tracks: N)
    whole = results()
    monkeypatch.setattr(partition, "rows_per_piece", lambda N, tracks: min(N, pieces))
    monkeypatch.setattr(partition, "MOST_PASSES", 1)  # others would mend what is wrong with the starts
    monkeypatch.setattr(partition, "_in_pieces", fitting_at_once)
    for ours, theirs in zip(results(), whole, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)


# Some twenty times by how much `step` after `step` and the uncut columns differ, both in doubles.
@pytest.mark.parametrize(
    ("make", "sleep", "allowed"),
    [
        (mpt.constant_velocity, 3600.0, 1e-6),
        (mpt.constant_velocity, 86_400.0, 5e-6),  # the pieces fit after the second run
        (mpt.constant_acceleration, 600.0, 5e-6),  # after the third
        (mpt.constant_acceleration, 3600.0, 5e-5),
    ],
)
def test_a_tracker_that_sleeps_again_and_again_is_the_track(monkeypatch, make, sleep, allowed):
    """Bursts of five fixes: each piece holds several pauses, over which its response to its start loses its digits."""
    axis = make(dt=1.0, q=0.01, r=1.0)
    axis = replace(axis, P0=10 * np.eye(axis.n))
    steps = np.ones(239)
    steps[4::5] = sleep
    t = np.concatenate([[0.0], np.cumsum(steps)])
    rng = np.random.default_rng(1)
    x, z = rng.standard_normal(axis.n), np.empty((240, 1))
    for k, length in enumerate([1.0, *steps]):
        F, Q = axis.over(length)
        x = F @ x + square_root(Q) @ rng.standard_normal(axis.n)
        z[k] = x[0] + rng.standard_normal()
    kf = mpt.KalmanFilter(axis, t=t)
    found, in_pieces = [], partition._in_pieces
    monkeypatch.setattr(partition, "_in_pieces", lambda *all: found.append(in_pieces(*all)) or found[-1])
    both, x, P, states = kf.estimates(z), axis.x0, axis.P0, []
    assert found[-1] is not None  # the first are those of the pieces as rows
    for length, z_k in zip([1.0, *steps], z, strict=True):
        x, P = kf.step(x, P, z_k, dt=length)
        states.append(x)
    off = np.abs(both.x - states) / np.sqrt(np.einsum("kii->ki", both.P))
    assert off.max() < allowed


def test_a_tile_whose_tracks_share_a_covariance_gives_it_to_each(monkeypatch):
    """After a diffuse pause: one track of another tile misses a row, so that not all tracks share it."""
    few = partition.FEW_TRACKS
    monkeypatch.setattr(engine, "MOST_NUMBERS", 1)  # tiles of so few tracks
    axis = mpt.constant_acceleration(1.0, 0.1, 1.0, P0=np.diag([100.0, 100.0, 10.0]))
    t = np.arange(60.0) + np.where(np.arange(60) < 30, 0.0, 1e6)
    kf = mpt.KalmanFilter(mpt.stack(axis, axis), t=t)
    z = np.random.default_rng(1).normal(size=(60, 2, 2 * few + 2))
    z[10, 0, 0] = np.nan
    found, own = kf.estimates(z), kf.estimates(z[..., few + 20])
    for track in (1, few + 10, -1):
        variances, expected = (P.diagonal(axis1=1, axis2=2) for P in (found.P[..., track], own.P))
        np.testing.assert_allclose(variances, expected, rtol=1e-9)


def test_many_diffuse_pauses_filter_no_row_many_times(monkeypatch):
    """Fifty pauses of a day: all rows up to the next thousand were filtered again after each, 20,000 epochs in all."""
    dts, advanced = np.ones(2_000), 0
    dts[40::40] = 1e5
    advance = KalmanColumns.advance

    def counted(self, row, x, P):
        nonlocal advanced
        advanced += 1
        return advance(self, row, x, P)

    monkeypatch.setattr(KalmanColumns, "advance", counted)
    kf = mpt.KalmanFilter(mpt.constant_acceleration(1.0, 0.01, 0.1, P0=np.eye(3)), t=np.cumsum(dts))
    kf.estimates(np.random.default_rng(0).standard_normal((2_000, 1)))
    assert advanced < 2 * len(dts)


def test_pieces_fit_together_along_sums_of_states_too():
    """Two pauses of hours, and a fix missed after the second: one sum of states is known 1e5 times as well as any.

    Compared state by state the pieces agreed to 3e-7 sigma, and the estimates were wrong by 0.015.
    """
    axis = mpt.constant_acceleration(dt=1.0, q=1.0, r=25.0, P0=np.eye(3))
    steps = np.ones(40)
    steps[12], steps[22] = 7200.0, 14_400.0
    rng, x, z = np.random.default_rng(1_000_073), np.zeros(3), np.empty((40, 1))
    for k, length in enumerate(steps):
        F, Q = axis.over(length)
        sigma = np.sqrt(np.diag(Q))
        variances, axes = np.linalg.eigh(Q / np.outer(sigma, sigma))
        x = F @ x + sigma * (axes @ (np.sqrt(np.maximum(variances, 0)) * rng.standard_normal(3)))
        z[k] = x[0] + 5.0 * rng.standard_normal()
    z[23] = np.nan
    kf = mpt.KalmanFilter(axis, t=np.cumsum(steps))
    both, x, P, states = kf.estimates(z), axis.x0, axis.P0, []
    for length, z_k in zip(steps, z, strict=True):
        x, P = kf.step(x, P, z_k, dt=length)
        states.append(x)
    off = np.abs(both.x - states) / np.sqrt(np.einsum("kii->ki", both.P))
    assert off.max() < 5e-5  # each of them errs by 1e-6


@pytest.mark.parametrize("make", [mpt.KalmanFilter, mpt.LainiotisFilter])
def test_a_gain_that_never_settles_takes_a_track_without_gaps_through_columns(make, monkeypatch):
    """Without process noise no step repeats: 50 times slower one by one, and a Step for each row to keep."""
    model = replace(mpt.constant_velocity(1.0, 0.0, 0.5), P0=100 * np.eye(2))
    z = mpt.simulate(model, 3 * steps.MOST_STEPS, np.random.default_rng(6))[1]
    one_by_one = make(model).coefficients(len(z))
    x = recursion(one_by_one.A, one_by_one.B, model.x0, z)
    taken = []
    monkeypatch.setattr(
        make, "next_step", lambda *given, next_step=make.next_step: taken.append(1) or next_step(*given)
    )
    kf = make(model)
    both = kf.estimates(z)
    sigma = np.sqrt(np.einsum("kii->ki", both.P))
    assert len(taken) < len(z) / 2
    assert (np.abs(both.x - x) < 1e-9 * sigma).all()
    assert (np.abs(both.P - one_by_one.P) < 1e-9 * sigma[:, :, None] * sigma[:, None]).all()
    assert (np.abs(kf.filter(np.dstack([z, z])) - x[..., None]) < 1e-9 * sigma[..., None]).all()


@pytest.mark.parametrize("P0", [0.0, 1.0])
@pytest.mark.parametrize("name", ["gps_ins", "gsm", "dense"])
def test_the_smoother_is_dense_conditioning(name, P0):
    """Also where P(k+1/k) is singular: a start known exactly, a constant bias, noise of one direction."""
    model = {"gps_ins": mpt.gps_ins(1.0, 0.01, (1.0, 0.1)), "gsm": AXIS, "dense": dense_model(2)}[name]
    model = replace(model, P0=P0 * np.eye(model.n), x0=np.ones(model.n))
    F, H, Q, R, x0, _ = matrices(model)
    z = gappy(model, np.random.default_rng(3), 14, rows=0.1)
    exact = gaussian_conditioning_of_steps([F] * 14, [Q] * 14, H, [R] * 14, x0, model.P0, z)
    for make in (mpt.KalmanFilter, mpt.LainiotisFilter):
        s = make(model).smooth(z)
        np.testing.assert_allclose(s.x, exact.x_smooth, rtol=1e-7, atol=1e-8)
        np.testing.assert_allclose(s.P, exact.P_smooth, rtol=1e-7, atol=1e-8)


def test_the_smoother_of_many_tracks_is_that_of_each_and_of_separate_axes():
    model = plane()
    z = gappy(model, np.random.default_rng(4), 120, 5)
    z[..., :2] = z[..., :1]
    many = mpt.KalmanFilter(model).smooth(z)
    for i in range(5):
        one = mpt.KalmanFilter(model).smooth(z[..., i])
        np.testing.assert_allclose(many.x[..., i], one.x, rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(many.P[..., i], one.P, rtol=1e-10, atol=1e-10)
    axes = [replace(start(mpt.constant_velocity), R=[[r]]) for r in (0.5, 2.0)]
    apart = mpt.Separate(mpt.KalmanFilter(axes[0]), mpt.LainiotisFilter(axes[1])).smooth(z)
    np.testing.assert_allclose(apart.x, many.x, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(apart.P, many.P, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", ["SSKF", "predictor", "FIR", "join"])
def test_the_smoother_is_refused_where_the_gain_is_not_optimal(name):
    steady = mpt.SteadyStateFilter.from_kalman(AXIS)
    each = {
        "SSKF": steady,
        "predictor": mpt.Predictor(mpt.KalmanFilter(AXIS), 2),
        "FIR": mpt.FIRFilter.from_steady_state(steady),
        "join": mpt.JoinFilter(mpt.KalmanFilter(AXIS), steady),
    }[name]
    with pytest.raises(TypeError, match="needs a filter"):
        each.smooth(np.zeros((5, 1)))


def test_the_smoothed_error_is_the_one_that_is_stated():
    """Its mean square over tracks that were simulated, inside a gap too, and smaller than the filter's."""
    model = mpt.constant_velocity(1.0, 0.04, 0.5, P0=np.eye(2))
    x, z = mpt.simulate(model, 60, np.random.default_rng(5), 4000)
    z[20:28] = np.nan
    s, e = mpt.KalmanFilter(model).smooth(z), mpt.KalmanFilter(model).estimates(z)
    # 4,000 tracks know a mean square to 2.2 %; of sixty epochs none is off by five times that.
    np.testing.assert_allclose(np.square(s.x - x).mean(axis=2), np.einsum("kiiM->ki", s.P) / 4000, rtol=0.12)
    assert s.P[20:28, 0, 0].mean() < e.P[20:28, 0, 0].mean() / 4


@pytest.mark.parametrize("name", ["KF", "LF", "SSKF", "join", "separate"])
def test_a_predictor_is_the_propagated_estimate_over_gaps(name):
    each = filters_of(AXIS)[name]
    model = each.model
    z = mpt.simulate(model, 40, np.random.default_rng(6), 3)[1]
    z[5:9, :, 1] = np.nan
    ahead, both = mpt.Predictor(each, 4), each.estimates(z)
    F, P = np.linalg.matrix_power(model.F, 4), both.P
    for _ in range(4):
        P = np.einsum("ab,kbcM,dc->kadM", model.F, P, model.F) + model.Q[..., None]
    np.testing.assert_allclose(ahead.filter(z), F @ both.x, rtol=1e-12)
    np.testing.assert_allclose(ahead.covariances(z), P, rtol=1e-11, atol=1e-14)
    np.testing.assert_allclose(ahead.estimates(z).x, F @ both.x, rtol=1e-12)


def test_a_predictor_of_a_filter_with_times_looks_ahead_by_steps_of_the_model():
    model, t = start(mpt.constant_velocity), [0.0, 0.0, 3.0]
    kf, z = mpt.KalmanFilter(model, t=t), [[1.0], [2.0], [np.nan]]
    np.testing.assert_allclose(mpt.Predictor(kf, 2).filter(z), kf.filter(z) @ (model.F @ model.F).T, rtol=1e-12)


def test_a_number_of_steps_is_one_whatever_its_type():
    kf = mpt.KalmanFilter(AXIS)
    assert mpt.Predictor(kf, np.int64(3)) == mpt.Predictor(kf, 3)


@pytest.mark.parametrize("name", ["predictor", "steady predictor", "FIR"])
def test_a_filter_without_a_start_of_its_own_is_refused_by_name(name):
    axis = mpt.constant_velocity(dt=1.0, q=0.01, r=0.1)
    steady = mpt.SteadyStateFilter.from_kalman(axis)
    each = (filters_of(axis) | {"FIR": mpt.FIRFilter.from_steady_state(steady)})[name]
    ahead = partial(metrics.ahead, seconds=2.0)
    for function in (ahead, metrics.innovations, metrics.nis, metrics.log_likelihood):
        with pytest.raises(TypeError, match=f"estimator: needs a filter with P0, .*, got a {type(each).__name__}"):
            function(each, np.arange(20.0)[:, None])


@pytest.mark.parametrize("tracks", [None, 2])
def test_steps_of_any_length_are_the_filter_with_times(tracks):
    model = plane()
    rng = np.random.default_rng(7)
    t, z = np.cumsum(rng.choice([0.0, 0.4, 2.0], 30)), gappy(model, rng, 30)
    r = rng.uniform(0.1, 2.0, z.shape)
    kf = mpt.KalmanFilter(model, t=t, r=r)
    both, (x, P) = kf.estimates(z), (model.x0, model.P0)
    for k, dt in enumerate([model.dt, *np.diff(t)]):
        x, P = kf.step(x, P, z[k], dt=dt, r=r[k])
        np.testing.assert_allclose(x, both.x[k], rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(P, both.P[k], rtol=1e-9, atol=1e-10)


def test_equal_steps_of_the_models_length_are_no_times():
    model = plane()
    z = gappy(model, np.random.default_rng(8), 50, 3)
    timed = mpt.KalmanFilter(model, t=7.0 + 0.7 * np.arange(50)).estimates(z)
    plain = mpt.KalmanFilter(model).estimates(z)
    np.testing.assert_allclose(timed.x, plain.x, rtol=1e-10, atol=1e-11)
    np.testing.assert_allclose(timed.P, plain.P, rtol=1e-10, atol=1e-12)


T = np.arange(5.0)
ZERO, ONE = np.zeros(4), np.eye(4)


def timed(model=None, **conditions):
    return mpt.KalmanFilter(plane() if model is None else model, **conditions)


@pytest.mark.parametrize("r", [-1.0, 0.0, np.nan, np.inf])
def test_the_variance_of_a_missing_measurement_is_not_looked_at(r):
    """In its place S has that of the model."""
    z = np.array([[1.0, 2.0], [np.nan, 2.5]])
    given, models = np.full((2, 2), 0.5), np.full((2, 2), 0.5)
    given[1, 0], models[1, 0] = r, plane().R[0, 0]
    for ours, right in zip(*(metrics.innovations(timed(r=each), z) for each in (given, models)), strict=True):
        np.testing.assert_array_equal(ours, right)


def test_a_damped_mode_without_process_noise_is_told_by_the_smoother():
    F = np.array([[0.98, 0.47], [-0.02, 0.22]])  # its P(k/N) was wrong by a tenth
    z = np.ones((40, 1))

    def smoothed(F, Q):
        return mpt.KalmanFilter(mpt.LinearModel(F=F, H=[[1, 0]], Q=Q, R=[[1]], P0=np.eye(2))).smooth(z)

    with pytest.warns(
        UserWarning, match=r"smooth: F has damped modes without process noise, 0\.\d+, 0\.\d+, so"
    ) as said:
        smoothed(F, np.zeros((2, 2)))
    assert said[0].filename == __file__  # it names the line that calls, not one of ours
    with pytest.warns(UserWarning, match="damped"):  # too little to matter
        smoothed(F, 1e-18 * np.eye(2))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        smoothed(F, 1e-6 * np.eye(2))
        smoothed(F, 1e-6 * np.diag([0, 1]))  # it reaches both modes
        smoothed(AXIS.F, np.zeros((2, 2)))


@pytest.mark.parametrize("seed", range(6))
def test_a_damped_mode_is_told_whichever_track_does_not_measure_it(seed):
    """Beside the variance of what is measured to 1e-5 m the noise is large, beside that of what is missed it is nil."""
    rng = np.random.default_rng(seed)
    z, r = rng.standard_normal((12, 1, 3)), np.full((12, 1, 3), 1e-10)
    model = mpt.LinearModel(F=[[0.5]], H=[[1]], Q=[[1e-16]], R=[[1]], P0=[[1]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mpt.KalmanFilter(model, r=r).smooth(z)
    z[0, 0, rng.integers(3)] = np.nan
    with pytest.warns(UserWarning, match="damped modes without process noise, 0.5,"):
        mpt.KalmanFilter(model, r=r).smooth(z)


REFUSED_TIMES = {
    "gsm": (lambda: timed(AXIS, t=T), "t: needs a model with a transition"),
    "gps_ins": (lambda: timed(mpt.gps_ins(1.0, 0.1, (1.0, 1.0)), t=T), "t: needs a model with a transition"),
    "a plain model": (lambda: timed(mpt.LinearModel(F=[[1]], H=[[1]], Q=[[1]], R=[[1]]), t=T), "t: needs a mod"),
    "another F": (lambda: timed(replace(plane(), F=0.9 * np.eye(4)), t=T), "t: needs a model with a transition"),
    "another Q": (lambda: timed(replace(plane(), Q=np.eye(4)), t=T), "t: needs a model with a transition"),
    "axes of other dt": (
        lambda: timed(mpt.stack(*(mpt.constant_velocity(dt, 1, 1) for dt in (1, 2))), t=T),
        "models: needs models of the same dt",
    ),
    "backwards": (lambda: timed(t=[0, 2, 1]), "t: needs .* do not decrease, got 1 after 2, in row 2"),
    "NaN": (lambda: timed(t=[0, np.nan]), "t: needs .* got NaN or infinity"),
    "length": (lambda: timed(t=T).filter(np.zeros((4, 2))), r"t: needs the epochs and tracks of z, \(4"),
    "tracks": (lambda: timed(t=np.arange(12.0).reshape(4, 3)).filter(np.zeros((4, 2, 2))), "t: needs the epochs"),
    "r of zero": (lambda: timed(r=np.zeros((4, 2))).filter(np.zeros((4, 2))), "r: needs a positive var"),
    "r missing": (lambda: timed(r=[[1, np.nan]]).filter(np.zeros((1, 2))), "r: needs a positive var"),
    "r of other axes": (lambda: timed(r=np.ones((4, 1))), r"r: needs an \(N, 2\) or"),
    "step without dt": (lambda: timed(t=T).step(ZERO, ONE, [0, 0]), "dt: needs the time"),
    "step without r": (lambda: timed(r=[[1, 1]]).step(ZERO, ONE, [0, 0]), "r: needs"),
    "step, r below zero": (lambda: timed().step(ZERO, ONE, [0, 0], r=[1, -1]), r"r: needs a .*positive variance"),
    "step, r of other axes": (lambda: timed().step(ZERO, ONE, [0, 0], r=[1]), r"r: needs .* got shape \(1,\)"),
    "over": (lambda: AXIS.over(1.5), "dt: needs a model with a transition"),
    "fit, rows": (lambda: mpt.fit(lambda q: plane(), np.zeros((20, 3)), q=1.0), r"z: needs an \(N, 2\)"),
    "coefficients, t": (lambda: timed(t=T).coefficients(4), "t: needs to be left out, .* got times"),
    "coefficients, r": (lambda: timed(r=[[1, 1]]).coefficients(1), "r: needs to be left out, .* got variances"),
    "join, t": (lambda: mpt.JoinFilter(timed(t=T), mpt.LainiotisFilter(plane())), "second: needs a .* same times"),
    "join of predictors, t": (
        lambda: mpt.JoinFilter(mpt.Predictor(timed(t=T), 1), mpt.Predictor(timed(), 1)),
        "second: needs a filter of the same times",
    ),
    "join of parts, t": (
        lambda: mpt.JoinFilter(mpt.Separate(timed(t=T)), timed()),
        "second: needs a filter of the same times",
    ),
    "join, r": (lambda: mpt.JoinFilter(timed(), timed(r=[[1, 1]])), "second: needs a filter of the same variances"),
    "step backwards": (lambda: timed().step(ZERO, ONE, [0, 0], dt=-1), "dt: needs a number"),
    "step of gsm": (lambda: timed(AXIS).step(np.zeros(2), np.eye(2), [0], dt=1), "dt: needs a model with a transition"),
    "step, P between axes": (
        lambda: mpt.Separate(timed(), timed()).step(np.zeros(8), np.eye(8) + 0.1, [0] * 4),
        "P: needs a block diagonal covariance, got one between the states of different filters",
    ),
    "step, swapped": (lambda: timed().step(ONE, ZERO, [0, 0]), r"x: needs a \(4,\) array"),
    "step, NaN in x": (lambda: timed().step(np.nan * ZERO, ONE, [0, 0]), "x: needs a .* NaN"),
    "step, NaN in P": (lambda: mpt.LainiotisFilter(AXIS).step(np.zeros(2), np.nan * np.eye(2), [0]), "P: needs a .*"),
}


@pytest.mark.parametrize(("call", "words"), REFUSED_TIMES.values(), ids=REFUSED_TIMES)
def test_times_variances_and_steps_are_refused_by_name(call, words):
    with pytest.raises(ValueError, match=words):
        call()


def test_a_step_of_two_filters_of_different_gains_is_refused():
    kf, steady = mpt.KalmanFilter(AXIS), mpt.SteadyStateFilter.from_kalman(AXIS)
    B = steady.B / 2
    other = mpt.SteadyStateFilter(AXIS, A=(np.eye(2) - B @ AXIS.H) @ AXIS.F, B=B, P=steady.P)
    for join in (mpt.JoinFilter(kf, steady), mpt.JoinFilter(steady, other)):
        with pytest.raises(TypeError, match="step: needs two filters of the same gain"):
            join.step(np.zeros(2), np.eye(2), [0.0])


UNSEEN = mpt.LinearModel(
    F=np.diag([1, 0.5]), H=[[1, 0]], Q=np.eye(2), R=[[1]]
)  # of the second state nothing is measured
EQUAL_BUT_FOR_ROUNDING = {"two axes": (AXIS, AXIS), "an unseen state and an axis": (UNSEEN, AXIS)}


@pytest.mark.parametrize("models", EQUAL_BUT_FOR_ROUNDING.values(), ids=EQUAL_BUT_FOR_ROUNDING)
def test_gains_are_equal_where_one_solver_has_zero_and_the_other_its_rounding(models):
    """Of two axes the gain of one for the measurement of the other is zero by one solver, 2e-48 by the other."""
    model = mpt.stack(*models)
    joint = mpt.six_filters(model)["JSSKLF"]
    z = np.ones(model.m)
    x, P = joint.step(model.x0, joint.P0, z)
    np.testing.assert_allclose(x, joint.filter([z])[0], rtol=1e-12)
    np.testing.assert_allclose(P, joint.covariances(1)[0], rtol=1e-12, atol=1e-15)


def test_gains_are_compared_state_by_state():
    """A state in km has a gain a thousandth of that in m: a tenth more of it is a tenth more."""
    unit = np.array([1.0, 1e7])
    model = mpt.LinearModel(F=AXIS.F * unit / unit[:, None], H=AXIS.H * unit, Q=AXIS.Q / np.outer(unit, unit), R=AXIS.R)
    steady = mpt.SteadyStateFilter.from_kalman(model)
    B = steady.B * [[1.0], [1.1]]
    other = mpt.SteadyStateFilter(model, A=(np.eye(2) - B @ model.H) @ model.F, B=B, P=steady.P)
    with pytest.raises(TypeError, match="step: needs two filters of the same gain"):
        mpt.JoinFilter(steady, other).step(np.zeros(2), steady.P, [0.0])


def wrappers(kf):
    return [kf, mpt.JoinFilter(kf, kf), mpt.Separate(kf), mpt.Predictor(kf, 2)]


@pytest.mark.parametrize("i", range(4))
def test_wrappers_ask_for_the_conditions_of_their_filters(i):
    """Each way through a wrapper refuses times that are not those of z, and a variance that is no variance."""
    z, late, zero = np.zeros((40, 2)), np.arange(50.0), np.zeros((40, 2))
    for conditions, words in (
        ({"t": late}, "t: needs the epochs and tracks of z"),
        ({"r": zero}, "r: needs a positive"),
    ):
        each = wrappers(timed(**conditions))[i]
        for function in (each.filter, each.estimates, each.covariances):
            with pytest.raises(ValueError, match=words):
                function(z)


@pytest.mark.parametrize("i", range(4), ids=["one", "join", "separate", "predictor"])
def test_a_filter_of_filters_has_their_times(i):
    """It had steps of dt, from which the length of the blocks of a fit was made."""
    np.testing.assert_array_equal(wrappers(timed(t=3 * T))[i].times_of(5), 3 * T)
    np.testing.assert_allclose(wrappers(timed())[i].times_of(5), 0.7 * T)


def test_a_fit_with_times_of_its_own_whose_first_epochs_are_missed_is_not_refused():
    """What the mobile moved before the first measurement is motion, not a start that is far."""
    t = np.concatenate([np.arange(3.0), 600.0 + np.arange(97.0)])
    _, z = mpt.simulate(mpt.constant_velocity(1.0, 0.5, 0.5), 600, np.random.default_rng(14))
    kept = np.concatenate([np.full((3, 1), np.nan), z[500:597]])
    found = mpt.fit(
        lambda q, r: mpt.KalmanFilter(mpt.constant_velocity(1.0, q, r, P0=1e4 * np.eye(2)), t=t), kept, q=1.0, r=1.0
    )
    assert 0.1 < found.values["q"] < 2.0


def test_separate_filters_with_times_step_by_dt():
    axis = start(mpt.constant_velocity)
    t = np.array([0.0, 0.5, 2.0])
    both, plane_kf = mpt.Separate(*[mpt.KalmanFilter(axis, t=t)] * 2), mpt.KalmanFilter(mpt.stack(axis, axis), t=t)
    z = np.array([[1.0, 2.0], [np.nan, 3.0], [0.0, 1.0]])
    np.testing.assert_allclose(both.filter(z), plane_kf.filter(z), rtol=1e-12)
    x, P = both.model.x0, both.P0
    for z_k, dt in zip(z, [0.7, 0.5, 1.5], strict=True):
        x, P = both.step(x, P, z_k, dt=dt)
    np.testing.assert_allclose(x, plane_kf.filter(z)[-1], rtol=1e-12)
    with pytest.raises(ValueError, match="x: needs a"):
        both.step(np.zeros(5), P, z[0], dt=1.0)


def test_a_model_keeps_its_times_where_F_and_Q_still_fit():
    model = plane()
    assert replace(model, x0=np.zeros(4), R=np.eye(2)).dt == 0.7
    assert model.with_noise_times(2.0).dt == 0.7
    assert mpt.exact_motion(model, np.zeros(4)).dt == 0.7
    assert replace(model, F=np.eye(4)).transition is None


@pytest.mark.parametrize("driven", [0, 1])
@pytest.mark.parametrize("seed", range(8))
def test_stable_models_with_modes_that_nothing_drives_have_a_steady_state(seed, driven):
    rng = np.random.default_rng(seed)
    n, m = rng.integers(1 + driven, 5), rng.integers(1, 3)
    V = rng.standard_normal((n, n))
    noise = V[:, :driven] @ rng.standard_normal((driven, driven))
    F = V @ np.diag(rng.uniform(-0.95, 0.95, n)) @ np.linalg.inv(V)
    model = mpt.LinearModel(F=F, H=rng.standard_normal((m, n)), Q=noise @ noise.T, R=np.eye(m), P0=np.eye(n))
    limit = mpt.KalmanFilter(model).coefficients(400)  # P comes near as 0.95^800, which is 1e-18
    six = mpt.six_filters(model)
    for name in ("SSKF", "SSLF"):
        # The modes are as well conditioned as V: rounding of 1e-16 times some thousands.
        np.testing.assert_allclose(six[name].P, limit.P[-1], rtol=1e-7, atol=1e-11)
        np.testing.assert_allclose(six[name].B, limit.B[-1], rtol=1e-7, atol=1e-11)


def make_axis(q, r):
    return mpt.constant_velocity(1.0, q, r, P0=np.eye(2))


def information(N, q, r):
    """The information of N measurements on log q and log r: 1/2 tr(C^-1 dC C^-1 dC), C their covariance."""

    def covariance(q, r):
        return gaussian_covariance(*matrices(make_axis(q, r)), N)

    C = covariance(q, r)
    relative = [np.linalg.solve(C, q * (covariance(q + 1, r) - C)), np.linalg.solve(C, r * (covariance(q, r + 1) - C))]
    return np.array([[np.trace(one @ other) / 2 for one in relative] for other in relative])


def test_the_errors_of_a_fit_are_those_that_the_exact_information_gives():
    """Of 200 simulated tracks, whose scores tell an error to 5 %, or 6 where q rests on the few slow innovations."""
    true = {"q": 0.04, "r": 0.5}
    z = mpt.simulate(make_axis(**true), 60, np.random.default_rng(9), 200)[1]
    found = mpt.fit(make_axis, z, q=0.1, r=1.0)
    assert found.log_likelihood == pytest.approx(metrics.log_likelihood(found.filter, z).sum(), rel=1e-12)
    exact = np.sqrt(np.diag(np.linalg.inv(200 * information(60, **true))))
    for error, (name, value) in zip(exact, true.items(), strict=True):
        assert found.log_errors[name] == pytest.approx(error, rel=0.18)  # three of these 5 to 6 %
        assert abs(np.log(found.values[name] / value)) < 4 * error


def test_a_fit_takes_times_and_gaps():
    rng = np.random.default_rng(10)
    t = np.cumsum(rng.choice([1.0, 2.0, 5.0], 400))
    grid = np.arange(t[-1] + 1)
    whole = np.full((len(grid), 1), np.nan)
    z = mpt.simulate(make_axis(0.04, 0.5), len(grid), rng)[1][t.astype(int)]
    whole[t.astype(int)] = z
    late = replace(make_axis(0.04, 0.5), P0=np.eye(2))
    by_time = mpt.fit(lambda q, r: mpt.KalmanFilter(replace(make_axis(q, r), P0=late.P0), t=t), z, q=1.0, r=1.0)
    by_grid = mpt.fit(make_axis, whole[int(t[0]) :], q=1.0, r=1.0)
    for name in "qr":
        assert by_time.values[name] == pytest.approx(by_grid.values[name], rel=1e-3)


@pytest.mark.filterwarnings("ignore:fit. row 0 of z is far off")  # said too, where it is
def test_a_far_start_is_told_even_if_the_noise_takes_it():
    """A variance of the measurements may grow until the start seems near: it stands out from the later ones."""
    z = mpt.simulate(make_axis(0.04, 0.5), 40, np.random.default_rng(11))[1] + 1000
    with pytest.warns(UserWarning, match="the first measurements are"):
        found = mpt.fit(make_axis, z, q=1.0, r=1.0)
    assert found.values["r"] > 100


def test_a_fit_of_measurements_that_never_change_knows_upper_limits_only():
    with pytest.warns(UserWarning, match="only an upper limit"):
        found = mpt.fit(make_axis, np.zeros((30, 1)), q=1.0, r=1.0)
    assert set(found.log_errors.values()) == {np.inf}


def test_what_runs_to_zero_leaves_the_errors_of_the_others():
    x, _ = mpt.simulate(make_axis(0.04, 0.5), 300, np.random.default_rng(15))
    with pytest.warns(UserWarning, match="r: the likelihood does not fall"):
        found = mpt.fit(make_axis, x[:, :1], q=1.0, r=1e3)
    assert found.log_errors["r"] == np.inf
    assert found.log_errors["q"] < 0.3  # three hundred steps tell a variance to some 8 %


def test_a_flat_direction_leaves_the_errors_of_the_others():
    z = mpt.simulate(make_axis(0.04, 0.5), 100, np.random.default_rng(11))[1]
    alone = mpt.fit(make_axis, z, q=1.0, r=1.0)  # says nothing: a warning is an error in these tests
    with pytest.warns(UserWarning, match="the likelihood is flat") as said:
        found = mpt.fit(lambda q, r, a: make_axis(q * a, r), z, q=0.3, r=1.0, a=2.0)
    assert sorted(str(each.message)[5] for each in said) == ["a", "q"]
    assert found.log_errors["r"] == pytest.approx(alone.log_errors["r"], rel=0.02)


def make_plane(q1, r1, q2, r2):
    return mpt.stack(make_axis(q1, r1), make_axis(q2, r2))


@pytest.mark.slow  # of two parameters test_fit sees the same
def test_a_fit_from_a_process_noise_far_too_small_finds_the_same():
    """There the noise of the measurements explains the motion, and q changes nothing: the search alone stays there."""
    z = mpt.simulate(make_plane(0.04, 0.5, 3.0, 20.0), 120, np.random.default_rng(3))[1]
    found = mpt.fit(make_plane, z, q1=0.1, r1=1.0, q2=1.0, r2=10.0)
    q, r = 1e-6, 1e4
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "fit: .* times its guess")  # which it is
        far = mpt.fit(make_plane, z, q1=q, r1=r, q2=q, r2=r)
    assert far.log_likelihood == pytest.approx(found.log_likelihood, abs=1e-3)
    assert far.values == pytest.approx(found.values, rel=1e-2)


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda z: mpt.fit(make_axis, z + 5e5, q=1.0, r=1.0), ValueError, "make: needs a model whose x0 and"),
        (lambda z: mpt.fit(make_axis, z, q=0.0, r=1.0), ValueError, "q: needs a positive number"),
        (lambda z: mpt.fit(make_axis, z), ValueError, "start: needs a first guess"),
        (lambda z: mpt.fit(make_axis, z[:2], q=1.0, r=1.0), ValueError, "z: needs more measurements than parameters"),
        (lambda z: mpt.fit(3, z, q=1.0), TypeError, "make: needs a function"),
        (lambda z: mpt.fit(lambda q: q, z, q=1.0), TypeError, "make: needs a Filter"),
    ],
)
def test_a_fit_refuses_by_name(call, error, words):
    z = mpt.simulate(make_axis(0.04, 0.5), 20, np.random.default_rng(12))[1]
    with pytest.raises(error, match=words):
        call(z)


def test_a_fit_is_the_maximum_of_the_joint_density():
    """The density of all measurements, dense, maximised by another search."""
    z = mpt.simulate(make_axis(0.04, 0.5), 30, np.random.default_rng(13))[1]
    z[7:10] = np.nan
    found = mpt.fit(make_axis, z, q=1.0, r=1.0)

    def surprise(logs):
        return -gaussian_log_density(*matrices(make_axis(*np.exp(logs))), z)

    best = minimize(surprise, [0.0, 0.0], method="Powell", options={"xtol": 1e-8, "ftol": 1e-12})
    assert found.log_likelihood == pytest.approx(-best.fun, abs=1e-6)
    # The search ends within 1e-4 in the logarithms, a hundredth of the error.
    np.testing.assert_allclose(np.log([found.values[name] for name in "qr"]), best.x, atol=2e-3)


def test_innovations_of_many_tracks_ask_for_as_many_times(monkeypatch):
    """However few are computed together."""
    monkeypatch.setattr(engine, "MOST_NUMBERS", 8)
    kf = timed(t=np.tile(np.arange(4.0)[:, None], 3))
    with pytest.raises(ValueError, match="t: needs the epochs and tracks of z"):
        metrics.innovations(kf, np.zeros((4, 2, 2)))


@pytest.mark.parametrize("gaps", [(0.1, 0.0), (0.1, 0.2)])
@pytest.mark.parametrize("tracks", [None, 3])
def test_a_state_that_is_known_exactly_stays_so(tracks, gaps):
    """The bias of the INS, and the position after one step: the rounding of zero was below it, and refused."""
    model = mpt.gps_ins(1.0, 0.1, (1.0, 0.1, 2.0))
    for R in (model.R, model.R + 0.05):
        correlated = replace(model, R=R)
        F, H, Q, R, x0, P0 = matrices(correlated)
        z = gappy(correlated, np.random.default_rng(22), 40, tracks, *gaps)
        both, smooth = mpt.KalmanFilter(correlated).estimates(z), mpt.KalmanFilter(correlated).smooth(z)
        assert not both.P[:, 2].any()
        for i in range(tracks or 1):
            one = (lambda array: array) if tracks is None else (lambda array, i=i: array[..., i])
            exact = gaussian_conditioning_of_steps([F] * 40, [Q] * 40, H, [R] * 40, x0, P0, one(z))
            np.testing.assert_allclose(one(both.x), exact.x, rtol=1e-8, atol=1e-9)
            np.testing.assert_allclose(one(both.P), exact.P, rtol=1e-8, atol=1e-9)
            np.testing.assert_allclose(one(smooth.P), exact.P_smooth, rtol=1e-7, atol=1e-8)


VAGUE_STARTS = {
    # Its P was 3 to 78 % wrong without a word, and never forgets.
    "no process noise": (mpt.constant_acceleration(dt=10.0, q=0.0, r=1e-4, P0=1e8 * np.eye(3)), None),
    # It was refused: 5.3 sigma wrong.
    "P0 = 1e16": (mpt.constant_velocity(dt=1.0, q=0.01, r=0.1, P0=1e16 * np.eye(2)), None),
    "variances of its own": (mpt.constant_acceleration(dt=10.0, q=0.0, r=1e4, P0=1e8 * np.eye(3)), 1e-4),
    "two axes": (mpt.stack(*[mpt.constant_velocity(dt=1.0, q=0.01, r=0.1, P0=1e14 * np.eye(2))] * 2), None),
}


@pytest.mark.parametrize(("rows", "gaps"), [(5, 0.0), (60, 0.3)])
@pytest.mark.parametrize(("model", "r"), VAGUE_STARTS.values(), ids=VAGUE_STARTS)
def test_a_vague_start_costs_few_digits(model, r, gaps, rows):
    """Against 60 digits; of many tracks with their own gaps, and of one that is cut into pieces."""
    rng = np.random.default_rng(5)
    z = rng.standard_normal((rows, model.m, 3))
    z[rng.random(z.shape) < gaps] = np.nan
    kf = mpt.KalmanFilter(model, r=None if r is None else np.full((rows, model.m), r))
    many = kf.estimates(z)
    for i in range(3):
        R = model.R if r is None else r * np.eye(model.m)
        x, _, _, P, *_ = precise.kalman(model.F, model.H, model.Q, R, model.x0, model.P0, z[..., i])
        x, P = x.astype(float), P.astype(float)
        sigma = np.sqrt(np.einsum("kii->ki", P))
        one = kf.estimates(z[..., i])
        for both in (one, Estimates(many.x[..., i], many.P[..., i])):
            # Steps of 10 s make the first prediction 1e17 times as uncertain as R: that costs all but three digits.
            assert (np.abs(both.x - x) < 1e-2 * sigma).all()
            assert (np.abs(both.P - P) < 1e-2 * sigma[:, :, None] * sigma[:, None]).all()


TOO_VAGUE = r"P0: needs a start that makes the first measurements less than 1e\+30 times as uncertain as their noise"


@pytest.mark.parametrize("power", [8, 12, 16, 26, 30])
@pytest.mark.parametrize("make", [mpt.gsm_axis, *MAKERS.values()])
@pytest.mark.parametrize("kind", [mpt.KalmanFilter, mpt.LainiotisFilter])
def test_a_vague_start_is_right_or_refused_by_name(kind, make, power):
    """Step by step, as `coefficients`, and as it runs; the Lainiotis filter was wrong by 1e8 sigma."""
    axis = make(1.0, 0.01, 0.1)
    model = replace(axis, P0=10.0**power * np.eye(axis.n))
    z = np.random.default_rng(5).standard_normal((6, 1))
    x, _, _, P, *_ = precise.kalman(model.F, model.H, model.Q, model.R, model.x0, model.P0, z)
    x, P = x.astype(float), P.astype(float)
    sigma = np.sqrt(np.einsum("kii->ki", P))

    def is_right(each, within):
        off_x = np.abs(each.x - x) / sigma
        off_P = np.abs(each.P - P) / sigma[:, :, None] / sigma[:, None]
        return off_x.max() < within and off_P.max() < within

    each = kind(model)
    if power < 28:
        assert is_right(each.estimates(z), 0.1)
    else:
        with pytest.raises(ValueError, match=TOO_VAGUE):
            each.estimates(z)
    if power <= 12:
        both = each.coefficients(6)
        assert is_right(Estimates(recursion(both.A, both.B, model.x0, z), both.P), 0.01)
    else:
        with pytest.raises(ValueError, match="P: needs a covariance that keeps digits beside the measurement noise"):
            each.coefficients(6)


def test_a_vague_start_is_compared_with_the_variances_that_are_used():
    """The model's R, 1e-32, would make P0 too vague; the variances of the measurements that are there replace it."""
    model = mpt.LinearModel(F=[[1]], H=[[1]], Q=[[0.0]], R=[[1e-32]], P0=[[1.0]])
    z, r = np.ones((5, 1)), np.ones((5, 1))
    exact = mpt.KalmanFilter(replace(model, R=np.eye(1))).estimates(z)
    np.testing.assert_allclose(mpt.KalmanFilter(model, r=r).estimates(z).P, exact.P, rtol=1e-12)
    z[2] = np.nan
    r[2] = 1e-32
    kf = mpt.KalmanFilter(model, r=r)
    exact = mpt.KalmanFilter(replace(model, R=np.eye(1))).estimates(z)
    np.testing.assert_allclose(kf.estimates(z).P, exact.P, rtol=1e-12)
    kf.smooth(z)
    z[2] = 1.0
    with pytest.raises(ValueError, match=TOO_VAGUE):
        kf.filter(z)
