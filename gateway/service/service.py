"""The service: builds everything from one configuration, runs it until it is stopped, and leaves nothing behind."""

import asyncio
import logging
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import AsyncExitStack

from drivers.tap import Tap
from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.board import Board
from gateway.acquisition.build import lines_of
from gateway.acquisition.line import Line
from gateway.acquisition.reload import BusChanges, PreparedReload, ReloadError, apply, prepare
from gateway.config.applied import ConfigurationApplied
from gateway.config.model import GatewayConfig
from gateway.control.explaining import Explanations
from gateway.control.grid import GridSampler, Schedule
from gateway.control.loop import GridLoop
from gateway.control.measuring import Measuring
from gateway.control.planned_loads import PlannedLoads
from gateway.control.restart.earlier import Past
from gateway.control.sensor_watch import SensorWatch
from gateway.control.trainer import Trainings
from gateway.model.commands import Command, CommandOutcome
from gateway.model.events import (
    CompensationStepped,
    EventReported,
    ProbingRequested,
    ReadingsTaken,
    Sink,
    StoreHealth,
    in_order,
    problem_event,
)
from gateway.model.sample import Sample
from gateway.nc.build import control_of
from gateway.nc.link import NcLink
from gateway.nc.probing.cycle import NotBegun, number_after
from gateway.nc.probing.schedule import schedule_of
from gateway.nc.settings import Earlier, Identity, LinkSettings, Listeners
from gateway.runtime.ages import Ages
from gateway.runtime.clocks import ServiceClock
from gateway.runtime.problems import Notice
from gateway.service.clock_watch import ClockWatch
from gateway.service.command_taker import AskReload, CommandTaker
from gateway.service.health import HealthWatch
from gateway.service.store_watch import StoreWatch
from gateway.storage.faults import StoreError
from talc.frame import Decision, Event, EventKind, FloatArray, Frame, TrainingJob, Why

log = logging.getLogger(__name__)

_LOOKS_PER_STEP, _SHORTEST_LOOK_S = 60, 1.0
"""How often the store's health is looked at: each 5 s with a grid of 5 min."""

_TEMPERATURE = "degC"
_LOADS = frozenset({"1/min", "mm/s", "m/s", "%", "W", "kW", "A", "Nm"})
"""Units of what heats a machine: speeds, shares of a rated load, powers, currents, torques."""


async def _nothing_to_wait_for() -> None:
    """Waits for nothing, in a service without a store."""


