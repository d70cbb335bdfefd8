"""Put together what Sphinx builds the site from: run as `python docs/pages.py` in the project's folder.

Everything that says what the papers print and what was computed comes from the verdicts in the executed notebooks. The
few sentences per paper are in papers.toml, where each number is looked up in a verdict. The HTML is in templates/.
"""

import contextlib
import csv
import hashlib
import io
import json
import re
import shutil
import tomllib
import zlib
from importlib.metadata import distribution
from pathlib import Path
from textwrap import shorten
from typing import NamedTuple
from urllib.parse import urlencode

import matplotlib
import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

import mpt_helpers as mpt
from mpt_helpers import plots
from mpt_helpers.ledger import Verdicts, keys, stored_verdicts
from mpt_helpers.ledger.verdicts import BASES, CAUSE_KINDS, FIELDS, OF_CLAIMS, VERDICTS

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
BUILD = DOCS / "_build"
# es5/tex-svg.js of MathJax 3.2.2, as in the package `mathjax` of the npm registry.
MATHJAX = "sphinx-mathjax-offline", "sphinx-mathjax-offline/static/mathjax/tex-svg.js"
MATHJAX_SHA256 = "d4295dc33744836935c1399feece5159577b34c5c8ffb9f1c6324cd82e03a882"
SAVED = re.compile(r'save_figure\(\w+, "(\w+)"\)')
# More verdicts than this that share their table, outcome and cause become one row, or one chip, that opens.
FOLD = 4
# What a page holds for the site, hidden where Markdown is shown as it is: a template, and in the guide a drawing.
INCLUDE = re.compile(r"<!-- include (\w+\.html) -->")
CHECKOUT = re.compile(r" ?<!-- checkout -->.*?<!-- /checkout -->", re.DOTALL)  # for readers of a checkout only
BLOCK = re.compile(r'(?ms)^(?:```python|<!-- draw (?P<name>\w+) "(?P<alt>[^"]*)")\n(?P<code>.*?)^(?:```|-->)$')


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
    """A figure of a notebook: its file's name, what it is called, its heading, its caption, its cell, its alt text."""

    name: str
    label: str
    heading: str
    caption: str
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


def place(verdict):
    """Return the table, figure or section of an item, without its row and column."""
    return re.split(r"[,;]", verdict.where)[0]


def grouped(verdicts):
    """Return verdicts as Groups, in the order of their first members; few alike stay single."""
    alike = {}
    for each in verdicts:
        alike.setdefault((place(each), each.verdict, each.cause), []).append(each)
    groups = [Group(*shared, members) for shared, members in alike.items()]
    single = [Group(*group[:3], [each]) for group in groups if not group.folds for each in group.members]
    order = {id(each): i for i, each in enumerate(verdicts)}
    return sorted([*filter(lambda group: group.folds, groups), *single], key=lambda group: order[id(group.members[0])])


def by_cause(given, kind):
    """Return the verdicts whose cause is of this kind."""
    return [each for each in given if each.cause and given.causes[each.paper, each.cause].kind == kind]


def claims(given, *outcomes):
    """Return the claims with one of these verdicts, one verdict after the other, and what else fails by a finding."""
    findings = by_cause(given, "finding")
    listed = [each for each in given if each.kind == "claim" or each in findings]
    return [each for outcome in outcomes for each in listed if each.verdict == outcome]


def reasons(given, chosen):
    """Return the causes of some verdicts, each with those that name it; a cause that two papers share stands once."""
    alike = {}
    for each in chosen:
        cause = given.causes[each.paper, each.cause]
        alike.setdefault((cause.sentence, cause.meaning), (cause, []))[1].append(each)
    return list(alike.values())


def common(members):
    """Return the filter of the values page that shows these verdicts: all the fields in which they agree."""
    values = {name: {getattr(each, name) for each in members} for name in ("paper", "kind", "verdict", "cause")}
    values["place"] = {place(each) for each in members}
    return urlencode({name: min(found) for name, found in values.items() if len(found) == 1 and found != {""}})


def figures_of(key, cells):
    """Return the figures of a notebook; the caption is the paragraph that begins with **Figure 1.** or so."""
    prose = [part for cell in cells if cell["cell_type"] == "markdown" for part in source(cell).split("\n\n")]
    drawn, section = [], "What we found"
    for cell in cells:
        if cell["cell_type"] == "markdown":
            section = [section, *re.findall(r"(?m)^## (?:\d+\. )?(.*)", source(cell))][-1]
        for name in SAVED.findall(source(cell)) if cell["cell_type"] == "code" else []:
            own = name.removeprefix(f"{key}_")
            label = f"Figure {own[3:]}" if re.fullmatch(r"fig\d+", own) else f"Figure `{own}`"
            heading = label if label[-1].isdigit() else f"{section} ({label[0].lower()}{label[1:]})"
            captions = [part for part in prose if label in names_of(part)]
            (alt,) = (out["metadata"]["image/png"]["alt"] for out in cell["outputs"] if "image/png" in out["data"])
            width, height = svg_size(ROOT / "figures" / f"{name}.svg")
            caption = captions[0] if captions else alt
            drawn.append(Drawn(name, label, heading, caption, cell["id"], alt, width, height))
    return drawn


