"""What a cell of a notebook shows of its paper: tables with what is printed beside what is right."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from html import escape

from .tables import aligned, details
from .verdicts import CANNOT_BE_CHECKED, FAILS, HOLDS, IN_PART, Verdict, Verdicts

ITEM = re.compile(r"\{([^{}]+)\}")
WRONG_STYLE = "background:#fbe0d2"  # beside a sign: GitHub shows no colours
LEFT = "text-align:left"
SHORT = 12  # letters of a place such as "Eq. 12" that is not broken


def mark(verdict: str) -> str:
    """Return the sign of a verdict: colours do not show everywhere."""
    if verdict in HOLDS:
        return "✓"
    return {IN_PART: "(✓)", CANNOT_BE_CHECKED: "?"}.get(verdict, "✗")


@dataclass(frozen=True)
class Layout:
    """A table as the paper lays it out; `{id}` stands for an item, all else is text.

    A grid has too many cells, or too long ones, to stand on one line: its texts stand one below the other.
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
        found = [ITEM.fullmatch(cell) for row in self.rows for cell in row]
        return list(dict.fromkeys(item[1] for item in found if item))

    @property
    def name(self) -> str:
        """The paper's name of the table: the title up to a colon."""
        return self.title.partition(":")[0]


@dataclass(frozen=True)
class Cell:
    """A cell of a table: its text, the same in HTML, and whether it is wrong."""

    text: str
    html: str = ""
    wrong: bool = False

    def tag(self, name: str, style: str = "") -> str:
        """Return the cell in HTML, as a td or th."""
        styles = "; ".join(each for each in (style, WRONG_STYLE if self.wrong else "") if each)
        return f"<{name}{f' style={styles!r}' if styles else ''}>{self.html or escape(self.text)}</{name}>"


class Grid:
    """Cells under a header, with a caption; a text stands for the Cell of that text.

    Notebooks align tables at the right; a table of sentences is aligned at the left.
    """

    def __init__(
        self,
        head: Iterable[Cell | str],
        rows: Iterable[Iterable[Cell | str]],
        caption: str = "",
        sentences: bool = False,
    ):
        self.lines = [[cell if isinstance(cell, Cell) else Cell(str(cell)) for cell in line] for line in (head, *rows)]
        self.caption, self.style = caption, LEFT if sentences else ""

    def __repr__(self):
        lines = aligned([[cell.text for cell in line] for line in self.lines])
        return "\n".join([self.caption, *lines] if self.caption else lines)

    def html(self) -> str:
        """Return the table in HTML."""
        caption = f'<caption style="{LEFT}">{escape(self.caption)}</caption>\n' if self.caption else ""
        head, *rows = self.lines
        heads = "".join(cell.tag("th", self.style) for cell in head)
        body = "\n".join(f"<tr>{''.join(cell.tag('td', self.style) for cell in row)}</tr>" for row in rows)
        return f"<table>\n{caption}<thead><tr>{heads}</tr></thead>\n<tbody>\n{body}\n</tbody>\n</table>"


def laid_out(layout: Layout, cells: Mapping[str, Cell], extra: Mapping[str, Iterable] | None = None) -> list[list]:
    """Return the lines of a table, its head first, with a Cell for each item; extra has columns for the right."""
    extra = extra or {}
    columns = zip(*extra.values(), strict=True) if extra else [()] * len(layout.rows)
    lines = [[*layout.head, *extra]]
    for row, more in zip(layout.rows, columns, strict=True):
        found = [ITEM.fullmatch(cell) for cell in row]
        lines.append([*(cells[item[1]] if item else cell for item, cell in zip(found, row, strict=True)), *more])
    if layout.grid:  # names of rows break nowhere, those of columns behind their number
        lines[0] = [_unbroken(name, "<br>") for name in lines[0]]
        for line in lines[1:]:
            if isinstance(line[0], str):  # else it is an item
                line[0] = _unbroken(line[0], "&nbsp;")
    return lines


def _unbroken(name, break_):
    number, _, rest = escape(name).partition(" ")
    return Cell(name, f"{number}{break_}{rest.replace(' ', '&nbsp;')}")


def beside(given: Verdict, right: str, grid: bool) -> Cell:
    """Return a cell with what is printed, and what is right: once, where both agree to the digit.

    >>> beside(Verdict("p", "t", "Table 3", "number", "326", "336", "erratum", "", "arithmetic", "join"), "336", False)
    Cell(text='326 | 336 ✗', html='<s>326</s> | <b>336</b>&nbsp;✗', wrong=True)
    """
    printed, bar = given.printed, "<br>" if grid else " | "
    old, new = escape(printed), escape(right)
    if given.verdict in FAILS:
        sign = mark(given.verdict)
        return Cell(f"{printed} | {right} {sign}", f"<s>{old}</s>{bar}<b>{new}</b>&nbsp;{sign}", wrong=True)
    if given.verdict == CANNOT_BE_CHECKED:
        known = "" if printed == "?" else f"{printed} "
        return Cell(f"{known}? | {right}" if right else f"{known}?", f"{escape(known)}?{bar if right else ''}{new}")
    if right == printed:
        return Cell(printed)
    return Cell(f"{printed} | {right}")


def place(given: Verdict) -> Cell:
    """Return where an item stands, with the sign of its verdict.

    >>> place(Verdict("p", "t", "Eq. 4", "formula", "A = B", "gap 0", "reproduced", "", "identity", ""))
    Cell(text='✓ Eq. 4', html='✓&nbsp;Eq.&nbsp;4', wrong=False)
    """
    where = escape(given.where)
    if len(given.where) <= SHORT:
        where = where.replace(" ", "&nbsp;")
    return Cell(f"{mark(given.verdict)} {given.where}", f"{mark(given.verdict)}&nbsp;{where}")


def shortened(text: str, most: int = 60) -> str:
    """Return the beginning of a text, whole words, if it is long."""
    return text if len(text) <= most else text[: most - 1].rsplit(" ", 1)[0] + " ..."


class Shown(Verdicts):
    """Verdicts that a cell shows as a table with sentences below, and stores for machines as Verdicts do.

    If a text stands for `folded`, HTML shows it in their place until a reader opens it.
    """

    def __init__(self, verdicts, causes, grid: Grid, told: Iterable[str] = (), folded: str = ""):
        super().__init__(verdicts, causes)
        self.grid, self.told, self.folded = grid, list(told), folded

    def __repr__(self):
        return "\n".join([repr(self.grid), *self.told])

    def html(self) -> str:
        """Return the table and the sentences in HTML."""
        html = self.grid.html() + "".join(f"\n<p>{escape(text)}</p>" for text in self.told)
        return details(self.folded, html) if self.folded else html
