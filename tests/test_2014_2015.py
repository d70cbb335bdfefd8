"""The filters and recursions that the notebooks on 2014 and 2015 write out, against what shares nothing with them."""

import json
import re

import numpy as np
import pytest
from conftest import ROOT, part_one, source
from scipy.linalg import solve_discrete_are

import mpt_helpers as mpt
from reproduction import burden
from reproduction.papers_2014_2015 import article_2014

TRACKS, STEPS = 20_000, 60
ARTICLE = part_one(ROOT / "notebooks" / "2014_gsm_2d.ipynb")


def cells_of(key):
    return json.loads((ROOT / "notebooks" / f"{key}.ipynb").read_text(encoding="utf-8"))["cells"]


def code_of(id):
    (cell,) = (cell for cell in cells_of("2014_gsm_2d") if cell["id"] == id)
    return source(cell)


@pytest.fixture(scope="module")
def taught():
    """The names that the teaching cells of the notebook on 2014 define."""
    wanted = ["setup", "model", "kalman", "lainiotis", "run", "steady", "fir", "four", "joint"]
    code = {cell["id"]: source(cell) for cell in cells_of("2014_gsm_2d")}
    names = {}
    exec("\n".join(code[id] for id in wanted), names)
    return names


@pytest.fixture(scope="module")
def tracks(taught):
    """True states (STEPS, 2, TRACKS) and measurements with both H's, drawn without the package."""
    rng = np.random.default_rng(1)
    x, states = np.zeros((2, TRACKS)), []
    for _ in range(STEPS):
        x = taught["F"] @ x + taught["G"] * np.sqrt(taught["q"]) * rng.standard_normal(TRACKS)
        states.append(x)
    states = np.array(states)
    noise = np.sqrt(taught["r"]) * rng.standard_normal((STEPS, TRACKS))
    return states, states[:, 0] + states[:, 1] + noise, states[:, 0] + noise


def run_all(step, z):
    """Run a filter P -> (A, B, P) over many tracks of measurements (STEPS, TRACKS)."""
    x, P, estimates = np.zeros((2, z.shape[1])), np.zeros((2, 2)), []
    for z_k in z:
        A, B, P = step(P)
        x = A @ x + B * z_k
        estimates.append(x)
    return np.array(estimates)


def test_lainiotis_equals_kalman(taught):
    for P in (np.zeros((2, 2)), np.eye(2), np.array([[3.0, 1.0], [1.0, 2.0]])):
        for ours, theirs in zip(taught["lainiotis"](P), taught["kalman"](P), strict=True):
            np.testing.assert_allclose(ours, theirs, atol=1e-14)


def test_the_limit_solves_the_riccati_equation(taught):
    F, H, Q, R = (taught[name] for name in "FHQR")
    P_p = solve_discrete_are(F.T, H.T, Q, R)
    for step in (taught["kalman"], taught["lainiotis"]):
        _, _, P_e = taught["limit"](step)
        np.testing.assert_allclose(F @ P_e @ F.T + Q, P_p, rtol=1e-10)


def test_filters_of_the_notebook_are_those_of_the_package(taught):
    model = mpt.gsm_axis(dt=1.0, q=0.01, r=0.1)
    _, z = mpt.simulate(model, 40, np.random.default_rng(3))
    np.testing.assert_allclose(taught["run"](taught["kalman"], z), mpt.KalmanFilter(model).filter(z), atol=1e-13)
    A, B, _ = taught["limit"](taught["kalman"])
    steady = mpt.SteadyStateFilter.from_kalman(model)
    fir = mpt.FIRFilter.from_steady_state(steady, tol=1e-3)
    for step in (taught["sskf"], taught["sslf"]):
        np.testing.assert_allclose(taught["run"](step, z), steady.filter(z), atol=1e-13)
    M = taught["fir_order"](A, 1e-3)
    assert M == fir.order == 17
    np.testing.assert_allclose(taught["run_fir"](A, B, M, z), fir.filter(z), atol=1e-12)


