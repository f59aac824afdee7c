"""Boxes of modules with one mistake each, on real wires; docs/wiring.md shows what the commands report.

`python -m tests.benches.wiring_faults` renews the document's blocks.
"""

import re
import tempfile
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, chdir
from functools import partial
from pathlib import Path
from struct import pack, unpack

from simulators.devices import M7015, Adam6015, Cia404Node, MeSensor, RtuLine, SlcanAdapter, TcpHost
from simulators.devices.cia404_node import Nmt
from simulators.devices.modbus_unit import ModbusUnit
from simulators.devices.pta8d08 import Pta8d08
from simulators.devices.source import SensorFault
from tests.benches.command import beside, here
from tests.benches.simulated_time import simulated_time

DOCUMENT = Path("docs/wiring.md")
_BLOCK = re.compile(r"(<!-- shown (\w+) -->\n```text\n)(.*?)(```\n)", re.DOTALL)

ROOM = [21.3, 21.4, 21.2, 21.3, 21.5, 21.2]
"""A machine that stood overnight: everything has the hall's temperature."""

RTU = """[machine]
name = "mill"

[[bus]]
name = "rtu1"
kind = "modbus_rtu"
port = "rs485"
baud = 9600
timeout_s = 0.5
"""


def device(name: str, bus: str, profile: str, unit: int, channels: Sequence[str], options: str = "") -> str:
    """One `[[device]]`."""
    lines = [f'\n[[device]]\nname = "{name}"\nbus = "{bus}"\nprofile = "{profile}"\nunit = {unit}']
    lines += [f"[device.options]\n{options}"] if options else []
    return "\n".join([*lines, "[device.channels]", *(f"{c} = {i}" for i, c in enumerate(channels))]) + "\n"


def beds(unit: int = 1) -> str:
    """A module with three sensors in use."""
    return device("rtd1", "rtu1", "icpdas_m7015", unit, ("bed_front", "bed_rear", "column"))


def canopen(node: int = 5, bitrate: int = 125_000) -> str:
    """A node behind an slcan adapter."""
    bus = f'\n[[bus]]\nname = "can1"\nkind = "canopen"\ninterface = "slcan"\nchannel = "canusb"\nbitrate = {bitrate}\n'
    fluids = device("fluids", "can1", "cia404", node, ("coolant_in", "coolant_out"), 'vendor = "esd"')
    return '[machine]\nname = "mill"\n' + bus + fluids


class WiredBox:
    """A folder with a configuration, the wires that it names, and the commands that a user types there."""

    def __init__(self, folder: Path, stack: AsyncExitStack) -> None:
        self.folder, self._stack = folder, stack
        self.typed: list[tuple[str, ...]] = []

    def write(self, text: str, name: str = "gateway.toml") -> None:
        """A file of the folder."""
        (self.folder / name).write_text(text, encoding="utf-8")

    async def line(self, units: Mapping[int, ModbusUnit], baud: int = 9600) -> RtuLine:
        """Modbus units on the port rs485."""
        line = RtuLine(units, baud=baud)
        (self.folder / "rs485").symlink_to(await line.start())
        self._stack.push_async_callback(line.stop)
        return line

    async def sensor(self) -> MeSensor:
        """A displacement sensor on the port growth."""
        sensor = MeSensor(lambda: [123.4], range_um=500.0)
        (self.folder / "growth").symlink_to(await sensor.start())
        self._stack.push_async_callback(sensor.stop)
        return sensor

    async def host(self, units: Mapping[int, ModbusUnit]) -> int:
        """Modbus TCP on a free port of this computer."""
        host = TcpHost(units)
        port = await host.start()
        self._stack.push_async_callback(host.stop)
        return port

    async def can(self, nodes: Sequence[Cia404Node], bitrate: int = 125_000) -> SlcanAdapter:
        """Nodes behind the adapter canusb."""
        adapter = SlcanAdapter(nodes, bitrate=bitrate)
        (self.folder / "canusb").symlink_to(await adapter.start())
        self._stack.push_async_callback(adapter.stop)
        return adapter

    def speaks(self, node: Cia404Node, adapter: SlcanAdapter) -> None:
        """Let this node of the adapter send unasked."""
        node.start(adapter.send)
        self._stack.callback(node.stop)

    def type(self, *arguments: str) -> None:
        """Add a command to run once everything is wired."""
        self.typed.append(arguments)


