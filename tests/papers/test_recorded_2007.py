"""The recorded days of three receivers: their tables, what is made of them, and what the article says of it."""

import gzip
import re
import sys
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import ROOT, cells_of, parts, prose, shown, source
from scipy.signal import lfilter
from scipy.special import erf

import mpt_helpers as mpt
from reproduction.lasting import fit_lasting, lasting_error
from reproduction.paper_2007 import article, positioning, recorded
from reproduction.paper_2007.positioning import line_sigma

sys.path.insert(0, str(ROOT / "notebooks" / "data"))
import make_table

DATA = ROOT / "notebooks" / "data"
NOTEBOOK = ROOT / "notebooks" / "2007_mms_kalman.ipynb"
ROWS = {"ESBC": 25_801, "NYA1": 29_835, "Belem": 28_622}
CASES = [f"{station}, {kind}" for station in recorded.TABLES for kind in recorded.KINDS]


@pytest.fixture(scope="module")
def days():
    return recorded.recorded_days({name: DATA / file for name, file in recorded.TABLES.items()})


@pytest.fixture(scope="module")
def cases(days):
    return recorded.cases(days)


@pytest.fixture(scope="module")
def filtered(cases):
    """The fits and the filters of all recordings."""
    return article.filtered(cases)


@pytest.mark.parametrize("station", recorded.TABLES)
def test_a_table_is_the_day_that_its_readme_states(days, station):
    day, file = days[station], DATA / recorded.TABLES[station]
    assert day.ranges.shape == (2880, 32)
    assert np.isfinite(day.ranges).sum() == ROWS[station]
    readme = (DATA / "README.md").read_text(encoding="utf-8")
    assert f"{ROWS[station]:,}" in readme
    assert recorded.TABLES[station] in readme
    np.testing.assert_array_equal(np.diff(day.seconds), 30)
    assert file.stat().st_size < 1.5e6
    seen = np.isfinite(day.ranges)
    assert (np.isfinite(day.satellites).all(axis=2) == seen).all()
    assert (day.troposphere[seen] > 2.2).all()
    height = [positioning.elevation(day.satellites[k, s], day.station) for k, s in enumerate(seen)]
    assert np.concatenate(height).min() > 10
    there = np.isfinite(day.second) & np.isfinite(day.phase1) & np.isfinite(day.phase2)
    assert (there & seen).sum() > 0.99 * seen.sum()
    assert np.unique(day.bias[seen & (day.bias != 0)]).size >= 30  # one for each satellite
    assert np.nanstd(day.bias) > 0.2


@pytest.mark.parametrize("file", recorded.TABLES.values())
def test_the_columns_of_a_table_are_those_of_its_script(file):
    with gzip.open(DATA / file, "rt") as lines:
        assert next(lines).startswith("# station,")
        assert next(lines).strip() == make_table.COLUMNS
        assert len(next(lines).split(",")) == len(make_table.FORMAT.split(",")) == len(make_table.COLUMNS.split(","))


def test_a_table_without_the_phases_is_refused(tmp_path):
    old = "# station,1,2,3\nepoch,satellite,x,y,z,range,elevation,troposphere,dual\n"
    (tmp_path / "old.csv.gz").write_bytes(gzip.compress(old.encode()))
    with pytest.raises(
        ValueError, match=r"path: needs a table of make_table.py with its 13 columns, got the columns epoch,"
    ):
        recorded.recorded_day(tmp_path / "old.csv.gz")


def test_the_two_frequencies_of_the_table_are_one_combination(days):
    """`dual` and `second` hold C2W both: what is left between them is Klobuchar's model and the group delay."""
    for day in days.values():
        by_second = -day.second / (recorded.LAMBDA - 1)
        gap = day.dual - by_second
        steps = np.diff(gap, axis=0)
        # From epoch to epoch the model moves by centimetres (more at the equator), the noise of C2W by decimetres.
        assert np.nanmax(np.abs(steps)) < 0.5
        assert np.nanstd(np.diff(by_second, axis=0)) > 3 * np.nanstd(steps)


@pytest.mark.parametrize("kind", recorded.KINDS)
@pytest.mark.parametrize("station", recorded.TABLES)
def test_fixes_of_a_day_are_those_of_position(days, station, kind):
    day = days[station]
    ranges = recorded.ranges_of(day, kind)
    variance = (day.troposphere / np.nanmin(day.troposphere)) ** 2
    found = recorded.fixes(day, ranges, variance)
    axes = positioning.local_axes(day.station)
    for k in range(0, len(ranges), 144):
        s = np.isfinite(ranges[k])
        fix = positioning.position(day.satellites[k, s], ranges[k, s], variance=variance[k, s])
        np.testing.assert_allclose(found.local[k], (fix.X[:3] - day.station) @ axes.T, rtol=0, atol=1e-6)
        np.testing.assert_allclose(found.P[k], axes @ fix.P[:3, :3] @ axes.T, rtol=1e-6, atol=1e-9)
        assert found.chi_square[k] == pytest.approx(fix.chi_square, abs=1e-6)
        assert found.redundant[k] == s.sum() - 4
    assert np.linalg.norm(found.local, axis=1).max() < 20


def test_an_epoch_of_three_satellites_is_missing(days):
    day = days["ESBC"]
    few = day.ranges.copy()
    few[7, np.flatnonzero(np.isfinite(few[7]))[3:]] = np.nan
    found, whole = recorded.fixes(day, few), recorded.fixes(day, day.ranges)
    assert np.isnan(found.local[7]).all()
    np.testing.assert_array_equal(np.delete(found.local, 7, axis=0), np.delete(whole.local, 7, axis=0))


def write_table(path, rows):
    """A table of make_table.py with the columns that matter: (epoch, satellite, range)."""
    lines = [f"{epoch:g},{satellite},1e7,1e7,2e7,{value:.2f},45,2.5,0,0,0,0,0.1" for epoch, satellite, value in rows]
    text = "\n".join(["# station,1,2,3", make_table.COLUMNS, *lines, ""])
    path.write_bytes(gzip.compress(text.encode()))


def test_epochs_that_are_missing_become_rows_and_those_out_of_step_are_refused(tmp_path):
    write_table(tmp_path / "gap.csv.gz", [(k, 5, 2e7 + k) for k in (3, 4, 5, 8, 9)])
    day = recorded.recorded_day(tmp_path / "gap.csv.gz")
    assert day.step == 1
    np.testing.assert_array_equal(day.seconds, np.arange(3, 10))
    np.testing.assert_array_equal(day.ranges[:, 4] - 2e7, [3, 4, 5, np.nan, np.nan, 8, 9])
    write_table(tmp_path / "odd.csv.gz", [(k, 5, 2e7) for k in (0, 30, 60, 90, 91, 120)])
    with pytest.raises(ValueError, match="path: needs epochs of one step, here 30 s, got epochs 1 s apart"):
        recorded.recorded_day(tmp_path / "odd.csv.gz")


def test_biases_are_put_back(days):
    """Into one frequency as they are, into two 2.55 times."""
    for day in days.values():
        left_in = recorded.without_biases(day)
        for kind, factor in zip(recorded.KINDS, (1, recorded.LAMBDA / (recorded.LAMBDA - 1)), strict=True):
            gap = recorded.ranges_of(left_in, kind) - recorded.ranges_of(day, kind)
            known = np.isfinite(gap)
            np.testing.assert_allclose(gap[known], factor * day.bias[known], atol=1e-6)
        assert np.nanmax(np.abs(left_in.bias)) == 0


@pytest.mark.parametrize("station", recorded.TABLES)
def test_a_fault_of_one_range_is_left_out_and_nothing_else(days, station):
    """One fault of 249 m once turned the message of the article round."""
    day = days[station]
    whole = recorded.tested(day, day.ranges)
    np.testing.assert_array_equal(whole.ranges, day.ranges)
    assert whole.said.startswith("left out: 0 faulty of ")
    faulty = day.ranges.copy()
    k, j = 1000, np.flatnonzero(np.isfinite(day.ranges[1000]))[2]
    faulty[k, j] += 249
    found = recorded.tested(day, faulty)
    assert np.isnan(found.ranges[k, j])
    faulty[k, j] = np.nan
    np.testing.assert_array_equal(found.ranges, faulty)
    assert re.match(r"left out: 1 faulty of [\d,]+ ranges, 0 of 2,880 epochs", found.said)
    assert found.sigma == pytest.approx(whole.sigma, rel=0.01)


def test_epochs_that_nothing_tests_and_poor_ones_are_left_out(days):
    day = days["ESBC"]
    ranges = day.ranges.copy()
    s = np.flatnonzero(np.isfinite(ranges[50]))
    ranges[50, s[4:]] = np.nan  # four satellites always agree
    ranges[60, np.isfinite(ranges[60])] += 500 * np.random.default_rng(1).standard_normal(np.isfinite(ranges[60]).sum())
    found = recorded.tested(day, ranges)
    assert np.flatnonzero(np.isnan(found.ranges).all(axis=1)).tolist() == [50, 60]
    assert found.said.endswith("2 of 2,880 epochs")