@pytest.mark.parametrize(
    ("data", "own", "reported"),
    [
        ("paper", "paper", "eye"),
        ("usual", "usual", "eye"),
        ("usual", "paper", "eye"),
        ("paper", "usual", "eye"),
        ("usual", "paper", "F"),
    ],
)
def test_the_error_of_the_wrong_H_is_that_of_simulated_tracks(taught, tracks, data, own, reported):
    states, ahead, positions = tracks
    T = taught[reported]
    choices = {"paper": (taught["H"], ahead), "usual": (np.array([[1, 0]]), positions)}
    late, rest, stated = taught["true_error"](choices[data][0], choices[own][0], T)
    A, B, P = taught["limit"](lambda P: taught["kalman"](P, choices[own][0]))
    error = (states - T @ run_all(lambda P: (A, B, P), choices[data][1]))[30:, 0]
    rest_of_error = error - float(late.split()[0]) * states[30:, 1]
    assert abs(rest_of_error.mean()) < 0.005
    assert rest_of_error.std() == pytest.approx(float(rest), abs=0.002)
    assert float(stated) == pytest.approx(np.sqrt((T @ P @ T.T)[0, 0]), abs=0.0005)


def test_the_joint_covariance_is_that_of_simulated_tracks(taught, tracks):
    states, z, _ = tracks
    A, B, P = taught["limit"](taught["kalman"])
    both = [run_all(step, z) for step in (taught["kalman"], lambda _: (A, B, P))]
    exact = taught["joint"](taught["kalman"], lambda _: (A, B, P), STEPS, np.zeros((2, 2)))
    for k in (0, 1, 4, 20):
        seen = np.cov(np.vstack([states[k], both[0][k], both[1][k]]))
        np.testing.assert_allclose(seen, exact[k], atol=0.05 * np.abs(exact[k]).max())
        gap = np.std(both[0][k] - both[1][k], axis=1)
        C = np.kron([[0, 1, -1]], np.eye(2))
        np.testing.assert_allclose(gap, np.sqrt(np.diag(C @ exact[k] @ C.T)), rtol=0.05)


def test_the_gap_of_2014_is_that_of_2015(taught):
    model = mpt.gsm_axis(dt=1.0, q=0.01, r=0.1)
    A, B, P = taught["limit"](taught["kalman"])
    exact = taught["joint"](taught["kalman"], lambda _: (A, B, P), STEPS, np.zeros((2, 2)))
    C = np.kron([[0, 1, -1]], np.eye(2))
    steady = mpt.SteadyStateFilter.from_kalman(model)
    difference = mpt.metrics.error_moments(steady, model, STEPS).covariance - mpt.KalmanFilter(model).covariances(STEPS)
    np.testing.assert_allclose(C @ exact @ C.T, difference, atol=1e-11)


def test_the_innovations_of_the_late_filter_are_those_of_simulated_tracks(taught, tracks):
    states, _, positions = tracks
    names = dict(taught)
    exec(code_of("late"), names)
    nis, correlations, about_previous = names["late"]()
    A, B, P = taught["limit"](taught["kalman"])
    estimates = run_all(lambda _: (A, B, P), positions)
    F, H, Q, r = (taught[name] for name in ("F", "H", "Q", "r"))
    S = (H @ (F @ P @ F.T + Q) @ H.T).item() + r
    innovations = positions[31:] - np.einsum("j,kjM->kM", (H @ F)[0], estimates[30:-1])
    assert (innovations**2).mean() / S == pytest.approx(nis, abs=0.004)
    for lag in (1, 2, 4):
        seen = (innovations[lag:] * innovations[:-lag]).mean() / (innovations**2).mean()
        assert seen == pytest.approx(correlations[lag - 1], abs=0.004)
    assert (states[30:-1, 0] - estimates[31:, 0]).std() == pytest.approx(about_previous, abs=0.001)


def test_what_fir_drops_in_example_1_is_that_of_simulated_tracks(taught, tracks):
    _, z, _ = tracks
    names = dict(taught)
    A, B, P = taught["limit"](taught["kalman"])
    names |= {"A": A, "B": B, "M": 17, "P0": np.zeros((2, 2)), "sigma": np.sqrt(np.diag(P))}
    names["steps"] = {"SSKF": lambda _: (A, B, P)}
    exec(code_of("fir-close"), names)
    estimates = run_all(lambda _: (A, B, P), z)
    for k in (18, 30, 60):
        seen = np.linalg.matrix_power(A, 17) @ estimates[k - 17 - 1]
        np.testing.assert_allclose(names["dropped"][k] * names["sigma"], seen.std(axis=1), rtol=0.03)
    assert not names["dropped"][:18].any()


