"""The gate: which fixes are faults, on simulated tracks, random models, and recorded tracks with faults put in."""

import gzip
import io
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from conftest import ROOT, dense_model

import mpt_helpers as mpt
from mpt_helpers.tracks import cleaning, gate


def model(q=0.04, r=4.0, dt=1.0):
    axis = mpt.constant_velocity(dt=dt, q=q, r=r, P0=np.diag([100.0, 100.0]))
    return mpt.stack(axis, axis)


@pytest.fixture
def track():
    """A track of 400 fixes and its filter."""
    _, z = mpt.simulate(model(), 400, np.random.default_rng(3))
    return mpt.KalmanFilter(model()), z


def test_a_clean_track_is_one_segment(track):
    kf, z = track
    np.testing.assert_array_equal(mpt.gated(kf, z), 0)


def test_single_outliers_are_refused_and_nothing_else(track):
    kf, z = track
    rows = [0, 50, 51, 120, 399]
    z[rows] += 300.0
    number = mpt.gated(kf, z)
    np.testing.assert_array_equal(np.flatnonzero(number == -1), rows)
    assert number.max() == 0


def test_a_jump_that_stays_begins_a_segment_at_its_first_fix(track):
    kf, z = track
    z[200:] += 500.0
    np.testing.assert_array_equal(mpt.gated(kf, z), np.repeat([0, 1], 200))


def test_a_jump_whose_first_fix_is_an_outlier_begins_a_segment_without_it(track):
    kf, z = track
    z[200:] += 500.0
    z[200] -= 90.0
    number = mpt.gated(kf, z)
    np.testing.assert_array_equal(number, [0] * 200 + [-1] + [1] * 199)


def test_a_burst_that_agrees_with_itself_is_dropped_and_the_track_goes_on(track):
    kf, z = track
    z[200:208] += 500.0
    np.testing.assert_array_equal(mpt.gated(kf, z), [0] * 200 + [-1] * 8 + [0] * 192)


def test_a_receiver_that_stood_still_and_caught_up_is_refused_where_it_stood(track):
    _, z = track
    z[:, 0] += 10.0 * np.arange(400)
    z[200:230] = z[200] + np.random.default_rng(0).normal(0, 0.5, (30, 2))
    number = mpt.gated(mpt.KalmanFilter(model()), z)
    assert set(range(201, 230)) <= set(np.flatnonzero(number == -1)) <= set(range(195, 230))
    assert number.max() == 0


def test_the_example_of_a_receiver_that_stood_still():
    """The fixes of 30 m, at 30 to 33 s, in the middle of a track that moves 1 m a second."""
    z, times = np.arange(80.0)[:, None], np.arange(80.0)
    z[30:34] = 30.0
    moves = gate._Moves([list(range(80))], z, times, np.zeros(80, dtype=int))
    (left,) = gate._without_stuck_fixes([list(range(80))], moves)
    assert left == [*range(30), *range(34, 80)]


@pytest.mark.parametrize(("rest", "braking"), [(15, 40), (150, 1)])
def test_a_rest_before_a_jump_is_not_taken_for_a_receiver_without_signal(rest, braking):
    """It had slowed down before; or it came far faster than it would have gone on."""
    z = np.random.default_rng(0).normal(0, 0.5, (400, 2))
    speed = np.concatenate(
        [np.full(110 - braking, 4.0), np.linspace(4, 0, braking), np.zeros(rest), np.full(290 - rest, 4.0)]
    )
    z[:, 0] += np.cumsum(speed)
    z[110 + rest :] += [0.0, 120.0]
    number = mpt.gated(mpt.KalmanFilter(model(r=0.25)), z)
    assert number.max() == 1
    assert (number == -1).sum() <= 1


def test_a_u_turn_is_not_cut_and_not_refused():
    """At 10 m/s and back within a second: far beyond the limit, but no faster than the track usually is."""
    z = np.zeros((400, 2))
    z[:, 0] = 10 * np.concatenate([np.arange(200), np.arange(200, 0, -1)])
    kf = mpt.KalmanFilter(model(q=1e-4, r=0.01))
    assert mpt.metrics.nis(kf, z).max() > 1000
    np.testing.assert_array_equal(mpt.gated(kf, z), 0)


