"""The scenes that second_opinion draws: files of the scenes folder, unpacked, and a camera for each."""

from __future__ import annotations

import gzip
import shutil
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from clgrid.camera import Camera
from clgrid.mesh import Mesh
from clgrid.scene import Scene, default_camera, named_camera

Eye = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]


@dataclass(frozen=True)
class Place:
    """A scene of the folder; ``member`` of a zip file, ``eye`` (eye, look-at, up) where it has no camera."""

    file: str
    member: str = ""
    eye: Eye | None = None


_Y, _Z = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
PLACES = (
    Place("textured/Duck.glb"),
    Place("textured/CesiumMilkTruck.glb"),
    Place("textured/flight_helmet_gltf.zip", "FlightHelmet/glTF/FlightHelmet.gltf"),
    Place("textured/sponza_obj_textured.zip", "sponza/sponza.obj", ((-13.0, 3.0, 1.5), (8.0, 4.5, -1.5), _Y)),
    Place("textured/spot.zip", "spot/spot_triangulated.obj"),
    Place("textured/trimesh_obj_textured.zip", "capsule.obj"),
    Place("textured/trimesh_obj_textured.zip", "fuze.obj"),
    Place("arch/sponza_dabrovic.glb", "", ((-13.0, 3.0, 1.5), (8.0, 4.5, -1.5), _Y)),
    Place("arch/luxcore_kitchen.glb"),
    Place("arch/openarena_ctf_inyard.glb", "", ((-1200.0, 200.0, -200.0), (600.0, 0.0, 100.0), _Y)),
    Place("arch/white_room.glb.gz"),
    Place("arch/country_kitchen.glb.gz"),
)
# sponza.mtl names none of the pictures beside it; their names say whose they are.
_SPONZA = {
    "sp_00_luk_mali": "sp_luk", "sp_00_pod": "KAMEN", "sp_00_prozor": "prozor1",
    "sp_00_vrata_kock": "vrata_ko", "sp_00_vrata_krug": "vrata_kr", "sp_00_zid": "KAMEN",
    "sp_01_stub": "01_STUB", "sp_01_stub_baza": "01_S_ba", "sp_01_stub_kut": "01_STUB",
    "sp_01_stup": "x01_st", "sp_01_stup_baza": "01_St_kp", "sp_02_reljef": "reljef",
    "sp_svod_kapitel": "00_skap",
}  # fmt: skip


def unpacked(place: Place, scenes: Path, folder: Path) -> Path:
    """Path of the scene's file, as any reader can take it; below ``folder`` if it was packed.

    Raises
    ------
    OSError, KeyError, zipfile.BadZipFile
        If it is not there, or is damaged.
    """
    source = scenes / place.file
    if place.member:
        into = folder / source.stem
        with zipfile.ZipFile(source) as archive:
            archive.getinfo(place.member)
            archive.extractall(into)
        for materials in into.rglob("sponza.mtl"):
            materials.write_text(textured(materials.read_text()))
        return into / place.member
    if source.suffix == ".gz":
        path = folder / source.stem
        with gzip.open(source) as packed, open(path, "wb") as plain:
            shutil.copyfileobj(packed, plain)
        return path
    return source


def textured(materials: str) -> str:
    """Sponza's materials, with the pictures that are theirs."""

    def lines() -> Iterator[str]:
        for line in materials.splitlines():
            yield line
            name = line.removeprefix("newmtl ").strip()
            if line.startswith("newmtl ") and name in _SPONZA:
                yield f"map_Kd textures/{_SPONZA[name]}.JPG"

    return "\n".join(lines()) + "\n"


def camera_of(place: Place, scene: Scene, scenes: Path) -> tuple[str, Camera]:
    """The scene's own camera, or ours for it, or the default view; and which it is."""
    beside = scenes / (place.file.partition(".")[0] + ".camera.json")
    if scene.cameras:
        return "own", scene.cameras[0]
    if beside.is_file():
        return "own", named_camera(scene, str(beside))
    if place.eye is not None:
        eye, target, up = place.eye
        return "inside", Camera.look_at(eye, target, up, 60.0)
    return "default", default_camera(scene)


def cornell() -> tuple[Mesh, npt.NDArray[np.int64], tuple[tuple[float, float, float], ...]]:
    """An open box with two blocks: mesh, material of each triangle, colours of the materials."""
    white, red, green = (0.73, 0.73, 0.73), (0.63, 0.065, 0.05), (0.14, 0.45, 0.091)
    walls = [
        ((0, 0, 0), (1, 0, 0), (0, 0, 1), 0), ((0, 1, 0), (0, 0, 1), (1, 0, 0), 0),
        ((0, 0, 0), (0, 1, 0), (1, 0, 0), 0), ((0, 0, 0), (0, 0, 1), (0, 1, 0), 1),
        ((1, 0, 0), (0, 1, 0), (0, 0, 1), 2),
    ]  # fmt: skip
    corners = [(np.array(p), np.array(a), np.array(b), m) for p, a, b, m in walls]
    for middle, half, high, turn in (((0.33, 0.35), 0.15, 0.6, 0.3), ((0.67, 0.65), 0.15, 0.3, -0.3)):
        across = np.array([np.cos(turn), 0.0, -np.sin(turn)]) * 2 * half
        along, up = np.array([np.sin(turn), 0.0, np.cos(turn)]) * 2 * half, np.array([0.0, high, 0.0])
        low = np.array([middle[0], 0.0, middle[1]]) - (across + along) / 2
        sides = [(low, up, across), (low + along, across, up), (low, along, up), (low + across, up, along)]
        corners += [(p, a, b, 0) for p, a, b in [*sides, (low + up, along, across)]]
    vertices = np.array([[p, p + a, p + a + b, p + b] for p, a, b, _ in corners]).reshape(-1, 3)
    quads = 4 * np.arange(len(corners))[:, None]
    faces = (quads[:, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    numbers = np.repeat([m for *_, m in corners], 2)
    return Mesh.from_arrays(vertices.astype(np.float32), faces, "box"), numbers, (white, red, green)
