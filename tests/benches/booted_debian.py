"""A Debian booted with its own systemd in a container without a network: systemd-nspawn, Debian's systemd-container.

Its kernel is this computer's, so it needs root. What the guest's systemd sets (filters of system calls, devices and
addresses, limits, the watchdog) is set in this kernel for real.
"""

import os
import signal
import subprocess
import time
from pathlib import Path

from tests.benches.processes import read_if_there

MIRROR = "http://deb.debian.org/debian"
LIMIT_S = 900.0
"""Generous: no single command of a test takes longer on an idle computer than a tenth of it."""


def minimal_debian(root: Path, *packages: str) -> Path:
    """Make a minimal Debian of this computer's release with Python, systemd, chrony, modprobe, udev, ip and these
    packages in a folder.

    Its dpkg does not wait for the disk after each file, now and later: nobody cuts the power of a test. mmdebstrap
    needs half of debootstrap's processor time.
    """
    lines = Path("/etc/os-release").read_text(encoding="utf-8").splitlines()
    release = dict(line.split("=", 1) for line in lines if "=" in line)
    suite = release["VERSION_CODENAME"].strip('"')
    more = ",".join(("python3", "systemd-sysv", "dbus", "chrony", "kmod", "udev", "iproute2", *packages))
    command = [
        "mmdebstrap", "--variant=minbase", f"--include={more}", "--dpkgopt=force-unsafe-io",
        "--hook-dir=/usr/share/mmdebstrap/hooks/maybe-merged-usr",  # else by usrmerge, which brings Perl
        "--skip=cleanup/reproducible",  # a computer has its machine-id
        suite, str(root), MIRROR,
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}\n{done.stdout[-4000:]}{done.stderr[-4000:]}")
    return root


class BootedDebian:
    """A guest that runs from entering to leaving the context.

    Parameters
    ----------
    root: a folder with a Debian that has systemd and dbus
    log: the guest's console goes there
    """

    def __init__(self, root: Path, log: Path) -> None:
        self._root, self._log = root, log
        self._container: subprocess.Popen[bytes] | None = None
        self._leader = 0

    def __enter__(self) -> "BootedDebian":
        command = [
            "systemd-nspawn", "--quiet", "--boot", "--register=no", "--keep-unit", "--private-network",
            "--console=pipe", "--link-journal=no", "--resolv-conf=off", "--timezone=off",
            # The guest's systemd puts the filters of addresses and devices into this kernel with bpf. Its clock can be
            # read, but without CAP_SYS_TIME not be set.
            "--capability=CAP_BPF,CAP_NET_ADMIN", "--system-call-filter=bpf adjtimex clock_adjtime",
            f"--directory={self._root}",
        ]  # fmt: skip
        environment = {**os.environ, "SYSTEMD_NSPAWN_UNIFIED_HIERARCHY": "1"}
        with self._log.open("wb") as log:
            self._container = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=environment, start_new_session=True
            )
        try:
            self._leader = self._wait_for_leader()
            self.wait_until("systemctl is-system-running | grep -E 'running|degraded'")
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    @property
    def leader(self) -> int:
        """The guest's process 1, seen from here."""
        return self._leader

    def run(self, command: str) -> str:
        """Output of a shell command in the guest; fails with all of it."""
        done = self.tried(command)
        if done.returncode != 0:
            raise RuntimeError(f"{command}: exit code {done.returncode}\n{done.stdout}{done.stderr}")
        return done.stdout

    def tried(self, command: str) -> subprocess.CompletedProcess[str]:
        """The result of a shell command in the guest, also when it fails."""
        inside = ["nsenter", f"--target={self._leader}", "--all", "env", "-i", "-C", "/"]
        path = "PATH=/usr/sbin:/usr/bin:/sbin:/bin"
        return subprocess.run(
            [*inside, path, "sh", "-c", command], capture_output=True, text=True, timeout=LIMIT_S, check=False
        )

    def wait_until(self, command: str) -> float:
        """Wait until a shell command in the guest succeeds; seconds that it took."""
        began = asked = time.monotonic()
        while (done := self.tried(command)).returncode != 0:
            now = time.monotonic()
            if now - began > LIMIT_S:
                raise TimeoutError(f"{command}: {done.stdout}{done.stderr}\n{self._log.read_text(errors='replace')}")
            time.sleep(max(0.5, 3.0 * (now - asked)))  # what starts Python takes a second of a core to ask
            asked = time.monotonic()
        return time.monotonic() - began

    def _wait_for_leader(self) -> int:
        """The guest's process 1, seen from here."""
        if self._container is None:
            raise RuntimeError("the container was not started")
        children = Path(f"/proc/{self._container.pid}/task/{self._container.pid}/children")
        began = time.monotonic()
        while time.monotonic() - began < LIMIT_S and self._container.poll() is None:
            for child in read_if_there(children).decode().split():
                if read_if_there(Path(f"/proc/{child}/comm")).strip() == b"systemd":
                    return int(child)
            time.sleep(0.1)
        raise RuntimeError(f"no systemd in {self._root}:\n{self._log.read_text(errors='replace')}")

    def _end(self) -> None:
        if self._container is None:
            return
        if self._leader:
            os.kill(self._leader, signal.SIGRTMIN + 4)  # systemd: power off
        try:
            self._container.wait(30.0)
        except subprocess.TimeoutExpired:
            self._container.kill()
            self._container.wait()
