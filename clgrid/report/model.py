"""What a page holds: tables, plots and heat maps as data, whoever draws them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from clgrid.report.quantity import NUMBER, Quantity

Value = str | int | float | None
# What is said of a cell, row or point beside its value; each has a sign of its own, not a colour alone.
GOOD, BAD, CHOSEN, QUIET = "good", "bad", "chosen", "quiet"


@dataclass(frozen=True)
class Column:
    """A column; without a quantity it holds text.

    Attributes
    ----------
    name : str
    quantity : Quantity or None
    note : str
        What the name means, where it does not speak for itself.
    detail : bool
        Whether it is left out where there is little room: on terminals.
    """

    name: str
    quantity: Quantity | None = None
    note: str = ""
    detail: bool = False


@dataclass(frozen=True)
class Cell:
    """A value with more to say.

    Attributes
    ----------
    value : str, int, float or None
        What sorts; a number in the base unit.
    text : str
        Shown in place of the value.
    mark : str
        ``good``, ``bad``, ``chosen``, ``quiet`` or nothing.
    note : str
        Shown where the pointer rests.
    """

    value: Value
    text: str = ""
    mark: str = ""
    note: str = ""


@dataclass(frozen=True)
class Table:
    """Rows of values or cells, one a column.

    Attributes
    ----------
    marks : dict of int to str
        Of whole rows, by number.
    note : str
        Below the table.
    """

    title: str
    columns: Sequence[Column]
    rows: Sequence[Sequence[Value | Cell]]
    marks: dict[int, str] = field(default_factory=dict)
    note: str = ""


@dataclass(frozen=True)
class Axis:
    """An axis of a plot."""

    name: str
    quantity: Quantity = NUMBER
    log: bool = True


@dataclass(frozen=True)
class Point:
    """A point of a scatter plot.

    Attributes
    ----------
    series : str
        Gives the colour.
    kind : str
        Gives the shape.
    x_range, y_range : (low, high) or None
        Drawn as whiskers.
    mark : str
        ``good``: on the front; ``chosen``: the one recommended.
    facts : sequence of (str, str)
        What it shows when pointed at, beside its label.
    """

    label: str
    x: float
    y: float
    series: str = ""
    kind: str = ""
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    mark: str = ""
    facts: Sequence[tuple[str, str]] = ()


@dataclass(frozen=True)
class Scatter:
    """Points in a plane; those marked ``good`` are joined by steps, as the front that they are.

    On a logarithmic axis, zeros lie in a lane of their own.
    """

    title: str
    x: Axis
    y: Axis
    points: Sequence[Point]
    note: str = ""


@dataclass(frozen=True)
class Range:
    """A line of a range plot: a value between two others."""

    label: str
    value: float
    low: float
    high: float
    series: str = ""
    mark: str = ""
    facts: Sequence[tuple[str, str]] = ()


@dataclass(frozen=True)
class Ranges:
    """Values with their ranges, a line each.

    Attributes
    ----------
    zero : float or None
        Where nothing has changed: a line across.
    band : (low, high) or None
        What does not count, around ``zero``.
    """

    title: str
    axis: Axis
    rows: Sequence[Range]
    zero: float | None = None
    band: tuple[float, float] | None = None
    note: str = ""


@dataclass(frozen=True)
class HeatMap:
    """An array of values as a picture.

    Attributes
    ----------
    values : array (H, W)
        At least 0; NaN where there is nothing.
    """

    title: str
    values: npt.NDArray[np.floating]
    quantity: Quantity = NUMBER
    note: str = ""


Block = Table | Scatter | Ranges | HeatMap


@dataclass(frozen=True)
class Section:
    """A heading, a sentence or two, and what is below them."""

    title: str
    blocks: Sequence[Block]
    text: str = ""


@dataclass(frozen=True)
class Page:
    """A report.

    Attributes
    ----------
    title : str
    says : sequence of str
        What it says, in sentences; the first matter most.
    warnings : sequence of str
        What must be known before anything is concluded.
    facts : sequence of (str, str)
        Machine, devices, versions, seeds.
    commands : sequence of str
        How to repeat it.
    compiled : sequence of str
        Kernels with their options.
    """

    title: str
    says: Sequence[str]
    sections: Sequence[Section]
    warnings: Sequence[str] = ()
    facts: Sequence[tuple[str, str]] = ()
    commands: Sequence[str] = ()
    compiled: Sequence[str] = ()

    def blocks(self, kind: type[Block]) -> list[Block]:
        """Return all blocks of one kind, in order."""
        return [block for section in self.sections for block in section.blocks if isinstance(block, kind)]


def cell(value: Value | Cell) -> Cell:
    """Return a value as a cell."""
    return value if isinstance(value, Cell) else Cell(value)
