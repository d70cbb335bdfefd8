"""Loss of significance where P is very large relative to the measurement noise: what is refused, what is handled.

S is the variance of a predicted measurement due to P, divided by the noise variance. Above VAGUE, a filter computes the
first epochs in another way (`pieces`), which keeps the digits. A single step cannot, and is refused where no digit is
left. Above LARGEST everything is refused.
"""

import numpy as np

from .. import _checks as checks
from ..equations import unit_measurements

EPS = np.finfo(float).eps
# Above this, rounding leaves about three digits in P after the measurement.
VAGUE = 1e12
# The rounding of the root of S causes an error of up to 1e-31 S R in P after the measurement: here some percent of R.
LARGEST = 1e30
# The largest fraction of a variance that may be rounding error after a step.
MOST_ROUNDING = 0.1
# The largest fraction of an S that may be rounding error: NIS and likelihood are wrong by as much.
MOST_ROUNDING_OF_S = 0.01


def directions_seen(model, R):
    """Return |G| (rows, n): G x is what the sensors see of x within n steps, in units of their noise and that of Q.

    An observable state shows within n steps.
    """
    G, seen = unit_measurements(model.H, model.H @ model.Q @ model.H.T + R)[0], []
    for _ in range(model.n):
        G = G @ model.F
        seen.append(np.abs(G))
    return np.concatenate(seen)


def largest_S(directions, P):
    """Return the largest S to which the standard deviations of each P (n, n, W) may add up, (W,)."""
    return ((directions @ np.sqrt(P.diagonal().T)) ** 2).max(axis=0)


def require_digits(T_1, T_2, P, after, S, dt=None):
    """Raise a ValueError if the step x <- T_1 T_2 x + B z leaves no correct digit in the covariance `after` it (n, n).

    One term of that covariance is T_1 T_2 P (T_1 T_2)ᵀ, with the P (n, n) before the step. Doubles round P_ij by
    ε σ_i σ_j, and hence this term by up to ε (|T_1| |T_2| σ)². S is the largest variance of a predicted measurement.
    The error names dt where it is given.
    """
    finite = np.isfinite(after).all()
    if S < VAGUE and finite:
        return
    sigma = np.sqrt(np.abs(P.diagonal()))
    rounding = EPS * (np.abs(T_1) @ np.abs(T_2) @ sigma) ** 2
    if S < LARGEST and finite and (rounding <= MOST_ROUNDING * after.diagonal()).all():
        return
    if dt is not None:
        checks.refuse("dt", "a time over which the prediction keeps digits beside the measurement noise", f"{dt:.6g} s")
    need = "a covariance that keeps digits beside the measurement noise (filter and estimates take a larger P0)"
    checks.refuse("P", need, f"{S:.2g} times the noise variance")
