"""The code of the page "From RINEX to a filtered track" runs in order, and prints what the page says."""

import csv
import gzip
import io
import re
import runpy
import sys
import warnings
from contextlib import chdir, redirect_stdout
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import ROOT

from reproduction.paper_2007 import positioning, recorded

sys.path.insert(0, str(ROOT / "notebooks" / "data"))
import make_table

BLOCKS = re.findall(r"(?ms)^```(\w+)\n(.*?)^```$", (ROOT / "docs" / "rinex.md").read_text(encoding="utf-8"))


def test_the_code_prints_what_the_page_says(monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    names, printed = {}, ""
    for kind, text in BLOCKS:
        if kind == "python":
            assert printed == "", "the page does not say what the block before prints"
            exec(text, names)
            printed = capsys.readouterr().out
        elif kind == "text":
            assert printed == text
            printed = ""
    assert printed == ""


def table_of(path, step, missing=(), short=None):
    """Write the first 600 epochs of ESBC's table as if they were `step` seconds apart.

    Rows in `missing` are left out; `short` says how many ranges are kept of some rows. Return the path.
    """
    lines = gzip.decompress((ROOT / "notebooks" / "data" / recorded.TABLES["ESBC"]).read_bytes()).decode().splitlines()
    kept, count = lines[:2], {}
    for line in lines[2:]:
        epoch, _, rest = line.partition(",")
        row = round(float(epoch) / 30)
        count[row] = count.get(row, 0) + 1
        if row < 600 and row not in missing and count[row] <= (short or {}).get(row, 32):
            kept.append(f"{row * step:.10g},{rest}")
    path.write_bytes(gzip.compress("\n".join([*kept, ""]).encode()))
    return path


def run_from_own_table(path):
    """Run the page from "begin here" on with another table; return its names and what it prints."""
    codes = [text for kind, text in BLOCKS if kind == "python"]
    (first,) = (k for k, code in enumerate(codes) if "begin here" in code)
    names, shipped = {}, '"notebooks/data/esbc_2020_177.csv.gz"'
    with chdir(ROOT), redirect_stdout(io.StringIO()) as printed, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # half a day does not determine tau, and the page asks for a day
        for code in codes[first:]:
            exec(code.replace(shipped, repr(str(path))), names)
    return names, printed.getvalue()


MISSING, SHORT = [0, *range(20, 36), 150], {50: 3, 51: 5}  # five: nothing to spare, so that no fix is trusted


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    """The page's run on half a day of 30 s steps with missing epochs: its names and what it prints."""
    return run_from_own_table(table_of(tmp_path_factory.mktemp("own") / "t.csv.gz", 30, [*MISSING, 599], SHORT))


def test_the_page_runs_on_a_table_of_ones_own_with_missing_epochs(own):
    names, printed = own
    rows = np.array([*MISSING[1:], *SHORT]) - 1  # the table begins with the first epoch that is there
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(names["local"][:, 0])), np.sort(rows))
    assert "after 120 min, east north up: [" in printed
    assert "nan" not in printed
    assert np.isfinite(names["x"]).all()
    assert len(names["t"]) == 599 - len(MISSING) - len(SHORT)


def test_the_page_runs_on_a_table_of_another_step(own, tmp_path):
    """At 1 Hz the filter took 30 s steps without a word, and "two hours" stood for four minutes."""
    fast = table_of(tmp_path / "fast.csv.gz", 1, [*MISSING, 599], SHORT)
    names, printed = run_from_own_table(fast)
    assert "240 rows, 4 min" in printed
    assert printed.count("after 4 min") == 2
    assert names["model"].dt == names["axis"].dt == names["day"].step == 1
    assert names["honest"].model.F[2, 2] == pytest.approx(np.exp(-1 / names["found"].tau[0]))
    assert names["rows"] == 240
    others, printed = own
    assert printed.count("after 120 min") == 2
    np.testing.assert_allclose(others["Q"][:3, :3], 30 * names["Q"][:3, :3])  # a step of 30 s wanders as 30 of a second
    np.testing.assert_allclose(others["found"].tau, 30 * names["found"].tau, rtol=1e-3)


@pytest.mark.slow  # one more table; the page runs on one of one's own, with missing epochs, above
def test_the_page_s_faults_are_seen_at_belem():
    """They stood on satellites that were not in view there: nothing was left out, and nothing moved."""
    names, printed = run_from_own_table(ROOT / "notebooks" / "data" / recorded.TABLES["Belem"])
    one, two, half = re.findall(r"100 m short: \[(.*)\], left out \[(.*)\], fix.trusted = (.*), moved", printed)
    assert one[0] == one[1]
    assert two[0] == two[1]
    assert one[2] == two[2] == "True"
    assert len(two[0].split()) == 2
    assert len(half[0].split()) == np.isfinite(names["day"].ranges[names["row"]]).sum() // 2
    assert half[2] == "False"
    (off,) = re.findall(r"one range of G\d\d 100 m short: .* innovation (-\d+) m off the median", printed)
    assert -110 < int(off) < -90


