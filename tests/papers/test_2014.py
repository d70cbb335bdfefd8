"""The notebook on 2014: what its filters are held against, and each number that its words say."""

import re
from collections import Counter

import numpy as np
import pytest
from conftest import ROOT, cells_of, prose, source
from scipy.linalg import solve_discrete_are

import mpt_helpers as mpt
from reproduction import burden, published
from reproduction.ledger import Item, stored_verdicts
from reproduction.papers_2014_2015 import checks_2014 as checks
from reproduction.papers_2014_2015 import figures, table4
from reproduction.plots import COLOUR_OF

NOTEBOOK = ROOT / "notebooks" / "2014_gsm_2d.ipynb"
CELLS = {cell["id"]: cell for cell in cells_of(NOTEBOOK)}
AXIS = mpt.gsm_axis(dt=1.0, q=0.01, r=0.1)
STEADY = mpt.SteadyStateFilter.from_kalman(AXIS)
COUNTED = burden.twelve(axes=2)
TRACKS, STEPS = 20_000, 60


@pytest.fixture(scope="module")
def taught():
    """The names that the open cells of the notebook define, up to FIR."""
    names = {}
    for id in ("setup", "model", "filters", "steady", "run", "fir"):
        exec(source(CELLS[id]), names)
    return names


@pytest.fixture(scope="module")
def verdicts():
    return {each.id: each for each in stored_verdicts(NOTEBOOK)}


@pytest.fixture(scope="module")
def words():
    """The words of the notebook in one line, without emphasis and the contents."""
    text = re.sub(r"<!-- contents -->.*<!-- end of contents -->", "", prose(CELLS.values()), flags=re.DOTALL)
    return re.sub(r"\s+", " ", text.replace("*", ""))


@pytest.fixture(scope="module")
def tracks():
    """True states (STEPS, 2, TRACKS), their measurements with H = [1 Δt], and with H = [1 0]; without the package."""
    rng = np.random.default_rng(1)
    x, states = np.zeros((2, TRACKS)), []
    for _ in range(STEPS):
        x = np.array([[1, 1], [0, 1]]) @ x + np.array([[0.5], [1]]) * 0.1 * rng.standard_normal(TRACKS)
        states.append(x)
    states = np.array(states)
    noise = np.sqrt(0.1) * rng.standard_normal((STEPS, TRACKS))
    return states, states[:, 0] + states[:, 1] + noise, states[:, 0] + noise


def run_all(coefficients, z):
    """Run a filter over many tracks of measurements (STEPS, TRACKS); coefficients gives A and B of each step."""
    x, estimates = np.zeros((2, z.shape[1])), []
    for z_k, (A, B) in zip(z, coefficients, strict=True):
        x = A @ x + B * z_k
        estimates.append(x)
    return np.array(estimates)


def settled():
    return [(STEADY.A, STEADY.B)] * STEPS


# What the filters are held against


def test_the_answer_without_a_filter_is_that_of_the_package():
    for model in (AXIS, mpt.stack(AXIS, AXIS)):
        z = mpt.simulate(model, 12, np.random.default_rng(5))[1]
        means, covariances = checks.conditioned(model, z)
        expected = mpt.KalmanFilter(model).estimates(z)
        np.testing.assert_allclose(means, expected.x, atol=1e-12)
        np.testing.assert_allclose(covariances, expected.P, atol=1e-12)


def test_both_limits_solve_the_riccati_equation_by_another_way(taught):
    F, H, Q, R = AXIS.F, AXIS.H, AXIS.Q, AXIS.R
    P_p = solve_discrete_are(F.T, H.T, Q, R)
    for filter in ("sskf", "sslf"):
        _, _, P_e = taught[filter](AXIS)
        np.testing.assert_allclose(F @ P_e @ F.T + Q, P_p, rtol=1e-10)


@pytest.mark.parametrize("wrong", range(5))
def test_each_matrix_of_equation_7_matters(taught, wrong):
    matrices = list(taught["parts"](AXIS))
    assert checks.parts_of_eq7(taught["kalman"], AXIS, *matrices) < 1e-12
    matrices[wrong] = 1.01 * matrices[wrong]
    assert checks.parts_of_eq7(taught["kalman"], AXIS, *matrices) > 1e-5


def test_a_gap_is_the_largest_of_all_members_and_all_others():
    one, other = (np.zeros(2), np.zeros(3)), (np.ones(2), np.zeros(3))
    assert checks.gap(one, one, other) == 1
    assert checks.gap([0.0, 0.0], [0.0, -2.0]) == 2
    with pytest.raises(ValueError, match="zip"):
        checks.gap(one, other[:1])


