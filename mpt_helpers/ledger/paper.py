"""What a paper prints, read from its TOML file, and the verdict on each item: computed, never typed."""

import json
import math
import re
import tomllib
from collections import Counter
from collections.abc import Mapping
from dataclasses import astuple, dataclass, fields
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from .verdicts import (
    BASES,
    CANNOT_BE_CHECKED,
    CAUSE_KINDS,
    DIFFERS,
    ERRATUM,
    FAILS,
    HOLDS,
    IN_PART,
    MIME,
    REPRODUCED,
    WITHIN_BAND,
    Verdict,
    Verdicts,
)

FOLDER = Path(__file__).parent
KINDS = ("number", "formula", "claim", "figure")
# A cell that the paper prints and our copy of it has lost.
LOST = "?"


@dataclass(frozen=True)
class Item:
    """One number, formula, claim or figure that a paper gives as a result: where it stands and what is printed."""

    id: str
    where: str
    kind: str
    printed: str

    def agrees(self, value):
        """Say whether a number rounds to the printed digits.

        A tie may have been rounded either way, and a tie in decimals may be a little off as a double.

        >>> Item("t", "Table 4", "number", "1.316").agrees(670 / 509)
        True
        """
        decimals = len(self.printed.partition(".")[2])
        return bool(abs(value - float(self.printed)) <= 0.5 * 10**-decimals * (1 + 1e-9))


@dataclass(frozen=True)
class Cause:
    """Why items fail: one cause for all that fail for one reason.

    kind is "slip" (a wrong number or formula), "wording" (a sentence that says it wrongly while nothing computed
    depends on it), "finding" (a claim that fails or holds only in part) or "copy" (lost by our copy, not by the paper).
    sentence says what is wrong and what is right, meaning what that means for somebody who uses the filter.
    """

    id: str
    kind: str
    sentence: str
    meaning: str


