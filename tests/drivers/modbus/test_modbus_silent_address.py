"""A unit that is silent for one address and answers others: only the channels that need this address are lost."""

from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from math import inf
from pathlib import Path

import pytest

from drivers.base import AsksLater, Driver, DriverError, NoAnswer, Quality, Reading
from drivers.build import make_device
from drivers.modbus.bus import ModbusBus
from simulators.devices import RtuLine, TcpHost
from tests.benches.buses import make_bus
from tests.benches.manual_clock import ManualClock

pytestmark = pytest.mark.simulated_time

ASKS = 20
"""More than the gateway needs to see that an address is silent."""
LONGEST_S = 60.0
"""Between two requests for a silent address."""
RegisterPlace = tuple[int, int]
"""Function and address."""


class Muting(Mapping[int, int]):
    """Registers that hold their own addresses, but for one function, of which those the unit lacks are absent."""

    def __init__(self, unit: "MutedUnit", function: int) -> None:
        self._unit, self._function = unit, function

    def __getitem__(self, address: int) -> int:
        place = self._function, address
        self._unit.touched.append(place)
        if place in self._unit.lacks:
            raise KeyError(address)
        return address

    def __iter__(self) -> Iterator[int]:
        return iter(range(0x10000))

    def __len__(self) -> int:
        return 0x10000


@dataclass
class MutedUnit:
    """A unit that does not answer a request for any of its silent places."""

    mute: set[RegisterPlace] = field(default_factory=set)
    lacks: set[RegisterPlace] = field(default_factory=set)
    touched: list[RegisterPlace] = field(default_factory=list)
    """Places that the present request reads."""
    asked: list[Sequence[RegisterPlace]] = field(default_factory=list)
    silent: bool = False

    def memory(self, function: int) -> Mapping[int, int]:
        self.touched = []
        self.asked.append(self.touched)
        return Muting(self, function)

    def spoil(self, _: int, frame: bytes) -> Sequence[tuple[float, bytes]]:
        return () if self.mute & set(self.touched) else ((0.0, frame),)

    def asked_for(self, *places: RegisterPlace) -> int:
        """How many requests asked for any of these places."""
        return sum(bool(set(places) & set(one)) for one in self.asked)


HEAD = """
protocol = "modbus"
title = "registers at several addresses"
buses = ["modbus_rtu", "modbus_tcp"]
unit = "1"
"""
THREE = "".join(
    f'[[block]]\nfunction = 4\naddress = {address}\nchannels = {channels}\ntype = "uint16"\n'
    for address, channels in ((0, 1), (100, 4), (200, 2))
)
CHANNELS = {"a0": 0, "b0": 1, "b1": 2, "b2": 3, "b3": 4, "c0": 5, "c1": 6}
VALUES = {"a0": 0.0, "b0": 100.0, "b1": 101.0, "b2": 102.0, "b3": 103.0, "c0": 200.0, "c1": 201.0}


@asynccontextmanager
async def wired(
    unit: MutedUnit, folder: Path, kind: str, text: str = THREE, channels: Mapping[str, int] = CHANNELS
) -> AsyncIterator[tuple[Driver, ManualClock, ModbusBus]]:
    path = folder / "words.toml"
    path.write_text(HEAD + text, encoding="utf-8")
    server: RtuLine | TcpHost
    if kind == "modbus_tcp":
        server = TcpHost({1: unit})
        options: dict[str, object] = {"host": "127.0.0.1", "port": await server.start()}
    else:
        server = RtuLine({1: unit})
        options = {"port": await server.start(), "baud": 115200}
    server.spoil = unit.spoil
    clock = ManualClock()
    bus = make_bus("bus1", kind, {**options, "timeout_s": 0.1})
    assert isinstance(bus, ModbusBus)
    driver = make_device("words", bus, str(path), 1, channels, {}, clock)
    try:
        await bus.connect()
        yield driver, clock, bus
    finally:
        await bus.close()
        await server.stop()


@asynccontextmanager
async def reading(
    unit: MutedUnit, folder: Path, kind: str, text: str = THREE, channels: Mapping[str, int] = CHANNELS
) -> AsyncIterator[tuple[Driver, ManualClock]]:
    async with wired(unit, folder, kind, text, channels) as (driver, clock, _):
        yield driver, clock


