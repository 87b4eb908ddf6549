"""The life of a grid: released by hand or by ``with``, copied, pickled, and no use to a forked process."""

from __future__ import annotations

import copy
import logging
from abc import ABC, abstractmethod
from types import TracebackType
from typing import TYPE_CHECKING, Any, TypeVar

from clgrid.cost import Choice
from clgrid.device import Device, choose
from clgrid.errors import DeviceError, InputError
from clgrid.mesh import Mesh
from clgrid.recipe import Recipe

if TYPE_CHECKING:
    from typing_extensions import Self

log = logging.getLogger(__name__)


class Life(ABC):
    """Of whatever is made of a mesh by a recipe, and holds buffers of a device.

    A copy, shallow or deep, has buffers of its own; the shallow one shares the mesh. A pickle holds the mesh
    and the recipe: loading it builds anew, on the device of the same label where there is one, and on the
    default device elsewhere. Both have the same answers, bit for bit, but for ``fast`` on another device.
    """

    mesh: Mesh
    device: Device
    recipe: Recipe
    choice: Choice | None
    _released = False

    @classmethod
    @abstractmethod
    def rebuilt(cls, mesh: Mesh, device: Device, recipe: Recipe) -> Self:
        """One made anew.

        Raises
        ------
        GridTooLargeError, DeviceError
            As of ``build``.
        """

    @abstractmethod
    def _let_go(self) -> None:
        """Drop every buffer, once kernels that were left to themselves are done."""

    def require_here(self) -> None:
        """Refuse use after release, and in a forked process.

        Raises
        ------
        InputError
            If it was released.
        DeviceError
            In a process forked from the one that made it: drivers hang there.
        """
        self.require_unreleased()
        self.device.refuse_fork()

    def require_unreleased(self) -> None:
        """Refuse use after release.

        Raises
        ------
        InputError
            If it was released.
        """
        if self._released:
            raise InputError(f"the grid over {self.mesh.source} was released; build it anew")

    def release(self) -> None:
        """Give the buffers back to the device; ``with clgrid.build(mesh) as grid`` does so at its end.

        Those of a grid that nobody refers to wait for the next build on the device, 64 MB of them at most.
        What is then asked of this one is an InputError, but for ``stats`` and ``mesh``. Releasing twice is
        nothing. A forked process leaves buffers alone: they are not its own.
        """
        before, self._released = self._released, True
        # In this order, so that a thread that finds no buffers finds out why.
        if not before and not self.device.is_forked:
            self._let_go()

    def __enter__(self) -> Self:
        self.require_unreleased()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    def __copy__(self) -> Self:
        return self._again(self.mesh)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self._again(copy.deepcopy(self.mesh, memo))

    def _again(self, mesh: Mesh) -> Self:
        self.require_here()
        return _made(type(self), mesh, self.device, self.recipe, self.choice)

    def __reduce__(self) -> tuple[Any, ...]:
        self.require_unreleased()
        return _unpickled, (type(self), self.mesh, self.device.label, self.recipe, self.choice)


Kind = TypeVar("Kind", bound=Life)


def _made(kind: type[Kind], mesh: Mesh, device: Device, recipe: Recipe, choice: Choice | None) -> Kind:
    made = kind.rebuilt(mesh, device, recipe)
    made.choice = choice
    return made


def _unpickled(kind: type[Kind], mesh: Mesh, label: str, recipe: Recipe, choice: Choice | None) -> Kind:
    return _made(kind, mesh, _labelled(label), recipe, choice)


def _labelled(label: str) -> Device:
    """The device of that label, or the default one."""
    try:
        return choose(label)
    except DeviceError as error:
        chosen = choose()
        log.warning("a grid was pickled on %s (%s); it is rebuilt on %s", label, error, chosen.label)
        return chosen
