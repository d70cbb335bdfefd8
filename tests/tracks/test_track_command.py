"""`python -m mpt_helpers track`: what it prints, what it writes, what it refuses, and that it says so in words."""

import itertools
import json
import os
import pickle
import re
import subprocess
import sys
from copy import deepcopy
from datetime import timedelta
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import ROOT

import mpt_helpers as mpt
from mpt_helpers import tracks
from mpt_helpers.__main__ import main
from mpt_helpers.tracks import cleaning, readers, report, writers

RIDE = ROOT / "docs" / "tracks" / "ride.gpx"
PNG = b"\x89PNG"


@pytest.fixture(autouse=True)
def no_pixels(monkeypatch):
    """Pictures are built, and not drawn: only a whole process draws them."""
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda fig, file, **_: file.write(PNG))


CLEANED = {}


def cleaned_once(*track, clean=tracks.clean, **how):
    """The cleaned track. The same fixes, which many tests write in some form to some place, are cleaned once."""
    key = pickle.dumps((track, sorted(how.items())))
    if key not in CLEANED:
        CLEANED[key] = clean(*track, **how)
    return deepcopy(CLEANED[key])


@pytest.fixture(autouse=True)
def once(monkeypatch):
    monkeypatch.setattr(tracks, "clean", cleaned_once)


HEAD = '<?xml version="1.0" encoding="UTF-8"?>\n<gpx version="1.1" creator="test" xmlns="http://www.topografix.com/GPX/1/1">'


def positions(N=300, seed=1):
    """Degrees of a mobile at some 10 m/s, with noise of 2 m."""
    axis = mpt.constant_velocity(dt=1.0, q=0.05, r=4.0, x0=[0.0, 7.0])
    _, z = mpt.simulate(mpt.stack(axis, axis), N, np.random.default_rng(seed))
    return z, *tracks.degrees(z, (57.0, 9.9))


def fix(lat, lon, second, inside=""):
    clock = f"2024-05-03T{10 + second // 3600:02d}:{second // 60 % 60:02d}:{second % 60:02d}Z"
    time = clock if not isinstance(second, str) else second
    return f'<trkpt lat="{lat:.7f}" lon="{lon:.7f}"><ele>30.5</ele><time>{time}</time>{inside}</trkpt>'


def gpx_of(*segments):
    body = "".join(f"<trkseg>{''.join(fixes)}</trkseg>" for fixes in segments)
    return f"{HEAD}<trk><name>Ålborg</name>{body}</trk></gpx>\n"


@pytest.fixture
def spoilt(tmp_path):
    """A file of two segments with an outlier, a jump, heart rates, and a fix without a time."""
    _, lat, lon = positions()
    lat[50] += 0.01
    lat[200:] += 0.01
    hr = "<extensions><x:hr xmlns:x='urn:x'>{}</x:hr></extensions>"
    fixes = [fix(*place, k, hr.format(100 + k)) for k, place in enumerate(zip(lat, lon, strict=True))]
    fixes[20] = re.sub(r"<time>.*</time>", "", fixes[20])
    path = tmp_path / "giro.gpx"
    path.write_text(gpx_of(fixes[:100], fixes[100:]), encoding="utf-8")
    return path


def in_one_line(text):
    return " ".join(text.split())


def said(capsys, *arguments):
    code = main(["track", *map(str, arguments)])
    out, err = capsys.readouterr()
    assert max(map(len, out.splitlines()), default=0) <= 100 or "--json" in arguments or "written" in out
    return code, in_one_line(out), err


def test_the_report_needs_no_vocabulary_and_names_all_that_was_done(spoilt, capsys):
    code, out, err = said(capsys, spoilt)
    assert (code, err) == (0, "")
    assert "giro.gpx: 299 fixes in 0:04:59, every 1 s" in out
    assert "not used: 1 with no time that can be read" in out
    assert "refused as faults: 1 fix (0.33%), 0:00:50 after the start" in out
    assert "jumps that stay: 1, 0:03:20 after the start" in out
    assert re.search(r"prediction: a fix 10 s ahead is predicted to ± \d+", out)
    assert "giro_smooth.gpx" in out
    assert "giro.png" in out
    assert "NIS" not in out
    assert "in 2 parts (pauses, or segments of the file)" in out
    assert (spoilt.parent / "giro.png").read_bytes() == PNG


def test_json_is_one_object_with_the_promised_names(spoilt, capsys):
    code, out, _ = said(capsys, spoilt, "--json")
    found = json.loads(out)
    assert code == 0
    assert (found["fixes"], found["refused"], found["starts"]) == (300, [50], [200])
    assert found["left_out"] == {"no time that can be read": 1}
    assert set(found["log_errors"]) == {"q", "r"}
    assert {"seconds", "half_width", "asked", "held", "own"} <= set(found["ahead"])
    assert found["ahead"]["seconds"] == 10
    assert found["q"] == pytest.approx(0.05, rel=0.7)
    assert found["r"] == pytest.approx(4.0, rel=0.3)
    assert [path.rpartition("/")[2] for path in found["files"]] == ["giro_smooth.gpx", "giro.png"]


