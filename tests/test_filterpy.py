"""Canaries: one test for each trap of filterpy 2.0 that `KalmanFilter` works around.

Each asserts that the trap is still there. The day one of them fails, upstream has mended it: drop the way around, and
the test.
"""

import numpy as np
import pytest
from filterpy.common import Saver, kinematic_kf
from filterpy.kalman import KalmanFilter

ZS = np.ones((4, 2))


def plain_filter(**options):
    kf = KalmanFilter(dim_x=2, dim_z=2)
    kf.H, kf.x = np.eye(2), np.zeros(2)
    for name, value in options.items():
        setattr(kf, name, value)
    return kf


def test_batch_filter_with_a_column_state_refuses_vectors():
    with pytest.raises(ValueError, match=r"shape|broadcast|dimension"):
        plain_filter(x=np.zeros((2, 1))).batch_filter(ZS)


def test_passing_h_to_update_changes_the_shape_of_x():
    kf = plain_filter(x=np.zeros((2, 1)))
    kf.predict()
    kf.update(np.ones(2), H=kf.H)
    assert kf.x.shape == (2, 2)


def test_kinematic_filter_of_two_axes_measures_their_sum():
    assert kinematic_kf(2, 1).H.tolist() == [[1, 0, 1, 0]]


def test_scalar_r_is_added_to_every_entry():
    kf = plain_filter(R=5.0)
    kf.predict()
    kf.update(np.ones(2))
    np.testing.assert_array_equal(kf.S, [[7, 5], [5, 7]])


def test_nan_poisons_every_later_state():
    kf = plain_filter()
    for z in (np.ones(2), np.full(2, np.nan), np.ones(2)):
        kf.predict()
        kf.update(z)
    assert np.isnan(kf.x).all()


def test_a_missed_epoch_leaves_the_gain_of_the_last_update():
    kf = plain_filter()
    kf.predict()
    kf.update(np.ones(2))
    kf.predict()
    kf.update(None)
    assert kf.K.any()


def test_a_second_run_starts_from_the_last_state():
    kf = plain_filter()
    first, second = kf.batch_filter(ZS)[0], kf.batch_filter(ZS)[0]
    assert not np.array_equal(first, second)


def test_a_gain_set_by_hand_has_no_likelihood():
    kf = plain_filter(K=np.eye(2) / 2)
    kf.predict_steadystate()
    kf.update_steadystate(np.ones(2))
    assert kf.mahalanobis == 0
    assert kf.log_likelihood == -np.inf


def test_saver_cannot_take_a_missed_epoch():
    kf = plain_filter()
    saver = Saver(kf)
    for z in (np.ones(2), None):
        kf.predict()
        kf.update(z)
        saver.save()
    with pytest.raises(ValueError, match="could not convert z"):
        saver.to_array()
