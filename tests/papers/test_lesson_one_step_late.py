"""The lesson `one_step_late`: its filter, each number in its prose, and hunts for cases that refute its sentences.

A text in `says` has its numbers put in by the test, so that a number that changes makes it fail.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
from conftest import source
from reading import Article
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov
from scipy.stats import chi2

import mpt_helpers as mpt
from reproduction.papers_2014_2015 import lesson_one_step_late as lesson


def plain(text):
    """A text without markup, in one line; [1\\ \\ 0] is [1 0]."""
    return re.sub(r"\s+", " ", re.sub(r"\\ ", " ", re.sub(r"[*$]", "", text)))


LESSON = Article("lessons/one_step_late", plain)
says, code_of, printed_by = LESSON.says, LESSON.code_of, LESSON.printed_by
NOW, NEXT = np.array([[1.0, 0.0]]), np.array([[1.0, 1.0]])
WIDE = 100 * np.eye(2)


def motion(dt, q):
    """F, G and Q of an axis: the push w of a step comes evenly over it."""
    F, G = np.array([[1.0, dt], [0.0, 1.0]]), np.array([[dt / 2], [1.0]])
    return F, G, q * G @ G.T


def settled(H, dt=1.0, q=0.01, r=0.1):
    """A, K, P and the variance S of the innovations of the settled filter, by scipy."""
    F, _, Q = motion(dt, q)
    P_p = solve_discrete_are(F.T, H.T, Q, [[r]])
    S = (H @ P_p @ H.T).item() + r
    K = P_p @ H.T / S
    return (np.eye(2) - K @ H) @ F, K, P_p - K @ H @ P_p, S


def makes(H, dt=1.0, q=0.01, r=0.1, age=0):
    """What a settled filter makes of positions that are `age` steps old: its lag, by L, and the covariance of the rest.

    The estimate is L x(k) plus an error whose covariance, with that of the previous step's push, one Lyapunov equation
    gives; it follows the position `age` steps ago and the newest pushes, so it needs no simulation.
    """
    F, G, _ = motion(dt, q)
    A, K, _, _ = settled(H, dt, q, r)
    seen = np.array([[1.0, -age * dt]])  # what the sensor shows of x(k), but for the newest pushes
    # L F = K seen F + A L
    L = np.linalg.solve(np.kron(np.eye(2), F.T) - np.kron(A, np.eye(2)), (K @ seen @ F).ravel()).reshape(2, 2)
    # pushes w(k), ..., w(k - age + 1) that the sensor has not felt: position now - age v dt is wrong by their sum
    felt = [-(np.linalg.matrix_power(F, i) @ G)[0, 0] + age * dt for i in range(age)]
    n = 2 + age  # the error, and the newest pushes
    T, W = np.zeros((n, n)), np.zeros((n, 2))
    T[:2, :2] = A
    T[3:, 2:-1] = np.eye(max(age - 1, 0))
    W[:2, [0]] = K @ seen @ G - L @ G
    W[:2, [1]] = K
    if age:
        W[2, 0] = 1
        W[:2, [0]] += K * felt[0]
        T[:2, 2:-1] += K * felt[1:]
    covariance = solve_discrete_lyapunov(T, W @ np.diag([q, r]) @ W.T)
    return L, covariance[:2, :2]


@pytest.fixture(scope="module")
def taught():
    """The names that the cells of the lesson define, but for those that draw."""
    names = {"lesson": lesson}
    for id in ("filter", "four-positions", "nis", "ramp"):
        exec(code_of(id), names)
    return names


def with_matrices(taught, F=None, Q=None):
    """The lesson's names once more, with another F or Q."""
    names = dict(taught)
    for id in ("filter", "four-positions", "ramp"):
        exec(code_of(id), names)
        names |= {name: matrix for name, matrix in (("F", F), ("Q", Q)) if matrix is not None}
    return names


# The filter, and why it is late


