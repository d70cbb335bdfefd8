"""The notebook on 2015: its filters beside the package; its front and its verdicts, computed another way."""

import json
import re
from collections import Counter
from itertools import combinations

import numpy as np
import pytest
from conftest import ROOT, cells_of, dense_model, shown, source
from scipy.linalg import solve_discrete_are

import mpt_helpers as mpt
from reproduction import burden, published
from reproduction.ledger import stored_verdicts
from reproduction.papers_2014_2015 import evidence_2015 as evidence

KEY = "2015_mpt_3d"
CELLS = {cell["id"]: cell for cell in cells_of(ROOT / "notebooks" / f"{KEY}.ipynb")}
PAPER = published(KEY)
VERDICTS = {each.id: each for each in stored_verdicts(ROOT / "notebooks" / f"{KEY}.ipynb")}
AXIS = mpt.gsm_axis(dt=1.0, q=0.01, r=0.1)
F, G, H = AXIS.F, np.array([[0.5], [1.0]]), AXIS.H
FRONT, BEYOND = (re.sub(r"[*\s]+", " ", source(CELLS[id])) for id in ("title", "beyond-text"))


@pytest.fixture(scope="module")
def written():
    """The filters that the notebook writes out."""
    names = {}
    exec("\n".join(source(CELLS[id]) for id in ("setup", "invariant", "steady")), names)
    return names


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("name", ["kalman", "lainiotis"])
def test_a_filter_of_the_notebook_is_that_of_the_package(written, name, seed):
    """On a model without zeros, from an uncertain start."""
    model = dense_model(seed)
    z = mpt.simulate(model, 15, np.random.default_rng(seed))[1]
    x, P = written["filtered"](written[name], model, z)
    expected = mpt.KalmanFilter(model).estimates(z)
    np.testing.assert_allclose(x, expected.x, rtol=1e-7, atol=1e-7 * np.abs(x).max())
    np.testing.assert_allclose(P, expected.P, rtol=1e-7, atol=1e-7 * np.abs(P).max())


@pytest.mark.parametrize("name", ["sskf", "sslf"])
def test_a_steady_state_filter_of_the_notebook_is_that_of_the_package(written, name):
    A, B, Pe = written[name](AXIS)
    Pp = solve_discrete_are(F.T, H.T, AXIS.Q, AXIS.R)
    np.testing.assert_allclose(F @ Pe @ F.T + AXIS.Q, Pp, rtol=1e-10)
    z = mpt.simulate(AXIS, 40, np.random.default_rng(3))[1]
    expected = mpt.SteadyStateFilter.from_kalman(AXIS).filter(z)
    np.testing.assert_allclose(written["constant"](A, B, z), expected, atol=1e-12)


def test_a_join_is_the_mean_of_estimates_and_of_covariances(written):
    x, P = written["join"]((np.array([1.0, 2.0]), np.eye(2)), (np.array([3.0, -2.0]), 3 * np.eye(2)))
    np.testing.assert_array_equal(x, [2, 0])
    np.testing.assert_array_equal(P, 2 * np.eye(2))


# The front


def test_the_wrong_cells_that_the_front_names_are_all_that_is_wrong():
    fail = [each for each in VERDICTS.values() if each.verdict in ("erratum", "differs")]
    assert [each.id for each in fail] == ["filters.b", "table3.9", "table3.12"]
    for each in fail[1:]:
        assert f"{each.printed} should be {each.computed}" in FRONT
    assert "model B needs two filters, a slip: it needs three, and Table 3 counts three" in FRONT
    assert fail[0].computed == "Table 3 counts 207 = 3 · 69"
    assert 3 * 69 == 207 == int(PAPER.items["table3.7"].printed)
    assert burden.total(burden.kalman(2, 1)) == 69
    assert [each.id for each in VERDICTS.values() if each.verdict == "holds in part"] == ["measured"]