@pytest.fixture(scope="module")
def page():
    """The names that the page's code by hand defines: one satellite at the first epoch."""
    names = {}
    with chdir(ROOT):
        for text in [text for kind, text in BLOCKS if kind == "python"][:9]:
            exec(text, names)
    return names


@pytest.fixture
def message(page):
    names = ["M0", "Cuc", "Cus", "Cic", "Cis", "Crs", "Crc", "omega", "TGD"]
    message = {name: page[name] for name in names}
    message |= {"Toe": page["toe"], "Eccentricity": page["e"], "sqrtA": page["sqrt_a"], "DeltaN": page["dn"]}
    message |= {"Omega0": page["node0"], "OmegaDot": page["node_rate"], "Io": page["i0"], "IDOT": page["i_rate"]}
    return message | {"SVclockBias": page["a0"], "SVclockDrift": page["a1"], "SVclockDriftRate": page["a2"]}


def test_the_script_computes_what_the_page_does_by_hand(page, message):
    left = page["t"] - page["C1C"] / make_table.C - page["clock"]
    position, clock = make_table.orbit(message, np.array([left]))
    np.testing.assert_allclose(position[0], page["at_transmission"], rtol=0, atol=1e-6)
    np.testing.assert_allclose(clock[0], page["clock"], rtol=1e-9)
    travel = np.linalg.norm(position - page["station"], axis=1) / make_table.C
    np.testing.assert_allclose(make_table.turned(position, travel)[0], page["satellite"], rtol=0, atol=1e-6)


CLOCKS = {"runs": 30.0 * np.arange(240), "jumps": make_table.C * 1e-3 * (np.arange(240) >= 239)}  # 0.1 ppm; 1 ms


@pytest.mark.parametrize(("clock", "step"), [("runs", 30), ("jumps", 1)])
def test_no_clock_moves_the_page_s_filter_and_any_moves_one_of_a_steered_clock(page, clock, step):
    """At 1 Hz it ended 15.7 m up and stated 0.31 m."""
    day, start, variance = page["day"], page["fixes"][0], page["variance"]
    at_rest = page["Q"][0, 0] * step / 30
    moved = {}
    for name, of_clock in {"steered": 1.0 * step / 30, "free": page["Q"][3, 3]}.items():
        Q = np.diag([at_rest, at_rest, at_rest, of_clock])
        ends = [
            page["positioning"].position_kalman(day.satellites[:240], ranges, start.X, start.P, Q, variance).X[-1, :3]
            for ranges in (day.ranges[:240], day.ranges[:240] + step * CLOCKS[clock][:, None])
        ]
        moved[name] = np.linalg.norm(ends[1] - ends[0])
    assert moved["steered"] > 10
    assert moved["free"] < 0.01


class Recorded(dict):
    """The part of georinex's data that the script uses: columns with `values` and `dims`."""

    def __init__(self, **columns):
        for name, values in columns.items():
            self[name] = SimpleNamespace(values=np.array(values), dims=("time",))

    @property
    def data_vars(self):
        return [name for name in self if name != "time"]

    def sel(self, sv):
        return self

    def dropna(self, *_, **__):
        return self


@pytest.mark.parametrize("phases", [{"L1C": [110078836.389], "L2W": [85775729.718]}, {"L1C": [0.0]}], ids=["L", "no L"])
@pytest.mark.parametrize("second", [{"C2W": [20947300.413]}, {}], ids=["C2W", "no C2W"])
def test_a_row_is_that_of_the_table_with_and_without_a_second_frequency(page, message, monkeypatch, second, phases):
    angles = np.array([page["azimuth"]]), np.array([page["elevation"]]), 0.0
    stub = SimpleNamespace(ecef2geodetic=lambda *_: (55.49, 8.46, 59.0), ecef2aer=lambda *_: angles)
    monkeypatch.setitem(sys.modules, "pymap3d", stub)
    time = np.array(["2020-06-25T00"], "datetime64[s]")
    messages = Recorded(time=time, health=[0.0], **{name: [value] for name, value in message.items()})
    observations = Recorded(time=time, C1C=[page["C1C"]], **second, **phases)
    (row,) = make_table.rows_of("G05", observations, messages, page["station"], page["header"], page["bias"])
    day = page["day"]
    np.testing.assert_allclose(row[2:5], day.satellites[0, 4], rtol=0, atol=0.006)
    np.testing.assert_allclose([row[5], row[7]], [day.ranges[0, 4], day.troposphere[0, 4]], rtol=0, atol=0.006)
    assert row[8] == pytest.approx(day.dual[0, 4] if second else np.nan, abs=0.006, nan_ok=True)
    assert row[9] == pytest.approx(day.second[0, 4] if second else np.nan, abs=0.0006, nan_ok=True)
    both = "L2W" in phases  # a phase that is zero or not there is missing
    carriers = [day.phase1[0, 4], day.phase2[0, 4]] if both else [np.nan, np.nan]
    np.testing.assert_allclose(row[10:12], carriers, rtol=0, atol=0.0006)
    assert row[12] == pytest.approx(day.bias[0, 4], abs=0.0006)


