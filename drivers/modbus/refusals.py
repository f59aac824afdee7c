"""Errors for the exception codes of Modbus: what each code means, and what to do about it."""

from drivers.base import Busy, NoAnswer, Refused
from drivers.modbus.numbers import Block, as_in_manuals
from drivers.text import Text

_EXCEPTIONS = {
    1: Text("modbus_illegal_function"),
    2: Text("modbus_illegal_address"),
    3: Text("modbus_illegal_value"),
    4: Text("modbus_device_failure"),
    5: Text("modbus_not_ready"),
    6: Text("modbus_device_busy"),
    8: Text("modbus_parity_error"),
    10: Text("modbus_path_unavailable"),
    11: Text("modbus_target_silent"),
}
_TARGET_SILENT = (10, 11)
_BUSY = (5, 6)
_ILLEGAL_ADDRESS = 2
_ABSENT = (1, _ILLEGAL_ADDRESS, 3)
"""What the unit does not have, or cannot return this much of at once: illegal data value is the standard's answer
to a count that is too large."""


def is_target_silent(message: bytes) -> bool:
    """Whether an answer (function code and data) says that a gateway could not ask the unit."""
    return len(message) == 2 and bool(message[0] & 0x80) and message[1] in _TARGET_SILENT


def is_busy(message: bytes) -> bool:
    """Whether an answer (function code and data) says that the unit cannot answer just now."""
    return len(message) == 2 and bool(message[0] & 0x80) and message[1] in _BUSY


def refusal(bus: str, device: str, unit: int, block: Block, code: int) -> NoAnswer | Refused:
    """The error for a unit that answered this request with an exception code."""
    meaning = _EXCEPTIONS.get(code, Text("modbus_unknown_exception"))
    reason = Text("modbus_exception", code=code, meaning=meaning)
    asked = Text("modbus_request", function=block.function, address=block.address, count=block.count)
    what = Text("modbus_unit_refused", unit=unit, asked=asked, reason=reason)
    if code in _TARGET_SILENT:
        hint = Text("modbus_behind_gateway")
        return NoAnswer(what, bus=bus, device=device, hint=hint)
    if code in _BUSY:
        hint = Text("modbus_ask_less")
        return Busy(what, reason=reason, bus=bus, device=device, hint=hint)
    hint = (code == _ILLEGAL_ADDRESS and as_in_manuals(block.address)) or Text("profile_fits")
    return Refused(what, absent=code in _ABSENT, reason=reason, bus=bus, device=device, hint=hint)
