"""Keyframes of glTF: where an animation has the nodes at a time, and the weights of morph targets."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from clgrid.errors import MeshError
from clgrid.meshfile.gltf_accessors import Accessors, at
from clgrid.meshfile.gltf_schema import Animation, AnimationSampler, Gltf, Node

Doubles = npt.NDArray[np.float64]

_WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}
# Quaternions this close are mixed in a straight line: the sine of their angle is lost in rounding.
_NEAR = 1.0 - 1e-9


@dataclass(frozen=True)
class Track:
    """What one channel does to one node.

    Attributes
    ----------
    node : int
        Number of the node.
    path : str
        ``translation``, ``rotation``, ``scale`` or ``weights``.
    times : (K,) float64
        Seconds, ascending.
    values : (K, N) float64
        At the keyframes.
    interpolation : str
        ``LINEAR`` (spherical for rotations), ``STEP`` or ``CUBICSPLINE``.
    arriving, leaving : (K, N) float64 or None
        Tangents of cubic splines, in units a second.
    """

    node: int
    path: str
    times: Doubles
    values: Doubles
    interpolation: str
    arriving: Doubles | None = None
    leaving: Doubles | None = None

    def at(self, time: float) -> Doubles:
        """(N,) values at a time: the first before the first keyframe, the last behind the last."""
        k = int(np.searchsorted(self.times, time, side="right")) - 1
        if k < 0 or k == len(self.times) - 1 or self.interpolation == "STEP" or time == self.times[k]:
            value: Doubles = self.values[max(k, 0)]
            return value
        span = float(self.times[k + 1] - self.times[k])
        share = (time - float(self.times[k])) / span
        one, other = self.values[k], self.values[k + 1]
        if self.arriving is not None and self.leaving is not None:
            return _spline((one, other), (span * self.leaving[k], span * self.arriving[k + 1]), share)
        if self.path == "rotation":
            return _slerp(one, other, share)
        mixed: Doubles = (1.0 - share) * one + share * other
        return mixed


def tracks_of(gltf: Gltf, animation: Animation, accessors: Accessors) -> tuple[list[Track], tuple[str, ...]]:
    """Tracks of an animation, and warnings for channels that are left out.

    Raises
    ------
    MeshError
        If a reference dangles, times do not ascend, or values are too few, too many or not finite.
    """
    found, left_out = [], 0
    for number, channel in enumerate(animation.channels):
        where = f"animation {animation.name[:40]!r} channel {number}"
        sampler = at(animation.samplers, channel.sampler, "sampler", where)
        node, path = channel.target.node, channel.target.path
        if node is None or path not in (*_WIDTHS, "weights"):
            left_out += 1
            continue
        target = at(gltf.nodes, node, "node", where)
        width = _WIDTHS.get(path) or _target_count(gltf, target)
        if width:
            found.append(_track(node, path, width, sampler, accessors, where))
        else:
            left_out += 1
    warning = f"left out: channels of animations that move no node, no morph target ({left_out})"
    return found, (warning,) if left_out else ()


def posed(gltf: Gltf, tracks: Sequence[Track], time: float) -> dict[int, Node]:
    """The nodes that tracks move, by number, as they stand at a time."""
    changes: dict[int, dict[str, Any]] = {}
    for track in tracks:
        # a matrix and an animation exclude each other, so that of a malformed file goes
        members = changes.setdefault(track.node, {})
        members[track.path] = track.at(time).tolist()
        if track.path != "weights":
            members["matrix"] = None
    return {number: msgspec.structs.replace(gltf.nodes[number], **new) for number, new in changes.items()}


def _target_count(gltf: Gltf, node: Node) -> int:
    """Morph targets of a node's mesh."""
    if node.mesh is None:
        return 0
    primitives = at(gltf.meshes, node.mesh, "mesh", "node").primitives
    return max((len(primitive.targets) for primitive in primitives), default=0)


def _track(
    node: int, path: str, width: int, sampler: AnimationSampler, accessors: Accessors, where: str
) -> Track:
    times = accessors.scaled(sampler.input, where).astype(np.float64).reshape(-1)
    stored = accessors.scaled(sampler.output, where).astype(np.float64)
    if not len(times) or not np.isfinite(times).all() or (np.diff(times) <= 0).any():
        raise MeshError(f"glTF {where} has times that do not ascend; repair or re-export the file")
    if sampler.interpolation not in ("LINEAR", "STEP", "CUBICSPLINE"):
        raise MeshError(
            f"glTF {where} has the unknown interpolation {sampler.interpolation[:20]!r}; repair it"
        )
    cubic = sampler.interpolation == "CUBICSPLINE"
    expected = len(times) * width * (3 if cubic else 1)
    if stored.size != expected or not np.isfinite(stored).all():
        raise MeshError(
            f"glTF {where} has {stored.size} values for {len(times)} keyframes, {expected} finite ones are "
            "needed; repair or re-export the file"
        )
    if not cubic:
        return Track(node, path, times, stored.reshape(-1, width), sampler.interpolation)
    arriving, values, leaving = stored.reshape(-1, 3, width).transpose(1, 0, 2)
    return Track(node, path, times, values, sampler.interpolation, arriving, leaving)


def _slerp(a: Doubles, b: Doubles, share: float) -> Doubles:
    """Rotation between two, at even speed the short way round; of unit length where both are."""
    cosine = float((a * b).sum())
    if cosine < 0:
        b, cosine = -b, -cosine
    if cosine > _NEAR:
        return (1.0 - share) * a + share * b
    angle = math.acos(cosine)
    return (math.sin((1.0 - share) * angle) * a + math.sin(share * angle) * b) / math.sin(angle)


def _spline(ends: tuple[Doubles, Doubles], tangents: tuple[Doubles, Doubles], share: float) -> Doubles:
    """Cubic Hermite spline, tangents in units a whole span (glTF 2.0, appendix C)."""
    square = share * share
    cube = square * share
    start = (2 * cube - 3 * square + 1) * ends[0] + (cube - 2 * square + share) * tangents[0]
    return start + (3 * square - 2 * cube) * ends[1] + (cube - square) * tangents[1]
