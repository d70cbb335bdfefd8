"""Motions of a user's own: one class and all that runs on it, against a plain loop; what is refused, what is kept."""

import copy
import pickle
import warnings
from dataclasses import dataclass, replace

import numpy as np
import pytest
from motions import TAU, Forgetful, Singer
from oracles import gaussian_conditioning_of_steps, plain_loop, van_loan

import mpt_helpers as mpt
from mpt_helpers import bands, metrics
from mpt_helpers._engine import run as engine
from mpt_helpers._immutable import Immutable
from mpt_helpers.motion import Motion, OneLength, Powers, SideBySide, matrices


@dataclass(frozen=True, eq=False)
class Decaying(Immutable, Motion):
    """States that decay, each at a rate of its own: a motion that holds an array, and counts for how many lengths."""

    dt: float
    rates: np.ndarray
    asked: list | tuple

    def over(self, length):
        if isinstance(self.asked, list):
            self.asked.append(np.size(length))
        kept = np.exp(-np.multiply.outer(np.asarray(length) * self.dt, self.rates))
        return kept[..., None] * np.eye(2), (1 - kept**2)[..., None] * np.eye(2)


@dataclass(frozen=True)
class OfNumbers(Motion):
    """A motion whose F is made by numpy from a list, which it can of one length only."""

    dt: float

    def over(self, length):
        return np.array([[1, length], [0, 1]]), 0 * np.array([[1, length], [length, 1]])


def forgetful(q=0.3, r=0.5, dt=0.7, **given):
    given = {"H": [[1, 0]], "R": [[r]], "x0": [1.0, 2.0], "P0": np.eye(2) + 0.1} | given
    return mpt.LinearModel(motion=Forgetful(dt, TAU, q), **given)


def singer():
    start = {"x0": [1.0, 2.0, 0.5], "P0": np.eye(3) + 0.1}
    return mpt.LinearModel(motion=Singer(0.7, TAU, 0.3), H=[[1, 0, 0]], R=[[0.5]], **start)


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
    F[:2, :2], Q[:2, :2] = van_loan(*(line if isinstance(model.motion, Powers) else OU), T)
    F[2:, 2:], Q[2:, 2:] = van_loan(*line, T)
    return F, Q


def plane():
    """Powers of the length, and correlated noises."""
    axis = mpt.constant_velocity(0.7, 0.04, 2.0, x0=[0.0, 1.0], P0=np.eye(2))
    return replace(mpt.stack(axis, axis), R=[[0.5, 0.3], [0.3, 2.0]])


MODELS = {"forgetful": forgetful, "singer": singer, "two kinds, correlated noises": mixed, "plane": plane}


# A hundred products of numbers of order 10, in both.
SAME = {"rtol": 1e-8, "atol": 1e-9}


@pytest.mark.parametrize("own", [None, 3], ids=["one track", "tracks of their own times"])
@pytest.mark.parametrize("precise", [False, True], ids=["R", "variances of their own"])
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


@dataclass(frozen=True)
class Rounded(Singer):
    """A motion whose F has rounding where a zero should be, over steps of at least one dt, as an exponential leaves."""

    left: float = 2e-16

    def over(self, length):
        F, Q = super().over(length)
        F = F.copy()
        F[..., 2, 1] += np.where(np.asarray(length) >= 1, self.left, 0.0)
        return F, Q


def test_what_rounding_leaves_of_a_zero_is_no_lost_digit():
    """scipy 1.18's exponential leaves 1e-16 there; a tenth of the velocity is refused as before."""
    model = mpt.LinearModel(motion=Rounded(0.7, TAU, 0.3), H=[[1, 0, 0]], R=[[0.5]], P0=np.eye(3))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mpt.KalmanFilter(model, t=[0.7, 3.5, 6.3]).filter(np.ones((3, 1)))
    with pytest.raises(ValueError, match="half"):
        mpt.LinearModel(motion=Rounded(0.7, TAU, 0.3, left=0.1), H=[[1, 0, 0]], R=[[0.5]], P0=np.eye(3))


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
    np.testing.assert_allclose(model.over(3.0), of_model(model, 2.1), rtol=1e-7, atol=1e-9)


