"""What the papers printed, and the verdict on each: computed, never typed."""

import json
import linecache
import re
import sys
import tomllib
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from difflib import get_close_matches
from importlib.resources import files
from os import PathLike
from pathlib import Path
from types import MappingProxyType

import numpy as np

from . import checks
from .tables import Table

KINDS = ("number", "formula", "claim", "figure")
REPRODUCED, WITHIN_BAND, DIFFERS = "reproduced", "within band", "differs"
ERRATUM, CANNOT_BE_CHECKED, NONE_YET = "erratum", "cannot be checked", "no verdict"
VERDICTS = (REPRODUCED, WITHIN_BAND, DIFFERS, ERRATUM, CANNOT_BE_CHECKED)
# What a notebook stores for machines beside the table that it shows: `python -m mpt_helpers verdicts` reads it.
MIME = "application/vnd.mpt-helpers.verdicts+json"
# A cell that the paper prints and our copy of it has lost.
LOST = "?"


@dataclass(frozen=True)
class Item:
    """One number, formula, claim or figure of a paper: where it stands, what kind it is, what is printed."""

    id: str
    where: str
    kind: str
    printed: str

    def __post_init__(self):
        for name, value in vars(self).items():
            if not isinstance(value, str) or not value:
                checks.refuse(f"{name} of {self.id!r}", "a text", repr(value))
        if self.kind not in KINDS:
            checks.refuse(f"kind of {self.id!r}", " or ".join(KINDS), repr(self.kind))
        digits = self.kind != "number" or re.fullmatch(r"[+-]?\d+(\.\d+)?", self.printed, re.ASCII)
        if not digits and self.printed != LOST:
            checks.refuse(f"printed of {self.id!r}", "a number as printed", repr(self.printed))

    def agrees(self, value):
        """Say whether a number rounds to the printed digits.

        A tie may have been rounded either way, and a tie in decimals may be a little off as a double. Raises ValueError
        or TypeError for an item or a value that is no number.

        >>> Item("t", "Table 4", "number", "1.316").agrees(670 / 509)
        True
        """
        value = checks.number("value", value)
        if self.kind != "number" or self.printed == LOST:
            checks.refuse("item", "a legible number", f"{self.id!r}, {self.printed!r}")
        decimals = len(self.printed.partition(".")[2])
        return abs(value - float(self.printed)) <= 0.5 * 10**-decimals * (1 + 1e-9)


@dataclass(frozen=True)
class Verdict:
    """The verdict on one item, with both values and, where they differ, the reason.

    cell is the notebook cell that gave it: a checksum of its source while it runs, its id once it is stored.
    """

    paper: str
    id: str
    where: str
    kind: str
    printed: str
    computed: str
    verdict: str
    reason: str
    cell: str | None = None

    def __repr__(self):
        reason = f" ({self.reason})" if self.reason else ""
        return f"{self.where}: printed {self.printed}; computed {self.computed}: {self.verdict}{reason}"


class Verdicts(Sequence):
    """Verdicts as a table; a notebook that displays it stores them for machines too.

    >>> Verdicts([Verdict("p", "t1", "Table 1", "number", "2", "2", "reproduced", "")])
    id  where    printed  computed  verdict     reason
    t1  Table 1  2        2         reproduced
    """

    COLUMNS = ("id", "where", "printed", "computed", "verdict", "reason")

    def __init__(self, verdicts):
        self._verdicts = checks.several("verdicts", verdicts, "Verdicts", least=0)
        for each in self._verdicts:
            checks.instance("verdicts", each, Verdict)

    def __getitem__(self, i):
        return self._verdicts[i]

    def __len__(self):
        return len(self._verdicts)

    def table(self):
        """Return the table."""
        return Table(self.COLUMNS, [[getattr(each, name) for name in self.COLUMNS] for each in self])

    def counts(self):
        """Return how many there are of each verdict, as a table."""
        given = [each.verdict for each in self]
        rows = [[verdict, given.count(verdict)] for verdict in (*VERDICTS, NONE_YET) if verdict in given]
        return Table(["verdict", "items"], [*rows, ["all", len(given)]])

    def look_at(self):
        """Return those verdicts that a reader should look at: all that are neither reproduced nor within band."""
        return [each for each in self if each.verdict not in (REPRODUCED, WITHIN_BAND)]

    def records(self):
        """Return the verdicts as a list of dictionaries of text."""
        return [asdict(each) for each in self]

    def __repr__(self):
        return repr(self.table())

    def _repr_mimebundle_(self, include=None, exclude=None):
        return {"text/plain": repr(self), "text/html": self.table()._repr_html_(), MIME: self.records()}


