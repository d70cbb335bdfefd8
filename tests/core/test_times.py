"""Times are taken for what they are: dates, lengths of time, numbers of seconds. What cannot be seconds is refused."""

import itertools
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pytest

import mpt_helpers as mpt
from reproduction.lasting import lasting_error

MODEL = mpt.constant_velocity(1.0, 0.04, 0.5, P0=np.eye(2))
SECONDS = np.array([0.0, 1.5, 4.0, 64.25])
Z = np.array([[0.1], [0.9], [np.nan], [3.0]])
BEGIN = datetime(2024, 5, 3, 12, 0, 10)
DATES = [BEGIN + timedelta(seconds=s) for s in SECONDS]
IN_BELGRADE = timezone(timedelta(hours=2))
# One row of each kind of times: a function of dates without a zone.
KINDS = {
    "datetimes": list,
    "datetimes of a zone": lambda dates: [each.replace(tzinfo=UTC) for each in dates],
    "datetimes of two zones": lambda dates: [
        each.replace(tzinfo=UTC).astimezone(zone)
        for each, zone in zip(dates, itertools.cycle([UTC, IN_BELGRADE]), strict=False)
    ],
    "an array of objects": lambda dates: np.array(dates, object),
    "datetime64[ms]": lambda dates: np.array(dates, "datetime64[ms]"),
    "datetime64[ns]": lambda dates: np.array(dates, "datetime64[ns]"),
    "datetime64 in a list": lambda dates: list(np.array(dates, "datetime64[us]")),
    "timedeltas": lambda dates: [each - dates[0] for each in dates],
    "timedeltas of two kinds": lambda dates: [dates[0] - dates[0], *(np.timedelta64(d - dates[0]) for d in dates[1:])],
    "timedelta64": lambda dates: np.array(dates, "datetime64[ms]") - np.datetime64(dates[0], "ms"),
    "Unix seconds": lambda dates: [each.replace(tzinfo=UTC).timestamp() for each in dates],
}
OF_PANDAS = {
    "index": lambda pd, dates: pd.DatetimeIndex(dates),
    "index with a zone": lambda pd, dates: pd.DatetimeIndex(dates, tz="UTC"),
    "series": lambda pd, dates: pd.Series(dates, index=np.arange(len(dates)) + 7),
    "series with a zone": lambda pd, dates: pd.Series(pd.DatetimeIndex(dates, tz="UTC")),
    "Timestamps": lambda pd, dates: [pd.Timestamp(each, tz="UTC") for each in dates],
    "timedeltas": lambda pd, dates: pd.Series(dates) - dates[0],
}


