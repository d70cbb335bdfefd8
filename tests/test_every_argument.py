"""Whatever an argument of a public function cannot take is refused by its name, before anything is computed."""

import inspect
import re
import traceback
from dataclasses import replace
from functools import wraps
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from conftest import AXIS
from matplotlib.figure import Figure

import mpt_helpers as mpt
from mpt_helpers import (
    average_error,
    burden,
    figures,
    filters,
    metrics,
    model,
    positioning,
    recursion,
    riccati,
    trials,
)

study = import_module("mpt_helpers.study")
T, V, NAN, INF = TypeError, ValueError, np.nan, np.inf
PACKAGE = Path(mpt.__file__).parent


def values(*bad):
    return [(V, each) for each in bad]


def types(*bad):
    return [(T, each) for each in bad]


def number(*also):
    """What no number takes, and values that this one does not."""
    wrong = types(None, "1", [], [1.0], {}, True, np.True_, 1j, np.array([1.0]), np.array(None), np.ma.masked, KF)
    return wrong + values(NAN, INF, -INF, 10**400, *also)


def count(least=1):
    return types(None, "1", [], [1], 1.5, 1.0, NAN, INF, True, np.True_, 1j, KF) + values(least - 1, -1)


def kind(*also):
    """What no model, filter or other object takes, and objects that this one does not."""
    return types(None, "1", 1, 1.5, True, NAN, [], {}, np.eye(2), object(), *also)


def several(*also, least=1):
    """What has no elements, or fewer than it must."""
    return types(None, 1, 1.5, True, NAN, "xy", b"xy", 1j, np.array(1.0), KF, *also) + values(*[[]][:least])


def array(good, *also, scalar=False, nan=True):
    """What no array of this shape takes, and values that this one does not."""
    good = np.array(good, float)
    lost, infinite, pointed = good.copy(), good.copy(), good.astype(object)
    lost.flat[-1], infinite.flat[0] = NAN, -INF
    pointed.flat[0] = None
    wrong = [None, "1", {}, KF, good + 0j, good > 0, good.astype(str), pointed, np.ma.array(good, mask=good == good)]
    shapes = [] if scalar else [1.0, good[None, ..., None]]
    return types(*wrong) + values([], [[1.0], [1.0, 2.0]], infinite, *[lost] * nan, *shapes, *also)


def text(*also):
    return types(None, 1, 1.5, NAN, True, [], b"x", np.array(["x"])) + values(*also)


EYE = np.eye(2)
KF, LF, CV = mpt.KalmanFilter(AXIS), mpt.LainiotisFilter(AXIS), mpt.constant_velocity(1.0, 0.01, 0.1)
TWO_AXES = mpt.stack(AXIS, AXIS)
STEADY, STEADY_CV = (mpt.SteadyStateFilter.from_kalman(each) for each in (AXIS, CV))
AHEAD, FIR = mpt.SteadyStatePredictor(STEADY, 2), mpt.FIRFilter.from_steady_state(STEADY)
UNSTABLE = mpt.SteadyStateFilter(AXIS, A=2 * np.eye(2), B=STEADY.B, P=STEADY.P)
NO_NOISE = mpt.KalmanFilter(replace(AXIS, Q=0 * EYE))
MOVING = mpt.exact_motion(CV, [1, 20])
THREE, TWO = (replace(mpt.gps_ins(1.0, 0.01, r), P0=np.eye(3)) for r in ((1.0, 1e-4, 1.0), (1.0, 1e-4)))
CASE, ENDS = average_error.Case(STEADY_CV, (MOVING, MOVING), (1.0, 2.0)), [0, 1, 2, 4]
RNG = np.random.default_rng(0)
SUMS = average_error.error_sums(CASE, ENDS, np.random.default_rng(0), 3)
Z, X = np.arange(12.0).reshape(6, 2), np.arange(24.0).reshape(6, 4)
STATE = np.array([*positioning.place(57.0, 24.0), 0.0])
SKY = positioning.sky(STATE[:3], t=0.0)
RANGES, AT_SKY = positioning.pseudoranges(SKY, STATE), np.append(SKY[0], 0.0)
LINE = positioning.line_window
AX = figures.panels([["a"]])[1]["a"]
AX.plot([1, 2], label="a")


