"""Other libraries' Kalman filters over the same tracks: functions of z (N, m, M) or (N, m).

Each starts from x(0/0) and P(0/0) of the model; those that take the state before the first measurement instead get
F x0 and F P0 Fᵀ + Q.
"""

import ctypes
import json
import shutil
import subprocess
import tempfile
from pathlib import Path

import filterpy.kalman
import numpy as np
import simdkalman
from scipy.signal import lfilter, ss2tf
from statsmodels.tsa.statespace.kalman_smoother import KalmanSmoother

from mpt_helpers.equations import predicted_covariance

HERE = Path(__file__).parent
COMPILER = shutil.which("cc")
LESSON = HERE.parent / "notebooks" / "lessons" / "a_track_in_pieces.ipynb"
TAUGHT = ("filter", "pretend", "mend-code", "in-pieces")  # the cells of it that define its filters

try:
    import jax
    from dynamax.linear_gaussian_ssm import lgssm_filter
    from dynamax.linear_gaussian_ssm.inference import make_lgssm_params

    jax.config.update("jax_enable_x64", True)
    DYNAMAX = True
except ImportError:  # it needs jax, which not every machine has
    DYNAMAX = False


def before_first(model):
    """Return mean and covariance of x(1/0)."""
    return model.F @ model.x0, predicted_covariance(model, model.P0, 1)


def filterpy_batch(model):
    """Make a filter of one track from filterpy's `batch_filter`; x is a column, which filterpy 2.0 needs here."""

    def one(z):
        kf = filterpy.kalman.KalmanFilter(dim_x=model.n, dim_z=model.m)
        kf.F, kf.H, kf.Q, kf.R = (each.copy() for each in (model.F, model.H, model.Q, model.R))
        kf.x, kf.P = model.x0[:, None].copy(), model.P0.copy()
        return kf.batch_filter(z[..., None])[0][..., 0]

    return one


def filterpy_steps(model):
    """Make a loop of filterpy's predict and update for one track, as its documentation shows it."""

    def one(z):
        kf = filterpy.kalman.KalmanFilter(dim_x=model.n, dim_z=model.m)
        kf.F, kf.H, kf.Q, kf.R = (each.copy() for each in (model.F, model.H, model.Q, model.R))
        kf.x, kf.P = model.x0.copy(), model.P0.copy()
        x = np.empty((len(z), model.n))
        for k, z_k in enumerate(z):
            kf.predict()
            kf.update(z_k)
            x[k] = kf.x
        return x

    return one


def filterpy_estimates(model):
    """Make the same loop, which keeps covariances too; a row of NaN is an epoch that is missed."""

    def one(z):
        kf = filterpy.kalman.KalmanFilter(dim_x=model.n, dim_z=model.m)
        kf.F, kf.H, kf.Q, kf.R = (each.copy() for each in (model.F, model.H, model.Q, model.R))
        kf.x, kf.P = model.x0.copy(), model.P0.copy()
        x, P = np.empty((len(z), model.n)), np.empty((len(z), model.n, model.n))
        for k, z_k in enumerate(z):
            kf.predict()
            kf.update(None if np.isnan(z_k[0]) else z_k)
            x[k], P[k] = kf.x, kf.P
        return x, P

    return one


def statsmodels_of(model, z):
    """Make statsmodels' state space model of one track z (N, m), in C: it has `filter`, `loglike` and `smooth`."""
    made = KalmanSmoother(k_endog=model.m, k_states=model.n, k_posdef=model.n)
    made.bind(np.asfortranarray(z.T))
    made["design"], made["transition"], made["selection"] = model.H, model.F, np.eye(model.n)
    made["obs_cov"], made["state_cov"] = model.R, model.Q
    made.initialize_known(*before_first(model))
    return made


def filterpy_loop(model):
    """Make the same of many tracks, one after the other."""
    one = filterpy_steps(model)
    return lambda z: np.stack([one(np.ascontiguousarray(z[..., i])) for i in range(z.shape[2])], axis=-1)


def simdkalman_all(model):
    """Make a filter from `compute` of simdkalman, all tracks at once: estimates (N, n, M), covariances (N, n, n, M)."""
    mean, covariance = before_first(model)
    kf = simdkalman.KalmanFilter(
        state_transition=model.F, process_noise=model.Q, observation_model=model.H, observation_noise=model.R
    )

    def many(z):
        start = {"initial_value": mean, "initial_covariance": covariance}
        tracks_first = np.ascontiguousarray(z.transpose(2, 0, 1))
        data = tracks_first[..., 0] if model.m == 1 else tracks_first
        states = kf.compute(data, 0, smoothed=False, filtered=True, **start).filtered.states
        return np.moveaxis(states.mean, 0, 2), np.moveaxis(states.cov, 0, 3)

    return many


