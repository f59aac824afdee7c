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


def find_ports(dev: Path = Path("/dev"), net: Path = Path("/sys/class/net")) -> list[ScanPort]:
    """Serial ports, those with a permanent name first, then CAN interfaces."""
    by_id = dev / "serial" / "by-id"
    links = _listed(by_id)
    named = {link.resolve() for link in links}
    found = [ScanPort("serial", str(link), f"{link.resolve().name}{_allowed(link)}") for link in links]
    others = [
        device for pattern in _WITHOUT_ID for device in sorted(dev.glob(pattern)) if device.resolve() not in named
    ]
    found += [ScanPort("serial", str(d), f"may have another name after a reboot{_allowed(d)}") for d in others]
    can = [interface for interface in _listed(net) if _read(interface / "type") == _CAN]
    found += [ScanPort("can", interface.name, _read(interface / "operstate") or "unknown") for interface in can]
    return found


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