def same_as_in_seconds(t):
    by_seconds, by_dates = (mpt.KalmanFilter(MODEL, t=each) for each in (SECONDS, t))
    # Unix seconds are rounded to 2e-7 s.
    np.testing.assert_allclose(by_dates.filter(Z), by_seconds.filter(Z), rtol=1e-6)
    np.testing.assert_allclose(np.diff(by_dates.t), np.diff(SECONDS), atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_dates_are_taken_for_what_they_are(kind):
    same_as_in_seconds(KINDS[kind](DATES))


@pytest.mark.parametrize("kind", OF_PANDAS)
def test_times_of_pandas_are_taken_for_what_they_are(kind):
    same_as_in_seconds(OF_PANDAS[kind](pytest.importorskip("pandas"), DATES))


def test_tracks_with_dates_of_their_own_are_columns():
    t = np.array([DATES, [each + timedelta(days=9) for each in DATES]], "datetime64[ms]").T
    kf = mpt.KalmanFilter(MODEL, t=t)
    np.testing.assert_allclose(
        kf.filter(np.stack([Z, Z], axis=-1))[..., 1], mpt.KalmanFilter(MODEL, t=SECONDS).filter(Z)
    )


def lengths(seconds):
    pandas = pytest.importorskip("pandas")
    return [timedelta(seconds=seconds), np.timedelta64(round(1e3 * seconds), "ms"), pandas.Timedelta(seconds=seconds)]


@pytest.mark.parametrize("i", range(3))
def test_a_length_of_time_is_taken_for_what_it_is(i):
    """In dt= of a model and of a step, and as a horizon."""
    length = lengths(1.5)[i]
    for make in (mpt.constant_velocity, mpt.constant_acceleration, mpt.gsm_axis):
        assert make(dt=length, q=0.1, r=0.2) == make(dt=1.5, q=0.1, r=0.2)
    assert mpt.gps_ins(length, 0.1, (1.0, 0.1)) == mpt.gps_ins(1.5, 0.1, (1.0, 0.1))
    model = mpt.LinearModel(transition=MODEL.transition, H=MODEL.H, R=MODEL.R, dt=length)
    assert model.dt == 1.5
    kf = mpt.KalmanFilter(MODEL, t=SECONDS)
    both = mpt.Separate(kf, kf)
    for each, z in ((kf, [1.0]), (both, [1.0, 2.0])):
        x, P = each.model.x0, each.P0
        for got, due in zip(each.step(x, P, z, dt=length), each.step(x, P, z, dt=1.5), strict=True):
            np.testing.assert_array_equal(got, due)
    a, due = (mpt.metrics.ahead(kf, Z, seconds) for seconds in (length, 1.5))
    np.testing.assert_array_equal(a.errors, due.errors)
    assert a.seconds == 1.5
    assert mpt.bands.LiveBand(kf, length).seconds == 1.5
    assert lasting_error(mpt.gsm_axis(1.5, 0.1, 0.2), 1.0, 60.0, dt=length).n == 3


UNIX = 1.7e9 + np.arange(4)
REFUSED = {
    "forgotten: all are equal": ([5.0, 5.0, 5.0, 5.0], "t: needs times of which some differ, got 5 in all 4 rows"),
    "Unix milliseconds": (
        1e3 * UNIX,
        "t: needs times in seconds, got 1700000003000, as of Unix milli-, micro- or nano",
    ),
    "Unix nanoseconds": ((1e9 * UNIX).astype(np.int64), "t: needs times in seconds, .* as of Unix milli-"),
    "too large for all": (1e25 * UNIX, "t: needs times in seconds, got 1.7"),
    "float32, 128 s apart": (
        np.float32(1.7e9 + 100 * np.arange(4)),
        "t: needs times as float64, or from the first, got float32",
    ),
    "NaT": (np.array(["2024-05-03", "NaT"], "datetime64[s]"), "t: needs .*got NaN"),
    "NaT first": (np.array(["NaT", "2024-05-03"], "datetime64[s]"), "t: needs .*got NaN"),
    "back in time": (DATES[::-1], r"t: needs .*got -60.25 after 0, in row 1"),
    "with a zone and without": (
        [DATES[0], DATES[1].replace(tzinfo=UTC)],
        "t: needs .*got dates that cannot be subtracted: can't subtract offset-naive and",
    ),
    "dates, then numbers": ([DATES[0], 5.0], "t: needs .*got dates that cannot be subtracted: unsupported operand"),
    "dates, then none": ([DATES[0], None], "t: needs .*got dates that cannot be subtracted: unsupported operand"),
    "numbers, then dates": ([5.0, DATES[0]], "t: needs .*got an array of objects of type datetime, float"),
    "datetime64, then datetimes": (
        [np.datetime64(DATES[0]), DATES[1]],
        "t: needs .*got an array of objects of type datetime, datetime64",
    ),
    "lengths, then none": (
        [DATES[1] - DATES[0], None],
        "t: needs .*got an array of objects of type NoneType, timedelta",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_times_that_are_no_seconds_are_refused(name):
    t, words = REFUSED[name]
    with pytest.raises((TypeError, ValueError), match=words):
        mpt.KalmanFilter(MODEL, t=t)


@pytest.mark.parametrize("t", [np.float32([0, 0.5, 1e5, 1e5]), [1e9, 1e9, 1e9 + 1], [3.0, 3.0], np.int8([1, 2, 2])])
def test_times_that_may_be_seconds_are_taken(t):
    np.testing.assert_array_equal(mpt.KalmanFilter(MODEL, t=t).t, t)


@pytest.mark.parametrize(
    "dt", [DATES[0], np.datetime64("2024-05-03"), np.timedelta64("NaT", "s"), np.timedelta64(1, "M")]
)
def test_a_date_is_no_length_of_time(dt):
    with pytest.raises((TypeError, ValueError), match="dt: needs a number"):
        mpt.KalmanFilter(MODEL).step(MODEL.x0, MODEL.P0, [1.0], dt=dt)


def test_variances_that_are_missing_refuse_no_step():
    r = np.array([[np.nan, 0.1], [0.1, np.nan], [np.nan, 0.1]])
    two = replace(mpt.constant_velocity(1.0, 0.01, 0.1), H=[[1, 0], [1, 0]], R=0.1 * np.eye(2))
    z = np.where(np.isnan(r), np.nan, 1.0)
    assert np.isfinite(mpt.KalmanFilter(two, t=[0.0, 1e5, 2e5], r=r).filter(z)).all()


def test_separate_filters_of_two_dt_are_refused_when_they_are_made():
    one, two = (mpt.KalmanFilter(mpt.constant_velocity(dt, 0.01, 0.1)) for dt in (1.0, 2.0))
    with pytest.raises(ValueError, match=r"models of the same dt, got 1\.0 s and 1\.0 s and 2\.0 s"):
        mpt.Separate(one, one, two)
    of_any_dt = mpt.KalmanFilter(mpt.gsm_axis(1.0, 0.01, 0.1))
    assert mpt.Separate(of_any_dt, one).filter(np.zeros((2, 2))).shape == (2, 4)


@pytest.mark.parametrize(
    "call",
    [
        lambda: mpt.constant_velocity(1, 1e308, 1),
        lambda: mpt.KalmanFilter(mpt.constant_velocity(1, 0.01, 0.1), t=[-1.7e308, 1.7e308]),
        lambda: mpt.KalmanFilter(mpt.constant_velocity(1, 0.01, 0.1), t=[1, 1e110]),
    ],
    ids=["q", "t", "t 1e110"],
)
def test_the_largest_doubles_are_taken_or_refused_without_a_warning(call):
    with suppress(ValueError):
        call()  # a warning is an error in these tests
