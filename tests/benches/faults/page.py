"""Writes docs/faults.md from the table that the tests play: `python -m tests.benches.faults.page > docs/faults.md`."""

from collections.abc import Mapping

from tests.benches.faults.matrix import COMM, HARMLESS, MATRIX, Case
from tests.benches.faults.plants import WIRES

HEAD = """# Faults

What each fault of a sensor, a device or a wire looks like to you, and what to do. This page is written from the table
of the tests: each row is played there over the real wire (pseudo-terminal, TCP, serial CAN adapter, UDP multicast),
with the gateway's acquisition on the other end, and in each it is checked that

- the channel's quality turns within two periods, and the reading says why, in the words of the last column;
- no value of before is shown as good meanwhile;
- other devices on the wire keep their period (99th percentile within 20 %) unless the wire itself is gone, and other
  buses always;
- recovery needs nobody: when the fault is gone the channel is good again;
- log and events tell it once when it begins and once when it ends, not each second.

`comm_fault`: no valid answer. `sensor_fault`, `out_of_range`: the device answers, this channel is broken or beyond.
`stale`: the number may be an old one. Channels that are not good carry no number, or are not used. While a read hangs
(it may, up to `read_limit_s`), the service publishes its bus's channels as `stale`, without a number and with the age
of the last one, as soon as that is three periods old.
"""

MEANING: Mapping[str, str] = {
    "unplugged and back": (
        "The adapter or the cable is out, or the host is off. The bus is opened again and again, less and less "
        "often up to `retry_max_periods`; a serial port is found again by its lasting name."
    ),
    "dead device": (
        "It hears and does not answer: no power, wrong address, broken. It is asked less and less often. On "
        "multicast it cannot be told from one that is unplugged."
    ),
    "dead device, long timeout": (
        "The same with a `timeout_s` of half a period. A device that usually is quick is not waited for so long."
    ),
    "half-open connection": (
        "The other end is gone without a word: power cut, network switched. The connection of before never comes back "
        "to life: when nobody on it answers, it is closed and opened again."
    ),
    "gateway to a dead device": (
        "The TCP gateway answers for the device behind it. Its neighbours share the connection and keep it."
    ),
    "wrong device answers": (
        "Two devices with one address, or a gateway that mixes them up. No foreign answer becomes a value."
    ),
    "late answer": (
        "It comes after `timeout_s`, when the next request waits for its own, and is not taken for that. If it is the "
        "rule, raise `timeout_s`. Of Modbus devices and CANopen nodes read by SDO this holds though every answer be "
        "one behind. What a Micro-Epsilon sensor on RS-485 or a node after SYNC sends carries no number: there it "
        "holds when answers come late for a while, and one that lags behind for ever cannot be told."
    ),
    "late answer, in another's time": "It comes while another device on the wire is asked, and is taken for nobody's.",
    "checksum error": (
        "Noise, missing termination, wrong baud rate. CAN frames with a wrong checksum never leave the controller; "
        "TCP has its own."
    ),
    "truncated frame": "A frame ends too early. What comes next is read from its own beginning.",
    "truncated datagram": "What is no CAN frame in the group is passed over.",
    "overlong frame": "A frame is longer than it may be, or than was asked for.",
    "exception code": "The device understood and said no. Does the profile fit the device?",
    "bus-off": (
        "The CAN controller left the bus after too many errors: wrong bitrate, short circuit, missing termination."
    ),
    "node reboots": (
        "The node was without power and is back. It is checked anew (sensor types, units) and started (NMT)."
    ),
    "heartbeat lost": (
        "The node answers while its heartbeat stopped: its program may hang and repeat the last values."
    ),
    "returns with another type": (
        "Another device, or another setting, is in the place of the one that was gone. Its values are refused."
    ),
    "sensor open": (
        "A wire is off or broken. The PTA8D08 shows 97.7 °C, a number like any other: only the profile's guess tells."
    ),
    "sensor short": "The wires touch.",
    "over range": "Above what the input can measure.",
    "under range": "Below what the input can measure.",
}
SLOW = """## slow device
It answers within `timeout_s`, but the devices of the bus together do not within the period: every reading is good, and
later than it should be. An event says how many periods were missed and which device takes longest; `periods_missed` in
the key `status` counts them. Raise `period_s` or the line's speed, or read fewer channels of it.
"""
FROZEN = """## frozen value
With `stuck_after_s` set, a channel whose number has not changed at all for so long is `stale` ("exactly 21 for
600 s"), on every kind of bus. Without it a frozen value cannot be told from a steady one.
"""
REST = """Two more are played on every wire above: the computer's clock jumps by an hour, forwards and back, while
readings come and while the bus is closed and opened (periods, timeouts and ages stand on the monotonic clock, those of
the libraries too; only the UTC of readings jumps); and every core is busy with other programs (periods are as regular
as the computer lets a thread wake).

A device that comes and goes, silent for a period and back for a while, on a wire whose `timeout_s` is half a period:
its neighbours keep their period.

Every row above is also played ten times over, all rows of a wire in a row, and leaves no descriptor, thread, task or
memory behind. Of each wire that is some 350 to 850 polls in half a minute, as many as in a quarter of an hour at 1 Hz;
it says nothing of what would grow in weeks.

Five units on one Modbus RTU line are played too, read each second with a timeout of half a second: three fall silent at
once, or one comes and goes, or one answers late for once. In each the others keep every interval within 20 % of the
period, and who was late for once is not told as a fault. When all five fall silent, each shows it within two periods,
and no period is missed.
"""


def page() -> str:
    """The text of docs/faults.md."""
    parts = [HEAD]
    faults = dict.fromkeys(case.fault for case in MATRIX)
    parts += [f"## {fault}\n{MEANING[fault]}\n\n{_table([c for c in MATRIX if c.fault == fault])}" for fault in faults]
    parts += [FROZEN, SLOW]
    parts.append(
        f"## What no reading may show\nEvery value right, every period kept, nothing told.\n\n{_harmless()}\n{REST}"
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
