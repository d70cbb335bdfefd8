"""The lesson `a_track_in_pieces`: its filters, each number in its prose, and hunts for cases that refute its sentences.

A text in `says` has its numbers put in by the test, so that a number that changes makes it fail.
"""

import json
import re
from functools import partial
from time import process_time

import numpy as np
import pytest
from conftest import ROOT
from reading import Article
from scipy.linalg import expm

import mpt_helpers as mpt
from reproduction.papers_2014_2015 import lesson_a_track_in_pieces as lesson


def plain(text):
    """A text without markup, in one line; [1\\ \\ 0] is [1 0]."""
    return re.sub(r"\s+", " ", re.sub(r"\\ ", " ", re.sub(r"[*$]", "", text)))


LESSON = Article("lessons/a_track_in_pieces", plain)
says, code_of, printed_by = LESSON.says, LESSON.code_of, LESSON.printed_by
FILTERS = ("filter", "pretend", "mend-code", "in-pieces")  # the cells that define them
NOW = np.array([[1.0, 0.0]])
F = np.array([[1.0, 1.0], [0.0, 1.0]])
Q = 0.01 * np.outer([0.5, 1], [0.5, 1])


@pytest.fixture(scope="module")
def taught():
    """The names that the lesson defines: its filters and its recordings."""
    names = {}
    for id in FILTERS:
        exec(code_of(id), names)
    exec(code_of("recording").partition("for name")[0], names)  # but for the comparison
    return names


def with_model(F, Q, H=NOW):
    """The lesson's functions for another model."""
    names = {}
    for id in FILTERS:
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