def test_the_new_file_keeps_times_heights_segments_and_heart_rates_and_bridges_what_was_refused(spoilt, capsys):
    said(capsys, spoilt)
    text = (spoilt.parent / "giro_smooth.gpx").read_text(encoding="utf-8")
    after = tracks.gpx(spoilt.parent / "giro_smooth.gpx", up=True)
    assert [len(each.t) for each in after] == [99, 100, 100]  # a new one after the jump
    assert text.count("<x:hr") == 299
    assert "Ålborg" in text
    assert text.count("<ele>30.5</ele>") == 299
    z, _, _ = positions()
    smooth = readers.read(spoilt.parent / "giro_smooth.gpx")
    seconds = ((smooth.time - smooth.time[0]) / 1e6).astype(int)
    np.testing.assert_array_equal(seconds, np.delete(np.arange(300), 20))
    there = tracks.local(smooth.lat, smooth.lon, (57.0, 9.9)) - z[seconds]
    there[seconds >= 200] -= np.median(there[seconds >= 200], axis=0)
    assert np.abs(there).max() < 12.0  # the outlier was 1100 m off
    assert mpt.metrics.rms(there) < 2.0  # less than the noise of the fixes


def test_nothing_is_overwritten_unasked_and_what_is_replaced_is_named(spoilt, capsys):
    other = spoilt.parent / "giro_smooth.gpx"
    other.write_text("mine")
    code, out, err = said(capsys, spoilt)
    assert (code, out) == (1, "")
    assert "giro_smooth.gpx: exists; to replace it" in err
    assert other.read_text() == "mine"
    assert not (spoilt.parent / "giro.png").exists()
    code, out, _ = said(capsys, spoilt, "--overwrite")
    assert "(replaced: giro_smooth.gpx)" in out
    own = other.read_bytes()
    assert said(capsys, spoilt)[0] == 1  # its own files, which may have been edited since
    assert other.read_bytes() == own
    assert sorted(path.name for path in spoilt.parent.iterdir()) == ["giro.gpx", "giro.png", "giro_smooth.gpx"]


def test_a_recording_is_not_written_over_even_if_asked_and_a_link_is_replaced_not_followed(spoilt, capsys):
    picture = spoilt.rename(spoilt.with_suffix(".png"))  # a GPX file by another name, in the place of its picture
    before = picture.read_bytes()
    code, _, err = said(capsys, picture, "--overwrite")
    assert code == 1
    assert "giro.png: is the recording itself, which is never overwritten" in err
    assert [path.name for path in spoilt.parent.iterdir()] == ["giro.png"]
    picture.write_bytes(PNG + bytes(9) + b"IHDR")
    assert "giro.png: needs a GPX or CSV file, got a binary file" in said(capsys, picture)[2]
    picture.write_bytes(before)
    picture.rename(spoilt)
    photo = spoilt.parent / "photo.png"
    photo.write_bytes(b"mine")
    picture.symlink_to(photo)
    assert said(capsys, spoilt)[0] == 1
    assert said(capsys, spoilt, "--overwrite")[0] == 0
    assert photo.read_bytes() == b"mine"
    assert spoilt.read_bytes() == before


def test_the_method_replaces_no_file_unasked_and_never_its_source(spoilt):
    before, photo = spoilt.read_bytes(), spoilt.parent / "photo.jpg"
    photo.write_bytes(b"mine")
    c = mpt.track(spoilt)
    with pytest.raises(FileExistsError, match=r"photo.jpg: exists; to replace it give overwrite=True"):
        c.gpx(photo)
    for overwrite in (False, True):
        with pytest.raises(FileExistsError, match=r"giro.gpx: is the recording itself"):
            c.gpx(spoilt, overwrite=overwrite)
    assert (spoilt.read_bytes(), photo.read_bytes()) == (before, b"mine")
    c.gpx(photo, overwrite=True)
    assert b"trkpt" in photo.read_bytes()
    pipe, linked = spoilt.parent / "pipe.gpx", spoilt.parent / "linked.gpx"
    os.mkfifo(pipe)
    os.link(spoilt, linked)
    with pytest.raises(FileExistsError, match=r"pipe.gpx: is a pipe or a device"):
        c.gpx(pipe, overwrite=True)  # a device would be a file afterwards
    with pytest.raises(FileExistsError, match=r"linked.gpx: is the recording itself"):
        c.gpx(linked, overwrite=True)


def test_what_is_written_is_the_recording_as_it_was_read(spoilt):
    """It was read again: a source that had changed meanwhile gave a broken file, or another ride's times."""
    c = mpt.track(spoilt)
    c.gpx(spoilt.parent / "before.gpx")
    spoilt.write_text("another file")
    c.gpx(spoilt.parent / "after.gpx")
    spoilt.unlink()
    c.gpx(spoilt.parent / "gone.gpx")
    written = [(spoilt.parent / f"{name}.gpx").read_bytes() for name in ("before", "after", "gone")]
    assert written[0] == written[1] == written[2]


def test_a_part_of_a_file_beside_it_is_not_overwritten(spoilt, capsys):
    other = spoilt.parent / "giro.png.part"
    other.write_text("mine")
    assert said(capsys, spoilt)[0] == 0
    assert other.read_text() == "mine"


def test_a_pipe_a_device_or_nothing_is_refused_at_once(tmp_path, capsys):
    os.mkfifo(tmp_path / "pipe.gpx")
    with pytest.raises(ValueError, match=r"pipe.gpx: needs a file, got a folder, a pipe or a device"):
        mpt.track(tmp_path / "pipe.gpx")
    for path, words in {
        tmp_path / "pipe.gpx": "needs a file, got",
        "/dev/stdin": "needs a file with a name of its own",
        tmp_path / "none.gpx": "No such file",
    }.items():
        code, _, err = said(capsys, path)
        assert code == 1
        assert words in err


