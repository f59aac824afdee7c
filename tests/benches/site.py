"""Many gateways, a router and a collector, killed meanwhile: is every row kept once, and what does that cost?

`python -m tests.benches.site --gateways 200 --keys 40 --seconds 120` prints a row for the table in docs/collect.md.
Each gateway stores and publishes all keys once a second, and a step with an event each ten seconds, with the program's
own store, publisher and queries; they share processes, which the figures leave out. One process of gateways, the router
and the collector are each killed once and started again.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

import msgspec
import numpy as np
import zenoh
from pyarrow import parquet

from gateway.config.telemetry import Telemetry
from gateway.listeners.collect.progress import load_progress
from gateway.service.stored_answers import rows_of
from gateway.telemetry.session import page_config
from gateway.telemetry.stored_queries import StoredRequest
from tests.benches.free_port import free_port
from tests.benches.site_parts import machine

TABLES = ("steps", "events", "readings")
_PER_PROCESS = 50
_LIMIT_S, _CATCHES_UP_S = 300.0, 60.0
_TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True, slots=True)
class SiteRun:
    """The results."""

    stored: int
    """Rows in all gateways' stores."""
    lost: int
    doubled_or_moved: int
    live_p50_s: float
    """From publication to a subscriber of one key of each gateway, while nothing is killed."""
    live_p99_s: float
    collector_share: float
    """The share of one core."""
    router_share: float
    collector_mb: float
    """The most at any time."""
    router_mb: float
    """Likewise."""
    caught_up_s: float
    """From the end until the last row was kept."""
    late_s: float
    """The longest delay in feeding a gateway: the computer was too slow for its gateways."""


