"""Table 1 of 2016: the averages, their expectation, and the search for the protocol."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from conftest import MODELS_2016

import mpt_helpers as mpt
from mpt_helpers.average_error import (
    Case,
    Protocol,
    averages,
    error_sums,
    expected_relative_errors,
    mean_relative_errors,
    score,
    search,
)

MOTION = {"cv": ([0, 20], [0, 30]), "ca": ([0, 0, 2], [0, 0, 3])}
STEADY = {key: mpt.SteadyStateFilter.from_kalman(model) for key, model in MODELS_2016.items()}
TRUTHS = {key: [mpt.exact_motion(model, x0) for x0 in MOTION[key]] for key, model in MODELS_2016.items()}
NOISY = {key: [replace(each, Q=MODELS_2016[key].Q) for each in truths] for key, truths in TRUTHS.items()}
LENGTHS = [20, 30, 40, 50, 60, 80, 100, 150, 3000, 4000]


def by_hand(case, protocol, L, rng, M):
    """The averages of a protocol over runs of L steps, by plain loops; draws what error_sums draws."""
    n = case.steady.model.n
    errors, positions = [], []
    for truth in case.truths:
        if truth.Q.any():
            states = mpt.simulate(truth, L + case.steps, rng, tracks=M)[0]
            s = np.concatenate([np.zeros((1, M)), states[:, 0]])
        else:
            s = np.array([[(np.linalg.matrix_power(truth.F, k) @ truth.x0)[0]] * M for k in range(L + case.steps + 1)])
        z = s[1 : L + 1] + np.sqrt(truth.R[0, 0]) * rng.standard_normal((L, 1, M))[:, 0]
        x, made = np.zeros((n, M)), []
        for k in range(L + 1):
            x = case.steady.A @ x + case.steady.B * z[k - 1] if k else x
            made.append([(np.linalg.matrix_power(truth.F, N) @ x)[0] for N in range(case.steps + 1)])
        errors.append([[abs(s[k + N] - made[k][N]) for k in range(L + 1)] for N in range(case.steps + 1)])
        positions.append([[abs(s[k + N]) for k in range(L + 1)] for N in range(case.steps + 1)])
    errors, positions = np.array(errors), np.array(positions)
    if protocol.axes == "plane":
        errors, positions = np.hypot(*errors)[None], np.hypot(*positions)[None]
    elif protocol.axes in "xy":
        errors, positions = (each["xy".index(protocol.axes)][None] for each in (errors, positions))
    result = []
    for N in range(case.steps + 1):
        first = protocol.first_prediction if N else protocol.first_estimate
        e, s = (each[:, N, first : protocol.length + 1] for each in (errors, positions))
        ratio = (e / s).mean(axis=(0, 1)) if protocol.average == "mean of ratios" else e.sum((0, 1)) / s.sum((0, 1))
        result.append(ratio)
    return np.array(result)


@pytest.mark.parametrize("truths", [TRUTHS, NOISY], ids=["constant", "noisy"])
@pytest.mark.parametrize("key", MODELS_2016)
@pytest.mark.parametrize("first", [(1, 1), (2, 0), (1, 2)])
@pytest.mark.parametrize("axes", ["x", "y", "both", "plane"])
@pytest.mark.parametrize("average", ["mean of ratios", "ratio of sums"])
def test_a_protocol_gives_what_plain_loops_give(truths, key, first, axes, average):
    case, ends = Case(STEADY[key], truths[key], (1, 1, 1)), [0, 1, 2, 5, 9]
    sums = error_sums(case, ends, np.random.default_rng(3), 4)
    for L, made in zip((5, 9), averages(sums, ends, [5, 9], average, axes, *first), strict=True):
        protocol = Protocol("", "fraction", average, axes, *first, L)
        np.testing.assert_allclose(made, by_hand(case, protocol, 9, np.random.default_rng(3), 4), rtol=1e-9)


@pytest.mark.parametrize("key", MODELS_2016)
def test_the_search_and_the_study_average_alike(key):
    truths = [TRUTHS[key][0], TRUTHS[key][0]]
    sums = error_sums(Case(STEADY[key], truths, (1,) * 6), [0, 40], np.random.default_rng(1), 50)
    direct = mean_relative_errors(STEADY[key], truths[0], 40, 5, np.random.default_rng(1), 50)
    np.testing.assert_allclose(averages(sums, [0, 40], [40], "mean of ratios", "x", 1, 1)[0], direct, rtol=1e-12)


@pytest.mark.parametrize("L", [1, 5, 300])
@pytest.mark.parametrize("key", MODELS_2016)
def test_the_expectation_is_the_mean_of_many_runs(key, L):
    runs = mpt.study(partial(mean_relative_errors, STEADY[key], TRUTHS[key][1], L, 5), 20_000, seed=1, workers=2)
    expected = expected_relative_errors(STEADY[key], TRUTHS[key][1], L, 5)
    assert expected.shape == (6, L)
    # Five standard errors.
    assert (np.abs(runs.mean(axis=1) - expected.mean(axis=1)) < 5 * runs.std(axis=1) / np.sqrt(20_000)).all()


KNOWN = [
    Protocol("constant", "percent", "mean of ratios", "y", 1, 1, 4000),
    Protocol("constant", "fraction", "mean of ratios", "both", 2, 2, 60),
    Protocol("constant", "percent", "ratio of sums", "x", 1, 0, 100),
    Protocol("constant", "fraction", "ratio of sums", "plane", 1, 1, 40),
    Protocol("noisy", "fraction", "mean of ratios", "x", 2, 1, 80),
]


@pytest.mark.parametrize("known", KNOWN, ids=str)
def test_the_search_finds_a_known_protocol(known):
    """One run of a known protocol, printed with six decimals: the search must name its kind and explain it."""
    tracks = {"constant": TRUTHS, "noisy": NOISY}
    scale = {"percent": 100, "fraction": 1}[known.unit]
    printed = {}
    for i, key in enumerate(MODELS_2016):
        case, rng = Case(STEADY[key], tracks[known.track][key], (0,) * 6), np.random.default_rng(100 + i)
        printed[key] = np.round(scale * by_hand(case, known, known.length, rng, 1)[:, 0], 6)
    cases = {
        track: [Case(STEADY[key], truths[key], printed[key]) for key in MODELS_2016] for track, truths in tracks.items()
    }
    fits = search(cases, LENGTHS, runs=400, seed=1, digits=6)
    assert len(fits) == 2 * 2 * 2 * 4 * 2 * 3 * len(LENGTHS)
    # The axes of one table can hardly be told apart: the motions on both are multiples of each other.
    assert replace(fits[0].protocol, axes=known.axes) == known
    assert next(fit for fit in fits if fit.protocol == known).p > 0.01
    # A percentage over L steps of constant motion and a fraction over L / 100 of noisy motion can look alike.
    for name in ("average", "unit", "first_estimate", "first_prediction"):
        others = [f for f in fits if f.protocol.track == known.track and vars(f.protocol)[name] != vars(known)[name]]
        assert max(fit.p for fit in others) < 0.01, name


def test_the_score_is_a_chi_square_for_the_right_runs():
    rng = np.random.default_rng(0)
    root = rng.standard_normal((3, 3))
    samples = root @ rng.standard_normal((3, 50_000))
    distance, distances, inside = score(samples, root @ np.array([1.0, 2.0, 2.0]), digits=6)
    assert distance == pytest.approx(9, rel=0.05)  # 50,000 runs know a covariance to 1 %
    assert inside == 3
    assert np.mean(distances < 7.815) == pytest.approx(0.95, abs=0.005)  # the 95 % point for three degrees of freedom
    assert score(samples, 100 * np.ones(3), digits=6)[2] == 0


def test_the_score_knows_of_rounding():
    """Runs that hardly vary, printed with two decimals: what is off by less than the last digit is not far."""
    samples = 0.333 + 1e-9 * np.random.default_rng(0).standard_normal((2, 100))
    assert score(samples, (0.33, 0.33), digits=2)[0] < 3
    assert score(samples, (0.34, 0.33), digits=2)[0] > 3
    assert score(samples, (0.33, 0.33), digits=2)[2] == 2
    assert score(samples, (0.34, 0.33), digits=2)[2] == 1


@pytest.mark.parametrize("truth", [replace(TRUTHS["cv"][0], x0=[0, 0]), replace(TRUTHS["cv"][0], x0=[-40, 20])])
def test_a_track_through_the_origin_has_no_relative_error(truth):
    with pytest.raises(ValueError, match="truth: needs a track whose position is not zero, got zero at k = "):
        expected_relative_errors(STEADY["cv"], truth, 5, 1)