def test_out_names_the_folder(spoilt, tmp_path, capsys):
    folder = tmp_path / "there"
    code, _, err = said(capsys, spoilt, "--out", folder)
    assert code == 1
    assert "there: needs a folder that exists, to write to" in err
    folder.mkdir()
    assert said(capsys, spoilt, "--out", folder)[0] == 0
    assert sorted(path.name for path in folder.iterdir()) == ["giro.png", "giro_smooth.gpx"]


def test_a_csv_is_read_by_its_names_or_by_those_given(tmp_path, capsys):
    z, lat, lon = positions()
    rows = [f"2024-05-03T10:{k // 60:02d}:{k % 60:02d}Z" for k in range(300)]
    path = table(tmp_path / "walk.csv", "time,lat,lon", rows, lat, lon)
    found = json.loads(said(capsys, path, "--json")[1])
    assert (found["fixes"], found["refused"], found["notes"]) == (300, [], [])
    assert found["files"][0].endswith("walk_smooth.gpx")
    assert len(tracks.gpx(tmp_path / "walk_smooth.gpx")[0].t) == 300
    path = table(tmp_path / "metres.csv", "when,a,b", 1.7e9 + np.arange(300), *z.T)
    code, _, err = said(capsys, path)
    assert code == 1
    assert (
        "needs columns time and lat, lon (degrees) or x, y (metres), with commas between, got 'when', 'a', 'b': name "
        "the others: --time NAME --lat NAME --lon NAME, or in Python columns={'time': 'NAME', 'lat': 'NAME', " in err
    )
    found = json.loads(said(capsys, path, "--time", "when", "--x", "a", "--y", "b", "--json")[1])
    assert found["r"] == pytest.approx(4.0, rel=0.3)
    assert found["files"][0].endswith("metres_smooth.csv")


@pytest.mark.parametrize(
    ("times", "why"),
    [
        (np.float32(1.7e9 + np.arange(1000)), "9 of 1000, 991 with a time that is not after the one before"),
        (np.where(np.arange(1000) < 8, np.arange(1000), np.nan), r"8 of 1000, 992 with no time that can be read$"),
    ],
)
def test_why_too_few_fixes_are_left_is_told(tmp_path, times, why):
    _, lat, lon = positions(N=1000)
    path = tmp_path / "few.csv"
    rows = [f"{'' if np.isnan(t) else f'{t:.0f}'},{a:.7f},{b:.7f}" for t, a, b in zip(times, lat, lon, strict=True)]
    path.write_text("\n".join(["time,lat,lon", *rows]))
    with pytest.raises(ValueError, match=f"few.csv: needs at least 10 fixes with a time and a position, got {why}"):
        mpt.track(path)


def test_the_command_reads_what_it_has_written(tmp_path, capsys):
    z, _, _ = positions()
    assert said(capsys, table(tmp_path / "metres.csv", "time,x,y", range(300), *z.T))[0] == 0
    code, out, err = said(capsys, tmp_path / "metres_smooth.csv")
    assert (code, err) == (0, "")
    assert "300 fixes" in out


def test_what_would_be_overwritten_is_refused_before_the_work(tmp_path, capsys, monkeypatch):
    z, lat, lon = positions()
    tables = {"degrees": ("time,lat,lon", lat, lon, "gpx"), "metres": ("time,x,y", *z.T, "csv")}
    for name, (head, first, second, kind) in tables.items():
        path = tmp_path / f"{name}.csv"
        rows = [f"{k},{a:.7f},{b:.7f}" for k, (a, b) in enumerate(zip(first, second, strict=True))]
        path.write_text("\n".join([head, *rows]))
        other = tmp_path / f"{name}_smooth.{'csv' if kind == 'gpx' else 'gpx'}"
        other.write_text("mine")  # it does not stand in the way
        assert said(capsys, path)[0] == 0
        with monkeypatch.context() as patched:
            patched.setattr(tracks, "track", None)
            code, _, err = said(capsys, path)
        assert code == 1
        assert f"{name}.png: exists; to replace it" in err
        (tmp_path / f"{name}.png").unlink()
        assert f"{name}_smooth.{kind}: exists; to replace it" in said(capsys, path)[2]


def test_help_says_what_a_pause_is(capsys):
    with pytest.raises(SystemExit):
        main(["track", "--help"])
    assert "without a fix (60, or ten usual steps if that is longer)" in in_one_line(capsys.readouterr().out)


def table(path, head, *columns):
    rows = [",".join(map(str, each)) for each in zip(*columns, strict=True)]
    path.write_text("\n".join([head, *rows]), encoding="utf-8")
    return path


def test_r_is_that_of_the_fixes_that_are_kept():
    """With noise of Student's t, of so few degrees of freedom that some fixes are refused as faults."""
    z, _, _ = positions(N=1000, seed=0)
    noise = 2 * np.random.default_rng(0).standard_t(1.5, z.shape)
    c = tracks.clean(np.arange(1000.0), z + noise)
    assert len(c.refused) > 0
    assert c.r == pytest.approx(4 + np.mean(noise[c.mask] ** 2), rel=0.05)
    assert c.r < 0.5 * (4 + np.mean(noise**2))


