"""What the site is made of, where no browser is needed."""

import base64
import doctest
import importlib
import json
import re
import shutil
import subprocess
import sys
import tarfile

import break_sensor
import corrections
import home
import numpy as np
import pages
import pytest
import speed
from conftest import NOTEBOOKS, ROOT, cells_of, prose

import mpt_helpers as mpt
from mpt_helpers import _base as recursive
from reproduction import burden
from reproduction.ledger import Cause, Verdicts, keys, stored_verdicts
from reproduction.ledger.verdicts import FAILS, HOLDS, Verdict


def verdict(id, where="Table 4, row 1", verdict="reproduced", cause="", **other):
    fields = {"paper": "p", "kind": "number", "printed": "1", "computed": "1", "reason": "", "basis": "arithmetic"}
    return Verdict(id=id, where=where, verdict=verdict, cause=cause, **fields | other)


def test_many_verdicts_that_share_table_outcome_and_cause_become_one_row():
    alike = [verdict(f"t4.{i}", f"Table 4, row {i}", "erratum", "join") for i in range(6)]
    others = [verdict("a", "Abstract"), verdict("t4.9", "Table 4, row 9"), verdict("t3", "Table 3", "erratum", "join")]
    groups = pages.grouped([others[0], *alike[:3], others[1], *alike[3:], others[2]])
    assert [(group.place, len(group.members), group.folds) for group in groups] == [
        ("Abstract", 1, False),
        ("Table 4", 6, True),
        ("Table 4", 1, False),
        ("Table 3", 1, False),
    ]


def test_what_fails_comes_before_what_holds_under_a_condition():
    given = [verdict("a"), verdict("b", verdict="holds in part"), verdict("c", verdict="differs"), verdict("d")]
    assert [each.id for each in pages.worst_first(given)] == ["c", "b", "a", "d"]


def test_the_filter_of_some_verdicts_says_all_that_they_share():
    alike = [verdict(f"t4.{i}", f"Table 4, row {i}", "erratum", "join") for i in range(2)]
    assert pages.common(alike) == "paper=p&kind=number&verdict=erratum&cause=join&place=Table+4"
    assert pages.common([*alike, verdict("a", "Abstract")]) == "paper=p&kind=number"


def test_indices_are_lowered_powers_raised_and_names_left_alone():
    html = pages.typeset("H_kP_k < A^(ν-1), σ²_r, A_KF, line_sigma, x_max")
    expected = "H<sub>k</sub>P<sub>k</sub> &lt; A<sup>ν-1</sup>, σ²<sub>r</sub>, A<sub>KF</sub>, line_sigma, x_max"
    assert html == expected


def test_what_is_printed_cannot_become_markup():
    chips = pages.environment().get_template("macros.html").module.chips
    html = str(chips([verdict("a", printed="a < b & <script>")], ""))
    assert "<script>" not in html
    assert "a &lt; b &amp; &lt;script&gt;" in html


def test_a_number_is_looked_up_in_its_verdict_and_an_item_that_is_not_there_stops_the_build(tmp_path, monkeypatch):
    monkeypatch.setattr(pages, "DOCS", tmp_path)
    given = [verdict("gap", computed="11 steps")]
    said = """[home]\nanswer = "after {{ computed('p', 'gap') }}, not {{ printed('p', 'gap') }}"\n"""
    (tmp_path / "papers.toml").write_text(said)
    assert pages.texts(given)["home"]["answer"] == "after 11 steps, not 1"
    (tmp_path / "papers.toml").write_text(said.replace("'gap'", "'lost'"))
    with pytest.raises(KeyError, match="lost"):
        pages.texts(given)


@pytest.fixture(scope="module")
def given():
    """The verdicts of all papers, as the site reads them."""
    stored = [stored_verdicts(ROOT / "notebooks" / f"{key}.ipynb") for key in keys()]
    causes = {place: cause for each in stored for place, cause in each.causes.items()}
    return Verdicts([each for verdicts in stored for each in verdicts], causes)


@pytest.fixture(scope="module")
def by_id(given):
    return {(each.paper, each.id): each for each in given}


@pytest.fixture(scope="module")
def drawn():
    """The figures of all notebooks by their names."""
    return {each.name: each for key in keys() for each in pages.figures_of(key, pages.stored_notebook(key)["cells"])}


