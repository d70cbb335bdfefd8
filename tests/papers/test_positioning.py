"""Least-squares positioning, the line fit, its adaptive window, and GPS/INS: theorems and oracles."""

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from oracles import matrices, textbook_kalman

import mpt_helpers as mpt
from reproduction.paper_2007 import experiments as runs
from reproduction.paper_2007 import positioning
from reproduction.paper_2007.positioning import adaptive_line, line_fit, line_sigma

RIGA = positioning.place(56.95, 24.1)
# Ranges are some 2e7 m, so that a double holds them to 4e-9 m; a GDOP of 100, more than any sky here has, leaves 4e-7.
EXACT = 1e-6
# The same of a line fit over places of some 1e2 m and up to 200 points.
SAME = 1e-10


def far_from(X, distance, clock=0.0):
    return X + np.array([distance, 0, 0, clock])


@pytest.mark.parametrize("seed", range(8))
def test_position_is_exact_without_noise(seed):
    rng = np.random.default_rng(seed)
    satellites, X = runs.random_sky(rng)
    X[3] = rng.uniform(-1e6, 1e6)
    start = X + rng.uniform(-1, 1, 4) * [3e5, 3e5, 3e5, 1e6]
    fix = positioning.position(satellites, positioning.pseudoranges(satellites, X), start)
    np.testing.assert_allclose(fix.X, X, rtol=0, atol=EXACT)
    np.testing.assert_allclose(fix.residuals, 0, atol=EXACT)


@pytest.mark.parametrize("shift", [-1e6, 5e3, 1e5])
def test_clock_shift_moves_only_the_clock(shift):
    rng = np.random.default_rng(1)
    satellites, X = runs.random_sky(rng)
    ranges = positioning.pseudoranges(satellites, X) + rng.standard_normal(len(satellites))
    start = far_from(X, 3e5)
    fix, shifted = (positioning.position(satellites, each, start).X for each in (ranges, ranges + shift))
    np.testing.assert_allclose(shifted - fix, [0, 0, 0, shift], rtol=0, atol=EXACT)


def test_linearised_is_the_derivative_of_the_pseudoranges():
    rng = np.random.default_rng(2)
    satellites, X = runs.random_sky(rng)
    step = 10.0  # m: both the rounding (4e-9 / 10) and the curvature (10 / 2e7)² are far below the tolerance
    columns = [
        (positioning.pseudoranges(satellites, X + e) - positioning.pseudoranges(satellites, X - e)) / (2 * step)
        for e in step * np.eye(4)
    ]
    np.testing.assert_allclose(positioning.linearised(satellites, X), np.transpose(columns), atol=1e-8)


def test_a_step_is_equation_7():
    rng = np.random.default_rng(3)
    satellites, X = runs.random_sky(rng)
    ranges = positioning.pseudoranges(satellites, X) + rng.standard_normal(len(satellites))
    X0 = far_from(X, 3e5, 5e3)
    H, residual = positioning.linearised(satellites, X0), ranges - positioning.pseudoranges(satellites, X0)
    after = positioning.position_steps(satellites, ranges, X0, steps=1)[1]
    np.testing.assert_allclose(after, X0 + np.linalg.inv(H.T @ H) @ H.T @ residual, atol=EXACT)


def test_the_iteration_ends_where_the_steps_do():
    rng = np.random.default_rng(4)
    satellites, X = runs.random_sky(rng)
    ranges = positioning.pseudoranges(satellites, X) + rng.standard_normal(len(satellites))
    start = far_from(X, 3e5, 5e3)
    last = positioning.position_steps(satellites, ranges, start, steps=12)[-1]
    np.testing.assert_allclose(positioning.position(satellites, ranges, start).X, last, atol=EXACT)


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


def test_a_cone_of_satellites_is_a_degenerate_geometry():
    angle = np.linspace(0, 2 * np.pi, 6, endpoint=False)
    cone = np.column_stack([np.cos(angle), np.sin(angle), np.ones(6)])
    axes = positioning.local_axes(RIGA)
    satellites, X = RIGA + 2e7 * cone @ axes, np.append(RIGA, 0.0)
    ranges = positioning.pseudoranges(satellites, X)
    with pytest.raises(ValueError, match="satellites: needs a geometry that determines a position"):
        positioning.position(satellites, ranges, X)
    with pytest.raises(ValueError, match=r"satellites: needs a geometry|start: needs a position from which"):
        positioning.position(satellites, ranges, far_from(X, 3e5))


