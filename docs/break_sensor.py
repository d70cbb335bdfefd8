"""Break the sensor: one axis, three filters, and five ways in which measurements go wrong.

The motion is that of the 2014 paper (`gsm_axis`), walked at 1.5 m/s, and measured where it is: H = [1 0]. Three filters
follow it: Kalman, the constant gain of its steady state, and the last measurements only (FIR). Nothing is known at the
start: x0 is the origin at rest, with a variance of 100.

A Scene says what is broken, `run` what the filters make of it, and `said` puts that into a sentence. The site's first
figure does the same in JavaScript, and its tests hold it to this module.
"""

from dataclasses import asdict, dataclass, field
from functools import cache

import numpy as np
from scipy.special import chdtri

from mpt_helpers.kalman import KalmanFilter
from mpt_helpers.metrics import chi_square_band, error_moments, nis, rms
from mpt_helpers.model import LinearModel, gsm_axis, simulate
from mpt_helpers.steady import FIRFilter, SteadyStateFilter
from reproduction import plots

FIXES = 60
SPEED = 1.5  # m/s, walking pace
DT, Q, R = 1.0, 0.01, 0.1  # the paper's own: seconds, m²/s² and m²
START = 100.0 * np.eye(2)
# Numbers are those of the fixes after this one: by then all filters have forgotten the start.
SETTLED = 20
# An error that lasts: its standard deviation in metres, and what is left of it after a second.
LASTING, LEFT = 0.55, 0.97
FAR = 3000.0  # metres from the origin
CANDIDATES, SEED = 10_000, 1
USUAL = float(chdtri(1, 0.001))  # a good fix has a higher NIS once in 1,000
REACH = 3.1  # metres, the vertical axis
# Written in the drawing, a line each.
BAND_IS = ("blue band: Kalman is", "95 % sure of the truth")
RED_IS = ("red: the truth is", "outside the band")
RED = "#b8251d"


@dataclass(frozen=True)
class Walk:
    """One walk: true positions, errors of the fixes, and errors that last, (FIXES,) each and in metres."""

    truth: np.ndarray
    noise: np.ndarray
    lasting: np.ndarray


@dataclass(frozen=True)
class Scene:
    """A broken sensor: fixes lost, fixes pulled away, a wrong model, errors that last, an origin far away.

    lost holds numbers of fixes from 1 on, pulled maps them to metres off the truth. `ahead` feeds the filters of
    H = [1 Δt], which expect the next position, with present ones.
    """

    lost: tuple = ()
    pulled: dict = field(default_factory=dict)
    ahead: bool = False
    lasts: bool = False
    origin: float = 0.0


SCENES = {
    "gap": Scene(lost=tuple(range(28, 36))),
    "outlier": Scene(pulled={46: 2.6}),
    "lag": Scene(ahead=True),
    "lasting": Scene(lasts=True),
    "far": Scene(origin=FAR),
}
# What is seen. The figure fills the same sentences with the numbers that it computes.
SENTENCES = {
    "whole": "Every fix is there. After the start Kalman’s gain is the constant gain, and the three lines are one.",
    "gap": "After {missing} Kalman gives the next fix {jump} of the weight, not {rest}, and is {kalman} m off. "
    "The constant gain stays at {rest}: {constant} m. Root mean square over many simulated walks: {sigma} and "
    "{sigma_constant} m.",
    "open": "After the last fix all three filters can only predict: the band opens to ± {band} m.",
    "outlier": "Fix {fix} is {off} m off, and every filter follows it as far as its gain says: {share} of the way. "
    "Kalman’s own test, NIS, sees it ({nis}, where 1 is usual), but a filter refuses it only if it has a gate.",
    "small": "Fix {fix} is {off} m off, and every filter follows it as far as its gain says: {share} of the way. "
    "Kalman’s own test, NIS, lets it pass ({nis}; a good fix is above {usual} once in 1,000).",
    "lag": "H = [1 Δt] says that each fix is the next position. Fed with present ones, every filter is one step late: "
    "{late} m at walking pace, {times} times the error it expects. Its own test {test}.",
    "lasting": "An error that lasts looks like motion, and every filter follows it: the truth is outside the band "
    "(red) at {outside} of {counted} fixes, not at 1 in 20. Its own test {test}.",
    "far": "{km} km from the origin FIR is {off} m off: it is a weighted sum of the last {order} fixes, and the "
    "weights add up to {weights}, not 1. The other two know where they started.",
}
UNSEEN = "sees nothing: mean NIS {nis}, where 1 is right"
SEEN = "sees it: mean NIS {nis}, where 1 is right"


