"""``clgrid doctor --fix`` in environments made of folders, and in this one."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from clgrid import registration
from clgrid.doctor import drivers, repair
from clgrid.errors import DeviceError, InputError


@pytest.fixture
def environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A virtual environment with Intel's runtime and a pyopencl that brings its loader."""
    venv = tmp_path / "venv"
    (venv / "lib").mkdir(parents=True)
    for name in ("libintelocl.so", "libimf.so"):
        (venv / "lib" / name).touch()
    loader = venv / "site" / "pyopencl" / ".libs"
    loader.mkdir(parents=True)
    (loader.parent / "__init__.py").touch()
    (loader / "libOpenCL-1.so").touch()
    (loader / "pocl.icd").write_text("libpocl.so")
    (tmp_path / "vendors").mkdir()
    monkeypatch.syspath_prepend(venv / "site")
    monkeypatch.delitem(sys.modules, "pyopencl", raising=False)
    monkeypatch.setattr(sys, "prefix", str(venv))
    monkeypatch.setattr(registration, "SYSTEM_VENDORS", tmp_path / "vendors")
    monkeypatch.setattr(repair, "_fault", lambda: "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    for variable in registration.LOADER_VARIABLES:
        monkeypatch.setenv(variable, "")
        monkeypatch.delenv(variable)
    return venv


def test_the_file_is_written_once_and_says_how_to_undo_it(environment: Path) -> None:
    file = environment / "site" / "pyopencl" / ".libs" / "clgrid-intel.icd"
    library = environment / "lib" / "libintelocl.so"
    done = repair.fix()
    assert (done.check, done.status) == ("fix", "ok")
    assert done.message.startswith(f"wrote {file}, which names {library}")
    assert done.advice == f"to undo it: rm {file}"
    assert file.read_text() == f"{library}\n"
    assert file.stat().st_mode & 0o777 == 0o644
    written = file.stat().st_mtime_ns
    assert sorted(path.name for path in file.parent.iterdir()) == [
        "clgrid-intel.icd",
        "libOpenCL-1.so",
        "pocl.icd",
    ]
    again = repair.fix()
    assert again.message == f"nothing to do: {file} names {library} already"
    assert file.stat().st_mtime_ns == written


def test_clgrid_registers_nothing_beside_it(environment: Path) -> None:
    own = registration.register()
    assert os.environ["OCL_ICD_VENDORS"] == str(own)
    repair.fix()
    # A child of a process that registered it finds the variable set.
    assert registration.register() is None
    assert "OCL_ICD_VENDORS" not in os.environ
    [said] = [finding for finding in drivers.intel([]) if finding.check == "intel"]
    assert said.status == "warn"  # it is not among the devices, which are none here
    libraries = [library for library in registration.registered_libraries().values() if "intel" in library]
    assert libraries == [str(environment / "lib" / "libintelocl.so")]


def test_the_systems_own_registration_stands(environment: Path) -> None:
    system = registration.SYSTEM_VENDORS / "intel.icd"
    system.write_text(f"{environment}/lib/libintelocl.so\n")
    assert repair.fix().message.startswith(f"nothing to do: {system} names")
    assert not (environment / "site" / "pyopencl" / ".libs" / "clgrid-intel.icd").exists()


def refusal() -> str:
    with pytest.raises(InputError) as caught:
        repair.fix()
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 1
    return str(caught.value)


def test_it_refuses_what_is_no_venv(environment: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "base_prefix", str(environment))
    assert refusal().startswith(f"--fix writes only into virtual environments; {environment} is none")


def test_it_refuses_without_a_complete_runtime_or_a_loader(environment: Path, tmp_path: Path) -> None:
    loader = environment / "site" / "pyopencl" / ".libs" / "libOpenCL-1.so"
    loader.unlink()
    assert "this pyopencl brings no loader" in refusal()
    (environment / "lib" / "libimf.so").unlink()
    assert "libimf.so, which Intel's runtime needs, is not in" in refusal()
    (environment / "lib" / "libintelocl.so").unlink()
    assert "pip install intel-opencl-rt intel-cmplr-lib-rt" in refusal()


def test_it_refuses_a_pyopencl_of_another_place(environment: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (environment / "inner" / "lib").mkdir(parents=True)
    for name in ("libintelocl.so", "libimf.so"):
        (environment / "inner" / "lib" / name).touch()
    monkeypatch.setattr(sys, "prefix", str(environment / "inner"))
    assert "outside of" in refusal()


def test_what_does_not_help_is_removed_again(environment: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(repair, "_fault", lambda: "2 of Intel's platforms are seen")
    with pytest.raises(DeviceError, match="removed again, since it did not help: 2 of Intel's"):
        repair.fix()
    assert not (environment / "site" / "pyopencl" / ".libs" / "clgrid-intel.icd").exists()


def test_a_refusal_on_the_command_line_is_one_line(tmp_path: Path) -> None:
    if registration.intel_library() is not None:
        code = "import sys; sys.base_prefix = sys.prefix; from clgrid.cli import main; main(sys.argv[1:])"
    else:
        code = "import sys; from clgrid.cli import main; main(sys.argv[1:])"
    used = subprocess.run(
        [sys.executable, "-c", code, "doctor", "--fix", "--json"], capture_output=True, text=True, check=False
    )
    assert (used.returncode, used.stdout) == (1, "")
    [line] = used.stderr.splitlines()
    assert line.startswith("clgrid: error: ")