def test_the_front_says_how_many_results_could_have_failed():
    """As the ledger's bases have it; what is left is named."""
    hold = [each for each in VERDICTS.values() if each.verdict == "reproduced"]
    of = Counter(each.basis for each in hold)
    left = [each.id for each in hold if each.basis not in ("identity", "arithmetic")]
    assert f"Of the {len(hold)} results that hold, {of['identity']} are algebra" in FRONT
    assert f"{of['arithmetic']} are counts of operations, or compare these. The other {len(left)} are" in FRONT
    assert "very close (twice), the condition that each axis is measured, and three wordings" in FRONT
    wordings = [id for id in left if id.startswith(("merge.", "filters.list"))]
    assert set(left) == {"abstract.behaviour", "behaviour.3", "three-axes", *wordings}
    assert len(wordings) == 3


def test_the_front_names_the_dearest_and_the_cheapest_that_it_compares():
    assert "the cost falls from Kalman's 1660 operations a step to 30" in FRONT
    assert (PAPER.items["table3.1"].printed, PAPER.items["table3.10"].printed) == ("1660", "30")


def test_no_comparison_of_table_3_changes():
    """Which of two implementations takes fewer operations, or that they take as many, for all 66 pairs."""
    assert "none of them changes a comparison" in FRONT
    printed = [int(PAPER.items[f"table3.{row}"].printed) for row in range(1, 13)]
    right = list(burden.twelve(axes=3).values())
    assert sum(was != is_ for was, is_ in zip(printed, right, strict=True)) == 2
    for i, j in combinations(range(12), 2):
        assert np.sign(printed[i] - printed[j]) == np.sign(right[i] - right[j]), (i + 1, j + 1)


def test_a_join_costs_more_than_both_filters_and_changes_nothing():
    assert "the mean of two equal estimates is the same estimate, at more than the price of both" in FRONT
    counts = burden.twelve(axes=3)
    once = burden.total(burden.join(6, 3)), burden.total(burden.join_steady_state(6, 3))
    changing, constant = counts["KF B"] + counts["LF B"] + once[0], counts["SSKF B"] + counts["SSLF B"] + once[1]
    said = f"Nor does it help to join after merging, once with n = 6: that gives {changing} and {constant}."
    assert said in source(CELLS["table3-read"])
    counts = burden.twelve(axes=3)
    for model in "AB":
        assert counts[f"JKLF {model}"] > counts[f"KF {model}"] + counts[f"LF {model}"]
        assert counts[f"JSSKLF {model}"] > counts[f"SSKF {model}"] + counts[f"SSLF {model}"]
    assert VERDICTS["behaviour.1"].verdict == VERDICTS["behaviour.2"].verdict == "reproduced"