def test_messages_of_the_evening_before_a_sunday_are_of_the_week_before():
    """They were counted from the first message's week: Sunday's own message lay seven days ahead."""
    time = np.array(["2020-06-27T22", "2020-06-28T00", "2020-07-04T23:59:44", "2020-07-05T02"], "datetime64[s]")
    messages = Recorded(time=time, Toe=[597_600, 0, 604_784, 7_200], M0=[1.0, 2.0, 3.0, 4.0])
    t = np.array([-3_700, -3_500, 590_000, 606_000, 612_000])
    found = make_table.message_at(messages, "G05", t, np.datetime64("2020-06-28"))
    assert found["M0"].tolist() == [1, 2, 3, 3, 4]


def test_a_range_is_left_out_whose_message_is_older_than_two_hours(page, message, monkeypatch):
    angles = np.zeros(2), np.full(2, 60.0), 0.0
    stub = SimpleNamespace(ecef2geodetic=lambda *_: (55.49, 8.46, 59.0), ecef2aer=lambda *_: angles)
    monkeypatch.setitem(sys.modules, "pymap3d", stub)
    times = np.array(["2020-06-25T02:00:00", "2020-06-25T02:00:30"], "datetime64[s]")
    messages = Recorded(time=times[:1], health=[0.0], **{name: [value] for name, value in message.items()})
    observations = Recorded(time=times, C1C=[page["C1C"]] * 2)
    arguments = "G05", observations, messages, page["station"], page["header"]
    with pytest.warns(UserWarning, match=r"G05: 1 of 2 ranges left out: no message .* within two hours of them"):
        (row,) = make_table.rows_of(*arguments)
    assert row[0] == 7200
    messages["time"].values -= np.timedelta64(7, "D")  # a week ago the same second of the week
    with pytest.warns(UserWarning, match="G05: 2 of 2 ranges left out"):
        assert len(make_table.rows_of(*arguments)) == 0


@pytest.mark.parametrize(
    ("last", "header", "early"),
    [
        ("2024-05-03T23:59:30", {"TIME OF LAST OBS": "2024 5 3 23 59 59.0 GPS", "INTERVAL": "30.000"}, 0),
        ("2024-05-03T21:59:30", {"TIME OF LAST OBS": "2024 5 3 23 59 30.0 GPS"}, 7200),
        ("2024-05-03T21:59:30", {"INTERVAL": "30.000"}, 0),
    ],
)
def test_observations_that_end_before_their_header_says(last, header, early):
    assert make_table.ends_early(header, np.datetime64(last)) == early


class Read(dict):
    """A file as georinex gives it."""

    def __init__(self, attrs=(), **columns):
        super().__init__(columns)
        self.attrs = dict(attrs)


STATION = {"APPROX POSITION XYZ": "  3582105.2910   532589.7313  5232754.8054"}
IONOSPHERE = {"ionospheric_corr_GPS": np.zeros(8)}
OBS = {"rinextype": "obs", "version": 3.05, "fields": {"E": ["C1C"], "G": ["C1C", "C2W"]}}
NAV = {"rinextype": "nav", "version": 3.04}
ONE = SimpleNamespace(values=np.array([2e7]))


