"""Asks every gateway of a site in turn for its next rows, and commits them before it asks for more."""

import logging
import math
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Protocol, cast

import pyarrow as pa
from pyarrow import compute

from drivers.base import SystemClock
from gateway.listeners.collect.folder import Commit
from gateway.listeners.collect.progress import CollectProgress, TablePlace
from gateway.listeners.collect.tables import arrow_of, check_end, time_column
from gateway.model.codes import NoticeCode
from gateway.model.notice import Notice
from gateway.model.text import Text, text_of
from gateway.runtime.problems import Problems, TurnTime
from gateway.storage.epochs import NUMBERS
from gateway.telemetry.answers import StoredRows, StoredTable
from gateway.telemetry.asking import QueryRefusal

log = logging.getLogger(__name__)

_LIMIT = 10_000
"""Rows of a table in one answer."""
_AT_ONCE = 16
"""Machines that are asked at the same time, as one that does not answer holds up the others."""
_WRITTEN_AT_ONCE = 2
"""Answers that are written at the same time, as that takes memory."""
_APART_S = 1.0
"""Between two turns in which machines are asked that have nothing more. All at once they would keep processors, disks
and the network busy for seconds, and live messages would wait."""
_AHEAD_S = 60.0
"""How far the clocks of two computers with time servers are never apart."""
_NAMED = 5
"""Machines that a line of the log names."""
_GAPS = "gaps"


class SiteGateways(Protocol):
    """Who is asked."""

    def running(self) -> Sequence[str]:
        """The machines whose gateways run now."""

    def ask(self, machine: str, after: Mapping[str, TablePlace | None], limit: int) -> StoredRows:
        """Rows that follow. Raises QueryRefusal, another OSError, ValueError."""


class SiteKept(Protocol):
    """Where rows are kept."""

    def ready(self) -> None:
        """Raises OSError while nothing can be kept at all."""

    def progress(self, machine: str) -> CollectProgress:
        """How far a machine is collected. Raises OSError, ValueError."""

    def collected_as(self, table: str, epoch: str) -> tuple[str, CollectProgress] | None:
        """The machine of which this epoch of a table is collected, and how far; None: of none. Raises OSError."""

    def add(self, machine: str, commit: Commit) -> CollectProgress:
        """Keep all of a batch, or nothing of it. When this returns, it is kept for good.

        Raises OSError, ValueError; then only `progress` knows whether it counts.
        """


@dataclass(slots=True)
class MachineAsked:
    """What is known of one machine."""

    progress: CollectProgress | None = None
    """None: to be read from the disk."""
    back: dict[str, int] = field(default_factory=dict)
    """By table: how many epochs the gateway was asked for and does not know."""
    due_s: float = 0.0
    """When it is asked next, on the collector's clock."""
    lacks: frozenset[str] = frozenset()
    """Tables that its program does not have; forgotten at each start of the gateway, which may run a later program."""
    problem: str = ""
    """Why it was not collected; empty: it was."""
    rows: dict[str, int] = field(default_factory=dict)
    """Collected since the start, by table."""