@pytest.fixture(scope="module")
def article():
    """The names that the cells of Part I define."""
    names = {}
    for id in ("one-kalman", "constants"):
        exec(code_of(id), names)
    return names


def kalman_filter(article, z):
    """The last x and P of a textbook Kalman filter over z, from an unknown start."""
    x, P = np.zeros(2), 100 * np.eye(2)
    F, H, Q, R = article["F"], article["H"], article["Q"], article["r"] * np.eye(1)
    for z_k in z:
        x, P = F @ x, F @ P @ F.T + Q
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        x, P = x + K @ (z_k - H @ x), P - K @ H @ P
    return x, P


def test_the_constants_over_one_step_are_those_of_the_paper(article, taught):
    for ours, name in zip(article["constants"](1), ("Fn", "Kn", "Km", "Pn", "On"), strict=True):
        np.testing.assert_allclose(ours, taught[name], atol=1e-14)


@pytest.mark.parametrize("L", [1, 2, 7, 60])
def test_the_lainiotis_filter_over_several_steps_is_the_kalman_filter(article, L):
    Fn, Kn, Km, Pn, On = article["constants"](L)
    z = np.random.default_rng(1).standard_normal(L)
    x, P = kalman_filter(article, z)
    A = Fn @ np.linalg.inv(np.eye(2) + 100 * On)
    np.testing.assert_allclose(A @ (100 * Km @ z) + Kn @ z, x, atol=1e-11)
    np.testing.assert_allclose(Pn + A @ (100 * Fn.T), P, atol=1e-11)


def test_a_track_in_pieces_ends_as_a_track_in_one(article, capsys):
    names = article | {"article": article_2014}
    exec(code_of("pieces"), names)
    x, _ = kalman_filter(article, article_2014.walk(1200)[1])
    for steps, said in zip((1200, 40), capsys.readouterr().out.splitlines(), strict=True):
        assert said == f"{steps} steps in order: position {x[0]:.3f} m, velocity {x[1]:.4f} m/s"


@pytest.mark.parametrize(
    ("id", "placeholder", "right", "wrong"),
    [
        (
            "exercise-h",
            "mine = None",
            "mine = np.linalg.lstsq(states, measured, rcond=None)[0]",
            "mine = np.array([1, 1])",
        ),
        (
            "exercise-lainiotis",
            "    return None",
            """    S = H @ Q @ H.T + r
    Kn, Km = Q @ H.T / S, F.T @ H.T / S
    Fn, Pn, On = F - Kn @ H @ F, Q - Kn @ H @ Q, Km @ H @ F
    A = Fn @ np.linalg.inv(np.eye(2) + P @ On)
    return A @ (x + P @ Km @ z) + Kn @ z, Pn + A @ P @ Fn.T""",
            "    return x, P",
        ),
        ("exercise-m", "M = 17", "M = 33", "M = 18"),
    ],
)
def test_an_exercise_can_be_solved_and_only_solved(article, capsys, id, placeholder, right, wrong):
    """As committed it says that it is not yet solved; a solution passes and a wrong one fails its assert."""
    cell = code_of(id)
    assert cell.count(placeholder) == 1
    names = article | {"article": article_2014}
    for answer, said in ((placeholder, "not yet"), (right, "right")):
        exec(cell.replace(placeholder, answer), dict(names))
        assert said in capsys.readouterr().out
    with pytest.raises(AssertionError):
        exec(cell.replace(placeholder, wrong), dict(names))


def test_the_walk_has_the_speed_that_the_article_says():
    (said,) = re.findall(r"walks at ([\d.]+) to ([\d.]+) m/s", ARTICLE)
    states, measured = article_2014.walk()
    assert said == tuple(f"{each(states[:, 1]):.1f}" for each in (np.min, np.max))
    assert (measured - states[:, 0]).std() == pytest.approx(np.sqrt(0.1), rel=0.2)


def test_a_step_of_the_article_is_that_of_the_textbook(article):
    x, P = article_2014.kalman_step(np.zeros(2), 100 * np.eye(2), 3.5)
    for ours, textbook in zip((x, P), kalman_filter(article, [3.5]), strict=True):
        np.testing.assert_allclose(ours, textbook, atol=1e-12)


