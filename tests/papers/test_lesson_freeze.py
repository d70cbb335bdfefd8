"""The lesson on freezing a filter: it agrees with the package, and each number of its prose is computed here."""

import re
from dataclasses import replace

import numpy as np
import pytest
from conftest import ROOT, cells_of, prose, source

import mpt_helpers as mpt
from reproduction import burden
from reproduction.paper_2016 import lesson_freeze as lesson

CELLS = {cell["id"]: cell for cell in cells_of(ROOT / "notebooks" / "lessons" / "freeze_the_filter.ipynb")}
TEXT = re.sub(r"\s+", " ", prose(CELLS.values()).replace("*", ""))
UNKNOWN = 1e4 * np.eye(2)
VELOCITY = mpt.constant_velocity(1.0, lesson.Q, lesson.R, P0=UNKNOWN)
SETTLED = mpt.SteadyStateFilter.from_kalman(VELOCITY)


def says(text):
    """Require that the lesson says this; numbers in it are computed by the test."""
    assert re.sub(r"\s+", " ", text) in TEXT, text


@pytest.fixture(scope="module")
def taught():
    """The names that the lesson's cells define, without its drawings."""
    names = {"dt": 1.0, "q": 0.01, "R": 0.1}
    for id in ("filter", "freeze", "brakes", "drives"):
        exec(source(CELLS[id]), names)
    return names


def test_the_filter_that_is_taught_is_that_of_the_package(taught):
    _, z = mpt.simulate(replace(VELOCITY, P0=np.zeros((2, 2))), 40, np.random.default_rng(1))
    for model, make in (
        (VELOCITY, "motion"),
        (mpt.constant_acceleration(1.0, 0.01, 0.1, P0=1e4 * np.eye(3)), "motion_3"),
    ):
        F, Q = taught[make](1.0, 0.01)
        np.testing.assert_allclose(F, model.F)
        np.testing.assert_allclose(Q, model.Q)
        x, gains, P = taught["track"](z[:, 0], F, Q, 0.1, model.P0, vary=40)
        e = mpt.KalmanFilter(model).estimates(z)
        np.testing.assert_allclose(x[:, :, 0], e.x, atol=1e-6)
        np.testing.assert_allclose(P, e.P[-1], atol=1e-9)
        np.testing.assert_allclose(gains[-1], e.P[-1] @ model.H.T / 0.1, atol=1e-6)


def test_the_start_comes_out_by_hand():
    K = SETTLED.B[:, 0]
    says("a filter that knows the velocity to 0.14 m/s")
    assert round(np.sqrt(SETTLED.P[1, 1]), 2) == 0.14
    says("It moves by 0.549 · 20 = 11.0 m, and its velocity by 0.212 · 20 = 4.2 m/s.")
    assert K.round(3).tolist() == [0.549, 0.212]
    assert (20 * K).round(1).tolist() == [11.0, 4.2]
    says(
        "It is now 9.0 m behind and 15.8 m/s too slow. In the next second it falls back to 9.0 + 15.8 = 24.8 m behind."
    )
    says("The second measurement takes 0.549 of that away, and leaves 11.2 m. That is the top of the curve.")
    behind = 20 * (1 - K)
    assert behind.round(1).tolist() == [9.0, 15.8]
    assert round((1 - K[0]) * behind.sum(), 1) == 11.2


def test_the_picture():
    """The exact errors of the picture are those of simulated cars that nothing pushes."""
    says(
        "For twelve steps, but for the moment in which its error changes sign, the frozen filter is worse than the bare"
    )
    says("The one whose gain varies only improves.")
    at_once, later = lesson.typical_errors(40)
    one = np.sqrt(lesson.R)
    assert np.flatnonzero(at_once > one).max() + 1 == 12
    assert (at_once[:12] < one).sum() == 1
    assert (np.diff(later) < 1e-4).all()  # a tenth of a millimetre: the start was 10⁴ I and not unknown
    says("From step 15 on their typical errors agree to 1 %.")
    assert np.abs(at_once / later - 1)[14:].max() < 0.01
    truth = lesson.SPEED * np.arange(1, 41)[:, None]
    z = truth + one * np.random.default_rng(2).normal(size=(40, 20_000))
    off = SETTLED.filter(z[:, None])[:, 0] - truth
    np.testing.assert_allclose(np.sqrt((off**2).mean(axis=1)), at_once, rtol=0.02)  # known to 0.5 %


