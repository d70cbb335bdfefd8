"""The lesson on a car that brakes: its filters are the package's, and each number of its prose is computed here."""

import re
from dataclasses import replace

import numpy as np
import pytest
from conftest import ROOT, cells_of, prose, shown, source
from scipy.optimize import brentq

import mpt_helpers as mpt
from reproduction.paper_2016 import lesson_brakes as lesson

CELLS = {cell["id"]: cell for cell in cells_of(ROOT / "notebooks" / "lessons" / "when_the_driver_brakes.ipynb")}
TEXT = re.sub(r"\s+", " ", prose(CELLS.values()).replace("*", ""))
VELOCITY, ACCELERATION = (2, 1.0), (3, 0.01)  # unknowns and q of the two that are equally calm


def says(text):
    """Require that the lesson says this; numbers in it are computed by the test."""
    assert re.sub(r"\s+", " ", text) in TEXT, text


def made(R=0.1):
    """The names that the lesson's cells define, of a sensor with this variance; without its table."""
    names = {"lesson": lesson}
    exec(source(CELLS["filter"]), names)
    names["R"] = R
    functions, _, _ = source(CELLS["table"]).partition("\nbrakes = ")
    exec(functions, names)
    return names


@pytest.fixture(scope="module")
def taught():
    """The names of the lesson, with its own sensor."""
    return made()


QUIET = np.zeros((71, 1))  # no noise, and predictions of seconds 0 to 10


def rms(off):
    return np.sqrt(np.mean(off**2))


@pytest.fixture(scope="module")
def off(taught):
    """How far the filter of n unknowns misses without noise, as rms over the ten seconds."""
    return lambda n, q, *brake: rms(taught["misses"](n, q, *brake, QUIET))


def test_the_filters_that_are_taught_are_those_of_the_package(taught):
    """Each of the picture, at each brake, with the rule; and the matrices."""
    for (n, q), model in zip(((2, 0.01), (2, 1.0), (3, 0.01)), lesson.FILTERS.values(), strict=True):
        F, Q = taught["motion"](n, 1.0, q)
        np.testing.assert_allclose(F, model.F)
        np.testing.assert_allclose(Q, model.Q)
        for brake, lasting in ((2.0, np.inf), (4.0, np.inf), (2.0, 3.0)):
            here = taught["misses"](n, q, brake, lasting, QUIET)[:, 0]
            np.testing.assert_allclose(here, lesson.misses(model, brake, lasting), atol=1e-3)


def test_the_road_is_that_of_the_picture(taught):
    t = np.arange(-5, 30)
    for brake, lasting in ((2.0, np.inf), (4.0, np.inf), (2.0, 3.0)):
        np.testing.assert_allclose(taught["road"](t, brake, lasting), lesson.road(t, brake, lasting))


def test_the_first_screen(taught):
    says("| velocity filter | 26 m | 10 m |")
    says("| acceleration filter | 16 m | 16 m |")
    says("Both are tuned to be equally calm: where nothing pushes the car, their predictions are off by 2 m.")
    rows = [re.split(r"  +", line.strip()) for line in shown(CELLS["table"]).splitlines()]
    assert rows[2] == ["velocity, q = 1", "26 m", "33 m", "10 m", "2.1 m"]
    assert rows[3] == ["acceleration, q = 0.01", "16 m", "29 m", "16 m", "2.0 m"]
    says("in the last row, is better at both stops. Its price is twice the error on a calm road.")
    assert rows[4] == ["acceleration, q = 0.1", "13 m", "23 m", "15 m", "3.9 m"]
    says("in five seconds 25 m at 2 m/s², and 50 m at 4.")
    for brake, taken in ((2.0, 25), (4.0, 50)):
        for model in lesson.FILTERS.values():
            assert round(lesson.misses(model, brake)[0]) == taken


def test_the_picture():
    velocity, acceleration = (lesson.FILTERS[name] for name in ("velocity, q = 1", "acceleration, q = 0.01"))
    says("the acceleration filter (yellow) is right to 1.5 m from second 6 on")
    assert np.abs(lesson.misses(acceleration, 2.0)[6:]).max() < 1.5
    says("while the velocity filters (blue) are too far all ten seconds")
    assert min(lesson.misses(model, 2.0)[:11].min() for model in list(lesson.FILTERS.values())[:2]) > 4
    says("On the right the velocity filter with q = 1 is within a metre from second 4 on.")
    assert np.abs(lesson.misses(velocity, 2.0, 3.0)[4:]).max() < 1
    says("Until then it goes on braking, and is up to 25 m short.")
    assert round(lesson.misses(acceleration, 2.0, 3.0).min()) == -25
    says("predict that the car comes back (dashed)")
    assert lesson.misses(acceleration, 2.0, stops=False)[10] < -20


