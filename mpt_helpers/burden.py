"""The papers' calculation burdens, itemised operation by operation.

A burden is the number of scalar additions, multiplications and divisions in one iteration, as a polynomial in the
dimension n of the state, m of the measurement and, for the FIR filter, its order M. The papers print totals only (2014
and 2015 Table 2) and itemise one filter (2016 Table 2): every entry of a product of p columns costs p multiplications
and p - 1 additions, and zeros are not exploited. The other rules are inferred, and give exactly the printed totals: of
a symmetric result only the upper triangle is computed, and a p×p inverse costs (16p³ - 3p² - p)/6.
"""

import re
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import prod
from numbers import Real

from . import checks


class Polynomial:
    """A polynomial with exact coefficients in variables of one letter.

    `terms` maps monomials to coefficients: {"nn": 2, "n": -1} is 2n² - n. Raises TypeError or ValueError for others.

    >>> n, m = Polynomial({"n": 1}), Polynomial({"m": 1})
    >>> 2 * n * n + m / 2 - n
    2n² - n + 0.5m
    >>> (n + 1)(n=4)
    5
    """

    def __init__(self, terms):
        for monomial, c in checks.instance("terms", terms, Mapping).items():
            if not re.fullmatch("[A-Za-z]*", checks.instance("terms", monomial, str)):
                checks.refuse("terms", "monomials of letters", repr(monomial))
            checks.number(f"terms[{monomial!r}]", c)
        terms = {"".join(sorted(monomial, reverse=True)): Fraction(c) for monomial, c in terms.items() if c}
        self.terms = {key: terms[key] for key in sorted(sorted(terms, reverse=True), key=len, reverse=True)}

    @classmethod
    def of(cls, value):
        """Return a number as a constant polynomial, and a polynomial as it is; raises TypeError for anything else."""
        if isinstance(value, Polynomial):
            return value
        checks.number("value", value, "a number or a Polynomial")
        return cls({"": value})

    @classmethod
    def parse(cls, text):
        """Read a formula as the papers print it: sums of terms such as 3.5n² and (16m³ - 3m² - m)/6 or (M - 1)n.

        Raises ValueError or TypeError for what is none.

        >>> Polynomial.parse("n² + (3n² - n)/6 + (M - 1)n")
        1.5n² + nM - (7/6)n
        """
        checks.instance("text", text, str)
        text = text.replace("−", "-").replace("²", "^2").replace("³", "^3").replace(" ", "")
        total = cls({})
        letters = r"(?:[A-Za-z](?:\^\d)?)"
        term = rf"([+-]?)(?:\(([^()]+)\)(?:/(\d+))?|(\d+(?:\.\d+)?)|(?={letters}))({letters}*)"
        if not re.fullmatch(f"(?:{term})(?:(?=[+-]){term})*", text):
            checks.refuse("text", "a formula such as 2n² - n + (M - 1)n", repr(text))
        if re.search(r"/0+(?!\d)", text):
            checks.refuse("text", "a divisor that is not zero", repr(text))
        for sign, group, divisor, factor, letters in re.findall(term, text):
            inner = cls.parse(group) / int(divisor or 1) if group else cls.of(Fraction(factor or 1))
            monomial = "".join(letter * int(power or 1) for letter, power in re.findall(r"([A-Za-z])\^?(\d?)", letters))
            total += inner * cls({monomial: -1 if sign == "-" else 1})
        return total

    def __add__(self, other):
        terms = defaultdict(Fraction, self.terms)
        for monomial, c in Polynomial.of(other).terms.items():
            terms[monomial] += c
        return Polynomial(terms)

    def __mul__(self, other):
        terms = defaultdict(Fraction)
        for monomial, c in self.terms.items():
            for by, d in Polynomial.of(other).terms.items():
                terms["".join(sorted(monomial + by, reverse=True))] += c * d
        return Polynomial(terms)

    def __sub__(self, other):
        return self + -1 * Polynomial.of(other)

    def __truediv__(self, number):
        return self * Fraction(1, number)

    __radd__ = __add__
    __rmul__ = __mul__

    def __eq__(self, other):
        return self.terms == Polynomial.of(other).terms if isinstance(other, (Polynomial, Real)) else NotImplemented

    __hash__ = None

    def __call__(self, **values):
        """Return the value for these numbers, as a Fraction or an int; a variable may also be given a Polynomial.

        Raises ValueError or TypeError unless every variable has a value.

        >>> (n * n + M)(n=4, M=M)
        M + 16
        """
        letters = set("".join(self.terms))
        for letter, value in {**dict.fromkeys(letters), **values}.items():
            if not isinstance(value, Polynomial):
                checks.number(letter, value, "a number or a Polynomial")
        value = sum((c * prod(values[letter] for letter in monomial) for monomial, c in self.terms.items()), Fraction())
        return int(value) if isinstance(value, Fraction) and value.denominator == 1 else value

    def __repr__(self):
        superscript = {1: "", 2: "²", 3: "³"}
        text = ""
        for monomial, c in self.terms.items():
            letters = "".join(v + superscript[monomial.count(v)] for v in dict.fromkeys(monomial))
            factor = f"{float(abs(c)):g}" if c.denominator <= 2 else f"({abs(c)})"
            text += (" - " if c < 0 else " + ") + ("" if factor == "1" and letters else factor) + letters
        return text.removeprefix(" + ").removeprefix(" ").replace("- ", "-", text.startswith(" -")) or "0"


