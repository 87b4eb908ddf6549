"""A finer grid in place of the chosen one, once rays that have little in common have paid for it.

"auto" chooses a grid for a picture. ``Adaptation`` looks at the rays of each cast, and adds up what those
that go alone lose against the grid that would suit them (``finer``). Once that is what the other takes to
build, it is built and stands from then on: whatever is cast later, it all takes at most twice the best.
Nothing here decides a hit: every grid gives the same answers.
"""

from __future__ import annotations

import logging
import threading
from abc import abstractmethod
from collections.abc import Callable, Sequence

import numpy as np

from clgrid.cast import GridPart
from clgrid.errors import GridTooLargeError
from clgrid.finer import Plan, plan
from clgrid.hits import COUNTERS
from clgrid.life import Life
from clgrid.memory import Allocator
from clgrid.mesh import Mesh
from clgrid.queries import Queries
from clgrid.rays import Rays
from clgrid.recipe import Recipe
from clgrid.stats import GridStats
from clgrid.target import MeshPart

log = logging.getLogger(__name__)

FEWEST = 1 << 14
"""Rays of a grid that are cast before any is looked at."""

# Rays looked at, and how finely: parts of the mesh's longest side, and of half the range of a direction.
_LOOKED_AT, _PARTS, _TURNS = 256, 8, 2
# Farther from the mesh, parts are no longer told apart.
_FARTHEST = 16
# Rays that start in one part, one way, from which on tiles of them keep together: 16 tiles.
_TOGETHER = 1 << 10
# As many as are in order at once.
_LAUNCH = 1 << 22


def go_alone(rays: Rays, mesh: Mesh) -> bool:
    """Whether neighbours among the rays, once they are in order, have little in common.

    Of a sample's pairs, those that start in one part of space, one way, are the share that they are of all
    pairs: so many rays there are for a tile to be made of.
    """
    origins, directions = rays.origins.reshape(-1, 3), rays.directions.reshape(-1, 3)
    count = len(origins)
    # An odd step meets all columns of an image.
    some = slice(None, None, count // _LOOKED_AT | 1)
    low, high = mesh.bounds
    with np.errstate(all="ignore"):
        parts = (origins[some] - low) * (_PARTS / (float((high - low).max()) or 1.0))
        ways = directions[some].astype(np.float64)
        ways /= np.abs(ways).max(axis=1, keepdims=True)
    numbers = np.concatenate([np.clip(parts, -_FARTHEST, _FARTHEST), _TURNS * ways], axis=1)
    keys = np.floor(np.nan_to_num(numbers)).astype(np.int64) @ (64 ** np.arange(6, dtype=np.int64))
    alike = np.unique(keys, return_counts=True)[1]
    pairs = float((alike * (alike - 1)).sum()) / max(len(keys) * (len(keys) - 1), 1)
    return pairs * min(count, _LAUNCH) < _TOGETHER


class Adaptation:
    """Decides when the rays of a grid have paid for another.

    Threads may note rays at once: one of them is heard, and the others are not kept waiting.

    Parameters
    ----------
    make_plan : callable
        Of the bytes that stand, the plan, or None; called once, when enough rays have been cast.
    """

    def __init__(self, mesh: Mesh, make_plan: Callable[[int], Plan | None]) -> None:
        self._mesh, self._make_plan = mesh, make_plan
        self._lock = threading.Lock()
        self._plan: Plan | None = None
        self._seen, self._lost_s = 0, 0.0
        self.settled = False

    def note(self, rays: Rays, nbytes: int, build: Callable[[Recipe], None]) -> None:
        """Look at rays before they are cast, and ``build`` the plan's recipe once that is paid for."""
        if self.settled or not self._lock.acquire(blocking=False):
            return
        try:
            if not self.settled and self._is_due(rays, nbytes) and self._plan is not None:
                self.settled = True
                build(self._plan.recipe)
        finally:
            self._lock.release()

    def _is_due(self, rays: Rays, nbytes: int) -> bool:
        count = rays.origins.size // 3
        self._seen += count
        if self._seen < FEWEST or not go_alone(rays, self._mesh):
            return False
        if self._plan is None:
            self._plan = self._make_plan(nbytes)
        if self._plan is None:
            self.settled = True
            return False
        self._lost_s += count * self._plan.saved_s
        return self._lost_s >= self._plan.build_s


class Adapts(Queries, Life):
    """Of a grid that another may take the place of.

    Attributes
    ----------
    parts : list of GridPart
    """

    parts: list[GridPart]
    _allocator: Allocator
    _swapping: threading.Lock
    _stats: tuple[list[GridPart], GridStats] | None

    @property
    @abstractmethod
    def nbytes(self) -> int:
        """Bytes of the parts."""

    @abstractmethod
    def _build_part(self, part: MeshPart, recipe: Recipe) -> GridPart:
        """Build a part of a grid of that recipe."""

    def _wait_for_rays(self) -> None:
        """Stand as the recipe says, until rays have paid for a finer grid."""
        self._stands_as = self.recipe
        self._adaptation: Adaptation | None = None
        mesh, device, recipe = self.mesh, self.device, self.recipe
        if recipe.adapts and mesh.triangle_count:
            # Without a way back to the grid, which would then live until garbage is collected.
            self._adaptation = Adaptation(mesh, lambda nbytes: plan(mesh, device, recipe, nbytes))

    @property
    def adapted(self) -> bool:
        """Whether it is no longer the grid that was chosen, but a finer one."""
        return self._stands_as is not self.recipe

    def parts_for(self, rays: Rays, fields: Sequence[str] = ()) -> list[GridPart]:
        """The parts, of a finer grid from when rays have paid for it.

        Rays whose steps are counted are told of the grid that stands.
        """
        if self._adaptation is not None and not self._adaptation.settled and not set(COUNTERS) & set(fields):
            self.require_here()
            self._adaptation.note(rays, self.nbytes, self._replace)
        return self.standing

    def _replace(self, recipe: Recipe) -> None:
        """Let a grid of another recipe stand over the same mesh, unless it is too large.

        Other threads may be casting through the one before: it goes when they are done with it.
        """
        made: list[GridPart] = []
        try:
            for part in self.standing:
                made.append(self._build_part(part.mesh, recipe))
        except GridTooLargeError as error:
            log.info("the grid over %s stays as it is: %s", self.mesh.source, error)
            made = []
        with self._swapping:
            if made and not self._released:
                self.parts, self._stands_as, self._stats = made, recipe, None
            standing = self.parts
        self._allocator.keep_only(*(buffer for part in standing for buffer in part.lists.buffers))
        self._allocator.finished = self.nbytes

    def as_it_stands(self) -> tuple[Recipe, list[GridPart]]:
        """How the grid that stands was built, and its parts."""
        with self._swapping:
            return self._stands_as, self.standing
