import json
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from clgrid import device as devices
from clgrid import doctor, probe, registration
from clgrid.device import Device
from clgrid.doctor import Finding, Verdict, abilities, drivers, installing, settings, trial
from clgrid.errors import DeviceError

COMMAND = "import sys; from clgrid.cli import main; main(sys.argv[1:])"


def clgrid(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run the command line in a process of its own with these variables set."""
    return subprocess.run(
        [sys.executable, "-c", COMMAND, *arguments],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def report(used: subprocess.CompletedProcess[str]) -> dict[str, Any]:
    """The JSON document of ``clgrid doctor --json``, and nothing else."""
    document = json.loads(used.stdout)
    assert document["schema"] == "clgrid.doctor/1"
    assert {finding["status"] for finding in document["findings"]} <= {"ok", "warn", "fail"}
    assert all("\n" not in finding["message"] + finding["advice"] for finding in document["findings"])
    assert all(finding["advice"] for finding in document["findings"] if finding["status"] != "ok")
    return dict(document)


def of_check(document: dict[str, Any], check: str) -> list[dict[str, Any]]:
    return [finding for finding in document["findings"] if finding["check"] == check]


def test_a_device_that_works_is_said_to_work(device: Device) -> None:
    used = clgrid("doctor", "--json", "--no-selftest", "--device", device.label)
    assert used.returncode == 0, used.stderr
    document = report(used)
    assert document["usable"] == [device.label]
    assert document["default"] in {description.label for description in devices.describe_all()}
    [compiled] = of_check(document, "compile")
    assert (compiled["status"], compiled["device"]) == ("ok", device.label)
    assert compiled["seconds"] > 0
    assert of_check(document, "pyopencl")[0]["status"] == "ok"
    assert all(entry["may_run"] and entry["why"] for entry in document["rungs"])


@pytest.mark.thorough
def test_the_self_test_of_each_strict_rung_really_runs(device: Device) -> None:
    for _ in range(2):  # whether it is remembered or not
        used = clgrid("doctor", "--json", "--device", device.label)
        assert used.returncode == 0, used.stderr
        rungs = {entry["rung"]: entry for entry in report(used)["rungs"]}
        assert list(rungs) == ["fast", "robust", "precise", "exact"]
        assert all(entry["may_run"] for entry in rungs.values())
        assert [name for name, entry in rungs.items() if entry["tested"]] == ["robust", "precise", "exact"]
        assert all(rungs[name]["seconds"] > 0.1 for name in ("robust", "precise", "exact"))


def test_the_table_says_what_the_json_says(device: Device) -> None:
    used = clgrid("doctor", "--no-selftest", "--device", device.label)
    assert used.returncode == 0, used.stderr
    assert f"{device.label}: first compile and launch" in used.stdout


def test_an_icd_file_that_names_a_missing_library_is_named(device: Device, tmp_path: Path) -> None:
    broken = tmp_path / "broken.icd"
    broken.write_text("/gone/libother.so\n")
    (tmp_path / "empty.icd").write_text("")
    used = clgrid("doctor", "--json", "--no-selftest", OCL_ICD_VENDORS=str(tmp_path))
    faults = [finding for finding in of_check(report(used), "icd") if finding["status"] == "warn"]
    assert len(faults) == 2
    assert f"{broken} names /gone/libother.so, which cannot be loaded" in faults[0]["message"]
    assert f"delete {broken}" in faults[0]["advice"]
    assert "empty.icd names no library" in faults[1]["message"]


def test_no_platform_is_exit_code_3_with_what_to_install(tmp_path: Path) -> None:
    # Naming one .icd file isolates it, also from the drivers inside pyopencl.
    (tmp_path / "only.icd").write_text("/gone/libonly.so\n")
    hidden = {"OCL_ICD_VENDORS": str(tmp_path / "only.icd")}
    used = clgrid("doctor", "--json", **hidden)
    assert used.returncode == 3, used.stderr
    document = report(used)
    assert document["usable"] == []
    assert document["default"] is None
    [platforms] = of_check(document, "platforms")
    assert platforms["status"] == "fail"
    assert "pip install" in platforms["advice"]
    assert [finding["status"] for finding in of_check(document, "icd")] == ["ok", "warn"]
    listed = clgrid("devices", "--json", **hidden)
    assert listed.returncode == 3
    assert json.loads(listed.stdout)["devices"] == []
    assert len(listed.stderr.splitlines()) == 1


def test_a_pocl_without_a_linker_is_explained(device: Device, tmp_path: Path) -> None:
    if not device.description.is_pocl:
        pytest.skip("only PoCL links")
    used = clgrid("doctor", "--json", "--device", device.label, PATH=str(tmp_path))
    assert used.returncode == 3
    [compiled] = of_check(report(used), "compile")
    assert compiled["status"] == "fail"
    assert "there is no linker (ld)" in compiled["message"]
    assert compiled["advice"] == probe.linker_cure()


def test_a_damaged_kernel_cache_is_found(tmp_path: Path) -> None:
    entry = tmp_path / "AB" / "CDEF"
    entry.mkdir(parents=True)
    program = entry / "program.bc"
    program.write_bytes(b"BC\xc0\xde" + bytes(10))
    os.utime(program, (time.time() - 3600,) * 2)
    [cache] = of_check(
        report(clgrid("doctor", "--json", "--no-selftest", POCL_CACHE_DIR=str(tmp_path))), "cache"
    )
    assert cache["status"] == "warn"
    assert str(entry) in cache["message"]
    assert cache["advice"] == f"rm -r {tmp_path}"


def test_intels_runtime_that_the_users_setting_leaves_out_is_named(tmp_path: Path) -> None:
    if registration.intel_library() is None:
        pytest.skip("Intel's runtime is not installed in this environment")
    document = report(clgrid("doctor", "--json", "--no-selftest", OCL_ICD_VENDORS=str(tmp_path)))
    [intel] = of_check(document, "intel")
    assert intel["status"] == "warn"
    assert f"installed but OCL_ICD_VENDORS={tmp_path} leaves it out" in intel["message"]
    assert intel["advice"] == "unset OCL_ICD_VENDORS"


def intel_findings(monkeypatch: pytest.MonkeyPatch, math: Path | None) -> list[Finding]:
    for variable in registration.LOADER_VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(registration, "intel_library", lambda: Path("/venv/lib/libintelocl.so"))
    monkeypatch.setattr(registration, "intel_math_library", lambda: math)
    return list(drivers.intel([]))


def test_intels_runtime_without_its_math_library_is_explained(monkeypatch: pytest.MonkeyPatch) -> None:
    [finding] = intel_findings(monkeypatch, None)
    assert finding.status == "warn"
    assert "libimf.so" in finding.message
    assert finding.advice == "pip install intel-cmplr-lib-rt"


def test_intels_runtime_that_is_not_registered_is_explained(monkeypatch: pytest.MonkeyPatch) -> None:
    [finding] = intel_findings(monkeypatch, Path("/venv/lib/libimf.so"))
    assert finding.status == "warn"
    assert finding.advice == "clgrid doctor --fix"
    monkeypatch.setattr(sys, "base_prefix", sys.prefix)
    [finding] = intel_findings(monkeypatch, Path("/venv/lib/libimf.so"))
    assert finding.advice == "as root: echo /venv/lib/libintelocl.so > /etc/OpenCL/vendors/intel-cpu.icd"


def test_no_double_precision_and_a_small_allocation_limit_are_found(device: Device) -> None:
    poor = replace(device.description, fp64=False, max_allocation=2**28)
    found = {finding.check: finding for finding in abilities.abilities(poor)}
    assert found["fp64"].status == "fail"
    assert found["allocation"].status == "warn"
    assert "one buffer may take 0.2 of" in found["allocation"].message
    assert ("HWLOC_SYNTHETIC" in found["allocation"].advice) == device.description.is_pocl
    rich = replace(device.description, fp64=True, max_allocation=2**50)
    assert {finding.status for finding in abilities.abilities(rich)} == {"ok"}


def test_a_slow_compile_is_found(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    slow = probe.Outcome(ok=True, seconds=25.0, reason="", cure="")
    monkeypatch.setattr(probe, "attempt", lambda *_: slow)
    finding = abilities.first_compile(device.description)
    assert (finding.status, finding.seconds) == ("warn", 25.0)
    assert "POCL_CACHE_DIR" in finding.advice


@pytest.mark.parametrize(
    ("crash", "said"),
    [
        ("import os; os.abort()", "killed by SIGABRT"),
        ("raise SystemExit('no such driver')", "no such driver"),
    ],
)
def test_a_driver_that_crashes_on_listing_does_not_take_the_doctor_along(
    monkeypatch: pytest.MonkeyPatch, crash: str, said: str
) -> None:
    monkeypatch.setattr(probe, "child_command", lambda *_: [sys.executable, "-c", crash])
    finding = drivers.listing()
    assert finding.status == "fail"
    assert f"listing OpenCL devices fails: {said}" in finding.message


def test_a_device_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    used = clgrid("doctor", "--device", "radeon")
    assert used.returncode == 3
    assert used.stdout == ""
    [line] = used.stderr.splitlines()
    assert "no OpenCL device matches 'radeon'; there are: 0 " in line


def test_a_wrong_setting_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CLGRID_DEVICE", "radeon")
    finding, chosen = doctor._default()
    assert chosen is None
    assert finding.status == "fail"
    assert "CLGRID_DEVICE" in finding.advice


SPOILT = """
import sys; sys.path[:] = {path!r}
from clgrid import selftest
from clgrid.doctor import trial
selftest.EXPECTED["robust"] = "0123456789abcdef"
trial.main(*sys.argv[1:])
"""


def verdict(monkeypatch: pytest.MonkeyPatch, device: Device, code: str, **options: float) -> Verdict:
    """What becomes of the self-test of `robust` where this runs in its place."""
    monkeypatch.setattr(probe, "child_command", lambda _, *rest: [sys.executable, "-c", code, *rest])
    return trial.attempt(device.description, "robust", **options)


@pytest.mark.thorough
def test_a_self_test_that_fails_crashes_or_hangs_is_said(
    device: Device, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    wrong = verdict(monkeypatch, device, SPOILT.format(path=sys.path))
    assert (wrong.may_run, wrong.tested) == (False, True)
    assert wrong.why == "hits do not have the bits that exact rules of rounding give"
    crashed = verdict(monkeypatch, device, "import os; os.abort()")
    assert crashed.why == "its self-test ends the process: killed by SIGABRT"
    hung = verdict(monkeypatch, device, "import time; time.sleep(60)", timeout=0.5)
    assert hung.why == "its self-test does not end within 0 s"
    for failed in (crashed, hung):
        [finding] = trial.findings(device.description, [failed])
        assert (finding.status, finding.device) == ("fail", device.label)
        assert finding.message.startswith(f"refused for robust ({failed.seconds:.1f} s): ")
        assert finding.advice


def test_a_device_that_compiles_nothing_or_has_no_doubles_may_run_nothing(device: Device) -> None:
    failed = Finding("compile", "fail", device.label, "no linker")
    found = list(trial.verdicts(device.description, failed, run=True, progress=None))
    assert {(verdict.may_run, verdict.why) for verdict in found} == {(False, "the device compiles no kernel")}
    [finding] = trial.findings(device.description, found)
    assert finding.advice == "see above"
    compiled, poor = Finding("compile", "ok", device.label, ""), replace(device.description, fp64=False)
    found = list(trial.verdicts(poor, compiled, run=True, progress=None))
    assert {verdict.may_run for verdict in found} == {False}


def test_variables_that_do_harm_or_would_help_are_named(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    threads = "POCL_MAX_PTHREAD_COUNT" if device.description.is_pocl else "CL_CONFIG_CPU_TBB_NUM_WORKERS"
    for variable in (threads, "POCL_WORK_GROUP_METHOD", "POCL_MEMORY_LIMIT"):
        monkeypatch.delenv(variable, raising=False)
    two = replace(device.description, compute_units=2)
    monkeypatch.setattr(settings, "processors", lambda: 2)
    assert list(settings.settings(two)) == []
    monkeypatch.setattr(settings, "processors", lambda: 1)
    [finding] = settings.settings(two)
    assert (finding.status, finding.advice) == ("warn", f"export {threads}=1")
    monkeypatch.setattr(settings, "processors", lambda: 2)
    monkeypatch.setenv(threads, "1")
    [finding] = settings.settings(two)
    assert finding.message == f"{threads}=1 leaves 1 of 2 processors idle"
    assert finding.advice == f"unset {threads}"
    monkeypatch.delenv(threads)
    monkeypatch.setenv("POCL_WORK_GROUP_METHOD", "repl")
    monkeypatch.setenv("POCL_MEMORY_LIMIT", "2")
    advice = [finding.advice for finding in settings.settings(two)]
    pocls = ["unset POCL_WORK_GROUP_METHOD", "unset POCL_MEMORY_LIMIT"]
    assert advice == (pocls if device.description.is_pocl else [])
    assert list(settings.settings(replace(two, platform="Other", platform_version="1", implicit=False))) == []


def test_processors_are_those_of_affinity_and_quota(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2, 3})
    limit = tmp_path / "cpu.max"
    monkeypatch.setattr(settings, "_CPU_MAX", limit)
    assert settings.processors() == 4
    for text, count in (("max 100000", 4), ("150000 100000", 2), ("1000 100000", 1), ("900000 100000", 4)):
        limit.write_text(text + "\n")
        assert settings.processors() == count


def test_what_could_be_installed_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registration, "intel_library", lambda: None)
    monkeypatch.setattr(installing.shutil, "which", lambda _: "/usr/bin/apt-get")
    bare = {finding.advice: finding.message for finding in installing.installable([])}
    assert "pip install 'pyopencl[pocl]'" in bare
    assert "pip install intel-opencl-rt intel-cmplr-lib-rt" in bare
    assert "as root: apt-get install -y --no-install-recommends pocl-opencl-icd" in bare
    assert "65,535" in bare[""]
    pocl = next(each for each in devices.describe_all() if each.is_pocl)
    others = [
        replace(pocl, driver_version="3.0-rc2"),
        replace(pocl, driver_version="3.1+debian"),
        replace(pocl, platform="Intel(R) OpenCL", platform_version="OpenCL 3.1"),
        replace(pocl, platform="Oclgrind", platform_version="OpenCL 1.2", implicit=False),
        replace(pocl, platform="rusticl", platform_version="OpenCL 3.0", implicit=False),
    ]
    assert list(installing.installable(others)) == []
    monkeypatch.setattr(installing.shutil, "which", lambda _: None)
    assert all("apt-get" not in finding.advice for finding in installing.installable([]))


def test_the_list_of_devices_as_json_and_as_a_table() -> None:
    used = clgrid("devices", "--json")
    assert used.returncode == 0, used.stderr
    document = json.loads(used.stdout)
    assert document["schema"] == "clgrid.devices/1"
    found = devices.describe_all()
    assert [entry["label"] for entry in document["devices"]] == [description.label for description in found]
    first = document["devices"][0]
    assert first["max_allocation"] == found[0].max_allocation
    assert {"platform", "name", "driver_version", "version", "compute_units", "global_memory"} <= set(first)
    assert {"fp64", "correctly_rounded_divide", "denormals"} <= set(first)
    table = clgrid("devices")
    assert table.returncode == 0
    assert all(description.label in table.stdout for description in found)


def test_without_pyopencl_the_doctor_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registration, "_pyopencl", None)
    monkeypatch.setitem(sys.modules, "pyopencl", None)
    finding = drivers.pyopencl()
    assert finding.status == "fail"
    with pytest.raises(DeviceError, match="pyopencl cannot be imported"):
        registration.opencl()
