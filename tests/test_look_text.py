"""Looks of OBJ and PLY files."""

from __future__ import annotations

import gzip
import zipfile

import numpy as np
import pytest
from look_files import both, texel
from pictures import CORNERS, png
from scenes import scene as shared_scene

from clgrid.colour import linear
from clgrid.errors import MeshError
from clgrid.look import Material
from clgrid.lookfile import read_look
from clgrid.mesh import load

pytestmark = pytest.mark.host

RED, GREEN, BLUE, WHITE = ([*CORNERS[y, x].tolist(), 255] for y in (0, 1) for x in (0, 1))

# A quad with coordinates of its own order, then a triangle of another material, then one without any.
OBJ = """mtllib scene.mtl
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
vt 1 1
vt 0 1
vt 0 0
vt 1 0
usemtl wood
f 1/3 2/4 3/1 4/2
usemtl two words
f 1/-2 2/-1 3/1
usemtl wood
f 1 2 3
"""
MTL = """# a comment
newmtl wood
Kd 0.5 0.25 1
map_Kd a.png

newmtl two words
\tKd 1 0 0 # red
Ke 3 2 1
d 0.5
"""


def obj(folder, text=OBJ, mtl=MTL):
    (folder / "a.png").write_bytes(png(CORNERS))
    if mtl is not None:
        (folder / "scene.mtl").write_text(mtl)
    path = folder / "a.obj"
    path.write_text(text)
    return path


def test_obj_in_full(tmp_path):
    mesh, look = both(obj(tmp_path))
    wood, other = look.materials
    assert (wood.name, wood.base_colour, wood.double_sided) == ("wood", (0.5, 0.25, 1, 1), True)
    assert other == Material("two words", (1, 0, 0, 0.5), None, (3, 2, 1), None, "blend")
    assert look.material_ids.tolist() == [0, 0, 1, 0]
    assert texel(mesh, look, 0, (0.8, 0.1, 0.1)) == BLUE
    assert texel(mesh, look, 0, (0.1, 0.8, 0.1)) == WHITE
    assert texel(mesh, look, 0, (0.1, 0.1, 0.8)) == GREEN
    assert texel(mesh, look, 1, (0.1, 0.1, 0.8)) == RED
    assert look.uv_faces[0] is not None
    # the fan of the quad, relative indices, and the row for corners that have none
    assert look.uv_faces[0].tolist() == [[2, 3, 0], [2, 0, 1], [2, 3, 0], [4, 4, 4]]
    assert look.uvs[0].tolist() == [[1, 0], [0, 0], [0, 1], [1, 1], [0, 0]]
    assert look.warnings == ()
    packed = tmp_path / "b.obj.gz"
    packed.write_bytes(gzip.compress(OBJ.encode()))
    assert np.array_equal(both(packed)[1].uv_faces[0], look.uv_faces[0])


def test_obj_coordinates_that_go_with_vertices_need_no_faces(tmp_path):
    text = "mtllib scene.mtl\nusemtl wood\nv 0 0 0\nv 1 0 0\nv 1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nf 1/1 2/2 3/3\n"
    mesh, look = both(obj(tmp_path, text))
    assert look.uv_faces == (None,)
    assert texel(mesh, look, 0, (0.1, 0.1, 0.8)) == GREEN


def test_obj_split_by_normals_keeps_its_coordinates(tmp_path):
    text = OBJ.replace("f 1/3 2/4 3/1 4/2", "vn 0 0 1\nvn 0 1 0\nf 1/3/1 2/4/1 3/1/1 4/2/1").replace(
        "f 1/-2 2/-1 3/1", "f 1/-2/2 2/-1/2 3/1/2"
    )
    mesh, look = both(obj(tmp_path, text))
    assert len(mesh.vertices) > 4
    assert texel(mesh, look, 0, (0.8, 0.1, 0.1)) == BLUE
    assert look.uv_faces[0].tolist() == [[2, 3, 0], [2, 0, 1], [2, 3, 0], [4, 4, 4]]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("map_Kd nosuch.png", "'nosuch.png' is missing; drawn magenta"),
        ("map_Kd a.obj", "cannot be read"),
        ("Kd 1 2\nmap_Kd a.png", "not understood, such as 'Kd'"),
        ("Kd nan 0 0", "not understood"),
        ("Kd spectral a.rfl", "not understood"),
        ("map_Kd -s", "not understood"),
        ("d x", "not understood"),
        ("map_d nosuch.png", "mask 'nosuch.png', which is missing"),
    ],
)
def test_mtl_lines_that_cannot_be_used_are_warnings(tmp_path, lines, message):
    _, look = both(obj(tmp_path, mtl=f"newmtl wood\n{lines}\nnewmtl two words\n"))
    assert any(message in line for line in look.warnings), look.warnings


