"""Puts everybody to the same work in turns: rounds of scripts/peers."""

from __future__ import annotations

import argparse
import importlib.util
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from peers_process import Child, PeerError, compile_moving, run_json
from peers_results import CLGRID, EMBREE, GRID, PYTHON, Result, SceneResult
from peers_scenes import Shot

# Builder / scene flag / rays per call.
EMBREE_VARIANTS = (
    "low/none/16", "low/none/8", "low/none/1", "low/compact/16", "low/robust/16", "low/robust/1",
    "med/none/16", "med/none/1", "med/compact/16", "med/robust/16",
)  # fmt: skip
LOW, ROBUST = "low/none/16", "low/robust/1"
GRID_VARIANTS = ("compact/rho=4", "compact/pkt/rho=2")
MOVING_VARIANTS = (
    ("rebuild", "none", "16"),
    ("rebuild", "none", "8"),
    ("refit", "none", "16"),
    ("refit", "none", "8"),
)
# Variants slower than this after the first round take no further part, but for those that others are held to.
_OUT_OF_THE_RUNNING = 1.25
_CPP_RAYS = 1_000_000
_CPP_BUDGET_S = 3.0
# More triangles take trimesh minutes; the others keep theirs to the end of the run, 100 bytes each and more.
_MOST_TRIANGLES = {
    "trimesh-rtree": 120_000,
    "trimesh-embreex": 2_000_000,
    "embreex": 16_000_000,
    "open3d": 16_000_000,
}
# On more than so many, only the first of these builders is tried: they are far behind.
_SLOW_BUILDER, _MOST_FOR_SLOW = "med/", 2_000_000

MODULES = {"embreex": "embreex", "open3d": "open3d", "trimesh-embreex": "embreex", "trimesh-rtree": "rtree"}
PEERS = ("embree", "grid", *MODULES)
_OPEN3D_NEEDS = "; its system libraries are in libusb-1.0-0, libgl1, libgomp1 (apt-get install them)"

Say = Callable[[str], None]


