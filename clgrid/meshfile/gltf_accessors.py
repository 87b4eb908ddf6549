"""glTF accessors as arrays: every reference and range is checked before memory is touched or taken."""

from __future__ import annotations

import base64
import binascii
from functools import cached_property
from typing import TypeVar
from urllib.parse import unquote, urlsplit

import numpy as np
import numpy.typing as npt

from clgrid.errors import MeshError
from clgrid.meshfile.content import Content, content
from clgrid.meshfile.gltf_document import Document
from clgrid.meshfile.gltf_schema import Accessor, Buffer, Sparse

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
SHAPES = {
    "SCALAR": (1, 1),
    "VEC2": (2, 1),
    "VEC3": (3, 1),
    "VEC4": (4, 1),
    "MAT2": (2, 2),
    "MAT3": (3, 3),
    "MAT4": (4, 4),
}
"""Rows and columns of each type; columns of matrices begin at multiples of four bytes."""

Bytes = Content | memoryview
Array = npt.NDArray[np.generic]
Entry = TypeVar("Entry")


def at(entries: list[Entry], index: int, what: str, where: str) -> Entry:
    """Entry ``index`` of a table of the document.

    Raises
    ------
    MeshError
        If the document has no such entry: a dangling reference.
    """
    if index >= len(entries):
        raise MeshError(f"glTF {where} names {what} {index} of {len(entries)}; repair or re-export the file")
    return entries[index]