def test_how_close_a_constant_gain_is_is_that_of_simulated_tracks(tracks):
    _, z, _ = tracks
    P, changing = np.zeros((2, 2)), []
    for _ in range(STEPS):
        P = AXIS.F @ P @ AXIS.F.T + AXIS.Q
        K = P @ AXIS.H.T / (AXIS.H @ P @ AXIS.H.T + AXIS.R)
        P = P - K @ AXIS.H @ P
        changing.append((AXIS.F - K @ AXIS.H @ AXIS.F, K))
    apart = np.std(run_all(changing, z) - run_all(settled(), z), axis=2) / np.sqrt(np.diag(STEADY.P))
    found = checks.closeness(AXIS)
    for k in (0, 1, 4, 8):
        assert found["gap"][k] == pytest.approx(apart[k].max(), rel=0.03)
        assert found["metres"][k] == pytest.approx(apart[k, 0] * np.sqrt(STEADY.P[0, 0]), rel=0.03)


def test_below_is_the_step_after_the_last_that_is_not():
    assert checks.below(np.array([0.5, 0.05, 0.2, 0.01, 0.0])) == 4


def test_the_delay_is_that_of_simulated_tracks(tracks):
    states, ahead, positions = tracks
    for z, H, late in ((positions, [[1, 0]], 1), (ahead, [[1, 1]], 0)):
        found, rest, stated = checks.late_by(AXIS, H)
        assert found == pytest.approx(late, abs=1e-9)
        error = (states - run_all(settled(), z))[40:, 0] - late * states[40:, 1]
        assert error.std() == pytest.approx(rest, rel=0.01)
        assert stated == pytest.approx(np.sqrt(STEADY.P[0, 0]))


def test_the_innovations_of_a_late_filter_are_those_of_simulated_tracks(tracks):
    _, _, positions = tracks
    estimates = run_all(settled(), positions)
    stated = (AXIS.H @ (AXIS.F @ STEADY.P @ AXIS.F.T + AXIS.Q) @ AXIS.H.T + AXIS.R).item()
    innovations = positions[41:] - np.einsum("j,kjM->kM", (AXIS.H @ AXIS.F)[0], estimates[40:-1])
    nis = checks.nis_of_late(AXIS, np.array([[0.5], [1]]), 0.01)
    assert (innovations**2).mean() / stated == pytest.approx(nis, abs=0.005)


def test_the_chance_of_an_alarm_is_that_of_simulated_tests():
    sums = 0.9 * np.random.default_rng(1).chisquare(60, 200_000)
    alarmed = np.mean((sums < 40.482) | (sums > 83.298))  # the quantiles of a table
    assert checks.noticed(0.9, 60) == pytest.approx(alarmed, abs=0.003)
    assert checks.noticed(1, 60) == pytest.approx(0.05)


def test_what_fir_drops_is_that_of_simulated_tracks(tracks):
    _, z, _ = tracks
    estimates = run_all(settled(), z)
    found = checks.dropped_by_fir(AXIS, 17) * np.sqrt(np.diag(STEADY.P))
    for k in (18, 30, 60):
        seen = np.linalg.matrix_power(STEADY.A, 17) @ estimates[k - 17 - 1]
        np.testing.assert_allclose(found[k], seen.std(axis=1), rtol=0.03)
    assert not found[:18].any()


def test_a_steady_state_is_expected_where_the_theorem_says():
    found = checks.forgets_its_start(AXIS)
    assert all(meet == should for meet, should in found.values())
    assert {should for _, should in found.values()} == {True, False}


# Table 4


def test_each_wrong_cell_follows_from_the_counts_of_its_cause(verdicts):
    """A new failure is not explained by a cause in silence: their cells are counted here."""
    cells = Counter(each.cause for each in verdicts.values() if each.cause)
    expected = {"table4-1191": 17, "table4-118": 18, "table4-640": 18, "table4-98": 18, "table3-join": 2}
    assert cells == expected | {"fir-cost": 9, "measured": 1, "copy": 9}
    counts = list(COUNTED.values())
    behind = counts.copy()
    behind[2], behind[5], behind[8], behind[11] = 1191, 118, 640, 98
    for each in verdicts.values():
        if each.id.startswith("table4.") and each.printed != "?":
            i, j = (int(part) - 1 for part in each.id.split(".")[1:])
            assert Item("t", "", "number", each.printed).agrees(behind[i] / behind[j])


