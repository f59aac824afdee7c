"""Recognises which profile a device fits from what can be read. It never writes.

Devices with type codes, or with a register that identifies them, are recognised for certain; others by registers that
must agree with each other. A device whose registers are ambiguous stays unknown: that is better than a guess.
"""

from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field

from drivers.base import BadAnswer, NoAnswer, Refused
from drivers.canopen.bus import CanOpenBus
from drivers.canopen.place import CanObject
from drivers.canopen.profile import Cia404Profile
from drivers.micro_epsilon.ethernet import MeEthernetBus
from drivers.micro_epsilon.rs485 import MeRs485Bus, decode_counted, decode_float
from drivers.modbus.bus import ModbusBus
from drivers.modbus.numbers import Block, NumberFormat
from drivers.modbus.profile import ModbusProfile
from drivers.profile import fits_bus
from drivers.profiles import load_profile, profile_names

_PROPOSED_RANGE_UM = 500.0
"""Proposed measuring range, to be corrected by a person: no sensor reports it."""
_LONGEST_TEXT = 64
"""Bytes of a node's name."""
_INT16 = NumberFormat("int16")

CANOPEN_VENDORS: Mapping[int, str] = {0x17: "esd", 0x55: "axiomatic"}
"""Vendor-ID in object 1018:01 (esd manual C.3034.21; Axiomatic UMAX030301), to the name in the profile cia404."""


@dataclass(frozen=True, slots=True)
class Recognition:
    """The device at one address."""

    profile: str
    """Name of the profile; empty if something answers that matches no supplied profile."""
    inputs: tuple[int, ...]
    """The profile's channel numbers that can be used."""
    evidence: str
    """How it was recognised, in words."""
    options: Mapping[str, object] = field(default_factory=dict)
    """Device options that the configuration needs."""
    doubts: tuple[str, ...] = ()
    """Points that a person must check."""


class _Registers:
    """One unit's readable registers. A refusal or silence gives None; a silent function is not tried again."""

    def __init__(self, bus: ModbusBus, unit: int) -> None:
        self._bus, self._unit = bus, unit
        self._silent: set[int] = set()

    async def read(self, function: int, address: int, count: int) -> tuple[int, ...] | None:
        """The registers, or None. Raises ConnectError."""
        if function in self._silent:
            return None
        try:
            return await self._bus.read("", self._unit, Block(function, address, count))
        except Refused:
            return None
        except (NoAnswer, BadAnswer):
            self._silent.add(function)
            return None


async def recognise_modbus(bus: ModbusBus, unit: int) -> Recognition:
    """Identify the unit, which has answered before. Raises ConnectError."""
    registers = _Registers(bus, unit)
    for name in profile_names():
        profile = load_profile(name)
        if not isinstance(profile, ModbusProfile) or not fits_bus(profile.buses, bus.kind, bus.carries):
            continue
        if any(block.type_codes is not None for block in profile.blocks):
            found = await _by_type_codes(registers, profile)
        elif name in _BY_NAME:
            found = await _BY_NAME[name](registers, profile)
        else:
            continue
        if found is not None:
            return found
    return Recognition("", (), "a Modbus unit that matches no supplied profile; write one")


async def _by_type_codes(registers: _Registers, profile: ModbusProfile) -> Recognition | None:
    """A device with type codes at the profile's addresses, all known to the profile, and readable values."""
    inputs: list[int] = []
    doubts: list[str] = []
    known: dict[str, None] = {}
    first = 0
    for block in profile.blocks:
        numbers = range(first, first + block.channels)
        first += block.channels
        codes = block.type_codes
        words = () if codes is None else await registers.read(codes.function, codes.address, block.channels)
        if words is None or await registers.read(*block.place(0, 0)) is None:
            return None
        if codes is None:
            inputs += numbers
            continue
        if not any(word in codes.spans for word in words):
            return None
        for number, word in zip(numbers, words, strict=True):
            if word in codes.spans:
                inputs.append(number)
                known[f"0x{word:X}"] = None
            else:
                doubts.append(f"input {number} has type code 0x{word:04X}, which the profile cannot read")
    for setting in profile.settings:
        held = await registers.read(setting.function, setting.address, 1)
        if held is None or held[0] != setting.equals:
            doubts.append(f"{setting.name} is {'unknown' if held is None else held[0]}: {setting.hint}")
    return Recognition(profile.name, tuple(inputs), f"type code {', '.join(known)}", doubts=tuple(doubts))


