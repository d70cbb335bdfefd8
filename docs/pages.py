"""Put together what Sphinx builds the site from: run as `python docs/pages.py` in the project's folder.

Everything that says what the papers print and what was computed comes from the verdicts in the executed notebooks. The
few sentences per paper are in papers.toml, where each number is looked up in a verdict; home.py computes what the home
page says, corrections.py writes the corrections. The HTML is in templates/.
"""

import ast
import base64
import builtins
import csv
import doctest
import importlib
import inspect
import json
import re
import shutil
import subprocess
import tomllib
import zlib
from functools import cached_property
from pathlib import Path
from textwrap import shorten
from typing import NamedTuple
from urllib.parse import urlencode

import break_sensor
import corrections
import home
import nbformat
import numpy as np
import speed
import yaml
from corrections import place
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

import mpt_helpers as mpt
from reproduction import figures, plots
from reproduction.ledger import Verdicts, keys, stored_verdicts
from reproduction.ledger.verdicts import (
    BASES,
    CANNOT_BE_CHECKED,
    CAUSE_KINDS,
    DIFFERS,
    ERRATUM,
    FIELDS,
    IN_PART,
    OF_CLAIMS,
    REPRODUCED,
    VERDICTS,
    WITHIN_BAND,
)

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
BUILD = DOCS / "_build"
SAVED = re.compile(r'save_figure\([^"]+, "(\w+)"\)')
# More verdicts than this that share their table, outcome and cause become one row, or one chip, that opens.
FOLD = 4
PART_2 = re.compile(r"(?m)^## Part II\b")
# What the filter of the values calls all that did not come out as printed.
NOT_REPRODUCED = "not reproduced"
# What a reader of the values comes for, first.
FAILS = (ERRATUM, DIFFERS)
WORST_FIRST = (*FAILS, IN_PART, CANNOT_BE_CHECKED, WITHIN_BAND, REPRODUCED)
# What a page holds for the site, hidden where Markdown is shown as it is: a template.
INCLUDE = re.compile(r"<!-- include (\w+\.html) -->")
CHECKOUT = re.compile(r" ?<!-- checkout -->.*?<!-- /checkout -->", re.DOTALL)  # for readers of a checkout only


SOURCE = "<!-- archive -->"  # where the site leads to the source, which a reader of a checkout has
# Pages whose blocks of Python can be downloaded as a notebook, and those that stand below the guide, where they are.
GUIDES = ("guide", "by_hand")
BELOW_GUIDE = {
    "by_hand": "Every step by hand",
    "small_processor": "A small processor",
    "lasting": "Errors that last",
    "other_packages": "From another package",
    "rinex": "From RINEX files",
}


class Group(NamedTuple):
    """Verdicts that share a table or section of a paper, the outcome and the cause."""

    place: str
    verdict: str
    cause: str
    members: list

    @property
    def folds(self):
        """Say whether they are shown as one that opens."""
        return len(self.members) > FOLD


class Drawn(NamedTuple):
    """A figure of a notebook: its file's name, what it is called, its section, its caption, its finding."""

    name: str
    label: str
    section: str
    caption: str
    finding: str
    cell: str
    alt: str
    width: int
    height: int


def stored_notebook(key):
    """Return a notebook as it is stored."""
    return json.loads((ROOT / "notebooks" / f"{key}.ipynb").read_text(encoding="utf-8"))


def source(cell):
    """Return the source of a notebook's cell as text."""
    return "".join(cell["source"])


def title(cells):
    """Return the title of a notebook."""
    return re.match(r"# (.*)", source(cells[0]))[1]


def grouped(verdicts):
    """Return verdicts as Groups, in the order of their first members; few alike stay single."""
    alike = {}
    for each in verdicts:
        alike.setdefault((place(each), each.verdict, each.cause), []).append(each)
    groups = [Group(*shared, members) for shared, members in alike.items()]
    single = [Group(*group[:3], [each]) for group in groups if not group.folds for each in group.members]
    order = {id(each): i for i, each in enumerate(verdicts)}
    return sorted([*filter(lambda group: group.folds, groups), *single], key=lambda group: order[id(group.members[0])])


def worst_first(verdicts):
    """Return verdicts with those first that fail, then those under a condition; otherwise in the paper's order."""
    return sorted(verdicts, key=lambda each: WORST_FIRST.index(each.verdict))


def by_cause(given, kind):
    """Return the verdicts whose cause is of this kind."""
    return [each for each in given if each.cause and given.causes[each.paper, each.cause].kind == kind]


def claims(given, *outcomes):
    """Return the claims with one of these verdicts, one verdict after the other, and what else fails by a finding."""
    findings = by_cause(given, "finding")
    listed = [each for each in given if each.kind == "claim" or each in findings]
    return [each for outcome in outcomes for each in listed if each.verdict == outcome]


def cause_options(given):
    """Return (id, sentence) of the causes that verdicts name; of an id that papers share, the first sentence."""
    named = {(each.paper, each.cause) for each in given if each.cause}
    sentences = {}
    for (paper, id), cause in given.causes.items():
        if (paper, id) in named:
            sentences.setdefault(id, cause.sentence)
    return sorted(sentences.items(), key=lambda option: option[1])


