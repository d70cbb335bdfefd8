"""The command line, on a copy of the project."""

import csv
import errno
import gc
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import warnings
from contextlib import chdir
from pathlib import Path

import pytest
from conftest import KERNEL, PAPER, ROOT, VERDICTS, write_notebook
from jupyter_client import KernelManager
from nbformat.v4 import new_output

import mpt_helpers as mpt
from reproduction import runner
from reproduction.__main__ import as_text, main
from reproduction.execute import through_files
from reproduction.ledger import keys, shipped_verdicts, stored_verdicts
from reproduction.ledger.verdicts import FIELDS, MIME
from reproduction.readme import HOLDS, ON_GITHUB, block

PLOTS = """\
from reproduction import plots
from reproduction.figures import save_figure
fig, ax = plots.panels([["a"]])
ax["a"].plot([1, 2])
save_figure(fig, "small_fig1")"""
# A figure in no time.
MAKES_FIGURE = "open('../figures/small_fig1.png', 'wb').write(b'PNG');"
# What a cell does: it waits at most a minute for another notebook, or tells its process's number and sleeps.
WAITS = """\
import time
from pathlib import Path
Path(own).touch()
end = time.time() + 60
while not Path(other).exists():
    assert time.time() < end
    time.sleep(0.02)"""
SLEEPS = "import os, pathlib, time; pathlib.Path({sign!r}).write_text(str(os.getpid())); time.sleep(300)"
SMALL = "notebooks/small.ipynb"


