"""Build a grid over a mesh and cast rays through it: the heart of clgrid."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid import compact
from clgrid.cast import DeviceMesh, Hits, cast_closest, no_hits
from clgrid.device import Device, choose
from clgrid.errors import InputError
from clgrid.frame import LocalFrame
from clgrid.memory import Allocator
from clgrid.mesh import Mesh
from clgrid.resolution import DEFAULT_DENSITY, by_density, checked

LAYOUTS = ("compact",)
ACCURACIES = ("robust",)


@dataclass(frozen=True)
class GridStats:
    """What a build made, and what it took.

    Attributes
    ----------
    triangles, cells, references : int
    resolution : (int, int, int)
    density : float
        Cells per triangle, as built.
    empty_share : float
        Share of cells with an empty list.
    build_s : dict of str to float
        Seconds of each stage on the device: count, scan, bin, insert.
    upload_s : float
        Seconds to bring the mesh into its local frame and to the device.
    nbytes : dict of str to int
        Bytes by array.
    peak_nbytes : int
        Most bytes that the build held on the device at once, the finished grid included.
    """

    triangles: int
    cells: int
    references: int
    resolution: tuple[int, int, int]
    density: float
    empty_share: float
    build_s: dict[str, float]
    upload_s: float
    nbytes: dict[str, int]
    peak_nbytes: int


class Grid:
    """A grid over a mesh, on a device. Made by ``clgrid.build``.

    Attributes
    ----------
    mesh : Mesh
    device : Device
    layout, accuracy : str
    upload_s : float
        Seconds to bring the mesh into its local frame and to the device.
    """

    def __init__(self, mesh: Mesh, device: Device, layout: str, accuracy: str, skipping: bool) -> None:
        self.mesh = mesh
        self.device = device
        self.layout = layout
        self.accuracy = accuracy
        self.skipping = skipping
        self._allocator = Allocator(device)
        self._target: DeviceMesh | None = None
        self._compact: compact.CompactGrid | None = None
        self.upload_s = 0.0

    def _build(self, density: float, resolution: tuple[int, int, int] | None, max_memory: int | None) -> None:
        start = time.perf_counter()
        self._allocator = Allocator(self.device, max_memory)
        if self._target is None:
            self._target = DeviceMesh(self.mesh, self.device, self._allocator)
            self.upload_s = time.perf_counter() - start
        bounds = self._target.local_bounds
        cells = resolution or by_density(bounds[1] - bounds[0], self.mesh.triangle_count, density)
        params = compact.plane_params(bounds, cells, self.mesh.triangle_count)
        self._compact = compact.build(
            self.device, self._allocator, self._target.vertices, self._target.faces, params, self.skipping
        )

    @property
    def target(self) -> DeviceMesh:
        """The mesh on the device; only for a mesh that has triangles."""
        if self._target is None:
            raise InputError("the mesh has no triangles, so nothing of it is on a device")
        return self._target

    @property
    def compact(self) -> compact.CompactGrid:
        """The arrays on the device; only for a mesh that has triangles."""
        if self._compact is None:
            raise InputError("the mesh has no triangles, so there is no grid on a device")
        return self._compact

    @property
    def empty(self) -> bool:
        """Whether the mesh has no triangles; every ray then misses."""
        return self._compact is None

    @property
    def frame(self) -> LocalFrame:
        """Where the kernels see the mesh."""
        return self.target.frame

    @property
    def nbytes(self) -> int:
        """Bytes of the acceleration structure, exactly; the mesh is not part of it."""
        return 0 if self._compact is None else sum(self._compact.nbytes.values())

    @property
    def peak_nbytes(self) -> int:
        """Most device bytes that the build held at once, the finished grid included."""
        return self._allocator.peak_nbytes

    @cached_property
    def stats(self) -> GridStats:
        """Counts, bytes and seconds; the share of empty cells is counted at the first call."""
        if self._compact is None:
            return GridStats(0, 0, 0, (0, 0, 0), 0.0, 1.0, {}, 0.0, {}, 0)
        grid, triangles = self._compact, self.mesh.triangle_count
        starts, _ = self.arrays()
        empty = int(np.count_nonzero(starts[1:] == starts[:-1]))
        return GridStats(
            triangles=triangles,
            cells=grid.cell_count,
            references=grid.reference_count,
            resolution=grid.resolution,
            density=grid.cell_count / triangles,
            empty_share=empty / grid.cell_count,
            build_s=grid.build_s,
            upload_s=self.upload_s,
            nbytes=grid.nbytes,
            peak_nbytes=self.peak_nbytes,
        )

    def arrays(self) -> tuple[npt.NDArray[np.uint32], npt.NDArray[np.uint32]]:
        """Copies of the grid's two arrays: (M + 1,) list starts and (R,) triangle ids, uint32."""
        grid = self.compact
        return (
            self._allocator.download(grid.cells, np.uint32, grid.cell_count + 1),
            self._allocator.download(grid.references, np.uint32, grid.reference_count),
        )

    def cast(
        self,
        origins: npt.ArrayLike,
        directions: npt.ArrayLike | None = None,
        t_min: npt.ArrayLike = 0.0,
        t_max: npt.ArrayLike = np.inf,
    ) -> Hits:
        """Closest hit of each ray.

        Parameters
        ----------
        origins : (..., 3) or (..., 6) float32 or float64
            Scene units; with six components, the last three are the directions.
        directions : (..., 3) float32 or float64
            Of any length but zero; broadcast against the origins.
        t_min, t_max : float or (...) float64
            Closed interval of the ray parameter, in lengths of the direction.

        Returns
        -------
        Hits

        Raises
        ------
        InputError
            If shapes or dtypes do not fit.
        """
        if self._compact is None:
            return no_hits(self.mesh, origins, directions, t_min, t_max)
        return cast_closest(self.target, self._compact, origins, directions, t_min, t_max)


