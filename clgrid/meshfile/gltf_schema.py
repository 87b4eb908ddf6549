"""The part of glTF 2.0 that is read, typed: wrong JSON types fail on decoding."""

from __future__ import annotations

import math
from typing import Annotated, Any

import msgspec

Index = Annotated[int, msgspec.Meta(ge=0, le=2**53)]
Vector3 = Annotated[list[float], msgspec.Meta(min_length=3, max_length=3)]
Vector4 = Annotated[list[float], msgspec.Meta(min_length=4, max_length=4)]
Matrix4 = Annotated[list[float], msgspec.Meta(min_length=16, max_length=16)]
Extensions = dict[str, Any]


class Record(msgspec.Struct, rename="camel"):
    """Names as in the specification; unknown members are ignored."""


class Asset(Record):
    """Which version of glTF the file is written in."""

    version: str
    generator: str | None = None


class Buffer(Record):
    """Binary data: a file, a data URI, or the chunk of a GLB."""

    byte_length: Index
    uri: str | None = None


class BufferView(Record):
    """A range of a buffer."""

    buffer: Index
    byte_length: Index
    byte_offset: Index = 0
    byte_stride: Index | None = None


class SparseIndices(Record):
    """Which elements a sparse accessor replaces."""

    buffer_view: Index
    component_type: Index
    byte_offset: Index = 0


class SparseValues(Record):
    """What a sparse accessor puts there."""

    buffer_view: Index
    byte_offset: Index = 0


class Sparse(Record):
    """Elements that differ from the rest of an accessor."""

    count: Index
    indices: SparseIndices
    values: SparseValues


class Accessor(Record):
    """A typed array in a buffer view."""

    component_type: Index
    count: Index
    type: str
    buffer_view: Index | None = None
    byte_offset: Index = 0
    normalized: bool = False
    sparse: Sparse | None = None


class Primitive(Record):
    """One draw: attributes by accessor, and how vertices join."""

    attributes: dict[str, Index]
    indices: Index | None = None
    mode: Index = 4
    material: Index | None = None
    targets: list[dict[str, Index]] = []
    extensions: Extensions = {}


class MeshRecord(Record):
    """Primitives that are placed together."""

    primitives: list[Primitive]
    name: str = ""
    weights: list[float] = []


class Node(Record):
    """A place in the scene tree, by a matrix or by translation, rotation and scale."""

    name: str = ""
    children: list[Index] = []
    mesh: Index | None = None
    camera: Index | None = None
    skin: Index | None = None
    matrix: Matrix4 | None = None
    translation: Vector3 | None = None
    rotation: Vector4 | None = None
    scale: Vector3 | None = None
    weights: list[float] = []
    extensions: Extensions = {}


class Scene(Record):
    """Roots of the trees to draw."""

    nodes: list[Index] = []
    name: str = ""


class Perspective(Record):
    """Lens of a perspective camera; angles in radians."""

    yfov: float
    znear: float = 0.0
    zfar: float | None = None
    aspect_ratio: float | None = None


class Orthographic(Record):
    """Half extents of an orthographic camera in scene units."""

    xmag: float
    ymag: float
    znear: float = 0.0
    zfar: float | None = None


class Camera(Record):
    """A lens; the node that names it says where it stands."""

    type: str
    name: str = ""
    perspective: Perspective | None = None
    orthographic: Orthographic | None = None


class Image(Record):
    """A picture: a file, a data URI, or a buffer view."""

    name: str = ""
    uri: str | None = None
    mime_type: str = ""
    buffer_view: Index | None = None


class Sampler(Record):
    """How a texture is looked up, in the numbers of OpenGL."""

    mag_filter: Index | None = None
    min_filter: Index | None = None
    wrap_s: Index = 10497
    wrap_t: Index = 10497


class Texture(Record):
    """An image and how it is looked up; extensions may name another image."""

    name: str = ""
    source: Index | None = None
    sampler: Index | None = None
    extensions: Extensions = {}


class TextureInfo(Record):
    """Reference to a texture with the factors of the several uses."""

    index: Index | None = None
    tex_coord: Index = 0
    scale: float = 1.0
    strength: float = 1.0
    extensions: Extensions = {}


class TextureTransform(Record):
    """KHR_texture_transform: how uv are changed before the look-up."""

    offset: tuple[float, float] = (0.0, 0.0)
    rotation: float = 0.0
    scale: tuple[float, float] = (1.0, 1.0)
    tex_coord: Index | None = None


class Metallic(Record):
    """Base colour and its texture."""

    base_color_factor: Vector4 | None = None
    base_color_texture: TextureInfo | None = None
    metallic_factor: float = 1.0
    roughness_factor: float = 1.0
    metallic_roughness_texture: TextureInfo | None = None


class Material(Record):
    """Look of a primitive."""

    name: str = ""
    pbr_metallic_roughness: Metallic | None = None
    normal_texture: TextureInfo | None = None
    occlusion_texture: TextureInfo | None = None
    emissive_texture: TextureInfo | None = None
    emissive_factor: Vector3 | None = None
    alpha_mode: str = "OPAQUE"
    alpha_cutoff: float = 0.5
    double_sided: bool = False
    extensions: Extensions = {}


class Spot(Record):
    """Half angles of a spot light in radians."""

    inner_cone_angle: float = 0.0
    outer_cone_angle: float = math.pi / 4


class Light(Record):
    """KHR_lights_punctual: a light; the node that names it says where it stands."""

    type: str
    name: str = ""
    color: Vector3 | None = None
    intensity: float = 1.0
    range: float | None = None
    spot: Spot | None = None


class Lights(Record):
    """KHR_lights_punctual of the document."""

    lights: list[Light] = []


class Target(Record):
    """What an animation moves: a path of a node."""

    path: str
    node: Index | None = None


class Channel(Record):
    """One sampler of an animation and what it moves."""

    sampler: Index
    target: Target


class AnimationSampler(Record):
    """Keyframes: times and values by accessor, and what lies between."""

    input: Index
    output: Index
    interpolation: str = "LINEAR"


class Animation(Record):
    """Channels that play together."""

    channels: list[Channel] = []
    samplers: list[AnimationSampler] = []
    name: str = ""


class Skin(Record):
    """Joints by node, and what takes vertices to each."""

    joints: list[Index]
    inverse_bind_matrices: Index | None = None


class Gltf(Record):
    """The whole document."""

    asset: Asset
    scene: Index | None = None
    scenes: list[Scene] = []
    nodes: list[Node] = []
    meshes: list[MeshRecord] = []
    cameras: list[Camera] = []
    accessors: list[Accessor] = []
    buffer_views: list[BufferView] = []
    buffers: list[Buffer] = []
    materials: list[Material] = []
    textures: list[Texture] = []
    images: list[Image] = []
    samplers: list[Sampler] = []
    animations: list[Animation] = []
    skins: list[Skin] = []
    extensions: Extensions = {}
    extensions_required: list[str] = []
    extensions_used: list[str] = []
