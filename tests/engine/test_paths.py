"""Every way through the engine is one plain loop, over random cases; and bands and predictions are loops of their own.

A case is drawn from all that an epoch can be: steps of any length, variances, correlated noises, rows that are partly
missing, all of it shared by the tracks or each track's own. The loops (`oracles`) share no code with the package.
"""

from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cache
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from motions import TAU, Forgetful
from oracles import plain_band, plain_loop, plain_smoother, van_loan
from scipy.linalg import block_diag

import mpt_helpers as mpt
from mpt_helpers import RecursiveFilter, metrics
from mpt_helpers._engine import pieces as partition
from mpt_helpers._engine import run as engine
from mpt_helpers._engine import shared as steps
from mpt_helpers.bands import LiveBand, ahead, following
from mpt_helpers.equations import corrected_covariance, gain, masked

DT, Q = 0.7, 0.3  # of all axes
SHARING = ["none", "shared", "own"]
# A hundred products of numbers of order 10, in both. The smoother divides by predicted covariances.
SAME = {"rtol": 1e-8, "atol": 1e-9}
SMOOTHED = {"rtol": 1e-6, "atol": 1e-7}


def axis(kind):
    """A model of one axis."""
    if kind == "forgetful":
        return mpt.LinearModel(transition=Forgetful(TAU, Q), dt=DT, H=[[1, 0]], R=[[1.0]])
    return {"cv": mpt.constant_velocity, "ca": mpt.constant_acceleration}[kind](DT, Q, 1.0)


@cache
def over(kinds, T):
    """F and Q of such axes over T seconds, by van Loan's exponential."""
    made = []
    for kind in kinds:
        n = 3 if kind == "ca" else 2
        A = np.diag(np.ones(n - 1), 1)
        if kind == "forgetful":
            A[1, 1] = -1 / TAU
        made.append(van_loan(A, [0.0] * (n - 1) + [Q], T))
    return tuple(block_diag(*each) for each in zip(*made, strict=True))


@dataclass(frozen=True, repr=False)
class Case:
    """A model with measurements z (N, m, M), and the conditions of their epochs, as a KalmanFilter takes them."""

    model: mpt.LinearModel
    kinds: tuple
    z: np.ndarray
    t: np.ndarray | None
    r: np.ndarray | None

    @property
    def kf(self):
        return mpt.KalmanFilter(self.model, t=self.t, r=self.r)

    def times(self, i):
        """The times of track i, on a grid where there are none."""
        N = len(self.z)
        return DT * np.arange(N) if self.t is None else self.t.reshape(N, -1)[:, i if self.t.ndim == 2 else 0]

    def lengths(self, i):
        """The steps before each epoch of track i, in seconds."""
        return [DT, *np.diff(self.times(i)).tolist()] if self.t is not None else [DT] * len(self.z)

    def steps(self, i):
        """F and Q of each step of track i."""
        return [over(self.kinds, T) if self.kinds else (self.model.F, self.model.Q) for T in self.lengths(i)]

    def variances(self, i):
        """The r of track i, (N, m), or None."""
        return None if self.r is None else self.r if self.r.ndim == 2 else self.r[..., i]

    def noises(self, i):
        """R of each epoch of track i: of a measurement that needs no variance and has none, the model's."""
        r, own = self.variances(i), np.diag(self.model.R)
        return [self.model.R] * len(self.z) if r is None else [np.diag(np.where(row > 0, row, own)) for row in r]

    def loop(self, i, **alpha):
        """The plain loop over track i."""
        model = self.model
        return plain_loop(self.steps(i), model.H, self.noises(i), model.x0, model.P0, self.z[..., i], **alpha)


def spd(rng, n):
    root = rng.standard_normal((n, n))
    return root @ root.T + 0.3 * np.eye(n)


