"""For pytest: every trimesh.Trimesh gets clgrid's intersector; tests that ask one are counted.

Loaded by scripts/upstream_trimesh before any test is imported. UPSTREAM_ACCURACY names the rung;
UPSTREAM_THEIRS leaves trimesh its own.
"""

from __future__ import annotations

import os
import sys
import types
from collections.abc import Iterator
from typing import Any

import pytest
import trimesh.ray

from clgrid.trimesh import RayMeshIntersector

METHODS = ("intersects_any", "intersects_first", "intersects_id", "intersects_location", "contains_points")

asked = 0
outcomes: dict[str, str] = {}
"""By test: those that asked an intersector."""


class Ours(RayMeshIntersector):
    """On the rung that was named."""

    def __init__(self, *words: Any, **named: Any) -> None:
        super().__init__(*words, accuracy=os.environ["UPSTREAM_ACCURACY"], **named)


def count(intersector: type) -> None:
    """Have the class's queries counted."""

    def counted(query: Any) -> Any:
        def ask(*words: Any, **named: Any) -> Any:
            global asked
            asked += 1
            return query(*words, **named)

        return ask

    for name in METHODS:
        setattr(intersector, name, counted(getattr(intersector, name)))


def replace_both() -> None:
    count(Ours)
    trimesh.ray.ray_triangle.RayMeshIntersector = Ours
    if not trimesh.ray.has_embree:
        module: Any = types.ModuleType("trimesh.ray.ray_pyembree")
        sys.modules[module.__name__] = trimesh.ray.ray_pyembree = module
        trimesh.ray.has_embree = True
    trimesh.ray.ray_pyembree.RayMeshIntersector = Ours


def count_theirs() -> None:
    count(trimesh.ray.ray_triangle.RayMeshIntersector)
    if trimesh.ray.has_embree:
        count(trimesh.ray.ray_pyembree.RayMeshIntersector)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    before = asked
    yield
    if asked == before:
        outcomes.pop(item.nodeid, None)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.when == "call" or not report.passed:
        outcomes[report.nodeid] = report.outcome


def pytest_terminal_summary(terminalreporter: Any) -> None:
    engine = "trimesh's intersectors" if os.environ["UPSTREAM_THEIRS"] else "clgrid's RayMeshIntersector"
    passed = sum(outcome == "passed" for outcome in outcomes.values())
    for name, outcome in outcomes.items():
        if outcome != "passed":
            terminalreporter.write_line(f"{outcome}: {name}")
    terminalreporter.write_line(f"{passed} of {len(outcomes)} tests that ask {engine} pass")


if os.environ["UPSTREAM_THEIRS"]:
    count_theirs()
else:
    replace_both()
