"""The fault matrix: each fault over a real wire, the gateway's acquisition on the other end.

In each: the channel's quality turns within two periods, the neighbour on the wire and the other bus keep their period,
recovery needs nobody, and each problem is told once.
"""

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from drivers.base import Quality
from simulators.devices.modbus_servers import crc16
from simulators.devices.source import Fault
from simulators.devices.spoil import Spoil
from tests.gateway.faults.bench import FAULT_PERIODS, PERIOD_S, Metronome, acquiring, keeps_period
from tests.gateway.faults.plants import PLANTS, PLANTS_OF_ONE_FAULT, VICTIM, Plant, other

Do = Callable[[Plant], Awaitable[None] | None]


def spoilt(spoil: Callable[[bytes], Sequence[tuple[float, bytes]]], *, all_units: bool = False) -> Do:
    """What happens to the victim's answers."""

    def on_wire(sender: int, frame: bytes) -> Sequence[tuple[float, bytes]]:
        return spoil(frame) if all_units or sender == VICTIM else ((0.0, frame),)

    def do(plant: Plant) -> None:
        assert plant.wire is not None
        plant.wire.spoil = on_wire

    return do


def whole(plant: Plant) -> None:
    assert plant.wire is not None
    wire_fault: Spoil | None = None
    plant.wire.spoil = wire_fault


def rtu_frame(body: bytes) -> bytes:
    return body + crc16(body)


def tcp_exception(frame: bytes) -> bytes:
    return frame[:4] + b"\0\3" + frame[6:7] + bytes((frame[7] | 0x80, 6))


def silent(plant: Plant) -> None:
    plant.faults.silent = True


def talking(plant: Plant) -> None:
    plant.faults.silent = False


def sensor(fault: Fault | None) -> Do:
    return lambda plant: plant.faults.set(0, fault)


def bus_off(off: bool) -> Do:
    def do(plant: Plant) -> None:
        assert plant.adapter is not None
        plant.adapter.bus_off = off

    return do


def rebooted(plant: Plant) -> None:
    """The node is back and says so; nobody restarts it."""
    assert plant.adapter is not None
    plant.faults.silent = False
    plant.adapter.send([(0x700 + VICTIM, b"\0")])


def heartbeat(stopped: bool) -> Do:
    def do(plant: Plant) -> None:
        assert plant.node is not None
        plant.node.heartbeat_stopped = stopped

    return do


def wrong_type(plant: Plant) -> None:
    """Gone, and another device is in its place: seen when it is connected anew."""
    plant.faults.silent = True
    plant.retype(0x0FFF)
    asyncio.get_running_loop().call_later(2 * PERIOD_S, talking, plant)


def right_type(plant: Plant) -> None:
    plant.faults.silent = False
    plant.retype(0)


def unplug(plant: Plant) -> Awaitable[None]:
    return plant.unplug()


def plug(plant: Plant) -> Awaitable[None]:
    return plant.plug()


COMM = Quality.COMM_FAULT
BROKEN, BEYOND = Quality.SENSOR_FAULT, Quality.OUT_OF_RANGE


@dataclass(frozen=True)
class Case:
    """One row of the matrix."""

    fault: str
    plant: str
    start: Do
    end: Do
    quality: Quality = COMM
    whole_bus: bool = False
    """The fault is one of the wire, so the neighbour on it is gone too; only the other bus is held to its period."""
    whole_device: bool = False
    """All channels of the victim turn, not the first alone."""
    kinds: int = 1
    """How many different problems this is in turn, each told once."""


