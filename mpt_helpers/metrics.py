"""How far estimates lie from each other and from the truth, and how far they should."""

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_lyapunov
from scipy.special import erf, gammaincinv

from . import checks
from .filters import SteadyStateFilter, require_covariances
from .model import LinearModel, predicted_covariance
from .recursion import measurements, shaped


def relative_gap(a, b):
    """Return the largest difference between two arrays of one shape, relative to the largest entry of the second.

    Raises ValueError or TypeError for anything else, and for NaN.

    >>> relative_gap([1.0, 2.0], [1.0, 4.0])
    0.5
    """
    a, b = (checks.finite(name, each) for name, each in (("a", a), ("b", b)))
    if a.shape != b.shape or not b.any():
        checks.refuse("a", "the shape of b, which is not all zero", f"{a.shape}, b {b.shape}")
    return float(np.abs(a - b).max() / np.abs(b).max())


def largest_gaps(reference, others, z):
    """Return how far other filters are from one on the same measurements (N, m), in estimates and in covariances.

    Both are the largest over the others, the steps and the components: of the estimates relative to the largest
    estimate of that component, of the covariances relative to the standard deviations of both components at that step.

    Raises ValueError or TypeError for anything but filters of one model that state their covariances, measurements of
    one track, and where a component of the estimates or a variance is zero throughout.
    """
    require_covariances("reference", reference)
    for i, each in enumerate(others := checks.several("others", others, "at least one filter")):
        if require_covariances(f"others[{i}]", each).model != reference.model:
            checks.refuse(f"others[{i}]", "a filter of the same model as the reference", "one of another model")
    if shaped(z, reference.model.m).ndim != 2:
        checks.refuse("z", f"an (N, {reference.model.m}) array of one track", "many tracks")
    x, P = reference.filter(z), reference.covariances(len(z))
    sigma = np.sqrt(np.einsum("kii->ki", P))
    if not sigma.all():
        checks.refuse("reference", "a filter whose variances are positive", "a variance of zero")
    if not x.any(axis=0).all():
        checks.refuse("z", "measurements that move every component of the estimate", "a component that stays zero")
    x_gap = max(np.abs((each.filter(z) - x) / np.abs(x).max(axis=0)).max() for each in others)
    P_gap = max(np.abs((each.covariances(len(z)) - P) / sigma[:, :, None] / sigma[:, None, :]).max() for each in others)
    return float(x_gap), float(P_gap)


def rms(values, axis=None):
    """Return the root mean square along an axis, or of all.

    Raises ValueError or TypeError for anything but finite numbers and axes that they have.

    >>> rms([3.0, -3.0])
    3.0
    """
    values = checks.finite("values", values)
    if axis is not None:
        for each in checks.several("axis", [axis] if np.ndim(axis) == 0 else axis, "an axis or some"):
            if checks.count("axis", each, least=-values.ndim) >= values.ndim:
                checks.refuse("axis", f"an axis of an array of {values.ndim}", each)
    square = np.mean(np.square(values), axis=axis)
    return float(np.sqrt(square)) if axis is None else np.sqrt(square)


def nees(errors, P):
    """Return the normalised estimation error squared eᵀ P⁻¹ e of each step.

    errors is (N, n) or (N, n, M), P the covariance that the filter states: (n, n), or (N, n, n), one for each step.
    Returns (N,) or (N, M). Its mean over steps or tracks is n when the errors have mean zero and covariance P.

    Raises ValueError for other shapes, NaN and a P that is not symmetric and definite, TypeError for no real numbers.

    >>> nees([[1.0, 2.0]], [[1.0, 0.0], [0.0, 4.0]])
    array([2.])
    """
    errors = checks.finite("errors", errors, ("N", "n"), ("N", "n", "M"))
    N, n = errors.shape[:2]
    P = checks.finite("P", P, (n, n), (N, n, n))
    if (np.abs(P - P.swapaxes(-1, -2)) > checks.COMPUTED * np.abs(P).max(axis=(-2, -1), keepdims=True)).any():
        checks.refuse("P", "positive definite matrices", "one that is not symmetric")
    try:
        root = np.linalg.cholesky(P)
    except np.linalg.LinAlgError:
        checks.refuse("P", "positive definite matrices", "one that is not")
    whitened = np.linalg.solve(root, errors.reshape(N, n, -1))
    return np.square(whitened).sum(axis=1).reshape(N, *errors.shape[2:])


