"""Whatever a device answers during recognition, the result is usable, or an error with its reason.

The buses here draw from what the real ones may return or raise; other tests show that those return nothing else.
"""

import asyncio
import struct
from collections.abc import Callable, Sequence

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from drivers.base import BadAnswer, ConnectError, DriverError, NoAnswer, Refused, SystemClock
from drivers.build import make_device
from drivers.canopen.bus import CanOpenBus
from drivers.canopen.place import CanObject
from drivers.canopen.profile import Cia404Profile
from drivers.canopen.settings import CanOpenSettings
from drivers.micro_epsilon.ethernet import MeBlock, MeEthernetBus
from drivers.micro_epsilon.rs485 import MeRs485Bus
from drivers.micro_epsilon.settings import MeEthernetSettings, MeRs485Settings
from drivers.modbus.bus import ModbusBus, ModbusTcpBus
from drivers.modbus.numbers import Block
from drivers.modbus.profile import ModbusProfile
from drivers.modbus.rtu import ModbusRtuBus
from drivers.modbus.settings import ModbusRtuSettings, ModbusTcpSettings
from drivers.profiles import load_profile, profile_names
from drivers.recognition import (
    Recognition,
    recognise_canopen,
    recognise_me_ethernet,
    recognise_me_rs485,
    recognise_modbus,
)

pytestmark = pytest.mark.simulated_time

MODBUS = [profile for name in profile_names() if isinstance(profile := load_profile(name), ModbusProfile)]
CODES = sorted({code for profile in MODBUS if profile.type_codes for code in profile.type_codes.spans})
NODE = 5


def raised(*kinds: type[DriverError]) -> st.SearchStrategy[DriverError]:
    return st.sampled_from(kinds).map(lambda kind: kind("as it happens"))


registers = st.one_of(st.integers(0, 0xFFFF), st.sampled_from([*CODES, 750, 464, 0, 1, 200, 1078]))


class DrawnRegisters:
    """Draws what a read of registers gives; the same for the same block."""

    def __init__(self, data: st.DataObject) -> None:
        self._data = data
        self.told: dict[Block, tuple[int, ...] | DriverError] = {}

    def read(self, block: Block) -> tuple[int, ...]:
        if block not in self.told:
            number = st.integers(0, 1) if block.function < 3 else registers
            right = st.lists(number, min_size=block.count, max_size=block.count).map(tuple)
            self.told[block] = self._data.draw(
                st.one_of(right, right, right, raised(Refused, NoAnswer, BadAnswer, ConnectError))
            )
        said = self.told[block]
        if isinstance(said, DriverError):
            raise said
        return said


class RtuUnit(ModbusRtuBus):
    def __init__(self, script: DrawnRegisters) -> None:
        super().__init__("scan", ModbusRtuSettings(port="nowhere"))
        self._script = script

    async def read(self, device: str, unit: int, block: Block, *, again: bool = False) -> tuple[int, ...]:
        return self._script.read(block)


class TcpUnit(ModbusTcpBus):
    def __init__(self, script: DrawnRegisters) -> None:
        super().__init__("scan", ModbusTcpSettings(host="nowhere"))
        self._script = script

    async def read(self, device: str, unit: int, block: Block, *, again: bool = False) -> tuple[int, ...]:
        return self._script.read(block)


def usable(bus: ModbusBus | CanOpenBus | MeRs485Bus | MeEthernetBus, unit: int, what: Recognition) -> None:
    """A recognised device can be made as the recognition says; any result states its evidence."""
    assert what.evidence
    if not what.profile:
        assert what.inputs == ()
        return
    channels = {f"in{number}": number for number in what.inputs}
    make_device("found", bus, what.profile, unit, channels, what.options, SystemClock())


@pytest.mark.slow
@pytest.mark.parametrize("kind", [RtuUnit, TcpUnit])
def test_any_registers(kind: Callable[[DrawnRegisters], ModbusBus]) -> None:
    seen: set[str] = set()

    @settings(max_examples=200)
    @given(st.data())
    def any_registers(data: st.DataObject) -> None:
        script = DrawnRegisters(data)
        bus = kind(script)
        try:
            what = runner.run(recognise_modbus(bus, 1))
        except ConnectError:
            assert any(isinstance(said, ConnectError) for said in script.told.values())
            return
        usable(bus, 1, what)
        seen.add(what.profile)
        if not what.profile:
            return
        profile = load_profile(what.profile)
        assert isinstance(profile, ModbusProfile)
        if (codes := profile.type_codes) is not None:
            told = script.told[Block(codes.function, codes.address, profile.channels)]
            assert not isinstance(told, DriverError)
            assert what.inputs == tuple(i for i in range(profile.channels) if told[i] in codes.spans)
            assert sum("type code" in doubt for doubt in what.doubts) == profile.channels - len(what.inputs)
        if what.profile == "wago_750_464":
            told = script.told[Block(3, 0x2030, 65)]
            assert not isinstance(told, DriverError)
            assert 464 in told[1:]

    with asyncio.Runner() as runner:
        any_registers()
    assert len(seen) > 1, "recognised and not, or nothing was tried"


def _cia404() -> Cia404Profile:
    profile = load_profile("cia404")
    assert isinstance(profile, Cia404Profile)
    return profile


PROFILE = _cia404()


def number(*values: int) -> st.SearchStrategy[bytes]:
    return st.sampled_from(values).map(lambda value: value.to_bytes(4, "little"))


