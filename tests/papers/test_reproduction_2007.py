"""The reproduction of the paper of 2007: what its notebook says, what its figures show, what its verdicts rest on."""

import re
from dataclasses import replace

import numpy as np
import pytest
from conftest import ROOT, cells_of, prose, shown

import mpt_helpers as mpt
from reproduction.ledger import published, stored_verdicts
from reproduction.paper_2007 import checks, figures, positioning, recorded
from reproduction.paper_2007 import experiments as runs

NOTEBOOK = ROOT / "notebooks" / "2007_mms_kalman.ipynb"
INPUTS = {"0.2", "0.02", "0.01"}  # what the paper prints of its settings


@pytest.fixture(scope="module")
def cells():
    return cells_of(NOTEBOOK)


@pytest.fixture(scope="module")
def printed(cells):
    return "\n".join(shown(cell) for cell in cells if cell["cell_type"] == "code")


@pytest.fixture(scope="module")
def record():
    return checks.on_record()


def verdicts():
    return {each.id: each for each in stored_verdicts(NOTEBOOK)}


# What the notebook says


def test_every_number_of_the_prose_is_printed_by_a_cell(cells, printed):
    said = set(re.findall(r"(?<![\d.])\d+\.\d+(?![\d.])", prose(cells).replace("10.5755", ""))) - INPUTS
    assert {"0.20", "0.39", "1.08", "0.82", "0.146"} <= said
    missing = [number for number in said if not re.search(rf"(?<![\d.]){re.escape(number)}\d?(?!\d)", printed)]
    assert missing == []


def test_the_front_says_what_the_verdicts_say(cells, record):
    front = prose(cells[:1])
    found = verdicts()
    unchecked = [each for each in found.values() if each.verdict == "cannot be checked"]
    assert len([each for each in unchecked if each.kind != "figure"]) == 4
    assert "Four statements cannot be checked" in front
    assert len([each for each in unchecked if each.kind == "figure"]) == 6
    assert "It has lost all six pictures" in front
    assert {id for id, each in found.items() if each.cause not in ("", "copy")} == {
        "line.sigma",
        "line.first",
        "kalman.longer",
    }
    share, with_row_3 = re.findall(r"0\.\d+", found["kalman.changing"].computed)
    assert f"its error is at most {share} of that of a line through 100 positions ({with_row_3} with" in front
    low, high = record.newest.min(), record.newest.max()
    assert f"left {low:.2f} to {high:.2f} of the error of a single position, instead of 0.20" in front
    assert positioning.line_sigma(100, np.array([0, 100])) == pytest.approx(2 / np.sqrt(100), rel=0.02)


def test_what_lasts_is_told_as_it_is(cells, record):
    said = prose(cells)
    assert f"its square is {record.nees.min():.0f} to {record.nees.max():.0f} times the variance" in said
    low, high = record.of_noise.min(), record.of_noise.max()
    assert f"On their noise alone the line leaves {low:.2f} to {high:.2f}, near theory's 0.20" in said
    assert np.abs(record.ratio / record.newest - 1).max() < 1 / 6  # "that of the line within a sixth"


def test_no_verdict_rests_on_a_recording():
    """The paper's errors are simulated and independent; what recordings add is beyond."""
    assert {each.basis for each in verdicts().values()} <= {"identity", "arithmetic", "exact", "simulation", "reading"}
    assert sum("recordings of receivers" in each.beyond for each in verdicts().values()) == 7


def test_what_looks_odd_only_is_no_item():
    """A name or a caption is no result: symbols and captions are told at the figures and among the letters."""
    assert not {"symbols.p", "captions"} & published("2007_mms_kalman").items.keys()


def test_each_dispute_is_settled_in_the_head_of_the_ledger():
    text = (ROOT / "reproduction/ledger/2007_mms_kalman.toml").read_text(encoding="utf-8")
    head = text[: text.index("paper.name")]
    for id in ("symbols.p", "captions", "eq5", "rough.steps", "fluctuation", "kalman.rough", "kalman.longer"):
        assert id in head
    for id in ("line.first", "kalman.precise", "kalman.longer", "conclusion.motion"):
        assert re.search(rf"^# {id}: ", head, re.MULTILINE)