@st.composite
def cases(draw, timed=None, least_rows=1, most_rows=36, variances=SHARING):
    """A Case: with steps of any length where `timed`, of one length where it is False."""
    any_length = draw(st.booleans(), "any length") if timed is None else timed
    N = draw(st.integers(least_rows, most_rows), "N")
    M = draw(st.integers(1, 4), "M")
    times = draw(st.sampled_from(SHARING), "times") if any_length else "none"
    precisions = draw(st.sampled_from(["none", *variances]), "variances")  # without them R may be correlated
    gaps = draw(st.sampled_from(["own", "shared", "all but one", "none"]), "gaps")
    partly = draw(st.sampled_from([True, True, False]), "rows that are partly missing")
    correlated = draw(st.booleans(), "correlated noises")
    known_start = draw(st.booleans(), "P0 = 0")
    kinds = tuple(draw(st.lists(st.sampled_from(["cv", "ca", "forgetful"]), min_size=1, max_size=2), "axes"))
    m = draw(st.sampled_from([2, 3, 1]), "m")
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1), "seed"))
    if any_length:
        model = mpt.stack(*map(axis, kinds))
    else:
        n = draw(st.integers(1, 4), "n")
        F = rng.standard_normal((n, n))
        model = mpt.LinearModel(F=F / np.abs(np.linalg.eigvals(F)).max(), H=np.eye(n), Q=spd(rng, n), R=np.eye(n))
        kinds = ()
    n, R = model.n, spd(rng, m)
    model = replace(
        model,
        H=rng.standard_normal((m, n)),
        R=R if correlated else np.diag(np.diag(R)),
        x0=rng.standard_normal(n),
        P0=np.zeros((n, n)) if known_start else spd(rng, n),
    )
    missing = rng.random((N, 1, M)) < 0.2
    missing = missing | (rng.random((N, m, M)) < 0.25) if partly else np.broadcast_to(missing, (N, m, M)).copy()
    if gaps == "none":
        missing[:] = False
    elif gaps == "shared":
        missing = np.broadcast_to(missing[..., :1], missing.shape)
    elif gaps == "all but one":
        missing[..., 0] = False
    z = np.where(missing, np.nan, 3 * rng.standard_normal((N, m, M)))
    lengths = rng.choice([0.0, 0.1, DT, 2.5], (N, M))
    lengths[:2] = DT  # times that are all alike are refused
    r = rng.uniform(0.2, 4.0, (N, m, M))
    # Of what is missing the variance may be anything.
    r = np.where(missing & (rng.random((N, m, M)) < 0.5), rng.choice([np.nan, -1.0, 0.0]), r)
    r_of_all = np.where(missing.all(axis=2), np.nan, np.abs(np.nan_to_num(r[..., 0])) + 0.2)
    t = np.cumsum(lengths, axis=0)
    return Case(
        model,
        kinds,
        z,
        {"none": None, "shared": t[:, 0], "own": t}[times],
        {"none": None, "shared": r_of_all, "own": r}[precisions],
    )


def agree(x, P, loops, near=SAME):
    """Assert that states (N, n, M) and covariances (N, n, n, M or 1) are those of the loops of M tracks."""
    for i, loop in enumerate(loops):
        np.testing.assert_allclose(x[..., i], loop.x, **near)
        np.testing.assert_allclose(P[..., i if P.shape[-1] > 1 else 0], loop.P, **near)


def all_that_a_filter_says_is(loops, kf, z):
    """Assert that all functions of many tracks give what the loops give."""
    both, new = kf.estimates(z), metrics.innovations(kf, z)
    agree(both.x, both.P, loops)
    agree(kf.filter(z), kf.covariances(z), loops)
    nis, log_likelihood = metrics.nis(kf, z), metrics.log_likelihood(kf, z)
    for i, loop in enumerate(loops):
        np.testing.assert_allclose(new.values[..., i], loop.innovations, **SAME)
        np.testing.assert_allclose(new.S[..., i], loop.S, **SAME)
        np.testing.assert_allclose(nis[:, i], loop.nis, **SAME)
        np.testing.assert_allclose(log_likelihood[i], loop.log_density, **SAME)


