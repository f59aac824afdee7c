"""A Modbus device as its profile describes it."""

from collections.abc import Iterable, Mapping, Sequence
from math import isfinite

from drivers.base import Clock, DriverError, Quality, Reading, WrongDevice
from drivers.faults import Fault, first_fault
from drivers.modbus.bus import ModbusBus
from drivers.modbus.numbers import BIT_FUNCTIONS, Block, Span, total
from drivers.modbus.profile import ModbusProfile, Plausibility, TypeCodes
from drivers.modbus.settings import ModbusOptions
from drivers.readings import ReadingMaker

_MOST_BITS = 2000

AddressRange = tuple[int, int, int]
"""Function, address, width."""


class ModbusDevice:
    """One unit; `channels` maps names to the device's channel numbers, counted from 0."""

    def __init__(
        self,
        device: str,
        bus: ModbusBus,
        profile: ModbusProfile,
        unit: int,
        channels: Mapping[str, int],
        options: ModbusOptions,
        clock: Clock,
    ) -> None:
        self._device, self._bus, self._profile, self._unit = device, bus, profile, unit
        self._channels, self._offset = dict(channels), options.address_offset
        self._maker = ReadingMaker(profile.unit, clock)
        self._value_blocks = plan_blocks(
            _places_of_values(profile, channels, self._offset),
            profile.max_registers,
            profile.max_gap,
        )
        self._fault_blocks = plan_blocks(self._apart(), profile.max_registers, profile.max_gap)
        self._code_blocks = plan_blocks(
            _places_of_type_codes(profile, channels, self._offset), profile.max_registers, profile.max_gap
        )
        self._setting_blocks = plan_blocks(
            _places_of_settings(profile, self._offset), profile.max_registers, profile.max_gap
        )
        self._format, self._sentinels = profile.values.format, profile.sentinel_faults
        self._spans: dict[int, Span] = {}
        self._checked = False
        """Whether the unit is known to match the profile."""
        self._answers: list[tuple[int, ...]] = []
        """The blocks of values and faults that have been answered since the question was asked first, in order."""
        self._was_silent = False
        """Whether it missed the last read: another unit may answer the next one, though not a repeated one."""

    @property
    def device(self) -> str:
        return self._device

    @property
    def channels(self) -> tuple[str, ...]:
        return tuple(self._channels)

    async def connect(self) -> None:
        """Check the settings and the type codes of the channels in use, or just that the unit answers.

        Raises WrongDevice, or the bus's errors.
        """
        self._forget()
        if self._profile.settings:
            self._check_settings(await self._fetch(self._setting_blocks))
        if self._profile.type_codes is not None:
            self._spans = self._spans_of(self._profile.type_codes, await self._fetch(self._code_blocks))
        elif not self._profile.settings:
            await self._fetch(self._value_blocks[:1])
        self._checked = True

    def _check_settings(self, words: Mapping[tuple[int, int], int]) -> None:
        for setting in self._profile.settings:
            found = words[setting.function, setting.address + self._offset]
            if found != setting.equals:
                raise WrongDevice(
                    f"{setting.name} is {found}, which profile {self._profile.name} cannot read",
                    bus=self._bus.name,
                    device=self._device,
                    hint=setting.hint,
                )

    def _spans_of(self, codes: TypeCodes, words: Mapping[tuple[int, int], int]) -> dict[int, Span]:
        """The scaling of each channel in use."""
        spans: dict[int, Span] = {}
        for channel, index in self._channels.items():
            code = words[codes.function, codes.address + self._offset + index]
            if code not in codes.spans:
                known = ", ".join(f"0x{c:04X}" for c in codes.spans)
                raise WrongDevice(
                    f"type code 0x{code:04X} at input {index}, which profile {self._profile.name} cannot read",
                    bus=self._bus.name,
                    device=self._device,
                    channel=channel,
                    hint=f"set the input to one of {known}, or check the unit id",
                )
            spans[index] = codes.spans[code]
        return spans

    async def read(self, *, again: bool = False) -> Sequence[Reading]:
        """One reading per channel. After a silence the unit is checked again, because a different one may answer.

        again: continue with the block that was not answered
        """
        if not again:
            self._answers.clear()
            if self._was_silent:
                self._forget()
        if not self._checked and (self._code_blocks or self._setting_blocks):
            await self.connect()
        try:
            for block in (*self._value_blocks, *self._fault_blocks)[len(self._answers) :]:
                self._answers.append(await self._bus.read(self._device, self._unit, block, again=again))
        except DriverError as error:
            self._was_silent |= not (error.hurried or error.heard)
            raise
        answers, self._answers, self._was_silent = self._answers, [], False
        count = len(self._value_blocks)
        words = _words(zip(self._value_blocks, answers[:count], strict=True))
        later = words | _words(zip(self._fault_blocks, answers[count:], strict=True))
        values = {name: self._value(index, words) for name, index in self._channels.items()}
        for name, index in self._channels.items():
            if self._fault_blocks and not isinstance(values[name], Fault):
                values[name] = self._value(index, later)
        return self._maker.make(values)

    async def close(self) -> None:
        """Forget what is known about the unit: next time a different one may answer."""
        self._forget()

    def _forget(self) -> None:
        self._spans, self._checked, self._was_silent = {}, False, False

    async def _fetch(self, blocks: Iterable[Block]) -> dict[tuple[int, int], int]:
        return _words([(block, await self._bus.read(self._device, self._unit, block)) for block in blocks])

    def _value(self, index: int, words: Mapping[tuple[int, int], int]) -> float | Fault:
        profile, values = self._profile, self._profile.values
        start = values.address + self._offset + index * values.stride
        raw = self._format.decode([words[values.function, start + i] for i in range(self._format.registers)])
        sentinel = self._sentinels.get(raw)
        if (bits := profile.fault_bits) is not None and words[bits.function, bits.address + self._offset + index]:
            return (
                bits.fault if sentinel is None else Fault(bits.fault.quality, f"{bits.fault.detail}; {sentinel.detail}")
            )
        if (status := profile.status) is not None:
            code = status.code(index, words[status.function, status.register(index) + self._offset])
            if code not in status.good:
                unknown = Fault(Quality.SENSOR_FAULT, f"status 0x{code:X}, which the profile does not define")
                return first_fault(status.rules, code) or unknown
        if sentinel is not None:
            return sentinel
        if not isfinite(raw):
            return Fault(Quality.SENSOR_FAULT, f"the device sends {raw} instead of a value")
        span = self._spans.get(index)
        value = (
            span.apply(raw) if values.scaled_by == "type_code" and span else total(raw * values.scale, values.offset)
        )
        if span is not None and not span.holds(value):
            ends = f"{span.low:g} to {span.high:g}"
            text = f"{value:.4g} {profile.unit} is outside the range that the input is set to, {ends}"
            return Fault(Quality.OUT_OF_RANGE, text)
        return _implausible(profile.plausibility, value, profile.unit) or value

    def _apart(self) -> list[AddressRange]:
        """What must be read again after the values, so that a sensor that recovers in between is noticed.

        This applies where bits or status are read in another request than the value and the value cannot show it.
        """
        profile, offset = self._profile, self._offset
        if profile.sentinels:
            return []
        return [
            place
            for index in self._channels.values()
            for place in _fault_places(profile, index, offset)
            if not any(
                _holds(block, place) and _holds(block, _value_place(profile, index, offset))
                for block in self._value_blocks
            )
        ]


