"""The files of a run: Markdown, CSV, JSON and the plot, each written beside and renamed."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from figure1_files import write_text
from figure1_measure import Measured, Settings, commit
from figure1_paper import PAPER
from figure1_plot import NoPlotError, plot
from figure1_tables import csv_text, flat, linearity, markdown, paper_note

import clgrid

# What every measurement of one row has in common: the layout changes no answer.
_SAME = ("hits", "rays", "triangles", "resolution", "references")
_PLOT = "![Time to image, build time and bytes per triangle over triangles, by layout](figure1.png)"


@dataclass(frozen=True)
class Run:
    """One call of the script.

    Attributes
    ----------
    command : str
        That measures the same again, without folders of this machine.
    processors : int
        Threads of the main measurements.
    """

    command: str
    settings: Settings
    processors: int
    rounds: int
    remarks: list[str]

    def headline(self) -> str:
        """Device, version, repetitions."""
        mine, plural = self.settings, "" if self.processors == 1 else "s"
        version = f"clgrid {clgrid.__version__}" + (f" at {commit()}" if commit() else "")
        turns = mine.repetitions * self.rounds
        counted = f"{turns} timed turn" + ("" if turns == 1 else "s")
        return (
            f"{mine.device} ({mine.driver}), {self.processors} thread{plural}, {version}; {mine.size} "
            f"primary rays, default view, density {mine.density}. Medians of {counted}, "
            f"{mine.repetitions} a process, the processes of a row alternating."
        )


def write_all(folder: Path, run: Run, measured: Sequence[Measured], plotted: bool = False) -> str:
    """Write Markdown, CSV and JSON of what there is so far; return the Markdown.

    ``plotted`` says that the plot shows the same measurements.
    """
    rows = [flat(one) for one in measured]
    notes = [*linearity(rows, run.processors), *disagreements(measured), paper_note(), *run.remarks]
    codes = {code for one in measured for code in one.codes}
    if len(codes) > 1:
        notes.append(f"The code changed between measurements: {len(codes)} states of it are in this table.")
    head = ["# The paper's Figure 1", f"    {run.command}", run.headline(), *([_PLOT] if plotted else [])]
    text = markdown(rows, run.processors, head, notes)
    document = {
        "schema": "clgrid.figure1/1",
        "command": run.command,
        "clgrid": clgrid.__version__,
        "commit": commit(),
        "device": {"label": run.settings.device, "driver": run.settings.driver},
        "processors": run.processors,
        "size": run.settings.size,
        "density": run.settings.density,
        "rows": rows,
        "rounds": [
            {"row": m.row, "layout": m.layout, "threads": m.threads, "records": m.rows} for m in measured
        ],
        "paper": {name: _flat_paper(name) for name in PAPER},
        "notes": notes,
    }
    write_text(folder / "figure1.md", text)
    write_text(folder / "figure1.csv", csv_text(rows))
    write_text(folder / "figure1.json", json.dumps(document, indent=1) + "\n")
    return text


def draw(folder: Path, run: Run, measured: Sequence[Measured]) -> str:
    """Draw the plot; return why there is none, empty if there is one."""
    rows = [row for row in map(flat, measured) if row["threads"] == run.processors and not row["failure"]]
    if not rows:
        return "nothing was measured"
    mine, plural = run.settings, "" if run.processors == 1 else "s"
    title = (
        f"clgrid on {mine.device}, {run.processors} thread{plural}, "
        f"density {mine.density}, {mine.size} primary rays"
    )
    try:
        plot(rows, folder / "figure1.png", title)
    except NoPlotError as error:
        return str(error)
    return ""


def disagreements(measured: Sequence[Measured]) -> list[str]:
    """What two measurements of one row should have in common and do not."""
    found = []
    for name in dict.fromkeys(one.row for one in measured):
        for key in _SAME:
            values = {str(row[key]) for one in measured if one.row == name for row in one.rows}
            if len(values) > 1:
                found.append(f"{name}: {key} differ between measurements: {', '.join(sorted(values))}")
    return found


def _flat_paper(name: str) -> dict[str, Any]:
    paper = PAPER[name]
    return {
        "triangles": paper.triangles,
        "references_per_triangle": paper.references,
        "empty_share": paper.empty_share(),
        **{
            layout: {
                "bytes_per_triangle": paper.bytes_per_triangle(layout),
                "build_s": paper.build_s(layout),
                "render_s": paper.render_s(layout),
                "time_to_image_s": paper.time_to_image_s(layout),
            }
            for layout in ("compact", "hashed")
        },
    }