def test_the_step_is_that_of_the_package(taught):
    x, P, z = np.array([[1.0], [2.0]]), np.array([[2.0, 0.5], [0.5, 1.0]]), 3.5
    for H in (NOW, NEXT):
        model = mpt.LinearModel(F=taught["F"], H=H, Q=taught["Q"], R=[[0.1]])
        ours_x, ours_P = taught["step"](x, P, z, H)
        package_x, package_P = mpt.KalmanFilter(model).step(x[:, 0], P, np.array([z]))
        np.testing.assert_allclose(ours_x[:, 0], package_x, rtol=1e-12)
        np.testing.assert_allclose(ours_P, package_P, rtol=1e-12)
    np.testing.assert_allclose(taught["Q"], lesson.PRINTED.Q)
    np.testing.assert_array_equal(lesson.PRINTED.H, NEXT)  # the paper's


def test_the_numbers_of_the_scene_and_of_the_repair():
    late, right = (np.sqrt(settled(H)[2][0, 0]) for H in (NEXT, NOW))
    says(f"and it says that it knows the position to {100 * late:.0f} centimetres")
    says("each position wrong by some 30 centimetres")
    assert np.sqrt(0.1) == pytest.approx(0.3, abs=0.02)
    says(f"At 1.5 m/s it is 1.5 m, nine times the σ of {late:.3f} m at which the filter settles.")
    assert round(1.5 / late) == 9
    says(f"The right one settles at {right:.3f} m.")
    delay = right / 1.5 / np.sqrt(2)
    says(f"with σ = {right:.2f} m and independent errors, it tells the delay to {delay:.2f} s (its σ)")


def test_the_lag_is_one_step_at_any_speed_for_every_filter_of_this_kind():
    """The estimate is that of x(k), minus Δt times the velocity in the position: for every Q, r and Δt."""
    says(
        "late by v Δt at a steady speed v, and on average, over a long walk, by the mean velocity (with its sign) times"
        " Δt, is algebra, for every Q, r and Δt with which its gain for the speed does not fade to zero"
    )
    rng = np.random.default_rng(0)
    for _ in range(100):
        dt, q, r = 10 ** rng.uniform([-2, -4, -3], [2, 2, 3])
        L, _ = makes(np.array([[1.0, dt]]), dt, q, r)
        np.testing.assert_allclose(L, [[1, -dt], [0, 1]], rtol=1e-6, atol=1e-6 * dt)


def test_the_wrong_sigma_is_the_error_of_a_second_ago():
    """Within one part in a hundred, by simulation of the position before and the estimate now."""
    says("with pushes this gentle, it is really that of the position a second ago")
    true, measured = lesson.walk(60, tracks=4000)
    x = mpt.KalmanFilter(mpt.LinearModel(**{**matrices(lesson.PRINTED), "P0": WIDE})).filter(measured[:, None])
    about_before = np.sqrt(np.mean((x[40:, 0] - true[39:-1]) ** 2))
    assert about_before == pytest.approx(np.sqrt(settled(NEXT)[2][0, 0]), rel=0.01)


def matrices(model):
    return {name: getattr(model, name) for name in "FHQR"}


def test_the_walk_of_the_picture():
    true, measured = lesson.walk(60)
    speed = 1.5 + np.cumsum(np.random.default_rng(1).normal(0, 0.1, 60))
    says(f"The phone walks at {speed.min():.1f} to {speed.max():.1f} m/s")
    np.testing.assert_allclose(np.diff(true), (speed[1:] + speed[:-1]) / 2)
    late = mpt.KalmanFilter(mpt.LinearModel(**{**matrices(lesson.PRINTED), "P0": WIDE}))
    error = (true - late.filter(measured[:, None])[:, 0])[2:]
    says("The paper's filter is 1.5 m behind on average, and always far outside the grey stripe.")
    says("The surprises scatter as they should: 95 % or more lie within ± 2.")
    assert f"{error.mean():.1f}" == "1.5"
    assert (error > 2 * np.sqrt(late.covariances(60)[2:, 0, 0])).all()
    new = mpt.metrics.innovations(late, measured[:, None])
    assert np.mean(np.abs(new.values[2:, 0] / np.sqrt(new.S[2:, 0, 0])) <= 2) >= 0.95


