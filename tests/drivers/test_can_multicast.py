"""CANopen between two bus objects over UDP multicast, as between two programs."""

import socket
from collections.abc import Iterator

import pytest

from drivers.base import NoAnswer, SystemClock
from drivers.build import make_bus, make_device
from simulators.devices.cia404_node import Cia404Node
from simulators.devices.multicast_bus import MulticastBus

GROUP = "239.74.163.2"
TEMPERATURES = [20.0, -3.3]


@pytest.fixture
def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def wire(free_port: int) -> Iterator[MulticastBus]:
    bus = MulticastBus([Cia404Node(5, lambda: TEMPERATURES, inputs=2)], GROUP, free_port)
    bus.start()
    yield bus
    bus.stop()


@pytest.mark.parametrize("transfer", ["sdo", "sync"])
async def test_node_is_read_until_it_leaves_and_again_when_it_is_back(
    wire: MulticastBus, free_port: int, transfer: str
) -> None:
    options = {"interface": "udp_multicast", "channel": GROUP, "port": free_port, "timeout_s": 0.5}
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