# Equation 8 and the first point


def test_equation_8_gives_the_point_before_the_first():
    """By numpy, on a line without errors whose first point is at 7 m."""
    x = 7 + 0.3 * np.arange(100)
    start, velocity = positioning.line_fit(x, 1.0)
    assert start == pytest.approx(7 - 0.3)
    assert start + velocity == pytest.approx(x[0])
    assert (verdicts()["line.first"].verdict, verdicts()["line.first"].cause) == ("differs", "first-point")


# Figures


def curves(panel):
    """The lines of a panel that have points: {style: (x, y)}."""
    return {line.get_linestyle(): np.transpose(line.get_xydata()) for line in panel.lines if len(line.get_xydata())}


@pytest.fixture
def made():
    """Five seconds of a track, measured and estimated."""
    t = np.arange(1.0, 6)
    true = checks.track(0.2, 5)
    return t, true, true[:, 0] + 0.5, true + np.outer(t, [0.1, 0.01, -0.1]), np.full(5, 0.2)


@pytest.mark.parametrize("draw", [figures.draw_line, figures.draw_kalman])
def test_a_track_is_drawn_as_its_caption_says(draw, made):
    """Measured x solid, estimated x dashed; below it the estimated velocity, and the true one dotted."""
    t, true, measured, estimates, _ = made
    x, velocity = (each for each in draw(5, *made).axes[:2])
    assert (x.get_title(loc="left"), velocity.get_title(loc="left")) == ("coordinate x (m)", "velocity (m/s)")
    assert curves(x).keys() == {"-", "--"}
    np.testing.assert_array_equal(curves(x)["-"], [t, measured])
    np.testing.assert_array_equal(curves(x)["--"], [t, estimates[:, 0]])
    np.testing.assert_array_equal(curves(velocity)["--"], [t, estimates[:, 1]])
    np.testing.assert_array_equal(curves(velocity)[":"], [t, true[:, 1]])
    (legend,) = draw(5, *made).legends
    assert [text.get_text() for text in legend.get_texts()] == ["measured $x_m$", "estimated $x_e$", "true"]


def test_what_is_ours_stands_below(made):
    t, true, _, estimates, sigma = made
    _, _, b, error = figures.draw_kalman(6, *made).axes
    np.testing.assert_array_equal(curves(b)["--"], [t, estimates[:, 2]])
    np.testing.assert_array_equal(curves(b)[":"], [t, true[:, 2]])
    np.testing.assert_allclose(curves(error)["-"][1], estimates[:, 0] - true[:, 0])
    band = error.collections[0].get_paths()[0].vertices[:, 1]
    assert (band.min(), band.max()) == (-2 * sigma[0], 2 * sigma[0])
    for panel in (b, error, figures.draw_line(3, *made).axes[2]):
        assert panel.get_title(loc="left").startswith("added: ")


def test_figures_1_and_2_have_the_error_above_and_many_skies_below():
    one = np.array([3e5, 1e3, 2.0])
    many = np.array([[3e5, 3e5, 3e5], [900.0, 1e3, 2e3], [1.0, 2.0, 4.0]])
    starts = {"off": 1, "at": 2, "centre": 3}
    off, at, centre, below = figures.draw_fig1(
        *({name: i * each for name, i in starts.items()} for each in (one, many))
    ).axes
    np.testing.assert_allclose(curves(off)["-"], [range(3), one / 1e3])
    np.testing.assert_allclose(curves(at)["--"], [range(3), 2 * one / 1e3])
    np.testing.assert_allclose(curves(centre)[":"], [range(3), 3 * one / 1e3])
    assert (off.get_yscale(), at.get_yscale(), below.get_yscale()) == ("linear", "linear", "log")
    np.testing.assert_allclose(curves(below)["-"][1], [3e5, 1e3, 2.0])
    np.testing.assert_allclose(curves(below)["--"][1], [6e5, 2e3, 4.0])
    band = below.collections[0].get_paths()[0].vertices[:, 1]
    assert (band.min(), band.max()) == (1.0, 3e5)
    above, below = figures.draw_fig2(one, many, 2 * many).axes
    np.testing.assert_allclose(curves(above)["-"], [range(3), one])
    np.testing.assert_allclose(curves(below)["-"][1][-1], np.sqrt(21 / 3))
    assert below.get_title(loc="left") == "added: rms error (m), 3 skies"


