"""What a frozen gain loses when measurements are missed, exactly."""

import numpy as np

import mpt_helpers as mpt


def worst_ratio(missed, motion, r, seconds=5.0):
    """How much larger the error of a prediction gets, after a gap, with the frozen gain than with the best.

    motion(dt) is F and Q; a step is one second, and the worst of the twelve after the gap counts.
    """
    (F, Q), (far, pushed) = motion(1.0), motion(seconds)
    H = np.eye(1, len(F))
    settled = mpt.SteadyStateFilter.from_kalman(mpt.LinearModel(F=F, H=H, Q=Q, R=[[r]]))
    best, K = settled.P, settled.B
    for _ in range(missed):
        best = F @ best @ F.T + Q
    frozen, found, left = best, [], np.eye(len(F)) - K @ H
    for _ in range(12):
        best, frozen = (F @ P @ F.T + Q for P in (best, frozen))
        best = best - best @ H.T @ H @ best / (H @ best @ H.T + r)
        frozen = left @ frozen @ left.T + r * K @ K.T
        found.append((far @ frozen @ far.T + pushed)[0, 0] / (far @ best @ far.T + pushed)[0, 0])
    return np.sqrt(max(found))
