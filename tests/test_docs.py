"""The README and the guide do what they say: their code runs, the outputs that they show are printed."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import os
import re
import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import typer.main

import clgrid
from clgrid.cli import app, main
from clgrid.device import Device

pytestmark = pytest.mark.host

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PAGES = sorted([ROOT / "README.md", *DOCS.glob("*.md"), *DOCS.glob("guide/*.md")])
# Reports: their commands take minutes and scenes that are not in the repository.
REPORTS = ("architecture", "figure1", "numerics", "performance")
EXAMPLES = sorted(path for path in DOCS.glob("examples/*.py") if path.stem != "common")
# What a fence may hold: what runs, what that prints, and what is no code.
LANGUAGES = ("python", "sh", "text", "{toctree}", "{eval-rst}", "{literalinclude}")


@dataclass(frozen=True)
class Block:
    """A fenced block; ``line`` is that of its first line."""

    language: str
    line: int
    text: str


def blocks_of(page: Path) -> list[Block]:
    text = page.read_text(encoding="utf-8")
    found = re.finditer(r"^```([^\n]*)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return [Block(m[1].split()[0] if m[1] else "", text.count("\n", 0, m.start(2)) + 1, m[2]) for m in found]


def run_python(block: Block, page: Path, names: dict[str, object]) -> str:
    """What the block prints. Errors name the line of the page."""
    code = compile("\n" * (block.line - 1) + block.text, str(page), "exec")
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(code, names)
    return printed.getvalue()


def run_commands(block: Block) -> None:
    """Run each line that calls clgrid; the others are for the reader's shell."""
    for line in block.text.splitlines():
        words = shlex.split(line, comments=True)
        if words[:1] == ["clgrid"]:
            with pytest.raises(SystemExit) as exit_:
                main(words[1:])
            assert not exit_.value.code, line


def with_code(page: Path) -> bool:
    return any(block.language in ("python", "sh") for block in blocks_of(page))


@pytest.mark.parametrize("page", [p for p in PAGES if with_code(p)], ids=lambda p: p.stem)
def test_code_runs_and_prints_what_is_shown(page, device: Device, tmp_path, monkeypatch, capsys):
    """All blocks of a page, in order, in one namespace and one empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CLGRID_DEVICE", device.label)
    names: dict[str, object] = {"__name__": "__main__"}
    printed = ""
    for block in blocks_of(page):
        if block.language == "python":
            printed = run_python(block, page, names)
        elif block.language == "sh":
            run_commands(block)
        elif block.language == "text":
            assert printed == block.text, f"{page.name}:{block.line}"


@pytest.mark.parametrize("page", [p for p in PAGES if p.stem not in REPORTS], ids=lambda p: p.stem)
def test_no_block_is_left_out(page):
    """A block of another language, or of none, would not be run."""
    assert {block.language for block in blocks_of(page)} <= set(LANGUAGES), page


def commands_of(page: Path) -> list[str]:
    """Indented command lines: they name files of the reader's."""
    return re.findall(r"^    (clgrid [a-z].*)$", page.read_text(encoding="utf-8"), re.MULTILINE)


@pytest.mark.parametrize("page", [p for p in PAGES if commands_of(p)], ids=lambda p: p.stem)
def test_command_lines_are_understood(page):
    """Verbs, options and their values; what they would do to the files is not tried."""
    verbs = typer.main.get_command(app).commands
    for line in commands_of(page):
        words = shlex.split(line.split(">")[0], comments=True)
        verbs[words[1]].make_context(words[1], words[2:])


def test_the_guide_has_a_page_for_each_task():
    assert {path.stem for path in DOCS.glob("guide/*.md")} == {
        "accuracy",
        "batch",
        "cast_rays",
        "compare",
        "devices",
        "differences",
        "inside_tests",
        "keeping_grids",
        "large_meshes",
        "moving_mesh",
        "reports",
        "shading",
        "tradeoff",
        "worked_comparison",
    }


def test_links_between_pages_lead_somewhere():
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_every_public_name_is_in_the_reference():
    reference = (DOCS / "api.md").read_text(encoding="utf-8")
    named = set(re.findall(r"auto(?:class|function|exception|module|data):: clgrid\.(\w+)$", reference, re.M))
    assert set(clgrid.__all__) - {"__version__"} <= named


# Smaller scenes than those of the pictures; each still has what the example shows.
SMALL = {
    "ambient_occlusion": ["icosphere:3"],
    "depth_camera": ["icosphere:3"],
    "line_of_sight": ["terrain:64"],
    "moving_mesh": ["icosphere:3", "--count", "4"],
    "points_in_mesh": ["icosphere:3", "--points", "5000"],
    "thickness": ["icosphere:3"],
}


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda p: p.stem)
def test_examples_run(example, device: Device, tmp_path):
    output = tmp_path / "picture.png"
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": path, "CLGRID_DEVICE": device.label}
    command = [sys.executable, example, *SMALL[example.stem], "-o", output, "--size", "64"]
    done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == 1
    assert not re.search("Warning|Traceback", done.stderr), done.stderr
    picture = clgrid.read_image(output)
    assert picture.width == 64
    assert np.ptp(picture.rgba[..., :3]) > 0.3


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda p: p.stem)
def test_pictures_of_examples_are_in_the_docs(example):
    picture = example.with_suffix(".png")
    assert picture.stat().st_size <= 150_000
    assert clgrid.read_image(picture).width <= 512
    page = (DOCS / "examples.md").read_text(encoding="utf-8")
    assert f"(examples/{picture.name})" in page
    assert f"examples/{example.name}" in page


@pytest.mark.slow
def test_the_site_builds_without_warnings(tmp_path):
    missing = [name for name in ("sphinx", "furo", "myst_parser") if importlib.util.find_spec(name) is None]
    if missing:
        pytest.skip(f"{', '.join(missing)} not installed: pip install '.[docs]', or run scripts/docs")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", DOCS, tmp_path]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "api.html").is_file()
