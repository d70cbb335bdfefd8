"""`step`: what it takes and refuses, for every filter that has one; and what two threads at once may not break."""

import warnings
from dataclasses import dataclass, replace

import numpy as np
import pytest
from conftest import AXIS, dense_model
from hypothesis import given
from hypothesis import strategies as st

import mpt_helpers as mpt

CV = mpt.constant_velocity(0.7, 0.04, 0.5, x0=[1.0, 2.0], P0=np.eye(2) + 0.1)
PLANE = mpt.stack(CV, replace(CV, R=[[2.0]]))
KF, LF = mpt.KalmanFilter(AXIS), mpt.LainiotisFilter(AXIS)
SS = mpt.SteadyStateFilter.from_kalman(AXIS)
EACH = {"KF": KF, "LF": LF, "SSKF": SS, "join": mpt.JoinFilter(KF, LF), "separate": mpt.Separate(KF, LF)}
NO_COVARIANCES = {
    "not symmetric": [[1.0, 0.5], [0.4, 1.0]],
    "negative": [[1.0, 0.0], [0.0, -1e-3]],
    "all negative": -np.eye(2),
    "correlated by more than one": [[1.0, 2.0], [2.0, 1.0]],
    "correlated with what is known": [[1.0, 0.1], [0.1, 0.0]],
}


@pytest.mark.parametrize("P", NO_COVARIANCES.values(), ids=NO_COVARIANCES)
@pytest.mark.parametrize("each", EACH.values(), ids=EACH)
def test_a_step_refuses_a_P_that_is_no_covariance(each, P):
    n = each.model.n
    whole = np.eye(n)
    whole[:2, :2] = P
    with pytest.raises(ValueError, match="P: needs a symmetric positive semidefinite matrix"):
        each.step(np.zeros(n), whole.tolist(), np.zeros(each.model.m))


def test_coefficients_from_a_P_that_is_no_covariance_are_refused():
    """`next_step` itself does not look at P, but a measurement of negative variance would have a gain."""
    with pytest.raises(ValueError, match="P: needs a covariance, got one that gives a measurement a variance"):
        mpt.KalmanFilter(CV).next_step(-9 * np.eye(2), np.ones(1, bool))


@dataclass(frozen=True, eq=False)
class Fading(mpt.KalmanFilter):
    """A filter of one's own that forgets: its gain is not that of the best estimate."""

    rate: float = 1.0
    optimal = False

    def __init__(self, model, rate):
        super().__init__(model)
        object.__setattr__(self, "rate", rate)

    def next_step(self, P, *conditions):
        return super().next_step(self.rate * P, *conditions)


def test_a_join_of_filters_of_different_gains_has_no_step():
    """Two filters that forget at different rates would be stepped from one state, silently."""
    slow, fast = Fading(AXIS, 1.01), Fading(AXIS, 1.02)
    P = np.eye(2)
    with pytest.raises(TypeError, match=r"step: needs two filters of the same gain.*Fading and Fading"):
        mpt.JoinFilter(slow, fast).step(AXIS.x0, P, [0.0])  # the innovation is zero: only P tells
    join = mpt.JoinFilter(mpt.Separate(slow, KF), mpt.Separate(fast, KF))
    with pytest.raises(TypeError, match="same gain"):
        join.step(join.model.x0, np.eye(4), [0.0, 0.0])
    for same in (slow, KF):
        for ours, right in zip(
            mpt.JoinFilter(same, same).step(AXIS.x0, P, [0.5]), same.step(AXIS.x0, P, [0.5]), strict=True
        ):
            np.testing.assert_allclose(ours, right)


@given(st.integers(0, 2**32 - 1), st.integers(3, 5))
def test_a_kalman_step_refuses_a_P_that_is_fine_by_pairs_of_states(seed, n):
    """An eigenvalue below zero lies along a sum of all positions."""
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], n)
    P = np.eye(2 * n)
    P[::2, ::2] = np.where(np.eye(n), 1.0, -0.99 * signs[:, None] * signs)
    kf = mpt.KalmanFilter(mpt.stack(*[mpt.constant_velocity(0.1, 1e-3, 1.0)] * n))
    with pytest.raises(ValueError, match="P: needs a symmetric positive semidefinite matrix"):
        kf.step(np.zeros(2 * n), P, np.ones(n))


