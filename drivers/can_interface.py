"""Opening and releasing a CAN interface with python-can. Both block."""

from contextlib import suppress
from typing import Any

import can

from drivers.base import ConnectError
from drivers.bus_settings import CanInterfaceSettings

_SERIAL_WAIT_S = 0.1
"""How long python-can's slcan blocks for a byte. Its 1 ms would wake the thread a thousand times a second for
nothing; a byte that comes ends the wait at once, so a longer wait costs no latency."""


def open_interface(bus: str, settings: CanInterfaceSettings) -> can.BusABC:
    """The interface, open. Raises ConnectError."""
    options: dict[str, Any] = {"interface": settings.interface, "channel": settings.channel}
    if settings.interface == "slcan":
        options |= {"bitrate": settings.bitrate, "sleep_after_open": 0.0, "timeout": _SERIAL_WAIT_S}
    elif settings.interface == "udp_multicast":
        options |= {"port": settings.port, "hop_limit": 0}
    try:
        return can.Bus(**options)
    except (can.CanError, OSError, ValueError, ImportError) as error:
        raise ConnectError(
            f"cannot open {settings.interface} {settings.channel}: {error}",
            bus=bus,
            hint="is the adapter plugged in, or the interface up? another program may have it open",
        ) from error


def release(interface: Any) -> None:
    """Close what python-can left open when its own shutdown failed."""
    port = getattr(interface, "serialPortOrig", None)
    with suppress(OSError):
        if port is not None:
            port.close()