def test_the_line_of_figures_3_and_4_is_that_of_numpy():
    z = np.random.default_rng(1).standard_normal(40).cumsum()
    found, sigma = checks.line_track(z)
    assert np.isnan(found[:4]).all()
    for k in (5, 17, 40):
        V, x_eo = np.polyfit(np.arange(1, k + 1), z[:k], 1)
        np.testing.assert_allclose(found[k - 1], [x_eo + k * V, V])
        assert sigma[k - 1] == positioning.line_sigma(k, k)


# What the verdicts rest on


def simulated(M, seed=5):
    """True states and measurements of GPS and INS on M tracks of 100 steps at 0.2 m/s."""
    true = checks.track(0.2)
    z = (true[:, :2] + [0, checks.BIAS])[..., None]
    return true, z + checks.SIGMAS[:, None] * np.random.default_rng(seed).standard_normal((100, 2, M))


def test_the_errors_after_100_steps_are_those_of_many_tracks():
    """Those of 4,000 tracks, whose rms is known to 1.1 %; four of it."""
    kf = mpt.KalmanFilter(checks.model(0.01))
    true, z = simulated(4000)
    error = kf.filter(z)[-1] - true[-1][:, None]
    np.testing.assert_allclose(checks.after_100(kf.filter), mpt.metrics.rms(error, axis=1), rtol=0.045)
    F = np.array([[1, 1.0], [0, 1]])
    alone = mpt.LinearModel(F=F, H=[[1, 0]], Q=np.diag([0, 1.0]), R=[[1.0]], P0=checks.P0[:2, :2])
    error = mpt.KalmanFilter(alone).filter(z[:, :1])[-1, 0] - true[-1, 0]
    assert checks.gps_alone(1.0) == pytest.approx(mpt.metrics.rms(error), rel=0.045)


def test_a_track_moves_by_the_printed_matrix_from_where_the_filter_starts():
    true = np.vstack([[0, 0.02, checks.BIAS], checks.track(0.02)])
    np.testing.assert_allclose(true[1:], true[:-1] @ checks.model().F.T)
    assert checks.model().x0[0] == 0


def test_a_reading_of_the_third_row_is_that_of_many_tracks():
    """GPS less Δt times the INS without its estimated error, fed to the filter of three rows, step by step."""
    true, z = simulated(4000)
    kf = mpt.KalmanFilter(checks.model(0.01, r33=1.0))
    A, B, _ = kf.coefficients(len(z))
    x = np.repeat(kf.model.x0[:, None], z.shape[2], axis=1)
    for A_k, B_k, z_k in zip(A, B, z, strict=True):
        x = A_k @ x + B_k @ np.vstack([z_k, z_k[0] - (z_k[1] - x[2])])
    made, stated = checks.third_row("GPS - Δt (INS - b)")
    assert made == pytest.approx(mpt.metrics.rms(x[0] - true[-1, 0]), rel=0.045)
    assert stated == pytest.approx(np.sqrt(kf.covariances(100)[-1, 0, 0]))
    without = checks.after_100(mpt.KalmanFilter(checks.model()).filter)[0]
    assert checks.third_row("no third row")[0] == pytest.approx(without)


