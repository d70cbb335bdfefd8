"""The guide's snippets run in order, and print what it says."""

import re

from conftest import ROOT

BLOCKS = re.findall(r"(?ms)^```(\w+)\n(.*?)^```$", (ROOT / "docs" / "guide.md").read_text(encoding="utf-8"))


def test_the_snippets_print_what_the_guide_says(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (track,) = (text for kind, text in BLOCKS if kind == "none")
    (tmp_path / "track.csv").write_text(track)
    snippets = [text for kind, text in BLOCKS if kind == "python"]
    printed = [text for kind, text in BLOCKS if kind == "text"]
    names = {}
    for snippet, expected in zip(snippets, printed, strict=True):
        exec(snippet, names)
        assert capsys.readouterr().out == expected, snippet
