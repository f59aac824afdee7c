"""CANopen: restarting nodes, emergencies, foreign frames."""

import asyncio
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from importlib.resources import files
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.base import BadAnswer, ConnectError, Driver, NoAnswer, Quality, Reading, Refused, SystemClock, WrongDevice
from drivers.build import make_device
from drivers.canopen.events import NodeEvents
from simulators.devices import Cia404Node, SlcanAdapter
from simulators.devices.slcan_adapter import CanFrame
from simulators.devices.source import SensorFault
from tests.benches.buses import make_bus

pytestmark = pytest.mark.simulated_time

TEMPERATURES = [20.0, -3.3]
JUMO: dict[str, object] = {"vendor": "jumo"}


@asynccontextmanager
async def bench(
    node: Cia404Node, node_id: int = 5, profile: str = "cia404", **chosen: float | str | None
) -> AsyncIterator[tuple[SlcanAdapter, Driver]]:
    adapter = SlcanAdapter([node])
    options = {"interface": "slcan", "channel": await adapter.start(), "timeout_s": 0.1}
    bus = make_bus("can1", "canopen", options)
    given = {key: value for key, value in {**JUMO, **chosen}.items() if value is not None}
    driver = make_device("node", bus, profile, node_id, {"a": 0, "b": 1}, given, SystemClock())
    try:
        await bus.connect()
        yield adapter, driver
    finally:
        await bus.close()
        await adapter.stop()


@pytest.fixture
def node() -> Cia404Node:
    return Cia404Node(5, lambda: TEMPERATURES, inputs=2)


async def passed(adapter: SlcanAdapter, *frames: CanFrame) -> None:
    """Send the frames, and let the receiving thread see them."""
    adapter.send(frames)
    await asyncio.sleep(0.05)


@pytest.mark.parametrize(("digits", "temperature"), [(0, -3.0), (1, -3.3), (2, -3.3)])
async def test_values_of_16_bits_are_read_when_a_profile_says_so(
    tmp_path: Path, digits: int, temperature: float
) -> None:
    supplied = (files("drivers") / "profiles" / "cia404.toml").read_text(encoding="utf-8")
    (tmp_path / "short.toml").write_text(supplied.replace('object = "9130"', 'object = "7130"'), encoding="utf-8")
    node = Cia404Node(5, lambda: TEMPERATURES, inputs=2, digits=digits)
    async with bench(node, profile=str(tmp_path / "short.toml")) as (_, driver):
        await driver.connect()
        assert [r.value for r in await driver.read()] == pytest.approx([20.0, temperature])


@pytest.mark.parametrize("with_table", [True, False])
async def test_a_node_without_a_vendor_is_read_and_any_bit_of_its_status_is_a_broken_sensor(
    node: Cia404Node, with_table: bool, tmp_path: Path
) -> None:
    supplied = (files("drivers") / "profiles" / "cia404.toml").read_text(encoding="utf-8")
    (tmp_path / "without.toml").write_text(supplied[: supplied.index("[vendor.")], encoding="utf-8")
    node.faults.set(1, SensorFault.OVER)
    profile = "cia404" if with_table else str(tmp_path / "without.toml")
    async with bench(node, profile=profile, vendor=None) as (_, driver):
        await driver.connect()
        good, broken = await driver.read()
    assert good.quality is Quality.GOOD
    assert good.value == pytest.approx(20.0)
    assert (broken.quality, broken.detail) == (
        Quality.SENSOR_FAULT,
        "status 0x02, which the profile does not define",
    )


@pytest.mark.parametrize("digits", [10, 0x7F, 0x80, 0xFF])
async def test_decimal_digits_that_no_value_of_32_bits_has_are_refused(digits: int) -> None:
    """An erased memory contains 0xFF; read as -1 it made 235.0 of 23.5."""
    async with bench(Cia404Node(5, lambda: TEMPERATURES, inputs=2, digits=digits)) as (_, driver):
        with pytest.raises(WrongDevice, match=f"{digits} decimal digits at input 0: a 32-bit value has at most 9"):
            await driver.connect()