def test_why_the_velocity_is_late():
    """By hand: the surprise that makes up for the brake; and the settled miss of the prediction."""
    gains = {}
    for q in (0.01, 1.0):
        gains[q] = mpt.SteadyStateFilter.from_kalman(mpt.constant_velocity(1.0, q, 0.1)).B[:, 0]
    says("the gain of the velocity is 0.212 per second")
    says("the filter needs a surprise of 2/0.212 = 9.4 m in every second")
    says("With q = 1 the gain is 0.905, and 2/0.905 = 2.2 m suffice.")
    assert [round(gains[q][1], 3) for q in gains] == [0.212, 0.905]
    assert [round(2 / gains[q][1], 1) for q in gains] == [9.4, 2.2]
    says("That is most of the 30 m by which the solid blue line is off from second 1 to 5. The other 5 m come from")
    says("its speed, which lags behind by 1 m/s.")
    K_s, K_v = gains[1.0]
    position = (1 - K_s) * 2 / K_v  # what is left of the surprise
    speed = 2 / K_v - position - 1  # the surprise is position, speed, and half a brake of 2 m/s²
    assert round(position + 5 * speed + 25) == 30
    assert (round(position, 1), round(speed, 1)) == (0.2, 1.0)
    made = lesson.misses(lesson.FILTERS["velocity, q = 1"], 2.0)
    assert (made.round()[1:6] - 30 <= 1).all()
    assert made[5] == pytest.approx(position + 5 * speed + 25, abs=0.1)


