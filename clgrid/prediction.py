"""Bytes of a grid before it is built."""

from __future__ import annotations

from clgrid import cost, layouts
from clgrid.camera import Camera
from clgrid.device import Device, choose
from clgrid.memory import Allocator
from clgrid.mesh import Mesh
from clgrid.recipe import Options, Recipe
from clgrid.target import DeviceMesh


def predict(
    mesh: Mesh,
    layout: str = "compact",
    density: float | str = "auto",
    resolution: tuple[int, int, int] | None = None,
    device: Device | str | None = None,
    max_memory: int | None = None,
    skipping: bool | str = False,
    rays: int = cost.DEFAULT_RAYS,
    view: Camera | None = None,
) -> dict[str, int]:
    """Bytes by array of the grid that ``build`` would make, exactly, without keeping any of it.

    Parameters, errors
        As of ``build``. The mesh must fit in one part on the device.
    """
    return predict_choice(mesh, layout, density, resolution, device, max_memory, skipping, rays, view)[0]


def predict_choice(
    mesh: Mesh,
    layout: str = "compact",
    density: float | str = "auto",
    resolution: tuple[int, int, int] | None = None,
    device: Device | str | None = None,
    max_memory: int | None = None,
    skipping: bool | str = False,
    rays: int = cost.DEFAULT_RAYS,
    view: Camera | None = None,
) -> tuple[dict[str, int], cost.Choice | None]:
    """``predict``, with what ``Grid.choice`` would be."""
    asked = Options(layout, density, resolution, "robust", max_memory, skipping, rays, view)
    chosen = device if isinstance(device, Device) else choose(device)

    def attempt(recipe: Recipe) -> dict[str, int]:
        if not mesh.triangle_count:
            return {}
        allocator = Allocator(chosen, recipe.max_memory)
        part = DeviceMesh(mesh, chosen, allocator).whole
        sizes = layouts.predict(
            chosen, allocator, part.vertices, part.faces, recipe.params(part), recipe.layout, recipe.skipping,
            recipe.density,
        )  # fmt: skip
        allocator.check_arrays(sizes, f"a grid of density {recipe.density:g}")
        return sizes

    return asked.first_that_fits(mesh, chosen, attempt)
