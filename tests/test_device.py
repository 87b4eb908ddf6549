import ctypes
import logging
import subprocess
import sys
import types
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from clgrid import device as devices
from clgrid import pocl, probe
from clgrid.description import Description
from clgrid.device import Device
from clgrid.errors import DeviceError

POCL30 = Description(
    index=0,
    label="pocl-3.0",
    platform="Portable Computing Language",
    platform_version="OpenCL 3.0 PoCL 3.0-rc2",
    name="pthread-Intel(R) Core(TM) i7",
    vendor="GenuineIntel",
    driver_version="3.0-rc2",
    version="OpenCL 3.0 PoCL",
    c_version="OpenCL C 1.2 PoCL",
    type="CPU",
    compute_units=2,
    global_memory=2**33,
    max_allocation=2**31,
    fp64=True,
    correctly_rounded_divide=True,
    denormals=True,
    implicit=True,
    preferred=False,
    note="",
)
POCL71 = replace(
    POCL30, index=1, label="pocl-7.1", driver_version="7.1", platform_version="OpenCL 3.0 PoCL 7.1"
)
INTEL = replace(
    POCL30,
    index=2,
    label="intel",
    platform="Intel(R) OpenCL",
    platform_version="OpenCL 3.1 LINUX",
    name="Intel(R) Core(TM) i7",
    vendor="Intel(R) Corporation",
    driver_version="2026.22.10.0",
)
OCLGRIND = replace(
    POCL30,
    index=3,
    label="oclgrind",
    platform="Oclgrind",
    platform_version="OpenCL 1.2 (Oclgrind 21.10)",
    name="Oclgrind Simulator",
    vendor="University of Bristol",
    driver_version="Oclgrind 21.10",
    type="CPU+GPU+ACCELERATOR",
    implicit=False,
)
GPU = replace(
    POCL30,
    index=4,
    label="nvidia",
    platform="NVIDIA CUDA",
    platform_version="OpenCL 3.0 CUDA",
    name="NVIDIA RTX",
    vendor="NVIDIA",
    driver_version="555",
    type="GPU",
)
ALL = [POCL30, POCL71, INTEL, OCLGRIND, GPU]

Pretend = Callable[..., None]


@pytest.fixture
def pretend(monkeypatch: pytest.MonkeyPatch) -> Pretend:
    """Make the loader list these devices, of which the labels in ``broken`` cannot compile."""

    def install(descriptions: list[Description], broken: tuple[str, ...] = ()) -> None:
        found = tuple((replace(d, index=i), object()) for i, d in enumerate(descriptions))
        monkeypatch.setattr(devices, "_find", lambda: found)
        monkeypatch.setattr(devices, "_devices", {})
        bad = probe.Outcome(ok=False, seconds=0, reason="there is no linker", cure="run: apt-get install gcc")
        monkeypatch.setattr(devices, "usable", lambda d: bad if d.label in broken else probe.GOOD)

    return install


@pytest.mark.parametrize(
    ("selector", "label"),
    [
        ("2", "intel"),
        ("intel", "intel"),
        ("INTEL", "intel"),
        ("pocl-7.1", "pocl-7.1"),
        ("7.1", "pocl-7.1"),
        ("3.0-rc2", "pocl-3.0"),
        ("pocl:3.0-rc2", "pocl-3.0"),
        ("portable:7.1", "pocl-7.1"),
        ("oclgrind", "oclgrind"),
        ("Simulator", "oclgrind"),
        ("0:0", "pocl-3.0"),
        ("2:core", "intel"),
        ("cuda:0", "nvidia"),
        ("rtx", "nvidia"),
    ],
)
def test_a_selector_names_one_device(pretend: Pretend, selector: str, label: str) -> None:
    pretend(ALL)
    assert devices.choose(selector).label == label


@pytest.mark.parametrize("selector", ["pocl", "portable", "portable:0:1", "core"])
def test_a_selector_that_fits_several_devices_lists_them_in_one_line(pretend: Pretend, selector: str) -> None:
    pretend(ALL)
    with pytest.raises(DeviceError) as caught:
        devices.choose(selector)
    message = str(caught.value)
    assert "\n" not in message
    if selector != "portable:0:1":
        assert "pocl-3.0" in message
        assert "pocl-7.1" in message
        assert "oclgrind" not in message


@pytest.mark.parametrize("selector", ["9", "radeon", "pocl:9", "nothing:0", "7:0"])
def test_a_selector_that_fits_nothing_lists_what_there_is(pretend: Pretend, selector: str) -> None:
    pretend(ALL)
    with pytest.raises(DeviceError, match=r"no OpenCL device matches .*; there are: .*intel.*nvidia"):
        devices.choose(selector)


def test_the_same_device_registered_twice_is_no_ambiguity(pretend: Pretend) -> None:
    pretend([POCL30, replace(POCL30, label="pocl-3.0-2")])
    assert devices.choose("portable").description.index == 0