def test_a_start_beyond_the_satellites_does_not_converge():
    satellites, X = positioning.sky(RIGA, 0.0), np.append(RIGA, 0.0)
    with pytest.raises(ValueError, match=r"satellites: needs a geometry|start: needs a position from which"):
        positioning.position(satellites, positioning.pseudoranges(satellites, X), far_from(X, 1e8))


def test_an_extended_kalman_filter_near_the_place_is_least_squares_over_all_epochs():
    rng = np.random.default_rng(6)
    satellites, X = positioning.sky(RIGA, 0.0), np.append(RIGA, 0.0)
    ranges = positioning.pseudoranges(satellites, X) + rng.standard_normal((5, len(satellites)))
    track = positioning.position_kalman(satellites, ranges, X, 1e6 * np.eye(4), np.zeros((4, 4)), 1.0)
    together = positioning.position(np.tile(satellites, (5, 1)), ranges.ravel(), X)
    # The prior of 1,000 m weighs DOP² / 1e6, some 5e-6 of errors of a few metres.
    np.testing.assert_allclose(track.X[-1], together.X, atol=1e-4)
    np.testing.assert_allclose(track.P[-1], together.P, atol=1e-4)


def changing_epochs(rng, N=6):
    """Satellites that move and are not all seen, ranges with a variance of their own each, and the true state."""
    X = np.append(RIGA, 30.0)
    satellites = np.array([positioning.constellation(600.0 * k) for k in range(N)])
    variance = rng.uniform(0.5, 4, (N, 24))
    ranges = np.array([positioning.pseudoranges(each, X) for each in satellites])
    ranges += np.sqrt(variance) * rng.standard_normal(ranges.shape)
    high = np.array([positioning.elevation(each, RIGA) for each in satellites]) > 10
    return satellites, np.where(high & (rng.uniform(size=high.shape) < 0.8), ranges, np.nan), variance, X


def test_an_extended_kalman_filter_is_equation_11_over_the_satellites_that_are_seen():
    satellites, ranges, variance, X = changing_epochs(np.random.default_rng(7))
    ranges[3] = np.nan  # an epoch without any
    assert len({tuple(row) for row in np.isnan(ranges)}) > 3
    x, P, Q = far_from(X, 100.0), np.diag([1e4, 1e4, 1e4, 1e2]), np.diag([1.0, 2.0, 3.0, 4.0])
    track = positioning.position_kalman(satellites, ranges, x, P, Q, variance)
    for k, seen in enumerate(~np.isnan(ranges)):
        P = P + Q
        H = positioning.linearised(satellites[k, seen], x)
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.diag(variance[k, seen]))
        x = x + K @ (ranges[k, seen] - positioning.pseudoranges(satellites[k, seen], x))
        P = (np.eye(4) - K @ H) @ P
        np.testing.assert_allclose(track.X[k], x, atol=EXACT)
        np.testing.assert_allclose(track.P[k], P, rtol=1e-6, atol=1e-9)


def test_the_innovations_of_an_extended_kalman_filter_are_those_of_equation_11():
    satellites, ranges, variance, X = changing_epochs(np.random.default_rng(7))
    P0, Q = np.diag([1e4, 1e4, 1e4, 1e2]), np.diag([1.0, 2.0, 3.0, 4.0])
    track = positioning.position_kalman(satellites, ranges, far_from(X, 100.0), P0, Q, variance)
    seen = ~np.isnan(ranges)
    np.testing.assert_array_equal(np.isnan(track.innovations), ~seen)
    np.testing.assert_array_equal(np.isnan(track.S), ~(seen[:, :, None] & seen[:, None]))
    x, P = far_from(X, 100.0), P0
    for k, now in enumerate(seen):
        H = positioning.linearised(satellites[k, now], x)
        expected = positioning.pseudoranges(satellites[k, now], x)
        np.testing.assert_allclose(track.innovations[k, now], ranges[k, now] - expected, rtol=0, atol=EXACT)
        S = H @ (P + Q) @ H.T + np.diag(variance[k, now])
        np.testing.assert_allclose(track.S[k][np.ix_(now, now)], S, rtol=1e-9)
        x, P = track.X[k], track.P[k]


def test_innovations_have_the_covariance_that_is_stated():
    rng = np.random.default_rng(14)
    satellites, X = positioning.sky(RIGA, 0.0), np.append(RIGA, 0.0)
    P0, Q = np.diag([4.0, 9.0, 1.0, 16.0]), np.diag([0.5, 0.5, 0.5, 2.0])
    nis = []
    for _ in range(300):
        true = X + np.sqrt(np.diag(P0)) * rng.standard_normal(4)
        true = true + np.sqrt(np.diag(Q)) * rng.standard_normal((3, 4)).cumsum(axis=0)
        ranges = np.array([positioning.pseudoranges(satellites, each) for each in true])
        track = positioning.position_kalman(satellites, ranges + rng.standard_normal(ranges.shape), X, P0, Q, 1.0)
        nis += [e @ np.linalg.solve(S, e) for e, S in zip(track.innovations, track.S, strict=True)]
    low, high = mpt.metrics.chi_square_band(len(satellites), 900, level=0.9999)
    assert low < np.mean(nis) < high


