"""TPDOs after SYNC or by timer: the node's mapping is read and used, or refused with a reason."""

import asyncio
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.base import Driver, NoAnswer, Quality, SystemClock, WrongDevice
from drivers.build import make_device
from drivers.canopen.pdo import pdo_map
from drivers.canopen.place import CanObject
from simulators.devices import Cia404Node, SlcanAdapter
from simulators.devices.slcan_adapter import CanFrame
from tests.benches.buses import make_bus
from tests.benches.driver_reads import read_until_error

pytestmark = pytest.mark.simulated_time

TEMPERATURES = [20.0, -3.3, 40.5, 55.1, 60.0, 70.0]


@asynccontextmanager
async def bench(node: Cia404Node, inputs: int, transfer: str = "sync") -> AsyncIterator[tuple[SlcanAdapter, Driver]]:
    adapter = SlcanAdapter([node])
    bus = make_bus("can1", "canopen", {"interface": "slcan", "channel": await adapter.start(), "timeout_s": 0.2})
    channels = {f"c{i}": i for i in range(inputs)}
    driver = make_device("node", bus, "cia404", 5, channels, {"vendor": "jumo", "transfer": transfer}, SystemClock())
    try:
        await bus.connect()
        node.start(adapter.send)
        yield adapter, driver
    finally:
        node.stop()
        await bus.close()
        await adapter.stop()


def test_mapping_of_the_standards_form() -> None:
    """Two int32 process values in one frame: entries 9130 0120 and 9130 0220 (CiA 301, object 1A00)."""
    pdo = pdo_map(0x185, [0x91300120, 0x91300220])
    assert pdo is not None
    assert pdo.identifier == 0x185
    assert pdo.decode(bytes.fromhex("C8000000 DFFFFFFF")) == {
        CanObject(0x9130, 1): bytes.fromhex("C8000000"),
        CanObject(0x9130, 2): bytes.fromhex("DFFFFFFF"),
    }


def test_tpdo_that_is_off_or_empty_is_ignored() -> None:
    assert pdo_map(0x80000185, [0x91300120]) is None
    assert pdo_map(0x185, []) is None


@pytest.mark.parametrize(
    ("mapped", "places"),
    [
        ([0x91300104], {}),
        ([0x91300120, 0x91300220, 0x61500108], {(0x9130, 1): (0, 4), (0x9130, 2): (4, 4)}),
        ([0x21000101, 0x21000201, 0x00050006, 0x91300120], {(0x9130, 1): (1, 4)}),
        ([0x91300120, 0x21000190, 0x91300220], {(0x9130, 1): (0, 4)}),
    ],
)
def test_entries_that_are_no_whole_bytes_of_a_frame_are_left_out(
    mapped: list[int], places: dict[tuple[int, int], tuple[int, int]]
) -> None:
    pdo = pdo_map(0x185, mapped)
    assert pdo is not None
    assert pdo.places == {CanObject(*place): where for place, where in places.items()}


@given(st.lists(st.integers(0, 2**32 - 1), max_size=8), st.binary(max_size=8))
def test_any_mapping_and_frame_give_whole_objects(mapped: list[int], data: bytes) -> None:
    pdo = pdo_map(0x185, mapped)
    if pdo is not None:
        for place, part in pdo.decode(data).items():
            assert len(part) == pdo.places[place][1]
            assert part in data


async def test_values_and_status_of_six_inputs() -> None:
    node = Cia404Node(5, lambda: TEMPERATURES, inputs=6)
    async with bench(node, 6) as (_, driver):
        await driver.connect()
        readings = await driver.read()
    assert [r.value for r in readings] == pytest.approx(TEMPERATURES)
    assert {r.quality for r in readings} == {Quality.GOOD}


async def test_inputs_in_no_tpdo_are_refused() -> None:
    node = Cia404Node(5, lambda: [20.0] * 8, inputs=8)
    async with bench(node, 8) as (_, driver):
        with pytest.raises(WrongDevice, match=r"6150:07 is not mapped to any TPDO \(map it, or use transfer = 'sdo'\)"):
            await driver.connect()


async def test_tpdos_on_events_are_refused() -> None:
    node = Cia404Node(5, lambda: TEMPERATURES, inputs=6)
    node.set_transmission_type(254)
    async with bench(node, 2) as (_, driver):
        with pytest.raises(WrongDevice, match="TPDO 1 has transmission type 254, not 1"):
            await driver.connect()


async def test_node_that_restarts_between_two_reads_is_made_operational_again() -> None:
    node = Cia404Node(5, lambda: TEMPERATURES, inputs=6)
    async with bench(node, 6) as (_, driver):
        await driver.connect()
        await driver.read()
        node.on_frame(0, bytes((129, 5)))  # power cut: its boot-up frame is lost
        with pytest.raises(NoAnswer, match="TPDO 0x185, 0x285, 0x385, 0x485 did not arrive after SYNC"):
            await driver.read()
        assert [r.value for r in await driver.read()] == pytest.approx(TEMPERATURES)


def timed(event_ms: int = 80, *values: float) -> Cia404Node:
    return Cia404Node(5, lambda: values or TEMPERATURES, inputs=2, event_ms=event_ms)


