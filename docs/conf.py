"""Configuration of the documentation site: `make docs` writes it to out/docs."""

import sys
import tomllib
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE / "_ext"))

project = "pkm-oed"
author = "The pkm-oed authors"
copyright = author
with (HERE.parent / "pyproject.toml").open("rb") as file:
    release = tomllib.load(file)["project"]["version"]
version = release

extensions = [
    "api_pages",
    "mathml",
    "myst_parser",
    "plain_docstrings",
    "reference_pages",
    "sphinx.ext.autodoc",
    "sphinx_copybutton",
    "sphinx_design",
]
exclude_patterns = ["_ext"]

# -- pages -----------------------------------------------------------------------------

myst_enable_extensions = ["attrs_block", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
myst_url_schemes = ["http", "https", "mailto"]
copybutton_exclude = ".linenos, .gp, .go"
copybutton_prompt_text = "$ "
copybutton_only_copy_prompt_lines = False

# -- API -------------------------------------------------------------------------------

autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_typehints_format = "short"
autodoc_type_aliases = {name: name for name in ("Array", "Index", "Mask", "Expr")}
autodoc_use_type_comments = False
add_module_names = False
toc_object_entries = False  # functions in every navigation tree double the time
nitpick_ignore_regex = [("py:class", ".*")]  # types in signatures: NumPy's and others'

# -- HTML ------------------------------------------------------------------------------

html_theme = "furo"
html_title = f"pkm-oed {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_show_sphinx = False
html_copy_source = False
