"""The papers' claims as theorems, and every filter against oracles that share no code with it."""

import pickle
import time
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from conftest import AXIS, dense_model
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import gaussian_conditioning, matrices, textbook_kalman

import mpt_helpers as mpt
from mpt_helpers._base import Estimates
from mpt_helpers._engine import shared as steps
from mpt_helpers._engine.columns import KalmanColumns
from mpt_helpers.equations import unit_measurements

# Estimates here are of order 100 and variances start at 100: sixty steps of rounding stay below 1e-12 of that.
SAME = {"rtol": 1e-10, "atol": 1e-10}
FILTERS = [mpt.KalmanFilter, mpt.LainiotisFilter]
SOLVED = [mpt.SteadyStateFilter.from_kalman, mpt.SteadyStateFilter.from_lainiotis]


def joint(model):
    return mpt.JoinFilter(mpt.KalmanFilter(model), mpt.LainiotisFilter(model))


def missing(z, *rows):
    z = z.copy()
    z[list(rows)] = np.nan
    return z


@pytest.mark.parametrize("oracle", [textbook_kalman, gaussian_conditioning])
@pytest.mark.parametrize("make", FILTERS)
def test_filter_equals_oracle(make, oracle, model, z):
    x, P = oracle(*matrices(model), z[:12])
    np.testing.assert_allclose(make(model).filter(z[:12]), x, **SAME)
    np.testing.assert_allclose(make(model).covariances(12), P, **SAME)


@pytest.mark.parametrize("oracle", [textbook_kalman, gaussian_conditioning])
@pytest.mark.parametrize("make", FILTERS)
def test_missed_epoch_is_predicted_only(make, oracle, model, z):
    z = missing(z[:12], 0, 4, 5, 11)
    np.testing.assert_allclose(make(model).filter(z), oracle(*matrices(model), z)[0], **SAME)


@pytest.mark.parametrize("seed", range(5))
def test_correlated_noises_and_dense_matrices(seed):
    model = dense_model(seed)
    _, z = mpt.simulate(model, 10, np.random.default_rng(seed))
    z = missing(z, 0, 6)
    expected = gaussian_conditioning(*matrices(model), z)[0]
    filters = mpt.six_filters(model)
    scale = np.abs(expected).max()  # unstable models grow by some powers of ten in ten steps
    for name in ("KF", "LF", "JKLF"):
        np.testing.assert_allclose(filters[name].filter(z), expected, rtol=1e-8, atol=1e-8 * scale)
    kalman, lainiotis = filters["SSKF"], filters["SSLF"]
    limit = mpt.KalmanFilter(model).coefficients(300)
    for name in "ABP":
        np.testing.assert_allclose(getattr(kalman, name), getattr(limit, name)[-1], **SAME)
        np.testing.assert_allclose(getattr(lainiotis, name), getattr(limit, name)[-1], **SAME)


def test_covariances_of_the_lainiotis_filter_are_symmetric(model):
    P = mpt.LainiotisFilter(model).covariances(50)
    np.testing.assert_array_equal(P, P.transpose(0, 2, 1))


def test_lainiotis_equals_kalman(model, z):
    kf, lf = mpt.KalmanFilter(model), mpt.LainiotisFilter(model)
    np.testing.assert_allclose(lf.filter(z), kf.filter(z), **SAME)
    for ours, theirs in zip(lf.coefficients(60), kf.coefficients(60), strict=True):
        np.testing.assert_allclose(ours, theirs, **SAME)


def test_joint_equals_both(model, z):
    kf, lf = mpt.KalmanFilter(model), mpt.LainiotisFilter(model)
    join = mpt.JoinFilter(kf, lf)
    for each in (kf, lf):
        np.testing.assert_allclose(join.filter(z), each.filter(z), **SAME)
        np.testing.assert_allclose(join.covariances(60), each.covariances(60), **SAME)


def test_joint_is_the_mean(model, z):
    kf, steady = mpt.KalmanFilter(model), mpt.SteadyStateFilter.from_kalman(model)
    join = mpt.JoinFilter(kf, steady)
    np.testing.assert_allclose(join.filter(z), (kf.filter(z) + steady.filter(z)) / 2, **SAME)
    np.testing.assert_array_equal(join.covariances(9), (kf.covariances(9) + steady.covariances(9)) / 2)