async def test_node_sends_by_its_timer_and_is_asked_for_nothing() -> None:
    asked = []

    class Counting(Cia404Node):
        def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
            asked.append(identifier)
            return super().on_frame(identifier, data)

    temperatures = [20.0, -3.3]
    node = Counting(5, lambda: temperatures, inputs=2, event_ms=80)
    async with bench(node, 2, "timer") as (_, driver):
        await driver.connect()
        assert [r.value for r in await driver.read()] == pytest.approx([20.0, -3.3])
        asked.clear()
        temperatures[0] = 21.5
        async with asyncio.timeout(2):
            while (await driver.read())[0].value != pytest.approx(21.5):
                await asyncio.sleep(0.005)
    assert asked == []


async def test_first_read_takes_what_came_since_the_node_was_started() -> None:
    """It does not wait for the next frames, which a node with a slow clock sends too late."""
    node = timed()
    async with bench(node, 2, "timer") as (_, driver):
        await driver.connect()
        await asyncio.sleep(0.1)
        node.stop()
        assert [r.value for r in await driver.read()] == pytest.approx(TEMPERATURES[:2])


async def ages(driver: Driver) -> list[float]:
    """The age of each channel, s."""
    readings, now_s = await driver.read(), SystemClock().monotonic()
    assert {r.quality for r in readings} == {Quality.GOOD}
    return [now_s - r.monotonic_s for r in readings]


async def test_a_timed_value_is_as_old_as_its_frame() -> None:
    node = timed()
    async with bench(node, 2, "timer") as (_, driver):
        await driver.connect()
        assert await ages(driver) == pytest.approx([0.0, 0.0], abs=1e-3), "the frame that was waited for"
        await asyncio.sleep(0.05)
        assert await ages(driver) == pytest.approx([0.05, 0.05], abs=1e-3), "the same one"
        await asyncio.sleep(0.05)
        assert await ages(driver) == pytest.approx([0.02, 0.02], abs=1e-3), "the next one, 0.08 s after the first"


async def test_a_timed_value_is_as_old_as_the_status_that_it_is_judged_by() -> None:
    """A sensor may have broken since."""
    node = timed()
    async with bench(node, 2, "timer") as (adapter, driver):
        await driver.connect()
        await driver.read()
        node.stop()
        await asyncio.sleep(0.05)
        adapter.send([(0x185, b"".join(round(10 * value).to_bytes(4, "little", signed=True) for value in (21.5, 7.0)))])
        await asyncio.sleep(0.05)
        assert [r.value for r in await driver.read()] == pytest.approx([21.5, 7.0])
        assert await ages(driver) == pytest.approx([0.1, 0.1], abs=1e-3)


async def test_a_value_that_was_asked_for_is_as_old_as_its_answer() -> None:
    async with bench(timed(), 2, "sdo") as (_, driver):
        await driver.connect()
        await asyncio.sleep(0.05)
        assert await ages(driver) == pytest.approx([0.0, 0.0], abs=1e-3)


async def test_timed_values_that_stop_give_no_answer_and_no_earlier_one_is_taken() -> None:
    node = timed()
    async with bench(node, 2, "timer") as (_, driver):
        await driver.connect()
        await driver.read()
        node.faults.silent = True
        begun = time.monotonic()
        with pytest.raises(NoAnswer, match="TPDO 0x185, 0x285 did not arrive on the node's timer"):
            await read_until_error(driver)
        assert time.monotonic() - begun >= 2 * 0.08  # three times the timer, less the frame that had just come
        with pytest.raises(NoAnswer, match="no answer"):
            await driver.read()
        node.faults.silent = False
        assert [r.value for r in await driver.read()] == pytest.approx(TEMPERATURES[:2])


async def test_node_that_restarts_is_made_operational_before_its_values_are_due_again() -> None:
    node = timed()
    async with bench(node, 2, "timer") as (adapter, driver):
        await driver.connect()
        await driver.read()
        adapter.send(node.on_frame(0, bytes((129, 5))))  # boots, and waits in the state before
        await asyncio.sleep(0.05)
        for _ in range(3):
            assert [r.value for r in await driver.read()] == pytest.approx(TEMPERATURES[:2])


async def test_what_a_node_sent_before_it_restarted_is_not_taken() -> None:
    """200 with one digit is 20.0, and would be 200 without."""
    node = Cia404Node(5, lambda: [20.0, 30.0], inputs=2, event_ms=80)
    async with bench(node, 2, "timer") as (adapter, driver):
        await driver.connect()
        await driver.read()
        node.set_digits(0)
        adapter.send(node.reboot())
        await asyncio.sleep(0.01)
        for _ in range(3):
            assert [r.value for r in await driver.read()] == [20.0, 30.0]


@pytest.mark.parametrize(
    ("event_ms", "kind", "says"),
    [
        (0, 1, "TPDO 1 has transmission type 1, not 255"),
        (0, 255, "TPDO 1 is never sent on a timer, but timeout_s = 0.2"),
        (250, 255, r"every 0.25 s, but timeout_s = 0.2 \(set object 1800:05 to less"),
    ],
)
async def test_node_without_a_fitting_timer_is_refused(event_ms: int, kind: int, says: str) -> None:
    node = timed(event_ms)
    node.set_transmission_type(kind)
    async with bench(node, 2, "timer") as (_, driver):
        with pytest.raises(WrongDevice, match=says):
            await driver.connect()
