"""Reads every device once per period of its bus. A dead device never takes its neighbours' time for long."""

import asyncio
import logging
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import AsyncExitStack
from dataclasses import dataclass, field, replace
from itertools import count
from types import TracebackType
from typing import Self

from drivers.base import BadAnswer, Bus, ConnectError, Driver, DriverError, Quality, Reading
from gateway.acquisition.pace import Pace
from gateway.acquisition.plausibility import Check, Plausible
from gateway.clock import ServiceClock
from gateway.polling import Breaker, Notify, Periodic, Problems

log = logging.getLogger(__name__)

_CLOSE_LIMIT_S = 5.0
"""Real seconds that closing a bus or device may take."""


@dataclass(frozen=True, slots=True)
class Line:
    """One bus with the drivers of its devices, and the policy for both."""

    bus: Bus
    drivers: tuple[Driver, ...]
    period_s: float = 1.0
    retry_max_periods: int = 60
    read_limit_s: float = 10.0
    """Real seconds that one read may take before the bus is closed and opened again."""
    plausible: Mapping[str, Plausible] = field(default_factory=dict)
    """Stated limits, by channel."""
    phase_s: float = 0.0
    """The polls after the first one come this long after those of a line without."""


Publish = Callable[[Sequence[Reading]], None]
"""Takes the readings of one device; must return at once."""


class _Device:
    """One driver and what is known of it."""

    def __init__(self, driver: Driver, period_s: float, longest_s: float, plausible: Mapping[str, Plausible]) -> None:
        self.driver = driver
        self.breaker = Breaker(period_s, longest_s)
        self.connected = False
        self.cost_s = 0.0
        """Time that its last failure took."""
        self.wavered_s = -math.inf
        """When it last did not answer at once."""
        self.detail = "not asked yet"
        self.units = dict.fromkeys(driver.channels, "")
        self.checks = {name: Check(limits) for name, limits in plausible.items() if name in self.units}

    def checked(self, reading: Reading) -> Reading:
        """The reading after the checks that the configuration states for its channel."""
        check = self.checks.get(reading.channel)
        return reading if check is None else check.judge(reading)