def test_hdop_weighs_the_fixes(tmp_path):
    z, _, _ = positions()
    hdop = np.where(np.arange(300) % 3 == 0, 5.0, 1.0)
    noisy = z + (hdop[:, None] - 1) * 2 * np.random.default_rng(2).standard_normal(z.shape)
    lat, lon = tracks.degrees(noisy, (57.0, 9.9))
    fixes = [fix(*place, k, f"<hdop>{hdop[k]}</hdop>") for k, place in enumerate(zip(lat, lon, strict=True))]
    path = tmp_path / "hdop.gpx"
    path.write_text(gpx_of(fixes), encoding="utf-8")
    weighted = mpt.track(path)
    path.write_text(gpx_of([re.sub("<hdop>.*</hdop>", "", each) for each in fixes]), encoding="utf-8")
    plain = mpt.track(path)
    assert "fixes are weighted by their hdop" in in_one_line(weighted.report())
    true, _, _ = positions()

    def error(c):
        there = tracks.local(*writers.degrees_of(c, c.x[:, ::2]), (57.0, 9.9))
        return mpt.metrics.rms(there - true)

    assert error(weighted) < 0.9 * error(plain)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda text: re.sub("<time>.*?</time>", "", text), "got 0 of 300, 300 with no time that can be read"),
        (
            lambda text: re.sub("<time>.*?</time>", "<time>noon</time>", text),
            "needs ISO 8601, Unix seconds, or seconds from 0 in column 'time', got 'noon': numbers are decimal",
        ),
        (
            lambda text: re.sub("<time>.*?</time>", "<time>2024-05-03T10:00:00Z</time>", text),
            "got 1 of 300, 299 with a time that is not after the one before",
        ),
        (lambda text: re.sub('lat="5', 'lat="95', text), "needs degrees of at most 90 and 360"),
        (lambda text: re.sub('lat="5', 'lat="15', text), "are the two exchanged, "),
        (
            lambda text: text.replace("<ele>", "<el>", 1),
            "needs a GPX file, got one that cannot be read (mismatched tag",
        ),
        (lambda text: "", "or x, y (metres), with commas between, got 'nothing': name the others"),
        (
            lambda text: text.replace("<trkpt", "<rtept").replace("</trkpt", "</rtept"),
            "got no trkpt: routes and waypoints have no times",
        ),
        (lambda text: f"{HEAD}{'<a>' * 200_000}", "one that cannot be read (no element found"),
        (
            lambda text: re.sub('<trkpt lat="[^"]*" lon="[^"]*"', '<trkpt lat="57" lon="9"', text),
            "needs a track that moves",
        ),
    ],
)
def test_what_cannot_be_used_is_refused_in_words(tmp_path, capsys, spoil, words):
    _, lat, lon = positions()
    fixes = [fix(*place, k) for k, place in enumerate(zip(lat, lon, strict=True))]
    path = tmp_path / "bad.gpx"
    path.write_text(spoil(gpx_of(fixes)), encoding="utf-8")
    code, out, err = said(capsys, path)
    assert (code, out) == (1, "")
    assert "bad.gpx" in err or "moves" in err
    assert words in err
    assert [each.name for each in tmp_path.iterdir()] == ["bad.gpx"]


def test_unusual_numbers_are_named_and_absurd_ones_set_no_scale(tmp_path):
    _, lat, lon = positions()
    fixes = [fix(*place, k) for k, place in enumerate(zip(lat, lon, strict=True))]
    path = tmp_path / "odd.gpx"
    for height in ("-32768", "1e300"):
        path.write_text(gpx_of([fixes[0].replace("30.5", height), *fixes[1:]]), encoding="utf-8")
        assert tracks.gpx(path, up=True)[0].origin[2] == 30.5
        assert in_one_line(mpt.track(path).report()).count("refused as faults: none") == 1
    fast = [fix(57 + (k * 0.005), 9.9, k) for k in range(300)]
    path.write_text(gpx_of(fast), encoding="utf-8")
    assert "ATTENTION: one step in a hundred is faster than 55" in in_one_line(mpt.track(path).report())
    far = [fixes[0], fix(-33.0, 151.0, 1), *fixes[2:]]
    path.write_text(gpx_of(far), encoding="utf-8")
    c = mpt.track(path)
    np.testing.assert_array_equal(c.refused, [1])
    path.write_text(gpx_of([fix(-33.0, 151.0, 0), *fixes[1:]]), encoding="utf-8")
    c = mpt.track(path)  # nor is the first fix an origin for all
    np.testing.assert_array_equal(c.refused, [0])
    assert np.abs(c.x[1:, ::2]).max() < 10e3
    again = [*fixes[:9], fixes[8], *fixes[9:]]
    path.write_text(gpx_of(again), encoding="utf-8")
    assert "not used: 1 with a time that is not after the one before" in in_one_line(mpt.track(path).report())


SLOW = "ATTENTION: 99 of 100 steps are slower than"


@pytest.mark.parametrize(
    ("step", "metres", "words"),
    [
        (1, 9e-6, SLOW),  # degrees
        (1, 1e3, "ATTENTION: one step in a hundred is faster than"),  # millimetres
        (4e3, 60, f"{SLOW} 0.2 m/s, with a fix every 4000 s"),  # an aircraft
        (60, 6, None),  # a walk, rarely
    ],
    ids=["degrees", "mm", "plane_ms", "walk"],
)
def test_other_units_are_asked_for_where_numbers_are_handed_in_too(step, metres, words):
    z, _, _ = positions()
    c = tracks.clean(step * np.arange(300.0), metres * z)
    asked = " ".join(c.unusual)
    before, _, after = in_one_line(c.report()).partition("refused as faults")
    assert before.endswith(f"every {step:g} s {f'note: {asked} ' if asked else ''}")  # before all numbers
    assert "note" not in after
    assert c.summary()["notes"] == c.unusual
    assert (words or "") in asked
    assert bool(words) == ("the times in seconds, not milliseconds, and the positions in metres, or a file's" in asked)


