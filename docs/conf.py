"""The documentation site: `make docs` writes it to docs/_build/html. Nothing is fetched when it is built or read."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_ext"))

from startracker import __version__  # noqa: E402

project = "boresight"
author = "The boresight developers"
copyright = "the boresight developers"
version = release = __version__

extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx_design",
    "reference_pages",
    "mathml",
]
exclude_patterns = ["_build", "_ext", "make_images", "reports"]
suppress_warnings = ["config.cache"]

myst_enable_extensions = ["colon_fence", "dollarmath", "deflist", "attrs_block"]
myst_heading_anchors = 3
nb_execution_mode = "off"  # notebooks ship executed, and the tests execute them again
nb_ipywidgets_js = {}  # the default is a content delivery network
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the sections of a docstring have the types
autodoc_preserve_defaults = True
numpydoc_show_class_members = False
numpydoc_xref_param_type = False
python_maximum_signature_line_length = 80
toc_object_entries_show_parents = "hide"
default_role = "literal"  # docstrings write `name` for code

html_theme = "pydata_sphinx_theme"
html_title = "boresight"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "logo": {"text": "boresight"},
    "navigation_with_keys": False,
    "show_toc_level": 2,
    "header_links_before_dropdown": 6,
    "navbar_align": "left",
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "back_to_top_button": False,
}
html_sidebars = {"index": []}
