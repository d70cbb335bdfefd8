"""How Sphinx builds the site from what pages.py has put together."""

import os
import re
import sys
from pathlib import Path

from docutils import nodes
from docutils.utils.math import MathError, latex2mathml
from sphinx.util import logging

import mpt_helpers

sys.path.insert(0, str(Path(__file__).parent))
import pages

logger = logging.getLogger(__name__)
project = "mpt_helpers"
release = mpt_helpers.__version__
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "sphinx_design",
    "sphinx_copybutton",
]
if os.environ.get("INTERSPHINX"):  # links to numpy and scipy: their lists of names come from the network
    extensions.append("sphinx.ext.intersphinx")
    intersphinx_mapping = {
        "python": ("https://docs.python.org/3", None),
        "numpy": ("https://numpy.org/doc/stable", None),
        "scipy": ("https://docs.scipy.org/doc/scipy", None),
    }
nb_execution_mode = "off"
nb_code_prompt_show = nb_code_prompt_hide = "code"  # the bar above folded code
# Verdicts for machines; the full notebooks; names such as P that several classes have.
suppress_warnings = ["mystnb.unknown_mime_type", "toc.not_included", "ref.python"]
myst_heading_anchors = 3  # links to sections, as code hosts make them
myst_enable_extensions = ["dollarmath", "attrs_inline", "attrs_block", "colon_fence"]
default_role = "py:obj"
add_module_names = False
toc_object_entries_show_parents = "hide"
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the sections of a docstring say shapes and units
autosummary_generate = True
numpydoc_show_class_members = False  # the page of a class shows them whole
autodoc_type_aliases = {"ArrayLike": "ArrayLike"}
copybutton_selector = ":not(.highlight-text, .highlight-myst-ansi) > div.highlight pre"
copybutton_prompt_text = r">>> |\.\.\. "
copybutton_prompt_is_regexp = True
html_theme = "pydata_sphinx_theme"
html_title = "Position tracking, checked"
html_favicon = "_static/icon.svg"
html_theme_options = {
    "logo": {"text": html_title, "image_light": "_static/icon.svg", "image_dark": "_static/icon.svg", "alt_text": ""},
    "navbar_align": "right",
    "navbar_persistent": ["search-button"],
    "navbar_end": ["theme-switcher"],
    "show_prev_next": False,
    "show_nav_level": 2,
    "navigation_depth": 2,
    "collapse_navigation": True,
    "show_toc_level": 2,
    "back_to_top_button": False,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["links"],
    "footer_end": [],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
html_context = {"default_mode": "auto"}
html_sidebars = {"index": [], "ledger": []}
templates_path = [str(Path(__file__).parent / "templates" / "theme")]  # absolute, for autosummary
html_static_path = ["_static", "_build/static"]
html_extra_path = ["_build/extra"]
html_css_files = ["colours.css", "site.css"]
html_show_sphinx = html_show_copyright = False
html_copy_source = html_show_search_summary = html_show_sourcelink = False  # summaries cannot be read from files
html_use_index = html_domain_indices = False
html_math_renderer = "mathml"


def skip_inner(app, what, name, each, skip, options):
    """Leave out what filters call of one another: the page of a class shows what a user calls."""
    return True if what == "class" and name in pages.INNER else None


def name_parts(app, doctree):
    """Give each code cell the anchor #cell-ID, and show its figures as SVG; name headers, mark short code."""
    for cell in doctree.findall(lambda node: node.get("nb_element") == "cell_code" if node.children else False):
        about = cell["cell_metadata"]
        cell["ids"].append(f"cell-{about['id']}")
        for image in list(cell.findall(nodes.image)):
            if "figure" in about:
                image.replace_self(raw(pages.picture(about["figure"], root="../" * app.env.docname.count("/"))))
    for head in doctree.findall(nodes.thead):
        for empty in [each for each in head.findall(nodes.entry) if not each.astext()]:
            empty += raw('<span class="visually-hidden">row</span>')  # or a screen reader has no name for it
    for code in doctree.findall(nodes.literal):
        if len(code.astext()) <= 28:  # fits a line of a phone
            code["classes"].append("unbroken")


def size_pictures(app, doctree):
    """Give each PNG picture its width and height: the page then does not jump when the picture comes."""
    for image in doctree.findall(nodes.image):
        if image["uri"].endswith(".png"):
            header = (Path(app.srcdir) / image["uri"]).read_bytes()[16:24]
            image["width"], image["height"] = str(int.from_bytes(header[:4])), str(int.from_bytes(header[4:]))


def lean_code(app, pagename, templatename, context, doctree):
    """Leave out the spans of code that have no style of their own: half the bytes of an article were theirs."""
    if "body" in context:
        context["body"] = UNSTYLED.sub(r"\1", context["body"]).replace("<pre><span></span>", "<pre>")


# Names, blanks, punctuation: a test holds that the styles of the site colour none of them.
UNSTYLED = re.compile(r'<span class="(?:n|nn|w|p)">([^<]*)</span>')


def raw(html):
    """Return HTML as a node."""
    return nodes.raw("", html, format="html")


def write_formula(self, node):
    """Write a formula in a line as MathML."""
    self.body.append(mathml(node.astext(), block=False))
    raise nodes.SkipNode


def write_display(self, node):
    """Write a displayed formula as MathML, in a box that scrolls where it is too wide."""
    self.body.append(f'<div class="math" tabindex="0">{mathml(node.astext(), block=True)}</div>')
    raise nodes.SkipNode


def mathml(tex, block):
    r"""Return a formula as MathML, by the converter of docutils.

    It knows no \dots, and a slash would have spaces around it.
    """
    try:
        made = latex2mathml.tex2mathml(tex.strip().replace(r"\dots", r"\ldots"), as_block=block)
    except MathError as error:
        logger.warning("the formula %r cannot be set: %s", tex, error)
        return ""
    return re.sub(r"<mo[^>]*>/</mo>", r'<mo lspace="0" rspace="0">/</mo>', made)


def plain_docstring(app, what, name, obj, options, lines):
    """Read the text of a docstring above its sections as plain text: an indented part is a formula, as it stands.

    Stars and bars are no markup. A formula that writes a matrix as [a b; c d] is set as math. Lines that continue
    indented are the items of a list. numpydoc reads the sections.
    """
    heads = [i for i, line in enumerate(lines) if i and re.fullmatch("-{3,}", line.strip())]
    end = heads[0] - 1 if heads else len(lines)
    parts = "\n".join(lines[:end]).rstrip().split("\n\n")
    for i, part in enumerate(parts):
        if part.startswith("    ") and MATRIX.search(part):
            parts[i] = ", ".join(f":math:`{as_tex(each)}`" for each in re.split(r",?\s{2,}", part.strip()))
        elif part.startswith("    "):
            parts[i] = f"::\n\n{part}"
        elif not part.startswith(">>>"):
            plain = re.sub(r"([*|])|(?<=\w)_(?!\w)", r"\\\g<0>", part)
            parts[i] = as_list(plain) if "\n    " in plain else plain
    lines[:] = [*"\n\n".join(parts).splitlines(), "", *lines[end:]]


def as_list(text):
    """Return lines, of which some continue indented on the next, as a list with an item for each."""
    return "\n".join(f"- {line}" for line in re.sub(r"\n +", " ", text).splitlines())


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


def named_by_its_text(app, pagename, templatename, context, doctree):
    """Leave folded code its text for a name: MyST-NB gives it another one that nobody reads."""
    if "body" in context:
        context["body"] = context["body"].replace(' aria-label="Toggle hidden content"', "")


def setup(app):
    """Connect them."""
    app.add_html_math_renderer("mathml", (write_formula, None), (write_display, None))
    app.connect("autodoc-skip-member", skip_inner)
    app.connect("doctree-read", name_parts)
    app.connect("doctree-read", size_pictures)
    app.connect("html-page-context", lean_code)
    app.connect("html-page-context", named_by_its_text)
    app.connect("autodoc-process-docstring", plain_docstring, priority=400)  # before numpydoc
