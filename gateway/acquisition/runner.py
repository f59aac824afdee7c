"""Reads every device of one bus once per period. A silent device never delays its neighbours for long."""

import logging
import math
from collections.abc import Callable, Sequence

from drivers.base import BadAnswer, ConnectError, DriverError
from gateway.acquisition.bus import PolledBus
from gateway.acquisition.device import PolledDevice
from gateway.acquisition.line import Line
from gateway.acquisition.reports import LineReports
from gateway.acquisition.sample import Sample, samples
from gateway.clock import ServiceClock
from gateway.polling import Notify, Periodic, Problems

log = logging.getLogger(__name__)

Publish = Callable[[Sequence[Sample]], None]
"""Receives the readings of one device; must return at once."""


class BusRunner:
    """Polls the devices of one bus on a drift-free schedule.

    Healthy devices come first, in the order of the configuration; those that failed recently come after the steady
    ones. A usually quick device that does not answer within the short time allowed is asked once more, after all others
    and with the full timeout, if that fits into the period: a single late answer is not a fault and delays no other
    device. At most one failing device per period is asked in vain: last, when its breaker allows it and its possible
    cost still fits. After the longest wait it is asked in any case.
    """

    def __init__(
        self,
        line: Line,
        clock: ServiceClock,
        publish: Publish,
        notify: Notify,
        sequence: Callable[[], int],
        *,
        quiet: bool = False,
    ) -> None:
        self.line = line
        self.devices = tuple(PolledDevice(driver, line, clock) for driver in line.drivers)
        self._clock, self._publish, self._sequence = clock, publish, sequence
        self._bus = PolledBus(line)
        problems = Problems(clock, line.period_s, notify, log, quiet=quiet)
        self._steady_s = problems.window_s
        self._reports = LineReports(line, problems)
        self._periodic = Periodic(clock, line.period_s, phase_s=line.phase_s)
        self._answered_s: dict[str, float] = {}
        """How long each device that answered in this period took."""
        self._unsure: dict[PolledDevice, tuple[Exception, bool]] = {}
        """Devices that did not answer in this period and may be asked again, and whether each had been steady."""

    @property
    def missed(self) -> int:
        """Periods skipped because the previous one took too long."""
        return self._periodic.missed

    async def run(self) -> None:
        """Poll until cancelled; then close the devices and the bus."""
        try:
            await self._periodic.run(self._poll, lambda missed: self._reports.polled(self._answered_s, missed))
        finally:
            with self._clock.hold():
                await self.close()

    async def once(self) -> None:
        """Read every device once, each with its full time, whatever happened to the previous one. Closes nothing."""
        due = self._clock.monotonic()
        for device in self.devices:
            if self._bus.is_open or await self._open_bus(due):
                await self._ask(device, due, again=True)
            else:
                self._publish_fault(device)

    async def _poll(self, due: float) -> None:
        """One period: read healthy devices, try some failing ones, give the channels of the rest a fault reading."""
        healthy = sorted((d for d in self.devices if not d.breaker.failing), key=self._wavered_lately)
        self._answered_s, self._unsure = {}, {}
        asked = (healthy or self._waiting(due)) and (self._bus.is_open or await self._open_bus(due))
        if not asked:
            for device in self.devices:
                self._publish_fault(device)
            return
        self._reports.opened(self._bus.subject)
        waiting = self._waiting(due)
        for device in healthy:
            await self._ask(device, due)
        for device in self.devices:
            if device not in healthy and device not in waiting:
                self._publish_fault(device)
        await self._ask_again(due)
        await self._try_failing(waiting, due)
        if not self._answered_s:
            # No device answers: the connection itself may be at fault (half-open TCP, adapter unplugged).
            await self.close()

    def _wavered_lately(self, device: PolledDevice) -> float:
        """Sort key of the healthy devices: the one that failed most recently is asked last."""
        return -math.inf if self._steady(device) else device.wavered_s

    def _steady(self, device: PolledDevice) -> bool:
        return self._clock.monotonic() - device.wavered_s >= self._steady_s

    def _waiting(self, due: float) -> list[PolledDevice]:
        """Failing devices that are due, the longest waiting first."""
        waiting = [d for d in self.devices if d.breaker.failing and d.breaker.allows(due)]
        return sorted(waiting, key=lambda device: device.breaker.retry_at)

    async def _ask_again(self, due: float) -> None:
        """Ask again the devices that did not answer, while it fits into the period or their answers are only late.

        The first steady device is asked in any case: this is rare, and it must not fail because a busy computer has
        used up the time. They are asked in reverse order: late answers of earlier devices may have disturbed those of
        the last.
        """
        late, first = False, True
        for device, (error, steady) in reversed(self._unsure.items()):
            if late or not self._bus.is_open or (first and steady) or self._may_cost_s() <= self._left_s(due):
                late, first = await self._ask(device, due, again=True), False
            else:
                await self._failed(device, due, error)

    async def _try_failing(self, waiting: Sequence[PolledDevice], due: float) -> None:
        """Ask those that fit into the rest of the period, until one does not answer."""
        alone, vain = len(self.devices) == 1, False
        for device in waiting:
            fits = max(device.cost_s, self._may_cost_s()) <= self._left_s(due)
            if not vain and (alone or fits or device.breaker.overdue(due)):
                vain = not await self._ask(device, due, again=True)
            else:
                self._publish_fault(device)

    def _left_s(self, due: float) -> float:
        return due + self.line.period_s - self._clock.monotonic()

    def _may_cost_s(self) -> float:
        """Time that must remain in the period to ask a possibly silent device; half a period if the timeout is long."""
        return min(self.line.bus.timeout_s, self.line.period_s / 2)

    async def _open_bus(self, due: float) -> bool:
        if not self._bus.breaker.allows(due):
            return False
        try:
            await self._bus.open()
        except MemoryError:
            raise
        except Exception as error:  # noqa: BLE001 - a driver's bug must not end the other buses
            self._bus.breaker.failed(due)
            text = self._reports.failed(self._bus.subject, error, "closed")
            for device in self.devices:
                device.detail = text
            return False
        self._bus.breaker.succeeded()
        return True

    async def _ask(self, device: PolledDevice, due: float, *, again: bool = False) -> bool:
        """Read one device and publish the result. False: it failed, or will be asked again in this period.

        again: a device that does not answer this time counts as failed
        """
        if not self._bus.is_open:  # closed after the previous device failed
            self._publish_fault(device)
            return False
        try:
            readings = await device.read()
        except MemoryError:
            raise
        except Exception as error:  # noqa: BLE001 - likewise
            steady, device.wavered_s = self._steady(device), self._clock.monotonic()
            if not again and self._may_be_late(error):
                self._unsure[device] = error, steady
            else:
                await self._failed(device, due, error)
            return False
        if device.answered_s is not None:
            self._answered_s[device.driver.device] = device.answered_s
        device.breaker.succeeded()
        self._reports.answered(device.subject, readings)
        self._publish(samples(readings, self._sequence()))
        return True

    def _may_be_late(self, error: Exception) -> bool:
        """Whether an answer may only be late, or was disturbed by another device's late one."""
        return (isinstance(error, DriverError) and error.hurried) or (
            bool(self._unsure) and isinstance(error, BadAnswer)
        )

    async def _failed(self, device: PolledDevice, due: float, error: Exception) -> None:
        device.breaker.failed(due)
        device.detail = self._reports.failed(device.subject, error)
        self._publish_fault(device)
        await device.close()
        if isinstance(error, ConnectError | OSError):  # the connection is lost, or a read hangs on it
            for other in self.devices:
                other.detail = device.detail
            await self.close()

    def _publish_fault(self, device: PolledDevice) -> None:
        self._publish(samples(device.fault(), self._sequence()))

    async def close(self) -> None:
        """Close the devices and the bus."""
        await self.close_devices()
        await self._bus.close()

    async def close_devices(self) -> None:
        """The bus stays open."""
        for device in self.devices:
            await device.close()
