"""A camera: where it stands, what it frames, the rays it casts.

A ray's direction has unit component along the view axis, so the ``t`` of a hit is its planar
depth. Rays are made with ``+ - *`` alone, in float64: cl/camera.h makes the same bits of perspective
ones on a device.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from clgrid import structs
from clgrid.errors import InputError

Vector = npt.NDArray[np.float64]
FovAxis = Literal["y", "x", "smaller"]

DEFAULT_FOV = 40.0
# The default view stands this far around the up axis and above the ground plane, and leaves this
# share of the picture free around the bounds.
_AZIMUTH, _ELEVATION, _MARGIN = math.radians(35.0), math.radians(24.0), 0.04


@dataclass(frozen=True)
class Camera:
    """A perspective or orthographic camera.

    Attributes
    ----------
    eye : (3,) float64
        Where all rays start, in scene units; of an orthographic camera, the middle of where they do.
    right, up, forward : (3,) float64
        Orthonormal axes of the picture; ``right`` is kept apart so that mirrored cameras exist.
    fov : float
        Field of view in degrees, below 180.
    fov_axis : {"y", "x", "smaller"}
        The side of the picture that ``fov`` spans: height, width or the shorter one.
    name : str
        Name in the file the camera came from.
    orthographic_height : float or None
        Height of the picture in scene units, of an orthographic camera; ``fov`` is then without meaning.
    """

    eye: Vector
    right: Vector
    up: Vector
    forward: Vector
    fov: float = DEFAULT_FOV
    fov_axis: FovAxis = "y"
    name: str = ""
    orthographic_height: float | None = None

    def __post_init__(self) -> None:
        if self.orthographic_height is not None and not 0.0 < self.orthographic_height < math.inf:
            raise InputError(f"camera: orthographic height {self.orthographic_height:g}; give one above 0")
        if not 0.0 < self.fov < 180.0:
            raise InputError(f"camera: field of view {self.fov:g} degrees; give one between 0 and 180")
        if not np.isfinite([self.eye, self.right, self.up, self.forward]).all():
            raise InputError("camera: eye or axes are not finite; give finite --eye, --look-at and --up")

    @staticmethod
    def look_at(
        eye: npt.ArrayLike,
        target: npt.ArrayLike,
        up: npt.ArrayLike = (0.0, 1.0, 0.0),
        fov: float = DEFAULT_FOV,
        orthographic_height: float | None = None,
    ) -> Camera:
        """Camera at ``eye`` with ``target`` in the middle of the picture.

        Parameters
        ----------
        eye, target, up : (3,) array_like
            Positions in scene units; ``up`` is a direction of any length.
        fov : float
            Vertical field of view in degrees.
        orthographic_height : float, optional
            Height of the picture in scene units, for parallel rays.

        Raises
        ------
        InputError
            If ``fov`` or the height is out of range, a vector is not finite, eye and target coincide, or
            ``up`` is the view axis.
        """
        start = _vector(eye, "eye")
        forward = _unit(_vector(target, "look-at") - start)
        if forward is None:
            raise InputError("camera: eye and look-at coincide; move one of them")
        right = _unit(_cross(forward, _vector(up, "up")))
        if right is None:
            raise InputError("camera: up is zero or along the view axis; give another --up")
        upward = _cross(right, forward)
        return Camera(start, right, upward, forward, fov, orthographic_height=orthographic_height)

    @staticmethod
    def framing(
        bounds: npt.ArrayLike,
        up: npt.ArrayLike = (0.0, 1.0, 0.0),
        fov: float = DEFAULT_FOV,
        aspect: float = 1.0,
    ) -> Camera:
        """Three-quarter view from the least distance at which the whole box is in the picture.

        Parameters
        ----------
        bounds : (2, 3) array_like
            Lowest and highest corner, in scene units.
        up : (3,) array_like
            Direction that points up in the picture.
        fov : float
            Vertical field of view in degrees.
        aspect : float
            Width of the picture over its height.
        """
        low, high = np.asarray(bounds, np.float64)
        centre = low + 0.5 * (high - low)
        axes = Camera.look_at((0.0, 0.0, 0.0), _three_quarter(_vector(up, "up")), up, fov)
        tan_y = math.tan(math.radians(fov) / 2) * (1.0 - _MARGIN)
        corners = np.stack(np.meshgrid(*np.stack([low - centre, high - centre], 1)), -1).reshape(8, 3)
        x, y, z = (corners @ np.stack([axes.right, axes.up, axes.forward], 1)).T
        back = max(_least_distance(x, z, tan_y * aspect), _least_distance(y, z, tan_y))
        if not back > 0:
            # A box without extent has no natural distance: any that moves the eye will do.
            back = max(1.0, 1e-3 * float(np.abs(centre).max()))
        sideways = _centring_shift(x, z + back) * axes.right + _centring_shift(y, z + back) * axes.up
        return replace(axes, eye=centre + sideways - back * axes.forward)

    @staticmethod
    def from_matrix(
        to_world: npt.ArrayLike,
        fov: float,
        fov_axis: FovAxis = "y",
        *,
        right: int = 1,
        forward: int = -1,
        name: str = "",
        orthographic_height: float | None = None,
    ) -> Camera:
        """Camera from a camera-to-world matrix (column vectors); its scale is dropped.

        Parameters
        ----------
        to_world : (4, 4) array_like
            Takes camera coordinates to scene coordinates.
        fov, fov_axis
            As the attributes.
        right, forward : {1, -1}
            Which end of the camera's x axis points right in the picture, and of its z axis into it:
            glTF (1, -1), pbrt (1, 1), Mitsuba (-1, 1).
        name : str
            Name of the camera.
        orthographic_height : float, optional
            Height of the picture in scene units, for parallel rays.

        Raises
        ------
        InputError
            If the matrix is not finite, not 4x4, or has no three axes.
        """
        matrix = np.asarray(to_world, np.float64)
        if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
            raise InputError(f"camera {name!r}: its matrix is not 4x4 finite numbers; correct the file")
        x, y, z = (_unit(column) for column in matrix[:3, :3].T)
        if x is None or y is None or z is None:
            raise InputError(f"camera {name!r}: its matrix has an axis of length zero; correct the file")
        axes = (right * x, y, forward * z)
        return Camera(matrix[:3, 3].copy(), *axes, fov, fov_axis, name, orthographic_height)

    def steps(self, width: int, height: int) -> tuple[Vector, Vector]:
        """Change of direction, or of origin, from a pixel to its right and to its lower neighbour.

        Parameters
        ----------
        width, height : int
            Size of the picture in pixels.

        Returns
        -------
        step_x, step_y : (3,) float64
            Scene units at depth 1 along the view axis, or at any depth of an orthographic picture.
        """
        if self.orthographic_height is not None:
            pixel = self.orthographic_height / height
            return self.right * pixel, self.up * -pixel
        side = {"y": height, "x": width, "smaller": min(width, height)}[self.fov_axis]
        pixel = 2.0 * math.tan(math.radians(self.fov) / 2) / side
        return self.right * pixel, self.up * -pixel

    def rays(self, width: int, height: int) -> tuple[Vector, Vector]:
        """Rays through the pixel centres, row 0 on top.

        Parameters
        ----------
        width, height : int
            Size of the picture in pixels.

        Returns
        -------
        origins, directions : (height, width, 3) float64
            ``directions`` have unit component along ``forward``: ``t`` is planar depth in scene
            units. What all rays share, origins or directions, is a read-only view of one.
        """
        step_x, step_y = self.steps(width, height)
        x = (np.arange(width, dtype=np.float64) + 0.5 - 0.5 * width)[None, :, None]
        y = (np.arange(height, dtype=np.float64) + 0.5 - 0.5 * height)[:, None, None]
        if self.orthographic_height is not None:
            origins = (self.eye + x * step_x) + y * step_y
            return origins, np.broadcast_to(self.forward, origins.shape)
        directions = (self.forward + x * step_x) + y * step_y
        return np.broadcast_to(self.eye, directions.shape), directions

    def params(
        self, width: int, height: int, window: tuple[int, int, int, int] | None = None
    ) -> npt.NDArray[np.void]:
        """Return the struct that kernels read, for a picture of this size or a window of it.

        Parameters
        ----------
        width, height : int
            Size of the whole picture in pixels.
        window : (x0, y0, x1, y1), optional
            Pixels x0 .. x1 - 1 and y0 .. y1 - 1 alone.
        """
        left, top, right, _ = window or (0, 0, width, height)
        step_x, step_y = self.steps(width, height)
        return structs.CAMERA.pack(
            eye=self.eye, forward=self.forward, step_x=step_x, step_y=step_y, width=width, height=height,
            left=left, top=top, across=right - left, parallel=self.orthographic_height is not None,
        )  # fmt: skip

    def world_to_camera(self) -> Vector:
        """(4, 4) float64 for column vectors: x right, y up, z into the picture."""
        axes = np.stack([self.right, self.up, self.forward])
        matrix = np.eye(4)
        matrix[:3, :3] = axes
        matrix[:3, 3] = -(axes @ self.eye)
        return matrix

    def world_to_ndc(self, width: int, height: int) -> Vector:
        """(4, 4) float64 for column vectors: (0, 0) is the picture's upper left, (1, 1) its lower right.

        After the division by the fourth, the third coordinate is without meaning, as in OpenEXR.
        """
        step_x, step_y = self.steps(width, height)
        x, y = 1.0 / (width * _length(step_x)), 1.0 / (height * _length(step_y))
        flat = self.orthographic_height is not None
        depth = (0.0, 0.0, 1.0, 0.0)
        one = (0.0, 0.0, 0.0, 1.0)
        # The middle of the picture is at one half, times what is divided by: 1 or the depth.
        across, down = ((x, 0, 0, 0.5), (0, -y, 0, 0.5)) if flat else ((x, 0, 0.5, 0), (0, -y, 0.5, 0))
        rows = np.array([across, down, depth if flat else one, one if flat else depth], np.float64)
        product: Vector = rows @ self.world_to_camera()
        return product


def _least_distance(across: Vector, depth: Vector, tangent: float) -> float:
    """How far back from depth 0 a view must start to hold all points between two picture borders."""
    one, other = np.max(across - tangent * depth), np.max(-across - tangent * depth)
    return float(0.5 * (one + other) / tangent)


def _centring_shift(across: Vector, depth: Vector) -> float:
    """Sideways place from which the outermost points are equally far from the picture's middle."""
    low, high = float(across.min()), float(across.max())
    for _ in range(60):
        middle = 0.5 * (low + high)
        slopes = (across - middle) / depth
        low, high = (middle, high) if slopes.max() > -slopes.min() else (low, middle)
    return 0.5 * (low + high)


