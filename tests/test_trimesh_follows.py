"""clgrid.trimesh: changes of the mesh, points inside, copies, and what else of trimesh asks rays."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
from shapes import box, joined
from trimesh_meshes import intersector, theirs, trimesh

import clgrid
from clgrid import rational
from clgrid.device import Device
from clgrid.errors import MeshError
from clgrid.trimesh import RayMeshIntersector

pytestmark = pytest.mark.host


def test_changes_of_the_mesh_are_followed(device: Device) -> None:
    mesh = trimesh.creation.box()
    mesh.ray = intersector(mesh, device)
    ray = [[0.25, 0.125, 9.0]], [[0.0, 0, -1]]
    inside = [[0.25, 0.125, 0.0]]

    def heights() -> list[float]:
        found: list[float] = mesh.ray.intersects_location(*ray)[0][:, 2].tolist()
        return found

    assert heights() == [0.5, -0.5]
    assert mesh.contains(inside).tolist() == [True]
    grid = mesh.ray.grid
    assert mesh.ray.grid is grid
    mesh.apply_transform(trimesh.transformations.translation_matrix([0, 0, 2]))
    assert heights() == [2.5, 1.5]
    assert mesh.contains(inside).tolist() == [False]
    assert mesh.ray.grid is grid  # updated
    mesh.vertices[mesh.vertices[:, 2] > 2] += [0, 0, 1]
    assert heights() == [3.5, 1.5]
    mesh.vertices *= 2
    assert heights() == [7, 3]
    mesh.update_faces(mesh.face_normals[:, 2] < 0.5)
    assert heights() == [3]
    mesh.faces = mesh.faces[:0]
    assert heights() == []
    mesh.vertices, mesh.faces = trimesh.creation.box().vertices, trimesh.creation.box().faces
    assert heights() == [0.5, -0.5]


def test_a_change_that_is_refused_leaves_no_grid_behind(device: Device) -> None:
    mesh = trimesh.creation.box()
    ours = intersector(mesh, device)
    ray = [[0.25, 0.125, 9.0]], [[0.0, 0, -1]]
    assert ours.intersects_any(*ray).all()
    good = mesh.vertices.copy()
    mesh.vertices[3] = np.nan
    for _ in range(2):
        with pytest.raises(MeshError, match="NaN or infinite, first vertex 3"):
            ours.intersects_any(*ray)
    mesh.vertices = good
    assert ours.intersects_any(*ray).all()
    mesh.faces[5] = [0, 1, 99]
    with pytest.raises(MeshError, match=r"triangle 5 names vertices \[0, 1, 99\] of 8"):
        ours.intersects_any(*ray)


def test_points_are_told_inside_as_exact_arithmetic_does(device: Device) -> None:
    """On the lattice of boxes, with a cavity and an overlap; surfaces count as what is beside them."""
    mesh = theirs(joined(box([-2] * 3, [2] * 3), box([1] * 3, [3] * 3)))
    cavity = trimesh.creation.box(extents=[1, 1, 1])
    cavity.invert()
    mesh = trimesh.util.concatenate([mesh, cavity])
    points = np.random.default_rng(6).integers(-7, 8, (400, 3)) / 2.0
    corners = mesh.triangles.view(np.ndarray)
    expected = [rational.inside(corners, point, np.array([1.0, 0.5, 0.25])) for point in points]
    for accuracy in ("precise", "exact"):
        found = intersector(mesh, device, accuracy=accuracy).contains_points(points)
        assert found.tolist() == expected
    assert 20 < sum(expected) < 380
    mesh.ray = intersector(mesh, device)
    assert mesh.contains([[0, 0, 0], [0, 0, 0.75], [1.5, 1.5, 1.5]]).tolist() == [False, True, False]


def test_points_in_open_meshes_are_told_by_both_halves_of_lines(device: Device) -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)
    bowl = ball.copy()
    bowl.update_faces(ball.triangles_center[:, 2] < 0.8)
    points = np.random.default_rng(7).uniform(-1.5, 1.5, (2000, 3))
    whole, found = (intersector(mesh, device).contains_points(points) for mesh in (ball, bowl))
    assert np.mean(whole == found) > 0.98
    assert not found[np.linalg.norm(points, axis=1) > 1].any()
    np.testing.assert_array_equal(found, intersector(bowl, device).contains_points(points))


def test_trimesh_functions_take_our_rays(device: Device) -> None:
    mesh = trimesh.creation.icosphere(subdivisions=2)
    mesh.ray = intersector(mesh, device)
    points = trimesh.sample.volume_mesh(mesh, 50)
    assert len(points)
    assert mesh.contains(points).all()
    assert trimesh.ray.ray_util.contains_points(mesh.ray, [[0, 0, 0], [2, 0, 0]]).tolist() == [True, False]


def test_thickness_takes_our_rays_where_rtree_is_installed(device: Device) -> None:
    pytest.importorskip("rtree", reason="trimesh's own thickness needs rtree")
    mesh = trimesh.creation.icosphere(subdivisions=2)
    mesh.ray = intersector(mesh, device)
    thickness = trimesh.proximity.thickness(mesh, mesh.triangles_center[:5] * 0.999, method="ray")
    assert (thickness > 1.5).all()


def test_meshes_with_our_rays_are_copied_and_pickled(device: Device) -> None:
    mesh = trimesh.creation.box()
    mesh.ray = intersector(mesh, device, accuracy="exact")
    assert mesh.ray.intersects_any([[0, 0, 0]], [[0, 0, 1]]).all()
    again = pickle.loads(pickle.dumps(mesh))
    assert isinstance(again.ray, RayMeshIntersector)
    assert again.ray.mesh is again
    again.apply_translation([9, 0, 0])
    assert not again.ray.intersects_any([[0, 0, 0]], [[0, 0, 1]]).any()
    assert again.ray.grid.device == device
    twin = copy.deepcopy(mesh.ray)
    assert twin.mesh is mesh
    assert twin.grid.accuracy == "exact"


def test_the_name_shadows_nothing() -> None:
    assert clgrid.trimesh.RayMeshIntersector is RayMeshIntersector
    assert "trimesh" in dir(clgrid)
    assert trimesh.__name__ == "trimesh"
