"""Writes docs/faults.md from the fault matrix: `python -m tests.benches.faults.page > docs/faults.md`."""

from collections.abc import Iterable, Mapping
from textwrap import fill

from tests.benches.faults.matrix import COMM, HARMLESS, MATRIX, Case
from tests.benches.faults.plants import WIRES

HEAD = """# Faults

What each fault of a sensor, a device or a wire looks like, and what to do about it. The page is generated from the
table of the tests, which play each row over a real wire (pseudo-terminal, TCP, serial CAN adapter, UDP multicast) with
a period of 0.4 s. Each time they check that

- the channel's quality changes within two periods, and the reading says why, in the words of the last column;
- no earlier value is shown as good in the meantime;
- other devices on the wire keep their period (99th percentile within 20 %) unless the wire itself is gone, and other
  buses always do;
- when the fault is gone, the channel is good again by itself. (A bus that was away for long may take up to
  `retry_max_periods`, 60 by default; the tests use 2);
- the log and the events report the fault once when it begins and once when it ends.

`comm_fault`: no valid answer. `sensor_fault`, `out_of_range`: the device answers, but this channel is broken or beyond
its range. `stale`: the number may be old. Channels that are not good have no number, or are not used. If a read hangs
(for up to `read_limit_s`), the channels become `stale` when their last number is three periods old.

How the gateway waits and asks again: [devices](devices.md#what-holds-on-every-bus).

In the column of wires, a bus without a device means all of its devices that the tests play:

{wires}
"""

WIDTH = 120

MEANING: Mapping[str, str] = {
    "unplugged and back": (
        "The adapter or the cable is unplugged, or the host is off. The gateway tries to open the bus again after 1, "
        "2, 4 ... periods, up to `retry_max_periods`. It finds a serial port again by its permanent name."
    ),
    "dead device": (
        "The device does not answer: no power, wrong address, broken. On multicast it looks like an unplugged one."
    ),
    "dead device, long timeout": (
        "The same with a `timeout_s` of half a period. The gateway waits less for a device that usually answers "
        "quickly."
    ),
    "half-open connection": (
        "The other end disappears without closing the connection: power cut, network switched. The old connection "
        "never works again. When no device on it answers, the gateway closes it and opens a new one."
    ),
    "gateway to a dead device": (
        "The TCP gateway answers for the device behind it. Its neighbours share the connection and keep it."
    ),
    "wrong device answers": (
        "Two devices have the same address, or a gateway mixes them up. No answer of another device becomes a value."
    ),
    "late answer": (
        "The answer arrives after `timeout_s`. It is used in the same period, and never for a later question. If this "
        "happens often, raise `timeout_s`. A Micro-Epsilon sensor on RS-485 or a node read after SYNC that stays one "
        "answer behind permanently cannot be detected."
    ),
    "late answer, in another's time": (
        "The answer arrives while another device on the wire is asked. It is not taken for the answer of any device."
    ),
    "checksum error": (
        "Noise, missing termination, wrong baud rate. CAN frames with a wrong checksum never leave the CAN controller; "
        "TCP has its own checksum."
    ),
    "truncated frame": "A frame ends too early. The next frame is read from its own beginning.",
    "truncated datagram": "A datagram in the group that is not a CAN frame is ignored.",
    "overlong frame": "A frame is longer than allowed, or longer than requested.",
    "exception code": "The device understood the request and refused it. Check whether the profile matches the device.",
    "silent for one address": (
        "The unit answers, but not a request for one of its addresses: the profile names one that it does not have, or "
        "a module behind it is gone. At first it looks like a lost unit; then only the channels that need this "
        "address are lost ([profiles](own-profile.md#a-device-with-several-kinds-of-values))."
    ),
    "bus-off": (
        "The CAN controller left the bus after too many errors: wrong bitrate, short circuit, missing termination."
    ),
    "node reboots": (
        "The node lost power and is back. The gateway checks it again (sensor types, units) and starts it (NMT)."
    ),
    "heartbeat lost": (
        "The node answers although its heartbeat has stopped: its firmware may hang and repeat the last values."
    ),
    "returns with another type": (
        "Another device, or another setting, has replaced the previous one. Its values are refused."
    ),
    "sensor open": (
        "A wire is disconnected or broken. The PTA8D08 shows 97.7 °C, like any other number: only the profile's guess "
        "detects it."
    ),
    "sensor short": "The wires touch.",
    "over range": "Above what the input can measure.",
    "under range": "Below what the input can measure.",
}
SLOW = """## slow device
Each device answers within `timeout_s`, but together the devices of the bus take longer than the period. Every reading
is good, but late. An event says how many periods were missed and which device takes longest. Raise `period_s` or the
line's speed, or read fewer channels.
"""
FROZEN = """## frozen value
With `stuck_after_s` set, a channel whose number has not changed at all for that long is `stale` ("exactly 21 for 600
s"), on every kind of bus. Without it a frozen value cannot be distinguished from a steady one.
"""
REST = """\
On every wire above the computer's clock also jumps by an hour, forwards and back, while readings arrive: only the UTC
of the readings jumps. With every core busy, periods are as regular as the computer lets a thread wake. All rows of a
wire are played ten times in sequence and leave no descriptor, thread, task or memory behind.

Five units share one Modbus RTU line, read every second with a timeout of half a second. Three fall silent at once, or
one comes and goes, or one answers late once: the others keep every interval within 20 % of the period, and a single
late answer is not reported as a fault. When all five fall silent, each shows it within two periods, and no period is
missed.

`python -m tests.benches.strangers --seeds 200000` draws Modbus devices that are slow, mute, closing, restarting, one
answer behind, or that send twice or in pieces; `--of me` draws Micro-Epsilon controllers that stand still, are
exchanged, lose bytes or send late. No value may be wrong, and what a plain client with a timeout of 5 s reads within
the period, the gateway reads from the 20th period on.
"""