def test_which_filter_wins(off, taught):
    says("Here the border lies between seven and eight seconds of braking.")
    says("The errors scatter by less than a metre from one set of 200 drives to the next.")
    noise = np.random.default_rng(7).normal(0, np.sqrt(lesson.R), (71, 200))  # other drives than the lesson's
    table = {(2, 0.01): [42, 50, 15], VELOCITY: [26, 33, 10], ACCELERATION: [16, 29, 16], (3, 0.1): [13, 23, 15]}
    for each, expected in table.items():
        found = [rms(taught["misses"](*each, *brake, noise)) for brake in ((2, np.inf), (4, np.inf), (2, 3))]
        np.testing.assert_allclose(found, expected, atol=1)
    says("The acceleration filter wins at all four stops, but clearly only if the stop takes longer than five")
    says("at 1 m/s² up to eight seconds, at 2 m/s² up to seven, at 3 m/s² up to five, and at 4 m/s² up to four,")
    for brake, from_when in ((1, 9), (2, 8), (3, 6), (4, 5)):
        wins = [
            lasting
            for lasting in range(1, 20 // brake)
            if off(*VELOCITY, brake, lasting) > off(*ACCELERATION, brake, lasting)
        ]
        assert wins == list(range(from_when, 20 // brake))
    gain = {each: off(*VELOCITY, each, np.inf) / off(*ACCELERATION, each, np.inf) for each in (1, 2, 3, 4, 6, 8)}
    assert min(gain.values()) > 1
    assert min(gain[1], gain[2], gain[3]) > 1.25  # twenty, ten and seven seconds
    assert max(gain[4], gain[6], gain[8]) < 1.2  # five seconds and less


def test_a_driver_who_has_just_speeded_up(taught):
    """From 10 to 20 m/s in the five seconds before the touch."""
    says("from 10 to 20 m/s, it is 26 m off in a stop by 2 m/s², the other 34.")

    def position(t):
        faster, braked = np.clip(t + 5, 0, 5), np.clip(t, 0, 10)
        return 10 * np.minimum(t, 0) + faster**2 + 20 * braked - braked**2

    z = position(np.arange(-60.0, 11))
    errors = {}
    for n, q in (VELOCITY, ACCELERATION):
        x, _ = taught["track"](z[:, None] - z[0], *taught["motion"](n, 1.0, q), lesson.R)
        predicted = np.array([taught["ahead"](each[:, 0], 5) for each in x[60:]])
        errors[n] = predicted - (position(np.arange(5.0, 16)) - z[0])
    assert [round(rms(each)) for each in errors.values()] == [26, 34]
    says("With three seconds of steady drive between, the acceleration filter wins again here.")
    for steady, brake in ((3, 2), (4, 1), (4, 2), (4, 3)):
        t = np.arange(-60.0, 11) + steady
        earlier = np.clip(-t, 0, 5) ** 2 + 10 * np.maximum(-t - 5, 0)  # metres further back, some seconds before
        velocity, acceleration = (
            rms(taught["misses"](*each, brake, np.inf, earlier[:, None])) for each in (VELOCITY, ACCELERATION)
        )
        assert acceleration < velocity


def equally_calm(names, n, q):
    """The q of the filter with acceleration that is as calm as a velocity filter, by the lesson's own measure."""
    aim = names["calm"](n, q)
    return 10 ** brentq(lambda power: names["calm"](3, 10**power) - aim, -4, 0, xtol=0.01)


def test_most_of_the_error_of_a_short_stop_is_made_before_anybody_knows():
    says("and the first three seconds, in which neither of the two is good, make most of the error.")
    for model in list(lesson.FILTERS.values())[1:]:
        squares = lesson.misses(model, 4.0) ** 2
        assert squares[:3].sum() > 0.5 * squares.sum()


@pytest.mark.parametrize("brake", [1, 2, 3, 4, 5, 6, 8])
def test_the_rule_makes_no_braking_to_a_standstill_worse(brake):
    """For brakes that the lesson does not show, too; of filters that learn fast enough."""
    for q in (0.01, 0.1, 1.0):
        model = mpt.constant_acceleration(1.0, q, lesson.R, P0=1e4 * np.eye(3))
        with_rule, without = (rms(lesson.misses(model, brake, stops=each)) for each in (True, False))
        assert with_rule <= 1.001 * without


def test_with_ten_measurements_a_second_the_border_is_at_six(taught):
    """Both filters tuned to 2 m on the calm road."""
    says("With ten measurements a second the border of our example falls to six seconds;")
    names = made()
    exec(source(CELLS["filter"]).replace("dt, R = 1.0, 0.1", "dt, R = 0.1, 0.1"), names)
    exec(source(CELLS["table"]).partition("\nbrakes = ")[0], names)
    both = [(2, 1.35), (3, 0.0301)]
    assert [names["calm"](*each) for each in both] == [pytest.approx(2, abs=0.02)] * 2
    quiet = np.zeros((len(names["t"]), 1))
    for lasting, wins in ((5, 0), (6, 0), (7, 1), (8, 1)):
        assert np.argmin([rms(names["misses"](*each, 2, lasting, quiet)) for each in both]) == wins


def test_with_a_worse_sensor_the_acceleration_gains_less():
    """With q such that the filter with acceleration is as calm as that of velocity with q = 1, as the table judges."""
    says("both filters kept at 7 m on the calm road, they differ on our three brakes by some 7 % at most, either way.")
    names = made(R=25.0)
    noise = np.random.default_rng(7).normal(0, 5.0, (71, 100))
    assert round(names["calm"](*VELOCITY)) == 7
    ratios = {}
    for brake in ((2, np.inf), (4, np.inf), (2, 3)):
        velocity, acceleration = (
            rms(names["misses"](*each, *brake, noise)) for each in (VELOCITY, (3, equally_calm(names, *VELOCITY)))
        )
        ratios[brake] = acceleration / velocity
    assert 0.93 < min(ratios.values()) < 0.95
    assert ratios[2, 3] == pytest.approx(1.06, abs=0.02)
    says("If they may be off by 15 m there, it is 20 % again.")
    rough = [(n, 10 ** brentq(lambda power, n=n: names["calm"](n, 10**power) - 15, -6, 4, xtol=0.01)) for n in (2, 3)]
    velocity, acceleration = (rms(names["misses"](*each, 2, np.inf, noise)) for each in rough)
    assert acceleration / velocity == pytest.approx(0.8, abs=0.03)
    velocity, acceleration = (rms(names["misses"](*each, 2, 3, noise)) for each in rough)
    assert acceleration / velocity == pytest.approx(1.2, abs=0.04)
    of_velocity = names["calm"](*VELOCITY)
    model = mpt.constant_velocity(1.0, 1.0, 25.0)
    made_of = mpt.metrics.error_moments(mpt.SteadyStateFilter.from_kalman(model), replace(model, Q=0 * model.Q), 400)
    assert of_velocity == pytest.approx(np.sqrt(np.array([1, 5]) @ made_of.covariance[-1] @ np.array([1, 5])))


def test_the_winners_are_those_until_ten_seconds_after_the_brake():
    says("if errors count until ten seconds after the brake has ended, its borders stay.")
    functions, _, _ = source(CELLS["table"]).partition("\nbrakes = ")
    for brake, border in ((1, 8), (2, 7), (3, 5), (4, 4)):
        for lasting in range(1, 20 // brake):
            last = lasting + 10
            names = made()
            exec(functions, names)
            names["t"] = np.arange(-60.0, last + 1)
            velocity, acceleration = (
                rms(names["misses"](*each, brake, lasting, np.zeros((61 + last, 1))))
                for each in (VELOCITY, ACCELERATION)
            )
            if (brake, lasting) == (1, 9):
                assert acceleration / velocity == pytest.approx(1, abs=0.02)
            else:
                assert (velocity < acceleration) == (lasting <= border), (brake, lasting)


def test_the_picture_of_the_border_has_lines_and_stops():
    lengths = np.arange(1, 5)
    errors = {each: [lengths, (lengths * each, 7.0 * each), (9.0 - lengths, 3.0)] for each in (1, 2, 3, 4)}
    panels = lesson.draw_border(errors).axes
    assert len(panels) == 4
    for brake, panel in zip(errors, panels, strict=True):
        velocity, its_stop, acceleration, other_stop = (line.get_ydata() for line in panel.lines)
        np.testing.assert_array_equal(velocity, lengths * brake)
        np.testing.assert_array_equal(acceleration, 9.0 - lengths)
        assert (list(its_stop), list(other_stop)) == ([7.0 * brake], [3.0])


def test_how_fast_the_acceleration_is_learnt(taught):
    says("corrects its acceleration by 0.16 of each surprise.")
    says("after three seconds it has learnt 1.1 of the 2 m/s²,")
    says("and after five nearly all.")
    says("The acceleration filter has learnt half of the brake when it ends")
    F, Q = taught["motion"](3, 1.0, 0.01)
    x, gains = taught["track"](taught["road"](np.arange(-60.0, 11), 2.0), F, Q, 0.1)
    assert round(gains[-1, 2, 0], 2) == 0.16
    assert round(-x[63, 2, 0], 1) == 1.1
    assert -x[65, 2, 0] > 1.9


def test_a_recorded_drive_is_judged_by_later_measurements(taught):
    """As by the true positions, within the sensor's error."""
    names = {**taught}
    exec(source(CELLS["recorded"]).partition("\n\n\ndef drive")[0], names)
    t = np.arange(-60.0, 16)
    noise = np.random.default_rng(3).normal(0, np.sqrt(lesson.R), len(t))
    for each in (VELOCITY, ACCELERATION):
        found = names["misses_of"](taught["road"](t, 2.0) + noise, *each)[60:]
        true = taught["misses"](*each, 2.0, np.inf, noise[:71, None])[:, 0]
        assert np.abs(found - true).max() < 4 * np.sqrt(2 * lesson.R)  # less its first measurement's error


def test_a_q_is_found_for_an_error_on_the_calm_road(taught):
    (code,) = re.findall(r"`(min\(np.logspace.*?)` for 2 m.", TEXT)
    assert taught["calm"](3, eval(code, taught)) == pytest.approx(2, rel=0.05)
    says("(No $q$ makes that of the velocity filter larger than 3.5 m here.)")
    largest = [taught["calm"](2, q) for q in (1e2, 1e4, 1e6)]
    assert largest == sorted(largest)
    assert round(largest[-1], 1) == 3.5


def test_the_border_of_other_roads_and_horizons():
    says("the border stays between four and ten seconds of braking; in a brake too short for that, the velocity filter")
    says("At stops after a steady drive the acceleration filter wins, or loses by 3 % at most.")
    names = made()
    for names["speed"], names["horizon"], aim in (
        *((speed, 5, aim) for speed in (10, 20, 30) for aim in (0.7, 1, 2)),
        *((20, 2, aim) for aim in (0.7, 1)),
        *((20, 10, aim) for aim in (0.7, 1, 2, 4)),
    ):
        both = [
            (n, 10 ** brentq(lambda power, n=n, aim=aim: names["calm"](n, 10**power) - aim, -6, 4, xtol=0.01))
            for n in (2, 3)
        ]
        for brake in (1, 2, 3, 4):

            def error(each, lasting, brake=brake):
                return rms(names["misses"](*each, brake, lasting, QUIET))

            standing = int(np.ceil(names["speed"] / brake))
            wins = [lasting for lasting in range(1, standing) if error(both[0], lasting) < error(both[1], lasting)]
            assert wins == list(range(1, wins[-1] + 1))
            assert 5 <= wins[-1] <= 9 or standing - 2 <= wins[-1]
            assert error(both[1], np.inf) < 1.02 * error(both[0], np.inf)


def test_a_recording_with_other_steps_is_judged_at_its_own_seconds():
    """With two measurements a second the drive has the same road, and predictions are compared as far ahead."""
    drives = []
    for dt in (1.0, 0.5):
        names = made()
        exec(source(CELLS["filter"]).replace("dt, R = 1.0, 0.1", f"dt, R = {dt}, 1e-12"), names)
        exec(source(CELLS["table"]).partition("\nbrakes = ")[0], names)
        exec(source(CELLS["brakes"]).partition("\nerrors")[0], names)
        exec(source(CELLS["recorded"]), names)
        drives.append(names)
    letting_go = drives[0]["letting_go"]
    np.testing.assert_allclose(drives[1]["drive"](letting_go)[1::2], drives[0]["drive"](letting_go), atol=1e-4)
    still = drives[1]["drive"](letting_go)[:60]  # at constant speed both see nothing but the start
    assert np.abs(drives[1]["misses_of"](still, 2, 1)[20:]).max() < 1e-3
