from __future__ import annotations

import gzip
import math

import numpy as np
import pytest
from gltf_files import GltfFile, tetrahedron
from look_files import (
    BASE,
    SQUARE,
    SQUARE_FACES,
    SQUARE_UV,
    both,
    check_shapes,
    data_uri,
    square,
    texel,
    textured,
)
from pictures import CORNERS, bomb, png
from scenes import scene as shared_scene

from clgrid.errors import MeshError
from clgrid.look import Material, TextureUse
from clgrid.lookfile import read_look
from clgrid.mesh import load

pytestmark = pytest.mark.host

# Weights of the square's first triangle near its corners (0, 0), (1, 0) and (1, 1).
NEAR = {"bottom left": (0.8, 0.1, 0.1), "bottom right": (0.1, 0.8, 0.1), "top right": (0.1, 0.1, 0.8)}
RED, GREEN, BLUE, WHITE = ([*CORNERS[y, x].tolist(), 255] for y in (0, 1) for x in (0, 1))


def corner_texels(path):
    mesh, look = both(path)
    return [texel(mesh, look, 0, weights) for weights in NEAR.values()]


def test_textures_are_the_right_way_up_from_every_place(tmp_path):
    expected = [BLUE, WHITE, GREEN]
    assert corner_texels(textured(square(BASE)).write_glb(tmp_path / "a.glb")) == expected
    (tmp_path / "my picture.png").write_bytes(png(CORNERS))
    beside = textured(square(BASE), "my%20picture.png")
    assert corner_texels(beside.write_gltf(tmp_path / "b.gltf", uri="b.bin")) == expected
    inside = textured(square(BASE))
    packed = np.frombuffer(png(CORNERS), np.uint8)
    inside.accessor(packed)
    inside.json["images"] = [
        {"bufferView": len(inside.json["bufferViews"]) - 1, "mimeType": "image/png", "name": "in"}
    ]
    path = inside.write_glb(tmp_path / "c.glb")
    assert corner_texels(path) == expected
    (tmp_path / "c.glb.gz").write_bytes(gzip.compress(path.read_bytes()))
    assert corner_texels(tmp_path / "c.glb.gz") == expected
    assert both(path)[1].textures[0].name == "in"


def test_files_without_a_look_have_none(tmp_path):
    path = tetrahedron().write_glb(tmp_path / "a.glb")
    assert read_look(path, load(path)) is None
    for plain in ({"name": "plain", "doubleSided": True}, {"pbrMetallicRoughness": {"roughnessFactor": 0.3}}):
        path = square(plain).write_glb(tmp_path / "b.glb")
        assert read_look(path, load(path)) is None
    path = tmp_path / "a.stl"
    path.write_text(
        "solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\n"
    )
    path.write_text(path.read_text() + "endfacet\nendsolid\n")
    assert read_look(path, load(path)) is None


def test_a_material_in_full(tmp_path):
    material = {
        "name": "m",
        "pbrMetallicRoughness": {"baseColorFactor": [0.1, 0.2, 0.3, 0.4], "baseColorTexture": {"index": 0}},
        "emissiveFactor": [0.5, 0.25, 0],
        "emissiveTexture": {"index": 1, "texCoord": 1},
        "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 4}},
        "alphaMode": "MASK",
        "alphaCutoff": 0.25,
        "doubleSided": True,
    }
    file = textured(
        square(material, TEXCOORD_1=2 * SQUARE_UV),
        data_uri(png(CORNERS)),
        data_uri(png(CORNERS[:1])),
        samplers=[{"wrapS": 33071, "wrapT": 33648, "magFilter": 9728}],
    )
    _, look = both(file.write_glb(tmp_path / "a.glb"))
    assert look.materials == (
        Material(
            "m", (0.1, 0.2, 0.3, 0.4), TextureUse(0, 0), (2, 1, 0), TextureUse(1, 1), "mask", 0.25, True
        ),
    )
    assert [texture.pixels.shape for texture in look.textures] == [(2, 2, 4), (1, 2, 4)]
    assert {(texture.wrap, texture.smooth) for texture in look.textures} == {(("clamp", "mirror"), False)}
    assert np.array_equal(look.uvs[0], SQUARE_UV)
    assert np.array_equal(look.uvs[1], 2 * SQUARE_UV)


