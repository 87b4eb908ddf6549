"""What scripts/peers measures: scenes, and the mesh, camera, light and rays that everybody is given."""

from __future__ import annotations

import gzip
import json
import os
import struct
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from figure1_scenes import ROWS, SceneError, nature, usable_folder
from six_scenes import camera_of

from clgrid.cache import folder as cache_folder
from clgrid.camera import Camera
from clgrid.errors import InputError
from clgrid.mesh import Mesh
from clgrid.scene import default_camera, load_scene

CHECKOUT = Path(__file__).resolve().parent.parent
Floats = npt.NDArray[np.float32]

_SEED = 12345
# The peers in C++ start shadow rays this share of the longest side before the surface.
_LIFT = np.float32(1e-4)
_LIGHT, _LIGHT_INSIDE = 0.5, 2.0**-4
# Small copies of a scan on a large terrain, as in the table of Figure 1: `nature:N` has about N triangles.
NATURE = "nature"
_NATURES_FEWEST = 100_000


@dataclass(frozen=True)
class Named:
    """A scene of the table: a file of the scenes folder, a built-in one, or ``nature:N``.

    Attributes
    ----------
    source : str
        Path within the folder, or a name with a size.
    frames : str
        Path of the positions of all frames, (K, V, 3) float32; empty for a scene that stands still.
    eye, target, light : tuple of float
        The view, by default that of the file beside the scene, or else of the whole scene; and where the
        light stands.
    up : tuple of float
        Which way is up for ``eye``.
    shuffled : bool
        Whether the order of the triangles is drawn by lot.
    """

    source: str
    frames: str = ""
    eye: tuple[float, float, float] | None = None
    target: tuple[float, float, float] | None = None
    light: tuple[float, float, float] | None = None
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)
    shuffled: bool = False


_Z = (0.0, 0.0, 1.0)
_STADIUM = "arch/bunny_in_stadium.ply"

SCENES = {
    "armadillo": Named("scans/armadillo.obj"),
    "horse": Named("scans/horse.ply"),
    "lucy": Named("scans/lucy_100k.ply"),
    "rangemap": Named("scans/rangemap_face000.ply"),
    "terrain": Named("scans/terrain_st_helens.ply"),
    "dragon": Named("scans/dragon_vrip.ply.gz"),
    "dragon-shuffled": Named("scans/dragon_vrip.ply.gz", shuffled=True),
    "sponza": Named(
        "arch/sponza_dabrovic.glb", eye=(-11.0, 2.5, 0.0), target=(5.0, 5.0, 0.0), light=(2.0, 11.0, 1.0)
    ),
    "kitchen": Named("arch/country_kitchen.glb.gz"),
    "whiteroom": Named("arch/white_room.glb.gz"),
    # From a few steps away the bunny is a dozen pixels wide; then the same file from beside the bunny.
    "stadium": Named(_STADIUM, eye=(-3.0, -4.0, 3.0), target=(0.0, 0.0, 0.08), up=_Z),
    "stadium-bunny": Named(
        _STADIUM, eye=(0.065, -0.11, 0.15), target=(0.01, 0.01, 0.075), light=(0.5, -0.5, 0.8), up=_Z
    ),
    # Where its authors stand and look.
    "luxcore": Named(
        "arch/luxcore_kitchen.glb",
        eye=(7.634103, -4.168197, 1.421921),
        target=(12.037415, 4.713311, 0.106751),
        light=(7.5, -3.0, 2.3),
        up=_Z,
    ),
    "openarena": Named(
        "arch/openarena_ctf_inyard.glb",
        eye=(-1300.0, -330.0, 360.0),
        target=(300.0, 150.0, 180.0),
        light=(-1000.0, -300.0, 900.0),
        up=_Z,
    ),
    "large-terrain": Named("terrain:1340"),
    "large-sphere": Named("icosphere:9"),
    "horse-gallop": Named("dynamic/horse_gallop_frame0.ply", "dynamic/horse_gallop_frames.npy.gz"),
    "elephant-gallop": Named("dynamic/elephant_gallop_frame0.ply", "dynamic/elephant_gallop_frames.npy.gz"),
    NATURE: Named(
        f"{NATURE}:{ROWS['Nature'][0].triangles}", eye=(-10.0, -10.0, 9.0), target=(0.0, 0.0, -1.0), up=_Z
    ),
}
# Nature takes gigabytes of everybody: it is for those who ask for it.
USUAL = tuple(name for name in SCENES if name != NATURE)


