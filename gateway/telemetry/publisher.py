"""Publishes everything over Zenoh from a separate thread, so that the control loop never waits for the network."""

import asyncio
import logging
import threading
import time
from collections.abc import Callable, Coroutine, Iterable, Mapping, Sequence
from itertools import groupby
from typing import Self

import zenoh

from drivers.base import Clock, SystemClock
from drivers.signature import shared_key
from gateway.config.applied import ConfigurationApplied
from gateway.config.certificates import certificate_ends
from gateway.config.consequences import unarmed
from gateway.config.telemetry import Telemetry as TelemetrySettings
from gateway.model.codes import NoticeCode
from gateway.model.commands import Command, CommandOutcome
from gateway.model.events import (
    CompensationStepped,
    DecisionMade,
    GatewayEvent,
    HealthChecked,
    OutlookChanged,
    StorageChanged,
)
from gateway.model.text import Text, text_of
from gateway.runtime.problems import Problems
from gateway.telemetry import keys
from gateway.telemetry.answers import ScenarioPage
from gateway.telemetry.backlog import Backlog
from gateway.telemetry.codec import encode
from gateway.telemetry.command_door import CommandDoor, Entitled
from gateway.telemetry.compose import Composer, Dropped, GatewayState, Keyed
from gateway.telemetry.history_queries import CourseSource, HistorySource, course_answer, history_answer
from gateway.telemetry.json_schema import schemas
from gateway.telemetry.queries import Queries
from gateway.telemetry.reached import Reached
from gateway.telemetry.report_queries import ReportSource, report_answer
from gateway.telemetry.scenario_queries import ScenarioRequest, scenario_answer
from gateway.telemetry.stored_queries import StoredSource, stored_answer

log = logging.getLogger(__name__)

_MOST_LOOSE = 5000
_MOST_FIRM = 20_000
"""A day of frames, decisions and events; a subscriber that stalls for longer misses the oldest."""
_MOST_FIRM_BYTES = 32_000_000
"""And as many bytes of them."""
_GATHER_S = 0.05
"""How long a reading waits for others to leave with it."""
_OPENS_S = 2.0
"""How long the entry waits for the first attempt to open the session. It usually opens in half a second, and then
whoever follows the gateway's start finds it open; nothing else waits for it."""
_JSON = zenoh.Encoding.APPLICATION_JSON
_MUST_ARRIVE = frozenset({keys.FRAME, keys.DECISION, keys.MEASUREMENT, keys.MODEL, keys.EVENT, keys.PROBING})
"""Kinds for which a slow subscriber makes the publishing thread wait instead of losing a sample."""


_OBEYED_WITHIN_S = 60.0
"""A command waits for the disk, twice."""

Obey = Callable[[Command, Text], Coroutine[object, object, CommandOutcome]]
"""Carries out a command in the event loop, or refuses it for the given reason. Raises OSError while nobody does."""


Scenario = Callable[[ScenarioRequest], Coroutine[object, object, ScenarioPage]]
"""Computes it in the event loop. Raises ValueError for what is not planned, OSError while there is no forecast."""
_COMPUTED_WITHIN_S = 10.0