@pytest.mark.parametrize("name", ["known start", "dense", "12 states"])
def test_a_step_takes_what_it_has_returned(name):
    """Also where variances are zero but for their rounding, and where states are of very different sizes."""
    gps_ins = replace(mpt.gps_ins(1.0, 0.01, (1.0, 1e-4)))
    model = {"known start": gps_ins, "dense": dense_model(1), "12 states": mpt.stack(*[CV] * 6)}[name]
    if name == "dense":
        model = replace(model, F=model.F / np.abs(np.linalg.eigvals(model.F)).max())
    size = np.geomspace(1e-6, 1e6, model.n)
    sized = mpt.LinearModel(
        F=model.F * size[:, None] / size,
        H=model.H / size,
        Q=model.Q * size[:, None] * size,
        R=model.R,
        P0=model.P0 * size[:, None] * size,
    )
    for each in (mpt.KalmanFilter(model), mpt.LainiotisFilter(model), mpt.KalmanFilter(sized)):
        x, P = np.zeros(each.model.n), each.P0
        for z_k in mpt.simulate(each.model, 300, np.random.default_rng(0))[1]:
            x, P = each.step(x, P, z_k)


@pytest.mark.parametrize("dt", [1e60, 1e110, 1e160, 1e300])
@pytest.mark.parametrize("make", [mpt.constant_velocity, mpt.constant_acceleration])
def test_a_step_refuses_a_time_beside_which_doubles_hold_no_measurement(make, dt):
    """At 1e60 s a variance was 6.6e146 m² after a measurement of 0.5 m²; beyond, NaN, without an error."""
    model = make(1.0, 0.04, 0.5)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for z in (1.0, np.nan):
            if not np.isnan(z) or dt > 1e110:
                with pytest.raises(ValueError, match=r"^dt: needs a time .* got 1e\+\d+ s"):
                    mpt.KalmanFilter(model).step(np.zeros(model.n), np.eye(model.n), [z], dt=dt)


@pytest.mark.parametrize("dt", [1e3, 1e5, 1e6])
def test_a_step_takes_a_pause_of_days(dt):
    """P to a thousandth: of sigma in the position as it was measured, 0.5 m²."""
    kf = mpt.KalmanFilter(mpt.constant_acceleration(1.0, 0.04, 0.5, P0=np.eye(3)))
    _, P = kf.step(np.zeros(3), np.eye(3), [1.0], dt=dt)
    np.testing.assert_allclose(P[0, 0], 0.5, rtol=1e-3)


def test_separate_filters_step_with_their_variances():
    z, r = np.array([[1.0, 2.0], [np.nan, 3.0], [0.0, 1.0]]), np.array([[0.3, 1.0], [np.nan, 2.0], [0.1, 4.0]])
    t = np.array([0.7, 1.0, 3.0])
    axes = [mpt.KalmanFilter(CV, t=t, r=r[:, :1]), mpt.KalmanFilter(replace(CV, R=[[2.0]]), t=t, r=r[:, 1:])]
    both, plane = mpt.Separate(*axes), mpt.KalmanFilter(PLANE, t=t, r=r)
    x, P = both.model.x0, both.P0
    for z_k, r_k, dt in zip(z, r, [0.7, 0.3, 2.0], strict=True):
        x, P = both.step(x, P, z_k, dt=dt, r=r_k)
    np.testing.assert_allclose(x, plane.filter(z)[-1], rtol=1e-12)
    np.testing.assert_allclose(P, plane.covariances(z)[-1], rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(both.filter(z), plane.filter(z), rtol=1e-12)
    # Of filters of which only one was given variances, the other has none to be told.
    one = mpt.Separate(mpt.KalmanFilter(CV, r=r[:, :1]), mpt.LainiotisFilter(CV))
    x, _ = one.step(one.model.x0, one.P0, [1.0, 2.0], r=[0.3, np.nan])
    np.testing.assert_allclose(x, one.filter([[1.0, 2.0], [np.nan, 3.0], [0.0, 1.0]])[0], rtol=1e-12)


def test_joint_filters_step_by_dt_and_r():
    join, kf = mpt.JoinFilter(mpt.KalmanFilter(CV), mpt.KalmanFilter(CV)), mpt.KalmanFilter(CV)
    ours, theirs = (each.step(CV.x0, CV.P0, [1.0], dt=2.0, r=[0.2]) for each in (join, kf))
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-14)


