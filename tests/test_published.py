import json

import pytest
from conftest import NOTEBOOKS
from IPython.core.interactiveshell import InteractiveShell

import mpt_helpers as mpt
from mpt_helpers.published import MIME, NONE_YET, Item, Paper, keys, read_items, stored_verdicts

ITEMS = """
items = [
  { id = "count", where = "Table 1", kind = "number", printed = "17" },
  { id = "ratio", where = "Table 2", kind = "number", printed = "1.290" },
  { id = "wrong", where = "Table 3", kind = "number", printed = "326" },
  { id = "equal", where = "Section 1", kind = "claim", printed = "A equals B" },
  { id = "lost", where = "Table 4", kind = "number", printed = "?" },
]
"""
GRID = """
items = []
[[grids]]
id = "t"
where = "Table 5, row {row}, column {column}"
columns = ["1", "2", "3"]
[grids.rows]
1 = ["", "0.50", "?"]
2 = ["2.00", "", "0.33"]
3 = ["6.00", "3.00", ""]
"""


@pytest.fixture
def paper():
    return Paper("test", read_items("test", ITEMS))


@pytest.mark.parametrize(
    ("printed", "value", "agrees"),
    [
        ("17", 17.5, True), ("17", 17.505, False),
        ("17", 17, True), ("17", 17.4, True), ("17", 17.6, False), ("17", 16, False),
        ("1.290", 178 / 138, True), ("1.290", 1.2906, False), ("1.290", 1.2894, False), ("1.29", 1.2906, True),
        ("0.125", 0.1255, True), ("0.125", 0.1245, True), ("0.125", 0.1256, False), ("-1.5", -1.54, True),
    ],
)  # fmt: skip
def test_a_number_agrees_at_its_printed_digits(printed, value, agrees):
    assert Item("id", "where", "number", printed).agrees(value) is agrees


def test_a_number_is_reproduced_or_differs(paper):
    assert paper.check("count", 17).verdict == "reproduced"
    differs = paper.check("ratio", 1.3, reason="We rounded.")
    assert (differs.verdict, differs.printed, differs.computed) == ("differs", "1.290", "1.3")
    assert differs.reason == "We rounded."


def test_a_difference_needs_a_reason(paper):
    with pytest.raises(ValueError, match="reason: needs a reason, for ratio differs, got none"):
        paper.check("ratio", 1.3)
    with pytest.raises(ValueError, match="reason: needs a reason"):
        paper.claim("equal", False, "gap 1")


def test_an_erratum_rests_on_items_that_were_reproduced(paper):
    with pytest.raises(ValueError, match="against: needs items of the paper that were reproduced before, got 'count'"):
        paper.check("wrong", 336, against=["count"], reason="One is missing.")
    paper.check("count", 17)
    erratum = paper.check("wrong", 336, against=["count"], reason="One is missing.")
    assert erratum.verdict == "erratum"
    assert erratum.reason == "One is missing. Against Table 1: 17."


def test_an_erratum_does_not_rest_on_what_differs(paper):
    paper.check("ratio", 1.3, reason="We rounded.")
    with pytest.raises(ValueError, match="against: needs items of the paper that were reproduced before, got 'ratio'"):
        paper.check("wrong", 336, against=["ratio"], reason="One is missing.")


def test_a_band_is_shown(paper):
    assert paper.check("ratio", 1.3, band=(1.28, 1.31)).computed == "1.3 [1.28, 1.31]"


def test_against_makes_no_erratum_of_what_agrees(paper):
    paper.check("count", 17)
    assert paper.check("wrong", 326, against=["count"], reason="One is missing.").verdict == "reproduced"


@pytest.mark.parametrize(
    ("band", "verdict"), [((1.28, 1.3), "within band"), ((1.29, 1.29), "within band"), ((1.3, 1.4), "differs")]
)
def test_a_band_holds_the_printed_number_or_not(paper, band, verdict):
    assert paper.check("ratio", 1.35, band=band, reason="Noise.").verdict == verdict