def test_a_walk_obeys_the_model():
    """The covariance of a push, as it enters position and speed, is Q; that of the noise 0.1."""
    true, measured = lesson.walk(3, push=0.7, tracks=200_000)
    first, second, third = np.diff(true, axis=0, prepend=0) - 1.5  # w1/2, w1 + w2/2, w1 + w2 + w3/2
    w1, w2 = 2 * first, 2 * (second - 2 * first)
    w3 = 2 * (third - w1 - w2)
    np.testing.assert_allclose(np.cov([w1, w2, w3]), 0.49 * np.eye(3), atol=0.01)
    np.testing.assert_allclose(mpt.gsm_axis(dt=1.0, q=0.49, r=0.1).Q, 0.49 * np.outer([0.5, 1], [0.5, 1]))
    assert np.var(measured - true) == pytest.approx(0.1, rel=0.01)


def test_the_four_positions():
    answer = re.search(r"H = \[1 1\]: the phone is at ([\d.]+) m", printed_by("four-positions"))[1]
    says(f"The last measurement was 4.0. The paper's filter answers {answer}")
    assert abs(float(answer) - 2.9) < 0.17  # "where the phone was one measurement earlier": the third was 2.9


# The usual test


def nis_of_late(dt, q, r):
    """The exact mean NIS of the settled filter with H = [1 Δt] on positions of now.

    Its innovation is H F d(k-1) + half of the newest push + noise, where d(k-1) is its error about x(k-2).
    """
    F, G, _ = motion(dt, q)
    H = np.array([[1.0, dt]])
    A, K, _, S = settled(H, dt, q, r)
    # d(k) = x(k-1) - x(k/k) = A d(k-1) + (I - K H) G w(k-2) - K ([1 0] G w(k-1) + v(k)); state: d and the last push
    T = np.block([[A, (np.eye(2) - K @ H) @ G], [np.zeros((1, 3))]])
    W = np.block([[-K * G[0, 0], -K], [1, 0]])
    covariance = solve_discrete_lyapunov(T, W @ np.diag([q, r]) @ W.T)
    C = np.hstack([H @ F, H @ G])
    return ((C @ covariance @ C.T).item() + G[0, 0] ** 2 * q + r) / S


def test_what_counts_is_the_push_over_the_noise():
    rng = np.random.default_rng(2)
    for ratio in (0.1, 0.32, 1.0, 3.0):
        found = []
        for _ in range(20):
            dt, r = 10 ** rng.uniform([-2, -3], [2, 3])
            found.append(nis_of_late(dt, ratio**2 * r / dt**2, r))
        np.testing.assert_allclose(found, found[0], rtol=1e-5)
        assert found[0] < 1
    by_push = [nis_of_late(1.0, q, 0.1) for q in np.logspace(-6, 3, 50)]
    assert (np.diff(by_push) < 0).all()


def alarms(push, H, minutes=20_000, seed=14):
    """The mean NIS, and the share of minutes whose NIS is not within 1 ± 2 sqrt(2/60), after one that settles."""
    _, measured = lesson.walk(120, push, minutes, seed)
    kf = mpt.KalmanFilter(replace(mpt.gsm_axis(dt=1.0, q=push**2, r=0.1), H=H, P0=WIDE))
    new = mpt.metrics.innovations(kf, measured[:, None])
    nis = (new.values[60:, 0] ** 2 / new.S[60:, 0, 0].reshape(60, -1)).mean(axis=0)
    return nis.mean(), np.mean(np.abs(nis - 1) > 2 * np.sqrt(2 / 60))


def test_how_often_a_minute_raises_an_alarm():
    """The share is one of 20,000 minutes or more, 0.4 % give or take at most; its mean NIS is the exact one."""
    says("The shares of minutes are counted in 20,000 simulated ones or more")
    pushes = (0.1, 0.3, 0.6, 1.0)
    found = [alarms(push, NEXT, 80_000 if push == 0.1 else 20_000) for push in pushes]
    for push, (nis, _) in zip(pushes, found, strict=True):
        assert nis == pytest.approx(nis_of_late(1.0, push**2, 0.1), abs=0.006)
    limits = 60 * (1 + np.array([-2, 2]) * np.sqrt(2 / 60))
    honest = chi2.cdf(limits[0], 60) + chi2.sf(limits[1], 60)  # its surprises are white and Gaussian: any push
    assert alarms(0.6, NOW)[1] == pytest.approx(honest, abs=0.006)
    says("| σ of a push (m/s), with a sensor wrong by 0.32 m | 0.1 | 0.3 | 0.6 | 1 |")
    for name, shares in (("paper's filter", [share for _, share in found]), ("right filter", 4 * [honest])):
        says(f"| {name} | {' | '.join(f'{100 * share:.0f} %' for share in shares)} |")