@pytest.mark.parametrize(
    ("observations", "navigation", "headers", "said"),
    [
        (
            EOFError("cut"),
            Read(),
            {},
            r"^a: needs a RINEX 3 file of observations, got one that cannot be read \(EOFError",
        ),
        (
            Read(C1C=ONE),
            IndexError("cut"),
            {},
            "^b: needs a RINEX 3 file of broadcast ephemerides, got one that cannot",
        ),
        (Read(), Read(), {"a": NAV, "b": OBS}, "^a: needs observations, got another kind of file: are the two swapped"),
        (Read(), Read(), {"b": OBS}, "^b: needs broadcast ephemerides, got another kind of file: are the two swapped"),
        (
            Read(),
            Read(),
            {"a": OBS | {"version": 2.11}},
            "^a: needs RINEX 3, got RINEX 2, whose names of ranges say less",
        ),
        (Read(), Read(), {"b": NAV | {"version": 2.0}}, "^b: needs RINEX 3, got RINEX 2"),
        (
            Read(),
            Read(),
            {"a": OBS | {"fields": {"E": [], "R": []}}},
            "^a: needs GPS observations, got those of E, R only",
        ),
        (Read(), Read(), {"a": OBS | {"fields": {"G": ["C1W"]}}}, "^a: needs GPS ranges C1C, got the observations C1W"),
        (Read(), Read(), {}, "^a: needs GPS ranges C1C, got none in its epochs"),
        (Read(C1C=ONE), Read(), {}, "^b: needs ephemerides of GPS satellites, got none"),
        (Read(C1C=ONE), Read(Toe=ONE), {"a": OBS | STATION}, "^b: needs GPSA and GPSB, the ionosphere, in its header"),
        (Read(C1C=ONE), Read(IONOSPHERE, Toe=ONE), {}, "^a: APPROX POSITION XYZ: needs a position on the Earth"),
    ],
)
def test_a_file_that_will_not_do_is_named(monkeypatch, tmp_path, observations, navigation, headers, said):
    headers = {"a": OBS, "b": NAV} | headers

    def load(text, **_):
        found = {"a": observations, "b": navigation}[text.getvalue()]
        if isinstance(found, Exception):
            raise found
        found.sv = SimpleNamespace(values=["G05"])
        return found

    stub = SimpleNamespace(load=load, rinexheader=lambda path: headers[str(path)])
    monkeypatch.setitem(sys.modules, "georinex", stub)
    monkeypatch.setattr(make_table, "text_of", str)
    for name in ("whole_epochs", "whole_messages"):
        monkeypatch.setattr(make_table, name, lambda text: (text, []))
    table = tmp_path / "table.csv.gz"
    monkeypatch.setattr(sys, "argv", ["make_table.py", "a", "b", str(table)])
    with pytest.raises(SystemExit, match=said):
        make_table.main()
    assert not table.exists()


def seen(**columns):
    """Observations of some satellites, (epochs, satellites) each, as the script asks georinex for them."""
    names = ["G05", "G07"]

    class Seen(dict):
        sv = SimpleNamespace(values=names)

        def sel(self, sv):
            codes = {name: values for name, values in self.items() if name != "time"}
            return {name: SimpleNamespace(values=values[:, names.index(sv)]) for name, values in codes.items()}

    return Seen({name: np.array(values, dtype=float) for name, values in columns.items()})


def test_own_biases_are_means_over_what_has_both_codes_about_their_mean():
    both = seen(C1C=[[101, 210], [102, 220], [103, 0]], C1W=[[100, 205], [np.nan, 215], [101, 300]])
    assert make_table.own_biases(both) == {"G05": (1 + 2) / 2 - 3.25, "G07": 5 - 3.25}
    assert make_table.own_biases(seen(C1C=[[1, 1]])) == {}


SINEX = """\
%=BIA 1.00 TST 2024:130:00000 TST 2024:010:00000 2024:125:00000 R 00000004
+BIAS/SOLUTION
*BIAS SVN_ PRN STATION__ OBS1 OBS2 BIAS_START____ BIAS_END______ UNIT __ESTIMATED_VALUE____ _STD_DEV___
"""
DSB = " DSB  G063 {prn:3} {station:9} {one:4} {two:4} {start} {end} {unit:4} {value:21.4f} {sd:11.4f}\n"
USUAL = {"prn": "G05", "station": "", "one": "C1C", "two": "C1W", "unit": "ns", "sd": 0.01}
USUAL |= {"start": "2024:010:00000", "end": "2024:011:00000"}
LATER = {"start": "2024:124:00000", "end": "2024:125:00000"}