def smoothed(case, loops):
    """The plain smoother after each loop."""
    both = [plain_smoother(case.steps(i), loop.x, loop.P) for i, loop in enumerate(loops)]
    return [SimpleNamespace(x=x, P=P) for x, P in both]


@settings(max_examples=25)
@given(cases(), st.integers(2, 40), st.integers(1, 3))
def test_the_paths_of_the_kalman_filter_are_one_plain_loop(case, rows, width):
    """As it runs, in pieces, in tiles, and each track alone; the smoother too."""
    M = case.z.shape[2]
    loops = [case.loop(i) for i in range(M)]
    backwards = smoothed(case, loops)
    ways = {
        "as it runs": [],
        "in pieces": [patch.object(partition, "rows_per_piece", lambda N, tracks: min(N, rows))],
        "in tiles": [
            patch.object(steps, "TILE", width),
            patch.object(engine, "TILE", width),
            patch.object(engine, "TILE_OF_COVARIANCES", width),
            patch.object(engine, "MOST_NUMBERS", width * len(case.z) * case.model.n**2),
            patch.object(steps, "IN_CACHE", 100),
        ],
    }
    for way in ways.values():
        with ExitStack() as stack:
            for change in way:
                stack.enter_context(change)
            all_that_a_filter_says_is(loops, case.kf, case.z)
            agree(*case.kf.smooth(case.z), backwards, near=SMOOTHED)
    for i in range(M):
        t = case.t if case.t is None else case.times(i)
        alone, z = mpt.KalmanFilter(case.model, t=t, r=case.variances(i)), case.z[..., i]
        both = alone.estimates(z)
        agree(both.x[..., None], both.P[..., None], [loops[i]])
        np.testing.assert_allclose(alone.filter(z), loops[i].x, **SAME)
        np.testing.assert_allclose(metrics.log_likelihood(alone, z), loops[i].log_density, **SAME)


@given(cases())
def test_one_step_after_the_other_is_the_plain_loop(case):
    kf = case.kf
    for i in range(case.z.shape[2]):
        x, P, loop, r = case.model.x0, case.model.P0, case.loop(i), case.variances(i)
        for k, (z_k, T) in enumerate(zip(case.z[..., i], case.lengths(i), strict=True)):
            given = {} if case.t is None else {"dt": T}
            x, P = kf.step(x, P, z_k, **given, r=None if r is None else r[k])
            np.testing.assert_allclose(x, loop.x[k], **SAME)
            np.testing.assert_allclose(P, loop.P[k], **SAME)


@settings(max_examples=8)
@given(cases(timed=False, variances=["none"]), st.integers(2, 40), st.integers(0, 3))
def test_lainiotis_joint_filters_and_predictions_are_the_plain_loop(case, rows, steps_ahead):
    """A prediction of a prediction is the plain loop's state, moved on; its covariance with it."""
    loops, model = [case.loop(i) for i in range(case.z.shape[2])], case.model
    kf, lf = mpt.KalmanFilter(model), mpt.LainiotisFilter(model)
    later = []
    for loop in loops:
        x, P = loop.x, loop.P
        for _ in range(steps_ahead + 2):
            x, P = x @ model.F.T, model.F @ P @ model.F.T + model.Q
        later.append(SimpleNamespace(x=x, P=P))
    backwards = smoothed(case, loops)
    inner = [mpt.Predictor(each, steps_ahead) for each in (kf, lf)]
    predictions = [
        mpt.Predictor(inner[0], 2),
        mpt.Predictor(mpt.JoinFilter(*inner), 2),
        mpt.JoinFilter(*(mpt.Predictor(each, 2) for each in inner)),
        mpt.Predictor(mpt.Separate(inner[1]), 2),
    ]
    for K in (len(case.z), min(len(case.z), rows)):
        with patch.object(partition, "rows_per_piece", lambda N, tracks, K=K: K):
            for each in (lf, mpt.JoinFilter(kf, lf), mpt.Separate(lf)):
                all_that_a_filter_says_is(loops, each, case.z)
                agree(*each.smooth(case.z), backwards, near=SMOOTHED)
            for each in predictions:
                assert each.steps_ahead == steps_ahead + 2
                both = each.estimates(case.z)
                agree(both.x, both.P, later)
                agree(each.filter(case.z), each.covariances(case.z), later)
    if steps_ahead:
        with pytest.raises(ValueError, match=f"second: needs one {steps_ahead + 2} steps ahead"):
            mpt.JoinFilter(predictions[0], mpt.Predictor(kf, 2))