def test_singular_covariances_leave_alone_what_is_known():
    """They ended in a LinAlgError: the inverse of P does not exist."""
    satellites, ranges, variance, X = changing_epochs(np.random.default_rng(15))
    zero, begin = np.zeros((4, 4)), far_from(X, 5.0, 1.0)
    track = positioning.position_kalman(satellites, ranges, begin, zero, zero, variance)
    np.testing.assert_array_equal(track.X, np.tile(begin, (len(ranges), 1)))
    np.testing.assert_array_equal(track.P, np.zeros((len(ranges), 4, 4)))
    assert np.isfinite(track.S[~np.isnan(ranges)[:, :, None] & ~np.isnan(ranges)[:, None]]).all()
    clock = np.diag([0, 0, 0, 100.0])  # the position is known, the clock is not
    track = positioning.position_kalman(satellites, ranges, X, zero, clock, variance)
    np.testing.assert_array_equal(track.X[:, :3], np.tile(X[:3], (len(ranges), 1)))
    assert (track.P[:, 3, 3] > 0).all()
    nearly = positioning.position_kalman(satellites, ranges, X, 1e-14 * np.eye(4), clock + 1e-14 * np.eye(4), variance)
    np.testing.assert_allclose(track.X, nearly.X, rtol=0, atol=EXACT)
    line = np.outer([3.0, 4.0, 0.0, 0.0], [3.0, 4.0, 0.0, 0.0])  # it moves on a line
    track = positioning.position_kalman(satellites, ranges, X, line, 0.01 * line, variance)
    np.testing.assert_allclose((track.X - X) @ [4.0, -3.0, 0.0, 0.0], 0, atol=EXACT)


@pytest.mark.parametrize("hide", [np.nan, 0.0, 1e-3])
def test_a_mask_hides_a_range(hide):
    """The numbers under a mask counted as measured."""
    satellites, ranges, variance, X = changing_epochs(np.random.default_rng(16))
    missing = np.isnan(ranges)
    masked = np.ma.masked_array(np.where(missing, hide, ranges), mask=missing)
    whole = positioning.position_kalman(satellites, ranges, X, np.eye(4), np.eye(4), variance)
    again = positioning.position_kalman(satellites, masked, X, np.eye(4), np.eye(4), variance)
    for one, other in zip(whole, again, strict=True):
        np.testing.assert_array_equal(one, other)
    with pytest.raises(ValueError, match=r"ranges: needs pseudoranges of .* m, got nan"):
        positioning.position(satellites[0], masked[0])


def test_an_extended_kalman_filter_is_continued_from_where_it_ended():
    satellites, ranges, variance, X = changing_epochs(np.random.default_rng(8))
    P0, Q = np.diag([1e4, 1e4, 1e4, 1e2]), np.eye(4)
    whole = positioning.position_kalman(satellites, ranges, X, P0, Q, variance)
    half = positioning.position_kalman(satellites[:3], ranges[:3], X, P0, Q, variance[:3])
    rest = positioning.position_kalman(satellites[3:], ranges[3:], half.X[-1], half.P[-1], Q, variance[3:])
    np.testing.assert_array_equal(np.vstack([half.X, rest.X]), whole.X)
    np.testing.assert_array_equal(np.vstack([half.P, rest.P]), whole.P)


def test_an_iterated_kalman_filter_with_a_wide_start_is_least_squares():
    satellites, X = positioning.sky(RIGA, 0.0), np.append(RIGA, 0.0)
    ranges = positioning.pseudoranges(satellites, X) + np.random.default_rng(8).standard_normal((1, len(satellites)))
    before, P0 = far_from(X, 3e5, 5e3), np.diag([9e10, 9e10, 9e10, 2.5e7])
    once, iterated = (
        positioning.position_kalman(satellites, ranges, before, P0, np.zeros((4, 4)), 1.0, linearisations=count).X[0]
        for count in (1, 5)
    )
    fix = positioning.position(satellites, ranges[0], before).X
    assert np.linalg.norm((once - fix)[:3]) > 100
    np.testing.assert_allclose(iterated, fix, rtol=0, atol=0.01)  # the prior of the clock weighs DOP² / 2.5e7 of 5 km