async def green(box: WiredBox) -> None:
    """Two modules and a displacement sensor, all well."""
    await box.line({1: M7015(lambda: ROOM), 2: Pta8d08(lambda: [*ROOM, 21.3, 21.2])})
    options = ("--protocol", "modbus_rtu", "--baud", "9600", "--baud", "19200", "--timeout", "0.4")
    box.type("scan", "serial", "rs485", "--units", "1-4", *options, "--toml", "gateway.toml")
    box.type("probe", "gateway.toml")


async def silence(box: WiredBox) -> None:
    """A and B swapped, no power, another unit id, another speed: no module receives our requests."""
    box.write(RTU + beds())
    await box.line({1: M7015(lambda: ROOM)}, baud=115200)
    box.type("probe", "gateway.toml")


async def speed(box: WiredBox) -> None:
    """The same line, every speed tried."""
    await box.line({1: M7015(lambda: ROOM)}, baud=115200)
    box.type("scan", "serial", "rs485", "--units", "1-2", "--protocol", "modbus_rtu", "--timeout", "0.4")


async def duplicate(box: WiredBox) -> None:
    """Two units with one id answer at once; here the second one drowns the middle of the first one's answer."""
    box.write(RTU + beds())
    line = await box.line({1: M7015(lambda: ROOM)})
    line.spoil = lambda _, frame: [(0.0, frame[:3] + bytes(a & 0x6D for a in frame[3:-2]) + frame[-2:])]
    box.type("probe", "gateway.toml")


async def noise(box: WiredBox) -> None:
    """No termination beside a long cable: at times all answers are disturbed, longer than a period."""
    box.write(
        RTU.replace("timeout_s", "period_s = 0.25\nretry_max_periods = 1\ntimeout_s").replace("0.5", "0.1") + beds()
    )
    line = await box.line({1: M7015(lambda: ROOM)})
    turn = 0

    def disturb(_: int, frame: bytes) -> list[tuple[float, bytes]]:
        nonlocal turn
        turn += len(frame) > 8  # an answer with values
        disturbed = len(frame) > 8 and (3 <= turn <= 10 or 14 <= turn <= 21)
        return [(0.0, frame[:4] + bytes([frame[4] ^ 0x08]) + frame[5:] if disturbed else frame)]

    line.spoil = disturb
    box.type("probe", "gateway.toml", "--watch", "--seconds", "5", "--every", "5")


async def open_input(box: WiredBox) -> None:
    """A broken wire at a module that reports it, and at one that does not."""
    tells, guesses = M7015(lambda: ROOM), Pta8d08(lambda: [*ROOM, 21.3, 21.2])
    tells.faults.set(1, SensorFault.OPEN)
    guesses.faults.set(0, SensorFault.OPEN)
    box.write(RTU + beds() + device("rtd2", "rtu1", "eletechsup_pta8d08", 2, ("spindle_front", "spindle_rear")))
    await box.line({1: tells, 2: guesses})
    box.type("probe", "gateway.toml")


async def two_wires(box: WiredBox) -> None:
    """A Pt100 wired with two conductors of 1.2 ohm in all: 1.2 / 0.385 = 3.1 K too warm, and good."""
    box.write(RTU + beds())
    await box.line({1: M7015(lambda: [21.3, 21.4 + 1.2 / 0.385, *ROOM[2:]])})
    box.type("probe", "gateway.toml")


FLOATS = """protocol = "modbus"
title = "Module with four float32 inputs"
buses = ["modbus_rtu"]
channels = 4
unit = "degC"
[value]
function = 4
address = 0
type = "float32"
word_order = "big"
"""


class FloatModule:
    """A unit with float32 values, low register first."""

    silent = False

    def memory(self, function: int) -> dict[int, int]:
        """Registers 0.. of function 4."""
        if function != 4:
            return {}
        words = [unpack(">HH", pack(">f", value))[::-1] for value in ROOM[:4]]
        return dict(enumerate(word for pair in words for word in pair))


async def word_order(box: WiredBox) -> None:
    """A user's profile with the registers in the wrong order."""
    box.write(FLOATS, "module.toml")
    box.write(RTU + device("rtd1", "rtu1", "module.toml", 1, ("bed_front", "bed_rear")))
    await box.line({1: FloatModule()})
    box.type("probe", "gateway.toml")


async def wrong_device(box: WiredBox) -> None:
    """An input that is set to another sensor."""
    box.write(RTU + beds())
    module = M7015(lambda: ROOM)
    module.set_type_code(2, 0x2B)
    await box.line({1: module})
    box.type("probe", "gateway.toml")


async def data_format(box: WiredBox) -> None:
    """A module whose numbers are parts of its range instead of tenths of a degree."""
    box.write(RTU + beds())
    module = M7015(lambda: ROOM)
    module.engineering = False
    await box.line({1: module})
    box.type("probe", "gateway.toml")