@pytest.mark.parametrize("make", [*FILTERS, *SOLVED])
def test_separate_axes_equal_stacked_axes(make, axis_and_count, model, z):
    axis, axes = axis_and_count
    separate = mpt.Separate(*[make(axis)] * axes)
    z = missing(z, 3)
    np.testing.assert_allclose(separate.filter(z), make(model).filter(z), **SAME)
    np.testing.assert_allclose(separate.covariances(60), make(model).covariances(60), **SAME)


def test_separate_axes_may_differ():
    axes = [AXIS, replace(AXIS, R=[[3.0]]), replace(AXIS, F=[[1, 0.5], [0, 1]])]
    _, z = mpt.simulate(mpt.stack(*axes), 30, np.random.default_rng(1), tracks=3)
    separate = mpt.Separate(*map(mpt.KalmanFilter, axes))
    np.testing.assert_allclose(separate.filter(z), mpt.KalmanFilter(mpt.stack(*axes)).filter(z), **SAME)


@pytest.mark.parametrize("make", SOLVED)
def test_steady_state_is_the_limit(make, model):
    steady = make(model)
    for limit, each in zip(mpt.KalmanFilter(model).coefficients(200), (steady.A, steady.B, steady.P), strict=True):
        np.testing.assert_allclose(limit[-1], each, **SAME)


@pytest.mark.parametrize("make", SOLVED)
def test_steady_state_filter_is_its_recursion(make, model, z):
    steady, z = make(model), missing(z, 7)
    x = model.x0
    for row, z_k in zip(steady.filter(z), z, strict=True):
        x = model.F @ x if np.isnan(z_k).any() else steady.A @ x + steady.B @ z_k
        np.testing.assert_allclose(row, x, **SAME)


@pytest.mark.parametrize("tol", [1e-1, 1e-3, 1e-6])
def test_fir_converges_to_steady_state(tol, model, z):
    steady = mpt.SteadyStateFilter.from_kalman(model)
    fir = mpt.FIRFilter.from_steady_state(steady, tol=tol)
    x, M = steady.filter(z), fir.order
    before = np.vstack([model.x0, x])[: len(z) - M + 1]  # x(0/0), x(1/1), ...: what the dropped taps stand for
    gap = (x - fir.filter(z))[M - 1 :]
    np.testing.assert_allclose(gap, before @ np.linalg.matrix_power(steady.A, M).T, **SAME)
    assert np.linalg.norm(gap, axis=1).max() <= tol * np.linalg.norm(before, axis=1).max()


def test_fir_order_is_the_first_power_below_tol(model):
    A = mpt.SteadyStateFilter.from_kalman(model).A
    for norm in (2, 1, np.inf, "fro"):
        M = mpt.fir_order(A, 1e-3, norm)
        sizes = [np.linalg.norm(np.linalg.matrix_power(A, j), norm) for j in (M - 1, M)]
        assert sizes[0] >= 1e-3 > sizes[1]


def test_fir_order_of_the_largest_tolerance():
    assert mpt.fir_order([[0.5]], 1) == 1


def test_fir_predicts_from_x0_where_the_first_epoch_is_missed():
    model = replace(AXIS, x0=[3.0, -1.0])
    fir = mpt.FIRFilter.from_steady_state(mpt.SteadyStateFilter.from_kalman(model))
    np.testing.assert_array_equal(fir.filter([[np.nan], [1.0]])[0], model.F @ model.x0)
    with pytest.raises(ValueError, match="read-only"):
        fir.taps[0, 0, 0] = 1


def test_fir_order_of_the_paper():
    assert mpt.FIRFilter.from_steady_state(mpt.SteadyStateFilter.from_kalman(AXIS)).order == 17


def test_fir_taps_are_the_impulse_response():
    steady = mpt.SteadyStateFilter.from_lainiotis(replace(AXIS, x0=[0, 0]))
    fir = mpt.FIRFilter.from_steady_state(steady, tol=1e-2)
    impulse = np.zeros((30, 1))
    impulse[0] = 1
    np.testing.assert_allclose(fir.taps[..., 0], steady.filter(impulse)[: fir.order], **SAME)
    np.testing.assert_array_equal(fir.filter(impulse)[fir.order :], 0)


def test_fir_treats_missed_epochs_like_the_steady_state_filter(model, z):
    model, z = replace(model, x0=np.zeros(model.n)), missing(z, 0, 9, 10, 30, 59)
    steady = mpt.SteadyStateFilter.from_kalman(model)
    fir = mpt.FIRFilter.from_steady_state(steady, tol=1e-15)
    np.testing.assert_allclose(fir.filter(z), steady.filter(z), **SAME)
    short = mpt.FIRFilter.from_steady_state(steady, tol=1e-1).filter(z)
    np.testing.assert_array_equal(short[10], model.F @ short[9])


