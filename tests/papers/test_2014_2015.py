"""The filters and recursions that the notebooks on 2014 and 2015 write out, against what shares nothing with them."""

import re
import tomllib

import numpy as np
import pytest
from conftest import ROOT
from reading import Article
from scipy.linalg import solve_discrete_are

import mpt_helpers as mpt
from reproduction import burden, published
from reproduction.ledger import stored_verdicts

TRACKS, STEPS = 20_000, 60


code_of = Article("2014_gsm_2d").code_of


@pytest.fixture(scope="module")
def taught():
    """The names that the teaching cells of the notebook on 2014 define."""
    wanted = ["setup", "model", "kalman", "lainiotis", "run", "steady", "conditional", "fir", "four", "joint"]
    names = {}
    exec("\n".join(map(code_of, wanted)), names)
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


def test_the_conditional_mean_is_that_of_the_package(taught):
    model = mpt.gsm_axis(dt=1.0, q=0.01, r=0.1)
    _, z = mpt.simulate(model, 12, np.random.default_rng(5))
    means, covariances = taught["conditional"](z)
    expected = mpt.KalmanFilter(model).estimates(z)
    np.testing.assert_allclose(means, expected.x, atol=1e-12)
    np.testing.assert_allclose(covariances, expected.P, atol=1e-12)


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


# What the verdicts say, with its numbers put in here


BOTH = {"2014_gsm_2d": 2, "2015_mpt_3d": 3}  # papers and their axes


@pytest.fixture(scope="module")
def verdicts():
    """The verdicts of both notebooks, {key: {id: verdict}}."""
    return {key: {each.id: each for each in stored_verdicts(ROOT / "notebooks" / f"{key}.ipynb")} for key in BOTH}


@pytest.fixture(scope="module")
def settled():
    """The package's steady-state filter of one axis of Example 1, and its norms ‖A^k‖, {name of the norm: list}."""
    steady = mpt.SteadyStateFilter.from_kalman(mpt.gsm_axis(dt=1.0, q=0.01, r=0.1))
    powers = [np.linalg.matrix_power(steady.A, k) for k in range(1, 30)]
    columns = {"1-norm": 0, "infinity-norm": 1}
    norms = {name: [np.abs(each).sum(axis=axis).max() for each in powers] for name, axis in columns.items()}
    norms["2-norm"] = [np.sqrt(np.linalg.eigvalsh(each.T @ each).max()) for each in powers]
    norms["Frobenius norm"] = [np.sqrt((each**2).sum()) for each in powers]
    return steady, norms


def first_below(norms, limit=1e-3):
    return 1 + next(i for i, each in enumerate(norms) if each < limit)


@pytest.mark.parametrize("key", BOTH)
def test_what_z_leaves_out_of_the_next_position_is_the_push(key, verdicts):
    dt, q = 1.0, 0.01
    F, G, H = np.array([[1, dt], [0, 1]]), np.array([0.5 * dt, 1]), np.array([1, dt])
    x, w = np.array([2.0, -3.0]), 0.7
    assert (F @ x + G * w)[0] - H @ x == pytest.approx(0.5 * dt * w)
    found = verdicts[key]["measured"]
    assert "push" in found.computed
    assert f"with a σ of {100 * 0.5 * dt * np.sqrt(q):g} cm" in found.computed
    assert found.reason == published(key).causes["measured"].sentence
    assert "predicted one step ahead, without the push ½ Δt w(k)" in found.reason
    assert found.verdict == "differs"


@pytest.mark.parametrize("key", BOTH)
def test_the_first_gap_beside_the_filters_own_sigma(key, verdicts, settled):
    """At step 1 from a known start: P = Q, updated; the gap is the difference of the gains times the innovation."""
    steady, _ = settled
    model = steady.model
    S = (model.H @ model.Q @ model.H.T + model.R).item()
    K = model.Q @ model.H.T / S
    own = np.sqrt((model.Q - K @ model.H @ model.Q)[0, 0])
    gap = abs(steady.B[0, 0] - K[0, 0]) * np.sqrt(S)
    share = gap / np.sqrt(steady.P[0, 0])
    expected = f"{share:.2f} σ at most, at step 1: {100 * gap:.0f} cm of position, {gap / own:.1f} times the "
    expected += f"time-invariant filter's own σ there, {100 * own:.1f} cm"
    assert expected in verdicts[key]["behaviour.3"].computed


def test_the_order_of_fir_in_four_norms_for_both_models(verdicts, settled):
    _, norms = settled
    # Two axes: columns and rows of a block, its largest stretch, √2 times its entries.
    orders = {
        name: {first_below(each), first_below(np.multiply(each, np.sqrt(2) if name[0] == "F" else 1))}
        for name, each in norms.items()
    }
    assert all(len(each) == 1 for each in orders.values())
    for name, (order,) in orders.items():
        assert f"{name} {order}" in verdicts["2014_gsm_2d"]["fir.order"].reason
    (frobenius,) = orders["Frobenius norm"]
    assert f"the Frobenius norm gives {frobenius}." in questions("2014_gsm_2d")["fir.order"]
    assert {order for name, (order,) in orders.items() if name[0] != "F"} == {17}


def questions(key):
    """The questions of papers.toml to the authors of a paper, with their lookups as they stand."""
    return tomllib.loads((ROOT / "docs" / "papers.toml").read_text(encoding="utf-8"))["questions"][key]


