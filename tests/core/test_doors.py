"""What a user hands in is checked where it enters: a model made, a filter made, measurements filtered, a study.

Each argument is refused by its name, with what it needs and what it got.
"""

import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from decimal import Decimal
from functools import partial

import numpy as np
import pytest
from conftest import AXIS

import mpt_helpers as mpt
from mpt_helpers import metrics

NAN, INF = np.nan, np.inf
EYE, PLANE, CV = np.eye(2), mpt.stack(AXIS, AXIS), mpt.constant_velocity(1.0, 0.01, 0.1)
KF, LF, STEADY = mpt.KalmanFilter(AXIS), mpt.LainiotisFilter(AXIS), mpt.SteadyStateFilter.from_kalman(AXIS)
AHEAD, FIR = mpt.SteadyStatePredictor(STEADY, 2), mpt.FIRFilter.from_steady_state(STEADY)
RNG = np.random.default_rng(0)
STILL, MOVING = np.zeros((40, 1)), mpt.KalmanFilter(CV)
ERRORS = metrics.ahead(MOVING, STILL, seconds=1.0)

NO_NUMBER = [None, "1", [1.0], 1j, NAN, INF, 10**400, KF]
NO_POSITIVE = [*NO_NUMBER, 0, -1]
NO_COUNT = [None, "1", [1], 1.0, 1.5, NAN, -1, KF]
NO_MODEL = [None, "axis", 1, EYE, KF, mpt.LinearModel]
NO_FILTER = [None, "KF", 1, AXIS, mpt.KalmanFilter]
NO_STEADY = [*NO_FILTER, KF, AHEAD, FIR]


def no_array(good):
    """Values that are no array of finite numbers of this shape."""
    good = np.array(good, float)
    lost, infinite = good.copy(), good.copy()
    lost.flat[-1], infinite.flat[0] = NAN, -INF
    kinds = [good + 0j, good > 0, good.astype(str), good.astype(object), np.ma.array(good, mask=good == good)]
    return [None, "1", 1.0, [], [[1.0], [1.0, 2.0]], good[None, ..., None], lost, infinite, *kinds]


COVARIANCES = [-EYE, [[1.0, 0.5], [0.0, 1.0]], [[1.0, 1e-9], [0.0, 1.0]], [[1.0, 2.0], [2.0, 1.0]]]
COVARIANCES += [[[1.0, 1 + 1e-9], [1 + 1e-9, 1.0]], [[0.0, 1.0], [1.0, 1.0]], [[1e-300, 1e300]] * 2]
COVARIANCES += [[[0.0, 9e-7], [9e-7, 1.0]], [[0.0, 5e-21], [5e-21, 0.0]]]  # a covariance beside a variance of zero
NO_COVARIANCE = [*no_array(EYE), *COVARIANCES, [1.0, 1.0], np.eye(3)]
START = {"x0": ([0.0, 1.0], [*no_array([0.0, 1.0])[1:], [[0.0], [1.0]]]), "P0": (EYE, NO_COVARIANCE[1:])}
MAKER = {"dt": (1.0, NO_POSITIVE), "q": (0.01, [*NO_NUMBER, -1]), "r": (0.1, NO_POSITIVE)} | START
NO_VARIANCES = [None, "ab", 1.0, [1.0], [1.0] * 4, [1.0, 0.0], [1.0, -1.0], [1.0, NAN], ["1", "1"], [True, True]]
NO_MEASUREMENTS = [None, "1", 1.0, [], [[]], np.ones((3, 2)), np.ones((3, 1, 0)), np.ones((2, 1, 2, 2))]
NO_MEASUREMENTS += [[[INF]], [[1.0], [-INF]], [[1j]], [["1"]], [[True]], [[1.0], [None]]]
NO_MEASUREMENTS += [np.ma.masked_equal([[1.0], [2.0]], 2)]
MEASURED = {"z": ([[1.0], [NAN]], [*NO_MEASUREMENTS, [[1.0], [1.0, 2.0]]])}


NO_TAPS = [FIR.taps.T, FIR.taps[:0], NAN * FIR.taps, 5.0]


def same(rng, M):
    return rng.standard_normal(M)


NO_EXPERIMENT = [None, 1, "f", lambda rng, M: None, lambda rng, M: "x", lambda rng, M: np.ones(M) * 1j]
NO_EXPERIMENT += [
    lambda rng, M: 1.0,
    lambda rng, M: np.ones((M, 2)),
    lambda rng, M: np.ones((rng.integers(1, 1000), M)),
]


