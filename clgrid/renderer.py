"""Draw a scene: cast the camera's rays through a grid on the device, shade what they hit.

Named ``renderer`` so that ``clgrid.render`` can be the function.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

import clgrid
from clgrid.camera import Camera
from clgrid.cast import part_defines
from clgrid.device import Device
from clgrid.errors import InputError
from clgrid.grid import Grid, build
from clgrid.image import NO_ID, Attribute, Image
from clgrid.look import Look, Shading
from clgrid.memory import Allocator
from clgrid.mesh import Mesh
from clgrid.program import kernel
from clgrid.recipe import kinds
from clgrid.scene import Scene, default_camera
from clgrid.shading.order import Order, Window, check_order
from clgrid.shading.staged import draw_staged
from clgrid.shading.stand_in import few, stand_in, traits
from clgrid.shading.surfaces import look_defines
from clgrid.target import MeshPart
from clgrid.tuning import tuning_of

PLAIN_AOVS = ("depth", "normal", "id", "steps", "t_err")
"""What the one kernel of plain pictures makes."""
AOVS = (*PLAIN_AOVS, "P", "uv", "albedo", "coverage")
DEFAULT_BACKGROUND = (0.9, 0.9, 0.9)

_BLOCK = 16  # as in cl/render.cl
_MOST_PIXELS = 1 << 28
# Bands of a picture whose progress is watched: each costs one launch.
_BANDS = 16
_LARGEST_BUFFER = 1 << 30
_BYTES_PER_PIXEL = 16

Progress = Callable[[float], None]


def render(
    scene: Scene | Mesh,
    camera: Camera | None = None,
    width: int = 1024,
    height: int = 1024,
    aovs: Sequence[str] = (),
    *,
    grid: Grid | None = None,
    background: Sequence[float] = DEFAULT_BACKGROUND,
    progress: Progress | None = None,
    look: Look | None = None,
    shading: Shading | None = None,
    crop: Window | None = None,
    **build_options: Any,
) -> Image:
    """Render a picture of a scene, the same bits on every device.

    One ray a pixel and a light at the eye, unless ``shading`` says otherwise.

    Parameters
    ----------
    scene : Scene or Mesh
        What to draw. Vertex normals are used where the mesh has them.
    camera : Camera, optional
        By default a three-quarter view of the whole scene.
    width, height : int
        Pixels of the whole picture.
    aovs : sequence of {"depth", "normal", "id", "steps", "t_err", "P", "uv", "albedo", "coverage"}
        Further channel groups of the image. All but coverage are of the ray through the pixel's middle,
        however many samples there are.
    grid : Grid, optional
        Of this very mesh; by default one is built with ``build_options``.
    background : (float, float, float)
        Linear colour where no triangle is hit.
    progress : callable, optional
        Called with the share of rows done, from 0 to 1.
    look : Look, optional
        Materials, textures and lights, for ``shading`` and the AOVs uv and albedo; by default the scene's
        own, or none: grey.
    shading : Shading, optional
        How the picture is lit and sampled. Rays then pass masked texels and backs of single-sided surfaces.
    crop : (x0, y0, x1, y1), optional
        Only the pixels from column x0 and row y0 to before x1 and y1, with the bits that they have in the
        whole.
    **build_options
        As for ``clgrid.build``: layout, density, resolution, accuracy, device, max_memory, skipping; ``rays``
        is the number of pixels, ``view`` the camera.

    Returns
    -------
    Image
        Its metadata tell device, grid, camera and seconds.

    Raises
    ------
    InputError
        If a size, an AOV name, the crop or the background is out of range, the grid is of another mesh, its
        rung knows no error of t, or look or shading do not fit.
    GridTooLargeError, DeviceError
        As ``clgrid.build``.
    """
    mesh = scene.mesh if isinstance(scene, Scene) else scene
    _check(width, height, aovs, background)
    window = _window(crop, width, height)
    view = camera or default_camera(scene, width / height)
    if look is None and isinstance(scene, Scene) and needs_look(aovs, shading):
        look = scene.look
    wanted = look if needs_look(aovs, shading) else None
    order = Order(view, (width, height), window, background, wanted, shading)
    check_order(order, mesh)  # before there is a grid
    if grid is None:
        grid = build(mesh, **{"rays": width * height, "view": view, **build_options})
    elif grid.mesh is not mesh or build_options:
        raise InputError("render: the grid is of another mesh or has build options beside it; give one")
    if "t_err" in aovs and grid.accuracy == "fast":
        raise InputError("render: the AOV t_err is of the strict rungs, not of fast; choose one of those")
    start = time.perf_counter()
    # Several parts each leave the pixels of the parts before, where those are nearer.
    staged = _takes_stages(order, aovs)
    filled = grid.empty or staged or len(grid.standing) > 1
    image = _blank(window[2] - window[0], window[3] - window[1], aovs, background, filled=filled)
    stages: dict[str, float] = {}
    if staged and not grid.empty:
        stages = draw_staged(grid, order, image, progress)
    elif not grid.empty:
        _draw(grid, order, image, progress)
    image.crop, image.full_size = window[:2], None if crop is None else (width, height)
    if image.primitive_id is not None:
        image.geometry_id = _geometry_ids(mesh, image.primitive_id)
    seconds = time.perf_counter() - start
    options = look_defines(order.look) if staged and order.look else kernel_options(mesh, aovs)
    image.metadata = _metadata(mesh, grid, view, options | grid.rung.defines, seconds)
    image.metadata |= _told_of(order, stages, cropped=crop is not None)
    image.metadata["worldToNDC"] = view.world_to_ndc(width, height)
    return image


def needs_look(aovs: Sequence[str], shading: Shading | None) -> bool:
    """Whether a picture shows materials: a plain one does not, and no textures are decoded for it."""
    return shading is not None or "uv" in aovs or "albedo" in aovs


def _takes_stages(order: Order, aovs: Sequence[str]) -> bool:
    """Whether the picture is more than one kernel draws."""
    parallel = order.camera.orthographic_height is not None
    return parallel or order.shading is not None or not set(aovs) <= set(PLAIN_AOVS)


def _window(crop: Window | None, width: int, height: int) -> Window:
    if crop is None:
        return (0, 0, width, height)
    if len(crop) != 4 or not all(isinstance(x, (int, np.integer)) for x in crop):
        raise InputError(f"render: crop {crop} is not four whole numbers; give x0, y0, x1, y1")
    x0, y0, x1, y1 = map(int, crop)
    if not (0 <= x0 < x1 <= width and 0 <= y0 < y1 <= height):
        raise InputError(f"render: crop {(x0, y0, x1, y1)} has no pixel of {width}x{height} or some beyond")
    return (x0, y0, x1, y1)


def _told_of(order: Order, stages: dict[str, float], *, cropped: bool) -> dict[str, Attribute]:
    """What metadata say of window and shading."""
    told: dict[str, Attribute] = {f"clgrid:render_{name}_s": value for name, value in stages.items()}
    if cropped:
        told["clgrid:crop"] = " ".join(map(str, order.window))
        told["clgrid:full_size"] = "x".join(map(str, order.size))
    if order.camera.orthographic_height is not None:
        told["clgrid:camera_orthographic_height"] = order.camera.orthographic_height
    if order.shading is not None:
        shading = order.shading
        told |= {
            "clgrid:samples": shading.samples,
            "clgrid:seed": str(shading.seed),
            "clgrid:occlusion_rays": shading.occlusion_rays,
            "clgrid:occlusion_distance": shading.occlusion_distance,
        }
    return told


def kernel_options(mesh: Mesh, aovs: Sequence[str]) -> dict[str, int | str]:
    """Return the ``-D`` options with which cl/render.cl is compiled: only what is asked for."""
    macros = {
        **{name: f"AOV_{name.upper()}" for name in PLAIN_AOVS},
        "steps": "COUNT_STEPS",
        "t_err": "WITH_T_ERR",
    }
    options: dict[str, int | str] = {macros[name]: 1 for name in PLAIN_AOVS if name in aovs}
    if mesh.vertex_normals is not None:
        options |= {"SMOOTH_NORMALS": 1, "WITH_UVS": 1}
    return options


def warm_up(
    device: Device | str | None = None,
    aovs: Sequence[str] = (),
    *,
    smooth: bool = False,
    layout: str = "compact",
    skipping: bool | str = False,
    look: Look | None = None,
    shading: Shading | None = None,
    orthographic: bool = False,
    **build_options: Any,
) -> float:
    """Compile what a build and a render need by drawing one triangle, in every layout that may be chosen.

    Where something is to be chosen, the device's constants are fitted too. Queries compile at their first
    call: to have that behind you, cast a ray.

    Parameters
    ----------
    device : Device or str, optional
        As of ``clgrid.build``.
    aovs, smooth, layout, skipping, look, shading, build_options
        As the later render: ``smooth`` if its mesh has vertex normals.
    orthographic : bool
        Whether its camera is.

    Returns
    -------
    seconds : float
        How long it took, compiling above all; next to nothing the second time.

    Raises
    ------
    InputError, DeviceError
        As ``clgrid.build`` and ``clgrid.render``.
    """
    start = time.perf_counter()
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    normals = np.tile(np.array([[0, 0, 1]], np.float32), (3, 1)) if smooth else None
    triangle = Mesh(corners, np.array([[0, 1, 2]], np.uint32), vertex_normals=normals)
    build(triangle, layout, device=device, skipping=skipping, **build_options)
    seen: dict[str, Any] = {"aovs": aovs}
    if needs_look(aovs, shading):
        seen |= {"look": stand_in(traits(look), triangle), "shading": few(look, shading)}
    if orthographic:
        seen["camera"] = Camera.look_at((0, 0, 1), (0, 0, 0), orthographic_height=2.0)
    for each, skip in kinds(layout, skipping):
        options = {**build_options, "layout": each, "skipping": skip, "density": 1.0}
        render(triangle, width=_BLOCK, height=_BLOCK, device=device, **seen, **options)
    return time.perf_counter() - start


def check_aovs(aovs: Sequence[str]) -> None:
    """Refuse a name that is of no AOV.

    Raises
    ------
    InputError
        With the names that there are.
    """
    unknown = [name for name in aovs if name not in AOVS]
    if unknown:
        raise InputError(f"render: unknown AOV {unknown[0]!r}; choose of {', '.join(AOVS)}")


def _check(width: int, height: int, aovs: Sequence[str], background: Sequence[float]) -> None:
    if width < 1 or height < 1 or width * height > _MOST_PIXELS:
        raise InputError(f"render: size {width}x{height}; give at least 1x1 and at most 2^28 pixels")
    check_aovs(aovs)
    if len(background) != 3 or not np.isfinite(background).all():
        raise InputError(f"render: background {tuple(background)} is not three finite numbers")


def _blank(
    width: int, height: int, aovs: Sequence[str], background: Sequence[float], *, filled: bool
) -> Image:
    """Make the picture of nothing; or, if rendering writes every pixel, arrays that hold anything."""

    def channels(name: str, value: float, real: type[np.generic], *depth: int) -> npt.NDArray[Any] | None:
        if name not in aovs:
            return None
        array: npt.NDArray[Any] = np.empty((height, width, *depth), real)
        if filled:
            array.fill(value)
        return array

    rgba = np.empty((height, width, 4), np.float32)
    if filled:
        rgba[:] = (*background, 0)
    return Image(
        rgba,
        depth=channels("depth", np.inf, np.float32),
        normal=channels("normal", 0, np.float32, 3),
        primitive_id=channels("id", NO_ID, np.uint32),
        # The kernels count on from 0.
        steps=np.zeros((height, width), np.uint32) if "steps" in aovs else None,
        t_err=channels("t_err", 0, np.float32),
        position=channels("P", 0, np.float32, 3),
        uv=channels("uv", 0, np.float32, 2),
        albedo=channels("albedo", 0, np.float32, 3),
        coverage=channels("coverage", 0, np.float32),
    )


def _draw(grid: Grid, order: Order, image: Image, progress: Progress | None) -> None:
    device, mesh, parts = grid.device, grid.mesh, grid.standing
    aovs = [name for name, array in _aov_arrays(image) if array is not None]
    rung = grid.rung
    tuned = tuning_of(device).defines
    options = {**kernel_options(mesh, aovs), **part_defines(parts), **rung.defines, **tuned}
    allocator = Allocator(device)
    inputs = [allocator.upload(order.camera.params(*order.size, order.window)), grid.target.frame_params]
    colour = [np.float32(value) for value in order.background]
    normals = [_normals(mesh, part.mesh, allocator) for part in parts]
    arrays = [array for _, array in _aov_arrays(image) if array is not None]
    if len(parts) > 1:
        nearest = np.zeros((image.height, image.width, rung.nearest_reals), rung.real)
        nearest[..., 0] = np.inf
        arrays.append(nearest)
    arrays.append(image.rgba)
    blocks_across = -(-image.width // _BLOCK)
    for first, last in _bands(image.width, image.height, device, watched=progress is not None):
        pieces = [array[first:last] for array in arrays]
        outputs = [allocator.results(piece) for piece in pieces]
        blocks = blocks_across * -(-(last - first) // _BLOCK)
        for part, own_normals in zip(parts, normals, strict=True):
            draw = kernel(device, "render.cl", "render", **options, **part.defines)
            draw(
                device.queue, (blocks,), (1,), *inputs, *part.arguments, np.uint32(first),
                np.uint32(last - first), *colour, *own_normals, *outputs,
            )  # fmt: skip
        for piece, buffer in zip(pieces, outputs, strict=True):
            allocator.bring_home(piece, buffer)
        if progress is not None:
            progress(last / image.height)


def _normals(mesh: Mesh, part: MeshPart, allocator: Allocator) -> list[Any]:
    """The buffer of the normals of a part's vertices, if the mesh has normals."""
    if mesh.vertex_normals is None:
        return []
    return [allocator.share(mesh.vertex_normals if part.used is None else mesh.vertex_normals[part.used])]


