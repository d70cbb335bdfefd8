"""The article on 2015: every number in its prose is printed by a cell or computed here, and what it teaches runs."""

import json
import re

import numpy as np
import pytest
from conftest import ROOT, part_one, source

import mpt_helpers as mpt
from reproduction import burden
from reproduction.papers_2014_2015 import article_2015 as article

NOTEBOOK = ROOT / "notebooks" / "2015_mpt_3d.ipynb"
TEXT = re.sub(r"\s+", " ", part_one(NOTEBOOK).replace("*", ""))
CELLS = {cell["id"]: cell for cell in json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]}
CLOCK = {
    each["name"]: each
    for each in json.loads((ROOT / "benchmarks" / "results.json").read_text(encoding="utf-8"))["three axes"]
}
F, G = article.AXIS.F, np.array([[0.5], [1.0]])


def says(text):
    """Require that the article says this; numbers in it are computed by the test."""
    assert text in TEXT, text


def printed_by(id):
    """What a cell of the notebook prints or shows as text."""
    texts = ["".join(out.get("text", out.get("data", {}).get("text/plain", ""))) for out in CELLS[id]["outputs"]]
    return "\n".join(texts)


@pytest.fixture(scope="module")
def taught():
    """The names that the teaching cells of Part I define: step and step_with_gaps, F, H, Q, r."""
    names = {}
    exec(source(CELLS["filter"]), names)
    exec(source(CELLS["step-gaps"]).partition("\nz[30:, 2]")[0], names)
    return names


@pytest.fixture(scope="module")
def settled():
    """P and K of the settled filter."""
    steady = mpt.SteadyStateFilter.from_kalman(article.AXIS)
    return steady.P, steady.B


@pytest.mark.parametrize(
    ("said", "id", "computed"),
    [
        (r"known to (0\.23) m\. Thirty seconds after its last", "run", r"states σ (0\.23)4 m"),
        (r"grows from 0\.23 to (10\.5) m", "parts", r"so σ = (10\.5) m after 30"),
        (r"last measurement it is known to (10) m", "parts", r"so σ = (10)\.5 m"),
        (r"cost (10) m\. The axis x", "parts", r"so σ = (10)\.5 m"),
        (r"m/s back by (1\.5) m, and states", "ramp", r"-(1\.5)0 m off"),
        (r"and states an error of (0\.17) m", "ramp", r"-1\.50 m off, and the filter states σ (0\.17) m"),
        (r"smaller σ, (0\.17) m instead of", "ramp", r"-1\.50 m off, and the filter states σ (0\.17) m"),
        (r"σ, 0\.17 m instead of (0\.23) m", "ramp", r"\+0\.00 m off, and the filter states σ (0\.23) m"),
        (r"error, so its σ is (0\.32) m", "run", r"one measurement: σ (0\.32) m"),
        (r"the gain ends at (0\.546)", "gains", r"known start: .* (0\.546); within"),
        (r"an error of (0\.17) m where", "start", r"(?m)^1 +0\.05 +(0\.17) "),
        (r"where (0\.05) m was possible", "start", r"(?m)^1 +(0\.05) "),
        (r"it is off by (6) m", "start", r"(?m)^1 .* (6)\.42$"),
        (r"Of its 36 entries (24) are zero", "picture", r"(24) of 36 entries are zero"),
        (r"Of its (36) entries 24 are zero", "picture", r"24 of (36) entries are zero"),
        (r"takes (207) arithmetic operations", "operations", r"model B\) +(207)"),
        (r"207 arithmetic operations instead of (1660)\.", "operations", r"model A\) +(1660)"),
        (r"It takes (101) operations", "operations", r"as columns +(101)"),
        (r"and (2207) operations instead of 1660", "table3", r"LF A +2207 +(2207)"),
        (r"are (504) and 72 instead", "table3", r"JKLF B +484 +(504)"),
        (r"504 and (72) instead", "table3", r"JSSKLF B +64 +(72)"),
        (r"instead of (484) and 64", "table3", r"JKLF B +(484)"),
        (r"instead of 484 and (64)", "table3", r"JSSKLF B +(64)"),
        (r"three axes it takes (30) operations\.", "table3", r"SSKF B +30 +(30)"),
    ],
)
def test_a_number_of_the_article_is_printed_by_a_cell(said, id, computed):
    (number,) = re.findall(said, TEXT)
    assert re.search(computed, printed_by(id))[1] == number


