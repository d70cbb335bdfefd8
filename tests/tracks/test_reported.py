"""Kinds of recordings that people report in public: times, repeats, wrong positions, long ways, rests."""

from copy import deepcopy
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pandas
import pytest

import mpt_helpers as mpt
from mpt_helpers.tracks import clean, geodesy, readers

RADIUS = 6371008.8


def ride(N=600, dt=1.0, speed=6.0, noise=2.0, seed=1):
    """Times, true positions and fixes of a ride."""
    rng = np.random.default_rng(seed)
    heading = np.cumsum(rng.normal(0, 0.03 * np.sqrt(dt), N))
    v = speed * (1 + 0.15 * np.sin(np.arange(N) * dt / 50)) * np.ones(N)
    true = np.cumsum(np.column_stack([np.sin(heading), np.cos(heading)]) * v[:, None] * dt, axis=0)
    return np.arange(N) * dt, true, true + noise * rng.standard_normal((N, 2))


def gpx(path, t, lat, lon, segment=None):
    """Write fixes as a GPX file."""
    lines = ['<gpx version="1.1" creator="x" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>']
    start = datetime(2022, 5, 3, 9, 15, tzinfo=UTC)
    for k, (seconds, a, b) in enumerate(zip(t, lat, lon, strict=True)):
        if segment is not None and k and segment[k] != segment[k - 1]:
            lines.append("</trkseg><trkseg>")
        time = (start + timedelta(seconds=float(seconds))).isoformat().replace("+00:00", "Z")
        lines.append(f'<trkpt lat="{a:.7f}" lon="{b:.7f}"><time>{time}</time></trkpt>')
    path.write_text("".join([*lines, "</trkseg></trk></gpx>"]))
    return path


def degrees(z):
    return 52.3 + np.degrees(z[:, 1] / RADIUS), 4.9 + np.degrees(z[:, 0] / (RADIUS * np.cos(np.radians(52.3))))


def bad_rows(kind):
    k = np.arange(600)
    return {
        "six short ones": np.isin(k % 100, (7, 8, 9, 10, 11)),
        "three of other lengths": ((k >= 50) & (k < 55)) | ((k >= 200) & (k < 290)) | ((k >= 450) & (k < 480)),
        "at the start, and again": (k < 5) | ((k >= 200) & (k < 212)),
        "at the end": k >= 540,
    }[kind]


NULL_ISLAND, NEAR = (-3e5, -5.8e6), (3000.0, 200.0)


@pytest.mark.parametrize(
    ("kind", "position"),
    [
        ("six short ones", NULL_ISLAND),
        ("three of other lengths", NEAR),
        ("at the start, and again", NULL_ISLAND),
        ("at the end", NULL_ISLAND),
        ("at the end", NEAR),
    ],
)
def test_bursts_at_one_wrong_position_are_refused_and_no_good_fix_is(kind, position):
    t, _, z = ride()
    bad = bad_rows(kind)
    z[bad] = position
    if kind == "at the end" and position[0] > 0:  # a jump of 3 km that stays, as far as anybody can tell
        assert len(clean(t, z).starts) == 1
        return
    c = clean(t, z)
    np.testing.assert_array_equal(c.refused, np.flatnonzero(bad))
    assert c.q < 0.1
    assert c.r == pytest.approx(4.0, rel=0.2)


def test_wrong_fixes_at_the_end_of_a_tunnel_are_refused():
    """Those after 45 s without a fix are no further off than the motion allows, but the track jumps back from them."""
    t, _, z = ride(seed=0)
    z[345:349] += 60.0, -80.0
    left = (t < 300) | (t >= 345)
    c = clean(t[left], z[left])
    np.testing.assert_array_equal(c.refused, np.arange(300, 304))
    assert c.stretches == 1


@pytest.mark.parametrize("rows", [(0, 40), (100, 160), (560, 600)])
def test_a_wrong_position_while_the_mobile_rests_is_refused(rows):
    t, true, z = ride()
    true[50:250] = true[50]
    true[250:] += true[50] - true[250]
    z = true + np.random.default_rng(3).normal(0, 2.0, true.shape)
    z[slice(*rows)] = -3e5, -5.8e6
    np.testing.assert_array_equal(clean(t, z).refused, np.arange(*rows))


