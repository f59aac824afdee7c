"""The application layer of an emulated Modbus unit: function codes 1 to 4 on four address spaces.

Written from the MODBUS Application Protocol V1.1b3, independently of any client's code.
"""

import struct
from collections.abc import Mapping
from typing import Protocol

ILLEGAL_FUNCTION = 1
ILLEGAL_ADDRESS = 2
ILLEGAL_VALUE = 3

_MOST_BITS = 2000
_MOST_REGISTERS = 125


class ModbusUnit(Protocol):
    """A device behind a unit id."""

    @property
    def silent(self) -> bool:
        """True: receives requests, but does not answer."""
        ...

    def memory(self, function: int) -> Mapping[int, int]:
        """Address to bit (functions 1, 2) or register 0..65535 (functions 3, 4) at this moment."""
        ...


def answer(unit: ModbusUnit, pdu: bytes) -> bytes:
    """The unit's answer to a request (function code and data, without address and checksum)."""
    function = pdu[0]
    if function not in (1, 2, 3, 4):
        return bytes((function | 0x80, ILLEGAL_FUNCTION))
    if len(pdu) != 5:
        return bytes((function | 0x80, ILLEGAL_VALUE))
    address, count = struct.unpack(">HH", pdu[1:])
    bits = function <= 2
    if not 1 <= count <= (_MOST_BITS if bits else _MOST_REGISTERS):
        return bytes((function | 0x80, ILLEGAL_VALUE))
    memory = unit.memory(function)
    try:
        words = [memory[i] for i in range(address, address + count)]
    except KeyError:
        return bytes((function | 0x80, ILLEGAL_ADDRESS))
    if bits:
        packed = sum(bool(bit) << i for i, bit in enumerate(words)).to_bytes((count + 7) // 8, "little")
        return bytes((function, len(packed))) + packed
    return bytes((function, 2 * count)) + struct.pack(f">{count}H", *words)
