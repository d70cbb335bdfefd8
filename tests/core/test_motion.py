"""Transitions of a user's own: one function and all that runs on it, against a plain loop; what is refused and kept."""

import copy
import pickle
import warnings
from dataclasses import replace
from datetime import timedelta
from functools import partial

import numpy as np
import pytest
from motions import TAU, Forgetful, Singer
from oracles import gaussian_conditioning_of_steps, plain_loop, van_loan

import mpt_helpers as mpt
from mpt_helpers import bands, fitting, metrics
from mpt_helpers.model import ConstantVelocity, Scaled, SideBySide


def forgetful(q=0.3, r=0.5, dt=0.7, **given):
    given = {"H": [[1, 0]], "R": [[r]], "x0": [1.0, 2.0], "P0": np.eye(2) + 0.1} | given
    return mpt.LinearModel(transition=Forgetful(TAU, q), dt=dt, **given)


def singer():
    start = {"x0": [1.0, 2.0, 0.5], "P0": np.eye(3) + 0.1}
    return mpt.LinearModel(transition=Singer(TAU, 0.3), dt=0.7, H=[[1, 0, 0]], R=[[0.5]], **start)


def mixed():
    """Axes of two kinds, whose noises are correlated: they become states where a row is partly missing."""
    start = {"x0": [0.0, 1.0], "P0": np.eye(2)}
    return replace(mpt.stack(forgetful(), mpt.constant_velocity(0.7, 0.04, 2.0, **start)), R=[[0.5, 0.3], [0.3, 2.0]])


def of_model(model, T):
    """F and Q over T seconds, made apart."""
    OU = np.array([[0, 1], [0, -1 / TAU]]), [0, 0.3]
    if model.n == 3:
        return van_loan(np.array([[0, 1, 0], [0, 0, 1], [0, 0, -1 / TAU]]), [0, 0, 0.3], T)
    if model.n == 2:
        return van_loan(*OU, T)
    line = np.array([[0.0, 1.0], [0.0, 0.0]]), [0, 0.04]
    F, Q = np.zeros((2, 4, 4))
    F[:2, :2], Q[:2, :2] = van_loan(*(line if isinstance(model.transition.transitions[0], ConstantVelocity) else OU), T)
    F[2:, 2:], Q[2:, 2:] = van_loan(*line, T)
    return F, Q


def plane():
    """Powers of the length, and correlated noises."""
    axis = mpt.constant_velocity(0.7, 0.04, 2.0, x0=[0.0, 1.0], P0=np.eye(2))
    return replace(mpt.stack(axis, axis), R=[[0.5, 0.3], [0.3, 2.0]])


MODELS = {"forgetful": forgetful, "singer": singer, "two kinds, correlated noises": mixed, "plane": plane}


# A hundred products of numbers of order 10, in both.
SAME = {"rtol": 1e-8, "atol": 1e-9}


@pytest.mark.parametrize(
    ("precise", "own"), [(False, None), (True, 3)], ids=["one track, R", "tracks of their own times and variances"]
)
@pytest.mark.parametrize("make", MODELS.values(), ids=MODELS)
def test_a_motion_of_ones_own_takes_steps_of_any_length(make, precise, own):
    """Filter, covariances, innovations, likelihood and smoother, over 60 rows with gaps: in pieces too."""
    model, N = make(), 60
    rng = np.random.default_rng(1)
    shape = () if own is None else (own,)
    lengths = rng.choice([0.0, 0.1, 1.0, 4.0], (N, *shape))
    t = np.cumsum(0.7 * lengths, axis=0)
    z = 3 * rng.standard_normal((N, model.m, *shape))
    z[rng.random(z.shape) < 0.3] = np.nan
    r = rng.uniform(0.2, 3.0, z.shape) if precise else None
    kf = mpt.KalmanFilter(model, t=t, r=r)
    e, s, new, log_l = kf.estimates(z), kf.smooth(z), metrics.innovations(kf, z), metrics.log_likelihood(kf, z)
    np.testing.assert_allclose(kf.filter(z), e.x, **SAME)
    for i in range(own or 1):
        one = (lambda array: array) if own is None else (lambda array, i=i: array[..., i])
        steps = [of_model(model, T) for T in [0.7, *np.diff(one(t))]]
        variances = [np.diag(row) for row in one(r)] if precise else [model.R] * N
        loop = plain_loop(steps, model.H, variances, model.x0, model.P0, one(z))
        np.testing.assert_allclose(one(e.x), loop.x, **SAME)
        np.testing.assert_allclose(one(e.P), loop.P, **SAME)
        np.testing.assert_allclose(one(new.values), loop.innovations, **SAME)
        np.testing.assert_allclose(one(new.S), loop.S, **SAME)
        np.testing.assert_allclose(np.atleast_1d(log_l)[i], loop.log_density, rtol=1e-9)
        exact = gaussian_conditioning_of_steps(
            [F for F, _ in steps], [Q for _, Q in steps], model.H, variances, model.x0, model.P0, one(z)
        )
        np.testing.assert_allclose(one(s.x), exact.x_smooth, rtol=1e-6, atol=1e-7)  # the dense solution rounds more
        np.testing.assert_allclose(one(s.P), exact.P_smooth, rtol=1e-6, atol=1e-7)


