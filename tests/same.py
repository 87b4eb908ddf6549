"""Whether two grids answer alike, bit for bit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

import clgrid
from clgrid.grid import Grid


def some_rays(seed: int = 3, count: int = 3000) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, 3)), rng.normal(size=(count, 3))


def assert_same_bits(one: Any, other: Any, names: Sequence[str]) -> None:
    for name in names:
        a, b = getattr(one, name), getattr(other, name)
        assert (a.dtype, a.shape) == (b.dtype, b.shape), name
        assert a.tobytes() == b.tobytes(), name


def answers(grid: Grid, seed: int = 3, draw: bool = True) -> dict[str, bytes]:
    """The bytes of every query's arrays."""
    origins, directions = some_rays(seed)
    hits, every = grid.cast(origins, directions), grid.cast_all(origins[:500], directions[:500])
    found = {
        **{f"cast {name}": hits[name] for name in ("t_hit", "primitive_ids", "primitive_uvs")},
        **{f"cast_all {name}": every[name] for name in ("ray_splits", "t_hit", "primitive_ids")},
        "count": grid.count(origins, directions),
        "occluded": grid.occluded(origins, directions),
        "contains": grid.contains(origins * 0.7, require_closed=False),
    }
    if draw:
        image = clgrid.render(grid.mesh, width=40, height=30, aovs=("depth", "normal", "id"), grid=grid)
        found |= {name: getattr(image, name) for name in ("rgba", "depth", "normal", "primitive_id")}
    return {name: array.tobytes() for name, array in found.items()}


def assert_same_answers(one: Grid, other: Grid) -> None:
    found, expected = answers(one), answers(other)
    assert [name for name in expected if found[name] != expected[name]] == []
