"""The recorded days of three receivers: their tables, and what is made of them."""

import gzip
import re
import sys

import numpy as np
import pytest
from conftest import ROOT

import mpt_helpers as mpt
from reproduction.paper_2007 import positioning, recorded
from reproduction.paper_2007.positioning import line_sigma

sys.path.insert(0, str(ROOT / "notebooks" / "data"))
import make_table

DATA = ROOT / "notebooks" / "data"
ROWS = {"ESBC": 25_801, "NYA1": 29_835, "Belem": 28_622}
CASES = [f"{station}, {kind}" for station in recorded.TABLES for kind in recorded.KINDS]


@pytest.fixture(scope="module")
def days():
    return recorded.recorded_days({name: DATA / file for name, file in recorded.TABLES.items()})


@pytest.fixture(scope="module")
def cases(days):
    return recorded.cases(days)


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
    for name in ("errors", "noise", "lasting"):
        assert recorded.size(getattr(found, name)) == pytest.approx(recorded.size(getattr(whole, name)), rel=0.02)
    ratios = [[recorded.line_ratios(axis, 100)[1] for axis in each.errors.T] for each in (found, whole)]
    np.testing.assert_allclose(*ratios, rtol=0.03)


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


def test_the_parts_of_an_error_add_up(cases):
    for case in cases.values():
        np.testing.assert_allclose(case.errors, case.noise + case.lasting, atol=1e-12)
        for errors in (case.errors, case.lasting):
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


@pytest.mark.parametrize("name", CASES)
def test_the_closed_form_with_a_measured_autocorrelation_is_what_the_line_makes(cases, name):
    for errors in cases[name].errors.T:
        measured = mpt.metrics.rms(recorded.line_errors(errors, 50), axis=1) / errors.std()
        # Some 60 stretches of 25 minutes: 9 % for each of the two.
        closed = line_sigma(50, np.array([25.5, 50]), recorded.autocorrelation(errors))
        np.testing.assert_allclose(measured, closed, rtol=0.1)


def test_a_filter_with_an_error_state_states_what_it_makes():
    """On errors drawn from the model itself, the filter that knows it is right, and the other is not."""
    made = recorded.with_lasting(30.0, 0.04, 1.0, 3600.0)
    x, z = mpt.simulate(made.model, 100, np.random.default_rng(5), tracks=3000)
    square = {}
    for name, each in {"aware": made, "white": recorded.white(30.0, 1.04)}.items():
        found = each.estimates(z - x[:, :1])
        square[name] = (found.x[:, 0] ** 2 / found.P[:, 0, 0].reshape(100, -1))[recorded.SETTLED :]
    # 3,000 tracks, whose squares are chi-square: 0.026; four of it
    assert square["aware"].mean() == pytest.approx(1, abs=0.1)
    assert np.mean(square["aware"] < 4) == pytest.approx(0.954, abs=0.015)
    assert square["white"].mean() > 5


def test_the_ins_is_expected_over_its_noise():
    """Against many draws of the INS."""
    errors = np.random.default_rng(6).standard_normal(200).cumsum() / 5
    model = recorded.ins_model(30.0, 1.0, q=1e-4)
    found = recorded.with_ins(model, errors)
    gps, kf, rng = recorded.windows(errors)[:, 0], mpt.KalmanFilter(model), np.random.default_rng(7)
    square, draws = [], 20
    true = np.stack([6.0 * np.arange(100), np.full(100, 0.2), np.ones(100)], axis=1)[:, :, None]
    for _ in range(20):
        ins = np.repeat(1.2 + 0.01 * rng.standard_normal((100, draws, 1)), 2, axis=2)
        z = np.stack([np.tile(true[:, 0] + gps, draws), ins.reshape(100, -1)], axis=1)
        wrong = (kf.filter(z) - true).reshape(100, 3, draws, 2)
        square.append((wrong**2).mean(axis=2))
    rms = np.sqrt(np.mean(square, axis=0)[50:].mean(axis=(0, 2)))
    np.testing.assert_allclose([found.position, found.velocity, found.bias], rms, rtol=0.05)
    nees = (np.mean(square, axis=0)[:, 0] / kf.covariances(100)[:, 0, 0, None])[recorded.SETTLED :].mean()
    assert found.nees == pytest.approx(nees, rel=0.05)
    assert found.fix == pytest.approx(mpt.metrics.rms(gps[50:]))


def test_the_mean_of_fixes_at_rest_is_compared_with_one():
    errors = np.random.default_rng(8).standard_normal((5000, 3))

    def of_one(errors, n):
        return recorded.ratio_of(recorded.means(errors, n), errors[n - 1 :])

    assert of_one(errors, 25) == pytest.approx(1 / 5, rel=0.1)  # 600 independent errors: 4 %
    assert of_one(np.cumsum(errors, axis=0), 2) == pytest.approx(1, abs=1e-3)  # errors that last