def common(members):
    """Return the filter of the values page that shows these verdicts: all the fields in which they agree."""
    values = {name: {getattr(each, name) for each in members} for name in ("paper", "kind", "verdict", "cause")}
    values["place"] = {place(each) for each in members}
    return urlencode({name: min(found) for name, found in values.items() if len(found) == 1 and found != {""}})


def figures_of(key, cells):
    """Return the figures of a notebook; the caption is the paragraph that begins with **Figure 1.** or so.

    What a figure found is its own title or that of its only panel. Without one it is the first sentence of its caption,
    or the question of its section.
    """
    prose = [part for cell in cells if cell["cell_type"] == "markdown" for part in source(cell).split("\n\n")]
    drawn, section = [], ""
    for cell in cells:
        if cell["cell_type"] == "markdown":
            section = [section, *re.findall(r"(?m)^#{1,3} (?:\d+\. )?(.*)", source(cell))][-1]
        for name in SAVED.findall(source(cell)) if cell["cell_type"] == "code" else []:
            own = name.removeprefix(f"{key}_")
            label = f"Figure {own[3:]}" if re.fullmatch(r"fig\d+", own) else f"Figure `{own}`"
            captions = [part for part in prose if label in names_of(part)]
            (shown,) = (out for out in cell["outputs"] if "image/png" in out.get("data", {}))
            alt = shown["metadata"]["image/png"]["alt"]
            above, only = drawn_titles("".join(shown["data"].get("text/plain", "")))
            width, height = svg_size(ROOT / "figures" / f"{name}.svg")
            caption = re.sub(r"\]\((\w+\.ipynb)", r"](notebooks/\1", captions[0]) if captions else ""
            finding = above or only or conclusion(caption) or section
            drawn.append(Drawn(name, label, section, caption, finding, cell["id"], alt, width, height))
    return drawn


def drawn_titles(description):
    r"""Return the title above a figure's panels and that of its only panel, from its description: "" if there is none.

    >>> drawn_titles("late.png\ntext 'One step\\nlate'\naxes 1: 'error' x '' linear 0..1\naxes 2: x '' linear 0..1")
    ('One step late', '')
    >>> drawn_titles("gain.png\naxes 1: 'It settles' x 'step k' linear 0..1; y '' linear 0..1")
    ('', 'It settles')
    """
    quoted = r"""('(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*")"""
    above = re.match(rf"[^\n]*\ntext {quoted}", description)
    panels = re.findall(rf"(?m)^axes \d+: (?:{quoted} )?x ", description)
    only = panels[0] if len(panels) == 1 else ""
    return tuple(" ".join(ast.literal_eval(each).split()) if each else "" for each in (above[1] if above else "", only))


def conclusion(caption):
    """Return the first sentence of a caption, behind the figure's name and without markup."""
    found = re.match(r"\*\*Figure [^*]*\*\* *(?:\*\*(.+?)\*\*|([^*]+?[.](?=\s|$)))", caption.replace("\n", " "))
    return (found[1] or found[2]).strip() if found else ""


def names_of(paragraph):
    """Return the figures that a paragraph is the caption of, as in **Figure 1, Figure 2.** or **Figure `name`.**."""
    head = re.match(r"\*\*(.*?)\.?\*\*", paragraph)
    return head[1].split(", ") if head else []


def svg_size(path):
    """Return the width and height of an SVG, in points."""
    head = path.read_text(encoding="utf-8")[:2000]
    return tuple(round(float(size)) for size in re.search(r'<svg [^>]*viewBox="0 0 ([\d.]+) ([\d.]+)"', head).groups())


def texts(given):
    """Return papers.toml with what it looks up or counts in verdicts; raises KeyError for an item that is not there."""
    by_id = {(each.paper, each.id): each for each in given}
    lookups = {
        "printed": lambda paper, id: by_id[paper, id].printed,
        "computed": lambda paper, id: by_id[paper, id].computed,
        "failing": lambda paper, table: sum(
            each.verdict in FAILS and each.id.startswith(f"{table}.") for each in given.of(paper)
        ),
    }
    plain = Environment(undefined=StrictUndefined)
    said = plain.from_string((DOCS / "papers.toml").read_text(encoding="utf-8")).render(lookups)
    return tomllib.loads(said)


def unbroken(text):
    """Return a text in which no line breaks between a number and its unit, or inside H = [1 0].

    >>> unbroken("1.5 m at 3 km") == "1.5\N{NO-BREAK SPACE}m at 3\N{NO-BREAK SPACE}km"
    True
    """
    return re.sub(
        r"(?<=\d) (?=(?:m|km|σ|s|fixes)\b)|(?<=H) (?==)|(?<==) (?=\[)|(?<=\[1) (?=[Δ0])", "\N{NO-BREAK SPACE}", text
    )


