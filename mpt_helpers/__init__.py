"""Kalman, Lainiotis, joint, steady-state and FIR filters for mobile position tracking, over filterpy."""

__version__ = "0.2.0"

from . import metrics, riccati
from .combined import JoinFilter, Separate, six_filters
from .filters import KalmanFilter, LainiotisFilter
from .model import (
    LinearModel,
    constant_acceleration,
    constant_velocity,
    exact_motion,
    gps_ins,
    gsm_axis,
    mean_track,
    simulate,
    stack,
)
from .monte_carlo import study
from .steady import FIRFilter, SteadyStateFilter, SteadyStatePredictor, fir_order

__all__ = [
    "FIRFilter",
    "JoinFilter",
    "KalmanFilter",
    "LainiotisFilter",
    "LinearModel",
    "Separate",
    "SteadyStateFilter",
    "SteadyStatePredictor",
    "constant_acceleration",
    "constant_velocity",
    "exact_motion",
    "fir_order",
    "gps_ins",
    "gsm_axis",
    "mean_track",
    "metrics",
    "riccati",
    "simulate",
    "six_filters",
    "stack",
    "study",
]