# What is called, with the good value of each argument and what that argument refuses.
DOORS = {
    "a model": (
        mpt.LinearModel,
        {
            "F": (EYE, [*no_array(EYE), np.ones((2, 3)), [1.0, 2.0], np.ones((0, 0))]),
            "H": ([[1.0, 0.0]], [*no_array([[1.0, 0.0]]), [1.0, 0.0], [[1.0, 0.0, 0.0]], np.ones((0, 2))]),
            "Q": (EYE, NO_COVARIANCE),
            "R": ([[1.0]], [*no_array([[1.0]]), [[0.0]], [[-1.0]], EYE]),
        }
        | START,
    ),
    "two sensors": (mpt.LinearModel, {"F": (EYE, []), "H": (EYE, []), "Q": (EYE, []), "R": (EYE, [np.ones((2, 2))])}),
    "gsm_axis": (mpt.gsm_axis, MAKER),
    "constant_velocity": (mpt.constant_velocity, MAKER),
    "constant_acceleration": (mpt.constant_acceleration, {name: MAKER[name] for name in ("dt", "q", "r")}),
    "gps_ins": (
        mpt.gps_ins,
        {name: MAKER[name] for name in ("dt", "q")} | {"r": ([1.0, 1e-4], NO_VARIANCES)},
    ),
    "exact_motion": (mpt.exact_motion, {"model": (CV, NO_MODEL), "x0": START["x0"]}),
    "mean_track": (mpt.mean_track, {"model": (CV, NO_MODEL), "N": (3, [*NO_COUNT, 0])}),
    "simulate": (
        mpt.simulate,
        {
            "model": (CV, NO_MODEL),
            "N": (3, [*NO_COUNT, 0]),
            "rng": (RNG, []),
            "tracks": (2, [*NO_COUNT[1:], 0]),
        },
    ),
    "KalmanFilter": (mpt.KalmanFilter, {"model": (AXIS, NO_MODEL)}),
    "LainiotisFilter": (mpt.LainiotisFilter, {"model": (AXIS, NO_MODEL)}),
    "SteadyStateFilter": (
        mpt.SteadyStateFilter,
        {
            "model": (AXIS, NO_MODEL),
            "A": (STEADY.A, [*no_array(STEADY.A), np.eye(3), STEADY.A.T, 1.01 * STEADY.A]),
            "B": (STEADY.B, [*no_array(STEADY.B), STEADY.B.T, STEADY.B[:, 0]]),
            "P": (STEADY.P, [*no_array(STEADY.P), -STEADY.P, np.triu(np.ones((2, 2)))]),
        },
    ),
    "from_kalman": (mpt.SteadyStateFilter.from_kalman, {"model": (AXIS, [*NO_MODEL, replace(AXIS, Q=0 * EYE)])}),
    "from_lainiotis": (mpt.SteadyStateFilter.from_lainiotis, {"model": (AXIS, [*NO_MODEL, replace(AXIS, Q=0 * EYE)])}),
    "predictor": (mpt.SteadyStatePredictor, {"estimator": (STEADY, NO_STEADY), "steps": (1, NO_COUNT)}),
    "FIRFilter": (
        mpt.FIRFilter,
        {"model": (AXIS, NO_MODEL), "taps": (FIR.taps, NO_TAPS)},
    ),
    "from_steady_state": (
        mpt.FIRFilter.from_steady_state,
        {"steady": (STEADY, NO_STEADY), "tol": (0.1, [*NO_POSITIVE, 2])},
    ),
    "fir_order": (
        mpt.fir_order,
        {"A": ([[0.5]], [[[1.0]], [[0.5, 0.5]], [[NAN]], [["1"]], [[1 - 1e-9]]]), "tol": (0.1, [*NO_POSITIVE, 2])},
    ),
    "JoinFilter": (
        mpt.JoinFilter,
        {"first": (KF, NO_FILTER), "second": (LF, [*NO_FILTER, mpt.KalmanFilter(CV), mpt.Separate(KF, KF), AHEAD])},
    ),
    "measurements": (KF.filter, MEASURED),
    "measurements, Lainiotis": (LF.filter, MEASURED),
    "measurements, steady state": (STEADY.filter, MEASURED),
    "measurements, FIR": (FIR.filter, MEASURED),
    "covariances": (
        KF.covariances,
        {"z": (3, [each for each in NO_MEASUREMENTS if isinstance(each, list | np.ndarray)])},
    ),
    "innovations": (metrics.innovations, {"estimator": (KF, NO_FILTER)} | MEASURED),
    "nis": (partial(metrics.nis, z=STILL), {"estimator": (KF, NO_FILTER)}),
    "log_likelihood": (partial(metrics.log_likelihood, z=STILL), {"estimator": (KF, NO_FILTER)}),
    "suspicious": (partial(metrics.suspicious, z=STILL), {"estimator": (KF, NO_FILTER)}),
    "ahead": (partial(metrics.ahead, z=STILL, seconds=1.0), {"estimator": (MOVING, NO_FILTER)}),
    "LiveBand": (partial(mpt.bands.LiveBand, seconds=1.0), {"estimator": (MOVING, NO_FILTER)}),
    "following": (metrics.following, {"a": (ERRORS, [KF, None, 1.0])}),
    "coverage": (partial(metrics.coverage, band=ERRORS.sigma), {"a": (ERRORS, [KF, None, 1.0])}),
    "interval_score": (partial(metrics.interval_score, band=ERRORS.sigma), {"a": (ERRORS, [KF, None, 1.0])}),
    "nees": (
        metrics.nees,
        {"errors": (np.ones((3, 2)), []), "P": (EYE, [np.eye(3), [1.0, 1.0], -EYE, 0 * EYE, [[1.0, 0.5], [0.0, 1.0]]])},
    ),
    "chi_square_band": (
        metrics.chi_square_band,
        {"dof": (2, [*NO_COUNT, 0]), "runs": (10, [*NO_COUNT, 0]), "level": (0.9, [*NO_POSITIVE, 1, 95])},
    ),
    "error_moments": (
        metrics.error_moments,
        {"steady": (STEADY, NO_STEADY), "truth": (AXIS, [*NO_MODEL, CV]), "N": (3, [*NO_COUNT, 0])},
    ),
    "study": (
        mpt.study,
        {
            "experiment": (same, NO_EXPERIMENT),
            "runs": (500, [*NO_COUNT, 0]),
            "seed": (1, NO_COUNT),
            "workers": (1, [*NO_COUNT, 0, lambda f, tasks: [f(tasks[0])], lambda f, tasks: []]),
        },
    ),
}
REFUSED = [
    pytest.param(call, {each: good for each, (good, _) in arguments.items()}, name, bad, id=f"{door}: {name}")
    for door, (call, arguments) in DOORS.items()
    for name, (_, bad) in arguments.items()
    if bad
]


