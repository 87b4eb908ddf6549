"""A page as one HTML file that needs nothing else: style, script, plots and pictures are in it."""

from __future__ import annotations

import hashlib
import itertools
import re
from base64 import b64encode
from collections.abc import Iterator, Sequence
from functools import cache
from html import escape
from pathlib import Path

import numpy as np

from clgrid.report import svg
from clgrid.report.cells import scale, shown
from clgrid.report.heat import heat_png
from clgrid.report.model import (
    CHOSEN,
    GOOD,
    Block,
    Column,
    HeatMap,
    Page,
    Ranges,
    Scatter,
    Section,
    Table,
    cell,
)

# Rows beyond which a table scrolls by itself, below its headings; letters of texts that are not broken.
_TALL, _SHORT = 24, 24
_WITH_UNIT = re.compile(r"(?<=\d) (?=(?:[mnµ]?s|[kMG]?B|x \d+)\b)|(?<=\d x) (?=\d)")
_HERE = Path(__file__).parent


def html(page: Page) -> str:
    """Write the page; every string of it is escaped."""
    style, script = _file("page.css"), _file("page.js")
    numbers = itertools.count()
    parts = [
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n',
        # Nothing may be loaded, and no script may run but ours, whatever a scene is called.
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; img-src data:; style-src'
        f" 'unsafe-inline'; script-src '{_digest(script)}'\">\n",
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n',
        # An icon of its own, or browsers ask the server for one.
        f'<link rel="icon" href="{_picture(np.ones((1, 1)))}">\n',
        f"<title>{escape(page.title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n<main>\n",
        f"<h1>{escape(page.title)}</h1>\n",
        _list("says", page.says),
        _list("warnings", page.warnings),
        *(_section(section, numbers) for section in page.sections),
        _origin(page),
        f'</main>\n<div id="hint" role="status" hidden></div>\n<script>{script}</script>\n</body>\n</html>\n',
    ]
    return "".join(parts)


@cache
def _file(name: str) -> str:
    return (_HERE / name).read_text(encoding="utf-8")


def _digest(script: str) -> str:
    return f"sha256-{b64encode(hashlib.sha256(script.encode()).digest()).decode()}"


def _picture(values: np.ndarray, largest: float | None = None) -> str:
    return f"data:image/png;base64,{b64encode(heat_png(values, largest)).decode()}"


def _prose(text: str) -> str:
    """A sentence, whose numbers stay with their units."""
    return _WITH_UNIT.sub("\u00a0", escape(text))


def _list(kind: str, sentences: Sequence[str]) -> str:
    lines = "".join(f"<li>{_prose(sentence)}</li>\n" for sentence in sentences)
    return f'<ul class="{kind}">\n{lines}</ul>\n' if lines else ""


def _section(section: Section, numbers: Iterator[int]) -> str:
    text = f"<p>{_prose(section.text)}</p>\n" if section.text else ""
    parts = [f"<section>\n<h2>{escape(section.title)}</h2>\n{text}"]
    # Heat maps that follow one another stand side by side.
    for maps, blocks in itertools.groupby(section.blocks, lambda block: isinstance(block, HeatMap)):
        drawn = "".join(_block(block, f"b{next(numbers)}") for block in blocks)
        parts.append(f'<div class="maps">\n{drawn}</div>\n' if maps else drawn)
    return "".join([*parts, "</section>\n"])


def _block(block: Block, name: str) -> str:
    if isinstance(block, Table):
        inner = _table(block, name)
    elif isinstance(block, Scatter):
        inner = _scatter(block, name)
    elif isinstance(block, Ranges):
        inner = _ranges(block, name)
    else:
        inner = _heat_map(block)
    note = f"<p>{_prose(block.note)}</p>\n" if block.note else ""
    return f'<div class="block">\n<h3 id="{name}">{escape(block.title)}</h3>\n{inner}{note}</div>\n'


