"""What the site is made of, where no browser is needed."""

import json
import re
from types import SimpleNamespace

import pages
import pytest
from conftest import NOTEBOOKS, ROOT

from mpt_helpers.ledger.verdicts import Verdict


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


def test_a_number_on_the_home_page_that_no_verdict_says_stops_the_build(tmp_path, monkeypatch):
    monkeypatch.setattr(pages, "DOCS", tmp_path)
    given = [verdict("gap", computed="11 steps")]
    said = """[home]\nanswer = "after {{ found('p', 'gap', '11') }} steps, {{ printed('p', 'gap') }}"\n"""
    (tmp_path / "papers.toml").write_text(said)
    assert pages.texts(given)["home"]["answer"] == "after 11 steps, 1"
    (tmp_path / "papers.toml").write_text(said.replace("11", "12"))
    with pytest.raises(ValueError, match="does not say '12'"):
        pages.texts(given)


def test_a_number_from_the_guide_must_stand_there_once():
    assert pages.said("FIR: 3 m at k = 69, 4 m at k = 70", "FIR: ([0-9]+ m) at k = 69") == "3 m"
    for pattern in ("([0-9]+ m) at k = 68", "([0-9]+ m) at k"):
        with pytest.raises(ValueError, match=r"is found [02] times"):
            pages.said("FIR: 3 m at k = 69, 4 m at k = 70", pattern)


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
            "source": 'plots.save_figure(fig, "2014_gsm_2d_fig1")',
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
        assert [cell["metadata"]["folded"] for cell in made if cell["id"] in ("teach", "draw")] == [False, not whole]
    json.dumps(made)


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
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        texts[path] = "\n".join(pages.source(cell) for cell in cells if cell["cell_type"] == "markdown")
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
    assert drawn.heading == "Figure 1"


def test_a_figure_of_our_own_is_listed_under_the_title_of_its_section():
    own = cells()
    own[2]["source"] = 'plots.save_figure(fig, "2014_gsm_2d_gain")'
    assert pages.figures_of("2014_gsm_2d", own)[0].heading == "What we found (figure `gain`)"
    own[1] = own[0] | {"source": "## 4. How close?\n\nVery."}
    assert pages.figures_of("2014_gsm_2d", own)[0].heading == "How close? (figure `gain`)"


def test_two_figures_may_share_a_caption():
    assert pages.names_of("**Figure 1, Figure 2.** Estimates.") == ["Figure 1", "Figure 2"]
    assert pages.names_of("**Figure `burden`.** It falls.") == ["Figure `burden`"]
    assert pages.names_of("Figure 1 falls, **as it should**.") == []


def test_another_file_than_mathjax_is_refused(tmp_path, monkeypatch):
    (tmp_path / "other.js").write_text("alert(1)")
    other = SimpleNamespace(locate_file=lambda name: tmp_path / "other.js")
    monkeypatch.setattr(pages, "distribution", lambda package: other)
    with pytest.raises(ValueError, match=r"is not es5/tex-svg\.js of MathJax"):
        pages.mathjax()
