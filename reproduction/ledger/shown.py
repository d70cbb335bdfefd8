"""What a notebook shows of a paper: its tables, printed beside computed, its sentences, and the contents."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from html import escape

from .verdicts import CANNOT_BE_CHECKED, FAILS, HOLDS, IN_PART, MIME, Verdict, Verdicts

ITEM = re.compile(r"\{([^{}]+)\}")
WRONG_STYLE = "background:#fbe0d2"
LEGEND = "printed | computed; ✗ wrong; ? lost in our copy"


def mark(verdict: str) -> str:
    """Return how a verdict is marked beside what it is about: by a sign, since colours do not show everywhere."""
    if verdict in HOLDS:
        return "✓"
    return {IN_PART: "(✓)", CANNOT_BE_CHECKED: "?"}.get(verdict, "✗")


@dataclass(frozen=True)
class Layout:
    """A table as the paper lays it out; `{id}` stands for an item, all else is text.

    A grid has too many cells to print both numbers in each: one number then means that printed and computed agree.
    wrong says in a sentence what is wrong, in place of one for each cause.
    """

    id: str
    title: str
    head: list
    rows: list
    grid: bool = False
    wrong: str = ""

    @property
    def ids(self) -> list[str]:
        """The items in the rows, in the order in which they are read."""
        return list(dict.fromkeys(found for row in self.rows for cell in row for found in ITEM.findall(cell)))


@dataclass(frozen=True)
class Row:
    """A line of the table of contents: a heading of the notebook, and the items of the ledger that it is about."""

    heading: str
    ids: list
    shows: str
    why: str = ""
    holds: str = ""

    @property
    def name(self) -> str:
        """What the line is called: the heading up to a colon."""
        return self.heading.partition(":")[0]


class Grid:
    """Cells as text and as HTML, under a header; a cell is a text or (text, html, whether it is wrong)."""

    def __init__(self, head: Iterable, rows: Iterable[Iterable], caption: str = ""):
        self.head = [_cell(each) for each in head]
        self.rows = [[_cell(each) for each in row] for row in rows]
        self.caption = caption

    def __repr__(self):
        lines = [[text for text, _, _ in row] for row in (self.head, *self.rows)]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        padded = ["  ".join(map(str.ljust, line, widths)).rstrip() for line in lines]
        return "\n".join([*([self.caption] if self.caption else []), *padded])

    def html(self) -> str:
        """Return the table in HTML."""
        caption = f"<caption>{escape(self.caption)}</caption>\n" if self.caption else ""
        head = "".join(f"<th>{html}</th>" for _, html, _ in self.head)
        body = "\n".join(f"<tr>{''.join(map(_td, row))}</tr>" for row in self.rows)
        return f"<table>\n{caption}<thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody>\n</table>"


def name_of_line(text: str, line: str = "&nbsp;") -> tuple[str, str, bool]:
    """Return the name of a row or column of a grid, which breaks nowhere or behind its number."""
    number, _, name = escape(text).partition(" ")
    return text, f"{number}{line}{name.replace(' ', '&nbsp;')}", False


def _cell(cell):
    return cell if isinstance(cell, tuple) else (str(cell), escape(str(cell)), False)


def _td(cell):
    _, html, wrong = cell
    return f'<td style="{WRONG_STYLE}">{html}</td>' if wrong else f"<td>{html}</td>"


def beside(given: Verdict, right: str, grid: bool) -> tuple[str, str, bool]:
    """Return a cell with what is printed and what is right.

    >>> beside(Verdict("p", "t", "Table 3", "number", "326", "336", "erratum", "", "arithmetic", "join"), "336", False)
    ('326 | 336 ✗', '<s>326</s> | <b>336</b>&nbsp;✗', True)
    """
    old, new = escape(given.printed), escape(right)
    if given.verdict in FAILS:
        line = "<br>" if grid else " | "
        return f"{given.printed} | {right} ✗", f"<s>{old}</s>{line}<b>{new}</b>&nbsp;✗", True
    if given.verdict == CANNOT_BE_CHECKED:
        return f"? | {right}", f"?{'<br>' if grid else ' | '}{new}", False
    if grid:
        return given.printed, old, False
    same = right if right != given.printed or given.kind == "number" else "the same"
    return f"{given.printed} | {same}", f"{old} | {escape(same)}", False


class Shown(Verdicts):
    """Verdicts that a cell shows as a table with sentences below, and stores for machines as Verdicts do."""

    def __init__(self, verdicts, causes, grid: Grid, said: Iterable[str] = ()):
        super().__init__(verdicts, causes)
        self.grid, self.said = grid, list(said)

    def __repr__(self):
        return "\n".join([repr(self.grid), *self.said])

    def _repr_mimebundle_(self, include=None, exclude=None):
        records = self.records()
        for record in records:
            del record["cell"]
        html = self.grid.html() + "".join(f"\n<p>{escape(text)}</p>" for text in self.said)
        return {"text/plain": repr(self), "text/html": html, MIME: records}


def in_words(row: Row, verdicts: Iterable[Verdict]) -> str:
    """Return the verdict on a line of the contents in a few words."""
    given = [each for each in verdicts if any(each.id == id or each.id.startswith(f"{id}.") for id in row.ids)]
    lost = [each for each in given if each.verdict == CANNOT_BE_CHECKED]
    fail = [each for each in given if each.verdict in FAILS]
    checked = len(given) - len(lost)
    if lost and all(each.kind == "figure" for each in given):
        return "picture lost in our copy; redrawn"
    if not fail:
        said = row.holds or f"all {checked}"
    else:
        said = f"✗ {len(fail)} of {checked} wrong" + (f": {row.why}" if row.why else "")
    return said + (f"; {len(lost)} lost in our copy" if lost else "")


def contents(rows: Iterable[Row], verdicts: Iterable[Verdict]) -> str:
    """Return the table of contents in Markdown: what stands where, what it shows, and the verdict in a few words."""
    lines = ["| in the paper | what it shows | does it hold? |", "|---|---|---|"]
    for row in rows:
        link = row.heading.replace(" ", "-")
        lines.append(f"| [{row.name}](#{link}) | {row.shows} | {in_words(row, verdicts)} |")
    return "\n".join(lines)
