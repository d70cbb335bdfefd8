"""Loss of significance where P is very large relative to the measurement noise: what is refused, what is handled.

S is the variance of a predicted measurement due to P, divided by the noise variance. Above VAGUE, a filter computes the
first epochs in another way (`pieces`), which keeps the digits. A single step cannot, and is refused where no digit is
left. Above LARGEST everything is refused.
"""

import numpy as np

from .. import _checks as checks
from ..equations import unit_measurements

# Above this, rounding leaves about three digits in P after the measurement.
VAGUE = 1e12
# Rounding of I - K H causes an error of about 1e-31 S R in P after the measurement: here 1 % of R.
LARGEST = 1e29
# The largest fraction of a variance that may be rounding error after a step.
MOST_ROUNDING = 0.1


def is_vague(model, P0, r=None):
    """Tell whether P0 (n, n) is vague relative to Q and R, or to the variances r (N, m, ...) in place of R.

    Raises ValueError for a P0 above LARGEST.
    """
    F, H, Q, R = model.F, model.H, model.Q, model.R
    if r is not None:
        smallest = np.where(r > 0, r, np.inf).min(axis=(0, *range(2, r.ndim)))
        R = np.diag(np.where(np.isfinite(smallest), smallest, np.diag(R)))

    def largest_S(noise, steps):
        G, largest = unit_measurements(H, noise)[0], 0.0
        for _ in range(steps):
            G = G @ F
            largest = max(largest, float((G @ P0 @ G.T).max()))
        return largest

    first_S = largest_S(R, steps=1)
    if not first_S < LARGEST:
        noise = "R" if r is None else "the smallest r"
        checks.refuse("P0", f"variances of what is measured below {LARGEST:g} {noise}", f"{first_S:.2g} {noise}")
    return largest_S(H @ Q @ H.T + R, steps=len(F)) > VAGUE  # an observable state shows within n steps


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
    rounding = np.finfo(float).eps * (np.abs(T_1) @ np.abs(T_2) @ sigma) ** 2
    if S < LARGEST and finite and (rounding <= MOST_ROUNDING * after.diagonal()).all():
        return
    if dt is not None:
        checks.refuse("dt", "a time over which the prediction keeps digits beside the measurement noise", f"{dt:.6g} s")
    need = "a covariance that keeps digits beside the measurement noise (filter and estimates take a larger P0)"
    checks.refuse("P", need, f"{S:.2g} times the noise variance")
