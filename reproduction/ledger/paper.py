"""What a paper prints, read from its TOML file, and the verdict on each item: computed, never typed."""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, dataclass, fields
from difflib import get_close_matches
from itertools import product
from numbers import Real
from pathlib import Path

import numpy as np

from .shown import Grid, Layout, Row, Shown, beside, contents, mark, name_of_line
from .tables import gap_text
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
    VERDICTS,
    WITHIN_BAND,
    Verdict,
    Verdicts,
    counted,
)

FOLDER = Path(__file__).parent
KINDS = ("number", "formula", "claim", "figure")


@dataclass(frozen=True)
class Item:
    """One number, formula, claim or figure that a paper gives as a result: where it stands and what is printed.

    If it fails, `cause` says why and `against` with which items of the paper it is at odds; basis says what a verdict on
    it rests on. So a notebook gives values only.
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
        decimals = len(self.printed.partition(".")[2])
        return bool(abs(value - float(self.printed)) <= 0.5 * 10**-decimals * (1 + 1e-9))


@dataclass(frozen=True)
class Cause:
    """Why items fail: one cause for all that fail for one reason.

    kind is "slip" (a wrong number or formula), "wording" (a sentence that says it wrongly while nothing computed
    depends on it), "finding" (a claim or formula that fails or holds only in part) or "copy" (lost by our copy, not by
    the paper).
    `sentence` says what is wrong and what is right, `meaning` says what follows for a user of the filter.
    """

    id: str
    kind: str
    sentence: str
    meaning: str


class Paper:
    """The items of one paper, the causes of what fails, and the verdicts given so far; made by `published`."""

    def __init__(self, key: str, items: Iterable[Item], causes: Iterable[Cause], tables=(), rows=()):
        self.key = key
        self.tables = {table.id: table for table in tables}
        self.rows = list(rows)
        self._given, self._said = [], {}
        self.items = {item.id: item for item in items}
        self.causes = {cause.id: cause for cause in causes}
        self._outcomes = {}  # the last verdict on each item, in a word
        self._to_report = []

    def check(
        self,
        id: str,
        value: float,
        *,
        basis: str = "arithmetic",
        band: tuple[float, float] | None = None,
        cause: str | None = None,
        against: Iterable[str] = (),
        reason: str = "",
        beyond: str = "",
    ) -> Verdict:
        """Compare a computed number with the printed one, and return the Verdict.

        Without a band it is `reproduced` when it rounds to the printed digits. With a band (low, high), the spread of
        simulations, it is `within band` when the printed number lies inside. Otherwise it `differs`, or is an `erratum`
        if `against` names items of the paper from which the value follows and which were reproduced: then the paper
        contradicts itself. A failing verdict needs a cause; its sentence serves as the reason unless you give one.
        beyond says what was found outside the paper's setting: it stands beside the verdict, and never changes it.
        Raises ValueError for an argument that makes no sense, naming the item.
        """
        item = self._item(id, ["number"])
        if not _is_finite(value):
            raise self._error(id, f"needs a finite number, got {value!r}")
        computed = f"{value:.6g}"
        if band is None:
            verdict = REPRODUCED if item.agrees(value) else DIFFERS
        else:
            if np.shape(band) != (2,) or not all(map(_is_finite, band)) or band[0] > band[1]:
                raise self._error(id, f"needs a band (low, high) of finite numbers with low <= high, got {band!r}")
            if basis in ("identity", "arithmetic", "reading"):
                raise self._error(id, f"needs the basis of its band: exact, simulation or recording, got {basis!r}")
            low, high = band
            verdict = WITHIN_BAND if low <= float(item.printed) <= high else DIFFERS
            computed += f" [{low:.6g}, {high:.6g}]"
        return self._give(item, computed, verdict, basis, reason, cause, against, beyond=beyond)

    def claim(
        self,
        id: str,
        holds: bool | np.bool_ | Mapping[str, bool | np.bool_],
        evidence: str,
        *,
        basis: str = "",
        cause: str | None = None,
        against: Iterable[str] = (),
        reason: str = "",
        beyond: str = "",
    ) -> Verdict:
        """Record whether a claim, a formula or what a figure shows holds, with the evidence, and return the Verdict.

        holds is a bool, or a mapping {condition in words: bool}. It is `reproduced` when all hold and `holds in part`
        when some do; the verdict names the conditions. When none holds, it `differs` or is an `erratum`, as in `check`.
        A condition lies inside the setting that the paper states or evidently means. What was found outside it (other
        starts, steps, recordings) is beyond: a sentence that stands beside the verdict, and never changes it.
        """
        item = self._item(id, ["formula", "claim", "figure"])
        conditions = holds if isinstance(holds, Mapping) else {}
        outcomes = list(conditions.values()) or [holds]
        if not all(isinstance(outcome, (bool, np.bool_)) for outcome in outcomes):
            raise self._error(id, f"needs True, False or {{condition: True or False}}, got {holds!r}")
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
        return self._give(item, evidence, verdict, basis, reason, cause, against, prefix, beyond)

    def cannot_check(self, id: str, missing: str, *, cause: str | None = None, counted: float | None = None) -> Verdict:
        """Record that an item cannot be checked, and what is missing.

        A cause is given where our copy of the paper has lost the item, and only there: it is of kind "copy". counted is
        the number that should stand there, where it is known.
        """
        item = self._item(id)
        if counted is not None and not _is_finite(counted):
            raise self._error(id, f"needs a finite number for counted, got {counted!r}")
        lost_by_us = [each.id for each in self.causes.values() if each.kind == "copy"]
        if (item.lost or cause is not None) and cause not in lost_by_us:
            raise self._error(id, f'needs a cause of kind "copy", or none if our copy has the item, got {cause!r}')
        computed = "-" if counted is None else f"{counted:.6g}"
        return self._give(item, computed, CANNOT_BE_CHECKED, "reading", missing, cause)

    def table(
        self, id: str, computed, *, basis: str = "arithmetic", extra: Mapping[str, Iterable] | None = None
    ) -> Shown:
        """Check all cells of a table of the paper, and return it as the paper lays it out, printed beside computed.

        computed maps the items' ids to values, or has them in reading order (of a grid: rows of columns). A value is a
        number, or a function of the printed formula that returns (whether it holds, what is right, how that was seen).
        What our copy has lost is counted and not judged. extra has columns of ours, {head: cells}, at the right.
        """
        layout = self.tables[id]
        ids = layout.ids
        if not isinstance(computed, Mapping):
            values = list(np.ravel(computed)[_off_diagonal(computed)]) if np.ndim(computed) == 2 else list(computed)
            computed = dict(zip(ids, values, strict=True))
        cells = {}
        for each in ids:
            item, value = self.items[each], computed[each]
            if item.lost:
                decimals = 3
                given = self.cannot_check(
                    each, "our copy has lost this cell", cause=item.cause, counted=round(value, 3)
                )
                right = f"{value:.{decimals}f}"
            elif callable(value):
                holds, right, how = value(item.printed)
                given = self.claim(each, holds, f"{right}: {how}" if right != item.printed else how, basis=basis)
            else:
                given = self.check(each, float(value), basis=basis)
                right = f"{value:.{item.decimals}f}"
            cells[f"{{{each}}}"] = beside(given, right, layout.grid)
        extra = extra or {}
        head = [ITEM_TEXT(each, self.items) for each in (*layout.head, *extra)]
        if layout.grid:
            head = [name_of_line(each, "<br>") for each in head]
            cells |= {row[0]: name_of_line(row[0]) for row in layout.rows}
        columns = zip(*extra.values(), strict=True) if extra else [()] * len(layout.rows)
        rows = [
            [*(cells.get(cell, cell) for cell in row), *more] for row, more in zip(layout.rows, columns, strict=True)
        ]
        said = self._what_is_wrong(layout.title.partition(":")[0], layout.wrong)
        wrong, lost = (sum(each.verdict in some for each in self._to_report) for some in (FAILS, [CANNOT_BE_CHECKED]))
        checked = len(ids) - lost
        count = f"{checked - wrong} of {checked} agree" + (f"; our copy has lost {lost}" if lost else "")
        caption = f"{layout.title}. {count}." if ids else layout.title
        return self._show(Grid(head, rows, caption), said)

    def equal(self, gaps: Mapping[str, float], what: str = "", *, below: float = 1e-12, reason: str = "") -> Shown:
        """Record formulas and claims that hold if a gap is rounding, {id: gap}, and show them in a table."""
        rows = []
        for id, gap in gaps.items():
            shown = f"{what}: largest gap {gap_text(gap)}" if what else f"largest gap {gap_text(gap)}"
            given = self.claim(id, bool(gap < below), shown, basis=self.items[id].basis or "identity", reason=reason)
            rows.append([f"{mark(given.verdict)} {given.where}", _short(given), gap_text(gap)])
        return self._show(Grid(["", "the paper says", "largest gap" + (f" to {what}" if what else "")], rows), [])

    def claims(self, found: Mapping[str, tuple]) -> Shown:
        """Record claims, {id: (whether it holds, what shows it[, what lies beyond])}, and show them in a table."""
        rows = []
        for id, (holds, shown, *beyond) in found.items():
            given = self.claim(id, holds, shown, basis=self.items[id].basis, beyond=" ".join(beyond))
            rows.append([f"{mark(given.verdict)} {given.where}", given.printed, shown])
        return self._show(Grid(["", "the paper says", "what we find"], rows), self._what_is_wrong("above"))

    def lacking(self, missing: Mapping[str, str]) -> Shown:
        """Record what our copy of the paper has lost, {id: what is missing}, and show it in a table."""
        rows = []
        for id, what in missing.items():
            given = self.cannot_check(id, what, cause=self.items[id].cause or None)
            rows.append([f"? {given.where}", given.printed, what])
        return self._show(Grid(["", "what cannot be checked", "why"], rows), [])

    def ledger(self) -> Ledger:
        """Return all verdicts, to be shown folded at the end; raises ValueError for an item without one."""
        given = Verdicts(self._given, self.causes_by_paper())
        order = {id: place for place, id in enumerate(self.items)}
        given.sort(key=lambda each: order[each.id])
        return Ledger(self.complete(given), given.causes)

    def contents(self, verdicts: Verdicts) -> str:
        """Return the table of contents of the paper's notebook in Markdown."""
        return contents(self.rows, verdicts)

    def cells(self, id: str) -> dict[tuple[int, int], Item]:
        """Return the items of a grid as {(row, column): item}, counted from 0."""
        places = {tuple(int(number) - 1 for number in each.split(".")[1:]): each for each in self.tables[id].ids}
        return {place: self.items[each] for place, each in places.items()}

    def _what_is_wrong(self, place, sentence=""):
        """Return a sentence for each cause of what fails in a table, or one for all; the second time, where it was said."""
        said = []
        causes = Counter(each.cause for each in self._to_report if each.verdict in FAILS)
        if sentence and causes:
            return [f"✗ {counted(causes.total(), 'cell')}: {sentence}"]
        for id, count in causes.items():
            first = self._said.setdefault(id, place)
            why = self.causes[id].sentence if first == place else f"the same as in {first}."
            said.append(f"✗ {counted(count, 'cell')}: {why}")
        return said

    def _show(self, grid, said):
        given, self._to_report = self._to_report, []
        return Shown(given, self.causes_by_paper(), grid, said)

    def report(self) -> Verdicts:
        """Return the Verdicts given since the last report; as the last line of a cell, it shows and stores them."""
        if not self._to_report:
            raise ValueError(f"{self.key}: no verdict was given since the last report")
        given = Verdicts(self._to_report, self.causes_by_paper())
        self._to_report = []
        return given

    def complete(self, verdicts: Verdicts) -> Verdicts:
        """Return these Verdicts if they cover the paper: each item once, as in the file, each failure with its cause.

        Raises ValueError otherwise, naming the entries.
        """
        times = Counter(each.id for each in verdicts)
        named = {each.cause for each in verdicts if each.cause}
        failing = [each.id for each in verdicts if each.verdict in FAILS and not each.cause]
        printed = {printed_of(item) for item in self.items.values()}
        changed = [each.id for each in verdicts if (each.id, each.where, each.kind, each.printed) not in printed]
        wrong = {
            "no verdict on": [id for id in self.items if id not in times],
            "no cause, although it fails, for": failing,
            "two verdicts on": [id for id in times if times[id] > 1],
            "verdicts that do not match the file (unknown id or changed text):": changed,
            "no verdict names the cause": [id for id in self.causes if id not in named],
        }
        parts = [f"{what} {', '.join(ids)}" for what, ids in wrong.items() if ids]
        if parts:
            raise ValueError(f"{self.key}.toml and its notebook: {'; '.join(parts)}")
        return verdicts

    def causes_by_paper(self) -> dict[tuple[str, str], Cause]:
        """Return the causes as {(key of the paper, id): Cause}, as Verdicts take them."""
        return {(self.key, id): cause for id, cause in self.causes.items()}

    def _item(self, id, kinds=None):
        """Return an item; if kinds are named, one of these kinds that our copy of the paper has not lost."""
        if id not in self.items:
            near = get_close_matches(str(id), self.items, n=3, cutoff=0)
            raise self._error(id, f"unknown id of {self.key}.toml; did you mean {', '.join(near)}?")
        item = self.items[id]
        if kinds and item.kind not in kinds:
            raise self._error(id, f"needs an item of kind {' or '.join(kinds)}, got a {item.kind}")
        if kinds and item.lost:
            raise self._error(id, "our copy has lost this item: use cannot_check")
        return item

    def _give(self, item, computed, verdict, basis, reason, cause, against=(), prefix="", beyond=""):
        """Return the Verdict and keep it for the report; what holds has no cause, what fails has its sentence."""
        basis = basis or item.basis
        if verdict in FAILS:
            cause, against = cause or item.cause or None, against or item.against
        if basis not in BASES:
            raise self._error(item.id, f"needs one of the bases {', '.join(BASES)}, got {basis!r}")
        if cause is not None and cause not in self.causes:
            known = ", ".join(self.causes) or "none"
            raise self._error(item.id, f"needs a cause of {self.key}.toml ({known}), got {cause!r}")
        if verdict in FAILS and cause is None:
            raise self._error(item.id, f"needs a cause, since the verdict is {verdict!r} (computed: {computed})")
        if verdict in FAILS and self.causes[cause].kind == "copy":
            raise self._error(item.id, f"needs another cause: what our copy has lost cannot be checked, got {cause!r}")
        if isinstance(against, str):
            raise self._error(item.id, f"needs a list of ids in `against`, got {against!r}")
        for id in against:
            if self._outcomes.get(id) != REPRODUCED:
                raise self._error(item.id, f"needs items in `against` that were reproduced before, got {id!r}")
        if verdict in HOLDS:
            cause = None
        elif cause is not None:
            reason = reason or self.causes[cause].sentence
        if verdict == DIFFERS and against:
            verdict = ERRATUM
            sides = "; ".join(f"{self.items[id].where}: {self.items[id].printed}" for id in against)
            reason = f"{reason} Against {sides}."
        reason = (prefix + reason).strip()
        given = Verdict(self.key, *printed_of(item), computed, verdict, reason, basis, cause or "", beyond)
        self._given.append(given)
        self._outcomes[item.id] = verdict
        self._to_report.append(given)
        return given

    def _error(self, id, problem):
        return ValueError(f"{self.key}, {id!r}: {problem}")


