"""`python -m tests.benches.whole_site 200`: gateways, a router and a collector into PostgreSQL, killed meanwhile.

Each gateway has the program's own store and publisher, and reads 40 keys each four seconds, with a step and an event at
each tenth read; fifty share a process. Router, collector, fifty gateways and the database are killed once and started
again. Then each row of each store is looked up in the database. Prints rows, processor time and memory; exit code 1 if
a row is missing or there twice. A second number: for how many seconds besides the kills. Needs Debian's postgresql.
"""

import asyncio
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import AsyncExitStack, ExitStack, suppress
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

import msgspec
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
from gateway.telemetry.stored_queries import StoredRequest
from talc.frame import Event, EventKind, Frame
from tests.benches import telemetry_examples as example
from tests.benches.free_port import free_port
from tests.benches.postgres import Postgres, postgres
from tests.benches.waits import wait_until
from tests.benches.zenoh_sessions import client, router

SECONDS = "90"
KEYS, EVERY_S = 40, 4.0
"""Of a gateway. On two processors the gateways themselves need most of the time."""
TABLES = ("steps", "events", "readings")
_PER_PROCESS = 50
_STEP_EVERY = 10
"""Reads of a gateway between two steps."""
_AWAY_S, _CATCHES_UP_S = 20.0, 300.0
_TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")


class Part:
    """A process that is killed and started again, and what all its lives have used."""

    def __init__(self, *words: str) -> None:
        self._words = words
        self._process: subprocess.Popen[str] | None = None
        self._began_s = self.used_s = self.lived_s = self.peak_mb = 0.0

    def start(self) -> None:
        """Begin, without waiting until it says that it is ready."""
        command = [sys.executable, "-u", "-m", *self._words]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._began_s = time.monotonic()

    def line(self) -> str:
        """The next that it says."""
        assert self._process is not None
        assert self._process.stdout is not None
        said = self._process.stdout.readline()
        assert said, f"{self._words} has ended"
        return said

    def close(self) -> None:
        """End its input."""
        assert self._process is not None
        assert self._process.stdin is not None
        self._process.stdin.close()

    def kill(self) -> None:
        """Add what it has used, and kill it."""
        assert self._process is not None
        folder = Path("/proc", str(self._process.pid))
        stat = (folder / "stat").read_text(encoding="ascii").rpartition(")")[2].split()
        status = (folder / "status").read_text(encoding="ascii").splitlines()
        (peak_kb,) = (int(line.split()[1]) for line in status if line.startswith("VmHWM"))
        self.used_s += (int(stat[11]) + int(stat[12])) * _TICK_S
        self.peak_mb = max(self.peak_mb, peak_kb / 1000)
        self.lived_s += time.monotonic() - self._began_s
        self.end()

    def end(self) -> None:
        """Kill it, if it runs."""
        if self._process is not None:
            with self._process as process:
                process.kill()
            self._process = None


class FedGateway:
    """A store and a publisher that are fed as by a service."""

    def __init__(self, store: Store, publisher: TelemetryPublisher, first_k: int) -> None:
        self._store, self._publisher, self._clock = store, publisher, SystemClock()
        self._reads, self._k = 0, first_k
        self.flush = store.flush

    def read(self) -> None:
        """All keys once, and sometimes a step with an event."""
        self._reads += 1
        now, now_s, n = self._clock.utc(), self._clock.monotonic(), self._reads
        values = ((f"c{at}", n + at / 64) for at in range(KEYS))
        self._tell(ReadingsTaken([Sample(c, x, "degC", Quality.GOOD, now, now_s, sequence=n) for c, x in values]))
        if n % _STEP_EVERY == 0:
            self._k += 1
            self._tell(FrameMade(Frame(self._k, np.array([20.5, np.nan]), np.array([True, False]))))
            self._tell(DecisionMade(replace(example.DECISION, k=self._k)))
            self._tell(EventReported(Event(EventKind.PROBLEM, f"step {self._k}"), self._k))

    def _tell(self, event: GatewayEvent) -> None:
        self._store.record(event)
        self._publisher.publish(event)


async def feed(port: int, folder: Path, first: int, count: int) -> None:
    """Gateways until standard input ends; then they say how late the latest reading was, and go on answering."""
    settings = Telemetry(mode="client", listen=(), connect=(f"tcp/127.0.0.1:{port}",))
    loop, stop = asyncio.get_running_loop(), asyncio.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), loop.call_soon_threadsafe(stop.set)), daemon=True).start()
    async with AsyncExitStack() as stack:
        gateways = []
        for name in map(machine, range(first, first + count)):
            path, boot = folder / f"{name}.sqlite", boot_id()
            store = stack.enter_context(Store(path, boot, RealClock()))
            publisher = TelemetryPublisher(
                settings, name, ("bed", "column"), SystemClock(), boot, simulated=False, stored=rows_of(path)
            )
            await stack.enter_async_context(publisher)
            gateways.append(FedGateway(store, publisher, int(loop.time() / EVERY_S / _STEP_EVERY)))
        print("ready")
        due_s, late_s = loop.time(), 0.0
        while not stop.is_set():
            for gateway in gateways:
                due_s += EVERY_S / count
                await asyncio.sleep(due_s - loop.time())
                late_s = max(late_s, loop.time() - due_s)
                gateway.read()
        for gateway in gateways:
            await asyncio.to_thread(gateway.flush)
        print(late_s)
        await loop.create_future()


