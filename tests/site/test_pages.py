"""What the site is made of, where no browser is needed."""

import base64
import doctest
import inspect
import re
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
from reproduction.ledger import Verdicts, keys, stored_verdicts
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


def test_indices_are_lowered_powers_raised_and_names_left_alone():
    html = pages.typeset("H_kP_k < A^(ν-1), σ²_r, A_KF, line_sigma, x_max")
    expected = "H<sub>k</sub>P<sub>k</sub> &lt; A<sup>ν-1</sup>, σ²<sub>r</sub>, A<sub>KF</sub>, line_sigma, x_max"
    assert html == expected


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


def test_the_home_page_says_how_many_could_be_checked_and_how_they_came_out(given):
    about = pages.home_page(pages.texts(given), given)["about"]
    counts = [
        sum(each.verdict in some for each in given) for some in (HOLDS, ("holds in part",), ("differs", "erratum"))
    ]
    checked = (
        r"of (\d+) numbers, [\w, ]+ that we could check (\d+) \[hold\]\(#trust\), (\d+) hold in part, and (\d+) fail"
    )
    said = re.search(rf"{checked}. Of the \d+, (\d+) are speedups in", about)
    of_table_4 = sum(each.verdict in FAILS and each.id.startswith("table4.") for each in given.of("2014_gsm_2d"))
    assert list(map(int, said.groups())) == [sum(counts), *counts, of_table_4]
    assert sum(counts) == len(given) - sum(each.verdict == "cannot be checked" for each in given)


def test_outcomes_add_up_to_all_verdicts(given):
    for key in keys():
        own = given.of(key)
        assert sum(each.count for each in home.outcomes(own)) == len(own)


def test_the_headline_is_true(by_id):
    """Once started a constant gain is as good as Kalman's; after missing fixes it is not."""
    whole = break_sensor.run(break_sensor.Scene(), break_sensor.walks(2_000, np.random.default_rng(3)))
    settled = break_sensor.settled()
    kalman, constant = (mpt.metrics.rms(each[settled:], axis=1) for each in (whole.kalman, whole.constant))
    np.testing.assert_allclose(constant, kalman, rtol=0.1)
    gap = break_sensor.run(break_sensor.SCENES["gap"], break_sensor.average())
    first = max(break_sensor.SCENES["gap"].lost)
    assert gap.sigma_constant[first] > 3 * gap.sigma[first]


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


def test_nothing_is_both_asked_and_corrected(given):
    """A conditional correction says what a question would: the reader answers it once."""
    about = pages.texts(given)
    for key in keys():
        corrected = corrections.read(given.of(key), about["corrected"].get(key, {}))
        patched = [id for id, right in corrected.items() if isinstance(right, corrections.Patch)]
        assert not set(patched) & set(about["questions"].get(key, {}))


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


def test_links_of_a_notebook_lead_to_the_pages_of_the_site():
    cell = {"cell_type": "markdown", "id": "end", "metadata": {}}
    text = "[speed](../benchmarks/README.md), [guide](../docs/guide.md#gaps), [4](#Table-4), [2014](2014_gsm_2d.ipynb)"
    first, top = pages.prepared({"cells": [cell | {"source": text}]}, [], "<p>top</p>")["cells"]
    said = "[speed](../speed.md), [guide](../guide.md#gaps), [4](#table-4), [2014](2014_gsm_2d.ipynb)"
    assert first["source"] == said
    assert "<p>top</p>" in top["source"]


def test_links_in_a_checkout_lead_to_what_can_be_read_there():
    """A page of the site that is a template, such as docs/speed.md, says nothing before it is rendered."""

    def shown(path):
        return re.sub(r"(?ms)^ *```.*?^ *```", "", path.read_text(encoding="utf-8"))

    written = [*ROOT.glob("*.md"), *ROOT.glob("[bdnrt]*/*.md"), *ROOT.glob("notebooks/*/*.md")]
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
        assert file.exists(), f"{path.name}: {target}"
        assert file.resolve() not in templates, f"{path.name}: {target}"


def test_a_caption_is_the_paragraph_with_the_name_of_the_figure():
    (drawn,) = pages.figures_of("2014_gsm_2d", cells())
    assert (drawn.label, drawn.caption, drawn.cell) == ("Figure 1", "**Figure 1.** It falls.", "draw")
    assert drawn.finding == "It falls."


def test_a_link_of_a_caption_to_its_page_leads_there_from_the_page_of_figures():
    own = cells()
    for each in own:
        each["source"] = each["source"].replace("It falls.", "It falls ([below](#Table-4)).")
    (drawn,) = pages.figures_of("2014_gsm_2d", own)
    assert drawn.caption == "**Figure 1.** It falls ([below](notebooks/2014_gsm_2d.ipynb#table-4))."


def test_a_figure_without_a_caption_stands_under_the_question_of_its_section():
    own = cells()
    own[2]["source"] = 'figures.save_figure(fig, "2014_gsm_2d_late")'
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


def test_every_class_and_function_of_the_package_and_every_module_for_users_has_a_page():
    names = [name for _, some in pages.interface() for name in some]
    modules = [name for name in mpt.__all__ if inspect.ismodule(getattr(mpt, name))]
    assert sorted([*names, *modules]) == sorted(mpt.__all__)
    shown = pages.public_modules()
    assert {f"mpt_helpers.{name}" for name in modules} <= set(shown)
    for some in (names, shown):  # on a disk that ignores case each has a file of its own
        assert len({name.lower() for name in some}) == len(some)


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
