"""Transitions of a user's own: what is forgotten within tau seconds."""

from dataclasses import dataclass

import numpy as np
from oracles import van_loan

TAU = 4.0


@dataclass(frozen=True)
class Forgetful:
    """The velocity (Ornstein-Uhlenbeck), made anew by noise of density q, as in the docstring of `LinearModel`."""

    tau: float
    q: float

    def __call__(self, dt):
        a, b = np.exp(-dt / self.tau), -np.expm1(-dt / self.tau)
        Q_sv = self.tau**2 * b**2 / 2
        Q = [[self.tau**2 * (dt - self.tau * (b + b**2 / 2)), Q_sv], [Q_sv, self.tau * b * (1 + a) / 2]]
        return np.array([[1, self.tau * b], [0, a]]), self.q * np.array(Q)


@dataclass(frozen=True)
class Singer:
    """The acceleration: F and Q by van Loan's exponential of one matrix."""

    tau: float
    q: float

    def __call__(self, dt):
        A = np.array([[0, 1, 0], [0, 0, 1], [0, 0, -1 / self.tau]])
        return van_loan(A, [0, 0, self.q], dt)
