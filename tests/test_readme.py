"""The README says what the notebooks say, and its snippet runs."""

import json
import re

import numpy as np
import pytest
from conftest import NOTEBOOKS, ROOT

from mpt_helpers.__main__ import BLOCK, readme
from mpt_helpers.ledger import keys, shipped_verdicts

README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_snippet_runs_and_does_what_its_comments_say():
    (snippet,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    names = {}
    exec(snippet, names)
    z2 = np.repeat(names["z"], 2, axis=1)
    np.testing.assert_allclose(
        names["separate"].filter(z2), names["mpt"].KalmanFilter(names["plane"]).filter(z2), rtol=1e-12
    )
    assert names["x"].shape == (5, 2)
    assert names["sigma"].shape == (5,)
    assert names["ahead"].shape == (5, 2)
    assert names["many"].shape == (100, 2, 1000)
    assert 1 < names["fir"].order < 100
    error = names["many"][:, 0] - names["tracks_x"][:, 0]
    sigma = np.sqrt(names["kf"].covariances(100)[:, 0, 0])
    # 1,000 tracks know the mean of a chi-square of two degrees of freedom to 6 % at each step.
    assert abs(names["nees"].mean(axis=1) - 2).max() < 5 * 2 / np.sqrt(1000)
    # 10,000 runs know a standard deviation to 0.7 %.
    np.testing.assert_allclose(names["errors"].std(), sigma[-1], rtol=0.035)
    # 100 correlated steps of 1,000 tracks: the rms is known to some 2 %.
    np.testing.assert_allclose(np.sqrt((error**2).mean()), np.sqrt((sigma**2).mean()), rtol=0.05)


def test_the_counts_are_those_of_the_verdicts():
    verdicts = shipped_verdicts()
    if {each.paper for each in verdicts} != set(keys()):
        pytest.skip("some notebooks still have the verdicts of the ledger before this one")
    (block,) = BLOCK.finditer(README)
    assert block[0] == f"{block[1]}\n{readme(verdicts)}\n\n{block[2]}", "stale: python -m mpt_helpers readme"


def test_the_numbers_of_what_was_found_are_computed():
    """A number of two digits or more stands on the first screen of its notebook, which computes it."""
    found = dict(re.findall(r"(?m)^- \[(\w+)\]\(notebooks/\w+\.ipynb\): (.*)", README))
    assert sorted(found) == [path.stem for path in NOTEBOOKS]
    for path in NOTEBOOKS:
        text = re.split(r"(?:Figures?|Tables) [\d-]+\. ", found[path.stem], maxsplit=1)[1]
        first = "".join(json.loads(path.read_text(encoding="utf-8"))["cells"][0]["source"])
        for number in re.findall(r"\d{2,}", text):
            assert re.search(rf"\b{number}\b", first), f"{path.stem}: {number}"


def test_links_and_pictures_exist():
    for target in re.findall(r"\]\((?!https?:)([^)]+)\)", README):
        assert (ROOT / target).is_file(), target


def test_the_first_thirty_lines_hold_the_table_the_commands_and_a_picture():
    first = "\n".join(README.splitlines()[:30])
    for part in ("| paper |", "make reproduce", "make test", "![", "doi.org/10.1155/2014/130512"):
        assert part in first


def test_nothing_names_a_path_of_one_machine():
    for path in ROOT.rglob("*"):
        hidden = any(
            part.startswith(".") and part not in (".ci", ".gitignore") for part in path.relative_to(ROOT).parts
        )
        if path.is_file() and not hidden and path.suffix in (".py", ".md", ".toml", ".txt", ".ipynb", ".cff", ".yml"):
            assert not re.search(r"/(?:work|root|home|tmp|Users)/", path.read_text(encoding="utf-8")), path
