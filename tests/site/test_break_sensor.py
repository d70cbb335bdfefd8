"""Break the sensor: the scenes, and that the track shown flatters nobody."""

import break_sensor
import numpy as np
import pytest

import mpt_helpers as mpt
from reproduction.plots import COLOUR_OF


@pytest.fixture(scope="module")
def tracks():
    """Other tracks than those that the shown one was taken from."""
    return break_sensor.walks(10_000, np.random.default_rng(99))


@pytest.mark.parametrize("name", break_sensor.SCENES)
def test_a_run_is_what_the_filters_of_the_package_make_of_the_fixes(name):
    scene, track = break_sensor.SCENES[name], break_sensor.average()
    seen = break_sensor.run(scene, track)
    truth = track.truth + scene.origin
    z = (truth + break_sensor.fixes(scene, track))[:, None]
    kf, steady, fir = break_sensor.filters(scene.ahead, scene.origin)
    np.testing.assert_allclose(seen.nis, by_hand(kf.model, z), rtol=1e-9)
    np.testing.assert_allclose(seen.kalman, kf.filter(z)[:, 0] - truth, atol=1e-9)
    np.testing.assert_allclose(seen.sigma**2, kf.covariances(z)[:, 0, 0], rtol=1e-12)
    np.testing.assert_allclose(seen.constant, steady.filter(z)[:, 0] - truth, atol=1e-9)
    np.testing.assert_allclose(seen.sigma_constant**2, steady.covariances(z)[:, 0, 0], rtol=1e-12)
    late = fir.order - 1
    np.testing.assert_allclose(seen.fir[late:], (fir.filter(z)[:, 0] - truth)[late:], atol=1e-9)
    assert np.isnan(seen.fir[:late]).all()
    assert seen.gain[np.isfinite(z[:, 0])][-1] == pytest.approx(seen.rest)
    assert np.isnan(seen.gain[~np.isfinite(z[:, 0])]).all()


def by_hand(model, z):
    """Return the NIS of each measurement by the Kalman filter's equations, one line each; NaN where it is lost."""
    x, P, found = model.x0, model.P0, []
    for each in z:
        x, P = model.F @ x, model.F @ P @ model.F.T + model.Q
        S = model.H @ P @ model.H.T + model.R
        new = each - model.H @ x
        found.append((new @ np.linalg.solve(S, new)).item())
        if np.isfinite(new).all():
            K = P @ model.H.T @ np.linalg.inv(S)
            x, P = x + K @ new, P - K @ S @ K.T
    return found


def test_many_tracks_are_run_as_each_alone(tracks):
    some = break_sensor.Walk(*(getattr(tracks, name)[:, :3] for name in ("truth", "noise", "lasting")))
    scene = break_sensor.SCENES["gap"]
    together = break_sensor.run(scene, some)
    for i in range(3):
        alone = break_sensor.run(scene, break_sensor.Walk(some.truth[:, i], some.noise[:, i], some.lasting[:, i]))
        for name in ("kalman", "constant", "fir", "nis"):
            np.testing.assert_allclose(getattr(together, name)[:, i], getattr(alone, name), atol=1e-9)


def test_the_errors_of_the_fixes_are_those_that_the_page_names(tracks):
    assert tracks.noise.std() == pytest.approx(np.sqrt(break_sensor.R), rel=0.01)
    assert tracks.lasting.std() == pytest.approx(break_sensor.LASTING, rel=0.02)
    after_a_second = np.mean(tracks.lasting[1:] * tracks.lasting[:-1]) / np.mean(tracks.lasting**2)
    assert after_a_second == pytest.approx(break_sensor.LEFT, abs=0.005)
    assert np.diff(tracks.truth, axis=0).mean() == pytest.approx(break_sensor.SPEED, rel=0.01)


def test_the_track_that_is_shown_is_an_average_one(tracks):
    """Each number that the page shows of it lies within 15 % of the root mean square over other tracks."""
    for name, shown in break_sensor.SHOWN.items():
        own = break_sensor.numbers(break_sensor.SCENES[name], break_sensor.average())
        all_of_them = break_sensor.numbers(break_sensor.SCENES[name], tracks)
        for each in shown:
            middle = break_sensor.SPEED if (name, each) == ("lag", "kalman") else mpt.metrics.rms(all_of_them[each])
            assert own[each] == pytest.approx(middle, rel=0.15), (name, each)


@pytest.mark.parametrize("name", break_sensor.SCENES)
def test_a_sentence_is_filled(name):
    assert "{" not in break_sensor.said(name)


def test_what_the_sentences_say_of_the_filters_own_test_holds_for_most_tracks(tracks):
    """Where fixes come one step late, or their errors last, 85 % of the tracks have a NIS within its band."""
    for name in ("lag", "lasting"):
        given = break_sensor.numbers(break_sensor.SCENES[name], tracks)
        low, high = mpt.metrics.chi_square_band(1, 40)
        assert np.mean((low <= given["nis"]) & (given["nis"] <= high)) > 0.85
        assert "sees nothing" in break_sensor.said(name)
        assert np.mean(given["outside"]) > 15  # and yet the truth is outside the band


def test_after_a_gap_a_constant_gain_takes_longer_than_kalman():
    assert break_sensor.settled(lost=1) <= break_sensor.settled(lost=4) <= break_sensor.settled(lost=16)
    kf, steady, _ = break_sensor.filters()
    z = np.zeros((200, 1))
    z[100:108] = np.nan
    ratio = np.sqrt(steady.covariances(z)[108:, 0, 0] / kf.covariances(z)[108:, 0, 0])
    fixes = break_sensor.settled(lost=8)
    assert ratio[fixes - 2] > 1.1
    assert (ratio[fixes - 1 :] <= 1.1).all()


def test_the_still_has_a_label_at_each_filter_and_no_legend():
    (top,) = break_sensor.draw("gap").axes
    colours = {text.get_text(): text.get_color() for text in top.texts}
    assert colours == {
        "constant gain": COLOUR_OF["steady"],
        "Kalman": COLOUR_OF["kalman"],
        "blue band: Kalman is\n95 % sure of the truth": COLOUR_OF["kalman"],
        "red: the truth is\noutside the band": break_sensor.RED,
    }
    assert top.get_legend() is None


def test_a_fix_that_is_lost_or_pulled_is_the_one_of_that_number():
    track = break_sensor.average()
    errors = break_sensor.fixes(break_sensor.Scene(lost=(1, 28), pulled={46: 2.6}), track)
    assert errors[45] == 2.6
    assert np.flatnonzero(np.isnan(errors)).tolist() == [0, 27]
    same = np.delete(np.arange(60), [0, 27, 45])
    assert (errors[same] == track.noise[same]).all()