class Collector:
    """Collects a site.

    Parameters
    ----------
    gateways: who is asked
    kept: where it is kept
    every_s: how often a machine is asked of which it has everything; the machines' turns are spread over this time
    limit: rows of a table in one answer
    utc: the time of gaps
    """

    def __init__(
        self,
        gateways: SiteGateways,
        kept: SiteKept,
        *,
        every_s: float = 30.0,
        limit: int = _LIMIT,
        utc: Callable[[], datetime] = lambda: datetime.now(UTC),
    ) -> None:
        self._gateways, self._kept, self._every_s, self._limit, self._utc = gateways, kept, every_s, limit, utc
        self.machines: dict[str, MachineAsked] = {}
        self._writing = threading.Semaphore(_WRITTEN_AT_ONCE)
        self._time, self._notices = TurnTime(), list[Notice]()
        self._problems = Problems(self._time, every_s, lambda _: None, log)
        self._of_machines = Problems(self._time, every_s, self._notices.append, log, quiet=True)
        """Told together for all machines that have the same one."""
        self._clocks = Problems(self._time, every_s, lambda _: None, log)
        self._clocks_lock = threading.Lock()

    def run(self, stop: threading.Event) -> None:
        """Turn after turn until `stop`. What holds up all machines is logged when it begins and when it ends."""
        clock = SystemClock()
        while not stop.is_set():
            try:
                due_s = self.turn(clock.monotonic())
            except OSError as error:
                due_s = clock.monotonic() + self._every_s
                self._problems.report("site", text_of(error), str(error))
            else:
                self._problems.clear("site", NoticeCode.COLLECTING_AGAIN)
            stop.wait(max(0.0, due_s - clock.monotonic()))

    def turn(self, now_s: float) -> float:
        """Ask each machine that runs and is due once: those with a backlog get one page each, so that none waits for
        another's backlog. Returns when the next turn is due. Raises OSError while nothing can be kept, or when the
        network fails as a whole."""
        self._time.now_s = now_s
        self._kept.ready()
        running = self._gateways.running()
        if running:
            self._problems.clear("gateways", NoticeCode.GATEWAYS_HEARD)
        else:
            self._problems.report("gateways", Text(NoticeCode.NO_GATEWAY_HEARD))
        slots = max(1, int(self._every_s / _APART_S))
        phase_s = {name: at * slots // len(running) * self._every_s / slots for at, name in enumerate(running)}
        due = [name for name in running if self.machines.setdefault(name, MachineAsked()).due_s <= now_s]
        with ThreadPoolExecutor(_AT_ONCE) as pool:
            for name, (more, bug) in zip(due, pool.map(self._collect, due), strict=True):
                self.machines[name].due_s = now_s if more else self._next_s(now_s, phase_s[name])
                self._report(name, self.machines[name].problem, bug)
        self._tell()
        return min((self.machines[name].due_s for name in running), default=now_s + self._every_s)

    def _next_s(self, now_s: float, phase_s: float) -> float:
        """The next time of this phase that is at least half of `every_s` away."""
        return phase_s + math.ceil((now_s + self._every_s / 2 - phase_s) / self._every_s) * self._every_s

    def _collect(self, name: str) -> tuple[bool, Exception | None]:
        """Whether there is more; an unexpected exception. Whatever goes wrong with a machine holds up no other one."""
        asked = self.machines[name]
        try:
            more = self._page(name, asked)
        except Exception as error:  # noqa: BLE001 - whatever claims to be a gateway may answer anything; it is reported
            asked.progress = None  # the disk says whether the batch counts
            asked.problem = text_of(error) or type(error).__name__
            if isinstance(error, OSError | ValueError | pa.ArrowException):
                return False, None
            asked.problem = f"unexpected {type(error).__name__}: {error}"
            return False, error
        asked.problem = ""
        return more, None

    def _report(self, name: str, problem: str, bug: Exception | None) -> None:
        if problem:
            self._of_machines.report(
                name, Text(NoticeCode.NOT_COLLECTED, machine=name, problem=problem), problem, bug=bug
            )
        else:
            self._of_machines.clear(name, NoticeCode.COLLECTED_AGAIN, machine=name)

    def _tell(self) -> None:
        """Log what began and ended in this turn, in one line for all machines of which the same is said."""
        together = dict[Text, list[str]]()
        for notice in self._notices:
            together.setdefault(notice.text.having("machine", ""), []).append(notice.subject)
        self._notices.clear()
        for text, names in together.items():
            log.warning("%s", text.having("machine", _some(names)))

    def _page(self, name: str, asked: MachineAsked) -> bool:
        before = asked.progress or self._kept.progress(name)
        places = {table: before.place(table, asked.back.get(table, 0)) for table in NUMBERS if table not in asked.lacks}
        try:
            answer = self._gateways.ask(name, places, self._limit)
        except QueryRefusal as error:
            lacks = self._lacking(name, places, text_of(error))
            if not lacks or lacks >= frozenset(places):
                raise
            asked.lacks |= lacks
            places = {table: place for table, place in places.items() if table not in lacks}
            answer = self._gateways.ask(name, places, self._limit)
        with self._writing:
            if (renamed := self._renamed(name, before, answer)) is not None:
                asked.progress = renamed
                return True
            return self._keep(name, asked, before, places, answer)

    def _renamed(self, name: str, before: CollectProgress, answer: StoredRows) -> CollectProgress | None:
        """Of a machine that is collected for the first time: where it was, if its store is known by another name."""
        if before.places:
            return None
        begun = ((table, page.epoch) for table, page in answer.tables.items() if page.epoch and page.numbers)
        found = next((found for place in begun if (found := self._kept.collected_as(*place)) is not None), None)
        if found is None or found[0] == name:
            return None
        former, progress = found
        log.warning("%s", Text(NoticeCode.MACHINE_RENAMED, machine=name, former=former))
        return CollectProgress(before.batch, progress.places)

    def _lacking(self, name: str, places: Mapping[str, TablePlace | None], refused: Text) -> frozenset[str]:
        """The tables that the gateway's program does not have. One that does not say so is asked for each."""
        if refused.code:
            has = refused.value_of("tables") if refused.says(NoticeCode.NO_SUCH_TABLE) else None
            return frozenset() if has is None else frozenset(places) - frozenset(map(str, cast("Sequence[str]", has)))
        lacks = set()
        for table, place in places.items():
            try:
                self._gateways.ask(name, {table: place}, 1)
            except QueryRefusal:
                lacks.add(table)
        return frozenset(lacks)

    def _keep(
        self,
        name: str,
        asked: MachineAsked,
        before: CollectProgress,
        places: Mapping[str, TablePlace | None],
        answer: StoredRows,
    ) -> bool:
        batch = _Batch(before)
        for table, page in answer.tables.items():
            if page.problem:
                batch.problems.append(page.problem)
            elif page.epoch is not None and table in places:
                asked.back.pop(table, None)
                if (place := places[table]) is not None and place[0] != page.epoch:
                    asked.lacks = frozenset()  # it was started again
                batch.take(table, page.epoch, page, places[table])
            elif table in places:
                if places[table] is None:
                    raise ValueError(f"{table}: has no epoch, not even from the beginning")
                asked.back[table] = asked.back.get(table, 0) + 1
                batch.more = True
        rows = batch.rows_at(self._utc())
        for table, *_ in batch.gaps:
            log.warning("%s", Text(NoticeCode.ROWS_TOO_OLD, machine=name, table=table))
        self._compare_clock(name, rows)
        asked.progress = self._kept.add(name, Commit(batch.progress, rows)) if batch.progress != before else before
        for table, added in rows.items():
            asked.rows[table] = asked.rows.get(table, 0) + added.num_rows
        if batch.problems:
            raise OSError("; ".join(batch.problems))
        return batch.more

    def _compare_clock(self, name: str, rows: Mapping[str, pa.Table]) -> None:
        """Say when rows are of a time that has not come yet; they are kept as they are."""
        latest = max((time for table in rows.values() if (time := _latest(table)) is not None), default=None)
        if latest is None:
            return
        ahead_s = (latest - self._utc()).total_seconds()
        with self._clocks_lock:
            if ahead_s > _AHEAD_S:
                text = Text(NoticeCode.GATEWAY_CLOCK_AHEAD, machine=name, ahead_s=ahead_s)
                self._clocks.report(name, text)
            else:
                self._clocks.clear(name, NoticeCode.GATEWAY_CLOCK_RIGHT, machine=name)


@dataclass(slots=True)
class _Batch:
    """What one answer adds."""

    progress: CollectProgress
    rows: dict[str, pa.Table] = field(default_factory=dict)
    gaps: list[tuple[str, str, int | None, int]] = field(default_factory=list)
    """Table, epoch, the last row that was collected, and up to which row they were deleted."""
    problems: list[str] = field(default_factory=list)
    more: bool = False

    def take(self, table: str, epoch: str, page: StoredTable, place: TablePlace | None) -> None:
        """Add the rows that follow a place. Raises ValueError."""
        rows = arrow_of(page, self.progress.last(table, epoch))
        check_end(page, None if place is None else place[1])
        self.progress = self.progress.moved_on(table, epoch, page.last)
        self.more = self.more or (page.more and (epoch, page.last) != place)
        if rows.num_rows:
            self.rows[table] = rows
        if page.thinned is not None:
            self.gaps.append((table, epoch, None if place is None else place[1], page.thinned))

    def rows_at(self, now: datetime) -> dict[str, pa.Table]:
        """By table, with the gaps that were found now."""
        if not self.gaps:
            return self.rows
        columns = ([now] * len(self.gaps), *zip(*self.gaps, strict=True))
        types = (pa.timestamp("us", tz="UTC"), pa.string(), pa.string(), pa.int64(), pa.int64())
        arrays = [pa.array(values, type_) for values, type_ in zip(columns, types, strict=True)]
        return {**self.rows, _GAPS: pa.table(arrays, ["time", "table", "epoch", "after", "upto"])}


def _latest(table: pa.Table) -> datetime | None:
    """The latest time in a table."""
    if not table.num_rows:
        return None
    found = compute.max(table[time_column(table)]).as_py()
    return found if isinstance(found, datetime) else None


def _some(names: Sequence[str]) -> str:
    """The first names, and how many more there are."""
    more = len(names) - _NAMED
    return ", ".join(names[:_NAMED]) + (f" and {more} more" if more > 0 else "")