def test_the_causes_of_table_4_name_the_counts(verdicts):
    causes = published("2014_gsm_2d").causes
    for id, (name, model, row) in {
        "table4-1191": ("JKLF", "A", 3), "table4-118": ("JSSKLF", "A", 6),
        "table4-640": ("JKLF", "B", 9), "table4-98": ("JSSKLF", "B", 12),
    }.items():  # fmt: skip
        right, behind = COUNTED[f"{name} {model}"], id.removeprefix("table4-")
        sentence = (
            f"The ratios of Table 4 that involve {name}, model {model}, fit {behind} operations. By Table 2 it takes"
        )
        assert causes[id].sentence.startswith(f"{sentence} {right}")
        if model == "B":
            assert causes[id].sentence.endswith(f"Table 3 prints {verdicts[f'table3.{row}'].printed}.")
    assert f"off by {100 - 100 * 1191 / COUNTED['JKLF A']:.1f} % only" in causes["table4-1191"].meaning
    assert f"{100 * 118 / COUNTED['JSSKLF A'] - 100:.0f} % slower" in causes["table4-118"].meaning
    assert 98 / COUNTED["JSSKLF B"] == pytest.approx(2, abs=0.1)
    assert "twice as slow" in causes["table4-98"].meaning


def test_one_comparison_is_reversed(verdicts, words):
    cells = [each for each in verdicts.values() if each.id.startswith("table4.") and each.printed != "?"]
    found = [each.id for each in cells if (float(each.printed) - 1) * (float(each.computed) - 1) < 0]
    assert found == ["table4.1.9", "table4.9.1"]
    cell = verdicts["table4.9.1"]
    assert f"is printed with {cell.printed} times the operations of KF with model A" in words
    assert f"Counted, it takes {float(cell.computed):.3f} times as many." in words
    assert "row 1, column 9 and in row 9, column 1" in published("2014_gsm_2d").causes["table4-640"].meaning


def test_the_text_says_how_our_copy_of_table_4_was_read(words):
    """Thirteen numbers in each of twelve rows: those placed, and those dropped."""
    cells = table4.cells_of(published("2014_gsm_2d"))
    legible = sum(not item.lost for item in cells.values())
    assert f"that of j and i is 1) place {legible}. We dropped" in words
    assert f"We dropped {12 * 13 - legible}:" in words
    assert f"{len(cells) - legible} of the {len(cells)} cells of Table 4 are lost" in words


# The figures


@pytest.mark.parametrize(
    ("draw", "labels", "colours", "shown"),
    [
        (figures.draw_fig1, ["solid line: KF/LF/JKLF", "dashed line: SSKF/SSLF/JSSKLF"], ["kalman", "steady"], 15),
        (figures.draw_fig2, ["solid line: SSKF/SSLF", "dashed line: FIR SSKF/SSLF"], ["steady", "fir"], 40),
    ],
)
@pytest.mark.parametrize("axes", [2, 3])
def test_a_figure_has_the_line_styles_of_its_caption_and_below_it_the_difference(draw, labels, colours, shown, axes):
    """Of the papers of 2014 and 2015, on some track; the difference is in centimetres, and names its axes."""
    first, second = np.random.default_rng(6).normal(size=(2, 40, 2 * axes))
    sigma = np.array([0.2, 0.1])
    fig = draw(first, second, sigma)
    names = [
        f"{what} {axis} ({unit})" for axis in "xyz"[:axes] for what, unit in (("position", "m"), ("velocity", "m/s"))
    ]
    *above, position, velocity = fig.axes
    assert [panel.get_title(loc="left") for panel in above] == names
    for i, panel in enumerate(above):
        solid, dashed = panel.lines
        assert [line.get_linestyle() for line in panel.lines] == ["-", "--"]
        assert [line.get_color() for line in panel.lines] == [COLOUR_OF[each] for each in colours]
        np.testing.assert_array_equal(solid.get_xydata(), np.column_stack([np.arange(1, 41), first[:, i]]))
        np.testing.assert_array_equal(dashed.get_ydata(), second[:, i])
    (legend,) = fig.legends
    assert [text.get_text() for text in legend.get_texts()] == labels
    for i, panel in enumerate((position, velocity)):
        title = panel.get_title(loc="left")
        assert (title[:23], title[-12:]) == ("added: dashed − solid,\n", "grey: ± σ/10")
        assert [text.get_text() for text in panel.get_legend().get_texts()] == list("xyz"[:axes])
        assert len({line.get_marker() for line in panel.lines}) == axes
        for axis, line in enumerate(panel.lines):
            np.testing.assert_allclose(line.get_ydata(), 100 * (second - first)[:shown, 2 * axis + i])
        (band,) = panel.patches
        low, high = band.get_extents().transformed(panel.transData.inverted()).intervaly
        np.testing.assert_allclose([low, high], [-10 * sigma[i], 10 * sigma[i]])
    assert (
        fig.get_suptitle()
        == f"Figure {1 if draw is figures.draw_fig1 else 2}, redrawn: estimates on a track of our own"
    )


