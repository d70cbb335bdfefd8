"""CONTRIBUTING.md, "A paper is added", followed to the letter in a copy of the project: the smallest fifth paper."""

import json
import os
import re
import shutil
import subprocess
import sys

import pytest
from conftest import NOTEBOOKS, ROOT, write_notebook
from test_notebooks import LINES

from mpt_helpers.__main__ import main
from mpt_helpers.ledger import keys, published, stored_verdicts

PAGE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
KEY = re.search(r"The key is .*, here `(\w+)`", PAGE)[1]
FOLDED = json.loads(re.search(r"metadata `(\{.*\})`", PAGE)[1])


def blocks(kind):
    """Return the page's code blocks of one kind."""
    return re.findall(rf"```{kind}\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """A copy of the project to which the page has added a paper, and its notebook is executed."""
    copy = tmp_path_factory.mktemp("project")
    shutil.copytree(ROOT / "mpt_helpers", copy / "mpt_helpers", ignore=shutil.ignore_patterns("__pycache__"))
    for folder in ("notebooks", "figures"):
        (copy / folder).mkdir()
    (toml,) = blocks("toml")
    (copy / "mpt_helpers" / "ledger" / f"{KEY}.toml").write_text(toml, encoding="utf-8")
    write_notebook(copy / "notebooks" / f"{KEY}.ipynb", *blocks("python"))
    command = [sys.executable, "-m", "mpt_helpers", "reproduce", KEY]
    subprocess.run(command, cwd=copy, env=os.environ | {"PYTHONPATH": str(copy)}, capture_output=True, check=True)
    return copy


@pytest.fixture
def said(copy, monkeypatch, capsys):
    """What the command line says of the copy's verdicts."""

    def said(*arguments):
        monkeypatch.setattr("mpt_helpers.ledger.paper.FOLDER", copy / "mpt_helpers" / "ledger")
        assert main(["verdicts", *arguments]) == 0
        return capsys.readouterr().out

    return said


def test_the_verdicts_on_the_new_paper_are_won(said):
    given = {each["id"]: each for each in json.loads(said(KEY, "--json"))}
    verdicts = {id: each["verdict"] for id, each in given.items()}
    assert verdicts == {"gain": "reproduced", "variance": "differs", "units": "reproduced"}
    assert given["variance"]["cause"] == "digits-exchanged"
    assert given["variance"]["computed"] == "0.618034"
    assert {each["basis"] for each in given.values()} == {"exact", "identity"}


def test_the_new_paper_is_counted_beside_the_others(said):
    others = keys()
    shown = said()
    assert re.findall(r"(?m)^(\w+): ", shown) == sorted([KEY, *others])
    assert f"{KEY}: 1 of 1 claims hold; 1 of 2 numbers" in " ".join(shown.split())
    assert "The filter is a little better than printed." in " ".join(shown.split())


def test_an_item_without_a_verdict_is_an_error_that_names_it(copy, monkeypatch):
    monkeypatch.setattr("mpt_helpers.ledger.paper.FOLDER", copy / "mpt_helpers" / "ledger")
    verdicts = stored_verdicts(copy / "notebooks" / f"{KEY}.ipynb")
    with pytest.raises(ValueError, match=f"{KEY}.toml and its notebook: no verdict on units"):
        published(KEY).complete([each for each in verdicts if each.id != "units"])


def test_the_page_says_of_cells_what_the_tests_hold_notebooks_to():
    cells = [cell for path in NOTEBOOKS for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]]
    folded = [cell["metadata"] for cell in cells if "ledger" in cell["metadata"].get("tags", [])]
    assert [each for each in folded if each != FOLDED] == []
    assert f"at most {LINES} lines" in PAGE


def test_the_page_names_every_room():
    (table,) = re.findall(r"(?s)\| room \|.*?\n\n", PAGE)
    for name in ("ledger/", "papers/", "plots", "__main__", "notebooks/", "docs/", "benchmarks/"):
        assert f"`{name}`" in table, name