def home_page(about, given, drawn):
    """Return the contents of the home page: the words of papers.toml with the numbers of home.py in them.

    drawn maps names of figures to Drawn. Raises ValueError for a mistake whose figure no notebook draws.
    """
    numbers, costs = home.choice() | given.checked(), home.mistakes()

    def said(mistake):
        if mistake["figure"] not in drawn:
            known = ", ".join(sorted(drawn))
            raise ValueError(
                f"docs/papers.toml: the figure of the mistake {mistake['name']!r} must be one of {known}; "
                f"it is {mistake['figure']!r}"
            )
        words = {name: unbroken(text.format(**costs[mistake["name"]])) for name, text in mistake.items()}
        return words | {"drawn": drawn[mistake["figure"]], "key": key_of(mistake["figure"])}

    return {
        **{name: unbroken(text.format(**numbers)) for name, text in about["home"].items()},
        "choice": [{name: unbroken(text.format(**numbers)) for name, text in row.items()} for row in about["choice"]],
        "mistakes": [said(each) for each in about["mistakes"]],
        "lost": numbers["lost"],
        "claims": sum(each.kind == "claim" for each in given),
    }


def key_of(figure):
    """Return the paper to which a figure belongs."""
    (key,) = (each for each in keys() if figure.startswith(f"{each}_"))
    return key


def draw_sensor(folder):
    """Draw what the first figure shows first, as sensor.svg, and return what the page needs to know of it."""
    fig = break_sensor.draw("gap")
    alt = figures.save_figure(fig, "sensor", folder).alt
    data = break_sensor.for_the_page()
    return {
        "data": data,
        "json": json.dumps(data, ensure_ascii=False),
        "size": svg_size(folder / "sensor.svg"),
        "alt": f"{alt} {break_sensor.said('gap')}",
        "said": break_sensor.said("gap"),
        "candidates": break_sensor.CANDIDATES,
    }


def citations():
    """Return CITATION.cff, how to cite this project, and the reference to each paper by its year."""
    cff = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    (author,) = (each["name"] for each in cff["authors"])
    year = cff["date-released"][:4]
    own = f"{author[0].upper()}{author[1:]} ({year}). {cff['title']}. Version {cff['version']}."
    papers = {}
    for each in cff["references"]:
        names = ", ".join(f"{author['given-names']} {author['family-names']}" for author in each["authors"])
        volume = " ".join(str(each[name]) for name in ("volume", "issue") if name in each)
        at = f"{each['start']}-{each['end']}" if "start" in each else each["number"]
        papers[str(each["year"])] = f"{names}, {each['title']}, {each['journal']} {volume} ({each['year']}) {at}."
    return cff, own, papers


def prepared(key, notebook, page, whole):
    """Return a notebook as it is rendered, whole or as an article: there without cells of the ledger.

    page maps what stands between the cells: "top" after the title, "live" (figure, HTML) after that figure or else
    before Part II, and "verdicts", a function from a ledger cell to the HTML of its verdicts.
    """
    drawn = {each.cell: each for each in figures_of(key, notebook["cells"])}
    figure, live = page["live"]
    last_of_part_1 = None
    if not whole and figure.startswith(key):
        last_of_part_1 = end_of_part_1(notebook["cells"], {each.cell for each in drawn.values() if each.name == figure})
    cells, evidence = [], False
    for i, cell in enumerate(notebook["cells"]):
        text = source(cell)
        if cell["cell_type"] == "markdown":
            # In a checkout, docs/ and benchmarks/ stand beside notebooks/; on the site, their pages stand above it.
            text = text.replace("](../docs/", "](../").replace("](../benchmarks/README.md", "](../speed.md")
        made = {**cell, "source": text, "metadata": {**cell["metadata"], "id": cell["id"]}}
        ledger = "ledger" in cell["metadata"].get("tags", ())
        evidence = evidence or PART_2.search(text) is not None
        if made["cell_type"] == "code":
            made["outputs"] = [with_named_headers(each) for each in cell["outputs"]]
        made["metadata"]["tags"] = [] if whole or is_open(cell, evidence) else ["hide-input"]
        if ledger and not whole:
            cells.append(raw_cell(page["verdicts"](cell["id"])))
        else:
            if each := drawn.get(cell["id"]):
                made["metadata"] |= {"figure": each._asdict()}
            cells.append(made)
        if i == 0:
            cells.append(raw_cell(page["top"]))
        if i == last_of_part_1:
            cells.append(raw_cell(live))
    return {**notebook, "cells": cells}


def with_named_headers(output):
    """Return an output of a cell whose tables have no empty header: to a screen reader it would have no name."""
    if "text/html" not in output.get("data", {}):
        return output
    html = "".join(output["data"]["text/html"]).replace("<th></th>", "<td></td>")
    return {**output, "data": {**output["data"], "text/html": html}}


def end_of_part_1(cells, figure):
    """Return the cell after which the figure with sliders stands: its figure's, else the last one before Part II."""
    for i, cell in enumerate(cells):
        if cell["id"] in figure:
            return i
    ends = [i for i, cell in enumerate(cells) if PART_2.search(source(cell))]
    return ends[0] - 1 if ends else len(cells) - 1


