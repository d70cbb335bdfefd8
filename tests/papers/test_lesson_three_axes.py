"""The lesson on three axes: what it teaches agrees with the package, and each number of its prose is computed here."""

import json
import re

import numpy as np
import pytest
from conftest import ROOT, cells_of, prose, shown, source

import mpt_helpers as mpt
from reproduction import burden
from reproduction.papers_2014_2015 import lesson_three_axes as lesson

CELLS = {cell["id"]: cell for cell in cells_of(ROOT / "notebooks" / "lessons" / "three_axes_one_small_filter.ipynb")}
TEXT = re.sub(r"\s+", " ", prose(CELLS.values()).replace("*", ""))
F, G = lesson.AXIS.F, np.array([[0.5], [1.0]])


def says(text):
    """Require that the lesson says this; numbers in it are computed by the test."""
    assert re.sub(r"\s+", " ", text) in TEXT, text


@pytest.fixture(scope="module")
def taught():
    """The names that the lesson's filters define."""
    names = {}
    exec(source(CELLS["filter"]), names)
    exec(source(CELLS["step-gaps"]).partition("\n\n\non = ")[0], names)
    return names


@pytest.fixture(scope="module")
def settled():
    """P and K of the settled filter."""
    steady = mpt.SteadyStateFilter.from_kalman(lesson.AXIS)
    return steady.P, steady.B


def test_the_filter_that_is_taught_is_that_of_the_package(taught):
    model = mpt.stack(*[lesson.AXIS] * 3)
    _, z = mpt.simulate(model, 50, np.random.default_rng(3))
    X, P = np.zeros((2, 3)), np.zeros((2, 2))
    big = mpt.KalmanFilter(model).estimates(z)
    for z_k, x_big, P_big in zip(z, big.x, big.P, strict=True):
        X, P = taught["step"](X, P, z_k)
        np.testing.assert_allclose(X.T.ravel(), x_big, rtol=0, atol=1e-12)
        np.testing.assert_allclose(np.kron(np.eye(3), P), P_big, rtol=0, atol=1e-12)


@pytest.mark.parametrize("shape", [(3,), (3, 1, 1)])
def test_the_filter_with_gaps_serves_axes_with_noises_of_their_own(taught, shape):
    variances = np.array([0.1, 0.2, 0.9])
    model = mpt.stack(*[mpt.LinearModel(F=F, H=[[1, 0]], Q=lesson.AXIS.Q, R=[[each]]) for each in variances])
    rng = np.random.default_rng(4)
    _, z = mpt.simulate(model, 50, rng)
    z[rng.random(z.shape) < 0.3] = np.nan
    X, P = np.zeros((3, 2, 1)), np.zeros((3, 2, 2))
    for z_k in z:
        X, P = taught["step_with_gaps"](X, P, list(z_k), r=variances.reshape(shape))
    e = mpt.KalmanFilter(model).estimates(z)
    np.testing.assert_allclose(X.ravel(), e.x[-1], atol=1e-12)
    for i in range(3):
        np.testing.assert_allclose(P[i], e.P[-1][2 * i : 2 * i + 2, 2 * i : 2 * i + 2], atol=1e-12)


def test_sharing_needs_that_each_axis_is_measured_and_the_split_does_not(taught):
    says("Splitting needs only the zeros. Sharing also needs equal blocks.")
    X, P = np.zeros((3, 2, 1)), np.stack([np.eye(2)] * 3)
    for _ in range(200):
        before = P
        X, P = taught["step_with_gaps"](X, P, [0.0, 0.0, np.nan])
        assert (P[2] > before[2])[[0, 1], [0, 1]].all()
    np.testing.assert_allclose(P[0], before[0], rtol=1e-9)
    says("Never give `step` or the frozen line a NaN: it would stay. If all axes miss the same second, predict only.")
    X, P = taught["step"](np.zeros((2, 3)), np.eye(2), np.array([1.0, np.nan, 1.0]))
    X, _ = taught["step"](X, P, np.ones(3))
    np.testing.assert_array_equal(np.isnan(X), [[False, True, False]] * 2)