def test_a_rough_filter_begins_300_km_away_and_least_squares_does_not_wait():
    rough = checks.rough_kalman(np.random.default_rng(3), 4, epochs=12)
    assert set(rough) == {"least squares", "Q = (0 m)²", "Q = (1 m)²", "Q = (100 m)²", "iterated", "fix first"}
    for errors in rough.values():
        assert errors.shape == (12, 4)
    assert (rough["Q = (0 m)²"][0] > 100).all()  # linearised once, 300 km away
    assert (checks.epochs_until(rough["fix first"]) == 1).all()
    np.testing.assert_allclose(rough["iterated"], rough["fix first"], atol=0.05)  # m: P0 of 300 km is little knowledge
    assert (checks.epochs_until(rough["Q = (0 m)²"]) == np.inf).all()


def test_with_a_large_q_a_rough_filter_takes_as_many_epochs_as_least_squares():
    """Both linearise once for each epoch, under other skies than those of the notebook."""
    rough = checks.rough_kalman(np.random.default_rng(4), 20, epochs=30)
    epochs = {name: np.median(checks.epochs_until(each)) for name, each in rough.items()}
    assert epochs["least squares"] == epochs["Q = (100 m)²"] == 2
    assert epochs["Q = (1 m)²"] > 5
    assert verdicts()["kalman.longer"].verdict == "holds in part"
    assert "Does not hold: in epochs, Q = (100 m)²." in verdicts()["kalman.longer"].reason


@pytest.mark.parametrize("m", range(4, 13))
def test_a_step_of_the_filter_takes_more_arithmetic_than_one_of_least_squares(m):
    fix, kalman = checks.operations(m)
    assert kalman > 2 * fix


def test_the_error_of_the_velocity_is_told_beside_the_velocity(cells):
    said, given = prose(cells), verdicts()["conclusion.motion"].computed
    for v in (0.2, 0.02):
        error = checks.after_100(mpt.KalmanFilter(checks.model()).filter, v)[1]
        assert error < v
        assert f"{100 * error / v:.0f} % of {v:g} m/s" in given
    assert "0.0105 m/s in $V$, which is 5 % of 0.2 m/s" in said
    assert "Now the error, 0.0105 m/s, is 53 % of the velocity." in said
    H = np.vander(np.arange(1.0, 101), 2)
    slope = np.sqrt(np.linalg.inv(H.T @ H)[0, 0])  # the error of the slope of the line
    assert f"{slope:.4f} m/s is {100 * slope / 0.2:.0f} % of 0.2 m/s, and {100 * slope / 0.02:.0f} % of 0.02" in said


def test_what_q_and_p0_change_at_a_constant_velocity(cells):
    """P0 at most 5 %; Q the error of x little, and that of V threefold."""
    errors = {}
    for q in (0.0, 1e-4, 0.01, 1.0):
        model = checks.model(q)
        errors[q] = checks.after_100(mpt.KalmanFilter(model).filter)
        for times in (0.01, 100):
            other = checks.after_100(mpt.KalmanFilter(replace(model, P0=times * model.P0)).filter)
            np.testing.assert_allclose(other, errors[q], rtol=0.05)
    x, V, _ = np.transpose(list(errors.values()))
    assert "change by at most 5 % if $P_0$ is a hundred times larger or smaller" in prose(cells)
    told = f"$Q$ changes the error of $x$ little ({x.min():.3f} to {x.max():.3f} m), and triples that of $V$ "
    assert told + f"({V.min():.4f} to {V.max():.4f} m/s)" in prose(cells)
    assert V.max() / V.min() == pytest.approx(3, abs=0.1)


@pytest.fixture(scope="module")
def change():
    return checks.changes(np.random.default_rng(11), tracks=30)