MODEL, GENERATOR = kind(KF, {"F": 1}), kind(1234, np.random, np.random.RandomState(1))
STATE_FILTER = kind(AXIS, KF, AHEAD, FIR, mpt.KalmanFilter)
FILTER, NO_P = kind(AXIS, mpt.KalmanFilter), kind(AXIS, FIR, mpt.KalmanFilter)
MEASURED = array(Z[:, :1], Z[:, 0], Z, Z[:, :1].T, nan=False)  # a row of NaN is a missed epoch
POSITIVE, NOT_NEGATIVE = number(0, -1), number(-1)
COVARIANCE = array(EYE, [1.0, 1.0], -EYE, [[1.0, 0.5], [0.0, 1.0]], [[1.0, 2.0], [2.0, 1.0]], [[1e-300, 1e300]] * 2)
AXIS_OF = {"dt": (1.0, POSITIVE), "q": (0.01, NOT_NEGATIVE), "r": (0.1, POSITIVE)}
PLACES = array(SKY, SKY.T, SKY[:, :2])
FOUR, FOUR_BY_FOUR = array(STATE, STATE[:3], STATE[None]), array(np.eye(4), EYE, -np.eye(4))
RUNS = {"rng": (RNG, GENERATOR), "M": (2, count())}
ROUGH = {"start_error": (np.zeros(4), FOUR), "sigma": (1.0, NOT_NEGATIVE)}
MOTION = {
    "velocity": (np.ones(5), array(np.ones(5), np.ones((5, 1)))),
    "dt": (1.0, POSITIVE),
    "sigmas": ((1.0, 0.1), array([1.0, 0.1], (1.0, -0.1), (1.0, 1.0, 1.0))),
    "bias": (1.0, number()),
}
PHASE = {"phase": (0.5, number(-0.1, 2))}
WINDOW = {
    "threshold": (3.0, types(None, "1", [], True, 1j, np.array([INF, 1.0])) + values(NAN, -INF, 0, -1)),
    "smallest": (2, count(2)),
    "largest": (5, count(2)),
    "fall": (3, [each for each in count() if each[1] is not None]),
    "last": (positioning.fitted_place, types(None, 1, "measured", [])),
}
CURVES = types(None, 1, "ab", [], [X, X], {1: X, 2: X}, {"a": X, "b": "x"}, {"a": X > 0, "b": X})
CURVES += values({}, {"a": X, "b": X[:, 0]}, {"a": X}, {"a": X, "b": X.T}, {"a": X, "b": NAN * X})
GAPS = types(None, 1, [], "a", {1: [1.0]}, {"a": ["x"]}) + values({}, {"a": -Z}, {"a": [NAN]}, {"a": []}, {"a": 1.0})
DIMENSIONS = {name: (3, count()) for name in "pqr"}
WHAT = {"what": ("F P", text())}


def label(call):
    return getattr(call, "__qualname__", None) or f"{type(call).__name__}()"


