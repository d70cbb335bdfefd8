"""The guide's snippets run in order, and print what it says."""

import re

import pages
from conftest import ROOT

GUIDE = (ROOT / "docs" / "guide.md").read_text(encoding="utf-8")


def test_the_snippets_print_what_the_guide_says(tmp_path):
    said = re.findall(r"(?ms)^```text\n(.*?)^```$", GUIDE)
    printed = [text for block, text in pages.run_guide(GUIDE, tmp_path) if not block["name"]]
    assert printed == said