def test_a_case_with_missing_epochs_and_a_fault_is_nearly_that_without(days, cases):
    day = days["NYA1"]
    ranges = day.ranges.copy()
    ranges[100:140] = np.nan
    ranges[2000, np.flatnonzero(np.isfinite(ranges[2000]))[0]] -= 400
    found = recorded.case("NYA1", day._replace(ranges=ranges), recorded.KINDS[0])
    whole = cases["NYA1, one frequency"]
    assert np.isnan(found.errors[100:140]).all()
    for name in ("errors", "noise", "lasting", "smooth"):
        assert recorded.size(getattr(found, name)) == pytest.approx(recorded.size(getattr(whole, name)), rel=0.02)
    assert recorded.newest_ratio(found.errors, 100) == pytest.approx(recorded.newest_ratio(whole.errors, 100), rel=0.03)
    judged = [
        recorded.judged(recorded.white(30.0, 1.0), recorded.windows(each.errors[:, 2])) for each in (found, whole)
    ]
    assert judged[0].nis == pytest.approx(judged[1].nis, rel=0.05)
    assert np.isfinite([*judged[0].error, *judged[0].stated, judged[0].nees]).all()


def test_one_phase_gives_a_short_average_and_none_gives_none(days, cases):
    """It was the code itself, silently: a noise of 0 and ratios of NaN."""
    day = days["NYA1"]._replace(phase2=np.full((2880, 32), np.nan))
    assert recorded.phases_of(day) == 1
    found = recorded.case("NYA1", day, recorded.KINDS[0])
    assert (found.noise, found.lasting) == (None, None)
    both = cases["NYA1, one frequency"]
    assert recorded.size(both.smooth) < recorded.size(found.smooth) < 0.95 * recorded.size(both.errors)
    none = recorded.case("NYA1", day._replace(phase1=day.phase2), recorded.KINDS[0])
    assert none.smooth is None
    table = {"NYA1, one frequency": none}
    assert article.how_far(table)[0][3:5] == ["-", "-"]
    assert article.remedies(table)[0][3] == "-"
    assert recorded.kinds_of(day._replace(dual=day.phase2)) == recorded.KINDS[:1]


def test_two_positions_that_both_agree_are_not_trusted(days):
    """Seven satellites at this epoch: without G05, which is 100 m short, and without G24 the other six agree."""
    day, k = days["ESBC"], 230
    s = np.isfinite(day.ranges[k])
    short = day.ranges[k, s] - 100 * (np.flatnonzero(s) == 4)
    fix = positioning.position(day.satellites[k, s], short, variance=0.64, false_alarm=1e-5)
    true = positioning.position(day.satellites[k, s], day.ranges[k, s])
    assert fix.probability > 1e-5
    assert np.linalg.norm((fix.X - true.X)[:3]) > 50
    assert not fix.trusted


def test_two_faults_among_nine_are_found(days):
    """Left out one after the other, the first one was the wrong one."""
    day, k = days["ESBC"], 60
    s = np.isfinite(day.ranges[k])
    faulty = np.isin(np.flatnonzero(s), [4, 12])
    fix = positioning.position(day.satellites[k, s], day.ranges[k, s] - 100 * faulty, variance=0.64, false_alarm=1e-5)
    np.testing.assert_array_equal(fix.used, ~faulty)
    assert fix.trusted


def invented_day(rng, N=400):
    """A day whose code, phases, ionosphere and slips are known: one satellite, as a Day of 32."""
    column = np.full((N, 32), np.nan)
    iono = 3 + np.cumsum(0.01 * rng.standard_normal(N))
    noise1, noise2 = 0.4 * rng.standard_normal((2, N))
    ambiguity1, ambiguity2 = np.where(np.arange(N) < 150, 7.0, -2.0), np.where(np.arange(N) < 150, 4.0, 9.0)
    code1, code2 = iono + noise1, recorded.LAMBDA * iono + noise2  # about the distance, which all share
    phase1, phase2 = -iono + ambiguity1, -recorded.LAMBDA * iono + ambiguity2
    values = {"second": code2 - code1, "phase1": phase1 - code1, "phase2": phase2 - code1}
    values["ranges"] = code1
    values["dual"] = (recorded.LAMBDA * code1 - code2) / (recorded.LAMBDA - 1) - code1
    columns = {name: column.copy() for name in recorded.Day._fields[3:]}
    for name, value in values.items():
        columns[name][:, 4] = value
    day = recorded.Day(np.zeros(3), 30.0 * np.arange(N), np.full((N, 32, 3), np.nan), **columns)
    return day, {
        "one frequency": noise1,
        "two frequencies": (recorded.LAMBDA * noise1 - noise2) / (recorded.LAMBDA - 1),
    }


def test_lambda_is_the_square_of_the_frequencies():
    assert pytest.approx((make_table.L1 / make_table.L2) ** 2, rel=1e-7) == recorded.LAMBDA


@pytest.mark.parametrize("kind", recorded.KINDS)
def test_code_and_carrier_differ_by_the_noise_and_a_constant_for_each_arc(kind):
    day, noise = invented_day(np.random.default_rng(1))
    arc = recorded.arcs(day)
    assert [set(arc[:150, 4]), set(arc[150:, 4])] == [{arc[0, 4]}, {arc[150, 4]}]
    assert arc[0, 4] != arc[150, 4]
    assert set(np.delete(arc, 4, axis=1).ravel()) == {-1}
    gap = (recorded.carrier(day, kind) + noise[kind][:, None])[:, 4]
    for part in (gap[:150], gap[150:]):
        np.testing.assert_allclose(part, part[0], atol=1e-9)


def test_arcs_end_at_gaps_at_slips_of_one_cycle_and_at_slips_of_both_frequencies():
    day, _ = invented_day(np.random.default_rng(2))
    whole = recorded.arcs(day)[150:, 4]
    assert len(set(whole)) == 1
    one = day._replace(phase1=day.phase1 + np.where(np.arange(400) >= 300, make_table.C / make_table.L1, 0.0)[:, None])
    both = np.where(np.arange(400) >= 300, 77 * make_table.C / make_table.L1, 0.0)[:, None]  # 60 of L2: L1 - L2 stays
    two = day._replace(phase1=day.phase1 + both, phase2=day.phase2 + both)
    lost = day._replace(phase1=np.where((np.arange(400) == 300)[:, None], np.nan, day.phase1))
    for slipped in (one, two, lost):
        arc = recorded.arcs(slipped)[150:, 4]
        assert len(set(arc[arc >= 0])) == 2
        assert arc[149] != arc[151]


def test_means_of_arcs_are_means():
    rng = np.random.default_rng(3)
    values, arc = rng.standard_normal((50, 4)), np.sort(rng.integers(0, 5, (50, 4)), axis=0)
    arc[3:9, 1] = -1
    found = recorded.arc_means(values, arc)
    for j in range(4):
        for number in range(5):
            here = arc[:, j] == number
            if here.any():
                np.testing.assert_allclose(found[here, j], values[here, j].mean())
    assert np.isnan(found[3:9, 1]).all()


def test_smoothing_is_a_mean_at_first_and_then_forgets():
    rng = np.random.default_rng(4)
    phase = 1e3 * rng.standard_normal((40, 1)).cumsum(axis=0)
    noise = rng.standard_normal((40, 1))
    arc = np.where(np.arange(40) < 25, 3, 8)[:, None]
    found = recorded.smoothed(phase + 5 + noise, phase, arc, most=10) - phase - 5
    for k in (0, 4, 9, 25, 30):  # until ten epochs of an arc are in it: their mean
        start = 0 if k < 25 else 25
        np.testing.assert_allclose(found[k], noise[start : k + 1].mean(axis=0), atol=1e-9)
    np.testing.assert_allclose(found[15], found[14] + (noise[15] - found[14]) / 10, atol=1e-9)
    code = np.where(np.arange(40) < 20, 1.0, 2.0)[:, None]
    np.testing.assert_array_equal(recorded.smoothed(code, phase, np.full((40, 1), -1), most=10), code)


def test_the_parts_of_an_error_add_up(cases):
    for case in cases.values():
        np.testing.assert_allclose(case.errors, case.noise + case.lasting, atol=1e-12)
        for errors in (case.errors, case.lasting, case.smooth):
            np.testing.assert_allclose(errors.mean(axis=0), 0, atol=1e-12)
        assert recorded.size(case.noise) > 0.1


def test_noise_is_noise_and_the_rest_lasts(cases):
    """Fifteen minutes on, nothing of the noise is left, and most of the rest."""
    for case in cases.values():
        for noise, lasting in zip(case.noise.T, case.lasting.T, strict=True):
            assert np.abs(recorded.autocorrelation(noise)[20:40]).mean() < 0.06  # 2,880 values: 0.02 each
            assert recorded.autocorrelation(lasting)[20] > 0.6


def test_autocorrelation_is_its_sums():
    x = np.random.default_rng(1).standard_normal(50).cumsum()
    e = x - x.mean()
    sums = [e[: 50 - lag] @ e[lag:] for lag in range(50)]
    np.testing.assert_allclose(recorded.autocorrelation(x), np.array(sums) / sums[0], atol=1e-12)


