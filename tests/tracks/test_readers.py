"""What is read of files and frames, and what is refused by name: nothing is guessed."""

import bz2
import gzip
import io
import lzma
import re
import zipfile

import numpy as np
import pandas as pd
import pytest
from conftest import ROOT

import mpt_helpers as mpt
from mpt_helpers.tracks import degrees, readers

N = 300
RNG = np.random.default_rng(4)
WALK = np.cumsum(3 * np.column_stack([np.sin(np.arange(N) / 60), np.cos(np.arange(N) / 60)]), axis=0)
Z = WALK + RNG.normal(0, 1, (N, 2))
LAT, LON = (each.round(7) for each in degrees(Z, (33.45, 70.66)))
UNIX = 1_651_569_300 + np.arange(N)
MOMENTS = pd.to_datetime(UNIX, unit="s", utc=True)
ISO = [f"{moment:%Y-%m-%dT%H:%M:%SZ}" for moment in MOMENTS]
GPX = (
    '<?xml version="1.0"?><gpx><trk><trkseg>'
    + "".join(f'<trkpt lat="{a}" lon="{b}"><time>{t}</time></trkpt>' for a, b, t in zip(LAT, LON, ISO, strict=True))
    + "</trkseg></trk></gpx>"
)


def text_of(head, *columns):
    return "\n".join([head, *(",".join(map(str, row)) for row in zip(*columns, strict=True)), ""])


def read(tmp_path, text, **columns):
    path = tmp_path / "a.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return readers.read(path, columns)


@pytest.mark.parametrize("times", [ISO, UNIX, UNIX + 0.25, [each.replace("T", " ")[:-1] for each in ISO]])
def test_times_are_iso_8601_or_unix_seconds(tmp_path, times):
    r = read(tmp_path, text_of("time,lat,lon", times, LAT, LON))
    np.testing.assert_array_equal(np.diff(r.time), 1_000_000)
    assert abs(r.time[0] / 1e6 - UNIX[0]) < 0.3
    np.testing.assert_array_equal([r.lat, r.lon], [LAT, LON])
    assert r.said == ()


def test_other_names_are_given_and_metres_are_taken_where_they_are_named(tmp_path):
    text = text_of("when,lat,lon,e,n,acc", UNIX, LAT, LON, *Z.T, RNG.uniform(1, 2, N))
    assert read(tmp_path, text, time="when", accuracy="acc").metres is None
    r = read(tmp_path, text, time="when", x="e", y="n")
    assert r.lat is None
    np.testing.assert_array_equal(r.metres, Z)


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"latitude": "lat"}, r"columns: needs names of some of time, lat.*got \{'latitude'"),
        ("lat", "columns: needs names of some of .* got 'lat'"),
        (["time", "lat", "lon"], r"columns: needs names of some of .* got \['time'"),
        ({"lon": "lat"}, "needs one column 'lat' of lat alone, got 'time'"),
        ({"time": "when"}, "needs one column 'when' of time alone, got .*'time', 'lat', 'lon'"),
    ],
)
def test_columns_that_are_none_are_refused(tmp_path, columns, said):
    path = tmp_path / "a.csv"
    path.write_text(text_of("time,lat,lon", UNIX, LAT, LON))
    with pytest.raises(ValueError, match=said):
        mpt.track(path, columns=columns)
    with pytest.raises(ValueError, match=said.replace("a.csv", "frame")):
        mpt.track(pd.read_csv(path), columns=columns)


def test_a_gpx_file_has_no_columns_to_name(tmp_path):
    path = tmp_path / "a.gpx"
    path.write_text(GPX)
    with pytest.raises(
        ValueError, match=r"a.gpx: is a GPX file, which has no columns to name, got \{'lat': 'nosuch'\}"
    ):
        mpt.track(path, columns={"lat": "nosuch"})


def compact(form):
    return [f"{moment:{form}}" for moment in MOMENTS]


EAST, SOUTH, NORTH = ["E"] * N, ["S"] * N, ["N"] * N
COMMAS = [[str(value).replace(".", ",") for value in each] for each in (LAT, LON)]


