"""The cells of tables as text: one unit a column, so that its numbers can be compared."""

from __future__ import annotations

from dataclasses import dataclass

from clgrid.report.model import Cell, Column, Table, Value, cell


@dataclass(frozen=True)
class Unit:
    """The unit of a column: its size in the base unit, its name, and digits after the point."""

    size: float = 1.0
    name: str = ""
    decimals: int = 0


def scale(table: Table, number: int) -> Unit:
    """Return the unit that suits all values of a column."""
    quantity = table.columns[number].quantity
    if quantity is None:
        return Unit()
    values = [cell(row[number]).value for row in table.rows]
    numbers = [value for value in values if isinstance(value, (int, float))]
    size, name = quantity.scale(numbers)
    return Unit(size, name, quantity.decimals(numbers, size))


def shown(column: Column, value: Value | Cell, unit: Unit) -> str:
    """Return the text of a cell, without the unit."""
    each = cell(value)
    if each.text or each.value is None:
        return each.text or "-"
    if column.quantity is not None and isinstance(each.value, (int, float)):
        return column.quantity.write(each.value, unit.size, unit.decimals)
    return str(each.value)