def files(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


ROWS = """
[[contents]]
heading = "All"
ids = ["count", "ratio", "wrong", "equal", "lost"]
shows = "everything"
"""


@pytest.fixture
def another_python3(tmp_path_factory, monkeypatch):
    """A kernel of the user that is named python3, which does not run: Jupyter's own finder would prefer it."""
    data = tmp_path_factory.mktemp("data")
    kernel = data / "kernels" / "python3"
    kernel.mkdir(parents=True)
    of_another = {"argv": ["false", "{connection_file}"], "display_name": "Python 3", "language": "python"}
    (kernel / "kernel.json").write_text(json.dumps(of_another))
    monkeypatch.setenv("JUPYTER_DATA_DIR", str(data))
    monkeypatch.setenv("JUPYTER_PREFER_ENV_PATH", "0")


@pytest.mark.usefixtures("another_python3")
def test_reproduce_executes_in_place_stores_the_verdicts_and_again_changes_no_byte(project, monkeypatch, capfd):
    """By the Python that runs it. It writes the contents, too."""
    (project / "reproduction/ledger/small.toml").write_text(PAPER + ROWS)
    write_notebook(project / SMALL, VERDICTS, PLOTS)
    notebook = json.loads((project / SMALL).read_text())
    front = "# Small\n\n<!-- contents --><!-- end of contents -->\n"
    notebook["cells"].insert(0, {"cell_type": "markdown", "id": "front", "metadata": {}, "source": front})
    (project / SMALL).write_text(json.dumps(notebook))
    before = files(project)
    assert main(["reproduce"]) == 0
    shown = capfd.readouterr()
    ran, outcome = shown.out.splitlines()
    assert ran == "small: 2 cells executed"
    assert outcome.startswith("the notebooks ran; not as before: figures/small_fig1.png, ")
    assert shown.err == ""
    made = ["figures/small_fig1.png", "figures/small_fig1.svg", "reproduction/ledger/small.json"]
    assert sorted(files(project)) == sorted([*before, *made])
    notebook = json.loads((project / SMALL).read_text())
    assert notebook["metadata"]["language_info"] == {"name": "python"}
    assert [cell["execution_count"] for cell in notebook["cells"][1:]] == [1, 2]
    written = "".join(notebook["cells"][0]["source"])
    assert "4 of them can be checked: 3 hold, 1 does not, for 1 reason." in written
    assert "| [All](#All) | everything | ✗ 1 of 4 wrong; ? 1 lost in our copy |" in written
    assert not [cell["metadata"] for cell in notebook["cells"] if cell["metadata"]]
    assert list(shipped_verdicts()) == list(stored_verdicts(SMALL))
    assert [each.cell for each in shipped_verdicts()] == 5 * ["cell-0"]

    before = files(project)
    monkeypatch.chdir(project / "notebooks")
    assert main(["reproduce", "small"]) == 0
    assert files(project) == before
    same = "the notebooks ran, and all 4 files that they make are as before, byte for byte"
    assert capfd.readouterr().out.splitlines()[-1] == same


def test_a_notebook_without_a_place_for_its_contents_changes_no_file(project, capsys):
    (project / "reproduction/ledger/small.toml").write_text(PAPER + ROWS)
    before = files(project)
    assert main(["reproduce"]) == 1
    assert (
        "small.ipynb: needs <!-- contents --> and <!-- end of contents --> once, got them 0 times"
        in capsys.readouterr().err
    )
    assert files(project) == before


def without_ids(path, minor):
    """Make the notebook in a file one of an older format, in which cells have no ids."""
    notebook = json.loads(path.read_text())
    for cell in notebook["cells"]:
        del cell["id"]
    path.write_text(json.dumps(notebook | {"nbformat_minor": minor}))


def test_notebooks_run_side_by_side_and_a_terminal_tells_the_time_left(project, tmp_path_factory, monkeypatch, capsys):
    """One of them is of an older format."""
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    (project / SMALL).unlink()
    signs = tmp_path_factory.mktemp("signs")
    for own, other in (("one", "two"), ("two", "one")):
        names = f"own, other = {str(signs / own)!r}, {str(signs / other)!r}"
        write_notebook(project / f"notebooks/{own}.ipynb", names, f"{WAITS}\nprint(6 * 7)")
    without_ids(project / "notebooks/one.ipynb", 2)
    assert main(["reproduce"]) == 0
    old = json.loads((project / "notebooks/one.ipynb").read_text())
    assert old["cells"][1]["outputs"][0]["text"] == ["42\n"]
    assert (old["nbformat"], old["nbformat_minor"]) == (4, 2)
    out = capsys.readouterr().out
    assert out.count("\n") == 3  # the line that tells the time is written over; the last one says what is new
    assert "one: 2 cells executed\n" in out
    assert "two: 2 cells executed\n" in out
    assert "cell 0 of 4" in out
    assert "cell 4 of 4" in out
    assert " left" in out


def test_without_jupyter_the_extra_is_named(project, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "nbclient", None)
    assert main(["reproduce"]) == 1
    assert capsys.readouterr().err == "error: reproduce needs Jupyter: pip install 'mpt_helpers[notebooks]'\n"


@pytest.mark.parametrize("command", ["reproduce", "tidy"])
def test_without_nbformat_too(project, monkeypatch, capsys, command):
    monkeypatch.setitem(sys.modules, "nbformat", None)
    assert main([command]) == 1
    assert capsys.readouterr().err == f"error: {command} needs Jupyter: pip install 'mpt_helpers[notebooks]'\n"


@pytest.fixture
def copied(tmp_path, monkeypatch):
    """A project with a copy of the package, whose notebook says which package it runs."""
    for half in ("mpt_helpers", "reproduction"):
        shutil.copytree(ROOT / half, tmp_path / half)  # with what Python has compiled, which takes it seconds
    (tmp_path / "notebooks").mkdir()
    write_notebook(tmp_path / "notebooks/own.ipynb", "import mpt_helpers; print(mpt_helpers.__file__)")
    return tmp_path


def reproduce_in(folder):
    command = [sys.executable, "-m", "reproduction", "reproduce"]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True)


def test_the_notebooks_of_a_copied_project_run_its_own_package(copied):
    run = reproduce_in(copied)
    assert (run.stdout.splitlines()[0], run.stderr, run.returncode) == ("own: 1 cells executed", "", 0)
    assert str(copied / "mpt_helpers/__init__.py") in (copied / "notebooks/own.ipynb").read_text()


def test_a_copied_project_is_refused_to_another_package(copied):
    """From its notebooks/, Python finds the installed package."""
    before = files(copied)
    run = reproduce_in(copied / "notebooks")
    need = f"the reproduction that runs is that of {ROOT}, not of {copied}: run this in {copied}"
    assert run.stderr == f"error: {need}\n"
    assert (run.stdout, run.returncode) == ("", 1)
    assert files(copied) == before


def test_a_notebook_that_fails_is_named_ends_the_others_and_all_are_left_as_they_were(project, capsys):
    """Of an older format, in which cells are numbered."""
    write_notebook(project / SMALL, MAKES_FIGURE, "x = 1", "{}['missing']", "2")
    without_ids(project / SMALL, 4)
    write_notebook(project / "notebooks/other.ipynb", MAKES_FIGURE, "import time; time.sleep(300)")
    before = files(project)
    start = time.monotonic()
    assert main(["reproduce"]) == 1
    assert time.monotonic() - start < 200
    assert capsys.readouterr().err == "error: small: cell 3 failed: KeyError: 'missing'\n"
    assert files(project) == before


