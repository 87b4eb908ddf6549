"""Keyframed nodes, morph targets, cameras and lights of glTF files as frames."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from clgrid.animation import MAX_FRAMES, Frames, even_times
from clgrid.errors import InputError
from clgrid.mesh import FloatArray
from clgrid.meshfile import file_format, named_errors, one_line
from clgrid.meshfile.content import content
from clgrid.meshfile.gltf import place_points
from clgrid.meshfile.gltf_animation import Track, posed, tracks_of
from clgrid.meshfile.gltf_cameras import cameras_of
from clgrid.meshfile.gltf_draws import Draw, Drawn, draw_file, redrawn
from clgrid.meshfile.gltf_nodes import Placed, placed_nodes
from clgrid.meshfile.gltf_schema import Animation

if TYPE_CHECKING:
    from clgrid.camera import Camera
    from clgrid.look import Look
    from clgrid.scene import Scene


def node_frames(scene: Scene, path: Path, fps: float, wanted: str | int | None) -> Frames | None:
    """The frames of an animation in a glTF file, by name or number, by default the first; None without one.

    The animation begins at its time 0 and ends with its last keyframe.

    Raises
    ------
    MeshError
        If the animation is malformed.
    InputError
        If there is no such animation, or it has more frames than `MAX_FRAMES`.
    """
    with named_errors(path):
        drawn = None
        if file_format(path) in (".gltf", ".glb"):
            drawn = draw_file(content(path), path)
    if drawn is None:
        if wanted is None:
            return None
        raise InputError(f"animation {wanted!r}: {path} is no glTF file and has none")
    stops = [row.vertices.stop for row in drawn.rows()]
    if scene.mesh.triangle_count and max(stops, default=0) != len(scene.mesh.vertices):
        raise InputError(f"{path}: holds another mesh than when it was loaded; load it again")
    animations = drawn.document.gltf.animations
    if not animations and wanted is None:
        return None
    chosen = _chosen(animations, wanted, path)
    with named_errors(path):
        tracks, warnings = tracks_of(drawn.document.gltf, chosen, drawn.accessors)
    if not tracks:
        return None
    if len(animations) > 1 and wanted is None:
        names = ", ".join(repr(each.name) for each in animations[:8])
        warnings += (f"holds {len(animations)} animations ({names}), of which the first is shown",)
    seconds = max(float(track.times[-1]) for track in tracks)
    # the last keyframe is a frame, whatever rounding did to the product
    count = seconds * fps * (1 + 1e-12) + 1e-9
    if count >= MAX_FRAMES:
        raise InputError(f"{path}: {seconds:g} s at {fps:g} fps are too many frames; give a lower fps")
    found = NodeFrames(scene, drawn, tracks, int(max(count, 0)) + 1, fps)
    found.warnings = tuple(one_line(f"{path}: {warning}") for warning in warnings)
    return found


def _chosen(animations: list[Animation], wanted: str | int | None, path: Path) -> Animation:
    number = 0 if wanted is None else wanted
    if isinstance(number, str):
        matches = [k for k, each in enumerate(animations) if each.name == number]
        number = matches[0] if matches else int(number) if number.isdecimal() else -1
    if not 0 <= number < len(animations):
        names = ", ".join(f"{k} {each.name!r}" for k, each in enumerate(animations)) or "none"
        raise InputError(f"animation {wanted!r}: not in {path}, which has {names}")
    return animations[number]


class NodeFrames(Frames):
    """Frames of an animation; what no keyframe moves has the very positions of the scene's mesh."""

    def __init__(self, base: Scene, drawn: Drawn, tracks: list[Track], count: int, fps: float) -> None:
        path = drawn.document.path
        super().__init__(base, str(path), even_times(count, fps))
        self._drawn = drawn
        self._tracks = tracks
        self.mesh_moves = _reaches(drawn, tracks)
        seen = [placed.number for placed in drawn.placed if placed.node.camera is not None]
        self.cameras_move = bool(seen) and any(
            not np.array_equal(a.world, b.world)
            for k in {0, count // 3, count // 2, count - 1}
            for a, b in zip(drawn.placed, self._placed(k), strict=True)
            if a.number in seen
        )

    def vertices(self, k: int) -> FloatArray:
        """(V, 3) positions of frame ``k``, of the dtype of the scene's mesh."""
        vertices = self.base.mesh.vertices.copy()
        placed = self._placed(k)
        with named_errors(self._drawn.document.path):
            moved = redrawn(self._drawn, placed)
            for before, after in zip(self._drawn.rows(), moved.rows(), strict=True):
                if after.first and after.vertices.stop <= len(vertices) and _differ(before.draw, after.draw):
                    place_points(after, self._drawn.accessors, vertices[after.vertices])
        return vertices

    def look(self, k: int) -> Look | None:
        """The look of frame ``k``: that of the scene with its lights where they are by then."""
        from clgrid.lookfile.gltf_lights import lights_of

        look = self.base.look
        if look is None or not look.lights:
            self.checked(k)
            return look
        return replace(look, lights=lights_of(self._drawn.document.gltf, self._placed(k)))

    def cameras(self, k: int) -> tuple[Camera, ...]:
        """The cameras of frame ``k``."""
        from clgrid.scene_cameras import camera_of

        found = cameras_of(self._drawn.document.gltf, self._placed(k))
        return tuple(camera_of(each) for each in found)

    def _placed(self, k: int) -> list[Placed]:
        """Nodes of frame ``k``, in the order of the file's own.

        Raises
        ------
        MeshError
            If the animation leaves a node without a place, such as by a rotation of length 0.
        """
        gltf, time = self._drawn.document.gltf, float(self.times[self.checked(k)])
        with named_errors(self._drawn.document.path):
            return placed_nodes(gltf, posed(gltf, self._tracks, time))


def _reaches(drawn: Drawn, tracks: list[Track]) -> bool:
    """Whether tracks move a node that is drawn, or one that it hangs on; a skin may hang on any."""
    moved: set[int] = set()
    todo = [track.node for track in tracks]
    while todo:
        number = todo.pop()
        if number not in moved:
            moved.add(number)
            todo.extend(drawn.document.gltf.nodes[number].children)
    return any(draw.pose is not None or draw.placed.number in moved for draw in drawn.draws)


def _differ(one: Draw, other: Draw) -> bool:
    """Whether a draw is placed, turned or morphed otherwise."""
    if (
        one.pose is not None
        and other.pose is not None
        and not np.array_equal(one.pose.joints, other.pose.joints)
    ):
        return True
    return one.weights != other.weights or not np.array_equal(one.placed.world, other.placed.world)
