"""The papers' calculation burdens (2014 and 2015 Table 2, 2016 Table 2), itemised operation by operation.

A burden is the number of scalar additions, multiplications and divisions of one iteration. Each filter is a function of
n, the dimension of the state, and m, that of the measurement; it returns a list of (operation, burden).

2014 and 2015 print totals only. 2016 itemises one filter, with full matrix products (`product`). We infer the rest, and
it gives exactly the printed totals: of a symmetric result only the upper triangle is computed, and inversion costs
`inverse`.
"""

import itertools
import re
from fractions import Fraction

from mpt_helpers import _checks as checks

# What Python writes for what the papers do; these and numbers are all that is evaluated of a formula.
OPERATORS = {"+": "+", "-": "-", "/": "/", "(": "(", ")": ")", "²": "**2", "³": "**3"}
FACTORS_END = tuple("0123456789)²³")


def product(p, q, r):
    """(p×q)·(q×r): each of p r entries takes q multiplications and q - 1 additions.

    >>> product(4, 4, 1)
    28
    """
    return p * r * (2 * q - 1)


def symmetric_product(p, q):
    """(p×q)·(q×p) with a symmetric result: p (p + 1) / 2 entries."""
    return p * (p + 1) // 2 * (2 * q - 1)


def symmetric_sum(p):
    """(p×p) + (p×p) with a symmetric result, or a symmetric (p×p) matrix times a number."""
    return p * (p + 1) // 2


def inverse(p):
    """(p×p)⁻¹: the bracket (16p³ - 3p² - p)/6 of the printed total of the Kalman filter."""
    return (16 * p**3 - 3 * p**2 - p) // 6


def kalman(n, m):
    """Return the operations of one step of the Kalman filter (2014 Eq. 4).

    >>> total(kalman(n=4, m=2))
    509
    """
    return [
        ("F x(k/k)", product(n, n, 1)),
        ("F P(k/k)", product(n, n, n)),
        ("F P(k/k) · Fᵀ", symmetric_product(n, n)),
        ("P(k+1/k) = GQGᵀ + F P(k/k) Fᵀ", symmetric_sum(n)),
        ("H P(k+1/k)", product(m, n, n)),
        ("H P(k+1/k) · Hᵀ", symmetric_product(m, n)),
        ("H P(k+1/k) Hᵀ + R", symmetric_sum(m)),
        ("[H P(k+1/k) Hᵀ + R]⁻¹", inverse(m)),
        ("K = P(k+1/k) Hᵀ · [H P(k+1/k) Hᵀ + R]⁻¹", product(n, m, m)),
        ("K H", product(n, m, n)),
        ("I - K H", n),
        ("[I - K H] x(k+1/k)", product(n, n, 1)),
        ("K z(k+1)", product(n, m, 1)),
        ("x(k+1/k+1) = [I - K H] x(k+1/k) + K z(k+1)", n),
        ("P(k+1/k+1) = [I - K H] P(k+1/k)", symmetric_product(n, n)),
    ]


def kalman_columns(n, m, axes):
    """Return the operations of one Kalman step for several axes that share P and K, side by side as columns.

    P and K are made once; what contains x or z is done for each axis.

    >>> total(kalman_columns(n=2, m=1, axes=3)), 3 * total(kalman(n=2, m=1))
    (101, 207)
    """
    operations = []
    for name, burden in kalman(n, m):
        of_each_axis = "x(k" in name or "z(k" in name
        operations.append((name, axes * burden if of_each_axis else burden))
    return operations


def lainiotis(n, m):
    """Return the operations of one step of the Lainiotis filter (2014 Eqs. 5-6); the matrices of Eq. 7 are known.

    >>> total(lainiotis(n=4, m=2))
    670
    """
    return [
        ("P(k/k) Oₙ", product(n, n, n)),
        ("I + P(k/k) Oₙ", n),
        ("[I + P(k/k) Oₙ]⁻¹", inverse(n)),
        ("A = Fₙ · [I + P(k/k) Oₙ]⁻¹", product(n, n, n)),
        ("Kₙ z(k+1)", product(n, m, 1)),
        ("Kₘ z(k+1)", product(n, m, 1)),
        ("P(k/k) · Kₘ z(k+1)", product(n, n, 1)),
        ("P(k/k) Kₘ z(k+1) + x(k/k)", n),
        ("A · [P(k/k) Kₘ z(k+1) + x(k/k)]", product(n, n, 1)),
        ("x(k+1/k+1) = Kₙ z(k+1) + A [P(k/k) Kₘ z(k+1) + x(k/k)]", n),
        ("A · P(k/k)", product(n, n, n)),
        ("A P(k/k) · Fₙᵀ", symmetric_product(n, n)),
        ("P(k+1/k+1) = Pₙ + A P(k/k) Fₙᵀ", symmetric_sum(n)),
    ]


def join(n, m):
    """Return the operations that average two filters (2014 Eq. 8)."""
    return [
        ("x_KF + x_LF", n),
        ("½ (x_KF + x_LF)", n),
        ("P_KF + P_LF", symmetric_sum(n)),
        ("½ (P_KF + P_LF)", symmetric_sum(n)),
    ]


