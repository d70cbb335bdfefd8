"""Least-squares positioning, the line fit, its adaptive window, and GPS/INS: theorems and oracles."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from oracles import matrices, textbook_kalman

import mpt_helpers as mpt
from mpt_helpers import positioning, trials
from mpt_helpers.positioning import adaptive_line, line_fit, line_sigma

RIGA = positioning.place(56.95, 24.1)
# Ranges are some 2e7 m, so that a double holds them to 4e-9 m; a GDOP of 100, more than any sky here has, leaves 4e-7.
EXACT = 1e-6
# The same of a line fit over places of some 1e2 m and up to 200 points.
SAME = 1e-10


def far_from(X, distance, clock=0.0):
    return X + np.array([distance, 0, 0, clock])


@pytest.mark.parametrize("seed", range(100))
def test_position_is_exact_without_noise(seed):
    rng = np.random.default_rng(seed)
    satellites, X = trials.random_sky(rng)
    X[3] = rng.uniform(-1e6, 1e6)
    start = X + rng.uniform(-1, 1, 4) * [3e5, 3e5, 3e5, 1e6]
    fix = positioning.position(satellites, positioning.pseudoranges(satellites, X), start)
    np.testing.assert_allclose(fix, X, rtol=0, atol=EXACT)


@pytest.mark.parametrize("shift", [-1e6, 5e3, 1e5])
def test_clock_shift_moves_only_the_clock(shift):
    rng = np.random.default_rng(1)
    satellites, X = trials.random_sky(rng)
    ranges = positioning.pseudoranges(satellites, X) + rng.standard_normal(len(satellites))
    start = far_from(X, 3e5)
    fix, shifted = (positioning.position(satellites, each, start) for each in (ranges, ranges + shift))
    np.testing.assert_allclose(shifted - fix, [0, 0, 0, shift], rtol=0, atol=EXACT)


def test_linearised_is_the_derivative_of_the_pseudoranges():
    rng = np.random.default_rng(2)
    satellites, X = trials.random_sky(rng)
    step = 10.0  # m: both the rounding (4e-9 / 10) and the curvature (10 / 2e7)² are far below the tolerance
    columns = [
        (positioning.pseudoranges(satellites, X + e) - positioning.pseudoranges(satellites, X - e)) / (2 * step)
        for e in step * np.eye(4)
    ]
    np.testing.assert_allclose(positioning.linearised(satellites, X), np.transpose(columns), atol=1e-8)


def test_a_step_is_equation_7():
    rng = np.random.default_rng(3)
    satellites, X = trials.random_sky(rng)
    ranges = positioning.pseudoranges(satellites, X) + rng.standard_normal(len(satellites))
    X0 = far_from(X, 3e5, 5e3)
    H, residual = positioning.linearised(satellites, X0), ranges - positioning.pseudoranges(satellites, X0)
    after = positioning.position_steps(satellites, ranges, X0, steps=1)[1]
    np.testing.assert_allclose(after, X0 + np.linalg.inv(H.T @ H) @ H.T @ residual, atol=EXACT)


def test_the_iteration_ends_where_the_steps_do():
    rng = np.random.default_rng(4)
    satellites, X = trials.random_sky(rng)
    ranges = positioning.pseudoranges(satellites, X) + rng.standard_normal(len(satellites))
    start = far_from(X, 3e5, 5e3)
    last = positioning.position_steps(satellites, ranges, start, steps=12)[-1]
    np.testing.assert_allclose(positioning.position(satellites, ranges, start), last, atol=EXACT)


def test_the_constellation_is_the_nominal_one():
    satellites = positioning.constellation(0.0)
    assert satellites.shape == (24, 3)
    np.testing.assert_allclose(np.linalg.norm(satellites, axis=1), 26_560e3)
    over_a_day = np.array([positioning.constellation(t) for t in np.linspace(0, positioning.SIDEREAL_DAY, 500)])
    highest = np.abs(over_a_day[..., 2]).max(axis=0) / 26_560e3
    np.testing.assert_allclose(np.degrees(np.arcsin(highest)), 55, atol=0.1)  # 500 samples see the top to 0.02 degrees
    np.testing.assert_allclose(over_a_day[-1], satellites, atol=1e-3)  # the tracks on the ground repeat each day
    # In half a sidereal day a satellite goes round once and the Earth turns by half a turn.
    half = positioning.constellation(positioning.SIDEREAL_DAY / 2)
    np.testing.assert_allclose(half, satellites * [-1, -1, 1], atol=1e-3)


def test_the_planes_are_60_degrees_apart():
    day = np.array([positioning.constellation(t) for t in (0.0, 100.0)])
    inertial = [day[0], day[1] @ _turn(2 * np.pi * 100 / positioning.SIDEREAL_DAY).T]
    normals = np.cross(*inertial)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    np.testing.assert_allclose(np.degrees(np.arccos(normals[:, 2])), 55, atol=1e-6)
    nodes = np.degrees(np.arctan2(normals[::4, 0], -normals[::4, 1]))
    np.testing.assert_allclose(normals.reshape(6, 4, 3) - normals[::4, None], 0, atol=1e-9)
    np.testing.assert_allclose(np.diff(np.sort(nodes % 360)), 60, atol=1e-6)


def _turn(angle):
    return np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])


def test_a_sky_is_above_the_mask():
    satellites = positioning.sky(RIGA, 3600.0)
    everything = positioning.constellation(3600.0)
    high = positioning.elevation(everything, RIGA) > 10
    np.testing.assert_array_equal(satellites, everything[high])
    assert 0 < high.sum() < 24
    axes = positioning.local_axes(RIGA)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-15)
    away = (satellites - RIGA) @ axes.T
    elevation = np.degrees(np.arctan2(away[:, 2], np.hypot(away[:, 0], away[:, 1])))
    np.testing.assert_allclose(positioning.elevation(satellites, RIGA), elevation)


def test_dilution_is_the_standard_error_of_a_fix():
    rng = np.random.default_rng(5)
    satellites = positioning.sky(RIGA, 0.0)
    X = np.append(RIGA, 0.0)
    ranges = positioning.pseudoranges(satellites, X) + rng.standard_normal((4000, len(satellites)))
    errors = np.array([positioning.position(satellites, each, X) for each in ranges]) - X
    errors[:, :3] = errors[:, :3] @ positioning.local_axes(RIGA).T
    # The relative standard error of a standard deviation over 4,000 runs is 1.1 %; four of it.
    np.testing.assert_allclose(errors.std(axis=0), positioning.dilution(satellites, X), rtol=0.045)


def test_a_cone_of_satellites_is_a_degenerate_geometry():
    angle = np.linspace(0, 2 * np.pi, 6, endpoint=False)
    cone = np.column_stack([np.cos(angle), np.sin(angle), np.ones(6)])
    axes = positioning.local_axes(RIGA)
    satellites, X = RIGA + 2e7 * cone @ axes, np.append(RIGA, 0.0)
    ranges = positioning.pseudoranges(satellites, X)
    with pytest.raises(
        positioning.DegenerateGeometryError, match="satellites: needs a geometry that determines a position"
    ):
        positioning.position(satellites, ranges, X)
    with pytest.raises(ValueError, match=r"satellites: needs a geometry|start: needs a place from which"):
        positioning.position(satellites, ranges, far_from(X, 3e5))


def test_a_start_beyond_the_satellites_does_not_converge():
    satellites, X = positioning.sky(RIGA, 0.0), np.append(RIGA, 0.0)
    with pytest.raises(ValueError, match=r"satellites: needs a geometry|start: needs a place from which"):
        positioning.position(satellites, positioning.pseudoranges(satellites, X), far_from(X, 1e8))


def test_an_extended_kalman_filter_near_the_place_is_least_squares_over_all_epochs():
    rng = np.random.default_rng(6)
    satellites, X = positioning.sky(RIGA, 0.0), np.append(RIGA, 0.0)
    ranges = positioning.pseudoranges(satellites, X) + rng.standard_normal((5, len(satellites)))
    path = positioning.position_kalman(satellites, ranges, X, P0=1e6 * np.eye(4), Q=np.zeros((4, 4)), R=1.0)
    together = positioning.position(np.tile(satellites, (5, 1)), ranges.ravel(), X)
    # The prior of 1,000 m weighs DOP² / 1e6, some 5e-6 of errors of a few metres.
    np.testing.assert_allclose(path[-1], together, atol=1e-4)


def test_an_extended_kalman_filter_is_equation_11():
    rng = np.random.default_rng(7)
    satellites, X = positioning.sky(RIGA, 0.0), np.append(RIGA, 0.0)
    ranges = positioning.pseudoranges(satellites, X) + rng.standard_normal((6, len(satellites)))
    before, P_before, Q = far_from(X, 100.0), np.diag([1e4, 1e4, 1e4, 1e2]), np.diag([1.0, 2.0, 3.0, 4.0])
    path = positioning.position_kalman(satellites, ranges, before, P_before, Q, R=2.0)
    for measured, x in zip(ranges, path, strict=True):
        H = positioning.linearised(satellites, before)
        K = P_before @ H.T @ np.linalg.inv(H @ P_before @ H.T + 2 * np.eye(len(H)))
        before = before + K @ (measured - positioning.pseudoranges(satellites, before))
        P_before = (np.eye(4) - K @ H) @ P_before + Q
        np.testing.assert_allclose(x, before, atol=EXACT)


def test_an_iterated_kalman_filter_with_a_wide_start_is_least_squares():
    satellites, X = positioning.sky(RIGA, 0.0), np.append(RIGA, 0.0)
    ranges = positioning.pseudoranges(satellites, X) + np.random.default_rng(8).standard_normal((1, len(satellites)))
    before, P0 = far_from(X, 3e5, 5e3), np.diag([9e10, 9e10, 9e10, 2.5e7])
    once, iterated = (
        positioning.position_kalman(satellites, ranges, before, P0, np.zeros((4, 4)), 1.0, linearisations=count)[0]
        for count in (1, 5)
    )
    fix = positioning.position(satellites, ranges[0], before)
    assert np.linalg.norm((once - fix)[:3]) > 100
    np.testing.assert_allclose(iterated, fix, rtol=0, atol=0.01)  # the prior of the clock weighs DOP² / 2.5e7 of 5 km


@pytest.mark.parametrize("n", [2, 3, 5, 100, 200])
@pytest.mark.parametrize("dt", [0.1, 1.0, 7.0])
def test_line_fit_equals_polyfit(n, dt):
    x = 100 * np.random.default_rng(n).standard_normal((n, 4))
    slope, start = np.polyfit(np.arange(1, n + 1), x, 1)
    line = line_fit(x, dt)
    np.testing.assert_allclose(line.start, start, atol=SAME)
    np.testing.assert_allclose(line.velocity, slope / dt, atol=SAME / dt)
    one = line_fit(x[:, 0], dt)
    np.testing.assert_allclose([one.start, one.velocity], [line.start[0], line.velocity[0]], atol=SAME / dt)


@pytest.mark.parametrize("n", [2, 5, 100])
def test_line_sigma_is_the_covariance_of_the_fit(n):
    i = np.arange(1.0, n + 1)
    C = np.linalg.inv(np.array([[n, i.sum()], [i.sum(), i @ i]]))
    for point in (0, 1, (n + 1) / 2, n, n + 1):
        row = np.array([1, point])
        assert line_sigma(n, point) == pytest.approx(np.sqrt(row @ C @ row))
    assert line_sigma(n, (n + 1) / 2) == pytest.approx(1 / np.sqrt(n))


@pytest.mark.parametrize("seed", range(20))
def test_window_never_leaves_its_bounds(seed):
    rng = np.random.default_rng(seed)
    smallest = int(rng.integers(2, 6))
    largest = smallest + int(rng.integers(0, 60))
    fall = int(rng.integers(1, 80))
    z = 5 * rng.standard_normal((150, 1, 8)).cumsum(axis=0) + rng.standard_normal((150, 1, 8))
    tracked = adaptive_line(z, 1.0, rng.uniform(0.5, 20), smallest, largest, fall)
    assert tracked.n.min() == smallest
    assert tracked.n.max() <= largest
    change = np.diff(tracked.n, axis=0)
    assert change.max() <= 1
    assert change.min() >= -fall
    assert np.isnan(tracked.x[: smallest - 1]).all()
    assert np.isfinite(tracked.x[smallest - 1 :]).all()


def slow_window(z, dt, threshold, smallest, largest, fall, measured):
    """The adaptive window with numpy.polyfit, one step at a time."""
    n, x, windows = smallest, [], []
    for k in range(smallest, len(z) + 1):
        if x:
            off = abs(z[k - 1] - (z[k - 2] if measured else x[-1][0]) - x[-1][1] * dt) > threshold
            n = max(n - fall, smallest) if off else min(n + 1, largest)
        slope, start = np.polyfit(dt * np.arange(1, n + 1), z[k - n : k], 1)
        x.append((start + slope * n * dt, slope))
        windows.append(n)
    return np.array(x), windows


@pytest.mark.parametrize(("smallest", "largest", "fall"), [(2, 30, 100), (5, 100, 100), (3, 20, 4), (6, 6, 1)])
@pytest.mark.parametrize("last", [positioning.fitted_place, positioning.measured_place])
def test_adaptive_line_equals_polyfit_in_a_loop(smallest, largest, fall, last):
    rng = np.random.default_rng(8)
    z = np.concatenate([np.zeros(60), 3.0 * np.arange(60)]) + rng.standard_normal(120) + 1e4
    x, windows = slow_window(z, 0.5, 3.0, smallest, largest, fall, last is positioning.measured_place)
    tracked = adaptive_line(z[:, None], 0.5, 3.0, smallest, largest, fall, last)
    np.testing.assert_array_equal(tracked.n[smallest - 1 :], windows)
    np.testing.assert_allclose(tracked.x[smallest - 1 :], x, rtol=0, atol=1e-9)  # polyfit over places of 1e4 m
    assert len(set(windows)) > 1 or smallest == largest
    many = adaptive_line(np.repeat(z[:, None, None], 3, axis=2), 0.5, 3.0, smallest, largest, fall, last)
    np.testing.assert_array_equal(many.x[..., 2], tracked.x)


def test_an_infinite_threshold_grows_the_window_only():
    z = np.random.default_rng(9).standard_normal((30, 1))
    np.testing.assert_array_equal(
        adaptive_line(z, 1.0, np.inf, 2, 10).n, np.minimum(np.maximum(np.arange(1, 31), 2), 10)
    )


R = (1.0, 1e-4, 2.0)
GPS_INS = replace(mpt.gps_ins(0.5, 0.01, R), x0=[1.0, 2.0, 3.0], P0=np.diag([100.0, 1.0, 1.0]))


def observability(model):
    return np.vstack([model.H @ np.linalg.matrix_power(model.F, k) for k in range(model.n)])


def test_gps_ins_is_the_printed_model():
    np.testing.assert_array_equal(GPS_INS.F, [[1, 0.5, 0], [0, 1, 0], [0, 0, 1]])
    np.testing.assert_array_equal(GPS_INS.H, [[1, 0, 0], [0, 1, 1], [1, -0.5, 0]])
    np.testing.assert_array_equal(GPS_INS.Q, np.diag([0, 0.01, 0]))
    np.testing.assert_array_equal(GPS_INS.R, np.diag(R))
    assert mpt.gps_ins(0.5, 0.01, R[:2]) == trials.without_third_row(mpt.gps_ins(0.5, 0.01, R))


def test_gps_and_ins_observe_the_state_and_gps_alone_does_not_see_the_error_of_the_ins():
    F, H = GPS_INS.F, GPS_INS.H
    ranks = {
        rows: np.linalg.matrix_rank(observability(replace(GPS_INS, H=H[list(rows)], R=np.eye(len(rows)))))
        for rows in ((0, 1), (0, 1, 2), (0,), (0, 2), (1,), (1, 2))
    }
    assert ranks == {(0, 1): 3, (0, 1, 2): 3, (0,): 2, (0, 2): 2, (1,): 1, (1, 2): 3}
    np.testing.assert_array_equal(H[2] @ F, H[0])  # the third row sees where the mobile was one step before


def test_a_constant_error_of_the_ins_has_no_steady_state():
    with pytest.raises(ValueError, match="not stabilizable at the mode 1 of F"):
        mpt.SteadyStateFilter.from_kalman(GPS_INS)


def test_the_filter_of_equation_11_is_the_textbooks():
    _, z = mpt.simulate(GPS_INS, 40, np.random.default_rng(1))
    x, P = textbook_kalman(*matrices(GPS_INS), z)
    kf = mpt.KalmanFilter(GPS_INS)
    np.testing.assert_allclose(kf.filter(z), x, rtol=1e-9)
    np.testing.assert_allclose(kf.covariances(40), P, rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("velocity", [0.2, 0.02])
def test_without_process_noise_the_gps_ins_filter_is_the_growing_line_fit(velocity):
    _, z = trials.gps_ins_track(np.full(80, velocity), 0.5, (1.0, 0.01), 1.0, np.random.default_rng(2), 3)
    P0 = 1e6 * np.eye(3)
    x = mpt.KalmanFilter(replace(mpt.gps_ins(0.5, 0.0, (1.0, 1e-4)), P0=P0)).filter(z)
    line = adaptive_line(z[:, :1], 0.5, np.inf, 2, 80).x
    # A prior of variance 1e6 weighs 1e-6 of the first places; after ten it is some 1e-6 of errors of about 1.
    np.testing.assert_allclose(x[10:, :2], line[10:], atol=1e-4)
    count = np.arange(1, 81)[10:, None]
    np.testing.assert_allclose(x[10:, 2] + x[10:, 1], z[:, 1].cumsum(axis=0)[10:] / count, atol=1e-4)


def test_a_track_moves_as_the_model_says():
    velocity = np.array([1.0, 1.0, -2.0, -2.0])
    truth, z = trials.gps_ins_track(velocity, 0.5, (0.0, 0.0), 3.0, np.random.default_rng(3), 2)
    np.testing.assert_allclose(truth[1:, 0], truth[:-1, 0] + 0.5 * velocity[:-1])
    np.testing.assert_array_equal(z[:, 0, 1], truth[:, 0])
    np.testing.assert_array_equal(z[:, 1, 0], velocity + 3)


@pytest.mark.parametrize("phase", [0.0, 0.5, 0.9, 1.0])
def test_the_phase_says_when_within_the_step_the_velocity_changes(phase):
    velocity = np.array([1.0, 1.0, -2.0, -2.0])
    truth, _ = trials.gps_ins_track(velocity, 0.5, (0.0, 0.0), 0.0, np.random.default_rng(3), 1, phase=phase)
    steps = 0.5 * ((1 - phase) * velocity[:-1] + phase * velocity[1:])
    np.testing.assert_allclose(truth[:, 0], [0, *steps.cumsum()])
    np.testing.assert_array_equal(truth[:, 1], velocity)


def test_the_filters_own_estimate_as_third_measurement_has_no_innovation():
    """Against the textbook filter that is fed its own last estimate, step by step."""
    rng = np.random.default_rng(4)
    start = trials.third_row_start(GPS_INS)
    F, H, Q, noise, x, P = matrices(start)
    _, z = mpt.simulate(trials.without_third_row(start), 20, rng)
    path = []
    for z_k in z:
        last, x, P = x, F @ x, F @ P @ F.T + Q
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + noise)
        x, P = x + K @ (np.append(z_k, last[0]) - H @ x), (np.eye(3) - K @ H) @ P
        path.append(x)
    np.testing.assert_allclose(trials._own_estimate(mpt.KalmanFilter(start), z), path, rtol=1e-9)


@pytest.mark.parametrize("q", [0.01, 4.0])
def test_the_covariances_of_a_repeated_row_are_those_of_the_runs(q):
    model = replace(GPS_INS, Q=np.diag([0, q, 0]))
    runs = mpt.study(partial(trials.third_row_errors, model, 30), 4000, seed=1, workers=2)
    errors = dict(zip(trials.READINGS, runs, strict=True))
    # The relative standard error of a standard deviation over 4,000 runs is 1.1 %; four of it.
    for reading, rho in (("second receiver", 0.0), ("GPS again", 1.0)):
        P = trials.repeated_row_covariances(model, rho, 30)
        np.testing.assert_allclose(errors[reading].std(axis=2), np.sqrt(np.einsum("kii->ki", P)), rtol=0.045)


def test_a_second_receiver_without_process_noise_is_what_the_filter_assumes():
    model = replace(GPS_INS, Q=np.zeros((3, 3)))
    stated = mpt.KalmanFilter(trials.third_row_start(model)).covariances(30)
    np.testing.assert_allclose(trials.repeated_row_covariances(model, 0.0, 30), stated, rtol=1e-8, atol=1e-12)


def test_the_same_gps_place_again_carries_nothing_once_the_model_says_so():
    """With z_1(k-1) and its noise in the state, a filter of three rows is the filter of two."""
    two = trials.without_third_row(GPS_INS)
    _, z = mpt.simulate(two, 30, np.random.default_rng(5))
    again = np.vstack([[two.x0[0]], z[:-1, :1]])
    x = mpt.KalmanFilter(trials.with_last_gps(two)).filter(np.hstack([z, again]))
    # The tiny variances and the 1e-6 of information in the first place again leave some 1e-5 of errors of about 1.
    np.testing.assert_allclose(x[:, :3], mpt.KalmanFilter(two).filter(z), atol=1e-3)


def test_trackers_run_on_the_same_tracks():
    errors = trials.tracking_errors(
        [lambda z: z, lambda z: 2 * z], np.full(5, 0.2), 1.0, (1.0, 0.01), 1.0, np.random.default_rng(6), 3
    )
    truth, z = trials.gps_ins_track(np.full(5, 0.2), 1.0, (1.0, 0.01), 1.0, np.random.default_rng(6), 3)
    np.testing.assert_allclose(errors[1] - errors[0], z)
    np.testing.assert_allclose(errors[0], z - truth[..., None])


def test_the_start_of_the_third_row_is_one_step_later():
    x, _ = mpt.simulate(GPS_INS, 1, np.random.default_rng(10), tracks=100_000)
    begun = trials.third_row_start(GPS_INS)
    # The relative standard error of a variance over 100,000 tracks is 0.45 %; four of it.
    np.testing.assert_allclose(x[0].mean(axis=1), begun.x0, atol=4 * np.sqrt(begun.P0.max() / 100_000))
    np.testing.assert_allclose(np.cov(x[0]), begun.P0, atol=0.018 * begun.P0.max())


def test_a_tracker_of_gps_alone_does_not_see_the_ins():
    _, z = trials.gps_ins_track(np.full(20, 0.2), 1.0, (1.0, 0.01), 1.0, np.random.default_rng(11), 3)
    gps = mpt.constant_velocity(1.0, 0.01, 1.0)
    np.testing.assert_array_equal(trials.filter_tracker(gps)(z), mpt.KalmanFilter(gps).filter(z[:, :1]))
    line = adaptive_line(z[:, :1], 1.0, 4.0, 5, 10, 3).x
    np.testing.assert_array_equal(trials.line_tracker(1.0, 4.0, 5, 10, 3)(z), line)


def test_gps_ins_errors_are_those_from_the_truth():
    args = np.full(20, 0.2), 1.0, (1.0, 0.01), 3.0
    model = mpt.gps_ins(1.0, 0.01, (1.0, 1e-4))
    errors = trials.gps_ins_errors(model, *args, np.random.default_rng(12), 3)
    truth, z = trials.gps_ins_track(*args, np.random.default_rng(12), 3)
    x = mpt.KalmanFilter(model).filter(z)
    np.testing.assert_allclose(errors[:, :2], x[:, :2] - truth[..., None])
    np.testing.assert_allclose(errors[:, 2], x[:, 2] - 3)


def test_random_skies_are_of_all_places_and_times():
    rng = np.random.default_rng(13)
    drawn = [trials.random_sky(rng) for _ in range(500)]
    places = np.array([X[:3] for _, X in drawn]) / positioning.EARTH_RADIUS
    # A coordinate of a uniform direction has mean 0 and variance 1/3; four standard errors of 500.
    np.testing.assert_allclose(places.mean(axis=0), 0, atol=4 * np.sqrt(1 / 3 / 500))
    at_epoch = positioning.constellation(0.0)
    assert not any(np.isclose(satellites[:, None], at_epoch, atol=1.0).all(axis=2).any() for satellites, _ in drawn)


def test_the_first_step_of_a_rough_kalman_filter_is_that_of_least_squares():
    off, P0 = np.array([3e5, 0, 0, 5e3]), np.diag([9e10, 9e10, 9e10, 2.5e7])
    kalman = trials.rough_kalman_errors(off, P0, np.zeros((4, 4)), 1.0, 1, np.random.default_rng(14), 20)
    rough = trials.rough_errors(off, 1.0, 1, 24, np.random.default_rng(14), 20)
    assert rough[3].min() > 100
    np.testing.assert_allclose(kalman[0], rough[3], rtol=1e-4)  # the prior of the clock weighs DOP² / 2.5e7 of 5 km


def test_a_filter_from_a_fix_at_rest_is_least_squares_over_all_epochs():
    """Its errors fall with the square root of the epochs."""
    off = np.array([3e5, 0, 0, 5e3])
    errors = trials.fix_kalman_errors(off, np.zeros((4, 4)), 1.0, 16, np.random.default_rng(15), 400)
    ratio = np.sqrt(np.mean(errors[0] ** 2) / np.mean(errors[-1] ** 2))
    assert ratio == pytest.approx(4, rel=0.2)  # 400 runs of unequal skies: a standard error of some 5 %


def test_a_median_band_covers_the_median_as_often_as_it_says():
    _, low, high = trials.median_band(np.random.default_rng(16).exponential(size=(2000, 100)))
    assert 0.94 < np.mean((low <= np.log(2)) & (np.log(2) <= high)) < 0.985  # by whole runs it is somewhat wider


def test_line_errors_have_the_standard_error_of_the_closed_form():
    errors = mpt.study(partial(trials.line_errors, 20, 2.0, 3.0), 4000, seed=2)
    # The relative standard error of a standard deviation over 4,000 runs is 1.1 %; four of it.
    np.testing.assert_allclose(errors[:-1].std(axis=1), 3 * line_sigma(20, np.arange(22)), rtol=0.045)
    np.testing.assert_allclose(errors[-1].std(), 3 * np.sqrt(12 / (20 * 399)) / 2, rtol=0.045)


def test_rough_errors_are_those_of_the_iteration():
    offset = np.array([3e5, 0, 0, 5e3])
    runs = trials.rough_errors(offset, 0.0, 4, 24, np.random.default_rng(7), 20)
    assert (runs[0] > runs[1]).all()
    np.testing.assert_allclose(runs[2], 3e5)
    assert (np.diff(runs[2:5], axis=0) < 0).all()
    assert runs[6].max() < EXACT


def test_a_receiver_of_few_channels_takes_so_many_satellites():
    rng = np.random.default_rng(8)
    assert {len(trials.random_sky(rng, 4)[0]) for _ in range(20)} == {4}


def test_rms_band_covers_the_truth_as_often_as_it_says():
    rng = np.random.default_rng(9)
    bands = [trials.rms_band(2 * rng.standard_normal((10, 200))) for _ in range(1000)]
    share = np.mean([low <= 2 <= high for _, low, high in bands])
    assert abs(share - 0.95) < 0.03  # the share of 1,000 has a standard error of 0.7 %