def test_one_second_of_the_filter_comes_out_by_hand(settled):
    """The circle of predict, weigh, correct, with the digits that the article prints and no others."""
    P, K = settled
    says(r"\begin{bmatrix} 0.0546 & 0.0213 \\ 0.0213 & 0.0206 \end{bmatrix}")
    np.testing.assert_array_equal(P.round(4), [[0.0546, 0.0213], [0.0213, 0.0206]])
    says("0.0546 + 2 · 0.0213 + 0.0206, from the unknown velocity, and 0.0025 from the random change: 0.120 m²")
    assert article.AXIS.Q[0, 0] == pytest.approx(0.0025)
    assert round(0.0546 + 2 * 0.0213 + 0.0206 + 0.0025, 3) == 0.120
    assert round(F[0] @ P @ F[0] + article.AXIS.Q[0, 0], 3) == 0.120
    says("0.120 / (0.120 + 0.1) = 0.545 (with more digits 0.546)")
    assert round(0.120 / (0.120 + 0.1), 3) == 0.545
    assert K[0, 0].round(3) == 0.546
    says("The position moves by 0.546 of the surprise.")
    says("the velocity moves too, by 0.213 of it")
    assert K[1, 0].round(3) == 0.213
    says("(1 - 0.545) · 0.120 = 0.0546 m²")
    assert round((1 - 0.545) * 0.120, 4) == 0.0546


def test_the_model_of_the_article_is_the_papers_but_for_H():
    says("All four are the paper's but for $H$.")
    for name in "FQR":
        np.testing.assert_allclose(getattr(article.AXIS, name), getattr(article.PAPER, name))
    assert article.AXIS.H.tolist() == [[1, 0]]
    assert article.PAPER.H.tolist() == [[1, 1]]
    np.testing.assert_allclose(article.AXIS.Q, 0.01 * G @ G.T)
    says("variance 0.01 m²/s²")
    says("changes by 0.1 m/s each second")  # the root of that variance


def test_the_filter_that_is_taught_is_that_of_the_package(taught):
    rng = np.random.default_rng(3)
    model = mpt.stack(*[article.AXIS] * 3)
    _, z = mpt.simulate(model, 50, rng)
    X, P = np.zeros((2, 3)), np.zeros((2, 2))
    for z_k in z:
        X, P = taught["step"](X, P, z_k)
    big = mpt.KalmanFilter(model)
    np.testing.assert_allclose(X.T.ravel(), big.filter(z)[-1], atol=1e-12)
    np.testing.assert_allclose(np.kron(np.eye(3), P), big.covariances(50)[-1], atol=1e-12)


def test_the_filter_with_gaps_serves_axes_with_noises_of_their_own(taught):
    rng = np.random.default_rng(4)
    variances = np.array([0.1, 0.2, 0.9])
    axes = [mpt.LinearModel(F=F, H=[[1, 0]], Q=article.AXIS.Q, R=[[each]]) for each in variances]
    model = mpt.stack(*axes)
    _, z = mpt.simulate(model, 50, rng)
    z[rng.random(z.shape) < 0.3] = np.nan
    X, P = np.zeros((3, 2, 1)), np.zeros((3, 2, 2))
    for z_k in z:
        X, P = taught["step_with_gaps"](X, P, z_k, r=variances[:, None, None])
    e = mpt.KalmanFilter(model).estimates(z)
    np.testing.assert_allclose(X.ravel(), e.x[-1], atol=1e-12)
    for i in range(3):
        np.testing.assert_allclose(P[i], e.P[-1][2 * i : 2 * i + 2, 2 * i : 2 * i + 2], atol=1e-12)


