"""Sorts references by slab: the stages that every layout shares.

``count_references``  A *chunk* of triangles is one work-item. It turns each triangle's padded box
                      into a range of cells, and counts references per *slab*: 2^slab_shift
                      consecutive cells, small enough that a slab's counters stay in the L2 cache. Of
                      large triangles it keeps which cells they touch.
``scan_slabs``        Prefix sum over (slab, chunk): where each chunk writes into each slab.
``bin_references``    The chunks write their references to the slabs: the cell within the slab and the
                      triangle within the chunk, 16 bits each. Within a slab, chunks follow one another, so
                      triangles are ascending.

A layout then finishes each slab by one work-item. No atomics and no barriers: the bytes depend on
nothing but the mesh and the resolution.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from clgrid.device import Device
from clgrid.memory import Allocator
from clgrid.program import kernel

MOST_REFERENCES = 2**32 - 2
"""That 32 bits number, with one value to spare for "none"; beyond it, positions have 64."""

_SMALLEST_CHUNK = 4096
_LARGEST_CHUNK = 65536  # a triangle within its chunk is 16 bits
_USUAL_CHUNKS = 64
_VECTOR = 8
# Runs of cells of large triangles that are kept, so that these are not clipped twice: 4 MB, enough for rooms.
_MOST_RUNS = 1 << 19


class Work:
    """A build under way: where it runs, on what, and how long its stages took.

    Attributes
    ----------
    device : Device
    allocator : Allocator
        Accounts for every byte, and refuses what exceeds its limit.
    vertices, faces : buffer
        3 V + 1 float32 local coordinates within [-1, 1], and 3 F uint32.
    params : buffer of one GridParams
    resolution : (int, int, int)
    triangles, cells, slab_shift, slabs : int
    seconds : dict of str to float
        By stage.
    reference_count : int
        Known after ``count``.
    wide : bool
        Whether positions of references have 64 bits; known after ``count``.
    """

    def __init__(
        self, device: Device, allocator: Allocator, vertices: Any, faces: Any, params: npt.NDArray[np.void]
    ) -> None:
        x, y, z = (int(n) for n in params["resolution"])
        self.device = device
        self.allocator = allocator
        self.vertices = vertices
        self.faces = faces
        self.host_params = params
        self.params = allocator.upload(params)
        self.resolution = (x, y, z)
        self.triangles = int(params["triangle_count"])
        self.cells = x * y * z
        self.slab_shift = int(params["slab_shift"])
        self.slabs = ((self.cells - 1) >> self.slab_shift) + 1
        self.seconds: dict[str, float] = {}
        self.reference_count = 0
        self.wide = False

    @property
    def index_bytes(self) -> int:
        """Of a position of a reference."""
        return 8 if self.wide else 4

    @property
    def defines(self) -> dict[str, int | str]:
        """The options with which the stages of this build are compiled."""
        return {"WIDE_REFERENCES": 1} if self.wide else {}

    @property
    def name(self) -> str:
        """What messages call the grid."""
        return f"a grid of {'x'.join(map(str, self.resolution))} cells"

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time what is done within, the device's work included."""
        start = time.perf_counter()
        yield
        self.device.queue.finish()
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def run(self, stage: str, items: int, *arguments: Any) -> None:
        """Enqueue a stage's kernel over so many work-items."""
        call = kernel(self.device, f"{stage}.cl", stage, **self.defines)
        call(self.device.queue, (items,), (1,), *arguments)

    def each_slab(self, stage: str, *arguments: Any) -> None:
        """Enqueue a stage that takes the cells, slab by slab."""
        self.run(stage, self.slabs, np.uint32(self.cells), np.uint32(self.slab_shift), *arguments)


@dataclass(frozen=True)
class Counted:
    """After counting: cell ranges by triangle, references by chunk and slab, and room for where they go.

    ``kept`` are the runs of cells of large triangles, and how many a chunk has room for.
    """

    chunks: int
    shape: tuple[np.uint32, np.uint32, np.uint32]
    ranges: Any
    counts: Any
    starts: Any
    kept: tuple[np.uint32, Any]

    @property
    def buffers(self) -> tuple[Any, ...]:
        """All of them."""
        return self.ranges, self.counts, self.starts, self.kept[1]


@dataclass(frozen=True)
class Binned:
    """References sorted by slab.

    Attributes
    ----------
    slab_starts : buffer of (slabs + 1)
        Where each slab's references start.
    ends : buffer of (chunks, slabs)
        Where the references of each chunk end in each slab.
    chunks, chunk_size : uint32
    entries : buffer of R uint32
        Triangle within its chunk, and cell within its slab; triangles ascend within each slab.
    """

    slab_starts: Any
    ends: Any
    chunks: np.uint32
    chunk_size: np.uint32
    entries: Any

    @property
    def arguments(self) -> tuple[Any, ...]:
        """What kernels take that need the triangles."""
        return self.slab_starts, self.ends, self.chunks, self.chunk_size, self.entries


def count(work: Work) -> Counted:
    """Count references; sets the work's ``reference_count`` and ``wide``."""
    with work.stage("count"):
        counted, total = _count(work)
        if total > MOST_REFERENCES and not work.wide:
            work.allocator.release(*counted.buffers)
            work.allocator.check(4 * total, f"{work.name} and {total:,} references")
            work.wide = True
            counted, total = _count(work)
    work.reference_count = total
    return counted


def _count(work: Work) -> tuple[Counted, int]:
    allocator = work.allocator
    chunk_size = -(-max(_SMALLEST_CHUNK, -(-work.triangles // _USUAL_CHUNKS)) // _VECTOR) * _VECTOR
    chunk_size = min(chunk_size, _LARGEST_CHUNK)
    chunks = -(-work.triangles // chunk_size)
    shape = (np.uint32(chunk_size), np.uint32(work.slab_shift), np.uint32(work.slabs))
    ranges = allocator.buffer(8 * work.triangles)
    counts = allocator.buffer(work.index_bytes * chunks * work.slabs)
    starts = allocator.buffer(work.index_bytes * chunks * work.slabs)
    totals = allocator.buffer(8 * chunks)
    room = min(chunk_size, work.triangles, _MOST_RUNS // chunks)
    kept = (np.uint32(room), allocator.buffer(8 * chunks * room))
    most = np.uint64(2**63 if work.wide else MOST_REFERENCES)
    work.run(
        "count_references",
        chunks,
        work.params,
        work.vertices,
        work.faces,
        *shape,
        most,
        ranges,
        counts,
        starts,
        *kept,
        totals,
    )
    total = int(allocator.download(totals, np.uint64, chunks).sum())
    allocator.release(totals)
    return Counted(chunks, shape, ranges, counts, starts, kept), total


def sort_by_slab(work: Work, counted: Counted) -> Binned:
    """Scan the counts and bring every reference to its slab; releases the counts."""
    allocator = work.allocator
    with work.stage("scan"):
        slab_starts = allocator.buffer(work.index_bytes * (work.slabs + 1))
        work.run(
            "scan_slabs",
            1,
            np.uint32(counted.chunks),
            np.uint32(work.slabs),
            counted.counts,
            counted.starts,
            slab_starts,
        )
    with work.stage("bin"):
        entries = allocator.buffer(4 * work.reference_count)
        work.run(
            "bin_references", counted.chunks, work.params, work.vertices, work.faces, *counted.shape,
            counted.ranges, counted.starts, counted.counts, *counted.kept, entries,
        )  # fmt: skip
    allocator.release(counted.ranges, counted.starts, counted.kept[1])
    return Binned(slab_starts, counted.counts, np.uint32(counted.chunks), counted.shape[0], entries)