def test_missing_material_files_and_materials_are_warnings(tmp_path):
    _, look = both(obj(tmp_path, mtl=None))
    assert look.materials == (Material("wood"), Material("two words"))
    assert len(look.warnings) == 1
    assert "'scene.mtl' is missing" in look.warnings[0]
    _, look = both(obj(tmp_path, mtl="newmtl wood\n"))
    assert "'two words' is in no material file" in look.warnings[0]
    path = obj(tmp_path, OBJ.replace("mtllib scene.mtl\n", ""))
    assert read_look(path, load(path)) is None
    (tmp_path / "scene.mtl").unlink()
    (tmp_path / "scene.mtl").mkdir()
    assert "missing" in both(obj(tmp_path, mtl=None))[1].warnings[0]


def test_map_options_and_names_with_spaces(tmp_path):
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "My Wood.png").write_bytes(png(CORNERS))
    options = "-s 2 3 1 -o 0.25 0.5 -clamp on -bm 1 -mm 0 1"
    mtl = f"newmtl wood\nmap_Kd {options} maps\\my wood.PNG\nnewmtl two words\n"
    _, look = both(obj(tmp_path, mtl=mtl))
    use = look.materials[0].base_texture
    # v upwards: v' = 3 v + 0.5; downwards, with w = 1 - v: 1 - (3 (1 - w) + 0.5) = 3 w - 2.5
    assert use.transform.tolist() == [[2, 0, 0.25], [0, 3, -2.5]]
    assert look.textures[0].wrap == ("clamp", "clamp")
    assert look.warnings == ()


def test_black_below_a_map_is_white_and_tr_of_1_is_opaque(tmp_path):
    mtl = "newmtl wood\nKd 0 0 0\nTr 1\nmap_Kd a.png\nmap_Ke a.png\nnewmtl two words\nKd 0 0 0\nTr 0.25\n"
    wood, other = both(obj(tmp_path, mtl=mtl))[1].materials
    assert wood.base_colour == (1, 1, 1, 1)
    assert (wood.emissive, wood.emissive_texture.texture) == ((1, 1, 1), 0)
    assert (other.base_colour, other.alpha_mode) == ((0, 0, 0, 0.75), "blend")


def test_masks_go_into_the_alpha_of_their_map(tmp_path):
    mask = np.array([[[0], [255]], [[128], [255]]], np.uint8)
    (tmp_path / "mask.png").write_bytes(png(mask))
    mtl = "newmtl wood\nmap_Kd a.png\nmap_d mask.png\nnewmtl two words\nmap_d mask.png\n"
    _, look = both(obj(tmp_path, mtl=mtl))
    assert [material.alpha_mode for material in look.materials] == ["mask", "mask"]
    with_colours, alone = (texture.pixels for texture in look.textures)
    assert np.array_equal(with_colours[..., :3], CORNERS)
    assert np.array_equal(with_colours[..., 3:], mask)
    assert (alone[..., :3] == 255).all()
    (tmp_path / "mask.png").write_bytes(png(mask[:1]))
    _, look = both(obj(tmp_path, mtl=mtl))
    assert look.materials[0].alpha_mode == "opaque"
    assert "does not fit its colours" in look.warnings[0]


@pytest.mark.parametrize("word", ["1/9", "1/0", "1/-9", "1/x"])
def test_missing_coordinates_are_a_warning(tmp_path, word):
    text = OBJ.replace("f 1/-2", f"f {word}")
    _, look = both(obj(tmp_path, text))
    assert any("1 corners name missing texture coordinates" in line for line in look.warnings)
    assert look.uvs[0][look.uv_faces[0][2, 0]].tolist() == [0, 0]


def test_coordinates_that_are_no_numbers_are_a_warning(tmp_path):
    _, look = both(obj(tmp_path, OBJ.replace("vt 0 0", "vt x 0")))
    assert "NaN or infinite" in look.warnings[0]


def test_sponza_in_stone(tmp_path):
    with zipfile.ZipFile(shared_scene("textured/sponza_obj_textured.zip")) as packed:
        packed.extractall(tmp_path)
    folder = tmp_path / "sponza"
    # its materials name no map; in another case and with another slash than the file has
    text = (
        (folder / "sponza.mtl").read_text().replace("sp_00_pod\n", "sp_00_pod\nmap_Kd TEXTURES\\kamen.jpg\n")
    )
    (folder / "sponza.mtl").write_text(text)
    mesh, look = both(folder / "sponza.obj")
    assert (len(look.materials), look.warnings) == (20, ())
    assert look.textures[0].pixels.shape == (477, 640, 4)
    floor = next(k for k, material in enumerate(look.materials) if material.name == "sp_00_pod")
    texels = np.array(
        [texel(mesh, look, face)[:3] for face in np.flatnonzero(look.material_ids == floor)[::50]]
    )
    assert np.ptp(texels.mean(axis=0)) < 40
    assert texels.std() > 5