def _table(table: Table, name: str) -> str:
    scales = [scale(table, k) for k in range(len(table.columns))]
    heads = "".join(_head(column, unit.name) for column, unit in zip(table.columns, scales, strict=True))
    kind = "box tall" if len(table.rows) > _TALL else "box"
    rows = []
    for number, row in enumerate(table.rows):
        mark = table.marks.get(number, "")
        cells = []
        for column, value, unit in zip(table.columns, row, scales, strict=True):
            each = cell(value)
            text = shown(column, each, unit)
            wraps = "n" if column.quantity else "s" if len(text) <= _SHORT else ""
            kinds = " ".join(filter(None, (wraps, each.mark)))
            sorts = "" if each.value is None else f' data-v="{escape(str(each.value))}"'
            note = f' title="{escape(each.note)}"' if each.note else ""
            kinds = f' class="{kinds}"' if kinds else ""
            cells.append(f"<td{kinds}{sorts}{note}>{escape(text)}</td>")
        rows.append(f"<tr{f' class={chr(34)}{mark}{chr(34)}' if mark else ''}>{''.join(cells)}</tr>\n")
    return (
        f'<div class="{kind}" tabindex="0" role="region" aria-labelledby="{name}">\n<table>\n'
        f"<thead><tr>{heads}</tr></thead>\n<tbody>\n{''.join(rows)}</tbody>\n</table>\n</div>\n"
    )


def _head(column: Column, unit: str) -> str:
    kind = ' class="n"' if column.quantity else ""
    note = f' title="{escape(column.note)}"' if column.note else ""
    name = f'{escape(column.name)}<span class="unit">{escape(unit)}</span>'
    return f'<th scope="col"{kind}{note}><button type="button">{name}</button></th>'


def _scatter(scatter: Scatter, name: str) -> str:
    if not scatter.points:
        return "<p>Nothing to show.</p>\n"
    points = scatter.points
    marks = [point.mark for point in points]
    front = sum(mark in (GOOD, CHOSEN) for mark in marks) > 1
    key = svg.legend(
        [(name, k) for k, name in enumerate(svg.names(point.series for point in points))],
        svg.names(point.kind for point in points),
        front,
        CHOSEN in marks,
    )
    return _both(
        svg.scatter_svg(scatter, svg.WIDE, f"{name}w"), svg.scatter_svg(scatter, svg.NARROW, f"{name}n"), key
    )


def _ranges(ranges: Ranges, name: str) -> str:
    if not ranges.rows:
        return "<p>Nothing to show.</p>\n"
    series = svg.names(row.series for row in ranges.rows)
    colours = {row.series: svg.colour_of(row, series) for row in ranges.rows}
    key = svg.legend([*colours.items()])
    return _both(
        svg.ranges_svg(ranges, svg.WIDE, f"{name}w"), svg.ranges_svg(ranges, svg.NARROW, f"{name}n"), key
    )


def _both(wide: str, narrow: str, key: str) -> str:
    return f'<figure><div class="wide">{wide}</div><div class="narrow">{narrow}</div>{key}</figure>\n'


def _heat_map(heat: HeatMap) -> str:
    known = heat.values[np.isfinite(heat.values)]
    largest = float(known.max(initial=0.0))
    # Squares of the ramp's positions, since pictures show square roots.
    ramp = _picture(np.linspace(0.0, 1.0, 256)[None] ** 2)
    alt = f"{heat.title}: at most {heat.quantity.text(largest)}"
    return (
        f'<div class="heat"><img alt="{escape(alt)}" src="{_picture(heat.values)}"></div>\n<div class="ramp">'
        f'<span>0</span><img alt="" src="{ramp}"><span>{escape(heat.quantity.text(largest))}</span></div>\n'
    )


def _origin(page: Page) -> str:
    """Where it comes from, and how to have it again."""
    facts = "".join(f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>\n" for name, value in page.facts)
    commands = "".join(
        f'<div class="command"><pre tabindex="0">{escape(command)}</pre>'
        '<button type="button" class="copy">Copy</button></div>\n'
        for command in page.commands
    )
    kernels = "".join(f"{escape(line)}\n" for line in page.compiled)
    parts = [
        f"<section>\n<h2>Machine and versions</h2>\n<dl>\n{facts}</dl>\n</section>\n" if facts else "",
        f"<section>\n<h2>To repeat it</h2>\n{commands}</section>\n" if commands else "",
        f"<details><summary>Kernels and their options</summary>\n<pre>{kernels}</pre>\n</details>\n"
        if kernels
        else "",
    ]
    return "".join(parts)
