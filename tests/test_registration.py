"""Intel's runtime is registered beside the system's drivers, and the user's own settings stand."""

import os
import sys
from pathlib import Path

import pytest

from clgrid import registration
from clgrid.doctor import drivers


@pytest.fixture
def environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A Python environment with Intel's runtime on a system with one driver of its own."""
    (tmp_path / "venv" / "lib").mkdir(parents=True)
    (tmp_path / "venv" / "lib" / "libintelocl.so").touch()
    (tmp_path / "vendors").mkdir()
    (tmp_path / "vendors" / "pocl.icd").write_text("libpocl.so.2\n")
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "venv"))
    monkeypatch.setattr(registration, "SYSTEM_VENDORS", tmp_path / "vendors")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    for variable in registration.LOADER_VARIABLES:
        # Set first, so that whatever the test sets is undone.
        monkeypatch.setenv(variable, "")
        monkeypatch.delenv(variable)
    return tmp_path


def test_intels_runtime_is_registered_beside_the_systems_drivers(environment: Path) -> None:
    folder = registration.register()
    assert folder == environment / "venv" / "etc" / "clgrid" / "icd"
    assert os.environ["OCL_ICD_VENDORS"] == str(folder)
    assert sorted(registration.icd_libraries(folder).values()) == [
        str(environment / "venv" / "lib" / "libintelocl.so"),
        "libpocl.so.2",
    ]
    (environment / "vendors" / "pocl.icd").unlink()
    assert registration.user_setting() is None
    assert registration.register() == folder
    assert len(registration.icd_libraries(folder)) == 1


@pytest.mark.parametrize("variable", registration.LOADER_VARIABLES)
def test_the_users_own_loader_setting_stands(
    environment: Path, monkeypatch: pytest.MonkeyPatch, variable: str
) -> None:
    monkeypatch.setenv(variable, str(environment / "vendors"))
    assert registration.register() is None
    assert os.environ[variable] == str(environment / "vendors")
    assert registration.user_setting() == (variable, str(environment / "vendors"))


def test_nothing_is_registered_where_the_system_did_it(environment: Path) -> None:
    library = environment / "venv" / "lib" / "libintelocl.so"
    (environment / "vendors" / "intel.icd").write_text(f"{library}\n")
    assert registration.register() is None
    (environment / "vendors" / "intel.icd").write_text("/gone/libintelocl.so\n")
    assert registration.register() is not None


def test_an_environment_that_cannot_be_written_is_registered_in_the_cache(environment: Path) -> None:
    (environment / "venv" / "etc").touch()  # a file where the folder would go
    folder = registration.register()
    assert folder is not None
    assert folder.parent == environment / "cache" / "clgrid"


def test_a_runtime_below_a_folder_with_a_blank_is_linked_to_a_place_without(
    environment: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spaced = environment / "a b"
    (environment / "venv").rename(spaced)
    (spaced / "lib" / "libimf.so").touch()
    monkeypatch.setattr(sys, "prefix", str(spaced))
    folder = registration.register()
    assert folder is not None
    assert folder.parent == environment / "cache" / "clgrid"
    library = Path(registration.icd_libraries(folder)[folder / "clgrid-intel.icd"])
    assert " " not in str(library)
    assert library.samefile(spaced / "lib" / "libintelocl.so")
    assert (library.parent / "libimf.so").samefile(spaced / "lib" / "libimf.so")
    assert registration.register() == folder


def test_a_runtime_that_cannot_be_linked_is_left_alone(
    environment: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spaced = environment / "a b"
    (environment / "venv").rename(spaced)
    monkeypatch.setattr(sys, "prefix", str(spaced))
    monkeypatch.setenv("XDG_CACHE_HOME", str(spaced / "cache"))
    assert registration.register() is None
    assert "OCL_ICD_VENDORS" not in os.environ
    [finding] = drivers.intel([])
    assert "libimf" in finding.message
    (spaced / "lib" / "libimf.so").touch()
    [finding] = drivers.intel([])
    assert finding.status == "warn"
    assert "blank in its name" in finding.message


def test_nothing_is_registered_without_intels_runtime(environment: Path) -> None:
    (environment / "venv" / "lib" / "libintelocl.so").unlink()
    assert registration.register() is None
    assert "OCL_ICD_VENDORS" not in os.environ