def test_what_rounding_leaves_of_a_zero_is_no_lost_digit():
    """scipy 1.18's exponential leaves 1e-16 there; a tenth of the velocity is refused as before."""

    def rounded(dt, left=2e-16):
        F, Q = Singer(TAU, 0.3)(dt)
        F[2, 1] += left if dt >= 0.7 else 0.0
        return F, Q

    given = {"dt": 0.7, "H": [[1, 0, 0]], "R": [[0.5]], "P0": np.eye(3)}
    model = mpt.LinearModel(transition=rounded, **given)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mpt.KalmanFilter(model, t=[0.7, 3.5, 6.3]).filter(np.ones((3, 1)))
    with pytest.raises(ValueError, match="two steps of dt / 2"):
        mpt.LinearModel(transition=lambda dt: rounded(dt, left=0.1), **given)


@pytest.mark.parametrize("make", MODELS.values(), ids=MODELS)
def test_steps_of_one_length_and_single_steps_are_the_filter(make):
    model = make()
    z = mpt.simulate(model, 40, np.random.default_rng(2))[1]
    grid, timed = mpt.KalmanFilter(model), mpt.KalmanFilter(model, t=0.7 * np.arange(40))
    np.testing.assert_allclose(timed.filter(z), grid.filter(z), **SAME)
    np.testing.assert_allclose(mpt.LainiotisFilter(model).filter(z), grid.filter(z), **SAME)
    x, P = model.x0, model.P0
    for z_k in z:
        x, P = timed.step(x, P, z_k, dt=0.7)
    np.testing.assert_allclose(x, grid.filter(z)[-1], **SAME)
    np.testing.assert_allclose(model.over(2.1), of_model(model, 2.1), rtol=1e-7, atol=1e-9)


def test_a_fit_finds_the_parameters_of_a_motion_of_ones_own():
    t = np.cumsum(
        np.random.default_rng(3).integers(2, 20, 600) / 10
    )  # few lengths: this transition takes one at a time
    x, z, rng = np.zeros(2), [], np.random.default_rng(4)
    for T in [0.7, *np.diff(t)]:
        F, Q = of_model(forgetful(), T)
        x = F @ x + np.linalg.cholesky(Q) @ rng.standard_normal(2)
        z.append([x[0] + np.sqrt(0.5) * rng.standard_normal()])
    found = mpt.fit(lambda q, r: mpt.KalmanFilter(forgetful(q, r, x0=[0, 0]), t=t), np.array(z), q=1.0, r=1.0)
    for name, true in {"q": 0.3, "r": 0.5}.items():
        assert abs(np.log(found.values[name] / true)) < 4 * found.log_errors[name]
        assert found.log_errors[name] < 0.5


