"""The README says what the notebooks say, and its code prints what it says."""

import re

import numpy as np
import pytest
from conftest import ROOT, cells_of, prose
from tools import shipped

from reproduction.ledger import keys, published, shipped_verdicts
from reproduction.readme import BLOCK, COUNTS, WRITTEN_COUNTS, block

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
    assert names["timed"].x.shape == names["later"].shape == (5, 2)
    assert (names["past"].P[:, 0, 0] <= names["P"][:, 0, 0]).all()


def test_the_counts_are_those_of_the_verdicts():
    verdicts = shipped_verdicts()
    (found,) = BLOCK.finditer(README)
    assert found[0] == f"{found[1]}\n{block(verdicts)}\n\n{found[2]}", "stale: python -m reproduction readme"
    (counts,) = WRITTEN_COUNTS.findall(README)
    given = [each.verdict for each in verdicts]
    numbers = [len(given), *(sum(each in some for each in given) for some in (CHECKED, HOLDS, ["holds in part"], FAIL))]
    assert [int(each) for each in re.findall(r"\d+", counts)] == numbers, "stale: python -m reproduction readme"
    assert counts == COUNTS.format(**verdicts.checked())


def test_where_the_failures_are():
    failures = [each for each in shipped_verdicts() if each.verdict in FAIL]
    causes = [each.cause for each in failures if each.paper == "2014_gsm_2d" and each.id.startswith("table4.")]
    assert f"{len(causes)} of the failures are speedups in Table 4 of 2014, and come from four wrong" in README
    assert len(set(causes)) == 4


def test_each_table_and_figure_of_each_paper_is_linked():
    linked = re.findall(r"\]\(([^)]*)\)", README)
    for key in keys():
        about = published(key).about
        tables = [f"notebooks/{key}.ipynb#Table-{n}" for n in range(1, about.tables + 1)]
        figures = [f"figures/{key}_fig{n}.png" for n in range(1, about.figures + 1)]
        assert [link for link in [*tables, *figures] if linked.count(link) != 1] == []


def test_an_answer_has_few_words_and_no_number_that_a_verdict_could_change():
    for key in keys():
        answer = published(key).about.answer
        assert 3 <= len(answer.split()) <= 9
        assert not re.search(r"\d{2,}", answer)


def test_what_cannot_be_checked_is_lost_doubted_or_left_out():
    """The three counts add up to the verdicts, and what is doubted is legible."""
    said = re.search(
        r"Of the (\d+) items that cannot be checked, (\d+) are lost .*, (\d+) have one .*, and (\d+) need", README
    )
    unchecked, lost, doubted, left_out = map(int, said.groups())
    given = [each for each in shipped_verdicts() if each.verdict == "cannot be checked"]
    assert unchecked == len(given) == lost + doubted + left_out
    assert left_out == sum(not each.cause for each in given)
    assert lost == sum(each.printed == "?" or each.kind == "figure" for each in given if each.cause)


def test_links_and_pictures_exist():
    for target in re.findall(r"""(?:\]\(|src=")(?!https?:)([^)"]+)[)"]""", README):
        path, _, anchor = target.partition("#")
        path = path or "README.md"
        assert (ROOT / path).exists(), target
        if path.endswith(".ipynb") and anchor:
            titles = re.findall(r"(?m)^#+ (.*)", prose(cells_of(ROOT / path)))
        elif anchor:
            titles = re.findall(r"(?m)^#+ (.*)", (ROOT / path).read_text(encoding="utf-8").lower())
        assert not anchor or any(title.replace(" ", "-").startswith(anchor) for title in titles), target


def test_the_first_lines_hold_the_outcome_the_commands_and_the_guide():
    first = "\n".join(README.splitlines()[:48])
    for part in ("make reproduce", "make test", "python -m mpt_helpers track", "(docs/guide.md)", "pip install ."):
        assert part in first


CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")


def test_every_dependency_is_explained():
    (table,) = re.findall(r"(?s)\| package \| what for \|.*?\n\n", CONTRIBUTING)
    project = shipped.metadata()
    extras = [each for name, some in project["optional-dependencies"].items() if name != "test" for each in some]
    for each in [*project["dependencies"], *extras]:
        assert re.split(r"[<>=]", each)[0] in table, each


def test_nothing_names_a_path_of_one_machine():
    kinds = (".py", ".md", ".toml", ".txt", ".ipynb", ".cff", ".yml", ".json", ".html", ".js", "")
    hidden = (".ci", ".github", ".gitignore")  # of ours
    ours = [top for top in ROOT.iterdir() if not top.name.startswith(".") or top.name in hidden]
    for path in (path for top in ours for path in (top, *top.rglob("*"))):
        if "_build" not in path.parts and path.suffix in kinds and path.is_file():
            assert not re.search(rb"/(?:work|root|home|tmp|Users)/", path.read_bytes()), path