@pytest.mark.parametrize(
    ("lines", "expected", "days"),
    [
        ([{"value": 1.0}, {"prn": "G07", "value": 3.0}], [-1.0, 1.0], 113),
        ([{"value": 1.0}, {"prn": "G07", "one": "C1W", "two": "C1C", "value": -3.0}], [-1.0, 1.0], 113),
        ([{"value": 9.0}, {"value": 1.0, **LATER}, {"prn": "G07", "value": 3.0, **LATER}], [-1.0, 1.0], 0),
        ([{"value": 1.0, **LATER}, {"value": 9.0}, {"prn": "G07", "value": 3.0, **LATER}], [-1.0, 1.0], 0),
        (
            [{"value": 1.0}, {"prn": "G07", "value": 3.0}, {"prn": "G", "station": "BELE", "value": 50.0}],
            [-1.0, 1.0],
            113,
        ),
        ([{"value": 1.0}, {"prn": "G07", "value": 3.0}, {"two": "C2W", "value": 50.0}], [-1.0, 1.0], 113),
        ([{"value": 1.0}, {"prn": "G07", "value": 3.0}, {"prn": "E05", "value": 50.0}], [-1.0, 1.0], 113),
    ],
    ids=["DSB", "turned round", "nearest in time", "and first", "a station", "other codes", "another system"],
)
def test_biases_of_a_sinex_file_are_read(tmp_path, lines, expected, days):
    """And gzipped, as they are published."""
    text = SINEX + "".join(DSB.format(**USUAL | line) for line in lines) + "-BIAS/SOLUTION\n%=ENDBIA\n"
    for name, raw in {"b.bsx": text.encode(), "b.bsx.gz": gzip.compress(text.encode())}.items():
        (tmp_path / name).write_bytes(raw)
        found, away = make_table.read_biases(tmp_path / name, np.datetime64("2024-05-03"))
        nanosecond = make_table.C * 1e-9
        assert found == pytest.approx({"G05": expected[0] * nanosecond, "G07": expected[1] * nanosecond})
        assert away == days


def test_biases_of_single_codes_are_subtracted(tmp_path):
    line = DSB.replace("DSB", "OSB")
    values = {("G05", "C1C"): 5.0, ("G05", "C1W"): 4.0, ("G07", "C1C"): 2.0, ("G07", "C1W"): -1.0, ("G08", "C1C"): 7.0}
    lines = [line.format(**USUAL | {"prn": s, "one": code, "two": "", "value": v}) for (s, code), v in values.items()]
    (tmp_path / "b.bsx").write_text(SINEX + "".join(lines))
    found, _ = make_table.read_biases(tmp_path / "b.bsx", np.datetime64("2024-01-10"))
    assert found == pytest.approx({"G05": -make_table.C * 1e-9, "G07": make_table.C * 1e-9})


def test_biases_of_a_csv_are_read_and_another_file_is_refused(tmp_path):
    (tmp_path / "b.csv").write_text("satellite,C1C_minus_C1W_ns,sigma_ns\nG05,1.0,0.1\nG07,3.0,0.1\n")
    found, days = make_table.read_biases(tmp_path / "b.csv", np.datetime64("2024-01-10"))
    assert found == pytest.approx({"G05": -make_table.C * 1e-9, "G07": make_table.C * 1e-9})
    assert days is None
    (tmp_path / "c.csv").write_text("satellite,bias\nG05,1.0\n")
    with pytest.raises(ValueError, match=r"c.csv: needs Bias-SINEX, or a CSV with the columns satellite and C1C_minus"):
        make_table.read_biases(tmp_path / "c.csv", np.datetime64("2024-01-10"))
    (tmp_path / "d.bsx").write_text(SINEX)
    with pytest.raises(ValueError, match=r"d.bsx: needs biases of C1C and C1W of GPS satellites, got none"):
        make_table.read_biases(tmp_path / "d.bsx", np.datetime64("2024-01-10"))


def day_of_two(**columns):
    """Observations of two satellites on 3 May 2024."""
    day = seen(**columns)
    dict.__setitem__(day, "time", SimpleNamespace(values=np.array(["2024-05-03"], "datetime64[s]")))
    return day


def test_biases_that_are_missing_or_old_are_told_in_one_line(tmp_path):
    day = day_of_two(C1C=[[1, 1]])
    with pytest.warns(
        UserWarning, match="no C1W, and no --biases are given: .* error that lasts, of two frequencies, 1.4 to"
    ):
        assert make_table.biases_of(day, None) == ({}, "none")
    (tmp_path / "b.bsx").write_text(SINEX + DSB.format(**USUAL | {"value": 1.0}))
    with pytest.warns(UserWarning, match="is 113 days from the observations: numbers of satellites go to new ones"):
        make_table.biases_of(day, tmp_path / "b.bsx")
    (tmp_path / "b.csv").write_text("satellite,C1C_minus_C1W_ns\nG05,1.0\n")
    with pytest.warns(UserWarning, match="does not say of which day its biases are"):
        make_table.biases_of(day, tmp_path / "b.csv")


def sinex_of(path, **values):
    """Write a file of biases of that day, satellites' values in ns, and return its path."""
    path.write_text(SINEX + "".join(DSB.format(**USUAL | LATER | {"prn": s, "value": v}) for s, v in values.items()))
    return path


