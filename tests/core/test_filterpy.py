"""Canaries: one for each trap of filterpy 2.0 that the package works around.

Each says whether the trap is still there. The day one of them fails, upstream has mended it: the message says what was
mended and what can go, the canary with it.
"""

import numpy as np
import pytest
from filterpy.common import Saver, kinematic_kf
from filterpy.kalman import KalmanFilter, rts_smoother

ZS = np.ones((4, 2))
COLUMN = np.zeros((2, 1))


def plain_filter(**options):
    kf = KalmanFilter(dim_x=2, dim_z=2)
    kf.H, kf.x = np.eye(2), np.zeros(2)
    for name, value in options.items():
        setattr(kf, name, value)
    return kf


def run(kf, *measurements):
    for z in measurements:
        kf.predict()
        kf.update(z)
    return kf


def refuses(action, words):
    """Whether the action raises a ValueError whose message holds one of these words."""
    try:
        action()
    except ValueError as error:
        return any(word in str(error) for word in words)
    return False


def batch_refuses_a_column():
    return refuses(lambda: plain_filter(x=COLUMN).batch_filter(ZS), ("shape", "broadcast", "dimension"))


def update_with_h_changes_x():
    kf = plain_filter(x=COLUMN)
    kf.predict()
    kf.update(np.ones(2), H=kf.H)
    return kf.x.shape == (2, 2)


def two_axes_measure_their_sum():
    return kinematic_kf(2, 1).H.tolist() == [[1, 0, 1, 0]]


def scalar_r_fills_the_matrix():
    return np.array_equal(run(plain_filter(R=5.0), np.ones(2)).S, [[7, 5], [5, 7]])


def nan_poisons_the_state():
    return np.isnan(run(plain_filter(), np.ones(2), np.full(2, np.nan), np.ones(2)).x).all()


def none_leaves_the_gain():
    return run(plain_filter(), np.ones(2), None).K.any()


def second_run_goes_on():
    kf = plain_filter()
    return not np.array_equal(kf.batch_filter(ZS)[0], kf.batch_filter(ZS)[0])


def gain_by_hand_has_no_likelihood():
    kf = plain_filter(K=np.eye(2) / 2)
    kf.predict_steadystate()
    kf.update_steadystate(np.ones(2))
    return kf.mahalanobis == 0 and kf.log_likelihood == -np.inf


def saver_refuses_a_missed_epoch():
    kf = plain_filter()
    saver = Saver(kf)
    for z in (np.ones(2), None):
        run(kf, z)
        saver.save()
    return refuses(saver.to_array, ["could not convert z"])


def update_is_in_joseph_form():
    """To the last bit: with a gain that is not the optimal one the short form (I - K H) P gives something else."""
    kf = plain_filter(P=np.array([[2.0, 0.3], [0.3, 1.0]]))
    kf.inv = lambda S: np.eye(2) / 2
    P = kf.P
    kf.update(np.ones(2))
    rest = np.eye(2) - P / 2
    return np.allclose(kf.P, rest @ P @ rest.T + P / 2 @ kf.R @ P.T / 2, rtol=1e-14, atol=0)


def free_smoother_takes_the_step_before():
    """Of epochs with steps of their own, F[k] leads to epoch k in batch_filter and in the method, and from it here."""
    kf = plain_filter(P=np.array([[2.0, 0.3], [0.3, 1.0]]))
    F = [np.array([[1.0, dt], [0.0, 1.0]]) for dt in (1.0, 2.0, 3.0, 4.0)]
    Q = [dt * np.eye(2) for dt in (1.0, 2.0, 3.0, 4.0)]
    x, P, *_ = kf.batch_filter(ZS, Fs=F, Qs=Q)
    right = kf.rts_smoother(x, P, F, Q)
    shifted, one_later = rts_smoother(x, P, F, Q), rts_smoother(x, P, F[1:], Q[1:])
    return np.array_equal(one_later[0], right[0]) and not np.allclose(shifted[0], right[0], rtol=1e-3)


def asks_for_no_python():
    from importlib.metadata import metadata

    return metadata("filterpy").get("Requires-Python") is None


# What upstream has mended when the canary fails, and what can go then.
CANARIES = {
    batch_refuses_a_column: (
        "batch_filter takes vectors with a column x",
        "KalmanFilter.next_step need no longer set a state of one dimension",
    ),
    update_with_h_changes_x: (
        "update(z, H=H) keeps the shape of x",
        "KalmanFilter.next_step may pass H to update",
    ),
    two_axes_measure_their_sum: (
        "kinematic_kf of several axes measures each axis",
        "model.stack is no longer the only way to several axes",
    ),
    scalar_r_fills_the_matrix: (
        "a scalar R is put on the diagonal of S",
        "LinearModel may take a scalar R",
    ),
    nan_poisons_the_state: (
        "NaN is a missed epoch, or refused",
        "KalmanFilter.next_step may leave missing measurements to filterpy",
    ),
    none_leaves_the_gain: (
        "update(None) sets the gain to zero",
        "KalmanFilter.next_step may pass None where nothing is measured",
    ),
    second_run_goes_on: (
        "a second batch_filter starts anew",
        "KalmanFilter.next_step may use one filterpy object for all steps",
    ),
    gain_by_hand_has_no_likelihood: (
        "update_steadystate has an innovation covariance",
        "metrics.innovations of a SteadyStateFilter may leave S to filterpy",
    ),
    saver_refuses_a_missed_epoch: (
        "Saver.to_array takes a missed epoch",
        "benchmarks/peers.py may leave the recording to Saver",
    ),
    update_is_in_joseph_form: (
        "update is no longer in Joseph form",
        "burden may count and time filterpy; but covariances are semidefinite by this form: see docs/accuracy.md",
    ),
    free_smoother_takes_the_step_before: (
        "rts_smoother as a function takes the same F and Q as batch_filter",
        "nothing: the tests compare with the method; they may use either",
    ),
    asks_for_no_python: (
        "filterpy says which Python it needs",
        "its exact pin in environment.txt",
    ),
}


@pytest.mark.parametrize("trap", CANARIES, ids=lambda trap: trap.__name__)
def test_trap_is_still_there(trap):
    mended, can_go = CANARIES[trap]
    assert trap(), f"mended upstream: {mended}. What can go: {can_go}, and this canary ({trap.__name__})."
