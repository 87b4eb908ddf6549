"""Grids in files: what of a grid is kept, and a grid made of what was (the format is ``gridfile``'s)."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import clgrid
from clgrid import cache, gridfile, structs
from clgrid.cast import GridPart
from clgrid.device import Device, choose
from clgrid.errors import BufferTooLargeError, GridFileError
from clgrid.grid import Grid, require_tested
from clgrid.gridfile import Facts, Frame, Part, Source
from clgrid.layouts.lists import Array, CellLists
from clgrid.memory import Allocator
from clgrid.mesh import Mesh
from clgrid.recipe import Recipe

_PARAMS, _BESIDE = "params", ("distances", "subgrids")
Arrays = dict[str, npt.NDArray[Any]]


def save(grid: Grid, allocator: Allocator, path: Path) -> None:
    """``Grid.save``."""
    mesh = grid.mesh
    recipe, standing = (grid.recipe, []) if grid.empty else grid.as_it_stands()
    parts = [_part(number, part) for number, part in enumerate(standing)]
    facts = Facts(
        clgrid=clgrid.__version__,
        structs=_structs(),
        layout=recipe.layout,
        accuracy=recipe.accuracy,
        density=float(recipe.density),
        resolution=recipe.resolution,
        max_memory=recipe.max_memory,
        skipping=recipe.skipping,
        source=_text(mesh.source),
        geometry_names=tuple(map(_text, mesh.geometry_names)),
        warnings=tuple(map(_text, mesh.warnings)),
        vertices=len(mesh.vertices),
        triangles=mesh.triangle_count,
        frame=_frame(grid) if parts else None,
        parts=tuple(parts),
    )
    sources = _mesh_sources(mesh)
    for number, part in enumerate(standing):
        sources += _grid_sources(number, part.lists, allocator)
    gridfile.write(path, facts, sources)


def _structs() -> str:
    """Another one for every other layout of the structs that the file holds."""
    return cache.key(structs.declarations((structs.GRID, structs.SUBGRID)))


def _text(text: str) -> str:
    """Names of files may hold bytes that are no text."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def _frame(grid: Grid) -> Frame:
    x, y, z = map(float, grid.frame.offset)
    return Frame((x, y, z), grid.frame.exponent)


def _part(number: int, part: GridPart) -> Part:
    lists = part.lists
    return Part(
        first=part.mesh.first,
        count=part.mesh.count,
        arrays=tuple(lists.nbytes),
        resolution=lists.resolution,
        references=lists.reference_count,
        full_cells=lists.full_cells,
        slots=lists.slots,
        wide=lists.wide,
        cells=lists.cells,
    )


def _name(number: int, array: str) -> str:
    return f"part {number}: {array}"


def _mesh_sources(mesh: Mesh) -> list[Source]:
    arrays: dict[str, npt.NDArray[Any] | None] = {
        "vertices": mesh.vertices,
        "faces": mesh.faces,
        "vertex_normals": mesh.vertex_normals,
        "geometry_starts": mesh.geometry_starts,
    }
    return [_of_array(name, array) for name, array in arrays.items() if array is not None]


def _of_array(name: str, array: npt.NDArray[Any]) -> Source:
    return Source(name, array.dtype, array.shape, lambda: array)


def _grid_sources(number: int, lists: CellLists, allocator: Allocator) -> list[Source]:
    sources = [
        _of_buffer(_name(number, _PARAMS), lists.params, np.uint8, structs.GRID.dtype.itemsize, allocator)
    ]
    beside = {"distances": lists.distances, "subgrids": lists.subgrids}
    arrays = {**lists.arrays, **{name: array for name, array in beside.items() if array is not None}}
    for name, array in arrays.items():
        dtype = np.dtype(lists.dtypes.get(name, np.uint8))
        source = _of_buffer(
            _name(number, name), array.buffer, dtype, array.nbytes // dtype.itemsize, allocator
        )
        sources.append(_of_zeros(source) if name == "subgrids" and _has_no_subgrid(lists) else source)
    return sources