def test_kalman_gains_are_those_of_filterpy(model, monkeypatch):
    import filterpy.kalman

    gains = []

    class Spy(filterpy.kalman.KalmanFilter):
        def update(self, z, **options):
            super().update(z, **options)
            gains.append((self.K.copy(), self.P.copy()))

    monkeypatch.setattr(filterpy.kalman, "KalmanFilter", Spy)
    _, B, P = mpt.KalmanFilter(model).coefficients(10)
    _, W = unit_measurements(model.H, model.R)  # filterpy gets measurements of unit noise
    np.testing.assert_array_equal(B, [K @ W for K, _ in gains[:10]])
    np.testing.assert_array_equal(P, [P for _, P in gains[:10]])


@pytest.mark.parametrize("make", FILTERS)
def test_coefficients_that_repeat_are_copied_to_the_last_bit(make, model):
    """Where P no longer moves by its rounding, a step made anew differs from the one that is copied by no more."""
    each, P = make(model), model.P0
    coefficients = each.coefficients(80)
    for k in range(80):
        A, B, P = each.next_step(P, np.ones(model.m, bool))
        for ours, row in zip((A, B, P), (part[k] for part in coefficients), strict=True):
            np.testing.assert_allclose(ours, row, rtol=1e-14, atol=1e-16)
    taken = list(steps.steps_without_gaps(each.next_step, each.P0, each.model.m, 1000))
    assert len({id(step) for step in taken}) < 100


@pytest.mark.parametrize("make", FILTERS)
def test_a_missed_epoch_after_the_steady_state_is_seen(make):
    _, z = mpt.simulate(AXIS, 120, np.random.default_rng(2))
    z = missing(z, 80, 81, 90)
    x, _ = textbook_kalman(*matrices(AXIS), z)
    np.testing.assert_allclose(make(AXIS).filter(z), x, **SAME)


def test_nothing_that_is_passed_in_is_changed(model, z):
    z = missing(z, 2)
    before = z.copy()
    z.flags.writeable = False
    for each in [*mpt.six_filters(model).values(), mpt.FIRFilter.from_steady_state(mpt.six_filters(model)["SSKF"])]:
        each.filter(z)
    np.testing.assert_array_equal(z, before)
    with pytest.raises(ValueError, match="read-only"):
        model.F[0, 0] = 2


@pytest.mark.parametrize("late", [7, 8, 39])
@pytest.mark.parametrize("make", [*FILTERS, *SOLVED, joint])
def test_tracks_that_differ_in_one_missed_epoch_are_told_apart(make, late):
    _, z = mpt.simulate(AXIS, 40, np.random.default_rng(1), tracks=3)
    z[late, :, 1] = np.nan
    many = make(AXIS).filter(z)
    for i in range(3):
        np.testing.assert_allclose(many[..., i], make(AXIS).filter(z[..., i]), **SAME)


@pytest.mark.parametrize(
    "make", [*SOLVED, lambda model: mpt.FIRFilter.from_steady_state(mpt.SteadyStateFilter.from_kalman(model))]
)
def test_a_constant_gain_refuses_a_row_that_is_partly_missing(make):
    z = np.zeros((40, 2, 3))
    z[21, 1, 2] = np.nan
    with pytest.raises(ValueError, match=r"z: needs rows all of numbers or all of NaN, .* a row that is partly NaN"):
        make(mpt.stack(AXIS, AXIS)).filter(z)


@pytest.mark.parametrize("gaps", [(), (5,), (0, 20, 21, 39)])
@pytest.mark.parametrize("own", [False, True], ids=["alike", "one track of its own"])
def test_tracks_of_common_gaps_are_filtered_in_common(monkeypatch, gaps, own):
    """Epoch by epoch, with a covariance each, go only tracks whose gaps differ, and no track without gaps."""
    _, z = mpt.simulate(AXIS, 40, np.random.default_rng(1), tracks=100)
    z[list(gaps), :, 50:] = np.nan
    if own:
        z[33, :, 57] = np.nan
    in_a_column, advance = set(), KalmanColumns.advance
    spy = lambda self, row, x, P: in_a_column.add(x.shape[1]) or advance(self, row, x, P)  # noqa: E731
    monkeypatch.setattr(KalmanColumns, "advance", spy)
    x = mpt.KalmanFilter(AXIS).filter(z)
    # Where a long track is cut into pieces, the answers to the start of a piece run beside its tracks.
    assert in_a_column <= ({1, 1 + AXIS.n} if own else {50, 50 + AXIS.n} if gaps else set())
    for i in (0, 57, 99):
        np.testing.assert_allclose(x[..., i], mpt.KalmanFilter(AXIS).filter(z[..., i]), **SAME)


