"""The guide's snippets print what it says, its links lead somewhere, and its numbers in words are right."""

import re

import numpy as np
import pages
from conftest import ROOT

import mpt_helpers as mpt

DOCS = ROOT / "docs"
GUIDE = (DOCS / "guide.md").read_text(encoding="utf-8")
AXIS = mpt.constant_velocity(dt=1.0, q=0.05, r=0.5, P0=np.diag([100.0, 100.0]))


def test_the_snippets_print_what_the_guide_says(tmp_path):
    said = re.findall(r"(?ms)^```text\n(.*?)^```$", GUIDE)
    printed = [text for block, text in pages.run_guide(GUIDE, tmp_path) if not block["name"]]
    assert printed == said


def test_links_lead_to_files_of_a_checkout():
    links = re.findall(r'\]\((?!https?:)([^)]+)\)|href="([^"]+)"', GUIDE)
    assert links
    for link in links:
        assert (DOCS / "".join(link)).is_file(), link


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
    missing = np.isnan(np.genfromtxt(DOCS / "track.csv", delimiter=",", skip_header=1)[:, 1:])
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
