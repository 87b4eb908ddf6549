"""Differences between devices, planted: kernels altered in one place, on rays that show it."""

from __future__ import annotations

from functools import cache

from clgrid import selftest
from clgrid.device import Device
from clgrid.locate import Finding, Side, locate
from clgrid.mesh import Mesh
from clgrid.program import own_source_folder
from clgrid.repro_record import ReproGrid, ReproRay

MESH = selftest.mesh()
GRID = ReproGrid(layout="compact", accuracy="robust", resolution=(8, 8, 8))
CONTRACTION = "contraction: a product and a sum rounded once (fma)"
# Rays of the self-test whose answers change: two to misses, the third to another triangle.
CONTRACTED_RAY, EDGES_RAY, SHEAR_RAY = 99, 53, 17


def aimed(number: int) -> ReproRay:
    """A ray of the self-test: aimed at a vertex, an edge or a face of the mesh."""
    origins, directions = selftest.rays(MESH)
    return ReproRay.of(origins[number], directions[number])


def altered(name: str, *changes: tuple[str, str]) -> dict[str, str]:
    """A kernel source with texts replaced; each is there once."""
    text = (own_source_folder() / name).read_text(encoding="utf-8")
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return {name: text}


def contracted() -> dict[str, str]:
    """What a compiler does that ignores FP_CONTRACT OFF."""
    return altered("config.h", ("FP_CONTRACT OFF", "FP_CONTRACT ON"))


def fused_edges() -> dict[str, str]:
    """Edge functions of the test of one ray, contracted."""
    return altered(
        "triangle_robust.h",
        (
            "const float u = p->cx * p->by - p->cy * p->bx;",
            "const float u = fma(p->cx, p->by, -(p->cy * p->bx));",
        ),
        (
            "const float v = p->ax * p->cy - p->ay * p->cx;",
            "const float v = fma(p->ax, p->cy, -(p->ay * p->cx));",
        ),
        (
            "const float w = p->bx * p->ay - p->by * p->ax;",
            "const float w = fma(p->bx, p->ay, -(p->by * p->ax));",
        ),
    )


def reciprocal_shear() -> dict[str, str]:
    """A shear constant as a product with a reciprocal in float32."""
    return altered(
        "shear.h",
        (
            "s.sx = (float)((double)direction[s.kx] / dz);",
            "s.sx = direction[s.kx] * (1.0f / direction[s.kz]);",
        ),
    )


def late_hits() -> dict[str, str]:
    """Hits that are stored wrongly, after all that a trace sees."""
    return altered(
        "rays_in_out.h",
        (
            "missed ? INFINITY : reported_t(ray, &hit->meeting);",
            "missed ? INFINITY : 2 * reported_t(ray, &hit->meeting);",
        ),
    )


def wrong() -> dict[str, str]:
    """Three faults, each on rays of its own: kernels with all of them are compiled once."""
    return fused_edges() | reciprocal_shear() | late_hits()


def found(device: Device, ray: ReproRay, kernels: dict[str, str], mesh: Mesh = MESH) -> Finding:
    """Where a device with other kernels parts from itself."""
    return locate(mesh, GRID, ray, (Side(device.label), Side(device.label, kernels=kernels)))


@cache
def missed(label: str) -> Finding:
    """What contracted edge functions do to a ray, found once."""
    return locate(MESH, GRID, aimed(EDGES_RAY), (Side(label), Side(label, kernels=wrong())))