MATRIX = [
    *(Case("unplugged and back", plant, unplug, plug, whole_bus=True) for plant in PLANTS),
    *(Case("dead unit", plant, silent, talking) for plant in PLANTS),
    Case("half-open connection", "tcp", spoilt(lambda _: (), all_units=True), whole, whole_bus=True),
    Case("wrong unit answers", "rtu", spoilt(lambda f: [(0, rtu_frame(b"\x07" + f[1:-2]))]), whole),
    Case("wrong unit answers", "tcp", spoilt(lambda f: [(0, f[:6] + b"\x07" + f[7:])]), whole),
    Case("late answer", "rtu", spoilt(lambda f: [(1.5 * 0.03, f)]), whole),
    Case("late answer", "tcp", spoilt(lambda f: [(1.5 * 0.03, f)]), whole),
    Case("checksum error", "rtu", spoilt(lambda f: [(0, f[:-1] + bytes((f[-1] ^ 1,)))]), whole),
    Case("truncated", "rtu", spoilt(lambda f: [(0, f[:-3])]), whole),
    Case("overlong", "rtu", spoilt(lambda f: [(0, rtu_frame(f[:2] + bytes((f[2] + 2,)) + f[3:-2] + b"\0\0"))]), whole),
    Case("overlong", "tcp", spoilt(lambda f: [(0, f[:4] + bytes((0, f[5] + 2)) + f[6:] + b"\0\0")]), whole),
    Case("exception code", "rtu", spoilt(lambda f: [(0, rtu_frame(bytes((f[0], f[1] | 0x80, 6))))]), whole),
    Case("exception code", "tcp", spoilt(lambda f: [(0, tcp_exception(f))]), whole),
    Case("bus-off", "slcan", bus_off(True), bus_off(False), whole_bus=True),
    Case("node reboots", "slcan", silent, rebooted),
    Case("heartbeat lost", "slcan_heartbeat", heartbeat(True), heartbeat(False), Quality.STALE, whole_device=True),
    *(Case("another type code", plant, wrong_type, right_type, kinds=2) for plant in ("rtu", "tcp", "slcan")),
    *(Case("sensor open", plant, sensor(Fault.OPEN), sensor(None), BROKEN) for plant in ("rtu", "pta", "tcp", "slcan")),
    Case("sensor open", "me_rs485", sensor(Fault.OPEN), sensor(None), BROKEN),
    Case("sensor open", "me_ethernet", sensor(Fault.OPEN), sensor(None), BEYOND),
    Case("sensor short", "rtu", sensor(Fault.SHORT), sensor(None), BROKEN),
    Case("sensor short", "tcp", sensor(Fault.SHORT), sensor(None), BEYOND),
    Case("sensor short", "slcan", sensor(Fault.SHORT), sensor(None), BROKEN),
    *(Case("over range", plant, sensor(Fault.OVER), sensor(None), BEYOND) for plant in PLANTS if plant != "rtu"),
    *(Case("under range", plant, sensor(Fault.UNDER), sensor(None), BEYOND) for plant in PLANTS if plant != "rtu"),
]


async def _do(action: Do, plant: Plant) -> None:
    waiting = action(plant)
    if waiting is not None:
        await waiting


@pytest.mark.parametrize("case", MATRIX, ids=lambda case: f"{case.plant}-{case.fault}".replace(" ", "_"))
async def test_fault(case: Case, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING, logger="gateway.acquisition")
    plant = await {**PLANTS, **PLANTS_OF_ONE_FAULT}[case.plant](tmp_path)
    with Metronome() as metronome:
        async with acquiring(plant, await other()) as heard:
            await heard.until("victim", Quality.GOOD, 0.0, 5.0)
            await asyncio.sleep(2 * PERIOD_S)
            begun = time.monotonic()
            await _do(case.start, plant)
            turned = await heard.until("victim", case.quality, begun, 5.0)
            await asyncio.sleep(FAULT_PERIODS * PERIOD_S)
            ended = time.monotonic()
            during = [r for r in heard.of("victim", turned.monotonic_s) if r.monotonic_s < ended]
            await _do(case.end, plant)
            back = await heard.until("victim", Quality.GOOD, ended, 5.0)
            await asyncio.sleep(0.05)
    slack_s = metronome.worst_s
    assert turned.monotonic_s - begun <= 2 * PERIOD_S + slack_s
    assert Quality.GOOD not in {r.quality for r in during}
    assert back.value == pytest.approx(250.0 if case.plant.startswith("me_") else 21.0, abs=0.06)
    keeps_period([r for r in heard.of("other") if begun <= r.monotonic_s < ended], slack_s)
    if not case.whole_bus and len(plant.drivers) > 1:
        keeps_period([r for r in heard.of("neighbour") if begun <= r.monotonic_s < ended], slack_s)
    if case.whole_device:
        assert {r.quality for r in heard.of("beside", turned.monotonic_s) if r.monotonic_s < ended} == {case.quality}
    elif case.quality is not COMM and "beside" in plant.drivers[0].channels:
        assert {r.quality for r in heard.of("beside")} == {Quality.GOOD}
    told: dict[str, int] = {}
    for notice in heard.notices:
        if not notice.ended:
            told[notice.subject] = told.get(notice.subject, 0) + 1
    assert told, "nothing was told"
    assert max(told.values()) <= case.kinds, heard.notices
    assert len(caplog.records) == sum(told.values())
