"""Defects that the bench which kills gateways has to find, each in one phase.

Without a kill a gateway with one of them does all that it should.
"""

# ruff: noqa: SLF001 - a defect is put where it does harm

import asyncio
import sqlite3
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from drivers.nc import NcSnapshot, WatchdogTerms
from gateway.config import GatewayConfig
from gateway.control.grid import Instant
from gateway.control.loop import GridLoop
from gateway.events import DecisionMade, FrameMade
from gateway.nc import NcLink
from gateway.nc.states import Condition
from gateway.past import rebuild
from gateway.past.rebuild import RebuildProgress, Rebuilt, go_on
from gateway.probing import Prober
from gateway.storage import Store, StoredStep, schema, store
from gateway.storage.writer import DatabaseWriter
from tests.benches.planted import Defect

_rebuilt, _make_schema, _stop, _finding = rebuild.rebuilt, schema.make_schema, NcLink.stop, NcLink._finding


def _tables_one_by_one(path: Path) -> Path | None:
    """A new file gets its version first and its tables in a transaction each."""
    if not path.exists():
        with closing(schema.connect(path)) as connection:
            connection.execute(f"PRAGMA user_version = {schema.SCHEMA_VERSION}")
            statement = ""
            for line in schema.NEW.splitlines():
                statement += line + "\n"
                if sqlite3.complete_statement(statement):
                    if not statement.strip().startswith(("BEGIN", "COMMIT", "PRAGMA")):
                        connection.execute(statement)
                        connection.commit()
                    statement = ""
    return _make_schema(path)


def _steps_taken_out(
    steps: Iterable[StoredStep], config: GatewayConfig, found: Rebuilt, progress: RebuildProgress = go_on
) -> Rebuilt:
    """The decision on a step is deleted, and put back when the step has been repeated."""

    def each() -> Iterator[StoredStep]:
        with closing(sqlite3.connect(config.storage.path, isolation_level=None)) as connection:
            for step in list(steps):
                query = "SELECT * FROM decision WHERE k = ?"
                row = connection.execute(query, (step.frame.k,)).fetchone()
                connection.execute("DELETE FROM decision WHERE k = ?", (step.frame.k,))
                yield step
                connection.execute(f"INSERT INTO decision VALUES ({', '.join('?' * len(row))})", row)

    return _rebuilt(each(), config, found, progress)


async def _at_once(*_: object) -> None:
    """A probing request does not wait for its number to be stored; a cycle of an earlier run is not withdrawn."""
    await asyncio.sleep(0)


def _own_cycles_alone(link: NcLink, snapshot: NcSnapshot) -> Condition:
    """The offsets stand still in cycles of this run, not in one that an earlier run has asked for."""
    return _finding(link, replace(snapshot, probing=False))


def _frame_first(loop: GridLoop, instant: Instant) -> None:
    """The frame is stored before the controller learns from it."""
    frame = loop._sampler.frame(instant, loop._measuring.take())
    loop._sink(FrameMade(frame, loop._moment(instant)))
    loop._last_k = frame.k
    decision = loop._controller.step(frame)
    loop._sink(DecisionMade(decision))
    loop._measuring.want(decision)
    for follow in loop._followers:
        follow(frame, decision)


async def _unwatched_while_stopping(link: NcLink) -> None:
    """The control's watchdog is told to do nothing while the gateway takes its offsets back."""
    lease = link._lease
    if lease.armed:
        await lease._nc.claim(lease._owner, WatchdogTerms(1e9, 0.0))
    await _stop(link)


PLANTED: Mapping[str, tuple[str, Defect]] = {
    "commit later than said": ("writing", ((DatabaseWriter, "flush", lambda *_: None),)),
    "tables one by one": ("start", ((store, "make_schema", _tables_one_by_one),)),
    "steps taken out": ("rebuild", ((rebuild, "rebuilt", _steps_taken_out),)),
    "half a step": (
        "learning",
        (
            (GridLoop, "_step", _frame_first),
            (store, "_remove_torn_step", lambda _: None),
        ),
    ),
    "number not stored": ("probing", ((Store, "on_disk", _at_once),)),
    "moved in a cycle": (
        "probing",
        (
            (NcLink, "_finding", _own_cycles_alone),
            (Prober, "settle", _at_once),
        ),
    ),
    "unwatched": ("stop", ((NcLink, "stop", _unwatched_while_stopping),)),
}
"""Each with the phase in which it is found."""
