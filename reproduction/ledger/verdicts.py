"""Verdicts on what a paper prints: one record each, shown folded in a notebook, stored there for machines, counted."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict, dataclass, fields
from textwrap import shorten

from .tables import Table, details

REPRODUCED, WITHIN_BAND, IN_PART = "reproduced", "within band", "holds in part"
DIFFERS, ERRATUM, CANNOT_BE_CHECKED = "differs", "erratum", "cannot be checked"
VERDICTS = (REPRODUCED, WITHIN_BAND, IN_PART, DIFFERS, ERRATUM, CANNOT_BE_CHECKED)
HOLDS = (REPRODUCED, WITHIN_BAND)
FAILS = (IN_PART, DIFFERS, ERRATUM)

BASES = ("identity", "arithmetic", "exact", "simulation", "recording", "reading")
WRONG = ("slip", "wording", "finding")
CAUSE_KINDS = (*WRONG, "copy")

# The output of a notebook cell in which `python -m reproduction` and the site find the verdicts.
MIME = "application/vnd.mpt-helpers.verdicts+json"

# Plurals that are not the word with an s.
PLURALS = {each: each for each in VERDICTS} | {IN_PART: "hold in part", DIFFERS: "differ", ERRATUM: "errata"}


def counted(number: int, word: str) -> str:
    """Return a number and its word, in the plural if need be.

    >>> counted(1, "erratum"), counted(2, "erratum"), counted(3, "reproduced"), counted(4, "slip")
    ('1 erratum', '2 errata', '3 reproduced', '4 slips')
    """
    return f"{number} {word if number == 1 else PLURALS.get(word, word + 's')}"


@dataclass(frozen=True)
class Verdict:
    """The verdict on one item of a paper.

    The verdict judges the item in the setting that the paper states or evidently means, by the paper's own measure;
    beyond says what we found outside that setting, and never changes the verdict. basis says what the verdict rests on
    (one of BASES), cause is the id of the reason that it shares with other verdicts ("" where it holds), cell the id of
    the notebook cell that gave it (once a notebook stores it).
    """

    paper: str
    id: str
    where: str
    kind: str
    printed: str
    computed: str
    verdict: str
    reason: str
    basis: str
    cause: str
    beyond: str = ""
    cell: str = ""

    def __repr__(self):
        reason = f" ({self.reason})" if self.reason else ""
        return f"{self.where}: printed {self.printed}; computed {self.computed}: {self.verdict}{reason}"


FIELDS = tuple(field.name for field in fields(Verdict))


@dataclass(frozen=True)
class Tally:
    """Counts of verdicts: of claims, of everything else, and the items of each cause.

    claims and values map a verdict to a number of items; causes maps each kind of cause to {(paper, cause): items}.
    """

    claims: Counter
    values: Counter
    causes: dict

    def claims_text(self) -> str:
        """Return how many claims hold, as in "107 of 130 claims hold"."""
        return f"{self.claims[REPRODUCED]} of {self.claims.total()} claims hold"

    def values_text(self) -> str:
        """Return how many numbers, formulas and figures agree."""
        agree = self.values[REPRODUCED] + self.values[WITHIN_BAND]
        return f"{agree} of {self.values.total()} numbers, formulas and figures agree"

    def causes_text(self) -> str:
        """Return the causes of each kind with their cells, as in "6 slips (85 cells)", and what our copy lacks."""
        said = []
        for kind in WRONG:
            cells = self.causes[kind]
            if cells:
                said.append(f"{counted(len(cells), kind)} ({counted(cells.total(), 'cell')})")
        text, lost = ", ".join(said) or "nothing wrong", self.causes["copy"].total()
        return f"{text}; {counted(lost, 'cell')} missing or illegible in our copy" if lost else text


class Verdicts(list[Verdict]):
    """A list of Verdicts with their causes; a notebook that displays it stores it for machines too.

    causes maps (paper, id of the cause) to a Cause.

    >>> Verdicts([Verdict("p", "t1", "Table 1", "number", "2", "2", "reproduced", "", "arithmetic", "")])
    1 verdict: 1 reproduced
    id  printed  computed  verdict     basis       cause
    t1  2        2         reproduced  arithmetic
    """

    IN_TEXT = ("id", "printed", "computed", "verdict", "basis", "cause")
    IN_HTML = ("id", "where", "printed", "computed", "verdict", "basis", "cause", "reason", "beyond")

    def __init__(self, verdicts, causes=()):
        super().__init__(verdicts)
        self.causes = dict(causes)

    def of(self, paper: str) -> Verdicts:
        """Return the Verdicts on one paper."""
        return Verdicts([each for each in self if each.paper == paper], self.causes)

    def records(self) -> list[dict[str, str]]:
        """Return the verdicts as a list of dictionaries of text."""
        return [asdict(each) for each in self]

    def as_json(self) -> str:
        """Return the verdicts as the text of a JSON file."""
        return f"{json.dumps(self.records(), indent=1, ensure_ascii=False)}\n"

    def tally(self) -> Tally:
        """Return the Tally: causes counted with their cells, claims apart from everything else."""
        causes = {kind: Counter() for kind in CAUSE_KINDS}
        for each in self:
            if each.cause:
                kind = self.causes[each.paper, each.cause].kind
                causes[kind][each.paper, each.cause] += 1
        claims = Counter(each.verdict for each in self if each.kind == "claim")
        values = Counter(each.verdict for each in self if each.kind != "claim")
        return Tally(claims, values, causes)

    def checked(self) -> dict[str, int]:
        """Return how many items there are, were checked, could not be, hold, hold in part and fail, by short names."""
        given = Counter(each.verdict for each in self)
        hold, fail = given[REPRODUCED] + given[WITHIN_BAND], given[DIFFERS] + given[ERRATUM]
        lost = given[CANNOT_BE_CHECKED]
        counts = {"all": len(self), "checked": len(self) - lost, "lost": lost}
        return counts | {"hold": hold, "part": given[IN_PART], "fail": fail}

    def summary(self) -> str:
        """Return the counts in one line."""
        given = Counter(each.verdict for each in self)
        verdicts = ", ".join(counted(given[verdict], verdict) for verdict in VERDICTS if given[verdict])
        causes = self.tally().causes
        why = ", ".join(counted(len(causes[kind]), kind) for kind in WRONG if causes[kind])
        return f"{counted(len(self), 'verdict')}: {verdicts}" + (f" ({why})" if why else "")

    def __repr__(self):
        rows = [[shorten(getattr(each, name), 30, placeholder="...") for name in self.IN_TEXT] for each in self]
        return f"{self.summary()}\n{Table(self.IN_TEXT, rows)}"

    def html(self) -> str:
        """Return the verdicts in HTML: a folded table."""
        table = Table(self.IN_HTML, [[getattr(each, name) for name in self.IN_HTML] for each in self])
        return details(self.summary(), table._repr_html_())

    def _repr_mimebundle_(self, include=None, exclude=None):
        records = self.records()
        for record in records:
            del record["cell"]  # a running cell does not know its id: the reader of the notebook does
        return {"text/plain": repr(self), "text/html": self.html(), MIME: records}