def test_line_errors_have_the_standard_error_of_the_closed_form():
    errors = np.random.default_rng(2).standard_normal(200_000)
    found = mpt.metrics.rms(recorded.line_errors(errors, 20), axis=1)
    # Overlapping windows count as some 200,000 / 20; their rms has a relative standard error of 0.7 %; four of it.
    np.testing.assert_allclose(found, line_sigma(20, np.array([10.5, 20])), rtol=0.03)


def test_a_line_is_compared_with_the_fixes_of_the_same_epochs():
    """In the spread of the whole day, noisy first hours included, the later lines looked better than the fixes."""
    errors = np.ones(1000)  # a line through equal errors is as wrong as each of them
    errors[:25] = 10
    for n in (50, 51):
        middle, newest = recorded.line_errors(errors, n)
        at_middle = errors[[(k + k + n - 1) // 2 for k in range(len(middle))]]
        expected = [mpt.metrics.rms(middle) / mpt.metrics.rms(at_middle), mpt.metrics.rms(newest)]
        np.testing.assert_allclose(recorded.line_ratios(errors, n), expected)
        in_space = recorded.newest_ratio(np.column_stack([errors, 0 * errors, errors]), n)
        assert in_space == pytest.approx(expected[1])


@pytest.mark.parametrize("name", CASES)
def test_the_closed_form_with_a_measured_autocorrelation_is_what_the_line_makes(cases, name):
    for errors in cases[name].errors.T:
        measured = mpt.metrics.rms(recorded.line_errors(errors, 50), axis=1) / errors.std()
        # Some 60 stretches of 25 minutes: 9 % for each of the two.
        closed = line_sigma(50, np.array([25.5, 50]), recorded.autocorrelation(errors))
        np.testing.assert_allclose(measured, closed, rtol=0.1)


def test_filters_with_and_without_an_error_state_are_judged_by_what_they_make():
    """On errors drawn from the model itself, the filter that knows it is right, and the other is not."""
    rng = np.random.default_rng(5)
    made = recorded.with_lasting(30.0, 0.04, 1.0, 3600.0)
    x, z = mpt.simulate(made.model, 100, rng, tracks=3000)
    aware = recorded.judged(made, z - x[:, :1])
    assert aware.nees == pytest.approx(1, abs=0.1)  # 3,000 tracks, whose squares are chi-square: 0.026; four of it
    assert aware.within == pytest.approx(0.954, abs=0.015)
    np.testing.assert_allclose(aware.error, aware.stated, rtol=0.06)
    ignorant = recorded.judged(recorded.white(30.0, 1.04), z - x[:, :1])
    assert ignorant.nees > 5
    assert ignorant.nis < 0.5


def test_constants_of_one_half_day_are_judged_on_the_other():
    """Quiet errors first, then three times as large: by the quiet constants the truth is seldom within 2σ."""
    rng = np.random.default_rng(10)
    quiet, loud = (recorded.with_lasting(30.0, 0.04 * s**2, s, 3600.0) for s in (1.0, 3.0))
    errors = []
    for made in (quiet, loud):
        x, z = mpt.simulate(made.model, 100, rng, tracks=100)
        errors.append((z - x[:, :1])[:, 0].T.ravel())
    case = recorded.Case("a", "one", 30.0, np.concatenate(errors)[:, None], None, None, None, np.zeros(1), "")
    halves = np.array([[[0.04, 1.0, 3600.0]], [[0.36, 3.0, 3600.0]]])
    filtered = {"a": SimpleNamespace(fit=SimpleNamespace(halves=halves))}
    found = article.other_half({"a": case}, filtered)
    by_quiet, by_loud = found["aware"]
    assert 40 < by_quiet < 60  # 2/3 of a sigma: 49.5 %
    assert by_loud > 99.5
    assert all(x >= y for x, y in zip(found["aware, with its floor"], found["aware"], strict=True))
    assert found["tuned"][0] < found["aware"][0]
    assert found["white"][0] < found["white"][1] < 90


def test_constants_are_exchanged_between_stations_and_not_between_kinds_of_range():
    """Errors drawn from two models of the size 1 and 3: by each other's constants the NEES is off by the square."""
    rng = np.random.default_rng(9)
    cases, filtered = {}, {}
    for station, sigma in {"a": 1.0, "b": 3.0}.items():
        for kind in ("one", "two"):
            made = recorded.with_lasting(30.0, 0.04 * sigma**2, sigma, 3600.0)
            x, z = mpt.simulate(made.model, 100, rng, tracks=300)  # joined, a day of 300 windows
            errors = (z - x[:, :1])[:, 0].T.ravel()[:, None]
            cases[f"{station}, {kind}"] = SimpleNamespace(kind=kind, errors=errors, step=30.0)
            constants = {"r": [0.04 * sigma**2], "sigma": [sigma], "tau": [3600.0], "floor": [sigma]}
            filters = {"white": [recorded.white(30.0, 1.04 * sigma**2)], "tuned": [recorded.tracker(30.0, 1e-5, 1.0)]}
            filters["aware"] = [made]
            filtered[f"{station}, {kind}"] = SimpleNamespace(fit=SimpleNamespace(**constants), filters=filters)
    found = article.exchanged(cases, filtered)
    assert max(found["aware"][:2]) > 99.5 > 60 > max(found["aware"][2:])  # by constants three times as large, and small
    assert max(found["white"][2:]) < min(found["aware"][2:])
    assert set(found) == {"NEES", "white", "tuned", "aware", "aware, with its floor"}
    np.testing.assert_allclose(found["NEES"], [1 / 9, 1 / 9, 9, 9], rtol=0.3)  # 300 windows: 8 %; four of it
    assert article.exchanged({"a, one": cases["a, one"]}, filtered) == {}


def test_the_ins_is_expected_over_its_noise():
    """Against many draws of the INS."""
    errors = np.random.default_rng(6).standard_normal(200).cumsum() / 5
    model = recorded.ins_model(30.0, 1.0, q=1e-4)
    found = recorded.with_ins(model, errors)
    gps, kf, rng = recorded.windows(errors)[:, 0], mpt.KalmanFilter(model), np.random.default_rng(7)
    square = []
    for _ in range(400):
        ins = 1.2 + 0.01 * rng.standard_normal((100, 2))
        x = kf.filter(np.stack([6.0 * np.arange(100)[:, None] + gps, ins], axis=1))
        wrong = x - np.stack([6.0 * np.arange(100)[:, None] + 0 * gps, 0.2 + 0 * gps, 1 + 0 * gps], axis=1)
        square.append(wrong**2)
    rms = np.sqrt(np.mean(square, axis=0)[50:].mean(axis=(0, 2)))
    np.testing.assert_allclose([found.position, found.velocity, found.bias], rms, rtol=0.05)
    nees = (np.mean(square, axis=0)[:, 0] / kf.covariances(100)[:, 0, 0, None])[recorded.SETTLED :].mean()
    assert found.nees == pytest.approx(nees, rel=0.05)
    assert found.fix == pytest.approx(mpt.metrics.rms(gps[50:]))


@pytest.fixture(scope="module")
def cells():
    return parts(cells_of(NOTEBOOK))


def printed(cells):
    return "\n".join(shown(cell) for cell in cells if cell["cell_type"] == "code")


def test_every_number_of_the_article_is_printed_by_its_cells(cells):
    """Those with decimals; whole percents stand in the tests below.

    2.55 and 1.55 are what two frequencies make of the ranges; 1.4 and 0.1 stand in the test of the rule for q; 1.9 and
    0.23 are of a mean whose old fixes fade; 0.3 stands in the test of the fits, 4.7 too, rounded; 0.05, 0.16, 0.78,
    0.82, 0.91, 0.989, 1.42, 1.56 and 98.9 in those of the formula, 6.0 in that of the plain filter; 1.3, 1.4, 2.0 and
    2.1 in that of the biases, 1.05 in that of the slip; 0.4, 1.2 and 3.3 in that of the mean of the day, 1.5 in that of
    the last line; 1.28, 2.43 and 2.53 in those of the walker.
    """
    faded = np.sqrt(0.1 / (2 - 0.1))  # each fix counts a tenth: the variance of such a mean is g / (2 - g)
    computed = f"{recorded.AMPLIFIED:.2f} {recorded.AMPLIFIED - 1:.2f} {faded:.2f}"
    computed += " 1.4 0.1 1.9 0.3 0.05 0.78 0.82 0.91 1.42 1.56 6.0 1.3 2.0 2.1 1.05 0.4 1.2 3.3 1.5 1.28 2.43 2.53 4.7"
    computed += " 0.989 98.9 0.16"
    said = f"{printed(cells[0])} {computed}"
    for cell in cells[0]:
        if cell["cell_type"] == "markdown":
            for number in re.findall(r"(?<![\d.])\d+\.\d+(?![\d.])", source(cell)):
                shorter = rf"(?<![\d.]){re.escape(number)}\d?(?!\d)"  # 1.3 of 1.34 too, where both are said
                assert re.search(shorter, said), number


def over_stated(cells):
    """What Part II prints of made over stated, in space, without the mean of the day and with it."""
    return "\n".join(re.findall(r"(?m)^(?:made over stated|the constant error added).*$", printed(cells[1])))


def numbers_of(cells, header, rows=6):
    """The numbers of the rows of six cases, or of fewer, below a header, (rows, numbers of a row)."""
    rows = printed(cells).split(header)[1].splitlines()[1 : rows + 1]
    return np.array([[float(each) for each in re.findall(r"[\d.]+", row.split("frequenc")[1])] for row in rows])


def test_the_first_screen_says_what_the_recordings_do(cases, cells):
    first, said = source(cells[0][0]), prose(cells[0])
    found = article.gains(cases)
    gained, more = found["smoothing, of one fix"], found["the mean, of the smoothed fix"]
    one, two = (article.spread(each, "{:.0f}") for each in by_smoothing(cases))
    assert f"With two frequencies it took {two} % off the error of a position" in first
    assert f"With two frequencies smoothing took {two} % off one fix. With one it was {one} %, and there" in said
    assert "With two frequencies it took a quarter to a half off the error here, and less with one" in said
    assert np.sort(np.concatenate(by_smoothing(cases)))[[0, -1]] == pytest.approx(gained)
    ((less, more_of_it),) = re.findall(r"error of aware, against white: -(\d+) to \+(\d+) %", printed(cells[1]))
    better = (
        f"The error of *aware* is at best {less} % smaller than that of *white*, and at worst {more_of_it} % larger"
    )
    assert better in said
    assert f"in every row the mean is better, by {more[0]:.0f} to {more[1]:.0f} %" in said


def test_the_question_of_the_first_line_is_answered(cases, cells):
    """On the height of NYA1 with two frequencies, which is carried through the article."""
    first, said = source(cells[0][0]), prose(cells[0])
    up = cases["NYA1, two frequencies"].errors[:, 2]
    one = np.std(up)
    made = mpt.metrics.rms(up[:2800].reshape(28, 100).mean(axis=1))
    stated = article.stated_at_rest(4.7, 1.1, 2700.0, 3000.0, 100)
    assert 2.4 < one < 2.6
    assert "Each one is wrong by two and a half metres or so" in first
    assert f"heights was {made:.2f} m off, and not the {one / 10:.2f} m of $\\sqrt n$" in first
    assert (f"{one / 10:.2f}", f"{made:.2f}", f"{stated:.2f}") == ("0.25", "0.94", "0.97")
    assert (
        "**Twenty-five centimetres? No: ninety-four.** The formula, from a log of the same day, said ninety-seven"
        in said
    )
    constant = 1.2  # in the test of the mean of the day
    assert f"$\\sqrt{{{stated:.2f}^2 + {constant}^2}}$ = {np.hypot(stated, constant):.1f} m" in said
    assert f'write "± {np.hypot(stated, constant):.1f} m" beside the height that fifty minutes gave' in said
    of_the_day = np.hypot(article.stated_at_rest(4.7, 1.1, 2700.0, 86_400.0, 2880), constant)
    assert f"Its mean is known to ± {of_the_day:.1f} m, nearly all of it what no fit sees" in said
    assert constant / of_the_day > 0.95


def test_the_formula_is_computed_by_hand(cells):
    said = prose(cells[0])
    assert f"$1 + 50/120$, or {1 + 50 / 120:.2f}" in said
    assert f"$1/\\sqrt{{1.42}}$ is the {1 / np.sqrt(1.42):.2f} in that line" in said
    assert f"best {1 / np.sqrt(1 + 50 / 120):.2f}" in printed(cells[0])
    count = 1 + 50 / 90
    wave, noise = 1.1**2 / count, 4.7 / 100
    assert f"$1 + 50/90$ = {count:.2f} different errors" in said
    assert f"1.1²/1.56 = {wave:.2f} m². The noise leaves 4.7/100 = {noise:.2f} m²." in said
    assert f"Together that is {wave + noise:.2f} m², and its root is {np.sqrt(wave + noise):.2f} m" in said
    assert f"of the {wave + noise:.2f} m² the noise is {noise:.2f}" in said
    a = np.exp(-30 / 2700)
    assert f"$a$ is {a:.3f}. So from fix to fix $e$ keeps {100 * a:.1f} % and gains some" in said
    assert f"some {1.1 * np.sqrt(1 - a**2):.2f} m that is new" in said
    assert "Keep the three numbers: 4.7 m², 1.1 m and 45 minutes" in said
    assert f"After a time τ, {100 * np.exp(-1):.0f} % of it is left on average" in said


def by_smoothing(cases):
    """What smoothing takes off one fix (%), of the cases of one frequency and of those of two."""
    took = {row[0]: 100 * (1 - float(row[3]) / float(row[1])) for row in article.remedies(cases)}
    return [[took[name] for name, case in cases.items() if case.kind == kind] for kind in recorded.KINDS]


def test_the_line_beats_the_smoothing_at_belem_and_loses_at_esbc(cases, cells):
    of = {row[0]: [float(text) for text in row[1:]] for row in article.remedies(cases)}
    _, line, smooth, _ = of["Belem, two frequencies"]
    assert line < smooth
    assert "At Belem, two frequencies, the line even beat it" in prose(cells[1])
    fix, line, *_ = of["ESBC, one frequency"]
    assert line > fix
    assert "at ESBC, one frequency, the line made things worse than one fix" in prose(cells[1])
    one = {name: row[0] for name, row in of.items()}
    assert of["NYA1, two frequencies"][2] < of["NYA1, two frequencies"][1] < 0.6 * one["NYA1, two frequencies"]
    assert "On your wall it gives in five minutes what the line gives in fifty" in prose(cells[0])


def test_the_newest_point_of_a_line_divides_by_half_the_root_of_n(cells):
    said = prose(cells[0])
    assert "So at its newest point the paper's $\\sqrt n$ is $\\sqrt n/2$, even for independent errors" in said
    assert "Then the paper's line pays while you go straight, half as much as it says" in said
    assert "If the newest point of a hundred fixes leaves about 0.20" in said
    assert 2 / np.sqrt(100) == pytest.approx(0.20)
    for n in (100, 400):
        assert 1 / line_sigma(n, n) == pytest.approx(np.sqrt(n) / 2, rel=0.01)


def test_the_mean_of_the_day_is_not_the_surveyed_position(cases, cells):
    """Filters are judged by errors about the first; Part II says how far it is from the second."""
    away = article.spread([np.linalg.norm(case.offset) for case in cases.values()], "{:.1f}")
    mean = f"the day's mean position (which itself is {away} m from the surveyed one)"
    assert f"how often {mean} was within 2σ" in prose(cells[1])
    assert "The truth, here the mean of the day, should lie within twice the standard deviation" in prose(cells[0])
    for case in cases.values():
        np.testing.assert_allclose(np.nanmean(case.errors, axis=0), 0, atol=1e-9)


def shares_within(cells):
    """How often the truth was within 2σ, {filter: three of (median, worst, best)}.

    The three are by constants of the same day, of its other half and of another station, as texts.
    """
    table = printed(cells[1]).split("within 2σ (%), constants of")[1]
    share = r" +(\d+) \((\d+) to (\d+)\)"
    rows = re.findall(rf"(?m)^([a-z]+){3 * share}$", table)
    return {name: (numbers[:3], numbers[3:6], numbers[6:]) for name, *numbers in rows}


def test_the_article_says_how_often_the_bounds_held(cells):
    first, said, shares = source(cells[0][0]), prose(cells[0]), shares_within(cells)
    assert set(shares) == {"white", "tuned", "aware"}
    white, tuned, aware = (shares[name][0][0] for name in ("white", "tuned", "aware"))
    assert (
        f"Fitted to the same day, what it states as 95 % typically held in {aware} % of the fixes; "
        f"what the usual filter states, in {white} %."
    ) in first
    assert (
        f"On the median axis it did so in {white} % for *white*, {tuned} % for *tuned* and {aware} % for *aware*"
        in said
    )
    assert int(shares["aware"][1][1]) < 60  # of the other half of the day: it stands in Part II's table
    assert "Constants from elsewhere are right on the median axis and not on the worst" in prose(cells[1])


def test_a_filter_states_by_two_to_seven_times_too_little_and_passes_its_test(cells):
    """Each station's own constants, in space: of *tuned*, whose surprises are as large as it expects."""
    said = prose(cells[0])
    assert "can be wrong by several times what it states" in said
    assert "At rest ours were two to seven times too sure without it" in said
    assert "*White* and *tuned* make 2 to 7 times what they state" in said
    pattern = r"white ([\d.]+) to ([\d.]+), tuned ([\d.]+) to ([\d.]+), aware ([\d.]+ to [\d.]+)"
    (alone,) = re.findall(f"made over stated in space: {pattern}", over_stated(cells))
    lows, highs = (list(map(float, each)) for each in (alone[0:4:2], alone[1:4:2]))
    assert min(lows) > 2
    assert f"{max(highs):.0f}" == "7"
    ((*_, aware),) = re.findall(f"the constant error added: {pattern}", over_stated(cells))
    most = aware.split()[-1]
    assert f"with it, *aware* made up to {most} times what it states." in said


def test_noise_that_lasts_makes_a_walker_s_filter_no_better_than_one_fix(cells):
    """New at each fix, it makes what the filter states; remembered ten seconds, as many walks are off as computed."""
    stated = float(re.findall(r"a fix each 1 s: .*filter ± ([\d.]+)", printed(cells[0]))[0])
    assert article.walker(remembered=1e-3).made == pytest.approx(stated, abs=0.005)
    model = lasting_error(
        mpt.constant_velocity(dt=1.0, q=0.1, r=4.7, P0=np.diag([100.0, 1.4**2])), sigma=1.1, tau=2700.0
    )
    kf, rng, keeps, M = mpt.KalmanFilter(model), np.random.default_rng(5), np.exp(-1 / 10), 4000
    truth = rng.multivariate_normal(np.zeros(3), model.P0, M).T
    noise, z = np.sqrt(4.7) * rng.standard_normal(M), []
    for _ in range(200):
        truth = model.F @ truth + rng.multivariate_normal(np.zeros(3), model.Q, M).T
        noise = keeps * noise + np.sqrt(4.7 * (1 - keeps**2)) * rng.standard_normal(M)
        z.append((model.H @ truth)[0] + noise)
    off = (kf.filter(np.array(z)[:, None])[-1] - truth)[0]
    # The standard error of an rms over M walks is 1 / sqrt(2 M) of it: 1.1 %.
    assert np.sqrt(np.mean(off**2)) == pytest.approx(article.walker(10.0, N=200).made, rel=0.04)
    assert article.walker(10.0).made > np.sqrt(4.7 + 1.1**2) == pytest.approx(article.walker(10.0).fix)
    said = f"where the noise lasts ten, the same filter is no better than one fix, and still states {stated} m."
    assert said in prose(cells[0])


SMOOTHED_LINE = r"smoothed over 100 s: one fix ± ([\d.]+) m, filter states ± ([\d.]+) m and makes ([\d.]+) m"


def at_rest_and_smoothed(rng, days, smoothed=100, remembered=10.0):
    """Logs of one fix a second: an error of 1.1 m that lasts 45 minutes, and noise that was smoothed, (days, 86400)."""
    keeps, fades, shape = np.exp(-1 / remembered), np.exp(-1 / 2700), (days, 86400)
    noise = lfilter([1], [1, -keeps], np.sqrt(4.7 * (1 - keeps**2)) * rng.standard_normal((days, 87400)))
    noise = lfilter([1 / smoothed], [1, 1 / smoothed - 1], noise)[:, 1000:]
    new = 1.1 * np.sqrt(1 - fades**2) * rng.standard_normal(shape)
    new[:, 0] = 1.1 * rng.standard_normal(days)
    return lfilter([1], [1, -fades], new) + noise


def fitted_to(logs, every=1):
    """The fit of `fit_lasting` to logs of one fix a second, or to each so many of them."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return fit_lasting(*((np.arange(86400.0)[::every], log[::every]) for log in logs))


def test_a_fit_to_smoothed_fixes_takes_what_is_left_of_the_noise_for_lasting(cells):
    """And what a walker's filter states by it is what it makes, which is what one smoothed fix is off."""
    logs = at_rest_and_smoothed(np.random.default_rng(3), days=4)
    found = fitted_to(logs)
    ((fix, stated, made),) = re.findall(SMOOTHED_LINE, printed(cells[1]))
    assert found.r[0] < 0.1
    assert 400 < found.tau[0] < 800  # s, where the lasting error has 2,700 and what is left of the noise 100
    # Some 130 memories of 45 minutes, two thirds of the variance: 9 % of sigma.
    assert found.sigma[0] == pytest.approx(float(fix), rel=0.15)
    assert np.std(logs) == pytest.approx(float(fix), rel=0.15)
    by_fit = article.walker(10.0, smoothed=100.0, believed=(found.r[0], found.sigma[0], found.tau[0]))
    assert by_fit.stated == pytest.approx(found.sigma[0], rel=0.03)
    assert by_fit.made == pytest.approx(float(fix), rel=0.03)
    assert fix == stated == made
    said = prose(cells[0])
    assert f"takes the fix itself from 2.43 m to {fix} m" in said
    assert "and for that it needs the $r$, σ and τ of smoothed fixes (Part II has them)" in said
    assert f"fitted = 1e-4, {fix}, 600.0" in "".join(map(source, cells[1]))


def test_the_mean_at_rest_needs_the_fit_of_fixes_that_are_not_smoothed(cells):
    """By the walker's constants it states too little: of a fix a second for fifty minutes, whose mean is computed."""
    states = article.stated_at_rest(1e-4, 1.28, 600.0, 3000, 100)
    age = np.arange(3000)
    both = 1.1**2 * np.exp(-age / 2700) + 4.7 * np.exp(-age / 10)
    made = np.sqrt((2 * (3000 - age) @ both - 3000 * both[0]) / 3000**2)
    assert f"the formula would state {states:.2f} m for a mean that is {made:.2f} m off" in prose(cells[1])
    assert "An average needs the true τ. A moving filter needs above all the right σ." in prose(cells[0])


def test_a_fix_each_thirty_seconds_is_enough_for_the_fit(cells):
    """Of one each second, whose reflections last ten: what those of each 30 s say of the lasting error is the truth."""
    assert "One each 30 s is enough" in prose(cells[0])
    logs = at_rest_and_smoothed(np.random.default_rng(7), days=6, smoothed=1)
    found, more = fitted_to(logs, every=30), fitted_to(logs, every=10)
    assert found.r[0] == pytest.approx(4.7, rel=0.05)  # 17,280 fixes; reflections leave e^-3 of it at the next
    # 190 memories: 10 % of sigma and 20 % of tau would be two of their errors.
    assert found.sigma[0] == pytest.approx(1.1, rel=0.2)
    assert found.tau[0] == pytest.approx(2700, rel=0.5)
    assert more.sigma[0] == pytest.approx(found.sigma[0], rel=0.1)


def test_one_day_knows_sigma_to_about_a_third(cells, filtered):
    assert "One day knows σ of the median axis to a factor of two only" in prose(cells[0])
    above = [each.fit.known["sigma"][:, 1] / each.fit.sigma for each in filtered.values()]
    assert np.median(above) == pytest.approx(2, abs=0.05)
    span = re.findall(r"sigma ([\d.]+) m, at 95 % between ([\d.]+) and ([\d.]+)", printed(cells[0]))
    ((sigma, low, high),) = [list(map(float, each)) for each in span]
    assert 0.2 < 1 - low / sigma < 0.4
    assert 0.2 < high / sigma - 1 < 0.4


def test_the_formula_of_the_mean_elsewhere_and_over_four_hours(cases, filtered, cells):
    """What the means made over what the formula states: with the constants of other stations, and over longer spans."""

    def made_over_stated(case, fit, n):
        windows = case.errors[: len(case.errors) // n * n].reshape(-1, n, 3)
        means = windows.mean(axis=1)
        made = np.sqrt(np.nanmean(means**2, axis=0))
        return made / article.stated_at_rest(fit.r, fit.sigma, fit.tau, n * case.step, n)

    others = [
        made_over_stated(case, filtered[source].fit, 100)
        for name, case in cases.items()
        for source in filtered
        if source != name and cases[source].kind == case.kind
    ]
    assert "Fitted to another station, the formula of the mean was up to three times too sure." in prose(cells[0])
    assert np.max(others) == pytest.approx(3, abs=0.2)
    long = np.array([made_over_stated(case, filtered[name].fit, 480) for name, case in cases.items()])
    most, second = np.sort(long.ravel())[[-1, -2]]
    tau = np.array([filtered[name].fit.tau for name in cases]).ravel()[long.argmax()]
    said = f"Over four hours the means of one axis of {long.size} were twice as far off as the formula says; its τ of"
    assert f"{said} {tau / 60:.0f} minutes was too short" in prose(cells[0])
    assert most == pytest.approx(2, abs=0.1)
    assert second < 1.25


def test_at_rest_the_variance_of_white_with_that_of_what_lasts_is_honest(cases, filtered, cells):
    """The shortcut, by the estimates of the plain filter and sigma² of the fit: shares within twice what it states."""
    assert (
        "(At rest there is a shortcut: add σ² to the variance that *white* states. That does nearly as well.)"
        in prose(cells[0])
    )
    shares = {"shortcut": [], "aware": []}
    for name, case in cases.items():
        each = filtered[name]
        shares["aware"].extend(axis.within for axis in each.aware)
        for filter, axis, sigma in zip(each.filters["white"], case.errors.T, each.fit.sigma, strict=True):
            found = filter.estimates(recorded.windows(axis))
            position = found.x[recorded.SETTLED :, 0]
            variance = found.P[recorded.SETTLED :, 0, 0].reshape(len(position), -1) + sigma**2
            shares["shortcut"].append(np.mean(position**2 < 4 * variance))
    assert np.median(shares["shortcut"]) == pytest.approx(np.median(shares["aware"]), abs=0.02)
    assert min(shares["shortcut"]) > 0.85


def test_the_recipe_at_rest_is_judged_on_all_axes(cells):
    """The numbers of the cell, and on errors of a known kind."""
    low, high, own, other, worst = re.findall(
        r"all axes, stated over made: ([\d.]+) to ([\d.]+), median .*\n"
        r"within 2σ .* constants (\d+) .* station's (\d+) \((\d+) to",
        printed(cells[1]),
    )[0]
    said = "On all 18 axes of our recordings the formula, fitted to the same day, was right within a quarter"
    assert said in prose(cells[0])
    assert 0.75 < float(low) < float(high) < 1.25
    assert min(int(own), int(other)) > 94
    assert f"the worst axis was within 2σ of the day's mean {worst} % of the time" in prose(cells[1])
    rng, sizes = np.random.default_rng(14), {"a": 1.0, "b": 3.0}
    made = {name: recorded.with_lasting(30.0, 4.0 * size**2, size, 2700.0) for name, size in sizes.items()}
    drawn = {name: mpt.simulate(each.model, 100, rng, tracks=400) for name, each in made.items()}
    cases = {
        name: SimpleNamespace(kind="one", step=30.0, errors=(z - x[:, :1])[:, 0].T.ravel()[:, None])
        for name, (x, z) in drawn.items()
    }
    constants = {
        name: SimpleNamespace(r=np.array([4.0 * s**2]), sigma=np.array([s]), tau=np.array([2700.0]))
        for name, s in sizes.items()
    }
    found = article.at_rest(cases, {name: SimpleNamespace(fit=each) for name, each in constants.items()})
    np.testing.assert_allclose(found.stated_over_made, 1.0, atol=0.16)  # 400 windows: 3.5 %; 1.07 of the best
    assert found.stated_over_made.min() > 0.95
    assert min(found.own) > 93
    assert found.others[0] > 99.9 > 60 > found.others[1]


def test_the_mean_of_one_that_stands_is_known_better_than_by_the_filter(cells):
    assert "So at rest the mean is better, with its 0.97 m" in prose(cells[0])
    R = 1.1**2 * np.exp(-np.abs(np.subtract.outer(np.arange(100), np.arange(100))) * 30 / 2700)
    assert f"{np.sqrt(R.mean() + 4.7 / 100):.2f}" == "0.95"
    assert "position -0.10 ± 1.22 m" in printed(cells[0])


def test_the_mean_of_the_day_is_that_of_the_header(cases, cells):
    """On the axes the article says, and only Belem's of one frequency is larger than what a header may be off."""
    said = prose(cells[0])
    sizes = {name: np.abs(case.offset) for name, case in cases.items()}
    heights = [sizes[f"Belem, {kind}"][2] for kind in reversed(recorded.KINDS)]
    largest = max(np.max(size[:2]) for size in sizes.values())
    add = "add {:.1f} m on each axis, and {:.1f} m in height with one frequency near the equator"
    assert add.format(*heights) in said
    most = "The largest on any axis was {:.1f} m, and {:.1f} m in the height of one frequency at the equator"
    assert most.format(*heights) in said
    assert f"In the height of your wall it was {sizes['NYA1, two frequencies'][2]:.1f} m off" in said
    assert largest < heights[0]
    assert max(size[2] for name, size in sizes.items() if not name.startswith("Belem")) < heights[0]
    means = {name: np.linalg.norm(size) for name, size in sizes.items()}
    assert [name for name, mean in means.items() if mean > 1.3] == ["Belem, one frequency"]
    assert f"only Belem's {means['Belem, one frequency']:.1f} m, of one frequency, is clearly" in prose(cells[1])


def test_filters_that_were_fitted_with_the_biases_left_in_passed_their_test(days, cells):
    (least, most) = re.findall(r"biases left in: NIS of tuned and aware ([\d.]+) to ([\d.]+)", printed(cells[1]))[0]
    assert "was clean: as large as the filters said, within a few percent" in prose(cells[0])
    assert 0.95 < np.sqrt(float(least)) < np.sqrt(float(most)) < 1.05  # a few percent of their size
    assert "They pass the test of their innovations on all axes" in prose(cells[1])
    raw = {"ESBC": recorded.case("ESBC", recorded.without_biases(days["ESBC"]), recorded.KINDS[1])}
    raw = article.filtered(raw)["ESBC"]
    assert all(0.9 < float(least) - 0.005 < axis.nis < float(most) + 0.005 < 1.1 for axis in (*raw.tuned, *raw.aware))


def test_a_change_is_that_of_the_error_in_space():
    def of(*last):
        return [SimpleNamespace(error=[9.0, each]) for each in last]

    found = article.changed({"a": SimpleNamespace(aware=of(2, 3, 6), white=of(0, 6, 8))}, "aware", "white")
    np.testing.assert_allclose(found, [-30.0])


def test_what_is_left_without_noise_jumps_where_satellites_come_and_go(days, cases, cells):
    assert "It jumps where a satellite comes or goes" in prose(cells[0])
    for name, day in days.items():
        arc = recorded.arcs(day)
        changes = (arc[1:] != arc[:-1]).any(axis=1)
        jumps = np.abs(np.diff(cases[f"{name}, {recorded.KINDS[1]}"].lasting[:, 2])) > 0.5
        assert jumps.sum() > 20
        assert changes[jumps].mean() > 0.75 > 0.2 > changes.mean()


def test_where_two_frequencies_lose_their_lasting_error_is_larger(cases, cells):
    assert "On Svalbard they lose, since there was little to correct" in prose(cells[0])
    one, two = (recorded.size(cases[f"NYA1, {kind}"].lasting) for kind in recorded.KINDS)
    assert two > one


def test_the_mean_of_a_day_keeps_a_part_of_an_hour_s_memory(cells):
    assert "keeps $1/\\sqrt{1 + 12}$, or 0.28, of one that is remembered for an hour" in prose(cells[1])
    assert pytest.approx(0.28, abs=0.005) == (1 + 24 / 2) ** -0.5


def test_the_rule_for_q_is_what_it_says(cells):
    said = prose(cells[0])
    assert "1.4²/20, about 0.1 m²/s³" in said
    assert pytest.approx(0.1, abs=0.005) == 1.4**2 / 20
    wander = np.random.default_rng(3).standard_normal((20_000, 20)).cumsum(axis=1) * np.sqrt(0.1)  # 1 s each
    assert wander[:, -1].std() == pytest.approx(1.4, rel=0.03)


def test_the_best_average_is_the_sum_of_an_inverse():
    R = np.exp(-np.abs(np.subtract.outer(np.arange(100), np.arange(100))) * 30 / 3600)
    assert np.linalg.inv(R).sum() == pytest.approx(1 + 99 * np.tanh(30 / 7200))


def test_the_prose_says_what_the_fits_say(cases, cells):
    said = prose(cells[0])
    by_phase, fitted, _, tau, _ = np.split(numbers_of(cells[1], "σ by the phase (m)"), 5, axis=1)
    low, high = (float(f"{each(fitted[:, :2]):.1f}") for each in (np.min, np.max))
    of_height = f"{fitted[:, 2].min():.0f} to {fitted[:, 2].max():.0f} m in height"
    assert f"σ was {low:g} to {high:g} m horizontally and {of_height}" in said
    others = np.delete(tau.ravel(), tau.argmin())
    assert f"it was {article.spread(others, '{:.0f}')} minutes, on all axes but one" in said
    apart = np.abs(fitted / by_phase - 1)
    assert f"agrees with the fitted σ on all {apart.size} axes within {100 * apart.max():.0f} %" in prose(cells[1])
    phase = float(re.findall(r"height of your wall: .* its lasting error ([\d.]+) m", printed(cells[0]))[0])
    assert f"The carrier phase, which the fit never saw, had {phase} m for σ" in said
    assert f"{np.nanstd(cases['NYA1, two frequencies'].lasting[:, 2]):.2f}" == f"{phase}"
    day = re.findall(r"(?m)^(?:r|sigma|tau) ([\d.]+)", printed(cells[0]))  # the filter's cell has them rounded
    assert f"r={float(day[0]):.2g}, sigma={float(day[1]):.2g}, tau={60 * float(day[2]):.1f})" in "".join(
        source(cell) for cell in cells[0]
    )


def test_the_newest_point_tells_the_cases_apart(cases, cells):
    """And is true of errors that fade: the newest point leaves 0.9 or more up to a span of six memories."""
    fade = {span: line_sigma(100, 100, np.exp(-np.arange(100) / 100 * span)) for span in (0.1, 1, 2, 4, 6, 8, 20)}
    assert min(left for span, left in fade.items() if span <= 6) > 0.9
    assert all(0.5 < left < 0.87 for span, left in fade.items() if span > 6)
    left = {row[0]: float(row[2]) for row in article.memories(cases)}
    took = {row[0]: 100 * (1 - float(row[3]) / float(row[1])) for row in article.remedies(cases)}
    second, third = ([took[name] for name in took if (left[name] >= 0.9) is lasts] for lasts in (True, False))
    said = prose(cells[1])
    assert "of a line leaves 0.9 or more of a fix, smoothing gained 4 and 5 %" in said
    assert sorted(f"{each:.0f}" for each in second) == ["4", "5"]
    assert (len(third), article.spread(third, "{:.0f}")) == (4, "17 to 50")


def test_the_mean_leaves_seven_percent_more_than_the_best_average(cells):
    """Of errors that fade as e^(-x) over a span x, in units of tau: the closed forms of both."""
    assert "it leaves at most 7 % more" in prose(cells[0])
    assert "it is at most 7 % larger" in prose(cells[1])
    x = np.linspace(0.01, 50, 5000)
    ratio = np.sqrt(2 * (x - 1 + np.exp(-x)) / x**2 * (1 + x / 2))
    assert 1.06 < ratio.max() < 1.07
    R = np.exp(-np.abs(np.subtract.outer(np.arange(300), np.arange(300))) * 3 / 300)  # a span of three tau
    assert np.sqrt(R.mean() * np.linalg.inv(R).sum()) == pytest.approx(ratio[np.abs(x - 3).argmin()], abs=2e-3)


def function_of(cells, *needed):
    """The last of some functions that Part I defines; it may call those before it."""
    names = {"np": np}
    for name in needed:
        (text,) = [source(cell) for cell in cells[0] if f"def {name}(" in source(cell)]
        exec(text[text.index(f"def {name}(") :].split("\n\n\n")[0], names)
    return names[needed[-1]]


def test_the_filter_of_the_article_is_the_package_s(cells):
    """On a track that moves, whose first fixes are missing."""
    model = lasting_error(mpt.constant_velocity(30.0, 1e-3, 4.0, P0=np.diag([100.0, 400.0])), 1.5, 1800.0)
    _, z = mpt.simulate(model, 60, np.random.default_rng(11))
    z[[0, 1, 30]] = np.nan
    z = z[:, 0]
    made = list(function_of(cells, "kalman", "error_state")(z, 30.0, 4.0, 1.5, 1800.0, q=1e-3, speed=20.0))
    theirs = mpt.KalmanFilter(model).estimates((z - z[2])[:, None])
    np.testing.assert_allclose([x - [z[2], 0, 0] for x, _ in made], theirs.x, atol=1e-8)
    np.testing.assert_allclose([P for _, P in made], theirs.P, atol=1e-8)


def test_the_plain_filter_of_the_article_is_the_package_s_and_the_line(cases, cells):
    """It states what the newest point of a line has, of independent errors: P0 counts little after 100 fixes."""
    up = cases["NYA1, two frequencies"].errors[:100, 2]
    axis = mpt.constant_velocity(30.0, 0.0, 6.0, P0=np.diag([100.0, 1.0]))
    zero = np.zeros((2, 2))
    made = function_of(cells, "kalman")(up, axis.F, axis.H, zero, 6.0, np.array([up[0], 0]), axis.P0)
    theirs = mpt.KalmanFilter(axis).estimates((up - up[0])[:, None])
    both = list(made)
    np.testing.assert_allclose([x - [up[0], 0] for x, _ in both], theirs.x, atol=1e-9)
    np.testing.assert_allclose([P for _, P in both], theirs.P, atol=1e-9)
    stated = np.sqrt(both[-1][1][0, 0])
    assert stated == pytest.approx(np.sqrt(6.0) * line_sigma(100, 100), rel=0.01)
    said = prose(cells[0])
    assert f"wrong by {np.std(up_of_day(cases)):.2f} m, so $r$ is {np.var(up_of_day(cases)):.1f} m²" in said
    assert f"It states {stated:.2f} m, which is {stated / np.std(up_of_day(cases)):.2f} of 2.46 m" in said
    (newest,) = re.findall(
        r"NYA1, two frequencies +left by the mean [\d.]+, by the newest point ([\d.]+)", printed(cells[0])
    )
    assert "`memory` said that on your wall that point really leaves about half of a fix" in said
    assert float(newest) == pytest.approx(0.5, abs=0.05)
    assert recorded.newest_ratio(up_of_day(cases)[:, None], 100) == pytest.approx(float(newest), abs=0.02)


def up_of_day(cases):
    """The errors of the height that the article carries through, of a whole day."""
    return cases["NYA1, two frequencies"].errors[:, 2]


@pytest.fixture
def hatch(cells):
    return function_of(cells, "hatch")


def ranges_with_a_slip(slip, noise):
    rng = np.random.default_rng(1)
    true = 2.1e7 + 400.0 * np.arange(600)
    return true, true + noise * rng.standard_normal(600), true + 12.3 + np.where(np.arange(600) >= 350, slip, 0.0)


@pytest.mark.parametrize("slip", [8.0, 1.5, -1.5])
@pytest.mark.parametrize("missing", ["", "code", "phase"])
def test_the_smoothing_of_the_article_begins_anew_after_a_slip_and_after_what_is_missing(hatch, missing, slip):
    """The slip is inside the gap: a filter that goes on through it is wrong by as much. A small one needs the gap."""
    true, code, phase = ranges_with_a_slip(slip if missing else 8.0, 0.5)
    gone = slice(345, 355) if missing else slice(0)
    {"": code, "code": code, "phase": phase}[missing][gone] = np.nan
    smooth = hatch(code, phase)
    np.testing.assert_array_equal(np.isnan(smooth), np.isnan(code + phase))
    wrong = smooth - true
    assert np.nanmax(np.abs(wrong)) < 2.0  # at a start it is one code, of 0.5 m: four of it
    assert np.sqrt(np.nanmean(wrong[10:] ** 2)) < 0.13
    first = 355 if missing else 350
    for k in (first, first + 4, first + 9):  # a mean from there on
        assert smooth[k] - phase[k] == pytest.approx(np.mean((code - phase)[first : k + 1]))


def test_a_small_slip_goes_unnoticed_and_fades(hatch, cells):
    """All but a twentieth of it, in three times what is averaged over."""
    assert "A slip that is missed fades in about three times `most`" in prose(cells[1])
    for slip in (1.5, 2.9):
        for most in (10, 70):
            true, code, phase = ranges_with_a_slip(slip, 0.0)
            wrong = (hatch(code, phase, dt=1.0, most=most) - true) / slip
            kept = 1 - 1 / most
            last = 3 * most
            np.testing.assert_allclose(wrong[[349, 350, 349 + last]], [0, kept, kept**last], atol=1e-6)
            assert wrong[349 + last] < 0.05
    true, code, phase = ranges_with_a_slip(3.1, 0.0)
    np.testing.assert_allclose(hatch(code, phase), true, atol=1e-6)


def test_a_slip_is_told_from_noise_at_six_times_the_noise(hatch, cells):
    said = prose(cells[0])
    assert "**Set `slip` to six times the noise**, which is 1.05 times the median" in said
    # At a start the gap is one code: the next differs from it by the root of two of the noise.
    assert "four times would begin anew once in 200 times" in prose(cells[1])
    assert 1 / (1 - erf(4 / 2)) == pytest.approx(200, rel=0.1)
    assert 1 / (1 - erf(6 / 2)) > 20_000
    assert "1.05 times the median of |change of code minus phase| between fixes 30 s apart" in said
    assert "A smaller slip goes unseen" in said
    true, code, phase = ranges_with_a_slip(20.0, 1.5)
    left = {slip: mpt.metrics.rms((hatch(code, phase, slip=slip) - true)[10:]) / 1.5 for slip in (3.0, 6.0, 9.0)}
    assert left[3.0] > 0.6
    for slip in (6.0, 9.0):
        assert left[slip] == pytest.approx(np.sqrt(0.1 / 1.9), abs=0.05)
    assert noise_by_the_recipe(code - phase, 1) == pytest.approx(1.5, rel=0.1)


def noise_by_the_recipe(gap, apart):
    return 1.05 * np.median(np.abs(gap[apart:] - gap[:-apart]))


def test_the_recipe_for_slip_holds_at_one_second_and_with_a_slip_in_the_log(hatch, cells):
    """Reflections of ten seconds, and a phase that begins anew far away: of neighbours it comes out at a third."""
    assert "because neighbours of one second share their reflections" in prose(cells[1])
    N, keeps, rng = 20_000, np.exp(-1 / 10), np.random.default_rng(6)
    noise = lfilter([1], [1, -keeps], 1.5 * np.sqrt(1 - keeps**2) * rng.standard_normal(N))
    true = 2.1e7 + 400.0 * np.arange(N)
    code, phase = true + noise, true + np.where(np.arange(N) >= 9000, 1e6, 0.0)
    found, neighbours = (noise_by_the_recipe(code - phase, apart) for apart in (30, 1))
    assert found == pytest.approx(1.5, rel=0.07)
    assert neighbours < 0.5
    for times in (4, 6):
        slips = times * found, times * neighbours
        right, wrong = (hatch(code, phase, dt=1.0, most=100.0, slip=slip) - true for slip in slips)
        assert mpt.metrics.rms(right[200:]) < 0.6
        assert mpt.metrics.rms(wrong[200:]) > 1.2


def test_the_example_of_the_gain_is_what_it_says(cells):
    said = prose(cells[0])
    assert "the variance 100 + 6 m². The position is to blame for 100 of these 106" in said
    P, H = np.diag([10.0**2, 1.0]), np.array([[1.0, 0.0]])
    K = P @ H.T / (H @ P @ H.T + 6.0)
    assert f"it moves by {100 * K[0, 0]:.0f} % of the surprise" in said
    assert K[1, 0] == 0


def test_a_walker_gains_nothing_at_thirty_seconds(cells):
    assert "With fixes 30 s apart the walker gains nothing" in prose(cells[0])
    found = re.findall(r"a fix each (\d+) s: one fix ± ([\d.]+) m, filter ± ([\d.]+) m", printed(cells[0]))
    gained = {int(dt): 1 - float(after) / float(before) for dt, before, after in found}
    assert gained[30] < 0.01
    assert gained[1] > 0.2


def test_smoothing_and_error_state_together_are_judged(cells):
    """On errors that smoothing has left no noise in, and by constants of a station that is three times as bad."""
    rng, cases = np.random.default_rng(13), {}
    for name, sigma in {"a": 1.0, "b": 3.0}.items():
        made = recorded.with_lasting(30.0, 0.01 * sigma**2, sigma, 1800.0)
        x, z = mpt.simulate(made.model, 2000, rng)
        smooth = z - x[:, :1]
        cases[name] = recorded.Case(name, "one", 30.0, smooth, None, None, smooth, np.zeros(1), "")
    chain = article.smoothed_and_aware(cases)
    own, (by_worse, by_better) = chain.within()
    assert all(each == pytest.approx(95.4, abs=4) for each in own)  # some 20 independent windows and 33 memories
    assert by_worse > 99.5 > 60 > by_better
    judged = {name: SimpleNamespace(aware=chain.judged[name, name]) for name in cases}
    np.testing.assert_allclose(chain.gains(judged), 0, atol=1e-9)
    (gained,) = re.findall(r"error after smoothing, against aware alone: (.*) % less", printed(cells[1]))
    assert f"say what smoothing before it adds: {gained} % less" in prose(cells[1])


def test_the_tracker_s_own_innovations_are_those_of_the_kalman_filter():
    errors = np.random.default_rng(12).standard_normal(300).cumsum()
    errors[[0, 40, 41]] = np.nan
    own = recorded.tracker(30.0, 1e-4, 2.0)
    values, S = own.innovations_of(errors[:, None, None])
    theirs = mpt.metrics.innovations(mpt.KalmanFilter(own.model), errors[:, None])
    np.testing.assert_allclose(values[..., 0], theirs.values, atol=1e-9)
    np.testing.assert_allclose(S[..., 0], np.broadcast_to(theirs.S, (300, 1, 1)), rtol=1e-9)
    many = np.repeat(errors[:, None, None], 3, axis=2)
    np.testing.assert_allclose(own.innovations_of(many)[0], np.repeat(values, 3, axis=2), atol=1e-9)


def test_the_first_screen_says_what_the_biases_did(days, cases, cells):
    kind = recorded.KINDS[1]
    of_two = [recorded.size(case.lasting) for case in cases.values() if case.kind == kind]
    left_in = [recorded.case(name, recorded.without_biases(day), kind).lasting for name, day in days.items()]
    before, after = (
        article.spread([recorded.size(each) for each in left_in], "{:.1f}"),
        article.spread(of_two, "{:.1f}"),
    )
    said = prose(cells[0])
    assert (
        f"the lasting error of two frequencies was {before} m with the biases left in. Corrected, it was {after} m"
        in said
    )
    larger = np.divide([recorded.size(each) for each in left_in], of_two)
    assert "which made the slow part of the error of two frequencies half as large again" in source(cells[0][0])
    assert "correcting them took a third off our lasting error" in said
    assert 1.45 < larger.min() < larger.max() < 1.55
    wrong = np.sqrt(np.square([recorded.size(each) for each in left_in]) - np.square(of_two))
    assert "Yet about a metre and a half in each position was wrong" in said
    assert 1.4 < wrong.min() < wrong.max() < 1.65
    raw, corrected = left_in[list(days).index("NYA1")], cases[f"NYA1, {kind}"].lasting
    assert "The largest swings were our own fault" in said
    assert np.nanmax(np.abs(raw[:, 2])) > 6 > 5 > np.nanmax(np.abs(corrected[:, 2]))


def test_a_filter_that_is_tuned_to_its_innovations_passes_its_own_test_and_is_wrong(cells):
    evidence = printed(cells[1])
    (row,) = re.findall(r"(?m)^tuned +([\d.]+) to [\d.]+ +[\d.]+ to [\d.]+ +([\d.]+) to ([\d.]+)$", evidence)
    assert all(abs(float(each) - 1) < 0.1 for each in row[1:])
    assert float(row[0]) > 1.5
    assert all(float(median) < 80 for median, *_ in shares_within(cells)["tuned"])
    assert "And *tuned* had passed its test." in prose(cells[0])
    (least,) = re.findall(r"log-likelihood of a day, aware less tuned: ([\d.-]+) to", evidence)
    assert float(least) > 10  # the likelihood, which needs no truth either, tells the two apart on every axis


def test_an_inertial_sensor_changes_nothing_at_a_constant_velocity(cells):
    found = re.findall(r"with an inertial sensor ([\d.]+ to [\d.]+), without ([\d.]+ to [\d.]+)", printed(cells[1]))
    assert len(found) == 1
    assert found[0][0] == found[0][1]
    said = f"With the sensor or without it the error was the same, {found[0][0]} of a single fix's"
    assert said in prose(cells[1])
    assert "An inertial sensor does not help at a constant velocity" in prose(cells[0])


def test_a_constant_is_added_in_squares():
    axes = [SimpleNamespace(error=[9.0, error], stated=[9.0, 1.0]) for error in (2.0, 4.0, 4.0)]  # 6 m in space
    filtered, cases = {"a": SimpleNamespace(white=axes)}, {"a": SimpleNamespace(offset=np.array([0.0, 8.0, 0.0]))}
    assert article.over_stated(cases, filtered, "white") == pytest.approx([6 / 3**0.5])
    assert article.over_stated(cases, filtered, "white", constant=True) == pytest.approx([10 / 3**0.5])


def test_noise_falls_nearly_as_theory_says_and_what_lasts_does_not(cases, cells):
    assert "The noise falls most of the way to theory (dotted). The lasting error does not fall at all" in prose(
        cells[0]
    )
    left = [recorded.newest_ratio(case.noise, 100) for case in cases.values()]
    assert 0.2 < min(left) < max(left) < 0.32
    assert line_sigma(100, 100) == pytest.approx(0.2, abs=0.005)
    assert min(recorded.newest_ratio(case.lasting, 100) for case in cases.values()) > 0.995


def test_two_frequencies_pay_at_the_equator_and_not_at_nya1(cases):
    """In 95 % of the day, smoothed, as the article says it; at all three the noise is about three times as large."""
    rows = {row[0]: [float(text) for text in row[1:]] for row in article.how_far(cases)}
    one, two = recorded.KINDS
    gained = {name: np.divide(rows[f"{name}, {two}"], rows[f"{name}, {one}"])[2:4] for name in recorded.TABLES}
    assert max(gained["Belem"]) < 0.55
    assert 0.8 < min(gained["ESBC"]) < max(gained["ESBC"]) < 0.95
    assert min(gained["NYA1"]) > 1.05
    for name in recorded.TABLES:
        noise = [recorded.size(cases[f"{name}, {kind}"].noise) for kind in (one, two)]
        assert 2.5 < noise[1] / noise[0] < 3.5


def from_to(values, form="{:.2f}"):
    return f"{form.format(min(values))} to {form.format(max(values))}"


@pytest.mark.parametrize("path", ["CHANGELOG.md", "docs/corrections.md"])
def test_what_we_had_wrong_is_told_by_numbers_that_are_computed(days, cases, path):
    left_in = recorded.cases({name: recorded.without_biases(day) for name, day in days.items()})
    text = " ".join((ROOT / path).read_text(encoding="utf-8").split())
    both = [[recorded.size(each[f"{name}, {recorded.KINDS[1]}"].lasting) for name in days] for each in (left_in, cases)]
    for sizes in both:
        assert f"{from_to(sizes)} m" in text
    ours = 100 * (1 - np.square(np.divide(*both[::-1])))
    assert f"{from_to(ours, '{:.0f}')} % of the variance of what lasts" in text
    of_two = [name for name in cases if not name.startswith("Belem")]
    for each in (left_in, cases):
        assert from_to([recorded.newest_ratio(each[name].errors, 100) for name in of_two]) in text
    bias = [each for day in days.values() for each in (np.nanmin(day.bias), np.nanmax(day.bias))]
    assert f"from {from_to(bias, '{:.1f}')} m" in text
    assert f"multipl{'y' if path == 'CHANGELOG.md' else 'ies'} it by {recorded.AMPLIFIED:.2f}" in text
    rows = {row[0]: [float(number) for number in row[1:]] for row in article.how_far(cases)}
    better = [
        name
        for name in sorted(days, reverse=True)
        if max(np.divide(*(rows[f"{name}, {kind}"] for kind in recorded.KINDS[::-1]))[2:4]) < 1
    ]
    assert better == ["ESBC", "Belem"]
    assert "turns round at ESBC and Belem" in text
    assert "not at NYA1" in text


def test_the_mean_of_fixes_at_rest_is_compared_with_one():
    errors = np.random.default_rng(8).standard_normal((5000, 3))

    def of_one(errors, n):
        return recorded.ratio_of(recorded.means(errors, n), errors[n - 1 :])

    assert of_one(errors, 25) == pytest.approx(1 / 5, rel=0.1)  # 600 independent errors: 4 %
    assert of_one(np.cumsum(errors, axis=0), 2) == pytest.approx(1, abs=1e-3)  # errors that last
