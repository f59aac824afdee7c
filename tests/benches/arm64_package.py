"""`python -m tests.benches.arm64_package PACKAGE`: the arm64 package in an arm64 Debian on another computer.

Debootstraps Debian for arm64; qemu-user runs its programs. Installs the package, runs the tests of the kernel with it,
upgrades, removes and purges. As root; needs debootstrap and qemu-user-static, whose binfmt entry must be there. Prints
a table; exit code 1 if something did not go as it should.
"""

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from shutil import copy, copytree, ignore_patterns

from tests.benches.locked import locked
from tests.benches.package_traces import package_traces
from tests.benches.service_under_systemd import TriedUnit

ROOT = Path(__file__).parents[2]
CONFIG, DATA = "etc/talc-gateway/gateway.toml", "var/lib/talc-gateway/gateway.sqlite"
RUN_BY = (
    "pytest",
    "pluggy",
    "iniconfig",
    "packaging",
    "pygments",
    "hypothesis",
    "sortedcontainers",
    "clarabel",
    "cffi",
    "pycparser",
)
"""What the tests need besides the package, in the versions of the lock."""
TESTS = (
    "talc/papers/test_search.py",
    "talc/papers/test_pso.py",
    "libraries/test_group_lasso.py",
    "talc/test_kinematics.py",
    "talc/papers/test_free_running.py",
)


class Arm64Debian:
    """A folder with Debian for arm64; each command gets /proc and /dev in its own namespace."""

    def __init__(self, root: Path) -> None:
        self.root = root
        done = subprocess.run(
            ["debootstrap", "--arch=arm64", "--variant=minbase", "--include=python3", "bookworm", str(root)],
            capture_output=True, text=True,
        )  # fmt: skip
        if done.returncode != 0:
            raise RuntimeError(f"debootstrap: {done.stdout[-4000:]}{done.stderr}")

    def run(self, command: str) -> subprocess.CompletedProcess[str]:
        """The result of a shell command, also when it fails."""
        mounts = f"mount -t proc proc {self.root}/proc && mount --rbind /dev {self.root}/dev"
        path = "env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin"
        inside = f"{mounts} && exec chroot {self.root} {path} sh -ec '{command}'"
        return subprocess.run(["unshare", "--mount", "sh", "-ec", inside], capture_output=True, text=True)


def tries(machine: Arm64Debian, package: Path) -> Iterator[TriedUnit]:
    """Everything in its order."""
    copy(package, machine.root / "package.deb")
    before, install = package_traces(machine.root), "dpkg --install /package.deb"

    def tried(what: str, command: str, wanted: str = "") -> TriedUnit:
        done = machine.run(command)
        last = (done.stdout.strip().splitlines() or ["nothing said"])[-1]
        good = done.returncode == 0 and wanted in done.stdout
        return TriedUnit(what, good, last if good else f"exit code {done.returncode}: {done.stdout}{done.stderr}")

    yield tried("the computer", "uname -m", "aarch64")
    yield tried("it installs", install)
    yield tried("the program starts", "talc-gateway --version", "version")
    yield tried("check accepts the example", f"talc-gateway check /{CONFIG}", "good")
    place_tests(machine.root / "tests")
    files = " ".join(f"tests/{name}" for name in TESTS)
    python = "PYTHONPATH=/tests/libraries:/tests /opt/talc-gateway/bin/python -m pytest"
    options = "-q --noconftest -c /dev/null --rootdir=/tests --import-mode=importlib -p no:cacheprovider"
    yield tried("the tests of the kernel", f"cd /tests && {python} {options} {files}", " passed")
    config, data = machine.root / CONFIG, machine.root / DATA
    config.write_text(config.read_text("utf-8").replace("[machine]", "# changed\n[machine]"), encoding="utf-8")
    data.write_text("what was learnt", encoding="utf-8")
    yield tried("it is installed again", install)
    kept = "# changed" in config.read_text("utf-8") and data.read_text("utf-8") == "what was learnt"
    yield TriedUnit("the configuration and the data after that", kept, "kept" if kept else "changed")
    yield tried("it is removed", "dpkg --remove talc-gateway")
    kept = config.exists() and data.exists() and not (machine.root / "opt/talc-gateway").exists()
    yield TriedUnit("the configuration and the data after that", kept, "kept" if kept else "gone")
    yield tried("it is purged", "dpkg --purge talc-gateway")
    left = package_traces(machine.root) - before
    yield TriedUnit("what is left of it", not left, ", ".join(sorted(left)) or "nothing")


def place_tests(folder: Path) -> None:
    """The tests of `talc`, what they share, and what runs them, for Debian 12's Python on arm64.

    Raises CalledProcessError: the packages could not be had.
    """
    for name in ("talc", "libraries", "benches"):
        copytree(ROOT / "tests" / name, folder / "tests" / name, ignore=ignore_patterns("__pycache__"))
    wanted = [one for one in locked(ROOT / "requirements/dev.lock", "3.11") if one.partition("==")[0] in RUN_BY]
    platforms = [f"--platform=manylinux_2_{glibc}_aarch64" for glibc in (17, 28, 34)]
    target = [f"--target={folder / 'libraries'}", "--only-binary=:all:", "--no-deps", "--quiet", *platforms]
    subprocess.run([sys.executable, "-m", "pip", "install", *target, *wanted], check=True)


def main() -> None:
    """Print the table."""
    with tempfile.TemporaryDirectory(dir="/var/tmp") as name:  # not on a /tmp without devices
        print("| test | result |\n|---|---|")
        good = True
        for row in tries(Arm64Debian(Path(name) / "root"), Path(sys.argv[1])):
            print(f"| {row.what} | {'' if row.good else 'WRONG: '}{row.seen} |", flush=True)
            good = good and row.good
    sys.exit(not good)


if __name__ == "__main__":
    main()
