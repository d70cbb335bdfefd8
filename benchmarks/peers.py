"""Other libraries' Kalman filters over the same tracks: functions of z (N, m, M) or (N, m).

Each starts from x(0/0) and P(0/0) of the model; those that take the state before the first measurement instead get
F x0 and F P0 Fᵀ + Q.
"""

import filterpy.kalman
import numpy as np
import simdkalman
from statsmodels.tsa.statespace.kalman_smoother import KalmanSmoother

from mpt_helpers.equations import predicted_covariance

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