@dataclass(frozen=True)
class View:
    """A camera in float32, since some peers know nothing else; ``fov`` is vertical, in degrees."""

    eye: list[float]
    target: list[float]
    up: list[float]
    fov: float
    light: list[float]

    def camera(self) -> Camera:
        """The same as clgrid's."""
        return Camera.look_at(self.eye, self.target, self.up, self.fov)


@dataclass
class Shot:
    """A scene ready for everybody, in memory and as files of ``folder``.

    Attributes
    ----------
    vertices : (V, 3) float32
    faces : (F, 3) uint32
    frames : (K, V, 3) float32
        Positions over time; none for a scene that stands still.
    size : int
        Width and height of the picture.
    """

    name: str
    folder: Path
    vertices: Floats
    faces: npt.NDArray[np.uint32]
    view: View
    size: int
    rays: int
    frames: Floats = field(default_factory=lambda: np.zeros((0, 0, 3), np.float32))

    @property
    def triangles(self) -> int:
        return len(self.faces)

    @property
    def moving(self) -> bool:
        return len(self.frames) > 0

    @property
    def longest_side(self) -> np.float32:
        side: np.float32 = np.max(self.vertices.max(axis=0) - self.vertices.min(axis=0))
        return side

    def save(self) -> None:
        """Write what the peers read."""
        with open(self.folder / "mesh.bin", "wb") as file:
            file.write(b"MSH1" + struct.pack("<II", len(self.vertices), len(self.faces)))
            file.write(np.ascontiguousarray(self.vertices, "<f4").data)
            file.write(np.ascontiguousarray(self.faces, "<u4").data)
        view = self.view
        numbers = [*view.eye, *view.target, *view.up, view.fov, *view.light]
        (self.folder / "mesh.cam").write_text(" ".join(map(repr, numbers)) + "\n")
        (self.folder / "frames.bin").write_bytes(self.frames.astype("<f4").tobytes())
        np.savez(self.folder / "arrays.npz", vertices=self.vertices, faces=self.faces, frames=self.frames)
        facts = {"name": self.name, "size": self.size, "rays": self.rays, "view": asdict(view)}
        (self.folder / "shot.json").write_text(json.dumps(facts))

    @staticmethod
    def load(folder: Path) -> Shot:
        """What ``save`` wrote."""
        facts: dict[str, Any] = json.loads((folder / "shot.json").read_text())
        facts["view"] = View(**facts["view"])
        with np.load(folder / "arrays.npz") as arrays:
            return Shot(folder=folder, **facts, **arrays)

    def camera_rays(self) -> tuple[Floats, Floats]:
        """Origins and directions of all pixels, row by row, each (N, 3)."""
        origins, directions = self.view.camera().rays(self.size, self.size)
        return _float32(origins), _float32(directions)

    def random_rays(self) -> tuple[Floats, Floats]:
        """Rays from anywhere in the bounds to anywhere: those of the peers in C++, number by number."""
        draws = _uniform(5 * self.rays).reshape(-1, 5)
        low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        origins = low + draws[:, :3] * (high - low).astype(np.float64)
        z, angle = 2.0 * draws[:, 3] - 1.0, 2.0 * np.pi * draws[:, 4]
        across = np.sqrt(np.maximum(0.0, 1.0 - z * z))
        return _float32(origins), _float32(np.stack([across * np.cos(angle), across * np.sin(angle), z], 1))

    def shadow_rays(self, t: npt.NDArray[np.float64]) -> tuple[Floats, Floats]:
        """From what the camera's rays hit at ``t``, inf where nothing, to the light, which is at 1."""
        eye, directions = self.camera_rays()
        hit = np.isfinite(t)
        lengths = np.linalg.norm(directions[hit].astype(np.float64), axis=1)
        before = t[hit] - float(_LIFT * self.longest_side) / lengths
        origins = _float32(eye[hit] + before[:, None] * directions[hit])
        return origins, _float32(np.asarray(self.view.light, np.float32) - origins)


def _float32(array: npt.NDArray[Any]) -> Floats:
    return np.ascontiguousarray(array.reshape(-1, 3), np.float32)


