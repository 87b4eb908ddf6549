"""Options of ``clgrid render`` for light, files and jobs."""

from __future__ import annotations

from typing import Annotated

import typer

from clgrid.cli import options

LIGHT = "Light"


def _light(flag: str, metavar: str | None, text: str) -> typer.models.OptionInfo:
    found: typer.models.OptionInfo = typer.Option(
        flag, metavar=metavar, help=text, rich_help_panel=LIGHT, show_default=False
    )
    return found


def _file(flag: str, metavar: str | None, text: str, default: bool = False) -> typer.models.OptionInfo:
    found: typer.models.OptionInfo = typer.Option(
        flag, metavar=metavar, help=text, rich_help_panel=options.OUTPUT, show_default=default
    )
    return found


Samples = Annotated[int | None, _light("--samples", "N", "Rays a pixel.")]
Seed = Annotated[int | None, _light("--seed", "N", "Of the places of samples and of occlusion rays.")]
Lights = Annotated[
    bool | None, _light("--lights/--no-lights", None, "Whether the scene's own lights are lit.")
]
Sun = Annotated[str, _light("--sun", "X,Y,Z", "Direction from the scene to a sun.")]
SunStrength = Annotated[float | None, _light("--sun-strength", "LUX", "Of the sun.")]
Sky = Annotated[str, _light("--sky", "COLOUR", "Linear light from everywhere: R,G,B, one grey, or #rrggbb.")]
OcclusionRays = Annotated[
    int | None, _light("--occlusion-rays", "N", "Rays a sample that look for the open share of the sky.")
]
OcclusionDistance = Annotated[
    float | None, _light("--occlusion-distance", "UNITS", "Beyond it nothing stands before the sky.")
]
Crop = Annotated[
    str,
    typer.Option(
        metavar="X0,Y0,X1,Y1",
        help="Draw only these pixels of the whole picture.",
        rich_help_panel=options.PICTURE,
        show_default=False,
    ),
]
Compression = Annotated[
    str | None,
    _file(
        "--compression",
        "NAME",
        "Of an .exr: none, rle, zips, zip, piz; of its colours: pxr24, b44, b44a, dwaa, dwab. Default: zips.",
    ),
]
Half = Annotated[bool, _file("--half", None, "Colours of an .exr in 16 bits; all else keeps 32.")]
Tile = Annotated[int | None, _file("--tile", "PIXELS", "An .exr in tiles of this side instead of scanlines.")]
Quality = Annotated[int | None, _file("--quality", "1-100", "Of a .jpg. Default: 90.")]
Frames = Annotated[
    str,
    typer.Option(
        "--frames",
        metavar="A..B|all",
        help="Frames of a scene that moves, from 0: 1..240, 0..100..5, 7, all.",
        rich_help_panel=options.PICTURE,
        show_default=False,
    ),
]
Vertices = Annotated[
    str,
    typer.Option(
        "--vertices",
        metavar="FILE.npy|FOLDER|PATTERN",
        help="What moves the mesh: vertices of each frame, float32 of shape (frames, vertices, 3), gzipped or"
        " not; or a mesh file a frame. Default: the glTF scene's own animation.",
        rich_help_panel=options.PICTURE,
        show_default=False,
    ),
]
Fps = Annotated[
    float | None,
    typer.Option(
        "--fps",
        metavar="N",
        help="Frames a second of an animation. Default: 24.",
        rich_help_panel=options.PICTURE,
        show_default=False,
    ),
]
Animation = Annotated[
    str,
    typer.Option(
        "--animation",
        metavar="NAME|INDEX",
        help="Which of a glTF scene's animations. Default: the first.",
        rich_help_panel=options.PICTURE,
        show_default=False,
    ),
]


def parse_crop(text: str) -> tuple[int, int, int, int] | None:
    """Read ``X0,Y0,X1,Y1``; the empty text is None.

    Raises
    ------
    InputError
        If it is not four integers from 0.
    """
    from clgrid.errors import InputError

    if not text:
        return None
    parts = text.split(",")
    if len(parts) != 4 or not all(part.strip().isdecimal() for part in parts):
        raise InputError(f"--crop {text!r}: give four integers as X0,Y0,X1,Y1")
    x0, y0, x1, y1 = (int(part) for part in parts)
    return x0, y0, x1, y1