async def _pta8d08(registers: _Registers, profile: ModbusProfile) -> Recognition | None:
    """Its resistances (0.1 ohm, from address 32) must agree with its temperatures by the Pt100 curve."""
    temperatures = await registers.read(*profile.blocks[0].place(0, 0)[:2], profile.channels)
    resistances = await registers.read(3, 32, profile.channels)
    if temperatures is None or resistances is None:
        return None
    pairs = [(_INT16.decode([t]) * 0.1, r * 0.1) for t, r in zip(temperatures, resistances, strict=True)]
    judged = [(celsius, ohm) for celsius, ohm in pairs if -100 <= celsius <= 850]
    if not judged or any(abs(_pt100_ohm(celsius) - ohm) > 0.3 for celsius, ohm in judged):
        return None
    inputs = tuple(range(profile.channels))
    return Recognition(profile.name, inputs, "resistances agree with temperatures")


def _pt100_ohm(celsius: float) -> float:
    """IEC 60751; the term with C applies below 0 degC only."""
    ohm = 1 + 3.9083e-3 * celsius - 5.775e-7 * celsius**2
    if celsius < 0:
        ohm -= 4.183e-12 * (celsius - 100) * celsius**3
    return 100.0 * ohm


async def _wago_464(registers: _Registers, profile: ModbusProfile) -> Recognition | None:
    """The coupler states its series (0x2011), type (0x2012) and modules (0x2030; digital ones have bit 15 set)."""
    nameplate = await registers.read(3, 0x2011, 2)
    if nameplate is None or nameplate[0] != 750:
        return None
    modules = await registers.read(3, 0x2030, 65)
    analogue = [] if modules is None else [word for word in modules[1:] if word and not word & 0x8000]
    if 464 not in analogue:
        listed = ", ".join(f"750-{number}" for number in analogue) or "none"
        return Recognition("", (), f"WAGO coupler 750-{nameplate[1]} without 750-464; analogue modules: {listed}")
    before = analogue[: analogue.index(464)]
    doubts: list[str] = []
    if before:
        listed = ", ".join(f"750-{number}" for number in before)
        doubts.append(f"address_offset: add up the words of {listed}, which precede the 750-464")
    if (count := analogue.count(464)) > 1:
        doubts.append(f"the coupler has {count} modules 750-464; this is the first")
    return Recognition(
        profile.name, tuple(range(profile.channels)), f"WAGO coupler 750-{nameplate[1]} with a 750-464",
        {"address_offset": 0}, tuple(doubts),
    )  # fmt: skip


_BY_NAME: Mapping[str, Callable[[_Registers, ModbusProfile], Awaitable[Recognition | None]]] = {
    "eletechsup_pta8d08": _pta8d08,
    "wago_750_464": _wago_464,
}
"""Supplied profiles of devices without type codes, and the test that recognises each of them."""


async def recognise_me_rs485(bus: MeRs485Bus, address: int) -> Recognition | None:
    """The sensor at this address, recognised by the form of its answer; None when nothing answers.

    Raises BadAnswer when what answers is not such a sensor, or ConnectError.
    """
    try:
        data = await bus.measure("", address)
    except NoAnswer:
        return None
    # One counted value is as long as two floats; read as a float it would be below 1e-37, so it is tried first.
    forms = (("me_dt6120", decode_counted, "counted int32"), ("me_rs485", decode_float, "two float32"))
    for profile, decode, form in forms:
        try:
            decode(data)
        except ValueError:
            continue
        return Recognition(profile, (0,), f"answers with {form}", {"range_um": _PROPOSED_RANGE_UM}, (_RANGE_DOUBT,))
    return Recognition("", (), f"a Micro-Epsilon frame of {len(data)} data bytes, which no supplied profile reads")


