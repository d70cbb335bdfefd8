"""Operation counts: the formulas against filters that count what they do."""

from fractions import Fraction

import numpy as np
import pytest
from counting import Counted

from reproduction import burden
from reproduction.ledger import Item
from reproduction.papers_2014_2015 import table4


def counted(*shape):
    """An array of numbers that count."""
    Counted.done = 0
    array = np.empty(shape, dtype=object)
    for index in np.ndindex(shape):
        array[index] = Counted(1.5)
    return array


def sum_of_taps(taps, z):
    terms = [tap.dot(z_k) for tap, z_k in zip(taps, z, strict=True)]
    result = terms[0]
    for term in terms[1:]:
        result = result + term
    return result


@pytest.mark.parametrize("axes", [1, 2, 3])
def test_a_steady_state_step_takes_as_many_operations_as_its_burden_says(axes):
    n, m = 2 * axes, axes
    A, B, x, z = counted(n, n), counted(n, m), counted(n, 1), counted(m, 1)
    A.dot(x) + B.dot(z)
    assert Counted.done == burden.total(burden.steady_state(n, m))


@pytest.mark.parametrize("axes", [1, 2, 3])
def test_an_fir_estimate_takes_as_many_operations_as_its_burden_says(axes):
    n, m, M = 2 * axes, axes, 17
    sum_of_taps(counted(M, n, m), counted(M, m, 1))
    assert Counted.done == burden.total(burden.fir(n, m, M))


@pytest.mark.parametrize("axes", [1, 2, 3])
def test_several_steps_in_one_product_take_as_many_operations_as_their_burden_says(axes):
    n, m, M = 2 * axes, axes, 17
    A, x, taps, z = counted(n, n), counted(n, 1), counted(M, n, m), counted(M, m, 1)
    A.dot(x) + sum_of_taps(taps, z)
    assert Counted.done == burden.total(burden.lifted(n, m, M))


@pytest.mark.parametrize(
    ("operations", "formula"),
    [
        (burden.kalman, "4n³ + 3.5n² - 1.5n + 4n²m + nm + 3nm² + (16m³ - 3m² - m)/6"),
        (burden.lainiotis, "4nm + (58n³ + 9n² - 7n)/6"),
        (burden.join, "n² + 3n"),
        (burden.steady_state, "2n² + 2nm - n"),
        (burden.join_steady_state, "2n"),
    ],
    ids=["KF", "LF", "JKLF", "SSKF", "JSSKLF"],
)
def test_itemised_burdens_equal_the_printed_formulas(operations, formula):
    judged = burden.formula(operations, formula)
    assert judged(formula)[0]
    for wrong in (f"{formula} + 1", f"{formula} - (n - m)/1000"):
        assert judged(wrong)[:2] == (False, formula)
    with pytest.raises(ValueError, match="right: needs a formula that is the sum"):
        burden.formula(operations, f"{formula} + 1")


@pytest.mark.parametrize("text", ["2n² - n", "4nm + (58n³ + 9n² - 7n)/6", "n² + 3n", "-n", "(M - 1)n + 40", "7"])
def test_formulas_are_read_as_they_are_printed(text):
    python = text.replace("²", "**2").replace("³", "**3").replace("nm", "n*m").replace(")n", ")*n")
    for digit in "0123456789":
        python = python.replace(f"{digit}n", f"{digit}*n")
    values = {"n": 3, "m": 5, "M": 7}
    assert burden.value(text, **values) == eval(python, values)


@pytest.mark.parametrize(
    ("text", "got"),
    [
        ("", "''"),
        ("2n +", r"'2n \+'"),
        ("n^2", r"'\^' in 'n\^2'"),
        ("n)", r"'n\)'"),
        ("2n 3", "'2n 3'"),
        ("(n", r"'\(n'"),
        ("n²²", "'²' in 'n²²'"),
        ("x", "'x' in 'x'"),
        ("n.real", r"'\.' in 'n.real'"),
        ("print(n)", "'p' in"),
        ("__import__('os')", "'_' in"),
        ("9**9", r"'\*' in"),
    ],
)
def test_what_is_no_formula_is_refused(text, got):
    """Nothing but numbers, the letters, brackets and operators of the papers is ever evaluated."""
    with pytest.raises(ValueError, match=f"formula: needs .*, got {got}"):
        burden.value(text, n=2, m=1)


def test_a_quotient_is_exact_and_taken_from_the_left():
    assert burden.value("n/3m", n=1, m=2) == Fraction(2, 3)
    assert burden.value("0.1n/(n + m)", n=1, m=2) == Fraction(1, 30)


@pytest.mark.parametrize("axes", [2, 3])
def test_model_b_is_one_filter_for_each_axis(axes):
    twelve, one = burden.twelve(axes), burden.twelve(axes=1)
    for name in ("KF", "LF", "JKLF", "SSKF", "SSLF", "JSSKLF"):
        assert one[f"{name} A"] == one[f"{name} B"]
        assert twelve[f"{name} B"] == axes * one[f"{name} B"] < twelve[f"{name} A"]


def numbers_behind(ratios, known):
    """From which numbers a table of ratios, {(i, j): text}, was made."""
    cells = {pair: Item("id", "where", "number", printed) for pair, printed in ratios.items()}
    return table4.numbers_behind(cells, known)


def test_the_numbers_behind_ratios_are_all_that_fit():
    secret = {1: 509, 2: 1191, 3: 44, 4: 640}
    ratios = {(i, j): f"{secret[i] / secret[j]:.3f}" for i in secret for j in secret if i != j}
    assert numbers_behind(ratios, known={1: 509, 3: 44}) == {2: [1191], 4: [640]}
    ties = numbers_behind({(1, 2): "0.50"}, known={1: 1000})[2]
    assert ties == [number for number in range(1, 10_001) if 0.495 <= 1000 / number <= 0.505]
    assert numbers_behind({(2, 1): "2.00", (1, 2): "?"}, known={1: 1000})[2] == list(range(1995, 2006))
    assert numbers_behind(ratios | {(2, 1): "2.341"}, known={1: 509, 3: 44})[2] == []
