"""Sphinx configuration: ``make docs`` writes build/docs, without a network and without a warning."""

import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(Path(__file__).parent / "_ext")]

project = "nsfc"
author = "The nsfc developers"
html_title = "nsfc: shape from caustics"
html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["nsfc.css"]
html_copy_source = False
html_show_sourcelink = False
html_show_copyright = False

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_click",
    "sphinx_gallery.gen_gallery",
    # Of this project, in _ext.
    "api_modules",
    "config_keys",
    "mathml",
    "offline",
    "python_names",
]
exclude_patterns = ["_ext"]

myst_enable_extensions = ["amsmath", "attrs_inline", "dollarmath"]
myst_heading_anchors = 3
# MathJax would come from a server; MathML needs none.
html_math_renderer = "mathml"

autodoc_default_options = {"members": True, "ignore-module-all": True}
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
# There are none, and to look for them every function is read and parsed once more.
autodoc_use_type_comments = False
add_module_names = False
napoleon_numpy_docstring = False
napoleon_use_ivar = True
toc_object_entries = False
# Two packages may have classes of one name; a type then links to one of them.
suppress_warnings = ["ref.python"]

sphinx_gallery_conf = {
    "examples_dirs": [str(ROOT / "examples" / "gallery")],
    "gallery_dirs": ["gallery"],
    "filename_pattern": "/plot_",
    "within_subsection_order": "FileNameSortKey",
    # Every example asserts its own result: one that fails stops the build.
    "abort_on_example_error": True,
    "backreferences_dir": None,
    "copyfile_regex": "",
    "download_all_examples": False,
    "min_reported_time": 1000,
    "remove_config_comments": True,
    "show_signature": False,
    "write_computation_times": False,
}
