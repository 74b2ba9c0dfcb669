"""Sphinx configuration: `make docs` builds the site without network access."""

import os
import sys
import tempfile
from pathlib import Path

import rodnet

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

# pages of the validation gallery share what a build has computed once
os.environ["RODNET_GALLERY"] = tempfile.mkdtemp(prefix="rodnet-gallery-")

project = "rodnet"
author = "The rodnet developers"
copyright = author
release = rodnet.__version__
version = ".".join(release.split(".")[:2])

extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx-mathjax-offline",  # pages read without a network, too
    "term_entry",
]
templates_path = ["_templates"]
exclude_patterns = ["_build", "jupyter_execute", "**.ipynb_checkpoints"]
nitpicky = False
default_role = "py:obj"

# -- pages and notebooks -------------------------------------------------------------------
myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath", "smartquotes"]
myst_heading_anchors = 3
nb_execution_mode = "auto"
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_execution_timeout = 900  # a page that runs all of the gallery takes five minutes where cores are shared
nb_merge_streams = True
nb_render_markdown_format = "myst"

# -- mathematics: equations are numbered by page, (2.3) -------------------------------------
numfig = True
math_numfig = True
numfig_secnum_depth = 1
math_eqref_format = "({number})"
mathjax3_config = {
    "tex": {
        "macros": {
            "vec": [r"\boldsymbol{#1}", 1],
            "mat": [r"\mathsf{#1}", 1],
            "T": r"^{\mathsf{T}}",
        }
    }
}

# -- API -----------------------------------------------------------------------------------
autosummary_generate = True
autosummary_imported_members = True
autosummary_ignore_module_all = False
autodoc_member_order = "bysource"
autodoc_typehints = "none"
numpydoc_show_class_members = False
numpydoc_xref_param_type = False

# -- output --------------------------------------------------------------------------------
html_theme = "furo"
html_title = f"rodnet {release}"
html_show_sphinx = False
copybutton_exclude = ".linenos, .gp, .go"


def setup(app):
    """Pages are read by several processes; this extension has a part in none of them, but doesn't say so."""
    app.extensions["sphinx-mathjax-offline"].parallel_read_safe = True