def test_a_kernel_that_dies_is_named_and_leaves_everything_as_it_was(project, capsys):
    write_notebook(project / SMALL, MAKES_FIGURE, "import os; os._exit(1)")
    before = files(project)
    assert main(["reproduce"]) == 1
    assert "error: small: cell cell-1 failed: Kernel died" in capsys.readouterr().err
    assert files(project) == before


@pytest.mark.skipif(os.name != "posix", reason="a signal of POSIX")
@pytest.mark.parametrize("end", ["SIGTERM", "SIGHUP"])
def test_a_termination_and_the_end_of_the_terminal_are_ends_like_an_interrupt(end):
    end = getattr(signal, end)
    before = signal.signal(end, signal.SIG_DFL)  # nohup may have had it ignored
    try:
        with runner._ends_interrupt():
            stop = signal.getsignal(end)
        assert signal.getsignal(end) == signal.SIG_DFL
    finally:
        signal.signal(end, before)
    with pytest.raises(SystemExit) as done:
        stop()
    assert done.value.code == 143


def test_an_interrupt_ends_all_kernels_and_leaves_everything_as_it_was(project, tmp_path_factory):
    keys = ["small", "other"]
    signs = tmp_path_factory.mktemp("signs")
    for key in keys:
        sleeps = SLEEPS.format(sign=str(signs / key))
        write_notebook(project / f"notebooks/{key}.ipynb", MAKES_FIGURE, sleeps)
    shutil.rmtree(project / "reproduction")  # which is not the package that the command runs
    before = files(project)
    # Whatever started the tests may ignore it, as a job in the background does.
    listens = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler);"
    runs = f"{listens} import sys; from reproduction.__main__ import main; sys.exit(main(['reproduce']))"
    command = [sys.executable, "-c", runs]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        expected = min(len(keys), os.cpu_count())
        # A sign is written when its text is there.
        while len([text for path in signs.iterdir() if (text := path.read_text())]) < expected:
            assert running.poll() is None, running.communicate()
            time.sleep(0.05)
        kernels = [path.read_text() for path in signs.iterdir()]
        running.send_signal(signal.SIGINT)
        _, err = running.communicate(timeout=60)
    assert (running.returncode, err) == (130, "error: interrupted\n")
    assert files(project) == before
    assert not list(project.glob(".reproduce-*"))
    for kernel in kernels:
        with pytest.raises(ProcessLookupError):
            os.kill(int(kernel), 0)


EMPTY = {"cells": [], "metadata": KERNEL | {"language_info": {"name": "python"}}, "nbformat": 4, "nbformat_minor": 5}
NEW = {
    "figures/a.png": b"new",
    "figures/b.png": b"new",
    "notebooks/plain.ipynb": f"{json.dumps(EMPTY, indent=1)}\n".encode(),  # the notebook last
}


@pytest.fixture
def finished(project, monkeypatch):
    """A project with committed files, whose notebook (of no paper) makes two of three figures anew in no time."""
    (project / SMALL).rename(project / "notebooks/plain.ipynb")
    for name in ("a", "b", "c"):
        (project / "figures" / f"{name}.png").write_bytes(b"old")

    def execute(processes, key, stage, bar):
        for name in ("a", "b"):
            (stage / "figures" / f"{name}.png").write_bytes(b"new")
        (stage / f"notebooks/{key}.ipynb").write_bytes(NEW["notebooks/plain.ipynb"])

    monkeypatch.setattr(runner._Processes, "execute", execute)
    return project


def test_in_a_checkout_the_last_line_says_what_is_not_as_committed(finished, capsys):
    def git(*arguments):
        subprocess.run(["git", "-c", "user.name=me", "-c", "user.email=@", *arguments], check=True, capture_output=True)

    git("init")
    said = []
    for committed in NEW, NEW | {"figures/b.png": b"another"}:
        for name, content in committed.items():
            (finished / name).write_bytes(content)
        git("add", ".")
        git("commit", "-m", "all")
        assert main(["reproduce"]) == 0
        said.append(capsys.readouterr().out.splitlines()[-1])
    assert said[0].endswith("are as committed, byte for byte")
    assert said[1] == "the notebooks ran; not as committed: figures/b.png"


