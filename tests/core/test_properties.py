"""What holds for every model that has a steady state, tried on random ones: n up to 8, m up to 4."""

from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import matrices, textbook_kalman
from scipy.linalg import block_diag

import mpt_helpers as mpt
from mpt_helpers._engine import run as engine
from mpt_helpers._engine import shared as steps

EPS = np.finfo(float).eps
FILTERS = [mpt.KalmanFilter, mpt.LainiotisFilter]
SOLVED = [mpt.SteadyStateFilter.from_kalman, mpt.SteadyStateFilter.from_lainiotis]
steady_state = mpt.SteadyStateFilter.from_kalman
# Each way in which a filter runs, once.
ALL = {
    "KF": mpt.KalmanFilter,
    "LF": mpt.LainiotisFilter,
    "SSKF": steady_state,
    "FIR": lambda model: mpt.FIRFilter.from_steady_state(steady_state(model)),
    "join, separate, ahead": lambda model: mpt.JoinFilter(
        mpt.Separate(mpt.Predictor(steady_state(model), 2)), mpt.SteadyStatePredictor(steady_state(model), 2)
    ),
}


def all_filters(test):
    """Try fewer models with each of the filters."""
    return pytest.mark.parametrize("make", ALL.values(), ids=ALL)(settings(max_examples=4)(test))


seeds = st.integers(0, 2**32 - 1)
few = settings(max_examples=5)  # of what `test_paths` looks at too, under more conditions


def rotation(rng, n):
    """A random orthogonal matrix."""
    return np.linalg.qr(rng.standard_normal((n, n)))[0]


def spd(rng, n):
    """A correlated covariance with variances from 0.1 to 10 along its axes."""
    V = rotation(rng, n)
    return V * 10 ** rng.uniform(-1, 1, n) @ V.T


def modes(rng, outer, inner):
    """A triangular matrix: so many eigenvalues on or outside the unit circle first, the others between 0.4 and 0.9."""
    signs = rng.choice([-1, 1], outer + inner)
    sizes = np.concatenate([1 + rng.choice([0, 0.05, 0.2], outer), rng.uniform(0.4, 0.9, inner)])
    return np.diag(signs * sizes) + np.triu(0.3 * rng.standard_normal((outer + inner,) * 2), 1)


@st.composite
def models(draw, most=8):
    """A model with a steady state, well conditioned: outer modes are driven and seen each by a noise and a row of H.

    Q is singular in most, the noises are correlated, P0 is zero or a covariance.
    """
    n = draw(st.integers(1, most), "n")
    m = draw(st.integers(1, min(4, most)), "m")
    outer = draw(st.integers(0, min(2, m, n)), "outer")
    driven = draw(st.integers(0 if outer else 1, n - outer) if n > outer else st.just(0), "driven")
    uncertain = draw(st.booleans(), "P0")
    rng = np.random.default_rng(draw(seeds, "seed"))
    V = rotation(rng, n)
    G = block_diag(np.eye(outer), rng.standard_normal((n - outer, driven)))
    H = rng.uniform(-0.5, 0.5, (m, n))
    H[:outer, :outer] = np.eye(outer)
    return mpt.LinearModel(
        F=V @ modes(rng, outer, n - outer) @ V.T,
        H=H @ V.T,
        Q=V @ G @ G.T @ V.T,
        R=spd(rng, m),
        x0=rng.standard_normal(n),
        P0=spd(rng, n) if uncertain else np.zeros((n, n)),
    )


def measured(model, seed, N=40, tracks=None, missed=0.0):
    """Measurements of tracks of the model; each epoch of each track is missed with this probability."""
    rng = np.random.default_rng(seed)
    z = mpt.simulate(model, N, rng, tracks)[1]
    lost = rng.random((N, 1, *z.shape[2:])) < missed
    return np.where(lost, np.nan, z)


def decay(A):
    """The largest sum of rounding errors of size one, made in every step: Σ ‖Aʲ‖²."""
    power, total = np.eye(len(A)), 0.0
    while (size := np.linalg.norm(power, 2) ** 2) > EPS:
        power, total = power @ A, total + size
    return total


