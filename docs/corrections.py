"""The corrections proposed to the authors of one paper: written from the ledger and from papers.toml.

The sections follow the causes of the slips and wordings. A table of the paper in which a number fails stands whole; a
word in the text is struck where it stands. What lies beyond a paper's setting corrects nothing: it has its own page.
"""

import re
from typing import NamedTuple

from reproduction.ledger.verdicts import CANNOT_BE_CHECKED, FAILS, Verdicts, counted

CORRECTED_KINDS = ("slip", "wording")


class Patch(NamedTuple):
    """A printed word, number or letters, and what is right instead; a few words of ours around them say where.

    why is a reason in a sentence, "" where the words around it say enough.
    """

    printed: str
    right: str
    before: str = ""
    after: str = ""
    why: str = ""


class Entry(NamedTuple):
    """One item of a table or text: what it is called, what is printed, what is right ("" where nothing is wrong).

    if_printed is True where our copy has lost the item: old is then what may be printed.
    """

    label: str
    old: str
    new: str
    verdict: object
    if_printed: bool = False


class Question(NamedTuple):
    """A question to the authors, the verdict on the item that it is about, and where it stands in the paper."""

    text: str
    verdict: object
    where: str


class Remark(NamedTuple):
    """What was found beyond a paper's setting, and the verdicts about which it says so."""

    text: str
    verdicts: list


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
    """Return a computed number with as many decimals as the paper prints.

    >>> from types import SimpleNamespace
    >>> rounded(SimpleNamespace(printed="0.427", computed="0.421707"))
    '0.422'
    """
    decimals = len(verdict.printed.partition(".")[2])
    return f"{float(verdict.computed):.{decimals}f}"


def read(given, corrected):
    """Return the corrections of papers.toml to one paper, {id: text or Patch}, in the order of the paper.

    Raises KeyError for an item that is not there, and ValueError for a Patch without what is printed and what is right,
    or that strikes what its item does not print.
    """
    by_id = {each.id: each for each in given}
    found = {}
    for id, right in corrected.items():
        printed = by_id[id].printed
        if isinstance(right, str):
            found[id] = right
            continue
        if not {"printed", "right"} <= set(right) <= set(Patch._fields) or right["printed"] == right["right"]:
            need = f"printed and right, which differ, and of {', '.join(Patch._fields[2:])} what helps"
            raise ValueError(f"docs/papers.toml: the correction of {id!r} needs {need}; got {right!r}")
        if printed != "?" and right["printed"] not in printed:
            struck = right["printed"]
            raise ValueError(f"docs/papers.toml: the correction of {id!r} strikes {struck!r}, not found in {printed!r}")
        found[id] = Patch(**right)
    return {each.id: found[each.id] for each in given if each.id in found}


def patched(given, corrected, *verdicts):
    """Return the Patches of items with one of these verdicts, [(Patch, verdict)]."""
    with_patch = [each for each in given if isinstance(corrected.get(each.id), Patch)]
    return [(corrected[each.id], each) for each in with_patch if each.verdict in verdicts]


def in_text(given, corrected):
    """Return the Patches of what is wrong, [(Patch, verdict)]."""
    return patched(given, corrected, *FAILS)


def if_printed(given, corrected):
    """Return the Patches of what our copy leaves open, [(Patch, verdict)]: right if the page prints what is struck.

    A lost cell of a table is none of them: it stands in its table.
    """
    return [(patch, each) for patch, each in patched(given, corrected, CANNOT_BE_CHECKED) if each.printed != "?"]


def cells_if_printed(given, corrected):
    """Return how many lost cells of tables are corrected under that condition."""
    return sum(each.printed == "?" for _, each in patched(given, corrected, CANNOT_BE_CHECKED))


def entry(verdict, corrected):
    """Return an item of a table as an Entry; corrected maps ids to what is right, as `read` returns it."""
    right = corrected.get(verdict.id, "")
    if verdict.verdict == CANNOT_BE_CHECKED and isinstance(right, Patch):
        return Entry(label(verdict), right.printed, right.right, verdict, if_printed=True)
    if verdict.verdict == CANNOT_BE_CHECKED and verdict.computed != "-":
        return Entry(label(verdict), f"[{verdict.computed}]", "", verdict)  # not in our copy, but counted
    if verdict.verdict not in FAILS:
        return Entry(label(verdict), verdict.printed, "", verdict)
    return Entry(label(verdict), verdict.printed, rounded(verdict) if verdict.kind == "number" else right, verdict)


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


def is_corrected(given, verdict):
    """Say whether an item is wrong by a slip or a wording."""
    cause = given.causes.get((verdict.paper, verdict.cause))
    return verdict.verdict in FAILS and cause is not None and cause.kind in CORRECTED_KINDS


def sections(given, corrected):
    """Return the corrections to a paper as Sections: slips before wordings, causes that share a table together.

    What a Patch corrects stands in no table.
    """
    apart = {verdict.id for _, verdict in in_text(given, corrected)}
    failing = {}
    for each in given:
        if is_corrected(given, each) and each.id not in apart:
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
    """Return the questions to the authors as Questions; asked maps ids to questions, as in papers.toml.

    One that is a text stands where its item does first; one that is {where, text} is about more or less than its item.
    """
    by_id = {each.id: each for each in given}
    made = []
    for id, question in asked.items():
        verdict = by_id[id]
        if isinstance(question, str):
            made.append(Question(question, verdict, verdict.where.split(";")[0]))
        else:
            made.append(Question(question["text"], verdict, question["where"]))
    return made


def unchecked(given, asked, corrected):
    """Return the verdicts on what the paper leaves out, and that no question and no conditional correction is about."""
    lacking = [each for each in given if each.verdict == CANNOT_BE_CHECKED and not each.cause]
    return [each for each in lacking if each.id not in asked and not isinstance(corrected.get(each.id), Patch)]


def remarks(given, asked):
    """Return what was found beyond the paper's setting as Remarks: each once, none on what is asked or corrected."""
    about = {}
    for each in given:
        if each.beyond and each.id not in asked and not is_corrected(given, each):
            about.setdefault(each.beyond, []).append(each)
    return [Remark(text, verdicts) for text, verdicts in about.items()]


def contents(given, corrected, asked):
    """Return what a page of corrections shows, counted in words.

    >>> contents(Verdicts([]), {}, {"a": "Why?"})
    'no certain correction, 1 question'
    """
    tally = Verdicts([each for each in given if is_corrected(given, each)], given.causes).tally()
    texts = [tally.cause_text(kind) for kind in CORRECTED_KINDS if tally.causes[kind]] or ["no certain correction"]
    doubtful = patched(given, corrected, CANNOT_BE_CHECKED)
    if doubtful:
        texts.append(f"{counted(len(doubtful), 'correction')} if it is so printed")
    if asked:
        texts.append(counted(len(asked), "question"))
    return ", ".join(texts)