def steady_state(n, m):
    """Return the operations of one step of either steady-state filter (2014 Eqs. 9 and 12)."""
    return [
        ("A x(k/k)", product(n, n, 1)),
        ("B z(k+1)", product(n, m, 1)),
        ("x(k+1/k+1) = A x(k/k) + B z(k+1)", n),
    ]


def join_steady_state(n, m):
    """Return the operations that average two steady-state filters, which have no covariances (2014 Eq. 16)."""
    return [("x_SSKF + x_SSLF", n), ("½ (x_SSKF + x_SSLF)", n)]


def prediction(n, m):
    """Return the operations of one prediction (2016 Eq. 19; its Table 2 prints x(k/k-1) and z(k+1))."""
    return [
        ("A_N x(k+N-1/k-1)", product(n, n, 1)),
        ("B_N z(k)", product(n, m, 1)),
        ("x(k+N/k) = A_N x(k+N-1/k-1) + B_N z(k)", n),
    ]


def fir(n, m, M):
    """Return the operations of one FIR estimate, Aʲ B known (2014 Eq. 22; Table 5 prints another formula)."""
    return [("AʲB z(k-j) for j = 0 ... M-1", M * product(n, m, 1)), ("their sum", (M - 1) * n)]


def lifted(n, m, M):
    """Return the operations of M steps of the steady-state filter as one product, Aᴹ and Aʲ B known (2014 Eq. 21)."""
    return [("Aᴹ x(k-M/k-M)", product(n, n, 1)), *fir(n, m, M), ("the sum of both", n)]


def total(operations):
    """Return the sum of the burdens of some operations."""
    return sum(burden for _, burden in operations)


def twelve(axes):
    """Return the total of each implementation of 2014 and 2015 Table 1, by its name and in the order of the table.

    Model A is one filter of all axes, model B one filter for each axis.

    >>> twelve(axes=2)["JKLF B"]
    336
    """
    totals = {}
    for model, n, m, filters in (("A", 2 * axes, axes, 1), ("B", 2, 1, axes)):
        kf, lf, ss = kalman(n, m), lainiotis(n, m), steady_state(n, m)
        operations = {"KF": kf, "LF": lf, "JKLF": kf + lf + join(n, m)}
        operations |= {"SSKF": ss, "SSLF": ss, "JSSKLF": ss + ss + join_steady_state(n, m)}
        for name, of_one_filter in operations.items():
            totals[f"{name} {model}"] = filters * total(of_one_filter)
    return totals


def value(formula, **letters):
    """Return the exact value of a formula, written as the papers print it, for whole numbers in place of its letters.

    Raises ValueError for what is no formula of these letters.

    >>> value("2n² + 2nm - n + (M - 1)n", n=4, m=2, M=17)
    Fraction(108, 1)
    """
    in_python = before = ""
    for token in re.findall(r"\d+(?:\.\d+)?|\S", formula):
        a_number = token[0].isdecimal()
        if not (a_number or token in letters or token in OPERATORS) or (token in "²³" and before in ("²", "³")):
            need = f"numbers, brackets and the letters {', '.join(letters)}"
            checks.refuse("formula", need, f"{token!r} in {formula!r}")
        if (token in letters or token == "(") and (before in letters or before[-1:] in FACTORS_END):
            in_python += "*"  # what stands side by side is multiplied
        in_python += f"Fraction({token!r})" if a_number else OPERATORS.get(token, token)
        before = token
    try:
        return eval(in_python, {"Fraction": Fraction} | {name: Fraction(each) for name, each in letters.items()})
    except (SyntaxError, NameError, TypeError):
        checks.refuse("formula", "one that can be computed", repr(formula))


def formula(operations, right="", letters="nm", over=1):
    """Return a function for `Paper.table`: of a printed formula, whether it is the sum of these operations.

    It is, if both agree for all letters from 1 to 8: two polynomials of degree 3 in each letter are equal if they agree
    on four values of each. Where the operations are to be divided by a number, it is `over`; a formula may have several
    sides. right is the formula that it should be, where it is another; it is held against the operations too.

    >>> formula(fir, "2nmM - n", "nmM")("2n² + 2nm - n + (M - 1)n")
    (False, '2nmM - n', 'not the sum of the operations, for all n, m, M = 1 ... 8')
    """

    def is_sum(text):
        sides = [side.strip() for side in text.split("=")]
        for sizes in itertools.product(range(1, 9), repeat=len(letters)):
            wanted = Fraction(total(operations(*sizes)), over)
            if any(value(side, **dict(zip(letters, sizes, strict=True))) != wanted for side in sides):
                return False
        return True

    if right and not is_sum(right):
        checks.refuse("right", "a formula that is the sum of the operations", repr(right))

    def compared(printed):
        holds = is_sum(printed)
        how = f"{'' if holds else 'not '}the sum of the operations, for all {', '.join(letters)} = 1 ... 8"
        return holds, printed if holds else right, how

    return compared