def test_without_git_what_stood_there_before_is_compared(finished, monkeypatch, tmp_path_factory, capsys):
    """A ZIP of the project on a machine without git: all has run, so that nothing is an error."""
    monkeypatch.setenv("PATH", str(tmp_path_factory.mktemp("nothing")))
    for end in ("not as before: ", "are as before, byte for byte"):
        assert main(["reproduce"]) == 0
        shown = capsys.readouterr()
        assert end in shown.out.splitlines()[-1]
        assert shown.err == ""


def test_what_a_notebook_makes_is_moved_into_place(finished):
    before = files(finished)
    assert main(["reproduce"]) == 0
    assert files(finished) == before | NEW


def test_a_folder_that_a_run_of_another_day_has_left_is_removed(finished):
    """As when the machine went down. One of today may be at work."""
    for name, hours in ((".reproduce-old", 25), (".reproduce-new", 23)):
        (finished / name / "notebooks").mkdir(parents=True)
        os.utime(finished / name, (time.time() - 3600 * hours,) * 2)
    assert main(["reproduce"]) == 0
    assert [path.name for path in finished.glob(".reproduce-*")] == [".reproduce-new"]


@pytest.mark.parametrize("edit", [lambda path: path.write_text("mine"), Path.unlink], ids=["edited", "removed"])
def test_a_notebook_that_is_edited_while_it_runs_is_left_as_it_is(finished, monkeypatch, capsys, edit):
    """What the run made is kept elsewhere, and other notebooks are written."""
    monkeypatch.setattr("os.cpu_count", lambda: 1)  # or the other one may be copying the notebooks just then
    path = finished / "notebooks/plain.ipynb"
    write_notebook(path.with_name("other.ipynb"), "1 + 1")
    before, execute = files(finished), runner._Processes.execute

    def edited_meanwhile(processes, key, *args):
        execute(processes, key, *args)
        if key == "plain":
            edit(path)

    monkeypatch.setattr(runner._Processes, "execute", edited_meanwhile)
    assert main(["reproduce"]) == 1
    kept = "reproduced/plain"
    assert capsys.readouterr().err == (
        "error: notebooks/plain.ipynb was edited while it ran and is left as it is: "
        f"what this run made lies in {kept}\n"
    )
    expected = before | NEW | {f"{kept}/{name}": content for name, content in NEW.items()}
    expected["notebooks/other.ipynb"] = expected.pop("notebooks/plain.ipynb")
    after = files(finished)
    assert after.pop("notebooks/plain.ipynb", None) in (b"mine", None)
    assert after == expected


@pytest.mark.parametrize(
    ("stop", "code", "message"),
    [(OSError(errno.ENOSPC, "No space left on device"), 1, "No space left"), (KeyboardInterrupt(), 130, "interr")],
)
@pytest.mark.parametrize("call", [(Path, "open"), (os, "replace")], ids=["write", "move"])
@pytest.mark.parametrize("at", [1, 2, 3])
def test_a_full_disk_or_an_interrupt_leaves_every_file_whole(
    finished, monkeypatch, capsys, call, at, stop, code, message
):
    before, real, calls = files(finished), getattr(*call), []

    def stops(path, *args, **kwargs):
        if Path(path).suffix == ".part":
            calls.append(path)
            if len(calls) == at:
                if call[1] == "open":
                    with real(path, *args, **kwargs) as file:
                        file.write(b"n")  # the part that still fits
                raise stop
        return real(path, *args, **kwargs)

    with monkeypatch.context() as patch:
        patch.setattr(*call, stops)
        assert main(["reproduce"]) == code
    shown = capsys.readouterr().err
    assert shown.startswith("error: ")
    assert message in shown
    if code == 1 and call[1] == "open":
        assert list(NEW)[at - 1] in shown
    moved = 0 if call[1] == "open" else at - 1
    assert files(finished) == before | dict(list(NEW.items())[:moved])
    assert not list(finished.glob(".reproduce-*"))


@pytest.mark.skipif(sys.platform == "win32", reason="a limit of the size of files, which stands for a full disk")
def test_a_copy_that_fails_is_named(project, capsys):
    """Not as a list of all files."""
    for name in ("a", "b"):
        (project / "notebooks" / name).write_bytes(bytes(100_000))
    resource = pytest.importorskip("resource")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, limits[1]))
    try:
        assert main(["reproduce"]) == 1
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    told = capsys.readouterr().err
    assert re.fullmatch(rf"error: {project}/notebooks/[ab]: cannot be copied: .*File too large.*\n", told)
    assert not list(project.glob(".reproduce-*"))


