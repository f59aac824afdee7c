"""Finds out whether a time service has set this computer's clock, from the kernel, chrony or systemd-timesyncd."""

import ctypes
import os
import socket
import struct
from collections.abc import Callable
from pathlib import Path

_TIMEX_BYTES = 512
"""More than any Linux's struct timex (208 on 64 bit); all zero, it only reads."""
_TIME_ERROR = 5
"""What adjtimex returns while no time server keeps the clock (adjtimex(2))."""
_TIMESYNCD = Path("/run/systemd/timesync")
"""Where systemd-timesyncd leaves the file `synchronized` once it has set the clock."""
_CHRONYD = ("127.0.0.1", 323)
"""chrony's command port, on which every local user may ask for `tracking`; only root can open a port below 1024."""
CHRONYD_WAIT_S = 0.05
"""The service's loop waits this long at most; without chrony the kernel refuses at once."""

# chrony's candm.h, version 6 of its protocol (since chrony 2.0): a request is as long as its answer.
_REQUEST = 1
_REPLY = 2
_TRACKING = 33
_TRACKING_REPLY = 5
_SUCCESS = 0
_LEAP_UNSYNCHRONISED = 3
_LOCAL = 0x7F7F0101
"""Its reference is the computer's own clock (`local` in chrony.conf)."""
_ASK = struct.Struct("!BBxxHHI8x84x")
"""Version, type, command, attempt, sequence; padding."""
_ANSWER = struct.Struct("!BBxxHHH6xI8xI20xxxH")
"""Version, type, command, reply, status, sequence; of `tracking` the reference and the leap status. More follows."""


def kernel_synchronised() -> bool | None:
    """Whether the kernel knows of a time service that keeps the clock; None: it may not be asked."""
    libc = ctypes.CDLL(None)
    state = libc.adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES)) if hasattr(libc, "adjtimex") else -1
    return bool(state != _TIME_ERROR) if state >= 0 else None


def clock_synchronised(
    timesyncd: Path = _TIMESYNCD,
    chronyd: tuple[str, int] = _CHRONYD,
    kernel: Callable[[], bool | None] = kernel_synchronised,
) -> bool | None:
    """Whether a time server keeps the computer's clock; None: unknown.

    The kernel knows it of any time service. Where asking it is denied, as by ProtectClock of a systemd unit, chrony
    tells, or systemd-timesyncd's file; of another time service nothing is known then.

    chronyd: address of its command port; kernel: asks the kernel
    """
    known = kernel()
    if known is None:
        known = chrony_synchronised(chronyd)
    if known is None and timesyncd.is_dir():
        known = (timesyncd / "synchronized").exists()
    return known


def chrony_synchronised(chronyd: tuple[str, int] = _CHRONYD) -> bool | None:
    """Whether chrony has set the clock by a server; None: it does not answer."""
    sequence = int.from_bytes(os.urandom(4), "big")
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
            line.settimeout(CHRONYD_WAIT_S)
            line.connect(chronyd)
            line.send(_ASK.pack(6, _REQUEST, _TRACKING, 0, sequence))
            answer = line.recv(1024)
    except OSError:
        return None
    if len(answer) < _ANSWER.size:
        return None
    version, kind, command, reply, status, same, reference, leap = _ANSWER.unpack_from(answer)
    if (version, kind, command, reply, status, same) != (6, _REPLY, _TRACKING, _TRACKING_REPLY, _SUCCESS, sequence):
        return None
    return bool(leap != _LEAP_UNSYNCHRONISED and reference != _LOCAL)
