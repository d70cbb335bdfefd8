"""Put together what Sphinx builds the site from: run as `python docs/pages.py` in the project's folder.

Everything that says what the papers print and what was computed comes from the executed notebooks.
"""

import hashlib
import json
import re
import shutil
import struct
from html import escape
from importlib.metadata import distribution
from pathlib import Path
from typing import NamedTuple

from mpt_helpers.__main__ import FIGURES, NOTEBOOKS, as_csv, as_json, known, verdicts
from mpt_helpers.published import ERRATUM, VERDICTS, counts_by_paper

ROOT = Path(__file__).parents[1]
BUILD = ROOT / "docs" / "_build"
# es5/tex-svg.js of MathJax 3.2.2, as in the package `mathjax` of the npm registry.
MATHJAX = "sphinx-mathjax-offline", "sphinx-mathjax-offline/static/mathjax/tex-svg.js"
MATHJAX_SHA256 = "d4295dc33744836935c1399feece5159577b34c5c8ffb9f1c6324cd82e03a882"
SEE = "*What to see:*"


class Drawn(NamedTuple):
    """A figure of a notebook: the name of its files, what it is called, its caption, its cell and its alt text."""

    name: str
    label: str
    caption: str
    cell: str
    alt: str


def source(cell):
    """Return the source of a notebook's cell as text."""
    return "".join(cell["source"])


def cell_link(verdict):
    """Return the address of the cell that gave a verdict."""
    return f"notebooks/{verdict.paper}.html#cell-{verdict.cell}"


def values_link(paper=None, verdict=None):
    """Return the address of the values page, filtered."""
    chosen = [f"{name}={value.replace(' ', '+')}" for name, value in (("paper", paper), ("verdict", verdict)) if value]
    return "values.html" + ("#" + "&".join(chosen) if chosen else "")


def paper_title(cells):
    """Return the title of a notebook."""
    return re.match(r"# (.*)", source(cells[0]))[1]


def counts_html(given):
    """Return the table of counts; each count links to those values."""
    table = counts_by_paper(given)
    header = "".join(f'<th scope="col">{name}</th>' for name in table.header)
    rows = []
    for paper, items, *counts in table.rows:
        key = None if paper == "all" else paper
        name = f'<a href="notebooks/{paper}.html">{paper}</a>' if key else paper
        links = [f'<a href="{values_link(key, verdict)}">{n}</a>' for verdict, n in zip(VERDICTS, counts, strict=True)]
        links = ["0" if n == "0" else link for n, link in zip(counts, links, strict=True)]
        cells = "".join(f"<td>{each}</td>" for each in (f'<a href="{values_link(key)}">{items}</a>', *links))
        rows.append(f'<tr><th scope="row">{name}</th>{cells}</tr>')
    return f'<div class="scroll"><table class="counts">\n<thead><tr>{header}</tr></thead>\n<tbody>\n' + (
        "\n".join(rows) + "\n</tbody>\n</table></div>"
    )


def home(about, given):
    """Return the head of the README with its table of counts and its picture as the site has them."""
    about = re.sub(r"(?s)<!-- verdicts.*end of verdicts -->", lambda _: counts_html(given), about)
    return re.sub(r"!\[(.*)\]\(figures/(\w+)\.png\)", lambda image: picture_html(image[2], image[1]), about)


def slip(verdict):
    """Return what kind of slip an erratum is: the first sentence of its reason, without its numbers."""
    return re.sub(r"[\d./]+\d", "#", verdict.reason).partition(". ")[0]


def errata_html(given, titles):
    """Return the errata of all papers as lists, one line for each kind of slip."""
    parts = []
    for paper, title in titles.items():
        errata = [each for each in given if each.paper == paper and each.verdict == ERRATUM]
        alike = {}
        for each in errata:
            alike.setdefault(slip(each), []).append(each)
        lines = "\n".join(f"<li>{_erratum_html(group)}</li>" for group in alike.values())
        link = f'<a href="{values_link(paper, ERRATUM)}">{len(errata)} errata</a>'
        parts.append(f"<h3>{escape(title)}: {link}</h3>\n<ul>\n{lines}\n</ul>")
    return '<div class="errata">\n' + "\n".join(parts) + "\n</div>"


