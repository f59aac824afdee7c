"""How the real-time component gets onto a control: compiled there, or as the Debian package brings it.

In part with Debian's linuxcnc-uspace-dev.
"""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from simulators.linuxcnc.component import MODULES
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


LOADED = "loadrt talc_errors\nloadrt threads name1=servo-thread period1=1000000\naddf talc-errors servo-thread\n"
INSTALLED_AND_LOADED = (
    f'mount --bind "$1/modules" {MODULES} && mount --bind "$1" /tmp && sh /tmp/nc/install.sh '
    "&& exec halrun -f /tmp/loaded.hal"
)
NOBODY = 65534
"""LinuxCNC's real-time part refuses root unless it is told which user it works for."""


def listed(folder: Path) -> dict[str, tuple[int, int]]:
    """Length and time of change of each file."""
    return {file.name: (file.stat().st_size, file.stat().st_mtime_ns) for file in folder.iterdir()}


@pytest.mark.peer
def test_where_it_can_be_compiled_the_script_installs_one_that_linuxcnc_loads(tmp_path: Path) -> None:
    # A copy in place of the folder of LinuxCNC's modules, which only these processes see: nothing is installed.
    shutil.copytree(MODULES, tmp_path / "modules")
    (tmp_path / "modules" / "talc_errors.so").unlink(missing_ok=True)
    before = listed(MODULES)
    shutil.copytree(FILES, tmp_path / "nc", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "loaded.hal").write_text(f"{LOADED}getp talc-errors.x-bound\n")
    root = os.geteuid() == 0
    if root:
        os.chown(tmp_path, NOBODY, -1)
    done = subprocess.run(
        [
            *("unshare", *(() if root else ("--user", "--map-current-user", "--keep-caps"))),
            *("--mount", "--ipc", "--pid", "--fork", "--mount-proc", "--kill-child"),
            *("sh", "-c", INSTALLED_AND_LOADED, "sh", str(tmp_path)),
        ],
        env={"PATH": os.environ["PATH"], "HOME": "/tmp", **({"RTAPI_UID": str(NOBODY)} if root else {})},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1] == "1e+09", "the bound that the component begins with"
    assert (tmp_path / "modules" / "talc_errors.so").is_file()
    assert listed(MODULES) == before, "the computer's own modules, whether or not ours is among them"


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