def test_a_folder_in_the_place_of_a_figure_is_refused_before_any_file_is_moved(finished, capsys):
    (finished / "figures" / "b.png").unlink()
    (finished / "figures" / "b.png").mkdir()
    before = files(finished)
    assert main(["reproduce"]) == 1
    assert "error: a folder is in the place of the file " in capsys.readouterr().err
    assert files(finished) == before


def test_figures_that_are_a_file_or_read_only_are_refused_before_anything_runs(project, monkeypatch, capsys):
    monkeypatch.setattr(runner._Processes, "execute", None)
    with monkeypatch.context() as patch:
        patch.setattr("os.access", lambda path, mode: path.name != "figures")
        assert main(["reproduce"]) == 1
    (project / "figures").rmdir()
    (project / "figures").write_text("mine")
    before = files(project)
    assert main(["reproduce"]) == 1
    assert capsys.readouterr().err == 2 * "error: figures: needs a folder that can be written to\n"
    assert files(project) == before


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"cells": 5, "nbformat": 4}', "\udcff"])
@pytest.mark.parametrize("command", ["reproduce", "tidy"])
def test_what_is_no_notebook_is_named(project, capsys, command, content):
    path = project / "notebooks" / "small.ipynb"
    path.write_bytes(content.encode(errors="surrogateescape"))
    before = files(project)
    assert main([command]) == 1
    assert capsys.readouterr().err.startswith("error: small: needs a notebook (")
    assert files(project) == before


@pytest.mark.parametrize("command", ["reproduce", "verdicts", "tidy"])
def test_an_unknown_key_lists_the_known_ones(project, capsys, command):
    before = files(project)
    assert main([command, "smal"]) == 1
    assert capsys.readouterr().err == "error: unknown notebook 'smal'; the known ones are small\n"
    assert files(project) == before


@pytest.mark.parametrize("command", ["reproduce", "readme", "tidy"])
def test_another_folder_is_refused(tmp_path, monkeypatch, capsys, command):
    monkeypatch.chdir(tmp_path)
    assert main([command]) == 1
    assert "needs the project's root or its notebooks/" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [[], ["reproduce"], ["verdicts"]])
def test_help(arguments, capsys):
    with pytest.raises(SystemExit) as done:
        main([*arguments, "--help"])
    assert done.value.code == 0
    assert "usage: python -m reproduction" in capsys.readouterr().out


def test_the_version(capsys):
    with pytest.raises(SystemExit):
        main(["--version"])
    assert capsys.readouterr().out == f"mpt_helpers {mpt.__version__}\n"


@pytest.fixture
def reported(project):
    """The verdicts that the made-up paper's notebook gives."""
    given = {}
    with chdir("notebooks"):
        exec(VERDICTS.removesuffix("paper.report()"), given)
    return given["paper"].report()


def test_verdicts_that_do_not_cover_the_paper_are_refused(project, reported, monkeypatch, capsys):
    def execute(processes, key, stage, bar):
        (stage / "figures/small_fig1.png").write_bytes(b"new")
        notebook = json.loads((stage / SMALL).read_text())
        records = [each for each in reported._repr_mimebundle_()[MIME] if each["id"] != "count"]
        notebook["cells"][0]["outputs"] = [new_output("display_data", {MIME: records})]
        (stage / SMALL).write_text(json.dumps(notebook))

    monkeypatch.setattr(runner._Processes, "execute", execute)
    before = files(project)
    assert main(["reproduce"]) == 1
    assert capsys.readouterr().err == "error: small.toml and its notebook: no verdict on count\n"
    assert files(project) == before


@pytest.fixture
def shipped(project, reported):
    """The same, as the package ships them."""
    (project / "reproduction/ledger/small.json").write_text(reported.as_json())
    return shipped_verdicts()