def test_the_headline_numbers(settled):
    P, _ = settled
    says("knows it to 10.5 m after thirty seconds of silence.")
    says(f"A phone that knew its height to 0.23 m (the root of {P[0, 0]:.4f}, in the first picture)")
    assert (round(np.sqrt(P[0, 0]), 2), round(lesson.sigma_after(30), 1)) == (0.23, 10.5)
    assert "of a measurement 0.32 m" in source(CELLS["filter"])
    assert round(np.sqrt(0.1), 2) == 0.32


def test_the_settled_gain_is_r_times_less_than_what_is_left(settled):
    P, K = settled
    np.testing.assert_allclose(P[:, [0]] / 0.1, K, rtol=1e-9)


def test_after_a_silence_the_frozen_filter_needs_ten_seconds():
    """By errors of simulated tracks too: 20,000 know a standard deviation to 0.5 %."""
    best, frozen = lesson.after_silence(30, steps=15)
    says(f"knows the height to {best[0]:.2f} m at once")
    says("It goes only about half of the way, takes the jump for a speed, and swings past: it needs ten seconds until")
    assert frozen[0] / lesson.sigma_after(31) == pytest.approx(0.45, abs=0.05)
    ratio = frozen / best
    assert ratio[8] > 1.2
    assert ratio[9:].max() < 1.035
    settle, missed = 40, 30
    x, z = mpt.simulate(lesson.AXIS, settle + missed + 10, np.random.default_rng(8), tracks=20_000)
    z[settle : settle + missed] = np.nan
    error = mpt.SteadyStateFilter.from_kalman(lesson.AXIS).filter(z)[settle + missed :, 0] - x[settle + missed :, 0]
    np.testing.assert_allclose(error.std(axis=1), frozen[:10], rtol=0.03)


def test_axes_that_are_linked():
    rows = [re.split(r"  +", line.strip()) for line in shown(CELLS["linked"]).splitlines()[1:]]
    assert [row[1:] for row in rows[:3]] == [["0 %", "0 %"], ["2 %", "7 %"], ["2 %", "10 %"]]
    says("If errors and changes of equal axes are linked alike, that is nothing:")
    for c in (0.5, 0.9):
        alike, opposite = (lesson.losses_apart([1, 1, 1], errors=c, changes=each) for each in (c, -0.45))
        np.testing.assert_allclose(alike, 0, atol=1e-6)
        assert f"{opposite[:, 0].max():.0f} %" in rows[4]
    for c, worst in ((0.5, "7 %"), (0.9, "44 %")):
        links = {"errors": c}, {"changes": c}, {"errors": c, "changes": c}
        unlike = [lesson.losses_apart([1, 1, size], **each)[:, 0].max() for size in (0.1, 10) for each in links]
        assert f"{max(unlike):.0f} %" == worst
        assert worst in rows[3]
    says("(−0.5 is the lowest that three axes can have)")
    assert np.linalg.eigvalsh(lesson.correlated(3, -0.5)).min() == pytest.approx(0, abs=1e-12)
    says("with errors linked by one half they state 0.23 m along the diagonal (1, 1, 1), where 0.32 m is true.")
    assert [round(each, 2) for each in lesson.diagonal_apart(0.5)] == [0.23, 0.32]
    says("Assume 0.9 for changes that are linked by 0.3, and the big filter states 4.4 m after the silence,")
    linked = lesson.correlated(3, 0.9)
    assert [round(each, 1) for each in lesson.silent_in_company(linked)] == [4.4, 4.4]
    weak = lesson.silent_in_company(linked, true_changes=lesson.correlated(3, 0.3))
    assert [round(each, 1) for each in weak] == [4.4, 10.9]