def test_an_image_used_in_two_ways_is_decoded_once(tmp_path):
    file = textured(square({**BASE, "emissiveTexture": {"index": 1}, "emissiveFactor": [1, 1, 1]}))
    file.json["samplers"] = [{}, {"wrapS": 33071}]
    file.json["textures"] = [{"source": 0, "sampler": 0}, {"source": 0, "sampler": 1}]
    _, look = both(file.write_glb(tmp_path / "a.glb"))
    assert [texture.wrap for texture in look.textures] == [("repeat", "repeat"), ("clamp", "repeat")]
    assert look.textures[0].pixels is look.textures[1].pixels


def test_rows_are_those_of_the_mesh_with_instances_mirrors_and_materials(tmp_path):
    """Three nodes draw two meshes of two primitives; one node mirrors, one primitive has no material."""
    file = GltfFile()
    colours = [np.full((4, 3), k / 8, np.float32) for k in range(3)]
    shared = {"POSITION": file.accessor(SQUARE), "COLOR_0": file.accessor(colours[1])}
    indices = file.accessor(SQUARE_FACES)
    other = {"POSITION": file.accessor(SQUARE), "COLOR_0": file.accessor(colours[2])}
    file.mesh(
        {"attributes": shared, "indices": indices, "material": 2},
        {"attributes": shared, "indices": indices, "material": 0},
    )
    file.mesh(
        {"attributes": other, "indices": indices}, {"attributes": {"POSITION": other["POSITION"]}, "mode": 6}
    )
    file.json["materials"] = [
        {"name": name, "pbrMetallicRoughness": {"baseColorFactor": [k, 0, 0, 1]}}
        for k, name in enumerate(("a", "unused", "c"))
    ]
    file.nodes({"mesh": 1, "scale": [-1, 1, 1]}, {"mesh": 0}, {"mesh": 1, "translation": [5, 0, 0]})
    mesh, look = both(file.write_glb(tmp_path / "a.glb"))
    names = [look.materials[k].name for k in look.material_ids]
    assert names == [""] * 4 + ["c", "c", "a", "a"] + [""] * 4
    assert not any(material.double_sided for material in look.materials)
    assert look.colours is not None
    of_faces = look.colours[mesh.faces][:, :, 0]
    assert (of_faces == of_faces[:, :1]).all()
    assert of_faces[:, 0].tolist() == [0.25, 0.25, 1, 1, *[0.125] * 4, 0.25, 0.25, 1, 1]


def test_primitives_that_share_positions_keep_their_own_coordinates(tmp_path):
    file = textured(square(BASE))
    first = file.json["meshes"][0]["primitives"][0]
    second = {**first, "attributes": {**first["attributes"], "TEXCOORD_0": file.accessor(1 - SQUARE_UV)}}
    file.json["meshes"][0]["primitives"].append(second)
    mesh, look = both(file.write_glb(tmp_path / "a.glb"))
    near = NEAR["bottom left"]
    assert [texel(mesh, look, 0, near), texel(mesh, look, 2, near)] == [BLUE, GREEN]


@pytest.mark.parametrize("stored", ["f4", "u1", "u2"])
@pytest.mark.parametrize("channels", [3, 4])
def test_colours_of_every_type_are_linear(tmp_path, stored, channels):
    most = 1 if stored == "f4" else np.iinfo(stored).max
    values = (np.arange(16).reshape(4, 4)[:, :channels] % 5 == 0).astype(stored) * most
    padded = np.ascontiguousarray(values)
    members = {} if stored == "f4" else {"normalized": True}
    # rows of three bytes or words are not aligned, as elements should be; readers take them all the same
    path = square(None, COLOR_0=(padded, members)).write_glb(tmp_path / "a.glb")
    _, look = both(path)
    assert look.colours is not None
    expected = np.ones((4, 4), np.float32)
    expected[:, :channels] = values / most
    assert np.array_equal(look.colours, expected)


def test_quantized_coordinates_are_put_back_by_their_transform(tmp_path):
    transform = {"scale": [65535 / 1000, 65535 / 1000], "offset": [0, 0]}
    use = {"index": 0, "extensions": {"KHR_texture_transform": transform}}
    quantized = (SQUARE_UV * 1000).astype(np.uint16)
    file = textured(
        square(
            {"pbrMetallicRoughness": {"baseColorTexture": use}}, TEXCOORD_0=(quantized, {"normalized": True})
        )
    )
    assert corner_texels(file.write_glb(tmp_path / "a.glb")) == [BLUE, WHITE, GREEN]


