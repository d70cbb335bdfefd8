"""A table that prints as text and displays as HTML, the same on every run and machine."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

import numpy as np


def cell_text(value: object) -> str:
    """Return a cell as text: at most six significant digits, so that processors agree on it.

    >>> cell_text(1 / 3), cell_text(509), cell_text(2.0), cell_text("KF"), cell_text(True)
    ('0.333333', '509', '2', 'KF', 'yes')
    """
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    if isinstance(value, (float, np.floating)):
        return f"{float(value) + 0.0:.6g}"  # + 0.0 makes 0 of -0
    return str(value)


def gap_text(gap: float, floor: float = 1e-12) -> str:
    """Return a gap as text; a gap at rounding level becomes "below 1e-12", since its digits differ between processors.

    >>> gap_text(3e-16), gap_text(0.0123)
    ('below 1e-12', '1.2e-02')
    """
    return f"below {floor:.0e}" if abs(gap) < floor else f"{gap:.1e}"


def aligned(rows: Iterable[Sequence[str]]) -> list[str]:
    """Return rows of cells as lines in which the cells of a column begin below each other.

    >>> aligned([["filter", "burden"], ["KF", "509"]])
    ['filter  burden', 'KF      509']
    """
    rows = list(rows)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]


def details(summary: str, html: str) -> str:
    """Return HTML that is shown when a reader opens its summary."""
    return f"<details><summary>{escape(summary)}</summary>\n{html}\n</details>"


class Table:
    """A header and rows of cells. Raises ValueError for a row whose length is not that of the header.

    >>> Table(["filter", "burden"], [["KF", 509], ["LF", 670]])
    filter  burden
    KF      509
    LF      670
    """

    def __init__(self, header: Iterable[object], rows: Iterable[Iterable[object]]):
        self.header = [cell_text(cell) for cell in header]
        self.rows = [[cell_text(cell) for cell in row] for row in rows]
        for i, row in enumerate(self.rows):
            if len(row) != len(self.header):
                raise ValueError(f"rows[{i}]: needs {len(self.header)} cells, got {len(row)}")

    def __repr__(self):
        return "\n".join(aligned([self.header, *self.rows]))

    def markdown(self) -> str:
        r"""Return the table in Markdown.

        >>> print(Table(["filter", "burden"], [["a|b", 509]]).markdown())
        | filter | burden |
        |---|---|
        | a\|b | 509 |
        """
        lines = [" | ".join(cell.replace("|", r"\|") for cell in line) for line in (self.header, *self.rows)]
        header, *rows = [f"| {line} |" for line in lines]
        rule = "|" + "---|" * len(self.header)
        return "\n".join([header, rule, *rows])

    def folded(self, summary: str) -> Folded:
        """Return the table to be shown folded under a summary."""
        return Folded(self.header, self.rows, summary)

    def _repr_html_(self):
        def line(cells, tag):
            return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"

        body = "\n".join(line(row, "td") for row in self.rows)
        return f"<table>\n<thead>{line(self.header, 'th')}</thead>\n<tbody>\n{body}\n</tbody>\n</table>"


class Folded(Table):
    """A table that a notebook shows under a line of its own, to be opened."""

    def __init__(self, header: Iterable[object], rows: Iterable[Iterable[object]], summary: str):
        super().__init__(header, rows)
        self.summary = summary

    def _repr_html_(self):
        return details(self.summary, super()._repr_html_())