def test_an_obj_with_a_space_in_its_texture(tmp_path):
    with zipfile.ZipFile(shared_scene("textured/trimesh_obj_textured.zip")) as packed:
        packed.extractall(tmp_path)
    mesh, look = both(tmp_path / "fuze.obj")
    assert look.textures[0].name == "fuze uv.jpg"
    assert look.textures[0].pixels.shape == (1024, 1024, 4)
    top = int(np.argmax(mesh.vertices[mesh.faces][:, :, 2].min(axis=1)))
    red, green, blue, _ = texel(mesh, look, top)
    # the cap is violet
    assert blue > green
    assert red > green
    assert both(tmp_path / "rabbit.obj")[1].materials[0].base_colour == (1, 0, 1, 1)


PLY = """ply
format ascii 1.0
comment TextureFile a.png
element vertex 4
property float x
property float y
property float z
{properties}element face 1
property list uchar int vertex_indices
{faces}end_header
{rows}
"""
PLACES = ("0 0 0", "1 0 0", "1 1 0", "0 1 0")


def ply(folder, properties="", rows=("",) * 4, faces="", corners="", picture=True):
    (folder / "a.png").write_bytes(png(CORNERS))
    lines = [f"{place} {row}" for place, row in zip(PLACES, rows, strict=True)] + [f"4 0 1 2 3 {corners}"]
    text = PLY.format(
        properties="".join(f"property {each}\n" for each in properties.split(", ") if each),
        faces=faces,
        rows="\n".join(lines),
    )
    path = folder / "a.ply"
    path.write_text(text if picture else text.replace("comment TextureFile a.png\n", ""))
    return path


def test_ply_colours_by_their_type(tmp_path):
    rows = ("255 0 128 51", "0 0 0 255", "0 0 0 255", "0 0 0 255")
    kinds = "uchar red, uchar green, uchar blue, uchar alpha"
    _, look = both(ply(tmp_path, kinds, rows, picture=False))
    expected = [1, 0, float(linear(np.array(128 / 255))), 0.2]
    np.testing.assert_allclose(look.colours[0], expected, rtol=1e-6)
    assert look.materials == (Material(),)
    rows = ("0.5 0.25 2", "0 0 0", "0 0 0", "-1 0 0")
    _, look = both(ply(tmp_path, "float red, float green, float blue", rows, picture=False))
    assert look.colours[0].tolist() == [0.5, 0.25, 2, 1]
    assert look.colours[3].tolist() == [0, 0, 0, 1]


@pytest.mark.parametrize("names", ["s t", "u v", "texture_u texture_v"])
def test_ply_coordinates_of_vertices(tmp_path, names):
    first, second = names.split()
    path = ply(tmp_path, f"float {first}, float {second}", ("0 0", "1 0", "1 1", "0 1"))
    mesh, look = both(path)
    assert texel(mesh, look, 0, (0.8, 0.1, 0.1)) == BLUE
    assert texel(mesh, look, 0, (0.1, 0.1, 0.8)) == GREEN
    assert look.uv_faces == (None,)


def test_ply_coordinates_of_corners(tmp_path):
    path = ply(
        tmp_path, faces="property list uchar float texcoord\n", corners="8 0.25 0 0.75 0 0.75 1 0.25 1"
    )
    mesh, look = both(path)
    assert look.uv_faces[0].tolist() == [[0, 1, 2], [0, 2, 3]]
    assert texel(mesh, look, 1, (0.8, 0.1, 0.1)) == BLUE
    assert texel(mesh, look, 1, (0.1, 0.1, 0.8)) == RED


def test_ply_without_coordinates_or_colours(tmp_path):
    assert "for which there are no coordinates" in both(ply(tmp_path))[1].warnings[0]
    path = ply(tmp_path, picture=False)
    assert read_look(path, load(path)) is None
    short = ply(tmp_path, faces="property list uchar float texcoord\n", corners="6 0 0 1 0 1 1")
    assert "no coordinates" in both(short)[1].warnings[0]


def test_ply_of_another_mesh_is_refused(tmp_path):
    path = ply(tmp_path, "float s, float t", ("0 0", "1 0", "1 1", "0 1"))
    mesh = load(path)
    text = path.read_text().replace("element vertex 4", "element vertex 3").replace("0 1 0 0 1\n", "")
    path.write_text(text.replace("4 0 1 2 3", "3 0 1 2"))
    with pytest.raises(MeshError, match="load it again"):
        read_look(path, mesh)


def test_the_horse_has_colours():
    mesh, look = both(shared_scene("scans/horse.ply"))
    assert look.colours is not None
    assert look.colours.shape == (len(mesh.vertices), 4)