async def test_sensors_are_checked_again_after_the_node_restarted(node: Cia404Node) -> None:
    async with bench(node) as (adapter, driver):
        await driver.connect()
        await driver.read()
        node.set_sensor_type(1, 1)
        assert len(await driver.read()) == 2  # it sent no boot-up
        await passed(adapter, (0x705, b"\0"))
        with pytest.raises(WrongDevice, match="sensor type 1 at input 1"):
            await driver.read()
        node.set_sensor_type(1, 30)
        assert [r.value for r in await driver.read()] == pytest.approx(TEMPERATURES)


class Restarting(Cia404Node):
    """Restarts after every `after` SDO requests, with other sensors at its inputs; `starts` times in all."""

    def __init__(self, after: int, starts: int, sensor_type: int) -> None:
        super().__init__(5, lambda: [21.0 + self.booted] * 2, inputs=2)
        self.after, self.starts, self.sensor_type, self.requests, self.booted = after, starts, sensor_type, 0, 0

    def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
        frames = super().on_frame(identifier, data)
        if identifier != 0x605 or self.booted == self.starts:
            return frames
        self.requests += 1
        if self.requests < self.after:
            return frames
        self.requests, self.booted = 0, self.booted + 1
        self.set_sensor_type(0, self.sensor_type)
        return *frames, (0x705, b"\0")


SDOS_OF_A_READ = 6
"""Status, value, status of two inputs. A start after the last is one between two reads."""


@pytest.mark.parametrize("after", range(1, SDOS_OF_A_READ))
async def test_node_that_restarts_while_it_is_read_is_checked_before_anything_is_taken(after: int) -> None:
    node = Restarting(after, 0, sensor_type=1)
    async with bench(node) as (_, driver):
        await driver.connect()
        node.starts = 1
        with pytest.raises(WrongDevice, match="sensor type 1 at input 0"):
            await driver.read()


@pytest.mark.parametrize("after", range(1, SDOS_OF_A_READ))
async def test_node_that_restarted_while_it_was_read_is_read_again(after: int) -> None:
    node = Restarting(after, 0, sensor_type=30)
    async with bench(node) as (_, driver):
        await driver.connect()
        node.starts = 1
        assert [r.value for r in await driver.read()] == [22.0, 22.0]


async def test_node_that_restarts_again_and_again_gives_no_value() -> None:
    node = Restarting(SDOS_OF_A_READ - 1, 0, sensor_type=30)
    async with bench(node) as (_, driver):
        await driver.connect()
        node.starts = 50
        with pytest.raises(BadAnswer, match=r"node 5 restarted twice while it was read \(check its power supply"):
            await driver.read()
        node.starts = node.booted
        assert (await driver.read())[0].quality is Quality.GOOD


async def test_emergency_explains_a_fault_until_it_is_cleared(node: Cia404Node) -> None:
    node.faults.set(0, SensorFault.OPEN)
    async with bench(node) as (adapter, driver):
        assert (await driver.read())[0].detail == "sensor fault"
        await passed(adapter, (0x085, bytes.fromhex("30 FF 81 00 00 00 00 00")))
        broken, good = await driver.read()
        assert broken.detail == "sensor fault; the node reports emergency 0xFF30, error register 0x81"
        assert good.quality is Quality.GOOD
        await passed(adapter, (0x085, bytes(8)))
        assert (await driver.read())[0].detail == "sensor fault"


@pytest.mark.parametrize("breaks", [True, False])
async def test_sensor_that_breaks_or_recovers_while_it_is_read_gives_no_value(breaks: bool) -> None:
    """A broken input of this node shows the end of the range; only the status reports it."""

    class Flickering(Cia404Node):
        def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
            value_is_read = identifier == 0x605 and data[:4] == bytes.fromhex("40 30 91 01")
            if value_is_read and breaks:
                self.faults.set(0, SensorFault.OPEN)
            frames = super().on_frame(identifier, data)
            if value_is_read and not breaks:
                self.faults.set(0, None)
            return frames

    node = Flickering(5, lambda: TEMPERATURES, inputs=2)
    async with bench(node) as (_, driver):
        await driver.connect()
        if not breaks:
            node.faults.set(0, SensorFault.OPEN)
        broken, good = await driver.read()
    assert broken.quality is Quality.SENSOR_FAULT
    assert good.value == pytest.approx(-3.3)


