"""What the tests share: where files are, models, and the cells of notebooks."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from _pytest.doctest import DoctestModule
from hypothesis import settings
from sockets import talk_through_files

import mpt_helpers as mpt

COMMON = {"derandomize": True, "deadline": None, "database": None, "max_examples": 12}
settings.register_profile("properties", **COMMON)
settings.load_profile("properties")
talk_through_files()


def pytest_configure(config):
    """Name the mark of tests that `make test` leaves out and `make test-all` runs."""
    config.addinivalue_line("markers", "slow: sees one more case of many, or what only a maintainer meets")


@pytest.hookimpl(wrapper=True)
def pytest_collect_file():
    """Look for no examples in the tests: only the package and the reproduction have some."""
    return [each for each in (yield) if not isinstance(each, DoctestModule)]


ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted(ROOT.glob("notebooks/*.ipynb"))  # one for each paper
LESSONS = sorted(ROOT.glob("notebooks/lessons/*.ipynb"))
GIVES_A_VERDICT = re.compile(r"\bpaper\.(check|claims?|cannot_check|report|table|equal|lacking)\(")
AXIS = mpt.gsm_axis(dt=1.0, q=0.01, r=0.1)
MODELS_2016 = {"cv": mpt.constant_velocity(1.0, 0.01, 0.1), "ca": mpt.constant_acceleration(1.0, 0.01, 0.1)}


def dense_model(seed, n=3, m=2):
    """A model whose matrices have no zeros: correlated noises, a start that is uncertain, stable or not."""
    rng = np.random.default_rng(seed)
    roots = [rng.standard_normal((size, size)) for size in (n, m, n)]
    Q, R, P0 = (root @ root.T + 0.1 * np.eye(len(root)) for root in roots)
    x0 = rng.standard_normal(n)
    return mpt.LinearModel(F=rng.standard_normal((n, n)), H=rng.standard_normal((m, n)), Q=Q, R=R, x0=x0, P0=P0)


@pytest.fixture(params=[(1, 100.0), (2, 0.0), (3, 100.0)], ids=lambda p: f"{p[0]}axes-P0={p[1]:g}")
def axis_and_count(request):
    """One axis of the papers' models with a start that is not zero, and how many axes there are."""
    axes, p0 = request.param
    return replace(AXIS, x0=[3.0, -1.0], P0=p0 * np.eye(2)), axes


@pytest.fixture
def model(axis_and_count):
    """Model A over one to three axes."""
    axis, axes = axis_and_count
    return mpt.stack(*[axis] * axes)


@pytest.fixture
def z(model):
    """Measurements of one track of 60 steps."""
    return mpt.simulate(model, 60, np.random.default_rng(7))[1]


def cells_of(path):
    """The cells of a notebook in a file."""
    return json.loads(path.read_text(encoding="utf-8"))["cells"]


def source(cell):
    """The text of a notebook's cell."""
    return "".join(cell["source"])


def prose(cells):
    """The text of the cells of Markdown."""
    return "\n\n".join(source(cell) for cell in cells if cell["cell_type"] == "markdown")


def shown(cell):
    """What a cell of code prints or shows, as text."""
    return "\n".join("".join(out.get("text", out.get("data", {}).get("text/plain", ""))) for out in cell["outputs"])


def parts(cells):
    """The cells of Part I, the article, and of Part II, its evidence: none if the notebook has one part."""
    for i, cell in enumerate(cells):
        if cell["cell_type"] == "markdown" and re.match(r"##? Part II\b", source(cell)):
            return cells[:i], cells[i:]
    return cells, []


@pytest.fixture(params=[*NOTEBOOKS, *LESSONS], ids=lambda path: path.stem)
def notebook(request):
    """A committed notebook, of a paper or a lesson: its path and its cells."""
    return request.param, cells_of(request.param)


# A made-up paper: what the tests of the ledger, the command line and the seeds work on.
PAPER = """
items = [
  { id = "count", where = "Table 1", kind = "number", printed = "17" },
  { id = "ratio", where = "Table 2", kind = "number", printed = "1.290" },
  { id = "wrong", where = "Table 3", kind = "number", printed = "326", cause = "one-missing", against = ["count"] },
  { id = "equal", where = "Section 1", kind = "claim", printed = "A equals B" },
  { id = "lost", where = "Table 4", kind = "number", printed = "?", cause = "our-copy" },
]
[[causes]]
id = "one-missing"
kind = "slip"
sentence = "One is missing: 326 for 336."
meaning = "Count ten more."
[[causes]]
id = "our-copy"
kind = "copy"
sentence = "Our copy has lost the cell."
meaning = "Nothing."
"""
# What a notebook on it computes: a seed, and a verdict on each item.
VERDICTS = """\
import random
from pathlib import Path
SEED = 1
random.seed(SEED)
from reproduction.ledger import read_paper
paper = read_paper("small", Path("small.toml").read_text())
paper.check("count", 17)
paper.check("ratio", 1.3, basis="simulation", band=(1.28, 1.31))
paper.check("wrong", 336)
paper.claim("equal", random.random() < 2, "always", basis="simulation")
paper.cannot_check("lost", "a cell")
paper.report()"""


KERNEL = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}


def write_notebook(path, *sources):
    """Write a notebook that was never executed."""
    cells = [
        {"cell_type": "code", "id": f"cell-{i}", "metadata": {}, "execution_count": None, "outputs": [], "source": text}
        for i, text in enumerate(sources)
    ]
    path.write_text(json.dumps({"cells": cells, "metadata": KERNEL, "nbformat": 4, "nbformat_minor": 5}))


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A project with one notebook on the made-up paper, which is the only one that the package has, to work in."""
    for folder in ("notebooks", "figures", "reproduction/ledger"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "reproduction/ledger/small.toml").write_text(PAPER)
    (tmp_path / "notebooks/small.toml").write_text(PAPER)
    write_notebook(tmp_path / "notebooks/small.ipynb", VERDICTS, "1 + 1")
    monkeypatch.setattr("reproduction.ledger.files.FOLDER", tmp_path / "reproduction/ledger")
    monkeypatch.chdir(tmp_path)
    return tmp_path