def test_the_variable_names_the_device_and_an_argument_goes_first(
    pretend: Pretend, monkeypatch: pytest.MonkeyPatch
) -> None:
    pretend(ALL)
    monkeypatch.setenv("CLGRID_DEVICE", "nvidia")
    assert devices.choose().label == "nvidia"
    assert devices.choose("intel").label == "intel"
    monkeypatch.setenv("CLGRID_DEVICE", "")
    assert devices.choose().label == "intel"


@pytest.mark.parametrize(
    ("present", "label"),
    [
        ([OCLGRIND, GPU, POCL30, INTEL], "intel"),
        ([OCLGRIND, GPU, POCL30, POCL71], "pocl-7.1"),
        ([POCL71, POCL30], "pocl-7.1"),
        ([replace(POCL30, label="pocl-10.0", driver_version="10.0"), POCL71], "pocl-10.0"),
        ([OCLGRIND, GPU], "nvidia"),
    ],
)
def test_the_default_is_the_best_cpu_and_no_simulator(
    pretend: Pretend, present: list[Description], label: str
) -> None:
    pretend(present)
    assert devices.choose().label == label


def test_a_pocl_that_cannot_link_is_passed_over_with_a_warning(
    pretend: Pretend, caplog: pytest.LogCaptureFixture
) -> None:
    pretend([POCL30, POCL71, GPU], broken=("pocl-7.1", "pocl-3.0"))
    with caplog.at_level(logging.WARNING):
        assert devices.choose().label == "nvidia"
    assert "pocl-7.1 passed over: there is no linker; run: apt-get install gcc; using nvidia" in caplog.text


def test_no_device_that_works_is_an_error_with_the_cure(pretend: Pretend) -> None:
    pretend([POCL30], broken=("pocl-3.0",))
    with pytest.raises(DeviceError, match="there is no linker; run: apt-get install gcc"):
        devices.choose()
    pretend([OCLGRIND])
    with pytest.raises(DeviceError, match=r"oclgrind.*pip install"):
        devices.choose()
    pretend([])
    with pytest.raises(DeviceError, match="no OpenCL device: pip install"):
        devices.choose()
    with pytest.raises(DeviceError, match="no OpenCL device 'intel', nor any other"):
        devices.choose("intel")


def test_a_named_device_that_cannot_link_is_refused_before_its_first_build(pretend: Pretend) -> None:
    pretend(ALL, broken=("pocl-3.0",))
    with pytest.raises(DeviceError, match=r"pocl-3\.0: there is no linker"):
        devices.choose("pocl-3.0").require_usable()


def test_a_device_without_fp64_is_refused_by_name(pretend: Pretend) -> None:
    pretend([replace(POCL30, fp64=False)])
    with pytest.raises(DeviceError, match=r"pocl-3\.0: no double precision .* name a device with fp64"):
        devices.choose("pocl-3.0").require_usable()


def test_a_device_is_made_once(device: Device) -> None:
    assert devices.choose(device.label) is device
    assert devices.choose(str(device.description.index)) is device
    assert devices.choose(device) is device
    assert device.context is device.context
    assert device.queue is device.queue


def test_descriptions_hold_what_the_driver_reports(device: Device) -> None:
    found = devices.describe_all()
    assert [d.index for d in found] == list(range(len(found)))
    assert len({d.label for d in found}) == len(found)
    assert sum(d.preferred for d in found) == 1
    description = found[device.description.index]
    assert description == device.description
    assert description.driver_version == device.cl_device.driver_version
    assert description.max_allocation == device.cl_device.max_mem_alloc_size
    assert description.fp64 == ("cl_khr_fp64" in device.cl_device.extensions)


