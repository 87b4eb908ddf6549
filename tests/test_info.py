from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from agreement import KINDS
from shaded import quad, scene_of

from clgrid.frame import LocalFrame
from clgrid.grid import build
from clgrid.info import degenerate_count, explain, info, shaded_variants, variants
from clgrid.info_record import InfoRecord
from clgrid.look import Material, Shading, Texture, TextureUse
from clgrid.mesh import Mesh
from clgrid.procedural import cube, icosphere
from clgrid.program import builds
from clgrid.record import decode, encode
from clgrid.renderer import PLAIN_AOVS as AOVS
from clgrid.renderer import render
from clgrid.scene import Scene, load_scene


def test_info_predicts_the_grid_that_is_built(device):
    for options in ({"density": 4}, {"density": 0.5}, {"resolution": (3, 4, 5)}):
        scene = load_scene("icosphere:3")
        found = info(scene, **options)
        grid = build(scene.mesh, device=device, **options)
        assert found.resolution == grid.stats.resolution
        assert found.cells == grid.stats.cells
        assert found.cell_bytes == grid.stats.nbytes["cells"]


def test_without_a_device_auto_stands_for_the_density_of_the_paper():
    assert info(load_scene("icosphere:3")) == info(load_scene("icosphere:3"), 4)


@pytest.mark.parametrize(("layout", "skipping"), KINDS)
def test_info_names_the_programs_that_are_compiled(device, layout, skipping):
    mesh = cube()
    render(mesh, None, 8, 8, AOVS, layout=layout, skipping=skipping, density=4, device=device)
    compiled = {" ".join((built.file, *built.options)) for built in builds(device)}
    assert set(variants(mesh, layout, skipping=skipping)) <= compiled


@pytest.mark.host
def test_info_names_the_programs_of_a_look(device):
    see_through = Material(alpha_mode="mask", base_texture=TextureUse(0), base_colour=(1, 1, 1, 0))
    texture = Texture(np.full((1, 1, 4), 255, np.uint8))
    mesh, look = scene_of([quad(0), quad(1)], [Material(), see_through], [texture])
    image = render(mesh, None, 8, 8, look=look, shading=Shading(), density=4, device=device)
    assert "-DLOOK_TEXTURES=1" in image.metadata["clgrid:kernel_options"]
    compiled = {" ".join((built.file, *built.options)) for built in builds(device)}
    named = shaded_variants(mesh, look)
    assert [each.split()[0] for each in named] == ["find_surfaces.cl", "pass_surfaces.cl"]
    assert set(named) <= compiled
    assert shaded_variants(mesh, None) == ()


def test_explain_describes_the_grid_that_is_built(device):
    scene = load_scene("icosphere:4")
    for options in (
        {},
        {"layout": "auto", "skipping": "auto", "rays": 10**8},
        {"layout": "hashed", "rays": 0},
        {"layout": "auto", "max_memory": 60_000},
        {"layout": "auto", "resolution": (3, 4, 5)},
        {"density": 4, "layout": "linked-list"},
    ):
        found = explain(scene, device, **options)
        grid = build(scene.mesh, device=device, **options)
        explained = found.explained
        assert (explained.layout, explained.skipping) == (grid.layout, grid.skipping)
        assert found.resolution == grid.stats.resolution
        assert explained.nbytes == grid.stats.nbytes
        assert found.density == grid.recipe.density
        assert explained.device.name == device.name
        if grid.choice is None:
            assert explained.candidates == explained.constants == []
        else:
            assert len(explained.candidates) == len(grid.choice.candidates)
            (chosen,) = (one for one in explained.candidates if one.chosen)
            assert (chosen.layout, chosen.resolution) == (grid.layout, grid.stats.resolution)
            assert {(one.layout, one.skipping) for one in explained.constants} == set(grid.choice.constants)
        assert decode(encode(found), InfoRecord) == found


def test_explain_of_nothing(device, tmp_path):
    (tmp_path / "empty.off").write_text("OFF\n0 0 0\n")
    found = explain(load_scene(tmp_path / "empty.off"), device, "auto")
    assert found.explained.nbytes == {}
    assert found.explained.candidates == []
    assert decode(encode(found), InfoRecord) == found


def run(*words):
    """Exit code, stdout and stderr of the command."""
    done = subprocess.run([sys.executable, "-m", "clgrid", *words], capture_output=True, text=True)
    return done.returncode, done.stdout, done.stderr


def test_info_touches_no_device(monkeypatch):
    code = (
        "import sys\n"
        "from clgrid.cli import main\n"
        "main(['info', 'cube'])\n"
        "assert 'pyopencl' not in sys.modules, 'pyopencl was imported'"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "paper's; auto depends on the device" in done.stdout


def test_info_explain_in_words_and_in_json(device):
    words = (
        "info",
        "icosphere:4",
        "--explain",
        "--layout",
        "auto",
        "--rays",
        "1000",
        "--device",
        device.label,
    )
    code, text, _ = run(*words)
    assert code == 0
    text = " ".join(text.split())  # lines may end within what is looked for
    for word in ("for 1,000 rays", "fitted on", "ns a passed cell", "chosen", "compact", "hashed", "0.25"):
        assert word in text
    code, text, _ = run(*words, "--json")
    found = decode(text, InfoRecord)
    assert code == 0
    assert sum(one.chosen for one in found.explained.candidates) == 1
    code, text, _ = run(*words, "--density", "4", "--layout", "compact")
    assert code == 0
    assert "the options leave one grid" in text


@pytest.mark.parametrize(
    "words",
    [
        ["--rays", "5"],
        ["--layout", "hashed"],
        ["--max-memory", "5G"],
        ["--device", "0"],
        ["--skipping"],
        ["--explain", "--max-memory", "10"],
    ],
)
def test_options_without_effect_and_impossible_bounds_are_one_line(words):
    code, out, err = run("info", "icosphere:3", *words)
    assert (code, out) == (1, "")
    assert len(err.splitlines()) == 1
    assert "--explain" in err or "more than the limit given" in err


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