def test_sigma_of_each_axis_stays_true_whatever_links_them():
    says("The small filters still run, and σ of each axis stays true.")
    H, F_3 = np.kron(np.eye(3), lesson.AXIS.H), np.kron(np.eye(3), F)
    apart = mpt.SteadyStateFilter.from_kalman(mpt.stack(*[lesson.AXIS] * 3))
    R, Q = lesson.AXIS.R[0, 0] * lesson.correlated(3, 0.9), np.kron(lesson.correlated(3, -0.45), lesson.AXIS.Q)
    true = mpt.metrics.error_moments(apart, mpt.LinearModel(F=F_3, H=H, Q=Q, R=R), 500).covariance[-1]
    np.testing.assert_allclose(true.diagonal(), apart.P.diagonal(), rtol=1e-9)


def test_the_loss_of_axes_kept_apart_is_that_of_simulated_tracks():
    """The exact loss of the table, against the errors of both filters on tracks whose errors are linked."""
    H, Q = np.kron(np.eye(3), lesson.AXIS.H), np.kron(np.eye(3), lesson.AXIS.Q)
    R = lesson.AXIS.R[0, 0] * lesson.correlated(3, 0.9)
    linked = mpt.LinearModel(F=np.kron(np.eye(3), F), H=H, Q=Q, R=R)
    x, z = mpt.simulate(linked, 60, np.random.default_rng(6), tracks=20_000)
    together = (mpt.KalmanFilter(linked).filter(z) - x)[-1, 0].std()
    apart = (mpt.KalmanFilter(mpt.stack(*[lesson.AXIS] * 3)).filter(z) - x)[-1, 0].std()
    # the ratio of two correlated spreads of 20,000 tracks is known to less than 1 %
    assert 100 * (apart / together - 1) == pytest.approx(lesson.losses_apart([1, 1, 1], errors=0.9)[0, 0], abs=1)


def test_the_table_of_costs_has_the_operations_of_the_paper_and_the_times_of_the_benchmark():
    stored = json.loads((ROOT / "benchmarks" / "results.json").read_text(encoding="utf-8"))["three axes"]
    clock = {each["name"]: each for each in stored}
    rows = {
        "one big filter": ("one filter of six states", "constant gain: one filter of six states"),
        "axes stacked, a $P$ for each: `step_with_gaps`, below": (
            "axes stacked, a P for each",
            "constant gain: three filters of two states",
        ),
        "axes as columns that share one $P$: `step`": (
            "axes as columns, one P and K",
            "constant gain: axes as columns",
        ),
    }
    for said, names in rows.items():
        says(f"| {said} | {' | '.join(str(clock[name]['operations']) for name in names)} |")
    times = {name: f"{each['one']:.2g}" for name, each in clock.items()}
    says("On our machine `step_with_gaps` takes as long as the big filter")
    assert times["axes stacked, a P for each"] == "1"
    assert round(clock["axes as columns, one P and K"]["one"], 1) == 0.7
    says("`step` 0.7 times")
    says("the bare line of a frozen filter 0.14 times, big or as columns")
    for name in ("constant gain: one filter of six states", "constant gain: axes as columns"):
        assert times[name] == "0.14"
    says("in 207 operations a step instead of 1660.")
    says("they can share a matrix: 101 operations. And once the gain has settled, you can freeze it: 30.")
    assert burden.total(burden.kalman(6, 3)) == 1660
    assert burden.total(burden.kalman_columns(2, 1, axes=3)) == 101


def test_the_frozen_line_goes_on_from_the_stacked_filter(taught):
    """On the turned state it is the filter of three axes; on the stack itself numpy would mix them."""
    names = dict(taught)
    exec(source(CELLS["freeze"]), names)
    X_own, P_own = names["X"].T[:, :, None], np.stack([names["P"]] * 3)
    rng = np.random.default_rng(3)
    for _ in range(12):
        X_own, P_own = taught["step_with_gaps"](X_own, P_own, rng.normal(size=3))
    X = X_own[:, :, 0].T
    for z_k in rng.normal(size=(30, 3)):
        X_own, P_own = taught["step_with_gaps"](X_own, P_own, z_k)
        X = names["A"] @ X + names["K"] * z_k
    np.testing.assert_allclose(X.T, X_own[:, :, 0], atol=2e-3)  # the gain is within a thousandth of its limit