@pytest.mark.parametrize("sigma", [0.32, 10.0])
def test_a_line_through_two_measurements_is_a_start_for_a_good_sensor_only(sigma):
    """The exact errors are those of simulated measurements of a car that nothing pushes."""
    steady = mpt.SteadyStateFilter.from_kalman(mpt.constant_velocity(1.0, lesson.Q, sigma**2))
    noise = sigma * np.random.default_rng(3).normal(size=(25, 20_000))
    x = np.array([noise[1], noise[1] - noise[0]])
    rms = [sigma, sigma]
    for z in noise[2:]:
        x = steady.A @ x + steady.B * z
        rms.append(np.sqrt((x[0] ** 2).mean()))
    exact = lesson.errors_from_two_measurements(sigma**2)
    np.testing.assert_allclose(rms, exact, rtol=0.02)  # known to 0.5 %
    if sigma == 10:
        says(f"begun on two of its measurements the frozen filter is up to {exact.max():.0f} m off")
    else:
        says("With this sensor a good guess is nearly enough.")
        assert exact.max() < 1.2 * sigma


def test_the_steps_to_freeze(taught):
    says("eight for our sensor and a calm car, 39 if the sensor is wrong by 10 m")
    assert taught["freeze_from"](*taught["motion"](1.0, 0.01), 0.1) == 8
    assert taught["freeze_from"](*taught["motion"](1.0, 0.01), 100.0) == 39


def test_the_operations_are_those_of_the_paper():
    says("As the paper counts, a step takes 69 operations while a Kalman filter computes its gain, and 10 with $A$")
    assert burden.total(burden.kalman(2, 1)) == 69
    assert burden.total(burden.steady_state(2, 1)) == 10
    says("59 of 69 operations a step as the paper counts")


def test_the_error_of_a_prediction(taught):
    says("here 1.1 m (rms) at five seconds, with the small pushes of an even road")
    F, Q = taught["motion"](5, 0.01)
    assert round(np.sqrt((F @ SETTLED.P @ F.T + Q)[0, 0]), 1) == 1.1


def rms(off):
    return np.sqrt(np.mean(off**2))


def test_the_braking(taught):
    misses, motion, motion_3 = (taught[name] for name in ("misses", "motion", "motion_3"))
    says("the filter of the dotted line needs a surprise of 2/0.212 = 9.4 m each time")
    assert round(2 / SETTLED.B[1, 0], 1) == 9.4
    says("the filter that knows the acceleration is ahead, by 16 m against 26 and by 29 against 33")
    says("If the driver lets go after three seconds, velocity is ahead, by 10 m against 16")
    noise = np.random.default_rng(7).normal(0, np.sqrt(lesson.R), (71, 200))  # other drives than the lesson's
    of = {
        brake: [rms(misses(make, q, *brake, noise=noise)) for make, q in ((motion_3, 0.01), (motion, 1))]
        for brake in ((2, np.inf), (4, np.inf), (2, 3))
    }
    np.testing.assert_allclose(list(of.values()), [[16, 26], [29, 33], [16, 10]], atol=0.6)
    says("acceleration wins at every standstill, velocity at every brake of up to three seconds")
    for brake in (1, 2, 3, 4):
        for lasting in (1, 2, 3):
            assert rms(misses(motion, 1, brake, lasting)) < rms(misses(motion_3, 0.01, brake, lasting))
        assert rms(misses(motion, 1, brake)) > rms(misses(motion_3, 0.01, brake))
    says("It helps much only if the stop takes clearly longer than the five seconds that you look ahead.")
    gain = {each: rms(misses(motion, 1, each)) / rms(misses(motion_3, 0.01, each)) for each in (2, 3, 4, 6, 8)}
    assert min(gain[2], gain[3]) > 1.25  # ten and seven seconds
    assert max(gain[4], gain[6], gain[8]) < 1.2  # five seconds and less
    says("the prediction is up to 31 m too far at 2 m/s² and up to 60 m at 4, with velocity and q = 1 as with")
    says("After a brake that is let go the latter falls short.")
    assert misses(motion_3, 0.01, 2, 3)[4:].min() < -10
    for brake, (first, worst) in {2: (25, 31), 4: (50, 60)}.items():
        for off in (misses(motion, 1, brake), misses(motion_3, 0.01, brake)):
            assert round(off[0, 0]) == first
            assert off.max() == pytest.approx(worst, abs=1)
    says("With the rule it does not, and at 2 m/s² it is right to 1.5 m from second 6 on.")
    assert np.abs(misses(motion_3, 0.01, 2)[6:]).max() < 1.5
    assert misses(motion_3, 0.01, 2, stops=False)[10] < -20


@pytest.mark.parametrize("brake", [1, 2, 3, 4, 5, 6, 8])
def test_the_rule_makes_no_braking_to_a_standstill_worse(taught, brake):
    """For brakes that the lesson does not show, too; of filters that learn fast enough."""
    for q in (0.01, 0.1, 1.0):
        with_rule, without = (rms(taught["misses"](taught["motion_3"], q, brake, stops=each)) for each in (True, False))
        assert with_rule <= 1.001 * without


