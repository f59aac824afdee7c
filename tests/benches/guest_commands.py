"""Shell commands in the guest, and where the service's files are."""

import subprocess
import time

CONFIG, DATA = "/etc/talc-gateway/gateway.toml", "/var/lib/talc-gateway"
PYTHON = "/opt/talc-gateway/bin/python"
LIMIT_S = 300.0
GuestRow = tuple[str, bool, str]
"""What was tried, whether it went as it should, what was seen."""


def run(command: str) -> str:
    """The output of a command; fails with all of it."""
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{command}: exit code {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout.strip()


def until(command: str) -> float:
    """Seconds until a command succeeds."""
    began = asked = time.monotonic()
    while (done := subprocess.run(["sh", "-c", command], capture_output=True, check=False)).returncode != 0:
        now = time.monotonic()
        if now - began > LIMIT_S:
            raise TimeoutError(f"{command}: {done.stdout!r} {done.stderr!r}")
        time.sleep(max(0.5, 3.0 * (now - asked)))  # leaves the guest's processor to what is waited for
        asked = time.monotonic()
    return time.monotonic() - began
