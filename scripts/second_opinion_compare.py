"""Two renderers' answers to the same rays: arrays in, figures out. No renderer is needed for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

F64 = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# Shares of pixels that must agree, and the most that albedos may differ by: rms, in 1/255.
LEAST_SHARE, MOST_ALBEDO = 0.999, 1.0
# Agreement: of depths, relative; of normals, in degrees. Far above what float32 leaves, far below what shows.
DEPTH_TOLERANCE, NORMAL_DEGREES = 1e-4, 0.5
# Inverse depth is linear along a row over a plane: a step off it by this share is a silhouette.
_STEP = 0.01


@dataclass(frozen=True)
class View:
    """What the rays of a picture meet.

    Attributes
    ----------
    depth : (H, W) float64
        Along the view axis, scene units; inf on a miss.
    normal : (H, W, 3) float64
        Unit, of the vertices where there are such, on the viewer's side; on a miss without meaning.
    uv : (H, W, 2) float64
        Of set 0, v downward; NaN where there are none, or no picture is looked up.
    albedo : (H, W, 3) float64
        Linear.
    triangle : (H, W) int64
        -1 on a miss, or where it is not known.
    """

    depth: F64
    normal: F64
    uv: F64
    albedo: F64
    triangle: npt.NDArray[np.int64]

    @property
    def hit(self) -> Mask:
        return np.isfinite(self.depth)


@dataclass(frozen=True)
class Agreement:
    """How two views of a scene agree.

    Attributes
    ----------
    hits, compared : int
        Pixels where either hits; of these, those away from silhouettes.
    depth, normal : float
        Shares of those compared that agree; what is not compared is NaN.
    depth_all, normal_all : float
        The same of all pixels where either hits.
    albedo : float
        Root mean square of the difference of channels, in 1/255, where both hit.
    uv : float
        The greatest difference of coordinates in the 99.9 % that differ least; NaN if there are none.
    apart : (H, W) bool
        Pixels compared that do not agree in depth or normal.
    worst_albedo : (x, y, difference)
        Pixel of the greatest difference, in 1/255.
    """

    hits: int
    compared: int
    depth: float
    normal: float
    depth_all: float
    normal_all: float
    albedo: float
    uv: float
    apart: Mask
    worst_albedo: tuple[int, int, float]

    @property
    def holds(self) -> bool:
        """Whether it is within the limits; NaN, what was not compared, is."""
        return not (self.depth < LEAST_SHARE or self.normal < LEAST_SHARE or self.albedo > MOST_ALBEDO)


def steps_in(depth: F64) -> Mask:
    """Pixels at which depth leaves the plane of its neighbours, and the pixels around them."""
    inverse = np.zeros_like(depth)
    np.divide(1.0, depth, out=inverse, where=np.isfinite(depth))
    found = np.zeros(depth.shape, bool)
    for q, there in ((inverse, found), (inverse.T, found.T)):
        bend = np.abs((q[2:] - q[1:-1]) - (q[1:-1] - q[:-2]))
        there[1:-1] |= bend > _STEP * np.maximum(np.maximum(q[2:], q[:-2]), q[1:-1])
    return grown(found)


def grown(mask: Mask) -> Mask:
    """The mask and the pixels that touch it, by a corner too."""
    wide = np.pad(mask, 1)
    rows = wide[:-2] | wide[1:-1] | wide[2:]
    return rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:]


def silhouettes(one: View, other: View) -> Mask:
    """Pixels within one of a silhouette in both views: what only one of them sees is a fault."""
    return steps_in(one.depth) & steps_in(other.depth)


def depths_agree(one: View, other: View) -> Mask:
    both = one.hit & other.hit
    a, b = np.where(both, one.depth, 1.0), np.where(both, other.depth, 1.0)
    return (one.hit == other.hit) & (np.abs(a - b) <= DEPTH_TOLERANCE * np.abs(a))


def degrees_between(a: F64, b: F64) -> F64:
    """Angles between unit vectors, by their chord: exact for small ones."""
    chord = np.sqrt(((a - b) ** 2).sum(-1))
    return np.asarray(np.degrees(2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0))))


def normals_agree(one: View, other: View) -> Mask:
    angles = degrees_between(one.normal, other.normal)
    return (one.hit == other.hit) & ~(one.hit & (angles > NORMAL_DEGREES))


def compare(
    one: View, other: View, aside: Mask | None = None, *, normals: bool = True, albedos: bool = True
) -> Agreement:
    """Put two views beside each other; pixels of ``aside`` are left out of all figures."""
    considered = one.hit | other.hit
    if aside is not None:
        considered = considered & ~aside
    away = considered & ~silhouettes(one, other)
    depth = depths_agree(one, other)
    normal = normals_agree(one, other) if normals else np.ones_like(depth)
    both = away & one.hit & other.hit
    albedo = np.where(both[..., None], (one.albedo - other.albedo) * 255.0, 0.0)
    worst = np.abs(albedo).max(-1)
    y, x = np.unravel_index(int(worst.argmax()), worst.shape)
    coordinates = np.abs(one.uv - other.uv).max(-1)[both]
    coordinates = coordinates[np.isfinite(coordinates)]
    return Agreement(
        hits=int(considered.sum()),
        compared=int(away.sum()),
        depth=share(depth, away),
        normal=share(normal, away) if normals else np.nan,
        depth_all=share(depth, considered),
        normal_all=share(normal, considered) if normals else np.nan,
        albedo=float(np.sqrt((albedo[both] ** 2).mean())) if both.any() and albedos else np.nan,
        uv=float(np.quantile(coordinates, 0.999)) if len(coordinates) else np.nan,
        apart=away & ~(depth & normal),
        worst_albedo=(int(x), int(y), float(worst[y, x]) if albedos else np.nan),
    )


def share(agree: Mask, among: Mask) -> float:
    return float(agree[among].mean()) if among.any() else 1.0


HEADER = (
    "scene",
    "triangles",
    "read by",
    "camera",
    "pixels",
    "of all",
    "depth",
    "normals",
    "all: depth",
    "normals",
    "albedo rms",
    "worst",
    "uv",
)


def row(words: Sequence[str], found: Agreement) -> str:
    """A row of the table, of ``words`` for the first four columns."""
    shares = (found.depth, found.normal, found.depth_all, found.normal_all)
    figures = [
        f"{found.compared:,}",
        f"{found.compared / max(found.hits, 1):.1%}",
        *(known(part, "{:.3%}") for part in shares),
        known(found.albedo, "{:.4f}"),
        known(found.worst_albedo[2], "{:.2f}"),
        known(found.uv, "{:.1e}"),
    ]
    return "| " + " | ".join([*words, *figures]) + " |"


def known(value: float, form: str) -> str:
    return "–" if np.isnan(value) else form.format(value)


def header() -> str:
    return f"| {' | '.join(HEADER)} |\n|---|--:|---|---|{'--:|' * (len(HEADER) - 4)}"