def is_open(cell, evidence):
    """Tell whether the code of a cell stays open on the page: not that of a figure, and in Part II only functions."""
    hidden = "hide-input" in cell["metadata"].get("tags", ())
    if hidden or SAVED.search(source(cell)):
        return False
    return not evidence or re.search(r"(?m)^def ", source(cell)) is not None


def raw_cell(html):
    """Return HTML as a Markdown cell."""
    id = f"html-{zlib.crc32(html.encode())}"
    return {"cell_type": "markdown", "id": id, "metadata": {}, "source": raw_html(html)}


def raw_html(html):
    """Return HTML as a block of MyST, in which blank lines end nothing."""
    return f"```{{raw}} html\n{html}\n```"


def draw_still(preset, folder):
    """Draw what the figure with sliders shows first, for readers without JavaScript, as live.svg."""
    make = {"cv": mpt.constant_velocity, "gsm": mpt.gsm_axis}[preset["model"]]
    steps = np.logspace(-2, 2, 41)
    steady = [mpt.SteadyStateFilter.from_kalman(make(dt, preset["q"], preset["r"])) for dt in steps]
    fig, ax = plots.panels([["sigma"], ["gain"]])
    ax["sigma"].loglog(steps, [np.sqrt(each.P[0, 0]) for each in steady])
    plots.finish(ax["sigma"], "time step Δt (s)", "σ of the position (m)")
    for row, name in enumerate(["position", "velocity"]):
        ax["gain"].loglog(steps, [each.B[row, 0] for each in steady], label=name)
    plots.finish(ax["gain"], "time step Δt (s)", "the constant gain")
    for each in ax.values():
        each.set_ylim(0.01, 1)
        for axis in (each.xaxis, each.yaxis):
            axis.set_major_formatter("{x:g}")  # the exponents of powers of ten would be small
            axis.set_minor_formatter("")
    figures.save_figure(fig, "live", folder)


def draw_accuracy(text, folder):
    """Draw the table of digits on the page on accuracy as a heat map, accuracy.svg."""
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("| ")]
    (_, *columns), rows = rows[0], rows[1:]
    digits = np.array([[float(cell) if cell.isdigit() else np.nan for cell in row[1:]] for row in rows])
    fig, ax = plots.panels([["map"]], height=0.18 * len(rows) + 1.6)
    drawn = ax["map"].imshow(digits, vmin=0, vmax=14, cmap="cividis", aspect="auto")
    ax["map"].set_xticks(range(len(columns)), columns, rotation=90)
    ax["map"].set_yticks(range(len(rows)), [row[0] for row in rows])
    ax["map"].grid(visible=False)
    ax["map"].xaxis.tick_top()
    fig.colorbar(drawn, ax=ax["map"], label="digits that hold", location="bottom", aspect=40)
    figures.save_figure(fig, "accuracy", folder)


def picture(figure, root="", folder="figures"):
    """Return a figure as HTML: its SVG, with a link to it."""
    return str(environment().get_template("figures.html").module.picture(figure, root, folder)).strip()


# Modules that no page shows: those behind the doors. Others are listed as the package has them, so that a new one is.
NOT_SHOWN = []
# Modules of which a user of the filters needs nothing: they stand below the others.
INSIDE = ["equations", "kalman", "lainiotis", "predictor", "search"]
# What a reader comes to a class for, in this order; the rest follows as the source has it.
FOR_USERS = [
    "from_kalman",
    "from_lainiotis",
    "from_steady_state",
    "filter",
    "estimates",
    "covariances",
    "smooth",
    "step",
]
# What the engine asks of a filter: told once, in `_base`.
FOR_THE_ENGINE = ["as_tracks", "epochs_of", "estimates_of", "in_columns", "innovations_of", "next_step", "next_steps"]
FOR_THE_ENGINE += ["optimal", "parts", "run", "shared_steps", "times_of"]
# How modules are used whose first example shows something else, or that have none.
KF = "kf = KalmanFilter(constant_velocity(dt=1.0, q=0.01, r=0.1))"
USES = {
    "metrics": [KF, "z = [[0.1], [1.3], [9.9]]", "metrics.nis(kf, z), metrics.suspicious(kf, z)"],
    "search": ["value, gradient, curvature = differences(lambda point: (point**2).sum(), np.array([1.0, 2.0]))"],
}


class Described(NamedTuple):
    """A page of the package's interface: a class or a module, its name, how it is used, and what stands elsewhere.

    members are the members of a class as (name of autodoc's directive, name), in the order of the page.
    """

    name: str
    path: str
    use: str
    summary: str
    elsewhere: list
    members: list

    @property
    def inside(self):
        """Say whether it is a module of which a user needs nothing."""
        return self.name in INSIDE


