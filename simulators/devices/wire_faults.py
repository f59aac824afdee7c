"""Wire faults that a scenario switches on and off: late, corrupted, truncated and refused answers.

Framing describes which faults each kind of wire can have. TCP and CAN have lower-level checksums, hence no `crc`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from simulators.devices.modbus_servers import crc16
from simulators.devices.source import Actions

ChangedBytes = Callable[[bytes], bytes]
_CUT_BYTES = 3
_UNIT = 6
"""Position of the unit id after a Modbus TCP header's numbers and length."""


@dataclass(frozen=True, slots=True)
class Framing:
    """The faulty form of one frame on this kind of wire; None: the wire does not have this fault."""

    cut: ChangedBytes
    """It ends too early."""
    wrong_crc: ChangedBytes | None = None
    exception: Callable[[bytes, int], bytes] | None = None
    """The same request refused with a Modbus exception."""
    abort: Callable[[bytes, int], bytes] | None = None
    """The same SDO answered with an abort code."""
    concerns: Callable[[bytes], bool] = lambda _: True
    """Whether this frame can be affected."""


class WireFaults:
    """The faults in force on one device's wire. Its line, host or adapter calls `spoil`.

    `actions` gives what can be switched, by the scenario's key.
    """

    def __init__(self, framing: Framing) -> None:
        self._framing = framing
        self._delay_s = 0.0
        self._changes: dict[str, ChangedBytes] = {}

    def spoil(self, sender: int, frame: bytes) -> Sequence[tuple[float, bytes]]:  # noqa: ARG002 - it is the only sender
        if not self._framing.concerns(frame):
            return ((0.0, frame),)
        for change in self._changes.values():
            frame = change(frame)
        return ((self._delay_s, frame),)

    def actions(self) -> Actions:
        framing = self._framing
        found: Actions = {"delay_s": self._delay, "truncated": partial(self._switch, "truncated", framing.cut)}
        if framing.wrong_crc is not None:
            found["crc"] = partial(self._switch, "crc", framing.wrong_crc)
        if framing.exception is not None:
            found["exception"] = partial(self._refuse, "exception", framing.exception)
        if framing.abort is not None:
            found["abort"] = partial(self._refuse, "abort", framing.abort)
        return found

    def _delay(self, seconds: float) -> None:
        self._delay_s = seconds

    def _switch(self, name: str, change: ChangedBytes, on: bool) -> None:
        self._changes.pop(name, None)
        if on:
            self._changes[name] = change

    def _refuse(self, name: str, refuse: Callable[[bytes, int], bytes], code: int) -> None:
        self._switch(name, lambda frame: refuse(frame, code), code != 0)


def _cut(frame: bytes) -> bytes:
    return frame[:-_CUT_BYTES]


def _rtu_exception(frame: bytes, code: int) -> bytes:
    body = bytes((frame[0], frame[1] | 0x80, code))
    return body + crc16(body)


def _tcp_exception(frame: bytes, code: int) -> bytes:
    body = bytes((frame[_UNIT], frame[_UNIT + 1] | 0x80, code))
    return frame[: _UNIT - 2] + len(body).to_bytes(2, "big") + body


# An adapter's line: t, three digits of the identifier (T: eight), one of the length, two for each byte, return.


def _identifier_end(line: bytes) -> int:
    return 4 if line[:1] == b"t" else 9


def _is_answer_or_data(line: bytes) -> bool:
    """Process data and SDO answers; not the network's own: NMT, SYNC, emergencies, heartbeats."""
    return line[:1] == b"T" or 0x180 <= int(line[1:4], 16) < 0x600


def _half(line: bytes) -> bytes:
    """The same identifier with half of the bytes: a controller passes no frame that was cut on the wire."""
    end = _identifier_end(line)
    count = int(line[end : end + 1]) // 2
    return line[:end] + b"%d" % count + line[end + 1 : end + 1 + 2 * count] + b"\r"


def _sdo_abort(line: bytes, code: int) -> bytes:
    """The same object, refused; frames that are not SDO answers pass."""
    if not 0x580 <= int(line[1:4], 16) < 0x600:
        return line
    return line[:5] + b"80" + line[7:13] + code.to_bytes(4, "little").hex().upper().encode() + b"\r"


RTU = Framing(_cut, wrong_crc=lambda f: f[:-1] + bytes((f[-1] ^ 1,)), exception=_rtu_exception)
TCP = Framing(_cut, exception=_tcp_exception)
CANOPEN = Framing(_half, abort=_sdo_abort, concerns=_is_answer_or_data)
CAN = Framing(_half)
ME_LINE = Framing(_cut, wrong_crc=lambda f: f[:-2] + bytes((f[-2] ^ 1, f[-1])))
ME_STREAM = Framing(_cut)
