"""Kalman, Lainiotis, joint, steady-state and FIR filters for mobile position tracking, over filterpy.

To see how the filters work, read in this order:

- `equations`: predicted covariance, gain, Joseph's form, and one Lainiotis step;
- `model`: x(k+1) = F x(k) + w(k), z(k) = H x(k) + v(k), the papers' models, and F and Q of a step of any length;
- `kalman`, `lainiotis`: A_k, B_k and P of both filters in `next_step`; `steady`: their limits as constants, and the FIR
  form;
- `combined`: the mean of two filters, and one filter for each axis; `predictor`: predictions some steps ahead;
- `riccati` solves for the limits, `metrics` and `bands` judge results, `fitting` estimates the parameters of a model by
  means of `search`, `monte_carlo` repeats experiments;
- `_base`: what every filter offers; `_engine`: how a filter runs over tracks, in `columns` (one epoch), `run`, `shared`
  (tracks without gaps), `pieces` (a long track) and `smoother` (the backward pass).

Papers are cited by their year:

- 2007: Kluga & Kluga, Modeling Information Complex Processing with MMS-Kalman Filter;
- 2014: Assimakis & Adam, Global Systems for Mobile Position Tracking Using Kalman and Lainiotis Filters;
- 2015: Assimakis & Adam, Mobile Position Tracking in Three Dimensions using Kalman and Lainiotis Filters;
- 2016: Assimakis, Tziallas, Adam, Polyzos & Papanastasiou, Mobile Position Estimation and Prediction Using Steady State
  Kalman Filter.

For a recorded track: `tracks`, from a file to a smoothed line with its error.
"""

__version__ = "0.5.0.dev0"

from importlib import import_module
from typing import TYPE_CHECKING, Any

from . import bands, metrics, riccati
from ._base import RecursiveFilter
from .combined import JoinFilter, Separate, six_filters
from .fitting import fit
from .kalman import KalmanFilter
from .lainiotis import LainiotisFilter
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

if TYPE_CHECKING:
    from . import tracks
    from .tracks import track
    from .tracks.gate import gated

LATER = "gated", "track", "tracks"

__all__ = [
    "FIRFilter",
    "JoinFilter",
    "KalmanFilter",
    "LainiotisFilter",
    "LinearModel",
    "Predictor",
    "RecursiveFilter",
    "Separate",
    "SteadyStateFilter",
    "SteadyStatePredictor",
    "bands",
    "constant_acceleration",
    "constant_velocity",
    "exact_motion",
    "fir_order",
    "fit",
    "gated",
    "gps_ins",
    "gsm_axis",
    "mean_track",
    "metrics",
    "riccati",
    "simulate",
    "six_filters",
    "stack",
    "study",
    "track",
    "tracks",
]


def __getattr__(name: str) -> Any:
    """Import `tracks` when it, `track` or `gated` is first asked for: readers of files would slow every import down."""
    if name not in LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    tracks = import_module(".tracks", __name__)
    globals().update(tracks=tracks, track=tracks.track, gated=tracks.gate.gated)  # found without this function
    return globals()[name]


def __dir__() -> list[str]:
    return sorted({*globals(), *LATER})
