"""The lesson on freezing a filter: it agrees with the package, and each number of its prose is computed here."""

import re
from dataclasses import replace

import numpy as np
import pytest
from after_a_gap import worst_ratio
from conftest import ROOT, cells_of, prose, shown, source

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
    for id in ("filter", "freeze"):
        exec(source(CELLS[id]), names)
    return names


def test_the_filter_that_is_taught_is_that_of_the_package(taught):
    _, z = mpt.simulate(replace(VELOCITY, P0=np.zeros((2, 2))), 40, np.random.default_rng(1))
    F, Q = taught["motion"](1.0, 0.01)
    np.testing.assert_allclose(F, VELOCITY.F)
    np.testing.assert_allclose(Q, VELOCITY.Q)
    x, gains, P = taught["track"](z[:, 0], F, Q, 0.1, UNKNOWN, vary=40)
    e = mpt.KalmanFilter(VELOCITY).estimates(z)
    np.testing.assert_allclose(x[:, :, 0], e.x, atol=1e-6)
    np.testing.assert_allclose(P, e.P[-1], atol=1e-9)
    np.testing.assert_allclose(gains[-1], SETTLED.B, atol=1e-6)
    says("To freeze at once is to begin with the last $P$ instead, so that the first gain is already the final one.")
    at_once, _, _ = taught["track"](z[:, 0], F, Q, 0.1, P, vary=1)
    np.testing.assert_allclose(at_once[:, :, 0], SETTLED.filter(z), atol=1e-6)


def test_the_loop_of_the_small_computer_is_the_filter_whose_gain_varies_first():
    """Both print the last of the sixty positions, the loop as a place and the filter as an error."""
    assert "after 60 seconds: at 1200.05 m" in shown(CELLS["device"])
    assert "step 60: off by  0.05 m if the gain varies first" in shown(CELLS["run"])


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
    says("For twelve steps the frozen filter is worse than the bare measurement, but for the moment in which its error")
    says("The one whose gain varies only improves.")
    at_once, later = lesson.typical_errors(40)
    one = np.sqrt(lesson.R)
    assert np.flatnonzero(at_once > one).max() + 1 == 12
    assert (at_once[:12] < one).sum() == 1
    says("Then the filter begins as good as one measurement, and only improves.")
    assert later[0] == pytest.approx(one, rel=1e-3)
    assert (np.diff(later) < 1e-4).all()  # a tenth of a millimetre: the start was 10⁴ I and not unknown
    says("From step 15 on the two agree to 1 %.")
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
    says("eight for our sensor, 39 for one that is wrong by 10 m")
    assert taught["freeze_from"](*taught["motion"](1.0, 0.01), 0.1) == 8
    assert taught["freeze_from"](*taught["motion"](1.0, 0.01), 100.0) == 39


def test_the_operations_are_those_of_the_paper():
    says("As the paper counts, a step takes 69 operations while a Kalman filter computes its gain, and 10 with $A$")
    assert burden.total(burden.kalman(2, 1)) == 69
    assert burden.total(burden.steady_state(2, 1)) == 10
    says("59 of 69 operations a step as a paper of 2016 counts")


def test_the_error_of_a_prediction(taught):
    says("it is typically off by 0.23 m now, and by 1.1 m five seconds ahead")
    says("Tell the driver twice the typical error: here 2.2 m at five seconds.")
    for seconds, typical in ((0, 0.23), (5, 1.10)):
        F, Q = taught["motion"](seconds, 0.01)
        assert round(np.sqrt((F @ SETTLED.P @ F.T + Q)[0, 0]), 2) == typical
    assert "95 % of all cases below 2.2 m" in shown(CELLS["metres"])


def test_a_miss_costs_a_frozen_gain_little_and_ten_much(taught):
    lost = [worst_ratio(missed, lambda dt: taught["motion"](dt, 0.01), lesson.R) for missed in (1, 3, 10)]
    says("| times as large | " + " | ".join(f"{each:.2f}" for each in lost[:2]) + f" | {lost[2]:.1f} |")
    says(f"after ten in a row its error is up to {lost[2]:.1f} times that of a filter which computes its gain")
    says("with q = 1 its error is 2.1 times as large after three")
    assert round(worst_ratio(3, lambda dt: taught["motion"](dt, 1.0), lesson.R), 1) == 2.1


@pytest.mark.parametrize("sigma", [0.32, 10.0])
def test_a_gain_that_is_off_by_a_fiftieth_costs_hardly_anything(sigma):
    says("From the eighth step on the gain stays within 2 % of its limit, and so near the best gain a deviation costs")
    says("gains that are off by so much make the error larger by less than 0.1 %")
    model = mpt.constant_velocity(1.0, lesson.Q, sigma**2)
    best = mpt.SteadyStateFilter.from_kalman(model)
    for signs in ([1, 1], [1, -1]):
        K = best.B * (1 + 0.02 * np.array(signs)[:, None])
        left, P = np.eye(2) - K @ model.H, best.P
        for _ in range(500):
            P = left @ (model.F @ P @ model.F.T + model.Q) @ left.T + K @ model.R @ K.T
        assert np.sqrt(np.diag(P) / np.diag(best.P)).max() < 1.001
