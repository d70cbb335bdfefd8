"""Other libraries' Kalman filters over the same tracks: functions of z (N, m, M) that return (N, n, M).

Each starts from x(0/0) and P(0/0) of the model; those that take the state before the first measurement instead get
F x0 and F P0 Fᵀ + Q.
"""

import filterpy.kalman
import jax
import numba
import numpy as np
import pykalman
import simdkalman
from dynamax.linear_gaussian_ssm import lgssm_filter
from dynamax.linear_gaussian_ssm.inference import make_lgssm_params
from statsmodels.tsa.statespace.kalman_filter import KalmanFilter as StatsmodelsFilter

from mpt_helpers.model import predicted_covariance

jax.config.update("jax_enable_x64", True)


def before_first(model):
    """Return mean and covariance of x(1/0)."""
    return model.F @ model.x0, predicted_covariance(model, model.P0, 1)


def track_by_track(one):
    """Make a filter of many tracks from one that takes z (N, m) and returns (N, n)."""
    return lambda z: np.stack([one(np.ascontiguousarray(z[..., i])) for i in range(z.shape[2])], axis=-1)


def filterpy_batch(model):
    """Make a filter of one track from filterpy's `batch_filter`; x is a column, which filterpy 2.0 needs here."""

    def one(z):
        kf = filterpy.kalman.KalmanFilter(dim_x=model.n, dim_z=model.m)
        kf.F, kf.H, kf.Q, kf.R = (each.copy() for each in (model.F, model.H, model.Q, model.R))
        kf.x, kf.P = model.x0[:, None].copy(), model.P0.copy()
        return kf.batch_filter(z[..., None])[0][..., 0]

    return one


def filterpy_loop(model):
    """Make a loop of filterpy's predict and update for each track, as its documentation shows it."""

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

    return track_by_track(one)


def pykalman_loop(model):
    """Make a filter from that of pykalman, track by track."""
    mean, covariance = before_first(model)
    kf = pykalman.KalmanFilter(
        transition_matrices=model.F,
        observation_matrices=model.H,
        transition_covariance=model.Q,
        observation_covariance=model.R,
        initial_state_mean=mean,
        initial_state_covariance=covariance,
    )
    return track_by_track(lambda z: kf.filter(z)[0])


def simdkalman_all(model):
    """Make a filter from `compute` of simdkalman, all tracks at once (one measurement)."""
    mean, covariance = before_first(model)
    kf = simdkalman.KalmanFilter(
        state_transition=model.F, process_noise=model.Q, observation_model=model.H, observation_noise=model.R
    )

    def many(z):
        start = {"initial_value": mean, "initial_covariance": covariance}
        result = kf.compute(z[:, 0].T, 0, smoothed=False, filtered=True, **start)
        return np.moveaxis(result.filtered.states.mean, 0, 2)

    return many


def statsmodels_loop(model):
    """Make a filter from the compiled one of statsmodels, track by track."""
    mean, covariance = before_first(model)

    def one(z):
        kf = StatsmodelsFilter(
            k_endog=model.m,
            k_states=model.n,
            transition=model.F,
            design=model.H,
            selection=np.eye(model.n),
            state_cov=model.Q,
            obs_cov=model.R,
        )
        kf.bind(z)
        kf.initialize_known(mean, covariance)
        return kf.filter().filtered_state.T

    return track_by_track(one)


def dynamax_vmap(model):
    """Make a filter from that of dynamax, compiled and mapped over all tracks; only the means are asked for."""
    arrays = (jax.numpy.asarray(each) for each in (*before_first(model), model.F, model.Q, model.H, model.R))
    parameters = make_lgssm_params(*arrays)
    means = jax.jit(jax.vmap(lambda z: lgssm_filter(parameters, z).filtered_means, in_axes=2, out_axes=2))
    return lambda z: means(z).block_until_ready()


def numba_loop(model, coefficients):
    """Make the recursion over ready coefficients of compiled loops, tracks innermost, on all cores."""
    A, B, x0 = coefficients.A, coefficients.B, model.x0
    return lambda z: _numba(A, B, z, x0)


@numba.njit(parallel=True)
def _numba(A, B, z, x0):
    (N, m, M), n = z.shape, len(x0)
    x = np.empty((N, n, M))
    width = 512
    for tile in numba.prange((M + width - 1) // width):
        for k in range(N):
            for i in range(n):
                for t in range(tile * width, min(M, (tile + 1) * width)):
                    s = 0.0
                    for j in range(n):
                        s += A[k, i, j] * (x[k - 1, j, t] if k else x0[j])
                    for j in range(m):
                        s += B[k, i, j] * z[k, j, t]
                    x[k, i, t] = s
    return x
