"""A scripted bus with scripted devices, on stepped time, with an acquisition that reads them."""

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import NoReturn

from drivers.base import NoAnswer, Quality, Reading
from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.line import Line
from gateway.config.sections import Limits
from gateway.model.notice import Notice
from gateway.model.sample import Sample
from tests.benches.stepped_clock import SteppedClock


class ScriptedBus:
    """A bus whose connection the test breaks."""

    kind, units = "modbus_rtu", (1, 247)

    def __init__(self, name: str = "rtu1") -> None:
        self.name = name
        self.timeout_s = 0.5
        self.fault: Exception | None = None
        self.opened = self.closed = 0
        self.is_open = False

    async def connect(self) -> None:
        if self.fault is not None:
            raise self.fault
        self.opened += 1
        self.is_open = True

    async def close(self) -> None:
        self.closed += 1
        self.is_open = False


class ScriptedDevice:
    """A device with one channel that the test silences. `takes_s`: simulated duration of a read.

    `fault_takes_s`: of one that fails; `first_fault_takes_s`: of the first one after an answer, where the bus hurries.
    """

    def __init__(self, name: str, clock: SteppedClock, bus: ScriptedBus) -> None:
        self.device, self.channels = name, (f"{name}_t",)
        self.fault: Exception | None = None
        self.fault_once: Exception | None = None
        self.fault_then: Exception | None = None
        """What `fault` becomes after `fault_once`."""
        self.fault_at_connect: Exception | None = None
        self.quality = Quality.GOOD
        self.takes_s = self.fault_takes_s = 0.0
        self.first_fault_takes_s: float | None = None
        self._failed = False
        self.asked: list[float] = []
        self.hang = False
        self.clock, self._bus = clock, bus

    async def connect(self) -> None:
        if self.fault_at_connect is not None:
            self.asked.append(self.clock.monotonic())
            raise self.fault_at_connect

    async def read(self, *, again: bool = False) -> Sequence[Reading]:
        assert self.clock.holds > 0, "a wire is used while simulated time runs"
        assert self._bus.is_open, "a device is read on a closed bus"
        self.asked.append(self.clock.monotonic())
        if self.hang:
            await asyncio.Event().wait()
        if self.fault is not None:
            self._fail(self.fault)
        if self.fault_once is not None:
            fault, self.fault_once = self.fault_once, None
            self.fault, self.fault_then = self.fault_then, None
            self._fail(fault)
        self._failed = False
        self.clock.spend(self.takes_s)
        now = self.clock.monotonic()
        return [Reading(self.channels[0], 20.0 + now / 1000, "degC", self.quality, self.clock.utc(), now)]

    def _fail(self, fault: Exception) -> NoReturn:
        first_s = None if self._failed else self.first_fault_takes_s
        self._failed = True
        self.clock.spend(self.fault_takes_s if first_s is None else first_s)
        if first_s is not None and isinstance(fault, NoAnswer):
            raise NoAnswer(str(fault), hurried=True)
        raise fault

    async def close(self) -> None:
        pass


class ScriptedPlant:
    """One bus with devices, and everything that the acquisition reported."""

    def __init__(self, *names: str) -> None:
        self.clock = SteppedClock()
        self.bus = ScriptedBus()
        self.devices = {name: ScriptedDevice(name, self.clock, self.bus) for name in names}
        self.readings: list[Sample] = []
        self.notices: list[Notice] = []
        self.plausible: dict[str, Limits] = {}

    def line(self, **policy: float) -> Line:
        return Line(
            self.bus,
            tuple(self.devices.values()),
            period_s=1.0,
            retry_max_periods=int(policy.get("retry_max_periods", 8)),
            read_limit_s=policy.get("read_limit_s", 5.0),
            plausible=self.plausible,
            phase_s=policy.get("phase_s", 0.0),
        )

    @asynccontextmanager
    async def running(self, **policy: float) -> AsyncIterator[Acquisition]:
        lines = [self.line(**policy)]
        async with Acquisition(lines, self.clock, self.readings.extend, self.notices.append) as acquisition:
            yield acquisition

    def of(self, device: str) -> list[Sample]:
        return [r for r in self.readings if r.channel == f"{device}_t"]

    def told(self) -> list[tuple[str, bool]]:
        return [(notice.subject, notice.ended) for notice in self.notices]