class Runner:
    """Polls the devices of one bus on a drift-free schedule.

    Healthy devices come first, in the order of the configuration; those that wavered lately after the steady ones. Who
    does not answer in the short time that the bus allows one that usually is quick, is asked once more behind all
    others, with all its time, if that fits into the period: an answer that is late for once is no fault, and delays
    nobody. Of the failing ones at most one is asked in vain per period, last, when its breaker allows it and when what
    it may cost still fits; only when put off for the longest wait is it asked regardless.
    """

    def __init__(self, line: Line, clock: ServiceClock, publish: Publish, notify: Notify, sequence: Callable[[], int]):
        self.line = line
        self._clock, self._publish, self._sequence = clock, publish, sequence
        longest_s = line.period_s * line.retry_max_periods
        self._devices = [_Device(driver, line.period_s, longest_s, line.plausible) for driver in line.drivers]
        self._breaker = Breaker(line.period_s, longest_s)
        self._problems = Problems(clock, line.period_s, notify, log)
        self._periodic = Periodic(clock, line.period_s, phase_s=line.phase_s)
        self._pace = Pace(line.period_s)
        self._answered_s: dict[str, float] = {}
        """What each device that answered in this period took."""
        self._unsure: dict[_Device, tuple[Exception, bool]] = {}
        """Who did not answer in this period, and may be asked again; whether it had been steady."""
        self._open = False

    @property
    def missed(self) -> int:
        """Periods that were skipped because the one before took too long."""
        return self._periodic.missed

    async def run(self) -> None:
        """Poll until cancelled; then close the devices and the bus."""
        try:
            await self._periodic.run(self._poll, self._note_pace)
        finally:
            with self._clock.hold():
                await self._shut()

    async def _poll(self, due: float) -> None:
        """One period: read the healthy, try some of the failing, give the others' channels a fault reading."""
        healthy = sorted((d for d in self._devices if not d.breaker.failing), key=self._wavered_lately)
        self._answered_s, self._unsure = {}, {}
        asked = (healthy or self._waiting(due)) and (self._open or await self._open_bus(due))
        if not asked:
            for device in self._devices:
                self._publish_fault(device)
            return
        self._problems.clear(f"bus {self.line.bus.name}", f"bus {self.line.bus.name}: open again")
        waiting = self._waiting(due)
        for device in healthy:
            await self._ask(device, due)
        for device in self._devices:
            if device not in healthy and device not in waiting:
                self._publish_fault(device)
        await self._ask_again(due)
        await self._try_failing(waiting, due)
        if not self._answered_s:
            # Nobody answers: the fault may be the connection itself (half-open TCP, adapter unplugged).
            await self._shut()

    def _wavered_lately(self, device: _Device) -> float:
        """Key of the order in which the healthy are asked: who wavered last is last."""
        return -math.inf if self._steady(device) else device.wavered_s

    def _steady(self, device: _Device) -> bool:
        return self._clock.monotonic() - device.wavered_s >= self._problems.window_s

    def _waiting(self, due: float) -> list[_Device]:
        """Failing devices whose turn it is, the longest waiting first."""
        waiting = [d for d in self._devices if d.breaker.failing and d.breaker.allows(due)]
        return sorted(waiting, key=lambda device: device.breaker.retry_at)

    async def _ask_again(self, due: float) -> None:
        """Who did not answer at once: while it fits into the period, or while they show that they are only late.

        The first of the steady ones is asked in any case: it seldom is, and where a busy computer has used up the time
        it must not fail for that. The order is backwards: the last may have suffered from those before it, whose late
        answers disturbed its own.
        """
        late, first = False, True
        for device, (error, steady) in reversed(self._unsure.items()):
            if late or not self._open or (first and steady) or self._may_cost_s() <= self._left_s(due):
                late, first = await self._ask(device, due, again=True), False
            else:
                await self._failed(device, due, error)

    async def _try_failing(self, waiting: Sequence[_Device], due: float) -> None:
        """Those that fit into what is left of the period, until one does not answer."""
        alone, vain = len(self._devices) == 1, False
        for device in waiting:
            fits = max(device.cost_s, self._may_cost_s()) <= self._left_s(due)
            if not vain and (alone or fits or device.breaker.overdue(due)):
                vain = not await self._ask(device, due, again=True)
            else:
                self._publish_fault(device)

    def _left_s(self, due: float) -> float:
        return due + self.line.period_s - self._clock.monotonic()

    def _may_cost_s(self) -> float:
        """What must be left of the period to ask one that may be silent. Where the timeout is long, half a period."""
        return min(self.line.bus.timeout_s, self.line.period_s / 2)

    async def _open_bus(self, due: float) -> bool:
        if not self._breaker.allows(due):
            return False
        bus = self.line.bus
        try:
            async with asyncio.timeout(self.line.read_limit_s):
                await bus.connect()
        except Exception as error:  # noqa: BLE001 - a driver's bug must not end the other buses
            text = self._text(error, f"bus {bus.name}")
            self._breaker.failed(due)
            self._report(f"bus {bus.name}", "closed", text, error)
            for device in self._devices:
                device.detail = text
            await self._close(bus)
            return False
        self._breaker.succeeded()
        self._open = True
        return True

    async def _ask(self, device: _Device, due: float, *, again: bool = False) -> bool:
        """Read one device, publish what it says. False: it failed, or will be asked again in this period.

        again: it counts as failed when it does not answer now
        """
        if not self._open:  # closed by the one before
            self._publish_fault(device)
            return False
        before = self._clock.monotonic()
        try:
            async with asyncio.timeout(self.line.read_limit_s):
                if not device.connected:
                    await device.driver.connect()
                    device.connected = True
                readings = await device.driver.read()
        except Exception as error:  # noqa: BLE001 - nor this
            now, steady = self._clock.monotonic(), self._steady(device)
            device.cost_s, device.wavered_s = now - before, now
            if not again and self._may_be_late(error):
                self._unsure[device] = error, steady
            else:
                await self._failed(device, due, error)
            return False
        self._answered_s[device.driver.device] = self._clock.monotonic() - before
        device.breaker.succeeded()
        self._problems.clear(f"device {device.driver.device}", f"device {device.driver.device}: answers again")
        number = self._sequence()
        checked = [device.checked(replace(reading, sequence=number)) for reading in readings]
        self._note_qualities(device, checked)
        self._publish(checked)
        return True

    def _may_be_late(self, error: Exception) -> bool:
        """Whether an answer may only be late, or was disturbed by another's late one."""
        return (isinstance(error, DriverError) and error.hurried) or (
            bool(self._unsure) and isinstance(error, BadAnswer)
        )

    async def _failed(self, device: _Device, due: float, error: Exception) -> None:
        subject = f"device {device.driver.device}"
        device.detail = self._text(error, subject)
        self._publish_fault(device)
        device.breaker.failed(due)
        self._report(subject, type(error).__name__, device.detail, error)
        if device.connected:
            device.connected = False
            await self._close(device.driver)
        if isinstance(error, ConnectError | OSError):  # the connection is gone, or a read hangs in it
            for other in self._devices:
                other.detail = device.detail
            await self._shut()

    def _text(self, error: Exception, subject: str) -> str:
        match error:
            case DriverError():
                return str(error)
            case TimeoutError():
                return f"{subject}: did not finish within {self.line.read_limit_s:g} s"
            case _:
                return f"{subject}: unexpected {type(error).__name__}: {error}"

    def _report(self, subject: str, kind: str, text: str, error: Exception) -> None:
        expected = isinstance(error, DriverError | TimeoutError)
        self._problems.report(subject, kind, text, bug=None if expected else error)

    def _note_pace(self, missed: int) -> None:
        """Report when answers take longer than the period."""
        subject = f"period of bus {self.line.bus.name}"
        self._pace.polled(self._answered_s, missed)
        if self._pace.slow:
            self._problems.report(subject, "slow", f"bus {self.line.bus.name}: {self._pace.text()}")
        else:
            self._problems.clear(subject, f"{subject}: the devices answer in time again")

    def _note_qualities(self, device: _Device, readings: Sequence[Reading]) -> None:
        """Report a channel whose quality changed while its device answers."""
        for reading in readings:
            device.units[reading.channel] = reading.unit
            subject, quality = f"channel {reading.channel}", reading.quality.value
            if reading.quality in (Quality.GOOD, Quality.SIMULATED):
                self._problems.clear(subject, f"{subject}: good again")
            else:
                why = f": {reading.detail}" if reading.detail else ""
                self._problems.report(subject, quality, f"{subject}: {quality}{why}")

    def _publish_fault(self, device: _Device) -> None:
        utc, now, number = self._clock.utc(), self._clock.monotonic(), self._sequence()
        self._publish(
            [
                Reading(channel, math.nan, unit, Quality.COMM_FAULT, utc, now, number, device.detail)
                for channel, unit in device.units.items()
            ]
        )

    async def _shut(self) -> None:
        """Close the devices and the bus; what fails in closing is not worth more than a line."""
        for device in self._devices:
            if device.connected:
                device.connected = False
                await self._close(device.driver)
        self._open = False
        await self._close(self.line.bus)

    async def _close(self, what: Bus | Driver) -> None:
        try:
            async with asyncio.timeout(_CLOSE_LIMIT_S):
                await what.close()
        except Exception:
            log.debug("closing %s", what, exc_info=True)


