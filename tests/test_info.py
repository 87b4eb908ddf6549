from __future__ import annotations

import numpy as np
import pytest

from clgrid.frame import LocalFrame
from clgrid.grid import build
from clgrid.info import degenerate_count, info, variants
from clgrid.mesh import Mesh
from clgrid.procedural import cube, icosphere
from clgrid.program import builds
from clgrid.record import InfoRecord, decode, encode
from clgrid.renderer import AOVS, render
from clgrid.scene import Scene, load_scene


def test_info_predicts_the_grid_that_is_built(device):
    for options in ({}, {"density": 0.5}, {"resolution": (3, 4, 5)}):
        scene = load_scene("icosphere:3")
        found = info(scene, **options)
        grid = build(scene.mesh, device=device, **options)
        assert found.resolution == grid.stats.resolution
        assert found.cells == grid.stats.cells
        assert found.cell_bytes == grid.stats.nbytes["cells"]


def test_info_names_the_programs_that_are_compiled(device):
    mesh = cube()
    render(mesh, None, 8, 8, AOVS, device=device)
    compiled = {" ".join((built.file, *built.options)) for built in builds(device)}
    assert set(variants(mesh)) <= compiled


def test_far_meshes_report_their_one_rounding():
    near = info(Scene("a", icosphere(2)))
    assert near.max_rounding == 0
    mesh = Mesh(icosphere(2).vertices.astype(np.float64) + 1e6 + 0.1, icosphere(2).faces)
    far = info(Scene("a", mesh))
    assert 0 < far.max_rounding < 1e-6
    assert far.frame_offset[0] == pytest.approx(1e6, rel=1e-3)


def test_triangles_without_area_are_counted():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [3e-20, 1e-20, 0]], np.float32)
    faces = np.array([[0, 1, 2], [0, 1, 3], [0, 0, 3], [3, 3, 3], [0, 1, 4]], np.uint32)
    mesh = Mesh(vertices, faces)
    assert degenerate_count(mesh, LocalFrame.of_bounds(mesh.bounds)) == 3


def test_the_record_is_strict_and_complete_also_for_nothing(tmp_path):
    (tmp_path / "empty.off").write_text("OFF\n0 0 0\n")
    found = info(load_scene(tmp_path / "empty.off"))
    assert (found.triangles, found.cells, found.bounds, found.resolution) == (0, 0, None, None)
    assert found.warnings
    assert decode(encode(found), InfoRecord) == found
    full = info(load_scene("cube"))
    assert decode(encode(full), InfoRecord) == full
    assert full.bounds == ((-1, -1, -1), (1, 1, 1))
