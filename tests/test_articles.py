"""The form of a notebook: Part I, an article with limits to its length; Part II, its evidence, which stands alone."""

import builtins
import dis
import re
from typing import NamedTuple

import pytest
from conftest import parts, source


class Limits(NamedTuple):
    """What Part I and Part II may have at most. Without cells for Part II, the notebook has one part."""

    cells: int
    words: int
    evidence_cells: int


LIMITS = {
    "2007_mms_kalman": Limits(16, 1100, 70),
    "2014_gsm_2d": Limits(14, 1120, 60),
    "2015_mpt_3d": Limits(20, 700, 0),  # the whole notebook has the length of one article
    "2016_prediction": Limits(14, 1010, 60),
}
USUAL = Limits(14, 1000, 60)
FIRST_CELL = 120  # words
FIRST_PICTURE = 5  # lines of code, up to the first picture and with it
PICTURES = 4
LINES = 12  # of a code cell that teaches

DRAWS = re.compile(r"\b(plt|ax|axes|panel)\s*[.\[]|\bplots\.(panels|finish|legend_below)\b|\bmatplotlib\b")
COUNTS = re.compile(r"\b\d+ (slip|wording|finding|cell)s?\b|\b\d+ of \d+ claims\b")
GIVES_A_VERDICT = re.compile(r"\bpaper\.(check|claim|cannot_check|report)\(")


@pytest.fixture
def article(notebook):
    """The key of a notebook in two parts, and both."""
    key, cells = notebook
    return key, *parts(cells)


def words(text):
    """How many words a text has, formulas not counted."""
    return len(re.sub(r"(?s)\$\$.*?\$\$|\$.*?\$", " ", text).split())


def prose(cells):
    return [source(cell) for cell in cells if cell["cell_type"] == "markdown"]


def code(cells):
    return [source(cell) for cell in cells if cell["cell_type"] == "code"]


def lines(text):
    return [line for line in text.splitlines() if line.strip()]


def has_picture(cell):
    return any("image/png" in out.get("data", {}) for out in cell.get("outputs", []))


def lines_to_the_first_picture(cells):
    """Lines of code up to the first cell that shows a picture, and with it; None without a picture."""
    count = 0
    for cell in cells:
        if cell["cell_type"] == "code":
            count += len(lines(source(cell)))
            if has_picture(cell):
                return count
    return None


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


def test_part_one_keeps_to_its_limits(article):
    key, article, evidence = article
    most = LIMITS.get(key, USUAL)
    assert len(article) <= most.cells
    assert sum(map(words, prose(article))) <= most.words
    assert len(evidence) <= most.evidence_cells
    assert bool(evidence) == bool(most.evidence_cells)


def test_the_first_cell_is_an_answer(article):
    """A title, a few lines, two or three findings that each open with something in bold to do; nothing is counted."""
    _, article, _ = article
    first = source(article[0])
    assert article[0]["cell_type"] == "markdown"
    assert first.startswith("# ")
    assert words(first) <= FIRST_CELL
    findings = re.findall(r"(?m)^(?:\d\.|-) (.*)", first)
    assert 2 <= len(findings) <= 3
    assert all(re.match(r"\*\*[^*]+\.\*\* ", each) for each in findings)
    assert not COUNTS.search(first)


def test_the_counts_open_the_evidence(article):
    """In the first cell of Part II, or in the text of the only part."""
    _, article, evidence = article
    assert COUNTS.search(source(evidence[0]) if evidence else "\n".join(prose(article)))


def test_the_picture_comes_first(article):
    _, article, _ = article
    count = lines_to_the_first_picture(article)
    assert count is not None
    assert count <= FIRST_PICTURE
    assert sum(map(has_picture, article)) <= PICTURES


def test_code_that_teaches_is_short(article):
    _, article, _ = article
    for text in code(article):
        if not GIVES_A_VERDICT.search(text):
            assert len(text.splitlines()) <= LINES, text


def test_verdicts_stand_in_the_evidence(article):
    _, article, evidence = article
    if evidence:
        assert not [text for text in code(article) if GIVES_A_VERDICT.search(text)]
        assert [text for text in code(evidence) if GIVES_A_VERDICT.search(text)]


def test_no_part_uses_a_name_of_the_other(article):
    _, *both = article
    for part in both:
        assert names_from_elsewhere(code(part)) == []


def test_a_notebook_has_no_drawing_code(article):
    """What draws stands in papers/, so that a figure is two lines wherever the notebook is shown."""
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
        ("fig = article.draw_start()\nfigures.save_figure(fig, 'x')", False),
        ("relax.go()", False),
    ],
)
def test_drawing_code_is_seen(text, draws):
    assert bool(DRAWS.search(text)) == draws
