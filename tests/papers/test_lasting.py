"""The model with an error state."""

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
from conftest import AXIS

import mpt_helpers as mpt
from reproduction import lasting
from reproduction.lasting import fit_lasting, lasting_error

CV = mpt.constant_velocity(dt=30.0, q=0.0, r=0.04, P0=np.diag([100.0, 1.0]))
GPS_INS = mpt.gps_ins(30.0, 0.0, (1.0, 1e-4), P0=np.diag([100.0, 1.0, 1.0]))


def covariance_of_measurements(model, N):
    """The covariance of N successive measurements (N m, N m), from the definitions of F, H, Q and R."""
    n, m = model.n, model.m
    C = np.zeros((N * n, N * n))  # of the states
    P, powers = model.P0, np.eye(n)
    for k in range(N):
        P = model.F @ P @ model.F.T + model.Q
        powers = np.eye(n)
        for later in range(k, N):
            block = powers @ P
            C[later * n : (later + 1) * n, k * n : (k + 1) * n] = block
            C[k * n : (k + 1) * n, later * n : (later + 1) * n] = block.T
            powers = model.F @ powers
    H = np.kron(np.eye(N), model.H)
    return H @ C @ H.T + np.kron(np.eye(N), model.R), m


@pytest.mark.parametrize(("model", "sigma", "tau"), [(CV, 1.2, 3600.0), (GPS_INS, (0.8, 0.02), (600.0, 7200.0))])
def test_the_measurements_gain_an_error_that_fades_exponentially(model, sigma, tau):
    """Against the covariance of such errors, written down at once."""
    made, m = covariance_of_measurements(lasting_error(model, sigma, tau, dt=30.0), 6)
    plain, _ = covariance_of_measurements(model, 6)
    lag = 30.0 * np.abs(np.subtract.outer(np.arange(6), np.arange(6)))
    for j, (s, t) in enumerate(zip(np.broadcast_to(sigma, m), np.broadcast_to(tau, m), strict=True)):
        plain[j::m, j::m] += s**2 * np.exp(-lag / t)
    np.testing.assert_allclose(made, plain, rtol=1e-9)


def test_the_step_is_the_models_own():
    assert lasting_error(CV, 1.0, 600.0) == lasting_error(CV, 1.0, 600.0, dt=30.0)
    with pytest.raises(ValueError, match="dt: needs the model's own time step, 30 s, got 1 s"):
        lasting_error(CV, 1.0, 600.0, dt=1.0)
    with pytest.raises(ValueError, match="dt: needs the time step in seconds, which this model does not say, got none"):
        lasting_error(replace(AXIS, dt=None), 1.0, 600.0)


def test_the_start_and_the_states_stay_in_front():
    begun = replace(GPS_INS, x0=[1.0, 2.0, 3.0])
    model = lasting_error(begun, (0.5, 0.0), 600.0, dt=30.0)
    np.testing.assert_array_equal(model.x0, [1, 2, 3, 0, 0])
    np.testing.assert_array_equal(model.P0, np.diag([100, 1, 1, 0.25, 0]))
    np.testing.assert_array_equal(model.F[:3, :3], GPS_INS.F)
    np.testing.assert_array_equal(model.R, GPS_INS.R)


def test_without_a_lasting_error_the_filter_is_the_same():
    _, z = mpt.simulate(CV, 50, np.random.default_rng(1))
    x = mpt.KalmanFilter(lasting_error(CV, 0.0, 600.0)).filter(z)
    np.testing.assert_allclose(x[:, :2], mpt.KalmanFilter(CV).filter(z), rtol=1e-9)
    np.testing.assert_array_equal(x[:, 2], 0)


def test_a_filter_that_knows_of_it_states_what_it_makes():
    model = lasting_error(CV, 1.0, 3600.0)
    x, z = mpt.simulate(model, 100, np.random.default_rng(2), tracks=2000)
    low, high = mpt.metrics.chi_square_band(1, 2000, level=0.9999)

    def squares(estimates):
        return (estimates.x[-1, 0] - x[-1, 0]) ** 2 / estimates.P[-1, 0, 0]

    assert low < squares(mpt.KalmanFilter(model).estimates(z)).mean() < high
    assert squares(mpt.KalmanFilter(CV).estimates(z)).mean() > 100  # and one that does not is wrong by ten sigma