def output_of(id):
    """What a cell of the notebook on 2014 prints or shows as text."""
    (cell,) = (cell for cell in cells_of("2014_gsm_2d") if cell["id"] == id)
    texts = ["".join(out.get("text", out.get("data", {}).get("text/plain", ""))) for out in cell["outputs"]]
    return "\n".join(texts)


@pytest.mark.parametrize(
    ("said", "id", "computed"),
    [
        (r"Here it is (0\.94):", "late-test", r"mean NIS (0\.94)35"),
        (r"needs some (2,3)00 steps", "late-test", r"50 % in (2 ?3)20"),
        (r"About \*that\* state its error is (0\.169) m", "late-test", r"about x\(k-1\) (0\.169)"),
        (r"its honest σ is (0\.234) m", "four", r"(?m)^\[1 0\] +\[1 0\] .* (0\.234) +0\.234"),
        (r"its error is (0\.234) m too", "four", r"F x\(k/k\) +0 Δt v +(0\.234) "),
        (r"(-4\.3) and -2\.5", "late-test", r"known start (4\.3) σ"),
        (r"z lies v Δt = (1\.5) m ahead on average", "exercise-h", r"lies (1\.5) m ahead"),
        (r"the phone is put at (2\.99) m", "one-kalman", r"position (2\.99) m"),
        (r"is a step late, (nine) stated σ", "late-test", r"error (8\.9) σ"),
        (r"as good as uncorrelated \(below (0\.02)\)", "late-test", r"innovations (0\.019) at most"),
        (r"After (6) steps from a known start", "close-table", r"very close from step: (7) for 0 I"),
        (r"(0\.73) mm of the position for each metre", "fir-close", r"at rest: (0\.73) mm short per metre"),
        (r"passes σ at step (270)", "fir-close", r"σ at step (270)"),
        (r"M = (17)\.", "fir-count", r"M = (17)"),
        (r"takes (268) operations \(printed: 108; model A\)", "fir-count", r"model A +108 +(268)"),
        (r"every (7)th step", "fir-count", r"model A .* (7)$|model A .* (7)\n"),
        (r"All (125) legible ratios", "table4-origin", r"(125) of 125 legible"),
        (r"With these (71) ratios", "table4-size", r"counted +(71)"),
        (r"wrong: (14) by less than 3 %", "table4-size", r"counted +71 +(14)"),
        (r"(1191) → 1207", "table4-origin", r"JKLF A: \[(1191)\]; Table 3 prints 1207, counted 1207"),
        (r"(640) → 336", "table4-origin", r"JKLF B: \[(640)\]; Table 3 prints 326, counted 336"),
        (r"(118) → 96", "table4-origin", r"JSSKLF A: \[(118)\]; Table 3 prints 96, counted 96"),
        (r"(98) → 48", "table4-origin", r"JSSKLF B: \[(98)\]; Table 3 prints 44, counted 48"),
        (r"3 %, (27) by more than half", "table4-size", r"counted +71 +14 +(27)"),
        (r"totals of Table 3 \((326) for 336", "table4-origin", r"JKLF B: \[640\]; Table 3 prints (326), counted 336"),
        (r"336, (44) for 48\)", "table4-origin", r"JSSKLF B: \[98\]; Table 3 prints (44), counted 48"),
    ],
)
def test_a_number_of_the_article_is_computed_in_the_evidence(said, id, computed):
    (number,) = re.findall(said, ARTICLE)
    found = next(group for group in re.search(computed, output_of(id)).groups() if group)
    rounded = {"8.9": "nine", "0.019": "0.02", "7": "6" if "After" in said else "7", "4.3": "-4.3"}
    assert number.replace(",", "") == rounded.get(found, found)


def test_the_fir_filter_is_close_as_long_as_the_article_says():
    (said,) = re.findall(r"stays below σ/10 for (\d+) steps", ARTICLE)
    assert f"it passes 0.1 σ at step {int(said) + 1}," in output_of("fir-close")


