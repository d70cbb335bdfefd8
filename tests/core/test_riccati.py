"""The limits of both Riccati equations against sixty digits, and what has none."""

from contextlib import suppress

import numpy as np
import precise
import pytest
from conftest import AXIS

import mpt_helpers as mpt
from mpt_helpers import riccati

SOLVERS = [riccati.rekf, riccati.relf]


def random_models():
    """Models of dense matrices, stable and unstable, that have a steady state with probability one."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        n, m = rng.integers(1, 6), rng.integers(1, 4)
        G = rng.standard_normal((n, n))
        yield mpt.LinearModel(
            F=rng.standard_normal((n, n)), H=rng.standard_normal((m, n)), Q=G @ G.T, R=np.diag(rng.uniform(0.5, 2, m))
        )


@pytest.mark.parametrize("model", list(random_models()), ids=range(20))
def test_two_solvers_agree(model):
    kalman, lainiotis = mpt.SteadyStateFilter.from_kalman(model), mpt.SteadyStateFilter.from_lainiotis(model)
    # Both are backward stable, and these random equations are conditioned no worse than some 1e5.
    for ours, theirs in zip((kalman.A, kalman.B, kalman.P), (lainiotis.A, lainiotis.B, lainiotis.P), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9 * np.abs(theirs).max())


@pytest.mark.parametrize("model", list(random_models()), ids=range(20))
def test_solutions_solve_their_equations(model):
    F, H, Q, R = model.F, model.H, model.Q, model.R
    P = riccati.rekf(model)
    left = Q + F @ P @ F.T - F @ P @ H.T @ np.linalg.inv(H @ P @ H.T + R) @ H @ P @ F.T
    np.testing.assert_allclose(left, P, rtol=1e-8, atol=1e-8 * np.abs(P).max())
    P = riccati.relf(model)
    A = np.linalg.inv(H @ Q @ H.T + R)
    Fn, Pn, On = F - Q @ H.T @ A @ H @ F, Q - Q @ H.T @ A @ H @ Q, F.T @ H.T @ A @ H @ F
    left = Pn + Fn @ np.linalg.inv(np.eye(model.n) + P @ On) @ P @ Fn.T
    np.testing.assert_allclose(left, P, rtol=1e-8, atol=1e-8 * np.abs(P).max())


def test_relf_does_not_go_through_rekf(monkeypatch):
    monkeypatch.delattr(riccati, "solve_discrete_are")
    monkeypatch.delattr(riccati, "rekf")
    assert mpt.SteadyStateFilter.from_lainiotis(AXIS).P.shape == (2, 2)


@pytest.mark.parametrize("solve", SOLVERS)
@pytest.mark.parametrize(
    ("model", "message"),
    [
        ({"F": np.diag([2.0, 0.5]), "H": [[0, 1]], "Q": np.eye(2)}, r"\[F, H\] is not detectable at the mode 2 of F"),
        ({"F": np.diag([-1.0, 0.5]), "H": [[0, 1]], "Q": np.eye(2)}, "not detectable at the mode -1 of F"),
        ({"F": np.diag([1.0, 0.5]), "H": [[1, 1]], "Q": np.diag([0.0, 1.0])}, "not stabilizable at the mode 1 of F"),
        ({"F": [[0, -2], [2, 0]], "H": [[1, 0]], "Q": np.zeros((2, 2))}, r"not stabilizable at the mode 0[+-]2j"),
        ({"F": [[1, 1], [0, 1]], "H": [[0, 1]], "Q": np.eye(2)}, "not detectable at the mode 1 of F"),
        ({"F": [[1, 1], [0, 1]], "H": [[1, 0]], "Q": np.diag([1.0, 0.0])}, "not stabilizable at the mode 1 of F"),
        ({"F": [[1]], "H": [[1]], "Q": [[0]]}, "not stabilizable at the mode 1 of F"),
        ({"F": [[1.5]], "H": [[1]], "Q": [[0]]}, "not stabilizable at the mode 1.5 of F"),
        ({"F": [[1.5]], "H": [[0]], "Q": [[1]]}, "not detectable at the mode 1.5 of F"),
    ],
    ids=[
        "unseen",
        "unseen-minus-one",
        "undriven",
        "undriven-pair",
        "unseen-position",
        "undriven-velocity",
        *("no noise", "growth without noise", "no sight"),
    ],
)
def test_no_steady_state_says_which_condition_fails_and_where(solve, model, message):
    with pytest.raises(ValueError, match=message):
        solve(mpt.LinearModel(**model, R=[[1.0]]))


@pytest.mark.parametrize("q", [1e-4, 1e-10, 1e-16])
def test_a_state_of_small_variance_settles_too(q):
    """Beside one of large variance that settles long before."""
    large, small = (mpt.LinearModel(F=[[1]], H=[[1]], Q=[[each]], R=[[r]]) for each, r in ((1e4, 1e4), (q, 1e8 * q)))
    both = riccati.relf(mpt.stack(large, small))
    np.testing.assert_allclose(np.diag(both), [riccati.relf(each)[0, 0] for each in (large, small)], rtol=1e-9)


ROTATION = np.array([[0.6, -0.8], [0.8, 0.6]])


@pytest.mark.parametrize("solve", SOLVERS)
@pytest.mark.parametrize("F", [np.diag([2.0, 0.5]), np.array([[1.0, 1.0], [0.0, 1.0]])], ids=["simple", "double"])
def test_rounding_hides_no_failing_condition(solve, F):
    F, H = ROTATION @ F @ ROTATION.T, [[0.0, 1.0]] @ ROTATION.T
    with pytest.raises(ValueError, match=r"needs a steady state.*not detectable at the mode"):
        solve(mpt.LinearModel(F=F, H=H, Q=np.eye(2), R=[[1.0]]))


def gap(solve, model):
    """The distance of a solution from that of 60 digits, in standard deviations."""
    *_, P, P_p, _ = precise.steady(model.F, model.H, model.Q, model.R)
    exact = (P_p if solve is riccati.rekf else P).astype(float)
    sigma = np.sqrt(np.diag(exact))
    return (np.abs(solve(model) - exact) / sigma / sigma[:, None]).max()


@pytest.mark.parametrize(("solve", "seen"), [(riccati.rekf, 1e-8), (riccati.relf, 1e-8), (riccati.relf, 1e-10)])
def test_a_mode_that_is_hardly_seen_is_seen(solve, seen):
    """1e-10 is a hundred times what counts as unseen; there the REKF may be refused, for want of six digits."""
    model = mpt.LinearModel(F=np.diag([1.0, 0.5]), H=[[seen, 1.0]], Q=np.eye(2), R=[[1.0]])
    assert gap(solve, model) < 10 * np.finfo(float).eps / seen  # a rounding of H changes the solution by eps / seen


NEARLY_UNSOLVABLE = {
    "two unstable modes 1e-3 apart": {"F": np.diag([1.5, 1.501])},
    "two unstable modes 1e-4 apart": {"F": np.diag([1.5, 1.5001])},
    "two modes 1e-6 apart": {"F": np.diag([1.0, 1.000001])},
    "two modes 1e-7 apart": {"F": np.diag([1.0, 1.0000001])},
    "driven by 1e-9": {"F": np.diag([1.0, 0.5]), "Q": np.diag([1e-18, 1.0])},
    "driven by 1e-11": {"F": np.diag([1.0, 0.5]), "Q": np.diag([1e-22, 1.0])},
}


@pytest.mark.parametrize("matrices", NEARLY_UNSOLVABLE.values(), ids=NEARLY_UNSOLVABLE)
def test_a_rekf_that_is_given_out_holds_five_digits(matrices):
    """Its last correction is below 1e-6; which of these models are refused may depend on the processor."""
    model = mpt.LinearModel(**{"H": [[1.0, 1.0]], "Q": np.eye(2), "R": [[1.0]]} | matrices)
    with suppress(ValueError):
        assert gap(riccati.rekf, model) < 1e-5


@pytest.mark.parametrize("failing", [lambda *_: np.full((2, 2), 5.0), lambda *_: np.full((2, 2), np.nan)])
def test_a_solution_that_solves_nothing_is_refused(monkeypatch, failing):
    monkeypatch.setattr(riccati, "solve_discrete_are", failing)
    with pytest.raises(ValueError, match="model: needs a steady state that double precision can resolve"):
        riccati.rekf(AXIS)


def test_a_solver_that_fails_is_named(monkeypatch):
    def fail(*_):
        raise np.linalg.LinAlgError("no solution")

    monkeypatch.setattr(riccati, "solve_discrete_are", fail)
    with pytest.raises(ValueError, match=r"nearest to failing, by .*: .* at the mode 1 of F"):
        riccati.rekf(AXIS)


@pytest.mark.parametrize("solve", SOLVERS)
def test_solutions_are_symmetric(solve):
    for model in random_models():
        np.testing.assert_array_equal(solve(model), solve(model).T)


@pytest.mark.parametrize("solve", SOLVERS)
def test_stable_modes_need_neither_condition(solve):
    model = mpt.LinearModel(F=np.diag([0.9, 0.97]), H=[[1.0, 0.0]], Q=np.diag([1.0, 0.0]), R=[[1.0]])
    assert solve(model)[1, 1] == pytest.approx(0, abs=1e-15)


@pytest.mark.parametrize("solve", SOLVERS)
@pytest.mark.parametrize("dt", [1e-4, 1.0, 1e4])
@pytest.mark.parametrize("q", [1e-12, 1.0, 1e12])
def test_models_of_every_scale_have_a_steady_state(solve, dt, q):
    assert np.isfinite(solve(mpt.gsm_axis(dt=dt, q=q, r=0.1))).all()


@pytest.mark.parametrize("solve", SOLVERS)
@pytest.mark.parametrize("unit", [2.0**-50, 2.0**50])
def test_the_units_do_not_matter(solve, unit):
    state = mpt.LinearModel(F=AXIS.F, H=AXIS.H / unit, Q=AXIS.Q * unit**2, R=AXIS.R)
    measurement = mpt.LinearModel(F=AXIS.F, H=AXIS.H * unit, Q=AXIS.Q, R=AXIS.R * unit**2)
    np.testing.assert_allclose(solve(state), solve(AXIS) * unit**2, rtol=1e-10)
    np.testing.assert_allclose(solve(measurement), solve(AXIS), rtol=1e-10)


def residual(model, P_p):
    """The residual of P_p in the REKF, in standard deviations, computed in 60 digits."""
    F, H, Q, R, P = map(precise.exact, (model.F, model.H, model.Q, model.R, P_p))
    *_, after, _ = precise.update(P, F, H, R)
    gap = np.abs((F @ after @ F.T + Q - P).astype(float))
    sigma = np.sqrt(np.diag(P_p))
    return (gap / sigma / sigma[:, None]).max()


UNEQUAL = {
    "of the issue": ([[1.0]], [[1e3], [1e3]], [[1e4]], [1e-4, 1]),
    "1e16 apart": ([[1.0]], [[1.0], [1.0]], [[1.0]], [1e-8, 1e8]),
    "two states": ([[1.0, 1.0], [0.0, 1.0]], [[1.0, 0.0], [1.0, 0.1], [1.0, 0.0]], np.eye(2), [1e-9, 1.0, 1e3]),
    "more than states": (np.diag([0.9, 1.1]), np.ones((4, 2)) + np.eye(4, 2), np.eye(2), [1e-10, 1e-2, 1.0, 1e6]),
}


@pytest.mark.parametrize(("F", "H", "Q", "variances"), UNEQUAL.values(), ids=UNEQUAL)
def test_sensors_of_unequal_precision(F, H, Q, variances):
    """Both solvers, against 60 digits, and both by their own equation's residual."""
    model = mpt.LinearModel(F=F, H=H, Q=Q, R=np.diag(variances))
    *_, P, P_p, _ = precise.steady(model.F, model.H, model.Q, model.R)
    P, P_p = P.astype(float), P_p.astype(float)
    np.testing.assert_allclose(riccati.rekf(model), P_p, rtol=1e-9, atol=1e-9 * np.abs(P_p).max())
    assert residual(model, riccati.rekf(model)) < 1e-9
    sigma = np.sqrt(np.diag(P))
    for solved in (mpt.SteadyStateFilter.from_kalman(model), mpt.SteadyStateFilter.from_lainiotis(model)):
        assert np.abs((solved.P - P) / sigma / sigma[:, None]).max() < 1e-9


