"""A gateway killed while it starts, rebuilds, learns, probes, writes or stops: no step on the control, nothing lost or
torn."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.benches.death import PHASES
from tests.benches.kills import WRITING

WHILE_WRITING, EACH = 6, 10
KILLS = {WRITING: WHILE_WRITING, **dict.fromkeys(PHASES, EACH)}


@pytest.mark.slow
def test_whatever_it_does_when_it_is_killed_the_next_one_goes_on() -> None:
    command = [sys.executable, "-m", "tests.benches.kills", "--writing", str(WHILE_WRITING), "--phase", str(EACH)]
    done = subprocess.run(
        command,
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr[-4000:]
    rows = [line.strip("| ").split(" | ") for line in done.stdout.splitlines() if line.startswith("| ")]
    assert {name: int(killed) for name, killed, _ in rows[1:]} == KILLS