class Paper:
    """The items of one paper, the causes of what fails, and the verdicts given so far; made by `published`."""

    def __init__(self, key, items, causes):
        self.key = key
        self.items = {item.id: item for item in items}
        self.causes = {cause.id: cause for cause in causes}
        self._outcomes = {}  # the last verdict on each item, in a word
        self._to_report = []

    def check(self, id, value, *, basis="arithmetic", band=None, cause=None, against=(), reason=""):
        """Compare a computed number with the printed one, and return the Verdict.

        Without a band it is `reproduced` when it rounds to the printed digits. With a band (low, high), the spread of
        simulations, it is `within band` when the printed number lies inside. Otherwise it `differs`, or is an `erratum`
        if `against` names items of the paper from which the value follows and which were reproduced: then the paper
        contradicts itself. A verdict that fails needs a cause, whose sentence is the reason where none is given.
        Raises ValueError for an argument that makes no sense, naming the item.
        """
        item = self._item(id, ["number"])
        if not math.isfinite(value):
            raise self._error(id, "a finite number", value)
        computed = f"{value:.6g}"
        if band is None:
            verdict = REPRODUCED if item.agrees(value) else DIFFERS
        else:
            low, high = band
            if not low <= high:
                raise self._error(id, "a band (low, high) with low <= high", band)
            if basis in ("identity", "arithmetic", "reading"):
                raise self._error(id, "the basis of its band: exact, simulation or recording", repr(basis))
            verdict = WITHIN_BAND if low <= float(item.printed) <= high else DIFFERS
            computed += f" [{low:.6g}, {high:.6g}]"
        return self._give(item, computed, verdict, basis, reason, cause, against)

    def claim(self, id, holds, evidence, *, basis, cause=None, against=(), reason=""):
        """Record whether a claim, a formula or what a figure shows holds, with the evidence, and return the Verdict.

        holds is a bool, or a mapping {condition in words: bool}. It is `reproduced` when all hold and `holds in part`
        when some do; the verdict names the conditions. When none holds, it `differs` or is an `erratum`, as in `check`.
        """
        item = self._item(id, ["formula", "claim", "figure"])
        conditions = holds if isinstance(holds, Mapping) else {}
        outcomes = list(conditions.values()) or [holds]
        if not all(isinstance(outcome, (bool, np.bool_)) for outcome in outcomes):
            raise self._error(id, "True, False or {condition: True or False}", repr(holds))
        if all(outcomes):
            verdict = REPRODUCED
        elif any(outcomes):
            verdict = IN_PART
        else:
            verdict = DIFFERS
        where_it_holds = "; ".join(condition for condition in conditions if conditions[condition])
        where_it_fails = "; ".join(condition for condition in conditions if not conditions[condition])
        prefix = ""
        if where_it_holds:
            prefix += f"Holds: {where_it_holds}. "
        if where_it_fails:
            prefix += f"Fails: {where_it_fails}. "
        return self._give(item, evidence, verdict, basis, reason, cause, against, prefix)

    def cannot_check(self, id, missing, *, cause=None):
        """Record that an item cannot be checked, and what is missing.

        What our copy of the paper has lost names a cause of kind "copy".
        """
        item = self._item(id)
        lost_by_us = [each.id for each in self.causes.values() if each.kind == "copy"]
        if item.printed == LOST and cause not in lost_by_us:
            raise self._error(id, 'a cause of kind "copy", since our copy has lost it', repr(cause))
        return self._give(item, "-", CANNOT_BE_CHECKED, "reading", missing, cause)

    def report(self):
        """Return the Verdicts given since the last report; as the last line of a cell, it shows and stores them."""
        if not self._to_report:
            raise ValueError(f"{self.key}: no verdict was given since the last report")
        given = Verdicts(self._to_report, self.causes_by_paper())
        self._to_report = []
        return given

    def complete(self, verdicts):
        """Return these Verdicts if they cover the paper: each item once, as in the file, each failure with its cause.

        Raises ValueError otherwise, naming the entries.
        """
        times = Counter(each.id for each in verdicts)
        named = {each.cause for each in verdicts if each.cause}
        failing = [each.id for each in verdicts if each.verdict in FAILS and not each.cause]
        printed = {astuple(item) for item in self.items.values()}
        changed = [each.id for each in verdicts if (each.id, each.where, each.kind, each.printed) not in printed]
        wrong = {
            "no verdict on": [id for id in self.items if id not in times],
            "no cause, although it fails, for": failing,
            "two verdicts on": [id for id in times if times[id] > 1],
            "a verdict on what the file does not have, or no longer so": changed,
            "no verdict names the cause": [id for id in self.causes if id not in named],
            "a verdict names an unknown cause": sorted(named - set(self.causes)),
        }
        parts = [f"{what} {', '.join(ids)}" for what, ids in wrong.items() if ids]
        if parts:
            raise ValueError(f"{self.key}.toml and its notebook: {'; '.join(parts)}")
        return verdicts

    def causes_by_paper(self):
        """Return the causes as {(key of the paper, id): Cause}, as Verdicts take them."""
        return {(self.key, id): cause for id, cause in self.causes.items()}

    def _item(self, id, kinds=None):
        """Return an item; if kinds are named, one of these kinds that our copy of the paper has not lost."""
        if id not in self.items:
            near = get_close_matches(str(id), self.items, n=3, cutoff=0)
            raise self._error(id, f"an id of {self.key}.toml", f"none; the nearest are {', '.join(near)}")
        item = self.items[id]
        if kinds and item.kind not in kinds:
            raise self._error(id, f"an item of kind {' or '.join(kinds)}", f"a {item.kind}")
        if kinds and item.printed == LOST:
            raise self._error(id, "an item that our copy of the paper has kept", "one that it has lost")
        return item

    def _give(self, item, computed, verdict, basis, reason, cause, against=(), prefix=""):
        """Return the Verdict and keep it for the report; what holds has no cause, what fails has its sentence."""
        if basis not in BASES:
            raise self._error(item.id, f"one of the bases {', '.join(BASES)}", repr(basis))
        if cause is not None and cause not in self.causes:
            raise self._error(item.id, f"a cause of {self.key}.toml ({', '.join(self.causes) or 'none'})", repr(cause))
        if cause is not None and self.causes[cause].kind == "copy" and verdict in FAILS:
            raise self._error(item.id, "another cause: what our copy has lost cannot be checked", repr(cause))
        for id in against:
            if self._outcomes.get(id) != REPRODUCED:
                raise self._error(item.id, "items in `against` that were reproduced before", repr(id))
        if verdict in HOLDS:
            cause, reason = None, ""
        elif cause is not None:
            reason = reason or self.causes[cause].sentence
        if verdict == DIFFERS and against:
            verdict = ERRATUM
            sides = "; ".join(f"{self.items[id].where}: {self.items[id].printed}" for id in against)
            reason = f"{reason} Against {sides}."
        reason = (prefix + reason).strip()
        given = Verdict(self.key, *astuple(item), computed, verdict, reason, basis, cause or "")
        self._outcomes[item.id] = verdict
        self._to_report.append(given)
        return given

    def _error(self, id, need, got):
        return ValueError(f"{self.key}, {id!r}: needs {need}, got {got}")


