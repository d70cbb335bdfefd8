"""How Sphinx builds the site from what pages.py has put together."""

import re
from pathlib import Path

from docutils import nodes

import mpt_helpers

project = "mpt_helpers"
author = "the authors of mpt_helpers"
release = mpt_helpers.__version__
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.mathjax"]
suppress_warnings = ["mystnb.unknown_mime_type"]
nb_execution_mode = "off"
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3
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
html_show_sphinx = False
html_copy_source = False
mathjax_path = "tex-svg.js"
mathjax3_config = {"options": {"enableMenu": False}}
pygments_style = "a11y-high-contrast-light"
pygments_dark_style = "a11y-high-contrast-dark"


def name_cells(app, doctree):
    """Give each code cell the anchor #cell-ID, and each picture of a notebook a link to its SVG."""
    for cell in doctree.findall(lambda node: node.get("nb_element") == "cell_code" if node.children else False):
        cell["ids"].append(f"cell-{cell['cell_metadata']['id']}")
        for image in list(cell.findall(nodes.image)):
            link = nodes.reference("", "", refuri=f"../figures/{cell['cell_metadata']['figure']}.svg")
            image.replace_self(link)
            link += image


def escape_docstring(app, what, name, obj, options, lines):
    """Keep stars and bars of plain docstrings from being read as markup."""
    for i, line in enumerate(lines):
        if not line.lstrip().startswith((">>>", "...")):
            lines[i] = re.sub(r"([*|])", r"\\\1", line)


def setup(app):
    """Connect the two."""
    app.connect("doctree-read", name_cells)
    app.connect("autodoc-process-docstring", escape_docstring)