def test_patience_and_limit_do_what_they_say(track):
    kf, z = track
    z[200:] += 500.0
    assert (mpt.gated(kf, z[:240], patience=50)[200:] == -1).any()
    assert (mpt.gated(kf, z, limit=1e9) == 0).all()
    assert (mpt.gated(kf, z, limit=1.5) == -1).sum() > 20


def test_a_row_without_measurements_is_no_fix(track):
    kf, z = track
    z[10:13] = np.nan
    number = mpt.gated(kf, z)
    np.testing.assert_array_equal(np.flatnonzero(number == -1), [10, 11, 12])


def stable_model(seed):
    """Matrices without zeros, correlated noises, and no state that grows without end."""
    made = dense_model(seed)
    return replace(made, F=made.F * 0.9 / np.abs(np.linalg.eigvals(made.F)).max())


@pytest.mark.parametrize("seed", range(12))
def test_each_step_has_the_nis_of_the_engine_for_any_model_times_variances_correlations_and_partial_rows(seed):
    rng = np.random.default_rng(seed)
    kind, N = seed % 4, 120
    if kind == 0:
        kf = mpt.KalmanFilter(stable_model(seed))
    elif kind == 1:
        kf = mpt.LainiotisFilter(stable_model(seed))
    else:
        t = np.cumsum(rng.choice([0.5, 1, 2, 7, 1e6], N, p=[0.3, 0.3, 0.2, 0.18, 0.02]))
        r = rng.uniform(1, 9, (N, 2)) if kind == 2 else rng.uniform(1, 9, (N, 1)) * np.ones(2)
        kf = mpt.KalmanFilter(model(), t=t, r=r)
    _, z = mpt.simulate(kf.model, N, rng)
    if kind < 3:
        z[rng.random(z.shape) < 0.2] = np.nan
    refused = rng.random(N) < 0.2
    row_filter = gate._RowFilter(kf, z)
    state, found = gate._state(kf.model.x0, kf.model.P0), np.full(N, np.nan)
    for k in range(N):
        without_fix, with_fix, nis, _ = row_filter.after(state, k)
        used = row_filter.fixes[k] and not refused[k]
        state = with_fix if used else without_fix
        found[k] = nis if used else np.nan
    masked = np.where(refused[:, None], np.nan, z)
    np.testing.assert_allclose(found, mpt.metrics.nis(kf, masked), rtol=1e-6)
    assert np.isfinite(found).sum() > 60


@pytest.mark.parametrize("make", [mpt.gsm_axis, mpt.constant_acceleration])
def test_a_vague_start_refuses_no_good_fix(make):
    """P - K H P loses all digits at 3e16 R, and some time before."""
    axis = make(dt=1.0, q=0.04, r=4.0)
    _, z = mpt.simulate(axis, 60, np.random.default_rng(3))
    z[40] += 300.0
    for size in (1e8, 1e15, 3e16, 1e20, 1e24):
        kf = mpt.KalmanFilter(replace(axis, P0=4.0 * size * np.eye(axis.n)))
        np.testing.assert_array_equal(np.flatnonzero(mpt.gated(kf, z) == -1), [40])


def forgetful(dt, tau=20.0, q=0.04):
    """A velocity that is forgotten within tau seconds; Q loses its digits over steps below 1e-4 s."""
    a, b = np.exp(-dt / tau), -np.expm1(-dt / tau)
    Q_sv = tau**2 * b**2 / 2
    Q = [[tau**2 * (dt - tau * (b + b**2 / 2)), Q_sv], [Q_sv, tau * b * (1 + a) / 2]]
    return np.array([[1, tau * b], [0, a]]), q * np.array(Q)


@pytest.mark.parametrize(
    "made", [model(), mpt.LinearModel(transition=forgetful, dt=1.0, H=[[1, 0]], R=[[0.5]], P0=np.eye(2))]
)
def test_fixes_of_one_time_are_no_faults(made):
    """Also with a transition that has no digits for steps near zero."""
    t = np.arange(700.0)
    t[496:500] = t[496]
    _, z = mpt.simulate(mpt.constant_velocity(dt=1.0, q=0.04, r=0.5), 700, np.random.default_rng(3))
    z = z * np.ones(made.m)
    z[496:500] = z[496]
    z[300] += 500.0
    number = mpt.gated(mpt.KalmanFilter(made, t=t), z)
    np.testing.assert_array_equal(np.flatnonzero(number == -1), [300])