async def absent_port(box: WiredBox) -> None:
    """The adapter is not plugged in."""
    box.write(RTU + beds())
    box.type("probe", "gateway.toml")


async def unit_behind_host(box: WiredBox) -> None:
    """The unit id behind a host is another one."""
    port = await box.host({3: Adam6015(lambda: [*ROOM, 21.3])})
    box.type("scan", "tcp", f"127.0.0.1:{port}", "--timeout", "0.5")
    box.type("scan", "tcp", f"127.0.0.1:{port}", "--timeout", "0.5", "--units", "1-8")


async def can_rate(box: WiredBox) -> None:
    """Nodes at another bit rate."""
    box.write(canopen())
    node = Cia404Node(5, lambda: ROOM[:2], inputs=2, vendor="esd", heartbeat_ms=200)
    adapter = await box.can([node], bitrate=250_000)
    box.speaks(node, adapter)
    box.type("probe", "gateway.toml")
    box.type("scan", "can", "canusb", "--interface", "slcan", "--listen", "1")


async def can_duplicate(box: WiredBox) -> None:
    """Two nodes with one id, and one that was stopped."""
    twins = [Cia404Node(5, lambda: ROOM[:2], inputs=2, vendor="esd") for _ in range(2)]
    stopped = Cia404Node(6, lambda: ROOM[:2], inputs=2, vendor="esd", heartbeat_ms=200)
    stopped.on_frame(0, bytes((Nmt.STOP, 6)))
    adapter = await box.can([*twins, stopped])
    box.speaks(stopped, adapter)
    box.type("scan", "can", "canusb", "--interface", "slcan", "--bitrate", "125000", "--listen", "1")


async def no_target(box: WiredBox) -> None:
    """A displacement sensor without its target, or unplugged from its amplifier."""
    sensor = await box.sensor()
    sensor.faults.set(0, SensorFault.OPEN)
    bus = '\n[[bus]]\nname = "growth1"\nkind = "me_rs485"\nport = "growth"\n'
    box.write(
        '[machine]\nname = "mill"\n' + bus + device("eddy", "growth1", "me_rs485", 126, ("growth",), "range_um = 500.0")
    )
    box.type("probe", "gateway.toml")


FAULTS: dict[str, Callable[[WiredBox], Awaitable[None]]] = {
    case.__name__: case
    for case in (
        green, silence, speed, duplicate, noise, open_input, two_wires, word_order, wrong_device, data_format,
        absent_port, unit_behind_host, can_rate, can_duplicate, no_target,
    )
}  # fmt: skip


@asynccontextmanager
async def wired(name: str, folder: Path) -> AsyncIterator[WiredBox]:
    """The box of one case, whose wires are taken away at the end."""
    async with AsyncExitStack() as stack:
        box = WiredBox(folder, stack)
        await FAULTS[name](box)
        yield box


def told_of(name: str, folder: Path) -> str:
    """What the commands of one case print. They run in this process, so that simulated time applies to them and the
    devices."""
    told = []
    with beside(wired(name, folder)) as box, chdir(folder):
        for arguments in box.typed:
            done = here(*arguments, columns=80)
            out = done.together.replace(f"{folder.resolve()}/", "")  # a relative port starts at the file's folder
            told.append(f"$ talc-gateway {' '.join(arguments)}\n{out}")
    return "\n".join(told)


def blocks(text: str) -> dict[str, str]:
    """The document's shown output, by name."""
    return {found[2]: found[3] for found in _BLOCK.finditer(text)}


def comparable(text: str) -> str:
    """Without what differs from run to run: times, ports, and the room that they take in a table."""
    text = re.sub(r"\d\d:\d\d:\d\d", "TIME", re.sub(r"127\.0\.0\.1(:|, )\d+", "127.0.0.1:PORT", text))
    text = re.sub(r"[\d.]+ (ms|Hz|s)\b", r"N \1", text)
    return "\n".join(re.sub(r"[ ━─]+", " ", line).strip() for line in text.strip().splitlines())


def renew() -> None:
    """Put what the commands print now into the document."""
    text = DOCUMENT.read_text(encoding="utf-8")

    def output(found: re.Match[str]) -> str:
        with tempfile.TemporaryDirectory() as folder, simulated_time():
            said = told_of(found[2], Path(folder))
        return found[1] + "\n".join(line.rstrip() for line in said.splitlines()) + "\n" + found[4]

    DOCUMENT.write_text(_BLOCK.sub(partial(output), text), encoding="utf-8")


if __name__ == "__main__":
    renew()
