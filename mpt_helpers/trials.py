"""The Monte Carlo experiments of the paper of 2007: what its modelling may have been, over many skies and tracks.

Each function that ends in (rng, M) is an experiment for `study`, once the arguments before them are given. Positions
are in metres, velocities in m/s, and M is the number of runs.
"""

from contextlib import suppress
from dataclasses import replace
from itertools import islice

import numpy as np
from scipy.linalg import block_diag

from . import checks, positioning
from .filters import KalmanFilter
from .model import LinearModel, predicted_covariance, simulate
from .recursion import System, lift, run, shaped

# How the third row of H_k, [1 -dt 0], can be read: which measurement it takes. The paper does not say.
READINGS = ("no third row", "second receiver", "GPS again", "own estimate", "GPS - Δt INS")


def random_sky(rng, channels=24):
    """Return the satellites (m, 3) above the mask, and the state [x y z D'], at a random place and time.

    The place is uniform on the sphere, the time uniform over a sidereal day, D' is zero. A sky of fewer than four
    satellites is drawn again. A receiver of few channels takes so many of the satellites, at random.

    Raises ValueError or TypeError for anything but a Generator and at least four channels.

    >>> satellites, X = random_sky(np.random.default_rng(0))
    >>> len(satellites) >= 4, round(float(np.linalg.norm(X)))
    (True, 6371000)
    """
    _generator(rng)
    checks.count("channels", channels, least=4)
    direction = rng.standard_normal(3)
    x = positioning.EARTH_RADIUS * direction / np.linalg.norm(direction)
    satellites = positioning.sky(x, rng.uniform(0, positioning.SIDEREAL_DAY))
    if len(satellites) < 4:
        return random_sky(rng, channels)
    return rng.permutation(satellites)[:channels], np.append(x, 0.0)


def rough_errors(start_error, sigma, steps, channels, rng, M):
    """Return the errors of the rough position over the iteration (2007 Fig. 1), (steps + 3, M).

    Each run has a `random_sky`, pseudoranges with independent errors of standard deviation sigma, and a known position
    that is off by start_error, [x y z D']. The first two rows are GDOP and PDOP, the others the distance to the true
    place at the start and after each step; NaN after a step that meets a degenerate geometry.

    Raises ValueError or TypeError for bad arguments.

    >>> rough_errors(np.array([3e5, 0, 0, 5e3]), 1.0, 3, 24, np.random.default_rng(0), 2)[2]
    array([300000., 300000.])
    """
    start_error, sigma = checks.array("start_error", start_error, (4,)), checks.not_negative("sigma", sigma)
    result = np.full((checks.count("steps", steps, least=0) + 3, checks.count("M", M)), np.nan)
    for run_ in range(M):
        satellites, X = random_sky(rng, channels)
        ranges = positioning.pseudoranges(satellites, X) + sigma * rng.standard_normal(len(satellites))
        dop = positioning.dilution(satellites, X)
        result[:2, run_] = np.linalg.norm(dop), np.linalg.norm(dop[:3])
        with suppress(positioning.DegenerateGeometryError):
            for step, here in enumerate(islice(positioning.iterates(satellites, ranges, X + start_error), steps + 1)):
                result[step + 2, run_] = np.linalg.norm((here - X)[:3])
    return result


def rms_text(errors):
    """Return the `rms_band` of errors as text. Raises as that does.

    >>> rms_text(np.array([[1.0, 1.0, 1.0], [-1.0, -1.0, -1.0]]))
    '1 [1, 1]'
    """
    return "{:.3g} [{:.3g}, {:.3g}]".format(*rms_band(errors))


def rms_band(errors):
    """Return the root mean square of errors (..., M), and the 95 % band of it, from the spread over the M runs.

    Raises ValueError or TypeError for anything but an array of finite numbers.

    >>> rms_band(np.array([[1.0, 1.0, 1.0], [-1.0, -1.0, -1.0]]))
    (1.0, 1.0, 1.0)
    """
    squares = np.square(_errors(errors))
    squares = squares.reshape(-1, squares.shape[-1]).mean(axis=0)
    mean, half = squares.mean(), 1.96 * squares.std() / np.sqrt(len(squares))
    return tuple(float(np.sqrt(max(value, 0))) for value in (mean, mean - half, mean + half))


