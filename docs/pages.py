"""Put together what Sphinx builds the site from: run as `python docs/pages.py` in the project's folder.

Everything that says what the papers print and what was computed comes from the verdicts in the executed notebooks. The
few sentences per paper are in papers.toml, where each number is looked up in a verdict; home.py computes what the home
page says, corrections.py writes the corrections, archive.py packs the source. The HTML is in templates/.
"""

import csv
import hashlib
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

import archive
import break_sensor
import corrections
import home
import numpy as np
import speed
import yaml
from corrections import place
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

import mpt_helpers as mpt
from mpt_helpers import plots
from reproduction import figures
from reproduction.ledger import Verdicts, keys, stored_verdicts
from reproduction.ledger.verdicts import BASES, CANNOT_BE_CHECKED, CAUSE_KINDS, FIELDS, OF_CLAIMS, VERDICTS

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
BUILD = DOCS / "_build"
# es5/tex-svg.js of MathJax 3.2.2, as in the package `mathjax` of the npm registry.
MATHJAX = "sphinx-mathjax-offline", "sphinx-mathjax-offline/static/mathjax/tex-svg.js"
MATHJAX_SHA256 = "d4295dc33744836935c1399feece5159577b34c5c8ffb9f1c6324cd82e03a882"
SAVED = re.compile(r'save_figure\([^"]+, "(\w+)"\)')
# More verdicts than this that share their table, outcome and cause become one row, or one chip, that opens.
FOLD = 4
PART_2 = re.compile(r"(?m)^## Part II\b")
# What the filter of the values calls all that did not come out as printed.
NOT_REPRODUCED = "not reproduced"
# What a page holds for the site, hidden where Markdown is shown as it is: a template.
INCLUDE = re.compile(r"<!-- include (\w+\.html) -->")
CHECKOUT = re.compile(r" ?<!-- checkout -->.*?<!-- /checkout -->", re.DOTALL)  # for readers of a checkout only


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
    """A figure of a notebook: its file's name, what it is called, its heading, its caption and what that concludes."""

    name: str
    label: str
    heading: str
    caption: str
    conclusion: str
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
    """Return the figures of a notebook; the caption is the paragraph that begins with **Figure 1.** or so."""
    prose = [part for cell in cells if cell["cell_type"] == "markdown" for part in source(cell).split("\n\n")]
    drawn, section = [], "What we found"
    for cell in cells:
        if cell["cell_type"] == "markdown":
            section = [section, *re.findall(r"(?m)^###? (?:\d+\. )?(.*)", source(cell))][-1]
        for name in SAVED.findall(source(cell)) if cell["cell_type"] == "code" else []:
            own = name.removeprefix(f"{key}_")
            label = f"Figure {own[3:]}" if re.fullmatch(r"fig\d+", own) else f"Figure `{own}`"
            heading = label if label[-1].isdigit() else f"{section} ({label[0].lower()}{label[1:]})"
            captions = [part for part in prose if label in names_of(part)]
            (alt,) = (
                out["metadata"]["image/png"]["alt"] for out in cell["outputs"] if "image/png" in out.get("data", {})
            )
            width, height = svg_size(ROOT / "figures" / f"{name}.svg")
            caption = re.sub(r"\]\((\w+\.ipynb)", r"](notebooks/\1", captions[0]) if captions else alt
            said = conclusion(caption)
            drawn.append(Drawn(name, label, heading, caption, said, cell["id"], alt, width, height))
    return drawn


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
    """Return papers.toml with what it looks up in verdicts; raises KeyError for an item that is not there."""
    by_id = {(each.paper, each.id): each for each in given}
    lookups = {
        "printed": lambda paper, id: by_id[paper, id].printed,
        "computed": lambda paper, id: by_id[paper, id].computed,
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


def home_page(given, about):
    """Return what the home page says: the words of papers.toml with the numbers of home.py in them."""
    by_id = {(each.paper, each.id): each for each in given}

    def said(mistake):
        words = {name: unbroken(text.format(**mistake.words)) for name, text in about["mistakes"][mistake.name].items()}
        return words | {"scene": mistake.scene, "proof": mistake.proof}

    filters = home.choice()
    metres, choices = home.in_metres(by_id), home.of_choice(by_id)
    counts = home.outcomes(given)
    numbers = {"late": next(each.words["metres"] for each in metres if each.name == "lag")}
    for name in ("claims", "values"):
        numbers |= {f"{name}_{part}": n for part, n in zip(("hold", "part", "all"), counts[name], strict=True)}
    values = [each for each in given if each.kind != "claim"]
    numbers["table4"] = next(each.words["wrong"] for each in choices if each.name == "table4")
    return {
        "short": {name: unbroken(about["home"][name].format(**numbers)) for name in ("hold", "cost", "take")},
        "choice": [{name: unbroken(text.format(**filters)) for name, text in row.items()} for row in about["choice"]],
        "metres": [said(each) for each in metres],
        "choices": [said(each) for each in choices],
        "lost": sum(each.verdict == CANNOT_BE_CHECKED for each in values),
        "table4": numbers["table4"],
    }


def draw_sensor(folder):
    """Draw what the first figure shows first, as sensor.svg, and return what the page needs to know of it."""
    fig = break_sensor.draw("gap")
    alt = figures.save_figure(fig, "sensor", folder).alt
    scene, track = break_sensor.SCENES["gap"], break_sensor.average()
    return {
        "data": break_sensor.for_the_page(),
        "json": json.dumps(break_sensor.for_the_page(), ensure_ascii=False),
        "size": svg_size(folder / "sensor.svg"),
        "alt": f"{alt} {break_sensor.said('gap')}",
        "numbers": break_sensor.numbers(scene, track),
        "order": break_sensor.run(scene, track).order,
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
        made["metadata"]["folded"] = not whole and not is_open(cell, evidence)
        made["metadata"]["tags"] = []  # code is folded here, not by myst-nb
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


def end_of_part_1(cells, figure):
    """Return after which cell the figure with sliders stands: its figure's, else the last one before Part II."""
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


def mathjax():
    """Return MathJax, after checking that it is the file of its project."""
    package, name = MATHJAX
    data = Path(distribution(package).locate_file(name)).read_bytes()
    if hashlib.sha256(data).hexdigest() != MATHJAX_SHA256:
        raise ValueError(f"{name} of {package} is not es5/tex-svg.js of MathJax 3.2.2")
    return data


# The modules of the core in the order in which they are read; others come after them, with what runs the filters.
FIRST = ["model", "filters", "steady", "predictor", "combined"]
JUDGE = ["metrics", "fitting", "bands", "monte_carlo"]
NOT_SHOWN = ["checks", "files", "plots"]


def api():
    """Return the headings of the API page, each with its modules: those of the layout, and what is in papers/."""
    papers = sorted(path.stem for path in (ROOT / "mpt_helpers" / "papers").glob("[a-z]*.py"))
    core = sorted(path.stem for path in (ROOT / "mpt_helpers").glob("[a-z]*.py"))
    others = [name for name in core if name not in (*FIRST, *JUDGE, *NOT_SHOWN)]
    return {
        "Models and filters": [name for name in FIRST if name in core],
        "Judging them": [name for name in JUDGE if name in core],
        "What runs them": others,
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
        "claims": claims,
        "cause_options": cause_options,
        "outcomes": home.outcomes,
        "common": common,
        "shorten": shorten,
        "NOT_REPRODUCED": NOT_REPRODUCED,
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
    for part in ("source/notebooks", "source/corrections", "static", "extra/notebooks"):
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
    size = write_archive(BUILD / "extra" / f"{name}.tar.gz", name, cff["date-released"])
    env.globals |= {
        "given": given,
        "texts": about,
        "home": home_page(given, about),
        "sensor": draw_sensor(BUILD / "static"),
        "archive": name,
        "archive_size": f"{size / 1e6:.1f} MB",
        "citation": own,
        "citation_of": lambda key: references.get(key[:4], about["papers"][key]["authors"]),
        "accuracy": svg_size(BUILD / "static" / "accuracy.svg"),
        "titles": {key: title(each["cells"]) for key, each in notebooks.items()},
        "figures": {key: figures_of(key, each["cells"]) for key, each in notebooks.items()},
        "api": api().items(),
        "speed": speed,
    }
    write_pages(env)
    for key, notebook in notebooks.items():
        write_article(env, key, notebook, given.of(key), about["live"]["after"])
        write_corrections(env, key, given.of(key), about)
    shutil.copytree(ROOT / "figures", BUILD / "extra" / "figures")
    shutil.copytree(DOCS / "tracks", BUILD / "extra" / "tracks")
    (BUILD / "static" / "tex-svg.js").write_bytes(mathjax())
    write_tables(given, BUILD / "extra")
    words = {"descriptions": about["descriptions"], "papers": about["papers"]}
    (BUILD / "words.json").write_text(json.dumps(words), encoding="utf-8")  # for conf.py
    for png in (BUILD / "static").glob("*.png"):
        png.unlink()


def write_archive(path, name, day):
    """Write the source of the project to a .tar.gz, and return its size in bytes."""
    data = archive.source(ROOT, name, day)
    path.write_bytes(data)
    return len(data)


def write_pages(env):
    """Write the pages of docs/ as they are rendered."""
    shutil.copytree(DOCS / "guide", BUILD / "source" / "guide")
    for page in sorted(DOCS.glob("*.md")):
        # In a checkout, the notebooks' folder stands beside docs/; on the site, below its pages.
        text = page.read_text(encoding="utf-8").replace("](../notebooks/", "](notebooks/")
        text = INCLUDE.sub(raw_html(r'{% include "\1" %}'), CHECKOUT.sub("", text))
        text = env.from_string(text).render(root="")
        (BUILD / "source" / page.name).write_text(text, encoding="utf-8")


def write_article(env, key, notebook, own, live):
    """Write the article and the full notebook of one paper."""
    shutil.copy(ROOT / "notebooks" / f"{key}.ipynb", BUILD / "extra" / "notebooks")
    here = {"key": key, "root": "../"}

    def verdicts(cell):
        chosen = [each for each in own if each.cell == cell]
        return env.get_template("chips.html").render(here, cell=cell, verdicts=chosen)

    html = {"live": (live, env.get_template("live.html").render(here)), "verdicts": verdicts}
    for name, whole in ((key, False), (f"{key}-full", True)):
        first = source(notebook["cells"][0])
        page = html | {"top": env.get_template("top.html").render(here, whole=whole, first=first)}
        text = json.dumps(prepared(key, notebook, page, whole), ensure_ascii=False)
        (BUILD / "source" / "notebooks" / f"{name}.ipynb").write_text(text, encoding="utf-8")


def write_corrections(env, key, own, about):
    """Write the page of corrections to one paper."""
    html = env.get_template("correction.html").render(
        key=key,
        rows=corrections.names_of_rows(own),
        sections=corrections.sections(own, about["corrected"].get(key, {})),
        lost=corrections.lost(own),
        questions=corrections.questions(own, about["questions"].get(key, {})),
    )
    text = f"---\nhide-toc: true\n---\n# Corrections to {about['papers'][key]['authors']}\n\n{raw_html(html)}\n"
    (BUILD / "source" / "corrections" / f"{key}.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
