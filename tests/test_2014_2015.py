"""The filters and recursions that the notebooks on 2014 and 2015 write out, against what shares nothing with them."""

import numpy as np
import pytest
from reading import Article
from scipy.linalg import solve_discrete_are

import mpt_helpers as mpt

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
