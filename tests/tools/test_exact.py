"""`make test` runs each notebook once, under nbval with the plugin `exact`: whatever a reader sees goes red."""

import json
import os
import re
import shutil
import subprocess
import sys
from contextlib import chdir

import pytest
from conftest import ROOT, write_notebook
from drawn import every_change_is_described

from reproduction import figures, plots
from reproduction.__main__ import main

FIRST = """\
from reproduction import plots
from reproduction.figures import save_figure
from reproduction.ledger import Table
def draw(name):
    fig, ax = plots.panels([["a"]])
    ax["a"].plot([1, 2, 3], label="a")
    plots.finish(ax["a"], "k", "A line")
    return fig"""
TABLE = 'Table(["a"], [["one"]])'


def figure(name):
    return f'fig = draw("{name}")\nsave_figure(fig, "small_{name}")'


# What a cell holds, and what is done to it after it was executed.
CELLS = {
    "imports": (FIRST, None),
    "text": ("print(17)", lambda cell, folder: cell["outputs"][0].update(text=["18\n"])),
    "html": (TABLE, lambda cell, folder: cell["outputs"][0]["data"].update({"text/html": ["<b>one</b>"]})),
    "gone": ("print(1)", lambda cell, folder: cell.update(outputs=[])),
    "png": (figure("png"), lambda cell, folder: cell["outputs"][0]["data"].update({"image/png": "AAAA"})),
    "alt": (figure("alt"), lambda cell, folder: cell["outputs"][0]["metadata"]["image/png"].update(alt="a curve")),
    "png_file": (figure("png_file"), lambda cell, folder: (folder / "small_png_file.png").write_bytes(b"other")),
    "svg_file": (figure("svg_file"), lambda cell, folder: (folder / "small_svg_file.svg").write_text("<svg/>")),
    "left": (figure("left"), None),
    "printed": ("print(17)", None),
    "table": (TABLE, None),
    "names": ("[name for name in dir() if name in ('os', 're', 'pytest', 'exact', 'watch')]", None),
}


@pytest.fixture(scope="module")
def executed_once(tmp_path_factory):
    """A project whose one notebook was executed: to be copied."""
    project = tmp_path_factory.mktemp("executed") / "project"
    for folder in ("notebooks", "figures"):
        (project / folder).mkdir(parents=True)
    write_notebook(project / "notebooks" / "small.ipynb", *(source for source, _ in CELLS.values()))
    with chdir(project):
        assert main(["reproduce"]) == 0
    return project


@pytest.fixture
def executed(executed_once, tmp_path):
    """A copy of the project whose one notebook was executed."""
    return shutil.copytree(executed_once, tmp_path / "project")


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """Somebody's own settings: code that IPython and Python run first, a style, a backend, coloured output, a zone."""
    mine = tmp_path / "mine"
    (mine / "profile_default" / "startup").mkdir(parents=True)
    (mine / "profile_default" / "startup" / "first.py").write_text("import os")
    (mine / "python.py").write_text("import re")  # the last cell would show the names
    (mine / "matplotlibrc").write_text("lines.linestyle: --\nfigure.facecolor: red\n")
    variables = {"IPYTHONDIR": mine, "PYTHONSTARTUP": mine / "python.py", "MATPLOTLIBRC": mine / "matplotlibrc"}
    variables |= {"MPLBACKEND": "svg", "FORCE_COLOR": "1", "TZ": "Pacific/Auckland", "LC_ALL": "C"}
    for name, value in variables.items():
        monkeypatch.setenv(name, str(value))


def failures(project):
    """Return the names of the cells that fail, and what is printed."""
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "--color=no",
        "-p",
        "tests.support.exact",
        "-p",
        "no:cacheprovider",
    ]
    command += ["--rootdir", project, "--nbval", "--nbval-current-env", "notebooks"]
    here = os.environ | {"PYTHONPATH": str(ROOT)}
    run = subprocess.run(command, cwd=project, env=here, capture_output=True, text=True)
    names = list(CELLS)
    return [names[int(number)] for number in re.findall(r"(?m)^FAILED .*::Cell (\d+)", run.stdout)], run.stdout


@pytest.mark.slow
def test_a_notebook_is_the_same_whoever_runs_it(executed, mine, monkeypatch):
    monkeypatch.chdir(executed)
    before = {path: path.read_bytes() for path in executed.rglob("*.*") if path.is_file()}
    assert len(before) > 10
    assert main(["reproduce"]) == 0
    assert {path: path.read_bytes() for path in executed.rglob("*.*") if path.is_file()} == before


def test_all_that_a_reader_sees_is_compared_and_nothing_else_whoever_runs_it(executed, mine):
    """The cells that nobody has changed pass beside somebody's settings too."""
    path = executed / "notebooks" / "small.ipynb"
    notebook = json.loads(path.read_text())
    for cell, (_, change) in zip(notebook["cells"], CELLS.values(), strict=True):
        if change:
            change(cell, executed / "figures")
    path.write_text(json.dumps(notebook))
    failed, shown = failures(executed)
    assert failed == [name for name, (_, change) in CELLS.items() if change], shown
    assert "figures/small_svg_file.svg is not what this cell draws" in shown


class DescribesTitlesOnly:
    """Stands for `plots`, with a description that no number changes."""

    QUANTUM = figures.QUANTUM

    @staticmethod
    def describe(fig):
        return str([ax.get_title() for ax in fig.axes])


@pytest.mark.parametrize(
    "draw",
    [
        lambda ax: ax.plot([1, 2, 3]),
        lambda ax: ax.fill_between([1, 2], [1, 2]),
        lambda ax: ax.bar([1, 2], [3, 4]),
        lambda ax: ax.scatter([1, 2], [3, 4]),
        lambda ax: ax.imshow([[1, 2], [3, 4]]),
    ],
    ids=["line", "area", "bars", "points", "image"],
)
def test_a_drawing_that_the_description_leaves_out_is_seen(draw):
    fig, ax = plots.panels([["a"]])
    draw(ax["a"])
    every_change_is_described(fig, figures)
    with pytest.raises(AssertionError, match="1 % more is not described"):
        every_change_is_described(fig, DescribesTitlesOnly)


@pytest.mark.parametrize("left", [3e-11, -5e-11])
def test_the_mean_of_values_that_cancel_is_the_same_on_every_processor(left):
    """Of errors about their mean, what their nine digits leave over is another number on another processor."""
    fig, ax = plots.panels([["a"]])
    ax["a"].plot([1, 2, 3, 4], [-5.0, 4.7, -4.0, 4.3 + 4 * left])
    assert "y -5..4.7 mean 0, checksum" in figures.describe(fig)
    ax["a"].lines[0].set_ydata([-5.0, 4.7, -4.0, 4.3 + 4e-6])
    assert "mean 1e-06, checksum" in figures.describe(fig)


def test_an_inset_is_refused_since_it_is_not_described():
    fig, ax = plots.panels([["a"]])
    ax["a"].inset_axes([0.5, 0.5, 0.4, 0.4]).plot([1, 2, 3])
    with pytest.raises(AssertionError, match="1 % more is not described"):
        every_change_is_described(fig, figures)
