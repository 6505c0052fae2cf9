"""Configuration of the documentation, which ``make docs`` builds."""

from __future__ import annotations

import logging
import os
import re
import shutil
import sys
import tempfile
from pathlib import Path

import wrapjax

sys.path.insert(0, str(Path(__file__).parent / "_extensions"))
logging.getLogger("jax").setLevel(logging.WARNING)
# Results that the examples keep, and compiled programs.
os.environ.setdefault("WRAPJAX_CACHE", str(Path(tempfile.gettempdir()) / "wrapjax-docs"))

project = "wrapjax"
author = "The wrapjax developers"
project_copyright = author
version = release = wrapjax.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.doctest",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
    "command_help",
    "drawn_equations",
]
exclude_patterns = ["_build"]
# Names in single backquotes are links where they can be.
default_role = "py:obj"

# Pages are Markdown; notebooks are shown with the outputs that they have.
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath", "amsmath"]
myst_heading_anchors = 3
nb_execution_mode = "off"
suppress_warnings = ["mystnb.unknown_mime_type"]

# Shapes stand in annotations, as text; values of arguments as they are written.
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
autodoc_member_order = "bysource"
autodoc_class_signature = "mixed"
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True

doctest_test_doctest_blocks = "default"
doctest_global_setup = """
import os, tempfile
os.chdir(tempfile.mkdtemp())
from wrapjax.jax_setup import set_up_jax
set_up_jax()
import wrapjax
"""

html_theme = "furo"
html_title = f"wrapjax {release}"
html_static_path = ["_static"]
html_css_files = ["wrapjax.css"]
html_math_renderer = "drawn"
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {"navigation_with_keys": True}
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

#: Links to files outside of this folder, by the link to the page that shows the file.
_PAGES_OF_FILES = {
    "../README.md": "index.md",
    "../CONTRIBUTING.md": "contributing.md",
    "../CHANGELOG.md": "changelog.md",
    "../benchmarks/RESULTS.md": "benchmarks.md",
    "../validation/RESULTS.md": "validation_results.md",
    "../../notebooks/": "../notebooks/",
    "../notebooks/": "notebooks/",
}
#: The same of files that pages include, whose links begin at their own folders.
_PAGES_OF_INCLUDED = _PAGES_OF_FILES | {
    "../../docs/": "",
    "../docs/": "",
    "docs/": "",
    "EFFECTS.md": "blind_bank_effects.md",
    "blind/README.md": "blind_bank.md",
    **{
        f"blind/published/{bank}/table.md": "sealed_banks.md"
        for bank in ("first_80", "next_159", "second_test_120", "development_40")
    },
}


def _link_to(pages, text):
    # One pass, so that a link is not changed twice.
    alternatives = "|".join(map(re.escape, pages))
    return re.sub(rf"\]\(({alternatives})", lambda match: f"]({pages[match[1]]}", text)


def _read_page(app, page, source):
    source[0] = _link_to(_PAGES_OF_FILES, source[0])


def _read_included(app, path, page, content):
    content[0] = _link_to(_PAGES_OF_INCLUDED, content[0])


#: Public classes that users make themselves; the others are results.
_MADE_BY_USERS = {
    "PhysiologicalThresholds",
    "BoundedLevenbergMarquardt",
    "JaxoptSolver",
    "OptimistixSolver",
    "InputError",
}


def _hide_signatures_of_results(app, what, name, obj, options, signature, annotation):
    """Leave out what a result is made of: its fields are documented below."""
    if what == "class" and name.rsplit(".", 1)[-1] not in _MADE_BY_USERS:
        return "", None
    return None


def _copy_notebooks(app, config):
    """Copy the notebooks into this folder, as pages have to lie in it."""
    folder = Path(__file__).parent / "notebooks"
    folder.mkdir(exist_ok=True)
    for notebook in (Path(__file__).parents[1] / "notebooks").glob("*.ipynb"):
        shutil.copy2(notebook, folder)  # with its time, so that unchanged ones are not read again


def setup(app):
    """Connect what this file defines."""
    app.connect("config-inited", _copy_notebooks)
    app.connect("autodoc-process-signature", _hide_signatures_of_results)
    app.connect("source-read", _read_page)
    app.connect("include-read", _read_included)