def _aov_arrays(image: Image) -> list[tuple[str, npt.NDArray[Any] | None]]:
    """Pair each AOV with its array, in the order of the kernel's arguments."""
    return [
        ("depth", image.depth),
        ("normal", image.normal),
        ("id", image.primitive_id),
        ("steps", image.steps),
        ("t_err", image.t_err),
    ]


def _bands(width: int, height: int, device: Device, *, watched: bool) -> Iterator[tuple[int, int]]:
    """Split the rows into bands: one, more if watched or if a buffer would be too large."""
    largest = min(_LARGEST_BUFFER, device.description.max_allocation)
    rows = max(1, largest // (_BYTES_PER_PIXEL * width))
    if watched:
        rows = min(rows, -(-height // _BANDS))
    if rows > _BLOCK:
        rows -= rows % _BLOCK
    for first in range(0, height, rows):
        yield first, min(first + rows, height)


def _geometry_ids(mesh: Mesh, primitive_ids: npt.NDArray[np.uint32]) -> npt.NDArray[np.uint32]:
    """Look up the geometry of each triangle id; NO_ID stays NO_ID."""
    found = np.searchsorted(mesh.geometry_starts, primitive_ids.astype(np.int64), side="right") - 1
    return np.where(primitive_ids == NO_ID, NO_ID, found).astype(np.uint32)


def _metadata(
    mesh: Mesh, grid: Grid, camera: Camera, options: dict[str, int | str], seconds: float
) -> dict[str, Attribute]:
    device = grid.device
    entries: dict[str, Attribute] = {
        "Software": f"clgrid {clgrid.__version__}",
        "worldToCamera": camera.world_to_camera(),
        "clgrid:source": mesh.source,
        "clgrid:triangles": mesh.triangle_count,
        "clgrid:device": device.name,
        "clgrid:driver": device.driver_version,
        "clgrid:platform": device.platform,
        "clgrid:kernel_options": " ".join(f"-D{key}={value}" for key, value in options.items()),
        "clgrid:layout": grid.layout,
        "clgrid:accuracy": grid.accuracy,
        "clgrid:grid_bytes": grid.nbytes,
        "clgrid:camera_name": camera.name,
        "clgrid:camera_eye": _text(camera.eye),
        "clgrid:camera_forward": _text(camera.forward),
        "clgrid:camera_up": _text(camera.up),
        "clgrid:camera_fov": camera.fov,
        "clgrid:camera_fov_axis": camera.fov_axis,
        "clgrid:render_s": seconds,
    }
    if not grid.empty:
        stats = grid.stats
        entries["clgrid:resolution"] = "x".join(map(str, stats.resolution))
        entries["clgrid:references"] = stats.references
        entries["clgrid:upload_s"] = grid.upload_s
        for stage, value in stats.build_s.items():
            entries[f"clgrid:build_{stage}_s"] = value
    return entries


def _text(vector: npt.NDArray[np.float64]) -> str:
    """Write a vector so that reading it gives the same doubles; EXR attributes hold floats only."""
    return " ".join(repr(float(value)) for value in vector)
