import os
import re
import shutil
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clgrid import program
from clgrid.device import Device
from clgrid.errors import DeviceError

KERNEL = """
#include "shift.h"
kernel void add(global int *values) { values[get_global_id(0)] += SHIFT + STEP; }
kernel void twice(global int *values) { values[get_global_id(0)] *= 2; }
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of kernels of the test's own, with a space in its path."""
    place = tmp_path / "with a space"
    place.mkdir()
    shutil.copy(program.source_folder() / "check_structs.cl", place)
    (place / "add.cl").write_text(KERNEL)
    (place / "shift.h").write_text('#include "deeper.h"\n')
    (place / "deeper.h").write_text("#define SHIFT 100\n")
    (place / "other.h").write_text("#define OTHER 1\n")
    monkeypatch.setattr(program, "source_folder", lambda: place)
    program._digest.cache_clear()
    yield place
    program._digest.cache_clear()


def run(device: Device, kernel: Any, values: list[int]) -> list[int]:
    import pyopencl as cl

    host = np.array(values, np.int32)
    buffer = cl.Buffer(device.context, cl.mem_flags.COPY_HOST_PTR, hostbuf=host)
    kernel(device.queue, host.shape, None, buffer)
    cl.enqueue_copy(device.queue, host, buffer)
    return [int(value) for value in host]


def test_a_kernel_is_built_from_its_file_headers_and_options(device: Device, folder: Path) -> None:
    assert run(device, program.kernel(device, "add.cl", "add", STEP=7), [1, 2]) == [108, 109]
    assert run(device, program.kernel(device, "add.cl", "add", STEP="(3 * 3)".replace(" ", "")), [0]) == [109]
    assert run(device, program.kernel(device, "add.cl", "add", STEP=True), [0]) == [101]
    assert run(device, program.kernel(device, "add.cl", "twice", STEP=7), [4]) == [8]


def test_each_variant_is_built_once_and_its_kernel_kept(device: Device, folder: Path) -> None:
    before = len(program.builds(device))
    first = program.kernel(device, "add.cl", "add", STEP=11)
    assert len(program.builds(device)) == before + 1
    assert program.kernel(device, "add.cl", "add", STEP=11) is first
    program.kernel(device, "add.cl", "twice", STEP=11)
    assert len(program.builds(device)) == before + 1
    built = program.builds(device)
    assert (built[-1].file, built[-1].options) == ("add.cl", ("-DSTEP=11",))
    program.kernel(device, "add.cl", "add", STEP=12)
    assert len(program.builds(device)) == len(built) + 1


def test_a_changed_header_is_compiled_anew_and_an_unrelated_one_is_not(device: Device, folder: Path) -> None:
    assert run(device, program.kernel(device, "add.cl", "add", STEP=0), [0]) == [100]
    count = len(program.builds(device))
    (folder / "other.h").write_text("#define OTHER 2\n")
    program._digest.cache_clear()
    program.kernel(device, "add.cl", "add", STEP=0)
    assert len(program.builds(device)) == count
    (folder / "deeper.h").write_text("#define SHIFT 200\n")
    program._digest.cache_clear()
    assert run(device, program.kernel(device, "add.cl", "add", STEP=0), [0]) == [200]
    assert len(program.builds(device)) == count + 1


def test_a_compile_error_names_the_file_the_line_and_the_first_error(device: Device, folder: Path) -> None:
    (folder / "wrong.cl").write_text("kernel void wrong(global int *values) {\n    values[0] = MISSING;\n}\n")
    with pytest.raises(DeviceError) as caught:
        program.kernel(device, "wrong.cl", "wrong")
    message = str(caught.value)
    assert message.startswith(f"wrong.cl does not compile on {device.label}: ")
    assert "MISSING" in message
    assert re.search(r"wrong\.cl:2:\d+", message)
    assert "\n" not in message


def test_a_kernel_that_is_not_in_the_file_is_an_error(device: Device, folder: Path) -> None:
    with pytest.raises(DeviceError, match=r"add\.cl has no kernel subtract"):
        program.kernel(device, "add.cl", "subtract", STEP=1)


def test_a_missing_source_is_an_error(device: Device, folder: Path) -> None:
    with pytest.raises(DeviceError, match=r"nowhere\.cl is missing"):
        program.kernel(device, "nowhere.cl", "nothing")
    (folder / "lost.cl").write_text('#include "lost.h"\n')
    with pytest.raises(DeviceError, match=r"lost\.h is missing"):
        program.kernel(device, "lost.cl", "nothing")


@pytest.mark.parametrize("defines", [{"STEP": "a b"}, {"STEP": 'a"b'}, {"ST EP": 1}, {"STEP": "a\\b"}])
def test_macros_that_would_break_the_option_string_are_refused(
    device: Device, folder: Path, defines: dict[str, Any]
) -> None:
    with pytest.raises(ValueError, match="not a macro"):
        program.kernel(device, "add.cl", "add", **defines)