def test_texture_transforms_are_offset_rotation_scale(tmp_path):
    """As in the specification's own example: (u, v) * scale, turned against the clock, then moved."""
    transform = {"offset": [0.5, -0.25], "rotation": math.pi / 2, "scale": [2, 3], "texCoord": 1}
    use = {"index": 0, "texCoord": 0, "extensions": {"KHR_texture_transform": transform}}
    file = textured(square({"pbrMetallicRoughness": {"baseColorTexture": use}}, TEXCOORD_1=SQUARE_UV))
    _, look = both(file.write_glb(tmp_path / "a.glb"))
    found = look.materials[0].base_texture
    assert found is not None
    assert found.uv_set == 0
    assert len(look.uvs) == 1
    # the image of (1, 0) under rotation by +90 degrees points to -v, that of (0, 1) to +u
    np.testing.assert_allclose(found.transform, [[0, 3, 0.5], [-2, 0, -0.25]], atol=1e-15)


LIGHTS = {
    "extensions": {
        "KHR_lights_punctual": {
            "lights": [
                {"type": "directional", "intensity": 3, "color": [1, 0.5, 0.25], "name": "sun"},
                {"type": "point", "range": 7},
                {"type": "spot", "spot": {"innerConeAngle": 0.1, "outerConeAngle": 0.2}},
                {"type": "area"},
            ]
        }
    }
}


def lit(number, **members):
    return {**members, "extensions": {"KHR_lights_punctual": {"light": number}}}


def test_lights_stand_where_their_nodes_are(tmp_path):
    half = math.sqrt(0.5)
    nodes = (
        {"mesh": 0},
        {"translation": [1, 2, 3], "scale": [2, 2, 2], "children": [2, 3]},
        lit(1, translation=[1, 0, 0], name="bulb"),
        lit(2, rotation=[-half, 0, 0, half]),
        lit(0),
        lit(3),
    )
    file = square(None, *nodes)
    file.json["scenes"][0]["nodes"] = [0, 1, 4, 5]
    file.json.update(LIGHTS)
    _, look = both(file.write_glb(tmp_path / "a.glb"))
    bulb, spot, sun = look.lights
    assert (bulb.kind, bulb.name, bulb.position, bulb.reach) == ("point", "bulb", (3, 2, 3), 7)
    assert (spot.kind, spot.position, spot.inner_cone, spot.outer_cone) == ("spot", (1, 2, 3), 0.1, 0.2)
    np.testing.assert_allclose(spot.direction, [0, -1, 0], atol=1e-15)
    assert (sun.kind, sun.intensity, sun.colour, sun.direction) == (
        "directional",
        3,
        (1, 0.5, 0.25),
        (0, 0, -1),
    )
    assert sun.reach == math.inf
    assert len(look.warnings) == 1
    assert "'area'" in look.warnings[0]


def test_missing_and_broken_pictures_are_magenta_and_said(tmp_path):
    material = {**BASE, "emissiveTexture": {"index": 1}, "emissiveFactor": [1, 1, 1]}
    for uri, reason in (
        ("nosuch.png", "missing"),
        ("https://example.org/a.png", "nothing is fetched"),
        ("data:image/png;base64,!!", "base64"),
        (data_uri(b"no picture"), "cannot be read"),
        (data_uri(png(CORNERS)[:60]), "texture"),
        (data_uri(bomb(60_000, 60_000)), "texture"),
    ):
        file = textured(square(material), uri, uri)
        _, look = both(file.write_glb(tmp_path / "a.glb"))
        assert [texture.pixels.tolist() for texture in look.textures] == [
            [[[255, 0, 255, 255]]],
            [[[0, 0, 0, 255]]],
        ]
        assert len(look.warnings) == 2
        assert "magenta" in look.warnings[0]
        assert reason in look.warnings[0]
        assert "black" in look.warnings[1]


def test_textures_without_image_or_coordinates(tmp_path):
    file = textured(square(BASE, TEXCOORD_0=None))
    _, look = both(file.write_glb(tmp_path / "a.glb"))
    assert not look.uvs[0].any()
    assert "without TEXCOORD_0" in look.warnings[0]
    file.json["textures"] = [{"extensions": {"KHR_texture_basisu": {"source": 5}}}]
    path = file.write_glb(tmp_path / "b.glb")
    with pytest.raises(MeshError, match="image 5 of 1"):
        read_look(path, load(path))
    file.json["textures"] = [{}]
    assert "names no image" in "".join(both(file.write_glb(tmp_path / "c.glb"))[1].warnings)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"textures": []}, "texture 0 of 0"),
        ({"images": []}, "image 0 of 0"),
        ({"textures": [{"source": 0, "sampler": 3}]}, "sampler 3 of 0"),
        ({"images": [{"bufferView": 77}]}, "buffer view 77"),
        ({"materials": []}, "material 0 of 0"),
        ({"materials": [{"pbrMetallicRoughness": {"baseColorTexture": {}}}]}, "without saying which"),
        (
            {"materials": [{"extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": "x"}}}]},
            "malf",
        ),
        (
            {"extensions": {"KHR_lights_punctual": {"lights": 3}}, "nodes": [lit(0, mesh=0)]},
            "malformed KHR_l",
        ),
        ({"nodes": [lit(0, mesh=0)]}, "light 0 of 0"),
    ],
)
def test_dangling_and_malformed_parts_are_mesh_errors(tmp_path, change, message):
    file = textured(square(BASE))
    mesh = load(file.write_glb(tmp_path / "a.glb"))
    file.json.update(change)
    path = file.write_glb(tmp_path / "a.glb")
    with pytest.raises(MeshError, match=message) as caught:
        read_look(path, mesh)
    assert str(caught.value).startswith(f"{path}: ")


