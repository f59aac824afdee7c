"""An emulated Modbus unit that has what a profile describes. It reads the profile's file without the drivers."""

import struct
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

from simulators.devices.source import Faults, SensorFault, ValueSource, clamp

_FORMS = {
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
_BEYOND = (SensorFault.OVER, SensorFault.UNDER)
_JUDGES = ("type_code", "fault_bits", "status", "sentinel", "plausibility")

_ProfileTable = Mapping[str, Any]
_Memory = dict[tuple[int, int], int]


class ProfiledUnit:
    """A unit for an RtuLine, DeviceServer or TcpHost.

    A broken sensor shows as the profile says: its fault bit, status and sentinel of that quality; if it says nothing,
    as the last value would be. Type codes are the first that the profile lists, settings are as they must be. Unused
    addresses between used ones are 0 up to the profile's `max_gap`; all others are refused.

    Parameters
    ----------
    profile: content of a Modbus profile's file
    source: values of all channels, in the profile's units
    """

    def __init__(self, profile: _ProfileTable, source: ValueSource) -> None:
        self._blocks = blocks_of(profile)
        self._settings: Sequence[_ProfileTable] = profile.get("setting", ())
        self._max_gap: int = profile.get("max_gap", 8)
        self._source = source
        self.faults = Faults()
        self.refused: set[tuple[int, int]] = set()
        """Function and address of what it refuses although the profile has it."""

    @property
    def silent(self) -> bool:
        return self.faults.silent

    def memory(self, function: int) -> Mapping[int, int]:
        memory: _Memory = {(s["function"], s["address"]): s["equals"] for s in self._settings}
        values = iter(enumerate(self._source()))
        for block in self._blocks:
            for index in range(channels_of(block)):
                number, value = next(values)
                self._put(memory, block, index, value, self.faults.by_channel.get(number))
        used = sorted(address for space, address in memory if space == function)
        gaps = (range(a + 1, b) for a, b in pairwise(used) if b - a - 1 <= self._max_gap)
        words = {address: 0 for gap in gaps for address in gap}
        words |= {address: memory[function, address] for address in used}
        return {address: word for address, word in words.items() if (function, address) not in self.refused}

    def _put(self, memory: _Memory, block: _ProfileTable, index: int, value: float, fault: SensorFault | None) -> None:
        quality = "out_of_range" if fault in _BEYOND else "sensor_fault"
        code = block["type_code"]["code"][0] if "type_code" in block else None
        if code is not None:
            memory[block["type_code"]["function"], block["type_code"]["address"] + index] = code["code"]
        raw = _raw(block, value)
        if fault is not None:
            told = [s["raw"] for s in block.get("sentinel", ()) if s["quality"] == quality]
            raw = told[-1 if fault is SensorFault.UNDER else 0] if told else _raw(block, _measured(block, value, fault))
        _write(memory, block, index, raw)
        if "fault_bits" in block:
            bits = block["fault_bits"]
            reports = fault is not None and bits["quality"] == quality
            memory[bits["function"], bits["address"] + index] = int(reports)
        if "status" in block:
            _write_status(memory, block["status"], index, quality if fault is not None else "")


def blocks_of(profile: _ProfileTable) -> list[dict[str, Any]]:
    """The profile's blocks; `[value]` with the tables beside it is one."""
    if "value" not in profile:
        return [dict(block) for block in profile["block"]]
    tables = {name: profile[name] for name in _JUDGES if name in profile}
    return [{**profile["value"], **tables, "channels": profile["channels"]}]


def channels_of(block: _ProfileTable) -> int:
    """How many channels the block has."""
    return len(block["addresses"]) if "addresses" in block else int(block.get("channels", 1))


def _raw(block: _ProfileTable, value: float) -> float:
    """What the device sends for this value, before it is rounded."""
    if block.get("scaled_by") == "type_code":
        codes = block["type_code"]
        code = codes["code"][0]
        low, high = (code.get(key, codes.get(key, usual)) for key, usual in (("raw_low", 0.0), ("raw_high", 1.0)))
        return float(low + (value - code["low"]) / (code["high"] - code["low"]) * (high - low))
    return float((value - block.get("offset", 0.0)) / block.get("scale", 1.0))


def _measured(block: _ProfileTable, value: float, fault: SensorFault) -> float:
    """What a device without a sentinel for this fault measures."""
    limits = block.get("plausibility", {})
    if fault in _BEYOND:
        return float({"over": 2 * limits["high"], "under": 2 * limits["low"] - 1}[fault]) if limits else value
    return float(limits.get("open_input_low", value))


def _write(memory: _Memory, block: _ProfileTable, index: int, raw: float) -> None:
    function, kind = block["function"], block["type"]
    if kind == "bit":
        _write_bit(memory, block, index, raw)
        return
    form = _FORMS[kind]
    if form not in "fd":
        shift, signed = block.get("shift", 0), form.islower()
        bits = 8 * struct.calcsize(form) - shift
        raw = round(clamp(raw, -(2 ** (bits - 1)) if signed else 0, 2 ** (bits - signed) - 1)) << shift
    data = struct.pack(">" + form, raw)
    words = list(_words(data, block.get("byte_order", "big")))
    if block.get("word_order") == "little":
        words.reverse()
    first = block["addresses"][index] if "addresses" in block else None
    if first is None:
        first = block["address"] + index * block.get("stride", len(words))
    memory.update({(function, first + i): word for i, word in enumerate(words)})


def _words(data: bytes, byte_order: str) -> Iterator[int]:
    for high, low in zip(data[::2], data[1::2], strict=True):
        yield high << 8 | low if byte_order == "big" else low << 8 | high


def _write_bit(memory: _Memory, block: _ProfileTable, index: int, raw: float) -> None:
    function, on = block["function"], int(raw > 0.5)
    distance = 0 if "addresses" in block else index * block.get("stride", 1)
    address = block["addresses"][index] if "addresses" in block else block["address"]
    if function <= 2:
        memory[function, address + distance] = on
        return
    register, bit = divmod(block["bit"] + distance, 16)
    if block.get("byte_order") == "little":
        bit ^= 8
    place = function, address + register
    memory[place] = memory.get(place, 0) & ~(1 << bit) | on << bit


def _write_status(memory: _Memory, status: _ProfileTable, index: int, quality: str) -> None:
    """quality: of the fault; empty: the sensor is in order."""
    number = status.get("good", [0])[0]
    if quality:
        rule = next((r for r in status.get("rule", ()) if r["quality"] == quality), None)
        if rule is not None:
            number = 1 << rule["bit"] if "bit" in rule else rule["equals"]
    shared, step = status.get("channels_per_register", 1), status.get("bit_stride", 0)
    place = status["function"], status["address"] + index // shared * status.get("stride", 1)
    memory[place] = memory.get(place, 0) | number << index % shared * step