def test_no_compiler_warning_reaches_the_caller(device: Device, folder: Path) -> None:
    (folder / "chatty.cl").write_text(
        "kernel void chatty(global int *values) { int unused; values[0] = 1; }\n"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        program.kernel(device, "chatty.cl", "chatty")


def test_threads_share_the_program_and_have_kernels_of_their_own(device: Device, folder: Path) -> None:
    count = len(program.builds(device))
    kernels: list[Any] = []
    failures: list[BaseException] = []

    def work() -> None:
        try:
            kernel = program.kernel(device, "add.cl", "add", STEP=5)
            assert run(device, kernel, [1]) == [106]
            kernels.append(kernel)
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=work) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures
    assert len(program.builds(device)) == count + 1
    assert len({id(kernel) for kernel in kernels}) == 6


CHILD = """
import logging, sys
logging.basicConfig(format="%(message)s", level=logging.WARNING)
from clgrid import device, program
from clgrid.errors import DeviceError
try:
    chosen = device.choose(sys.argv[1])
    program.check_structs(chosen)
    program.kernel(chosen, "check_structs.cl", "check_structs", SALT=1)
except DeviceError as error:
    sys.exit(f"refused: {error}")
"""


def child(device: Device, code: str = CHILD, **environment: str) -> subprocess.CompletedProcess[str]:
    """Use ``device`` in a process of its own with these variables set."""
    return subprocess.run(
        [sys.executable, "-c", code, device.label],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_without_a_linker_the_user_reads_a_cure_and_not_aborted(device: Device, tmp_path: Path) -> None:
    if not device.description.is_pocl:
        pytest.skip("only PoCL links")
    (tmp_path / "bin").mkdir()
    used = child(
        device, PATH=str(tmp_path / "bin"), XDG_CACHE_HOME=str(tmp_path), POCL_CACHE_DIR=str(tmp_path)
    )
    assert used.returncode == 1
    assert "refused" in used.stderr
    assert "PoCL cannot link kernels: there is no linker (ld); run: " in used.stderr
    assert "Abort" not in used.stderr


WITHOUT_KERNELS = """
import sys
import pyopencl as cl
from clgrid import device
cl.Program(device.choose(sys.argv[1]).context, "int nothing(int x) { return x; }").build()
"""


@pytest.mark.slow
def test_a_cache_entry_that_lost_its_kernels_is_worked_around(device: Device, tmp_path: Path) -> None:
    if not device.description.is_pocl:
        pytest.skip("only PoCL has a cache of its own")
    cache, empty = tmp_path / "kernels", tmp_path / "empty"
    assert child(device, XDG_CACHE_HOME=str(tmp_path), POCL_CACHE_DIR=str(cache)).returncode == 0
    assert child(device, WITHOUT_KERNELS, POCL_CACHE_DIR=str(empty)).returncode == 0
    [lost] = empty.glob("*/*/program.bc")
    entries = list(cache.glob("*/*/program.bc"))
    assert entries
    for entry in entries:
        shutil.copy(lost, entry)
    used = child(device, XDG_CACHE_HOME=str(tmp_path), POCL_CACHE_DIR=str(cache))
    assert used.returncode == 0, used.stderr
    assert f"PoCL's kernel cache is damaged by an earlier crash: delete the folder {cache}" in used.stderr


@pytest.mark.slow
@pytest.mark.parametrize("damage", ["cut", "died"])
def test_settled_damage_is_deleted_before_the_first_build(
    device: Device, tmp_path: Path, damage: str
) -> None:
    if not device.description.is_pocl:
        pytest.skip("only PoCL has a cache of its own")
    environment = {"XDG_CACHE_HOME": str(tmp_path), "POCL_CACHE_DIR": str(tmp_path / "kernels")}
    assert child(device, **environment).returncode == 0
    healthy = child(device, **environment)
    assert "deleting" not in healthy.stderr
    entries = list((tmp_path / "kernels").glob("*/*/program.bc"))
    assert entries
    for entry in entries:
        compiled = next((place for place in entry.parent.glob("*/*") if place.is_dir()), None)
        if damage == "died" and compiled is not None:
            for file in compiled.iterdir():
                file.unlink()
        else:
            for place in [place for place in entry.parent.iterdir() if place.is_dir()]:
                shutil.rmtree(place)
            entry.write_bytes(entry.read_bytes()[:1500])
    for place in (tmp_path / "kernels").rglob("*"):
        os.utime(place, (time.time() - 3600,) * 2)
    used = child(device, **environment)
    assert used.returncode == 0, used.stderr
    assert used.stderr.count("deleting") == len(entries)