def test_satellites_without_a_bias_of_their_own_take_that_of_the_file_on_the_mean_of_those_shared(tmp_path):
    """The file was dropped without a word where one satellite had its own; its mean is that of other receivers."""
    light = make_table.C * 1e-9
    day = day_of_two(C1C=[[103, 200]], C1W=[[100, np.nan]])
    path = sinex_of(tmp_path / "b.bsx", G05=7.0, G07=11.0, G09=25.0)
    found, source = make_table.biases_of(day, path)
    assert found == pytest.approx({"G05": -2 * light, "G07": 2 * light})  # G07 is 4 ns above G05, as in the file
    assert source == f"of the observations, and of {path}, put on their mean, for G07"
    whole = day_of_two(C1C=[[103, 200]], C1W=[[100, 201]])
    found, source = make_table.biases_of(whole, path)
    assert found == {"G05": 2.0, "G07": -2.0}
    assert source == f"of the observations, for 2 satellites; {path} knows no others"
    other = sinex_of(tmp_path / "c.bsx", G07=11.0)
    found, source = make_table.biases_of(day, other)
    assert found == {"G05": 0.0}
    assert source == f"of the observations, for 1 satellites; {other} knows none of these, and is not used"


@pytest.mark.parametrize(
    ("line", "got"), [("G07,", "nothing"), ("G07", "nothing"), ("G07,n/a", "n/a")], ids=["empty", "short", "word"]
)
def test_a_line_of_a_csv_without_a_number_is_named(tmp_path, line, got):
    path = tmp_path / "b.csv"
    path.write_text(f"satellite,C1C_minus_C1W_ns\nG05,1.0\n{line}\n")
    with pytest.raises(ValueError, match=rf"b.csv, line 3: needs a number in C1C_minus_C1W_ns, got {got}$"):
        make_table.read_biases(path, np.datetime64("2024-05-03"))


def test_a_folder_that_does_not_exist_is_refused_before_the_work(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "argv", ["make_table.py", "a", "b", str(tmp_path / "gone" / "table.csv.gz")])
    monkeypatch.setattr(make_table, "load", lambda *_, **__: pytest.fail("the files were read"))
    with pytest.raises(SystemExit, match=r"table.csv.gz: needs a folder that exists, got .*gone$"):
        make_table.main()


def test_a_warning_of_the_script_is_one_line(monkeypatch, tmp_path, capsys):
    time = SimpleNamespace(values=np.array(["2024-05-03"], "datetime64[s]"))
    files = {OBSERVATIONS: Read(C1C=ONE, time=time), NAVIGATION: Read(IONOSPHERE, Toe=ONE)}
    for text, satellite in {OBSERVATIONS: "G05", NAVIGATION: "G07"}.items():
        files[text].sv = SimpleNamespace(values=[satellite])
    headers = {RINEX / "observations.rnx": OBS | STATION, RINEX / "navigation.rnx": NAV}
    stub = SimpleNamespace(load=lambda text, **_: files[text.getvalue()], rinexheader=headers.get)
    monkeypatch.setitem(sys.modules, "georinex", stub)
    monkeypatch.setitem(sys.modules, "georinex.rio", SimpleNamespace(opener=lambda path: path.open()))
    monkeypatch.setattr(sys, "argv", ["make_table.py", *map(str, headers), str(tmp_path / "table.csv.gz")])
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    warnings.simplefilter("always")
    with pytest.raises(SystemExit, match="needs messages of the day"):
        runpy.run_path(make_table.__file__, run_name="__main__")
    assert capsys.readouterr().err == f"warning: {make_table.NO_BIASES}\n"


RINEX = ROOT / "tests" / "rinex"
OBSERVATIONS, NAVIGATION = ((RINEX / f"{name}.rnx").read_text() for name in ("observations", "navigation"))
COMMENT = f"{'SITE (own marker)':60}COMMENT\n"
EVENT = ">                              4  1\n"
SECOND = OBSERVATIONS.index("> 2020 06 25 00 00 30")
MOVED = f"{'  3582205.2910   532589.7313  5232754.8054':60}APPROX POSITION XYZ\n"


@pytest.mark.parametrize(
    "inside", [COMMENT, EVENT + COMMENT, ">                              6  1\nG05  20947300.931\n"]
)
@pytest.mark.parametrize("at", [SECOND, OBSERVATIONS.index("G30"), len(OBSERVATIONS)])
def test_comments_and_events_do_not_end_the_observations(inside, at):
    if inside[0] == ">" and at not in (SECOND, len(OBSERVATIONS)):
        pytest.skip("an event stands between two epochs")
    spoilt = OBSERVATIONS[:at] + inside + OBSERVATIONS[at:]
    assert make_table.whole_epochs(spoilt) == (OBSERVATIONS, [])


