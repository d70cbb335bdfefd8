"""The article on 2015: every number in its prose is printed by a cell or computed here, and what it teaches runs."""

import json
import re

import numpy as np
import pytest
from conftest import ROOT, shown
from reading import Article

import mpt_helpers as mpt
from mpt_helpers import tracks
from reproduction import burden
from reproduction.papers_2014_2015 import article_2015 as article

ARTICLE = Article("2015_mpt_3d")
says, adds, code_of, printed_by = ARTICLE.says, ARTICLE.adds, ARTICLE.code_of, ARTICLE.printed_by
CLOCK = {
    each["name"]: each
    for each in json.loads((ROOT / "benchmarks" / "results.json").read_text(encoding="utf-8"))["three axes"]
}
F, G = article.AXIS.F, np.array([[0.5], [1.0]])


@pytest.fixture(scope="module")
def taught():
    """The names that the teaching cells of Part I define: step and step_with_gaps, F, H, Q, r."""
    names = {}
    exec(code_of("filter"), names)
    exec(code_of("step-gaps").partition("\nX_own, P_own")[0], names)
    return names


@pytest.fixture(scope="module")
def settled():
    """P and K of the settled filter."""
    steady = mpt.SteadyStateFilter.from_kalman(article.AXIS)
    return steady.P, steady.B


@pytest.mark.parametrize(
    ("said", "id", "computed"),
    [
        (r"knows its height to (0\.23) m\.", "run", r"states σ (0\.23)4 m"),
        (r"still states (0\.234) m", "run", r"states σ (0\.234) m"),
        (r"silence turn 0\.23 m into (10\.5) m", "parts", r"so σ = (10\.5) m  in all"),
        (r"silence turn (0\.23) m into 10\.5 m", "run", r"states σ (0\.23)4 m"),
        (r"after the last measurement it knows it to (10\.5) m", "parts", r"so σ = (10\.5) m  in all"),
        (r"the last measurement, σ would be (9\.5) m", "parts", r"so σ = +(9\.5) m  from what has changed"),
        (r"These are the (10\.5) m and", "parts", r"so σ = (10\.5) m  in all"),
        (r"10\.5 m and the (0\.32) m from above", "step-gaps", r"measured again \(m\): +\[0\.23 0\.23 (0\.32)\]"),
        (r"first position is wrong by (4\.98) m \(σ\)\.", "missed", r"(?m)^30 +0\.32 +(4\.98)$"),
        (r"but for the (0\.32) m of a single measurement", "missed", r"(?m)^30 +(0\.32) +4\.98$"),
        (r"it puts a walker (1\.5) m behind", "ramp", r"(1\.5)0 m late"),
        (r"behind, and states an error of (0\.17) m", "ramp", r"1\.50 m late, and the filter states σ (0\.17) m"),
        (r"and is wrong by (0\.333) m", "lasting", r"(?m)^0\.9 +(0\.333)$"),
        (r"error, so its σ is (0\.32) m", "missed", r"(?m)^30 +(0\.32) "),
        (r"seconds it knows it to (4\.4) m instead of", "silent-links", r"(?m)^linked changes, 0\.9 +(4\.4) +4\.4$"),
        (r"4\.4 m instead of (10\.5) m", "silent-links", r"(?m)^nothing linked +(10\.5) +10\.5$"),
        (r"and still states (4\.4) m", "silent-links", r"(?m)^linked changes, 0\.9, height .* (4\.4) +20\.3$"),
        (r"is wrong by (20) m and still", "silent-links", r"(?m)^linked changes, 0\.9, height .* 4\.4 +(20)\.3$"),
        (r"a position has a σ that is (10) % larger", "linked", r"(?m)^0\.9 +1 : 1 : 1 +7 % +14 % +(10) % +11 %$"),
        (r"the share (0\.546) of the way", "freeze", r"with the gains (0\.546) and"),
        (r"model A\) \| (1660) \| 1 \|", "table3", r"KF A +1660 +(1660)"),
        (r"model B\) \| (207) \| 2 \|", "table3", r"KF B +207 +(207)"),
        (r"That leaves the paper's (30) operations", "table3", r"SSKF B +30 +(30)"),
        (r"axes as columns, frozen \| (30) \|", "table3", r"SSKF B +30 +(30)"),
        (r"Together, (1660) operations a step become 30", "table3", r"KF A +1660 +(1660)"),
        (r"1660 operations a step become (30)\.", "table3", r"SSKF B +30 +(30)"),
        (r"Of (1660) operations a step, 101", "table3", r"KF A +1660 +(1660)"),
    ],
)
def test_a_number_of_the_article_is_printed_by_a_cell(said, id, computed):
    (number,) = re.findall(said, ARTICLE.text)
    assert re.search(computed, printed_by(id))[1] == number


@pytest.mark.parametrize(
    ("said", "computed"),
    [
        (r"(504) and 72 are right", r"JKLF B +484 +(504)"),
        (r"504 and (72) are right", r"JSSKLF B +64 +(72)"),
        (r"prints (484) and 64", r"JKLF B +(484)"),
        (r"prints 484 and (64)", r"JSSKLF B +(64)"),
    ],
)
def test_a_slip_that_part_two_names_is_printed_by_its_table(said, computed):
    (number,) = re.findall(said, ARTICLE.evidence)
    assert re.search(computed, printed_by("table3"))[1] == number