@pytest.mark.slow  # `fit` has tests of its own, and the error's covariance is held exactly above
def test_a_fit_finds_it_without_the_truth():
    true = lasting_error(CV, 1.0, 1800.0)
    _, z = mpt.simulate(true, 1000, np.random.default_rng(3))
    z[500] = np.nan

    def make(r, sigma, tau):
        axis = mpt.constant_velocity(dt=30.0, q=0.0, r=r, P0=CV.P0)
        return lasting_error(axis, sigma, tau)

    found = mpt.fit(make, z, r=0.5, sigma=3.0, tau=300.0)
    for name, value in {"r": 0.04, "sigma": 1.0, "tau": 1800.0}.items():
        assert abs(np.log(found.values[name] / value)) < 4 * found.log_errors[name], name


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sigma": -1.0}, "sigma: needs a number that is not negative, got -1.0"),
        ({"sigma": [1.0, 2.0]}, r"sigma: needs a number, or 1 numbers, got shape \(2,\)"),
        ({"tau": 0.0}, "tau: needs a positive number, got 0.0"),
        ({"tau": np.inf}, "tau: needs a positive number, got inf"),
        ({"dt": -1.0}, "dt: needs a positive number.*, got -1.0"),
    ],
)
def test_bad_numbers_are_refused_by_name(change, message):
    with pytest.raises(ValueError, match=message):
        lasting_error(**{"model": CV, "sigma": 1.0, "tau": 600.0} | change)


def test_only_a_model_gets_an_error_state():
    with pytest.raises(TypeError, match="model: needs a LinearModel"):
        lasting_error("model", 1.0, 600.0)


def test_a_filter_with_times_refuses_it():
    with pytest.raises((TypeError, ValueError), match="t: needs a model with a transition"):
        mpt.KalmanFilter(lasting_error(CV, 1.0, 600.0), t=[0.0, 30.0, 50.0])


STILL = mpt.LinearModel(F=[[1]], H=[[1]], Q=[[0]], R=[[0.25]])


def log_at_rest(seed, sigma=1.0, tau=600.0, N=400, dt=60.0):
    """Times and positions, to the east of a point 100 m away, of a receiver that does not move."""
    _, z = mpt.simulate(lasting_error(STILL, sigma, tau, dt=dt), N, np.random.default_rng(seed))
    return dt * np.arange(N), 100 + z


@pytest.mark.filterwarnings("ignore:fit_lasting")
def test_logs_at_rest_tell_r_sigma_and_tau_within_the_errors_that_they_state():
    """Four logs, three numbers each: four of 12 outside their spans of 95 % have a probability of 0.2 %."""
    logs = [log_at_rest(seed) for seed in range(10, 14)]
    true = {"r": 0.25, "sigma": 1.0, "tau": 600.0}
    fits = [fit_lasting(log) for log in logs]
    outside = [not low < true[name] < high for each in fits for name in true for low, high in each.known[name]]
    assert sum(outside) <= 3
    assert min(each.floor[0] for each in fits) > 0.6


def test_each_log_has_its_own_mean_and_may_have_its_own_length():
    t, z = log_at_rest(1)
    two = fit_lasting((t, z), (t[:300] + 1e6, z[:300] - 5000))
    same = fit_lasting((t, z), (t[:300], z[:300]))
    np.testing.assert_allclose(two.sigma, same.sigma, rtol=1e-3)
    assert two.sigma[0] < 2


@pytest.mark.filterwarnings("ignore:fit_lasting")
def test_missing_fixes_are_left_out_or_nan_and_axes_stay_apart():
    t, z = log_at_rest(2, N=250)
    both = np.column_stack([z, 3 * z])
    gap = both.copy()
    gap[100:130] = np.nan
    keep = np.isfinite(gap).all(axis=1)
    for one, other in zip(*(lasting._on_a_grid(log) for log in ((t, gap), (t[keep], both[keep]))), strict=True):
        np.testing.assert_array_equal(one, other)
    found = fit_lasting((t, gap))
    np.testing.assert_allclose(found.sigma[1], 3 * found.sigma[0], rtol=2e-3)
    np.testing.assert_allclose(found.tau[1], found.tau[0], rtol=4e-3)
    assert found.halves.shape == (2, 2, 3)