# What is called, with the good value of each argument and what that argument refuses. The arguments of a function that
# takes any number of them are a tuple under the name that the messages use.
TABLE = [
    # model
    (
        mpt.LinearModel,
        {
            "F": (EYE, array(EYE, np.ones((2, 3)))),
            "H": ([[1.0, 0.0]], array([[1.0, 0.0]], [[1.0], [0.0]], [[1.0, 0.0, 0.0]])),
            "Q": (EYE, COVARIANCE),
            "R": ([[1.0]], array([[1.0]], [[0.0]], [[-1.0]], EYE)),
            "x0": ([0.0, 0.0], array([0.0, 0.0], [[0.0], [0.0]])[1:]),
            "P0": (EYE, COVARIANCE[1:]),
        },
    ),
    (mpt.gsm_axis, AXIS_OF),
    (mpt.constant_velocity, AXIS_OF),
    (mpt.constant_acceleration, AXIS_OF),
    (mpt.gps_ins, AXIS_OF | {"r": ((1.0, 1e-4), array([1.0, 1e-4], (1.0,), (0.0, 1.0), (1.0, -1.0), (1.0,) * 4))}),
    (mpt.stack, {"models": ((AXIS,), values(()) + types((AXIS, None), (KF,), (EYE,), ("a",)))}),
    (mpt.exact_motion, {"model": (CV, MODEL), "x0": ([0.0, 1.0], array([0.0, 1.0], [[0.0, 1.0]])[1:])}),
    (mpt.mean_track, {"model": (CV, MODEL), "N": (3, count())}),
    (
        mpt.simulate,
        {
            "model": (CV, MODEL),
            "N": (3, count()),
            "rng": (RNG, GENERATOR),
            "tracks": (2, [each for each in count() if each[1] is not None]),
        },
    ),
    (
        model.predicted_covariance,
        {"model": (CV, MODEL), "P": (EYE, array(EYE, [1.0, 1.0], np.eye(3))), "steps": (1, count(0))},
    ),
    (model.square_root, {"C": (EYE, COVARIANCE)}),
    # recursion: where measurements come in
    (recursion.measurements, {"z": (Z[:, :1], MEASURED), "m": (1, [])}),
    (
        recursion.shaped,
        {"z": (Z[:, :1], types(None, "1", {}, Z + 1j) + values([], 1.0, Z, Z[:, 0], Z[:, :1].T)), "m": (1, [])},
    ),
    # riccati
    (riccati.lainiotis_matrices, {"model": (AXIS, MODEL)}),
    (riccati.lainiotis_gain, {name: (EYE, array(EYE, np.ones((2, 3)), [1.0])) for name in ("P", "Fn", "On")}),
    (riccati.rekf, {"model": (AXIS, MODEL + values(mpt.LinearModel(F=EYE, H=[[1.0, 0.0]], Q=EYE, R=[[1.0]])))}),
    (riccati.relf, {"model": (AXIS, MODEL + values(mpt.LinearModel(F=EYE, H=[[1.0, 0.0]], Q=EYE, R=[[1.0]])))}),
    # filters
    (mpt.KalmanFilter, {"model": (AXIS, MODEL)}),
    (mpt.LainiotisFilter, {"model": (AXIS, MODEL)}),
    (KF.filter, {"z": (Z[:, :1], MEASURED)}),
    (FIR.filter, {"z": (Z[:, :1], MEASURED)}),
    (KF.covariances, {"N": (3, count())}),
    (KF.coefficients, {"N": (3, count())}),
    (
        mpt.SteadyStateFilter,
        {
            "model": (AXIS, MODEL),
            "A": (STEADY.A, array(STEADY.A, np.eye(3))),
            "B": (STEADY.B, array(STEADY.B, STEADY.B.T, STEADY.B[:, 0])),
            "P": (STEADY.P, array(STEADY.P, -STEADY.P, np.triu(np.ones((2, 2))))),
        },
    ),
    (mpt.SteadyStateFilter.from_kalman, {"model": (AXIS, MODEL)}),
    (mpt.SteadyStateFilter.from_lainiotis, {"model": (AXIS, MODEL)}),
    (mpt.SteadyStatePredictor, {"steady": (STEADY, STATE_FILTER), "steps": (1, count(0))}),
    (
        mpt.JoinFilter,
        {"first": (KF, FILTER), "second": (LF, FILTER + values(mpt.KalmanFilter(CV), mpt.Separate(KF, KF), AHEAD))},
    ),
    (mpt.JoinFilter(KF, LF).covariances, {"N": (3, count())}),
    (mpt.Separate, {"filters": ((KF, LF), values((), (KF, AHEAD)) + types((KF, None), (AXIS,), ("a",)))}),
    (mpt.Separate(KF, LF).covariances, {"N": (3, count())}),
    (
        mpt.fir_order,
        {
            "A": ([[0.5]], array([[0.5]], [[1.0]], [[0.5, 0.5]])),
            "tol": (0.1, number(0, -1, 2)),
            "norm": (2, types(None, [], True, 1j, KF) + values(0, 3, NAN, "two", 1.5)),
        },
    ),
    (mpt.FIRFilter, {"model": (AXIS, MODEL), "taps": (FIR.taps, array(FIR.taps, FIR.taps.T, FIR.taps[:0]))}),
    (mpt.FIRFilter.from_steady_state, {"steady": (STEADY, STATE_FILTER), "tol": (0.1, number(0, -1, 2))}),
    (mpt.six_filters, {"model": (AXIS, MODEL)}),
    (filters.require_filter, {"value": (KF, FILTER), "name": ("value", [])}),
    (filters.require_covariances, {"value": (KF, NO_P), "name": ("value", [])}),
    # metrics
    (metrics.relative_gap, {"a": (Z, array(Z, Z.T, scalar=True)), "b": (Z, array(Z, scalar=True))}),
    (
        metrics.largest_gaps,
        {
            "reference": (KF, NO_P),
            "others": ([LF], several(KF, [FIR], [AXIS]) + values([mpt.KalmanFilter(CV)])),
            "z": (Z[:, :1], MEASURED + values(0 * Z[:, :1], Z[:, :1, None])),
        },
    ),
    (
        metrics.rms,
        {
            "values": (Z, array(Z, scalar=True)),
            "axis": (1, types("1", 1.5, True, [1.5], 1j, KF) + values(2, -3, (0, 2), [])),
        },
    ),
    (
        metrics.nees,
        {
            "errors": (Z, array(Z, Z[:, 0])),
            "P": (EYE, array(EYE, [1.0, 1.0], -EYE, 0 * EYE, [[1.0, 0.5], [0.0, 1.0]])),
        },
    ),
    *(
        (each, {"each": (KF, NO_P + values(AHEAD)), "z": (Z[:, :1], MEASURED + values([[1.0], [NAN]]))})
        for each in (metrics.innovations, metrics.nis)
    ),
    (metrics.chi_square_band, {"dof": (2, count()), "runs": (10, count()), "level": (0.9, number(0, 1, 95, -1))}),
    (
        metrics.error_moments,
        {
            "steady": (STEADY_CV, STATE_FILTER),
            "truth": (MOVING, MODEL + values(AXIS)),
            "N": (3, count()),
            "steps": (1, count(0)),
        },
    ),
    (
        metrics.error_covariance,
        {
            "steady": (STEADY, STATE_FILTER + values(UNSTABLE)),
            "truth": (AXIS, MODEL + values(CV)),
            "steps": (1, count(0)),
        },
    ),
    (
        metrics.expected_absolute,
        {"mean": (Z, array(Z, scalar=True)), "variance": (Z, array(Z, Z.T, -Z, scalar=True))},
    ),
    (
        metrics.largest_gaps,
        {"reference": (NO_NOISE, values(NO_NOISE)), "others": ([NO_NOISE], []), "z": (Z[:, :1], [])},
    ),
    (
        metrics.require_same,
        {"steady": (STEADY, STATE_FILTER), "truth": (AXIS, MODEL + values(CV)), "name": ("truth", [])},
    ),
    # study
    (
        mpt.study,
        {
            "experiment": (
                lambda rng, M: rng.standard_normal(M),
                types(None, 1, "f", [], lambda rng, M: None, lambda rng, M: "x", lambda rng, M: np.ones(M) * 1j)
                + types(lambda rng, M: np.ma.ones(M), lambda rng, M: [None] * M)
                + values(lambda rng, M: 1.0, lambda rng, M: np.ones((M, 2)), lambda rng, M: [[1.0], [1.0, 2.0]])
                + values(lambda rng, M: np.ones((rng.integers(1, 1000), M))),
            ),
            "runs": (500, count()),
            "seed": (1, count(0)),
            "tile": (200, count()),
            "workers": (
                1,
                count()
                + types(lambda f, tasks: None, lambda f, tasks: 5, lambda f, tasks: [1.0] * 3)
                + values(lambda f, tasks: [f(tasks[0])], lambda f, tasks: []),
            ),
        },
    ),
    # figures
    (
        figures.panels,
        {
            "layout": (
                [["a", "b"]],
                several([1], ["ab"], [[1]], [[None]]) + values([[]], [["a", "b"], ["c"]], [["a", "b"], ["b", "a"]]),
            ),
            "height": (1.0, POSITIVE),
        },
    ),
    (
        figures.tracking,
        {
            "x": (X, array(X, X.T, X[:, :2])),
            "z": (Z, array(Z, Z.T, Z[:, 0])),
            "estimates": ({"a": X, "b": X}, CURVES),
            "P": (np.tile(np.eye(4), (6, 1, 1)), array(np.tile(np.eye(4), (6, 1, 1)), np.eye(4), -np.ones((6, 4, 4)))),
            "gaps": ({"a": Z}, GAPS),
        },
    ),
    (
        figures.following,
        {
            "k": (range(6), array(range(6), range(5))),
            "true": (Z, array(Z, Z.T, Z[:, 0])),
            **{name: (Z, array(Z, Z.T, Z[:, 0], Z[:5])) for name in ("estimated", "mean")},
            "sigma": (Z + 1, array(Z, -Z)),
            "label": ("a", text()),
            "last": ("b", text()[1:]),
        },
    ),
    (
        figures.steps_ahead,
        {
            "ax": (AX, kind(Figure())),
            "errors": (Z, array(Z, Z[:, 0])),
            "real": (Z[:, 0], array(Z[:, 0], -Z[:, 0], Z)),
            "stated": (Z[:, 0], array(Z[:, 0], -Z[:, 0], Z)),
        },
    ),
    (
        figures.effects,
        {
            "values": ([1.0, 2.0], array([1.0, 2.0], [0.0, 1.0], [1.0, -1.0])),
            "results": (
                {("a", "b"): EYE},
                types(None, 1, [], EYE, {("a", "b"): EYE > 0})
                + values({}, {"ab": EYE}, {("a",): EYE}, {("a", "b"): Z}, {("a", "b"): NAN * EYE})
                + values({("a", "b"): EYE, ("c", "d"): EYE}),
            ),
            "labels": (["a", "b"], several() + values(["a"] * 4)),
            "xlabel": ("t", text()),
        },
    ),
    (
        figures.coordinate,
        {
            "t": (range(6), array(range(6), Z)),
            "truth": (Z, array(Z, Z.T, X)),
            "measured": (range(6), array(range(6), Z)),
            "estimates": (
                {"a": Z, "b": Z[1:]},
                types(None, [], 1, "a", {1: Z}, {"a": Z > 0})
                + values({}, {"a": X}, {"a": Z[:, 0]}, {"a": np.ones((7, 2))}, {"a": Z[:, :1]}),
            ),
            "sigma": (Z, array(Z, -Z, Z[1:])),
        },
    ),
    (figures.draw_gaps, {"ax": (AX, kind(Figure())), "gaps": ({"a": Z}, GAPS)}),
    (figures.finish, {"ax": (AX, kind(Figure())), "xlabel": ("k", text()), "title": ("t", text())}),
    (figures.visible_gap, {"gap": (Z, array(Z, -Z, scalar=True))}),
    (figures.describe, {"fig": (Figure(), kind(AX))}),
    (figures.alt_text, {"fig": (Figure(), kind(AX))}),
    (figures.round_svg, {"text": ("<svg/>", text())}),
    (
        mpt.save_figure,
        {
            "fig": (Figure(), kind(AX)),
            "name": ("a", text("", "a b", "../a", "a.png", "ä")),
            "folder": ("folder", types(None, 1, [], b"x") + values("nowhere", __file__, Path("nowhere"))),
        },
    ),
    # burden
    (
        burden.Polynomial,
        {"terms": ({"n": 1}, types(None, 1, "n", [], {1: 1}, {"n": "1"}, {"n": 1j}) + values({"n": NAN}, {"n+": 1}))},
    ),
    (burden.Polynomial.of, {"value": (1, number())}),
    (burden.Polynomial.parse, {"text": ("2n", text("", "2n +", "n/", "(n)/0", "n^", "((n))"))}),
    (burden.n, {"n": (2, number())}),
    (
        burden.Operation,
        {"what": ("a", text()), "dimensions": ("b", text()), "burden": (burden.n, types(None, "n", [], 1j))},
    ),
    (burden.product, WHAT | DIMENSIONS),
    (burden.symmetric_product, WHAT | {name: DIMENSIONS[name] for name in "pq"}),
    (burden.addition, WHAT | {name: DIMENSIONS[name] for name in "pq"}),
    (burden.symmetric_addition, WHAT | {"p": DIMENSIONS["p"]}),
    (burden.identity_plus, WHAT | {"p": DIMENSIONS["p"]}),
    (burden.inverse, WHAT | {"p": DIMENSIONS["p"]}),
    (burden.Burden, {"operations": (burden.join.operations, several([1], [burden.n]))}),
    (burden.fir, {name: (2, count()) for name in "nmM"}),
    # positioning
    (positioning.place, {"latitude": (57.0, number(91, -91)), "longitude": (24.0, number())}),
    (positioning.local_axes, {"x": (STATE[:3], array(STATE[:3], STATE, [0.0, 0.0, 1.0]))}),
    (positioning.constellation, {"t": (0.0, number())}),
    (
        positioning.elevation,
        {"satellites": (SKY, PLACES), "x": (STATE[:3], array(STATE[:3], STATE, np.zeros(3), SKY[0]))},
    ),
    (
        positioning.sky,
        {"x": (STATE[:3], array(STATE[:3], STATE, np.zeros(3))), "t": (0.0, number()), "mask": (10.0, number())},
    ),
    (positioning.pseudoranges, {"satellites": (SKY, PLACES), "X": (STATE, FOUR)}),
    (positioning.linearised, {"satellites": (SKY, PLACES), "X": (STATE, FOUR + values(AT_SKY))}),
    *(
        (
            each,
            {
                "satellites": (SKY, PLACES + values(SKY[:3], np.tile(SKY[:2], (4, 1)))),
                "ranges": (RANGES, array(RANGES, RANGES[1:], RANGES[None])),
                last: (STATE, FOUR + values(AT_SKY)),
            }
            | more,
        )
        for each, last, more in (
            (positioning.corrected, "X", {}),
            (positioning.position, "start", {}),
            (positioning.position_steps, "start", {"steps": (2, count(0))}),
        )
    ),
    (
        positioning.iterates,  # a geometry is met by its steps only
        {
            "satellites": (SKY, PLACES + values(SKY[:3])),
            "ranges": (RANGES, array(RANGES, RANGES[1:], RANGES[None])),
            "start": (STATE, FOUR + values(AT_SKY)),
        },
    ),
    (
        positioning.dilution,
        {"satellites": (SKY, PLACES + values(SKY[:3], np.tile(SKY[:2], (4, 1)))), "X": (STATE, FOUR + values(AT_SKY))},
    ),
    (
        positioning.position_kalman,
        {
            "satellites": (SKY, PLACES + values(SKY[:3])),
            "ranges": ([RANGES], array([RANGES], RANGES, [RANGES[1:]])),
            "start": (STATE, FOUR + values(AT_SKY)),
            "P0": (np.eye(4), FOUR_BY_FOUR + values(np.zeros((4, 4)))),
            "Q": (np.eye(4), FOUR_BY_FOUR),
            "R": (1.0, POSITIVE),
            "linearisations": (1, count()),
        },
    ),
    (positioning.line_fit, {"x": (Z, array(Z, Z[:1], np.ones((2, 0)))), "dt": (1.0, POSITIVE)}),
    (positioning.line_sigma, {"n": (5, count(2)), "i": (Z, array(Z, scalar=True))}),
    (positioning.line_window, {"dt": (1.0, POSITIVE)} | WINDOW),
    (
        positioning.adaptive_line,
        {"z": (Z[:, :1], MEASURED + values(Z[:1, :1], [[1.0], [NAN], [1.0]])), "dt": (1.0, POSITIVE)} | WINDOW,
    ),
    # trials
    (trials.random_sky, {"rng": (RNG, GENERATOR), "channels": (24, count(4))}),
    (trials.rough_errors, ROUGH | {"steps": (1, count(0)), "channels": (24, count(4))} | RUNS),
    *(
        (each, {"errors": (Z, array(Z, *more, scalar=True))})
        for each, more in ((trials.rms_text, [1.0]), (trials.rms_band, [1.0]), (trials.median_band, [1.0, Z[0]]))
    ),
    (
        trials.rough_kalman_errors,
        ROUGH
        | {"P0": (np.eye(4), FOUR_BY_FOUR), "Q": (np.eye(4), FOUR_BY_FOUR), "sigma": (1.0, POSITIVE)}
        | {"epochs": (2, count())}
        | RUNS
        | {"linearisations": (1, count())},
    ),
    (
        trials.fix_kalman_errors,
        ROUGH | {"Q": (np.eye(4), FOUR_BY_FOUR), "sigma": (1.0, POSITIVE), "epochs": (2, count(2))} | RUNS,
    ),
    (trials.line_errors, {"n": (5, count(2)), "dt": (1.0, POSITIVE), "sigma": (1.0, NOT_NEGATIVE)} | RUNS),
    (trials.gps_ins_track, MOTION | RUNS | PHASE),
    (
        trials.tracking_errors,
        {
            "trackers": (
                [lambda z: z],
                several([1], [None]) + values([lambda z: z[0]], [lambda z: None], [lambda z: "x"]),
            )
        }
        | MOTION
        | RUNS
        | PHASE,
    ),
    (wraps(trials.line_tracker)(lambda **all: trials.line_tracker(*all.values())), {"dt": (1.0, POSITIVE)} | WINDOW),
    (trials.filter_tracker, {"model": (TWO, MODEL + values(THREE))}),
    (trials.gps_ins_errors, {"model": (TWO, MODEL + values(THREE, CV))} | MOTION | RUNS),
    (trials.third_row_start, {"model": (THREE, MODEL)}),
    (trials.third_row_errors, {"model": (THREE, MODEL + values(TWO, CV)), "N": (3, count())} | RUNS),
    (trials.without_third_row, {"model": (THREE, MODEL + values(TWO, CV))}),
    (trials.with_last_gps, {"model": (TWO, MODEL + values(THREE, CV))}),
    (
        trials.repeated_row_covariances,
        {"model": (THREE, MODEL + values(TWO, CV)), "rho": (0.5, number(-0.1, 2)), "N": (3, count())},
    ),
    # average_error
    *(
        (
            each,
            {
                "steady": (STEADY_CV, STATE_FILTER),
                "truth": (MOVING, MODEL + values(AXIS, mpt.exact_motion(CV, [0, 0]))),
                "L": (3, count()),
                "steps": (1, count(0)),
            }
            | more,
        )
        for each, more in ((average_error.mean_relative_errors, RUNS), (average_error.expected_relative_errors, {}))
    ),
    (
        average_error.Protocol,
        {
            "track": ("a", text()),
            "unit": ("percent", types(None, [], 1j) + values("percents", 1)),
            "average": ("ratio of sums", types(None, []) + values("mean")),
            "axes": ("x", types(None, []) + values("z")),
            **{name: (1, count(0)) for name in ("first_estimate", "first_prediction", "length")},
        },
    ),
    (
        average_error.Case,
        {
            "steady": (STEADY_CV, STATE_FILTER),
            "truths": ((MOVING, MOVING), several([MOVING, None], [KF, KF]) + values([MOVING], [MOVING, AXIS])),
            "printed": ((1.0, 2.0), several() + values([NAN, 1.0], [[1.0]], [INF]) + types([None], ["1"])),
        },
    ),
    (
        average_error.search,
        {
            "tracks": ({"a": [CASE]}, types(None, 1, [CASE], {"a": CASE}, {"a": [1]}) + values({}, {"a": []})),
            "lengths": ([3], several([None], ["3"], [2.5]) + values([1])),
            "runs": (20, count(2)),
            "seed": (1, count(0)),
            "digits": (4, count(0)),
            "workers": (1, count()),
        },
    ),
    (
        average_error.error_sums,
        {"case": (CASE, kind(STEADY)), "ends": (ENDS, several([1.5]) + values([0], [2, 1], [1, 1], [-1, 2]))} | RUNS,
    ),
    (
        average_error.averages,
        {
            "sums": (SUMS, array(SUMS, SUMS.T, SUMS[:, :, :, 1:])),
            "ends": (ENDS, several([0, 1, 2.0, 4]) + values([4, 2, 1, 0])),
            "lengths": ([4], several([4.0]) + values([3], [0])),
            "average": ("ratio of sums", types(None, []) + values("mean")),
            "axes": ("both", types(None, []) + values("z")),
            "first_estimate": (1, count(0) + values(4)),
            "first_prediction": (1, count(0) + values(4)),
        },
    ),
    (
        average_error.score,
        {
            "samples": (Z.T, array(Z.T, Z[0], Z[:, :1])),
            "printed": ([1.0, 2.0], array([1.0, 2.0], [1.0])),
            "digits": (2, count(0)),
        },
    ),
]

