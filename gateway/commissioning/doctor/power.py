"""Reports of `doctor` on a Raspberry Pi's supply voltage, and on a processor that is or was slowed down."""

import subprocess
from collections.abc import Iterator
from pathlib import Path

from gateway.commissioning.doctor.kernel_files import kernel_text

_LIMIT_S = 5.0
_SUPPLY = (
    "adapters lose their connection, and cards their content",
    "use the power supply that was made for this computer",
)
_HEAT = (
    "a slow processor misses periods of buses and decides late",
    "cool the computer: heat sink, fan, a larger cabinet; if its supply voltage is too low, mend that first",
)
_NOW = {
    0: ("the supply voltage is too low", _SUPPLY),
    1: ("the processor is slowed down", _HEAT),
    2: ("the processor is throttled", _HEAT),
    3: ("the processor is slowed down, as it is hot", _HEAT),
}
"""Bits of the firmware's get_throttled (raspberrypi.com, documentation of vcgencmd)."""
_SINCE = {
    16: ("the supply voltage was too low", _SUPPLY),
    17: ("the processor was slowed down", _HEAT),
    18: ("the processor was throttled", _HEAT),
    19: ("the processor was slowed down, as it was hot", _HEAT),
}
_VCGENCMD = "usr/bin/vcgencmd"
_HWMON = "sys/class/hwmon/hwmon*"
_THROTTLED = "sys/devices/platform/soc*/soc*:firmware/get_throttled"


def power(root: Path) -> Iterator[tuple[str, str, str]]:
    """What is wrong, why it matters and what to do; nothing where there is no such firmware.

    Only vcgencmd knows what has happened since the start. The kernel clears those bits whenever it asks the firmware,
    every 2 s, so in its files they describe only the last moment. It calls get_throttled deprecated, and only some
    kernels have it.
    """
    if (bits := _of_vcgencmd(root)) is not None:
        yield from _told(bits, "since the start")
        return
    files = sorted(root.glob(_THROTTLED))
    for file in files:
        yield from _told(_number(kernel_text(file)) or 0, "in the last seconds")
    if not files and any(kernel_text(sensor / "in0_lcrit_alarm") == "1" for sensor in _supply_sensors(root)):
        what, advice = _NOW[0]
        yield f"{what} now", *advice


def _told(bits: int, since: str) -> Iterator[tuple[str, str, str]]:
    for when, meanings in (("now", _NOW), (since, _SINCE)):
        for bit, (what, advice) in meanings.items():
            if bits >> bit & 1:
                state, comma, cause = what.partition(",")
                yield f"{state} {when}{comma}{cause}", *advice


def _of_vcgencmd(root: Path) -> int | None:
    """None: it is not there, or its user may not ask the firmware (group video)."""
    try:
        asked = subprocess.run([root / _VCGENCMD, "get_throttled"], capture_output=True, timeout=_LIMIT_S, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    name, _, text = asked.stdout.decode("ascii", "replace").partition("=")
    return _number(text) if name == "throttled" else None


def _number(text: str) -> int | None:
    """From hexadecimal digits."""
    try:
        return int(text, 16)
    except ValueError:
        return None


def _supply_sensors(root: Path) -> Iterator[Path]:
    yield from (sensor for sensor in root.glob(_HWMON) if kernel_text(sensor / "name") == "rpi_volt")