def test_each_mistake_has_words_numbers_and_a_figure(given, drawn):
    about = pages.texts(given)
    made = pages.home_page(about, given, drawn)
    assert [each["name"] for each in about["mistakes"]] == list(home.mistakes())
    said = [text for each in made["mistakes"] for text in each.values() if isinstance(text, str)]
    said += [each for each in made.values() if isinstance(each, str)]
    assert not [text for text in said if "{" in text]
    for each in made["mistakes"]:
        assert each["drawn"].name.startswith(each["key"])
        assert not each["scene"] or each["scene"] in break_sensor.SCENES


def test_a_mistake_whose_figure_is_gone_stops_the_build_and_says_which_there_are(given, drawn):
    about = pages.texts(given)
    gone = about["mistakes"][0]["figure"]
    with pytest.raises(ValueError, match=f"the figure of the mistake 'lag' must be one of .*; it is '{gone}'"):
        pages.home_page(about, given, {name: each for name, each in drawn.items() if name != gone})


def test_a_mistake_of_metres_costs_what_simulated_tracks_say():
    """Each cost, and the answer's two sigmas, from the errors of many tracks instead of the formula."""
    tracks = break_sensor.walks(20_000, np.random.default_rng(2))
    costs, answer = home.mistakes(), home.choice()
    gap = break_sensor.run(break_sensor.SCENES["gap"], tracks)
    first = max(break_sensor.SCENES["gap"].lost)
    # 20,000 tracks know a standard deviation to 0.5 %; the page prints two digits after the point.
    assert mpt.metrics.rms(gap.kalman[first]) == pytest.approx(float(answer["sigma"]), abs=0.01)
    assert mpt.metrics.rms(gap.constant[first]) == pytest.approx(float(answer["sigma_constant"]), abs=0.02)
    lag = break_sensor.run(break_sensor.SCENES["lag"], tracks)
    assert -lag.kalman[-1].mean() == pytest.approx(float(costs["lag"]["metres"]), rel=0.02)
    lasting = break_sensor.run(break_sensor.SCENES["lasting"], tracks)
    assert mpt.metrics.rms(lasting.kalman[-1]) == pytest.approx(float(costs["lasting"]["metres"]), rel=0.15)
    steady = mpt.SteadyStateFilter.from_kalman(mpt.constant_velocity(dt=1.0, q=0.01, r=0.1))
    truth = mpt.exact_motion(steady.model, x0=[0.0, home.SPEED_2016])
    x, z = mpt.simulate(truth, 12, np.random.default_rng(3), tracks=2_000)
    off = np.abs((steady.filter(z) - x)[:, 0].mean(axis=1))
    assert off.max() == pytest.approx(float(costs["start"]["metres"]), abs=0.5)


def test_the_home_page_says_how_many_could_be_checked_and_how_they_came_out(given, drawn):
    about = pages.home_page(pages.texts(given), given, drawn)["about"]
    counts = [
        sum(each.verdict in some for each in given) for some in (HOLDS, ("holds in part",), ("differs", "erratum"))
    ]
    said = re.search(
        r"of (\d+) numbers.* (\d+) hold, (\d+) hold in part, and (\d+) do not, (\d+) of these in one table.*"
        r" (\d+) more",
        about,
    )
    of_table_4 = sum(each.verdict in FAILS and each.id.startswith("table4.") for each in given.of("2014_gsm_2d"))
    assert list(map(int, said.groups())) == [sum(counts), *counts, of_table_4, len(given) - sum(counts)]
    assert sum(counts) == len(given) - sum(each.verdict == "cannot be checked" for each in given)


def test_outcomes_add_up_to_all_claims_and_values(given):
    for key in keys():
        own = given.of(key)
        came = home.outcomes(own)
        assert sum(each.count for each in came["claims"]) == sum(each.kind == "claim" for each in own)
        assert sum(each.count for each in came["values"]) == sum(each.kind != "claim" for each in own)


def test_the_headline_is_true(by_id):
    """Once started a constant gain is as good as Kalman's; after missing fixes it is not."""
    whole = break_sensor.run(break_sensor.Scene(), break_sensor.walks(2_000, np.random.default_rng(3)))
    settled = break_sensor.settled()
    kalman, constant = (mpt.metrics.rms(each[settled:], axis=1) for each in (whole.kalman, whole.constant))
    np.testing.assert_allclose(constant, kalman, rtol=0.1)
    gap = break_sensor.run(break_sensor.SCENES["gap"], break_sensor.average())
    first = max(break_sensor.SCENES["gap"].lost)
    assert gap.sigma_constant[first] > 3 * gap.sigma[first]


