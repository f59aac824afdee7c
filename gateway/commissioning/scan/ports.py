"""Lists serial ports by their permanent names, and the kernel's CAN interfaces."""

import os
from dataclasses import dataclass
from pathlib import Path

_CAN = "280"
"""ARPHRD_CAN, the type of a network interface that is a CAN bus (linux/if_arp.h)."""
_WITHOUT_ID = ("ttyUSB*", "ttyACM*", "ttyAMA*")


@dataclass(frozen=True, slots=True)
class ScanPort:
    """One place to scan."""

    command: str
    """`serial` or `can`."""
    name: str
    remark: str


def find_ports(dev: Path = Path("/dev"), sys: Path = Path("/sys")) -> list[ScanPort]:
    """Serial ports, those with a permanent name first, then CAN interfaces.

    An adapter without a serial number has the name of its socket: any other one of its kind has the same by-id name.
    """
    sockets = sockets_of(dev)
    links = {link.resolve(): link for link in _listed(dev / "serial" / "by-id")}
    named = {d: link for d, link in links.items() if d not in sockets or has_own_name(d, sys)}
    by_socket = {
        device: sockets[device]
        for pattern in _WITHOUT_ID
        for device in sorted(dev.glob(pattern))
        if device in sockets and device not in named
    }
    found = [ScanPort("serial", str(link), f"{device.name}{_allowed(link)}") for device, link in named.items()]
    found += [
        ScanPort("serial", str(link), f"{device.name}, in this socket{_allowed(link)}")
        for device, link in by_socket.items()
    ]
    named |= by_socket
    others = [
        device for pattern in _WITHOUT_ID for device in sorted(dev.glob(pattern)) if device.resolve() not in named
    ]
    found += [ScanPort("serial", str(d), f"may have another name after a reboot{_allowed(d)}") for d in others]
    can = [interface for interface in _listed(sys / "class/net") if _read(interface / "type") == _CAN]
    found += [ScanPort("can", interface.name, _read(interface / "operstate") or "unknown") for interface in can]
    return found


def sockets_of(dev: Path) -> dict[Path, Path]:
    """Each serial device's name by the socket that its adapter is in."""
    return {link.resolve(): link for link in reversed(_listed(dev / "serial" / "by-path"))}


def has_own_name(device: Path, sys: Path) -> bool:
    """Whether the adapter has a serial number, which is part of its by-id name, or is no USB adapter."""
    usb = usb_adapter(device, sys)
    return usb is None or (usb / "serial").is_file()


def usb_adapter(device: Path, sys: Path) -> Path | None:
    """The folder in which the kernel describes it; None: it is on no USB."""
    within = (sys / "class/tty" / device.name / "device").resolve()
    return next((folder for folder in (within, *within.parents) if (folder / "idVendor").is_file()), None)


def _listed(folder: Path) -> list[Path]:
    """Sorted; udev takes the folder away with the last adapter."""
    try:
        return sorted(folder.iterdir())
    except FileNotFoundError:
        return []


def _allowed(device: Path) -> str:
    return "" if os.access(device, os.R_OK | os.W_OK) else "; no permission: add the user to the dialout group"


def _read(file: Path) -> str:
    try:
        return file.read_text(encoding="ascii").strip()
    except OSError:
        return ""