def test_a_band_of_a_motion_of_ones_own_looks_ahead_by_it():
    rng = np.random.default_rng(5)
    t = np.cumsum(rng.uniform(0.5, 1.0, 80))
    z = np.cumsum(rng.standard_normal((80, 1)), axis=0)
    model = forgetful()
    kf = mpt.KalmanFilter(model, t=t)
    a, e = bands.ahead(kf, z, seconds=2.0), kf.estimates(z)
    for k, (row, due) in enumerate(zip(a.row, a.due_row, strict=True)):
        F, Q = of_model(model, t[due] - t[row])
        S = (F @ e.P[row] @ F.T + Q)[0, 0] + 0.5
        np.testing.assert_allclose(a.errors[k, 0], z[due, 0] - (F @ e.x[row])[0], rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(a.sigma[k, 0], np.sqrt(S), rtol=1e-9)
    live, (x, P) = bands.LiveBand(kf, 2.0), (model.x0, model.P0)
    x, P = kf.step(x, P, z[0], dt=model.dt)
    F, _ = of_model(model, 2.0)
    np.testing.assert_allclose(live.step(t[0], z[0], x, P).position, (F @ x)[:1], rtol=1e-9)


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda each: pickle.loads(pickle.dumps(each))])
@pytest.mark.parametrize(
    "make", [*MODELS.values(), lambda: mpt.constant_velocity(0.7, 0.1, 1.0), lambda: mpt.gsm_axis(1, 1, 1)]
)
def test_a_copy_of_a_model_has_its_motion(make, copied):
    model = make()
    kf = mpt.KalmanFilter(model)
    again = copied(model)
    assert (again, hash(again), again.transition) == (model, hash(model), model.transition)
    assert copied(kf) == kf
    assert replace(model, H=2 * model.H).transition == model.transition
    if model.transition is not None:
        np.testing.assert_array_equal(again.over(1.3), model.over(1.3))


def test_transitions_of_other_numbers_make_other_models():
    """Also where the F and Q of one step are the same."""
    axis = mpt.constant_velocity(0.7, 0.1, 1.0)
    other = mpt.LinearModel(transition=Singer(2 * TAU, 0.3), dt=0.7, H=[[1, 0, 0]], R=[[0.5]])
    assert other != mpt.LinearModel(transition=Singer(TAU, 0.3), dt=0.7, H=[[1, 0, 0]], R=[[0.5]])
    assert mpt.LinearModel(F=axis.F, H=axis.H, Q=axis.Q, R=axis.R) != axis
    assert replace(axis, transition=ConstantVelocity(0.2)) != axis


def test_a_model_keeps_its_transition_without_noise_and_loses_it_with_another_F():
    model, axes = forgetful(), mixed()
    for quiet in (mpt.exact_motion(model, [0, 20]), mpt.exact_motion(axes, [0, 20, 0, 0])):
        assert quiet.dt == 0.7
        F, Q = quiet.over(2.0)
        np.testing.assert_array_equal(F, (model if quiet.n == 2 else axes).over(2.0)[0])
        assert not Q.any()
    for other in (replace(model, F=np.eye(2)), replace(model, Q=2 * model.Q), replace(axes, F=np.eye(4))):
        assert (other.dt, other.transition) == (0.7, None)
        with pytest.raises(ValueError, match="t: needs a model with a transition"):
            mpt.KalmanFilter(other, t=[0.0, 1.0])


def test_a_stack_has_the_transitions_of_its_axes():
    both = mpt.stack(mpt.stack(forgetful(), forgetful()), mpt.constant_velocity(0.7, 1, 1))
    assert both.transition == SideBySide((Forgetful(TAU, 0.3), Forgetful(TAU, 0.3), ConstantVelocity(1.0)))
    one_length = mpt.stack(forgetful(), mpt.gsm_axis(0.7, 1, 1))
    assert (one_length.dt, one_length.transition) == (0.7, None)


def a_walk(q=0.5):
    """Its F says nothing of dt."""
    return of(partial(walk, q=q))


def walk(dt, q):
    return np.eye(1), np.array([[q * dt]])


@pytest.mark.parametrize(
    "make", [*MODELS.values(), a_walk, lambda: a_walk(0.0), lambda: mpt.exact_motion(forgetful(), [0, 20])]
)
def test_another_dt_or_transition_makes_another_F_and_Q(make):
    """`replace` hands on the F and Q that it finds: once they stayed, and the transition was lost."""
    model = make()
    longer = replace(model, dt=2.0)
    assert longer.dt == 2.0
    np.testing.assert_array_equal((longer.F, longer.Q), model.over(2.0))
    louder = replace(model, transition=Scaled(model.transition, 3.0))
    np.testing.assert_array_equal((louder.F, louder.Q), (model.F, 3.0 * model.Q))
    for each in (longer, louder, pickle.loads(pickle.dumps(longer)), replace(longer, R=2 * model.R)):
        np.testing.assert_array_equal(each.over(1.3), (louder if each is louder else model).over(1.3))
        assert replace(replace(each, dt=0.3), dt=each.dt) == each


