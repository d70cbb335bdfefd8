"""Refuse bad input by name, before anything is computed."""

import operator
from collections.abc import Iterable
from numbers import Real

import numpy as np

# Entries of a scaled covariance are of order one and come out of a few products of doubles: asymmetry or negative
# eigenvalues below this are rounding, above it they are a mistake.
ROUNDING = 1e-12
COMPUTED = 1e-6  # the same for a covariance that a solver made, of a model at the edge of double precision


def refuse(name, need, got, error=ValueError):
    """Raise `error` with a message that names the argument, what it needs and what it got."""
    raise error(f"{name}: needs {need}, got {got}")


def number(name, value, need="a number", accept=lambda value: True):
    """Return a finite real scalar as a float, or raise.

    `accept` says whether a finite value is one that the argument can take, and `need` says it in words.

    >>> number("dt", 1, "a positive number", lambda value: value > 0)
    1.0
    >>> number("dt", 0, "a positive number", lambda value: value > 0)
    Traceback (most recent call last):
    ...
    ValueError: dt: needs a positive number, got 0
    """
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, Real):
        refuse(name, need, brief(value), TypeError)
    try:
        result = float(value)
    except OverflowError:
        result = np.inf
    if not (np.isfinite(result) and accept(result)):
        refuse(name, need, brief(value))
    return result


def positive(name, value):
    """Return a positive number as a float, or raise."""
    return number(name, value, "a positive number", lambda value: value > 0)


def not_negative(name, value):
    """Return a number that is not negative as a float, or raise."""
    return number(name, value, "a number that is not negative", lambda value: value >= 0)


def brief(value):
    """Return a value as text, and a long one as its type and beginning."""
    return repr(value) if len(repr(value)) <= 60 else kind_of(value)


def kind_of(value):
    """Return the type of a value, and its beginning as text."""
    return f"{type(value).__name__} {value!r:.40}"


def count(name, value, least=1):
    """Return an integer of at least `least`, or raise.

    >>> count("N", 0)
    Traceback (most recent call last):
    ...
    ValueError: N: needs an integer of at least 1, got 0
    """
    need = f"an integer of at least {least}"
    try:
        value = operator.index(None if isinstance(value, (bool, np.bool_)) else value)
    except TypeError:
        refuse(name, need, brief(value), TypeError)
    if value < least:
        refuse(name, need, value)
    return value


def instance(name, value, kind):
    """Return `value` if it is a `kind`, or one of several, or raise a TypeError."""
    if not isinstance(value, kind):
        need = " or ".join(f"a {each.__name__}" for each in (kind if isinstance(kind, tuple) else (kind,)))
        refuse(name, need, kind_of(value), TypeError)
    return value


def function(name, value, need):
    """Return `value` if it can be called, or raise a TypeError."""
    if not callable(value):
        refuse(name, need, kind_of(value), TypeError)
    return value


def several(name, value, need, least=1):
    """Return the elements of anything that has some, a text excepted, as a tuple, or raise.

    >>> several("truths", "xy", "motions")
    Traceback (most recent call last):
    ...
    TypeError: truths: needs motions, got 'xy'
    """
    if isinstance(value, (str, bytes)) or not isinstance(value, Iterable) or getattr(value, "shape", None) == ():
        refuse(name, need, brief(value), TypeError)
    value = tuple(value)
    if len(value) < least:
        refuse(name, need, "none" if not value else len(value))
    return value


def one_of(name, value, choices):
    """Return `value` if it is one of some numbers and texts, or raise.

    >>> one_of("unit", "per mille", ("fraction", "percent"))
    Traceback (most recent call last):
    ...
    ValueError: unit: needs fraction or percent, got 'per mille'
    """
    need = " or ".join(map(str, choices))
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (str, Real)):
        refuse(name, need, brief(value), TypeError)
    if value not in choices:
        refuse(name, need, brief(value))
    return value


def numbers(name, value, need):
    """Return an array of real numbers, `value` itself if it is one (NaN and infinity allowed), or raise."""
    if isinstance(value, np.ma.MaskedArray):
        refuse(name, f"{need} without a mask (a missed epoch is a row of NaN)", "a masked array", TypeError)
    try:
        array = np.asarray(value)
    except ValueError:
        refuse(name, need, "rows of different lengths")
    if array.dtype.kind not in "iuf":
        refuse(name, f"{need} of real numbers", f"an array of {array.dtype} data", TypeError)
    return array