def test_one_second_of_the_filter_comes_out_by_hand(settled):
    """The circle of predict, weigh, correct, with the digits that the article prints and no others."""
    P, K = settled
    says(r"\begin{bmatrix} 0.0546 & 0.0213 \\ 0.0213 & 0.0206 \end{bmatrix}")
    np.testing.assert_array_equal(P.round(4), [[0.0546, 0.0213], [0.0213, 0.0206]])
    says(r"$0.01\,GG^T=\begin{bmatrix}0.0025&0.005\\0.005&0.01\end{bmatrix}$")
    np.testing.assert_allclose(article.AXIS.Q, [[0.0025, 0.005], [0.005, 0.01]])
    says(r"$$FPF^T = \begin{bmatrix} 0.1179 & 0.0419 \\ 0.0419 & 0.0206 \end{bmatrix}$$")
    says(r"$$FPF^T + Q = \begin{bmatrix} 0.1204 & 0.0469 \\ 0.0469 & 0.0306 \end{bmatrix}$$")
    moved, with_changes = [[0.1179, 0.0419], [0.0419, 0.0206]], [[0.1204, 0.0469], [0.0469, 0.0306]]
    np.testing.assert_array_equal((F @ P @ F.T).round(4), moved)
    predicted = F @ P @ F.T + article.AXIS.Q
    np.testing.assert_array_equal(predicted.round(4), with_changes)
    says("The new error of the position is the old one, plus a second of the velocity's. So, but for rounding,")
    by_hand = (F @ P.round(4) @ F.T).round(4)
    np.testing.assert_array_equal((moved - by_hand).round(4), [[1e-4, 0], [0, 0]])
    says("The position's variance has more than doubled. Most of what came, 2 · 0.0213, is there because the two")
    says("Another 0.0206 is there because the velocity is not quite known.")
    says("Only 0.0025 came because the velocity changed.")
    assert predicted[0, 0] > 2 * P[0, 0]
    came = [2 * P[0, 1], P[1, 1], article.AXIS.Q[0, 0]]
    np.testing.assert_allclose(came, [2 * 0.0213, 0.0206, 0.0025], atol=1e-4)
    assert came[0] > sum(came) / 2
    assert sum(came) == pytest.approx(predicted[0, 0] - P[0, 0], rel=1e-9)
    says("0.1204 / (0.1204 + 0.1) = 0.546")
    assert round(0.1204 / (0.1204 + 0.1), 3) == 0.546 == K[0, 0].round(3)
    says("0.0469 / 0.2204 = 0.213")
    assert round(0.1204 + 0.1, 4) == 0.2204
    assert round(0.0469 / 0.2204, 3) == 0.213 == K[1, 0].round(3)
    says("Say you are measured one metre further east than predicted. Then the filter moves you 0.546 m to the east.")
    says("It also thinks you 0.213 m/s faster")
    np.testing.assert_array_equal((K @ [[1.0]])[:, 0].round(3), [0.546, 0.213])
    says("the share $1 - K$ is left, which is 0.1 / 0.2204. Now 0.1204 · 0.1 / 0.2204 = 0.0546 m².")
    assert round(0.1204 * 0.1 / 0.2204, 4) == 0.0546
    assert 1 - K[0, 0] == pytest.approx(0.1 / 0.2204, abs=1e-4)
    says("`P @ H.T` holds the numerators of the two gains, and `H @ P @ H.T + r` is their denominator")
    np.testing.assert_allclose(predicted @ article.AXIS.H.T, predicted[:, [0]])
    np.testing.assert_allclose(predicted[:, [0]] / (predicted[0, 0] + 0.1), K, rtol=1e-9)
    says("what the measurement left is 0.1204 · 0.1 / 0.2204, and the gain is 0.1204 / 0.2204.")
    assert round(0.1 * 0.546, 4) == 0.0546
    np.testing.assert_allclose(P[:, [0]] / 0.1, K, rtol=1e-9)


def test_a_filter_frozen_from_the_first_second_begins_hundreds_of_metres_off(settled):
    """By hand from 1000 m, and sigma by the recursion of its covariance, from 1 km and 2 m/s: without the module."""
    says("A filter that is frozen too early can begin hundreds of metres off.")
    says("Say you stand 1000 m from where the filter starts, and the first measurement says so.")
    says("It leaves you 454 m short.")
    _, K = settled
    assert round(1000 * (1 - K[0, 0])) == 454 == round(1000 * (1 - 0.546))
    says("it is 1,000,000 / (1,000,000 + 0.1), and takes you there")
    says("in the fifth second it is 138 m past you. From the 25th second on the two are equally good.")
    off = np.array([[1000.0], [0.0]])
    for _ in range(5):
        off = (np.eye(2) - K @ article.AXIS.H) @ F @ off
    assert round(off[0, 0]) == -138
    P = frozen = np.diag([1e6, 4.0])
    left, sigmas, ratios = np.eye(2) - K @ article.AXIS.H, [], []
    for _ in range(60):
        P, frozen = (F @ each @ F.T + article.AXIS.Q for each in (P, frozen))
        gain = P[:, [0]] / (P[0, 0] + 0.1)
        if not ratios:
            assert gain[0, 0] == pytest.approx(1e6 / (1e6 + 0.1), rel=1e-9)
        P, frozen = P - gain @ P[[0]], left @ frozen @ left.T + 0.1 * K @ K.T
        sigmas.append(np.sqrt(frozen[0, 0]))
        ratios.append(np.sqrt(frozen[0, 0] / P[0, 0]))
    assert ratios[23] > 1.01
    assert max(ratios[24:]) < 1.01
    for k in (1, 10, 24, 25):
        line = f"unknown to 1 km and 2 m/s: {sigmas[k - 1]:.2f} m in second {k}, {ratios[k - 1]:.4g} times the best"
        assert line in printed_by("start")


def test_the_model_of_the_article_is_the_papers_but_for_H():
    says("The numbers are the paper's, read in metres and seconds. Only $H$ is ours")
    says("the position gets half of it")
    np.testing.assert_array_equal(G[:, 0], [0.5, 1])
    for name in "FQR":
        np.testing.assert_allclose(getattr(article.AXIS, name), getattr(article.PAPER, name))
    assert article.AXIS.H.tolist() == [[1, 0]]
    assert article.PAPER.H.tolist() == [[1, 1]]
    np.testing.assert_allclose(article.AXIS.Q, 0.01 * G @ G.T)
    says("a variance of 0.01 m²/s²")
    says("each second the velocity also changes at random, by 0.1 m/s (σ)")


def test_the_filters_that_should_agree_do():
    says("with all the filters of the paper, and they agree where it says that they do")
    for group in ("time-invariant", "steady state"):
        assert f"{group}, models A and B: x and P agree to below 1e-12" in printed_by("implementations")


def test_the_filter_that_is_taught_is_that_of_the_package(taught):
    rng = np.random.default_rng(3)
    model = mpt.stack(*[article.AXIS] * 3)
    _, z = mpt.simulate(model, 50, rng)
    X, P = np.zeros((2, 3)), np.zeros((2, 2))
    says("The estimates of `step` and of the big filter are the same, but for rounding.")
    big = mpt.KalmanFilter(model).estimates(z)
    for z_k, x_big, P_big in zip(z, big.x, big.P, strict=True):
        X, P = taught["step"](X, P, z_k)
        np.testing.assert_allclose(X.T.ravel(), x_big, rtol=0, atol=1e-12)
        np.testing.assert_allclose(np.kron(np.eye(3), P), P_big, rtol=0, atol=1e-12)


@pytest.mark.parametrize("shape", [(3,), (3, 1, 1)])
def test_the_filter_with_gaps_serves_axes_with_noises_of_their_own(taught, shape):
    says("If measurements are missing, or each axis has a noise of its own: take `step_with_gaps`")
    says("So does one with a noise of its own")
    rng = np.random.default_rng(4)
    variances = np.array([0.1, 0.2, 0.9])
    axes = [mpt.LinearModel(F=F, H=[[1, 0]], Q=article.AXIS.Q, R=[[each]]) for each in variances]
    model = mpt.stack(*axes)
    _, z = mpt.simulate(model, 50, rng)
    z[rng.random(z.shape) < 0.3] = np.nan
    X, P = np.zeros((3, 2, 1)), np.zeros((3, 2, 2))
    for z_k in z:
        X, P = taught["step_with_gaps"](X, P, list(z_k), r=variances.reshape(shape))
    e = mpt.KalmanFilter(model).estimates(z)
    np.testing.assert_allclose(X.ravel(), e.x[-1], atol=1e-12)
    for i in range(3):
        np.testing.assert_allclose(P[i], e.P[-1][2 * i : 2 * i + 2, 2 * i : 2 * i + 2], atol=1e-12)