def test_the_covariance_of_a_fix_is_that_of_its_errors_and_the_probability_of_good_ranges_is_uniform():
    rng = np.random.default_rng(9)
    satellites, X = positioning.sky(RIGA, 0.0), np.append(RIGA, 0.0)
    variance = rng.uniform(0.5, 9, len(satellites))
    ranges = positioning.pseudoranges(satellites, X) + np.sqrt(variance) * rng.standard_normal((4000, len(satellites)))
    fixes = [positioning.position(satellites, each, X, variance=variance) for each in ranges]
    errors = np.array([fix.X for fix in fixes]) - X
    scale = np.sqrt(np.diag(fixes[0].P))
    # The standard error of a correlation over 4,000 runs is 1.6 %; four of it.
    np.testing.assert_allclose(
        np.cov(errors.T) / scale / scale[:, None], fixes[0].P / scale / scale[:, None], atol=0.065
    )
    # The standard error of a share over 4,000 runs is at most 0.8 %; four of it.
    p = np.array([fix.probability for fix in fixes])
    np.testing.assert_allclose([np.mean(p < level) for level in (0.1, 0.5, 0.9)], [0.1, 0.5, 0.9], atol=0.032)


def test_one_faulty_satellite_is_found_and_left_out():
    """One range 100 m short moved the fix by 54 m, silently."""
    satellites, X = positioning.sky(RIGA, 0.0), np.append(RIGA, 0.0)
    good = positioning.pseudoranges(satellites, X) + np.random.default_rng(11).standard_normal(len(satellites))
    for faulty in range(len(satellites)):
        ranges = good - 100 * np.eye(len(satellites))[faulty]
        plain = positioning.position(satellites, ranges)
        assert plain.used.all()
        assert np.linalg.norm((plain.X - X)[:3]) > 20
        assert plain.probability < 1e-9
        fix = positioning.position(satellites, ranges, false_alarm=1e-3)
        assert list(np.flatnonzero(~fix.used)) == [faulty]
        assert fix.probability > 1e-3
        rest = fix.used
        np.testing.assert_allclose(fix.X, positioning.position(satellites[rest], ranges[rest]).X, atol=EXACT)
        assert fix.residuals[faulty] == pytest.approx(-100, abs=25)


def test_good_ranges_are_all_used():
    satellites, X = positioning.sky(RIGA, 0.0), np.append(RIGA, 0.0)
    ranges = positioning.pseudoranges(satellites, X)
    assert positioning.position(satellites, ranges, false_alarm=1e-3).used.all()


@pytest.mark.parametrize("faults", [{0: 300, 3: -500}, {1: -40, 5: 60}, {2: 2e5, 4: -3e5}, {0: 90, 4: -50, 7: 70}])
def test_faulty_satellites_are_left_out_while_enough_remain(faults):
    """Only one could be: a fix of all satellites came back, 2 km off on a phone's ranges, with a sigma of 15 m.

    In the third case every probability is zero until both are left out. Three take ten satellites.
    """
    satellites, X = positioning.sky(RIGA, 0.0, mask=10 if len(faults) == 2 else -5), np.append(RIGA, 0.0)
    assert len(satellites) == {2: 8, 3: 10}[len(faults)]
    ranges = positioning.pseudoranges(satellites, X)
    ranges[list(faults)] += list(faults.values())
    assert not positioning.position(satellites, ranges).trusted  # nobody has asked for a test
    fix = positioning.position(satellites, ranges, false_alarm=1e-3)
    assert list(np.flatnonzero(~fix.used)) == sorted(faults)
    np.testing.assert_allclose(fix.X, X, rtol=0, atol=EXACT)
    assert not fix.trusted  # as many agree beyond four as were left out


@pytest.mark.parametrize("faults", [{3: 100}, {0: 300, 3: -500}])
def test_a_fix_is_trusted_where_more_are_to_spare_than_were_left_out(faults):
    satellites, X = positioning.sky(RIGA, 0.0, mask=-5), np.append(RIGA, 0.0)
    for count in range(6, 11):
        ranges = positioning.pseudoranges(satellites[:count], X)
        ranges[list(faults)] += list(faults.values())
        fix = positioning.position(satellites[:count], ranges, false_alarm=1e-3)
        to_spare, left_out = fix.used.sum() - 4, (~fix.used).sum()
        assert fix.trusted == (left_out == len(faults) and to_spare >= 2 and to_spare > left_out)
    assert fix.trusted