def median_band(errors):
    """Return the median of errors (N, M) over the M runs and its 95 % band, (3, N), by the order of the runs.

    Raises ValueError or TypeError for anything but an array of finite numbers.

    >>> median_band(np.arange(101.0)[None])[:, 0]
    array([50., 40., 60.])
    """
    errors = checks.finite("errors", errors, ("N", "M"))
    M = errors.shape[-1]
    half = 1.96 * np.sqrt(M) / 2
    ordered = np.sort(errors, axis=-1)
    low, high = int(np.floor((M - 1) / 2 - half)), int(np.ceil((M - 1) / 2 + half))
    return np.array([np.median(errors, axis=-1), ordered[..., max(low, 0)], ordered[..., min(high, M - 1)]])


def rough_kalman_errors(start_error, P0, Q, sigma, epochs, rng, M, *, linearisations=1):
    """Return the distance of an extended Kalman filter from the true place after each epoch, (epochs, M).

    The skies, the errors and the start are those of `rough_errors`; P0, Q and the linearisations of an epoch are those
    of `position_kalman`.

    >>> rough_kalman_errors(np.zeros(4), np.eye(4), np.zeros((4, 4)), 1.0, 3, np.random.default_rng(0), 2).shape
    (3, 2)
    """
    start_error, sigma = checks.array("start_error", start_error, (4,)), checks.positive("sigma", sigma)
    result = np.empty((checks.count("epochs", epochs), checks.count("M", M)))
    for run_ in range(M):
        satellites, X = random_sky(rng)
        ranges = positioning.pseudoranges(satellites, X) + sigma * rng.standard_normal((epochs, len(satellites)))
        start = X + start_error
        path = positioning.position_kalman(satellites, ranges, start, P0, Q, sigma**2, linearisations=linearisations)
        result[:, run_] = np.linalg.norm((path - X)[:, :3], axis=1)
    return result


def fix_kalman_errors(start_error, Q, sigma, epochs, rng, M):
    """Return what `rough_kalman_errors` does where least squares makes the first epoch and the filter the others.

    P0 of the filter is the covariance of that fix, σ² (HᵀH)⁻¹.

    >>> fix_kalman_errors(np.zeros(4), np.zeros((4, 4)), 1.0, 3, np.random.default_rng(0), 2).shape
    (3, 2)
    """
    start_error, sigma = checks.array("start_error", start_error, (4,)), checks.positive("sigma", sigma)
    Q = checks.covariance("Q", Q, 4)
    result = np.empty((checks.count("epochs", epochs, least=2), checks.count("M", M)))
    for run_ in range(M):
        satellites, X = random_sky(rng)
        ranges = positioning.pseudoranges(satellites, X) + sigma * rng.standard_normal((epochs, len(satellites)))
        fix = positioning.position(satellites, ranges[0], X + start_error)
        H = positioning.linearised(satellites, fix)
        P0 = sigma**2 * np.linalg.inv(H.T @ H) + Q
        path = positioning.position_kalman(satellites, ranges[1:], fix, P0, Q, sigma**2)
        result[:, run_] = np.linalg.norm((np.vstack([fix, path]) - X)[:, :3], axis=1)
    return result


def line_errors(n, dt, sigma, rng, M):
    """Return the errors of the fitted line (2007 Eqs. 8-10) at the points i = 0 ... n + 1, and of V, (n + 3, M).

    The measured places have independent errors of standard deviation sigma; the fit is linear, so that the velocity
    does not matter and is zero.

    >>> line_errors(100, 1.0, 1.0, np.random.default_rng(0), 5).shape
    (103, 5)
    """
    checks.count("n", n, least=2)
    sigma = checks.not_negative("sigma", sigma)
    line = positioning.line_fit(sigma * _generator(rng).standard_normal((n, checks.count("M", M))), dt)
    return np.vstack([line.start + np.arange(n + 2)[:, None] * dt * line.velocity, line.velocity])


