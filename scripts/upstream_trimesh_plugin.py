"""For pytest: every trimesh.Trimesh gets clgrid's intersector; tests that ask one are counted.

Loaded by scripts/upstream_trimesh before any test is imported. UPSTREAM_ACCURACY names the rung;
UPSTREAM_THEIRS leaves trimesh its own.
"""

from __future__ import annotations

import importlib
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


def counting(intersector: type, **options: Any) -> type:
    """The class, made with options, whose queries are counted."""

    class Counting(intersector):  # type: ignore[misc, valid-type]
        def __init__(self, *words: Any, **named: Any) -> None:
            super().__init__(*words, **named, **options)

    def counted(name: str) -> Any:
        query = getattr(intersector, name)

        def ask(self: Any, *words: Any, **named: Any) -> Any:
            global asked
            asked += 1
            return query(self, *words, **named)

        return ask

    for name in METHODS:
        setattr(Counting, name, counted(name))
    return Counting


def replace_both() -> None:
    ours = counting(RayMeshIntersector, accuracy=os.environ["UPSTREAM_ACCURACY"])
    trimesh.ray.ray_triangle.RayMeshIntersector = ours
    if not trimesh.ray.has_embree:
        module: Any = types.ModuleType("trimesh.ray.ray_pyembree")
        sys.modules[module.__name__] = trimesh.ray.ray_pyembree = module
        trimesh.ray.has_embree = True
    trimesh.ray.ray_pyembree.RayMeshIntersector = ours


def count_theirs() -> None:
    engines = ["ray_triangle", *(["ray_pyembree"] if trimesh.ray.has_embree else [])]
    for engine in engines:
        module = importlib.import_module(f"trimesh.ray.{engine}")
        module.RayMeshIntersector = counting(module.RayMeshIntersector)


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