def test_what_is_replaced_on_purpose_stays():
    model = forgetful()
    other = replace(model, dt=2.0, Q=np.eye(2))
    assert (other.dt, other.transition) == (2.0, None)
    np.testing.assert_array_equal((other.F, other.Q), (model.over(2.0)[0], np.eye(2)))
    for change in ({"F": np.eye(2)}, {"Q": np.eye(2)}, {"transition": None}):
        other = replace(model, **change)
        assert (other.dt, other.transition) == (0.7, None)
        assert pickle.loads(pickle.dumps(other)) == other
        np.testing.assert_array_equal((other.F, other.Q), (change.get("F", model.F), change.get("Q", model.Q)))


def test_another_step_of_a_model_without_a_transition_is_its_F_and_Q():
    """Once refused, since the dt was another one."""
    slow, quick = mpt.gsm_axis(5.0, 0.01, 0.1), mpt.gsm_axis(2.0, 0.01, 0.1)
    made = replace(slow, F=quick.F, Q=quick.Q, H=quick.H, dt=2.0)
    assert made == quick
    assert replace(replace(slow, dt=None), dt=5.0) == slow
    with pytest.raises(ValueError, match="those of the model are for 2 s"):
        replace(made, dt=5.0)


@pytest.mark.parametrize("dt", [timedelta(minutes=1), np.timedelta64(1, "m"), [timedelta(minutes=1)], [60]])
def test_over_takes_lengths_of_time(dt):
    np.testing.assert_array_equal(forgetful().over(dt)[0], np.reshape(forgetful().over(60.0)[0], (*np.shape(dt), 2, 2)))


@pytest.mark.parametrize(
    "dt", [-1.0, [1.0, -1e-9], np.nan, np.inf, timedelta(-1), np.timedelta64("NaT"), "1", None, [[1], [1, 2]]]
)
def test_over_refuses_what_is_no_length_of_time(dt):
    """A step of -1 s once had a negative Q."""
    with pytest.raises((ValueError, TypeError), match="dt: needs finite lengths of time that are not negative, got "):
        forgetful().over(dt)


ONE_LENGTH = {
    "gsm_axis": mpt.gsm_axis(5.0, 0.01, 0.1),
    "gps_ins": mpt.gps_ins(5.0, 0.01, (1.0, 1.0)),
    "of one's own": mpt.LinearModel(F=[[1.0]], H=[[1.0]], Q=[[1.0]], R=[[1.0]], dt=timedelta(seconds=5)),
}


@pytest.mark.parametrize("model", ONE_LENGTH.values(), ids=ONE_LENGTH)
def test_a_model_of_one_length_knows_it(model):
    for each in (model, mpt.stack(model, model), replace(model, R=2 * model.R), pickle.loads(pickle.dumps(model))):
        assert (each.dt, each.transition) == (5.0, None)
        np.testing.assert_array_equal(mpt.KalmanFilter(each).times_of(3), [0.0, 5.0, 10.0])
    kf, z = mpt.KalmanFilter(model), np.zeros((300, model.m))
    assert fitting.blocks_of(kf, z).name == "6 blocks of 50 fixes"
    assert fitting.blocks_of(kf, np.zeros((900, model.m))).name == "15 blocks of 60 fixes"  # of 300 s
    assert replace(model, dt=None).dt is None
    for call in (lambda: mpt.KalmanFilter(model, t=[0.0, 5.0]), lambda: bands.ahead(kf, z, seconds=5.0)):
        with pytest.raises(ValueError, match=r"needs a model .*one length only"):
            call()
    with pytest.raises(ValueError, match="dt: needs a model with a transition"):
        kf.step(model.x0, kf.P0, z[0], dt=1.0)


def test_separate_filters_of_one_length_are_those_of_one_step():
    both = mpt.Separate(*[mpt.KalmanFilter(mpt.gsm_axis(5.0, 0.01, 0.1))] * 2)
    np.testing.assert_array_equal(both.times_of(2), [0.0, 5.0])


def wrong(f=1.0, power=1.0, at_zero=0.0):
    """A random walk, parts of which may be wrong."""
    return lambda dt: (np.array([[f]]), np.array([[dt**power + at_zero]]))


def of(transition, dt=1.0):
    return mpt.LinearModel(transition=transition, dt=dt, H=[[1]], R=[[1]])