def test_a_file_in_degrees_is_asked_for_its_times_only(tmp_path):
    _, lat, lon = positions()
    path = tmp_path / "car.csv"
    rows = [f"{1000 * k},{place[0]:.7f},{place[1]:.7f}" for k, place in enumerate(zip(lat, lon, strict=True))]
    path.write_text("\n".join(["time,lat,lon", *rows]))
    c = mpt.track(path)
    (asked,) = c.unusual
    assert ", with a fix every 1000 s: are the times in seconds, not milliseconds" in asked
    assert c.summary()["notes"][-1] == asked


def test_radians_are_asked_for_and_the_date_is_told(tmp_path):
    """Nobody can see that GPS seconds of 2024 are no Unix seconds of 2014, but the one who reads the date."""
    _, lat, lon = positions()
    c = mpt.track(table(tmp_path / "car.csv", "time,lat,lon", 1.39e9 + np.arange(300), *np.radians([lat, lon])))
    assert [each for each in c.unusual if "are they in radians?" in each] == c.unusual
    assert in_one_line(c.report()).startswith(
        "car.csv: 300 fixes in 0:04:59, every 1 s; from 2014-01-17 23:06:40 UTC note"
    )
    c = mpt.track(table(tmp_path / "car.csv", "time,lat,lon", np.arange(300), lat, lon))
    assert c.unusual == []
    assert "UTC" not in c.report()


def test_so_many_refused_fixes_are_called_no_faults():
    z, _, _ = positions()
    c = tracks.clean(np.arange(300.0), z)
    c.segments[100:130] = -1
    assert c.unusual == []
    c.segments[130] = -1
    words = "10% of the fixes are refused. So many are hardly faults: are digits missing, or is the noise large?"
    assert words in in_one_line(c.report())


def test_a_track_of_too_few_digits_is_told_so():
    z, _, _ = positions()
    t = np.arange(300.0)
    with pytest.raises(ValueError, match=r"a track that moves, got 260 of 300 fixes standing .* are digits missing\?"):
        tracks.clean(t, z.round(-2))


def test_a_first_half_that_rests_tells_no_band():
    z, _, _ = positions()
    c = tracks.clean(np.arange(300.0), np.where(np.arange(300)[:, None] < 170, z[0], z))
    assert c.band is None
    assert c.stretches == 2


def test_a_fix_that_is_left_out_counts_for_one_reason(tmp_path):
    """Without a time, with one that cannot be read, without a position, and without both."""
    _, lat, lon = positions()
    fixes = [fix(*place, k) for k, place in enumerate(zip(lat, lon, strict=True))]
    blank, noon = (lambda text: re.sub("<time>.*</time>", "", text)), (lambda text: re.sub("10:..:..Z", "noon", text))
    nowhere = lambda text: text.replace('lat="5', 'lat="95')  # noqa: E731
    fixes[20], fixes[30], fixes[40] = blank(fixes[20]), noon(fixes[30]), nowhere(noon(fixes[40]))
    fixes[50], fixes[60] = nowhere(fixes[50]), nowhere(blank(fixes[60]))
    path = tmp_path / "holes.gpx"
    path.write_text(gpx_of(fixes), encoding="utf-8")
    left_out = mpt.track(path).source.left_out
    assert left_out == {"no position on the Earth": 3, "no time that can be read": 2}


def test_a_time_that_cannot_be_read_is_said_to_be_one(tmp_path):
    path = tmp_path / "track.gpx"
    fixes = [fix(57, 9, k) for k in range(12)]
    fixes[1] = fixes[1].replace("10:00:01", "10:00:71")
    path.write_text(gpx_of(fixes), encoding="utf-8")
    with pytest.raises(ValueError, match="1 with no time that can be read, first in fix 2"):
        tracks.gpx(path)


def test_what_was_taken_from_the_file_goes_back_into_its_encoding(spoilt, capsys):
    text = spoilt.read_text(encoding="utf-8").replace("UTF-8", "ISO-8859-1")
    text = re.sub(r"(</?)(trk|gpx)", r"\1g:\2", text).replace("xmlns=", "xmlns:g=")
    spoilt.write_bytes(text.encode("latin-1"))
    assert said(capsys, spoilt)[0] == 0
    after = tracks.gpx(spoilt.parent / "giro_smooth.gpx")
    assert [len(each.t) for each in after] == [99, 100, 100]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (r"><ele>30.5</ele><time>[^<]*</time></trkpt></trkseg>", "/></trkseg>"),  # of an element without content
        ("<trkpt lat", "<trkpt name='north > south' lat"),
        (r'" lon="', '" note="/>" lon="'),
    ],
)
def test_fixes_written_in_any_way_that_xml_allows_are_replaced_in_place(tmp_path, capsys, old, new):
    _, lat, lon = positions()
    lat[50] += 0.01  # an outlier, which would stand in the new file if its numbers were not found
    lon[50] += 0.01
    fixes = [fix(*place, k) for k, place in enumerate(zip(lat, lon, strict=True))]
    path = tmp_path / "walk.gpx"
    path.write_text(re.sub(old, new, gpx_of(fixes[:100], fixes[100:])), encoding="utf-8")
    before = readers.read(path)
    assert said(capsys, path)[0] == 0
    after = readers.read(tmp_path / "walk_smooth.gpx")
    timed = np.isfinite(before.time)  # others are left out
    np.testing.assert_array_equal(after.time, before.time[timed])
    np.testing.assert_array_equal(after.segment, before.segment[timed])
    for change in (after.lat - before.lat[timed], after.lon - before.lon[timed]):
        assert -0.011 < change[50] < -0.009
        assert np.abs(np.delete(change, 50)).max() < 2e-4