class Measurer:
    """All who take part: children that stay for the whole run, and programs in C++.

    Attributes
    ----------
    left_out : list of str
        Who does not take part, and why; one line each.
    facts : dict
        What those who do say of themselves, by name.
    """

    def __init__(self, options: argparse.Namespace, folder: Path, say: Say, stack: ExitStack) -> None:
        self.options = options
        self.folder = folder
        self.say = say
        self.left_out: list[str] = []
        self.facts: dict[str, dict[str, Any]] = {}
        self.clgrids: dict[str, Child] = {}
        self.pythons: dict[str, Child] = {}
        for device in options.device or [None]:
            words = ["clgrid", *(["--device", device] if device else [])]
            for name in ("layout", "density", "skipping", "adapt"):
                words += [f"--{name}", getattr(options, name)]
            child = stack.enter_context(Child(words, options.threads, options.timeout))
            facts = child.ask(do="facts")
            name = f"clgrid {facts['device']}"
            self.clgrids[name], self.facts[name] = child, facts
        for name in (name for name in MODULES if name in options.peers):
            self._start_python(name, stack)
        self._find_cpp()

    def _start_python(self, name: str, stack: ExitStack) -> None:
        if importlib.util.find_spec(MODULES[name]) is None:
            self.left_out.append(f"{name}: {MODULES[name]} is not installed: pip install 'clgrid[peers]'")
            return
        child = stack.enter_context(Child([name], self.options.threads, self.options.timeout))
        try:
            self.facts[name] = child.ask(do="facts")
            self.pythons[name] = child
        except PeerError as error:
            needs = _OPEN3D_NEEDS if name == "open3d" and "cannot open shared object" in str(error) else ""
            self.left_out.append(f"{name}: {error}{needs}")

    def _find_cpp(self) -> None:
        self.programs: dict[str, Path] = {}
        for name, program in ((EMBREE, "embree3"), (GRID, "grid")):
            path = self.options.cpp / "build" / program
            if name not in self.options.peers:
                continue
            if path.is_file():
                self.programs[name] = path
            else:
                self.left_out.append(
                    f"{name} in C++: no build/{program} in the folder of peers; make it (--cpp)"
                )

    def measure(self, shot: Shot, seconds: float) -> SceneResult:
        """As many rounds of a scene as are asked for and fit into the time, at least one."""
        scene = SceneResult(
            shot.name, shot.triangles, shot.size**2, shot.rays, float(shot.longest_side), len(shot.frames)
        )
        turns = self._moving_turns(shot, scene) if shot.moving else self._turns(shot, scene)
        end = time.monotonic() + seconds
        for turn in range(self.options.rounds):
            start = time.monotonic()
            # Forth and back, so that nobody always follows the same neighbour.
            for result, work in turns if turn % 2 == 0 else reversed(turns):
                if not result.failure:
                    attempt(result, lambda work=work, turn=turn: work(turn))  # type: ignore[misc]
            if turn == 0:
                turns = self._running(scene, turns)
            if 2 * time.monotonic() - start > end:
                break
        scene.compare_counts()
        if not shot.moving:
            self._compare_arrays(scene)
        return scene

    def _running(self, scene: SceneResult, turns: list[Any]) -> list[Any]:
        """Those who stay in for further rounds."""
        best = scene.embrees_best
        if best is None:
            return turns

        def stays(result: Result) -> bool:
            mine = result.time_to_image
            held_to = result.kind != EMBREE or result.name.endswith((LOW, ROBUST)) or scene.frames
            return bool(held_to) or (mine is not None and mine <= _OUT_OF_THE_RUNNING * best)

        return [(result, work) for result, work in turns if stays(result)]

    def _turns(self, shot: Shot, scene: SceneResult) -> list[Any]:
        """Who takes part, each with what it does in a round."""
        turns: list[Any] = []
        for name, child in (*self.clgrids.items(), *self.pythons.items()):
            result = Result(CLGRID if name in self.clgrids else PYTHON, name)
            scene.results.append(result)
            most = _MOST_TRIANGLES.get(name, shot.triangles)
            if shot.triangles > most:
                result.failure = f"left out above {most:,} triangles"
                continue
            self.say(f"{shot.name}: {name} gets ready")
            attempt(result, lambda result=result, child=child: self._open(result, child, shot))  # type: ignore[misc]
            turns.append((result, self._child_turn(result, child)))
        for kind, variants in ((EMBREE, EMBREE_VARIANTS), (GRID, GRID_VARIANTS)):
            for variant in sensible(variants, shot.triangles) if kind in self.programs else ():
                result = Result(kind, f"{kind} {variant}")
                scene.results.append(result)
                turns.append((result, self._cpp_turn(result, kind, variant, shot)))
        return turns

    def _open(self, result: Result, child: Child, shot: Shot) -> None:
        result.facts = child.ask(do="open", folder=str(shot.folder))
        for name in ("bytes", "adapted_bytes"):
            if name in result.facts:
                result.facts[f"{name}_per_triangle"] = result.facts[name] / shot.triangles

    def _child_turn(self, result: Result, child: Child) -> Callable[[int], None]:
        def work(turn: int) -> None:
            if result.name == "trimesh-rtree" and turn:
                return  # once is enough of what takes hours
            done = child.ask(do="turn", reps=self.options.reps)
            result.rounds.append(done["s"])
            result.raw.append(done["raw"])

        return work

    def _cpp_turn(self, result: Result, kind: str, variant: str, shot: Shot) -> Callable[[int], None]:
        def work(turn: int) -> None:
            command = [
                self.programs[kind],
                "--mesh",
                shot.folder / "mesh.bin",
                "--cam",
                shot.folder / "mesh.cam",
            ]
            command += ["--variant", variant, "--threads", self.options.threads, "--reps", self.options.reps]
            command += ["--size", shot.size, "--budget", _CPP_BUDGET_S]
            # Random rays take the slow ones seconds: once is enough but for whom the others are held to.
            with_random = shot.rays == _CPP_RAYS and (turn == 0 or variant in (LOW, ROBUST))
            command += [] if with_random else ["--skiprand"]
            said = run_json([str(word) for word in command], self.options.threads, self.options.timeout)
            seconds = {"build": said["build_s"], "primary": said["render_s"]}
            if said["nshadow"]:
                seconds["shadow"] = said["shadow_s"]
            facts = {"hits": said["nhit"], "shadow_rays": said["nshadow"], "occluded": said["noccl"]}
            if with_random:
                seconds["random"] = said["rand_s"]
                facts["random_hits"] = said["rand_nhit"]
            result.rounds.append(seconds)
            result.raw.append(said)
            result.facts |= {**facts, "bytes_per_triangle": said["bytes_per_tri"]}

        return work

    def _moving_turns(self, shot: Shot, scene: SceneResult) -> list[Any]:
        turns: list[Any] = []
        for name, child in self.clgrids.items():
            result = Result(CLGRID, name)
            scene.results.append(result)
            self.say(f"{shot.name}: {name} gets ready")
            attempt(result, lambda result=result, child=child: self._open(result, child, shot))  # type: ignore[misc]
            turns.append((result, self._moving_turn(result, lambda child=child: child.ask(do="moving"))))  # type: ignore[misc]
        for variant in MOVING_VARIANTS if EMBREE in self.programs else ():
            result = Result(EMBREE, f"embree {'/'.join(variant)}")
            scene.results.append(result)
            turns.append(
                (result, self._moving_turn(result, lambda variant=variant: self._embree_moves(shot, variant)))  # type: ignore[misc]
            )
        return turns

    def _moving_turn(self, result: Result, ask: Callable[[], dict[str, Any]]) -> Callable[[int], None]:
        def work(turn: int) -> None:
            said = ask()
            result.rounds.append(said["s"])
            result.raw.append(said.get("raw", {}))
            result.facts = {"hits": said["hits"], "bytes_per_triangle": said["bytes"]}

        return work

    def _embree_moves(self, shot: Shot, variant: tuple[str, ...]) -> dict[str, Any]:
        program = self.folder / "moving"
        if not program.is_file():
            compile_moving(self.options.cpp, program)
        files = [str(shot.folder / name) for name in ("mesh.bin", "mesh.cam", "frames.bin")]
        numbers = [str(number) for number in (len(shot.frames), self.options.threads, shot.size)]
        said = run_json(
            [str(program), *files, *numbers, *variant], self.options.threads, self.options.timeout
        )
        seconds = {"build": said["build_s"], "primary": said["render_s"]}
        return {"s": seconds, "hits": said["hits"], "bytes": said["bytes_per_tri"]}

    def _compare_arrays(self, scene: SceneResult) -> None:
        """Ray by ray against the first clgrid."""
        truth: Path | None = None
        children = {**self.clgrids, **self.pythons}
        for result in scene.results:
            if result.kind not in (CLGRID, PYTHON) or result.failure or result.name == "trimesh-rtree":
                continue
            path = self.folder / f"answers-{result.name.replace(' ', '-')}.npz"
            try:
                children[result.name].ask(do="answers", to=str(path))
            except PeerError as error:
                result.failure = str(error)
                continue
            if truth is None and result.kind == CLGRID:
                truth = path
            elif truth is not None:
                scene.compare_arrays(result, path, truth)
                path.unlink()


def sensible(variants: tuple[str, ...], triangles: int) -> list[str]:
    """Those that may be anybody's best on so many triangles, and one of those that are not."""
    slow = [variant for variant in variants if variant.startswith(_SLOW_BUILDER)]
    out = slow[1:] if triangles > _MOST_FOR_SLOW else []
    return [variant for variant in variants if variant not in out]


def attempt(result: Result, work: Callable[[], None]) -> None:
    """Do the work, or note why it failed."""
    try:
        work()
    except PeerError as error:
        result.failure = str(error)
