"""How many digits hold where: models of extreme numbers against a reference of 60 digits.

docs/accuracy.md states the digits in tables that this file writes and checks:
`PYTHONPATH=tests/support python tests/engine/test_hard_numbers.py` writes them.
"""

import json
import os
import subprocess
import sys
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import precise
import pytest

import mpt_helpers as mpt
from mpt_helpers import riccati
from mpt_helpers._engine import shared as steps
from mpt_helpers.equations import square_root

PAGE = Path(__file__).parents[2] / "docs" / "accuracy.md"
BEGIN, END = "<!-- digits -->\n", "<!-- end of digits -->\n"
GAPS_BEGIN, GAPS_END = "<!-- gaps -->\n", "<!-- end of gaps -->\n"
SMOOTHED_BEGIN, SMOOTHED_END = "<!-- smoothed -->\n", "<!-- end of smoothed -->\n"
CORES = ["Nehalem", "Haswell", "SkylakeX"]  # whose products round otherwise
SLACK = 1  # of what these measure, for the next machine
LUCK = 4  # a few entries may round all in one's favour
MOST = 14  # a double holds 15.95 digits, and one product of matrices rounds the last ones

AXES = {"gsm": mpt.gsm_axis, "cv": mpt.constant_velocity, "ca": mpt.constant_acceleration}
WALK = {"F": [[1.0]], "H": [[1.0]], "Q": [[1.0]]}
UNSTABLE = {"F": [[1.5, 1.0], [0.0, 0.9]], "H": [[1.0, 0.3]], "R": [[1.0]]}
BOTH_SEEN = {"F": [[1.0, 1.0], [0.0, 1.0]], "H": np.eye(2), "Q": np.eye(2)}
SUMS_SEEN = {"F": [[1.0, 7.0], [0.0, 1.0]], "H": [[1.0, 0.7], [0.7, -0.9]], "Q": np.diag([1e4, 1e6])}


def uncertain(make, variance):
    model = make(dt=0.7, q=0.01, r=0.1)
    return replace(model, P0=variance * np.eye(model.n))


def in_units(model, *units):
    """The model with its states in other units, of which so many make one."""
    d = np.array(units)
    return mpt.LinearModel(F=model.F * d[:, None] / d, H=model.H / d, Q=model.Q * d[:, None] * d, R=model.R)


def dense(ratio):
    """Six states, three measurements, no zeros."""
    rng = np.random.default_rng(6)
    F, H, G, W = (rng.standard_normal(shape) for shape in ((6, 6), (3, 6), (6, 6), (3, 3)))
    return mpt.LinearModel(F=F / 2, H=H, Q=G @ G.T, R=ratio * (W @ W.T + np.eye(3)), P0=np.eye(6))


OBLIQUE = {"F": [[1.0, 1.0], [0.0, 1.0]], "H": [[1.0, 0.0], [1.0, 0.1], [1.0, 0.0]], "Q": np.eye(2)}
MODELS = {
    **{f"{name}, R/Q = {r:g}": make(1.0, 1.0, r) for r in (1e-12, 1e-6, 1.0, 1e6, 1e12) for name, make in AXES.items()},
    **{f"{name}, dt = {dt:g}": make(dt, 1.0, 1.0) for dt in (1e-4, 1e-2, 1e2, 1e4) for name, make in AXES.items()},
    **{f"{name}, P0 = {p:g} I": uncertain(make, p) for p in (1.0, 1e6, 1e12) for name, make in AXES.items()},
    "gsm, dt = 0.7, R/Q = 1e-12": mpt.gsm_axis(0.7, 1.0, 1e-12),
    **{f"6 states, R/Q = {ratio:g}": dense(ratio) for ratio in (1e-12, 1.0, 1e12)},
    "ca, in nm, km/s and m/s²": in_units(mpt.constant_acceleration(1.0, 1.0, 1.0), 1e9, 1e-3, 1.0),
    "R = diag(1, 1e-12)": mpt.LinearModel(**BOTH_SEEN, R=np.diag([1, 1e-12])),
    "R of correlation 1 - 1e-6": mpt.LinearModel(**BOTH_SEEN, R=[[1, 1 - 1e-6], [1 - 1e-6, 1]]),
    "two sensors, R = diag(1e-4, 1)": mpt.LinearModel(F=[[1]], H=[[1e3], [1e3]], Q=[[1e4]], R=np.diag([1e-4, 1])),
    "three sensors, R = diag(1e-8, 1, 1e8)": mpt.LinearModel(**OBLIQUE, R=np.diag([1e-8, 1, 1e8])),
    "three sensors, R = diag(1e8, 1, 1e-8)": mpt.LinearModel(**OBLIQUE, R=np.diag([1e8, 1, 1e-8])),
    "two axes, R/Q = 1e-12 and 1e12": mpt.stack(mpt.constant_velocity(1, 1, 1e-12), mpt.constant_velocity(1, 1, 1e12)),
    "closed loop 1 - 1e-3": mpt.LinearModel(**WALK, R=[[1e6]]),
    "closed loop 1 - 1e-6": mpt.LinearModel(**WALK, R=[[1e12]]),
    "closed loop 1 - 1e-8": mpt.LinearModel(**WALK, R=[[1e16]]),
    "gsm, P0 = diag(1e8, 1e-6)": mpt.gsm_axis(1.5, 1e-10, 100.0, P0=np.diag([1e8, 1e-6])),
    "gsm, Q = 0, P0 = diag(1e8, 0)": mpt.gsm_axis(2.0, 0.0, 100.0, x0=[0, 1], P0=np.diag([1e8, 0])),
    "two precise sensors of sums of states": mpt.LinearModel(**SUMS_SEEN, R=np.diag([1e-2, 1e-1])),
    "undriven mode 1 - 1e-6": mpt.LinearModel(
        F=np.diag([1 - 1e-6, 0.5]), H=[[1, 1]], Q=np.diag([0, 1]), R=[[1]], P0=np.eye(2)
    ),
    "F of 1.5, Q = I": mpt.LinearModel(**UNSTABLE, Q=np.eye(2)),
    "F of 1.5, Q singular": mpt.LinearModel(**UNSTABLE, Q=np.diag([1.0, 0.0]), P0=np.eye(2)),
    "cv, Q = 0, P0 = I": replace(mpt.constant_velocity(1.0, 1.0, 1.0), Q=np.zeros((2, 2)), P0=np.eye(2)),
}
NO_STEADY_STATE = {"cv, Q = 0, P0 = I", "gsm, Q = 0, P0 = diag(1e8, 0)"}
COLUMNS = [
    *[f"{name}: {what}" for name in ("Kalman", "Lainiotis") for what in ("x", "A B", "P")],
    *["own gaps: x", "own gaps: P"],
    *["REKF: P_p", "REKF: A B", "REKF: P", "RELF: A B", "RELF: P"],
]