def test_the_table_of_filters_counts_the_operations_of_the_papers(by_id):
    filters = home.choice()
    assert f"{filters['kalman']}" == by_id["2014_gsm_2d", "table3.7"].computed
    assert f"{filters['constant']}" == by_id["2014_gsm_2d", "table3.10"].computed
    # L measurements in one product, on each of two axes: Aᴸ x takes 6 operations, each Aʲ B z 2, each sum of two 2.
    at, before = (2 * (6 + 2 * L + 2 * L) for L in (filters["every"], filters["every"] - 1))
    assert before < filters["fir"] <= at
    fir = break_sensor.filters()[2]
    for distance, near in ((home.near(), True), (home.near() + 20, False)):
        off = distance * abs(fir.taps[:, 0, 0].sum() - 1)
        assert bool(off < 0.1 * home.settled_sigma()) is near


def test_a_corrected_formula_is_what_the_operations_give(given):
    """The formulas of papers.toml, which no verdict holds: against the operations counted one by one."""
    corrected = pages.texts(given)["corrected"]["2014_gsm_2d"]
    formulas = {id: each for id, each in corrected.items() if isinstance(each, str)}
    right = {id: re.split("≥|=|for", formulas[id])[0 if id.startswith("mu") else -1] for id in formulas}
    for M in range(1, 30):
        a, b = (count * burden.total(burden.fir(n, m, M)) for count, n, m in ((1, 4, 2), (2, 2, 1)))
        steady = [count * burden.total(burden.steady_state(n, m)) for count, n, m in ((1, 4, 2), (2, 2, 1))]
        assert burden.value(corrected["table5.fir"], n=4, m=2, M=M) == a
        assert burden.value(right["table6.fir.a"], M=M) == a
        assert burden.value(right["table6.fir.b"], M=M) == b
        for id, total, own in (("mu.a", a, steady[0]), ("mu.b", b, steady[1])):
            for side in re.findall(r"\(([^()]*)\)/(\d+)", corrected[id]):
                assert burden.value(side[0], M=M) / int(side[1]) == pytest.approx(total / own), id


def test_the_question_on_table_4_names_the_counts_that_its_causes_name(given):
    """One slip for each of the four counts, said on the page of corrections and in the question."""
    causes = [each for (_, id), each in given.causes.items() if id.startswith("table4-")]
    said = r"fit (\d+) operations\. By Table 2 it takes (\d+)"
    pairs = [re.search(said, each.sentence).groups() for each in causes]
    text = pages.texts(given)["questions"]["2014_gsm_2d"]["table4.1.3"]["text"]
    assert re.findall(r"\b\d{2,4}\b", text) == [number for number, _ in pairs]
    counted = {each.computed for each in given.of("2014_gsm_2d") if each.id.startswith("table3.")}
    assert counted.issuperset(number for _, number in pairs)
    assert len(pairs) == 4


def test_a_cell_that_our_copy_has_lost_shows_what_was_counted_and_why_it_is_lost():
    cause = {("p", "copy"): Cause("copy", "copy", "Our copy has lost a cell.", "Nothing.")}
    gone = verdict("g", "Table 4, row 1", "cannot be checked", "copy", printed="?", computed="0.206")
    unknown = verdict("h", "Table 5, row 1", "cannot be checked", printed="?", computed="-")
    assert corrections.entry(gone, {})[:3] == ("row 1", "[0.206]", "")
    assert corrections.entry(unknown, {})[:3] == ("row 1", "?", "")
    assert corrections.lost(Verdicts([gone, verdict("t")], cause)) == {"Table 4": "Our copy has lost a cell."}
    doubtful = corrections.entry(gone, {"g": corrections.Patch("0.3", "0.2")})
    assert doubtful[:3] == ("row 1", "0.3", "0.2")
    assert doubtful.if_printed


def test_a_page_of_corrections_has_the_tables_whole_and_what_is_wrong_beside_what_is_right():
    cause = {("p", "join"): Cause("join", "slip", "One is missing.", "Count two.")}
    wrong = verdict("t.2", "Table 3, row 2 (B, LF)", "erratum", "join", printed="0.427", computed="0.421707")
    fine = verdict("t.1", "Table 3, row 1 (A, KF)")
    (section,) = corrections.sections(Verdicts([fine, wrong], cause), {})
    ((title, entries, columns),) = section.tables
    assert (title, columns, section.causes) == ("Table 3", 0, [(cause["p", "join"], wrong)])
    assert [(each.label, each.old, each.new) for each in entries] == [
        ("row 1 (A, KF)", "1", ""),
        ("row 2 (B, LF)", "0.427", "0.422"),
    ]
    grid = [verdict(f"g.{i}.{j}", f"Table 4, row {i}, column {j}") for i in (1, 2) for j in (1, 2) if i != j]
    grid[0] = verdict("g.1.2", "Table 4, row 1, column 2", "erratum", "join", printed="2", computed="3")
    ((_, cells, columns),) = corrections.sections(Verdicts(grid, cause), {})[0].tables
    assert ([each and each.new for each in cells], columns) == ([None, "3", "", None], 2)
    other = {("p", "split"): Cause("split", "slip", "One is too many.", "Count one.")}
    more = verdict("t.3", "Table 3, row 3 (B, JKLF)", "erratum", "split", printed="1", computed="2")
    (section,) = corrections.sections(Verdicts([fine, wrong, more], cause | other), {})
    assert [each.id for each, _ in section.causes] == ["join", "split"]
    assert len(section.tables) == 1
    assert corrections.names_of_rows([fine, wrong]) == {1: "A, KF", 2: "B, LF"}


