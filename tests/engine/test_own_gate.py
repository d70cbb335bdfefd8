"""A gate of a user's own, as docs/extending.md writes it, is a plain loop."""

import re

import numpy as np
from conftest import ROOT

import mpt_helpers as mpt

(TEXT,) = re.findall(r"```python gate\n(.*?)```", (ROOT / "docs/extending.md").read_text(encoding="utf-8"), re.DOTALL)
LIMIT, PATIENCE = 9.0, 2


def gate_of_the_page():
    names = {"__name__": "mpt_helpers.impatient", "__package__": "mpt_helpers"}
    exec(TEXT, names)
    return names["impatient"]


def a_loop(model, t, z, r):
    """A mask of the rows of one track (N, 2) that a plain Kalman filter with this gate takes."""
    x, P, at, refused, mask = model.x0, model.P0, t[0] - model.dt, 0, []
    for t_k, z_k, r_k in zip(t, z, r, strict=True):
        F, Q = model.over(t_k - at)
        x, P, at, seen = F @ x, F @ P @ F.T + Q, t_k, ~np.isnan(z_k)
        if not seen.any():
            mask.append(False)
            continue
        H, e = model.H[seen], z_k[seen] - model.H[seen] @ x
        S = H @ P @ H.T + np.diag(r_k[seen])
        mask.append(bool(e @ np.linalg.solve(S, e) <= LIMIT or refused >= PATIENCE))
        refused = 0 if mask[-1] else refused + 1
        if mask[-1]:
            K = P @ H.T @ np.linalg.inv(S)
            x, P = x + K @ e, P - K @ H @ P
    return mask


def test_the_gate_of_the_page_is_a_plain_loop():
    """Times and variances of its own, rows that are partly or wholly missing, and outliers."""
    axis = mpt.constant_velocity(1.0, 0.04, 0.5, P0=np.eye(2))
    model, rng = mpt.stack(axis, axis), np.random.default_rng(3)
    t, r = np.cumsum(rng.uniform(0.5, 3.0, 60)), rng.uniform(0.2, 2.0, (60, 2))
    z = np.cumsum(rng.standard_normal((60, 2, 4)), axis=0)
    z[rng.random(z.shape) < 0.05] += 30
    z[rng.random(z.shape) < 0.15] = np.nan
    kf = mpt.KalmanFilter(model, t=t, r=r)
    masks = np.array([gate_of_the_page()(kf, z[..., i], LIMIT, PATIENCE) for i in range(4)])
    np.testing.assert_array_equal(masks, [a_loop(model, t, z[..., i], r) for i in range(4)])
    assert 5 < (~masks).sum() < 100  # most rows count


def test_a_missed_row_is_no_fix_that_fits():
    """After a jump every second row is missed: the gate gives in all the same."""
    axis = mpt.constant_velocity(1.0, 0.01, 0.1, P0=np.eye(2))
    z = np.zeros((40, 1))
    z[20:] = 100.0
    z[21::2] = np.nan
    mask = gate_of_the_page()(mpt.KalmanFilter(axis), z, LIMIT, PATIENCE)
    assert mask[20:].sum() > 3