class TelemetryPublisher:
    """Publishes every event, as an async context manager.

    A late subscriber gets the last value of every key by a query on `<prefix>/<machine>/**`; queries on
    `schema/<kind>`, `history`, `course`, `report`, `scenario` and `stored` are answered too. When the network is slower
    than what is published, the oldest readings, compensation steps and states are dropped and counted; of the rest the
    oldest goes only beyond 20 000 messages or 32 MB, and is counted apart. A query larger than 1 MiB is not taken.

    The session opens in the background, for ever: a router that is away or a wrong certificate holds up nothing. What
    is published before waits within the same bounds, and is sent when the session has opened.

    Parameters
    ----------
    settings: the [telemetry] section
    machine: second part of every key
    input_names: order of a frame's inputs
    clock: for the time in each payload and the age of readings
    boot: identifies this run of the process
    simulated: whether the clock is a simulated one
    reached: how others reach it; None: by these settings
    history: finds stored readings; None: queries on `history` are refused
    course: finds stored estimates; None: queries on `course` are refused
    stored: finds stored rows; None: queries on `stored` are refused
    report: makes the report of a day; None: queries on `report` are refused
    periods_missed: the number of missed periods by bus, for the status
    answers_s: how long each unit usually takes to answer, s, by bus, for the status
    clock_known: whether the computer's clock is known to be right, for every message
    obey: carries out commands, or refuses them; None: each is refused until the gateway has started
    scenario: computes a scenario in the event loop; None: queries on `scenario` are refused
    """

    def __init__(
        self,
        settings: TelemetrySettings,
        machine: str,
        input_names: Sequence[str],
        clock: Clock,
        boot: str,
        *,
        simulated: bool,
        reached: Reached | None = None,
        history: HistorySource | None = None,
        course: CourseSource | None = None,
        stored: StoredSource | None = None,
        report: ReportSource | None = None,
        periods_missed: Callable[[], Mapping[str, int]] = dict,
        answers_s: Callable[[], Mapping[str, Mapping[int, float]]] = dict,
        clock_known: Callable[[], bool] = lambda: True,
        obey: Obey | None = None,
        scenario: Scenario | None = None,
    ) -> None:
        self._settings, self._root = settings, keys.root(settings.prefix, machine)
        self._composer = Composer(boot, input_names, clock, simulated=simulated, clock_known=clock_known)
        self._backlog = Backlog(_MOST_LOOSE, _MOST_FIRM, _MOST_FIRM_BYTES, _GATHER_S)
        self._state = GatewayState(commands=bool(settings.operators))
        self._periods_missed, self._answers_s = periods_missed, answers_s
        self._last: dict[str, bytes] = {}
        self._last_lock = threading.Lock()
        self._thread = threading.Thread(target=self._send, name="telemetry", daemon=True)
        self._problems = Problems(SystemClock(), 1.0, lambda _: None, log)
        self.reached = Reached(settings, machine, boot) if reached is None else reached
        self._queries: tuple[Queries, ...] = (
            Queries(self._root, keys.HISTORY, None if history is None else history_answer(history)),
            Queries(self._root, keys.COURSE, None if course is None else course_answer(course)),
            Queries(self._root, keys.STORED, None if stored is None else stored_answer(stored)),
            Queries(self._root, keys.REPORT, None if report is None else report_answer(report)),
        )
        self._undeclare: list[Callable[[], object]] = []
        self._schemas: dict[str, bytes] = {}
        self._machine = machine
        self._obey, self._scenario = obey, scenario

    @property
    def dropped(self) -> Dropped:
        """What was not published because the network was too slow."""
        return Dropped(self._backlog.dropped_loose, self._backlog.dropped_firm)

    def dropped_by_kind(self) -> Mapping[str, int]:
        """The same, for figures."""
        return self.dropped._asdict()

    async def tried(self, limit_s: float) -> None:
        """Wait until the first attempt to open the session has ended, or for so long."""
        await asyncio.to_thread(self.reached.session.tried, limit_s)

    async def __aenter__(self) -> Self:
        self._schemas = {f"{keys.SCHEMA}/{kind}": text.encode() for kind, text in schemas().items()}
        loop = asyncio.get_running_loop()
        self._queries = (*self._queries, self._scenario_queries(loop), *self._command_queries(loop))
        for queries in self._queries:
            queries.start()
        self.reached.session.start(self._opened)
        self.reached.echo.start()
        await self.tried(_OPENS_S)
        return self

    async def __aexit__(self, *_: object) -> None:
        self._backlog.close()
        await asyncio.to_thread(self.reached.echo.close)
        await asyncio.to_thread(self.reached.session.stop)
        if self._thread.ident is not None:
            await asyncio.to_thread(self._thread.join)
        for queries in self._queries:
            await asyncio.to_thread(queries.close)
        await asyncio.to_thread(self._close)

    def _opened(self, session: zenoh.Session) -> None:
        """What has waited is sent before anybody hears that this gateway lives and asks for the last values."""
        for key, answer in (
            *((queries.declared, queries.take) for queries in self._queries),
            (f"{self._root}/**", self._answer),
        ):
            self._undeclare.append(session.declare_queryable(key, answer).undeclare)
        while self._backlog.waiting:
            self._put_out(session, self._backlog.take())
        self._undeclare.append(session.liveliness().declare_token(f"{self._root}/{keys.ALIVE}").undeclare)
        self._thread.start()

    def _command_queries(self, loop: asyncio.AbstractEventLoop) -> tuple[Queries, ...]:
        """None without operators: then nothing listens for commands."""
        operators = {}
        for one in self._settings.operators:
            try:
                operators[one.name] = Entitled(shared_key(one.key_file), frozenset(one.may))
            except (OSError, ValueError) as error:
                log.error(
                    "%s", Text(NoticeCode.KEY_REFUSED, user=one.name, file=str(one.key_file), error=text_of(error))
                )

        def give(command: Command, refused: Text) -> CommandOutcome:
            if self._obey is None:
                raise OSError("the gateway is starting; give the command again")
            return asyncio.run_coroutine_threadsafe(self._obey(command, refused), loop).result(_OBEYED_WITHIN_S)

        door = CommandDoor(self._machine, operators, give, time.monotonic)
        return (Queries(self._root, keys.COMMAND, sift=door.sift),) if self._settings.operators else ()

    def _scenario_queries(self, loop: asyncio.AbstractEventLoop) -> Queries:
        def computed(asked: ScenarioRequest) -> ScenarioPage:
            if self._scenario is None:
                raise OSError("this gateway does not learn")
            return asyncio.run_coroutine_threadsafe(self._scenario(asked), loop).result(_COMPUTED_WITHIN_S)

        return Queries(self._root, keys.SCENARIO, scenario_answer(computed))

    def _close(self) -> None:
        for undeclare in reversed(self._undeclare):  # the token first
            undeclare()
        self.reached.session.close()

    def publish(self, event: GatewayEvent) -> None:
        """A gateway.model.events.Sink: puts the event's messages into the queue."""
        state = self._state
        match event:
            case CompensationStepped(write) if write.mode == "monitor":
                return
            case ConfigurationApplied(config):
                state.config, state.unarmed = config.fingerprint(), unarmed(config)
                state.certificates = certificate_ends(config)  # a few small files: as the programs use them from now on
                state.planned_loads = tuple(planned.name for planned in config.planned_loads)
                state.kinematics = config.machine.chain
                state.sphere_mm = config.probing.sphere_radius_mm, config.probing.sphere_height_mm
                state.when_stale = config.compensation.when_stale
            case DecisionMade(decision):
                state.decision = decision
            case OutlookChanged(outlook):
                state.outlook = outlook
            case StorageChanged(storage):
                state.storage = storage
            case HealthChecked(health):
                state.health, state.storage = health, health.store
            case _:
                pass
        self._put(self._composer.messages(event))
        if isinstance(event, ConfigurationApplied | DecisionMade | OutlookChanged | StorageChanged | HealthChecked):
            self._put_status()

    def _put_status(self) -> None:
        self._put([self._composer.status(self._state, self.dropped, self._periods_missed(), self._answers_s())])

    def _put(self, messages: Iterable[Keyed]) -> None:
        encoded = [(suffix, encode(message)) for suffix, message in messages]
        with self._last_lock:
            self._last.update(encoded)
        for firm, together in groupby(encoded, key=lambda one: keys.kind_of(one[0]) in _MUST_ARRIVE):
            self._backlog.put(together, firm=firm)

    def _send(self) -> None:
        session = self.reached.session.session
        while session is not None and (messages := self._backlog.take()):
            self._put_out(session, messages)

    def _put_out(self, session: zenoh.Session, messages: Iterable[tuple[str, bytes]]) -> None:
        for suffix, payload in messages:
            must = keys.kind_of(suffix) in _MUST_ARRIVE
            control = zenoh.CongestionControl.BLOCK if must else zenoh.CongestionControl.DROP
            try:
                session.put(f"{self._root}/{suffix}", payload, encoding=_JSON, congestion_control=control)
            except zenoh.ZError as error:
                self._problems.report(suffix, Text(NoticeCode.NOT_PUBLISHED, key=suffix, error=str(error)))
            else:
                self._problems.clear(suffix, NoticeCode.PUBLISHED_AGAIN, key=suffix)

    def _answer(self, query: zenoh.Query) -> None:
        """Reply with the last value of every requested key, or with schemas; called in one of Zenoh's threads."""
        with query:
            if keys.asks_for(keys.SCHEMA, str(query.key_expr)):
                answers = self._schemas
            else:
                with self._last_lock:
                    answers = dict(self._last)
            for suffix, payload in answers.items():
                key = zenoh.KeyExpr(f"{self._root}/{suffix}")
                if query.key_expr.intersects(key):
                    query.reply(key, payload, encoding=_JSON)