def test_rows_of_one_slip_in_one_table_are_struck_one_by_one():
    cause = {("p", "operands"): Cause("operands", "slip", "Two operands are late.", "Count on.")}
    fails = {"kind": "formula", "cause": "operands"}
    rows = [
        verdict(f"r.{i}", f"Table 2, prediction, row {i}", outcome, printed=printed, **fails)
        for i, (outcome, printed) in enumerate([("holds in part", "A x"), ("erratum", "B y"), ("erratum", "C")], 1)
    ]
    fine = verdict("size", "Table 2, estimation, row 1", kind="formula", printed="n")
    right = {"r.1": "A x(k-1)", "r.2": "B y(k)", "r.3": "C(k)"}
    given = Verdicts([fine, *rows], cause)
    (section,) = corrections.sections(given, corrections.read(given, right))
    ((title, entries, columns),) = section.tables
    assert (title, columns) == ("Table 2", 0)
    assert [each[:3] for each in entries] == [
        ("prediction, row 1", "A x", "A x(k-1)"),
        ("prediction, row 2", "B y", "B y(k)"),
        ("prediction, row 3", "C", "C(k)"),
    ]


def test_a_word_is_struck_where_it_stands_and_under_a_condition_where_it_cannot_be_checked():
    causes = {
        ("p", "count"): Cause("count", "wording", "Two for three.", "Nothing."),
        ("p", "copy"): Cause("copy", "copy", "One letter.", "Nothing."),
    }
    wrong = verdict("b", "Section 5", "erratum", "count", kind="claim", printed="it needs two filters")
    unread = verdict("p", "After Eq. 11", "cannot be checked", "copy", kind="claim", printed="P_k is the noise's")
    fine = verdict("f", kind="claim", printed="one of two")
    lost = verdict("g", "Table 4, row 1", "cannot be checked", "copy", printed="?", computed="0.206")
    given = Verdicts([wrong, unread, fine, lost], causes)
    written = {
        "g": {"printed": "0.3", "right": "0.206"},
        "p": {"printed": "P_k", "right": "R_k"},
        "b": {"before": "it needs", "printed": "two", "right": "three", "after": "filters"},
        "f": {"printed": "two", "right": "three"},
    }
    corrected = corrections.read(given, written)
    assert list(corrected) == ["b", "p", "f", "g"]
    assert corrections.in_text(given, corrected) == [(("two", "three", "it needs", "filters", ""), wrong)]
    assert corrections.if_printed(given, corrected) == [(("P_k", "R_k", "", "", ""), unread)]
    assert corrections.sections(given, corrected) == []


def test_a_correction_that_strikes_what_is_not_printed_or_lacks_a_part_stops_the_build():
    given = Verdicts([verdict("b", "Section 5", kind="claim", printed="it needs two filters")])
    for wrong, said in (
        ({"printed": "four", "right": "three"}, "'b' strikes 'four', not found in 'it needs two filters'"),
        ({"printed": "two"}, "'b' needs printed and right, which differ"),
        ({"printed": "two", "right": "two"}, "'b' needs printed and right, which differ"),
        ({"printed": "two", "right": "three", "because": "so"}, "'b' needs printed and right, which differ"),
    ):
        with pytest.raises(ValueError, match=said):
            corrections.read(given, {"b": wrong})
    with pytest.raises(KeyError, match="gone"):
        corrections.read(given, {"gone": "x"})


