"""CANopen between two bus objects over UDP multicast, as between two programs."""

from collections.abc import Iterator
from queue import Queue

import pytest

from drivers.base import NoAnswer, SystemClock
from drivers.build import make_device
from simulators.devices import Cia404Node
from simulators.devices.multicast_bus import MulticastBus
from tests.benches.buses import make_bus
from tests.benches.free_port import free_port

pytestmark = pytest.mark.simulated_time

GROUP = "239.74.163.2"
TEMPERATURES = [20.0, -3.3]


@pytest.fixture
def port() -> int:
    return free_port()


@pytest.fixture
def wire(port: int) -> Iterator[MulticastBus]:
    bus = MulticastBus([Cia404Node(5, lambda: TEMPERATURES, inputs=2)], GROUP, port)
    bus.start()
    yield bus
    bus.stop()


@pytest.mark.parametrize("transfer", ["sdo", "sync"])
async def test_node_is_read_until_it_leaves_and_again_when_it_is_back(
    wire: MulticastBus, port: int, transfer: str
) -> None:
    options = {"interface": "udp_multicast", "channel": GROUP, "port": port, "timeout_s": 0.5}
    bus = make_bus("can1", "canopen", options)
    choice = {"vendor": "jumo", "transfer": transfer}
    driver = make_device("node", bus, "cia404", 5, {"a": 0, "b": 1}, choice, SystemClock())
    try:
        await bus.connect()
        await driver.connect()
        assert [r.value for r in await driver.read()] == pytest.approx(TEMPERATURES)
        wire.stop()
        with pytest.raises(NoAnswer):
            await driver.read()
        wire.start()
        await driver.connect()
        assert [r.value for r in await driver.read()] == pytest.approx(TEMPERATURES)
    finally:
        await driver.close()
        await bus.close()


class FrameLog:
    """A tap that notes the frames it hears."""

    def __init__(self) -> None:
        self.heard: Queue[int] = Queue()

    def on_frame(self, identifier: int, data: bytes) -> tuple[()]:
        del data
        self.heard.put(identifier)
        return ()


def test_an_identifier_of_29_bits_is_received_as_it_was_sent(port: int) -> None:
    """As an emulated device writes it, with bit 31: a player must recognise its own frames."""
    ear, extended = FrameLog(), 1 << 31 | 0x18FEDF00
    bus = MulticastBus([ear], GROUP, port)
    bus.start()
    try:
        bus.send([(extended, b"\x01"), (0x123, b"\x02")])
        assert {ear.heard.get(timeout=60.0) for _ in range(2)} == {extended, 0x123}
    finally:
        bus.stop()