def test_the_split_does_not_need_that_all_axes_are_measured_but_sharing_does(taught):
    """The split with gaps is held above; here the P of a silent axis, that is another one and grows without rest."""
    says("(The paper asks that all three axes be measured. The split alone does not need it; the sharing does.)")
    says("| 207 | 2 | nothing links the axes: no entry between two of them in $F$, in $Q$, in $H$,")
    says("the same first $P$, and are measured at the same seconds")
    says("the gain has settled, and from then on no measurement is missed and nothing in the model changes")
    X, P = np.zeros((3, 2, 1)), np.stack([np.eye(2)] * 3)
    for _ in range(200):
        before = P
        X, P = taught["step_with_gaps"](X, P, [0.0, 0.0, np.nan])
        assert (P[2] > before[2])[0, 0]
        assert (P[2] > before[2])[1, 1]
    assert not np.allclose(P[2], P[0])
    np.testing.assert_allclose(P[0], before[0], rtol=1e-9)


def test_a_missed_measurement_stays_in_its_column_of_the_shared_filter(taught):
    says("(In `step` a single NaN would spoil its column for ever.)")
    X, P = taught["step"](np.zeros((2, 3)), np.eye(2), np.array([1.0, np.nan, 1.0]))
    X, _ = taught["step"](X, P, np.ones(3))
    np.testing.assert_array_equal(np.isnan(X), [[False, True, False]] * 2)


def test_the_first_measurement_sets_the_position_of_an_unknown_start(taught, settled):
    """Up to a kilometre off, with both filters; where an axis is silent at first, as soon as it is measured."""
    says("Begin with $X = 0$ and a large $P$. Here σ is 1 km for the position and 2 m/s for the velocity")
    says("begin as above, with a $P$ of `np.diag([1e6, 4.0])`")
    says("For a car write 900 instead of 4, which is 30 m/s.")
    assert np.sqrt(900) == 30
    unknown = np.diag([1e6, 4.0])
    np.testing.assert_array_equal(np.sqrt(np.diag(unknown)), [1000, 2])
    z = np.array([1000.0, -300.0, np.nan])
    X, P = taught["step"](np.zeros((2, 3)), unknown, z)
    np.testing.assert_allclose(X[0, :2], z[:2], atol=1e-3)
    assert np.sqrt(P[0, 0]) == pytest.approx(np.sqrt(0.1), rel=1e-6)
    X, P = taught["step_with_gaps"](np.zeros((3, 2, 1)), np.stack([unknown] * 3), z)
    np.testing.assert_allclose(X[:2, 0, 0], z[:2], atol=1e-3)
    for _ in range(20):
        X, P = taught["step_with_gaps"](X, P, np.array([1000.0, -300.0, np.nan]))
    X, P = taught["step_with_gaps"](X, P, np.array([1000.0, -300.0, 800.0]))
    assert X[2, 0, 0] == pytest.approx(800, abs=1e-3)
    for _ in range(60):
        X, P = taught["step_with_gaps"](X, P, z)
    np.testing.assert_allclose(P[0], settled[0], atol=1e-9)


def ready_made(z=None):
    """What the ready-made lines of Part II define, for measurements z (seconds, 3) if given, not its example's."""
    names = {"np": np, "mpt": mpt, "axis": article.PAPER}  # Part II's axis has the paper's H
    block = code_of("ready")
    if z is not None:
        line = re.search(r"(?m)^recorded = .*\n", block)
        block = block.replace(line[0], "")
        names["recorded"] = z
    exec(block, names)
    return names


def test_the_ready_made_lines_run_from_top_to_bottom():
    """As they stand, with the example data that they bring."""
    adds("Leave `P0` out only if the phone starts at zero and at rest.")
    assert mpt.LinearModel(F=F, H=[[1, 0]], Q=article.AXIS.Q, R=[[0.1]]) == article.started(np.zeros((2, 2)))
    names = ready_made()
    assert names["apart"].shape == (60, 2, 3)
    assert names["together"].shape == (60, 6)
    assert np.abs(names["apart"][-1, 0]).max() < 1  # a phone at rest at zero
    assert np.abs(names["together"][-1, ::2] - names["apart"][-1, 0]).max() < 0.5
    np.testing.assert_array_equal(names["C"], article.correlated(3, 0.9))


def test_the_package_filters_axes_with_gaps_as_tracks_of_their_own():
    """The lines of Part II, with missed measurements as NaN, from an unknown start: a P for each axis."""
    adds("gives each axis a $P$ of its own, as `step_with_gaps` does, and NaN is a missed measurement")
    names = ready_made(np.full((20, 3), 100.0))  # phones that stand far from zero
    np.testing.assert_allclose(names["apart"][:, 0], 100, atol=0.01)
    axis = names["small"]
    assert axis == article.started(np.diag([1e6, 4.0]))
    model = mpt.stack(*[axis] * 3)
    _, z = mpt.simulate(mpt.stack(*[article.AXIS] * 3), 60, np.random.default_rng(5))
    z[30:, 2] = np.nan
    apart = ready_made(z)["apart"]
    np.testing.assert_allclose(apart.transpose(0, 2, 1).reshape(60, 6), mpt.KalmanFilter(model).filter(z), atol=1e-9)
    own, big = mpt.KalmanFilter(axis).estimates(z[:, None, :]), mpt.KalmanFilter(model).estimates(z)
    np.testing.assert_allclose(own.P[-1, :, :, 2], big.P[-1][4:, 4:], rtol=1e-9)


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
    sources = [sum(parts[:3]), parts[3], sum(parts)]
    assert re.findall(r"(?m)^ *([\d.]+) m²", printed_by("parts")) == [f"{each:.1f}" for each in sources]
    assert re.findall(r"σ = +([\d.]+) m", printed_by("parts")) == [f"{np.sqrt(each):.1f}" for each in sources]
    says("The variances add up, not the metres. Here the second source is the larger one.")
    assert parts[3] > sum(parts[:3])
    says("mostly that of the velocity: its σ of 0.144 m/s makes 4.3 m in thirty seconds")
    assert round(np.sqrt(P[1, 1]), 3) == 0.144
    assert round(30 * 0.144, 1) == 4.3 == round(np.sqrt(parts[1]), 1)
    says("Even if the filter had known everything at the last measurement, σ would be 9.5 m.")