@pytest.mark.parametrize(("make", "most"), [*((make, 1.05) for make in [*FILTERS, *SOLVED]), (joint, 2.05)])
def test_no_memory_is_taken_beside_the_estimates(make, most):
    """The joint filter holds the estimates of both."""
    z = np.random.default_rng(0).standard_normal((500, 1, 2000))
    each = make(AXIS)
    tracemalloc.start()
    x = each.filter(z)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < most * x.nbytes


@pytest.mark.parametrize("steps", [1, 31, 32, 33, 65])
@pytest.mark.parametrize("tracks", [1, 800, 20_000])
def test_any_number_of_steps_and_tracks_is_the_recursion(steps, tracks):
    """Whole blocks of steps and parts of them, one tile of tracks and several."""
    _, z = mpt.simulate(AXIS, steps, np.random.default_rng(1), tracks=tracks)
    A, B, _ = mpt.KalmanFilter(AXIS).coefficients(steps)
    x = np.repeat(AXIS.x0[:, None], tracks, axis=1)
    for k, row in enumerate(mpt.KalmanFilter(AXIS).filter(z)):
        x = A[k] @ x + B[k] @ z[k]
        np.testing.assert_allclose(row, x, **SAME)


def test_a_finite_track_whose_estimate_overflows_is_not_refused():
    stiff = mpt.constant_velocity(dt=1e-3, q=1e6, r=1e-6)  # a place of 1e308 m within a millisecond
    with pytest.warns(RuntimeWarning, match="overflow"):
        x = mpt.KalmanFilter(stiff).filter(np.full((3, 1, 3), 1e308))
    assert np.isinf(x[0, 1]).all()


def test_separate_and_joint_fir_filters_are_the_fir_filter(axis_and_count, model, z):
    axis, axes = axis_and_count
    fir = [mpt.FIRFilter.from_steady_state(mpt.SteadyStateFilter.from_kalman(each), tol=1e-2) for each in (axis, model)]
    z = missing(z, 0, 9, 10, 30)
    np.testing.assert_allclose(mpt.Separate(*[fir[0]] * axes).filter(z), fir[1].filter(z), **SAME)
    np.testing.assert_allclose(mpt.JoinFilter(fir[1], fir[1]).filter(z), fir[1].filter(z), **SAME)


def test_filters_of_different_kinds_join(model, z):
    steady = mpt.SteadyStateFilter.from_kalman(model)
    kf, fir, z = mpt.KalmanFilter(model), mpt.FIRFilter.from_steady_state(steady), missing(z, 5, 6)
    joint = mpt.JoinFilter(mpt.JoinFilter(kf, fir), steady).filter(z)
    np.testing.assert_allclose(joint, (kf.filter(z) + fir.filter(z)) / 4 + steady.filter(z) / 2, **SAME)
    apart = mpt.Separate(mpt.JoinFilter(kf, fir), steady).filter(np.concatenate([z, z], axis=1))
    np.testing.assert_allclose(apart, np.hstack([(kf.filter(z) + fir.filter(z)) / 2, steady.filter(z)]), **SAME)


def test_filters_that_ran_can_be_sent_to_another_process(model, z):
    filters = mpt.six_filters(model)
    steady = filters["SSKF"]
    filters |= {"FIR": mpt.FIRFilter.from_steady_state(steady), "ahead": mpt.SteadyStatePredictor(steady, 2)}
    filters["B"] = mpt.Separate(filters["KF"])
    for each in filters.values():
        np.testing.assert_array_equal(pickle.loads(pickle.dumps([each.filter(z), each]))[1].filter(z), each.filter(z))


def test_side_by_side_any_number_of_filters_keeps_its_coefficients():
    kf, steady = mpt.KalmanFilter(AXIS), mpt.SteadyStateFilter.from_kalman(AXIS)
    x = mpt.Separate(kf, *[steady] * 64).filter(np.ones((20, 65)))
    np.testing.assert_allclose(x[:, :2], kf.filter(np.ones((20, 1))), **SAME)
    np.testing.assert_allclose(x[:, 2:4], steady.filter(np.ones((20, 1))), **SAME)