@pytest.mark.parametrize(
    ("head", "columns", "said"),
    [
        (
            "Time,Latitude,Longitude",
            (ISO, LAT, LON),
            "needs columns time and lat, lon .*, got 'Time', 'Latitude', 'Long",
        ),
        ("time,lat,lon,lat", (ISO, LAT, LON, LAT), "needs one column 'lat' of lat alone, got"),
        (
            "time,lat,lon",
            (compact("%H%M%S.00"), LAT, LON),
            "seconds from 0 in column 'time', got '091500.00': a clock's digits.*ISO8601",
        ),
        ("time,lat,lon", (compact("%H%M%S"), LAT, LON), "got '091500': a clock's digits"),
        ("time,lat,lon", (compact("%H%M%S500"), LAT, LON), "got '091500500': a clock's digits"),
        ("time,lat,lon", (compact("%d%H%M%S"), LAT, LON), "got '03091500': a clock's digits"),
        (
            "time,lat,lon",
            (compact("%Y%m%d%H%M%S"), LAT, LON),
            "ISO 8601, Unix seconds, or seconds from 0 .*format='%Y%m%d%H%M%S'",
        ),
        (
            "time,lat,lon",
            (compact("%y%m%d%H%M%S"), LAT, LON),
            "ISO 8601, Unix seconds, or seconds from 0 .*got '220503091500': a clock's digits",
        ),
        ("time,lat,lon", (compact("%H%M"), LAT, LON), "got '0915': a clock's digits"),
        ("time,lat,lon", (45_415.4 + np.arange(N) / 86_400, LAT, LON), "got '45415.4"),
        ("time,lat,lon", (UNIX * 1000, LAT, LON), r"got '1651569300000': .*unit='ms'"),
        ("time,lat,lon", (compact("%H:%M:%S"), LAT, LON), r"got '09:15:00': a date is needed too: .*frame\['date'\]"),
        ("time,lat,lon", (compact("%d/%m/%Y %H:%M:%S"), LAT, LON), "numbers are decimal.* of dates .*dayfirst=True"),
        ("time,lat,lon", (468_000 + np.arange(N), LAT, LON), "got '468000': .* seconds from another start"),
        ("time,lat,lon,ele", (ISO, LAT, LON, ["520 m"] * N), "'ele', got '520 m': numbers are decimal, without a unit"),
        ("time,lat,N/S,lon,E/W", (ISO, LAT, SOUTH, LON, EAST), "the sign of lat in column 'N/S': .*'S': -1"),
        ("time,lat,lon,side", (ISO, LAT, LON, ["W"] * N), "the sign of lon in column 'side'"),
        (
            "time,lat,lon",
            (ISO, [f"{a}N" for a in LAT], [f"{b}E" for b in LON]),
            "column 'lat', got '33.45.*'S': -1",
        ),
        ("time,lat,lon", (ISO, [f"33°{a}'" for a in LAT], LON), "needs decimal numbers in column 'lat'"),
        (
            "time,lat,lon",
            (ISO, LAT, [*LON[:-1], f"{LON[-1]},000.5"]),
            "needs as many cells in each line .* got '2022.*on_bad_lines",
        ),
        ("time,lat,lon", (ISO, *COMMAS), "needs as many cells in each line .* got '2022.*are commas decimal"),
        ("time,lat,lon", (ISO, [f'"{a}"' for a in COMMAS[0]], LON), "'lat', got '33,45.*decimal=','"),
        ("time;lat;lon", ([f"{a};{b};{c}" for a, b, c in zip(ISO, LAT, LON, strict=True)],), "sep=';'"),
        ("time,lat,lon", (ISO, 3327.0 + LAT % 1 * 60, 7039.0 + LON % 1), "at most 90 and 360, got 3354.* or ddmm.mmmm"),
        ("time,lat,lon", (ISO, (1e7 * LAT).astype(int), (1e7 * LON).astype(int)), "got 334.* 1e7 to a degree"),
        ("time,lat,lon", (ISO, np.linspace(87, 91, N), LAT), "got 90.01.* are the two exchanged"),
        ("time,lat,lon", ((), (), ()), "needs at least 10 fixes .* got 0 of 0"),
        ("time,lat,lon", ([t[: 20 - k % 2] for k, t in enumerate(ISO)], LAT, LON), "needs a zone in all times or none"),
        ("time,lat,lon", ([t.replace("05-03", "02-30") for t in ISO[:40]] + ISO[40:], LAT, LON), "got '2022-02-30"),
        (
            "time,lat,lon",
            ([t[:-1].replace("T", " ") + " UTC" for t in ISO], LAT, LON),
            r"to_datetime\(frame\['time'\]\)$",
        ),
        (
            "time,note,lat,lon",
            (ISO, ['"a\nb"'] + ["c"] * (N - 1), LAT, LON),
            "quotes that close, got '2022-05-03T09:15.*quoting=3",
        ),
        ('"time\n(UTC)",lat,lon', (ISO, LAT, LON), "quotes that close, got '\"time'"),
        ("time,x,y", (ISO, ['"1,002.7"'] + ["1.5"] * (N - 1), LON), "got '1,002.7': pandas.*thousands="),
    ],
)
def test_a_table_that_is_written_in_another_way_is_refused_with_the_way_to_mend_it(tmp_path, head, columns, said):
    path = tmp_path / "a.csv"
    path.write_text(text_of(head, *columns))
    with pytest.raises(ValueError, match=said):
        mpt.track(path)


