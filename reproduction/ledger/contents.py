"""The contents table at the front of a paper's notebook: what stands where, and whether it holds, from the verdicts."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from .verdicts import CANNOT_BE_CHECKED, DIFFERS, ERRATUM, IN_PART, Verdict, Verdicts, counted

MARKS = "<!-- contents -->", "<!-- end of contents -->"
BETWEEN = re.compile(f"({MARKS[0]}).*?({MARKS[1]})", re.DOTALL)


@dataclass(frozen=True)
class Row:
    """A line of the table: a heading of the notebook, and the items of the ledger that stand under it.

    ids are ids, or what they begin with ("table4" for "table4.1.2"). why says in a few words what is wrong, where
    something is; holds what to say where nothing is.
    """

    heading: str
    ids: list
    shows: str
    why: str = ""
    holds: str = ""

    @property
    def name(self) -> str:
        """The name of the line: the heading up to a colon."""
        return self.heading.partition(":")[0]

    @property
    def anchor(self) -> str:
        """The target of the link, as JupyterLab and nbviewer make it of the heading."""
        return self.heading.replace(" ", "-")

    def has(self, id: str) -> bool:
        """Say whether an item stands under this heading."""
        return any(id == each or id.startswith(f"{each}.") for each in self.ids)


def in_words(row: Row, verdicts: Iterable[Verdict]) -> str:
    """Return the verdict on a line of the contents in a few words."""
    given = [each for each in verdicts if row.has(each.id)]
    times = Counter(each.verdict for each in given)
    checked = len(given) - times[CANNOT_BE_CHECKED]
    wrong, part = times[DIFFERS] + times[ERRATUM], times[IN_PART]
    said = []
    if wrong:
        said.append(f"✗ {wrong} of {checked} wrong")
    if part:
        said.append(f"(✓) {part} of {checked} in part")
    if said and row.why:
        said[-1] += f": {row.why}"
    if not said and checked:
        said.append(row.holds or ("✓" if checked == 1 else f"✓ all {checked}"))
    if not given:
        said.append(row.holds)
    unchecked = [each for each in given if each.verdict == CANNOT_BE_CHECKED]
    pictures = [each for each in unchecked if each.kind == "figure"]
    lost = [each for each in unchecked if each.printed == "?"]
    if pictures:
        said.append("? picture lost in our copy; redrawn on our own data")
    if lost:
        said.append(f"? {len(lost)} lost in our copy")
    if len(unchecked) > len(pictures) + len(lost):
        said.append(f"? {len(unchecked) - len(pictures) - len(lost)} cannot be checked")
    return "; ".join(said)


def contents(rows: Iterable[Row], verdicts: Verdicts) -> str:
    """Return the counts in a sentence and the table of contents, in Markdown."""
    count = verdicts.checked()
    part = f", {count['part']} in part" if count["part"] else ""
    wrong = f"{count['fail']} do{'es' if count['fail'] == 1 else ''} not{for_which_reasons(verdicts)}"
    lines = [
        f"**The paper prints {count['all']} numbers, formulas, claims and figures as results. {count['checked']} of "
        f"them can be checked: {count['hold']} hold{part}, {wrong}.**",
        "",
        "| in the paper | what it shows | does it hold? |",
        "|---|---|---|",
    ]
    for row in rows:
        lines.append(f"| [{row.name}](#{row.anchor}) | {row.shows} | {in_words(row, verdicts)} |")
    return "\n".join(lines)


def for_which_reasons(verdicts: Verdicts) -> str:
    """Return how many reasons there are for what is wrong, and which, in a few words; causes may share their words."""
    wrong = [each for each in verdicts if each.verdict in (DIFFERS, ERRATUM)]
    causes = [verdicts.causes[key] for key in dict.fromkeys((each.paper, each.cause) for each in wrong)]
    if not causes:
        return ""
    said = f", for {counted(len(causes), 'reason')}"
    short = dict.fromkeys(cause.short for cause in causes if cause.short)
    return f"{said}: {', '.join(short)}" if short else said


def write_contents(notebook: Path, text: str):
    """Write the contents into a notebook, between their marks; raises ValueError where they do not stand once."""
    file = json.loads(notebook.read_text(encoding="utf-8"))
    places = 0
    for cell in file["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown" and BETWEEN.search(source):
            source, count = BETWEEN.subn(lambda found: f"{found[1]}\n\n{text}\n\n{found[2]}", source)
            places += count
            cell["source"] = source.splitlines(keepends=True)
    if places != 1:
        raise ValueError(f"{notebook.name}: needs {MARKS[0]} and {MARKS[1]} once, got them {places} times")
    # as nbformat writes it
    notebook.write_text(json.dumps(file, indent=1, ensure_ascii=False, sort_keys=True) + "\n", encoding="utf-8")