def test_a_lost_cell_is_struck_under_a_condition_only_where_its_twin_in_print_is_wrong(given, by_id):
    """Columns 4 and 5 of Table 4 are of filters with as many operations: what is printed in one stands in the other."""
    key = "2014_gsm_2d"
    corrected = corrections.read(given.of(key), pages.texts(given)["corrected"][key])
    lost = [each for each in given.of(key) if re.fullmatch(r"table4\.\d+\.5", each.id) and each.printed == "?"]
    assert lost
    for each in lost:
        twin = by_id[key, f"{each.id[:-1]}4"]
        expected = (twin.printed, corrections.rounded(twin)) if twin.verdict in FAILS else None
        assert (corrected[each.id][:2] if each.id in corrected else None) == expected, each.id


def test_nothing_is_both_asked_and_corrected(given):
    """A conditional correction says what a question would: the reader answers it once."""
    about = pages.texts(given)
    for key in keys():
        corrected = corrections.read(given.of(key), about["corrected"].get(key, {}))
        patched = [id for id, right in corrected.items() if isinstance(right, corrections.Patch)]
        assert not set(patched) & set(about["questions"].get(key, {}))


def test_a_remark_stands_once_with_all_its_claims_and_repeats_no_question_and_no_correction():
    causes = {
        ("p", "join"): Cause("join", "slip", "One is missing.", "Count two."),
        ("p", "late"): Cause("late", "finding", "One step late.", "Mind H."),
    }
    same = [verdict(id, beyond="In metres, a factor of 2.") for id in "ab"]
    asked = verdict("c", beyond="The paper does not say.")
    wrong = verdict("d", "Table 3", "erratum", "join", beyond="Not as in Table 5.")
    part = verdict("e", "Section 5", "holds in part", "late", beyond="Over as many steps, 4.11.")
    found = corrections.remarks(Verdicts([*same, asked, wrong, part, verdict("f")], causes), {"c": "Which?"})
    assert found == [("In metres, a factor of 2.", same), ("Over as many steps, 4.11.", [part])]


def test_the_contents_of_a_page_are_what_it_shows(given):
    """The index counts causes and cells as the sections have them, not findings, which no page shows."""
    about = pages.texts(given)
    for key in keys():
        own, asked = given.of(key), about["questions"].get(key, {})
        corrected = corrections.read(own, about["corrected"].get(key, {}))
        sections = corrections.sections(own, corrected)
        entries = [
            each for section in sections for _, cells, _ in section.tables for each in cells if each and each.new
        ]
        text = corrections.contents(own, corrected, asked)
        cells = sum(map(int, re.findall(r"(\d+) cells?", text)))
        sure = [each for each in entries if not each.if_printed]
        assert cells == len(sure) + len(corrections.in_text(own, corrected))
        causes = {each.cause for each in own if corrections.is_corrected(own, each)}
        assert sum(map(int, re.findall(r"(\d+) (?:slip|wording)", text))) == len(causes)
        doubtful = len(entries) - len(sure) + len(corrections.if_printed(own, corrected))
        assert sum(map(int, re.findall(r"(\d+) corrections? if", text))) == doubtful
        assert sum(map(int, re.findall(r"(\d+) question", text))) == len(asked)
        assert ("no certain correction" in text) is (not causes)
        assert "finding" not in text


def test_what_a_paper_leaves_out_is_asked_or_listed_and_what_our_copy_lost_is_neither():
    lacking = verdict("a", "Section 1", "cannot be checked", reason="how time was measured", printed="more rapid")
    lost = verdict("b", "Figure 1", "cannot be checked", cause="copy", reason="our copy has no pictures")
    wrong, right = verdict("c", verdict="differs", cause="x"), verdict("d")
    unread = verdict("e", verdict="cannot be checked", reason="one letter", printed="P")
    given, asked = [lacking, lost, wrong, right, unread], {"c": "Why?", "d": "When?", "e": "P or R?"}
    first = "Section 1, twice"
    twice = verdict("f", f"{first}; Conclusion")
    made = corrections.questions([*given, twice], asked | {"f": "Both?", "a": {"where": "Section 2", "text": "How?"}})
    assert [(each.text, each.verdict) for each in made[:3]] == [("Why?", wrong), ("When?", right), ("P or R?", unread)]
    assert made[3:] == [("Both?", twice, first), ("How?", lacking, "Section 2")]
    assert corrections.unchecked(given, asked, {}) == [lacking]
    assert corrections.unchecked(given, asked | {"a": "Than what?"}, {}) == []
    assert corrections.unchecked(given, asked, {"a": corrections.Patch("more", "less")}) == []
    with pytest.raises(KeyError):
        corrections.questions([right], {"gone": "Asked of no item."})