@pytest.mark.parametrize(
    ("error", "message", "call"),
    [
        (ValueError, "id: needs an item of test, got 'cuont'; the nearest are count", lambda p: p.check("cuont", 1)),
        (ValueError, "id: needs a number, got 'equal', a claim", lambda p: p.check("equal", 1)),
        (ValueError, "id: needs a formula or claim or figure", lambda p: p.claim("count", True, "")),
        (ValueError, "id: needs an item that is legible, got 'lost'", lambda p: p.check("lost", 1)),
        (ValueError, r"band: needs \(low, high\) with low <= high", lambda p: p.check("ratio", 1, band=(2, 1))),
        (ValueError, "value: needs a number, got nan", lambda p: p.check("count", float("nan"))),
        (TypeError, "value: needs a number, got '17'", lambda p: p.check("count", "17")),
        (TypeError, "band: needs a number, got None", lambda p: p.check("ratio", 1, band=(None, 1))),
        (ValueError, "holds: needs True or False, got 'yes'", lambda p: p.claim("equal", "yes", "")),
        (TypeError, "evidence: needs a str", lambda p: p.claim("equal", True, 5)),
        (TypeError, "missing: needs a str", lambda p: p.cannot_check("lost", None)),
    ],
)
def test_a_check_that_makes_no_sense_is_refused(paper, error, message, call):
    with pytest.raises(error, match=message):
        call(paper)
    assert {each.verdict for each in paper.verdicts()} == {NONE_YET}


def test_no_item_is_checked_twice(paper):
    paper.check("count", 17)
    with pytest.raises(ValueError, match="id: needs an item without a verdict, got 'count' for the second time"):
        paper.check("count", 17)


def test_a_lost_item_cannot_be_checked(paper):
    lost = paper.cannot_check("lost", "the cell is lost")
    assert (lost.verdict, lost.reason) == ("cannot be checked", "the cell is lost")


def test_verdicts_are_in_the_order_of_the_paper_and_name_what_is_open(paper):
    paper.claim("equal", True, "gap 0")
    paper.check("count", 17)
    assert [each.id for each in paper.verdicts()] == list(paper.items)
    assert [each.id for each in paper.verdicts() if each.verdict == NONE_YET] == ["ratio", "wrong", "lost"]
    assert {each.id for each in paper.verdicts().look_at()} == {"ratio", "wrong", "lost"}


def test_a_grid_is_one_item_for_each_cell_that_holds_one():
    items = {item.id: item for item in read_items("test", GRID)}
    assert {id: item.printed for id, item in items.items()} == {
        "t.1.2": "0.50", "t.1.3": "?", "t.2.1": "2.00", "t.2.3": "0.33", "t.3.1": "6.00", "t.3.2": "3.00",
    }  # fmt: skip
    assert items["t.2.3"].where == "Table 5, row 2, column 3"


def test_the_numbers_behind_a_grid_of_ratios_are_found():
    paper = Paper("test", read_items("test", GRID))
    # 10/20 = 0.50 and 60/10, 60/20 leave 60 alone; without knowing 20 every number that rounds right is kept.
    assert paper.implied("t", {"1": 10, "2": 20}) == {"3": [60]}
    assert paper.implied("t", {"1": 10}) == {"2": [20], "3": [60]}
    below = GRID.replace('"2.00"', '"?"').replace('"3.00"', '"?"').replace('"6.00"', '"?"')
    assert Paper("test", read_items("test", below)).implied("t", {"1": 10})["2"] == [20]
    assert paper.implied("t", {"1": 1000})["2"] == list(range(1995, 2006))  # 1995 and 2005 are ties


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("items = [", "test.toml: "),
        ("", "test.toml: 'items'"),
        ('items = [{ id = "a" }]', "test.toml: .*missing"),
        (ITEMS.replace('kind = "claim"', 'kind = "rumour"'), "test.toml: kind of 'equal': needs number or formula"),
        (ITEMS.replace('"1.290"', '"1,290"'), "test.toml: printed of 'ratio': needs a number as printed, got '1,290'"),
        (ITEMS.replace('"1.290"', "1.290"), "test.toml: printed of 'ratio': needs a text, got 1.29"),
        (ITEMS.replace('id = "ratio"', 'id = "count"'), "test.toml: needs each id once, got count"),
        (ITEMS.replace('where = "Table 1", ', ""), "test.toml: .*missing"),
        (ITEMS + "\n[extra]\n", "test.toml: needs only items and grids, got extra"),
        (GRID.replace('"0.50", "?"', '"0.50"'), r"test.toml: .*shorter"),
    ],
)
def test_a_malformed_file_is_refused_by_name(text, message):
    with pytest.raises(ValueError, match=message):
        read_items("test", text)