class Acquisition:
    """One runner per bus, as an async context manager: inside, they run; at its end all are stopped and closed.

    A runner that ends by an error of its own ends the whole: the exceptions come out as a group.

    Parameters
    ----------
    lines: buses with their drivers; nothing is opened before the context is entered
    clock: real or simulated
    publish: takes each device's readings
    notify: takes problems as they begin and end
    """

    def __init__(self, lines: Sequence[Line], clock: ServiceClock, publish: Publish, notify: Notify) -> None:
        self._clock, self._publish, self._notify = clock, publish, notify
        self._sequence = count(1).__next__
        self._runners = {line.bus.name: self._runner(line) for line in lines}
        self._stack = AsyncExitStack()
        self._group: asyncio.TaskGroup | None = None
        self._tasks: dict[str, asyncio.Task[None]] = {}

    @property
    def runners(self) -> Mapping[str, Runner]:
        """By the name of the bus."""
        return dict(self._runners)

    def number(self) -> int:
        """The sequence number of a reading that somebody else makes: none occurs twice in a run."""
        return self._sequence()

    async def __aenter__(self) -> Self:
        self._group = await self._stack.enter_async_context(asyncio.TaskGroup())
        for runner in self._runners.values():
            self._start(runner)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool | None:
        for task in self._tasks.values():
            task.cancel()
        return await self._stack.__aexit__(kind, error, trace)

    async def exchange(self, stop: Collection[str], start: Sequence[Line]) -> None:
        """While running: end the runners of some buses, close them, then begin others. The rest notices nothing.

        Stopping comes first, because a new bus may use the port of an old one.
        """
        ending = [self._tasks.pop(name) for name in stop]
        for name in stop:
            del self._runners[name]
        for task in ending:
            task.cancel()
        if ending:
            await asyncio.wait(ending)
        for line in start:
            self._runners[line.bus.name] = self._runner(line)
            self._start(self._runners[line.bus.name])

    def _runner(self, line: Line) -> Runner:
        return Runner(line, self._clock, self._publish, self._notify, self._sequence)

    def _start(self, runner: Runner) -> None:
        if self._group is None:
            raise RuntimeError("the acquisition is not running: enter its context first")
        name = runner.line.bus.name
        self._tasks[name] = self._group.create_task(runner.run(), name=f"bus {name}")