async def test_storm_of_emergencies_does_not_disturb_reading(node: Cia404Node) -> None:
    async with bench(node) as (adapter, driver):
        await driver.connect()
        for _ in range(20):
            adapter.send([(0x085, bytes.fromhex("00 10 01 00 00 00 00 00"))] * 20)
            assert [r.value for r in await driver.read()] == pytest.approx(TEMPERATURES)


async def test_answers_of_other_nodes_and_objects_are_not_taken(node: Cia404Node) -> None:
    async with bench(node) as (adapter, driver):
        await driver.connect()
        adapter.send([(0x586, bytes.fromhex("43 30 91 01 63 00 00 00"))])
        assert [r.value for r in await driver.read()] == pytest.approx(TEMPERATURES)


async def test_answer_after_the_timeout_is_not_taken_for_the_next(node: Cia404Node) -> None:
    async with bench(node) as (adapter, driver):
        await driver.connect()
        node.faults.silent = True
        with pytest.raises(NoAnswer):
            await driver.read()
        node.faults.silent = False
        adapter.send([(0x585, bytes.fromhex("43 30 91 01 63 00 00 00"))])
        await asyncio.sleep(0.02)
        assert [r.value for r in await driver.read()] == pytest.approx(TEMPERATURES)


async def test_garbage_from_the_adapter_is_survived(node: Cia404Node) -> None:
    async with bench(node) as (adapter, driver):
        await driver.connect()
        adapter.send([(0x7FF, b""), (0x000, bytes(8)), (0x705, b""), (0x085, b"\x01")])
        assert [r.value for r in await driver.read()] == pytest.approx(TEMPERATURES)


async def turned(driver: Driver, quality: Quality) -> list[Reading]:
    """The first readings with this quality; all earlier ones have the other."""
    async with asyncio.timeout(60.0):
        while (readings := list(await driver.read()))[0].quality is not quality:
            await asyncio.sleep(0.005)
    return readings


async def test_node_that_answers_without_a_heartbeat_is_stale_until_it_beats_again() -> None:
    node = Cia404Node(5, lambda: TEMPERATURES, inputs=2, heartbeat_ms=50)
    node.faults.set(1, SensorFault.OPEN)
    async with bench(node) as (adapter, driver):
        node.start(adapter.send)
        try:
            await driver.connect()
            begun = time.monotonic()
            while time.monotonic() < begun + 0.5:
                assert (await driver.read())[0].quality is Quality.GOOD
                await asyncio.sleep(0.01)
            node.heartbeat_stopped = True
            stopped = time.monotonic()
            stale, broken = await turned(driver, Quality.STALE)
            assert time.monotonic() - stopped >= 2 * 0.05  # three beats less the one that was just sent
            assert "heartbeat stopped" in stale.detail
            assert broken.quality is Quality.SENSOR_FAULT
            await driver.close()
            await driver.connect()
            assert (await driver.read())[0].quality is Quality.STALE  # connecting heals nothing
            node.heartbeat_stopped = False
            assert (await turned(driver, Quality.GOOD))[0].value == pytest.approx(20.0)
        finally:
            node.stop()


async def test_consumer_time_of_the_configuration_counts() -> None:
    node = Cia404Node(5, lambda: TEMPERATURES, inputs=2, heartbeat_ms=20)
    async with bench(node, heartbeat_s=0.4) as (_, driver):  # a node that never beats
        begun = time.monotonic()
        await driver.connect()
        await turned(driver, Quality.STALE)
        assert 0.4 <= time.monotonic() - begun < 2.0


@pytest.mark.parametrize(("sends_ms", "words"), [(0, "never"), (500, "every 0.5 s")])
async def test_node_that_cannot_keep_the_consumer_time_is_refused(sends_ms: int, words: str) -> None:
    node = Cia404Node(5, lambda: TEMPERATURES, inputs=2, heartbeat_ms=sends_ms)
    async with bench(node, heartbeat_s=0.4) as (_, driver):
        with pytest.raises(WrongDevice, match=f"sends its heartbeat {words}, but heartbeat_s = 0.4"):
            await driver.connect()