def condition(model):
    """How much larger than eps the relative error of the estimates and covariances of a filter may be.

    One step rounds some ten products of n terms and solves systems with S = H P_p Hᵀ + R or with I + P O_n, whose
    condition is at most that of R times 1 + ‖P_p‖ ‖Hᵀ R⁻¹ H‖ (P_p also the largest that the start or some missed epochs
    make). Its errors last as the closed loop lets them.
    """
    steady = mpt.SteadyStateFilter.from_kalman(model)
    P = np.linalg.norm(steady.P, 2) + np.linalg.norm(model.P0, 2)
    P_p = np.linalg.norm(model.F, 2) ** 2 * P + np.linalg.norm(model.Q, 2)
    step = np.linalg.cond(model.R) * (1 + P_p * np.linalg.norm(model.H, 2) ** 2 / np.linalg.eigvalsh(model.R)[0])
    return 10 * model.n * step * decay(steady.A)


def assert_same(ours, theirs, condition, axis=None):
    """Assert that two arrays are equal within eps times a condition, relative to the largest entry."""
    assert ours.shape == theirs.shape
    scale = max(np.abs(theirs).max(), np.finfo(float).tiny)
    gap = np.abs(ours - theirs).max() / scale
    assert gap <= EPS * condition, f"{gap:.1e} is more than {EPS * condition:.1e}"


@few
@given(models(), seeds)
def test_lainiotis_equals_kalman(model, seed):
    z = measured(model, seed, missed=0.2)
    kf, lf = mpt.KalmanFilter(model), mpt.LainiotisFilter(model)
    assert_same(lf.filter(z), kf.filter(z), condition(model))
    for ours, theirs in zip(lf.coefficients(40), kf.coefficients(40), strict=True):
        assert_same(ours, theirs, condition(model))


@few
@given(models(), seeds)
def test_missed_epochs_are_predicted_only(model, seed):
    z = measured(model, seed, missed=0.4)
    expected = textbook_kalman(*matrices(model), z)[0]
    for make in FILTERS:
        x = make(model).filter(z)
        assert_same(x, expected, condition(model))
        before = np.vstack([model.x0, x[:-1]])
        lost = np.isnan(z[:, 0])
        if lost.any():  # F x is a sum of n products, whatever the filter
            assert_same(x[lost], before[lost] @ model.F.T, 10 * model.n * np.linalg.norm(model.F, 2))


@pytest.mark.parametrize("make", [mpt.KalmanFilter, mpt.SteadyStateFilter.from_lainiotis])
@few
@given(models(most=4), models(most=4), seeds)
def test_separate_filters_are_one_of_the_stacked_model(make, first, second, seed):
    both = mpt.stack(first, second)
    z = measured(both, seed, missed=0.2)
    separate = mpt.Separate(make(first), make(second))
    assert_same(separate.filter(z), make(both).filter(z), condition(both))
    assert_same(separate.covariances(20), make(both).covariances(20), condition(both))


@few
@given(models())
def test_steady_state_is_the_limit_of_the_recursion(model):
    limit = [each[-1] for each in mpt.KalmanFilter(model).coefficients(600)]  # 0.9^600 is below eps
    for make in SOLVED:
        steady = make(model)
        for ours, theirs in zip((steady.A, steady.B, steady.P), limit, strict=True):
            assert_same(ours, theirs, condition(model))


@few
@given(models(), seeds, st.integers(0, 6))
def test_predictor_is_the_propagated_estimate(model, seed, steps):
    z = measured(model, seed, missed=0.2)
    steady = mpt.SteadyStateFilter.from_kalman(model)
    F_N = np.linalg.matrix_power(model.F, steps)
    assert_same(mpt.SteadyStatePredictor(steady, steps).filter(z), steady.filter(z) @ F_N.T, condition(model))


@given(models(), seeds, st.floats(1e-6, 0.5))
def test_fir_goes_to_the_steady_state(model, seed, tol):
    """What the dropped taps stand for is A^M x(k-M/k-M), and its size is below tol."""
    model = replace(model, x0=0 * model.x0)
    z = measured(model, seed)
    steady = mpt.SteadyStateFilter.from_kalman(model)
    fir = mpt.FIRFilter.from_steady_state(steady, tol)
    x, M = steady.filter(z), fir.order
    dropped = np.zeros_like(x)
    dropped[M:] = x[:-M] @ np.linalg.matrix_power(steady.A, M).T if len(x) > M else 0
    assert_same(fir.filter(z) + dropped, x, condition(model))
    assert np.linalg.norm(dropped, axis=1).max() <= tol * np.linalg.norm(x, axis=1).max()