def test_every_slip_and_wording_has_its_corrected_text(given):
    """Or the page would show what is wrong without what is right: a claim is never struck, only a word of it."""
    written = pages.texts(given)["corrected"]
    for key in keys():
        own = given.of(key)
        corrected = corrections.read(own, written.get(key, {}))
        shown = {verdict.id for _, verdict in corrections.in_text(own, corrected)}
        for section in corrections.sections(own, corrected):
            entries = [each for _, cells, _ in section.tables for each in cells if each]
            shown |= {each.verdict.id for each in entries if each.new and each.verdict.kind != "claim"}
        assert [each.id for each in own if corrections.is_corrected(own, each) and each.id not in shown] == []


def test_the_archive_is_the_committed_tree_and_the_same_bytes_twice(tmp_path):
    sizes = [pages.write_archive(tmp_path / f"{i}.tar.gz", "mpt_helpers-1") for i in (1, 2)]
    if not sizes[0]:
        pytest.skip("no git repository: nothing is committed")
    assert (tmp_path / "1.tar.gz").read_bytes() == (tmp_path / "2.tar.gz").read_bytes()
    with tarfile.open(tmp_path / "1.tar.gz") as tar:
        names = set(tar.getnames())
    for path in ("mpt_helpers/__init__.py", "reproduction/__init__.py", "notebooks/2014_gsm_2d.ipynb", "Makefile"):
        assert f"mpt_helpers-1/{path}" in names
    assert not [each for each in names if "_build" in each or each.endswith(".tar.gz")]


def test_the_speed_page_has_the_direction_of_the_median_times():
    for row in speed.results()["rows"]:
        if row.get("against_ms"):
            assert speed.times_as_fast(row) == pytest.approx(row["against_ms"] / row["ms"], rel=0.5), row


@pytest.mark.parametrize("module", [corrections, home, pages, speed], ids=lambda module: module.__name__)
def test_the_examples_of_the_modules_print_what_they_say(module):
    assert doctest.testmod(module).failed == 0


def test_what_only_a_checkout_needs_is_left_out_of_the_site():
    page = "Blocks. <!-- checkout -->`make`\nmakes it.<!-- /checkout --> More.<!-- checkout --> Here.<!-- /checkout -->"
    assert pages.CHECKOUT.sub("", page) == "Blocks. More."
    assert len(pages.CHECKOUT.findall((ROOT / "docs" / "guide.md").read_text(encoding="utf-8"))) == 1


def cells():
    picture = {"data": {"image/png": ""}, "metadata": {"image/png": {"alt": "a curve"}}}
    return [
        {"cell_type": "markdown", "id": "title", "metadata": {}, "source": "# Title\n\n**Figure 1.** It falls."},
        {"cell_type": "code", "id": "teach", "metadata": {}, "source": "def step(P):\n    return P", "outputs": []},
        {
            "cell_type": "code",
            "id": "draw",
            "metadata": {"tags": ["hide-input"]},
            "source": 'figures.save_figure(fig, "2014_gsm_2d_fig1")',
            "outputs": [picture],
        },
        {"cell_type": "code", "id": "won", "metadata": {"tags": ["hide-input", "ledger"]}, "source": "", "outputs": []},
    ]


def test_an_article_has_chips_for_the_calls_to_the_ledger_and_the_full_notebook_has_the_calls():
    page = {"top": "TOP", "live": ("2014_gsm_2d_fig1", "LIVE"), "verdicts": lambda cell: f"CHIPS {cell}"}
    for whole, expected in ((False, ["LIVE", "CHIPS won"]), (True, ["won"])):
        made = pages.prepared("2014_gsm_2d", {"cells": cells()}, page, whole)["cells"]
        html = [cell["source"].split("\n")[1] if cell["id"].startswith("html") else cell["id"] for cell in made]
        assert html == ["title", "TOP", "teach", "draw", *expected]
        folded = ["hide-input" in cell["metadata"]["tags"] for cell in made if cell["id"] in ("teach", "draw")]
        assert folded == [False, not whole]
    json.dumps(made)


def test_code_is_open_in_part_one_and_folded_in_part_two_but_for_functions():
    plain = {"cell_type": "code", "id": "plain", "metadata": {}, "source": "x = A @ x", "outputs": []}
    function = plain | {"id": "function", "source": "def step(x):\n    return x"}
    part_2 = {"cell_type": "markdown", "id": "two", "metadata": {}, "source": "## Part II: the evidence"}
    notebook = {"cells": [*cells(), plain, part_2, plain | {"id": "later"}, function]}
    page = {"top": "TOP", "live": ("", "LIVE"), "verdicts": lambda cell: "CHIPS"}
    made = {cell["id"]: cell["metadata"] for cell in pages.prepared("2014_gsm_2d", notebook, page, False)["cells"]}
    of = ("draw", "plain", "later", "function")
    folded = {id: "hide-input" in about["tags"] for id, about in made.items() if id in of}
    assert folded == {"draw": True, "plain": False, "later": True, "function": False}