@pytest.mark.parametrize(("call", "good", "name", "refused"), REFUSED)
def test_what_an_argument_cannot_take_is_refused_by_name(call, good, name, refused):
    call(**good)
    for bad in refused:
        with pytest.raises((TypeError, ValueError)) as raised:
            pytest.fail(f"{bad!r} gives {call(**good | {name: bad})!r}")
        assert re.match(rf"{name}\b.*: needs .*, (got|but) ", str(raised.value)), (bad, raised.value)


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: mpt.stack(AXIS, KF), r"models\[1\]"),
        (lambda: mpt.Separate(), "filters"),
        (lambda: mpt.Separate(KF, AXIS), r"filters\[1\]"),
        (lambda: mpt.Separate(KF, AHEAD), r"filters\[1\]"),
        (lambda: mpt.Separate(KF, LF).filter(np.ones((3, 1))), "z"),
        (lambda: mpt.Separate(KF, LF).covariances(np.ones((3, 1))), "z"),
        (lambda: KF.step(AXIS.x0, AXIS.P0, [1.0, 2.0]), "z_k"),
        (lambda: STEADY.step(AXIS.x0, STEADY.P, 1.0), "z_k"),
        (lambda: mpt.SteadyStateFilter.from_kalman(PLANE).filter([[1.0, NAN]]), "z"),
        (lambda: mpt.FIRFilter.from_steady_state(mpt.SteadyStateFilter.from_kalman(PLANE)).filter([[NAN, 1.0]]), "z"),
    ],
)
def test_several_of_a_kind_are_refused_by_their_number(make, name):
    with pytest.raises((TypeError, ValueError), match=f"^{name}: needs .*, got "):
        make()


@pytest.mark.parametrize("each", [AHEAD, FIR, mpt.JoinFilter(FIR, FIR), mpt.Separate(KF, FIR)])
def test_a_filter_that_is_not_recursive_has_no_step(each):
    with pytest.raises(TypeError, match="needs a filter with P0, covariances and step, got a "):
        each.step(each.model.x0, np.eye(each.model.n), np.ones(each.model.m))


def test_separate_filters_cannot_be_exchanged():
    with pytest.raises(AttributeError):
        mpt.Separate(KF, KF).filters = (KF,)


@pytest.mark.parametrize("make", [metrics.innovations, metrics.nis, metrics.log_likelihood])
@pytest.mark.parametrize("without", [AHEAD, FIR, mpt.JoinFilter(FIR, FIR), mpt.Separate(KF, FIR)])
def test_a_filter_without_covariances_has_no_innovations(make, without):
    with pytest.raises(TypeError, match="needs a filter with P0, covariances and step, got a "):
        make(without, np.zeros((4, without.model.m)))


def test_rounding_is_no_bad_input():
    model = mpt.LinearModel(F=EYE, H=[[1.0, 0.0]], Q=[[1.0, 1 + 4e-16], [1.0, 1.0]], R=[[1e-30]])
    assert model.Q[0, 1] > model.Q[1, 0]


