"""What a notebook shows of its paper, on a made-up one: tables beside computed values, claims, and the contents."""

import json
from dataclasses import replace

import pytest
from conftest import PAPER

from reproduction.ledger import Item, Verdicts, read_paper
from reproduction.ledger.contents import Row, contents, in_words, write_contents
from reproduction.ledger.shown import Cell, Grid
from reproduction.ledger.verdicts import MIME

TABLES = """
[[tables]]
id = "both"
title = "Table 9: all of them"
head = ["what", "printed | computed"]
rows = [["a count", "{count}"], ["a total", "{wrong}"], ["a ratio", "{ratio}"], ["no longer there", "{lost}"]]
[[tables]]
id = "names"
title = "Table 8: names"
head = ["number", "name"]
rows = [["1", "KF"]]
[[contents]]
heading = "Table 9: all of them"
ids = ["count", "wrong", "ratio", "lost"]
shows = "numbers"
why = "a total"
[[contents]]
heading = "Section 1"
ids = ["equal"]
shows = "what is equal"
[[contents]]
heading = "Table 8"
ids = []
shows = "names"
holds = "names only"
[[grids]]
id = "t"
title = "Table 5: ratios"
names = ["KF A", "LF B"]
where = "Table 5, row {row}, column {column}"
columns = ["1", "2"]
cause_of = { 2 = "one-missing" }
lost = "our-copy"
[grids.rows]
1 = ["", "0.50"]
2 = ["2.00", ""]
"""
WITH_TABLES = PAPER.replace('sentence = "One is', 'short = "a sum"\nsentence = "One is')
VALUES = {"count": 17, "wrong": 336, "ratio": (1.3, (1.28, 1.31)), "lost": 2.50004}


@pytest.fixture
def paper():
    return read_paper("test", WITH_TABLES + TABLES)


def test_a_table_shows_printed_beside_computed_and_says_what_is_wrong(paper):
    shown = paper.table("both", VALUES, basis="simulation")
    assert repr(shown).splitlines() == [
        "Table 9: all of them. 2 of 3 agree; our copy has lost 1.",
        "what             printed | computed",
        "a count          17",
        "a total          326 | 336 ✗",
        "a ratio          1.290 | 1.300 (1.280 to 1.310)",
        "no longer there  ? | 2.500",
        "✗ 1 cell: One is missing: 326 for 336.",
    ]
    given = {each.id: each.verdict for each in shown}
    assert given == {
        "count": "reproduced",
        "wrong": "erratum",
        "ratio": "within band",
        "lost": "cannot be checked",
    }
    assert {each.id: each.computed for each in shown}["lost"] == "2.5"  # with as many decimals as the rest prints
    assert "<s>326</s> | <b>336</b>&nbsp;✗" in shown.html()
    assert [each["id"] for each in shown._repr_mimebundle_()[MIME]] == list(given)


def test_values_of_a_table_come_by_id_or_in_reading_order(paper):
    by_id = paper.table("both", VALUES, basis="simulation")
    in_order = [VALUES[id] for id in ("count", "wrong", "ratio", "lost")]
    assert list(paper.table("both", in_order, basis="simulation")) == list(by_id)
    with pytest.raises(ValueError, match="zip"):
        paper.table("both", in_order[:3], basis="simulation")


def test_a_cell_that_cannot_be_checked_says_why(paper):
    shown = paper.table("both", VALUES | {"ratio": "the paper names no unit"}, basis="simulation")
    (given,) = (each for each in shown if each.id == "ratio")
    assert (given.verdict, given.reason) == ("cannot be checked", "the paper names no unit")
    assert "a ratio          1.290 ?\n" in repr(shown)
    assert shown.told[-1] == "? 1 cell: the paper names no unit."


def test_a_sentence_is_said_once_and_then_where_it_was_said(paper):
    paper.table("both", VALUES, basis="simulation")
    assert paper.table("t", [[1, 3], [2, 1]]).told == ["✗ 1 cell: As in Table 9."]


def test_the_reason_of_claims_is_said_once_too():
    text = WITH_TABLES.replace('"A equals B"', '"A equals B", cause = "one-missing"')
    paper = read_paper("test", text + TABLES)
    paper.table("both", VALUES, basis="simulation")
    shown = paper.claims({"equal": ({"in x": True, "in y": False}, "seen in x")}, basis="exact")
    assert shown.told == ["(✓) Holds: in x. Does not hold: in y. As in Table 9."]
    assert shown[0].reason.endswith("One is missing: 326 for 336.")


def test_a_table_of_bands_says_so(paper):
    text = TABLES.replace('["a count", "{count}"], ["a total", "{wrong}"], ', "")
    text = text.replace(', ["no longer there", "{lost}"]', "")
    shown = read_paper("test", WITH_TABLES + text).table("both", {"ratio": (1.3, (1.28, 1.31))}, basis="simulation")
    assert repr(shown).splitlines()[0] == "Table 9: all of them. 1 of 1 within the band."