class Accessors:
    """The arrays of one document; buffers are opened once."""

    def __init__(self, document: Document) -> None:
        self._document = document
        self._gltf = document.gltf

    @cached_property
    def _buffers(self) -> list[Bytes | None]:
        return [self._open(number, buffer) for number, buffer in enumerate(self._gltf.buffers)]

    def _open(self, number: int, buffer: Buffer) -> Bytes | None:
        """Bytes of a buffer, None where it has none of its own (a fallback of a compressing extension)."""
        data: Bytes | None
        try:
            if buffer.uri is None:
                data = self._document.chunk if number == 0 else None
            elif buffer.uri.startswith("data:"):
                data = base64.b64decode(buffer.uri.partition(",")[2], validate=True)
            elif urlsplit(buffer.uri).scheme or buffer.uri.startswith(("/", "\\")):
                raise MeshError("is not named relative to the file, and nothing is fetched from elsewhere")
            else:
                data = content(self._document.path.parent / unquote(buffer.uri))
        except (MeshError, binascii.Error) as error:
            raise MeshError(f"glTF buffer {number} {(buffer.uri or '')[:60]!r} {error}") from error
        if data is not None and len(data) < buffer.byte_length:
            raise MeshError(f"glTF buffer {number} announces {buffer.byte_length} bytes and has {len(data)}")
        return data

    def check_all(self, contents: bool) -> None:
        """Refuse missing buffers and dangling references; with ``contents`` also NaN and infinities.

        Raises
        ------
        MeshError
            At the first buffer or accessor that is wrong.
        """
        views, buffers = self._gltf.buffer_views, self._buffers
        for number, accessor in enumerate(self._gltf.accessors):
            if accessor.buffer_view is not None:
                view = at(views, accessor.buffer_view, "buffer view", f"accessor {number}")
                if at(buffers, view.buffer, "buffer", f"buffer view {accessor.buffer_view}") is None:
                    continue
            dense = self._dense(accessor, number)
            if accessor.sparse is not None:
                self._replacements(dense, accessor.sparse, f"accessor {number}")
            if contents and dense.dtype.kind == "f" and not np.isfinite(dense).all():
                raise MeshError(f"glTF accessor {number} holds NaN or infinite numbers; repair the file")

    def view_bytes(self, number: int, where: str) -> memoryview:
        """Bytes of a buffer view, such as a packed picture.

        Raises
        ------
        MeshError
            If the view or its buffer is missing or too short.
        """
        length = at(self._gltf.buffer_views, number, "buffer view", where).byte_length
        return memoryview(self._strided(number, 0, length, np.dtype("u1"), 1, where).reshape(-1).data)

    def array(self, number: int, where: str) -> Array:
        """Elements of an accessor, as stored: not scaled where it is normalized.

        Parameters
        ----------
        number : int
            Of the accessor.
        where : str
            Who asks, for the error of a dangling reference.

        Returns
        -------
        (count, components) array
            A view of the buffer where it can be.

        Raises
        ------
        MeshError
            If the accessor or its view or buffer is missing, or the elements do not fit in them.
        """
        accessor = at(self._gltf.accessors, number, "accessor", where)
        dense = self._dense(accessor, number)
        if accessor.sparse is None:
            return dense
        indices, values = self._replacements(dense, accessor.sparse, f"accessor {number}")
        if len(indices) and int(indices.max()) >= len(dense):
            raise MeshError(
                f"glTF accessor {number} replaces an element beyond its {len(dense)}; repair the file"
            )
        full = dense.copy()
        full[indices] = values
        return full

    def scaled(self, number: int, where: str) -> npt.NDArray[np.floating]:
        """Elements of an accessor as float32 or, where it holds integers, as the float64 they stand for."""
        stored = self.array(number, where)
        if stored.dtype.kind == "f":
            return stored.astype(np.float32, copy=False)
        values = stored.astype(np.float64)
        if self._gltf.accessors[number].normalized:
            values = np.maximum(values / np.iinfo(stored.dtype.str).max, -1.0)
        return values

    def _dense(self, accessor: Accessor, number: int) -> Array:
        """Elements before any are replaced."""
        if accessor.type not in SHAPES or accessor.component_type not in COMPONENTS:
            kind = f"{accessor.type[:20]!r} of {accessor.component_type}"
            raise MeshError(f"glTF accessor {number} is of the unknown type {kind}; repair the file")
        dtype = np.dtype(COMPONENTS[accessor.component_type])
        rows, columns = SHAPES[accessor.type]
        if accessor.buffer_view is None:
            return self._zeros(accessor, dtype, rows * columns, number)
        # matrix columns are padded; nothing here reads matrices but for their range
        column = -(-rows * dtype.itemsize // 4) * 4 if columns > 1 else rows * dtype.itemsize
        width = column * columns // dtype.itemsize
        name = f"accessor {number}"
        return self._strided(accessor.buffer_view, accessor.byte_offset, accessor.count, dtype, width, name)

    def _zeros(self, accessor: Accessor, dtype: np.dtype[np.generic], width: int, number: int) -> Array:
        """Elements of an accessor without data; their number must be in proportion to the file."""
        if accessor.count > max(1024, sum(len(data) for data in self._buffers if data)):
            raise MeshError(
                f"glTF accessor {number} has no data for its {accessor.count} elements; export it again"
            )
        return np.zeros((accessor.count, width), dtype)

    def _strided(
        self, view_number: int, offset: int, count: int, dtype: np.dtype[np.generic], width: int, name: str
    ) -> Array:
        view = at(self._gltf.buffer_views, view_number, "buffer view", name)
        data = at(self._buffers, view.buffer, "buffer", f"buffer view {view_number}")
        if data is None:
            raise MeshError(
                f"glTF {name} lies in buffer {view.buffer}, which has no data; export the file again"
            )
        size = width * dtype.itemsize
        stride = view.byte_stride or size
        if view.byte_offset + view.byte_length > len(data):
            raise MeshError(
                f"glTF buffer view {view_number} ends at byte {view.byte_offset + view.byte_length} and its "
                f"buffer at {len(data)}; the file is truncated or malformed: export it again"
            )
        if stride < size or (count and offset + (count - 1) * stride + size > view.byte_length):
            raise MeshError(
                f"glTF {name} needs {offset + count * stride} bytes (stride {stride}) and its buffer view "
                f"has {view.byte_length}; export the file again"
            )
        if count == 0:
            return np.zeros((0, width), dtype)
        return np.ndarray((count, width), dtype, data, view.byte_offset + offset, (stride, dtype.itemsize))

    def _replacements(
        self, dense: Array, sparse: Sparse, name: str
    ) -> tuple[npt.NDArray[np.unsignedinteger], Array]:
        """Which elements of ``dense`` are replaced, and by what."""
        if sparse.indices.component_type not in (5121, 5123, 5125):
            raise MeshError(
                f"glTF {name} has sparse indices of type {sparse.indices.component_type}; repair it"
            )
        dtype = np.dtype(COMPONENTS[sparse.indices.component_type])
        view, offset = sparse.indices.buffer_view, sparse.indices.byte_offset
        indices = self._strided(view, offset, sparse.count, dtype, 1, f"{name} (sparse indices)")
        view, offset = sparse.values.buffer_view, sparse.values.byte_offset
        values = self._strided(
            view, offset, sparse.count, dense.dtype, dense.shape[1], f"{name} (sparse values)"
        )
        return indices.reshape(-1).astype(dtype), values
