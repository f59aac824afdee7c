"""The service: builds everything from one configuration, runs it until it is stopped, and leaves nothing behind."""

import asyncio
import logging
from collections.abc import Awaitable, Callable, Mapping, Sequence
from functools import partial

from drivers.tap import Tap
from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.board import Board
from gateway.acquisition.build import lines_of
from gateway.acquisition.quantities import Quantities
from gateway.acquisition.reload import BusChanges, PreparedReload, ReloadError, apply, prepare
from gateway.config.applied import ConfigurationApplied
from gateway.config.model import GatewayConfig
from gateway.control.explaining import Explanations
from gateway.control.grid import GridSampler, Schedule
from gateway.control.loop import GridLoop
from gateway.control.measuring import Measuring
from gateway.control.planned_loads import PlannedLoads
from gateway.control.restart.earlier import EarlierRun
from gateway.control.scenario import Scenarios
from gateway.control.sensor_watch import SensorWatch
from gateway.control.trainer import Trainings
from gateway.model.codes import NoticeCode
from gateway.model.commands import Command, CommandOutcome
from gateway.model.connection import Connection
from gateway.model.events import (
    CompensationStepped,
    DecisionMade,
    EventReported,
    Events,
    OutlookChanged,
    ProbingRequested,
    ReadingsTaken,
    Sink,
    StoreHealth,
    problems_to,
)
from gateway.model.sample import Sample
from gateway.model.text import NOTHING, Text, failure
from gateway.model.wording import event_of
from gateway.nc.build import control_of
from gateway.nc.link import NcLink
from gateway.nc.probing.cycle import NotBegun, number_after
from gateway.nc.probing.schedule import schedule_of
from gateway.nc.settings import Earlier, Identity, LinkSettings, Listeners
from gateway.runtime.ages import Ages
from gateway.runtime.clocks import ServiceClock
from gateway.runtime.parts import WORK_S, Part, Parts
from gateway.service.clock_watch import ClockWatch
from gateway.service.command_taker import CommandTaker
from gateway.service.health import HealthWatch
from gateway.service.store_watch import StoreWatch
from gateway.service.telemetry_watch import TelemetryWatch
from gateway.storage.faults import StoreError
from gateway.telemetry.answers import ScenarioPage
from gateway.telemetry.scenario_queries import ScenarioRequest
from talc.frame import EventKind

log = logging.getLogger(__name__)

_LOOKS_PER_STEP = 60
"""How often the store's health is looked at: each 5 s with a grid of 5 min."""
_SHORTEST_LOOK_S = 1.0
"""With a short grid step not more often than this."""


async def _nothing_to_wait_for() -> None:
    """Waits for nothing, in a service without a store."""


def not_published() -> None:
    """The connection of a telemetry that is off."""


