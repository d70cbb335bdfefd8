"""A gate of a user's own, as CONTRIBUTING.md writes it, on the engine's rows; and the gain of each epoch."""

import re

import numpy as np
import pytest
from conftest import AXIS, ROOT, dense_model

import mpt_helpers as mpt
from mpt_helpers._engine.run import in_sequence, on_own_columns

(TEXT,) = re.findall(r"```python gate\n(.*?)```", (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"), re.DOTALL)
LIMIT, PATIENCE = 9.0, 2


@pytest.fixture
def impatient():
    """The gate of the page."""
    names = {"__name__": "mpt_helpers.impatient", "__package__": "mpt_helpers"}
    exec(TEXT, names)
    return names["impatient"]


def a_loop(model, t, z, r):
    """A mask of the rows of one track (N, 2) that a plain Kalman filter with this gate takes."""
    x, P, at, refused, mask = model.x0, model.P0, t[0] - model.dt, 0, []
    for t_k, z_k, r_k in zip(t, z, r, strict=True):
        F, Q = model.over(t_k - at)
        x, P, at, seen = F @ x, F @ P @ F.T + Q, t_k, ~np.isnan(z_k)
        H, e = model.H[seen], z_k[seen] - model.H[seen] @ x
        S = H @ P @ H.T + np.diag(r_k[seen])
        mask.append(bool(e @ np.linalg.solve(S, e) <= LIMIT or refused >= PATIENCE))
        refused = 0 if mask[-1] else refused + 1
        if mask[-1]:
            K = P @ H.T @ np.linalg.inv(S)
            x, P = x + K @ e, P - K @ H @ P
    return mask


def test_the_gate_of_the_page_is_a_plain_loop_for_each_track(impatient):
    """Times and variances of its own, rows that are partly or wholly missing, and outliers in single tracks."""
    axis = mpt.constant_velocity(1.0, 0.04, 0.5, P0=np.eye(2))
    model, rng = mpt.stack(axis, axis), np.random.default_rng(3)
    t, r = np.cumsum(rng.uniform(0.5, 3.0, 60)), rng.uniform(0.2, 2.0, (60, 2))
    z = np.cumsum(rng.standard_normal((60, 2, 4)), axis=0)
    z[rng.random(z.shape) < 0.05] += 30
    z[rng.random(z.shape) < 0.15] = np.nan
    mask = impatient(mpt.KalmanFilter(model, t=t, r=r), z, LIMIT, PATIENCE)
    loops = np.transpose([a_loop(model, t, z[..., i], r) for i in range(4)])
    np.testing.assert_array_equal(mask, loops)
    assert 5 < (~mask).sum() < 100  # the tracks differ, and most rows count
    np.testing.assert_array_equal(impatient(mpt.KalmanFilter(model, t=t, r=r), z[..., 0], LIMIT, PATIENCE), mask[:, 0])


def test_clean_tracks_that_share_their_conditions_are_not_refused_for_each_other(impatient):
    """Of forty tracks in one column the sum of all squares is far above the limit."""
    z = mpt.simulate(AXIS, 50, np.random.default_rng(1), 40)[1]
    assert impatient(mpt.KalmanFilter(AXIS), z, limit=25.0).all()


def test_a_gate_is_refused_where_it_would_be_wrong():
    z, kf = np.zeros((5, 1, 3)), mpt.KalmanFilter(AXIS)
    advance, _, x, P = on_own_columns(kf, z)
    in_one = kf.epochs_of(z).rows(together=True)
    words = r"takes: needs a column for each track \(on_own_columns\), got 3 tracks in one"
    with pytest.raises(ValueError, match=words):
        next(in_sequence(advance, in_one, x, P, takes=lambda epoch, e: True))
    with pytest.raises(TypeError, match="takes: needs a filter with innovations, got one whose P"):
        next(in_sequence(*on_own_columns(mpt.SteadyStateFilter.from_kalman(AXIS), z), takes=lambda epoch, e: True))
    with pytest.raises(TypeError, match="needs a filter with P0, covariances and step, got a JoinFilter"):
        on_own_columns(mpt.JoinFilter(kf, kf), z)


@pytest.mark.parametrize(("yes", "no"), [(True, False), (1, 0), (np.True_, np.False_)])
def test_a_gate_may_say_yes_and_no_in_any_way(yes, no):
    kf = mpt.KalmanFilter(AXIS)
    run = list(in_sequence(*on_own_columns(kf, np.ones((3, 1, 1))), takes=lambda epoch, e: no))
    np.testing.assert_allclose(run[-1][0].ravel(), kf.filter(np.full((3, 1), np.nan))[-1], rtol=1e-12)
    run = list(in_sequence(*on_own_columns(kf, np.ones((3, 1, 1))), takes=lambda epoch, e: yes))
    np.testing.assert_allclose(run[-1][0].ravel(), kf.filter(np.ones((3, 1)))[-1], rtol=1e-12)


@pytest.mark.parametrize("says", [None, [True, False], np.ones((1, 1, 3), bool)], ids=["nothing", "two", "a matrix"])
def test_a_gate_that_says_something_else_is_refused_by_name(says):
    run = in_sequence(*on_own_columns(mpt.KalmanFilter(AXIS), np.ones((3, 1, 3))), takes=lambda epoch, e: says)
    with pytest.raises(ValueError, match="takes: needs a gate that returns one truth value, or one for each of the 3"):
        next(run)


def gains(kf, z):
    """Yield the gain B_k (n, m, M) of each epoch of z (N, m, M): the answer to unit measurements, from x = 0."""
    advance, rows, _, P = on_own_columns(kf, z)
    n, m, M = kf.model.n, kf.model.m, z.shape[2]
    units = np.broadcast_to(np.eye(m)[..., None], (m, m, M))
    for epoch in rows:
        B, P, _ = advance(epoch._replace(z=units), np.zeros((n, m, M)), P)
        yield B


@pytest.mark.parametrize("make", [mpt.KalmanFilter, mpt.LainiotisFilter])
def test_the_gain_of_each_epoch_is_seen(make):
    """Against `next_step`, with correlated noises and rows that are partly missing."""
    each = make(dense_model(1))
    z = np.ones((12, 2, 3))
    z[np.random.default_rng(2).random(z.shape) < 0.3] = np.nan
    P = [each.P0] * 3
    for B, z_k in zip(gains(each, z), z, strict=True):
        for i in range(3):
            _, B_k, P[i] = each.next_step(P[i], ~np.isnan(z_k[:, i]))
            # A dozen products of numbers of order 10.
            np.testing.assert_allclose(B[..., i], B_k * ~np.isnan(z_k[:, i]), rtol=1e-9, atol=1e-10)
