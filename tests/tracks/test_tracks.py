"""Recorded tracks: from GPX files, and from degrees to metres."""

import itertools
import re
import warnings
from datetime import UTC, datetime
from math import cos, hypot, radians, sin

import numpy as np
import pytest
from conftest import ROOT

from mpt_helpers import tracks

HEAD = '<gpx version="1.1" creator="test" xmlns="http://www.topografix.com/GPX/1/1"><trk>'


def fix(time, lat=57.0, lon=9.9, ele=None):
    """A fix of a GPX file; time may be an hour's seconds or text."""
    time = f"2024-05-03T12:{time // 60:02.0f}:{time % 60:06.3f}Z" if isinstance(time, int | float) else time
    inside = ("" if time is None else f"<time>{time}</time>") + ("" if ele is None else f"<ele>{ele}</ele>")
    return f'<trkpt lat="{lat}" lon="{lon}">{inside}</trkpt>'


@pytest.fixture
def written(tmp_path):
    """Write a GPX file of segments, lists of fixes, and return its path."""

    def write(*segments, encoding="utf-8", head='<?xml version="1.0" encoding="UTF-8"?>'):
        body = "".join(f"<trkseg>{''.join(fixes)}</trkseg>" for fixes in segments)
        path = tmp_path / "track.gpx"
        path.write_bytes(f"{head}{HEAD}{body}</trk></gpx>".encode(encoding))
        return path

    return write


def test_segments_stay_apart_in_seconds_of_one_start_and_metres_from_their_own_first_fix(written):
    path = written([fix(10), fix(12.5, lat=57.001)], [], [fix(60, lon=9.91, ele=30), fix(61, lat=57.001, lon=9.91)])
    first, second = tracks.gpx(path)
    np.testing.assert_array_equal(first.t, [0, 2.5])
    np.testing.assert_array_equal(second.t, [50, 51])
    for track in (first, second):
        np.testing.assert_allclose(track.z, [[0, 0], [0, 111.36]], atol=0.01)
        assert track.start == datetime(2024, 5, 3, 12, 0, 10, tzinfo=UTC)
    assert first.origin == (57.0, 9.9, 0.0)
    assert second.origin == (57.0, 9.91, 30.0)


@pytest.mark.parametrize("height", [0.0, 30.0])
def test_an_origin_that_is_given_puts_all_segments_into_one_plane(written, height):
    path = written([fix(10, ele=40), fix(12.5, lat=57.001)], [fix(60, lon=9.91)])
    given = (57.0, 9.9, height) if height else (57.0, 9.9)
    first, second = tracks.gpx(path, origin=given, up=True)
    np.testing.assert_allclose(first.z[:, :2], [[0, 0], [0, 111.36]], atol=0.01)
    np.testing.assert_allclose(second.z[:, :2], [[607.72, 0.04]], atol=0.01)
    np.testing.assert_array_equal(first.z[:, 2], [40 - height, np.nan])
    assert first.origin == second.origin == (57.0, 9.9, height)


def test_segments_2000_km_apart_have_the_same_metres_as_alone(written):
    far = [fix(60, lat=40.0, lon=-3.0), fix(61, lat=40.05, lon=-2.9)]
    (_, second), (alone,) = tracks.gpx(written([fix(0)], far)), tracks.gpx(written(far))
    np.testing.assert_array_equal(second.z, alone.z)
    length = np.hypot(*np.diff(tracks.gpx(written([fix(0)], far), origin=(57.0, 9.9))[1].z, axis=0)[0])
    assert length < 0.99 * np.hypot(*alone.z[1])  # in the plane of another place


def test_a_segment_is_cut_where_nothing_came_for_longer_than_a_pause(written):
    times = [0, 1, 61, 62, 122.5, 123]
    path = written([fix(time, lon=9.9 + row / 1000) for row, time in enumerate(times)], [fix(200)])
    parts = tracks.gpx(path, pause=60)
    assert [part.t.tolist() for part in parts] == [[0, 1, 61, 62], [122.5, 123], [200]]
    np.testing.assert_allclose([part.z[0] for part in parts], 0, atol=1e-9)
    assert parts[1].origin == (57.0, 9.904, 0.0)
    assert [len(part.t) for part in tracks.gpx(path)] == [6, 1]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"pause": 0}, "pause: needs a positive number"),
        ({"pause": "60"}, "pause: needs a positive number"),
        ({"origin": (57.0,)}, "origin: needs a latitude, a longitude"),
        ({"origin": (570.0, 9.9)}, "origin: needs a latitude, a longitude"),
        ({"origin": (57.0, np.nan)}, "origin: needs a latitude, a longitude"),
        ({"origin": "Aalborg"}, "origin: needs a latitude and a longitude"),
    ],
)
def test_a_pause_or_an_origin_that_is_none_is_refused(written, given, said):
    with pytest.raises((ValueError, TypeError), match=said):
        tracks.gpx(written([fix(0)]), **given)


