"""What a reader sees in the committed notebooks, read from them: `make test` executes them under nbval with `exact`."""

import json
import re
import subprocess
from base64 import b64decode

import numpy as np
import pytest
from conftest import LESSONS, NOTEBOOKS, ROOT, cells_of, source
from matplotlib.image import imread

from reproduction.execute import tidied
from reproduction.figures import SavedFigure

FIGURES = ROOT / "figures"
WIDTH = 110  # characters of a line that a reader must read


def code(cells):
    return [cell for cell in cells if cell["cell_type"] == "code"]


def outputs(cells):
    return [out for cell in code(cells) for out in cell["outputs"]]


def figure_names(cells):
    return re.findall(r'save_figure\([^"]+, "(\w+)"\)', "\n".join(map(source, code(cells))))


def test_there_are_notebooks():
    assert NOTEBOOKS


def test_a_notebook_is_executed_from_top_to_bottom(notebook):
    _, cells = notebook
    assert [cell["execution_count"] for cell in code(cells)] == list(range(1, len(code(cells)) + 1))
    assert not [out for out in outputs(cells) if out["output_type"] == "error" or out.get("name") == "stderr"]


def test_a_notebook_is_stored_as_reproduce_and_tidy_store_it(notebook):
    """With the outputs, which `exact` compares, this makes the whole file: executing it again changes no byte."""
    path, cells = notebook
    text = path.read_text(encoding="utf-8")
    kept = tidied(json.loads(text))
    assert text == json.dumps(kept, indent=1, ensure_ascii=False, sort_keys=True) + "\n"
    assert kept["metadata"]["kernelspec"]["name"] == "python3"
    for cell in code(cells):
        streams = [out["output_type"] == "stream" for out in cell["outputs"]]
        assert [True, True] not in [streams[i : i + 2] for i in range(len(streams))], "streams in pieces"


def test_no_line_of_an_output_is_wider_than_a_page(notebook):
    _, cells = notebook
    for cell in code(cells):
        for out in cell["outputs"]:
            data = out.get("data", {})
            text = "".join(out.get("text", data.get("text/plain", "")))
            if "text/html" not in data and "image/png" not in data:  # there a reader sees another form
                wide = [line for line in text.splitlines() if len(line) > WIDTH]
                assert not wide, f"{cell['id']}: {wide[0]}"


def test_every_figure_in_a_notebook_is_saved_and_committed(notebook):
    path, cells = notebook
    pictures = [out["data"]["image/png"] for out in outputs(cells) if "image/png" in out.get("data", {})]
    names = figure_names(cells)
    assert len(names) == len(pictures) == len(set(names))
    for name, picture in zip(names, pictures, strict=True):
        assert path in LESSONS or name.startswith(f"{path.stem}_")
        assert (FIGURES / f"{name}.png").read_bytes() == b64decode(picture)


def test_every_committed_figure_is_made_by_a_notebook():
    made = {name for path in [*NOTEBOOKS, *LESSONS] for name in figure_names(cells_of(path))}
    files = {f"{name}.{kind}" for name in made for kind in ("png", "svg")}
    assert files == {path.name for path in FIGURES.iterdir()}
    if not (ROOT / ".git").exists():
        pytest.skip("not a git checkout: what is committed is not known")
    tracked = subprocess.run(["git", "ls-files", "figures"], cwd=ROOT, capture_output=True, text=True, check=True)
    assert {f"figures/{name}" for name in files} == set(tracked.stdout.split())


def test_no_text_of_a_figure_is_cut_off():
    """Text that is wider than its figure would leave ink in the two pixels at the edge, which are empty."""
    for path in sorted(FIGURES.glob("*.png")):
        ink = imread(path)[..., :3].min(axis=2) < 1
        ink[2:-2, 2:-2] = False
        assert not np.any(ink), path


def test_a_saved_figure_shows_its_description_to_nbval():
    assert SavedFigure(b"", "words")._repr_mimebundle_()[0]["text/plain"] == "words"
