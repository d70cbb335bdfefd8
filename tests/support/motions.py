"""Motions of a user's own, which have no powers of the length: what is forgotten within tau seconds."""

from dataclasses import dataclass

import numpy as np
from oracles import van_loan

from mpt_helpers.motion import Motion, matrices

TAU = 4.0


@dataclass(frozen=True)
class Forgotten(Motion):
    """Something that is forgotten within tau seconds, and made anew by noise of density q."""

    dt: float
    tau: float
    q: float


class Forgetful(Forgotten):
    """The velocity (Ornstein-Uhlenbeck), as in the docstring of `motion`."""

    def over(self, length):
        T = np.asarray(length) * self.dt
        a, b = np.exp(-T / self.tau), -np.expm1(-T / self.tau)
        Q_sv = self.tau**2 * b**2 / 2
        Q = [[self.tau**2 * (T - self.tau * (b + b**2 / 2)), Q_sv], [Q_sv, self.tau * b * (1 + a) / 2]]
        return matrices([[1, self.tau * b], [0, a]]), self.q * matrices(Q)


class Singer(Forgotten):
    """The acceleration: F and Q by van Loan's exponential of one matrix."""

    def over(self, length):
        A = np.array([[0, 1, 0], [0, 0, 1], [0, 0, -1 / self.tau]])
        return van_loan(A, [0, 0, self.q], np.asarray(length)[..., None, None] * self.dt)
