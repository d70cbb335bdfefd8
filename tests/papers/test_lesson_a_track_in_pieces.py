"""The lesson `a_track_in_pieces`: its filters, each number in its prose, and hunts for cases that refute its sentences.

A text in `says` has its numbers put in by the test, so that a number that changes makes it fail.
"""

import re
import timeit
from functools import partial
from time import process_time

import numpy as np
import pytest
from conftest import ROOT
from reading import Article

import mpt_helpers as mpt
from reproduction.papers_2014_2015 import lesson_a_track_in_pieces as lesson


def plain(text):
    """A text without markup, in one line; [1\\ \\ 0] is [1 0]."""
    return re.sub(r"\s+", " ", re.sub(r"\\ ", " ", re.sub(r"[*$]", "", text)))


LESSON = Article("lessons/a_track_in_pieces", plain)
says, code_of, printed_by = LESSON.says, LESSON.code_of, LESSON.printed_by
CELLS = ("filter", "recording", "early", "pretend", "mend-code", "in-pieces")
NOW = np.array([[1.0, 0.0]])
F = np.array([[1.0, 1.0], [0.0, 1.0]])
Q = 0.01 * np.outer([0.5, 1], [0.5, 1])


@pytest.fixture(scope="module")
def taught():
    """The names that the cells of the lesson define, but for those that show."""
    names = {}
    for id in CELLS:
        exec(code_of(id), names)
    return names


def with_model(F, Q, H=NOW):
    """The lesson's functions for another model: its cells, but for the recording."""
    names = {}
    for id in CELLS:
        if id != "recording":
            exec(code_of(id), names)
    names |= {"F": F, "Q": Q, "H": H, "n": len(F)}
    return names


def model_of(names):
    return mpt.LinearModel(F=names["F"], H=names["H"], Q=names["Q"], R=[[0.1]], P0=100 * np.eye(names["n"]))


def with_gaps(rng, rows, push=0.1):
    """A simulated recording: some rows missing, and some long gaps."""
    truth = np.cumsum(1.5 + np.cumsum(rng.normal(0, push, rows)))
    z = truth + rng.normal(0, np.sqrt(0.1), rows)
    z[rng.random(rows) < rng.choice([0, 0.05, 0.3, 0.5])] = np.nan
    for _ in range(rng.integers(0, 3)):
        first = rng.integers(0, max(rows - 60, 1))
        z[first : first + rng.integers(1, 60)] = np.nan
    return z


# The plain loop


