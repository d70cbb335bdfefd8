"""The lesson on three axes: what it teaches agrees with the package, and each number of its prose is computed here."""

import json
import re

import numpy as np
import pytest
from conftest import ROOT, cells_of, prose, source

import mpt_helpers as mpt
from reproduction import burden
from reproduction.papers_2014_2015 import lesson_three_axes as lesson

CELLS = {cell["id"]: cell for cell in cells_of(ROOT / "notebooks" / "lessons" / "three_axes_one_small_filter.ipynb")}
TEXT = re.sub(r"\s+", " ", prose(CELLS.values()).replace("*", ""))
F, G = lesson.AXIS.F, np.array([[0.5], [1.0]])
UNKNOWN = np.diag([1e6, 4.0])


def says(text):
    """Require that the lesson says this; numbers in it are computed by the test."""
    assert re.sub(r"\s+", " ", text) in TEXT, text


@pytest.fixture(scope="module")
def taught():
    """The names that the lesson's filters define."""
    names = {}
    exec(source(CELLS["filter"]), names)
    exec(source(CELLS["step-gaps"]).partition("\nX_own, P_own")[0], names)
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


def test_the_package_gives_each_axis_a_covariance_of_its_own():
    says("`mpt.KalmanFilter(axis).filter(z[:, None, :])` filters three tracks of one number each, the axes")
    model = mpt.stack(*[lesson.AXIS] * 3)
    _, z = mpt.simulate(model, 60, np.random.default_rng(5))
    z[30:, 2] = np.nan
    apart = mpt.KalmanFilter(lesson.AXIS).filter(z[:, None, :])
    together = mpt.KalmanFilter(model).filter(z)
    np.testing.assert_allclose(apart.transpose(0, 2, 1).reshape(60, 6), together, atol=1e-9)


def test_sharing_needs_that_each_axis_is_measured_and_the_split_does_not(taught):
    says("Splitting needs only the zeros. Sharing also needs the equal blocks.")
    X, P = np.zeros((3, 2, 1)), np.stack([np.eye(2)] * 3)
    for _ in range(200):
        before = P
        X, P = taught["step_with_gaps"](X, P, [0.0, 0.0, np.nan])
        assert (P[2] > before[2])[[0, 1], [0, 1]].all()
    np.testing.assert_allclose(P[0], before[0], rtol=1e-9)
    says("Never give `step` a NaN: it would stay. To change over when an axis falls silent, begin")
    X, P = taught["step"](np.zeros((2, 3)), np.eye(2), np.array([1.0, np.nan, 1.0]))
    X, _ = taught["step"](X, P, np.ones(3))
    np.testing.assert_array_equal(np.isnan(X), [[False, True, False]] * 2)


def test_the_headline_numbers(settled):
    P, K = settled
    says("a phone that knows its height to 0.23 m knows it to 10.5 m after thirty seconds without one")
    assert (round(np.sqrt(P[0, 0]), 2), round(lesson.sigma_after(30), 1)) == (0.23, 10.5)
    says("The settled gain would go the share 0.546 of the way")
    assert round(K[0, 0], 3) == 0.546
    says("Its first one here is 1,000,000 / (1,000,000 + 0.1)")
    first = mpt.KalmanFilter(mpt.LinearModel(F=np.eye(2), H=[[1, 0]], Q=0 * P, R=[[0.1]], P0=UNKNOWN)).covariances(1)
    assert first[0, 0, 0] / 0.1 == pytest.approx(1e6 / (1e6 + 0.1), rel=1e-9)
    says("even a filter that knew everything at the last measurement would end at 9.5 m")
    known = np.zeros((2, 2))
    for _ in range(30):
        known = F @ known @ F.T + lesson.AXIS.Q
    assert round(np.sqrt(known[0, 0]), 1) == 9.5
    says("A measurement has a variance of 0.1 m², so its σ is 0.32 m")
    assert round(np.sqrt(0.1), 2) == 0.32


def test_the_settled_gain_learns_a_walkers_speed_more_slowly(settled):
    """Exact, from the right position and a speed that is wrong by 1 m/s: the rms error of the velocity."""
    says("Even from the right position it learns a speed of 1 m/s more slowly than the gain that varies.")
    H, Q, P = lesson.AXIS.H, lesson.AXIS.Q, np.diag([0.0, 4.0])
    moments = {"settled": np.diag([0.0, 1.0]), "varies": np.diag([0.0, 1.0])}
    for _ in range(4):
        P = F @ P @ F.T + Q
        K = P @ H.T / (H @ P @ H.T + 0.1)
        P = P - K @ H @ P
        for name, gain in (("settled", settled[1]), ("varies", K)):
            left = np.eye(2) - gain @ H
            moments[name] = left @ (F @ moments[name] @ F.T + Q) @ left.T + 0.1 * gain @ gain.T
        assert moments["settled"][1, 1] > 1.5 * moments["varies"][1, 1]


def test_what_is_left_of_a_measurement_is_r_times_the_gain(settled):
    says("The gain is $c / (p + r)$, and the measurement leaves the share $r / (p + r)$ of $c$.")
    P, K = settled
    c = (F @ P @ F.T + lesson.AXIS.Q)[:, [0]]
    p = c[0, 0]
    np.testing.assert_allclose(K, c / (p + 0.1), rtol=1e-9)
    np.testing.assert_allclose(P[:, [0]], c * 0.1 / (p + 0.1), rtol=1e-9)
    np.testing.assert_allclose(P[:, [0]] / 0.1, K, rtol=1e-9)