def test_after_a_change_line_and_filter_err_as_they_do_on_simulated_tracks(change):
    """To 2.2 m/s within a second, by simulated tracks, the filter of the package and numpy's line."""
    N, tracks, rng = 200, 200, np.random.default_rng(1)
    moves = runs.change(0.2, 2.2, 1, N)
    noise = rng.normal(size=(N, 2, tracks)) * [[1.0], [0.01]]
    z = (moves + np.array([0, 1.0]))[..., None] + noise
    off = mpt.KalmanFilter(checks.model(Q=np.diag([0, 0.01, 0]))).filter(z)[:, 0] - moves[:, :1]
    k = range(N // 2, N // 2 + 50)
    slopes = [np.polyfit(np.arange(100), z[j - 99 : j + 1, 0], 1) for j in k]
    line = np.array([slope * 99 + first for slope, first in slopes]) - moves[k, :1]
    place = checks.SPEEDS.index(2.2), checks.DURATIONS.index(1), checks.PHASES.index(0)
    assert change.kalman["diagonal", 0.01][place] == pytest.approx(mpt.metrics.rms(off[k]), rel=0.05)
    assert change.line[place] == pytest.approx(mpt.metrics.rms(line), rel=0.01)
    window = positioning.adaptive_line(z[:, :1], 1.0, checks.THRESHOLD, 5, 100).x[:, 0] - moves[:, :1]
    assert change.window[place] == pytest.approx(mpt.metrics.rms(window[k]), rel=0.1)


def test_the_filter_makes_less_than_a_tenth_of_the_error_of_the_line_after_a_change(change):
    given = verdicts()["kalman.changing"]
    assert (given.verdict, given.basis) == ("reproduced", "exact")
    share, with_row_3 = (float(each) for each in re.findall(r"0\.\d+", given.computed))
    assert share == pytest.approx(max((each / change.line).max() for each in change.kalman.values()), abs=6e-4)
    assert share < 0.1
    assert change.row_3.shape == change.line.shape
    assert with_row_3 == pytest.approx((change.row_3 / change.line).max(), abs=6e-4)
    assert with_row_3 < 1


def test_against_the_adaptive_line_q_decides(cells, change):
    """What the notebook says of the largest errors, with other simulated tracks; filters are exact."""
    said = prose(cells)
    largest = {family: np.max([change.kalman[family, q] for q in (0.01, 1.0)], axis=0) for family in checks.FAMILIES}
    to_10 = checks.SPEEDS.index(10.2)
    diagonal, acceleration = largest["diagonal"], largest["acceleration"]
    assert change.window[to_10].max() == pytest.approx(1.07, abs=0.05)
    told = diagonal[to_10].max(), acceleration[to_10].max(), acceleration[to_10, 1:].max()
    assert (
        "is {:.2f} m off with the diagonal $Q$, and {:.2f} m with that of an acceleration, or {:.2f} m".format(*told)
        in said
    )
    assert (diagonal[to_10, 1:] > change.window[to_10, 1:]).all()
    better = {family: each.max(axis=2) < change.window.max(axis=2) for family, each in largest.items()}
    assert better["acceleration"][:to_10].all()
    assert np.argwhere(~better["diagonal"][:to_10]).tolist() == [[checks.SPEEDS.index(2.2), 0]]


def test_each_reading_of_the_third_row_leaves_less_than_half(cells):
    """Whatever its variance, which is not printed."""
    made = [checks.third_row(reading, r33)[0] for reading in runs.READINGS for r33 in (1.0, 2.0, 4.0, 25.0)]
    assert max(made) < 0.5
    assert "Each reading keeps our limit of half of GPS's error of 1 m." in prose(cells)
    assert verdicts()["kalman.precise"].computed.endswith(f"with it {max(made):.2f} at most")


def test_recordings_are_judged_by_line_and_filter(record):
    """One case, by hand: a line of numpy through each hundred heights."""
    case = recorded.cases(recorded.recorded_days())["NYA1, two frequencies"]
    up = case.errors[:, 2]
    newest = [np.polyval(np.polyfit(np.arange(100), up[k - 99 : k + 1], 1), 99) for k in range(99, len(up))]
    at = record.names.index("NYA1, two frequencies"), recorded.AXES.index("up")
    assert record.newest[at] == pytest.approx(mpt.metrics.rms(np.array(newest)) / mpt.metrics.rms(up[99:]))
    assert record.fix[at] == pytest.approx(np.sqrt(np.mean(up**2)), rel=0.05)
    assert record.of_noise[at] == pytest.approx(recorded.line_ratios(case.noise[:, 2], 100)[1])
    assert (record.velocity < checks.BIAS / 2).all()
    assert (record.bias < checks.BIAS / 2).all()