def test_the_package_filters_axes_with_gaps_as_tracks_of_their_own():
    """As the article says: the NaN is all that changes."""
    says("`mpt.KalmanFilter(axis).estimates(z[:, None, :])` returns the estimates and each axis' own $P$.")
    model = mpt.stack(*[article.AXIS] * 3)
    _, z = mpt.simulate(model, 60, np.random.default_rng(5))
    z[30:, 2] = np.nan
    own, big = mpt.KalmanFilter(article.AXIS).estimates(z[:, None, :]), mpt.KalmanFilter(model).estimates(z)
    np.testing.assert_allclose(own.x.transpose(0, 2, 1).reshape(60, 6), big.x, atol=1e-12)
    np.testing.assert_allclose(own.P[-1, :, :, 2], big.P[-1][4:, 4:], atol=1e-12)


def test_the_parts_of_the_lost_metres_are_those_of_the_recursion(settled):
    """Without their formula: the covariance predicted thirty times, from all of P, from each part of it and from Q."""
    P, _ = settled

    def predicted(P, Q):
        for _ in range(30):
            P = F @ P @ F.T + Q
        return P[0, 0]

    one = np.zeros((2, 2))
    known, moving, together = (one.copy() for _ in range(3))
    known[0, 0], moving[1, 1] = P[0, 0], P[1, 1]
    together[0, 1] = together[1, 0] = P[0, 1]
    parts = [predicted(each, one) for each in (known, moving, together)] + [predicted(one, article.AXIS.Q)]
    assert re.findall(r"(?m)^ *([\d.]+) m²", printed_by("parts")) == [f"{each:.3f}" for each in [*parts, sum(parts)]]
    says("had the filter known position and velocity exactly at the last measurement, σ would still be 9.5 m")
    assert f"{np.sqrt(parts[-1]):.1f}" == "9.5"
    says("If yours is twice as restless, 9.5 becomes 19 m.")
    assert f"{np.sqrt(predicted(one, 4 * article.AXIS.Q)):.0f}" == "19"


def test_silence_lasts_as_long_as_the_advice_says():
    (seconds, metres) = re.findall(r"In our example that is (\d+) seconds if you need (\d+) m", TEXT)[0]
    assert article.sigma_after(int(seconds)) < int(metres) < article.sigma_after(int(seconds) + 1)


def test_the_phones_that_are_drawn_stay_within_what_the_filter_states():
    says("nearly all phones stay within twice that")
    says("Thirty phones are followed for a minute. After thirty seconds")
    errors, sigma = article.silent_phones()
    assert errors.shape == (60, 3, 30)
    assert sigma[-1, 2] == pytest.approx(article.sigma_after(30), rel=1e-6)
    np.testing.assert_allclose(sigma[-1, :2], sigma[29, 2], rtol=1e-6)
    within = np.abs(errors) < 2 * sigma[:, :, None]
    assert within[-1, 2].mean() > 0.9  # 95 % of 30 phones are 28.5
    assert within.mean() == pytest.approx(0.95, abs=0.03)


def test_the_blocks_of_the_drawn_covariance_are_equal():
    P = article.covariance()
    np.testing.assert_array_equal(P != 0, np.kron(np.eye(3), np.ones((2, 2))) != 0)
    for i in (2, 4):
        np.testing.assert_allclose(P[i : i + 2, i : i + 2], P[:2, :2], rtol=1e-12)


def test_the_operations_are_taken_apart_as_the_article_says():
    says("by its table the three small ones need an eighth of the arithmetic")
    small, big = burden.total(burden.kalman(2, 1)), burden.total(burden.kalman(6, 3))
    assert 3 * small / big == pytest.approx(1 / 8, rel=0.01)
    says("Of the 69 operations of one small filter, 53 make $P$ and $K$ and 16 move the estimate")
    says("Three filters take 3 · 69 = 207, and one that shares takes 53 + 3 · 16 = 101.")
    two = burden.total(burden.kalman_columns(2, 1, axes=2))
    assert (small, 2 * small - two, two - small) == (69, 53, 16)
    assert burden.total(burden.kalman_columns(2, 1, axes=3)) == 53 + 3 * 16 == 101
    assert burden.total(burden.kalman_columns(2, 1, axes=1)) == small
    says("To multiply two n × n matrices takes about $2n^3$ operations.")
    assert burden.product(6, 6, 6) == 2 * 6**3 - 6**2
    says("each product of the big filter costs 27 times as much, and three small filters need three of the small ones")
    assert (6 / 2) ** 3 == 27 == 3 * 9