CASES = [
    pytest.param(
        call, {each: good for each, (good, _) in arguments.items()}, name, refused, id=f"{label(call)}, {name}"
    )
    for call, arguments in TABLE
    for name, (_, refused) in arguments.items()
]

# What has no argument that a user could get wrong, and why.
NO_CASE = {
    *(
        recursion.run,
        recursion.lift,
        recursion.advance,
        recursion.steps_at_once,
        recursion.tiles,
    ),  # the filters' engine
    *(recursion.System, recursion.Blocks),  # and what it runs on: z was checked, and the rest is made by a filter
    *(filters.Coefficients, riccati.LainiotisMatrices, metrics.Innovations, metrics.ErrorMoments),  # results
    *(positioning.Line, positioning.Tracked, average_error.Fit, figures.SavedFigure),  # results
    positioning.DegenerateGeometryError,  # an error
    *(positioning.fitted_place, positioning.measured_place),  # return one of their arguments
}
MODULES = (
    *(average_error, burden, figures, filters, metrics, model, positioning, recursion, riccati, study),
    trials,
)


def public():
    """Every public function, class and method of the package that has an argument."""
    for module in MODULES:
        for name, each in vars(module).items():
            mine = (inspect.isfunction(each) or inspect.isclass(each)) and each.__module__ == module.__name__
            if name.startswith("_") or not mine or each in NO_CASE:
                continue
            yield each
            if inspect.isclass(each):
                methods = [member for name, member in inspect.getmembers(each, inspect.isroutine) if name[0] != "_"]
                functions = [getattr(member, "__func__", member) for member in methods if callable(member)]
                yield from (function for function in functions if PACKAGE.name in getattr(function, "__module__", ""))