def names_of(paragraph):
    """Return the figures that a paragraph is the caption of, as in **Figure 1, Figure 2.** or **Figure `name`.**."""
    head = re.match(r"\*\*(.*?)\.?\*\*", paragraph)
    return head[1].split(", ") if head else []


def svg_size(path):
    """Return the width and height of an SVG, in points."""
    head = path.read_text(encoding="utf-8")[:2000]
    return tuple(round(float(size)) for size in re.search(r'<svg [^>]*viewBox="0 0 ([\d.]+) ([\d.]+)"', head).groups())


def said(text, pattern):
    """Return what the group of a pattern matches in a text; raises ValueError unless that is one thing."""
    found = re.findall(pattern, text)
    if len(found) != 1:
        raise ValueError(f"papers.toml: {pattern!r} is found {len(found)} times")
    return found[0]


def texts(given):
    """Return papers.toml with its numbers looked up; raises ValueError for one that is not found.

    They stand in a verdict, in a notebook or in the guide, all of which have tests of their own.
    """
    by_id = {(each.paper, each.id): each for each in given}

    def found(paper, id, text):
        each = by_id[paper, id]
        if text not in f"{each.printed} {each.computed} {each.reason}":
            raise ValueError(f"papers.toml: {paper}, {id!r} does not say {text!r}, but {each!r}")
        return text

    lookups = {
        "printed": lambda paper, id: by_id[paper, id].printed,
        "computed": lambda paper, id: by_id[paper, id].computed,
        "found": found,
        "guide": lambda pattern: said((DOCS / "guide.md").read_text(encoding="utf-8"), pattern),
        "article": lambda paper, pattern: said("\n".join(map(source, stored_notebook(paper)["cells"])), pattern),
    }
    plain = Environment(undefined=StrictUndefined)
    return tomllib.loads(plain.from_string((DOCS / "papers.toml").read_text(encoding="utf-8")).render(lookups))


def prepared(key, notebook, page, whole):
    """Return a notebook as it is rendered, whole or as an article: there without cells of the ledger.

    page maps what stands between the cells: "top" after the title, "live" (figure, HTML) after that figure, and
    "verdicts", a function from a ledger cell to the HTML of its verdicts.
    """
    drawn = {each.cell: each for each in figures_of(key, notebook["cells"])}
    cells = []
    for cell in notebook["cells"]:
        text = source(cell)
        if cell["cell_type"] == "markdown":
            # In a checkout, docs/ and benchmarks/ stand beside notebooks/; on the site, their pages stand above it.
            text = text.replace("](../docs/", "](../").replace("](../benchmarks/README.md", "](../speed.md")
        cell = {**cell, "source": text, "metadata": {**cell["metadata"], "id": cell["id"]}}
        ledger = "ledger" in cell["metadata"].get("tags", ())
        cell["metadata"]["folded"] = not whole and not teaches(cell)
        cell["metadata"]["tags"] = []  # code is folded here, not by myst-nb
        if ledger and not whole:
            cells.append(raw_cell(page["verdicts"](cell["id"])))
            continue
        if each := drawn.get(cell["id"]):
            cell["metadata"] |= {"figure": each._asdict()}
        cells.append(cell)
        if cell is cells[0]:
            cells.append(raw_cell(page["top"]))
        if not whole and each and each.name == page["live"][0]:
            cells.append(raw_cell(page["live"][1]))
    return {**notebook, "cells": cells}


def teaches(cell):
    """Tell whether a cell defines a function that the text explains: its code stays open on the page."""
    hidden = "hide-input" in cell["metadata"].get("tags", ())
    return not hidden and not SAVED.search(source(cell)) and re.search(r"(?m)^def ", source(cell)) is not None


def raw_cell(html):
    """Return HTML as a Markdown cell."""
    id = f"html-{zlib.crc32(html.encode())}"
    return {"cell_type": "markdown", "id": id, "metadata": {}, "source": raw_html(html)}


def raw_html(html):
    """Return HTML as a block of MyST, in which blank lines end nothing."""
    return f"```{{raw}} html\n{html}\n```"


def live_presets(chosen):
    """Return the presets of the figure with sliders as JSON."""
    return json.dumps(chosen, ensure_ascii=False)


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
    plots.save_figure(fig, "live", folder)


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
    plots.save_figure(fig, "accuracy", folder)


def run_guide(text, place):
    """Run the guide in a folder that has its track: yield each block of Python or of drawing, and what came of it.

    That is the printed text of a block ```python, and of a comment <!-- draw name "alt text" the figure, whose files
    are then in the folder.
    """
    names = {"plots": plots}
    shutil.copy(DOCS / "track.csv", place)
    with contextlib.chdir(place), matplotlib.rc_context():
        plots.use_style()
        for block in BLOCK.finditer(text):
            with contextlib.redirect_stdout(io.StringIO()) as printed:
                exec(block["code"], names)
            if block["name"]:
                plots.save_figure(names["fig"], block["name"], place)
            yield block, printed.getvalue()


