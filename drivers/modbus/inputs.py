"""Register and bit addresses of a Modbus device's channels."""

from collections.abc import Mapping
from dataclasses import dataclass

from drivers.modbus.numbers import REGISTER_FUNCTIONS, AddressRange, as_in_manuals
from drivers.modbus.profile import ChannelBlock, ModbusProfile


@dataclass(frozen=True, slots=True)
class DeviceInput:
    """One channel in use: where its value is, and all that tells what it means."""

    block: ChannelBlock
    index: int
    """Which of the block's channels it is."""
    unit: str
    value: AddressRange
    bit: AddressRange | None
    """Its fault bit."""
    status: AddressRange | None
    code: AddressRange | None
    """Its type code."""

    @property
    def faults(self) -> tuple[AddressRange, ...]:
        return tuple(place for place in (self.bit, self.status) if place is not None)

    @property
    def all(self) -> tuple[AddressRange, ...]:
        return (self.value, *self.faults) if self.code is None else (self.value, *self.faults, self.code)


def device_input(profile: ModbusProfile, number: int, offset: int) -> DeviceInput:
    """The channel of this number; offset: added to every address."""
    block, index = profile.channel(number)
    bits, status, codes = block.fault_bits, block.status, block.type_codes
    return DeviceInput(
        block,
        index,
        block.unit or profile.unit,
        block.place(index, offset),
        None if bits is None else (bits.function, bits.address + offset + index, 1),
        None if status is None else (status.function, status.register(index) + offset, 1),
        None if codes is None else (codes.function, codes.address + offset + index, 1),
    )


def addresses_as_in_manuals(profile: ModbusProfile, channels: Mapping[str, int]) -> Mapping[str, str]:
    """Channels whose values have an address such as 40101 in the profile, and what a manual means by that number.

    Some devices do have such addresses.
    """
    inputs = {name: device_input(profile, number, 0) for name, number in channels.items()}
    meant = {name: as_in_manuals(one.value[1]) for name, one in inputs.items() if one.value[0] in REGISTER_FUNCTIONS}
    return {name: text for name, text in meant.items() if text}


def last_address(profile: ModbusProfile, channels: Mapping[str, int], offset: int) -> int:
    """Highest register or bit address that a device with this profile reads.

    offset: as `address_offset` of its options
    """
    places = [(setting.function, setting.address + offset, 1) for setting in profile.settings]
    for number in channels.values():
        places += device_input(profile, number, offset).all
    return max(address + width - 1 for _, address, width in places)