def route(port: int) -> None:
    """A router until standard input ends."""
    with router(port):
        print("ready")
        sys.stdin.read()


def machine(number: int) -> str:
    """The name of a gateway's machine."""
    return f"m{number:03d}"


class _Timed(msgspec.Struct):
    time: datetime


@dataclass(slots=True)
class Delays:
    """Of live messages of one key of each gateway, s, while nothing is killed."""

    found: list[float]
    listening: bool = True

    def take(self, sample: zenoh.Sample) -> None:
        """Called by Zenoh."""
        if self.listening:
            sent = msgspec.json.decode(sample.payload.to_bytes(), type=_Timed).time
            self.found.append(time.time() - sent.timestamp())


def stored_by(path: Path) -> dict[str, set[tuple[str, int]]]:
    """Epoch and number of each row of a gateway's store, by table."""
    ask = rows_of(path)

    def rows(table: str) -> Iterator[tuple[str, int]]:
        place, more = None, True
        while more:
            page = ask(StoredRequest({table: place}, 50_000)).tables[table]
            assert page.epoch is not None
            yield from ((page.epoch, number) for number in page.numbers)
            place, more = (page.epoch, page.last), page.more

    return {table: set(rows(table)) for table in TABLES}


def kept_of(server: Postgres, table: str, name: str) -> set[tuple[str, int]]:
    """Likewise what the database has of a machine."""
    found = server.query("site", f"SELECT epoch, row FROM talc.{table} WHERE machine = '{name}'")
    return {(str(one["epoch"]), int(one["row"])) for one in found}


def counted(server: Postgres) -> int:
    """Rows in the database."""
    what = " + ".join(f"(SELECT count(*) FROM talc.{table})" for table in TABLES)
    return int(server.query("site", f"SELECT {what} AS rows")[0]["rows"])


def doubled(server: Postgres) -> int:
    """Readings whose channel and time another row of the machine has."""
    twice = "SELECT count(*) - count(DISTINCT (machine, channel, time)) AS rows FROM talc.readings"
    return int(server.query("site", twice)[0]["rows"])


def run_site(server: Postgres, folder: Path, gateways: int, seconds: float) -> bool:
    """Run it, and print what was found; whether every row is there once."""
    own, port = "tests.benches.whole_site", free_port()
    at_router = Part(own, "route", str(port))
    collector = Part("gateway", "collect", server.created("site"), "--connect", f"tcp/127.0.0.1:{port}")
    shares = [(first, min(_PER_PROCESS, gateways - first)) for first in range(0, gateways, _PER_PROCESS)]
    feeds = [Part(own, "feed", str(port), str(folder), str(first), str(count)) for first, count in shares]
    delays = Delays([])
    with ExitStack() as stack:
        for part in (at_router, *feeds, collector):
            stack.callback(part.end)
            part.start()
            part.line()
        session = stack.enter_context(client(port))
        session.declare_subscriber("talc/*/reading/c0", delays.take)
        time.sleep(seconds * 2 / 3)
        delays.listening = False
        for part in (at_router, collector, feeds[0]):
            part.kill()
            time.sleep(_AWAY_S)
            part.start()
            part.line()
            time.sleep(_AWAY_S)
        server.stop()
        time.sleep(_AWAY_S)
        server.start()
        time.sleep(seconds / 3)
        for part in feeds:
            part.close()
        late_s = max(float(part.line()) for part in feeds)
        ended_s = time.monotonic()
        stored = {name: stored_by(folder / f"{name}.sqlite") for name in map(machine, range(gateways))}
        total = sum(len(rows) for tables in stored.values() for rows in tables.values())
        with suppress(AssertionError):  # what is still missing then is lost
            wait_until(lambda: counted(server) >= total, _CATCHES_UP_S, 1.0)
        caught_up_s = time.monotonic() - ended_s
        for part in (at_router, collector):
            part.kill()
    lost = sum(
        len(rows - kept_of(server, table, name)) for name, tables in stored.items() for table, rows in tables.items()
    )
    twice = doubled(server) + counted(server) - (total - lost)
    print(f"rows stored: {total}; lost: {lost}; twice: {twice}")
    for name, part in (("collector", collector), ("router", at_router)):
        each = 1e6 * part.used_s / total
        print(f"{name}: {part.used_s / part.lived_s:.0%} of a core, {each:.0f} us a row, {part.peak_mb:.0f} MB")
    median, most = 1e3 * np.percentile(delays.found, (50, 99))
    print(f"live messages: {median:.0f} ms (median), {most:.0f} ms (99th percentile)")
    print(f"after the end until the last row was kept: {caught_up_s:.0f} s; readings came up to {late_s:.1f} s late")
    return lost == twice == 0


def main() -> None:
    """Run it, or one of its parts."""
    match sys.argv[1:]:
        case ["route", port]:
            route(int(port))
        case ["feed", port, folder, first, count]:
            asyncio.run(feed(int(port), Path(folder), int(first), int(count)))
        case [gateways, *seconds]:
            with tempfile.TemporaryDirectory() as name, postgres() as server:
                sys.exit(not run_site(server, Path(name), int(gateways), float([*seconds, SECONDS][0])))
        case _:
            sys.exit(__doc__)


if __name__ == "__main__":
    main()