def gps_ins_track(velocity, dt, sigmas, bias, rng, M, *, phase=0.0):
    """Draw what GPS and INS measure on tracks of given velocities (2007, after Eq. 11).

    velocity is (N,), sigmas the standard deviations of a GPS position and an INS velocity, bias the constant error of
    the INS. The track starts at zero. A velocity changes by the part `phase` of a step before the sample that has it,

        x(k+1) = x(k) + dt ((1 - phase) v(k) + phase v(k+1)),

    so that with phase 0 the track moves as Φ says, even where v changes. Returns the true positions and velocities
    (N, 2) and the measurements (N, 2, M). Raises ValueError or TypeError for bad arguments, as a phase outside [0, 1].

    >>> gps_ins_track(np.full(3, 0.2), 1.0, (0.0, 0.0), 1.0, np.random.default_rng(0), 1)[1][..., 0].round(1)
    array([[0. , 1.2],
           [0.2, 1.2],
           [0.4, 1.2]])
    """
    velocity, dt = checks.finite("velocity", velocity, ("N",)), checks.positive("dt", dt)
    sigmas, bias = checks.array("sigmas", sigmas, (2,)), checks.number("bias", bias)
    if (sigmas < 0).any():
        checks.refuse("sigmas", "numbers that are not negative", sigmas)
    _generator(rng)
    M = checks.count("M", M)
    phase = checks.number("phase", phase, "a number in [0, 1]", lambda phase: 0 <= phase <= 1)
    x = dt * (velocity.cumsum() - velocity + phase * (velocity - velocity[0]))
    truth = np.column_stack([x, velocity])
    noise = np.reshape(sigmas, (2, 1)) * rng.standard_normal((len(velocity), 2, M))
    return truth, truth[..., None] + [[0.0], [bias]] + noise


def tracking_errors(trackers, velocity, dt, sigmas, bias, rng, M, *, phase=0.0):
    """Return the errors of position and velocity of some trackers on the same tracks, (trackers, N, 2, M).

    The tracks are those of `gps_ins_track`. A tracker is a function of its measurements (N, 2, M); the result, (N, 2,
    M) or (N, 3, M), starts with position and velocity. Raises ValueError or TypeError as `gps_ins_track` does, and for
    trackers that give something else.

    >>> tracking_errors([lambda z: z], np.zeros(5), 1.0, (1.0, 0.01), 1.0, np.random.default_rng(0), 3).shape
    (1, 5, 2, 3)
    """
    for i, tracker in enumerate(trackers := checks.several("trackers", trackers, "at least one function")):
        checks.function(f"trackers[{i}]", tracker, "a function of measurements")
    truth, z = gps_ins_track(velocity, dt, sigmas, bias, rng, M, phase=phase)
    tracked = [np.asarray(tracker(z)) for tracker in trackers]
    for i, each in enumerate(tracked):
        if each.dtype.kind != "f" or each.shape not in {(len(z), n, M) for n in (2, 3)}:
            need, got = f"a result of shape ({len(z)}, 2 or 3, {M})", f"{each.dtype} of shape {each.shape}"
            checks.refuse(f"trackers[{i}]", need, got)
    return np.array([each[:, :2] - truth[..., None] for each in tracked])


def line_tracker(dt, *window):
    """Return a tracker that is the `adaptive_line` of the places: window is what follows dt there, from the threshold.

    Raises ValueError or TypeError as that does.

    >>> line_tracker(1.0, np.inf, 2, 100)(np.zeros((5, 2, 3))).shape
    (5, 2, 3)
    """
    positioning.line_window(dt, *window)
    return lambda z: positioning.adaptive_line(z[:, :1], dt, *window).x


def filter_tracker(model):
    """Return a tracker that is the Kalman filter of a model of GPS alone (m = 1) or of GPS and INS (m = 2).

    Raises TypeError or ValueError for anything else.

    >>> from mpt_helpers.model import gps_ins
    >>> filter_tracker(gps_ins(dt=1.0, q=0.01, r=(1.0, 1e-4)))(np.zeros((5, 2, 3))).shape
    (5, 3, 3)
    """
    if checks.instance("model", model, LinearModel).m > 2:
        checks.refuse("model", "a model of one or two measurements", f"m = {model.m}")
    return lambda z: KalmanFilter(model).filter(z[:, : model.m])