def test_an_unknown_paper_lists_the_known_ones():
    with pytest.raises(
        ValueError, match="key: needs one of 2007_mms_kalman, 2014_gsm_2d, 2015_mpt_3d, 2016_prediction, got"
    ):
        mpt.published("2013")


@pytest.mark.parametrize("content", ["", "{}", "[]", '{"cells": []}', '{"cells": [{"outputs": [{}]}]}'])
def test_what_stores_no_verdicts_is_refused_by_name(tmp_path, content):
    path = tmp_path / "n.ipynb"
    path.write_text(content)
    with pytest.raises(ValueError, match=r"n\.ipynb: needs an executed notebook"):
        stored_verdicts(path)


def test_stored_verdicts_are_those_displayed(tmp_path, paper):
    paper.check("count", 17)
    data = paper.verdicts()._repr_mimebundle_()
    path = tmp_path / "n.ipynb"
    early = {MIME: Paper("test", read_items("test", ITEMS)).verdicts().records()}
    path.write_text(json.dumps({"cells": [{"outputs": [{"data": early}]}, {"outputs": [{"data": data}]}]}))
    assert list(stored_verdicts(path)) == list(paper.verdicts())
    assert {each.cell for each in paper.verdicts()} == {None}  # no notebook runs here
    assert "<td>count</td>" in data["text/html"]
    assert len(data[MIME]) == len(paper.items)


HANDS_IN = """\
import json
import mpt_helpers as mpt
from mpt_helpers.published import Paper, read_items
paper = Paper("test", read_items("test", ITEMS))
for _ in [paper.check("count", 17)]:
    pass"""


@pytest.mark.parametrize("numbered", [True, False])
def test_a_stored_verdict_names_the_cell_that_gave_it(tmp_path, numbered):
    """Also for a runner that does not number its cells, such as nbval."""
    shell = InteractiveShell.instance()
    shell.user_ns["ITEMS"] = ITEMS
    try:
        for cell in ("other = 1", HANDS_IN, "verdicts = paper.verdicts()"):
            shell.run_cell(cell, store_history=numbered).raise_error()
    finally:
        InteractiveShell.clear_instance()
    outputs = [{"data": {MIME: shell.user_ns["verdicts"].records()}}]
    cells = [
        {"id": "text", "source": "words"},
        {"id": "other", "execution_count": 1, "source": "other = 1"},
        {"id": "computes", "execution_count": 2, "source": HANDS_IN.splitlines(keepends=True)},
        {"id": "last", "execution_count": 3, "source": "paper.verdicts()", "outputs": outputs},
    ]
    (tmp_path / "n.ipynb").write_text(json.dumps({"cells": cells}))
    assert {each.id: each.cell for each in stored_verdicts(tmp_path / "n.ipynb") if each.cell} == {"count": "computes"}


def test_every_paper_has_a_notebook_and_every_notebook_a_paper():
    assert keys() == [path.stem for path in NOTEBOOKS]


def test_every_item_has_a_verdict_and_every_verdict_an_item(notebook):
    key, _ = notebook
    items = mpt.published(key).items
    verdicts = {each.id: each for each in stored_verdicts(next(p for p in NOTEBOOKS if p.stem == key))}
    assert list(verdicts) == list(items)
    assert not [id for id, each in verdicts.items() if each.verdict == NONE_YET]
    assert not [id for id, each in verdicts.items() if each.verdict in ("differs", "erratum") and not each.reason]
    assert {id: (v.where, v.kind, v.printed) for id, v in verdicts.items()} == {
        id: (item.where, item.kind, item.printed) for id, item in items.items()
    }
