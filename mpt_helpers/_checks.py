"""Checks of user input where it enters the package; the code behind does not check it again.

There is a check where bad input would silently give a wrong number, or where the error would not name the argument.
"""

from __future__ import annotations

import math
import operator
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
from datetime import datetime, timedelta
from numbers import Real
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf

Array = NDArray[np.float64]  # what a model holds and what a filter returns
Seconds = float | timedelta | np.timedelta64  # a length of time; a number is one of seconds

# A covariance at unit variances has entries of order one: asymmetry or negative eigenvalues below this are rounding.
ROUNDING = 1e-12
# Tolerance of gains and covariances from a Riccati equation, relative to their size or to the standard deviations: at
# the limits of double precision a solver leaves six digits.
SOLVED = 1e-6
TINY = np.finfo(float).tiny
LATEST_TIME = 1e11  # s, 3,000 years: larger numbers are Unix milli-, micro- or nanoseconds


def refuse(name: str, need: str, got: object, error: type[Exception] = ValueError) -> NoReturn:
    """Raise an error that names the argument, what it needs and what it got."""
    raise error(f"{name}: needs {need}, got {got}") from None


def warn(text: str) -> None:
    """Warn at the user's line that called into this package, however deep inside it the warning arises."""
    frame, level = sys._getframe(1), 2
    while frame is not None and (frame.f_globals.get("__package__") or "").partition(".")[0] == __package__:
        frame, level = frame.f_back, level + 1
    warnings.warn(text, UserWarning, stacklevel=level)


def instance(name: str, value: object, kind: type) -> None:
    """Refuse a value that is not a `kind`."""
    if not isinstance(value, kind):
        refuse(name, f"a {kind.__name__}", f"a {type(value).__name__}", TypeError)


# Numbers.


def number(name: str, value: object, need: str, accept: Callable[[float], bool]) -> float:
    """Return a finite real number that satisfies `accept`; `need` says in words what that is."""
    if not isinstance(value, Real) or isinstance(value, np.timedelta64):  # which counts as a Real
        refuse(name, need, f"{value!r:.60}", TypeError)
    try:
        as_float = float(value)
    except OverflowError:  # an integer beyond the range of doubles
        as_float = math.inf
    if not (math.isfinite(as_float) and accept(as_float)):
        refuse(name, need, f"{value!r:.60}")
    return as_float


def positive(name: str, value: object) -> float:
    """Return a positive number."""
    return number(name, value, "a positive number", lambda value: value > 0)


def not_negative(name: str, value: object) -> float:
    """Return a number that is not negative."""
    return number(name, value, "a number that is not negative", lambda value: value >= 0)


def level(value: object) -> float:
    """Return the nominal coverage of a band, between 0 and 1."""
    return number("level", value, "a number in (0, 1)", lambda value: 0 < value < 1)


def count(name: str, value: object, least: int = 1) -> int:
    """Return an integer of at least `least`."""
    need = f"an integer of at least {least}"
    try:
        whole = operator.index(value)
    except TypeError:
        refuse(name, need, f"{value!r:.60}", TypeError)
    if whole < least:
        refuse(name, need, whole)
    return whole


# Arrays.


def real_numbers(name: str, value: Any, need: str, *shapes: tuple[int | str, ...]) -> np.ndarray:
    """Return `value` as an array of real numbers, in one of the shapes if any is given; a letter is any size but 0.

    numpy would silently turn dates, strings and masks into numbers.
    """
    values = _as_array(name, value, need)
    if values.dtype == object and hasattr(value, "to_numpy") and any(isinstance(each, Real) for each in values.flat):
        with suppress(TypeError, ValueError):  # of numbers and texts
            values = value.to_numpy(dtype=float, na_value=np.nan)  # a pandas column of type Float64
    if values.dtype == object:
        kinds = ", ".join(sorted({type(each).__name__ for each in values.flat}))
        refuse(name, need, "None" if value is None else f"an array of objects of type {kinds}", TypeError)
    if values.dtype.kind not in "iuf":
        refuse(name, need, f"an array of {values.dtype} data", TypeError)
    if shapes and not any(_fits(values.shape, shape) for shape in shapes):
        refuse(name, need, f"shape {values.shape}")
    return values


def _fits(shape, wanted):
    """Tell whether an array has the wanted shape, in which a letter is any size but 0."""
    if len(shape) != len(wanted):
        return False
    return all(size > 0 if isinstance(want, str) else size == want for size, want in zip(shape, wanted, strict=True))