@pytest.mark.parametrize(("step", "held", "digit"), [(0.1, 10, 0.0), (1.0, 5, 0.01)])
def test_rows_that_repeat_a_position_while_the_mobile_moves_on_are_no_fixes(step, held, digit):
    """They may differ in the last digit, if the grid of the numbers is known."""
    t, true, z = ride(N=3000 if step < 1 else 600, dt=step, speed=15.0)
    own = np.arange(len(t)) // held * held
    z = z.round(2)
    written = z[own] + digit * np.random.default_rng(4).integers(0, 2, z.shape)
    c = clean(t, written, rounding=0.01**2 / 12)
    np.testing.assert_array_equal(c.repeats, own != np.arange(len(t)))
    assert c.said == [f"{c.repeats.sum()} rows repeat a position while the mobile moves on: they are no fixes"]
    assert len(c.refused) == 0
    alone = clean(t[::held], z[::held])
    assert (c.q, c.r) == pytest.approx((alone.q, alone.r), rel=0.02)
    np.testing.assert_allclose(c.x[::held], alone.x, atol=0.1)
    error = np.linalg.norm(c.x[:, ::2] - true, axis=1)[: -held + 1]
    assert mpt.metrics.rms(error) < 1.5 * mpt.metrics.rms(np.linalg.norm(alone.x[:, ::2] - true[::held], axis=1))
    assert c.report().count("no fixes") == 1


def bursts(rng):
    """Ten fixes, and five minutes without one."""
    t = np.arange(0.0, 7200.0, 2.0)
    t = t[t % 310 < 20]
    return t, np.column_stack([5 * t, 0 * t]) + 3 * rng.standard_normal((len(t), 2))