class Innovations(NamedTuple):
    """What is new in each measurement, (N, m) or (N, m, M), and its covariance S (N, m, m)."""

    values: np.ndarray
    S: np.ndarray


def innovations(each, z):
    """Return z(k) - H x(k/k-1) and S(k) = H P(k/k-1) Hᵀ + R for k = 1 ... N, of a filter over measurements z.

    `each` is a filter with a model and covariances, z is (N, m) or (N, m, M). P(0/0) is the model's P0, and that of the
    steady state for steady-state filters. Raises ValueError or TypeError for measurements of another shape or with
    missed epochs, and for a filter without covariances or a predictor.

    >>> from mpt_helpers.model import constant_velocity
    >>> steady = SteadyStateFilter.from_kalman(constant_velocity(dt=1.0, q=0.01, r=0.1))
    >>> innovations(steady, [[1.0], [2.0]]).values.round(4)
    array([[1.   ],
           [1.239]])
    """
    model = require_covariances("each", each).model
    if getattr(each, "steps", 0):
        checks.refuse("each", "a filter of estimates", f"one that predicts {each.steps} steps ahead")
    z, missed = measurements(z, model.m)
    if missed.any():
        checks.refuse("z", "no missed epochs", "rows of NaN")
    x, P = each.filter(z), each.covariances(len(z))
    x_0 = model.x0 if x.ndim == 2 else model.x0[:, None]
    x_before = np.concatenate([np.broadcast_to(x_0, x[:1].shape), x[:-1]])
    P_before = np.concatenate([getattr(each, "P_0", model.P0)[None], P[:-1]])
    expected = np.tensordot(model.H @ model.F, x_before, (1, 1)).swapaxes(0, 1)
    return Innovations(z - expected, model.H @ predicted_covariance(model, P_before, 1) @ model.H.T + model.R)


def nis(each, z):
    """Return the normalised innovation squared of each step, (N,) or (N, M): its mean is m for a consistent filter.

    Raises as `innovations` does.

    >>> from mpt_helpers.model import constant_velocity
    >>> nis(SteadyStateFilter.from_kalman(constant_velocity(dt=1.0, q=0.01, r=0.1)), [[1.0], [2.0]]).round(2)
    array([4.51, 6.93])
    """
    return nees(*innovations(each, z))


def chi_square_band(dof, runs, level=0.95):
    """Return the central band of the mean of `runs` independent chi-square variables of `dof` degrees of freedom.

    The mean NEES (dof n) or NIS (dof m) over so many runs of a consistent filter lies in it with probability `level`.

    >>> low, high = chi_square_band(dof=2, runs=100)
    >>> round(low, 2), round(high, 2)
    (1.63, 2.41)
    """
    total = checks.count("dof", dof) * checks.count("runs", runs)
    level = checks.number("level", level, "a number in (0, 1)", lambda level: 0 < level < 1)
    low, high = 2 * gammaincinv(total / 2, [(1 - level) / 2, (1 + level) / 2]) / runs
    return float(low), float(high)