def test_the_clock_of_the_article_is_the_measured_one():
    """Its table has the ratio of the paper's Table 3, then what `make bench` measured last, to two digits.

    The last row is the time of a long track with gaps, run in pieces, over that of a filterpy loop.
    """
    results = json.loads((ROOT / "benchmarks" / "results.json").read_text())
    measured = results["speedups"]["2014_gsm_2d"]["kf-lf-a"]
    ratios = [670 / 509, measured["one"], measured["own"]]
    (long,) = (
        row
        for row in results["rows"]
        if row["work"] == "one track, 4 states, 12,000 rows" and row["against"].endswith("filterpy loop")
    )
    ratios.append(1 / long["ratio"])
    said = re.findall(r"(?m)^\| (?:.*?) \| ([\d.]+) \|$", code_of("clock"))
    assert said == [f"{each:.2g}" for each in ratios]


def test_the_variances_of_the_article_are_those_of_its_filters(taught):
    """S of the paper's filter, what its innovations have, and S with the right H; the process noise of one step."""
    names = dict(taught)
    exec(code_of("late"), names)
    F, H, G, Q, q, r = (taught[name] for name in ("F", "H", "G", "Q", "q", "r"))
    S = []
    for each in (H, np.array([[1, 0]])):
        S.append((each @ solve_discrete_are(F.T, each.T, Q, taught["R"]) @ each.T).item() + r)
    nis, _, _ = names["late"]()
    said = re.search(r"states S = ([\d.]+) m², its innovations have ([\d.]+) m² \(([\d.]+) with the right H", ARTICLE)
    assert said.groups() == tuple(f"{each:.3f}" for each in (S[0], nis * S[0], S[1]))
    (said,) = re.findall(r"process noise of one step: .* = ([\d.]+) m² beside r = 0\.1 m²", ARTICLE)
    assert float(said) == pytest.approx((q * (np.array([1, 0]) @ G) ** 2).item())
    assert r == 0.1


def test_a_start_known_to_be_moving_alarms_as_long_as_the_article_says(article):
    """Mean innovations of the paper's filter from the true state, over their sigma, at 1.5 m/s, of positions."""
    (said,) = re.findall(r"the delay for two steps \((.*?) σ at 1\.5 m/s\)", ARTICLE)
    F, H, Q, r = (article[name] for name in ("F", "H", "Q", "r"))
    x, P = np.array([0, 1.5]), np.zeros((2, 2))
    means = []
    for position in 1.5 * np.arange(1, 7):
        x, P = F @ x, F @ P @ F.T + Q
        S = (H @ P @ H.T).item() + r
        K = (P @ H.T)[:, 0] / S
        innovation = position - (H @ x).item()
        means.append(innovation / np.sqrt(S))
        x, P = x + K * innovation, P - np.outer(K, H @ P)
    assert re.findall(r"-?[\d.]+", said) == [f"{each:.1f}" for each in means[:2]]
    assert [abs(each) > 2 for each in means] == [True, True] + 4 * [False]  # two steps of alarm


def test_measured_less_reported_is_the_delay_and_nothing_with_the_right_H():
    """On a long walk: v Δt within the noise of the paper's filter, and zero of the filter of positions."""
    states, measured = article_2014.walk(2000)
    axis = mpt.gsm_axis(1.0, 0.01, 0.1, P0=100 * np.eye(2))
    right = mpt.LinearModel(F=axis.F, H=[[1, 0]], Q=axis.Q, R=axis.R, P0=axis.P0)
    ahead, nothing = (measured - mpt.KalmanFilter(each).filter(measured[:, None])[:, 0] for each in (axis, right))
    error = 0.32 / np.sqrt(2000)  # of a mean; innovations of both filters are as good as independent
    assert np.mean(ahead - states[:, 1]) == pytest.approx(0, abs=4 * error)
    assert np.mean(nothing) == pytest.approx(0, abs=4 * error)


def test_fir_against_one_product_costs_what_the_article_says():
    (said,) = re.findall(r"FIR costs the same at (\d+), less from (\d+) on", ARTICLE)
    equal, less = map(int, said)
    for n, m in ((4, 2), (2, 1)):
        fir = burden.total(burden.fir(n, m, 17))
        costs = {L: burden.total(burden.lifted(n, m, L)) for L in range(1, 30)}
        assert [L for L, cost in costs.items() if cost == fir] == [equal]
        assert min(L for L, cost in costs.items() if cost > fir) == less