class Ledger(Verdicts):
    """All verdicts on a paper, folded: a notebook shows them at its end, and stores them where they were given."""

    def __repr__(self):
        return "\n".join(
            [
                self.summary(),
                *(
                    f"{mark(e.verdict)} {e.id}: {e.cause}"
                    for e in self
                    if e.verdict not in HOLDS and e.kind != "number"
                ),
            ]
        )

    def _repr_mimebundle_(self, include=None, exclude=None):
        bundle = super()._repr_mimebundle_()
        return {"text/plain": repr(self), "text/html": bundle["text/html"]}


def ITEM_TEXT(text, items):
    """Return a text with what is printed in place of {id}."""
    return re.sub(r"\{([^{}]+)\}", lambda found: items[found[1]].printed, text)


def _off_diagonal(square):
    return ~np.eye(len(square), dtype=bool).ravel()


def _short(given):
    text = given.printed
    return text if len(text) <= 60 else text[:59].rsplit(" ", 1)[0] + " ..."


def printed_of(item):
    """Return what a Verdict repeats of an item."""
    return item.id, item.where, item.kind, item.printed


def _is_finite(value):
    return isinstance(value, Real) and math.isfinite(value)


def read_paper(key: str, text: str) -> Paper:
    """Return the Paper in the text of a TOML file: `items`, `grids` of numbers and `causes`.

    A grid gives one item for each row and column, with id "{id}.{row}.{column}" and a `where` such as "Table 4, row
    {row}, column {column}"; an empty cell is no item, and "?" is one that our copy of the paper has lost. Raises
    ValueError for a malformed file, naming the file, the entry and what it needs.
    """
    file = f"{key}.toml"
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{file}: {error}") from None
    for name, entries in content.items():
        if name not in ("items", "grids", "causes", "tables", "contents") or not isinstance(entries, list):
            raise ValueError(f"{file}: needs lists of items, grids and causes, got {name} = {entries!r}")
    contents_rows = [Row(**row) for row in content.pop("contents", [])]
    layouts = [Layout(**table) for table in content.pop("tables", [])]
    layouts += [_grid_layout(grid) for grid in content.get("grids", []) if "title" in grid]
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
    return Paper(key, items, causes, layouts, contents_rows)