def test_the_relf_of_two_sensors_is_that_of_the_better_one():
    model = mpt.LinearModel(F=[[1]], H=[[1e3], [1e3]], Q=[[1e4]], R=np.diag([1e-4, 1]))
    assert riccati.relf(model)[0, 0] == pytest.approx(1.00e-10, rel=1e-3)


def test_a_relf_that_does_not_solve_its_equation_is_refused(monkeypatch):
    """As when the doubling ends too soon."""
    monkeypatch.setattr(riccati, "DOUBLINGS", 1)
    with pytest.raises(ValueError, match="needs a steady state that double precision can resolve"):
        riccati.relf(AXIS)


@pytest.mark.parametrize("solve", SOLVERS)
def test_axes_of_very_different_units_are_solved_side_by_side(solve):
    """A position in metres and a clock in seconds, or one sensor in units of 1e13 of the other's."""
    position, clock = mpt.constant_velocity(1.0, 1.0, 1.0), mpt.constant_velocity(1.0, 1e-24, 1e-24)
    P = solve(mpt.stack(position, clock))
    np.testing.assert_allclose(P[2:, 2:] * 1e24, P[:2, :2], rtol=1e-9)
    unequal = mpt.LinearModel(F=np.eye(2), H=np.diag([1, 1e-13]), Q=np.eye(2), R=np.diag([1, 1e-26]))
    np.testing.assert_allclose(np.diag(solve(unequal)), solve(unequal)[0, 0], rtol=1e-9)


