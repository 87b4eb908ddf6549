"""MTL files: the materials that OBJ files name."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from clgrid.look import Material, TextureUse, Wrap
from clgrid.lookfile.names import find_beside
from clgrid.lookfile.pictures import Allowance, PictureError, Pixels, read_picture
from clgrid.lookfile.shelf import BLACK, MAGENTA, Shelf, Texel

# How many words follow each option of a map statement; -s, -o and -t take up to three numbers.
_OPTIONS = {"-blendu": 1, "-blendv": 1, "-boost": 1, "-bm": 1, "-cc": 1, "-clamp": 1, "-imfchan": 1}
_OPTIONS |= {"-texres": 1, "-type": 1, "-mm": 2}
_VECTORS = ("-s", "-o", "-t")


@dataclass(frozen=True)
class Map:
    """A texture as a statement names it.

    Attributes
    ----------
    name : str
        Of the file, as written.
    scale, offset : (float, float)
        Applied to u, v with v upwards.
    clamp : bool
        Whether what is beyond 0 and 1 is the border.
    """

    name: str
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)
    clamp: bool = False


@dataclass
class Statement:
    """One ``newmtl`` and what follows it; colours as written, taken as linear."""

    name: str
    colour: tuple[float, float, float] | None = None
    emissive: tuple[float, float, float] = (0.0, 0.0, 0.0)
    alpha: float = 1.0
    colour_map: Map | None = None
    emissive_map: Map | None = None
    alpha_map: Map | None = None


def read_statements(path: Path, shelf: Shelf) -> dict[str, Statement]:
    """Materials of a file by name; lines that make no sense are left out with a warning.

    Of a name given twice, the first counts.
    """
    try:
        text = path.read_bytes().decode("utf-8", "replace").removeprefix("\ufeff")
    except OSError as error:
        shelf.warn(f"material file {path.name!r} cannot be read ({error.strerror})")
        return {}
    found: dict[str, Statement] = {}
    current = Statement("")
    for line in text.splitlines():
        key, _, rest = line.strip().partition(" ") if "\t" not in line else _tabbed(line)
        if key.lower() == "newmtl":
            current = Statement(rest.strip())
            found.setdefault(current.name, current)
        elif key and not key.startswith("#"):
            try:
                _take(current, key.lower(), rest.strip())
            except ValueError:
                shelf.warn(f"left out: lines of {path.name!r} that are not understood, such as {key[:20]!r}")
    return found


def _tabbed(line: str) -> tuple[str, str, str]:
    words = line.split(None, 1)
    return (words[0] if words else "", " ", words[1] if len(words) > 1 else "")


def _take(into: Statement, key: str, rest: str) -> None:
    """Take in one line.

    Raises
    ------
    ValueError
        If it is malformed.
    """
    if key == "kd":
        into.colour = _colour(rest)
    elif key == "ke":
        into.emissive = _colour(rest)
    elif key == "d":
        into.alpha = _share(rest.removeprefix("-halo"))
    elif key == "tr":
        # by the specification 1 lets all through, which nobody means: older exporters write it for opaque
        into.alpha = 1.0 - _share(rest) if _share(rest) < 1 else 1.0
    elif key == "map_kd":
        into.colour_map = _map(rest)
    elif key == "map_ke":
        into.emissive_map = _map(rest)
    elif key == "map_d":
        into.alpha_map = _map(rest)


def _colour(rest: str) -> tuple[float, float, float]:
    """Three numbers, or one for all three; spectral curves are none."""
    values = [float(word) for word in rest.split("#")[0].split()]
    if len(values) not in (1, 3) or not all(math.isfinite(value) and value >= 0 for value in values):
        raise ValueError
    return (values[0], values[-2 % len(values)], values[-1])


def _share(rest: str) -> float:
    value = float(rest.split("#")[0])
    if not math.isfinite(value):
        raise ValueError
    return min(max(value, 0.0), 1.0)


def _map(rest: str) -> Map:
    """Options and then the name, which may hold spaces."""
    found, words = Map(""), rest
    while words.startswith("-"):
        option, _, words = words.partition(" ")
        option = option.lower()
        if option in _VECTORS:
            values: list[float] = []
            while len(values) < 3:
                word, _, after = words.lstrip().partition(" ")
                try:
                    values.append(float(word))
                except ValueError:
                    break
                words = after
            if not values:
                raise ValueError
            pair = (values[0], values[1] if len(values) > 1 else (1.0 if option == "-s" else 0.0))
            if not np.isfinite(pair).all():
                raise ValueError
            if option == "-s":
                found = replace(found, scale=pair)
            elif option == "-o":
                found = replace(found, offset=pair)
        elif option in _OPTIONS:
            values_of = words.split(None, _OPTIONS[option])
            if len(values_of) <= _OPTIONS[option]:
                raise ValueError
            if option == "-clamp":
                found = replace(found, clamp=values_of[0].lower() == "on")
            words = values_of[-1]
        else:
            break
        words = words.lstrip()
    if not words:
        raise ValueError
    return replace(found, name=words)


def material_of(statement: Statement, folder: Path, shelf: Shelf) -> Material:
    """What a statement stands for.

    The map is multiplied by Kd, but for a Kd of black, which exporters write beside maps. A mask (map_d) goes
    into the alpha of the map; where it has another size, it is left out with a warning.
    """
    colour = statement.colour or (1.0, 1.0, 1.0)
    if statement.colour_map is not None and not any(colour):
        colour = (1.0, 1.0, 1.0)
    emissive = statement.emissive
    if statement.emissive_map is not None and not any(emissive):
        emissive = (1.0, 1.0, 1.0)
    use, masked = _base(statement, folder, shelf)
    alpha_mode: Literal["opaque", "mask", "blend"] = "blend" if statement.alpha < 1 else "opaque"
    return Material(
        name=statement.name,
        base_colour=(*colour, statement.alpha),
        base_texture=use,
        emissive=emissive,
        emissive_texture=_use(statement.emissive_map, folder, shelf, BLACK),
        alpha_mode="mask" if masked else alpha_mode,
    )


def _base(statement: Statement, folder: Path, shelf: Shelf) -> tuple[TextureUse | None, bool]:
    """The map of colours, and whether it is a mask too."""
    colour, mask = statement.colour_map, statement.alpha_map
    if mask is None:
        return _use(colour, folder, shelf, MAGENTA), False
    alpha = _pixels(mask, folder, shelf)
    base = None if colour is None else _pixels(colour, folder, shelf)
    same = colour is None or (colour.scale, colour.offset) == (mask.scale, mask.offset)
    fits = base is None or (not isinstance(base, str) and base.shape == np.shape(alpha))
    if isinstance(alpha, str) or isinstance(base, str) or not (same and fits):
        why = alpha if isinstance(alpha, str) else "does not fit its colours"
        shelf.warn(f"left out: mask {mask.name!r}, which {why}")
        return _use(colour, folder, shelf, MAGENTA), False
    joined = np.full_like(alpha, 255) if base is None else base.copy()
    # a mask with an alpha of its own means that, any other its grey
    joined[..., 3] = alpha[..., 3] if (alpha[..., 3] < 255).any() else alpha[..., 0]
    name = mask.name if colour is None else f"{colour.name} with {mask.name}"
    return _use(colour or mask, folder, shelf, MAGENTA, ("mask", name), joined, name), True


def _use(
    wanted: Map | None,
    folder: Path,
    shelf: Shelf,
    stand_in: Texel,
    key: tuple[str, str] | None = None,
    pixels: Pixels | None = None,
    name: str | None = None,
) -> TextureUse | None:
    if wanted is None:
        return None
    wrap: tuple[Wrap, Wrap] = ("clamp", "clamp") if wanted.clamp else ("repeat", "repeat")

    def decode(allowance: Allowance) -> Pixels:
        return _read(wanted.name, folder, allowance) if pixels is None else pixels

    number = shelf.texture(key or wanted.name, name or wanted.name, decode, wrap, stand_in=stand_in)
    return TextureUse(number, 0, _matrix(wanted))


def _pixels(wanted: Map, folder: Path, shelf: Shelf) -> Pixels | str:
    return shelf.picture(wanted.name, lambda allowance: _read(wanted.name, folder, allowance))


def _read(name: str, folder: Path, allowance: Allowance) -> Pixels:
    found = find_beside(folder, name)
    if found is None:
        raise PictureError("is missing")
    return read_picture(found, allowance)


def _matrix(wanted: Map) -> Any:
    """(2, 3) for v downwards of what the map says for v upwards; None where it does nothing."""
    (su, sv), (du, dv) = wanted.scale, wanted.offset
    matrix = np.array([[su, 0.0, du], [0.0, sv, 1.0 - sv - dv]])
    return None if np.array_equal(matrix, np.eye(2, 3)) else matrix
