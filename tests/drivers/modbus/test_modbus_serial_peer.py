"""The Modbus drivers against another maker's stack, on TCP and on a serial line: modbus-serial (npm)."""

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from drivers.base import Bus, NoAnswer, Quality, Refused, SystemClock
from drivers.build import make_device
from drivers.modbus.bus import ModbusBus
from drivers.modbus.numbers import Block
from simulators.devices.pty_port import PtyPort
from tests.benches.asked_again import answered, readings_of
from tests.benches.buses import make_bus
from tests.benches.npm_peer import node_with, running

pytestmark = pytest.mark.peer

TIMEOUT_S = 5.0
"""A busy computer may need this long for another program's answer."""


class SentFrames:
    """A tap that keeps the requests."""

    def __init__(self) -> None:
        self.requests: list[bytes] = []

    def data(self, sent: bool, data: bytes) -> None:
        if sent:
            self.requests.append(data)

    def frame(self, sent: bool, identifier: int, extended: bool, data: bytes) -> None: ...

    def note(self, text: str) -> None: ...


@pytest.fixture(scope="module")
def node() -> str:
    return node_with("modbus_serial", "modbus-serial")


@pytest.fixture
def sent() -> SentFrames:
    """The requests sent on `bus`."""
    return SentFrames()


@pytest.fixture
async def bus(node: str, sent: SentFrames) -> AsyncIterator[Bus]:
    async with running(node, "modbus_serial/server.js") as (port, _):
        tcp = make_bus("tcp1", "modbus_tcp", {"host": "127.0.0.1", "port": int(port), "timeout_s": TIMEOUT_S}, sent)
        await tcp.connect()
        yield tcp
        await tcp.close()


@pytest.fixture
async def line(node: str) -> AsyncIterator[Bus]:
    """A line of two pseudo-terminals, modbus-serial on the far one."""
    near: PtyPort
    far = PtyPort(lambda data: near.write(data))
    near = PtyPort(far.write)
    near_path, far_path = await near.start(), await far.start()
    rtu = make_bus("rtu1", "modbus_rtu", {"port": near_path, "baud": 19200, "timeout_s": TIMEOUT_S})
    async with running(node, "modbus_serial/server.js", Path(far_path)):
        await rtu.connect()
        yield rtu
        await rtu.close()
    await near.stop()
    await far.stop()


async def test_modules_on_a_serial_line(line: Bus) -> None:
    m7015 = make_device("m7015", line, "icpdas_m7015", 3, {f"a{i}": i for i in range(6)}, {}, SystemClock())
    pta = make_device("pta", line, "eletechsup_pta8d08", 4, {f"b{i}": i for i in range(8)}, {}, SystemClock())
    await m7015.connect()
    await pta.connect()
    for _ in range(3):
        readings = await readings_of(m7015)
        assert [r.value for r in readings if r.quality is Quality.GOOD] == pytest.approx([20.0, 21.3, -3.3, 40.0, 22.2])
        assert readings[4].quality is Quality.SENSOR_FAULT
        readings = await readings_of(pta)
        good = [20.0, 21.3, -3.3, 40.0, 22.2, 23.4]
        assert [r.value for r in readings if r.quality is Quality.GOOD] == pytest.approx(good)
        assert [r.quality for r in readings if r.quality is not Quality.GOOD] == [
            Quality.SENSOR_FAULT,
            Quality.OUT_OF_RANGE,
        ]


async def test_silence_and_refusal_on_a_serial_line(line: Bus) -> None:
    assert isinstance(line, ModbusBus)
    for _ in range(2):
        with pytest.raises(NoAnswer, match="unit 9"):
            await line.read("dead", 9, Block(4, 0, 2))
        with pytest.raises(Refused, match="exception 2: illegal data address"):
            await answered(lambda again: line.read("alive", 3, Block(4, 6, 1), again=again))
        assert await answered(lambda again: line.read("alive", 3, Block(4, 0, 2), again=again)) == (200, 213)


async def test_adam6015(bus: Bus) -> None:
    driver = make_device("rtd", bus, "advantech_adam6015", 1, {f"c{i}": i for i in range(7)}, {}, SystemClock())
    await driver.connect()
    for _ in range(3):
        readings = await driver.read()
        assert [r.value for r in readings][:5] == pytest.approx([50.0, 0.0, 100.0, -49.997, 149.997], abs=0.003)
        assert [r.quality for r in readings] == [Quality.GOOD] * 5 + [Quality.OUT_OF_RANGE, Quality.SENSOR_FAULT]


BLOCKS = """
protocol = "modbus"
title = "Counts and coils of the module, and a type code where it has none"
buses = ["modbus_tcp"]
unit = "1"
[[block]]
function = 3
addresses = [0, 1, 200, 230]
type = "uint16"
[[block]]
function = 1
address = 124
channels = 4
type = "bit"
"""


async def test_registers_and_coils_with_addresses_that_it_lacks(bus: Bus, tmp_path: Path) -> None:
    path = tmp_path / "blocks.toml"
    path.write_text(BLOCKS, encoding="utf-8")
    driver = make_device("all", bus, str(path), 1, {f"c{i}": i for i in range(8)}, {}, SystemClock())
    await driver.connect()
    for _ in range(3):
        readings = await driver.read()
        good = [r.value for r in readings if r.quality is Quality.GOOD]
        assert good == [0x8000, 0x4000, 0x03A4, 0, 0, 1]
        lacking = [r.detail for r in readings if r.quality is Quality.COMM_FAULT]
        assert ["address 230, count 1" in lacking[0], "address 127, count 1" in lacking[1]] == [True, True]


async def test_coupler_with_status_before_each_value(bus: Bus) -> None:
    driver = make_device("rtd", bus, "wago_750_464", 2, {f"c{i}": i for i in range(4)}, {}, SystemClock())
    await driver.connect()
    good, under, broken, below_zero = await driver.read()
    assert (good.value, below_zero.value) == pytest.approx((21.3, -3.3))
    assert (under.quality, broken.quality) == (Quality.OUT_OF_RANGE, Quality.SENSOR_FAULT)


async def test_unit_that_is_silent_costs_one_request_and_not_its_neighbour(bus: Bus, sent: SentFrames) -> None:
    dead = make_device("dead", bus, "wago_750_464", 9, {"a": 0}, {}, SystemClock())
    alive = make_device("alive", bus, "wago_750_464", 2, {"b": 0}, {}, SystemClock())
    for _ in range(3):
        asked = len(sent.requests)
        with pytest.raises(NoAnswer, match="unit 9"):
            await dead.read()
        assert len(sent.requests) == asked + 1
        assert [r.value for r in await alive.read()] == pytest.approx([21.3])


async def test_address_that_does_not_exist_is_refused(bus: Bus) -> None:
    assert isinstance(bus, ModbusBus)
    with pytest.raises(Refused, match="exception 2: illegal data address"):
        await bus.read("d", 2, Block(4, 6, 4))
    assert await bus.read("d", 2, Block(4, 0, 2)) == (0, 213)
