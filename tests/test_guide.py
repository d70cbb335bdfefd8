"""The guide's snippets print what it says, its links lead somewhere, and its numbers in words are right."""

import re
from contextlib import chdir

import numpy as np
import pages
import pytest
from conftest import ROOT

import mpt_helpers as mpt

DOCS = ROOT / "docs"
GUIDE = (DOCS / "guide.md").read_text(encoding="utf-8")
AXIS = mpt.constant_velocity(dt=1.0, q=0.05, r=0.5, P0=np.diag([100.0, 100.0]))


def names_after(*first_words):
    """Return what the guide's blocks define that hold these words."""
    blocks = [block["code"] for block in pages.BLOCK.finditer(GUIDE) if not block["name"]]
    names = {}
    with chdir(DOCS):
        for words in first_words:
            (code,) = (code for code in blocks if words in code)
            exec(code, names)
    return names


def test_the_snippets_print_what_the_guide_says(tmp_path):
    said = re.findall(r"(?ms)^```text\n(.*?)^```$", GUIDE)
    printed = [text for block, text in pages.run_guide(GUIDE, tmp_path) if not block["name"]]
    assert printed == said


def test_links_lead_to_files_of_a_checkout():
    links = re.findall(r'\]\((?!https?:)([^)]+)\)|href="([^"]+)"', GUIDE)
    assert links
    for link in links:
        assert (DOCS / "".join(link)).is_file(), link


def test_a_log_without_rows_for_missed_seconds_gets_them_wherever_its_times_start():
    on_grid = names_after("def on_grid")["on_grid"]
    t, measured = np.array([7.02, 7.98, 10.01]), np.array([[1.0], [2.0], [4.0]])
    for start in (0.0, 5.0):
        z = on_grid(np.arange(4.0) + 7 + start, t + start, measured)
        np.testing.assert_array_equal(z, [[1], [2], [np.nan], [4]])
    for wrong in ([6.0, 7.0, 8.0], [7.0, 7.3, 8.0]):
        with pytest.raises(AssertionError, match="a time before the grid, or two in one row"):
            on_grid(np.arange(7.0, 11.0), np.array(wrong), measured)


def test_the_gate_takes_three_axes():
    names = names_after("def on_grid", "kf.filter(z)", "def gated")
    names["model"] = mpt.stack(*[names["axis"]] * 3)
    names["kf"] = mpt.KalmanFilter(names["model"])
    faulty = np.column_stack([names["z"], names["z"][:, 0]])
    faulty[119] += 20
    assert names["gated"](faulty, 0.9999)[1] == [120]


def test_sensors_that_alternate_give_the_error_that_the_guide_names():
    names = names_after("def on_grid", "def filter_with", "def normalised")
    assert "no column has two successive measurements (NaN)" in GUIDE
    names["z"] = names["z"].copy()
    names["z"][::2, 0] = names["z"][1::2, 1] = np.nan
    with pytest.warns(RuntimeWarning, match="empty slice"), pytest.raises(ValueError, match="NaN"):
        names["brentq"](names["correlation"], np.log(1e-6), np.log(1e4))


def test_two_sensors_with_an_origin_each_are_wrong_by_about_the_distance_between_them():
    names = names_after("def on_grid", "z_both = ")
    distance = names["seen"][names["radio"], 2:][0] - names["origin"]
    moved = names["z_both"] - [0, 0, *distance]
    off = (names["both"].filter(moved) - names["both"].filter(names["z_both"]))[100:, ::2]
    np.testing.assert_allclose(off[2:], np.broadcast_to(-distance, off[2:].shape), rtol=0.1)


def test_the_steady_state_filter_is_close_from_the_measurements_on_that_the_guide_names():
    (said,) = re.findall(
        r"less than 5 cm rms.* from the (\d+)th measurement after the start, "
        r"from the (\d+)rd after one missed epoch, and from the (\d+)th after eight",
        GUIDE,
    )
    steady = mpt.SteadyStateFilter.from_kalman(AXIS)
    _, z = mpt.simulate(AXIS, 200, np.random.default_rng(0), tracks=2000)
    found = []
    for first, end in ((0, 0), (100, 101), (100, 108)):  # no epoch is missed, one, eight
        gappy = z.copy()
        gappy[first:end] = np.nan
        gap = mpt.metrics.rms(steady.filter(gappy) - mpt.KalmanFilter(AXIS).filter(gappy), axis=2)[:, 0]
        after = gap[end : end + 50]
        found.append(np.flatnonzero(after > 0.05)[-1] + 2)  # counted from 1, the measurement after the last that is far
    assert found == [int(number) for number in said]


def test_the_innovations_of_one_track_give_q_within_the_range_that_the_guide_names():
    (low, high) = map(float, re.search(r"(0\.\d+) and (0\.\d+) by the innovations", GUIDE).groups())
    missing = np.isnan(names_after("def on_grid")["z"])
    _, z = mpt.simulate(mpt.stack(AXIS, AXIS), 200, np.random.default_rng(0), tracks=300)
    z[missing] = np.nan
    ratios, correlations, variances = np.geomspace(0.01, 1.0, 25), [], []
    for ratio in ratios:
        axis = mpt.constant_velocity(1.0, ratio, 1.0, P0=AXIS.P0)
        values, S = mpt.metrics.innovations(mpt.KalmanFilter(mpt.stack(axis, axis)), z)
        new = (values / np.sqrt(np.einsum("kiiM->kiM", S)))[10:]
        variances.append(np.nanmean(new**2, axis=(0, 1)))
        correlations.append(np.nanmean(new[1:] * new[:-1], axis=(0, 1)))
    correlations, variances = np.array(correlations), np.array(variances)
    q = []
    for c, r in zip(correlations.T, variances.T, strict=True):
        log_ratio = np.interp(0, -c, np.log(ratios))  # correlations fall with the ratio
        q.append(np.exp(log_ratio) * np.interp(log_ratio, np.log(ratios), r))
    np.testing.assert_allclose(np.percentile(q, [2.5, 97.5]), [low, high], atol=0.005)