class Service:
    """One gateway.

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
    """

    def __init__(
        self,
        config: GatewayConfig,
        clock: ServiceClock,
        sink: Sink,
        past: Past,
        tap: Callable[[str], Tap] | None = None,
        health: Callable[[], StoreHealth] = StoreHealth,
        identity: Identity | None = None,
        synchronised: Callable[[], bool | None] = lambda: None,
        on_disk: Callable[[], Awaitable[None]] = _nothing_to_wait_for,
    ) -> None:
        self._config, self._clock, self._past = config, clock, past
        self._tap, self._health, self._identity = tap, health, identity or Identity()
        self._on_disk = on_disk
        self._sampler = GridSampler(config.input_names, config.grid.step_s)
        self._ages = Ages(clock, config.grid.step_s, past.moment, past.pauses)
        lead_s = 0.0 if past.moment is None else past.moment.lead_s
        self._schedule = Schedule(config.grid.step_s, past.last_k, lead_s)
        self._channels = {channel.name for channel in config.channels}
        self.board = Board({c.name: c.period_s for c in config.channels})
        self._health_watch = HealthWatch(
            config.grid.step_s, self.board, lambda: self.link, clock, health, synchronised, sink
        )
        self._sink = in_order((sink, self._health_watch.take))
        self._lines: tuple[Line, ...] = lines_of(config, clock, tap)
        self.link = self._make_link()
        self._sensors = SensorWatch(
            config.input_names,
            config.sensor_check,
            config.grid.step_s,
            self._is_temperature,
            sink,
            clock,
            past.seen,
            is_load=self._is_load,
        )
        self._planned = PlannedLoads(
            config.input_names,
            config.grid.step_s,
            {planned.name: planned.loads for planned in config.planned_loads},
            self._is_load,
            clock,
            None if past.seen is None else past.seen.frames,
        )
        self._acquisition: Acquisition | None = None
        self._clock_watch = ClockWatch(self._ages, clock, self._noticed, self._remember)
        job, wanted = past.pending
        self._measuring = self._make_measuring(wanted)
        self._grid = self._loop(job)
        self._commands = CommandTaker(self.link, self._measuring.order, clock, self._sink, on_disk)

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the configuration in use, also after a reload."""
        return self._config.fingerprint()

    @property
    def clock_known(self) -> bool:
        """Whether the wall clock is known to be right."""
        return not self._clock_watch.unknown

    @property
    def periods_missed(self) -> Mapping[str, int]:
        """Number of periods, by bus since its start, without a read because the previous one took too long."""
        runners = {} if self._acquisition is None else self._acquisition.runners
        return {name: runner.missed for name, runner in runners.items()}

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
        acquisition = self._acquisition
        if acquisition is None:
            raise ReloadError("the service is not running")
        change = await apply(acquisition, prepared)
        self._config = prepared.new
        self._sink(ConfigurationApplied(prepared.new))
        log.info(
            "configuration %s runs; buses exchanged: %s", self.fingerprint[:16], ", ".join(change.started) or "none"
        )
        return change

    async def obey(self, command: Command, refused: str = "") -> CommandOutcome:
        """Obey a command, or refuse it; see CommandTaker. Raises OSError while the service does not run."""
        if self._acquisition is None:
            raise OSError("the gateway is starting or stopping; give the command again")
        outcome = await self._commands.take(command, refused)
        self._health_watch.report()
        return outcome

    def take_reloads(self, reload: AskReload) -> None:
        """Set what reads the configuration again when a command says so."""
        self._commands.reload = reload

    def tell(self, text: str) -> None:
        """Report an event for people."""
        self._sink(EventReported(Event(EventKind.OPERATOR, text), None))

    async def run(self, stop: asyncio.Event) -> None:
        """Run until `stop` is set. Raises an exception group if a part of the service fails."""
        async with AsyncExitStack() as stack:
            if self.link is not None:
                stack.push_async_callback(self.link.stop)
            acquisition = await stack.enter_async_context(
                Acquisition(self._lines, self._clock, self._take, self._noticed, board=self.board)
            )
            self._acquisition = acquisition
            stack.callback(self._forget_acquisition)
            self._sink(ConfigurationApplied(self._config))
            async with asyncio.TaskGroup() as tasks:
                running = [
                    tasks.create_task(self._grid.run(), name="grid"),
                    tasks.create_task(self._sensors.run(), name="sensors"),
                    tasks.create_task(self._planned.run(), name="planned loads"),
                    tasks.create_task(self._store_watch().run(), name="storage"),
                    tasks.create_task(self._health_watch.run(), name="health"),
                    tasks.create_task(self._clock_watch.run(), name="clock"),
                ]
                if self.link is not None:
                    running.append(tasks.create_task(self.link.run(), name="nc"))
                await stop.wait()
                for task in running:
                    task.cancel()

    def _forget_acquisition(self) -> None:
        self._acquisition = None

    def _make_measuring(self, wanted: Why | None) -> Measuring:
        probing = self._config.probing
        return Measuring(self.link, schedule_of(probing), probing, self._clock, self._sink, wanted)

    def _loop(self, job: TrainingJob | None) -> GridLoop:
        controller, clock, sink = self._past.controller, self._clock, self._sink
        explanations = Explanations(controller, self._config.grid.step_s, clock, sink, self._planned.changes)
        return GridLoop(
            controller,
            self._sampler,
            self._schedule,
            clock,
            sink,
            self._measuring,
            Trainings(controller, clock, sink, job),
            self._ages,
            [self._follow, self._seen, explanations.follow],
            self._renew,
        )

    def _make_link(self) -> NcLink | None:
        config = self._config
        if config.nc is None:
            return None
        return NcLink(
            control_of(config.nc, config, self._clock),
            self._clock,
            LinkSettings.of(config, self._identity),
            Earlier(
                first_number=number_after(self._past.last_number, self._clock.utc()),
                abandoned=self._past.last_number,
                reference_mm=self._past.reference_mm,
                measured_s=self._measured_s(),
                missing_s=self._missing_s(),
                paused=self._past.paused,
                disarmed=self._past.disarmed,
                proven=self._past.proven,
            ),
            Listeners(
                states=self._sampler.add_states,
                written=lambda write: self._sink(CompensationStepped(write)),
                notify=self._noticed,
                requested=self._request,
            ),
            stored=self._stored,
        )

    def _store_watch(self) -> StoreWatch:
        period_s = max(_SHORTEST_LOOK_S, self._config.grid.step_s / _LOOKS_PER_STEP)
        return StoreWatch(self._health, self._config.storage, self._clock, period_s, self._noticed, self._sink)

    def _stored(self) -> bool:
        """Whether the compensation may go on as far as the store is concerned."""
        storage = self._config.storage
        return storage.compensate_unstored or self._health().failing_s <= storage.unstored_after_s

    async def _request(self, number: int) -> None:
        self._sink(ProbingRequested(number))
        try:
            await self._on_disk()
        except StoreError as error:  # after a restart the number would be used again
            raise NotBegun(f"its number cannot be stored: {error}") from error

    def _measured_s(self) -> list[float]:
        return [self._ages.monotonic_of(k) for k in self._past.measured]

    def _missing_s(self) -> dict[str, float]:
        return {name: self._ages.monotonic_of(k) for name, k in self._past.missing.items()}

    def _remember(self) -> None:
        """From now on the clock is known to be right, and with it the age of everything that the earlier run left."""
        if self.link is not None:
            self.link.remembered(self._measured_s(), self._missing_s())

    def _follow(self, _: Frame, decision: Decision) -> None:
        if self.link is not None:
            self.link.follow(decision)

    def _renew(self, corrected: FloatArray) -> None:
        if self.link is not None:
            self.link.renew(corrected)

    def _seen(self, frame: Frame, _: Decision) -> None:
        self._sensors.frame(frame)
        self._planned.frame(frame)

    def _is_temperature(self, name: str) -> bool:
        return self._unit(name) == _TEMPERATURE

    def _is_load(self, name: str) -> bool:
        """A machine state, or a channel that tells a speed, power, current, torque or share of a load."""
        return name not in self._channels or self._unit(name) in _LOADS

    def _unit(self, name: str) -> str | None:
        aged = self.board.latest(name, self._clock.monotonic()) if name in self._channels else None
        return None if aged is None else aged.reading.unit

    def _take(self, readings: Sequence[Sample]) -> None:
        self._sampler.add(readings)
        self._sink(ReadingsTaken(readings))

    def _noticed(self, notice: Notice) -> None:
        self._sink(EventReported(problem_event(notice), None))
