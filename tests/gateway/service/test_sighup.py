"""`talc-gateway run` reads its configuration again on SIGHUP."""

import os
import selectors
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from gateway.config.file import load
from gateway.storage.history import History
from tests.benches.database import applied
from tests.benches.service_file import UNPUBLISHED, m7015, rtu_bus

TEXT = UNPUBLISHED + rtu_bus() + m7015()
LONGEST_S = 120.0


def wait_for(process: subprocess.Popen[bytes], text: str, seen: bytearray) -> None:
    """Read standard error until `text` appears after what was seen before."""
    assert process.stderr is not None
    start, deadline = len(seen), time.monotonic() + LONGEST_S
    with selectors.DefaultSelector() as selector:
        selector.register(process.stderr, selectors.EVENT_READ)
        while text.encode() not in seen[start:]:
            assert selector.select(max(0.0, deadline - time.monotonic())), f"no {text!r} in {seen.decode()}"
            more = os.read(process.stderr.fileno(), 65536)
            assert more, f"ended without {text!r}: {seen.decode()}"
            seen += more


@pytest.mark.slow
def test_a_good_file_is_applied_and_a_bad_one_changes_nothing(tmp_path: Path) -> None:
    file, seen = tmp_path / "gateway.toml", bytearray()
    file.write_text(TEXT)
    command = [sys.executable, "-c", "from gateway.cli.main import main; main()", "run", str(file)]
    with subprocess.Popen(command, stderr=subprocess.PIPE) as process:
        try:
            wait_for(process, "/nowhere/adapter", seen)
            first = load(file).fingerprint()
            file.write_text(TEXT.replace("adapter", "other"))
            second = load(file).fingerprint()
            process.send_signal(signal.SIGHUP)
            wait_for(process, "buses exchanged: rtu1", seen)
            file.write_text(TEXT.replace("unit = 1", "units = 1"))
            process.send_signal(signal.SIGHUP)
            wait_for(process, "unknown key; did you mean 'unit'?", seen)
            file.write_text(TEXT.replace("bed_front", "bed_rear"))
            process.send_signal(signal.SIGHUP)
            wait_for(process, "inputs changed (gone: bed_front; new: bed_rear)", seen)
            process.send_signal(signal.SIGTERM)
            assert process.wait(LONGEST_S) == 0
        finally:
            process.kill()
    assert "/nowhere/other" in seen.decode()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["gateway.sqlite", "gateway.toml"], "closed, and no lock left"
    database = tmp_path / "gateway.sqlite"
    assert [fingerprint for _, fingerprint in applied(database)] == [first, second], "only what took effect"
    with History(database) as history:
        stored = history.config()
    assert stored is not None
    assert stored[1] == second
    assert '"/nowhere/other"' in stored[0]
