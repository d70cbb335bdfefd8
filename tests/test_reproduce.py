"""The command line, on a copy of the project."""

import csv
import io
import json
import shutil
import signal
import subprocess
import sys

import pytest
from conftest import NOTEBOOKS, ROOT

from mpt_helpers.__main__ import main
from mpt_helpers.published import stored_verdicts

KEYS = [path.stem for path in NOTEBOOKS]
MAKES_FIGURE = """\
import mpt_helpers as mpt
fig, ax = mpt.figures.panels([["a"]])
_ = ax["a"].plot([1, 2])
mpt.save_figure(fig, "small_fig1")"""


def write_notebook(path, *sources):
    """Write a notebook that was never executed."""
    cells = [
        {"cell_type": "code", "id": f"cell-{i}", "metadata": {}, "execution_count": None, "outputs": [], "source": text}
        for i, text in enumerate(sources)
    ]
    kernel = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    path.write_text(json.dumps({"cells": cells, "metadata": kernel, "nbformat": 4, "nbformat_minor": 5}))


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A project with one small notebook, to work in."""
    (tmp_path / "notebooks").mkdir()
    (tmp_path / "figures").mkdir()
    shutil.copy(ROOT / "notebooks" / "matplotlibrc", tmp_path / "notebooks")
    write_notebook(tmp_path / "notebooks" / "small.ipynb", MAKES_FIGURE, "1 + 1")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def files(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_reproduce_executes_in_place_with_progress(project, capfd):
    assert main(["reproduce"]) == 0
    shown = capfd.readouterr()
    assert shown.out.splitlines() == ["small: cell 1 of 2, cell-0", "small: cell 2 of 2, cell-1"]
    assert shown.err == ""
    made = ["figures/small_fig1.png", "figures/small_fig1.svg"]
    assert sorted(files(project)) == [*made, "notebooks/matplotlibrc", "notebooks/small.ipynb"]
    cells = json.loads((project / "notebooks/small.ipynb").read_text())["cells"]
    assert [cell["execution_count"] for cell in cells] == [1, 2]
    assert not [cell["metadata"] for cell in cells if cell["metadata"]]


def test_reproduce_again_changes_no_byte(project):
    main(["reproduce"])
    before = files(project)
    assert main(["reproduce", "small"]) == 0
    assert files(project) == before


def test_a_notebook_that_fails_is_named_and_left_as_it_was(project, capsys):
    write_notebook(project / "notebooks" / "small.ipynb", MAKES_FIGURE, "x = 1", "{}['missing']", "2")
    before = files(project)
    assert main(["reproduce"]) == 1
    assert capsys.readouterr().err == "error: small: cell cell-2 failed: KeyError: 'missing'\n"
    assert files(project) == before


def test_a_kernel_that_dies_is_named_and_leaves_everything_as_it_was(project, capsys):
    write_notebook(project / "notebooks" / "small.ipynb", MAKES_FIGURE, "import os; os._exit(1)")
    before = files(project)
    assert main(["reproduce"]) == 1
    assert "error: small: cell cell-1 failed: " in capsys.readouterr().err
    assert files(project) == before


def test_an_interrupt_leaves_everything_as_it_was(project):
    write_notebook(project / "notebooks" / "small.ipynb", MAKES_FIGURE, "import time; time.sleep(60)")
    before = files(project)
    command = [sys.executable, "-m", "mpt_helpers", "reproduce"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        while "cell-1" not in running.stdout.readline():
            assert running.poll() is None
        running.send_signal(signal.SIGINT)
        _, err = running.communicate(timeout=30)
    assert running.returncode != 0
    assert err.splitlines()[-1].startswith("error: ")
    assert "Traceback" not in err
    assert files(project) == before


@pytest.mark.parametrize("command", ["reproduce", "verdicts"])
def test_an_unknown_key_lists_the_known_ones(project, capsys, command):
    before = files(project)
    assert main([command, "smal"]) == 1
    assert capsys.readouterr().err == "error: unknown notebook 'smal'; the known ones are small\n"
    assert files(project) == before


@pytest.mark.parametrize("command", ["reproduce", "verdicts"])
def test_another_folder_is_refused(tmp_path, monkeypatch, capsys, command):
    monkeypatch.chdir(tmp_path)
    assert main([command]) == 1
    assert "run this in the project's folder" in capsys.readouterr().err


def test_verdicts_of_a_notebook_that_was_not_executed_are_refused(project, capsys):
    assert main(["verdicts"]) == 1
    assert "small.ipynb: needs an executed notebook" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [[], ["reproduce"], ["verdicts"]])
def test_help(arguments, capsys):
    with pytest.raises(SystemExit) as done:
        main([*arguments, "--help"])
    assert done.value.code == 0
    assert "usage: python -m mpt_helpers" in capsys.readouterr().out


def test_verdicts_are_printed_without_running_a_notebook(monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    monkeypatch.setitem(sys.modules, "nbclient", None)
    assert main(["verdicts", "--json"]) == 0
    records = json.loads(capsys.readouterr().out)
    assert records == [each for path in NOTEBOOKS for each in stored_verdicts(path).records()]
    assert list(records[0]) == ["paper", "id", "where", "kind", "printed", "computed", "verdict", "reason", "cell"]
    assert main(["verdicts", "--csv"]) == 0
    assert list(csv.DictReader(io.StringIO(capsys.readouterr().out))) == records
    assert main(["verdicts", KEYS[0]]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1 + sum(record["paper"] == KEYS[0] for record in records)


def test_the_readme_gets_the_table_of_the_notebooks(tmp_path, monkeypatch, capsys):
    shutil.copytree(ROOT / "notebooks", tmp_path / "notebooks")
    monkeypatch.chdir(tmp_path)
    assert main(["readme"]) == 1
    assert "README.md: No such file" in capsys.readouterr().err
    readme = tmp_path / "README.md"
    readme.write_text("words\n")
    assert main(["readme"]) == 1
    assert "README.md: needs one place for the table of verdicts, got 0" in capsys.readouterr().err
    assert readme.read_text() == "words\n"
    readme.write_text("above\n<!-- verdicts: here -->\nold\n<!-- end of verdicts -->\nbelow\n")
    assert main(["readme"]) == 0
    lines = readme.read_text().splitlines()
    assert lines[:2] == ["above", "<!-- verdicts: here -->"]
    assert lines[-2:] == ["<!-- end of verdicts -->", "below"]
    assert [f"[{key}](notebooks/{key}.ipynb)" in "\n".join(lines) for key in KEYS] == [True] * len(KEYS)
    assert "old" not in lines


def test_the_committed_notebooks_and_figures_come_out_byte_for_byte(tmp_path):
    for folder in ("notebooks", "figures", "benchmarks"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns(".ipynb_checkpoints"))
    before = files(tmp_path)
    for path in tmp_path.glob("figures/*"):
        path.unlink()
    subprocess.run([sys.executable, "-m", "mpt_helpers", "reproduce"], cwd=tmp_path, check=True)
    after = files(tmp_path)
    assert sorted(after) == sorted(before)
    assert [name for name in before if after[name] != before[name]] == []
