"""Writes docs/faults.md from the fault matrix: `python -m tests.benches.faults.page > docs/faults.md`."""

from collections.abc import Mapping
from textwrap import fill

from tests.benches.faults.matrix import COMM, HARMLESS, MATRIX, Case
from tests.benches.faults.plants import WIRES

HEAD = """# Faults

This page shows what each fault of a sensor, a device or a wire looks like, and what to do about it. It is generated
from the table of the tests. They play each row over a real wire (pseudo-terminal, TCP, serial CAN adapter, UDP
multicast), with the gateway's acquisition on the other end. The period is 0.4 s, and `retry_max_periods` is 2. (The
defaults are 1 s and 60: a bus that was away for long is then back up to 60 periods later.) Each time they check that

- the channel's quality changes within two periods, and the reading says why, in the words of the last column;
- no earlier value is shown as good in the meantime;
- other devices on the wire keep their period (99th percentile within 20 %) unless the wire itself is gone, and other
  buses always do;
- recovery needs no one: when the fault is gone, the channel is good again;
- the log and the events report the fault once when it begins and once when it ends, not every second.

`comm_fault`: no valid answer. `sensor_fault`, `out_of_range`: the device answers, but this channel is broken or beyond
its range. `stale`: the number may be old. Channels that are not good have no number, or are not used. A read may hang
for up to `read_limit_s`. Meanwhile, as soon as the last number of a channel of that bus is three periods old, the
service publishes the channel as `stale`, without a number and with that age; `probe --watch` shows it so, and `record`
counts it as not good.
"""

WIDTH = 120

MEANING: Mapping[str, str] = {
    "unplugged and back": (
        "The adapter or the cable is unplugged, or the host is off. The gateway tries to open the bus again, less and "
        "less often, up to `retry_max_periods`. It finds a serial port again by its permanent name."
    ),
    "dead device": (
        "The device does not answer: no power, wrong address, broken. The gateway asks it less and less often. On "
        "multicast it cannot be distinguished from an unplugged one."
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
        "The answer arrives after `timeout_s`. In the same period it is used, because the device has only been asked "
        "the same question again. Later it is never taken for the answer to the next question. If this happens often, "
        "raise `timeout_s`. For Modbus devices and CANopen nodes read by SDO this holds even if every answer is one "
        "request late. Micro-Epsilon sensors on RS-485 and nodes read after SYNC do not number their answers. There it "
        "holds when answers are late for a while, but a device that stays one answer behind permanently cannot be "
        "detected."
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
        "a module behind it is gone. At first it looks like a lost unit; after that, only the channels that need this "
        "address are lost. The gateway divides the request to find the address, and asks for it again less and less "
        "often, once in a period at most, after all other devices."
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
is good, but late. An event says how many periods were missed and which device takes longest; `periods_missed` in the
key `status` counts them. Raise `period_s` or the line's speed, or read fewer channels.
"""
FROZEN = """## frozen value
With `stuck_after_s` set, a channel whose number has not changed at all for that long is `stale` ("exactly 21 for 600
s"), on every kind of bus. Without it a frozen value cannot be distinguished from a steady one.
"""
REQUEST = """## The life of a Modbus request
A request waits for the line and for the rest that its unit needs; then it is sent. What becomes of it:

| state | it means | what follows |
|---|---|---|
| sent | its answer is waited for, about as long as the unit usually takes and at most `timeout_s` | answered, late |
| late | it was waited for in vain | the question is repeated, or the late answer is waited for |
| answered | by a value or a refusal | the value is used, if the question is still the same |
| lost | a later request was answered, and units answer in order; or ten seconds have passed | |

Over TCP an answer carries the number of its request. On a serial line it only has a form: unit, function and length. So
no two different requests wait for answers of one form: the unit is first asked for something of another length, and
once it has answered that, nothing older can follow. A late answer is therefore never taken for another one, whether
the unit is slow, one answer behind for ever, or sends each answer twice. (The last two at once cannot be told apart.)

Of each unit the gateway learns how long its answers take, which rest it needs after an answer (some ignore or refuse
what comes sooner, some say that they are busy), and whether missed answers come in the end. If they do, it waits
for them and does not ask again, because a slow unit would have to answer both. A device that is heard is asked again as
long as the period lasts, after all others; one that is silent, less and less often, in what is left of the period.

Devices drawn from random seeds try this (`python -m tests.benches.strangers --seeds 200000`): mute after a connection,
slow, in need of a rest, closing, restarting, behind, refusing for a while, sending twice or in pieces. No value may be
wrong, and what a plain client with a timeout of 5 s reads within the period, the gateway reads from the 20th period on.
"""
REST = """\
The tests play two more disturbances on every wire above. First, the computer's clock jumps by an hour, forwards and
back, while readings arrive and while the bus is closed and opened. Periods, timeouts and ages use the monotonic clock,
in the libraries too, so only the UTC of the readings jumps. Second, every core is busy with other programs. Periods are
then as regular as the computer lets a thread wake.

An intermittent device, silent for one period and back for a while, is played on a wire whose `timeout_s` is half a
period. Its neighbours keep their period.

Every row above is also played ten times, all rows of a wire in sequence. This leaves no descriptor, thread, task or
memory behind. For each wire it means about 350 to 850 polls in half a minute, as many as in a quarter of an hour at 1
Hz. It does not show what would grow over weeks.

The tests also play five units on one Modbus RTU line, read every second with a timeout of half a second. Three fall
silent at once, or one is intermittent, or one answers late once. Each time the others keep every interval within 20 %
of the period, and a single late answer is not reported as a fault. When all five fall silent, each one shows it within
two periods, and no period is missed.
"""


def page() -> str:
    """The text of docs/faults.md."""
    parts = [HEAD]
    faults = dict.fromkeys(case.fault for case in MATRIX)
    parts += [
        f"## {fault}\n{fill(MEANING[fault], WIDTH)}\n\n{_table([c for c in MATRIX if c.fault == fault])}"
        for fault in faults
    ]
    parts += [FROZEN, SLOW, REQUEST]
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
    lines += [f"| {'; '.join(wires)} | `{quality}` | {who} | {says} |" for (quality, who, says), wires in rows.items()]
    return "\n".join(lines) + "\n"


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
        wires = "; ".join(WIRES[case.plant] for case in HARMLESS if case.disturbance == disturbance)
        lines.append(f"| {disturbance} | {wires} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(page(), end="")