def interface():
    """Return the pages of the package, (classes, modules), as lists of Described.

    Classes are those that `mpt_helpers` exports; a module's page has its functions and the other classes.
    """
    exported = [getattr(mpt, name) for name in mpt.__all__]
    classes = [each for each in exported if inspect.isclass(each)]
    names = sorted(path.stem for path in (ROOT / "mpt_helpers").glob("[a-z]*.py"))
    modules = [importlib.import_module(f"mpt_helpers.{name}") for name in names if name not in NOT_SHOWN]
    return (
        [described(each, f"{each.__module__}.{each.__name__}", []) for each in classes],
        [
            described(each, each.__name__, [one.__name__ for one in classes if one.__module__ == each.__name__])
            for each in modules
        ],
    )


def described(thing, path, elsewhere):
    """Return the page of a class or a module."""
    summary = " ".join(inspect.getdoc(thing).partition("\n\n")[0].split())
    members = members_of(thing) if inspect.isclass(thing) else []
    return Described(path.rpartition(".")[2], path, lines_of_use(thing, path), summary, elsewhere, members)


def members_of(described):
    """Return the documented members of a class, (directive of autodoc, name): first those that a user comes for."""
    found = {}
    for each in described.__mro__[:-1]:
        for name, member in vars(each).items():
            if not name.startswith("_") and name not in FOR_THE_ENGINE:
                found.setdefault(name, member)
    directives = {
        name: "autoproperty" if isinstance(member, property | cached_property) else "automethod"
        for name, member in found.items()
        if isinstance(member, property | cached_property | classmethod) or inspect.isfunction(member)
    }
    first = [name for name in FOR_USERS if name in directives]
    return [(directives[name], name) for name in [*first, *(name for name in directives if name not in first)]]


def lines_of_use(thing, path):
    """Return lines that use a class or a module: they run as they stand, and import no more than they use.

    Those of a module are its own of USES, or those of what the package exports of it, or of its first function with
    an example: the first example of the docstring, as far as the first line that uses the name.

    >>> print(lines_of_use(mpt.FIRFilter, "mpt_helpers.steady.FIRFilter"))
    import mpt_helpers as mpt
    <BLANKLINE>
    steady = mpt.SteadyStateFilter.from_kalman(mpt.gsm_axis(dt=1.0, q=0.01, r=0.1))
    mpt.FIRFilter.from_steady_state(steady, tol=1e-3).order
    """
    if inspect.isclass(thing):
        used = [thing]
    elif (name := path.rpartition(".")[2]) in USES:
        return with_imports(USES[name], vars(mpt) | vars(thing))
    else:
        own = [each for each in vars(thing).values() if getattr(each, "__module__", "") == path]
        used = [*(each for each in own if exported(each)), *public_functions(thing)]
    for each in used:
        lines = []
        for example in doctest.DocTestParser().get_examples(inspect.getdoc(each) or ""):
            lines.append(example.source.rstrip())
            if re.search(rf"\b{each.__name__}[.(]", lines[-1]):
                return with_imports(lines, vars(importlib.import_module(each.__module__)))
    raise ValueError(f"docs/pages.py: USES needs lines that use {path}, which has no example")


def exported(thing):
    """Say whether the package exports a function, a class or a module under its name."""
    name = getattr(thing, "__name__", "").rpartition(".")[2]
    return name in mpt.__all__ and getattr(mpt, name) is thing


def with_imports(lines, names):
    """Return lines of an example with what they need: numpy, the package as `mpt`, and what it does not export.

    names are those of the module in which the example stands.
    """
    text = "\n".join(lines)
    parsed = ast.parse(text)
    brought = {}
    exec("\n".join(ast.unparse(each) for each in parsed.body if isinstance(each, ast.Import | ast.ImportFrom)), brought)
    known = {**names, **brought}
    rows = text.splitlines()
    imports, others, places = set(), {}, []
    bound = {each.id for each in ast.walk(parsed) if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store)}
    bound |= {each.arg for each in ast.walk(parsed) if isinstance(each, ast.arg)}
    bound |= {each.name for each in ast.walk(parsed) if isinstance(each, ast.FunctionDef)}
    for each in ast.walk(parsed):
        if not isinstance(each, ast.Name) or each.id in bound or each.id not in known or hasattr(builtins, each.id):
            continue
        thing = known[each.id]
        module = getattr(thing, "__module__", "")
        if each.id == "np":
            imports.add("import numpy as np\n")
        elif thing is mpt:
            imports.add(PACKAGE)
        elif exported(thing):
            imports.add(PACKAGE)
            places.append((each.lineno, each.col_offset, "mpt."))
        elif exported(importlib.import_module(module)):
            imports.add(PACKAGE)
            places.append((each.lineno, each.col_offset, f"mpt.{module.rpartition('.')[2]}."))
        else:
            others.setdefault(module, set()).add(each.id)
    for row, column, before in sorted(places, reverse=True):
        rows[row - 1] = f"{rows[row - 1][:column]}{before}{rows[row - 1][column:]}"
    skipped = {each.lineno for each in parsed.body if isinstance(each, ast.Import | ast.ImportFrom)}
    said = [row for i, row in enumerate(rows, 1) if i not in skipped]
    first = sorted(imports, key=lambda line: line == PACKAGE)  # numpy, then the package
    first += [f"from {module} import {', '.join(sorted(own))}" for module, own in sorted(others.items())]
    return "\n".join([*first, "", *said])