@pytest.mark.parametrize(
    ("spoilt", "kept", "said"),
    [
        (OBSERVATIONS[:-7], OBSERVATIONS[:-17] + 16 * " " + "\n", "the last line is cut within a number"),
        (
            OBSERVATIONS[: OBSERVATIONS.rindex("G30")],
            None,
            r"1 epochs have fewer .* than they announce \(2020 06 25 00 00 3",
        ),
        (
            OBSERVATIONS[: SECOND + 36],
            None,
            r"1 epochs left out that are cut, empty, or not later \(2020 06 25 00 00 30",
        ),
        (OBSERVATIONS[: SECOND + 9], None, "1 epochs left out that are cut"),
        (OBSERVATIONS + OBSERVATIONS[SECOND:], OBSERVATIONS, "1 epochs left out .* not later"),
        (
            OBSERVATIONS[:SECOND] + EVENT + MOVED + OBSERVATIONS[SECOND:],
            None,
            "not read from .* APPROX POSITION XYZ is",
        ),
        (
            OBSERVATIONS[:SECOND] + ">                              3  0\n" + OBSERVATIONS[SECOND:],
            None,
            "a new site is",
        ),
    ],
)
def test_observations_that_are_cut_or_change_are_read_up_to_there_and_it_is_said(spoilt, kept, said):
    text, left_out = make_table.whole_epochs(spoilt)
    assert len(left_out) == 1
    assert re.match(f"(?:.*){said}", left_out[0])
    if kept is not None:
        assert text == kept
    elif "fewer" in said:
        assert text.splitlines()[-2:] == ["> 2020 06 25 00 00 30.0000000  0  1", spoilt.splitlines()[-1]]
    else:
        assert text == OBSERVATIONS[:SECOND]


def test_a_whole_last_line_without_its_end_keeps_its_numbers():
    assert make_table.whole_epochs(OBSERVATIONS[:-1]) == (OBSERVATIONS, [])


def test_messages_that_are_cut_are_left_out_and_comments_are_none_of_their_lines():
    lines = NAVIGATION.splitlines(keepends=True)
    commented = "".join([*lines[:8], COMMENT, *lines[8:]])
    for text in (NAVIGATION, NAVIGATION[:-1], commented):
        assert make_table.whole_messages(text)[1] == []
        assert make_table.whole_messages(text)[0].splitlines() == NAVIGATION.splitlines()
    for cut in (NAVIGATION[:-100], NAVIGATION[:-50]):
        text, (said,) = make_table.whole_messages(cut)
        assert text.splitlines() == NAVIGATION.splitlines()[:-8]
        assert said == "1 messages left out that are cut or broken (G30 2020 06 25 02 00 00)"


def test_two_positions_in_a_header_are_refused_and_one_twice_is_one():
    twice = {"APPROX POSITION XYZ": 2 * f"{STATION['APPROX POSITION XYZ']} "}
    np.testing.assert_array_equal(make_table.station_of(twice), make_table.station_of(STATION))
    with pytest.raises(
        ValueError, match=r"APPROX POSITION XYZ: needs one position, got \[\[3582105.291, .*\[3582205.291"
    ):
        make_table.station_of({"APPROX POSITION XYZ": f"{STATION['APPROX POSITION XYZ']} {MOVED[:60]}"})


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ("G05,nan\nG07,1.0", "needs biases in ns, within 20 of their median 1, got nan of G05"),
        ("G05,1.0\nG07,2.0\nG08,1000", "got 1000 of G08"),
        ("G05,1.0\nG07,2.0\nG05,1.0", "line 4: needs one bias of each satellite, got G05 again"),
    ],
)
def test_a_bias_that_is_none_is_refused_by_its_satellite(tmp_path, lines, said):
    path = tmp_path / "b.csv"
    path.write_text(f"satellite,C1C_minus_C1W_ns\n{lines}\n")
    with pytest.raises(ValueError, match=rf"b.csv.*{said}"):
        make_table.read_biases(path, np.datetime64("2024-05-03"))


def test_two_biases_of_a_satellite_at_one_time_are_refused_if_they_disagree(tmp_path):
    path = tmp_path / "b.bsx"
    lines = [DSB.format(**USUAL | {"value": value}) for value in (1.0, 1.5)]
    path.write_text(SINEX + "".join(lines))  # as of two days that share their midnight
    make_table.read_biases(path, np.datetime64("2024-01-10"))
    path.write_text(SINEX + lines[0] + DSB.format(**USUAL | {"value": 9.0}))
    with pytest.raises(ValueError, match="needs one bias of G05 at a time, got 1 and 9 ns"):
        make_table.read_biases(path, np.datetime64("2024-01-10"))


