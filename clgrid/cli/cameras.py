"""The camera's options, which verbs that look at scenes share, and the camera that they describe."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from clgrid.cli import options
from clgrid.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from clgrid.camera import Camera
    from clgrid.scene import Scene

CameraName = Annotated[
    str,
    typer.Option(
        "--camera",
        metavar="NAME|INDEX|FILE.json",
        help="A camera of the glTF file, or of a camera file.",
        rich_help_panel=options.CAMERA,
        show_default=False,
    ),
]
Eye = Annotated[
    str, typer.Option(metavar="X,Y,Z", help="Where the camera stands.", rich_help_panel=options.CAMERA)
]
LookAt = Annotated[
    str, typer.Option(metavar="X,Y,Z", help="What it looks at.", rich_help_panel=options.CAMERA)
]
Up = Annotated[
    str,
    typer.Option(
        metavar="AXIS|X,Y,Z",
        help="Up in the picture: x, -z, ... auto takes z for STL and for flat scenes, else y.",
        rich_help_panel=options.CAMERA,
    ),
]
Fov = Annotated[
    float | None,
    typer.Option(
        metavar="DEGREES",
        help="Vertical field of view; 40 if not the camera's own.",
        rich_help_panel=options.CAMERA,
        show_default=False,
    ),
]


def choose_camera(
    scene: Scene, aspect: float, camera: str, eye: str, look_at: str, up: str, fov: float | None
) -> Camera:
    """Return the camera that the options describe.

    Raises
    ------
    InputError
        If they contradict each other or name no camera.
    """
    from dataclasses import replace

    from clgrid.camera import DEFAULT_FOV, Camera
    from clgrid.scene import default_camera, named_camera, parse_up, parse_vector

    if camera:
        if eye or look_at or up != "auto":
            raise InputError("--camera brings its own place: leave out --eye, --look-at and --up")
        found = named_camera(scene, camera)
        return found if fov is None else replace(found, fov=fov, fov_axis="y")
    upward = parse_up(up, scene)
    framed = default_camera(scene, aspect, upward, DEFAULT_FOV if fov is None else fov)
    if not eye and not look_at:
        return framed
    start = parse_vector(eye, "--eye") if eye else framed.eye
    if look_at:
        target = parse_vector(look_at, "--look-at")
    elif scene.mesh.triangle_count:
        low, high = scene.mesh.bounds.tolist()
        target = (low[0] / 2 + high[0] / 2, low[1] / 2 + high[1] / 2, low[2] / 2 + high[2] / 2)
    else:
        target = (0.0, 0.0, 0.0)
    return Camera.look_at(start, target, upward, framed.fov)


def view_of(
    camera: str, eye: str, look_at: str, up: str, fov: float | None
) -> Callable[[Scene, float], Camera] | None:
    """What makes the camera of each scene; None where no option speaks of it."""
    if not camera and not eye and not look_at and up == "auto" and fov is None:
        return None
    return lambda scene, aspect: choose_camera(scene, aspect, camera, eye, look_at, up, fov)