def test_before_step_M_eq_22_lacks_what_eq_21_has_of_the_start(verdicts, settled):
    steady, norms = settled
    M, start = first_below(norms["2-norm"]), np.array([5.0, -1.0])
    z = np.random.default_rng(22).normal(0, 1, (M + 5, 1))
    x, alone, off = start, np.zeros(2), []
    for z_k in z:
        x, alone = steady.A @ x + steady.B @ z_k, steady.A @ alone + steady.B @ z_k  # from x0, and from 0
        off.append(np.abs(x - alone).max())
    found = verdicts["2014_gsm_2d"]["eq22.range"]
    assert found.verdict == "reproduced"
    assert f"calls for {M - 1} measurements before z(1)" in found.reason
    assert f"lacks A^k x0 of Eq. 21: {max(off[: M - 1]):.2f} m for x0 = [5.0, -1.0]" in found.beyond
    before = norms["2-norm"][: M - 1]
    assert f"‖A^k‖ from {max(before):.2g} to {min(before):.2g}" in found.beyond
    assert min(before) >= 1e-3
    assert verdicts["2014_gsm_2d"]["fir.start"].verdict == "reproduced"
    assert (
        f"from x0 = 0, as in Example 1, and {max(off[: M - 1]):.2f} m" in verdicts["2014_gsm_2d"]["fir.start"].computed
    )
    assert f"the present one and the {M - 1} before it" in verdicts["2014_gsm_2d"]["fir.remark2"].reason


def test_the_cost_of_fir_in_the_ledger_is_that_of_its_operations(verdicts):
    """Eq. 22 one multiplication and addition at a time, for any order."""
    own = verdicts["2014_gsm_2d"]
    for part, n, m, filters, printed in (("a", 4, 2, 1, lambda M: 40 + 4 * M), ("b", 2, 1, 2, lambda M: 16 + 4 * M)):
        counts = {M: filters * (M * (n * m + n * (m - 1)) + (M - 1) * n) for M in range(1, 101)}
        line = re.match(r"(\d+)M - (\d+) operations at M = 1 ... 100;", own[f"table6.fir.{part}"].computed)
        assert all(int(line[1]) * M - int(line[2]) == count for M, count in counts.items())
        right = [M for M, count in counts.items() if printed(M) == count]
        said = f"as printed at M = {right[0]} only" if right else "as printed at none of these"
        assert own[f"table6.fir.{part}"].computed.endswith(said)
        assert own[f"mu.{part}"].computed.startswith(f"({line[1]}M - {line[2]})/")
        assert str(counts[17]) in published("2014_gsm_2d").causes["fir-cost"].sentence


@pytest.mark.parametrize(("key", "axes"), BOTH.items())
def test_the_sums_of_table_3_are_those_that_its_cause_writes_out(key, axes):
    counted = burden.twelve(axes)
    sentence = published(key).causes["table3-join"].sentence
    for name, pair, join in (("JKLF", ("KF", "LF"), 2**2 + 3 * 2), ("JSSKLF", ("SSKF", "SSLF"), 2 * 2)):
        first, second = (counted[f"{each} B"] for each in pair)
        total = counted[f"{name} B"]
        assert first + second + axes * join == total
        assert f"{first} + {second} + {axes} · {join} = {total}" in sentence


def test_a_lost_cell_says_what_is_right_if_it_prints_what_fits(verdicts):
    """The four counts behind Table 4 against those of Table 2: what our copy would print where it has lost a cell."""
    right = list(burden.twelve(axes=2).values())
    behind = right.copy()
    behind[2], behind[5], behind[8], behind[11] = 1191, 118, 640, 98
    lost = [each for each in verdicts["2014_gsm_2d"].values() if each.printed == "?"]
    said = 0
    for each in lost:
        i, j = (int(part) - 1 for part in each.id.split(".")[1:])
        would, should = f"{behind[i] / behind[j]:.3f}", f"{right[i] / right[j]:.3f}"
        expected = f"; if it prints {would}, {should} is right" if would != should else ""
        assert each.reason == f"our copy has lost this cell{expected}"
        said += bool(expected)
    assert (len(lost), said) == (7, 3)


def test_a_speedup_that_changes_the_filter_says_that_of_the_same_filter(verdicts):
    for key, axes in BOTH.items():
        counted = burden.twelve(axes)
        for id, name in {"speedup.kf-a-sskf-b": "KF", "speedup.lf-a-sslf-b": "LF"}.items():
            ratio = counted[f"{name} A"] / counted[f"{name} B"]
            assert verdicts[key][id].reason.endswith(f"{name} A against {name} B: {ratio:.1f}.")
        assert not verdicts[key]["speedup.kf-lf-a"].beyond


@pytest.mark.parametrize(("key", "id"), [("2014_gsm_2d", "eq17.joined"), ("2015_mpt_3d", "merge.joined")])
def test_columns_side_by_side_are_no_state_however_they_are_transposed(key, id, verdicts):
    axes = BOTH[key]
    columns = [np.ones((2, 1))] * axes
    found = verdicts[key][id]
    rows, width = np.hstack(columns).T.shape
    assert (found.verdict, found.cause) == ("cannot be checked", "copy-transposes")
    assert f"a matrix of {rows} × {width}" in found.reason
    assert np.hstack([each.T for each in columns]).T.shape == (2 * axes, 1)
    corrected = tomllib.loads((ROOT / "docs" / "papers.toml").read_text(encoding="utf-8"))["corrected"][key][id]
    assert corrected["printed"] in found.printed
    assert re.sub("(?<=k/k\\))ᵀ", "", corrected["right"]) == corrected["printed"]
    assert corrected["right"].count("ᵀ") == axes + 1