def test_the_gain_settles_in_twelve_seconds():
    says("After twelve seconds without a miss on any axis, as many as $P$ took to settle, freeze again:")
    says("with `X = X_own[:, :, 0].T`, and the line of the frozen filter.")
    assert "at rest after 12 seconds" in shown(CELLS["freeze"])


def test_axes_of_other_motions_are_stacked_too(taught):
    """F, Q and H of each axis, as a stack."""
    F_k = np.stack([[[1, dt], [0, 1]] for dt in (1.0, 0.5)])
    Q_k, H_k = np.stack([np.eye(2), 2 * np.eye(2)]), np.array([[[1.0, 0]], [[1.0, 0.2]]])
    code = source(CELLS["step-gaps"]).partition("\n\n\non = ")[0]
    names = {"np": np, "F": F_k, "Q": Q_k, "H": H_k, "r": 0.1}
    exec(code, names)
    X, P = np.zeros((2, 2, 1)), np.stack([np.eye(2)] * 2)
    z = np.random.default_rng(2).normal(0, 1, (10, 2))
    for z_k in z:
        X, P = names["step_with_gaps"](X, P, z_k)
    for i in range(2):
        own = mpt.LinearModel(F=F_k[i], H=H_k[i], Q=Q_k[i], R=[[0.1]], P0=np.eye(2))
        e = mpt.KalmanFilter(own).estimates(z[:, [i]])
        np.testing.assert_allclose(X[i, :, 0], e.x[-1], atol=1e-9)
        np.testing.assert_allclose(P[i], e.P[-1], atol=1e-9)


def test_errors_that_last_are_not_stated():
    says("If each error keeps 80 % or 99 % of itself to the next second, the filter takes it for motion: it states a σ")
    says("of 0.23 m where 0.33 m is true in both cases, no better than a raw measurement.")
    for kept in (0.8, 0.99):
        last = lesson.sigma_if_errors_last(kept, steps=5000)
        assert round(last, 2) == 0.33
        assert last > np.sqrt(0.1)


def test_a_corner_puts_the_filter_off(settled):
    """The mean error after a change of velocity that comes evenly over a second."""
    says("a velocity that changes by 1.4 m/s in a second puts the filter 0.7 m off on that axis, and it")
    _, K = settled
    off, found = np.zeros((2, 1)), []
    for change in (1.4, 0.0, 0.0, 0.0):
        off = (np.eye(2) - K @ lesson.AXIS.H) @ (F @ off - G * change)
        found.append(-off[0, 0])
    assert [round(each, 1) for each in found] == [0.3, 0.7, 0.7, 0.6]


def test_single_precision_needs_a_start_at_the_first_measurement():
    """A hundred measurements a second, each wrong by 0.1 m: from 10⁶ the errors double, from r they are the best."""
    says("begin at the first measurement, with the variance $r$, and with the velocity zero")
    dt, r = 0.01, 0.01
    F_k = np.array([[1.0, dt], [0.0, 1.0]])
    Q_k, H = 0.01 * dt * np.array([[dt**2 / 3, dt / 2], [dt / 2, 1.0]]), np.eye(1, 2)

    def made(P0, steps, kind):
        """The true P of the filter whose gains are computed in this precision."""
        P, true = P0.astype(kind), P0.copy()
        f, q, h, variance = (np.asarray(each, kind) for each in (F_k, Q_k, H, r))
        for _ in range(steps):
            P = f @ P @ f.T + q
            K = P @ h.T / (h @ P @ h.T + variance)
            P = P - K @ h @ P
            left = np.eye(2) - K.astype(float) @ H
            true = left @ (F_k @ true @ F_k.T + Q_k) @ left.T + r * K.astype(float) @ K.T.astype(float)
        return np.sqrt(true[0, 0])

    best = made(np.diag([1e6, 4.0]), 50, float)
    assert made(np.diag([1e6, 4.0]), 50, np.float32) > 1.5 * best
    assert made(np.diag([r, 4.0]), 49, np.float32) == pytest.approx(best, rel=0.01)
