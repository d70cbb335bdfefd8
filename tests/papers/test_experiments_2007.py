"""What the notebook on the paper of 2007 simulates."""

from dataclasses import replace

import numpy as np
import pytest

import mpt_helpers as mpt
from reproduction.paper_2007 import experiments as runs
from reproduction.paper_2007 import positioning

SIGMAS = np.array([1.0, 0.01])
MODEL = replace(mpt.gps_ins(0.5, 0.01, (*SIGMAS**2, 2.0)), x0=[1.0, 2.0, 3.0], P0=np.diag([100.0, 1.0, 1.0]))
TWO = replace(MODEL, H=MODEL.H[:2], R=MODEL.R[:2, :2])


def test_random_skies_are_of_all_places_and_times():
    rng = np.random.default_rng(13)
    drawn = [runs.random_sky(rng) for _ in range(500)]
    up = np.array([positioning.local_axes(X[:3])[2] for _, X in drawn])
    # A coordinate of a uniform direction has mean 0 and variance 1/3; four standard errors of 500.
    np.testing.assert_allclose(up.mean(axis=0), 0, atol=4 * np.sqrt(1 / 3 / 500))
    np.testing.assert_allclose(up.var(axis=0), 1 / 3, atol=4 * np.sqrt(4 / 45 / 500))
    at_epoch = positioning.constellation(0.0)
    assert not any(np.isclose(satellites[:, None], at_epoch, atol=1.0).all(axis=2).any() for satellites, _ in drawn)


def off(X):
    return X + np.array([3e5, 0, 0, 5e3])


def test_rough_errors_are_those_of_the_iteration():
    errors = runs.rough_errors(off, 0.0, 4, np.random.default_rng(7), 20)
    assert errors.shape == (5, 20)
    np.testing.assert_allclose(errors[0], 3e5)
    assert (np.diff(errors[:3], axis=0) < 0).all()
    assert errors[4].max() < 1e-6


def test_ranges_are_new_at_each_step_or_stay_the_same():
    """With the same ranges least squares repeats its position; with new ones the error is new, and as large."""
    anew, same = (runs.rough_errors(lambda X: X, 1.0, 6, np.random.default_rng(7), 400, each) for each in (True, False))
    np.testing.assert_allclose(same[2:], same[1:-1], atol=1e-3)  # m: from 2 m away the second step moves by microns
    assert np.abs(np.diff(anew[1:], axis=0)).min(axis=0).max() > 1e-3
    # The errors of 400 skies differ between the two by their own luck: an rms of 400 is known to some 5 %.
    np.testing.assert_allclose(mpt.metrics.rms(anew[1:], axis=1), mpt.metrics.rms(same[1], axis=0), rtol=0.2)
    assert (anew[0] == 0).all()


@pytest.mark.parametrize("seconds", [0, 0.5, 1, 3, 10])
@pytest.mark.parametrize("phase", [0.0, 0.3, 0.9])
def test_the_position_of_a_change_is_the_integral_of_its_velocity(seconds, phase):
    track = runs.change(0.2, 5.0, seconds, 40, dt=0.5, phase=phase)
    fine = np.linspace(0, 0.5 * 39, 390_001)
    begin = 0.5 * (20 - phase)
    ramp = np.clip((fine - begin) / seconds, 0, 1) if seconds else fine >= begin - 1e-9
    velocity = 0.2 + 4.8 * ramp
    np.testing.assert_allclose(track[:, 1], velocity[::10_000], atol=1e-3)
    steps = (velocity[1:] + velocity[:-1]) / 2 * np.diff(fine)
    np.testing.assert_allclose(track[:, 0], np.append(0, steps.cumsum())[::10_000], atol=1e-3)


def test_exact_errors_are_those_of_many_runs():
    rng = np.random.default_rng(3)
    truth = np.column_stack([runs.change(0.2, 3.0, 2.0, 30, 0.5), np.full(30, 1.0)])
    clean = truth[:, :2] + [0, 1.0]
    kf = mpt.KalmanFilter(TWO)
    experiment = kf.filter, clean[..., None], truth[..., None], SIGMAS
    mean, P = runs.exact_moments(*experiment)
    z = clean[..., None] + SIGMAS[:, None] * rng.standard_normal((30, 2, 20_000))
    e = kf.filter(z) - truth[..., None]
    sigma = np.sqrt(np.einsum("kii->ki", P))
    np.testing.assert_allclose(e.mean(axis=2) / sigma, mean[..., 0] / sigma, atol=4 / np.sqrt(20_000))
    # The relative standard error of a standard deviation over 20,000 runs is 0.5 %; four of it.
    np.testing.assert_allclose(e.std(axis=2), sigma, rtol=0.02)
    np.testing.assert_allclose(mpt.metrics.rms(e, axis=2), runs.exact_rms(*experiment)[..., 0], rtol=0.03)