def test_the_loop_is_the_filter_of_the_package_by_the_lines_that_the_lesson_gives(taught):
    z = taught["recordings"]["50% missing"][:300]
    call, model = re.findall(r"`(?:model = )?(mpt\.[LK].*?)`", "".join(LESSON.cell("digits")["source"]))
    expected = eval(call, {"mpt": mpt, "model": eval(model, {"mpt": mpt, **taught}), "z": z})
    np.testing.assert_allclose(taught["one_by_one"](z), expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(taught["Q"], Q)


def test_the_recordings(taught):
    speed = np.abs(1.5 + np.cumsum(np.random.default_rng(14).normal(0, 0.1, 10_000)))
    assert f"# its speed wanders up to {speed.max():.0f} m/s" in code_of("recording")
    for name, share in {"5% missing": 0.05, "50% missing": 0.5}.items():
        assert np.isnan(taught["recordings"][name]).mean() == pytest.approx(share, abs=0.01)


# The relay


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
    says("Each is the real start plus the noise of one measurement.")
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


def test_the_pretended_pieces_of_the_picture_end_too_low():
    says("Each pretended piece starts at 0 and at rest, sure of both, climbs, and ends too low.")
    *_, hollow, filled = lesson.draw_relay().axes[1].lines
    assert (hollow.get_ydata() < filled.get_ydata()[1:] - 1).all()
    assert (hollow.get_ydata() > 1).all()


def test_what_the_surprises_of_a_piece_see():
    """By the lines of the filter from a certain start, and without the lesson's."""
    P, T, seen = np.zeros((2, 2)), np.eye(2), []
    for _ in range(80):
        P = F @ P @ F.T + Q
        h, K = (F @ T)[0], P[:, [0]] / (P[0, 0] + 0.1)
        seen.append(h)
        T, P = F @ T - K * h, P - K * P[0]
    np.testing.assert_array_equal(seen[0], [1, 1])
    says("At the first row h = HF = [1 1]: the surprise sees the position of the start and a second of its velocity.")
    says("The next rows see more of the velocity, and together they say where the piece began, and how fast.")
    assert seen[0][1] < seen[1][1] < seen[2][1]


def test_the_noises_of_the_surprises_are_independent():
    """The covariance of all surprises of a piece that starts exactly, without a filter's lines: diagonal, and S."""
    says("These noises are uncorrelated.")
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
    says("With pieces of one measurement all this is the filter of Lainiotis")
    z = 1.7
    X, T, P, t, information = taught["pretend"]([(z, 0.1)])
    S = (NOW @ Q @ NOW.T).item() + 0.1
    Kn, Km = Q @ NOW.T / S, F.T @ NOW.T / S
    pairs = ((X, Kn * z), (t, Km * z), (T, F - Kn @ NOW @ F), (P, Q - Kn @ NOW @ Q), (information, Km @ NOW @ F))
    for ours, paper in pairs:
        np.testing.assert_allclose(ours, paper, atol=1e-14)


@pytest.mark.parametrize("L", [1, 2, 7, 60, 200])
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


def test_the_cell_that_compares_says_that_all_agree(taught):
    printed = re.findall(r"within a nanometre of the loop, (\d+) km from the start: (\w+)", printed_by("recording"))
    assert printed == [(f"{taught['truth'][-1] / 1000:.0f}", "True")] * 2


def test_four_unknowns_of_the_lesson_mix_and_agree(taught):
    assert printed_by("waggons").strip() == "four unknowns, within a nanometre: True"
    names = {**taught, "z": taught["complete"][:200]}
    exec(code_of("waggons"), names)
    assert (np.abs(names["F"][:2, 2:]) > 0.01).all()


def test_the_other_ways_of_the_table_are_the_loop(taught):
    assert re.findall(r"nanometre[^:]*: (\w+)", printed_by("others")) == ["True", "True"]
    exec(code_of("others").partition("z = recordings")[0], taught)
    z = with_gaps(np.random.default_rng(3), 400)
    np.testing.assert_allclose(taught["in_numbers"](z), taught["one_by_one"](z), rtol=0, atol=1e-9)


def test_what_is_measured_must_not_be_known_exactly_one_row_after_a_pretended_start(taught):
    says("with r = 0 and H Q H^T = 1e-12 m² the result can be metres off.")
    z, off = taught["recordings"]["50% missing"], {}
    for s in (1e-4, 1e-12):
        names = with_model(F, np.diag([s, 0.01]))
        names["noise"] = 0.0
        with np.errstate(all="ignore"):
            off[s] = np.abs(names["in_pieces"](z, 5) - names["one_by_one"](z))[:, 0].max()
    assert off[1e-4] < 1e-6
    assert off[1e-12] > 1


def test_the_best_length_of_a_piece():
    N = 10_000
    steps = {L: N / L + 2 * L for L in range(1, N)}
    best = min(steps, key=steps.get)
    says("Their sum is smallest at L = \\sqrt{N/2}, about 70 here. Near it little changes.")
    says(f"It is {round(steps[best])} steps in place of 10,000")
    assert best == round(np.sqrt(N / 2))
    assert round(best, -1) == 70
    assert steps[80] < 1.01 * steps[best]


def test_several_measurements_a_row_take_an_inverse_and_a_huge_variance():
    """Of a track in two axes, filtered in pieces."""
    says("the division becomes an inverse between the factors")
    says("`P @ H.T @ inv(S)`, `h.mT @ inv(S) @ e`, `h.mT @ inv(S) @ h`")
    says("Take 1e30 in place of an infinite variance.")
    code = "\n".join(map(code_of, FILTERS)).replace("H.T / (H @ P @ H.T + r)", "H.T @ inv(H @ P @ H.T + r)")
    for divided, inverted in {
        "P @ H.T / S": "P @ H.T @ inv(S)",
        "h.mT @ e / S": "h.mT @ inv(S) @ e",
        "h.mT @ h / S": "h.mT @ inv(S) @ h",
    }.items():
        assert divided in code
        code = code.replace(divided, inverted)
    names = {"inv": np.linalg.inv}
    exec(code, names)
    names |= {name: np.kron(np.eye(2), matrix) for name, matrix in (("F", F), ("Q", Q), ("H", NOW))} | {"n": 4}
    model = mpt.LinearModel(F=names["F"], H=names["H"], Q=names["Q"], R=0.1 * np.eye(2), P0=100 * np.eye(4))
    _, z = mpt.simulate(model, 30, np.random.default_rng(3))
    z[10:14] = np.nan
    rows = [(np.nan_to_num(z_k)[:, None], (1e30 if np.isnan(z_k[0]) else 0.1) * np.eye(2)) for z_k in z]
    x, P = np.zeros((4, 1)), 100 * np.eye(4)
    X, T, _, *evidence = names["pretend"](rows)
    mended, _ = names["mend"](x, P, *evidence)
    for row in rows:
        x, P = names["step"](x, P, *row)
    expected = mpt.KalmanFilter(model).filter(z)[-1]
    np.testing.assert_allclose(x[:, 0], expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose((X + T @ mended)[:, 0], expected, rtol=0, atol=1e-9)


# Times


def test_the_table_says_what_was_measured():
    rows = json.loads((ROOT / "benchmarks" / "results.json").read_text(encoding="utf-8"))["rows"]
    ms = {
        row["against"].split(": ")[1]: row["against_ms"] for row in rows if row["work"].endswith("as taught: in pieces")
    }
    ms["in pieces"] = next(row["ms"] for row in rows if row["work"].endswith("as taught: in pieces"))
    for way, name in {
        "constant gain, by `scipy.signal.lfilter` (the position; the first rows differ)": "lfilter",
        "the loop in C": "C",
        "the loop in Python's own numbers, written out": "Python numbers",
    }.items():
        to_one_digit = float(f"{ms['plain loop of numpy'] / ms[name]:.0e}")
        says(f"| {way} | {to_one_digit:,.0f}")


def times_as_fast(way, other, rounds):
    """How many times as fast the first function is as the other: the least processor times, in turns.

    Other programs take wall time, but hardly processor time, and a busy second strikes both.
    """
    times = {way: [], other: []}
    for _ in range(rounds):
        for each, found in times.items():
            start = process_time()
            each()
            found.append(process_time() - start)
    return min(times[other]) / min(times[way])


@pytest.mark.parametrize(("unknowns", "said"), [(4, 9), (12, 4)])
def test_pieces_are_faster_than_the_loop_and_gain_less_with_more_unknowns(taught, unknowns, said):
    """Within a factor of two, since machines, numpy's builds and other programs differ by as much."""
    says("| pieces with the runner | 9 with four, 7 with six, 4 with twelve; for 1,000 rows half of that |")
    z = taught["recordings"]["5% missing"]
    blocks = np.eye(unknowns // 2)
    H = np.random.default_rng(unknowns).standard_normal((1, unknowns))
    names = with_model(np.kron(blocks, F), np.kron(blocks, Q), H)
    part = 500  # of the 10,000 rows, for the loop, which takes twenty times as long over all
    ratio = times_as_fast(partial(names["in_pieces"], z, 80), partial(names["one_by_one"], z[:part]), 7)
    assert said / 2 < ratio * len(z) / part < 2 * said
    of_1000 = times_as_fast(partial(names["in_pieces"], z[:1000], 22), partial(names["one_by_one"], z[:part]), 7) * 2
    assert said / 4 < of_1000 < said


def written_out(F, Q, H, r=0.1):
    """The loop of a model in Python's own numbers, as code with each product written out; P by its upper half."""
    n = range(len(F))

    def total(numbers, names):
        return " + ".join(f"{float(number)!r} * {name}" for number, name in zip(numbers, names, strict=True) if number)

    def p(i, j):
        return f"p{min(i, j)}{max(i, j)}"

    upper = [(i, j) for i in n for j in n if i <= j]
    x = [f"x{i}" for i in n]
    lines = [f"{', '.join(x)} = {', '.join(total(F[i], x) for i in n)}"]
    lines += [f"m{i}{j} = {total(F[i], [p(k, j) for k in n])}" for i in n for j in n]
    lines += [f"p{i}{j} = {total(F[j], [f'm{i}{k}' for k in n])} + {float(Q[i, j])!r}" for i, j in upper]
    correct = [f"g{i} = {total(H[0], [p(i, k) for k in n])}" for i in n]
    correct += [f"s = 1 / ({total(H[0], [f'g{i}' for i in n])} + {r})", f"e = (z - ({total(H[0], x)})) * s"]
    correct += [f"x{i} += g{i} * e" for i in n]
    correct += [f"p{i}{j} -= g{i} * s * g{j}" for i, j in upper]
    start = [f"x{i} = 0.0" for i in n] + [f"p{i}{j} = {100.0 * (i == j)}" for i, j in upper]
    body = [*lines, "if z == z:", *(f"    {each}" for each in correct), f"found.append(({', '.join(x)}))"]
    names = {}
    code = ["def run(zs):", *(f"    {each}" for each in ["found = []", *start, "for z in zs:"])]
    exec("\n".join([*code, *(f"        {each}" for each in body), "    return found"]), names)
    return names["run"]


@pytest.mark.parametrize(("unknowns", "chain", "said"), [(4, True, 10), (4, False, 6), (6, False, 2)])
def test_plain_numbers_lose_their_lead_with_more_unknowns(taught, unknowns, chain, said):
    """A chain is position, velocity, acceleration and jerk; the others all mix."""
    says("| 30 with two, 10 with four |")
    rng = np.random.default_rng(unknowns)
    mixing = np.eye(unknowns) + 0.1 * rng.standard_normal((unknowns, unknowns))
    mixing *= 0.98 / np.abs(np.linalg.eigvals(mixing)).max()
    H = rng.standard_normal((1, unknowns))
    if chain:
        mixing, H = expm(np.eye(unknowns, k=1)), np.eye(1, unknowns)
    names = with_model(mixing, 0.01 * np.eye(unknowns), H)
    z = taught["recordings"]["5% missing"][:500]
    run = written_out(names["F"], names["Q"], names["H"])
    np.testing.assert_allclose(run(z.tolist()), names["one_by_one"](z), rtol=0, atol=1e-7)
    ratio = times_as_fast(partial(run, z.tolist()), partial(names["one_by_one"], z), 7)
    assert said / 2 < ratio < 2 * said


def test_a_step_of_a_hundred_pieces_takes_a_few_times_as_long_as_of_one(taught):
    says("a step of a hundred pieces takes only a few times as long as a step of one")
    one = np.ones((2, 1)), np.eye(2), np.ones((1, 1)), np.full((1, 1), 0.1)
    many = [np.repeat(each[None], 100, axis=0) for each in one]

    def steps(of):
        for _ in range(20):
            taught["step"](*of)

    assert 1.5 < times_as_fast(lambda: steps(one), lambda: steps(many), 20) < 8


def test_the_pieces_of_the_benchmark_are_those_of_the_lesson():
    """`make bench` measures what is taught here."""
    text = (ROOT / "benchmarks" / "peers.py").read_text(encoding="utf-8")
    (cells,) = re.findall(r"TAUGHT = \(([^)]*)\)", text)
    assert set(re.findall(r'"([^"]+)"', cells)) == set(FILTERS)