@dataclass(frozen=True)
class Run:
    """The results of the filters on a scene: errors in metres, stated sigmas, gains for the position, Kalman's NIS.

    All are (FIXES,), NaN where there is nothing: gains and NIS of lost fixes, and FIR before its first full window.
    """

    kalman: np.ndarray
    sigma: np.ndarray
    gain: np.ndarray
    nis: np.ndarray
    constant: np.ndarray
    sigma_constant: np.ndarray
    rest: float
    fir: np.ndarray
    order: int
    weights: float
    counted: np.ndarray


def model(ahead=False, x0=(0.0, 0.0)):
    """Return the model of the filters: H = [1 0], or the paper's H = [1 Δt].

    >>> model().H, model(ahead=True).H
    (array([[1., 0.]]), array([[1., 1.]]))
    """
    axis = gsm_axis(DT, Q, R)
    return LinearModel(F=axis.F, H=axis.H if ahead else [[1.0, 0.0]], Q=axis.Q, R=axis.R, x0=x0, P0=START)


@cache
def filters(ahead=False, origin=0.0):
    """Return the Kalman, the steady-state and the FIR filter, which start at the origin of the map at rest.

    >>> [each.order for each in filters() if hasattr(each, "order")]
    [20]
    """
    own = model(ahead, x0=(origin, 0.0))
    steady = SteadyStateFilter.from_kalman(own)
    return KalmanFilter(own), steady, FIRFilter.from_steady_state(steady, tol=1e-3)


def walks(count, rng):
    """Return a Walk of `count` columns: walks of the model from the origin, and their errors to the millimetre."""
    axis = gsm_axis(DT, Q, R)
    walk = LinearModel(F=axis.F, H=[[1.0, 0.0]], Q=axis.Q, R=axis.R, x0=[0.0, SPEED], P0=np.zeros((2, 2)))
    x, z = simulate(walk, FIXES, rng, tracks=count)
    lasting = np.empty((FIXES, count))
    error = LASTING * rng.standard_normal(count)
    for k in range(FIXES):
        error = LEFT * error + LASTING * np.sqrt(1 - LEFT**2) * rng.standard_normal(count)
        lasting[k] = error
    return Walk(x[:, 0].round(3), (z[:, 0] - x[:, 0]).round(3), lasting.round(3))


def fixes(scene, track):
    """Return the fixes of a scene as errors in metres, NaN where they are lost, in the shape of the track's."""
    errors = track.noise + (track.lasting if scene.lasts else 0)
    for fix, off in scene.pulled.items():
        errors[fix - 1] = off
    errors[[fix - 1 for fix in scene.lost]] = np.nan
    return errors


def run(scene, track):
    """Return the Run of the filters on a scene; its arrays have a column per track if the track has.

    >>> seen = run(SCENES["gap"], average())
    >>> print(seen.gain[34:37].round(2), seen.sigma[35].round(2), seen.sigma_constant[35].round(2))
    [ nan 0.98 0.61] 0.31 0.98
    """
    kf, steady, fir = filters(scene.ahead, scene.origin)
    truth = (track.truth + scene.origin).reshape(FIXES, 1, -1)
    z = truth + fixes(scene, track).reshape(truth.shape)
    shape = track.truth.shape
    column = (-1,) + (1,) * (len(shape) - 1)
    # All tracks lose the same fixes, so that one of them has the covariances of all.
    P, P_constant = (each.covariances(z[..., 0]) for each in (kf, steady))
    gain = (P @ kf.model.H.T / kf.model.R)[:, 0, 0].reshape(column)  # K = P(k/k) Hᵀ R⁻¹
    there = np.isfinite(z[:, 0]).reshape(shape)
    errors = {
        name: (each.filter(z)[:, 0] - truth[:, 0]).reshape(shape)
        for name, each in {"kalman": kf, "constant": steady, "fir": fir}.items()
    }
    errors["fir"][: fir.order - 1] = np.nan
    return Run(
        kalman=errors["kalman"],
        sigma=np.sqrt(P[:, 0, 0]).reshape(column),
        gain=np.where(there, gain, np.nan),
        nis=nis(kf, z).reshape(shape),
        constant=errors["constant"],
        sigma_constant=np.sqrt(P_constant[:, 0, 0]).reshape(column),
        rest=float(steady.B[0, 0]),
        fir=errors["fir"],
        order=fir.order,
        weights=float(fir.taps[:, 0, 0].sum()),
        counted=there & (np.arange(1, FIXES + 1) > SETTLED).reshape(column),
    )


