"""Small looks and shadings for which the same kernels are compiled as for large ones."""

from __future__ import annotations

import math

import numpy as np

from clgrid.look import Look, Material, Shading, Texture, TextureUse
from clgrid.mesh import Mesh
from clgrid.shading.lamps import lamps_of
from clgrid.shading.surfaces import is_passable, is_textured


def traits(look: Look | None) -> frozenset[str]:
    """What of a look kernels are compiled for."""
    if look is None:
        return frozenset()
    has = {
        str(look.material_ids.dtype): True,
        "textures": is_textured(look),
        "uvs": bool(look.uvs),
        "colours": look.colours is not None,
        "passes": is_passable(look),
    }
    return frozenset(name for name, there in has.items() if there)


def stand_in(has: frozenset[str], mesh: Mesh) -> Look | None:
    """A look of a small mesh with these traits; None where there are none.

    Where rays may pass surfaces, they pass this one, so that what comes behind is compiled too.
    """
    if not has:
        return None
    passes, vertices = "passes" in has, len(mesh.vertices)
    material = Material(
        base_colour=(1.0, 1.0, 1.0, 0.0 if passes else 1.0),
        base_texture=TextureUse(0) if "textures" in has else None,
        alpha_mode="mask" if passes else "opaque",
    )
    return Look(
        materials=(material,),
        material_ids=np.zeros(mesh.triangle_count, "uint16" if "uint16" in has else "uint32"),
        textures=(Texture(np.zeros((1, 1, 4), np.uint8)),) if "textures" in has else (),
        uvs=(np.zeros((vertices, 2), np.float32),) if "uvs" in has else (),
        uv_faces=(None,) if "uvs" in has else (),
        colours=np.ones((vertices, 4), np.float32) if "colours" in has else None,
    )


def few(look: Look | None, shading: Shading | None) -> Shading | None:
    """A shading with at most one of each: samples, lights, rays to the sky."""
    if shading is None:
        return None
    return Shading(
        sun=(0.0, 0.0, 1.0) if lamps_of(look, shading) else None,
        sky=None if shading.sky is None else (1.0, 1.0, 1.0),
        occlusion_rays=1 if shading.sky is not None and shading.occlusion_rays > 0 else 0,
        occlusion_distance=math.inf,
    )
