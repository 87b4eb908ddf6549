"""Lit pictures beside Mitsuba's: sun and sky, and direct light alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import second_opinion_mitsuba as second
from second_opinion_compare import F64, Mask
from second_opinion_pieces import pieces_of
from second_opinion_scenes import cornell

import clgrid
from clgrid.camera import Camera
from clgrid.device import Device
from clgrid.image import Image
from clgrid.look import Look, Material, Shading
from clgrid.mesh import Mesh
from clgrid.scene import load_scene
from clgrid.shading.surfaces import GREY

# The most that pictures may differ by in the mean, relative.
MOST_MEAN = 0.01
_SIZE, _SAMPLES, _SKY_RAYS = (256, 256), 64, 16
_SECOND_SAMPLES = 512
_SUN, _LUX, _SKY = (
    np.array([0.3, 0.7, 0.65]) / np.linalg.norm([0.3, 0.7, 0.65]),
    2.0,
    np.array([0.5, 0.6, 0.8]),
)
_HEADER = (
    "| picture | mean of clgrid | of Mitsuba | difference | rms | of that noise |\n|---|--:|--:|--:|--:|--:|"
)


def light(mi: Any, scenes: Path, device: Device, out: Path) -> bool:
    """Print a row for each picture; whether all means agree."""
    print(_HEADER)
    agree = [_compared(mi, *subject, device, out) for subject in _subjects(scenes)]
    return all(agree)


def _subjects(scenes: Path) -> list[tuple[str, Mesh, Look | None, Camera]]:
    box, numbers, colours = cornell()
    materials = tuple(Material(base_colour=(*colour, 1.0)) for colour in colours)
    front = Camera.look_at((0.5, 0.5, 2.4), (0.5, 0.5, 0.0), fov=38.0)
    duck = load_scene(scenes / "textured/Duck.glb")
    near = clgrid.default_camera(duck)
    flat = replace(duck.mesh, vertex_normals=None)
    return [
        ("box", box, Look(materials, numbers.astype(np.uint16)), front),
        ("Duck, normals of triangles", flat, duck.look, near),
        ("Duck, normals of vertices", duck.mesh, duck.look, near),
    ]


def _compared(
    mi: Any, name: str, mesh: Mesh, look: Look | None, camera: Camera, device: Device, out: Path
) -> bool:
    if look is not None:  # Mitsuba's surfaces have two sides here
        both = tuple(replace(material, double_sided=True) for material in look.materials)
        look = replace(look, materials=both)
    shading = Shading(
        samples=_SAMPLES, sun=tuple(_SUN), sun_strength=_LUX, sky=tuple(_SKY), occlusion_rays=_SKY_RAYS,
        lights=False,
    )  # fmt: skip
    picture = clgrid.render(
        mesh, camera, *_SIZE, look=look, shading=shading, background=tuple(_SKY), device=device
    )
    scene = second.Second(mi, pieces_of(mesh, look, GREY))
    lit = [scene.lit(camera, _SIZE, _SUN, _LUX, _SKY, _SECOND_SAMPLES // 2, seed) for seed in (1, 2)]
    slug = name.replace(", ", "_").replace(" ", "_")
    picture.save(out / f"light_{slug}.png")
    found = figures(picture.rgba[..., :3].astype(np.float64), lit[0], lit[1], picture.rgba[..., 3] > 0)
    theirs = Image(picture.rgba.copy())
    theirs.rgba[..., :3] = 0.5 * (lit[0] + lit[1])
    theirs.save(out / f"light_{slug}_mitsuba.png")
    ours, other, relative, rms, noise = found
    print(f"| {name} | {ours:.4f} | {other:.4f} | {relative:+.3%} | {rms:.2%} | {noise:.2%} |", flush=True)
    return abs(relative) <= MOST_MEAN


def figures(ours: F64, first: F64, second_half: F64, hit: Mask) -> tuple[float, float, float, float, float]:
    """Means over pixels that hit; the relative difference; rms of pixels over the mean; Mitsuba's own noise.

    Mitsuba's picture comes in two halves of independent samples: half their difference is its noise.
    """
    theirs = 0.5 * (first + second_half)
    mean, other = float(ours[hit].mean()), float(theirs[hit].mean())
    rms = float(np.sqrt(((ours - theirs)[hit] ** 2).mean()))
    noise = float(np.sqrt(((0.5 * (first - second_half))[hit] ** 2).mean()))
    return mean, other, (mean - other) / other, rms / other, noise / other