@pytest.mark.parametrize(
    "times",
    [
        *(compact(form) for form in ("%H%M%S", "%H%M%S.00", "%H:%M:%S", "%d/%m/%Y %H:%M:%S", "%Y-%m-%d %H:%M:%S UTC")),
        UNIX * 1000,
        [f"{25569 + each / 86400:.8f}" for each in UNIX],
    ],
)
def test_the_line_that_a_refusal_names_makes_times_of_a_column(tmp_path, times):
    path = tmp_path / "a.csv"
    path.write_text(text_of("time,lat,lon", times, LAT, LON))
    with pytest.raises(ValueError, match=r"pandas\.to_datetime") as refused:
        mpt.track(path)
    texts = {"time": str} if "as texts" in str(refused.value) else {}
    frame = pd.read_csv(path, dtype=texts).assign(date="2022-05-03")
    line = re.search(r"pandas\.to_datetime\(.*?\)(?=$|, )", str(refused.value))[0]
    frame["time"] = eval(line, {"pandas": pd, "frame": frame})
    time = readers.read_frame(frame).time
    np.testing.assert_allclose(time / 1e6, UNIX, rtol=0, atol=1e-3)


@pytest.mark.parametrize("form", ["{1}{0}", "{0}{1}", "{0} {1}", "{1} {0}"])
def test_the_line_that_a_refusal_names_makes_signed_degrees(tmp_path, form):
    """Of numbers with the letter of their hemisphere, before or after them."""
    path = tmp_path / "a.csv"
    path.write_text(
        text_of("time,lat,lon", ISO, [form.format(a, "S") for a in LAT], [form.format(b, "E") for b in LON])
    )
    frame = pd.read_csv(path)
    for column in ("lat", "lon"):
        with pytest.raises(ValueError, match=f"needs decimal numbers in column '{column}'") as refused:
            mpt.track(frame)
        frame[column] = eval(str(refused.value).partition(": frame")[2].join(["frame", ""]), {"frame": frame})
    r = readers.read_frame(frame)
    np.testing.assert_array_equal([r.lat, r.lon], [-LAT, LON])


@pytest.mark.parametrize(
    "text",
    [
        text_of("time lat lon", [f"{a} {b} {c}" for a, b, c in zip(ISO, LAT, LON, strict=True)]),
        text_of("time;lat;lon", [f"{a};{b};{c}" for a, b, c in zip(ISO, *COMMAS, strict=True)]),
        text_of("time,lat,lon,note", ISO, LAT, LON, ['"six feet' if k == 5 else "n" for k in range(N)]),
        text_of("time,note,lat,lon", ISO, ['"a\nb"' if k == 5 else "n" for k in range(N)], LAT, LON),
        text_of("time,lat,lon", ISO, LAT, [f"{b},7" if k == 5 else b for k, b in enumerate(LON)]),
    ],
    ids=["blanks", "semicolons", "open quote", "two lines", "long line"],
)
def test_the_line_that_a_refusal_names_makes_a_table(tmp_path, text):
    path, new = tmp_path / "a.csv", tmp_path / "new.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"pandas\.read_csv") as refused:
        readers.read(path)
    line = re.search(r"pandas\.read_csv\(.*'new.csv'\)", str(refused.value))[0]
    eval(line.replace("'new.csv'", "NEW"), {"pandas": pd, "FILE": path, "NEW": new})
    r = readers.read(new)
    there = np.isfinite(r.lat) & np.isfinite(r.time)
    assert np.isin(np.round(r.lat[there], 7), LAT).all()
    assert there.sum() >= N - 1


