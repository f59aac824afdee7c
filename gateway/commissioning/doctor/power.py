"""Reports of `doctor` on a Raspberry Pi's supply voltage, and on a processor that is or was slowed down."""

import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

from gateway.commissioning.doctor.kernel_files import kernel_text
from gateway.model.codes import NoticeCode
from gateway.model.text import Text

_LIMIT_S = 5.0
_BITS: Final[Mapping[int, tuple[NoticeCode, str]]] = {
    0: (NoticeCode.SUPPLY_LOW, ""),
    1: (NoticeCode.PROCESSOR_SLOW, "capped"),
    2: (NoticeCode.PROCESSOR_SLOW, "throttled"),
    3: (NoticeCode.PROCESSOR_SLOW, "hot"),
}
"""Bits of the firmware's get_throttled for now (raspberrypi.com, documentation of vcgencmd)."""
_EARLIER = 16
"""Bits to the left of them are the same for earlier."""
_VCGENCMD = "usr/bin/vcgencmd"
_HWMON = "sys/class/hwmon/hwmon*"
_THROTTLED = "sys/devices/platform/soc*/soc*:firmware/get_throttled"


def power(root: Path) -> Iterator[Text]:
    """What is wrong; nothing where there is no such firmware.

    Only vcgencmd knows what has happened since the start. The kernel clears those bits whenever it asks the firmware,
    every 2 s, so in its files they describe only the last moment. It calls get_throttled deprecated, and only some
    kernels have it.
    """
    if (bits := _of_vcgencmd(root)) is not None:
        yield from _told(bits, "since_start")
        return
    files = sorted(root.glob(_THROTTLED))
    for file in files:
        yield from _told(_number(kernel_text(file)) or 0, "lately")
    if not files and any(kernel_text(sensor / "in0_lcrit_alarm") == "1" for sensor in _supply_sensors(root)):
        yield Text(NoticeCode.SUPPLY_LOW, moment="now")


def _told(bits: int, earlier: str) -> Iterator[Text]:
    for moment, shift in (("now", 0), (earlier, _EARLIER)):
        for bit, (code, how) in _BITS.items():
            if bits >> bit + shift & 1:
                yield Text(code, moment=moment, how=how)


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