REFUSED = {
    "no function": (lambda: of(3), TypeError, "transition: needs a function of dt that returns F and Q as arrays"),
    "no pair": (lambda: of(lambda dt: np.eye(1)), TypeError, "transition: needs a function of dt"),
    "lists": (lambda: of(lambda dt: ([[1.0]], [[dt]])), TypeError, r"returns F and Q as arrays, got \(\[\["),
    "no dt": (lambda: of(wrong(), dt=None), TypeError, "dt: needs a length of step, since the model has a transition"),
    "dt of zero": (lambda: of(wrong(), dt=0.0), ValueError, "dt: needs"),
    "Q of the square of the length": (lambda: of(wrong(power=2.0)), ValueError, "two steps of dt / 2 to be one"),
    "F that is not the identity at zero": (lambda: of(wrong(f=0.9)), ValueError, "F = I and Q = 0 over a step of zero"),
    "Q that is not zero at zero": (lambda: of(wrong(at_zero=1.0)), ValueError, "F = I and Q = 0 over a step of zero"),
    "Q of another shape": (lambda: of(lambda dt: (np.eye(2), np.eye(1))), ValueError, "transition: needs a"),
    "no Q": (lambda: mpt.LinearModel(F=[[1]], H=[[1]], R=[[1]]), TypeError, "Q: needs a .* got None"),
    "no F": (lambda: mpt.LinearModel(H=[[1]], R=[[1]]), TypeError, "F: needs a matrix, got None"),
    "F beside a transition": (
        lambda: mpt.LinearModel(F=[[2]], transition=wrong(), dt=1.0, H=[[1]], R=[[1]]),
        ValueError,
        "transition: needs to be given without F and Q, which it makes",
    ),
    "Q replaced beside the transition": (
        lambda: replace(forgetful(), Q=np.eye(2), transition=Forgetful(TAU, 0.1)),
        ValueError,
        "transition: needs to be given without F and Q, which it makes",
    ),
    "another dt for the same F and Q": (
        lambda: replace(mpt.gsm_axis(5, 1, 1), dt=2.0),
        ValueError,
        "dt: needs a transition, or F and Q of such a step: those of the model are for 5 s, got 2 s",
    ),
    "another dt after none": (
        lambda: replace(replace(mpt.gsm_axis(5, 1, 1), dt=None), dt=2.0),
        ValueError,
        "dt: needs a transition, or F and Q of such a step: those of the model are for 5 s, got 2 s",
    ),
    "another dt and F without its Q": (
        lambda: replace(mpt.gsm_axis(5, 1, 1), F=np.eye(2), dt=2.0),
        ValueError,
        "dt: needs a transition, or F and Q of such a step: those of the model are for 5 s, got 2 s",
    ),
    "another dt without the transition": (
        lambda: replace(forgetful(), dt=2.0, transition=None),
        ValueError,
        "dt: needs a transition, or F and Q of such a step: those of the model are for 0.7 s, got 2 s",
    ),
    "a stack of two dt, of one length each": (
        lambda: mpt.stack(mpt.gsm_axis(1, 1, 1), mpt.gsm_axis(5, 1, 1)),
        ValueError,
        "models: needs models of the same dt, got 1.0 s and 5.0 s",
    ),
    "a stack of none": (mpt.stack, ValueError, "models: needs at least one model, got none"),
    "a stack of two dt": (
        lambda: mpt.stack(mpt.gsm_axis(1, 1, 1), forgetful(), forgetful(dt=0.5)),
        ValueError,
        "models: needs models of the same dt, got 1.0 s and 0.7 s and 0.5 s",
    ),
}


@pytest.mark.parametrize(("call", "error", "words"), REFUSED.values(), ids=REFUSED)
def test_what_is_no_transition_is_refused_by_name(call, error, words):
    with pytest.raises(error, match=words):
        call()


def test_the_first_step_is_one_dt_and_the_others_those_of_the_times():
    z = np.array([[1.0], [2.0], [2.5]])
    slow = mpt.KalmanFilter(forgetful(dt=0.7), t=[0.7, 1.4, 5.0])
    fast = mpt.KalmanFilter(forgetful(dt=0.1), t=[0.1, 0.8, 4.4])
    assert not np.allclose(slow.filter(z), fast.filter(z))  # the first step is one dt
    late = replace(fast, t=[0.1, 0.8, 4.4])
    np.testing.assert_allclose(fast.filter(z), late.filter(z))
    x, P = slow.model.x0, slow.model.P0
    for z_k, dt in zip(z, [0.7, 0.7, 3.6], strict=True):
        x, P = fast.step(x, P, z_k, dt=dt)
    np.testing.assert_allclose(x, slow.filter(z)[-1], **SAME)


