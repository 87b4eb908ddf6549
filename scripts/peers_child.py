"""A library in a process of its own, for scripts/peers: takes commands by lines of JSON, answers by lines.

{"do": "open", "folder": ..}      read a scene, warm up       {"do": "turn", "reps": N}   measure once
{"do": "answers", "to": FILE}     hits of all rays as arrays  {"do": "moving"}            a pass of frames
"""

from __future__ import annotations

import argparse
import gc
import importlib.metadata
import json
import os
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from peers_clock import Timings, repeat
from peers_scenes import Shot

Arrays = dict[str, npt.NDArray[Any]]
Rays = tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]
NONE = -1


class Peer(ABC):
    """A library. ``build`` and ``cast`` take arrays and are timed; arrays are made beforehand."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options

    @abstractmethod
    def facts(self) -> dict[str, Any]:
        """What it is, for the record."""

    def open(self, shot: Shot) -> dict[str, Any]:
        """Take a scene, and do everything once without a clock."""
        self.shot = shot
        self.camera_rays, self.random_rays = shot.camera_rays(), shot.random_rays()
        self.turn(0)
        return {}

    @abstractmethod
    def build(self) -> None:
        """Build from the arrays of the shot."""

    @abstractmethod
    def drop(self) -> None:
        """Release what ``build`` made."""

    @abstractmethod
    def cast(self, rays: Rays) -> object:
        """The nearest hit of each ray, as arrays."""

    @abstractmethod
    def hits(self, rays: Rays) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        """Triangle ids, -1 for a miss, and t, inf for a miss."""

    def turn(self, reps: int) -> dict[str, Any]:
        """Measure once."""
        timings = Timings()
        self.measure(timings, reps)
        return {"s": timings.summary(), "raw": timings.raw()}

    def measure(self, timings: Timings, reps: int) -> None:
        """Build and cast, arrays in, arrays out."""

        def once() -> None:
            self.drop()
            gc.collect()
            timings.time("build", self.build)
            timings.time("camera_cast", lambda: self.cast(self.camera_rays))

        repeat(timings, reps, ("build", "camera_cast"), once)
        repeat(timings, min(reps, 1), ("random",), self._random(timings))

    def _random(self, timings: Timings) -> Callable[[], object]:
        return lambda: timings.time("random", lambda: self.cast(self.random_rays))

    def answers(self) -> Arrays:
        """Hits of all rays."""
        camera, random = self.hits(self.camera_rays), self.hits(self.random_rays)
        return dict(
            zip(("camera_ids", "camera_t", "random_ids", "random_t"), (*camera, *random), strict=True)
        )


class Clgrid(Peer):
    """The package itself, on one device."""

    def __init__(self, options: argparse.Namespace) -> None:
        super().__init__(options)
        from clgrid.device import choose

        self.device = choose(options.device)
        self.grid: Any = None
        self.image: Any = None
        self.shadows: Rays | None = None

    def facts(self) -> dict[str, Any]:
        import clgrid

        device = self.device
        facts = {"version": clgrid.__version__, "device": device.label, "driver": device.driver_version}
        return {**facts, "name": device.name, "platform": device.platform}

    def open(self, shot: Shot) -> dict[str, Any]:
        self.shadows = None
        super().open(shot)
        t = self.hits(self.camera_rays)[1]
        self.shadows = shot.shadow_rays(t)
        occluded = self.occluded() if len(self.shadows[0]) else np.zeros(0, bool)
        hits = self.image.hits
        # The grid of the picture, and what random rays have it become.
        self.build()
        chosen = self._stands()
        random = self.hits(self.random_rays)[0]
        return {
            "hits": hits,
            "shadow_rays": len(self.shadows[0]),
            "occluded": int(np.count_nonzero(occluded)),
            "random_hits": int(np.count_nonzero(random != NONE)),
            **chosen,
            **{f"adapted_{name}": value for name, value in self._stands().items()},
        }

    def _stands(self) -> dict[str, Any]:
        grid = self.grid
        return {"bytes": grid.nbytes, "layout": grid.layout, "density": grid.stats.density}

    def build(self) -> None:
        import clgrid
        from clgrid.mesh import Mesh

        options = self.options
        density = options.density if options.density == "auto" else float(options.density)
        # A mesh keeps what it learned of itself: each build starts from bare arrays, checks included.
        mesh = Mesh(self.shot.vertices, self.shot.faces)
        self.grid = clgrid.build(
            mesh,
            layout=options.layout,
            density=density,
            accuracy="robust",
            device=self.device,
            skipping="auto" if options.skipping == "auto" else options.skipping == "on",
            rays=self.shot.size**2,
            view=self.shot.view.camera(),
            adapt=options.adapt == "on",
        )

    def drop(self) -> None:
        self.grid = self.image = None

    def render(self) -> None:
        import clgrid

        size, grid = self.shot.size, self.grid
        self.image = clgrid.render(grid.mesh, self.shot.view.camera(), size, size, grid=grid)

    def cast(self, rays: Rays) -> object:
        return self.grid.cast(*rays, fields=())

    def occluded(self) -> npt.NDArray[np.bool_]:
        assert self.shadows is not None
        found: npt.NDArray[np.bool_] = self.grid.occluded(*self.shadows, t_max=1.0)
        return found

    def hits(self, rays: Rays) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        found = self.grid.cast(*rays, fields=())
        return found.primitive_ids, found.t_hit

    def measure(self, timings: Timings, reps: int) -> None:
        def once() -> None:
            self.drop()
            gc.collect()
            timings.time("build", self.build)
            timings.time("primary", self.render)

        repeat(timings, reps, ("build", "primary"), once)
        repeat(timings, reps, ("camera_cast",), lambda: timings.time("camera_cast", self._cast_camera))
        repeat(timings, min(reps, 1), ("random",), self._random(timings))
        if self.shadows is not None and len(self.shadows[0]):
            repeat(timings, reps, ("shadow",), lambda: timings.time("shadow", self.occluded))

    def _cast_camera(self) -> object:
        return self.cast(self.camera_rays)

    def moving(self) -> dict[str, Any]:
        """One pass: each frame is built from host positions, and drawn."""
        timings, hits = Timings(), []
        for frame in self.shot.frames:
            timings.time("build", lambda frame=frame: self.grid.update(frame))  # type: ignore[misc]
            timings.time("primary", self.render)
            hits.append(self.image.hits)
        triangles = self.shot.triangles
        return {
            "s": timings.summary(),
            "raw": timings.raw(),
            "hits": hits,
            "bytes": self.grid.nbytes / triangles,
        }


class Embreex(Peer):
    """Embree from Python; its builder cannot be chosen, and it casts on one thread."""

    def facts(self) -> dict[str, Any]:
        return {"version": importlib.metadata.version("embreex")}

    def build(self) -> None:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh

        self.scene = rtcore_scene.EmbreeScene()
        TriangleMesh(self.scene, self.shot.vertices, self.shot.faces.view(np.int32))
        # The scene is committed at the first query; one ray makes it the build's.
        self.scene.run(self.camera_rays[0][:1], self.camera_rays[1][:1])

    def drop(self) -> None:
        self.scene = None

    def cast(self, rays: Rays) -> object:
        return self.scene.run(*rays)

    def hits(self, rays: Rays) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        found = self.scene.run(*rays, output=True)
        return found["primID"].astype(np.int64), np.where(found["primID"] < 0, np.inf, found["tfar"])


class Open3D(Peer):
    """RaycastingScene of Open3D, which is Embree too."""

    scene: Any

    def facts(self) -> dict[str, Any]:
        import open3d

        return {"version": open3d.__version__}

    def open(self, shot: Shot) -> dict[str, Any]:
        import open3d

        self.tensor: Any = open3d.core.Tensor
        self.scene_class: Any = open3d.t.geometry.RaycastingScene
        return super().open(shot)

    def build(self) -> None:
        self.scene = self.scene_class(nthreads=self.options.threads)
        self.scene.add_triangles(self.tensor(self.shot.vertices), self.tensor(self.shot.faces))
        self.cast((self.camera_rays[0][:1], self.camera_rays[1][:1]))

    def drop(self) -> None:
        self.scene = None

    def cast(self, rays: Rays) -> dict[str, npt.NDArray[Any]]:
        both = self.tensor.from_numpy(np.concatenate(rays, axis=1))
        found = self.scene.cast_rays(both, nthreads=self.options.threads)
        return {name: found[name].numpy() for name in ("t_hit", "primitive_ids")}

    def hits(self, rays: Rays) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        found = self.cast(rays)
        missed = np.isinf(found["t_hit"])
        return np.where(missed, NONE, found["primitive_ids"].astype(np.int64)), found["t_hit"]


class Trimesh(Peer):
    """trimesh over embreex, or over rtree: then of a small sample of the rays, and extrapolated."""

    def facts(self) -> dict[str, Any]:
        versions = {"version": importlib.metadata.version("trimesh")}
        if self.options.library == "trimesh-rtree":
            return {**versions, "rtree": importlib.metadata.version("rtree")}
        return {**versions, "embreex": importlib.metadata.version("embreex")}

    def build(self) -> None:
        import trimesh

        mesh = trimesh.Trimesh(self.shot.vertices, self.shot.faces, process=False)
        if self.options.library == "trimesh-rtree":
            from trimesh.ray.ray_triangle import RayMeshIntersector
        else:
            from trimesh.ray.ray_pyembree import RayMeshIntersector
        self.intersector: Any = RayMeshIntersector(mesh)
        self.intersector.intersects_first(self.camera_rays[0][:1], self.camera_rays[1][:1])

    def drop(self) -> None:
        self.intersector = None

    def cast(self, rays: Rays) -> npt.NDArray[Any]:
        found: npt.NDArray[Any] = self.intersector.intersects_first(*rays)
        return found

    def hits(self, rays: Rays) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        ids = self.cast(rays)
        return ids, np.where(ids < 0, np.inf, np.nan)

    def open(self, shot: Shot) -> dict[str, Any]:
        if self.options.library != "trimesh-rtree":
            return super().open(shot)
        self.shot = shot
        self.camera_rays, self.random_rays = shot.camera_rays(), shot.random_rays()
        return {}

    def measure(self, timings: Timings, reps: int) -> None:
        if self.options.library != "trimesh-rtree":
            super().measure(timings, reps)
            return
        timings.time("build", self.build)
        for name, rays in (("camera_cast", self.camera_rays), ("random", self.random_rays)):
            step = max(1, len(rays[0]) // self.options.sample)
            some = rays[0][step // 2 :: step], rays[1][step // 2 :: step]
            taken = Timings()
            taken.time(name, lambda some=some: self.cast(some))  # type: ignore[misc]
            timings.note(name, taken.value(name) * len(rays[0]) / len(some[0]))


LIBRARIES: dict[str, type[Peer]] = {
    "clgrid": Clgrid,
    "embreex": Embreex,
    "open3d": Open3D,
    "trimesh-embreex": Trimesh,
    "trimesh-rtree": Trimesh,
}


def answer(peer: Peer, command: dict[str, Any]) -> dict[str, Any]:
    """Do what a line asks for."""
    match command["do"]:
        case "facts":
            return peer.facts()
        case "open":
            return peer.open(Shot.load(Path(command["folder"])))
        case "turn":
            return peer.turn(command["reps"])
        case "answers":
            np.savez(command["to"], **peer.answers())  # type: ignore[arg-type]
            return {}
        case "moving" if isinstance(peer, Clgrid):
            return peer.moving()
    raise ValueError(f"no such command: {command['do']}")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("library", choices=LIBRARIES)
    parser.add_argument("--device")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--layout", default="auto")
    parser.add_argument("--density", default="auto")
    parser.add_argument("--skipping", default="auto")
    parser.add_argument("--adapt", default="on")
    parser.add_argument("--sample", type=int, default=128)
    options = parser.parse_args()
    # Libraries write to stdout as they like: answers have it for themselves.
    replies = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    peer: Peer | None = None
    for line in sys.stdin:
        try:
            peer = peer or LIBRARIES[options.library](options)
            reply = answer(peer, json.loads(line))
        except Exception as error:  # whatever a library or a scene provokes is said in its cell
            reply = {"error": f"{type(error).__name__}: {' '.join(str(error).split())}"}
        print(json.dumps(reply), file=replies, flush=True)


if __name__ == "__main__":
    main()
