"""LinuxCNC ends with the program that started it, however that program ended."""

import os
import select
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

pytestmark = pytest.mark.peer

LIMIT_S = 60.0
"""For LinuxCNC's own end, in real time."""
_STARTER = """
import asyncio, sys
from pathlib import Path
from simulators.linuxcnc import machine

async def main():
    async with machine.machine(Path(sys.argv[1]), sphere=True) as operator:
        await operator.ask("switch_on")
        await operator.ask("home")
        print(operator.process.pid, flush=True)
        await operator.ask("mdi", "G4 P2")

asyncio.run(main())
"""


def test_it_does_not_outlive_a_starter_that_is_killed_before_it_has_its_answer(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", _STARTER, str(tmp_path)], stdout=subprocess.PIPE, text=True
    ) as starter:
        assert starter.stdout is not None
        left = int(starter.stdout.readline())
        watch = os.pidfd_open(left)
        starter.kill()
    try:
        ended, _, _ = select.select([watch], [], [], LIMIT_S)
        assert ended, "LinuxCNC still runs"
    finally:
        with suppress(ProcessLookupError):
            signal.pidfd_send_signal(watch, signal.SIGKILL)
        os.close(watch)