def test_a_log_too_short_for_its_memory_is_told():
    with pytest.warns(
        UserWarning,
        match=r"axis 0: tau is \d+ min to more than the 400 min of the log, which the logs do not determine: give more",
    ):
        found = fit_lasting(log_at_rest(3, tau=30_000.0))
    low, high = found.known["tau"][0]
    assert high > 7 * low


@pytest.mark.filterwarnings("ignore:fit_lasting")
def test_a_bad_half_makes_the_floor_and_widens_what_is_known():
    t, z = log_at_rest(4)
    loud = 100 + (z - 100) * np.where(np.arange(len(z)) < 200, 1.0, 4.0)[:, None]
    calm, found = fit_lasting((t, z)), fit_lasting((t, loud))
    assert found.floor[0] > 2.5 * calm.floor[0]
    worse = np.array_split(loud - loud.mean(), 2)[1]
    assert found.floor[0] ** 2 == pytest.approx(np.mean(worse**2) - found.r[0])
    assert np.divide(*found.known["sigma"][0, ::-1]) > 2 * np.divide(*calm.known["sigma"][0, ::-1])


@pytest.mark.filterwarnings("ignore:fit_lasting")
def test_a_long_log_is_thinned(monkeypatch):
    monkeypatch.setattr(lasting, "MOST_ROWS", 200)
    t, z = log_at_rest(5, N=600)
    found, every_third = fit_lasting((t, z)), fit_lasting((t[::3], (z - z.mean() + z[::3].mean())[::3]))
    np.testing.assert_allclose(found.tau, every_third.tau, rtol=1e-3)


