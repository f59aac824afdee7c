"""Errors for the exception codes of Modbus: what each code means, and what to do about it."""

from drivers.base import Busy, NoAnswer, Refused
from drivers.modbus.numbers import Block, as_in_manuals

_EXCEPTIONS = {
    1: "illegal function",
    2: "illegal data address",
    3: "illegal data value",
    4: "device failure",
    5: "acknowledge, not ready yet",
    6: "device busy",
    8: "memory parity error",
    10: "gateway path unavailable",
    11: "gateway target did not respond",
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


def refusal(bus: str, device: str, unit: int, block: Block, code: int) -> NoAnswer | Refused:
    """The error for a unit that answered this request with an exception code."""
    meaning = _EXCEPTIONS.get(code, "unknown exception")
    reason = f"exception {code}: {meaning}"
    asked = f"function {block.function}, address {block.address}, count {block.count}"
    what = f"unit {unit} answered {asked} with {reason}"
    if code in _TARGET_SILENT:
        hint = "behind that gateway: check power, wiring and id of the unit, and the gateway's timeout"
        return NoAnswer(what, bus=bus, device=device, hint=hint)
    if code in _BUSY:
        hint = "ask it less often: a longer period_s, or no second master"
        return Busy(what, reason=reason, bus=bus, device=device, hint=hint)
    hint = (code == _ILLEGAL_ADDRESS and as_in_manuals(block.address)) or "does the profile fit the device?"
    return Refused(what, absent=code in _ABSENT, reason=reason, bus=bus, device=device, hint=hint)