@all_filters
@given(models(most=5), seeds, st.integers(1, 40), st.integers(1, 30), st.sampled_from([0.0, 0.03, 0.5]))
def test_many_tracks_are_each_track_alone(make, model, seed, N, tracks, missed):
    """Whatever the number of tracks in a tile, and of steps in a product."""
    z = measured(model, seed, N, tracks, missed)
    with patch.object(steps, "TILE", 1 + seed % 7), patch.object(engine, "TILE_OF_COVARIANCES", 1 + seed % 5):
        together = make(model).filter(z)
    each = make(model)
    for i in range(0, tracks, 1 + tracks // 5):
        assert_same(together[..., i], each.filter(z[..., i]), condition(model))


@settings(max_examples=3)
@pytest.mark.parametrize("make", FILTERS)
@given(models(), seeds)
def test_covariances_stay_covariances(make, model, seed):
    """After 20,000 steps of which some are missed."""
    z = np.zeros((20_000, model.m))
    z[np.random.default_rng(seed).integers(0, 19_000, 20)] = np.nan
    P = make(model).covariances(z)
    largest = np.linalg.eigvalsh(P)[:, -1].max()
    allowed = EPS * condition(model) * largest
    assert np.abs(P - P.transpose(0, 2, 1)).max() <= allowed
    assert np.linalg.eigvalsh(P).min() >= -allowed
    # The steady state does not drift: 20,000 roundings add up no further than the closed loop lets them.
    assert_same(P[-1], mpt.SteadyStateFilter.from_kalman(model).P, condition(model))


def read_only(z):
    z = z.copy()
    z.flags.writeable = False
    return z


def strided(z):
    wide = np.full([2 * size for size in z.shape], 99, z.dtype)
    wide[tuple(slice(None, None, 2) for _ in z.shape)] = z
    return wide[tuple(slice(None, None, 2) for _ in z.shape)]


LAYOUTS = {
    "Fortran": np.asfortranarray,
    "strided": strided,
    "reversed": lambda z: np.ascontiguousarray(z[::-1])[::-1],
    "transposed": lambda z: np.ascontiguousarray(z.T).T,
    "read-only": read_only,
    "big-endian": lambda z: z.astype(z.dtype.newbyteorder(">")),
    "list": np.ndarray.tolist,
}
KINDS = [np.float32, np.float64, np.longdouble, np.int8, np.int64, np.uint16]


@all_filters
@given(models(most=4), seeds, st.sampled_from(sorted(LAYOUTS)), st.sampled_from(KINDS), st.sampled_from([None, 1, 9]))
def test_layout_and_type_of_the_measurements_do_not_matter(make, model, seed, layout, kind, tracks):
    """For numbers that all these types hold; and nothing is written to them.

    To rounding: of other layouts numpy 2.0 makes products in another order, to the last bit.
    """
    z = np.abs(measured(model, seed, 20, tracks)).round() % 100
    if issubclass(kind, np.floating):
        z[seed % 20] = np.nan
    given_z = LAYOUTS[layout](z.astype(kind))
    before = np.array(given_z)
    each = make(model)
    right = each.filter(z)
    np.testing.assert_allclose(each.filter(given_z), right, rtol=1e-12, atol=1e-13 * np.nanmax(np.abs(right)))
    np.testing.assert_array_equal(given_z, before)


@given(models(most=4), seeds, st.sampled_from(sorted(LAYOUTS)))
def test_layout_of_the_model_does_not_matter(model, seed, layout):
    """To the last bit; and nothing is written to its matrices."""
    arrays = {name: LAYOUTS[layout](getattr(model, name)) for name in ("F", "H", "Q", "R", "x0", "P0")}
    before = {name: np.array(value) for name, value in arrays.items()}
    z = measured(model, seed, 20, missed=0.1)
    np.testing.assert_array_equal(*(mpt.KalmanFilter(each).filter(z) for each in (mpt.LinearModel(**arrays), model)))
    for name, value in arrays.items():
        np.testing.assert_array_equal(value, before[name])