@pytest.mark.parametrize(
    ("kf", "z", "given", "said"),
    [
        (
            mpt.SteadyStateFilter.from_kalman(model()),
            np.zeros((9, 2)),
            {},
            "kf: needs a KalmanFilter.*SteadyStateFilter",
        ),
        (mpt.JoinFilter, np.zeros((9, 2)), {}, "kf: needs a KalmanFilter"),
        (mpt.KalmanFilter(model()), np.zeros((9, 2, 3)), {}, "z: needs one track"),
        (mpt.KalmanFilter(model()), np.zeros((9, 3)), {}, "z: needs"),
        (mpt.KalmanFilter(model()), np.full((9, 2), np.inf), {}, "z: needs finite numbers"),
        (
            mpt.KalmanFilter(model()),
            np.zeros((9, 2)),
            {"limit": 0.99},
            "limit: needs a squared distance in variances, above 1, as 100, got 0.99",
        ),
        (mpt.KalmanFilter(model()), np.zeros((9, 2)), {"patience": 0}, "patience: needs an integer of at least 1"),
        (
            mpt.KalmanFilter(model(), t=np.arange(8.0)),
            np.zeros((9, 2)),
            {},
            r"t: needs the epochs and tracks of z, \(9,\)",
        ),
        (
            mpt.KalmanFilter(model(), r=np.ones((8, 2))),
            np.zeros((9, 2)),
            {},
            r"r: needs the epochs and tracks of z, \(9, 2\)",
        ),
        (mpt.KalmanFilter(model(), r=np.zeros((9, 2))), np.zeros((9, 2)), {}, "r: needs a positive variance"),
    ],
)
def test_what_has_no_gate_is_refused_by_name(kf, z, given, said):
    with pytest.raises((ValueError, TypeError), match=said):
        mpt.gated(kf, z, **given)


def test_nothing_to_see_is_no_segment():
    np.testing.assert_array_equal(mpt.gated(mpt.KalmanFilter(model()), np.full((5, 2), np.nan)), -1)


# Recorded tracks. The numbers of the rule were chosen on rides, a paraglider and walks. The watch of a runner and the
# logger of a glider were not looked at for any of them, a phone on a hike for two, ARRIVED and WENT_ON. The run and
# the ride in a town, both of phones, were run when all rules were there, and nothing was changed after. The sailing
# boat, and the hike with a fix every 11 s, had been run before `grid_of` and the limits of smooth motion were made.
HELD_BACK = {
    "run_fenix2_1hz": slice(None),
    "hike_gpxo_2s": slice(2500),
    "glider_nz_3s": slice(2500),
    "run_stoplight_1hz": slice(None),
    "phone_ride_stoplight_1s": slice(None),
    "boat_plaka_2s": slice(1500),
    "hike_korita_11s": slice(None),
}


def recorded(name):
    with gzip.open(ROOT / "tests" / "tracks" / f"{name}.csv.gz") as file:
        t, lat, lon = np.loadtxt(io.TextIOWrapper(file), delimiter=",", skiprows=1).T
    t, lat, lon = t[HELD_BACK[name]], lat[HELD_BACK[name]], lon[HELD_BACK[name]]
    grid = 111e3 * max(cleaning.grid_of(each, mpt.tracks.GRIDS) for each in (lat, lon))
    return t, mpt.tracks.local(lat, lon), grid**2 / 12


@cache
def cleaned(name):
    t, z, rounding = recorded(name)
    return mpt.tracks.clean(t, z, rounding=rounding)


def some(rng, count, first, last, apart):
    """Draw rows that are apart, as many as there is room for."""
    room = np.arange(first, last, apart)
    return rng.choice(room, min(count, len(room)), replace=False)


def singles(t, z, rng):
    rows = np.sort(some(rng, 30, 50, len(z) - 50, 45))
    angle, far = rng.uniform(0, 2 * np.pi, len(rows)), 10 ** rng.uniform(np.log10(20), 4, len(rows))
    z[rows] += np.column_stack([np.cos(angle), np.sin(angle)]) * far[:, None]
    return rows, 0.0