NOT_TAKEN = {
    "LF, dt": (lambda: LF.step(AXIS.x0, AXIS.P0, [0.0], dt=1.0), "dt: needs a filter whose `next_step` takes it"),
    "LF, r": (lambda: LF.step(AXIS.x0, AXIS.P0, [0.0], r=[1.0]), "r: needs a filter whose `next_step` takes it"),
    "SSKF, dt": (lambda: SS.step(AXIS.x0, AXIS.P0, [0.0], dt=1.0), "dt: needs a filter whose `next_step` takes it"),
    "join, dt": (lambda: mpt.JoinFilter(KF, LF).step(AXIS.x0, AXIS.P0, [0.0], dt=1.0), "dt: needs"),
    "separate, dt": (
        lambda: mpt.Separate(LF).step(AXIS.x0, AXIS.P0, [0.0], dt=1.0),
        "dt: needs a filter whose `next_step` takes it",
    ),
    "separate, r": (
        lambda: mpt.Separate(LF).step(AXIS.x0, AXIS.P0, [0.0], r=[1.0]),
        "r: needs a filter whose `next_step` takes it",
    ),
    "separate, no r": (
        lambda: mpt.Separate(mpt.KalmanFilter(CV, r=[[1.0]])).step(CV.x0, CV.P0, [0.0]),
        "r: needs the variances of z_k",
    ),
    "separate, r of others": (
        lambda: mpt.Separate(mpt.KalmanFilter(CV)).step(CV.x0, CV.P0, [0.0], r=[1.0, 2.0]),
        r"r: needs a vector of 1 variances, got shape \(2,\)",
    ),
    "a dt whose powers overflow": (
        lambda: mpt.constant_velocity(1e150, 1, 1),
        r"transition: needs a \(2, 2\) array of finite numbers",
    ),
}


@pytest.mark.parametrize(("call", "words"), NOT_TAKEN.values(), ids=NOT_TAKEN)
def test_what_a_step_does_not_take_is_refused_by_name(call, words):
    with pytest.raises(TypeError if "takes it" in words else ValueError, match=words):
        call()


@pytest.mark.parametrize("infinite", [np.inf, -np.inf])
def test_an_infinite_measurement_of_a_step_is_refused_by_name_also_beside_a_missing_one(infinite):
    kf = mpt.KalmanFilter(mpt.stack(AXIS, AXIS))
    for z_k in ([0.0, infinite], [np.nan, infinite]):
        with pytest.raises(ValueError, match=r"z_k: needs .* of numbers, got infinity"):
            kf.step(kf.model.x0, kf.model.P0, z_k)


@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_a_step_refuses_arrays_of_numbers_that_are_not_finite(number):
    """Arrays of floats go another way than lists, since they come in every step."""
    x, P = np.zeros(2), np.eye(2)
    with pytest.raises(ValueError, match=r"x: needs a \(2,\) array of finite numbers"):
        KF.step(np.array([number, 0.0]), P, np.zeros(1))
    with pytest.raises(ValueError, match=r"P: needs a \(2, 2\) array of finite numbers"):
        KF.step(x, np.diag([1.0, number]), np.zeros(1))
    if number == np.inf:
        with pytest.raises(ValueError, match=r"z_k: needs .* of numbers, got infinity"):
            KF.step(x, P, np.array([number]))


@pytest.mark.parametrize("given_besides", [{"t": [1.0, 2.0, 4.0]}, {"r": [[0.5], [1.0], [2.0]]}], ids=["t", "r"])
def test_a_step_of_ones_own_that_would_not_see_times_or_variances_is_refused(given_besides):
    """By columns it is not told of them: each row would silently be filtered with the model's dt and R."""

    class Own(mpt.KalmanFilter):
        def next_step(self, P, seen, **conditions):
            return super().next_step(P, seen, **conditions)

    (name,) = given_besides
    axis = mpt.constant_velocity(1.0, 0.1, 0.5, P0=np.eye(2))
    with pytest.raises(ValueError, match=rf"{name}: needs an `advance` of Own"):
        Own(axis, **given_besides).filter([[1.0], [2.0], [np.nan]])
