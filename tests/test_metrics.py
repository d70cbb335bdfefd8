import numpy as np
import pytest
from conftest import AXIS

import mpt_helpers as mpt
from mpt_helpers.metrics import largest_gaps, relative_gap, rms


class Shifted:
    """The Kalman filter of one axis, off by a constant in one component of x and in one of P."""

    def __init__(self, x=0.0, P=0.0, P_sv=0.0):
        self.kf, self.x, self.P = mpt.KalmanFilter(AXIS), np.array([0, x]), np.array([[0, P_sv], [P_sv, P]])

    def filter(self, z):
        return self.kf.filter(z) + self.x

    def covariances(self, N):
        return self.kf.covariances(N) + self.P


def test_largest_gaps_are_those_of_the_component_that_is_off():
    _, z = mpt.simulate(AXIS, 50, np.random.default_rng(0))
    reference = Shifted()
    speed, P_v = np.abs(reference.filter(z)[:, 1]).max(), reference.covariances(50)[:, 1, 1].min()
    assert largest_gaps(reference, [Shifted()], z) == (0, 0)
    assert largest_gaps(reference, [Shifted(), Shifted(x=0.1)], z) == (pytest.approx(0.1 / speed), 0)
    assert largest_gaps(reference, [Shifted(P=0.001), Shifted()], z) == (0, pytest.approx(0.001 / P_v))
    product = np.sqrt(np.prod(np.einsum("kii->ki", reference.covariances(50)), axis=1)).min()
    assert largest_gaps(reference, [Shifted(P_sv=0.001)], z) == (0, pytest.approx(0.001 / product))


def test_filters_that_differ_have_gaps():
    _, z = mpt.simulate(AXIS, 50, np.random.default_rng(0))
    x_gap, P_gap = largest_gaps(mpt.KalmanFilter(AXIS), [mpt.SteadyStateFilter.from_kalman(AXIS)], z)
    assert x_gap > 1e-3
    assert P_gap > 0.1


def test_relative_gap_and_rms():
    assert relative_gap([[1.0, 2.0]], [[1.0, -4.0]]) == pytest.approx(6 / 4)
    assert rms([3.0, 4.0]) == pytest.approx(np.sqrt(12.5))
    np.testing.assert_allclose(rms([[3.0, 4.0], [0.0, 2.0]], axis=0), [np.sqrt(4.5), np.sqrt(10)])