def _cells(file, grid):
    """Yield the entries of a grid, as they would stand among the items."""
    need = "id, where with {row} and {column}, columns, and rows with a text for each column"
    needed = {"columns", "id", "rows", "where"}
    if not isinstance(grid, dict) or not needed <= set(grid) <= needed | {
        "title",
        "names",
        "cause_of",
        "lost",
        "against",
        "wrong",
    }:
        raise ValueError(f"{file}, grid {grid!r:.40}: needs {need}")
    try:
        for row, cells in grid["rows"].items():
            for column, printed in zip(grid["columns"], cells, strict=True):
                if printed != "":
                    place = grid["where"].format(row=row, column=column)
                    why = grid.get("cause_of", {})
                    cause = grid.get("lost", "") if printed == "?" else why.get(row, why.get(column, ""))
                    made = {"id": f"{grid['id']}.{row}.{column}", "where": place, "kind": "number", "printed": printed}
                    yield (
                        made
                        | ({"cause": cause} if cause else {})
                        | ({"against": grid["against"]} if cause and printed != "?" else {})
                    )
    except (TypeError, LookupError, AttributeError, ValueError) as error:
        raise ValueError(f"{file}, grid {grid!r:.40}: needs {need} ({error})") from None


def _grid_layout(grid):
    """Return the Layout of a grid: its names, if it has some, beside the numbers of rows and columns."""
    names = grid.get("names", grid["columns"])
    head = ["", *(f"{number} {name}" for number, name in zip(grid["columns"], names, strict=True))]
    rows = []
    for (row, cells), name in zip(grid["rows"].items(), names, strict=True):
        items = [
            f"{{{grid['id']}.{row}.{column}}}" if cell else ""
            for column, cell in zip(grid["columns"], cells, strict=True)
        ]
        rows.append([f"{row} {name}", *items])
    return Layout(grid["id"], grid["title"], head, rows, grid=True, wrong=grid.get("wrong", ""))