def test_numbers_that_make_no_sense_are_warnings(tmp_path):
    uv = SQUARE_UV.copy()
    uv[0] = np.nan
    material = {
        "pbrMetallicRoughness": {"baseColorFactor": [1, -1, 1, 1], "baseColorTexture": {"index": 0}},
        "alphaMode": "DITHER",
    }
    _, look = both(textured(square(material, TEXCOORD_0=uv)).write_glb(tmp_path / "a.glb"))
    text = "\n".join(look.warnings)
    for part in ("factor of -1", "'DITHER'", "TEXCOORD_0 that are NaN"):
        assert part in text


def test_another_mesh_is_refused(tmp_path):
    path = textured(square(BASE)).write_glb(tmp_path / "a.glb")
    with pytest.raises(MeshError, match="load it again"):
        read_look(path, load(tetrahedron().write_glb(tmp_path / "b.glb")))


def test_attributes_of_another_length_are_refused(tmp_path):
    path = textured(square(BASE, TEXCOORD_0=SQUARE_UV[:3])).write_glb(tmp_path / "a.glb")
    with pytest.raises(MeshError, match=r"TEXCOORD_0 of shape \(3, 2\)"):
        read_look(path, load(path))


def test_scenes_without_triangles_may_have_lights(tmp_path):
    file = GltfFile()
    file.nodes(lit(1))
    file.json.update(LIGHTS)
    mesh, look = both(file.write_gltf(tmp_path / "a.gltf"))
    assert mesh.triangle_count == 0
    assert [light.kind for light in look.lights] == ["point"]


def test_duck_and_truck_show_what_they_should():
    mesh, look = both(shared_scene("textured/Duck.glb"))
    beak = int(np.argmax(mesh.vertices[mesh.faces][:, :, 0].min(axis=1)))
    back = int(np.argmin(mesh.vertices[mesh.faces][:, :, 0].max(axis=1)))
    red, green, blue, _ = texel(mesh, look, beak)
    assert red > 200
    assert 60 < green < 160
    assert blue < 60
    red, green, blue, _ = texel(mesh, look, back)
    assert red > 180
    assert green > 140
    assert blue < 60
    mesh, look = both(shared_scene("textured/CesiumMilkTruck.glb"))
    assert [material.name for material in look.materials] == ["truck", "glass", "window_trim", "wheels"]
    # wheels, the last two draws, are dark rubber
    last = mesh.geometry_starts[-2]
    assert set(look.material_ids[last:].tolist()) == {3}


def test_flight_helmet_lacks_a_picture(tmp_path):
    import zipfile

    with zipfile.ZipFile(shared_scene("textured/flight_helmet_gltf.zip")) as packed:
        packed.extractall(tmp_path)
    mesh, look = both(tmp_path / "FlightHelmet" / "glTF" / "FlightHelmet.gltf")
    assert [texture.pixels.shape[0] for texture in look.textures] == [2048, 1, 1024, 2048, 2048]
    assert len(look.warnings) == 1
    assert "FlightHelmet_baseColor1.png" in look.warnings[0]
    # the lowest triangle is of the wooden foot: brown
    low = int(np.argmin(mesh.vertices[mesh.faces][:, :, 1].max(axis=1)))
    red, green, blue, _ = texel(mesh, look, low)
    assert red > green > blue


def test_kitchens_have_materials_without_textures():
    mesh, look = both(shared_scene("arch/luxcore_kitchen.glb"))
    check_shapes(mesh, look)
    assert len(look.materials) == 26
    assert all(material.double_sided for material in look.materials)
    assert look.textures == ()
    assert len(mesh.geometry_names) == 26
    starts = mesh.geometry_starts[:-1]
    assert look.material_ids[starts].tolist() == sorted(look.material_ids[starts].tolist())