def test_three_hours_show_that_something_is_off_and_a_minute_does_not():
    minute, hours = ([float(each) for each in re.findall(r"\d\.\d\d", line)] for line in printed_by("nis").splitlines())
    says("Three hours of such pushes show that something is a little off, but not what.")
    assert all(abs(nis - 1) < 2 * minute[2] for nis in minute[:2])
    assert hours[0] < 1 - 3 * hours[2]
    assert abs(hours[1] - 1) < 2 * hours[2]
    assert 2.7 < 10_000 / 3600 < 3
    assert minute[2] == pytest.approx(np.sqrt(2 / 60), abs=0.005)
    says("For an honest filter and Gaussian errors it is 1, give or take \\sqrt{2/N} over N measurements")


def test_nis_of_the_lesson_is_that_of_the_package(taught):
    _, measured = lesson.walk(100)
    kf = mpt.KalmanFilter(mpt.LinearModel(**{**matrices(lesson.PRINTED), "P0": WIDE}))
    new = mpt.metrics.innovations(kf, measured[:, None])
    expected = np.mean(new.values[10:, 0] ** 2 / new.S[10:, 0, 0])
    assert taught["nis"](measured, NEXT) == pytest.approx(expected, rel=1e-9)


def test_somebody_who_turns_back_alarms_both():
    says("If you turn back within a step, it lags for a while, too.")
    seconds = np.arange(200)
    positions = np.cumsum(1.5 * (1 - 2 * (seconds // 20 % 2)))
    z = positions[:, None] + np.random.default_rng(0).normal(0, np.sqrt(0.1), (200, 200))
    for H in (NOW, NEXT):
        kf = mpt.KalmanFilter(mpt.LinearModel(**{**matrices(lesson.PRINTED), "H": H, "P0": WIDE}))
        new = mpt.metrics.innovations(kf, z[:, None])
        assert np.mean(new.values[10:, 0] ** 2 / new.S[10:, 0, 0].reshape(190, -1)) > 5


# The ramp


def test_the_ramp_of_the_four_cases():
    found = re.findall(r"off by (-?[\d.]+) m and ([\d.]+) m/s", printed_by("ramp"))
    assert found == [("0.00", "0.00"), ("-1.50", "0.00"), ("1.50", "0.00"), ("0.00", "0.00")]
    assert len(code_of("ramp").split("\n\n\n")[0].splitlines()) == 5
    says("A few lines of code, and one fact about the sensor, bring it to light.")


def after_ramp(F, H, Q, r, sensor, dt=1.0, v=1.5, rows=1000):
    """How far the settled filter of these matrices is off on a ramp; its sensor shows the position `sensor` s ahead."""
    n = len(F)
    x, P = np.zeros((n, 1)), 100 * np.eye(n)
    for k in range(1, rows + 1):
        x, P = F @ x, F @ P @ F.T + Q
        K = P @ H.T / (H @ P @ H.T + r)
        x, P = x + K @ (v * (k * dt + sensor) - H @ x), P - K @ H @ P
        P = (P + P.T) / 2
    return x[:, 0] - np.array([v * rows * dt, v, *[0.0] * (n - 2)])


def test_what_a_ramp_tells_is_what_the_formula_says():
    """For many steps, entries a and b, sensors, speeds, Q and r."""
    says("and the position is off by (h - b)\\,v.")
    says("it ends at \\hat v = v\\,\\Delta t/a, and with b = h = 0 the position is still right.")
    rng = np.random.default_rng(3)
    for _ in range(25):
        dt, v, q, r = 10 ** rng.uniform([-1, -1, -2, -1], [1, 1.5, 1, 1])
        a, b, h = dt * rng.uniform(0.3, 3), dt * rng.uniform(0, 2), dt * rng.uniform(-2, 2)
        _, _, Q = motion(dt, q / dt**2)
        found = after_ramp(np.array([[1, a], [0, 1]]), np.array([[1, b]]), Q, r, h, dt, v, 1000)
        speed = v * dt / a  # a v^ = v dt
        expected = np.array([h * v - b * speed, speed - v])  # p^ + b v^ = p + h v
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5 * v * max(1, dt))


def test_each_wrong_entry_of_f_and_h_shows_on_a_ramp():
    """Each by 2 % of its scale, for many Q and r: the position or the speed is off by more than a thousandth."""
    rng = np.random.default_rng(4)
    for _ in range(12):
        q, r = 10 ** rng.uniform([-3, -1], [1, 1])
        for entry in ("F00", "F01", "F10", "F11", "H0", "H1"):
            F, H = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]])
            matrix, index = (F, (int(entry[1]), int(entry[2]))) if entry[0] == "F" else (H, (0, int(entry[1])))
            matrix[index] += rng.choice([-1, 1]) * 0.02
            off = after_ramp(F, H, motion(1.0, q)[2], r, 0.0, rows=400)
            assert np.abs(off).max() > 1e-3, (entry, q, r)