async def test_another_device_profile_is_refused() -> None:
    class Drive(Cia404Node):
        def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
            if identifier == 0x605 and data[:4] == b"\x40\x00\x10\x00":
                return [(0x585, b"\x43" + data[1:4] + (402).to_bytes(4, "little"))]
            return super().on_frame(identifier, data)

    async with bench(Drive(5, lambda: TEMPERATURES, inputs=2)) as (_, driver):
        with pytest.raises(WrongDevice, match="device profile 402, not 404"):
            await driver.connect()


async def test_node_without_any_of_the_inputs_is_refused() -> None:
    async with bench(Cia404Node(5, list, inputs=0)) as (_, driver):
        with pytest.raises(Refused, match="6110:01"):
            await driver.connect()


@pytest.mark.parametrize("transfer", ["sdo", "sync"])
async def test_input_that_does_not_exist_takes_its_own_channel_only(transfer: str) -> None:
    node = Cia404Node(5, lambda: [20.0], inputs=1)
    async with bench(node, transfer=transfer) as (_, driver):
        await driver.connect()
        there, absent = await driver.read()
        assert there.quality is Quality.GOOD
        assert there.value == pytest.approx(20.0)
        assert absent.quality is Quality.COMM_FAULT
        assert "6110:02" in absent.detail


async def test_input_that_was_refused_once_is_read_when_it_answers() -> None:
    class Late(Cia404Node):
        refuses = True

        def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
            if self.refuses and identifier == 0x605 and data[:4] == b"\x40\x10\x61\x02":
                return [(0x585, b"\x80" + data[1:4] + (0x08000022).to_bytes(4, "little"))]
            return super().on_frame(identifier, data)

    node = Late(5, lambda: TEMPERATURES, inputs=2)
    async with bench(node) as (_, driver):
        await driver.connect()
        assert [r.quality for r in await driver.read()] == [Quality.GOOD, Quality.COMM_FAULT]
        node.refuses = False
        await driver.read()
        assert (await driver.read())[1].value == pytest.approx(TEMPERATURES[1])


async def test_four_channels_take_less_than_15_ms() -> None:
    node = Cia404Node(5, lambda: [20.0] * 4, inputs=4)
    adapter = SlcanAdapter([node])
    bus = make_bus("can1", "canopen", {"interface": "slcan", "channel": await adapter.start()})
    driver = make_device("node", bus, "cia404", 5, {f"c{i}": i for i in range(4)}, JUMO, SystemClock())
    try:
        await bus.connect()
        await driver.connect()
        times = []
        for _ in range(30):
            started = time.perf_counter()
            await driver.read()
            times.append(time.perf_counter() - started)
    finally:
        await bus.close()
        await adapter.stop()
    assert sorted(times)[15] < 0.015


@given(st.lists(st.tuples(st.booleans(), st.binary(max_size=8))))
def test_any_frames_from_a_node_are_survived(frames: list[tuple[bool, bytes]]) -> None:
    events = NodeEvents()
    for heartbeat, data in frames:
        (events.on_heartbeat if heartbeat else events.on_emergency)(0, data, 0.0)
    assert events.boots == sum(heartbeat and data[:1] == b"\0" for heartbeat, data in frames)


async def test_adapter_that_another_program_has_is_not_disturbed(node: Cia404Node) -> None:
    """Two programs on one slcan adapter would take each other's frames."""
    adapter = SlcanAdapter([node])
    options = {"interface": "slcan", "channel": await adapter.start(), "timeout_s": 0.1}
    first, second = make_bus("can1", "canopen", options), make_bus("can2", "canopen", options)
    driver = make_device("node", first, "cia404", 5, {"a": 0}, JUMO, SystemClock())
    try:
        await first.connect()
        await driver.connect()
        with pytest.raises(ConnectError, match="another program has it open"):
            await second.connect()
        assert (await driver.read())[0].quality is Quality.GOOD
    finally:
        await second.close()
        await first.close()
        await adapter.stop()
