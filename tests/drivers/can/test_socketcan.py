"""Interfaces of the kernel: the requests to it, the errors made from its errors, and the buses' recovery."""

import asyncio
import errno
import os
import re
import socket
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from drivers.base import Bus, ConnectError, Driver, DriverError, Quality, Reading, SystemClock
from drivers.build import make_device
from drivers.can.settings import CanInterfaceSettings
from drivers.can.survey import CanSurvey, Heard
from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.line import Line
from gateway.runtime.clocks import RealClock
from simulators.devices import Cia404Node
from simulators.devices.can_logger import CanLogger
from tests.benches.buses import make_bus
from tests.benches.can_kernel import CanKernel
from tests.benches.logger_files import logger_profile

pytestmark = pytest.mark.simulated_time

NODE, TEMPERATURES = 5, [20.0, -3.3]
OPTIONS = {"interface": "socketcan", "channel": "can0", "timeout_s": 0.2}
SOL_CAN_RAW = 101
RAW_FILTER, RAW_ERR_FILTER, RAW_LOOPBACK, RAW_RECV_OWN_MSGS, SO_TIMESTAMPNS = 1, 2, 3, 4, 35
"""linux/can/raw.h and asm-generic/socket.h."""


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch) -> CanKernel:
    there = CanKernel([Cia404Node(NODE, lambda: TEMPERATURES, inputs=2)])
    monkeypatch.setattr("can.interfaces.socketcan.socketcan.create_socket", there.create)
    return there


@asynccontextmanager
async def opened(kind: str = "canopen", **options: object) -> AsyncIterator[Bus]:
    bus = make_bus("can1", kind, OPTIONS | options)
    try:
        await bus.connect()
        yield bus
    finally:
        await bus.close()


def node_on(bus: Bus) -> Driver:
    return make_device("node", bus, "cia404", NODE, {"a": 0, "b": 1}, {"vendor": "jumo"}, SystemClock())


async def refused(kind: str = "canopen", **options: object) -> ConnectError:
    with pytest.raises(ConnectError) as raised:
        async with opened(kind, **options):
            pass
    return raised.value