def _three_quarter(up: Vector) -> Vector:
    """Direction of the default view: round the up axis by the azimuth, down by the elevation."""
    axis = int(np.argmax(np.abs(up)))
    ahead = np.zeros(3)
    # Seen from +z where y is up (glTF's front), from -y where z is up (CAD's front).
    ahead[2 if axis != 2 else 1] = -1.0 if axis != 2 else 1.0
    sideways = _unit(_cross(ahead, up))
    vertical = _unit(up)
    if sideways is None or vertical is None:
        raise InputError("camera: up has length zero; give another --up")
    ahead = _cross(vertical, sideways)
    flat = math.cos(_AZIMUTH) * ahead - math.sin(_AZIMUTH) * sideways
    return math.cos(_ELEVATION) * flat - math.sin(_ELEVATION) * vertical


def _vector(values: npt.ArrayLike, what: str) -> Vector:
    array = np.asarray(values, np.float64)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise InputError(f"camera: {what} {values!r} is not three finite numbers")
    return array


def _unit(vector: Sequence[float] | Vector) -> Vector | None:
    """``vector`` at length 1; None for the zero vector. Scaled first, so that no square overflows."""
    array = np.asarray(vector, np.float64)
    largest = float(np.abs(array).max())
    if not 0.0 < largest < math.inf:
        return None
    array = array / largest
    return array / math.sqrt(float(array @ array))


def _length(vector: Vector) -> float:
    return math.sqrt(float(vector @ vector))


def _cross(a: Vector, b: Vector) -> Vector:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