# What the words say


def test_the_front_counts_what_the_verdicts_say(verdicts, words):
    def failing(start):
        given = [
            each for each in verdicts.values() if each.id.startswith(start) and each.verdict != "cannot be checked"
        ]
        return f"{sum(each.verdict == 'erratum' for each in given)} of {len(given)}"

    assert f"{failing('table4.')} speedups in Table 4" in words
    assert f"{failing('table3.')} totals in Table 3" in words
    wrong = [each for each in verdicts.values() if each.verdict in ("erratum", "differs")]
    joins = [each for each in wrong if each.cause == "table3-join" or each.cause.startswith("table4-")]
    assert f"{len(joins)} of the {len(wrong)} wrong results are joins" in words
    assert {each.cause for each in wrong if each not in joins} == {"fir-cost"}
    every = {each.id: float(each.computed) for each in verdicts.values() if each.id.startswith("table7.mu")}
    assert set(every.values()) == {7}
    printed = [verdicts[f"table7.mu.{model}"].printed for model in "ab"]
    assert f"every 7th step or less often, not every {printed[0]}rd (model A) or {printed[1]}th (model B)" in words
    assert f"the newest M = {verdicts['fir.order'].computed} measurements" in words


def test_a_join_costs_more_than_twice_one_of_its_filters(words):
    assert all(COUNTED[f"J{join} {model}"] > 2 * COUNTED[f"{one} {model}"] for model in "AB"
               for join, one in (("KLF", "KF"), ("SSKLF", "SSKF")))  # fmt: skip
    assert "at more than twice the cost of KF or SSKF alone" in words


def test_z_is_the_position_at_the_end_of_the_step_save_the_push(verdicts):
    x, w = np.array([2.0, -3.0]), 0.7
    ahead = (AXIS.F @ x)[0] + 0.5 * w
    assert ahead - (AXIS.H @ x).item() == pytest.approx(0.5 * w)
    push, noise = 100 * 0.5 * np.sqrt(0.01), 100 * np.sqrt(0.1)
    found = verdicts["measured"]
    assert found.verdict == "holds in part"
    assert f"save a push of {push:.0f} cm against {noise:.0f} cm of noise." in found.reason
    assert "Does not hold: of s(k), the position when it begins." in found.reason
    assert found.reason.endswith(published("2014_gsm_2d").causes["measured"].sentence)
    assert (
        published("2014_gsm_2d")
        .causes["measured"]
        .meaning.startswith("Measurements that follow the paper's H are not late.")
    )


def test_one_column_below_the_other_is_the_state_of_equation_17(verdicts):
    assert verdicts["eq17.joined"].verdict == "reproduced"
    assert np.hstack([np.ones((2, 1))] * 2).T.shape == (2, 2)  # not as columns side by side: as blocks


def test_the_start_that_constant_gain_needs(words):
    from_zero, from_unknown = (checks.closeness(AXIS, p0=p0)["gap"] for p0 in (0, 100))
    assert checks.below(from_zero) == 7
    assert "agree after six steps" in words
    assert f"it takes {checks.below(from_unknown) - 1} steps to come near the Kalman filter" in words
    assert f"from an unknown start it needs {checks.below(from_unknown) - 1} steps" in words


def test_the_first_gap_is_the_difference_of_the_gains_times_the_innovation(verdicts):
    S = (AXIS.H @ AXIS.Q @ AXIS.H.T + AXIS.R).item()
    K = AXIS.Q @ AXIS.H.T / S
    gap = abs(STEADY.B[0, 0] - K[0, 0]) * np.sqrt(S)
    share = gap / np.sqrt(STEADY.P[0, 0])
    assert f"at most {share:.2f} σ, {100 * gap:.0f} cm, at step 1" in verdicts["behaviour.3"].computed


def test_the_two_factors_of_the_speedups_in_the_text(words):
    of_model, of_gain = COUNTED["KF A"] / COUNTED["KF B"], COUNTED["KF B"] / COUNTED["SSKF B"]
    said = f"takes {of_model:.2f} times the operations of KF with model B, and these {of_gain:.2f} times those of SSKF:"
    assert f"{said} {of_model * of_gain:.2f} is the product" in words


