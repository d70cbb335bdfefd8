"""Kalman, Lainiotis, joint, steady-state and FIR filters for mobile position tracking, over filterpy."""

__version__ = "0.2.0"

from . import metrics, riccati
from .combined import JoinFilter, Separate, six_filters
from .filters import KalmanFilter, LainiotisFilter
from .ledger import Table, gap_text, published
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
    "Table",
    "constant_acceleration",
    "constant_velocity",
    "exact_motion",
    "fir_order",
    "gap_text",
    "gps_ins",
    "gsm_axis",
    "mean_track",
    "metrics",
    "published",
    "riccati",
    "simulate",
    "six_filters",
    "stack",
    "study",
]
