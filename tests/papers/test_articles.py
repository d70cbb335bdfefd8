"""The form of a notebook: Part I, an article; Part II, its evidence, which stands alone."""

import builtins
import dis
import re

import pytest
from conftest import GIVES_A_VERDICT, parts, source

DRAWS = re.compile(r"\b(plt|ax|axes|panel)\s*[.\[]|\bplots\.(panels|finish|legend_below)\b|\bmatplotlib\b")
COUNTS = re.compile(r"\b\d+ (slip|wording|finding|cell)s?\b|\b\d+ of \d+ claims\b")


@pytest.fixture
def article(notebook):
    """The key of a notebook in two parts, and both."""
    key, cells = notebook
    return key, *parts(cells)


def code(cells):
    return [source(cell) for cell in cells if cell["cell_type"] == "code"]


def has_picture(cell):
    return any("image/png" in out.get("data", {}) for out in cell.get("outputs", []))


def names_from_elsewhere(texts):
    """Names that code cells, run alone and in their order, would look up in vain."""
    bound, missing = set(dir(builtins)), []
    functions = []

    def look_up(code):
        for step in dis.get_instructions(code):
            if step.opname in ("LOAD_NAME", "LOAD_GLOBAL") and step.argval not in bound:
                missing.append(step.argval)
            elif step.opname in ("STORE_NAME", "STORE_GLOBAL"):
                bound.add(step.argval)

    for text in texts:
        top = compile(text, "cell", "exec")
        look_up(top)
        functions += [each for each in top.co_consts if hasattr(each, "co_code")]
    while functions:  # they look up what is bound when they are called
        each = functions.pop()
        look_up(each)
        functions += [inner for inner in each.co_consts if hasattr(inner, "co_code")]
    return sorted(set(missing))


def test_a_notebook_has_both_parts(article):
    _, article, evidence = article
    assert article
    assert evidence


def test_an_article_opens_with_a_title_and_prose(article):
    """And counts no slips: that is the evidence's business."""
    _, article, _ = article
    assert article[0]["cell_type"] == "markdown"
    assert source(article[0]).startswith("# ")
    assert not COUNTS.search(source(article[0]))


def test_the_counts_open_the_evidence(article):
    _, _, evidence = article
    assert COUNTS.search(source(evidence[0]))


def test_an_article_has_a_picture(article):
    _, article, _ = article
    assert any(map(has_picture, article))


def test_verdicts_stand_in_the_evidence(article):
    _, article, evidence = article
    assert not [text for text in code(article) if GIVES_A_VERDICT.search(text)]
    assert [text for text in code(evidence) if GIVES_A_VERDICT.search(text)]


def test_no_part_uses_a_name_of_the_other(article):
    _, *both = article
    for part in both:
        assert names_from_elsewhere(code(part)) == []


def test_a_notebook_has_no_drawing_code(article):
    """What draws stands in reproduction/, so that a figure is two lines wherever the notebook is shown."""
    _, *both = article
    for text in code([*both[0], *both[1]]):
        assert not DRAWS.search(text), text


@pytest.mark.parametrize(
    ("cells", "missing"),
    [
        (["x = 1", "print(x)"], []),
        (["print(x)", "x = 1"], ["x"]),
        (["def f():\n    return x", "x = 1\nf()"], []),
        (["import numpy as np\ny = [np.sqrt(each * k) for each in range(3)]"], ["k"]),
        (["def f(a):\n    return lambda b: a + b + c"], ["c"]),
        (["x += 1"], ["x"]),
    ],
)
def test_a_name_of_the_other_part_is_seen(cells, missing):
    assert names_from_elsewhere(cells) == missing


def test_the_second_part_begins_at_its_heading():
    texts = ["# Title", "See Part II.", "## Part II: the evidence", "# Part II again"]
    cells = [{"cell_type": "markdown", "source": [text]} for text in texts]
    assert parts(cells) == (cells[:2], cells[2:])
    assert parts(cells[:2]) == (cells[:2], [])


@pytest.mark.parametrize(
    ("text", "draws"),
    [
        ("ax.plot(x)", True),
        ("ax['a'].plot(x)", True),
        ("plt.show()", True),
        ("fig, ax = plots.panels([['a']])", True),
        ("fig = article.draw_start()\nsave_figure(fig, 'x')", False),
        ("relax.go()", False),
    ],
)
def test_drawing_code_is_seen(text, draws):
    assert bool(DRAWS.search(text)) == draws