def with_pictures(text, place):
    """Return the guide with its drawing run, and each block of it replaced by the figure."""
    for block, _ in list(run_guide(text, place)):
        if block["name"]:
            width, height = svg_size(place / f"{block['name']}.svg")
            figure = {"name": block["name"], "alt": block["alt"], "width": width, "height": height}
            text = text.replace(block[0], raw_html(picture(figure, folder="_static")))
    return text


def picture(figure, root="", folder="figures"):
    """Return a figure as HTML: its SVG, with a link to it."""
    return str(environment().get_template("figures.html").module.picture(figure, root, folder)).strip()


def mathjax():
    """Return MathJax, after checking that it is the file of its project."""
    package, name = MATHJAX
    data = Path(distribution(package).locate_file(name)).read_bytes()
    if hashlib.sha256(data).hexdigest() != MATHJAX_SHA256:
        raise ValueError(f"{name} of {package} is not es5/tex-svg.js of MathJax 3.2.2")
    return data


def api():
    """Return the headings of the API page, each with its modules: those of the layout, and what is in papers/."""
    papers = sorted(path.stem for path in (ROOT / "mpt_helpers" / "papers").glob("[a-z]*.py"))
    return {
        "Models and filters": ["model", "filters", "steady", "combined", "riccati", "recursion"],
        "Judging them": ["metrics", "monte_carlo"],
        "What the papers need": [f"papers.{name}" for name in papers],
        "What the papers print, and whether it holds": ["ledger.paper", "ledger.verdicts", "ledger.tables"],
        "Figures": ["plots"],
    }


# A letter with an index or a power: P_k, A^(ν-1). A small letter is one only where no word ends with it.
SYMBOL = re.compile(r"((?:[A-ZΑ-ω]|(?<![A-Za-z\d_.])[a-z])\u0302?²?)([_^])(\([^()]*\)|\d+|[A-Z]+|[a-zν]{1,2}(?![a-z]))")


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
        "grouped": grouped,
        "by_cause": by_cause,
        "claims": claims,
        "reasons": reasons,
        "common": common,
        "shorten": shorten,
        "live_presets": live_presets,
    }
    env.filters |= {
        "slug": lambda text: text.replace(" ", "-"),
        "code": lambda text: re.sub(r"`([^`]*)`", r"\1", text),
        "place": place,
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
    for part in ("source/notebooks", "static", "extra/notebooks"):
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
    env.globals |= {
        "given": given,
        "tally": given.tally(),
        "texts": about,
        "accuracy": svg_size(BUILD / "static" / "accuracy.svg"),
        "titles": {key: title(each["cells"]) for key, each in notebooks.items()},
        "figures": {key: figures_of(key, each["cells"]) for key, each in notebooks.items()},
        "api": api().items(),
        "speed": (ROOT / "benchmarks" / "README.md").read_text(encoding="utf-8"),
    }
    for page in sorted(DOCS.glob("*.md")):
        # In a checkout, the notebooks' folder stands beside docs/; on the site, below its pages.
        text = page.read_text(encoding="utf-8").replace("](../notebooks/", "](notebooks/")
        text = INCLUDE.sub(raw_html(r'{% include "\1" %}'), CHECKOUT.sub("", text))
        text = env.from_string(text).render(root="")
        if page.name == "guide.md":
            text = with_pictures(text, BUILD / "static")
        (BUILD / "source" / page.name).write_text(text, encoding="utf-8")
    for key, notebook in notebooks.items():
        shutil.copy(ROOT / "notebooks" / f"{key}.ipynb", BUILD / "extra" / "notebooks")
        own, here = given.of(key), {"key": key, "root": "../"}
        html = {
            "live": (about["live"]["after"], env.get_template("live.html").render(here)),
            "verdicts": lambda cell, own=own, here=here: env.get_template("chips.html").render(
                here, cell=cell, verdicts=[each for each in own if each.cell == cell]
            ),
        }
        for name, whole in ((key, False), (f"{key}-full", True)):
            page = html | {"top": env.get_template("top.html").render(here, whole=whole)}
            text = json.dumps(prepared(key, notebook, page, whole), ensure_ascii=False)
            (BUILD / "source" / "notebooks" / f"{name}.ipynb").write_text(text, encoding="utf-8")
    shutil.copytree(ROOT / "figures", BUILD / "extra" / "figures")
    shutil.copy(DOCS / "track.csv", BUILD / "extra")
    (BUILD / "static" / "tex-svg.js").write_bytes(mathjax())
    write_tables(given, BUILD / "extra")
    for png in (BUILD / "static").glob("*.png"):
        png.unlink()


if __name__ == "__main__":
    main()