def test_heights_are_a_column_where_they_are_wanted_and_nan_where_the_file_has_none(written):
    path = written([fix(0, ele=30), fix(1), fix(2, ele=42.5)])
    (track,) = tracks.gpx(path, up=True)
    np.testing.assert_array_equal(track.z[:, 2], [0, np.nan, 12.5])
    assert tracks.gpx(path)[0].z.shape == (3, 2)
    (track,) = tracks.gpx(written([fix(0, ele="NaN"), fix(1, ele=30), fix(2, ele=31)]), up=True)
    np.testing.assert_array_equal(track.z[:, 2], [np.nan, 0, 1])  # above the first height that is known
    assert track.origin[2] == 30


@pytest.mark.parametrize(
    ("fixes", "said"),
    [
        ([fix(0), fix(1), fix(1)], "got 1 with a time that is not after the one before, first in fix 2 of segment 2"),
        ([fix(0), fix(9), fix(4)], "got 1 with a time that is not after the one before, first in fix 2 of segment 2"),
        ([fix(99), fix(1), fix(2)], "got 1 with a time that is not after the one before, first in fix 1 of segment 2"),
        ([fix(0), fix(None), fix(None)], "got 2 with no time that can be read, first in fix 2 of segment 2"),
    ],
)
def test_a_time_that_repeats_runs_back_or_is_missing_is_refused_by_row_with_the_way_out(written, fixes, said):
    path = written([fix(0)], fixes)
    with pytest.raises(
        ValueError, match=rf"track.gpx: needs a position and a later time in each fix, {said}.*skip=True"
    ):
        tracks.gpx(path)
    with pytest.warns(UserWarning, match=said.removeprefix("got ").split(",")[0]):
        segments = tracks.gpx(path, skip=True)
    assert len(segments) == 2
    assert (np.diff(segments[1].t) > 0).all()
    assert len(segments[1].t) == (1 if "no time" in said else 2)


def test_one_clock_error_does_not_cost_the_fixes_after_it(written):
    times = [*range(10), 3000, *range(11, 60), *range(40, 70)]
    path = written([fix(time) for time in times])
    with pytest.raises(ValueError, match=r"got 21 with a time .* first in fix 11 of"):
        tracks.gpx(path)
    with pytest.warns(UserWarning, match="fixes left out: 21 with a time"):
        (track,) = tracks.gpx(path, skip=True)
    np.testing.assert_array_equal(track.t, [*range(10), *range(11, 70)])


