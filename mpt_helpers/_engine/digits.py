"""The digits that doubles lose where P is huge beside the noise of a measurement: what is refused, what is done.

The size of P is told by S, the variance that it gives to the prediction of a measurement, in units of the noise. Where
it is above VAGUE, the epochs of a start are filtered in another way (`pieces.run_rows`). A single step has no such way:
it is refused where it leaves no digit. Above LARGEST everything is refused.
"""

import numpy as np

from .. import _checks as checks
from ..equations import unit_measurements

# Above it, rounding leaves some three digits in P after the measurement.
VAGUE = 1e12
# Rounding of I - K H makes P after the measurement wrong by some 1e-31 S: here by 1 % of R.
LARGEST = 1e29
# The largest share of a variance that may be rounding after a step.
MOST_ROUNDING = 0.1


def is_vague(model, P0, r=None):
    """Say whether P0 (n, n) is vague beside Q and R, or beside the variances r (N, m, ...) in place of R.

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
    return largest_S(H @ Q @ H.T + R, steps=len(F)) > VAGUE  # within n steps each state shows that ever does


def require_digits(T_1, T_2, P, after, S, dt=None):
    """Raise a ValueError if the step x <- T_1 T_2 x + B z leaves no digit in the covariance `after` it (n, n).

    T_1 T_2 P (T_1 T_2)ᵀ is a part of it. Doubles round P_ij by ε σ_i σ_j, and so this part by up to ε (|T_1| |T_2| σ)².
    P (n, n) is the covariance before the step, S the largest variance of a measurement. The error names dt where given.
    """
    finite = np.isfinite(after).all()
    if S < VAGUE and finite:
        return
    sigma = np.sqrt(np.abs(P.diagonal()))
    rounding = np.finfo(float).eps * (np.abs(T_1) @ np.abs(T_2) @ sigma) ** 2
    if S < LARGEST and finite and (rounding <= MOST_ROUNDING * after.diagonal()).all():
        return
    held = "whose variances doubles hold beside those of the measurements"
    if dt is not None:
        checks.refuse("dt", f"a time over which the state has a prediction {held}", f"{dt:.6g} s")
    need = f"a covariance with a prediction {held} (filter and estimates take a larger P0 than single steps do)"
    checks.refuse("P", need, f"{S:.2g} times as much")
