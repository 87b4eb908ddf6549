"""The header of a PLY file: which elements follow, and of what properties each is made."""

from __future__ import annotations

import re
from dataclasses import dataclass

from clgrid.errors import MeshError
from clgrid.meshfile.content import Content

TYPES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
"""PLY's names of types, old and new, as numpy's without byte order."""

BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class Property:
    """One value of an element, or one list of values.

    Attributes
    ----------
    name : str
    type : str
        numpy type of the value or of each list entry, without byte order.
    count_type : str or None
        numpy type of the length in front of a list, None for a single value.
    """

    name: str
    type: str
    count_type: str | None = None


@dataclass(frozen=True)
class Element:
    """A table of the file: ``count`` rows of the same properties."""

    name: str
    count: int
    properties: tuple[Property, ...]

    def find(self, *names: str) -> Property | None:
        """First property of one of these names."""
        return next((entry for entry in self.properties if entry.name in names), None)


@dataclass(frozen=True)
class Header:
    """What the header says, unchecked against the size of the file.

    Attributes
    ----------
    byte_order : str
        ``<`` or ``>``, empty for text.
    elements : tuple of Element
        In the order of the data.
    body : int
        Offset of the first byte of data.
    comments : tuple of str
        What follows the word ``comment`` on each such line.
    """

    byte_order: str
    elements: tuple[Element, ...]
    body: int
    comments: tuple[str, ...] = ()

    @property
    def has_faces(self) -> bool:
        """Whether faces or strips are announced."""
        return any(element.name in ("face", "tristrips") and element.count for element in self.elements)


def read_header(data: Content) -> Header:
    """Parse the header.

    Raises
    ------
    MeshError
        If it is no PLY header or an incomplete or contradictory one, with the line.
    """
    if not re.match(rb"ply[ \t]*[\r\n]", data):
        raise MeshError("does not begin with the line 'ply'; it is no PLY file")
    end = re.search(rb"[\r\n]end_header[ \t]*(\r\n|\n|\r)", data)
    if end is None:
        raise MeshError("has no line 'end_header' in its PLY header; it is truncated or damaged")
    text = data[: end.start()]
    body = end.end()
    if end.group(1) == b"\r\n" and b"\n" not in text:
        body -= 1  # lines of this header end in CR alone, so the LF is the first byte of the data
    byte_order: str | None = None
    elements: list[tuple[str, int, list[Property]]] = []
    comments: list[str] = []
    for number, line in enumerate(text.decode("latin-1").splitlines(), 1):
        words = line.split()
        if words and words[0] == "comment":
            comments.append(line.strip().removeprefix("comment").strip())
        if not words or words[0] in ("ply", "comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) == 3 and words[1] in BYTE_ORDERS:
            byte_order = BYTE_ORDERS[words[1]]
        elif words[0] == "element" and len(words) == 3 and words[2].isascii() and words[2].isdigit():
            elements.append((words[1], int(words[2]), []))
        elif words[0] == "property" and elements:
            elements[-1][2].append(_property(words, number))
        else:
            raise MeshError(f"PLY header line {number} is not understood: {line[:80]!r}; repair the header")
    if byte_order is None:
        raise MeshError(
            "PLY header has no line 'format ascii|binary_little_endian|binary_big_endian 1.0'; add it"
        )
    named = tuple(Element(name, count, tuple(entries)) for name, count, entries in elements)
    _require_distinct_names(named)
    return Header(byte_order, named, body, tuple(comments))


def _property(words: list[str], number: int) -> Property:
    if len(words) == 3 and words[1] in TYPES:
        return Property(words[2], TYPES[words[1]])
    if len(words) == 5 and words[1] == "list" and words[2] in TYPES and words[3] in TYPES:
        count_type = TYPES[words[2]]
        if count_type.startswith("f"):
            raise MeshError(
                f"PLY header line {number}: a list length cannot be a {words[2]}; repair the header"
            )
        return Property(words[4], TYPES[words[3]], count_type)
    raise MeshError(
        f"PLY header line {number} is not understood: {' '.join(words)[:80]!r}; repair the header"
    )


def _require_distinct_names(elements: tuple[Element, ...]) -> None:
    for names in (
        [entry.name for entry in elements],
        *([p.name for p in entry.properties] for entry in elements),
    ):
        if len(set(names)) != len(names):
            raise MeshError(
                f"PLY header names the same thing twice: {', '.join(names)[:80]}; repair the header"
            )
