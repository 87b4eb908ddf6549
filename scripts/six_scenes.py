"""Six scenes that experiments are run on unless others are named: scans, a terrain, rooms from within."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from figure1_scenes import usable_folder

from clgrid.camera import Camera
from clgrid.scene import Scene, default_camera, named_camera

CHECKOUT = Path(__file__).resolve().parent.parent

# Scenes of the folder, and what stands in for each without it.
SCENES = (
    ("scans/armadillo.obj", "icosphere:6"),
    ("scans/bunny_zipper.ply", "icosphere:5"),
    ("scans/dragon_vrip.ply.gz", "demo"),
    ("scans/terrain_st_helens.ply", "terrain:384"),
    ("arch/sponza_dabrovic.glb", "terrain:128"),
    ("arch/white_room.glb.gz", "cube"),
)


def default_scenes() -> list[str]:
    """Names of the six."""
    return scenes_or_instead(SCENES)


def scenes_or_instead(scenes: Sequence[tuple[str, str]]) -> list[str]:
    """Files of the scenes folder, each that is missing replaced by the built-in scene beside it."""
    folder = usable_folder(Path(os.environ.get("CLGRID_SCENES") or CHECKOUT.parent / "shared" / "scenes"))
    return [
        str(folder / name) if folder is not None and (folder / name).is_file() else instead
        for name, instead in scenes
    ]


def camera_of(scene: Scene, name: str, aspect: float) -> Camera:
    """That of the file beside the scene, if there is one."""
    beside = Path(name.removesuffix(".gz")).with_suffix(".camera.json")
    return named_camera(scene, str(beside)) if beside.is_file() else default_camera(scene, aspect)