def test_a_prefix_may_be_undeclared_and_a_comment_holds_no_fix(tmp_path):
    """As in files that were put together by hand: nothing but the fixes changes in what is written."""
    head, *fixes = GPX.replace("<time>", "<x:hr>90</x:hr><time>").split("<trkpt")
    note = "<!-- <trkpt lat='1' lon='2'></trkpt> --><name><![CDATA[<trkpt>]]></name>"
    text = "<trkpt".join([head + note, *fixes]).replace("<trkpt", "<g:trkpt").replace("</trkpt", "</g:trkpt")
    (tmp_path / "a.gpx").write_text(text)
    c = mpt.track(tmp_path / "a.gpx")
    assert len(c.t) == N
    c.gpx(tmp_path / "b.gpx")
    written = (tmp_path / "b.gpx").read_text()
    assert "<g:trkpt".join(["<?xml version", *written.split("<g:trkpt")[1:]]).count("<x:hr>90</x:hr>") == N
    np.testing.assert_allclose(readers.read(tmp_path / "b.gpx").lat, LAT, atol=1e-4)
    assert note.replace("<trkpt", "<g:trkpt").replace("</trkpt", "</g:trkpt") in written


def test_signs_in_columns_that_agree_are_right(tmp_path):
    read(tmp_path, text_of("time,lat,N/S,lon,E/W", ISO, LAT, NORTH, LON, EAST))
    read(tmp_path, text_of("time,lat,N/S,lon,E/W", ISO, -LAT, SOUTH, LON, EAST))


def test_signs_may_be_on_both_sides_of_zero(tmp_path):
    """A walk past Greenwich is east of it and then west."""
    lon = (LON - LON[150]).round(7)
    with pytest.raises(ValueError, match=r"the sign of lon in column 'E/W'.*; or drop that column"):
        read(tmp_path, text_of("time,lat,lon,E/W", ISO, LAT, abs(lon), np.where(lon < 0, "W", "E")))


@pytest.mark.parametrize("rows", [np.arange(N)[::-1], np.random.default_rng(1).permutation(N)])
def test_rows_in_no_order_are_refused(rows):
    with pytest.raises(
        ValueError, match=r"frame: needs times in order, got \d+ of 300 earlier than the one before: frame.sort"
    ):
        mpt.track(FRAME.assign(time=MOMENTS).iloc[rows])


@pytest.mark.parametrize(
    "seconds", [UNIX, UNIX - 1.4e9, np.arange(N), 300.0 * np.arange(N), np.r_[0, UNIX[1:]], 50.5 + UNIX]
)
def test_seconds_are_those_since_1970_or_from_zero(tmp_path, seconds):
    r = read(tmp_path, text_of("time,lat,lon", seconds, LAT, LON))
    np.testing.assert_allclose(r.time / 1e6, seconds)


@pytest.mark.parametrize(
    ("name", "apart", "order", "in_degrees"),
    [
        ("MMSI", 20.0, "in turn", True),
        ("icao24", 600.0, "in turn", False),
        ("tag-local-identifier", 20.0, "one after the other", False),
        ("MMSI", 600.0, "one after the other", True),
    ],
)
def test_two_mobiles_in_one_table_are_refused_by_the_name_of_their_column(tmp_path, name, apart, order, in_degrees):
    t = np.r_[10 * np.arange(N), 10 * np.arange(N) + 4]
    z = np.r_[WALK, WALK + np.array([0, apart])] + np.random.default_rng(1).normal(0, 2, (2 * N, 2))
    who = np.repeat([257000001, 257000002], N)
    rows = np.argsort(t, kind="stable") if order == "in turn" else np.arange(2 * N)
    places = degrees(z[rows], (58.1, 6.6)) if in_degrees else z[rows].T
    text = text_of(f"{name},time,{'lat,lon' if in_degrees else 'x,y'}", who[rows], t[rows], *places)
    with pytest.raises(
        ValueError, match=f"needs one mobile, got 2, by their column '{name}': take one: frame.*== '257000001'"
    ):
        read(tmp_path, text)