def _uniform(count: int) -> npt.NDArray[np.float64]:
    """(N,) in [0, 1): the splitmix64 generator."""
    z = np.uint64(_SEED) + np.arange(1, count + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return ((z ^ (z >> np.uint64(31))) >> np.uint64(40)).astype(np.float64) / 2.0**24


def scenes_folder() -> Path | None:
    """Folder of the scenes, if it is there."""
    return usable_folder(Path(os.environ.get("CLGRID_SCENES") or CHECKOUT.parent / "shared" / "scenes"))


def present(names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Split into those that can be had, and those whose file is missing."""
    folder = scenes_folder()
    missing = [
        name
        for name in names
        if name in SCENES
        and ":" not in SCENES[name].source
        and (folder is None or not (folder / SCENES[name].source).is_file())
    ]
    return [name for name in names if name not in missing], missing


def prepare(name: str, folder: Path, size: int, rays: int) -> Shot:
    """Load a scene of the table, a file, a built-in one or ``nature:N``, and write what the peers read.

    Raises
    ------
    ClgridError
        If the scene cannot be used.
    """
    named, root = _named(name), scenes_folder()
    path, made = named.source, named.source.startswith(f"{NATURE}:")
    if made:
        path = _made_nature(path.removeprefix(f"{NATURE}:"), root)
    elif name in SCENES and ":" not in path and root is not None:
        path = str(root / path)
    scene = load_scene(path)
    vertices = np.ascontiguousarray(scene.mesh.vertices, np.float32)
    faces = scene.mesh.faces
    if not len(faces):
        raise InputError(f"{name}: no triangles; choose another scene")
    if named.shuffled:
        faces = np.ascontiguousarray(np.random.default_rng(_SEED).permutation(faces))
    frames = np.zeros((0, 0, 3), np.float32)
    if named.frames and root is not None:
        with gzip.open(root / named.frames) as file:
            frames = np.ascontiguousarray(np.load(file), np.float32)
        if frames.shape[1:] != vertices.shape:
            raise InputError(f"{name}: frames of shape {frames.shape} do not fit {len(vertices)} vertices")
    if named.eye is not None and named.target is not None:
        camera = Camera.look_at(named.eye, named.target, named.up, fov=60.0)
    elif len(frames):
        box = np.stack([frames.min(axis=(0, 1)), frames.max(axis=(0, 1))])
        camera = default_camera(Mesh(box, np.array([[0, 1, 1]], np.uint32)))
    else:
        camera = camera_of(scene, path, 1.0)
    label = name if name in SCENES or made else scene.name
    shot = Shot(label, folder, vertices, faces, _view(camera, vertices, named.light), size, rays, frames)
    shot.save()
    return shot


def _named(name: str) -> Named:
    """Of the table; ``nature:N`` is seen as Nature is, any other scene by its own camera."""
    if name.startswith(f"{NATURE}:"):
        return replace(SCENES[NATURE], source=name)
    return SCENES.get(name, Named(name))


def _made_nature(triangles: str, root: Path | None) -> str:
    """Path of the uneven scene of about so many triangles; kept where scripts/figure1 keeps its own."""
    if not triangles.isdecimal() or int(triangles) < _NATURES_FEWEST:
        raise InputError(f"{NATURE}:{triangles}: give a number of triangles, at least {_NATURES_FEWEST}")
    try:
        return nature(int(triangles), root).make(root, cache_folder() / "figure1").argument
    except SceneError as error:
        raise InputError(f"{NATURE}: {error}") from None


def _view(camera: Camera, vertices: Floats, light_at: tuple[float, float, float] | None) -> View:
    """The camera with numbers that all peers can hold, and a light that suits it.

    Unless it is given, the light stands beyond the highest corner; for an eye within the bounds, near the
    eye, or the walls would shut it out.
    """
    low, high = (corner.astype(np.float64) for corner in (vertices.min(axis=0), vertices.max(axis=0)))
    side = float((high - low).max())
    # As far away as the scene: next to the eye, rounding would turn the view.
    target = camera.eye + camera.forward * float(np.linalg.norm(camera.eye - (low + high) / 2.0) + side)
    light = high + _LIGHT * side
    if (camera.eye > low).all() and (camera.eye < high).all():
        light = camera.eye + _LIGHT_INSIDE * side * np.sqrt(0.5) * (camera.right + camera.up)
    if light_at is not None:
        light = np.asarray(light_at, np.float64)
    rounded = [[float(np.float32(x)) for x in each] for each in (camera.eye, target, camera.up, light)]
    return View(rounded[0], rounded[1], rounded[2], float(np.float32(camera.fov)), rounded[3])