def test_a_fit_finds_the_parameters_of_a_motion_of_ones_own():
    t = np.cumsum(np.random.default_rng(3).uniform(0.2, 2.0, 600))
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
    kf.filter(np.zeros((4, model.m)))  # what a motion has made for its steps is no part of its value
    again = copied(model)
    assert (again, hash(again), again.motion) == (model, hash(model), model.motion)
    assert copied(kf) == kf
    assert replace(model, H=2 * model.H).motion == model.motion
    if model.dt is not None:
        np.testing.assert_array_equal(again.over([0.0, 1.3]), model.over([0.0, 1.3]))


def test_motions_of_other_numbers_make_other_models():
    """Also where the F and Q of one step are the same."""

    class Backwards(Powers):
        """The same numbers, but another motion."""

    axis = mpt.constant_velocity(0.7, 0.1, 1.0)
    other = mpt.LinearModel(motion=Singer(0.7, 2 * TAU, 0.3), H=[[1, 0, 0]], R=[[0.5]])
    assert other != mpt.LinearModel(motion=Singer(0.7, TAU, 0.3), H=[[1, 0, 0]], R=[[0.5]])
    assert OneLength(axis.F, axis.Q) != axis.motion
    assert replace(axis, dt=None) != axis
    assert Backwards(axis.F, axis.Q, axis.powers, 0.7) != axis.motion


def test_a_model_keeps_its_motion_without_noise_and_loses_it_with_another_F():
    model, axes = forgetful(), mixed()
    for quiet in (mpt.exact_motion(model, [0, 20]), replace(axes, Q=0 * axes.Q)):
        assert quiet.dt == 0.7
        F, Q = quiet.over(2.0)
        np.testing.assert_array_equal(F, (model if quiet.n == 2 else axes).over(2.0)[0])
        assert not Q.any()
    half = axes.Q.copy()
    half[2:, 2:] = 0  # of one axis only
    assert replace(axes, Q=half).dt == 0.7
    for other in (replace(model, F=np.eye(2)), replace(model, Q=2 * model.Q), replace(axes, F=np.eye(4))):
        assert (other.dt, type(other.motion)) == (None, OneLength)
        with pytest.raises(ValueError, match="t: needs a model that says"):
            mpt.KalmanFilter(other, t=[0.0, 1.0])


def test_a_stack_has_the_motions_of_its_axes():
    assert isinstance(mpt.stack(forgetful(), forgetful()).motion, SideBySide)
    assert isinstance(mpt.stack(*[mpt.constant_velocity(1, 1, 1)] * 2).motion, Powers)
    assert mpt.stack(forgetful(), mpt.gsm_axis(0.7, 1, 1)).dt is None


class Missing(Motion):
    """Of no dt."""

    def over(self, length):
        return np.ones((*np.shape(length), 1, 1)), np.zeros((*np.shape(length), 1, 1))


@dataclass(frozen=True)
class Wrong(Motion):
    """A random walk whose parts may be wrong."""

    dt: float = 1.0
    f: float = 1.0
    power: float = 1.0
    at_zero: float = 0.0
    many: bool = True

    def over(self, length):
        s = np.asarray(length, dtype=float) if self.many else float(np.ravel(length)[0])
        return matrices([[self.f + 0 * s]]), matrices([[s**self.power + self.at_zero]])