PACKAGE = "import mpt_helpers as mpt"


def public_functions(module):
    """Return the functions that a module defines, in its order, without those of its own use."""
    own = [each for each in vars(module).values() if inspect.isfunction(each) and each.__module__ == module.__name__]
    return [each for each in own if not each.__name__.startswith("_")]


def guide_as_notebook(text, pictures, archive):
    """Return the guide as a notebook that runs beside the folder tracks/: its blocks are cells, with what they print.

    A block that makes a figure `fig` shows it; a picture below it, `![...](guide/look.png)`, is the output of that
    cell. Other pictures stand in the notebook itself, so that it is one file. Its first cell says how to install the
    package from `archive`, the name of the source's file. Links to other pages become plain text.
    """
    notebook = nbformat.v4.new_notebook(metadata={"language_info": {"name": "python"}})
    notebook.cells.append(
        nbformat.v4.new_markdown_cell(HOW_TO_RUN.format(archive=archive or "the source"), id="install")
    )
    for i, part in enumerate(re.split(r"(?ms)(^```python\n.*?^```$(?:\n\n```text\n.*?^```$)?)", text)):
        block = re.fullmatch(r"(?s)```python\n(.*?)\n```(?:\n\n```text\n(.*?)```)?", part)
        if block:
            said = [nbformat.v4.new_output("stream", name="stdout", text=block[2])] if block[2] else []
            if not any(each.cell_type == "code" for each in notebook.cells):
                # Or a figure that pyplot has not made is shown as its name.
                notebook.cells.append(nbformat.v4.new_code_cell("%matplotlib inline", id="pictures"))
            shows = "\nfig" if re.search(r"(?m)^fig\b[^=\n]*=[^=]", block[1]) else ""
            cell = nbformat.v4.new_code_cell(block[1] + shows, outputs=said, id=f"guide-{i}")
        elif part.strip():
            part = part.strip()
            if drawn := re.match(r"!\[([^\]]*)\]\((guide/\w+\.png)\)\n*", part) if i else None:
                data = {"image/png": base64.b64encode((pictures / drawn[2]).read_bytes()).decode()}
                notebook.cells[-1].outputs.append(nbformat.v4.new_output("display_data", data))
                part = part[drawn.end() :]
            cell = nbformat.v4.new_markdown_cell(without_links(pictures_inside(part, pictures)), id=f"guide-{i}")
        else:
            continue
        notebook.cells.append(cell)
    nbformat.validate(notebook)
    return notebook


HOW_TO_RUN = """\
This notebook needs Python 3.11 or newer, the package `mpt_helpers`, and the file `ride.gpx` in a folder `tracks` \
beside it. Where it was downloaded lie that file and the source, {archive}. In a terminal:

```
python3 -m venv .venv && . .venv/bin/activate
python -m pip install jupyterlab ./{archive}
jupyter lab
```"""


def without_links(text):
    """Return Markdown in which links to other pages and places are plain text: in a notebook they would be dead.

    >>> without_links("See [speed](speed.md#fast), [numpy](https://numpy.org) and <a href='a.gpx' download>a.gpx</a>.")
    'See speed, [numpy](https://numpy.org) and a.gpx.'
    """
    text = re.sub(r"(?m)^<a href=\"#.*\n+", "", text)  # the line of contents
    text = re.sub(r"(?<!!)\[([^\]]*)\]\((?!https?:)[^)]*\)", r"\1", text)
    return re.sub(r"""<a href=["'](?!https?:)[^>]*>(.*?)</a>""", r"\1", text)


def pictures_inside(text, folder):
    """Return Markdown whose pictures stand in it, so that the notebook is one file."""

    def inside(found):
        data = base64.b64encode((folder / found[2]).read_bytes()).decode()
        return f"![{found[1]}](data:image/png;base64,{data})"

    return re.sub(r"!\[([^\]]*)\]\(([\w/]+\.png)\)", inside, text)


# A letter with an index or a power: P_k, A^(ν-1). A small letter is one only where no word ends with it.
SYMBOL = re.compile(r"((?:[A-ZΑ-ω]|(?<![A-Za-z\d_.])[a-z])\u0302?²?)([_^])(\([^()]*\)|\d+|[A-Z]+|[a-zν]{1,2}(?![a-z]))")


def plain(text):
    r"""Return a text as Markdown that shows it as it stands; what stands in backticks is code.

    >>> print(plain("P_k of `step_k`"))
    P\_k of `step_k`
    """
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(each if each.startswith("`") else re.sub(r"([\\*_|<>$])", r"\\\1", each) for each in parts)


def typeset(text):
    """Return a text as HTML with its indices lowered and its powers raised: P_k is P<sub>k</sub>."""

    def set_apart(symbol):
        base, sign, index = symbol.groups()
        tag = {"_": "sub", "^": "sup"}[sign]
        return f"{base}<{tag}>{index.strip('()')}</{tag}>"

    return Markup(SYMBOL.sub(set_apart, str(escape(text))))