def test_the_rules_of_table_2_are_those_that_are_counted():
    said = source(CELLS["table2-text"])
    assert "q multiplications and q - 1 additions for each entry" in said
    assert burden.product(2, 5, 3) == 6 * (5 + 4)
    assert "Of a symmetric result only the upper triangle is computed." in said
    assert burden.symmetric_product(3, 5) == 6 * (5 + 4)
    assert "An inverse takes (16p³ - 3p² - p)/6 operations." in said
    assert [burden.inverse(p) for p in (1, 3)] == [2, (16 * 27 - 27 - 3) // 6]


def test_the_sums_of_table_3_are_those_that_its_cause_writes_out():
    sentence = PAPER.causes["table3-join"].sentence
    counts = burden.twelve(axes=3)
    for name, pair, join in (("JKLF", ("KF", "LF"), 2**2 + 3 * 2), ("JSSKLF", ("SSKF", "SSLF"), 2 * 2)):
        first, second = (counts[f"{each} B"] for each in pair)
        assert f"{first} + {second} + 3 · {join} = {counts[f'{name} B']}" in sentence
        assert first + second + 3 * join == counts[f"{name} B"]


# The verdicts


def test_what_z_leaves_out_of_the_next_position_is_the_push():
    x, w, push, noise = np.array([2.0, -3.0]), 0.7, 0.5 * np.sqrt(0.01), np.sqrt(0.1)
    assert (F @ x + G[:, 0] * w)[0] - (H @ x)[0] == pytest.approx(0.5 * w)
    found = VERDICTS["measured"]
    assert found.verdict == "holds in part"
    assert f"it measures the position one step later, to within {100 * push:.0f} cm (σ)" in FRONT
    assert f"save a push of {100 * push:.0f} cm against {100 * noise:.0f} cm of noise." in found.reason
    assert "z(k) measures s(k+1), but for the push ½ Δt w(k)" in found.reason


def test_what_z_measures_has_the_words_of_2014():
    of_2014 = {each.id: each for each in stored_verdicts(ROOT / "notebooks" / "2014_gsm_2d.ipynb")}
    assert VERDICTS["measured"].reason == of_2014["measured"].reason


def test_the_theorem_is_judged_by_the_models_that_fulfil_it(monkeypatch):
    tried = evidence.forgets_its_start(AXIS)
    fulfil = [forgot for forgot, should in tried.values() if should]
    assert all(fulfil)
    assert len(tried) == len(fulfil) + 1
    said = f"{len(fulfil)} of {len(fulfil)} models tried that fulfil it forget P0; it is silent on one more"
    assert f"{said}, which does not" in VERDICTS["exists"].computed
    lucky = {"fulfils": (True, True), "does not": (True, False)}
    monkeypatch.setattr(evidence, "forgets_its_start", lambda axis: lucky)
    holds, shown = evidence.exists(AXIS)["exists"]
    assert holds, "a sufficient condition says nothing of other models"
    assert shown.endswith("which does too")


def test_nothing_is_late_where_the_measurements_follow_H():
    """The error of a constant gain has no part that grows with the state; fed with positions it has, of one step."""
    assert "Measurements that follow the paper's H are not late." in FRONT
    assert "fed with H x(k), they are not late" in VERDICTS["measured"].beyond
    steady = mpt.SteadyStateFilter.from_kalman(AXIS)
    np.testing.assert_allclose(F - steady.A - steady.B @ H @ F, 0, atol=1e-12)
    fed = F - steady.A - steady.B @ np.array([[1, 0]]) @ F
    behind = np.linalg.solve(np.eye(2) - steady.A, fed @ [0, 1])  # at a velocity of 1 m/s
    assert behind[0] == pytest.approx(1, abs=1e-9)
    assert evidence.late(AXIS) == pytest.approx(1.5 * behind[0], abs=1e-9)


def test_with_positions_and_their_H_nothing_is_late():
    assert "if your receiver reports where the phone is now , write H = [1 0]" in FRONT
    assert "With H = [1 0] it is not late ([One step late]" in BEYOND
    right = mpt.LinearModel(F=F, H=[[1, 0]], Q=AXIS.Q, R=AXIS.R)
    assert evidence.late(right) == pytest.approx(0, abs=1e-9)


def test_columns_side_by_side_are_a_matrix_and_as_blocks_the_state():
    found = VERDICTS["merge.joined"]
    assert found.verdict == "reproduced"
    columns = [np.ones((2, 1))] * 3
    assert "{} × {}".format(*np.hstack(columns).T.shape) in found.computed
    assert np.vstack(columns).shape == (6, 1)


@pytest.mark.parametrize(("p0", "where"), [(0, "computed"), (100, "beyond")])
def test_the_first_gap_of_the_groups_is_that_of_their_gains(p0, where):
    """At step 1 the gap is the difference of both gains times the innovation."""
    P = p0 * F @ F.T + AXIS.Q
    S = (H @ P @ H.T).item() + 0.1
    K = P @ H.T / S
    steady = mpt.SteadyStateFilter.from_kalman(AXIS)
    gap = abs(steady.B - K)[0, 0] * np.sqrt(S)
    own = np.sqrt((P - K @ H @ P)[0, 0])
    said = getattr(VERDICTS["behaviour.3"], where)
    if p0:
        assert f"from P0 = 100 I the rms gap is {gap:.1f} m at step 1" in said
        assert f"{gap:.1f} m apart at step 1" in BEYOND
        assert f"from P0 = 100 I the rms gap is {gap:.1f} m at step 1" in VERDICTS["abstract.behaviour"].computed
    else:
        share = gap / np.sqrt(steady.P[0, 0])
        assert f"{share:.2f} σ at most, at step 1: {100 * gap:.0f} cm of position" in said
        assert f"{gap / own:.1f} times Kalman's own σ there" in said
        variance = own**2 / steady.P[0, 0]
        assert f"Kalman's P of the position is {100 * variance:.0f} % of P_e at step 1, " in said
        assert said.endswith("within 10 % from step 5 on")
        after = np.diagonal(mpt.KalmanFilter(AXIS).covariances(60), axis1=1, axis2=2) / np.diag(steady.P)
        assert np.abs(after[3] - 1).max() > 0.1 > np.abs(after[4:] - 1).max()


def test_the_gap_of_the_groups_is_below_a_tenth_of_sigma_when_the_notebook_says():
    """From 20,000 simulated tracks: past the step and not before it, in position and velocity."""
    steady = mpt.SteadyStateFilter.from_kalman(AXIS)
    sigma = np.sqrt(np.diag(steady.P))
    for p0, said, from_step in ((0, "computed", 7), (100, "beyond", 17)):
        assert f"below σ/10 from step {from_step} on" in getattr(VERDICTS["behaviour.3"], said)
        model = mpt.LinearModel(F=F, H=H, Q=AXIS.Q, R=AXIS.R, P0=p0 * np.eye(2))
        _, z = mpt.simulate(model, 30, np.random.default_rng(5), tracks=20_000)
        gap = steady.filter(z) - mpt.KalmanFilter(model).filter(z)
        rms = (np.sqrt((gap**2).mean(axis=2)) / sigma).max(axis=1)
        assert rms[from_step - 2] > 0.1
        assert max(rms[from_step - 1 :]) < 0.1
        if p0:
            assert "below σ from step 11 on" in VERDICTS["behaviour.3"].beyond
            assert rms[9] > 1 > max(rms[10:])
    assert "less than σ/10 apart from step 17 on, not from step 7" in BEYOND


def test_the_conclusion_on_steady_state_names_the_pair_that_is_the_other_way_round():
    counts = burden.twelve(axes=3)
    across = [
        (slow, fast)
        for slow in counts
        for fast in counts
        if "SS" in slow and "SS" not in fast and counts[slow] >= counts[fast]
    ]
    assert across == [("JSSKLF A", "KF B")]
    assert "JSSKLF A with 216 than KF B with 207" in VERDICTS["speed.3"].beyond


def test_model_b_takes_the_shares_that_the_ledger_says():
    printed = {
        name: f"{burden.twelve(axes=3)[f'{name} B'] / burden.twelve(axes=3)[f'{name} A']:.0%}"
        for name in ("LF", "JSSKLF")
    }
    assert printed == {"LF": "12%", "JSSKLF": "33%"}
    assert "takes 12 to 33 % of model A's operations" in VERDICTS["speed.4"].computed


def test_each_total_of_table_3_is_the_sum_beside_it():
    for made, total in zip(evidence.sums(), burden.twelve(axes=3).values(), strict=True):
        filters, of_one = made.split(" · ")
        assert int(filters) * burden.value(of_one) == total
        assert made in shown(CELLS["table3"])


@pytest.mark.parametrize("name", ["KF", "LF"])
def test_a_large_speedup_is_the_product_of_two(name):
    counts = burden.twelve(axes=3)
    model, gain = counts[f"{name} A"] / counts[f"{name} B"], counts[f"{name} B"] / counts[f"SS{name} B"]
    id = f"speedup.{name.lower()}-a-ss{name.lower()}-b"
    line = f"{name} A over SS{name} B: {model:.2f} (model) times {gain:.2f} (constant gain) = {PAPER.items[id].printed}"
    assert line in shown(CELLS["speedups-apart"])
    assert f"{model * gain:.3f}" == PAPER.items[id].printed


# Beyond the paper


def test_axes_that_share_P_take_the_operations_that_are_said():
    """One step of one axis: 16 operations contain x or z, and the others make P and K."""
    moves = [each for name, each in burden.kalman(2, 1) if "x(k" in name or "z(k" in name]
    one = burden.total(burden.kalman(2, 1))
    assert (one - sum(moves)) + 3 * sum(moves) == 101
    assert "Computed once it leaves 101 operations of 207. With constant gain both take 30." in BEYOND


def test_axes_that_share_P_have_the_estimates_of_model_a():
    assert "three axes have the same P" in BEYOND
    model = mpt.stack(AXIS, AXIS, AXIS)
    z = mpt.simulate(model, 30, np.random.default_rng(4))[1]
    X, P = np.zeros((2, 3)), np.zeros((2, 2))
    for z_k, x_k, P_k in zip(z, *(getattr(mpt.KalmanFilter(model).estimates(z), name) for name in "xP"), strict=True):
        X, P = F @ X, F @ P @ F.T + AXIS.Q
        K = P @ H.T / (H @ P @ H.T + 0.1)
        X, P = X + K * (z_k - H @ X), P - K @ H @ P
        np.testing.assert_allclose(X.T.ravel(), x_k, atol=1e-12)
        np.testing.assert_allclose(np.kron(np.eye(3), P), P_k, atol=1e-12)


def test_a_silent_axis_is_lost_as_fast_as_is_said():
    """Thirty steps at once: F^30, and each push by what it has moved since."""
    P = mpt.SteadyStateFilter.from_kalman(AXIS).P
    moved = np.array([[1, 30], [0, 1]])
    lost = (moved @ P @ moved.T)[0, 0] + 0.01 * sum((j + 0.5) ** 2 for j in range(30))
    words = f"take σ of its position from {np.sqrt(P[0, 0]):.2f} m to {np.sqrt(lost):.1f} m"
    assert words in BEYOND
    assert words.replace("its", "a") in VERDICTS["three-axes"].beyond


def test_the_late_filter_states_what_is_said():
    assert "is 1.5 m behind a walker at 1.5 m/s, and states a σ of 0.17 m" in BEYOND
    assert round(float(np.sqrt(mpt.SteadyStateFilter.from_kalman(AXIS).P[0, 0])), 2) == 0.17


def test_the_times_are_those_that_were_measured():
    """A quarter leaves room for another load; no other word ("three times") would fit."""
    times = json.loads((ROOT / "benchmarks" / "results.json").read_text(encoding="utf-8"))["three axes"]
    one = {each["name"]: each["one"] for each in times}
    assert "one after the other take about twice as long as the big one" in BEYOND
    assert "two to three times as long as one for all" in FRONT
    assert one["three filters of two states"] == pytest.approx(2, rel=0.25)
    assert "with constant gain three times" in BEYOND
    constant = {name.removeprefix("constant gain: "): time for name, time in one.items() if "constant" in name}
    ratio = constant["three filters of two states"] / constant["one filter of six states"]
    assert ratio == pytest.approx(3, rel=0.25)
    assert "share one P take 0.7 of its time" in BEYOND
    assert one["axes as columns, one P and K"] == pytest.approx(0.7, rel=0.25)


def test_the_costs_with_all_states_measured_are_those_of_table_2():
    of = {name: PAPER.items[f"table2.{name}"].printed for name in ("kf", "lf")}
    costs = {name: burden.value(formula, n=6, m=6) for name, formula in of.items()}
    assert f"KF takes {costs['kf']} operations and LF {costs['lf']}" in BEYOND


def test_each_number_beyond_the_paper_is_printed_by_its_cell():
    printed = set(re.findall(r"\d+(?:\.\d+)?", shown(CELLS["beyond"])))
    inputs = {"0", "1", "100", "10", "0.7"}  # H, P0, σ/10; the measured time has a test of its own
    said = re.sub(r"\]\([^)]*\)", "]", BEYOND)
    assert set(re.findall(r"(?<![\w.])\d+(?:\.\d+)?", said)) - inputs <= printed
