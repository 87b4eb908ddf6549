"""The cells of a nested grid, as cl/subgrid.h says: where each one is, and what it lists."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from cell_lists import lists_of, params_of
from oracle import local_mesh

from clgrid.grid import Grid
from clgrid.mesh import Mesh

F64 = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

FINEST = 10
"""Halvings of a cell of the top grid that make the finest there can be, as in cl/config.h."""
_PAIRS_AT_ONCE = 1 << 20


@dataclass(frozen=True)
class Nest:
    """The cells of one part of a nested grid; arrays have a row for each."""

    low: F64
    """(M, 3) lower corner, local units."""
    size: F64
    """(M, 3)"""
    lists: list[list[int]]
    """Triangles; none of a cell that has a subgrid."""
    child: Ints
    """Number of its subgrid, or -1."""
    levels: Ints
    """How many subgrids the cell is in."""


def subgrids_of(grid: Grid, part: int = 0) -> npt.NDArray[np.uint32]:
    """(S, 5): first cell, halvings, and the place of the first cell in cells of its size."""
    lists = grid.parts[part].lists
    assert lists.subgrids is not None
    first = int(params_of(grid, part)["first_subgrid"])
    # Every subgrid is listed once; where there is none, there is room for one.
    count = sum(cell[0] >= first for cell in lists_of(grid, part) if cell)
    assert lists.subgrids.nbytes == 20 * max(count, 1)
    return grid._allocator.download(lists.subgrids.buffer, np.uint32, 5 * count).reshape(-1, 5)


def nest_of(grid: Grid) -> Nest:
    """The cells of a grid of one part, after checking that subgrids fill the cells that they are in."""
    params, subgrids, lists = params_of(grid), subgrids_of(grid).astype(np.int64), lists_of(grid)
    resolution, first = params["resolution"].astype(np.int64), int(params["first_subgrid"])
    assert first >= grid.mesh.triangle_count
    halvings = subgrids[:, 1:2] >> (4 * np.arange(3)) & 15
    finer = subgrids[:, 1:2] >> (12 + 4 * np.arange(3)) & 15
    assert (subgrids[:, 1] >> 24 == 0).all()
    assert (halvings.sum(axis=1) > 0).all()

    cells = grid.parts[0].lists.cell_count
    starts = np.concatenate([[0], subgrids[:, 0]])
    counts = np.concatenate([[resolution.prod()], 1 << halvings.sum(axis=1)])
    order = np.argsort(starts, kind="stable")
    np.testing.assert_array_equal(starts[order], np.cumsum(counts[order]) - counts[order])
    assert counts.sum() == cells == grid.stats.cells

    place, below = np.zeros((cells, 3), np.int64), np.zeros((cells, 3), np.int64)
    for number in range(len(starts)):
        along = resolution if number == 0 else 1 << halvings[number - 1]
        index = np.arange(counts[number])
        own = np.stack([index % along[0], index // along[0] % along[1], index // (along[0] * along[1])], -1)
        rows = slice(starts[number], starts[number] + counts[number])
        place[rows] = own if number == 0 else own + subgrids[number - 1, 2:]
        below[rows] = FINEST if number == 0 else finer[number - 1]

    child = np.array([cell[0] - first if cell and cell[-1] >= first else -1 for cell in lists])
    held = np.flatnonzero(child >= 0)
    assert all(len(lists[cell]) == 1 for cell in held), "a subgrid is alone in its list"
    np.testing.assert_array_equal(np.sort(child[held]), np.arange(len(subgrids)))
    of = child[held]
    np.testing.assert_array_equal(subgrids[of, 2:], place[held] << halvings[of])
    np.testing.assert_array_equal(finer[of], below[held] - halvings[of])

    levels = np.zeros(cells, np.int64)
    for cell in held[np.argsort(starts[1:][of], kind="stable")]:
        number = child[cell]
        levels[starts[number + 1] : starts[number + 1] + counts[number + 1]] = levels[cell] + 1
    size = params["cell_size"] / 2.0 ** (FINEST - below)
    triangles = [[] if child[cell] >= 0 else listed for cell, listed in enumerate(lists)]
    return Nest(params["lower"] + place * size, size, triangles, child, levels)


def assert_lists_hold_what_they_must(mesh: Mesh, grid: Grid, reach: float, widest: float) -> Nest:
    """Each leaf lists all triangles within ``reach`` of it, and none whose box is not within ``widest``."""
    nest = nest_of(grid)
    leaves = np.flatnonzero(nest.child < 0)
    _, vertices = local_mesh(mesh)
    corners = vertices[mesh.faces].astype(np.float64)
    listed = np.concatenate([np.array([], np.int64), *(_keys(corners, int(cell), nest) for cell in leaves)])
    near: list[Ints] = []
    rows = max(1, _PAIRS_AT_ONCE // len(corners))
    for start in range(0, len(leaves), rows):
        some = leaves[start : start + rows]
        near.append(_boxes_touch(corners, nest, some, widest))
    touched = np.concatenate(near)
    assert np.isin(listed, touched).all(), "a triangle is listed in a cell that its box is not near"
    cell, face = np.divmod(touched, len(corners))
    must = touched[_touches(corners[face], nest.low[cell], nest.size[cell], reach)]
    lost = np.setdiff1d(must, listed)
    assert not len(lost), f"cell {lost[0] // len(corners)} does not list triangle {lost[0] % len(corners)}"
    return nest


def _keys(corners: F64, cell: int, nest: Nest) -> Ints:
    return cell * len(corners) + np.array(nest.lists[cell], np.int64)


def _boxes_touch(corners: F64, nest: Nest, cells: Ints, pad: float) -> Ints:
    """Pairs of cell and triangle, as cell * triangles + triangle."""
    low, high = corners.min(axis=1), corners.max(axis=1)
    near = np.ones((len(cells), len(corners)), bool)
    for axis in range(3):
        begin, end = nest.low[cells, axis] - pad, (nest.low + nest.size)[cells, axis] + pad
        near &= (low[:, axis] <= end[:, None]) & (high[:, axis] >= begin[:, None])
    row, face = np.nonzero(near)
    return np.asarray(cells[row] * len(corners) + face)


def _touches(corners: F64, low: F64, size: F64, pad: float) -> npt.NDArray[np.bool_]:
    """Whether triangles touch boxes widened by ``pad``, pair by pair: 13 separating axes, in float64."""
    half, from_centre = size / 2 + pad, corners - (low + size / 2)[:, None]
    edges = np.roll(from_centre, -1, axis=1) - from_centre
    axes = [np.broadcast_to(axis, half.shape) for axis in np.eye(3)]
    axes.append(np.cross(edges[:, 0], edges[:, 1]))
    axes += [np.cross(edges[:, k], axis) for k in range(3) for axis in np.eye(3)]
    touched = np.ones(len(corners), bool)
    for axis in axes:
        at, reach = np.einsum("pck,pk->pc", from_centre, axis), (np.abs(axis) * half).sum(axis=1)
        touched &= (at.min(axis=1) <= reach) & (at.max(axis=1) >= -reach)
    return touched