def deviations(P):
    variance = np.einsum("...ii->...i", P).astype(float)
    return np.sqrt(np.where(variance > 0, variance, 1))


class Digits:
    """Counts digits relative to standard deviations, so that they depend on no unit.

    P by the deviations of both its components, B by those of the component and the innovation (no entry can be larger),
    A by the largest entry of F when states are measured in their predicted deviations.
    """

    def __init__(self, F, A, B, P, P_p, S):
        self.A, self.B, self.P, self.P_p = A, B, P, P_p
        p, s, self.s = deviations(P_p), deviations(S), deviations(P)
        self.unit_B = p[..., :, None] / s[..., None, :]
        ratio = p[..., :, None] / p[..., None, :]
        self.unit_A = ratio * (np.abs(F) / ratio).max(axis=(-1, -2), keepdims=True)
        self.p = p

    def of_coefficients(self, A, B):
        return min(precise.digits(A, self.A, self.unit_A), precise.digits(B, self.B, self.unit_B))

    def of_covariance(self, P):
        return precise.digits(P, self.P, self.s[..., :, None] * self.s[..., None, :])

    def of_prediction(self, P_p):
        return precise.digits(P_p, self.P_p, self.p[..., :, None] * self.p[..., None, :])


def of_recursions(model, N=40):
    """x is counted relative to the largest estimate of each component."""
    z = mpt.simulate(model, N, np.random.default_rng(1))[1]
    x, *coefficients = precise.kalman(model.F, model.H, model.Q, model.R, model.x0, model.P0, z)
    exact, largest = Digits(model.F, *coefficients), np.abs(x.astype(float)).max(axis=0)
    for make in (mpt.KalmanFilter, mpt.LainiotisFilter):
        A, B, P = make(model).coefficients(N)
        yield precise.digits(make(model).filter(z), x, largest)
        yield exact.of_coefficients(A, B)
        yield exact.of_covariance(P)


def of_own_gaps(model, N=40, tracks=3):
    """The Kalman filter of tracks that each miss every tenth epoch, and rows where R has no correlation."""
    rng = np.random.default_rng(2)
    z = mpt.simulate(model, N, rng, tracks)[1]
    lost = np.broadcast_to(rng.random((N, 1, tracks)) < 0.1, z.shape)
    if np.array_equal(model.R, np.diag(np.diag(model.R))):
        lost = lost | (rng.random(z.shape) < 0.1)
    z[lost] = np.nan
    x, P = mpt.KalmanFilter(model).filter(z), mpt.KalmanFilter(model).covariances(z)
    of_x, of_P = [], []
    for i in range(tracks):
        exact, _, _, exact_P, *_ = precise.kalman(model.F, model.H, model.Q, model.R, model.x0, model.P0, z[..., i])
        s = deviations(exact_P)
        of_x.append(precise.digits(x[..., i], exact, np.abs(exact.astype(float)).max(axis=0)))
        of_P.append(precise.digits(P[..., i], exact_P, s[:, :, None] * s[:, None, :]))
    return min(of_x), min(of_P)


def of_steady_states(model):
    exact = Digits(model.F, *precise.steady(model.F, model.H, model.Q, model.R))
    yield exact.of_prediction(riccati.rekf(model))
    for solved in (mpt.SteadyStateFilter.from_kalman(model), mpt.SteadyStateFilter.from_lainiotis(model)):
        yield exact.of_coefficients(solved.A, solved.B)
        yield exact.of_covariance(solved.P)


@lru_cache
def measured(name):
    """The digits of each column, as far as the model has it."""
    steady = [] if name in NO_STEADY_STATE else of_steady_states(MODELS[name])
    return [*of_recursions(MODELS[name]), *of_own_gaps(MODELS[name]), *steady]


SAME_SEEN = {"F": [[1.0, 1.0], [0.0, 1.0]], "H": [[1.0, 0.0], [1.0, 0.0]]}
EQUAL = mpt.LinearModel(**SAME_SEEN, Q=0.01 * np.eye(2), R=1e-4 * np.eye(2), P0=1e8 * np.eye(2))
CORRELATED = replace(EQUAL, R=1e-4 * np.array([[1.0, 0.9], [0.9, 1.0]]))
# A model, and how many epochs are missed after the first twenty. Sixty epochs are seen in all.
LONG_GAPS = {
    **{f"{name}, gap of {gap:,}": (make(1.0, 0.01, 0.1), gap) for gap in (500, 4000) for name, make in AXES.items()},
    **{f"{name}, P0 = 1e10 I, gap of 4": (uncertain(make, 1e10), 4) for name, make in AXES.items()},
    "two equal sensors, P0 = 1e8 I": (EQUAL, 4),
    "two equal sensors, steady at R/Q = 1e-12": (replace(EQUAL, Q=np.eye(2), R=1e-12 * np.eye(2), P0=np.eye(2)), 4),
    "two equal sensors of correlation 0.9": (CORRELATED, 4),
}
OF_GAPS = [f"{name}: {what}" for name in ("Kalman", "Lainiotis", "joint") for what in ("x", "P", "x by steps")]