def read_paper(key, text):
    """Return the Paper in the text of a TOML file: `items`, `grids` of numbers and `causes`.

    A grid gives one item for each row and column, with id "{id}.{row}.{column}" and a `where` such as "Table 4, row
    {row}, column {column}"; an empty cell is no item, and "?" is one that our copy of the paper has lost. Raises
    ValueError for a malformed file, naming the file, the entry and what it needs.
    """
    file = f"{key}.toml"
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{file}: {error}") from error
    for name, entries in content.items():
        if name not in ("items", "grids", "causes") or not isinstance(entries, list):
            raise ValueError(f"{file}: needs lists of items, grids and causes, got {name} = {entries!r}")
    cells = [cell for grid in content.get("grids", []) for cell in _cells(file, grid)]
    items = [_made(Item, entry, KINDS, file) for entry in content.get("items", []) + cells]
    causes = [_made(Cause, entry, CAUSE_KINDS, file) for entry in content.get("causes", [])]
    for item in items:
        if item.kind == "number" and not re.fullmatch(r"\?|[+-]?\d+(\.\d+)?", item.printed, re.ASCII):
            raise ValueError(f"{file}, {item.id!r}: needs a number as printed, got {item.printed!r}")
    for made in (items, causes):
        twice = [id for id, times in Counter(each.id for each in made).items() if times > 1]
        if twice:
            raise ValueError(f"{file}: needs each id once, got {', '.join(twice)} again")
    return Paper(key, items, causes)


def _cells(file, grid):
    """Yield the entries of a grid, as they would stand among the items."""
    try:
        for row, cells in grid["rows"].items():
            for column, printed in zip(grid["columns"], cells, strict=True):
                if printed != "":
                    place = grid["where"].format(row=row, column=column)
                    yield {"id": f"{grid['id']}.{row}.{column}", "where": place, "kind": "number", "printed": printed}
    except (TypeError, LookupError, AttributeError, ValueError) as error:
        need = "id, where with {row} and {column}, columns, and rows with a text for each column"
        raise ValueError(f"{file}, grid {grid!r:.40}: needs {need} ({error})") from error


def _made(make, entry, kinds, file):
    """Return the Item or Cause that an entry describes, or raise."""
    names = [field.name for field in fields(make)]
    if not isinstance(entry, dict) or sorted(entry) != sorted(names):
        raise ValueError(f"{file}: needs {', '.join(names)}, got {entry!r}")
    for name, value in entry.items():
        if not isinstance(value, str) or not value:
            raise ValueError(f"{file}, {entry['id']!r}: needs a text for {name}, got {value!r}")
    if entry["kind"] not in kinds:
        raise ValueError(f"{file}, {entry['id']!r}: needs kind {' or '.join(kinds)}, got {entry['kind']!r}")
    return make(**entry)


def keys():
    """Return the keys of all papers.

    >>> "2014_gsm_2d" in keys()
    True
    """
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def published(key):
    """Return one Paper, to be checked item by item. Raises ValueError for an unknown key and for a malformed file.

    >>> paper = published("2014_gsm_2d")
    >>> paper.check("speedup.kf-lf-a", 670 / 509)
    Section 6, after Table 4 (i): printed 1.316; computed 1.31631: reproduced
    """
    if key not in keys():
        raise ValueError(f"key: needs one of {', '.join(keys())}, got {key!r}")
    return read_paper(key, (FOLDER / f"{key}.toml").read_text(encoding="utf-8"))


def stored_verdicts(notebook):
    """Return the Verdicts that the cells of an executed notebook store, in the paper's order, without running it.

    The paper is the one that the notebook is named for. Raises ValueError for a file that stores none.
    """
    path = Path(notebook)
    paper = published(path.stem)
    given = []
    try:
        for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
            for output in cell.get("outputs", []):
                given += [Verdict(**record, cell=cell["id"]) for record in output.get("data", {}).get(MIME, [])]
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise ValueError(f"{path}: needs an executed notebook with verdicts of this version ({error!r})") from error
    if not given:
        raise ValueError(f"{path}: needs an executed notebook whose cells end with paper.report()")
    order = {id: place for place, id in enumerate(paper.items)}
    given.sort(key=lambda each: order.get(each.id, len(order)))
    return Verdicts(given, paper.causes_by_paper())


def shipped_verdicts(*some):
    """Return the Verdicts of some papers, or of all, that come with the package."""
    given = []
    causes = {}
    for key in some or keys():
        path = FOLDER / f"{key}.json"
        if path.is_file():
            given += [Verdict(**record) for record in json.loads(path.read_text(encoding="utf-8"))]
        causes |= published(key).causes_by_paper()
    return Verdicts(given, causes)
