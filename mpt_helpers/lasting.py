"""The error state: a model whose measurements also have an error that lasts."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from . import checks
from .checks import Seconds
from .model import LinearModel


def lasting_error(model: LinearModel, sigma: ArrayLike, tau: ArrayLike, dt: Seconds | None = None) -> LinearModel:
    """Return `model` with one more state for each measurement: an error that fades slowly (Gauss-Markov, first order).

        e(k+1) = a e(k) + w(k),   a = exp(-dt / tau),   w ~ N(0, sigma² (1 - a²)),   e(0) ~ N(0, sigma²)
        z(k)   = H x(k) + e(k) + v(k)

    The new states follow those of the model, one for each row of H, and R stays the noise of one measurement. sigma is
    the standard deviation of the lasting error, in the units of the measurement, tau the time in seconds after which
    its correlation has fallen to 1/e; both are a number, or one for each measurement. dt is the time step in seconds,
    of a model that does not say it itself. All steps share it: a filter that is given times refuses such a model.

    A filter of this model cannot take the lasting error off a position that it knows from the same measurements. What
    changes is what it states: the error of the position does not fall below what lasts.

    Raises ValueError for sigma < 0, tau <= 0, another number of them, and a dt that is not positive, that is missing,
    or that is not the model's own; TypeError for anything but a model.

    >>> from mpt_helpers.model import constant_velocity
    >>> axis = constant_velocity(dt=30.0, q=0.0, r=0.04)
    >>> model = lasting_error(axis, sigma=1.0, tau=3600.0)
    >>> model.H
    array([[1., 0., 1.]])
    >>> model.F[2, 2].round(4), model.Q[2, 2].round(4), model.P0[2, 2]
    (np.float64(0.9917), np.float64(0.0165), np.float64(1.0))
    """
    checks.instance("model", model, LinearModel)
    variance = _of_each("sigma", sigma, model.m, checks.not_negative) ** 2
    a = np.exp(-_step_of(model, dt) / _of_each("tau", tau, model.m, checks.positive))
    return LinearModel(
        F=block_diag(model.F, np.diag(a)),
        H=np.hstack([model.H, np.eye(model.m)]),
        Q=block_diag(model.Q, np.diag(variance * (1 - a**2))),
        R=model.R,
        x0=np.append(model.x0, np.zeros(model.m)),
        P0=block_diag(model.P0, np.diag(variance)),
    )


def _step_of(model, dt):
    """Return the time step of a model in seconds: its own, or dt where it has none, or raise."""
    if dt is None and model.dt is None:
        checks.refuse("dt", "the time step in seconds, which this model does not say", "none")
    step = checks.positive("dt", checks.as_seconds(model.dt if dt is None else dt))
    if model.dt not in (None, step):
        checks.refuse("dt", f"the model's own time step, {model.dt:g} s", f"{step:g} s")
    return step


def _of_each(name, value, m, accept):
    """Return a number for each of m measurements, (m,), from one number or from m of them, or raise."""
    values = checks.real_numbers(name, value, f"a number, or {m} numbers")
    if values.shape not in ((), (m,)):
        checks.refuse(name, f"a number, or {m} numbers", f"shape {values.shape}")
    return np.array([accept(name, each) for each in np.broadcast_to(values, (m,)).tolist()])