def _of_buffer(name: str, buffer: Any, dtype: npt.DTypeLike, count: int, allocator: Allocator) -> Source:
    return Source(name, np.dtype(dtype), (count,), lambda: allocator.download(buffer, dtype, count))


def _has_no_subgrid(lists: CellLists) -> bool:
    """Whether no cell of a nested grid was worth one: there is room for one then, with any bytes."""
    x, y, z = lists.resolution
    return lists.cells == x * y * z


def _of_zeros(source: Source) -> Source:
    return Source(source.name, source.dtype, source.shape, lambda: np.zeros(source.shape, source.dtype))


def open_grid(path: str | Path, device: Device | str | None = None) -> Grid:
    """Open a grid that ``Grid.save`` wrote: its answers have the same bits as those of the grid saved.

    The arrays of mesh and grid are mapped, and CPU devices read them where they lie: opening takes a pass for
    the checksums, and processes that open one file share its pages. The file may be replaced or deleted then,
    but not be written into. Seconds of the build and ``Grid.choice`` are not kept.

    Parameters
    ----------
    path : str or Path
        Of a file that you trust: checksums tell damage, not malice.
    device : Device or str, optional
        As of ``build``; need not be the one that the grid was built on.

    Raises
    ------
    GridFileError
        If there is no such file, or it is truncated, altered, of another format version or no grid's.
    BufferTooLargeError
        If an array is larger than one buffer of the device may be.
    DeviceError
        If there is no usable device, or it fails the self-test of the accuracy.
    """
    source = Path(path)
    facts, arrays = gridfile.read(source)
    if facts.structs != _structs():
        raise _of_another_clgrid(source, facts)
    mesh = _mesh(facts, arrays)
    chosen = device if isinstance(device, Device) else choose(device)
    grid = Grid(mesh, chosen, _recipe(facts))
    if facts.parts:
        require_tested(chosen, facts.accuracy)
        _stand(grid, source, facts, arrays)
    return grid


def _of_another_clgrid(path: Path, facts: Facts) -> GridFileError:
    return GridFileError(
        f"{path}: written by clgrid {facts.clgrid}, which this {clgrid.__version__} cannot read;"
        " build the grid and save it anew"
    )


def _mesh(facts: Facts, arrays: Arrays) -> Mesh:
    return Mesh(
        arrays["vertices"],
        arrays["faces"],
        arrays.get("vertex_normals"),
        arrays["geometry_starts"],
        facts.geometry_names,
        facts.source,
        facts.warnings,
    )


def _recipe(facts: Facts) -> Recipe:
    return Recipe(
        facts.layout, facts.density, facts.resolution, facts.accuracy, facts.max_memory, facts.skipping
    )


def _stand(grid: Grid, path: Path, facts: Facts, arrays: Arrays) -> None:
    """Let the grid stand on what was saved."""
    start = time.perf_counter()
    ends = [0, *(part.first + part.count for part in facts.parts)]
    makers = [_maker(number, part, facts.layout, arrays) for number, part in enumerate(facts.parts)]
    try:
        grid.stand_on(ends, makers)
    except BufferTooLargeError as error:
        raise BufferTooLargeError(f"{path}: {error}; build the grid on {grid.device.label}") from error
    if _frame(grid) != facts.frame:
        # The arrays would be of other coordinates than the kernels see.
        raise _of_another_clgrid(path, facts)
    grid.upload_s = time.perf_counter() - start


def _maker(number: int, part: Part, layout: str, arrays: Arrays) -> Callable[[Allocator], CellLists]:
    def make(allocator: Allocator) -> CellLists:
        own = {name: arrays[_name(number, name)] for name in part.arrays}
        held = {name: Array(allocator.adopt(array), array.nbytes) for name, array in own.items()}
        beside = {name: held.pop(name, None) for name in _BESIDE}
        return CellLists(
            layout=layout,
            params=allocator.upload(arrays[_name(number, _PARAMS)]),
            arrays=held,
            resolution=part.resolution,
            reference_count=part.references,
            full_cells=part.full_cells,
            build_s={},
            slots=part.slots,
            wide=part.wide,
            distances=beside["distances"],
            subgrids=beside["subgrids"],
            cells=part.cells,
        )

    return make