def _rms(values, counted):
    return np.sqrt(np.nanmean(np.where(counted, values, np.nan) ** 2, axis=0))


def numbers(scene, track):
    """Return the numbers that are said of a scene, by name: each one number, or one for each track.

    rms errors and stated sigmas over the fixes that count, the first fix after the gap, the share outside 2 sigma.
    """
    seen = run(scene, track)
    given = {
        "kalman": _rms(seen.kalman, seen.counted),
        "constant": _rms(seen.constant, seen.counted),
        "fir": _rms(seen.fir, seen.counted),
        "states": _rms(seen.sigma, seen.counted),
        "states_constant": _rms(seen.sigma_constant, seen.counted),
        "nis": np.nanmean(np.where(seen.counted, seen.nis, np.nan), axis=0),
        "outside": np.sum(seen.counted & (np.abs(seen.kalman) > 2 * seen.sigma), axis=0),
        "counted": np.sum(seen.counted, axis=0),
    }
    if scene.lost:
        first = max(scene.lost)
        given |= {"first_kalman": np.abs(seen.kalman[first]), "first_constant": np.abs(seen.constant[first])}
        given |= {"before": np.abs(seen.kalman[first - 1])}
    return given


# What must be average in the track that is shown: the numbers that the figure says of each scene.
SHOWN = {
    "gap": ("kalman", "constant", "first_kalman", "first_constant", "before"),
    "lag": ("kalman", "nis"),
    "lasting": ("kalman", "nis", "outside"),
}


def far_from_average(tracks):
    """Return how far each track is from the average, 0 if it has the root mean square of all in every number.

    tracks is a Walk of many columns. The distance is that of the logarithms of the numbers in SHOWN. The error of
    H = [1 Δt] is the velocity times Δt: there the average is walking pace.
    """
    distance = 0.0
    for name, shown in SHOWN.items():
        given = numbers(SCENES[name], tracks)
        for each in shown:
            middle = SPEED * DT if (name, each) == ("lag", "kalman") else rms(given[each])
            distance = distance + np.log(np.maximum(given[each], 1e-6) / middle) ** 2
    return distance


@cache
def average():
    """Return the Walk that is shown: of 10,000 walks the one whose numbers lie nearest to their root mean square.

    >>> average().truth.shape
    (60,)
    """
    tracks = walks(CANDIDATES, np.random.default_rng(SEED))
    best = int(np.argmin(far_from_average(tracks)))
    return Walk(tracks.truth[:, best], tracks.noise[:, best], tracks.lasting[:, best])


def said(name):
    """Return the sentence on a scene, with the numbers of the average track.

    >>> said("far")
    '3 km from the origin FIR is 0.9 m off: it is a weighted sum of the last 20 fixes, and the weights add up to \
1.0003, not 1. The other two know where they started.'
    """
    scene, track = SCENES[name], average()
    seen, given = run(scene, track), numbers(scene, track)
    words = {"rest": percent(seen.rest), "order": seen.order, "weights": f"{seen.weights:.4f}"}
    low, high = chi_square_band(1, int(given["counted"]))
    words["test"] = (UNSEEN if low <= given["nis"] <= high else SEEN).format(nis=f"{given['nis']:.1f}")
    words |= {"outside": given["outside"], "counted": given["counted"]}
    words |= {"late": f"{given['kalman']:.1f}", "times": f"{given['kalman'] / given['states']:.0f}"}
    if scene.lost:
        first = max(scene.lost)
        words |= {"missing": f"{len(scene.lost)} missing fixes", "jump": percent(seen.gain[first])}
        words |= {"kalman": f"{abs(seen.kalman[first]):.1f}", "constant": f"{abs(seen.constant[first]):.1f}"}
        words |= {"sigma": f"{seen.sigma[first]:.2f}", "sigma_constant": f"{seen.sigma_constant[first]:.2f}"}
    for fix, off in scene.pulled.items():
        words |= {"fix": fix, "off": f"{off:.1f}", "share": percent(seen.gain[fix - 1])}
        words["nis"] = f"{seen.nis[fix - 1]:.0f}"
    if scene.origin:
        words |= {"km": f"{scene.origin / 1000:g}", "off": f"{abs(np.mean(seen.fir[seen.counted])):.1f}"}
    return SENTENCES[name].format(**words)