@pytest.mark.parametrize("make", MODELS.values(), ids=MODELS)
def test_an_advance_keeps_its_promises(make):
    """Linear in x, a P that no measurement changes, the same when called twice, innovations whose squares are NIS."""
    model = make()
    rng = np.random.default_rng(6)
    t, z = np.cumsum(rng.uniform(0.1, 2.0, 30)), rng.standard_normal((30, model.m, 5))
    z[rng.random(z.shape) < 0.2] = np.nan
    kf = mpt.KalmanFilter(model, t=t)
    x, P = np.tile(model.x0[:, None, None], 5), np.tile(model.P0[..., None], 5)
    nis = metrics.nis(kf, z)
    for k, (z_k, *conditions) in enumerate(zip(*kf.epochs_of(z).rows()[:4], [None] * 30, strict=True)):

        def advance(z, x, P, conditions=conditions):
            return kf.advance((z, *conditions), x, P)

        before = x.copy(), P.copy()
        first, second = advance(z_k, x, P), advance(z_k, x, P)
        for a, b in zip(first, second, strict=True):
            np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(x, before[0])
        np.testing.assert_array_equal(P, before[1])
        of_zero = advance(0 * z_k, x, P)
        np.testing.assert_array_equal(of_zero[1], first[1])
        from_zero = advance(z_k, 0 * x, P)
        both = advance(2 * z_k, 3 * x, P)
        for i in (0, 2):
            alone = advance(0 * z_k, x, P)[i]
            np.testing.assert_allclose(both[i], 2 * from_zero[i] + 3 * alone, rtol=1e-9, atol=1e-12)
        squares = (first[2] ** 2).sum(axis=(0, 1))
        np.testing.assert_allclose(squares, np.nan_to_num(nis[k]), rtol=1e-12, atol=1e-13)
        x, P, _ = first


def textbook(dt, tau=20.0):
    """The velocity that is forgotten within tau, by a closed form that subtracts large numbers."""
    a = np.exp(-dt / tau)
    Q_ss = tau**2 * (dt - 2 * tau * (1 - a) + tau / 2 * (1 - a**2))
    Q_sv = tau**2 / 2 * (1 - 2 * a + a**2)
    return np.array([[1, tau * (1 - a)], [0, a]]), np.array([[Q_ss, Q_sv], [Q_sv, tau / 2 * (1 - a**2)]])


def test_a_transition_that_loses_its_digits_over_short_steps_is_warned_of():
    """Over a second it is right to ten digits, and over a tenth of a millisecond its Q is rounding."""
    model = mpt.LinearModel(transition=textbook, dt=1.0, H=[[1, 0]], R=[[1e-6]], P0=np.eye(2))
    z = np.zeros((5, 1))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mpt.KalmanFilter(model, t=[0.0, 1.0, 2.5, 9.0, 100.0]).filter(z)
    with pytest.warns(UserWarning, match=r"t: over 0.0001 s the transition's F and Q are not those of two half steps"):
        mpt.KalmanFilter(model, t=[0.0, 1.0, 1.0001, 2.0, 3.0]).filter(z)


def test_no_length_of_step_gives_no_matrices():
    """A horizon beyond the track asks for the F and Q of no step at all, also of a transition of a single dt."""
    model = mpt.LinearModel(transition=Singer(10.0, 0.1), dt=1.0, H=[[1, 0, 0]], R=[[1.0]], P0=np.eye(3))
    F, Q = model.over([])
    assert F.shape == Q.shape == (0, 3, 3)


def test_a_transition_without_finite_matrices_over_a_gap_is_refused_by_name():
    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])  # Singer's: the exponential overflows
    transition = partial(van_loan, A, [0.0, 0.0, 0.3])
    model = mpt.LinearModel(transition=transition, dt=1.0, H=[[1, 0, 0]], R=[[0.5]], P0=np.eye(3))
    t = np.array([0.0, 1.0, 2.0, 2000.0, 2001.0])
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        with pytest.raises(ValueError, match=r"t: needs steps over which the transition gives finite F and Q.* 1998 s"):
            mpt.KalmanFilter(model, t=t).filter(np.zeros((5, 1)))
