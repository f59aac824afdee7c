"""A telemetry publisher in a separate process, which has published one event; and a client of it."""

import asyncio
import sys

import zenoh

from drivers.base import SystemClock
from gateway.config import Telemetry
from gateway.events import EventReported
from gateway.telemetry import TelemetryPublisher
from talc.frame import Event, EventKind


def client(port: int) -> zenoh.Session:
    """A session that finds only the publisher."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["tcp/127.0.0.1:{port}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config)


async def main(port: int) -> None:
    settings = Telemetry(listen=(f"tcp/127.0.0.1:{port}",))
    async with TelemetryPublisher(settings, "mill", (), SystemClock(), "boot", simulated=False) as publisher:
        publisher.publish(EventReported(Event(EventKind.PROBLEM, "the only one"), None))
        print("published", flush=True)
        await asyncio.to_thread(sys.stdin.readline)


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1])))