def worst_ratio_after(missed, make, q):
    """How much larger the error of a prediction for five seconds later is with the frozen gain than with the best."""
    (F, Q), (far, pushed) = make(1.0, q), make(5.0, q)
    H = np.eye(1, len(F))
    settled = mpt.SteadyStateFilter.from_kalman(mpt.LinearModel(F=F, H=H, Q=Q, R=[[lesson.R]]))
    best, K = settled.P, settled.B
    for _ in range(missed):
        best = F @ best @ F.T + Q
    frozen, found, left = best, [], np.eye(len(F)) - K @ H
    for _ in range(12):
        best, frozen = (F @ P @ F.T + Q for P in (best, frozen))
        best = best - best @ H.T @ H @ best / (H @ best @ H.T + lesson.R)
        frozen = left @ frozen @ left.T + lesson.R * K @ K.T
        found.append((far @ frozen @ far.T + pushed)[0, 0] / (far @ best @ far.T + pushed)[0, 0])
    return np.sqrt(max(found))


def test_a_miss_costs_a_frozen_gain_little_and_ten_much(taught):
    filters = (taught["motion"], 0.01), (taught["motion"], 1.0), (taught["motion_3"], 0.01)
    after = {missed: [worst_ratio_after(missed, *each) for each in filters] for missed in (1, 3, 10)}
    for missed, ratios in after.items():
        cells = [f"{each:.2f}" if each < 1.095 else f"{each:.1f}" if each < 5 else f"{each:.0f}" for each in ratios]
        says(f"| {missed} | {' | '.join(cells)} |")


@pytest.mark.parametrize("sigma", [0.32, 10.0])
def test_a_gain_that_is_off_by_a_fiftieth_costs_hardly_anything(sigma):
    says("From the eighth on the gain stays within 2 % of its limit; so near the best gain a deviation costs hardly")
    model = mpt.constant_velocity(1.0, lesson.Q, sigma**2)
    best = mpt.SteadyStateFilter.from_kalman(model)
    for signs in ([1, 1], [1, -1]):
        K = best.B * (1 + 0.02 * np.array(signs)[:, None])
        left, P = np.eye(2) - K @ model.H, best.P
        for _ in range(500):
            P = left @ (model.F @ P @ model.F.T + model.Q) @ left.T + K @ model.R @ K.T
        assert np.sqrt(np.diag(P) / np.diag(best.P)).max() < 1.001


def test_with_a_worse_sensor_the_acceleration_gains_nothing_that_counts(taught):
    """With q such that the filter with acceleration is as calm as that of velocity with q = 1, as the tables judge."""
    says("if it is wrong by 5 m, an equally calm filter with acceleration is hardly better at any of these")
    names, R = dict(taught, R=25.0), 25.0
    for id in ("filter", "freeze", "brakes", "drives"):
        exec(source(CELLS[id]), names)

    def calm(make, q):
        F, Q = make(1.0, q)
        model = mpt.LinearModel(F=F, H=np.eye(1, len(F)), Q=Q, R=[[R]])
        steady = mpt.SteadyStateFilter.from_kalman(model)
        made = mpt.metrics.error_moments(steady, replace(model, Q=0 * Q), 400).covariance[-1]
        far = make(5.0, q)[0][0]
        return np.sqrt(far @ made @ far)

    of_velocity = calm(taught["motion"], 1.0)
    equal = min(np.logspace(-4, 0, 41), key=lambda q: abs(calm(taught["motion_3"], q) - of_velocity))
    noise = np.random.default_rng(7).normal(0, 5.0, (71, 100))
    for brake in ((2, np.inf), (4, np.inf), (2, 3)):
        velocity, acceleration = (
            rms(names["misses"](make, q, *brake, noise=noise))
            for make, q in ((taught["motion"], 1.0), (taught["motion_3"], equal))
        )
        assert acceleration > 0.94 * velocity, (brake, velocity, acceleration)


def test_a_larger_q_states_too_much_on_a_calm_road(taught):
    says("If you chose a larger $q$ that is too much on a calm road, which is the safe side.")
    for q in (0.1, 1.0, 10.0):
        F, Q = taught["motion"](5, q)
        model = mpt.constant_velocity(1.0, q, lesson.R)
        steady = mpt.SteadyStateFilter.from_kalman(model)
        calm = mpt.metrics.error_moments(steady, replace(model, Q=np.zeros((2, 2))), 200).covariance[-1]
        assert (F @ steady.P @ F.T + Q)[0, 0] > 2 * (F @ calm @ F.T)[0, 0]
