"""The one table of structs that Python and the kernels share (after Cycles' data_template.h).

Each struct is declared once here; the C declarations that kernels see are made from it. That sizes and
offsets are the same on both sides is asserted on the device by ``program.check_structs``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

_C_TYPES = {"double": np.float64, "float": np.float32, "uint": np.uint32, "ulong": np.uint64, "int": np.int32}


@dataclass(frozen=True)
class Struct:
    """A C struct and its numpy twin.

    Attributes
    ----------
    name : str
        The typedef's name in C.
    members : tuple of (C type, member name, array length)
        Length 1 is a plain member. Doubles come first so that no padding is needed.
    """

    name: str
    members: tuple[tuple[str, str, int], ...]

    @property
    def dtype(self) -> np.dtype[np.void]:
        """The aligned numpy dtype of the struct."""
        fields = [
            (name, _C_TYPES[ctype]) if count == 1 else (name, _C_TYPES[ctype], (count,))
            for ctype, name, count in self.members
        ]
        return np.dtype(fields, align=True)

    def declaration(self) -> str:
        """C source of the typedef."""
        lines = [
            f"    {ctype} {name}{'' if count == 1 else f'[{count}]'};" for ctype, name, count in self.members
        ]
        return "typedef struct {\n" + "\n".join(lines) + f"\n}} {self.name};\n"

    def pack(self, **values: npt.ArrayLike) -> npt.NDArray[np.void]:
        """One record with every member given by name.

        Raises
        ------
        KeyError
            If a member is missing or unknown.
        """
        record = np.zeros((), self.dtype)
        if set(values) != {name for _, name, _ in self.members}:
            raise KeyError(f"{self.name}: members {sorted(values)} do not match the table")
        for name, value in values.items():
            record[name] = value
        return record


GRID = Struct(
    "GridParams",
    (
        # Planes of axis a: lower[a] + k * cell_size[a], k = 0..resolution[a] (local units).
        ("double", "lower", 3),
        ("double", "upper", 3),
        ("double", "cell_size", 3),
        # Nested layouts: a reference from here on is no triangle but a subgrid.
        ("ulong", "first_subgrid", 1),
        # The float32 twins that rasterise bounding boxes; see docs/numerics.md.
        ("float", "lower_f", 3),
        ("float", "cells_per_unit", 3),
        ("uint", "resolution", 3),
        ("uint", "triangle_count", 1),
        # Id of triangle 0, where the mesh is in several grids.
        ("uint", "first_triangle", 1),
        # A slab of the build is 2^slab_shift consecutive cells.
        ("uint", "slab_shift", 1),
    ),
)

SUBGRID = Struct(
    "Subgrid",
    (
        ("uint", "first_cell", 1),
        # Per axis, four bits each: halvings of the parent's cell that make its own, and from bit 12 on of one
        # of its own that make the finest there can be.
        ("uint", "halvings", 1),
        # Where its first cell is, in cells of its size from the grid's lower corner.
        ("int", "first", 3),
    ),
)

FRAME = Struct(
    "FrameParams",
    (
        # local = (scene - offset) * 2^exponent
        ("double", "offset", 3),
        ("double", "scale", 1),
        ("double", "inverse_scale", 1),
    ),
)

CAMERA = Struct(
    "CameraParams",
    (
        ("double", "eye", 3),
        ("double", "forward", 3),
        # Change of direction from a pixel to its right and to its lower neighbour.
        ("double", "step_x", 3),
        ("double", "step_y", 3),
        ("uint", "width", 1),
        ("uint", "height", 1),
        # The window that is drawn, in pixels of the whole picture, and its columns.
        ("uint", "left", 1),
        ("uint", "top", 1),
        ("uint", "across", 1),
        # Whether rays are parallel to `forward`, and steps are of their origins.
        ("uint", "parallel", 1),
    ),
)

MATERIAL = Struct(
    "MaterialParams",
    (
        # Rows of 2x3 matrices, applied to (u, v, 1).
        ("double", "base_transform", 6),
        ("double", "emissive_transform", 6),
        ("double", "base_colour", 4),
        ("double", "emissive", 3),
        # Rays pass where alpha is below; 0 where none do.
        ("double", "alpha_cutoff", 1),
        # Numbers of textures, NO_TEXTURE for none, and of their sets of coordinates.
        ("uint", "base_texture", 1),
        ("uint", "base_uv", 1),
        ("uint", "emissive_texture", 1),
        ("uint", "emissive_uv", 1),
        ("uint", "double_sided", 1),
        ("uint", "masked", 1),
    ),
)

TEXTURE = Struct(
    "TextureParams",
    (
        # Number of its first texel.
        ("uint", "first", 1),
        ("uint", "width", 1),
        ("uint", "height", 1),
        # Along u and v, as in cl/texture.h.
        ("uint", "wrap", 2),
        ("uint", "smooth", 1),
    ),
)

LIGHT = Struct(
    "LightParams",
    (
        ("double", "position", 3),
        # Unit, from the light on.
        ("double", "direction", 3),
        # Beyond reach nothing arrives; the light of a spot is the square of scale * cosine + offset.
        ("double", "reach", 1),
        ("double", "spot_scale", 1),
        ("double", "spot_offset", 1),
        # As in cl/light_rays.cl.
        ("ulong", "kind", 1),
    ),
)

ALL = (GRID, SUBGRID, FRAME, CAMERA, MATERIAL, TEXTURE, LIGHT)


def declarations(structs: Sequence[Struct] = ()) -> str:
    """C source of the shared structs, and of the list ``CLG_STRUCTS`` that ``check_structs.cl`` expands.

    Parameters
    ----------
    structs : sequence of Struct
        Instead of the whole table.
    """
    table = structs or ALL
    lines = [
        f"    SIZE({s.name}) " + " ".join(f"OFFSET({s.name}, {m})" for _, m, _ in s.members) for s in table
    ]
    listing = "#define CLG_STRUCTS(SIZE, OFFSET) \\\n" + " \\\n".join(lines) + "\n"
    return "".join(struct.declaration() for struct in table) + listing


def _offset(dtype: np.dtype[np.void], member: str) -> int:
    fields = dtype.fields
    assert fields is not None  # every struct has members
    return fields[member][1]


def layout(structs: Sequence[Struct] = ()) -> list[tuple[str, int]]:
    """What numpy makes of them: (``sizeof T`` or ``T.member``, bytes), in the order of ``CLG_STRUCTS``."""
    facts: list[tuple[str, int]] = []
    for struct in structs or ALL:
        dtype = struct.dtype
        facts.append((f"sizeof {struct.name}", dtype.itemsize))
        facts += [(f"{struct.name}.{name}", _offset(dtype, name)) for _, name, _ in struct.members]
    return facts
