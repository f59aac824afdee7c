"""`run` is stopped while the disk of its database hangs."""

import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.benches.database import applied
from tests.benches.failing_disk import on_failing_disk
from tests.benches.service_file import UNPUBLISHED, m7015, rtu_bus
from tests.benches.waits import wait_until

LIMIT_S = 120.0
"""Real seconds; the gateway itself waits 5 s for the disk."""


def wait_until_ready(manager: socket.socket) -> None:
    while not manager.recv(4096).startswith(b"READY=1"):
        pass


@pytest.mark.slow
def test_it_ends_by_itself_and_names_what_may_be_lost(tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    file, hanging, log = disk / "gateway.toml", tmp_path / "hanging", tmp_path / "log"
    file.write_text(UNPUBLISHED + rtu_bus() + m7015(), encoding="utf-8")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager, log.open("w") as errors:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(LIMIT_S)
        environment = on_failing_disk(disk, hanging) | {"NOTIFY_SOCKET": str(tmp_path / "notify")}
        process = subprocess.Popen([sys.executable, "-m", "gateway", "run", str(file)], stderr=errors, env=environment)
        try:
            wait_until_ready(manager)
            # the gateway is ready before its first commit
            wait_until(lambda: process.poll() is not None or applied(disk / "gateway.sqlite"), LIMIT_S)
            assert process.poll() is None
            hanging.touch()
            process.send_signal(signal.SIGHUP)
            wait_until_ready(manager)  # what runs from now on is to be stored
            process.send_signal(signal.SIGTERM)
            began_s = time.monotonic()
            assert process.wait(LIMIT_S) == 3
            took_s = time.monotonic() - began_s
        finally:
            hanging.unlink()
            process.kill()
            process.wait()
    said = log.read_text(encoding="utf-8")
    print(f"stopped after {took_s:.2f} s: {said.splitlines()[-1]}")
    assert f"error: {disk}/gateway.sqlite: the disk does not answer" in said
    assert "rows may be lost (" in said
    assert "running 1" in said