def test_ranges_that_are_all_wrong_are_hardly_ever_trusted():
    """A jammed receiver: with one satellite to spare one set in a hundred passes by luck, kilometres off."""
    rng, X = np.random.default_rng(14), np.append(RIGA, 0.0)
    satellites = positioning.sky(RIGA, 0.0)
    passed = {5: 0, 7: 0}
    for count in passed:
        trusted = 0
        for _ in range(600):
            some = satellites[rng.permutation(len(satellites))[:count]]
            wrong = positioning.pseudoranges(some, X) + 2000 * rng.standard_normal(count)
            with suppress(ValueError):  # some do not converge
                fix = positioning.position(some, wrong, X, variance=20.0, false_alarm=1e-5)
                passed[count] += fix.probability >= 1e-5
                trusted += fix.trusted
        assert trusted <= 2  # with two to spare, some in a thousand
    assert passed[5] >= 4


def test_what_cannot_be_excluded_is_not_trusted():
    satellites, X = positioning.sky(RIGA, 0.0), np.append(RIGA, 0.0)
    good = positioning.pseudoranges(satellites, X)
    ranges = good + 500 * np.array([1, 0, -1, 2, 0, -2, 3, 0])  # more faults than can be left out
    fix = positioning.position(satellites, ranges, false_alarm=1e-3)
    assert (fix.used.all(), fix.trusted) == (True, False)
    assert fix.probability < 1e-9
    assert np.linalg.norm((fix.X - X)[:3]) > 10 * np.sqrt(np.trace(fix.P[:3, :3]))
    ranges = good[:5] - [100, 0, 0, 0, 0]  # five satellites show it, not which one
    fix = positioning.position(satellites[:5], ranges, false_alarm=1e-3)
    assert (fix.used.all(), fix.trusted) == (True, False)
    assert fix.probability < 1e-3
    ranges = good[:7] + np.array([300, 0, 0, -500, 0, 0, 0])  # of seven, one can be told: two would leave five
    fix = positioning.position(satellites[:7], ranges, false_alarm=1e-3)
    assert (fix.used.all(), fix.trusted) == (True, False)
    four = positioning.position(satellites[:4], ranges[:4], false_alarm=1e-3)  # four cannot show it
    assert np.isnan(four.probability)
    assert not four.trusted


def test_good_ranges_are_trusted_but_for_false_alarms():
    rng = np.random.default_rng(12)
    satellites, X = positioning.sky(RIGA, 0.0), np.append(RIGA, 0.0)
    ranges = positioning.pseudoranges(satellites, X) + rng.standard_normal((500, len(satellites)))
    fixes = [positioning.position(satellites, each, X, false_alarm=0.1) for each in ranges]
    # 10 % fail the test of all satellites; the standard error over 500 runs is 1.3 %; four of it.
    assert np.mean([not fix.used.all() or not fix.trusted for fix in fixes]) == pytest.approx(0.1, abs=0.054)


