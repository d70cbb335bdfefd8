"""The ledger on a made-up paper, and the papers' files."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from conftest import NOTEBOOKS, PAPER, ROOT

import reproduction
from reproduction.ledger import Item, Verdicts, keys, read_paper, shipped_verdicts, stored_verdicts
from reproduction.ledger.verdicts import BASES, HOLDS, MIME

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
    return read_paper("test", PAPER)


@pytest.fixture
def failing():
    """The made-up paper, whose ratio and claim have a cause."""
    text = PAPER.replace('"1.290"', '"1.290", cause = "one-missing"')
    return read_paper("test", text.replace('"A equals B"', '"A equals B", cause = "one-missing"'))


@pytest.fixture
def path(tmp_path, monkeypatch):
    """Where a notebook on the made-up paper would stand."""
    (tmp_path / "test.toml").write_text(PAPER)
    monkeypatch.setattr("reproduction.ledger.files.FOLDER", tmp_path)
    return tmp_path / "test.ipynb"


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


def test_a_number_is_reproduced_or_differs(failing):
    assert failing.check("count", 17).verdict == "reproduced"
    differs = failing.check("ratio", 1.3, reason="We rounded.")
    assert (differs.verdict, differs.printed, differs.computed) == ("differs", "1.290", "1.3")
    assert (differs.reason, differs.cause, differs.basis) == ("We rounded.", "one-missing", "arithmetic")


def test_what_holds_names_no_cause(failing):
    """One cause may be given to all cells of a table: those that agree do not count for it. A reason stays."""
    given = failing.check("ratio", 1.29)
    assert (given.verdict, given.cause, given.reason) == ("reproduced", "", "")
    assert failing.check("ratio", 1.29, reason="All were counted.").reason == "All were counted."


def test_the_sentence_of_the_cause_is_the_reason_where_none_is_given(failing):
    assert failing.check("ratio", 1.3).reason == "One is missing: 326 for 336."


def test_an_erratum_rests_on_items_that_were_reproduced(paper):
    with pytest.raises(ValueError, match="test, 'wrong': needs items in `against` that were reproduced before, got 'c"):
        paper.check("wrong", 336)
    paper.check("count", 17)
    erratum = paper.check("wrong", 336)
    assert erratum.verdict == "erratum"
    assert erratum.reason == "One is missing: 326 for 336. Against Table 1: 17."


def test_an_erratum_does_not_rest_on_what_differs():
    text = PAPER.replace('"1.290"', '"1.290", cause = "one-missing"').replace('["count"]', '["ratio"]')
    paper = read_paper("test", text)
    paper.check("ratio", 1.3)
    with pytest.raises(ValueError, match="needs items in `against` that were reproduced before, got 'ratio'"):
        paper.check("wrong", 336)


def test_against_makes_no_erratum_of_what_agrees(paper):
    paper.check("count", 17)
    assert paper.check("wrong", 326).verdict == "reproduced"


@pytest.mark.parametrize(
    ("band", "verdict"), [((1.28, 1.3), "within band"), ((1.29, 1.29), "within band"), ((1.3, 1.4), "differs")]
)
def test_a_band_holds_the_printed_number_or_not(failing, band, verdict):
    given = failing.check("ratio", 1.35, basis="simulation", band=band)
    assert given.verdict == verdict
    assert given.computed == f"1.35 [{band[0]}, {band[1]}]"


@pytest.mark.parametrize(
    ("holds", "verdict", "reason"),
    [
        (True, "reproduced", ""),
        (False, "differs", "One is missing: 326 for 336."),
        ({"in x": True, "in y": True}, "reproduced", "Holds: in x; in y."),
        ({"in x": False}, "differs", "Fails: in x. One is missing: 326 for 336."),
        (
            {"in x": True, "in y": False, "in z": True},
            "holds in part",
            "Holds: in x; in z. Fails: in y. One is missing: 326 for 336.",
        ),
    ],
)
def test_a_claim_holds_fails_or_holds_where_it_says(failing, holds, verdict, reason):
    given = failing.claim("equal", holds, "gap 1", basis="exact")
    assert (given.verdict, given.reason, given.basis) == (verdict, reason, "exact")
    assert given.cause == ("" if verdict == "reproduced" else "one-missing")


BAND = r"'ratio': needs a band \(low, high\) of finite numbers with low <= high, got "
PART = {"in x": True, "in y": False}


@pytest.mark.parametrize(
    ("message", "call"),
    [
        (r"test, 'cuont': unknown id of test.toml; did you mean count, .*\?$", lambda p: p.check("cuont", 1)),
        ("'equal': needs an item of kind number, got a claim", lambda p: p.check("equal", 1)),
        ("'count': needs an item of kind formula or claim or", lambda p: p.claim("count", True, "", basis="exact")),
        ("'lost': our copy has lost this item: use cannot_check", lambda p: p.check("lost", 1)),
        ("'lost': needs a finite number for counted", lambda p: p.cannot_check("lost", "", counted=float("nan"))),
        ("'wrong': needs a cause of kind \"copy\", or", lambda p: p.cannot_check("wrong", "")),
        ("'ratio': needs a cause, since the verdict is 'differs'", lambda p: p.check("ratio", 1.3)),
        ("'equal': needs a cause, since .* 'holds in part'", lambda p: p.claim("equal", PART, "", basis="simulation")),
        ("'count': needs a finite number, got nan", lambda p: p.check("count", float("nan"))),
        ("'count': needs a finite number, got '17'", lambda p: p.check("count", "17")),
        ("'count': needs a finite number, got array", lambda p: p.check("count", np.array([17.0, 18.0]))),
        (BAND, lambda p: p.check("ratio", 1, basis="exact", band=(2, 1))),
        (BAND, lambda p: p.check("ratio", 1, basis="exact", band=(-np.inf, np.inf))),
        (BAND, lambda p: p.check("ratio", 1, basis="exact", band=(1, 2, 3))),
        (BAND, lambda p: p.check("ratio", 1, basis="exact", band=("1", "2"))),
        (BAND, lambda p: p.check("ratio", 1, basis="exact", band=5)),
        ("'ratio': needs the basis of its band", lambda p: p.check("ratio", 1.29, band=(1, 2))),
        ("'equal': needs one of the bases identity, .*, got 'gut'", lambda p: p.claim("equal", True, "", basis="gut")),
        ("'equal': needs True, False or .*, got 'yes'", lambda p: p.claim("equal", "yes", "", basis="exact")),
        ("'equal': needs True, False or .*, got {}", lambda p: p.claim("equal", {}, "", basis="exact")),
        ("test: no verdict was given since the last report", lambda p: p.report()),
    ],
)  # fmt: skip
def test_a_check_that_makes_no_sense_is_refused(paper, message, call):
    with pytest.raises(ValueError, match=message):
        call(paper)
    with pytest.raises(ValueError, match="no verdict was given"):
        paper.report()


@pytest.mark.parametrize("cause", ["", "one-missing"])
def test_what_our_copy_has_lost_needs_a_cause_that_says_so(cause):
    paper = read_paper("test", PAPER.replace(', cause = "our-copy"', f', cause = "{cause}"' if cause else ""))
    with pytest.raises(ValueError, match=f"'lost': needs a cause of kind \"copy\", .* got '{cause}'"):
        paper.cannot_check("lost", "a cell")


def test_what_fails_needs_a_cause_other_than_our_copy():
    paper = read_paper("test", PAPER.replace('"17"', '"17", cause = "our-copy"'))
    with pytest.raises(ValueError, match="'count': needs another cause: what our copy"):
        paper.check("count", 1)


def test_a_claim_needs_a_basis_here_or_in_the_file(paper):
    with pytest.raises(ValueError, match=r"'equal': needs one of the bases identity, .*, got ''"):
        paper.claim("equal", True, "gap 0")
    paper = read_paper("test", PAPER.replace('"A equals B"', '"A equals B", basis = "exact"'))
    assert paper.claim("equal", True, "gap 0").basis == "exact"
    assert paper.claim("equal", True, "gap 0", basis="identity").basis == "identity"


def test_what_cannot_be_checked_says_what_is_missing(paper):
    lost = paper.cannot_check("lost", "the cell is lost")
    assert (lost.verdict, lost.reason, lost.basis) == ("cannot be checked", "the cell is lost", "reading")
    assert paper.cannot_check("ratio", "The paper does not say which.").cause == ""
    assert lost.computed == "-"
    assert paper.cannot_check("lost", "the cell is lost", counted=0.25).computed == "0.25"


def test_a_report_has_what_was_given_since_the_last(paper):
    paper.check("count", 17)
    assert [each.id for each in paper.report()] == ["count"]
    paper.claim("equal", True, "gap 0", basis="identity")
    assert [each.id for each in paper.report()] == ["equal"]


def test_a_cell_may_run_again(paper):
    for _ in range(2):
        paper.check("count", 17)
        assert [each.id for each in paper.report()] == ["count"]


def full(paper):
    """Give a verdict on each item of the made-up paper."""
    paper.check("count", 17)
    paper.check("ratio", 178 / 138)
    paper.check("wrong", 336)
    paper.claim("equal", True, "gap 0 < 1", basis="identity")
    paper.cannot_check("lost", "a cell")
    return paper.report()


def test_a_report_is_one_line_and_a_folded_table(paper):
    report = full(paper)
    data = report._repr_mimebundle_()
    summary = "5 verdicts: 3 reproduced, 1 erratum, 1 cannot be checked (1 slip)"
    assert data["text/plain"].splitlines()[0] == summary
    assert max(map(len, data["text/plain"].splitlines())) <= 110
    assert data["text/html"].startswith(f"<details><summary>{summary}</summary>\n<table>")
    assert data["text/html"].endswith("</table>\n</details>")
    assert "<td>gap 0 &lt; 1</td>" in data["text/html"]
    assert [record["id"] for record in data[MIME]] == list(paper.items)
    fields = ["paper", "id", "where", "kind", "printed", "computed", "verdict", "reason", "basis", "cause"]
    fields.append("beyond")
    assert list(data[MIME][0]) == fields


def test_causes_are_counted_with_their_cells_and_claims_apart(paper):
    report = full(paper)
    twice = Verdicts([*report, *[each for each in report if each.id in ("wrong", "equal")]], report.causes)
    tally = twice.tally()
    assert tally.claims_text() == "2 of 2 claims hold"
    assert tally.values_text() == "2 of 5 numbers, formulas and figures agree"
    assert tally.causes_text() == "1 slip (2 cells); 1 cell missing or illegible in our copy"
    assert Verdicts([]).tally().causes_text() == "nothing wrong"


def test_a_tally_has_every_claim_once(failing):
    given = []
    for holds in (True, True, False, {"x": True, "y": False}):
        given.append(failing.claim("equal", holds, "", basis="exact"))
    given += [replace(given[0], verdict="erratum"), replace(given[0], verdict="cannot be checked")]
    claims = Verdicts(given, failing.report().causes).tally().claims
    words = ["reproduced", "holds in part", "differs", "erratum", "cannot be checked"]
    assert claims == dict(zip(words, [2, 1, 1, 1, 1], strict=True))


def test_a_grid_is_one_item_for_each_cell_that_holds_one():
    items = read_paper("test", GRID).items
    assert {id: item.printed for id, item in items.items()} == {
        "t.1.2": "0.50", "t.1.3": "?", "t.2.1": "2.00", "t.2.3": "0.33", "t.3.1": "6.00", "t.3.2": "3.00",
    }  # fmt: skip
    assert items["t.2.3"].where == "Table 5, row 2, column 3"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("items = [", "test.toml: "),
        ('items = [{ id = "a" }]', "test.toml: needs id, where, kind, printed, got {'id': 'a'}"),
        ("items = 5", "test.toml: needs lists of items, .*, got items = 5"),
        ("items = [5]", "test.toml: needs id, where, kind, printed, got 5"),
        (PAPER.replace('"claim"', '"rumour"'), "test.toml, 'equal': needs kind number or .*, got 'rumour'"),
        (PAPER.replace('"claim"', '"claim", extra = "x"'), "test.toml: needs id, .*'equal'.*extra"),
        (PAPER.replace('where = "Table 1", ', ""), "test.toml: needs id, where, kind, printed, got {'id': 'count'"),
        (PAPER.replace('"1.290"', '"nan"'), "test.toml, 'ratio': needs a number as printed, got 'nan'"),
        (PAPER.replace('"1.290"', '"1,290"'), "test.toml, 'ratio': needs a number as printed, got '1,290'"),
        (PAPER.replace('"1.290"', "1.290"), "test.toml, 'ratio': needs a text for printed, got 1.29"),
        (PAPER.replace('id = "ratio"', 'id = "count"'), "test.toml: needs each id once, got count again"),
        (PAPER.replace('cause = "our-copy"', 'cause = "x"'), "test.toml, 'lost': needs a cause of this file, got 'x'"),
        (PAPER.replace('["count"]', '"count"'), "test.toml, 'wrong': needs a list of ids in `against`, got 'count'"),
        (PAPER.replace('"our-copy"', '"one-missing"'), "test.toml: needs each id once, got one-missing again"),
        (PAPER.replace('"slip"', '"sin"'), "test.toml, 'one-missing': needs kind slip or .*, got 'sin'"),
        (PAPER.replace('meaning = "Nothing."', ""), "test.toml: needs id, kind, sentence, meaning, got .*'our-copy'"),
        (PAPER + "\n[extra]\n", "test.toml: needs lists of items, .*, got extra = {}"),
        (GRID.replace("{column}", "{0}"), "test.toml, grid .*'t'.*: needs id, where"),
        (GRID.replace("{column}", "{colum}"), "test.toml, grid .*'colum'"),
        (GRID.replace("1 = [", "1 = 5 # ["), "test.toml, grid "),
        (GRID.replace("[grids.rows]", "rows = 5"), "test.toml, grid "),
        (GRID.replace('where = "Table 5, row {row}, column {column}"', "where = 5"), "test.toml, grid "),
        (GRID.replace('"0.50", "?"', '"0.50"'), "test.toml, grid .*shorter"),
        (GRID.replace("[grids.rows]", 'unit = "m"\n[grids.rows]'), "test.toml, grid .*: needs id, where"),
    ],
)
def test_a_malformed_file_is_refused_by_name(text, message):
    with pytest.raises(ValueError, match=message):
        read_paper("test", text)


def test_an_unknown_paper_lists_the_known_ones():
    with pytest.raises(ValueError, match=f"key: needs one of {', '.join(keys())}, got '2013'"):
        reproduction.published("2013")


@pytest.mark.parametrize(
    "content",
    [
        "", "{}", "[]", '{"cells": []}', '{"cells": [5]}', '{"cells": [{"outputs": [{"data": null}]}]}',
        '{"cells": [{"outputs": [{}]}]}', json.dumps({"cells": [{"id": "a", "outputs": [{"data": {MIME: [{}]}}]}]}),
    ],
)  # fmt: skip
def test_what_stores_no_verdicts_is_refused_by_name(path, content):
    path.write_text(content)
    with pytest.raises(ValueError, match=r"test\.ipynb: needs (an executed notebook|verdicts of this version)"):
        stored_verdicts(path)


def stored(path, *reports):
    """Return the Verdicts that a notebook with these reports stores, each in a cell of its own."""
    cells = [{"id": "words", "source": "no output"}]
    for number, report in enumerate(reports):
        cells.append({"id": f"cell-{number}", "outputs": [{"data": report._repr_mimebundle_()}]})
    path.write_text(json.dumps({"cells": cells}))
    return stored_verdicts(path)


def test_a_stored_verdict_names_the_cell_that_shows_it_in_the_order_of_the_paper(path, paper):
    paper.claim("equal", True, "gap 0", basis="identity")
    first = paper.report()
    paper.check("count", 17)
    given = stored(path, first, paper.report())
    assert [(each.id, each.cell) for each in given] == [("count", "cell-1"), ("equal", "cell-0")]
    assert given.causes["test", "our-copy"].kind == "copy"


def test_a_notebook_of_nbformat_4_4_whose_cells_have_no_ids_names_them_by_their_number(path, paper):
    expected = stored(path, full(paper))
    content = json.loads(path.read_text())
    for cell in content["cells"]:
        del cell["id"]
    path.write_text(json.dumps(content))
    assert list(stored_verdicts(path)) == [replace(each, cell="2") for each in expected]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"one-missing"', '"two-missing"', "got cause 'two-missing' of 'wrong': run"),
        ('"erratum"', '"error"', "got verdict 'error' of 'wrong': run"),
        ('"paper": "test"', '"paper": "other"', "got paper 'other' of 'count': run"),
        ('"basis": "arithmetic"', '"basis": ""', "got basis '' of 'count': run"),
        ('"basis"', '"base"', "unexpected keyword argument 'base'.*: run"),
        ('"verdict": "erratum", ', "", "missing 1 required positional argument: 'verdict'.*: run"),
        ("[{", "[5, {", "test.json: needs verdicts of this version .*: run"),
    ],
)
def test_verdicts_of_another_version_are_refused_with_the_file_and_the_cure(path, paper, old, new, message):
    """Read from the package and from a notebook."""
    records = json.dumps([each | {"cell": "a"} for each in full(paper).records()])
    shipped = path.with_suffix(".json")
    shipped.write_text(records)
    assert list(shipped_verdicts("test")) == [replace(each, cell="a") for each in full(paper)]
    assert old in records
    shipped.write_text(records.replace(old, new))
    with pytest.raises(ValueError, match=f"test.json: .*{message.removeprefix('test.json: ')} .*reproduce test"):
        shipped_verdicts("test")
    cell = f'{{"id": "a", "outputs": [{{"data": {{"{MIME}": {records.replace(old, new)}}}}}]}}'
    path.write_text(f'{{"cells": [{cell}]}}')
    with pytest.raises(ValueError, match=r"test.ipynb: needs "):
        stored_verdicts(path)


def test_a_shipped_file_that_is_no_json_is_named(path):
    path.with_suffix(".json").write_text("[{")
    with pytest.raises(ValueError, match=r"test\.json: "):
        shipped_verdicts("test")


def test_a_complete_notebook_has_one_verdict_on_each_item(path, paper):
    given = stored(path, full(paper))
    assert paper.complete(given) is given


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda all: all[1:], "test.toml and its notebook: no verdict on count"),
        (lambda all: [replace(each, cause="") for each in all], "no cause, although it fails, for wrong; no verdict"),
        (lambda all: [*all, all[0]], "two verdicts on count"),
        (lambda all: all[:2] + all[3:], "no verdict on wrong; no verdict names the cause one-missing"),
    ],
)
def test_a_notebook_that_is_not_complete_is_refused(paper, change, message):
    with pytest.raises(ValueError, match=message):
        paper.complete(Verdicts(change(list(full(paper)))))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('printed = "17"', 'printed = "18"', "verdicts that do not match the file .*: count"),
        ('id = "ratio"', 'id = "ratios"', "no verdict on ratios; verdicts that do not match .*: ratio"),
        ('"our-copy"', '"copy"', "no verdict names the cause copy"),
    ],
)
def test_a_notebook_that_is_older_than_the_file_is_refused(paper, old, new, message):
    with pytest.raises(ValueError, match=message):
        read_paper("test", PAPER.replace(old, new)).complete(full(paper))


def test_the_ledger_knows_no_filter_and_imports_fast():
    code = "import reproduction.ledger, sys; print(*sorted(sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    own = [name for name in loaded if name.startswith(("mpt_helpers", "reproduction.ledger."))]
    names = ("contents", "files", "items", "paper", "shown", "tables", "verdicts")
    assert own == [f"reproduction.ledger.{name}" for name in names]
    assert not {"scipy", "matplotlib", "pandas", "filterpy", "IPython"} & set(loaded)


def test_every_paper_has_a_notebook_and_every_notebook_a_paper():
    assert keys() == [path.stem for path in NOTEBOOKS]


@pytest.mark.parametrize("key", keys())
def test_every_item_has_a_verdict_and_the_package_ships_what_the_notebook_stores(key):
    shipped = shipped_verdicts(key)
    stored = stored_verdicts(ROOT / "notebooks" / f"{key}.ipynb")
    assert list(reproduction.published(key).complete(stored)) == list(shipped), "stale: run `make reproduce`"
    for each in stored:
        assert each.basis in BASES
        assert each.verdict in HOLDS or each.reason
