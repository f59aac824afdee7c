"""How the real-time component gets onto a control: compiled there, or as the Debian package brings it. In part with
Debian's linuxcnc-uspace-dev.
"""

import shutil
import subprocess
from pathlib import Path

import pytest

from simulators.linuxcnc.machine import FILES

ROOT = Path(__file__).parents[3]
MODULE = "usr/lib/linuxcnc/modules/talc_errors.so"
HERE = "amd64 2.9.0-1"


@pytest.fixture
def control(tmp_path: Path) -> Path:
    """A folder with the files for the control; dpkg answers with HERE, and halcompile is missing."""
    folder, programs = tmp_path / "linuxcnc", tmp_path / "programs"
    shutil.copytree(FILES, folder, ignore=shutil.ignore_patterns("__pycache__"))
    programs.mkdir()
    for name in ("sh", "dirname", "cat", "install", "echo"):
        found = shutil.which(name)
        assert found is not None, name
        (programs / name).symlink_to(found)
    for name, answer in zip(("dpkg", "dpkg-query"), HERE.split(), strict=True):
        (programs / name).write_text(f"#!/bin/sh\nprintf %s {answer}\n")
        (programs / name).chmod(0o755)
    return folder


def install(control: Path) -> subprocess.CompletedProcess[str]:
    environment = {"PATH": str(control.parent / "programs"), "DESTDIR": str(control.parent / "root")}
    command = ["sh", str(control / "install.sh")]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def test_the_prebuilt_component_is_installed_where_it_fits(control: Path) -> None:
    (control / "prebuilt").mkdir()
    (control / "prebuilt" / "talc_errors.so").write_bytes(b"component")
    (control / "prebuilt" / "made-for").write_text(f"{HERE}\n")
    done = install(control)
    assert done.returncode == 0, done.stderr
    assert (control.parent / "root" / MODULE).read_bytes() == b"component"


@pytest.mark.parametrize("made_for", ["amd64 2.9.0-2", "arm64 2.9.0-1"])
def test_one_for_another_linuxcnc_or_processor_is_refused_by_name(made_for: str, control: Path) -> None:
    (control / "prebuilt").mkdir()
    (control / "prebuilt" / "talc_errors.so").write_bytes(b"component")
    (control / "prebuilt" / "made-for").write_text(f"{made_for}\n")
    done = install(control)
    assert done.returncode == 1
    assert f"is for {made_for}, here is {HERE}: apt-get install linuxcnc-uspace-dev" in done.stderr
    assert not (control.parent / "root" / MODULE).exists()


def test_without_either_it_says_what_to_install(control: Path) -> None:
    done = install(control)
    assert (done.returncode, done.stderr) == (1, "halcompile is missing: apt-get install linuxcnc-uspace-dev\n")


@pytest.mark.peer
def test_the_package_brings_the_component_that_was_compiled_here(tmp_path: Path) -> None:
    script = ROOT / "deploy" / "debian" / "linuxcnc_component.sh"
    for folder in ("first", "second"):
        subprocess.run([str(script), str(tmp_path / folder)], check=True, capture_output=True)
    built = (tmp_path / "first" / "talc_errors.so").read_bytes()
    assert built.startswith(b"\x7fELF")
    assert b"talc-errors" in built
    assert built == (tmp_path / "second" / "talc_errors.so").read_bytes(), "a package can be built again"
    command = ["dpkg-query", "-W", "-f", "${Version}", "linuxcnc-uspace"]
    version = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    assert (tmp_path / "first" / "made-for").read_text().split()[1] == version
