"""`talc-gateway demo --replay`: the last demo's days again in about a minute, for its page, without its machine.

The stored frames go through a fresh controller, as in a replay: what it decides, why, and what it foresees is published
again, and it answers what if. Readings, cycles, offsets and events come from the record.
"""

import asyncio
import math
import os
from collections import deque
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager, suppress
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import Final

import numpy as np

from drivers.base import Quality, Reading
from gateway.config.applied import ConfigurationApplied
from gateway.config.model import GatewayConfig
from gateway.control.explaining import Explanations
from gateway.control.planned_loads import PlannedLoads
from gateway.control.restart.rebuild import start_of
from gateway.control.scenario import Scenarios
from gateway.demo.demo_page import demo_page
from gateway.model.compensation import Source, Step, Write
from gateway.model.control_state import NcState
from gateway.model.events import (
    CompensationStepped,
    DecisionMade,
    EventReported,
    Events,
    FrameMade,
    GatewayEvent,
    Health,
    HealthChecked,
    MeasurementEnded,
    OutlookChanged,
    ReadingsTaken,
    StoreHealth,
)
from gateway.model.probing import End, Outcome, Outlook
from gateway.model.sample import samples
from gateway.model.standing import Standing
from gateway.model.text import Language, language_wanted, plain
from gateway.runtime.extras import lack_of
from gateway.runtime.signals import stop_on_signals
from gateway.runtime.terminal import terminal
from gateway.service.day_reports import DayReports
from gateway.service.stored_answers import course_of, history_of, rows_of
from gateway.storage.configurations import stored_config
from gateway.storage.faults import StoreError
from gateway.storage.history import History
from gateway.storage.store import boot_id
from gateway.storage.stored import StoredCompensation, StoredMeasurement, StoredStep
from gateway.telemetry.answers import ScenarioPage
from gateway.telemetry.publisher import TelemetryPublisher
from gateway.telemetry.scenario_queries import ScenarioRequest
from simulators.clock import SharedClock
from talc.control import Controller
from talc.frame import Frame, Measurement, Why

_LASTS_S: Final = 50.0
"""Of the minute, while the clock runs; it stands still while a step is computed, in all about ten seconds of a core."""
_STATUS_S: Final = 5.0
"""How often the last state is said again, real seconds, until somebody stops it."""


def run_replay(folder: Path, port: int, use: str) -> None:
    """Play it, and then show the last state until a signal. Raises StoreError: there is no demo in this folder.

    port: of 127.0.0.1, where the page listens; use: what the page knows of the machine, TOML
    """
    database = folder / "gateway.sqlite"
    with History(database) as history:
        config = stored_config(history)
        start = start_of(config, history)
        steps = list(history.steps(start.after_k))
        if not steps:
            raise StoreError(f"{database}: contains no frames yet; run talc-gateway demo first")
        record = _Record(config, history)
    asyncio.run(_play(folder, port, use, config, start.controller, steps, record))


class _Record:
    """What is published besides the controller's own, in the order of time."""

    def __init__(self, config: GatewayConfig, history: History) -> None:
        self._channels = frozenset(channel.name for channel in config.channels)
        self._names, self._units = config.input_names, history.units()
        self._mode = config.compensation.mode
        self._cycles = deque(history.measurements())
        self._offsets = deque(history.compensation())
        self._events = deque((at, event) for at, k, event in history.events() if k is None)
        self._numbers = count(1)

    def until(self, step: StoredStep, now: datetime, monotonic_s: float) -> list[GatewayEvent]:
        """What belongs to this step."""
        frame, found = step.frame, list[GatewayEvent]()
        while self._events and self._events[0][0] <= now:
            found.append(EventReported(self._events.popleft()[1], None))
        readings = [
            Reading(name, float(value) if good else math.nan, self._units.get(name, ""),
                    Quality.GOOD if good else Quality.STALE, now, monotonic_s)
            for name, value, good in zip(self._names, frame.inputs.tolist(), frame.valid.tolist(), strict=True)
            if name in self._channels
        ]  # fmt: skip
        found.append(ReadingsTaken(samples(readings, next(self._numbers))))
        while self._cycles and self._cycles[0].ended <= now:
            found.append(MeasurementEnded(_outcome(self._cycles.popleft(), frame.measurement)))
        return found

    def offsets(self, k: int, now: datetime) -> list[GatewayEvent]:
        """What was in force at the end of this step."""
        latest: StoredCompensation | None = None
        while self._offsets and self._offsets[0].time <= now:
            latest = self._offsets.popleft()
        if latest is None or latest.mode not in ("advise", "compensate"):
            return []
        x, y, z = latest.offsets_um.tolist()
        step = Step((x, y, z), (x, y, z), Source(latest.source), (False, False, False))
        return [CompensationStepped(Write(now, self._mode, step, k, {}, latest.written, (x, y, z)))]


