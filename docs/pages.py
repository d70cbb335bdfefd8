"""Put together what Sphinx builds the site from: run as `python docs/pages.py` in the project's folder.

The notebooks are pages as they are. Everything else that says what the papers print and what was computed comes from
their verdicts; what papers are called stands in the ledger, the words of a few pages in papers.toml, where each number
is looked up in a verdict. The HTML is in templates/.
"""

import ast
import base64
import csv
import inspect
import json
import re
import shutil
import subprocess
import tomllib
import zlib
from pathlib import Path
from textwrap import shorten
from typing import NamedTuple

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
from reproduction.ledger import Verdicts, keys, published, stored_verdicts
from reproduction.ledger.verdicts import (
    BASES,
    CANNOT_BE_CHECKED,
    CAUSE_KINDS,
    DIFFERS,
    ERRATUM,
    FIELDS,
    IN_PART,
    REPRODUCED,
    VERDICTS,
    WITHIN_BAND,
)

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
BUILD = DOCS / "_build"
LESSONS = ROOT / "notebooks" / "lessons"
# The order in which to read the lessons, as the README has it; others follow by name.
READ_FIRST = (
    "one_step_late",
    "a_track_in_pieces",
    "three_axes_one_small_filter",
    "freeze_the_filter",
    "when_the_driver_brakes",
    "what_averaging_leaves",
)
SAVED = re.compile(r'save_figure\([^"]+, "(\w+)"\)')
# More verdicts than this that share their table, outcome and cause become one row, or one chip, that opens.
FOLD = 4
# What the filter of the values calls all that did not come out as printed.
NOT_REPRODUCED = "not reproduced"
# What a reader of the values comes for, first.
FAILS = (ERRATUM, DIFFERS)
WORST_FIRST = (*FAILS, IN_PART, CANNOT_BE_CHECKED, WITHIN_BAND, REPRODUCED)
# What a page holds for the site, hidden where Markdown is shown as it is: a template.
INCLUDE = re.compile(r"<!-- include (\w+\.html) -->")
CHECKOUT = re.compile(r" ?<!-- checkout -->.*?<!-- /checkout -->", re.DOTALL)  # for readers of a checkout only