def test_the_order_that_is_kept_is_as_long_as_any(written):
    """Against all subsequences of short tracks."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        times = rng.integers(0, 9, 7)
        kept = [times[list(rows)] for n in range(8) for rows in itertools.combinations(range(7), n)]
        longest = max(len(each) for each in kept if (np.diff(each) > 0).all())
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of what was left out
            (track,) = tracks.gpx(written([fix(int(time)) for time in times]), skip=True)
        assert len(track.t) == longest
        assert (np.diff(track.t) > 0).all()


def test_names_with_a_prefix_are_read(written):
    path = written([fix(0, ele=3), fix(1)], [fix(9)])
    plain = tracks.gpx(path, up=True)
    path.write_text(re.sub(r"(</?)(?=[a-z])", r"\1gpx:", path.read_text()).replace("xmlns=", "xmlns:gpx="))
    assert "<gpx:trkpt lat" in path.read_text()
    for track, other in zip(tracks.gpx(path, up=True), plain, strict=True):
        np.testing.assert_array_equal(track.z, other.z)
        np.testing.assert_array_equal(track.t, other.t)


@pytest.mark.parametrize(("lat", "lon"), [("NaN", 9.9), (150, 9.9), (57.0, 6.3e6)])
def test_degrees_that_are_none_are_refused_by_fix(written, lat, lon):
    with pytest.raises(
        ValueError, match=r"track.gpx: needs (a position and .* fix 2 of segment 1|degrees of .* got (150|57) and)"
    ):
        tracks.gpx(written([fix(0), fix(1, lat=lat, lon=lon)]))


def test_fractions_of_a_second_are_kept_and_a_time_without_a_zone_is_utc(written):
    (track,) = tracks.gpx(written([fix("2024-05-03T12:00:00"), fix(0.25), fix("2024-05-03T14:00:01+02:00")]))
    np.testing.assert_array_equal(track.t, [0, 0.25, 1])


@pytest.mark.parametrize(
    ("encoding", "name"),
    [("utf-8", "UTF-8"), ("utf-8-sig", "UTF-8"), ("latin-1", "ISO-8859-1"), ("utf-8", None)],
)
def test_files_of_other_encodings_are_read(written, encoding, name):
    head = f'<?xml version="1.0" encoding="{name}"?><!-- Ålborg -->' if name else "<!-- Ålborg -->"
    for each in (head, head.replace("encoding=", "encoding = ")):
        assert len(tracks.gpx(written([fix(0), fix(1)], encoding=encoding, head=each))[0].t) == 2


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time,x,y\n1,2,3\n", "needs a recorded track in degrees, got 1 fixes$"),
        ("", "needs columns time and lat, lon .* got 'nothing'"),
        ("<gpx", "needs a GPX file, got one that cannot be read"),
        (f"{HEAD}</trk></gpx>", "needs a recorded track, got no trkpt: routes and waypoints have no times"),
        (
            f"{HEAD}<trkseg>{fix('17147304')}</trkseg></trk></gpx>",
            "needs ISO 8601, Unix seconds, or seconds from 0 in column 'time', got '17147304'",
        ),
        (
            f"{HEAD}<trkseg>{fix(None)}</trkseg></trk></gpx>",
            "needs a recorded track in degrees, got 1 fixes, 1 with no time that can be read",
        ),
    ],
)
def test_what_is_no_recorded_track_is_refused_by_name(tmp_path, text, said):
    path = tmp_path / "other.gpx"
    path.write_text(text)
    with pytest.raises(ValueError, match=f"other.gpx: {said}"):
        tracks.gpx(path)


def test_a_file_that_is_not_there_is_missing(tmp_path):
    with pytest.raises(FileNotFoundError):
        tracks.gpx(tmp_path / "none.gpx")


def test_metres_are_those_of_the_ellipsoid():
    """Against the radii of curvature of WGS 84 at 57°, some 100 m around the origin."""
    a, e2, lat = 6378137.0, 0.00669437999014, radians(57.0)
    w = np.sqrt(1 - e2 * sin(lat) ** 2)
    north, east = radians(0.001) * a * (1 - e2) / w**3, radians(0.001) * a / w * cos(lat)
    z = tracks.local([57.0, 57.001, 57.0], [9.9, 9.9, 9.901])
    np.testing.assert_allclose(z, [[0, 0], [0, north], [east, 0]], atol=2e-3)


def test_up_in_the_mountains_a_degree_is_longer():
    low, high = (tracks.local([57.0, 57.001], [9.9, 9.9], origin=(57.0, 9.9, height))[1, 1] for height in (0, 3000))
    assert high / low - 1 == pytest.approx(3000 / 6.37e6, rel=0.01)


def test_lengths_100_km_away_are_too_short_by_what_the_docstring_says():
    lat = 57.0 + 100.0 / 111.4
    far, near = tracks.local([57.0, lat, lat + 0.001], [9.9] * 3), tracks.local([lat, lat + 0.001], [9.9, 9.9])
    shorter = 1 - hypot(*(far[2] - far[1])) / hypot(*near[1])
    assert 0.00005 < shorter < 0.00015


def test_a_position_that_is_missing_stays_missing_and_is_no_origin():
    z = tracks.local([np.nan, 57.0, 57.001], [9.9, 9.9, 9.9])
    assert np.isnan(z[0]).all()
    np.testing.assert_allclose(z[1], 0, atol=1e-9)


@pytest.mark.parametrize(
    ("lat", "lon", "said"),
    [
        ([57.0, 57.1], [9.9], "as many latitudes as longitudes"),
        ([[57.0]], [[9.9]], "as many latitudes as longitudes"),
        ([], [], "as many latitudes as longitudes"),
        ([6.3e6], [5e5], "degrees of at most 90 and 360"),
        ([100.0], [57.0], "degrees of at most 90 and 360"),
        ([np.nan], [np.nan], "degrees of at most 90 and 360"),
        (["57"], ["9"], "latitudes"),
    ],
)
def test_other_numbers_are_refused(lat, lon, said):
    with pytest.raises((ValueError, TypeError), match=said):
        tracks.local(lat, lon)


def test_the_track_of_the_guide_is_read():
    (ride,) = tracks.gpx(ROOT / "docs" / "tracks" / "ride.gpx")
    assert ride.z.shape == (4559, 2)
    np.testing.assert_array_equal(np.diff(ride.t), 1)


def test_an_infinite_latitude_is_no_position():
    with pytest.raises(ValueError, match="lat, lon: needs degrees"):
        tracks.local([57.0, np.inf], [9.9, 9.9])
