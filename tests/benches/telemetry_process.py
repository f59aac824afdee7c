"""A telemetry publisher in a separate process, which has published one event."""

import asyncio
import sys

from drivers.base import SystemClock
from gateway.config.telemetry import Telemetry
from gateway.model.events import EventReported
from talc.frame import Event, EventKind
from tests.benches.open_publisher import OpenPublisher


async def main(port: int) -> None:
    settings = Telemetry(listen=(f"tcp/127.0.0.1:{port}",))
    async with OpenPublisher(settings, "mill", (), SystemClock(), "boot", simulated=False) as publisher:
        publisher.publish(EventReported(Event(EventKind.PROBLEM, "the only one"), None))
        print("published", flush=True)
        await asyncio.to_thread(sys.stdin.readline)


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1])))