@dataclass(slots=True)
class _Part:
    """A process that may be killed and started again, and the resources that it has used in all its lives."""

    words: Sequence[str]
    process: "subprocess.Popen[str] | None" = None
    used_s: float = 0.0
    peak_mb: float = 0.0
    lived_s: float = 0.0
    began_s: float = 0.0

    def start(self) -> None:
        self.process = subprocess.Popen(
            [sys.executable, *self.words], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.began_s = time.monotonic()
        self.line()

    def line(self) -> str:
        assert self.process is not None
        assert self.process.stdout is not None
        found = self.process.stdout.readline()
        assert found, f"{self.words} has ended"
        return found

    def stop(self) -> None:
        """Add what it has used, and kill it."""
        assert self.process is not None
        stat = Path(f"/proc/{self.process.pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        self.used_s += (int(stat[11]) + int(stat[12])) * _TICK_S
        status = Path(f"/proc/{self.process.pid}/status").read_text(encoding="ascii")
        (peak_kb,) = (int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM"))
        self.peak_mb = max(self.peak_mb, peak_kb / 1000)
        self.lived_s += time.monotonic() - self.began_s
        self.end()

    def end(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            for pipe in (self.process.stdin, self.process.stdout):
                if pipe is not None:
                    pipe.close()
            self.process = None

    @property
    def share(self) -> float:
        return self.used_s / self.lived_s


class _Timed(msgspec.Struct):
    time: datetime


@dataclass(slots=True)
class _Delays:
    """Delays of live messages of one key of each gateway, s."""

    listening: bool = True
    found: list[float] = field(default_factory=list)

    def take(self, sample: zenoh.Sample) -> None:
        now_s = time.time()
        if self.listening:
            stamp = msgspec.json.decode(sample.payload.to_bytes(), type=_Timed)
            self.found.append(now_s - stamp.time.timestamp())


GrowingCount = Callable[[], int]
Passes = Callable[[float, GrowingCount | None], None]
"""Lets a share of the run pass. Given what grows meanwhile; None: nothing."""


def of_time(seconds: float) -> Passes:
    """Delays for a run of this many seconds."""
    return lambda share, _: time.sleep(share * seconds)


def of_rows(count: int) -> Passes:
    """Delays for a run of this many rows, however long they take. Raises TimeoutError."""

    def passes(share: float, rows: GrowingCount | None) -> None:
        if rows is not None:
            wanted = rows() + share * count
            if not _wait(lambda: rows() >= wanted, 0.05):
                raise TimeoutError(f"{rows()} rows, expected {wanted:g}")

    return passes


def run_site(gateways: int, keys: int, passes: Passes, every_s: float, read_every_s: float = 1.0) -> SiteRun:
    """Run a site, and compare what was stored with what was kept."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder, port = Path(name), free_port()
        (folder / "gateways").mkdir()
        here, parts = f"tcp/127.0.0.1:{port}", "tests.benches.site_parts"
        router = _Part(("-m", parts, "router", str(port)))
        collector = _Part(
            ("-um", "gateway", "collect", str(folder / "site"), "--connect", here, "--every", str(every_s))
        )
        counts = [(first, min(_PER_PROCESS, gateways - first)) for first in range(0, gateways, _PER_PROCESS)]
        places = [(str(port), str(folder / "gateways"), str(first), str(count)) for first, count in counts]
        fed = (str(keys), str(read_every_s))
        many = [_Part(("-m", parts, "gateways", *place, *fed)) for place in places]
        for part in (router, *many, collector):
            stack.callback(part.end)
            part.start()
        delays = _Delays()
        session = stack.enter_context(zenoh.open(page_config(Telemetry(listen=(), connect=(here,)))))
        subscriber = session.declare_subscriber("talc/*/reading/c0", delays.take)

        def stored_rows() -> int:
            databases = (folder / "gateways" / f"{machine(n)}.sqlite" for n in range(gateways))
            return sum(len(rows) for database in databases for rows in _stored(database).values())

        def kept_rows() -> int:
            return _count(folder / "site")

        passes(1 / 2, kept_rows)
        delays.listening = False
        for part, grows in ((router, stored_rows), (collector, stored_rows), (many[0], None)):
            part.stop()
            passes(1 / 20, grows)
            part.start()
            passes(1 / 20, kept_rows)
        passes(1 / 5, kept_rows)
        subscriber.undeclare()
        late_s = max(_ended(part) for part in many)
        ended_s = time.monotonic()
        stored = {machine(n): _stored(folder / "gateways" / f"{machine(n)}.sqlite") for n in range(gateways)}
        total = sum(len(rows) for tables in stored.values() for rows in tables.values())
        if not _wait(lambda: _is_collected(folder / "site", stored), min(1.0, every_s), _CATCHES_UP_S + every_s):
            raise TimeoutError("not everything is collected")
        caught_up_s = time.monotonic() - ended_s
        for part in (router, collector):
            part.stop()
        lost = wrong = 0
        for name_of, tables in stored.items():
            for table, rows in tables.items():
                kept = _kept(folder / "site", table, name_of)
                lost += len(set(rows) - set(kept))
                wrong += kept != rows
        p50, p99 = np.percentile(delays.found, (50, 99)) if delays.found else (np.nan, np.nan)
        return SiteRun(
            total, lost, wrong, float(p50), float(p99), collector.share, router.share, collector.peak_mb,
            router.peak_mb, caught_up_s, late_s,
        )  # fmt: skip


def _ended(part: _Part) -> float:
    """Let the gateways stop feeding; they go on answering."""
    assert part.process is not None
    assert part.process.stdin is not None
    part.process.stdin.close()
    return float(json.loads(part.line())["late_s"])


def _stored(path: Path) -> dict[str, list[tuple[str, int]]]:
    """Epoch and number of each row of a gateway's store, in order."""
    ask, found = rows_of(path), dict[str, list[tuple[str, int]]]()
    for table in TABLES:
        rows, place = list[tuple[str, int]](), None
        while True:
            page = ask(StoredRequest({table: place}, 50_000)).tables[table]
            assert page.epoch is not None
            rows += [(page.epoch, number) for number in page.numbers]
            place = (page.epoch, page.last)
            if not page.more:
                break
        found[table] = rows
    return found


def _files(folder: Path, table: str, name: str) -> list[Path]:
    return sorted((folder / table / f"machine={name}").rglob("*.parquet"))


def _count(folder: Path) -> int:
    paths = (path for table in TABLES for path in (folder / table).rglob("*.parquet"))
    return sum(parquet.read_metadata(path).num_rows for path in paths)


def _kept(folder: Path, table: str, name: str) -> list[tuple[str, int]]:
    found = [parquet.read_table(path, columns=["epoch", "row"]) for path in _files(folder, table, name)]
    return [pair for rows in found for pair in zip(rows["epoch"].to_pylist(), rows["row"].to_pylist(), strict=True)]


def _is_collected(site: Path, stored: Mapping[str, Mapping[str, Sequence[tuple[str, int]]]]) -> bool:
    """Whether the collector says that it has the last row of each table, and has put its files where they belong."""
    for name, tables in stored.items():
        progress = load_progress(site / "progress" / f"{name}.json")
        if any((site / written).exists() for written, _ in progress.moves):
            return False
        for table, rows in tables.items():
            if rows and (progress.last(table, rows[-1][0]) or 0) < rows[-1][1]:
                return False
    return True


def _wait(reached: Callable[[], bool], look_every_s: float, limit_s: float = _LIMIT_S) -> bool:
    """Wait; returns whether the condition was reached."""
    began_s = time.monotonic()
    while not (there := reached()) and time.monotonic() - began_s < limit_s:
        time.sleep(look_every_s)
    return there


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--gateways", type=int, default=200)
    parser.add_argument("--keys", type=int, default=40)
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--every", type=float, default=30.0)
    given = parser.parse_args()
    found = run_site(given.gateways, given.keys, of_time(given.seconds), given.every)
    print(found)
    print(
        f"| {given.gateways} × {given.keys} | {found.stored} | {found.lost}, {found.doubled_or_moved} "
        f"| {100 * found.collector_share:.0f} % | {found.collector_mb:.0f} MB "
        f"| {100 * found.router_share:.0f} %, {found.router_mb:.0f} MB "
        f"| {1000 * found.live_p50_s:.0f} ms, {1000 * found.live_p99_s:.0f} ms | {found.caught_up_s:.0f} s "
        f"| {found.late_s:.1f} s |"
    )
    if found.lost or found.doubled_or_moved:
        sys.exit(1)


if __name__ == "__main__":
    main()
