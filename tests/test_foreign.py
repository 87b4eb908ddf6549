"""Meshes of trimesh as ours."""

from __future__ import annotations

import numpy as np
import pytest

from clgrid.errors import MeshError
from clgrid.mesh import Mesh

pytestmark = pytest.mark.host

trimesh = pytest.importorskip("trimesh")


def test_a_mesh_of_trimesh_is_a_copy() -> None:
    source = trimesh.creation.box()
    mesh = Mesh.from_trimesh(source)
    assert (mesh.vertices.dtype, mesh.faces.dtype) == (np.float64, np.uint32)
    np.testing.assert_array_equal(mesh.faces, source.faces)
    source.vertices[0] = 9
    assert mesh.vertices.max() == 0.5
    assert Mesh.from_trimesh(trimesh.Trimesh()).triangle_count == 0
    for other in (trimesh.PointCloud(np.zeros((2, 3))), np.zeros((3, 3))):
        with pytest.raises(MeshError, match=f"a {type(other).__name__} has no triangles"):
            Mesh.from_trimesh(other)


def test_a_scene_of_trimesh_has_a_geometry_for_each_node() -> None:
    scene = trimesh.Scene()
    unit = trimesh.creation.box()
    mirrored = np.diag([-1.0, 1, 1, 1])
    mirrored[:3, 3] = 5, 0, 0
    scene.add_geometry(unit, node_name="here", geom_name="box")
    scene.add_geometry(unit, node_name="there", geom_name="box", transform=mirrored)
    scene.add_geometry(trimesh.load_path([[0, 0, 0], [1, 1, 1]]), node_name="line")
    scene.add_geometry(trimesh.PointCloud([[0.0, 0, 0]]), node_name="dots")
    mesh = Mesh.from_trimesh(scene)
    assert mesh.geometry_names == ("here", "there")
    assert mesh.geometry_starts.tolist() == [0, 12, 24]
    np.testing.assert_array_equal(mesh.bounds, [[-0.5] * 3, [5.5, 0.5, 0.5]])
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outwards = corners.mean(axis=1) - np.repeat([[0.0, 0, 0], [5, 0, 0]], 12, axis=0)
    assert ((normals * outwards).sum(axis=1) > 0).all()
    assert Mesh.from_trimesh(trimesh.Scene()).triangle_count == 0
