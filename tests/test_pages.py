"""What the site says is what the notebooks say: the parts that need no browser."""

import re
from html import unescape

import pages
import pytest
from conftest import NOTEBOOKS

from mpt_helpers.published import Verdicts, stored_verdicts

GIVEN = Verdicts(each for path in NOTEBOOKS for each in stored_verdicts(path))
TITLES = {path.stem: path.stem for path in NOTEBOOKS}


def test_the_home_page_has_every_erratum_in_one_line_of_its_kind():
    lines = re.findall(r"<li>(.*?)</li>", pages.errata_html(GIVEN, TITLES))
    counts = [int(number[1]) if (number := re.search(r"\((\d+) items\)", line)) else 1 for line in lines]
    errata = [each for each in GIVEN if each.verdict == "erratum"]
    assert sum(counts) == len(errata)
    assert len(lines) < 30  # one screen
    table_4 = [each for each in errata if each.paper == "2014_gsm_2d" and each.id.startswith("table4.")]
    assert max(counts) == len(table_4)
    for line in lines:
        assert re.search(r'href="notebooks/\w+\.html#cell-', line), line


def test_the_values_page_has_a_row_for_each_item_with_its_text():
    rows = re.findall(r'<tr id="([^"]*)"(.*?)</tr>', pages.values_html(GIVEN))
    assert [id for id, _ in rows] == [f"{each.paper}.{each.id}" for each in GIVEN]
    for each, (_, row) in zip(GIVEN, rows, strict=True):
        text = unescape(re.sub(r"<[^>]*>", " ", row))
        for part in (each.paper, each.where, each.printed, each.computed, each.verdict, each.reason):
            assert part in text
        assert f'href="notebooks/{each.paper}.html#cell-{each.cell}"' in row


def test_what_is_printed_cannot_become_markup():
    (first, *_) = GIVEN
    odd = type(first)(**{**first.__dict__, "printed": "a < b & <script>"})
    assert "<script>" not in pages.values_html([odd])
    assert "a &lt; b &amp; &lt;script&gt;" in pages.values_html([odd])


def test_another_file_than_mathjax_is_refused(tmp_path, monkeypatch):
    class Other:
        def locate_file(self, name):
            return tmp_path / "other.js"

    (tmp_path / "other.js").write_text("alert(1)")
    monkeypatch.setattr(pages, "distribution", lambda package: Other())
    with pytest.raises(ValueError, match=r"is not es5/tex-svg\.js of MathJax"):
        pages.mathjax()


def test_a_caption_says_what_to_see_also_where_that_stands_below():
    image = [{"data": {"image/png": ""}, "metadata": {"image/png": {"alt": "a curve"}}}]
    cells = [
        {"cell_type": "markdown", "source": "**Figure 1.** The gain."},
        {"cell_type": "code", "id": "draw", "source": 'mpt.save_figure(fig, "p_fig1")', "outputs": image},
        {"cell_type": "markdown", "source": "*What to see:* it settles.\n\nMore."},
    ]
    seen = "The gain. *What to see:* it settles."
    assert pages.figures_of("p", cells) == [("p_fig1", "Figure 1", seen, "draw", "a curve")]
    with pytest.raises(ValueError, match=r"p_fig1: needs one paragraph that begins with \*\*Figure 1"):
        pages.figures_of("p", cells[1:])