class Service:
    """One gateway: `parts` that run together, `events` that they publish, and the `link` to its control.

    Parameters
    ----------
    config: the checked configuration
    clock: real or simulated
    sink: receives every event
    past: the controller and whatever else an earlier run left
    tap: returns the tap of the bus with that name, or None
    health: of the store that the sink writes to
    identity: under which the control is claimed
    synchronised: whether a time server keeps the clock; None: unknown
    on_disk: returns when what the sink received so far can no longer be lost, or raises StoreError
    reload: reads the configuration again because a command says so; None: there is no file to read
    telemetry: how it is connected; None: it is off
    """

    def __init__(
        self,
        config: GatewayConfig,
        clock: ServiceClock,
        sink: Sink,
        past: EarlierRun,
        tap: Callable[[str], Tap] | None = None,
        health: Callable[[], StoreHealth] = StoreHealth,
        identity: Identity | None = None,
        synchronised: Callable[[], bool | None] = lambda: None,
        on_disk: Callable[[], Awaitable[None]] = _nothing_to_wait_for,
        reload: Callable[["Service"], Awaitable[Text]] | None = None,
        telemetry: Callable[[], Connection | None] = not_published,
    ) -> None:
        self._config, self._clock, self._tap = config, clock, tap
        self.parts = Parts()
        names, step_s = config.input_names, config.grid.step_s
        self.board = Board({c.name: c.period_s for c in config.channels})
        sampler = GridSampler(names, step_s, config.tolerance_state)
        self.events = Events(sink)
        publish, notify = self.events.publish, problems_to(self.events.publish)
        ages = Ages(clock, step_s, past.moment, past.pauses)

        def publish_readings(readings: Sequence[Sample]) -> None:
            publish(ReadingsTaken(readings))

        self._acquisition = Acquisition(
            lines_of(config, clock, tap),
            clock,
            publish_readings,
            notify,
            board=self.board,
            before=(sampler.add,),
            parts=self.parts,
        )

        def stored() -> bool:
            """Whether the compensation may go on as far as the store is concerned."""
            return config.storage.compensate_unstored or health().failing_s <= config.storage.unstored_after_s

        async def requested(number: int) -> None:
            publish(ProbingRequested(number))
            try:
                await on_disk()
            except StoreError as error:  # after a restart the number would be used again
                raise NotBegun(Text(NoticeCode.NUMBER_NOT_STORED, error=failure(error))) from error

        self.link: NcLink | None = None
        if config.nc is not None:
            self.link = NcLink(
                control_of(config.nc, config, clock),
                clock,
                LinkSettings.of(config, identity or Identity()),
                _earlier(past, ages, clock),
                Listeners(sampler.add_states, lambda write: publish(CompensationStepped(write)), notify, requested),
                stored=stored,
            )
        link = self.link
        self._health = HealthWatch(
            step_s, self.board, link, clock, health, synchronised, publish, telemetry, config.machine.name
        )
        self.events.subscribe(DecisionMade, self._health.decided)
        self.events.subscribe(OutlookChanged, self._health.outlook_changed)
        quantities = Quantities({channel.name for channel in config.channels}, self.board, clock)
        sensors = SensorWatch(
            names,
            config.sensor_check,
            step_s,
            quantities.is_temperature,
            publish,
            clock,
            past.seen,
            is_load=quantities.is_load,
        )
        planned = PlannedLoads(
            names,
            step_s,
            {planned.name: planned.loads for planned in config.planned_loads},
            quantities.is_load,
            clock,
            None if past.seen is None else past.seen.frames,
        )

        def remember() -> None:
            """From now on the clock is known to be right, and with it the age of what the earlier run left."""
            if link is not None:
                link.remembered(_measured_s(past, ages), _missing_s(past, ages))

        self._clock_watch = ClockWatch(ages, clock, notify, remember)
        job, wanted = past.pending
        plan = schedule_of(config.probing)
        measuring = Measuring(link, plan, config.probing, clock, publish, wanted, anew=past.renewing)
        self._scenarios = Scenarios(past.controller, planned, step_s)
        explanations = Explanations(past.controller, step_s, clock, publish, planned.changes)
        grid = GridLoop(
            past.controller,
            sampler,
            Schedule(step_s, past.last_k, ages.lead_s),
            clock,
            publish,
            measuring,
            Trainings(past.controller, clock, publish, job),
            ages,
            link,
            (sensors.follow, planned.follow, explanations.follow),
        )
        period_s = max(_SHORTEST_LOOK_S, step_s / _LOOKS_PER_STEP)
        to_others = TelemetryWatch(config.machine.name, telemetry, clock, notify)
        store_watch = StoreWatch(health, config.storage, clock, period_s, notify, publish)
        self._commands = CommandTaker(
            link, measuring, clock, publish, on_disk, None if reload is None else partial(reload, self)
        )
        self.parts.add(
            Part("grid", grid.run, works_s=WORK_S),
            Part("sensors", sensors.run),  # it waits for frames, and gives advice only
            Part("planned loads", planned.run),
            Part("storage", store_watch.run, works_s=WORK_S),
            Part("health", self._health.run, works_s=WORK_S),
            Part("clock", self._clock_watch.run, works_s=WORK_S),
            *((Part("telemetry", to_others.run),) if config.telemetry.enabled else ()),
            *(() if link is None else (Part("nc", link.run, link.stop, WORK_S),)),
        )

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the configuration in use, also after a reload."""
        return self._config.fingerprint()

    def clock_known(self) -> bool:
        """Whether the wall clock is known to be right."""
        return not self._clock_watch.unknown

    def periods_missed(self) -> Mapping[str, int]:
        """Number of periods, by bus since its start, without a read because the previous one took too long."""
        return {name: runner.missed for name, runner in self._acquisition.runners.items()}

    def answers_s(self) -> Mapping[str, Mapping[int, float]]:
        """How long each unit usually takes to answer, s, by bus."""
        return {name: runner.answers_s for name, runner in self._acquisition.runners.items() if runner.answers_s}

    async def prepare(self, config: GatewayConfig) -> PreparedReload:
        """Build what applying another checked configuration needs, and change nothing. Raises ReloadError, SetupError.

        In a thread, because it may import a library.
        """
        return await asyncio.to_thread(prepare, self._config, config, self._clock, self._tap)

    async def reload(self, prepared: PreparedReload) -> BusChanges:
        """Apply another configuration by its differences, while running.

        Raises ReloadError or SetupError when nothing was changed: the service continues unchanged.
        """
        if prepared.old is not self._config:  # another one was applied meanwhile
            prepared = await self.prepare(prepared.new)
        if not self.parts.running:
            raise ReloadError(Text(NoticeCode.RELOAD_NOT_RUNNING))
        change = await apply(self._acquisition, prepared)
        self._config = prepared.new
        self.events.publish(ConfigurationApplied(prepared.new))
        log.info(
            "%s", Text(NoticeCode.CONFIGURATION_RUNS, fingerprint=self.fingerprint[:16], buses=change.started or "none")
        )
        return change

    async def obey(self, command: Command, refused: Text = NOTHING) -> CommandOutcome:
        """Obey a command, or refuse it; see CommandTaker. Raises OSError while the service does not run."""
        if not self.parts.running:
            raise OSError("the gateway is starting or stopping; give the command again")
        outcome = await self._commands.take(command, refused)
        self._health.report()
        return outcome

    async def scenario(self, asked: ScenarioRequest) -> ScenarioPage:
        """What becomes of the estimates under a load that somebody thinks of; see Scenarios."""
        if not self.parts.running:
            raise OSError("the gateway is starting or stopping; ask again")
        return self._scenarios(asked, self._clock.utc())

    def tell(self, text: Text) -> None:
        """Report an event for people."""
        self.events.publish(EventReported(event_of(EventKind.OPERATOR, text), None))

    async def run(self, stop: asyncio.Event) -> None:
        """Run until `stop` is set. Raises an exception group if a part of the service fails."""
        async with self.parts:
            self.events.publish(ConfigurationApplied(self._config))
            await stop.wait()


def _earlier(past: EarlierRun, ages: Ages, clock: ServiceClock) -> Earlier:
    """What an earlier run left, for the link."""
    return Earlier(
        first_number=number_after(past.last_number, clock.utc()),
        abandoned=past.last_number,
        reference_mm=past.reference_mm,
        measured_s=_measured_s(past, ages),
        missing_s=_missing_s(past, ages),
        paused=past.paused,
        disarmed=past.disarmed,
        proven=past.proven,
        paths=past.paths,
    )


def _measured_s(past: EarlierRun, ages: Ages) -> list[float]:
    return [ages.monotonic_of(k) for k in past.measured]


def _missing_s(past: EarlierRun, ages: Ages) -> dict[str, float]:
    return {name: ages.monotonic_of(k) for name, k in past.missing.items()}