def _made(make, entry, kinds, file):
    """Return the Item or Cause that an entry describes, or raise."""
    names = [field.name for field in fields(make)]
    needed = [field.name for field in fields(make) if field.default is MISSING]
    if not isinstance(entry, dict) or not set(needed) <= set(entry) <= set(names):
        raise ValueError(f"{file}: needs {', '.join(needed)}, got {entry!r}")
    for name, value in entry.items():
        if name != "against" and (not isinstance(value, str) or not value):
            raise ValueError(f"{file}, {entry['id']!r}: needs a text for {name}, got {value!r}")
    if entry["kind"] not in kinds:
        raise ValueError(f"{file}, {entry['id']!r}: needs kind {' or '.join(kinds)}, got {entry['kind']!r}")
    return make(**entry)


def keys() -> list[str]:
    """Return the keys of all papers.

    >>> "2014_gsm_2d" in keys()
    True
    """
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def published(key: str) -> Paper:
    """Return one Paper, to be checked item by item. Raises ValueError for an unknown key and for a malformed file.

    >>> paper = published("2014_gsm_2d")
    >>> paper.check("speedup.kf-lf-a", 670 / 509)
    Section 6, after Table 4 (i): printed 1.316; computed 1.31631: reproduced
    """
    if key not in keys():
        raise ValueError(f"key: needs one of {', '.join(keys())}, got {key!r}")
    return read_paper(key, (FOLDER / f"{key}.toml").read_text(encoding="utf-8"))


