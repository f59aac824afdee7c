"""The parts of a site that run in separate processes: a router, and many gateways that store and publish.

`python -m tests.benches.site_parts router PORT`
`python -m tests.benches.site_parts gateways PORT FOLDER FIRST COUNT KEYS EVERY_S`: until its standard input ends.
"""

import asyncio
import json
import sys
import threading
from contextlib import AsyncExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import zenoh

from drivers.base import Quality, SystemClock
from gateway.config.telemetry import Telemetry
from gateway.model.events import DecisionMade, EventReported, FrameMade, GatewayEvent, ReadingsTaken
from gateway.model.sample import Sample
from gateway.runtime.clocks import RealClock
from gateway.service.stored_answers import rows_of
from gateway.storage.store import Store, boot_id
from gateway.telemetry.publisher import TelemetryPublisher
from talc.frame import Event, EventKind, Frame
from tests.benches import telemetry_examples as example

_SWITCH_S = 0.0002
"""How long a thread keeps the interpreter when others want it. With Python's 5 ms a gateway that answers a query holds
up the messages of the fifty in its process, each at every message; real gateways do not share a process."""
_STEP_EVERY = 10
"""Reads of a gateway between two steps."""


def machine(number: int) -> str:
    return f"m{number:03d}"


def _router(port: int) -> None:
    config = zenoh.Config()
    for key, value in (
        ("mode", "router"),
        ("listen/endpoints", [f"tcp/127.0.0.1:{port}"]),
        ("scouting/multicast/enabled", False),
        ("scouting/gossip/enabled", False),
    ):
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config):
        print("ready", flush=True)
        sys.stdin.readline()


class _SiteGateway:
    """Feeds a store and a publisher as a service does."""

    def __init__(self, store: Store, publisher: TelemetryPublisher, keys: int, first_k: int) -> None:
        self._store, self._publisher, self._clock = store, publisher, SystemClock()
        self._names = [f"c{number}" for number in range(keys)]
        self._reads, self._k = 0, first_k
        self.flush = store.flush

    def read(self) -> None:
        """All keys once, and sometimes a step with an event."""
        self._reads += 1
        now, now_s = self._clock.utc(), self._clock.monotonic()
        self._tell(
            ReadingsTaken(
                [
                    Sample(name, self._reads + at / 64, "degC", Quality.GOOD, now, now_s, sequence=self._reads)
                    for at, name in enumerate(self._names)
                ]
            )
        )
        if self._reads % _STEP_EVERY == 0:
            self._k += 1
            self._tell(FrameMade(Frame(self._k, np.array([20.5, np.nan]), np.array([True, False]))))
            self._tell(DecisionMade(replace(example.DECISION, k=self._k)))
            self._tell(EventReported(Event(EventKind.PROBLEM, f"step {self._k}"), self._k))

    def _tell(self, event: GatewayEvent) -> None:
        self._store.record(event)
        self._publisher.publish(event)


async def _gateways(port: int, folder: Path, first: int, count: int, keys: int, every_s: float) -> None:
    sys.setswitchinterval(_SWITCH_S)
    settings = Telemetry(mode="client", listen=(), connect=(f"tcp/127.0.0.1:{port}",))
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    threading.Thread(target=lambda: (sys.stdin.read(), loop.call_soon_threadsafe(stop.set)), daemon=True).start()
    async with AsyncExitStack() as stack:
        running = []
        for number in range(first, first + count):
            path, boot = folder / f"{machine(number)}.sqlite", boot_id()
            store = stack.enter_context(Store(path, boot, RealClock()))
            publisher = await stack.enter_async_context(
                TelemetryPublisher(
                    settings,
                    machine(number),
                    ("bed", "column"),
                    SystemClock(),
                    boot,
                    simulated=False,
                    stored=rows_of(path),
                )
            )
            running.append(_SiteGateway(store, publisher, keys, int(loop.time() / (every_s * _STEP_EVERY))))
        print("ready", flush=True)
        began_s, late_s, turn = loop.time(), 0.0, 0
        while not stop.is_set():
            for at, gateway in enumerate(running):
                due_s = began_s + every_s * (turn + at / count)
                if loop.time() < due_s:
                    await asyncio.sleep(due_s - loop.time())
                late_s = max(late_s, loop.time() - due_s)
                gateway.read()
                await asyncio.sleep(0)
            turn += 1
        for gateway in running:
            await asyncio.to_thread(gateway.flush)
        print(json.dumps({"late_s": late_s, "reads": turn}), flush=True)
        await asyncio.to_thread(_until_told, folder)


def _until_told(folder: Path) -> None:
    """Keep answering until everything was asked for."""
    while not (folder / "end").exists():
        threading.Event().wait(0.2)


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["router", port]:
            _router(int(port))
        case ["gateways", port, folder, first, count, keys, every_s]:
            asyncio.run(_gateways(int(port), Path(folder), int(first), int(count), int(keys), float(every_s)))
        case _:
            sys.exit(__doc__)