def wild(rng):
    """A fix in 26 is kilometres off."""
    t, true, _ = ride()
    z = true + 3 * rng.standard_normal((600, 2))
    far = np.flatnonzero(rng.random(600) < 1 / 26)
    angle, distance = rng.uniform(0, 2 * np.pi, len(far)), rng.uniform(1000, 4000, len(far))
    z[far] += distance[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return t, z


@pytest.mark.parametrize("recording", [bursts, wild])
def test_positions_that_differ_are_fixes_however_long_other_steps_are(recording):
    c = clean(*recording(np.random.default_rng(1)))
    assert not c.repeats.any()
    assert c.r == pytest.approx(9.0, rel=0.2)


def test_a_mobile_at_rest_repeats_its_position_and_its_fixes_count():
    t, _, z = ride()
    z = z.round(1)
    z[200:320] = z[200]
    c = clean(t, z)
    assert not c.repeats.any()
    assert c.said == []


def test_noise_is_no_repeat_where_recordings_lie_far_apart():
    """Ten fixes each hour, 700 m on: a hundredth of the way between two recordings is more than a fix scatters."""
    t = (3600.0 * np.arange(48)[:, None] + np.arange(10)).ravel()
    z = 0.2 * t[:, None] * [1.0, 0.5] + 3 * np.random.default_rng(1).standard_normal((480, 2))
    c = clean(t, z)
    assert not c.repeats.any()
    assert len(c.recordings) == 48


def test_a_rest_in_a_recording_of_repeats_keeps_a_fix_for_each_repeat():
    t, true, _ = ride(N=3000, dt=0.1, speed=15.0)
    rest = (t > 100) & (t < 160)
    moved = np.where(rest[1:, None], 0, np.diff(true, axis=0))
    true = np.vstack([true[:1], true[0] + np.cumsum(moved, axis=0)])
    z = true[np.arange(3000) // 10 * 10] + 0.0
    z += 2 * np.random.default_rng(5).standard_normal((300, 2))[np.arange(3000) // 10]
    z[rest] = z[1010]
    c = clean(t, z)
    fixes = ~c.repeats & rest
    assert 30 <= fixes.sum() <= 61
    assert c.stretches == 1


def test_of_fixes_at_one_time_the_last_counts():
    """A receiver that catches up: five fixes, all with the time of the newest."""
    t, true, z = ride(speed=15.0)
    burst = np.minimum(np.arange(600) // 5 * 5 + 4, 599)
    c = clean(t[burst], z)
    np.testing.assert_array_equal(np.flatnonzero(~c.repeats), np.arange(4, 600, 5))
    assert c.said == ["480 fixes have the time of the next one: only the last of each time counts"]
    error = c.x[4::5, ::2] - true[4::5]
    assert mpt.metrics.rms(np.linalg.norm(error, axis=1)) < 2.2
    assert c.r == pytest.approx(4.0, rel=0.35)


def test_of_fixes_at_one_time_in_a_file_the_newest_is_read(tmp_path):
    t, _, z = ride()
    path = gpx(tmp_path / "burst.gpx", t[np.minimum(np.arange(600) // 5 * 5 + 4, 599)], *degrees(z))
    c = mpt.track(path)
    np.testing.assert_array_equal(c.source.rows, np.arange(4, 600, 5))


@pytest.fixture(scope="module")
def plain():
    """A ride without any fault, cleaned."""
    t, _, z = ride()
    return clean(t, z)


@pytest.mark.parametrize("years", [0.02, 40])
def test_a_long_pause_is_two_segments(years, plain):
    t, _, z = ride()
    c = clean(np.where(np.arange(600) < 300, t, t + years * 365 * 86400), z)
    assert (c.stretches, len(c.refused), c.recordings) == (2, 0, [0, 300])
    days = f"{years * 365:,.0f}"
    assert c.said == ([f"ATTENTION: for {days} days there is no fix: are the dates right?"] if years > 1 else [])
    assert (c.q, c.r) == pytest.approx((plain.q, plain.r), rel=0.15)
    low, high = c.plot().axes[1].get_xlim()
    assert high - low < (30 if years > 1 else 1e5)  # minutes: the pause is left out


def test_a_few_fixes_years_away_are_faults_of_time():
    t, _, z = ride()
    t[:4] -= 19.6 * 365.25 * 86400
    c = clean(t, z)
    np.testing.assert_array_equal(c.refused, np.arange(4))
    assert c.said == ["refused: 4 fixes whose time is months or years from all others"]
    low, high = c.plot().axes[1].get_xlim()
    assert high - low < 15  # minutes


@pytest.mark.parametrize(("row", "when"), [(0, "0:00:00"), (599, "0:09:59")])
def test_the_time_of_a_fault_at_an_end_is_told(row, when):
    t, _, z = ride()
    z[row] += 500.0
    assert f"refused as faults: 1 fix (0.17%), {when} after the start" in clean(t, z).report()


def test_segments_out_of_order_keep_their_times_and_say_so(tmp_path):
    t, _, z = ride(N=900)
    z[100] += 400.0
    order = np.r_[300:600, 600:900, 0:300]
    path = gpx(tmp_path / "order.gpx", t[order], *degrees(z[order]), segment=np.repeat([0, 1, 2], 300))
    c = mpt.track(path)
    assert "900 fixes in 0:14:59" in c.report()
    assert "0:01:40 after the start" in c.report()
    assert "segments are not in order of time" in c.report()
    np.testing.assert_array_equal(c.refused, [700])
    c.gpx(tmp_path / "smooth.gpx")
    assert [each.t[0] for each in mpt.tracks.gpx(tmp_path / "smooth.gpx")] == [0, 300, -300]


def test_two_receivers_in_one_file_keep_their_times(tmp_path):
    t, _, z = ride(N=900)
    other = z + np.random.default_rng(9).normal(0, 1, z.shape)
    other[700] += 400.0
    path = gpx(tmp_path / "two.gpx", np.r_[t, t], *degrees(np.vstack([z, other])), segment=np.repeat([0, 1], 900))
    c = mpt.track(path)
    assert "1,800 fixes in 0:14:59" in c.report()
    assert "0:11:40 after the start" in c.report()
    assert "overlap in time" in c.report()


@pytest.mark.parametrize(("apart", "asked"), [(30.0, True), (0.0, False)])
def test_two_receivers_in_turn_are_asked_about(apart, asked, tmp_path):
    """Nothing else in the file tells them apart, and the line runs midway between them."""
    t, _, z = ride()
    z[::2, 1] += apart
    c = mpt.track(gpx(tmp_path / "two.gpx", t, *degrees(z)))
    assert ("every other fix lies on a path of its own" in " ".join(c.report().split())) == asked


@pytest.mark.parametrize("step", [0.7, 1.5])
def test_one_receiver_whose_times_are_rounded_is_not(step):
    t, _, z = ride(dt=step, speed=30.0, noise=0.5)
    assert not any("every other fix" in each for each in clean(np.floor(t), z).unusual)


def test_times_that_run_back_within_a_segment_are_refused():
    t, _, z = ride()
    with pytest.raises(ValueError, match="t: needs times that do not decrease within a segment, got less in row 300"):
        clean(np.where(np.arange(600) < 300, t + 1000, t), z, segment=np.arange(600) // 200)


@pytest.mark.parametrize(("km", "step", "speed", "noise"), [(9000, 30, 250.0, 0.0), (6000, 600, 8.0, 30.0)])
def test_a_flight_along_the_earth_has_its_length_its_speed_and_no_jump(km, step, speed, noise, tmp_path):
    N = int(km * 1000 / (speed * step)) + 1
    s = np.arange(N) * step * speed / RADIUS
    lat0, azimuth = np.radians(35), np.radians(60)
    lat = np.degrees(np.arcsin(np.sin(lat0) * np.cos(s) + np.cos(lat0) * np.sin(s) * np.cos(azimuth)))
    up = np.cos(s) - np.sin(lat0) * np.sin(np.radians(lat))
    lon = (140 + np.degrees(np.arctan2(np.sin(azimuth) * np.sin(s) * np.cos(lat0), up)) + 180) % 360 - 180
    e, n = np.random.default_rng(3).normal(0, noise, (2, N)) / RADIUS
    path = gpx(
        tmp_path / "far.gpx", step * np.arange(N), lat + np.degrees(n), lon + np.degrees(e / np.cos(np.radians(lat)))
    )
    c = mpt.track(path)
    assert (len(c.starts), len(c.refused)) == (0, 0)
    found = c.summary()
    true = geodesy.earth_centred(lat, lon, 0.0)  # the sphere of the test is not the Earth
    length = np.linalg.norm(np.diff(true, axis=1), axis=0).sum()
    assert found["kilometres"] == pytest.approx(length / 1000, rel=1e-4)
    assert found["median_speed_km_h"] == pytest.approx(3.6 * length / (step * (N - 1)), rel=2e-3)
    c.gpx(tmp_path / "smooth.gpx")
    written = mpt.tracks.gpx(tmp_path / "smooth.gpx", origin=(0.0, 0.0))  # read only for its count
    assert [len(each.t) for each in written] == [N]
    off = np.linalg.norm(geodesy.earth_centred(*mpt.tracks.report.degrees_of(c, c.x[:, ::2]), 0.0) - true, axis=0)
    assert off.max() < max(noise, 0.1)


def test_frame_file_picture_and_report_of_a_flight_agree_on_its_speed_and_course(tmp_path):
    """Along a parallel for 130°, where the chart shows a bow: its north is up to 56° off, its metres 1.4 % too long."""
    lat, lon = np.full(1100, 55.0), -60 + 0.1176 * np.arange(1100)
    c = mpt.track(gpx(tmp_path / "far.gpx", 30 * np.arange(1100), lat, lon))

    def speeds(lat, lon):
        return np.linalg.norm(np.diff(geodesy.earth_centred(lat, lon, 0.0), axis=1), axis=0) / 30

    speed = speeds(lat, lon).mean()
    frame = c.to_frame()
    np.testing.assert_allclose(frame["v_x"], speed, rtol=1e-4)
    np.testing.assert_allclose(np.degrees(np.arctan2(frame["v_x"], frame["v_y"])), 90, atol=0.1)
    np.testing.assert_allclose(speeds(frame["lat"], frame["lon"]), speed, rtol=1e-6)
    drawn = max(c.plot().axes[1].lines, key=lambda line: len(line.get_ydata())).get_ydata()
    np.testing.assert_allclose(drawn, 3.6 * speed, rtol=1e-4)
    assert c.summary()["median_speed_km_h"] == pytest.approx(3.6 * speed, rel=1e-4)
    c.gpx(tmp_path / "smooth.gpx")
    written = readers.read(tmp_path / "smooth.gpx")
    np.testing.assert_allclose([written.lat, written.lon], frame[["lat", "lon"]].T, atol=1e-8)


def test_a_chart_gives_degrees_back_and_distances_from_its_middle():
    """Over a third of the Earth: the way to the middle is that of the sphere, to the Earth's flattening."""
    rng = np.random.default_rng(4)
    lat, lon = 30 + np.cumsum(rng.uniform(0, 0.35, 150)), 150 + np.cumsum(rng.uniform(0, 1.0, 150))
    (chart,), number, z = geodesy.charts_of(lat, (lon + 180) % 360 - 180, np.zeros(150, int))
    assert not number.any()
    back = chart.degrees(z)
    np.testing.assert_allclose(back[0], lat, atol=1e-9)
    np.testing.assert_allclose((back[1] - lon + 180) % 360 - 180, 0, atol=1e-9)
    up = geodesy.axes_at(lat, lon)[2]
    angle = np.arccos(np.clip(geodesy.axes_at(chart.lat, chart.lon)[2] @ up, -1, 1))
    np.testing.assert_allclose(np.linalg.norm(z, axis=1), RADIUS * angle, rtol=6e-3, atol=0.2)


@pytest.mark.parametrize("lat", [0.0, 57.0, -89.0])
def test_metres_near_the_middle_of_a_chart_are_those_of_the_plane(lat):
    chart = geodesy.Chart(lat, 179.99)
    z = np.random.default_rng(5).uniform(-2000, 2000, (50, 2))
    plane = geodesy.to_plane(*chart.degrees(z), (lat, 179.99, 0.0))
    # Half of what the meridian's radius changes by over 2 km.
    np.testing.assert_allclose(plane, z, rtol=3e-6, atol=1e-3)


def test_a_way_around_the_earth_is_refused(tmp_path):
    path = gpx(tmp_path / "round.gpx", 3600 * np.arange(1400), np.full(1400, 5.0), np.arange(1400) / 4 - 175)
    with pytest.raises(ValueError, match="track: needs segments that stay within 15,000 km of their middle, got 18,"):
        mpt.track(path)


def test_a_stop_is_found_beside_errors_that_last():
    """An hour with a rest of 20 minutes, while the fixes wander about."""
    N, rng = 3600, np.random.default_rng(1)
    t = np.arange(float(N))
    v = np.where((t > 1200) & (t < 2400), 0, 5.0)
    heading = np.cumsum(rng.normal(0, 0.03, N))
    true = np.cumsum(np.column_stack([np.sin(heading), np.cos(heading)]) * v[:, None], axis=0)
    error = rng.standard_normal((N, 2))
    for k in range(1, N):
        error[k] = 0.95 * error[k - 1] + np.sqrt(1 - 0.95**2) * error[k]
    found = clean(t, true + 4.0 * error).summary()
    assert found["moving_seconds"] == pytest.approx(2401, abs=40)
    assert found["kilometres"] == pytest.approx(v.sum() / 1000, rel=0.02)


def test_a_walk_with_stops_of_half_a_minute_to_two_has_its_length_and_its_time_in_motion():
    """Fixes with an error that lasts for half a minute; the time before a stop and after it counted as rest."""
    rng = np.random.default_rng(1)
    t = np.arange(3600.0)
    stops, begin = np.zeros(3600, dtype=bool), 100
    while begin < 3600:
        end = begin + int(rng.uniform(30, 120))
        stops[begin:end] = True
        begin = end + int(rng.uniform(100, 300))
    heading = np.cumsum(rng.normal(0, 0.03, 3600))
    v = np.where(stops, 0.0, 1.4)
    true = np.cumsum(np.column_stack([np.sin(heading), np.cos(heading)]) * v[:, None], axis=0)
    error = 1.5 * rng.standard_normal((3600, 2))
    for k in range(1, 3600):
        error[k] = np.exp(-1 / 30) * error[k - 1] + np.sqrt(1 - np.exp(-2 / 30)) * error[k]
    found = clean(t, true + error).summary()
    assert found["moving_seconds"] == pytest.approx((~stops).sum(), rel=0.05)
    assert found["kilometres"] == pytest.approx(v.sum() / 1000, rel=0.03)


def test_a_player_who_runs_about_in_a_small_place_is_no_stop():
    t = np.arange(600.0)
    z = 8 * np.column_stack([np.sin(t / 3), np.sin(t / 4)]) + np.random.default_rng(2).normal(0, 0.3, (600, 2))
    assert clean(t, z).summary()["moving_seconds"] > 500


def test_rounded_walks_with_rests_are_cleaned_or_said_to_stand_still():
    """Seventeen of a hundred were refused for the gaps between segments, which clean itself had made."""
    still = []
    for seed in (*range(12), 26):  # the last one's line is straight, and the rounding of "across" was negative
        rng = np.random.default_rng(seed)
        n = int(rng.integers(10, 60))
        z = np.cumsum(rng.normal(size=(n, 2)) * (rng.random((n, 1)) < 0.3), axis=0).round(0)
        t = np.cumsum(rng.choice([1.0, 1.0, 5.0, 100.0], n))
        try:
            c = clean(t, z)
        except ValueError as error:
            still.append(str(error))
        else:
            assert np.isfinite(c.x[c.mask]).all()
            assert "refused as faults" in c.report()
    assert len(still) < 3
    assert all("z: needs a track that moves" in each for each in still)


SHORT = ride(N=300)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"segment": np.zeros(299)}, r"segment: needs a number or a name for each of 300 rows, got shape \(299,\)"),
        ({"rounding": np.nan}, "rounding: needs a number that is not negative, got nan"),
        ({"rounding": "1"}, "rounding: needs a number that is not negative"),
        ({"t": np.r_[np.zeros(299), 1.0]}, "t: needs at least 10 fixes at different times, got 2"),
        ({"t": np.ma.masked_greater(SHORT[0], 295)}, "t: needs .* got a masked array"),
        ({"pause": 0.5}, "pause: needs recordings of three fixes and more, got 300 recordings of 300 fixes"),
        ({"limit": 0.99}, "limit: needs a squared distance in variances, above 1"),
        (
            {"z": np.where(np.arange(300)[:, None] % 2 == [0, 1], SHORT[2], np.nan)},
            "z: needs at least 10 fixes with all axes, got 0",
        ),
    ],
)
def test_what_cannot_be_cleaned_is_refused_by_name(given, said):
    given = {"t": SHORT[0], "z": SHORT[2]} | given
    with pytest.raises((ValueError, TypeError), match=said):
        clean(**given)


def test_segments_may_have_names_and_dates_for_times():
    _, _, z = SHORT
    dates = np.datetime64("2024-05-03T10:00", "s") + np.r_[150:300, 0:150].astype("m8[s]")
    c = clean(dates, z, segment=["a"] * 150 + ["b"] * 150)
    assert c.recordings == [0, 150]
    np.testing.assert_array_equal(c.t, np.r_[150:300, 0:150])


def test_years_that_cannot_be_are_unread_and_the_others_count(tmp_path):
    """A double holds the microseconds of three centuries, and an old pandas the nanoseconds of six."""
    t, _, z = ride(N=100)
    path = gpx(tmp_path / "years.gpx", t, *degrees(z))
    text = path.read_text().replace("2022-05-03T09:15:40Z", "0001-01-01T00:00:00Z")
    path.write_text(text.replace("2022-05-03T09:15:50Z", "9999-12-31T00:00:00Z"))
    c = mpt.track(path)
    assert c.source.left_out == {"no time that can be read": 2}
    assert len(c.refused) == 0


def test_the_time_in_motion_of_a_glider_is_known_although_its_speed_is_not():
    """At 30 m/s, circling, where a speed is known to more than MOVING: no row is near a rest."""
    t = np.arange(0, 1800.0, 3.0)
    z = np.column_stack([400 * np.sin(t / 13), 400 * np.cos(t / 13) + 5 * t])
    found = clean(t, z + np.random.default_rng(4).normal(0, 3.0, z.shape)).summary()
    assert found["speed_error_km_h"] > 3.6 * 0.5
    assert found["moving_seconds"] == pytest.approx(1797, abs=6)


def test_a_cleaned_track_is_equal_to_itself_only(plain):
    c, again = plain, deepcopy(plain)
    assert c == c
    assert c != again
    assert c.band != again.band
    assert len({c, again}) == 2


def test_the_noise_of_fixes_that_the_motion_hides_is_assumed_and_the_covariance_holds_the_truth():
    """A car with a fix every 12 s: r came out as 1e-5 of the true one, and 1 % of the truth lay within 95 % of P."""
    axis = mpt.constant_velocity(dt=12.0, q=1.0, r=1.0)
    x, z = mpt.simulate(mpt.stack(axis, axis), 450, np.random.default_rng(1))
    c = clean(12.0 * np.arange(450), z, rounding=1e-6)
    assert c.log_errors["r"] == np.inf
    assert not c.rounding
    assert 1.0 < c.r < 10.0
    sigma = np.sqrt(np.diagonal(c.P, axis1=1, axis2=2))
    assert np.mean(np.abs(c.x - x) < 1.96 * sigma) > 0.93
    assert "their errors cannot be told from the motion between them" in " ".join(c.report().split())


@pytest.mark.parametrize(("step", "asked"), [(5, False), (20, True)])
def test_stops_that_the_fixes_are_too_rare_for_show_as_scatter_along_the_way_and_are_asked_about(step, asked):
    """A hiker who stops for 20 s of each minute: the line came out worse than the fixes (8 against 4 m), unsaid."""
    rng = np.random.default_rng(1)
    seconds = np.arange(5400)
    heading = np.cumsum(rng.normal(0, 0.05, 5400))
    v = np.where(seconds % 60 < 40, 1.4, 0.0)
    true = np.cumsum(np.column_stack([np.sin(heading), np.cos(heading)]) * v[:, None], axis=0)[::step]
    z = true + 2.9 * rng.standard_normal(true.shape)
    c = clean(1.0 * seconds[::step], z)
    worse = mpt.metrics.rms(c.x[:, ::2] - true) > mpt.metrics.rms(z - true)
    assert worse == asked
    assert any("m along the way, but by" in each for each in c.unusual) == asked
    assert len(c.unusual) == asked


def car_in_a_town(step):
    """Straight streets at 12 m/s, and at each corner a turn, or none."""
    rng = np.random.default_rng(3)
    street = np.repeat(np.arange(200), rng.integers(12, 66, 200))[:5400]
    heading = np.cumsum(rng.integers(-1, 2, 200))[street] * np.pi / 2
    return np.arange(0, 5400, 1.0)[::step], np.cumsum(12 * np.column_stack([np.sin(heading), np.cos(heading)]), axis=0)[
        ::step
    ]


def glider(step):
    """A turn in half a minute, and a slow drift."""
    t = np.arange(0, 1800.0, step)
    return t, np.column_stack([100 * np.sin(t / 5), 100 * np.cos(t / 5) + 5 * t])


@pytest.mark.parametrize(
    ("motion", "step", "known"),
    [
        *[(car_in_a_town, 1, True), (car_in_a_town, 30, False)],
        *[(glider, 1, True), (glider, 4, False)],
        *[pytest.param(*each, False, marks=pytest.mark.slow) for each in ((car_in_a_town, 60), (glider, 10))],
    ],
)
def test_no_line_is_worse_than_its_fixes_or_claims_more_than_they_tell(motion, step, known):
    """Of fixes good to 3 m, sqrt(r) was 150 m in a town, with a line 40 times worse, or 0.2 m where a glider turns."""
    t, true = motion(step)
    z = true + 3 * np.random.default_rng(1).standard_normal(true.shape)
    c = clean(t, z)
    kept = c.mask
    assert mpt.metrics.rms((c.x[:, ::2] - true)[kept]) < 1.03 * mpt.metrics.rms((z - true)[kept])
    assert np.isfinite(c.log_errors["r"]) == known
    assert [each[:54] for each in c.unusual] == ["ATTENTION: the errors of the fixes cannot be told from"] * (not known)
    sigma = np.sqrt(np.diagonal(c.P, axis1=1, axis2=2))[:, ::2]
    assert np.mean((np.abs(c.x[:, ::2] - true) < 1.96 * sigma)[kept]) > 0.8


def test_faults_that_are_too_many_to_be_refused_are_told():
    t, _, z = ride(N=900)
    rng = np.random.default_rng(1)
    far = rng.random(900) < 0.1
    z[far] += rng.choice([-1, 1], (far.sum(), 2)) * rng.uniform(100, 300, (far.sum(), 2))
    c = clean(t, z)
    assert any("of the fixes are more than 6 times as far from the smoothed line" in each for each in c.unusual)


@pytest.mark.parametrize(("empty", "said"), [(0.2, "fixes are weighted by their"), (0.7, "is not used: only 26%")])
def test_an_accuracy_is_used_where_most_fixes_have_one_and_else_its_absence_is_told(empty, said):
    rng = np.random.default_rng(0)
    t = np.arange(600.0)
    accuracy = np.where(rng.random(600) < 0.3, 20.0, 3.0)
    x, y = np.column_stack([1.4 * t, 100 * np.sin(t / 200)]).T + accuracy * rng.standard_normal((2, 600))
    accuracy[rng.random(600) < empty] = np.nan
    frame = pandas.DataFrame({"time": t, "x": x, "y": y, "accuracy": accuracy})
    assert said in mpt.track(frame).report()


def test_a_step_of_a_tenth_of_a_second_is_told_as_that_though_unix_times_are_rounded():
    _, _, z = ride(N=300, dt=0.1)
    frame = pandas.DataFrame({"time": 1714723200 + 0.1 * np.arange(300), "x": z[:, 0], "y": z[:, 1]})
    assert "in 0:00:30, every 0.1 s" in mpt.track(frame).report()


def test_coarse_digits_are_not_called_smoothing(plain):
    said = replace(plain, rounding=True, r=11**2 / 12).report()
    assert "do not show beside the rounding of the numbers" in " ".join(said.split())
    assert "smoothed them already" in " ".join(replace(plain, rounding=True, r=1e-5).report().split())


def test_fixes_that_are_less_precise_along_the_way_are_no_sign_of_stops():
    t = np.arange(300.0)
    true = np.column_stack([5.0 * t, 0.1 * t])
    sigma = np.array([6.0, 2.0])
    z = true + sigma * np.random.default_rng(5).standard_normal((300, 2))
    assert clean(t, z, r=np.tile(sigma**2, (300, 1))).unusual == []
    assert "along the way" in clean(t, z).unusual[0]


@pytest.mark.parametrize(("axes", "names"), [(1, ["x"]), (3, ["x", "y", "z"]), (4, ["x0", "x1", "x2", "x3"])])
def test_a_frame_has_a_column_for_each_axis(axes, names):
    rng = np.random.default_rng(3)
    z = np.cumsum(rng.standard_normal((300, axes)), axis=0) + rng.standard_normal((300, axes))
    c = clean(np.arange(300.0), z)
    np.testing.assert_array_equal(c.to_frame()[names], c.x[:, ::2])
    assert c.to_frame().shape[1] == 1 + 2 * axes + 4
    assert "way:" in c.report()
    assert len(c.plot().axes) == 2


def test_sigma_of_a_frame_is_that_of_the_worse_axis():
    t = np.arange(300.0)
    rng = np.random.default_rng(2)
    z = np.column_stack([5 * t, 3 * t]) + rng.normal(0, [1.0, 4.0], (300, 2))
    c = mpt.tracks.clean(t, z, r=np.tile([1.0, 16.0], (300, 1)))
    frame = c.to_frame()
    np.testing.assert_allclose(frame["sigma"], np.sqrt(c.P[:, 2, 2]))
    assert (c.P[:, 2, 2] > c.P[:, 0, 0])[c.mask].all()