def page() -> str:
    """The text of docs/faults.md."""
    played = "\n".join(f"- {bus}: {', '.join(each)}" for bus, each in _profiles(WIRES.values()).items())
    parts = [HEAD.replace("{wires}", played)]
    faults = dict.fromkeys(case.fault for case in MATRIX)
    parts += [
        f"## {fault}\n{fill(MEANING[fault], WIDTH)}\n\n{_table([c for c in MATRIX if c.fault == fault])}"
        for fault in faults
    ]
    parts += [FROZEN, SLOW]
    parts.append(
        "## What no reading may show\nEvery value is right, every period is kept, nothing is reported.\n\n"
        f"{_harmless()}\n{REST}"
    )
    return "\n".join(parts)


def _table(cases: list[Case]) -> str:
    rows: dict[tuple[str, str, str], list[str]] = {}
    for case in cases:
        rows.setdefault((case.quality.value, _who(case), _words(case)), []).append(WIRES[case.plant])
    lines = ["| wire | quality | channels | the reading says |", "|---|---|---|---|"]
    lines += [f"| {_by_bus(wires)} | `{quality}` | {who} | {says} |" for (quality, who, says), wires in rows.items()]
    return "\n".join(lines) + "\n"


def _by_bus(wires: Iterable[str]) -> str:
    every, named = _profiles(WIRES.values()), _profiles(wires)
    return "; ".join(bus if each == every[bus] else f"{bus}: {', '.join(each)}" for bus, each in named.items())


def _profiles(wires: Iterable[str]) -> dict[str, list[str]]:
    """Of each bus, in the order of the wires."""
    found: dict[str, list[str]] = {}
    for wire in wires:
        bus, _, profile = wire.partition(", ")
        found.setdefault(bus, []).append(profile)
    return found


def _who(case: Case) -> str:
    if case.whole_bus:
        return "all on this wire"
    if case.in_part:
        return "those that need the address; for up to three periods all of the device"
    return "all of the device" if case.quality is COMM or case.whole_device else "this one"


def _words(case: Case) -> str:
    says = " or ".join(f"“{part}”" for part in case.says.split("|"))
    return f"{says}, then “{case.then}”" if case.then else says


def _harmless() -> str:
    lines = ["| disturbance | wires |", "|---|---|"]
    for disturbance in dict.fromkeys(case.disturbance for case in HARMLESS):
        wires = _by_bus([WIRES[case.plant] for case in HARMLESS if case.disturbance == disturbance])
        lines.append(f"| {disturbance} | {wires} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(page(), end="")