def test_a_ramp_sees_neither_q_nor_r():
    says("Q, r and P. They change how fast the filter settles, not where.")
    rng = np.random.default_rng(5)
    for _ in range(15):
        root = rng.normal(0, 1, (2, 2)) * 10 ** rng.uniform(-1, 1, (2, 1))
        off = after_ramp(np.array([[1.0, 1.0], [0.0, 1.0]]), NOW, root @ root.T, 10 ** rng.uniform(-2, 2), 0.0)
        assert np.abs(off).max() < 1e-6
    off = after_ramp(np.array([[1.0, 1.0], [0.0, 1.0]]), NOW, np.zeros((2, 2)), 0.1, 0.0)
    assert np.abs(off).max() < 1e-3  # the gain fades to zero, but the ramp is found before


def parabola(F, H, Q, r, rows=1500, a=0.3):
    """How far a filter of three states is off at constant acceleration: position, speed and acceleration."""
    x, P = np.zeros((3, 1)), 100 * np.eye(3)
    for k in range(1, rows + 1):
        x, P = F @ x, F @ P @ F.T + Q
        K = P @ H.T / (H @ P @ H.T + r)
        x, P = x + K @ (a * k**2 / 2 - H @ x), P - K @ H @ P
        P = (P + P.T) / 2
    return x[:, 0] - np.array([a * rows**2 / 2, a * rows, a])


def test_with_acceleration_four_entries_pass_the_ramp_and_not_the_parabola():
    says("If the acceleration is a third state, a ramp does not see what multiplies it: add a parabola,")
    rng = np.random.default_rng(6)
    for _ in range(2):
        q, r = 10 ** rng.uniform([-2, -1], [0, 1])
        G = np.array([[1 / 6], [0.5], [1]])
        Q = q * G @ G.T
        right = np.array([[1, 1, 0.5], [0, 1, 1], [0, 0, 1]]), np.array([[1.0, 0, 0]])
        assert np.abs(parabola(*right, Q, r)).max() < 1e-4
        for entry in ((0, 2), (1, 2), (2, 2), "H"):
            F, H = right[0].copy(), right[1].copy()
            if entry == "H":
                H[0, 2] = 0.4
            else:
                F[entry] -= 0.2
            assert np.abs(after_ramp(F, H, Q, r, 0.0, rows=1000)).max() < 1e-4
            assert np.abs(parabola(F, H, Q, r)).max() > 1e-2


# A recording, and sensors that are late


