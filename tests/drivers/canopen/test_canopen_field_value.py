"""Values of CANopen nodes other than the usual one: field values, which the profile scales, and their sizes."""

import re
import struct
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from importlib.resources import files
from pathlib import Path

import pytest

from drivers.base import Driver, Quality, SetupError, SystemClock, WrongDevice
from drivers.build import make_device
from drivers.profiles import load_profile
from simulators.devices import Cia404Node, SlcanAdapter
from simulators.devices.slcan_adapter import CanFrame
from simulators.devices.source import SensorFault
from tests.benches.buses import make_bus
from tests.benches.refusals import refusing

pytestmark = pytest.mark.simulated_time

NODE, TEMPERATURES = 5, [20.0, -3.3]
SUPPLIED = (files("drivers") / "profiles" / "cia404.toml").read_text(encoding="utf-8")
PHYSICAL_UNIT = re.compile(r"\[physical_unit\]\n.*\n")
COUNTS = "scale = 0.05\noffset = -200.0"
"""The emulated converter sends 4000 at 0 degC and 20 more for each degree."""


def field_profile(folder: Path, index: str, scaling: str = COUNTS) -> str:
    text = SUPPLIED.replace('object = "9130"', f'object = "{index}"\n{scaling}')
    (folder / "field.toml").write_text(PHYSICAL_UNIT.sub("", text), encoding="utf-8")
    return str(folder / "field.toml")


@asynccontextmanager
async def bench(node: Cia404Node, profile: str, transfer: str) -> AsyncIterator[Driver]:
    adapter = SlcanAdapter([node])
    bus = make_bus("can1", "canopen", {"interface": "slcan", "channel": await adapter.start(), "timeout_s": 0.2})
    options = {"vendor": "jumo", "transfer": transfer}
    driver = make_device("node", bus, profile, NODE, {"a": 0, "b": 1}, options, SystemClock())
    try:
        await bus.connect()
        yield driver
    finally:
        await bus.close()
        await adapter.stop()


@pytest.mark.parametrize("index", ["7100", "9100"])
@pytest.mark.parametrize("transfer", ["sdo", "sync"])
@pytest.mark.parametrize("digits", [0, 3])
async def test_field_value_is_scaled_by_the_profile_alone(
    tmp_path: Path, index: str, transfer: str, digits: int
) -> None:
    node = Cia404Node(NODE, lambda: TEMPERATURES, inputs=2, digits=digits, mapped=int(index, 16))
    async with bench(node, field_profile(tmp_path, index), transfer) as driver:
        await driver.connect()
        readings = await driver.read()
        assert [r.value for r in readings] == pytest.approx(TEMPERATURES)
        assert {(r.quality, r.unit) for r in readings} == {(Quality.GOOD, "degC")}
        node.faults.set(0, SensorFault.OPEN)
        assert [r.quality for r in await driver.read()] == [Quality.SENSOR_FAULT, Quality.GOOD]


async def test_sensor_type_is_still_checked(tmp_path: Path) -> None:
    node = Cia404Node(NODE, lambda: TEMPERATURES, inputs=2, sensor_types=[30, 1])
    async with bench(node, field_profile(tmp_path, "7100"), "sdo") as driver:
        with pytest.raises(WrongDevice, match="sensor type 1 at input 1"):
            await driver.connect()


@pytest.mark.parametrize(
    ("index", "scaling", "says"),
    [
        ("7100", "", "value.scale: cia404_no_scale"),
        ("7100", "scale = 0.0", "value.scale: zero_scale"),
        ("9100", "scale = inf", "value.scale: expected value=inf a_finite_number"),
        ("7110", COUNTS, "value.object: invalid value='7110' mean name=7130"),
    ],
)
def test_field_value_without_a_scaling_is_refused(tmp_path: Path, index: str, scaling: str, says: str) -> None:
    with refusing(SetupError, says):
        load_profile(field_profile(tmp_path, index, scaling))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            SUPPLIED.replace('object = "9130"', f'object = "7100"\n{COUNTS}'),
            "physical_unit: cia404_no_unit",
        ),
        (
            SUPPLIED.replace('object = "9130"', 'object = "9130"\nscale = 0.1'),
            "value.scale: cia404_states_scale",
        ),
        (PHYSICAL_UNIT.sub("", SUPPLIED), "physical_unit: cia404_no_physical_unit"),
    ],
)
def test_unit_of_the_node_goes_with_its_process_value(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "mixed.toml").write_text(text, encoding="utf-8")
    with refusing(SetupError, says):
        load_profile(str(tmp_path / "mixed.toml"))


class RawNode(Cia404Node):
    """Sends given counts, one of each input, in place of field values."""

    counts: Sequence[bytes] = ()

    def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
        if identifier == 0x600 + NODE and data[1:3] in (b"\x00\x71", b"\x00\x91") and data[3]:
            raw = self.counts[data[3] - 1]
            return [(0x580 + NODE, bytes((0x43 | 4 - len(raw) << 2,)) + data[1:4] + raw.ljust(4, b"\0"))]
        return super().on_frame(identifier, data)


@pytest.mark.parametrize(("index", "size"), [("7100", 2), ("9100", 4)])
@pytest.mark.parametrize("low", [True, False], ids=["lowest", "highest"])
async def test_the_ends_of_an_objects_range_are_not_values(tmp_path: Path, index: str, size: int, low: bool) -> None:
    raw = -(1 << 8 * size - 1) if low else (1 << 8 * size - 1) - 1
    node = RawNode(NODE, lambda: TEMPERATURES, inputs=2, digits=0, mapped=int(index, 16))
    node.counts = [value.to_bytes(size, "little", signed=True) for value in (raw, raw + (1 if low else -1))]
    async with bench(node, field_profile(tmp_path, index), "sdo") as driver:
        await driver.connect()
        end, last = await driver.read()
    assert (end.quality, last.quality) == (Quality.OUT_OF_RANGE, Quality.GOOD)
    assert end.detail == ("0x8" if low else "0x7") + ("0" if low else "F") * (2 * size - 1) + (
        ", the end of what it can send"
    )


class WideNode(Cia404Node):
    """Sends four bytes of 7130, which has two according to CiA 404."""

    def on_frame(self, identifier: int, data: bytes) -> Sequence[CanFrame]:
        if identifier == 0x600 + NODE and data[:3] == b"\x40\x30\x71":
            return [(0x580 + NODE, b"\x43" + data[1:4] + struct.pack("<i", 40_000))]
        return super().on_frame(identifier, data)


async def test_no_part_of_a_value_with_more_bytes_than_its_object_is_taken(tmp_path: Path) -> None:
    (tmp_path / "wide.toml").write_text(SUPPLIED.replace('object = "9130"', 'object = "7130"'), encoding="utf-8")
    node = WideNode(NODE, lambda: TEMPERATURES, inputs=2, digits=3)
    async with bench(node, str(tmp_path / "wide.toml"), "sdo") as driver:
        await driver.connect()
        readings = await driver.read()
    assert {(r.quality, r.detail) for r in readings} == {(Quality.COMM_FAULT, "object 7130 holds 4 bytes, not 2")}
