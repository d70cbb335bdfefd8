"""Kalman, Lainiotis, joint, steady-state and FIR filters for mobile position tracking, over filterpy.

To see how the filters work, read in this order:

- `model`: x(k+1) = F x(k) + w(k), z(k) = H x(k) + v(k), and the papers' models; `motion`: F and Q of a step of any
  length, and how to write a motion of your own;
- `equations`: one Kalman step and one Lainiotis step, equation by equation;
- `filters`: A_k, B_k and P of both filters in `next_step`; `steady`: their limits as constants, and the FIR form;
- `recursive`: what every filter offers, and what the package asks of it;
- `epochs`: measurements with the conditions that they were made under, as one value;
- `engine`: the run of a filter over tracks. It has two ways: `steps`, which tracks without gaps share, and `columns`,
  for tracks with gaps, times and precisions of their own;
- `partition`: a long track as many short columns, and how these are run;
- `smoothing`: the way back;
- `combined`: the mean of two filters, and one filter for each axis; `predictor`: states some steps ahead.

`riccati` solves for the limits, `metrics` and `bands` judge results, `fitting` finds the parameters of a model by
`search`, `lasting` models errors that last, `monte_carlo` runs studies of many runs, `checks` refuses bad input,
`algebra` and `immutable` serve the others.

Papers are cited by their year:

- 2007: Kluga & Kluga, Modeling Information Complex Processing with MMS-Kalman Filter;
- 2014: Assimakis & Adam, Global Systems for Mobile Position Tracking Using Kalman and Lainiotis Filters;
- 2015: Assimakis & Adam, Mobile Position Tracking in Three Dimensions using Kalman and Lainiotis Filters;
- 2016: Assimakis, Tziallas, Adam, Polyzos & Papanastasiou, Mobile Position Estimation and Prediction Using Steady State
  Kalman Filter.

For a recorded track: `tracks` does all of it, from a file read by `recordings` to a line cleaned by `cleaning`, which
asks `gate` for faults, and told by `report`; `track_command` is the same for a terminal. `geodesy`, `files` and `plots`
serve these.
"""

__version__ = "0.5.0.dev0"

from importlib import import_module
from typing import TYPE_CHECKING, Any

from . import bands, lasting, metrics, riccati
from .combined import JoinFilter, Separate, six_filters
from .filters import KalmanFilter, LainiotisFilter
from .fitting import fit, rescaled
from .gate import gated
from .lasting import fit_lasting, lasting_error
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
    "bands",
    "constant_acceleration",
    "constant_velocity",
    "exact_motion",
    "fir_order",
    "fit",
    "fit_lasting",
    "gated",
    "gps_ins",
    "gsm_axis",
    "lasting",
    "lasting_error",
    "mean_track",
    "metrics",
    "rescaled",
    "riccati",
    "simulate",
    "six_filters",
    "stack",
    "study",
    "track",
    "tracks",
]


def __getattr__(name: str) -> Any:
    """Import `tracks` when it or `track` is first asked for: its readers of files would slow every import down."""
    if name not in ("track", "tracks"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    tracks = import_module(".tracks", __name__)
    globals().update(tracks=tracks, track=tracks.track)  # from now on both are found without this function
    return globals()[name]


def __dir__() -> list[str]:
    return sorted({*globals(), "track", "tracks"})