@pytest.mark.parametrize(("bad", "named"), [(0.0, "0"), (np.nan, "nan"), (-5.0, "-5"), (2e11, r"2e\+11")])
def test_ranges_that_cannot_be_are_named(bad, named):
    satellites, X = positioning.sky(RIGA, 0.0), np.append(RIGA, 0.0)
    ranges = positioning.pseudoranges(satellites, X)
    ranges[2] = bad
    with pytest.raises(ValueError, match=f"ranges: needs pseudoranges of .* m, got {named} at index .2."):
        positioning.position(satellites, ranges)
    if not np.isnan(bad):  # which is a satellite that was not measured
        with pytest.raises(ValueError, match=f"ranges: needs pseudoranges of .* m, got {named} at index .0, 2."):
            positioning.position_kalman(satellites, ranges[None], X, np.eye(4), np.eye(4), 1.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"satellites": np.zeros((3, 3))}, r"satellites: needs an \(m, 3\) array of at least 4, got shape \(3, 3\)"),
        ({"satellites": positioning.sky(RIGA, 0.0) / 1e3}, "satellites: needs positions of .* m, got"),
        ({"ranges": [2e7]}, r"ranges: needs one for each of 8 satellites, got shape \(1,\)"),
        ({"variance": 0.0}, "variance: needs a positive number, or one for each range, got 0"),
        ({"start": [0.0, 0.0, 0.0]}, r"start: needs a \(4,\) array of finite numbers, got shape \(3,\)"),
        ({"false_alarm": 5}, "false_alarm: needs a probability between 0 and 1, got 5"),
        ({"false_alarm": -1}, "false_alarm: needs a probability between 0 and 1, got -1"),
        ({"false_alarm": np.nan}, "false_alarm: needs a probability between 0 and 1, got nan"),
    ],
)
def test_what_is_no_epoch_is_refused(change, message):
    satellites = positioning.sky(RIGA, 0.0)
    good = {"satellites": satellites, "ranges": positioning.pseudoranges(satellites, np.append(RIGA, 0.0))}
    with pytest.raises(ValueError, match=message):
        positioning.position(**good | change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"linearisations": 0}, "linearisations: needs an integer of at least 1, got 0"),
        ({"variance": 0.0}, "variance: needs a positive number, or one for each range, got 0"),
        ({"start": RIGA}, r"start: needs a \(4,\) array of finite numbers, got shape \(3,\)"),
        ({"P0": np.eye(3)}, r"P0: needs a \(4, 4\) array of finite numbers, got shape \(3, 3\)"),
        ({"P0": np.ones(4)}, r"P0: needs a \(4, 4\) array of finite numbers, got shape \(4,\)"),
        ({"P0": -np.eye(4)}, "P0: needs a symmetric positive semidefinite 4×4 matrix, got a variance of -1"),
        ({"Q": 0.01}, r"Q: needs a \(4, 4\) array of finite numbers, got shape \(\)"),
        ({"Q": np.diag([0.1, 0.1, 0.1])}, r"Q: needs a \(4, 4\) array of finite numbers, got shape \(3, 3\)"),
        (
            {"Q": np.triu(np.ones((4, 4)))},
            "Q: needs a symmetric positive semidefinite 4×4 matrix, got a matrix that is",
        ),
    ],
)
def test_a_filter_of_positions_refuses_by_name(change, message):
    X = np.append(RIGA, 0.0)
    satellites = positioning.sky(RIGA, 0.0)
    ranges = positioning.pseudoranges(satellites, X)[None]
    good = {"start": X, "P0": np.eye(4), "Q": np.eye(4), "variance": 1.0}
    with pytest.raises(ValueError, match=message):
        positioning.position_kalman(satellites, ranges, **good | change)


def test_a_measured_satellite_without_a_position_is_named_with_its_epoch():
    X = np.append(RIGA, 0.0)
    satellites = np.tile(positioning.sky(RIGA, 0.0), (3, 1, 1))
    ranges = np.array([positioning.pseudoranges(each, X) for each in satellites])
    satellites[1, 2] = np.nan
    with pytest.raises(ValueError, match=r"satellites: needs positions of .* m, got nan at index \[1, 2\]"):
        positioning.position_kalman(satellites, ranges, X, np.eye(4), np.eye(4), 1.0)


def test_a_satellite_that_is_not_measured_needs_neither_variance_nor_position():
    X = np.append(RIGA, 0.0)
    satellites = positioning.sky(RIGA, 0.0)
    ranges = positioning.pseudoranges(satellites, X)[None]
    ranges[0, 2] = np.nan
    satellites[2] = np.nan
    variance = np.where(np.isnan(ranges), np.nan, 1.0)
    track = positioning.position_kalman(satellites, ranges, X, np.eye(4), np.eye(4), variance)
    np.testing.assert_allclose(track.X[0], X, rtol=0, atol=EXACT)


def test_positions_are_on_the_ellipsoid():
    """The station of the recorded day: pymap3d 3.2.0 gives 55.49356276505275, 8.456821388720854, 59.476485892501756."""
    x = positioning.place(55.49356276505275, 8.456821388720854, 59.476485892501756)
    np.testing.assert_allclose(x, [3582105.291, 532589.7313, 5232754.8054], rtol=0, atol=1e-4)
    up = positioning.local_axes(x)[2]
    assert np.degrees(np.arcsin(up[2])) == pytest.approx(55.49356276505275, abs=1e-5)
    np.testing.assert_allclose(positioning.local_axes(x) @ positioning.local_axes(x).T, np.eye(3), atol=1e-15)
    with pytest.raises(ValueError, match="x: needs a position that is not on the Earth's axis"):
        positioning.local_axes([0.0, 0.0, 6.4e6])


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


def test_a_line_through_many_points_is_exact():
    """n² (n² - 1) / 12, the d of Eq. 10, is above the largest int64 here."""
    line = line_fit(3.0 + 0.5 * np.arange(1, 200_001), 2.0)
    assert line.velocity == pytest.approx(0.25, rel=1e-9)
    assert line.start == pytest.approx(3.0, rel=1e-6)


def test_a_line_through_single_precision_sums_in_doubles():
    """10,000 points of the size of an Earth-fixed coordinate: the line was 58 m off."""
    x = (3_582_105 + 0.25 * np.arange(1, 10_001)).astype(np.float32)  # each is exact in single precision
    line = line_fit(x, 1.0)
    assert line.start == pytest.approx(3_582_105, abs=EXACT)
    assert line.velocity == pytest.approx(0.25, abs=1e-9)