def gps_ins_errors(model, velocity, dt, sigmas, bias, rng, M):
    """Return the errors of a GPS/INS filter on the tracks of `gps_ins_track`, (N, 3, M): place, velocity, bias.

    Raises ValueError or TypeError as that does, and for a model of other than 3 states and 2 measurements.

    >>> from mpt_helpers.model import gps_ins
    >>> model = gps_ins(dt=1.0, q=0.01, r=(1.0, 1e-4))
    >>> gps_ins_errors(model, np.zeros(5), 1.0, (1.0, 0.01), 1.0, np.random.default_rng(0), 3).shape
    (5, 3, 3)
    """
    _gps_ins(model, 2)
    truth, z = gps_ins_track(velocity, dt, sigmas, bias, rng, M)
    return KalmanFilter(model).filter(z) - np.column_stack([truth, np.full(len(truth), bias)])[..., None]


def third_row_start(model):
    """Return the model as it is one step later: its x0 and P0 are those of x(1).

    Raises TypeError for anything but a model.

    >>> from mpt_helpers.model import constant_velocity
    >>> third_row_start(constant_velocity(dt=1.0, q=3.0, r=1.0)).P0
    array([[1. , 1.5],
           [1.5, 3. ]])
    """
    checks.instance("model", model, LinearModel)
    return replace(model, x0=model.F @ model.x0, P0=predicted_covariance(model, model.P0, 1))


def third_row_errors(model, N, rng, M):
    """Return the errors of the GPS/INS filter under each of `READINGS` of its third row, (5, N, 3, M).

    model is a `gps_ins` of three rows; tracks and measurements are drawn from it. The third measurement is, in turn:
    none; the place one step before, measured by a second receiver; what GPS measured one step before; the filter's own
    estimate of one step before; the difference of this step's GPS place and INS displacement. The filter always runs
    from `third_row_start(model)` and takes the third row as independent, with the variance R_33.

    Raises ValueError or TypeError for bad arguments.

    >>> from mpt_helpers.model import gps_ins
    >>> third_row_errors(gps_ins(dt=1.0, q=0.01, r=(1.0, 1e-4, 1.0)), N=4, rng=np.random.default_rng(0), M=2).shape
    (5, 4, 3, 2)
    """
    start, N = third_row_start(_gps_ins(model, 3)), checks.count("N", N)
    _generator(rng)
    M = checks.count("M", M)
    kf, two = KalmanFilter(start), KalmanFilter(without_third_row(start))
    x, z = simulate(without_third_row(model), N + 1, rng, M)
    receiver = x[:-1, :1] + np.sqrt(model.R[2, 2]) * rng.standard_normal((N, 1, M))
    before, x, z = z[:-1, :1], x[1:], z[1:]
    difference = z[:, :1] - model.F[0, 1] * z[:, 1:]
    second, again, last = (kf.filter(np.concatenate([z, row], axis=1)) for row in (receiver, before, difference))
    return np.array([each - x for each in (two.filter(z), second, again, _own_estimate(kf, z), last)])


def without_third_row(model):
    """Return a GPS/INS model of three rows without the third.

    Raises TypeError or ValueError for anything but a model of 3 states and 3 measurements.

    >>> from mpt_helpers.model import gps_ins
    >>> three, two = (gps_ins(dt=1.0, q=0.01, r=r) for r in ((1.0, 1e-4, 1.0), (1.0, 1e-4)))
    >>> without_third_row(three) == two
    True
    """
    _gps_ins(model, 3)
    return replace(model, H=model.H[:2], R=model.R[:2, :2])


