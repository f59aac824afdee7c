"""Reads every device of one bus once per period. A silent device never delays its neighbours for long."""

import logging
import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from drivers.base import BadAnswer, Busy, ConnectError, DriverError, NoAnswer, Reading
from gateway.acquisition.bus import PolledBus
from gateway.acquisition.device import PolledDevice
from gateway.acquisition.line import Line
from gateway.acquisition.reports import LineReports
from gateway.model.notice import Notify
from gateway.model.sample import Sample, samples
from gateway.runtime.clocks import ServiceClock
from gateway.runtime.periodic import Periodic
from gateway.runtime.problems import Problems

log = logging.getLogger(__name__)

Publish = Callable[[Sequence[Sample]], None]
"""Receives the readings of one device; must return at once."""


_MOST_SILENT = 4
"""How often a device is asked in one period while it stays silent."""
_SILENT_OFTEN = 3
"""In how many such periods before it is asked once only."""
_MOST_HEARD = 8
"""How often one is asked that is heard, or was in the last period, where asking costs only what is left of it."""
_FEW = 2
"""How often one is asked that was heard and could not be read."""
_LOST_OFTEN = 3
"""In how many periods without a read before that."""
_SHORTEST_S = 0.05
"""The shortest wait for an answer that is worthwhile, where it can be limited to the rest of the period."""
_RESERVE_S = 0.05
"""The part of the period that is reserved for such an answer to arrive."""


_LEARNS_S = 10.0
"""How long devices are read again and again to find out how they want to be asked."""


@dataclass(slots=True)
class _Unsure:
    """A device that did not answer in this period and may be asked again."""

    device: PolledDevice
    error: Exception
    steady: bool
    """Whether it had answered promptly for a long time."""
    asks: int = 1
    """How often it has been asked in this period."""