def test_a_mask_hides_a_position():
    z = np.arange(12.0)[:, None] ** 2
    hidden = np.arange(12)[:, None] == 7
    masked = np.ma.masked_array(np.where(hidden, 1e9, z), mask=hidden)
    with_nan = adaptive_line(np.where(hidden, np.nan, z), 1.0, 5.0, 2, 9)
    np.testing.assert_array_equal(adaptive_line(masked, 1.0, 5.0, 2, 9).x, with_nan.x)
    many = adaptive_line(np.ma.stack([masked, masked], axis=2), 1.0, 5.0, 2, 9)
    np.testing.assert_allclose(many.x[..., 1], with_nan.x, rtol=1e-12)
    assert np.isnan(line_fit(masked, 1.0).start).all()


def test_a_line_needs_two_points():
    with pytest.raises(ValueError, match="x: needs at least 2 positions, got 1"):
        line_fit(np.array([1.0]), 1.0)


@pytest.mark.parametrize("n", [2, 5, 100])
def test_line_sigma_is_the_covariance_of_the_fit(n):
    i = np.arange(1.0, n + 1)
    C = np.linalg.inv(np.array([[n, i.sum()], [i.sum(), i @ i]]))
    for point in (0, 1, (n + 1) / 2, n, n + 1):
        row = np.array([1, point])
        assert line_sigma(n, point) == pytest.approx(np.sqrt(row @ C @ row))
    assert line_sigma(n, (n + 1) / 2) == pytest.approx(1 / np.sqrt(n))


@pytest.mark.parametrize("n", [2, 20, 100])
def test_line_sigma_of_correlated_errors_is_that_of_the_weights(n):
    """Against polyfit's own weights and a covariance matrix written out."""
    rho = 0.9 ** np.arange(150) * np.cos(0.05 * np.arange(150))
    R = np.array([[rho[abs(j - k)] for j in range(n)] for k in range(n)])
    for point in (0, (n + 1) / 2, n):
        c = np.array([np.polyval(np.polyfit(np.arange(1, n + 1), e, 1), point) for e in np.eye(n)])
        assert line_sigma(n, point, rho) == pytest.approx(np.sqrt(c @ R @ c))
    np.testing.assert_allclose(line_sigma(n, np.arange(n), np.eye(1, n)[0]), line_sigma(n, np.arange(n)))
    assert line_sigma(n, n, np.ones(n)) == pytest.approx(1)  # errors that never change are not reduced


def test_line_sigma_refuses_too_few_lags():
    with pytest.raises(ValueError, match="autocorrelation: needs at least n = 5 lags, got 4"):
        line_sigma(5, 5, np.ones(4))
    with pytest.raises(ValueError, match="n: needs at least 2 points, got 1"):
        line_sigma(1, 1)


@pytest.mark.parametrize("seed", range(8))
def test_window_never_leaves_its_bounds(seed):
    rng = np.random.default_rng(seed)
    smallest = int(rng.integers(2, 6))
    largest = smallest + int(rng.integers(0, 60))
    z = 5 * rng.standard_normal((150, 1, 8)).cumsum(axis=0) + rng.standard_normal((150, 1, 8))
    tracked = adaptive_line(z, 1.0, rng.uniform(0.5, 20), smallest, largest)
    assert tracked.n.min() == smallest
    assert tracked.n.max() <= largest
    fell = tracked.n[1:] == smallest
    grew = tracked.n[1:] == np.minimum(tracked.n[:-1] + 1, largest)
    assert (fell | grew).all()
    assert np.isnan(tracked.x[: smallest - 1]).all()
    assert np.isfinite(tracked.x[smallest - 1 :]).all()


def slow_window(z, dt, threshold, smallest, largest):
    """The adaptive window over coordinates (N, m), one step at a time, with numpy.polyfit over the rows there are."""
    n, x, windows = smallest, [], []
    for k in range(smallest, len(z) + 1):
        there = ~np.isnan(z[:k]).any(axis=1)
        if x:
            position, velocity = x[-1].T
            off = there[-1] and np.linalg.norm(z[k - 1] - position - velocity * dt) > threshold
            n = smallest if off else min(n + 1, largest)
        used = np.flatnonzero(there[k - n : k]) + k - n
        slope, start = (
            np.polyfit(dt * (used - k + 1), z[used], 1) if len(used) > 1 else np.full((2, z.shape[1]), np.nan)
        )
        x.append(np.column_stack([start, slope]))
        windows.append(n)
    return np.array(x).reshape(len(x), -1), windows