def said_of(z, dt=60.0):
    """Return what `fit_lasting` finds of fixes (N,) and the texts of its warnings."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = fit_lasting((dt * np.arange(len(z)), z))
    return found, [str(each.message) for each in told]


def test_independent_errors_are_said_to_be_and_get_no_floor():
    """Four logs of 120 to 200 fixes: 20 to 1 is passed by chance by some 2 in 100."""
    rng = np.random.default_rng(20)
    for seed in range(4):
        size, dt = rng.uniform(0.3, 5), rng.choice([1.0, 60.0])
        found, said = said_of(size * np.random.default_rng(seed).standard_normal(rng.integers(120, 200)), dt)
        assert found.sigma[0] == 0
        (text,) = said
        assert text.startswith(
            "fit_lasting: axis 0: no error that lasts is seen: the errors look independent, sigma is"
        )
        unit = "s" if dt == 1 else "min"
        assert f"below about {found.known['sigma'][0, 1]:.2g} m for a tau of 10 {unit} to " in text
        assert found.floor[0] == 0
        assert found.known["sigma"][0, 0] == 0
        assert 0 < found.known["sigma"][0, 1] < size
        assert found.r[0] == pytest.approx(size**2, rel=0.5)
        assert np.isfinite(found.halves).all()


def test_errors_that_last_are_seen_and_more_days_are_asked_for_where_they_help():
    """Four logs; a span that is beyond the log or below a step is said in words."""
    rng = np.random.default_rng(21)
    for seed in range(4):
        sigma, tau, N = rng.uniform(0.5, 3), rng.choice([600.0, 1800.0, 7200.0]), int(rng.integers(120, 200))
        found, said = said_of(log_at_rest(seed, sigma, tau, N)[1])
        assert found.sigma[0] > 0
        assert found.floor[0] > 0
        low, high = found.known["tau"][0]
        for text in said:
            assert re.fullmatch(
                r"fit_lasting: axis 0: tau is .*, which the logs do not determine: give more days", text
            )
            assert (f"more than the {N} min of the log" in text) == (high > 60 * N)
            assert ("less than a step" in text) == (low < 60)
            assert max(map(int, re.findall(r"\d+", text))) <= N
        assert bool(said) == (high / low > np.exp(2 * 1.96 * 0.5))


def test_what_is_not_seen_is_smaller_than_is_said():
    """Five logs of errors beside which the noise is 2.5 times as large: seen, or below what the warning says."""
    below = []
    for seed in range(5):
        found, _ = said_of(log_at_rest(seed, sigma=0.2, tau=900.0, N=200)[1])
        below.append(found.sigma[0] > 0 or found.known["sigma"][0, 1] > 0.2)
    assert sum(below) >= 4


def test_missing_fixes_are_no_fixes():
    t, z = log_at_rest(3, N=150)
    z[99:] = np.nan
    with pytest.raises(ValueError, match="log: needs at least 100 fixes on each axis, got 99"):
        fit_lasting((t, z))


@pytest.mark.filterwarnings("ignore:fit_lasting")
def test_a_gap_that_would_thin_a_log_to_nothing_is_refused_with_the_way_out():
    """800 fixes and a week between two halves of them: of 20,560 rows every 14th is taken, and 58 fixes remain."""
    t, z = log_at_rest(1, N=800, dt=30.0)
    apart = np.where(np.arange(800) < 400, t, t + 7 * 86400)
    with pytest.raises(ValueError, match=r"log: needs at least 100 fixes .*, got 58; give parts .* as logs"):
        fit_lasting((apart, z))
    found = fit_lasting((apart[:400], z[:400]), (apart[400:], z[400:]))
    np.testing.assert_array_equal(found.r, fit_lasting((t[:400], z[:400]), (t[400:], z[400:])).r)


BAD_LOGS = [
    ((), "logs: needs at least one pair"),
    (([1, 2, 3],), r"log: needs a pair \(t, z\), got list"),
    (((np.arange(50.0), np.ones(50)),), "log: needs at least 100 fixes on each axis, got 50"),
    (
        ((np.arange(200.0), np.ones(100)),),
        r"log: needs times \(N,\) and positions .* got shapes \(200,\) and \(100, 1\)",
    ),
    (((np.arange(200.0)[::-1], np.arange(200.0) % 7),), "t: needs times that increase, got 199 and then 198"),
    (((np.where(np.arange(200) == 7, np.nan, np.arange(200)), np.ones(200)),), "t: needs a time of each fix"),
    (
        ((np.cumsum(np.where(np.arange(200) == 50, 0.1, 1.0)), np.arange(200) % 7),),
        "t: needs times at one step, here 1 s",
    ),
    (((np.arange(200.0), np.full(200, np.nan)),), "log: needs at least 100 fixes on each axis, got 0"),
    ((log_at_rest(0), log_at_rest(0, dt=30.0)), "logs: needs one step and one number of axes, got steps of 30 to 60 s"),
]


@pytest.mark.parametrize(("logs", "message"), BAD_LOGS)
def test_bad_logs_are_refused_by_name(logs, message):
    with pytest.raises((ValueError, TypeError), match=message):
        fit_lasting(*logs)


def test_a_receiver_at_rest_is_filtered_without_matrices_as_with_them():
    """Two logs with gaps of their own, against the filter of the package."""
    still = mpt.LinearModel(F=[[1.0]], H=[[1.0]], Q=[[0.0]], R=[[0.5]], P0=[[30.0]])
    model = lasting_error(still, 1.2, 900.0, dt=30.0)
    z = np.random.default_rng(12).standard_normal((80, 1, 2)).cumsum(axis=0)
    z[[3, 17, 18], 0, 0] = z[40, 0, 1] = np.nan
    without = lasting._at_rest(3.0, 30.0, r=0.5, sigma=1.2, tau=900.0)
    for found, expected in zip(without.innovations_of(z), mpt.KalmanFilter(model).innovations_of(z), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("slow", [0.0, 1.5])
def test_a_slower_error_beside_a_quick_one_is_told(slow):
    """Two hours at 1 Hz with reflections of 20 s, and an error of half an hour: one tau cannot be both."""
    rng = np.random.default_rng(0)
    z = np.zeros((7200, 1))
    for sigma, tau, r in ((1.0, 20.0, 0.25), (slow, 1800.0, 1e-12)):
        still = mpt.LinearModel(F=[[1.0]], H=[[1.0]], Q=[[0.0]], R=[[r]])
        z += mpt.simulate(lasting_error(still, sigma, tau, dt=1.0), 7200, rng)[1]
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        fit_lasting((np.arange(7200.0), z))
    assert any("a slower error is there too" in str(each.message) for each in said) == (slow > 0)


def test_unix_milliseconds_and_one_value_are_refused():
    t, z = log_at_rest(0)
    with pytest.raises(ValueError, match=r"t: needs times in seconds, got 1\d+, as of Unix milli"):
        fit_lasting((1.7e12 + 1000 * t, z))
    with pytest.raises(ValueError, match="z: needs positions that differ"):
        fit_lasting((t, np.full(len(t), 5.0)))