def _as_array(name, value, need):
    if isinstance(value, np.ma.MaskedArray):
        refuse(name, need, "a masked array (its filled(np.nan) has NaN where one is missing)", TypeError)
    try:
        return np.asarray(value)
    except ValueError:
        refuse(name, need, "rows of different lengths")


def array(name: str, value: object, shape: tuple[int, ...], finite: bool = True) -> Array:
    """Return a read-only copy of an array of real numbers of this shape, finite or with NaN."""
    need = f"a {shape} array of {'finite numbers' if finite else 'numbers'}"
    # In C order, since the rounding of a product depends on the memory layout.
    copy = real_numbers(name, value, need, shape).astype(float, order="C")
    wrong = ~np.isfinite(copy) if finite else np.isinf(copy)
    if wrong.any():
        refuse(name, need, "NaN or infinity" if finite else "infinity")
    copy.flags.writeable = False
    return copy


def rows(name: str, matrix: object) -> int:
    """Return how many rows a matrix has."""
    return len(real_numbers(name, matrix, "a matrix", ("rows", "columns")))


def covariance(name: str, value: object, size: int, definite: bool = False, tolerance: float = ROUNDING) -> Array:
    """Return a symmetric positive semidefinite (or definite) matrix of this size, judged at unit variances."""
    need = f"a symmetric positive {'definite' if definite else 'semidefinite'} {size}×{size} matrix"
    matrix = array(name, value, (size, size))
    variance = matrix.diagonal()
    # A variance of -tolerance² relative to the largest is a sigma wrong by `tolerance`.
    if variance.min() < -(tolerance**2) * max(variance.max(), 0):
        refuse(name, need, f"a variance of {variance.min():.6g}")
    sigma = np.sqrt(np.maximum(variance, 0))
    # Covariances with a component of zero variance can only be rounding: up to `tolerance` of the largest possible.
    unit = np.where(sigma > 0, sigma, np.sqrt(tolerance) * sigma.max() or TINY)
    with np.errstate(over="ignore"):
        scaled = np.clip(matrix / unit[:, None] / unit, -1e9, 1e9)
    lowest = np.linalg.eigvalsh(scaled)[0]
    if np.abs(scaled - scaled.T).max() > tolerance:
        refuse(name, need, "a matrix that is not symmetric")
    if lowest < -tolerance or (definite and lowest <= tolerance):
        refuse(name, need, f"an eigenvalue of {lowest:.6g} (at unit variances)")
    return matrix


def _is_finite_array(value, shape):
    """Tell, in less time than `array` takes, whether a value is an array of finite floats of this shape."""
    is_array = type(value) is np.ndarray and value.dtype == float and value.shape == shape
    return is_array and math.isfinite(np.vdot(value, value))  # the sum of squares is finite only if each number is


