"""Small looks and shadings for which the same kernels are compiled as for large ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clgrid.look import Look, Material, Shading, Texture, TextureUse
from clgrid.memory import Allocator
from clgrid.mesh import Mesh
from clgrid.shading.lamps import lamps_of
from clgrid.shading.surfaces import Surfaces


def stand_in(look: Look | None, mesh: Mesh) -> Look | None:
    """A look of a small mesh that has what another look has, of each kind one.

    Where rays may pass surfaces, they pass this one, so that what comes behind is compiled too.
    """
    if look is None:
        return None
    having = Surfaces(look, mesh, Allocator.__new__(Allocator))
    use = TextureUse(0) if having.textured else None
    material = Material(base_texture=use)
    if having.passable:
        material = replace(material, base_colour=(1.0, 1.0, 1.0, 0.0), alpha_mode="mask")
    vertices = len(mesh.vertices)
    return Look(
        materials=(material,),
        material_ids=np.zeros(mesh.triangle_count, look.material_ids.dtype),
        textures=(Texture(np.zeros((1, 1, 4), np.uint8)),) if use else (),
        uvs=(np.zeros((vertices, 2), np.float32),) if look.uvs else (),
        uv_faces=(None,) if look.uvs else (),
        colours=None if look.colours is None else np.ones((vertices, 4), np.float32),
    )


def few(look: Look | None, shading: Shading) -> Shading:
    """A shading of one sample and at most one light and occlusion ray."""
    lit = bool(lamps_of(look, shading))
    return replace(
        shading,
        samples=1,
        sun=(0.0, 0.0, 1.0) if lit else None,
        occlusion_rays=min(1, shading.occlusion_rays),
    )
