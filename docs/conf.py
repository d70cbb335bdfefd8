"""How Sphinx builds the site from what pages.py has put together."""

import re

from docutils import nodes

import mpt_helpers

project = "mpt_helpers"
release = mpt_helpers.__version__
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.mathjax"]
nb_execution_mode = "off"
suppress_warnings = ["mystnb.unknown_mime_type"]  # the verdicts for machines, beside their table
myst_enable_extensions = ["dollarmath"]
default_role = "py:obj"
add_module_names = False
autodoc_member_order = "bysource"
html_theme = "furo"
html_title = "mpt_helpers"
html_favicon = "_static/icon.svg"
html_static_path = ["_static", "_build/static"]
html_extra_path = ["_build/extra"]
html_css_files = ["site.css"]
html_js_files = [("values.js", {"defer": "defer"})]
html_show_sphinx = html_show_copyright = False
html_copy_source = html_show_search_summary = False  # summaries cannot be read from files
html_use_index = html_domain_indices = False
mathjax_path = "tex-svg.js"
mathjax3_config = {"options": {"enableMenu": False}}
pygments_style = "a11y-high-contrast-light"
pygments_dark_style = "a11y-high-contrast-dark"


def name_parts(app, doctree):
    """Give each code cell the anchor #cell-ID, each of its pictures a link to its SVG, and long formulas a class."""
    for cell in doctree.findall(lambda node: node.get("nb_element") == "cell_code" if node.children else False):
        cell["ids"].append(f"cell-{cell['cell_metadata']['id']}")
        for image in list(cell.findall(nodes.image)):
            link = nodes.reference("", "", refuri=f"../figures/{cell['cell_metadata']['figure']}.svg")
            image.replace_self(link)
            link += image
    for formula in doctree.findall(nodes.math):
        if len(formula.astext()) > 35:  # too wide for a phone
            formula["classes"].append("long")


def plain_docstring(app, what, name, obj, options, lines):
    """Read docstrings as plain text: an indented part is a formula, as it stands; stars and bars are no markup."""
    parts = "\n".join(lines).split("\n\n")
    for i, part in enumerate(parts):
        if part.startswith("    "):
            parts[i] = f"::\n\n{part}"
        elif not part.startswith(">>>"):
            parts[i] = re.sub(r"([*|])|(?<=\w)_(?!\w)", r"\\\g<0>", part)
    lines[:] = "\n\n".join(parts).splitlines()


def setup(app):
    """Connect the two."""
    app.connect("doctree-read", name_parts)
    app.connect("autodoc-process-docstring", plain_docstring)
