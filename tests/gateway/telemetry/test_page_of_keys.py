"""The examples of docs/keys.md, as they stand there: one prints the decisions of a gateway, one reads blocks."""

import asyncio
import math
import re
import subprocess
import sys
from contextlib import suppress
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
import zenoh

from drivers.base import Quality, SystemClock
from gateway.config.telemetry import Telemetry
from gateway.model.events import DecisionMade, ReadingsTaken
from gateway.runtime.clocks import RealClock
from gateway.service.stored_answers import history_of
from gateway.storage.store import Store
from gateway.telemetry.codec import encode
from gateway.telemetry.history_queries import HistoryRequest
from tests.benches.free_port import free_port
from tests.benches.open_publisher import OpenPublisher
from tests.benches.telemetry_examples import DECISION
from tests.benches.telemetry_peer import reading
from tests.benches.waits import until

PAGE = (Path(__file__).parents[3] / "docs" / "keys.md").read_text(encoding="utf-8")
LIMIT_S = 120.0


@pytest.mark.slow
async def test_the_subscriber_of_the_page_prints_decisions(monkeypatch: pytest.MonkeyPatch) -> None:
    sessions, open_session = list[zenoh.Session](), zenoh.open

    def keep(*given: Any, **named: Any) -> zenoh.Session:
        sessions.append(open_session(*given, **named))
        return sessions[-1]

    monkeypatch.setattr(zenoh, "open", keep)
    found = re.search(r"```python\n(import json, zenoh\n.*?)```", PAGE, re.DOTALL)
    assert found is not None
    port = free_port()
    code = found[1].replace("7447", str(port))
    assert code != found[1]
    settings = Telemetry(listen=(f"tcp/127.0.0.1:{port}",), multicast=False)
    async with OpenPublisher(settings, "mill", (), SystemClock(), "boot", simulated=False) as publisher:
        process = await asyncio.create_subprocess_exec(sys.executable, "-uc", code, stdout=subprocess.PIPE)
        try:
            assert process.stdout is not None
            decisions: Any = sessions[0].declare_publisher("talc/mill/decision")
            # it hears only what is published after it has subscribed
            await until(lambda: decisions.matching_status.matching, LIMIT_S)
            publisher.publish(DecisionMade(DECISION))
            async with asyncio.timeout(LIMIT_S):
                assert f" {DECISION.phase.value} " in (await process.stdout.readline()).decode()
        finally:
            with suppress(ProcessLookupError):  # it has ended by itself
                process.kill()
            await process.communicate()  # closes its pipes


def test_the_reader_of_blocks_of_the_page_finds_the_readings_of_rows(tmp_path: Path) -> None:
    path, taken = tmp_path / "g.sqlite", [replace(reading(20.0 + n), sequence=n + 1) for n in range(5)]
    taken.append(replace(reading(math.nan, Quality.SENSOR_FAULT), sequence=7))
    with Store(path, "boot", RealClock()) as store:
        store.record(ReadingsTaken(taken))
    code, space = PAGE.rpartition("```python\n")[2].partition("```")[0], dict[str, Any]()
    exec(code, space)
    span = taken[0].source_time - timedelta(days=1), taken[0].source_time + timedelta(days=1)
    page = history_of(path)(HistoryRequest(*span, None, 100, None, None, blocks=True))
    rows = history_of(path)(HistoryRequest(*span, None, 100, None))
    found = [
        (t, name, None if math.isnan(v) else v, quality) for t, name, v, quality in space["readings"](encode(page))
    ]
    names = [rows.names[channel] for channel in rows.channel]
    assert found == list(zip(rows.time, names, rows.value, rows.quality, strict=True))
    assert len(found) == 6