with (ROOT / "tests" / "rinex" / "by_cssrlib.csv").open(encoding="utf-8", newline="") as file:
    BY_CSSRLIB = list(csv.DictReader(file))


@pytest.mark.parametrize("station", recorded.TABLES)
def test_the_tables_are_those_of_a_program_that_shares_no_code(station):
    """cssrlib's numbers, stored by tests/tools/by_cssrlib.py: orbits, clocks, delays, biases, ranges."""
    file = recorded.TABLES[station]
    day = recorded.recorded_day(ROOT / "notebooks" / "data" / file)
    own = [row for row in BY_CSSRLIB if row["table"] == file.split(".")[0]]
    theirs = {name: np.array([float(row[name]) for row in own]) for name in own[0] if name != "table"}
    at = (theirs["epoch"] // 30).astype(int), theirs["satellite"].astype(int) - 1
    every = at[0][0] + 193 * np.arange(15)
    assert sorted(zip(*at, strict=True)) == [(k, s) for k in every for s in np.flatnonzero(np.isfinite(day.ranges[k]))]
    distance = np.linalg.norm(day.satellites[at] - day.station, axis=1)
    # Positions are stored to 1 cm on each axis.
    np.testing.assert_allclose(distance, theirs["distance"], rtol=0, atol=0.01)
    # cssrlib's zero is at 273.16 K, and its dry delay grows towards the poles: 1.5 permille.
    np.testing.assert_allclose(day.troposphere[at], theirs["troposphere"], rtol=0.003, atol=0.006)
    # 1 / sin(elevation) is good for most of a metre at 10 degrees only, against mapping functions of Niell.
    high = theirs["elevation"] > 20
    np.testing.assert_allclose(day.troposphere[at][high], theirs["niell"][high], rtol=0.03)
    known = np.isfinite(theirs["bias"])
    gap = day.bias[at][known] - theirs["bias"][known]  # a constant, of all satellites
    np.testing.assert_allclose(gap, np.median(gap), rtol=0, atol=0.001)
    bias = np.where(known, theirs["bias"] + np.median(gap), 0)
    computed = (
        theirs["measured"] - bias + theirs["clock"] - theirs["group"] - theirs["ionosphere"] - day.troposphere[at]
    )
    np.testing.assert_allclose(day.ranges[at], computed, rtol=0, atol=0.015)


def test_the_cost_of_missing_biases_is_what_the_script_says():
    low, high = map(
        float, re.search(r"lasts, of two frequencies, ([\d.]+) to ([\d.]+) times", make_table.NO_BIASES).groups()
    )
    for station, file in recorded.TABLES.items():
        day = recorded.recorded_day(ROOT / "notebooks" / "data" / file)
        sizes = [
            recorded.size(recorded.case(station, each, recorded.KINDS[1]).lasting)
            for each in (recorded.without_biases(day), day)
        ]
        assert low < sizes[0] / sizes[1] < high


def test_the_pages_variance_leaves_no_range_out_where_the_ionosphere_is_thick():
    """At Belem a fixed 0.64 m² left out 43 ranges of a day on which none was faulty."""
    day = recorded.recorded_day(ROOT / "notebooks" / "data" / recorded.TABLES["Belem"])
    sigma = recorded.ranging_sigma(recorded.fixes(day, day.ranges))
    esbc = recorded.recorded_day(ROOT / "notebooks" / "data" / recorded.TABLES["ESBC"])
    in_denmark = recorded.ranging_sigma(recorded.fixes(esbc, esbc.ranges))
    assert 1.8 < sigma / in_denmark < 2.2  # as the page says: twice as large
    found = recorded.tested(day, day.ranges)
    np.testing.assert_array_equal(np.isfinite(found.ranges), np.isfinite(day.ranges))
    evening = range(2300, 2880, 20)
    fixed = [
        positioning.position(day.satellites[k, s], day.ranges[k, s], variance=0.64, false_alarm=1e-5).used.all()
        for k in evening
        for s in [np.isfinite(day.ranges[k])]
    ]
    assert not all(fixed)


@pytest.mark.parametrize("position", ["  0.0 0.0 0.0", "55.5 8.5 59.0", None])
def test_a_header_without_a_position_is_refused_by_name(position):
    header = {} if position is None else {"APPROX POSITION XYZ": position}
    with pytest.raises(ValueError, match="APPROX POSITION XYZ: needs a position on the Earth, got"):
        make_table.station_of(header)


def test_epochs_of_a_fraction_of_a_second_stay_apart():
    written = [make_table.FORMAT.split(",")[0] % epoch for epoch in (0, 0.2, 86_399.8, 86_370)]
    assert written == ["0", "0.2", "86399.8", "86370"]
