"""Makes docs/tried.md and the short table of it in README.md: `python -m tests.benches.tried`.

They name the third-party programs that the drivers are tried against, their versions, and the tests.
"""

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
ROOMS = ("drivers", "gateway", "examples")
"""Folders of `tests` that are searched."""


@dataclass(frozen=True, slots=True)
class Tried:
    """A third-party program or library."""

    name: str
    made_by: str
    """Package, and where it comes from: `npm`, `PyPI` or `Debian`."""
    package: str
    what: str
    """Its role for the gateway, and what was tried with it."""
    trace: str
    """How a test file shows that it uses it, as a regular expression."""
    wire: str
    """The protocol that it speaks: its row in README.md."""
    debian_version: str = ""
    """The upstream version in Debian 12."""

    @property
    def version(self) -> str:
        """The version from the lock files; for a Debian package as stated here, which a test with marker `peer`
        checks."""
        match self.made_by:
            case "npm":
                return _npm()[self.package]
            case "PyPI":
                return _locked()[self.package]
            case _:
                return self.debian_version

    def tests(self) -> Iterator[Path]:
        """The test files that use it."""
        for room in ROOMS:
            for file in sorted((ROOT / "tests" / room).rglob("test_*.py")):
                if re.search(self.trace, file.read_text("utf-8")):
                    yield file


MODBUS = "Modbus, serial lines"
CAN = "CANopen, CAN"
CONTROLS = "OPC UA, MTConnect, ADS"
OUTLETS = "MQTT, databases"
NC = "a control"

PEERS = (
    Tried(
        "libmodbus",
        "Debian",
        "libmodbus5",
        "Modbus RTU and TCP server: supplied profiles, all four tables, refused addresses, silence, a line that "
        "echoes, one that flips bits",
        r"libmodbus_line",
        MODBUS,
        "3.1.6",
    ),
    Tried(
        "modbus-serial",
        "npm",
        "modbus-serial",
        "Modbus RTU and TCP server: supplied profiles, coils and registers, "
        "a silent unit beside others, refused addresses, a connection that ends after each answer",
        r'node_with\("modbus_serial"',
        MODBUS,
    ),
    Tried(
        "pymodbus",
        "PyPI",
        "pymodbus",
        "Modbus TCP server: types and orders, IO-Link masters, unknown unit ids, `inspect registers`; "
        "frames of another master. Our driver encodes with it, too",
        r"from pymodbus\.(server|framer)",
        MODBUS,
    ),
    Tried(
        "canopen (Node.js)",
        "npm",
        "canopen",
        "CANopen node: CiA 404 by SDO, SYNC and timer, heartbeat, emergencies; objects without a device profile",
        r'node_with\("canopen_node"',
        CAN,
    ),
    Tried(
        "canopen (Python)",
        "PyPI",
        "canopen",
        "CANopen node by an EDS: types, refused objects, identity, `inspect objects`. Our driver uses its client",
        r"LibraryNode\(",
        CAN,
    ),
    Tried(
        "cantools",
        "PyPI",
        "cantools",
        "encodes multiplexed CAN messages, one and two levels. Our driver decodes with it",
        r"(?m)^import cantools",
        CAN,
    ),
    Tried(
        "asyncua",
        "PyPI",
        "asyncua",
        "OPC UA server: values, statuses, ages, unknown nodes, lost sessions, `inspect "
        "nodes`. Our driver uses its client",
        r"Drives\(",
        CONTROLS,
    ),
    Tried(
        "node-opcua",
        "npm",
        "node-opcua",
        "OPC UA server, signed and encrypted, with a user: channels, IO-Link devices with the types of OPC 30120, and "
        "a control with its part program",
        r'node_with\("node_opcua"',
        CONTROLS,
    ),
    Tried(
        "mtconnect",
        "PyPI",
        "mtconnect",
        "MTConnect agent: positions, speeds, states, units and types of data items, UNAVAILABLE",
        r"mtconnect_agent\(",
        CONTROLS,
    ),
    Tried(
        "pyads",
        "PyPI",
        "pyads",
        "ADS server for tests, as a TwinCAT PLC: variables, missing ones, a stopped program. `examples/ads` uses its "
        "client, which is Beckhoff's",
        r"ads_server\(",
        CONTROLS,
    ),
    Tried(
        "ser2net",
        "Debian",
        "ser2net",
        "device server of a serial line, by RFC 2217 and by raw TCP: Modbus RTU and a displacement sensor, speeds, "
        "loss and return",
        r"benches\.ser2net",
        MODBUS,
        "4.3.11",
    ),
    Tried(
        "Mosquitto",
        "Debian",
        "mosquitto",
        "MQTT broker and, as a subscriber, its own client: retained messages, last will, TLS with users and "
        "certificates, refusals, loss and return, `inspect topics`",
        r"benches\.mosquitto",
        OUTLETS,
        "2.0.11",
    ),
    Tried(
        "InfluxDB",
        "Debian",
        "influxdb",
        "database: what the outlet writes by line protocol is read back; escaping, times, refusals. InfluxDB 2 was not "
        "tried",
        r"influxdb1\(",
        OUTLETS,
        "1.6.7",
    ),
    Tried(
        "VictoriaMetrics",
        "Debian",
        "victoria-metrics",
        "database that takes line protocol at the address and in the form of InfluxDB 2, without its tokens",
        r"victoria_metrics\(",
        OUTLETS,
        "1.79.5",
    ),
    Tried(
        "LinuxCNC",
        "Debian",
        "linuxcnc-uspace",
        "a real numerical control, with emulated motors and probe",
        r"simulators\.linuxcnc|linuxcnc_bench|linuxcnc_motion",
        NC,
        "2.9.0",
    ),
)


