"""A program's view of running gateways: follow a machine, ask for its last values and for what it has stored."""

import queue
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack
from datetime import UTC, date, datetime, time, timedelta, tzinfo
from types import TracebackType
from typing import TYPE_CHECKING, Self

import numpy as np
import zenoh

from gateway.config.fields import DEFAULT_PREFIX, key_prefix, machine_name
from gateway.model.codes import NoticeCode
from gateway.model.commands import CommandName
from gateway.model.reading_blocks import DamagedBlock
from gateway.model.text import Text
from gateway.telemetry import keys
from gateway.telemetry.answers import CommandAnswer, HistoryPage
from gateway.telemetry.asking import (
    COMMAND_LIMIT_S,
    QueryRefusal,
    SeveralAnswer,
    Unanswered,
    ask_only,
    command,
    running,
)
from gateway.telemetry.codec import MESSAGE_TYPES, decode
from gateway.telemetry.command_signer import CommandSigner
from gateway.telemetry.history_tables import TimeTable, as_read, asked_s, interval_means
from gateway.telemetry.messages import Published, StatusMessage
from gateway.telemetry.queries import MOST_ROWS
from gateway.telemetry.reaching import why_not
from gateway.telemetry.session import Access, reader_config, reading_session

if TYPE_CHECKING:
    import pandas

ANSWER_LIMIT_S = 10.0
_MOST_WAITING = 20_000
_ANYONE = Access()


class MachineError(OSError):
    """A gateway cannot be reached, does not run, shares its name with another one, or refuses the request; the
    message says which."""


def _lacks(error: MachineError, parameter: str) -> bool:
    """Whether the gateway's program may be too old for this parameter of a query."""
    return isinstance(error.__cause__, QueryRefusal) and error.__cause__.lacks(parameter)


