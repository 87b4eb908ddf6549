"""Skins of glTF: vertices that follow several nodes, each by its weight."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clgrid.errors import MeshError
from clgrid.meshfile.gltf_accessors import Accessors, at
from clgrid.meshfile.gltf_nodes import Matrix, Placed, product
from clgrid.meshfile.gltf_schema import Gltf, Primitive

Doubles = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Pose:
    """A skin as the nodes of a scene stand.

    Attributes
    ----------
    joints : (J, 4, 4) float64
        Takes vertices, as the file has them, to the scene, for each joint.
    """

    joints: Doubles


def pose_of(gltf: Gltf, number: int, placed: list[Placed], accessors: Accessors) -> Pose:
    """Pose a skin.

    Raises
    ------
    MeshError
        If a joint is not in the scene, or a reference dangles.
    """
    where = f"skin {number}"
    skin = at(gltf.skins, number, "skin", "node")
    worlds = {each.number: each.world for each in placed}
    missing = [joint for joint in skin.joints if joint not in worlds]
    if missing or not skin.joints:
        what = f"has the joint {missing[0]}, which is not in the scene" if missing else "has no joints"
        raise MeshError(f"glTF {where} {what}; repair or re-export the file")
    inverses = np.tile(np.eye(4), (len(skin.joints), 1, 1))
    if skin.inverse_bind_matrices is not None:
        stored = accessors.scaled(skin.inverse_bind_matrices, where)
        if stored.shape[1] != 16 or len(stored) < len(skin.joints):
            raise MeshError(f"glTF {where} has {len(stored)} inverse matrices for {len(skin.joints)} joints")
        inverses = stored[: len(skin.joints)].astype(np.float64).reshape(-1, 4, 4).transpose(0, 2, 1)
    with np.errstate(over="ignore", invalid="ignore"):
        return Pose(
            np.stack(
                [
                    product(worlds[joint], inverse)
                    for joint, inverse in zip(skin.joints, inverses, strict=True)
                ]
            )
        )


def is_skinned(primitive: Primitive) -> bool:
    """Whether a primitive says which joints its vertices follow."""
    return "JOINTS_0" in primitive.attributes and "WEIGHTS_0" in primitive.attributes


def matrices(pose: Pose, primitive: Primitive, count: int, accessors: Accessors, where: str) -> Doubles:
    """(V, 3, 4) for each vertex: its joints by their weights, which are brought to a sum of 1.

    Raises
    ------
    MeshError
        If joints or weights are malformed, or a weight counts for a joint that the skin does not have.
    """
    total = np.zeros((count, 3, 4))
    whole = np.zeros(count)
    sets = [int(name[7:]) for name in primitive.attributes if re.fullmatch("JOINTS_[0-9]{1,3}", name)]
    for number in sorted(sets):
        if f"WEIGHTS_{number}" not in primitive.attributes:
            continue
        joints = accessors.array(primitive.attributes[f"JOINTS_{number}"], where)
        weights = accessors.scaled(primitive.attributes[f"WEIGHTS_{number}"], where).astype(np.float64)
        shape = (count, 4)
        if joints.shape != shape or weights.shape != shape or joints.dtype.kind != "u":
            raise MeshError(f"glTF {where} has joints or weights that are not four a vertex; repair the file")
        chosen = joints.astype(np.int64)
        if not np.isfinite(weights).all() or (chosen[weights != 0] >= len(pose.joints)).any():
            raise MeshError(
                f"glTF {where} has weights that are not finite, or of joints beyond its {len(pose.joints)}; "
                "repair the file"
            )
        usable = np.minimum(chosen, len(pose.joints) - 1)
        for column in range(4):
            total += weights[:, column, None, None] * pose.joints[usable[:, column], :3]
        whole += weights.sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        scaled: Doubles = total / whole[:, None, None]
    # a vertex without weights follows the first joint
    return np.where((whole != 0)[:, None, None], scaled, pose.joints[0, :3])


def skinned_points(points: npt.NDArray[np.floating], moves: Doubles) -> Doubles:
    """(V, 3) float64 positions, each by its own matrix."""
    x, y, z = (points[:, axis].astype(np.float64)[:, None] for axis in range(3))
    with np.errstate(over="ignore", invalid="ignore"):
        moved: Doubles = ((x * moves[:, :, 0] + y * moves[:, :, 1]) + z * moves[:, :, 2]) + moves[:, :, 3]
    return moved


def skinned_normals(normals: npt.NDArray[np.floating], moves: Doubles) -> Doubles:
    """(V, 3) unit normals, each by the cofactors of its own matrix; zero where there is none."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        a, b, c = (moves[:, row, :3] for row in range(3))
        rows = [_cross(b, c), _cross(c, a), _cross(a, b)]
        mirrors = np.sign((a * rows[0]).sum(axis=1))
        values = normals.astype(np.float64)
        turned = np.stack([(row * values).sum(axis=1) for row in rows], axis=1) * mirrors[:, None]
        length = np.sqrt((turned * turned).sum(axis=1, keepdims=True))
        unit: Doubles = np.where(length > 0, turned / length, 0.0)
    return unit


def _cross(a: Matrix, b: Matrix) -> Matrix:
    x = a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1]
    y = a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]
    z = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return np.stack([x, y, z], axis=1)