def measured(N, M, second=False):
    x, z = mpt.simulate(TWO, N + 1, np.random.default_rng(4), tracks=M)
    receiver = x[:, :1] + np.sqrt(2.0) * np.random.default_rng(5).standard_normal((N + 1, 1, M))
    return x, np.concatenate([z, receiver], axis=1) if second else z


def begun(model):
    """The model one step later, where row 0 of the measurements is."""
    return replace(model, x0=model.F @ model.x0, P0=model.F @ model.P0 @ model.F.T + model.Q)


def test_without_a_third_row_it_is_the_packages_filter():
    _, z = measured(25, 3)
    estimates = runs.kalman(MODEL, z, "no third row")
    np.testing.assert_allclose(estimates, mpt.KalmanFilter(TWO).filter(z[1:]), rtol=1e-9)
    assert runs.filter_of(MODEL, "no third row").model == TWO


def test_a_second_receiver_is_what_the_filter_assumes():
    """But for the change of the velocity in the step, which is in both: with a small q it is little."""
    model = begun(replace(MODEL, Q=np.zeros((3, 3))))
    x, z = mpt.simulate(replace(TWO, Q=np.zeros((3, 3))), 31, np.random.default_rng(6), tracks=5000)
    z = np.concatenate([z, x[:, :1] + np.sqrt(2.0) * np.random.default_rng(7).standard_normal((31, 1, 5000))], axis=1)
    P = runs.filter_of(model, "second receiver").covariances(30)
    nees = mpt.metrics.nees(runs.kalman(model, z, "second receiver") - x[1:], P).mean(axis=1)
    low, high = mpt.metrics.chi_square_band(3, 5000, level=0.9999)
    assert low < nees.min()
    assert nees.max() < high


@pytest.mark.parametrize(
    ("reading", "third"),
    [
        ("GPS again", lambda z: z[:-1, 0]),
        ("second receiver", lambda z: z[:-1, 2]),
    ],
)
def test_a_reading_is_the_packages_filter_fed_with_it(reading, third):
    _, z = measured(20, 4, second=reading == "second receiver")
    fed = np.concatenate([z[1:, :2], third(z)[:, None]], axis=1)
    np.testing.assert_allclose(runs.kalman(MODEL, z, reading), mpt.KalmanFilter(MODEL).filter(fed), rtol=1e-9)
    assert runs.filter_of(MODEL, reading).model == MODEL


@pytest.mark.parametrize(
    ("reading", "third"),
    [
        ("own estimate", lambda x, z_k: x[0]),
        ("GPS - Δt (INS - b)", lambda x, z_k: z_k[0] - 0.5 * (z_k[1] - x[2])),
    ],
)
def test_a_reading_that_takes_the_last_estimate_is_the_packages_steps(reading, third):
    _, z = measured(20, 1)
    kf, x, P, path = mpt.KalmanFilter(MODEL), MODEL.x0, MODEL.P0, []
    for z_k in z[1:, :, 0]:
        x, P = kf.step(x, P, np.append(z_k, third(x, z_k)))
        path.append(x)
    np.testing.assert_allclose(runs.kalman(MODEL, z, reading)[..., 0], path, rtol=1e-9)


def test_the_last_gps_position_again_carries_nothing_once_the_model_says_so():
    """With the noise n of GPS and its last measurement y in the state, a filter of three rows is the filter of two."""
    gps, ins = np.diag(TWO.R)
    F, H = np.zeros((5, 5)), np.zeros((3, 5))
    F[:3, :3], F[4, [0, 3]] = TWO.F, 1
    H[:2, :3], H[0, 3], H[2, 4] = TWO.H, 1, 1
    Q, P0 = (np.diag([*np.diag(first), gps, last]) for first, last in ((TWO.Q, 0.0), (TWO.P0, 0.0)))
    P0[3, 3] = 1e6  # of the position before the first step nothing is known
    R = np.diag([1e-6 * gps, ins, 1e-6 * gps])  # so that R stays definite
    knows = mpt.LinearModel(F=F, H=H, Q=Q, R=R, x0=[*TWO.x0, 0, 0], P0=P0)
    _, z = mpt.simulate(TWO, 30, np.random.default_rng(5))
    again = np.vstack([[TWO.x0[0]], z[:-1, :1]])
    x = mpt.KalmanFilter(knows).filter(np.hstack([z, again]))
    # The tiny variances and the 1e-6 of information in the first position again leave some 1e-5 of errors of about 1.
    np.testing.assert_allclose(x[:, :3], mpt.KalmanFilter(TWO).filter(z), atol=1e-3)
