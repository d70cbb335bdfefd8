"""The command line, on a copy of the project."""

import csv
import errno
import io
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

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
    assert running.returncode == 130
    assert err.splitlines()[-1] == "error: interrupted"
    assert "Traceback" not in err
    assert files(project) == before
    assert sorted(path.name for path in project.iterdir()) == ["figures", "notebooks"]


# What a cell does to a paper that the package does not have: it is read from the folder of the notebook.
PAPER = """\
import pathlib, sys
import mpt_helpers as mpt
sys.modules["mpt_helpers.published"]._folder = pathlib.Path
paper = mpt.published("small")
paper.check("count", 17), paper.check("ratio", 1.29, band=(1.28, 1.3))"""
TOML = """
items = [
  { id = "count", where = "Table 1", kind = "number", printed = "17" },
  { id = "ratio", where = "Table 2", kind = "number", printed = "1.290" },
]
"""


@pytest.mark.parametrize(
    ("toml", "old", "new", "message"),
    [
        (TOML + "items = [", "", "", "cell cell-1 failed: ValueError: small.toml: "),
        (
            TOML,
            '"ratio"',
            '"count"',
            "cell cell-1 failed: ValueError: id: needs an item without a verdict, got 'count'",
        ),
    ],
)
def test_what_a_paper_refuses_is_said_and_nothing_is_touched(project, capsys, toml, old, new, message):
    (project / "notebooks" / "small.toml").write_text(toml)
    write_notebook(project / "notebooks" / "small.ipynb", MAKES_FIGURE, PAPER.replace(old, new))
    before = files(project)
    assert main(["reproduce"]) == 1
    shown = capsys.readouterr()
    assert shown.err.startswith(f"error: small: {message}")
    assert "Traceback" not in shown.err
    assert files(project) == before


@pytest.fixture
def finished(project, monkeypatch):
    """A project with committed files, whose notebook makes two of its three figures anew in no time."""
    for name in ("a", "b", "c"):
        (project / "figures" / f"{name}.png").write_bytes(b"old")

    def execute(key, folder):
        for name in ("a", "b"):
            (folder.parent / "figures" / f"{name}.png").write_bytes(b"new")
        return "new"

    monkeypatch.setattr("mpt_helpers.__main__._execute", execute)
    return project


def test_what_a_notebook_makes_is_moved_into_place(finished):
    before = files(finished)
    assert main(["reproduce"]) == 0
    new = {"figures/a.png": b"new", "figures/b.png": b"new", "notebooks/small.ipynb": b"new"}
    assert files(finished) == before | new


FULL = OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize(
    ("stop", "code", "message"), [(FULL, 1, "No space left"), (KeyboardInterrupt(), 130, "interr")]
)
@pytest.mark.parametrize("call", [(Path, "write_bytes"), (os, "replace")], ids=["write", "move"])
@pytest.mark.parametrize("at", [1, 2, 3])
def test_a_full_disk_or_an_interrupt_leaves_every_file_whole(
    finished, monkeypatch, capsys, call, at, stop, code, message
):
    before, real, calls = files(finished), getattr(*call), []

    def stops(path, *args):
        if Path(path).suffix == ".part":
            calls.append(path)
            if len(calls) == at:
                if call[1] == "write_bytes":
                    real(path, b"n")  # the part that still fits
                raise stop
        return real(path, *args)

    with monkeypatch.context() as patch:
        patch.setattr(*call, stops)
        assert main(["reproduce"]) == code
    shown = capsys.readouterr().err
    assert shown.startswith("error: ")
    assert message in shown
    moved = 0 if call[1] == "write_bytes" else at - 1
    new = ["figures/a.png", "figures/b.png", "notebooks/small.ipynb"][:moved]
    assert files(finished) == before | dict.fromkeys(new, b"new")  # the notebook last
    assert sorted(path.name for path in finished.iterdir()) == ["figures", "notebooks"]


def test_a_folder_in_the_place_of_a_figure_is_refused_before_any_file_is_moved(finished, capsys):
    (finished / "figures" / "b.png").unlink()
    (finished / "figures" / "b.png").mkdir()
    before = files(finished)
    assert main(["reproduce"]) == 1
    assert "error: a folder is in the place of the file figures" in capsys.readouterr().err
    assert files(finished) == before


def test_figures_that_are_a_file_or_read_only_are_refused_before_anything_runs(project, monkeypatch, capsys):
    monkeypatch.setattr("mpt_helpers.__main__._execute", None)
    with monkeypatch.context() as patch:
        patch.setattr("os.access", lambda path, mode: path != Path("figures"))
        assert main(["reproduce"]) == 1
    (project / "figures").rmdir()
    (project / "figures").write_text("mine")
    before = files(project)
    assert main(["reproduce"]) == 1
    assert capsys.readouterr().err == 2 * "error: figures: needs a folder that can be written to\n"
    assert files(project) == before


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"cells": 5, "nbformat": 4}', "\udcff"])
def test_what_is_no_notebook_is_named(project, capsys, content):
    path = project / "notebooks" / "small.ipynb"
    path.write_bytes(content.encode(errors="surrogateescape"))
    before = files(project)
    assert main(["reproduce"]) == 1
    assert capsys.readouterr().err.startswith("error: small: needs a notebook (")
    assert files(project) == before
    assert main(["verdicts"]) == 1
    assert "small.ipynb: needs an executed notebook" in capsys.readouterr().err


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