def test_verdicts_are_printed_from_any_folder_without_jupyter(shipped, tmp_path_factory, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    monkeypatch.setitem(sys.modules, "nbclient", None)
    assert main(["verdicts", "--json"]) == 0
    records = json.loads(capsys.readouterr().out)
    assert [record["id"] for record in records] == ["count", "ratio", "wrong", "equal", "lost"]
    assert list(records[0]) == list(FIELDS)
    assert main(["verdicts", "small", "--csv"]) == 0
    assert list(csv.DictReader(io.StringIO(capsys.readouterr().out))) == records


@pytest.mark.parametrize("form", ["--json", "--csv"])
def test_a_table_of_verdicts_has_all_of_them_whether_or_not_all_are_asked_for(shipped, form, capsys):
    assert main(["verdicts", form]) == 0
    table = capsys.readouterr().out
    for arguments in (["--all", form], [form, "small", "--all"]):
        assert main(["verdicts", *arguments]) == 0
        assert capsys.readouterr().out == table


def test_verdicts_have_one_form(shipped, capsys):
    with pytest.raises(SystemExit):
        main(["verdicts", "--json", "--csv"])
    assert "--csv: not allowed with argument --json" in capsys.readouterr().err


def test_the_summary_of_verdicts_comes_first_in_lines_of_the_terminal(shipped, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "60")
    assert main(["verdicts"]) == 0
    summary = capsys.readouterr().out
    assert summary.replace("\n    ", " ").splitlines() == [
        "small: 1 of 1 claims hold; 2 of 4 numbers, formulas and",
        "figures agree; 1 slip (1 cell); 1 cell missing or illegible",
        "in our copy.",
        "  slip one-missing (1): One is missing: 326 for 336. Count ten more.",
        "  copy our-copy (1): Our copy has lost the cell. Nothing.",
    ]
    assert main(["verdicts", "--all"]) == 0
    every = capsys.readouterr().out
    assert every.startswith(summary)
    assert max(map(len, every.splitlines())) <= 60
    rows = every.removeprefix(summary).replace("\n    ", " ").splitlines()
    assert rows[2] == (
        "  wrong: Table 3: printed 326; computed 336; erratum (arithmetic, one-missing). "
        "One is missing: 326 for 336. Against Table 1: 17."
    )
    assert [row.split(":")[0].strip() for row in rows] == ["count", "ratio", "wrong", "equal", "lost"]


def test_the_counts_of_several_papers_and_of_all_stand_before_the_first_cause():
    summary, *papers = as_text(shipped_verdicts(), every=False, width=1000).split("\n\n")
    assert [line.split(":")[0] for line in summary.splitlines()] == ["all papers", *keys()]
    assert [paper.split(":")[0] for paper in papers] == keys()


def test_a_paper_that_is_named_twice_is_counted_once(shipped, capsys):
    assert main(["verdicts", "small"]) == 0
    once = capsys.readouterr().out
    assert main(["verdicts", "small", "small"]) == 0
    assert capsys.readouterr().out == once


def test_verdicts_of_another_version_are_an_error_that_names_their_file(shipped, project, capsys):
    path = project / "reproduction/ledger/small.json"
    path.write_text(path.read_text().replace("one-missing", "another"))
    for command in ("verdicts", "readme"):
        assert main([command]) == 1
        assert capsys.readouterr().err.startswith(f"error: {path}: needs verdicts of this version")


def test_ids_are_not_broken_at_their_hyphens(shipped, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "17")
    assert main(["verdicts"]) == 0
    assert "one-missing" in capsys.readouterr().out


def test_without_verdicts_the_header_stands_alone(project, capsys):
    for form, shown in (("--csv", ",".join(FIELDS)), ("--json", "[]"), ("--all", "no verdicts are stored yet")):
        assert main(["verdicts", form]) == 0
        assert capsys.readouterr().out.startswith(shown)


LONG = """\
import sys
from reproduction import __main__ as command
command.as_text = lambda *all: 'line\\n' * 100_000
sys.exit(command.main(["verdicts"]))"""


def test_verdicts_into_head_end_silently():
    shell = ["bash", "-c", 'set -o pipefail; "$0" -c "$1" | head -1', sys.executable, LONG]
    run = subprocess.run(shell, capture_output=True, text=True)
    assert (run.stdout, run.stderr, run.returncode) == ("line\n", "", 0)


@pytest.mark.slow  # `reproduce` itself leaves no more than outputs
def test_after_jupyter_execute_tidy_leaves_outputs_only(project):
    (project / SMALL).unlink()
    write_notebook(project / "notebooks/plain.ipynb", "1 + 1")
    path = project / "notebooks/plain.ipynb"
    notebook = json.loads(path.read_text())
    notebook["cells"][0] |= {
        "execution_count": 1,
        "outputs": [new_output("execute_result", {"text/plain": "2"}, execution_count=1)],
    }
    path.write_text(json.dumps(notebook))
    assert main(["tidy"]) == 0
    before = files(project)
    command = [sys.executable, "-m", "jupyter", "execute", "--inplace", "notebooks/plain.ipynb"]
    subprocess.run(command, check=True, capture_output=True)
    assert files(project) != before  # the version of Python, the times of the cells
    assert main(["tidy"]) == 0
    assert files(project) == before


ABOUT = """\
paper = { name = "Small", title = "T", authors = "A", journal = "J", year = 1960, doi = "", tables = 2, figures = 1,
    question = "Is it?", answer = "It is." }
"""


def test_the_readme_gets_the_counts(shipped, project, capsys):
    path, ledger = project / "README.md", project / "reproduction/ledger/small.toml"
    ledger.write_text(ABOUT.replace("\n    ", " ") + ledger.read_text())
    assert main(["readme"]) == 1
    assert re.search("error: .*No such file .*README.md", capsys.readouterr().err)
    path.write_text("words\n")
    assert main(["readme"]) == 1
    assert "README.md: needs one place for the papers, got 0" in capsys.readouterr().err
    assert path.read_text() == "words\n"
    path.write_text("above\n<!-- papers: here -->\nold\n<!-- end of papers -->\nbelow\n")
    assert main(["readme"]) == 0
    tables = " ".join(f"[{n}](notebooks/small.ipynb#Table-{n})" for n in (1, 2))
    figure, ours = "[1](figures/small_fig1.png)", "[our notebook](notebooks/small.ipynb)"
    assert path.read_text().splitlines() == [
        "above",
        "<!-- papers: here -->",
        "",
        ON_GITHUB,
        "",
        "| paper | question, and answer | hold / in part / fail | tables | figures |",
        "|---|---|---|---|---|",
        f"| A, *T*, 1960: {ours} | Is it? **It is.** | 3 / 0 / 1 | {tables} | {figure} |",
        "",
        HOLDS,
        "",
        "Of the 1 items that cannot be checked, 1 are lost in this text, 0 have one doubtful character, and 0 need "
        "details that the paper leaves out.",
        "",
        "<!-- end of papers -->",
        "below",
    ]


def test_the_counts_of_the_readme_add_up_to_what_could_be_checked():
    rows = [
        row.strip("|").split("|")
        for row in block(shipped_verdicts()).splitlines()
        if ".ipynb)" in row and row.startswith("| ")
    ]
    assert len(rows) == len(keys())
    assert sum(int(count) for row in rows for count in row[2].split("/")) == shipped_verdicts().checked()["checked"]


def test_verdicts_into_a_file_are_utf_8_whatever_the_terminal_has():
    command = [sys.executable, "-m", "reproduction", "verdicts", "--json"]
    ran = subprocess.run(command, capture_output=True, env=os.environ | {"PYTHONIOENCODING": "cp1252"}, cwd=ROOT)
    assert ran.returncode == 0, ran.stderr
    assert "σ" in str(json.loads(ran.stdout.decode("utf-8")))


def test_a_reader_that_closes_the_pipe_leaves_reproduce_unfinished(project, monkeypatch):
    """What was not executed was not reproduced; `verdicts | head` is."""

    def closed(*_):
        raise BrokenPipeError

    for name in ("reproduce_and_say", "show_verdicts"):
        monkeypatch.setattr(f"reproduction.__main__.{name}", closed)
    with monkeypatch.context() as patch:
        patch.setattr("os.dup2", lambda nothing, _: os.close(nothing))  # the output of the tests stays
        assert [main([command]) for command in ("reproduce", "verdicts")] == [1, 0]


@pytest.mark.skipif(os.name != "posix", reason="elsewhere kernels use ports")
@pytest.mark.parametrize(("folder", "fits"), [("/sockets", True), ("/" + 97 * "a", False)])
def test_kernels_use_ports_where_a_path_is_too_long_for_a_socket(folder, fits):
    assert bool(through_files(folder)) == fits


@pytest.mark.skipif(os.name != "posix", reason="elsewhere kernels use ports")
def test_the_folder_of_a_kernel_goes_with_its_manager_without_a_word():
    manager = KernelManager()
    folder = Path(manager.connection_file).parent
    assert folder.is_dir()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        del manager
        gc.collect()
    assert not folder.exists()