n, m, M = Polynomial({"n": 1}), Polynomial({"m": 1}), Polynomial({"M": 1})


@dataclass(frozen=True)
class Operation:
    """One matrix operation: what it computes, the dimensions of its operands, its burden."""

    what: str
    dimensions: str
    burden: Polynomial

    def __post_init__(self):
        checks.instance("what", self.what, str)
        checks.instance("dimensions", self.dimensions, str)
        checks.instance("burden", self.burden, (Polynomial, int, float))


def _sizes(**sizes):
    for name, size in sizes.items():
        if not isinstance(size, Polynomial):
            checks.count(name, size)


def product(what, p, q, r):
    """(p×q)·(q×r): p r entries of q multiplications and q - 1 additions.

    >>> product("F x(k/k)", n, n, 1)
    Operation(what='F x(k/k)', dimensions='(n×n)·(n×1)', burden=2n² - n)
    """
    _sizes(p=p, q=q, r=r)
    return Operation(what, f"({p}×{q})·({q}×{r})", p * r * (2 * q - 1))


def symmetric_product(what, p, q):
    """(p×q)·(q×p) with a symmetric result: p (p + 1) / 2 entries.

    >>> symmetric_product("F P(k/k) Fᵀ", n, n).burden
    n³ + 0.5n² - 0.5n
    """
    _sizes(p=p, q=q)
    return Operation(what, f"({p}×{q})·({q}×{p}), symmetric", p * (p + 1) / 2 * (2 * q - 1))


def addition(what, p, q):
    """(p×q) + (p×q), or a (p×q) matrix times a number."""
    _sizes(p=p, q=q)
    return Operation(what, f"({p}×{q})", Polynomial.of(p * q))


def symmetric_addition(what, p):
    """(p×p) + (p×p) with a symmetric result, or a symmetric (p×p) matrix times a number."""
    _sizes(p=p)
    return Operation(what, f"({p}×{p}), symmetric", p * (p + 1) / 2)


def identity_plus(what, p):
    """I + (p×p): the diagonal only."""
    _sizes(p=p)
    return Operation(what, f"({p}×{p}), diagonal", p)


def inverse(what, p):
    """(p×p)⁻¹, with the burden that stands in the papers' total for the Kalman filter.

    >>> inverse("[H P Hᵀ + R]⁻¹", m).burden
    (8/3)m³ - 0.5m² - (1/6)m
    """
    _sizes(p=p)
    return Operation(what, f"({p}×{p})⁻¹", (16 * p * p * p - 3 * p * p - p) / 6)


@dataclass(frozen=True)
class Burden:
    """The operations of one iteration; calling it with numbers counts them.

    >>> kalman.total
    4n³ + 4n²m + 3nm² + (8/3)m³ + 3.5n² + nm - 0.5m² - 1.5n - (1/6)m
    >>> kalman(n=4, m=2)
    509
    """

    operations: tuple

    def __post_init__(self):
        operations = checks.several("operations", self.operations, "Operations")
        for i, each in enumerate(operations):
            checks.instance(f"operations[{i}]", each, Operation)
        object.__setattr__(self, "operations", operations)

    @property
    def total(self):
        """The sum over the operations, a Polynomial."""
        return sum((operation.burden for operation in self.operations), Polynomial({}))

    def __add__(self, other):
        return Burden(self.operations + other.operations)

    def __call__(self, n, m, **order):
        """Return the number of operations; raises ValueError or TypeError unless n, m (and M) are positive integers."""
        values = {name: checks.count(name, value) for name, value in {"n": n, "m": m, **order}.items()}
        for name in set(order) - set("".join(self.total.terms)):
            checks.refuse(name, f"a variable of {self.total}", name)
        return self.total(**values)

    def rows(self):
        """Return (operation, dimensions, burden) for each operation and the total, as text."""
        rows = [(each.what, each.dimensions, str(each.burden)) for each in self.operations]
        return [*rows, ("total", "", str(self.total))]