@dataclass(frozen=True, eq=False)
class FadingFilter(RecursiveFilter):
    """A filter of one's own, with one method: the covariance is predicted alpha² times as large."""

    alpha: float

    @property
    def optimal(self):
        return self.alpha == 1

    def next_step(self, P, seen):
        F, Q = self.model.F, self.model.Q
        H, R = masked(self.model.H, self.model.R, seen)
        P = self.alpha**2 * F @ P @ F.T + Q
        K = gain(P, H, R)
        return (np.eye(len(F)) - K @ H) @ F, K, corrected_covariance(P, K, H, R)


@dataclass(frozen=True, eq=False)
class OfConstantGain(RecursiveFilter):
    """A filter of one's own that keeps the gain of the steady state, which P0 is."""

    def next_step(self, P, seen):
        K = self.gain * seen.all()
        F, Q, H, R = self.model.F, self.model.Q, self.model.H, self.model.R
        return (np.eye(len(F)) - K @ H) @ F, K, corrected_covariance(F @ P @ F.T + Q, K, H, R)

    @property
    def gain(self):
        return mpt.SteadyStateFilter.from_kalman(self.model).B


@settings(max_examples=12)
@given(cases(timed=False, variances=["none"]), st.integers(2, 40), st.sampled_from([1.0, 1.02, 1.3]))
def test_a_filter_of_ones_own_is_one_method(case, rows, alpha):
    """Against a plain loop: gaps of any kind, single steps, pieces; a smoother only where P is that of the error."""
    M, model = case.z.shape[2], case.model
    loops = [case.loop(i, alpha=alpha) for i in range(M)]
    fading = FadingFilter(model, alpha)
    with patch.object(partition, "rows_per_piece", lambda N, tracks: N):
        both = fading.estimates(case.z)
        agree(both.x, both.P, loops)
        agree(fading.filter(case.z), fading.covariances(case.z), loops)
    for i in range(M):
        x, P = model.x0, model.P0
        for k, z_k in enumerate(case.z[..., i]):
            x, P = fading.step(x, P, z_k)
            np.testing.assert_allclose(x, loops[i].x[k], **SAME)
            np.testing.assert_allclose(P, loops[i].P[k], **SAME)
    if alpha > 1:
        with pytest.raises(TypeError, match="smooth: needs a filter of optimal gain, got a FadingFilter"):
            fading.smooth(case.z)
        with pytest.raises(ValueError, match="estimator: needs a filter whose P follows from its gain and the model's"):
            metrics.log_likelihood(fading, case.z)  # S would be that of the model, not of this filter
    with patch.object(partition, "rows_per_piece", lambda N, tracks: min(N, rows)):
        both = fading.estimates(case.z)
        agree(both.x, both.P, loops, near={"rtol": 1e-5, "atol": 1e-5})  # pieces fit together to 1e-6 sigma
        if alpha == 1:  # it is the Kalman filter, and has all that one has
            all_that_a_filter_says_is(loops, fading, case.z)
            agree(*fading.smooth(case.z), smoothed(case, loops), near=SMOOTHED)


class FourTimesP:
    """A step of one's own, to be put before that of a filter."""

    def next_step(self, P, seen):
        return super().next_step(4 * P, seen)


