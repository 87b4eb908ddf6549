"""How the documentation is built: ``scripts/docs``, or ``sphinx-build -W -b html docs out/docs``."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import clgrid  # noqa: E402

project = "clgrid"
author = "the clgrid authors"
copyright = author
version = release = clgrid.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]

html_theme = "furo"
html_title = f"clgrid {release}"

myst_heading_anchors = 3

# Types are in the docstrings, with shapes and dtypes, which annotations do not have.
autodoc_typehints = "none"
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_ivar = True

# What functions return, and callers do not make.
_MADE_BY_CLGRID = {"Grid", "Hits", "AllHits", "Scene", "Device", "GridStats", "Description"}


def one_name_a_line(app: Any, what: str, name: str, thing: object, options: object, lines: list[str]) -> None:
    """Split ``a, b : type`` of a section Attributes, which napoleon takes for one name."""
    del app, what, name, thing, options
    for k in range(len(lines) - 1, -1, -1):
        found = re.match(r"(\w+(?:, \w+)+) : (.+)$", lines[k])
        if found is None or "Attributes" not in lines[:k]:
            continue
        after = k + 1
        while after < len(lines) and lines[after].startswith(" "):
            after += 1
        text = lines[k + 1 : after]
        lines[k:after] = [line for each in found[1].split(", ") for line in (f"{each} : {found[2]}", *text)]


def without_constructor(
    app: Any, what: str, name: str, thing: object, options: object, signature: str, returned: str
) -> tuple[str, str] | None:
    """Leave out how classes are made that only clgrid makes."""
    del app, thing, options, signature, returned
    if what == "class" and name.split(".")[-1] in _MADE_BY_CLGRID:
        return "", ""
    return None


def setup(app: Any) -> None:
    """Connect the two before napoleon reads the docstrings."""
    app.connect("autodoc-process-docstring", one_name_a_line, priority=100)
    app.connect("autodoc-process-signature", without_constructor)
