from __future__ import annotations

import hashlib

import numpy as np
import pytest

from clgrid import procedural
from clgrid.errors import InputError
from clgrid.mesh import Mesh


def edge_balance(faces: np.ndarray) -> tuple[int, int]:
    """Edges not shared by two triangles, and edges that both triangles run along the same way."""
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    keys = directed.min(1) * 2**32 + directed.max(1)
    _, inverse, uses = np.unique(keys, return_inverse=True, return_counts=True)
    turn = np.zeros(len(uses), np.int64)
    np.add.at(turn, inverse, np.where(directed[:, 0] < directed[:, 1], 1, -1))
    return int(np.count_nonzero(uses != 2)), int(np.count_nonzero(turn[uses == 2]))


def volume(mesh: Mesh, faces: np.ndarray) -> float:
    a, b, c = (mesh.vertices[faces[:, k]].astype(np.float64) for k in range(3))
    return float((np.cross(a, b) * c).sum() / 6)


@pytest.mark.parametrize(("name", "triangles", "size"), [("cube", 12, 8.0), ("icosphere:4", 5120, 4.18)])
def test_closed_shapes_are_closed_and_wound_outwards(name, triangles, size):
    mesh = procedural.make(name)
    assert mesh.triangle_count == triangles
    assert edge_balance(mesh.faces) == (0, 0)
    assert volume(mesh, mesh.faces) == pytest.approx(size, rel=0.01)


def test_demo_is_a_million_triangles_of_closed_bodies_above_the_ground():
    mesh = procedural.demo()
    assert 0.95e6 < mesh.triangle_count < 1.05e6
    assert mesh.vertices.dtype == np.float32
    assert mesh.geometry_names[:2] == ("ground", "knot")
    starts = mesh.geometry_starts
    for g in range(1, len(mesh.geometry_names)):
        faces = mesh.faces[starts[g] : starts[g + 1]]
        assert edge_balance(faces) == (0, 0), mesh.geometry_names[g]
        assert volume(mesh, faces) > 0, mesh.geometry_names[g]


def test_the_ground_is_seen_from_above():
    for name, up in (("demo", 1), ("terrain:16", 2)):
        mesh = procedural.make(name)
        first, last = mesh.geometry_starts[:2]
        a, b, c = (mesh.vertices[mesh.faces[first:last, k]].astype(np.float64) for k in range(3))
        assert (np.cross(b - a, c - a)[:, up] > 0).all()


def test_demo_is_the_same_on_every_machine():
    mesh = procedural.demo()
    digest = hashlib.sha256(mesh.vertices.tobytes() + mesh.faces.tobytes()).hexdigest()
    assert digest[:16] == "d3fcbecb9db6b475"


@pytest.mark.parametrize(("level", "triangles"), [(0, 20), (1, 80), (5, 20480)])
def test_icosphere_splits_in_four(level, triangles):
    mesh = procedural.icosphere(level)
    assert mesh.triangle_count == triangles
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices, axis=1), 1, rtol=2e-7)


def test_terrain_has_two_triangles_a_square():
    assert procedural.terrain(7).triangle_count == 98
    assert edge_balance(procedural.terrain(7).faces)[0] == 4 * 7


@pytest.mark.parametrize(
    "name",
    [
        "icosphere:10",
        "icosphere:-1",
        "icosphere:x",
        "terrain:0",
        "terrain:99999",
        "cube:2",
        "demo:1",
        "torus",
    ],
)
def test_wrong_names_and_numbers_are_input_errors(name):
    with pytest.raises(InputError, match=r"icosphere|terrain|cube|torus|demo"):
        procedural.make(name)