def simdkalman_smoother(model):
    """Make the smoother of simdkalman, all tracks at once: states (N, n, M) and covariances (N, n, n, M)."""
    mean, covariance = before_first(model)
    kf = simdkalman.KalmanFilter(
        state_transition=model.F, process_noise=model.Q, observation_model=model.H, observation_noise=model.R
    )

    def many(z):
        start = {"initial_value": mean, "initial_covariance": covariance}
        data = np.ascontiguousarray(z.transpose(2, 0, 1))
        states = kf.compute(data[..., 0] if model.m == 1 else data, 0, smoothed=True, **start).smoothed.states
        return np.moveaxis(states.mean, 0, 2), np.moveaxis(states.cov, 0, 3)

    return many


def dynamax_vmap(model):
    """Make a filter from that of dynamax, compiled and mapped over all tracks; only the means are asked for."""
    arrays = (jax.numpy.asarray(each) for each in (*before_first(model), model.F, model.Q, model.H, model.R))
    parameters = make_lgssm_params(*arrays)
    means = jax.jit(jax.vmap(lambda z: lgssm_filter(parameters, z).filtered_means, in_axes=2, out_axes=2))
    return lambda z: means(z).block_until_ready()


# One track of one axis whose positions are measured, H = [1 0], from x(0/0) = 0 and P(0/0) = p I, gaps as NaN: the code
# of the lesson on pieces, and what somebody might write instead. Each takes z (N, 1).


def taught():
    """Return what the lesson on pieces defines, by name: `step`, `one_by_one` and `in_pieces`."""
    names, cells = {}, json.loads(LESSON.read_text(encoding="utf-8"))["cells"]
    for cell in cells:
        if cell["id"] in TAUGHT:
            exec("".join(cell["source"]), names)
    return names


def _numbers(model):
    """Return dt, the three entries of Q, r and p of such a model, as Python numbers."""
    Q = model.Q
    return (*map(float, (model.F[0, 1], Q[0, 0], Q[0, 1], Q[1, 1], model.R[0, 0], model.P0[0, 0])),)


def plain_numbers(model):
    """Make the loop with F, P and K written out as Python numbers: two unknowns, by hand."""
    dt, q00, q01, q11, r, p = _numbers(model)

    def one(z):
        s, v, p00, p01, p11 = 0.0, 0.0, p, 0.0, p
        found = []
        for z_k in z[:, 0].tolist():
            s += dt * v
            p00 += dt * (2 * p01 + dt * p11) + q00
            p01 += dt * p11 + q01
            p11 += q11
            if z_k == z_k:  # NaN, a missing measurement, is unequal to itself
                variance = p00 + r
                k0, k1, surprise = p00 / variance, p01 / variance, z_k - s
                s += k0 * surprise
                v += k1 * surprise
                p11 -= k1 * p01
                p01 -= k1 * p00
                p00 -= k0 * p00
            found.append((s, v))
        return np.array(found)

    return one


def in_c(model):
    """Make the same loop in C (kalman.c), compiled for this machine."""
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "kalman.so"
        subprocess.run([COMPILER, "-O2", "-shared", "-fPIC", HERE / "kalman.c", "-o", library], check=True)
        kalman = ctypes.CDLL(library).kalman
    array = np.ctypeslib.ndpointer(float, flags="C_CONTIGUOUS")
    number = ctypes.c_double
    kalman.argtypes = [array, ctypes.c_long, number, array, number, number, array]
    dt, q00, q01, q11, r, p = _numbers(model)
    Q = np.array([q00, q01, q11])

    def one(z):
        found = np.empty((len(z), 2))
        kalman(np.ascontiguousarray(z[:, 0]), len(z), dt, Q, r, p, found)
        return found

    return one


def by_lfilter(steady):
    """Make scipy's `lfilter` of the position from a steady-state filter; nothing may be missing. It starts at z[0]."""
    weights, feedback = ss2tf(steady.A, steady.B, steady.A[:1], steady.B[:1])

    def one(z):
        return z[0, 0] + lfilter(weights[0], feedback, z[:, 0] - z[0, 0])

    return one