def test_a_recording_of_the_next_position_is_that_of_somebody_who_set_out_earlier(taught):
    """Row by row: so a filter makes the same of both, while one of them is late and the other is not."""
    true = 1.5 * np.arange(1, 202)
    noise = np.random.default_rng(3).normal(0, np.sqrt(0.1), 200)
    of_next = true[1:] + noise
    set_out_earlier = true + 1.5
    np.testing.assert_array_equal(of_next, set_out_earlier[:200] + noise)
    position = taught["run"](of_next, NEXT)[20:, 0]
    assert np.mean(true[20:200] - position) == pytest.approx(0, abs=0.05)
    assert np.mean(set_out_earlier[20:200] - position) == pytest.approx(1.5, abs=0.05)


def test_a_mark_that_is_passed_twice_tells_the_delay():
    """At constant speed; every filter, delay and offset of the sensor: the mean to 2 %, the scatter that is said."""
    says("The two lie apart by twice the delay times your speed")
    away = 1.5 * np.arange(1, 101)
    rng = np.random.default_rng(8)
    for h, offset in ((-2, 0.0), (0, 3.0), (1, -7.0)):
        for H in (NOW, NEXT):
            kf = mpt.KalmanFilter(mpt.LinearModel(**{**matrices(lesson.PRINTED), "H": H, "P0": 1e4 * np.eye(2)}))
            reports = []
            for positions, v in ((away, 1.5), (away[::-1], -1.5)):
                z = positions[:, None] + v * h + offset + rng.normal(0, np.sqrt(0.1), (100, 5000))
                reports.append(kf.filter(z[:, None])[-1, 0] - positions[-1])  # the mark is where it ends
            delay = (reports[1] - reports[0]) / 2 / 1.5
            assert delay.mean() == pytest.approx(H[0, 1] - h, abs=0.02)
            assert delay.std() < 0.115


def test_a_sensor_of_the_next_position_raises_the_same_alarms():
    """There the paper's H is right: the settled filter errs by what it states, and NIS is that of the late filter."""
    says("The same surprises could come from a sensor that shows the next position, and then nothing is late.")
    push = 1.0
    true, measured = lesson.walk(121, push, tracks=4000)
    kf = mpt.KalmanFilter(mpt.LinearModel(**{**matrices(mpt.gsm_axis(1.0, push**2, 0.1)), "P0": WIDE}))
    x = kf.filter(measured[1:, None])
    assert abs(np.mean(true[60:-1] - x[60:, 0])) < 0.01  # not late: the lag of positions of now would be 1.5 m
    new = mpt.metrics.innovations(kf, measured[1:, None])
    nis = np.mean(new.values[60:, 0] ** 2 / new.S[60:, 0, 0].reshape(60, -1))
    assert nis == pytest.approx(nis_of_late(1.0, push**2, 0.1), abs=0.01)


def test_what_lasts_for_minutes_drops_out_of_the_walk_past_a_mark():
    """Errors of half an hour hardly count, where independent ones make 0.11 s."""
    says("A wrong position of the mark drops out, and so do errors that last for many minutes.")
    kf = mpt.KalmanFilter(mpt.LinearModel(**{**matrices(lesson.PRINTED), "H": NOW, "P0": WIDE}))
    rng, keep = np.random.default_rng(3), np.exp(-1 / 1800)
    positions = 1.5 * np.concatenate([np.arange(60), 59 - np.arange(1, 60)])
    errors = np.empty((119, 2000))
    errors[0] = rng.normal(0, np.sqrt(0.1), 2000)
    for k in range(1, 119):
        errors[k] = keep * errors[k - 1] + rng.normal(0, np.sqrt(0.1 * (1 - keep**2)), 2000)
    found = kf.filter((positions[:, None] + errors)[:, None])[:, 0]
    spread = ((found[59 + 11] - found[59 - 11]) / 3.0).std()
    assert spread < 0.03