def test_every_public_function_and_method_has_a_case():
    calls = [getattr(inspect.unwrap(call), "__func__", inspect.unwrap(call)) for call, _ in TABLE]
    needed = [each for each in public() if set(inspect.signature(each).parameters) - {"self", "cls"}]
    assert [f"{each.__module__}.{each.__qualname__}" for each in needed if each not in calls] == []
    assert {type(call) for call in calls} >= {burden.Polynomial, burden.Burden}  # of which the objects are called, too
    functions = [getattr(mpt, name) for name in mpt.__all__ if not inspect.ismodule(getattr(mpt, name))]
    ledger = [each for each in functions if each.__module__.startswith("mpt_helpers.ledger")]  # its door is its files
    assert [each for each in functions if each not in calls + ledger] == []


def test_every_argument_of_what_has_a_case_has_one():
    for call, arguments in TABLE:
        parameters = inspect.signature(call).parameters.values()
        named = {each.name for each in parameters if each.kind not in (each.VAR_KEYWORD, each.VAR_POSITIONAL)}
        assert named - {"self"} <= set(arguments), call


def arrange(call, arguments):
    """Call with these arguments; those of a function that takes any number of them stand in a tuple."""
    names = [each.name for each in inspect.signature(call).parameters.values() if each.kind == each.VAR_POSITIONAL]
    if names and names[0] in arguments:
        return call(*arguments[names[0]])
    return call(**arguments)


