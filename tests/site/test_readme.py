"""The README says what the notebooks say, and its code prints what it says."""

import re

import numpy as np
import pytest
from conftest import NOTEBOOKS, ROOT, cells_of, part_one, parts, source
from test_package import CORE
from tools import shipped

from reproduction.__main__ import BLOCK, COUNTS, WRITTEN_COUNTS, readme
from reproduction.ledger import shipped_verdicts

HOLDS, FAIL = ("reproduced", "within band"), ("differs", "erratum")
CHECKED = (*HOLDS, "holds in part", *FAIL)
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def names():
    """The names that the README's code defines."""
    names = {}
    exec(shipped.README_CODE, names)
    return names


def test_the_code_prints_what_the_readme_says(capsys):
    exec(shipped.README_CODE, {})
    said = "".join(re.findall(r"```text\n(.*?)```", README, re.DOTALL))
    assert capsys.readouterr().out == said


def test_the_uncertainty_is_that_of_the_track_shown(names):
    """The errors on many tracks with this gap spread as the README prints."""
    mpt, model, z = names["mpt"], names["model"], names["z"]
    true, measured = mpt.simulate(model, len(z), np.random.default_rng(1), tracks=100_000)
    measured[np.isnan(z[:, 0])] = np.nan
    errors = names["kf"].filter(measured) - true
    # 100,000 tracks know a standard deviation to 0.22 %.
    np.testing.assert_allclose(errors[:, 0].std(axis=1), np.sqrt(names["P"][:, 0, 0]), rtol=0.011)


def test_the_code_does_what_its_comments_say(names):
    z2 = np.repeat(names["z"], 2, axis=1)
    plane = names["mpt"].KalmanFilter(names["plane"]).filter(z2)
    np.testing.assert_allclose(names["separate"].filter(z2), plane, rtol=1e-12)
    assert names["later"].shape == (5, 2)
    assert names["many"].shape == (100, 2, 1000)
    assert 1 < names["fir"].order < 100
    # 1,000 tracks know the mean of a chi-square of two degrees of freedom to 6 % at each step.
    assert abs(names["nees"].mean(axis=1) - 2).max() < 5 * 2 / np.sqrt(1000)
    six = names["kf"].filter(np.vstack([names["z"], [[5.0]]]))
    np.testing.assert_allclose(names["x_k"], six[-1], rtol=1e-12)


def test_the_counts_are_those_of_the_verdicts():
    verdicts = shipped_verdicts()
    (block,) = BLOCK.finditer(README)
    assert block[0] == f"{block[1]}\n{readme(verdicts)}\n\n{block[2]}", "stale: python -m reproduction readme"
    (counts,) = WRITTEN_COUNTS.findall(README)
    given = [each.verdict for each in verdicts]
    numbers = [len(given), *(sum(each in some for each in given) for some in (CHECKED, HOLDS, ["holds in part"], FAIL))]
    assert [int(each) for each in re.findall(r"\d+", counts)] == numbers, "stale: python -m reproduction readme"
    assert counts == COUNTS.format(**verdicts.checked())


def test_the_list_of_papers_is_that_of_the_notebooks():
    """Each with no number that neither Part I of the notebook gives nor the citation, which opens Part II."""
    listed = dict(re.findall(r"(?m)^- \[(\w+)\]\(notebooks/\w+\.ipynb\): (.*)", README))
    assert sorted(listed) == [path.stem for path in NOTEBOOKS]
    for path in NOTEBOOKS:
        _, evidence = parts(cells_of(path))
        said = "\n".join([part_one(path), *map(source, evidence[:1])])
        for number in re.findall(r"\d{2,}", listed[path.stem]):
            assert re.search(rf"(?<!\d){number}(?!\d)", said), f"{path.stem}: {number}"


def test_the_numbers_of_the_opening_stand_in_the_articles():
    opening = WRITTEN_COUNTS.sub("", README.partition("**Everything again")[0])  # the counts have a test of their own
    said = " ".join(map(part_one, NOTEBOOKS))
    numbers = re.findall(r"(?<![\d_])\d{2,}(?![\d_])", re.sub(r"\[\w+\]\([^)]*\)|<img [^>]*>", "", opening))
    assert numbers
    for number in numbers:
        assert re.search(rf"(?<!\d){number}(?!\d)", said), number


def test_links_and_pictures_exist():
    for target in re.findall(r"""(?:\]\(|src=")(?!https?:)([^)"]+)[)"]""", README):
        path, _, anchor = target.partition("#")
        path = path or "README.md"
        assert (ROOT / path).is_file(), target
        if anchor:
            titles = re.findall(r"(?m)^## (.*)", (ROOT / path).read_text(encoding="utf-8"))
            assert anchor in [re.sub(r"\W+", "-", title.lower()) for title in titles], target


def test_the_first_lines_hold_the_outcome_the_commands_the_guide_and_a_picture():
    first = "\n".join(README.splitlines()[:50])
    for part in ("make reproduce", "make test", "python -m mpt_helpers track", "(docs/guide.md)", "<img "):
        assert part in first


def test_every_dependency_is_explained():
    (table,) = re.findall(r"(?s)\| package \| what for \|.*?\n\n", README)
    project = shipped.metadata()
    extras = [each for name, some in project["optional-dependencies"].items() if name != "test" for each in some]
    for each in [*project["dependencies"], *extras]:
        assert re.split(r"[<>=]", each)[0] in table, each


def test_the_layout_names_every_part_of_the_package():
    layout = README.partition("## Layout")[2]
    for name in {*(each.partition(".")[0] for each in CORE), "tracks", "__main__", "py.typed"}:
        assert re.search(rf"\b{name}\b", layout), name


def test_nothing_names_a_path_of_one_machine():
    kinds = (".py", ".md", ".toml", ".txt", ".ipynb", ".cff", ".yml", ".json", ".html", ".js", "")
    hidden = (".ci", ".github", ".gitignore")  # of ours
    ours = [top for top in ROOT.iterdir() if not top.name.startswith(".") or top.name in hidden]
    for path in (path for top in ours for path in (top, *top.rglob("*"))):
        if "_build" not in path.parts and path.suffix in kinds and path.is_file():
            assert not re.search(rb"/(?:work|root|home|tmp|Users)/", path.read_bytes()), path