def test_a_table_may_say_in_one_sentence_what_is_wrong():
    text = TABLES.replace('title = "Table 5: ratios"', 'title = "Table 5: ratios"\nwrong = "All of them."')
    assert read_paper("test", WITH_TABLES + text).table("t", [[1, 3], [4, 1]]).told == ["✗ 2 cells: All of them."]


def test_what_is_wrong_and_what_holds_in_part_are_counted_apart():
    formula = '{ id = "some", where = "Table 9", kind = "formula", printed = "a + b", cause = "one-missing" },'
    text = WITH_TABLES.replace("items = [", f"items = [\n  {formula}")
    text += TABLES.replace('["a count", "{count}"]', '["a count", "{count}"], ["a sum", "{some}"]')
    in_part = {"some": ({"in x": True, "in y": False}, "a + c", "added up")}
    shown = read_paper("test", text).table("both", VALUES | in_part, basis="simulation")
    assert shown.told == ["✗ 1 cell, (✓) 1 cell: One is missing: 326 for 336."]


def test_a_grid_shows_one_number_where_both_agree(paper):
    shown = paper.table("t", [[1, 0.5], [3, 1]])
    assert repr(shown).splitlines()[1:4] == [
        "printed | counted  1 KF A         2 LF B",
        "1 KF A                            0.50",
        "2 LF B             2.00 | 3.00 ✗",
    ]
    assert "<th>2<br>LF&nbsp;B</th>" in shown.html()


def test_the_numbers_of_a_table_may_share_a_reason(paper):
    shown = paper.table("both", VALUES, basis="simulation", reason="Read as metres.")
    assert [each.reason.startswith("Read as metres.") for each in shown] == [True, True, True, False]


def test_a_grid_may_have_items_as_names_of_its_rows():
    rows = '[["{equal}", "{count}"], ["a total", "17"]]'
    text = f'[[tables]]\nid = "long"\ntitle = "Table 7"\nhead = ["what it says", "count"]\nrows = {rows}\ngrid = true\n'
    value = {"equal": (True, "A equals B", "counted"), "count": 17}
    shown = read_paper("test", WITH_TABLES + text).table("long", value, basis="arithmetic")
    assert repr(shown).splitlines()[2:] == ["A equals B    17", "a total       17"]
    assert "<td>a&nbsp;total</td>" in shown.html()


def test_a_table_of_names_has_no_verdict_and_takes_columns_of_ours(paper):
    shown = paper.table("names", [], extra={"computed": ["0.1"]})
    assert list(shown) == []
    assert repr(shown).splitlines() == ["Table 8: names", "number  name  computed", "1       KF    0.1"]


def test_a_formula_in_a_table_is_a_claim_with_its_evidence():
    text = WITH_TABLES.replace(
        'id = "count", where = "Table 1", kind = "number"', 'id = "count", where = "T", kind = "formula"'
    )
    for value in ((True, "17", "counted"), lambda printed: (printed == "17", "17", "counted")):
        shown = read_paper("test", text + TABLES).table("both", VALUES | {"count": value}, basis="simulation")
        assert (shown[0].verdict, shown[0].computed) == ("reproduced", "counted")
        assert "a count          17\n" in repr(shown)


def test_claims_and_gaps_are_shown_with_their_signs(paper):
    assert repr(paper.equal({"equal": 1e-15}, "B")).splitlines() == [
        "             the paper says  largest gap to B",
        "✓ Section 1  A equals B      below 1e-12",
    ]
    part = {"in x": True, "in y": False}
    paper = read_paper("test", WITH_TABLES.replace('"A equals B"', '"A equals B", cause = "one-missing"'))
    shown = paper.claims({"equal": (part, "seen in x", "and beyond")}, basis="exact")
    assert (shown[0].verdict, shown[0].beyond) == ("holds in part", "and beyond")
    assert repr(shown).splitlines()[1:] == [
        "(✓) Section 1  A equals B      seen in x",
        "(✓) Holds: in x. Does not hold: in y. One is missing: 326 for 336.",
    ]


def test_what_cannot_be_checked_is_shown_with_its_reason(paper):
    shown = paper.lacking({"lost": "a cell"})
    assert shown[0].verdict == "cannot be checked"
    assert repr(shown).splitlines()[-1] == "? Table 4  ?                       a cell"
    assert shown.html().startswith("<table>")
    folded = paper.lacking({"lost": "a cell"}, folded="what is lost")
    assert folded.html() == f"<details><summary>what is lost</summary>\n{shown.html()}\n</details>"
    assert repr(folded) == repr(shown)


