"""What a reader sees in the committed notebooks: executed, complete, and every plotted number covered by a test."""

import json
import os
import re
import subprocess
from base64 import b64decode

import pytest
from conftest import NOTEBOOKS, ROOT

import mpt_helpers as mpt
from mpt_helpers.figures import QUANTUM, SavedFigure, alt_text, describe

FIGURES = ROOT / "figures"


def code(cells):
    return [cell for cell in cells if cell["cell_type"] == "code"]


def source(cell):
    return "".join(cell["source"])


def outputs(cells):
    return [out for cell in code(cells) for out in cell["outputs"]]


def figure_names(cells):
    return re.findall(r'save_figure\(fig, "(\w+)"\)', "\n".join(map(source, code(cells))))


def test_there_are_notebooks():
    assert NOTEBOOKS


def test_a_notebook_is_executed_from_top_to_bottom(notebook):
    _, cells = notebook
    assert [cell["execution_count"] for cell in code(cells)] == list(range(1, len(code(cells)) + 1))
    assert not [out for out in outputs(cells) if out["output_type"] == "error" or out.get("name") == "stderr"]


def test_a_notebook_is_prose_and_short_cells(notebook):
    _, cells = notebook
    for before, cell in zip([None, *cells], cells, strict=False):
        if cell["cell_type"] == "code":
            assert before["cell_type"] == "markdown", f"no prose before {cell['id']}"
            assert len(source(cell).splitlines()) <= 10, f"{cell['id']} is long"
            assert "def " not in source(cell), f"{cell['id']} defines a function"


def test_no_output_is_longer_than_a_reader_can_scroll(notebook):
    key, cells = notebook
    for cell in code(cells)[:-1]:  # the last one is the table of all verdicts
        for out in cell["outputs"]:
            text = "".join(out.get("text", "")) + "".join(out.get("data", {}).get("text/html", ""))
            assert len(text) < 50_000, f"{key}: {cell['id']} prints {len(text)} characters"


def test_every_figure_in_a_notebook_is_saved_and_committed(notebook):
    key, cells = notebook
    pictures = [out["data"]["image/png"] for out in outputs(cells) if "image/png" in out.get("data", {})]
    names = figure_names(cells)
    assert len(names) == len(pictures) == len(set(names))
    for name, picture in zip(names, pictures, strict=True):
        assert name.startswith(f"{key}_")
        assert (FIGURES / f"{name}.png").read_bytes() == b64decode(picture)
    prose = "\n".join(source(cell) for cell in cells if cell["cell_type"] == "markdown")
    for name in names:
        own = name.removeprefix(f"{key}_")
        assert (f"Figure `{own}`" if not own.startswith("fig") else f"Figure {own[3:]}") in prose


def test_every_committed_figure_is_made_by_a_notebook():
    made = {name for path in NOTEBOOKS for name in figure_names(json.loads(path.read_text(encoding="utf-8"))["cells"])}
    files = {f"{name}.{kind}" for name in made for kind in ("png", "svg")}
    assert files == {path.name for path in FIGURES.iterdir()}
    if not (ROOT / ".git").exists():
        pytest.skip("not a git checkout: what is committed is not known")
    tracked = subprocess.run(["git", "ls-files", "figures"], cwd=ROOT, capture_output=True, text=True, check=True)
    assert {f"figures/{name}" for name in files} == set(tracked.stdout.split())


def test_the_numbers_of_the_first_screen_are_computed_below(notebook):
    """The numbers of "What we found" are those that the cell `first-screen` prints, in the same order."""
    _, cells = notebook
    found = source(cells[0]).partition("**What we found**")[2].partition("**What this notebook makes**")[0]
    assert len(re.findall(r"(?m)^- ", found)) == 5
    stated = re.findall(r"(?<![\w.])\d+(?:\.\d+)?", re.sub(r"(Table|Figure) \d+", "", found))
    (cell,) = [cell for cell in cells if cell["id"] == "first-screen"]
    assert stated == "".join(cell["outputs"][0]["text"]).split()


@pytest.fixture(scope="module")
def figures(tmp_path_factory):
    """Every figure of every notebook, drawn in this process."""
    drawn, folder, here = {}, tmp_path_factory.mktemp("figures"), os.getcwd()
    original = mpt.save_figure

    def keep(fig, name):
        drawn[name] = fig
        return original(fig, name, folder)

    mpt.save_figure = keep
    try:
        for path in NOTEBOOKS:
            os.chdir(path.parent)
            cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
            exec("\n".join(map(source, code(cells))), {})
    finally:
        mpt.save_figure = original
        os.chdir(here)
    return drawn


def test_the_committed_descriptions_are_those_of_the_figures(figures):
    stored = {}
    for path in NOTEBOOKS:
        for out in outputs(json.loads(path.read_text(encoding="utf-8"))["cells"]):
            if "image/png" in out.get("data", {}):
                name, _, words = "".join(out["data"]["text/plain"]).partition(".png\n")
                stored[name] = words
    assert stored == {name: describe(fig) for name, fig in figures.items()}


def test_a_change_of_one_percent_in_anything_plotted_is_seen(figures):
    """Scale each line and each area by 1.01, one at a time: the description, which nbval compares, must change."""
    changed = 0
    for name, fig in figures.items():
        before = describe(fig)
        for ax in fig.axes:
            for line in ax.lines:
                for get, put in ((line.get_xdata, line.set_xdata), (line.get_ydata, line.set_ydata)):
                    data = get()
                    if abs(max(data, key=abs)) > QUANTUM:  # what is smaller is drawn with one digit
                        put([1.01 * value for value in data])
                        assert describe(fig) != before, f"{name}: {line.get_label()}"
                        put(data)
                        changed += 1
            for area in ax.collections:
                for path in area.get_paths():
                    path.vertices *= 1.01
                    assert describe(fig) != before, f"{name}: {area.get_label()}"
                    path.vertices /= 1.01
                    changed += 1
        assert describe(fig) == before
    assert changed > 50


def test_a_saved_figure_shows_its_description_to_nbval():
    assert SavedFigure(b"", "words")._repr_mimebundle_()[0]["text/plain"] == "words"


def test_the_committed_alt_texts_are_those_of_the_figures(figures):
    pictures = [out for path in NOTEBOOKS for out in outputs(json.loads(path.read_text(encoding="utf-8"))["cells"])]
    stored = {
        "".join(out["data"]["text/plain"]).partition(".png\n")[0]: out["metadata"]["image/png"]["alt"]
        for out in pictures
        if "image/png" in out.get("data", {})
    }
    assert stored == {name: alt_text(fig) for name, fig in figures.items()}