def percent(share):
    """Return a share in whole percents, as the sentences say a gain.

    >>> percent(0.984)
    '98 %'
    """
    return f"{100 * share:.0f} %"


def settled(lost=0, within=0.1):
    """Return how many fixes a constant gain needs to be as good as Kalman's: from an unknown start, or after a gap.

    That is the first fix from which on its rms error exceeds that of the Kalman filter by less than `within`, with
    `lost` fixes missing before. From a start without a gap the error is that of P0, 100 in both states.

    >>> settled(), settled(lost=8)
    (14, 8)
    """
    kf, steady, _ = filters()
    if lost:
        z = np.zeros((4 * FIXES, 1))
        z[FIXES : FIXES + lost] = np.nan
        kalman, constant = (each.covariances(z)[FIXES + lost :, 0, 0] for each in (kf, steady))
    else:
        kalman = kf.covariances(FIXES)[:, 0, 0]
        constant = error_moments(steady, model(), FIXES).covariance[:, 0, 0]
    worse = np.flatnonzero(np.sqrt(constant / kalman) > 1 + within)
    return int(worse.max(initial=-1)) + 2


def for_the_page():
    """Return the data of the site's figure: the track, the filters' settings, the scenes and the sentences."""
    track = average()
    axis = gsm_axis(DT, Q, R)
    return {
        "truth": track.truth.tolist(),
        "noise": track.noise.tolist(),
        "lasting": track.lasting.tolist(),
        "dt": DT,
        "Q": [axis.Q[0, 0], axis.Q[0, 1], axis.Q[1, 1]],
        "r": R,
        "p0": START[0, 0],
        "settled": SETTLED,
        "reach": REACH,
        "usual": USUAL,
        "band": [[round(float(edge), 3) for edge in chi_square_band(1, count)] for count in range(1, FIXES + 1)],
        "scenes": {name: asdict(scene) for name, scene in SCENES.items()},
        "sentences": SENTENCES | {"unseen": UNSEEN, "seen": SEEN},
        "notes": {"band": BAND_IS, "outside": RED_IS},
    }


def draw(name):
    """Return the figure of a scene: errors in metres, a label at each line, what the band and the red line are.

    It is what the site shows without JavaScript.
    """
    scene, track = SCENES[name], average()
    seen, measured = run(scene, track), fixes(scene, track)
    k = np.arange(1, FIXES + 1)
    fig, ax = plots.panels([["error"]], height=2.4)
    top, colour = ax["error"], plots.COLOUR_OF
    top.fill_between(
        k, seen.kalman - 2 * seen.sigma, seen.kalman + 2 * seen.sigma, color=colour["kalman"], alpha=0.2, lw=0
    )
    top.axhline(0, color=colour["truth"], lw=1)
    (constant,) = top.plot(k, seen.constant, color=colour["steady"])
    (kalman,) = top.plot(k, seen.kalman, color=colour["kalman"])
    top.plot(k, measured, "o", color="black", ms=2.5)
    top.set_ylim(-REACH, REACH)
    at = max(scene.lost, default=FIXES - 20)
    plots.label_line(constant, "constant gain", at + 1, xytext=(6, 6))
    plots.label_line(kalman, "Kalman", at + 1, xytext=(6, -32))
    outside = np.abs(seen.kalman) > 2 * seen.sigma
    top.hlines(np.zeros(outside.sum()), k[outside] - 0.5, k[outside] + 0.5, color=RED, lw=3)
    top.text(1, -REACH + 0.15, "\n".join(BAND_IS), color=colour["kalman"], va="bottom")
    if outside.any():
        top.text(1, REACH - 0.15, "\n".join(RED_IS), color=RED, va="top")
    plots.finish(top, "fix", "metres off the truth")
    return fig
