"""Kalman, Lainiotis, joint, steady-state and FIR filters for mobile position tracking, over filterpy.

To see how the filters work, read in this order:

- `recursion`: x(k+1) = A_k x(k) + B_k z(k+1) as a plain loop, and as `run`, which takes several steps in one product;
- `filters`: A_k, B_k and P in `next_step`, and gaps; `riccati.lainiotis_matrices` has the constants of Lainiotis;
- `steady`: filters with the limits of A_k and B_k as constants, the prediction of their state, and their FIR form;
- `combined`: the mean of two filters, and one filter for each axis.

`model` has the models, `riccati` the limits, `columns` tracks whose gaps differ, `metrics` the judgement of results,
`monte_carlo` studies of many runs, `checks` the refusal of bad input. The rest reproduces the papers.
"""

__version__ = "0.2.0"

from . import metrics, riccati
from .combined import JoinFilter, Separate, six_filters
from .filters import KalmanFilter, LainiotisFilter
from .fitting import fit
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
from .predictor import Predictor, SteadyStatePredictor
from .steady import FIRFilter, SteadyStateFilter, fir_order

__all__ = [
    "FIRFilter",
    "JoinFilter",
    "KalmanFilter",
    "LainiotisFilter",
    "LinearModel",
    "Predictor",
    "Separate",
    "SteadyStateFilter",
    "SteadyStatePredictor",
    "Table",
    "constant_acceleration",
    "constant_velocity",
    "exact_motion",
    "fir_order",
    "fit",
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