def test_the_phone_of_the_ride_is_lost_in_sixty_metres():
    """Measured, with the q and r that the guide fits: each axis, over the whole ride and over its second half."""
    says("the position predicted 30 seconds ahead was wrong by about 60 m on each axis (rms)")
    guide = (ROOT / "docs" / "by_hand.md").read_text(encoding="utf-8")
    (q,) = re.findall(r"(?m)^q = ([\d.]+) m²/s³ to \d+%$", guide)
    track = max(tracks.gpx(ROOT / "docs" / "tracks" / "ride.gpx", pause=600), key=lambda each: len(each.t))
    axis = mpt.constant_velocity(dt=1.0, q=float(q), r=0.01**2 / 12, P0=np.diag([10.0**2, 30.0**2]))
    ahead = mpt.metrics.ahead(mpt.KalmanFilter(mpt.stack(axis, axis), t=track.t), track.z, 30)
    for errors in (ahead.errors, ahead.errors[ahead.row >= len(track.t) // 2]):
        np.testing.assert_allclose(np.sqrt(np.mean(errors**2, axis=0)), 60, atol=5)


def test_the_phones_that_are_drawn_stay_within_what_the_filter_states():
    says("nearly all phones stay within twice its σ")
    says("Thirty phones like yours, all with a known start, are followed for a minute. After thirty seconds")
    errors, sigma = article.silent_phones()
    assert errors.shape == (60, 3, 30)
    assert sigma[-1, 2] == pytest.approx(article.sigma_after(30), rel=1e-6)
    np.testing.assert_allclose(sigma[-1, :2], sigma[29, 2], rtol=1e-6)
    within = np.abs(errors) < 2 * sigma[:, :, None]
    assert within[-1, 2].mean() > 0.9  # 95 % of 30 phones are 28.5
    assert within.mean() == pytest.approx(0.95, abs=0.03)


def test_the_curve_of_the_figure_is_labelled_with_what_it_reads():
    fig = article.draw_lost_axis()
    (far,) = (ax for ax in fig.axes if ax.texts)
    (label,) = (text for text in far.texts if "=" in text.get_text())
    assert label.get_text() == f"2σ = {2 * article.sigma_after(30):.0f} m"
    assert np.nanmax(far.lines[0].get_ydata()) == pytest.approx(2 * article.sigma_after(30), rel=1e-6)


def test_the_blocks_of_the_drawn_covariance_are_equal():
    P = article.covariance()
    np.testing.assert_array_equal(P != 0, np.kron(np.eye(3), np.ones((2, 2))) != 0)
    for i in (2, 4):
        np.testing.assert_allclose(P[i : i + 2, i : i + 2], P[:2, :2], rtol=1e-12)


def test_the_operations_are_taken_apart_as_the_article_says():
    says("The estimates stay the same, at an eighth of the arithmetic.")
    small, big = burden.total(burden.kalman(2, 1)), burden.total(burden.kalman(6, 3))
    assert 3 * small / big == pytest.approx(1 / 8, rel=0.01)
    adds("takes 69 operations, of which 53 make $P$ and $K$ and 16 move the estimate, $(I - KH)Fx + Kz$")
    adds("Three take 3 · 69 = 207. Axes as columns that share $P$ and $K$ take 53 + 3 · 16 = 101.")
    says("we counted the shared filter in the same way")
    says("axes as columns that share one $P$: our `step` | 101 | 0.7 |")
    says("Of 1660 operations a step, 101 are left.")
    two = burden.total(burden.kalman_columns(2, 1, axes=2))
    assert (small, 2 * small - two, two - small) == (69, 53, 16)
    assert burden.total(burden.kalman_columns(2, 1, axes=3)) == 53 + 3 * 16 == 101
    assert burden.total(burden.kalman_columns(2, 1, axes=1)) == small
    says("a product of two n × n matrices takes about $2n^3$ operations, so")
    assert burden.product(6, 6, 6) == 2 * 6**3 - 6**2
    says("one of the big filter costs 27 small ones, where three are needed.")
    assert (6 / 2) ** 3 == 27 == 3 * 9


# Measured twice, under other loads, the ratios differed by up to 12 %. A quarter leaves room for that and for the
# rounding of the words; no other word ("three times", "half") would fit.
WORDS = 0.25


@pytest.mark.parametrize(
    ("part", "text", "name", "kind", "ratio"),
    [
        (says, "one after the other (model B) | 207 | 2 |", "three filters of two states", "one", 2),
        (says, "share one $P$: our `step` | 101 | 0.7 |", "axes as columns, one P and K", "one", 0.7),
        (says, "axes as columns, frozen | 30 | 0.14 |", "constant gain: axes as columns", "one", 0.14),
        (adds, "Python loop, take about twice as long as the big one", "three filters of two states", "one", 2),
        (adds, "The frozen filter takes about a seventh", "constant gain: axes as columns", "one", 1 / 7),
        (adds, "filters take about a tenth of the time of the big one", "three filters of two states", "many", 1 / 10),
        (adds, "and the columns about a thirtieth", "axes as columns, one P and K", "many", 1 / 30),
    ],
)
def test_the_clock_of_the_article_is_the_measured_one(part, text, name, kind, ratio):
    part(text)
    assert CLOCK[name][kind] == pytest.approx(ratio, rel=WORDS)


def test_the_stack_takes_from_one_to_one_point_three_times_as_long_as_the_big_filter():
    """Measured at the lower end; the upper one leaves the room that every ratio has here."""
    adds("as `step_with_gaps`, takes 1 to 1.3 times as long as the big filter, which is timed with `np.linalg.inv`")
    measured = CLOCK["axes stacked, a P for each"]["one"]
    assert measured == pytest.approx(1, abs=0.1)
    assert measured * (1 + WORDS) == pytest.approx(1.3, abs=0.1)


def test_more_than_half_of_the_gain_is_lost_without_the_division():
    adds("With `np.linalg.inv` in its place more than half of the columns' advantage is lost.")
    divided, inverted = (CLOCK[f"axes as columns, one P and K{how}"]["one"] for how in ("", ", by `inv`"))
    assert 1 - inverted < (1 - divided) / 2


def test_lainiotis_is_cheaper_where_nearly_all_states_are_measured():
    """Up to six states: with one unmeasured it depends, with two or more Kalman is cheaper."""
    adds("LF is the cheaper one only where nearly all states are measured")
    says("Lainiotis's, gives the same estimates and costs more here")
    assert "6 states, 6 measured: KF 3086, LF 2279" in printed_by("speedups")
    sizes = [(n, m) for n in range(1, 7) for m in range(1, n + 1)]
    cheaper = [(n, m) for n, m in sizes if burden.total(burden.lainiotis(n, m)) < burden.total(burden.kalman(n, m))]
    assert all((n, n) in cheaper for n in range(1, 7))
    assert all(n - m <= 1 for n, m in cheaper)


def test_a_call_takes_nearly_as_long_for_large_matrices_as_for_small_ones():
    """With a constant gain a step is the same calls; three small filters make three times as many."""
    says("Three small filters have an eighth of the operations and take twice the time,")
    says("because for one phone a call of numpy costs more than what it computes")
    adds("three times as many calls, each only a little faster")
    large, small = (CLOCK[f"constant gain: {name}"]["one"] for name in ("one filter of six states", "axes as columns"))
    assert large == pytest.approx(small, rel=WORDS)
    assert 1 < 3 / CLOCK["three filters of two states"]["one"] < 3 / 2


def test_the_columns_are_the_fastest_and_three_filters_the_slowest():
    """Of the gains that vary; and the frozen filter is faster still, in operations as on the clock."""
    says("So in numpy let the axes share the calls, as `step` and `step_with_gaps` do.")
    constant, varies = (
        [name for name in CLOCK if ("constant gain" in name) == is_constant] for is_constant in (True, False)
    )
    for by in ("one", "operations"):
        least = min(varies, key=lambda name: CLOCK[name][by])
        assert least == "axes as columns, one P and K"
    assert CLOCK["constant gain: axes as columns"]["one"] < CLOCK["axes as columns, one P and K"]["one"]
    assert CLOCK["constant gain: axes as columns"]["operations"] == 30 < 101
    assert max(varies, key=lambda name: CLOCK[name]["one"]) == "three filters of two states"
    assert len(constant) == 3
    adds("With ten thousand phones side by side, each with a $P$ of its own, the three small")
    of_many = {name: each["many"] for name, each in CLOCK.items() if "many" in each}
    assert sorted(of_many, key=of_many.get) == sorted(of_many, key=lambda name: CLOCK[name]["operations"])
    assert of_many["three filters of two states"] < of_many["one filter of six states"]


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


def test_the_gain_settles_when_the_article_says(settled):
    """Both entries of K, from both starts; the limit is reached long before second 60."""
    adds("From which second on does $K$ stay within 1 % of its last value?")
    last_off = []
    for P0 in (np.zeros((2, 2)), np.diag([1e6, 4.0])):
        K = article.gains(P0, 60)
        np.testing.assert_allclose(K[-1], settled[1][:, 0], rtol=1e-6)
        off = np.abs(K / K[-1] - 1).max(axis=1)
        last_off.append(1 + int(np.flatnonzero(off > 0.01).max()))
    assert max(last_off) + 1 == 9
    slow = []
    for P in (np.zeros((2, 2)), np.diag([1e6, 4.0])):  # by the formulas of `step`, with r = 9
        K = []
        for _ in range(300):
            P = F @ P @ F.T + article.AXIS.Q
            K.append(P[:, 0] / (P[0, 0] + 9))
            P = P - np.outer(K[-1], P[0])
        slow.append(2 + int(np.flatnonzero(np.abs(np.array(K) / K[-1] - 1).max(axis=1) > 0.01).max()))
    assert max(slow) == 26
    of = article.measured_with(3.0)
    assert slow == [article.rests(article.gains(P0, 300, of)) for P0 in (np.zeros((2, 2)), np.diag([1e6, 4.0]))]
    assert re.search(rf"(?m)^3\.00 +{slow[0]} +{slow[1]} ", printed_by("rests"))
    assert re.search(r"(?m)^0\.32 +9 ", printed_by("rests"))


def test_the_constant_gain_costs_what_the_article_says():
    says("known to start at zero and at rest, where that costs little, and only in the first seconds")
    best, constant = article.sigma_of_both(np.zeros((2, 2)), 60)
    assert constant[3] > 1.01 * best[3]
    assert constant[4] == pytest.approx(best[4], rel=0.01)
    adds("With the paper's own H the known start costs about as much.")
    predicted = article.PAPER.Q  # of a known start
    S = (article.PAPER.H @ predicted @ article.PAPER.H.T).item() + 0.1
    K = predicted @ article.PAPER.H.T / S
    settled = mpt.SteadyStateFilter.from_kalman(article.PAPER).B
    after = []
    for gain in (K, settled):
        left = np.eye(2) - gain @ article.PAPER.H
        after.append(np.sqrt((left @ predicted @ left.T + 0.1 * gain @ gain.T)[0, 0]))
    assert "second 1: {:.3f} m with the gain that varies, {:.3f} m with the settled one".format(*after) in printed_by(
        "frozen"
    )


@pytest.mark.parametrize("sigma", [np.sqrt(0.1), 3.0])
def test_a_covariance_at_rest_has_a_settled_gain(taught, sigma):
    """By the lines of the article, with both sensors, from both starts and after a silence."""
    says("Call $P$ at rest when a second changes no entry of it by more than a thousandth")
    adds("The gain is then within 0.2 % of its last value, with either sensor and from either start.")
    start, block = code_of("freeze").partition("K = ")[0].split("\n", 1)
    assert start == "P, second, at_rest = np.diag([1e6, 4.0]), 0, False"
    step = taught["step"]

    def slow(X, P, z):
        return step(X, P, z, r=sigma**2)

    silent = np.zeros((2, 2))
    for _ in range(1000):
        _, silent = slow(np.zeros((2, 3)), silent, np.zeros(3))
    settled = silent[:, 0] / sigma**2
    for _ in range(30):
        silent = F @ silent @ F.T + article.AXIS.Q
    for P in (np.zeros((2, 2)), np.diag([1e6, 4.0]), silent):
        names = {"np": np, "step": slow, "P": P, "second": 0, "at_rest": False}
        exec(block, names)
        np.testing.assert_allclose(names["P"][:, 0] / sigma**2, settled, rtol=2e-3)


def test_the_frozen_filter_that_is_taught_is_the_packages(taught):
    """Its lines, with a P that has come to rest, and the line of the comment for each second."""
    block = re.search(r"K = .*\nA = .*\n", code_of("freeze"))[0]
    names = dict(taught) | {"P": article.covariance(200)[:2, :2], "X": np.zeros((2, 3))}
    exec(block, names)
    block = re.search(r"# from now on the whole filter is (X = .*)", code_of("freeze"))[1]
    _, z = mpt.simulate(mpt.stack(*[article.AXIS] * 3), 30, np.random.default_rng(11))
    for z_k in z:
        exec(block, names | {"z": z_k}, names)
    expected = mpt.SteadyStateFilter.from_kalman(article.AXIS).filter(z[:, None, :])[-1]
    np.testing.assert_allclose(names["X"], expected, atol=1e-9)


def test_the_frozen_filter_overshoots_from_a_wrong_start(taught):
    adds("a phone may stand 10 m from where the filters start")
    P = article.covariance(200)[:2, :2]
    K = P[:, 0] / 0.1
    frozen, steps = [np.zeros(2)], [np.zeros(2)]
    P = np.diag([1e6, 4.0])
    for _ in range(20):
        ahead = F @ frozen[-1]
        frozen.append(ahead + K * (10 - ahead[0]))
        ahead, P = taught["F"] @ steps[-1], F @ P @ F.T + article.AXIS.Q
        gain = P[:, 0] / (P[0, 0] + 0.1)
        steps.append(ahead + gain * (10 - ahead[0]))
        P = P - np.outer(gain, P[0])
    rows = [row.split() for row in printed_by("frozen").splitlines() if row[:1].isdigit()]
    assert [row[0] for row in rows] == ["1", "5", "10", "20"]
    for second, of_frozen, of_step in rows:
        assert f"{frozen[int(second)][0]:.2f}" == of_frozen
        assert f"{steps[int(second)][0]:.2f}" == of_step


def test_the_frozen_filter_takes_the_jump_after_a_silence_for_a_speed(settled):
    """Its sigma falls and rises again. By the recursion of the covariance, without the module's formula."""
    says("it takes the jump for a speed, and so it runs past the phone")
    says("After a silence the frozen filter swings for nine seconds.")
    says("back at once, but for the 0.32 m of a single measurement")
    assert round(np.sqrt(0.1), 2) == 0.32
    P, K = settled
    for _ in range(30):
        P = F @ P @ F.T + article.AXIS.Q
    sigmas, left = [], np.eye(2) - K @ article.AXIS.H
    for _ in range(10):
        P = left @ (F @ P @ F.T + article.AXIS.Q) @ left.T + 0.1 * K @ K.T
        sigmas.append(float(np.sqrt(P[0, 0])))
    assert f"{sigmas[0]:.2f}" == "4.98"
    assert sigmas[2] < sigmas[4]
    assert min(sigmas[:9]) > 1.2 * np.sqrt(settled[0][0, 0])
    assert sigmas[9] < 1.05 * np.sqrt(settled[0][0, 0])
    best, constant = article.after_silence(30, 10)
    np.testing.assert_allclose(constant, sigmas, rtol=1e-9)
    assert f"{best[0]:.2f}" == "0.32"
    assert max(best) == best[0]


def test_the_phone_that_is_drawn_after_its_silence_has_a_usual_error_and_is_overshot():
    """Its frozen filter, run again by its three lines, on the measurements of that phone."""
    says("Here is one such phone, with a usual error.")
    says("It goes only about half of the way back, just as it did from a wrong start.")
    zero, varies, frozen = (line.get_ydata() for line in article.draw_swing().axes[0].lines)
    assert set(zero) == {0}
    assert varies[0] == frozen[0]
    assert abs(varies[0]) == pytest.approx(article.sigma_after(30), rel=0.1)  # usual: to a tenth
    assert frozen[1] / frozen[0] == pytest.approx(0.5, abs=0.1)
    assert max(frozen) > 1  # past the phone, where the other filter stays within its own sigma, of 0.32 m
    assert abs(varies[1]) == pytest.approx(0.32, rel=0.1)
    assert max(np.abs(varies[2:7])) < 0.32
    assert np.abs(frozen - varies)[9:].max() < 0.2  # nine seconds later both are the same filter
    states, z = mpt.simulate(article.AXIS, 75, np.random.default_rng(2015), tracks=300)
    z[30:60] = np.nan
    estimates = mpt.KalmanFilter(article.AXIS).filter(z)
    errors = (estimates - states)[59:, 0]
    (phone,) = np.flatnonzero(np.isclose(errors[0], varies[0]))
    np.testing.assert_allclose(errors[:, phone], varies)
    x, K = estimates[59, :, phone], article.covariance(200)[:2, 0] / 0.1
    for k in range(60, 75):
        x = F @ x
        x = x + K * (z[k, 0, phone] - x[0])
        assert x[0] - states[k, 0, phone] == pytest.approx(frozen[k - 59], abs=1e-6)


def test_the_best_gain_after_a_gap_is_that_of_the_predicted_P(taught, settled):
    """Predicted through ten missed seconds, then `step`: the sigma of the article, without the module's formula."""
    says("What tells the second filter how much to believe? The large $P$ of the silent axis.")
    assert re.search(r"(?m)^10 +0\.31 +1\.25$", printed_by("missed"))
    P, K = settled
    for _ in range(10):
        P = F @ P @ F.T + article.AXIS.Q
    _, after = taught["step"](np.zeros((2, 3)), P, np.zeros(3))
    predicted, left = F @ P @ F.T + article.AXIS.Q, np.eye(2) - K @ article.AXIS.H
    frozen = left @ predicted @ left.T + 0.1 * K @ K.T
    np.testing.assert_allclose(article.first_after(10), np.sqrt([after[0, 0], frozen[0, 0]]), rtol=1e-9)


def test_an_axis_may_share_P_again_after_eight_measurements(taught):
    adds("With our noises eight measurements bring σ back, however long the silence was.")
    for r, expected in ((0.1, 8), (9.0, 22)):
        P = np.eye(2)
        for _ in range(500):
            _, P = taught["step"](np.zeros((2, 3)), P, np.zeros(3), r=r)
        rest, needed = np.diag(P), []
        for silence in (1, 3, 10, 30, 100, 1000, 10_000):
            P_silent, off = P, []
            for _ in range(silence):
                P_silent = F @ P_silent @ F.T + article.AXIS.Q
            for _ in range(60):
                _, P_silent = taught["step"](np.zeros((2, 3)), P_silent, np.zeros(3), r=r)
                off.append(np.abs(np.sqrt(np.diag(P_silent) / rest) - 1).max())
            needed.append(2 + max(i for i, each in enumerate(off) if each > 0.01))
        assert max(needed) == expected
        assert article.rests_after_silence(10_000, article.measured_with(np.sqrt(r))) == expected
        assert re.search(rf"(?m)^{np.sqrt(r):.2f} .* {expected}$", printed_by("rests"))
    before, after = re.findall(r"\[ ?([\d. ]+)\]", printed_by("step-gaps"))
    assert before.split() == ["0.23", "0.23", "10.48"]
    assert after.split() == ["0.23", "0.23", "0.32"]


def test_the_stacked_axes_go_back_into_columns(taught):
    adds("you go back from `step_with_gaps` to `step` with `X_own[:, :, 0].T` and `P_own[0]`")
    rng, X, P = np.random.default_rng(9), np.zeros((2, 3)), np.eye(2)
    X_own, P_own = X.T[:, :, None], np.stack([P] * 3)
    for z in rng.normal(size=(5, 3)):
        X, P = taught["step"](X, P, z)
        X_own, P_own = taught["step_with_gaps"](X_own, P_own, z)
    np.testing.assert_allclose(X_own[:, :, 0].T, X, atol=1e-12)
    np.testing.assert_allclose(P_own[0], P, atol=1e-12)


def test_errors_that_last_are_worse_than_a_measurement():
    """Simulated: another way than the module's recursion."""
    says("and its variance is still 0.1 m², our filter still states 0.234 m")
    rng = np.random.default_rng(6)
    steady = mpt.SteadyStateFilter.from_kalman(article.AXIS)
    truth, x, late = np.zeros((2, 400)), np.zeros((2, 400)), np.sqrt(0.1) * rng.standard_normal(400)
    off = []
    for k in range(600):
        truth = F @ truth + 0.1 * G * rng.standard_normal(400)
        late = 0.9 * late + np.sqrt(0.1 * (1 - 0.9**2)) * rng.standard_normal(400)
        x = steady.A @ x + steady.B * (truth[0] + late)
        if k >= 100:
            off.append(x[0] - truth[0])
    sigma = article.sigma_if_errors_last(0.9)
    assert np.std(off) == pytest.approx(sigma, rel=0.02)  # 200,000 errors, a few thousand independent ones
    assert sigma > np.sqrt(0.1)


def test_one_more_prediction_cures_the_papers_lag():
    """The filter of the paper, run on a walk and on noise, then F x."""
    adds("If the filter cannot be changed, predict once more.")
    assert "σ of F x: 0.234 m, against 0.234 m" in printed_by("late")
    rng = np.random.default_rng(7)
    truth, z = mpt.simulate(article.AXIS, 600, rng, tracks=300)
    x = mpt.SteadyStateFilter.from_kalman(article.PAPER).filter(z)
    off = (F @ x[100:])[:, 0] - truth[100:, 0]
    assert np.sqrt(np.mean(off**2)) == pytest.approx(article.sigma_predicted_once_more(), rel=0.02)
    walk = 1.5 * np.arange(1.0, 61)[:, None]
    assert (F @ mpt.SteadyStateFilter.from_kalman(article.PAPER).filter(walk)[-1])[0] == pytest.approx(90, abs=1e-6)


def test_the_Q_of_an_uneven_pace_adds_up_and_is_nearly_the_papers(taught):
    motion = dict(taught)
    exec(code_of("uneven").partition("\nP = ")[0], motion)
    (F_first, Q_first), (F_then, Q_then), (F_both, Q_both) = map(motion["motion"], (1.8, 0.7, 2.5))
    adds("the $Q$ of a step is the same however the step is cut")
    np.testing.assert_allclose(F_then @ Q_first @ F_then.T + Q_then, Q_both, rtol=1e-12)
    np.testing.assert_allclose(F_then @ F_first, F_both, rtol=1e-12)
    adds("In it the velocity changes once in each step, and two half steps have two changes.")
    half = mpt.gsm_axis(dt=0.5, q=0.005, r=0.1)
    assert np.abs(half.F @ half.Q @ half.F.T + half.Q - article.PAPER.Q).max() > 1e-4
    adds("(At 1 s its first entry is 0.0033, where the paper has 0.0025.)")
    np.testing.assert_allclose(motion["motion"](1.0)[1].round(4), [[0.0033, 0.005], [0.005, 0.01]])
    np.testing.assert_allclose(article.PAPER.Q, [[0.0025, 0.005], [0.005, 0.01]])


def test_step_takes_the_F_and_Q_of_an_uneven_pace(taught):
    """What the cell prints is what `step` makes of the same F and Q, and step_with_gaps too."""
    says("Part II, below, has the last two ready made, and seconds of uneven length.")
    motion = dict(taught)
    exec(code_of("uneven").partition("\nP = ")[0], motion)
    P, sigmas, steps = article.covariance()[:2, :2], [], (0.4, 1.0, 2.6)
    P_own = np.stack([P] * 3)
    for dt in steps:
        F_dt, Q_dt = motion["motion"](dt)
        _, P = taught["step"](np.zeros((2, 3)), P, np.zeros(3), F=F_dt, Q=Q_dt)
        _, P_own = taught["step_with_gaps"](np.zeros((3, 2, 1)), P_own, np.zeros(3), F=F_dt, Q=Q_dt)
        sigmas.append(f"{dt} s after the last measurement, and corrected: σ {np.sqrt(P[0, 0]):.3f} m")
    assert printed_by("uneven").splitlines() == sigmas
    np.testing.assert_allclose(P_own[2], P, atol=1e-12)


def lateness(taught, sigma, H, seconds=120, Q=article.AXIS.Q):
    """How late the filter of a sensor is each second, and its gains: a walk without noise, from the unknown start."""
    X, P, late, gains = np.zeros((2, 1)), np.diag([1e6, 4.0]), [], []
    for second in range(1, seconds + 1):
        X, P = taught["step"](X, P, np.array([1.5 * second]), H=np.array([H]), Q=Q, r=sigma**2)
        late.append(1.5 * second - X[0, 0])
        gains.append(P[:, 0] / sigma**2)
    return np.array(late), np.array(gains)


@pytest.mark.parametrize(
    ("sigma", "seconds"), [(np.sqrt(0.1), 20), (1.0, 20), (2.0, 20), (3.0, 120), (5.0, 120), (10.0, 120), (20.0, 120)]
)
def test_a_walk_without_noise_is_followed_to_a_centimetre(taught, sigma, seconds):
    adds("After twenty seconds, or two minutes if your sensor's σ is metres, the lateness must be below 1 cm.")
    late, _ = lateness(taught, sigma, [1.0, 0.0])
    assert abs(late[seconds - 1]) < 0.01
    adds("With the wrong $H$ you are 1.5 m late even after two minutes.")
    late, _ = lateness(taught, sigma, [1.0, 1.0])
    assert late[119] == pytest.approx(1.5, abs=0.01)


def test_a_noisy_sensor_needs_more_than_twenty_seconds_to_forget_its_start(taught):
    adds("A noisier sensor needs longer, because its filter forgets the start more slowly.")
    late = [abs(lateness(taught, sigma, [1.0, 0.0])[0][19]) for sigma in (3.0, 5.0, 10.0, 20.0)]
    assert late == sorted(late)
    assert late[0] > 0.01


@pytest.mark.parametrize("q", [1e-4, 1e-3, 0.01, 0.1, 1.0])
def test_with_another_Q_the_walk_lasts_twice_as_long_as_the_gain_moves(taught, q):
    says("Once its gain has stopped, and as long again, it must be less than 1 cm off.")
    for sigma in (np.sqrt(0.1), 1.0, 3.0, 5.0, 10.0, 20.0):
        late, gains = lateness(taught, sigma, [1.0, 0.0], seconds=600, Q=q * G @ G.T)
        assert np.abs(late[2 * article.rests(gains) - 1 :]).max() < 0.01
        P, second, at_rest = np.diag([1e6, 4.0]), 0, False
        while not at_rest:  # by the rule of the article
            _, P_new = taught["step"](np.zeros((2, 1)), P, np.zeros(1), Q=q * G @ G.T, r=sigma**2)
            P, second, at_rest = P_new, second + 1, np.allclose(P_new, P, rtol=1e-3, atol=0)
        assert np.abs(late[2 * second - 1 :]).max() < 0.01


def test_the_varying_gain_loses_nothing():
    """Frozen when it has stopped, from either start: then the covariance moves no more."""
    says("Let the gain vary until it stops, then freeze it")
    for variance in (0.0, 100.0):
        model = mpt.LinearModel(F=F, H=[[1, 0]], Q=article.AXIS.Q, R=[[0.1]], P0=variance * np.eye(2))
        settled = mpt.SteadyStateFilter.from_kalman(model).P
        np.testing.assert_allclose(mpt.KalmanFilter(model).covariances(60)[-1], settled, atol=1e-9)


def test_axes_kept_apart_state_a_true_sigma_when_their_errors_go_together():
    """And the loss that Part II prints is that of this true sigma."""
    two = np.eye(2)
    R = 0.1 * np.array([[1, 0.9], [0.9, 1]])
    F2, H2, Q2 = (np.kron(two, each) for each in (F, article.AXIS.H, article.AXIS.Q))
    linked = mpt.LinearModel(F=F2, H=H2, Q=Q2, R=R)
    small = mpt.SteadyStateFilter.from_kalman(article.AXIS)
    apart = mpt.SteadyStateFilter.from_kalman(mpt.LinearModel(F=F2, H=H2, Q=Q2, R=0.1 * two))
    true = mpt.metrics.error_moments(apart, linked, 200).covariance[-1]
    np.testing.assert_allclose(true[:2, :2], small.P, rtol=1e-9)
    best = mpt.SteadyStateFilter.from_kalman(linked).P
    np.testing.assert_allclose(
        article.losses_apart([1, 1], errors=0.9)[0], 100 * (np.sqrt(np.diag(true) / np.diag(best))[:2] - 1), rtol=1e-6
    )


def test_axes_kept_apart_lose_what_the_article_says_if_their_changes_go_together():
    """By the three lines of the article, with six states; alone an axis keeps its own sigma."""
    says("kept apart, a position has a σ that is 10 % larger")
    eye, pushed = np.eye(3), 0.9 + 0.1 * np.eye(3)
    F6, H6, Q6 = (
        np.kron(first, second) for first, second in ((eye, F), (eye, article.AXIS.H), (pushed, article.AXIS.Q))
    )
    P = np.zeros((6, 6))
    for _ in range(200):
        P = F6 @ P @ F6.T + Q6
        P = P - P @ H6.T @ np.linalg.inv(H6 @ P @ H6.T + 0.1 * eye) @ H6 @ P
    lost = 100 * (np.sqrt(np.diag(article.covariance(200)) / np.diag(P)) - 1).reshape(-1, 2)
    np.testing.assert_allclose(article.losses_apart([1, 1, 1], changes=0.9), lost, rtol=1e-6)
    assert lost[0].round().tolist() == [10, 11]


def with_six_states(changes=0.0, errors=0.0):
    """The big filter of the article's last lines, but from the known start, and with linked errors of measurement."""
    C, R = (each + (1 - each) * np.eye(3) for each in (changes, errors))
    F6, H6, Q6 = np.kron(np.eye(3), F), np.kron(np.eye(3), article.AXIS.H), np.kron(C, article.AXIS.Q)
    return mpt.LinearModel(F=F6, H=H6, Q=Q6, R=0.1 * R)


def test_the_big_filter_of_part_two_runs_with_missed_heights(taught):
    """Its lines as they stand, from an unknown start: the height has the sigma of the article after its silence."""
    z = np.full((90, 3), 100.0)
    z[60:, 2] = np.nan
    names = ready_made(z)
    assert names["together"].shape == (90, 6)
    np.testing.assert_allclose(names["together"][-1, ::2], 100, atol=0.01)
    big = names["big"]
    sigma = np.sqrt(mpt.KalmanFilter(big).covariances(z)[-1, 4, 4])
    assert sigma == pytest.approx(article.silent_in_company(names["C"])[0], rel=1e-6)
    adds("(`step` cannot take it, as it divides by one number.)")
    with pytest.raises(ValueError, match="broadcast"):
        taught["step"](np.zeros((6, 1)), big.P0, z[0], F=big.F, Q=big.Q, H=big.H, r=0.1)


@pytest.mark.parametrize(
    ("links", "metres"), [({"changes": 0.9}, 4.4), ({"changes": 0.5}, 8.7), ({"errors": 0.9}, 10.1)]
)
def test_the_other_axes_tell_of_a_silent_one_if_they_are_pushed_together(links, metres):
    z = np.zeros((90, 3))
    z[60:, 2] = np.nan
    sigma = np.sqrt(mpt.KalmanFilter(with_six_states(**links)).covariances(z)[-1, 4, 4])
    assert round(float(sigma), 1) == metres
    correlations = {kind: article.correlated(3, c) for kind, c in links.items()}
    stated, true = article.silent_in_company(**({"changes": np.eye(3)} | correlations))
    np.testing.assert_allclose([stated, true], sigma, rtol=1e-6)


@pytest.mark.parametrize("c", [0.5, 0.9])
def test_a_silent_axis_that_turns_round_is_lost_in_company(c):
    """Simulated: the height starts where it is known and is turned round from the first step."""
    rng, phones = np.random.default_rng(12), 3000
    model = with_six_states(changes=c)
    pushed = np.linalg.cholesky(article.correlated(3, c)) @ rng.standard_normal((90, 3, phones)) * 0.1
    pushed[:, 2] *= -1
    truth, states = np.zeros((2, 3, phones)), []
    for each in pushed:
        truth = np.einsum("ij,jap->iap", F, truth) + G[:, :, None] * each
        states.append(truth[0])
    z = np.array(states) + np.sqrt(0.1) * rng.standard_normal((90, 3, phones))
    z[60:, 2] = np.nan
    off = mpt.KalmanFilter(model).filter(z)[-1, 4] - states[-1][2]
    _, true = article.silent_in_company(article.correlated(3, c), article.turned(3, c))
    assert np.std(off) == pytest.approx(true, rel=0.04)  # three times the scatter of 3,000


def test_a_diagonal_is_worse_known_than_axes_apart_imply():
    """Simulated, with the columns of the package: sigma of each axis is true, that of the diagonal is not."""
    rng, phones = np.random.default_rng(13), 400
    truth = mpt.simulate(article.AXIS, 160, rng, tracks=3 * phones)[0].reshape(160, 2, 3, phones)
    late = np.linalg.cholesky(article.correlated(3, 0.9)) @ rng.standard_normal((160, 3, phones)) * np.sqrt(0.1)
    z = (truth[:, 0] + late).reshape(160, 1, 3 * phones)
    off = mpt.KalmanFilter(article.AXIS).filter(z).reshape(160, 2, 3, phones)[60:, 0] - truth[60:, 0]
    implied, true = article.diagonal_apart(0.9)
    assert np.std(off) == pytest.approx(implied, rel=0.02)
    assert np.std(off.sum(axis=1) / np.sqrt(3)) == pytest.approx(true, rel=0.02)


def test_the_estimates_of_axes_apart_are_those_of_one_filter_only_for_a_start_in_blocks():
    says("and starting $P$ made of blocks")
    _, z = mpt.simulate(mpt.stack(*[article.AXIS] * 2), 5, np.random.default_rng(8))
    F2, H2, Q2 = (np.kron(np.eye(2), each) for each in (F, article.AXIS.H, article.AXIS.Q))
    apart = mpt.KalmanFilter(article.started(np.eye(2))).filter(z[:, None, :]).transpose(0, 2, 1).reshape(5, 4)
    gaps = []
    for c in (0.0, 0.9):
        P0 = np.kron([[1, c], [c, 1]], np.eye(2))
        together = mpt.KalmanFilter(mpt.LinearModel(F=F2, H=H2, Q=Q2, R=0.1 * np.eye(2), P0=P0)).filter(z)
        gaps.append(np.abs(together - apart).max())
    assert gaps[0] < 1e-12
    assert gaps[1] > 0.01


def test_the_counts_are_those_of_the_table():
    adds("The other ten of the twelve counts in its table come out as printed")
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
        ("exercise-step", EXERCISE_2, KALMAN.replace("K[:, 0] *", "K *"), "K[:, 0] fits x."),
    ],
)
def test_an_exercise_says_what_was_expected(taught, capsys, id, placeholder, answer, said):
    cell = code_of(id)
    assert cell.count(placeholder) == 1
    exec(cell.replace(placeholder, answer), dict(taught) | {"article": article})
    assert said in capsys.readouterr().out