def test_so_are_many_mobiles_of_a_few_fixes_each(tmp_path):
    who, t = np.repeat(np.arange(60), 6), np.tile(10 * np.arange(6), 60)
    z = 500 * who[:, None] + 3 * t[:, None] + np.random.default_rng(1).normal(0, 2, (360, 2))
    with pytest.raises(ValueError, match="needs one mobile, got 60, by their column 'icao24'"):
        read(tmp_path, text_of("icao24,time,x,y", who, t, *z.T))


@pytest.mark.parametrize("at_rest", [False, True])
def test_no_column_of_one_mobile_makes_several_of_it(tmp_path, at_rest):
    """Satellites, a quality that comes and goes, laps, a copy of the latitude, and a position that is repeated."""
    rng = np.random.default_rng(2)
    z = rng.normal(0, 1, (N, 2)) if at_rest else Z
    others = [rng.integers(5, 9, N), np.arange(N) % 2, np.arange(N) // 60, z[:, 1].round(), rng.integers(0, 3, N)]
    read(tmp_path, text_of("time,x,y,sats,even,lap,y_copy,fix", UNIX, *z.T, *others))
    held = z[np.arange(N) // 10 * 10]
    read(tmp_path, text_of("time,x,y,new", UNIX, *held.T, np.arange(N) % 10 == 0))


def test_a_short_row_costs_no_other_row(tmp_path):
    lines = text_of("time,lat,lon,note", ISO, LAT, LON, ["n"] * N).splitlines()
    lines[60] = ",".join(lines[60].split(",")[:2])
    lines[80] = lines[80][:-1] + '"by x, y"'
    r = read(tmp_path, "\n".join(lines))
    there = np.isfinite(r.lat) & np.isfinite(r.lon)
    assert np.flatnonzero(~there).tolist() == [59]
    np.testing.assert_array_equal(r.lat[there], LAT[there])


def test_a_line_that_is_cut_within_its_last_number_is_left_out(tmp_path):
    lon = [f"{each:.7f}" for each in LON]
    text = text_of("time,lat,lon", ISO, LAT, lon)
    assert read(tmp_path, text.rstrip("\n")).said == ()
    r = read(tmp_path, text[:-4])
    assert len(r.lon) == N - 1
    assert r.said == ("ATTENTION: the last line is cut off, and left out",)


@pytest.mark.parametrize(
    ("head", "columns", "cut"),
    [
        ("time,lat,lon", (np.arange(N), LAT, [f"{each:.7f}" for each in LON]), 2),  # lines grow longer by their number
        ("time,lat,lon", (np.arange(N), LAT, LON), 9),  # of any decimals
        ("time,x,y", (np.arange(N), *Z.T.round(1)), 3),  # the point is gone
        ("lat,lon,time", (LAT, LON, ISO), 2),
        ("time,lat,lon,note", (np.arange(N), LAT, LON, ["n"] * N), 5),  # a cell is missing
    ],
)
def test_a_cut_line_need_not_be_the_shortest(tmp_path, head, columns, cut):
    text = text_of(head, *columns)
    assert len(read(tmp_path, text[:-1]).time) == N
    text = "\n".join([*text.splitlines()[:200], "5", *text.splitlines()[200:], ""])  # beside a short line
    assert len(read(tmp_path, text[:-cut]).time) == N
    assert len(read(tmp_path, text).time) == N + 1


def packed(text, cut=None):
    return gzip.compress(text.encode(), mtime=0)[:cut]


TABLE = text_of("time,lat,lon", ISO, LAT, LON)


@pytest.mark.parametrize(
    "data",
    [
        packed(TABLE),
        packed(TABLE[:1000]) + packed(TABLE[1000:]),
        TABLE.encode("utf-8-sig"),
        TABLE.replace("\n", "\r\n").encode(),
        f"# made by hand\n{TABLE}".encode(),
    ],
    ids=["gz", "two gz", "bom", "crlf", "comment"],
)
def test_a_table_is_read_packed_and_however_its_lines_end(tmp_path, data):
    r = read(tmp_path, data)
    np.testing.assert_array_equal(r.lat, LAT)
    assert r.said == ()


@pytest.mark.parametrize("data", [packed(GPX), packed(GPX[:50]) + packed(GPX[50:])])
def test_so_is_a_gpx_file_whatever_its_name(tmp_path, data):
    for name in ("ride.gpx", "ride.GPX.GZ", "ride"):
        (tmp_path / name).write_bytes(data)
        recorded = readers.read(tmp_path / name)
        np.testing.assert_array_equal(recorded.lat, LAT)
        assert b"<trkpt" in recorded.data
        assert "<trkpt" not in repr(recorded)  # which does not show the file


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (packed(GPX, -900), "the compressed file is cut off"),
        (GPX[:-300].encode() + "<name>ü".encode()[:-1], "the file is cut off after 29[456] fixes"),
        (GPX[:-300].encode() + bytes(4096), "the file ends in empty bytes"),
        (
            GPX[: GPX.rindex("<trkpt")].encode() + b"<trkpt><desc><![CDATA[left",
            "the file is cut off after 29[456] fixes",
        ),
        (TABLE[:-300].encode() + bytes(4096), "the file ends in empty bytes"),
    ],
)
def test_of_a_file_that_is_cut_the_whole_fixes_are_read_and_it_is_said(tmp_path, data, words):
    path = tmp_path / "a"
    path.write_bytes(data)
    c = mpt.track(path)
    assert N - 120 < len(c.t) < N
    recorded = c.source.recording
    np.testing.assert_array_equal(recorded.lat[c.source.rows], LAT[c.source.rows])
    assert "ATTENTION" in c.report()
    assert words.split("[")[0] in " ".join(c.report().split())
    c.gpx(tmp_path / "b.gpx")
    np.testing.assert_allclose(readers.read(tmp_path / "b.gpx").lat, LAT[c.source.rows], atol=1e-4)