@lru_cache
def measured_over_gaps(name):
    """The digits of estimates and covariances relative to standard deviations: by `estimates` and by `step`."""
    model, gap = LONG_GAPS[name]
    z = with_a_gap(model, gap, seen=60, seed=3)
    x, _, _, P, *_ = precise.kalman(model.F, model.H, model.Q, model.R, model.x0, model.P0, z)
    s, x, P = deviations(P), precise.two_doubles(x), precise.two_doubles(P)
    kf, lf = mpt.KalmanFilter(model), mpt.LainiotisFilter(model)
    result = []
    for each in (kf, lf, mpt.JoinFilter(kf, lf)):
        both = each.estimates(z)
        result.append(min(precise.digits(both.x, x, s), precise.digits(each.filter(z), x, s)))
        result.append(precise.digits(both.P, P, s[:, :, None] * s[:, None]))
        result.append(precise.digits(one_after_the_other(each, z), x, s))
    return result


# A model, and how many epochs are missed after the first twenty. Forty epochs are seen in all.
SMOOTHED = {
    **{f"{name}, gap of 500": (make(1.0, 0.01, 0.1), 500) for name, make in AXES.items()},
    **{f"{name}, P0 = {p:g} I": (uncertain(make, p), 20) for p in (1e4, 1e8, 1e12) for name, make in AXES.items()},
    "ca, Q/R = 1e-10": (replace(mpt.constant_acceleration(1.0, 1e-10, 1.0), P0=1e4 * np.eye(3)), 20),
}
OF_SMOOTHED = [f"{name}: {what}" for name in ("Kalman", "Lainiotis") for what in ("x", "P")]


@lru_cache
def measured_smoothed(name):
    """The digits of the states given all measurements, relative to their standard deviations."""
    model, gap = SMOOTHED[name]
    z = with_a_gap(model, gap, seen=40, seed=4)
    x, P = precise.smoothed(model.F, model.H, model.Q, model.R, model.x0, model.P0, z)
    s = deviations(P)
    result = []
    for make in (mpt.KalmanFilter, mpt.LainiotisFilter):
        found = make(model).smooth(z)
        result.append(precise.digits(found.x, x, s))
        result.append(precise.digits(found.P, P, s[:, :, None] * s[:, None, :]))
    return result


def with_a_gap(model, gap, seen, seed):
    """Measurements of a track of which so many epochs are seen, and so many missed after the first twenty."""
    truth = replace(model, P0=np.minimum(model.P0, 100.0))
    z = mpt.simulate(truth, gap + seen, np.random.default_rng(seed))[1]
    z[20 : 20 + gap] = np.nan
    return z


def one_after_the_other(each, z):
    x, P, states = each.model.x0, each.P0, []
    for z_k in z:
        x, P = each.step(x, P, z_k)
        states.append(x)
    return np.array(states)


def require_as_stated(columns, measured, given):
    """Fail where fewer digits hold than are stated, or many more."""
    for column, digits, least in zip(columns, measured, given, strict=True):
        assert least == 0 or least <= digits, f"{column}: {digits:.1f} digits, {least} stated"
        assert least == MOST or digits < least + SLACK + LUCK, f"{column}: {digits:.1f} digits, {least} stated"


# Thousands of single steps take seconds.
FEW = [pytest.param(name, marks=pytest.mark.slow) if name.endswith("4,000") else name for name in LONG_GAPS]


@pytest.mark.parametrize("name", FEW)
def test_as_many_digits_hold_over_long_gaps_as_stated(name):
    given = dict(zip(LONG_GAPS, stated(GAPS_BEGIN, GAPS_END).values(), strict=True))[name]
    require_as_stated(OF_GAPS, measured_over_gaps(name), given)


def test_the_page_states_every_long_gap():
    assert list(stated(GAPS_BEGIN, GAPS_END)) == list(LONG_GAPS)


@pytest.mark.parametrize("name", SMOOTHED)
def test_as_many_digits_of_the_smoother_hold_as_stated(name):
    given = dict(zip(SMOOTHED, stated(SMOOTHED_BEGIN, SMOOTHED_END).values(), strict=True))[name]
    require_as_stated(OF_SMOOTHED, measured_smoothed(name), given)


def test_the_page_states_every_smoothed_model():
    assert list(stated(SMOOTHED_BEGIN, SMOOTHED_END)) == list(SMOOTHED)


def stated(begin=BEGIN, end=END, text=None):
    """The digits that the page states, by the names of the models."""
    table = (text or PAGE.read_text(encoding="utf-8")).split(begin)[1].split(end)[0].strip().splitlines()[2:]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table]
    return {name: [int(cell) for cell in cells if cell != "-"] for name, *cells in rows}


def test_the_page_states_every_model():
    assert list(stated()) == list(MODELS)
    assert [len(row) for row in stated().values()] == [8 if name in NO_STEADY_STATE else 13 for name in MODELS]


@pytest.mark.parametrize("name", MODELS)
def test_as_many_digits_hold_as_stated(name):
    require_as_stated(COLUMNS[: len(stated()[name])], measured(name), stated()[name])


REFUSED = {
    "undriven drift": (MODELS["cv, Q = 0, P0 = I"], "not stabilizable at the mode 1 of F"),
    "undriven mode 1 - 1e-10": (
        mpt.LinearModel(F=np.diag([1 - 1e-10, 0.5]), H=[[1, 1]], Q=np.diag([0, 1]), R=[[1]]),
        "not stabilizable at the mode 1 of F",
    ),
    "unseen constant": (mpt.gps_ins(1.0, 0.01, (1.0, 1e-4)), "not stabilizable at the mode 1 of F"),
    "closed loop 1 - 1e-12": (mpt.LinearModel(**WALK, R=[[1e24]]), "that double precision can resolve"),
}


