"""Motions: F and Q, by which a step changes the state, over one dt of the model or over steps of any length.

    x <- F x,   P <- F P Fᵀ + Q

A model owns its motion, and everything that predicts asks it: filters, smoother, innovations, bands. Two kinds come
with the models of this package: `OneLength`, for an F and a Q of one step, and `Powers`, where F and Q follow powers of
the length, as those of constant velocity do.

**Your own motion** is a subclass of `Motion` with a dt and one function, `over`. Here is a mobile whose velocity is
forgotten within tau seconds (an Ornstein-Uhlenbeck process, dv = -v/tau dt + noise of density q). Filter, smoother,
likelihood, fit and bands then take steps of any length:

>>> from dataclasses import dataclass
>>> import mpt_helpers as mpt
>>> from mpt_helpers.motion import Motion, matrices
>>> @dataclass(frozen=True)
... class Forgetful(Motion):
...     dt: float
...     tau: float
...     q: float
...
...     def over(self, length):
...         T = np.asarray(length) * self.dt  # lengths come in units of dt
...         a, b = np.exp(-T / self.tau), -np.expm1(-T / self.tau)  # a + b = 1; expm1 keeps the digits of short steps
...         F = [[1, self.tau * b], [0, a]]
...         Q_sv = self.tau**2 * b**2 / 2
...         Q = [[self.tau**2 * (T - self.tau * (b + b**2 / 2)), Q_sv], [Q_sv, self.tau * b * (1 + a) / 2]]
...         return matrices(F), self.q * matrices(Q)
>>> model = mpt.LinearModel(motion=Forgetful(dt=1.0, tau=20.0, q=0.04), H=[[1, 0]], R=[[0.5]], P0=np.eye(2))
>>> kf = mpt.KalmanFilter(model, t=[1.0, 1.5, 4.0, 60.0])
>>> kf.smooth([[0.9], [1.6], [np.nan], [20.0]]).x.round(2)
array([[ 1.  ,  0.71],
       [ 1.35,  0.69],
       [ 3.01,  0.63],
       [19.99,  0.12]])

Two steps of half a length must be one of the whole: a motion for which that does not hold over its dt is refused, and
a filter warns where it does not hold over its shortest or longest step. One that holds
arrays is `class Mine(Immutable, Motion)` with `@dataclass(frozen=True, eq=False)`, as those below: then models that
have it can be compared and hashed. Mind the range of `over`: Van Loan's matrix exponential for Q overflows over gaps of
many time constants, where P∞ - F P∞ Fᵀ, with the covariance P∞ at rest of a motion that has one, does not.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from . import _checks as checks
from ._checks import Array
from ._engine.algebra import LinearMap, product, transposed
from ._immutable import Immutable

# By how much two half steps of a motion may miss one whole step, relative to its size: a Q from a formula that
# subtracts large numbers loses digits on short steps, and six of them should be left. Over other steps than the
# motion's own dt three suffice without a warning.
MISSED, MISSED_ELSEWHERE = 1e-6, 1e-3
# Rounding leaves some 1e-16 of the largest entry of F where a zero should be. Against a billionth of that entry it
# stays below the millionth. (Of Q nothing is left out: over short steps an entry may rightly be 1e-18 of the largest.)
LEAST_OF_F = 1e-9
# The same for powers of the length, whose steps are a few products.
MISSED_BY_POWERS = 1e-12


class Motion:
    """F and Q of steps of any length. A subclass has a `dt` (s) and `over`; all else follows from these.

    What is here works for every motion, by a matrix for each column; a subclass may do the same in fewer operations.
    Columns are the last axes: x is (n, ...) and P (n, n, ...). lengths are those of the steps, in units of dt, one for
    each column or broadcast to them, and None where all steps are one dt long.
    """

    dt: float | None

    def over(self, length: ArrayLike) -> tuple[Array, Array]:
        """Return F and Q (n, n) of a step of this length, in units of dt, or (..., n, n) of many lengths (...).

        A step of length zero changes nothing: F is I and Q is zero.
        """
        raise NotImplementedError

    @cached_property
    def one_step(self) -> tuple[Array, Array]:
        """F and Q of a step of length one."""
        return self.over(1.0)

    def state(self, x: Array, lengths: Array | None = None) -> Array:
        """Return F x (n, ...)."""
        return self._one_map.of_state(x) if lengths is None else self._state(x, self._made(lengths))

    def covariance(self, P: Array, lengths: Array | None = None) -> Array:
        """Return F P Fᵀ + Q (n, n, ...), symmetric to the last bit where P is."""
        if lengths is not None:
            return self._covariance(P, self._made(lengths))
        _, Q = self.one_step
        return self._one_map.of_covariance(P) + Q.reshape(*Q.shape, *[1] * (P.ndim - 2))

    def predicted(self, x: Array, P: Array, lengths: Array | None = None) -> tuple[Array, Array]:
        """Return F x and F P Fᵀ + Q, with what both need made once."""
        if lengths is None:
            return self.state(x), self.covariance(P)
        made = self._made(lengths)
        return self._state(x, made), self._covariance(P, made)

    def with_noises(self, R: Array) -> Motion:
        """Return the motion of the state and, after it, of measurement noises of covariance R.

        The noises are new in each epoch, however long the step: they have an F of zero, and the Q of every step is R.
        """
        return joined([self, Noises(R, self.dt)])

    def with_matrices(self, F: Array, Q: Array) -> Motion | None:
        """Return the motion of this kind whose step of one dt has this F and Q, or None where there is none.

        `dataclasses.replace` of a model asks this. The F must be that of this motion, and the Q its own or zero.
        """
        own_F, own_Q = self.one_step
        if not np.array_equal(F, own_F):
            return None
        if np.array_equal(Q, own_Q):
            return self
        return None if Q.any() else Noiseless(self)

    @cached_property
    def _one_map(self):
        return LinearMap(self.one_step[0])

    # The three below are what `Powers` does in fewer operations.

    def _made(self, lengths):
        """Return the matrices or numbers of the lengths that `_state` and `_covariance` need."""
        # F and Q may be dear, as those of a matrix exponential: those of equal lengths are made once.
        of_each, which = np.unique(lengths, return_inverse=True)
        which = which.reshape(np.shape(lengths))  # numpy 2.0 returned another shape than 1.26 and 2.1
        return tuple(np.moveaxis(each[which], (-2, -1), (0, 1)) for each in self.over(of_each))

    def _state(self, x, made):
        F, _ = made
        return np.einsum("ij...,j...->i...", F, x)

    def _covariance(self, P, made):
        F, Q = made
        P = product(product(F, P), transposed(F)) + Q
        return (P + transposed(P)) / 2


def matrices(rows: ArrayLike) -> Array:
    """Return matrices (..., a, b) from a list of a rows with b entries each, which are numbers or arrays (...).

    >>> matrices([[1, np.array([2.0, 3.0])]])
    array([[[1., 2.]],
    <BLANKLINE>
           [[1., 3.]]])
    """
    entries = np.broadcast_arrays(*[np.asarray(entry, dtype=float) for row in rows for entry in row])
    return np.stack(entries, axis=-1).reshape(*entries[0].shape, len(rows), len(rows[0]))


def refuse_other_lengths() -> NoReturn:
    """Raise the ValueError of a model that knows steps of one length only."""
    need = "powers that say what a step of another length is, or a motion that does"
    checks.refuse("model", need, "an F and a Q of one length only")


def powers_of(motion: Motion) -> Array | None:
    """Return the powers (n,) of `Powers`, and None of any other motion, whose own `powers` may be anything."""
    return motion.powers if isinstance(motion, Powers) else None


@dataclass(frozen=True, eq=False)
class OneLength(Immutable, Motion):
    """F and Q (n, n) of a step of one length, which need not be known: there are no others."""

    F: Array
    Q: Array

    dt = None

    def over(self, length: ArrayLike) -> tuple[Array, Array]:
        """Return F and Q. Raises ValueError for another length than one."""
        if np.any(np.asarray(length) != 1):
            refuse_other_lengths()
        return self.F, self.Q


@dataclass(frozen=True, eq=False)
class Powers(Immutable, Motion):
    """F and Q (n, n) over one dt, which follow the length s of a step: F_ij s^(e_i - e_j) and Q_ij s^(e_i + e_j).

    The powers e (n,) belong to the states: a position driven by a white noise of the acceleration has 3/2, its velocity
    1/2.
    """

    F: Array
    Q: Array
    powers: Array
    dt: float

    def over(self, length: ArrayLike) -> tuple[Array, Array]:
        """Return F and Q as `Motion.over`."""
        # A power below zero has an F_ij or Q_ij of zero (`fits`), so its power is set to 0: 0 ** -1 would be infinite.
        e = self.powers
        s = np.asarray(length, dtype=float)[..., None, None]
        return self.F * s ** np.maximum(e[:, None] - e, 0), self.Q * s ** np.maximum(e[:, None] + e, 0)

    def fits(self) -> bool:
        """Tell whether two steps of dt / 2 are one of dt, and whether a step of length zero changes nothing."""
        e, F, Q = self.powers, self.F, self.Q
        differences, sums = e[:, None] - e, e[:, None] + e
        # Whole powers, which `_made` has as products of the lengths.
        if (differences[F != 0] % 1).any() or (sums[Q != 0] % 1).any():
            return False
        # Over a step of length zero no entry is infinite (0 ** -1), and Q is zero (0 ** 0 is 1).
        if (differences[F != 0] < 0).any() or (sums[Q != 0] <= 0).any():
            return False
        # Entries of power zero are the same over every step, and so those of the identity.
        if (np.diag(F) != 1).any() or F[(differences == 0) & ~np.eye(len(F), dtype=bool)].any():
            return False
        # F = F½ F½ and Q = F½ Q½ F½ᵀ + Q½, with F½ and Q½ of half a step, to the rounding of these products.
        half, noise = F * 0.5**differences, Q * 0.5**sums
        with np.errstate(over="ignore"):  # beside the largest doubles the size is infinite
            sizes = _two_steps(np.abs(half), np.abs(Q))
            pairs = zip((F, Q), _two_steps(half, noise), sizes, strict=True)
            return all((np.abs(twice - whole) <= MISSED_BY_POWERS * size).all() for whole, twice, size in pairs)

    def with_noises(self, R: Array) -> Motion:
        """Return the motion of the state and the noises, as `Motion.with_noises`: noises have powers of zero."""
        F, Q = block_diag(self.F, np.zeros_like(R)), block_diag(self.Q, R)
        return Powers(F, Q, np.append(self.powers, np.zeros(len(R))), self.dt)

    # On columns `over` would make an (n, n) for each of them, most of whose entries are zero or constant. So F and Q
    # stand here a second time, as the terms that are not zero: each is one row of numbers for all columns.

    @cached_property
    def _terms(self):
        """The (i, j, F_ij, power) outside of the diagonal that are not zero, in the order in which they are added.

        `_state` adds F_ij s^power x_j to x_i in place, and must add x_j as it was before the step. j has a lower power
        than i, so the states of the highest powers come first. Constant acceleration has the powers 5/2, 3/2 and 1/2:
        the position takes the old velocity and acceleration, and only then the velocity takes the acceleration.
        """
        n, e = len(self.F), self.powers
        highest_first = sorted(range(n), key=lambda i: -e[i])
        return [
            (i, j, self.F[i, j], round(e[i] - e[j])) for i in highest_first for j in range(n) if i != j and self.F[i, j]
        ]

    @cached_property
    def _noises(self):
        """The (i, j, Q_ij, power) on and above the diagonal that are not zero."""
        n, e = len(self.Q), self.powers
        return [(i, j, self.Q[i, j], round(e[i] + e[j])) for i in range(n) for j in range(i, n) if self.Q[i, j]]

    @cached_property
    def _diagonal(self):
        """The diagonal of F (n,), or None where it is all ones; that of a noise is zero."""
        diagonal = np.diag(self.F)
        return None if (diagonal == 1).all() else diagonal

    @cached_property
    def _highest(self):
        return max((power for *_, power in self._terms + self._noises), default=0)

    def _made(self, lengths):
        """Return [1, s, s², ...] for the lengths s of the steps."""
        powers = [1.0, lengths]
        for _ in range(self._highest - 1):
            powers.append(powers[-1] * lengths)
        return powers

    def _state(self, x, made):
        moved = x.copy() if self._diagonal is None else x * self._diagonal.reshape(-1, *[1] * (x.ndim - 1))
        for i, j, F_ij, power in self._terms:
            moved[i] += F_ij * made[power] * moved[j]
        return moved

    def _covariance(self, P, made):
        P = self._state(P, made)  # F P; now the same for the columns of each matrix: (F P) Fᵀ
        if self._diagonal is not None:
            P *= self._diagonal.reshape(-1, *[1] * (P.ndim - 2))
        for i, j, F_ij, power in self._terms:
            P[:, i] += F_ij * made[power] * P[:, j]
        for i, j, Q_ij, power in self._noises:
            P[i, j] += Q_ij * made[power]
        for i in range(len(P)):
            P[i, :i] = P[:i, i]  # the same sums in another order: P stays symmetric to the last bit
        return P


@dataclass(frozen=True, eq=False)
class Noises(Immutable, Motion):
    """States that are new in each epoch, however long the step: F is zero and Q is R.

    So it breaks what `Motion.over` says of a step of length zero: two epochs at one time have two noises. Only
    `with_noises` makes it.
    """

    R: Array
    dt: float | None

    def over(self, length: ArrayLike) -> tuple[Array, Array]:
        """Return F and Q as `Motion.over`, but those of a step of length zero, which are zero and R too."""
        shape = (*np.shape(length), *self.R.shape)
        return np.zeros(shape), np.broadcast_to(self.R, shape)


@dataclass(frozen=True, eq=False)
class Noiseless(Immutable, Motion):
    """A motion with its F, and a Q of zero."""

    motion: Motion

    @property
    def dt(self) -> float:
        """The length of one step (s)."""
        return self.motion.dt

    def over(self, length: ArrayLike) -> tuple[Array, Array]:
        """Return F and Q as `Motion.over`."""
        F, Q = self.motion.over(length)
        return F, np.zeros_like(Q)


@dataclass(frozen=True, eq=False)
class SideBySide(Immutable, Motion):
    """Motions of states that follow one another, with no term between them; all have one dt."""

    motions: tuple[Motion, ...]

    @property
    def dt(self) -> float:
        """The length of one step (s)."""
        return self.motions[0].dt

    def over(self, length: ArrayLike) -> tuple[Array, Array]:
        """Return F and Q as `Motion.over`, block diagonal."""
        F, Q = zip(*(motion.over(length) for motion in self.motions), strict=True)
        return _on_diagonal(F), _on_diagonal(Q)

    def with_matrices(self, F: Array, Q: Array) -> Motion | None:
        """Return the motion as `Motion.with_matrices`: some of its parts may lose their noise, and others keep it."""
        made, start = [], 0
        for motion in self.motions:
            here = slice(start, start + len(motion.one_step[0]))
            made.append(motion.with_matrices(F[here, here], Q[here, here]))
            start = here.stop
        if None in made:
            return None
        whole = SideBySide(tuple(made))
        return whole if all(map(np.array_equal, whole.one_step, (F, Q))) else None


def _on_diagonal(parts):
    """Return matrices (..., n, n) with parts (..., n_i, n_i) on their diagonal; `block_diag` takes no axes before."""
    n = sum(part.shape[-1] for part in parts)
    whole, start = np.zeros((*parts[0].shape[:-2], n, n)), 0
    for part in parts:
        here = slice(start, start + part.shape[-1])
        whole[..., here, here] = part
        start = here.stop
    return whole


def joined(motions: list[Motion]) -> Motion:
    """Return the motion of states that follow one another, of one length only where one of them is.

    Those that know steps of any length have one dt: `stack` refuses others.
    """
    steps = [motion.dt for motion in motions]
    F, Q = (block_diag(*each) for each in zip(*(motion.one_step for motion in motions), strict=True))
    if None in steps:
        return OneLength(F, Q)
    if all(isinstance(motion, Powers) for motion in motions):
        return Powers(F, Q, np.concatenate([motion.powers for motion in motions]), steps[0])
    return SideBySide(tuple(motions))


def _two_steps(F, Q):
    """Return F F and F Q Fᵀ + Q, the F and Q of two steps in a row."""
    return F @ F, F @ Q @ F.T + Q


def checked(motion: Motion) -> tuple[Array, Array]:
    """Return F and Q of one step of a motion of a user's own, or raise what is wrong with it.

    TypeError for anything but a Motion, ValueError for a dt that is not positive, for F and Q of other shapes than
    those of `Motion.over`, and where two half steps are not one.
    """
    checks.instance("motion", motion, Motion)
    checks.positive("motion.dt", getattr(motion, "dt", None))
    F, Q = (checks.real_numbers("motion", each, "an over(length) that returns F and Q") for each in motion.over(1.0))
    n = len(np.atleast_1d(F))
    need = "an over(length) that returns F and Q, (n, n) of a number and (K, n, n) of lengths (K,): see `matrices`"
    try:
        of_many = motion.over(np.array([0.0, 0.5, 1.0]))
    except (TypeError, ValueError) as error:  # as of a list with numbers beside arrays
        checks.refuse("motion", need, f"of 3 lengths, the error {str(error)!r:.60}")
    for each, many in zip((F, Q), of_many, strict=True):
        if each.shape != (n, n) or np.shape(many) != (3, n, n):
            checks.refuse("motion", need, f"shapes {each.shape} and, of 3 lengths, {np.shape(many)}")
    (F_0, *_), (Q_0, *_) = of_many
    if not np.array_equal(F_0, np.eye(n)) or Q_0.any():
        checks.refuse("motion", "F = I and Q = 0 over a step of length zero", "others")
    for name, missed in zip("FQ", missed_by_halves(motion, 1.0), strict=True):
        if not missed <= MISSED:
            got = f"a {name} that they miss by {missed:.2g} of its size"
            checks.refuse("motion", "two steps of half a length to be one of the whole", got)
    return F, Q


def missed_by_halves(motion: Motion, length: float) -> tuple[float, float]:
    """Return by how much two steps of half a length miss one of the whole: F and Q, as the largest part of an entry.

    It is infinite where `over` gives no finite numbers. An entry of F that should be zero may be rounding, as from
    `scipy.linalg.expm`: F counts relative to `LEAST_OF_F` of its largest entry at least.
    """
    (half, whole), (noise, of_whole) = motion.over(np.array([length / 2, length]))
    of_F, of_Q = _two_steps(np.abs(half), np.abs(noise))
    sizes = np.maximum(of_F, LEAST_OF_F * of_F.max()), of_Q
    parts = []
    for one, two, size in zip((whole, of_whole), _two_steps(half, noise), sizes, strict=True):
        missed = np.abs(two - one) / np.where(size > 0, size, np.finfo(float).tiny)
        parts.append(float(missed.max()) if np.isfinite(missed).all() else np.inf)
    return parts[0], parts[1]
