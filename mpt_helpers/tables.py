"""A table that prints as text and displays as HTML, the same on every run and machine."""

from dataclasses import dataclass
from html import escape

from . import checks


def cell_text(value):
    """Return a cell as text: at most six significant digits, so that processors agree on it.

    >>> cell_text(1 / 3), cell_text(509), cell_text(2.0), cell_text("KF"), cell_text(True)
    ('0.333333', '509', '2', 'KF', 'yes')
    """
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def gap_text(gap, floor=1e-12):
    """Return a gap as text, and one at rounding level as "below 1e-12": its digits differ between processors.

    >>> gap_text(3e-16), gap_text(0.0123)
    ('below 1e-12', '1.2e-02')
    """
    return f"below {floor:.0e}" if gap < floor else f"{gap:.1e}"


@dataclass(frozen=True)
class Table:
    """A header and rows of cells.

    Raises ValueError for a row whose length is not that of the header.

    >>> Table(["filter", "burden"], [["KF", 509], ["LF", 670]])
    filter  burden
    KF      509
    LF      670
    """

    header: tuple
    rows: tuple

    def __post_init__(self):
        header = tuple(map(cell_text, self.header))
        rows = tuple(tuple(map(cell_text, row)) for row in self.rows)
        for i, row in enumerate(rows):
            if len(row) != len(header):
                checks.refuse(f"rows[{i}]", f"{len(header)} cells", len(row))
        object.__setattr__(self, "header", header)
        object.__setattr__(self, "rows", rows)

    def __repr__(self):
        lines = [self.header, *self.rows]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        return "\n".join("  ".join(map(str.ljust, line, widths)).rstrip() for line in lines)

    def markdown(self):
        r"""Return the table in Markdown.

        >>> print(Table(["filter", "burden"], [["a|b", 509]]).markdown())
        | filter | burden |
        |---|---|
        | a\|b | 509 |
        """
        lines = [
            "| " + " | ".join(cell.replace("|", r"\|") for cell in line) + " |" for line in (self.header, *self.rows)
        ]
        return "\n".join([lines[0], "|" + "---|" * len(self.header), *lines[1:]])

    def _repr_html_(self):
        def line(cells, tag):
            return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"

        body = "\n".join(line(row, "td") for row in self.rows)
        return f"<table>\n<thead>{line(self.header, 'th')}</thead>\n<tbody>\n{body}\n</tbody>\n</table>"
