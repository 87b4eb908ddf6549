"""The whole public surface as a caller types it: test_surface.py checks it with mypy, strict, and runs it."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import numpy.typing as npt

import clgrid
from clgrid.animation import Frames
from clgrid.look import Look


def use(folder: Path, device: str) -> None:
    """Everything once."""
    vertices: npt.NDArray[np.float32] = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    mesh: clgrid.Mesh = clgrid.Mesh(vertices, np.array([[0, 1, 2]], np.uint32))
    mesh = clgrid.Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    scene: clgrid.Scene = clgrid.load_scene("icosphere:3")
    camera: clgrid.Camera = clgrid.Camera.look_at((0, 0, 4), (0, 0, 0))
    flat = clgrid.Camera.look_at((0, 0, 4), (0, 0, 0), orthographic_height=2.5)
    look: Look | None = scene.look
    frames: Frames | None = scene.frames
    cameras: tuple[clgrid.Camera, ...] = scene.cameras
    assert (look, frames, cameras) == (None, None, ())
    np.save(folder / "frames.npy", np.stack([scene.mesh.vertices] * 2))
    moving = clgrid.load_scene("icosphere:3", folder / "frames.npy", fps=12.0).frames
    assert moving is not None
    assert moving.count == 2
    still: clgrid.Scene = moving.scene(1)
    assert still.mesh.triangle_count == len(moving.vertices(1)) * 2 - 4
    mesh = scene.mesh
    grid: clgrid.Grid = clgrid.build(mesh, "compact", "auto", device=device, view=camera)
    nbytes: dict[str, int] = clgrid.predict(mesh, density=2.0, device=device)
    assert sum(nbytes.values()) > 0
    for view in (camera, flat):
        origins, directions = view.rays(8, 6)
        hits: clgrid.Hits = grid.cast(origins, directions, t_min=0.0, t_max=np.inf)
        t: npt.NDArray[np.float64] = hits.t_hit
        ids: npt.NDArray[np.int64] = hits.primitive_ids
        assert t.shape == ids.shape == (6, 8) == hits.mask.shape
        assert hits["t_hit"] is t
        assert hits.points.dtype == np.float64
        occluded: npt.NDArray[np.bool_] = grid.occluded(origins, directions)
        counts: npt.NDArray[np.uint32] = grid.count(origins, directions)
        every: clgrid.AllHits = grid.cast_all(origins, directions)
        assert int(counts.sum()) == len(every.t_hit)
        assert every.points.shape == every.primitive_normals.shape == (len(every.geometry_ids), 3)
        assert bool((occluded == hits.mask).all())
        oracle: clgrid.Hits = clgrid.brute_force(mesh, origins, directions, device=device)
        assert np.array_equal(oracle.t_hit, t)
    inside: npt.NDArray[np.bool_] = clgrid.build(mesh, accuracy="exact", device=device).contains([[0, 0, 0]])
    assert inside.tolist() == [True]
    framed: clgrid.Camera = clgrid.default_camera(mesh, 16 / 12)
    seconds: float = clgrid.warm_up(device, ("depth",), density=1.0)
    assert framed.fov == clgrid.default_camera(scene).fov
    assert seconds >= 0
    image: clgrid.Image = clgrid.render(scene, camera, 16, 12, ("depth",), grid=grid)
    image.save(folder / "picture.exr")
    assert clgrid.read_image(folder / "picture.exr").width == 16
    grid.save(folder / "grid.clgrid")
    with clgrid.open_grid(folder / "grid.clgrid", device=device) as opened:
        assert opened.nbytes == grid.nbytes
    copy: clgrid.Grid = pickle.loads(pickle.dumps(grid))
    assert copy.layout == grid.layout
    grid.update(2 * mesh.vertices)
    assert grid.stats.triangles == mesh.triangle_count
    theirs = clgrid.open3d.RaycastingScene(device=device)
    number: int = theirs.add_triangles(mesh)
    rays = np.concatenate(camera.rays(4, 4), axis=-1)
    found = theirs.cast_rays(rays)
    assert number == 0
    assert set(found) >= {"t_hit", "geometry_ids", "primitive_ids"}
    names = [description.label for description in clgrid.devices()]
    assert device in names
    try:
        grid.cast([[0, 0]], [[0, 0, 1]])
    except clgrid.ClgridError:
        return grid.release()
    raise AssertionError("two numbers are no origin")