def test_a_file_that_is_cut_keeps_its_segments(tmp_path):
    text = GPX.replace(f"<time>{ISO[150]}</time></trkpt>", f"<time>{ISO[150]}</time></trkpt></trkseg><trkseg>")
    (tmp_path / "a.gpx").write_text(text[:-300])
    c = mpt.track(tmp_path / "a.gpx")
    c.gpx(tmp_path / "b.gpx")
    assert np.unique(readers.read(tmp_path / "b.gpx").segment).tolist() == [1, 2]


def test_a_clock_that_is_put_back_within_a_recording_is_asked_about(tmp_path):
    (tmp_path / "a.csv").write_text(text_of("time,lat,lon", np.where(np.arange(N) < 200, UNIX, UNIX - 3600), LAT, LON))
    c = mpt.track(tmp_path / "a.csv")
    assert c.source.left_out == {"a time that is not after the one before": 100}
    assert c.source.said == [
        "ATTENTION: times run back: was the clock put back, as in autumn, or are these two recordings?"
    ]


def test_longitudes_may_be_counted_in_two_ways_in_one_file(tmp_path):
    """From -180° and from 0°: the steps of 360° between them are no grid of a whole degree."""
    lon = np.where(np.arange(N) % 2, (360 - LON).round(7), -LON)
    (tmp_path / "a.csv").write_text(text_of("time,lat,lon", ISO, LAT, lon))
    c = mpt.track(tmp_path / "a.csv")
    assert (len(c.refused), c.rounding) == (0, False)
    assert c.r == pytest.approx(1, rel=0.2)


def test_a_damaged_packed_file_is_refused(tmp_path):
    data = bytearray(packed(TABLE))
    data[2000:2100] = b"\xff" * 100
    with pytest.raises(ValueError, match=r"a.csv: needs a file that can be decompressed, got a damaged one"):
        read(tmp_path, bytes(data))


