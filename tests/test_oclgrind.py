"""Kernels under Oclgrind: no race, nothing out of bounds, nothing uninitialised; planted faults are found.

What is watched, and what is not: docs/architecture.md, "Oclgrind watches".
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import watched

from clgrid.program import source_folder

SCRIPT = Path(__file__).resolve().parent / "watched.py"
# Where the shell says, where scripts/test puts it (PyPI), or Debian's package.
PLACES = (
    Path(os.environ.get("OCLGRIND_FOLDER", sys.prefix)) / "pyopencl/.libs",
    Path(sys.prefix) / "oclgrind/pyopencl/.libs",
    Path("/usr/lib/oclgrind"),
)
SECONDS = 240


def library() -> Path | None:
    """Oclgrind as a platform of OpenCL."""
    return next((file for place in PLACES for file in sorted(place.glob("liboclgrind-rt-icd*.so"))), None)


needs_oclgrind = pytest.mark.skipif(
    library() is None, reason="Oclgrind is not installed: scripts/test does it, or apt-get install oclgrind"
)


@pytest.fixture(scope="module")
def kernels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of cl/ that Oclgrind reads right."""
    folder = tmp_path_factory.mktemp("kernels") / "cl"
    shutil.copytree(source_folder(), folder)
    for file in folder.iterdir():
        file.write_text(watched.spelled_out(file.read_text(encoding="utf-8")), encoding="utf-8")
    return folder


def findings(kernels: Path, case: str, scratch: Path, *, planted: bool = False) -> str:
    """What Oclgrind says of a case, which it alone sees: no other device is there.

    With a planted fault the case may fail too, since answers are wrong.
    """
    environment = {
        **os.environ,
        "OCL_ICD_VENDORS": str(library()),
        "XDG_CACHE_HOME": str(scratch),
        "PYOPENCL_NO_CACHE": "1",
        "OCLGRIND_DATA_RACES": "1",
        "OCLGRIND_UNIFORM_WRITES": "1",
        "OCLGRIND_UNINITIALIZED": "1",
        "OCLGRIND_NUM_THREADS": "1",
        "OCLGRIND_MAX_ERRORS": "10",
        "OCLGRIND_BUILD_OPTIONS": watched.BUILD_OPTIONS,
    }
    child = subprocess.run(
        [sys.executable, str(SCRIPT), str(kernels), case],
        env=environment,
        capture_output=True,
        text=True,
        timeout=SECONDS,
        check=False,
    )
    before, mark, found = child.stderr.partition(watched.MARK + case)
    assert child.returncode == 0 or planted, f"exit code {child.returncode}\n{child.stderr}"
    assert mark, before
    return found.strip()


@needs_oclgrind
@pytest.mark.slow
@pytest.mark.parametrize("case", watched.CASES)
def test_oclgrind_finds_nothing(kernels: Path, case: str, tmp_path: Path) -> None:
    found = findings(kernels, case, tmp_path)
    assert not found, found


# A line of a kernel, what it is altered to, and what is then to be found when `compact` is built and cast.
PLANTED = {
    "a write behind an array": (
        "insert_references.cl",
        "cell[size] = end;",
        "cell[size + 1] = end;",
        "Invalid write of size 4 at global memory",
    ),
    "a read behind an array": (
        "gather.h",
        "faces + 3 * (size_t)ids[i < last ? i : last]",
        "faces + 3 * (size_t)(ids[i < last ? i : last] + 80)",
        "Invalid read of size 4 at global memory",
    ),
    "a race": (
        "insert_references.cl",
        "full_cells[slab] = sum_up",
        "full_cells[0] = sum_up",
        "Write-write data race at global memory",
    ),
    "a read of what was never written": (
        "insert_references.cl",
        "cell[i] = 0;",
        ";",
        "Uninitialized value",
    ),
}


@needs_oclgrind
@pytest.mark.slow
@pytest.mark.parametrize("fault", PLANTED)
def test_a_planted_fault_is_found(kernels: Path, fault: str, tmp_path: Path) -> None:
    file, line, altered, said = PLANTED[fault]
    folder = tmp_path / "cl"
    shutil.copytree(kernels, folder)
    text = (folder / file).read_text(encoding="utf-8")
    assert text.count(line) == 1
    (folder / file).write_text(text.replace(line, altered), encoding="utf-8")
    found = findings(folder, "compact", tmp_path, planted=True)
    assert said in found


def test_vectors_of_vectors_are_spelled_out() -> None:
    assert watched.spelled_out("(float8)(a.lo, f(b, c))") == (
        "(float8)((a.lo).s0, (a.lo).s1, (a.lo).s2, (a.lo).s3, (f(b, c)).s0, (f(b, c)).s1, (f(b, c)).s2,"
        " (f(b, c)).s3)"
    )
    assert watched.spelled_out("(double4)(vload3(i, v), 0.0)") == (
        "(double4)((vload3(i, v)).s0, (vload3(i, v)).s1, (vload3(i, v)).s2, 0.0)"
    )
    assert watched.spelled_out("x + (int2)(1, 0) - (float4)(y)") == "x + (int2)(1, 0) - (float4)(y)"
