"""The subscriber of docs/keys.md, as it stands there, prints the decisions of a gateway."""

import asyncio
import re
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from drivers.base import SystemClock
from gateway.config import Telemetry
from gateway.events import DecisionMade
from gateway.telemetry import TelemetryPublisher
from tests.benches.free_port import free_port
from tests.benches.telemetry_examples import DECISION

PAGE = (Path(__file__).parents[3] / "docs" / "keys.md").read_text(encoding="utf-8")
LIMIT_S = 120.0


@pytest.mark.slow
async def test_the_subscriber_of_the_page_prints_decisions() -> None:
    found = re.search(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert found is not None
    port = free_port()
    code = found[1].replace("7447", str(port))
    assert code != found[1]
    settings = Telemetry(listen=(f"tcp/127.0.0.1:{port}",), multicast=False)
    async with TelemetryPublisher(settings, "mill", (), SystemClock(), "boot", simulated=False) as publisher:
        process = await asyncio.create_subprocess_exec(sys.executable, "-uc", code, stdout=subprocess.PIPE)
        try:
            assert process.stdout is not None
            line = asyncio.create_task(process.stdout.readline())
            async with asyncio.timeout(LIMIT_S):
                while not line.done():  # it hears only what is published after it has subscribed
                    publisher.publish(DecisionMade(DECISION))
                    await asyncio.wait([line], timeout=0.2)
            assert f" {DECISION.phase.value} " in line.result().decode()
        finally:
            with suppress(ProcessLookupError):  # it has ended by itself
                process.kill()
            await process.wait()
