"""What a paper prints: its items, the causes of what fails, and the paper itself."""

from __future__ import annotations

from dataclasses import dataclass

KINDS = ("number", "formula", "claim", "figure")


@dataclass(frozen=True)
class About:
    """A paper: its name here, its citation, how many tables and figures it has, what it asks, and whether it holds.

    doi is "" if our copy has none. question and answer are what the README and the home page say, in a few words.
    """

    name: str
    title: str
    authors: str
    journal: str
    year: int
    doi: str
    tables: int
    figures: int
    question: str = ""
    answer: str = ""

    @property
    def numbered(self) -> list[str]:
        """The tables and figures as the paper numbers them: "Table 1" ... "Figure 1" ..."""
        kinds = {"Table": self.tables, "Figure": self.figures}
        return [f"{kind} {number}" for kind, count in kinds.items() for number in range(1, count + 1)]


@dataclass(frozen=True)
class Item:
    """One number, formula, claim or figure that a paper gives as a result: where it stands and what is printed.

    If it fails, `cause` says why and `against` with which items of the paper it is at odds; basis says what a verdict
    on it rests on. A notebook then gives values only.
    """

    id: str
    where: str
    kind: str
    printed: str
    cause: str = ""
    against: tuple = ()
    basis: str = ""

    @property
    def decimals(self) -> int:
        """The number of decimals that the paper prints."""
        return len(self.printed.partition(".")[2])

    @property
    def lost(self) -> bool:
        """Say whether the printed text is missing from our copy of the paper; "?" stands for it then."""
        return self.printed == "?"

    def agrees(self, value: float) -> bool:
        """Say whether a number rounds to the printed digits.

        A tie may have been rounded either way, and a tie in decimals may be a little off as a double.

        >>> Item("t", "Table 4", "number", "1.316").agrees(670 / 509)
        True
        """
        return bool(abs(value - float(self.printed)) <= 0.5 * 10**-self.decimals * (1 + 1e-9))


@dataclass(frozen=True)
class Cause:
    """Why items fail: one cause for all that fail for one reason.

    kind is "slip" (a wrong number or formula), "wording" (a sentence that says it wrongly while nothing computed
    depends on it), "finding" (a claim or formula that fails or holds only in part) or "copy" (lost by our copy, not by
    the paper).
    `sentence` says what is wrong and what is right, `meaning` says what follows for a user of the filter, `short` says
    in a few words what is wrong, where reasons are listed.
    """

    id: str
    kind: str
    sentence: str
    meaning: str
    short: str = ""


def printed_of(item: Item) -> tuple[str, str, str, str]:
    """Return what a Verdict repeats of an item."""
    return item.id, item.where, item.kind, item.printed