def state(x: Any, P: Any, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return x (n,) and P (n, n), a covariance, as arrays of finite floats."""
    if not (_is_finite_array(x, (n,)) and _is_finite_array(P, (n, n))):
        x, P = array("x", x, (n,)), array("P", P, (n, n))
    sigma = np.sqrt(np.abs(P.diagonal()))
    sigma += SOLVED**1.5 * max(sigma.tolist()) + TINY
    unit = P / sigma / sigma[:, None]
    asymmetry = unit - unit.T
    unit.flat[:: n + 1] += SOLVED
    _, failed_at = dpotrf(unit)  # LAPACK's Cholesky factor: there is none where an eigenvalue of P is below -SOLVED
    if failed_at or np.vdot(asymmetry, asymmetry) > SOLVED**2:
        refuse("P", "a symmetric positive semidefinite matrix", f"{P.tolist()!s:.80}")
    return x, P


# Measurements and their variances.


def measurements(z: Any, m: int, name: str = "z") -> Array:
    """Return measurements, NaN where one is missing, as floats (N, m) or (N, m, M); (N,) of one sensor is (N, 1).

    Infinite values pass; callers search for them with `no_infinity` if a result is not finite.
    """
    need = f"an (N, {m}) or (N, {m}, M) array of numbers, NaN where one is missing"
    of_one = [("N",)] if m == 1 else []
    values = real_numbers(name, z, need, ("N", m), ("N", m, "M"), *of_one)
    if values.ndim == 1:
        values = values[:, None]
    with np.errstate(over="ignore"):  # a long double beyond the range of doubles becomes infinite, and is refused
        return values.astype(float, copy=False)


def no_infinity(z: np.ndarray) -> None:
    """Refuse infinite measurements."""
    if np.isinf(z).any():
        refuse("z", "finite numbers, or NaN where a measurement is missing", "an infinite value")


def one_measurement(value: Any, m: int, name: str = "z_k") -> tuple[Array, np.ndarray]:
    """Return a measurement as a new vector (m,), NaN where it is missing, and which of its components are there."""
    z_k = value.copy() if _is_finite_array(value, (m,)) else array(name, value, (m,), finite=False)
    return z_k, ~np.isnan(z_k)


def variances(name: str, value: object, m: int) -> Array:
    """Return variances (N, m) or (N, m, M) as a read-only float array; `used_variances` checks their values."""
    values = measurements(value, m, name).copy(order="C")
    values.flags.writeable = False
    return values


def used_variances(name: str, values: np.ndarray, of: str = "measurement that is there") -> None:
    """Refuse variances that are not all positive and finite; `of` says what they belong to."""
    wrong = values[~((values > 0) & (values < np.inf))]
    if wrong.size:
        refuse(name, f"a positive variance of every {of}", f"{wrong[0]:g}")


def variances_of_one(name: str, value: object, seen: np.ndarray) -> Array:
    """Return the variances (m,) of one measurement, positive where it is there, as seen (m,) says."""
    need = f"a vector of {len(seen)} positive variances"
    values = real_numbers(name, value, need, seen.shape).astype(float)
    used_variances(name, values[seen])
    return values


# Times, and lengths of time.


def as_seconds(value: object) -> object:
    """Return timedeltas of Python, numpy or pandas, one or many, in seconds; anything else as it is."""
    values = np.asanyarray(value)
    if isinstance(next(values.flat, None), timedelta | np.timedelta64):
        with suppress(TypeError):  # of months and years, which have no length
            return np.asarray(values / np.timedelta64(1, "s"), float)[()]
    return value


def duration(name: str, value: object) -> float:
    """Return a positive length of time, a number of seconds or a timedelta, in seconds."""
    return positive(name, as_seconds(value))


def lengths(name: str, value: object) -> Array:
    """Return the lengths of steps, numbers of seconds or timedeltas, in seconds; they are not negative."""
    need = "finite lengths of time that are not negative"
    _as_array(name, value, need)
    seconds = real_numbers(name, as_seconds(value), need).astype(float, copy=False)
    if not ((seconds >= 0) & (seconds < np.inf)).all():
        refuse(name, need, f"{value!r:.60}")
    return seconds


def times(name: str, value: Any) -> Array:
    """Return times (N,) or (N, M) that do not decrease as a read-only array in seconds; dates count from the first."""
    need = "an (N,) or (N, M) array of finite times that do not decrease"
    values = _as_array(name, value, need)
    if values.dtype.kind == "M" or isinstance(next(values.flat, None), datetime):
        try:
            value = values - values.flat[:1]
        except TypeError as error:
            refuse(name, need, f"dates that cannot be subtracted: {error}", TypeError)
    values = real_numbers(name, as_seconds(value), need, ("N",), ("N", "M"))
    kind = values.dtype
    values = array(name, values, values.shape)
    with np.errstate(over="ignore"):  # such times are refused below
        steps, largest = np.diff(values, axis=0), np.abs(values).max()
    if (steps < 0).any():
        k = np.argwhere(steps < 0)[0][0]
        refuse(name, need, f"{values[k + 1].max():.15g} after {values[k].max():.15g}, in row {k + 1}")
    if largest > LATEST_TIME:
        refuse(name, "times in seconds", f"{largest:.15g}, as of Unix milli-, micro- or nanoseconds")
    if len(values) > 2 and not steps.any():
        refuse(name, "times of which some differ", f"{values.flat[0]:.15g} in all {len(values)} rows")
    shortest = min(steps[steps > 0], default=np.inf)
    # Times of 1.7e9 s in single precision are multiples of 128 s.
    if kind.kind == "f" and kind.itemsize < 8 and shortest < 2 * np.spacing(kind.type(largest)):
        refuse(name, "times as float64, or from the first", f"{kind}, which rounds {largest:.10g}")
    return values
