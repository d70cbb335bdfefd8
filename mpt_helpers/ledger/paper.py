"""What a paper prints, read from its TOML file, and the verdict on each item: computed, never typed."""

import json
import math
import re
import tomllib
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, fields
from difflib import get_close_matches
from importlib.resources import files
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

    def __init__(self, key, items, causes=()):
        self.key = key
        self.items = {item.id: item for item in items}
        self.causes = {cause.id: cause for cause in causes}
        self._verdicts = {}
        self._to_report = []

    def check(self, id, value, *, basis="arithmetic", band=None, cause=None, against=(), reason=""):
        """Compare a computed number with the printed one, and return the Verdict.

        Without a band it is `reproduced` when it rounds to the printed digits. With a band (low, high), the spread of
        simulations, it is `within band` when the printed number lies inside. Otherwise it `differs`, or is an `erratum`
        if `against` names items of the paper from which the value follows and which were reproduced: then the paper
        contradicts itself. Either names a cause, whose sentence is the reason where none is given.
        Raises ValueError for what makes no sense, naming the item.
        """
        item = self._item(id, ("number",))
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
        return self._give(item, computed, verdict, reason, basis, cause, against)

    def claim(self, id, holds, evidence, *, basis, cause=None, against=(), reason=""):
        """Record whether a claim, a formula or what a figure shows holds, with the evidence, and return the Verdict.

        holds is a bool, or a mapping {condition in words: bool}. It is `reproduced` when all hold and `holds in part`
        when some do; the verdict names the conditions. When none holds, it `differs` or is an `erratum`, as in `check`.
        """
        item = self._item(id, ("formula", "claim", "figure"))
        named = isinstance(holds, Mapping)
        outcomes = list(holds.values()) if named else [holds]
        if not outcomes or not all(isinstance(outcome, (bool, np.bool_)) for outcome in outcomes):
            raise self._error(id, "True, False or {condition: True or False}", repr(holds))
        if all(outcomes):
            verdict = REPRODUCED
        elif any(outcomes):
            verdict = IN_PART
        else:
            verdict = DIFFERS
        conditions = []
        for word, wanted in (("Holds", True), ("Fails", False)):
            those = [condition for condition, outcome in holds.items() if outcome == wanted] if named else []
            if those:
                conditions.append(f"{word}: {'; '.join(those)}.")
        return self._give(item, evidence, verdict, reason, basis, cause, against, " ".join(conditions))

    def cannot_check(self, id, missing, *, cause=None):
        """Record that an item cannot be checked, and what is missing.

        What our copy of the paper has lost names a cause of kind "copy".
        """
        item = self._item(id, KINDS, lost_too=True)
        if item.printed == LOST and (cause not in self.causes or self.causes[cause].kind != "copy"):
            raise self._error(id, 'a cause of kind "copy", since our copy has lost it', repr(cause))
        return self._give(item, "-", CANNOT_BE_CHECKED, missing, "reading", cause, ())

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
        changed = [
            each.id
            for each in verdicts
            if Item(each.id, each.where, each.kind, each.printed) != self.items.get(each.id)
        ]
        failing = [each.id for each in verdicts if each.verdict in FAILS and not each.cause]
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

    def _item(self, id, kinds, lost_too=False):
        if id not in self.items:
            near = get_close_matches(str(id), self.items, n=3, cutoff=0)
            raise self._error(id, f"an id of {self.key}.toml", f"none; the nearest are {', '.join(near)}")
        item = self.items[id]
        if item.kind not in kinds:
            raise self._error(id, f"an item of kind {' or '.join(kinds)}", f"a {item.kind}")
        if item.printed == LOST and not lost_too:
            raise self._error(id, "an item that our copy of the paper has kept", "one that it has lost")
        return item

    def _give(self, item, computed, verdict, reason, basis, cause, against, conditions=""):
        if basis not in BASES:
            raise self._error(item.id, f"one of the bases {', '.join(BASES)}", repr(basis))
        if cause is not None and cause not in self.causes:
            raise self._error(item.id, f"a cause of {self.key}.toml ({', '.join(self.causes) or 'none'})", repr(cause))
        for id in against:
            if id not in self._verdicts or self._verdicts[id].verdict != REPRODUCED:
                raise self._error(item.id, "items in `against` that were reproduced before", repr(id))
        if verdict in HOLDS:
            cause, reason = None, ""
        elif cause is not None:
            reason = reason or self.causes[cause].sentence
            if self.causes[cause].kind == "copy" and verdict != CANNOT_BE_CHECKED:
                raise self._error(item.id, "another cause: what our copy has lost cannot be checked", repr(cause))
        if verdict == DIFFERS and against:
            verdict = ERRATUM
            sides = "; ".join(f"{self.items[id].where}: {self.items[id].printed}" for id in against)
            reason = f"{reason} Against {sides}."
        reason = f"{conditions} {reason}".strip()
        item_fields = (item.id, item.where, item.kind, item.printed)
        given = Verdict(self.key, *item_fields, computed, verdict, reason, basis, cause or "")
        self._verdicts[item.id] = given
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
    unknown = sorted(set(content) - {"items", "grids", "causes"})
    if unknown:
        raise ValueError(f"{file}: needs only items, grids and causes, got {', '.join(unknown)}")
    for name in ("items", "grids", "causes"):
        if not isinstance(content.setdefault(name, []), list):
            raise ValueError(f"{file}: needs a list for {name}, got {content[name]!r}")
    entries = [*content["items"], *(cell for grid in content["grids"] for cell in _cells(file, grid))]
    items = [_entry(file, Item, entry, KINDS) for entry in entries]
    causes = [_entry(file, Cause, entry, CAUSE_KINDS) for entry in content["causes"]]
    for item in items:
        if item.kind == "number" and not re.fullmatch(r"\?|[+-]?\d+(\.\d+)?", item.printed, re.ASCII):
            raise ValueError(f"{file}, {item.id!r}: needs a number as printed, got {item.printed!r}")
    for ids in ([item.id for item in items], [cause.id for cause in causes]):
        twice = [id for id, times in Counter(ids).items() if times > 1]
        if twice:
            raise ValueError(f"{file}: needs each id once, got {', '.join(twice)} again")
    return Paper(key, items, causes)


