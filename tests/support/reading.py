"""A committed notebook as its reader has it: its words, its code, and what it shows."""

import re

from conftest import ROOT, cells_of, prose, shown, source


def without_stars(text):
    """A text in one line, without the stars of emphasis."""
    return re.sub(r"\s+", " ", text.replace("*", ""))


class Article:
    """The notebook of a key; `plain` takes the markup from its words, by default only the stars."""

    def __init__(self, key, plain=without_stars):
        self.path = ROOT / "notebooks" / f"{key}.ipynb"
        self.cells = cells_of(self.path)
        self.text = plain(prose(self.cells))

    def says(self, text):
        """Require that the notebook says this; numbers in it are computed by the test."""
        assert re.sub(r"\s+", " ", text) in self.text, text

    def cell(self, id):
        """The cell of an id."""
        (cell,) = (cell for cell in self.cells if cell["id"] == id)
        return cell

    def code_of(self, id):
        """The code of a cell."""
        return source(self.cell(id))

    def printed_by(self, id):
        """What a cell prints or shows as text."""
        return shown(self.cell(id))