@pytest.mark.parametrize("make", FILTERS)
@pytest.mark.parametrize("tracks", [(), (3,)], ids=["one track", "one of three"])
@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of the covariance that overflows
def test_a_gap_in_which_the_covariance_overflows_is_refused(make, tracks):
    growing = mpt.LinearModel(F=[[16.0]], H=[[1.0]], Q=[[1.0]], R=[[1.0]])
    z = np.ones((200, 1, *tracks))
    z[(slice(150), 0, *[1] * len(tracks))] = np.nan
    for function in (make(growing).filter, make(growing).covariances, make(growing).smooth):
        with pytest.raises(ValueError, match=r"z: needs covariances within double precision .* got an overflow"):
            function(z)


@pytest.mark.skipif(np.longdouble("1e400") == np.inf, reason="a long double that is no longer than a double")
@pytest.mark.parametrize("make", FILTERS)
def test_a_number_beyond_doubles_is_infinite(make):
    with pytest.raises(ValueError, match=r"z: .* got an infinite value"):
        make(AXIS).filter(np.array([[1], [np.longdouble("1e400")], [2]]))


def test_the_order_of_a_slow_fir_filter_is_found_at_once():
    start = time.process_time()
    assert mpt.fir_order([[1 - 1e-5]], 1e-3) == 690_773  # ln 1e-3 / ln(1 - 1e-5)
    assert time.process_time() - start < 1


def test_blocks_that_share_some_steps_have_products_of_their_own(monkeypatch):
    monkeypatch.setattr(steps, "steps_per_product", lambda numbers: 2)
    first, second, third = (steps.Step(A * np.eye(1), np.eye(1), np.eye(1)) for A in (0.5, 0.25, 0.125))
    products = steps.products_for([first, second, first, third, first, third], tracks=1)
    assert [W[1, 0] for W in products] == [0.125, 0.0625, 0.0625]
    assert products[2] is products[1]


def constant_gain(model, rng):
    """A SteadyStateFilter with a gain and a P that no Riccati equation gave."""
    B, root = 0.3 * rng.standard_normal((model.n, model.m)), rng.standard_normal((model.n, model.n))
    return mpt.SteadyStateFilter(model, A=(np.eye(model.n) - B @ model.H) @ model.F, B=B, P=root @ root.T)


def plain_innovations(each, z):
    """The innovations and S of a filter of constant gain on one track, one epoch after the other."""
    model, x, P, values, S = each.model, each.model.x0, each.P, [], []
    keep = np.eye(model.n) - each.B @ model.H
    for z_k in z:
        x, P = model.F @ x, model.F @ P @ model.F.T + model.Q
        values.append(z_k - model.H @ x)
        S.append(model.H @ P @ model.H.T + model.R)
        if not np.isnan(z_k).any():
            x, P = x + each.B @ values[-1], keep @ P @ keep.T + each.B @ model.R @ each.B.T
    return np.array(values), np.array(S)


