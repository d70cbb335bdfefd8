"""The words to correct in a paper's text and the questions to its authors: from the ledger and from papers.toml.

Wrong numbers and formulas stand in the tables of the paper's notebook, printed beside computed.
"""

import re
from typing import NamedTuple

from reproduction.ledger.verdicts import CANNOT_BE_CHECKED, FAILS


class Patch(NamedTuple):
    """A printed word, number or letters, and what is right instead; a few words of ours around them say where.

    why is a reason in a sentence, "" where the words around it say enough.
    """

    printed: str
    right: str
    before: str = ""
    after: str = ""
    why: str = ""


class Corrections(NamedTuple):
    """What is proposed to the authors of one paper: Patches of what is wrong, of what our copy leaves open, Questions.

    The Patches stand as [(Patch, verdict)].
    """

    in_text: list
    if_printed: list
    questions: list


class Question(NamedTuple):
    """A question to the authors, the verdict on the item that it is about, and where it stands in the paper."""

    text: str
    verdict: object
    where: str


def place(verdict):
    """Return the table, figure or section of an item, without its row and column."""
    return re.split(r"[,;]", verdict.where)[0]


def read(given, corrected):
    """Return the Patches of papers.toml to one paper, {id: Patch}, in the order of the paper.

    Raises KeyError for an item that is not there, and ValueError for a Patch without what is printed and what is right,
    or that strikes what its item does not print.
    """
    by_id = {each.id: each for each in given}
    found = {}
    for id, right in corrected.items():
        printed = by_id[id].printed
        if not {"printed", "right"} <= set(right) <= set(Patch._fields) or right["printed"] == right["right"]:
            need = f"printed and right, which differ, and of {', '.join(Patch._fields[2:])} what helps"
            raise ValueError(f"docs/papers.toml: the correction of {id!r} needs {need}; got {right!r}")
        if right["printed"] not in printed:
            struck = right["printed"]
            raise ValueError(f"docs/papers.toml: the correction of {id!r} strikes {struck!r}, not found in {printed!r}")
        found[id] = Patch(**right)
    return {each.id: found[each.id] for each in given if each.id in found}


def patched(given, corrected, *verdicts):
    """Return the Patches of items with one of these verdicts, [(Patch, verdict)]."""
    return [(corrected[each.id], each) for each in given if each.id in corrected and each.verdict in verdicts]


def in_text(given, corrected):
    """Return the Patches of what is wrong, [(Patch, verdict)]."""
    return patched(given, corrected, *FAILS)


def if_printed(given, corrected):
    """Return the Patches of what our copy leaves open, [(Patch, verdict)]: right if the page prints what is struck."""
    return patched(given, corrected, CANNOT_BE_CHECKED)


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


def of(given, about, key):
    """Return what is proposed to the authors of a paper, from its verdicts and papers.toml, as Corrections."""
    corrected = read(given, about["corrected"].get(key, {}))
    return Corrections(
        in_text(given, corrected), if_printed(given, corrected), questions(given, about["questions"].get(key, {}))
    )
