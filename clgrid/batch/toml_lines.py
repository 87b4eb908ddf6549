"""On which line of a TOML text a key is; parsers of TOML do not tell."""

from __future__ import annotations

import re

_TABLE = re.compile(r"\s*\[(\[)?\s*([^\]]+?)\s*\](\])?\s*(?:#.*)?$")
_KEY = re.compile(r"\s*((?:[A-Za-z0-9_-]+|\"[^\"]*\"|'[^']*')(?:\s*\.\s*(?:[A-Za-z0-9_-]+))*)\s*=")
# What can hide brackets: strings, then comments.
_HIDING = re.compile(r'"""(?:.|\n)*?"""|\'\'\'(?:.|\n)*?\'\'\'|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'|#[^\n]*')


def line_of(text: str, path: str) -> int:
    """Find a key.

    Parameters
    ----------
    text : str
    path : str
        As msgspec writes it: ``item[1].size[0]``.

    Returns
    -------
    int
        From 1; that of the nearest key around it if there is none; 0 if there is none either.
    """
    lines = keys_by_line(text)
    wanted = path
    while wanted:
        if wanted in lines:
            return lines[wanted]
        cut = max(wanted.rfind("."), wanted.rfind("["))
        wanted = wanted[:cut] if cut > 0 else ""
    return 0


def keys_by_line(text: str) -> dict[str, int]:
    """Every key and table of a TOML text with its line."""
    # Brackets and signs within strings and comments count for nothing.
    plain = _HIDING.sub(lambda found: re.sub(r"[^\n]", "_", found[0]) if found[0][0] != "#" else "", text)
    found: dict[str, int] = {}
    tables: dict[str, int] = {}
    table = ""
    depth = 0
    for number, line in enumerate(plain.split("\n"), 1):
        if depth == 0:
            header = _TABLE.match(line)
            key = _KEY.match(line)
            if header is not None and key is None:
                table = header[2].replace(" ", "")
                if header[1]:
                    tables[table] = tables.get(table, -1) + 1
                    table = f"{table}[{tables[table]}]"
                found.setdefault(table, number)
                continue
            if key is not None:
                name = key[1].replace(" ", "")
                found.setdefault(f"{table}.{name}" if table else name, number)
        depth = max(0, depth + line.count("[") + line.count("{") - line.count("]") - line.count("}"))
    return found