class Paper:
    """The published values of one paper and the verdicts given so far; made by `published`."""

    def __init__(self, key, items):
        self.key = checks.instance("key", key, str)
        for each in (items := checks.several("items", items, "Items", least=0)):
            checks.instance("items", each, Item)
        self.items = MappingProxyType({item.id: item for item in items})
        self._verdicts = {}

    def check(self, id, value, *, band=None, against=(), reason=""):
        """Compare a computed number with the printed one.

        Without a band it is `reproduced` when it rounds to the printed digits. With a band (low, high), for Monte Carlo
        results, it is `within band` when the printed number lies inside. Otherwise it `differs`, for the given reason.
        It is an `erratum` if the value follows from other items of the paper, named by `against`, that were themselves
        reproduced: then the paper contradicts itself.

        Returns the Verdict. Raises ValueError for an unknown id, an id checked twice, an item that is not a number, a
        band upside down, and an item of `against` that was not reproduced; ValueError or TypeError for a value or band
        that is not one.
        """
        item = self._item(id, "number")
        value = checks.number("value", value)
        computed = f"{value:.6g}"
        if band is None:
            verdict = REPRODUCED if item.agrees(value) else DIFFERS
        else:
            band = checks.several("band", band, "(low, high)")
            if len(band) != 2:
                checks.refuse("band", "(low, high)", checks.brief(band))
            low, high = (checks.number("band", edge) for edge in band)
            if low > high:
                checks.refuse("band", "(low, high) with low <= high", f"({low:.6g}, {high:.6g})")
            verdict = WITHIN_BAND if low <= float(item.printed) <= high else DIFFERS
            computed += f" [{low:.6g}, {high:.6g}]"
        return self._give(item, computed, verdict, against, reason)

    def claim(self, id, holds, evidence, *, against=(), reason=""):
        """Record whether a claim, a formula or what a figure shows holds, with the computed evidence.

        It is `reproduced` when it holds, an `erratum` when it does not and `against` names reproduced items of the
        paper that say otherwise, and `differs` when it does not for another reason. Returns the Verdict. Raises as
        `check` does.
        """
        item = self._item(id, "formula", "claim", "figure")
        if not isinstance(holds, (bool, np.bool_)):
            checks.refuse("holds", "True or False", checks.brief(holds))
        checks.instance("evidence", evidence, str)
        return self._give(item, evidence, REPRODUCED if holds else DIFFERS, against, reason)

    def cannot_check(self, id, missing):
        """Record that an item cannot be checked, and what the paper leaves out. Returns the Verdict."""
        item = self._item(id, *KINDS, lost_too=True)
        checks.instance("missing", missing, str)
        return self._record(item, "-", CANNOT_BE_CHECKED, missing)

    def given(self, *prefixes):
        """Return a table of the verdicts on the items whose id starts with one of these prefixes.

        Raises ValueError or TypeError for none, and for one with which no id starts.
        """
        for prefix in checks.several("prefixes", prefixes, "at least one beginning of an id"):
            if not any(id.startswith(checks.instance("prefixes", prefix, str)) for id in self.items):
                checks.refuse("prefixes", f"the beginning of an id of {self.key}", repr(prefix))
        columns = ("where", "printed", "computed", "verdict", "reason")
        verdicts = [each for each in self.verdicts() if each.id.startswith(prefixes)]
        return Table(columns, [[getattr(each, name) for name in columns] for each in verdicts])

    def implied(self, grid, known, limit=10_000):
        """Return from which whole numbers a grid of ratios follows.

        Entry "{grid}.{i}.{j}" is printed as value i over value j. known maps some of the indices, as text, to their
        values; the result maps each other index to the whole numbers up to `limit` that agree with every legible
        ratio to a known value. Raises ValueError or TypeError for an unknown grid or index, a known value that is not
        positive and a limit that is no count.
        """
        checks.instance("grid", grid, str)
        checks.count("limit", limit)
        cells = {tuple(id.split(".")[1:]): item for id, item in self.items.items() if id.startswith(f"{grid}.")}
        if not cells:
            checks.refuse("grid", f"a grid of {self.key}", repr(grid))
        for index, value in checks.instance("known", known, Mapping).items():
            if not any(index in place for place in cells):
                checks.refuse("known", f"indices of the grid {grid}", repr(index))
            checks.positive(f"known[{index!r}]", value)
        legible = {place: item for place, item in cells.items() if item.printed != LOST}
        unknown = dict.fromkeys(i for place in legible for i in place if i not in known)
        for index in unknown:
            above = [(item, known[j]) for (i, j), item in legible.items() if i == index and j in known]
            below = [(item, known[i]) for (i, j), item in legible.items() if j == index and i in known]
            unknown[index] = [
                number
                for number in range(1, limit + 1)
                if all(item.agrees(number / other) for item, other in above)
                and all(item.agrees(other / number) for item, other in below)
            ]
        return unknown

    def verdicts(self):
        """Return the Verdicts on all items, in the paper's order."""
        none = {
            id: Verdict(self.key, **vars(item), computed="", verdict=NONE_YET, reason="")
            for id, item in self.items.items()
        }
        return Verdicts((none | self._verdicts).values())

    def _item(self, id, *kinds, lost_too=False):
        if checks.instance("id", id, str) not in self.items:
            near = get_close_matches(str(id), self.items, n=3, cutoff=0) or ["none"]
            checks.refuse("id", f"an item of {self.key}", f"{id!r}; the nearest are {', '.join(near)}")
        item = self.items[id]
        if id in self._verdicts:
            checks.refuse("id", "an item without a verdict", f"{id!r} for the second time")
        if item.kind not in kinds:
            checks.refuse("id", f"a {' or '.join(kinds)}", f"{id!r}, a {item.kind}")
        if item.printed == LOST and not lost_too:
            checks.refuse("id", "an item that is legible", f"{id!r}, lost in our copy of the paper")
        return item

    def _give(self, item, computed, verdict, against, reason):
        checks.instance("reason", reason, str)
        for id in checks.several("against", against, "a list of ids", least=0):
            if checks.instance("against", id, str) not in self._verdicts or self._verdicts[id].verdict != REPRODUCED:
                checks.refuse("against", "items of the paper that were reproduced before", repr(id))
        if verdict != DIFFERS:
            return self._record(item, computed, verdict, "")
        if not reason:
            checks.refuse(
                "reason", f"a reason, for {item.id} differs", f"none (printed {item.printed}, computed {computed})"
            )
        if against:
            sides = "; ".join(f"{self.items[id].where}: {self.items[id].printed}" for id in against)
            return self._record(item, computed, ERRATUM, f"{reason} Against {sides}.")
        return self._record(item, computed, verdict, reason)

    def _record(self, item, computed, verdict, reason):
        given = Verdict(self.key, **vars(item), computed=computed, verdict=verdict, reason=reason, cell=_cell())
        self._verdicts[item.id] = given
        return given


