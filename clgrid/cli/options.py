"""Options that several verbs share, and how their words are read."""

from __future__ import annotations

import re
from typing import Annotated

import typer

from clgrid.errors import InputError

GRID, CAMERA, PICTURE, OUTPUT = "Grid and device", "Camera", "Picture", "Output"
_SCENE_HELP = "PLY, OBJ, STL, OFF, GLB or glTF file, gzipped or not; or demo, cube, icosphere:N, terrain:N."

SceneName = Annotated[str, typer.Argument(metavar="SCENE", help=_SCENE_HELP, show_default=False)]
SceneNames = Annotated[list[str], typer.Argument(metavar="SCENE...", help=_SCENE_HELP, show_default=False)]
Layout = Annotated[
    str,
    typer.Option(
        help="How cells find their triangles: compact, hashed, nested, nested-hashed, linked-list,"
        " dynamic-array; auto is the one that is estimated to be fastest.",
        rich_help_panel=GRID,
    ),
]
Density = Annotated[
    str,
    typer.Option(
        metavar="NUMBER|auto",
        help="Cells per triangle; the paper's is 4, auto is the fastest for this device, scene and rays.",
        rich_help_panel=GRID,
    ),
]
Resolution = Annotated[
    str,
    typer.Option(metavar="XxYxZ", help="Cells along each axis, instead of a density.", rich_help_panel=GRID),
]
Accuracy = Annotated[
    str, typer.Option(help="Rung of the accuracy ladder: fast, robust, precise, exact.", rich_help_panel=GRID)
]
DeviceName = Annotated[
    str | None,
    typer.Option(
        "--device",
        metavar="INDEX|NAME",
        help="OpenCL device by index, part of its name, or platform:device; see clgrid devices."
        " Default: CLGRID_DEVICE, or a CPU.",
        rich_help_panel=GRID,
        show_default=False,
    ),
]
MaxMemory = Annotated[
    str,
    typer.Option(metavar="BYTES", help="Refuse a larger grid: 500M, 2GiB, or bytes.", rich_help_panel=GRID),
]
Skipping = Annotated[
    bool,
    typer.Option(
        "--skipping/--no-skipping",
        help="Leap over empty space, for a byte every 64 cells; changes no answer.",
        rich_help_panel=GRID,
    ),
]
Rays = Annotated[
    int | None,
    typer.Option(min=0, help="How many rays the grid is for. Default: 1048576.", rich_help_panel=GRID),
]
Size = Annotated[str, typer.Option(metavar="WxH", help="Pixels.", rich_help_panel=PICTURE)]
Json = Annotated[
    bool, typer.Option("--json", help="Write one JSON document to stdout.", rich_help_panel=OUTPUT)
]
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", help="No table, progress or warnings.", rich_help_panel=OUTPUT)
]

_UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "ki": 2**10, "mi": 2**20, "gi": 2**30}


def parse_size(text: str) -> tuple[int, int]:
    """Read ``WxH`` in pixels.

    Raises
    ------
    InputError
        If it is not two positive integers.
    """
    width, height = _integers(text, 2, "--size", "1024x768")
    return width, height


def parse_resolution(text: str, what: str = "--resolution") -> tuple[int, int, int] | None:
    """Read ``XxYxZ`` cells; the empty text is None.

    Raises
    ------
    InputError
        If it is not three positive integers.
    """
    if not text:
        return None
    x, y, z = _integers(text, 3, what, "128x128x64")
    return x, y, z


def parse_density(text: str) -> float | str:
    """Read ``auto`` or a number.

    Raises
    ------
    InputError
        If it is neither.
    """
    if text == "auto":
        return text
    try:
        return float(text)
    except ValueError:
        raise InputError(f"--density {text!r}: give a number of cells per triangle, or auto") from None


def parse_bytes(text: str) -> int | None:
    """Read ``1500000``, ``500M`` or ``2GiB``; the empty text is None.

    Raises
    ------
    InputError
        If it is no such size.
    """
    if not text:
        return None
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([kmg]?i?)b?", text.lower())
    if match is None or match[2] not in _UNITS:
        raise InputError(f"--max-memory {text!r}: give bytes, such as 1500000, 500M or 2GiB")
    return int(float(match[1]) * _UNITS[match[2]])


def parse_seconds(text: str, what: str) -> float | None:
    """Read ``20ms``, ``1.5s`` or seconds; the empty text is None.

    Raises
    ------
    InputError
        If it is no such time.
    """
    if not text:
        return None
    match = re.fullmatch(r"(\d+(?:\.\d+)?(?:e-?\d+)?)\s*(ms|s|)", text.lower())
    if match is None:
        raise InputError(f"{what} {text!r}: give a time, such as 20ms, 1.5s, or seconds")
    return float(match[1]) * (1e-3 if match[2] == "ms" else 1.0)


def parse_numbers(text: str, what: str, example: str, *, whole: bool = False) -> list[float]:
    """Read numbers above 0, separated by commas; the empty text is none.

    Raises
    ------
    InputError
        If one is no such number.
    """
    try:
        found = [float(part) for part in text.split(",")] if text else []
    except ValueError:
        found = [-1.0]
    if not all(0 < number < float("inf") and (number == int(number) or not whole) for number in found):
        kind = "whole numbers" if whole else "numbers"
        raise InputError(f"{what} {text!r}: give {kind} above 0, separated by commas, such as {example}")
    return found


def parse_colour(text: str, what: str = "--background") -> tuple[float, float, float]:
    """Read a linear ``R,G,B``, one linear grey, or an sRGB ``#rrggbb``.

    Raises
    ------
    InputError
        If it is none of these.
    """
    match = re.fullmatch(r"#([0-9a-fA-F]{2})([0-9a-fA-F]{2})([0-9a-fA-F]{2})", text)
    if match is not None:
        red, green, blue = (_linear(int(pair, 16) / 255.0) for pair in match.groups())
        return red, green, blue
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) == 1:
        values = values * 3
    if len(values) != 3:
        raise InputError(f"{what} {text!r}: give linear R,G,B, one grey, or #rrggbb")
    return values[0], values[1], values[2]


def _linear(value: float) -> float:
    """Decode one sRGB value in [0, 1] (IEC 61966-2-1)."""
    return float(value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4)


def _integers(text: str, count: int, option: str, example: str) -> list[int]:
    parts = text.lower().split("x")
    if len(parts) != count or not all(part.isascii() and part.isdigit() and int(part) > 0 for part in parts):
        raise InputError(f"{option} {text!r}: give {count} positive integers, such as {example}")
    return [int(part) for part in parts]