@pytest.mark.parametrize("distance", [1e3, 150e3, 1000e3])
def test_degrees_are_the_inverse_of_local(distance):
    angle = np.linspace(0, 2 * np.pi, 24)
    z = distance * np.column_stack([np.cos(angle), np.sin(angle)])
    for origin in ((57.0, 9.9), (-33.0, 179.9, 1200.0), (89.9, 0.0)):
        lat, lon = tracks.degrees(z, origin)
        np.testing.assert_allclose(tracks.local(lat, lon, origin), z, atol=1e-6)


def test_degrees_and_metres_are_those_of_another_package():
    pymap3d = pytest.importorskip("pymap3d")
    rng = np.random.default_rng(0)
    lat, lon = 57 + rng.uniform(-3, 3, 50), 9.9 + rng.uniform(-3, 3, 50)
    east, north, _ = pymap3d.geodetic2enu(lat, lon, 200.0, 57.0, 9.9, 200.0)
    z = tracks.local(lat, lon, (57.0, 9.9, 200.0))
    np.testing.assert_allclose(z, np.column_stack([east, north]), atol=1e-6)
    back = tracks.degrees(z, (57.0, 9.9, 200.0))
    np.testing.assert_allclose(back, [lat, lon], atol=1e-11)
    flat = pymap3d.enu2geodetic(east, north, np.zeros(50), 57.0, 9.9, 200.0)
    assert np.abs(flat[0] - lat).max() * 111e3 > 10  # what up = 0 would be wrong by


def test_q_and_r_and_their_errors_are_those_of_fit():
    """A search in one dimension and the general one, on one track of the model. (test_fit: what errors hold)"""
    z, _, _ = positions(N=600)
    c = tracks.clean(np.arange(600.0), z, rounding=0.0)
    make = lambda q, r: mpt.stack(*[mpt.constant_velocity(dt=1.0, q=q, r=r, P0=np.diag([1e4, 1e3]))] * 2)  # noqa: E731
    f = mpt.fit(make, z, q=c.q, r=c.r)
    assert c.q == pytest.approx(f.values["q"], rel=0.05)
    assert c.r == pytest.approx(f.values["r"], rel=0.02)
    assert c.log_errors == pytest.approx(f.log_errors, rel=0.01)


def line_of(t, z, segment, noise, scale, relative=None):
    return cleaning.concatenate_segments(t, z, relative, np.arange(len(t)), segment, noise, scale)


def fitted_by_turns(seed):
    """The q of half an hour that is calm and wild by turns, three minutes each at the mean, and its stated error."""
    rng, N = np.random.default_rng(seed), 1800
    calm = np.cumsum(rng.random(N) < 1 / 180) % 2
    changes = rng.standard_normal((N, 2)) * np.sqrt(np.where(calm, 0.01, 1.0))[:, None]
    z = np.cumsum(np.cumsum(changes, axis=0), axis=0) + 2 * rng.standard_normal((N, 2))
    t = np.arange(float(N))
    scale = cleaning.scale_of(t, z, 0.0)
    guess = cleaning.first_guess(t, z, scale)
    line = line_of(t, z, np.zeros(N, dtype=int), guess, scale)
    found = cleaning.fit_noise(line, guess, scale)
    return found.q, cleaning.log_errors(line, found, scale)["q"]


@pytest.mark.slow  # the blocks are those of `fit`, whose errors test_fit holds to a recorded track's scatter
def test_errors_of_q_hold_on_half_an_hour_that_is_calm_and_wild_by_turns():
    """Ten blocks of three minutes, with Student's factor, state five sixths of the scatter, blocks of 1 s a fifth."""
    q, errors = np.transpose([fitted_by_turns(seed) for seed in range(24)])
    assert 0.8 < np.std(np.log(q), ddof=1) / mpt.metrics.rms(errors) < 1.35


def segments_of(rng, N):
    """The segment of each of N fixes: 2 to 5 of them, with refused fixes inside and between."""
    segments = np.sort(rng.integers(0, rng.integers(2, 6), N))
    segments = np.unique(segments, return_inverse=True)[1]
    for k in range(segments.max() + 1):
        own = np.flatnonzero(segments == k)
        segments[own[2:][rng.random(len(own[2:])) < 0.3]] = -1
    return segments


