import numpy as np
import pytest

from mpt_helpers import burden
from mpt_helpers.burden import Polynomial


class Counted(float):
    """A number that counts the multiplications and additions done with it."""

    operations = 0

    def __mul__(self, other):
        Counted.operations += 1
        return Counted(float(self) * float(other))

    def __add__(self, other):
        Counted.operations += 1
        return Counted(float(self) + float(other))


def counted(*shape):
    """An array of numbers that count."""
    Counted.operations = 0
    array = np.empty(shape, dtype=object)
    for index in np.ndindex(shape):
        array[index] = Counted(1.5)
    return array


@pytest.mark.parametrize("axes", [1, 2, 3])
def test_a_steady_state_step_takes_as_many_operations_as_its_burden_says(axes):
    n, m = 2 * axes, axes
    A, B, x, z = counted(n, n), counted(n, m), counted(n, 1), counted(m, 1)
    A.dot(x) + B.dot(z)
    assert Counted.operations == burden.steady_state(n, m)


@pytest.mark.parametrize("axes", [1, 2, 3])
def test_an_fir_estimate_takes_as_many_operations_as_its_burden_says(axes):
    n, m, M = 2 * axes, axes, 17
    taps, z = counted(M, n, m), counted(M, m, 1)
    terms = [tap.dot(z_k) for tap, z_k in zip(taps, z, strict=True)]
    total = terms[0]
    for term in terms[1:]:
        total = total + term
    assert Counted.operations == burden.fir(n, m, M=M)


@pytest.mark.parametrize(
    ("count", "formula"),
    [
        (burden.kalman, lambda n, m: 4 * n**3 + 3.5 * n**2 - 1.5 * n + 4 * n**2 * m + n * m + 3 * n * m**2
         + (16 * m**3 - 3 * m**2 - m) / 6),
        (burden.lainiotis, lambda n, m: 4 * n * m + (58 * n**3 + 9 * n**2 - 7 * n) / 6),
        (burden.join, lambda n, m: n**2 + 3 * n),
        (burden.steady_state, lambda n, m: 2 * n**2 + 2 * n * m - n),
        (burden.join_steady_state, lambda n, m: 2 * n),
    ],
    ids=["KF", "LF", "JKLF", "SSKF", "JSSKLF"],
)  # fmt: skip
def test_itemised_burdens_equal_the_printed_formulas(count, formula):
    for n in range(1, 9):
        for m in range(1, 9):
            assert count(n, m) == pytest.approx(formula(n, m), rel=1e-14)


def test_polynomials_are_exact():
    n, m = burden.n, burden.m
    assert (n + m) * (n - m) == n * n - m * m
    assert (n / 3 + n / 6) == n / 2
    assert n - n == 0
    assert repr(n - n) == "0"
    assert repr(-1 * n + 2) == "-n + 2"
    assert n / 3 != n / 2


@pytest.mark.parametrize("text", ["2n² - n", "4nm + (58n³ + 9n² - 7n)/6", "n² + 3n", "-n", "(M - 1)n + 40", "7"])
def test_formulas_are_read_as_they_are_printed(text):
    python = text.replace("²", "**2").replace("³", "**3").replace("nm", "n*m").replace(")n", ")*n")
    for digit in "0123456789":
        python = python.replace(f"{digit}n", f"{digit}*n")
    values = {"n": 3, "m": 5, "M": 7}
    assert Polynomial.parse(text)(**values) == eval(python, values)


@pytest.mark.parametrize("text", ["", "2n +", "n^2)", "x*", "2n 3", "(n", "n/2"])
def test_what_is_no_formula_is_refused(text):
    with pytest.raises(ValueError, match="text: needs a formula"):
        Polynomial.parse(text)