def test_the_figure_with_sliders_stands_below_its_figure_or_at_the_end_of_part_one():
    markdown = {"cell_type": "markdown", "metadata": {}}
    end = [markdown | {"id": "two", "source": "## Part II: the evidence"}, markdown | {"id": "last", "source": "Text."}]
    page = {"top": "TOP", "live": ("2014_gsm_2d_gone", "LIVE"), "verdicts": lambda cell: "CHIPS"}
    for more, before in ((end, "two"), ([], None)):
        made = pages.prepared("2014_gsm_2d", {"cells": cells() + more}, page, False)["cells"]
        (at,) = (i for i, cell in enumerate(made) if "LIVE" in cell["source"])
        assert [cell["id"] for cell in made[at + 1 :]][:1] == ([before] if before else [])
    made = pages.prepared("2015_mpt_3d", {"cells": cells()}, page, False)["cells"]
    assert not any("LIVE" in cell["source"] for cell in made)


def test_links_of_a_notebook_lead_to_the_pages_of_the_site():
    cell = {"cell_type": "markdown", "id": "end", "metadata": {}}
    text = "[speed](../benchmarks/README.md), [guide](../docs/guide.md#gaps), [2014](2014_gsm_2d.ipynb)"
    page = {"top": "", "live": ("", ""), "verdicts": None}
    first, _ = pages.prepared("2014_gsm_2d", {"cells": [cell | {"source": text}]}, page, False)["cells"]
    assert first["source"] == "[speed](../speed.md), [guide](../guide.md#gaps), [2014](2014_gsm_2d.ipynb)"


def test_links_in_a_checkout_lead_to_what_can_be_read_there():
    """A page of the site that is a template, such as docs/speed.md, says nothing before it is rendered."""

    def shown(path):
        return re.sub(r"(?ms)^ *```.*?^ *```", "", path.read_text(encoding="utf-8"))

    written = [*ROOT.glob("*.md"), *ROOT.glob("[bdnt]*/*.md"), *ROOT.glob("notebooks/*/*.md")]
    templates = [path for path in written if re.search(r"{[{%]", shown(path))]
    texts = {path: shown(path) for path in written if path not in templates}
    for path in NOTEBOOKS:
        texts[path] = prose(cells_of(path))
    linked = {
        (path, target): path.parent / target
        for path, text in texts.items()
        for target in re.findall(r"\]\((?!https?:|#)([^)#\s]+)", text)
    }
    assert ROOT / "docs" / "speed.md" in templates
    assert len(linked) > 10
    for (path, target), file in linked.items():
        assert file.is_file(), f"{path.name}: {target}"
        assert file.resolve() not in templates, f"{path.name}: {target}"


def test_a_caption_is_the_paragraph_with_the_name_of_the_figure():
    (drawn,) = pages.figures_of("2014_gsm_2d", cells())
    assert (drawn.label, drawn.caption, drawn.cell) == ("Figure 1", "**Figure 1.** It falls.", "draw")
    assert drawn.finding == "It falls."


def test_a_figure_without_a_caption_stands_under_the_question_of_its_section():
    own = cells()
    own[2]["source"] = 'figures.save_figure(fig, "2014_gsm_2d_gain")'
    assert pages.figures_of("2014_gsm_2d", own)[0].finding == "Title"
    own[1] = own[0] | {"source": "## 4. How close?\n\nVery."}
    assert pages.figures_of("2014_gsm_2d", own)[0].finding == "How close?"
    own[1] = own[0] | {"source": "## Part II: the evidence\n\n### 2. How sure?\n\nVery."}
    assert pages.figures_of("2014_gsm_2d", own)[0].finding == "How sure?"


def test_what_a_figure_found_is_its_title_where_it_has_one():
    own = cells()
    drawing = next(each for each in own if each["id"] == "draw")
    drawing["outputs"][0]["data"]["text/plain"] = "a.png\ntext 'It\\nrests'\naxes 1: 'gain' x 'k' linear 0..1"
    assert pages.figures_of("2014_gsm_2d", own)[0].finding == "It rests"
    drawing["outputs"][0]["data"]["text/plain"] = "a.png\naxes 1: 'It falls' x 'k' linear 0..1"
    assert pages.figures_of("2014_gsm_2d", own)[0].finding == "It falls"