def error_moments(steady, truth, N, steps=0):
    """Return the mean and the covariance of the error that a steady-state filter really makes.

    The filter runs on measurements of another model, `truth`, which differs in x0, P0, Q and R. Its error is

        e(k+1) = A e(k) + (I - B H) w(k) - B v(k+1),   e(0) = x(0) - x(0/0),   e(k+N/k) = Fᴺ e(k) + noise

    Returns mean (N, n) and covariance (N, n, n) of x(k+steps) - x(k+steps/k) for k = 1 ... N.

    Raises ValueError when truth has another F or H.

    >>> from mpt_helpers.model import constant_velocity, exact_motion
    >>> steady = SteadyStateFilter.from_kalman(constant_velocity(dt=1.0, q=0.01, r=0.1))
    >>> error_moments(steady, exact_motion(steady.model, x0=[0.0, 20.0]), N=2).mean.round(3)
    array([[ 9.029, 15.75 ],
           [11.187, 10.485]])
    """
    require_same(steady, truth)
    N, steps = checks.count("N", N), checks.count("steps", steps, least=0)
    mean, P = np.empty((N, truth.n)), np.empty((N, truth.n, truth.n))
    noise = _step_noise(steady, truth)
    e, C = truth.x0 - steady.model.x0, truth.P0
    for k in range(N):
        e, C = steady.A @ e, steady.A @ C @ steady.A.T + noise
        mean[k], P[k] = e, C
    return ErrorMoments(mean @ np.linalg.matrix_power(truth.F, steps).T, predicted_covariance(truth, P, steps))


def error_covariance(steady, truth, steps=0):
    """Return the limit of the covariance of `error_moments` for large N, (n, n), from its Lyapunov equation.

        P = A P Aᵀ + (I - B H) Q (I - B H)ᵀ + B R Bᵀ   with the Q and R of `truth`

    It is the P of the filter when `truth` is the filter's own model. Raises ValueError when truth has another F or H
    and when the filter has no limit: an A that does not decay.

    >>> from mpt_helpers.model import constant_velocity
    >>> steady = SteadyStateFilter.from_kalman(constant_velocity(dt=1.0, q=0.01, r=0.1))
    >>> relative_gap(error_covariance(steady, steady.model), steady.P) < 1e-12
    True
    """
    require_same(steady, truth)
    steps, radius = checks.count("steps", steps, least=0), np.abs(np.linalg.eigvals(steady.A)).max()
    if radius >= 1:
        checks.refuse("steady", "a filter whose A has a spectral radius below 1", f"{radius:.6g}")
    P = solve_discrete_lyapunov(steady.A, _step_noise(steady, truth))
    return predicted_covariance(truth, (P + P.T) / 2, steps)


class ErrorMoments(NamedTuple):
    """The mean (N, n) and the covariance (N, n, n) of an error at the steps 1 to N."""

    mean: np.ndarray
    covariance: np.ndarray


def expected_absolute(mean, variance):
    """Return the expected absolute value of Gaussian variables: the mean of a folded normal distribution.

    Raises ValueError for a negative variance, NaN and shapes that do not fit together, TypeError for no real numbers.

    >>> expected_absolute(0.0, 1.0), expected_absolute(-3.0, 0.0)
    (0.7978845608028654, 3.0)
    """
    mean, variance = (checks.finite(n, v) for n, v in (("mean", mean), ("variance", variance)))
    if (variance < 0).any():
        checks.refuse("variance", "numbers that are not negative", f"{variance.min():.6g}")
    try:
        np.broadcast_shapes(mean.shape, variance.shape)
    except ValueError:
        checks.refuse("variance", f"a shape that goes with that of mean, {mean.shape}", variance.shape)
    mean, sigma = np.abs(mean), np.sqrt(variance)
    ratio = np.divide(mean, sigma, out=np.full(np.broadcast(mean, sigma).shape, np.inf), where=sigma > 0)
    value = sigma * np.sqrt(2 / np.pi) * np.exp(-np.square(ratio) / 2) + mean * erf(ratio / np.sqrt(2))
    return float(value) if np.ndim(value) == 0 else value


def _step_noise(steady, truth):
    update = np.eye(truth.n) - steady.B @ truth.H
    return update @ truth.Q @ update.T + steady.B @ truth.R @ steady.B.T


def require_same(steady, truth, name="truth"):
    """Raise, with this name for it, unless `truth` is a model with the F and H of the steady-state filter's."""
    checks.instance("steady", steady, SteadyStateFilter)
    checks.instance(name, truth, LinearModel)
    if not all(np.array_equal(getattr(truth, name), getattr(steady.model, name)) for name in "FH"):
        checks.refuse(name, "the F and H of the filter's model", "others")