def _cells(file, grid):
    try:
        id, where, columns, rows = grid["id"], grid["where"], grid["columns"], grid["rows"]
        for row, cells in rows.items():
            for column, printed in zip(columns, cells, strict=True):
                if printed != "":
                    place = where.format(row=row, column=column)
                    yield {"id": f"{id}.{row}.{column}", "where": place, "kind": "number", "printed": printed}
    except (TypeError, LookupError, AttributeError, ValueError) as error:
        need = "id, where with {row} and {column}, columns, and rows with a text for each column"
        raise ValueError(f"{file}, grid {grid!r:.40}: needs {need} ({error})") from error


def _entry(file, make, entry, kinds):
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
    return sorted(path.name.removesuffix(".toml") for path in _folder().iterdir() if path.name.endswith(".toml"))


def published(key):
    """Return one Paper, to be checked item by item. Raises ValueError for an unknown key and for a malformed file.

    >>> paper = published("2014_gsm_2d")
    >>> paper.check("speedup.kf-lf-a", 670 / 509)
    Section 6, after Table 4 (i): printed 1.316; computed 1.31631: reproduced
    """
    if key not in keys():
        raise ValueError(f"key: needs one of {', '.join(keys())}, got {key!r}")
    return read_paper(key, _folder().joinpath(f"{key}.toml").read_text(encoding="utf-8"))


def stored_verdicts(notebook, paper=None):
    """Return the Verdicts that the cells of an executed notebook store, in the paper's order, without running it.

    The paper is the one that the notebook is named for. Raises ValueError for a file that stores none.
    """
    path = Path(notebook)
    paper = paper or published(path.stem)
    try:
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        given = [
            Verdict(**record, cell=cell["id"])
            for cell in cells
            for output in cell.get("outputs", [])
            for record in output.get("data", {}).get(MIME, [])
        ]
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
        paper = published(key)
        path = _folder().joinpath(f"{key}.json")
        if path.is_file():
            given += [Verdict(**record) for record in json.loads(path.read_text(encoding="utf-8"))]
        causes |= paper.causes_by_paper()
    return Verdicts(given, causes)


def _folder():
    return files(__package__)
