"""The stored measurements and what is made of them; nothing is timed here."""

import json
import sys

import pytest
from conftest import ROOT

import mpt_helpers as mpt

BENCHMARKS = ROOT / "benchmarks"
RESULTS = json.loads((BENCHMARKS / "results.json").read_text())


@pytest.fixture(autouse=True)
def beside_the_benchmarks(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    yield
    for name in ("report", "speedups"):
        sys.modules.pop(name, None)


def test_the_tables_are_those_of_the_stored_results():
    import report

    text = (BENCHMARKS / "README.md").read_text()
    assert report.filled(text, report.tables(RESULTS)) == text


def test_every_goal_that_is_said_to_be_reached_is():
    for each in RESULTS["rows"]:
        if each["goal"]:
            relation, number = each["goal"].split()[:2]
            reached = each["ratio"] <= float(number) if relation == "<=" else each["ratio"] >= float(number)
            assert each["met"] == reached, each


def test_the_steps_that_are_timed_are_the_same_filter():
    import speedups

    speedups.agree(1e-10)  # variances and estimates of order one, some ten products


def test_the_clock_agrees_with_the_papers_counts_where_each_track_has_its_own_covariance():
    """To a factor of two; for one track the calls cost most, and tracks that share coefficients cost all the same."""
    for key, pairs in RESULTS["speedups"].items():
        items = mpt.published(key).items
        for pair, clock in pairs.items():
            counted = float(items[f"speedup.{pair}"].printed)
            assert counted / 2 < clock["own"] < counted * 2
            if pair.startswith("kf-lf"):
                assert clock["one"] < 1
                assert clock["shared"] == pytest.approx(1, abs=0.1)  # 1.08 was measured beside 0.99
            else:
                assert clock["one"] < counted / 5
                assert clock["shared"] < 1 / 2
