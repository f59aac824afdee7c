"""A node of a third-party library, on a virtual interface."""

from collections.abc import Iterator

import canopen
import pytest
from canopen.objectdictionary import ODArray, ODVariable
from canopen.objectdictionary.datatypes import INTEGER32, UNSIGNED8, UNSIGNED16, UNSIGNED32

from drivers.base import Quality, SystemClock
from drivers.build import make_device
from tests.benches.buses import make_bus

pytestmark = pytest.mark.simulated_time


def _variable(name: str, index: int, subindex: int, kind: int, value: int) -> ODVariable:
    variable = ODVariable(name, index, subindex)
    variable.data_type, variable.access_type, variable.default = kind, "ro", value
    return variable


def _dictionary() -> canopen.ObjectDictionary:
    dictionary = canopen.ObjectDictionary()  # type: ignore[no-untyped-call]
    dictionary.add_object(_variable("device type", 0x1000, 0, UNSIGNED32, 0x20000 + 404))
    for index, kind, values in (
        (0x6110, UNSIGNED16, (30, 30)),
        (0x6131, UNSIGNED32, (0x002D0000, 0x002D0000)),
        (0x6132, UNSIGNED8, (2, 2)),
        (0x6150, UNSIGNED8, (0, 1)),
        (0x9130, INTEGER32, (-1234, 0)),
    ):
        array = ODArray(f"array {index:04X}", index)
        array.add_member(_variable("count", index, 0, UNSIGNED8, 2))
        for subindex, value in enumerate(values, start=1):
            array.add_member(_variable(f"input {subindex}", index, subindex, kind, value))
        dictionary.add_object(array)
    return dictionary


VIRTUAL: dict[str, object] = {"interface": "virtual", "channel": "test_canopen_library_node"}


@pytest.fixture
def local_node() -> Iterator[dict[str, object]]:
    """A node of the canopen library on a virtual interface; gives the bus options to reach it."""
    network = canopen.Network()
    network.NOTIFIER_CYCLE = 0.1
    network.connect(**VIRTUAL)
    network.add_node(canopen.LocalNode(5, _dictionary()))
    yield VIRTUAL
    network.disconnect()


async def test_node_of_the_canopen_library_is_read(local_node: dict[str, object]) -> None:
    bus = make_bus("can1", "canopen", local_node | {"timeout_s": 1.0})
    driver = make_device("node", bus, "cia404", 5, {"a": 0, "b": 1}, {"vendor": "jumo"}, SystemClock())
    try:
        await bus.connect()
        await driver.connect()
        good, broken = await driver.read()
    finally:
        await bus.close()
    assert good.quality is Quality.GOOD
    assert good.value == pytest.approx(-12.34)
    assert broken.quality is Quality.SENSOR_FAULT