@pytest.fixture(scope="module", autouse=True)
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("place")
    (place / "folder").mkdir()
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        yield


@pytest.mark.parametrize(("call", "arguments"), TABLE, ids=[label(call) for call, _ in TABLE])
def test_the_good_arguments_are_taken(call, arguments):
    if NO_NOISE not in arguments.get("reference", ()):  # there are none
        arrange(call, {name: good for name, (good, _) in arguments.items()})


@pytest.mark.parametrize(("call", "good", "name", "refused"), CASES)
def test_what_an_argument_cannot_take_is_refused_by_name(call, good, name, refused):
    for error, bad in refused:
        with pytest.raises((TypeError, ValueError)) as raised:
            pytest.fail(f"{bad!r} gives {arrange(call, good | {name: bad})!r}")
        assert isinstance(raised.value, error), (bad, raised.value)
        assert re.match(rf"{name}\b.*: needs .*, (got|but) ", str(raised.value)), (bad, raised.value)
        assert Path(traceback.extract_tb(raised.tb)[-1].filename).parent == PACKAGE, bad


def test_a_polynomial_equals_nothing_else():
    assert burden.n != "n"
    assert burden.n != KF


def test_there_are_thousands_of_cases():
    assert sum(len(case.values[-1]) for case in CASES) > 4000
