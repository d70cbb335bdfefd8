"""The ledger's files: what a paper prints, one TOML each, and the verdicts that notebooks and the package store."""

from __future__ import annotations

import json
import re
import tomllib
from collections import Counter
from collections.abc import Mapping
from dataclasses import MISSING, fields
from itertools import product
from pathlib import Path

from .contents import Row
from .items import KINDS, About, Cause, Item
from .paper import Paper
from .shown import Layout
from .verdicts import BASES, CAUSE_KINDS, MIME, VERDICTS, Verdict, Verdicts

FOLDER = Path(__file__).parent
LISTS = ("items", "grids", "causes", "tables", "contents")
GRID_NEEDS = {"columns", "id", "rows", "where"}
GRID_HAS = GRID_NEEDS | {"title", "names", "cause_of", "lost", "against", "wrong"}


def read_paper(key: str, text: str) -> Paper:
    """Return the Paper in the text of a TOML file.

    It has lists of `items`, `grids` of numbers and `causes`; and, for the notebook, `tables` as the paper lays them
    out, a line of `contents` for each of its headings, and what the `paper` is. A grid gives one item for each row and
    column, with id "{id}.{row}.{column}" and a `where` such as "Table 4, row {row}, column {column}"; an empty cell is
    no item, and "?" is one that our copy of the paper has lost. Raises ValueError for a malformed file, naming the
    file, the entry and what it needs.
    """
    file = f"{key}.toml"
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{file}: {error}") from None
    about = _made(About, content.pop("paper"), file) if "paper" in content else None
    for name, entries in content.items():
        if name not in LISTS or not isinstance(entries, list):
            raise ValueError(f"{file}: needs lists of {', '.join(LISTS)}, got {name} = {entries!r}")
    grids = content.get("grids", [])
    cells = [cell for grid in grids for cell in _cells(file, grid)]
    items = [_made(Item, entry, file, KINDS) for entry in content.get("items", []) + cells]
    causes = [_made(Cause, entry, file, CAUSE_KINDS) for entry in content.get("causes", [])]
    layouts = [_made(Layout, entry, file) for entry in content.get("tables", [])]
    layouts += [_grid_layout(grid) for grid in grids if "title" in grid]
    rows = [_made(Row, entry, file) for entry in content.get("contents", [])]
    for item in items:
        if item.kind == "number" and not re.fullmatch(r"\?|[+-]?\d+(\.\d+)?", item.printed, re.ASCII):
            raise ValueError(f"{file}, {item.id!r}: needs a number as printed, got {item.printed!r}")
    for made in (items, causes, layouts):
        twice = [id for id, times in Counter(each.id for each in made).items() if times > 1]
        if twice:
            raise ValueError(f"{file}: needs each id once, got {', '.join(twice)} again")
    known = {item.id for item in items}
    for item in items:
        if item.cause and item.cause not in {cause.id for cause in causes}:
            raise ValueError(f"{file}, {item.id!r}: needs a cause of this file, got {item.cause!r}")
        if not set(item.against) <= known:
            raise ValueError(f"{file}, {item.id!r}: needs a list of ids in `against`, got {item.against!r}")
    for layout in layouts:
        if not set(layout.ids) <= known:
            unknown = ", ".join(id for id in layout.ids if id not in known)
            raise ValueError(f"{file}, table {layout.id!r}: needs ids of items in braces, got {unknown}")
    return Paper(key, items, causes, about, layouts, rows)


def _cells(file, grid):
    """Yield the entries of a grid, as they would stand among the items."""
    need = "id, where with {row} and {column}, columns, and rows with a text for each column"
    if not isinstance(grid, dict) or not GRID_NEEDS <= set(grid) <= GRID_HAS:
        raise ValueError(f"{file}, grid {grid!r:.40}: needs {need}")
    cause_of = grid.get("cause_of", {})
    try:
        for row, cells in grid["rows"].items():
            for column, printed in zip(grid["columns"], cells, strict=True):
                if printed == "":
                    continue
                where = grid["where"].format(row=row, column=column)
                entry = {"id": f"{grid['id']}.{row}.{column}", "where": where, "kind": "number", "printed": printed}
                cause = grid.get("lost") if printed == "?" else cause_of.get(row, cause_of.get(column))
                if cause:
                    entry["cause"] = cause
                    entry["against"] = grid.get("against", [])
                yield entry
    except (TypeError, LookupError, AttributeError, ValueError) as error:
        raise ValueError(f"{file}, grid {grid!r:.40}: needs {need} ({error})") from None


def _grid_layout(grid):
    """Return the Layout of a grid: names of rows and columns, if it has some, behind their numbers."""
    names = grid.get("names", [""] * len(grid["columns"]))
    named = [f"{number} {name}".strip() for number, name in zip(grid["columns"], names, strict=True)]
    rows = []
    for (row, cells), name in zip(grid["rows"].items(), names, strict=True):
        columns = zip(grid["columns"], cells, strict=True)
        items = [f"{{{grid['id']}.{row}.{column}}}" if printed else "" for column, printed in columns]
        rows.append([f"{row} {name}".strip(), *items])
    head = ["printed | counted", *named]
    return Layout(grid["id"], grid["title"], head, rows, grid=True, wrong=grid.get("wrong", ""))


def _made(make, entry, file, kinds=()):
    """Return what an entry describes, an Item or another of these classes, or raise."""
    needed = [field.name for field in fields(make) if field.default is MISSING]
    types = {field.name: field.type for field in fields(make)}
    if not isinstance(entry, Mapping) or not set(needed) <= set(entry) <= set(types):
        raise ValueError(f"{file}: needs {', '.join(needed)}, got {entry!r}")
    name = entry.get("id", entry.get("heading", "paper"))
    for field, value in entry.items():
        if types[field] == "str" and (not isinstance(value, str) or not (value or field == "doi")):
            raise ValueError(f"{file}, {name!r}: needs a text for {field}, got {value!r}")
    if kinds and entry["kind"] not in kinds:
        raise ValueError(f"{file}, {name!r}: needs kind {' or '.join(kinds)}, got {entry['kind']!r}")
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
        for number, cell in enumerate(json.loads(path.read_text(encoding="utf-8"))["cells"], 1):
            name = cell.get("id", str(number))  # before nbformat 4.5 cells have no ids
            for output in cell.get("outputs", []):
                records += [{**record, "cell": name} for record in output.get("data", {}).get(MIME, [])]
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise ValueError(f"{path}: needs an executed notebook ({error!r})") from None
    if not records:
        raise ValueError(f"{path}: needs an executed notebook whose cells give verdicts")
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
