"""Build a grid over a mesh and cast rays through it: the heart of clgrid."""

from __future__ import annotations

import threading
import time
import weakref
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy.typing as npt

from clgrid import cost, layouts, selftest
from clgrid.adapted import Adapts
from clgrid.camera import Camera
from clgrid.cast import GridPart
from clgrid.device import Device, choose
from clgrid.errors import BufferTooLargeError, InputError
from clgrid.frame import LocalFrame
from clgrid.layouts.lists import CellLists
from clgrid.memory import Allocator
from clgrid.mesh import FloatArray, Mesh
from clgrid.prediction import predict as predict
from clgrid.prediction import predict_choice as predict_choice
from clgrid.recipe import Options, Recipe
from clgrid.rungs import RUNGS, Rung
from clgrid.shown import Facts, Shown, below_picture, counted
from clgrid.stats import NO_STATS, GridStats, facts_of, stats_of, sums
from clgrid.target import DeviceMesh, MeshPart
from clgrid.under_way import UnderWay
from clgrid.units import bytes_text

# Pixels of the picture in a notebook.
_THUMBNAIL = (240, 180)
# So many times a mesh is split for the sake of a device's largest buffer.
_MOST_PARTS = 256


class Grid(Adapts, Shown):
    """A grid over a mesh, on a device. Made by ``clgrid.build``.

    Threads may ask it anything at once, and get the bits that one gets. ``update`` moves what they ask, so it
    is for a time when none of them does.

    Attributes
    ----------
    mesh : Mesh
        The one given, or moved by ``update``.
    device : Device
    layout, accuracy : str
    skipping : bool
    parts : list of GridPart
        The arrays on the device; none for a mesh without triangles.
    upload_s : float
        Seconds to bring the mesh into its local frame and to the device.
    choice : Choice or None
        The grids among which this one was chosen, with their estimated seconds and bytes; None where nothing
        was left to choose.
    adapted : bool
        Whether rays that have little in common had it rebuilt, since it had been chosen for others: layout,
        skipping, bytes and stats are then of the finer grid. ``update`` builds the one that was chosen.
    """

    def __init__(self, mesh: Mesh, device: Device, recipe: Recipe) -> None:
        self.mesh = mesh
        self.device = device
        self.recipe = recipe
        self.parts: list[GridPart] = []
        self._allocator = Allocator(device, recipe.max_memory)
        self._target: DeviceMesh | None = None
        self.upload_s = 0.0
        self.under_way = UnderWay(device)
        # Before the arrays go, and before the process ends.
        weakref.finalize(self, self.under_way.wait)
        self.choice: cost.Choice | None = None
        self._stats: tuple[list[GridPart], GridStats] | None = None
        self._swapping = threading.Lock()
        self._wait_for_rays()
        # What lets the next build have the arrays when the grid is gone.
        self._endings: list[weakref.finalize[Any, Any]] = []

    @property
    def layout(self) -> str:
        """How cells find their lists."""
        return self._stands_as.layout

    @property
    def accuracy(self) -> str:
        """The rung of the accuracy ladder."""
        return self.recipe.accuracy

    @property
    def rung(self) -> Rung:
        """The rung, as kernels are compiled for it."""
        return RUNGS[self.recipe.accuracy]

    @property
    def skipping(self) -> bool:
        """Whether rays leap over empty space."""
        return self._stands_as.skipping

    @classmethod
    def rebuilt(cls, mesh: Mesh, device: Device, recipe: Recipe) -> Grid:
        """A grid of a recipe, as ``build`` makes it once nothing is left to choose.

        Raises
        ------
        GridTooLargeError, DeviceError
            As of ``build``.
        """
        if mesh.triangle_count:
            require_tested(device, recipe.accuracy)
        return untested(mesh, device, recipe)

    @property
    def empty(self) -> bool:
        """Whether the mesh has no triangles; every ray then misses."""
        self.require_unreleased()
        return super().empty

    def _let_go(self) -> None:
        if self.parts:
            self._stats = [], self.stats  # which outlive the buffers
        self.under_way.wait()
        self._stop_endings()
        with self._swapping:
            self.parts, self._target = [], None
        self._allocator.drop()

    def _build(self) -> None:
        start = time.perf_counter()
        if self._target is None:
            self._target = DeviceMesh(self.mesh, self.device, self._allocator, self.rung)
        else:
            self._target.move(self.mesh)
        target = self._target
        self.upload_s = 0.0
        count = 1
        while True:
            try:
                mesh_parts = target.parts(count)
                self.upload_s = self.upload_s or time.perf_counter() - start
                for part in mesh_parts:
                    self.parts.append(self._build_part(part, self.recipe))
                    self._allocator.finished = self.nbytes
                return
            except BufferTooLargeError:
                self._give_back()
                if count >= min(_MOST_PARTS, self.mesh.triangle_count):
                    raise
                count *= 2

    def _build_part(self, part: MeshPart, recipe: Recipe) -> GridPart:
        allocator = self._allocator
        lists = layouts.build(
            self.device,
            allocator,
            part.vertices,
            part.faces,
            recipe.params(part),
            recipe.layout,
            recipe.skipping,
            recipe.density,
        )
        self._endings.append(allocator.give_with(lists, lists.buffers, self.under_way.wait))
        return GridPart(part, lists)

    def stand_on(self, ends: Sequence[int], makers: Sequence[Callable[[Allocator], CellLists]]) -> None:
        """Take lists made elsewhere, one a run of triangles from one of ``ends`` to the next."""
        self._target = DeviceMesh(self.mesh, self.device, self._allocator, self.rung)
        runs = self._target.runs(ends)
        self.parts = [GridPart(run, make(self._allocator)) for run, make in zip(runs, makers, strict=True)]
        self._allocator.finished = self.nbytes

    def _give_back(self) -> None:
        """Release the arrays of all parts."""
        self._stop_endings()
        for part in self.parts:
            self._allocator.release(*part.lists.buffers)
        self.parts = []
        self._allocator.start_again()

    def _stop_endings(self) -> None:
        """The arrays of all parts go elsewhere than to the next build."""
        for ending in self._endings:
            ending.detach()
        self._endings = []

    def update(self, vertices: FloatArray) -> None:
        """Rebuild the grid in place for moved vertices, on the device, allocating only what grew.

        Parameters
        ----------
        vertices : (V, 3) float32 or float64
            One a vertex of the mesh, scene units. Vertex normals of the mesh are dropped.

        Raises
        ------
        MeshError
            If shape or dtype do not fit, or a position is not finite; the grid stays as it was.
        GridTooLargeError
            If the new grid would exceed a limit; there is then no grid until an update succeeds.
        """
        self.require_here()
        moved = self.mesh.moved(vertices)
        if self.empty:
            return
        self.under_way.wait()
        self.mesh = moved
        self.__dict__.pop("open_edges", None)
        self._stats = None
        self._wait_for_rays()
        self._allocator.recycles = True
        self._give_back()
        self._build()

    def save(self, path: str | Path) -> None:
        """Write the grid and its mesh to a file that ``clgrid.open_grid`` opens.

        The same grid gives the same bytes, on any device. The file appears under its name only when complete.

        Parameters
        ----------
        path : str or Path
            Any name; a file that is there is replaced.

        Raises
        ------
        GridFileError
            If the file cannot be written; one that was there is then as it was.
        InputError
            If the last update failed.
        """
        from clgrid.saved import save

        save(self, self._allocator, Path(path))

    @property
    def target(self) -> DeviceMesh:
        """The mesh on the device; only for a mesh that has triangles."""
        target = self._target
        self.require_here()
        if target is None:
            raise InputError("the mesh has no triangles, so nothing of it is on a device")
        return target

    @property
    def standing(self) -> list[GridPart]:
        """The parts of a grid that is not empty.

        Raises
        ------
        InputError
            If the last update failed, or the grid was released.
        DeviceError
            In a forked process.
        """
        parts = self.parts
        self.require_here()
        if not parts:
            raise InputError("the last update failed, so there is no grid; update it with other vertices")
        return parts

    @property
    def frame(self) -> LocalFrame:
        """Where the kernels see the mesh."""
        return self.target.frame

    @property
    def build_s(self) -> dict[str, float]:
        """Seconds of each stage on the device."""
        return sums([part.lists.build_s for part in self.parts])

    @property
    def nbytes(self) -> int:
        """Bytes of the acceleration structure, exactly; the mesh is not part of it."""
        return sum(sum(part.lists.nbytes.values()) for part in self.parts)

    @property
    def peak_nbytes(self) -> int:
        """Most device bytes that the build held at once, the finished grid included."""
        return self._allocator.peak_nbytes

    @property
    def stats(self) -> GridStats:
        """Counts, bytes and seconds."""
        if not self.mesh.triangle_count:
            return NO_STATS
        known, parts = self._stats, self.parts
        # A released grid has no parts, but what was known of them.
        if known is not None and (known[0] is parts or not parts):
            return known[1]
        lists = [part.lists for part in parts or self.standing]
        made = stats_of(lists, self.mesh.triangle_count, self.upload_s, self.peak_nbytes)
        self._stats = parts, made
        return made

    def _headline(self) -> str:
        how = f"{self.layout}, {self.accuracy}, on {self.device.label}"
        state = "released" if self._released else bytes_text(self.nbytes)
        return f"over {self.mesh.source}: {counted(self.mesh.triangle_count, 'triangle')}, {how}, {state}"

    def _facts(self) -> Facts:
        # None of a grid whose last update failed.
        stands = self.parts or self._released or not self.mesh.triangle_count
        facts = facts_of(self.stats) if stands else {}
        was = f"for rays without order, in place of {self.recipe.layout}, density {self.recipe.density:g}"
        return {**facts, "rebuilt": was} if self.adapted else facts

    def _repr_html_(self) -> str:
        """A small picture of the mesh and a table, for notebooks."""
        if self._released or not self.parts:
            return super()._repr_html_()
        from clgrid.renderer import render

        picture = render(self.mesh, width=_THUMBNAIL[0], height=_THUMBNAIL[1], grid=self)
        return below_picture(picture.png(), super()._repr_html_())

    def arrays(self, part: int = 0) -> dict[str, npt.NDArray[Any]]:
        """Copies of the arrays of a part, by name, in the order of cl/lists.h.

        Raises
        ------
        InputError
            If the mesh has no triangles.
        """
        if self.empty:
            raise InputError("the mesh has no triangles, so there is no grid on a device")
        lists = self.standing[part].lists
        types = lists.dtypes
        return {
            name: self._allocator.download(array.buffer, types[name], array.nbytes // types[name]().itemsize)
            for name, array in lists.arrays.items()
        }


def build(
    mesh: Mesh,
    layout: str = "compact",
    density: float | str = "auto",
    resolution: tuple[int, int, int] | None = None,
    accuracy: str = "robust",
    device: Device | str | None = None,
    max_memory: int | None = None,
    skipping: bool | str = False,
    rays: int = cost.DEFAULT_RAYS,
    view: Camera | None = None,
    adapt: bool = True,
) -> Grid:
    """Build a grid over a mesh.

    What is "auto" is chosen for the least time of the build and the casts together, by a model of the device
    (see ``cost``); whatever is chosen, the hits are the same. ``Grid.choice`` says what was weighed.

    Parameters
    ----------
    mesh : Mesh
    layout : {"compact", "hashed", "linked-list", "dynamic-array", "nested", "nested-hashed", "auto"}
        How cells find their lists: the paper's two, those that it compares them with, or the paper's two over
        a coarse grid whose cells have grids of their own, for scenes that are crowded here and empty there.
    density : float or "auto"
        Cells per triangle. The paper's is 4. Of a nested layout, cells of subgrids per triangle in them.
    resolution : (int, int, int), optional
        Cells along x, y, z, instead of a density; of a nested layout those of the top grid, at most 4096.
    accuracy : {"robust", "fast", "precise", "exact"}
        A rung of the accuracy ladder (docs/numerics.md): no ray through a closed mesh, and the same bits
        everywhere; float32 without a promise, in 0.5 to 0.75 of the time; robust in float64; or the
        answers of rational arithmetic.
    device : Device or str, optional
        An index, part of a name, or platform:device; by default CLGRID_DEVICE or a CPU device.
    max_memory : int, optional
        Bytes that the finished grid may have. What is "auto" is chosen among grids that keep to it.
    skipping : bool or "auto"
        Keep a byte for every 4 x 4 x 4 cells, by which rays leap over empty space; changes no answer.
    rays : int
        How many are expected: many are worth a finer grid.
    view : Camera, optional
        Whose picture the rays are: from within a scene they take more tests than from outside, which they are
        taken for without.
    adapt : bool
        Whether rays that have little in common, once so many are cast that it pays, may have the grid
        rebuilt for them, while ``cast`` or another query runs: the same hits, sooner, from then on. Only
        where layout, density and skipping are all "auto", and never on the rung ``fast``, beyond
        ``max_memory`` with the one before, or beyond about 20 bytes a triangle.

    Raises
    ------
    InputError
        If an option is unknown or out of range.
    GridTooLargeError
        If the grid, or with "auto" every grid, would exceed ``max_memory``, the device, or 32-bit indices;
        says the bytes.
    DeviceError
        If there is no usable device, or it fails the self-test of the accuracy.
    """
    asked = Options(layout, density, resolution, accuracy, max_memory, skipping, rays, view, adapt)
    chosen = device if isinstance(device, Device) else choose(device)
    if mesh.triangle_count:
        require_tested(chosen, accuracy)
    grid, choice = asked.first_that_fits(mesh, chosen, lambda recipe: untested(mesh, chosen, recipe))
    grid.choice = choice
    return grid


def require_tested(device: Device, accuracy: str, *, again: bool = False) -> None:
    """Find out, before the first grid of this accuracy on the device, that it keeps the promises.

    ``again``: also where it is known already.

    Raises
    ------
    DeviceError
        If it does not.
    """
    tested = Recipe(selftest.LAYOUT, selftest.DENSITY, None, accuracy, None, False)
    selftest.require(device, RUNGS[accuracy], lambda ball: untested(ball, device, tested), again=again)


def untested(mesh: Mesh, device: Device, recipe: Recipe) -> Grid:
    """A grid of a recipe, though its device may fail the self-test: for what finds out why.

    Raises
    ------
    GridTooLargeError, DeviceError
        As of ``build``.
    """
    grid = Grid(mesh, device, recipe)
    if mesh.triangle_count:
        grid._build()
    return grid