def keys():
    """Return the keys of all papers that have published values.

    >>> "2014_gsm_2d" in keys()
    True
    """
    return sorted(path.name.removesuffix(".toml") for path in _folder().iterdir() if path.name.endswith(".toml"))


def published(key):
    """Return the published values of one paper, to be checked one by one.

    Raises ValueError for an unknown key and for a file that does not say what it must, naming both.

    >>> paper = published("2014_gsm_2d")
    >>> paper.check("speedup.kf-lf-a", 670 / 509)
    Section 6, after Table 4 (i): printed 1.316; computed 1.31631: reproduced
    """
    if checks.instance("key", key, str) not in keys():
        checks.refuse("key", f"one of {', '.join(keys())}", repr(key))
    return Paper(key, read_items(key, _folder().joinpath(f"{key}.toml").read_text(encoding="utf-8")))


def read_items(key, text):
    """Read the items from the text of a TOML file: `items`, one table each, and `grids` of numbers.

    A grid gives one item for each row and column, with id "{id}.{row}.{column}" and a place such as "Table 4, row
    {row}, column {column}"; an empty cell is none, and "?" is one that our copy of the paper has lost. Raises
    ValueError, naming the file, for a text that does not say what it must.
    """
    checks.instance("key", key, str)
    checks.instance("text", text, str)
    try:
        content = tomllib.loads(text)
        items = [Item(**item) for item in content.pop("items")]
        for grid in content.pop("grids", []):
            items += _grid_items(**grid)
    except (TypeError, LookupError, AttributeError, ValueError) as error:
        raise ValueError(f"{key}.toml: {error}") from error
    if content:
        checks.refuse(f"{key}.toml", "only items and grids", ", ".join(content))
    ids = [item.id for item in items]
    twice = sorted({id for id in ids if ids.count(id) > 1})
    if twice:
        checks.refuse(f"{key}.toml", "each id once", ", ".join(twice))
    return items


