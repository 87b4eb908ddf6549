"""The eleven scenes: stand-ins of about the paper's triangle counts, made once and kept in a cache folder."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

from figure1_child import last_words, run_clgrid
from figure1_files import beside
from figure1_nature import SEED, write_scattered


class SceneError(Exception):
    """A scene that cannot be made; one line."""


@dataclass(frozen=True)
class Ready:
    """A scene that ``clgrid bench`` can be given.

    Attributes
    ----------
    argument : str
        Absolute path or built-in name.
    label : str
        What it is, without its folder.
    mesh_bytes : int
        Of the host arrays.
    """

    argument: str
    label: str
    triangles: int
    mesh_bytes: int


@dataclass(frozen=True)
class BuiltIn:
    """``icosphere:N`` or ``terrain:N``, made by clgrid itself."""

    name: str

    @property
    def label(self) -> str:
        return self.name

    @property
    def triangles(self) -> int:
        return self._counts()[0]

    def _counts(self) -> tuple[int, int]:
        base, _, number = self.name.partition(":")
        n = int(number)
        return (20 * 4**n, 10 * 4**n + 2) if base == "icosphere" else (2 * n * n, (n + 1) ** 2)

    def make(self, scenes: Path | None, cache: Path) -> Ready:
        triangles, vertices = self._counts()
        return Ready(self.name, self.label, triangles, _mesh_bytes(triangles, vertices))


@dataclass(frozen=True)
class Subdivided:
    """A mesh of the scenes folder, its triangles split in four ``levels`` times by ``subdivide.py``.

    At level 0 it is the file itself. ``triangles`` is what is known beforehand; the file has the last word.
    """

    source: str
    levels: int
    triangles: int

    @property
    def label(self) -> str:
        times = ("", ", split once", ", split twice", ", split three times", ", split four times")
        return Path(self.source).name + times[self.levels]

    def make(self, scenes: Path | None, cache: Path) -> Ready:
        script, source = _require(scenes, "subdivide.py"), _require(scenes, self.source)
        if not self.levels:
            return _as_it_is(source, self.label)
        recipe = _digest(_sha(script), source.stat().st_size, self.levels)
        path = cache / f"{Path(self.source).name.split('.')[0]}-{self.levels}-{recipe}.ply"
        if not path.is_file():
            with beside(path) as fresh:
                _run_subdivide([str(script), str(source), str(self.levels), str(fresh)])
        return _ready(path, self.label)


@dataclass(frozen=True)
class Scattered:
    """Small copies of one mesh over a terrain; ``source`` is a file of the scenes folder or a built-in."""

    source: str
    side: int
    triangles: int

    @property
    def label(self) -> str:
        return f"small copies of {Path(self.source).name} over terrain:{self.side}"

    def make(self, scenes: Path | None, cache: Path) -> Ready:
        built_in = ":" in self.source
        source = self.source if built_in else _require(scenes, self.source)
        facts = (self.source if built_in else Path(source).stat().st_size, self.side, self.triangles, SEED)
        path = cache / f"nature-{_digest(*facts, _sha(Path(__file__).with_name('figure1_nature.py')))}.ply"
        if not path.is_file():
            from clgrid import procedural
            from clgrid.scene import load_scene

            copy, ground = load_scene(source).mesh, procedural.terrain(self.side)
            with beside(path) as fresh:
                write_scattered(
                    fresh,
                    (copy.vertices, copy.faces),
                    (ground.vertices, ground.faces),
                    side=self.side,
                    triangles=self.triangles,
                )
        return _ready(path, self.label)


StandIn = BuiltIn | Subdivided | Scattered

# Name: the stand-in of the scenes folder, and the one that needs no folder.
ROWS: dict[str, tuple[StandIn, StandIn]] = {
    "Armadillo": (Subdivided("scans/armadillo.obj", 1, 345_928), BuiltIn("icosphere:7")),
    "Atrium": (Subdivided("arch/white_room.glb.gz", 0, 414_841), BuiltIn("terrain:529")),
    "Dragon": (Subdivided("scans/dragon_vrip.ply.gz", 0, 871_414), BuiltIn("terrain:660")),
    "Conference": (Subdivided("arch/country_kitchen.glb.gz", 0, 1_021_815), BuiltIn("terrain:703")),
    "Buddha": (Subdivided("scans/bunny_zipper.ply", 2, 1_111_216), BuiltIn("icosphere:8")),
    "Cruiser": (Subdivided("scans/dragon_vrip.ply.gz", 1, 3_485_224), BuiltIn("terrain:1349")),
    "Asian Dragon": (Subdivided("scans/flybrain_banc.ply", 3, 7_768_064), BuiltIn("terrain:1900")),
    "Thai Statue": (Subdivided("scans/rangemap_face000.ply", 3, 10_640_576), BuiltIn("terrain:2236")),
    "Lucy": (Subdivided("scans/lucy_100k.ply", 4, 25_592_320), BuiltIn("terrain:3748")),
    "Nature": (
        Scattered("scans/dragon_vrip_res4.ply.gz", 1024, 41_400_000),
        Scattered("icosphere:5", 1024, 41_400_000),
    ),
    # terrain ends at 4096, short of the paper's 56.2 M triangles.
    "David": (Subdivided("scans/dragon_vrip.ply.gz", 3, 55_770_496), BuiltIn("terrain:4096")),
}


def stand_in(row: str, scenes: Path | None) -> StandIn:
    """Return the stand-in of ``row``: of the folder, or without one."""
    return ROWS[row][0 if scenes is not None else 1]


def nature(triangles: int, scenes: Path | None) -> Scattered:
    """Return the uneven scene in any size: its terrain keeps its share of the triangles."""
    whole = stand_in("Nature", scenes)
    assert isinstance(whole, Scattered)
    side = max(1, round(whole.side * (triangles / whole.triangles) ** 0.5))
    return replace(whole, side=side, triangles=triangles)


def usable_folder(folder: Path) -> Path | None:
    """Return ``folder``, or ``scenes`` in it, where the script that splits scenes is; else None."""
    return next((place for place in (folder, folder / "scenes") if (place / "subdivide.py").is_file()), None)


def _require(scenes: Path | None, name: str) -> Path:
    if scenes is None or not (scenes / name).is_file():
        raise SceneError(f"{name} is not in the scenes folder")
    return (scenes / name).resolve()


def _run_subdivide(arguments: list[str]) -> None:
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True)
    if done.returncode:
        raise SceneError(f"subdivide.py: {last_words(done)}")


def _as_it_is(path: Path, label: str) -> Ready:
    done = run_clgrid(["info", str(path), "--json"])
    if done.returncode:
        raise SceneError(last_words(done).replace(str(path), path.name))
    known = json.loads(done.stdout)
    return Ready(str(path), label, int(known["triangles"]), int(known["mesh_bytes"]))


def _ready(path: Path, label: str) -> Ready:
    counts = _ply_counts(path)
    return Ready(str(path), label, counts["face"], _mesh_bytes(counts["face"], counts["vertex"]))


def _mesh_bytes(triangles: int, vertices: int) -> int:
    """Three uint32 a triangle, three float32 a vertex."""
    return 12 * (triangles + vertices)


def _ply_counts(path: Path) -> dict[str, int]:
    """Elements that the header of a PLY file announces."""
    counts: dict[str, int] = {}
    with open(path, "rb") as file:
        for line in iter(file.readline, b""):
            words = line.split()
            if words == [b"end_header"]:
                break
            if len(words) == 3 and words[0] == b"element":
                counts[words[1].decode("ascii")] = int(words[2])
    if not {"vertex", "face"} <= set(counts):
        raise SceneError(f"{path.name}: no vertices or faces in its header; delete it and run again")
    return counts


def _sha(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _digest(*facts: object) -> str:
    return hashlib.sha256(repr(facts).encode()).hexdigest()[:8]
