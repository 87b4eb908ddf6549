"""Rules of the kernel sources: what strict arithmetic forbids, and what CPU drivers do not survive."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import cell_lists
import numpy as np
import pytest
import test_grid

from clgrid import resolution
from clgrid.layouts import planes
from clgrid.program import source_folder

SOURCES = sorted([*source_folder().glob("*.cl"), *source_folder().glob("*.h")])
KERNELS = [path for path in SOURCES if path.suffix == ".cl"]
by_name = pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.name)

_COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)
_INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"', re.MULTILINE)
# Built-ins whose result OpenCL leaves to the device, or that fuse a product with a sum.
_INEXACT = re.compile(
    r"\b(dot|cross|length|distance|normalize|fast_\w+|native_\w+|half_\w+|mad|fma|rsqrt|cbrt|hypot|exp(?:2|10|m1)?|log(?:2|10|1p|b)?"
    r"|pow\w?|a?sinh?|a?cosh?|a?tanh?|atan2|mix|smoothstep|degrees|radians|remquo|fract|modf)\s*\("
)
# Types above 256 bits crash, hang or miscompile on the PoCL that pip installs; so does vload16 of chars.
_TOO_WIDE = re.compile(r"\b(?:\w+16|u?long8|double8)\b(?!\w)")


def code(path: Path) -> str:
    """The source without its comments."""
    return _COMMENT.sub("", path.read_text(encoding="utf-8"))


def reached(path: Path) -> Iterator[Path]:
    """The file and all that it includes."""
    yield path
    for name in _INCLUDE.findall(code(path)):
        yield from reached(path.parent / name)


@by_name
def test_no_inexact_built_ins(path: Path) -> None:
    # What these do is what that kernel finds out.
    tried = ["mad", "fma"] if path.name == "probe_arithmetic.cl" else []
    assert _INEXACT.findall(code(path)) == tried


@by_name
def test_no_types_above_256_bits(path: Path) -> None:
    assert _TOO_WIDE.findall(code(path)) == []


@by_name
def test_contraction_is_never_switched_on(path: Path) -> None:
    text = code(path)
    assert not re.search(r"FP_CONTRACT\s+(?:ON|DEFAULT)", text)
    assert "fast-relaxed" not in text
    if path.name == "config.h":
        assert re.search(r"^#pragma OPENCL FP_CONTRACT OFF$", text, re.MULTILINE)


def test_no_build_option_loosens_arithmetic() -> None:
    package = Path(resolution.__file__).parent
    for path in package.rglob("*.py"):
        assert not re.search(
            r"-cl-(?:fast|mad|unsafe|finite|no-signed|denorms)", path.read_text(encoding="utf-8")
        )


@pytest.mark.parametrize("path", KERNELS, ids=lambda path: path.name)
def test_kernels_with_arithmetic_are_strict(path: Path) -> None:
    """Every kernel that names a float or double takes the pragma of config.h with it, before any code."""
    text = "".join(code(part) for part in reached(path))
    if not re.search(r"\b(?:float|double)\d?\b", text):
        return
    assert "config.h" in {part.name for part in reached(path)}
    first = _INCLUDE.search(code(path))
    assert first is not None
    assert "{" not in code(path)[: first.start()]


def test_some_kernels_are_strict() -> None:
    """The rule above applies to the kernels that decide hits and references."""
    names = {path.name for path in KERNELS if "config.h" in {part.name for part in reached(path)}}
    assert {
        "brute_force.cl",
        "cast_closest.cl",
        "count_references.cl",
        "bin_references.cl",
        "render.cl",
    } <= names


@by_name
def test_a_file_opens_with_a_comment_of_at_most_ten_lines(path: Path) -> None:
    lines = path.read_text(encoding="utf-8").splitlines()
    opening = next((i for i, line in enumerate(lines) if not line.startswith("//")), len(lines))
    assert 1 <= opening <= 10


@by_name
def test_a_file_is_short_and_ascii(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert text.count("\n") <= 400
    assert text.isascii(), "PoCL's compiler complains of other characters"


@by_name
def test_no_barriers_and_no_atomics(path: Path) -> None:
    assert re.findall(r"\b(barrier|mem_fence|atom\w*_\w+)\s*\(", code(path)) == []


@pytest.mark.parametrize("path", KERNELS, ids=lambda path: path.name)
def test_kernels_fix_their_work_group(path: Path) -> None:
    text = code(path)
    assert text.count("reqd_work_group_size") == len(re.findall(r"\b__kernel\b", text)) == 1
    assert re.search(rf"\b{path.stem}\s*\(", text), "the kernel is named as its file"


def constant(name: str) -> float:
    """The value of a macro of config.h made of numbers, products and other macros."""
    text = code(source_folder() / "config.h")
    found = re.search(rf"^#define {name}\s+(.+)$", text, re.MULTILINE)
    assert found, name
    value = re.sub(r"\b[A-Z_]{2,}\b", lambda other: repr(constant(other.group())), found.group(1))
    value = re.sub(r"0x1p([+-]\d+)f?", r"2.0**\1", value)
    return float(eval(value.rstrip("uf").strip(), {"__builtins__": {}}))


def test_python_and_kernels_share_their_constants() -> None:
    assert constant("BOX_PAD") == resolution.BOX_PAD
    assert constant("BRICK") == planes.BRICK
    assert constant("DENSE_ROW") == cell_lists.DENSE_ROW
    assert constant("CLIP_CELLS") == test_grid.CLIP_CELLS
    assert constant("ROW_SHIFT") == np.log2(planes.ROW_CELLS)


def test_constants_are_those_of_the_proof() -> None:
    """docs/numerics.md: a change here needs a new argument there."""
    u = 2.0**-24
    assert constant("UNIT_ROUNDOFF") == u
    assert constant("START_LIMIT") == 2
    assert constant("ENTRY_CUBE") == 1.5
    assert constant("SMALLEST_EDGE") == 2.0**-80
    # Aside and late, see tests/test_triangle_twin.py; then the rounding of cell_range.
    assert (14.5 + 11) * u < constant("HIT_ERROR")
    assert constant("HIT_ERROR") + 7.1 * u < constant("BOX_PAD")