def _grid_items(id, where, columns, rows):
    for row, cells in rows.items():
        for column, printed in zip(columns, cells, strict=True):
            if printed != "":
                place = where.format(row=row, column=column)
                yield Item(id=f"{id}.{row}.{column}", where=place, kind="number", printed=printed)


def stored_verdicts(notebook):
    """Return the Verdicts that an executed notebook stores, without running it.

    Raises ValueError when the file is not a notebook or stores none.
    """
    path = Path(checks.instance("notebook", notebook, (str, PathLike)))
    try:
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        stored = [out["data"][MIME] for cell in cells for out in cell.get("outputs", []) if MIME in out.get("data", {})]
        ids = {_mark("".join(cell["source"])): cell["id"] for cell in cells if cell.get("execution_count")}
        verdicts = [Verdict(**record) for record in stored[-1]]
        return Verdicts(replace(each, cell=ids.get(each.cell)) for each in verdicts)
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise ValueError(f"{path}: needs an executed notebook that ends with its verdicts ({error!r})") from error


def counts_by_paper(verdicts):
    """Return how many there are of each verdict as a table: a row for each paper, and their sum.

    >>> counts_by_paper([Verdict("p", "t1", "Table 1", "number", "2", "2", "reproduced", "")])
    notebook  items  reproduced  within band  differs  erratum  cannot be checked
    p         1      1           0            0        0        0
    all       1      1           0            0        0        0
    """
    verdicts = checks.several("verdicts", verdicts, "Verdicts", least=0)
    papers = dict.fromkeys(checks.instance("verdicts", each, Verdict).paper for each in verdicts)
    given = {paper: [each.verdict for each in verdicts if each.paper == paper] for paper in papers}
    given["all"] = [each.verdict for each in verdicts]
    rows = [[paper, len(own), *(own.count(verdict) for verdict in VERDICTS)] for paper, own in given.items()]
    return Table(["notebook", "items", *VERDICTS], rows)


def _cell():
    # The running cell is known by its source: nbval, for one, runs cells without a number.
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    frame = sys._getframe() if shell else None
    while frame and frame.f_globals is not shell.user_ns:
        frame = frame.f_back
    return _mark("".join(linecache.getlines(frame.f_code.co_filename))) if frame else None


def _mark(source):
    return f"{zlib.crc32(source.strip().encode()):08x}"


def _folder():
    return files(__package__).joinpath("published")