async def recognise_me_ethernet(bus: MeEthernetBus) -> Recognition:
    """Identify the controller. Raises NoAnswer, BadAnswer or ConnectError."""
    block = await bus.next_block("")
    inputs = tuple(channel for channel in block.values if channel < load_profile("me_ethernet").channels)
    evidence = f"order number {block.order}, serial number {block.serial}"
    if not inputs:
        return Recognition("", (), f"{evidence}; it has none of the channels that the profile reads")
    return Recognition("me_ethernet", inputs, evidence, {"range_um": _PROPOSED_RANGE_UM}, (_RANGE_DOUBT,))


_RANGE_DOUBT = "range_um: the measuring range is printed on the sensor; no sensor reports it"


async def recognise_canopen(bus: CanOpenBus, node: int) -> Recognition | None:
    """What the node is; None if it does not answer SDO. Raises NoAnswer (falls silent), BadAnswer or ConnectError."""
    read = _Objects(bus, node)
    try:
        device_type = await read.number(0x1000, 0)
    except NoAnswer:
        return None
    number = (device_type or 0) & 0xFFFF
    vendor, product, serial = [await read.number(0x1018, sub) for sub in (1, 2, 4)]
    name = await read.text(0x1008)
    who = " ".join(
        part for part in (
            name, f"vendor 0x{vendor:X}" if vendor is not None else "", f"product 0x{product:X}" if product else "",
            f"serial {serial}" if serial else "",
        ) if part
    )  # fmt: skip
    evidence = f"device profile {number}" + (f", {who}" if who else "")
    profile = load_profile("cia404")
    if number != 404 or not isinstance(profile, Cia404Profile):
        return Recognition("", (), f"{evidence}; no supplied profile for it")
    inputs, doubts = await _cia404_inputs(read, profile)
    known = CANOPEN_VENDORS.get(vendor or 0) or next((v for v in profile.vendors if v in name.lower()), None)
    if known is None:
        doubts.append(
            "vendor: whose status bits (object 6150) does it use? without this option any of them means a broken "
            f"sensor; available: {', '.join(profile.vendors)}"
        )
    if not inputs:
        return Recognition(
            "", (), f"{evidence}; no input has a sensor type that the profile reads", doubts=tuple(doubts)
        )
    return Recognition(profile.name, inputs, evidence, {} if known is None else {"vendor": known}, tuple(doubts))


async def _cia404_inputs(read: "_Objects", profile: Cia404Profile) -> tuple[tuple[int, ...], list[str]]:
    """Inputs that the profile can read, and why the others cannot be read."""
    inputs: list[int] = []
    doubts: list[str] = []
    count = await read.number(0x6110, 0) or 0
    for index in range(min(count, profile.channels)):
        sensor, unit = await read.number(0x6110, index + 1), await read.number(0x6131, index + 1)
        if sensor not in profile.sensor_types:
            right = ", ".join(map(str, sorted(profile.sensor_types)))
            doubts.append(
                f"input {index} has sensor type {sensor}; to use it set object 6110:{index + 1:02X} to {right}"
            )
        elif unit != profile.unit_code:
            doubts.append(f"input {index} is not in {profile.unit}; set object 6131:{index + 1:02X}")
        elif await read.number(profile.value_object, index + 1) is None:
            doubts.append(f"input {index} has no object {profile.value_object:04X}")
        else:
            inputs.append(index)
    return tuple(inputs), doubts


class _Objects:
    """Objects of one node; None for an object that the node does not have."""

    def __init__(self, bus: CanOpenBus, node: int) -> None:
        self._bus, self._node = bus, node

    async def number(self, index: int, subindex: int) -> int | None:
        try:
            (data,) = await self._bus.upload("", self._node, [CanObject(index, subindex)])
        except Refused:
            return None
        return int.from_bytes(data[:4], "little")

    async def text(self, index: int) -> str:
        """The printable characters of a text that only helps to identify a node; empty if it cannot be read."""
        try:
            (data,) = await self._bus.upload("", self._node, [CanObject(index, 0)], _LONGEST_TEXT)
        except (Refused, BadAnswer):
            return ""
        return "".join(chr(b) for b in data if 0x20 <= b < 0x7F).strip()


def describe(inputs: Sequence[int]) -> str:
    """`0-5`, or `0, 2, 3`."""
    if len(inputs) > 2 and list(inputs) == list(range(inputs[0], inputs[-1] + 1)):
        return f"{inputs[0]}-{inputs[-1]}"
    return ", ".join(map(str, inputs))
