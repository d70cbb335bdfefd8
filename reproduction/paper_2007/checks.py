"""What the text of the paper of 2007 claims, put to the test: the numbers behind the verdicts of its notebook.

The paper prints the size of its errors and no track. Its filters are linear, so that the mean and the covariance of
their errors are exact, without a seed; only the skies of the rough position and the adaptive window are simulated.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from mpt_helpers import KalmanFilter, LinearModel, gps_ins
from mpt_helpers.metrics import rms

from .. import burden
from . import experiments as runs
from . import positioning, recorded

N, DT = 100, 1.0  # the paper's n; the paper prints no Δt
SIGMAS = np.array([1.0, 0.01])  # m and m/s, the random errors of GPS and INS
BIAS = 1.0  # m/s, the constant error of the INS
P0 = np.diag([10.0**2, 1.0, 1.0])  # of position, velocity and INS error; not printed
OFF = np.array([300e3, 0, 0, 5e3])  # m, of the known [x y z D'] at the start
METRES = 10.0  # m: "a few metres"


def model(q=0.01, Q=None, r33=None):
    """Return the model of GPS and INS; q is the variance of the change of velocity, which the paper does not print.

    Q takes the place of diag(0, q, 0). r33 is the variance of the third measurement, which is left out by default.
    """
    variances = SIGMAS**2 if r33 is None else [*SIGMAS**2, r33]
    made = replace(gps_ins(DT, q, variances), P0=P0)
    return made if Q is None else replace(made, Q=Q)


def track(v, steps=N):
    """Return x, V and the constant error of the INS (steps, 3) at a constant velocity, from x = v Δt at i = 1."""
    i = np.arange(1, steps + 1)
    return np.column_stack([v * DT * i, np.full(steps, v), np.full(steps, BIAS)])


def line_track(z, smallest=5):
    """Return the newest point and the velocity (N, 2) of the line through all positions z (N,) so far, and its sigma.

    There is none before the fifth position: through fewer the velocity is off by metres a second.
    """
    i = np.arange(smallest, len(z) + 1)
    sigma = np.full(len(z), np.nan)
    sigma[smallest - 1 :] = [positioning.line_sigma(each, each) for each in i]
    return positioning.adaptive_line(z[:, None], DT, np.inf, smallest, len(z)).x, sigma


def rough_kalman(rng, M, epochs=N):
    """Return the errors of rough positions by Kalman filters from 300 km away, {filter: (epochs, M)}, under M skies.

    *Least squares* and the filters named by their Q, which the paper does not print, linearise once for each epoch, as
    Eqs. 6, 7 and 11 do. *Fix first* is the paper's proposal: least squares with several steps on the first epoch, then
    the filter. *Iterated* is the filter with five linearisations in an epoch.
    """
    away = np.diag(np.maximum(OFF, OFF[0] * np.array([1, 1, 1, 0])) ** 2)
    errors = {}
    for _ in range(M):
        satellites, X = runs.random_sky(rng)
        ranges = positioning.pseudoranges(satellites, X) + rng.standard_normal((epochs, len(satellites)))
        made = {"least squares": positioning.position_steps(satellites, ranges, X + OFF, steps=epochs)[1:]}
        made |= {
            f"Q = ({q} m)²": positioning.position_kalman(satellites, ranges, X + OFF, away, q**2 * np.eye(4), 1.0).X
            for q in (0, 1, 100)
        }
        made["iterated"] = positioning.position_kalman(
            satellites, ranges, X + OFF, away, np.zeros((4, 4)), 1.0, linearisations=5
        ).X
        fix = positioning.position(satellites, ranges[0], X + OFF)
        after = positioning.position_kalman(satellites, ranges[1:], fix.X, fix.P, np.zeros((4, 4)), 1.0).X
        made["fix first"] = np.vstack([fix.X, after])
        for name, states in made.items():
            errors.setdefault(name, []).append(np.linalg.norm((states - X)[:, :3], axis=1))
    return {name: np.transpose(each) for name, each in errors.items()}


def operations(m):
    """Return the operations of a step of least squares and of the Kalman filter on m ranges, H and residuals made.

    They are those of Eq. 7, last form, and of Eq. 11 with Φ = I, counted as `reproduction.burden` does.

    >>> operations(8)
    (404, 2712)
    """
    n = 4
    fix = [
        burden.symmetric_product(n, m),  # HᵀH
        burden.inverse(n),
        burden.product(n, m, 1),  # Hᵀ (P̃ - P)
        burden.product(n, n, 1),
        n,  # X̂0 + ...
    ]
    kalman = [
        burden.product(m, n, n),  # H P⁻
        burden.symmetric_product(m, n),  # H P⁻ Hᵀ
        burden.symmetric_sum(m),
        burden.inverse(m),
        burden.product(n, m, m),  # K
        burden.product(n, m, 1),  # K (Z - H X̂⁻)
        n,
        burden.product(n, m, n),  # K H
        n,
        burden.symmetric_product(n, n),  # (I - K H) P⁻
        burden.symmetric_sum(n),  # P + Q
    ]
    return sum(fix), sum(kalman)


def epochs_until(errors, below=METRES):
    """Return after how many epochs the errors (epochs, M) are below a bound, (M,); inf where they never are.

    >>> epochs_until(np.array([[30.0, 5.0, 30.0], [9.0, 5.0, 20.0]]))
    array([ 2.,  1., inf])
    """
    there = errors < below
    return np.where(there.any(axis=0), there.argmax(axis=0) + 1.0, np.inf)


def after_100(tracker, v=0.2):
    """Return the rms errors (3,) of x, V and INS error after 100 steps, of a tracker of GPS and INS (N, 2, M)."""
    true = track(v)
    clean = true[:, :2] + [0, BIAS]
    return runs.exact_rms(tracker, clean[..., None], true[..., None], SIGMAS)[-1, :, 0]


def gps_alone(q, v=0.2):
    """Return the rms error of x after 100 steps of a Kalman filter without INS."""
    F = np.array([[1, DT], [0, 1]])
    alone = LinearModel(F=F, H=[[1, 0]], Q=np.diag([0, q]), R=[[SIGMAS[0] ** 2]], P0=P0[:2, :2])
    true = track(v)[:, :2, None]
    return runs.exact_rms(KalmanFilter(alone).filter, true[:, :1], true, SIGMAS[:1])[-1, 0, 0]


def third_row(reading, r33=1.0, q=0.01):
    """Return the rms error of x after 100 steps by a reading of the third row of H, and the one that the filter states.

    reading is one of `experiments.READINGS`, r33 the variance of the third measurement, which the paper does not print.
    """
    states = np.vstack([[0, 0.2, BIAS], track(0.2)])
    clean = states[:, :2] + [0, BIAS]
    if reading == "second receiver":
        clean = np.column_stack([clean, states[:, 0]])
    each = model(q, r33=r33)
    sigmas = np.append(SIGMAS, np.sqrt(r33))[: clean.shape[1]]
    tracker = partial(runs.kalman, each, reading=reading)
    error = runs.exact_rms(tracker, clean[..., None], states[1:, :, None], sigmas)[-1, 0, 0]
    return error, np.sqrt(runs.filter_of(each, reading).covariances(N)[-1, 0, 0])


class Changes(NamedTuple):
    """The rms errors (m) in the 50 s after a change of the velocity: (speeds, durations, phases).

    line is the line of n = 100, window the adaptive one, kalman {(Q, q): ...} the filter with INS, row_3 the largest
    error of that filter by any reading of the third row, with R_33 = 1 m².
    """

    line: np.ndarray
    window: np.ndarray
    kalman: dict
    row_3: np.ndarray


SPEEDS, DURATIONS, PHASES = (0.02, 2.2, 10.2), (0, 1, 2, 5, 10), (0, 0.3, 0.6, 0.9)
HALF = np.array([DT**2 / 2, DT, 0])
FAMILIES = {"diagonal": np.diag([0.0, 1.0, 0.0]), "acceleration": np.outer(HALF, HALF)}  # of Q, times q
THRESHOLD = 4.0  # σ_x, the Δx of the adaptive window; its n is 5 to 100


def changes(rng, steps=200, tracks=100):
    """Return the `Changes` of tracks that begin at 0.2 m/s and change within 0 to 10 s to another velocity.

    Line and filters are exact, the adaptive window is simulated, which needs rng.
    """
    cases = [(v, T, phase) for v in SPEEDS for T in DURATIONS for phase in PHASES]
    moves = np.stack([runs.change(0.2, v, T, steps, phase=phase) for v, T, phase in cases], axis=2)
    clean = moves + np.array([0, BIAS])[:, None]
    states = np.concatenate([moves, np.full((steps, 1, len(cases)), BIAS)], axis=1)
    after = slice(steps // 2, steps // 2 + 50)
    shape = len(SPEEDS), len(DURATIONS), len(PHASES)

    def of_x(tracker, z, truth, sigmas, first=0):
        exact = runs.exact_rms(tracker, z, truth, sigmas)
        return rms(exact[after.start - first : after.stop - first, 0], axis=0).reshape(shape)

    line = of_x(lambda z: positioning.adaptive_line(z[:, :1], DT, np.inf, 2, N).x, clean, moves, SIGMAS)
    kalman, row_3 = {}, []
    for family, Q in FAMILIES.items():
        for q in (0.01, 1.0):
            kalman[family, q] = of_x(KalmanFilter(model(Q=q * Q)).filter, clean, states, SIGMAS)
            for reading in [each for each in runs.READINGS if each != "no third row"]:
                z = np.concatenate([clean, moves[:, :1]], axis=1) if reading == "second receiver" else clean
                tracker = partial(runs.kalman, model(Q=q * Q, r33=1.0), reading=reading)
                sigmas = np.append(SIGMAS, 1.0)[: z.shape[1]]
                row_3.append(of_x(tracker, z, states[1:], sigmas, first=1))  # these filters begin at row 1
    true = np.repeat(moves[:, :1], tracks, axis=2)
    z = true + rng.standard_normal(true.shape)
    found = positioning.adaptive_line(z, DT, THRESHOLD, 5, N).x[:, :1] - true
    window = rms(found[after].reshape(50, *shape, tracks), axis=(0, 4))
    return Changes(line, window, kalman, np.max(row_3, axis=0))


class OnRecord(NamedTuple):
    """The paper's claims tried on receivers at rest, for each recording and axis: arrays (recordings, 3).

    newest and of_noise are the errors of the newest point of the line of 100, over those of one fix: of the errors, and
    of their noise alone. ratio is the same of the Kalman filter with a simulated INS (q = 0), nees its squared error
    over the variance that it states, velocity and bias its rms errors (m/s).
    """

    names: list
    fix: np.ndarray
    newest: np.ndarray
    of_noise: np.ndarray
    ratio: np.ndarray
    ratio_of_noise: np.ndarray
    nees: np.ndarray
    velocity: np.ndarray
    bias: np.ndarray


def on_record():
    """Return `OnRecord` of all recordings shipped: three stations, each with one frequency and with two."""
    cases = recorded.cases(recorded.recorded_days())
    rows = []
    for case in cases.values():
        pairs = list(zip(case.errors.T, case.noise.T, strict=True))
        of = [recorded.with_ins(recorded.ins_model(case.step, np.nanvar(e)), e) for e, _ in pairs]
        noisy = [recorded.with_ins(recorded.ins_model(case.step, np.nanvar(e)), e) for _, e in pairs]
        newest = [[recorded.line_ratios(each, N)[1] for each in pair] for pair in pairs]
        lines = zip(of, noisy, newest, strict=True)
        rows.append(
            [(a.fix, *line, a.position / a.fix, b.position / b.fix, a.nees, a.velocity, a.bias) for a, b, line in lines]
        )
    return OnRecord(list(cases), *np.moveaxis(np.array(rows), 2, 0))


def spread(values, form="{:.2f}"):
    """Return the least and the largest of some numbers as a text.

    >>> spread([[1, 2.5], [3, 2]])
    '1.00 to 3.00'
    """
    return f"{form.format(np.min(values))} to {form.format(np.max(values))}"