TYPES, COUNTS, UNITS = number(30, 31, 1, 0), number(8, 8, 2, 0, 255), number(PROFILE.unit_code or 0, 0x002D_0001)


class Node(CanOpenBus):
    """Draws what an upload gives; the same for the same object. Every other node is a measuring device."""

    def __init__(self, data: st.DataObject) -> None:
        super().__init__("scan", CanOpenSettings(interface="virtual", channel="nowhere"))
        self._data = data
        self._measures = data.draw(st.booleans())
        self.told: dict[CanObject, bytes | DriverError] = {}

    async def upload(self, device: str, node: int, objects: Sequence[CanObject], most_bytes: int = 8) -> list[bytes]:
        return [self._said(wanted, most_bytes) for wanted in objects]

    def _said(self, wanted: CanObject, most_bytes: int) -> bytes:
        if wanted not in self.told:
            self.told[wanted] = self._data.draw(self._answers(wanted, most_bytes))
        said = self.told[wanted]
        if isinstance(said, DriverError):
            raise said
        return said

    def _answers(self, wanted: CanObject, most_bytes: int) -> st.SearchStrategy[bytes | DriverError]:
        anything = st.binary(min_size=1, max_size=most_bytes)
        if not self._measures:
            return st.one_of(anything, raised(Refused, NoAnswer, BadAnswer, ConnectError))
        match wanted:
            case CanObject(0x1000):
                return number(0x0002_0194)
            case CanObject(0x6110, 0):
                return COUNTS
            case CanObject(0x6110):
                return TYPES
            case CanObject(0x6131):
                return UNITS
            case _:
                return st.one_of(anything, raised(Refused))

    def number(self, index: int, subindex: int) -> int:
        said = self.told[CanObject(index, subindex)]
        assert isinstance(said, bytes)
        return int.from_bytes(said[:4], "little")


@pytest.mark.slow
def test_any_objects_of_a_node() -> None:
    seen = {"cia404": 0, "": 0, "silent": 0, "error": 0}

    @settings(max_examples=200)
    @given(st.data())
    def any_objects(data: st.DataObject) -> None:
        bus = Node(data)
        try:
            what = runner.run(recognise_canopen(bus, NODE))
        except (NoAnswer, BadAnswer, ConnectError):
            seen["error"] += 1
            return
        if what is None:
            assert isinstance(bus.told[CanObject(0x1000, 0)], NoAnswer)
            seen["silent"] += 1
            return
        seen[what.profile] += 1
        usable(bus, NODE, what)
        for number in what.inputs:
            assert bus.number(0x6110, number + 1) in PROFILE.sensor_types
            assert bus.number(0x6131, number + 1) == PROFILE.unit_code
        assert what.evidence.isprintable()

    with asyncio.Runner() as runner:
        any_objects()
    assert min(seen.values()) > 0, f"each was tried: {seen}"


class AnySensor(MeRs485Bus):
    def __init__(self, says: bytes | DriverError) -> None:
        super().__init__("scan", MeRs485Settings(port="nowhere"))
        self._says = says

    async def measure(self, device: str, address: int, *, again: bool = False) -> bytes:
        if isinstance(self._says, DriverError):
            raise self._says
        return self._says


@given(st.one_of(st.binary(max_size=252), raised(NoAnswer, BadAnswer, ConnectError)))
@example(struct.pack("<ff", 0.88, 1.0))
@example(b"\x01\x00\x01\x00" + struct.pack("<i", 0x780000))
@example(struct.pack("<f", float("nan")) + bytes(4))
def test_any_data_of_a_sensor(says: bytes | DriverError) -> None:
    bus = AnySensor(says)
    try:
        what = asyncio.run(recognise_me_rs485(bus, 126))
    except (BadAnswer, ConnectError):
        assert isinstance(says, BadAnswer | ConnectError)
        return
    if what is None:
        assert isinstance(says, NoAnswer)
        return
    assert isinstance(says, bytes)
    usable(bus, 126, what)
    if what.profile == "me_rs485":
        assert len(says) == 8
    if what.profile == "me_dt6120":
        assert len(says) == 4 + 4 * says[2]


class AnyController(MeEthernetBus):
    def __init__(self, says: MeBlock | DriverError) -> None:
        super().__init__("scan", MeEthernetSettings(host="nowhere"))
        self._says = says

    async def next_block(self, device: str) -> MeBlock:
        if isinstance(self._says, DriverError):
            raise self._says
        return self._says


BLOCKS = st.builds(
    MeBlock,
    st.integers(0, 2**32 - 1),
    st.integers(0, 2**32 - 1),
    st.integers(0, 2**32 - 1),
    st.dictionaries(st.integers(0, 31), st.integers(-(2**31), 2**31 - 1), min_size=1, max_size=32),
)


@pytest.mark.slow
@given(st.one_of(BLOCKS, raised(NoAnswer, BadAnswer, ConnectError)))
@example(MeBlock(1, 2, 3, {31: 0}))
def test_any_block_of_a_controller(says: MeBlock | DriverError) -> None:
    bus = AnyController(says)
    try:
        what = asyncio.run(recognise_me_ethernet(bus))
    except (NoAnswer, BadAnswer, ConnectError):
        assert isinstance(says, DriverError)
        return
    assert isinstance(says, MeBlock)
    usable(bus, 1, what)
    assert set(what.inputs) == {n for n in says.values if n < load_profile("me_ethernet").channels}