def _erratum_html(group):
    first = group[0]
    place = "; ".join(dict.fromkeys(each.where.partition(",")[0] for each in group)) if group[1:] else first.where
    number = f" ({len(group)} items)" if group[1:] else ""
    number += f", as in {first.where}" if place != first.where else ""
    computed = f"; computed: {first.computed}" if len(first.computed) <= 40 else ""
    words = f"{number}: “{first.printed}”{computed}. {first.reason.partition(' Against ')[0]}"
    return f'<strong>{escape(place)}</strong>{escape(words)} <a href="{cell_link(first)}">proof</a>'


def values_html(given):
    """Return the table of all published values, one row each."""
    header = "".join(f'<th scope="col">{name}</th>' for name in ("paper", "place", "printed", "computed", "verdict"))
    return f'<table id="values">\n<thead><tr>{header}</tr></thead>\n<tbody>\n' + (
        "\n".join(_value_html(each) for each in given) + "\n</tbody>\n</table>"
    )


def _value_html(each):
    reason = f'<span class="reason">{escape(each.reason)}</span>' if each.reason else ""
    name = each.verdict.replace(" ", "-")
    return (
        f'<tr id="{each.paper}.{each.id}" data-paper="{each.paper}" data-verdict="{each.verdict}">'
        f'<th scope="row">{each.paper}</th><td data-label="place">{escape(each.where)}</td>'
        f'<td data-label="printed">{escape(each.printed)}</td>'
        f'<td data-label="computed">{escape(each.computed)} <a href="{cell_link(each)}">cell</a></td>'
        f'<td data-label="verdict"><span class="verdict {name}">{each.verdict}</span> {reason}</td></tr>'
    )


def filter_html(papers):
    """Return the form that filters the values; the script shows it."""

    def choose(name, options):
        options = "".join(f"<option>{each}</option>" for each in options)
        return f'<label>{name} <select name="{name}"><option value="">all</option>{options}</select></label>'

    papers, kinds = choose("paper", papers), choose("verdict", VERDICTS)
    search = '<label>text <input type="search" name="text"></label>'
    return f'<form id="filter" hidden>{papers} {kinds} {search} <output aria-live="polite"></output></form>'


def figures_of(key, cells):
    """Return the figures of a notebook; raises ValueError for one without its caption in the prose."""
    prose = [part for cell in cells if cell["cell_type"] == "markdown" for part in source(cell).split("\n\n")]
    drawn = []
    for i, cell in enumerate(cells):
        for name in re.findall(r'save_figure\(fig, "(\w+)"\)', source(cell)):
            own = name.removeprefix(f"{key}_")
            label = f"Figure {own[3:]}" if re.fullmatch(r"fig\d+", own) else f"Figure `{own}`"
            captions = [part for part in prose if part.startswith(f"**{label}.**")]
            if len(captions) != 1:
                raise ValueError(f"{name}: needs one paragraph that begins with **{label}.**, got {len(captions)}")
            caption = captions[0].removeprefix(f"**{label}.** ")
            if SEE not in caption:  # then it may stand below the figure
                below = source(cells[i + 1]).split("\n\n")
                caption = " ".join([caption, *(part for part in below if part.startswith(SEE))])
            pictures = [out for out in cell["outputs"] if "image/png" in out.get("data", {})]
            (alt,) = (out["metadata"]["image/png"]["alt"] for out in pictures)
            drawn.append(Drawn(name, label, caption, cell["id"], alt))
    return drawn


def png_size(name):
    """Return the width and height of a figure's PNG, in pixels."""
    return struct.unpack(">II", (ROOT / FIGURES / f"{name}.png").read_bytes()[16:24])


def picture_html(name, alt):
    """Return a figure that links to its SVG."""
    width, height = png_size(name)
    image = f'<img src="figures/{name}.png" alt="{escape(alt)}" width="{width}" height="{height}" loading="lazy">'
    return f'<a href="figures/{name}.svg">{image}</a>'


def gallery(notebooks):
    """Return the figures of all notebooks in Markdown, each with its caption and links."""
    parts = []
    for key, cells in notebooks.items():
        parts.append(f"## {paper_title(cells)}")
        for each in figures_of(key, cells):
            parts.append(
                f"### {each.label}, {key[:4]}\n\n{picture_html(each.name, each.alt)}\n\n{each.caption}\n\n"
                f'<p class="downloads"><a href="notebooks/{key}.html#cell-{each.cell}">cell</a> '
                f"{file_links(each.name)}</p>"
            )
    return "\n\n".join(parts)