def build(
    mesh: Mesh,
    layout: str = "compact",
    density: float | str = "auto",
    resolution: tuple[int, int, int] | None = None,
    accuracy: str = "robust",
    device: Device | str | None = None,
    max_memory: int | None = None,
    skipping: bool = False,
) -> Grid:
    """Build a grid over a mesh.

    Parameters
    ----------
    mesh : Mesh
    layout : {"compact"}
        How cells find their lists.
    density : float or "auto"
        Cells per triangle; "auto" is the paper's 4.
    resolution : (int, int, int), optional
        Cells along x, y, z, instead of a density.
    accuracy : {"robust"}
        A rung of the accuracy ladder.
    device : Device or str, optional
        An index, part of a name, or platform:device; by default CLGRID_DEVICE or a CPU device.
    max_memory : int, optional
        Bytes that the finished grid may have.
    skipping : bool
        Keep a byte for every 4 x 4 x 4 cells, by which rays leap over empty space; changes no answer.

    Raises
    ------
    InputError
        If an option is unknown or out of range.
    GridTooLargeError
        If the grid would exceed ``max_memory``, the device, or 32-bit indices; says the bytes.
    DeviceError
        If there is no usable device.
    """
    for name, value, known in (("layout", layout, LAYOUTS), ("accuracy", accuracy, ACCURACIES)):
        if value not in known:
            raise InputError(f"{name} is {value!r}; choose one of {', '.join(known)}")
    if isinstance(density, str):
        if density != "auto":
            raise InputError(f"density is {density!r}; give a number or 'auto'")
        density = DEFAULT_DENSITY
    cells = None if resolution is None else checked(resolution)
    grid = Grid(mesh, device if isinstance(device, Device) else choose(device), layout, accuracy, skipping)
    if mesh.triangle_count:
        grid._build(density, cells, max_memory)
    return grid


def device_buffers(grid: Grid) -> list[Any]:
    """The kernel arguments that every traversal takes, in the order of cl/grid.h."""
    target, cells = grid.target, grid.compact
    return [target.frame_params, *cells.arguments, target.vertices, target.faces]
