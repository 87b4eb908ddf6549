"""Mitsuba 3's answers: pieces in, what rays meet and how they are lit out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from second_opinion_compare import F64, View
from second_opinion_pieces import Piece, unit

from clgrid.camera import Camera
from clgrid.errors import InputError

_TRIANGLE, _PICTURED = "face_triangle", "face_pictured"


def load() -> Any:
    """The module, in the one variant that needs no LLVM: rays go one by one, pictures on all threads.

    Raises
    ------
    ImportError
        If it is not installed.
    """
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    mi.set_log_level(mi.LogLevel.Error)  # it warns of normals that it makes before it gets ours
    return mi


class Second:
    """A scene in Mitsuba."""

    def __init__(self, mi: Any, pieces: Sequence[Piece], *, smooth: bool = True) -> None:
        self.mi = mi
        self.pieces = pieces
        self.shapes = [_shape(mi, piece, smooth=smooth) for piece in pieces]
        self.scene = mi.load_dict({"type": "scene", **{f"shape{k}": s for k, s in enumerate(self.shapes)}})

    def look(self, origins: F64, directions: F64) -> View:
        """What (H, W, 3) rays meet; depth is in units of their directions."""
        shape = origins.shape[:2]
        along = directions.reshape(-1, 3)
        met = [self._meet(*ray) for ray in zip(origins.reshape(-1, 3).tolist(), along.tolist(), strict=True)]
        t, triangle, face, normal, uv, albedo = (
            np.array(part, np.float64) for part in zip(*met, strict=True)
        )
        face *= np.where((face * along).sum(-1, keepdims=True) > 0.0, -1.0, 1.0)
        normal *= np.where((face * normal).sum(-1, keepdims=True) < 0.0, -1.0, 1.0)
        return View(
            depth=t.reshape(shape),
            normal=unit(normal).reshape(*shape, 3),
            uv=uv.reshape(*shape, 2),
            albedo=albedo.reshape(*shape, 3),
            triangle=np.rint(triangle).astype(np.int64).reshape(shape),
        )

    def _meet(self, origin: list[float], direction: list[float]) -> tuple[Any, ...]:
        """Depth, triangle, normals of triangle and vertices, coordinates, albedo."""
        si = self.scene.ray_intersect(self.mi.Ray3f(origin, direction))
        if not si.is_valid():
            return np.inf, -1, (0.0,) * 3, (0.0,) * 3, (np.nan,) * 2, (0.0,) * 3
        number = si.shape.eval_attribute_1(_TRIANGLE, si)
        uv = tuple(si.uv) if si.shape.eval_attribute_1(_PICTURED, si) else (np.nan,) * 2
        albedo = tuple(si.bsdf().eval_diffuse_reflectance(si))
        return si.t, number, tuple(si.n), tuple(si.sh_frame.n), uv, albedo

    def lit(
        self, camera: Camera, size: tuple[int, int], sun: F64, lux: float, sky: F64, samples: int, seed: int
    ) -> F64:
        """(H, W, 3): the picture by direct light alone, box filter, independent samples."""
        mi = self.mi
        scene = mi.load_dict(
            {
                "type": "scene",
                "sun": {"type": "directional", "direction": (-sun).tolist(), "irradiance": _rgb([lux] * 3)},
                "sky": {"type": "constant", "radiance": _rgb(sky)},
                "sensor": sensor(mi, camera, size),
                # one of each: Mitsuba 3.9.1 makes a sun as many times as bright as it has emitter_samples
                "integrator": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 1},
                **{f"shape{k}": shape for k, shape in enumerate(self.shapes)},
            }
        )
        return np.asarray(np.array(mi.render(scene, spp=samples, seed=seed)), np.float64)[..., :3]


def sensor(mi: Any, camera: Camera, size: tuple[int, int]) -> dict[str, Any]:
    """The same camera: Mitsuba looks along +z, and its x points to the left of the picture."""
    if camera.orthographic_height is not None or camera.fov_axis == "smaller":
        raise InputError("second_opinion: lit pictures want a perspective camera with its fov by x or y")
    matrix = np.eye(4)
    matrix[:3, :4] = np.stack([-camera.right, camera.up, camera.forward, camera.eye], 1)
    return {
        "type": "perspective",
        "to_world": mi.ScalarTransform4f(matrix),
        "fov": camera.fov,
        "fov_axis": camera.fov_axis,
        "film": {
            "type": "hdrfilm",
            "width": size[0],
            "height": size[1],
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
        },
        "sampler": {"type": "independent"},
    }


def pieces_by_mitsuba(mi: Any, path: Path, like: Piece) -> list[Piece]:
    """Positions, normals and coordinates as Mitsuba's own OBJ reader gives them, and the look of ``like``.

    It takes a file for one material: albedos of those with more mean nothing. Normals that the file does not
    have it makes itself; ``like`` says whether it has them.
    """
    read = mi.traverse(mi.load_dict({"type": "obj", "filename": str(path)}))
    rows = {name: np.array(read[name]) for name in ("vertex_positions", "vertex_normals", "vertex_texcoords")}
    faces = np.array(read["faces"], np.uint32).reshape(-1, 3)
    normals, uvs = rows["vertex_normals"].reshape(-1, 3), rows["vertex_texcoords"].reshape(-1, 2)
    return [
        Piece(
            vertices=rows["vertex_positions"].reshape(-1, 3),
            faces=faces,
            triangles=np.full(len(faces), -1),
            normals=None if like.normals is None else unit(normals).astype(np.float32),
            uvs=uvs if len(uvs) else None,
            picture=like.picture,
            colour=like.colour,
        )
    ]


def _shape(mi: Any, piece: Piece, *, smooth: bool) -> Any:
    """The piece as a mesh in Mitsuba, lit from both sides."""
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(
        {"type": "twosided", "side": {"type": "diffuse", "reflectance": _reflectance(mi, piece)}}
    )
    normals = piece.normals if smooth else None
    properties["face_normals"] = normals is None
    shape = mi.Mesh(
        "piece",
        len(piece.vertices),
        len(piece.faces),
        has_vertex_normals=normals is not None,
        has_vertex_texcoords=piece.uvs is not None,
        props=properties,
    )
    rows = mi.traverse(shape)
    rows["vertex_positions"] = np.ravel(piece.vertices)
    rows["faces"] = np.ravel(piece.faces)
    if piece.uvs is not None:
        rows["vertex_texcoords"] = np.ravel(piece.uvs)
    rows.update()
    if normals is not None:  # after the positions, of which it makes normals of its own
        rows["vertex_normals"] = np.ravel(normals)
        rows.update()
    shape.add_attribute(_TRIANGLE, 1, piece.triangles.astype(np.float32))
    shape.add_attribute(_PICTURED, 1, np.full(len(piece.faces), piece.picture is not None, np.float32))
    return shape


def _reflectance(mi: Any, piece: Piece) -> dict[str, Any]:
    if piece.picture is None:
        return _rgb(piece.colour)
    bitmap: Any = mi.Bitmap(piece.picture.pixels.copy(), mi.Bitmap.PixelFormat.RGB)
    raw = piece.colour != (1.0, 1.0, 1.0)
    if raw:  # Mitsuba has no product of textures
        linear = bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=False)
        scaled = np.array(linear) * np.asarray(piece.colour, np.float32)
        bitmap = mi.Bitmap(scaled, mi.Bitmap.PixelFormat.RGB)
    return {
        "type": "bitmap",
        "bitmap": bitmap,
        "raw": raw,
        "filter_type": "bilinear" if piece.picture.smooth else "nearest",
        "wrap_mode": piece.picture.wrap,
    }


def _rgb(colour: npt.ArrayLike) -> dict[str, Any]:
    return {"type": "rgb", "value": np.asarray(colour, np.float64).tolist()}