def file_links(name, root=""):
    """Return the links to a figure's files."""
    return " ".join(f'<a href="{root}figures/{name}.{kind}" download>{kind.upper()}</a>' for kind in ("png", "svg"))


def downloads(key, cells):
    """Return the links to a notebook's files."""
    links = [f'<a href="{key}.ipynb" download>the notebook</a>']
    links += [f"{each.label.replace('`', '')}: {file_links(each.name, '../')}" for each in figures_of(key, cells)]
    links.append(f'<a href="../{values_link(key)}">all its verdicts</a>')
    items = "".join(f"<li>{link}</li>" for link in links)
    return f'<details class="downloads"><summary>Downloads</summary><ul>{items}</ul></details>'


def prepared(key, notebook):
    """Return a notebook as it is rendered: cells that know their id, pictures with alt text and size, downloads."""
    drawn = {each.cell: each for each in figures_of(key, notebook["cells"])}
    for cell in notebook["cells"]:
        cell["metadata"]["id"] = cell["id"]
        if each := drawn.get(cell["id"]):
            width, height = map(str, png_size(each.name))
            image = {"alt": each.alt, "width": width, "height": height}
            cell["metadata"] |= {"figure": each.name, "mystnb": {"image": image}}
    first = notebook["cells"][0]
    first["source"] = f"{source(first)}\n\n{downloads(key, notebook['cells'])}\n"
    return notebook


def mathjax():
    """Return MathJax, after checking that it is the file of its project."""
    package, name = MATHJAX
    data = Path(distribution(package).locate_file(name)).read_bytes()
    if hashlib.sha256(data).hexdigest() != MATHJAX_SHA256:
        raise ValueError(f"{name} of {package} is not es5/tex-svg.js of MathJax 3.2.2")
    return data


def main():
    """Write docs/_build afresh: source, static and extra."""
    given = verdicts([])
    notebooks = {key: json.loads((ROOT / NOTEBOOKS / f"{key}.ipynb").read_text(encoding="utf-8")) for key in known([])}
    cells = {key: notebook["cells"] for key, notebook in notebooks.items()}
    titles = {key: paper_title(each) for key, each in cells.items()}
    readme = (ROOT / "README.md").read_text(encoding="utf-8").partition("\n## Without make")[0]
    about, commands, how = readme.partition("With Python 3.11")
    made = {
        "ABOUT": home(about, given),
        "COMMANDS": commands + how,
        "ERRATA": errata_html(given, titles),
        "FILTER": filter_html(titles),
        "VALUES": values_html(given),
        "GALLERY": gallery(cells),
        "SPEED": (ROOT / "benchmarks" / "README.md").read_text(encoding="utf-8"),
    }
    shutil.rmtree(BUILD, ignore_errors=True)
    for part in ("source", "static", "extra"):
        (BUILD / part).mkdir(parents=True)
    for page in sorted((ROOT / "docs").glob("*.md")):
        text = re.sub(r"%%([A-Z]+)%%", lambda place: made[place[1]], page.read_text(encoding="utf-8"))
        (BUILD / "source" / page.name).write_text(text, encoding="utf-8")
    for folder in ("source", "extra"):
        (BUILD / folder / NOTEBOOKS).mkdir()
    shutil.copytree(ROOT / FIGURES, BUILD / "extra" / FIGURES)
    for key, notebook in notebooks.items():
        shutil.copy(ROOT / NOTEBOOKS / f"{key}.ipynb", BUILD / "extra" / NOTEBOOKS)
        text = json.dumps(prepared(key, notebook), ensure_ascii=False)
        (BUILD / "source" / NOTEBOOKS / f"{key}.ipynb").write_text(text, encoding="utf-8")
    (BUILD / "static" / "tex-svg.js").write_bytes(mathjax())
    (BUILD / "extra" / "verdicts.json").write_text(as_json(given), encoding="utf-8")
    (BUILD / "extra" / "verdicts.csv").write_text(as_csv(given), encoding="utf-8")


if __name__ == "__main__":
    main()