REFUSED = {
    "no motion": (lambda: mpt.LinearModel(motion=3, H=[[1]], R=[[1]]), TypeError, "motion: needs a Motion"),
    "no dt": (lambda: of(Missing()), TypeError, "motion.dt: needs a positive number, got None"),
    "dt of zero": (lambda: of(Wrong(dt=0.0)), ValueError, "motion.dt: needs a positive number"),
    "Q of the square of the length": (lambda: of(Wrong(power=2.0)), ValueError, "two steps of half a length"),
    "F that is not the identity at zero": (lambda: of(Wrong(f=0.9)), ValueError, "F = I and Q = 0 over a step of"),
    "Q that is not zero at zero": (lambda: of(Wrong(at_zero=1.0)), ValueError, "F = I and Q = 0 over a step of"),
    "one length at a time": (lambda: of(Wrong(many=False)), ValueError, r"of 3 lengths, \(1, 1\)"),
    "other dt": (lambda: replace(forgetful(), dt=1.0), ValueError, "dt: needs the dt of the motion, 0.7 s, got 1 s"),
    "numbers only": (
        lambda: of(OfNumbers(1.0)),
        ValueError,
        "lengths .K,.: see `matrices`, got of 3 lengths, the error",
    ),
    "no Q": (
        lambda: mpt.LinearModel(F=[[1]], H=[[1]], R=[[1]]),
        TypeError,
        "Q: needs a matrix, as F does, or a motion",
    ),
    "no F": (
        lambda: mpt.LinearModel(H=[[1]], R=[[1]]),
        TypeError,
        "F: needs a matrix, as Q does, or a motion in place of both, got None",
    ),
    "dt without powers": (lambda: given(dt=1.0), ValueError, "dt: needs powers, or a motion in place of F and Q"),
    "powers without dt": (lambda: given(powers=[0.5]), ValueError, "powers: needs a dt"),
    "powers that do not fit": (lambda: given(dt=1.0, powers=[1.5]), ValueError, "powers: needs two steps of dt / 2"),
    "a stack of two dt": (
        lambda: mpt.stack(mpt.gsm_axis(1, 1, 1), forgetful(), forgetful(dt=0.5)),
        ValueError,
        r"models\[2\].dt: needs a model that says the same dt as models\[1\], 0.7 s, got 0.5 s",
    ),
}


def of(motion):
    return mpt.LinearModel(motion=motion, H=[[1]], R=[[1]])


def of_two(motion):
    return mpt.LinearModel(motion=motion, H=[[1, 1]], R=[[1]])


def given(**more):
    return mpt.LinearModel(F=[[1]], H=[[1]], Q=[[1]], R=[[1]], **more)


@pytest.mark.parametrize(("call", "error", "words"), REFUSED.values(), ids=REFUSED)
def test_what_is_no_motion_is_refused_by_name(call, error, words):
    with pytest.raises(error, match=words):
        call()


def test_a_motion_that_holds_an_array_is_compared_and_hashed():
    models = [of_two(Decaying(1.0, np.array(rates), ())) for rates in ([1.0, 2.0], [1.0, 2.0], [1.0, 3.0])]
    assert models[0] == models[1] != models[2]
    assert len(set(models)) == 2


def test_steps_of_equal_lengths_are_made_once_for_all_columns():
    """An `over` may be dear: a hundred tracks with steps of two lengths ask for two at a time."""
    model = of_two(Decaying(1.0, np.array([1.0, 2.0]), []))
    t = np.cumsum(np.random.default_rng(1).choice([0.5, 2.0], (30, 100)), axis=0)
    z = np.random.default_rng(2).standard_normal((30, 1, 100))
    kf = mpt.KalmanFilter(model, t=t)
    model.motion.asked.clear()
    x = kf.filter(z)
    assert max(model.motion.asked) == 2
    alone = mpt.KalmanFilter(model, t=t[:, 7]).filter(z[..., 7])
    np.testing.assert_allclose(x[..., 7], alone, **SAME)


def test_a_motion_is_the_only_thing_that_a_step_of_another_length_asks():
    """Lengths are in units of dt, whatever dt is."""
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
    epochs = kf.epochs_of(z)
    advance, rows, x, P = engine.start_on_columns(kf, epochs.layout.rows(epochs))
    nis = metrics.nis(kf, z)
    for k, row in enumerate(rows):
        before = x.copy(), P.copy()
        first, second = advance(row, x, P), advance(row, x, P)
        for a, b in zip(first, second, strict=True):
            np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(x, before[0])
        np.testing.assert_array_equal(P, before[1])
        of_zero = advance(row._replace(z=0 * row.z), x, P)
        np.testing.assert_array_equal(of_zero[1], first[1])
        from_zero = advance(row, 0 * x, P)
        both = advance(row._replace(z=2 * row.z), 3 * x, P)
        for i in (0, 2):
            alone = advance(row._replace(z=0 * row.z), x, P)[i]
            np.testing.assert_allclose(both[i], 2 * from_zero[i] + 3 * alone, rtol=1e-9, atol=1e-12)
        squares = (first[2] ** 2).sum(axis=(0, 1))
        np.testing.assert_allclose(squares, np.nan_to_num(nis[k]), rtol=1e-12, atol=1e-13)
        x, P, _ = first