@pytest.mark.parametrize("seed", range(12))
def test_segments_on_one_line_begin_where_the_one_before_has_ended_an_hour_later(seed):
    """Moved as a whole, and told from which fixes their start is known."""
    rng = np.random.default_rng(seed)
    N = int(rng.integers(30, 80))
    t, z = np.cumsum(rng.uniform(0.5, 3.0, N)), rng.standard_normal((N, 2)).cumsum(axis=0)
    segments = segments_of(rng, N)
    relative = rng.uniform(0.5, 2.0, (N, 2)) if seed % 2 else None
    noise, scale = cleaning.Noise(1.0, 1.0, False), cleaning.Scale(1.0, 2.0, 1e-6)
    line = line_of(t, z, segments, noise, scale, relative)
    before = None
    for k in range(segments.max() + 1):
        own = np.flatnonzero(segments == k)
        here = np.flatnonzero(line.number == k)
        span = np.arange(own[0], own[-1] + 1)
        np.testing.assert_array_equal(line.rows[here], span)
        np.testing.assert_allclose(np.diff(line.t[here]), np.diff(t[span]), rtol=1e-9, atol=1e-9)
        kept = segments[span] >= 0
        np.testing.assert_allclose((line.z[here] - line.moved[here])[kept], z[span][kept], atol=1e-9)
        assert np.isnan(line.z[here][~kept]).all()
        assert np.ptp(line.moved[here], axis=0).max() == 0
        np.testing.assert_array_equal(span[line.first[here]], own[:2])
        if before is not None:
            np.testing.assert_allclose(line.z[here[0]], line.z[before], atol=1e-9)
            assert line.t[here[0]] - line.t[before] == pytest.approx(3600)
        before = here[-1]
    assert (relative is None) == (line.relative is None)
    if relative is not None:
        np.testing.assert_array_equal(line.relative, relative[line.rows])


@pytest.mark.parametrize("seed", range(12))
def test_the_way_and_the_time_in_motion_are_those_within_segments(seed):
    """What lies between two segments is no way, and the time of a pause is no motion."""
    rng = np.random.default_rng(seed)
    N = int(rng.integers(30, 80))
    segments = segments_of(rng, N)
    t, x, P = np.cumsum(rng.uniform(0.5, 3.0, N)), rng.standard_normal((N, 4)), np.zeros((N, 4, 4))
    P[:, 1, 1] = rng.uniform(0.01, 0.2, N)
    inside = np.zeros(N, bool)
    metres = seconds = 0.0
    for k in range(segments.max() + 1):
        own = np.flatnonzero(segments == k)
        inside[own[0] : own[-1] + 1] = True
        for row in range(own[0] + 1, own[-1] + 1):
            metres += np.hypot(x[row, 0] - x[row - 1, 0], x[row, 2] - x[row - 1, 2])
            seconds += (t[row] - t[row - 1]) * (np.hypot(x[row, 1], x[row, 3]) > 0.5)
    speed = np.hypot(x[inside, 1], x[inside, 3])
    x[~inside] = np.nan
    noise, scale = cleaning.Noise(1.0, 1.0, False), cleaning.Scale(1.0, 2.0, 1e-6)
    line = line_of(t, x[:, ::2], segments, noise, scale)
    c = SimpleNamespace(t=t, x=x, P=P, line=line, source=None)
    expected = [metres / 1000, seconds, 3.6 * np.median(speed[speed > 0.5]), 3.6 * np.quantile(speed, 0.999)]
    expected.append(3.6 * np.sqrt(np.median(P[inside, 1, 1])))
    np.testing.assert_allclose(list(report.distance_and_speeds(c).values()), expected, rtol=1e-9)


@pytest.fixture
def part_of_the_ride(tmp_path):
    """A file of the first quarter of an hour of the guide's ride; test_guide has the report on all of it."""
    text = RIDE.read_text(encoding="utf-8")
    end = [each.end() for each in re.finditer("</trkpt>", text)][899]
    path = tmp_path / "ride.gpx"
    path.write_text(f"{text[:end]}</trkseg></trk></gpx>\n", encoding="utf-8")
    return path


def test_an_r_below_the_rounding_of_the_file_is_that_rounding(part_of_the_ride):
    c = mpt.track(part_of_the_ride)
    assert c.rounding
    assert c.r == pytest.approx((111e3 * 8.4e-8) ** 2 / 12, rel=0.05)  # half a circle over 2^31
    assert np.isinf(c.log_errors["r"])
    assert "the recorder had smoothed them already" in in_one_line(c.report())
    assert "r = 7.2e-06 m²)" in c.report()  # with blanks as a terminal knows them
    assert c.summary()["log_errors"]["r"] is None


def test_a_recorded_track_as_a_whole_process(part_of_the_ride, tmp_path):
    """By a name that is no text and looks like a formula, to a terminal that knows ASCII only."""
    path = part_of_the_ride.rename(tmp_path / os.fsdecode(b"$a$ ^_{\xff.gpx"))
    run = [sys.executable, "-m", "mpt_helpers", "track", path]
    ascii_only = os.environ | {"PYTHONIOENCODING": "ascii"}
    done = subprocess.run(run, capture_output=True, cwd=ROOT, env=ascii_only, check=True)
    out = in_one_line(done.stdout.decode("ascii"))
    assert "900 fixes in 0:14:5" in out
    assert re.search(r": 9\d% of 4\d\d fixes that were not refused lay", out)
    assert done.stderr == b""
    assert len(list(tmp_path.iterdir())) == 3
    picture = path.with_suffix(".png").read_bytes()
    assert picture.startswith(PNG)
    assert len(picture) > 20_000


def test_another_command_is_said_to_be_elsewhere(capsys):
    assert main(["reproduce"]) == 2
    assert "the papers are reproduced in a checkout, by python -m reproduction" in capsys.readouterr().err
    assert main(["--help"]) == 0
    assert "track FILE.gpx" in capsys.readouterr().out


