"""Kalman, Lainiotis, joint, steady-state and FIR filters for mobile position tracking, over filterpy."""

__version__ = "0.1.0"

from . import average_error, burden, figures, metrics, positioning, riccati, trials
from .figures import save_figure
from .filters import (
    FIRFilter,
    JoinFilter,
    KalmanFilter,
    LainiotisFilter,
    Separate,
    SteadyStateFilter,
    SteadyStatePredictor,
    fir_order,
    six_filters,
)
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
from .published import published
from .study import study
from .tables import Table, gap_text

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
    "average_error",
    "burden",
    "constant_acceleration",
    "constant_velocity",
    "exact_motion",
    "figures",
    "fir_order",
    "gap_text",
    "gps_ins",
    "gsm_axis",
    "mean_track",
    "metrics",
    "positioning",
    "published",
    "riccati",
    "save_figure",
    "simulate",
    "six_filters",
    "stack",
    "study",
    "trials",
]
