"""A contact sheet: one HTML file with a thumbnail of every picture, its seconds, and what failed."""

from __future__ import annotations

import base64
import html
import os
from pathlib import Path

import numpy as np

from clgrid.batch.item import FAILED, ItemRecord
from clgrid.batch.run import Outcome
from clgrid.batch.summary import record_of, stages
from clgrid.errors import ClgridError, ImageError
from clgrid.image import Image, read_image, to_srgb8
from clgrid.imagefile import Saving, write_parts
from clgrid.units import seconds

# Pixels of a thumbnail's longer side: screens have two or more to one of CSS.
_SIDE = 320
_QUALITY = 80
_STYLE = """
:root { color-scheme: light dark; --ink: #1d2129; --quiet: #5b6472; --page: #f6f7f9; --card: #fff;
  --line: #d9dde3; --bad: #b3261e; --badcard: #fdeceb }
@media (prefers-color-scheme: dark) { :root { --ink: #e8eaee; --quiet: #a0a8b4; --page: #14171c;
  --card: #1e2229; --line: #363c46; --bad: #ff9d94; --badcard: #3a2020 } }
* { box-sizing: border-box }
body { margin: 0 auto; padding: 1.25rem; max-width: 90rem; background: var(--page); color: var(--ink);
  font: 15px/1.45 system-ui, sans-serif }
h1 { font-size: 1.35rem; margin: 0 0 .25rem }
p { margin: .25rem 0; color: var(--quiet); overflow-wrap: anywhere }
dl { display: flex; flex-wrap: wrap; gap: .5rem 1.75rem; margin: 1rem 0 1.25rem }
dt { color: var(--quiet); font-size: .8rem }
dd { margin: 0; font-size: 1.1rem; font-variant-numeric: tabular-nums }
.grid { display: grid; gap: .9rem; align-items: start;
  grid-template-columns: repeat(auto-fill, minmax(10.5rem, 1fr)) }
figure { margin: 0; background: var(--card); border: 1px solid var(--line); border-radius: .5rem;
  overflow: hidden }
figure.failed { background: var(--badcard); border-color: var(--bad) }
img, .none { display: block; width: 100%; aspect-ratio: 4/3; object-fit: contain; background: #8882 }
.none { display: grid; place-items: center; background: none; aspect-ratio: 4/1;
  color: var(--bad); font-size: 1.6rem }
figcaption { padding: .5rem .65rem .6rem; font-size: .8rem; overflow-wrap: anywhere }
figcaption b { display: block; font-size: .88rem }
.t { color: var(--quiet); font-variant-numeric: tabular-nums }
.e { color: var(--bad) }
@media (max-width: 30rem) { body { padding: .75rem }
  .grid { gap: .6rem; grid-template-columns: repeat(auto-fill, minmax(8.5rem, 1fr)) } }
"""


def write_sheet(path: Path, outcome: Outcome) -> None:
    """Write the sheet of a run; the file appears under its name only when complete.

    Raises
    ------
    ImageError
        If it cannot be written.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        with open(partial, "w", encoding="utf-8") as file:
            file.write(_head(outcome))
            for record in sorted(outcome.records, key=lambda each: each.item):
                file.write(_figure(record, partial.with_suffix(".jpg")))
            file.write("</div>\n")
        os.replace(partial, path)
    except OSError as error:
        raise ImageError(f"{path}: cannot be written ({error.strerror}); choose another --sheet") from error
    finally:
        partial.unlink(missing_ok=True)


def _head(outcome: Outcome) -> str:
    record = record_of(outcome)
    counts = {"drawn": record.done, "already there": record.skipped, "failed": record.failed}
    facts = [(name, str(count)) for name, count in {**counts, "not begun": record.missing}.items()]
    facts += [("time", seconds(record.seconds))]
    facts += [(f"{name}, median", seconds(middle)) for name, _, middle in stages(outcome.records)]
    device = "" if record.device is None else f"{record.device.name}, driver {record.device.driver}"
    cells = "".join(f"<div><dt>{name}</dt><dd>{value}</dd></div>" for name, value in facts)
    return (
        '<!doctype html>\n<html lang="en"><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{record.asked} pictures</title>\n<style>{_STYLE}</style>\n"
        f"<h1>{record.done + record.skipped} of {record.asked} pictures</h1>\n"
        f"<p>{html.escape(device)}</p><p>{html.escape(record.ledger)}</p>\n"
        f"<dl>{cells}</dl>\n<div class=grid>\n"
    )


def _figure(record: ItemRecord, scratch: Path) -> str:
    frame = "" if record.frame is None else f", frame {record.frame}"
    title = html.escape(f"{Path(record.scene).name} {record.camera}{frame}")
    kind = "failed" if record.status == FAILED else "drawn"
    picture, said = _picture(record, scratch)
    times = ", ".join(
        f"{name} {seconds(sum(getattr(record, f'{name}_s')))}"
        for name in ("build", "render", "write")
        if getattr(record, f"{name}_s")
    )
    error = html.escape(record.error or said)
    return (
        f"<figure class={kind}>{picture}<figcaption><b>{record.item} {title}</b>"
        f"<span class=t>{times or record.status}</span>{f'<div class=e>{error}</div>' if error else ''}"
        "</figcaption></figure>\n"
    )


def _picture(record: ItemRecord, scratch: Path) -> tuple[str, str]:
    """The thumbnail, and why there is none."""
    nothing = '<div class=none aria-hidden="true">&#x2715;</div>'
    if not record.outputs:
        return nothing, ""
    # The smallest file is the quickest to read, and shows the same.
    name = min(record.outputs, key=lambda each: each.bytes).path
    try:
        image = read_image(name)
    except ClgridError as error:
        return nothing, str(error)
    data = base64.b64encode(_thumbnail(image, name.lower().endswith(".exr"), scratch)).decode()
    alt = html.escape(Path(name).name, quote=True)
    return f'<img loading=lazy alt="{alt}" src="data:image/jpeg;base64,{data}">', ""


def _thumbnail(image: Image, linear: bool, scratch: Path) -> bytes:
    """A small JPEG: means of squares of pixels, of linear light where the file holds that."""
    side = max(1, -(-max(image.width, image.height) // _SIDE))
    high, wide = min(side, image.height), min(side, image.width)
    rows, columns = image.height // high, image.width // wide
    squares = image.rgba[: rows * high, : columns * wide, :3].reshape(rows, high, columns, wide, 3)
    small = squares.mean(axis=(1, 3), dtype=np.float32)
    colours = to_srgb8(small) if linear else np.clip(small * 255.0 + 0.5, 0, 255).astype(np.uint8)
    try:
        write_parts(scratch, [("", ("R", "G", "B"), colours)], {}, Saving(quality=_QUALITY))
        return scratch.read_bytes()
    finally:
        scratch.unlink(missing_ok=True)
