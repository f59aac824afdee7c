"""Process data of IO-Link devices from another maker's OPC UA stack (node-opcua) with the types of OPC 30120."""

from asyncio.subprocess import Process
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from drivers.base import Quality, Reading, SetupError, SystemClock
from drivers.build import make_device
from drivers.opcua.nodes import NodeValue
from drivers.profiles import load_profile
from tests.benches.buses import make_bus
from tests.benches.npm_peer import node_with, running
from tests.benches.opcua_drives import URI, Drives
from tests.benches.refusals import refusing

PROFILE = Path(__file__).parents[3] / "examples" / "io-link" / "opcua.toml"


def told(readings: Sequence[Reading]) -> list[float | tuple[str, str]]:
    """The value of a good channel, otherwise quality and reason."""
    return [round(r.value, 6) if r.quality is Quality.GOOD else (r.quality.value, r.detail) for r in readings]


async def say(process: Process, line: str) -> None:
    """Set one device's process data and its StatusCode from now on."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(line.encode() + b"\n")
    while (answer := (await process.stdout.readline()).strip()) != b"done":
        assert answer, "the peer ended"


@pytest.mark.peer
async def test_process_data_of_two_devices(tmp_path: Path) -> None:
    node = node_with("node_opcua", "node-opcua")
    arguments = (tmp_path / "pki", "oil=00EA", "bearing=ABCDFF7F")
    async with running(node, "node_opcua/io_link.js", *arguments) as (url, process):
        bus = make_bus("opc1", "opcua", {"url": url, "security": "none", "timeout_s": 60.0})
        device = make_device("iolink", bus, str(PROFILE), 1, {"oil": 0, "bearing": 1}, {}, SystemClock())
        try:
            await bus.connect()
            await device.connect()
            assert told(await device.read()) == [23.4, -3.3], "-33 in 14 bits, and both outputs switched"
            # The last measured value is still there, and looks right: only the status shows the fault.
            expected = {
                "oil 00EA BadNotConnected": ("comm_fault", "the server reports BadNotConnected"),
                "oil 00EA BadDeviceFailure": ("sensor_fault", "the server reports BadDeviceFailure"),
                "oil 7FFC Good": ("sensor_fault", "the sensor has no data"),
                "oil EA00 Good": ("out_of_range", "-563.2 is beyond the profile's limits"),
                "oil 00 Good": ("sensor_fault", "the node holds 1 of the 2 bytes that the channel needs"),
                "oil 00EB Good": 23.5,
            }
            found = {}
            for line in expected:
                await say(process, line)
                oil, bearing = told(await device.read())
                assert bearing == -3.3, "a neighbour's process data is the neighbour's"
                found[line] = oil
            assert found == expected
        finally:
            await bus.close()


HEAD = f"""
protocol = "opcua"
title = "bytes"
unit = "degC"
namespace = "{URI}"
"""
BYTES = """
[[node]]
node = "s={name}"
type = "uint16"
shift = 4
invalid = [{{ bit = 11, quality = "sensor_fault", detail = "highest bit" }}]
[[node]]
node = "s={name}"
element = 1
type = "int8"
[[node]]
node = "s={name}"
element = 2
type = "float32"
"""


@pytest.mark.simulated_time
@pytest.mark.parametrize("name", ["bytes", "counts"])
async def test_bytes_of_a_node_as_numbers(tmp_path: Path, name: str) -> None:
    """A ByteString, and an array of whole numbers."""
    kind: Callable[[bytes], bytes | list[int]] = bytes if name == "bytes" else list
    profile = tmp_path / "bytes.toml"
    others = "".join(f'[[node]]\nnode = "s={other}"\ntype = "uint8"\n' for other in ("motor", "name", "axes"))
    profile.write_text(HEAD + BYTES.format(name=name) + others, encoding="utf-8")
    server = Drives()
    await server.start()
    bus = make_bus("opc1", "opcua", {"url": server.url, "security": "none", "timeout_s": 5.0})
    device = make_device("bytes", bus, str(profile), 1, {f"c{i}": i for i in range(6)}, {}, SystemClock())
    try:
        await bus.connect()
        await server.set(name, kind(bytes.fromhex("12FF41BC0000")))
        found = told(await device.read())
        assert found[:3] == [0x12F, -1, 23.5]
        assert found[3:] == [
            ("sensor_fault", f"the node holds no bytes: {shown}") for shown in ("61.25", "'drive'", "[1.5, 48.0]")
        ]
        await server.set(name, kind(bytes.fromhex("92107FC00000")))
        assert told(await device.read())[:3] == [
            ("sensor_fault", "highest bit"),
            16,
            ("sensor_fault", "the reading gives nan, which is not a finite number"),
        ]
        await server.set(name, kind(b"\x00\x10"))
        few = ("sensor_fault", "the node holds 2 of the 6 bytes that the channel needs")
        assert told(await device.read())[:3] == [1, 16, few]
        if name == "counts":
            await server.set(name, [1, 256])
            assert told(await device.read())[0] == ("sensor_fault", "the node holds no bytes: [1, 256]")
    finally:
        await bus.close()
        await server.server.stop()


@pytest.mark.simulated_time
async def test_a_device_that_loses_its_node_when_it_is_unplugged_returns_with_it(tmp_path: Path) -> None:
    profile = tmp_path / "bytes.toml"
    nodes = "".join(f'[[node]]\nnode = "s={name}"\n' for name in ("motor", "bearing"))
    profile.write_text(HEAD + nodes, encoding="utf-8")
    server = Drives()
    await server.start()
    bus = make_bus("opc1", "opcua", {"url": server.url, "security": "none", "timeout_s": 5.0})
    device = make_device("bytes", bus, str(profile), 1, {"motor": 0, "bearing": 1}, {}, SystemClock())
    try:
        await bus.connect()
        await device.connect()
        assert told(await device.read()) == [61.25, 431.0]
        await server.server.delete_nodes([server.server.get_node(server.node("motor"))])
        motor, bearing = await device.read()
        assert (motor.quality, bearing.value) == (Quality.COMM_FAULT, 431.0)
        assert "BadNodeIdUnknown" in motor.detail
        await server.server.nodes.objects.add_variable(server.node("motor"), "motor", 62.5)
        assert told(await device.read()) == [62.5, 431.0]
    finally:
        await bus.close()
        await server.server.stop()


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("shift = 2", "node[0].shift: opcua_of_bytes"),
        (
            "invalid = [{ equals = 1, quality = 'sensor_fault', detail = 'd' }]",
            "node[0].invalid: opcua_of_bytes",
        ),
        ("type = 'int16'\nshift = 16", "node[0].shift: shift_beyond shift=16 type=int16"),
        ("type = 'float32'\nshift = 1", "node[0].shift: shift_beyond shift=1 type=float32"),
        ("type = 'bool'\nshift = 1", "node[0].shift: shift_beyond shift=1 type=bool"),
        ("type = 'int24'", "node[0].type: invalid value='int24' mean"),
        (
            "type = 'bool'\ninvalid = [{ equals = 2, quality = 'sensor_fault', detail = 'd' }]",
            "node[0].invalid[0].equals: rule_never",
        ),
        (
            "type = 'int16'\nshift = 2\ninvalid = [{ low = 8192, quality = 'sensor_fault', detail = 'd' }]",
            "node[0].invalid[0].low: not_within value=8192 low=-8192 high=8191",
        ),
    ],
)
def test_a_number_that_bytes_cannot_hold_is_refused(tmp_path: Path, lines: str, message: str) -> None:
    profile = tmp_path / "bytes.toml"
    profile.write_text(HEAD + f'[[node]]\nnode = "s=motor"\n{lines}\n', encoding="utf-8")
    with refusing(SetupError, message):
        load_profile(str(profile))


def test_no_value_is_good_unless_its_status_is() -> None:
    """Every StatusCode: its two highest bits say whether the value is good; 3 is reserved. 0x96 is entered by hand."""
    for code in range(0x10000):
        assert (NodeValue(b"\x00\xea", code << 16).fault() is None) == (code >> 14 == 0 and code != 0x96)
    for low in (0x0480, 0x8000, 0xFFFF):  # details, such as that changes were left out
        assert NodeValue(b"\x00\xea", low).fault() is None
        assert NodeValue(b"\x00\xea", 0x4000_0000 | low).fault() is not None


@pytest.mark.simulated_time
async def test_bytes_are_good_only_with_a_good_status_and_if_they_are_there(tmp_path: Path) -> None:
    profile = tmp_path / "bytes.toml"
    profile.write_text(HEAD + '[[node]]\nnode = "s=bytes"\ntype = "int16"\nscale = 0.1\n', encoding="utf-8")
    server = Drives()
    await server.start()
    bus = make_bus("opc1", "opcua", {"url": server.url, "security": "none", "timeout_s": 5.0})
    device = make_device("bytes", bus, str(profile), 1, {"port": 0}, {}, SystemClock())
    statuses = (0, 0x4000_0000, 0x408F_0000, 0x4090_0000, 0x40A4_0000, 0x8000_0000, 0x808A_0000, 0x808C_0000)
    try:
        await bus.connect()
        await device.connect()
        for raw in (b"\x00\xea", b"\x00\xea\x01", b"\x00", b""):
            for status in statuses:
                await server.set("bytes", raw, status)
                (reading,) = await device.read()
                is_good = status == 0 and len(raw) >= 2
                assert (reading.quality is Quality.GOOD) == is_good, (raw, hex(status), reading)
                assert not is_good or reading.value == pytest.approx(23.4)
    finally:
        await bus.close()
        await server.server.stop()
