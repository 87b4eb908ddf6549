"""Work for Oclgrind to watch, a case a process: ``python watched.py KERNELS CASE``.

Oclgrind 21.10 misjudges some of what kernels and hosts may do. Its source says why; so, here only:

- A lane that a shuffle leaves undefined crashes its search for uninitialised reads, and lane 11 of the two
  vectors of a shuffle passes for uninitialised. KERNELS is a copy of cl/ in which `spelled_out` left none.
- Its record of what was written to a buffer is as long as the host's last write, outlives the buffer, and
  knows nothing of memory of the host's. So buffers are copies, written whole, and never given back.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from clgrid import (
    brute,
    camera,
    grid,
    layouts,
    look,
    memory,
    procedural,
    program,
    registration,
    renderer,
    target,
    tuning,
)
from clgrid import device as devices
from clgrid.layouts import binning, nested, planes
from clgrid.mesh import Mesh
from clgrid.rungs import LOSSLESS
from clgrid.selftest import _passed, rays

MARK = "watched: "
BUILD_OPTIONS = "-w -cl-opt-disable -fpreserve-vec3-type -D__builtin_prefetch(a,b,c)=((void)0)"
"""It interprets what clang makes without optimisation; prefetches, not even that."""

_LITERAL = re.compile(r"\((?:float|double|u?int|u?long)([248])\)\(")
_DENSITY = 4.0
_SIZE = 16


def spelled_out(source: str) -> str:
    """Kernel source in which vectors are made of numbers, never of shorter vectors."""
    parts, position = [], 0
    while literal := _LITERAL.search(source, position):
        width = int(literal[1])
        inner, end = _arguments(source, literal.end())
        items = [spelled_out(item.strip()) for item in inner]
        parts += [source[position : literal.end()], ", ".join(_lanes(items, width)), ")"]
        position = end
    return "".join(parts) + source[position:]


def _arguments(source: str, start: int) -> tuple[list[str], int]:
    """What stands between commas from ``start`` to the bracket that closes, and where that ends."""
    depth, found, begin = 1, [], start
    for at in range(start, len(source)):
        depth += (source[at] in "([") - (source[at] in ")]")
        if depth == 0 or (depth == 1 and source[at] == ","):
            found.append(source[begin:at])
            begin = at + 1
        if depth == 0:
            return found, at + 1
    raise ValueError(f"a bracket is never closed: {source[start : start + 80]}")


def _lanes(items: list[str], width: int) -> list[str]:
    """The numbers that a vector is made of."""
    if len(items) in (1, width):
        return items
    # Vectors of one width, or vload3 and a number.
    widths = [3, 0] if items[0].startswith("vload3") else [width // len(items)] * len(items)
    assert sum(each or 1 for each in widths) == width, items
    return [
        f"({item}).s{lane}" if each else item
        for item, each in zip(items, widths, strict=True)
        for lane in range(each or 1)
    ]


def _write_whole() -> None:
    """Make clgrid's buffers as Oclgrind follows them."""
    cl: Any = registration.opencl()
    copy_to, kept = cl.enqueue_copy, []

    class Kept(cl.Buffer):  # type: ignore[misc]
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            kept.append(self)

        def release(self) -> None:
            """Not before the process ends."""

    def copied(self: memory.Allocator, array: np.ndarray) -> Any:
        flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
        return Kept(self._device.context, flags, hostbuf=array) if array.nbytes else self.buffer(1)

    def bring_home(self: memory.Allocator, array: np.ndarray, buffer: Any) -> None:
        copy_to(self._device.queue, array, buffer, is_blocking=True)

    def enqueue_copy(queue: Any, to: Any, source: Any, **options: Any) -> Any:
        if not isinstance(to, cl.Buffer):
            return copy_to(queue, to, source, **options)
        # What a part leaves counts as written, too.
        whole = np.zeros(to.size, np.uint8)
        copy_to(queue, whole, to, is_blocking=True)
        start = options.get("dst_offset", 0)
        if isinstance(source, cl.Buffer):
            part = np.zeros(options.get("byte_count") or source.size, np.uint8)
            copy_to(queue, part, source, src_offset=options.get("src_offset", 0), is_blocking=True)
        else:
            part = np.ascontiguousarray(source).reshape(-1).view(np.uint8)
        whole[start : start + len(part)] = part
        return copy_to(queue, to, whole, is_blocking=True)

    def fill(queue: Any, to: Any, pattern: Any, offset: int, size: int, wait_for: Any = None) -> Any:
        return enqueue_copy(queue, to, np.tile(pattern, size // pattern.nbytes), dst_offset=offset)

    cl.Buffer, cl.enqueue_copy, cl.enqueue_fill_buffer = Kept, enqueue_copy, fill
    for name, method in (
        ("share", copied),
        ("results", copied),
        ("bring_home", bring_home),
        ("adopt", copied),
    ):
        setattr(memory.Allocator, name, method)


def _divide_finely() -> None:
    """Several chunks and slabs, or there were nobody to race with."""
    binning._SMALLEST_CHUNK = 32  # type: ignore[misc]
    for module in (planes, nested):
        module.slab_shift = lambda cells: 6  # type: ignore[attr-defined]


def _made(layout: str, rung: str, **options: Any) -> tuple[Mesh, grid.Grid]:
    mesh = procedural.icosphere(1)
    return mesh, grid.build(
        mesh, layout=layout, density=_DENSITY, accuracy=rung, device="oclgrind", **options
    )


def _some_rays(mesh: Mesh, count: int) -> tuple[np.ndarray, np.ndarray]:
    """From within to vertices, edges and faces; one beside the mesh, and one that is none."""
    origins, directions = rays(mesh)
    chosen = np.linspace(0, len(origins) - 1, count).astype(int)
    origins, directions = origins[chosen].copy(), directions[chosen].copy()
    origins[0], directions[1] = 9.0, np.nan
    return origins, directions


def _cast(layout: str, rung: str, count: int, *queries: str, **options: Any) -> None:
    """Build, and cast through the grid; its hits are those of the oracle, under Oclgrind too."""
    mesh, made = _made(layout, rung, **options)
    origins, directions = _some_rays(mesh, count)
    if "closest" in queries:
        hits = made.cast(origins, directions)
        if rung in LOSSLESS:
            every = brute.brute_force(mesh, origins, directions, device="oclgrind", accuracy=rung)
            assert np.array_equal(hits.primitive_ids, every.primitive_ids)
    if "any" in queries:
        assert made.occluded(origins, directions).sum() == count - 2
    if "count" in queries:
        assert np.count_nonzero(made.count(origins, directions)) == count - 2
    if "all" in queries:
        made.cast_all(origins, directions)


def _picture(layout: str, rung: str) -> None:
    mesh, made = _made(layout, rung)
    view = camera.Camera.look_at(eye=(0.5, 1, 3), target=(0, 0, 0))
    image = renderer.render(mesh, view, _SIZE, _SIZE, ("depth", "normal", "id"), grid=made)
    assert 0 < np.count_nonzero(np.isfinite(image.depth)) < _SIZE * _SIZE


def _lit_picture() -> None:
    mesh, made = _made("compact", "robust")
    lamps = (look.Light("point", (1, 0.8, 0.6), 9, (1, -1, 2.5)),)
    white = look.Look((look.Material("white"),), np.zeros(mesh.triangle_count, np.uint32), lights=lamps)
    shading = look.Shading(samples=1, sun=(1, 2, 3), sky=(0.3, 0.4, 0.5), occlusion_rays=4)
    view = camera.Camera.look_at(eye=(0.5, 1, 3), target=(0, 0, 0))
    renderer.render(mesh, view, _SIZE, _SIZE, grid=made, look=white, shading=shading)


def _moved() -> None:
    mesh, made = _made("compact", "robust")
    made.update(2 * mesh.vertices)
    assert made.occluded(*_some_rays(made.mesh, 8)).sum() == 6


def _in_parts() -> None:
    for module in (memory, target):
        module.largest_buffer = lambda device: 600  # type: ignore[attr-defined]
    _cast("compact", "robust", 8, "closest", "all")


def _wide_positions() -> None:
    binning.MOST_REFERENCES = 10  # type: ignore[misc]
    _cast("compact", "robust", 8, "closest")


def _in_turns() -> None:
    with tuning.tried(tuning.Tuning(fewest_together=65, herd=4, fewest_in_turns=0)):
        _cast("compact", "robust", 20, "closest")


CASES: dict[str, Callable[[], None]] = {
    **{
        layout: (lambda layout=layout: _cast(layout, "robust", 20, "closest", "any"))
        for layout in layouts.ALL_LAYOUTS
    },
    "moved": _moved,
    "in parts": _in_parts,
    "wide positions": _wide_positions,
    "in turns": _in_turns,
    "skipping": lambda: _cast("compact", "robust", 20, "closest", skipping=True),
    **{
        f"queries {rung}": (
            lambda rung=rung, count=count: _cast("compact", rung, count, "closest", "count", "all")
        )
        for rung, count in (("fast", 20), ("robust", 20), ("precise", 20), ("exact", 10))
    },
    "queries nested": lambda: _cast("nested", "robust", 12, "count", "all"),
    **{
        f"picture {rung}": (lambda rung=rung: _picture("compact", rung))
        for rung in ("fast", "robust", "precise", "exact")
    },
    "picture nested": lambda: _picture("nested", "robust"),
    "lit picture": _lit_picture,
}


def main(kernels: str, case: str) -> None:
    """Run one case; what goes wrong is on stderr, after the mark."""
    _write_whole()
    _divide_finely()
    program.source_folder = lambda: Path(kernels)  # type: ignore[assignment]
    simulator = devices.choose("oclgrind")
    # It casts a thousand rays, and answers are no concern here.
    _passed.update((simulator, rung) for rung in LOSSLESS)
    print(MARK + case, file=sys.stderr, flush=True)
    CASES[case]()


if __name__ == "__main__":
    main(*sys.argv[1:])