FOLDED = re.compile(r"(?m)^</?details>.*\n\n")  # around code that a page folds away, and a notebook does not
SOURCE = "<!-- archive -->"  # where the site leads to the source, which a reader of a checkout has
# Pages whose blocks of Python can be downloaded as a notebook, and those that stand below the guide, where they are.
GUIDES = ("guide", "by_hand", "band")
BELOW_GUIDE = {
    "by_hand": "By hand",
    "band": "What a band is worth",
    "small_processor": "A small processor, a live gate, two sensors",
    "smoothing": "Smoothing with the phase",
    "other_packages": "From another package",
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
    """A figure of a notebook: its file's name, what it is called, its section, its caption, its finding.

    numbered says whether it is a figure of the paper, under its number.
    """

    name: str
    numbered: bool
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


def cause_options(given):
    """Return (id, sentence) of the causes that verdicts name; of an id that papers share, the first sentence."""
    named = {(each.paper, each.cause) for each in given if each.cause}
    sentences = {}
    for (paper, id), cause in given.causes.items():
        if (paper, id) in named:
            sentences.setdefault(id, cause.sentence)
    return sorted(sentences.items(), key=lambda option: option[1])


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
            paper, own = next((each, name.removeprefix(f"{each}_")) for each in keys() if name.startswith(f"{each}_"))
            numbered = paper == key and re.fullmatch(r"fig\d+", own) is not None
            label = f"Figure {own[3:]}" if numbered else f"Figure `{own}`"
            captions = [part for part in prose if label in names_of(part)]
            (shown,) = (out for out in cell["outputs"] if "image/png" in out.get("data", {}))
            alt = shown["metadata"]["image/png"]["alt"]
            above, only, first = drawn_titles("".join(shown["data"].get("text/plain", "")))
            width, height = svg_size(ROOT / "figures" / f"{name}.svg")
            caption = re.sub(
                r"\]\((?!https?:|#)(?:\.\./)?([\w/]+\.ipynb)", r"](notebooks/\1", captions[0] if captions else ""
            )
            caption = re.sub(
                r"\]\(#[^)]*\)", lambda link: anchor(link[0].replace("(", f"(notebooks/{key}.ipynb")), caption
            )
            finding = re.sub(r"^Figure \d+(, redrawn)?: ", "", above or only or conclusion(caption) or first or section)
            drawn.append(Drawn(name, numbered, label, section, caption, finding, cell["id"], alt, width, height))
    return drawn


def drawn_titles(description):
    r"""Return the title above a figure's panels, that of its only panel and that of its first: "" if there is none.

    >>> drawn_titles("late.png\ntext 'One step\\nlate'\naxes 1: 'error' x '' linear 0..1\naxes 2: x '' linear 0..1")
    ('One step late', '', 'error')
    >>> drawn_titles("gain.png\naxes 1: 'It settles' x 'step k' linear 0..1; y '' linear 0..1")
    ('', 'It settles', 'It settles')
    """
    quoted = r"""('(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*")"""
    above = re.match(rf"[^\n]*\ntext {quoted}", description)
    panels = re.findall(rf"(?m)^axes \d+: (?:{quoted} )?x ", description)
    titles = (above[1] if above else "", panels[0] if len(panels) == 1 else "", panels[0] if panels else "")
    return tuple(" ".join(ast.literal_eval(each).split()) if each else "" for each in titles)


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


def home_page(about, given):
    """Return the words of the home page, with the numbers of home.py and the counts of the verdicts in them."""
    numbers = home.answer() | given.checked()
    return {name: unbroken(text.format(**numbers)) for name, text in about["home"].items()} | {"lost": numbers["lost"]}


class Lesson(NamedTuple):
    """A lesson: its file's name, its title, its question, and the paper of whose notebook it speaks."""

    name: str
    title: str
    question: str
    paper: str


def lessons():
    """Return {name: the notebook} of all lessons, in the order in which to read them."""
    found = {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in sorted(LESSONS.glob("*.ipynb"))}
    return {name: found[name] for name in sorted(found, key=lambda name: (*READ_FIRST, name).index(name))}


def described_lesson(name, cells):
    """Return a lesson as the home page and the page of its paper list it."""
    question = re.search(r"(?m)^\*([^*]+)\*$", source(cells[0]))[1]
    linked = re.findall(r"\]\(\.\./(\w+)\.ipynb", "\n".join(map(source, cells)))
    return Lesson(name, title(cells), question, next((key for key in linked if key in keys()), ""))


def parts_of(key, kind):
    """Return the tables or figures of a paper, [(number, anchor on its page)]: a heading may say more than its name."""
    paper = published(key)
    headings = {row.name: row.heading for row in paper.rows}
    return [(name.partition(" ")[2], slug(headings[name])) for name in paper.about.numbered if name.startswith(kind)]


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


def citation():
    """Return CITATION.cff, and how to cite this project."""
    cff = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    (author,) = (each["name"] for each in cff["authors"])
    year = cff["date-released"][:4]
    return cff, f"{author[0].upper()}{author[1:]} ({year}). {cff['title']}. Version {cff['version']}."


def cited(about):
    """Return the reference to a paper."""
    return f"{about.authors}, {about.title}, {about.journal} ({about.year})."


def prepared(notebook, drawn, top):
    """Return a notebook as the site renders it: `top`, as HTML, after its title, and its links to pages of the site.

    drawn are its figures; the cell of each is marked, so that the page shows its SVG.
    """
    figure_of = {each.cell: each for each in drawn}
    cells = []
    for i, cell in enumerate(notebook["cells"]):
        made = {**cell, "source": links_of_the_site(source(cell)), "metadata": {**cell["metadata"], "id": cell["id"]}}
        if cell["cell_type"] == "code":
            made["source"] = source(cell)
            made["outputs"] = [with_named_headers(each) for each in cell["outputs"]]
            if each := figure_of.get(cell["id"]):
                made["metadata"] |= {"figure": each._asdict()}
        cells.append(made)
        if i == 0:
            cells.append(raw_cell(top))
    return {**notebook, "cells": cells}


def links_of_the_site(text):
    """Return the Markdown of a notebook with links as the site has them.

    In a checkout docs/ and benchmarks/ stand beside notebooks/; on the site, their pages stand above it. JupyterLab and
    nbviewer keep the capitals of a heading in its anchor, MyST does not.

    >>> links_of_the_site("[Table 4](#Table-4), [the guide](../docs/guide.md), [a lesson](lessons/one_step_late.ipynb)")
    '[Table 4](#table-4), [the guide](../guide.md), [a lesson](lessons/one_step_late.ipynb)'
    """
    text = re.sub(r"\]\(((?:\.\./)+)docs/", r"](\1", text)
    text = re.sub(r"\]\(((?:\.\./)+)benchmarks/README\.md", r"](\1speed.md", text)
    return re.sub(r"\]\((?:[\w./]+\.ipynb)?#[^)]*\)", lambda link: anchor(link[0]), text)


def anchor(link):
    """Return a link to a heading with the anchor that MyST gives it.

    >>> anchor("](../2014_gsm_2d.ipynb#Section-3:-time-invariant-filters)")
    '](../2014_gsm_2d.ipynb#section-3-time-invariant-filters)'
    """
    target, _, heading = link[2:-1].partition("#")
    return f"]({target}#{slug(heading)})"


def slug(heading):
    """Return the anchor that MyST gives a heading.

    >>> slug("Table 4"), slug("Eqs. 5-6: Lainiotis")
    ('table-4', 'eqs-5-6-lainiotis')
    """
    return re.sub(r"[^\w\u4e00-\u9fff\- ]", "", heading.strip().lower()).replace(" ", "-")


def with_named_headers(output):
    """Return an output of a cell whose tables have no empty header: to a screen reader it would have no name."""
    if "text/html" not in output.get("data", {}):
        return output
    html = re.sub(r"<th( style='[^']*')?>(?:<br ?/?>)?</th>", r"<td\1></td>", "".join(output["data"]["text/html"]))
    return {**output, "data": {**output["data"], "text/html": html}}


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


# The headings of the page on the filters, with the modules in which what stands below them is defined.
CHAPTERS = {
    "Models": ("model", "motion"),
    "Filters": ("kalman", "lainiotis", "steady", "combined", "predictor", "_base"),
    "What a filter is worth": ("metrics", "fit", "fitting", "bands", "forecasts", "study", "monte_carlo", "riccati"),
    "A recorded track": ("tracks",),
}


# By these, filters, metrics and bands call one another. They have one line, and the page of a class leaves them out.
INNER = {"advance", "as_tracks", "epochs_of", "estimates_of", "innovations_of", "next_steps", "run", "times_of"}
INNER |= {"elementary_filters", "measurement", "motion", "observability", "shared_steps", "subfilters"}


def interface():
    """Return [(heading, names)] of the classes and functions that the package exports, in the order of `__all__`."""
    left = [name for name in mpt.__all__ if not inspect.ismodule(getattr(mpt, name))]
    made = []
    for heading, modules in CHAPTERS.items():
        names = [name for name in left if module_of(name) in modules]
        left = [name for name in left if name not in names]
        made.append((heading, names))
    if left:
        raise ValueError(f"docs/pages.py: CHAPTERS needs the modules of {', '.join(left)}")
    return made


def module_of(name):
    """Return the first part, below mpt_helpers, of the module in which an exported name is defined."""
    return getattr(mpt, name).__module__.split(".")[1]


def public_modules():
    """Return the names of the package's modules, those for use inside (`_engine`, `_checks`) left out."""
    found = [path.relative_to(ROOT).with_suffix("") for path in (ROOT / "mpt_helpers").rglob("*.py")]
    parts = [each.parts[:-1] if each.name == "__init__" else each.parts for each in found]
    return sorted(
        ".".join(each) for each in parts if len(each) > 1 and not any(part.startswith("_") for part in each[1:])
    )


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
    text = FOLDED.sub("", text)
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
        "FAILS": FAILS,
        "grouped": grouped,
        "worst_first": worst_first,
        "outcomes": home.outcomes,
        "cause_options": cause_options,
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
    for part in ("source/notebooks/lessons", "static", "extra/notebooks/lessons"):
        (BUILD / part).mkdir(parents=True)
    notebooks = {key: stored_notebook(key) for key in keys()}
    stored = [stored_verdicts(ROOT / "notebooks" / f"{key}.ipynb") for key in notebooks]
    causes = {place: cause for each in stored for place, cause in each.causes.items()}
    given = Verdicts([each for verdicts in stored for each in verdicts], causes)
    env = environment()
    about = texts(given)
    plots.use_style()
    draw_still(about["live"]["presets"][about["live"]["shown"]], BUILD / "static")
    digits = (DOCS / "accuracy.md").read_text(encoding="utf-8").partition("<!-- digits -->")[2]
    draw_accuracy(digits.partition("<!-- end of digits -->")[0], BUILD / "static")
    cff, own = citation()
    name = f"mpt_helpers-{mpt.__version__}"
    size = write_archive(BUILD / "extra" / f"{name}.tar.gz", name)
    told = {each: described_lesson(each, notebook["cells"]) for each, notebook in lessons().items()}
    pages = notebooks | {f"lessons/{each}": notebook for each, notebook in lessons().items()}
    env.globals |= {
        "given": given,
        "texts": about,
        "papers": {key: published(key).about for key in notebooks},
        "parts_of": parts_of,
        "home": home_page(about, given),
        "sensor": draw_sensor(BUILD / "static"),
        "archive": name if size else "",
        "archive_size": f"{size / 1e6:.1f} MB",
        "version": mpt.__version__,
        "released": cff,
        "citation": own,
        "citation_of": lambda key: cited(published(key).about),
        "accuracy": svg_size(BUILD / "static" / "accuracy.svg"),
        "lessons": told,
        "figures": {key: figures_of(key, notebook["cells"]) for key, notebook in pages.items()},
        "corrections": {key: corrections.of(given.of(key), about, key) for key in notebooks},
        "speed": speed,
        "interface": interface(),
        "modules": public_modules(),
    }
    write_pages(env)
    for key, notebook in pages.items():
        write_notebook(env, key, notebook)
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


def write_notebook(env, key, notebook):
    """Write the page of a notebook, the reproduction of a paper or a lesson, and the file to download."""
    shutil.copy(ROOT / "notebooks" / f"{key}.ipynb", BUILD / "extra" / "notebooks" / f"{key}.ipynb")
    lesson = env.globals["lessons"].get(key.removeprefix("lessons/"))
    root = "../../" if lesson else "../"
    top = env.get_template("top.html").render(key=key, root=root, lesson=lesson)
    made = prepared(notebook, env.globals["figures"][key], top)
    if lesson:
        description = f"{lesson.title}: a lesson of ten minutes. {lesson.question}"
    else:
        paper = env.globals["papers"][key]
        description = f"{paper.authors} ({paper.year}), reproduced: every table and figure, printed beside computed."
    made["metadata"] = made["metadata"] | {"myst": described_as(description)}
    (BUILD / "source" / "notebooks" / f"{key}.ipynb").write_text(json.dumps(made, ensure_ascii=False), encoding="utf-8")


def described_as(text):
    """Return front matter of MyST that says what a page is about, for search engines and previews."""
    return {"html_meta": {"description": text}}


if __name__ == "__main__":
    main()
