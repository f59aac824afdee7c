"""The command `publish`: from a gateway's Zenoh to Mosquitto, through the death of the gateway, until SIGTERM."""

import asyncio
import json
import signal
import sys
from asyncio.subprocess import PIPE, Process
from pathlib import Path

import pytest

from tests.benches.free_port import free_port
from tests.benches.mosquitto import LIMIT_S, Subscriber, mosquitto

pytestmark = pytest.mark.peer


async def line_with(process: Process, word: str) -> str:
    assert process.stdout is not None
    async with asyncio.timeout(LIMIT_S):
        while word not in (line := (await process.stdout.readline()).decode()):
            assert line, f"ended without {word!r}"
    return line


async def program(*arguments: str | Path | int) -> Process:
    return await asyncio.create_subprocess_exec(sys.executable, "-m", *map(str, arguments), stdin=PIPE, stdout=PIPE)


async def test_what_a_gateway_publishes_reaches_the_broker_and_its_death_too(tmp_path: Path) -> None:
    port = free_port()
    with mosquitto(tmp_path) as broker, Subscriber(broker, "talc/#") as live:
        file = tmp_path / "outlets.toml"
        file.write_text(
            f'[source]\nconnect = ["tcp/127.0.0.1:{port}"]\n'
            f'[[outlet]]\nname = "plant"\nkind = "mqtt"\nurl = "{broker.url}"\n'
        )
        played = await program("tests.benches.played_telemetry", port, "mill", "all")
        await line_with(played, "listening")
        publishing = await program("gateway", "publish", file)
        await line_with(publishing, "forwarding")
        await asyncio.to_thread(live.until, "talc/mill/alive", "online")
        assert played.stdin is not None
        played.stdin.write(b"\n")
        await line_with(played, "published")
        played.stdin.write(b'event {"text": "the last one"}\n')
        heard: dict[str, str] = {}
        while json.loads(heard.get("talc/mill/event", '{"text": ""}'))["text"] != "the last one":
            topic, payload, _ = await asyncio.to_thread(live.next)
            heard[topic] = payload
        assert {topic.split("/")[2] for topic in heard} >= {"reading", "decision", "status", "reasons", "forecast"}
        played.kill()
        await asyncio.to_thread(live.until, "talc/mill/alive", "offline")
        publishing.send_signal(signal.SIGTERM)
        account = await line_with(publishing, "plant: ")
        await asyncio.to_thread(live.until, "talc/_outlet/plant", "offline")
        assert await publishing.wait() == 0
        await played.wait()
    assert "0 dropped because too many waited, 0 not accepted, 0 waiting" in account