def zipped():
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("ride.gpx", GPX)
    return file.getvalue()


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (zipped(), "an archive: unpack it; or pandas.read_excel"),
        (bz2.compress(TABLE.encode()), "an archive"),
        (lzma.compress(GPX.encode()), "an archive"),
        (b"\x28\xb5\x2f\xfd\x24\x81abc", "an archive"),  # zstd
        (TABLE.encode("utf-16"), "UTF-16: save it as UTF-8; or pandas.read_csv\\('a.b'"),
        (GPX.encode("utf-16"), "UTF-16: save it as UTF-8"),
        (
            bytes([14, 16, 0x8B, 8, 0, 0, 0, 0]) + b".FIT" + bytes(range(256)),
            "a FIT file: gpsbabel .*-i garmin_fit -f a.b ",
        ),
        (b"<?xml version='1.0'?><TrainingCenterDatabase/>", "a TCX file: gpsbabel -t -i gtrnctr -f a.b -o gpx"),
        (b"\xef\xbb\xbf\n<?xml version='1.0'?>\n<!-- a --><kml></kml>", "a KML file"),
        (b"<kml><Document></Document></kml>", "a KML file: gpsbabel -t -i kml"),
        (b"<!DOCTYPE html><html><br></html>", "another kind of XML, or a web page"),
        (b"<osm></osm>", "another kind of XML"),
        (b"$GPGGA,091500.00,5217.99,N,00454.00,E,1,08,0.9,0.1,M,,M,,*47\r\n", "a log of NMEA .*-i nmea"),
        (b"\xef\xbb\xbf$GPRMC,091500.00,A,5217.99,N,00454.00,E,1,2,030524,,,A*47\r\n", "a log of NMEA sentences"),
        (b"!AIVDM,1,1,,A,13HOI:0P0000VOHLCnHQKwvL05Ip,0*23\n", "a log of NMEA sentences"),
        (b"AXCSAAA\r\nHFDTE030522\r\nB0915005217990N00454000EA0000100010\r\n", "an IGC file: gpsbabel"),
        (b'{"type": "FeatureCollection"}', r"a JSON file: pandas.read_json\('a.b'\).* geopandas.read_file\('a.b'\)"),
        (b"RECORD\x02\x01\x07, a logger's own", "a binary file, or a damaged one"),
        (b"\x89PNG\r\n\x1a\n" + bytes(range(256)), "a binary file"),
    ],
)
def test_another_kind_of_file_is_recognised_and_the_way_is_named(tmp_path, data, said):
    path = tmp_path / "a.b"
    path.write_bytes(data)
    with pytest.raises(ValueError, match=f"a.b: needs a (GPX or )?(GPX|CSV) file, got {said}"):
        mpt.track(path)


FRAME = pd.DataFrame({"lat": LAT, "lon": LON, "hr": 120})


@pytest.mark.parametrize(
    ("frame", "columns"),
    [
        (FRAME.assign(time=MOMENTS), None),
        (FRAME.assign(time=MOMENTS.tz_convert("Asia/Tokyo")), None),
        (FRAME.assign(time=MOMENTS.tz_localize(None)), None),
        (FRAME.assign(time=ISO), None),
        (FRAME.assign(time=UNIX), None),
        (FRAME.assign(time=list(MOMENTS)).astype({"time": object}), None),
        (FRAME.set_index(MOMENTS), None),
        (FRAME.set_index(MOMENTS.rename("when")), None),
        (FRAME.set_index(pd.Index(UNIX, name="time")), None),
        (FRAME.assign(when=MOMENTS), {"time": "when"}),
        (FRAME.set_index(MOMENTS), {"time": "when"}),
        (FRAME.set_index(pd.Index(list(MOMENTS), dtype=object)), {"time": "index"}),
        (FRAME.set_index(pd.MultiIndex.from_product([["car"], MOMENTS], names=["vehicle", "time"])), None),
        (FRAME.set_index(pd.MultiIndex.from_product([["car"], MOMENTS])), {"time": "level_1"}),
    ],
)
def test_a_frame_is_read_with_its_times_in_a_column_or_its_index(frame, columns):
    r = readers.read_frame(frame, columns)
    np.testing.assert_array_equal(r.time, UNIX * 1_000_000)
    np.testing.assert_array_equal([r.lat, r.lon], [LAT, LON])


@pytest.mark.parametrize(
    ("frame", "said"),
    [
        (FRAME, "frame: needs columns time and lat, lon"),
        (pd.DataFrame(), "frame: needs columns time and lat, lon"),
        (pd.concat([FRAME, FRAME], axis=1).set_index(MOMENTS), "frame: needs one column 'lat' of lat alone, got"),
        (
            FRAME.assign(time=MOMENTS, lat=FRAME["lat"].astype(str) + "N"),
            "frame: needs decimal numbers in column 'lat'",
        ),
    ],
)
def test_a_frame_that_will_not_do_is_refused(frame, said):
    with pytest.raises(ValueError, match=said):
        mpt.track(frame)


@pytest.mark.parametrize("where", ["column", "index"])
def test_times_of_a_frame_may_be_counted_from_its_start(where):
    since = pd.to_timedelta(np.arange(N), unit="s")
    r = readers.read_frame(FRAME.assign(time=since) if where == "column" else FRAME.set_index(since))
    np.testing.assert_array_equal(r.time, 1e6 * np.arange(N))
    assert not r.dated


