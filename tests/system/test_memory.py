"""The memory of `run` does not grow with the snapshots that it takes each day, and taking one needs little memory."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.benches.service_file import UNPUBLISHED, m7015, rtu_bus

DEVICES, EACH = 5, 6
DAYS = 5
GROWTH_MB = 8.0
"""It is 2.7 MB; 10 MB with the copy of a snapshot that SQLite kept; without what `run` sets it was 51 MB."""
MEANWHILE_MB = 18.0
"""It is 10.3 MB, of which the copy of the controller's state is 9.3; 37 MB when SQLite got it as one value."""


@pytest.mark.slow
def test_snapshots_leave_no_holes_behind(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    named = [", ".join(f"t{EACH * device + i} = {i}" for i in range(EACH)) for device in range(DEVICES)]
    devices = (m7015(f"rtd{unit}", unit, channels) for unit, channels in enumerate(named, start=1))
    file.write_text(UNPUBLISHED + rtu_bus() + "".join(devices), encoding="utf-8")
    ran = subprocess.run(
        [sys.executable, "-m", "tests.benches.snapshot_memory", str(file), str(DAYS)],
        cwd=Path(__file__).parents[2],
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    (before_mb, _), *taken = ([float(word) for word in line.split()] for line in ran.stdout.splitlines())
    after_mb = [now for now, _ in taken]
    print(before_mb, taken)
    assert len(after_mb) == DAYS
    assert max(after_mb) < before_mb + GROWTH_MB
    assert after_mb[-1] < after_mb[0] + 2.0
    assert max(most - now for now, most in taken) < MEANWHILE_MB