def environment():
    """Return the templates and what all of them use."""
    env = Environment(
        loader=FileSystemLoader([DOCS / "templates", DOCS]),
        autoescape=lambda name: name is not None and name.endswith(".html"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    env.globals |= {
        "VERDICTS": VERDICTS,
        "BASES": BASES,
        "CAUSE_KINDS": CAUSE_KINDS,
        "OF_CLAIMS": OF_CLAIMS,
        "FAILS": FAILS,
        "grouped": grouped,
        "worst_first": worst_first,
        "claims": claims,
        "cause_options": cause_options,
        "outcomes": home.outcomes,
        "common": common,
        "shorten": shorten,
        "NOT_REPRODUCED": NOT_REPRODUCED,
    }
    env.filters |= {
        "slug": lambda text: text.replace(" ", "-"),
        "code": lambda text: re.sub(r"[`$*]", "", text),
        "place": place,
        "plain": plain,
        "typeset": typeset,
    }
    return env


def write_tables(given, folder):
    """Write the verdicts for machines."""
    (folder / "verdicts.json").write_text(json.dumps(given.records(), indent=1, ensure_ascii=False), encoding="utf-8")
    with (folder / "verdicts.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, FIELDS)
        writer.writeheader()
        writer.writerows(given.records())


def main():
    """Write docs/_build afresh: source, static and extra."""
    shutil.rmtree(BUILD, ignore_errors=True)
    for part in ("source/notebooks", "source/corrections", "source/api", "source/modules", "static", "extra/notebooks"):
        (BUILD / part).mkdir(parents=True)
    notebooks = {key: stored_notebook(key) for key in keys()}
    stored = [stored_verdicts(ROOT / "notebooks" / f"{key}.ipynb") for key in notebooks]
    causes = {place: cause for each in stored for place, cause in each.causes.items()}
    given = Verdicts([each for verdicts in stored for each in verdicts], causes)
    env = environment()
    about = texts(given)
    plots.use_style()
    draw_still(about["live"]["presets"][about["live"]["shown"]], BUILD / "static")
    draw_accuracy((DOCS / "accuracy.md").read_text(encoding="utf-8").partition("<!-- digits -->")[2], BUILD / "static")
    cff, own, references = citations()
    name = f"mpt_helpers-{cff['version']}"
    size = write_archive(BUILD / "extra" / f"{name}.tar.gz", name)
    drawn = {key: figures_of(key, each["cells"]) for key, each in notebooks.items()}
    classes, modules = interface()
    corrected = {key: corrections.read(given.of(key), about["corrected"].get(key, {})) for key in notebooks}
    asked = {key: about["questions"].get(key, {}) for key in notebooks}
    env.globals |= {
        "given": given,
        "texts": about,
        "home": home_page(about, given, {each.name: each for own in drawn.values() for each in own}),
        "sensor": draw_sensor(BUILD / "static"),
        "archive": name if size else "",
        "archive_size": f"{size / 1e6:.1f} MB",
        "citation": own,
        "citation_of": lambda key: references.get(key[:4], about["papers"][key]["authors"]),
        "accuracy": svg_size(BUILD / "static" / "accuracy.svg"),
        "titles": {key: title(each["cells"]) for key, each in notebooks.items()},
        "figures": drawn,
        "contents": {key: corrections.contents(given.of(key), corrected[key], asked[key]) for key in notebooks},
        "remarks": {key: corrections.remarks(given.of(key), asked[key]) for key in notebooks},
        "classes": classes,
        "modules": modules,
        "speed": speed,
    }
    write_pages(env)
    # Two folders: on a disk that ignores case, Predictor and predictor are one file.
    for folder, described in (("api", classes), ("modules", modules)):
        for each in described:
            text = env.get_template("interface.md").render(each=each, of_class=folder == "api")
            (BUILD / "source" / folder / f"{each.name}.md").write_text(text, encoding="utf-8")
    for key, notebook in notebooks.items():
        write_article(env, key, notebook, given.of(key), about["live"]["after"])
        write_corrections(env, key, given.of(key), corrected[key], asked[key])
    shutil.copytree(ROOT / "figures", BUILD / "extra" / "figures")
    shutil.copytree(DOCS / "tracks", BUILD / "extra" / "tracks")
    for page in [DOCS / f"{name}.md" for name in GUIDES if (DOCS / f"{name}.md").exists()]:
        text = CHECKOUT.sub("", page.read_text(encoding="utf-8"))
        archive = env.globals["archive"] and f"{env.globals['archive']}.tar.gz"
        text = text.replace(SOURCE, f" ({archive}, unpacked)" if archive else "")
        nbformat.write(guide_as_notebook(text, DOCS, archive), BUILD / "extra" / f"{page.stem}.ipynb")
    write_tables(given, BUILD / "extra")
    colours = "".join(f"--{name}: {colour}; " for name, colour in plots.COLOUR_OF.items() if colour.startswith("#"))
    (BUILD / "static" / "colours.css").write_text(f":root {{ {colours}}}\n", encoding="utf-8")
    for png in (BUILD / "static").glob("*.png"):
        png.unlink()


def write_archive(path, name):
    """Write the committed source as a .tar.gz, and return its size in bytes: 0 where there is no git."""
    if not (ROOT / ".git").exists():
        return 0
    # Git writes the time of the commit into it: the same bytes wherever the same commit is packed. A container's folder
    # may belong to somebody else, which git minds unless it is told.
    git = ["git", "-c", f"safe.directory={ROOT}", "-C", str(ROOT)]
    subprocess.run([*git, "archive", "--format=tar.gz", f"--prefix={name}/", "-o", str(path), "HEAD"], check=True)
    return path.stat().st_size


def write_pages(env):
    """Write the pages of docs/ as they are rendered."""
    shutil.copytree(DOCS / "guide", BUILD / "source" / "guide")
    for page in sorted(DOCS.glob("*.md")):
        # In a checkout, the notebooks' folder stands beside docs/; on the site, below its pages.
        text = page.read_text(encoding="utf-8").replace("](../notebooks/", "](notebooks/")
        text = INCLUDE.sub(raw_html(r'{% include "\1" %}'), CHECKOUT.sub("", text))
        text = text.replace(SOURCE, LEADS_TO_SOURCE)
        text = env.from_string(text).render(root="")
        if page.stem in (said := env.globals["texts"]["descriptions"]):
            text = f"---\n{yaml.safe_dump({'myst': described_as(said[page.stem])})}---\n{text}"
        if page.stem in GUIDES:
            first, _, rest = text.partition("\n\n")
            text = f"{first}\n\n{download(page.stem)}\n\n{rest}"
        if page.stem == "guide":
            text += toctree({name: words for name, words in BELOW_GUIDE.items() if (DOCS / f"{name}.md").exists()})
        (BUILD / "source" / page.name).write_text(text, encoding="utf-8")


LEADS_TO_SOURCE = (
    '{% if archive %} (<a href="{{ archive }}.tar.gz" download>download it</a>, {{ archive_size }}, and unpack it)'
    "{% endif %}"
)


def download(name):
    """Return the line of a guide that leads to its notebook, which reads the ride."""
    return (
        f'<a href="{name}.ipynb" download>Download it as a notebook</a>; it reads '
        '<a href="tracks/ride.gpx" download>ride.gpx</a> from a folder `tracks` beside it.'
    )


def toctree(pages):
    """Return the pages below a page, {name: words}, for Sphinx: they stand in the navigation only."""
    entries = "\n".join(f"{words} <{name}>" for name, words in pages.items())
    return f"\n```{{toctree}}\n:hidden:\n\n{entries}\n```\n"


def write_article(env, key, notebook, own, live):
    """Write the article and the full notebook of one paper."""
    shutil.copy(ROOT / "notebooks" / f"{key}.ipynb", BUILD / "extra" / "notebooks")
    here = {"key": key, "root": "../"}
    about = env.globals["texts"]["papers"][key]

    def verdicts(cell):
        chosen = [each for each in own if each.cell == cell]
        return env.get_template("chips.html").render(here, cell=cell, verdicts=chosen)

    html = {"live": (live, env.get_template("live.html").render(here)), "verdicts": verdicts}
    for name, whole in ((key, False), (f"{key}-full", True)):
        first = source(notebook["cells"][0])
        page = html | {"top": env.get_template("top.html").render(here, whole=whole, first=first)}
        made = prepared(key, notebook, page, whole)
        made["metadata"] = made["metadata"] | {"myst": described_as(f"{about['authors']}, checked. {about['outcome']}")}
        if whole:  # what is searched is found in the article
            made["metadata"]["nosearch"] = True
            made["cells"][0] |= {"source": re.sub(r"\A# ", "# The full notebook: ", made["cells"][0]["source"])}
        text = json.dumps(made, ensure_ascii=False)
        (BUILD / "source" / "notebooks" / f"{name}.ipynb").write_text(text, encoding="utf-8")


def described_as(text):
    """Return front matter of MyST that says what a page is about, for search engines and previews."""
    return {"html_meta": {"description": text}}


def write_corrections(env, key, own, corrected, asked):
    """Write the page of corrections to one paper: corrected is {id: text or Patch}, asked {id: question}."""
    html = env.get_template("correction.html").render(
        key=key,
        root="../",
        rows=corrections.names_of_rows(own),
        sections=corrections.sections(own, corrected),
        in_text=corrections.in_text(own, corrected),
        if_printed=corrections.if_printed(own, corrected),
        cells_if_printed=corrections.cells_if_printed(own, corrected),
        lost=corrections.lost(own),
        questions=corrections.questions(own, asked),
        unchecked=corrections.unchecked(own, asked, corrected),
    )
    paper = env.globals["texts"]["papers"][key]
    front = yaml.safe_dump({"myst": described_as(f"Corrections to {paper['authors']}. {paper['outcome']}")})
    text = f"---\n{front}---\n# Corrections to {paper['authors']}\n\n{raw_html(html)}\n"
    (BUILD / "source" / "corrections" / f"{key}.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