def test_the_cost_of_fir_one_operation_at_a_time(verdicts, words):
    for part, n, m, filters in (("a", 4, 2, 1), ("b", 2, 1, 2)):
        count = {M: filters * (M * (n * m + n * (m - 1)) + (M - 1) * n) for M in range(1, 101)}
        line = re.match(r"(\d+)M - (\d+): ", verdicts[f"table6.fir.{part}"].computed)
        assert all(int(line[1]) * M - int(line[2]) == each for M, each in count.items())
        assert verdicts[f"mu.{part}"].computed.startswith(f"({line[1]}M - {line[2]})/")
        assert verdicts[f"mu.{part}"].verdict == "erratum"
        assert str(count[17]) in published("2014_gsm_2d").causes["fir-cost"].sentence
        assert f"{line[1]} · 17 - {line[2]} = {count[17]}" in published("2014_gsm_2d").layouts["table7"].wrong
    assert "108 at M = 17: one step with constant gain, 44, and 16 sums of 4" in words
    assert burden.value("2n² + 2nm - n + (M - 1)n", n=4, m=2, M=17) == 108 == 44 + 16 * 4
    assert r"17 \cdot 12 + 16 \cdot 4 = 268" in words


def test_from_which_step_on_fir_pays_against_a_filter_that_collects(words):
    """With both models: as many operations for L = 15, more from 16 on."""
    for n, m in ((4, 2), (2, 1)):
        fir = burden.total(burden.fir(n, m, 17))
        assert burden.total(burden.lifted(n, m, 15)) == fir < burden.total(burden.lifted(n, m, 16))
    assert "against that FIR pays from every 16th step on" in words


def test_fir_lags_by_a_share_of_the_distance(words):
    """Exactly: FIR leaves out A¹⁷ times the estimate of 17 steps earlier; there the velocity hardly counts."""
    left_out = np.linalg.matrix_power(STEADY.A, 17)
    share = f"by {1000 * left_out[0, 0]:.1f} mm for each metre that the phone was from it 17 steps earlier"
    assert share in words
    z = np.random.default_rng(3).normal(0, 10, (40, 1)).cumsum(axis=0)
    x, fir = STEADY.filter(z), mpt.FIRFilter.from_steady_state(STEADY, tol=1e-3).filter(z)
    np.testing.assert_allclose((x - fir)[17:], x[:-17] @ left_out.T, atol=1e-9)
    assert abs(left_out[0, 1]) < 0.05 * left_out[0, 0]


@pytest.mark.parametrize("name", ["1", "2", "inf", "fro"])
def test_the_order_of_fir_is_that_of_its_norm_with_both_models(name):
    size = {"1": 1, "2": 2, "inf": np.inf, "fro": "fro"}[name]
    found = {mpt.fir_order(np.kron(np.eye(axes), STEADY.A), 1e-3, size) for axes in (1, 2)}
    assert found == ({18} if name == "fro" else {17})


def test_equation_22_lacks_what_equation_21_has_of_the_start(verdicts):
    off = [np.abs(np.linalg.matrix_power(STEADY.A, k) @ [5.0, -1.0]).max() for k in range(1, 17)]
    for id in ("eq22.range", "fir.start"):
        assert verdicts[id].beyond.endswith(f"it lacks A^k x0: {max(off):.2f} m for x0 = [5.0, -1.0]")


def test_the_sums_of_table_3_are_those_that_its_cause_writes_out():
    sentence = published("2014_gsm_2d").causes["table3-join"].sentence
    for name, pair, join in (("JKLF", ("KF", "LF"), 2**2 + 3 * 2), ("JSSKLF", ("SSKF", "SSLF"), 2 * 2)):
        first, second = (COUNTED[f"{each} B"] for each in pair)
        assert f"{first} + {second} + 2 · {join} = {COUNTED[f'{name} B']}" in sentence
        assert first + second + 2 * join == COUNTED[f"{name} B"]


def test_kf_is_faster_than_lf_for_these_models_only():
    assert COUNTED["KF A"] < COUNTED["LF A"]
    assert burden.total(burden.kalman(4, 4)) > burden.total(burden.lainiotis(4, 4))


def test_the_ranking_holds_by_table_3_as_printed_too():
    names = ("KF", "LF", "JKLF", "SSKF", "SSLF", "JSSKLF")
    printed = [float(published("2014_gsm_2d").items[f"table3.{row}"].printed) for row in range(1, 13)]
    of_a, of_b = (dict(zip(names, some, strict=True)) for some in (printed[:6], printed[6:]))
    for of in (of_a, of_b):
        assert of["SSKF"] == of["SSLF"] < of["JSSKLF"] < of["KF"] < of["LF"] < of["JKLF"]
    assert all(of_a[name] > of_b[name] for name in names)
    assert "All comparisons hold, by Table 3 as printed and as corrected." in source(CELLS["after-table3-text"])