def _outcome(cycle: StoredMeasurement, found: Measurement | None) -> Outcome:
    used = found if cycle.errors is not None else None
    end = End.REJECTED if used is None else End.MEASURED
    in_force = tuple(np.atleast_2d(cycle.in_force_um)[0].tolist())
    return Outcome(cycle.number, Why(cycle.why), cycle.asked, cycle.ended, cycle.centres_mm, in_force, used, math.nan,
                   plain(cycle.reason), end)  # fmt: skip


@asynccontextmanager
async def _published(
    config: GatewayConfig, database: Path, clock: SharedClock, port: int, scenarios: Scenarios
) -> AsyncIterator[TelemetryPublisher]:
    async def scenario(asked: ScenarioRequest) -> ScenarioPage:
        return scenarios(asked, clock.utc())

    settings = config.telemetry.model_copy(update={"listen": (f"tcp/127.0.0.1:{port}",), "connect": ()})
    reports = DayReports(database, clock.utc, missing=lack_of("report"))
    publisher = TelemetryPublisher(
        settings, config.machine.name, config.input_names, clock, boot_id(), simulated=True,
        history=history_of(database), course=course_of(database, config.grid.step_s), stored=rows_of(database),
        report=reports, scenario=scenario,
    )  # fmt: skip
    async with publisher:
        try:
            yield publisher
        finally:
            reports.close()


async def _play(
    folder: Path,
    port: int,
    use: str,
    config: GatewayConfig,
    controller: Controller,
    steps: list[StoredStep],
    record: _Record,
) -> None:
    step_s, said, console = config.grid.step_s, Language(language_wanted(os.environ)), terminal()
    first, lasts_s = steps[0].frame.k, (steps[-1].frame.k - steps[0].frame.k + 1) * step_s
    epoch = datetime.fromtimestamp((first - 1) * step_s, UTC)
    clock = SharedClock(folder / "clock", epoch=epoch, speed=max(lasts_s / _LASTS_S, 1.0), owner=True)
    events, stop = Events(), asyncio.Event()
    channels = {channel.name for channel in config.channels}
    loads = {planned.name: planned.loads for planned in config.planned_loads}
    planned = PlannedLoads(config.input_names, step_s, loads, lambda name: name not in channels, clock)
    explanations = Explanations(controller, step_s, clock, events.publish, planned.changes)
    stop_on_signals(stop)
    async with (
        demo_page(folder, port, use) as page,
        _published(config, folder / "gateway.sqlite", clock, port, Scenarios(controller, planned, step_s)) as publisher,
    ):
        line = said("demo.page_absent", why=lack_of("web")) if page is None else await page.line(said)
        console.print(line, highlight=False, soft_wrap=True)
        console.print(said("demo.replaying", hours=lasts_s / 3600.0), highlight=False, soft_wrap=True)
        events.subscribe_to_all(publisher.publish)
        events.publish(ConfigurationApplied(config))
        events.publish(OutlookChanged(Outlook(Standing.NOT_WANTED, None)))  # a measurement ends in the step that asks
        learning = asyncio.create_task(planned.run())
        clock.start()
        try:
            for step in steps:
                due_s = (step.frame.k - first + 1) * step_s
                if not await _before(stop, clock.sleep_until(due_s)):
                    return
                with clock.hold():
                    _publish(step, clock, controller, events, record, (planned.follow, explanations.follow))
                    events.publish(HealthChecked(_health(due_s, step.frame, len(channels))))
            clock.stop()
            while not stop.is_set():
                events.publish(HealthChecked(_health(due_s, steps[-1].frame, len(channels))))
                await _before(stop, asyncio.sleep(_STATUS_S))
        finally:
            learning.cancel()
            with suppress(asyncio.CancelledError):
                await learning
            clock.close()


async def _before(stop: asyncio.Event, wait: Coroutine[object, object, None]) -> bool:
    """Whether it has ended before somebody stops it."""
    waiting, stopping = asyncio.ensure_future(wait), asyncio.ensure_future(stop.wait())
    await asyncio.wait((waiting, stopping), return_when=asyncio.FIRST_COMPLETED)
    for each in (waiting, stopping):
        each.cancel()
    return not stop.is_set()


def _publish(
    step: StoredStep,
    clock: SharedClock,
    controller: Controller,
    events: Events,
    record: _Record,
    followers: tuple[Callable[..., None], ...],
) -> None:
    now = clock.utc()
    for each in record.until(step, now, clock.monotonic()):
        events.publish(each)
    decision = controller.step(step.frame)
    for models in step.adopted:
        controller.adopt(models)
    events.publish(FrameMade(step.frame))
    events.publish(DecisionMade(decision))
    for event in decision.events:
        events.publish(EventReported(event, decision.k))
    for each in record.offsets(step.frame.k, now):
        events.publish(each)
    for follow in followers:
        follow(step.frame, decision)


def _health(uptime_s: float, frame: Frame, channels: int) -> Health:
    good = int(frame.valid[:channels].sum())
    return Health(uptime_s, channels, good, NcState.READY, None, (), StoreHealth())