def stored_verdicts(notebook: str | Path) -> Verdicts:
    """Return the Verdicts that the cells of an executed notebook store, in the paper's order, without running it.

    The paper is the one that the notebook is named for. Raises ValueError for a file that stores none, and for
    verdicts that do not fit this version of the package.
    """
    path = Path(notebook)
    paper = published(path.stem)
    records = []
    try:
        for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
            for output in cell.get("outputs", []):
                records += [{**record, "cell": cell["id"]} for record in output.get("data", {}).get(MIME, [])]
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise ValueError(f"{path}: needs an executed notebook ({error!r})") from None
    if not records:
        raise ValueError(f"{path}: needs an executed notebook whose cells end with paper.report()")
    given = _read_verdicts(path, paper, records)
    order = {id: place for place, id in enumerate(paper.items)}
    given.sort(key=lambda each: order.get(each.id, len(order)))
    return Verdicts(given, paper.causes_by_paper())


def shipped_verdicts(*some: str) -> Verdicts:
    """Return the Verdicts of some papers, or of all, that come with the package.

    Raises ValueError for a file whose verdicts do not fit this version of the package.
    """
    given = []
    causes = {}
    for key in some or keys():
        paper = published(key)
        path = FOLDER / f"{key}.json"
        if path.is_file():
            try:
                records = json.loads(path.read_text(encoding="utf-8"))
            except ValueError as error:
                raise ValueError(f"{path}: {error}") from None
            given += _read_verdicts(path, paper, records)
        causes |= paper.causes_by_paper()
    return Verdicts(given, causes)


def _read_verdicts(path, paper, records):
    """Return the records of a file as a list of Verdicts on this paper, or raise."""
    cure = f"run `python -m reproduction reproduce {paper.key}`"
    try:
        given = [Verdict(**record) for record in records]
    except TypeError as error:
        raise ValueError(f"{path}: needs verdicts of this version ({error}): {cure}") from None
    known = {"paper": [paper.key], "verdict": VERDICTS, "basis": BASES, "cause": ["", *paper.causes]}
    for each, (name, values) in product(given, known.items()):
        value = getattr(each, name)
        if value not in values:
            raise ValueError(f"{path}: needs verdicts of this version, got {name} {value!r} of {each.id!r}: {cure}")
    return given