def with_last_gps(model):
    """Return a GPS/INS model of two rows with what GPS measured one step before as a third, and its noise in the state.

    The state is [x v b n y]: n is the noise of GPS, y what it measured one step before, so that the third measurement
    is y itself. What must have a variance and has none gets a millionth of that of GPS; of the GPS place before the
    first step nothing is known. Raises TypeError or ValueError for anything but a model of 3 states and 2 measurements.

    >>> from mpt_helpers.model import gps_ins
    >>> with_last_gps(gps_ins(dt=1.0, q=0.01, r=(1.0, 1e-4))).H
    array([[1., 0., 0., 1., 0.],
           [0., 1., 1., 0., 0.],
           [0., 0., 0., 0., 1.]])
    """
    gps, ins = np.diag(_gps_ins(model, 2).R)
    F, H = np.zeros((5, 5)), np.zeros((3, 5))
    F[:3, :3], F[4, [0, 3]] = model.F, 1
    H[:2, :3], H[0, 3], H[2, 4] = model.H, 1, 1
    Q, P0 = block_diag(model.Q, gps, 0), block_diag(model.P0, 1e6 * gps, 0)
    return LinearModel(F=F, H=H, Q=Q, R=np.diag([1e-6 * gps, ins, 1e-6 * gps]), x0=[*model.x0, 0, 0], P0=P0)


def _own_estimate(kf, z):
    """Run the filter where z_3 is its own last place: its innovation is zero, as both are predicted from that place."""
    A, B, _ = kf.coefficients(len(z))
    F, H = kf.model.F, kf.model.H
    A = A + B[:, :, 2:] @ H[2:] @ F  # (I - K H) F with the third row of H left out of the innovation
    system = System(A, B[:, :, :2], np.arange(len(A)))
    return run(lambda missed, L: lift(system, L, kf.model.n), shaped(z, 2), kf.model.x0, kf.model.n)


def repeated_row_covariances(model, rho, N):
    """Return the covariance (N, 3, 3) of the errors that the filter of three rows really makes.

    Its third measurement is the place one step before, with an error that rho makes of the error of GPS one step before
    and of a new one, n, of variance R_33: 0 is the second receiver of `third_row_errors`, 1 is GPS again. The filter
    assumes 0.

        e(k+1) = (I - K H) (F e(k) + w) - K v
        v_3(k+1) = rho v_1(k) + sqrt(1 - rho²) n - h_3 w,   h_3 = [1 -dt 0]

    Raises ValueError for a rho outside [0, 1], ValueError or TypeError for a model of other
    than 3 states and 3 measurements and for no positive count.

    >>> from mpt_helpers.model import gps_ins
    >>> model = gps_ins(dt=1.0, q=0.0, r=(1.0, 1e-4, 1.0))
    >>> repeated_row_covariances(model, rho=1.0, N=5).shape
    (5, 3, 3)
    """
    rho = checks.number("rho", rho, "a number in [0, 1]", lambda rho: 0 <= rho <= 1)
    start = third_row_start(_gps_ins(model, 3))
    F, H, Q, R = start.F, start.H, start.Q, start.R
    K = KalmanFilter(start).coefficients(N).B
    # The joint covariance of e(k) and v_1(k), which enters the next step through the third row.
    e, cross, P = start.P0, np.zeros((3, 1)), np.empty((N, 3, 3))
    shocks = np.diag([R[0, 0], R[1, 1], R[2, 2] * (1 - rho**2)])
    for k in range(N):
        update = np.eye(3) - K[k] @ H
        on_w = update + K[k][:, 2:] @ H[2:]
        on_e, on_old = update @ F, -rho * K[k][:, 2:]
        mixed = on_e @ cross @ on_old.T
        e = on_e @ e @ on_e.T + mixed + mixed.T + on_old * R[0, 0] @ on_old.T
        e = e + on_w @ Q @ on_w.T + K[k] @ shocks @ K[k].T
        cross = -K[k][:, :1] * R[0, 0]
        P[k] = e
    return P


def _generator(rng):
    return checks.instance("rng", rng, np.random.Generator)


def _errors(errors):
    errors = checks.finite("errors", errors)
    if not errors.ndim:
        checks.refuse("errors", "an (..., M) array", "a scalar")
    return errors


def _gps_ins(model, rows):
    n, m = checks.instance("model", model, LinearModel).n, model.m
    if (n, m) != (3, rows):
        checks.refuse("model", f"a gps_ins model of {rows} rows", f"n = {n}, m = {m}")
    return model