kalman = Burden(
    (
        product("F x(k/k)", n, n, 1),
        product("F P(k/k)", n, n, n),
        symmetric_product("F P(k/k) · Fᵀ", n, n),
        symmetric_addition("P(k+1/k) = GQGᵀ + F P(k/k) Fᵀ", n),
        product("H P(k+1/k)", m, n, n),
        symmetric_product("H P(k+1/k) · Hᵀ", m, n),
        symmetric_addition("H P(k+1/k) Hᵀ + R", m),
        inverse("[H P(k+1/k) Hᵀ + R]⁻¹", m),
        product("K = P(k+1/k) Hᵀ · [H P(k+1/k) Hᵀ + R]⁻¹", n, m, m),
        product("K H", n, m, n),
        identity_plus("I - K H", n),
        product("[I - K H] x(k+1/k)", n, n, 1),
        product("K z(k+1)", n, m, 1),
        addition("x(k+1/k+1) = [I - K H] x(k+1/k) + K z(k+1)", n, 1),
        symmetric_product("P(k+1/k+1) = [I - K H] P(k+1/k)", n, n),
    )
)

lainiotis = Burden(
    (
        product("P(k/k) Oₙ", n, n, n),
        identity_plus("I + P(k/k) Oₙ", n),
        inverse("[I + P(k/k) Oₙ]⁻¹", n),
        product("Fₙ · [I + P(k/k) Oₙ]⁻¹", n, n, n),
        product("Kₙ z(k+1)", n, m, 1),
        product("Kₘ z(k+1)", n, m, 1),
        product("P(k/k) · Kₘ z(k+1)", n, n, 1),
        addition("P(k/k) Kₘ z(k+1) + x(k/k)", n, 1),
        product("Fₙ [I + P(k/k) Oₙ]⁻¹ · [P(k/k) Kₘ z(k+1) + x(k/k)]", n, n, 1),
        addition("x(k+1/k+1) = Kₙ z(k+1) + Fₙ [...]⁻¹ [...]", n, 1),
        product("Fₙ [I + P(k/k) Oₙ]⁻¹ · P(k/k)", n, n, n),
        symmetric_product("Fₙ [I + P(k/k) Oₙ]⁻¹ P(k/k) · Fₙᵀ", n, n),
        symmetric_addition("P(k+1/k+1) = Pₙ + Fₙ [...]⁻¹ P(k/k) Fₙᵀ", n),
    )
)

join = Burden(
    (
        addition("x_KF + x_LF", n, 1),
        addition("x = ½ (x_KF + x_LF)", n, 1),
        symmetric_addition("P_KF + P_LF", n),
        symmetric_addition("P = ½ (P_KF + P_LF)", n),
    )
)

steady_state = Burden(
    (
        product("A x(k/k)", n, n, 1),
        product("B z(k+1)", n, m, 1),
        addition("x(k+1/k+1) = A x(k/k) + B z(k+1)", n, 1),
    )
)

# 2016 Table 2 and Eq. 19; the table prints x(k/k-1) and z(k+1).
prediction = Burden(
    (
        product("A_N x(k+N-1/k-1)", n, n, 1),
        product("B_N z(k)", n, m, 1),
        addition("x(k+N/k) = A_N x(k+N-1/k-1) + B_N z(k)", n, 1),
    )
)

join_steady_state = Burden(
    (
        addition("x_SSKF + x_SSLF", n, 1),
        addition("x = ½ (x_SSKF + x_SSLF)", n, 1),
    )
)

joint = kalman + lainiotis + join
joint_steady_state = steady_state + steady_state + join_steady_state

# The burdens of `filters.six_filters`.
six_filters = {
    "KF": kalman,
    "LF": lainiotis,
    "JKLF": joint,
    "SSKF": steady_state,
    "SSLF": steady_state,
    "JSSKLF": joint_steady_state,
}

# 2014 Eq. 22 with the coefficients AʲB known; 2014 Table 5 prints another formula.
fir = Burden(
    (
        Operation("AʲB z(k-j) for j = 0 ... M-1", "M times (n×m)·(m×1)", M * n * (2 * m - 1)),
        Operation("their sum", "M-1 times (n×1)", (M - 1) * n),
    )
)