def walked(seed=5, N=2000):
    """Latitudes of a mobile that is driven north at 2.6 m/s, so that no two of them are alike."""
    return 57 + (2.6 * np.arange(N) + 0.02 * np.random.default_rng(seed).standard_normal(N)) / 111e3


@pytest.mark.parametrize(
    "grid", [1e-5, 1e-6, 1e-7, 1 / 60e3, 1 / 60e4, 1 / 36e3, 180 / 2**31], ids=lambda grid: f"{grid:.3g}"
)
def test_the_grid_of_a_file_is_found_beside_faults_and_where_the_track_was_moved(grid):
    rng = np.random.default_rng(1)
    lat = 57 + grid * np.round(np.cumsum(rng.uniform(-1, 2, 2000)) * 1e-5 / grid)
    assert cleaning.grid_of(lat, tracks.GRIDS) == pytest.approx(grid)
    lat[rng.choice(2000, 40)] += rng.standard_normal(40) * 1e-3  # they are written with more digits
    lat[900:] += 0.00123456
    assert cleaning.grid_of(lat.round(9), tracks.GRIDS) == pytest.approx(grid)


def test_one_fix_of_more_digits_does_not_change_the_rounding_of_a_file(tmp_path):
    text = RIDE.read_text(encoding="utf-8")
    for name in ("lat", "lon"):  # a number that stands there twice, so that the least difference becomes another
        degrees = re.findall(rf'{name}="([^"]*)"', text)
        twice = next(each for k, each in enumerate(degrees) if each in degrees[:k])
        text = text.replace(f'{name}="{twice}"', f'{name}="{float(twice) + 3e-9:.10f}"', 1)
    path = tmp_path / "ride.gpx"
    path.write_text(text, encoding="utf-8")
    assert mpt.track(path).r == pytest.approx((111e3 * 8.4e-8) ** 2 / 12, rel=0.05)


def test_the_step_of_a_straight_way_is_not_the_grid():
    assert cleaning.grid_of(walked().round(7), tracks.GRIDS) == pytest.approx(1e-7)
    assert cleaning.grid_of(walked(), tracks.GRIDS) < 1e-6  # on none
    assert cleaning.grid_of(np.array([57.0, 57.0, np.nan]), tracks.GRIDS) == 0
    assert cleaning.grid_of(np.cumsum([0.0, 1.2, 0.1, 2.4] * 9), tracks.DECIMALS) == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (0.084, "known to 8%"),
        (0.31, "known to a factor of 1.4"),
        (1.7, "known to a factor of 5.5"),
        (2.4, "hardly known"),
    ],
)
def test_an_error_of_a_logarithm_is_said_in_words(error, words):
    assert report._known(error) == words


def test_the_picture_shows_jumps_and_the_end_and_counts_hours_of_long_tracks():
    z, _, _ = positions()
    z[200:] += 1000
    c = tracks.clean(40 * np.arange(300.0), z)
    above, below = c.plot().axes
    labels = [line.get_label() for line in above.get_lines()]
    assert {"smoothed", "jumps", "start", "end"} <= set(labels)
    jump = above.get_lines()[labels.index("jumps")].get_xydata()
    np.testing.assert_allclose(jump, c.x[[199, 200]][:, ::2] / 1000)
    assert below.get_xlabel() == "time (h)"
    assert tracks.clean(np.arange(300.0), z).plot().axes[1].get_xlabel() == "time (min)"


@pytest.mark.parametrize("wide", [1.0, 40.0])
def test_all_text_of_the_picture_lies_inside_it_and_numbers_stand_apart(wide):
    z, _, _ = positions()
    z = 130e3 + z * [wide, 1]
    z[50] += 9e4  # off the map
    z[100] += [30, 60]
    z[200:] += 1000
    fig = tracks.clean(np.arange(300.0), z).plot()
    fig.draw_without_rendering()
    (legend,) = fig.legends
    assert len(legend.get_texts()) == 6
    texts = [legend, *legend.get_texts()]
    for ax in fig.axes:
        texts += [ax.xaxis.label, ax.yaxis.label, ax._left_title]
        along, up = (
            [tick.label1 for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high]
            for axis, (low, high) in ((ax.xaxis, ax.get_xlim()), (ax.yaxis, ax.get_ylim()))
        )
        texts += along + up
        ends = [each.get_window_extent() for each in along]
        for one, following in itertools.pairwise(ends):
            assert following.x0 - one.x1 > 4  # points of 1/100 inch
    for each in texts:
        extent = each.get_window_extent()
        assert fig.bbox.x0 <= extent.x0, each
        assert extent.x1 <= fig.bbox.x1, each
        assert fig.bbox.y0 <= extent.y0, each
        assert extent.y1 <= fig.bbox.y1, each


def test_lengths_of_time_are_taken_for_what_they_are(tmp_path):
    z, lat, lon = positions()
    t = np.arange(300.0)
    t[150:] += 100
    kinds = (90.0, timedelta(minutes=1.5), np.timedelta64(90, "s"))
    c = tracks.clean(t, z, pause=kinds[1], seconds=timedelta(seconds=20))
    assert (c.stretches, c.band.seconds) == (2, 20.0)
    path = tmp_path / "pause.gpx"
    path.write_text(gpx_of([fix(*place, int(k)) for *place, k in zip(lat, lon, t, strict=True)]), encoding="utf-8")
    assert [[len(each.t) for each in tracks.gpx(path, pause=pause)] for pause in kinds] == [[150, 150]] * 3