FORKED = """
import os, sys
from clgrid import device
from clgrid.errors import DeviceError
chosen = device.choose(sys.argv[1])
chosen.queue
child = os.fork()
if child == 0:
    refused = 0
    for use in (lambda: chosen.queue, lambda: chosen.context, device.choose, device.describe_all):
        try:
            use()
        except DeviceError as error:
            refused += "spawn" in str(error)
    os._exit(refused)
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


def test_a_forked_process_is_told_instead_of_hanging(device: Device) -> None:
    child = subprocess.run([sys.executable, "-c", FORKED, device.label], timeout=60, check=False)
    assert child.returncode == 4


def test_a_pocl_without_a_linker_is_found_out_in_a_child(
    device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not device.description.is_pocl:
        pytest.skip("only PoCL links")
    monkeypatch.setenv("PATH", str(tmp_path))
    facts = device.description
    outcome = probe.attempt(facts.platform, facts.name, facts.driver_version)
    assert not outcome.ok
    assert outcome.reason == "PoCL cannot link kernels: there is no linker (ld)"
    assert outcome.cure == probe.linker_cure()


def test_only_a_success_is_remembered_by_other_processes(
    device: Device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    facts = (device.description.platform, device.description.name, device.description.driver_version)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(probe, "_known", {})
    bad = probe.Outcome(ok=False, seconds=0, reason="no", cure="none")
    monkeypatch.setattr(probe, "attempt", lambda *_: bad)
    assert probe.remembered(*facts) == bad
    assert not list(tmp_path.rglob("*.json"))
    good = replace(bad, ok=True, reason="", cure="")
    monkeypatch.setattr(probe, "_known", {})
    monkeypatch.setattr(probe, "attempt", lambda *_: good)
    assert probe.remembered(*facts).ok
    monkeypatch.setattr(probe, "_known", {})
    monkeypatch.setattr(probe, "attempt", lambda *_: bad)
    assert probe.remembered(*facts).ok
    # Another linker is another trial.
    (tmp_path / "ld").touch(mode=0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(probe, "_known", {})
    assert not probe.remembered(*facts).ok


def test_a_compiler_that_hangs_is_given_up(device: Device) -> None:
    facts = device.description
    outcome = probe.attempt(facts.platform, facts.name, facts.driver_version, timeout=0.01)
    assert not outcome.ok
    assert "takes more than" in outcome.reason


@pytest.mark.parametrize(
    ("output", "reason"),
    [
        ("/usr/bin/ld: cannot find -lgcc: No such file\nerror: linker command failed", "-lgcc is missing"),
        ("/usr/bin/ld: cannot find crti.o: No such file", "crti.o is missing"),
        ("error: unknown target CPU 'generic'", "older than this processor"),
        ("LLVM ERROR: Cannot select: t1", "LLVM ERROR: Cannot select: t1"),
        ("", "no message"),
    ],
)
def test_the_reason_is_taken_from_what_the_driver_says(
    monkeypatch: pytest.MonkeyPatch, output: str, reason: str
) -> None:
    monkeypatch.setattr(probe.shutil, "which", lambda _: "/usr/bin/ld")
    said, cure = probe.explain(output, -6)
    assert reason in said
    assert cure
    assert "\n" not in said + cure


@pytest.mark.parametrize(
    ("output", "telling"),
    [
        ("LLVM ERROR: planted\n", "LLVM ERROR: planted"),
        (
            "LLVM ERROR: planted\nPLEASE submit a bug report to https://example.org/ and include the crash"
            " backtrace.\nStack dump:\n0.\tRunning pass 'X86'\n #0 0x00007f3a llvm::sys::PrintStackTrace()\n"
            "/usr/lib/libLLVM.so.15(+0xe3fd30)[0x7f3a]\n\n",
            "LLVM ERROR: planted",
        ),
        (
            "PLEASE submit a bug report to https://example.org/\n",
            "PLEASE submit a bug report to https://example.org/",
        ),
        ("Killed: 9 of 10 kernels\n", "Killed: 9 of 10 kernels"),
        (" \n", ""),
    ],
)
def test_the_last_words_of_a_crash_are_its_reason(output: str, telling: str) -> None:
    assert probe.telling_line(output.splitlines()) == telling


class FakeDevice:
    """A driver's device struct in this process's memory, as the PoCL of PyPI lays it out."""

    name = "pthread"

    def __init__(self, processor: bytes) -> None:
        self.version = f"OpenCL 3.0 PoCL HSTR: pthread-x86_64-unknown-linux-gnu-{processor.decode()} "
        self.processor = ctypes.create_string_buffer(processor)
        self.struct = (ctypes.c_void_p * 128)()
        self.struct[80] = ctypes.addressof(self.processor)
        self.int_ptr = ctypes.addressof(self.struct)

    def compiles_for(self) -> bytes:
        return ctypes.string_at(self.struct[80] or 0)


PYPI = types.SimpleNamespace(version=f"OpenCL 3.0 {pocl._PYPI_VERSION}, SLEEF, DISTRO, POCL_DEBUG")


@pytest.mark.skipif(sys.platform != "linux", reason="PoCL's build on PyPI is for Linux")
@pytest.mark.parametrize("now", [b"generic", b"znver3"])
def test_the_pocl_of_pypi_compiles_for_a_processor_that_its_functions_are_compiled_for(now: bytes) -> None:
    fake = FakeDevice(now)
    note = pocl.name_processor(PYPI, fake)
    assert fake.compiles_for() in {b"skylake-avx512", b"haswell", b"x86-64"}
    assert note.startswith(f"compiles for {fake.compiles_for().decode()}: ")


def test_no_other_driver_is_touched() -> None:
    other = types.SimpleNamespace(version="OpenCL 3.0 PoCL 3.1+debian  Linux, LLVM 15.0.6")
    fake = FakeDevice(b"generic")
    assert pocl.name_processor(other, fake) == ""
    assert fake.compiles_for() == b"generic"
    known = FakeDevice(b"skylake-avx512")
    assert pocl.name_processor(PYPI, known) == ""
    assert known.compiles_for() == b"skylake-avx512"
    lost = FakeDevice(b"generic")
    lost.struct[80] = 8  # nothing is mapped there
    assert pocl.name_processor(PYPI, lost) == ""