def test_the_loop_is_the_filter_of_the_package(taught):
    z = taught["half"][:300]
    expected = mpt.KalmanFilter(model_of(taught)).filter(z[:, None])
    np.testing.assert_allclose(taught["one_by_one"](z), expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(taught["Q"], Q)


def test_the_recording(taught):
    speed = np.abs(1.5 + np.cumsum(np.random.default_rng(14).normal(0, 0.1, 10_000)))
    assert f"# its speed wanders up to {speed.max():.0f} m/s" in code_of("recording")
    says("of which a twentieth is missing, and the same with half of them missing")
    assert np.isnan(taught["recording"]).mean() == pytest.approx(0.05, abs=0.005)
    assert np.isnan(taught["half"]).mean() == pytest.approx(0.5, abs=0.01)


def test_a_step_takes_a_stack_of_recordings_and_of_models(taught):
    says("`step` takes them as it is, without a change.")
    z = np.stack([taught["complete"][:40], taught["complete"][40:80]])
    factors = np.array([1.0, 30.0]).reshape(2, 1, 1)
    names = with_model(F, factors * Q)
    x, P = np.zeros((2, 2, 1)), np.tile(100 * np.eye(2), (2, 1, 1))
    for z_k in z.T:
        x, P = names["step"](x, P, z_k.reshape(2, 1, 1), 0.1)
    for i, factor in enumerate(factors.ravel()):
        kf = mpt.KalmanFilter(mpt.LinearModel(F=F, H=NOW, Q=factor * Q, R=[[0.1]], P0=100 * np.eye(2)))
        np.testing.assert_allclose(x[i, :, 0], kf.filter(z[i][:, None])[-1], rtol=1e-9)


# Forget


def test_pieces_begun_early(taught):
    says("40 early rows are exact to less than a thousandth of a millimetre")
    says("With half missing, 80 early rows reach the same.")
    says("it takes 120 steps in place of 10,000")
    for name, bounds in {"recording": {40: 1e-3}, "half": {80: 1e-3}}.items():
        for early, bound in bounds.items():
            x, _ = taught["begun_early"](taught[name], 80, early)
            off = np.abs(x - taught["one_by_one"](taught[name]))[:, 0].max()
            assert 1000 * off < bound  # from the first row on


def test_the_first_piece_is_the_loop(taught):
    """Also where it is the only one, and where the rows do not fill the last piece."""
    z = taught["recording"][:130]
    x, _ = taught["begun_early"](z, 60)
    np.testing.assert_allclose(x[:60], taught["one_by_one"](z)[:60], rtol=0, atol=1e-10)
    assert len(x) == 130


def ship():
    rng = np.random.default_rng(14)
    truth = np.cumsum(1.5 + np.cumsum(rng.normal(0, 0.001, 10_000)))
    return truth + rng.normal(0, np.sqrt(0.1), 10_000)


def test_a_filter_that_remembers_shows_at_the_seams():
    names, z = with_model(F, 1e-4 * Q), ship()
    says("40 early rows leave seams of up to {:.0f} σ".format(names["begun_early"](z, 80, 40)[1]))
    says("and it takes 160 to bring them to a hundredth.")
    assert names["begun_early"](z, 320, 160)[1] == pytest.approx(0.01, rel=0.25)
    assert names["begun_early"](z, 160, 80)[1] > 0.05


def test_a_gap_over_the_early_rows_shows_at_the_seam(taught):
    says("the piece arrives from its absurd start, thousands of σ off")
    z = taught["recording"][:4000].copy()
    z[2000:2080] = np.nan  # a piece begins at row 2080
    assert taught["begun_early"](z, 80)[1] > 2000


def test_a_start_that_is_right_by_accident_is_not_believed():
    """Nothing measured for long, at 0, where the loop begins: from a start of 0 the seams would be 0, and P wrong."""
    z = np.concatenate([np.full(150, np.nan), 1.5 * np.arange(100)])
    assert with_model(F, Q)["begun_early"](z, 60)[1] > 1


def test_a_difference_does_not_grow_in_sigma():
    """Of two filters with the same gains, for models of any kind, in gaps and elsewhere."""
    says(
        "a difference in this unit does not grow from row to row: a measurement shrinks it, and a gap widens σ at least"
    )
    rng = np.random.default_rng(5)
    for n in (2, 3, 4):
        for _ in range(30):
            root, wild, H = rng.standard_normal((n, n)), rng.standard_normal((n, n)), rng.standard_normal((1, n))
            names = with_model(wild, root @ root.T, H)
            P, d, before = np.eye(n), rng.standard_normal((n, 1)), np.inf
            for _ in range(30):
                r = np.inf if rng.random() < 0.4 else 0.1
                now = (d.T @ np.linalg.solve(P, d)).item()
                assert now <= before * (1 + 1e-9)
                before = now
                d, P = names["step"](d, P, 0.0, r)  # of two filters' estimates, z cancels
                P = (P + P.T) / 2


def sigma_of_loop(names, z):
    """The σ of all unknowns in each row."""
    P, found = 100 * np.eye(names["n"]), []
    for z_k, r_k in names["with_variances"](z):
        _, P = names["step"](np.zeros((names["n"], 1)), P, z_k, r_k)
        found.append(np.sqrt(np.diag(P)))
    return np.array(found)


def test_the_seams_tell():
    says("and L at least twice `early`. In most of them no row was further off the loop than the largest seam")
    says("both in σ; the worst was off by less than three times as much.")
    rng, ratios = np.random.default_rng(1), []
    for _ in range(300):
        factor = 10 ** rng.uniform(-4, 3)
        names = with_model(F, factor * Q)
        z = with_gaps(rng, int(rng.integers(300, 600)), 0.1 * np.sqrt(factor))
        early = int(rng.integers(5, 60))
        x, seam = names["begun_early"](z, int(rng.integers(2 * early, 200)), early)
        off = (np.abs(x - names["one_by_one"](z)) / sigma_of_loop(names, z)).max()
        if seam > 1e-7:  # below, rounding
            ratios.append(off / seam)
    assert max(ratios) < 3
    assert np.mean(np.array(ratios) < 1) > 0.7


# Learn


def test_the_example_by_hand():
    surprises, runner = [5.0, 5.2], 4.0
    information, evidence = len(surprises), sum(surprises)
    mean = (runner + evidence) / (1 + information)
    says("Your piece has two, {} and {}".format(*surprises))
    says("its surprises are {} and {}".format(*surprises))
    says(f"(4.0 + 5.0 + 5.2) / 3 = {mean:.2f}, with variance 1/3")
    says(f"two statements, sum {evidence:.1f}")
    says(f"O was {information}, the number of statements, and t was {evidence:.1f}, their sum")
    says(f"({runner} + {evidence:.1f}) / (1 + {information})")
    says(f"The runner arrives with {runner}, of variance 1")
    says(f"The ordinary filter begins at {runner} with variance 1. Its gains are 1/2 and 1/3: it moves to 4.5, then")
    x, P = runner, 1.0
    for z, gain in zip(surprises, (1 / 2, 1 / 3), strict=True):
        assert gain == pytest.approx(P / (P + 1))
        x, P = x + gain * (z - x), P - gain * P
        if gain == 1 / 2:
            assert (x, P) == (4.5, 0.5)
    assert (x, P) == (pytest.approx(mean), pytest.approx(1 / 3))
    says(f"to 4.5 + 0.7/3 = {x:.2f}, with variance 1/3")
    # and the lesson's own code on a state of one number that never moves
    names = with_model(np.eye(1), np.zeros((1, 1)), np.eye(1))
    X, T, P, t, information_of_code = names["pretend"]([(z, 1.0) for z in surprises])
    assert [each.item() for each in (X, T, P, t, information_of_code)] == [0, 1, 0, evidence, information]


def test_what_the_first_two_surprises_of_a_piece_see():
    """By the lines of the filter from a certain start, and without the lesson's."""
    P, T, seen = np.zeros((2, 2)), np.eye(2), []
    for _ in range(2):
        P = F @ P @ F.T + Q
        h, K = (F @ T)[0], P[:, [0]] / (P[0, 0] + 0.1)
        seen.append(h)
        T, P = F @ T - K * h, P - K * P[0]
    np.testing.assert_array_equal(seen[0], [1, 1])
    says("At the first row h = HF = [1 1]: the surprise sees the position of the start and a second of its velocity.")
    says(f"At the second it is [{seen[1][0]:.2f} {seen[1][1]:.2f}].")


def test_the_noises_of_the_surprises_are_independent():
    """The covariance of all surprises of a piece that starts exactly, without a filter's lines: diagonal, and S."""
    says("Each is uncorrelated with all before it")
    for factor in (0.01, 1, 100):
        rows, names = 12, with_model(F, factor * Q)
        # z = (sum of what each push does) + noise; the surprise of row k is z(k) - E[z(k) | z(1) ... z(k-1)]
        felt = np.zeros((rows, rows))
        for k in range(rows):
            for j in range(k + 1):
                felt[k, j] = (np.linalg.matrix_power(F, k - j) @ [0.5, 1])[0]
        covariance = 0.01 * factor * felt @ felt.T + 0.1 * np.eye(rows)
        surprise = np.eye(rows)
        for k in range(1, rows):
            surprise[k, :k] = -np.linalg.solve(covariance[:k, :k], covariance[:k, k])
        of_surprises = surprise @ covariance @ surprise.T
        np.testing.assert_allclose(of_surprises, np.diag(np.diag(of_surprises)), atol=1e-10 * covariance.max())
        P, stated = np.zeros((2, 2)), []
        for _ in range(rows):
            P = F @ P @ F.T + names["Q"]
            stated.append(P[0, 0] + 0.1)
            P = P - P[:, [0]] * P[0] / stated[-1]
        np.testing.assert_allclose(np.diag(of_surprises), stated, rtol=1e-9)


def test_a_piece_of_one_measurement_is_the_filter_of_the_paper(taught):
    """T, O, P are F_n, O_n, P_n; X is K_n z and t is K_m z (Eq. 7)."""
    says("With pieces of one measurement that is the filter of Lainiotis (1975), as a paper of 2014 has it")
    z = 1.7
    X, T, P, t, information = taught["pretend"]([(z, 0.1)])
    S = (NOW @ Q @ NOW.T).item() + 0.1
    Kn, Km = Q @ NOW.T / S, F.T @ NOW.T / S
    pairs = ((X, Kn * z), (t, Km * z), (T, F - Kn @ NOW @ F), (P, Q - Kn @ NOW @ Q), (information, Km @ NOW @ F))
    for ours, paper in pairs:
        np.testing.assert_allclose(ours, paper, atol=1e-14)


@pytest.mark.parametrize("L", [1, 2, 7, 60, 500])
def test_pieces_give_the_estimates_of_the_package_with_gaps_and_of_any_length(L):
    """For models drawn at random too: two to four unknowns, stable or not."""
    rng = np.random.default_rng(L)
    models = [(F, factor * Q, NOW) for factor in (1e-4, 1, 100)]
    for n in (2, 3, 4):
        root = rng.standard_normal((n, n))
        wild = rng.standard_normal((n, n))
        wild /= np.abs(np.linalg.eigvals(wild)).max() / rng.uniform(0.5, 1.02)
        models.append((wild, root @ root.T, rng.standard_normal((1, n))))
    for matrices in models:
        names = with_model(*matrices)
        z = with_gaps(rng, 131)
        expected = mpt.KalmanFilter(model_of(names)).filter(z[:, None])
        scale = max(np.abs(expected).max(), 1)
        np.testing.assert_allclose(names["in_pieces"](z, L), expected, rtol=0, atol=1e-8 * scale)


def test_pieces_bear_a_very_uncertain_start(taught):
    names = {}
    for id in CELLS:
        exec(code_of(id).replace("100 * np.eye(n)", "1e12 * np.eye(n)"), names)
    z = taught["complete"][:300]
    # a nanometre; rounding of 1e12 leaves a tenth of it
    np.testing.assert_allclose(names["in_pieces"](z, 30), names["one_by_one"](z), rtol=0, atol=1e-9)


def test_one_piece_ends_where_the_loop_does():
    lines = printed_by("one-piece").splitlines()
    start, mended, pretended, end, loop = (float(re.search(r"(-?[\d.]+) m\b", line)[1]) for line in lines)
    assert end == loop
    assert abs(pretended - loop) > 1
    before, after = (float(re.search(r"give or take ([\d.]+)", line)[1]) for line in lines[:2])
    assert after < before
    assert abs(start - mended) < 2 * before


def test_a_pretended_piece_overshoots():
    says("It overshoots, since the jump reads as speed.")
    true, measured = lesson.walk(120)
    pretended = mpt.KalmanFilter(lesson.POSITIONS).filter(measured[90:, None])[:, 0]
    assert (pretended - true[90:]).max() > 10


def test_the_cell_that_compares_says_that_all_agree():
    assert re.findall(r"to a nanometre, (\d+) km from the start: (\w+)", printed_by("same")) == [("66", "True")]
    says("The code holds it to a nanometre here, and in tests with other lengths, gaps and models.")


def test_the_best_length_of_a_piece():
    N = 10_000
    steps = {L: N / L + 2 * L for L in range(1, N)}
    best = min(steps, key=steps.get)
    says("L = \\sqrt{N/2}, about 70 here. Near it little changes.")
    assert best == round(np.sqrt(N / 2))
    assert round(best, -1) == 70
    assert steps[80] < 1.01 * steps[best]


def test_several_measurements_a_row_take_an_inverse_and_a_huge_variance():
    says("the division becomes an inverse between the factors")
    says("`P @ H.T @ inv(S)`, `h.mT @ inv(S) @ e`, `h.mT @ inv(S) @ h`")
    says("Take 1e30 in place of an infinite variance.")
    step, H = with_axes(2)
    model = mpt.LinearModel(
        F=np.kron(np.eye(2), F), H=H, Q=np.kron(np.eye(2), Q), R=0.1 * np.eye(2), P0=100 * np.eye(4)
    )
    _, z = mpt.simulate(model, 30, np.random.default_rng(3))
    z[10:14] = np.nan
    x, P = np.zeros((4, 1)), 100 * np.eye(4)
    for z_k, expected in zip(z, mpt.KalmanFilter(model).filter(z), strict=True):
        r = (1e30 if np.isnan(z_k[0]) else 0.1) * np.eye(2)
        x, P = step(x, P, np.nan_to_num(z_k)[:, None], r)
        np.testing.assert_allclose(x[:, 0], expected, rtol=0, atol=1e-9)


# Times


def with_axes(axes):
    """The lesson's step and `pretend` for several axes in one filter: `/` is an inverse, and F, Q, H have blocks."""
    names = {}
    code = code_of("filter").replace("/ (H @ P @ H.T + r)", "@ np.linalg.inv(H @ P @ H.T + r)")
    assert "inv" in code
    exec(code, names)
    names |= {name: np.kron(np.eye(axes), matrix) for name, matrix in (("F", F), ("Q", Q), ("H", NOW))}
    return names["step"], names["H"]


def pretend_of_axes(axes):
    """As `with_axes`: a row of `pretend`."""
    code = code_of("pretend").replace("P @ H.T / S", "P @ H.T @ S").replace("@ e / S", "@ S @ e")
    code = code.replace("@ h / S", "@ S @ h").replace("S = H @ P @ H.T + r", "S = np.linalg.inv(H @ P @ H.T + r)")
    assert "/ S" not in code
    names = {name: np.kron(np.eye(axes), matrix) for name, matrix in (("F", F), ("Q", Q), ("H", NOW))}
    names |= {"np": np, "n": 2 * axes}
    exec(code, names)
    return names["pretend"]


def best_times(ways, rounds, number=1):
    """The least processor time of each of several functions, {name: seconds}, run in turns.

    Other programs take wall time, but hardly processor time, and a busy second strikes all of them.
    """
    times = {name: [] for name in ways}
    for _ in range(rounds):
        for name, way in ways.items():
            times[name].append(timeit.timeit(way, number=number, timer=process_time) / number)
    return {name: min(each) for name, each in times.items()}


def test_pieces_gain_less_with_more_unknowns():
    """10,000 steps of one track against 120 steps of 125 pieces, and against 160 steps, half of `pretend`, and a relay.

    Each measured ratio lies within 2.5 times of what is said: 1.7 times for the machine, as the lesson says, and 1.5
    for what numpy's products of stacks cost in its various builds.
    """
    said = re.findall(r"with 4, 6, 12 unknowns (\d+), (\d+), (\d+)", printed_by("who"))
    early, pretending = np.array(said, float)
    says("There they were 4 to 13 times as fast as a loop over the rows.")
    assert (min(pretending), max(early)) == (4, 13)
    found = []
    for axes in (2, 3, 6):
        step, _ = with_axes(axes)
        pretend = pretend_of_axes(axes)
        n, R = 2 * axes, 0.1 * np.eye(axes)
        one = np.ones((n, 1)), np.eye(n), np.ones((axes, 1)), R
        many = [np.repeat(each[None], 125, axis=0) for each in one]
        ways = {"one": partial(step, *one), "many": partial(step, *many), "pretend": partial(pretend, [many[2:]])}
        took = best_times(ways, 40, number=10)
        loop = 10_000 * took["one"]
        relay = 125 * 1.5 * took["one"]  # of about as many calls as a step and a half
        found.append((loop / (120 * took["many"]), loop / (80 * (took["many"] + took["pretend"]) + relay)))
    ratios = np.array(found).T / [early, pretending]
    assert (ratios > 1 / 2.5).all(), found
    assert (ratios < 2.5).all(), found


def test_a_step_of_a_hundred_pieces_takes_a_few_times_as_long_as_of_one(taught):
    says("A step of a hundred pieces takes only a few times as long as a step of one.")
    one = np.ones((2, 1)), np.eye(2), np.ones((1, 1)), np.full((1, 1), 0.1)
    many = [np.repeat(each[None], 100, axis=0) for each in one]
    took = best_times({"one": partial(taught["step"], *one), "many": partial(taught["step"], *many)}, 40, number=10)
    assert 1.5 < took["many"] / took["one"] < 10


def test_pieces_that_begin_early_are_some_two_times_as_fast_as_the_runner(taught):
    """Minima of many runs, one beside the other; the runner's ratio is that of `make bench`.

    Two programs that share a processor's cache with others differ by more than two quiet machines: a factor of 2.5.
    """
    z = taught["recording"]
    times = best_times({way: partial(taught[way], z, 80) for way in ("in_pieces", "begun_early")}, 15)
    (said,) = re.findall(r"pieces begun early +some (\d+)", printed_by("who"))
    runner = float(lesson.times_as_fast()["in pieces"])
    assert 1 / 2.5 < runner * times["in_pieces"] / times["begun_early"] / float(said) < 2.5


def test_the_lines_of_the_table_are_in_the_order_of_what_they_gain():
    """From constant gain on: whoever stops at the first line that is true takes the fastest way open to him."""
    says("take the first line that is true for you")
    lines = printed_by("who").splitlines()[3:]
    numbers = [re.search(r" {2,}(?:some )?([\d,]+)(;.*)?$", line)[1].replace(",", "") for line in lines]
    assert list(map(float, numbers)) == sorted(map(float, numbers), reverse=True)


def test_the_measured_times_are_read_from_the_benchmarks():
    assert lesson.RESULTS == ROOT / "benchmarks" / "results.json"
    assert set(lesson.times_as_fast()) >= {"lfilter", "C", "Python numbers", "in pieces"}


def test_the_pieces_of_the_benchmark_are_those_of_the_lesson(taught):
    """`make bench` measures what is taught here."""
    text = (ROOT / "benchmarks" / "peers.py").read_text(encoding="utf-8")
    (cells,) = re.findall(r"TAUGHT = \(([^)]*)\)", text)
    names = {}
    for id in re.findall(r'"([^"]+)"', cells):
        exec(code_of(id), names)
    z = taught["recording"][:500]
    np.testing.assert_allclose(names["in_pieces"](z, 80), names["one_by_one"](z), rtol=0, atol=1e-9)
    np.testing.assert_allclose(names["begun_early"](z, 80)[0], names["one_by_one"](z), rtol=0, atol=1e-5)
