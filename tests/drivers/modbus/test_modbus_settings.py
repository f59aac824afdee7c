"""A module set to another data format sends other numbers for the same temperatures: it is refused."""

from collections.abc import AsyncIterator

import pytest

from drivers.base import Driver, NoAnswer, Quality, Refused, SystemClock, WrongDevice
from drivers.build import make_device
from simulators.devices import M7015, RtuLine
from tests.benches.buses import make_bus

pytestmark = pytest.mark.simulated_time

ROOM = [21.3, 10.0, 5.0, 21.3, 21.3, 21.3]


@pytest.fixture
def module() -> M7015:
    return M7015(lambda: ROOM)


@pytest.fixture
async def driver(module: M7015) -> AsyncIterator[Driver]:
    line = RtuLine({1: module})
    bus = make_bus("rtu1", "modbus_rtu", {"port": await line.start(), "timeout_s": 0.1})
    await bus.connect()
    yield make_device("rtd1", bus, "icpdas_m7015", 1, {"bed": 0, "oil": 1}, {}, SystemClock())
    await bus.close()
    await line.stop()


REFUSED = (
    r"data format \(coil 00269\) is 0, which profile icpdas_m7015 cannot read \(set the module to engineering format, 1"
)


async def test_module_in_hexadecimal_format_is_refused(module: M7015, driver: Driver) -> None:
    module.engineering = False
    assert module.memory(4)[1] == 1638, "10 degC, as a part of 200 degC, would be read as 163.8"
    for ask in (driver.connect, driver.read):
        with pytest.raises(WrongDevice, match=REFUSED):
            await ask()
    module.engineering = True
    await driver.connect()
    assert [r.value for r in await driver.read()] == pytest.approx([21.3, 10.0])


async def test_module_that_was_silent_is_checked_again(module: M7015, driver: Driver) -> None:
    await driver.connect()
    await driver.read()
    module.faults.silent = True
    with pytest.raises(NoAnswer):
        await driver.read()
    module.faults.silent, module.engineering = False, False
    with pytest.raises(WrongDevice, match=REFUSED):
        await driver.read()
    module.engineering = True
    assert {r.quality for r in await driver.read()} == {Quality.GOOD}


async def test_module_that_does_not_tell_its_format_is_refused(
    module: M7015, driver: Driver, monkeypatch: pytest.MonkeyPatch
) -> None:
    held = module.memory
    monkeypatch.setattr(module, "memory", lambda function: {} if function == 1 else held(function))
    with pytest.raises(Refused, match="function 1, address 268"):
        await driver.connect()