def real(name, value, need):
    """Return a new float array of real numbers (NaN allowed), or raise; `need` says what is needed, in words."""
    # A copy: what the caller does to his array later is his affair. In C order: products round by the memory layout.
    with np.errstate(over="ignore"):  # of what is longer than a double: it is infinite here
        array = numbers(name, value, need).astype(float, order="C")
    if np.isinf(array).any():
        refuse(name, f"{need} of finite numbers", "an infinite value")
    return array


def finite(name, value, *shapes):
    """Return a float array of finite numbers, or raise; in the shapes that it may have a text stands for any length.

    >>> finite("truth", [1.0, 2.0], ("N", 2), ("N", 3))
    Traceback (most recent call last):
    ...
    ValueError: truth: needs an (N, 2) or (N, 3) array, got shape (2,)
    """
    need = "an " + " or ".join(map(str, shapes)).replace("'", "") + " array" if shapes else "numbers"
    result = real(name, value, need)
    if not result.size or (shapes and not any(_fits(result.shape, shape) for shape in shapes)):
        refuse(name, need, f"shape {result.shape}" if result.ndim else "a scalar")
    if np.isnan(result).any():
        refuse(name, f"{need} of finite numbers", "NaN")
    return result


def _fits(have, want):
    return len(have) == len(want) and all(isinstance(w, str) or h == w for h, w in zip(have, want, strict=True))


def array(name, value, shape):
    """Return a read-only float array of exactly this shape without NaN, or raise.

    >>> array("F", 5.0, (2, 2))
    Traceback (most recent call last):
    ...
    ValueError: F: needs a 2×2 matrix, got a scalar
    """
    words = {1: "a vector of length {}", 2: "a {}×{} matrix"}
    need = words[len(shape)].format(*shape)
    result = real(name, value, need)
    if result.shape != tuple(shape):
        refuse(name, need, f"shape {result.shape}" if result.ndim else "a scalar")
    if np.isnan(result).any():
        refuse(name, f"{need} of finite numbers", "NaN")
    result.flags.writeable = False
    return result


def matrix(name, value, need="a matrix"):
    """Return a read-only float matrix of any shape without NaN, or raise."""
    result = real(name, value, need)
    if result.ndim != 2 or 0 in result.shape:
        refuse(name, need, f"shape {result.shape}" if result.ndim else "a scalar")
    return array(name, result, result.shape)


def covariance(name, value, size, definite=False, rounding=ROUNDING):
    """Return a symmetric positive semidefinite (or definite) matrix of this size, up to rounding, or raise.

    The eigenvalues looked at are those of the correlation matrix, so that variances of very different size pass.

    >>> covariance("R", [[0.0]], 1, definite=True)
    Traceback (most recent call last):
    ...
    ValueError: R: needs a symmetric positive definite 1×1 matrix, got an eigenvalue of 0 (scaled to unit variances)
    """
    need = f"a symmetric positive {'definite' if definite else 'semidefinite'} {size}×{size} matrix"
    result = array(name, value, (size, size))
    variance = np.diag(result)
    if variance.min() < -(rounding**2) * variance.max() or variance.max() < 0:  # rounding is that of a sigma
        refuse(name, need, f"a variance of {variance.min():.6g}")
    scale = np.sqrt(np.maximum(variance, 0))
    scale = np.where(scale > 0, scale, 1)
    with np.errstate(over="ignore"):
        scaled = result / scale[:, None] / scale
    if not np.isfinite(scaled).all():
        refuse(name, need, "a covariance far larger than the variances allow")
    if np.abs(scaled - scaled.T).max() > rounding:
        refuse(name, need, "a matrix that is not symmetric")
    lowest = np.linalg.eigvalsh(scaled)[0]
    if lowest < -rounding or (definite and lowest <= rounding):
        refuse(name, need, f"an eigenvalue of {lowest:.6g} (scaled to unit variances)")
    return result