class BusRunner:
    """Polls the devices of one bus on a drift-free schedule.

    Healthy devices come first, in the order of the configuration; those that failed recently come after the steady
    ones. One that does not answer, or whose answer is damaged, is asked again after all others, as often as fits into
    the period: neither a late nor a damaged answer is a fault, and neither delays another device. A device that is
    heard is not dead: it is asked in every period. One that stays silent is asked less and less often; at most one of
    those per period is asked in vain: last, when its breaker allows it and its possible cost still fits. After the
    longest wait it is asked in any case. At the very end, one device that leaves only a part of its requests unanswered
    may be asked for that part: this delays nobody.
    """

    def __init__(
        self,
        line: Line,
        clock: ServiceClock,
        publish: Publish,
        notify: Notify,
        sequence: Callable[[], int],
        *,
        before: Sequence[Publish] = (),
        quiet: bool = False,
    ) -> None:
        self.line = line
        self.devices = tuple(PolledDevice(driver, line, clock) for driver in line.drivers)
        self._clock, self._takers, self._sequence = clock, (*before, publish), sequence
        self._bus = PolledBus(line)
        self._reserve_s = min(_RESERVE_S, line.period_s / 10) if self._bus.is_limited else 0.0
        problems = Problems(clock, line.period_s, notify, log, quiet=quiet)
        self._steady_s = problems.window_s
        self._reports = LineReports(line, problems)
        self._periodic = Periodic(clock, line.period_s, phase_s=line.phase_s)
        self._answered_s: dict[str, float] = {}
        """How long each device that answered in this period took."""
        self._unsure: deque[_Unsure] = deque()
        """Devices that did not answer in this period and may be asked again."""

    @property
    def missed(self) -> int:
        """Periods skipped because the previous one took too long."""
        return self._periodic.missed

    @property
    def answers_s(self) -> Mapping[int, float]:
        """How long each unit usually takes to answer, s, where the bus finds it out."""
        return self._reports.answers_s

    async def run(self) -> None:
        """Poll until cancelled; then close the devices and the bus."""
        try:
            with self._clock.hold():
                await self._greet()
            await self._periodic.run(self._poll, lambda missed: self._reports.polled(self._answered_s, missed))
        finally:
            with self._clock.hold():
                await self.close()

    async def once(self) -> None:
        """Read every device once, each with its full time, whatever happened to the previous one. Closes nothing."""
        due = self._clock.monotonic()
        for device in self.devices:
            device.heard = False
            if self._bus.is_open or await self._open_bus(due):
                await self._ask(device, due)
                while self._unsure:  # it was heard, or usually answers quickly
                    await self._ask_once_more(self._unsure.popleft(), due)
            else:
                self._publish_fault(device)

    def may_learn(self, since_s: float) -> bool:
        """After `once`, the first at `since_s`: whether its bus may find out more about a device that was not read."""
        now_s = self._clock.monotonic()
        if not self._bus.learns or not any(isinstance(device.error, NoAnswer | Busy) for device in self.devices):
            return False
        return self._bus.settles(now_s) or (
            any(device.heard for device in self.devices) and now_s - since_s < _LEARNS_S
        )

    async def _greet(self) -> None:
        """Before the first period, connect the devices: nobody knows yet how long one takes, so one that is silent
        costs its full time. Then it would come between the first readings of the others."""
        began_s = self._clock.monotonic()
        if not await self._open_bus(began_s) or len(self.devices) == 1:
            return
        for device in self.devices:
            try:
                await device.greet()
                self._bus.heard()
            except MemoryError:
                raise
            except Exception as error:  # noqa: BLE001 - a driver's bug must not end the other buses
                if not self._may_be_asked_again(device, error):
                    await self._failed(device, began_s, error)
            if not self._bus.is_open:
                return

    async def _poll(self, due: float) -> None:
        """One period: read healthy devices, try some failing ones, give the channels of the rest a fault reading."""
        healthy = sorted((d for d in self.devices if not d.breaker.failing), key=self._wavered_lately)
        self._answered_s = {}
        self._unsure.clear()
        for device in self.devices:
            device.heard = False
        is_due = healthy or self._bus.was_mute or self._waiting(due)
        asked = is_due and (self._bus.is_open or await self._open_bus(due))
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
        await self._ask_later(due)
        if any(device.heard for device in self.devices):
            self._bus.heard()
        elif not self._bus.settles(due) and all(device.breaker.failing for device in self.devices):
            # No device answers: the connection itself may be at fault (half-open TCP, adapter unplugged).
            self._bus.was_mute = not self._bus.answers
            await self.close()
        await self._bus.end_period()

    def _wavered_lately(self, device: PolledDevice) -> float:
        """Sort key of the healthy devices: the one that failed most recently is asked last."""
        return -math.inf if self._steady(device) else device.wavered_s

    def _steady(self, device: PolledDevice) -> bool:
        return self._clock.monotonic() - device.wavered_s >= self._steady_s

    def _waiting(self, due: float) -> list[PolledDevice]:
        """Failing devices that are due, the longest waiting first; on a connection without an answer yet all are."""
        is_new = self._bus.is_open and not self._bus.answers
        waiting = [d for d in self.devices if d.breaker.failing and (is_new or d.breaker.allows(due))]
        return sorted(waiting, key=lambda device: device.breaker.retry_at)

    async def _ask_again(self, due: float) -> None:
        """Ask again the devices that did not answer, while it fits into the period or their answers are only late.

        The first steady device is asked in any case: this is rare, and it must not fail because a busy computer has
        used up the time. They are asked in reverse order: late answers of earlier devices may have disturbed those of
        the last.
        """
        self._unsure.reverse()
        late, first = False, True
        while self._unsure:
            unsure = self._unsure.popleft()
            rest_s = self._left_s(due) - self._reserve_s
            fits = self._least_s(unsure.device) <= rest_s
            if self._bus.is_open and (fits or (unsure.asks == 1 and (late or (first and unsure.steady)))):
                within_s = rest_s if fits else math.inf
                late |= await self._ask_once_more(unsure, due, within_s) or unsure.device.heard
                first = False
            else:
                await self._failed(unsure.device, due, unsure.error)

    async def _try_failing(self, waiting: Sequence[PolledDevice], due: float) -> None:
        """Ask those that fit into the rest of the period, until one does not answer."""
        alone, vain = len(self.devices) == 1, False
        for device in waiting:
            left_s = self._left_s(due)
            may_cost = alone or max(device.cost_s, self._may_cost_s(device)) <= left_s or device.breaker.overdue(due)
            within_s = math.inf if may_cost else left_s - self._reserve_s
            if not vain and (may_cost or (self._bus.is_limited and within_s >= _SHORTEST_S)):
                silent = not device.ever_answered or device.silent >= _SILENT_OFTEN
                vain = not await self._ask(device, due, last=silent, within_s=within_s)
            else:
                self._publish_fault(device)
        await self._ask_again(due)

    async def _ask_later(self, due: float) -> None:
        """Let one device that is silent for a part of it be asked for that, if it fits into the rest of the period."""
        rest_s = self._left_s(due) - self._reserve_s
        for device in self.devices if self._bus.is_open else ():
            try:
                if device.asks_later and self._may_cost_s(device) <= rest_s:
                    with self._bus.limited(rest_s):
                        await device.ask_later()
                    return
            except MemoryError:
                raise
            except (DriverError, OSError, TimeoutError):
                return  # the next read says what is wrong
            except Exception as error:  # noqa: BLE001 - a driver's bug must not end the other buses
                self._reports.failed(device.subject, error)

    def _left_s(self, due: float) -> float:
        return due + self.line.period_s - self._clock.monotonic()

    def _may_cost_s(self, device: PolledDevice) -> float:
        """Time that must remain in the period to ask a device. A possibly silent one may cost the timeout, or half of
        the period if that is long; one that was heard costs twice as much as the last time, or as much if that is
        longer."""
        longest_s = min(self.line.bus.timeout_s, self.line.period_s / 2)
        return min(2 * device.cost_s, max(longest_s, device.cost_s)) if device.heard else longest_s

    def _least_s(self, device: PolledDevice) -> float:
        """Time that must remain in the period to ask a device again."""
        may_cost_s = self._may_cost_s(device)
        return min(_SHORTEST_S, may_cost_s) if self._bus.is_limited else may_cost_s

    async def _open_bus(self, due: float) -> bool:
        if not self._bus.breaker.allows(due):
            return False
        try:
            await self._bus.open(self._clock.monotonic())
        except MemoryError:
            raise
        except Exception as error:  # noqa: BLE001 - a driver's bug must not end the other buses
            self._bus.breaker.failed(due)
            text = self._reports.failed(self._bus.subject, error, "closed")
            for device in self.devices:
                device.detail = text
            return False
        if self._bus.was_mute:
            self._bus.breaker.failed(due)
        else:
            self._bus.breaker.succeeded()
        return True

    async def _ask(self, device: PolledDevice, due: float, *, last: bool = False, within_s: float = math.inf) -> bool:
        """Read one device and publish the result. False: it failed, or may be asked again in this period.

        last: it is not asked again in this period
        within_s: how long it may take, if the bus can limit it
        """
        if not self._bus.is_open:  # closed after the previous device failed
            self._publish_fault(device)
            return False
        steady = self._steady(device)
        error = await self._read(device, due, within_s=within_s)
        if error is not None:
            if (last and not device.heard) or not self._may_be_asked_again(device, error):
                await self._failed(device, due, error)
            else:
                self._unsure.append(_Unsure(device, error, steady))
        return error is None

    async def _ask_once_more(self, unsure: _Unsure, due: float, within_s: float = math.inf) -> bool:
        """The same for a device that may answer this time, within `within_s`; otherwise it may be asked again."""
        error = await self._read(unsure.device, due, again=True, within_s=within_s)
        if error is not None:
            unsure.asks += 1
            if not (isinstance(unsure.error, DriverError) and not unsure.error.hurried):
                unsure.error = error  # the first that was given the full time says best what is wrong
            if not isinstance(error, NoAnswer | BadAnswer | Busy):
                await self._failed(unsure.device, due, error)
            elif self._in_vain(unsure, error):
                await self._failed(unsure.device, due, unsure.error)
            else:
                self._unsure.append(unsure)
        return error is None

    async def _read(
        self, device: PolledDevice, due: float, *, again: bool = False, within_s: float = math.inf
    ) -> Exception | None:
        """Read one device and publish its readings; otherwise returns why it could not be read."""
        try:
            with self._bus.limited(within_s):
                readings = await device.read(again=again)
        except MemoryError:
            raise
        except Exception as error:  # noqa: BLE001 - likewise
            # While another one is late, it may only suffer from that, and comes before it.
            device.wavered_s = due if self._unsure else self._clock.monotonic()
            return error
        if device.answered_s is not None:
            self._answered_s[device.driver.device] = device.answered_s
        self._bus.heard()
        device.breaker.succeeded()
        self._reports.answered(device.subject, readings)
        self._publish(readings)
        return None

    def _may_be_asked_again(self, device: PolledDevice, error: Exception) -> bool:
        """Whether its answer may only be late, lost or damaged."""
        match error:
            case NoAnswer():
                return error.hurried or device.heard or device.ever_answered or len(self.devices) == 1
            case BadAnswer() | Busy():
                return True
            case _:
                return False

    async def _failed(self, device: PolledDevice, due: float, error: Exception) -> None:
        device.detail = self._reports.failed(device.subject, error)
        self._publish_fault(device)
        lost = isinstance(error, ConnectError | OSError)  # the connection, or a read hangs on it
        # Alone on its bus, one that was given less than its full time delays nobody if it is asked on.
        hurried = len(self.devices) == 1 and isinstance(error, DriverError) and error.hurried and not device.silent
        if (device.heard or hurried) and not lost:
            device.lost, device.silent = device.lost + 1, 0
            device.breaker.succeeded()
            return
        device.silent += 1
        if device.breaker.allows(due):  # else it was asked early, as the connection is new
            device.breaker.failed(due)
        await device.close()
        if lost:
            for other in self.devices:
                other.detail = device.detail
            await self.close()

    def _in_vain(self, unsure: _Unsure, error: Exception) -> bool:
        """Whether it need not be asked again in this period. error: of the last time"""
        device = unsure.device
        if device.heard or (self._bus.is_limited and device.ever_answered and not device.silent):
            is_late = isinstance(error, NoAnswer)  # it makes progress
            return unsure.asks >= (_MOST_HEARD if is_late or device.lost < _LOST_OFTEN else _FEW)
        return unsure.asks >= _MOST_SILENT

    def _publish_fault(self, device: PolledDevice) -> None:
        self._publish(device.fault())

    def _publish(self, readings: Sequence[Reading]) -> None:
        taken = samples(readings, self._sequence())
        for take in self._takers:
            take(taken)

    async def close(self) -> None:
        """Close the devices and the bus."""
        await self.close_devices()
        await self._bus.close()

    async def close_devices(self) -> None:
        """The bus stays open."""
        for device in self.devices:
            await device.close()
