"""The records of a difference between two devices: what ``locate`` finds, and the file that replays it.

Numbers that are floating-point stand in hexadecimal, so that every bit is kept: ``float.fromhex``.
"""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from clgrid.record import DeviceRecord

OPERATION, KERNEL, NONE = "operation", "kernel", "none"
"""Kinds of ``Located``."""

Triple = tuple[str, str, str]


class ReproRay(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One ray, scene units.

    Attributes
    ----------
    dtype : str
        ``float32`` or ``float64``, as it was cast.
    origin, direction : (str, str, str)
    t_min, t_max : str
        In lengths of the direction; float64.
    """

    dtype: str
    origin: Triple
    direction: Triple
    t_min: str
    t_max: str

    @classmethod
    def of(
        cls, origin: npt.ArrayLike, direction: npt.ArrayLike, t_min: float = 0.0, t_max: float = np.inf
    ) -> ReproRay:
        """The ray of two arrays (3,), float32 if both are."""
        o, d = np.asarray(origin), np.asarray(direction)
        single = o.dtype == np.float32 and d.dtype == np.float32
        return cls(
            dtype="float32" if single else "float64",
            origin=hex_of(o.astype(np.float64)),
            direction=hex_of(d.astype(np.float64)),
            t_min=float(t_min).hex(),
            t_max=float(t_max).hex(),
        )

    @property
    def arrays(self) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        """(3,) origin and direction of ``dtype``."""
        o, d = (
            np.array([float.fromhex(x) for x in row], self.dtype) for row in (self.origin, self.direction)
        )
        return o, d

    @property
    def interval(self) -> tuple[float, float]:
        """``t_min`` and ``t_max``."""
        return float.fromhex(self.t_min), float.fromhex(self.t_max)


class ReproGrid(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The grid that the ray goes through: nothing in it is left to be chosen by the device.

    Attributes
    ----------
    layout, accuracy : str
        As for ``clgrid.build``; of the strict rungs.
    resolution : (int, int, int)
        Cells; of a nested layout those of the top grid.
    density : float
        Of a nested layout: cells of subgrids for each triangle in them. Else without effect.
    skipping : bool
    """

    layout: str
    accuracy: str
    resolution: tuple[int, int, int]
    density: float = 4.0
    skipping: bool = False


class ReproMesh(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The triangles, scene units.

    Attributes
    ----------
    source : str
        What messages called the scene.
    dtype : str
        Of the vertices: ``float32`` or ``float64``.
    whole : bool
        Whether this is the scene's whole mesh.
    triangles : int
        Of the scene.
    vertices : list of (str, str, str)
    faces : list of (int, int, int)
    triangle_ids : list of int
        The scene's numbers of the triangles. Those that only keep the bounds have the number ``triangles``.
    npz : str
        Instead of the three lists: a zip file of ``vertices.npy`` and ``faces.npy`` in base64.
    """

    source: str
    dtype: str
    whole: bool
    triangles: int
    vertices: list[Triple] = []
    faces: list[tuple[int, int, int]] = []
    triangle_ids: list[int] = []
    npz: str = ""


class NumberRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A value as the device had it: its bits, and in decimal digits that tell it from its neighbours."""

    bits: str
    decimal: str


class Difference(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A value that two devices have differently.

    Attributes
    ----------
    stage : str
        Of the ray's way: ``start``, ``shear``, ``entry``, ``cell``, ``triangle``, ``hit`` and so on.
    value : str
        Its name there.
    type : str
        ``float``, ``double``, ``long``, ``uint``, ``bool`` or ``triangle``.
    operation : str
        What computes it: ``u = cx * by - cy * bx``.
    steps : tuple of str
        Statements before it, whose results it takes and which are not traced themselves.
    cell : int or None
        Number of the cell where it is computed.
    cell_at : (int, int, int) or None
        The same along x, y and z; None in a subgrid.
    triangle : int or None
        Of the scene.
    first, second : NumberRecord
    ulps : int or None
        Floating-point numbers from one to the other.
    inputs : dict of str to NumberRecord
        What goes into the operation; both devices have the same.
    nearest : str
        Which of the two is the operation's result, each step of it rounded to the nearest: ``first``,
        ``second``, ``neither``; empty where the host cannot tell.
    first_as, second_as : tuple of str
        What each is consistent with.
    """

    stage: str
    value: str
    type: str
    operation: str
    steps: tuple[str, ...]
    cell: int | None
    cell_at: tuple[int, int, int] | None
    triangle: int | None
    first: NumberRecord
    second: NumberRecord
    ulps: int | None
    inputs: dict[str, NumberRecord]
    nearest: str
    first_as: tuple[str, ...]
    second_as: tuple[str, ...]


class AnswerRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The hit that ``Grid.cast`` gives: triangle of the scene, -1 for a miss; t, u and v."""

    triangle: int
    t: str
    u: str
    v: str


class SideRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One of the two that are compared.

    Attributes
    ----------
    label : str
        A selector of the device.
    build_options : str
        ``CLGRID_BUILD_OPTIONS``: added to clgrid's own.
    kernels : dict of str to str
        Kernel sources that are not clgrid's own (``CLGRID_KERNELS``), whole, by file name.
    compiled : tuple of str
        Every kernel file built, with its options.
    traced, alone, together : AnswerRecord
        Of the trace, of the ray cast alone, and of it in a tile of 64 like it, which takes other code.
    values : int
        That were traced.
    checked, off : int
        Of these, operations that the host follows in exact arithmetic, each from what this side has before;
        and those whose result is not rounded to the nearest in each step.
    off_as : tuple of str
        What all of those that are off are consistent with.
    """

    label: str
    device: DeviceRecord
    build_options: str
    kernels: dict[str, str]
    compiled: tuple[str, ...]
    traced: AnswerRecord
    alone: AnswerRecord
    together: AnswerRecord
    values: int
    checked: int
    off: int
    off_as: tuple[str, ...]


class Located(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Where two devices part on one ray.

    Attributes
    ----------
    kind : str
        ``operation``: ``difference`` is the first value in which the traces differ; ``kernel``: traces are
        equal but answers differ, so that it lies in how casting kernels are compiled; ``none``: both agree.
    where : str
        In a sentence.
    differing : int
        Values of the two traces that differ, as far as they have the same course.
    decision : Difference or None
        The first difference in what is decided: a cell, whether a triangle is met or kept, the hit.
    """

    kind: str
    where: str
    ray: ReproRay
    grid: ReproGrid
    sides: tuple[SideRecord, SideRecord]
    differing: int
    difference: Difference | None
    decision: Difference | None


class ReproRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The file that ``clgrid repro`` replays."""

    schema: str
    clgrid: str
    mesh: ReproMesh
    located: Located


class ReplayRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """``clgrid repro FILE --json``.

    Attributes
    ----------
    outcome : str
        ``same``: the file's difference; ``another``; ``none``: the devices agree.
    written_by : str
        Version of clgrid that wrote the file.
    expected, found : Located
        In the file, and now.
    """

    schema: str
    clgrid: str
    file: str
    outcome: str
    written_by: str
    expected: Located
    found: Located


def hex_of(row: npt.NDArray[np.float64]) -> Triple:
    """Three numbers in hexadecimal."""
    x, y, z = (value.hex() for value in row.tolist())
    return x, y, z
