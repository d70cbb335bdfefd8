"""How Sphinx builds the site from what pages.py has put together."""

import json
import re
import sys
from html import escape
from pathlib import Path

from docutils import nodes

import mpt_helpers

sys.path.insert(0, str(Path(__file__).parent))
import pages

project = "mpt_helpers"
release = mpt_helpers.__version__
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.mathjax"]
nb_execution_mode = "off"
# Verdicts for machines; the full notebooks; names such as P that several classes have.
suppress_warnings = ["mystnb.unknown_mime_type", "toc.not_included", "ref.python"]
myst_enable_extensions = ["dollarmath", "attrs_inline"]
default_role = "py:obj"
add_module_names = False
autodoc_member_order = "bysource"
html_theme = "furo"
html_title = "mpt_helpers"
html_favicon = "_static/icon.svg"
html_static_path = ["_static", "_build/static"]
html_extra_path = ["_build/extra"]
html_css_files = ["site.css"]
html_js_files = [(name, {"defer": "defer"}) for name in ("values.js", "live.js", "sensor.js", "article.js")]
html_show_sphinx = html_show_copyright = False
html_copy_source = html_show_search_summary = False  # summaries cannot be read from files
html_use_index = html_domain_indices = False
mathjax_path = "tex-svg.js"
mathjax3_config = {"options": {"enableMenu": False}}
pygments_style = "a11y-high-contrast-light"
pygments_dark_style = "a11y-high-contrast-dark"


def name_parts(app, doctree):
    """Give each code cell the anchor #cell-ID, fold its code, show its figures as SVG, and mark long formulas."""
    for cell in doctree.findall(lambda node: node.get("nb_element") == "cell_code" if node.children else False):
        about = cell["cell_metadata"]
        cell["ids"].append(f"cell-{about['id']}")
        for code in [each for each in cell.children if each.get("nb_element") == "cell_code_source"]:
            state = "" if about["folded"] else " open"
            at = cell.index(code)
            cell.insert(at, raw(f'<details class="code"{state}><summary>code</summary>'))
            cell.insert(at + 2, raw("</details>"))
        for image in list(cell.findall(nodes.image)):
            if "figure" in about:
                image.replace_self(raw(pages.picture(about["figure"], root="../")))
    for formula in doctree.findall(nodes.math):
        if len(formula.astext()) > 35:  # too wide for a phone
            formula["classes"].append("long")
    for code in doctree.findall(nodes.literal):
        if len(code.astext()) <= 28:  # fits a line of a phone
            code["classes"].append("unbroken")
    add_contents(app.env.docname, doctree)


WITH_CONTENTS = re.compile(r"guide|by_hand|rinex|accuracy|notebooks/.*(?<!-full)")


def add_contents(name, doctree):
    """Give a long page a list of its sections, and an article one more below the heading of Part II."""
    if not WITH_CONTENTS.fullmatch(name):
        return
    (top,) = (each for each in doctree.children if isinstance(each, nodes.section))
    parts = [each for each in top.children if isinstance(each, nodes.section)]
    after_title = top.first_child_matching_class(nodes.title) + 1
    starts = [i for i, part in enumerate(parts) if title_of(part).startswith("Part II")]
    if starts:
        evidence = parts[starts[0]]
        inside = [each for each in evidence.children if isinstance(each, nodes.section)] + parts[starts[0] + 1 :]
        evidence.insert(evidence.first_child_matching_class(nodes.title) + 1, contents("Its sections", inside))
        parts = parts[: starts[0] + 1]
    top.insert(after_title, contents("On this page", parts))


def title_of(section):
    """Return the heading of a section as text."""
    return section.next_node(nodes.title).astext()


def contents(summary, sections):
    """Return a list of links to sections that opens."""
    items = "".join(f'<li><a href="#{each["ids"][0]}">{escape(title_of(each))}</a></li>' for each in sections)
    return raw(f'<details class="sections"><summary>{summary}</summary><ul>{items}</ul></details>')


def describe(app, pagename, templatename, context, doctree):
    """Give a page its description, from papers.toml."""
    words = json.loads((pages.BUILD / "words.json").read_text(encoding="utf-8"))
    place, _, key = pagename.rpartition("/")
    key = key.removesuffix("-full")
    said = words["descriptions"].get(pagename)
    if key in words["papers"]:
        paper = words["papers"][key]
        first = {"corrections": "Corrections to ", "notebooks": "Checked: "}[place]
        said = f"{first}{paper['authors']}. {paper['outcome']}"
    context["metatags"] = (
        context.get("metatags", "")
        + f'<meta name="description" content="{escape(said or words["descriptions"]["index"])}">'
    )


def size_pictures(app, doctree):
    """Give each PNG picture its width and height: the page then does not jump when the picture comes."""
    for image in doctree.findall(nodes.image):
        if image["uri"].endswith(".png"):
            header = (Path(app.srcdir) / image["uri"]).read_bytes()[16:24]
            image["width"], image["height"] = str(int.from_bytes(header[:4])), str(int.from_bytes(header[4:]))


def raw(html):
    """Return HTML as a node."""
    return nodes.raw("", html, format="html")


def plain_docstring(app, what, name, obj, options, lines):
    """Read docstrings as plain text: an indented part is a formula, as it stands; stars and bars are no markup.

    A formula that writes a matrix as [a b; c d] is set as math.
    """
    parts = "\n".join(lines).split("\n\n")
    for i, part in enumerate(parts):
        if part.startswith("    ") and MATRIX.search(part):
            parts[i] = ", ".join(f":math:`{as_tex(each)}`" for each in re.split(r",?\s{2,}", part.strip()))
        elif part.startswith("    "):
            parts[i] = f"::\n\n{part}"
        elif not part.startswith(">>>"):
            parts[i] = re.sub(r"([*|])|(?<=\w)_(?!\w)", r"\\\g<0>", part)
    lines[:] = "\n\n".join(parts).splitlines()


MATRIX = re.compile(r"\[([^\[\]]*;[^\[\]]*)\]")
POWERS = {
    "⁻¹": "^{-1}",
    "²": "^2",
    "³": "^3",
    "⁴": "^4",
    "⁵": "^5",
    "ᵀ": "^T",
    "dt": r"\Delta t",
    "diag": r"\mathrm{diag}",
}


def as_tex(formula):
    """Return a formula such as F = [1 dt; 0 1] as TeX."""

    def matrix(found):
        rows = [" & ".join(row.split()) for row in found[1].split(";")]
        return r"\begin{bmatrix}" + r" \\ ".join(rows) + r"\end{bmatrix}"

    formula = re.sub(r"\[([^\[\]]*)\]", matrix, formula)
    for plain, tex in POWERS.items():
        formula = formula.replace(plain, tex)
    return formula


def setup(app):
    """Connect them."""
    app.connect("doctree-read", name_parts)
    app.connect("doctree-read", size_pictures)
    app.connect("html-page-context", describe)
    app.connect("autodoc-process-docstring", plain_docstring)