async def connected(driver: Driver) -> None:
    """Connect as the runner does: the device is asked again."""
    for _ in range(ASKS):
        try:
            await driver.connect()
        except NoAnswer:
            continue
        return
    raise AssertionError("it never connected")


async def read(driver: Driver) -> dict[str, Reading]:
    """Read as the runner does within a period, with all the time that is needed."""
    errors: list[DriverError] = []
    for ask in range(ASKS):
        try:
            return {reading.channel: reading for reading in await driver.read(again=ask > 0)}
        except NoAnswer as error:
            errors.append(error)
    raise errors[-1]


async def ask_later(driver: Driver, clock: ManualClock, times: int, step_s: float = 1.0) -> None:
    """Ask as the runner does at the end of this many periods, and each time read what was found."""
    assert isinstance(driver, AsksLater)
    for _ in range(times):
        clock.move_to(clock.now + step_s)
        if driver.asks_later:
            await driver.ask_later()
        await read(driver)


def good(readings: Mapping[str, Reading]) -> dict[str, float]:
    return {name: one.value for name, one in readings.items() if one.quality is Quality.GOOD}


def without(*names: str) -> dict[str, float]:
    return {name: value for name, value in VALUES.items() if name not in names}


KINDS = pytest.mark.parametrize("kind", ["modbus_rtu", "modbus_tcp"])


@KINDS
@pytest.mark.parametrize(
    ("place", "lost", "request_"),
    [
        ((4, 0), ("a0",), "function 4, address 0, count 1"),
        ((4, 102), ("b0", "b1", "b2", "b3"), "function 4, address 100, count 4"),
        ((4, 201), ("c0", "c1"), "function 4, address 200, count 2"),
    ],
)
async def test_the_other_channels_are_read_and_the_cause_is_named(
    kind: str, place: RegisterPlace, lost: tuple[str, ...], request_: str, tmp_path: Path
) -> None:
    unit = MutedUnit({place})
    async with reading(unit, tmp_path, kind) as (driver, _):
        await connected(driver)
        readings = await read(driver)
        assert good(readings) == without(*lost)
        text = f"unit 1 does not answer {request_} (it answers other requests: does it have this address?)"
        assert {(readings[name].quality, readings[name].detail) for name in lost} == {(Quality.COMM_FAULT, text)}
        unit.asked.clear()
        assert good({one.channel: one for one in await driver.read()}) == without(*lost), "at once"
        assert not unit.asked_for(place)


@KINDS
async def test_the_silent_address_is_found_by_dividing_and_costs_one_request_at_a_time(
    kind: str, tmp_path: Path
) -> None:
    unit = MutedUnit({(4, 102)})
    async with reading(unit, tmp_path, kind) as (driver, clock):
        await connected(driver)
        await read(driver)
        unit.asked.clear()
        await ask_later(driver, clock, 6)
        readings = await read(driver)
        assert good(readings) == without("b2")
        assert "address 102, count 1 (it answers other requests" in readings["b2"].detail
        assert unit.asked_for((4, 102)) <= 6, "never twice in a second"


@KINDS
async def test_a_silent_address_is_asked_for_less_and_less_often_and_returns(kind: str, tmp_path: Path) -> None:
    unit = MutedUnit({(4, 0)})
    async with reading(unit, tmp_path, kind) as (driver, clock):
        await connected(driver)
        await read(driver)
        unit.asked.clear()
        await ask_later(driver, clock, 300)
        assert unit.asked_for((4, 0)) == 1 + 6 + 3, "after 1, 2, 4, 8, 16, 32 s, then each 60 s"
        unit.mute.clear()
        await ask_later(driver, clock, 2, LONGEST_S)
        assert good(await read(driver)) == VALUES


@KINDS
async def test_a_unit_that_is_silent_for_a_gap_is_read_in_parts(kind: str, tmp_path: Path) -> None:
    """`max_gap` lets one request read what no channel needs."""
    text = "".join(f'[[block]]\nfunction = 3\naddress = {a}\ntype = "uint16"\n' for a in (0, 4, 50))
    unit = MutedUnit({(3, 2)})
    async with reading(unit, tmp_path, kind, text, {"a": 0, "b": 1, "c": 2}) as (driver, clock):
        await connected(driver)
        assert good(await read(driver)) == {"c": 50.0}
        await ask_later(driver, clock, 4)
        assert good(await read(driver)) == {"a": 0.0, "b": 4.0, "c": 50.0}


