"""The corrections to one paper, as its authors could submit them: written from the ledger.

The sections follow the causes of the slips and wordings. A table of the paper in which a number fails stands whole.
"""

import re
from typing import NamedTuple

from reproduction.ledger.verdicts import CANNOT_BE_CHECKED, FAILS

CORRECTED_KINDS = ("slip", "wording")


class Entry(NamedTuple):
    """One item of a table or text: what it is called, what is printed, what is right ("" where nothing is wrong)."""

    label: str
    old: str
    new: str
    verdict: object


class Section(NamedTuple):
    """Corrections that share their tables: the causes, each with a verdict that it explains, and the tables.

    A table is (title, entries, columns): columns is 0 for a list of entries and the number of columns for a grid, whose
    empty cells are None.
    """

    causes: list
    tables: list


def place(verdict):
    """Return the table, figure or section of an item, without its row and column."""
    return re.split(r"[,;]", verdict.where)[0]


def label(verdict):
    """Return where an item stands in its table, or where it stands at all."""
    return verdict.where.partition(", ")[2] or verdict.where


def rounded(verdict):
    """Return a computed number with as many decimals as the paper prints, or the corrected text in words.

    >>> from types import SimpleNamespace
    >>> rounded(SimpleNamespace(printed="0.427", computed="0.421707"))
    '0.422'
    """
    decimals = len(verdict.printed.partition(".")[2])
    return f"{float(verdict.computed):.{decimals}f}"


def entry(verdict, corrected):
    """Return an item as an Entry; corrected maps ids of formulas and claims to what is right."""
    if verdict.verdict == CANNOT_BE_CHECKED and verdict.computed != "-":
        return Entry(label(verdict), f"[{verdict.computed}]", "", verdict)  # not in our copy, but counted
    if verdict.verdict not in FAILS:
        return Entry(label(verdict), verdict.printed, "", verdict)
    new = rounded(verdict) if verdict.kind == "number" else corrected.get(verdict.id, "")
    return Entry(label(verdict), verdict.printed, new, verdict)


GRID = re.compile(r"row (\d+), column (\d+)")
NAMED_ROW = re.compile(r"row (\d+) \(([^)]*)\)")


def names_of_rows(given):
    """Return the names of the paper's numbered rows, {1: "A, KF"}, wherever it gives one."""
    found = [NAMED_ROW.search(each.where) for each in given]
    return {int(match[1]): match[2] for match in found if match}


def grid(members, corrected):
    """Return the entries of a table of rows and columns, row by row with None where a cell is empty, and its width."""
    cells = {tuple(map(int, GRID.search(each.where).groups())): entry(each, corrected) for each in members}
    rows, columns = (max(each[i] for each in cells) for i in (0, 1))
    return [cells.get((row, column)) for row in range(1, rows + 1) for column in range(1, columns + 1)], columns


def sections(given, corrected):
    """Return the corrections to a paper as Sections: slips before wordings, causes that share a table together."""
    failing = {}
    for each in given:
        cause = given.causes.get((each.paper, each.cause))
        if each.verdict in FAILS and cause and cause.kind in CORRECTED_KINDS:
            failing.setdefault(each.cause, []).append(each)
    together = []  # (causes, items), of causes whose items share a place
    for id, members in failing.items():
        cause = given.causes[members[0].paper, id]
        shared = [each for each in together if {place(item) for item in each[1]} & {place(item) for item in members}]
        together = [each for each in together if each not in shared]
        causes = [pair for each in shared for pair in each[0]] + [(cause, members[0])]
        together.append((causes, [item for each in shared for item in each[1]] + members))
    made = [Section(causes, tables(given, items, corrected)) for causes, items in together]
    return sorted(made, key=lambda section: CORRECTED_KINDS.index(section.causes[0][0].kind))


def tables(given, failing, corrected):
    """Return the tables of the paper in which some items fail, whole if there are numbers among them."""
    made = []
    for title in dict.fromkeys(map(place, failing)):
        own = [each for each in failing if place(each) == title]
        whole = [each for each in given if place(each) == title]
        if all(GRID.search(each.where) for each in whole):
            made.append((title, *grid(whole, corrected)))
        elif any(each.kind == "number" for each in own):
            made.append((title, [entry(each, corrected) for each in whole], 0))
        else:
            made.append((title, [entry(each, corrected) for each in own], 0))
    return made


def lost(given):
    """Return a sentence on the cells of each table that our copy has lost, {title: sentence of the cause}."""
    causes = {place(each): given.causes.get((each.paper, each.cause)) for each in given if each.printed == "?"}
    return {title: cause.sentence for title, cause in causes.items() if cause}


def questions(given, asked):
    """Return the open questions, [(question, verdict)]: those asked of items, and those that the paper leaves open."""
    by_id = {each.id: each for each in given}
    open_questions = [(text, by_id[id]) for id, text in asked.items()]
    lacking = [each for each in given if each.verdict == CANNOT_BE_CHECKED and not each.cause and each.id not in asked]
    return open_questions + [(f"{each.printed}. Left open: {each.reason}.", each) for each in lacking]