def bursts(t, z, rng):
    rows = []
    for begin in some(rng, 5, 50, len(z) - 90, 90):
        own = np.flatnonzero((t >= t[begin]) & (t < t[begin] + 10))
        z[own] += rng.standard_normal((len(own), 2)) * 10 ** rng.uniform(1.5, 2.5)
        rows += own.tolist()
    return np.array(rows), 0.0


def stuck(t, z, rng):
    rows = []
    for begin in some(rng, 5, 50, len(z) - 90, 90):
        own = np.flatnonzero((t > t[begin]) & (t < t[begin] + 30))
        z[own] = z[begin]
        rows += own.tolist()
    return np.array(rows), 0.0


def shift(t, z, rng):
    moved = np.zeros_like(z)
    moved[len(z) // 2 :] = 200.0 * np.array([0.6, 0.8])
    z += moved
    return np.empty(0, int), moved


# rms distance (m) from the smoothed clean track, at most: two to three times what came out. A glider at 30 m/s moves
# further between two fixes than the faults of a few are off.
AT_MOST = {
    "run_fenix2_1hz": {singles: 0.05, bursts: 0.6, stuck: 5.0, shift: 0.01},
    "hike_gpxo_2s": {singles: 0.1, bursts: 0.15, stuck: 1.5, shift: 0.1},
    "glider_nz_3s": {singles: 4.0, bursts: 15.0, stuck: 50.0, shift: 0.03},
    "run_stoplight_1hz": {singles: 0.1, bursts: 0.6, stuck: 5.0, shift: 0.02},
    "phone_ride_stoplight_1s": {singles: 0.8, bursts: 8.0, stuck: 50.0, shift: 0.05},
    "boat_plaka_2s": {singles: 0.1, bursts: 0.1, stuck: 0.5, shift: 0.02},
    "hike_korita_11s": {singles: 0.6, bursts: 0.5, stuck: 2.0, shift: 0.4},
}


# Each fault on a short recording; `make slow` runs all on all.
FEW = [
    ("hike_korita_11s", stuck),
    ("hike_korita_11s", shift),
    ("phone_ride_stoplight_1s", bursts),
    ("hike_korita_11s", singles),
]
CASES = [
    pytest.param(name, fault, id=f"{name}-{fault.__name__}", marks=[] if (name, fault) in FEW else pytest.mark.slow)
    for name in HELD_BACK
    for fault in (singles, bursts, stuck, shift)
]


@pytest.mark.parametrize(("name", "fault"), CASES)
def test_recorded_tracks_with_faults_are_smoothed_as_without(name, fault):
    t, z, rounding = recorded(name)
    clean = cleaned(name)
    spoilt = z.copy()
    rows, moved = fault(t, spoilt, np.random.default_rng(7))
    c = mpt.tracks.clean(t, spoilt, rounding=rounding)
    error = np.linalg.norm(c.x[:, ::2] - moved - clean.x[:, ::2], axis=1)
    assert mpt.metrics.rms(error[np.isfinite(error)]) < AT_MOST[name][fault]
    good = np.setdiff1d(c.refused, np.concatenate([rows, clean.refused]))
    assert len(good) < (0.01 + 0.01 * (fault is stuck)) * len(t)  # a fix or two beside each stay is as far off
    assert len(c.starts) <= len(clean.starts) + (fault is shift)
    assert abs(c.band.held - 0.95) < 0.02


def thinned(t, z, seed):
    """A fix every 4 to 13 s."""
    rng, rows = np.random.default_rng(seed), [0]
    while (row := int(np.searchsorted(t, t[rows[-1]] + rng.uniform(4, 13)))) < len(t):
        rows.append(row)
    return t[rows], z[rows]


def test_on_sparse_tracks_half_of_the_outliers_of_20_to_40_metres_are_caught_and_no_good_fix_is_lost():
    """Rides at 7 m/s, where a fix without its own measurement is known to 5 m: see the guide for the rest."""
    ride = mpt.tracks.gpx(ROOT / "docs" / "tracks" / "ride.gpx")[0]
    caught = []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        t, z = thinned(ride.t, ride.z, seed)
        spoilt = z.copy()
        rows = rng.choice(np.arange(5, len(z) - 5, 20), 8, replace=False)
        angle = rng.uniform(0, 2 * np.pi, 8)
        spoilt[rows] += rng.uniform(20, 40, 8)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        assert len(mpt.tracks.clean(t, z, rounding=1e-5).refused) <= 0.004 * len(t)
        refused = mpt.tracks.clean(t, spoilt, rounding=1e-5).refused
        assert len(np.setdiff1d(refused, rows)) <= 0.004 * len(t)
        caught += np.isin(rows, refused).tolist()
    assert np.mean(caught) >= 0.5  # by one limit for all of them below 0.4


@pytest.mark.parametrize("count", [1, 2, 9, 40])
def test_limits_follow_the_fixes_around(count):
    assert (cleaning._limits(np.full(count, 100.0)) == cleaning.SMOOTHER_LIMIT).all()
    assert (cleaning._limits(np.full(count, 0.1)) == cleaning.LEAST_LIMIT).all()
    np.testing.assert_allclose(cleaning._limits(np.full(count, 1.0)), 60 / 1.39)


def test_a_start_far_from_the_first_fixes_is_told(track):
    kf, z = track
    with pytest.warns(UserWarning, match=r"gated: the first fixes are \d+ standard deviations from x0: say where"):
        number = mpt.gated(kf, z + 5000.0)
    assert (number >= 0).sum() > 390


def test_a_fix_without_one_axis_is_judged_by_the_other():
    """The axes of `clean` share a covariance: a coordinate that is missing says nothing, and is no fault."""
    axis = mpt.constant_velocity(dt=1.0, q=0.04, r=4.0)
    _, z = mpt.simulate(mpt.stack(axis, axis), 300, np.random.default_rng(2))
    z += 500.0
    z[np.random.default_rng(3).random(z.shape) < 0.1] = np.nan
    z[50] += 300.0, 0.0
    assert np.isnan(z[0]).any()  # the track begins with such a fix
    c = mpt.tracks.clean(np.arange(300.0), z)
    assert c.refused.tolist() == [0, 50]  # before the first whole fix it is not known where the track is
    assert np.isfinite(c.x[1:]).all()


@pytest.mark.parametrize(("speed", "lost"), [(8.0, 60), (1.4, 120)])
def test_good_fixes_on_the_way_to_where_a_receiver_stands_still_are_kept(speed, lost):
    """Those within a tenth of the step that follows, too."""
    rng = np.random.default_rng(5)
    t = np.arange(600.0)
    z = np.column_stack([speed * t, 0.2 * speed * t]) + 0.02 * rng.standard_normal((600, 2))
    z[300 : 300 + lost] = z[300]
    np.testing.assert_array_equal(mpt.tracks.clean(t, z).refused, np.arange(300, 300 + lost))


def test_a_start_however_vague_is_none_or_refused_by_name():
    """At 1e24 it left the engine as numpy's own "Singular matrix"."""
    rng = np.random.default_rng(400)
    axis = mpt.constant_velocity(dt=1.0, q=0.1, r=1.0)
    _, z = mpt.simulate(mpt.stack(axis, axis), 120, rng)
    z[rng.random(120) < 0.05] += 1e3 * rng.standard_normal(2)
    z[rng.random((120, 2)) < 0.2] = np.nan

    def gated_from(variance):
        vague = mpt.constant_velocity(dt=1.0, q=0.1, r=1.0, P0=variance * np.eye(2))
        return mpt.gated(mpt.KalmanFilter(mpt.stack(vague, vague)), z)

    np.testing.assert_array_equal(gated_from(1e24), gated_from(1e8))
    with pytest.raises(ValueError, match="P0: needs a start that makes the first measurements"):
        gated_from(1e32)


def test_times_of_one_column_are_times():
    t = np.arange(50.0)
    z = t[:, None] + np.where(t == 20, 500.0, 0.0)[:, None]
    model = mpt.constant_velocity(1.0, 0.1, 0.1, P0=100 * np.eye(2))
    by_column = mpt.gated(mpt.KalmanFilter(model, t=t[:, None]), z)
    np.testing.assert_array_equal(by_column, mpt.gated(mpt.KalmanFilter(model, t=t), z))
    assert by_column[20] == -1
