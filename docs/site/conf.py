"""Configuration of the documentation site: `sphinx-build -W --keep-going -b html docs/site build/site`."""

from __future__ import annotations

import sys
from pathlib import Path

import sphinx.ext.autosummary

import nqr_geom

# A summary does not end at "Eq.".
sphinx.ext.autosummary.WELL_KNOWN_ABBREVIATIONS += ("Eq.", "Eqs.", "Fig.", "Figs.", "Sec.")

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "extensions"))  # where Sphinx looks for extensions of a site

project = "nqr_geom"
author = "The nqr_geom developers"
copyright = "The nqr_geom developers"
version = release = nqr_geom.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "cyclopts.ext.sphinx",
    "mathml",  # in extensions/, as those below
    "generated_pages",
]
exclude_patterns = ["extensions"]
templates_path = ["templates"]

default_role = "code"
autosummary_generate = True
autodoc_typehints = "none"  # numpydoc sections say types with shape and range
autodoc_default_options = {"members": True, "member-order": "bysource"}
numpydoc_show_class_members = False
numpydoc_attributes_as_param_list = True

myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "attrs_inline", "colon_fence"]
myst_heading_anchors = 3
suppress_warnings = ["myst.header"]  # a card's page or the changelog may start below the first level

html_theme = "furo"
html_title = f"nqr_geom {release}"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
pygments_style = "friendly"
pygments_dark_style = "monokai"
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#3b5b92", "color-brand-content": "#3b5b92"},
    "dark_css_variables": {"color-brand-primary": "#9db8e8", "color-brand-content": "#9db8e8"},
}
