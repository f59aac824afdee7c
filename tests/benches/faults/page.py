"""Renews the table of faults in docs/devices.md from the fault matrix: `python -m tests.benches.faults.page`."""

from collections.abc import Mapping
from pathlib import Path

from tests.benches.faults.matrix import MATRIX

PAGE = Path(__file__).parents[3] / "docs" / "devices.md"
BEGIN, END = "<!-- python -m tests.benches.faults.page -->\n", "<!-- end of the table -->"

ROWS: Mapping[str, tuple[tuple[str, ...], str]] = {
    "unplugged and back": (
        ("unplugged and back",),
        "The adapter or the cable is unplugged, or the host is off. The gateway opens the bus again after 1, 2, 4 ... "
        "periods, up to `retry_max_periods`, and finds a serial port by its permanent name",
    ),
    "dead device": (("dead device", "dead device, long timeout"), "No power, wrong address or speed, or broken"),
    "half-open connection": (
        ("half-open connection",),
        "The other end disappeared without closing the connection. The gateway closes it and opens a new one",
    ),
    "gateway to a dead device": (
        ("gateway to a dead device",),
        "The TCP gateway answers for the device behind it. Its neighbours are not affected",
    ),
    "wrong device answers": (("wrong device answers",), "Two devices have one address, or a TCP gateway mixes them up"),
    "late answer": (
        ("late answer", "late answer, in another's time"),
        "Later than `timeout_s`: raise it if this happens often. A Micro-Epsilon sensor on RS-485, or a node read "
        "after SYNC, that is always one answer behind is not detected",
    ),
    "damaged frame": (
        ("checksum error", "truncated frame", "truncated datagram", "overlong frame"),
        "Noise, missing termination, wrong speed; over TCP a faulty device",
    ),
    "exception code": (("exception code",), "The device refuses the request: check whether the profile fits it"),
    "silent for one address": (
        ("silent for one address",),
        "The profile names an address that the unit does not have, or a module behind it is gone. After three periods "
        "only the channels that need this address are lost",
    ),
    "bus-off": (("bus-off",), "Too many errors on the CAN bus: wrong bit rate, short circuit, missing termination"),
    "node reboots": (
        ("node reboots",),
        "The node lost power and is back. It is checked again (sensor types, units) and started (NMT)",
    ),
    "heartbeat lost": (
        ("heartbeat lost",),
        "The node answers without a heartbeat: its firmware may hang and repeat the last values",
    ),
    "returns with another type": (
        ("returns with another type",),
        "Another device, or another setting. Its values are refused",
    ),
}
"""By the name that users read: the faults that they cannot tell apart, what they are, and what to do."""
SENSOR_FAULTS = {"sensor open", "sensor short", "over range", "under range"}
"""Each device shows them in its own way: the column of the table of devices."""


def table() -> str:
    """The table, as Markdown. Raises ValueError for a fault that no row has."""
    if missing := {case.fault for case in MATRIX} - SENSOR_FAULTS - {f for faults, _ in ROWS.values() for f in faults}:
        raise ValueError(f"no row of ROWS has {sorted(missing)}")
    lines = ["| fault | what it is, and what to do | quality, and the reading says |", "|---|---|---|"]
    return "\n".join([*lines, *(_row(name, *row) for name, row in ROWS.items())]) + "\n"


def page() -> str:
    """The text of docs/devices.md with the table renewed."""
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    return f"{before}{BEGIN}\n{table()}\n{END}{rest.partition(END)[2]}"


def _row(name: str, faults: tuple[str, ...], meaning: str) -> str:
    said: dict[str, dict[str, None]] = {}
    for case in MATRIX:
        if case.fault in faults:
            said.setdefault(case.quality.value, {}).update(dict.fromkeys([*case.says.split("|"), case.then]))
    told = "; ".join(
        f"`{quality}`: {', '.join(f'“{each}”' for each in says if each)}" for quality, says in said.items()
    )
    return f"| {name} | {meaning} | {told} |"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