def test_the_cells_of_a_table_in_html_keep_their_signs():
    html = Grid(["a", "b"], [["<", "1 ✗"]], "c & d").html()
    assert "c &amp; d</caption>" in html
    assert "<td>&lt;</td><td>1 ✗</td>" in html
    sentences = Grid(["a"], [[Cell("b", wrong=True)]], sentences=True).html()
    assert "<td style='text-align:left; background:#fbe0d2'>b</td>" in sentences


@pytest.fixture
def verdicts(paper):
    found = paper.table("both", VALUES, basis="simulation")
    return Verdicts([*found, *paper.equal({"equal": 0.0})], paper.causes_by_paper())


def test_the_contents_count_and_link_what_the_verdicts_say(paper, verdicts):
    assert contents(paper.rows, verdicts).splitlines() == [
        "**The paper prints 5 numbers, formulas, claims and figures as results. 4 of them can be checked: 3 hold, "
        "1 does not, for 1 reason: a sum.**",
        "",
        "| in the paper | what it shows | does it hold? |",
        "|---|---|---|",
        "| [Table 9](#Table-9:-all-of-them) | numbers | ✗ 1 of 3 wrong: a total; ? 1 lost in our copy |",
        "| [Section 1](#Section-1) | what is equal | ✓ |",
        "| [Table 8](#Table-8) | names | names only |",
    ]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["reproduced", "within band"], "✓ all 2"),
        (["reproduced", "holds in part"], "(✓) 1 of 2 in part: why"),
        (["erratum", "differs", "holds in part", "reproduced"], "✗ 2 of 4 wrong; (✓) 1 of 4 in part: why"),
        (["cannot be checked"], "? 1 cannot be checked"),
    ],
)
def test_a_line_of_the_contents_says_what_holds(verdicts, given, said):
    every = [replace(verdicts[0], verdict=verdict) for verdict in given]
    assert in_words(Row("Table 1", [verdicts[0].id], "numbers", why="why"), every) == said


def test_a_lost_picture_is_said_to_be_redrawn(verdicts):
    picture = replace(verdicts[0], id="figure1", kind="figure", verdict="cannot be checked")
    assert (
        in_words(Row("Figure 1", ["figure1"], "a track"), [picture])
        == "? picture lost in our copy; redrawn on our own data"
    )


def test_contents_are_written_between_their_marks_and_again_change_nothing(tmp_path):
    path = tmp_path / "small.ipynb"
    front = "# Title\n\n<!-- contents -->\nold\n<!-- end of contents -->\n\nend"
    cells = [{"cell_type": "markdown", "id": "front", "metadata": {}, "source": front}]
    path.write_text(json.dumps({"cells": cells, "metadata": {}, "nbformat": 4, "nbformat_minor": 5}))
    write_contents(path, "new\\1")
    once = path.read_bytes()
    source = "".join(json.loads(once)["cells"][0]["source"])
    assert source == "# Title\n\n<!-- contents -->\n\nnew\\1\n\n<!-- end of contents -->\n\nend"
    write_contents(path, "new\\1")
    assert path.read_bytes() == once


@pytest.mark.parametrize("front", ["# Title", 2 * "<!-- contents --><!-- end of contents -->"])
def test_a_notebook_without_a_place_for_the_contents_is_refused(tmp_path, front):
    path = tmp_path / "small.ipynb"
    path.write_text(json.dumps({"cells": [{"cell_type": "markdown", "source": front}]}))
    before = path.read_bytes()
    with pytest.raises(ValueError, match=r"small\.ipynb: needs <!-- contents -->"):
        write_contents(path, "new")
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('["a count", "{count}"]', '["a count", "{cuont}"]', "table 'both': needs ids of items in braces, got cuont"),
        ('title = "Table 8: names"', "", "needs id, title, head, rows, got"),
        ('shows = "names"', "shows = 5", "'Table 8': needs a text for shows, got 5"),
        ('id = "names"', 'id = "both"', "needs each id once, got both again"),
    ],
)
def test_a_malformed_table_is_refused_by_name(old, new, message):
    with pytest.raises(ValueError, match=message):
        read_paper("test", WITH_TABLES + TABLES.replace(old, new))


def test_a_paper_says_what_it_is():
    lines = ['title = "T"', 'authors = "A"', 'journal = "J"', "year = 1960", 'doi = ""', "tables = 2", "figures = 1"]
    text = "\n".join(f"paper.{line}" for line in ['name = "N"', *lines])
    assert read_paper("test", f"{text}\n{PAPER}").about.numbered == ["Table 1", "Table 2", "Figure 1"]
    with pytest.raises(ValueError, match=r"needs name, title, .*, figures, got"):
        read_paper("test", f"paper.name = 'N'\n{PAPER}")


def test_an_item_knows_how_many_decimals_it_prints():
    assert [Item("t", "T", "number", each).decimals for each in ("17", "1.290")] == [0, 3]