def test_no_figure_of_the_articles_has_a_name_or_a_question_for_its_finding(drawn):
    bare = r"(of the paper|figure|what we found|section)\b|.*\?$"
    assert not [each.name for each in drawn.values() if re.match(bare, each.finding, re.IGNORECASE)]


def test_the_conclusion_of_a_figure_is_the_first_sentence_of_its_caption():
    assert pages.conclusion("**Figure 1.** It falls. Then it rests.") == "It falls."
    assert (
        pages.conclusion("**Figure `gain`.** **The gain settles, at 0.5.** What is left shrinks.")
        == "The gain settles, at 0.5."
    )
    assert pages.conclusion("*Left:* a curve.") == ""


def test_two_figures_may_share_a_caption():
    assert pages.names_of("**Figure 1, Figure 2.** Estimates.") == ["Figure 1", "Figure 2"]
    assert pages.names_of("**Figure `burden`.** It falls.") == ["Figure `burden`"]
    assert pages.names_of("Figure 1 falls, **as it should**.") == []


def test_every_class_and_module_of_the_package_has_a_page():
    classes, modules = pages.interface()
    names = [each.name for each in classes]
    assert set(names) == {name for name in mpt.__all__ if isinstance(getattr(mpt, name), type)}
    shown = {each.name for each in modules}
    on_disk = {path.stem for path in (ROOT / "mpt_helpers").glob("[a-z]*.py")}
    assert on_disk - shown == set(pages.NOT_SHOWN)
    for some in (classes, modules):  # on a disk that ignores case each has a file of its own
        assert len({each.name.lower() for each in some}) == len(some)
    assert set(pages.INSIDE) | set(pages.USES) <= shown


def test_the_lines_of_use_run_as_they_stand_import_no_more_than_they_use_and_say_mpt(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(ROOT / "docs" / "tracks" / "ride.gpx", tmp_path)
    classes, modules = pages.interface()
    for each in (*classes, *modules):
        names = {}
        exec(each.use, names)
        (tmp_path / f"{each.path}.py").write_text(each.use, encoding="utf-8")
        own = [each.name]
        if each in modules:
            module = importlib.import_module(each.path)
            own += [name for name, thing in vars(module).items() if getattr(thing, "__module__", "") == each.path]
        assert any(re.search(rf"\b{name}\b", each.use) for name in own), each.path
        assert not set(names) & set(mpt.__all__), each.path  # what the package exports is written `mpt.`
    command = [sys.executable, "-m", "ruff", "check", "--isolated", "--select", "F", "--output-format", "concise", "."]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


def test_a_class_shows_first_what_users_come_for_and_nothing_that_the_engine_asks():
    classes, _ = pages.interface()
    members = {each.name: [name for _, name in each.members] for each in classes}
    assert members["KalmanFilter"][:5] == ["filter", "estimates", "covariances", "smooth", "step"]
    assert members["SteadyStateFilter"][:3] == ["from_kalman", "from_lainiotis", "filter"]
    assert not [name for own in members.values() for name in own if name in pages.FOR_THE_ENGINE]
    told = {name for each in (recursive.Filter, recursive.RecursiveFilter) for name in vars(each)}
    assert set(pages.FOR_THE_ENGINE) <= told  # on the page of that module


def test_the_guide_as_a_notebook_has_its_blocks_what_they_print_and_its_pictures(tmp_path):
    (tmp_path / "guide").mkdir()
    (tmp_path / "guide" / "look.png").write_bytes(b"png")
    text = """\
# Title

![A look.](guide/look.png)

```python
print(1)
fig, ax = draw()
```

```text
1
```

![A look.](guide/look.png)

See [the other](other.md#there), <a href="tracks/ride.gpx" download>ride.gpx</a>.

```sh
ls
```
"""
    install, title, inline, code, rest = pages.guide_as_notebook(text, tmp_path, "mpt-1.tar.gz").cells
    assert "pip install jupyterlab ./mpt-1.tar.gz" in install.source
    assert inline.source == "%matplotlib inline"  # or `fig` would be shown as its name
    assert title.source == "# Title\n\n![A look.](data:image/png;base64,cG5n)"
    assert code.source == "print(1)\nfig, ax = draw()\nfig"  # the last line shows it
    assert (code.outputs[0].text, base64.b64decode(code.outputs[1].data["image/png"])) == ("1\n", b"png")
    assert rest.source == "See the other, ride.gpx.\n\n```sh\nls\n```"