def test_a_row_that_is_refused_counts_as_missing():
    """In one of three columns, with correlated noises: the run is that of measurements without it."""
    model = mixed()
    z = mpt.simulate(model, 25, np.random.default_rng(7), 3)[1]
    z[4, 0, 2] = np.nan
    far = z.copy()
    far[10, :, 1] += 1000
    gone = z.copy()
    gone[10, :, 1] = np.nan
    kf = mpt.KalmanFilter(model)
    run = list(
        engine.in_sequence(*engine.on_own_columns(kf, far), takes=lambda row, e: np.square(e).sum(axis=(0, 1)) < 1e4)
    )
    e = kf.estimates(gone)
    np.testing.assert_allclose([x[: model.n, 0] for x, _, _ in run], e.x, **SAME)
    np.testing.assert_allclose([P[: model.n, : model.n] for _, P, _ in run], e.P, **SAME)
    assert np.square(run[10][2][..., 1]).sum() > 1e4  # the innovations are those of the row that was refused


def test_a_motion_of_no_lengths_has_no_matrices():
    """As of columns that all begin later: an array of size zero does not tell its shape."""
    F, Q = forgetful().over(np.ones(0))
    assert F.shape == Q.shape == (0, 2, 2)


@pytest.mark.parametrize("model", [mpt.constant_velocity(0.7, 0.04, 2.0), mpt.stack(forgetful(), forgetful())])
def test_the_motion_of_a_model_makes_it_again(model):
    again = mpt.LinearModel(motion=model.motion, H=model.H, R=model.R, x0=model.x0, P0=model.P0)
    assert again == model


@dataclass(frozen=True)
class Powerful(Motion):
    """A motion of a user's own with a field that happens to be called `powers`."""

    dt: float
    powers: float

    def over(self, length):
        return mpt.constant_velocity(self.dt, self.powers, 1.0).over(length)


def test_powers_of_ones_own_are_no_powers_of_the_length():
    model = mpt.LinearModel(motion=Powerful(0.5, 3.0), H=[[1, 0]], R=[[1]])
    assert model.powers is None
    assert replace(model, x0=[1, 2]).motion == Powerful(0.5, 3.0)
    assert mpt.stack(model, model).powers is None
    np.testing.assert_array_equal(model.Q, mpt.constant_velocity(0.5, 3.0, 1.0).Q)


@dataclass(frozen=True)
class Textbook(Motion):
    """The velocity that is forgotten within tau, by a closed form that subtracts large numbers."""

    dt: float
    tau: float = 20.0

    def over(self, length):
        T = np.asarray(length) * self.dt
        a = np.exp(-T / self.tau)
        Q_ss = self.tau**2 * (T - 2 * self.tau * (1 - a) + self.tau / 2 * (1 - a**2))
        Q_sv = self.tau**2 / 2 * (1 - 2 * a + a**2)
        return matrices([[1, self.tau * (1 - a)], [0, a]]), matrices([[Q_ss, Q_sv], [Q_sv, self.tau / 2 * (1 - a**2)]])


def test_a_motion_that_loses_its_digits_over_short_steps_is_warned_of():
    """Over a second it is right to ten digits, and over a tenth of a millisecond its Q is rounding."""
    model = mpt.LinearModel(motion=Textbook(1.0), H=[[1, 0]], R=[[1e-6]], P0=np.eye(2))
    z = np.zeros((5, 1))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mpt.KalmanFilter(model, t=[0.0, 1.0, 2.5, 9.0, 100.0]).filter(z)
    with pytest.warns(UserWarning, match=r"t: over 0.0001 s the motion's F and Q are not those of two half steps, by"):
        mpt.KalmanFilter(model, t=[0.0, 1.0, 1.0001, 2.0, 3.0]).filter(z)


def test_a_motion_has_a_dt_and_powers_of_its_own():
    with pytest.raises(TypeError, match=r"dt: needs to be left out beside a motion, which has its own, got 2\.0"):
        mpt.LinearModel(motion=Forgetful(dt=1.0, tau=TAU, q=0.04), H=[[1, 0]], R=[[0.5]], dt=2.0)
    with pytest.raises(TypeError, match="powers: needs to be left out"):
        mpt.LinearModel(motion=Forgetful(dt=1.0, tau=TAU, q=0.04), H=[[1, 0]], R=[[0.5]], powers=[1, 0])