@pytest.mark.parametrize(("model", "reason"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_solved_is_refused(model, reason):
    with pytest.raises(ValueError, match=f"model: needs a steady state.*{reason}"):
        mpt.SteadyStateFilter.from_kalman(model)


def three_sensors():
    """Two states, and three sensors of which one is 1e8 times as precise as the others, at a process noise of 1e7."""
    G = np.array([[1.86, 0.92], [-0.776, -0.414]]) * np.sqrt([[0.00807], [1.69e7]])
    W = np.array([[-0.216, -1.28, -3.24], [0.521, -1.04, -0.705], [-0.783, -0.429, -0.483]])
    s = np.sqrt([27.6, 1.35e-16, 0.973])
    return mpt.LinearModel(
        F=[[0.117, 0.47], [0.319, -0.839]],
        H=[[-0.00809, 0.011], [1.96, -58.7], [215, 198]],
        Q=G @ G.T,
        R=(W @ W.T + 0.01 * np.eye(3)) * s[:, None] * s,
    )


@pytest.mark.parametrize("solve", [mpt.SteadyStateFilter.from_kalman, mpt.SteadyStateFilter.from_lainiotis])
def test_a_steady_state_without_a_digit_is_refused_though_its_equation_holds(solve, monkeypatch):
    model = three_sensors()
    with pytest.raises(ValueError, match="a variance has no digit right"):
        solve(model)
    monkeypatch.setattr(riccati, "require_resolved", lambda model, P: None)
    exact = precise.steady(model.F, model.H, model.Q, model.R)[2].astype(float)
    # Of the Kalman filter's no digit holds; of the other's, by luck, as many as two on some processors and libraries.
    least = 0.1 if solve == mpt.SteadyStateFilter.from_kalman else 1e-3
    assert np.abs(np.diag(solve(model).P) / np.diag(exact) - 1).max() > least


LIFTED = {
    name: MODELS[name]
    for name in MODELS
    if name.startswith(("F of", "closed", "undriven", "two axes", "6 states", "ca, dt"))
}


@pytest.mark.parametrize("name", LIFTED)
def test_several_steps_in_one_product_lose_no_digits(monkeypatch, name):
    """Against step by step: unstable F, closed loops near the unit circle, steps of very different entries.

    One product of L steps rounds powers of A where L products round the estimates: the same sums in another order.
    """
    model = replace(LIFTED[name], x0=np.ones(LIFTED[name].n))
    z = mpt.simulate(model, 96, np.random.default_rng(2))[1]
    kf = mpt.KalmanFilter(model)
    taken = list(steps.steps_without_gaps(kf.next_step, kf.P0, model.m, len(z)))
    exact = precise.recursion([step.A for step in taken], [step.B for step in taken], model.x0, z)
    largest = np.abs(exact.astype(float)).max(axis=0)

    def digits(L):
        monkeypatch.setattr(steps, "steps_per_product", lambda numbers: L)
        x = np.empty((len(z), model.n, 1))
        steps.run_shared(steps.products_for(taken, 1), model.x0[:, None], z[..., None], x)
        return precise.digits(x[..., 0], exact, largest)

    one = digits(1)
    for L in (2, 8, 32):
        assert digits(L) >= one - SLACK


TABLES = (
    (MODELS, COLUMNS, BEGIN, END),
    (LONG_GAPS, OF_GAPS, GAPS_BEGIN, GAPS_END),
    (SMOOTHED, OF_SMOOTHED, SMOOTHED_BEGIN, SMOOTHED_END),
)


TEXT = PAGE.read_text(encoding="utf-8")


def test_rounding_never_matters_for_a_gps_track():
    assert "A simulated track of a thousand fixes, 100 km from its origin and with a gap of a hundred" in TEXT
    assert "within 1e-9 m of the exact result" in TEXT
    model = mpt.constant_velocity(1.0, 0.14, 9.0, P0=np.diag([100.0, 900.0]))
    z = mpt.simulate(model, N=1000, rng=np.random.default_rng(0))[1] + np.linspace(0, 1e5, 1000)[:, None]
    z[300:400] = np.nan
    given = (model.F, model.H, model.Q, model.R, model.x0, model.P0, z)
    kf = mpt.KalmanFilter(model)
    for found, exact in ((kf.filter(z), precise.kalman(*given)[0]), (kf.smooth(z).x, precise.smoothed(*given)[0])):
        assert np.abs(found[:, 0] - exact[:, 0].astype(float)).max() < 1e-9


@pytest.mark.parametrize("make", AXES.values(), ids=AXES)
def test_a_start_of_a_million_r_leaves_eight_digits(make):
    assert "take P0 = 1e6 R: eight digits of σ hold in filter and smoother" in TEXT
    model = replace(make(0.7, 0.01, 0.1), P0=1e5 * np.eye(make(1, 1, 1).n))
    z = with_a_gap(model, 20, seen=40, seed=4)
    kf, given = mpt.KalmanFilter(model), (model.F, model.H, model.Q, model.R, model.x0, model.P0, z)
    filtered, _, _, covariances, *_ = precise.kalman(*given)
    for found, x, P in ((kf.estimates(z), filtered, covariances), (kf.smooth(z), *precise.smoothed(*given))):
        s = deviations(P)
        assert precise.digits(found.x, x, s) > 8 + SLACK
        assert precise.digits(found.P, P, s[:, :, None] * s[:, None]) > 8 + SLACK


def test_what_the_page_advises_holds_by_its_tables():
    digits = {name: dict(zip(COLUMNS, row, strict=False)) for name, row in stated().items()}
    precise_sensor = {each: digits[f"{each}, R/Q = 1e-12"] for each in AXES}
    assert {precise_sensor["gsm"]["Kalman: P"], precise_sensor["gsm"]["own gaps: P"]} == {2, 3}
    assert precise_sensor["cv"]["Lainiotis: P"] == 10
    assert precise_sensor["gsm"]["Lainiotis: P"] == 14
    assert min(precise_sensor["cv"]["Kalman: P"], precise_sensor["ca"]["Kalman: P"]) >= 13
    assert min(row[name] for row in precise_sensor.values() for name in WORST["x"] + WORST["A B"]) == 11
    assert digits["gsm, dt = 0.7, R/Q = 1e-12"]["Lainiotis: P"] == 4
    over_gaps = stated(GAPS_BEGIN, GAPS_END)
    assert (min(over_gaps["ca, gap of 4,000"]), min(over_gaps["cv, gap of 4,000"])) == (6, 9)
    slow = [digits[f"closed loop 1 - 1e-{power}"] for power in (6, 8)]
    assert [row["REKF: P_p"] for row in slow] == [10, 6]
    assert min(row[name] for row in slow for name in WORST["x"] + ["Kalman: P"]) == 13


DAMPED = (5, 14, 16, 66, 93, 181, 198, 249)


def damped(seed, q):
    """A model of damped modes, a number of fixes, and the generator for them."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 4))
    V = rng.standard_normal((n, n))
    F = V @ np.diag(rng.uniform(0.1, 0.95, n)) @ np.linalg.inv(V)
    N = int(rng.choice([20, 40, 100, 400]))
    return mpt.LinearModel(F=F, H=rng.standard_normal((1, n)), Q=q * np.eye(n), R=[[1]], P0=np.eye(n)), N, rng


@pytest.mark.parametrize("seed", DAMPED)
def test_a_little_process_noise_mends_the_smoother_of_damped_modes(seed):
    """Without it seven of these eight have less than a digit of P, by 40 fixes."""
    assert "a process noise of 1e-6 of their variances: ten digits of σ hold then" in TEXT
    model, _, _ = damped(seed, q=1e-6)
    z = np.random.default_rng(0).standard_normal((40, 1))
    x, P = precise.smoothed(model.F, model.H, model.Q, model.R, model.x0, model.P0, z)
    found, s = mpt.KalmanFilter(model).smooth(z), deviations(P)
    assert precise.digits(found.x, x, s) > 10
    assert precise.digits(found.P, P, s[:, :, None] * s[:, None]) > 10


def test_a_wrong_steady_state_shows_by_comparing_both_equations():
    """Models near those of `three_sensors`: some pass with a variance wrong by half, and the other equation tells."""
    base, rng, errors = three_sensors(), np.random.default_rng(0), []
    while len(errors) < 40:
        G = np.sqrt(10 ** rng.uniform(-4, 1.5)) * np.linalg.cholesky(base.Q) * (1 + 0.2 * rng.standard_normal((2, 2)))
        scale = np.array([1, 10 ** rng.uniform(-1, 3), 1.0])
        model = replace(base, Q=G @ G.T, R=base.R * scale[:, None] * scale)
        passed = []
        for solve in (mpt.SteadyStateFilter.from_kalman, mpt.SteadyStateFilter.from_lainiotis):
            with suppress(ValueError):
                passed.append(np.diag(solve(model).P))
        if not passed:
            continue
        exact = np.diag(precise.steady(model.F, model.H, model.Q, model.R)[2].astype(float))
        errors.append(max(np.abs(each / exact - 1).max() for each in passed))
        if len(passed) == 2 and errors[-1] > 0.01:
            assert np.abs(passed[0] / passed[1] - 1).max() > 1e-3
    assert sum(error > 0.5 for error in errors) > 1
    assert "Of 40 such models that we drew and that passed, several have a variance that is wrong by half" in TEXT


# The columns of the page's first tables: the worst of these.
WORST = {
    "x": COLUMNS[0:7:3],
    "A B": [name for name in COLUMNS if name.endswith("A B")],
    "P: Kalman": ["Kalman: P"],
    "P: Lainiotis": ["Lainiotis: P"],
    "P: gaps": ["own gaps: P"],
    "P: REKF": ["REKF: P_p", "REKF: P"],
    "P: RELF": ["RELF: P"],
}
WORST_OF_GAPS = {what: [name for name in OF_GAPS if name.endswith(f": {what}")] for what in ("x", "P", "x by steps")}
WORST_SMOOTHED = {what: [name for name in OF_SMOOTHED if name.endswith(f": {what}")] for what in ("x", "P")}
SHORT = (
    ("worst digits", COLUMNS, WORST, BEGIN, END),
    ("worst gaps", OF_GAPS, WORST_OF_GAPS, GAPS_BEGIN, GAPS_END),
    ("worst smoothed", OF_SMOOTHED, WORST_SMOOTHED, SMOOTHED_BEGIN, SMOOTHED_END),
)


def with_short_tables(text):
    """The page with its first tables: the rows of the long ones in which some entry has fewer than ten digits."""
    for mark, columns, worst, begin, end in SHORT:
        lines = ["| model | " + " | ".join(worst) + " |", "|---|" + "---:|" * len(worst)]
        for name, digits in stated(begin, end, text).items():
            if min(digits) < 10:
                of = dict(zip(columns, digits, strict=True))
                cells = [str(min(of[column] for column in each)) for each in worst.values()]
                lines.append("| " + " | ".join([name, *cells]) + " |")
        before, rest = text.split(f"<!-- {mark} -->\n")
        _, after = rest.split(f"<!-- end of {mark} -->\n")
        text = "\n".join([f"{before}<!-- {mark} -->", *lines, f"<!-- end of {mark} -->", after])
    return text


def test_the_first_tables_of_the_page_are_the_worst_of_the_long_ones():
    text = PAGE.read_text(encoding="utf-8")
    assert with_short_tables(text) == text


def write_page():
    """Write the tables: what the worst of several kinds of processor reaches, less the slack."""
    here = str(Path(__file__).resolve())
    command = [sys.executable, here, "measure"]
    every = [json.loads(subprocess.check_output(command, env=os.environ | {"OPENBLAS_CORETYPE": c})) for c in CORES]
    text = PAGE.read_text(encoding="utf-8")
    for names, columns, begin, end in TABLES:
        lines = ["| model | " + " | ".join(columns) + " |", "|---|" + "---:|" * len(columns)]
        for name in names:
            worst = np.min([each[f"{begin}{name}"] for each in every], axis=0)
            cells = [str(int(np.clip(np.floor(digits - SLACK), 0, MOST))) for digits in worst]
            lines.append("| " + " | ".join([name, *cells, *["-"] * (len(columns) - len(cells))]) + " |")
        before, rest = text.split(begin)
        text = before + begin + "\n".join(lines) + "\n" + end + rest.split(end)[1]
    PAGE.write_text(with_short_tables(text), encoding="utf-8")


if __name__ == "__main__":
    if sys.argv[1:] == ["measure"]:
        ways = (measured, measured_over_gaps, measured_smoothed)
        tables = zip(TABLES, ways, strict=True)
        print(json.dumps({f"{begin}{name}": way(name) for (names, _, begin, _), way in tables for name in names}))
    else:
        write_page()


@pytest.mark.parametrize("first", [(40, 40), (0, 40), (0, 400)], ids=str)
def test_a_vague_start_may_be_measured_late(first):
    """Two tracks, the first measurement of each after so many rows: x to 1e-6 of a sigma, P to 1e-6, by 60 digits."""
    model = mpt.constant_velocity(1.0, 0.01, 1.0, P0=1e18 * np.eye(2))
    N = first[1] + 10
    z = np.random.default_rng(3).standard_normal((N, 1, 2))
    for track, row in enumerate(first):
        z[:row, :, track] = np.nan
    found = mpt.KalmanFilter(model).estimates(z)
    for track, row in enumerate(first):
        x, _, _, P, *_ = precise.kalman(model.F, model.H, model.Q, model.R, model.x0, model.P0, z[..., track])
        x, P = x[row + 2 :].astype(float), P[row + 2 :].astype(float)
        sigma = np.sqrt(np.einsum("kii->ki", P))
        assert (np.abs(found.x[row + 2 :, :, track] - x) < 1e-6 * sigma).all()
        assert (np.abs(found.P[row + 2 :, :, :, track] - P) < 1e-6 * sigma[:, :, None] * sigma[:, None]).all()


@pytest.mark.parametrize("P0", [1e14, 1e20])
@pytest.mark.parametrize("q", [0.0, 0.01])
def test_a_sensor_may_start_late_under_a_vague_start(P0, q):
    """The sum of two states is measured from the start, the second of them from row 350 on; against 60 digits.

    Its digits were lost after 300 rows: the states were wrong by half a sigma at 1e14, by 3 sigma at 1e20.
    """
    H = np.array([[1.0, 1.0], [0.0, 1.0]])
    model = mpt.LinearModel(F=np.eye(2), H=H, Q=q * np.eye(2), R=np.eye(2), P0=P0 * np.eye(2))
    z = np.random.default_rng(1).standard_normal((360, 2))
    z[:350, 1] = np.nan
    found = mpt.KalmanFilter(model).estimates(z)
    x, _, _, P, *_ = precise.kalman(model.F, model.H, model.Q, model.R, model.x0, model.P0, z)
    x, P = x.astype(float), P.astype(float)
    sigma = np.sqrt(np.einsum("kii->ki", P))
    assert (np.abs(found.x - x) < 1e-3 * sigma).all()
    assert (np.abs(found.P - P) < 1e-6 * sigma[:, :, None] * sigma[:, None]).all()


def off_by(found, model, z):
    """How far x and P are from 60 digits, in standard deviations."""
    x, _, _, P, *_ = precise.kalman(model.F, model.H, model.Q, model.R, model.x0, model.P0, z)
    s, x, P = deviations(P), x.astype(float), P.astype(float)
    return (np.abs(found.x - x) / s).max(), (np.abs(found.P - P) / s[:, :, None] / s[:, None]).max()


def of_steps(model, dts, z, smooth=False):
    """x and P of one track z (N, m) with steps of these lengths, by 60 digits; given all of z if smooth."""
    H, R, x, P = map(precise.exact, (model.H, model.R, model.x0, model.P0))
    found, predicted = [], []
    for dt, z_k in zip(dts, z, strict=True):
        F, Q = map(precise.exact, model.over(dt))
        x, P = F @ x, F @ P @ F.T + Q
        predicted.append((F, P))
        seen = np.flatnonzero(~np.isnan(z_k))
        if len(seen):
            _, K, P, _ = precise.update(P, F, H[seen], R[np.ix_(seen, seen)])
            x = x + K @ (precise.exact(z_k[seen]) - H[seen] @ x)
        found.append((x, P))
    if smooth:
        for k in reversed(range(len(found) - 1)):
            (F, P_p), (x, P), (x_next, P_next) = predicted[k + 1], found[k], found[k + 1]
            C = P @ F.T @ precise.inverse(P_p)
            found[k] = x + C @ (x_next - F @ x), P + C @ (P_next - P_p) @ C.T
    return (np.array(each).astype(float) for each in zip(*found, strict=True))


def drawn(model, dts, seed):
    """Measurements z (N, m) of a simulated track with steps of these lengths."""
    rng, x, z = np.random.default_rng(seed), np.zeros(model.n), []
    for dt in dts:
        F, Q = model.over(dt)
        x = F @ x + square_root(Q) @ rng.standard_normal(model.n)
        z.append(model.H @ x + square_root(model.R) @ rng.standard_normal(model.m))
    return np.array(z)


@pytest.mark.parametrize("pause", [1e5, 1e6, 1e7])
@pytest.mark.parametrize("q", [0.0, 0.01])
def test_a_pause_of_weeks_is_right_or_refused_by_name(pause, q):
    """P was 17 % wrong after pauses of 1e6 s, 62 times after 1e7 s, and without process noise 1.8e8 times.

    Tracks with own pauses, one that has none, and one that is measured only once between two of them.
    """
    model = mpt.constant_acceleration(1.0, q, 0.1, P0=np.eye(3))
    dts = np.ones((60, 4))
    dts[20, 0], dts[40, 0], dts[10, 1], dts[13, 2], dts[14, 2] = pause, pause / 2, pause / 3, pause / 2, pause / 2
    z = 0.3 * np.random.default_rng(1).standard_normal((60, 1, 4))
    z[20, :, 0] = np.nan
    kf = mpt.KalmanFilter(model, t=np.cumsum(dts, axis=0))
    if pause == 1e7:
        with pytest.raises(ValueError, match=r"(t: needs pauses|P0: needs a start) that makes? the first"):
            kf.filter(z)
        return
    found, states = kf.estimates(z), kf.filter(z)
    for track in range(4):
        x, P = of_steps(model, dts[:, track], z[..., track])
        s = deviations(P)
        assert (np.abs(found.x[..., track] - x) < 1e-2 * s).all()
        assert (np.abs(states[..., track] - x) < 1e-2 * s).all()
        assert (np.abs(found.P[..., track] - P) < 1e-2 * s[:, :, None] * s[:, None]).all()


@pytest.mark.parametrize(("S", "digits"), [(1e24, 3), (1e29, 1)])
@pytest.mark.parametrize("pauses", [0, 1, 2])
def test_the_vaguest_starts_keep_the_digits_that_are_stated(S, digits, pauses):
    """The first fix, in row 1, is S times as uncertain as its noise, be it after a pause of 1e6 s or not."""
    assert "At 1e24 three digits of P hold, and near 1e30 one" in TEXT
    dts = np.ones(12)
    dts[[1, 3][:pauses]] = 1e6
    model = mpt.constant_velocity(1.0, 0.0, 0.1, P0=np.diag([1, 0.1 * S / dts[1] ** 2]))
    z = drawn(model, dts, seed=0)
    z[0] = np.nan
    x, P = of_steps(model, dts, z)
    found, s = mpt.KalmanFilter(model, t=np.cumsum(dts)).estimates(z), deviations(P)
    assert (np.abs(found.x - x) < 0.1 * s).all()
    assert (np.abs(found.P - P) < 10.0**-digits * s[:, :, None] * s[:, None]).all()


@pytest.mark.parametrize("start", ["known", "vague"])
@pytest.mark.parametrize("own", [False, True], ids=["times of all", "own times"])
def test_pauses_of_days_on_many_tracks_are_right_on_each(start, own):
    """Tracks go on together from a row, and apart where their gaps differ; one pauses before its start is over."""
    P0 = {"known": 1.0, "vague": 1e14}[start]
    model = mpt.constant_acceleration(1.0, 0.01, 0.1, P0=P0 * np.eye(3))
    rng, M = np.random.default_rng(2), 4
    dts = np.ones((40, M))
    dts[12], dts[25] = 7e5, 5e5
    if own:
        dts[12, 1], dts[2, 2], dts[30, 3] = 1.0, 1e3, 3e5
    z = rng.standard_normal((40, 1, M))
    z[(rng.random(z.shape) < 0.2) & (np.arange(40) > 3)[:, None, None]] = np.nan
    z[2, 0, 2] = np.nan  # the fix after the pause of 1e3 s, before the start is over
    kf = mpt.KalmanFilter(model, t=np.cumsum(dts, axis=0))
    found, states = kf.estimates(z), kf.filter(z)
    for track in range(M):
        x, P = of_steps(model, dts[:, track], z[..., track])
        s = deviations(P)
        assert (np.abs(found.x[..., track] - x) < 1e-2 * s).all()
        assert (np.abs(states[..., track] - x) < 1e-2 * s).all()
        assert (np.abs(found.P[..., track] - P) < 1e-2 * s[:, :, None] * s[:, None]).all()


def test_a_pause_soon_after_a_pause_of_days_loses_no_position():
    """At 4e11 m, three fixes between a pause of five days and one of half a day: x was 2,500 sigma off, P was right."""
    model = mpt.constant_acceleration(1.0, 6e-4, 0.09, P0=9 * np.eye(3))
    dts = np.ones(20)
    dts[8], dts[11] = 4.2e5, 4.2e4
    z = drawn(model, dts, seed=0)
    x, P = of_steps(model, dts, z)
    found = mpt.KalmanFilter(model, t=np.cumsum(dts)).estimates(z)
    assert (np.abs(found.x - x) < 1e-2 * deviations(P)).all()


@pytest.mark.parametrize(("pause", "soon"), [(1e5, 1e3), (1e5, 30.0), (1e6, 30.0)])
def test_a_pause_two_fixes_after_a_pause_of_days_loses_no_position(pause, soon):
    """Two fixes leave the acceleration vague: it was taken from both pauses at once, and x was up to 200 sigma off.

    At 2e14 m, after 1e6 s, a double holds a tenth of a sigma.
    """
    model = mpt.constant_acceleration(1.0, 1.0, 0.1, P0=np.eye(3))
    dts = np.ones(20)
    dts[8], dts[10] = pause, soon
    for seed in range(3):
        z = drawn(model, dts, seed)
        x, P = of_steps(model, dts, z)
        found = mpt.KalmanFilter(model, t=np.cumsum(dts)).estimates(z)
        assert (np.abs(found.x - x) < (0.4 if pause == 1e6 else 1e-2) * deviations(P)).all()


@pytest.mark.parametrize("pause", [1e4, 3e5, 1e6])
@pytest.mark.parametrize("name", ["ca", "cv", "cv in a plane"])
def test_the_smoother_over_a_pause_is_right_or_refused_by_name(name, pause):
    """At a constant acceleration and 1e6 s P was 30 % off, without a word.

    A sensor that does not measure at once after a pause leaves P vague, and does no harm.
    """
    assert "At 1e6 s the smoother refuses a constant acceleration; at 3e5 s one digit of σ holds" in TEXT
    model = AXES[name[:2]](1.0, 0.01, 0.1)
    if "plane" in name:
        model = mpt.stack(model, model)
    model = replace(model, P0=np.eye(model.n))
    dts = np.ones(40)
    dts[12], dts[26] = pause, pause / 3
    z = drawn(model, dts, seed=1)
    z[12:14, 1:] = np.nan
    kf = mpt.KalmanFilter(model, t=np.cumsum(dts))
    if name == "ca" and pause == 1e6:
        with pytest.raises(ValueError, match="t: needs for smooth pauses that leave what is measured"):
            kf.smooth(z)
        return
    x, P = of_steps(model, dts, z, smooth=True)
    found, s = kf.smooth(z), deviations(P)
    assert (np.abs(found.x - x) < 0.1 * s).all()
    assert (np.abs(found.P - P) < 0.1 * s[:, :, None] * s[:, None]).all()


@pytest.mark.parametrize("missing", [[], [5]], ids=["no gap", "a gap"])
def test_a_vague_state_may_show_only_after_some_steps(missing):
    """Two steps pass before the acceleration reaches the position; then all of its digits were lost."""
    F = np.array([[1.0, 1.0, 0.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
    model = mpt.LinearModel(F=F, H=[[1, 0, 0]], Q=np.zeros((3, 3)), R=[[1.0]], P0=np.diag([0, 0, 1e18]))
    z = np.random.default_rng(0).standard_normal((20, 1))
    z[missing] = np.nan
    assert max(off_by(mpt.KalmanFilter(model).estimates(z), model, z)) < 1e-10


@pytest.mark.parametrize("every", [57, 226])
def test_a_vague_start_may_be_measured_seldom(every):
    """Seven fixes in hundreds of rows, no process noise: x was 29 sigma off, P wrong by 4e5 times."""
    model = replace(mpt.constant_acceleration(1.0, 0.0, 1.0), P0=3e15 * np.eye(3))
    z = np.full((7 * every, 1), np.nan)
    z[every // 2 :: every] = 10 * np.random.default_rng(116).standard_normal((7, 1))
    off_x, off_P = off_by(mpt.KalmanFilter(model).estimates(z), model, z)
    assert off_x < 1e-8
    assert off_P < 1e-2  # the first fix is 1e25 times as uncertain as its noise


def of_a_sum(P0, q=0.0):
    """Two states of which only the sum is measured, and one that is measured itself."""
    H = [[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    return mpt.LinearModel(F=np.eye(3), H=H, Q=q * np.eye(3), R=[[2, 1], [1, 3]], P0=P0 * np.eye(3))


@pytest.mark.parametrize("q", [0.0, 0.01])
@pytest.mark.parametrize("P0", [1e12, 1e14, 1e16, 1e20])
def test_a_state_that_nothing_measures_may_be_vague(P0, q):
    """At 1e16 x was wrong by half a sigma and P by twice its size, S by 2 to 10 % at 1e14: now it is refused.

    `step` has no more than the doubles of P, which leave no digit of the sum: from 1e15 on it was wrong by its sigma.
    """
    model = of_a_sum(P0, q)
    z = np.random.default_rng(1).standard_normal((30, 2))
    z[5], z[7, 0] = np.nan, np.nan
    kf = mpt.KalmanFilter(model)
    found = kf.estimates(z)
    assert max(off_by(found, model, z)) < 1e-4
    for each in (kf, mpt.LainiotisFilter(model)):
        if P0 > 1e13:
            with pytest.raises(
                ValueError, match="P: needs a covariance that keeps digits beside the measurement noise"
            ):
                one_after_the_other(each, z)
        else:
            of_sums = (one_after_the_other(each, z) - found.x) @ model.H.T
            assert (np.abs(of_sums) < 1e-2).all()
    *_, S = precise.kalman(model.F, model.H, model.Q, model.R, model.x0, model.P0, z)
    if P0 > 1e13:
        with pytest.raises(ValueError, match="P0: needs a start that leaves digits of the predicted measurements"):
            mpt.metrics.log_likelihood(kf, z)
    else:
        np.testing.assert_allclose(mpt.metrics.innovations(kf, z).S, S.astype(float), rtol=1e-3)


@pytest.mark.parametrize("power", [8, 12, 13, 14, 16, 20])
@pytest.mark.parametrize("make", AXES.values(), ids=AXES)
@pytest.mark.parametrize("q", [0.0, 0.01])
def test_the_smoother_of_a_vague_start_is_right_or_refused_by_name(make, q, power):
    """It was wrong by up to 4,000 sigma at 1e16, with variances below zero, without a word."""
    model = replace(make(0.7, q, 0.1), P0=10.0**power * np.eye(make(1, 1, 1).n))
    z = np.random.default_rng(4).standard_normal((40, 1))
    z[15:25] = np.nan
    kf = mpt.KalmanFilter(model)
    if power <= 12:
        x, P = precise.smoothed(model.F, model.H, model.Q, model.R, model.x0, model.P0, z)
        s, found = deviations(P), kf.smooth(z)
        assert (np.abs(found.x - x.astype(float)) < 0.1 * s).all()
        assert (np.abs(found.P - P.astype(float)) < 0.1 * s[:, :, None] * s[:, None]).all()
    elif power >= 14:
        with pytest.raises(ValueError, match="P0: needs for smooth a start that leaves what is measured"):
            kf.smooth(z)


@pytest.mark.filterwarnings("ignore:smooth. F has damped modes")
def test_a_smoothed_variance_below_zero_is_refused():
    """Modes that are damped and not driven: of these eight models six had one, or NaN, and only a warning said so."""
    refused = []
    for seed in DAMPED:
        model, N, rng = damped(seed, q=0)
        try:
            found = mpt.KalmanFilter(model).smooth(rng.standard_normal((N, 1)))
        except ValueError as error:
            refused.append(str(error))
        else:
            assert (np.einsum("kii->ki", found.P) >= 0).all()
    assert len(refused) > 1
    assert all("z: needs covariances within double precision" in each for each in refused)
