"""Bad input is refused before anything is computed, with a message that names the argument."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import AXIS
from matplotlib.figure import Figure

import mpt_helpers as mpt
from mpt_helpers import positioning, trials

GOOD = {"F": np.eye(2), "H": [[1.0, 0.0]], "Q": np.eye(2), "R": [[1.0]]}
KF, LF = mpt.KalmanFilter(AXIS), mpt.LainiotisFilter(AXIS)
STEADY = mpt.SteadyStateFilter.from_kalman(AXIS)
FIR = mpt.FIRFilter.from_steady_state(STEADY)
CV, METRICS, AVERAGE = mpt.constant_velocity(1.0, 0.01, 0.1), mpt.metrics, mpt.average_error
STEADY_CV, MOVING = mpt.SteadyStateFilter.from_kalman(CV), mpt.exact_motion(CV, [0, 20])
AHEAD, CASE = mpt.SteadyStatePredictor(STEADY_CV, 2), AVERAGE.Case(STEADY_CV, [MOVING, MOVING], (1, 2))
RNG = np.random.default_rng(0)
NAN, INF = np.nan, np.inf


def model(**changed):
    return lambda: mpt.LinearModel(**GOOD | changed)


def measured(z):
    return lambda: KF.filter(z)


PLACE = positioning.place(57.0, 24.0)
SKY = positioning.sky(PLACE, t=0.0)
RANGES, START = positioning.pseudoranges(SKY, np.append(PLACE, 0.0)), np.append(PLACE, 0.0)


EYE, ZERO, THREE_ROWS = np.eye(4), np.zeros((4, 4)), mpt.gps_ins(1.0, 0.01, (1.0, 1e-4, 1.0))


def fix(satellites=SKY, ranges=RANGES, start=START):
    return lambda: positioning.position(satellites, ranges, start)


def window(z=((0.0,), (1.0,), (2.0,)), dt=1.0, threshold=3.0, smallest=2, largest=5, fall=None):
    return lambda: positioning.adaptive_line(z, dt, threshold, smallest, largest, fall)


CASES = [
    # LinearModel: shapes
    ("F: needs a square matrix, got a scalar", model(F=1.0)),
    ("F: needs a square matrix, got shape (2,)", model(F=[1.0, 2.0])),
    ("F: needs a 2×2 matrix, got shape (2, 3)", model(F=np.ones((2, 3)))),
    ("F: needs a square matrix, got shape (0, 0)", model(F=np.ones((0, 0)))),
    ("F: needs a square matrix, got rows of different lengths", model(F=[[1.0], [1.0, 2.0]])),
    ("H: needs a matrix of 2 columns, got shape (2,)", model(H=[1.0, 0.0])),
    ("H: needs a 1×2 matrix, got shape (1, 3)", model(H=[[1.0, 0.0, 0.0]])),
    ("H: needs a matrix of 2 columns, got shape (0, 2)", model(H=np.ones((0, 2)))),
    ("Q: needs a 2×2 matrix, got a scalar", model(Q=0.01)),
    ("Q: needs a 2×2 matrix, got shape (2,)", model(Q=[1.0, 1.0])),
    ("Q: needs a 2×2 matrix, got shape (1, 1)", model(Q=[[1.0]])),
    ("R: needs a 1×1 matrix, got a scalar", model(R=0.1)),
    ("R: needs a 1×1 matrix, got shape (2, 2)", model(R=np.eye(2))),
    ("x0: needs a vector of length 2, got a scalar", model(x0=0.0)),
    ("x0: needs a vector of length 2, got shape (2, 1)", model(x0=[[0.0], [0.0]])),
    ("P0: needs a 2×2 matrix, got a scalar", model(P0=1.0)),
    ("P0: needs a 2×2 matrix, got shape (3, 3)", model(P0=np.eye(3))),
    # LinearModel: values
    ("Q: needs a symmetric", model(Q=[[1.0, 0.5], [0.0, 1.0]])),
    ("Q: needs a symmetric positive semidefinite", model(Q=[[1.0, 2.0], [2.0, 1.0]])),
    ("Q: needs a symmetric positive semidefinite", model(Q=-np.eye(2))),
    ("got a matrix that is not symmetric", model(Q=[[1.0, 1e-9], [0.0, 1.0]])),
    ("Q: needs a symmetric positive semidefinite", model(Q=[[1.0, 1 + 1e-9], [1 + 1e-9, 1.0]])),
    ("Q: needs a symmetric positive semidefinite", model(Q=[[0.0, 1.0], [1.0, 1.0]])),
    ("R: needs a symmetric positive definite", model(R=[[0.0]])),
    ("R: needs a symmetric positive definite", model(R=[[-1.0]])),
    ("R: needs a symmetric positive definite", model(H=np.eye(2), R=np.ones((2, 2)))),
    ("P0: needs a symmetric positive semidefinite", model(P0=np.diag([1.0, -1.0]))),
    ("F: needs a 2×2 matrix of finite numbers, got NaN", model(F=[[NAN, 0.0], [0.0, 1.0]])),
    ("F: needs a square matrix of finite numbers, got an infinite value", model(F=[[INF, 0.0], [0.0, 1.0]])),
    ("F: needs a square matrix of finite numbers, got an infinite value", model(F=[[-INF, 0.0], [0.0, 1.0]])),
    ("Q: needs a 2×2 matrix of finite numbers, got NaN", model(Q=[[NAN, 0.0], [0.0, 1.0]])),
    ("R: needs a 1×1 matrix of finite numbers, got an infinite value", model(R=[[INF]])),
    ("x0: needs a vector of length 2 of finite numbers, got NaN", model(x0=[NAN, 0.0])),
    # gsm_axis, stack, simulate
    ("dt: needs a positive number, got 0", lambda: mpt.gsm_axis(0, 0.01, 0.1)),
    ("dt: needs a positive number, got -1", lambda: mpt.gsm_axis(-1, 0.01, 0.1)),
    ("dt: needs a positive number, got nan", lambda: mpt.gsm_axis(NAN, 0.01, 0.1)),
    ("dt: needs a positive number, got inf", lambda: mpt.gsm_axis(INF, 0.01, 0.1)),
    ("q: needs a number that is not negative, got -1", lambda: mpt.gsm_axis(1, -1, 0.1)),
    ("r: needs a positive number, got 0", lambda: mpt.gsm_axis(1, 0.01, 0)),
    ("models: needs at least one model, got none", lambda: mpt.stack()),
    ("N: needs an integer of at least 1, got 0", lambda: mpt.simulate(AXIS, 0, RNG)),
    ("N: needs an integer of at least 1, got -3", lambda: mpt.simulate(AXIS, -3, RNG)),
    ("tracks: needs an integer of at least 1, got 0", lambda: mpt.simulate(AXIS, 5, RNG, tracks=0)),
    # measurements
    ("z: needs an (N, 1) or (N, 1, M) array, got a scalar", measured(1.0)),
    ("z: needs an (N, 1) or (N, 1, M) array, got shape (3,)", measured([1.0, 2.0, 3.0])),
    ("z: needs an (N, 1) or (N, 1, M) array, got shape (3, 2)", measured(np.ones((3, 2)))),
    ("z: needs an (N, 1) or (N, 1, M) array, got shape (1, 3, 4)", measured(np.ones((1, 3, 4)))),
    ("z: needs an (N, 1) or (N, 1, M) array, got shape (0, 1)", measured(np.ones((0, 1)))),
    ("z: needs an (N, 1) or (N, 1, M) array, got shape (3, 1, 0)", measured(np.ones((3, 1, 0)))),
    ("z: needs an (N, 1) or (N, 1, M) array, got shape (2, 1, 2, 2)", measured(np.ones((2, 1, 2, 2)))),
    ("z: needs an (N, 1) or (N, 1, M) array, got rows of different lengths", measured([[1.0], [1.0, 2.0]])),
    ("z: needs an (N, 1) or (N, 1, M) array of finite numbers, got an infinite value", measured([[INF]])),
    ("row 1 partly NaN", lambda: mpt.KalmanFilter(mpt.stack(AXIS, AXIS)).filter([[1.0, 2.0], [NAN, 1.0]])),
    ("row 0 of track 1 partly NaN", lambda: mpt.Separate(KF, KF).filter([[[1.0, NAN], [1.0, 1.0]]])),
    ("z: needs an (N, 2)", lambda: mpt.Separate(KF, LF).filter(np.ones((3, 1)))),
    ("z: needs an (N, 1)", lambda: FIR.filter(np.ones((3, 2)))),
    ("z: needs an (N, 1)", lambda: STEADY.filter(np.ones(3))),
    # filters
    ("N: needs an integer of at least 1, got 0", lambda: KF.covariances(0)),
    ("N: needs an integer of at least 1, got 0", lambda: mpt.Separate(FIR, FIR).covariances(0)),
    (
        "second: needs a filter of the same model",
        lambda: mpt.JoinFilter(KF, mpt.LainiotisFilter(replace(AXIS, R=[[2]]))),
    ),
    ("filters: needs at least one filter, got none", lambda: mpt.Separate()),
    ("tol: needs a number in (0, 1], got 0", lambda: mpt.FIRFilter.from_steady_state(STEADY, tol=0)),
    ("tol: needs a number in (0, 1], got -0.1", lambda: mpt.FIRFilter.from_steady_state(STEADY, tol=-0.1)),
    ("tol: needs a number in (0, 1], got nan", lambda: mpt.FIRFilter.from_steady_state(STEADY, tol=NAN)),
    ("tol: needs a number in (0, 1], got 2", lambda: mpt.fir_order([[0.5]], 2)),
    ("A: needs a spectral radius below 1, got 1", lambda: mpt.fir_order([[1.0]], 0.1)),
    ("A: needs a 1×1 matrix, got shape (1, 2)", lambda: mpt.fir_order([[1.0, 2.0]], 0.1)),
    ("taps: needs an (M, 2, 1) array", lambda: mpt.FIRFilter(AXIS, np.ones((3, 1, 2)))),
    ("taps: needs an (M, 2, 1) array", lambda: mpt.FIRFilter(AXIS, np.ones((0, 2, 1)))),
    ("taps: needs an (M, 2, 1) array", lambda: mpt.FIRFilter(AXIS, np.full((3, 2, 1), NAN))),
    ("P: needs a 2×2 matrix", lambda: mpt.SteadyStateFilter(AXIS, A=STEADY.A, B=STEADY.B, P=0.1)),
    ("B: needs a 2×1 matrix", lambda: mpt.SteadyStateFilter(AXIS, A=STEADY.A, B=[0.1, 0.2], P=STEADY.P)),
    ("A: needs a 2×2 matrix", lambda: mpt.SteadyStateFilter(AXIS, A=np.eye(3), B=STEADY.B, P=STEADY.P)),
    # positioning
    ("satellites: needs an (m, 3) array of at least 4 satellites, got shape (3, 3)", fix(SKY[:3], RANGES[:3])),
    ("satellites: needs an (m, 3) array of at least 4 satellites, got shape (8, 2)", fix(SKY[:, :2])),
    ("satellites: needs an (m, 3) array of at least 4 satellites, got a scalar", fix(5.0)),
    ("ranges: needs a vector of length 8 of finite numbers, got NaN", fix(ranges=[NAN, *RANGES[1:]])),
    ("ranges: needs a vector of length 8 of finite numbers, got an infinite value", fix(ranges=[INF, *RANGES[1:]])),
    ("ranges: needs a vector of length 8, got shape (7,)", fix(ranges=RANGES[1:])),
    ("start: needs a vector of length 4, got shape (3,)", fix(start=PLACE)),
    ("start: needs a vector of length 4 of finite numbers, got NaN", fix(start=[NAN, 0, 0, 0])),
    ("satellites: needs a geometry that determines a position", fix(np.tile(SKY[:2], (4, 1)))),
    ("steps: needs an integer of at least 0, got -1", lambda: positioning.position_steps(SKY, RANGES, START, -1)),
    ("start: needs a place that is not a satellite's", fix(start=[*SKY[2], 0.0])),
    ("satellites: needs an (m, 3) array of at least 4", lambda: positioning.dilution(SKY[:3], START)),
    ("satellites: needs a geometry that determines", lambda: positioning.dilution(np.tile(SKY[:2], (4, 1)), START)),
    ("X: needs a vector of length 4", lambda: positioning.dilution(SKY, PLACE)),
    ("x: needs a place that is not on the axis of the Earth", lambda: positioning.local_axes([0.0, 0.0, 1.0])),
    ("place that is not on the axis", lambda: positioning.local_axes(positioning.place(90.0, 0.0))),
    ("satellites: needs an (m, 3) array, got a scalar", lambda: positioning.elevation(5.0, PLACE)),
    ("satellites: needs an (m, 3) array, got shape (2, 2)", lambda: positioning.elevation(np.ones((2, 2)), PLACE)),
    (
        "P0: needs a symmetric positive definite",
        lambda: positioning.position_kalman(SKY, [RANGES], START, ZERO, EYE, 1),
    ),
    (
        "ranges: needs an (N, m) array, got shape (8,)",
        lambda: positioning.position_kalman(SKY, RANGES, START, EYE, EYE, 1),
    ),
    ("latitude: needs a number in [-90, 90], got 91", lambda: positioning.place(91, 0)),
    ("longitude: needs a number, got nan", lambda: positioning.place(0, NAN)),
    ("t: needs a number, got inf", lambda: positioning.constellation(INF)),
    ("x: needs a vector of length 3, got shape (4,)", lambda: positioning.sky(START, 0.0)),
    ("P0: needs a 4×4 matrix", lambda: positioning.position_kalman(SKY, [RANGES], START, np.eye(3), np.eye(4), 1.0)),
    ("R: needs a positive number, got 0", lambda: positioning.position_kalman(SKY, [RANGES], START, EYE, EYE, 0)),
    ("x: needs an (n,) or (n, M) array of at least 2 places, got shape (1,)", lambda: positioning.line_fit([1.0], 1.0)),
    ("x: needs an (n,) or (n, M) array of at least 2 places, got NaN", lambda: positioning.line_fit([1.0, NAN], 1.0)),
    ("dt: needs a positive number, got 0", lambda: positioning.line_fit([1.0, 2.0], 0)),
    ("n: needs an integer of at least 2, got 1", lambda: positioning.line_sigma(1, 0)),
    ("z: needs an (N, 1) or (N, 1, M) array, got shape (3,)", window(z=[0.0, 1.0, 2.0])),
    ("z: needs places without a missed epoch, got 1 of them", window(z=[[0.0], [NAN], [2.0]])),
    ("z: needs at least 5 places, as smallest says, got 3", window(smallest=5)),
    ("dt: needs a positive number, got -1", window(dt=-1)),
    ("threshold: needs a positive number, got 0", window(threshold=0)),
    ("threshold: needs a positive number, got nan", window(threshold=NAN)),
    ("smallest: needs an integer of at least 2, got 1", window(smallest=1)),
    ("largest: needs an integer of at least 3, got 2", window(smallest=3, largest=2)),
    ("fall: needs an integer of at least 1, got 0", window(fall=0)),
    # gps_ins
    ("r: needs two or three variances, got shape (1,)", lambda: mpt.gps_ins(1.0, 0.0, [1.0])),
    ("r: needs two or three variances, got a scalar", lambda: mpt.gps_ins(1.0, 0.0, 1.0)),
    ("r[1]: needs a positive number, got", lambda: mpt.gps_ins(1.0, 0.0, [1.0, 0.0])),
    ("r[2]: needs a positive number, got", lambda: mpt.gps_ins(1.0, 0.0, [1.0, 1.0, NAN])),
    ("dt: needs a positive number, got 0", lambda: mpt.gps_ins(0, 0.0, [1.0, 1.0])),
    ("q: needs a number that is not negative, got -1", lambda: mpt.gps_ins(1.0, -1, [1.0, 1.0])),
    (
        "phase: needs a number in [0, 1], got 2",
        lambda: trials.gps_ins_track([1.0], 1.0, (1.0, 1.0), 0.0, np.random.default_rng(0), 1, phase=2),
    ),
    (
        "linearisations: needs an integer of at least 1, got 0",
        lambda: positioning.position_kalman(SKY, [RANGES], START, EYE, EYE, 1.0, linearisations=0),
    ),
    ("rho: needs a number in [0, 1], got 2", lambda: trials.repeated_row_covariances(THREE_ROWS, 2, 5)),
    # burden, metrics, tables, figures
    ("a: needs the shape of b", lambda: mpt.metrics.relative_gap([1.0], [1.0, 2.0])),
    ("a: needs the shape of b, which is not all zero", lambda: mpt.metrics.relative_gap([1.0], [0.0])),
    ("name: needs letters, digits and underscores", lambda: mpt.save_figure(Figure(), "../fig")),
    ("folder: needs a folder that exists", lambda: mpt.save_figure(Figure(), "fig", folder="nowhere")),
    # constant_velocity, constant_acceleration, exact_motion, mean_track
    ("dt: needs a positive number, got 0", lambda: mpt.constant_velocity(0, 0.01, 0.1)),
    ("dt: needs a positive number, got -1", lambda: mpt.constant_acceleration(-1, 0.01, 0.1)),
    ("q: needs a number that is not negative, got -1", lambda: mpt.constant_velocity(1, -1, 0.1)),
    ("q: needs a number that is not negative, got nan", lambda: mpt.constant_acceleration(1, NAN, 0.1)),
    ("r: needs a positive number, got 0", lambda: mpt.constant_velocity(1, 0.01, 0)),
    ("x0: needs a vector of length 2, got shape (3,)", lambda: mpt.exact_motion(CV, [0, 0, 1])),
    ("N: needs an integer of at least 1, got 0", lambda: mpt.mean_track(CV, 0)),
    # SteadyStatePredictor
    ("steps: needs an integer of at least 0, got -1", lambda: mpt.SteadyStatePredictor(STEADY, -1)),
    ("z: needs an (N, 1) or (N, 1, M) array, got shape (3,)", lambda: AHEAD.filter([1.0, 2.0, 3.0])),
    # metrics
    ("errors: needs an (N, n) or (N, n, M) array, got shape (3,)", lambda: METRICS.nees([1.0, 2.0, 3.0], [[1.0]])),
    ("P: needs an (2, 2) or (3, 2, 2) array, got shape (2,)", lambda: METRICS.nees(np.ones((3, 2)), [1.0, 1.0])),
    (
        "P: needs an (2, 2) or (3, 2, 2) array, got shape (4, 2, 2)",
        lambda: METRICS.nees(np.ones((3, 2)), np.ones((4, 2, 2))),
    ),
    (
        "P: needs positive definite matrices, got one that is not",
        lambda: METRICS.nees(np.ones((3, 2)), np.ones((2, 2))),
    ),
    ("z: needs no missed epochs, got rows of NaN", lambda: METRICS.nis(KF, [[1.0], [NAN]])),
    ("z: needs an (N, 1) or (N, 1, M) array, got shape (3,)", lambda: METRICS.innovations(KF, [1.0, 2.0, 3.0])),
    ("dof: needs an integer of at least 1, got 0", lambda: METRICS.chi_square_band(0, 10)),
    ("level: needs a number in (0, 1), got 1", lambda: METRICS.chi_square_band(2, 10, level=1)),
    ("level: needs a number in (0, 1), got 95", lambda: METRICS.chi_square_band(2, 10, level=95)),
    ("variance: needs numbers that are not negative, got -1", lambda: METRICS.expected_absolute(0.0, -1.0)),
    ("truth: needs the F and H of the filter's model, got others", lambda: METRICS.error_covariance(STEADY, CV)),
    ("N: needs an integer of at least 1, got 0", lambda: METRICS.error_moments(STEADY, AXIS, 0)),
    ("steps: needs an integer of at least 0, got -1", lambda: METRICS.error_moments(STEADY, AXIS, 3, -1)),
    # study
    ("runs: needs an integer of at least 1, got 0", lambda: mpt.study(np.ones, 0, 1)),
    ("seed: needs an integer of at least 0, got -1", lambda: mpt.study(np.ones, 10, -1)),
    ("tile: needs an integer of at least 1, got 0", lambda: mpt.study(np.ones, 10, 1, tile=0)),
    ("workers: needs an integer of at least 1, got 0", lambda: mpt.study(np.ones, 10, 1, workers=0)),
    # average_error
    ("truth: needs the F and H", lambda: AVERAGE.mean_relative_errors(STEADY, CV, 3, 1, RNG, 2)),
    (
        "truth: needs an exact_motion, got a model with process noise",
        lambda: AVERAGE.expected_relative_errors(STEADY, AXIS, 3, 1),
    ),
    ("or a random start", lambda: AVERAGE.expected_relative_errors(STEADY_CV, replace(MOVING, P0=np.eye(2)), 3, 1)),
    ("L: needs an integer of at least 1, got 0", lambda: AVERAGE.expected_relative_errors(STEADY_CV, MOVING, 0, 1)),
    (
        "steps: needs an integer of at least 0, got -1",
        lambda: AVERAGE.expected_relative_errors(STEADY_CV, MOVING, 3, -1),
    ),
    ("truths: needs the motions on two axes, got 1", lambda: AVERAGE.Case(STEADY_CV, [MOVING], (1, 2))),
    (
        "printed: needs a vector of length 2 of finite numbers, got NaN",
        lambda: AVERAGE.Case(STEADY_CV, [MOVING] * 2, (1, NAN)),
    ),
    ("lengths: needs an integer of at least 2, got 1", lambda: AVERAGE.search({"": [CASE]}, [1], 10, 1)),
]

WRONG_TYPES = [
    ("r: needs a positive number, got '1'", lambda: mpt.constant_acceleration(1, 0.01, "1")),
    ("model: needs a LinearModel, got int", lambda: mpt.exact_motion(1, [0, 0])),
    ("model: needs a LinearModel, got KalmanFilter", lambda: mpt.mean_track(KF, 3)),
    ("steps: needs an integer of at least 0, got 1.0", lambda: mpt.SteadyStatePredictor(STEADY, 1.0)),
    ("steps: needs an integer of at least 0, got 1.5", lambda: mpt.SteadyStatePredictor(STEADY, 1.5)),
    ("steps: needs an integer of at least 0, got True", lambda: mpt.SteadyStatePredictor(STEADY, True)),
    ("steps: needs an integer of at least 0, got None", lambda: mpt.SteadyStatePredictor(STEADY, None)),
    ("steady: needs a SteadyStateFilter, got KalmanFilter", lambda: mpt.SteadyStatePredictor(KF, 1)),
    ("steady: needs a SteadyStateFilter, got SteadyStatePredictor", lambda: mpt.SteadyStatePredictor(AHEAD, 1)),
    ("runs: needs an integer of at least 1, got 1.5", lambda: METRICS.chi_square_band(2, 1.5)),
    ("steady: needs a SteadyStateFilter, got KalmanFilter", lambda: METRICS.error_moments(KF, CV, 3)),
    ("truth: needs a LinearModel, got SteadyStateFilter", lambda: METRICS.error_covariance(STEADY, STEADY)),
    ("experiment: needs a callable of (rng, M), got int", lambda: mpt.study(1, 10, 1)),
    ("seed: needs an integer of at least 0, got None", lambda: mpt.study(np.ones, 10, None)),
    ("workers: needs an integer of at least 1, got 'all'", lambda: mpt.study(np.ones, 10, 1, workers="all")),
    ("steady: needs a SteadyStateFilter, got KalmanFilter", lambda: AVERAGE.Case(KF, [MOVING, MOVING], (1, 2))),
    ("lengths: needs an integer of at least 2, got 2.5", lambda: AVERAGE.search({"": [CASE]}, [2.5], 10, 1)),
    ("F: needs a square matrix of real numbers, got an array of complex128", model(F=1j * np.eye(2))),
    ("Q: needs a 2×2 matrix of real numbers, got an array of <U1", model(Q=[["a", "b"], ["c", "d"]])),
    ("R: needs a 1×1 matrix of real numbers, got an array of object", model(R=[[None]])),
    ("R: needs a 1×1 matrix of real numbers, got an array of bool", model(R=[[True]])),
    ("x0: needs a vector of length 2 of real numbers", model(x0=["0", "0"])),
    ("dt: needs a positive number, got '1'", lambda: mpt.gsm_axis("1", 0.01, 0.1)),
    ("dt: needs a positive number, got 1j", lambda: mpt.gsm_axis(1j, 0.01, 0.1)),
    ("dt: needs a positive number, got True", lambda: mpt.gsm_axis(True, 0.01, 0.1)),
    ("q: needs a number that is not negative, got [1]", lambda: mpt.gsm_axis(1, [1], 0.1)),
    ("models[1]: needs a LinearModel", lambda: mpt.stack(AXIS, 5)),
    ("model: needs a LinearModel", lambda: mpt.simulate("axis", 5, RNG)),
    ("N: needs an integer of at least 1, got 5.0", lambda: mpt.simulate(AXIS, 5.0, RNG)),
    ("N: needs an integer of at least 1, got True", lambda: mpt.simulate(AXIS, True, RNG)),
    ("rng: needs a Generator", lambda: mpt.simulate(AXIS, 5, 1234)),
    ("z: needs an (N, 1) or (N, 1, M) array of real numbers, got an array of complex128", measured([[1j]])),
    ("z: needs an (N, 1) or (N, 1, M) array of real numbers, got an array of <U1", measured([["1"]])),
    ("z: needs an (N, 1) or (N, 1, M) array of real numbers, got an array of object", measured([[1.0], [None]])),
    ("without a mask (a missed epoch is a row of NaN)", measured(np.ma.masked_equal([[1.0], [2.0]], 2))),
    ("z: needs an (N, 1) or (N, 1, M) array of real numbers", measured(None)),
    ("model: needs a LinearModel", lambda: mpt.KalmanFilter(np.eye(2))),
    ("model: needs a LinearModel", lambda: mpt.LainiotisFilter(KF)),
    ("model: needs a LinearModel", lambda: mpt.SteadyStateFilter.from_kalman(None)),
    ("model: needs a LinearModel", lambda: mpt.SteadyStateFilter.from_lainiotis(KF)),
    ("steady: needs a SteadyStateFilter", lambda: mpt.FIRFilter.from_steady_state(KF)),
    ("first: needs a filter", lambda: mpt.JoinFilter(AXIS, KF)),
    ("second: needs a filter", lambda: mpt.JoinFilter(KF, None)),
    ("filters[0]: needs a filter that states its covariances, got FIR", lambda: mpt.Separate(FIR, FIR).covariances(3)),
    ("first: needs a filter that states its covariances, got FIR", lambda: mpt.JoinFilter(FIR, FIR).covariances(3)),
    ("filters[0]: needs a filter that states its", lambda: METRICS.nis(mpt.Separate(FIR, KF), [[1.0, 1.0]])),
    ("filters[1]: needs a filter", lambda: mpt.Separate(KF, AXIS)),
    ("tol: needs a number in (0, 1], got '1'", lambda: mpt.FIRFilter.from_steady_state(STEADY, tol="1")),
    ("ranges: needs a vector of length 8 of real numbers", fix(ranges=["1"] * 8)),
    ("smallest: needs an integer of at least 2, got 2.0", window(smallest=2.0)),
    ("threshold: needs a positive number, got '3'", window(threshold="3")),
    ("r: needs two or three variances of real numbers", lambda: mpt.gps_ins(1.0, 0.0, ["1", "1"])),
    ("rho: needs a number in [0, 1], got '1'", lambda: trials.repeated_row_covariances(THREE_ROWS, "1", 5)),
    ("fig: needs a Figure", lambda: mpt.save_figure(None, "fig")),
    ("name: needs a str", lambda: mpt.save_figure(Figure(), 5)),
]


def test_rounding_is_no_bad_input():
    model = mpt.LinearModel(**GOOD | {"Q": [[1.0, 1 + 4e-16], [1.0, 1.0]], "R": [[1e-30]]})
    assert model.Q[0, 1] > model.Q[1, 0]


@pytest.mark.parametrize(("message", "call"), CASES, ids=[message for message, _ in CASES])
def test_bad_values_are_refused_by_name(message, call):
    with pytest.raises(ValueError) as refused:  # noqa: PT011 (the message is compared below)
        call()
    assert message in str(refused.value)


@pytest.mark.parametrize(("message", "call"), WRONG_TYPES, ids=[message for message, _ in WRONG_TYPES])
def test_wrong_types_are_refused_by_name(message, call):
    with pytest.raises(TypeError) as refused:
        call()
    assert message in str(refused.value)
