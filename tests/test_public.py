from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

import clgrid
import clgrid.cli
import clgrid.renderer


@pytest.mark.parametrize("name", clgrid.__all__)
def test_every_public_name_is_there(name):
    assert getattr(clgrid, name) is not None
    assert name in dir(clgrid)


def test_render_is_the_function_whatever_was_imported_before():
    assert clgrid.render is clgrid.renderer.render


def test_other_names_are_attribute_errors():
    with pytest.raises(AttributeError, match="frobnicate"):
        clgrid.frobnicate  # noqa: B018


def test_import_is_light():
    code = "import sys, clgrid; print([m for m in ('numpy', 'pyopencl', 'trimesh') if m in sys.modules])"
    root = Path(__file__).parent.parent
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_five_lines_of_the_readme_work(tmp_path):
    mesh = clgrid.load_scene("icosphere:2").mesh
    grid = clgrid.build(mesh)
    hits = grid.cast([[0, 0, 5]], [[0, 0, -1]])
    assert hits.t_hit[0] == pytest.approx(4, abs=0.1)
    image = clgrid.render(mesh, width=16, height=16, grid=grid)
    image.save(tmp_path / "a.png")
    assert clgrid.read_image(tmp_path / "a.png").width == 16


def test_the_wheel_holds_every_package() -> None:
    """An editable install works without this list; a wheel does not."""
    root = Path(__file__).resolve().parent.parent
    folders = {path.parent.relative_to(root) for path in root.glob("clgrid/**/__init__.py")}
    text = (root / "pyproject.toml").read_text(encoding="utf-8")
    listed = re.search(r"^packages = \[(.+)\]$", text, re.MULTILINE)
    assert listed is not None
    names = {".".join(folder.parts) for folder in folders}
    assert set(re.findall(r'"([\w.]+)"', listed[1])) == names | {"clgrid.cl"}