@KINDS
async def test_an_address_that_is_refused_and_one_that_is_silent(kind: str, tmp_path: Path) -> None:
    """A refused address is asked for again after a minute; a silent one is not, so that nobody has to wait for it."""
    unit = MutedUnit({(4, 0)}, lacks={(4, 201)})
    async with reading(unit, tmp_path, kind) as (driver, clock):
        await connected(driver)
        await read(driver)
        await ask_later(driver, clock, 100)
        readings = await read(driver)
        assert good(readings) == without("a0", "c1")
        assert "exception 2" in readings["c1"].detail
        assert "does not answer" in readings["a0"].detail
        unit.lacks.clear()
        unit.asked.clear()
        clock.move_to(clock.now + 61.0)
        assert good(await read(driver)) == without("a0")
        assert not unit.asked_for((4, 0))


STATUS = """
[[block]]
function = 4
address = 0
type = "uint16"
[block.status]
function = 3
address = 500
good = [500]
[[block]]
function = 4
address = 100
type = "uint16"
"""


@KINDS
async def test_a_status_that_is_silent_makes_its_own_values_invalid(kind: str, tmp_path: Path) -> None:
    """It is asked for first, so nothing has been answered yet when it is missed."""
    unit = MutedUnit({(3, 500)})
    async with reading(unit, tmp_path, kind, STATUS, {"judged": 0, "plain": 1}) as (driver, _):
        await connected(driver)
        readings = await read(driver)
        assert good(readings) == {"plain": 100.0}
        assert "does not answer function 3, address 500, count 1" in readings["judged"].detail


@KINDS
async def test_a_unit_that_is_silent_for_everything_is_not_a_unit_with_a_silent_address(
    kind: str, tmp_path: Path
) -> None:
    unit = MutedUnit()
    async with reading(unit, tmp_path, kind) as (driver, _):
        await connected(driver)
        assert good(await read(driver)) == VALUES
        unit.silent = True
        with pytest.raises(NoAnswer, match="did not answer within"):
            await read(driver)
        assert isinstance(driver, AsksLater)
        assert not driver.asks_later, "it is the unit that is silent"
        unit.silent = False
        assert good(await read(driver)) == VALUES


@KINDS
async def test_a_unit_that_returns_needs_one_miss_to_know_its_silent_address(kind: str, tmp_path: Path) -> None:
    unit = MutedUnit({(4, 100)})
    async with reading(unit, tmp_path, kind) as (driver, _):
        await connected(driver)
        await read(driver)
        await driver.close()
        await connected(driver)
        unit.asked.clear()
        assert good(await read(driver)) == without("b0", "b1", "b2", "b3")
        assert unit.asked_for((4, 100)) <= 2


ALIKE = "".join(f'[[block]]\nfunction = 4\naddress = {a}\nchannels = 2\ntype = "uint16"\n' for a in (0, 100))


@KINDS
async def test_blocks_whose_answers_look_alike(kind: str, tmp_path: Path) -> None:
    """Usually one waits for the late answer of the other, but not without limit."""
    unit = MutedUnit({(4, 0)})
    async with reading(unit, tmp_path, kind, ALIKE, {"a0": 0, "a1": 1, "b0": 2, "b1": 3}) as (driver, _):
        await connected(driver)
        assert good(await read(driver)) == {"b0": 100.0, "b1": 101.0}


@KINDS
async def test_an_address_that_is_refused_instead_is_not_silent_any_more(kind: str, tmp_path: Path) -> None:
    unit = MutedUnit({(4, 0)})
    async with reading(unit, tmp_path, kind) as (driver, clock):
        await connected(driver)
        await read(driver)
        unit.mute, unit.lacks = set(), {(4, 0)}
        await ask_later(driver, clock, 1)
        assert "exception 2" in (await read(driver))["a0"].detail


async def test_what_there_was_no_time_to_ask_is_not_silent(tmp_path: Path) -> None:
    unit = MutedUnit({(4, 200)})
    async with wired(unit, tmp_path, "modbus_rtu") as (driver, _, bus):
        await connected(driver)
        with pytest.raises(NoAnswer):  # the others are answered
            await driver.read()
        unit.mute.clear()
        bus.limit(0.0)
        for _ in range(ASKS):
            with pytest.raises(NoAnswer, match="no time was left"):
                await driver.read(again=True)
        bus.limit(inf)
        assert good({one.channel: one for one in await driver.read(again=True)}) == VALUES