def test_after_a_silence_the_frozen_filter_needs_ten_seconds():
    """By errors of simulated tracks too: 20,000 know a standard deviation to 0.5 %."""
    says("it is 16 times as uncertain as it need be in the first second, and it takes ten seconds until the two agree")
    says("the frozen filter's σ is 7 % larger in the next than with the best gain; after two in a row it is 23 %")
    assert np.divide(*lesson.after_silence(2, steps=1)[::-1]).item() == pytest.approx(1.23, abs=0.006)
    assert np.divide(*lesson.after_silence(1, steps=1)[::-1]).item() == pytest.approx(1.07, abs=0.006)
    best, frozen = lesson.after_silence(30, steps=15)
    ratio = frozen / best
    assert round(ratio.max()) == 16
    assert ratio[8] > 1.2
    assert ratio[9:].max() < 1.035
    says("in the first second after three, five or ten seconds its σ is 1.5, 2.0 or 4.0 times the other's.")
    first = [np.divide(*lesson.after_silence(missed, steps=1)[::-1]).item() for missed in (3, 5, 10)]
    assert [round(each, 1) for each in first] == [1.5, 2.0, 4.0]
    settle, missed = 40, 30
    x, z = mpt.simulate(lesson.AXIS, settle + missed + 10, np.random.default_rng(8), tracks=20_000)
    z[settle : settle + missed] = np.nan
    error = mpt.SteadyStateFilter.from_kalman(lesson.AXIS).filter(z)[settle + missed :, 0] - x[settle + missed :, 0]
    np.testing.assert_allclose(error.std(axis=1), frozen[:10], rtol=0.03)


def test_axes_that_are_linked():
    says("The last one is σ of a height that has been silent for thirty seconds")
    says("with 0.9 and −0.45 they lose 30 %")
    assert round(lesson.losses_apart([1, 1, 1], errors=0.9, changes=-0.45)[0, 0]) == 30
    says("Beside a height whose σ of measurement is ten times as large, east and north then lose 52 %, the most that")
    assert lesson.losses_apart([1, 1, 10], errors=0.9, changes=-0.45)[:2, 0].round().tolist() == [52, 52]
    says("If errors and changes have the same correlation, equal axes lose nothing")
    assert np.abs(lesson.losses_apart([1, 1, 1], errors=0.6, changes=0.6)).max() < 1e-6
    says("Velocities lose up to twice as much as positions.")
    for link in ("errors", "changes"):
        for c in (0.3, 0.5, 0.7, 0.9):
            position, velocity = lesson.losses_apart([1, 1, 1], **{link: c})[0]
            assert position < velocity < 2.05 * position
    says("with one half between the errors, they state σ = 0.23 m along the diagonal (1, 1, 1), where it is 0.32 m")
    assert [round(each, 2) for each in lesson.diagonal_apart(0.5)] == [0.23, 0.32]
    says("With 0.9 where 0.3 is true, it states 4.4 m after the silence and is wrong by 10.9 m, more than axes kept")
    linked = lesson.correlated(3, 0.9)
    assert [round(each, 1) for each in lesson.silent_in_company(linked)] == [4.4, 4.4]
    weak = lesson.silent_in_company(linked, true_changes=lesson.correlated(3, 0.3))
    assert [round(each, 1) for each in weak] == [4.4, 10.9]
    says("nearer than axes kept apart where at least half of the correlation that it was told was true")
    for told in (0.3, 0.5, 0.7, 0.9):
        for true in (told / 2, 0.75 * told, told, 0.95):
            _, wrong = lesson.silent_in_company(lesson.correlated(3, told), lesson.correlated(3, true))
            assert wrong < 10.48


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
        "axes stacked, a $P$ for each: `step_with_gaps`": (
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
    says("a frozen filter 0.14 times, big or as columns")
    for name in ("constant gain: one filter of six states", "constant gain: axes as columns"):
        assert times[name] == "0.14"
    says("a step takes 101 operations instead of 1660")
    says("30 operations instead of 102 for the big filter")
    assert burden.total(burden.kalman(6, 3)) == 1660
    assert burden.total(burden.kalman_columns(2, 1, axes=3)) == 101


def test_errors_that_last_are_not_stated():
    says("If nine tenths of each error stay for the next second, this filter still states")
    says("states 0.234 m and is wrong by 0.333 m, more than a raw measurement with its 0.316")
    assert round(np.sqrt(0.1), 3) == 0.316
    assert round(lesson.sigma_if_errors_last(0.9), 3) == 0.333


def test_a_corner_puts_the_filter_off(settled):
    """The mean error after a change of velocity that comes evenly over a second."""
    says(
        "a velocity that changes by 1.4 m/s in a second puts the filter 0.7 m off for two seconds, and it still states"
    )
    _, K = settled
    off, found = np.zeros((2, 1)), []
    for change in (1.4, 0.0, 0.0, 0.0):
        off = (np.eye(2) - K @ lesson.AXIS.H) @ (F @ off - G * change)
        found.append(-off[0, 0])
    assert [round(each, 1) for each in found] == [0.3, 0.7, 0.7, 0.6]