def _words(answers: Iterable[tuple[Block, tuple[int, ...]]]) -> dict[tuple[int, int], int]:
    """Registers and bits by function and address."""
    return {
        (block.function, address): word
        for block, answer in answers
        for address, word in enumerate(answer, start=block.address)
    }


def last_address(profile: ModbusProfile, channels: Mapping[str, int], offset: int) -> int:
    """Highest register or bit address that a device with this profile reads.

    offset: as `address_offset` of its options
    """
    places = (
        *_places_of_values(profile, channels, offset),
        *_places_of_type_codes(profile, channels, offset),
        *_places_of_settings(profile, offset),
    )
    return max(address + width - 1 for _, address, width in places)


def _places_of_values(profile: ModbusProfile, channels: Mapping[str, int], offset: int) -> list[AddressRange]:
    """Values with the bits or status that tell their faults."""
    return [
        place
        for index in channels.values()
        for place in (_value_place(profile, index, offset), *_fault_places(profile, index, offset))
    ]


def _value_place(profile: ModbusProfile, index: int, offset: int) -> AddressRange:
    values = profile.values
    return values.function, values.address + offset + index * values.stride, values.format.registers


def _fault_places(profile: ModbusProfile, index: int, offset: int) -> list[AddressRange]:
    places: list[AddressRange] = []
    if (bits := profile.fault_bits) is not None:
        places.append((bits.function, bits.address + offset + index, 1))
    if (status := profile.status) is not None:
        places.append((status.function, status.register(index) + offset, 1))
    return places


def _places_of_type_codes(profile: ModbusProfile, channels: Mapping[str, int], offset: int) -> list[AddressRange]:
    codes = profile.type_codes
    if codes is None:
        return []
    return [(codes.function, codes.address + offset + index, 1) for index in channels.values()]


def _places_of_settings(profile: ModbusProfile, offset: int) -> list[AddressRange]:
    return [(setting.function, setting.address + offset, 1) for setting in profile.settings]


def _holds(block: Block, place: AddressRange) -> bool:
    function, address, width = place
    return block.function == function and block.address <= address and address + width <= block.address + block.count


def plan_blocks(places: Iterable[AddressRange], max_registers: int, max_gap: int) -> tuple[Block, ...]:
    """The read requests that cover all places (function, address, width): as few as the device's limit allows.

    Neighbours are joined over a gap of up to max_gap addresses: one request costs about as much as 8 registers.
    """
    blocks: list[Block] = []
    for function, address, width in sorted(set(places)):
        limit = _MOST_BITS if function in BIT_FUNCTIONS else max_registers
        if blocks:
            last = blocks[-1]
            end = max(last.address + last.count, address + width)
            gap = address - (last.address + last.count)
            if last.function == function and gap <= max_gap and end - last.address <= limit:
                blocks[-1] = Block(function, last.address, end - last.address)
                continue
        blocks.append(Block(function, address, width))
    return tuple(blocks)


def _implausible(rule: Plausibility | None, value: float, unit: str) -> Fault | None:
    if rule is None:
        return None
    if rule.suspicious is not None and rule.suspicious[0] <= value <= rule.suspicious[1]:
        return Fault(Quality.SENSOR_FAULT, f"{value:.4g} {unit} is the reading of this device when an input is open")
    if not rule.low <= value <= rule.high:
        return Fault(Quality.OUT_OF_RANGE, f"{value:.4g} {unit} is outside {rule.low:g} to {rule.high:g} {unit}")
    return None
