"""Defects that the bench with killed gateways has to find, each in one phase.

A gateway with one of them does everything that it should, unless it is killed.
"""

from collections.abc import Mapping, Sequence

from gateway.control import loop
from gateway.nc import link
from gateway.past import rebuild
from gateway.probing import prober
from gateway.storage import schema, store, writer
from tests.benches.changed_source import SourceChange

PLANTED: Mapping[str, tuple[str, Sequence[SourceChange]]] = {
    # A flush returns before anything is committed.
    "commit later than said": ("writing", (SourceChange(writer, 'self.put("", (), commit=True)', "return"),)),
    # A new file gets its version first and its tables in a transaction each.
    "tables one by one": (
        "start",
        (
            SourceChange(
                schema,
                """\
            if version == 0 and not foreign:
                connection.executescript(NEW)
""",
                """\
            if version == 0 and not foreign:
                version, statement = SCHEMA_VERSION, ""
                connection.execute(f"PRAGMA user_version = {version}")
                for line in _SCHEMA.splitlines(keepends=True):
                    statement += line
                    if sqlite3.complete_statement(statement):
                        connection.execute("BEGIN")
                        connection.execute(statement)
                        connection.commit()
                        statement = ""
""",
            ),
        ),
    ),
    # The decision on a step is deleted, and put back when the step has been repeated.
    "steps taken out": (
        "rebuild",
        (
            SourceChange(
                rebuild,
                """\
    for step in steps:
        decision = found.controller.step(step.frame)
""",
                """\
    import sqlite3
    database = sqlite3.connect(config.storage.path, isolation_level=None)
    for step in list(steps):
        row = database.execute("SELECT * FROM decision WHERE k = ?", (step.frame.k,)).fetchone()
        database.execute("DELETE FROM decision WHERE k = ?", (step.frame.k,))
        decision = found.controller.step(step.frame)
""",
            ),
            SourceChange(
                rebuild,
                """\
        progress(found)
    return found
""",
                """\
        progress(found)
        database.execute(f"INSERT INTO decision VALUES ({', '.join('?' * len(row))})", row)
    database.close()
    return found
""",
            ),
        ),
    ),
    # The frame is stored before the controller learns from it, and one without a decision stays.
    "half a step": (
        "learning",
        (
            SourceChange(
                loop,
                """\
        decision = self._controller.step(frame)
        self._last_k, self._stepped_s = frame.k, instant.monotonic_s
        self._sink(FrameMade(frame, self._moment(instant)))
""",
                """\
        self._last_k, self._stepped_s = frame.k, instant.monotonic_s
        self._sink(FrameMade(frame, self._moment(instant)))
        decision = self._controller.step(frame)
""",
            ),
            SourceChange(store, "            _remove_torn_step(connection)\n", ""),
        ),
    ),
    # A probing request does not wait for its number to be stored.
    "number not stored": (
        "probing",
        (
            SourceChange(
                store,
                "await asyncio.to_thread(self._writer.flush, (WaitingKind.KEPT,), limit_s)",
                "await asyncio.sleep(0)",
            ),
        ),
    ),
    # The offsets stand still in cycles of this run, not in one that an earlier run asked for and nobody withdraws.
    "moved in a cycle": (
        "probing",
        (
            SourceChange(link, "if self._hold.on or snapshot.probing", "if self._hold.on"),
            SourceChange(prober, "            await self.withdraw()\n", "            pass\n"),
        ),
    ),
    # The control's watchdog is told to do nothing while the gateway takes its offsets back.
    "unwatched": (
        "stop",
        (
            SourceChange(
                link,
                "        self._state = after(STATES, self._state, Condition.STOP)\n",
                """\
        from drivers.nc import WatchdogTerms
        if (lease := self._lease).armed:
            await lease._nc.claim(lease._owner, WatchdogTerms(1e9, 0.0))
        self._state = after(STATES, self._state, Condition.STOP)
""",
            ),
        ),
    ),
}
"""Each defect with the phase in which it is found."""