# Measured twice, under other loads, the ratios differed by up to 12 %. A quarter leaves room for that and for the
# rounding of the words; no other word ("three times", "half") would fit.
WORDS = 0.25


@pytest.mark.parametrize(
    ("text", "name", "kind", "ratio"),
    [
        ("the three small filters take about twice as long as the big one", "three filters of two states", "one", 2),
        ("about three quarters of the time of the big filter", "axes as columns, one P and K", "one", 3 / 4),
        ("`step_with_gaps`, takes about as long as the big filter", "axes stacked, a P for each", "one", 1),
        ("take about a tenth of the time of the big one", "three filters of two states", "many", 1 / 10),
        ("and the columns about a thirtieth", "axes as columns, one P and K", "many", 1 / 30),
    ],
)
def test_the_clock_of_the_article_is_the_measured_one(text, name, kind, ratio):
    says(text)
    assert CLOCK[name][kind] == pytest.approx(ratio, rel=WORDS)


def test_more_than_half_of_the_gain_is_lost_without_the_division():
    says("With `np.linalg.inv` in its place, more than half of that advantage is lost.")
    divided, inverted = (CLOCK[f"axes as columns, one P and K{how}"]["one"] for how in ("", ", by `inv`"))
    assert 1 - inverted < (1 - divided) / 2


def test_a_call_takes_as_long_for_large_matrices_as_for_small_ones():
    says("numpy needs about the same time for a call, whether the matrices are 2 × 2 or 6 × 6")
    large, small = (CLOCK[f"constant gain: {name}"]["one"] for name in ("one filter of six states", "axes as columns"))
    assert large == pytest.approx(small, rel=WORDS)


def test_the_columns_are_the_fastest_and_three_filters_the_slowest():
    says("in numpy it is the fastest of the three. (Three separate small filters are the slowest there")
    names = ("axes as columns, one P and K", "one filter of six states", "three filters of two states")
    assert sorted(names, key=lambda name: CLOCK[name]["one"]) == list(names)


