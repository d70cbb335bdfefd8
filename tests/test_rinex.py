"""The code of the page "From RINEX to a filtered track" runs in order, and prints what the page says."""

import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import ROOT

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


@pytest.fixture
def page(monkeypatch):
    """What the page's code by hand defines: one satellite at the first epoch."""
    monkeypatch.chdir(ROOT)
    names = {}
    for text in [text for kind, text in BLOCKS if kind == "python"][:6]:
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


@pytest.mark.parametrize("clock", [900.0 * np.arange(240), make_table.C * 1e-3 * (np.arange(240) >= 239)])
def test_a_clock_that_runs_free_or_jumps_needs_its_own_variance(page, clock):
    """Said of 0.1 ppm and of a millisecond: tens of metres and more with the page's Q, the steered error with 1e12."""
    day, start, axes = page["day"], page["fixes"][0], page["axes"]
    errors = {}
    for variance in (1.0, 1e12):
        Q = np.diag([0.01, 0.01, 0.01, variance])
        ranges = day.ranges[:240] + clock[:, None]
        track = page["positioning"].position_kalman(day.satellites[:240], ranges, start.X, start.P, Q, 0.64)
        errors[variance] = np.linalg.norm(axes @ (track.X[-1, :3] - page["station"]))
    assert errors[1.0] > 60
    assert errors[1e12] < 1


class Recorded(dict):
    """What the script asks of georinex: columns with `values` and `dims`."""

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
    (row,) = make_table.rows_of("G05", observations, messages, page["station"], page["header"])
    day = page["day"]
    np.testing.assert_allclose(row[2:5], day.satellites[0, 4], rtol=0, atol=0.006)
    np.testing.assert_allclose([row[5], row[7]], [day.ranges[0, 4], day.troposphere[0, 4]], rtol=0, atol=0.006)
    assert row[8] == pytest.approx(day.dual[0, 4] if second else np.nan, abs=0.006, nan_ok=True)
    assert row[9] == pytest.approx(day.second[0, 4] if second else np.nan, abs=0.0006, nan_ok=True)
    both = "L2W" in phases  # a phase that is zero or not there is missing
    carriers = [day.phase1[0, 4], day.phase2[0, 4]] if both else [np.nan, np.nan]
    np.testing.assert_allclose(row[10:12], carriers, rtol=0, atol=0.0006)


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


STATION = {"position": [3582105.291, 532589.7313, 5232754.8054]}
IONOSPHERE = {"ionospheric_corr_GPS": np.zeros(8)}


@pytest.mark.parametrize(
    ("observations", "navigation", "said"),
    [
        (EOFError("cut"), Read(), r"^a: needs a RINEX 3 file of observations, got one that cannot be read \(EOFError"),
        (Read(C1C=[]), IndexError("cut"), r"^b: needs a RINEX 3 file of broadcast ephemerides, got one that cannot"),
        (Read(Toe=[]), Read(C1C=[]), r"^a needs GPS ranges C1C, b GPS ephemerides: are they swapped\?"),
        (Read(STATION, C1C=[]), Read(Toe=[]), "^b: needs GPSA and GPSB, the ionosphere, in its header"),
        (Read(C1C=[]), Read(IONOSPHERE, Toe=[]), "^a: APPROX POSITION XYZ: needs a position on the Earth"),
    ],
)
def test_a_file_that_will_not_do_is_named(monkeypatch, tmp_path, observations, navigation, said):
    def load(path, **_):
        found = {"a": observations, "b": navigation}[str(path)]
        if isinstance(found, Exception):
            raise found
        return found

    stub = SimpleNamespace(load=load, rinexheader=lambda path: {})
    monkeypatch.setitem(sys.modules, "georinex", stub)
    table = tmp_path / "table.csv.gz"
    monkeypatch.setattr(sys, "argv", ["make_table.py", "a", "b", str(table)])
    with pytest.raises(SystemExit, match=said):
        make_table.main()
    assert not table.exists()


@pytest.mark.parametrize("header", [{"position": [0.0, 0.0, 0.0]}, {"position": [55.5, 8.5, 59.0]}, {}])
def test_a_header_without_a_position_is_refused_by_name(header):
    with pytest.raises(ValueError, match="APPROX POSITION XYZ: needs a position on the Earth, got"):
        make_table.station_of(header)


def test_epochs_of_a_fraction_of_a_second_stay_apart():
    written = [make_table.FORMAT.split(",")[0] % epoch for epoch in (0, 0.2, 86_399.8, 86_370)]
    assert written == ["0", "0.2", "86399.8", "86370"]