@pytest.mark.parametrize("name", ["rekf", "relf"])
def test_a_solver_that_fails_within_numpy_names_the_model(monkeypatch, name):
    """By a patch, since a model that fails on one processor may be solved on another."""

    def fails(model):
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(riccati, f"_solve_{name}", fails)
    with pytest.raises(ValueError, match="model: needs a steady state that double precision can resolve"):
        getattr(riccati, name)(AXIS)


def test_a_model_at_the_edge_of_doubles_is_solved_or_refused():
    model = mpt.LinearModel(F=[[-0.7, 0.6], [2.3, -2]], H=[[1, 0]], Q=1e-9 * np.eye(2), R=[[1e6]])
    for make in (mpt.SteadyStateFilter.from_kalman, mpt.SteadyStateFilter.from_lainiotis):
        with suppress(ValueError):
            np.testing.assert_allclose(make(model).B.ravel(), [0.862068, -2.862888], rtol=1e-5)


@pytest.mark.parametrize("solve", SOLVERS)
@pytest.mark.parametrize(
    ("Q", "need"),
    [(1.0, "a steady state that double precision can resolve"), (1e-300, "matrices whose products do not overflow")],
)
def test_a_model_whose_products_overflow_is_refused(solve, Q, need):
    model = mpt.LinearModel(F=1e200 * np.eye(3), H=np.eye(3), Q=Q * np.eye(3), R=np.eye(3))
    with pytest.raises(ValueError, match=f"model: needs {need}"):
        solve(model)