@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.integers(1, 2))
def test_innovations_of_a_joint_filter_are_the_means_of_those_of_both(seed, n, m):
    """Of filters that differ in their gains and in where their P starts; with missed epochs."""
    rng = np.random.default_rng(seed)
    model = dense_model(rng.integers(1000), n, m)
    model = replace(model, F=model.F / np.abs(np.linalg.eigvals(model.F)).max())
    both = [constant_gain(model, rng) for _ in range(2)]
    join = mpt.JoinFilter(*both)
    z = rng.standard_normal((12, m, 3))
    z[(rng.random((12, 1, 3)) < 0.2).repeat(m, axis=1)] = np.nan
    new = mpt.metrics.innovations(join, z)
    np.testing.assert_allclose(join.P0, (both[0].P + both[1].P) / 2)
    for track in range(3):
        (values_1, S_1), (values_2, S_2) = (plain_innovations(each, z[..., track]) for each in both)
        np.testing.assert_allclose(new.values[..., track], (values_1 + values_2) / 2, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(new.S[..., track], (S_1 + S_2) / 2, rtol=1e-8, atol=1e-8)


@settings(max_examples=6)
@given(st.lists(st.tuples(st.integers(1, 90), st.integers(1, 5)), min_size=2, max_size=5), st.integers(0, 1000))
def test_a_filter_that_is_used_again_keeps_nothing_of_other_tracks(sizes, seed):
    """Shorter or longer ones, more or fewer of them, as a new filter takes them."""
    model = mpt.stack(AXIS, AXIS)
    for make in FILTERS:
        used = make(model)
        for N, M in sizes:
            z = np.random.default_rng(seed).standard_normal((N, 2, M))
            np.testing.assert_array_equal(used.filter(z), make(model).filter(z))
            np.testing.assert_array_equal(used.covariances(z), make(model).covariances(z))


class Smoothed(mpt.KalmanFilter):
    """A filter that smooths to what it is told."""

    def smooth(self, z):
        return vars(self)["told"]


@given(st.integers(0, 2**32 - 1))
def test_a_joint_filter_smooths_to_the_mean_of_both(seed):
    rng = np.random.default_rng(seed)
    told = [Estimates(rng.standard_normal((5, 2)), rng.standard_normal((5, 2, 2))) for _ in range(2)]
    both = [Smoothed(AXIS) for _ in told]
    for each, estimates in zip(both, told, strict=True):
        vars(each)["told"] = estimates
    x, P = mpt.JoinFilter(*both).smooth(np.zeros((5, 1)))
    np.testing.assert_allclose(x, (told[0].x + told[1].x) / 2)
    np.testing.assert_allclose(P, (told[0].P + told[1].P) / 2)


@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_joint_filters_of_separate_ones_have_the_same_times_in_every_part(seed, parts):
    """A part may have times of its own: what differs in one of them, wherever it stands, is refused."""
    rng = np.random.default_rng(seed)
    model = mpt.constant_velocity(1.0, 0.1, 0.5)
    own = np.arange(5.0)

    def separate(*times):
        return mpt.Separate(*(mpt.KalmanFilter(model, t=t) for t in times))

    for same in (None, own):
        first = separate(*[same] * parts)
        mpt.JoinFilter(first, separate(*[same] * parts))
        moved = own + rng.uniform(0.1, 9.0) * (np.arange(5) > rng.integers(1, 4))
        for others in (own if same is None else None, moved):
            times = [same] * parts
            times[rng.integers(parts)] = others
            for pair in ((first, separate(*times)), (separate(*times), first)):
                with pytest.raises(ValueError, match="second: needs a filter of the same times as the first"):
                    mpt.JoinFilter(*pair)


def test_what_is_printed_is_a_line():
    kf, z = mpt.KalmanFilter(AXIS, r=[[1.0], [2.0]]), np.ones((2, 1))
    printed = [
        (kf, "<KalmanFilter: 2 states, 1 measurement, r>"),
        (mpt.Separate(kf, kf), "<Separate: 4 states, 2 measurements>"),
        (kf.estimates(z), "Estimates(x (2, 2), P (2, 2, 2))"),
        (mpt.metrics.innovations(kf, z), "Innovations(values (2, 1), S (2, 1, 1))"),
    ]
    for each, line in printed:
        assert repr(each) == line


@pytest.mark.parametrize("name", ["predict", "update"])
def test_who_asks_for_a_name_of_filterpy_is_told_of_step(name):
    kf = mpt.KalmanFilter(AXIS)
    with pytest.raises(AttributeError, match=f"'KalmanFilter' object has no attribute '{name}'; step"):
        getattr(kf, name)
    with pytest.raises(AttributeError, match=r"no attribute 'gain'$"):
        kf.gain  # noqa: B018


@pytest.mark.parametrize("parent", [mpt.KalmanFilter, mpt.LainiotisFilter])
def test_a_step_of_ones_own_is_taken_with_gaps_too(parent):
    """A subclass of a shipped filter does not go by the faster ways of its parent, which are of the parent's step."""

    class Bolder(parent):
        optimal = False

        def next_step(self, P, seen, *conditions):
            return super().next_step(4 * P, seen, *conditions)

    z = np.array([[np.nan], [1.0], [2.0], [np.nan], [3.2]])
    kf, x, P, found = Bolder(AXIS), AXIS.x0, AXIS.P0, []
    for z_k in z:
        A, B, P = kf.next_step(P, np.isfinite(z_k))
        x = A @ x + B @ np.nan_to_num(z_k)
        found.append(x)
    np.testing.assert_allclose(kf.filter(z), found, rtol=1e-12)
    assert np.abs(kf.filter(z) - parent(AXIS).filter(z)).max() > 1e-3


def test_repeated_times_are_suspicious_of_filters_side_by_side_too():
    kf = mpt.KalmanFilter(mpt.constant_velocity(1.0, 0.01, 0.1, P0=np.eye(2)), t=[1, 2, 2, 3])
    for estimator, columns in ((kf, 1), (mpt.Separate(kf, kf), 2)):
        assert "same time" in mpt.metrics.suspicious(estimator, np.ones((4, columns)))