@pytest.mark.parametrize(
    ("smallest", "largest", "missed", "coordinates"),
    [(2, 30, 0.0, 1), (5, 100, 0.3, 2), (3, 20, 0.3, 1), (6, 6, 0.0, 2)],
)
def test_adaptive_line_equals_polyfit_in_a_loop(smallest, largest, missed, coordinates):
    rng = np.random.default_rng(8)
    z = np.concatenate([np.zeros(60), 3.0 * np.arange(60)])[:, None] + rng.standard_normal((120, coordinates)) + 1e4
    z[rng.uniform(size=120) < missed, -1] = np.nan
    x, windows = slow_window(z, 0.5, 3.0, smallest, largest)
    tracked = adaptive_line(z, 0.5, 3.0, smallest, largest)
    np.testing.assert_array_equal(tracked.n[smallest - 1 :], windows)
    np.testing.assert_allclose(tracked.x[smallest - 1 :], x, rtol=0, atol=1e-9)  # polyfit over positions of 1e4 m
    assert len(set(windows)) > 1 or smallest == largest
    other = z.copy()
    other[::7] = np.nan  # another track beside it, with other gaps
    many = adaptive_line(np.stack([other, z, other], axis=2), 0.5, 3.0, smallest, largest)
    np.testing.assert_allclose(many.x[..., 1], tracked.x, rtol=0, atol=1e-10)
    np.testing.assert_array_equal(many.n[:, 1], tracked.n)


def test_adaptive_line_keeps_its_digits_on_a_long_track():
    """By sums since its start, positions of 20 m per step were off by 4 cm at step 1e5 and by 81 m at step 1e6."""
    steps = 20_000  # where the sums had lost 1e-4 m
    z = 20.1 * np.arange(steps)[:, None]
    tracked = adaptive_line(z, 1.0, np.inf, 2, 20)
    np.testing.assert_allclose(tracked.x[-100:, 0], z[-100:, 0], rtol=0, atol=EXACT)
    np.testing.assert_allclose(tracked.x[-100:, 1], 20.1, rtol=0, atol=EXACT)


def test_an_infinite_threshold_grows_the_window_only():
    z = np.random.default_rng(9).standard_normal((30, 1))
    np.testing.assert_array_equal(
        adaptive_line(z, 1.0, np.inf, 2, 10).n, np.minimum(np.maximum(np.arange(1, 31), 2), 10)
    )


def test_a_window_that_is_none_is_refused():
    for smallest, largest in ((1, 5), (6, 5)):
        with pytest.raises(ValueError, match="smallest: needs 2 or more, and at most largest"):
            adaptive_line(np.zeros((9, 1)), 1.0, 1.0, smallest, largest)


R = (1.0, 1e-4, 2.0)
GPS_INS = replace(mpt.gps_ins(0.5, 0.01, R), x0=[1.0, 2.0, 3.0], P0=np.diag([100.0, 1.0, 1.0]))


def observability(model):
    return np.vstack([model.H @ np.linalg.matrix_power(model.F, k) for k in range(model.n)])


def test_gps_ins_is_the_printed_model():
    np.testing.assert_array_equal(GPS_INS.F, [[1, 0.5, 0], [0, 1, 0], [0, 0, 1]])
    np.testing.assert_array_equal(GPS_INS.H, [[1, 0, 0], [0, 1, 1], [1, -0.5, 0]])
    np.testing.assert_array_equal(GPS_INS.Q, np.diag([0, 0.01, 0]))
    np.testing.assert_array_equal(GPS_INS.R, np.diag(R))


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


def test_without_process_noise_the_gps_ins_filter_is_the_growing_line_fit():
    z = np.column_stack([0.1 * np.arange(80), np.full(80, 1.2)]) + np.random.default_rng(2).normal(
        0, (1, 0.01), (80, 2)
    )
    P0 = 1e6 * np.eye(3)
    x = mpt.KalmanFilter(replace(mpt.gps_ins(0.5, 0.0, (1.0, 1e-4)), P0=P0)).filter(z)
    line = adaptive_line(z[:, :1], 0.5, np.inf, 2, 80).x
    # A prior of variance 1e6 weighs 1e-6 of the first positions; after ten it is some 1e-6 of errors of about 1.
    np.testing.assert_allclose(x[10:, :2], line[10:], atol=1e-4)
    np.testing.assert_allclose(x[10:, 2] + x[10:, 1], (z[:, 1].cumsum() / np.arange(1, 81))[10:], atol=1e-4)
