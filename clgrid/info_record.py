"""The JSON record of ``clgrid info``."""

from __future__ import annotations

import msgspec

from clgrid.features_record import FeaturesRecord
from clgrid.record import DeviceRecord


class CandidateRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A grid that could be built, and what it is estimated to take: seconds, bytes.

    Attributes
    ----------
    density : float
        Cells per triangle, as asked for.
    full_cells : int
        Cells with a triangle.
    steps, tests, batches : float
        Of a ray, by mean: cells looked at, triangles tested, and batches of eight that these come in.
    build_s, cast_s : float
        Of the build, and of all rays.
    fits : bool
        Whether it keeps to the memory allowed.
    chosen : bool
    """

    layout: str
    skipping: bool
    density: float
    resolution: tuple[int, int, int]
    cells: int
    references: int
    full_cells: int
    nbytes: int
    steps: float
    tests: float
    batches: float
    build_s: float
    cast_s: float
    fits: bool
    chosen: bool


class ConstantsRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Seconds of the device for one layout, with or without skipping.

    Attributes
    ----------
    build : dict of str to float
        ``fixed``, ``triangle``, ``reference``, ``cell``.
    cast : dict of str to float
        ``ray``; ``passed_cell``, ``passed_reference``: that a tile of 64 rays passes.
    source : str
        Where they come from.
    """

    layout: str
    skipping: bool
    build: dict[str, float]
    cast: dict[str, float]
    source: str


class ExplainRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a grid would be on a device, and why.

    Attributes
    ----------
    rays : int
        For which it is chosen.
    max_memory : int or None
        Bytes that the finished grid may have.
    nbytes : dict of str to int
        Of the grid by array, exactly.
    candidates, constants
        Empty where nothing was left to choose.
    """

    device: DeviceRecord
    rays: int
    max_memory: int | None
    layout: str
    skipping: bool
    nbytes: dict[str, int]
    candidates: list[CandidateRecord]
    constants: list[ConstantsRecord]


class InfoRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """``clgrid info --json``: what is known of a scene and, with ``--explain``, of its grid on a device.

    Attributes
    ----------
    bounds : ((x, y, z), (x, y, z)) or None
        Lowest and highest corner; None for a mesh without triangles.
    mesh_bytes : int
        Of the host arrays.
    degenerate : int
        Triangles whose vertices lie on a line or in a point.
    frame_offset, frame_exponent
        ``local = (scene - offset) * 2**-exponent``.
    max_rounding : float
        The largest change of a coordinate by its one rounding to local float32, scene units.
    density : float
        Cells per triangle; where it is "auto", what was chosen, or without ``--explain`` the paper's 4.
    resolution : (int, int, int) or None
        What ``density`` asks for.
    cell_bytes : int
        Bytes of the list starts, exactly. Each reference adds 4; how many there are, the build counts.
    compiled
        Kernel variants that building and rendering this scene compiles.
    explained : ExplainRecord or None
        Only with ``--explain``.
    features : FeaturesRecord or None
        Materials, textures, lights, frames and so on; always there by now.
    """

    schema: str
    clgrid: str
    scene: str
    source: str
    triangles: int
    vertices: int
    vertex_dtype: str
    vertex_normals: bool
    geometries: tuple[str, ...]
    cameras: tuple[str, ...]
    bounds: tuple[tuple[float, float, float], tuple[float, float, float]] | None
    mesh_bytes: int
    degenerate: int
    frame_offset: tuple[float, float, float]
    frame_exponent: int
    max_rounding: float
    density: float
    resolution: tuple[int, int, int] | None
    cells: int
    cell_bytes: int
    compiled: tuple[str, ...]
    warnings: tuple[str, ...]
    explained: ExplainRecord | None = None
    features: FeaturesRecord | None = None