class Machine:
    """One machine's gateway, as a context manager.

    Nothing here changes anything on the other side but the commands, from `measure_now` to `reload`, which
    need an operator (docs/commands.md).

    Parameters
    ----------
    name: of the machine; None: the only one whose gateway runs there
    connect: Zenoh endpoints of the gateway or of a router, such as `tcp/192.168.1.5:7447`; the first that answers
    access: certificates and password, where the gateway or router asks for them
    prefix: of the keys, [telemetry] prefix of the gateway's configuration
    answer_limit_s: how long an answer is waited for, s
    operator: who gives commands; None: nobody

    Raises ValueError for endpoints or names that cannot be; on entry MachineError when nobody answers, no gateway runs,
    or several do and none is named.
    """

    def __init__(
        self,
        name: str | None = None,
        *,
        connect: str | Sequence[str],
        prefix: str = DEFAULT_PREFIX,
        access: Access = _ANYONE,
        answer_limit_s: float = ANSWER_LIMIT_S,
        operator: CommandSigner | None = None,
    ) -> None:
        for what, value, check in (("name", name, machine_name), ("prefix", prefix, key_prefix)):
            try:
                if value is not None:
                    check(value)
            except ValueError as error:
                raise ValueError(f"{what} = {error}") from None
        self._name, self._prefix, self._limit_s = name, prefix, answer_limit_s
        self._connect = (connect,) if isinstance(connect, str) else tuple(connect)
        self._config, self._access = reader_config(self._connect, access), access
        self._session: zenoh.Session | None = None
        self._leaving = ExitStack()
        self._operator = operator
        self.missed = 0
        """Messages that `follow` had to leave out because they were not taken fast enough."""

    def __enter__(self) -> Self:
        where = ", ".join(self._connect)

        def refused(why: str) -> MachineError:
            cause = why_not(self._connect, self._access, why)
            return MachineError(Text(NoticeCode.NO_ANSWER_AT, places=where, why=cause))

        with ExitStack() as stack:
            self._session = stack.enter_context(reading_session(self._config, refused))
            self._name = self._choose(self.running())
            self._leaving = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._leaving.close()

    @property
    def name(self) -> str:
        """The machine's name. Raises MachineError before it is entered without a name."""
        if self._name is None:
            raise MachineError("not connected: use it as `with Machine(...) as machine:`")
        return self._name

    @property
    def root(self) -> str:
        """The key with which all of its keys begin."""
        return keys.root(self._prefix, self.name)

    def running(self) -> list[str]:
        """The machines under the prefix whose gateways run now."""
        return running(self.session, self._prefix, self._limit_s)

    def latest(self, *kinds: str) -> dict[str, Published]:
        """The last message of every key below the machine's, or of these kinds of key only.

        Raises ValueError for a payload that does not fit its type, MachineError when two gateways of this name answer.
        """
        every = zenoh.ConsolidationMode.NONE  # else of two gateways' answers one is passed on
        found = dict[str, Published]()
        for expression in self._expressions(kinds):
            by = set[str]()  # a gateway that has started again since the query before is another one
            for reply in self.session.get(expression, timeout=self._limit_s, consolidation=every):
                if reply.ok is not None and (message := self._message(reply.ok)) is not None:
                    found[self._suffix(reply.ok)] = message
                    by.add(str(reply.replier_id))
            if len(by) > 1:
                raise MachineError(f"{self.name}: {SeveralAnswer(len(by))}")
        return found

    def status(self) -> StatusMessage:
        """How the gateway is, at most 10 s old. Raises MachineError before its first."""
        status = self.latest(keys.STATUS).get(keys.STATUS)
        if not isinstance(status, StatusMessage):
            raise MachineError(f"{self.name}: no status yet; does its gateway run?")
        return status

    def follow(self, *kinds: str, quiet_s: float | None = None) -> Generator[Published, None, None]:
        """The last messages of all keys, or of these kinds of key only, and then every one as it is published.

        When they are not taken fast enough, the oldest of 20 000 are left out and counted in `missed`.

        quiet_s: TimeoutError when nothing has come for this long; None: wait without end, also for a gateway that ended

        Raises as `latest`, also when the second gateway of this name begins later.
        """
        waiting: queue.Queue[zenoh.Sample] = queue.Queue()

        def take(sample: zenoh.Sample) -> None:
            waiting.put(sample)
            if waiting.qsize() > _MOST_WAITING:
                waiting.get_nowait()
                self.missed += 1

        # The gateway may publish between the two: what is then heard twice is passed on once.
        subscribers = [self.session.declare_subscriber(expression, take) for expression in self._expressions(kinds)]
        try:
            latest = self.latest(*kinds)
            yield from sorted(latest.values(), key=lambda message: message.seq)
            passed = {suffix: (message.boot, message.seq) for suffix, message in latest.items()}
            heard = next((message.boot for message in latest.values()), None)
            while True:
                try:
                    sample = waiting.get(timeout=quiet_s)
                except queue.Empty:
                    raise TimeoutError(f"{self.name}: nothing was published for {quiet_s:g} s") from None
                message, suffix = self._message(sample), self._suffix(sample)
                if message is None:
                    continue
                if heard not in (None, message.boot):  # it has started again, or there are two
                    self._refuse_two()
                heard = message.boot
                boot, seq = passed.get(suffix, ("", 0))
                if message.boot != boot or message.seq > seq:
                    yield message
        finally:
            for subscriber in subscribers:
                subscriber.undeclare()

    def pages(
        self,
        begin: datetime,
        end: datetime,
        channels: Sequence[str] | None = None,
        *,
        rows: int = MOST_ROWS,
        every_s: int | None = None,
    ) -> Iterator[HistoryPage]:
        """Stored readings from `begin` on and before `end`, page by page: first means of minutes, as older ones are
        kept, then single readings.

        every_s: rather means over `every_s` seconds each from `begin` on, which the gateway makes

        Raises ValueError for times without an offset from UTC, MachineError with the gateway's own words when it
        refuses or does not answer.
        """
        if every_s is not None:
            return self._pages(begin, end, channels, limit=str(rows), every=str(every_s))
        return self._pages(begin, end, channels, limit=str(rows))

    def _pages(
        self, begin: datetime, end: datetime, channels: Sequence[str] | None, **parameters: str
    ) -> Iterator[HistoryPage]:
        if begin.tzinfo is None or end.tzinfo is None:
            raise ValueError(f"{begin} to {end}: expected times with a time zone")
        asked = {"from": begin.isoformat(), "to": end.isoformat(), **parameters}
        if channels is not None:
            asked["channels"] = ",".join(channels)
        while True:
            page = self._page(asked)
            yield page
            if page.next is None:
                return
            asked["after"] = page.next

    def history(
        self, begin: datetime, end: datetime, channels: Sequence[str] | None = None, *, every_s: float | None = None
    ) -> "pandas.DataFrame":
        """Good readings as a table: a column per channel, a row per time at which one was read, UTC. Needs pandas.

        What was not read at that very time, or was not good, is NaN; `pages` has the quality.

        every_s: rather a row for each `every_s` seconds from `begin` on, with the mean of what was read meanwhile; the
            gateway already has the means of whole minutes, so for many days these are much the fastest

        Raises as `pages`.
        """
        try:
            import pandas as pd
        except ImportError:
            raise ImportError("Machine.history needs pandas: install talc-gateway with the extra `pandas`") from None
        if every_s is None:
            times, table, names = self._readings(begin, end, channels, lambda pages: as_read(pages, channels))
        else:
            span = channels, begin.timestamp(), end.timestamp(), every_s
            whole_s = asked_s(begin, every_s)
            try:
                if whole_s is None or whole_s % 60:
                    times, table, names = self._readings(
                        begin, end, channels, lambda pages: interval_means(pages, *span)
                    )
                else:
                    times, table, names = interval_means(self.pages(begin, end, channels, every_s=whole_s), *span)
            except MachineError as error:
                if not _lacks(error, "every"):
                    raise
                times, table, names = interval_means(self.pages(begin, end, channels), *span)  # of an earlier program
        index = pd.to_datetime(np.round(times * 1e6).astype(np.int64), unit="us", utc=True)
        return pd.DataFrame(table, index=index.rename("time"), columns=names)

    def _readings(
        self,
        begin: datetime,
        end: datetime,
        channels: Sequence[str] | None,
        table_of: Callable[[Iterator[HistoryPage]], TimeTable],
    ) -> TimeTable:
        """A table of pages of blocks; of rows, if the gateway is of an earlier program, or a stored block damaged."""
        try:
            return table_of(self._pages(begin, end, channels, form="blocks"))
        except MachineError as error:
            if not _lacks(error, "form"):
                raise
        except DamagedBlock:
            pass
        return table_of(self.pages(begin, end, channels))

    def day(
        self,
        day: date,
        channels: Sequence[str] | None = None,
        *,
        zone: tzinfo = UTC,
        every_s: float | None = None,
    ) -> "pandas.DataFrame":
        """The readings of one calendar day; see `history`."""
        begin, end = (datetime.combine(at, time(), zone) for at in (day, day + timedelta(days=1)))
        return self.history(begin, end, channels, every_s=every_s)

    def measure_now(self) -> CommandAnswer:
        """Have the gateway request a probing cycle before its grid step ends, as soon as nothing blocks it.

        Raises MachineError with the gateway's own words when it refuses.
        """
        return self.give(CommandName.MEASURE)

    def pause(self) -> CommandAnswer:
        """Have the compensation go to its declared state and stay there until `resume`. Raises as `measure_now`."""
        return self.give(CommandName.PAUSE)

    def resume(self) -> CommandAnswer:
        """End the pause. Raises as `measure_now`."""
        return self.give(CommandName.RESUME)

    def disarm(self) -> CommandAnswer:
        """Have the offsets go to zero and stay there until `arm`; no probing cycle is requested meanwhile. Raises as
        `measure_now`."""
        return self.give(CommandName.DISARM)

    def arm(self) -> CommandAnswer:
        """End the disarming: what the configuration arms is armed again. Raises as `measure_now`."""
        return self.give(CommandName.ARM)

    def reload(self) -> CommandAnswer:
        """Have the gateway read its configuration again and apply it. Raises as `measure_now`, and when something in it
        needs a restart."""
        return self.give(CommandName.RELOAD)

    def new_reference(self) -> CommandAnswer:
        """Have the sphere measured anew while no program runs, from where errors count from zero. Raises as
        `measure_now`."""
        return self.give(CommandName.REFERENCE)

    def give(self, name: CommandName) -> CommandAnswer:
        """Give a command, and return the answer of the gateway, which has stored it.

        Raises MachineError without an operator, when the gateway refuses or does not answer, or when what answers does
        not hold the operator's key.
        """
        if self._operator is None:
            raise MachineError("commands need an operator: Machine(..., operator=CommandSigner.of_file(NAME, FILE))")
        try:
            answer = command([self.session], self.root, self._operator, name, max(self._limit_s, COMMAND_LIMIT_S))
        except (OSError, ValueError) as error:
            absent = isinstance(error, Unanswered)
            hint = "; does its configuration have [[telemetry.operator]]?" if absent else ""
            raise MachineError(f"{self.name}: {error}{hint}") from error
        if not answer.accepted:
            raise MachineError(f"{self.name}: {name.value} refused: {answer.text}")
        return answer

    def _refuse_two(self) -> None:
        """Raises MachineError when two gateways answer."""
        try:
            ask_only([self.session], f"{self.root}/{keys.STATUS}", StatusMessage, self._limit_s)
        except SeveralAnswer as error:
            raise MachineError(f"{self.name}: {error}") from error
        except OSError:  # it has none yet, or has gone again
            pass

    def _page(self, asked: dict[str, str]) -> HistoryPage:
        selector = f"{self.root}/{keys.HISTORY}?" + ";".join(f"{name}={value}" for name, value in asked.items())
        try:
            return ask_only([self.session], selector, HistoryPage, self._limit_s)
        except OSError as error:
            raise MachineError(f"{self.name}: {error}") from error

    def _choose(self, alive: Sequence[str]) -> str:
        if self._name is not None and self._name in alive:
            return self._name
        if not alive:
            raise MachineError(
                f"no gateway runs under {self._prefix} (its [telemetry] prefix), or its readers do not name you"
            )
        running = f"running: {', '.join(alive)}"
        if self._name is not None:
            raise MachineError(f"no gateway of machine {self._name} runs under {self._prefix}; {running}")
        if len(alive) > 1:
            raise MachineError(f"several gateways run under {self._prefix}; name one; {running}")
        return alive[0]

    @property
    def session(self) -> zenoh.Session:
        """The Zenoh session, for what this class does not do. Raises MachineError before it is entered."""
        if self._session is None:
            raise MachineError("not connected: use it as `with Machine(...) as machine:`")
        return self._session

    def _expressions(self, kinds: Sequence[str]) -> list[str]:
        for kind in kinds:
            if kind not in MESSAGE_TYPES:
                raise ValueError(f"{kind!r}: no such kind of key; known are {', '.join(MESSAGE_TYPES)}")
        return [f"{self.root}/{kind}/**" for kind in kinds] or [f"{self.root}/**"]

    def _suffix(self, sample: zenoh.Sample) -> str:
        return str(sample.key_expr).removeprefix(self.root + "/")

    def _message(self, sample: zenoh.Sample) -> Published | None:
        return decode(self._suffix(sample), sample.payload.to_bytes())