def test_the_operations_of_the_table_of_times_are_those_of_the_article(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import three_axes

    assert {name: each["operations"] for name, each in CLOCK.items()} == three_axes.operations()
    three_axes.agree(1e-12)
    sums = {name: each() for name, each in three_axes.many_phones(phones=5).items()}
    x, P = sums["one filter of six states"]
    columns = sums["axes as columns, one P and K"]
    assert x.shape == (6, 1, 5)
    assert columns[0].shape == (2, 3, 5)
    for i, (x_of_axis, _) in enumerate(sums["three filters of two states"]):
        np.testing.assert_allclose(columns[0][:, [i]], x_of_axis, atol=1e-12)
    np.testing.assert_allclose(columns[1], P[:2, :2], atol=1e-12)


def test_the_gain_settles_when_the_article_says():
    says("From both starts the gain ends at 0.546, within ten seconds.")
    assert [int(each) < 10 for each in re.findall(r"within 1 % from second (\d+)", printed_by("gains"))] == [True, True]
    says("takes some twenty seconds to forget that")
    says("After five seconds nothing is left of that.")
    rows = {row.split()[0]: row.split()[1:] for row in printed_by("start").splitlines()[1:]}
    assert rows["5"][0] == rows["5"][1]
    assert rows["10"][2] != rows["10"][3]
    assert rows["20"][2] == rows["20"][3]


def test_the_varying_gain_loses_nothing():
    """Frozen when it has stopped, from either start: then the covariance moves no more."""
    says("You lose nothing from any start.")
    for variance in (0.0, 100.0):
        model = mpt.LinearModel(F=F, H=[[1, 0]], Q=article.AXIS.Q, R=[[0.1]], P0=variance * np.eye(2))
        settled = mpt.SteadyStateFilter.from_kalman(model).P
        np.testing.assert_allclose(mpt.KalmanFilter(model).covariances(60)[-1], settled, atol=1e-9)


def test_an_error_that_axes_share_costs_a_few_percent_and_no_honesty():
    says("For correlated errors alone it gains a few percent.")
    percent = [int(each) for each in re.findall(r"(\d+) %", printed_by("linked"))]
    assert percent == [1, 2, 4, 9]
    says("The σ that each small filter states stays true")
    two = np.eye(2)
    R = 0.1 * np.array([[1, 0.9], [0.9, 1]])
    F2, H2, Q2 = (np.kron(two, each) for each in (F, article.AXIS.H, article.AXIS.Q))
    linked = mpt.LinearModel(F=F2, H=H2, Q=Q2, R=R)
    small = mpt.SteadyStateFilter.from_kalman(article.AXIS)
    apart = mpt.SteadyStateFilter.from_kalman(mpt.LinearModel(F=F2, H=H2, Q=Q2, R=0.1 * two))
    true = mpt.metrics.error_moments(apart, linked, 200).covariance[-1]
    np.testing.assert_allclose(true[:2, :2], small.P, rtol=1e-9)


def test_the_counts_are_those_of_the_table():
    says("ten of the twelve counts in its table")
    rows = [row.split() for row in printed_by("table3").splitlines()[1:]]
    assert len(rows) == 12
    assert sum(row[2] == row[3] for row in rows) == 10


EXERCISE_1 = "seconds = None  # yours"
EXERCISE_2 = "    return None  # yours: x and P one second later"
KALMAN = """\
    x, P = F @ x, F @ P @ F.T + Q
    K = P @ H.T / (H @ P @ H.T + r)
    return x + K[:, 0] * (z - H @ x), P - K @ H @ P"""


@pytest.mark.parametrize(
    ("id", "placeholder", "answer", "said"),
    [
        ("exercise-silence", EXERCISE_1, EXERCISE_1, "not yet"),
        ("exercise-silence", EXERCISE_1, "seconds = 5", "right: after 5 s of silence σ is 1.09 m, a second before"),
        ("exercise-silence", EXERCISE_1, "seconds = 4", "after 4 s of silence σ is 0.87 m. It passes 1 m later."),
        ("exercise-silence", EXERCISE_1, "seconds = 6", "after 6 s of silence σ is 1.33 m. It passed 1 m earlier."),
        ("exercise-step", EXERCISE_2, EXERCISE_2, "not yet"),
        ("exercise-step", EXERCISE_2, KALMAN, "right: x and P"),
        ("exercise-step", EXERCISE_2, KALMAN.replace(" + Q", ""), "x should be [1.690 0.596], yours is [1.690 0.59"),
        ("exercise-step", EXERCISE_2, KALMAN.replace("P - K @ H @ P", "P"), "Your x is right."),
        ("exercise-step", EXERCISE_2, KALMAN.replace("K[:, 0] *", "K *"), "x should have the shape (2,), yours has"),
    ],
)
def test_an_exercise_says_what_was_expected(taught, capsys, id, placeholder, answer, said):
    cell = source(CELLS[id])
    assert cell.count(placeholder) == 1
    exec(cell.replace(placeholder, answer), dict(taught) | {"article": article})
    assert said in capsys.readouterr().out


# Numbers of Part I that no cell prints, with the test or the reason.
ELSEWHERE = {
    *("0.0546", "0.0213", "0.0206", "0.0025", "0.120", "0.545", "0.213", "0.1"),  # one second, by hand
    *("0.01", "100", "0.5", "1.5", "2.5", "2.0"),  # inputs: noises, starts, the walk, half seconds
    *("9.5", "19"),  # the lost metres, taken apart
    *("69", "53", "16", "27"),  # operations, taken apart
    *("2014", "2015"),  # years
    *("20,000", "1e-12"),  # lengths and limits of the cells
    "10",  # sigma of the unknown start, the root of 100; and 10.5 m in round metres
}


def test_no_number_of_the_article_is_untested():
    """Each of two digits or more is printed by a cell, or listed above."""
    outputs = " ".join(map(printed_by, (id for id, cell in CELLS.items() if cell["cell_type"] == "code")))
    known = set(re.findall(r"\d+(?:\.\d+)?(?:e-?\d+)?", outputs)) | ELSEWHERE
    prose = re.sub(r"\]\([^)]*\)", "]", TEXT)  # links
    said = re.findall(r"(?<![\w.])\d+(?:[.,]\d+)*(?:e-?\d+)?", prose)
    untested = {each for each in said if len(each) > 1 and each not in known}
    assert untested == set()
