"""What a scene's file holds beside triangles, and what of it a device would be given."""

from __future__ import annotations

from clgrid.features_record import FeaturesRecord, FramesFound, LightFound, TextureFound, UvFound
from clgrid.look import Look, TextureUse
from clgrid.scene import Scene, gltf_cameras


def features(scene: Scene) -> FeaturesRecord:
    """List what there is: reads the look and, of frames, how many there are.

    Raises
    ------
    MeshError, InputError
        If a part of the file that is not triangles is malformed.
    """
    look, frames = scene.look, scene.frames
    vertices = scene.mesh.vertices
    return FeaturesRecord(
        materials=0 if look is None else len(look.materials),
        double_sided=0 if look is None else sum(each.double_sided for each in look.materials),
        masked=0 if look is None else sum(each.alpha_mode == "mask" for each in look.materials),
        emissive=0 if look is None else sum(any(each.emissive) for each in look.materials),
        textures=[] if look is None else _textures(look),
        uv_sets=[] if look is None else _uv_sets(look),
        vertex_colours=look is not None and look.colours is not None,
        lights=[] if look is None else [LightFound(each.kind, each.name) for each in look.lights],
        orthographic=sum(camera.ymag is not None for camera in gltf_cameras(scene)),
        frames=None
        if frames is None
        else FramesFound(
            source=frames.source,
            count=frames.count,
            fps=scene.fps,
            seconds=float(frames.times[-1]),
            topology_changes=frames.topology_changes,
            cameras_move=frames.cameras_move,
            nbytes=vertices.nbytes,
        ),
        nbytes={} if look is None else look_bytes(look),
        warnings=(() if look is None else look.warnings) + (() if frames is None else frames.warnings),
    )


def look_bytes(look: Look) -> dict[str, int]:
    """Bytes of the arrays of a look by name, as they are given to a device; only of what there is.

    Tables of materials and lights are some hundred bytes an entry and not counted.
    """
    sizes = {
        "material_ids": look.material_ids.nbytes if len(look.materials) > 1 else 0,
        "textures": sum(texture.pixels.nbytes for texture in look.textures),
        "uvs": sum(uv.nbytes for uv in look.uvs),
        "uv_faces": sum(faces.nbytes for faces in look.uv_faces if faces is not None),
        "colours": 0 if look.colours is None else look.colours.nbytes,
    }
    return {name: size for name, size in sizes.items() if size}


def _textures(look: Look) -> list[TextureFound]:
    return [
        TextureFound(
            name=texture.name,
            width=texture.pixels.shape[1],
            height=texture.pixels.shape[0],
            nbytes=texture.pixels.nbytes,
            alpha=bool((texture.pixels[..., 3] < 255).any()),
        )
        for texture in look.textures
    ]


def _uv_sets(look: Look) -> list[UvFound]:
    uses: list[TextureUse] = [
        use
        for each in look.materials
        for use in (each.base_texture, each.emissive_texture)
        if use is not None
    ]
    return [
        UvFound(
            rows=len(uv),
            nbytes=uv.nbytes + (0 if faces is None else faces.nbytes),
            own_faces=faces is not None,
            uses=sum(use.uv_set == number for use in uses),
        )
        for number, (uv, faces) in enumerate(zip(look.uvs, look.uv_faces, strict=True))
    ]