def test_a_quote_within_a_cell_is_a_letter_and_one_that_closes_in_a_later_line_is_refused(tmp_path):
    note = ["n"] * N
    note[50] = '6" pipe'
    assert len(read(tmp_path, text_of("time,lat,lon,note", ISO, LAT, LON, note)).time) == N
    note[50], note[80] = '"six feet', '5"'  # together they would be one cell of 31 lines
    with pytest.raises(ValueError, match="quotes that close, got '2022-05-03T09:15:50Z"):
        read(tmp_path, text_of("time,lat,lon,note", ISO, LAT, LON, note))


def test_a_track_goes_back_as_a_frame_with_its_own_labels(tmp_path):
    frame = FRAME.set_index(pd.Index([f"fix {k}" for k in range(N)])).assign(time=MOMENTS)
    frame.iloc[20, 0] = np.nan
    frame.iloc[50, 0] += 0.01
    frame.iloc[60, -1] = pd.NaT
    frame = frame.astype({"hr": "Int64"})
    c = mpt.track(frame)
    back = c.to_frame()
    assert list(back.index) == list(frame.index.delete([20, 60]))
    assert back.index[~back["kept"]].tolist() == ["fix 50"]
    joined = frame.join(back.add_suffix("_smooth"), how="inner")
    assert (joined["time"] == joined["time_smooth"]).all()
    near = joined.drop(index="fix 50")
    np.testing.assert_allclose(near["lat"], near["lat_smooth"], atol=5e-5)
    np.testing.assert_array_equal(back[["x", "y"]], c.x[:, ::2])
    np.testing.assert_allclose(back[["v_x", "v_y"]], c.x[:, 1::2], atol=1e-3)  # the chart is small
    np.testing.assert_allclose(back["sigma"], np.sqrt(c.P[:, 0, 0]), rtol=1e-15)  # a root of one may round otherwise
    again = mpt.track(back)  # what was given back is a frame as any other
    assert len(again.t) == len(back)
    c.gpx(tmp_path / "frame.gpx")
    np.testing.assert_allclose(readers.read(tmp_path / "frame.gpx").lat, back["lat"], atol=1e-7)


def test_of_numbers_a_frame_has_no_degrees_and_its_times_as_they_were_given():
    c = mpt.tracks.clean(UNIX.astype(float), Z)
    assert c.to_frame().columns[:3].tolist() == ["time", "x", "y"]
    np.testing.assert_array_equal(c.to_frame()["time"], c.t)
    c = mpt.track(pd.DataFrame({"time": UNIX, "x": Z[:, 0], "y": Z[:, 1]}))
    np.testing.assert_array_equal(c.to_frame()["time"], UNIX)
    assert c.report().startswith("frame: 300 fixes in 0:04:59")


@pytest.mark.parametrize("path", sorted((ROOT / "tests" / "tracks").glob("*.csv.gz")), ids=lambda path: path.stem)
def test_the_shipped_tables_are_read_by_the_names_of_their_columns(path):
    r = readers.read(path, {"time": "t_s", "lat": "lat_deg", "lon": "lon_deg"})
    assert np.isfinite(r.lat).all()
    assert (np.diff(r.time) > 0).mean() > 0.99
    assert r.said == ()


def test_digits_of_a_clock_from_midnight_on_are_asked_about(tmp_path):
    """0, 10 ... 50, 100 ... are hhmmss. Steps of 50 or 100 s are seconds, and so is one of 45 s among others."""

    def table(times):
        rows = [f"{t:g},{2.0 * k},{0.5 * k}" for k, t in enumerate(times)]
        return "\n".join(["time,x,y", *rows]) + "\n"

    minutes, seconds = np.divmod(10 * np.arange(40), 60)
    with pytest.raises(ValueError, match=r"a clock's digits\?"):
        read(tmp_path, table(100 * minutes + seconds))
    for times in (
        50 * np.arange(40),
        100 * np.arange(40),
        10 * np.arange(40),
        np.cumsum([0, *[5] * 30, 45, *[5] * 30]),
    ):
        found = read(tmp_path, table(times)).time
        np.testing.assert_array_equal(found - found[0], 1_000_000 * times)