# Numbers of Part I that no cell prints, with the test or the reason.
ELSEWHERE = {
    *("0.0546", "0.0213", "0.0206", "0.0025", "0.1179", "0.0419", "0.1204", "0.0469", "0.0306"),  # by hand
    *("0.2204", "0.1", "0.005", "0.213", "0.546", "0.144", "4.3", "1000", "454", "1,000,000"),  # by hand
    *("0.01", "0.5", "1.5", "0.9"),  # inputs: noises, the walk, half seconds, correlations
    *("1e6", "4.0", "900"),  # the unknown start
    *("9.5", "60"),  # the lost metres, taken apart, and the ride
    *("27", "101"),  # operations, taken apart
    *("0.7", "0.14"),  # the clock
    "2015",  # a year
    *("20,000", "1e-12"),  # lengths and limits of the cells
}


def test_no_number_of_the_article_is_untested():
    """Each of two digits or more is printed by a cell, or listed above."""
    outputs = " ".join(shown(cell) for cell in ARTICLE.cells if cell["cell_type"] == "code")
    known = set(re.findall(r"\d+(?:\.\d+)?(?:e-?\d+)?", outputs)) | ELSEWHERE
    prose = re.sub(r"\]\([^)]*\)", "]", ARTICLE.text)  # links
    said = re.findall(r"(?<![\w.])\d+(?:[.,]\d+)*(?:e-?\d+)?", prose)
    untested = {each for each in said if len(each) > 1 and each not in known}
    assert untested == set()