@pytest.mark.parametrize("filter_of", [mpt.KalmanFilter, mpt.LainiotisFilter])
def test_a_step_of_ones_own_may_come_from_a_second_parent(filter_of):
    """The faster ways are those of the filter's step, not of this one."""

    class Bold(FourTimesP, filter_of):
        pass

    bold = Bold(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1, P0=np.eye(2)))
    z, x, P = np.array([[1.0], [np.nan], [3.0]]), np.zeros(2), bold.P0
    for x_k, z_k in zip(bold.filter(z), z, strict=True):
        x, P = bold.step(x, P, z_k)
        np.testing.assert_allclose(x_k, x, **SAME)
    assert not bold.optimal


def test_a_filter_of_ones_own_is_smoothed_only_if_it_says_that_it_may():
    """From P0, the steady P, its gain is the Kalman gain; after a gap it is not, which no first step shows.

    Its P is that of its gain all the same, and so its innovations are those of the shipped filter.
    """
    axis = mpt.constant_velocity(dt=1.0, q=0.01, r=0.1)
    steady = mpt.SteadyStateFilter.from_kalman(axis)
    own, z = OfConstantGain(replace(axis, P0=steady.P)), np.array([[1.0], [np.nan], [3.0]])
    np.testing.assert_allclose(metrics.nis(own, z), metrics.nis(steady, z), **SAME)
    with pytest.raises(TypeError, match="smooth: needs a filter of optimal gain, got a OfConstantGain"):
        own.smooth(z)


@given(cases(timed=True), cases(timed=True), st.integers(0, 3))
def test_separate_filters_with_conditions_are_plain_loops(first, second, steps_ahead):
    """Each of its own times and variances, of as many rows and tracks; predictions of them by steps of one dt."""
    N, M = min(len(first.z), len(second.z)), min(first.z.shape[2], second.z.shape[2])
    cut = [
        Case(
            each.model,
            each.kinds,
            each.z[:N, :, :M],
            None if each.t is None else each.t[:N] if each.t.ndim == 1 else each.t[:N, :M],
            None if each.r is None else each.r[:N] if each.r.ndim == 2 else each.r[:N, :, :M],
        )
        for each in (first, second)
    ]
    z = np.concatenate([each.z for each in cut], axis=1)
    both = mpt.Separate(*(each.kf for each in cut))
    loops = [[each.loop(i) for i in range(M)] for each in cut]
    x, P = both.estimates(z)
    later_x, later_P = mpt.Predictor(both, steps_ahead).estimates(z)
    new = metrics.innovations(both, z)
    n, m = cut[0].model.n, cut[0].model.m
    halves = (slice(None, n), slice(None, m)), (slice(n, None), slice(m, None))
    for each, of_each, (states, measured) in zip(cut, loops, halves, strict=True):
        agree(x[:, states], P[:, states, states], of_each)
        for i, loop in enumerate(of_each):
            np.testing.assert_allclose(new.values[:, measured, i], loop.innovations, **SAME)
            np.testing.assert_allclose(new.S[:, measured, measured, i], loop.S, **SAME)
            F, noise = over(each.kinds, DT)
            x_i, P_i = loop.x, loop.P
            for _ in range(steps_ahead):
                x_i, P_i = x_i @ F.T, F @ P_i @ F.T + noise
            np.testing.assert_allclose(later_x[:, states, i], x_i, **SAME)
            np.testing.assert_allclose(later_P[:, states, states, i], P_i, **SAME)
    assert not P[:, :n, n:].any()
    assert not new.S[:, :m, m:].any()
    sums = [loops[0][i].log_density + loops[1][i].log_density for i in range(M)]
    np.testing.assert_allclose(metrics.log_likelihood(both, z), sums, **SAME)


