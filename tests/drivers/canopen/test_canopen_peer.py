"""The CANopen driver against another maker's node: canopen (npm), behind an emulated serial CAN adapter.

That library does not access CAN hardware: it takes and gives frames. Its process exchanges them as lines, so our
emulated node takes no part; only the adapter's ASCII protocol is ours.
"""

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager, suppress
from math import isnan
from pathlib import Path

import pytest

from drivers.base import Bus, Driver, Quality, Reading, Refused, SystemClock
from drivers.build import make_device
from drivers.canopen.bus import CanOpenBus
from drivers.canopen.place import CanObject
from simulators.devices import SlcanAdapter
from simulators.devices.slcan_adapter import CanFrame
from tests.benches.asked_again import readings_of
from tests.benches.buses import make_bus
from tests.benches.npm_peer import node_with, running

pytestmark = pytest.mark.peer

NODE = 5
LAST_TPDO = 0x280 + NODE
TIMEOUT_S = 20.0
"""A busy computer may need this long for another program's answer. The node's heartbeat (1 s) and timer count as
stale after three of their periods."""


class PeerNode:
    """The process as a node of the adapter."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process
        self.sent = Counter[int]()
        """How many frames of each identifier it has sent."""

    def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
        self.tell(f"{identifier:x} {data.hex()}")
        return ()

    def tell(self, line: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(line.encode() + b"\n")

    async def forward(self, adapter: SlcanAdapter) -> None:
        """Pass what it sends to the adapter, until cancelled or until it ends."""
        assert self._process.stdout is not None
        while line := await self._process.stdout.readline():
            identifier, _, data = line.decode().strip().partition(" ")
            adapter.send([(int(identifier, 16), bytes.fromhex(data))])
            self.sent[int(identifier, 16)] += 1


@pytest.fixture
async def wire() -> AsyncIterator[tuple[Bus, PeerNode]]:
    async with joined() as (bus, peer):
        yield bus, peer


@asynccontextmanager
async def joined(event_ms: int = 0) -> AsyncIterator[tuple[Bus, PeerNode]]:
    """The node and a bus that reaches it."""
    async with running(node_with("canopen_node", "canopen"), "canopen_node/node.js", event_ms) as (_, process):
        peer = PeerNode(process)
        adapter = SlcanAdapter([peer])
        bus = make_bus(
            "can1", "canopen", {"interface": "slcan", "channel": await adapter.start(), "timeout_s": TIMEOUT_S}
        )
        forwarding = asyncio.create_task(peer.forward(adapter))
        await bus.connect()
        yield bus, peer
        await bus.close()
        forwarding.cancel()
        with suppress(asyncio.CancelledError):
            await forwarding
        await adapter.stop()


def device(bus: Bus, transfer: str = "sdo") -> Driver:
    options = {"vendor": "jumo", "transfer": transfer}
    return make_device("node", bus, "cia404", NODE, {"a": 0, "b": 1}, options, SystemClock())


async def until(driver: Driver, quality: Quality) -> Reading:
    """The first reading of channel a with this quality."""
    async with asyncio.timeout(60.0):
        while (reading := (await readings_of(driver))[0]).quality is not quality:
            await asyncio.sleep(0.01)
    return reading


@pytest.mark.parametrize("transfer", ["sdo", "sync"])
async def test_values_and_status(wire: tuple[Bus, PeerNode], transfer: str) -> None:
    driver = device(wire[0], transfer)
    await driver.connect()
    for _ in range(3):
        good, broken = await readings_of(driver)
        assert good.quality is Quality.GOOD
        assert good.value == pytest.approx(-12.34)
        assert broken.quality is Quality.SENSOR_FAULT
        assert isnan(broken.value)


async def test_values_that_it_sends_by_its_timer() -> None:
    async with joined(event_ms=1000) as (bus, peer):
        driver = device(bus, "timer")
        await driver.connect()
        for _ in range(3):
            heard = peer.sent[LAST_TPDO]
            good, broken = await readings_of(driver)
            assert good.value == pytest.approx(-12.34)
            assert broken.quality is Quality.SENSOR_FAULT
            async with asyncio.timeout(60.0):
                while peer.sent[LAST_TPDO] == heard:  # its timer brings the next values
                    await asyncio.sleep(0.01)


async def test_its_emergency_explains_the_fault(wire: tuple[Bus, PeerNode]) -> None:
    bus, peer = wire
    driver = device(bus)
    await driver.connect()
    peer.tell("emergency ff30 81")
    async with asyncio.timeout(60.0):
        while "emergency" not in (detail := (await readings_of(driver))[1].detail):
            await asyncio.sleep(0.01)
    assert detail == "sensor fault; the node reports emergency 0xFF30, error register 0x81"


async def test_its_heartbeat_is_watched(wire: tuple[Bus, PeerNode]) -> None:
    bus, peer = wire
    driver = device(bus)
    await driver.connect()
    async with asyncio.timeout(60.0):
        while peer.sent[0x700 + NODE] < 2:  # only one that has come can stop
            await until(driver, Quality.GOOD)
            await asyncio.sleep(0.01)
    await until(driver, Quality.GOOD)
    peer.tell("stop heartbeat")
    assert "heartbeat stopped" in (await until(driver, Quality.STALE)).detail
    peer.tell("start heartbeat")
    assert (await until(driver, Quality.GOOD)).value == pytest.approx(-12.34)


async def test_object_that_does_not_exist_is_refused(wire: tuple[Bus, PeerNode]) -> None:
    bus, _ = wire
    assert isinstance(bus, CanOpenBus)
    with pytest.raises(Refused, match="6110:03"):
        await bus.upload("node", NODE, [CanObject(0x6110, 3)])
    with pytest.raises(Refused, match="7130:01"):
        await bus.upload("node", NODE, [CanObject(0x7130, 1)])


@pytest.mark.parametrize("transfer", ["sdo", "sync"])
async def test_the_same_node_by_its_objects_alone(wire: tuple[Bus, PeerNode], tmp_path: Path, transfer: str) -> None:
    """Without device profile and vendor: index, sub-index, type, scale."""
    profile = tmp_path / "node.toml"
    objects = "".join(f'[[object]]\nindex = 0x9130\nsubindex = {i}\ntype = "int32"\nscale = 0.01\n' for i in (1, 2))
    profile.write_text(f'protocol = "canopen"\ntitle = "node"\nunit = "degC"\n{objects}')
    options = {"transfer": transfer}
    driver = make_device("node", wire[0], str(profile), NODE, {"a": 0, "b": 1}, options, SystemClock())
    await driver.connect()
    assert [r.value for r in await readings_of(driver)] == pytest.approx([-12.34, 850.0])