@pytest.mark.parametrize("kind", ["canopen", "can"])
async def test_a_socket_for_classic_frames_and_error_frames_and_nothing_else(
    kind: str, kernel: CanKernel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAN_CONFIG", '{"fd": true, "receive_own_messages": true, "channel": "can9"}')
    async with opened(kind):
        (only,) = kernel.sockets
        assert only.channel == "can0"
        assert only.options == {
            (SOL_CAN_RAW, RAW_FILTER): bytes(8),  # any identifier
            (SOL_CAN_RAW, RAW_LOOPBACK): 1,
            (SOL_CAN_RAW, RAW_RECV_OWN_MSGS): 0,
            (SOL_CAN_RAW, RAW_ERR_FILTER): 0x1FFFFFFF,
            (socket.SOL_SOCKET, SO_TIMESTAMPNS): 1,
        }
    assert only.closed


def _missing(kernel: CanKernel) -> None:
    kernel.up = {"vcan7": True}


def _down(kernel: CanKernel) -> None:
    kernel.switch("can0", on=False)


def _denied(number: int) -> Callable[[CanKernel], None]:
    def deny(kernel: CanKernel) -> None:
        kernel.refuses = number

    return deny


@pytest.mark.parametrize("kind", ["canopen", "can"])
@pytest.mark.parametrize(
    ("fault", "what", "remedy"),
    [
        (_missing, "No such device", "can0 is not among those that `ip link` lists: is the adapter plugged in"),
        (_down, "Network is down", "ip link set can0 up type can bitrate 250000 restart-ms 100"),
        (_denied(errno.EPERM), "Operation not permitted", "this user, service or container is not allowed to open"),
        (_denied(errno.EACCES), "Permission denied", "this user, service or container is not allowed to open"),
        (_denied(errno.EAFNOSUPPORT), "Address family not supported by protocol", "modprobe can_raw"),
    ],
)
async def test_what_cannot_be_opened_is_reported_with_its_remedy(
    kind: str, fault: Callable[[CanKernel], None], what: str, remedy: str, kernel: CanKernel
) -> None:
    fault(kernel)
    error = await refused(kind, bitrate=250_000)
    assert re.fullmatch(rf"bus can1: cannot open socketcan can0: {what} \(.*\)", str(error))
    assert remedy in error.hint
    assert all(one.closed for one in kernel.sockets)


async def test_kernel_of_this_computer_knows_no_such_interface() -> None:
    error = await refused(channel="nowhere0")
    assert "nowhere0" in error.what
    assert error.what.endswith(tuple(os.strerror(number) for number in (errno.ENODEV, errno.EAFNOSUPPORT, errno.EPERM)))
    assert error.hint


async def test_node_is_read_and_frames_of_others_are_ignored(kernel: CanKernel) -> None:
    error_frame, extended = (0x2000_0004, bytes(8)), (0x8000_0000 | 0x580 + NODE, bytes.fromhex("4330910163000000"))
    async with opened() as bus:
        driver = node_on(bus)
        for _ in range(3):
            kernel.send([error_frame, extended])
            assert [r.value for r in await driver.read()] == pytest.approx(TEMPERATURES)


async def read_until(driver: Driver, error: type[DriverError]) -> DriverError:
    """The error that a read raises; an earlier frame may still be fresh."""
    async with asyncio.timeout(60.0):
        while True:
            try:
                await driver.read()
            except error as met:
                return met
            await asyncio.sleep(0.005)


async def read_again(bus: Bus, driver: Driver) -> list[float]:
    await bus.connect()
    await driver.connect()
    return [r.value for r in await driver.read()]


def _pulled(kernel: CanKernel) -> None:
    kernel.remove("can0")


def _plugged(kernel: CanKernel) -> None:
    kernel.switch("can0", on=True)


@pytest.mark.parametrize(
    ("fault", "what", "remedy"),
    [(_down, "Network is down", "ip link set can0 up type can"), (_pulled, "No such device", "is the adapter plugged")],
)
@pytest.mark.parametrize("kind", ["canopen", "can"])
async def test_interface_that_goes_is_reported_and_taken_again(
    kind: str, fault: Callable[[CanKernel], None], what: str, remedy: str, kernel: CanKernel, tmp_path: Path
) -> None:
    logger = CanLogger(lambda: [*TEMPERATURES, 0.0, 0.0, 0.0], kernel.send)
    async with opened(kind) as bus:
        if kind == "canopen":
            driver = node_on(bus)
        else:
            driver = make_device("logger", bus, logger_profile(tmp_path), 1, {"a": 0, "b": 1}, {}, SystemClock())
            logger.start()
        try:
            await driver.connect()
            fault(kernel)
            error = await read_until(driver, ConnectError)
            assert "interface can0 is gone: " in error.what
            assert what in error.what
            assert remedy in error.hint
            await bus.close()  # as the acquisition does
            with pytest.raises(ConnectError, match="cannot open socketcan can0"):
                await bus.connect()
            _plugged(kernel)
            assert await read_again(bus, driver) == pytest.approx(TEMPERATURES)
        finally:
            logger.stop()
    assert all(one.closed for one in kernel.sockets)


async def test_full_queue_is_reported_as_nobody_acknowledging(kernel: CanKernel) -> None:
    async with opened() as bus:
        driver = node_on(bus)
        await driver.read()
        kernel.refuses_to_send = errno.ENOBUFS
        error = await read_until(driver, ConnectError)
        assert error.what == "cannot send on can0: No buffer space available"
        assert "no node acknowledges" in error.hint
        kernel.refuses_to_send = 0
        assert await read_again(bus, driver) == pytest.approx(TEMPERATURES)


async def test_acquisition_opens_the_interface_again_by_itself(kernel: CanKernel) -> None:
    bus = make_bus("can1", "canopen", OPTIONS)
    latest: dict[str, Reading] = {}

    async def until(quality: Quality, says: str = "") -> None:
        async with asyncio.timeout(60.0):
            while not (latest.get("a") and latest["a"].quality is quality and says in latest["a"].detail):
                await asyncio.sleep(0.005)

    def note(readings: Sequence[Reading]) -> None:
        latest.update({reading.channel: reading for reading in readings})

    line = Line(bus, (node_on(bus),), 0.05, retry_max_periods=2)
    async with Acquisition([line], RealClock(), note, lambda _: None):
        for fault in (_down, _pulled):
            await until(Quality.GOOD)
            fault(kernel)
            await until(Quality.COMM_FAULT, "cannot open socketcan can0")
            _plugged(kernel)
        await until(Quality.GOOD)


async def test_survey_meets_the_same_errors(kernel: CanKernel) -> None:
    settings = CanInterfaceSettings(interface="socketcan", channel="can0")
    with CanSurvey("scan", settings) as survey:
        heard = Heard()
        survey.ask([NODE, NODE + 1], 0.1, heard, lambda: False)
        assert heard.device_types == {NODE: 0x0002_0194}
        kernel.refuses_to_send = errno.ENOBUFS
        with pytest.raises(ConnectError, match=r"cannot send on can0: .*no node acknowledges"):
            survey.ask([NODE], 0.1, heard, lambda: False)
        _down(kernel)
        with pytest.raises(ConnectError, match=r"can0 is gone: .*Network is down.*ip link set can0 up"):
            survey.listen(0.1, heard, lambda: False)