@settings(max_examples=10)
@given(cases(timed=True, least_rows=25, most_rows=45), st.sampled_from([DT, 1.5, 4.0]), st.sampled_from([0.95, 0.7]))
def test_a_band_and_the_live_band_are_the_plain_loop(case, seconds, level):
    """Of tracks of their own times and variances; from where the bands of these tracks have ended, on average."""
    model, M = case.model, case.z.shape[2]
    # A mobile that rests, on some axes or on all, and what it is not: a row that repeats only a part of another.
    z = case.z.round(0)
    z[5:9], z[10:12, :1] = z[5], z[9, :1]
    r = None if case.r is None else np.where(case.r > 0, case.r, 2.0)
    if r is not None:
        r[::4] = np.where(np.isnan(z[::4]).all(axis=2) if r.ndim == 2 else np.isnan(z[::4]), np.nan, r[::4])
    case = replace(case, z=z, r=r)
    kf = case.kf
    x, P = kf.estimates(z)
    normal = np.full(model.m, np.log({0.95: 1.959963984540054, 0.7: 1.0364333894937898}[level]))

    def of_loops(log_f):
        found = []
        for i in range(M):
            t = case.times(i)
            start = t[0] - DT, model.x0, model.P0
            given = model.H, model.R, case.noises(i), start, t, z[..., i], x[..., i], P[..., i]
            found.append(plain_band(lambda T: over(case.kinds, float(T)), *given, seconds, level, log_f))
        return found

    loops = of_loops(normal)
    if not any(checked for checked, _, _ in loops):
        with pytest.raises(ValueError, match="seconds: needs a horizon"):
            ahead(kf, z, seconds)
        return
    a = ahead(kf, z, seconds)
    ends = np.mean([log_f for checked, _, log_f in loops if checked], axis=0)
    for before, each in ((None, loops), (a, of_loops(ends))):
        band = following(a, before=before, level=level)
        for i, (checked, at_rows, log_f) in enumerate(each):
            of_it = a.track == i
            for name in ("row", "due_row", "fixes", "rests"):
                np.testing.assert_array_equal(getattr(a, name)[of_it], [getattr(fix, name) for fix in checked])
            for ours, name in ((a.errors, "errors"), (a.sigma, "sigma"), (a.recent, "c"), (band, "half_width")):
                expected = np.reshape([getattr(fix, name) for fix in checked], ours[of_it].shape)
                np.testing.assert_allclose(ours[of_it], expected, **SAME)
            r = case.variances(i)
            live = LiveBand(kf, seconds, before=before, level=level)
            for k, (t_k, at_row) in enumerate(zip(case.times(i), at_rows, strict=True)):
                expected = live.step(t_k, z[k, :, i], x[k, :, i], P[k, :, :, i], None if r is None else r[k])
                np.testing.assert_allclose(expected.position, at_row.position, **SAME)
                np.testing.assert_allclose(expected.half_width, at_row.half_width, **SAME)
            np.testing.assert_allclose(live.factor, np.exp(log_f), **SAME)
    assert a.left_out == np.isfinite(z).any(axis=1).sum() - len(a.made)


def test_pieces_with_a_variance_below_zero_are_not_taken():
    """They fit together as far as doubles tell: then the track runs uncut, which may do without."""
    model = mpt.LinearModel(F=np.eye(2), H=[[1, 0]], Q=np.diag([0.1, 0]), R=[[1]], P0=np.diag([1.0, 0]))
    kf = mpt.KalmanFilter(model)
    z = np.random.default_rng(0).standard_normal((60, 1, 1))
    z[7] = np.nan
    rows, x0, P0 = kf.epochs_of(z).rows(), np.zeros((2, 1, 1)), model.P0[..., None]

    def rounding(row, x, P):
        x, P, e = kf.advance(row, x, P)
        if P.shape[2] > 1:
            P[1, 1] -= 1e-20
        return x, P, e

    x, P = np.empty((60, 2, 1, 1)), np.empty((60, 2, 2, 1))
    with patch.object(partition, "rows_per_piece", lambda N, tracks: 20):
        assert partition.run_rows(rounding, rows, x0, P0, x, P) is not None
    assert not P[:, 1].any()
    np.testing.assert_allclose(x[..., 0, 0], kf.filter(z[..., 0]), **SAME)
