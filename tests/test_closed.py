"""Open edges: against a count edge by edge."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from adversarial import CLOSED
from hypothesis import given, settings
from meshes import MESHES, lattice_box, soup
from rays import lattice_meshes

from clgrid import closed, procedural
from clgrid.closed import open_edges
from clgrid.mesh import Mesh


def one_by_one(mesh: Mesh) -> int:
    """Open edges counted with tuples, where -0.0 equals 0.0."""
    uses: Counter[frozenset[tuple[float, ...]]] = Counter()
    for face in mesh.faces:
        corners = [tuple(mesh.vertices[vertex].tolist()) for vertex in face]
        for k in range(3):
            if corners[k] != corners[k - 1]:
                uses[frozenset((corners[k], corners[k - 1]))] += 1
    return sum(number % 2 for number in uses.values())


@settings(max_examples=300)
@given(lattice_meshes())
def test_equals_a_count_edge_by_edge(mesh: Mesh) -> None:
    assert open_edges(mesh) == one_by_one(mesh)


@pytest.mark.parametrize("name", MESHES)
def test_meshes_equal_a_count_edge_by_edge(name: str) -> None:
    assert open_edges(MESHES[name]) == one_by_one(MESHES[name])


@pytest.mark.parametrize("name", CLOSED)
def test_closed_meshes_have_none(name: str) -> None:
    mesh = CLOSED[name][0]
    assert open_edges(mesh) == 0
    assert open_edges(Mesh(mesh.vertices, mesh.faces[1:])) == 3


def test_positions_count_and_not_indices() -> None:
    ball = procedural.icosphere(3)
    alone = soup(ball.vertices[ball.faces])
    assert open_edges(alone) == 0
    moved = alone.vertices.copy()
    moved[0, 0] = np.nextafter(moved[0, 0], np.float32(2))
    assert open_edges(alone.moved(moved)) == 4


def test_zeros_of_both_signs_are_one_place() -> None:
    box = lattice_box(4)
    corners = box.vertices[box.faces]
    signs = np.random.default_rng(0).choice((-1, 1), size=corners.shape)
    assert (corners == 0).any()
    assert open_edges(soup(np.where(corners == 0, np.copysign(0.0, signs), corners))) == 0


def test_triangles_without_area_open_nothing() -> None:
    cube = procedural.cube()
    folded = np.array([[0, 1, 1], [2, 2, 2], [3, 0, 3]], np.uint32)
    assert open_edges(Mesh(cube.vertices, np.concatenate([cube.faces, folded]))) == 0
    # Three different corners on a line have three edges.
    line = soup(np.array([[[0, 0, 0], [1, 0, 0], [3, 0, 0]]]))
    assert open_edges(line) == 3


def test_corner_on_an_edge_is_open_until_a_triangle_without_area_closes_it() -> None:
    a, b, c, m, d = (0, 0, 0), (2, 0, 0), (0, 2, 0), (1, 0, 0), (0, 0, 2)
    tetrahedron = [(a, c, b), (b, c, d), (c, a, d), (a, m, d), (m, b, d)]
    assert open_edges(soup(np.array(tetrahedron))) == 3
    assert open_edges(soup(np.array([*tetrahedron, (a, b, m)]))) == 0


def test_vertices_out_of_use_do_not_matter() -> None:
    cube = procedural.cube()
    waste = np.full((5, 3), np.nan, np.float32)
    assert open_edges(Mesh(np.concatenate([waste, cube.vertices, waste]), cube.faces + np.uint32(5))) == 0


def test_no_triangles_no_edges() -> None:
    assert open_edges(Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32))) == 0
    point = Mesh(np.ones((1, 3), np.float32), np.zeros((1, 3), np.uint32))
    assert open_edges(point) == 0


def test_portions_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    terrain = procedural.terrain(16)
    assert open_edges(terrain) == 64
    monkeypatch.setattr(closed, "_FACES_AT_ONCE", 7)
    assert open_edges(terrain) == 64
