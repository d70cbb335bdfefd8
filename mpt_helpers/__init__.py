"""Kalman, Lainiotis, joint, steady-state and FIR filters for mobile position tracking, over filterpy."""

__version__ = "0.1.0"

from . import burden, figures, metrics, riccati
from .figures import save_figure
from .filters import (
    FIRFilter,
    JoinFilter,
    KalmanFilter,
    LainiotisFilter,
    Separate,
    SteadyStateFilter,
    fir_order,
    six_filters,
)
from .model import LinearModel, gsm_axis, simulate, stack
from .published import published
from .tables import Table, gap_text

__all__ = [
    "FIRFilter",
    "JoinFilter",
    "KalmanFilter",
    "LainiotisFilter",
    "LinearModel",
    "Separate",
    "SteadyStateFilter",
    "Table",
    "burden",
    "figures",
    "fir_order",
    "gap_text",
    "gsm_axis",
    "metrics",
    "published",
    "riccati",
    "save_figure",
    "simulate",
    "six_filters",
    "stack",
]
