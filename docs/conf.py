"""How the documentation is built: ``scripts/docs``, or ``sphinx-build -W -b html docs out/docs``."""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import clgrid  # noqa: E402

project = "clgrid"
author = "the clgrid authors"
copyright = author  # noqa: A001
version = release = clgrid.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
]
exclude_patterns = ["examples/*.md"]

html_theme = "furo"
html_title = f"clgrid {release}"

myst_heading_anchors = 3

# Types are in the docstrings, with shapes and dtypes, which annotations do not have.
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_class_signature = "separated"
napoleon_google_docstring = False
napoleon_use_ivar = True