def test_there_are_hundreds_of_cases():
    assert sum(len(case.values[-1]) for case in REFUSED) > 600


class NullableColumn:
    """A pandas DataFrame of type Float64 as it shows itself: objects, NA where a number is missing."""

    def __init__(self, values):
        self.values = values

    def __array__(self, dtype=None, copy=None):
        return np.array(self.values, dtype=object)

    def to_numpy(self, dtype=object, na_value=None):
        return np.array([[na_value if value is None else value for value in row] for row in self.values], dtype=dtype)


def test_a_nullable_column_of_pandas_is_taken():
    np.testing.assert_array_equal(KF.filter(NullableColumn([[1.0], [None], [2.0]])), KF.filter([[1.0], [NAN], [2.0]]))


def test_pandas_itself():
    pandas = pytest.importorskip("pandas")
    column = pandas.DataFrame({"z": pandas.array([1.0, None, 2.0], dtype="Float64")})
    np.testing.assert_array_equal(KF.filter(column), KF.filter([[1.0], [NAN], [2.0]]))
    np.testing.assert_array_equal(KF.filter(column.astype(float)), KF.filter([[1.0], [NAN], [2.0]]))


class Times:
    """Times with a zone as pandas shows them; it also turns them into whole numbers since 1970."""

    def __array__(self, dtype=None, copy=None):
        return np.array([datetime(2024, 1, 1, tzinfo=UTC), datetime(2024, 1, 2, tzinfo=UTC)], dtype=object)

    def to_numpy(self, dtype=object, na_value=None):
        return np.array([1.7e18, 1.8e18], dtype=dtype)


class Texts(Times):
    """A column of texts that are numbers."""

    def __array__(self, dtype=None, copy=None):
        return np.array(["1", "2"], dtype=object)


@pytest.mark.parametrize("name", ["t", "r"])
def test_what_a_column_only_turns_into_numbers_is_refused(name):
    with pytest.raises(TypeError, match=f"{name}: needs .* got an array of objects of type str"):
        mpt.KalmanFilter(CV, **{name: Texts()})


def test_a_column_of_dates_is_taken_for_times_and_for_nothing_else():
    np.testing.assert_array_equal(mpt.KalmanFilter(CV, t=Times()).t, [0, 86400])
    with pytest.raises(TypeError, match=r"r: needs .* got an array of objects of type datetime"):
        mpt.KalmanFilter(CV, r=Times())


def chained(error):
    return error.__context__ is not None and not error.__suppress_context__


@pytest.mark.parametrize(
    ("call", "got"),
    [
        (lambda: mpt.gsm_axis(1.0, timedelta(seconds=1), 0.1), "q: .*got datetime.timedelta(seconds=1)"),
        (lambda: mpt.gsm_axis(1.0, np.timedelta64(1, "s"), 0.1), "q: .*got np.timedelta64(1,'s')"),
        (lambda: mpt.gsm_axis(1.0, 0.01, Decimal(1)), "r: needs a positive number, got Decimal('1')"),
        (lambda: KF.filter(None), "z: needs .* of numbers, NaN where one is missing, got None"),
        (lambda: KF.filter([[1.0], [None]]), "z: .*got an array of objects of type NoneType, float"),
        (lambda: KF.filter(np.array([[1.0]], object)), "z: .*got an array of objects of type float"),
        (lambda: KF.filter([[timedelta(1)]]), "z: .*got an array of objects of type timedelta"),
        (lambda: KF.filter([[np.datetime64("2020-06-25")]]), "z: .*got an array of datetime64[D] data"),
        (lambda: KF.filter([["1"]]), "z: .*got an array of <U1 data"),
        (lambda: KF.filter([[1.0], [1.0, 2.0]]), "z: .*got rows of different lengths"),
        (lambda: KF.filter(np.ma.masked_equal([[1.0], [2.0]], 2)), "z: .*got a masked array (its filled(np.nan) has"),
        (lambda: mpt.mean_track(CV, "3"), "N: needs an integer of at least 1, got '3'"),
        (lambda: mpt.gsm_axis(10**400, 0.01, 0.1), "dt: needs a positive number, got 1000"),
    ],
)
def test_what_was_got_is_said_without_what_led_there(call, got):
    with pytest.raises((TypeError, ValueError)) as raised:
        call()
    assert re.match(re.escape(got).replace(r"\.\*", ".*"), str(raised.value)), raised.value
    assert not chained(raised.value)


class Column:
    """A column of texts, as pandas has them."""

    def __array__(self, dtype=None, copy=None):
        return np.array([["a"]], object)

    def to_numpy(self, dtype, na_value):
        raise ValueError("could not convert string to float: 'a'")


def test_a_column_of_texts_is_refused_by_the_name_of_the_argument():
    with pytest.raises(TypeError, match=r"z: .*got an array of objects of type str"):
        KF.filter(Column())