def page() -> str:
    """The whole page."""
    rows = []
    for peer in PEERS:
        named = ", ".join(f"`{file.relative_to(ROOT / 'tests').as_posix()}`" for file in peer.tests())
        rows.append(f"| {peer.name} | {peer.version} ({peer.made_by}) | {peer.what} | {named} |")
    return _HEAD + "\n".join(rows) + "\n" + _TAIL


def short() -> str:
    """The table in README.md: one row per wire."""
    rows = []
    for wire in dict.fromkeys(peer.wire for peer in PEERS):
        named = ", ".join(f"{peer.name} {peer.version}" for peer in PEERS if peer.wire == wire)
        rows.append(f"| {wire} | {named} |\n")
    return _SHORT_HEAD + "".join(rows)


def between_marks(readme: str) -> tuple[str, str, str]:
    """The parts of README.md: before its table, the table, and after it. Raises ValueError without the marks."""
    before, table = readme.split(_BEGIN)
    table, after = table.split(_END)
    return before + _BEGIN, table, _END + after


def _locked() -> dict[str, str]:
    return dict(re.findall(r"(?m)^([a-z0-9-]+)==([^ ;]+)", (ROOT / "requirements" / "dev.lock").read_text("utf-8")))


def _npm() -> dict[str, str]:
    found: dict[str, str] = {}
    for file in sorted((ROOT / "tests" / "benches" / "peers").glob("*/package.json")):
        found |= json.loads(file.read_text("utf-8"))["dependencies"]
    return found


_BEGIN, _END = "<!-- made by tests/benches/tried.py -->\n", "<!-- end -->\n"
_SHORT_HEAD = """\
| wire | third-party programs in the tests ([what was tried](docs/tried.md)); no real device was tried |
|---|---|
"""
_HEAD = """\
# What the drivers were tried on

Generated by `python -m tests.benches.tried` from the tests and the lock files; a test fails when this page is out of
date. Third parties wrote every program in the table, so a misread specification shows as a disagreement. `.ci/run` runs
all of these tests.

| peer | version | what it is, and what was tried | files in `tests/` |
|---|---|---|---|
"""
_TAIL = """
**No real device and no real control is in this table, because none was tried.** The supplied profiles come from
manuals, and so do the emulators in `simulators/devices/`: they were written from the manual and not from the driver.
Facts that no manual confirms are marked **confirm** in [devices](devices.md). [nc](nc.md) says what was tried of the
control itself.
"""


def write(root: Path) -> None:
    """Both tables, below this folder."""
    (root / "docs" / "tried.md").write_text(page(), "utf-8")
    readme = root / "README.md"
    before, _, after = between_marks(readme.read_text("utf-8"))
    readme.write_text(before + short() + after, "utf-8")


if __name__ == "__main__":
    write(ROOT)
