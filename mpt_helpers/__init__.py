"""Kalman, Lainiotis, joint, steady-state and FIR filters for mobile position tracking, over filterpy.

To see how the filters work, read in this order:

- `recursion.recursion`: the loop x(k+1) = A_k x(k) + B_k z(k+1) that every filter runs;
- `filters.KalmanFilter.next_step` and `filters.LainiotisFilter.next_step`: A_k, B_k and P from one step to the next;
- `steady`: the limits of A_k and B_k, their prediction N steps ahead, and their FIR form;
- `combined`: the mean of two filters, and one filter for each axis.

All else makes this fast for many tracks (`recursion.run`, `columns`), solves for the limits (`riccati`), judges the
results (`metrics`) or refuses bad input (`checks`).
"""

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
