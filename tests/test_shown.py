"""What a prompt and a notebook show: short, safe in HTML, and of any state."""

from __future__ import annotations

import tempfile
from base64 import b64decode
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import OpenImageIO
import pytest

from clgrid import procedural
from clgrid.device import Device
from clgrid.grid import build
from clgrid.image import to_srgb8
from clgrid.mesh import Mesh
from clgrid.renderer import render
from clgrid.shown import Shown, shape_text
from clgrid.units import bytes_text

pytestmark = pytest.mark.host


def shown(thing: Shown) -> tuple[str, dict[str, str]]:
    """The line, and the table read back."""
    line, html = repr(thing), thing._repr_html_()
    assert len(line) < 160
    assert "\n" not in line
    root = ElementTree.fromstring(html)
    table = root.find("table") if root.tag == "div" else root
    assert table is not None
    caption = table.findtext("caption")
    assert caption is not None
    assert line == f"<{caption.replace(':', '', 1)}>"
    rows = table.findall("tbody/tr")
    return line, {row.findtext("th") or "": row.findtext("td") or "" for row in rows}


def test_a_mesh() -> None:
    cube = procedural.cube()
    starts = np.array([0, 4, 12], np.int64)
    mesh = Mesh(cube.vertices, cube.faces, None, starts, ("<a>", "b & c"), "a<b>.ply", ("one", "two"))
    line, table = shown(mesh)
    assert line == f"<clgrid.Mesh a<b>.ply: 12 triangles, {len(cube.vertices)} vertices>"
    assert table["geometries"] == "2: <a>, b & c"
    assert table["vertex normals"] == "no"
    assert table["lowest corner"] == "(" + ", ".join(f"{x:g}" for x in mesh.bounds[0]) + ")"
    assert table["warnings"] == "one; two"


def test_a_mesh_of_nothing(device: Device) -> None:
    mesh = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32))
    assert shown(mesh)[0] == "<clgrid.Mesh <arrays>: 0 triangles, 0 vertices>"
    grid = build(mesh, device=device)
    assert shown(grid)[1]["cells"] == "0 (0x0x0)"
    assert "0 hits" in shown(grid.cast(np.zeros((0, 3)), np.zeros((0, 3))))[0]
    assert "0 hits" in shown(grid.cast_all(np.zeros((0, 3)), np.zeros((0, 3))))[0]


def test_a_grid_alive_and_released(device: Device) -> None:
    grid = build(procedural.cube(), "hashed", resolution=(3, 4, 5), skipping=True, device=device)
    line, table = shown(grid)
    for part in ("12 triangles", "hashed", "robust", device.label, bytes_text(grid.nbytes)):
        assert part in line
    assert table["cells"] == "60 (3x4x5)"
    assert table["references"] == f"{grid.stats.references:,}"
    assert all(name in table["bytes"] for name in grid.stats.nbytes)
    grid.release()
    released, same = shown(grid)
    assert released.endswith("released>")
    assert same == table


def test_a_grid_whose_update_failed(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    grid = build(procedural.cube(), device=device)
    monkeypatch.setattr(grid, "_build", lambda: None)
    grid.update(grid.mesh.vertices)
    assert shown(grid)[1] == {}


def test_hits(device: Device) -> None:
    import pyopencl as cl
    import pyopencl.array as cl_array

    grid = build(procedural.cube(), device=device)
    x, y = np.meshgrid(np.linspace(-2, 2, 6), np.linspace(-2, 2, 4))
    origins = np.stack([x, y, np.full_like(x, 5.0)], axis=-1)
    directions = np.broadcast_to([0.0, 0.0, -1.0], origins.shape)
    hits = grid.cast(origins, directions)
    line, table = shown(hits)
    assert line == f"<clgrid.Hits 4 x 6 rays, {int(hits.mask.sum())} hits>"
    assert table["computed"] == "t_hit, primitive_ids, primitive_uvs"
    line, table = shown(grid.cast_all(origins, directions))
    assert line.startswith("<clgrid.AllHits 24 rays, ")
    assert int(table["most hits of a ray"]) >= 2
    queue = cl.CommandQueue(device.context)
    resident = [cl_array.to_device(queue, np.ascontiguousarray(array)) for array in (origins, directions)]
    line, table = shown(grid.cast_on_device(queue, *resident))
    assert line == "<clgrid.DeviceHits 4 x 6 rays, hits on the device>"
    assert table["t_hit"] == "(4, 6) float64"


def test_numbers_are_short() -> None:
    sizes = (0, 1, 999, 999.6, 1234, 1_500_000, 2.5e9, 7e12)
    assert [bytes_text(size) for size in sizes] == [
        "0 B", "1 B", "999 B", "1 kB", "1.23 kB", "1.5 MB", "2.5 GB", "7 TB",
    ]  # fmt: skip
    assert [shape_text(shape, "ray") for shape in ((), (1,), (2000,), (3, 4))] == [
        "1 ray", "1 ray", "2,000 rays", "3 x 4 rays",
    ]  # fmt: skip


def pixels_of(html: str) -> np.ndarray:
    """The picture of a notebook's cell, as bytes of sRGB."""
    source = ElementTree.fromstring(html).find("img").get("src")  # type: ignore[union-attr]
    assert source is not None
    kind, data = source.split(",", 1)
    assert kind == "data:image/png;base64"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cell.png"
        path.write_bytes(b64decode(data))
        return np.asarray(OpenImageIO.ImageBuf(str(path)).get_pixels(OpenImageIO.UINT8))


def test_a_picture_shows_itself(device: Device) -> None:
    image = render(procedural.icosphere(2), width=48, height=32, aovs=("depth",), device=device)
    line, table = shown(image)
    assert line == f"<clgrid.Image 48 x 32, {image.hits:,} pixels show the mesh>"
    assert table["groups"] == "rgba, depth"
    assert table["layout"] == "compact"
    np.testing.assert_array_equal(pixels_of(image._repr_html_()), to_srgb8(image.rgba[..., :3]))


def test_a_grid_shows_its_mesh_while_it_lives(device: Device) -> None:
    grid = build(procedural.icosphere(2), device=device)
    pixels = pixels_of(grid._repr_html_())
    assert pixels.shape == (180, 240, 3)
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 20
    grid.release()
    assert "<img" not in grid._repr_html_()
