"""What the README says of the papers, written from the ledger: one row for each, and what cannot be checked."""

import re

from mpt_helpers.tracks.files import write_whole

from .ledger import published, shipped_verdicts
from .ledger.tables import Table
from .ledger.verdicts import CANNOT_BE_CHECKED
from .project import FIGURES, NOTEBOOKS, CommandError, project

# The sentence of the README's opening with the counts, as it is written and as it is found.
COUNTS = (
    "{all} numbers, formulas, claims and figures, {checked} could be checked: {hold} hold, {part} in part, {fail} fail"
)
WRITTEN_COUNTS = re.compile(re.sub(r"\{\w+\}", r"\\d+", COUNTS))
HOLDS = (
    "A computed number *holds* if we get the printed digits, a simulated one if it lies within the spread (99 %) of "
    "our simulations, a claim if it meets the rule in its entry of the ledger; *in part*, under conditions that are "
    "named. Each failure has its reason beside it. We had the papers as text extracted from PDF, without pictures, "
    "and they print no data: figures are drawn again on tracks of our own, and judged by what the text says of them."
)
ON_GITHUB = (
    "GitHub opens a notebook at its top: search there for “Table 4”. [nbviewer](https://nbviewer.org) and the site "
    "from `make site` open it at the heading."
)
BLOCK = re.compile(r"(<!-- papers: [^\n]* -->\n).*?(<!-- end of papers -->)", re.DOTALL)


def block(verdicts):
    """Return the README's table of the papers, in Markdown, and a sentence on what cannot be checked."""
    rows = [row(key, verdicts.of(key).checked()) for key in dict.fromkeys(each.paper for each in verdicts)]
    head = ["paper", "question, and answer", "hold / in part / fail", "tables", "figures"]
    return f"{ON_GITHUB}\n\n{Table(head, rows).markdown()}\n\n{HOLDS}\n\n{on_what_is_lost(verdicts)}"


def row(key, count):
    """Return the cells of a paper: its notebook, question and answer, counts, and a link to each table and figure."""
    about = published(key).about
    notebook = f"{NOTEBOOKS}/{key}.ipynb"
    tables = [f"[{n}]({notebook}#Table-{n})" for n in range(1, about.tables + 1)]
    figures = [f"[{n}]({FIGURES}/{key}_fig{n}.png)" for n in range(1, about.figures + 1)]
    counts = " / ".join(str(count[name]) for name in ("hold", "part", "fail"))
    name = f"{about.authors}, *{about.title}*, {about.year}"
    if about.doi:
        name += f", [doi](https://doi.org/{about.doi})"
    name += f": [our notebook]({notebook})"
    found = f"{about.question} **{about.answer}**"
    return [name, found, counts, " ".join(tables) or "none", " ".join(figures) or "none"]


def on_what_is_lost(verdicts):
    """Return a sentence on the items that cannot be checked: lost by our copies, doubted, or left out by the papers."""
    unchecked = [each for each in verdicts if each.verdict == CANNOT_BE_CHECKED]
    of_copies = [each for each in unchecked if each.cause]
    lost = [each for each in of_copies if each.printed == "?" or each.kind == "figure"]
    return (
        f"Of the {len(unchecked)} items that cannot be checked, {len(lost)} are lost in this text, "
        f"{len(of_copies) - len(lost)} have one doubtful character, and {len(unchecked) - len(of_copies)} need details "
        "that the paper leaves out."
    )


def write_readme():
    """Write the papers and the counts into the README; raises CommandError where they have no place."""
    path = project() / "README.md"
    verdicts = shipped_verdicts()
    text = WRITTEN_COUNTS.sub(COUNTS.format(**verdicts.checked()), path.read_text(encoding="utf-8"))
    text, places = BLOCK.subn(lambda old: f"{old[1]}\n{block(verdicts)}\n\n{old[2]}", text)
    if places != 1:
        raise CommandError(f"{path.name}: needs one place for the papers, got {places}")
    write_whole(path, text.encode())