def test_after_a_turn_a_filter_looks_late_until_it_has_settled():
    """Without noise, of the right filter: the delay that the mark tells, by seconds between the mark and the turn."""
    says("Walk evenly for as long as the filter takes to settle after a turn, here ten seconds, plus the longest")
    kf = mpt.KalmanFilter(mpt.LinearModel(**{**matrices(lesson.PRINTED), "H": NOW, "P0": WIDE}))

    def delay(beyond):
        positions = 1.5 * np.concatenate([np.arange(60), 59 - np.arange(1, 60)])
        errors = kf.filter(positions[:, None])[:, 0] - positions
        return (errors[59 + beyond] - errors[59 - beyond]) / 3.0

    def told(age, beyond):
        """The delay that the mark tells of positions this old, with seconds from the mark to the turn."""
        seconds = np.arange(200.0)
        positions = 1.5 * np.minimum(
            seconds - 100, 100 + 2 * beyond - seconds
        )  # at the mark at 100, back at 100 + 2 beyond
        old = np.interp(seconds - age, seconds, positions)
        found = kf.filter(old[:, None])[:, 0]
        return (found[100 + 2 * beyond] - found[100]) / 3.0

    for age in (0, 3, 8, 12):
        assert told(age, 10 + age) == pytest.approx(age, abs=0.11 / 4)
    assert abs(told(12, 10) - 12) > 1
    assert abs(delay(3)) > 0.3
    assert max(abs(delay(each)) for each in range(10, 40)) < 0.11 / 4  # little beside the 0.11 s of the noise


@pytest.mark.parametrize("h", [-2.0, -0.5, 0.0, 1.0, 2.5])
def test_an_h_that_fits_the_sensor_passes_the_ramp(taught, h):
    np.testing.assert_allclose(taught["ramp"](np.array([[1.0, h]]), h), 0, atol=1e-6)
    assert abs(taught["ramp"](np.array([[1.0, h + 0.1]]), h)[0]) > 0.1


def test_an_old_position_is_mended_by_its_age_times_the_velocity(taught):
    says("once for each step, and for a fraction of one with that fraction in place of Δt in F |")
    for delay in (0.4, 1.0, 2.7):
        position, speed = taught["ramp"](NOW, -delay)
        assert position + delay * (1.5 + speed) == pytest.approx(0, abs=1e-6)


def test_a_wrong_step_in_f_shows_in_the_speed(taught):
    names = with_matrices(taught, F=np.array([[1.0, 0.5], [0.0, 1.0]]))
    position, speed = names["ramp"](NOW, 0)
    assert position == pytest.approx(0, abs=1e-6)
    assert speed == pytest.approx(1.5, abs=1e-6)


def test_the_half_in_g():
    """A push that comes evenly: in many small parts it moves the position by half of it."""
    assert "a push comes evenly over its step, so on average the position gets half" in code_of("filter")
    parts, dt, w = 100_000, 2.0, 0.3
    speed = np.cumsum(np.full(parts, w / parts))
    assert speed.sum() * dt / parts == pytest.approx(w * dt / 2, rel=1e-4)


def test_a_lesson_calls_no_ledger():
    assert not any(re.search(r"\bpublished\(|\bpaper\.", source(cell)) for cell in LESSON.cells)


def test_an_old_position_takes_a_negative_h_in_the_mean_only():
    old, age = np.array([[1.0, -3.0]]), 3
    L, made = makes(old, age=age)
    np.testing.assert_allclose(L, np.eye(2), atol=1e-9)
    states = np.sqrt(settled(old)[2][0, 0])
    real = np.sqrt(made[0, 0])
    says(f"for positions three seconds old (h = -3) it claims {states:.2f} m, and its real error is {real:.2f} m.")
    F, _, Q = motion(1.0, 0.01)
    P = settled(NOW)[2]
    for _ in range(age):
        P = F @ P @ F.T + Q
    # both by simulation, which owes nothing to the formulas above
    true, measured = lesson.walk(100, tracks=20_000)
    for H, rms in ((old, np.sqrt(made[0, 0])), (NOW, np.sqrt(P[0, 0]))):
        kf = mpt.KalmanFilter(mpt.LinearModel(**{**matrices(lesson.PRINTED), "H": H, "P0": WIDE}))
        x = kf.filter(measured[:-age, None])[-1]
        if H is NOW:
            x = np.linalg.matrix_power(F, age) @ x
        assert np.sqrt(np.mean((x[0] - true[-1]) ** 2)) == pytest.approx(rms, rel=0.02)
