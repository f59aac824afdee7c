"""Servers that do not use the whole unit id: a scan names the ids that they really distinguish."""

from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from itertools import count

import pytest

from gateway.commissioning.scan.found import ScanReport
from gateway.commissioning.scan.serial import plan, scan_line
from gateway.commissioning.scan.tcp import TcpScan, scan_hosts
from simulators.devices import DeviceServer, RtuLine, TcpHost
from simulators.devices.modbus_unit import ModbusUnit
from tests.benches.started import started

pytestmark = pytest.mark.simulated_time

TIMEOUT_S = 0.2
WIRES = ["tcp", "rtu", "rtu over tcp"]


class FilledRegisters:
    """A unit with sixteen registers of one function, the first of which may change whenever it is read."""

    def __init__(self, first: int, function: int = 3, *, live: bool = False) -> None:
        self.silent = False
        self._first, self._function = first, function
        self._drift = count() if live else None

    def memory(self, function: int) -> Mapping[int, int]:
        if function != self._function:
            return {}
        drift = 0 if self._drift is None else next(self._drift)
        return {n: (self._first + n + (drift if n == 0 else 0)) & 0xFFFF for n in range(16)}


def wrapped(units: Mapping[int, ModbusUnit], after: int, highest: int = 247) -> dict[int, ModbusUnit]:
    """What a server distinguishes if it looks only at the remainder of the id."""
    remainders = {unit % after: one for unit, one in units.items()}
    return {unit: remainders[unit % after] for unit in range(1, highest + 1) if unit % after in remainders}


@asynccontextmanager
async def scanned(wire: str, served: Mapping[int, ModbusUnit], units: range) -> AsyncIterator[ScanReport]:
    if wire == "rtu":
        async with started(RtuLine(served)) as path:
            what = plan(path, bauds=(9600,), parities=("N",), units=units, me_bauds=(), me_addresses=(),
                        timeout_s=TIMEOUT_S)  # fmt: skip
            yield await scan_line(what, lambda *_: None, lambda: False)
        return
    async with started(TcpHost(served) if wire == "tcp" else DeviceServer(served)) as port:
        hosts = TcpScan((("127.0.0.1", port),), units, TIMEOUT_S, rtu=wire != "tcp")
        yield await scan_hosts(hosts, lambda *_: None, lambda: False)


async def found(wire: str, served: Mapping[int, ModbusUnit], units: range) -> tuple[list[int], str]:
    """The ids that the scan shows, and its remarks."""
    async with scanned(wire, served, units) as report:
        return [device.unit for device in report.found], "; ".join(report.remarks)


@pytest.mark.parametrize(
    ("after", "wire", "live"),
    [
        *zip((4, 8, 32), WIRES, (False, True, False), strict=True),
        *zip((32, 4, 8), WIRES, (True, False, True), strict=True),
    ],
)
async def test_ids_that_repeat_are_named_once(after: int, wire: str, live: bool) -> None:
    served = wrapped({1: FilledRegisters(100, live=live), 3: FilledRegisters(300, live=live)}, after)
    units, told = await found(wire, served, range(1, 41))
    assert units == [1, 3]
    assert f"repeats its unit ids after {after}: 1 and {1 + after} are one device; the lowest are shown" in told


async def test_ids_that_use_seven_bits_are_named_once() -> None:
    units, told = await found(
        "tcp", wrapped({2: FilledRegisters(100), 120: FilledRegisters(300)}, 128, 255), range(1, 256)
    )
    assert units == [2, 120]
    assert "repeats its unit ids after 128: 2 and 130 are one device" in told


@pytest.mark.parametrize("wire", WIRES)
async def test_a_device_that_answers_to_every_id_is_one(wire: str) -> None:
    units, told = await found(wire, dict.fromkeys(range(1, 248), FilledRegisters(100, live=True)), range(2, 20))
    assert units == [2]
    assert "answers to every unit id: one device, shown as unit 2" in told


@pytest.mark.parametrize("wire", WIRES)
async def test_a_device_that_answers_to_every_id_may_have_others_behind_it(wire: str) -> None:
    served: dict[int, ModbusUnit] = dict.fromkeys(range(1, 248), FilledRegisters(100, live=True))
    units, told = await found(wire, {**served, 1: FilledRegisters(700), 5: FilledRegisters(700)}, range(1, 8))
    assert units == [1, 2, 5]
    assert "answers to every unit id: one device, shown as unit 2" in told


@pytest.mark.parametrize("wire", WIRES)
@pytest.mark.parametrize(
    ("make", "ids"),
    [
        (lambda: FilledRegisters(0), (1, 17)),
        (lambda: FilledRegisters(0), (1, 2, 3)),
        (lambda: FilledRegisters(0, 4), (1, 2, 9, 10)),
        (lambda: FilledRegisters(0), (1, 17, 33)),
    ],
    ids=["two apart", "three in a row", "two pairs", "three apart"],
)
async def test_devices_that_hold_the_same_are_not_taken_for_one(
    make: Callable[[], FilledRegisters], ids: tuple[int, ...], wire: str
) -> None:
    """An additional id, which would be theirs if ids repeated, does not answer."""
    units, told = await found(wire, {unit: make() for unit in ids}, range(1, 41))
    assert units == list(ids)
    assert "one device" not in told


async def test_a_host_that_refuses_every_id_alike_is_asked_with_more() -> None:
    """The ids that were asked may not be its own."""
    units, told = await found("tcp", {u: FilledRegisters(0, 9 if u < 247 else 3) for u in range(256)}, range(1, 33))
    assert units == [1]
    assert "refuses every unit asked as it refuses unknown ones" in told
    assert "--units 1-247?" in told
    units, told = await found("tcp", {u: FilledRegisters(0, 9 if u < 247 else 3) for u in range(256)}, range(1, 248))
    assert (units, told) == ([247], "")
