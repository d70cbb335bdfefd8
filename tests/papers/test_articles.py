"""The form of notebooks: that of a paper is its reproduction, found from the contents at its front; lessons tell."""

import importlib.util
import re

import pytest
from conftest import GIVES_A_VERDICT, LESSONS, ROOT, cells_of, prose, source

from reproduction.ledger import keys, published, stored_verdicts
from reproduction.ledger.contents import BETWEEN, contents
from reproduction.ledger.verdicts import DIFFERS, ERRATUM, MIME

DRAWS = re.compile(r"\b(plt|ax|axes|panel)\s*[.\[]|\bplots\.(panels|finish|legend_below)\b|\bmatplotlib\b")
LINK = re.compile(r"\]\(#([^)]*)\)")
FOUR = ["2007_mms_kalman", "2014_gsm_2d", "2015_mpt_3d", "2016_prediction"]
FOLDED = {"jupyter": {"source_hidden": True}, "tags": ["hide-input"]}


def code(cells):
    return [source(cell) for cell in cells if cell["cell_type"] == "code"]


def headings(cells):
    """The headings of a notebook, without their signs, in order."""
    return re.findall(r"(?m)^#+ (.*)$", prose(cells))


def anchor(heading):
    """The target of a link to a heading, as JupyterLab and nbviewer make it."""
    return heading.replace(" ", "-")


def under(cells, heading):
    """The cells under a heading, up to the next one."""
    found, here = [], False
    for cell in cells:
        for each in headings([cell]):
            here = each == heading
        if here:
            found.append(cell)
    return found


def text_of(cells):
    """What cells of code show as text: for a table, its plain form."""
    data = [out.get("data", {}) for cell in cells for out in cell.get("outputs", [])]
    return "\n".join("".join(each.get("text/plain", "")) for each in data)


@pytest.fixture(params=[key for key in keys() if published(key).rows])
def paper(request):
    """A paper, and the cells of its notebook."""
    return published(request.param), cells_of(ROOT / "notebooks" / f"{request.param}.ipynb")


def test_the_title_is_the_name_that_the_paper_has_everywhere(paper):
    paper, cells = paper
    assert source(cells[0]).splitlines()[0] == f"# {paper.about.name} ({paper.about.year}), reproduced"


def test_the_front_cites_the_paper(paper):
    paper, cells = paper
    front = re.sub(r"[*\s]+", " ", source(cells[0]))
    for each in (paper.about.authors, paper.about.title, paper.about.doi or "no DOI"):
        assert each in front


def test_the_contents_are_those_of_the_verdicts(paper):
    paper, cells = paper
    verdicts = stored_verdicts(ROOT / "notebooks" / f"{paper.key}.ipynb")
    (found,) = BETWEEN.finditer(source(cells[0]))
    assert contents(paper.rows, verdicts) in found[0]


@pytest.mark.parametrize("key", FOUR)
def test_each_reason_for_what_is_wrong_has_a_short_form(key):
    paper = published(key)
    verdicts = stored_verdicts(ROOT / "notebooks" / f"{key}.ipynb")
    wrong = {each.cause for each in verdicts if each.verdict in (DIFFERS, ERRATUM)}
    assert [id for id in wrong if not paper.causes[id].short] == []


@pytest.mark.parametrize("key", FOUR)
def test_the_first_cell_says_what_to_install_where_the_project_is_missing(key, monkeypatch):
    cells = cells_of(ROOT / "notebooks" / f"{key}.ipynb")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(SystemExit, match=r"needs the project around it: .* pip install -r environment\.txt -e \.$"):
        exec(code(cells)[0], {})


def test_the_contents_have_each_item_once(paper):
    """And each line that names items has some."""
    paper, _ = paper
    times = {id: sum(row.has(id) for row in paper.rows) for id in paper.items}
    assert {id: count for id, count in times.items() if count != 1} == {}
    assert [row.heading for row in paper.rows if row.ids and not any(map(row.has, paper.items))] == []


def test_the_contents_have_each_table_and_figure_in_the_order_of_the_notebook(paper):
    paper, cells = paper
    assert sorted({row.name for row in paper.rows} & set(paper.about.numbered)) == sorted(paper.about.numbered)
    listed = [row.heading for row in paper.rows]
    assert [each for each in headings(cells) if each in listed] == listed


def test_each_link_lands(paper):
    _, cells = paper
    targets = [anchor(each) for each in headings(cells)]
    assert len(targets) == len(set(targets)), "two headings of one name"
    links = LINK.findall(prose(cells))
    assert links
    assert [link for link in links if link not in targets] == []


def test_each_figure_stands_under_its_number_and_is_a_file(paper):
    paper, cells = paper
    for row in paper.rows:
        if row.name.startswith("Figure "):
            name = f"{paper.key}_fig{row.name.split()[1]}"
            assert f'save_figure(fig, "{name}")' in "\n".join(code(under(cells, row.heading)))
            for kind in ("png", "svg"):
                assert (ROOT / "figures" / f"{name}.{kind}").is_file()


def test_each_table_is_shown_with_all_that_is_printed(paper):
    paper, cells = paper
    for row in paper.rows:
        if row.name.startswith("Table "):
            layout = paper.layouts[row.name.replace("Table ", "table")]
            shown = [line.strip() for line in text_of(under(cells, row.heading)).splitlines()]
            assert set(layout.ids) >= {id for id in paper.items if id.startswith(f"{layout.id}.")}, row.name
            assert any(line.startswith(layout.title) for line in shown), row.name
            for line in layout.rows:
                printed = [paper.items[cell[1:-1]].printed if cell[1:-1] in layout.ids else cell for cell in line]
                assert any(have_in_order(each, printed) for each in shown), (row.name, printed)


def have_in_order(line, words):
    """Whether a line has all words, each after those before it."""
    place = 0
    for word in words:
        place = line.find(word, place)
        if place < 0:
            return False
        place += len(word)
    return True


def test_words_are_found_in_their_order():
    assert have_in_order("1  A  17 | 17", ["1", "A", "17"])
    assert not have_in_order("1  A  17 | 17", ["17", "A"])


def test_what_gives_verdicts_shows_and_stores_them(paper):
    """As the last thing that its cell does; a cell that is folded says so for every reader."""
    _, cells = paper
    for cell in cells:
        if cell["cell_type"] == "code" and GIVES_A_VERDICT.search(source(cell)):
            assert [MIME in out.get("data", {}) for out in cell["outputs"]][-1:] == [True], cell["id"]
        assert cell["metadata"] in ({}, FOLDED), cell["id"]


def test_a_notebook_has_no_drawing_code(notebook):
    """What draws stands in reproduction/, so that a figure is two lines wherever the notebook is shown."""
    _, cells = notebook
    for text in code(cells):
        assert not DRAWS.search(text), text


@pytest.mark.parametrize("path", LESSONS, ids=lambda path: path.stem)
def test_a_lesson_opens_with_its_title_has_a_picture_and_calls_no_ledger(path):
    cells = cells_of(path)
    assert source(cells[0]).startswith("# ")
    assert any("image/png" in out.get("data", {}) for cell in cells for out in cell.get("outputs", []))
    assert not [text for text in code(cells) if GIVES_A_VERDICT.search(text) or "published(" in text]


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
